"""Heights of buildings as the input that roofs follow from."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.io.read.rasterise import build_surface, building_index, rasterise
from jaxurban.world.city import City, Raster
from jaxurban.world.grid import Grid
from jaxurban.world.surface import NO_BUILDING, roofs_of
from jaxurban.world.synthetic import demo_city
from tests.made_maps import city_of_boxes

CRS = "EPSG:32618"
GRID = Grid(CRS, 5.0, 0, 0, 8, 8)


@pytest.mark.parametrize("all_touched", [False, True])
def test_roofs_by_index_are_the_burnt_roofs_exactly(all_touched):
    city = demo_city(600, 500)
    x_min, y_min = city.extent_m[:2]
    grid = Grid(city.crs, 5.0, round(y_min / 5), round(x_min / 5), 100, 120)
    building = building_index(city, grid, all_touched)
    assert building.dtype == np.int32
    height_m = city.buildings.height_m.astype(np.float32)
    roof_m = rasterise(city, grid, all_touched).roof_m
    assert (building == NO_BUILDING).any()
    np.testing.assert_array_equal(roofs_of(jnp.asarray(height_m), jnp.asarray(building)), roof_m)
    region = grid.padded(-5, -5, -5, -5)
    surface = build_surface(city, region, grid, all_touched)
    np.testing.assert_array_equal(surface.with_heights(jnp.asarray(height_m), jnp.asarray(building)).roof_m, roof_m)


def test_where_buildings_overlap_the_higher_one_has_the_cell_and_all_of_the_gradient():
    city = city_of_boxes([(0, 0, 20, 20), (10, 10, 30, 30), (12, 12, 18, 18)], [30, 20, 10], 40.0)
    building = building_index(city, GRID)
    np.testing.assert_array_equal(np.unique(building), [NO_BUILDING, 0, 1])  # the third one is covered
    gradient = jax.grad(lambda h: roofs_of(h, jnp.asarray(building)).sum())(jnp.asarray([30.0, 20.0, 10.0]))
    np.testing.assert_array_equal(gradient, [16, 12, 0])


def test_a_region_without_buildings_and_a_height_raster_have_none_to_differentiate_by():
    city = city_of_boxes([(0, 0, 20, 20)], 30.0, 40.0)
    assert (building_index(city, Grid(CRS, 5.0, 100, 100, 4, 4)) == NO_BUILDING).all()
    raster = Raster(np.ones((8, 8), np.float32), (5.0, 0.0, 0.0, 0.0, -5.0, 40.0), CRS)
    with pytest.raises(InputError, match="gradients by building need outlines"):
        building_index(City(CRS, (0.0, 0.0, 40.0, 40.0), roofs=raster), GRID)
