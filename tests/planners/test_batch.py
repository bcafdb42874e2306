"""Many queries at once: against SciPy's Dijkstra, MovingAI's published lengths, and the search one by one."""

import itertools

import jax
import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.errors import InputError
from jaxurban.planners import bulk
from jaxurban.planners import registry as many
from jaxurban.planners.astar import astar, cost_to_go
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.bulk import solve_by_frontier
from jaxurban.planners.cost import STEPS, CostModel
from jaxurban.planners.registry import FEW_QUERIES, FEW_TO_ONE_GOAL, GPU_BATCH, choose_heuristics, solve_many

SHAPE = (21, 34)
MODELS = list(itertools.product(["cell", "line"], [("both-free", 8), ("always", 8), ("both-free", 4)]))


def random_map(seed, cost_model="cell", diagonal="both-free", connectivity=8, shape=SHAPE):
    """A map with walls, free and dear cells; NaN inside walls in every second one."""
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < 0.72
    layers = rng.random((2, *shape)) ** 3 * np.array([3.0, 0.5])[:, None, None]
    layers[:, rng.random(shape) < 0.2] = 0.0
    if seed % 2:
        layers = np.where(is_free, layers, np.nan)
    anywhere = tuple(int(v) for v in np.argwhere(is_free)[0])
    model = CostModel(cost_model, 3.0, connectivity, diagonal)
    return Problem(layers, is_free, anywhere, anywhere, 2.0, 0.2 * (seed % 3), model)


def random_queries(problem, num, seed=0):
    rng = np.random.default_rng(seed)
    free = [tuple(int(v) for v in cell) for cell in np.argwhere(problem.is_free)]
    return [problem.between(*(free[k] for k in rng.choice(len(free), 2))) for _ in range(num)]


def dijkstra_to_goal(problem):
    """Cost from every cell to the goal, by SciPy, each edge written out by the definition."""
    num_rows, num_cols = problem.is_free.shape
    number = np.arange(num_rows * num_cols).reshape(num_rows, num_cols)
    framed = np.pad(problem.is_free, 1)
    edges = []
    for rows, cols in STEPS[: problem.cost_model.connectivity]:
        window = (slice(1 + rows, 1 + rows + num_rows), slice(1 + cols, 1 + cols + num_cols))
        is_allowed = problem.is_free & framed[window]
        if rows and cols and problem.cost_model.diagonal == "both-free":
            is_allowed &= framed[window[0], 1:-1] & framed[1:-1, window[1]]
        here = number[is_allowed]
        there = here + rows * num_cols + cols
        length_m = problem.resolution_m * np.hypot(rows, cols)
        cost = problem.cost.ravel()
        map_cost = cost[there]
        if problem.cost_model.kind == "line":
            map_cost = length_m * (cost[here] + cost[there]) / 2 / problem.cost_model.reference_length_m
        # SciPy takes an edge of cost 0 for none.
        edges.append((here, there, np.maximum(problem.distance_weight * length_m + map_cost, 1e-300)))
    here, there, weight = (np.concatenate(part) for part in zip(*edges, strict=True))
    graph = csr_array((weight, (there, here)), shape=(number.size, number.size))
    return dijkstra(graph, indices=number[problem.goal]).reshape(problem.is_free.shape)


def assert_optimal(path, problem):
    optimum = dijkstra_to_goal(problem)[problem.start]
    if np.isinf(optimum):
        assert path.status is Status.NO_PATH
        assert path.lower_bound == np.inf
        assert path.points_m.shape == (0, 2)
        return
    assert path.status is Status.OPTIMAL
    assert path.cost == pytest.approx(optimum, rel=1e-11, abs=1e-12)
    assert path.lower_bound == path.cost
    assert problem.features(path.points_m).is_valid
    cells = np.floor(path.points_m[:, ::-1] / problem.resolution_m).astype(int)
    np.testing.assert_array_equal(cells[[0, -1]], [problem.start, problem.goal])
    assert np.abs(np.diff(cells, axis=0)).max(initial=0) <= 1


