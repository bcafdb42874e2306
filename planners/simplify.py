"""Simplification of any planner's path: the fewest straight legs within a tolerance, all clear of closed cells."""

import time
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.clear import is_clear
from jaxurban.planners.any_angle import subdivided
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost_model import positive_m
from jaxurban.planners.search.legs import fewest_legs, nudged

CLEAR_M = 0.02  # that legs keep from closed cells, so that coordinates of 7 decimals of a degree cannot enter them
NUDGES = (1.5, 3.0)  # by how many such distances points may move where the path itself passes nearer
DIRECTIONS = 8
SPACING = 1.0  # cell sides between the points along a path at which it may turn
PART = 0.3  # cell sides: five parts make a diagonal step, whose corner then lies within one of them
SHORT_M = 1.0  # legs shorter than this between two turns are left out where one turn does for both
ALIKE = 0.05  # sine of the angle between legs that run alike


def simplify(problem: Problem, path: Path, tolerance_m: float) -> Path:
    """Return the path with as few waypoints as keep it within a tolerance of where it was, clear of closed cells.

    Waypoints are places along the path, at most a cell apart. Every leg that skips some keeps `CLEAR_M`, or the
    problem's larger margin, from every cell that is not free and from the map's border, so that rounding of a file's
    coordinates takes it into none. Where the path passes nearer, its points are first moved aside, each twice by at
    most three times `CLEAR_M`, or a quarter of the tolerance, where that mends it; what cannot be mended, as a step
    between two obstacles that touch at a corner (``diagonal="always"``), stays as it was planned, and the note says so.
    In a volume the parts on one level are simplified, each on its level's cells; climbs and descents stay. The ends
    stay.

    The cost is that of the new path, which may be above or below the old. The status is that of the path where
    nothing changed, else FEASIBLE (BUDGET_FEASIBLE where the path was). The lower bound stays that of the planner's
    graph, or the cost where that is lower.

    Args:
      problem: the query that the path was planned for.
      path: from a planner; where there is no path it comes back as it is.
      tolerance_m: how far the path may be from where it was, in plan (its altitudes stay), above 0.

    Raises:
      InputError: a tolerance that is not a positive number of metres, or a path that is blocked or off the map.
    """
    tolerance_m = positive_m("tolerance_m", tolerance_m)
    if not path.status.has_path:
        return path
    before = problem.cost_of(path.points_m)
    if before == np.inf:
        raise InputError(
            "the path crosses cells that are not free on this cost map: simplify it on the one that it was planned on"
        )
    _warm_up()
    begin_s = time.perf_counter()
    parts = [path.points_m[:1]]
    num_near = 0
    for level, first, last in _level_parts(problem, path.points_m):
        points_m = path.points_m[first : last + 1]
        if level is not None:
            is_free = problem.is_free if problem.levels_m is None else problem.is_free[level]
            margin = max(CLEAR_M, problem.leg_margin_m) / problem.resolution_m
            xy = _fewest(is_free, points_m[:, :2] / problem.resolution_m, tolerance_m, problem.resolution_m, margin)
            num_near += int(np.sum(~_are_clear(is_free, xy, CLEAR_M / problem.resolution_m)))
            xy_m = xy * problem.resolution_m
            xy_m[[0, -1]] = points_m[[0, -1], :2]
            points_m = np.column_stack([xy_m, np.broadcast_to(points_m[0, 2:], (len(xy_m), points_m.shape[1] - 2))])
        parts.append(points_m[1:])
    points_m = np.concatenate(parts)
    status = path.status
    if points_m.shape == path.points_m.shape and np.allclose(points_m, path.points_m, rtol=0, atol=1e-9):
        points_m = path.points_m
    elif status is Status.OPTIMAL:
        status = Status.FEASIBLE
    cost = problem.cost_of(points_m)
    said = f"{num_near} of its legs pass nearer than {100 * CLEAR_M:g} cm to a closed cell, as the planned path does."
    return replace(
        path,
        status=status,
        points_m=points_m,
        cost=cost,
        lower_bound=min(path.lower_bound, cost),
        elapsed_s=path.elapsed_s + time.perf_counter() - begin_s,
        note=" ".join(filter(None, (path.note, said if num_near else ""))),
    )


def _level_parts(problem: Problem, points_m: np.ndarray) -> list[tuple[int | None, int, int]]:
    """Return the parts of a path: its level (None: it changes), and the first and last point."""
    last = len(points_m) - 1
    if problem.levels_m is None:
        return [(0, 0, last)]
    is_level = np.diff(points_m[:, 2]) == 0
    cuts = [0, *(np.flatnonzero(is_level[1:] != is_level[:-1]) + 1).tolist(), last]
    level = np.searchsorted(problem.levels_m, points_m[:, 2])
    return [(int(level[a]) if is_level[a] else None, a, b) for a, b in pairwise(cuts)] if last else []


