"""plan: places to cells, costs that anyone can recompute from the maps, any altitude, maps weighed once for many."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import jaxurban as ju
from jaxurban import progress
from jaxurban.draw.metrics import obstacle_layer
from jaxurban.planners.base import EVERY_PATH, Status
from jaxurban.planners.corners import corner_bound
from jaxurban.typing import CostMap
from tests.volumes import WEIGHTS

NOTHING = ju.Weights(**dict.fromkeys(WEIGHTS.to_dict(), 0.0))
VOLUME = ju.Levels(climb_cost=0.3, descent_cost=0.1)
LOW_M, Z_M, HIGH_M = 20.0, 35.0, 60.0


@pytest.fixture(scope="module")
def planned(town, town_ends):
    """Plan between the two places of the town at 20 m, or as is given."""
    return lambda **given: ju.plan(town, **({"altitude_m": 20.0} | town_ends | given))


@pytest.mark.parametrize("altitude_m", [20.0, VOLUME])
def test_cell_cost_is_the_sum_over_the_nodes_entered(town, town_ends, planned, altitude_m):
    goal = {"goal": ju.XY(*town_ends["goal"][:2], 600.0)} if altitude_m is VOLUME else {}
    path = planned(
        altitude_m=altitude_m, **goal, weights=WEIGHTS, cost_model="cell", time_of_day="night"
    )
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
        np.testing.assert_allclose(path.xy_m[[0, -1]], [xy_m[:2] for xy_m in town_ends.values()])
        np.testing.assert_allclose(
            np.stack(town.grid.xy_of_lonlat(*path.lonlat.T), axis=-1), path.xy_m, atol=1e-3
        )


def test_the_straight_line_is_the_shortest_and_astar_the_cheapest(town_ends, planned):
    line = {"altitude_m": 600.0, "cost_model": "line"}
    straight, cheapest = (planned(**line, planner=planner) for planner in ("ptp", "astar-plus"))
    shortest = planned(**line, planner="astar-dist", objective="distance")
    assert straight.length_m == pytest.approx(
        np.hypot(*np.subtract(*(xy_m[:2] for xy_m in town_ends.values())))
    )
    assert straight.length_m <= shortest.length_m <= 1.0824 * straight.length_m
    assert shortest.length_m <= cheapest.length_m + 1e-9
    assert cheapest.cost <= shortest.cost + 1e-9
    assert shortest.search.cost == pytest.approx(shortest.length_m)


def test_start_equal_to_goal_costs_nothing(town_ends, planned):
    for altitude_m in (20.0, VOLUME):
        path = planned(goal=town_ends["start"], altitude_m=altitude_m)
        assert (path.cost, path.length_m, len(path.xy_m), len(path.z_m)) == (0.0, 0.0, 1, 1)


@pytest.mark.parametrize("altitude_m", [20.0, ju.Levels()])
def test_with_all_weights_zero_the_shortest_path_is_given_and_said_so(planned, altitude_m):
    with pytest.warns(UserWarning, match="All weights are zero.*Give one a weight above 0"):
        path = planned(altitude_m=altitude_m, weights=NOTHING)
    assert path.cost == 0.0
    assert path.length_m == pytest.approx(
        planned(altitude_m=altitude_m, objective="distance").length_m
    )
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
    assert (
        "the cheapest one on the 8-neighbour grid; one off it, at any angle, may be cheaper"
        in facts["message"]
    )
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


def test_routes_at_any_angle_of_one_query_have_one_bound(town, town_ends):
    on = ju.cost_map(town, 20.0)
    planned = [on.plan(**town_ends, planner="theta-star"), on.plan(**town_ends, refine=True)]
    cells = [end.cell for end in on.free_space.ends(*(ju.XY(*xy_m) for xy_m in town_ends.values()))]
    assert {path.search.lower_bound for path in planned} == {
        corner_bound(on.problem.between(*cells))
    }


def test_refinement_has_its_share_of_a_sampling_planners_budget(planned):
    path = planned(cost_model="line", planner="bitstar-dist", budget_s=0.3, refine=True)
    assert "refine" in path.search.note.lower()


def test_metrics_run_linearly_between_two_maps_and_obstacles_are_the_roofs(maps):
    on = ju.cost_map(maps, Z_M, time_of_day="night")
    share = (Z_M - LOW_M) / (HIGH_M - LOW_M)
    assert np.array_equal(on.is_free, maps.m("roof_touched") < Z_M)
    for rule, name in (("centre", "roof"), ("touched", "roof_touched")):
        for z_m in (Z_M, HIGH_M):
            assert np.array_equal(maps.is_free(z_m, rule), maps.m(name) < z_m)
    over_roof = maps.m("obstacle", LOW_M) == 1
    for name, layer in zip(on.names, on.costs, strict=True):
        low, high = (maps.m(name, z_m, time_of_day="night") for z_m in (LOW_M, HIGH_M))
        by_hand = 1 - np.where(over_roof, high, (1 - share) * low + share * high)
        by_hand = maps.m(name, time_of_day="night") if name == "population" else by_hand
        np.testing.assert_allclose(layer[on.is_free], by_hand[on.is_free], atol=1e-6)
    volume = ju.cost_map(maps, ju.Levels(Z_M, Z_M, 10.0), time_of_day="night")  # of one level
    assert np.array_equal(on.costs, volume.costs[:, 0])
    assert np.array_equal(on.is_free, volume.is_free[0])
    drawn = obstacle_layer(maps, Z_M).values
    assert np.array_equal(drawn == 0, maps.m("roof") >= Z_M)  # -1: not drawn


@pytest.mark.parametrize("z_m", [LOW_M, HIGH_M])
def test_an_altitude_of_the_maps_takes_their_bits(maps, z_m):
    on = ju.cost_map(maps, z_m)
    assert np.array_equal(on.is_free, maps.is_free(z_m))
    assert np.array_equal(on.costs, [*maps.costs(z_m).values()])


@pytest.mark.parametrize("planner", ["astar-plus", "theta-star", "bitstar-plus"])
def test_a_path_flies_there_and_says_what_its_metrics_are(maps, ends, planner, tmp_path):
    path = ju.plan(maps, **ends, altitude_m=Z_M, planner=planner, cost_model="line", budget_s=0.3)
    assert path.status.has_path
    assert set(path.z_m) == {Z_M}
    assert (
        "Metrics at 35 m are interpolated between the maps of 20 and 60 m."
        in path.to_dict()["message"]
    )
    assert path.settings["metrics_between_m"] == [LOW_M, HIGH_M]
    report = ju.explain(path, maps)
    assert report.totals["cost"] == pytest.approx(path.cost, rel=1e-9)
    assert report.totals["mean_gps"] == pytest.approx(path.metrics["gps"], rel=1e-9)
    (again,) = ju.fit.demonstrations(path.save(tmp_path / "route.geojson"), maps)
    assert again.query.cost_map.altitude_m == Z_M
    held = ju.plan(maps, **ends, altitude_m=HIGH_M)
    assert "metrics_between_m" not in held.settings
    assert "interpolated" not in held.to_dict()["message"]


@pytest.fixture(scope="module")
def shortest(town) -> CostMap:
    """Many routes are as short as the shortest."""
    return ju.cost_map(town, 20.0, objective="distance")


@pytest.fixture(scope="module")
def pairs(shortest) -> list:
    free = np.random.default_rng(2).choice(np.argwhere(shortest.is_free), (4, 2))
    return [[ju.XY(*shortest.grid.xy_of_cell(*cell)) for cell in pair] for pair in free]


def test_maps_weighed_once_give_the_paths_of_separate_plans(town, pairs):
    how = {"altitude_m": 20.0, "weights": ju.Weights(gps=3.0), "cost_model": "line"}
    weighted = ju.cost_map(town, **how)
    for pair in pairs:
        once, anew = weighted.plan(*pair), ju.plan(town, *pair, **how)
        assert (once.cost, once.metrics, once.settings) == (anew.cost, anew.metrics, anew.settings)
    assert weighted.problem is weighted.problem


def test_the_metrics_of_a_path_are_the_means_over_the_length_in_each_cell(planned):
    path = planned(cost_model=ju.CostModel("line", 1.0), weights=ju.Weights(0))
    for name, mean in path.metrics.items():
        mean_cost = mean if name == "population" else 1 - mean
        assert path.cost_by_layer[name] == pytest.approx(mean_cost * path.length_m, rel=1e-6)


def test_rounding_takes_no_mean_out_of_0_to_1(town):
    rounded = SimpleNamespace(mean_costs=np.full(4, np.nextafter(1.0, 2.0)))
    means = ju.cost_map(town, 600.0).means(rounded)
    assert means == {"gps": 0.0, "lidar": 0.0, "population": 1.0, "risk": 0.0}


def test_equal_plans_are_one_route(town, shortest, pairs):
    for start, goal in pairs:
        alone = ju.plan(town, start, goal, altitude_m=20.0, objective="distance")
        for _ in range(30):
            path = shortest.plan(start, goal)
            assert path.search.heuristic == alone.search.heuristic == "tiles"
            np.testing.assert_array_equal(path.xy_m, alone.xy_m)


def test_landmarks_find_the_same_cost_and_leave_other_searches_as_they_were(shortest, pairs):
    before = [shortest.plan(*pair) for pair in pairs]
    for pair, path in zip(pairs, before, strict=True):
        guided, after = shortest.plan(*pair, heuristic="landmarks"), shortest.plan(*pair)
        assert (guided.search.heuristic, after.search.heuristic) == ("landmarks", "tiles")
        assert guided.search.cost == pytest.approx(path.search.cost, rel=1e-9)
        np.testing.assert_array_equal(after.xy_m, path.xy_m)


def test_a_search_that_lasts_says_so_and_for_how_long(town, shortest, pairs, monkeypatch, caplog):
    monkeypatch.setattr(progress, "SILENT_S", 0.01)
    ju.cost_map(town, 20.0).plan(*pairs[1], planner="bitstar-dist", budget_s=0.5)
    assert (
        "bitstar-dist is still running: its search may take up to 0.5 s (budget_s)" in caplog.text
    )
    caplog.clear()
    monkeypatch.setattr(progress, "SILENT_S", 5.0)
    shortest.plan(*pairs[0])
    assert not caplog.records
