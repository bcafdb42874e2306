"""A*: against SciPy's Dijkstra, MovingAI's published lengths, and small maps done by hand."""

import itertools
import time

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.errors import InputError
from jaxurban.planners import grid_search as search_module
from jaxurban.planners.astar import ADMISSIBLE, HEURISTICS, astar, astar_dist, astar_plus, heuristic_at, make_heuristic
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import PLANNERS, find_planner

VARIANTS = list(itertools.product(["cell", "line"], ["both-free", "always"], [8, 4]))


def random_problem(seed, cost_model, diagonal, connectivity, shape=(13, 17)):
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < 0.75
    free = np.argwhere(is_free)
    start, goal = (tuple(int(v) for v in free[k]) for k in rng.choice(len(free), 2, replace=False))
    layers = rng.random((3, *shape)) ** 3 * np.array([2.0, 1.0, 0.5])[:, None, None]
    layers = np.where(is_free, layers, np.nan) if seed % 2 else layers
    return Problem(layers, is_free, start, goal, 2.0, 0.3, CostModel(cost_model, 3.0, connectivity, diagonal))


def graph_of(problem):
    """Every edge of the problem's grid, by the definition, for SciPy."""
    num_rows, num_cols = problem.is_free.shape
    cost = problem.cost
    origins, targets, weights = [], [], []

    def free(row, col):
        return 0 <= row < num_rows and 0 <= col < num_cols and problem.is_free[row, col]

    for row, col in np.argwhere(problem.is_free):
        for rows, cols in itertools.product((-1, 0, 1), repeat=2):
            to = (row + rows, col + cols)
            is_diagonal = rows != 0 and cols != 0
            if (rows, cols) == (0, 0) or not free(*to) or (is_diagonal and problem.cost_model.connectivity == 4):
                continue
            if (
                is_diagonal
                and problem.cost_model.diagonal == "both-free"
                and not (free(row, to[1]) and free(to[0], col))
            ):
                continue
            length_m = problem.resolution_m * np.hypot(rows, cols)
            if problem.cost_model.kind == "cell":
                map_cost = cost[to]
            else:
                map_cost = length_m * (cost[row, col] + cost[to]) / 2 / problem.cost_model.reference_length_m
            origins.append(row * num_cols + col)
            targets.append(to[0] * num_cols + to[1])
            weights.append(problem.distance_weight * length_m + map_cost)
    size = num_rows * num_cols
    return csr_array((weights, (origins, targets)), shape=(size, size))


def exact_cost_to_go(problem):
    """Cost from every cell to the goal, by SciPy."""
    goal = problem.goal[0] * problem.is_free.shape[1] + problem.goal[1]
    return dijkstra(graph_of(problem).T, indices=goal).reshape(problem.is_free.shape)


@pytest.mark.parametrize(("cost_model", "diagonal", "connectivity"), VARIANTS)
def test_cost_equals_scipy_dijkstra_and_bounds_never_exceed_it(cost_model, diagonal, connectivity):
    for seed in range(6):
        problem = random_problem(seed, cost_model, diagonal, connectivity)
        cost_to_go = exact_cost_to_go(problem)
        optimum = cost_to_go[problem.start]
        for name in ADMISSIBLE:
            heuristic = make_heuristic(name, problem)
            for row, col in np.argwhere(problem.is_free):
                assert heuristic_at(heuristic, (row, col), problem.goal) <= cost_to_go[row, col] + 1e-9
            path = astar(problem, heuristic=name)
            if np.isinf(optimum):
                assert path.status is Status.NO_PATH
                assert path.lower_bound == np.inf
                assert path.points_m.shape == (0, 2)
                continue
            assert path.status is Status.OPTIMAL
            assert path.cost == pytest.approx(optimum, rel=1e-12)
            assert path.lower_bound == path.cost
            assert problem.features(path.points_m).is_valid


@pytest.mark.parametrize(("cost_model", "diagonal", "connectivity"), VARIANTS)
def test_admissible_heuristics_are_consistent(cost_model, diagonal, connectivity):
    problem = random_problem(11, cost_model, diagonal, connectivity)
    graph = graph_of(problem).tocoo()
    num_cols = problem.is_free.shape[1]
    for name in ADMISSIBLE:
        heuristic = make_heuristic(name, problem)
        values = [heuristic_at(heuristic, divmod(node, num_cols), problem.goal) for node in range(problem.cost.size)]
        for origin, target, weight in zip(graph.row, graph.col, graph.data, strict=True):
            if np.isfinite(values[target]):
                assert values[origin] <= weight + values[target] + 1e-12


def test_better_bounds_expand_fewer_nodes():
    rng = np.random.default_rng(4)
    layers = 0.5 + rng.random((1, 120, 90))
    problem = Problem(layers, np.ones((120, 90), bool), (5, 5), (110, 40), 1.0, 1.0, "cell")
    counts = [astar(problem, heuristic=name).num_expanded for name in ("none", "euclidean", "octile", "tiles")]
    assert counts == sorted(counts, reverse=True)


