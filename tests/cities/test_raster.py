"""Rasters: what is read, how values come onto a Grid, and surface models, known from heights and made into them."""

import warnings
from dataclasses import replace

import numpy as np
import pyproj
import pytest
import rasterio.warp
import shapely
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning

import jaxurban as ju
from jaxurban.cities import raster as raster_module
from jaxurban.cities.raster import (
    check_is_no_surface,
    heights_of_surface,
    raster_extent_m,
    read_raster,
)
from jaxurban.io.city import City
from jaxurban.io.sampling import heights_above, resample_raster
from jaxurban.world.grid import transformer
from jaxurban.world.raster import Raster
from tests.made_files import FEET, UTM, WGS84, X, Y, box, north_up, write_raster, write_vector

ELSEWHERE = "EPSG:32617"


def read(tmp_path, values, bounds_m=None, **how):
    return read_raster(write_raster(tmp_path / "a.tif", values, **how), UTM, bounds_m)


def grid(resolution_m, num_rows, num_cols, east_m=0.0, north_m=0.0):
    first_row, first_col = round((Y + north_m) / resolution_m), round((X + east_m) / resolution_m)
    return ju.Grid(UTM, resolution_m, first_row, first_col, num_rows, num_cols)


def raster(values, transform=None):
    values = np.asarray(values, np.float32)
    return Raster(values, tuple(transform or north_up(10, len(values)))[:6], UTM)


def turned_by(degrees, pixel_m, y_m):
    cos_m, sin_m = pixel_m * np.cos(np.radians(degrees)), pixel_m * np.sin(np.radians(degrees))
    return Affine(cos_m, -sin_m, X, -sin_m, -cos_m, y_m)


RAMP = np.arange(12, dtype=np.float32).reshape(3, 4)


def test_the_declared_nodata_value_is_nan_and_scale_and_offset_are_applied(tmp_path):
    found = read(tmp_path, np.array([[0, 15, -99]], np.int16), nodata=-99, scales=0.1, offsets=2.0)
    np.testing.assert_allclose(found.values, [[2.0, 3.5, np.nan]])
    np.testing.assert_array_equal(
        read(tmp_path, np.float32([[1, np.nan]]), nodata=np.nan).values, [[1, np.nan]]
    )


def test_only_the_window_around_the_bounds_is_read_and_a_fault_outside_it_is_no_matter(tmp_path):
    values = np.arange(400, dtype=np.float32).reshape(20, 20)
    values[0, 0] = np.nan
    found = read(tmp_path, values, (X + 81, Y + 111, X + 99, Y + 119))
    assert (found.values.dtype, found.transform, found.crs) == (
        np.float32,
        (10, 0, X, 0, -10, Y + 200),
        UTM,
    )
    assert (found.first_row, found.first_col) == (6, 6)  # two pixels more on each side
    np.testing.assert_array_equal(found.values, values[6:11, 6:12])


def test_companions_of_a_raster_are_read(tmp_path):
    """Its place from a world file, its CRS from a .prj, masked pixels from a .msk; overviews change nothing."""
    path, pixels = tmp_path / "a.tif", np.arange(1, 10, dtype=np.float32).reshape(3, 3)
    write_raster(path, pixels)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False, TIFF_USE_OVR=True),
        rasterio.open(path, "r+") as file,
    ):
        file.write_mask(np.uint8(255 * (pixels > 1)))
        file.build_overviews([2])
    assert {name.name for name in tmp_path.iterdir()} >= {"a.tif.msk", "a.tif.ovr"}
    np.testing.assert_array_equal(
        read_raster(path, UTM).values, np.where(pixels > 1, pixels, np.nan)
    )
    (tmp_path / "b.asc").write_text(
        f"ncols 3\nnrows 3\nxllcorner {X}\nyllcorner {Y}\ncellsize 10\n" + "1 2 3\n4 5 6\n7 8 9\n"
    )
    (tmp_path / "b.prj").write_text(pyproj.CRS(UTM).to_wkt("WKT1_ESRI"))
    found = read_raster(tmp_path / "b.asc", UTM)
    np.testing.assert_array_equal(found.values, pixels)
    with (
        pytest.warns(NotGeoreferencedWarning),
        rasterio.open(tmp_path / "c.tif", "w", "GTiff", 3, 3, 1, UTM, dtype="float32") as file,
    ):
        file.write(pixels, 1)
    (tmp_path / "c.tfw").write_text(f"10\n0\n0\n-10\n{X + 5}\n{Y + 25}\n")
    placed = read_raster(tmp_path / "c.tif", UTM)
    assert placed.transform == found.transform == (10, 0, X, 0, -10, Y + 30)


