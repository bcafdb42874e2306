"""Buildings from any file, chosen by its suffix, and where files lie: extents, bounds left out, `jaxurban info`."""

import json

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.read.city import lonlat_extent, read_buildings
from jaxurban.maps.scenario import Scenario
from jaxurban.settings import Buildings
from tests.cli_runs import run
from tests.io.made_files import SQUARE, UTM, WGS84, X, Y, box, write_features, write_raster, write_vector


@pytest.fixture
def street(tmp_path):
    """Write a house, and an outline of 40 m whose two parts stand east of each other."""
    shapes = [box(0, 0, 10, 10), box(100, 0, 140, 10), box(100, 0, 120, 10), box(120, 0, 140, 10)]
    kinds = {"building": ["yes", "yes", None, None], "building:part": [None, None, "yes", "yes"]}
    return write_vector(tmp_path / "street.gpkg", shapes, height=[1, 2, 3, 4], **kinds)


def test_bounds_limit_what_is_kept_but_not_which_parts_replace_outlines(street):
    def heights(*sides):
        return read_buildings(Buildings(street), UTM, bounds_m=box(*sides).bounds).buildings.height_m.tolist()

    whole = read_buildings(Buildings(street), UTM)
    east = read_buildings(Buildings(street), UTM, bounds_m=(X + 125, Y, X + 200, Y + 5))
    assert whole.buildings.height_m.tolist() == [1, 3, 4]
    assert east.buildings.height_m.tolist() == [4]
    assert heights(50, 0, 60, 5) == []
    assert heights(10, 10, 20, 20) == [1]  # it touches the bounds
    assert east.read_issues == whole.read_issues
    assert whole.area.bounds == pytest.approx((X, Y, X + 140, Y + 10))
    assert east.area.bounds == pytest.approx((X + 120, Y, X + 140, Y + 10))


def test_a_height_raster_gives_roofs(tmp_path):
    source = read_buildings(Buildings(write_raster(tmp_path / "roofs.TIF", np.float32([[-0.5, 12.0]]))), UTM)
    assert source.buildings is None
    np.testing.assert_array_equal(source.roofs.values, [[0, 12]])
    assert source.read_issues == {"cells_below_ground": 1}
    assert source.area.bounds == pytest.approx((X, Y, X + 20, Y + 10))


def test_a_crs_in_degrees_is_refused(street):
    with pytest.raises(InputError, match="EPSG:4326"):
        read_buildings(Buildings(street), "EPSG:4326")


def test_level_and_default_heights_are_settings(tmp_path):
    path = write_vector(tmp_path / "city.geojson", [SQUARE] * 2, WGS84, levels=["2", None])
    source = read_buildings(Buildings(path, default_height_m=6.0, level_height_m=4.0), UTM)
    assert source.buildings.height_m.tolist() == [8.0, 6.0]
    assert source.buildings.origin_counts() == {"levels": 1, "default": 1}


EXTENT = (-74.012, 40.706, -74.008, 40.709)


@pytest.fixture
def town(tmp_path):
    """Write two buildings in opposite corners of a box."""
    west, south, east, north = EXTENT
    corners = shapely.box(west, south, west + 1e-3, south + 1e-3), shapely.box(east - 1e-3, north - 1e-3, east, north)
    return write_features(tmp_path / "town.geojson", *((shape, {"height": "30"}) for shape in corners))


def test_bounds_left_out_are_those_of_the_file(town):
    scenario = Scenario.from_dict({"buildings": {"source": town.name}}, folder=town.parent)
    for bounds in (lonlat_extent(town), ju.City.from_files(town).bounds, scenario.region.bounds):
        assert bounds == pytest.approx(EXTENT, abs=1e-9)
    with pytest.raises(InputError, match=r"holds no outline.*give bounds"):
        ju.City.from_files(write_features(town.with_name("empty.geojson")))


def test_bounds_elsewhere_name_the_extent_and_a_swap(town):
    with pytest.raises(InputError, match=r"it covers about -74\.012\d, 40\.706\d, -74\.008\d, 40\.709\d"):
        ju.City.from_files(town, bounds=(10.0, 50.0, 10.01, 50.01))
    with pytest.raises(InputError, match="look swapped"):
        ju.City.from_files(town, bounds=(41.881, -87.64, 41.882, -87.62))


def test_info_says_what_a_file_or_a_folder_of_maps_holds_and_where(town, capsys):
    code, out, err = run(capsys, "info", town, "--json")
    facts = json.loads(out)
    assert (code, err) == (0, "")
    assert facts["bounds"] == pytest.approx(EXTENT, abs=1e-6)
    assert (facts["buildings"], facts["heights by height"]) == ("2", "2 (100.0%)")
    maps = ju.build_maps(ju.demo_city(500, 500), resolution_m=50, altitudes_m=[20.0])
    maps.save(town.with_name("maps"))
    code, out, _ = run(capsys, "info", town.with_name("maps"))
    assert (code, "10 x 10 cells of 50 m" in out, "gps, lidar, population, risk" in out) == (0, True, True)


@pytest.mark.parametrize("name", ["nothing", "nothing.tif", "nothing.osm.pbf", "nothing.geojson"])
def test_info_says_that_a_file_does_not_exist(tmp_path, capsys, name):
    code, _, err = run(capsys, "info", tmp_path / name)
    assert (code, f"{name}' does not exist: check the path" in err) == (2, True)
