"""Rasters: what is read, what is refused, and how values come onto a Grid."""

import socket

import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.shutil
import rasterio.warp
import shapely
from affine import Affine

from jaxurban.errors import InputError
from jaxurban.io.read.raster import raster_extent_m, read_raster
from jaxurban.io.read.sampling import heights_above, resample_raster
from jaxurban.world.city import Raster
from jaxurban.world.grid import Grid

UTM = "EPSG:32618"
X, Y = 583000.0, 4506000.0  # southwest corner


@pytest.fixture
def write(tmp_path):
    """Write values (row 0 in the north) as a GeoTIFF of 10 m cells, or on another transform."""

    def write_values(values, *, crs=UTM, transform=None, nodata=None, scale=1.0, offset=0.0, units=None):
        path = tmp_path / "heights.tif"
        bands = np.atleast_3d(np.asarray(values)).transpose(2, 0, 1)
        transform = transform or Affine(10, 0, X, 0, -10, Y + 10 * bands.shape[1])
        shape = {"count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
        with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, nodata=nodata, **shape) as target:
            target.write(bands)
            target.scales, target.offsets = [scale] * len(bands), [offset] * len(bands)
            if units:
                target.units = [units]
        return path

    return write_values


def grid(resolution_m, num_rows, num_cols, east_m=0.0, north_m=0.0, crs=UTM):
    first_row, first_col = round((Y + north_m) / resolution_m), round((X + east_m) / resolution_m)
    return Grid(crs, resolution_m, first_row, first_col, num_rows, num_cols)


def raster(values, transform=None, crs=UTM):
    values = np.asarray(values, np.float32)
    return Raster(values, tuple(transform or Affine(10, 0, X, 0, -10, Y + 10 * values.shape[0]))[:6], crs)


RAMP = np.arange(12, dtype=np.float32).reshape(3, 4)


def test_a_whole_file_comes_back_as_it_is(write):
    read = read_raster(write(RAMP), UTM)
    np.testing.assert_array_equal(read.values, RAMP)
    assert read.values.dtype == np.float32
    assert read.transform == (10, 0, X, 0, -10, Y + 30)
    assert read.crs == UTM


def test_the_declared_nodata_value_is_nan_and_scale_and_offset_are_applied(write):
    read = read_raster(write(np.array([[0, 15, -99]], np.int16), nodata=-99, scale=0.1, offset=2.0), UTM)
    np.testing.assert_allclose(read.values, [[2.0, 3.5, np.nan]])


def test_declared_nan_is_no_fault(write):
    read = read_raster(write(np.float32([[1, np.nan]]), nodata=np.nan), UTM)
    np.testing.assert_array_equal(read.values, [[1, np.nan]])


@pytest.mark.parametrize("nodata", [None, -9999.0])
def test_nan_that_is_not_declared_is_refused_with_their_number(write, nodata):
    path = write(np.float32([[1, np.nan, np.inf, 4]]), nodata=nodata)
    with pytest.raises(InputError, match=r"heights\.tif.* 2 cells that are NaN or infinite.*-a_nodata"):
        read_raster(path, UTM)


def test_an_undeclared_nodata_value_is_refused(write):
    with pytest.raises(InputError, match=r"heights\.tif.* 1 cells outside -500 to 9000 m.*-a_nodata"):
        read_raster(write(np.float32([[1, -9999]])), UTM)


def test_only_the_window_around_the_bounds_is_read(write):
    values = np.arange(400, dtype=np.float32).reshape(20, 20)
    read = read_raster(write(values), UTM, (X + 81, Y + 111, X + 99, Y + 119))
    assert (read.first_row, read.first_col) == (6, 6)  # two pixels more on each side
    np.testing.assert_array_equal(read.values, values[6:11, 6:12])


def test_a_fault_outside_the_window_is_no_matter(write):
    values = np.zeros((20, 20), np.float32)
    values[0, 0] = np.nan
    assert read_raster(write(values), UTM, (X + 81, Y + 11, X + 99, Y + 19)).values.max() == 0


def test_a_raster_that_does_not_reach_the_bounds_is_refused(write):
    with pytest.raises(InputError, match=r"heights\.tif.*does not reach the region"):
        read_raster(write(RAMP), UTM, (X + 9000, Y, X + 9100, Y + 100))


