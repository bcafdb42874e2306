"""The maps as one pure function, jitted, mapped over, exported; cost layers and path costs as soft functions."""

from dataclasses import replace

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.at_once import all_maps, inputs_of, skies_of
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.differentiable import CELLS_STEP, SoftCity, SoftParams, path_visits
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Dop, Gps
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.population import BlockPopulation, Population
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.visibility import SkyView
from jaxurban.metrics.weights import Weights
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.planners.envelope import planned_cost
from jaxurban.world.blocks import Zoning
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from tests import hanging_city
from tests.metrics.soft.scene import (
    ALTITUDE_M,
    BUILDING,
    HEIGHT_M,
    REGION,
    check_gradient,
    surface_of,
)
from tests.metrics.whole_maps import compute_gps

TIMES = [f"2020-04-27T{hour:02d}:30:00Z" for hour in (0, 6)]
SCAN = Lidar(beams=2, field_of_view_deg=(-9.0, 6.0), azimuths=16, range_m=33.0)
SECTIONS = {
    "gps": Gps(10.0, times=TIMES),
    "gps_horizontal": Dop(10.0),
    "lidar": SCAN,
    "risk": Risk(37.0),
}
PARAMS = MapParams(altitudes_m=(20.0, 60.0), sections=SECTIONS)
TYPES = {
    "obstacle",
    "gps",
    "gdop",
    "hdop",
    "num_visible",
    "lidar",
    "risk",
    "population",
    "density",
    "gps_horizontal",
}
one = jax.jit(all_maps)


@pytest.fixture(scope="module")
def task():
    city = ju.demo_city(900, 900)
    first_col, first_row = (round(edge / 10) + 20 for edge in city.extent_m[:2])
    region = Grid(city.crs, 10.0, first_row, first_col, 48, 40)
    return MapTask(city, region, view_sky(region, ju.Gps(times=TIMES)), PARAMS)


@pytest.fixture(scope="module")
def inputs(task):
    return inputs_of(task)


@pytest.fixture(scope="module")
def views(task, inputs):
    return skies_of(task, inputs.surface)


def at(views, t):
    return jax.tree.map(lambda values: values[t], views)


def assert_same(name, found, expected):
    """Bit for bit, but for the last bit of what the population's programs round."""
    np.testing.assert_allclose(
        found, expected, rtol=2e-7 if name in ("population", "density") else 0, err_msg=name
    )


def assert_as_kept(maps, expected, t=0):
    """Maps of one function are those of the recipe, which misses values inside obstacles."""
    is_obstacle = np.asarray(maps["obstacle"]) == 1
    for name, values in maps.items():
        array = expected[name]
        held = array.values[t] if "time" in array.dims else array.values
        if "altitude" in array.dims and array.dtype.kind == "f":
            assert np.isnan(held[is_obstacle]).all(), name
            held, values = held[~is_obstacle], np.asarray(values)[~is_obstacle]
        assert_same(name, values, held)


@pytest.mark.slow
def test_it_gives_the_bits_of_the_recipe(task, inputs, views):
    expected = compute_maps(task).ds
    for t in range(task.num_times):
        found = one(inputs, at(views, t))
        assert_as_kept(found, expected, t)
    assert {*found} >= TYPES
    assert all(name == "obstacle" or len(np.unique(values)) > 5 for name, values in found.items())
    assert np.isfinite(found["lidar"]).all()


@pytest.mark.slow
def test_over_terrain_and_where_it_is_unknown_the_bits_are_equal_and_the_cost_s_derivatives_finite(
    task,
):
    x_min, _, _, y_max = task.city.extent_m
    hills_m = 15 * np.sin(np.arange(40) / 5)[:, None] * np.cos(np.arange(40) / 7)
    hills_m[:, :15] = np.nan
    place = (30.0, 0.0, x_min - 150, 0.0, -30.0, y_max + 150), task.city.crs
    task = replace(
        task, city=replace(task.city, terrain=Raster(hills_m.astype(np.float32), *place))
    )
    inputs, expected = inputs_of(task), compute_maps(task).ds
    has_data = expected["has_data"].values
    assert 0.1 < has_data.mean() < 0.9
    sky = at(skies_of(task, inputs.surface), 0)
    maps = one(inputs, sky, {})
    np.testing.assert_array_equal(
        np.isnan(maps["cost"]), np.broadcast_to(~has_data, maps["cost"].shape)
    )
    assert_as_kept({name: values for name, values in maps.items() if name != "cost"}, expected)
    by_risk = jax.grad(
        lambda risk: jnp.nansum(all_maps(inputs, sky, ju.Weights(risk=risk))["cost"])
    )(2.0)
    risk_cost = 1 - maps["risk"]
    assert float(by_risk) == pytest.approx(maps["cost"].shape[1] * np.nansum(risk_cost), rel=1e-4)


