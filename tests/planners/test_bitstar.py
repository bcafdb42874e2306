"""BIT*, one query or many at once: against Dijkstra on the same samples, Shapely, and one backend against the other."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from jaxurban.kernels.search.heap import NO_PARENT
from jaxurban.planners import bulk as batched
from jaxurban.planners.base import Status
from jaxurban.planners.bitstar.bounds import HEURISTICS, InformedSet, graph_radius, make_bounds
from jaxurban.planners.bitstar.planner import BitStarOptions, bitstar, bitstar_dist, bitstar_plus
from jaxurban.planners.bulk import solve_batched
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import solve_many
from tests.free_space import Obstacles
from tests.planners.problems import graph_cost, open_problem, reachable, walled_problem


def solve(problems, heuristic="plus", seeds=None, **options):
    seeds = range(len(problems)) if seeds is None else seeds
    return dict(
        solve_batched(problems, planner="bitstar", heuristic=heuristic, seeds=seeds, **options)
    )


def solve_one(backend, problem, heuristic, seed, options):
    if backend == "jax":
        return solve([problem], heuristic, [seed], options=options)[0]
    return bitstar(problem, heuristic=heuristic, seed=seed, options=options)


@pytest.mark.parametrize("backend", ["numba", pytest.param("jax", marks=pytest.mark.slow)])
@pytest.mark.parametrize("cost_model", ["line", "cell"])
@pytest.mark.parametrize("heuristic", HEURISTICS)
def test_every_batch_costs_what_dijkstra_finds_on_its_samples_and_the_tree_before(
    heuristic, cost_model, backend
):
    num_found = num_improved = 0
    for seed in range(2):
        problem, seen = walled_problem(seed, cost_model), []
        is_joined = reachable(problem)
        informed = InformedSet(make_bounds(heuristic, problem, is_joined), is_joined)
        options = BitStarOptions(
            35, growth=0, max_batches=4, on_batch=lambda now, seen=seen: seen.append(copy(now))
        )
        path = solve_one(backend, problem, heuristic, seed, options)
        before = seen[0].tree
        for batch in seen[1:]:
            xy = batch.tree.xy
            number = {tuple(point): node for node, point in enumerate(xy)}
            # Of the tree before, what the batch was left with.
            has_parent = np.flatnonzero(before.parent != NO_PARENT)
            edges = [(tuple(before.xy[before.parent[k]]), tuple(before.xy[k])) for k in has_parent]
            edges = [(number[a], number[b]) for a, b in edges if a in number and b in number]
            ends = [number[tuple(point)] for point in (informed.bounds.start, informed.bounds.goal)]
            expected = graph_cost(
                problem, xy, graph_radius(len(xy), informed.measure, 1.1), edges, ends
            )
            assert batch.cost == pytest.approx(expected, rel=1e-9)
            num_found += np.isfinite(expected)
            informed.shrink(batch.cost)
            before = batch.tree
        samples = np.concatenate([batch.samples for batch in seen])
        may_help = np.add(*informed.bounds.from_start_and_to_goal(samples)) < seen[-2].cost * (
            1 - 1e-9
        )
        assert set(map(tuple, samples[may_help])) <= number.keys()  # pruning leaves them
        assert path.backend == backend
        num_improved += len({row[2] for row in path.history}) - 1
        # An observer sees every batch and changes none.
        assert [batch.cost for batch in seen] == [row[2] for row in path.history]
        assert np.cumsum([len(batch.samples) for batch in seen]).tolist() == [
            row[1] for row in path.history
        ]
        unseen = solve_one(backend, problem, heuristic, seed, replace(options, on_batch=None))
        np.testing.assert_array_equal(path.points_m, unseen.points_m)
        np.testing.assert_array_equal(
            before.xy[before.path()] * problem.resolution_m, path.points_m
        )
    assert num_found > 4
    assert num_improved > 2


def queries_on_one_map():
    """Across the wall, into its gap, within that, and within a cell."""
    problem = walled_problem(1, "line")
    ends = [
        ((12, 2), (12, 27)),
        ((12, 27), (12, 2)),
        ((5, 14), (12, 27)),
        ((12, 2), (6, 15)),
        ((5, 14), (6, 16)),
    ]
    return [problem.between(*pair) for pair in ends] + [problem.between((12, 2), (12, 2))]


def pinched_problems():
    """A map of scattered obstacles, many of which touch at corners, under both rules for these."""
    is_free = np.random.default_rng(1).random((24, 30)) < 0.75
    is_free[1, 1] = is_free[20, 20] = True
    problem = open_problem(is_free.shape, (1, 1), (20, 20), is_free=is_free)
    return [
        replace(problem, cost_model=CostModel("line", 4.0, diagonal=rule))
        for rule in ("both-free", "always")
    ]


def court_problems():
    """Into a closed court, and a free ride beside it."""
    is_free = np.ones((24, 30), bool)
    is_free[10:15, 10:15] = False
    is_free[12, 12] = True
    free = open_problem(is_free.shape, (2, 2), (12, 12), is_free=is_free, distance_weight=0.0)
    return [free, free.between((20, 3), (3, 20))]


@pytest.mark.slow
def test_queries_together_give_the_paths_of_each_alone_and_begin_as_numba_does():
    problems = [
        *queries_on_one_map(),
        walled_problem(2, "line"),
        *pinched_problems(),
        *court_problems(),
    ]
    limits = {
        "max_samples": 90,
        "options": BitStarOptions(30),
    }  # all nodes fit into the smallest arrays
    together = solve(problems, **limits)
    assert {path.backend for path in together.values()} == {"jax"}
    for index, problem in enumerate(problems):
        path, alone = together[index], solve([problem], seeds=[index], **limits)[0]
        np.testing.assert_array_equal(alone.points_m, path.points_m)
        assert [row[1:] for row in alone.history] == [row[1:] for row in path.history]
        assert (alone.cost, alone.num_expanded) == (path.cost, path.num_expanded)
        by_numba = bitstar_plus(problem, budget_s=np.inf, seed=index, **limits)
        assert (path.status, path.lower_bound) == (by_numba.status, by_numba.lower_bound)
        drawn_and_costs = [[row[1:] for row in found.history] for found in (path, by_numba)]
        np.testing.assert_allclose(*drawn_and_costs, rtol=1e-9)
        if path.status.has_path:
            costs = [row[2] for row in path.history]
            assert costs == sorted(costs, reverse=True)
            assert path.cost == pytest.approx(by_numba.cost, rel=1e-9)
            assert problem.features(path.points_m).is_valid
            assert Obstacles(problem.is_free, 2.0).crossed_m(path.points_m) < 1e-6
    itself, court, ride = together[5], *(together[len(problems) - k] for k in (2, 1))
    assert (court.status, court.cost, court.lower_bound) == (Status.NO_PATH, np.inf, np.inf)
    assert (itself.status, itself.cost, len(itself.points_m)) == (Status.OPTIMAL, 0.0, 1)
    assert (ride.status, ride.cost) == (Status.OPTIMAL, 0.0)
    assert "costs nothing" in ride.note
    assert sum(path.status.has_path for path in together.values()) >= 7


def test_a_corner_that_no_sample_can_hit_leaves_the_budget_empty():
    is_free = np.zeros((8, 8), bool)
    is_free[:4, :4] = is_free[4:, 4:] = True
    closed = open_problem((8, 8), (1, 1), (6, 6), is_free=is_free)
    through_corner = replace(closed, cost_model=CostModel("line", diagonal="always"))
    assert (
        bitstar_dist(through_corner).status is Status.OPTIMAL
    )  # the straight line runs through the corner itself
    path = bitstar_dist(through_corner.between((1, 1), (6, 5)), budget_s=np.inf, max_samples=2000)
    assert (path.status, path.cost) == (Status.BUDGET_EMPTY, np.inf)


def test_the_search_ends_on_batches_cost_and_small_improvement():
    problem = walled_problem(4, "line")

    def run(max_samples=None, **options):
        options = BitStarOptions(batch_samples=50, **options)
        return bitstar(problem, budget_s=np.inf, max_samples=max_samples, options=options, seed=1)

    long = run(max_samples=20_000)
    batches = run(max_batches=5)
    assert (len(batches.history), batches.status) == (
        6,
        Status.BUDGET_FEASIBLE,
    )  # the straight segment's among them
    good = run(max_samples=20_000, target_cost=1.1 * long.cost)
    assert good.history[-1][2] <= 1.1 * long.cost < good.history[-2][2]
    settled = run(max_samples=20_000, min_improvement=0.02)
    assert good.status is settled.status is Status.FEASIBLE
    assert settled.history[-1][2] > 0.98 * settled.history[-2][2]
    assert long.cost <= settled.cost


@pytest.mark.slow
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
    problems = queries_on_one_map()[:3]
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


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["bitstar-dist", "bitstar-plus"])
def test_many_queries_take_the_batched_search_by_name_and_auto_does_not(monkeypatch, planner):
    problems = queries_on_one_map()
    monkeypatch.setattr(batched, "MOST_NODES", {"cpu": 1000, "gpu": 1000})
    paths = dict(solve_many(problems, planner=planner, backend="jax", budget_s=60.0))
    assert sorted(paths) == list(range(len(problems)))
    assert {(path.backend, path.planner) for path in paths.values()} == {("jax", planner)}
    by_numba = dict(solve_many(problems[:2], planner=planner, budget_s=0.1))
    assert {path.backend for path in by_numba.values()} == {"numba"}


def test_a_limit_of_samples_gives_the_same_path_alone_and_together():
    problems = queries_on_one_map()[:3]
    how = {"planner": "bitstar-plus", "max_samples": 300, "seed": 4}
    together, again = (dict(solve_many(problems, **how, num_threads=num)) for num in (1, 2))
    for index, problem in enumerate(problems):
        alone = bitstar_plus(problem, budget_s=np.inf, max_samples=300, seed=4)
        assert alone.history[-1][1] <= 300
        for path in (together[index], again[index]):
            np.testing.assert_array_equal(path.points_m, alone.points_m)