def test_a_raster_without_crs_or_place_is_refused(write):
    with pytest.raises(InputError, match="no CRS"):
        read_raster(write(RAMP, crs=None), UTM)


def test_a_raster_of_several_bands_is_refused(write):
    with pytest.raises(InputError, match="has 2 bands"):
        read_raster(write(np.dstack([RAMP, RAMP])), UTM)


@pytest.mark.parametrize("content", [b"", b"no raster at all", b"II*\x00"])
def test_a_file_of_another_kind_is_refused_by_name(tmp_path, content):
    path = tmp_path / "broken.tif"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"broken\.tif.*cannot be read as a raster"):
        read_raster(path, UTM)


def test_a_truncated_raster_is_refused_by_name(write):
    path = write(np.random.default_rng(0).random((200, 200)).astype(np.float32))
    path.write_bytes(path.read_bytes()[:80_000])
    with pytest.raises(InputError, match=r"heights\.tif.*cannot be read as a raster"):
        read_raster(path, UTM)


def test_the_extent_is_that_of_the_whole_file_in_the_citys_crs(write):
    path = write(RAMP)
    assert raster_extent_m(path, UTM) == pytest.approx((X, Y, X + 40, Y + 30))
    other = raster_extent_m(path, "EPSG:32617")
    expected = pyproj.Transformer.from_crs(UTM, "EPSG:32617", always_xy=True).transform_bounds(X, Y, X + 40, Y + 30)
    assert other == pytest.approx(expected, abs=0.01)


def test_row_0_is_in_the_south():
    np.testing.assert_array_equal(resample_raster(raster(RAMP), grid(10, 3, 4)), RAMP[::-1])


def test_nearest_takes_the_pixel_that_holds_the_centre():
    values = resample_raster(raster([[1, 2]]), grid(4, 1, 5))  # centres at 2, 6, 10 (the border), 14, 18 m
    np.testing.assert_array_equal(values, [[1, 1, 2, 2, 2]])


def test_beyond_the_raster_and_in_its_holes_there_is_no_data():
    for how in ("nearest", "bilinear", "max"):
        values = resample_raster(raster([[1, np.nan, 3]]), grid(10, 3, 5, east_m=-10, north_m=-10), how)
        np.testing.assert_array_equal(np.isfinite(values), np.array([[0] * 5, [0, 1, 0, 1, 0], [0] * 5], bool))


def test_bilinear_gives_a_plane_back():
    col, row = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    plane = raster(3.0 + 0.25 * col - 0.5 * row)
    on = grid(4, 60, 80, east_m=20, north_m=20)
    x_m, y_m = np.meshgrid(on.x_m, on.y_m)
    expected = 3.0 + 0.25 * (x_m - X) / 10 - 0.5 * (Y + 300 - y_m) / 10
    np.testing.assert_allclose(resample_raster(plane, on, "bilinear"), expected, atol=1e-5)


def test_bilinear_leaves_pixels_without_data_out_of_the_weights():
    values = resample_raster(raster([[5, np.nan]]), grid(4, 1, 5), "bilinear")
    np.testing.assert_array_equal(values, [[5, 5, np.nan, np.nan, np.nan]])


