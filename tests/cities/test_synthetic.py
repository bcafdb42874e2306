from functools import partial

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.synthetic import demo_city, demo_city_for_bounds, demo_cover
from jaxurban.io.city import City
from jaxurban.world.blocks import OTHER_DISTRICT, Zoning
from jaxurban.world.footprints import HeightOrigin

NO_SIZES_M = [(12_000, 20_000), (10_000, 25_000), (100, 1000), (1000, float("nan"))]
SIZES_M = [(500, 500), (2000, 3000), (3000, 2000)]


def outlines(city: City) -> np.ndarray:
    return city.buildings.polygons[~city.buildings.is_part]


@pytest.fixture(scope="module")
def full_city() -> City:
    return demo_city()


@pytest.fixture(scope="module", params=SIZES_M, ids=str)
def city(request) -> City:
    return demo_city(*request.param)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_city():
    def of(seed):
        made = demo_city(800, 900, seed=seed)
        numbers = [made.buildings.height_m.tobytes(), made.blocks.night_count.tobytes()]
        return numbers + [
            shapely.to_wkb(part.polygons).tolist() for part in (made.buildings, made.blocks)
        ]

    assert of(0) == of(0)
    assert of(0)[1] != of(1)[1]


def test_polygons_are_valid_areas_inside_the_box_with_a_height(city):
    box = shapely.box(*city.extent_m).buffer(1e-6)
    for polygons in (city.buildings.polygons, city.blocks.polygons):
        assert shapely.is_valid(polygons).all()
        assert set(shapely.get_type_id(polygons)) <= {
            shapely.GeometryType.POLYGON,
            shapely.GeometryType.MULTIPOLYGON,
        }
        assert shapely.covers(box, polygons).all()
    assert np.all(city.buildings.height_m >= 5.0)
    assert np.all(city.buildings.origin == HeightOrigin.GENERATED)


def test_every_building_stands_in_one_block_clear_of_its_streets(city):
    blocks, buildings = city.blocks.polygons, city.buildings.polygons
    index, block = shapely.STRtree(blocks).query(buildings, predicate="intersects")
    np.testing.assert_array_equal(index, np.arange(len(buildings)))
    assert np.all(city.blocks.night_count[block] > 0)
    edge = shapely.box(*city.extent_m).exterior
    clear_m = shapely.distance(
        buildings, shapely.difference(shapely.boundary(blocks[block]), edge.buffer(0.01))
    )
    assert np.nanmin(clear_m) > 16.0  # half of the narrowest street, 32.1 m


def test_outlines_and_blocks_do_not_overlap_and_leave_the_river_out(city):
    for polygons in (outlines(city), city.blocks.polygons):
        assert shapely.union_all(polygons).area == pytest.approx(
            shapely.area(polygons).sum(), rel=1e-9
        )
    assert 0.05 < 1 - city.blocks.area_m2.sum() / shapely.box(*city.extent_m).area < 0.5


def test_towers_stand_on_their_podium(city):
    parts = city.buildings.polygons[city.buildings.is_part]
    assert len(parts) > 0
    i, _ = shapely.STRtree(outlines(city)).query(parts, predicate="covered_by")
    np.testing.assert_array_equal(i, np.arange(len(parts)))


def test_park_and_river_are_empty_and_the_park_is_a_block_without_people(city):
    cover = demo_cover(city.extent_m)
    box_m2 = shapely.box(*city.extent_m).area
    for area in (cover.park, cover.water):
        assert not shapely.intersects(area, city.buildings.polygons).any()
        assert shapely.covers(shapely.box(*city.extent_m).buffer(1e-6), area)
    assert cover.park.area > 0.03 * box_m2
    assert cover.water.area > 0.08 * box_m2
    is_park = shapely.covers(cover.park, city.blocks.polygons)
    assert is_park.sum() == 1
    assert city.blocks.area_m2[is_park] == cover.park.area
    assert city.blocks.night_count[is_park] == 0
    assert city.blocks.district[is_park] == OTHER_DISTRICT


