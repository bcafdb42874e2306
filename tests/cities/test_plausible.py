"""Files that are read well and cannot be true of a city: each is refused or becomes a guess, and true ones pass."""

import re
import warnings

import geopandas as gpd
import numpy as np
import pytest
import shapely
from affine import Affine

import jaxurban as ju
from jaxurban.cities.census import read_blocks
from jaxurban.io.rasterise import bands_of, rasterise
from jaxurban.world.grid import Grid, transformer
from tests.guess_records import by_name
from tests.made_files import (
    UTM,
    WGS84,
    X,
    Y,
    box,
    line,
    north_up,
    osm,
    write_features,
    write_raster,
    write_vector,
)

SIDE_M = 600
ROOF_M = 30.0
# Halls of 40 m with streets of 35 m between them, in all of a square of 600 m, on 2 m pixels.
PIXEL_M = 2
ROW, COL = np.mgrid[: SIDE_M // PIXEL_M, : SIDE_M // PIXEL_M] * PIXEL_M
IS_BUILT = (ROW % 75 >= 20) & (ROW % 75 < 60) & (COL % 75 >= 20) & (COL % 75 < 60)
PLANE_M = 100 + 0.05 * COL - 0.03 * ROW
MIDDLE = Grid(UTM, 5.0, round(Y / 5) + 20, round(X / 5) + 20, 80, 80)
BOUNDS = transformer(UTM, WGS84).transform_bounds(*MIDDLE.bounds_m)


def pixels(path, values, nodata=None):
    return write_raster(path, np.float32(values), north_up(PIXEL_M, len(values)), nodata=nodata)


def halls(path):
    corners = [(x, SIDE_M - y - 40) for y in range(20, SIDE_M, 75) for x in range(20, SIDE_M, 75)]
    shapes = [shapely.box(X + x, Y + y, X + x + 40, Y + y + 40) for x, y in corners]
    return write_vector(path, shapes, height=[ROOF_M] * len(shapes))


SOURCES = {
    "outlines": lambda folder: halls(folder / "halls.gpkg"),
    "heights": lambda folder: pixels(folder / "heights.tif", np.where(IS_BUILT, ROOF_M, 0)),
    "surface": lambda folder: ju.Buildings(
        pixels(folder / "dsm.tif", PLANE_M + np.where(IS_BUILT, ROOF_M, 0)), kind="surface"
    ),
}


def city_of(source, **more):
    """Return a city and the names of its guesses but for those that every file without more gives."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        city = ju.City.from_files(source, **{"bounds": BOUNDS, "crs": UTM} | more)
    return city, " | ".join(name for name in by_name(city.guesses) if name != "flat ground")


@pytest.mark.slow
@pytest.mark.parametrize("source", SOURCES)
def test_ground_without_data_below_buildings_is_that_around_and_they_still_stand(tmp_path, source):
    terrain = pixels(tmp_path / "dtm.tif", np.where(IS_BUILT, -9999, PLANE_M), nodata=-9999)
    city, guesses = city_of(SOURCES[source](tmp_path), terrain=terrain)
    whole, silent = city_of(
        SOURCES[source](tmp_path), terrain=pixels(tmp_path / "all.tif", PLANE_M)
    )
    made, true = rasterise(city, MIDDLE), rasterise(whole, MIDDLE)
    assert made.has_data is None
    np.testing.assert_allclose(made.terrain_m, true.terrain_m, atol=1.0)  # 40 m of a slope of 6 %
    np.testing.assert_allclose(made.roof_m, true.roof_m, atol=1.0)
    share = 100 * rasterise(whole, MIDDLE).roof_m.astype(bool).mean()
    assert abs(int(guesses.removesuffix(" % of the terrain filled")) - share) < 3
    assert not silent


@pytest.mark.parametrize("source", SOURCES)
def test_terrain_without_any_elevation_in_the_region_is_named_and_no_building_is(tmp_path, source):
    terrain = pixels(tmp_path / "dtm.tif", np.full(ROW.shape, -9999), nodata=-9999)
    with pytest.raises(ju.InputError, match=r"the terrain .*dtm\.tif' holds no elevation"):
        city_of(SOURCES[source](tmp_path), terrain=terrain)


HILLS_M = 60 * np.sin(COL / 70) * np.cos(ROW / 90)


@pytest.mark.parametrize("source", ["outlines", "heights"])
@pytest.mark.parametrize("ground_m", [PLANE_M, HILLS_M, HILLS_M + np.where(IS_BUILT, -3, 0)])
def test_bare_ground_is_no_surface_model_on_hills_or_with_basements(tmp_path, source, ground_m):
    _, guesses = city_of(SOURCES[source](tmp_path), terrain=pixels(tmp_path / "dtm.tif", ground_m))
    assert not guesses


@pytest.mark.parametrize("source", ["outlines", "heights"])
@pytest.mark.parametrize(("pixel_m", "low", "high"), [(2, 95, 105), (30, 10, 80)])
def test_a_surface_model_as_terrain_is_cautioned_with_the_share_of_heights_in_it(
    tmp_path, source, pixel_m, low, high
):
    surface_m = HILLS_M + np.where(IS_BUILT, ROOF_M, 0)
    n = pixel_m // PIXEL_M
    means = surface_m.reshape(len(ROW) // n, n, -1, n).mean(axis=(1, 3))
    path = write_raster(tmp_path / "srtm.tif", np.float32(means), north_up(pixel_m, len(means)))
    _, guesses = city_of(SOURCES[source](tmp_path), terrain=path)
    assert low < int(guesses.removesuffix(" % of heights in the terrain")) < high


def layer_file(folder, values):
    return str(write_raster(folder / "layer.tif", np.float32(values), north_up(10, len(values))))


REGION = Grid(UTM, 10.0, round(Y / 10), round(X / 10), 20, 20)
QUIET = np.full((20, 20), 60.0)
UNKNOWN = np.arange(400).reshape(20, 20) < 100


@pytest.mark.parametrize(
    ("value", "cost", "scale"),
    [
        (-9999, "high-is-bad", (0.0, 80.0)),
        (-1, "high-is-bad", (0.0, 80.0)),
        (-32768, "high-is-bad", (-40.0, 80.0)),
        (1e20, "low-is-bad", (0.0, 80.0)),
    ],
)
@pytest.mark.parametrize("is_file", [True, False])
def test_a_number_that_stands_for_no_value_of_a_layer_is_refused_before_it_is_its_best(
    tmp_path, value, cost, scale, is_file
):
    values = np.where(UNKNOWN, value, QUIET)
    layer = ju.Layer(layer_file(tmp_path, values) if is_file else values, cost, scale)
    with pytest.raises(
        ju.InputError, match=rf"'noise' holds {re.escape(f'{value:g}')} in 2\d% .*nodata"
    ):
        bands_of({"noise": layer}, REGION, [60.0])


@pytest.mark.parametrize(
    ("values", "cost", "scale"),
    [
        (np.where(UNKNOWN, 0.0, QUIET), "high-is-bad", (50.0, 80.0)),  # quiet places of noise maps
        (np.linspace(0, 5000, 400).reshape(20, 20), "low-is-bad", (0.0, 50.0)),  # a distance
        (np.where(UNKNOWN, -9999, QUIET), "low-is-bad", (0.0, 80.0)),  # counts as the worst
        (np.linspace(-30, 80, 400).reshape(20, 20), "high-is-bad", (0.0, 80.0)),
        (np.where(UNKNOWN, np.nan, QUIET), "high-is-bad", (0.0, 80.0)),
    ],
)
def test_values_beyond_a_scale_that_may_be_meant_are_cut_as_ever(values, cost, scale):
    bands = bands_of({"noise": ju.Layer(values, cost, scale)}, REGION, [60.0])
    np.testing.assert_array_equal(bands["noise"][0], values.astype(np.float32))


@pytest.mark.parametrize("per_km2", [5_000, 90_000])
def test_people_per_km2_as_counts_are_refused_with_their_number_and_counts_are_not(
    tmp_path, per_km2
):
    """Pixels of a hectare hold a hundredth of the people of a km2."""
    density = np.full((12, 12), per_km2)
    counts = write_raster(tmp_path / "counts.tif", density / 100, north_up(100, 12))
    blocks, _ = read_blocks(ju.Population(blocks=counts), UTM)
    assert blocks.night_count.sum() == pytest.approx(per_km2 * 1.44)
    path = write_raster(tmp_path / "density.tif", density, north_up(100, 12))
    with pytest.raises(ju.InputError, match=f"are {100 * per_km2:,} per km2"):
        read_blocks(ju.Population(blocks=path), UTM)


def test_a_few_towers_may_hold_more_people_per_km2_than_any_quarter(tmp_path):
    path = write_raster(tmp_path / "a.tif", np.full((5, 5), 5000.0), north_up(100, 5))
    assert len(read_blocks(ju.Population(blocks=path), UTM)[0]) == 25


@pytest.mark.parametrize(
    ("pixel_m", "factor", "expected"),
    [
        (10, 1, ""),
        (90, 1, "heights averaged over pixels"),
        (10, 10, "the unit of heights"),
        (90, 10, "heights averaged over pixels | the unit of heights"),
    ],
)
def test_averages_and_decimetres_of_a_raster_are_cautioned(tmp_path, pixel_m, factor, expected):
    heights = np.random.default_rng(0).choice([0.0, 4.0, 9.0, 15.0, 24.0], (40, 40)) * factor
    path = write_raster(tmp_path / "a.tif", np.float32(heights), north_up(pixel_m, 40))
    city, guesses = city_of(path)
    assert guesses == expected
    assert all(
        f" {pixel_m} m wide" in text for name, text in by_name(city.guesses).items() if "av" in name
    )


@pytest.mark.parametrize(
    "name", ["GHS_BUILT_H_AGBH_E2018", "WSF3D_V02_BuildingHeight", "open_buildings_2.5d_temporal"]
)
def test_heights_of_a_raster_that_a_model_made_are_cautioned(tmp_path, name):
    city, guesses = city_of(pixels(tmp_path / f"{name}.tif", np.where(IS_BUILT, ROOF_M, 0)))
    assert guesses == "heights estimated by a model"
    assert "may be far too low" in by_name(city.guesses)[guesses]


def test_where_the_nodata_value_of_heights_is_0_nothing_stands(tmp_path):
    heights = np.where(IS_BUILT, ROOF_M, 0)
    masked, guesses = city_of(pixels(tmp_path / "masked.tif", heights, nodata=0))
    plain, silent = city_of(pixels(tmp_path / "plain.tif", heights))
    np.testing.assert_array_equal(masked.roofs.values, plain.roofs.values)
    assert masked.known_area.equals(plain.known_area)
    assert guesses == f"{100 * (1 - IS_BUILT.mean()):.0f} % of heights by the nodata value 0"
    assert not silent
    holes = np.where(IS_BUILT, ROOF_M + 10 * (ROW % 150 < 75), -1)
    with pytest.raises(ju.InputError, match="also in streets that hold no data"):
        city_of(pixels(tmp_path / "holes.tif", holes, nodata=-1))


@pytest.mark.parametrize("height_m", [828.0, 900.0])
def test_a_roof_above_the_highest_of_the_world_is_named_with_its_place(tmp_path, height_m):
    lon, lat = transformer(UTM, WGS84).transform(X + 300, Y + 300)
    shapes = [shapely.box(lon, lat, lon + 1e-4, lat + 1e-4)]
    path = write_features(tmp_path / "a.geojson", (shapes[0], {"height": height_m}))
    city, guesses = city_of(path)
    assert guesses == ("1 roof above 828 m" if height_m > 828 else "")
    assert all(
        f"{height_m:g} m at {lon:.5f}, {lat:.5f}" in by_name(city.guesses)[name]
        for name in guesses.split(" | ")
        if name
    )
    raster = pixels(tmp_path / "a.tif", np.where(IS_BUILT, height_m, 0))
    if height_m > 828:
        with pytest.raises(ju.InputError, match=r"holds \d+ cells outside -100 to 828 m"):
            city_of(raster)


def in_crs(folder, name, crs, x, y):
    """Write a house or a raster of one at a place in a CRS."""
    if name.endswith(".tif"):
        return write_raster(
            folder / name, np.eye(9, dtype=np.float32), Affine(9, 0, x, 0, -9, y), crs
        )
    return write_vector(folder / name, [shapely.box(x, y, x + 9, y + 9)], crs, height=[9.0])


@pytest.mark.parametrize("name", ["a.gpkg", "a.tif"])
@pytest.mark.parametrize(
    ("declared", "x", "y"),
    [
        ("EPSG:25832", 2_600_000, 1_200_000),  # Bern in Swiss LV95
        ("EPSG:25832", 3_565_000, 5_934_000),  # Hamburg in Gauss and Krueger's third zone
        ("EPSG:32618", -8_235_000, 4_970_000),  # New York in Web Mercator
        ("EPSG:28992", -1_500_000, 1_500_000),
    ],
)
def test_a_place_far_from_the_area_of_its_crs_is_refused_with_both(tmp_path, name, declared, x, y):
    with pytest.raises(
        ju.InputError, match=r"declares the CRS '.*' and so lies at .* \(lon, lat\)"
    ):
        ju.City.from_files(in_crs(tmp_path, name, declared, x, y))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("declared", "lon", "lat"),
    [
        ("EPSG:25833", 5.3, 60.4),  # Bergen, as all of Norway
        ("EPSG:25833", 30.0, 69.7),  # Kirkenes
        ("EPSG:31467", 14.9, 51.1),  # Goerlitz in the zone for all of Germany
        ("EPSG:3460", 179.9, -16.8),  # Fiji's map grid, whose area holds the antimeridian
        ("EPSG:3460", -179.5, -16.8),
        ("EPSG:27700", -0.1, 51.5),
        ("EPSG:3035", 13.4, 52.5),
        ("EPSG:2193", 174.8, -36.8),  # New Zealand's
    ],
)
def test_a_crs_may_be_used_beyond_its_zone_where_a_country_does(tmp_path, declared, lon, lat):
    x, y = transformer(WGS84, declared).transform(lon, lat)
    path = in_crs(tmp_path, "a.gpkg", declared, x, y)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ju.GuessWarning)
        assert len(ju.City.from_files(path).buildings) == 1


def houses_at_180(folder, crs):
    places = [179.9995, -179.9996, -179.9986]
    shapes = [shapely.box(lon, -16.8, lon + 2e-4, -16.7997) for lon in places]
    return write_vector(folder / "fiji.gpkg", shapes, WGS84, to=crs, height=[20.0] * 3)


@pytest.mark.parametrize("crs", [WGS84, "EPSG:32760"])
def test_houses_on_both_sides_of_the_antimeridian_are_named_and_read_from_one(tmp_path, crs):
    path = houses_at_180(tmp_path, crs)
    with pytest.raises(ju.InputError, match=r"fiji\.gpkg.*both sides of the antimeridian"):
        ju.City.from_files(path)
    with pytest.raises(ju.InputError, match="reach across the antimeridian"):
        ju.City.from_files(path, bounds=(179.99, -16.81, -179.99, -16.79))
    for bounds in ((179.99, -16.81, 180, -16.79), (-180, -16.81, -179.99, -16.79)):
        city, _ = city_of(path, bounds=bounds, crs=None)
        assert len(city.buildings) == 3
        assert np.ptp(shapely.bounds(city.buildings.polygons)[:, 0]) < 250  # metres


LOW = np.linspace(4, 40, 25)  # heights of houses


def houses(path, heights, **columns):
    shapes = [
        box(60 * (i // 5), 60 * (i % 5), 60 * (i // 5) + 12, 60 * (i % 5) + 12) for i in range(25)
    ]
    return write_vector(path, shapes[: len(heights)], height=list(heights), **columns)


def towns(folder, heights):
    """Return houses of these heights by outlines, in OpenStreetMap, by solids and in a raster."""
    outlines = houses(folder / "a.gpkg", heights)
    lonlat = gpd.read_file(outlines).to_crs(WGS84).geometry
    ways = [
        line(number, list(shape.exterior.coords), building="yes", height=f"{height:.1f}")
        for number, (shape, height) in enumerate(zip(lonlat, heights, strict=True), 1)
    ]
    (folder / "a.osm").write_text(osm(*ways))
    values = np.zeros((30, 30), np.float32)
    for i, height in enumerate(heights):
        row, col = 27 - 6 * (i % 5), 6 * (i // 5)
        values[row : row + 3, col : col + 3] = height
    raster = write_raster(folder / "a.tif", values)
    return outlines, folder / "a.osm", raster


def ground(folder, level_m):
    return write_raster(folder / "dtm.tif", np.full((60, 60), level_m, np.float32))


@pytest.mark.slow
@pytest.mark.parametrize("kind", range(3))
@pytest.mark.parametrize(
    ("base_m", "level_m", "is_refused"),
    [
        (0, None, False),
        (0, 30, False),
        (0, 1600, False),
        (0, -3, False),
        (500, None, True),
        (500, 500, True),
        (40, 40, True),
        (20, 20, False),  # as houses may be
    ],
)
def test_elevations_are_not_heights_in_any_format(tmp_path, kind, base_m, level_m, is_refused):
    source = towns(tmp_path, base_m + LOW)[kind]
    more = {"terrain": ground(tmp_path, level_m)} if level_m is not None else {}
    bounds = transformer(UTM, WGS84).transform_bounds(X - 30, Y - 30, X + 330, Y + 330)
    if not is_refused:
        city_of(source, bounds=bounds, **more)
        return
    with pytest.raises(ju.InputError, match=r"elevations above the sea .*ground_column"):
        city_of(source, bounds=bounds, **more)
    city_of(ju.Buildings(source, allow=("high",)), bounds=bounds, **more)


@pytest.mark.parametrize(
    ("heights", "is_refused"),
    [
        (np.linspace(62, 400, 25), True),  # towers alone: allow says so
        ([*np.linspace(62, 400, 24), 8.0], False),
        (1600 + LOW, True),  # above all buildings of the Earth, and so unreadable
        (np.full(19, 510.0), False),
        (np.full(20, 510.0), True),
        ([f"{height:.1f} m" for height in 500 + LOW], True),
        ([510.0] * 22 + [None] * 3, True),
        ([90.0] * 2 + [None] * 23, False),  # of a town whose towers alone have heights
    ],
)
def test_without_terrain_twenty_heights_of_which_none_is_below_60_m_are_refused(
    tmp_path, heights, is_refused
):
    path = houses(tmp_path / "a.gpkg", heights)
    if is_refused:
        with pytest.raises(ju.InputError, match=f"of {len([*filter(None, heights)])} hardly one"):
            city_of(path, bounds=None)
    else:
        city_of(path, bounds=None)


def test_a_column_of_the_ground_makes_heights_of_elevations(tmp_path):
    path = houses(tmp_path / "a.gpkg", 500 + LOW, ground=[500.0] * 25)
    columns = {"height_column": "height", "ground_column": "ground", "unit": "m"}
    city, _ = city_of(ju.Buildings(path, **columns), bounds=None)
    np.testing.assert_allclose(city.buildings.height_m, LOW)


BARE = np.random.default_rng(4).random((100, 100)) < 0.4
FOREST = np.where(BARE, 0, np.random.default_rng(5).normal(20, 6, BARE.shape).clip(3, 40))
REDWOODS = np.where(BARE, 0, np.random.default_rng(6).normal(65, 20, BARE.shape).clip(3, 116))
EVENLY = np.where(BARE, 0, np.random.default_rng(7).integers(1, 101, BARE.shape))


def coded(values, code, share=0.1):
    return np.where(np.random.default_rng(8).random(values.shape) < share, code, values)


def canopy(folder, values, **more):
    path = write_raster(folder / "chm.tif", values, north_up(4, 100, X - 30, Y - 30), **more)
    bounds = transformer(UTM, WGS84).transform_bounds(X, Y, X + 300, Y + 300)
    return city_of(houses(folder / "a.gpkg", LOW), bounds=bounds, vegetation=path)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (coded(FOREST.round(), 101), "101 in"),  # of GLAD
        (coded(FOREST.round(), 103, 0.001), "103 in"),
        (coded(FOREST.round(), 255), "255 in"),
        (coded(FOREST, -99), "-99 in"),
        (EVENLY, "100 in"),  # per cent
        (np.where(BARE, 0, 78), "78 in"),
        (np.where(BARE, 0, (1.2 * EVENLY).clip(0, 100)), "100 in"),
        (np.where(BARE, 0, (EVENLY / 80).clip(0, 1)), "1 in"),  # shares
        (~BARE, "1 in"),  # a mask
        ((10 * FOREST).round(), "400 in"),  # decimetres
        (np.where(BARE, 0, EVENLY % 60 + 31), "90 in"),
        (np.where(coded(BARE, False), 0, 110), "110 in"),
    ],
)
def test_a_raster_of_plants_that_holds_no_metres_is_refused_with_its_value(tmp_path, values, said):
    with pytest.raises(
        ju.InputError, match=rf"heights of plants in metres, .* as {said} [\d,]+ cells"
    ):
        canopy(tmp_path, values.astype(np.float32))


@pytest.mark.parametrize(
    ("values", "more"),
    [
        (FOREST, {}),
        (FOREST.round(), {}),
        (FOREST * 0, {}),
        (FOREST + np.random.default_rng(9).normal(0, 0.3, BARE.shape), {}),
        (REDWOODS, {}),
        (REDWOODS * 0.8, {}),
        (REDWOODS.round(), {}),
        (REDWOODS.round().clip(0, 95), {"units": "m"}),
        ((10 * FOREST).round(), {"scales": 0.1}),
        (FOREST / 0.3048, {"units": "ft"}),
        (FOREST + 5, {"units": "m"}),  # without a gap
    ],
)
def test_a_canopy_model_of_metres_opens_whatever_grows_there(tmp_path, values, more):
    city, guesses = canopy(tmp_path, values.astype(np.float32), **more)
    assert not guesses
    assert city.vegetation.values.shape == BARE.shape


@pytest.mark.parametrize(
    ("values", "nodata", "is_known"),
    [
        (FOREST, -1.0, True),
        (np.where(BARE, -1, FOREST), -1.0, True),  # no data where nothing grows
        (FOREST, 0.0, True),
        (np.where(COL[:100, :100] < 100, FOREST, -1), -1.0, False),
        (np.full(BARE.shape, -1), -1.0, False),
    ],
)
def test_no_data_mean_that_nothing_grows_in_files_of_plants_alone(
    tmp_path, values, nodata, is_known
):
    city, guesses = canopy(tmp_path, values.astype(np.float32), nodata=nodata)
    assert np.isfinite(city.vegetation.values).all() == is_known
    assert ("of the region without known plants" in guesses) == (not is_known)
