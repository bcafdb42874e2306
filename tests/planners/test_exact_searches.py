"""The exact searches of a grid or of levels, one by one and many at once: against SciPy's Dijkstra, and MovingAI."""

import itertools

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from jaxurban.kernels.search import tiles
from jaxurban.kernels.search.heap import EXHAUSTED, FOUND
from jaxurban.planners import grid_search, registry, tile_search
from jaxurban.planners.astar import (
    ADMISSIBLE,
    VOLUME_HEURISTICS,
    astar,
    exact_cost_to_go,
    heuristic_at,
    make_heuristic,
    make_landmarks,
)
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.grid_search import NO_HEURISTIC, GridSearch, cell_of, graph_of
from jaxurban.planners.registry import (
    FEW_QUERIES,
    FEW_TO_ONE_GOAL,
    GPU_BATCH,
    choose_heuristics,
    solve_many,
)
from jaxurban.planners.tile_search import costs_by_tiles, solve_by_tiles
from tests.movingai import GridProblem, read_map, read_scenarios
from tests.planners.problems import (
    assert_optimal,
    costs_to_goal,
    edges_of,
    random_problem,
    random_queries,
)

SHAPE = (21, 34)
SEEDS = st.integers(0, 10**6)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(13, 17), (8, 2), (1, 50), (43, 61), (4, 5, 6), (1, 9, 11)])
@settings(max_examples=12)
@given(seed=SEEDS, dtype=st.sampled_from([np.float32, np.float64]))
def test_bounds_are_admissible_and_consistent_and_paths_cost_what_dijkstra_finds(
    shape, seed, dtype
):
    problem = random_problem(seed, shape, dtype)
    edges = edges_of(problem)
    to_go, steps, goal = (
        costs_to_goal(problem, edges),
        edges.tocoo(),
        cell_of(problem, problem.goal),
    )
    slack = 1e-12 * to_go.max(where=np.isfinite(to_go), initial=0.0)
    for name in ADMISSIBLE if problem.levels_m is None else VOLUME_HEURISTICS:
        bound = make_heuristic(name, problem)
        h = np.array(
            [heuristic_at(bound, cell_of(problem, node), goal) for node in np.ndindex(shape)]
        )
        assert (h <= to_go.ravel() + slack)[problem.is_free.ravel()].all()
        # Also of cells that no way joins to the goal.
        rounding = 1e-12 * h.max(where=np.isfinite(h), initial=0.0)
        if name == "landmarks":  # whose costs are float32
            rounding = max(rounding, slack) * (2 * np.finfo(np.float32).eps / 1e-12)
        assert (h[steps.row] <= steps.data + h[steps.col] + rounding).all()
        if name == "exact":
            np.testing.assert_allclose(
                h.reshape(shape)[problem.is_free], to_go[problem.is_free], atol=slack + 1e-12
            )
        path = astar(problem, heuristic=name)
        assert_optimal(path, problem, to_go[problem.start])
        assert path.heuristic == name


@settings(max_examples=20)
@given(
    seed=SEEDS,
    reopen=st.booleans(),
    left_there=st.sampled_from([0.0, -1.0, np.nan, np.inf, 5e-324]),
)
def test_costs_to_all_cells_are_dijkstras_whatever_the_memory_held(seed, reopen, left_there):
    problem = random_problem(seed, (41, 53))
    search = GridSearch(graph_of(problem), NO_HEURISTIC, problem.start, None)
    search._g[search._state == 0] = left_there
    assert search.run(reopen=reopen) == EXHAUSTED
    expected = dijkstra(
        edges_of(problem), indices=np.ravel_multi_index(problem.start, problem.is_free.shape)
    )
    np.testing.assert_allclose(search.costs_from_start(), expected, rtol=1e-12, atol=1e-12)


def test_a_search_that_ends_early_knows_no_way_to_what_it_has_not_come_to():
    problem = (
        random_problem(0, (41, 53), share_free=1.0)
        .with_weights([0.3, 1, 1, 1])
        .between((1, 1), (2, 2))
    )
    search = GridSearch(graph_of(problem), NO_HEURISTIC, problem.start, problem.goal)
    assert search.run() == FOUND
    costs = search.costs_from_start()
    assert 0 < costs[search.goal] < np.inf
    assert np.isinf(costs[-1])


