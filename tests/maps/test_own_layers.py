"""Cost layers of one's own in the maps: rasters, arrays and functions, tiled and whole, saved and opened."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from affine import Affine
from rasterio.warp import transform_bounds

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.rasterise import bands_of, layer_values
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.task import MapTask
from jaxurban.metrics.custom import Layer, reserved_names
from jaxurban.metrics.registry import METRICS
from jaxurban.world.grid import Grid
from tests import tiled_runs
from tests.cli_runs import TOWN
from tests.guess_records import by_name
from tests.made_files import write_raster

REACH_M = 60.0


def highest_around(surface, altitude_m):
    """Return the highest roof within three cells, and a little of the altitude."""
    halo = int(REACH_M / surface.grid.resolution_m)
    roofs = surface.crop_with_halo(surface.roof_m, halo)
    rows, cols = surface.region.shape
    shifted = [
        roofs[i : i + rows, j : j + cols] for i in range(2 * halo + 1) for j in range(2 * halo + 1)
    ]
    return jnp.stack(shifted).max(axis=0) + 0.1 * altitude_m


def write_layer(path, grid, values, nodata=None):
    """Write a raster of 35 m pixels, or bands of it, over a grid and 100 m around it."""
    place = Affine(35, 0, grid.bounds_m[0] - 100, 0, -35, grid.bounds_m[3] + 100)
    write_raster(
        path,
        values.astype(np.float32),
        place,
        grid.crs,
        nodata,
        bands=np.atleast_3d(values.T).shape[2],
    )


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    """A task with a raster with a hole, two bands of another, an array and a function."""
    folder, plain = tmp_path_factory.mktemp("layers"), tiled_runs.task(tiled_runs.city())
    rng = np.random.default_rng(0)
    noise, wind = rng.uniform(20, 90, (40, 40)), rng.uniform(0, 12, (40, 40)) * [[[2]], [[1]]]
    noise[15:18, 12:15] = np.nan
    write_layer(folder / "noise.tif", plain.region, noise)
    write_layer(folder / "wind.tif", plain.region, wind)
    layers = {
        "noise": Layer("noise.tif", "high-is-bad", (0.0, 80.0)),
        "wind": Layer("wind.tif", "high-is-bad", (0.0, 25.0), altitudes_m=(60.0, 20.0)),
        "shade": Layer(rng.uniform(-0.2, 1.2, plain.region.shape), "low-is-bad", (0.0, 1.0)),
        "walls": Layer(highest_around, "high-is-bad", (0.0, 1000.0), reach_m=REACH_M),
    }
    bands = bands_of(layers, plain.region, plain.params.altitudes_m, folder)
    return replace(plain, layers=layers, bands=bands)


def test_no_layer_has_the_name_of_a_metric_its_maps_or_a_column_of_tables():
    used = {"gps", "gdop", "hpl", "protection", "gps_p05", "lidar_mean", "gps_floor", "distance"}
    used |= {"gps_floor_median", "population_highest"}
    assert used <= reserved_names()
    assert "noise" not in reserved_names()


@pytest.fixture(scope="module")
def maps(task):
    return compute_maps(task)


@pytest.mark.slow
def test_tiles_of_own_layers_equal_the_untiled_maps_bit_for_bit(task, tmp_path):
    tiled_runs.check_tiles(task, tmp_path)


def test_layers_are_scaled_by_fixed_numbers_and_cut_and_bands_go_by_altitude(task, maps):
    assert [*maps.metrics] == [*METRICS, "noise", "shade", "walls", "wind"]
    m, values = maps.m("shade", 20.0), np.clip(task.layers["shade"].source, 0, 1)
    np.testing.assert_allclose(m, values, rtol=1e-6)
    np.testing.assert_allclose(maps.costs(20.0)["shade"], 1 - values, atol=1e-6)
    np.testing.assert_array_equal(maps.costs(20.0)["noise"], maps.m("noise"))
    assert maps.ds["noise"].dims == ("y", "x")
    np.testing.assert_allclose(2 * maps.m("wind", 20.0), maps.m("wind", 60.0), rtol=1e-5)
    low, high = maps.m("walls", 20.0), maps.m("walls", 60.0)
    np.testing.assert_allclose(high - low, 0.1 * 40 / 1000, atol=1e-6)


def test_a_cell_without_a_value_is_closed_at_every_altitude(maps):
    is_lost = np.isnan(maps.m("noise"))
    assert is_lost.any()
    for altitude_m in (20.0, 41.0, 60.0):
        assert not (maps.is_free(altitude_m) & is_lost).any()
        assert maps.is_free(altitude_m).any()


def test_bands_shapes_and_layers_that_do_not_fit_are_refused(task):
    def layer(values, **how):
        return Layer(values, "high-is-bad", (0.0, 1.0), **how)

    grid, values = task.region, np.zeros((2, *task.region.shape))
    for made, message in (
        (layer(values), r"has 2 band\(s\) for 1 altitude\(s\): name the altitude"),
        (layer(values, altitudes_m=(20.0, 50.0)), "has no band for 60 m"),
        (layer(values[:, 1:]), "has values of shape"),
        (layer(values[0] + 1j), "layer 'noise' must be an array of real numbers, got complex128"),
    ):
        with pytest.raises(InputError, match=message):
            bands_of({"noise": made}, grid, task.params.altitudes_m)
    for layers in ({"noise": 5}, [layer("noise.tif")], np.zeros(3)):
        with pytest.raises(InputError, match="layers must be a dict of Layer or None"):
            ju.build_maps(task.city, grid=grid, layers=layers)
    strict = {"noise": replace(task.layers["noise"], nan="error")}
    with pytest.raises(InputError, match="layer 'noise' has no value in"):
        compute_maps(replace(task, layers=strict))


def test_a_function_that_looks_beyond_its_reach_is_told(task):
    short = {"walls": replace(task.layers["walls"], reach_m=REACH_M / 2)}
    with pytest.raises(InputError, match="looks 60 m sideways, beyond its reach_m"):
        compute_maps(replace(task, layers=short))


def with_raster(city, grid, path):
    layers = {"noise": Layer(str(path), "high-is-bad", (0, 80))}
    return MapTask(
        city, grid, view_sky(grid, ju.Gps()), MapParams(), layers, bands_of(layers, grid, (60.0,))
    )


@pytest.mark.parametrize("crs", ["EPSG:32618", "EPSG:4326"])
def test_a_raster_that_ends_inside_the_region_is_told_with_the_share_that_it_closes(crs, tmp_path):
    city, grid = ju.demo_city(500, 500), Grid("EPSG:32618", 20.0, 225_500, 29_250, 100, 100)
    edges = transform_bounds(grid.crs, crs, *grid.bounds_m)
    width = (edges[2] - edges[0]) * 0.6
    right, up = 1.1 * width / 50, (edges[3] - edges[1] + 2 * width) / 50
    at = Affine(right, 0.0, edges[0] - 0.1 * width, 0.0, -up, edges[3] + width)
    write_raster(tmp_path / "part.tif", np.zeros((50, 50), np.float32), at, crs)
    task = with_raster(city, grid, tmp_path / "part.tif")
    ((name, told),) = (
        (name, told) for name, told in by_name(task.all_guesses).items() if "layer" in name
    )
    closed = np.isnan(layer_values(task.bands["noise"], grid, grid)).mean()
    assert told.startswith(
        f"{100 * closed:.0f} % of the region lies beyond the raster of layer noise and is closed"
    )
    assert 0.38 < closed < 0.42
    assert name.endswith("of the region beyond layer noise")


def test_large_holes_of_a_raster_are_told(tmp_path):
    city, grid = ju.demo_city(500, 500), Grid("EPSG:32618", 20.0, 225_500, 29_250, 20, 20)
    values = np.zeros((40, 40))
    values[:, :10] = -1
    write_layer(tmp_path / "noise.tif", grid, values, nodata=-1)
    told = by_name(with_raster(city, grid, tmp_path / "noise.tif").all_guesses)
    (sentence,) = (sentence for name, sentence in told.items() if "layer noise without" in name)
    assert "% of the pixels of layer noise hold no value and are closed to every path" in sentence


@pytest.mark.parametrize("is_masked", [True, False])
def test_masked_and_infinite_values_are_no_values(is_masked):
    grid = Grid("EPSG:32618", 20.0, 225_500, 29_250, 4, 5)
    values = np.arange(20.0).reshape(4, 5)
    lost = values > 12
    given = np.ma.masked_greater(values, 12) if is_masked else np.where(lost, np.inf, values)
    layers = {"noise": Layer(given, "high-is-bad", (0, 80))}
    ((band,),) = bands_of(layers, grid, (60.0,)).values()
    np.testing.assert_array_equal(np.isnan(band), lost)


@pytest.mark.slow
def test_a_scenario_names_a_raster_layer(tmp_path):
    noise = '[layers.noise]\nsource = "noise.tif"\ncost = "high-is-bad"\nscale = [0, 80]\n'
    (tmp_path / "scenario.toml").write_text(TOWN + noise)
    scenario = Scenario.from_toml(tmp_path / "scenario.toml")
    grid = Grid.from_bounds(scenario.region.bounds, 20.0, None)
    write_layer(tmp_path / "noise.tif", grid, np.full((40, 40), 20.0))
    run = run_scenario(scenario, tmp_path / "out")
    np.testing.assert_allclose(run.maps[20.0].m("noise"), 0.25)
    assert run.record["inputs"]["layer_noise"]["path"] == "noise.tif"
    assert (tmp_path / "out" / "geotiff" / "noise_20m.tif").is_file()


@pytest.mark.parametrize("south", [-3, 0, 2, 9])
@pytest.mark.parametrize("west", [-2, 0, 4, 9])
def test_a_part_that_sticks_out_on_any_side_has_the_values_of_the_array_where_it_lies_on_it(
    south, west
):
    values = np.arange(48, dtype=np.float32).reshape(6, 8)
    region = Grid("EPSG:32618", 10.0, 100, 200, 6, 8)
    part = Grid("EPSG:32618", 10.0, 100 + south, 200 + west, 5, 7)
    padded = np.full((40, 40), np.nan, np.float32)
    padded[10:16, 10:18] = values
    expected = padded[10 + south : 15 + south, 10 + west : 17 + west]
    np.testing.assert_array_equal(layer_values((values,), part, region), expected)


def test_a_function_gets_arrays_of_jax_and_cannot_alter_the_surface_of_other_metrics():
    """Arrays of NumPy would be views: what a function adds in place would stand in the maps that are made after it."""
    city = ju.demo_city(400, 400)

    def raised(surface, altitude_m):
        arrays = [surface.roof_m, surface.crop(surface.roof_m)]
        assert all(isinstance(values, jax.Array) for values in arrays)
        with pytest.raises(TypeError, match="immutable"):
            surface.roof_m[:] = 500.0
        return surface.crop(surface.roof_m).at[0, 0].set(altitude_m)

    settings = {"resolution_m": 20.0, "altitudes_m": (20.0, 60.0), "progress": False}
    layer = ju.Layer(raised, cost="high-is-bad", scale=(0.0, 100.0))
    made = ju.build_maps(city, layers={"raised": layer}, **settings).ds
    plain = ju.build_maps(city, **settings).ds
    for name in plain:
        np.testing.assert_array_equal(made[name], plain[name], err_msg=str(name))
