"""The sample cities: small, at home everywhere, and equal to the files that they were made of."""

import doctest
import json
import math
from collections import Counter
from dataclasses import asdict
from datetime import date

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from skyfield.api import load

import jaxurban as ju
from benchmarks import make_samples as make
from benchmarks.make_samples import GALILEO
from jaxurban.cities import samples as cities
from jaxurban.io.files import digest_of, read_json
from jaxurban.io.nominal import GPS
from jaxurban.io.orbits import look_angles, read_orbits
from jaxurban.io.samples import SAMPLES, located, log_of, structures_of
from jaxurban.maps.run import load_city, run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.sources import scenario_of
from jaxurban.receivers.validation.logs import ReceiverLog, read_receiver_log
from jaxurban.world.grid import WGS84, transformer
from jaxurban.world.kinds import ALL_KINDS
from tests.guess_records import by_name
from tests.io.test_orbits import places_of, separation_deg

CITIES = sorted(SAMPLES)
CREDITS = {"lower-manhattan": "OpenStreetMap", "shinjuku": "PLATEAU", "nihonbashi": "PLATEAU"}
SATELLITES = {
    "lower-manhattan": "the GPS satellites are nominal ones at 2020-04-27T16:00:00Z",
    "shinjuku": "the GPS and GALILEO satellites are nominal ones at 2018-12-19T03:00:00Z",
    "nihonbashi": "the GPS and GALILEO satellites are nominal ones at 2023-06-22T01:10:00Z",
}
SMALL = {
    "lower-manhattan": [-74.012, 40.706, -74.008, 40.709],
    "shinjuku": [139.6900, 35.6880, 139.6940, 35.6910],
    "nihonbashi": [139.7640, 35.6770, 139.7670, 35.6790],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CITIES)
def test_a_sample_is_small_credited_and_comes_with_its_satellites(name):
    assert sum(file.stat().st_size for file in located(f"sample:{name}").parent.iterdir()) <= 2e6
    city = ju.sample_city(name)
    assert CREDITS[name] in city.attribution
    maps = ju.build_maps(city, SMALL[name], resolution_m=10.0, altitudes_m=[60.0])
    assert maps.times == city.gps.times
    assert SATELLITES[name] in by_name(maps.guesses)["nominal satellites"]
    assert maps.ds.num_visible.max() > 4
    assert CREDITS[name] in maps.attribution


@pytest.mark.parametrize(
    ("file", "day", "constellation", "turns", "days"),
    [
        ("lower-manhattan/gps.tle", date(2020, 4, 27), GPS, 2, 1),
        ("shinjuku/gps.tle", date(2018, 12, 19), GPS, 2, 1),
        ("shinjuku/galileo.tle", date(2018, 12, 19), GALILEO, 17, 10),
        ("nihonbashi/gps.tle", date(2023, 6, 22), GPS, 2, 1),
        ("nihonbashi/galileo.tle", date(2023, 6, 22), GALILEO, 17, 10),
    ],
)
def test_elements_are_those_that_the_package_makes_and_repeat_their_ground_track(
    file, day, constellation, turns, days, tmp_path
):
    make.write_nominal(tmp_path / "made.tle", day, constellation)
    assert located(f"sample:{file}").read_text() == (tmp_path / "made.tle").read_text()
    satellites = read_orbits(f"sample:{file}").satellites
    start = load.timescale(builtin=True).utc(day.year, day.month, day.day, 3)
    _, before = places_of(satellites, start)
    _, after = places_of(satellites, start + days * 86164.09 / 86400)
    assert separation_deg(before, after).max() < 0.05 * max(
        days, 4
    )  # Moon and Sun pull, and no one holds them
    for satellite in satellites:
        assert satellite.model.no_kozai * 1440 * days / math.tau == pytest.approx(
            turns * 86400 / 86164.09, rel=2e-3
        )


@pytest.mark.parametrize("name", CITIES)
def test_gps_of_a_sample_stands_as_nominal_satellites_do(name):
    times, place = SAMPLES[name]["gps"]["times"], SAMPLES[name]["region"]["bounds"][:2]
    ours, nominal = (
        look_angles(read_orbits(source), times, *place)
        for source in (f"sample:{name}/gps.tle", "nominal")
    )
    for field in ("azimuth_rad", "elevation_rad"):
        np.testing.assert_allclose(getattr(ours, field), getattr(nominal, field), atol=1e-5)


@pytest.mark.slow
def test_the_example_of_sample_city_runs():
    assert doctest.testmod(cities) == (0, 4)


def bits_of(buildings):
    """What stands, as bytes."""
    columns = buildings.height_m, buildings.min_height_m, buildings.origin, buildings.limit_m
    return shapely.to_wkb(buildings.polygons).tolist(), [column.tobytes() for column in columns]


