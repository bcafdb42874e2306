"""The soft GPS metric: its definition by brute force, its limit, its derivatives, and that one program serves all."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.build import view_sky
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.gps import soft_gps
from jaxurban.metrics.visibility import SkyView
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface
from tests.metrics.whole_maps import compute_gps

# One satellite a quadrant swept along rows and columns both ways, low and high, and one more.
AZIMUTH_RAD = np.radians([10.0, 80.0, 190.0, 285.0, 140.0, 330.0, 235.0])
ELEVATION_RAD = np.radians([35.0, 50.0, 25.0, 40.0, 65.0, 20.0, 45.0])
GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 30, 34)
REGION = GRID.padded(-3, -4, -5, -2)
NUM_BUILDINGS = 12


def random_buildings(seed=0):
    """Roofs by building: index [Y, X] (the last one stands nowhere) and heights [B + 1]."""
    rng = np.random.default_rng(seed)
    index = np.full(GRID.shape, NUM_BUILDINGS, np.int32)
    for building in range(NUM_BUILDINGS):
        row, col = rng.integers(0, 26), rng.integers(0, 30)
        index[row : row + rng.integers(2, 5), col : col + rng.integers(2, 6)] = building
    return index, np.append(rng.uniform(12, 60, NUM_BUILDINGS), 0.0)


INDEX, HEIGHTS_M = random_buildings()


def surface_of(dtype=np.float64, terrain=True):
    ground_m = 8 + 6 * np.sin(np.arange(30)[:, None] / 5) * np.cos(np.arange(34) / 7)
    terrain_m = jnp.asarray(ground_m, dtype) if terrain else None
    return Surface(jnp.asarray(HEIGHTS_M[INDEX], dtype), terrain_m, None, None, GRID, REGION)


def view_of(surface, turned_rad=0.0):
    return SkyView.of(surface, AZIMUTH_RAD + turned_rad, ELEVATION_RAD)


def total(inputs, surface, view, mix):
    """A mix of all cells' m, as a function of everything that it can be differentiated by."""
    roof_m = inputs["heights_m"][INDEX] + inputs["roof_m"]
    here = replace(surface, roof_m=roof_m, terrain_m=surface.terrain_m + inputs["ground_m"])
    seen_from = view._replace(lines=view.lines._replace(drop_m=inputs["drop_m"]))
    m = soft_gps(here, inputs["z_m"], inputs["threshold"], inputs["softness_m"], seen_from)
    return jnp.sum(mix * m), m


SLOPES = jax.jit(jax.value_and_grad(total, has_aux=True))
MIX = np.random.default_rng(1).uniform(0.5, 1.5, REGION.shape)


def inputs_of(surface, view, z_m=14.0, threshold=20.0, softness_m=2.0):
    zero, dtype = jnp.zeros_like(surface.roof_m), surface.roof_m.dtype
    numbers = {"z_m": z_m, "threshold": threshold, "softness_m": softness_m, "drop_m": view.lines.drop_m}
    return {"heights_m": jnp.asarray(HEIGHTS_M, dtype), "roof_m": zero, "ground_m": zero} | {
        name: jnp.asarray(value, dtype) for name, value in numbers.items()
    }


def shadow_by_walking(top_m, azimuth_rad, elevation_rad):
    """The highest top on the global digital line beyond each cell, less the ray's climb to it."""
    east, north = math.sin(azimuth_rad), math.cos(azimuth_rad)
    turned = abs(east) > abs(north)
    tops, along, across, first = (
        (top_m.T, east, north, GRID.first_col) if turned else (top_m, north, east, GRID.first_row)
    )
    climb_m = GRID.resolution_m / abs(along) * math.tan(elevation_rad)
    shadow_m = np.full(tops.shape, -np.inf)
    for row, col in np.ndindex(tops.shape):
        start = math.floor(across / along * (first + row) + 0.5)
        for steps in range(1, tops.shape[0]):
            beyond = row + int(math.copysign(steps, along))
            to = col + math.floor(across / along * (first + beyond) + 0.5) - start
            if 0 <= beyond < tops.shape[0] and 0 <= to < tops.shape[1]:
                shadow_m[row, col] = max(shadow_m[row, col], tops[beyond, to] - (steps - 0.25) * climb_m)
    return shadow_m.T if turned else shadow_m


def gdop_by_inverse(weights):
    level = np.cos(ELEVATION_RAD)
    east, north = np.sin(AZIMUTH_RAD) * level, np.cos(AZIMUTH_RAD) * level
    matrix = np.column_stack([east, north, np.sin(ELEVATION_RAD), -np.ones(len(level))])
    normal = matrix.T @ np.diag(weights) @ matrix
    return math.sqrt(np.trace(np.linalg.inv(normal))) if np.linalg.cond(normal) < 1e9 else math.inf


