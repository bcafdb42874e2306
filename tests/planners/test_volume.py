"""A* through a volume: against SciPy's Dijkstra, against 2-D, and small volumes done by hand."""

import itertools

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.errors import InputError
from jaxurban.planners import grid_search as search_module
from jaxurban.planners.astar import VOLUME_HEURISTICS, astar, heuristic_at, make_heuristic, volume_astar
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.grid_search import cell_of
from tests.planners.problems import volume_problem

LEVELS_M = np.array([20.0, 22.0, 29.0, 60.0])
VARIANTS = list(itertools.product(["cell", "line"], ["both-free", "always"], [8, 4]))


def buildings(rng, shape, levels_m=LEVELS_M):
    """Roofs of random height, and which nodes are free over them."""
    roof_m = np.where(rng.random(shape) < 0.5, 0.0, rng.uniform(10.0, 1.2 * levels_m[-1], shape))
    return roof_m, roof_m < levels_m[:, None, None]


def random_volume(seed, cost_model, diagonal, connectivity, shape=(5, 6)):
    rng = np.random.default_rng(seed)
    is_free = buildings(rng, shape)[1] if seed % 2 else rng.random((4, *shape)) < 0.75
    free = np.argwhere(is_free)
    start, goal = (tuple(int(v) for v in free[k]) for k in rng.choice(len(free), 2, replace=False))
    cost = np.where(is_free, 3 * rng.random(is_free.shape) ** 3, np.nan)
    weights = rng.uniform(0, 0.5, 3) * (rng.random(3) < 0.8)
    return volume_problem(
        cost, is_free, LEVELS_M, start, goal, 5.0, *weights, CostModel(cost_model, 3.0, connectivity, diagonal)
    )


def graph_of(problem):
    """Every edge of the volume, by the definition, for SciPy."""
    shape, z_m = problem.is_free.shape, problem.levels_m

    def is_free(level, row, col):
        return (
            all(0 <= i < n for i, n in zip((level, row, col), shape, strict=True)) and problem.is_free[level, row, col]
        )

    origins, targets, weights = [], [], []
    for level, row, col in np.argwhere(problem.is_free):
        for up, rows, cols in itertools.product((-1, 0, 1), repeat=3):
            to = (level + up, row + rows, col + cols)
            if (up, rows, cols) == (0, 0, 0) or (rows and cols and problem.cost_model.connectivity == 4):
                continue
            passed = {(row, col), to[1:]}
            if problem.cost_model.diagonal == "both-free":
                passed |= {(row, to[2]), (to[1], col)}
            if not all(is_free(z, *cell) for z in (level, to[0]) for cell in passed):
                continue
            rise_m = z_m[to[0]] - z_m[level]
            length_m = np.sqrt((rows**2 + cols**2) * problem.resolution_m**2 + rise_m**2)
            map_cost = problem.cost[to]
            if problem.cost_model.kind == "line":
                map_cost = (
                    length_m * (problem.cost[level, row, col] + map_cost) / 2 / problem.cost_model.reference_length_m
                )
            height_cost = problem.height_costs[0] * max(rise_m, 0) + problem.height_costs[1] * max(-rise_m, 0)
            origins.append(np.ravel_multi_index((level, row, col), shape))
            targets.append(np.ravel_multi_index(to, shape))
            weights.append(problem.distance_weight * length_m + map_cost + height_cost)
    return csr_array((weights, (origins, targets)), shape=(problem.cost.size, problem.cost.size))


@pytest.mark.parametrize(("cost_model", "diagonal", "connectivity"), VARIANTS)
def test_cost_equals_scipy_dijkstra_and_bounds_are_admissible_and_consistent(cost_model, diagonal, connectivity):
    for seed in range(4):
        problem = random_volume(seed, cost_model, diagonal, connectivity)
        graph = graph_of(problem)
        cost_to_go = dijkstra(graph.T, indices=np.ravel_multi_index(problem.goal, problem.is_free.shape))
        optimum = cost_to_go.reshape(problem.is_free.shape)[problem.start]
        edges = graph.tocoo()
        for name in VOLUME_HEURISTICS:
            bound, goal = make_heuristic(name, problem), cell_of(problem, problem.goal)
            nodes = np.ndindex(problem.is_free.shape)
            values = np.array([heuristic_at(bound, cell_of(problem, node), goal) for node in nodes])
            assert np.all((values <= cost_to_go + 1e-9)[problem.is_free.ravel()])
            assert np.all(values[edges.row] <= edges.data + values[edges.col] + 1e-9)
            path = volume_astar(problem, heuristic=name)
            if np.isinf(optimum):
                assert (path.status, path.lower_bound, path.points_m.shape) == (Status.NO_PATH, np.inf, (0, 3))
                continue
            assert path.status is Status.OPTIMAL
            assert path.cost == pytest.approx(optimum, rel=1e-12)
            assert path.lower_bound == path.cost
            assert path.cost == pytest.approx(problem.cost_of(path.points_m))


