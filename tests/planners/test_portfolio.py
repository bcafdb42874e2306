"""What holds for every planner of the registry: straight lines, free space by Shapely, and hard cases."""

from functools import cache, partial

import numpy as np
import pytest
from scipy.ndimage import label

from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import PLANNERS
from tests.free_space import Obstacles

OCTILE = np.sqrt(4 - 2 * np.sqrt(2)) - 1  # 8.24 %: paths of eight directions, at 22.5 degrees between two of them
EXACT = 1e-9
# How much longer than the straight line a planner's path may be on an empty map.
DISCRETISATION = {
    "ptp": EXACT,
    "astar-dist": OCTILE,
    "astar-plus": OCTILE,
    "bitstar-dist": EXACT,  # the first batch is the straight segment
    "bitstar-plus": EXACT,
    "theta-star": EXACT,
}
LINE_ONLY = ("theta-star",)  # refuses the `cell` model on maps with costs
SIDE_M = 5.0
RUNS = [(name, model) for name in PLANNERS for model in ("cell", "line") if model == "line" or name not in LINE_ONLY]


def run(name: str, problem: Problem, seed: int = 0, num_samples: int = 300) -> Path:
    """The planner's answer; samplers end after so many samples, so that every run repeats."""
    options = {"budget_s": 60.0}
    if name.startswith("bitstar"):
        options = {"budget_s": np.inf, "max_samples": num_samples}
    return PLANNERS[name].run(problem, seed=seed, **options)


def problem_on(is_free, start, goal, layers=None, model="line", distance_weight=1.0, **options) -> Problem:
    layers = np.zeros((1, *is_free.shape)) if layers is None else layers
    return Problem(layers, is_free, start, goal, SIDE_M, distance_weight, CostModel(model, **options))


