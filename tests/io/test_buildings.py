"""Buildings from any file, chosen by its suffix."""

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine

from jaxurban.errors import InputError
from jaxurban.io.read.city import read_buildings
from jaxurban.settings import Buildings

UTM = "EPSG:32618"
X, Y = 583000.0, 4506000.0


@pytest.fixture
def street(tmp_path):
    """Write a house, and an outline of 40 m whose two parts stand east of each other."""
    path = tmp_path / "street.gpkg"
    boxes = [(0, 0, 10, 10), (100, 0, 140, 10), (100, 0, 120, 10), (120, 0, 140, 10)]
    gpd.GeoDataFrame(
        {"building": ["yes", "yes", None, None], "building:part": [None, None, "yes", "yes"], "height": [1, 2, 3, 4]},
        geometry=[shapely.box(X + a, Y + b, X + c, Y + d) for a, b, c, d in boxes],
        crs=UTM,
    ).to_file(path)
    return path


def write_raster(path, values):
    transform = Affine(10, 0, X, 0, -10, Y + 10 * len(values))
    shape = {"count": 1, "height": values.shape[0], "width": values.shape[1], "dtype": values.dtype}
    with rasterio.open(path, "w", driver="GTiff", crs=UTM, transform=transform, **shape) as target:
        target.write(values, 1)
    return path


def test_bounds_limit_what_is_kept_but_not_which_parts_replace_outlines(street):
    whole = read_buildings(Buildings(street), UTM)
    east = read_buildings(Buildings(street), UTM, bounds_m=(X + 125, Y, X + 200, Y + 5))
    assert whole.buildings.height_m.tolist() == [1, 3, 4]
    assert east.buildings.height_m.tolist() == [4]
    assert east.read_issues == whole.read_issues
    assert whole.area.bounds == pytest.approx((X, Y, X + 140, Y + 10))
    assert east.area.bounds == pytest.approx((X + 120, Y, X + 140, Y + 10))


def test_bounds_without_a_building_give_none(street):
    assert len(read_buildings(Buildings(street), UTM, bounds_m=(X + 50, Y, X + 60, Y + 5)).buildings) == 0


def test_a_building_that_touches_the_bounds_is_kept(street):
    assert len(read_buildings(Buildings(street), UTM, bounds_m=(X + 10, Y + 10, X + 20, Y + 20)).buildings) == 1


def test_a_height_raster_gives_roofs(tmp_path):
    source = read_buildings(Buildings(write_raster(tmp_path / "roofs.TIF", np.float32([[-0.5, 12.0]]))), UTM)
    assert source.buildings is None
    np.testing.assert_array_equal(source.roofs.values, [[0, 12]])
    assert source.read_issues == {"cells_below_ground": 1}
    assert source.area.bounds == pytest.approx((X, Y, X + 20, Y + 10))


@pytest.mark.parametrize("value", [np.nan, 1001.0, -9999.0])
def test_a_height_raster_with_a_value_that_is_no_height_is_refused(tmp_path, value):
    path = write_raster(tmp_path / "roofs.tif", np.float32([[1.0, value]]))
    with pytest.raises(InputError, match=r"roofs\.tif.* 1 cells"):
        read_buildings(Buildings(path), UTM)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path / "nowhere.osm.pbf", tmp_path):
        with pytest.raises(InputError, match="does not exist"):
            read_buildings(Buildings(path), UTM)


def test_an_unknown_suffix_is_refused_with_the_known_ones(tmp_path):
    path = tmp_path / "city.dwg"
    path.touch()
    with pytest.raises(InputError, match=r"city\.dwg.*'\.dwg'.*\.pbf.*\.gpkg.*\.tif"):
        read_buildings(Buildings(path), UTM)


@pytest.mark.parametrize("settings", [{"default_height_m": 0}, {"level_height_m": -3.0}, {"default_height_m": np.nan}])
def test_settings_that_are_no_heights_are_refused(street, settings):
    with pytest.raises(InputError, match=next(iter(settings))):
        read_buildings(Buildings(street, **settings), UTM)


def test_a_crs_in_degrees_is_refused(street):
    with pytest.raises(InputError, match="EPSG:4326"):
        read_buildings(Buildings(street), "EPSG:4326")


def test_level_and_default_heights_are_settings(tmp_path):
    path = tmp_path / "city.geojson"
    square = shapely.box(-74, 40.7, -73.999, 40.701)
    gpd.GeoDataFrame({"levels": ["2", None]}, geometry=[square] * 2, crs="EPSG:4326").to_file(path)
    source = read_buildings(Buildings(path, default_height_m=6.0, level_height_m=4.0), UTM)
    assert source.buildings.height_m.tolist() == [8.0, 6.0]
    assert source.buildings.origin_counts() == {"levels": 1, "default": 1}


@pytest.mark.data
def test_a_sub_box_of_a_real_city_holds_the_same_buildings(data_dir):
    path = data_dir / "osm" / "boston-back-bay.osm.pbf"
    bounds_m = (328500.0, 4690500.0, 329000.0, 4691000.0)
    whole = read_buildings(Buildings(path), "EPSG:32619")
    part = read_buildings(Buildings(path), "EPSG:32619", bounds_m=bounds_m)
    x_min, y_min, x_max, y_max = shapely.bounds(whole.buildings.polygons).T
    inside = (x_min <= bounds_m[2]) & (x_max >= bounds_m[0]) & (y_min <= bounds_m[3]) & (y_max >= bounds_m[1])
    assert 0 < inside.sum() < len(whole.buildings)
    assert shapely.equals_exact(part.buildings.polygons, whole.buildings.polygons[inside]).all()
    np.testing.assert_array_equal(part.buildings.height_m, whole.buildings.height_m[inside])
