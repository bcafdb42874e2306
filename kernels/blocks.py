"""Square blocks of two sizes, in which grids of any shape are computed: so few programs are compiled."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

SMALL, LARGE = 128, 512  # sides in cells: the one wastes little of a town, the other has few calls
HALO_STEP = 16  # cells in which halos and margins grow, so that arrays of few shapes are made


def rounded_up(number: int, multiple: int = HALO_STEP) -> int:
    """Return the next multiple that is not below a number."""
    return -(-number // multiple) * multiple


def blocks_of(shape: tuple[int, int]) -> Iterator[tuple[int, int, int]]:
    """Yield row, column and side of the blocks that cover a grid: large ones where they fit, small ones beside.

    Those at the end may stick out of it.
    """
    large_rows, large_cols = (size // LARGE * LARGE for size in shape)
    for row in range(0, large_rows, LARGE):
        for col in range(0, large_cols, LARGE):
            yield row, col, LARGE
    for row in range(0, shape[0], SMALL):
        for col in range(0, shape[1], SMALL):
            if row >= large_rows or col >= large_cols:
                yield row, col, SMALL


def part_of(
    values: np.ndarray, corner: tuple[int, int], shape: tuple[int, int], fill: float
) -> np.ndarray:
    """Return a part of an array ``[Y, X]`` from a row and a column on, filled where it sticks out of it."""
    begins = [max(start, 0) for start in corner]
    ends = [
        min(start + size, whole)
        for start, size, whole in zip(corner, shape, values.shape, strict=True)
    ]
    inner = values[begins[0] : max(ends[0], begins[0]), begins[1] : max(ends[1], begins[1])]
    if inner.shape == shape:
        return np.ascontiguousarray(inner)
    part = np.full(shape, fill, values.dtype)
    row, col = begins[0] - corner[0], begins[1] - corner[1]
    part[row : row + inner.shape[0], col : col + inner.shape[1]] = inner
    return part


def by_cells(function: Callable[[Array], Any], values: Array, num_together: int) -> Any:
    """Return what a function makes of ``[N, ...]`` values, called for so many cells after the other, ``[N, C]``.

    Cells of zeros fill the last call up, so that every one has the same shape.
    """
    shape = values.shape[1:]
    num = math.prod(shape)
    flat = jnp.pad(values.reshape(len(values), num), ((0, 0), (0, -num % num_together)))
    calls = flat.reshape(len(values), -1, num_together).swapaxes(0, 1)
    made = lax.map(function, calls)
    return jax.tree.map(lambda of_calls: of_calls.reshape(-1)[:num].reshape(shape), made)
