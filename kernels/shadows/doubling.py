"""Shadows of many directions at once with no loop over rows: doubling along the digital lines, the shape for a GPU.

Each pass doubles how far every cell has looked along its line: ``M_0 = raised`` and ``M_{j+1}[p] = max(M_j[p],
M_j[p + 2^j steps] - 2^j x drop)``; the shadow is ``M_J[p + 1 step] - drop``. A pass is one operation over all cells and
directions, where the sweep of `jaxurban.kernels.shadows.sweep` needs one a row; on a CPU, which does both one cell
after the other, the sweep is some 30 times faster.

The lines are the sweep's own, and so are the answers but for rounding: the sweep takes the drop off row by row,
doubling takes a multiple of it off at once. Heights differ by less than 1e-3 m in float32, and a cell's answer only
where its receiver stands within that of a shadow's edge.
"""

import math
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, UInt

from jaxurban.kernels.shadows.sweep import EAST, ENTRY_STEPS, NORTH, SOUTH, WORD_BITS, Line, Ring, within

KernelShape = Literal["sweep", "doubling"]


def kernel_shape() -> KernelShape:
    """Return the shape of the shadows' kernel for JAX's platform: the sweep on a CPU, doubling on anything wider."""
    return "sweep" if jax.default_backend() == "cpu" else "doubling"


def num_passes(num_steps: float) -> int:
    """Return how many passes look at least ``num_steps`` rows (columns) along every line.

    As many as the longer side of the grid are always enough, and as many as a ray takes to climb above the highest
    roof: ``(highest top - lowest receiver) / drop``.
    """
    return max(1, math.ceil(math.log2(max(num_steps, 2.0))))


def _doubled(raised_m: Array, line: Line, passes: int) -> Array:
    """Return `sweep` of one direction, looking ``2^passes`` rows (columns) far."""
    num_rows, num_cols = raised_m.shape
    row = lax.broadcasted_iota(jnp.int32, raised_m.shape, 0)
    col = lax.broadcasted_iota(jnp.int32, raised_m.shape, 1)
    is_rows = (line.heading == NORTH) | (line.heading == SOUTH)
    is_forward = (line.heading == NORTH) | (line.heading == EAST)
    ahead = jnp.where(is_forward, 1, -1)
    shifts = jnp.asarray(line.shifts)
    summed = jnp.cumsum(shifts)
    offsets = jnp.where(is_forward, summed - shifts, -summed)  # cells sideways of each row (column), but for a constant
    drop_m = jnp.asarray(line.drop_m, raised_m.dtype)
    along, across = jnp.where(is_rows, row, col), jnp.where(is_rows, col, row)
    length, width = jnp.where(is_rows, num_rows, num_cols), jnp.where(is_rows, num_cols, num_rows)
    here = offsets[along]

    def beyond(values_m: Array, steps: int) -> Array:
        """Return the values that many steps along each cell's line, less what a ray gains; -inf beyond the grid."""
        there = along + ahead * steps
        side = across + offsets[jnp.clip(there, 0, length - 1)] - here
        is_inside = (there >= 0) & (there < length) & (side >= 0) & (side < width)
        cell = jnp.where(is_rows, there * num_cols + side, side * num_cols + there)
        found = values_m.reshape(-1)[jnp.where(is_inside, cell, 0)]
        return jnp.where(is_inside, found - steps * drop_m, -jnp.inf)

    reached_m = raised_m
    for k in range(passes):
        reached_m = jnp.maximum(reached_m, beyond(reached_m, 1 << k))
    return beyond(reached_m, 1)


@partial(jax.jit, static_argnames="passes")
def shadow_heights_at_once(
    top_m: Float[Array, "Y X"], lines: Line, *, passes: int, rings: Ring | None = None
) -> Float[Array, "S Y X"]:
    """Return `jaxurban.kernels.shadows.sweep.shadow_height` of every direction, ``[S, Y, X]``.

    Args:
      top_m: absolute height of roofs and bare ground, row 0 in the south.
      lines: of all directions, fields stacked along ``S``; with rings, for the grid grown by one cell on each side.
      passes: from `num_passes`; what stands farther shadows nothing.
      rings: what the grids around this one hand on, fields stacked along ``S``; left out, nothing stands there.
    """

    def cast(line: Line, ring: Ring | None) -> Array:
        raised_m = top_m + ENTRY_STEPS * jnp.asarray(line.drop_m, top_m.dtype)
        if ring is None:
            return _doubled(raised_m, line, passes)
        return _doubled(within(raised_m, ring), line, passes)[1:-1, 1:-1]

    return jax.vmap(cast)(lines, rings)


@partial(jax.jit, static_argnames="passes")
def hand_on_at_once(top_m: Float[Array, "Y X"], lines: Line, rings: Ring, *, passes: int) -> Ring:
    """Return what `jaxurban.kernels.shadows.sweep_cpu.hand_on` does, of every direction; arguments as above."""
    shadows_m = shadow_heights_at_once(top_m, lines, passes=passes, rings=rings)
    raised_m = top_m + ENTRY_STEPS * jnp.asarray(lines.drop_m, top_m.dtype)[:, None, None]
    carried_m = jnp.maximum(raised_m, shadows_m)
    return Ring(carried_m[:, 0], carried_m[:, -1], carried_m[:, :, 0], carried_m[:, :, -1])


def words_of(
    shadows_m: Float[Array, "S y x"], ground_m: Float[Array, "y x"] | None, altitudes_m: Float[Array, " A"]
) -> UInt[Array, "W A y x"]:
    """Return visibility words: satellite ``s``, bit ``s % 32`` of word ``s // 32``, is seen where no shadow reaches.

    Args:
      shadows_m: shadow heights at the receivers' cells.
      ground_m: terrain there; None for flat ground.
      altitudes_m: heights above the ground.
    """
    z_m = altitudes_m[:, None, None]
    receiver_m = z_m if ground_m is None else ground_m + z_m
    words = []
    for first in range(0, max(len(shadows_m), 1), WORD_BITS):
        seen = shadows_m[first : first + WORD_BITS, None] <= receiver_m
        bit = jnp.arange(len(seen), dtype=jnp.uint32)[:, None, None, None]
        words.append(jnp.sum(seen.astype(jnp.uint32) << bit, axis=0, dtype=jnp.uint32))
    return jnp.stack(words)
