"""What each kind does in every map, against cities in which it is a building or is left out; rasters of vegetation."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import shapely
import xarray as xr

import jaxurban as ju
from jaxurban.io.city import City
from jaxurban.maps.build import compute_maps
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.lidar import Lidar
from jaxurban.satellites.outlines import Hiding
from jaxurban.settings import SLABS, Heights, HeightStd
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import WGS84, Grid, transformer
from jaxurban.world.kinds import ALL_KINDS
from jaxurban.world.known import Rays
from jaxurban.world.raster import Raster
from tests import tiled_runs
from tests.made_maps import city_of_boxes

CRS, SIDE_M, EAST_M, NORTH_M = "EPSG:32618", 400.0, 585_000.0, 4_511_000.0
REGION = Grid(CRS, 5.0, int(NORTH_M / 5) + 12, int(EAST_M / 5) + 12, 56, 56)
PARAMS = MapParams(
    altitudes_m=(10.0, 30.0),
    sections={"gps": Gps(bounds=True), "lidar": Lidar(azimuths=36, range_m=60.0)},
)
# Written apart from the table: what of each kind is true.
HIDE = ("chimney", "tank", "tower", "canopy", "structure", "bridge", "unknown")
RETURN_ALONE = ("mast", "pole", "pylon", "tree", "wood")
NEITHER = ("crane", "turbine", "wire", "cableway")
OTHERS = (*HIDE, *RETURN_ALONE, *NEITHER)
HOUSES = [(80, 80, 120, 110), (200, 180, 240, 260)]


def structures(floor_m: float = 0.0) -> Footprints:
    """Return one structure of each kind, 35 m to 50 m high, over a third of them guessed; none over another."""
    num = len(OTHERS)
    at_m = 70.0 + 70 * np.stack(np.divmod(np.arange(num), 4)) + [[EAST_M], [NORTH_M]]
    wide_m = np.linspace(6.0, 23.0, num)
    is_guessed = np.arange(num) % 3 == 0
    return Footprints(
        polygons=shapely.buffer(shapely.points(at_m.T), wide_m / 2),
        height_m=np.linspace(35.0, 50.0, num),
        min_height_m=np.full(num, floor_m),
        origin=np.where(is_guessed, HeightOrigin.DEFAULT, HeightOrigin.HEIGHT).astype(np.uint8),
        is_part=np.zeros(num, bool),
        kind=np.array(OTHERS, object),
        limit_m=np.where(is_guessed, 80.0, np.inf),
    )


def town(others: Footprints | None = None, **more) -> City:
    """Return two houses, with the structures beside them."""
    houses = city_of_boxes(HOUSES, [12.0, 60.0], SIDE_M, (EAST_M, NORTH_M), CRS)
    return replace(houses, structures=others, **more)


def as_buildings(city: City, kinds=OTHERS) -> City:
    """Return a city whose structures of some kinds are buildings and whose others are not there."""
    others = city.structures.take(np.isin(city.structures.kinds, kinds))
    houses = city.buildings.joined(replace(others, kind=None))
    return replace(city, buildings=houses, structures=None)


def hills() -> Raster:
    values = np.random.default_rng(3).uniform(0, 25, (30, 30)).astype(np.float32)
    return Raster(values, (20.0, 0.0, EAST_M - 100, 0.0, -20.0, NORTH_M + 500), CRS)


def task(city: City, **settings) -> MapTask:
    return MapTask(city, REGION, tiled_runs.sky(), replace(PARAMS, **settings))


def maps_of(city: City, **settings):
    return compute_maps(task(city, **settings)).ds.drop_attrs(deep=False)


NO_ERRORS = HeightStd(height=0.0, levels=0.0, default=0.0, raster=0.0)


@pytest.mark.parametrize(
    ("more", "settings"),
    [
        ({}, {"oversample": 3}),
        ({"terrain": hills(), "gps": Gps(plants="hide")}, {}),
        ({"hanging": SLABS}, {"heights": Heights(all_touched=True)}),
        ({}, {"heights": Heights(height_samples=2, height_std_m=NO_ERRORS), "oversample": 3}),
    ],
    ids=["finer", "hills, plants hide", "slabs", "samples"],
)
def test_each_kind_closes_cells_and_hides_and_returns_as_it_says(more, settings):
    city = town(structures(10.0 * (more.get("hanging") == SLABS)), **more)
    hiding = HIDE
    if "gps" in more:
        hiding = (*HIDE, "tree", "wood")
        settings = {
            **settings,
            "sections": {**PARAMS.sections, "gps": Gps(bounds=True, plants="hide")},
        }
    if city.hanging == SLABS:  # what hangs and is no plant, mast or wire
        is_solid = np.isin(city.structures.kinds, HIDE)
        floor_m = np.where(is_solid, city.structures.min_height_m, 0.0)
        expected_city = replace(city, structures=replace(city.structures, min_height_m=floor_m))
    else:
        expected_city = city
    found = maps_of(city, **settings)
    standing, hides, returns = (
        maps_of(as_buildings(expected_city, kinds), **settings)
        for kinds in (OTHERS, hiding, (*HIDE, *RETURN_ALONE))
    )
    is_free = standing["obstacle"] == 0
    for name, less in (("num_visible", hides), ("lidar", returns)):
        assert not less[name].where(is_free).equals(standing[name].where(is_free))
    for name in found:
        if name.startswith("roof_kind"):
            continue
        expected = standing[name]
        if name.startswith(("gps", "num_visible")) or name.endswith("dop"):
            expected = hides[name]
        elif name.startswith("lidar"):
            expected = returns[name]
        if "altitude" in expected.dims:
            ours, expected = found[name].where(is_free), expected.where(is_free)
        else:
            ours = found[name]
        np.testing.assert_array_equal(ours.values, expected.values, err_msg=name)


def pixels(resolution_m: float = 5.0) -> Raster:
    """Return a canopy over a third of the pixels, in the lines of the map's cells; a fifth has no data."""
    num = int(SIDE_M / resolution_m)
    rng = np.random.default_rng(8)
    values = np.where(rng.random((num, num)) < 0.08, rng.uniform(5, 40, (num, num)), 0.0)
    values[rng.random((num, num)) < 0.2] = np.nan
    place = (resolution_m, 0.0, EAST_M, 0.0, -resolution_m, NORTH_M + SIDE_M)
    return Raster(values.astype(np.float32), place, CRS)


