"""The sample cities: small, at home everywhere, and equal to the files that they were made of."""

import doctest
import json

import numpy as np
import pytest
import rasterio
import shapely

import jaxurban as ju
from jaxurban.io.files import digest_of
from jaxurban.maps.run import load_city, run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.samples import cities, make
from jaxurban.samples.catalogue import SAMPLES, located

CITIES = sorted(SAMPLES)
CREDITS = {"lower-manhattan": "OpenStreetMap", "shinjuku": "PLATEAU"}
SMALL = {"lower-manhattan": [-74.012, 40.706, -74.008, 40.709], "shinjuku": [139.6900, 35.6880, 139.6940, 35.6910]}


@pytest.mark.parametrize("name", CITIES)
def test_a_sample_is_small_credited_and_comes_with_its_satellites(name):
    assert sum(file.stat().st_size for file in located(f"sample:{name}").parent.iterdir()) <= 2e6
    city = ju.sample_city(name)
    assert CREDITS[name] in city.attribution
    maps = ju.build_maps(city, SMALL[name], resolution_m=10.0, altitudes_m=[20.0])
    assert maps.times == city.gps.times
    assert not any("nominal" in guess for guess in maps.guesses)
    assert maps.ds.num_visible.max() > 4
    assert CREDITS[name] in maps.attribution


def test_the_example_of_sample_city_runs():
    assert doctest.testmod(cities) == (0, 3)


@pytest.mark.parametrize("name", CITIES)
def test_a_scenario_of_a_sample_holds_no_path_of_this_machine(name, tmp_path):
    region = {"bounds": SMALL[name], "resolution_m": 10.0, "altitudes_m": [20.0]}
    scenario = Scenario.from_dict({"region": region, "buildings": {"source": f"sample:{name}"}})
    text = scenario.to_toml()
    (tmp_path / "again.toml").write_text(text)
    assert Scenario.from_toml(tmp_path / "again.toml").to_toml() == text
    record = run_scenario(scenario, tmp_path / "maps", progress=False).record
    home = str(located(f"sample:{name}").parent)
    assert home not in text
    assert home not in json.dumps(record)
    assert {file["path"].split("/")[0] for file in record["inputs"].values()} == {f"sample:{name}"}
    assert record["inputs"]["orbits"]["path"] == f"sample:{name}/gps.tle"
    with rasterio.open(next((tmp_path / "maps").rglob("gps*.tif"))) as picture:
        assert CREDITS[name] in " ".join(picture.tags().values())


def test_a_scenario_of_a_sample_keeps_what_it_says_itself():
    settings = {
        "buildings": {"source": "sample:lower-manhattan"},
        "gps": {"start": "2020-04-27T00:00:00Z", "stop": "2020-04-27T01:00:00Z", "step_s": 3600},
        "population": {"time_of_day": "night"},
    }
    scenario = Scenario.from_dict(settings)
    assert len(scenario.gps.utc_times) == 2
    assert scenario.gps.orbits == ("sample:lower-manhattan/gps.tle",)
    assert scenario.population.times_of_day == ("night",)
    assert load_city(scenario).blocks is not None
    for source, hint in (("sample:lower-manhatan", "'lower-manhattan'"), ("sample:shinjuku/roofs.tif", "gps.tle")):
        for region in ({}, {"region": scenario.region.model_dump()}):
            with pytest.raises(ju.InputError, match=hint):
                load_city(Scenario.from_dict(settings | {"buildings": {"source": source}} | region))


@pytest.mark.data
def test_maps_of_lower_manhattan_are_those_of_its_sources(data_dir):
    census = ju.Population(
        blocks=data_dir / "census/tl_2010_36061_tabblock10.shp",
        table=data_dir / "census/DECENNIALSF12010.P1_nyc_blocks.csv",
        districts=data_dir / "districts/nyc_community_districts.geojson",
    )
    sample, osm = ju.sample_city("lower-manhattan"), data_dir / "osm/lower-manhattan.osm.pbf"
    city = ju.City.from_files(osm, bounds=sample.bounds, population=census)
    assert shapely.equals(sample.known_area, city.known_area)
    assert len(sample.buildings) == len(city.buildings)
    orbits = data_dir / "gps/gps-ops_2020-04-27.tle"
    gps = ju.Gps(orbits=orbits, times=sample.gps.times, reference=(-74.0, 40.715))
    for bounds in (SMALL["lower-manhattan"], (-73.990, 40.722, -73.984, 40.726)):
        ours, theirs = (ju.build_maps(each, bounds, altitudes_m=[20.0, 60.0], gps=gps).ds for each in (sample, city))
        for name in ("obstacle", "roof", "gps", "num_visible", "lidar", "risk", "population"):
            np.testing.assert_array_equal(ours[name].values, theirs[name].values, err_msg=name)
    blocks = [each.blocks.take(each.blocks.touches(sample.known_area.bounds)) for each in (sample, city)]
    ours, theirs = (
        dict(zip(each.block_id, zip(each.night_count, each.district, strict=True), strict=True)) for each in blocks
    )
    assert ours == theirs
    assert sum(count for count, _ in ours.values()) > 200_000


@pytest.mark.data
@pytest.mark.slow
def test_the_script_makes_the_files_that_are_here(data_dir, tmp_path, monkeypatch):
    monkeypatch.setattr(make, "HERE", tmp_path)
    make.main([str(data_dir)])
    for name in CITIES:
        home = located(f"sample:{name}").parent
        assert sorted(path.name for path in home.iterdir()) == sorted(path.name for path in (tmp_path / name).iterdir())
        for path in home.iterdir():
            assert digest_of(path) == digest_of(tmp_path / name / path.name), path.name
