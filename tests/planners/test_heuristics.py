"""Heuristics of A*: what they save, when their tables are made, landmarks, tiles, and the paper's printed bound."""

import numpy as np
import pytest

from jaxurban.kernels.search.bounds import TILE, printed_plus_field
from jaxurban.planners.astar import (
    astar,
    exact_cost_to_go,
    heuristic_at,
    landmark_cells,
    make_heuristic,
    make_landmarks,
)
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from tests.planners.problems import costs_to_goal, random_problem, random_queries


def city(cost_model="cell", connectivity=8, shape=(60, 70), seed=0):
    """Scattered obstacles and random costs, between two corners."""
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < 0.85
    is_free[:2, :2] = is_free[-2:, -2:] = True
    model = CostModel(cost_model, connectivity=connectivity)
    return Problem(
        rng.random((1, *shape)), is_free, (0, 0), (shape[0] - 1, shape[1] - 1), 5.0, 0.1, model
    )


def test_better_bounds_expand_fewer_nodes():
    rng = np.random.default_rng(4)
    uneven = Problem(
        0.5 + rng.random((1, 120, 90)),
        np.ones((120, 90), bool),
        (5, 5),
        (110, 40),
        1.0,
        1.0,
        "cell",
    )
    counts = [
        astar(uneven, heuristic=name).num_expanded
        for name in ("none", "euclidean", "octile", "tiles")
    ]
    assert counts == sorted(counts, reverse=True)
    shares = []
    for query in random_queries(city(shape=(150, 170)), 20):
        octile, guided = (astar(query, heuristic=name) for name in ("octile", "landmarks"))
        shares.append(guided.num_expanded / octile.num_expanded)
    assert np.mean(shares) < 0.25


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_the_bound_by_tiles_sees_costs_that_the_distance_does_not(kind):
    y, x = np.mgrid[:200, :300]
    noise = 1 + 0.05 * np.random.default_rng(0).random(y.shape)
    layers = ((2 + 1.8 * np.sin(x / 40) * np.sin(y / 30)) * noise)[None]
    problem = Problem(
        layers, np.ones(y.shape, bool), (60, 60), (150, 250), 1.0, 0.1, CostModel(kind, 1.0)
    )
    octile, tiles = (astar(problem, heuristic=name) for name in ("octile", "tiles"))
    assert tiles.cost == pytest.approx(octile.cost, rel=1e-12)
    assert tiles.num_expanded < 0.5 * octile.num_expanded


@pytest.mark.parametrize("shape", [(43, 61), (3 * TILE + 1, 5 * TILE), (TILE, 2), (1, 50)])
def test_a_tile_costs_what_its_cheapest_free_cell_does_rim_included(shape):
    problem = random_problem(1, shape, share_free=0.1)
    found = problem.tile_minima
    cost = np.where(problem.is_free, problem.cost, np.inf)
    expected = np.full(found.shape, np.inf)
    for i, j in np.ndindex(found.shape[0] - 2, found.shape[1] - 2):
        tile = cost[i * TILE : (i + 1) * TILE + 1, j * TILE : (j + 1) * TILE + 1]
        expected[i + 1, j + 1] = tile.min(initial=np.inf)
    np.testing.assert_array_equal(found, expected)


