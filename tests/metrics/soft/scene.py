"""A small city of boxes as a building index and heights, for soft metrics."""

import jax.numpy as jnp
import numpy as np

from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface, roofs_of

HALO = 9  # cells of 5 m: a range or a threshold of 40 m, and one cell more
REGION = Grid("EPSG:32618", 5.0, 901_000, 116_000, 15, 18)
GRID = REGION.padded(HALO, HALO, HALO, HALO)
ALTITUDE_M = 20.3
CELLS = np.array([[0, 0], [3, 11], [14, 17], [7, 7], [9, 2]], np.int32)


def scene(num_buildings: int = 30, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return ascending heights ``[B]`` and the building under each cell; boxes of 2 to 4 cells, the highest on top."""
    rng = np.random.default_rng(seed)
    building = np.full(GRID.shape, -1, np.int32)
    for number in range(num_buildings):
        row, col = rng.integers(0, GRID.num_rows - 3), rng.integers(0, GRID.num_cols - 3)
        building[row : row + rng.integers(2, 5), col : col + rng.integers(2, 5)] = number
    return np.sort(rng.uniform(4.0, 40.0, num_buildings)), building


def surface_of(height_m, building: np.ndarray, terrain_m=None) -> Surface:
    """Return the scene's surface in the type of its heights."""
    height_m = jnp.asarray(height_m)
    terrain = None if terrain_m is None else jnp.asarray(terrain_m, height_m.dtype)
    return Surface(roofs_of(height_m, jnp.asarray(building)), terrain, None, None, GRID, REGION)


def hills(relief_m: float = 12.0) -> np.ndarray:
    """Return a rolling ground on the scene's grid."""
    row, col = np.indices(GRID.shape)
    return relief_m * (1 + np.sin(row / 4.1) * np.cos(col / 5.3))
