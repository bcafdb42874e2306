"""Small faults, to count how many of them the tests notice: ``python -m tests.faults draw`` and ``run``.

``draw`` chooses them by a seed in kernels, planners, io and studies (signs, comparisons, off by one, units) and writes
``tests/faults.jsonl``; a fault is kept by its function and the text of its line, so that lines may move. ``run`` makes
them one by one in a copy of the tree and runs a command there: ``run 3 17 -- .venv/bin/python -m pytest -x tests/io``;
without numbers all. One is noticed where the command ends with other than 0. Kernels are compiled anew in the copy.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
KEPT = Path(__file__).with_name("faults.jsonl")
FOLDERS = ("kernels", "planners", "jaxurban/io", "jaxurban/studies")
NUMBERS = {"sign": 3, "comparison": 3, "off by one": 2, "unit": 2}  # of each kind in each folder
GOING = re.compile(  # what issues say will be made anew
    r"io/(fetch|download|files|folders|workspace|tables|store)|receiver|complementarity|sensitivity/buildings|comparison"
)
NOT_COPIED = (".git", ".venv*", "out", "build", ".*_cache", ".hypothesis", "*.egg-info")
OPERATORS: dict[type[ast.AST], tuple[str, str, str]] = {  # what is written, what instead, kind
    ast.Add: ("+", "-", "sign"),
    ast.Sub: ("-", "+", "sign"),
    ast.Lt: ("<", "<=", "comparison"),
    ast.LtE: ("<=", "<", "comparison"),
    ast.Gt: (">", "<", "comparison"),
    ast.GtE: (">=", ">", "comparison"),
    ast.Eq: ("==", "!=", "comparison"),
}
ANGLES = {"radians": "degrees", "degrees": "radians", "deg2rad": "rad2deg", "rad2deg": "deg2rad"}
NO_UNITS = (0.5, 1.0, 2.0)
LEAST_UNIT = 1e-3  # below are slacks of rounding
Fault = dict[str, str]


def changes(node: ast.AST) -> Iterator[tuple[str, int, int, int, str, str]]:
    """Yield kind, line, first and last column, the text that must stand between them, and what is put in its place."""
    pairs = [(node.left, node.op, node.right)] if isinstance(node, ast.BinOp) else []
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        pairs = [(node.left, node.ops[0], node.comparators[0])]
    for left, operator, right in pairs:
        is_text = any(isinstance(getattr(side, "value", side), ast.JoinedStr | str) for side in (left, right))
        if type(operator) in OPERATORS and not is_text and left.end_lineno == right.lineno:
            written, instead, kind = OPERATORS[type(operator)]
            yield kind, right.lineno, left.end_col_offset or 0, right.col_offset, written, instead
    if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.end_col_offset:
        kind = "off by one" if type(node.value) is int else "unit"
        instead = str(node.value + 1) if kind == "off by one" else f"{1000 * node.value:g}"
        if kind == "off by one" or (node.value not in NO_UNITS and abs(node.value) >= LEAST_UNIT):
            yield kind, node.lineno, node.col_offset, node.end_col_offset, "", instead
    if isinstance(node, ast.Attribute) and node.attr in ANGLES and node.end_col_offset:
        end = node.end_col_offset
        yield "unit", node.end_lineno or 0, end - len(node.attr), end, node.attr, ANGLES[node.attr]


def functions(tree: ast.AST, path: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Yield the functions of a module and of its classes by their qualified names; not those in functions."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield path + node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from functions(node, f"{path}{node.name}.")


def nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes in which a fault counts: none in messages, annotations and decorators."""
    for name, value in ast.iter_fields(tree):
        for node in value if isinstance(value, list) else [value]:
            is_text = isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr)
            is_text |= name in ("annotation", "returns", "decorator_list")
            if isinstance(node, ast.AST) and not is_text:
                yield node
                yield from nodes(node)


