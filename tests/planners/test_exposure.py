"""Budgets of exposure: against SciPy's Dijkstra over (cell, exposure), and against all undominated labels."""

import itertools
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.planners import exposure
from jaxurban.planners.astar import astar_plus
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from tests.planners.problems import edges_of, random_cells

NAMES = ("people", "other", "noise")


def find(problem, **budgets):
    return exposure.within_budgets(problem, astar_plus, budgets, NAMES, budget_s=np.inf, seed=0)


def made(seed, shape, connectivity):
    """A map with obstacles whose exposures are whole numbers from 0 to 3 for each step over two cells' halves."""
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < 0.85
    costs = np.array(
        [rng.integers(0, 4, shape), rng.random(shape) * 4, rng.integers(0, 3, shape)], np.float64
    )
    model = CostModel("line", 2.0, connectivity)
    return Problem(costs, is_free, *random_cells(rng, is_free), 2.0, [0.3, 0.0, 0.2, 0.0], model)


def alone(problem, layer):
    return problem.with_weights(np.eye(4)[1 + layer])


def cheapest_by_exposure(problem):
    """Return the least cost of a path for each exposure, in halves, up to those of the cheapest path: by SciPy."""
    cost, half = (edges_of(each).tocoo() for each in (problem, alone(problem, 0)))
    halves = np.rint(2 * half.data).astype(int)  # the same steps in the same order
    most = round(2 * problem.features(astar_plus(problem).points_m).phi[1])
    num, parts = problem.is_free.size, []
    for spent in range(most + 1):
        fits = spent + halves <= most
        (here, there), to = (index[fits] for index in cost.coords), (spent + halves)[fits]
        parts.append((cost.data[fits], spent * num + here, to * num + there))
    data, here, there = (np.concatenate(part) for part in zip(*parts, strict=True))
    start, goal = (
        np.ravel_multi_index(cell, problem.is_free.shape) for cell in (problem.start, problem.goal)
    )
    found = dijkstra(
        coo_array((data, (here, there)), (num * (most + 1),) * 2).tocsr(), indices=start
    )
    return np.minimum.accumulate(found.reshape(most + 1, num)[:, goal])


def check(seed, shape=(40, 40)):
    """Try some budgets on a random map: bounds, gaps, and paths that keep them; return how many were tried."""
    problem = made(seed, shape, 4)
    if not astar_plus(problem).status.has_path:
        return 0
    optimum = cheapest_by_exposure(problem)
    budgets = np.unique(np.linspace(0, len(optimum) - 1, 7).astype(int))
    costs = []
    for halves in budgets:
        path = find(problem, people=halves / 2)
        if np.isinf(optimum[halves]):
            assert path.status is Status.OVER_EXPOSURE
            assert f"any path has is {np.argmax(np.isfinite(optimum)) / 2:g} to people" in path.note
            continue
        assert path.lower_bound <= optimum[halves] * (1 + 1e-9)
        assert path.cost >= optimum[halves] * (1 - 1e-9)
        assert path.gap == pytest.approx(path.cost / path.lower_bound - 1, abs=1e-12)
        assert (path.cost, path.status) == (
            pytest.approx(optimum[halves], rel=1e-9),
            Status.OPTIMAL,
        )
        assert problem.features(path.points_m).phi[1] <= halves / 2 * (1 + 1e-9)
        costs.append(path.cost)
    assert (np.diff(costs) <= 1e-9).all()  # a larger budget costs no more
    return len(costs)


@pytest.mark.slow
def test_paths_bounds_and_gaps_are_those_of_dijkstra_over_cells_and_exposures():
    assert sum(check(seed, (20, 24)) for seed in range(8)) > 10


@pytest.mark.slow
def test_the_same_on_200_maps_of_40_by_40_cells():
    assert sum(map(check, range(100, 300))) > 500


def labels(problem, layers):
    """Return ``[N, 1 + K]`` cost and exposures of all paths to the goal that no other one beats, without any bound."""
    graphs = [
        edges_of(each).tocsr() for each in (problem, *(alone(problem, layer) for layer in layers))
    ]
    start, goal = (
        np.ravel_multi_index(cell, problem.is_free.shape) for cell in (problem.start, problem.goal)
    )
    nothing = np.zeros(len(graphs))
    kept, due = {start: [nothing]}, [(start, nothing)]
    while due:
        here, spent = due.pop(0)
        if not any(spent is each for each in kept[here]):
            continue
        for there in graphs[0].indices[slice(*graphs[0].indptr[here : here + 2])]:
            new, known = (
                spent + [graph[here, there] for graph in graphs],
                kept.setdefault(there, []),
            )
            if not any((each <= new + 1e-12).all() for each in known):
                kept[there] = [each for each in known if not (new <= each).all()] + [new]
                due.append((there, new))
    return np.array(kept.get(goal, []))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_one_and_two_budgets_on_eight_neighbours_equal_all_undominated_paths(seed):
    problem = made(seed, (6, 7), 8)
    front = labels(problem, (0, 2))
    assert len(front) > 2
    low, high = front[:, 1:].min(axis=0), front[:, 1:].max(axis=0)
    for share_people, share_noise in itertools.product((0.0, 0.3, 0.7), repeat=2):
        most = low + np.array([share_people, share_noise]) * (high - low)
        for budgets, is_within in (
            ({"people": most[0]}, front[:, 1] <= most[0] + 1e-9),
            ({"people": most[0], "noise": most[1]}, (front[:, 1:] <= most + 1e-9).all(axis=1)),
        ):
            path = find(problem, **budgets)
            if is_within.any():
                assert path.cost == pytest.approx(front[is_within, 0].min(), rel=1e-9)
                assert path.lower_bound == pytest.approx(path.cost, rel=1e-9)
            else:
                assert path.status is Status.OVER_EXPOSURE