def test_a_map_without_layers_is_searched_by_length_alone():
    problem = Problem(np.zeros((0, 3, 4)), np.ones((3, 4), bool), (0, 0), (0, 3), 2.0, 1.0)
    assert astar(problem).cost == 6.0


@pytest.mark.parametrize(
    ("cost_model", "map_cost"), [("cell", 2.0 + 3.0), ("line", (30 * 1.5 + 60 * 2.5) / 4)]
)
def test_a_climb_on_the_spot_pays_its_height_and_the_nodes_it_enters(cost_model, map_cost):
    cost, levels_m = np.array([1.0, 2.0, 3.0])[None, :, None, None], [10.0, 40.0, 100.0]
    free, model = np.ones((3, 1, 1), bool), CostModel(cost_model, 4.0)
    up = Problem(cost, free, (0, 0, 0), (2, 0, 0), 5.0, [0.1, 1.0, 0.5, 0.25], model, levels_m)
    path = astar(up, heuristic="plus")
    assert path.cost == pytest.approx((0.1 + 0.5) * 90 + map_cost)
    np.testing.assert_array_equal(path.points_m, [[2.5, 2.5, z_m] for z_m in levels_m])
    down_map_cost = 2.0 + 1.0 if cost_model == "cell" else map_cost
    down = astar(up.between(up.goal, up.start), heuristic="plus")
    assert down.cost == pytest.approx((0.1 + 0.25) * 90 + down_map_cost)


@pytest.mark.slow
def test_no_path_crosses_what_stands_between_its_levels():
    rng, num_checked, levels_m = np.random.default_rng(5), 0, np.array([20.0, 22.0, 29.0, 60.0])
    for _ in range(40):
        roof_m = np.where(rng.random((12, 12)) < 0.5, 0.0, rng.uniform(10.0, 72.0, (12, 12)))
        is_free = roof_m < levels_m[:, None, None]
        free, costs = tuple(map(int, np.argwhere(is_free)[0])), rng.random((1, *is_free.shape))
        volume = Problem(costs, is_free, free, free, 5.0, [0.1, 1.0, 0.0, 0.0], "cell", levels_m)
        for query in random_queries(volume, 50, rng.integers(1000)):
            path = astar(query, heuristic="plus")
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


def test_chunks_and_a_growing_queue_change_nothing(monkeypatch):
    problem = random_problem(3, (60, 70), kind="cell", diagonal="always", connectivity=8)
    whole = astar(problem)
    monkeypatch.setattr(grid_search, "CHUNK", 7)
    monkeypatch.setattr(grid_search, "FIRST_ENTRIES", 8)
    pieces = astar(problem)
    np.testing.assert_array_equal(pieces.points_m, whole.points_m)
    assert pieces.num_expanded == whole.num_expanded > 100


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_costs_orders_of_magnitude_apart_are_taken_in_their_order(cost_model):
    layers, free = (
        10 ** np.random.default_rng(6).uniform(-6, 9, (1, 12, 60)),
        np.ones((12, 60), bool),
    )
    for distance_weight in (0.0, 1e-3, 1e6):
        problem = Problem(
            layers, free, (1, 2), (10, 55), 2.0, distance_weight, CostModel(cost_model, 3.0)
        )
        optimum = costs_to_goal(problem)[problem.start]
        for name in ("none", "octile", "tiles"):
            path = astar(problem, heuristic=name)
            assert path.cost == pytest.approx(optimum, rel=1e-12)
            assert path.num_expanded < problem.cost.size


@pytest.mark.parametrize("shape", [(60, 60), (4, 30, 30)])
def test_a_spent_budget_leaves_a_lower_bound_and_no_path(monkeypatch, shape):
    problem = random_problem(4, shape, share_free=1.0, kind="cell", connectivity=8)
    weights = np.where(problem.weights == 0, 0.3, problem.weights)
    problem = problem.with_weights(weights).between(
        (0,) * len(shape), tuple(size - 1 for size in shape)
    )
    optimum = astar(problem, heuristic="octile").cost
    monkeypatch.setattr(grid_search, "CHUNK", 50)
    for name in ADMISSIBLE if problem.levels_m is None else VOLUME_HEURISTICS:
        astar(problem, heuristic=name)  # makes what it needs beforehand
        path = astar(problem, heuristic=name, budget_s=1e-9)
        assert (path.status, path.num_expanded, len(path.points_m)) == (Status.BUDGET_EMPTY, 50, 0)
        # The exact costs to go are added up from the other end.
        assert (
            0 <= path.lower_bound <= (np.nextafter(optimum, np.inf) if name == "exact" else optimum)
        )
    path = astar(problem, heuristic="octile", budget_s=1e-9)
    assert (
        path.lower_bound
        > (shape[-1] - 1) * np.sqrt(2) * problem.distance_weight * problem.resolution_m
    )


