"""How large the code of one or several checkouts is, and how it hangs together, in one table.

``python -m benchmarks.structure [CHECKOUT ...]`` prints a column a checkout: code lines without blanks, comments and
docstrings (links counted once), entries directly in ``jaxurban/``, layers of the import contract, functions with more
than 8 arguments, record classes, places written twice, the longest files, and the words that `benchmarks.words` wants
replaced. ``--docstrings BEFORE AFTER`` lists instead the sentences of public docstrings that tell a unit, a shape, an
edge or a source and stand in no docstring of AFTER (`benchmarks.docstring_facts`).
"""

import argparse
import ast
import io
import os
import re
import shlex
import subprocess
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from benchmarks.common import ROOT
from benchmarks.docstring_facts import lost_facts
from benchmarks.words import Hit, by_folder, count_words

SOURCES = ("jaxurban", "kernels", "planners")
MOST_ARGUMENTS = 8
NUM_LONGEST = 5
RECORD_BASES = {"NamedTuple", "TypedDict", "BaseModel"}
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
PAIR = re.compile(r"(\S+\.py):\d+-\d+ ~ (\S+\.py):\d+-\d+")
Function = ast.FunctionDef | ast.AsyncFunctionDef
Table = dict[str, str]  # of one checkout: what is counted, and how many


def source_files(checkout: Path) -> Iterator[Path]:
    """Yield the Python files of the sources, no link followed."""
    for top in SOURCES:
        for folder, _, names in os.walk(checkout / top):
            files = (Path(folder, name) for name in names if name.endswith(".py"))
            yield from sorted(file for file in files if not file.is_symlink())


