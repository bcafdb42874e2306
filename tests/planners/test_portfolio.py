"""What holds for every planner of the registry, refined and simplified: free space by Shapely, and hard cases."""

import time
from functools import cache, partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, label
from shapely import LineString, hausdorff_distance

from jaxurban.errors import InputError
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.refine import refine
from jaxurban.planners.registry import PLANNERS
from jaxurban.planners.simplify import CLEAR_M, simplify_path
from tests.free_space import Obstacles

OCTILE = (
    np.sqrt(4 - 2 * np.sqrt(2)) - 1
)  # 8.24 %: paths of eight directions, at 22.5 degrees between two of them
EXACT = 1e-9
# How much longer than the straight line a planner's path may be on an empty map; BIT*'s first batch is that line.
DISCRETISATION = {name: OCTILE if name.startswith("astar") else EXACT for name in PLANNERS}
LINE_ONLY = ("theta-star",)  # refuses the `cell` model on maps with costs
SIDE_M = 5.0
HALF_ROUNDING_M = 0.0079  # of the seventh decimal of a degree, at the equator, in both coordinates
RUNS = [
    (name, model)
    for name in PLANNERS
    for model in ("cell", "line")
    if model == "line" or name not in LINE_ONLY
]


def run(name: str, problem: Problem, seed: int = 0, num_samples: int = 300, **options) -> Path:
    """The planner's answer; samplers end after so many samples, so that every run repeats."""
    options |= (
        {"budget_s": np.inf, "max_samples": num_samples}
        if name.startswith("bitstar")
        else {"budget_s": 60.0}
    )
    return PLANNERS[name].run(problem, seed=seed, **options)


def problem_on(
    is_free, start, goal, layers=None, model="line", distance_weight=1.0, **options
) -> Problem:
    layers = np.zeros((1, *is_free.shape)) if layers is None else layers
    return Problem(
        layers, is_free, start, goal, SIDE_M, distance_weight, CostModel(model, **options)
    )