def test_all_twelve_districts_are_there_and_commerce_is_in_the_south(city):
    blocks = city.blocks
    assert set(blocks.district) == {*range(1, 13), OTHER_DISTRICT}
    np.testing.assert_array_equal(blocks.zoning == Zoning.COMMERCIAL, blocks.district <= 6)
    np.testing.assert_array_equal(blocks.zoning == Zoning.OTHER, blocks.district == OTHER_DISTRICT)
    y_m = shapely.get_y(shapely.centroid(blocks.polygons))
    assert (
        y_m[blocks.zoning == Zoning.COMMERCIAL].mean()
        < y_m[blocks.zoning == Zoning.RESIDENTIAL].mean()
    )


@pytest.mark.slow
def test_streets_are_turned_29_degrees_clockwise_from_north(full_city):
    blocks = full_city.blocks
    is_whole = np.abs(blocks.area_m2 - np.median(blocks.area_m2)) < 1e-3  # the box cuts the others
    whole = blocks.polygons[is_whole]
    edges = np.diff(shapely.get_coordinates(whole).reshape(-1, 5, 2), axis=1)
    azimuth_deg = np.degrees(np.arctan2(edges[..., 0], edges[..., 1])) % 90
    assert len(whole) > 5000
    np.testing.assert_allclose(azimuth_deg, 29.0, atol=1e-3)


def test_towers_rise_near_the_middle_and_one_is_the_tallest(city):
    x_min, y_min, x_max, y_max = city.extent_m
    centroids = shapely.get_coordinates(shapely.centroid(city.buildings.polygons))
    from_middle = (centroids - [(x_min + x_max) / 2, (y_min + y_max) / 2]) / [
        x_max - x_min,
        y_max - y_min,
    ]
    height_m = city.buildings.height_m
    is_tower = height_m > 60
    assert is_tower.sum() > 3
    assert np.hypot(*from_middle[is_tower].T).max() < 0.4  # of the sides of the box
    assert np.median(height_m[np.hypot(*from_middle.T) > 0.4]) < 12
    assert height_m.max() == 390


def test_the_full_city_is_as_dense_and_as_built_as_a_real_one(full_city):
    land_m2 = full_city.blocks.area_m2.sum()
    assert 0.25 < shapely.area(outlines(full_city)).sum() / land_m2 < 0.40
    per_km2 = full_city.blocks.night_count.sum() / land_m2 * 1e6
    assert 10e3 < per_km2 < 30e3  # of Manhattan, 28 thousand; of Paris, 20
    assert 40_000 < len(full_city.buildings) < 80_000


def test_a_city_for_bounds_covers_the_region_at_every_resolution():
    bounds = (-74.02, 40.70, -74.0, 40.72)
    extent_m = demo_city_for_bounds(bounds).extent_m
    for resolution_m in (2, 5, 10):
        region_m = ju.Grid.from_bounds(bounds, resolution_m).bounds_m
        assert np.all(np.array(extent_m[:2]) <= region_m[:2])
        assert np.all(np.array(extent_m[2:]) >= region_m[2:])


def test_a_city_is_as_large_as_asked_also_south_of_the_equator_in_another_crs():
    city = demo_city(700, 900, centre_lonlat=(151.2, -33.87), crs="EPSG:28356")
    x_min, y_min, x_max, y_max = city.extent_m
    assert (city.crs, x_max - x_min, y_max - y_min) == ("EPSG:28356", 700, 900)
    assert len(city.buildings) > 20


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        *((partial(demo_city, *size), "fits boxes from 400 m") for size in NO_SIZES_M),
        (lambda: demo_city_for_bounds((-74.5, 40.5, -73.5, 41.0)), r"10 km \(east\) x 20 km"),
        (lambda: demo_city(1000, 1000, crs="EPSG:4326"), "not a projected CRS"),
    ],
)
def test_a_box_of_the_wrong_size_or_crs_is_refused(make, sentence):
    with pytest.raises(ju.InputError, match=sentence):
        make()