@pytest.mark.slow
def test_lower_manhattan_brings_trees_and_wires_unless_buildings_alone_count():
    city = ju.sample_city("lower-manhattan")
    alone = ju.sample_city("lower-manhattan", kinds=["building"])
    num_by_kind = Counter(city.structures.kinds)
    few = {"crane": 9, "chimney": 5, "tank": 3, "mast": 1, "pole": 116, "wire": 36, "wood": 20}
    assert few.items() <= num_by_kind.items()
    assert num_by_kind["tree"] == 11_270  # of which 19 are rows
    assert "OpenStreetMap" in city.attribution
    assert set(alone.structures.kinds) == {"bridge"}  # of the file of buildings
    num = len(alone.buildings)
    is_known = ~alone.buildings.is_guessed  # guesses learn of the others too
    same = city.buildings.take(np.arange(num)).take(is_known)
    assert bits_of(same)[0] == bits_of(alone.buildings.take(is_known))[0]
    assert same.height_m.tolist() == alone.buildings.height_m[is_known].tolist()
    by_others = {"levels of a building": 3, "parking of lone things: multi-storey rooftop": 1}
    assert Counter(city.buildings.rules[num:]) == by_others  # which other keys name
    assert "structures" in city.sources
    assert "structures" not in alone.sources
    for name in ("shinjuku", "nihonbashi"):
        assert structures_of(f"sample:{name}", city.kinds) is None
    assert structures_of("sample:lower-manhattan/buildings.parquet", city.kinds) is None


@pytest.mark.slow
def test_a_run_records_what_else_stands(tmp_path):
    region = {"bounds": SMALL["lower-manhattan"], "resolution_m": 10.0, "altitudes_m": [20.0]}
    settings = {"region": region, "buildings": {"source": "sample:lower-manhattan"}}
    for name, more in (("all", {}), ("alone", {"obstacles": {"kinds": ["building"]}})):
        folder = tmp_path / name
        run_scenario(Scenario.from_dict(settings | more), folder, progress=False)
    record = read_json(tmp_path / "all/run.json")
    assert record["inputs"]["structures"]["path"] == "sample:lower-manhattan/structures.parquet"
    assert scenario_of(tmp_path / "all").kinds == ALL_KINDS

    record = read_json(tmp_path / "alone/run.json")
    assert "structures" not in record["inputs"]
    assert scenario_of(tmp_path / "alone").kinds == ("building",)


def drive_of(city: ju.City) -> tuple[ReceiverLog, shapely.LineString]:
    """Return the log of Nihonbashi and its track in the city's CRS."""
    log = read_receiver_log(log_of("sample:nihonbashi"))
    places = transformer(WGS84, city.crs).transform(log.epochs.lon_deg, log.epochs.lat_deg)
    return log, shapely.LineString(np.column_stack(places))


def test_nihonbashi_has_a_log_and_knows_roofs_nowhere_but_within_300_m_of_its_track():
    city = ju.sample_city("nihonbashi")
    log, track = drive_of(city)
    assert (len(log.epochs), len(log.satellites)) == (251, 11_235)
    assert "E18" not in set(log.satellites.satellite)  # unhealthy by its own message
    around = track.buffer(300.0)
    assert around.covers(city.known_area)
    assert city.known_area.area > 0.96 * around.area
    assert city.known_area.covers(track.buffer(255.0))
    assert log_of("sample:shinjuku") is None
    settings = Scenario.from_toml("sample:nihonbashi")
    assert (settings.region.resolution_m, settings.gps.mask_deg) == ((2.0,), 10.0)


@pytest.mark.slow
@pytest.mark.data
def test_nihonbashi_lacks_no_roof_of_its_source_where_it_knows(data_dir):
    city = ju.sample_city("nihonbashi")
    project = transformer(WGS84, city.crs)
    roofs = gpd.read_parquet(data_dir / "tokyo/tokyo-east-lod2.parquet").geometry.to_numpy()
    roofs = shapely.make_valid(shapely.transform(roofs, project.transform, interleaved=False))
    roofs = shapely.intersection(roofs[shapely.intersects(roofs, city.known_area)], city.known_area)
    ours = shapely.union_all(city.buildings.polygons)
    missed = shapely.difference(shapely.union_all(roofs), shapely.buffer(ours, 0.3))
    assert missed.area < 1e-5 * ours.area


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_scenario_of_a_sample_keeps_what_it_says_itself():
    settings = {
        "buildings": {"source": "sample:lower-manhattan"},
        "gps": {"times": ["2020-04-27T00:00:00Z", "2020-04-27T01:00:00Z"], "step_s": 3600},
        "population": {"time_of_day": "night"},
    }
    scenario = Scenario.from_dict(settings)
    assert len(scenario.gps.utc_times) == 2
    assert scenario.gps.orbits == ("sample:lower-manhattan/gps.tle",)
    assert scenario.population.times_of_day == ("night",)
    assert load_city(scenario).blocks is not None
    for source, hint in (
        ("sample:lower-manhatan", "'lower-manhattan'"),
        ("sample:shinjuku/roofs.tif", "gps.tle"),
    ):
        for region in ({}, {"region": asdict(scenario.region)}):
            with pytest.raises(ju.InputError, match=hint):
                load_city(Scenario.from_dict(settings | {"buildings": {"source": source}} | region))


