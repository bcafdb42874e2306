"""Simplification of any planner's path: the fewest straight legs within a tolerance, all clear of closed cells."""

import time

import numpy as np

from jaxurban.checks import positive
from jaxurban.kernels.compiled import compiled, host_array
from jaxurban.kernels.line.segment_cost import are_clear, is_clear
from jaxurban.kernels.search.heap import NO_PARENT
from jaxurban.planners.base import Path, Problem, Status, way_to
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.cost import level_parts
from jaxurban.planners.refine import subdivided

CLEAR_M = 0.02  # that legs keep from closed cells, so that coordinates of 7 decimals of a degree cannot enter them
# By how many such distances points may move where the path itself passes nearer.
NUDGES = (1.5, 3.0)
DIRECTIONS = 8
SPACING = 1.0  # cell sides between the points along a path at which it may turn
PART = 0.3  # cell sides: five parts make a diagonal step, whose corner then lies within one of them
STRAIGHT = 1e-9  # cell sides: points so near a leg lie on it
STUCK = 1e9  # what a leg that is not clear counts among nudges, so that there are as few as can be
REACH = 256  # points that a leg may span, lest a way over open land of thousands takes seconds
AHEAD = 1e-12  # relative: sums this much smaller are smaller


@compiled_first()
def simplify_path(
    problem: Problem, path: Path, tolerance_m: float, beside_m: float = 0.0, /
) -> Path:
    """Return the path with as few waypoints as keep it within a tolerance of where it was, clear of closed cells.

    Waypoints are chosen from places along the path, at most a cell apart. Every leg that skips some of these keeps
    `CLEAR_M`, or the problem's larger margin, from every cell that is not free and from the map's border, so that
    rounding of a file's coordinates takes it into no such cell. Where the path passes nearer, its points are first
    moved aside, at most twice, each time by at most three times `CLEAR_M` or a quarter of the tolerance. Legs that this
    does not clear, such as a step between two obstacles that touch at a corner (``diagonal="always"``), stay as they
    were planned, and the note says so. In a volume the parts on one level are simplified, each on its level's cells;
    climbs and descents stay. The ends stay.

    The cost is that of the new path, which may be above or below the old one. The status stays where nothing changed;
    otherwise OPTIMAL becomes FEASIBLE. The lower bound stays that of the planner's graph, or the cost where that is
    lower.

    Args:
      problem: the query that the path was planned for.
      path: from a planner; where there is no path it comes back as it is.
      tolerance_m: how far the path may be from where it was, in plan (its altitudes stay), above 0.
      beside_m: how far legs that leave the path stay from cells that are not free.

    Raises:
      InputError: a tolerance that is not a positive number of metres, or a path that is blocked or off the map.
    """
    tolerance_m = positive("tolerance_m", tolerance_m, "metres")
    if not path.status.has_path:
        return path
    problem.checked_cost(path.points_m)
    begin_s = time.perf_counter()

    # Simplify part by part, and put parts together, each without its first point, which ends the part before. Parts
    # that change the level stay.
    parts = [path.points_m[:1]]
    num_near = 0  # legs that pass nearer than `CLEAR_M`
    for level, first, last in level_parts(problem, path.points_m):
        points_m = path.points_m[first : last + 1]
        if level is not None:
            is_free = problem.is_free if problem.levels_m is None else problem.is_free[level]
            margin = max(CLEAR_M, problem.leg_margin_m) / problem.resolution_m
            xy = _fewest(
                is_free,
                points_m[:, :2] / problem.resolution_m,
                tolerance_m,
                problem.resolution_m,
                margin,
                beside_m / problem.resolution_m,
            )
            num_near += int(np.sum(~are_clear(is_free, xy, CLEAR_M / problem.resolution_m)))
            xy_m = xy * problem.resolution_m
            xy_m[[0, -1]] = points_m[[0, -1], :2]  # the ends to the last bit
            altitude_m = np.repeat(points_m[:1, 2:], len(xy_m), axis=0)
            points_m = np.column_stack([xy_m, altitude_m])
        parts.append(points_m[1:])
    points_m = np.concatenate(parts)

    # A path that has not changed keeps its status.
    status = path.status
    is_same_shape = points_m.shape == path.points_m.shape
    if is_same_shape and np.allclose(points_m, path.points_m, rtol=0, atol=1e-9):
        points_m = path.points_m
    elif status is Status.OPTIMAL:
        status = Status.FEASIBLE

    note = path.note
    if num_near:
        near = f"{num_near} of its legs pass nearer than {100 * CLEAR_M:g} cm to a closed cell"
        note = f"{note} {near}, as the planned path does.".lstrip()
    ran = path.ran | {"note": note}
    return Path.of(problem, points_m, status, path.lower_bound, begin_s - path.elapsed_s, **ran)


