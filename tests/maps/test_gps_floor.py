"""The GPS floor in whole maps: what the maps below and above it say, a series, roofs, and where it is refused."""

import re
from dataclasses import replace

import jax
import numpy as np
import pytest
import rasterio
import xarray as xr
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.draw.metrics import precise_percent
from jaxurban.draw.paths import maps_figures
from jaxurban.errors import InputError
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.shared import OneMap
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps_floor import METRIC, GpsFloor
from jaxurban.plot import plot_metric
from jaxurban.viewer.layers import layers_of, legend_of
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


@pytest.mark.slow
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


@pytest.fixture(scope="module")
def two_altitudes():
    return compute_maps(task_of(GpsFloor(3.5), altitudes_m=(12.0, 30.0)))


def joined_ends(maps, limits):
    """Return two far cells that a way joins at 12 m, above the floor too, the shortest without leading below it."""
    free = ju.cost_map(maps, 12.0, objective="distance")
    kept = ju.cost_map(maps, 12.0, objective="distance", constraints=limits)
    rng = np.random.default_rng(0)
    islands = kept.free_space.islands
    cells = np.argwhere(islands == np.bincount(islands[islands > 0]).argmax())
    for _ in range(50):
        ends = [
            tuple(map(float, maps.grid.lonlat_of_cell(*cell)))
            for cell in rng.choice(cells, 2, replace=False)
        ]
        plain = free.plan(*ends)
        if ju.explain(plain, maps).totals["below_gps_floor_m"] > 0:
            return ends, plain, kept.plan(*ends)
    raise AssertionError("no shortest way leads below the floor")


@pytest.mark.slow
def test_routes_stay_above_it_and_reports_and_checks_say_where_they_do_not(two_altitudes):
    maps = two_altitudes
    limits = ju.Constraints.read(require="gps_floor")
    assert str(limits) == "at or above the GPS floor, vertical clearance of 3 m"
    floor_m = maps.m("gps_floor")
    cost_map = ju.cost_map(maps, 12.0, constraints=limits)
    is_free = ju.cost_map(maps, 12.0).is_free
    np.testing.assert_array_equal(cost_map.is_free, is_free & (floor_m <= 12))
    np.testing.assert_array_equal(cost_map.is_free, is_free & (maps.m("gdop", 12.0) <= 3.5))
    cell = tuple(map(int, np.argwhere(is_free & ~cost_map.is_free)[0]))
    assert cost_map.free_space.why_closed(cell) == (
        f"closed by the GPS floor of {floor_m[cell]:.1f} m there at 12 m"
    )

    ends, plain, kept = joined_ends(maps, limits)
    assert kept.length_m > plain.length_m
    report = ju.explain(kept, maps)
    assert report.totals["below_gps_floor_m"] == 0
    below = ju.explain(plain, maps)
    profile = below.profile
    is_below = profile["gps_floor_m"] > 12
    length_m = (profile["to_m"] - profile["from_m"])[is_below].sum()
    assert below.totals["below_gps_floor_m"] == pytest.approx(length_m)
    assert "below floor m" in below.table()
    assert ju.check(maps, kept).limits["above_gps_floor"]
    findings = ju.check(maps, plain, constraints=limits).findings
    below = findings[findings["what"].str.startswith("flies below the GPS floor")]
    assert len(below)
    assert not any("GPS floor" in what for what in ju.check(maps, kept).findings["what"])
    for row in below[below["clear_m"].notna()].to_dict(
        "records"
    ):  # how high it is, and what clears it
        metres = float(re.search(r"reaches (\S+) m above", row["what"])[1])
        assert 12 < metres <= row["clear_m"] + 0.05
        assert row["by_m"] == pytest.approx(metres - 12, abs=0.1)
    assert below["clear_m"].notna().any()
    assert below["aside_m"].isna().all()

    # Between levels a route may climb over the floor instead.
    levels = ju.Levels()
    climbing = ju.plan(maps, *ends, altitude_m=levels, constraints=limits, objective="distance")
    assert ju.explain(climbing, maps).totals["below_gps_floor_m"] == 0
    volume = ju.cost_map(maps, levels, constraints=limits)
    np.testing.assert_array_equal(
        volume.is_free,
        ju.cost_map(maps, levels).is_free & (floor_m <= np.c_[12.0, 30.0].T[:, :, None]),
    )


def test_a_mission_takes_off_where_gps_is_good_from_the_ground(two_altitudes):
    limits = ju.Constraints(above_gps_floor=True)
    is_free = limits.is_free_to_ground(two_altitudes, 30.0)
    plain = ju.Constraints().is_free_to_ground(two_altitudes, 30.0)
    np.testing.assert_array_equal(is_free, plain & (two_altitudes.m("gps_floor") == 0))
    assert is_free.any()
    assert not is_free.all()


def test_without_it_in_the_maps_the_rule_is_refused():
    without = compute_maps(task_of(None))
    with pytest.raises(InputError, match="these maps hold no GPS floor: make them with"):
        ju.cost_map(without, 20.0, constraints=ju.Constraints(above_gps_floor=True))


def test_a_bound_on_it_is_in_metres(maps):
    limits = ju.Constraints.read(require="gps_floor<=15")
    closed = limits.closed(maps, 20.0)
    assert (closed >= (maps.m("gps_floor") > 15)).all()
    assert not closed.all()


def test_files_hold_it_with_no_data_where_no_height_suffices(maps, tmp_path):
    maps.save(tmp_path / "made")
    with rasterio.open(tmp_path / "made" / "geotiff" / "gps_floor_10m.tif") as file:
        assert np.isnan(file.nodata)
        assert file.units == ("m",)
        np.testing.assert_array_equal(file.read(1)[::-1], maps.m("gps_floor"))
        tags = file.tags()
    assert (tags["comment"], tags["time"]) == (METRIC.caveat, TIMES[0])
    style = (tmp_path / "made" / "geotiff" / "gps_floor_10m.qml").read_text(encoding="utf-8")
    assert 'classificationMax="120.0"' in style
    opened = ju.open_maps(tmp_path / "made")
    np.testing.assert_array_equal(opened.m("gps_floor"), maps.m("gps_floor"))

    never = compute_maps(task_of(GpsFloor(0.5)))
    never.save(tmp_path / "never")
    with rasterio.open(tmp_path / "never" / "geotiff" / "gps_floor_10m.tif") as file:
        assert np.isnan(file.read(1)).all()


def test_a_picture_says_over_which_share_an_altitude_is_high_enough(maps):
    figure = plot_metric(maps, "gps_floor")
    words = " ".join(text.get_text() for text in figure.findobj(Text))
    share = precise_percent((maps.m("gps_floor") <= 20).mean())
    assert f"good GPS: at 20 m over {share} of the area, roofs included" in words
    assert "stays at or below 6" in words.replace("\n", " ")
    assert "without reflections" in words.replace("\n", " ")
    assert {"gps_floor", "gps"} <= {*maps_figures(maps, [])}


def test_the_viewer_offers_it_among_the_satellites(maps):
    layer = layers_of(maps)["gps_floor"]
    assert (layer.group, layer.dims, layer.is_hidden) == ("Satellites", ("time",), False)
    values = layer.values(OneMap(altitude_m=20.0))
    np.testing.assert_array_equal(values, maps.m("gps_floor"))
    legend = legend_of(layer, values)
    assert "GPS floor in metres" in legend["html"]