def num_code_lines(text: str, tree: ast.Module) -> int:
    """Return the lines that hold code: no blank, no comment, no docstring."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, Function)) and ast.get_docstring(node, clean=False) is not None:
            lines.difference_update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(lines)


def num_arguments(function: Function) -> int:
    """Return how many arguments a function takes, ``self`` and ``cls`` not counted."""
    given = function.args
    names = [argument.arg for argument in given.posonlyargs + given.args]
    is_bound = names[:1] in (["self"], ["cls"])
    return len(names) - is_bound + len(given.kwonlyargs) + bool(given.vararg) + bool(given.kwarg)


def name_of(node: ast.expr) -> str:
    """Return the last part of the name that a decorator or a base class goes by."""
    while isinstance(node, (ast.Call, ast.Subscript)):
        node = node.func if isinstance(node, ast.Call) else node.value
    return ast.unparse(node).rpartition(".")[2]


def record_classes(classes: list[ast.ClassDef]) -> list[str]:
    """Return the names of the dataclasses, NamedTuples, TypedDicts and pydantic models, and of what derives from these.

    A class derived from a dataclass counts where it is decorated as one itself.
    """
    bases = {node.name: {name_of(base) for base in node.bases} for node in classes}
    records = set(RECORD_BASES)
    while found := {name for name, of in bases.items() if of & records} - records:
        records |= found
    return sorted(
        node.name
        for node in classes
        if node.name in records or any(name_of(mark) == "dataclass" for mark in node.decorator_list)
    )


def num_layers(checkout: Path) -> int:
    """Return how many entries the layers of the import contract have."""
    settings = tomllib.loads((checkout / "pyproject.toml").read_text(encoding="utf-8"))
    return sum(len(contract.get("layers", ())) for contract in settings["tool"]["importlinter"]["contracts"])


def num_pairs(checkout: Path, command: str) -> int:
    """Return in how many rows a command that looks for code written twice names two places of the sources."""
    done = subprocess.run(shlex.split(command), cwd=checkout, capture_output=True, text=True, check=True)
    pairs = PAIR.findall(done.stdout)
    return sum(all(path.split("/")[0] in SOURCES for path in pair) for pair in pairs)


def measure(checkout: Path, duplicates: str, details: list[str]) -> Table:
    """Return the table of one checkout; what is behind the counts goes to ``details``."""
    lines: Counter[str] = Counter()
    lengths: dict[str, int] = {}
    wide: list[str] = []
    classes: list[ast.ClassDef] = []
    for file in source_files(checkout):
        text, path = file.read_text(encoding="utf-8"), file.relative_to(checkout)
        tree = ast.parse(text)
        is_inside = path.parts[0] == "jaxurban" and len(path.parts) > 2
        lines["/".join(path.parts[:2]) if is_inside else path.parts[0]] += num_code_lines(text, tree)
        lengths[str(path)] = text.count("\n")
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes.append(node)
            elif isinstance(node, Function) and num_arguments(node) > MOST_ARGUMENTS:
                wide.append(f"{path}:{node.lineno} {node.name} takes {num_arguments(node)} arguments")
    records = record_classes(classes)
    longest = sorted(lengths, key=lambda path: -lengths[path])[:NUM_LONGEST]
    details += [*sorted(wide), f"record classes: {', '.join(records)}"]
    entries = [entry for entry in (checkout / "jaxurban").iterdir() if not entry.name.startswith((".", "__pycache__"))]
    return {
        "code lines": f"{sum(lines.values()):,}",
        **{f"  {folder}": f"{count:,}" for folder, count in sorted(lines.items())},
        "files": f"{len(lengths)}",
        "entries in jaxurban/": f"{len(entries)}",
        "import layers": f"{num_layers(checkout)}",
        f"functions with more than {MOST_ARGUMENTS} arguments": f"{len(wide)}",
        "record classes": f"{len(records)}",
        "pairs written twice": f"{num_pairs(checkout, duplicates)}" if duplicates else "",
        **{f"longest file, {rank}": f"{path} {lengths[path]}" for rank, path in enumerate(longest, start=1)},
    }


def words_table(hits: dict[str, list[Hit]]) -> Table:
    """Return how often each word to be replaced is left, by folder; nothing where it is gone."""
    left = {f"  {word}": by_folder(found) for word, found in hits.items()}
    return {"words left": f"{sum(map(len, hits.values()))}"} | left


def markdown(columns: dict[str, Table]) -> str:
    """Return tables side by side; what a checkout lacks stays blank."""
    names = dict.fromkeys(name for table in columns.values() for name in table)
    rows = [["", *columns], ["---"] * (len(columns) + 1)]
    rows += [[name, *(table.get(name, "") for table in columns.values())] for name in names]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def label_of(checkout: Path) -> str:
    """Return a checkout's commit, and its folder's name."""
    told = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=checkout, capture_output=True, text=True)
    return f"{checkout.resolve().parent.name}/{checkout.resolve().name} {told.stdout.strip()}".strip()


def main() -> None:
    """Print what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkouts", nargs="*", type=Path, default=[ROOT], metavar="CHECKOUT", help="default: this one")
    parser.add_argument("--docstrings", nargs=2, type=Path, metavar=("BEFORE", "AFTER"))
    parser.add_argument(
        "--duplicates",
        default="",
        metavar="COMMAND",
        help="run in each checkout; prints rows such as 'a.py:10-24 ~ b.py:40-54' for places written twice",
    )
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="also list functions, records and lines with words"
    )
    asked = parser.parse_args()
    if asked.docstrings:
        lost = lost_facts(*(list(source_files(checkout)) for checkout in asked.docstrings))
        print("\n".join([*lost, f"{len(lost)} sentences of public docstrings are found nowhere"]))
        return
    columns: dict[str, Table] = {}
    for checkout in asked.checkouts:
        details: list[str] = []
        hits = count_words(checkout)
        columns[label_of(checkout)] = measure(checkout, asked.duplicates, details) | words_table(hits)
        if asked.verbose:
            told = [f"{word}: {hit.path}:{hit.line}: {hit.text}" for word, found in hits.items() for hit in found]
            print("\n".join([label_of(checkout), *details, *told, ""]))
    print(markdown(columns))


if __name__ == "__main__":
    main()
