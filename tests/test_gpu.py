"""What a GPU computes is what the CPU computes. Run with ``pytest -m gpu`` where JAX has a GPU."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.kernels.distance.nearest import capped_distance, capped_distance_over_terrain
from jaxurban.metrics.gps import soft_gps
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from jaxurban.metrics.visibility import SkyView, visibility
from jaxurban.planners.base import Problem
from jaxurban.planners.bitstar.planner import bitstar_plus
from jaxurban.planners.bulk import solve_batched
from jaxurban.planners.registry import solve_many
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface
from tests.metrics.whole_maps import gps_maps

pytestmark = pytest.mark.gpu

SHARE = 1e-6  # of the answers may differ between CPU and GPU, where rounding falls on a border
NUM_ROWS, NUM_COLS, MARGIN = 240, 310, 30
GRID = Grid("EPSG:32618", 5.0, 0, 0, NUM_ROWS, NUM_COLS)
REGION = Grid("EPSG:32618", 5.0, MARGIN, MARGIN, NUM_ROWS - 2 * MARGIN, NUM_COLS - 2 * MARGIN)
AZIMUTH_RAD, ELEVATION_RAD = np.linspace(0.2, 6.0, 9), np.linspace(0.15, 1.3, 9)
ALTITUDES_M = (20.0, 60.0)


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
    ground_m = (8 * np.sin(rows / 17) + 5 * np.cos(cols / 23)).astype(np.float32) if terrain else None
    return Surface(roof_m, ground_m, None, None, GRID, REGION)


def on_both(work, given, gpu: jax.Device) -> tuple[np.ndarray, np.ndarray]:
    """Return what a function makes of the same arrays on the CPU and on the GPU."""
    found = []
    for device in (jax.devices("cpu")[0], gpu):
        with jax.default_device(device):
            result = jax.block_until_ready(work(jax.device_put(given, device)))
        assert not isinstance(result, jax.Array) or result.devices() == {device}  # words come to the host at once
        found.append(np.asarray(result))
    return found[0], found[1]


@pytest.mark.parametrize("terrain", [False, True])
def test_satellites_seen_are_the_same(gpu, terrain):
    cpu_words, gpu_words = on_both(
        lambda surface: visibility(surface, AZIMUTH_RAD, ELEVATION_RAD, ALTITUDES_M), city(terrain), gpu
    )
    num_differ = np.bitwise_count(cpu_words ^ gpu_words).sum()
    assert num_differ <= SHARE * len(AZIMUTH_RAD) * cpu_words.size
    assert len(np.unique(cpu_words)) > 20


@pytest.mark.parametrize("terrain", [False, True])
def test_lidar_returns_are_the_same(gpu, terrain):
    params = Lidar()
    shares = on_both(lambda surface: compute_lidar(surface, ALTITUDES_M, params), city(terrain), gpu)
    cpu_counts, gpu_counts = (np.rint(share * params.azimuths) for share in shares)
    assert np.mean(cpu_counts != gpu_counts) <= SHARE
    assert len(np.unique(cpu_counts)) > 50


def test_distances_lie_within_a_hundredth_of_a_millimetre(gpu):
    surface = city(terrain=True)

    def both(surface: Surface) -> jax.Array:
        source_m2 = jnp.where(surface.roof_m >= 20, 0.0, jnp.inf)
        receiver_m, has_building = surface.terrain_m + 20, surface.roof_m > 0
        sizes = {"resolution_m": 5.0, "cap_m": 50.0}
        over = capped_distance_over_terrain(receiver_m, surface.top_m, has_building, **sizes)
        return jnp.stack([capped_distance(source_m2, **sizes), over])

    cpu_m, gpu_m = on_both(both, surface, gpu)
    np.testing.assert_allclose(gpu_m, cpu_m, rtol=0, atol=1e-5)


@pytest.mark.parametrize("num", [9, 31])
def test_dilutions_are_the_same_to_a_ten_thousandth(gpu, num):
    rng = np.random.default_rng(num)
    words = rng.integers(0, 2**num, (1, 1, 200, 300)).astype(np.uint32)
    angles = rng.uniform(0, 6, num), rng.uniform(0.1, 1.5, num)

    def dilutions(words: jax.Array) -> jax.Array:
        maps = gps_maps(words, jnp.zeros(words.shape[1:], bool), InView(*angles, ()))
        return jnp.stack([maps.gdop, maps.pdop, maps.hdop, maps.vdop, maps.tdop])

    cpu_dops, gpu_dops = on_both(dilutions, words, gpu)
    is_usable = cpu_dops < 20  # above, nobody flies by it, and rounding may tell another of several hundreds from inf
    assert is_usable.mean() > 0.5
    np.testing.assert_allclose(gpu_dops[is_usable], cpu_dops[is_usable], rtol=1e-4)


@pytest.mark.parametrize("name", ["gps", "lidar"])
def test_gradients_by_roofs_are_the_same_to_a_thousandth_of_the_largest(gpu, name):
    surface = city()
    cells = np.random.default_rng(0).integers(20, 120, (64, 2)).astype(np.int32)
    view = SkyView.of(surface, AZIMUTH_RAD, ELEVATION_RAD)

    def slope(roof_m: jax.Array) -> jax.Array:
        def mean(roof_m: jax.Array) -> jax.Array:
            scene = replace(surface, roof_m=roof_m)
            if name == "gps":
                return soft_gps(scene, 20.0, 20.0, 2.0, view, cells=cells).mean()
            return soft_lidar(scene, 20.0, Lidar(), 2.0, cells=cells).mean()

        return jax.grad(mean)(roof_m)

    cpu_slope, gpu_slope = on_both(slope, surface.roof_m, gpu)
    assert np.count_nonzero(cpu_slope) > 10
    np.testing.assert_allclose(gpu_slope, cpu_slope, rtol=0, atol=1e-3 * np.abs(cpu_slope).max())


@pytest.fixture(scope="module")
def queries() -> list[Problem]:
    """Queries between free cells of a map with walls; JAX's default device runs them."""
    rng = np.random.default_rng(3)
    is_free = rng.random((150, 180)) > 0.25
    cells = np.argwhere(is_free)
    first = tuple(int(v) for v in cells[0])
    problem = Problem(rng.uniform(0, 1, (1, *is_free.shape)), is_free, first, first, 5.0, 0.1)
    pairs = cells[rng.choice(len(cells), (24, 2))]
    return [problem.between(tuple(map(int, start)), tuple(map(int, goal))) for start, goal in pairs]


def test_costs_of_many_queries_are_those_of_numba(gpu, queries):
    found, expected = (dict(solve_many(queries, backend=backend, heuristic="octile")) for backend in ("jax", "numba"))
    costs = [[paths[k].cost for k in range(len(queries))] for paths in (found, expected)]
    assert np.isfinite(costs[1]).sum() > 10
    np.testing.assert_allclose(costs[0], costs[1], rtol=1e-9)


def test_bitstar_finds_the_same_cost_at_equal_samples(gpu, queries):
    expected = bitstar_plus(queries[0], budget_s=np.inf, max_samples=500)
    ((_, found),) = solve_batched(
        queries[:1], planner="bitstar-plus", heuristic="plus", seeds=[0], budget_s=np.inf, max_samples=500
    )
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