@pytest.mark.slow
def test_m_equals_its_definition_cell_by_cell():
    z_m, threshold, softness_m = 14.0, 20.0, 2.0
    with jax.enable_x64(True):
        surface = surface_of()
        view = view_of(surface)
        found = np.asarray(SLOPES(inputs_of(surface, view, z_m, threshold, softness_m), surface, view, MIX)[0][1])
    top_m, ground_m, roof_m = (np.asarray(v) for v in (surface.top_m, surface.terrain_m, surface.roof_m))
    shadows_m = [shadow_by_walking(top_m, *angles) for angles in zip(AZIMUTH_RAD, ELEVATION_RAD, strict=True)]
    expected = np.zeros(GRID.shape)
    for cell in np.ndindex(GRID.shape):
        gdop = gdop_by_inverse([(1 + math.exp((s[cell] - ground_m[cell] - z_m) / softness_m)) ** -2 for s in shadows_m])
        t = np.clip((z_m - roof_m[cell]) / softness_m, 0, 1) if roof_m[cell] > 0 else 1
        expected[cell] = t**3 * (10 - 15 * t + 6 * t**2) * (threshold - min(gdop, threshold)) / (threshold - 1)
    expected = expected[REGION.window_in(GRID)]
    assert np.mean((expected > 0) & (expected < 0.85)) > 0.1
    assert (expected == 0).any()
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_derivatives_equal_central_differences_to_1e_4():
    """By buildings, single cells of roof and ground, altitude, threshold, softness and the climb of the rays."""
    with jax.enable_x64(True):
        surface = surface_of()
        view = view_of(surface)
        point = inputs_of(surface, view)
        slopes = SLOPES(point, surface, view, MIX)[1]
        num_checked = 0
        for name, slope in slopes.items():
            strong = np.flatnonzero(np.abs(slope) > 1e-3)
            for entry in np.random.default_rng(2).permutation(strong)[:15]:
                cell, ends = np.unravel_index(entry, slope.shape), []
                for step in (1e-5, -1e-5):
                    moved = point | {name: point[name].at[cell].add(step)}
                    ends.append(SLOPES(moved, surface, view, MIX)[0][0])
                expected = (ends[0] - ends[1]) / 2e-5
                np.testing.assert_allclose(slope[cell], expected, rtol=1e-4, err_msg=f"{name} {cell}")
                num_checked += 1
        assert num_checked > 45
        assert all(np.abs(slopes[name]) > 1e-3 for name in ("z_m", "threshold", "softness_m"))


def test_a_higher_roof_never_helps_and_a_higher_receiver_never_harms():
    with jax.enable_x64(True):
        surface = surface_of()
        view = view_of(surface)
        slopes = SLOPES(inputs_of(surface, view), surface, view, MIX)[1]
        assert np.max(slopes["roof_m"]) <= 0 < slopes["z_m"]
        # All tops and the receivers raised alike change nothing.
        np.testing.assert_allclose(np.sum(slopes["roof_m"]), -slopes["z_m"], rtol=1e-9)


@pytest.mark.slow
def test_softness_0_is_the_exact_map():
    surface = surface_of(np.float32)
    view = view_of(surface)
    exact = compute_gps(surface, AZIMUTH_RAD, ELEVATION_RAD, [14.0]).m
    (_, m), slopes = SLOPES(inputs_of(surface, view, softness_m=0.0), surface, view, MIX)
    np.testing.assert_allclose(m, exact[0], atol=1e-5)
    assert not np.any(slopes["heights_m"])


def differences_to_exact(city, region, softnesses_m):
    """Differences of m to the exact map 20 m up, [N, y, x]."""
    sky = view_sky(region, ju.Gps(times=["2020-04-27T16:00:00Z"]))
    surface, angles = MapTask(city, region, sky, MapParams()).surface(), (sky.azimuth_rad[0], sky.elevation_rad[0])
    exact = compute_gps(surface, *angles, [20.0]).m[0]
    view = SkyView.of(surface, *angles)
    return np.abs(np.array([soft_gps(surface, 20.0, 20.0, softness_m, view) for softness_m in softnesses_m]) - exact)


def test_halving_the_softness_brings_the_synthetic_city_closer_to_exact_each_time():
    city = ju.demo_city(1_500, 1_500)
    west, south, _, _ = city.extent_m
    region = Grid(city.crs, 10.0, math.ceil(south / 10), math.ceil(west / 10), 140, 140)
    off = differences_to_exact(city, region, 4.0 * 0.5 ** np.arange(8))
    assert np.all(np.diff(off.mean(axis=(1, 2))) < 0)
    assert np.mean(off[-1] > 0.01) < 0.005