def test_the_extent_is_that_of_the_whole_file_in_the_citys_crs(tmp_path):
    path, sides = write_raster(tmp_path / "a.tif", RAMP), (X, Y, X + 40, Y + 30)
    assert raster_extent_m(path, UTM) == pytest.approx(sides)
    expected = pyproj.Transformer.from_crs(UTM, ELSEWHERE, always_xy=True).transform_bounds(*sides)
    assert raster_extent_m(path, ELSEWHERE) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    ("how", "pixels", "cells"),  # whose centres lie at 2, 6, 10 (the border), 14 and 18 m
    [
        ("nearest", [1, 2], [1, 1, 2, 2, 2]),
        ("bilinear", [0, 10], [0, 1, 5, 9, 10]),
        ("bilinear", [5, np.nan], [5, 5, np.nan, np.nan, np.nan]),  # no data have no weight
    ],
)
def test_a_cell_takes_the_pixel_that_holds_its_centre_or_what_lies_between_two(how, pixels, cells):
    np.testing.assert_array_equal(resample_raster(raster([pixels]), grid(4, 1, 5), how), [cells])


@pytest.mark.parametrize("how", ["nearest", "bilinear", "max"])
def test_beyond_the_raster_and_in_its_holes_there_is_no_data(how):
    values = resample_raster(raster([[1, np.nan, 3]]), grid(10, 3, 5, east_m=-10, north_m=-10), how)
    np.testing.assert_array_equal(
        np.isfinite(values), np.array([[0] * 5, [0, 1, 0, 1, 0], [0] * 5], bool)
    )