def mixed_batch():
    """A court, a start at its goal, a free ride, a winding corridor both ways, random queries: eight maps."""
    court = np.ones(SHAPE, bool)
    court[4:7, 4:7] = False
    court[5, 5] = True
    free = Problem(np.zeros((1, *SHAPE)), court, (0, 0), (0, 0), 1.0, 0.0)
    corridor, last = (
        np.ones(SHAPE, bool),
        (SHAPE[0] - 1, SHAPE[1] - 1),
    )  # a cell wide, to and fro over the whole map
    corridor[1::2] = False
    corridor[1::4, -1] = corridor[3::4, 0] = True
    along = Problem(np.zeros((1, *SHAPE)), corridor, (0, 0), last, 1.0, 1.0)
    problems = [free.between((0, 0), (5, 5)), free, free.between((0, 0), (20, 33))]
    problems += [along, along.between(last, (0, 0))]
    kinds = itertools.product(["cell", "line"], [("both-free", 8), ("always", 8), ("both-free", 4)])
    for seed, (kind, (diagonal, connectivity)) in enumerate(kinds):
        model = {"kind": kind, "diagonal": diagonal, "connectivity": connectivity}
        problems += random_queries(random_problem(seed, SHAPE, **model), 4, seed)
    return problems


BANDS = [0.0, tile_search.BAND_STEPS, 1e30]


@pytest.mark.parametrize(
    "band_steps",
    [None, *(pytest.param(band, marks=pytest.mark.slow) for band in BANDS)],
)
def test_many_maps_at_once_are_solved_exactly_by_numba_and_by_tiles_with_every_band(
    monkeypatch, band_steps
):
    problems = mixed_batch()
    if band_steps is None:
        paths = dict(solve_many(problems, backend="numba"))
    else:
        monkeypatch.setattr(tile_search, "BAND_STEPS", band_steps)
        paths = dict(solve_by_tiles(problems, planner="astar-plus"))
    assert sorted(paths) == list(range(len(problems)))
    for index, problem in enumerate(problems):
        assert_optimal(paths[index], problem)
        assert paths[index].backend == ("numba" if band_steps is None else "jax")
        assert exact_cost_to_go(problem)[problem.start] == pytest.approx(
            paths[index].cost, rel=1e-11, abs=1e-12
        )
    assert paths[0].status is Status.NO_PATH
    assert "costs nothing" in paths[2].note
    assert [paths[k].cost for k in (3, 4)] == [
        problems[3].is_free.sum() - 1
    ] * 2  # every cell of the corridor once


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["numba", "jax"])
def test_queries_to_one_goal_share_its_field_under_each_weights_and_the_others_are_searched(
    backend,
):
    first, queries, others = random_problem(0, SHAPE), [], mixed_batch()
    for problem in (first, first.with_weights(first.weights * [1.0, 5.0, 0.2, 1.0])):
        for goal in [query.goal for query in random_queries(problem, 2, 4)]:
            queries += [
                query.between(query.start, goal)
                for query in random_queries(problem, FEW_TO_ONE_GOAL)
            ]
    paths = dict(solve_many(queries + others, backend=backend))
    for index, query in enumerate(queries + others):
        is_walked = index < len(queries)
        assert paths[index].backend == ("numba" if is_walked else backend)
        assert (paths[index].heuristic == "exact") == is_walked
        if index % 3 == 0:
            assert_optimal(paths[index], query)