def rows_of(standing):
    """What stands, in the order of nothing: kind, heights, bound, and shape to 0.1 mm."""
    shapes = shapely.normalize(shapely.set_precision(standing.polygons, 1e-4))
    columns = standing.kinds, standing.height_m, standing.min_height_m, standing.upper_m
    return list(zip(*columns, shapely.to_wkb(shapes), strict=True))


@pytest.mark.slow
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
    assert sorted(rows_of(sample.structures)) == sorted(rows_of(city.structures))
    ours, theirs = set(rows_of(sample.buildings)), set(rows_of(city.buildings))
    assert len(sample.buildings) == len(city.buildings)
    # Two houses are historic, which the file of buildings leaves out, as it does what heights do not follow from.
    assert sorted(row[3] for row in ours - theirs) == [25, 25]
    assert sorted(row[3] for row in theirs - ours) == [50, 50]
    orbits = data_dir / "gps/gps-ops_2020-04-27.tle"
    gps = ju.Gps(orbits=orbits, times=sample.gps.times, reference=(-74.0, 40.715))
    for bounds in (SMALL["lower-manhattan"], (-73.990, 40.722, -73.984, 40.726)):
        ours, theirs = (
            ju.build_maps(each, bounds, altitudes_m=[20.0, 60.0], gps=gps).ds
            for each in (sample, city)
        )
        assert ours.keys() == theirs.keys()
        for name in ("obstacle", "roof", "roof_kind", "roof_limit", "gps", "num_visible"):
            np.testing.assert_array_equal(ours[name].values, theirs[name].values, err_msg=name)
        for name in ("lidar", "risk", "population"):
            np.testing.assert_array_equal(ours[name].values, theirs[name].values, err_msg=name)
    blocks = [
        each.blocks.take(each.blocks.touches(sample.known_area.bounds)) for each in (sample, city)
    ]
    ours, theirs = (
        dict(zip(each.block_id, zip(each.night_count, each.district, strict=True), strict=True))
        for each in blocks
    )
    assert ours == theirs
    assert sum(count for count, _ in ours.values()) > 200_000


@pytest.mark.data
@pytest.mark.slow
def test_the_script_makes_the_files_that_are_here(data_dir, tmp_path, monkeypatch):
    monkeypatch.setattr(make, "HOME", tmp_path)
    make.main([str(data_dir)])
    for name in CITIES:
        home = located(f"sample:{name}").parent
        assert sorted(path.name for path in home.iterdir()) == sorted(
            path.name for path in (tmp_path / name).iterdir()
        )
        for path in home.iterdir():
            again = tmp_path / name / path.name
            if path.name == "buildings.parquet":  # in any order, and without what has no area
                ours, theirs = (gpd.read_parquet(file).to_wkb() for file in (path, again))
                ours = ours[shapely.area(shapely.from_wkb(ours["geometry"])) > 0]
                columns = ours.columns.to_list()[::-1]
                pd.testing.assert_frame_equal(
                    ours.sort_values(columns, ignore_index=True),
                    theirs.sort_values(columns, ignore_index=True),
                    check_like=True,
                )
            else:
                assert digest_of(path) == digest_of(again), path.name


@pytest.mark.slow
def test_maps_are_made_with_what_a_city_was_read_with_unless_they_are_given_others():
    bounds = (-74.012, 40.704, -74.0105, 40.705)
    real = ju.Gps(orbits="sample:shinjuku/galileo.tle", times="2018-12-19T03:00:00Z", mask_deg=20.0)
    night = ju.Population(time_of_day="night")
    file = ju.Buildings("sample:lower-manhattan", height_samples=2)
    city = ju.City.from_files(file, bounds=bounds, gps=real, population=night)

    def made(**given):
        return ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), progress=False, **given)

    maps = made()
    assert maps.ds.attrs["constellations"] == "galileo"
    assert maps.times_of_day == ("night",)  # of the sample's own census
    assert "gps_std" in maps.ds
    assert ju.sky(city, (-74.011, 40.7045), 60.0).table["system"].unique().tolist() == ["galileo"]
    others = made(gps=ju.Gps(), heights=ju.Heights(), population=ju.Population())
    assert others.ds.attrs["constellations"] == "gps"
    assert others.times_of_day == ("day", "night")
    assert "gps_std" not in others.ds
