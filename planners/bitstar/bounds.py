"""The map as planners off the grid see it: lower bounds from the start, to the goal, and along an edge, and samples.

Their distance part is Euclidean: octile lengths are those of grid paths, and up to 8.24 % longer.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxurban.checks import one_of
from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.kernels.line.traversal import DIAGONAL_SIDES
from jaxurban.planners.base import Problem

HEURISTICS = ("euclidean", "plus")
OFF_BORDER = 1e-6  # in cell sides: samples keep off the borders, so that each lies in one cell
MAX_ROUNDS = 64  # of rejection, before a set too thin to sample is given up


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
        """Return ``[N]`` the lower bounds of cost from the start and to the goal, at points ``[N, 2]`` of free cells.

        Both are costs; at the start (the goal) itself its own bound is 0.
        """
        # For either end: the distance, plus the larger of what rows and what columns between cost.
        col, row = xy.astype(np.int64).T
        row_at, col_at, enter = self.edge_parts(xy)
        bounds = []
        for end, (rows, cols) in ((self.start, self.from_start), (self.goal, self.to_goal)):
            end_row_at, end_col_at, _ = self.edge_parts(end[None])
            by_rows = rows[row] + np.abs(row_at - end_row_at)
            by_cols = cols[col] + np.abs(col_at - end_col_at)
            distance = np.hypot(*(xy - end).T)
            bounds.append(self.per_side * distance + np.maximum(by_rows, by_cols))

        # A path also pays for entering the cell of its end.
        from_start, to_goal = bounds
        goal_col, goal_row = self.goal.astype(np.int64)
        from_start = np.where((xy == self.start).all(axis=1), 0.0, from_start + enter)
        to_goal = np.where(
            (xy == self.goal).all(axis=1), 0.0, to_goal + self.enter[goal_row, goal_col]
        )
        return from_start, to_goal

    def through_cells(self, cells: np.ndarray) -> np.ndarray:
        """Return ``[M]`` the sum of both bounds at the centres of free cells, given as flat numbers."""
        row, col = np.divmod(cells, self.enter.shape[1])
        return np.add(*self.from_start_and_to_goal(np.stack([col, row], axis=1) + 0.5))

    def slack(self) -> float:
        """Return how far that sum can fall from the centre of a cell to anywhere in it."""
        return float(
            np.sqrt(2) * self.per_side
            + max(np.diff(self.row_sum).max(), np.diff(self.col_sum).max())
        )

    def from_start_to_goal(self) -> float:
        """Return the lower bound of any path."""
        return float(self.from_start_and_to_goal(self.start[None])[1][0])

    def edge_parts(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``[N]`` ``row_sum`` and ``col_sum`` at points of free cells, and ``enter`` of their cells."""
        col, row = xy.astype(np.int64).T
        row_at = np.interp(xy[:, 1], np.arange(len(self.row_sum)), self.row_sum)
        col_at = np.interp(xy[:, 0], np.arange(len(self.col_sum)), self.col_sum)
        return row_at, col_at, self.enter[row, col]


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

    Raises:
      InputError: an unknown heuristic.
    """
    one_of("heuristic", heuristic, HEURISTICS)
    # The distance alone, with no map cost.
    num_rows, num_cols = is_reachable.shape
    nothing = np.zeros(num_rows), np.zeros(num_cols)
    bounds = Bounds(
        per_side=float(problem.distance_weight * problem.resolution_m),
        row_sum=np.zeros(num_rows + 1),
        col_sum=np.zeros(num_cols + 1),
        enter=np.zeros(is_reachable.shape),
        from_start=nothing,
        to_goal=nothing,
        start=np.array(problem.start[::-1]) + 0.5,
        goal=np.array(problem.goal[::-1]) + 0.5,
    )
    if heuristic == "euclidean":
        return bounds

    # What the cheapest cell of each row, and of each column, costs more than the cheapest cell of all.
    cheapest = problem.cost[is_reachable].min()
    cost = np.where(is_reachable, problem.cost, np.inf)
    minima = [cost.min(axis=axis) - cheapest for axis in (1, 0)]
    minima = [np.where(np.isfinite(excess), excess, 0.0) for excess in minima]

    if problem.cost_model.kind == "line":
        sides_per_reference = problem.resolution_m / problem.cost_model.reference_length_m
        row_sum, col_sum = (np.append(0.0, np.cumsum(m)) * sides_per_reference for m in minima)
        return bounds._replace(
            per_side=bounds.per_side + cheapest * sides_per_reference,
            row_sum=row_sum,
            col_sum=col_sum,
        )

    # Under `cell`, of the start and of the goal: what rows, and columns, between cost at least.
    ends: list[Any] = [
        tuple(_entered_between(m, index) for m, index in zip(minima, cell, strict=True))
        for cell in (problem.start, problem.goal)
    ]
    return bounds._replace(
        per_side=bounds.per_side + cheapest / DIAGONAL_SIDES,
        enter=np.where(is_reachable, problem.cost - cheapest, 0.0),
        from_start=ends[0],
        to_goal=ends[1],
    )


def _entered_between(minima: np.ndarray, end: int) -> np.ndarray:
    """Return ``[N]`` the least map cost of the rows that a path enters strictly between each row and row ``end``.

    A step leaps one row at most, so of two neighbouring rows at least one is entered. Only ways that come nearer to
    ``end`` with each row need to be looked at: of any other way, the rows where it comes nearer than before are such a
    way, and cost no more. The same holds for columns.

    Args:
      minima: ``[N]`` least cost of entering each row.
      end: number of the row at which the path ends (or begins).
    """
    between = np.zeros(len(minima))
    for step in (1, -1):
        # Rows next to the end have none between; one row between may be leapt.
        for row in range(end + 3 * step, len(minima) if step > 0 else -1, step):
            near = row - step
            next_near = row - 2 * step
            between[row] = min(minima[near] + between[near], minima[next_near] + between[next_near])
    return between


def reachable_cells(problem: Problem) -> np.ndarray:
    """Return ``[Y, X]`` bool the cells that paths off the grid from the start may cross; without a way not the goal."""
    islands = problem.islands
    return np.asarray(islands == islands[problem.start])


def cost_grid_of(problem: Problem, is_reachable: np.ndarray) -> CostGrid:
    """Return the map as segments see it, in cell sides: closed outside the cells that paths may cross.

    Args:
      problem: the query.
      is_reachable: ``[Y, X]`` bool, the cells that paths may cross.
    """
    is_line = problem.cost_model.kind == "line"
    # Under `line` a cell's cost is per reference length, under `cell` per state.
    per_side = problem.resolution_m / problem.cost_model.reference_length_m if is_line else 1.0
    return CostGrid(
        cell_cost=np.where(is_reachable, problem.cost * per_side, np.inf),
        per_side=float(problem.distance_weight * problem.resolution_m),
        is_line=is_line,
        passes_corners=problem.cost_model.passes_corners,
        margin=problem.leg_margin_m / problem.resolution_m,
    )


class InformedSet:
    """The points of reachable cells through which a cheaper path may lead; it shrinks as paths get cheaper.

    Attributes:
      bounds: the lower bounds that say where a cheaper path may lead.
      is_reachable: ``[Y, X]`` bool cells that paths may cross.
      cells: ``[M]`` flat numbers of the cells that hold points of the set.
      incumbent: cost of the best path, inf without one.
      measure: area of the set, in cells: the number of cells whose centre lies in it, at most the ellipse's area.
    """

    def __init__(self, bounds: Bounds, is_reachable: np.ndarray) -> None:
        """Begin with the whole of the cells ``[Y, X]`` that paths may cross, and no incumbent."""
        self.bounds = bounds
        self.is_reachable = is_reachable
        self.cells = np.flatnonzero(is_reachable)
        self.incumbent = np.inf
        self.measure = float(self.cells.size)
        # [M] lower bound of paths through the cells' centres, given an incumbent.
        self._through = np.empty(0)

    def shrink(self, incumbent: float) -> None:
        """Leave out cells that cannot hold a path cheaper than the incumbent; nothing changes if it is no lower.

        Alters ``cells``, ``incumbent`` and ``measure``.
        """
        if not incumbent < self.incumbent:
            return
        if self.incumbent == np.inf:
            self._through = self.bounds.through_cells(self.cells)

        # A cell may hold such a point though its centre is none: by up to `slack`.
        self.incumbent = incumbent
        may_hold = self._through < incumbent + self.bounds.slack()
        if not may_hold.all():
            self.cells = self.cells[may_hold]
            self._through = self._through[may_hold]

        num_cells = float(np.count_nonzero(self._through < incumbent))
        self.measure = min(max(num_cells, 1.0), self._ellipse()[2])

    def _ellipse(self) -> tuple[float, float, float]:
        """Return half the major axis, half the minor axis and the area of the ellipse of the distance bound.

        It holds all points through which a path no longer than the incumbent allows can lead, its foci being start and
        goal. Lengths are in cell sides; all three are inf without an incumbent, or where distance costs nothing.
        """
        if self.bounds.per_side == 0 or self.incumbent == np.inf:
            return np.inf, np.inf, np.inf
        major = 0.5 * self.incumbent / self.bounds.per_side
        focal = 0.5 * np.hypot(*(self.bounds.goal - self.bounds.start))
        minor = np.sqrt(max((major - focal) * (major + focal), 0.0))
        return major, minor, np.pi * major * minor

    def sample(self, num_samples: int, rng: np.random.Generator) -> np.ndarray:
        """Return ``[N, 2]`` x, y of random points spread evenly over the set, in cell sides.

        Points are drawn in the ellipse or in the cells, whichever has the smaller area, and kept where their bound is
        below the incumbent. N is below ``num_samples`` if `MAX_ROUNDS` draws do not give as many.
        """
        major, minor, area = self._ellipse()
        kept = [np.empty((0, 2))]
        num_kept = 0
        for _ in range(MAX_ROUNDS if self.cells.size else 0):
            if num_kept >= num_samples:
                break
            num_points = max(64, 2 * (num_samples - num_kept))
            if area < self.cells.size:
                xy = self._in_ellipse(num_points, major, minor, rng)
            else:
                xy = self._in_cells(num_points, rng)
            if self.incumbent < np.inf and len(xy):
                xy = xy[np.add(*self.bounds.from_start_and_to_goal(xy)) < self.incumbent]
            kept.append(xy)
            num_kept += len(xy)
        return np.concatenate(kept)[:num_samples]

    def _in_cells(self, num_points: int, rng: np.random.Generator) -> np.ndarray:
        """Return ``[N, 2]`` random points of the set's cells, off the cells' borders."""
        row, col = np.divmod(
            self.cells[rng.integers(self.cells.size, size=num_points)], self.is_reachable.shape[1]
        )
        return np.stack([col, row], axis=1) + rng.uniform(
            OFF_BORDER, 1 - OFF_BORDER, (num_points, 2)
        )

    def _in_ellipse(
        self, num_points: int, major: float, minor: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Draw random points of the ellipse, and return ``[N, 2]`` the points that lie in reachable cells.

        Args:
          num_points: how many are drawn.
          major, minor: half of the ellipse's axes, in cell sides.
          rng: random numbers.
        """
        # Uniform in the unit disc (hence the root), then stretched along and across the line from start to goal.
        radius = np.sqrt(rng.random(num_points))
        angle = rng.uniform(0, 2 * np.pi, num_points)
        along = major * radius * np.cos(angle)
        across = minor * radius * np.sin(angle)
        start, goal = self.bounds.start, self.bounds.goal
        length = np.hypot(*(goal - start))
        unit = (goal - start) / length if length > 0 else np.array([1.0, 0.0])
        xy = (
            0.5 * (start + goal)
            + along[:, None] * unit
            + across[:, None] * np.array([-unit[1], unit[0]])
        )

        # Off the borders of cells, and only in reachable cells of the map.
        cell = np.floor(xy)
        xy = cell + np.clip(xy - cell, OFF_BORDER, 1 - OFF_BORDER)
        is_inside = ((cell >= 0) & (cell < self.is_reachable.shape[::-1])).all(axis=1)
        col, row = cell[is_inside].astype(np.int64).T
        is_inside[is_inside] = self.is_reachable[row, col]
        return xy[is_inside]


def graph_radius(num_nodes: int, measure: float, eta: float) -> float:
    """Return the radius of the random geometric graph, in cell sides (Gammell et al. 2015, eq. for r(q); 2-D).

    Above ``eta`` = 1 the graph holds paths that come ever nearer to the optimum as the number of nodes grows.

    Args:
      num_nodes: of the graph; below 2 the radius is inf.
      measure: area that the nodes are spread over, in cells.
      eta: factor of the radius.
    """
    if num_nodes < 2:
        return np.inf
    return 2 * eta * np.sqrt(1.5 * measure / np.pi * np.log(num_nodes) / num_nodes)
