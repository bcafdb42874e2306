"""BIT*: against Dijkstra on the same samples, closed forms, and small maps done by hand."""

import time
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from shapely import LineString, box, union_all

from jaxurban.errors import InputError
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.bitstar.bounds import HEURISTICS, InformedSet, graph_radius, make_bounds
from jaxurban.planners.bitstar.planner import BitStarOptions, bitstar, bitstar_dist, bitstar_plus
from jaxurban.planners.bulk import solve_batched
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import PLANNERS
from tests.planners.problems import ends_of, graph_cost, open_problem, reachable, walled_problem

MODELS = ("cell", "line")
PAIRS = [(bitstar_dist, "line"), (bitstar_plus, "line"), (bitstar_dist, "cell"), (bitstar_plus, "cell")]


@pytest.mark.parametrize("backend", ["numba", "jax"])
@pytest.mark.parametrize("heuristic", HEURISTICS)
@pytest.mark.parametrize("cost_model", MODELS)
def test_one_batch_finds_the_best_path_of_its_graph(cost_model, heuristic, backend):
    num_found = 0
    for seed in range(4):
        problem = walled_problem(seed, cost_model)
        is_joined = reachable(problem)
        options = BitStarOptions(150, growth=0, max_batches=1)
        if backend == "numba":
            path = bitstar(problem, heuristic=heuristic, seed=seed, options=options)
        else:
            ((_, path),) = solve_batched([problem], planner="", heuristic=heuristic, seeds=[seed], options=options)
        assert path.backend == backend
        informed = InformedSet(make_bounds(heuristic, problem, is_joined), is_joined)
        xy = np.concatenate([ends_of(problem), informed.sample(150, np.random.default_rng(seed))])
        best = graph_cost(problem, xy, graph_radius(len(xy), informed.measure, 1.1))
        assert path.cost == pytest.approx(best, rel=1e-9)
        num_found += np.isfinite(best)
    assert num_found > 1


def test_each_later_batch_finds_the_best_path_of_its_graph_or_a_better_one():
    problem = walled_problem(1, "line")
    # With hardly a distance weight nothing is pruned, so all samples stay in the graph.
    problem = Problem(problem.costs, problem.is_free, problem.start, problem.goal, 2.0, 1e-6, CostModel("line", 4.0))
    path = bitstar(problem, heuristic="euclidean", seed=5, options=BitStarOptions(60, growth=0, max_batches=4))
    is_joined = reachable(problem)
    informed = InformedSet(make_bounds("euclidean", problem, is_joined), is_joined)
    rng = np.random.default_rng(5)
    xy = ends_of(problem)
    for _, num_samples, cost in path.history[1:]:
        xy = np.concatenate([xy, informed.sample(60, rng)])
        assert len(xy) == num_samples + 2
        assert cost <= graph_cost(problem, xy, graph_radius(len(xy), informed.measure, 1.1)) * (1 + 1e-9)
        informed.shrink(cost)
    assert np.isfinite(path.cost)


def test_an_observer_sees_every_batch_and_changes_none():
    problem, seen = walled_problem(1, "line"), []
    options = BitStarOptions(60, growth=0, max_batches=4, on_batch=lambda now: seen.append(copy(now)))
    path = bitstar(problem, seed=5, options=options)
    unseen = bitstar(problem, seed=5, options=replace(options, on_batch=None))
    np.testing.assert_array_equal(path.points_m, unseen.points_m)
    assert len(seen) == 5
    for number, (batch, (_, num_drawn, cost)) in enumerate(zip(seen, path.history, strict=True)):
        assert batch.cost == cost
        assert sum(len(earlier.samples) for earlier in seen[: number + 1]) == num_drawn
        assert np.isin(batch.samples, batch.tree.xy).all()
        assert (len(batch.tree.path()) > 0) == np.isfinite(cost)
    last = seen[-1]
    np.testing.assert_array_equal(last.tree.xy[last.tree.path()] * problem.resolution_m, path.points_m)


@pytest.mark.parametrize(("planner", "cost_model"), PAIRS)
def test_cost_never_rises_from_batch_to_batch_and_is_that_of_the_path(planner, cost_model):
    for seed in range(5):
        problem = walled_problem(seed, cost_model)
        path = planner(problem, budget_s=np.inf, max_samples=3000, seed=seed)
        at_s, num_samples, cost = np.array(path.history).T
        assert path.status is Status.BUDGET_FEASIBLE
        assert np.all(cost[1:] <= cost[:-1])
        assert np.all(np.diff(num_samples) > 0)
        assert np.all(np.diff(at_s) > 0)
        assert num_samples[-1] == 3000
        assert path.cost == pytest.approx(cost[-1], rel=1e-9)
        assert path.cost == problem.cost_of(path.points_m)
        assert path.lower_bound <= path.cost
        np.testing.assert_allclose(path.points_m[[0, -1]], ends_of(problem) * 2.0)