@pytest.mark.parametrize("connectivity", [8, 4])
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_one_level_equals_2d(cost_model, connectivity):
    rng = np.random.default_rng(3)
    is_free = rng.random((40, 50)) < 0.75
    cost = rng.random(is_free.shape) ** 2
    free = [tuple(int(v) for v in cell) for cell in np.argwhere(is_free)]
    flat = Problem(cost[None], is_free, free[0], free[0], 5.0, 0.1, CostModel(cost_model, 4.0, connectivity))
    node = (0, *free[0])
    volume = volume_problem(
        cost[None],
        is_free[None],
        np.array([60.0]),
        node,
        node,
        5.0,
        0.1,
        3.0,
        3.0,
        CostModel(cost_model, 4.0, connectivity),
    )
    for _ in range(150):
        start, goal = (free[k] for k in rng.choice(len(free), 2))
        expected = astar(flat.between(start, goal))
        path = volume_astar(volume.between((0, *start), (0, *goal)))
        assert path.status is expected.status
        assert path.cost == pytest.approx(expected.cost, rel=1e-12)


@pytest.mark.parametrize(("cost_model", "map_cost"), [("cell", 2.0 + 3.0), ("line", (30 * 1.5 + 60 * 2.5) / 4)])
def test_a_climb_on_the_spot_pays_its_height_and_the_nodes_it_enters(cost_model, map_cost):
    cost, levels_m = np.array([1.0, 2.0, 3.0])[:, None, None], np.array([10.0, 40.0, 100.0])
    problem = volume_problem(
        cost, np.ones((3, 1, 1), bool), levels_m, (0, 0, 0), (2, 0, 0), 5.0, 0.1, 0.5, 0.25, CostModel(cost_model, 4.0)
    )
    up = volume_astar(problem)
    assert up.cost == pytest.approx((0.1 + 0.5) * 90 + map_cost)
    np.testing.assert_array_equal(up.points_m, [[2.5, 2.5, 10], [2.5, 2.5, 40], [2.5, 2.5, 100]])
    down_map_cost = 2.0 + 1.0 if cost_model == "cell" else map_cost
    assert volume_astar(problem.between((2, 0, 0), (0, 0, 0))).cost == pytest.approx((0.1 + 0.25) * 90 + down_map_cost)


def wall_with_a_door(climb_cost):
    """A wall 30 m high across the way, with a door far to the north; levels at 10 and 40 m."""
    roof_m = np.zeros((41, 21))
    roof_m[:40, 10] = 30.0
    levels_m = np.array([10.0, 40.0])
    is_free = roof_m < levels_m[:, None, None]
    return volume_problem(np.zeros(is_free.shape), is_free, levels_m, (0, 0, 0), (0, 0, 20), 5.0, 1.0, climb_cost)


def test_a_wall_is_flown_over_where_climbing_is_cheap_and_around_where_it_is_dear():
    # Over: 18 steps on a level and two that rise or fall 30 m. Around: twice 9 columns and 40 rows, and two
    # steps through the door.
    over_m = 18 * 5 + 2 * np.hypot(5, 30)
    around_m = 5 * (2 * 9 * np.sqrt(2) + 2 * 31 + 2)
    dear = (around_m - over_m) / 30
    over, around = (volume_astar(wall_with_a_door(factor * dear)) for factor in (0.999, 1.001))
    assert over.cost == pytest.approx(over_m + 0.999 * dear * 30)
    assert over.points_m[:, 2].max() == 40
    assert around.cost == pytest.approx(around_m)
    assert around.points_m[:, 2].max() == 10