@pytest.mark.slow
@pytest.mark.data
def test_halving_the_softness_brings_lower_manhattan_closer_to_exact_each_time(data_dir):
    bounds = (-74.02, 40.70, -73.98, 40.73)
    city = ju.City.from_files(data_dir / "osm" / "lower-manhattan.osm.pbf", bounds=bounds)
    off = differences_to_exact(city, Grid.from_bounds(bounds, 5.0, city.crs), 8.0 * 0.5 ** np.arange(9))
    assert np.all(np.diff(off.mean(axis=(1, 2))) < 0)
    assert np.mean(off[-1] > 0.01) < 0.005


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_one_program_serves_all_skies_altitudes_thresholds_and_softnesses(dtype):
    with jax.enable_x64(dtype == np.float64):
        surface = surface_of(dtype)
        for turned_rad, numbers in enumerate([(14.0, 20.0, 2.0), (30.0, 10.0, 0.1), (14.0, 20.0, 0.0)]):
            view = view_of(surface, turned_rad)
            (value, _), slopes = SLOPES(inputs_of(surface, view, *numbers), surface, view, MIX)
            assert all(np.all(np.isfinite(found)) for found in (value, *slopes.values()))
            if turned_rad == 0:
                compiled = SLOPES._cache_size()
        assert SLOPES._cache_size() == compiled


def test_float32_keeps_values_to_1e_4_and_slopes_to_1e_3_of_the_largest():
    found = []
    for dtype in (np.float32, np.float64):
        with jax.enable_x64(dtype == np.float64):
            surface = surface_of(dtype)
            view = view_of(surface)
            (_, m), slopes = SLOPES(inputs_of(surface, view), surface, view, MIX)
            assert m.dtype == slopes["roof_m"].dtype == dtype
            found.append((m, slopes))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-4)
    for name, expected in found[1][1].items():
        np.testing.assert_allclose(found[0][1][name], expected, atol=1e-3 * np.abs(expected).max())


def test_chosen_cells_give_the_maps_values_and_batches_of_altitudes_and_cities_the_same_as_one():
    surface = surface_of(np.float32)
    view, cells = view_of(surface), jnp.array([[0, 0], [3, 20], [10, 5], [21, 18]])
    (_, m), _ = SLOPES(inputs_of(surface, view), surface, view, MIX)
    roofs_m = surface.roof_m * jnp.array([0.5, 1.0, 1.5])[:, None, None]

    def one(roof_m, z_m):
        return soft_gps(replace(surface, roof_m=roof_m), z_m, 20.0, 2.0, view, cells=cells)

    batch = jax.vmap(jax.vmap(one, (None, 0)), (0, None))(roofs_m, jnp.array([14.0, 30.0]))
    np.testing.assert_allclose(batch[1, 0], m[*cells.T], atol=1e-6)
    np.testing.assert_allclose(
        one(roofs_m[2], jnp.array([14.0, 30.0, 14.0, 30.0])), batch[2, np.array([0, 1, 0, 1]), np.arange(4)], atol=1e-6
    )


def test_where_all_satellites_are_hidden_m_and_its_slopes_are_0_and_not_nan():
    surface = surface_of(np.float32)
    view = view_of(surface)
    inputs = inputs_of(surface, view, softness_m=1e-3)
    inputs["roof_m"] = inputs["roof_m"] + 5000
    (value, _), slopes = SLOPES(inputs | {"z_m": jnp.float32(4990)}, surface, view, MIX)
    assert value == 0
    assert not any(np.any(slope) for slope in slopes.values())


def test_a_wrong_softness_is_refused():
    surface = surface_of(np.float32)
    with pytest.raises(InputError, match="softness_m must be 0"):
        soft_gps(surface, 20.0, 20.0, -1.0, view_of(surface))


@pytest.mark.parametrize("multiple_of", [1, 8])
def test_without_satellites_m_is_0_and_so_is_its_gradient(multiple_of):
    surface = surface_of(np.float32)
    view = SkyView.of(surface, [], [], multiple_of)
    assert not np.any(compute_gps(surface, [], [], [20.0]).m)

    def total(roof_m):
        return jnp.sum(soft_gps(replace(surface, roof_m=roof_m), 20.0, 20.0, 2.0, view))

    m, slopes = jax.value_and_grad(total)(surface.roof_m)
    assert m == 0
    assert not np.any(slopes)


def test_satellites_that_fill_up_change_nothing():
    surface = surface_of(np.float32)
    alone, filled = (SkyView.of(surface, AZIMUTH_RAD, ELEVATION_RAD, multiple_of) for multiple_of in (1, 32))
    assert len(alone.lines.drop_m) == len(AZIMUTH_RAD) < len(filled.lines.drop_m) == 32
    maps = [soft_gps(surface, 20.0, 20.0, 2.0, view) for view in (alone, filled)]
    assert len(np.unique(maps[0])) > 3
    np.testing.assert_allclose(*maps, atol=1e-6)
