"""Soft risk: its limits, its gradients, its batches."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.metrics.risk import Risk, compute_risk, soft_risk
from tests.metrics.soft.differences import anyhow, axes, check_gradient
from tests.metrics.soft.scene import ALTITUDE_M, CELLS, hills, scene, surface_of

SLICE = Risk(threshold_m=40.0)
SOLID = Risk(threshold_m=40.0, distance="solid")
HEIGHT_M, BUILDING = scene(24, seed=3)
FLAT = surface_of(HEIGHT_M.astype(np.float32), BUILDING)


@jax.jit
def soft_map(surface, altitude_m, params, softness_m):
    return soft_risk(surface, altitude_m, params, softness_m, reach_m=40.0)


def test_softness_0_is_the_slice_and_softness_of_the_threshold_the_solid():
    for softness_m, params in ((0.0, SLICE), (40.0, SOLID)):
        exact = compute_risk(FLAT, [ALTITUDE_M], params)[0]
        assert 0.05 < exact.mean() < 0.95
        np.testing.assert_allclose(soft_map(FLAT, ALTITUDE_M, SLICE, softness_m), exact, atol=1e-6)


@pytest.mark.parametrize("ground", [None, hills()])
def test_solid_has_no_softness(ground):
    surface = surface_of(HEIGHT_M.astype(np.float32), BUILDING, ground)
    exact = compute_risk(surface, [ALTITUDE_M], SOLID)[0]
    np.testing.assert_allclose(soft_map(surface, ALTITUDE_M, SOLID, 3.0), exact, atol=1e-5)


def test_each_halving_of_softness_comes_nearer_until_no_roof_lies_so_little_below():
    exact = compute_risk(FLAT, [ALTITUDE_M], SLICE)[0]
    apart = np.array([float(jnp.abs(soft_map(FLAT, ALTITUDE_M, SLICE, 2.0**-p) - exact).mean()) for p in range(-5, 8)])
    is_apart = apart[:-1] > 1e-6
    assert is_apart.sum() > 3
    assert (np.diff(apart)[is_apart] < 0).all()
    assert apart[-1] < 1e-6


def test_a_roof_at_the_altitude_is_an_obstacle_at_every_softness():
    surface = surface_of(np.full(len(HEIGHT_M), 20.0, np.float32), BUILDING)
    exact = compute_risk(surface, [20.0], SLICE)[0]
    np.testing.assert_allclose(soft_map(surface, 20.0, SLICE, 2.0), exact, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("params", "ground"), [(SLICE, None), (SOLID, None), (SOLID, hills())], ids=["slice", "solid", "solid-hills"]
)
def test_gradients_agree_with_finite_differences_and_those_of_the_map_with_those_of_its_cells(params, ground):
    with jax.enable_x64(True):
        inputs = {
            "height_m": HEIGHT_M,
            "altitude_m": ALTITUDE_M,
            "threshold_m": 39.0,
            "softness_m": 12.0,
            "terrain_m": ground,
        }
        inputs = {name: jnp.asarray(value) for name, value in inputs.items() if value is not None}
        row, col = np.indices(FLAT.region.shape)
        cells = np.stack([row.ravel(), col.ravel()], axis=1)
        weight = jnp.linspace(0.5, 1.5, len(cells))

        def total(inputs, cells):
            surface = surface_of(inputs["height_m"], BUILDING, inputs.get("terrain_m"))
            chosen = replace(params, threshold_m=inputs["threshold_m"])
            m = soft_risk(surface, inputs["altitude_m"], chosen, inputs["softness_m"], cells=cells, reach_m=40.0)
            return (weight * m.ravel()).sum()

        of_map, of_cells = (jax.jit(jax.value_and_grad(lambda v, c=c: total(v, c))) for c in (None, cells))
        value, gradient = of_map(inputs)
        directions = {name: [1.0] for name in ("altitude_m", "threshold_m")}
        directions["height_m"] = [*axes(gradient["height_m"], 2), anyhow(HEIGHT_M.shape)]
        if params is SLICE:
            directions["softness_m"] = [1.0]
        else:
            assert gradient["softness_m"] == 0
        if ground is not None:
            directions["terrain_m"] = [anyhow(BUILDING.shape)]
        check_gradient(of_map, inputs, directions)
        if params is SLICE:
            value_at_cells, gradient_at_cells = of_cells(inputs)
            np.testing.assert_allclose(value_at_cells, value, rtol=1e-12)
            for name in directions.keys() - {"height_m"}:  # of several nearest roofs each may choose another
                np.testing.assert_allclose(gradient_at_cells[name], gradient[name], rtol=1e-9)


def test_the_exact_slice_has_the_exact_gradient_in_the_threshold():
    m = soft_map(FLAT, ALTITUDE_M, SLICE, 0.0)
    gradient = jax.jit(jax.grad(lambda params: soft_map(FLAT, ALTITUDE_M, params, 0.0).sum()))(SLICE)
    assert isinstance(gradient, Risk)
    np.testing.assert_allclose(gradient.threshold_m, -jnp.where(m < 1, m, 0.0).sum() / 40, rtol=1e-5)


def test_a_roof_above_the_altitude_has_no_gradient_and_one_below_brings_risk_as_it_grows():
    height_m = jnp.asarray(np.where(np.arange(len(HEIGHT_M)) % 2, 30.0, 18.0))
    gradient = jax.jit(jax.grad(lambda h: soft_map(surface_of(h, BUILDING), 20.0, SLICE, 4.0).sum()))(height_m)
    assert (gradient[1::2] == 0).all()
    assert (gradient[::2] <= 0).all()
    assert (gradient[::2] < 0).any()


def test_one_compilation_serves_every_softness_altitude_threshold_and_height_and_batches_agree():
    compiled = 0

    @jax.jit
    def soft(height_m, altitude_m, params, softness_m):
        nonlocal compiled
        compiled += 1
        return soft_risk(surface_of(height_m, BUILDING), altitude_m, params, softness_m, cells=CELLS, reach_m=40.0)

    height_m = jnp.asarray(HEIGHT_M, jnp.float32)
    steps = [(height_m * (1 + 0.1 * i), 20.0 + i, Risk(40.0 - i), 2.0 / (1 + i)) for i in range(3)]
    one_by_one = jnp.stack([soft(*step) for step in steps])
    assert compiled == 1
    stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *steps)
    batched = jax.vmap(soft)(*stacked)
    np.testing.assert_allclose(batched, one_by_one, atol=1e-6)
    assert batched.dtype == jnp.float32


def test_a_traced_threshold_needs_a_reach():
    with pytest.raises(InputError, match="risk threshold_m is traced by JAX: give reach_m"):
        jax.grad(lambda d: soft_risk(FLAT, 20.0, Risk(d), 1.0).sum())(40.0)


def test_each_chosen_cell_may_have_an_altitude_of_its_own():
    z_m = jnp.linspace(8.0, 30.0, len(CELLS))
    expected = [soft_map(FLAT, float(z), SLICE, 4.0)[row, col] for z, (row, col) in zip(z_m, CELLS, strict=True)]
    np.testing.assert_allclose(soft_risk(FLAT, z_m, SLICE, 4.0, cells=CELLS), expected, atol=1e-6)
