"""A* over real maps, against SciPy's Dijkstra on a graph built apart from it."""

import itertools

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.weights import Weights
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.registry import find_planner

ALTITUDE_M = 20.0


@pytest.fixture(scope="module")
def maps(data_dir, tmp_path_factory) -> MetricMaps:
    folder = tmp_path_factory.mktemp("lower-manhattan")
    (folder / "scenario.toml").write_text(
        f"""
        [region]
        bounds = [-74.02, 40.70, -73.98, 40.73]
        resolution_m = 5.0
        altitudes_m = [{ALTITUDE_M}]
        [buildings]
        source = "{data_dir}/osm/lower-manhattan.osm.pbf"
        [gps]
        orbits = "{data_dir}/gps/gps-ops_2020-04-27.tle"
        times = ["2020-04-27T16:00:00Z"]
        [population]
        blocks = "{data_dir}/census/tl_2010_36061_tabblock10.shp"
        table = "{data_dir}/census/DECENNIALSF12010.P1_nyc_blocks.csv"
        districts = "{data_dir}/districts/nyc_community_districts.geojson"
        """
    )
    return run_scenario(Scenario.from_toml(folder / "scenario.toml"), folder / "maps").maps[5.0]


def graph_of(problem: Problem) -> csr_array:
    """Every edge of the 8-connected grid, diagonal steps only between two free neighbours."""
    num_rows, num_cols = problem.is_free.shape
    number = np.arange(num_rows * num_cols).reshape(num_rows, num_cols)
    origins, targets, weights = [], [], []
    for rows, cols in itertools.product((-1, 0, 1), repeat=2):
        if (rows, cols) == (0, 0):
            continue
        from_rows, to_rows = (slice(max(0, -k), num_rows - max(0, k)) for k in (rows, -rows))
        from_cols, to_cols = (slice(max(0, -k), num_cols - max(0, k)) for k in (cols, -cols))
        is_edge = problem.is_free[from_rows, from_cols] & problem.is_free[to_rows, to_cols]
        if rows and cols:
            is_edge &= problem.is_free[from_rows, to_cols] & problem.is_free[to_rows, from_cols]
        length_m = problem.resolution_m * np.hypot(rows, cols)
        entered, left = problem.cost[to_rows, to_cols], problem.cost[from_rows, from_cols]
        is_cell = problem.cost_model.kind == "cell"
        map_cost = entered if is_cell else length_m * (entered + left) / 2 / problem.cost_model.reference_length_m
        origins.append(number[from_rows, from_cols][is_edge])
        targets.append(number[to_rows, to_cols][is_edge])
        weights.append((problem.distance_weight * length_m + map_cost)[is_edge])
    edges = (np.concatenate(origins), np.concatenate(targets))
    return csr_array((np.concatenate(weights), edges), shape=(number.size, number.size))


def day_problem(maps: MetricMaps, cost_model: str) -> Problem:
    """The map by day under the default weights."""
    weights, is_free = Weights(), maps.is_free(ALTITUDE_M)
    costs = maps.costs(ALTITUDE_M, time_of_day="day")
    vector = weights.vector(("distance", *costs))
    first = tuple(int(v) for v in np.argwhere(is_free)[0])
    return Problem(np.stack(list(costs.values())), is_free, first, first, maps.grid.resolution_m, vector, cost_model)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_every_cost_over_lower_manhattan_equals_dijkstra(maps, cost_model):
    problem = day_problem(maps, cost_model)
    is_free = problem.is_free
    free = [tuple(int(v) for v in cell) for cell in np.argwhere(is_free)]
    graph = graph_of(problem)
    rng = np.random.default_rng(9)
    for start in (free[k] for k in rng.integers(len(free), size=20)):
        distances = dijkstra(graph, indices=start[0] * is_free.shape[1] + start[1]).reshape(is_free.shape)
        for goal in (free[k] for k in rng.integers(len(free), size=10)):
            for name, heuristic in (
                ("astar-dist", None),
                ("astar-plus", "tiles"),
                ("astar-plus", "landmarks"),
                ("astar-plus", "exact"),
            ):
                path = find_planner(name, heuristic)(problem.between(start, goal), budget_s=60.0, seed=0)
                assert path.status is (Status.NO_PATH if np.isinf(distances[goal]) else Status.OPTIMAL)
                assert path.cost == pytest.approx(distances[goal], rel=1e-12)


@pytest.mark.slow
@pytest.mark.data
def test_landmarks_need_a_quarter_of_octiles_expansions(maps):
    problem = day_problem(maps, "cell")
    rng = np.random.default_rng(0)
    free = np.argwhere(problem.is_free)
    shares: list[float] = []
    while len(shares) < 200:
        start, goal = (tuple(int(v) for v in free[k]) for k in rng.choice(len(free), 2, replace=False))
        query = problem.between(start, goal)
        plain = find_planner("astar-dist", "octile")(query, budget_s=60.0, seed=0)
        if not plain.status.has_path:
            continue
        guided = find_planner("astar-plus", "landmarks")(query, budget_s=60.0, seed=0)
        assert guided.cost == pytest.approx(plain.cost, rel=1e-12)
        shares.append(guided.num_expanded / plain.num_expanded)
    assert np.mean(shares) <= 0.25
