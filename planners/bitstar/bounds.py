"""Lower bounds for paths that leave the grid: from the start, to the goal, and along an edge.

Their distance part is Euclidean: octile lengths are those of grid paths, and up to 8.24 % longer.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.traversal import DIAGONAL_SIDES
from jaxurban.kernels.search.bounds import line_minima
from jaxurban.planners.base import Problem

HEURISTICS = ("euclidean", "plus")


class Bounds(NamedTuple):
    """Lower bounds of the cost between points of free cells. ``Y`` rows, ``X`` columns; cell sides.

    No path between two points costs less than ``per_side`` times their distance, plus ``enter`` of the
    cell of the second, plus the larger of the differences of ``row_sum`` and ``col_sum``, which are
    interpolated at the points. No path from the start (to the goal) costs less than the same with
    ``from_start`` (``to_goal``) at the point's row and column added to the larger one.

    Attributes:
      per_side: cost per cell side of distance.
      row_sum, col_sum: ``[Y + 1]``, ``[X + 1]`` map cost of crossing all rows (columns) below a border.
      enter: ``[Y, X]`` map cost of a step that ends in a cell.
      from_start, to_goal: rows' ``[Y]`` and columns' ``[X]`` map cost of the steps between.
      start, goal: ``[2]`` x, y.
    """

    per_side: float
    row_sum: np.ndarray
    col_sum: np.ndarray
    enter: np.ndarray
    from_start: tuple[np.ndarray, np.ndarray]
    to_goal: tuple[np.ndarray, np.ndarray]
    start: np.ndarray
    goal: np.ndarray

    def from_start_and_to_goal(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``[N]`` the bounds from the start and to the goal at points ``[N, 2]`` of free cells."""
        col, row = xy.astype(np.int64).T
        row_at, col_at, enter = self.edge_parts(xy)
        from_start, to_goal = (
            self.per_side * np.hypot(*(xy - end).T)
            + np.maximum(rows[row] + np.abs(row_at - end_row), cols[col] + np.abs(col_at - end_col))
            for end, end_row, end_col, rows, cols in self._ends()
        )
        goal_col, goal_row = self.goal.astype(np.int64)
        from_start = np.where((xy == self.start).all(axis=1), 0.0, from_start + enter)
        to_goal = np.where((xy == self.goal).all(axis=1), 0.0, to_goal + self.enter[goal_row, goal_col])
        return from_start, to_goal

    def through_cells(self, cells: np.ndarray) -> np.ndarray:
        """Return ``[M]`` the sum of both bounds at the centres of free cells, given as flat numbers."""
        row_mid, col_mid = (0.5 * (sums[:-1] + sums[1:]) for sums in (self.row_sum, self.col_sum))
        through = np.zeros(len(cells))
        for end, end_row, end_col, rows, cols in self._ends():
            rows, cols = rows + np.abs(row_mid - end_row), cols + np.abs(col_mid - end_col)
            _add_bound(through, cells, end[0], end[1], self.per_side, rows, cols)
        goal_col, goal_row = self.goal.astype(np.int64)
        return through + self.enter.reshape(-1)[cells] + self.enter[goal_row, goal_col]

    def _ends(self) -> list[tuple[np.ndarray, float, float, np.ndarray, np.ndarray]]:
        """Return, of start and goal, the point, ``row_sum`` and ``col_sum`` there, and rows' and columns' parts."""
        row_at, col_at, _ = self.edge_parts(np.stack([self.start, self.goal]))
        return [
            (self.start, row_at[0], col_at[0], *self.from_start),
            (self.goal, row_at[1], col_at[1], *self.to_goal),
        ]

    def slack(self) -> float:
        """Return how far that sum can fall from the centre of a cell to anywhere in it."""
        return float(np.sqrt(2) * self.per_side + max(np.diff(self.row_sum).max(), np.diff(self.col_sum).max()))

    def from_start_to_goal(self) -> float:
        """Return the lower bound of any path."""
        return float(self.from_start_and_to_goal(self.start[None])[1][0])

    def edge_parts(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``[N]`` ``row_sum`` and ``col_sum`` at points of free cells, and ``enter`` of their cells."""
        col, row = xy.astype(np.int64).T
        row_at, col_at = (
            np.interp(xy[:, axis], np.arange(len(sums)), sums) for axis, sums in ((1, self.row_sum), (0, self.col_sum))
        )
        return row_at, col_at, self.enter[row, col]


@compiled()
def _add_bound(through, cells, end_x, end_y, per_side, rows, cols):
    """Add the bound between the centres of cells and an end to ``through``."""
    num_cols = len(cols)
    for k in range(len(cells)):
        row = cells[k] // num_cols
        col = cells[k] - row * num_cols
        dx, dy = col + 0.5 - end_x, row + 0.5 - end_y
        through[k] += per_side * np.sqrt(dx * dx + dy * dy) + max(rows[row], cols[col])


def make_bounds(heuristic: str, problem: Problem, is_reachable: np.ndarray) -> Bounds:
    """Return the bounds of a heuristic: ``"euclidean"``, the distance alone, or ``"plus"``, map costs too.

    With ``plus`` the cost of the cheapest reachable cell counts along the whole straight distance, and beyond
    that the rows or the columns between two points, at their cheapest cells. Under ``line`` a path
    crosses all between them, the two end rows in part. Under ``cell`` it enters them step by step: the
    start is left out and the end costs its own cell. A step between is as long as a diagonal and
    can leap a row, so no more than every other row is sure to be entered.

    Args:
      heuristic: one of `HEURISTICS`.
      problem: the query.
      is_reachable: ``[Y, X]`` bool cells that paths may cross.
    """
    num_rows, num_cols = is_reachable.shape
    start, goal = (np.array([cell[1] + 0.5, cell[0] + 0.5]) for cell in (problem.start, problem.goal))
    nothing = np.zeros(num_rows), np.zeros(num_cols)
    bounds = Bounds(
        per_side=float(problem.distance_weight * problem.resolution_m),
        row_sum=np.zeros(num_rows + 1),
        col_sum=np.zeros(num_cols + 1),
        enter=np.zeros(is_reachable.shape),
        from_start=nothing,
        to_goal=nothing,
        start=start,
        goal=goal,
    )
    if heuristic == "euclidean":
        return bounds
    cheapest = problem.cost[is_reachable].min()
    minima = [np.where(np.isfinite(m), m - cheapest, 0.0) for m in line_minima(problem.cost, is_reachable)]
    if problem.cost_model.kind == "line":
        sides_per_reference = problem.resolution_m / problem.cost_model.reference_length_m
        row_sum, col_sum = (np.append(0.0, np.cumsum(m)) * sides_per_reference for m in minima)
        return bounds._replace(
            per_side=bounds.per_side + cheapest * sides_per_reference, row_sum=row_sum, col_sum=col_sum
        )
    ends = [
        tuple(_entered_between(m, index) for m, index in zip(minima, cell, strict=True))
        for cell in (problem.start, problem.goal)
    ]
    return bounds._replace(
        per_side=bounds.per_side + cheapest / DIAGONAL_SIDES,
        enter=np.where(is_reachable, problem.cost - cheapest, 0.0),
        from_start=(ends[0][0], ends[0][1]),
        to_goal=(ends[1][0], ends[1][1]),
    )


def _entered_between(minima: np.ndarray, end: int) -> np.ndarray:
    """Return ``[N]`` the least map cost of entering rows strictly between each row and ``end``'s.

    Two rows that follow each other are never both leapt. Such a way runs through ever nearer rows: of
    any other, the rows where it first comes nearer are one.
    """
    between = np.zeros(len(minima))
    for step in (1, -1):
        for row in range(end + 3 * step, len(minima) if step > 0 else -1, step):
            near, next_near = row - step, row - 2 * step
            between[row] = min(minima[near] + between[near], minima[next_near] + between[next_near])
    return between