@pytest.mark.data
@pytest.mark.parametrize("name", [pytest.param("NewYork_0_512", marks=pytest.mark.slow), "Berlin_0_256"])
@pytest.mark.parametrize("search", [astar, pytest.param(astar_plus, marks=pytest.mark.slow)])
def test_every_published_length_of_movingai_is_reproduced(data_dir, name, search):
    rows = (data_dir / "movingai" / f"{name}.map").read_text().splitlines()[4:]
    is_free = np.array([list(row) for row in rows[::-1]]) == "."  # the file's first row is the northern one
    problem = None
    num_checked = 0
    for line in (data_dir / "movingai" / f"{name}.map.scen").read_text().splitlines()[1:]:
        x0, y0, x1, y1, length = line.split()[4:]
        start, goal = (len(rows) - 1 - int(y0), int(x0)), (len(rows) - 1 - int(y1), int(x1))
        if problem is None:
            problem = Problem(np.zeros((1, *is_free.shape)), is_free, start, goal, 1.0, 1.0)
        path = search(problem.between(start, goal))
        assert path.status is Status.OPTIMAL
        assert path.cost == pytest.approx(float(length), abs=1e-3)
        num_checked += 1
    assert num_checked == {"NewYork_0_512": 1790, "Berlin_0_256": 930}[name]