def spiral():
    """One corridor, a cell wide, winding inward; returns the map and its two ends."""
    is_free = np.zeros(SHAPE, bool)
    row, col, rows, cols = 0, 0, 0, 1
    is_free[0, 0] = True

    def is_wall(row, col):
        return 0 <= row < SHAPE[0] and 0 <= col < SHAPE[1] and not is_free[row, col]

    def may_step():
        beyond = (row + 2 * rows, col + 2 * cols)
        is_at_border = not (0 <= beyond[0] < SHAPE[0] and 0 <= beyond[1] < SHAPE[1])
        return is_wall(row + rows, col + cols) and (is_at_border or is_wall(*beyond))

    while True:
        if not may_step():
            rows, cols = cols, -rows
            if not may_step():
                return is_free, (0, 0), (row, col)
        row, col = row + rows, col + cols
        is_free[row, col] = True


def mixed_batch():
    """A court, a start at its goal, a free ride, a spiral both ways, then random queries: eight maps of one shape."""
    court = np.ones(SHAPE, bool)
    court[4:7, 4:7] = False
    court[5, 5] = True
    free = Problem(np.zeros((1, *SHAPE)), court, (0, 0), (0, 0), 1.0, 0.0)
    is_free, outer, inner = spiral()
    inward = Problem(np.zeros((1, *SHAPE)), is_free, outer, inner, 1.0, 1.0)
    problems = [free.between((0, 0), (5, 5)), free, free.between((0, 0), (20, 33))]
    problems += [inward, inward.between(inner, outer)]
    for seed, (cost_model, moves) in enumerate(MODELS):
        problems += random_queries(random_map(seed, cost_model, *moves), 4, seed)
    return problems


