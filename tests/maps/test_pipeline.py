"""The maps as one pure function: the recipe's bits, jitted, mapped over, exported."""

from dataclasses import replace
from functools import partial

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.build import all_maps, compute_maps, inputs_of, skies_of, view_sky
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.gps import Dop
from jaxurban.world.city import Raster
from jaxurban.world.grid import Grid

TIMES = [f"2020-04-27T{hour:02d}:30:00Z" for hour in range(0, 24, 6)]
PARAMS = MapParams(altitudes_m=(20.0, 60.0))


def task_of(has_terrain=False, params=PARAMS, times=TIMES[:2]):
    city = ju.demo_city(900, 900)
    x_min, y_min, _, y_max = city.extent_m
    if has_terrain:
        hills_m = (15 * np.sin(np.arange(40) / 5)[:, None] * np.cos(np.arange(40) / 7)).astype(np.float32)
        city = replace(city, terrain=Raster(hills_m, (30.0, 0.0, x_min - 150, 0.0, -30.0, y_max + 150), city.crs))
    region = Grid(city.crs, 10.0, round(y_min / 10) + 20, round(x_min / 10) + 20, 48, 40)
    sky = view_sky(region, ju.Gps(times=times))
    return MapTask(city, region, sky, params)


@pytest.fixture(scope="module")
def task():
    return task_of()


@pytest.fixture(scope="module")
def inputs(task):
    return inputs_of(task)


@pytest.fixture(scope="module")
def views(task, inputs):
    return skies_of(task, inputs.surface)


@pytest.fixture(scope="module")
def made(inputs, views):
    return jax.jit(jax.vmap(all_maps, (None, 0)))(inputs, views)


def at(views, t):
    return jax.tree.map(lambda values: values[t], views)


def assert_same(name, found, expected):
    """Bit for bit, but for the last bit of what the population's programs round."""
    np.testing.assert_allclose(found, expected, rtol=2e-7 if name in ("population", "density") else 0, err_msg=name)


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


def test_jitted_all_maps_has_the_bits_of_build_maps_on_a_small_city():
    city = ju.demo_city(600, 600)
    settings = {"altitudes_m": (20.0,), "gps": ju.Gps(times=TIMES[0]), "gps_horizontal": Dop(10.0)}
    expected = ju.build_maps(city, resolution_m=20.0, **settings)
    inputs, skies = ju.grad.map_inputs(city, expected.grid, **settings)
    found = jax.jit(all_maps)(inputs, at(skies, 0))
    assert {*found} >= {"obstacle", "gps", "gdop", "num_visible", "lidar", "risk", "population", "gps_horizontal"}
    assert all(name == "obstacle" or len(np.unique(values)) > 5 for name, values in found.items())
    assert np.isfinite(found["lidar"]).all()
    assert_as_kept(found, expected.ds)


@pytest.mark.slow
@pytest.mark.parametrize("has_terrain", [False, True])
def test_it_gives_the_bits_of_the_recipe(has_terrain):
    task = task_of(has_terrain)
    inputs = inputs_of(task)
    views, expected = skies_of(task, inputs.surface), compute_maps(task).ds
    for t in range(task.num_times):
        found = jax.jit(all_maps)(inputs, at(views, t))
        assert_as_kept(found, expected, t)
    assert {*found} >= {"obstacle", "gps", "gdop", "hdop", "num_visible", "lidar", "risk", "population", "density"}


@pytest.mark.slow
def test_where_the_terrain_is_unknown_the_maps_are_too_and_the_cost_s_derivatives_are_finite():
    task = task_of(has_terrain=True)
    terrain = task.city.terrain
    values = np.where(np.arange(terrain.values.shape[1]) < 15, np.nan, terrain.values).astype(np.float32)
    task = replace(task, city=replace(task.city, terrain=replace(terrain, values=values)))
    inputs, expected = inputs_of(task), compute_maps(task).ds
    has_data = expected["has_data"].values
    assert 0.1 < has_data.mean() < 0.9
    sky = at(skies_of(task, inputs.surface), 0)
    maps = jax.jit(all_maps)(inputs, sky, {})
    np.testing.assert_array_equal(np.isnan(maps["cost"]), np.broadcast_to(~has_data, maps["cost"].shape))
    assert_as_kept({name: values for name, values in maps.items() if name != "cost"}, expected)
    by_risk = jax.grad(lambda risk: jnp.nansum(all_maps(inputs, sky, ju.Weights(risk=risk))["cost"]))(2.0)
    risk_cost = 1 - maps["risk"]
    assert float(by_risk) == pytest.approx(maps["cost"].shape[1] * np.nansum(risk_cost), rel=1e-4)


