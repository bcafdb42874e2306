"""Where a city's sources know what stands, and where water and parks are: tagged areas, and the sea beside a coast."""

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.city import area_of_outlines, area_of_raster
from jaxurban.cities.land_cover import read_land_cover, sea
from jaxurban.maps.build import view_sky
from jaxurban.maps.guesses import leaving_share, outside_share
from jaxurban.studies.montecarlo.study import land_cover_of
from jaxurban.world.grid import transformer
from jaxurban.world.raster import Raster
from tests.made_files import UTM, WGS84, X, Y, box, line, north_up, osm, write_vector

SEA_BOX = shapely.box(0, 0, 3000, 2000)


def coast(*points: tuple[float, float]) -> shapely.LineString:
    return shapely.LineString(points)


NORTHWARD, WEST = (
    coast((1000, -500), (1000, 900), (1200, 2500)),
    coast((-1000, -5000), (-1000, 5000)),
)
ISLAND = [
    coast((1000, 500), (2000, 500), (2000, 1500)),
    coast((2000, 1500), (1000, 1500), (1000, 500)),
]
SHORES = [coast((1000, -10), (1000, 2010)), coast((1600, 2010), (1600, -10))]


@pytest.mark.parametrize(
    ("coasts", "area_m2", "is_wet"),  # the last at 500, 1300 and 2500 m from the west, halfway up
    [
        ([NORTHWARD], 3_924_375, [False, True, True]),  # the sea is on its right
        ([shapely.reverse(NORTHWARD)], 6e6 - 3_924_375, [True, False, False]),
        (ISLAND, 6e6 - 1e6, [True, False, True]),
        # Cut shortly before the border: it is led on to it.
        (
            [coast((1000, 120), (1000, 1000)), coast((1000, 1000), (1000, 1850))],
            4e6,
            [False, True, True],
        ),
        (SHORES, 600 * 2000, [False, True, False]),
        ([WEST], 6e6, [True, True, True]),  # no shore in the box: by the nearest
        ([shapely.reverse(WEST)], 0, [False, False, False]),
        ([], 0, [False, False, False]),
    ],
)
def test_the_sea_is_what_coasts_have_on_their_right(coasts, area_m2, is_wet):
    wet = sea(coasts, SEA_BOX)
    assert shapely.area(wet) == pytest.approx(area_m2)
    assert shapely.contains_xy(wet, [500, 1300, 2500], [1000] * 3).tolist() == is_wet


def test_a_coast_with_a_gap_in_the_middle_warns():
    broken = [coast((1000, -10), (1000, 900)), coast((1000, 901), (1000, 2010))]
    with pytest.warns(UserWarning, match="the coast lines have a gap"):
        sea(broken, SEA_BOX)


BOUNDS_M = (583_000, 4_507_000, 584_000, 4_508_000)


def cover_of(tmp_path, *ways):
    """Return the land cover of an OSM file of lines: pairs of a tag and points in metres from a corner of the box."""
    to_degrees = transformer(UTM, WGS84).transform
    lines = [
        line(
            number,
            [to_degrees(BOUNDS_M[0] + x_m, BOUNDS_M[1] + y_m) for x_m, y_m in points],
            **tags,
        )
        for number, (tags, points) in enumerate(ways, 1)
    ]
    (tmp_path / "cover.osm").write_text(osm(*lines))
    return read_land_cover(tmp_path / "cover.osm", UTM, BOUNDS_M)


def square(x_m: float, y_m: float, side_m: float) -> list[tuple[float, float]]:
    return [
        (x_m, y_m),
        (x_m + side_m, y_m),
        (x_m + side_m, y_m + side_m),
        (x_m, y_m + side_m),
        (x_m, y_m),
    ]


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
    assert shapely.area(cover.park) == pytest.approx(
        200**2 + 100**2, rel=1e-4
    )  # the cemetery reaches out of the box
    assert shapely.area(cover.water) == pytest.approx(100**2 + 700 * 1000, rel=1e-3)
    assert np.allclose(shapely.bounds(cover.water), (583_100, *BOUNDS_M[1:]), atol=0.1)


def test_an_island_drawn_as_one_closed_coast_is_neither_park_nor_water(tmp_path):
    cover = cover_of(
        tmp_path, ({"natural": "coastline"}, square(300, 300, 200))
    )  # land on the left: inside
    assert cover.park.is_empty
    assert shapely.area(cover.water) == pytest.approx(1e6 - 200**2, rel=1e-3)
    assert cover_of(tmp_path, ({"building": "yes"}, square(100, 100, 100))).water.is_empty


def scenario(source: str, **study) -> ju.Scenario:
    region = {"bounds": (-74.0, 40.755, -73.99, 40.762)}
    return ju.Scenario.from_dict(
        {"region": region, "buildings": {"source": source}, "study": study}
    )


def test_a_study_takes_the_land_cover_from_where_there_is_one(tmp_path):
    assert land_cover_of(scenario("synthetic")) is not None
    assert land_cover_of(scenario("heights.tif")) is None
    cover_of(tmp_path, ({"leisure": "park"}, square(100, 100, 100)))
    assert (
        land_cover_of(scenario("heights.tif", land_cover=str(tmp_path / "cover.osm"))) is not None
    )
    with pytest.raises(ju.InputError, match=r"land_cover=\.\.\.\) must be an OpenStreetMap file"):
        land_cover_of(scenario("heights.tif", land_cover="cover.tif"))


