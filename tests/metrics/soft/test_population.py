"""Population as a function of its gammas and of the population of each block."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from jaxurban.metrics.population import BlockPopulation, Population, soft_population
from jaxurban.world.city import Blocks, Zoning
from tests.metrics.soft.scene import check_gradient
from tests.metrics.whole_maps import population_maps

NUM_BLOCKS = 12
BOUNDS_M = (0.0, 0.0, 950.0, 100.0)  # the last two blocks lie beyond
RNG = np.random.default_rng(0)
ZONING = RNG.permutation(np.repeat([Zoning.COMMERCIAL, Zoning.RESIDENTIAL], NUM_BLOCKS // 2)).astype(np.uint8)
WEST_M = 100.0 * np.arange(NUM_BLOCKS)
BLOCKS = Blocks(
    polygons=shapely.box(WEST_M, 0.0, WEST_M + RNG.uniform(40, 90, NUM_BLOCKS), 100.0),
    night_count=RNG.uniform(10, 500, NUM_BLOCKS),
    district=np.zeros(NUM_BLOCKS, np.int32),
    zoning=ZONING,
    block_id=np.arange(NUM_BLOCKS).astype(object),
)
BLOCK = jnp.asarray(np.random.default_rng(1).integers(-1, NUM_BLOCKS, (6, 7)), jnp.int32)


@pytest.mark.parametrize(("time_of_day", "normalise"), [("day", "max"), ("night", 30_000.0), ("weekend-20", "p80")])
def test_it_is_the_metrics_own_map(time_of_day, normalise):
    params = Population(normalise=normalise)
    expected = population_maps(BLOCK, BLOCKS, [time_of_day], params, BOUNDS_M).m[0]
    population, cells = BlockPopulation.of(BLOCKS, BOUNDS_M), np.array([[0, 0], [5, 6], [2, 3]])
    np.testing.assert_array_equal(soft_population(BLOCK, population, time_of_day, params), expected)
    at_cells = soft_population(BLOCK, population, time_of_day, params, cells=cells)
    np.testing.assert_array_equal(at_cells, expected[*cells.T])


@pytest.mark.parametrize(
    ("quantity", "normalise"), [("density", "max"), ("density", "p80"), ("density", 150_000.0), ("count", "max")]
)
def test_gradients_agree_with_finite_differences(quantity, normalise):
    params = Population(normalise=normalise, quantity=quantity)
    with jax.enable_x64(True):
        population, weight = BlockPopulation.of(BLOCKS, BOUNDS_M, np.float64), RNG.uniform(size=BLOCK.shape)

        @jax.jit
        @jax.value_and_grad
        def total(inputs):
            gammas = {name: inputs[name] for name in ("gamma_commercial", "gamma_residential")}
            those = population._replace(night_count=inputs["night_count"], area_m2=inputs["area_m2"])
            return (weight * soft_population(BLOCK, those, "weekday-18", replace(params, **gammas))).sum()

        gammas = {"gamma_commercial": jnp.asarray(2.0), "gamma_residential": jnp.asarray(0.6)}
        inputs = {"night_count": population.night_count, "area_m2": population.area_m2} | gammas
        check_gradient(total, inputs, zero={"area_m2"} if quantity == "count" else ())


def test_gammas_are_leaves_of_the_settings_and_batches_take_no_new_compilation():
    population = BlockPopulation.of(BLOCKS, BOUNDS_M)

    @jax.jit
    def m(params, night_count):
        return soft_population(BLOCK, population._replace(night_count=night_count), "day", params)

    several = [Population(gamma_commercial=g, gamma_residential=h) for g, h in ((3.0, 0.5), (2.0, 0.7))]
    one_by_one = jnp.stack([m(params, population.night_count) for params in several])
    assert m._cache_size() == 1
    stacked = jax.tree.map(lambda *gammas: jnp.asarray(gammas), *several)
    np.testing.assert_allclose(jax.vmap(m, (0, None))(stacked, population.night_count), one_by_one, rtol=1e-6)
