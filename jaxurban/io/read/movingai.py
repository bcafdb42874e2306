"""MovingAI's grid benchmark format: ``.map`` and ``.scen`` files (Sturtevant 2012, movingai.com/benchmarks/formats).

The files' first row is the northern one and y counts southward; here row 0 is in the south.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxurban.io.files import write_whole

FREE, BLOCKED = ".", "@"
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
