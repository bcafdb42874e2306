import time
from functools import partial

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.city import City
from jaxurban.samples.synthetic import demo_city, demo_city_for_bounds, demo_cover_for_bounds
from jaxurban.world.blocks import OTHER_DISTRICT, Zoning
from jaxurban.world.footprints import HeightOrigin

NO_SIZES_M = [(12_000, 20_000), (10_000, 25_000), (100, 1000), (1000, float("nan"))]
SIZES_M = [(500, 500), (2000, 3000), (3000, 2000)]


def outlines(city: City) -> np.ndarray:
    return city.buildings.polygons[~city.buildings.is_part]


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
    edge = shapely.box(*city.extent_m).exterior
    clear_m = shapely.distance(
        buildings, shapely.difference(shapely.boundary(blocks[block]), edge.buffer(0.01))
    )
    assert np.nanmin(clear_m) == pytest.approx(20.0)  # half of the narrowest street, 40 m


def test_outlines_do_not_overlap_and_blocks_fill_the_box(city):
    for polygons in (outlines(city), city.blocks.polygons):
        assert shapely.union_all(polygons).area == pytest.approx(
            shapely.area(polygons).sum(), rel=1e-9
        )
    box_m2 = shapely.box(*city.extent_m).area
    assert 0.98 < city.blocks.area_m2.sum() / box_m2 <= 1.0 + 1e-9
    assert 0.15 < shapely.area(outlines(city)).sum() / box_m2 < 0.3


def test_the_one_tower_stands_on_its_podium_in_the_middle_of_the_box(city):
    buildings = city.buildings
    (tower,) = buildings.polygons[buildings.is_part]
    x_min, y_min, x_max, y_max = city.extent_m
    middle = shapely.Point((x_min + x_max) / 2, (y_min + y_max) / 2)
    assert tower.centroid.distance(middle) < 1e-6
    (podium,) = np.flatnonzero(shapely.covers(outlines(city), tower))
    assert buildings.height_m[~buildings.is_part][podium] == 25.0
    assert buildings.height_m[buildings.is_part] == buildings.height_m.max() == 320.0


def test_people_live_in_houses_and_none_in_the_park(city):
    blocks = city.blocks
    _, block = shapely.STRtree(blocks.polygons).query(outlines(city), predicate="intersects")
    has_houses = np.isin(np.arange(len(blocks.polygons)), block)
    is_park = blocks.district == OTHER_DISTRICT
    assert is_park.any()
    assert not has_houses[is_park].any()
    assert np.all(blocks.night_count[~has_houses] == 0)
    has_tower = blocks.night_count[has_houses] == 0
    assert has_tower.sum() == 1
    box_km2 = shapely.box(*city.extent_m).area / 1e6
    assert 10e3 < blocks.night_count.sum() / box_km2 < 50e3  # Manhattan: 28,000 a square kilometre


def test_commerce_is_in_the_centre_whose_houses_are_higher(city):
    blocks, buildings = city.blocks, city.buildings
    np.testing.assert_array_equal(blocks.zoning == Zoning.COMMERCIAL, blocks.district == 1)
    np.testing.assert_array_equal(blocks.zoning == Zoning.RESIDENTIAL, blocks.district == 2)
    np.testing.assert_array_equal(blocks.zoning == Zoning.OTHER, blocks.district == OTHER_DISTRICT)
    _, block = shapely.STRtree(blocks.polygons).query(buildings.polygons, predicate="intersects")
    is_central = blocks.zoning[block] == Zoning.COMMERCIAL
    central_m, outer_m = buildings.height_m[is_central], buildings.height_m[~is_central]
    assert 1.3 * np.median(outer_m) < np.median(central_m)
    assert 60 < np.quantile(buildings.height_m[~buildings.is_part], 0.995) < 160


def test_the_park_is_one_empty_area_north_of_the_tower():
    bounds = (-74.02, 40.70, -73.99, 40.72)
    city, cover = demo_city_for_bounds(bounds), demo_cover_for_bounds(bounds, None)
    assert cover.water.is_empty
    assert cover.park.geom_type == "Polygon"
    assert cover.park.area > 50_000
    assert not shapely.intersects(cover.park, city.buildings.polygons).any()
    is_park = shapely.contains(cover.park.buffer(0.01), city.blocks.polygons)
    np.testing.assert_array_equal(is_park, city.blocks.district == OTHER_DISTRICT)
    (tower,) = city.buildings.polygons[city.buildings.is_part]
    assert cover.park.centroid.y > tower.bounds[3]


def test_streets_are_turned_29_degrees_clockwise_from_north(city):
    blocks = city.blocks
    whole = blocks.polygons[np.abs(blocks.area_m2 - 18_000) < 1e-3]
    edges = np.diff(shapely.get_coordinates(whole).reshape(-1, 5, 2), axis=1)
    azimuth_deg = np.degrees(np.arctan2(edges[..., 0], edges[..., 1])) % 90
    assert len(whole) > 2
    np.testing.assert_allclose(azimuth_deg, 29.0, atol=1e-3)


@pytest.mark.slow
def test_the_full_city_is_made_in_seconds():
    began = time.process_time()
    made = demo_city()
    assert time.process_time() - began < 6.0
    assert 40_000 < len(made.buildings) < 100_000


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