@pytest.mark.parametrize("band_steps", [pytest.param(0.0, marks=pytest.mark.slow), 1.0, 8.0, np.inf])
def test_the_frontier_is_exact_for_every_band_on_many_maps_at_once(band_steps):
    problems = mixed_batch()
    paths = dict(solve_by_frontier(problems, planner="astar-plus", band_steps=band_steps))
    assert sorted(paths) == list(range(len(problems)))
    for index, problem in enumerate(problems):
        assert_optimal(paths[index], problem)
        assert paths[index].backend == "jax"
        assert paths[index].cost == pytest.approx(astar(problem).cost, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize(("cost_model", "moves"), MODELS)
def test_the_cost_to_go_equals_dijkstras_everywhere(cost_model, moves):
    for seed in range(4):
        problem = random_queries(random_map(seed, cost_model, *moves), 1, seed)[0]
        field = cost_to_go(problem)
        np.testing.assert_allclose(
            field[problem.is_free], dijkstra_to_goal(problem)[problem.is_free], rtol=1e-11, atol=1e-11
        )


@pytest.mark.parametrize("backend", ["numba", "jax"])
def test_a_winding_corridor_of_one_cell_is_walked_to_its_end(backend):
    problems = mixed_batch()
    inward, outward = problems[3:5]
    expected = inward.is_free.sum() - 1  # every cell of the corridor once
    assert expected > 300
    paths = dict(solve_many(problems, backend=backend))
    assert [paths[k].cost for k in (3, 4)] == pytest.approx([expected] * 2)
    assert cost_to_go(inward)[inward.start] == pytest.approx(expected)
    assert cost_to_go(outward)[outward.start] == pytest.approx(expected)


@pytest.mark.parametrize("backend", ["numba", "jax"])
def test_a_closed_court_start_at_the_goal_and_free_rides_are_told_apart(backend):
    paths = dict(solve_many(mixed_batch(), backend=backend))
    court, itself, free_ride = (paths[k] for k in range(3))
    assert (court.status, court.lower_bound) == (Status.NO_PATH, np.inf)
    assert (itself.status, itself.cost, len(itself.points_m)) == (Status.OPTIMAL, 0.0, 1)
    assert (free_ride.status, free_ride.cost) == (Status.OPTIMAL, 0.0)
    assert "costs nothing" in free_ride.note


@pytest.mark.parametrize(("backend", "num_others"), [("numba", 3), ("jax", 3)])
def test_queries_to_one_goal_share_its_field(backend, num_others):
    queries = random_queries(random_map(0), FEW_TO_ONE_GOAL + num_others)
    problems = [query.between(query.start, queries[0].goal) for query in queries[:FEW_TO_ONE_GOAL]]
    problems += queries[FEW_TO_ONE_GOAL:]
    paths = dict(solve_many(problems, backend=backend))
    for index, query in enumerate(problems):
        assert_optimal(paths[index], query)
        is_walked = index < FEW_TO_ONE_GOAL
        assert paths[index].backend == ("numba" if is_walked else backend)
        assert (paths[index].heuristic == "exact") == is_walked


def test_a_map_with_many_queries_gets_landmarks_and_the_answers_stay():
    queries = random_queries(random_map(2), FEW_QUERIES + 1)
    paths = dict(solve_many(queries, num_threads=2))
    assert {path.heuristic for path in paths.values()} == {"landmarks"}
    for index, query in enumerate(queries):
        assert_optimal(paths[index], query)


def test_what_is_chosen_depends_on_all_queries_and_not_on_those_that_are_left():
    problem = random_map(2)
    queries = random_queries(problem, FEW_QUERIES + 1)
    queries += [query.between(query.start, (20, 33)) for query in random_queries(problem, FEW_TO_ONE_GOAL)]
    whole = dict(solve_many(queries, num_threads=1))
    names = [whole[k].heuristic for k in range(len(queries))]
    assert names == choose_heuristics(queries, "astar-plus", None, np.inf)
    assert names == ["landmarks"] * (FEW_QUERIES + 1) + ["exact"] * FEW_TO_ONE_GOAL
    only = [3, FEW_QUERIES + 4]
    fresh = [problem.with_weights(problem.weights)]
    rest = dict(solve_many([fresh[0].between(q.start, q.goal) for q in queries], only=only, num_threads=2))
    assert sorted(rest) == only
    for k in only:
        assert rest[k].heuristic == names[k]
        np.testing.assert_array_equal(rest[k].points_m, whole[k].points_m)
    # Budgets that the fields would not fit into are left to the searches.
    assert set(choose_heuristics(queries, "astar-plus", None, 1e-6)) == {None}
    assert set(choose_heuristics(queries, "astar-plus", "tiles", np.inf)) == {"tiles"}


def test_without_a_gpu_numba_is_chosen_and_every_planner_runs_on_it():
    queries = random_queries(random_map(1), 3)
    for planner, backend in (("astar-dist", "numba"), ("ptp", "numpy")):
        paths = dict(solve_many(queries, planner=planner))
        assert {path.backend for path in paths.values()} == {backend}
        assert {path.planner for path in paths.values()} == {planner}


def test_a_crash_takes_the_place_of_its_path_alone(monkeypatch):
    queries = random_queries(random_map(1), 6)

    def search(problem, *, budget_s, seed):
        if problem is queries[2]:
            raise ZeroDivisionError("by a bug")
        return astar(problem, budget_s=budget_s)

    monkeypatch.setattr(many, "find_planner", lambda name, heuristic: search)
    outcomes = dict(solve_many(queries, planner="astar-dist"))
    assert isinstance(outcomes.pop(2), ZeroDivisionError)
    assert all(outcomes[index].status in (Status.OPTIMAL, Status.NO_PATH) for index in (0, 1, 3, 4, 5))


def test_no_search_begins_after_the_iterator_is_closed(monkeypatch):
    begun = []

    def search(problem, *, budget_s, seed):
        begun.append(problem)
        return astar(problem)

    monkeypatch.setattr(many, "find_planner", lambda name, heuristic: search)
    outcomes = solve_many(random_queries(random_map(1), 100), planner="astar-dist", num_threads=1)
    next(outcomes)
    outcomes.close()
    assert len(begun) <= 4


def test_a_spent_budget_ends_the_frontier_search_with_a_bound(monkeypatch):
    problems = mixed_batch()
    monkeypatch.setattr(bulk, "ROUNDS_AT_ONCE", 3)
    paths = dict(solve_many(problems, backend="jax", budget_s=1e-9))
    for index, problem in enumerate(problems):
        optimum = dijkstra_to_goal(problem)[problem.start]
        assert paths[index].lower_bound <= optimum * (1 + 1e-12)
        assert paths[index].cost >= optimum * (1 - 1e-12)
    assert paths[3].status is Status.BUDGET_EMPTY
    assert paths[3].lower_bound > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"planner": "ptp", "backend": "jax"}, "take backend='numba'"),
        ({"heuristic": "landmarks", "backend": "jax"}, "take backend='numba'"),
        ({"backend": "cuda"}, "backend must be 'auto', 'numba' or 'jax', got 'cuda'"),
        ({"num_threads": 0}, "num_threads must be a whole number from 1 up, got 0"),
        ({"planner": "astar"}, "unknown planner"),
    ],
)
def test_wrong_arguments_are_refused_at_once(options, message):
    with pytest.raises(InputError, match=message):
        solve_many([], **options)