@pytest.mark.slow
def test_over_times_it_is_every_time_s_maps(task, inputs, views):
    assert (
        len({len(task.in_view(t).numbers) for t in range(task.num_times)}) > 1
    )  # some skies are filled up
    made = jax.jit(jax.vmap(all_maps, (None, 0)))(inputs, views)
    for t in range(task.num_times):
        for name, values in one(inputs, at(views, t)).items():
            assert_same(name, made[name][t], values)


@pytest.mark.slow
def test_it_maps_over_five_cities_of_one_shape_their_skies_and_thresholds():
    """Each city lies elsewhere and has its own time; one program gives what each gives alone."""
    made, expected = [], []
    for seed in range(5):
        city = ju.demo_city(600, 500, seed=seed, centre_lonlat=(20.0 * seed - 70.0, 8.0 * seed))
        first_col, first_row = (round(edge / 10) + 10 for edge in city.extent_m[:2])
        grid = Grid(city.crs, 10.0, first_row, first_col, 30, 36)
        gps = Gps(10.0 + seed, times=f"2020-04-27T{3 * seed:02d}:00:00Z")
        given = {"altitudes_m": (20.0 + seed, 60.0), "gps": gps, "lidar": SCAN}
        given["population"] = ju.Population(credit=f"census {seed}", commercial=[seed])
        made.append(ju.grad.map_inputs(city, grid, **given))
        expected.append(ju.build_maps(city, grid=grid, progress=False, **given).ds)
    most = max(len(views.satellites.rows[0]) for _, views in made)
    filled = [(inputs, padded(views, most)) for inputs, views in made]
    stack = jax.tree.map(lambda *values: jnp.stack(values), *filled)
    maps = jax.jit(jax.vmap(jax.vmap(all_maps, (None, 0))))(*stack)
    for k in range(5):
        is_obstacle = np.asarray(maps["obstacle"][k, 0]) == 1
        for name in ("obstacle", "num_visible", "lidar", "risk", "gdop", "gps", "population"):
            found, held = np.asarray(maps[name][k, 0]), expected[k][name].values
            held = held[0] if "time" in expected[k][name].dims else held
            if "altitude" in expected[k][name].dims:
                found, held = found[~is_obstacle], held[~is_obstacle]
            # The metric of GPS is 1 less a quotient, which is rounded where it is near 1.
            atol = 2e-7 if name == "gps" else 0
            np.testing.assert_allclose(found, held, rtol=1e-6, atol=atol, err_msg=name)
    assert len({float(np.nanmean(ds["gps"])) for ds in expected}) == 5


def padded(views: SkyView, most: int) -> SkyView:
    """Return skies filled up to so many satellites."""
    num = most - views.lines.drop_m.shape[1]

    def fill(values, axis):
        widths = [(0, num if k == axis else 0) for k in range(values.ndim)]
        return jnp.pad(values, widths)

    lines = type(views.lines)(*(fill(values, 1) for values in views.lines))
    geometry = views.satellites
    satellites = geometry._replace(
        rows=fill(geometry.rows, 1),
        members=fill(geometry.members, 2),
        weights=fill(geometry.weights, 1),
    )
    return SkyView(lines, satellites, views.num)