def _fewest(
    is_free: np.ndarray,
    xy: np.ndarray,
    tolerance_m: float,
    side_m: float,
    margin: float,
    beside: float,
) -> np.ndarray:
    """Return the waypoints ``[W, 2]`` of a simplified path on one level, in cell sides.

    Args:
      is_free: ``[Y, X]`` bool.
      xy: ``[N, 2]`` points of the path, in cell sides; a single point comes back.
      tolerance_m: how far the path may be from where it was, in metres.
      side_m: side of a cell, in metres.
      margin: that legs keep from closed cells, in cell sides.
      beside: that legs which leave the path keep from them, in cell sides; the margin where that is more.
    """
    if len(xy) < 2:
        return xy

    # By how much points may move: not at all, or in `DIRECTIONS` directions by each distance of `NUDGES`.
    is_free = host_array(is_free)
    tolerance = tolerance_m / side_m
    rings = np.minimum(np.array(NUDGES) * CLEAR_M / side_m, tolerance / 4)
    turn = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    offsets = np.concatenate([np.zeros((1, 2)), *(ring * around for ring in rings)])

    # Move points until all legs are clear: first the path's own points, then, only if that is not enough, points
    # between them too. Every move takes its length off the tolerance.
    for divide in (False, True):
        is_far = are_clear(is_free, xy, margin)
        if is_far.all():
            break
        if divide:
            xy = _divided(xy, is_far)
            is_far = are_clear(is_free, xy, margin)
        # Points may move if a leg on either side is not clear; the ends stay.
        is_movable = np.concatenate([[False], ~(is_far[:-1] & is_far[1:]), [False]])
        moved = xy + offsets[nudges(is_free, xy, is_movable, offsets, margin)]
        tolerance -= float(np.hypot(*(moved - xy).T).max())
        xy = moved

    xy, _ = subdivided(xy, SPACING)
    return np.asarray(xy[fewest_legs(is_free, xy, tolerance, margin, beside)])


def _divided(xy: np.ndarray, is_far: np.ndarray) -> np.ndarray:
    """Return the points ``[N, 2]`` with others between them, `PART` apart, along each leg that is not clear.

    Args:
      xy: the points, in cell sides.
      is_far: ``[N - 1]`` whether each leg is clear.
    """
    parts = []
    for k in range(len(is_far)):
        part = xy[k : k + 2]
        if not is_far[k]:
            part, _ = subdivided(part, PART)
        parts.append(part[:-1])
    return np.concatenate([*parts, xy[-1:]])


def nudges(
    is_free: np.ndarray,
    xy: np.ndarray,
    is_movable: np.ndarray,
    offsets: np.ndarray,
    margin: float,
) -> np.ndarray:
    """Return ``[N]`` the number of the offset by which each point moves, so that as few legs as possible are not clear.

    Legs that remain unclear stay where they are: if a leg through the corner of two closed cells moved, it would enter
    one of them. Of all such choices this is the one whose points move the least in sum, by dynamic programming over the
    offsets of each point.

    Args:
      is_free: ``[Y, X]`` bool.
      xy: ``[N, 2]`` points, in cell sides.
      is_movable: ``[N]`` bool; other points stay. The first point must not be movable.
      offsets: ``[C, 2]`` in cell sides; the first is 0, 0.
      margin: see `is_clear`.
    """
    best = np.full((len(xy), len(offsets)), np.inf)
    parent = np.zeros(best.shape, np.int64)
    best[0, 0] = 0.0
    _weigh_nudges(is_free, xy, is_movable, offsets, margin, best, parent)

    # From the last point back.
    chosen = [int(np.argmin(best[-1]))]
    for parents in parent[:0:-1]:
        chosen.append(parents[chosen[-1]])
    return np.array(chosen[::-1])


@compiled()
def _weigh_nudges(is_free, xy, is_movable, offsets, margin, best, parent):
    """Find the best choice of offsets up to each point, for each offset of that point.

    Args:
      is_free, xy, is_movable, offsets, margin: as in `nudges`.
      best: ``[N, C]`` sum of the moves, plus `STUCK` for each leg that is not clear; 0 for the first point's first
        offset, inf for all else; filled in place.
      parent: ``[N, C]`` offset of the point before, in that choice; filled in place.
    """
    num, num_offsets = best.shape
    for k in range(1, num):
        for c in range(num_offsets if is_movable[k] else 1):
            x, y = xy[k, 0] + offsets[c, 0], xy[k, 1] + offsets[c, 1]
            moved = np.hypot(offsets[c, 0], offsets[c, 1])
            for p in range(num_offsets if is_movable[k - 1] else 1):
                reach = best[k - 1, p] + moved
                if reach >= best[k, c]:
                    continue
                from_x = xy[k - 1, 0] + offsets[p, 0]
                from_y = xy[k - 1, 1] + offsets[p, 1]
                if not is_clear(is_free, from_x, from_y, x, y, margin):
                    # A leg that is not clear may only stay.
                    reach = reach + STUCK if c == p == 0 else np.inf
                if reach < best[k, c]:
                    best[k, c], parent[k, c] = reach, p


