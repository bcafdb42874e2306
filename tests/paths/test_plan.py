"""plan: places to cells, and costs that anyone can recompute from the maps, at an altitude and between levels."""

import json

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.planners.base import EVERY_PATH, Status

WEIGHTS = ju.Weights(distance=0.2, gps=0.5, lidar=2.0, population=3.0, risk=1.5)
NOTHING = ju.Weights(**dict.fromkeys(WEIGHTS.to_dict(), 0.0))
VOLUME = ju.Levels(climb_cost=0.3, descent_cost=0.1)


@pytest.fixture(scope="module")
def planned(town, town_ends):
    """Plan between the two places of the town at 20 m, or as is given."""
    return lambda **given: ju.plan(town, **({"altitude_m": 20.0} | town_ends | given))


@pytest.mark.parametrize("altitude_m", [20.0, VOLUME])
def test_cell_cost_is_the_sum_over_the_nodes_entered(town, town_ends, planned, altitude_m):
    goal = {"goal_xy_m": (*town_ends["goal_xy_m"], 600.0)} if altitude_m is VOLUME else {}
    path = planned(altitude_m=altitude_m, **goal, weights=WEIGHTS, cost_model="cell", time_of_day="night")
    cells = np.transpose(town.grid.cell_of_xy(*path.xy_m.T))
    rise_m = np.diff(path.z_m)
    length_m = np.linalg.norm(np.diff(np.column_stack([path.xy_m, path.z_m]), axis=0), axis=1).sum()
    by_hand = 0.2 * length_m + 0.3 * rise_m[rise_m > 0].sum() - 0.1 * rise_m[rise_m < 0].sum()
    for z_m, cell in zip(path.z_m[1:], cells[1:], strict=True):
        for name, cost in town.costs(z_m, time_of_day="night").items():
            by_hand += WEIGHTS[name] * float(cost[tuple(cell)])
    assert path.status is Status.OPTIMAL
    assert path.cost == pytest.approx(by_hand, rel=1e-9)
    assert path.search.cost == pytest.approx(by_hand, rel=1e-9)
    assert sum(path.cost_by_layer.values()) == pytest.approx(path.cost)
    assert path.length_m == pytest.approx(length_m)
    assert (path.z_m[0], path.z_m[-1], path.altitude_m) == (20.0, 600.0 if goal else 20.0, 20.0)
    assert all(town.is_free(z_m)[tuple(cell)] for z_m, cell in zip(path.z_m, cells, strict=True))


def test_every_planner_starts_and_ends_at_cell_centres(town, town_ends, planned):
    for planner in ("ptp", "astar-dist", "astar-plus"):
        path = planned(altitude_m=600.0, planner=planner)
        np.testing.assert_allclose(path.xy_m[[0, -1]], [*town_ends.values()])
        np.testing.assert_allclose(np.stack(town.grid.xy_of_lonlat(*path.lonlat.T), axis=-1), path.xy_m, atol=1e-3)


def test_the_straight_line_is_the_shortest_and_astar_the_cheapest(town_ends, planned):
    line = {"altitude_m": 600.0, "cost_model": "line"}
    straight, cheapest = (planned(**line, planner=planner) for planner in ("ptp", "astar-plus"))
    shortest = planned(**line, planner="astar-dist", objective="distance")
    assert straight.length_m == pytest.approx(np.hypot(*np.subtract(*town_ends.values())))
    assert straight.length_m <= shortest.length_m <= 1.0824 * straight.length_m
    assert shortest.length_m <= cheapest.length_m + 1e-9
    assert cheapest.cost <= shortest.cost + 1e-9
    assert shortest.search.cost == pytest.approx(shortest.length_m)


def test_start_equal_to_goal_costs_nothing(town_ends, planned):
    for altitude_m in (20.0, VOLUME):
        path = planned(goal_xy_m=town_ends["start_xy_m"], altitude_m=altitude_m)
        assert (path.cost, path.length_m, len(path.xy_m), len(path.z_m)) == (0.0, 0.0, 1, 1)


@pytest.mark.parametrize("altitude_m", [20.0, ju.Levels()])
def test_with_all_weights_zero_the_shortest_path_is_given_and_said_so(planned, altitude_m):
    path = planned(altitude_m=altitude_m, weights=NOTHING)
    assert path.cost == 0.0
    assert path.length_m == pytest.approx(planned(altitude_m=altitude_m, objective="distance").length_m)
    assert path.search.cost == pytest.approx(path.length_m)
    assert "All weights are zero" in path.to_dict()["message"]


def test_a_weight_without_a_layer_or_a_free_distance_is_told(town, town_ends, planned):
    empty = ju.MetricMaps(town.ds.drop_vars(["population", "density"]))
    assert "hold no population" in ju.plan(empty, **town_ends, altitude_m=20.0).to_dict()["message"]
    assert "distance weighs nothing" in planned(weights={"distance": 0.0}).to_dict()["message"]


def test_facts_are_json_ready_and_an_unbounded_budget_is_written_as_none(planned):
    path = planned(budget_s=float("inf"))
    facts = path.to_dict()
    assert json.loads(json.dumps(facts)) == facts
    assert (facts["status"], facts["graph"]) == ("optimal", "8-neighbour grid")
    assert "the cheapest one on the 8-neighbour grid; one off it, at any angle, may be cheaper" in facts["message"]
    assert facts["settings"]["weights"]["distance"] == 0.1
    assert facts["settings"]["budget_s"] is None
    assert set(path.metrics) == {"gps", "lidar", "population", "risk"}
    assert all(0.0 <= value <= 1.0 for value in path.metrics.values())


def test_a_refined_path_leaves_the_grid_and_is_never_costlier(planned):
    drawn, refined = (planned(cost_model="line", refine=refine) for refine in (False, True))
    assert refined.cost < drawn.cost
    assert refined.status is Status.FEASIBLE
    assert (drawn.search.graph, refined.search.graph) == ("8-neighbour grid", EVERY_PATH)
    assert "refine" in refined.to_dict()["message"].lower()


def test_refinement_has_its_share_of_a_sampling_planners_budget(planned):
    path = planned(cost_model="line", planner="bitstar-dist", budget_s=0.3, refine=True)
    assert "refine" in path.search.note.lower()