def movingai_problems(data_dir, name):
    """Every problem of a map with its published length; the file's first row is the northern one."""
    rows = (data_dir / "movingai" / f"{name}.map").read_text().splitlines()[4:]
    is_free = np.array([list(row) for row in rows[::-1]]) == "."
    problem, lengths = None, []
    problems = []
    for line in (data_dir / "movingai" / f"{name}.map.scen").read_text().splitlines()[1:]:
        x0, y0, x1, y1, length = line.split()[4:]
        start, goal = (len(rows) - 1 - int(y0), int(x0)), (len(rows) - 1 - int(y1), int(x1))
        problem = problem or Problem(np.zeros((1, *is_free.shape)), is_free, start, goal, 1.0, 1.0)
        problems.append(problem.between(start, goal))
        lengths.append(float(length))
    return problems, lengths


BACKENDS = [("numba", None), ("numba", "landmarks"), ("jax", None)]


def check_movingai(problems, lengths, backend, heuristic):
    for index, path in solve_many(problems, backend=backend, heuristic=heuristic):
        assert path.status is Status.OPTIMAL
        assert path.cost == pytest.approx(lengths[index], abs=1e-3)


@pytest.mark.slow
@pytest.mark.data
def test_a_sample_of_movingai_is_optimal_in_jax(data_dir):
    problems, lengths = movingai_problems(data_dir, "Berlin_0_256")
    check_movingai(problems[::100], lengths[::100], "jax", None)


@pytest.mark.gpu
def test_a_gpu_takes_a_batch_and_gives_the_answers_of_numba():
    if jax.default_backend() == "cpu":
        pytest.skip("JAX sees no GPU")
    queries = random_queries(random_map(2), GPU_BATCH)
    paths = dict(solve_many(queries))
    assert {path.backend for path in paths.values()} == {"jax"}
    for index, query in enumerate(queries):
        assert_optimal(paths[index], query)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(("backend", "heuristic"), BACKENDS)
@pytest.mark.parametrize(("name", "num"), [("NewYork_0_512", 1790), ("Berlin_0_256", 930)])
def test_every_problem_of_movingai_is_optimal_by_every_backend(data_dir, name, num, backend, heuristic):
    problems, lengths = movingai_problems(data_dir, name)
    assert len(problems) == num
    check_movingai(problems, lengths, backend, heuristic)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(("name", "num"), [("NewYork_0_512", 1790), ("Berlin_0_256", 930)])
def test_every_problem_of_movingai_starts_at_its_length_in_the_cost_to_go(data_dir, name, num):
    problems, lengths = movingai_problems(data_dir, name)
    for problem, length in zip(problems, lengths, strict=True):
        assert cost_to_go(problem)[problem.start] == pytest.approx(length, abs=1e-3)
    assert len(lengths) == num
