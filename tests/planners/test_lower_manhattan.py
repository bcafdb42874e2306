"""A* over real maps, against SciPy's Dijkstra on a graph built apart from it."""

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from figures.paper.common import CENSUS, ORBITS, OSM
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.weights import Weights
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.registry import find_planner
from tests.planners.problems import edges_of, random_cells

ALTITUDE_M = 20.0


@pytest.fixture(scope="module")
def maps(data_dir, tmp_path_factory) -> MetricMaps:
    scenario = {
        "region": {
            "bounds": [-74.02, 40.70, -73.98, 40.73],
            "resolution_m": 5.0,
            "altitudes_m": [ALTITUDE_M],
        },
        "buildings": {"source": str(OSM)},
        "gps": {"orbits": str(ORBITS), "times": ["2020-04-27T16:00:00Z"]},
        "population": {name: str(file) for name, file in CENSUS.items()},
    }
    return run_scenario(
        Scenario.from_dict(scenario), tmp_path_factory.mktemp("lower-manhattan")
    ).maps[5.0]


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_every_cost_over_lower_manhattan_equals_dijkstra_and_landmarks_need_a_quarter_of_octiles_expansions(
    maps, cost_model
):
    costs, is_free = maps.costs(ALTITUDE_M, time_of_day="day"), maps.is_free(ALTITUDE_M)
    layers, weights = np.stack(list(costs.values())), Weights().vector(("distance", *costs))
    first = tuple(int(v) for v in np.argwhere(is_free)[0])
    problem = Problem(layers, is_free, first, first, maps.grid.resolution_m, weights, cost_model)
    edges, rng = edges_of(problem), np.random.default_rng(9)
    shares: list[float] = []
    for start in random_cells(rng, problem.is_free, 10):
        first = np.ravel_multi_index(start, problem.is_free.shape)
        costs = dijkstra(edges, indices=first).reshape(problem.is_free.shape)
        for goal in random_cells(rng, problem.is_free, 6):
            query = problem.between(start, goal)
            expanded = {}
            for name in ("euclidean", "octile", "tiles", "landmarks", "exact"):
                path = find_planner("astar-plus", name)(query, budget_s=60.0, seed=0)
                assert path.status is (Status.NO_PATH if np.isinf(costs[goal]) else Status.OPTIMAL)
                assert path.cost == pytest.approx(costs[goal], rel=1e-12)
                expanded[name] = path.num_expanded
            if path.status.has_path:
                shares.append(expanded["landmarks"] / expanded["octile"])
    assert cost_model == "line" or np.mean(shares) <= 0.25
