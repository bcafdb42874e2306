"""Where files lie: bounds left out, extents in messages, `jaxurban info`."""

import json

import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.read.city import lonlat_extent
from jaxurban.maps.scenario import Scenario
from tests.cli.test_bad_input import rectangle, write_geojson
from tests.cli_runs import run

WEST, SOUTH, EAST, NORTH = -74.012, 40.706, -74.008, 40.709


@pytest.fixture
def town(tmp_path):
    """Write two buildings in opposite corners of a box."""
    path = tmp_path / "town.geojson"
    rings = [rectangle(WEST, SOUTH, WEST + 1e-3, SOUTH + 1e-3), rectangle(EAST - 1e-3, NORTH - 1e-3, EAST, NORTH)]
    write_geojson(path, *rings)
    return path


def test_bounds_left_out_are_those_of_the_file(town):
    assert lonlat_extent(town) == pytest.approx((WEST, SOUTH, EAST, NORTH), abs=1e-9)
    city = ju.City.from_files(town)
    assert city.bounds == pytest.approx((WEST, SOUTH, EAST, NORTH), abs=1e-9)
    scenario = Scenario.from_dict({"buildings": {"source": town.name}}, folder=town.parent)
    assert scenario.region.bounds == pytest.approx((WEST, SOUTH, EAST, NORTH), abs=1e-9)


def test_a_file_without_outlines_says_that_bounds_are_needed(tmp_path):
    write_geojson(tmp_path / "empty.geojson")
    with pytest.raises(InputError, match=r"holds no outline.*give bounds"):
        ju.City.from_files(tmp_path / "empty.geojson")


def test_bounds_elsewhere_name_the_extent_and_a_swap(town):
    with pytest.raises(InputError, match=r"it covers about -74\.012\d, 40\.706\d, -74\.008\d, 40\.709\d"):
        ju.City.from_files(town, bounds=(10.0, 50.0, 10.01, 50.01))
    with pytest.raises(InputError, match="look swapped"):
        ju.City.from_files(town, bounds=(41.881, -87.64, 41.882, -87.62))


def test_info_says_what_a_file_holds_and_where(town, capsys):
    code, out, err = run(capsys, "info", town, "--json")
    facts = json.loads(out)
    assert (code, err) == (0, "")
    assert shapely.box(*facts["bounds"]).equals_exact(shapely.box(WEST, SOUTH, EAST, NORTH), 1e-6)
    assert facts["buildings"] == "2"
    assert facts["heights by height"] == "2 (100.0%)"


@pytest.mark.parametrize("name", ["nothing", "nothing.tif", "nothing.osm.pbf", "nothing.geojson"])
def test_info_says_that_a_file_does_not_exist(tmp_path, capsys, name):
    code, _, err = run(capsys, "info", tmp_path / name)
    assert (code, f"{name}' does not exist: check the path" in err) == (2, True)


def test_info_says_what_a_folder_of_maps_holds(tmp_path, capsys):
    maps = ju.build_maps(ju.demo_city(500, 500), resolution_m=50, altitudes_m=[20.0])
    maps.save(tmp_path)
    code, out, _ = run(capsys, "info", tmp_path)
    assert code == 0
    assert "10 x 10 cells of 50 m" in out
    assert "gps, lidar, population, risk" in out
    assert run(capsys, "info", tmp_path / "nothing")[0] == 2
