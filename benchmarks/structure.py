"""How large the code of one or several checkouts is, in one table: ``python -m benchmarks.structure [CHECKOUT ...]``.

Code lines are lines without blanks, comments and docstrings, links counted once; tokens are Python's own, without
these. Arrows upward are imports from one layer of the checkout's ``pyproject.toml`` to one above it, excepted ones
too; circles are modules that import each other, directly or not, in functions and for types too. With ``-v`` these and
the long and the wide functions are listed.
"""

import argparse
import ast
import io
import json
import os
import re
import subprocess
import sys
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from benchmarks.common import ROOT, table

SOURCES = ("jaxurban", "kernels", "planners")
WINGS = ("cities", "flights", "receivers", "studies", "draw", "terminal")
ABOVE = ("viewer", "cli", "__main__.py", "plot.py")  # may know all
OTHERS = ("tests", "benchmarks", "figures", "notebooks")
TEXTS = (
    ".pyi",
    ".js",
    ".css",
    ".md",
)  # of the sources: stubs, the viewer's page, templates of reports
MOST_LINES, MOST_ARGUMENTS, NUM_LONGEST = 60, 8, 5
NO_CODE = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)
# Grimp finds a package on the path of its process, so each checkout has a process.
PRINT_IMPORTS = """
import grimp, json
graph = grimp.build_graph("jaxurban", cache_dir=None)
print(json.dumps({module: sorted(graph.find_modules_directly_imported_by(module)) for module in sorted(graph.modules)}))
"""
Function = ast.FunctionDef | ast.AsyncFunctionDef
Table = dict[str, str]  # of one checkout: what is counted, and how many


def files_of(checkout: Path, tops: tuple[str, ...], suffix: str) -> Iterator[Path]:
    """Yield the files of folders, no link followed."""
    for top in tops:
        for folder, _, names in os.walk(checkout / top):
            files = (Path(folder, name) for name in names if Path(name).suffix == suffix)
            yield from sorted(file for file in files if not file.is_symlink())


def part_of(file: str) -> str:
    """Return the part of the package that a source belongs to, by its path in the checkout."""
    top, _, name = file.partition("/")
    name = name.partition("/")[0]
    if top != "jaxurban" or name not in (*WINGS, *ABOVE):
        return "core"
    return name if name in WINGS else "viewer and commands"