def test_a_seed_and_a_number_of_samples_repeat_a_run():
    problem = walled_problem(3, "line")
    runs = [bitstar_plus(problem, budget_s=np.inf, max_samples=1500, seed=seed) for seed in (7, 7, 8)]
    np.testing.assert_array_equal(runs[0].points_m, runs[1].points_m)
    assert [row[1:] for row in runs[0].history] == [row[1:] for row in runs[1].history]
    assert runs[0].num_expanded == runs[1].num_expanded
    assert runs[0].cost != runs[2].cost


@pytest.mark.parametrize(("planner", "cost_model"), PAIRS)
def test_on_an_empty_map_the_straight_line_is_proven_best(planner, cost_model):
    path = planner(open_problem((40, 50), (3, 4), (31, 45), cost_model=cost_model), budget_s=60.0)
    assert path.status is Status.OPTIMAL
    assert path.cost == pytest.approx(2 * np.hypot(28, 41))
    assert (len(path.points_m), path.history[0][1]) == (2, 0)


def test_plus_proves_the_straight_line_best_on_even_costs():
    problem = open_problem((40, 50), (3, 4), (31, 45), np.full((2, 40, 50), 0.6), distance_weight=0.1)
    assert bitstar_plus(problem, budget_s=60.0).status is Status.OPTIMAL
    assert bitstar_dist(problem, budget_s=np.inf, max_samples=200).status is Status.BUDGET_FEASIBLE


def test_the_way_around_a_block_tends_to_the_taut_string():
    is_free = np.ones((60, 60), bool)
    is_free[10:50, 20:40] = False
    problem = open_problem((60, 60), (30, 5), (30, 54), is_free=is_free)
    # Round the block's north corners: (5.5, 30.5), (20, 50), (40, 50), (54.5, 30.5).
    taut_m = 2 * (2 * np.hypot(14.5, 19.5) + 20)
    cost = bitstar_dist(problem, budget_s=np.inf, max_samples=8000).cost
    assert taut_m <= cost <= 1.01 * taut_m


@pytest.mark.parametrize("planner", [bitstar_dist, bitstar_plus])
def test_paths_bend_at_a_change_of_cost_as_snell_says(planner):
    layers = np.zeros((1, 60, 60))
    layers[:, 30:] = 6.0
    problem = open_problem((60, 60), (5, 5), (54, 50), layers, distance_weight=1.0)

    def cost_through(x):
        return 2 * (np.hypot(x - 5.5, 24.5) + (1 + 6.0 / 4.0) * np.hypot(50.5 - x, 24.5))

    least = minimize_scalar(cost_through, bounds=(5, 51), method="bounded").fun
    path = planner(problem, budget_s=np.inf, max_samples=4000)
    assert least * (1 - 1e-9) <= path.cost <= 1.003 * least
    assert path.cost < 0.98 * cost_through(28.0)  # the straight line's


@pytest.mark.parametrize(("planner", "cost_model"), PAIRS)
def test_paths_keep_out_of_obstacles_by_shapely(planner, cost_model):
    for seed in range(10):
        problem = walled_problem(100 + seed, cost_model)
        path = planner(problem, budget_s=np.inf, max_samples=1000, seed=seed)
        cells = np.argwhere(~problem.is_free)
        obstacles = union_all([box(2.0 * c, 2.0 * r, 2.0 * c + 2, 2.0 * r + 2) for r, c in cells])
        assert path.status.has_path
        assert LineString(path.points_m).intersection(obstacles).length < 1e-6


def test_start_at_the_goal_is_a_path_of_one_point():
    path = bitstar_plus(open_problem((4, 4), (1, 2), (1, 2), np.ones((1, 4, 4))))
    np.testing.assert_array_equal(path.points_m, [[5.0, 3.0]])
    assert (path.cost, path.lower_bound, path.status) == (0, 0, Status.OPTIMAL)


def test_a_goal_in_a_closed_court_has_no_path():
    is_free = np.ones((30, 30), bool)
    is_free[10:15, 10:15] = False
    is_free[12, 12] = True
    path = bitstar_dist(open_problem((30, 30), (2, 2), (12, 12), is_free=is_free), budget_s=60.0)
    assert (path.status, path.lower_bound, path.cost) == (Status.NO_PATH, np.inf, np.inf)
    assert path.points_m.shape == (0, 2)


