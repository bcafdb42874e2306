"""A lower bound of all paths at any angle, by paths along sides and diagonals of cells."""

from dataclasses import replace

import numpy as np

from jaxurban.kernels.search.bounds import costs_at_corners
from jaxurban.kernels.tolerances import SAME_COST
from jaxurban.planners.base import EVERY_PATH, Path, Problem, Status

# Of the cheapest path along sides and diagonals of cells over the cheapest curve.
STRETCH = 2 / np.sqrt(2 + np.sqrt(2))


def corner_bound(problem: Problem) -> float:
    """Return a lower bound of the cost of any curve between a problem's ends under the ``line`` model.

    The cheapest path along sides (at the cheaper of their two cells) and diagonals of free cells costs at most
    `STRETCH` times the cheapest curve (Bose, Esteban, Orden & Silveira 2024, square meshes). So the cost of such a path
    between corners of the start's and the goal's cell, divided by `STRETCH`, plus half a side in each of these two
    cells, is a lower bound between their centres. Passing between two closed cells at a corner counts as allowed.

    The cheapest path between centres of neighbouring cells proves no such bound: beside a closed cell a curve may round
    a corner in half the diagonal step, where the grid takes two straight ones.

    Args:
      problem: on one altitude, its ends in two cells.

    Returns:
      The bound; inf where no such path joins the ends.
    """
    # Cost of a cell's side; here each cell is a tile of its own.
    per_side = problem.resolution_m * (
        problem.distance_weight + problem.cost / problem.cost_model.reference_length_m
    )
    framed = np.pad(np.where(problem.is_free, per_side, np.inf), 1, constant_values=np.inf)
    start, goal = problem.start, problem.goal
    corners, is_joined = costs_at_corners(framed, (0.0, 1.0), (0.0, np.sqrt(2)), goal, start)
    if not is_joined:
        return np.inf
    # Costs begin at the corners of the start's cell; the least one at the goal's four corners counts.
    between = corners[goal[0] : goal[0] + 2, goal[1] : goal[1] + 2].min()
    return float(between / STRETCH + (per_side[start] + per_side[goal]) / 2)


def with_corner_bound(problem: Problem, path: Path) -> Path:
    """Return a path at any angle with the higher of its planner's lower bound and `corner_bound`.

    The status becomes OPTIMAL where the cost of such a path meets the bound. The corner bound is kept with the map for
    other planners of the same query. Nothing changes without a path, for a path of the grid, for one that meets its
    bound already, and under the ``cell`` model with map costs, where the bound does not hold.

    Args:
      problem: the query that was planned.
      path: what a planner returned for it.
    """
    if (
        path.graph == problem.grid_name
        or not problem.is_by_length
        or path.gap == 0
        or not path.status.has_path
    ):
        return path
    bounds = problem.cache.corner_bounds
    ends = problem.start, problem.goal
    if ends not in bounds:
        bounds[ends] = corner_bound(problem)
    bound = max(path.lower_bound, bounds[ends])
    is_best = path.graph == EVERY_PATH and path.cost <= bound * SAME_COST
    return replace(
        path, lower_bound=min(bound, path.cost), status=Status.OPTIMAL if is_best else path.status
    )