def test_what_is_chosen_depends_on_all_queries_and_not_on_those_that_are_left():
    problem = random_problem(2, SHAPE)
    queries = random_queries(problem, FEW_QUERIES + 1)
    queries += [
        query.between(query.start, queries[0].start)
        for query in random_queries(problem, FEW_TO_ONE_GOAL)
    ]
    whole = dict(solve_many(queries, num_threads=1))
    names = [whole[k].heuristic for k in range(len(queries))]
    assert names == choose_heuristics(queries, "astar-plus", None, np.inf)
    assert names == ["landmarks"] * (FEW_QUERIES + 1) + ["exact"] * FEW_TO_ONE_GOAL
    only = [3, FEW_QUERIES + 4]
    fresh = problem.with_weights(problem.weights)
    rest = dict(
        solve_many([fresh.between(q.start, q.goal) for q in queries], only=only, num_threads=2)
    )
    assert sorted(rest) == only
    for k in only:
        assert rest[k].heuristic == names[k]
        np.testing.assert_array_equal(rest[k].points_m, whole[k].points_m)
        assert_optimal(whole[k], queries[k])
    # Budgets that the fields would not fit into are left to the searches.
    assert set(choose_heuristics(queries, "astar-plus", None, 1e-6)) == {None}
    assert set(choose_heuristics(queries, "astar-plus", "tiles", np.inf)) == {"tiles"}


def test_without_a_gpu_numba_is_chosen_and_every_planner_runs_on_it():
    queries = random_queries(random_problem(1, SHAPE), 3)
    for planner, backend in (("astar-dist", "numba"), ("ptp", "numpy")):
        paths = dict(solve_many(queries, planner=planner))
        assert {(path.planner, path.backend) for path in paths.values()} == {(planner, backend)}


def test_a_crash_takes_the_place_of_its_path_and_no_search_begins_after_the_iterator_is_closed(
    monkeypatch,
):
    queries, begun = random_queries(random_problem(1, SHAPE), 100), []

    def search(problem, *, budget_s, seed):
        begun.append(problem)
        if problem is queries[2]:
            raise ZeroDivisionError("by a bug")
        return astar(problem, budget_s=budget_s)

    monkeypatch.setattr(registry, "find_planner", lambda name, heuristic, **_: search)
    outcomes = dict(solve_many(queries[:6], planner="astar-dist"))
    assert isinstance(outcomes.pop(2), ZeroDivisionError)
    assert all(
        outcomes[index].status in (Status.OPTIMAL, Status.NO_PATH) for index in (0, 1, 3, 4, 5)
    )
    begun.clear()
    closed = solve_many(queries, planner="astar-dist", num_threads=1)
    next(closed)
    closed.close()
    assert len(begun) <= 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cell", "line"])
@pytest.mark.parametrize("connectivity", [4, 8])
def test_tiles_are_exact_over_many_tiles_and_wide_spreads_whatever_runs_beside(kind, connectivity):
    shape = (50, 77)
    rng = np.random.default_rng(8)
    free = rng.random(shape) < 0.8
    layer = np.where(rng.random(shape) < 0.3, 0.0, 10 ** rng.uniform(-4, 5, shape))
    model = CostModel(kind, 3.0, connectivity)
    cells = [tuple(map(int, cell)) for cell in np.argwhere(free)]
    problem = Problem(layer[None], free, cells[0], cells[-1], 2.0, 1e-3, model)
    queries = random_queries(problem, 20)
    paths = dict(solve_by_tiles(queries, planner=""))
    alone = dict(solve_by_tiles(queries[3:4], planner=""))[0]
    np.testing.assert_array_equal(alone.points_m, paths[3].points_m)
    for index, query in enumerate(queries):
        assert_optimal(paths[index], query)
    make_landmarks(problem)
    bounded = dict(solve_by_tiles(queries, planner=""))
    for index, path in bounded.items():
        assert path.heuristic == "landmarks"
        np.testing.assert_array_equal(path.points_m, paths[index].points_m)
    np.testing.assert_allclose(costs_by_tiles(problem), exact_cost_to_go(problem), rtol=1e-12)