def test_no_path_crosses_what_stands_between_its_levels():
    rng = np.random.default_rng(5)
    num_checked = 0
    for _ in range(40):
        roof_m, is_free = buildings(rng, (12, 12))
        free = [tuple(int(v) for v in node) for node in np.argwhere(is_free)]
        cost = rng.random(is_free.shape)
        volume = volume_problem(cost, is_free, LEVELS_M, free[0], free[0], 5.0, 0.1)
        for _ in range(50):
            path = volume_astar(volume.between(*(free[k] for k in rng.choice(len(free), 2))))
            if not path.status.has_path or len(path.points_m) == 1:
                continue
            # Points along every segment, and their neighbours a hand's breadth to all sides, under the path too.
            along = np.linspace(0, 1, 21)[:, None, None]
            points = (path.points_m[:-1] * (1 - along) + path.points_m[1:] * along).reshape(-1, 3)
            for aside_m in itertools.product((-0.1, 0.1), repeat=2):
                col, row = np.floor((points[:, :2] + aside_m) / 5.0).astype(int).T
                assert np.all(roof_m[row, col] < points[:, 2])
            num_checked += 1
    assert num_checked > 1500


def test_a_closed_court_is_left_through_the_air_only():
    is_free = np.ones((2, 7, 7), bool)
    is_free[0, 2:5, 2:5] = False
    is_free[0, 3, 3] = True
    levels_m = np.array([10.0, 40.0])
    problem = volume_problem(np.zeros(is_free.shape), is_free, levels_m, (0, 3, 3), (0, 0, 0), 5.0, 1.0)
    path = volume_astar(problem)
    np.testing.assert_array_equal(path.points_m[:2], [[17.5, 17.5, 10], [17.5, 17.5, 40]])
    low = volume_problem(np.zeros((1, 7, 7)), is_free[:1], levels_m[:1], (0, 3, 3), (0, 0, 0), 5.0, 1.0)
    for name in VOLUME_HEURISTICS:
        assert volume_astar(low, heuristic=name).status is Status.NO_PATH


def test_a_spent_budget_leaves_a_bound_below_the_optimum(monkeypatch):
    problem = random_volume(1, "cell", "both-free", 8, shape=(30, 30)).between((3, 0, 0), (3, 29, 29))
    optimum = volume_astar(problem).cost
    monkeypatch.setattr(search_module, "CHUNK", 20)
    for heuristic in ("octile", "plus"):
        path = volume_astar(problem, budget_s=1e-9, heuristic=heuristic)
        assert path.status is Status.BUDGET_EMPTY
        assert path.num_expanded == 20
        assert 0 < path.lower_bound <= optimum


def test_what_costs_nothing_says_that_its_shape_means_nothing():
    problem = volume_problem(np.zeros((2, 3, 3)), np.ones((2, 3, 3), bool), [1.0, 2.0], (0, 0, 0), (1, 2, 2), 1.0, 0.0)
    path = volume_astar(problem)
    assert (path.cost, path.status) == (0, Status.OPTIMAL)
    assert "costs nothing" in path.note


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"cost": np.full((2, 3, 3), np.nan)}, "finite and not negative"),
        ({"cost": np.full((2, 3, 3), np.inf)}, "finite and not negative"),
        ({"cost": np.full((2, 3, 3), -1.0)}, "finite and not negative"),
        ({"climb_cost": -1.0}, "weights must be"),
        ({"descent_cost": np.nan}, "weights must be"),
        ({"distance_weight": np.inf}, "weights must be"),
        ({"resolution_m": 0.0}, "resolution_m"),
        ({"cost_model": "cells"}, "'cell' or 'line'"),
        ({"start": (2, 0, 0)}, "outside the volume"),
        ({"is_free": np.zeros((2, 3, 3), bool)}, "inside an obstacle"),
    ],
)
def test_wrong_problems_are_refused(changed, words):
    given = {
        "cost": np.zeros((2, 3, 3)),
        "is_free": np.ones((2, 3, 3), bool),
        "levels_m": [1.0, 2.0],
        "start": (0, 0, 0),
        "goal": (0, 2, 2),
        "resolution_m": 1.0,
        "distance_weight": 1.0,
    }
    with pytest.raises(InputError, match=words):
        volume_problem(**(given | changed))


def test_an_unknown_heuristic_is_named():
    with pytest.raises(InputError, match="did you mean 'octile'"):
        volume_astar(wall_with_a_door(1.0), heuristic="octil")