@cache
def city_map(seed: int) -> tuple[np.ndarray, np.ndarray, Obstacles, np.ndarray]:
    """Free cells, cost layers, obstacles and islands of scattered blocks, single cells and thin walls."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(24, 48, 2))
    is_free = rng.random(shape) < 0.93
    for row, col in rng.integers(0, shape, (8, 2)):
        is_free[row : row + rng.integers(1, 9), col : col + rng.integers(1, 9)] = False
    is_free[rng.integers(shape[0]), : shape[1] // 2] = False
    layers = np.where(is_free, rng.random((2, *shape)) ** 2, np.nan)
    return is_free, layers, Obstacles(is_free, SIDE_M), label(is_free)[0]


def test_the_check_sees_a_cut_corner_and_one_between_two_obstacles_and_no_other_touched_one():
    is_free = np.ones((4, 4), bool)
    is_free[1, 2] = False
    obstacles = Obstacles(is_free, SIDE_M)
    assert obstacles.crossed_m(np.array([[7.5, 2.5], [17.5, 12.5]])) > 3
    through_corner = np.array([[7.5, 7.5], [12.5, 12.5]])
    assert obstacles.crossed_m(through_corner) == 0
    assert not obstacles.is_pinched(through_corner)
    is_free[2, 1] = False
    assert Obstacles(is_free, SIDE_M).is_pinched(through_corner)
    assert obstacles.crossed_m(np.array([[2.5, 2.5], [-1.5, 2.5]])) == pytest.approx(1.5)


def check_random_query(number: int) -> bool:
    """Whether a path was found, after all that must hold of the answer was asserted."""
    name, model = RUNS[number % len(RUNS)]
    is_free, layers, obstacles, islands = city_map(number // len(RUNS) % 20)
    rng = np.random.default_rng(number)
    start, goal = (tuple(int(v) for v in cell) for cell in rng.choice(np.argwhere(is_free), 2))
    weights = rng.dirichlet(np.ones(3))
    problem = problem_on(is_free, start, goal, weights[1:, None, None] * layers, model, weights[0] / SIDE_M)
    path = run(name, problem, seed=number)
    if not path.status.has_path:
        assert (len(path.points_m), path.cost) == (0, np.inf)
        if path.status is Status.BLOCKED:
            centres_m = (np.array([start, goal])[:, ::-1] + 0.5) * SIDE_M
            assert obstacles.crossed_m(centres_m) > 1e-6 or obstacles.is_pinched(centres_m)
        elif path.status is Status.NO_PATH:
            assert islands[start] != islands[goal]
        else:
            assert name.startswith("bitstar")
        return False
    assert islands[start] == islands[goal]
    assert obstacles.crossed_m(path.points_m) < 1e-6
    assert not obstacles.is_pinched(path.points_m)
    np.testing.assert_allclose(path.points_m[[0, -1]], (np.array([start, goal])[:, ::-1] + 0.5) * SIDE_M)
    assert path.cost == problem.cost_of(path.points_m) < np.inf
    assert path.lower_bound <= path.cost
    return True


@pytest.mark.parametrize("name", PLANNERS)
def test_an_empty_map_costs_the_straight_line_within_the_planners_discretisation(name):
    is_free = np.ones((80, 90), bool)
    excess = []
    for goal in ((9, 2), (9, 80), (38, 72), (70, 33), (60, 53)):
        problem = problem_on(is_free, (9, 2), goal)
        straight_m = SIDE_M * np.hypot(goal[0] - 9, goal[1] - 2)
        excess.append(run(name, problem).cost / straight_m - 1 if straight_m else run(name, problem).cost)
    assert min(excess) >= -EXACT
    assert max(excess) <= DISCRETISATION[name] + EXACT
    if DISCRETISATION[name] == OCTILE:
        assert max(excess) > 0.99 * OCTILE  # 29 rows for 70 columns lie at 22.5 degrees


@pytest.mark.parametrize("name", PLANNERS)
def test_even_costs_count_along_the_line_within_the_planners_discretisation(name):
    problem = problem_on(np.ones((30, 40), bool), (2, 3), (14, 32), np.full((2, 30, 40), 0.4), distance_weight=0.1)
    straight_m = SIDE_M * np.hypot(12, 29)
    ratio = run(name, problem).cost / (straight_m * (0.1 + 0.8 / 5.0))
    assert 1 - EXACT <= ratio <= 1 + DISCRETISATION[name] + EXACT


def test_paths_of_random_queries_keep_to_free_cells_by_shapely():
    num_queries = 10 * len(RUNS)
    assert sum(check_random_query(k) for k in range(num_queries)) > 0.6 * num_queries


@pytest.mark.slow
def test_paths_of_2000_random_queries_keep_to_free_cells_by_shapely():
    assert sum(check_random_query(k) for k in range(2000)) > 1200


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_start_at_the_goal_costs_nothing(name, model):
    is_free, layers, _, _ = city_map(0)
    cell = tuple(int(v) for v in np.argwhere(is_free)[40])
    path = run(name, problem_on(is_free, cell, cell, layers, model))
    assert (path.status.has_path, path.status.exit_code, path.cost) == (True, 0, 0.0)
    np.testing.assert_allclose(path.points_m, (np.array([cell])[:, ::-1] + 0.5) * SIDE_M)


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_paths_along_the_border_stay_on_the_map(name, model):
    is_free = np.ones((12, 15), bool)
    is_free[1:-1, 1:-1] = False
    layers = np.random.default_rng(3).random((1, 12, 15))
    for start, goal in (((0, 0), (0, 14)), ((11, 14), (0, 14)), ((5, 0), (11, 0))):
        path = run(name, problem_on(is_free, start, goal, layers, model))
        assert path.status.has_path
        assert Obstacles(is_free, SIDE_M).crossed_m(path.points_m) < 1e-6
    for start, goal in (((0, 0), (11, 14)), ((11, 0), (0, 3))):
        path = run(name, problem_on(is_free, start, goal, layers, model), num_samples=2000)
        assert path.status.has_path is (name != "ptp")


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_a_goal_in_a_closed_court_is_not_reached(name, model):
    is_free = np.ones((20, 20), bool)
    is_free[8:15, 8:15] = False
    is_free[10:13, 10:13] = True
    path = run(name, problem_on(is_free, (2, 2), (11, 11), np.ones((1, 20, 20)), model))
    assert path.status is (Status.BLOCKED if name == "ptp" else Status.NO_PATH)
    assert (path.status.exit_code, path.cost, len(path.points_m)) == (3, np.inf, 0)
    out = run(name, problem_on(is_free, (11, 11), (2, 2), np.ones((1, 20, 20)), model))
    assert out.status.exit_code == 3


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_corridors_one_cell_wide_are_flown(name, model):
    is_free = np.zeros((9, 30), bool)
    is_free[4, 2:28] = True
    straight = run(name, problem_on(is_free, (4, 2), (4, 27), model=model))
    assert straight.cost == pytest.approx(25 * SIDE_M)
    is_free[4, 15:] = False
    is_free[2:5, 15] = is_free[2, 15:28] = True
    path = run(name, problem_on(is_free, (4, 2), (2, 27), model=model), num_samples=3000)
    if name == "ptp":
        assert path.status is Status.BLOCKED
        return
    # Through cell centres; the taut string bends at the corridor's inner corners (15, 4) and (16, 3).
    taut = np.hypot(12.5, 0.5) + np.sqrt(2) + np.hypot(11.5, 0.5)
    assert SIDE_M * taut * (1 - EXACT) <= path.cost <= SIDE_M * 27
    assert Obstacles(is_free, SIDE_M).crossed_m(path.points_m) < 1e-6


@pytest.mark.parametrize("diagonal", ["both-free", "always"])
@pytest.mark.parametrize("name", PLANNERS)
def test_a_corridor_of_corners_follows_the_diagonal_rule(name, diagonal):
    is_free = np.eye(12, dtype=bool)
    path = run(name, problem_on(is_free, (1, 1), (10, 10), diagonal=diagonal))
    if diagonal == "both-free":
        assert path.status is (Status.BLOCKED if name == "ptp" else Status.NO_PATH)
    else:  # the straight line touches obstacles at corners only
        assert path.cost == pytest.approx(SIDE_M * np.hypot(9, 9))


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_weights_of_zero_are_weights(name, model):
    is_free, layers, obstacles, islands = city_map(1)
    joined = np.argwhere(islands == np.bincount(islands[is_free]).argmax())
    start, goal = (tuple(int(v) for v in cell) for cell in (joined[3], joined[-3]))
    problem = partial(problem_on, is_free, start, goal, model=model)
    for case, expects_zero in (
        (problem(distance_weight=0.0), True),
        (problem(layers=layers, distance_weight=0.0), False),
        (problem(layers=layers * np.array([0, 1])[:, None, None]), False),
    ):
        path = run(name, case, num_samples=1000)
        if name == "ptp":
            assert path.status is Status.BLOCKED
            continue
        assert path.status.has_path
        assert obstacles.crossed_m(path.points_m) < 1e-6
        assert (path.cost == 0) is expects_zero
        assert path.cost == case.cost_of(path.points_m)


@pytest.mark.parametrize("wrong", [np.nan, -0.1, np.inf])
def test_costs_that_are_no_costs_are_refused_before_any_planner_runs(wrong):
    is_free = np.ones((6, 6), bool)
    layers = np.ones((2, 6, 6))
    layers[1, 3, 3] = wrong
    with pytest.raises(InputError, match="costs must be finite and not negative on free cells"):
        problem_on(is_free, (0, 0), (5, 5), layers)
    with pytest.raises(InputError, match="weights must be 2 finite numbers that are not negative"):
        problem_on(is_free, (0, 0), (5, 5), distance_weight=wrong)


@pytest.mark.parametrize("name", PLANNERS)
def test_the_cell_model_is_taken_or_refused_with_the_remedy(name):
    problem = problem_on(np.ones((4, 4), bool), (0, 0), (3, 3), np.ones((1, 4, 4)), "cell")
    if name not in LINE_ONLY:
        assert run(name, problem).status.has_path
        return
    with pytest.raises(InputError, match="cost_model='line'"):
        run(name, problem)


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_costs_never_rise_and_seeds_repeat(name, model):
    is_free, layers, _, islands = city_map(2)
    joined = np.argwhere(islands == np.bincount(islands[is_free]).argmax())
    start, goal = (tuple(int(v) for v in cell) for cell in (joined[5], joined[-9]))
    problem = problem_on(is_free, start, goal, layers, model, 0.1)
    first, again = run(name, problem, seed=4, num_samples=1500), run(name, problem, seed=4, num_samples=1500)
    np.testing.assert_array_equal(first.points_m, again.points_m)
    assert (first.cost, first.num_expanded) == (again.cost, again.num_expanded)
    assert [entry[1:] for entry in first.history] == [entry[1:] for entry in again.history]
    costs = [cost for _, _, cost in first.history]
    assert all(np.less_equal(costs[1:], costs[:-1]))
    if costs:
        assert first.cost == pytest.approx(costs[-1], rel=1e-9)