def faults_of(file: str) -> Iterator[Fault]:
    """Yield every fault that can be made in a file, in a line that its function holds once."""
    text = (ROOT / file).read_text(encoding="utf-8")
    lines = text.splitlines()
    for function, tree in functions(ast.parse(text)):
        if "warm_up" in function:  # whose results nobody looks at
            continue
        own = [line.strip() for line in lines[tree.lineno - 1 : tree.end_lineno]]  # type: ignore[attr-defined]
        for node in nodes(tree):
            for kind, number, first, last, written, instead in changes(node):
                line = lines[number - 1]
                between, is_of_the_clock = line[first:last], "perf_counter" in line
                if written in between and own.count(line.strip()) == 1 and line.isascii() and not is_of_the_clock:
                    place = line[:first] + (between.replace(written, instead, 1) if written else instead) + line[last:]
                    what = {"line": line.strip(), "instead": place.strip(), "kind": kind}
                    yield {"file": file, "function": function, **what}


def draw(seed: int) -> list[Fault]:
    """Return faults of each folder and kind, no two in one function; others where a kind runs out."""
    rng, drawn = random.Random(seed), []
    for folder in FOLDERS:
        files = [file.relative_to(ROOT).as_posix() for file in sorted((ROOT / folder).rglob("*.py"))]
        left = [fault for file in files if not GOING.search(file) for fault in faults_of(file)]
        rng.shuffle(left)
        for kind, number in NUMBERS.items():
            for _ in range(number):
                taken = {(fault["file"], fault["function"]) for fault in drawn}
                fitting = [fault for fault in left if (fault["file"], fault["function"]) not in taken]
                drawn.append(next((fault for fault in fitting if fault["kind"] == kind), fitting[0]))
    return drawn


def with_fault(text: str, fault: Fault) -> str | None:
    """Return the text of a file with a fault made; None where its line is gone, or no longer there once."""
    lines = text.splitlines(keepends=True)
    for function, tree in functions(ast.parse(text)):
        inside = range(tree.lineno - 1, tree.end_lineno)  # type: ignore[attr-defined]
        at = [k for k in inside if lines[k].strip() == fault["line"]] if function == fault["function"] else []
        if len(at) == 1:
            lines[at[0]] = lines[at[0]].replace(fault["line"], fault["instead"])
            return "".join(lines)
    return None


def is_noticed(fault: Fault, command: list[str]) -> bool | None:
    """Make a fault in a copy of the tree and run a command there; None where the fault's line is gone."""
    text = with_fault((ROOT / fault["file"]).read_text("utf-8"), fault) if (ROOT / fault["file"]).exists() else None
    if text is None:
        return None
    is_compiled = fault["file"].startswith(("kernels", "planners"))  # caches of Numba do not know what was inlined
    with tempfile.TemporaryDirectory(prefix="fault-") as scratch:
        copy = Path(scratch, "tree")
        ignored = shutil.ignore_patterns(*NOT_COPIED, *(["__pycache__"] if is_compiled else []))
        shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
        (copy / ".venv").symlink_to(ROOT / ".venv")
        (copy / fault["file"]).write_text(text, encoding="utf-8")
        own_cache = {"NUMBA_CACHE_DIR": f"{scratch}/numba"} if is_compiled else {}
        environment = {**os.environ, "PYTHONPATH": str(copy), **own_cache}
        return subprocess.run(command, cwd=copy, env=environment, capture_output=True).returncode != 0


def main() -> None:
    """Draw faults, or run a command under those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("draw", "run"))
    parser.add_argument("numbers", nargs="*", type=int, help="of faults: lines of the file, from 1")
    parser.add_argument("--seed", type=int, default=28, help="of draw")
    cut = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    asked, command = parser.parse_args(sys.argv[1:cut]), sys.argv[cut + 1 :]
    if asked.what == "draw":
        KEPT.write_text("".join(json.dumps(fault) + "\n" for fault in draw(asked.seed)), encoding="utf-8")
        return
    if not command:
        parser.error("give the command that shall notice the faults after --")
    faults = [json.loads(line) for line in KEPT.read_text(encoding="utf-8").splitlines()]
    names = {True: "noticed", False: "UNNOTICED", None: "gone"}
    for number in asked.numbers or range(1, len(faults) + 1):
        fault = faults[number - 1]
        verdict = names[is_noticed(fault, command)]
        print(
            f"{number:2} {verdict:<10}{fault['kind']:<12}{fault['file']} {fault['function']}: {fault['instead']}",
            flush=True,
        )


if __name__ == "__main__":
    main()
