"""The base map: what OpenStreetMap draws to orient by, kept in a folder of maps like its other files."""

import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.base_map import read_base_map
from jaxurban.cities.land_cover import read_land_cover
from jaxurban.io.files import digest_of
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.studies.montecarlo.study import land_cover_of
from jaxurban.world.grid import Grid, transformer
from tests.made_files import UTM, WGS84, line, osm

BOX_M = (583_000, 4_507_000, 584_000, 4_508_000)
SOHO = {
    "region": {
        "bounds": [-74.004, 40.720, -73.998, 40.724],
        "resolution_m": 20.0,
        "altitudes_m": [20.0],
    },
    "buildings": {"source": "sample:lower-manhattan"},
}
WAYS = (  # metres from the corner of the box
    ({"highway": "primary", "name": "Long Road"}, [(-500, 100), (500, 100)]),
    ({"highway": "primary", "name": "Long Road"}, [(500, 100), (1500, 100)]),
    ({"highway": "trunk_link"}, [(100, 200), (300, 200), (500, 200.3)]),
    ({"highway": "residential", "name": "Rue d’Été"}, [(100, 300), (400, 300)]),
    ({"highway": "footway"}, [(100, 400), (400, 400)]),
    ({"highway": "footway", "footway": "sidewalk"}, [(100, 410), (400, 410)]),
    ({"highway": "motorway", "tunnel": "yes"}, [(100, 500), (400, 500)]),
    ({"railway": "subway", "tunnel": "yes"}, [(100, 600), (400, 600)]),
    ({"railway": "subway"}, [(100, 700), (400, 700)]),
    ({"railway": "rail", "service": "yard"}, [(100, 710), (400, 710)]),
    (
        {"leisure": "park", "name": "Green"},
        [(600, 600), (800, 600), (800, 800), (600, 800), (600, 600)],
    ),
    ({"natural": "coastline"}, [(900, -50), (900, 1050)]),
    (
        {"place": "neighbourhood", "name": "an area, which is no point"},
        [(600, 300), (800, 300), (800, 400), (600, 300)],
    ),
    ({"highway": "residential", "name": "elsewhere"}, [(3000, 300), (3400, 300)]),
)


def base_map_of(tmp_path, *ways):
    to_degrees = transformer(UTM, WGS84).transform
    lines = [
        line(number, [to_degrees(BOX_M[0] + x_m, BOX_M[1] + y_m) for x_m, y_m in points], **tags)
        for number, (tags, points) in enumerate(ways, 1)
    ]
    lon, lat = to_degrees(BOX_M[0] + 700, BOX_M[1] + 350)
    place = f'<node id="999" lon="{lon}" lat="{lat}"><tag k="place" v="suburb"/><tag k="name" v="Here"/></node>'
    (tmp_path / "town.osm").write_text(osm(place, *lines))
    return read_base_map(tmp_path / "town.osm", UTM, BOX_M)


def test_streets_rails_water_parks_and_places_are_drawn_and_what_lies_in_tunnels_is_not(tmp_path):
    frame = base_map_of(tmp_path, *WAYS)
    assert frame.crs.to_epsg() == 4326
    assert sorted(zip(frame["kind"], frame["name"], strict=True)) == [
        ("major", ""),
        ("major", "Long Road"),
        ("park", "Green"),
        ("path", ""),
        ("place", "Here"),
        ("rail", ""),
        ("street", "Rue d’Été"),
        ("water", ""),
    ]
    of = frame.to_crs(UTM).set_index(["kind", "name"]).geometry
    assert of["major", "Long Road"].length == pytest.approx(
        1000.0, abs=0.2
    )  # two ways in one, cut at the box
    assert shapely.get_num_coordinates(of["major", ""]) == 2  # simplified
    assert of["park", "Green"].area == pytest.approx(200**2, rel=1e-3)
    assert of["water", ""].area == pytest.approx(100 * 1000, rel=1e-2)  # the sea
    assert "OpenStreetMap" in frame.attrs["credit"]
    alone = base_map_of(
        tmp_path, ({"building": "yes"}, [(3000, 0), (3000, 10), (3010, 10), (3000, 0)])
    )
    assert list(alone["kind"]) == ["place"]


@pytest.mark.slow
def test_a_folder_of_maps_keeps_its_base_map_as_one_of_its_files(tmp_path):
    scenario = Scenario.from_dict(SOHO)
    made, file = (
        run_scenario(scenario, tmp_path / "a", progress=False).maps[20.0],
        tmp_path / "a" / "basemap.parquet",
    )
    opened, written = ju.open_maps(tmp_path / "a"), digest_of(file)
    assert "Broadway" in set(opened.base_map["name"])
    west, south, east, north = made.base_map.total_bounds
    assert (west > -74.006, south > 40.718, east < -73.996, north < 40.726) == (True,) * 4
    file.unlink()
    run_scenario(scenario, tmp_path / "a", progress=False)
    assert digest_of(file) == written
    file.write_bytes(b"PAR1 damaged")
    assert ju.open_maps(tmp_path / "a").base_map is None  # and the maps are as good as ever
    run_scenario(scenario, tmp_path / "a", progress=False)
    assert digest_of(file) == written
    assert (tmp_path / "a" / "kept" / "basemap.parquet").is_file()

    opened.save(tmp_path / "b")
    pictures = {path: digest_of(path) for path in (tmp_path / "b").rglob("*.tif")}
    ju.open_maps(tmp_path / "b").save(tmp_path / "b")  # into the folder that they are read from
    assert {path: digest_of(path) for path in (tmp_path / "b").rglob("*.tif")} == pictures
    assert digest_of(tmp_path / "b" / "basemap.parquet") == written
    without = ju.build_maps(
        ju.demo_city(width_m=600, height_m=600), altitudes_m=[20.0], progress=False
    )
    assert without.base_map is None
    without.save(tmp_path / "b")
    assert not (tmp_path / "b" / "basemap.parquet").exists()

    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "basemap.parquet").write_bytes(b"of the user")
    with pytest.raises(ju.InputError, match="is in the way"):
        opened.save(tmp_path / "c")
    assert [file.name for file in (tmp_path / "c").iterdir()] == [
        "basemap.parquet"
    ]  # nothing else was begun


def test_a_study_of_a_sample_takes_its_water_and_parks():
    settings = {**SOHO, "region": {**SOHO["region"], "bounds": [-74.02, 40.70, -74.005, 40.715]}}
    cover = land_cover_of(Scenario.from_dict(settings))
    battery, river = transformer(WGS84, UTM).transform([-74.0165, -74.0185], [40.7033, 40.7150])
    assert shapely.contains_xy(cover.park, battery, river).tolist() == [True, False]
    assert land_cover_of(Scenario.from_dict({"buildings": {"source": "sample:shinjuku"}})) is None


@pytest.mark.data
def test_the_water_of_a_sample_is_that_of_its_source(data_dir):
    scenario = Scenario.from_dict({**SOHO, "region": {"bounds": [-74.02, 40.70, -73.98, 40.73]}})
    bounds_m = Grid.from_bounds(scenario.region.bounds, 5.0).bounds_m
    theirs, ours = (
        read_land_cover(data_dir / "osm/lower-manhattan.osm.pbf", UTM, bounds_m),
        land_cover_of(scenario),
    )
    for a, b in ((theirs.water, ours.water), (theirs.park, ours.park)):
        assert shapely.symmetric_difference(a, b).area < 0.01 * a.area
