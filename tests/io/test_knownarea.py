"""Where a city's sources know what stands: joined over boxes and buildings, and not stretched by what is far off."""

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.read.city import area_of_outlines, area_of_raster
from jaxurban.io.read.guesses import leaving_shares, outside_share, rays_leaving
from jaxurban.maps.build import view_sky
from jaxurban.world.city import Footprints, Raster
from tests.io import made_files
from tests.io.made_files import UTM, WGS84, X, Y, line, osm

BOUNDS = (-74.016, 40.704, -74.010, 40.708)


def house(x_m, y_m):
    return made_files.box(x_m, y_m, x_m + 20, y_m + 20)


def box(*sides_m):
    return made_files.box(*sides_m).bounds


def write(path, lonlat_boxes):
    boxes = [shapely.box(*each) for each in lonlat_boxes]
    return made_files.write_vector(path, boxes, WGS84, height=[30.0] * len(boxes))


def test_boxes_are_joined_and_buildings_beyond_them_count():
    boxes = [box(0, 0, 400, 400), box(3_000, 0, 3_400, 400)]
    area = area_of_outlines(np.array([house(10, 10), house(390, 100), house(0, 2_000)]), boxes)
    inside = shapely.union_all([shapely.box(*each) for each in boxes])
    assert shapely.covers(area, inside)
    assert shapely.covers(area, house(390, 100))  # across the border
    assert shapely.covers(area, house(0, 2_000))
    assert area.area == pytest.approx(inside.area + 10 * 20 + 400)
    assert not shapely.intersects(area, shapely.Point(X + 1_700, Y + 200))  # between the boxes


def test_a_wreck_far_off_is_known_but_not_the_way_there():
    town = [house(x, y) for x in range(0, 900, 300) for y in range(0, 900, 300)]
    area = area_of_outlines(np.array([*town, house(30_000, 0)]), [])
    assert area.bounds == pytest.approx(box(0, 0, 30_020, 620))
    assert area.area == pytest.approx(620**2 + 400)


def test_a_raster_is_known_where_it_holds_data():
    values = np.zeros((100, 100), np.float32)
    raster = Raster(values, tuple(made_files.north_up(10.0, 100))[:6], UTM)
    assert area_of_raster(raster, UTM).equals(shapely.box(*box(0, 0, 1_000, 1_000)))
    values[:, :50] = np.nan
    area = area_of_raster(raster, UTM)
    assert area.area == pytest.approx(500 * 1_000, rel=0.05)
    assert area.bounds == pytest.approx(box(500, 0, 1_000, 1_000), abs=20)
    assert area.bounds[2] == pytest.approx(X + 1_000)


def test_rays_leave_where_no_data_are_even_if_they_end_where_some_are():
    area = shapely.union_all([shapely.box(*box(0, 0, 100, 100)), shapely.box(*box(300, 0, 400, 100))])
    zero = np.zeros(0)
    none = Footprints(np.array([], object), zero, zero, zero.astype(np.uint8), zero > 0)
    city = ju.City(UTM, area.bounds, none, area=area)
    region = ju.Grid(UTM, 10.0, round(Y / 10), round(X / 10), 10, 10)
    east_m, north_m = np.array([4.0, 300.0, 8.0]), np.array([0.0, 0.0, 0.0])
    leaves = rays_leaving(city, region, east_m, north_m).reshape(10, 10, 3)
    assert not leaves[:, :, 0].any()
    assert leaves[:, :, 1].all()
    np.testing.assert_array_equal(leaves[:, :, 2], np.broadcast_to(np.arange(10) == 9, (10, 10)))


def test_a_city_keeps_its_bounds_and_a_wreck_does_not_stretch_its_maps(tmp_path):
    path = write(tmp_path / "city.geojson", [(-74.0159, 40.7041, -74.0140, 40.7060), (-72.0, 42.0, -71.999, 42.001)])
    city = ju.City.from_files(path, bounds=BOUNDS, crs=UTM)
    assert city.bounds == BOUNDS
    maps = ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,), population=ju.Population(time_of_day=("day",)))
    assert maps.grid == ju.Grid.from_bounds(BOUNDS, 20.0, UTM)
    assert 0.5 < outside_share(maps.grid, city.known_area) < 0.9  # the wreck makes nothing known
    x_min, y_min, x_max, y_max = city.extent_m
    assert (x_max - x_min) * (y_max - y_min) < 1e6


def test_what_is_kept_beyond_a_declared_box_still_shadows(tmp_path):
    """Two boxes, of which libosmium tells the first: a tower in the second shadows the first's streets."""
    corners = shapely.box(-74.0120, 40.7000, -74.0100, 40.7020).exterior.coords
    first, second = ((-74.016, 40.704, -74.010, 40.708), (-74.016, 40.699, -74.010, 40.703))

    def seen(name, *boxes):
        (tmp_path / name).write_text(osm(line(9, corners, building="yes", height="500"), boxes=boxes))
        city = ju.City.from_files(ju.Buildings(tmp_path / name, allow_none=True), bounds=BOUNDS, crs=UTM)
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
    beside = ju.City.from_files(write(tmp_path / "b.geojson", [*town, *wrecks]), bounds=BOUNDS, crs=UTM)
    grid = ju.Grid.from_bounds(BOUNDS, 20.0, UTM)
    sky = view_sky(grid, ju.Gps(times=("2020-04-27T16:00:00Z",)))
    shares = [leaving_shares(city, grid, sky, 20.0)[0] for city in (alone, beside)]
    assert shares[0] == shares[1] > 0.1
