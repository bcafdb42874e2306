"""Chimneys, masts and what is of unknown extent stand in all maps, as buildings do, which keep their numbers."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely

import jaxurban as ju
from jaxurban.io.city import City
from jaxurban.io.rasterise import highest_top_m, rasterise
from jaxurban.io.zone import cell_boxes
from jaxurban.maps.uncertain_heights import perturbed_cities
from jaxurban.metrics.variables import GROUP_NUMBERS
from jaxurban.receivers.outlines import Hiding
from jaxurban.settings import SLABS, HeightStd
from jaxurban.viewer.outlines import packed_outlines
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays
from tests import tiled_runs
from tests.made_maps import city_of_boxes, made_maps
from tests.viewer.browser import unpacked

GRID = Grid("EPSG:32618", 5.0, 0, 0, 40, 40)
HOUSES = [(0, 0, 40, 40), (100, 100, 140, 160)]
CHIMNEY, DECK, UNKNOWN = (20, 20, 60, 60), (150, 0, 200, 20), (0, 150, 30, 180)


def structures() -> Footprints:
    """Return a chimney of 90 m, a deck from 30 m to 35 m, and something unknown below 50 m."""
    return Footprints(
        polygons=shapely.box(*np.transpose([CHIMNEY, DECK, UNKNOWN])),
        height_m=np.array([90.0, 35.0, 0.0]),
        min_height_m=np.array([0.0, 30.0, 0.0]),
        origin=np.array([HeightOrigin.HEIGHT, HeightOrigin.HEIGHT, HeightOrigin.UNKNOWN], np.uint8),
        is_part=np.zeros(3, bool),
        kind=np.array(["chimney", "bridge", "unknown"], object),
        limit_m=np.array([np.inf, np.inf, 50.0]),
    )


def works(**more) -> City:
    """Return two houses of 20 m and 30 m, with the structures."""
    return replace(city_of_boxes(HOUSES, [20.0, 30.0], 200.0), structures=structures(), **more)


def test_a_structure_is_a_roof_as_a_building_of_its_outline_and_the_unknown_is_none():
    boxes = [*HOUSES, CHIMNEY, DECK]
    as_buildings = city_of_boxes(boxes, [20.0, 30.0, 90.0, 35.0], 200.0)
    surface, expected = rasterise(works(), GRID, has_guessed=True), rasterise(as_buildings, GRID)
    np.testing.assert_array_equal(surface.roof_m, expected.roof_m)
    np.testing.assert_array_equal(surface.roof_touched_m, expected.roof_touched_m)
    rows, cols = np.nonzero(surface.roof_guessed)
    assert set(rows) == set(range(30, 36))
    assert set(cols) == set(range(6))
    assert highest_top_m(works()) == 90.0
    hung = rasterise(works(hanging=SLABS), GRID)
    assert hung.slabs.lowest_floors(GRID).max() == 30.0
    assert hung.roof_m[1, 38] == 0.0


@pytest.mark.slow
def test_gradients_are_those_of_the_buildings_and_structures_are_constants():
    city = works()
    params = ju.grad.SoftParams(altitude_m=25.0)
    soft = ju.grad.soft_city(city, GRID, params)
    alone = ju.grad.soft_city(replace(city, structures=None), GRID, params)
    assert soft.height_m.shape == alone.height_m.shape == (2,)

    def risk(of, height_m):
        return of.layer("risk", height_m, params).sum()

    assert risk(soft, soft.height_m) > risk(alone, alone.height_m)
    slope = jax.grad(lambda height_m: risk(soft, height_m))(soft.height_m)
    step = jnp.array([0.0, 0.01])
    numeric = (risk(soft, soft.height_m + step) - risk(soft, soft.height_m - step)) / 0.02
    assert slope[1] == pytest.approx(float(numeric), rel=0.05)


def test_heights_are_drawn_again_for_buildings_alone():
    (moved,) = perturbed_cities(works(), HeightStd(height=5.0), 1, seed=1)
    assert (moved.buildings.height_m != works().buildings.height_m).all()
    np.testing.assert_array_equal(moved.standing.height_m[2:], structures().height_m)


def test_a_chimney_hides_a_satellite_and_the_unknown_is_no_roof():
    # Two rays from the west, at 45 degrees to the east: over the chimney, and over what is unknown.
    rays = Rays(
        np.array([-20.0, -20.0]), np.array([50.0, 165.0]), *np.radians([[90.0] * 2, [45.0] * 2])
    )
    city = replace(works(), extent_m=(-500.0, -500.0, 500.0, 500.0))
    table = Hiding(city, city.known_ground).behind(rays, np.array([2.0, 2.0]))
    expected = pd.DataFrame({"roof_height_m": [90.0, np.nan], "roof_distance_m": [40.0, np.nan]})
    pd.testing.assert_frame_equal(table[list(expected)], expected)
    assert table["margin_m"][1] == np.inf


def test_the_viewer_outlines_structures_and_what_is_unknown():
    maps = made_maps()
    moved = shapely.transform(works().standing.polygons, lambda xy: xy + maps.grid.bounds_m[:2])
    values = unpacked(packed_outlines(maps, replace(works().standing, polygons=moved)))
    counts, heights_m, is_guessed, group = values[1:21].reshape(4, 5)
    assert (counts == 5).all()
    assert heights_m.tolist() == [20.0, 30.0, 90.0, 35.0, 50.0]  # the last is its bound
    assert is_guessed.tolist() == [0, 0, 0, 0, 1]
    assert group.tolist() == [GROUP_NUMBERS[kind] for kind in works().standing.kinds]


@pytest.mark.slow
def test_the_bound_of_a_cell_is_the_highest_of_the_guessed_outlines_that_touch_it(tmp_path):
    of = tiled_runs.task(tiled_runs.city())
    buildings = of.city.buildings
    rng = np.random.default_rng(5)
    origin = rng.choice([HeightOrigin.HEIGHT, HeightOrigin.LEVELS], len(buildings))
    limit_m = rng.choice([25.0, 60.0, np.inf], len(buildings))
    city = replace(
        of.city, buildings=replace(buildings, origin=origin.astype(np.uint8), limit_m=limit_m)
    )
    maps = tiled_runs.check_tiles(replace(of, city=city), tmp_path)

    # The witness: the area that cells share with outlines.
    guessed = city.buildings.take(city.buildings.is_guessed)
    cells = cell_boxes(of.region, np.argwhere(np.ones(of.region.shape)), 1)
    cell, outline = shapely.STRtree(guessed.polygons).query(cells, predicate="intersects")
    shared_m2 = shapely.area(shapely.intersection(cells[cell], guessed.polygons[outline]))
    expected = np.zeros(len(cells))
    is_touched = shared_m2 > 1e-6
    np.maximum.at(expected, cell[is_touched], guessed.upper_m[outline[is_touched]])
    np.testing.assert_array_equal(
        maps["roof_limit"], expected.reshape(of.region.shape).astype(np.float32)
    )

    # Files hold it.
    ju.MetricMaps(maps).save(tmp_path / "saved", layers=("roof_limit",))
    (file,) = (tmp_path / "saved/geotiff").glob("roof_limit_*.tif")
    with rasterio.open(file) as raster:
        np.testing.assert_array_equal(raster.read(1)[::-1], maps["roof_limit"])