@pytest.mark.slow
def test_it_maps_over_sixteen_skies_thresholds_gammas_heights_and_weights(inputs, views):
    many = jax.tree.map(lambda values: jnp.concatenate([values] * 8), views)
    assert jax.eval_shape(jax.vmap(all_maps, (None, 0)), inputs, many)["gps"].shape == (
        16,
        2,
        48,
        40,
    )
    sky, given = at(views, 0), inputs.settings
    plain = one(inputs, sky)

    def over(values, change):
        return jax.vmap(lambda value: all_maps(replace(inputs, **change(value)), sky))(
            jnp.asarray(values)
        )

    def with_leaf(metric, name):
        return lambda value: {"settings": given | {metric: replace(given[metric], **{name: value})}}

    some = over([5.0, 10.0], with_leaf("gps", "gdop_threshold"))["gps"]
    np.testing.assert_array_equal(some[1], plain["gps"])
    assert np.mean(some[0]) < np.mean(some[1])
    some = over([1.0, 3.0], with_leaf("population", "gamma_commercial"))["population"]
    assert_same("population", some[1], plain["population"])
    roof_m = inputs.surface.roof_m
    some = over(
        [1.0, 0.0], lambda share: {"surface": replace(inputs.surface, roof_m=share * roof_m)}
    )
    assert some["obstacle"][0].any()
    assert not some["obstacle"][1].any()
    np.testing.assert_array_equal(some["lidar"][0], plain["lidar"])
    costs = jax.vmap(lambda risk: all_maps(inputs, sky, ju.Weights(risk=risk))["cost"])(
        jnp.asarray([1.0, 3.0])
    )
    more = np.broadcast_to(2 * (1 - plain["risk"])[:, None], costs[0].shape)
    np.testing.assert_allclose(costs[1] - costs[0], more, atol=1e-5)


@pytest.mark.slow
def test_it_is_exported_for_cpu_and_cuda_and_read_back(inputs, views):
    sky = at(views, 0)
    leaves, tree = jax.tree.flatten((inputs, sky))
    run = jax.jit(lambda *leaves: all_maps(*jax.tree.unflatten(tree, leaves)))
    exported = jax.export.export(run, platforms=["cpu", "cuda"])(*leaves)
    found = jax.export.deserialize(exported.serialize()).call(*leaves)
    for name, values in one(inputs, sky).items():
        assert_same(name, found[name], values)


def test_from_a_notebook_it_is_given_the_inputs_of_build_maps(task, inputs, views):
    found = ju.grad.map_inputs(task.city, task.region, altitudes_m=PARAMS.altitudes_m, **SECTIONS)
    assert jax.tree.structure(found) == jax.tree.structure((inputs, views))
    for ours, given in zip(jax.tree.leaves((inputs, views)), jax.tree.leaves(found), strict=True):
        np.testing.assert_array_equal(given, ours)
    assert ju.grad.all_maps is all_maps
    with pytest.raises(InputError, match=r"sky must be of one time, got 2: take jax\.vmap"):
        all_maps(inputs, views)


def test_what_it_does_not_know_and_what_build_maps_refuses_is_refused(task):
    refused = [
        (lambda: ju.grad.map_inputs(5, task.region), "city must be City"),
        (
            lambda: ju.grad.map_inputs(task.city, task.region, gps=ju.Gps(times=[])),
            "times must be different UTC times",
        ),
        (
            lambda: ju.grad.map_inputs(task.city, replace(task.region, crs="EPSG:32633")),
            "the grid in the city's CRS",
        ),
        (
            lambda: ju.grad.map_inputs(task.city, replace(task.region, first_row=0)),
            "region and the city do not meet",
        ),
        (
            lambda: inputs_of(replace(task, params=replace(PARAMS, oversample=3))),
            "hold no oversample",
        ),
        (lambda: inputs_of(hanging_city.task(hanging_city.city())), "hold no slabs"),
    ]
    for call, words in refused:
        with pytest.raises(InputError, match=words):
            call()
    _, skies = ju.grad.map_inputs(task.city, task.region, gps=ju.Gps(times=TIMES[0]))
    assert skies.num.shape == (1,)


