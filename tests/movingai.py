"""Reading MovingAI's grid benchmark files, for tests of what is written and of what was published."""

from pathlib import Path
from typing import NamedTuple

import numpy as np


class GridProblem(NamedTuple):
    """A shortest-path query on a map, cells as (row, column) from the southwest; ``length`` in cell sides."""

    start: tuple[int, int]
    goal: tuple[int, int]
    length: float


def read_map(file: Path) -> np.ndarray:
    """Return ``[Y, X]`` bool, the free cells of a ``.map`` file."""
    rows = file.read_text(encoding="ascii").splitlines()[4:]
    return np.array([[cell in ".G" for cell in row] for row in rows])[::-1]


def read_scenarios(file: Path) -> list[GridProblem]:
    """Return the problems of a ``.scen`` file."""
    problems = []
    for line in file.read_text(encoding="ascii").splitlines()[1:]:
        num_rows, x0, y0, x1, y1 = map(int, line.split()[3:8])
        problems.append(
            GridProblem((num_rows - 1 - y0, x0), (num_rows - 1 - y1, x1), float(line.split()[8]))
        )
    return problems
