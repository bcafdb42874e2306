"""RoutePool: the cheapest routes of many queries under any weights, all kept; FitSettings: how a fit searches them.

The cheapest cost of a query is a concave, piecewise linear function of W: the lower envelope of W . features over
routes. Routes found so far bound it from above, at the price of a few multiplications, and equal it wherever
the cheapest is among them.

The route under one W changes by jumps, so what it adds up is constant but for jumps and its derivative says nothing.
Averaged over W exp(Z), Z normal, it is smooth (Berthet et al. 2020, with the multiplicative noise of Dalle et al.
2022), and its derivative by log W is an average too: E[f(W exp(Z)) Z] / sigma^2 (Stein's identity).
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.tables import fingerprint
from jaxurban.progress import Progress
from jaxurban.studies.queries import RouteQuery

DIGITS = 10  # of features: routes that agree in so many cost the same under every W
BLOCK = 64  # routes a query: arrays grow by so many at once, so that compiled code meets few shapes
FEW_CELLS = 1 << 15  # a search over fewer is over sooner than a thread has taken it up
NOT_A_ROUTE = 1e12  # features that fill up the arrays: never the cheapest


class RoutePool:
    """Routes of ``Q`` queries as features and integrals (see `RouteQuery.sums`) of ``K`` weights; at most ``R`` each.

    Attributes:
      queries: whose routes are searched for.
      names: the weights.
      num_plans: searches made so far.
    """

    def __init__(
        self,
        queries: Sequence[RouteQuery],
        known: Sequence[np.ndarray] = (),
    ) -> None:
        """Begin with the known routes, or with none.

        Args:
          queries: whose routes are searched for; at least one.
          known: ``[2, K]`` features and integrals of one route of each query; empty: there are none yet.
        """
        self.queries = tuple(queries)
        self.names = self.queries[0].names
        self.num_plans = 0

        # Of each query its different routes [2, K], by their rounded features.
        self._routes: list[dict[tuple[str, ...], np.ndarray]] = [{} for _ in self.queries]

        # [2, K] of every route that was searched, by the number of its query and the hash of its points.
        self._sums: dict[tuple[int, str], np.ndarray] = {}
        for query, route in enumerate(known):
            self._add(query, route)

    @property
    def num_routes(self) -> int:
        """Different routes found so far, of all queries."""
        return sum(map(len, self._routes))

    @property
    def routes(self) -> np.ndarray:
        """``[2, Q, R, K]`` features and integrals of all routes found so far.

        R is the most routes of a query, rounded up to a multiple of `BLOCK`; queries with fewer are filled up with
        `NOT_A_ROUTE`.
        """
        most = max(1, *map(len, self._routes))
        num_rows = -(-most // BLOCK) * BLOCK
        shape = (2, len(self._routes), num_rows, len(self.names))
        filled = np.full(shape, NOT_A_ROUTE)
        for query, routes in enumerate(self._routes):
            if routes:
                filled[:, query, : len(routes)] = np.stack([*routes.values()], axis=1)
        return filled

    def cheapest(self, weights: np.ndarray) -> np.ndarray:
        """Return ``[2, Q, M, K]`` features and integrals of the cheapest routes, by search; new ones join the pool.

        Args:
          weights: ``[Q, M, K]`` not negative, M weights for each query, or ``[M, K]``, the same for all.

        Raises:
          InputError: a query's start and goal are not connected.
        """
        weights = np.broadcast_to(weights, (len(self.queries), *np.shape(weights)[-2:]))
        num_queries, num_weights, _ = weights.shape

        # One query and one row of weights for each search, all weights of a query together.
        numbers = np.repeat(np.arange(num_queries), num_weights).tolist()
        queries = [self.queries[number] for number in numbers]
        rows = weights.reshape(len(queries), -1)
        if all(query.cost_map.is_free.size < FEW_CELLS for query in self.queries):
            routes = list(map(RouteQuery.cheapest, queries, rows))
        else:
            with ThreadPoolExecutor() as threads:
                routes = list(threads.map(RouteQuery.cheapest, queries, rows))
        sums = np.array(list(map(self._sums_of, numbers, routes)))  # [Q M, 2, K]
        result = np.moveaxis(sums.reshape(num_queries, num_weights, 2, -1), 2, 0)
        self.num_plans += num_queries * num_weights
        for query, found in enumerate(np.moveaxis(result, 0, 2)):
            for route in found:
                self._add(query, route)
        return result

    def _sums_of(self, query: int, points_m: np.ndarray) -> np.ndarray:
        """Return ``[2, K]`` features and integrals of a route of a query (see `RouteQuery.sums`).

        Each route is added up once, as many weights have the same cheapest route.

        Args:
          query: its number.
          points_m: ``[N, 2]`` the route, in metres from the map's southwest corner.
        """
        key = query, fingerprint(points_m)
        if key not in self._sums:
            self._sums[key] = self.queries[query].sums(points_m)
        return self._sums[key]

    def _add(self, query: int, route: np.ndarray) -> None:
        """Add a route ``[2, K]`` of a query to the pool, unless one is known with the same features to `DIGITS`."""
        features = tuple(f"{value:.{DIGITS - 1}e}" for value in route[0].tolist())
        self._routes[query].setdefault(features, np.array(route))


@typed
@dataclass(frozen=True)
class FitSettings:
    """How a fit of weights searches.

    Attributes:
      max_rounds: of searches; fewer where nothing is left to better.
      seed: of all noise.
      budget_s: seconds; the fit ends after the round in which they run out.
      progress: gets a call after every round, as in `ju.build_maps`.

    Raises:
      InputError: a number that is too small.

    Examples:
      >>> settings = ju.fit.FitSettings(max_rounds=5)
      >>> settings.max_rounds, settings.seed
      (5, 0)
    """

    max_rounds: int = 20
    seed: int = 0
    budget_s: float = np.inf
    progress: Progress = False

    def __post_init__(self) -> None:
        if not (self.max_rounds >= 1 and self.budget_s > 0 and self.seed >= 0):
            raise InputError(
                "max_rounds must be >= 1, budget_s > 0 and seed >= 0, got "
                f"{self.max_rounds}, {self.budget_s} and {self.seed}"
            )


def draw_pairs(seed: int, num_noise: int, num_weights: int) -> np.ndarray:
    """Return ``[M, K]`` standard normal numbers in antithetic pairs; ``num_noise`` is even."""
    half = np.random.default_rng(seed).normal(size=(num_noise // 2, num_weights))
    return np.concatenate([half, -half])


@jax.custom_jvp
def known_route_sums(
    log_weights: Float[Array, " K"],
    routes: Float[Array, "Q R J"],
    drawn: Float[Array, "M K"],
    noise: Float[Array, ""],
) -> Float[Array, "Q J"]:
    """Return the mean over noises of the sums of the cheapest known route of each query, under perturbed weights.

    Each noise takes a few multiplications and no search, so thousands are affordable. The function has first
    derivatives by ``log_weights`` only, which `_known_mean_and_slope` estimates.

    Args:
      log_weights: log W.
      routes: J sums of each known route: its K features first, then whatever else is averaged.
      drawn: ``[M, K]`` Z, from `draw_pairs`.
      noise: sigma, standard deviation of log weights: wider is smoother, and farther from the route under W.
    """
    return _known_mean_and_slope(log_weights, routes, drawn, noise)[0]


@known_route_sums.defjvp
def _known_route_sums_jvp(primals: Any, tangents: Any) -> Any:
    """Return `known_route_sums` and its change along the tangent of the log weights; all other tangents are ignored."""
    mean, slope = _known_mean_and_slope(*primals)
    return mean, slope @ tangents[0]


def _known_mean_and_slope(log_weights: Any, routes: Any, drawn: Any, noise: Any) -> Any:
    """Return the mean ``[Q, J]`` of `known_route_sums`, and its derivative by log W ``[Q, J, K]``.

    The derivative is the Monte Carlo estimate of the derivative of the expectation, with the mean as baseline. It is
    **not** the derivative of the returned mean, which has none. Its error falls with the square root of ``M``.
    """
    perturbed = jnp.exp(log_weights + noise * drawn)
    features = routes[..., : len(log_weights)]
    cheapest = jnp.argmin(jnp.einsum("mk,qrk->qmr", perturbed, features), axis=-1)
    sums = jnp.take_along_axis(routes, cheapest[..., None], axis=1)
    mean = sums.mean(axis=1)
    deviations = sums - mean[:, None]
    return mean, deviations.swapaxes(1, 2) @ drawn / (noise * len(drawn))
