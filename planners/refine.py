"""Refinement of any path off the grid: it is shortcut between points along it, and its waypoints are moved.

In compiled parts points are x, y in cell sides from the map's southwest corner, inside it.
"""

import time
from dataclasses import replace

import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.segment_cost import CostGrid, segment_cost
from jaxurban.kernels.search.heap import NO_PARENT
from jaxurban.kernels.tolerances import CHEAPER, INSIDE, SAME_COST
from jaxurban.planners.base import EVERY_PATH, Path, Problem, Status, way_to
from jaxurban.planners.bitstar.bounds import cost_grid_of, make_bounds, reachable_cells
from jaxurban.planners.compiled_first import compiled_first

# Cell sides that waypoints keep from borders, lest rounding puts them in the cell beyond.
MARGIN = 1e-6
GROW, SHRINK = 1.5, 0.5  # of a waypoint's step, where it helped and where it did not
# Cell sides between the points that shortcuts join; 0.7 loses 0.04 %, 0.34 gains 0.01 %.
SPACING = 0.4
LONGEST = 8  # cell sides that a segment may grow to
# Cell sides between waypoints, one level after the other: long bends first.
SPACINGS = (LONGEST, 4, 2, 1)
ROUNDS = 20  # moves of every waypoint on a level
# Cell sides: a waypoint's step when a level begins, and where it ends.
FIRST_STEP, LAST_STEP = 1.0, 1e-3
REACH = 64  # points that a shortcut may span: 128 gains less than 0.001 % (both on Lower Manhattan)


