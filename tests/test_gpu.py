"""What a GPU computes is what the CPU computes. Run with ``pytest -m gpu`` where JAX has a GPU."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.gpu import difference
from benchmarks.gpu_sections import GRADIENT, METRES, SAME
from jaxurban.maps.build import compute_maps
from jaxurban.metrics.gps import maps_of_words, satellites_of, soft_gps
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.visibility import SkyView, visible_words
from jaxurban.planners.bitstar.planner import bitstar_plus
from jaxurban.planners.bulk import solve_batched
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface
from tests import tiled_runs
from tests.planners.problems import walled_problem

pytestmark = pytest.mark.gpu

# Rays that graze a roof: 7.4e-6 of the answers differed on an H200.
GRAZING = {"share": 1e-5}, "1e-5 of the answers"
NUM_ROWS, NUM_COLS, MARGIN = 240, 310, 30
GRID = Grid("EPSG:32618", 5.0, 0, 0, NUM_ROWS, NUM_COLS)
REGION = GRID.padded(-MARGIN, -MARGIN, -MARGIN, -MARGIN)
AZIMUTH_RAD, ELEVATION_RAD = np.linspace(0.2, 6.0, 9), np.linspace(0.15, 1.3, 9)
ALTITUDES_M = (20.0, 60.0)
CELLS = np.random.default_rng(0).integers(20, 120, (64, 2)).astype(np.int32)


@pytest.fixture(scope="module")
def gpu() -> jax.Device:
    """JAX's first device that is no CPU."""
    others = [device for device in jax.devices() if device.platform != "cpu"]
    if not others:
        pytest.skip("JAX has no GPU here")
    return others[0]


def city(terrain: bool = False) -> Surface:
    """Return towers and blocks on flat or rolling ground, as NumPy arrays."""
    rng = np.random.default_rng(5)
    roof_m = np.zeros(GRID.shape, np.float32)
    for row, col in rng.integers(0, (NUM_ROWS - 8, NUM_COLS - 8), (250, 2)):
        roof_m[row : row + rng.integers(2, 8), col : col + rng.integers(2, 8)] = rng.uniform(5, 150)
    rows, cols = np.indices(GRID.shape)
    ground_m = (
        (8 * np.sin(rows / 17) + 5 * np.cos(cols / 23)).astype(np.float32) if terrain else None
    )
    return Surface(roof_m, ground_m, None, None, GRID, REGION)


def on_both(work, given, gpu: jax.Device) -> tuple[np.ndarray, np.ndarray]:
    """Return what a function makes of the same arrays on the CPU and on the GPU."""
    found = []
    for device in (jax.devices("cpu")[0], gpu):
        with jax.default_device(device):
            is_surface = isinstance(given, Surface)  # as a pytree it has no place
            there = given.of_jax() if is_surface else jax.device_put(given, device)
            result = jax.block_until_ready(work(there))
        assert not isinstance(result, jax.Array) or result.devices() == {
            device
        }  # words come to the host at once
        found.append(np.asarray(result))
    return found[0], found[1]


def satellites(surface: Surface) -> np.ndarray:
    """Return a bit for each satellite, altitude and cell."""
    sky = SkyView.of(surface, AZIMUTH_RAD, ELEVATION_RAD)
    words = np.asarray(visible_words(surface, jnp.asarray(ALTITUDES_M), sky))
    return words >> np.arange(len(AZIMUTH_RAD), dtype=np.uint32).reshape(-1, 1, 1, 1, 1) & 1


def returns(surface: Surface) -> jax.Array:
    return jnp.rint(compute_lidar(surface, ALTITUDES_M, Lidar()) * Lidar().azimuths)


def distances(surface: Surface) -> jax.Array:
    each = (Risk(50.0, distance) for distance in ("slice", "solid"))
    return jnp.stack([50.0 * compute_risk(surface, ALTITUDES_M, params) for params in each])


def gradient(soft):
    """Return the gradient of a soft metric's mean over some cells by all roofs."""
    return lambda surface: jax.grad(lambda roof_m: soft(replace(surface, roof_m=roof_m)).mean())(
        surface.roof_m
    )


def gps_at(surface: Surface) -> jax.Array:
    return soft_gps(
        surface, 20.0, 20.0, 2.0, SkyView.of(city(), AZIMUTH_RAD, ELEVATION_RAD), cells=CELLS
    )


def lidar_at(surface: Surface) -> jax.Array:
    return soft_lidar(surface, 20.0, Lidar(), 2.0, cells=CELLS)


@pytest.mark.parametrize(
    ("work", "terrain", "allowed"),
    [
        (satellites, False, GRAZING),
        (satellites, True, SAME),
        (returns, False, SAME),
        (returns, True, SAME),
        (distances, True, METRES),
        (gradient(gps_at), False, GRADIENT),
        (gradient(lidar_at), False, GRADIENT),
    ],
)
def test_maps_and_gradients_are_the_same_but_for_rounding(gpu, work, terrain, allowed):
    expected, found = on_both(work, city(terrain), gpu)
    assert np.count_nonzero(expected) > 10
    answer = difference(found, expected, **allowed[0])
    assert not answer["is_wrong"], answer["differs"]


@pytest.mark.parametrize("num", [9, 31])
def test_dilutions_are_the_same_to_a_ten_thousandth(gpu, num):
    rng = np.random.default_rng(num)
    words = rng.integers(0, 2**num, (1, 1, 200, 300)).astype(np.uint32)
    angles = rng.uniform(0, 6, num), rng.uniform(0.1, 1.5, num)

    def dilutions(words: jax.Array) -> jax.Array:
        maps = maps_of_words(words, satellites_of(InView(*angles, ())), 20.0)
        return jnp.stack([maps.gdop, maps.pdop, maps.hdop, maps.vdop, maps.tdop])

    cpu_dops, gpu_dops = on_both(dilutions, words, gpu)
    is_usable = (
        cpu_dops < 20
    )  # above, nobody flies by it, and rounding may tell another of several hundreds from inf
    assert is_usable.mean() > 0.5
    np.testing.assert_allclose(gpu_dops[is_usable], cpu_dops[is_usable], rtol=1e-4)


@pytest.mark.parametrize("series", ["epochs", "statistics"])
def test_maps_made_at_once_are_the_host_s_but_for_rounding(gpu, series):
    task = tiled_runs.task(tiled_runs.city(), series)
    found, expected = (compute_maps(task, device_bytes=size).ds for size in (np.inf, None))
    for name, values in expected.data_vars.items():
        if values.dtype.kind not in "fui":
            continue
        is_grazed = {"absolute": 1e-4, "relative": 1e-4, "share": 1e-3}
        answer = difference(found[name].values, values.values, **is_grazed)
        assert not answer["is_wrong"], (name, answer["differs"])


def test_a_sampled_search_finds_the_cost_of_numba(gpu):
    problem, limits = walled_problem(1, "line"), {"budget_s": np.inf, "max_samples": 500}
    ((_, sampled),) = solve_batched(
        [problem], planner="bitstar-plus", heuristic="plus", seeds=[0], **limits
    )
    assert sampled.cost == pytest.approx(bitstar_plus(problem, **limits).cost, rel=1e-9)
