"""What a program compiled for a GPU launches, counted in XLA's own text of it (optimised HLO)."""

import re
from functools import cache
from typing import NamedTuple

# Instructions for which nothing runs on the GPU: names, views, and the ends of what was begun before.
FREE = (
    *("parameter", "constant", "get-tuple-element", "tuple", "bitcast", "after-all", "add-dependency", "opt-barrier"),
    *("domain", "partition-id", "replica-id", "copy-done", "async-update", "async-done"),
)


class Counts(NamedTuple):
    """What one call of a program does. A loop whose end is data counts as one turn, of branches the one with most.

    Attributes:
      launches: kernels, copies and library calls.
      in_loops: how many of these within the turns of loops.
      data_loops: loops of the program whose number of turns is not known when it is compiled: the host, or the GPU's
        own scheduler, must look at data after every turn.
      choices: branches that data choose.
    """

    launches: int = 0
    in_loops: int = 0
    data_loops: int = 0
    choices: int = 0


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
        total = Counts()
        for line in bodies[name]:
            total = Counts(*map(sum, zip(total, one(line), strict=True)))
        return total

    def one(line: str) -> Counts:
        opcode = _opcode(line)
        if opcode in FREE:
            return Counts()
        if opcode == "while":
            body, condition = (of(_called(line, part)) for part in ("body", "condition"))
            known = re.search(r'"known_trip_count":\s*\{\s*"n":\s*"(\d+)"', line)
            launches = (int(known[1]) if known else 1) * (body.launches + condition.launches)
            data_loops = body.data_loops + condition.data_loops + (known is None)
            return Counts(launches, launches, data_loops, body.choices + condition.choices)
        if opcode == "conditional":
            branches = [of(name) for name in _branches(line)]
            most = (max(branch[i] for branch in branches) for i in (0, 1))
            data_loops, choices = (sum(branch[i] for branch in branches) for i in (2, 3))
            return Counts(*most, data_loops, choices + 1)
        if opcode == "call":
            return of(_called(line, "to_apply"))
        return Counts(launches=1)

    return of(entry)


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