@compiled_first()
def refine(problem: Problem, path: Path, /, *, budget_s: float = np.inf) -> Path:
    """Return the path with its waypoints moved to where it costs less under the ``line`` model; its ends stay.

    Level by level the path is subdivided, more finely each time, and shortcut again. On each level waypoints move
    along the directions of the grid and of their segments (a compass search, which follows the kinks that cell borders
    and corners of obstacles give the exact cost), by steps that grow and shrink. A move is made only where it lowers
    the exact cost of the two segments that it changes: the path stays free and never gets costlier. If the result is
    not cheaper, the path itself comes back, with a note.

    The status is OPTIMAL where the cost meets a lower bound of every curve (`bitstar.bounds`, with map costs),
    BUDGET_FEASIBLE where the path's status was that or the budget ended before the last level, else FEASIBLE. The
    result is deterministic. The time of the search and that of the refinement, without compilation, are added up.

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
    cost_before = problem.checked_cost(path.points_m)

    # The map, of which only what the start is joined to counts, and the waypoints in cell sides.
    begin_s = time.perf_counter()
    end_s = begin_s + budget_s
    is_reachable = reachable_cells(problem)
    cost_grid = cost_grid_of(problem, is_reachable)
    # A point on the map's outer border belongs to no cell.
    xy = np.minimum(
        path.points_m / problem.resolution_m, np.array(problem.is_free.shape[::-1]) * INSIDE
    )

    # Level by level, the cheapest path so far is subdivided, moved (in place) and shortcut.
    best_cost = cost_before
    points_m = path.points_m
    is_spent = False
    for spacing in SPACINGS:
        moved, _ = subdivided(xy, spacing)
        _move(cost_grid, moved, end_s)
        moved = shortcut_line(cost_grid, moved)
        moved_m = moved * problem.resolution_m
        moved_m[[0, -1]] = path.points_m[[0, -1]]  # the ends to the last bit
        cost = problem.cost_of(moved_m)
        if cost < best_cost:
            xy, points_m, best_cost = moved, moved_m, cost
        is_spent = time.perf_counter() >= end_s
        if is_spent:
            break

    # The path itself, where no cheaper one came of it.
    begin_s -= path.elapsed_s  # so that the search's time counts too
    if not best_cost < cost_before * CHEAPER:
        note = f"{path.note} Refinement found nothing cheaper.".lstrip()
        return replace(path, elapsed_s=time.perf_counter() - begin_s, note=note)

    # Else the new path, whose bound holds for paths of every kind, as a grid planner's own bound does not.
    note = f"Refinement lowered what the search minimises by {1 - best_cost / cost_before:.2%}."
    ran = path.ran | {"graph": EVERY_PATH, "note": f"{path.note} {note}".lstrip()}
    is_spent = is_spent or path.status is Status.BUDGET_FEASIBLE
    status = Status.BUDGET_FEASIBLE if is_spent else Status.FEASIBLE
    lower_bound = make_bounds("plus", problem, is_reachable).from_start_to_goal()
    return Path.of(problem, points_m, status, lower_bound, begin_s, **ran)


def check_line_model(problem: Problem, what: str) -> None:
    """Refuse the ``cell`` cost model, unless only length costs, since then both models agree.

    Args:
      problem: the query.
      what: subject of the error's sentence.

    Raises:
      InputError: the problem's cost model is ``cell``, and its map has costs.
    """
    if not problem.is_by_length:
        raise InputError(
            f"{what} weighs straight segments of any direction by the length in each cell, which is not how "
            "cost_model='cell' counts: choose cost_model='line' (without --preset paper)"
        )


def _compass(xy: np.ndarray) -> list[np.ndarray]:
    """Return directions ``[N, 2]`` along which cost maps have edges: those of cells, and past corners of obstacles."""
    east, north = (np.broadcast_to(axis, xy.shape) for axis in np.eye(2))
    onward = np.diff(xy, axis=0, append=xy[-1:])
    return [east, north, onward, np.roll(onward, 1, axis=0)]


def _move(cost_grid: CostGrid, xy: np.ndarray, end_s: float) -> None:
    """Move the inner waypoints to where the path costs less, in place.

    Each round moves them along every direction of `_compass` in turn. It ends when all steps are small, after `ROUNDS`
    rounds, or when time is up.

    Args:
      cost_grid: the map.
      xy: ``[N, 2]`` waypoints in cell sides; altered.
      end_s: time of `time.perf_counter` at which no further round begins.
    """
    # A step's length for each direction and waypoint, in cell sides.
    steps = [np.full(len(xy), FIRST_STEP) for _ in _compass(xy)]
    for _ in range(ROUNDS):
        if time.perf_counter() >= end_s or max(step.max() for step in steps) < LAST_STEP:
            break
        for direction, step in zip(_compass(xy), steps, strict=True):
            # A direction may be 0.
            length = np.maximum(np.hypot(*direction.T), np.finfo(float).tiny)
            move_points(cost_grid, xy, direction / length[:, None], step, float(LONGEST))


def subdivided(xy: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a polyline with points added evenly so that no segment is longer than a length.

    Args:
      xy: ``[N, 2]`` the polyline.
      longest: length, in the same unit.

    Returns:
      ``[M, 2]`` the points of the new polyline, and ``[M]`` bool which of them were added.
    """
    # For each segment into how many parts it is cut; then for each part its number in its segment.
    num_parts = np.maximum(1, np.ceil(np.hypot(*np.diff(xy, axis=0).T) / longest)).astype(np.int64)
    part = np.arange(num_parts.sum()) - np.repeat(np.cumsum(num_parts) - num_parts, num_parts)
    share = (part / np.repeat(num_parts, num_parts))[:, None]
    begin = np.repeat(np.arange(len(num_parts)), num_parts)
    points = xy[begin] + share * (xy[begin + 1] - xy[begin])
    return np.concatenate([points, xy[-1:]]), np.append(part > 0, False)


def shortcut_line(cost_grid: CostGrid, xy: np.ndarray) -> np.ndarray:
    """Return a polyline shortcut between points along it at their best, with no points that do nothing."""
    points, is_added = subdivided(xy, SPACING)
    # Between points on borders a segment could run along an obstacle's wall.
    is_near_border = (np.abs(points - np.rint(points)) < MARGIN).any(axis=1)
    points = shortcut(cost_grid, points[~(is_added & is_near_border)])
    return shortcut(cost_grid, points)


