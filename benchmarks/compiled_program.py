"""What a program compiled for a GPU launches, counted in XLA's own text of it (optimised HLO)."""

import math
import re
from functools import cache
from typing import NamedTuple

# Instructions for which nothing runs on the GPU: names, views, and the ends of what was begun before.
FREE = (
    *("parameter", "constant", "get-tuple-element", "tuple", "bitcast", "after-all", "add-dependency", "opt-barrier"),
    *("domain", "partition-id", "replica-id", "copy-done", "async-update", "async-done"),
)
PARTS_READ = ("dynamic-slice", "slice", "gather")


class Counts(NamedTuple):
    """What one call of a program does. A loop whose end is data counts as one turn, of branches the one with most.

    Attributes:
      launches: kernels, copies and library calls.
      in_loops: how many of these within the turns of loops.
      data_loops: loops of the program whose number of turns is not known when it is compiled: the host, or the GPU's
        own scheduler, must look at data after every turn.
      choices: branches that data choose.
      bytes_moved: read and written by all launches, as if nothing stayed in a cache from one to the next.
    """

    launches: int = 0
    in_loops: int = 0
    data_loops: int = 0
    choices: int = 0
    bytes_moved: int = 0


def count(hlo: str) -> Counts:
    """Return what a call of a compiled program launches.

    Args:
      hlo: ``compiled.as_text()`` of a program compiled for a GPU.

    Raises:
      ValueError: the text holds no entry computation.
    """
    bodies, entry = _computations(hlo)

    @cache
    def of(name: str) -> Counts:
        total, of_name = Counts(), {_name(line): line for line in bodies[name]}
        for line in bodies[name]:
            total = Counts(*map(sum, zip(total, one(line, of_name), strict=True)))
        return total

    def one(line: str, of_name: dict[str, str]) -> Counts:
        opcode = _opcode(line)
        if opcode in FREE:
            return Counts()
        if opcode == "while":
            body, condition = (of(_called(line, part)) for part in ("body", "condition"))
            known = re.search(r'"known_trip_count":\s*\{\s*"n":\s*"(\d+)"', line)
            turns = int(known[1]) if known else 1
            launches = turns * (body.launches + condition.launches)
            data_loops = body.data_loops + condition.data_loops + (known is None)
            moved = turns * (body.bytes_moved + condition.bytes_moved)
            return Counts(launches, launches, data_loops, body.choices + condition.choices, moved)
        if opcode == "conditional":
            branches = [of(name) for name in _branches(line)]
            launches, in_loops, moved = (max(branch[i] for branch in branches) for i in (0, 1, 4))
            data_loops, choices = (sum(branch[i] for branch in branches) for i in (2, 3))
            return Counts(launches, in_loops, data_loops, choices + 1, moved)
        if opcode == "call":
            return of(_called(line, "to_apply"))
        return Counts(launches=1, bytes_moved=_bytes_moved(line, of_name, bodies))

    return of(entry)


def _bytes_moved(line: str, of_name: dict[str, str], bodies: dict[str, list[str]]) -> int:
    """Return what a launch reads and writes; of what a fusion only takes parts of, the parts."""
    opcode, operands = _opcode(line), _operands(line)
    if opcode in PARTS_READ:
        return 2 * _size(line)
    if opcode == "dynamic-update-slice":
        return 2 * _size(of_name[operands[1]])
    written, inside = _size(line), bodies[_called(line, "calls")] if opcode == "fusion" else []
    in_fusion = {_name(each): each for each in inside}
    updated = {_operands(each)[0]: each for each in inside if _opcode(each) == "dynamic-update-slice"}
    for each in updated.values():
        written -= _size(each) - _size(in_fusion[_operands(each)[1]])
    read = 0
    for each in inside:
        if _opcode(each) == "parameter":
            users = [user for user in inside if _name(each) in _operands(user)]
            if _name(each) in updated:
                users = [user for user in users if user is not updated[_name(each)]]
            in_parts = all(_opcode(user) in PARTS_READ and _operands(user)[0] == _name(each) for user in users)
            parts = sum(map(_size, users))
            read += min(parts, _size(each)) if in_parts else _size(each)
    if opcode != "fusion":
        read = sum(_size(of_name[name]) for name in operands if name in of_name)
    return read + max(written, 0)


def _name(line: str) -> str:
    return re.match(r"\s*(?:ROOT )?%?([\w.\-]+) = ", line)[1]


def _operands(line: str) -> list[str]:
    """Return the names in an instruction's brackets."""
    behind = line.split(" = ", 1)[1]
    begin = re.search(r" [a-z][a-z0-9\-]*\(", behind).end()
    return re.findall(r"%([\w.\-]+)", behind[begin:].split(")", 1)[0])


def _size(line: str) -> int:
    """Return the bytes of an instruction's result."""
    result = line.split(" = ", 1)[1]
    result = result[: re.search(r" [a-z][a-z0-9\-]*\(", result).start()]
    total = 0
    for kind, shape in re.findall(r"\b([a-z]+\d*)\[([\d,]*)\]", result):
        bits = 8 if kind == "pred" else int(re.search(r"\d+$", kind)[0]) if kind != "token" else 0
        total += math.prod(map(int, filter(None, shape.split(",")))) * bits // 8
    return total


def _computations(hlo: str) -> tuple[dict[str, list[str]], str]:
    """Return the instructions of each computation by its name, and the name of the one that is called."""
    bodies: dict[str, list[str]] = {}
    entry, name = None, None
    for line in hlo.splitlines():
        opened = re.match(r"(ENTRY )?%?([\w.\-]+) \(.*\{$", line)
        if opened:
            name = opened[2]
            bodies[name] = []
            entry = name if opened[1] else entry
        elif line.startswith("}"):
            name = None
        elif name is not None and " = " in line:
            bodies[name].append(line)
    if entry is None:
        raise ValueError("the text holds no ENTRY computation: give compiled.as_text()")
    return bodies, entry


def _opcode(line: str) -> str:
    """Return what an instruction does: the first word before a bracket, behind its type."""
    found = re.search(r" ([a-z][a-z0-9\-]*)\(", line.split(" = ", 1)[1])
    if found is None:
        raise ValueError(f"no instruction: {line.strip()[:200]}")
    return found[1]


def _called(line: str, part: str) -> str:
    return re.search(rf"{part}=%?([\w.\-]+)", line)[1]


def _branches(line: str) -> list[str]:
    several = re.search(r"branch_computations=\{([^}]*)\}", line)
    if several:
        return [name.strip().lstrip("%") for name in several[1].split(",")]
    return [_called(line, f"{which}_computation") for which in ("true", "false")]
