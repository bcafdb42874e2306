"""The maps as one pure function: the recipe's bits, jitted, mapped over, exported."""

from dataclasses import replace

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
from tests import hanging_city

TIMES = [f"2020-04-27T{hour:02d}:30:00Z" for hour in (0, 6)]
SECTIONS = {"gps": ju.Gps(times=TIMES), "gps_horizontal": Dop(10.0)}
PARAMS = MapParams(altitudes_m=(20.0, 60.0), sections=SECTIONS)
TYPES = {"obstacle", "gps", "gdop", "hdop", "num_visible", "lidar", "risk", "population", "density", "gps_horizontal"}
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


def test_it_gives_the_bits_of_the_recipe(task, inputs, views):
    expected = compute_maps(task).ds
    for t in range(task.num_times):
        found = one(inputs, at(views, t))
        assert_as_kept(found, expected, t)
    assert {*found} >= TYPES
    assert all(name == "obstacle" or len(np.unique(values)) > 5 for name, values in found.items())
    assert np.isfinite(found["lidar"]).all()


@pytest.mark.slow
def test_over_terrain_and_where_it_is_unknown_the_bits_are_equal_and_the_cost_s_derivatives_finite(task):
    x_min, _, _, y_max = task.city.extent_m
    hills_m = 15 * np.sin(np.arange(40) / 5)[:, None] * np.cos(np.arange(40) / 7)
    hills_m[:, :15] = np.nan
    place = (30.0, 0.0, x_min - 150, 0.0, -30.0, y_max + 150), task.city.crs
    task = replace(task, city=replace(task.city, terrain=Raster(hills_m.astype(np.float32), *place)))
    inputs, expected = inputs_of(task), compute_maps(task).ds
    has_data = expected["has_data"].values
    assert 0.1 < has_data.mean() < 0.9
    sky = at(skies_of(task, inputs.surface), 0)
    maps = one(inputs, sky, {})
    np.testing.assert_array_equal(np.isnan(maps["cost"]), np.broadcast_to(~has_data, maps["cost"].shape))
    assert_as_kept({name: values for name, values in maps.items() if name != "cost"}, expected)
    by_risk = jax.grad(lambda risk: jnp.nansum(all_maps(inputs, sky, ju.Weights(risk=risk))["cost"]))(2.0)
    risk_cost = 1 - maps["risk"]
    assert float(by_risk) == pytest.approx(maps["cost"].shape[1] * np.nansum(risk_cost), rel=1e-4)


@pytest.mark.slow
def test_over_times_it_is_every_time_s_maps(task, inputs, views):
    assert len({len(task.in_view(t).numbers) for t in range(task.num_times)}) > 1  # some skies are filled up
    made = jax.jit(jax.vmap(all_maps, (None, 0)))(inputs, views)
    for t in range(task.num_times):
        for name, values in one(inputs, at(views, t)).items():
            assert_same(name, made[name][t], values)


@pytest.mark.slow
def test_it_maps_over_sixteen_skies_thresholds_gammas_heights_and_weights(inputs, views):
    many = jax.tree.map(lambda values: jnp.concatenate([values] * 8), views)
    assert jax.eval_shape(jax.vmap(all_maps, (None, 0)), inputs, many)["gps"].shape == (16, 2, 48, 40)
    sky, given = at(views, 0), inputs.settings
    plain = one(inputs, sky)

    def over(values, change):
        return jax.vmap(lambda value: all_maps(replace(inputs, **change(value)), sky))(jnp.asarray(values))

    def with_leaf(metric, name):
        return lambda value: {"settings": given | {metric: replace(given[metric], **{name: value})}}

    some = over([5.0, 20.0], with_leaf("gps", "gdop_threshold"))["gps"]
    np.testing.assert_array_equal(some[1], plain["gps"])
    assert np.mean(some[0]) < np.mean(some[1])
    some = over([1.0, 3.0], with_leaf("population", "gamma_commercial"))["population"]
    assert_same("population", some[1], plain["population"])
    roof_m = inputs.surface.roof_m
    some = over([1.0, 0.0], lambda share: {"surface": replace(inputs.surface, roof_m=share * roof_m)})
    assert some["obstacle"][0].any()
    assert not some["obstacle"][1].any()
    np.testing.assert_array_equal(some["lidar"][0], plain["lidar"])
    costs = jax.vmap(lambda risk: all_maps(inputs, sky, ju.Weights(risk=risk))["cost"])(jnp.asarray([1.0, 3.0]))
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
        (lambda: ju.grad.map_inputs(task.city, task.region, gps=ju.Gps(times=[])), "times must be different UTC times"),
        (lambda: ju.grad.map_inputs(task.city, replace(task.region, crs="EPSG:32633")), "the grid in the city's CRS"),
        (lambda: ju.grad.map_inputs(task.city, replace(task.region, first_row=0)), "region and the city do not meet"),
        (lambda: inputs_of(replace(task, params=replace(PARAMS, oversample=3))), "know no oversample"),
        (lambda: inputs_of(hanging_city.task(hanging_city.city())), "know no slabs"),
    ]
    for call, words in refused:
        with pytest.raises(InputError, match=words):
            call()
    _, skies = ju.grad.map_inputs(task.city, task.region, gps=ju.Gps(times=TIMES[0]))
    assert skies.num.shape == (1,)