@pytest.mark.data
def test_places_of_lower_manhattan_are_where_they_are(data_dir):
    west, south, east, north = 582_500, 4_506_000, 585_800, 4_509_000
    cover = read_land_cover(
        data_dir / "osm/lower-manhattan.osm.pbf", UTM, (west, south, east, north)
    )
    places = {
        "water": (-73.995, 40.7035),
        "park": (-74.0068, 40.7127),
        "Wall Street": (-74.0095, 40.7065),
    }
    xy_m = transformer(WGS84, UTM).transform(*np.transpose(list(places.values())))
    assert shapely.contains_xy(cover.water, *xy_m).tolist() == [True, False, False]
    assert shapely.contains_xy(cover.park, *xy_m).tolist() == [False, True, False]


BOUNDS = (-74.016, 40.704, -74.010, 40.708)


def house(x_m, y_m):
    return box(x_m, y_m, x_m + 20, y_m + 20)


def write(path, lonlat_boxes):
    boxes = [shapely.box(*each) for each in lonlat_boxes]
    return write_vector(path, boxes, WGS84, height=[30.0] * len(boxes))


def test_boxes_are_joined_and_buildings_beyond_them_count():
    boxes = [box(0, 0, 400, 400), box(3_000, 0, 3_400, 400)]
    houses = np.array([house(10, 10), house(390, 100), house(0, 2_000)])
    area, inside = (
        area_of_outlines(houses, [each.bounds for each in boxes]),
        shapely.union_all(boxes),
    )
    assert shapely.covers(area, inside)
    assert shapely.covers(area, house(390, 100))  # across the border
    assert shapely.covers(area, house(0, 2_000))
    assert area.area == pytest.approx(inside.area + 10 * 20 + 400)
    assert not shapely.intersects(area, shapely.Point(X + 1_700, Y + 200))  # between the boxes


def test_a_wreck_far_off_is_known_but_not_the_way_there():
    town = [house(x, y) for x in range(0, 900, 300) for y in range(0, 900, 300)]
    area = area_of_outlines(np.array([*town, house(30_000, 0)]), [])
    assert area.bounds == pytest.approx(box(0, 0, 30_020, 620).bounds)
    assert area.area == pytest.approx(620**2 + 400)


def test_a_raster_is_known_where_it_holds_data():
    values = np.zeros((100, 100), np.float32)
    raster = Raster(values, tuple(north_up(10.0, 100))[:6], UTM)
    assert area_of_raster(raster, UTM).equals(box(0, 0, 1_000, 1_000))
    values[:, :50] = np.nan
    area = area_of_raster(raster, UTM)
    assert area.area == pytest.approx(500 * 1_000, rel=0.05)
    assert area.bounds == pytest.approx(box(500, 0, 1_000, 1_000).bounds, abs=20)
    assert area.bounds[2] == pytest.approx(X + 1_000)


def test_a_city_keeps_its_bounds_and_a_wreck_does_not_stretch_its_maps(tmp_path):
    path = write(
        tmp_path / "city.geojson",
        [(-74.0159, 40.7041, -74.0140, 40.7060), (-72.0, 42.0, -71.999, 42.001)],
    )
    city = ju.City.from_files(path, bounds=BOUNDS, crs=UTM)
    assert city.bounds == BOUNDS
    maps = ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,))
    assert maps.grid == ju.Grid.from_bounds(BOUNDS, 20.0, UTM)
    assert 0.5 < outside_share(maps.grid, city.known_area) < 0.9  # the wreck makes nothing known
    x_min, y_min, x_max, y_max = city.extent_m
    assert (x_max - x_min) * (y_max - y_min) < 1e6


def test_what_is_kept_beyond_a_declared_box_still_shadows(tmp_path):
    """Two boxes, of which libosmium tells the first: a tower in the second shadows the first's streets."""
    corners = shapely.box(-74.0120, 40.7000, -74.0100, 40.7020).exterior.coords
    first, second = ((-74.016, 40.704, -74.010, 40.708), (-74.016, 40.699, -74.010, 40.703))

    def seen(name, *boxes):
        (tmp_path / name).write_text(
            osm(line(9, corners, building="yes", height="500"), boxes=boxes)
        )
        city = ju.City.from_files(
            ju.Buildings(tmp_path / name, allow=("none",)), bounds=BOUNDS, crs=UTM
        )
        return ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,)).m("num_visible", 20.0)

    both = seen("both.osm", first, second)
    assert both.min() < both.max()  # the tower shadows
    np.testing.assert_array_equal(seen("swapped.osm", second, first), both)
    np.testing.assert_array_equal(seen("small.osm", first), both)
    np.testing.assert_array_equal(seen("none.osm"), both)


def test_rays_are_told_to_leave_a_town_beside_a_wreck(tmp_path):
    corners = [(-74.016 + i / 2000, 40.704 + j / 2000) for i in range(13) for j in range(9)]
    town = [(lon, lat, lon + 0.0002, lat + 0.0002) for lon, lat in corners]
    alone = ju.City.from_files(write(tmp_path / "a.geojson", town), bounds=BOUNDS, crs=UTM)
    wrecks = [(-74.12, 40.62, -74.119, 40.621), (-73.92, 40.79, -73.919, 40.791)]
    beside = ju.City.from_files(
        write(tmp_path / "b.geojson", [*town, *wrecks]), bounds=BOUNDS, crs=UTM
    )
    grid = ju.Grid.from_bounds(BOUNDS, 20.0, UTM)
    sky = view_sky(grid, ju.Gps(times=("2020-04-27T16:00:00Z",)))
    shares = [leaving_share(city, grid, sky, 20.0) for city in (alone, beside)]
    assert shares[0] == shares[1] > 0.01