def shortcut(cost_grid: CostGrid, xy: np.ndarray) -> np.ndarray:
    """Return the cheapest way ``[K, 2]`` through some of the points ``[N, 2]`` in their order, ends included.

    It is the cheapest of all ways whose segments span at most `REACH` points, by dynamic programming; of equally
    cheap ways it is one with long segments. If every way is blocked, the points themselves come back.

    Args:
      cost_grid: the map.
      xy: points in cell sides.
    """
    best = np.full(len(xy), np.inf)
    parent = np.full(len(xy), NO_PARENT)
    best[0] = 0.0
    _weigh_shortcuts(cost_grid, xy, best, parent)
    if best[-1] == np.inf:
        return xy
    return xy[way_to(len(xy) - 1, parent)]


@compiled()
def _weigh_shortcuts(cost_grid, xy, best, parent):
    """Find the cheapest way from the first point to each point, over points before it.

    Args:
      cost_grid, xy: as in `shortcut`.
      best: ``[N]`` costs of these ways: 0 for the first point, inf for all others; filled in place.
      parent: ``[N]`` the point before on each way, NO_PARENT without one; filled in place.
    """
    for k in range(1, len(xy)):
        for j in range(k - 1, max(-1, k - 1 - REACH), -1):
            # A little more than the best so far, so that of equal ways the one with the longest last segment is kept.
            limit = best[k] * SAME_COST - best[j]
            if limit > 0.0:
                cost = best[j] + segment_cost(
                    cost_grid, xy[j, 0], xy[j, 1], xy[k, 0], xy[k, 1], limit
                )
                if cost < np.inf:
                    best[k], parent[k] = cost, j


@compiled()
def _is_near_border(x, y):
    return min(x % 1.0, y % 1.0) < MARGIN or max(x % 1.0, y % 1.0) > 1.0 - MARGIN


@compiled()
def move_points(cost_grid, xy, direction, step, longest):
    """Move each inner point by its step along its direction, or against it, where that makes its two segments cheaper.

    Point after point is moved, at the exact cost of its segments to where its neighbours stand by then: the path
    never gets costlier, nor blocked. Steps grow where they helped and shrink where they did not. Points stay
    on the map and off the borders of cells, and no segment grows longer than ``longest``.

    Args:
      cost_grid: `CostGrid`, the map.
      xy: ``[N, 2]`` points in cell sides; altered. The ends stay.
      direction: ``[N, 2]`` unit vectors.
      step: ``[N]`` lengths of the steps in cell sides; altered.
      longest: in cell sides.
    """
    num_rows, num_cols = cost_grid.cell_cost.shape
    for k in range(1, len(xy) - 1):
        x0, y0 = xy[k - 1]
        x1, y1 = xy[k]
        x2, y2 = xy[k + 1]
        cost = segment_cost(cost_grid, x0, y0, x1, y1, np.inf) + segment_cost(
            cost_grid, x1, y1, x2, y2, np.inf
        )

        # Try the step along the direction, then against it; the first that helps is kept.
        factor = SHRINK
        for sign in (1.0, -1.0):
            x = x1 + sign * step[k] * direction[k, 0]
            y = y1 + sign * step[k] * direction[k, 1]
            if not (0.0 <= x < num_cols and 0.0 <= y < num_rows) or _is_near_border(x, y):
                continue
            if max(np.hypot(x - x0, y - y0), np.hypot(x - x2, y - y2)) > longest:
                continue
            first = segment_cost(cost_grid, x0, y0, x, y, cost)
            if (
                first < cost
                and first + segment_cost(cost_grid, x, y, x2, y2, cost - first) < cost * CHEAPER
            ):
                xy[k, 0], xy[k, 1] = x, y
                factor = GROW
                break
        step[k] *= factor
