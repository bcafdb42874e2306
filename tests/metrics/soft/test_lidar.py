"""Soft lidar: its limit, its gradients, its batches."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.kernels.lidar import hard, soft
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from tests.metrics.soft.differences import anyhow, axes, check_gradient
from tests.metrics.soft.scene import ALTITUDE_M, CELLS, hills, scene, surface_of

PARAMS = Lidar(azimuths=24, range_m=40.0, beams=5, field_of_view_deg=(-15.0, 10.0))
HEIGHT_M, BUILDING = scene()
GROUNDS = {"flat": None, "hills": hills()}
SURFACES = {name: surface_of(HEIGHT_M.astype(np.float32), BUILDING, ground) for name, ground in GROUNDS.items()}


@jax.jit
def soft_map(surface, altitude_m, softness_m):
    return soft_lidar(surface, altitude_m, PARAMS, softness_m)


@pytest.mark.parametrize("ground", GROUNDS)
def test_softness_0_is_the_exact_map_and_each_halving_comes_nearer(ground):
    surface = SURFACES[ground]
    exact = compute_lidar(surface, [ALTITUDE_M], PARAMS)[0]
    assert 0.05 < exact.mean() < 0.95
    np.testing.assert_allclose(soft_map(surface, ALTITUDE_M, 0.0), exact, atol=1e-6)
    apart = [float(jnp.abs(soft_map(surface, ALTITUDE_M, 2.0**-power) - exact).mean()) for power in range(-3, 7)]
    assert (np.diff(apart) < 0).all()
    assert apart[-1] < 1e-3


@pytest.mark.parametrize("ground", GROUNDS)
def test_near_the_ground_softness_0_is_the_exact_map_too(ground):
    exact = compute_lidar(SURFACES[ground], [3.0], PARAMS)[0]
    np.testing.assert_allclose(soft_map(SURFACES[ground], 3.0, 0.0), exact, atol=1e-6)


def test_a_roof_at_the_altitude_is_an_obstacle_at_every_softness():
    surface = surface_of(np.full(len(HEIGHT_M), 20.0, np.float32), BUILDING)
    assert (soft_map(surface, 20.0, 1.0)[surface.crop(surface.roof_m) > 0] == 0).all()


def test_level_terrain_changes_nothing():
    level = surface_of(HEIGHT_M.astype(np.float32), BUILDING, np.full(BUILDING.shape, 30.0))
    np.testing.assert_allclose(soft_map(level, ALTITUDE_M, 1.0), soft_map(SURFACES["flat"], ALTITUDE_M, 1.0), atol=1e-5)


@pytest.mark.parametrize("ground", GROUNDS)
def test_gradients_agree_with_finite_differences_and_those_of_the_map_with_those_of_its_cells(ground):
    with jax.enable_x64(True):
        weight = jnp.linspace(0.5, 1.5, len(CELLS))
        inputs = {
            "height_m": HEIGHT_M,
            "altitude_m": ALTITUDE_M,
            "range_m": 39.0,
            "softness_m": 2.0,
            "terrain_m": GROUNDS[ground],
        }
        inputs = {name: jnp.asarray(value) for name, value in inputs.items() if value is not None}

        def total(inputs, cells):
            surface = surface_of(inputs["height_m"], BUILDING, inputs.get("terrain_m"))
            params = replace(PARAMS, range_m=inputs["range_m"])
            m = soft_lidar(surface, inputs["altitude_m"], params, inputs["softness_m"], cells=cells, reach_m=45.0)
            return (weight * (m[CELLS[:, 0], CELLS[:, 1]] if cells is None else m)).sum()

        of_cells, of_map = (jax.jit(jax.value_and_grad(lambda v, c=c: total(v, c))) for c in (CELLS, None))
        value, gradient = of_cells(inputs)
        directions = {name: [1.0] for name in ("altitude_m", "range_m", "softness_m")}
        directions["height_m"] = [*axes(gradient["height_m"], 4), anyhow(HEIGHT_M.shape)]
        if ground == "hills":
            directions["terrain_m"] = [anyhow(BUILDING.shape)]
        check_gradient(of_cells, inputs, directions)
        if ground == "flat":  # over terrain the map is made cell by cell
            value_of_map, gradient_of_map = of_map(inputs)
            np.testing.assert_allclose(value_of_map, value, rtol=1e-12)
            for name in inputs:
                np.testing.assert_allclose(gradient_of_map[name], gradient[name], rtol=1e-9, atol=1e-12)
        m = soft_map(SURFACES[ground], ALTITUDE_M, 2.0)
        assert m.dtype == jnp.float32


def test_one_compilation_serves_every_softness_altitude_range_and_height_and_batches_agree():
    compiled = 0

    @jax.jit
    def soft(height_m, altitude_m, params, softness_m):
        nonlocal compiled
        compiled += 1
        return soft_lidar(surface_of(height_m, BUILDING), altitude_m, params, softness_m, cells=CELLS, reach_m=40.0)

    height_m = jnp.asarray(HEIGHT_M, jnp.float32)
    steps = [(height_m * (1 + 0.1 * i), 20.0 + i, replace(PARAMS, range_m=40.0 - i), 2.0 / (1 + i)) for i in range(3)]
    one_by_one = jnp.stack([soft(*step) for step in steps])
    assert compiled == 1
    stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *steps)
    np.testing.assert_allclose(jax.vmap(soft)(*stacked), one_by_one, atol=1e-6)
    with jax.enable_x64(True):
        in_float64 = jax.jit(lambda h: soft_lidar(surface_of(h, BUILDING), 20.0, PARAMS, 2.0, cells=CELLS))(HEIGHT_M)
        assert in_float64.dtype == np.float64
        np.testing.assert_allclose(one_by_one[0], in_float64, atol=1e-5)


def test_a_traced_range_needs_a_reach_that_is_long_enough():
    with pytest.raises(InputError, match="reach_m"):
        jax.grad(lambda r: soft_lidar(SURFACES["flat"], 20.0, replace(PARAMS, range_m=r), 1.0).sum())(40.0)
    with pytest.raises(InputError, match="at least lidar range_m, 40 m"):
        soft_lidar(SURFACES["flat"], 20.0, PARAMS, 1.0, reach_m=30.0)
    with pytest.raises(InputError, match="softness_m must be 0"):
        soft_lidar(SURFACES["flat"], 20.0, PARAMS, -1.0)


def test_each_chosen_cell_may_have_an_altitude_of_its_own():
    z_m = jnp.linspace(8.0, 30.0, len(CELLS))
    expected = [soft_map(SURFACES["flat"], float(z), 2.0)[row, col] for z, (row, col) in zip(z_m, CELLS, strict=True)]
    np.testing.assert_allclose(soft_lidar(SURFACES["flat"], z_m, PARAMS, 2.0, cells=CELLS), expected, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("num_azimuths", [7, 80])  # a GPU takes them at once, or in two turns
def test_the_form_for_a_gpu_gives_the_values_and_gradients_of_the_one_for_a_cpu(num_azimuths):
    rng = np.random.default_rng(0)
    steps = hard.num_steps(5.0, 40.0)
    shape = 15 + 2 * (steps - 1), 12 + 2 * (steps - 1)
    roof_m = jnp.asarray(np.where(rng.random(shape) < 0.3, rng.uniform(5, 40, shape), 0.0))
    terrain_m = jnp.asarray(rng.uniform(0, 6, shape))
    offsets = hard.ray_offsets(num_azimuths, steps)
    cells = jnp.asarray(rng.integers(0, (15, 12), (20, 2)))
    weight = jnp.asarray(rng.uniform(0.5, 1.5, (15, 12)))

    def of_map(roof_m, terrain_m, altitude_m, range_m, form):
        scan = soft.scan_of(altitude_m, range_m, PARAMS.elevations_rad, 5.0)
        return (weight * form(roof_m, scan, offsets, jnp.asarray(2.0))).sum()

    def of_cells(roof_m, terrain_m, altitude_m, range_m, form):
        scan = soft.scan_of(0.0 * altitude_m, range_m, PARAMS.elevations_rad, 5.0)
        heights_m = altitude_m + jnp.arange(len(cells))
        at = soft.ScansAt(roof_m, terrain_m, heights_m, scan, offsets, jnp.asarray(2.0), cells)
        return (weight[cells[:, 0], cells[:, 1]] * form(at)).sum()

    of_all, at_cells = (soft.one_by_one, soft.together), (soft.one_by_one_at, soft.together_at)
    for total, ground_m, forms in ((of_map, None, of_all), (of_cells, None, at_cells), (of_cells, terrain_m, at_cells)):
        by = (0, 2, 3) if ground_m is None else (0, 1, 2, 3)
        arguments = roof_m, ground_m, jnp.asarray(15.0), jnp.asarray(39.0)
        cpu, gpu = (jax.jit(jax.value_and_grad(partial(total, form=form), by))(*arguments) for form in forms)
        np.testing.assert_allclose(gpu[0], cpu[0], rtol=1e-6)
        for found, expected in zip(gpu[1], cpu[1], strict=True):
            assert np.abs(expected).max() > 1e-3
            np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
