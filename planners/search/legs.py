"""The compiled parts of simplification: nudged points, the fewest legs.

Points are x, y in cell sides from the map's southwest corner.
"""

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.clear import is_clear

STUCK = 1e9  # what a leg that is not clear counts among nudges, so that there are as few as can be
REACH = 256  # points that a leg may span, lest a way over open land of thousands takes seconds
AHEAD = 1e-12  # relative: sums this much smaller are smaller


@compiled()
def nudged(is_free, xy, is_movable, offsets, margin):
    """Return points ``[N, 2]``, some moved by one of a few offsets, so that as few legs as can be are not clear.

    Legs that are not clear stay where they are: moved, one through the corner of two closed cells would enter one.
    Of such ways the one whose points move the least in all, by dynamic programming over the offsets of each point.

    Args:
      is_free: ``[Y, X]`` bool.
      xy: ``[N, 2]`` points.
      is_movable: ``[N]`` bool.
      offsets: ``[C, 2]``; the first is 0, 0.
      margin: see `is_clear`.
    """
    num, num_offsets = len(xy), len(offsets)
    best = np.full((num, num_offsets), np.inf)
    parent = np.zeros((num, num_offsets), np.int64)
    best[0, 0] = 0.0
    for k in range(1, num):
        for c in range(num_offsets if is_movable[k] else 1):
            x, y = xy[k] + offsets[c]
            moved = np.hypot(offsets[c, 0], offsets[c, 1])
            for p in range(num_offsets if is_movable[k - 1] else 1):
                reach = best[k - 1, p] + moved
                if reach >= best[k, c]:
                    continue
                from_x, from_y = xy[k - 1] + offsets[p]
                if not is_clear(is_free, from_x, from_y, x, y, margin):
                    reach = reach + STUCK if c == p == 0 else np.inf
                if reach < best[k, c]:
                    best[k, c], parent[k, c] = reach, p
    found = xy.copy()
    c = int(np.argmin(best[num - 1]))
    for k in range(num - 1, -1, -1):
        found[k] = xy[k] + offsets[c]
        c = int(parent[k, c])
    return found


@compiled()
def is_within(xy, first, last, tolerance):
    """Whether the points between two lie within a tolerance of the segment that joins these."""
    x0, y0 = xy[first]
    dx, dy = xy[last] - xy[first]
    length = np.hypot(dx, dy)
    for k in range(first + 1, last):
        x, y = xy[k, 0] - x0, xy[k, 1] - y0
        share = 0.0
        if length > 0.0:
            share = min(max((x * dx + y * dy) / (length * length), 0.0), 1.0)
        if np.hypot(x - share * dx, y - share * dy) > tolerance:
            return False
    return True


@compiled()
def fewest_legs(is_free, xy, tolerance, margin):
    """Return ``[N]`` bool which points to keep, ends included: the fewest legs, and of these ways the most even.

    The most even way has the least sum of its legs' squared lengths, so that none is shorter than it need be.

    A leg may skip up to `REACH` points that lie within the tolerance of it where it is clear (`is_clear`); from one
    point to the next it always may lead, as the path does. Every two points that such a leg joins are an edge of a
    graph, and the shortest way through it is the answer (Imai & Iri 1988, "Polygonal approximations of a curve"). From
    each point the cone of directions that still pass all points since within the tolerance says when to stop looking
    farther (Chan & Chin 1996, "Approximation of polygonal curves with minimum number of line segments or minimum
    error").
    """
    num = len(xy)
    legs = np.full(num, num, np.int64)
    squares = np.full(num, np.inf)
    parent = np.zeros(num, np.int64)
    legs[0], squares[0] = 0, 0.0
    for i in range(num - 1):
        low, high, axis, is_open = 0.0, 0.0, 0.0, True
        farthest = 0.0
        for j in range(i + 1, min(num, i + 1 + REACH)):
            dx, dy = xy[j] - xy[i]
            away = np.hypot(dx, dy)
            turn = 0.0
            if away > 0.0 and not is_open:
                turn = (np.arctan2(dy, dx) - axis + np.pi) % (2 * np.pi) - np.pi
            number, total = legs[i] + 1, squares[i] + away * away
            is_better = number < legs[j] or (number == legs[j] and total < squares[j] * (1 - AHEAD))
            if is_better:
                is_near = j == i + 1
                if not is_near and (is_open or low <= turn <= high or away <= tolerance):
                    # No point since is farther from the first one, nor from the ray: then the segment's end is no bar.
                    is_near = (not is_open and low <= turn <= high and away >= farthest) or is_within(
                        xy, i, j, tolerance
                    )
                    is_near = is_near and is_clear(is_free, xy[i, 0], xy[i, 1], xy[j, 0], xy[j, 1], margin)
                if is_near:
                    legs[j], squares[j], parent[j] = number, total, i
            farthest = max(farthest, away)
            if away > tolerance:
                half = np.arcsin(tolerance / away)
                if is_open:
                    axis, low, high, is_open = np.arctan2(dy, dx), -half, half, False
                else:
                    low, high = max(low, turn - half), min(high, turn + half)
                if low > high:
                    break
    is_kept = np.zeros(num, np.bool_)
    k = num - 1
    while k > 0:
        is_kept[k] = True
        k = parent[k]
    is_kept[0] = True
    return is_kept
