"""plan: places to cells, and costs that anyone can recompute from the maps."""

import numpy as np
import pytest
from scipy.ndimage import label

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.paths.export.write import write_path
from jaxurban.planners.base import EVERY_PATH, Status
from jaxurban.planners.registry import PLANNERS
from tests.free_space import Obstacles


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return ju.build_maps(ju.demo_city(1_000, 1_000), resolution_m=10.0, altitudes_m=(20.0, 600.0))


def centre(maps: ju.MetricMaps, row: int, col: int) -> tuple[float, float]:
    return float(maps.grid.x_m[col]), float(maps.grid.y_m[row])


@pytest.fixture(scope="module")
def ends(maps) -> dict:
    free = np.argwhere(maps.is_free(20.0))
    return {"start_xy_m": centre(maps, *free[10]), "goal_xy_m": centre(maps, *free[-10])}


def test_cell_cost_is_the_sum_over_the_cells_entered(maps, ends):
    weights = ju.Weights(distance=0.2, gps=0.5, lidar=2.0, population=3.0, risk=1.5)
    path = ju.plan(maps, **ends, altitude_m=20.0, weights=weights, cost_model="cell", time_of_day="night")
    rows, cols = maps.grid.cell_of_xy(path.xy_m[:, 0], path.xy_m[:, 1])
    costs = maps.costs(20.0, time_of_day="night")
    length_m = np.hypot(*np.diff(path.xy_m, axis=0).T).sum()
    by_hand = 0.2 * length_m + sum(
        weights[name] * cost[rows[1:], cols[1:]].sum(dtype=float) for name, cost in costs.items()
    )
    assert path.status is Status.OPTIMAL
    assert path.cost == pytest.approx(by_hand, rel=1e-9)
    assert path.search.cost == pytest.approx(by_hand, rel=1e-9)
    assert sum(path.cost_by_layer.values()) == pytest.approx(path.cost)
    assert path.length_m == pytest.approx(length_m)
    assert maps.is_free(20.0)[rows, cols].all()


def test_every_planner_starts_and_ends_at_cell_centres(maps, ends):
    for planner in ("ptp", "astar-dist", "astar-plus"):
        path = ju.plan(maps, **ends, altitude_m=600.0, planner=planner)
        np.testing.assert_allclose(path.xy_m[[0, -1]], [ends["start_xy_m"], ends["goal_xy_m"]])
        np.testing.assert_allclose(np.stack(maps.grid.xy_of_lonlat(*path.lonlat.T), axis=-1), path.xy_m, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "meant"), [("astar", "astar-plus"), ("bitstar", "bitstar-plus"), ("theta", "theta-star")]
)
def test_a_planner_that_begins_as_the_name_asked_for_is_suggested_first(maps, ends, name, meant):
    with pytest.raises(InputError, match=f"unknown planner '{name}' .did you mean '{meant}'"):
        ju.plan(maps, **ends, altitude_m=600.0, planner=name)


def test_the_straight_line_is_the_shortest_and_astar_the_cheapest(maps, ends):
    straight = ju.plan(maps, **ends, altitude_m=600.0, planner="ptp", cost_model="line")
    cheapest = ju.plan(maps, **ends, altitude_m=600.0, planner="astar-plus", cost_model="line")
    shortest = ju.plan(maps, **ends, altitude_m=600.0, planner="astar-dist", cost_model="line", objective="distance")
    assert straight.length_m == pytest.approx(np.hypot(*np.subtract(ends["goal_xy_m"], ends["start_xy_m"])))
    assert straight.length_m <= shortest.length_m <= 1.0824 * straight.length_m
    assert shortest.length_m <= cheapest.length_m + 1e-9
    assert cheapest.cost <= shortest.cost + 1e-9
    assert shortest.search.cost == pytest.approx(shortest.length_m)


def test_means_along_a_path_lie_between_the_maps_extremes(maps, ends):
    path = ju.plan(maps, **ends, altitude_m=20.0)
    assert set(path.metrics) == {"gps", "lidar", "population", "risk"}
    assert all(0.0 <= value <= 1.0 for value in path.metrics.values())


def test_start_equal_to_goal_costs_nothing(maps, ends):
    path = ju.plan(maps, start_xy_m=ends["start_xy_m"], goal_xy_m=ends["start_xy_m"], altitude_m=20.0)
    assert (path.cost, path.length_m, len(path.xy_m)) == (0.0, 0.0, 1)


def test_a_place_inside_an_obstacle_is_refused_or_snapped(maps, ends):
    row, col = np.argwhere(~maps.is_free(20.0))[0]
    inside = centre(maps, row, col)
    with pytest.raises(InputError, match="nearest free cell"):
        ju.plan(maps, start_xy_m=inside, goal_xy_m=ends["goal_xy_m"], altitude_m=20.0)
    path = ju.plan(maps, start_xy_m=inside, goal_xy_m=ends["goal_xy_m"], altitude_m=20.0, snap=True)
    free = np.argwhere(maps.is_free(20.0))
    nearest_m = 10.0 * np.sqrt(((free - [row, col]) ** 2).sum(axis=1).min())
    assert path.snap_distance_m[0] == pytest.approx(nearest_m)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"planner": "astar-pluss"}, "did you mean 'astar-plus'"),
        ({"objective": "fast"}, "'weighted', 'distance' or None"),
        ({"cost_model": "cells"}, "CostModel, 'cell', 'line' or None"),
        ({"altitude_m": 10.0}, "from 20 to 600 m"),
        ({"start": (-73.97, 40.78)}, "not both"),
        ({"weights": {"gps": float("nan")}}, "gps must be a finite number"),
    ],
)
def test_wrong_arguments_are_named(maps, ends, changed, words):
    with pytest.raises(InputError, match=words):
        ju.plan(maps, **({"altitude_m": 20.0} | ends | changed))


