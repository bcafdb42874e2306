"""Estimates of the cost to the goal, by name, in the form that the search evaluates."""

from typing import NamedTuple

import numpy as np

from jaxurban.errors import InputError, nearest_name
from jaxurban.kernels.heuristic import cell_line_bound, line_line_bound, printed_plus_field
from jaxurban.planners.base import Cell, Problem
from jaxurban.planners.search import estimate

ADMISSIBLE = ("none", "euclidean", "octile", "plus")  # all of them consistent too
PRINTED = ("plus-printed", "plus-printed-from-0")
HEURISTICS = ADMISSIBLE + PRINTED


class Heuristic(NamedTuple):
    """A bound ``h(n)``: a distance part plus a map part, evaluated node by node. ``Y`` rows, ``X`` columns.

    With ``dr, dc`` rows and columns to the goal: the distance part is ``euclidean * hypot(dr, dc)
    + straight * max(dr, dc) + diagonal * min(dr, dc)``, the map part ``max(rows[r], cols[c])``
    or, where ``field`` has any cells, ``field[r, c]``.

    Attributes:
      euclidean, straight, diagonal: cost per cell side.
      rows, cols: ``[Y]``, ``[X]`` float64 map cost from each row and column to the goal's.
      field: ``[Y, X]`` float64 map cost to the goal, or ``[0, 0]``.
    """

    euclidean: float
    straight: float
    diagonal: float
    rows: np.ndarray
    cols: np.ndarray
    field: np.ndarray


def make_heuristic(name: str, problem: Problem) -> Heuristic:
    """Return a heuristic for a problem's goal, map, weights and cost model.

    - ``none``: 0, which makes A* Dijkstra's search.
    - ``euclidean``: ``distance_weight`` times the straight distance (the paper's h_dist).
    - ``octile``: the least length of an 8-connected path; Manhattan distance at connectivity 4.
    - ``plus``: octile, plus whole-row and whole-column minima of the map cost (admissible, consistent).
    - ``plus-printed``, ``plus-printed-from-0``: octile, plus the paper's box minima, summed over indices
      1..dx or 0..dx-1: **not** admissible. Under the ``line`` model every line counts in full.

    Raises:
      InputError: an unknown name.
    """
    if name not in HEURISTICS:
        raise InputError(
            f"unknown heuristic {name!r}{nearest_name(name, HEURISTICS)}: choose one of {', '.join(HEURISTICS)}"
        )
    per_side = problem.distance_weight * problem.resolution_m
    heuristic = Heuristic(
        euclidean=per_side if name == "euclidean" else 0.0,
        straight=0.0 if name in ("none", "euclidean") else per_side,
        diagonal=0.0
        if name in ("none", "euclidean")
        else per_side * (np.sqrt(2) - 1 if problem.connectivity == 8 else 1),
        rows=np.zeros(problem.is_free.shape[0]),
        cols=np.zeros(problem.is_free.shape[1]),
        field=np.empty((0, 0)),
    )
    sides_per_reference = problem.resolution_m / problem.reference_length_m
    if name == "plus":
        bounds = (
            cell_line_bound(minima, goal)
            if problem.cost_model == "cell"
            else line_line_bound(minima, goal, sides_per_reference)
            for minima, goal in zip(problem.line_minima, problem.goal, strict=True)
        )
        heuristic = heuristic._replace(rows=next(bounds), cols=next(bounds))
    elif name in PRINTED:
        field = printed_plus_field(problem.layers, problem.goal, first_index=1 if name == "plus-printed" else 0)
        if problem.cost_model == "line":
            field *= sides_per_reference
        heuristic = heuristic._replace(field=field)
    return heuristic


def heuristic_at(heuristic: Heuristic, cell: Cell, goal: Cell) -> float:
    """Return ``h`` at a cell."""
    return float(estimate(heuristic, *cell, *goal))
