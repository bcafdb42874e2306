"""The GPS floor in whole maps: what the maps below and above it say, a series, roofs, and where it is refused."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import xarray as xr

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps_floor import METRIC, GpsFloor
from tests import hanging_city
from tests.tiled_runs import city as tiled_city
from tests.tiled_runs import task as tiled_task

TIMES = [f"2020-04-27T{hour:02d}:30:00Z" for hour in (0, 6, 12)]


FLOOR = GpsFloor()


def task_of(params=FLOOR, times=TIMES[:1], altitudes_m=(20.0,), **gps) -> MapTask:
    city = replace(ju.demo_city(600, 600), blocks=None)
    x_min, y_min, _, _ = city.extent_m
    region = ju.Grid(city.crs, 10.0, round(y_min / 10) + 15, round(x_min / 10) + 15, 24, 28)
    sky = ju.Gps(times=times, **gps)
    sections = {"gps": sky} | ({"gps_floor": params} if params else {})
    return MapTask(
        city, region, view_sky(region, sky), MapParams(altitudes_m=altitudes_m, sections=sections)
    )


@pytest.fixture(scope="module")
def maps():
    return compute_maps(task_of())


def with_floor(task: MapTask) -> MapTask:
    sections = {**task.params.sections, "gps_floor": GpsFloor()}
    return replace(task, params=replace(task.params, sections=sections))


@pytest.mark.parametrize("dop", ["gdop", "vdop"])
def test_the_maps_are_good_a_centimetre_above_it_and_bad_a_centimetre_below(dop):
    params = GpsFloor(5.0, dop)
    floor_m = compute_maps(task_of(params)).m("gps_floor")
    roof_m = compute_maps(task_of()).m("roof")
    edges_m = np.unique(floor_m[(floor_m > roof_m) & (floor_m > 0.02)])
    assert len(edges_m) > 50
    for edge_m in edges_m[:: len(edges_m) // 6].tolist():
        altitudes_m = edge_m - 0.01, edge_m, edge_m + 0.01
        at_m = {z_m: z_m for z_m in altitudes_m}
        by_altitude = compute_maps(task_of(None, altitudes_m=altitudes_m))
        for z_m in at_m:
            is_free = by_altitude.m("obstacle", z_m) == 0
            is_good = by_altitude.m(dop, z_m) <= 5.0
            np.testing.assert_array_equal(is_good[is_free], (floor_m <= np.float32(z_m))[is_free])


def test_it_is_no_cost_and_stands_on_roofs(maps):
    floor_m = maps.m("gps_floor")
    assert [*maps.metrics] == ["gps", "lidar", "risk"]
    assert (floor_m >= maps.m("roof")).all()
    assert (floor_m[maps.m("roof") > 0] == maps.m("roof")[maps.m("roof") > 0]).any()
    attributes = maps.ds["gps_floor"].attrs
    assert attributes["long_name"] == (
        "least height above the ground from which GDOP stays at or below 6"
    )
    assert (attributes["units"], attributes["comment"]) == ("m", METRIC.caveat)
    without = compute_maps(task_of(None))
    xr.testing.assert_identical(
        maps.ds.drop_vars("gps_floor").drop_attrs(), without.ds.drop_attrs()
    )


def test_a_series_keeps_each_time_and_the_highest_and_a_long_one_the_highest_alone():
    each = compute_maps(task_of(times=TIMES))
    assert each.ds["gps_floor"].dims == ("time", "y", "x")
    one = compute_maps(task_of(times=TIMES[1:2]))
    np.testing.assert_array_equal(each.m("gps_floor", time=TIMES[1]), one.m("gps_floor"))
    highest = each.m("gps_floor_highest")
    np.testing.assert_array_equal(highest, each.ds["gps_floor"].max("time"))
    assert (highest > each.m("gps_floor")).any()
    series = compute_maps(task_of(times=TIMES, series="statistics"))
    assert "gps_floor" not in series.ds
    np.testing.assert_array_equal(series.m("gps_floor"), highest)
    with pytest.raises(InputError, match="hold GPS statistics over 3 epochs"):
        series.m("gps_floor", time=TIMES[0])


@pytest.mark.slow
@pytest.mark.parametrize("has_terrain", [False, True])
@pytest.mark.parametrize("series", ["epochs", "statistics"])
def test_a_device_makes_the_same_bits(has_terrain, series):
    task = with_floor(tiled_task(tiled_city(with_terrain=has_terrain), series))
    found, truth = compute_maps(task, device_bytes=np.inf).ds, compute_maps(task).ds
    xr.testing.assert_identical(found, truth)
    name = "gps_floor" if series == "epochs" else "gps_floor_highest"
    assert len(np.unique(truth[name])) > 10


@pytest.mark.slow
def test_all_maps_hold_it_and_it_pays_for_nothing(maps):
    task = task_of()
    inputs, skies = ju.grad.map_inputs(
        task.city,
        task.region,
        altitudes_m=(20.0,),
        gps=task.params.gps,
        gps_floor=GpsFloor(),
    )
    sky = jax.tree.map(lambda values: values[0], skies)
    made = jax.jit(ju.grad.all_maps)(inputs, sky, {"gps": 2.0})
    np.testing.assert_array_equal(made["gps_floor"], maps.m("gps_floor"))
    without, _ = ju.grad.map_inputs(
        task.city, task.region, altitudes_m=(20.0,), gps=task.params.gps
    )
    np.testing.assert_array_equal(
        made["cost"], jax.jit(ju.grad.all_maps)(without, sky, {"gps": 2.0})["cost"]
    )


@pytest.mark.slow
def test_finer_rays_are_those_of_the_maps():
    fine = task_of(altitudes_m=(20.0, 45.0))
    fine = replace(fine, params=replace(fine.params, oversample=3))
    made = compute_maps(fine)
    for z_m in (20.0, 45.0):
        is_free = made.m("obstacle", z_m) == 0
        is_good = made.m("gdop", z_m) <= 6
        np.testing.assert_array_equal(is_good[is_free], (made.m("gps_floor") <= z_m)[is_free])


def test_it_is_infinite_where_no_height_suffices():
    assert np.isinf(compute_maps(task_of(GpsFloor(0.5))).m("gps_floor")).all()


def test_slabs_and_wrong_settings_are_refused_in_a_sentence():
    with pytest.raises(InputError, match="the GPS floor knows no slabs"):
        with_floor(hanging_city.task(hanging_city.city()))
    with pytest.raises(InputError, match="dop_threshold must be a positive number"):
        GpsFloor(0.0)
    with pytest.raises(InputError, match="dop must be 'gdop'"):
        GpsFloor(dop="sdop")


def test_it_has_no_weight(maps):
    with pytest.raises(InputError, match="unknown weight 'gps_floor'"):
        ju.cost_map(maps, 20.0, weights={"gps_floor": 1.0})
    with pytest.raises(InputError, match="unknown weight 'gps_floor'"):
        ju.Scenario.from_dict(
            {
                "region": {"bounds": [-74.02, 40.70, -73.98, 40.73]},
                "buildings": {"source": "synthetic"},
                "weights": {"gps_floor": 1.0},
            }
        )