@cache
def city_map(seed: int) -> tuple[np.ndarray, np.ndarray, Obstacles]:
    """Free cells, cost layers and obstacles: of blobs, or scattered blocks, single cells, thin and diagonal walls."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(24, 48, 2))
    if seed % 2:
        noise = gaussian_filter(rng.normal(size=shape), 1.2)
        is_free = noise > np.quantile(noise, 0.28)
    else:
        is_free = rng.random(shape) < 0.93
        for row, col in rng.integers(0, shape, (8, 2)):
            is_free[row : row + rng.integers(1, 9), col : col + rng.integers(1, 9)] = False
        is_free[rng.integers(shape[0]), : shape[1] // 2] = False
        for row, col in rng.integers(0, 18, (2, 2)):
            is_free[row : row + 6, col : col + 6] = ~np.eye(6, dtype=bool)[:: rng.choice([-1, 1])]
    layers = np.where(is_free, rng.random((2, *shape)) ** 2, np.nan)
    return is_free, layers, Obstacles(is_free, SIDE_M)


def ends_in_one_part(is_free: np.ndarray, at: int) -> list[tuple[int, int]]:
    """Return two cells of the largest part of a map, so many from its first and its last one."""
    islands, _ = label(is_free)
    joined = np.argwhere(islands == np.bincount(islands[is_free]).argmax())
    return [tuple(map(int, joined[k])) for k in (at, -at)]


def test_the_check_sees_a_cut_corner_and_one_between_two_obstacles_and_no_other_touched_one():
    is_free = np.ones((4, 4), bool)
    is_free[1, 2] = False
    obstacles = Obstacles(is_free, SIDE_M)
    assert obstacles.crossed_m(np.array([[7.5, 2.5], [17.5, 12.5]])) > 3
    through_corner = np.array([[7.5, 7.5], [12.5, 12.5]])
    assert (obstacles.crossed_m(through_corner), obstacles.is_pinched(through_corner)) == (0, False)
    is_free[2, 1] = False
    assert Obstacles(is_free, SIDE_M).is_pinched(through_corner)
    assert obstacles.crossed_m(np.array([[2.5, 2.5], [-1.5, 2.5]])) == pytest.approx(1.5)


def check_simplified(
    problem: Problem, path: Path, obstacles: Obstacles, tolerance_m: float
) -> bool:
    """Whether it keeps clear of closed cells, after what must hold of a simplified path was asserted."""
    simple = simplify_path(problem, path, tolerance_m)
    assert simple.cost == problem.cost_of(simple.points_m) < np.inf
    assert simple.lower_bound <= simple.cost
    np.testing.assert_array_equal(simple.points_m[[0, -1]], path.points_m[[0, -1]])
    if len(simple.points_m) == 1:
        return True
    line = LineString(simple.points_m)
    assert hausdorff_distance(line, LineString(path.points_m), densify=0.02) <= tolerance_m + 1e-6
    if "pass nearer" in simple.note:
        return False
    assert not obstacles.is_near(simple.points_m, CLEAR_M * (1 - 1e-6))
    # Whichever way rounding moves each point, no leg enters a cell that is closed.
    moved = np.random.default_rng(0).choice(
        [-HALF_ROUNDING_M, HALF_ROUNDING_M], simple.points_m.shape
    )
    assert obstacles.crossed_m(simple.points_m + moved) == 0.0
    return True


def check_random_query(number: int) -> tuple[bool, bool]:
    """Whether a path was found, and refined to a cheaper one, after all that must hold of both was asserted."""
    (name, model), city = RUNS[number % len(RUNS)], number // len(RUNS) % 20
    is_free, layers, obstacles = city_map(city)
    rng = np.random.default_rng(number)
    start, goal = (tuple(int(v) for v in cell) for cell in rng.choice(np.argwhere(is_free), 2))
    weights, diagonal = rng.dirichlet(np.ones(3)), ("both-free", "always")[city // 2 % 2]
    layers = weights[1:, None, None] * layers
    problem = problem_on(
        is_free, start, goal, layers, model, weights[0] / SIDE_M, diagonal=diagonal
    )
    islands, _ = label(is_free, np.ones((3, 3)) if diagonal == "always" else None)
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
        return False, False
    assert islands[start] == islands[goal]
    refined = refine(problem, path) if model == "line" else path
    for found in (path, refined):
        assert obstacles.crossed_m(found.points_m) < 1e-6
        assert diagonal == "always" or not obstacles.is_pinched(found.points_m)
        np.testing.assert_allclose(
            found.points_m[[0, -1]], (np.array([start, goal])[:, ::-1] + 0.5) * SIDE_M
        )
        assert found.cost == problem.cost_of(found.points_m) < np.inf
        assert found.lower_bound <= found.cost
        is_clear = check_simplified(problem, found, obstacles, (0.3, 2.5)[number % 2])
        assert is_clear or city % 2 == 0 or diagonal == "always"
    assert (refined.cost, refined.planner) <= (path.cost, path.planner)
    is_cheaper = refined.cost < path.cost * (1 - 1e-9)
    if is_cheaper:
        gain = f"{1 - refined.cost / path.cost:.2%}"
        assert refined.note.startswith(f"Refinement lowered what the search minimises by {gain}")
        assert refined.status in (Status.OPTIMAL, Status.FEASIBLE, Status.BUDGET_FEASIBLE)
    if name == "theta-star":
        assert path.cost <= run("astar-dist", problem).cost * (1 + 1e-9)
    return True, is_cheaper


@pytest.mark.slow
def test_paths_of_random_queries_refined_and_simplified_keep_to_free_cells_by_shapely():
    num_queries = 1000
    num_found, num_cheaper = np.sum([check_random_query(k) for k in range(num_queries)], axis=0)
    assert num_found > 0.6 * num_queries
    assert num_cheaper > 0.2 * num_queries


@pytest.mark.parametrize("name", PLANNERS)
def test_an_empty_map_costs_the_straight_line_within_the_planners_discretisation(name):
    is_free = np.ones((80, 90), bool)
    excess = []
    for goal in ((9, 2), (9, 80), (38, 72), (70, 33), (60, 53)):
        problem = problem_on(is_free, (9, 2), goal)
        straight_m, path = SIDE_M * np.hypot(goal[0] - 9, goal[1] - 2), run(name, problem)
        excess.append(path.cost / straight_m - 1 if straight_m else path.cost)
        if name in ("bitstar-dist", "bitstar-plus", "theta-star"):
            assert (path.status, len(path.points_m)) == (Status.OPTIMAL, 1 + (straight_m > 0))
            simple = simplify_path(problem, path, 1.0)
            assert (simple.status, simple.points_m.tolist()) == (
                path.status,
                path.points_m.tolist(),
            )
        refined = refine(problem, path)
        assert refined.cost == pytest.approx(straight_m, rel=1e-9)
        assert name == "ptp" or refined.status is Status.OPTIMAL
    assert min(excess) >= -EXACT
    assert max(excess) <= DISCRETISATION[name] + EXACT
    if DISCRETISATION[name] == OCTILE:
        assert max(excess) > 0.99 * OCTILE  # 29 rows for 70 columns lie at 22.5 degrees


@pytest.mark.parametrize("name", PLANNERS)
def test_even_costs_count_along_the_line_within_the_planners_discretisation(name):
    problem = problem_on(
        np.ones((30, 40), bool), (2, 3), (14, 32), np.full((2, 30, 40), 0.4), distance_weight=0.1
    )
    expected, path = SIDE_M * np.hypot(12, 29) * (0.1 + 0.8 / 5.0), run(name, problem)
    refined = refine(problem, path)
    assert refined.cost == pytest.approx(expected, rel=EXACT)
    assert 1 - EXACT <= path.cost / expected <= 1 + DISCRETISATION[name] + EXACT
    unproven = {"ptp": Status.FEASIBLE, "bitstar-dist": Status.BUDGET_FEASIBLE}
    assert path.status is refined.status is unproven.get(name, Status.OPTIMAL)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "model"), RUNS)
def test_start_at_the_goal_costs_nothing(name, model):
    is_free, layers, _ = city_map(0)
    cell = tuple(int(v) for v in np.argwhere(is_free)[40])
    problem = problem_on(is_free, cell, cell, layers, model)
    for options in [{}, *({"heuristic": heuristic} for heuristic in PLANNERS[name].heuristics)]:
        path = run(name, problem, **options)
        assert (path.status.has_path, path.status.exit_code, path.cost) == (True, 0, 0.0)
        np.testing.assert_allclose(path.points_m, (np.array([cell])[:, ::-1] + 0.5) * SIDE_M)
        assert simplify_path(problem, path, 1.0).points_m.tolist() == path.points_m.tolist()
        assert model == "cell" or refine(problem, path).cost == 0


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
    problem = problem_on(is_free, (2, 2), (11, 11), np.ones((1, 20, 20)), model)
    for options in [{}, *({"heuristic": heuristic} for heuristic in PLANNERS[name].heuristics)]:
        path = run(name, problem, **options)
        assert path.status is (Status.BLOCKED if name == "ptp" else Status.NO_PATH)
        assert (path.status.exit_code, path.cost, len(path.points_m)) == (3, np.inf, 0)
    for altered in (
        simplify_path(problem, path, 1.0),
        path if model == "cell" else refine(problem, path),
    ):
        assert vars(altered) | {"setup_s": path.setup_s} == vars(
            path
        )  # the first one of a process compiles
    assert run(name, problem.between((11, 11), (2, 2))).status.exit_code == 3


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
    longest = 27 if name.startswith("astar") else 1.02 * taut
    assert taut * (1 - EXACT) <= path.cost / SIDE_M <= longest
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
    if not name.startswith(
        "astar"
    ):  # which round a corner by two steps: one obstacle is passed at its corner
        one = run(
            name,
            problem_on(np.array([[True, False], [True, True]]), (0, 0), (1, 1), diagonal=diagonal),
        )
        assert one.cost == pytest.approx(SIDE_M * np.sqrt(2))


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_neither_a_planner_nor_refinement_takes_a_short_cut_through_a_diagonal_wall(name, model):
    is_free = ~np.eye(9, dtype=bool)
    layers = np.random.default_rng(0).random((1, 9, 9))
    always = problem_on(is_free, (6, 3), (3, 6), layers, model, 0.1, diagonal="always")
    through, closed = (
        run(name, always),
        run(name, problem_on(is_free, (6, 3), (3, 6), layers, model, 0.1)),
    )
    assert closed.status is (Status.BLOCKED if name == "ptp" else Status.NO_PATH)
    assert through.cost < np.inf
    if model == "cell":
        return
    is_free[-1, -1] = True  # the way around
    problem = problem_on(is_free, (6, 3), (3, 6), layers, model, 0.1)
    with pytest.raises(InputError, match="passes between two closed ones that touch at a corner"):
        refine(problem, through)
    path = run(name, problem)
    if name == "ptp":
        assert path.status is Status.BLOCKED
        return
    wall, refined = LineString([[0.0, 0.0], [5.0 * 8 - 1e-6] * 2]), refine(problem, path)
    assert not LineString(path.points_m).intersects(wall)
    assert not LineString(refined.points_m).intersects(wall)
    assert through.cost < refined.cost <= path.cost < np.inf


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_weights_of_zero_are_weights(name, model):
    is_free, layers, obstacles = city_map(4)
    start, goal = ends_in_one_part(is_free, 3)
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
        assert (path.cost == 0) is expects_zero is ("costs nothing" in path.note)
        assert path.status is Status.OPTIMAL or not expects_zero
        assert path.cost == case.cost_of(path.points_m)


@cache
def large_problem() -> Problem:
    """Costs at random without obstacles, from corner to corner of so many cells that a search takes a while."""
    return problem_on(
        np.ones((700, 700), bool),
        (5, 5),
        (690, 680),
        np.random.default_rng(0).random((1, 700, 700)),
    )


@pytest.mark.parametrize("name", [*PLANNERS, "refinement"])
def test_a_small_budget_is_heeded_on_a_large_map(name):
    problem = large_problem()
    straight = PLANNERS["ptp"].run(problem)
    given = (problem, straight) if name == "refinement" else (problem,)
    search = refine if name == "refinement" else PLANNERS[name].run
    search(*given, budget_s=1e-3)
    begin_s, budget_s = time.perf_counter(), 0.3 if name.startswith("bitstar") else 1e-3
    path = search(*given, budget_s=budget_s)
    assert time.perf_counter() - begin_s < budget_s + 0.5
    if name in ("ptp", "refinement") or name.startswith("bitstar"):
        assert path.status.has_path
        assert path.cost <= straight.cost
    else:
        assert path.status is Status.BUDGET_EMPTY


@pytest.mark.parametrize(("name", "model"), RUNS)
def test_costs_never_rise_and_seeds_repeat(name, model):
    is_free, layers, _ = city_map(2)
    problem = problem_on(is_free, *ends_in_one_part(is_free, 5), layers, model, 0.1)
    first, again = (
        run(name, problem, seed=4, num_samples=1500),
        run(name, problem, seed=4, num_samples=1500),
    )
    np.testing.assert_array_equal(first.points_m, again.points_m)
    assert (first.cost, first.num_expanded) == (again.cost, again.num_expanded)
    assert [entry[1:] for entry in first.history] == [entry[1:] for entry in again.history]
    if first.history:
        at_s, num_samples, costs = np.array(first.history).T
        assert np.all(costs[1:] <= costs[:-1])
        assert np.all((np.diff(num_samples) > 0) & (np.diff(at_s) > 0))
        assert (first.status, num_samples[0], num_samples[-1]) == (Status.BUDGET_FEASIBLE, 0, 1500)
        assert first.cost == pytest.approx(costs[-1], rel=1e-9)
        assert first.cost != run(name, problem, seed=5, num_samples=1500).cost