@pytest.mark.parametrize("step", [(1, 0), (0, 1), (1, 1), (1, -1), (-1, -1)])
def test_tiles_leave_a_goal_whose_only_way_leads_into_the_next_tile(step):
    free = np.zeros((96, 96), bool)
    goal = np.where(
        np.array(step) < 0, 32, 63
    )  # on the rim, or in a corner, of the tile in the middle
    way = [tuple(map(int, goal + k * np.array(step))) for k in range(9)]
    free[tuple(np.array(way).T)] = True
    model = CostModel("line", 3.0, diagonal="always")
    problem = Problem(np.ones((1, *free.shape)), free, way[-1], way[0], 2.0, 0.1, model)
    assert_optimal(dict(solve_by_tiles([problem], planner=""))[0], problem)


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_landmarks_bound_the_cost_from_a_start_to_every_cell_of_a_tile_tighter_than_octile(kind):
    problem = random_problem(3, (70, 100), kind=kind)
    start = np.array([problem.start], np.int32)
    _, octile, _ = tile_search._tiled(problem, start)
    make_landmarks(problem)
    _, bound, _ = tile_search._tiled(problem, start)
    costs = exact_cost_to_go(problem.between(problem.start, problem.start))
    if kind == "cell":  # the same way back pays the other end's cell
        costs = costs + problem.cost - problem.cost[problem.start]
    for (i, j), least in np.ndenumerate(bound[0]):
        own = costs[32 * i : 32 * (i + 1), 32 * j : 32 * (j + 1)]
        assert least <= np.nanmin(own) * (1 + 1e-12) + 1e-12
    assert (bound >= octile).all()
    assert bound.sum() > octile.sum()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cell", "line"])
def test_tiles_as_a_gpu_lowers_them_cost_what_sweeps_find(monkeypatch, kind):
    problem = random_problem(3, SHAPE, kind=kind)
    swept = costs_by_tiles(problem)
    monkeypatch.setattr(tiles.lax, "platform_dependent", lambda g, *, cpu, default: default(g))
    jax.clear_caches()
    together = costs_by_tiles(problem)
    jax.clear_caches()
    np.testing.assert_array_equal(together, swept)


@pytest.mark.slow
def test_a_spent_budget_ends_the_search_by_tiles_with_a_bound(monkeypatch):
    problems = mixed_batch()
    monkeypatch.setattr(tile_search, "ROUNDS_AT_ONCE", 1)
    paths = dict(solve_many(problems, backend="jax", budget_s=1e-9))
    for index, problem in enumerate(problems):
        optimum = costs_to_goal(problem)[problem.start]
        assert paths[index].lower_bound <= optimum * (1 + 1e-12)
        assert paths[index].cost >= optimum * (1 - 1e-12)
    assert paths[3].status is Status.BUDGET_EMPTY
    assert paths[3].lower_bound > 0


# On New York each compiled search, and some in JAX, which takes longer on a CPU.
SLOWER = [("numba", None, 1), ("numba", "landmarks", 1), ("numba", "exact", 5), ("jax", None, 100)]


@pytest.mark.data
@pytest.mark.parametrize(
    ("backend", "heuristic", "every"),
    [("numba", "octile", 1), *(pytest.param(*row, marks=pytest.mark.slow) for row in SLOWER)],
)
@pytest.mark.parametrize(
    "name", [pytest.param("NewYork_0_512", marks=pytest.mark.slow), "Berlin_0_256"]
)
def test_the_published_lengths_of_movingai_are_reproduced(
    data_dir, name, backend, heuristic, every
):
    is_free = read_map(data_dir / "movingai" / f"{name}.map")
    queries = read_scenarios(data_dir / "movingai" / f"{name}.map.scen")
    sizes = {"NewYork_0_512": ((512, 512), 1790), "Berlin_0_256": ((256, 256), 930)}
    assert (is_free.shape, len(queries)) == sizes[name]
    if name == "Berlin_0_256":
        assert queries[0] == GridProblem((255 - 165, 248), (255 - 164, 249), 2.0)
    on_map = Problem(
        np.zeros((1, *is_free.shape)), is_free, queries[0].start, queries[0].goal, 1.0, 1.0
    )
    problems = [on_map.between(query.start, query.goal) for query in queries[::every]]
    for index, path in solve_many(problems, backend=backend, heuristic=heuristic):
        assert path.status is Status.OPTIMAL
        assert path.cost == pytest.approx(queries[::every][index].length, abs=1e-3)


@pytest.mark.gpu
def test_a_gpu_takes_a_batch_and_gives_the_answers_of_numba():
    if jax.default_backend() == "cpu":
        pytest.skip("JAX sees no GPU")
    queries = random_queries(random_problem(2, SHAPE), GPU_BATCH)
    paths = dict(solve_many(queries))
    assert {path.backend for path in paths.values()} == {"jax"}
    for index, query in enumerate(queries):
        assert_optimal(paths[index], query)