@pytest.mark.parametrize("resolution_m", [4.0, 10.0, 25.0])
def test_max_is_the_highest_of_all_pixels_that_a_cell_touches(resolution_m):
    pixels = np.random.default_rng(1).random((20, 20)).astype(np.float32)
    on = grid(resolution_m, 8, 8)
    values = resample_raster(raster(pixels), on, "max")
    for row in range(8):
        for col in range(8):
            south_m, west_m = on.y_min_m + row * resolution_m - Y, on.x_min_m + col * resolution_m - X
            rows = slice(int(south_m // 10), int(np.ceil((south_m + resolution_m) / 10)))
            cols = slice(int(west_m // 10), int(np.ceil((west_m + resolution_m) / 10)))
            assert values[row, col] == pixels[::-1][rows, cols].max()


def test_values_follow_a_turned_raster_in_another_crs():
    """Truth: GDAL's warper, which is exact to an eighth of a pixel, on a smooth field."""
    col, row = np.meshgrid(np.arange(120), np.arange(120))
    cos_m, sin_m = 5 * np.cos(np.radians(29)), 5 * np.sin(np.radians(29))
    turned = Affine(cos_m, -sin_m, X, -sin_m, -cos_m, Y + 600)
    field = raster(20 + 10 * np.sin(col / 15) * np.cos(row / 15), turned)
    to_other = pyproj.Transformer.from_crs(UTM, "EPSG:32617", always_xy=True)
    x_m, y_m = to_other.transform(X + 60 * (cos_m - sin_m), Y + 600 - 60 * (cos_m + sin_m))
    on = Grid("EPSG:32617", 5.0, int(y_m // 5) - 20, int(x_m // 5) - 20, 40, 40)
    expected = np.zeros(on.shape, np.float32)
    rasterio.warp.reproject(
        field.values,
        expected,
        src_transform=turned,
        src_crs=UTM,
        dst_transform=Affine(5, 0, on.x_min_m, 0, -5, on.y_max_m),
        dst_crs=on.crs,
        resampling=rasterio.warp.Resampling.bilinear,
    )
    np.testing.assert_allclose(resample_raster(field, on, "bilinear"), expected[::-1], atol=0.1)


@pytest.mark.parametrize("crs", [UTM, "EPSG:32617"])
@pytest.mark.parametrize("how", ["nearest", "bilinear", "max"])
def test_a_sub_box_equals_the_crop_bit_for_bit(write, crs, how):
    transform = Affine(2.5020579, 0, X + 0.123, 0, -2.5024088, Y + 400.321)  # no round numbers
    path = write(np.random.default_rng(2).random((160, 160)).astype(np.float32), transform=transform)
    x_min, y_min, _, _ = raster_extent_m(path, crs)
    large = Grid(crs, 5.0, int(y_min // 5) - 3, int(x_min // 5) - 3, 86, 86)
    small = Grid(crs, 5.0, large.first_row + 31, large.first_col + 17, 20, 30)
    whole = resample_raster(read_raster(path, crs, large.bounds_m), large, how)
    part = resample_raster(read_raster(path, crs, small.bounds_m), small, how)
    np.testing.assert_array_equal(part, whole[small.window_in(large)])


@pytest.mark.data
def test_bilbaos_heights_and_terrain_are_as_its_readme_says(data_dir):
    heights = read_raster(data_dir / "raster" / "bilbao_building_heights.tif", "EPSG:25830").values
    terrain = read_raster(data_dir / "raster" / "bilbao_dem.tif", "EPSG:25830").values
    assert (heights.min(), heights.max()) == (0, 52)
    assert (terrain.min(), terrain.max()) == (-2, 103)


@pytest.mark.parametrize("turn_deg", [0.0, 7.0, 29.0, 45.0])
def test_max_misses_no_pixel_that_overlaps_a_turned_cell_and_takes_no_other(turn_deg):
    cos_m, sin_m = 4 * np.cos(np.radians(turn_deg)), 4 * np.sin(np.radians(turn_deg))
    transform = Affine(cos_m, -sin_m, X, -sin_m, -cos_m, Y + 100)
    pixels = np.random.default_rng(3).random((40, 40)).astype(np.float32)
    on = grid(10.0, 6, 6, east_m=20, north_m=20)
    found = resample_raster(raster(pixels, transform), on, "max")
    col, row = np.meshgrid(np.arange(40), np.arange(40))
    a, b, c, d, e, f = tuple(transform)[:6]
    corners = [(col + i, row + j) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    shapes = shapely.polygons(
        np.stack([[a * u + b * v + c, d * u + e * v + f] for u, v in corners]).transpose(2, 3, 0, 1)
    )
    for i in range(6):
        for j in range(6):
            x_m, y_m = on.x_min_m + 10 * j, on.y_min_m + 10 * i
            shared_m2 = shapely.area(shapely.intersection(shapes, shapely.box(x_m, y_m, x_m + 10, y_m + 10)))
            expected = pixels[shared_m2 > 1e-5].max(initial=-1.0)
            assert found[i, j] == expected or (expected == -1.0 and np.isnan(found[i, j]))


@pytest.mark.parametrize("pixel_m", [2.5, 5.0])  # 4 and 2 to a cell's side
@pytest.mark.parametrize("offset_m", [0.0, 2.5, 5.0])
def test_a_block_stays_where_it_is_at_even_ratios(pixel_m, offset_m):
    """A building that mirrors itself gives a map that does, and its middle stays."""
    size = round(200 / pixel_m)
    pixels = np.zeros((size, size), np.float32)
    low, high = round((60 + offset_m) // pixel_m), round((140 - offset_m) // pixel_m)
    pixels[low:high, low:high] = 30.0
    values = resample_raster(raster(pixels, Affine(pixel_m, 0, X, 0, -pixel_m, Y + 200)), grid(10.0, 20, 20))
    np.testing.assert_array_equal(values, values[::-1, ::-1])
    assert values.max() == 30.0


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("ft", 0.3048), ("US survey foot", 1200 / 3937), (None, 1.0)])
def test_the_bands_unit_is_honoured(write, unit, metres):
    np.testing.assert_allclose(read_raster(write(RAMP, units=unit), UTM).values, RAMP * metres, rtol=1e-6)


@pytest.mark.parametrize(("crs", "metres"), [("EPSG:32618+5703", 1.0), ("EPSG:32618+8228", 0.3048)])
def test_the_unit_of_a_vertical_axis_is_honoured(write, crs, metres):
    read = read_raster(write(RAMP, crs=crs), UTM)
    np.testing.assert_allclose(read.values, RAMP * metres, rtol=1e-6)
    np.testing.assert_allclose(resample_raster(read, grid(10, 3, 4)), RAMP[::-1] * metres, rtol=1e-6)


def test_survey_feet_on_the_ground_and_above_it_are_honoured_and_guessed_nowhere(write):
    """New York's state plane: in feet on the ground, which says nothing of heights."""
    place = Affine(10, 0, 980_000, 0, -10, 200_000)
    read = read_raster(write(RAMP, crs="EPSG:2263+6360", transform=place), UTM)
    np.testing.assert_allclose(read.values, RAMP * 1200 / 3937, rtol=1e-6)
    with pytest.raises(InputError, match=r"does not say plainly.*US survey foot.*gdal_edit\.py -units m"):
        read_raster(write(RAMP, crs="EPSG:2263", transform=place), UTM)
    np.testing.assert_allclose(read_raster(write(RAMP, crs="EPSG:2263", transform=place, units="m"), UTM).values, RAMP)


def test_a_unit_that_is_none_or_contradicts_the_crs_is_refused(write):
    with pytest.raises(InputError, match=r"'furlong'.*-units m"):
        read_raster(write(RAMP, units="furlong"), UTM)


def test_heights_above_a_terrain_of_another_grid_are_those_of_the_surface():
    """A plane is exact between pixel centres, so a surface 12 m above it stands at 12 m."""

    def plane(transform, shape, above_m=0.0):
        col, row = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
        a, b, c, d, e, f = tuple(transform)[:6]
        x_m, y_m = a * col + b * row + c, d * col + e * row + f
        return raster(100 + 0.1 * (x_m - X) - 0.05 * (y_m - Y) + above_m, transform)

    surface = plane(Affine(2, 0, X + 30, 0, -2, Y + 170), (60, 50), above_m=12.0)
    terrain = plane(Affine(7, 0, X - 11, 0, -7, Y + 233), (40, 40))
    heights = heights_above(surface, terrain)
    assert heights.transform == surface.transform
    np.testing.assert_allclose(heights.values, 12.0, atol=1e-4)


@pytest.mark.parametrize("suffix", [".vrt", ".tif"])
def test_a_file_that_names_a_server_is_refused_before_a_request(tmp_path, suffix):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        path = tmp_path / f"mosaic{suffix}"
        path.write_text(
            '<VRTDataset rasterXSize="2" rasterYSize="2"><SRS>EPSG:32618</SRS><GeoTransform>0,1,0,0,0,-1'
            '</GeoTransform><VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename>/vsicurl/http:'
            f"//127.0.0.1:{server.getsockname()[1]}/a.tif</SourceFilename><SourceBand>1</SourceBand></SimpleSource>"
            "</VRTRasterBand></VRTDataset>"
        )
        with pytest.raises(InputError, match=r"mosaic\.(vrt.*are read: convert it|tif.*cannot be read)"):
            raster_extent_m(path, "EPSG:32618")
        with pytest.raises(TimeoutError):
            server.accept()
