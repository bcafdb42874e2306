"""GPS occlusion and lidar against Embree rays through the exact outlines."""

import jax
import numpy as np

from benchmarks.common import Row, Side, clocked, in_turn
from benchmarks.embree_peer import Answers, EmbreePool, scan_until_first_return, see_satellites
from benchmarks.scenes import ALTITUDES_M, Scene
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.visibility import visibility
from jaxurban.world.grid import Grid

RESOLUTION_M = 5.0
LIDAR_ALTITUDE_M = 20.0
NUM_LIDAR_CELLS = 2000  # of Embree's share; 720,000 scan positions
PEER = "Embree"


def cell_centres(grid: Grid) -> np.ndarray:
    """Return ``[y * x, 2]`` metres, row by row."""
    x_m, y_m = np.meshgrid(grid.x_m, grid.y_m)
    return np.column_stack([x_m.ravel(), y_m.ravel()])


def peer_side(pool: EmbreePool, found: dict[str, np.ndarray], name: str, *job: object) -> Side:
    """Return a run of a job by Embree that keeps what it found."""

    def run() -> tuple[float, float]:
        answers: Answers = pool.run(*job)
        found[name] = answers.found
        return answers.wall_s, answers.cpu_s

    return run


def occlusion(scene: Scene, pool: EmbreePool, num_runs: int) -> Row:
    """Return the row of line-of-sight answers: cells x satellites x altitudes."""
    surface = scene.surface(RESOLUTION_M)
    found: dict[str, np.ndarray] = {}
    directions = unit_vectors(scene.azimuth_rad, scene.elevation_rad)

    def ours() -> jax.Array:
        return visibility(surface, scene.azimuth_rad, scene.elevation_rad, ALTITUDES_M)

    job = (see_satellites, cell_centres(surface.region), np.array(ALTITUDES_M), directions)
    times = in_turn({"ours": clocked(ours), PEER: peer_side(pool, found, "seen", *job)}, num_runs)
    words = np.asarray(ours())[0].reshape(len(ALTITUDES_M), 1, -1)
    seen = (words >> np.arange(len(directions), dtype=np.uint32)[:, None]) & 1 == 1
    free = np.asarray(surface.crop(surface.roof_m)).ravel() < np.array(ALTITUDES_M)[:, None]
    agree = [np.mean((seen == found["seen"])[k][:, free[k]]) for k in range(len(ALTITUDES_M))]
    note = f"{scene.name}, 5 m; in free cells {' / '.join(f'{100 * a:.1f}' for a in agree)} % agree at 20 / 60 / 122 m"
    num = found["seen"].size
    return Row("GPS occlusion", PEER, "answers", num, num, *times.values(), bar=40, note=note)


def lidar(scene: Scene, pool: EmbreePool, num_runs: int) -> Row:
    """Return the row of lidar: scan positions, of which both sides look no farther than the first return."""
    surface, params = scene.surface(RESOLUTION_M), Lidar()
    centres_m = cell_centres(surface.region)
    chosen = np.sort(
        np.random.default_rng(0).choice(len(centres_m), NUM_LIDAR_CELLS, replace=False)
    )
    found: dict[str, np.ndarray] = {}

    def ours() -> jax.Array:
        return compute_lidar(surface, [LIDAR_ALTITUDE_M], params)

    place = (centres_m[chosen], LIDAR_ALTITUDE_M, params)
    sides = {
        "ours": clocked(ours),
        PEER: peer_side(pool, found, "scan", scan_until_first_return, *place),
    }
    times = in_turn(sides, num_runs)
    free = np.asarray(surface.crop(surface.roof_m)).ravel()[chosen] < LIDAR_ALTITUDE_M
    error = (np.asarray(ours()).ravel()[chosen] - found["scan"])[free]
    note = f"{scene.name}, 5 m, 20 m up; mean absolute difference of m {np.abs(error).mean():.4f}"
    nums = (cells * params.azimuths for cells in (len(centres_m), NUM_LIDAR_CELLS))
    return Row("lidar", PEER, "scan positions", *nums, *times.values(), bar=300, note=note)


def measure(scene: Scene, num_runs: int) -> list[Row]:
    with EmbreePool(scene.city.buildings) as pool:
        return [occlusion(scene, pool, num_runs), lidar(scene, pool, num_runs)]