def test_with_all_weights_zero_the_shortest_path_is_given_and_said_so(maps, ends):
    nothing = ju.Weights(distance=0.0, gps=0.0, lidar=0.0, population=0.0, risk=0.0)
    path = ju.plan(maps, **ends, altitude_m=20.0, weights=nothing)
    shortest = ju.plan(maps, **ends, altitude_m=20.0, objective="distance")
    assert path.cost == 0.0
    assert path.length_m == pytest.approx(shortest.length_m)
    assert "All weights are zero" in path.to_dict()["message"]


def test_a_weight_without_a_layer_is_ignored_with_a_message(maps, ends):
    empty = ju.MetricMaps(maps.ds.drop_vars(["population", "density"]))
    path = ju.plan(empty, **ends, altitude_m=20.0)
    assert "hold no population" in path.to_dict()["message"]


def test_facts_are_json_ready(maps, ends):
    import json

    facts = ju.plan(maps, **ends, altitude_m=20.0).to_dict()
    assert json.loads(json.dumps(facts)) == facts
    assert facts["status"] == "optimal"
    assert facts["graph"] == "8-neighbour grid"
    assert "the cheapest one on the 8-neighbour grid; one off it, at any angle, may be cheaper" in facts["message"]
    assert facts["settings"]["weights"]["distance"] == 0.1


def test_a_refined_path_leaves_the_grid_and_is_never_costlier(maps, ends):
    drawn = ju.plan(maps, altitude_m=20.0, cost_model="line", **ends)
    refined = ju.plan(maps, altitude_m=20.0, cost_model="line", refine=True, **ends)
    assert refined.cost < drawn.cost
    assert refined.status is Status.FEASIBLE
    assert (drawn.search.graph, refined.search.graph) == ("8-neighbour grid", EVERY_PATH)
    assert "refine" in refined.to_dict()["message"].lower()
    with pytest.raises(ju.InputError, match="cost_model='line'"):
        ju.plan(maps, altitude_m=20.0, cost_model="cell", refine=True, **ends)


@pytest.mark.parametrize("name", PLANNERS)
def test_plans_over_the_synthetic_city_keep_to_free_cells_by_shapely(maps, name):
    is_free, grid = maps.is_free(20.0), maps.grid
    obstacles = Obstacles(is_free, grid.resolution_m, grid.x_min_m, grid.y_min_m)
    islands = label(is_free)[0]
    joined = np.argwhere(islands == np.bincount(islands[is_free]).argmax())
    for start, goal in np.random.default_rng(7).choice(joined, (3, 2)):
        ends = {"start_xy_m": grid.xy_of_cell(*start), "goal_xy_m": grid.xy_of_cell(*goal)}
        path = ju.plan(maps, **ends, altitude_m=20.0, planner=name, cost_model="line", budget_s=0.3)
        assert path.status.has_path or path.status in (Status.BLOCKED, Status.BUDGET_EMPTY)
        if path.status.has_path:
            assert obstacles.crossed_m(path.xy_m) < 1e-6
            assert sum(path.cost_by_layer.values()) == pytest.approx(path.cost)


@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize("wrong", [np.nan, -1.0])
def test_a_plan_refuses_weights_that_are_no_weights(maps, name, wrong):
    place = maps.grid.xy_of_cell(*np.argwhere(maps.is_free(20.0))[0])
    with pytest.raises(InputError, match="weight risk must be a finite number >= 0"):
        ju.plan(maps, start_xy_m=place, goal_xy_m=place, altitude_m=20.0, planner=name, weights=ju.Weights(risk=wrong))


def test_an_unbounded_budget_is_written_as_none(maps, ends, tmp_path):
    planned = ju.plan(maps, altitude_m=20.0, budget_s=float("inf"), **ends)
    assert write_path(planned, tmp_path / "path.geojson")
    assert planned.to_dict()["settings"]["budget_s"] is None


def test_refinement_has_its_share_of_a_sampling_planners_budget(maps, ends):
    planned = ju.plan(
        maps, altitude_m=20.0, cost_model="line", planner="bitstar-dist", budget_s=1.0, refine=True, **ends
    )
    assert "refine" in planned.search.note.lower()


@pytest.mark.parametrize("seed", [-1, 1.5])
def test_a_seed_that_is_no_whole_number_is_refused(maps, ends, seed):
    with pytest.raises(ju.InputError, match="seed must be a whole number"):
        ju.plan(maps, altitude_m=20.0, planner="bitstar-dist", seed=seed, **ends)


def test_a_free_distance_is_told(maps, ends):
    planned = ju.plan(maps, altitude_m=20.0, weights=ju.Weights(distance=0.0), **ends)
    assert "distance weighs nothing" in planned.to_dict()["message"]
