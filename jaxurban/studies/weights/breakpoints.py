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

EXACT = 1e-9  # relative: costs this close are equal, being sums of thousands of terms in float64
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
      tolerance: relative: no route is cheaper, anywhere, by more than this.
      num_plans: searches made.
      names: the weights.
      objectives: of a Pareto front, the names of the weights whose features are traded.
    """

    corners: np.ndarray
    features: np.ndarray
    integrals: np.ndarray
    cells: tuple[np.ndarray, ...]
    is_complete: bool
    tolerance: float
    num_plans: int
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
    max_plans: int | None = None,
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
    before = pool.num_plans
    growing = _Growing(corners, tolerance)
    most = np.inf if max_plans is None else max_plans
    places = growing.unverified()
    while len(places) and pool.num_plans - before < most:
        growing.verify(places, pool.cheapest(places @ corners)[:, 0])
        places = growing.unverified()
        if on_plans is not None:
            on_plans(pool.num_plans - before)
    order = growing.order()
    facts = np.array([growing.facts[route] for route in order])
    return Partition(
        corners=corners,
        features=facts[:, 0],
        integrals=facts[:, 1],
        cells=tuple(growing.cells[route] for route in order),
        is_complete=not len(places),
        tolerance=tolerance,
        num_plans=pool.num_plans - before,
        names=pool.names,
    )


def nearest_breakpoints(
    pool: RoutePool, weights: np.ndarray, columns: Sequence[int], factors: tuple[float, float]
) -> np.ndarray:
    """Return ``[N, 2]`` the factors of each weight at which the cheapest route stops being so: below 1, and above 1.

    The others stay as given. NaN where the route is the cheapest to the end of the range, or the weight is 0. A search
    at the end finds a route that is cheaper there, the next one where both cost the same, and so on towards the given
    weight (Newton's method on a concave, piecewise linear function: each route is met once), until none is cheaper:
    some four searches for each factor. Between two breakpoints so near that costs differ by less than `TIE`, the
    farther one may be found.

    Args:
      pool: of one query; routes found join it.
      weights: ``[K]``.
      columns: of the weights that vary, ``N``.
      factors: the ends of the range, below and above 1.

    Raises:
      InputError: the query has no path.
    """
    features = pool.cheapest(weights[None])[0, 0, 0]
    factors_at = np.tile(np.asarray(factors, np.float64), (len(columns), 1))
    is_due = np.tile(weights[list(columns), None] > 0, 2)
    result = np.full(factors_at.shape, np.nan)
    while is_due.any():
        rows, ends = np.nonzero(is_due)
        places = np.tile(weights, (len(rows), 1))
        places[np.arange(len(rows)), np.asarray(columns)[rows]] *= factors_at[rows, ends]
        others = pool.cheapest(places)[0, 0]
        for row, end, place, other in zip(
            rows.tolist(), ends.tolist(), places, others, strict=True
        ):
            excess = features - other
            if place @ excess <= TIE * (place @ features):
                is_due[row, end] = False
                continue
            column = columns[row]
            # At the given weights the other one costs as much at least; rounding may say less.
            ahead = min(weights @ excess, 0.0)
            factors_at[row, end] = result[row, end] = 1 - ahead / (weights[column] * excess[column])
    return result


def pareto_front(
    pool: RoutePool,
    objectives: Sequence[str],
    *,
    tolerance: float = EXACT,
    max_plans: int | None = None,
    on_plans: OnPlans | None = None,
) -> Partition:
    """Return the routes that are best for some weights of two or three features, such as distance and population.

    No other route is as cheap in every chosen feature and better in one. These are the **supported** points only: the
    corners of the front's convex hull. A point of the front inside the hull is the cheapest under no weights, so no
    weighted sum finds it, and it is not here. Features that are not chosen cost nothing.

    Args:
      pool: of one query; routes found join it.
      objectives: two or three of the weights' names.
      tolerance, max_plans, on_plans: as in `find_breakpoints`.

    Raises:
      InputError: the query has no path.
    """
    columns = [pool.names.index(name) for name in objectives]
    alone = np.eye(len(pool.names))[columns]
    # In units of what routes have of each, so that no objective is squeezed into a corner of the triangle.
    size = pool.cheapest(alone)[0, 0][:, columns].max(axis=0)
    shares = np.eye(len(objectives)) * (1 - len(objectives) * LEAST) + LEAST
    corners = shares @ (alone / np.where(size > 0, size, 1.0)[:, None])
    result = find_breakpoints(
        pool, corners, tolerance=tolerance, max_plans=max_plans, on_plans=on_plans
    )
    return replace(result, objectives=tuple(objectives))


class _Growing:
    """The partition by the routes known so far: facts ``[2, K]``, cost at each corner ``[C]`` and cell of each."""

    def __init__(self, corners: np.ndarray, tolerance: float) -> None:
        self.corners = corners
        self.tolerance = tolerance
        self.facts: list[np.ndarray] = []
        self.ends: list[np.ndarray] = []
        # Empty where another route is as cheap or cheaper everywhere.
        self.cells: list[np.ndarray] = []
        self.verified: set[tuple[int, ...]] = set()

    def unverified(self) -> np.ndarray:
        """Return the places ``[P, C]`` at which a search is still due: corners of cells, each once."""
        cells = self.cells or [np.eye(len(self.corners))]
        due = {_key(place): place for cell in cells for place in cell}
        return np.array([place for key, place in due.items() if key not in self.verified])

    def verify(self, places: np.ndarray, result: np.ndarray) -> None:
        """Take in what searches at places ``[P, C]`` found, ``[2, P, K]``."""
        self.verified.update(map(_key, places))
        for place, features, integrals in zip(places, *result, strict=True):
            ends = self.corners @ features
            known = np.min(np.array(self.ends) @ place) if self.ends else np.inf
            if place @ ends < known * (1 - self.tolerance):
                self._add(np.stack([features, integrals]), ends)

    def _add(self, facts: np.ndarray, ends: np.ndarray) -> None:
        """Add a route: its region of weights is what all known ones leave it, and it takes its part of theirs."""
        new = np.eye(len(self.corners))
        for route, other in enumerate(self.ends):
            if len(self.cells[route]):
                new = _clip(new, ends - other)
                self.cells[route] = _clip(self.cells[route], other - ends)
        self.facts.append(facts)
        self.ends.append(ends)
        self.cells.append(new)

    def order(self) -> list[int]:
        """Return the routes that have a cell: along a line from its first corner on, else by falling size."""
        routes = [route for route, cell in enumerate(self.cells) if len(cell)]
        if len(self.corners) == 2:
            return sorted(routes, key=lambda route: self.cells[route][:, 1].min())
        return sorted(routes, key=lambda route: -_size(self.cells[route]))


def _clip(cell: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the part of a convex cell ``[V, C]`` where ``place @ excess <= 0``, empty where that has no size.

    One half-plane of Sutherland and Hodgman's clipping (1974).
    """
    empty = np.empty((0, len(excess)))
    above = cell @ excess
    if above.max(initial=0.0) <= 0:
        return cell
    kept = []
    following = np.roll(cell, -1, axis=0)
    above_following = np.roll(above, -1)
    for corner, other, a, b in zip(cell, following, above, above_following, strict=True):
        if a <= 0:
            kept.append(corner)
        if a * b < 0:  # the side crosses the line between
            kept.append(corner + (other - corner) * (a / (a - b)))
    points = {_key(place): place for place in kept}
    if len(points) < len(excess):
        return empty
    clipped = np.array([*points.values()])
    return clipped if _size(clipped) > EMPTY else empty


def _size(cell: np.ndarray) -> float:
    """Return the share of the line or of the triangle that a convex cell ``[V, C]`` covers."""
    if cell.shape[1] == 2:
        return float(np.ptp(cell[:, 1]))
    x, y = (cell - cell[0])[:, 1:].T
    return float(abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def _key(place: np.ndarray) -> tuple[int, ...]:
    return tuple(np.round(place / SAME_POINT).astype(np.int64).tolist())
