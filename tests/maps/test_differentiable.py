"""SoftCity: cost layers and path costs as functions of heights, parameters and weights."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.maps.differentiable import CELLS_STEP, SoftCity, SoftParams, path_visits
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.population import BlockPopulation, Population
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.visibility import SkyView
from jaxurban.metrics.weights import Weights
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.planners.envelope import planned_cost
from jaxurban.world.city import Zoning
from tests.metrics.soft.scene import ALTITUDE_M, BUILDING, HEIGHT_M, REGION, check_gradient, surface_of
from tests.metrics.whole_maps import compute_gps

AZIMUTH_RAD = np.radians([10.0, 80.0, 190.0, 285.0, 140.0])
ELEVATION_RAD = np.radians([35.0, 50.0, 25.0, 40.0, 65.0])
LIDAR = Lidar(beams=2, field_of_view_deg=(-9.0, 6.0), azimuths=16, range_m=33.0)
SECTIONS = {"gps": Gps(20.0), "lidar": LIDAR, "risk": Risk(37.0), "population": Population(normalise=400_000.0)}
PARAMS = SoftParams(ALTITUDE_M, 2.0, SECTIONS)
WEIGHTS = Weights(0.05, gps=1.0, lidar=0.7, population=0.4, risk=1.2)
START, GOAL = (1, 1), (13, 16)
REACH_M = (("gps", 0.0), ("lidar", 40.0), ("population", 0.0), ("risk", 40.0))


def city(dtype=np.float64):
    block = np.arange(REGION.num_rows)[:, None] // 4 * 3 + np.arange(REGION.num_cols)[None] // 6
    surface = replace(surface_of(HEIGHT_M.astype(dtype), BUILDING), block=jnp.asarray(block, jnp.int32))
    zoning = np.where(np.arange(12) % 2, Zoning.COMMERCIAL, Zoning.RESIDENTIAL)
    population = BlockPopulation(
        jnp.linspace(20.0, 120.0, 12, dtype=dtype), jnp.full(12, 600.0, dtype), jnp.asarray(zoning), jnp.arange(12)
    )
    view = SkyView.of(surface, AZIMUTH_RAD, ELEVATION_RAD)
    height_m = jnp.asarray(HEIGHT_M, dtype)
    return SoftCity(surface, jnp.asarray(BUILDING), height_m, view, population, reach_m=REACH_M)


@jax.jit
def layers_of(soft, height_m, params):
    return soft.layers(height_m, params)


@jax.jit
def cost_and_slopes(soft, height_m, params, weights, visits):
    return jax.value_and_grad(soft.path_cost, (0, 1, 2))(height_m, params, weights, visits)


def vector_of(soft, weights):
    return jnp.append(weights.distance, soft.layer_weights(weights))


def with_sections(**sections):
    return replace(PARAMS, sections={**PARAMS.sections, **sections})


@pytest.fixture
def soft():
    """The city in float64."""
    with jax.enable_x64(True):
        yield city()


def problem_of(soft, cost_model="cell"):
    """The planning question on the soft layers; obstacles are those of the city's own heights."""
    costs = np.asarray(layers_of(soft, soft.height_m, PARAMS))
    is_free = np.asarray(soft.surface.crop(soft.surface.roof_m)) < ALTITUDE_M
    return Problem(costs, is_free, START, GOAL, REGION.resolution_m, vector_of(soft, WEIGHTS), cost_model)


def visits_of(problem):
    return path_visits(astar(problem).points_m, REGION.shape, REGION.resolution_m, problem.cost_model)


