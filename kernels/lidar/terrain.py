"""Lidar scan returns over terrain: the stepping rule of `lidar.flat`, the ground ending beams as well.

What a receiver sees depends on its own ground, and it may lose its lowest beams to the ground: a beam ends where its
lowest height over a segment is not above the terrain of the cell looked at. There is a shape for a CPU
(`lidar.terrain_cpu`) and one for a GPU (`lidar.steps`), whose counts are the same.
"""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxurban.kernels.host import is_on_host, on_host
from jaxurban.kernels.lidar.steps import count_returns_on_terrain_by_steps
from jaxurban.kernels.lidar.terrain_cpu import count_on_terrain
from jaxurban.kernels.lidar.terrain_march import MOST_BEAMS, Looks


def distinct_looks(starts: Int[np.ndarray, "K N 3"]) -> Looks:
    """Return the looks of rays, those that several rays share once."""
    num_steps = starts.shape[1]
    sides = (num_steps, *(starts.max(axis=(0, 1)) + 1))
    steps = np.broadcast_to(np.arange(num_steps), starts.shape[:2])
    of_ray = np.ravel_multi_index((steps, *np.moveaxis(starts, -1, 0)), sides).ravel()
    order = np.argsort(of_ray, kind="stable")
    look, first = np.unique(of_ray[order], return_index=True)
    step, *start = np.unravel_index(look, sides)
    first_of_step = np.searchsorted(step, np.arange(num_steps + 1))
    parts = np.stack(start, axis=-1), first_of_step, order // num_steps, np.append(first, of_ray.size)
    return Looks(*(np.ascontiguousarray(part, np.int32) for part in parts))


def count_returns_on_terrain(
    roof_m: Float[Array, "P Y+2H X+2H"],
    terrain_m: Float[Array, "P Y+2H X+2H"],
    lowest_m: Float[Array | np.ndarray, "A N B"],
    starts: Int[np.ndarray, "K N 3"],
    *,
    halo: int,
    receiver_phase: int = 0,
    shape: Literal["cpu", "gpu"] | None = None,
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building before the terrain, ``[A, Y, X]`` int32.

    Receivers stand ``altitude`` above their own cell's terrain, roofs ``roof_m`` above theirs. Equals
    `jaxurban.kernels.lidar.flat.count_returns` over constant terrain. The gradient is zero.

    Args:
      roof_m: roof heights above their ground, 0 without a building, as `jaxurban.kernels.lidar.supersampled.phases`.
      terrain_m: ground elevation, likewise.
      lowest_m: ``[A, N, B]`` from `jaxurban.kernels.lidar.flat.lowest_heights`, rounded up to the type of ``roof_m``.
      starts: from `jaxurban.kernels.lidar.supersampled.phase_starts`.
      halo: H, cells beyond the receivers.
      receiver_phase: the phase in which receivers stand.
      shape: of the computation, for a CPU or a GPU; left out, for the platform on which the roofs lie, and for a GPU
        where JAX traces them or there are more than `MOST_BEAMS`. The counts are the same.
    """
    suits_cpu = is_on_host(roof_m, terrain_m, lowest_m) if shape is None else shape == "cpu"
    if not suits_cpu or lowest_m.shape[-1] > MOST_BEAMS:
        return count_returns_on_terrain_by_steps(
            roof_m, terrain_m, lowest_m, jnp.asarray(starts), halo=halo, receiver_phase=receiver_phase
        )
    looks = distinct_looks(starts)
    roofs, grounds, beams = (on_host(values) for values in (roof_m, terrain_m, lowest_m))
    counts = np.zeros((len(beams), *(size - 2 * halo for size in roofs.shape[1:])), np.int32)
    for k in range(len(beams)):
        count_on_terrain(roofs, grounds, beams[k], looks, len(starts), halo, receiver_phase, counts[k])
    return jnp.asarray(counts)
