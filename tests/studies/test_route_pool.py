"""The pool of known routes: one of each, at a price that does not grow with how many are known."""

import tracemalloc

import numpy as np
import pytest

from jaxurban.paths.plan import cost_map
from jaxurban.studies.route_pool import RoutePool
from tests.studies.routes_made import made_queries, small_maps


@pytest.fixture(scope="module")
def queries():
    return made_queries(cost_map(small_maps(), 20.0), 2)


def of_known(queries, num, rng):
    """Return a pool that knows so many random routes of the first query."""
    pool = RoutePool(queries[:1])
    for route in rng.uniform(1, 100, (num, 2, len(pool.names))):
        pool._add(0, route)
    return pool


def test_a_route_of_the_same_features_is_kept_once(queries):
    rng = np.random.default_rng(0)
    pool, route = of_known(queries, 50, rng), rng.uniform(1, 100, (2, 5))
    for shift in (0.0, 1e-14, 1e-3):
        pool._add(0, route * (1 + shift))
    assert pool.num_routes == 52
    assert pool.routes[:, 0, 50].tolist() == route.tolist()


def test_one_more_route_takes_as_much_beside_2000_known_ones_as_beside_20(queries):
    rng, bytes_taken = np.random.default_rng(0), []
    for num in (20, 2_000):
        pool, route = of_known(queries, num, rng), rng.uniform(1, 100, (2, 5))
        pool._add(0, route)  # known from now on: the next one changes nothing
        tracemalloc.start()
        pool._add(0, route)
        bytes_taken.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert pool.num_routes == num + 1
    assert bytes_taken[1] < 2 * bytes_taken[0]
