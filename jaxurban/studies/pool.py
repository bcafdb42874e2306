"""RoutePool: the cheapest routes of many queries under any weights, with all that were found kept.

The cheapest cost of a query is a concave, piecewise linear function of W: the lower envelope of W . features over
routes. Routes found so far bound it from above, at the price of a few multiplications, and equal it wherever
the cheapest is among them.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.batch import solve_many
from jaxurban.studies.journal import Journal
from jaxurban.studies.queries import Query, RouteFacts, route_facts

SAME = 1e-9  # relative: routes whose features differ by less cost the same under every W
BLOCK = 64  # routes a query: arrays grow by so many at once, so that compiled code meets few shapes
TOGETHER = 32  # searches at a time of JAX: each holds a cost map of its own
NOT_A_ROUTE = 1e12  # features that fill up the arrays: never the cheapest


class RoutePool:
    """Routes of ``Q`` queries as features and integrals (see `RouteFacts`) of ``K`` weights; at most ``R`` a query.

    Attributes:
      queries: what is asked.
      num_plans: searches made so far.
    """

    def __init__(
        self,
        queries: Sequence[Query],
        known: Sequence[RouteFacts] | None = None,
        workers: int | None = None,
        journal: Journal | None = None,
        backend: Literal["numba", "jax"] = "numba",
    ) -> None:
        """Begin with no route.

        Args:
          queries: what is asked.
          known: a route of each query to begin with.
          workers: threads of search; one a core if left out.
          journal: answers the searches that it holds, and takes down the others.
          backend: of A*: ``"numba"``, or ``"jax"`` for many searches together, which pays on a GPU.

        Raises:
          InputError: another backend.
        """
        if backend not in ("numba", "jax"):
            raise InputError(f"backend must be 'numba' or 'jax', got {backend!r}")
        self._backend = backend
        self.queries = tuple(queries)
        self.num_plans = 0
        self._journal = journal
        self._workers = workers or os.cpu_count() or 1
        self._routes: list[list[np.ndarray]] = [[] for _ in self.queries]  # [2, K]: features, integrals
        for query, facts in enumerate(known or ()):
            self._add(query, np.stack([facts.features, facts.integrals]))

    @property
    def num_routes(self) -> int:
        """Different routes found so far, of all queries."""
        return sum(map(len, self._routes))

    @property
    def features(self) -> np.ndarray:
        """``[Q, R, K]`` features of all routes, filled up with `NOT_A_ROUTE`; R is a multiple of `BLOCK`."""
        return self._filled(0)

    @property
    def integrals(self) -> np.ndarray:
        """``[Q, R, K]`` integrals of all routes, filled up like `features`."""
        return self._filled(1)

    def _filled(self, part: int) -> np.ndarray:
        most = max(1, *map(len, self._routes))
        filled = np.full((len(self._routes), -(-most // BLOCK) * BLOCK, len(self.queries[0].names)), NOT_A_ROUTE)
        for rows, routes in zip(filled, self._routes, strict=True):
            for row, route in zip(rows, routes, strict=False):
                row[:] = route[part]
        return filled

    def cheapest(self, weights: np.ndarray) -> np.ndarray:
        """Return ``[2, Q, M, K]`` features and integrals of the cheapest routes, by search; new ones join the pool.

        Args:
          weights: ``[Q, M, K]`` not negative, M weights for each query.

        Raises:
          InputError: a query's start and goal are not connected.
        """
        found = None if self._journal is None else self._journal.recall(weights)
        if found is None:
            found = self._search_all(weights)
            if self._journal is not None:
                self._journal.keep(weights, found)
        self.num_plans += weights.shape[0] * weights.shape[1]
        for query, routes in enumerate(np.moveaxis(found, 0, 2)):
            for route in routes:
                self._add(query, route)
        return found

    def _search_all(self, weights: np.ndarray) -> np.ndarray:
        """Return ``[2, Q, M, K]`` as `cheapest` does: the one place where routes are searched for."""
        jobs = [(self.queries[query], w) for query, each in enumerate(weights) for w in each]
        if self._backend == "jax":
            batches = (jobs[k : k + TOGETHER] for k in range(0, len(jobs), TOGETHER))
            routes = [route for batch in batches for route in _routes_together(batch)]
        else:
            with ThreadPoolExecutor(self._workers) as threads:
                routes = list(threads.map(lambda job: cheapest_route(*job), jobs))
        facts = [route_facts(query.unit, route) for (query, _), route in zip(jobs, routes, strict=True)]
        found = np.array([(each.features, each.integrals) for each in facts])
        return np.moveaxis(found.reshape(*weights.shape[:2], 2, -1), 2, 0)

    def _add(self, query: int, route: np.ndarray) -> None:
        if self._routes[query]:
            known = np.array(self._routes[query])[:, 0]
            scale = np.maximum(np.abs(known), np.abs(route[0])) + 1e-12
            if np.any(np.all(np.abs(known - route[0]) <= SAME * scale, axis=1)):
                return
        self._routes[query].append(np.array(route))


def _routes_together(jobs: Sequence[tuple[Query, np.ndarray]]) -> list[np.ndarray]:
    """Return what `cheapest_route` returns for each query and weights, all searched for at once by JAX."""
    problems = [_problem(*job) for job in jobs]
    found = dict(solve_many(problems, planner="astar-dist", backend="jax"))
    return [_points(query, found[k]) for k, (query, _) in enumerate(jobs)]


def cheapest_route(query: Query, weights: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` the cheapest route under weights ``[K]``, in metres from the map's southwest corner.

    Raises:
      InputError: the query's start and goal are not connected.
    """
    return _points(query, astar(_problem(query, weights)))


def _problem(query: Query, weights: np.ndarray) -> Problem:
    return query.unit.problem.between(query.start, query.goal).reweighted(weights[1:], float(weights[0]))


def _points(query: Query, found: Path | Exception) -> np.ndarray:
    if isinstance(found, Exception):
        raise found
    if not found.status.has_path:
        raise InputError(f"no path joins the ends of route {query.name!r}: leave it out")
    return found.points_m