def test_over_times_it_is_every_time_s_maps(task, inputs, views, made):
    assert len({len(task.in_view(t).numbers) for t in range(task.num_times)}) > 1  # some skies are filled up
    for t in range(task.num_times):
        for name, values in all_maps(inputs, at(views, t)).items():
            assert_same(name, made[name][t], values)


@pytest.mark.slow
def test_it_maps_over_sixteen_skies_thresholds_gammas_heights_and_weights(inputs, views):
    many = jax.tree.map(lambda values: jnp.concatenate([values] * 8), views)
    shapes = jax.eval_shape(jax.vmap(all_maps, (None, 0)), inputs, many)
    assert shapes["gps"].shape == (16, 2, 48, 40)
    sky = at(views, 0)

    def by(**changes):
        def maps(value):
            changed = {name: change(value) for name, change in changes.items()}
            return all_maps(replace(inputs, **changed), sky)

        return maps

    thresholds = jnp.asarray([5.0, 20.0])
    given = inputs.settings
    gps = partial(replace_leaf, given["gps"], "gdop_threshold")
    some = jax.vmap(by(settings=lambda value: given | {"gps": gps(value)}))(thresholds)
    np.testing.assert_array_equal(some["gps"][1], all_maps(inputs, sky)["gps"])
    assert np.mean(some["gps"][0]) < np.mean(some["gps"][1])
    gammas = jnp.asarray([1.0, 3.0])
    people = partial(replace_leaf, given["population"], "gamma_commercial")
    some = jax.vmap(by(settings=lambda value: given | {"population": people(value)}))(gammas)
    assert_same("population", some["population"][1], all_maps(inputs, sky)["population"])
    roofs_m = jnp.stack([inputs.surface.roof_m, inputs.surface.roof_m * 0])
    some = jax.vmap(by(surface=lambda value: replace(inputs.surface, roof_m=value)))(roofs_m)
    assert some["obstacle"][0].any()
    assert not some["obstacle"][1].any()
    np.testing.assert_array_equal(some["lidar"][0], all_maps(inputs, sky)["lidar"])
    weights = jax.vmap(lambda risk: all_maps(inputs, sky, ju.Weights(risk=risk))["cost"])(jnp.asarray([1.0, 3.0]))
    risk = 1 - all_maps(inputs, sky)["risk"]
    np.testing.assert_allclose(weights[1] - weights[0], np.broadcast_to(2 * risk[:, None], weights[0].shape), atol=1e-5)


def replace_leaf(params, name, value):
    """A settings object with a traced leaf."""
    leaves, tree = jax.tree_util.tree_flatten_with_path(params)
    return jax.tree_util.tree_unflatten(tree, [value if path[0].name == name else leaf for path, leaf in leaves])


def test_it_is_exported_for_cpu_and_cuda_and_read_back(inputs, views):
    sky = at(views, 0)
    leaves, tree = jax.tree.flatten((inputs, sky))
    run = jax.jit(lambda *leaves: all_maps(*jax.tree.unflatten(tree, leaves)))
    exported = jax.export.export(run, platforms=["cpu", "cuda"])(*leaves)
    found = jax.export.deserialize(exported.serialize()).call(*leaves)
    for name, values in all_maps(inputs, sky).items():
        assert_same(name, found[name], values)


def test_from_a_notebook_it_gives_the_maps_of_build_maps(task, made):
    city, grid = task.city, task.region
    inputs, skies = ju.grad.map_inputs(city, grid, altitudes_m=(20.0, 60.0), gps=ju.Gps(times=TIMES[:2]))
    found = jax.vmap(ju.grad.all_maps, (None, 0))(inputs, skies)
    for name, values in made.items():
        assert_same(name, found[name], values)
    with pytest.raises(InputError, match="city must be City"):
        ju.grad.map_inputs(5, grid)
    with pytest.raises(InputError, match=r"sky must be of one time, got 2: take jax\.vmap"):
        ju.grad.all_maps(inputs, skies)


def test_grids_and_times_are_refused_as_by_build_maps(task):
    with pytest.raises(InputError, match="times must be different UTC times"):
        ju.grad.map_inputs(task.city, task.region, gps=ju.Gps(times=[]))
    with pytest.raises(InputError, match="build the grid in the city's CRS"):
        ju.grad.map_inputs(task.city, replace(task.region, crs="EPSG:32633"))
    with pytest.raises(InputError, match="the region and the city do not meet"):
        ju.grad.map_inputs(task.city, replace(task.region, first_row=0))
    _, skies = ju.grad.map_inputs(task.city, task.region, gps=ju.Gps(times=TIMES[0]))
    assert skies.num.shape == (1,)


def test_what_it_does_not_know_is_refused(task):
    with pytest.raises(InputError, match="know no oversample"):
        inputs_of(replace(task, params=replace(PARAMS, oversample=3)))