@compiled()
def is_within(xy, first, last, tolerance):
    """Return whether the points between two points lie within a tolerance of the segment that joins the two.

    Args:
      xy: ``[N, 2]`` points.
      first, last: numbers of the two.
      tolerance: in the unit of the points.
    """
    (x0, y0), (x1, y1) = xy[first], xy[last]
    dx, dy = x1 - x0, y1 - y0
    length = np.hypot(dx, dy)
    for k in range(first + 1, last):
        x, y = xy[k, 0] - x0, xy[k, 1] - y0
        share = 0.0  # of the segment, at the place nearest to the point
        if length > 0.0:
            share = min(max((x * dx + y * dy) / (length * length), 0.0), 1.0)
        if np.hypot(x - share * dx, y - share * dy) > tolerance:
            return False
    return True


def fewest_legs(
    is_free: np.ndarray, xy: np.ndarray, tolerance: float, margin: float, beside: float = 0.0
) -> np.ndarray:
    """Return ``[K]`` the numbers of the points to keep, ends included: the fewest legs, as even as possible.

    Of all ways with the fewest legs it is the one with the least sum of squared lengths, so that no leg is shorter than
    necessary.

    A leg may skip up to `REACH` points if it is clear (`is_clear`) and they lie within the tolerance of it; where it is
    nearer to closed cells than ``beside``, they must lie on it. From one point to the next a leg is always allowed, as
    the path leads there. Every two points that an allowed leg joins are an edge of a graph, and the shortest way
    through the graph is the answer (Imai & Iri 1988, "Polygonal approximations of a curve"). From each point the cone
    of directions that pass all points since within the tolerance says when to stop looking farther (Chan & Chin 1996,
    "Approximation of polygonal curves with minimum number of line segments or minimum error").

    Args:
      is_free: ``[Y, X]`` bool.
      xy: ``[N, 2]`` points of the path, in cell sides.
      tolerance, margin, beside: in cell sides, as in `_fewest`.
    """
    num = len(xy)
    legs = np.full(num, num)
    squares = np.full(num, np.inf)
    parent = np.full(num, NO_PARENT)
    legs[0], squares[0] = 0, 0.0
    _weigh_legs(is_free, xy, tolerance, margin, beside, legs, squares, parent)
    return np.array(way_to(num - 1, parent))


@compiled()
def _weigh_legs(is_free, xy, tolerance, margin, beside, legs, squares, parent):
    """Find the way of fewest legs from the first point to each point, and of these the most even one.

    Args:
      is_free, xy, tolerance, margin, beside: as in `fewest_legs`.
      legs: ``[N]`` number of legs on that way; 0 for the first point, N for all others; filled in place.
      squares: ``[N]`` sum of their squared lengths; 0 for the first point, inf for all others; filled in place.
      parent: ``[N]`` the point before on that way; filled in place.
    """
    num = len(xy)
    for i in range(num - 1):
        # The cone of directions from point i, from `low` to `high` around the heading `axis`; no bound until a point
        # lies beyond the tolerance.
        axis = 0.0
        low = -np.inf
        high = np.inf
        farthest = 0.0  # distance of the points so far
        for j in range(i + 1, min(num, i + 1 + REACH)):
            (x0, y0), (x1, y1) = xy[i], xy[j]
            away = np.hypot(x1 - x0, y1 - y0)
            heading = np.arctan2(y1 - y0, x1 - x0)
            axis = heading if low == -np.inf else axis
            turn = (heading - axis + np.pi) % (2 * np.pi) - np.pi  # from -pi to pi

            # A leg to point j that has fewer legs before it, or as many and a smaller sum.
            number = legs[i] + 1
            total = squares[i] + away * away
            if number < legs[j] or (number == legs[j] and total < squares[j] * (1 - AHEAD)):
                # In the cone all points since lie near the ray; if none is farther away than j, also near the segment.
                is_near = low <= turn <= high and (
                    away >= farthest or is_within(xy, i, j, tolerance)
                )
                is_near = is_near and (
                    is_clear(is_free, x0, y0, x1, y1, beside) or is_within(xy, i, j, STRAIGHT)
                )
                if j == i + 1 or (is_near and is_clear(is_free, x0, y0, x1, y1, margin)):
                    legs[j], squares[j], parent[j] = number, total, i

            # Narrow the cone by point j.
            farthest = max(farthest, away)
            if away > tolerance:
                half = np.arcsin(tolerance / away)
                low = max(low, turn - half)
                high = min(high, turn + half)
                if low > high:
                    break