def woods_of(canopy: Raster) -> Footprints:
    """Return the pixels of a canopy as outlines."""
    row, col = np.nonzero(canopy.values > 0)
    side_m, _, x_m, _, _, y_m = canopy.transform
    west_m, north_m = x_m + side_m * col, y_m - side_m * row
    num = len(row)
    return Footprints(
        shapely.box(west_m, north_m - side_m, west_m + side_m, north_m),
        canopy.values[row, col].astype(float),
        np.zeros(num),
        np.full(num, HeightOrigin.HEIGHT, np.uint8),
        np.zeros(num, bool),
        np.full(num, "wood", object),
    )


def by_outlines(**more) -> City:
    return town(woods_of(pixels()), **more)


def by_raster(**more) -> City:
    return town(vegetation=pixels(), **more)


@pytest.mark.parametrize("plants", ["pass", "hide"])
def test_a_canopy_raster_is_what_woods_of_its_pixels_are(plants):
    sections = {**PARAMS.sections, "gps": Gps(plants=plants)}
    found, expected = (
        maps_of(of(terrain=hills()), sections=sections) for of in (by_raster, by_outlines)
    )
    assert set(np.unique(found["roof_kind"])) == {0, 1, 1 + ALL_KINDS.index("wood")}
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


def margins_m(city: City) -> np.ndarray:
    """Return the margins of random rays from the middle of the town, by outlines and pixels."""
    rng = np.random.default_rng(1)
    num = 400
    x_m, y_m = np.add([[EAST_M], [NORTH_M]], rng.uniform(150, 250, (2, num)))
    rays = Rays(x_m, y_m, rng.uniform(0, 2 * np.pi, num), rng.uniform(0.4, 1.5, num))
    return Hiding(city, city.known_ground).behind(rays, np.full(num, 3.0))["margin_m"].to_numpy()


def test_rays_pass_plants_or_meet_them_whether_outlines_or_pixels():
    hide = ju.Gps(plants="hide")
    np.testing.assert_array_equal(margins_m(by_raster()), margins_m(town()))
    np.testing.assert_array_equal(margins_m(by_outlines()), margins_m(town()))
    of_boxes, of_pixels = margins_m(by_outlines(gps=hide)), margins_m(by_raster(gps=hide))
    is_hidden = of_boxes <= 0
    assert np.mean(is_hidden != (margins_m(town()) <= 0)) > 0.1
    assert np.mean(is_hidden != (of_pixels <= 0)) < 0.02  # steps cut corners of pixels


def test_sky_by_the_map_is_that_of_the_city_in_which_plants_are_buildings_or_are_not_there():
    place, time = (EAST_M + 152.0, NORTH_M + 150.0), "2020-04-27T16:00:00Z"
    lonlat = transformer(CRS, WGS84).transform(*place)
    for plants, expected in (("pass", town()), ("hide", as_buildings(by_outlines()))):
        gps = ju.Gps(plants=plants, mask_deg=25.0)
        found, other = (
            ju.sky(of, lonlat, 3.0, time=time, gps=gps, by="map").table
            for of in (by_raster(), expected)
        )
        pd.testing.assert_frame_equal(found, other)


