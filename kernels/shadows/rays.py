"""How high the shadow of the roofs reaches at single places, in JAX: each ray walks its own digital line.

The definition is that of `jaxurban.kernels.shadows.sweep.shadow_height`, whose lines and rule these are; a sweep
answers for every cell of a grid, a walk for as many places as there are, each with a direction of its own. Heights
agree to 1e-3 m in float32, but where a line passes within 1e-4 cells of the border between two.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.kernels.shadows.sweep import ENTRY_STEPS
from jaxurban.programs import kept_jit

RAYS_A_TURN = 4096  # that walk together: as far as the longest of them


class Walks(NamedTuple):
    """Digital lines from single cells. ``R`` rays.

    Attributes:
      row_step, col_step: ``[R]`` cells from one step to the next: 1 or -1 along the axis that is walked, and a
        fraction, toward the source, across it.
      row_phase, col_phase: ``[R]`` by how much the line leaves the cells' centres at the start, in [0, 1).
      drop_m: ``[R]`` height that a ray gains in a step.
    """

    row_step: np.ndarray
    col_step: np.ndarray
    row_phase: np.ndarray
    col_phase: np.ndarray
    drop_m: np.ndarray


def walks(
    azimuth_rad: Float[np.ndarray, " R"],
    elevation_rad: Float[np.ndarray, " R"],
    resolution_m: float,
    row: Int[np.ndarray, " R"],
    col: Int[np.ndarray, " R"],
) -> Walks:
    """Return the digital line of each ray, computed in float64 on the host.

    Args:
      azimuth_rad: direction of the source, clockwise from grid north.
      elevation_rad: its height above the horizon, in (0, pi/2].
      resolution_m: side of a cell.
      row, col: global numbers of the cells where the rays begin.
    """
    east, north = np.sin(azimuth_rad), np.cos(azimuth_rad)

    # A line is walked along the axis that it is nearer to, a whole cell a step, and moves across it by the slope.
    is_rows = np.abs(north) >= np.abs(east)
    along = np.where(is_rows, north, east)
    across = np.where(is_rows, east, north)
    ahead = np.where(along > 0, 1.0, -1.0)
    slope = across / along
    # The same phase as `digital_line`'s, which counts from cell 0 of the axis that is walked.
    start = slope * np.where(is_rows, row, col) + 0.5
    phase = start - np.floor(start)
    sideways = slope * ahead

    in_type = partial(np.asarray, dtype=np.float32)
    return Walks(
        in_type(np.where(is_rows, ahead, sideways)),
        in_type(np.where(is_rows, sideways, ahead)),
        in_type(np.where(is_rows, 0.0, phase)),
        in_type(np.where(is_rows, phase, 0.0)),
        in_type(resolution_m / np.abs(along) * np.tan(elevation_rad)),
    )


def shadows_at(
    top_m: Float[Array, "Y X"],
    row: Int[np.ndarray, " R"],
    col: Int[np.ndarray, " R"],
    lines: Walks,
    most_m: float,
) -> Float[np.ndarray, " R"]:
    """Return the height below which each place does not see its source, ``[R]``; -inf where nothing shadows.

    Args:
      top_m: absolute height of what throws a shadow, -inf where nothing does, row 0 in the south; nothing stands
        outside.
      row, col: cells of ``top_m`` where the rays begin.
      lines: of the rays.
      most_m: a ray is followed until it has risen this far: the height of the highest top above the lowest place is
        enough.
    """
    # Steep rays, which are short, come first, since rays of one turn walk as long as the longest of them.
    order = np.argsort(-lines.drop_m, kind="stable")
    shadow_m = np.empty(len(order), np.float32)
    for first in range(0, len(order), RAYS_A_TURN):
        chosen = order[first : first + RAYS_A_TURN]
        # Repeated up to a power of two, so that few shapes are compiled.
        filled = np.resize(chosen, min(RAYS_A_TURN, 2 ** int(np.ceil(np.log2(len(order))))))
        start = np.asarray(row[filled], np.int32), np.asarray(col[filled], np.int32)
        walked = walk(
            top_m, *start, Walks(*(values[filled] for values in lines)), np.float32(most_m)
        )
        shadow_m[chosen] = np.asarray(walked)[: len(chosen)]
    return shadow_m


@kept_jit
def walk(
    top_m: Float[Array, "Y X"],
    row: Int[Array, " R"],
    col: Int[Array, " R"],
    lines: Walks,
    most_m: Float[Array, ""],
) -> Float[Array, " R"]:
    """Return what `shadows_at` does, for rays that walk together until all of them have risen by ``most_m``.

    Arguments are those of `shadows_at`.
    """
    num_rows, num_cols = top_m.shape

    def is_below(state: tuple[Array, Array]) -> Array:
        """Return whether a ray is still low enough, and the map long enough, for another step."""
        step, _ = state
        return jnp.any(step * lines.drop_m < most_m) & (step < max(num_rows, num_cols))

    def ahead(state: tuple[Array, Array]) -> tuple[Array, Array]:
        """Take one step along all rays, and raise each ray's shadow by the top that it meets there."""
        step, shadow_m = state
        of_row = row + jnp.floor(lines.row_phase + step * lines.row_step).astype(jnp.int32)
        of_col = col + jnp.floor(lines.col_phase + step * lines.col_step).astype(jnp.int32)
        met_m = top_m.at[of_row, of_col].get(mode="fill", fill_value=-jnp.inf)
        # Negative numbers would count from the end; a ray that has risen enough ends, whatever others walk beside it.
        counts = (of_row >= 0) & (of_col >= 0)
        counts &= step * lines.drop_m < most_m
        thrown_m = met_m + (ENTRY_STEPS - step) * lines.drop_m
        return step + 1, jnp.maximum(shadow_m, jnp.where(counts, thrown_m, -jnp.inf))

    nothing = jnp.full(row.shape, -jnp.inf, top_m.dtype)
    return lax.while_loop(is_below, ahead, (jnp.float32(1), nothing))[1]
