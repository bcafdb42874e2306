"""What each kind does in every map, against cities in which it is a building or is left out; rasters of vegetation."""

import math
from collections import Counter
from dataclasses import replace

import geopandas as gpd
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
import shapely
import xarray as xr

import jaxurban as ju
from jaxurban.io.city import City
from jaxurban.io.rasterise import rasterise
from jaxurban.maps.build import compute_maps
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.lidar import Lidar
from jaxurban.receivers.outlines import Hiding
from jaxurban.settings import SLABS, Heights, HeightStd
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import WGS84, Grid, transformer
from jaxurban.world.kinds import ALL_KINDS
from jaxurban.world.known import Rays
from jaxurban.world.raster import Raster
from tests import tiled_runs
from tests.guess_records import by_name
from tests.kernels.test_lidar import march_rays
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "settings"),
    [
        ({}, {"oversample": 3}),
        ({"terrain": hills(), "gps": Gps(plants="hide")}, {}),
        ({"hanging": SLABS}, {}),
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
    """Return a canopy over some of the pixels, in the lines of the map's cells."""
    num = int(SIDE_M / resolution_m)
    rng = np.random.default_rng(8)
    values = np.where(rng.random((num, num)) < 0.08, rng.uniform(5, 40, (num, num)), 0.0)
    values[rng.random((num, num)) < 0.2] = 0.0
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_with_buildings_alone_maps_and_inputs_are_those_of_a_city_without_others():
    both = replace(by_raster(), structures=structures(), kinds=("building",))
    without = town(structures().take(structures().kinds == "unknown"))
    found, expected = (compute_maps(task(of, oversample=3)).ds for of in (both, without))
    xr.testing.assert_identical(found.drop_vars("roof_kind"), expected.drop_vars("roof_kind"))
    inputs = [ju.grad.map_inputs(of, REGION) for of in (replace(both, structures=None), town())]
    assert jax.tree.structure(inputs[0]) == jax.tree.structure(inputs[1])
    assert all(map(np.array_equal, *map(jax.tree.leaves, inputs)))
    assert "roof_kind" not in compute_maps(task(replace(both, structures=None))).ds


def test_one_text_of_kinds_is_one_kind():
    assert ju.Obstacles(kinds="building").kinds == ("building",)
    with pytest.raises(ju.InputError, match=r"kinds must hold 'building', got \['tree'\]: add it"):
        City.from_files("synthetic", kinds="tree")


@pytest.mark.slow
@pytest.mark.parametrize("gps", [None, Gps(plants="hide")], ids=["pass", "hide"])
def test_all_maps_are_those_of_build_maps(gps):
    city = replace(by_raster(), structures=structures(), gps=gps)
    inputs, skies = ju.grad.map_inputs(city, REGION, altitudes_m=(30.0,))
    made = jax.jit(ju.grad.all_maps)(inputs, jax.tree.map(lambda values: values[0], skies))
    maps = ju.build_maps(city, grid=REGION, altitudes_m=(30.0,), progress=False).ds
    is_free = maps["obstacle"].values == 0
    for name in ("num_visible", "gps", "lidar", "risk"):
        expected = maps[name].values.reshape(is_free.shape)
        np.testing.assert_allclose(
            np.asarray(made[name])[is_free], expected[is_free], rtol=1e-5, err_msg=name
        )


@pytest.mark.slow
@pytest.mark.parametrize("plants", ["pass", "hide"])
def test_soft_layers_are_those_of_kinds_as_buildings_and_slopes_those_by_differences(plants):
    trees = replace(by_raster(), structures=structures())
    params = ju.grad.SoftParams(altitude_m=25.0, sections={"gps": Gps(plants=plants)})
    hiding = (*HIDE, "tree", "wood") if plants == "hide" else HIDE
    is_free = rasterise(trees, REGION).roof_m < 25
    with jax.enable_x64(True):
        soft = ju.grad.soft_city(trees, REGION, params)
        for name, kinds in (("gps", hiding), ("lidar", (*HIDE, *RETURN_ALONE)), ("risk", OTHERS)):
            as_built = ju.grad.soft_city(as_buildings(trees, kinds), REGION, params)
            layers = [of.layer(name, of.height_m, params) for of in (soft, as_built)]
            np.testing.assert_allclose(*(layer[is_free] for layer in layers), err_msg=name)

            def total(height_m, name=name):
                return soft.layer(name, height_m, params).sum()

            by_difference = [
                (total(soft.height_m + step) - total(soft.height_m - step)) / 2e-4
                for step in 1e-4 * jnp.eye(2)
            ]
            slope = jax.grad(total)(soft.height_m)
            np.testing.assert_allclose(slope, by_difference, 1e-3, 1e-6, err_msg=name)


KML = (
    '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><LineString>'
    "<coordinates>{}</coordinates></LineString></Placemark></Document></kml>"
)
# Gothenburg's canopy, beside three made-up houses on whole metres; brute force over the files' own pixels of 1 m.
CORNER_M, GOTHENBURG = (147_720, 6_398_557), (11.962, 57.7063, 11.9652, 57.708)
# Their sides run through no centre of a cell, 5 m or 2 m wide: whether such a cell is under the roof is a convention.
BLOCKS = {(40, 41, 60, 77): 15.0, (100, 81, 130, 91): 22.0, (150, 149, 170, 201): 6.0}
FAR = {(0, 1, 2, 3): 3.0, (232, 221, 234, 223): 3.0}  # so that the file covers the raster


@pytest.fixture(scope="module")
def gothenburg(data_dir, tmp_path_factory):
    """Return a function to the city, with terrain or without, and what stands on each pixel, from the south."""
    file = tmp_path_factory.mktemp("houses") / "houses.gpkg"
    outlines = [shapely.box(*np.add(box, CORNER_M * 2)) for box in BLOCKS | FAR]
    houses = {"height": list((BLOCKS | FAR).values())}
    gpd.GeoDataFrame(houses, geometry=outlines, crs="EPSG:3007").to_file(file)

    def read(name: str) -> np.ndarray:
        with rasterio.open(data_dir / f"raster/gothenburg_{name}.tif") as source:
            return source.read(1)[::-1].astype(np.float32)

    top_m = read("cdsm")
    for (west, south, east, north), height_m in (BLOCKS | FAR).items():
        part = top_m[south:north, west:east]
        np.maximum(part, height_m, out=part)

    def city(has_terrain: bool = False, vegetation=data_dir / "raster/gothenburg_cdsm.tif") -> City:
        return City.from_files(
            ju.Buildings(file, height_column="height", unit="m"),
            bounds=GOTHENBURG,
            crs="EPSG:3007",
            terrain=data_dir / "raster/gothenburg_dem.tif" if has_terrain else None,
            vegetation=vegetation,
            gps=Gps(mask_deg=20.0),
        )

    return city, top_m, read("dem")


def around(middle: float) -> slice:
    """Return the pixels that hold a coordinate: one, two where it lies between them, none beyond the raster."""
    return slice(max(math.ceil(middle) - 1, 0), max(math.floor(middle) + 1, 0))


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(("has_terrain", "side_m"), [(False, 5), (True, 5), (True, 2)])
def test_gothenburgs_canopy_closes_cells_and_returns_as_brute_force_says(
    gothenburg, has_terrain, side_m
):
    city, top_m, ground_m = gothenburg
    maps = ju.build_maps(
        city(has_terrain),
        resolution_m=float(side_m),
        altitudes_m=(3.0, 8.0, 15.0),
        lidar=ju.Lidar(azimuths=24, range_m=40.0),
        risk=ju.Risk(threshold_m=30.0),
        progress=False,
    )
    halo = 40 // side_m
    grid = maps.grid.padded(halo, halo, halo, halo)
    touched_m, centre_m, level_m = np.zeros((3, *grid.shape), np.float32)
    for row, col in np.ndindex(grid.shape):
        south = (grid.first_row + row) * side_m - CORNER_M[1]
        west = (grid.first_col + col) * side_m - CORNER_M[0]
        cell = slice(max(south, 0), south + side_m), slice(max(west, 0), west + side_m)
        middle = around(south + side_m / 2), around(west + side_m / 2)
        touched_m[row, col] = top_m[cell].max(initial=0)
        centre_m[row, col] = top_m[middle].max(initial=0)
        level_m[row, col] = ground_m[middle].mean() if ground_m[middle].size else -500
    inner = (slice(halo, -halo),) * 2
    np.testing.assert_array_equal(maps.m("roof_touched"), touched_m[inner])
    np.testing.assert_array_equal(maps.m("roof"), centre_m[inner])
    cells = np.argwhere(np.ones(maps.grid.shape)) + halo
    for altitude_m in maps.altitudes_m:
        is_closed = centre_m >= altitude_m
        np.testing.assert_array_equal(maps.m("obstacle", altitude_m), is_closed[inner])
        np.testing.assert_array_equal(
            maps.is_free(altitude_m, "touched"), touched_m[inner] < altitude_m
        )
        distance_m = np.full(len(cells), 30.0)
        for source in np.argwhere(is_closed):
            np.minimum(distance_m, side_m * np.hypot(*(cells - source).T), out=distance_m)
        free = ~is_closed[inner]
        np.testing.assert_allclose(
            maps.m("risk", altitude_m)[free],
            distance_m.reshape(maps.grid.shape)[free] / 30,
            atol=1e-6,
        )
        scan = np.radians(np.linspace(-15, 15, 16)), 24, 40.0, float(side_m)
        ground = level_m if has_terrain else np.zeros_like(level_m)
        counts = march_rays(centre_m, ground, halo, altitude_m, *scan)
        np.testing.assert_allclose(maps.m("lidar", altitude_m)[free], counts[free] / 24, atol=1e-6)


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("has_terrain", [False, True])
def test_no_flight_into_gothenburgs_canopy_is_clean(gothenburg, has_terrain, tmp_path):
    city, top_m, ground_m = gothenburg
    of = city(has_terrain)
    maps = ju.build_maps(of, altitudes_m=(3.0, 15.0, 30.0), resolution_m=5.0, progress=False)
    level_m = ground_m if has_terrain else np.zeros_like(ground_m)
    rng = np.random.default_rng(5)
    x_min, y_min, x_max, y_max = np.add(maps.grid.bounds_m, (8, 8, -8, -8)) - np.tile(CORNER_M, 2)
    counts = Counter()
    for _ in range(150):
        start, angle, run_m = (
            rng.uniform((x_min, y_min), (x_max, y_max)),
            *rng.uniform((0, 5), (7, 40)),
        )
        step = run_m * np.array([np.cos(angle), np.sin(angle)])
        ends = np.clip([start, start + step], (x_min, y_min), (x_max, y_max))
        height_m = rng.uniform(3, 30)
        lonlat = np.transpose(transformer("EPSG:3007", WGS84).transform(*(ends + CORNER_M).T))
        places = " ".join(f"{lon:.9f},{lat:.9f},{height_m:.3f}" for lon, lat in lonlat)
        line = tmp_path / "line.kml"
        line.write_text(KML.format(places))
        result = ju.check(maps, line, heights="ground", home=tuple(lonlat[0]), sources=of)

        # The witness looks at a point every few centimetres, over the pixels; the climb at the start.
        share = np.linspace(0, 1, 1000)
        x, y = ends[0][:, None] + share * (ends[1] - ends[0])[:, None]
        at = np.floor(y).astype(int), np.floor(x).astype(int)
        own_m = level_m[at]
        flown_m = height_m + (1 - share) * own_m[0] + share * own_m[-1]
        is_into = (top_m[at] > 0) & (flown_m < own_m + top_m[at] - (1.5 if has_terrain else 0.01))
        has_contact = bool(is_into.any()) or top_m[at][0] > 0
        is_clean = result.findings.empty and not result.not_judged
        counts[has_contact, is_clean] += 1
    assert counts[True, True] == 0
    assert counts[True, False] > 20
    assert counts[False, True] > 20


def test_plants_beyond_the_maps_are_not_looked_at_so_that_nearby_is_not_judged(tmp_path):
    canopy = pixels()
    canopy.values[:, 12:20] = 0.0
    canopy.values[:, :12] = 60.0  # up to the maps' western side
    city = town(vegetation=canopy)
    maps = ju.build_maps(city, grid=REGION, altitudes_m=(30.0, 50.0), progress=False)
    x_m, y_m = [REGION.x_min_m + 2.0] * 2, np.add(REGION.y_min_m, [100.0, 130.0])
    lonlat = np.transpose(transformer(CRS, WGS84).transform(x_m, y_m))
    line = tmp_path / "line.kml"
    line.write_text(KML.format(" ".join(f"{lon:.9f},{lat:.9f},45" for lon, lat in lonlat)))
    for clearance_m, state in ((0.0, "clean"), (5.0, "not-judged")):
        result = ju.check(
            maps,
            line,
            heights="ground",
            home=tuple(lonlat[0]),
            sources=city,
            constraints=ju.Constraints(clearance_m=clearance_m),
        )
        assert result.state == state


@pytest.mark.slow
@pytest.mark.parametrize("has_outlines", [True, False])
@pytest.mark.parametrize("is_beyond", [True, False])
def test_where_plants_are_not_known_nothing_below_their_bound_is_judged(
    tmp_path, has_outlines, is_beyond
):
    canopy = pixels()
    canopy.values[:, :40] = 0.0
    canopy.values[:, 40:] = np.nan
    roofs = replace(canopy, values=np.zeros_like(canopy.values))
    known = canopy.values[:, :40] if is_beyond else canopy.values
    city = town() if has_outlines else City(CRS, town().extent_m, roofs=roofs)
    city = replace(city, vegetation=replace(canopy, values=known))
    maps = ju.build_maps(city, grid=REGION, altitudes_m=(30.0, 50.0), progress=False)
    limit_m = np.zeros(REGION.shape)
    limit_m[:, 28:] = 45.0
    np.testing.assert_array_equal(maps.m("roof_limit"), limit_m)
    x_m, y_m = REGION.x_min_m + np.array([100.0, 200.0]), [REGION.y_min_m + 20.0] * 2
    lonlat = np.transpose(transformer(CRS, WGS84).transform(x_m, y_m))
    line = tmp_path / "line.kml"
    for height_m in (40.0, 50.0):
        places = " ".join(f"{lon:.9f},{lat:.9f},{height_m}" for lon, lat in lonlat)
        line.write_text(KML.format(places))
        result = ju.check(maps, line, heights="ground", home=tuple(lonlat[0]), sources=city)
        assert result.findings.empty
        assert any("may reach 45 m" in text for text in result.not_judged) == (height_m < 45)


@pytest.mark.data
def test_a_raster_that_is_no_canopy_or_not_there_is_refused_and_a_part_is_a_guess(
    gothenburg, data_dir, tmp_path
):
    city, _, _ = gothenburg
    raster = data_dir / "raster"
    with rasterio.open(raster / "gothenburg_cdsm.tif") as source:
        canopy_m, profile = source.read(1), source.profile

    def read(name: str, values=None, unit: str = "", **changed) -> City:
        file = raster / name
        if values is not None:
            file = tmp_path / name
            size = {"height": len(values), "width": len(values[0]), "dtype": "float32"}
            with rasterio.open(file, "w", **profile | {"nodata": None} | size | changed) as target:
                target.write(values.astype(np.float32), 1)
                target.set_band_unit(1, unit)
        return city(vegetation=file)

    far = rasterio.Affine(1, 0, profile["transform"].c + 400, 0, -1, profile["transform"].f)
    for given, sentence in [
        ({"name": "gothenburg_dsm.tif"}, "looks like elevations"),
        ({"name": "gothenburg_dem.tif"}, "looks like elevations"),
        ({"name": "bilbao_dem.tif"}, "does not reach the region: it covers"),
        ({"name": "far.tif", "values": canopy_m, "transform": far}, "does not reach the region"),
        ({"name": "crs.tif", "values": canopy_m, "crs": "EPSG:3006"}, "does not reach the region"),
        ({"name": "cm.tif", "values": 100 * canopy_m}, "does not hold heights of plants in metres"),
        ({"name": "none.tif"}, "does not exist: check the path"),
    ]:
        with pytest.raises(ju.InputError, match=sentence):
            read(**given)
    in_feet = read("feet.tif", canopy_m / 0.3048, unit="ft").vegetation
    np.testing.assert_allclose(in_feet.values, canopy_m, atol=1e-5)
    assert any(
        "without known plants" in guess
        for guess in by_name(read("half.tif", canopy_m[:, :100]).guesses)
    )