def test_tiles_prove_what_a_thick_wall_closes_and_hide_no_detour_beyond_what_they_look_at():
    is_free = np.ones((20, 90), bool)
    is_free[:, 30 : 30 + 2 * TILE + 1] = False
    closed = astar(
        Problem(np.ones((1, 20, 90)), is_free, (3, 3), (15, 80), 1.0, 1.0), heuristic="tiles"
    )
    assert (closed.status, closed.num_expanded) == (Status.NO_PATH, 0)
    is_free = np.ones((60, 400), bool)
    is_free[:58, 30] = False  # thinner than a tile: the bound goes straight through
    is_free[2:, 34] = False
    problem = Problem(np.ones((1, 60, 400)), is_free, (0, 25), (0, 40), 1.0, 1.0)
    octile, tiles = (astar(problem, heuristic=name) for name in ("octile", "tiles"))
    assert tiles.status is Status.OPTIMAL
    assert tiles.cost == pytest.approx(octile.cost, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("connectivity", [8, 4])
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_the_landmarks_bound_stays_below_the_cost_to_the_last_bit_and_at_a_landmark_is_it_both_ways(
    cost_model, connectivity
):
    for seed in range(5):
        problem = city(cost_model, connectivity, seed=seed)
        landmark = landmark_cells(problem, 8)[seed]
        for goal in (problem.goal, landmark):
            query = problem.between(problem.start, goal)
            bound, to_go = make_heuristic("landmarks", query), costs_to_goal(query)[problem.is_free]
            values = np.array(
                [heuristic_at(bound, tuple(cell), goal) for cell in np.argwhere(problem.is_free)]
            )
            assert np.all(values <= to_go)
        # Costs to landmarks are float32.
        rounding = 1e-6 * to_go.max(where=np.isfinite(to_go), initial=0.0)
        np.testing.assert_allclose(values, to_go, rtol=1e-6, atol=rounding)
        back = problem.between(landmark, problem.start)
        value = heuristic_at(make_heuristic("landmarks", back), landmark, back.goal)
        assert value == pytest.approx(costs_to_goal(back)[landmark], abs=rounding)


def test_landmarks_lie_far_apart_in_the_largest_part_of_the_map():
    is_free = np.ones((40, 60), bool)
    is_free[:, 40] = False  # a part of 19 columns is cut off
    problem = Problem(np.ones((1, 40, 60)), is_free, (0, 45), (39, 59), 1.0, 1.0)
    assert sorted(landmark_cells(problem, 4)) == [(0, 0), (0, 39), (39, 0), (39, 39)]
    assert (
        len(
            landmark_cells(
                Problem(np.ones((1, 1, 2)), np.ones((1, 2), bool), (0, 0), (0, 1), 1.0, 1.0), 8
            )
        )
        == 2
    )
    # The part that none of them reaches is searched as before.
    inside, plain = astar(problem, heuristic="landmarks"), astar(problem)
    assert (inside.cost, inside.num_expanded) == (plain.cost, plain.num_expanded)
    for start, goal in [((0, 0), (0, 59)), ((0, 59), (0, 0))]:
        for name in ("landmarks", "exact"):
            across = astar(problem.between(start, goal), heuristic=name)
            assert (across.status, across.num_expanded, across.lower_bound) == (
                Status.NO_PATH,
                0,
                np.inf,
            )


def test_tables_are_made_once_for_all_queries_that_they_serve():
    problem = city()
    first = astar(problem, heuristic="exact")
    assert first.num_expanded < 2 * len(first.points_m)  # straight to the goal
    field = exact_cost_to_go(problem)
    astar(problem.between((1, 1), problem.goal), heuristic="exact")
    assert make_heuristic("exact", problem).field is field
    assert make_heuristic("exact", problem.between(problem.goal, (1, 1))).field[1, 1] == 0
    assert problem.goal not in problem.with_weights([0.2, 1.0]).cache.costs_to_go
    landmarks = make_landmarks(problem)
    assert make_landmarks(problem.between((1, 1), (0, 0))) is landmarks


def test_auto_takes_tiles_however_often_it_is_asked_and_whatever_was_made():
    problem = city()
    first = astar(problem, heuristic="auto")
    for name in ("landmarks", "exact"):
        assert astar(problem, heuristic=name).heuristic == name
        path = astar(problem, heuristic="auto")
        assert path.heuristic == "tiles"
        np.testing.assert_array_equal(path.points_m, first.points_m)


@pytest.mark.parametrize("name", ["landmarks", "exact"])
def test_a_budget_that_ends_while_tables_are_built_is_reported_as_spent_and_nothing_is_kept(
    monkeypatch, name
):
    monkeypatch.setattr("jaxurban.planners.grid_search.CHUNK", 10)
    problem = city()
    path = astar(problem, heuristic=name, budget_s=1e-6)
    assert (path.status, path.num_expanded) == (Status.BUDGET_EMPTY, 0)
    assert "were not done in" in path.note
    assert 0 < path.lower_bound <= astar(problem).cost
    assert not problem.cache.costs_to_go
    assert problem.cache.landmarks is None
    assert astar(problem, heuristic=name).status is Status.OPTIMAL


def box_reduction(layers, goal, first_index):
    """The printed s_k, node by node, straight from the equations."""
    values = np.zeros(layers.shape[1:])
    for row, col in np.ndindex(values.shape):
        (south, north), (west, east) = sorted((row, goal[0])), sorted((col, goal[1]))
        box = layers[:, south : north + 1, west : east + 1]
        columns = box.min(axis=1)[:, first_index : first_index + east - west].sum(axis=1)
        rows = box.min(axis=2)[:, first_index : first_index + north - south].sum(axis=1)
        values[row, col] = np.maximum(columns, rows).sum()
    return values


@pytest.mark.parametrize("first_index", [1, 0])
def test_the_printed_field_equals_a_box_reduction_at_every_node(first_index):
    rng = np.random.default_rng(5)
    for shape in [(1, 1), (1, 7), (6, 1), (2, 2), (9, 12), (13, 8)]:
        layers, goal = rng.random((3, *shape)), tuple(rng.integers(shape).tolist())
        expected = box_reduction(layers, goal, first_index)
        np.testing.assert_allclose(
            printed_plus_field(layers, goal, first_index), expected, atol=1e-12
        )


# A wall of cost 5 between the southern corners, open only in the northern row.
WALL = np.array([[0.0, 5.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("name", "start", "goal"), [("plus-printed", 0, 2), ("plus-printed-from-0", 2, 0)]
)
@pytest.mark.parametrize("reopen", [True, False])
def test_the_printed_h_plus_misses_the_way_around_a_wall(name, start, goal, reopen):
    problem = Problem(WALL[None], np.ones((3, 3), bool), (0, start), (0, goal), 1.0, 1.0, "cell")
    printed = astar(problem, heuristic=name, reopen=reopen)
    assert (printed.cost, printed.status) == (pytest.approx(5 + 2), Status.FEASIBLE)
    assert printed.lower_bound == pytest.approx(2)
    exact = astar(problem, heuristic="auto")
    assert exact.cost == pytest.approx(2 + 2 * np.sqrt(2))
    cells = np.floor(exact.points_m[:, ::-1]).astype(int).tolist()
    assert cells == [[0, start], [1, start], [2, 1], [1, goal], [0, goal]]
    # North of the start the box ends at row 1, so the printed value counts the wall, which the path goes around.
    north = (1, start)
    assert heuristic_at(make_heuristic(name, problem), north, problem.goal) == pytest.approx(
        5 + 1 + np.sqrt(2)
    )
    assert costs_to_goal(problem)[north] == pytest.approx(1 + 2 * np.sqrt(2))


def test_the_printed_h_plus_is_inconsistent_where_the_goal_lies_west():
    problem = Problem(
        np.array([[[0.0, 0.0, 5.0]]]), np.ones((1, 3), bool), (0, 2), (0, 0), 1.0, 1.0, "cell"
    )
    heuristic = make_heuristic("plus-printed", problem)
    values = [heuristic_at(heuristic, (0, col), (0, 0)) for col in range(3)]
    assert values == [
        0,
        1,
        7,
    ]  # the step from the last to the middle cell costs 1, the value falls by 6
    np.testing.assert_array_equal(costs_to_goal(problem)[0], [0, 1, 2])


def test_reopening_mends_part_of_what_an_inconsistent_heuristic_breaks():
    costs = []
    for seed in range(60):
        problem = random_problem(seed, kind="cell", diagonal="both-free", connectivity=8)
        options = ({"heuristic": "plus-printed"}, {"heuristic": "plus-printed", "reopen": True}, {})
        costs.append([astar(problem, **each).cost for each in options])
    closed, reopened, exact = np.sum(costs, axis=0, where=np.isfinite(costs))
    assert closed > reopened > exact
