"""Breakpoints of the cheapest route along a line of weights: exact, with a proof by searches.

The cheapest cost V(W) of a query is the least of W . features over its routes: concave and piecewise linear, so
each route is cheapest over one interval of a line. Routes found so far bound V from above by U, and U is linear over
the interval of each. If a search at both ends of every interval finds nothing cheaper than U, then V = U everywhere:
over an interval, V is concave and meets the linear U at its ends, so it cannot be below. This is the recursion of
Eisner and Severance (J. ACM 23(4), 1976).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxurban.studies.route_pool import RoutePool

EXACT = 1e-9  # relative: costs this close are equal, being sums of thousands of terms in float64
SAME_POINT = 1e-10  # shares of the line that differ by less are one point, where routes only tie
TIE = 1e-14  # relative: what is left of equal costs by rounding, where no breakpoint but the nearest is looked for


@dataclass(frozen=True, eq=False)
class WeightLine:
    """The cheapest routes along a line of weights, from its first end on. ``K`` weights, ``R`` routes.

    A place is given by its shares ``[2]`` of the ends, which sum to 1 and are not negative: its weights are
    shares @ ends. Routes that cost the same along the whole line are one route; which of them stands for the others is
    arbitrary.

    Attributes:
      ends: ``[2, K]`` weights.
      features, integrals: ``[R, K]`` of each route (see `RouteQuery.sums`).
      cells: ``[R, 2, 2]`` of each route both ends of the interval where it is cheapest.
    """

    ends: np.ndarray
    features: np.ndarray
    integrals: np.ndarray
    cells: np.ndarray

    def weights_at(self, shares: np.ndarray) -> np.ndarray:
        """Return the weights ``[..., K]`` at places ``[..., 2]``."""
        return shares @ self.ends

    @property
    def middles(self) -> np.ndarray:
        """``[R, 2]`` the place in the middle of each interval."""
        return self.cells.mean(axis=1)

    @property
    def breakpoints(self) -> np.ndarray:
        """``[R - 1]`` the share of the second end at each breakpoint, rising."""
        return self.cells[:-1, :, 1].max(axis=1)


def find_breakpoints(
    pool: RoutePool, ends: np.ndarray, on_plans: Callable[[int], None] = lambda num_plans: None
) -> WeightLine:
    """Return the cheapest routes along a line of weights, and where each is.

    About 2 R searches find R routes: one at each end of an interval and one for each route.

    Args:
      pool: of one query; routes found join it.
      ends: ``[2, K]`` weights, not negative.
      on_plans: gets the number of searches made after each round.

    Raises:
      InputError: the query has no path.
    """
    # The routes found so far: features and integrals [2, K] of each, its cost at both ends [2], and its interval, empty
    # where another route is as cheap or cheaper everywhere.
    facts: list[np.ndarray] = []
    costs: list[np.ndarray] = []
    cells: list[np.ndarray] = []

    # Rounds of searches at all places [P, 2] at which one is still due: ends of intervals, each once.
    before = pool.num_plans
    verified: set[tuple[int, ...]] = set()
    places = np.eye(2)
    while len(places):
        verified.update(map(_key, places))
        found = pool.cheapest(places @ ends)[:, 0]
        for place, features, integrals in zip(places, *found, strict=True):
            at_ends = ends @ features
            known = np.min(np.array(costs) @ place) if costs else np.inf
            if not place @ at_ends < known * (1 - EXACT):
                continue

            # A new route: its interval is what the known routes leave it, and theirs lose what it takes.
            new = np.eye(2)
            for route, other in enumerate(costs):
                if len(cells[route]):
                    new = _clip(new, at_ends - other)
                    cells[route] = _clip(cells[route], other - at_ends)
            facts.append(np.stack([features, integrals]))
            costs.append(at_ends)
            cells.append(new)
        due = {_key(place): place for cell in cells for place in cell}
        places = np.array([place for key, place in due.items() if key not in verified])
        on_plans(pool.num_plans - before)

    # The routes that have an interval.
    order = [route for route, cell in enumerate(cells) if len(cell)]
    order.sort(key=lambda route: cells[route][:, 1].min())
    chosen = np.array([facts[route] for route in order])
    return WeightLine(ends, chosen[:, 0], chosen[:, 1], np.array([cells[route] for route in order]))


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


def _clip(cell: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the part of an interval where ``place @ excess <= 0``; ``[0, 2]`` where that part has no size.

    Args:
      cell: ``[2, 2]`` its ends; none for an empty one.
      excess: ``[2]`` cost at each end of the whole line, less the cost of another route.
    """
    excesses = cell @ excess
    if excesses.max(initial=0.0) <= 0:
        return cell
    begin, end = excesses
    if min(begin, end) < 0:
        crossing = cell[1] + (cell[0] - cell[1]) * (end / (end - begin))
        clipped = np.stack([cell[0], crossing] if begin < 0 else [crossing, cell[1]])
        if np.ptp(clipped[:, 1]) > SAME_POINT:
            return clipped
    return np.empty((0, 2))


def _key(place: np.ndarray) -> tuple[int, ...]:
    """Return a key that places ``[C]`` have in common if they are one but for rounding."""
    return tuple(np.round(place / SAME_POINT).astype(np.int64).tolist())