@pytest.mark.parametrize(
    "city",
    [
        pytest.param(
            lambda: replace(tiled_runs.city(), structures=spread_structures()), id="outlines"
        ),
        pytest.param(
            lambda: replace(tiled_runs.city(True), vegetation=spread_canopy()), id="rasters"
        ),
        pytest.param(
            lambda: replace(
                tiled_runs.city(),
                structures=spread_structures(),
                hanging=SLABS,
                vegetation=spread_canopy(),
                gps=Gps(plants="hide"),
            ),
            id="slabs, plants hide",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_tiles_equal_maps_in_one_piece(city, tmp_path):
    of = tiled_runs.task(city())
    sections = {**of.params.sections, "gps": of.city.gps or of.params.gps}
    of = replace(of, params=replace(of.params, sections=sections))
    maps = tiled_runs.check_tiles(of, tmp_path)
    assert len(np.unique(maps["roof_kind"])) > 2
    assert maps["roof_kind"].flag_meanings.split() == ["nothing", *ALL_KINDS, "unknown"]


def spread_structures() -> Footprints:
    """Return discs and strips of every kind all over the city of `tiled_runs`."""
    x_min, y_min, x_max, y_max = tiled_runs.city().extent_m
    rng = np.random.default_rng(4)
    num = 600
    at_m = shapely.points(rng.uniform(x_min, x_max, num), rng.uniform(y_min, y_max, num))
    ones = structures(8.0).take(rng.integers(0, len(OTHERS), num))
    return replace(
        ones,
        polygons=shapely.buffer(at_m, rng.uniform(1, 25, num)),
        height_m=rng.uniform(10, 90, num),
    )


def spread_canopy() -> Raster:
    """Return a canopy of 7 m pixels, turned by 10 degrees, over a part of the city of `tiled_runs`."""
    x_min, _, _, y_max = tiled_runs.city().extent_m
    values = np.random.default_rng(5).uniform(-60, 30, (200, 180)).clip(0).astype(np.float32)
    values[50:60] = np.nan
    east_m, south_m = 7.0 * np.cos(np.radians([10.0, 80.0]))
    place = (east_m, south_m, x_min + 100, south_m, -east_m, y_max - 100)
    return Raster(values, place, tiled_runs.city().crs)


def test_with_buildings_alone_maps_and_inputs_are_those_of_a_city_without_others():
    both = replace(by_raster(), structures=structures(), kinds=("building",))
    without = town(structures().take(structures().kinds == "unknown"))
    found, expected = (compute_maps(task(of, oversample=3)).ds for of in (both, without))
    xr.testing.assert_identical(found.drop_vars("roof_kind"), expected.drop_vars("roof_kind"))
    inputs = [ju.grad.map_inputs(of, REGION) for of in (replace(both, structures=None), town())]
    assert jax.tree.structure(inputs[0]) == jax.tree.structure(inputs[1])
    assert all(map(np.array_equal, *map(jax.tree.leaves, inputs)))
    assert "roof_kind" not in compute_maps(task(replace(both, structures=None))).ds


def test_all_maps_are_those_of_build_maps():
    city = replace(by_raster(), structures=structures())
    inputs, skies = ju.grad.map_inputs(city, REGION, altitudes_m=(30.0,))
    made = jax.jit(ju.grad.all_maps)(inputs, jax.tree.map(lambda values: values[0], skies))
    maps = ju.build_maps(city, grid=REGION, altitudes_m=(30.0,), progress=False).ds
    is_free = maps["obstacle"].values == 0
    for name in ("num_visible", "gps", "lidar", "risk"):
        expected = maps[name].values.reshape(is_free.shape)
        np.testing.assert_allclose(
            np.asarray(made[name])[is_free], expected[is_free], rtol=1e-5, err_msg=name
        )


@pytest.mark.parametrize("plants", ["pass", "hide"])
def test_soft_layers_agree_with_those_of_kinds_as_buildings_and_slopes_with_differences(plants):
    trees = replace(by_raster(), structures=structures())
    params = ju.grad.SoftParams(altitude_m=25.0, sections={"gps": Gps(plants=plants)})
    with jax.enable_x64(True):
        soft = ju.grad.soft_city(trees, REGION, params)
        assert soft.height_m.shape == (2,)

        def total(name, height_m):
            return soft.layer(name, height_m, params).sum()

        for name in ("gps", "lidar", "risk"):
            slope = jax.grad(total, 1)(name, soft.height_m)
            for number in range(2):
                step = jnp.zeros(2).at[number].set(1e-4)
                ends = [total(name, soft.height_m + sign * step) for sign in (1, -1)]
                assert slope[number] == pytest.approx(
                    float(ends[0] - ends[1]) / 2e-4, rel=1e-3, abs=1e-6
                ), name