@pytest.mark.parametrize("most", [0, 9, 300])
def test_a_gap_that_labels_may_not_close_is_said(monkeypatch, most):
    monkeypatch.setattr(exposure, "MOST_LABELS", most)
    gaps = []
    for seed in range(12):
        problem = made(seed, (20, 24), 4)
        if astar_plus(problem).status.has_path:
            optimum = cheapest_by_exposure(problem)
            halves = int(0.7 * (len(optimum) - 1))
            path = find(problem, people=halves / 2)
            if path.status.has_path:
                assert path.lower_bound <= optimum[halves] * (1 + 1e-9) <= path.cost * (1 + 2e-9)
                assert (path.status is Status.OPTIMAL) == (path.gap <= 1e-9)
                gaps.append(path.gap)
    assert max(gaps) > 1e-3 or most == 300


def test_exposures_too_small_for_the_solver_of_prices_are_kept_too():
    """Cells of 1e-44 and of 1: only the first can keep a budget of 1e-43, as if the others were closed."""
    problem, rng = made(7, (8, 9), 4), np.random.default_rng(7)
    is_tiny, costs = rng.random((8, 9)) < 0.8, problem.costs.copy()
    costs[1] = np.where(is_tiny, 0.01 * costs[1], costs[1] + 4)
    ulps = np.float32(1e-44).astype(np.float64)
    tiny = costs.copy()
    tiny[0] = np.where(is_tiny, 1e-44 * costs[0], 1 + costs[0])
    tiny, weights = problem.with_costs(tiny.astype(np.float32)), np.array([0.3, 0.0, 0.2, 0.0])
    front = labels(
        replace(problem.with_costs(costs, weights), is_free=problem.is_free & is_tiny), (0, 2)
    )
    _, people, _, noise = tiny.features(astar_plus(tiny).points_m).phi
    for share in (0.6, 0.9):
        path = find(tiny, people=share * people, noise=0.9 * noise)
        is_within = (front[:, 1] <= share * people / ulps) & (front[:, 2] <= 0.9 * noise)
        assert (path.status, path.cost) == (
            Status.OPTIMAL,
            pytest.approx(front[is_within, 0].min(), rel=1e-6),
        )


@pytest.mark.parametrize(
    ("most", "a_second", "status"), [(0, 1e6, "undecided"), (9, 0, "budget-empty")]
)
def test_a_method_that_ends_without_a_verdict_asks_for_no_more_seconds(
    monkeypatch, most, a_second, status
):
    monkeypatch.setattr(exposure, "MOST_LABELS", most)
    monkeypatch.setattr(exposure, "LABELS_PER_S", a_second)
    problem = made(1, (6, 7), 8)
    front = labels(problem, (0, 2))
    people, noise = (front[:, 1:].min(axis=0) * (1 + 1e-9)).tolist()
    path = exposure.within_budgets(
        problem, astar_plus, {"people": people, "noise": noise}, NAMES, budget_s=60, seed=0
    )
    assert (path.status.value, path.status.exit_code) == (status, 4)
    assert ("budget_s" in path.note, "more time changes nothing" in path.sentence) == (
        a_second == 0,
        a_second > 0,
    )
    assert path.lower_bound <= path.cost == np.inf


def test_a_budget_of_seconds_ends_the_search_with_what_is_known():
    problem, late = made(0, (40, 40), 4), []

    def planner(problem, budget_s, seed):
        late.append(budget_s)
        return astar_plus(problem, budget_s=budget_s, seed=seed)

    most = problem.features(astar_plus(problem).points_m).phi[1] * 0.8
    path = exposure.within_budgets(problem, planner, {"people": most}, NAMES, budget_s=0.0, seed=0)
    assert path.status is Status.BUDGET_EMPTY
    assert late == [0.0]


def made_to_choose():
    """Return a map whose cheapest path is not the least exposed one, the least exposure and that of the cheapest."""
    problem = made(0, (20, 24), 8)
    for seed in range(1, 50):
        least, first = (
            astar_plus(alone(problem, 0)).cost,
            problem.features(astar_plus(problem).points_m).phi[1],
        )
        if 1 < least < 0.9 * first < np.inf:
            return problem, least, first
        problem = made(seed, (20, 24), 8)
    raise AssertionError("no such map")


@pytest.mark.parametrize("most", [1e15, 1e20, 1e300])
def test_a_budget_beyond_all_paths_changes_neither_the_path_nor_the_least_exposures(most):
    problem, least, first = made_to_choose()
    other = astar_plus(alone(problem, 2)).cost
    kept, only = (
        find(problem, people=(least + first) / 2, noise=most),
        find(problem, people=(least + first) / 2),
    )
    assert (kept.cost, kept.lower_bound) == (only.cost, only.lower_bound)
    assert (
        f"{least:.10g} to people, {other:.10g} to noise"
        in find(problem, people=0.5 * least, noise=most).note
    )


def test_compiling_takes_nothing_from_the_budget_of_seconds():
    problem, least, first = made_to_choose()

    def planner(problem, budget_s, seed):
        time.sleep(0.0 if has_compiled else 0.6)
        path = astar_plus(problem, budget_s=budget_s, seed=seed)
        has_compiled.append(True)
        return path if len(has_compiled) > 1 else replace(path, setup_s=0.6)

    has_compiled = []
    budgets, begin_s = {"people": (least + first) / 2}, time.perf_counter()
    path = exposure.within_budgets(problem, planner, budgets, NAMES, budget_s=0.5, seed=0)
    assert path.status is Status.OPTIMAL
    assert path.elapsed_s + path.setup_s <= time.perf_counter() - begin_s
