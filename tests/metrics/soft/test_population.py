"""Population as a function of its gammas and of the population of each block."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.metrics.population import BlockPopulation, Population, soft_population
from jaxurban.world.city import Blocks, Zoning
from tests.metrics.soft.differences import anyhow, check_gradient
from tests.metrics.whole_maps import population_maps

NUM_BLOCKS = 12
BOUNDS_M = (0.0, 0.0, 950.0, 100.0)  # the last two blocks lie beyond


def blocks() -> Blocks:
    rng = np.random.default_rng(0)
    west = 100.0 * np.arange(NUM_BLOCKS)
    zoning = rng.permutation(np.repeat([Zoning.COMMERCIAL, Zoning.RESIDENTIAL], NUM_BLOCKS // 2)).astype(np.uint8)
    return Blocks(
        polygons=shapely.box(west, 0.0, west + rng.uniform(40, 90, NUM_BLOCKS), 100.0),
        night_count=rng.uniform(10, 500, NUM_BLOCKS),
        district=np.zeros(NUM_BLOCKS, np.int32),
        zoning=zoning,
        block_id=np.arange(NUM_BLOCKS).astype(object),
    )


BLOCK = np.random.default_rng(1).integers(-1, NUM_BLOCKS, (6, 7)).astype(np.int32)


@pytest.mark.parametrize(("time_of_day", "normalise"), [("day", "max"), ("night", 30_000.0), ("weekend-20", "p80")])
def test_it_is_the_metrics_own_map(time_of_day, normalise):
    params = Population(normalise=normalise)
    expected = population_maps(jnp.asarray(BLOCK), blocks(), [time_of_day], params, BOUNDS_M).m[0]
    population = BlockPopulation.of(blocks(), BOUNDS_M)
    np.testing.assert_array_equal(soft_population(jnp.asarray(BLOCK), population, time_of_day, params), expected)
    cells = np.array([[0, 0], [5, 6], [2, 3]])
    at_cells = soft_population(jnp.asarray(BLOCK), population, time_of_day, params, cells=cells)
    np.testing.assert_array_equal(at_cells, expected[cells[:, 0], cells[:, 1]])


@pytest.mark.parametrize(
    ("quantity", "normalise"), [("density", "max"), ("density", "p80"), ("density", 150_000.0), ("count", "max")]
)
def test_gradients_agree_with_finite_differences(quantity, normalise):
    with jax.enable_x64(True):
        params = Population(normalise=normalise, quantity=quantity)
        population, weight = (
            BlockPopulation.of(blocks(), BOUNDS_M, np.float64),
            np.random.default_rng(2).uniform(size=BLOCK.shape),
        )

        @jax.jit
        @jax.value_and_grad
        def total(inputs):
            gammas = {name: inputs[name] for name in ("gamma_commercial", "gamma_residential")}
            those = population._replace(night_count=inputs["night_count"], area_m2=inputs["area_m2"])
            m = soft_population(jnp.asarray(BLOCK), those, "weekday-18", replace(params, **gammas))
            return (weight * m).sum()

        names = ("gamma_commercial", "gamma_residential", "night_count", "area_m2")
        inputs = {name: jnp.asarray(getattr(params if "gamma" in name else population, name)) for name in names}
        directions = {name: [1.0] if "gamma" in name else [anyhow((NUM_BLOCKS,))] for name in names}
        if quantity == "count":  # counts per block do not depend on its area
            assert (total(inputs)[1]["area_m2"] == 0).all()
            del directions["area_m2"]
        check_gradient(total, inputs, directions)


def test_gammas_are_leaves_of_the_settings_and_batches_take_no_new_compilation():
    compiled, population = 0, BlockPopulation.of(blocks(), BOUNDS_M)

    @jax.jit
    def m(params, night_count):
        nonlocal compiled
        compiled += 1
        return soft_population(jnp.asarray(BLOCK), population._replace(night_count=night_count), "day", params)

    several = [Population(gamma_commercial=g, gamma_residential=h) for g, h in ((3.0, 0.5), (2.0, 0.7))]
    one_by_one = jnp.stack([m(params, population.night_count) for params in several])
    assert compiled == 1
    stacked = jax.tree.map(lambda *gammas: jnp.asarray(gammas), *several)
    np.testing.assert_allclose(jax.vmap(m, (0, None))(stacked, population.night_count), one_by_one, rtol=1e-6)


def test_given_settings_are_still_checked():
    with pytest.raises(InputError, match="gamma_commercial"):
        Population(gamma_commercial=jnp.asarray(-1.0))
    with pytest.raises(InputError, match="gamma_residential"):
        jax.tree.map(lambda leaf: leaf, replace(Population(), gamma_residential=np.nan))
