"""Landmarks and exact costs to go: against SciPy's Dijkstra, and when they are built."""

import itertools

import numpy as np
import pytest

from jaxurban.planners.astar import (
    astar,
    astar_dist,
    astar_plus,
    heuristic_at,
    landmark_cells,
    make_heuristic,
    make_landmarks,
)
from jaxurban.planners.base import Problem, Status
from jaxurban.planners.cost import CostModel
from tests.planners.test_astar import exact_cost_to_go, random_problem


def city(seed=0, shape=(60, 70), **options):
    """Scattered obstacles and random costs, between two corners."""
    rng = np.random.default_rng(seed)
    is_free = rng.random(shape) < 0.85
    is_free[0, 0] = is_free[-1, -1] = True
    is_free[:2, :2] = is_free[-2:, -2:] = True
    return Problem(rng.random((1, *shape)), is_free, (0, 0), (shape[0] - 1, shape[1] - 1), 5.0, 0.1, **options)


@pytest.mark.parametrize(("cost_model", "connectivity"), list(itertools.product(["cell", "line"], [8, 4])))
def test_one_field_gives_the_cost_between_a_landmark_and_a_cell_both_ways(cost_model, connectivity):
    problem = city(cost_model=CostModel(cost_model, connectivity=connectivity))
    made = make_landmarks(problem, 3)
    for k, cell in enumerate(landmark_cells(problem, 3)):
        to_landmark = exact_cost_to_go(problem.between(problem.start, cell))
        half = 0.5 * (problem.cost[cell] - problem.cost) if cost_model == "cell" else 0.0
        is_known = np.isfinite(to_landmark)
        np.testing.assert_array_equal(np.isfinite(made.costs[..., k]), is_known)
        np.testing.assert_allclose((made.costs[..., k] + half)[is_known], to_landmark[is_known], rtol=1e-12, atol=1e-12)
        # From the landmark to the start.
        back = exact_cost_to_go(problem.between(cell, problem.start))[cell]
        half = 0.5 * (problem.cost[0, 0] - problem.cost[cell]) if cost_model == "cell" else 0.0
        assert made.costs[0, 0, k] + half == pytest.approx(back)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_the_landmarks_bound_stays_below_the_true_cost_to_the_last_bit(cost_model):
    for seed in range(5):
        problem = city(seed, cost_model=cost_model)
        landmark = landmark_cells(problem, 8)[0]
        for goal in (problem.goal, landmark):  # at a landmark the bound is the cost itself, less the slack
            query = problem.between(problem.start, goal)
            bound, cost_to_go = make_heuristic("landmarks", query), exact_cost_to_go(query)
            cells = np.argwhere(problem.is_free & np.isfinite(cost_to_go))
            values = np.array([heuristic_at(bound, tuple(cell), goal) for cell in cells])
            assert np.all(values <= cost_to_go[tuple(cells.T)])
        np.testing.assert_allclose(values, cost_to_go[tuple(cells.T)], rtol=1e-9, atol=1e-9)


def test_costs_to_go_lead_straight_to_the_goal_and_are_kept_for_the_next_query_to_it():
    problem = city()
    first = astar(problem, heuristic="exact")
    assert first.cost == pytest.approx(exact_cost_to_go(problem)[problem.start], rel=1e-12)
    assert first.num_expanded < 2 * len(first.points_m)
    field = make_heuristic("exact", problem).field
    np.testing.assert_allclose(field[problem.is_free], exact_cost_to_go(problem)[problem.is_free], rtol=1e-12)
    astar(problem.between((1, 1), problem.goal), heuristic="exact")
    assert make_heuristic("exact", problem).field is field
    assert make_heuristic("exact", problem.between(problem.goal, (1, 1))).field[1, 1] == 0


def test_landmarks_lie_far_apart_in_the_largest_part_of_the_map():
    is_free = np.ones((40, 60), bool)
    is_free[:, 40] = False  # a part of 19 columns is cut off
    problem = Problem(np.ones((1, 40, 60)), is_free, (0, 0), (39, 39), 1.0, 1.0)
    cells = landmark_cells(problem, 4)
    assert sorted(cells) == [(0, 0), (0, 39), (39, 0), (39, 39)]
    assert len(landmark_cells(Problem(np.ones((1, 1, 2)), np.ones((1, 2), bool), (0, 0), (0, 1), 1.0, 1.0), 8)) == 2


def test_parts_that_landmarks_do_not_reach_are_searched_as_before():
    is_free = np.ones((40, 60), bool)
    is_free[:, 40] = False
    problem = Problem(np.ones((1, 40, 60)), is_free, (0, 45), (39, 59), 1.0, 1.0)
    inside = astar(problem, heuristic="landmarks")
    plain = astar(problem)
    assert (inside.cost, inside.num_expanded) == (plain.cost, plain.num_expanded)
    for start, goal in [((0, 0), (0, 59)), ((0, 59), (0, 0))]:
        across = astar(problem.between(start, goal), heuristic="landmarks")
        assert (across.status, across.num_expanded, across.lower_bound) == (Status.NO_PATH, 0, np.inf)


def test_landmarks_save_three_quarters_of_the_expansions_on_a_map_of_uneven_cost():
    problem = city(shape=(150, 170))
    rng = np.random.default_rng(1)
    free = np.argwhere(np.isfinite(exact_cost_to_go(problem)) & problem.is_free)
    shares = []
    for start, goal in rng.choice(free, (20, 2)):
        query = problem.between(tuple(map(int, start)), tuple(map(int, goal)))
        octile, guided = (astar(query, heuristic=name) for name in ("octile", "landmarks"))
        assert guided.cost == pytest.approx(octile.cost, rel=1e-12)
        shares.append(guided.num_expanded / octile.num_expanded)
    assert np.mean(shares) < 0.25


def test_auto_takes_tiles_however_often_it_is_asked_and_whatever_was_made():
    problem = city()
    first = astar_plus(problem)
    for k in range(30):
        path = astar_plus(problem)
        assert path.heuristic == "tiles"
        np.testing.assert_array_equal(path.points_m, first.points_m)
        if k == 20:
            assert astar(problem, heuristic="landmarks").heuristic == "landmarks"
    assert astar_dist(problem, heuristic="auto").heuristic == "tiles"
    assert astar_dist(problem).heuristic == "euclidean"


def test_landmarks_are_made_once_for_all_queries_on_a_map():
    problem = city()
    made = make_landmarks(problem, 2)
    assert make_landmarks(problem.between((1, 1), (0, 0))) is made


@pytest.mark.parametrize("name", ["landmarks", "exact"])
def test_a_budget_that_ends_while_tables_are_built_is_reported_as_spent(monkeypatch, name):
    monkeypatch.setattr("jaxurban.planners.grid_search.CHUNK", 10)
    problem = city()
    path = astar(problem, heuristic=name, budget_s=1e-6)
    assert path.status is Status.BUDGET_EMPTY
    assert path.num_expanded == 0
    assert "were not done in" in path.note
    assert 0 < path.lower_bound <= astar(problem).cost
    assert astar(problem, heuristic=name).status is Status.OPTIMAL


def test_random_maps_of_every_kind_keep_their_optimum():
    for seed in range(12):
        variant = (["cell", "line"][seed % 2], ["both-free", "always"][seed // 2 % 2], [8, 4][seed // 4 % 2])
        problem = random_problem(seed, *variant, shape=(25, 30))
        optimum = exact_cost_to_go(problem)[problem.start]
        for name in ("landmarks", "exact"):
            assert astar(problem, heuristic=name).cost == pytest.approx(optimum, rel=1e-12)
