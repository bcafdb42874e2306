"""Refinement of any planner's path: waypoints moved by a compass search, never into an obstacle or to a higher cost."""

import time
from dataclasses import replace

import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.planners.any_angle import TIE, check_line_model, move_points, shortened, subdivided
from jaxurban.planners.base import EVERY_PATH, Path, Problem, Status
from jaxurban.planners.bitstar.bounds import cost_grid_of, make_bounds
from jaxurban.planners.compiled_first import compiled_first

LONGEST = 8  # cell sides that a segment may grow to
SPACINGS = (LONGEST, 4, 2, 1)  # cell sides between waypoints, one level after the other: long bends first
ROUNDS = 20  # moves of every waypoint on a level
FIRST_STEP, LAST_STEP = 1.0, 1e-3  # cell sides: a waypoint's step when a level begins, and where it ends


@compiled_first()
def refine(problem: Problem, path: Path, *, budget_s: float = np.inf) -> Path:
    """Return the path with its waypoints moved to where it costs less under the ``line`` model; its ends stay.

    Level by level the path is subdivided, more finely each time, and cut short again. On each level
    waypoints move along the directions of the grid and of their segments (a compass search, which finds its way along
    the kinks that cell borders and corners of obstacles give the exact cost), by steps that grow and shrink. Each
    single move is made only where it lowers the exact cost of the two segments that it changes, so the path stays free
    and never gets costlier. Where the whole does not end up cheaper the path itself comes back, with a note.

    The status is that of a path off the grid: OPTIMAL where the cost meets a lower bound of every curve,
    BUDGET_FEASIBLE where the path had it or the budget ended before the last level, else FEASIBLE. The
    lower bound is that of every curve too (`bitstar.bounds`, with map costs). Deterministic. The search's
    time and the refinement's, without compilation, are added up.

    Args:
      problem: the query, under the ``line`` cost model, or under any where only length costs.
      path: what a planner returned for it; where there is no path it comes back as it is.
      budget_s: seconds of refinement.

    Raises:
      InputError: the ``cell`` cost model with map costs, or a path that is blocked or off the map.
    """
    check_line_model(problem, "refinement")
    if not path.status.has_path:
        return path
    before = problem.cost_of(path.points_m)
    if before == np.inf:
        raise InputError(
            "the path crosses an obstacle, passes between two that touch at a corner, or leaves the map: give one "
            "that was planned for this problem"
        )
    begin_s = time.perf_counter()
    end_s = begin_s + budget_s
    islands = problem.islands
    is_reachable = islands == islands[problem.start]
    cost_grid = cost_grid_of(problem, is_reachable)
    # A point on the map's outer border belongs to no cell.
    xy = np.minimum(path.points_m / problem.resolution_m, np.array(problem.is_free.shape[::-1]) * (1 - TIE))
    best, points_m, is_spent = before, path.points_m, False
    for spacing in SPACINGS:
        moved = subdivided(xy, spacing)
        _move(cost_grid, moved, end_s)
        moved = shortened(cost_grid, moved)
        moved_m = moved * problem.resolution_m
        moved_m[[0, -1]] = path.points_m[[0, -1]]
        cost = problem.cost_of(moved_m)
        if cost < best:
            xy, points_m, best = moved, moved_m, cost
        is_spent = time.perf_counter() >= end_s
        if is_spent:
            break
    begin_s -= path.elapsed_s
    if not best < before * (1 - TIE):
        note = " ".join(filter(None, (path.note, "Refinement found nothing cheaper.")))
        return replace(path, elapsed_s=time.perf_counter() - begin_s, note=note)
    note = f"Refinement lowered what the search minimises by {1 - best / before:.2%}."
    ran = path.ran | {"graph": EVERY_PATH, "note": " ".join(filter(None, (path.note, note)))}
    status = Status.BUDGET_FEASIBLE if is_spent or path.status is Status.BUDGET_FEASIBLE else Status.FEASIBLE
    # A grid planner's own bound holds for grid paths only.
    lower_bound = make_bounds("plus", problem, is_reachable).from_start_to_goal()
    return Path.of(problem, points_m, status, lower_bound, begin_s, **ran)


def _compass(xy: np.ndarray) -> list[np.ndarray]:
    """Return directions ``[N, 2]`` along which cost maps have edges: those of cells, and past corners of obstacles."""
    onward = np.diff(xy, axis=0, append=xy[-1:])
    return [*(np.broadcast_to(axis, xy.shape) for axis in np.eye(2)), onward, np.roll(onward, 1, axis=0)]


def _move(cost_grid: CostGrid, xy: np.ndarray, end_s: float) -> None:
    """Move waypoints, altered in place, round after round, until the steps are small or time is up."""
    steps = [np.full(len(xy), FIRST_STEP) for _ in _compass(xy)]
    for _ in range(ROUNDS):
        if time.perf_counter() >= end_s or max(step.max() for step in steps) < LAST_STEP:
            break
        for direction, step in zip(_compass(xy), steps, strict=True):
            direction = direction / np.maximum(np.hypot(*direction.T), np.finfo(float).tiny)[:, None]
            move_points(cost_grid, xy, direction, step, float(LONGEST))