def _fewest(is_free: np.ndarray, xy: np.ndarray, tolerance_m: float, side_m: float, margin: float) -> np.ndarray:
    """Return the waypoints ``[W, 2]`` of a path of points ``[N, 2]`` on one level, in cell sides, as the margin is."""
    if len(xy) < 2:
        return xy
    tolerance = tolerance_m / side_m
    rings = np.minimum(np.array(NUDGES) * CLEAR_M / side_m, tolerance / 4)
    turn = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    offsets = np.concatenate([np.zeros((1, 2)), *(ring * around for ring in rings)])
    for divide in (False, True):  # its own points first, and points between them only where that does not do
        is_far = _are_clear(is_free, xy, margin)
        if is_far.all():
            break
        if divide:
            xy = _divided(xy, is_far)
            is_far = _are_clear(is_free, xy, margin)
        is_movable = np.concatenate([[False], ~(is_far[:-1] & is_far[1:]), [False]])
        moved = nudged(is_free, xy, is_movable, offsets, margin)
        tolerance -= float(np.hypot(*(moved - xy).T).max())
        xy = moved
    xy = subdivided(xy, SPACING)
    kept = np.flatnonzero(fewest_legs(is_free, xy, tolerance, margin))
    return _without_short_legs(is_free, xy, kept, tolerance, margin, SHORT_M / side_m)


def _without_short_legs(
    is_free: np.ndarray, xy: np.ndarray, kept: np.ndarray, tolerance: float, margin: float, short: float
) -> np.ndarray:
    """Return the points kept ``[W, 2]``, two that a short leg joins replaced by one where that stays clear and near.

    Where the legs before and after meet, or at one of the two, or in their middle.
    """
    points, at = [xy[k] for k in kept], kept.tolist()
    k = 1
    while k < len(points) - 2:
        before, here, there, after = points[k - 1 : k + 3]
        first, last = max(k - 2, 0), min(k + 3, len(points) - 1)
        middles = [_crossing(before, here, there, after), (here + there) / 2, here, there]
        for middle in middles if np.hypot(*(there - here)) < short else ():
            way = np.array([*points[first:k], middle, *points[k + 2 : last + 1]])
            was = xy[at[first] : at[last] + 1]
            if (
                is_clear(is_free, *before, *middle, margin)
                and is_clear(is_free, *middle, *after, margin)
                and _farthest(was, way) <= tolerance
                and _farthest(middle[None], was) <= tolerance
            ):
                points[k : k + 2], at[k : k + 2] = [middle], [at[k]]
                break
        else:
            k += 1
    return np.array(points)


def _crossing(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return where the lines through two legs meet; their middle where they run alike."""
    (u_x, u_y), (v_x, v_y), (w_x, w_y) = b - a, c - d, d - a
    turn = u_x * v_y - u_y * v_x
    if abs(turn) < ALIKE * np.hypot(u_x, u_y) * np.hypot(v_x, v_y):
        return (b + c) / 2
    return a + (b - a) * ((w_x * v_y - w_y * v_x) / turn)


def _farthest(xy: np.ndarray, way: np.ndarray) -> float:
    """Return how far points ``[N, 2]`` are at most from a polyline ``[W, 2]``."""
    along, from_start = np.diff(way, axis=0), xy[:, None] - way[:-1]
    squares = np.maximum((along**2).sum(axis=-1), np.finfo(float).tiny)
    share = np.clip((from_start * along).sum(axis=-1) / squares, 0.0, 1.0)
    away = from_start - share[..., None] * along
    return float(np.hypot(away[..., 0], away[..., 1]).min(axis=1).max())


def _are_clear(is_free: np.ndarray, xy: np.ndarray, margin: float) -> np.ndarray:
    """Return ``[N - 1]`` bool: which legs between points ``[N, 2]`` in cell sides keep a margin from closed cells."""
    return np.array([is_clear(is_free, *here, *there, margin) for here, there in pairwise(xy.tolist())], bool)


def _divided(xy: np.ndarray, is_far: np.ndarray) -> np.ndarray:
    """Return the points with others along the legs that are not clear, `PART` apart."""
    parts = [xy[k : k + 1] if is_far[k] else subdivided(xy[k : k + 2], PART)[:-1] for k in range(len(is_far))]
    return np.concatenate([*parts, xy[-1:]])


@cache
def _warm_up() -> None:
    """Compile what a simplification runs, so that its time is its own."""
    is_free = np.ones((1, 4), bool)
    is_free.flags.writeable = False  # as a problem's are: another type to the compiler
    _fewest(is_free, np.array([[0.5, 0.5], [1.5, 0.999], [2.5, 0.5]]), 0.5, 1.0, CLEAR_M)
