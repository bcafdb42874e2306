"""Breakpoints of the cheapest route along a line and over a triangle of weights: exact, with a proof by searches.

The cheapest cost V(W) of a query is the least of W . features over its routes: concave and piecewise linear, so
each route is cheapest over one interval of a line, one convex polygon of a triangle. Routes found so far bound V
from above by U, and U is linear over the cell of each. If a search at every corner of every cell finds nothing
cheaper than U, then V = U everywhere: over a cell, V is concave and meets the linear U at all corners, so it
cannot be below. Along a line this is the recursion of Eisner and Severance (J. ACM 23(4), 1976). The Pareto front, as
far as weighted sums reach it, is the same over the weights of its objectives alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from jaxurban.studies.queries import outcomes_of
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.settings import EXACT

EMPTY = 1e-12  # of the whole: a cell smaller than this is a point or an edge, where routes only tie
SAME_POINT = 1e-10  # shares of the corners that differ by less are one point
TIE = 1e-14  # relative: what is left of equal costs by rounding, where no breakpoint but the nearest is looked for

# Share that each objective has at least: a route that is cheapest under weights above 0 is on the front, while under a
# weight of 0 it may be worse than need be in that objective.
LEAST = 1e-6

OnPlans = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Partition:
    """The cheapest routes over a line (``C`` = 2 corners) or triangle (3) of weights. ``K`` weights, ``R`` routes.

    A place is given by its shares ``[C]`` of the corners, which sum to 1 and are not negative: its weights are
    shares @ corners. Routes that cost the same under all of these weights are one route; which of them stands for
    the others is arbitrary.

    Attributes:
      corners: ``[C, K]`` weights.
      features, integrals: ``[R, K]`` of each route (see `RouteQuery.sums`). Along a line, from its first corner on;
        over a triangle, those of larger cells first.
      cells: of each route, the corners ``[V, C]`` of the interval or convex polygon where it is cheapest.
      is_complete: every corner of every cell is verified by a search. If not, a route may be missing.
      names: the weights.
      objectives: of a Pareto front, the names of the weights whose features are traded.
    """

    corners: np.ndarray
    features: np.ndarray
    integrals: np.ndarray
    cells: tuple[np.ndarray, ...]
    is_complete: bool
    names: tuple[str, ...]
    objectives: tuple[str, ...] = ()

    def weights_at(self, shares: np.ndarray) -> np.ndarray:
        """Return the weights ``[..., K]`` at places ``[..., C]``."""
        return shares @ self.corners

    def cost_at(self, shares: np.ndarray) -> np.ndarray:
        """Return the cheapest cost ``[...]`` at places ``[..., C]``."""
        return np.min(self.weights_at(shares) @ self.features.T, axis=-1)

    @property
    def sizes(self) -> np.ndarray:
        """``[R]`` share of the line or of the triangle where each route is cheapest."""
        return np.array([_size(cell) for cell in self.cells])

    @property
    def middles(self) -> np.ndarray:
        """``[R, C]`` a place inside each cell."""
        return np.array([cell.mean(axis=0) for cell in self.cells])

    @property
    def breakpoints(self) -> np.ndarray:
        """``[R - 1]`` of a line: the share of its second corner at each breakpoint, rising."""
        return np.array([cell[:, 1].max() for cell in self.cells[:-1]])

    @property
    def points(self) -> pd.DataFrame:
        """Of a Pareto front a row per route: its features by the names of the objectives, and its outcomes."""
        columns = [self.names.index(name) for name in self.objectives]
        result = pd.DataFrame(self.features[:, columns], columns=list(self.objectives))
        result.index = pd.RangeIndex(1, len(result) + 1, name="route")
        return result.assign(**outcomes_of(self.integrals, self.names))


def find_breakpoints(
    pool: RoutePool,
    corners: np.ndarray,
    *,
    tolerance: float = EXACT,
    max_plans: float = np.inf,
    on_plans: OnPlans | None = None,
) -> Partition:
    """Return the partition of a line or triangle of weights into the cells of its cheapest routes.

    Searches: one for each corner of a cell and one for each route, so about 2 R along a line and 3 R over a
    triangle, for R routes.

    Args:
      pool: of one query; routes found join it.
      corners: ``[2, K]`` or ``[3, K]`` weights, not negative.
      tolerance: relative: routes that save less than this share of the cost are not looked for. The least that
        float64 costs allow is `EXACT`.
      max_plans: stop after about so many searches, with ``is_complete`` False.
      on_plans: gets the number of searches made after each round.

    Raises:
      InputError: the query has no path.
    """
    # The routes found so far: features and integrals [2, K] of each, its cost at each corner [C], and its cell, empty
    # where another route is as cheap or cheaper everywhere.
    facts: list[np.ndarray] = []
    ends: list[np.ndarray] = []
    cells: list[np.ndarray] = []

    # Rounds of searches at all places [P, C] at which one is still due: corners of cells, each once.
    before = pool.num_plans
    verified: set[tuple[int, ...]] = set()
    places = np.eye(len(corners))
    while len(places) and pool.num_plans - before < max_plans:
        verified.update(map(_key, places))
        found = pool.cheapest(places @ corners)[:, 0]
        for place, features, integrals in zip(places, *found, strict=True):
            at_corners = corners @ features
            known = np.min(np.array(ends) @ place) if ends else np.inf
            if not place @ at_corners < known * (1 - tolerance):
                continue

            # A new route: its cell is what the known routes leave it, and their cells lose what it takes.
            new = np.eye(len(corners))
            for route, other in enumerate(ends):
                if len(cells[route]):
                    new = _clip(new, at_corners - other)
                    cells[route] = _clip(cells[route], other - at_corners)
            facts.append(np.stack([features, integrals]))
            ends.append(at_corners)
            cells.append(new)
        due = {_key(place): place for cell in cells for place in cell}
        places = np.array([place for key, place in due.items() if key not in verified])
        if on_plans is not None:
            on_plans(pool.num_plans - before)

    # The routes that have a cell: along a line from its first corner on, else by falling size.
    order = [route for route, cell in enumerate(cells) if len(cell)]
    if len(corners) == 2:
        order.sort(key=lambda route: cells[route][:, 1].min())
    else:
        order.sort(key=lambda route: -_size(cells[route]))
    chosen = np.array([facts[route] for route in order])
    return Partition(
        corners=corners,
        features=chosen[:, 0],
        integrals=chosen[:, 1],
        cells=tuple(cells[route] for route in order),
        is_complete=not len(places),
        names=pool.names,
    )


def nearest_breakpoints(
    pool: RoutePool, weights: np.ndarray, columns: Sequence[int], factors: tuple[float, float]
) -> np.ndarray:
    """Return ``[N, 2]`` the nearest factors of each weight, below 1 and above 1, at which the cheapest route changes.

    One weight varies at a time. The factor is NaN where the route stays the cheapest to the end of the range, or where
    the weight is 0.

    A first search at the end of the range finds a route that is cheaper there. The next search is at the factor where
    both routes cost the same, and so on towards the given weight, until no route is cheaper. This is Newton's method on
    a concave, piecewise linear function: each route is found once, with some four searches for each factor. Between
    two breakpoints so near that costs differ by less than `TIE`, the farther one may be found.

    Args:
      pool: of one query; routes found join it.
      weights: ``[K]``.
      columns: of the weights that vary, ``N``.
      factors: the ends of the range, below and above 1.

    Raises:
      InputError: the query has no path.
    """
    # [N, 2] the factors of the next searches, which are due until they find nothing cheaper.
    features = pool.cheapest(weights[None])[0, 0, 0]
    tried = np.tile(np.asarray(factors, np.float64), (len(columns), 1))
    is_due = np.tile(weights[list(columns), None] > 0, 2)
    result = np.full(tried.shape, np.nan)
    while is_due.any():
        # A search for each: the given weights, one of them changed.
        rows, ends = np.nonzero(is_due)
        places = np.tile(weights, (len(rows), 1))
        places[np.arange(len(rows)), np.asarray(columns)[rows]] *= tried[rows, ends]
        others = pool.cheapest(places)[0, 0]
        for row, end, place, other in zip(
            rows.tolist(), ends.tolist(), places, others, strict=True
        ):
            excess = features - other
            if place @ excess <= TIE * (place @ features):
                is_due[row, end] = False
                continue

            # The factor at which both cost the same: weights @ excess + (factor - 1) * weight * excess[column] = 0.
            # At the given weights the other route costs as much at least; rounding may say less.
            column = columns[row]
            ahead = min(weights @ excess, 0.0)
            tried[row, end] = 1 - ahead / (weights[column] * excess[column])
            result[row, end] = tried[row, end]
    return result


def pareto_front(
    pool: RoutePool,
    objectives: Sequence[str],
    *,
    tolerance: float = EXACT,
    max_plans: float = np.inf,
    on_plans: OnPlans | None = None,
) -> Partition:
    """Return the routes that are best for some weights of two or three features, such as distance and population.

    No other route is as low in every chosen feature and lower in one. The result holds the **supported** routes only:
    the corners of the front's convex hull. A route of the front inside the hull is the cheapest under no weights, so no
    weighted sum finds it. Features that are not chosen cost nothing.

    Args:
      pool: of one query; routes found join it.
      objectives: two or three of the weights' names.
      tolerance, max_plans, on_plans: as in `find_breakpoints`.

    Raises:
      InputError: the query has no path.
    """
    columns = [pool.names.index(name) for name in objectives]
    alone = np.eye(len(pool.names))[columns]

    # Each objective is counted in its largest value on the routes that are best in another one, so that none is
    # squeezed into a corner of the triangle; one that is 0 on all of them keeps its unit.
    size = pool.cheapest(alone)[0, 0][:, columns].max(axis=0)
    units = np.where(size > 0, size, 1.0)

    # At its corner an objective has nearly all of the weight, and the others at least `LEAST`.
    shares = np.eye(len(objectives)) * (1 - len(objectives) * LEAST) + LEAST
    corners = shares @ (alone / units[:, None])
    result = find_breakpoints(
        pool, corners, tolerance=tolerance, max_plans=max_plans, on_plans=on_plans
    )
    return replace(result, objectives=tuple(objectives))


def _clip(cell: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the part of a convex cell where ``place @ excess <= 0``; ``[0, C]`` where that part has no size.

    One half-plane of Sutherland and Hodgman's clipping (1974).

    Args:
      cell: ``[V, C]`` its corners, in order around it; no corner for an empty cell.
      excess: ``[C]`` cost at each corner of the whole line or triangle, less the cost of another route.
    """
    excesses = cell @ excess
    if excesses.max(initial=0.0) <= 0:
        return cell

    # Corners below the dividing line are kept, and a side that crosses the line ends on it.
    corners = []
    following = np.roll(cell, -1, axis=0)
    following_excesses = np.roll(excesses, -1)
    for corner, other, here, there in zip(
        cell, following, excesses, following_excesses, strict=True
    ):
        if here <= 0:
            corners.append(corner)
        if here * there < 0:
            corners.append(corner + (other - corner) * (here / (here - there)))

    # Each corner once; fewer than the line or triangle itself has enclose nothing.
    points = {_key(place): place for place in corners}
    if len(points) >= len(excess):
        clipped = np.array([*points.values()])
        if _size(clipped) > EMPTY:
            return clipped
    return np.empty((0, len(excess)))


def _size(cell: np.ndarray) -> float:
    """Return the share of the line or of the triangle that a convex cell ``[V, C]`` covers."""
    if cell.shape[1] == 2:
        return float(np.ptp(cell[:, 1]))
    x, y = (cell - cell[0])[:, 1:].T
    return float(abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def _key(place: np.ndarray) -> tuple[int, ...]:
    """Return a key that places ``[C]`` have in common if they are one but for rounding."""
    return tuple(np.round(place / SAME_POINT).astype(np.int64).tolist())