def test_softness_0_gives_the_costs_of_the_exact_maps(soft):
    found = dict(zip(soft.names, layers_of(soft, soft.height_m, replace(PARAMS, softness_m=0.0)), strict=True))
    surface = surface_of(HEIGHT_M.astype(np.float32), BUILDING)
    for name, m in (
        ("gps", compute_gps(surface, AZIMUTH_RAD, ELEVATION_RAD, [ALTITUDE_M], SECTIONS["gps"]).m),
        ("lidar", compute_lidar(surface, [ALTITUDE_M], LIDAR)),
        ("risk", compute_risk(surface, [ALTITUDE_M], SECTIONS["risk"])),
    ):
        np.testing.assert_allclose(found[name], 1 - m[0], atol=2e-6, err_msg=name)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_path_on_chosen_cells_costs_what_the_whole_maps_do(soft, cost_model):
    problem = problem_of(soft, cost_model)
    found = astar(problem)
    visits = visits_of(problem)
    assert visits.cells.shape == (CELLS_STEP, 2)
    cost, _ = cost_and_slopes(soft, soft.height_m, PARAMS, WEIGHTS, visits)
    np.testing.assert_allclose(cost, found.cost, rtol=1e-12)
    np.testing.assert_allclose(visits.length_m, problem.features(found.points_m).phi[0])


def test_the_gradient_of_a_path_agrees_with_finite_differences_in_everything(soft):
    visits = visits_of(problem_of(soft))
    leaves, shape = jax.tree.flatten((soft.height_m, PARAMS, WEIGHTS))
    inputs = {str(number): jnp.asarray(leaf) for number, leaf in enumerate(leaves)}

    def value_and_gradient(inputs):
        numbers = [leaf if leaf.ndim else float(leaf) for leaf in inputs.values()]  # the program of the other tests
        value, slopes = cost_and_slopes(soft, *jax.tree.unflatten(shape, numbers), visits)
        return value, dict(zip(inputs, jax.tree.leaves(slopes), strict=True))

    check_gradient(value_and_gradient, inputs)


def test_the_gradient_of_the_path_is_that_of_replanned_costs(soft):
    problem = problem_of(soft)
    _, (by_height, by_params, _) = cost_and_slopes(soft, soft.height_m, PARAMS, WEIGHTS, visits_of(problem))

    def replanned(height_m=soft.height_m, params=PARAMS):
        return astar(problem.with_costs(np.asarray(layers_of(soft, height_m, params)))).cost

    for building in np.argsort(-np.abs(by_height))[:3]:
        step = 1e-5 * np.eye(len(HEIGHT_M))[building]
        slope = (replanned(soft.height_m + step) - replanned(soft.height_m - step)) / 2e-5
        np.testing.assert_allclose(by_height[building], slope, rtol=1e-4)
    ends = [replanned(params=with_sections(risk=Risk(37.0 + step))) for step in (1e-5, -1e-5)]
    np.testing.assert_allclose(by_params.sections["risk"].threshold_m, (ends[0] - ends[1]) / 2e-5, rtol=1e-4)


@pytest.mark.slow
def test_the_gradient_through_the_planner_and_the_whole_maps_is_that_of_the_path(soft):
    problem = problem_of(soft)
    planned = planned_cost(problem, astar)

    def optimal(height_m, params, weights):
        return planned(soft.layers(height_m, params), vector_of(soft, weights))

    inputs = (soft.height_m, PARAMS, WEIGHTS)
    through_maps = jax.jit(jax.grad(optimal, (0, 1, 2)))(*inputs)
    _, of_the_path = cost_and_slopes(soft, *inputs, visits_of(problem))
    for one, other in zip(jax.tree.leaves(through_maps), jax.tree.leaves(of_the_path), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_one_program_serves_other_values_and_other_skies(soft):
    first = layers_of(soft, soft.height_m, PARAMS)
    compiled = layers_of._cache_size()
    for arguments in (
        (soft, soft.height_m + 1, PARAMS),
        (replace(soft, view=SkyView.of(soft.surface, AZIMUTH_RAD + 0.3, ELEVATION_RAD)), soft.height_m, PARAMS),
        (soft, soft.height_m, replace(with_sections(risk=Risk(25.0)), altitude_m=31.0, softness_m=0.5)),
        (soft, soft.height_m, with_sections(gps=Gps(9.0), lidar=replace(LIDAR, range_m=21.0))),
    ):
        assert float(jnp.abs(layers_of(*arguments) - first).max()) > 1e-3
    assert layers_of._cache_size() == compiled == 1


def test_a_city_without_people_has_no_such_layer():
    soft = replace(city(np.float32), population=None)
    assert soft.names == ("gps", "lidar", "risk")
    np.testing.assert_allclose(soft.layer_weights(WEIGHTS), [1.0, 0.7, 1.2])