# A wall of cost 5 between the southern corners, open only in the northern row.
WALL = np.array([[0.0, 5.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize(("name", "start", "goal"), [("plus-printed", 0, 2), ("plus-printed-from-0", 2, 0)])
@pytest.mark.parametrize("reopen", [True, False])
def test_the_printed_h_plus_misses_the_way_around_a_wall(name, start, goal, reopen):
    problem = Problem(WALL[None], np.ones((3, 3), bool), (0, start), (0, goal), 1.0, 1.0, "cell")
    printed = astar(problem, heuristic=name, reopen=reopen)
    assert printed.cost == pytest.approx(5 + 2)
    assert printed.status is Status.FEASIBLE
    assert printed.lower_bound == pytest.approx(2)
    exact = astar_plus(problem)
    assert exact.cost == pytest.approx(2 + 2 * np.sqrt(2))
    cells = np.floor(exact.points_m[:, ::-1]).astype(int).tolist()
    assert cells == [[0, start], [1, start], [2, 1], [1, goal], [0, goal]]
    # North of the start the box ends at row 1, so the printed value counts the wall, which the path goes around.
    north = (1, start)
    assert heuristic_at(make_heuristic(name, problem), north, problem.goal) == pytest.approx(5 + 1 + np.sqrt(2))
    assert exact_cost_to_go(problem)[north] == pytest.approx(1 + 2 * np.sqrt(2))


def test_the_printed_h_plus_is_inconsistent_where_the_goal_lies_west():
    problem = Problem(np.array([[[0.0, 0.0, 5.0]]]), np.ones((1, 3), bool), (0, 2), (0, 0), 1.0, 1.0, "cell")
    heuristic = make_heuristic("plus-printed", problem)
    values = [heuristic_at(heuristic, (0, col), (0, 0)) for col in range(3)]
    assert values == [0, 1, 7]  # the step from the last to the middle cell costs 1, the value falls by 6
    np.testing.assert_array_equal(exact_cost_to_go(problem)[0], [0, 1, 2])


@pytest.mark.parametrize("name", HEURISTICS)
@pytest.mark.parametrize("planner", [astar_dist, astar_plus])
def test_start_at_the_goal_is_a_path_of_one_point(planner, name):
    path = planner(Problem(WALL[None], np.ones((3, 3), bool), (1, 1), (1, 1), 2.0, 1.0), heuristic=name)
    np.testing.assert_array_equal(path.points_m, [[3.0, 3.0]])
    assert path.cost == 0
    assert path.status.has_path


def test_all_weights_zero_gives_a_path_that_says_so():
    path = astar_plus(Problem(np.zeros((1, 3, 3)), np.ones((3, 3), bool), (0, 0), (2, 2), 1.0, 0.0))
    assert (path.cost, path.status) == (0, Status.OPTIMAL)
    assert "costs nothing" in path.note


def test_a_goal_in_a_closed_court_is_proven_unreachable():
    is_free = np.ones((9, 9), bool)
    is_free[3:6, 3:6] = False
    is_free[4, 4] = True
    for name in HEURISTICS:
        path = astar(Problem(np.ones((1, 9, 9)), is_free, (0, 0), (4, 4), 1.0, 1.0), heuristic=name)
        assert path.status is Status.NO_PATH
        assert path.cost == np.inf
        # Landmarks and costs to go know it beforehand.
        assert path.num_expanded == (0 if name in ("landmarks", "exact") else 81 - 9)


def test_a_diagonal_slips_between_obstacles_only_where_allowed():
    is_free = np.eye(3, dtype=bool)
    options = {"costs": np.zeros((1, 3, 3)), "is_free": is_free, "start": (0, 0), "goal": (2, 2)}
    assert astar(Problem(**options, resolution_m=1.0, weights=1.0)).status is Status.NO_PATH
    path = astar(Problem(**options, resolution_m=1.0, weights=1.0, cost_model=CostModel(diagonal="always")))
    assert path.cost == pytest.approx(2 * np.sqrt(2))


def test_one_cell_corridors_are_followed():
    is_free = np.ones((9, 9), bool)
    is_free[1::4, :-1] = False
    is_free[3::4, 1:] = False
    path = astar(Problem(np.zeros((1, 9, 9)), is_free, (0, 0), (8, 8), 1.0, 1.0))
    assert path.cost == 5 * 8 + 8  # five runs of eight steps, and eight steps up between them


def test_a_spent_budget_leaves_a_lower_bound_and_no_path(monkeypatch):
    monkeypatch.setattr(search_module, "CHUNK", 50)
    layers = np.random.default_rng(0).random((1, 60, 60))
    problem = Problem(layers, np.ones((60, 60), bool), (0, 0), (59, 59), 1.0, 1.0)
    optimum = astar(problem).cost
    for name in HEURISTICS:
        astar(problem, heuristic=name)  # makes what it needs beforehand
        path = astar(problem, heuristic=name, budget_s=1e-9)
        assert path.status is Status.BUDGET_EMPTY
        assert path.num_expanded == 50
        assert path.points_m.shape == (0, 2)
        assert 0 <= path.lower_bound <= optimum
    assert astar(problem, heuristic="octile", budget_s=1e-9).lower_bound > 59 * np.sqrt(2)


def test_chunks_and_a_growing_queue_change_nothing(monkeypatch):
    problem = random_problem(3, "cell", "always", 8, shape=(60, 70))
    whole = astar(problem)
    monkeypatch.setattr(search_module, "CHUNK", 7)
    monkeypatch.setattr(search_module, "FIRST_ENTRIES", 8)
    pieces = astar(problem)
    np.testing.assert_array_equal(pieces.points_m, whole.points_m)
    assert pieces.num_expanded == whole.num_expanded


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_costs_orders_of_magnitude_apart_are_taken_in_their_order(cost_model):
    rng = np.random.default_rng(6)
    layers = 10 ** rng.uniform(-6, 9, (1, 12, 60))
    for distance_weight in (0.0, 1e-3, 1e6):
        problem = Problem(
            layers, np.ones((12, 60), bool), (1, 2), (10, 55), 2.0, distance_weight, CostModel(cost_model, 3.0)
        )
        optimum = exact_cost_to_go(problem)[problem.start]
        for name in ("none", "octile", "tiles"):
            path = astar(problem, heuristic=name)
            assert path.cost == pytest.approx(optimum, rel=1e-12)
            assert path.num_expanded < problem.cost.size


def test_the_clock_is_read_often_enough_for_a_small_budget():
    problem = Problem(np.zeros((1, 1500, 1500)), np.ones((1500, 1500), bool), (0, 0), (1499, 1400), 1.0, 1.0)
    astar(problem.between((0, 0), (1, 1)), heuristic="none")
    begin_s = time.perf_counter()
    assert astar(problem, heuristic="none", budget_s=0.05).status is Status.BUDGET_EMPTY
    assert time.perf_counter() - begin_s < 1.0


def test_reopening_mends_part_of_what_an_inconsistent_heuristic_breaks():
    costs = np.zeros((2, 2))
    for seed in range(60):
        problem = random_problem(seed, "cell", "both-free", 8)
        if astar(problem).status is Status.OPTIMAL:
            for k, options in enumerate([{}, {"reopen": True}]):
                costs[k] += astar(problem, heuristic="plus-printed", **options).cost, astar(problem).cost
    assert costs[0, 0] > costs[1, 0] > costs[1, 1]


def test_planners_by_name_run_with_their_own_heuristic():
    problem = random_problem(2, "line", "both-free", 8)
    for name, entry in PLANNERS.items():
        ran = find_planner(name)(problem, budget_s=0.2, seed=0).heuristic
        assert ran == ("tiles" if entry.default_heuristic == "auto" else entry.default_heuristic)
    path = find_planner("astar-plus", "octile")(problem, budget_s=0.2, seed=3)
    assert (path.planner, path.heuristic, path.backend) == ("astar-plus", "octile", "numba")


@pytest.mark.parametrize(
    ("name", "heuristic", "message"),
    [
        ("astar-pluss", None, "unknown planner 'astar-pluss' .did you mean 'astar-plus'"),
        ("astar-dist", "octil", "takes no heuristic 'octil' .did you mean 'octile'"),
        ("ptp", "octile", "planner 'ptp' takes no heuristic 'octile': leave it out"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest_one(name, heuristic, message):
    with pytest.raises(InputError, match=message):
        find_planner(name, heuristic)


def test_an_unknown_heuristic_is_refused_with_the_nearest_one():
    with pytest.raises(InputError, match="did you mean 'plus-printed'"):
        astar(random_problem(2, "cell", "both-free", 8), heuristic="plus-print")
