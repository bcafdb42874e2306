"""Water and parks from OSM: tagged areas, and the sea, which OSM draws as a coast with the land on its left."""

import numpy as np
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.osm import read_land_cover, sea
from jaxurban.maps.scenario import Scenario
from jaxurban.report.montecarlo import land_cover_of
from jaxurban.world.grid import WGS84, transformer
from tests.io.made_files import line, osm

BOX = shapely.box(0, 0, 3000, 2000)
CRS = "EPSG:32618"


def coast(*points: tuple[float, float]) -> shapely.LineString:
    return shapely.LineString(points)


NORTHWARD, WEST = coast((1000, -500), (1000, 900), (1200, 2500)), coast((-1000, -5000), (-1000, 5000))
ISLAND = [coast((1000, 500), (2000, 500), (2000, 1500)), coast((2000, 1500), (1000, 1500), (1000, 500))]
SHORES = [coast((1000, -10), (1000, 2010)), coast((1600, 2010), (1600, -10))]


@pytest.mark.parametrize(
    ("coasts", "area_m2", "is_wet"),  # the last at 500, 1300 and 2500 m from the west, halfway up
    [
        ([NORTHWARD], 3_924_375, [False, True, True]),  # the sea is on its right
        ([shapely.reverse(NORTHWARD)], 6e6 - 3_924_375, [True, False, False]),
        (ISLAND, 6e6 - 1e6, [True, False, True]),
        # Cut shortly before the border: it is led on to it.
        ([coast((1000, 120), (1000, 1000)), coast((1000, 1000), (1000, 1850))], 4e6, [False, True, True]),
        (SHORES, 600 * 2000, [False, True, False]),
        ([WEST], 6e6, [True, True, True]),  # no shore in the box: by the nearest
        ([shapely.reverse(WEST)], 0, [False, False, False]),
        ([], 0, [False, False, False]),
    ],
)
def test_the_sea_is_what_coasts_have_on_their_right(coasts, area_m2, is_wet):
    wet = sea(coasts, BOX)
    assert shapely.area(wet) == pytest.approx(area_m2)
    assert shapely.contains_xy(wet, [500, 1300, 2500], [1000] * 3).tolist() == is_wet


def test_a_coast_with_a_gap_in_the_middle_warns():
    broken = [coast((1000, -10), (1000, 900)), coast((1000, 901), (1000, 2010))]
    with pytest.warns(UserWarning, match="the coast lines have a gap"):
        sea(broken, BOX)


BOUNDS_M = (583_000, 4_507_000, 584_000, 4_508_000)


def cover_of(tmp_path, *ways):
    """Return the land cover of an OSM file of lines: pairs of a tag and points in metres from a corner of the box."""
    to_degrees = transformer(CRS, WGS84).transform
    lines = [
        line(number, [to_degrees(BOUNDS_M[0] + x_m, BOUNDS_M[1] + y_m) for x_m, y_m in points], **tags)
        for number, (tags, points) in enumerate(ways, 1)
    ]
    (tmp_path / "cover.osm").write_text(osm(*lines))
    return read_land_cover(tmp_path / "cover.osm", CRS, BOUNDS_M)


def square(x_m: float, y_m: float, side_m: float) -> list[tuple[float, float]]:
    return [(x_m, y_m), (x_m + side_m, y_m), (x_m + side_m, y_m + side_m), (x_m, y_m + side_m), (x_m, y_m)]


def test_tagged_water_parks_and_the_sea_are_read_within_the_box(tmp_path):
    cover = cover_of(
        tmp_path,
        ({"natural": "water"}, square(100, 100, 100)),
        ({"leisure": "park"}, square(400, 100, 200)),
        ({"landuse": "cemetery"}, square(900, 900, 200)),
        ({"natural": "coastline"}, [(300, -50), (300, 1050)]),
        ({"building": "yes"}, square(700, 300, 50)),
        ({"natural": "coastline"}, [(0, -50), (0, -20)]),
    )
    assert shapely.area(cover.park) == pytest.approx(200**2 + 100**2, rel=1e-4)  # the cemetery reaches out of the box
    assert shapely.area(cover.water) == pytest.approx(100**2 + 700 * 1000, rel=1e-3)
    assert np.allclose(shapely.bounds(cover.water), (583_100, *BOUNDS_M[1:]), atol=0.1)


def test_an_island_drawn_as_one_closed_coast_is_neither_park_nor_water(tmp_path):
    cover = cover_of(tmp_path, ({"natural": "coastline"}, square(300, 300, 200)))  # land on the left: inside
    assert cover.park.is_empty
    assert shapely.area(cover.water) == pytest.approx(1e6 - 200**2, rel=1e-3)
    assert cover_of(tmp_path, ({"building": "yes"}, square(100, 100, 100))).water.is_empty


def scenario(source: str, **study) -> Scenario:
    region = {"bounds": (-74.0, 40.755, -73.99, 40.762)}
    return Scenario.from_dict({"region": region, "buildings": {"source": source}, "study": study})


def test_a_study_takes_the_land_cover_from_where_there_is_one(tmp_path):
    assert land_cover_of(scenario("synthetic")) is not None
    assert land_cover_of(scenario("heights.tif")) is None
    cover_of(tmp_path, ({"leisure": "park"}, square(100, 100, 100)))
    assert land_cover_of(scenario("heights.tif", land_cover=str(tmp_path / "cover.osm"))) is not None
    with pytest.raises(InputError, match="land_cover must be an OpenStreetMap file"):
        land_cover_of(scenario("heights.tif", land_cover="cover.tif"))


@pytest.mark.data
def test_places_of_lower_manhattan_are_where_they_are(data_dir):
    west, south, east, north = 582_500, 4_506_000, 585_800, 4_509_000
    cover = read_land_cover(data_dir / "osm/lower-manhattan.osm.pbf", CRS, (west, south, east, north))
    places = {"water": (-73.995, 40.7035), "park": (-74.0068, 40.7127), "Wall Street": (-74.0095, 40.7065)}
    xy_m = transformer(WGS84, CRS).transform(*np.transpose(list(places.values())))
    assert shapely.contains_xy(cover.water, *xy_m).tolist() == [True, False, False]
    assert shapely.contains_xy(cover.park, *xy_m).tolist() == [False, True, False]
