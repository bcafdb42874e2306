"""BIT* searched in bulk, many queries at once: against Dijkstra on the same samples, Shapely, and itself one by one."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from shapely import LineString, box, union_all

from jaxurban.errors import InputError
from jaxurban.kernels.search.sample_graph import NO_PARENT
from jaxurban.planners import bulk as batched
from jaxurban.planners.base import Status
from jaxurban.planners.bitstar.bounds import HEURISTICS, InformedSet, graph_radius, make_bounds
from jaxurban.planners.bitstar.planner import BitStarOptions, bitstar_plus
from jaxurban.planners.bulk import solve_batched
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import solve_many
from tests.planners.problems import graph_cost, open_problem, reachable, walled_problem

PAIRS = [(heuristic, model) for heuristic in HEURISTICS for model in ("line", "cell")]


def solve(problems, heuristic="plus", seeds=None, **options):
    seeds = range(len(problems)) if seeds is None else seeds
    return dict(solve_batched(problems, planner="bitstar", heuristic=heuristic, seeds=seeds, **options))


def queries_on_one_map():
    """Across the wall, into its gap, within that, and within a cell."""
    problem = walled_problem(1, "line")
    ends = [((12, 2), (12, 27)), ((12, 27), (12, 2)), ((5, 14), (12, 27)), ((12, 2), (6, 15)), ((5, 14), (6, 16))]
    return [problem.between(*pair) for pair in ends] + [problem.between((12, 2), (12, 2))]


@pytest.mark.parametrize(("heuristic", "cost_model"), PAIRS)
def test_every_batch_costs_what_dijkstra_finds_on_its_samples_and_the_tree_before(heuristic, cost_model):
    num_found = num_improved = 0
    for seed in range(2):
        problem, seen = walled_problem(seed, cost_model), []
        is_joined = reachable(problem)
        informed = InformedSet(make_bounds(heuristic, problem, is_joined), is_joined)
        options = BitStarOptions(35, growth=0, max_batches=4, on_batch=lambda now, seen=seen: seen.append(copy(now)))
        path = solve([problem], heuristic, [seed], options=options)[0]
        before = seen[0].tree
        for batch in seen[1:]:
            xy = batch.tree.xy
            number = {tuple(point): node for node, point in enumerate(xy)}
            # Of the tree before, what the batch was left with; start and goal are the first two of any.
            has_parent = np.flatnonzero(before.parent != NO_PARENT)
            edges = [(tuple(before.xy[before.parent[k]]), tuple(before.xy[k])) for k in has_parent]
            edges = [(number[a], number[b]) for a, b in edges if a in number and b in number]
            order = [number[tuple(point)] for point in (informed.bounds.start, informed.bounds.goal)]
            assert order == [0, 1]
            expected = graph_cost(problem, xy, graph_radius(len(xy), informed.measure, 1.1), edges)
            assert batch.cost == pytest.approx(expected, rel=1e-9)
            num_found += np.isfinite(expected)
            informed.shrink(batch.cost)
            before = batch.tree
        costs = [row[2] for row in path.history]
        assert costs == sorted(costs, reverse=True)
        num_improved += len(set(costs)) - 1
    assert num_found > 4
    assert num_improved > 2


def test_queries_together_give_the_paths_of_each_alone():
    problems = queries_on_one_map()
    other_map = walled_problem(2, "line")
    together = solve([*problems, other_map], max_samples=200)
    assert {path.backend for path in together.values()} == {"jax"}
    for index, problem in enumerate([*problems, other_map]):
        alone = solve([problem], seeds=[index], max_samples=200)[0]
        np.testing.assert_array_equal(alone.points_m, together[index].points_m)
        assert [row[1:] for row in alone.history] == [row[1:] for row in together[index].history]
        assert (alone.cost, alone.num_expanded) == (together[index].cost, together[index].num_expanded)


def test_costs_never_rise_and_are_those_of_paths_that_the_evaluation_finds_free():
    for seed in range(2):
        problems = [walled_problem(seed, "line")] * 3
        seeds = [seed, seed + 10, seed]
        paths = solve(problems, seeds=seeds, max_samples=330)
        np.testing.assert_array_equal(paths[0].points_m, paths[2].points_m)
        for index, path in paths.items():
            costs = np.array(path.history)[:, 2]
            assert np.all(costs[1:] <= costs[:-1])
            assert path.history[-1][1] == 330
            assert path.status is Status.BUDGET_FEASIBLE
            assert problems[0].features(path.points_m).is_valid
            assert path.cost == pytest.approx(costs[-1], rel=1e-9)
            by_numba = bitstar_plus(problems[0], budget_s=np.inf, max_samples=330, seed=seeds[index])
            for (_, num_drawn, cost), (_, num_by_numba, cost_by_numba) in zip(
                path.history[:4], by_numba.history[:4], strict=True
            ):
                assert (num_drawn, cost) == (num_by_numba, pytest.approx(cost_by_numba, rel=1e-9))
            assert path.cost == pytest.approx(by_numba.cost, rel=0.02)
            assert path.lower_bound == by_numba.lower_bound


@pytest.mark.parametrize("diagonal", ["both-free", "always"])
def test_paths_keep_out_of_obstacles_by_shapely_and_between_pinched_ones_as_the_model_says(diagonal):
    num_found = 0
    for seed in range(4):
        is_free = np.random.default_rng(seed).random((24, 30)) < 0.75
        is_free[1, 1] = is_free[20, 20] = True
        problem = open_problem(is_free.shape, (1, 1), (20, 20), is_free=is_free)
        problem = replace(problem, cost_model=CostModel("line", 4.0, diagonal=diagonal))
        path = solve([problem], max_samples=600)[0]
        obstacles = union_all([box(2.0 * c, 2.0 * r, 2.0 * c + 2, 2.0 * r + 2) for r, c in np.argwhere(~is_free)])
        if path.status.has_path:
            num_found += 1
            assert LineString(path.points_m).intersection(obstacles).length < 1e-6
            assert problem.features(path.points_m).is_valid
    assert num_found > 0


def test_a_court_itself_and_a_free_ride_are_told_apart():
    is_free = np.ones((24, 30), bool)
    is_free[10:15, 10:15] = False
    is_free[12, 12] = True
    free = open_problem(is_free.shape, (2, 2), (2, 2), is_free=is_free, distance_weight=0.0)
    problems = [free, free.between((2, 2), (12, 12)), free.between((20, 3), (3, 20))]
    itself, court, ride = (path for _, path in sorted(solve(problems, max_samples=300).items()))
    assert (court.status, court.cost, court.lower_bound) == (Status.NO_PATH, np.inf, np.inf)
    assert (itself.status, itself.cost, len(itself.points_m)) == (Status.OPTIMAL, 0.0, 1)
    assert (ride.status, ride.cost) == (Status.OPTIMAL, 0.0)
    assert "costs nothing" in ride.note


def test_a_spent_budget_and_full_arrays_end_the_search_with_what_was_found(monkeypatch):
    problem = walled_problem(0, "line")
    solve([problem], max_samples=100)
    path = solve([problem], budget_s=0.2)[0]
    assert path.elapsed_s < 1.0  # compiling left out
    assert path.status is Status.BUDGET_FEASIBLE
    monkeypatch.setattr(batched, "MOST_NODES", {"cpu": 600, "gpu": 600})
    full = solve([problem] * 2, budget_s=60.0)
    assert {path.status for path in full.values()} == {Status.BUDGET_FEASIBLE}
    assert max(path.history[-1][1] for path in full.values()) < 600


@pytest.mark.slow
def test_room_that_is_too_small_grows_and_changes_nothing(monkeypatch):
    problems = queries_on_one_map()
    expected = solve(problems, max_samples=100)
    rooms, search = [], batched.search_samples

    def watched(*arrays, sizes, **options):
        rooms.append(sizes.edges)
        return search(*arrays, sizes=sizes, **options)

    monkeypatch.setattr(batched, "search_samples", watched)
    monkeypatch.setattr(batched, "EDGES", 2)
    for index, path in solve(problems, max_samples=100).items():
        np.testing.assert_array_equal(path.points_m, expected[index].points_m)
    assert rooms == sorted(rooms)
    assert rooms[-1] > rooms[0] == 2


@pytest.mark.parametrize("planner", ["bitstar-dist", "bitstar-plus"])
def test_many_queries_take_the_batched_search_by_name_and_auto_does_not(monkeypatch, planner):
    problems = queries_on_one_map()
    monkeypatch.setattr(batched, "MOST_NODES", {"cpu": 1000, "gpu": 1000})
    paths = dict(solve_many(problems, planner=planner, backend="jax", budget_s=60.0))
    assert sorted(paths) == list(range(len(problems)))
    for index, path in paths.items():
        assert (path.backend, path.planner) == ("jax", planner)
        assert problems[index].features(path.points_m).is_valid
    by_numba = dict(solve_many(problems[:2], planner=planner, budget_s=0.1))
    assert {path.backend for path in by_numba.values()} == {"numba"}


def test_wrong_arguments_are_refused_at_once():
    problem = open_problem((3, 3), (0, 0), (2, 2))
    with pytest.raises(InputError, match="nothing else ends the search"):
        solve_many([problem], planner="bitstar-plus", backend="jax")
    with pytest.raises(InputError, match="seeds must be one for each of 1 problems, got 2"):
        solve([problem], seeds=[0, 1], max_samples=1)
    with pytest.raises(InputError, match="tests no legs for this clearance"):
        solve([replace(problem, leg_margin_m=0.1 * problem.resolution_m)], max_samples=1)
