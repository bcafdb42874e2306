from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from affine import Affine
from rasterio.features import rasterize

from jaxurban.io.read.census import read_blocks
from jaxurban.maps.provenance import population_totals
from jaxurban.metrics.population import (
    Population,
    block_people,
    day_share,
    density_per_km2,
)
from jaxurban.world.city import Blocks, Zoning
from tests.metrics.whole_maps import population_maps

# Four blocks of 100 m x 100 m in a row: commercial, residential, other, empty.
WEST_M = np.arange(4) * 100.0
BLOCKS = Blocks(
    polygons=shapely.box(WEST_M, 0.0, WEST_M + 100.0, 100.0),
    night_count=np.array([100.0, 400.0, 200.0, 0.0]),
    district=np.array([101, 107, 13, 102], np.int32),
    zoning=np.array([Zoning.COMMERCIAL, Zoning.RESIDENTIAL, Zoning.OTHER, Zoning.COMMERCIAL], np.uint8),
    block_id=np.array(["a", "b", "c", "d"], object),
)
UNEQUAL = replace(BLOCKS, polygons=shapely.box(WEST_M, 0.0, WEST_M + 100.0, [9, 1, 4, 1]))
BLOCK = jnp.array([[0, 1, 2], [3, -1, 0]])


def test_night_is_the_census_day_multiplies_by_gamma_and_the_densest_block_of_the_time_has_m_one():
    maps = population_maps(BLOCK, BLOCKS, ("night", "day"))
    np.testing.assert_allclose(maps.density_per_km2[0], [[1e4, 4e4, 2e4], [0, 0, 1e4]])
    np.testing.assert_allclose(maps.density_per_km2[1], [[3e4, 2e4, 1e4], [0, 0, 3e4]])
    np.testing.assert_allclose(maps.norm_per_km2, [4e4, 3e4])
    np.testing.assert_allclose(maps.m[1], [[1, 2 / 3, 1 / 3], [0, 0, 1]], rtol=1e-6)
    assert maps.m.dtype == jnp.float32


@pytest.mark.parametrize(
    ("blocks", "settings", "bounds_m", "norm", "m"),
    [
        (BLOCKS, {}, None, 4e4, [0.25, 1, 0.5]),
        (BLOCKS, {}, (210, 10, 290, 90), 2e4, [0.5, 1, 1]),  # only blocks that touch the region count
        (BLOCKS, {"normalise": 2e4}, None, 2e4, [0.5, 1, 1]),
        (BLOCKS, {"normalise": "p50"}, None, 2e4, [0.5, 1, 1]),  # the median of the three inhabited blocks
        (UNEQUAL, {"quantity": "count"}, None, 400, [0.25, 1, 0.5]),  # counts ignore the area
    ],
)
def test_a_number_a_percentile_or_the_greatest_of_the_region_normalises_and_clips(blocks, settings, bounds_m, norm, m):
    maps = population_maps(BLOCK, blocks, ("night",), Population(**settings), bounds_m)
    np.testing.assert_allclose(maps.norm_per_km2, [norm])
    np.testing.assert_allclose(maps.m[0], [m, [0, 0, m[0]]])


def test_a_region_without_people_has_m_zero_everywhere():
    empty = replace(BLOCKS, night_count=np.zeros(4))
    for normalise in ("max", "p95"):
        maps = population_maps(BLOCK, empty, ("day",), Population(normalise=normalise))
        assert not np.any(maps.m)
    nobody = population_maps(BLOCK, BLOCKS, ("day",), bounds_m=(5000, 5000, 5001, 5001))
    assert np.all(np.isfinite(nobody.m))


def test_a_block_without_area_has_density_zero_and_finite_gradients():
    def density(area_m2):
        return density_per_km2(block_people(jnp.array([5.0]), jnp.array([2]), 1.0, 3.0, 0.5), area_m2).sum()

    assert density(jnp.zeros(1)) == 0
    assert jax.grad(density)(jnp.zeros(1)) == 0


def test_hours_of_the_week_move_between_night_and_day():
    assert day_share("night") == day_share("weekday-03") == 0.0
    assert day_share("day") == day_share("weekday-12") == 1.0
    assert 0.0 < day_share("weekday-08") < 1.0
    # Moss and Qing (2012), in millions: 2.05 at night, 2.90 on a weekend day, 3.94 on a working day.
    assert 2.05 + day_share("weekend-12") * (3.94 - 2.05) == pytest.approx(2.90)
    own = Population(weekday=(0.25,) * 24)
    night, hour = population_maps(BLOCK, BLOCKS, ("night", "weekday-12"), own).density_per_km2
    np.testing.assert_allclose(hour[0], night[0] * np.array([1.5, 0.875, 0.875]))


def test_totals_add_up_by_zoning():
    totals = population_totals(BLOCKS)
    assert totals["night"] == {"commercial": 100.0, "residential": 400.0, "other": 200.0, "total": 700.0}
    assert totals["day"] == {"commercial": 300.0, "residential": 200.0, "other": 100.0, "total": 600.0}
    assert population_totals(BLOCKS, bounds_m=(110, 10, 190, 90))["night"]["total"] == 400.0
    box = (125.0, 0.0, 300.0, 50.0)  # three eighths of the residential block and half of the other one
    assert population_totals(BLOCKS, bounds_m=box)["night"]["total"] == 600.0
    inside = population_totals(BLOCKS, bounds_m=box, is_cut=True)
    assert inside["night"]["residential"] == pytest.approx(400 * 0.75 * 0.5)
    assert inside["night"]["other"] == pytest.approx(200 * 0.5)
    assert inside["day"]["total"] == pytest.approx(0.5 * inside["night"]["total"])


@pytest.mark.data
def test_the_night_density_map_of_manhattan_sums_to_its_census(data_dir):
    census, files = data_dir / "census", ("tl_2010_36061_tabblock10.shp", "DECENNIALSF12010.P1_nyc_blocks.csv")
    blocks, _ = read_blocks(Population(blocks=census / files[0], table=census / files[1]), "EPSG:32618")
    x_min, y_min, x_max, y_max = shapely.total_bounds(blocks.polygons)
    x_min, y_max, size = np.floor(x_min / 10) * 10, np.ceil(y_max / 10) * 10, 10.0
    shape = int((y_max - y_min) / size) + 1, int((x_max - x_min) / size) + 1
    outlines, place = zip(blocks.polygons, range(len(blocks)), strict=True), Affine(size, 0, x_min, 0, -size, y_max)
    block = rasterize(outlines, shape, fill=-1, transform=place, dtype="int32")
    maps = population_maps(jnp.asarray(block), blocks, ("night",))
    people = np.asarray(maps.density_per_km2, np.float64).sum() * size**2 / 1e6
    assert people == pytest.approx(1_585_873, rel=0.005)
