"""No path enters what hangs, nor flies under it: floors are not known well enough."""

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.maps.build import compute_maps
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.lidar import Lidar
from jaxurban.paths.clearance import closed_by_clearance
from jaxurban.settings import TO_GROUND
from jaxurban.typing import PlannedPath
from jaxurban.world.grid import Grid
from tests.hanging_city import CRS, DECK, DECK_TOP_M, HANGING, STANDING, X_M, Y_M, city
from tests.tiled_runs import sky
from tests.volumes import plan_volume

REGION = Grid(CRS, 10.0, int(Y_M // 10) + 2, int(X_M // 10) + 2, 54, 56)
ALTITUDES_M = (5.0, 13.0, 20.0)
UNDER = (X_M + 300.0, Y_M + 205.0)  # the deck; the ends are south and north of it
ENDS = {"start": ju.XY(X_M + 300.0, Y_M + 165.0), "goal": ju.XY(X_M + 300.0, Y_M + 245.0)}
RULES = ("touched", "centre")


def made(hanging: str) -> ju.MetricMaps:
    params = MapParams(
        altitudes_m=ALTITUDES_M, sections={"lidar": Lidar(azimuths=12, range_m=40.0)}
    )
    return compute_maps(MapTask(city(hanging), REGION, sky(), params))


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return made("slabs")


def in_buildings(path: PlannedPath, rule: str) -> bool:
    """Whether a path is in a prism anywhere: a true one or, under the rule of centres, one less its outermost cells."""
    within_m = 0.0 if rule == "touched" else REGION.resolution_m / 2**0.5
    number = np.arange(len(path.xy_m))
    along = np.linspace(0, len(number) - 1, 40 * len(number))
    x, y, z = (np.interp(along, number, values) for values in (*path.xy_m.T, path.z_m))
    points = shapely.points(x, y)
    return any(
        np.any(
            shapely.contains_properly(polygon.buffer(-within_m), points)
            & (z > floor_m)
            & (z < top_m)
        )
        for polygon, floor_m, top_m in (*STANDING, *HANGING)
    )


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
def test_where_planners_may_fly_is_where_they_may_if_everything_reaches_the_ground(maps, rule):
    slabs, grounded = (held.with_obstacles(rule) for held in (maps, made(TO_GROUND)))
    for z_m in (5.0, 9.0, 12.5, 13.0, 14.0, 20.0):
        np.testing.assert_array_equal(slabs.is_free(z_m), grounded.is_free(z_m))
        for clearance_m in ((0.0, 0.0), (15.0, 3.0)):
            limits = ju.Constraints((), (), *clearance_m)
            closed = (closed_by_clearance(held, z_m, limits) for held in (slabs, grounded))
            np.testing.assert_array_equal(*closed)


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("planner", ["astar-dist", "astar-plus", "theta-star", "bitstar-plus"])
@pytest.mark.parametrize("altitude_m", [5.0, 13.0])
def test_no_path_at_an_altitude_goes_through_or_under_a_deck(maps, rule, planner, altitude_m):
    how = {"altitude_m": altitude_m, "planner": planner, "cost_model": "line", "budget_s": 0.3}
    path = ju.plan(maps.with_obstacles(rule), **ENDS, **how)
    assert path.length_m > 400  # around the deck, which is 80 m to cross
    assert not in_buildings(path, rule)
    row, col = maps.grid.cell_of_xy(*path.xy_m.T)
    assert np.all(maps.m("roof")[row, col] < altitude_m)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("step_m", [None, 1.0, 4.0])
def test_a_path_that_climbs_goes_over_the_deck_and_not_through_it(maps, rule, step_m):
    heights = {
        "start_altitude_m": 5.0,
        "goal_altitude_m": 5.0,
        "level_step_m": step_m,
        "climb_cost": 0.01,
    }
    path = plan_volume(maps.with_obstacles(rule), **ENDS, **heights)
    assert not in_buildings(path, rule)
    over = np.array([shapely.contains_properly(DECK, shapely.Point(x, y)) for x, y in path.xy_m])
    assert over.any()
    assert path.z_m[over].min() > DECK_TOP_M


def test_nobody_climbs_from_under_a_deck(maps):
    under = maps.grid.cell_of_xy(*UNDER)
    assert [maps.m("obstacle", z_m)[under] for z_m in (5.0, 13.0)] == [0, 1]
    climb = {
        "start": ju.XY(*UNDER),
        "goal": ENDS["goal"],
        "start_altitude_m": 5.0,
        "goal_altitude_m": 20.0,
    }
    with pytest.raises(ju.InputError, match="obstacle"):
        plan_volume(maps.with_obstacles("centre"), **climb)


def test_between_two_altitudes_values_over_a_deck_are_those_above_it(maps):
    over, on = maps.grid.cell_of_xy(*UNDER), ju.cost_map(maps, 15.0)
    lidar = dict(zip(on.names, on.costs, strict=True))["lidar"]
    assert lidar[over] == pytest.approx(1 - maps.m("lidar", 20.0)[over])