def code_lines_and_tokens(text: str) -> tuple[set[int], int]:
    """Return the numbers of the lines that hold code, and how many tokens: no blank, no comment, no docstring."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, (ast.Module, ast.ClassDef, Function))
            and ast.get_docstring(node, clean=False) is not None
        ):
            docstrings.update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    tokens = [
        token
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in NO_CODE
    ]
    tokens = [token for token in tokens if token.start[0] not in docstrings]
    return {line for token in tokens for line in range(token.start[0], token.end[0] + 1)}, len(
        tokens
    )


def num_arguments(function: Function) -> int:
    """Return how many arguments a function takes, ``self`` and ``cls`` not counted."""
    given = function.args
    names = [argument.arg for argument in given.posonlyargs + given.args]
    is_bound = names[:1] in (["self"], ["cls"])
    return len(names) - is_bound + len(given.kwonlyargs) + bool(given.vararg) + bool(given.kwarg)


def num_lazy_imports(text: str) -> int:
    """Return how many imports stand inside functions."""
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, Function)]
    inside = {node for function in functions for node in ast.walk(function)}
    return sum(isinstance(node, ast.Import | ast.ImportFrom) for node in inside)


class ImportGraph(NamedTuple):
    """Imports of a checkout: those upward, as ``IMPORTER -> IMPORTED``, and the circles of modules."""

    upward: list[str]
    circles: list[list[str]]


def layer_of(module: str, ranks: dict[str, int]) -> int | None:
    """Return the rank of the layer that a module or, before it, one of its parents is listed in."""
    while module and module not in ranks:
        module = module.rpartition(".")[0]
    return ranks.get(module)


def import_graph(checkout: Path) -> ImportGraph:
    """Return the arrows upward and the circles of a checkout."""
    printed = subprocess.run(
        [sys.executable, "-c", PRINT_IMPORTS],
        cwd=checkout,
        capture_output=True,
        text=True,
        check=True,
    )
    imports: dict[str, list[str]] = json.loads(printed.stdout)
    linter = tomllib.loads((checkout / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]
    layers = next(
        contract["layers"] for contract in linter["contracts"] if contract["type"] == "layers"
    )
    ranks = {
        name: rank for rank, layer in enumerate(layers) for name in re.findall(r"[\w.]+", layer)
    }
    arrows = [(module, other) for module, others in imports.items() for other in others]
    upward = []
    for module, other in arrows:
        own, its = layer_of(module, ranks), layer_of(other, ranks)
        if own is not None and its is not None and its < own:
            upward.append(f"{module} -> {other}")
    number = {module: index for index, module in enumerate(imports)}
    row, col = np.array([(number[module], number[other]) for module, other in arrows]).T
    matrix = coo_array((np.ones(len(row)), (row, col)), shape=(len(number), len(number)))
    _, labels = connected_components(matrix, connection="strong")
    modules = np.array(list(imports))
    groups = (modules[labels == label].tolist() for label in range(labels.max() + 1))
    circles = sorted((group for group in groups if len(group) > 1), key=len, reverse=True)
    return ImportGraph(upward, circles)


def measure(checkout: Path, details: list[str]) -> Table:
    """Return the table of one checkout; what is behind the counts goes to ``details``."""
    lines: Counter[str] = Counter()
    lengths: dict[str, int] = {}
    num_tokens = num_lazy = 0
    long: list[str] = []
    wide: list[str] = []
    for file in files_of(checkout, SOURCES, ".py"):
        text, path = file.read_text(encoding="utf-8"), file.relative_to(checkout)
        code, tokens = code_lines_and_tokens(text)
        is_inside = path.parts[0] == "jaxurban" and len(path.parts) > 2
        lines["/".join(path.parts[:2]) if is_inside else path.parts[0]] += len(code)
        num_tokens += tokens
        num_lazy += num_lazy_imports(text)
        lengths[str(path)] = text.count("\n")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, Function):
                num = len(code & set(range(node.lineno, node.end_lineno + 1)))
                if num > MOST_LINES:
                    long.append(f"{path}:{node.lineno} {node.name} has {num} code lines")
                if num_arguments(node) > MOST_ARGUMENTS:
                    wide.append(
                        f"{path}:{node.lineno} {node.name} takes {num_arguments(node)} arguments"
                    )
    longest = sorted(lengths, key=lambda path: -lengths[path])[:NUM_LONGEST]
    graph = import_graph(checkout)
    circles = [f"circle of {len(circle)}: {', '.join(circle)}" for circle in graph.circles]
    details += [*sorted(long), *sorted(wide), *graph.upward, *circles]
    others = {}
    for top in OTHERS:
        texts = (file.read_text(encoding="utf-8") for file in files_of(checkout, (top,), ".py"))
        others[f"code lines of {top}"] = (
            f"{sum(len(code_lines_and_tokens(text)[0]) for text in texts):,}"
        )
    for suffix in TEXTS:
        num = sum(
            len(file.read_text(encoding="utf-8").splitlines())
            for file in files_of(checkout, SOURCES, suffix)
        )
        others[f"lines of {suffix} in the sources"] = f"{num:,}"
    return {
        "code lines": f"{sum(lines.values()):,}",
        **{f"  {folder}": f"{count:,}" for folder, count in sorted(lines.items())},
        "code tokens": f"{num_tokens:,}",
        "files": f"{len(lengths)}",
        f"functions over {MOST_LINES} code lines": f"{len(long)}",
        f"functions with more than {MOST_ARGUMENTS} arguments": f"{len(wide)}",
        "arrows upward between layers": f"{len(graph.upward)}",
        "files in circles of imports": ", ".join(str(len(circle)) for circle in graph.circles)
        or "0",
        "imports inside functions": f"{num_lazy}",
        **{
            f"longest file, {rank}": f"{path} {lengths[path]}"
            for rank, path in enumerate(longest, start=1)
        },
        **others,
    }


def label_of(checkout: Path) -> str:
    """Return a checkout's commit, and its folder's name."""
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=checkout, capture_output=True, text=True
    )
    return f"{checkout.resolve().parent.name}/{checkout.resolve().name} {commit.stdout.strip()}".strip()


def main() -> None:
    """Print what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "checkouts",
        nargs="*",
        type=Path,
        default=[ROOT],
        metavar="CHECKOUT",
        help="default: this one",
    )
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="also list functions, arrows, circles"
    )
    options = parser.parse_args()
    columns: dict[str, Table] = {}
    for checkout in options.checkouts:
        details: list[str] = []
        columns[label_of(checkout)] = measure(checkout, details)
        if options.verbose:
            print("\n".join([label_of(checkout), *details, ""]))
    names = dict.fromkeys(name for each in columns.values() for name in each)
    print(
        table(
            ["", *columns],
            [[name, *(each.get(name, "") for each in columns.values())] for name in names],
        )
    )


if __name__ == "__main__":
    main()