def test_a_corner_that_no_sample_can_hit_leaves_the_budget_empty():
    is_free = np.zeros((8, 8), bool)
    is_free[:4, :4] = is_free[4:, 4:] = True
    through_corner = replace(
        open_problem((8, 8), (1, 1), (6, 6), is_free=is_free), cost_model=CostModel("line", diagonal="always")
    )
    assert bitstar_dist(through_corner).status is Status.OPTIMAL  # the straight line runs through the corner itself
    path = bitstar_dist(through_corner.between((1, 1), (6, 5)), budget_s=np.inf, max_samples=2000)
    assert path.status is Status.BUDGET_EMPTY
    assert path.cost == np.inf


def test_a_corridor_one_cell_wide_is_found():
    is_free = np.zeros((21, 21), bool)
    is_free[2, 2:18] = is_free[2:18, 17] = is_free[17, 5:18] = True
    path = bitstar_dist(open_problem((21, 21), (2, 2), (17, 5), is_free=is_free), budget_s=np.inf, max_samples=2000)
    assert path.status is Status.BUDGET_FEASIBLE
    # Inner corners of the bends: (17, 3) and (17, 17).
    taut_m = 2 * (np.hypot(14.5, 0.5) + 14 + np.hypot(11.5, 0.5))
    assert taut_m <= path.cost < 1.02 * taut_m


@pytest.mark.parametrize(("planner", "cost_model"), PAIRS)
def test_weights_of_zero_are_no_trouble(planner, cost_model):
    run = partial(planner, budget_s=np.inf, max_samples=500)
    walled = walled_problem(2, cost_model)
    nothing = open_problem(walled.is_free.shape, walled.start, walled.goal, None, cost_model, 0.0, walled.is_free)
    path = run(nothing)
    assert (path.status, path.cost) == (Status.OPTIMAL, 0.0)
    assert "costs nothing" in path.note
    map_only = Problem(walled.costs, walled.is_free, walled.start, walled.goal, 2.0, 0.0, CostModel(cost_model, 4.0))
    assert run(map_only).status is Status.BUDGET_FEASIBLE


def test_the_search_ends_on_batches_cost_and_small_improvement():
    problem = walled_problem(4, "line")

    def run(max_samples=None, **options):
        options = BitStarOptions(batch_samples=50, **options)
        return bitstar(problem, budget_s=np.inf, max_samples=max_samples, options=options, seed=1)

    long = run(max_samples=20_000)
    batches = run(max_batches=5)
    assert len(batches.history) == 6  # the straight segment's among them
    assert batches.status is Status.BUDGET_FEASIBLE
    good = run(max_samples=20_000, target_cost=1.1 * long.cost)
    assert good.status is Status.FEASIBLE
    assert good.history[-1][2] <= 1.1 * long.cost < good.history[-2][2]
    settled = run(max_samples=20_000, min_improvement=0.02)
    before, after = settled.history[-2][2], settled.history[-1][2]
    assert settled.status is Status.FEASIBLE
    assert before - after < 0.02 * before
    assert long.cost <= settled.cost


def test_the_budget_is_heeded_on_a_large_map():
    rng = np.random.default_rng(0)
    layers = rng.random((1, 700, 700))
    problem = open_problem((700, 700), (5, 5), (690, 680), layers, distance_weight=0.1)
    bitstar_plus(walled_problem(0, "line"), max_samples=10)
    begin_s = time.perf_counter()
    path = bitstar_plus(problem, budget_s=0.4)
    assert time.perf_counter() - begin_s < 1.5
    assert path.status is Status.BUDGET_FEASIBLE


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"heuristic": "pluss"}, "heuristic must be .*, got 'pluss' .did you mean 'plus'"),
        ({"budget_s": np.inf}, "nothing else ends the search"),
        ({"batch_samples": 0}, "batch_samples must be a whole number from 1 up, got 0"),
        ({"eta": np.nan}, "eta must be a positive number, got nan"),
        ({"growth": -0.5}, "growth must be a number >= 0, got -0.5"),
        ({"min_improvement": -1}, "min_improvement must be a number >= 0, got -1"),
        ({"max_samples": -1}, "max_samples must be a whole number from 0 up, got -1"),
    ],
)
def test_wrong_settings_are_refused(options, message):
    own = {name: options.pop(name) for name in list(options) if hasattr(BitStarOptions, name)}
    with pytest.raises(InputError, match=message):
        bitstar(open_problem((3, 3), (0, 0), (2, 2)), options=BitStarOptions(**own), **options)


def test_both_are_known_by_name():
    assert PLANNERS["bitstar-dist"].default_heuristic == "euclidean"
    assert PLANNERS["bitstar-plus"].default_heuristic == "plus"