AZIMUTH_RAD = np.radians([10.0, 80.0, 190.0, 285.0, 140.0])
ELEVATION_RAD = np.radians([35.0, 50.0, 25.0, 40.0, 65.0])
SOFT_SECTIONS = {
    "gps": Gps(20.0),
    "lidar": SCAN,
    "risk": Risk(37.0),
    "population": Population(normalise=400_000.0),
}
SOFT = SoftParams(ALTITUDE_M, 2.0, SOFT_SECTIONS)
WEIGHTS = Weights(0.05, gps=1.0, lidar=0.7, population=0.4, risk=1.2)
START, GOAL = (1, 1), (13, 16)
REACH_M = (("gps", 0.0), ("lidar", 40.0), ("population", 0.0), ("risk", 40.0))


def soft_city(dtype=np.float64):
    block = np.arange(REGION.num_rows)[:, None] // 4 * 3 + np.arange(REGION.num_cols)[None] // 6
    surface = replace(
        surface_of(HEIGHT_M.astype(dtype), BUILDING), block=jnp.asarray(block, jnp.int32)
    )
    zoning = np.where(np.arange(12) % 2, Zoning.COMMERCIAL, Zoning.RESIDENTIAL)
    population = BlockPopulation(
        jnp.linspace(20.0, 120.0, 12, dtype=dtype),
        jnp.full(12, 600.0, dtype),
        jnp.asarray(zoning),
        jnp.arange(12),
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
    return replace(SOFT, sections={**SOFT.sections, **sections})


@pytest.fixture
def soft():
    """The city in float64."""
    with jax.enable_x64(True):
        yield soft_city()


def test_a_soft_city_shows_how_large_it_is_and_its_layers(soft):
    num = len(HEIGHT_M)
    cells = f"{BUILDING.shape} cells, {num} buildings"
    assert repr(soft) == f"SoftCity(city: {cells}; layers: gps, lidar, population, risk)"


def problem_of(soft, cost_model="cell"):
    """The planning question on the soft layers; obstacles are those of the city's own heights."""
    costs = np.asarray(layers_of(soft, soft.height_m, SOFT))
    is_free = np.asarray(soft.surface.crop(soft.surface.roof_m)) < ALTITUDE_M
    return Problem(
        costs, is_free, START, GOAL, REGION.resolution_m, vector_of(soft, WEIGHTS), cost_model
    )


def visits_of(problem):
    return path_visits(
        astar(problem).points_m, REGION.shape, REGION.resolution_m, problem.cost_model
    )


@pytest.mark.slow
def test_softness_0_gives_the_costs_of_the_exact_maps(soft):
    found = dict(
        zip(soft.names, layers_of(soft, soft.height_m, replace(SOFT, softness_m=0.0)), strict=True)
    )
    surface = surface_of(HEIGHT_M.astype(np.float32), BUILDING)
    for name, m in (
        (
            "gps",
            compute_gps(surface, AZIMUTH_RAD, ELEVATION_RAD, [ALTITUDE_M], SOFT_SECTIONS["gps"]).m,
        ),
        ("lidar", compute_lidar(surface, [ALTITUDE_M], SCAN)),
        ("risk", compute_risk(surface, [ALTITUDE_M], SOFT_SECTIONS["risk"])),
    ):
        np.testing.assert_allclose(found[name], 1 - m[0], atol=2e-6, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_a_path_on_chosen_cells_costs_what_the_whole_maps_do(soft, cost_model):
    problem = problem_of(soft, cost_model)
    found = astar(problem)
    visits = visits_of(problem)
    assert visits.cells.shape == (CELLS_STEP, 2)
    cost, _ = cost_and_slopes(soft, soft.height_m, SOFT, WEIGHTS, visits)
    np.testing.assert_allclose(cost, found.cost, rtol=1e-12)
    np.testing.assert_allclose(visits.length_m, problem.features(found.points_m).phi[0])


@pytest.mark.slow
def test_the_gradient_of_a_path_agrees_with_finite_differences_in_everything(soft):
    visits = visits_of(problem_of(soft))
    leaves, shape = jax.tree.flatten((soft.height_m, SOFT, WEIGHTS))
    inputs = {str(number): jnp.asarray(leaf) for number, leaf in enumerate(leaves)}

    def value_and_gradient(inputs):
        numbers = [
            leaf if leaf.ndim else float(leaf) for leaf in inputs.values()
        ]  # the program of the other tests
        value, slopes = cost_and_slopes(soft, *jax.tree.unflatten(shape, numbers), visits)
        return value, dict(zip(inputs, jax.tree.leaves(slopes), strict=True))

    check_gradient(value_and_gradient, inputs)


@pytest.mark.slow
def test_the_gradient_of_the_path_is_that_of_replanned_costs(soft):
    problem = problem_of(soft)
    _, (by_height, by_params, _) = cost_and_slopes(
        soft, soft.height_m, SOFT, WEIGHTS, visits_of(problem)
    )

    def replanned(height_m=soft.height_m, params=SOFT):
        return astar(problem.with_costs(np.asarray(layers_of(soft, height_m, params)))).cost

    for building in np.argsort(-np.abs(by_height))[:3]:
        step = 1e-5 * np.eye(len(HEIGHT_M))[building]
        slope = (replanned(soft.height_m + step) - replanned(soft.height_m - step)) / 2e-5
        np.testing.assert_allclose(by_height[building], slope, rtol=1e-4)
    ends = [replanned(params=with_sections(risk=Risk(37.0 + step))) for step in (1e-5, -1e-5)]
    np.testing.assert_allclose(
        by_params.sections["risk"].threshold_m, (ends[0] - ends[1]) / 2e-5, rtol=1e-4
    )


@pytest.mark.slow
def test_the_gradient_through_the_planner_and_the_whole_maps_is_that_of_the_path(soft):
    problem = problem_of(soft)
    planned = planned_cost(problem, astar)

    def optimal(height_m, params, weights):
        return planned(soft.layers(height_m, params), vector_of(soft, weights))

    inputs = (soft.height_m, SOFT, WEIGHTS)
    through_maps = jax.jit(jax.grad(optimal, (0, 1, 2)))(*inputs)
    _, of_the_path = cost_and_slopes(soft, *inputs, visits_of(problem))
    for one, other in zip(jax.tree.leaves(through_maps), jax.tree.leaves(of_the_path), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_one_program_serves_other_values_and_other_skies(soft):
    first = layers_of(soft, soft.height_m, SOFT)
    compiled = layers_of._cache_size()
    for arguments in (
        (soft, soft.height_m + 1, SOFT),
        (
            replace(soft, view=SkyView.of(soft.surface, AZIMUTH_RAD + 0.3, ELEVATION_RAD)),
            soft.height_m,
            SOFT,
        ),
        (
            soft,
            soft.height_m,
            replace(with_sections(risk=Risk(25.0)), altitude_m=31.0, softness_m=0.5),
        ),
        (soft, soft.height_m, with_sections(gps=Gps(9.0), lidar=replace(SCAN, range_m=21.0))),
    ):
        assert float(jnp.abs(layers_of(*arguments) - first).max()) > 1e-3
    assert layers_of._cache_size() == compiled == 1


@pytest.mark.slow
def test_a_curve_of_reception_is_taken_in_batches_and_differentiated_by_and_leaves_other_layers_as_they_are(
    soft,
):
    by_curve = replace(SOFT, reception=ju.grad.ReceptionCurve.measured_in_tokyo())

    @jax.vmap
    @jax.value_and_grad
    def total(slope):
        curve = replace(by_curve.reception, slope=slope)
        return soft.layer("gps", soft.height_m, replace(SOFT, reception=curve)).sum()

    @jax.value_and_grad
    def total_of(params):
        return soft.layer("gps", soft.height_m, params).sum()

    totals, slopes = total(jnp.array([0.3, 0.64]))
    expected, by_params = total_of(by_curve)
    assert abs(float(totals[0] - expected)) > 1 < abs(float(total_of(SOFT)[0] - expected))
    np.testing.assert_allclose([totals[1], slopes[1]], [expected, by_params.reception.slope])
    assert by_params.reception.source == by_curve.reception.source
    others = (soft.layer("risk", soft.height_m, params) for params in (SOFT, by_curve))
    np.testing.assert_array_equal(*others)


def test_a_city_without_people_has_no_such_layer():
    soft = replace(soft_city(np.float32), population=None)
    assert soft.names == ("gps", "lidar", "risk")
    np.testing.assert_allclose(soft.layer_weights(WEIGHTS), [1.0, 0.7, 1.2])
