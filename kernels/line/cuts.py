"""Where segments cross the lines of a grid, as arrays of fixed size that can be differentiated."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


def cuts_needed(points_m: np.ndarray, resolution_m: float, first_cells: float) -> int:
    """Return the most lines of one direction that a segment crosses, as a power of two, so that shapes stay few.

    Args:
      points_m: ``[N, 2]`` polyline, x, y from the map's southwest corner.
      resolution_m: side of a cell.
      first_cells: where the first line runs, in cell sides: 0 for borders of cells, 0.5 for rows of centres.
    """
    spans = np.abs(np.diff(np.floor(np.asarray(points_m, np.float64) / resolution_m - first_cells), axis=0))
    return 1 << int(np.ceil(np.log2(max(1.0, float(spans.max(initial=0.0))))))


def cuts(begin: Array, along: Array, num_cuts: int) -> Array:
    """Return ``[S, 2 num_cuts + 2]`` where segments cross whole numbers, as ascending shares of them, 0 and 1 too."""
    low = jnp.minimum(begin, begin + along)
    number = jnp.floor(low)[..., None] + jnp.arange(1, num_cuts + 1, dtype=begin.dtype)  # [S, 2, num_cuts]
    span = along[..., None]
    share = inner_share(number - begin[..., None], span)
    ends = jnp.stack([jnp.zeros_like(low[:, 0]), jnp.ones_like(low[:, 0])], axis=-1)
    return jnp.sort(jnp.concatenate([ends, share.reshape(len(begin), 2 * num_cuts)], axis=-1), axis=-1)


def inner_share(part: Array, span: Array) -> Array:
    """Return part over span where it lies between 0 and 1, else 1."""
    share = part / jnp.where(span == 0, 1.0, span)
    return jnp.where((share > 0) & (share < 1) & (span != 0), share, 1.0)


def lengths(along: Array) -> Array:
    """Return ``[S]`` the lengths of vectors ``[S, D]``; the gradient of one of no length is 0."""
    square = (along**2).sum(axis=-1)
    return jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)
