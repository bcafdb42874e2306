"""MovingAI's grid benchmark format: ``.map`` and ``.scen`` files (Sturtevant 2012, movingai.com/benchmarks/formats).

The files' first row is the northern one and y counts southward; here row 0 is in the south.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxurban.errors import InputError, readable
from jaxurban.io.files import write_whole

FREE, BLOCKED = ".", "@"
PASSABLE = ".G"
BUCKET = 4  # problems are sorted into buckets of so many cells of optimal length


class GridProblem(NamedTuple):
    """A shortest-path query on a map, cells as (row, column) from the southwest; ``length`` in cell sides."""

    start: tuple[int, int]
    goal: tuple[int, int]
    length: float


def write_map(is_free: np.ndarray, file: Path) -> None:
    """Write ``[Y, X]`` free cells as a ``.map`` file."""
    num_rows, num_cols = is_free.shape
    text = np.full((num_rows, num_cols + 1), ord("\n"), np.uint8)
    text[:, :-1] = np.where(is_free[::-1], ord(FREE), ord(BLOCKED))
    write_whole(file, f"type octile\nheight {num_rows}\nwidth {num_cols}\nmap\n".encode() + text.tobytes())


def read_map(file: Path) -> np.ndarray:
    """Return ``[Y, X]`` bool, the free cells of a ``.map`` file.

    Raises:
      InputError: it cannot be read, or its header and its rows do not agree.
    """
    with readable(file, "a MovingAI map", "give a whole one", IndexError):
        lines = Path(file).read_text(encoding="ascii").splitlines()
        num_rows, num_cols = int(lines[1].split()[1]), int(lines[2].split()[1])
    rows = lines[4 : 4 + num_rows]
    if len(rows) != num_rows or any(len(row) != num_cols for row in rows):
        raise InputError(f"{str(file)!r} is not a whole MovingAI map: it names {num_rows} rows of {num_cols} cells")
    cells = np.frombuffer("".join(rows).encode(), np.uint8).reshape(num_rows, num_cols)
    return np.isin(cells, np.frombuffer(PASSABLE.encode(), np.uint8))[::-1]


def write_scenarios(problems: Iterable[GridProblem], shape: tuple[int, int], map_name: str, file: Path) -> None:
    """Write problems on a map of a shape (rows, columns) as a ``.scen`` file, short ones first."""
    num_rows, num_cols = shape
    lines = ["version 1"]
    for start, goal, length in sorted(problems, key=lambda problem: problem.length):
        (row0, col0), (row1, col1) = start, goal
        places = (col0, num_rows - 1 - row0, col1, num_rows - 1 - row1)
        facts = (int(length / BUCKET), map_name, num_cols, num_rows, *places, f"{length:.8f}")
        lines.append("\t".join(map(str, facts)))
    write_whole(file, "\n".join(lines) + "\n")


def read_scenarios(file: Path) -> list[GridProblem]:
    """Return the problems of a ``.scen`` file.

    Raises:
      InputError: it cannot be read.
    """
    problems = []
    with readable(file, "MovingAI scenarios", "give a whole file", IndexError):
        for line in Path(file).read_text(encoding="ascii").splitlines()[1:]:
            num_rows, x0, y0, x1, y1 = map(int, line.split()[3:8])
            length = float(line.split()[8])
            problems.append(GridProblem((num_rows - 1 - y0, x0), (num_rows - 1 - y1, x1), length))
    return problems