def test_values_follow_a_turned_raster_in_another_crs():
    """Truth: GDAL's warper, which is exact to an eighth of a pixel, on a smooth field."""
    col, row = np.meshgrid(np.arange(120), np.arange(120))
    turned = turned_by(29, 5, Y + 600)
    field = raster(20 + 10 * np.sin(col / 15) * np.cos(row / 15), turned)
    x_m, y_m = pyproj.Transformer.from_crs(UTM, ELSEWHERE, always_xy=True).transform(
        *(turned @ (60, 60))
    )
    on = ju.Grid(ELSEWHERE, 5.0, int(y_m // 5) - 20, int(x_m // 5) - 20, 40, 40)
    source = {
        "src_transform": turned,
        "src_crs": UTM,
        "resampling": rasterio.warp.Resampling.bilinear,
    }
    to = {"dst_transform": Affine(5, 0, on.x_min_m, 0, -5, on.y_max_m), "dst_crs": on.crs}
    expected = np.zeros(on.shape, np.float32)
    rasterio.warp.reproject(field.values, expected, **source, **to)
    np.testing.assert_allclose(resample_raster(field, on, "bilinear"), expected[::-1], atol=0.1)


@pytest.mark.parametrize("crs", [UTM, ELSEWHERE])
@pytest.mark.parametrize("how", ["nearest", "bilinear", "max"])
def test_a_sub_box_equals_the_crop_bit_for_bit(tmp_path, crs, how):
    transform = Affine(2.5020579, 0, X + 0.123, 0, -2.5024088, Y + 400.321)  # no round numbers
    path = write_raster(
        tmp_path / "a.tif", np.random.default_rng(2).random((160, 160), np.float32), transform
    )
    x_min, y_min, _, _ = raster_extent_m(path, crs)
    large = ju.Grid(crs, 5.0, int(y_min // 5) - 3, int(x_min // 5) - 3, 86, 86)
    small = ju.Grid(crs, 5.0, large.first_row + 31, large.first_col + 17, 20, 30)
    whole, part = (
        resample_raster(read_raster(path, crs, on.bounds_m), on, how) for on in (large, small)
    )
    np.testing.assert_array_equal(part, whole[small.window_in(large)])


@pytest.mark.parametrize(
    ("turn_deg", "pixel_m", "resolution_m"),
    [
        (0, 10, 4),
        (0, 10, 10),
        (0, 10, 25),
        (0, 4, 10),
        (0, 2.5, 10),
        (0, 5, 10),
        (7, 4, 10),
        (29, 4, 10),
        (45, 4, 10),
    ],
)
def test_max_misses_no_pixel_that_overlaps_a_cell_and_takes_no_other(
    turn_deg, pixel_m, resolution_m
):
    transform = turned_by(turn_deg, pixel_m, Y + 100)
    pixels = np.random.default_rng(3).random((40, 40), np.float32)
    on = grid(resolution_m, 6, 6, east_m=20, north_m=20)
    found = resample_raster(raster(pixels, transform), on, "max")
    col, row = np.meshgrid(np.arange(40), np.arange(40))
    corners = [transform @ (col + i, row + j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    shapes = shapely.polygons(np.array(corners).transpose(2, 3, 0, 1))
    for i, j in np.ndindex(6, 6):
        x_m, y_m = on.x_min_m + resolution_m * j, on.y_min_m + resolution_m * i
        cell = shapely.box(x_m, y_m, x_m + resolution_m, y_m + resolution_m)
        expected = pixels[shapely.area(shapely.intersection(shapes, cell)) > 1e-5].max(initial=-1.0)
        assert found[i, j] == expected or (expected == -1.0 and np.isnan(found[i, j]))


@pytest.mark.parametrize(
    ("how", "metres"),
    [
        ({}, 1.0),
        ({"units": "m"}, 1.0),
        ({"units": "ft"}, 0.3048),
        ({"units": "US survey foot"}, 1200 / 3937),
        ({"crs": "EPSG:32618+5703"}, 1.0),
        ({"crs": "EPSG:32618+8228"}, 0.3048),
        (FEET | {"crs": "EPSG:2263+6360"}, 1200 / 3937),  # on the ground and above it
        (FEET | {"units": "m"}, 1.0),  # on the ground alone
    ],
)
def test_the_unit_of_heights_is_that_of_the_band_or_of_a_vertical_axis(tmp_path, how, metres):
    found = read(tmp_path, RAMP, **how)
    np.testing.assert_allclose(found.values, RAMP * metres, rtol=1e-6)
    if "transform" not in how:
        np.testing.assert_allclose(
            resample_raster(found, grid(10, 3, 4)), RAMP[::-1] * metres, rtol=1e-6
        )


def test_heights_above_a_terrain_of_another_grid_are_those_of_the_surface():
    """A plane is exact between pixel centres, so a surface 12 m above it stands at 12 m."""

    def plane(transform, shape, above_m=0.0):
        x_m, y_m = transform @ np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
        return raster(100 + 0.1 * (x_m - X) - 0.05 * (y_m - Y) + above_m, transform)

    surface = plane(Affine(2, 0, X + 30, 0, -2, Y + 170), (60, 50), above_m=12.0)
    heights = heights_above(surface, plane(Affine(7, 0, X - 11, 0, -7, Y + 233), (40, 40)))
    assert heights.transform == surface.transform
    np.testing.assert_allclose(heights.values, 12.0, atol=1e-4)


SIDE_M = 600


def city_heights(built_share):
    """Blocks of 50 m of 20 m height with streets between them that leave a share of the ground open, and noise."""
    along = np.arange(SIDE_M) % 50 < 50 * np.sqrt(built_share)
    heights = np.where(along[:, None] & along, 20.0, 0.0)
    return raster(
        heights + np.random.default_rng(0).normal(0, 0.2, heights.shape), north_up(1, SIDE_M)
    )


def hills():
    row, col = np.mgrid[:95, :95]
    hill = 25 + 10 * np.sin(row / 25) * np.cos(col / 30)
    return raster(hill, Affine(7, 0, X - 20, 0, -7, Y + SIDE_M + 20))


def surface_on(terrain, heights):
    """Heights raised by a terrain of another grid."""
    return heights_above(heights, replace(terrain, values=-terrain.values))


@pytest.mark.parametrize("built_share", [0.1, 0.5, 0.85])
def test_a_surface_is_refused_with_the_share_seen_and_heights_are_taken_however_dense(built_share):
    check_is_no_surface("h.tif", city_heights(built_share), UTM)
    remedy = r'kind="surface".*ju\.Terrain\(source'
    with pytest.raises(
        ju.InputError, match=rf"'h\.tif' looks like a surface model.*\d+% of its blocks.*{remedy}"
    ):
        check_is_no_surface("'h.tif'", surface_on(hills(), city_heights(built_share)), UTM)


def test_open_fields_and_water_tell_nothing():
    check_is_no_surface("h.tif", raster(np.full((60, 60), 40.0)), UTM)


def test_a_surface_less_a_terrain_of_another_grid_gives_the_heights_back():
    heights = city_heights(0.5)
    with pytest.warns(UserWarning, match=r"trees, bridges and cranes.*as buildings.*2 m as ground"):
        found, issues = heights_of_surface("s.tif", surface_on(hills(), heights), hills(), UTM)
    np.testing.assert_allclose(
        found.values[heights.values > 10], heights.values[heights.values > 10], atol=1e-4
    )
    assert (found.values[heights.values < 2] == 0).all()  # noise on the ground is no building
    assert issues["cells_near_ground"] == np.sum(heights.values < 2)
    assert issues["cells_below_ground"] == pytest.approx(np.sum(heights.values < 0), abs=3)


def test_a_surface_needs_terrain_and_one_that_goes_with_it():
    surface = surface_on(hills(), heights := city_heights(0.5))
    with pytest.raises(ju.InputError, match=r"s\.tif.*ju\.Terrain\(source"):
        heights_of_surface("s.tif", surface, None, UTM)
    for other in (heights, replace(surface, values=surface.values + 34)):
        with pytest.raises(
            ju.InputError, match=r"s\.tif does not stand on the terrain .*\d+%.*datum.*leave out"
        ):
            heights_of_surface("s.tif", other, hills(), UTM)


@pytest.mark.data
@pytest.mark.slow
def test_gothenburgs_surface_is_refused_and_less_its_terrain_gives_a_city(data_dir):
    surface, terrain = (data_dir / "raster" / f"gothenburg_{kind}.tif" for kind in ("dsm", "dem"))
    options = {"bounds": (11.962, 57.7063, 11.9652, 57.708), "crs": "EPSG:3007"}
    for ground in (None, terrain):
        with pytest.raises(ju.InputError, match=r"gothenburg_dsm\.tif' looks like a surface model"):
            City.from_files(surface, terrain=ground, **options)
    with pytest.warns(UserWarning, match="trees"):
        city = City.from_files(ju.Buildings(surface, kind="surface"), terrain=terrain, **options)
    assert 0.4 < np.mean(city.roofs.values == 0) < 0.6
    assert city.roofs.values.max() == pytest.approx(52.4, abs=0.1)


def test_a_raster_read_in_strips_is_what_rasterio_reads_at_once(tmp_path, monkeypatch):
    values = np.random.default_rng(1).integers(-99, 900, (37, 23)).astype(np.int16)
    how = {"nodata": -99, "scales": 0.1, "offsets": 2.0}
    write_raster(tmp_path / "a.tif", values, **how)
    with rasterio.open(tmp_path / "a.tif") as file:
        expected = file.read(1, masked=True) * 0.1 + 2.0
    for pixels_at_once in (1, 50, 10**6):
        monkeypatch.setattr(raster_module, "STRIP_PIXELS", pixels_at_once)
        found = read_raster(tmp_path / "a.tif", UTM).values
        np.testing.assert_array_equal(found, expected.filled(np.nan).astype(np.float32))


def wide(path, num=40_000):
    """Write a raster of 40 x 40 km on pixels of a metre around the place, with a tree of 30 m there."""
    corner = Affine(1, 0, X - num / 2, 0, -1, Y + num / 2)
    profile = {"driver": "GTiff", "count": 1, "dtype": "uint8", "crs": UTM, "transform": corner}
    with rasterio.open(
        path, "w", height=num, width=num, sparse_ok=True, tiled=True, **profile
    ) as file:
        tree = np.full((1, 4, 4), 30, np.uint8)
        file.write(tree, window=rasterio.windows.Window(num // 2, num // 2 - 4, 4, 4))
    return path


def test_a_raster_that_memory_cannot_hold_is_refused_with_its_size_before_it_is_read(tmp_path):
    with pytest.raises(ju.InputError, match=r"40,000 x 40,000 pixels .* 1,073,741,824 .*gdalwarp"):
        read_raster(wide(tmp_path / "a.tif"), UTM)


def test_of_a_wide_canopy_model_only_what_is_near_the_region_is_read(tmp_path):
    houses = write_vector(tmp_path / "a.gpkg", [box(20, 20, 30, 30)], height=[9.0])
    bounds = transformer(UTM, WGS84).transform_bounds(X, Y, X + 250, Y + 220)
    canopy = wide(tmp_path / "a.tif")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        city = ju.City.from_files(houses, bounds=bounds, crs=UTM, vegetation=canopy)
    assert city.vegetation.values.size < 3000**2
    assert np.nanmax(city.vegetation.values) == 30
    assert np.sum(city.vegetation.values > 0) == 16
