"""DOPs against NumPy's batched inverse in float64."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from benchmarks.common import Row, clocked, in_turn, row
from benchmarks.scenes import ALTITUDES_M, Scene
from jaxurban.kernels.dop import Dops, Geometry, dops_of_words, geometry, unit_vectors
from jaxurban.metrics.gps import BLOCK_CELLS, SATELLITES_STEP
from jaxurban.metrics.visibility import visibility

LEAST_SATELLITES = 4  # three coordinates and the clock
BATCH = 2**16  # matrices in one call of the peer: more or fewer are slower


@jax.jit
def ours(satellites: Geometry, words: jax.Array) -> Dops:
    """Return the DOPs of ``[N, W, BLOCK_CELLS]`` words, block by block as the GPS maps do."""
    return lax.map(lambda block: dops_of_words(satellites, block), words)


def numpy_inverse(directions: np.ndarray, bits: np.ndarray) -> np.ndarray:
    """Return ``[5, N]`` GDOP, PDOP, HDOP, VDOP and TDOP of ``[N, S]`` visibility, at least four seen."""
    matrix = np.column_stack([directions, -np.ones(len(directions))])
    products = (matrix[:, :, None] * matrix[:, None, :]).reshape(-1, 16)
    out = np.empty((5, len(bits)))
    for first in range(0, len(bits), BATCH):
        part = slice(first, first + BATCH)
        normal = (bits[part] @ products).reshape(-1, 4, 4)
        variance = np.diagonal(np.linalg.inv(normal), axis1=1, axis2=2)
        position = variance[:, :3].sum(axis=1)
        level = variance[:, :2].sum(axis=1)
        out[:, part] = np.sqrt([position + variance[:, 3], position, level, variance[:, 2], variance[:, 3]])
    return out


def measure(scene: Scene, num_runs: int) -> list[Row]:
    surface = scene.surface(5.0)
    directions = unit_vectors(scene.azimuth_rad, scene.elevation_rad)
    words = np.asarray(visibility(surface, scene.azimuth_rad, scene.elevation_rad, ALTITUDES_M))
    words = words.reshape(len(words), -1)
    bits = (words[0] >> np.arange(len(directions), dtype=np.uint32)[:, None]) & 1
    words = words[:, bits.sum(axis=0) >= LEAST_SATELLITES]
    num_cells = words.shape[1] // BLOCK_CELLS * BLOCK_CELLS
    words = words[:, :num_cells]
    bits = ((words[0] >> np.arange(len(directions), dtype=np.uint32)[:, None]) & 1).T.astype(float)
    blocks = jnp.asarray(words.reshape(len(words), -1, BLOCK_CELLS).swapaxes(0, 1))
    satellites = geometry(directions, multiple_of=SATELLITES_STEP)
    sides = {
        "ours": clocked(lambda: ours(satellites, blocks)),
        "NumPy": clocked(lambda: numpy_inverse(directions, bits)),
    }
    times = in_turn(sides, num_runs)
    gdop, exact = np.asarray(ours(satellites, blocks).gdop).ravel(), numpy_inverse(directions, bits)[0]
    usable = exact < 20
    note = f"differs by {np.abs(gdop / exact - 1)[usable].max():.0e} of a GDOP below 20 at most"
    return [
        row("DOPs", "NumPy linalg.inv", "cells", (num_cells, times["ours"]), (num_cells, times["NumPy"]), note=note)
    ]
