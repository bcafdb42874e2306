"""Square blocks of two sizes, in which grids of any shape are computed: so few programs are compiled."""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

SMALL, LARGE = 128, 512  # sides in cells: the one wastes little of a town, the other has few calls
# Cells whose DOPs are made at once, by one core: what they need in between fits its cache.
BLOCK_CELLS = 2**11
WIDE_BLOCK_CELLS = 2**22  # the same on a GPU, which has a launch for every block
HALO_STEP = 16  # cells in which halos and margins grow, so that arrays of few shapes are made


def rounded_up(number: int, multiple: int = HALO_STEP) -> int:
    """Return the next multiple that is not below a number."""
    return -(-number // multiple) * multiple


def blocks_of(shape: tuple[int, int]) -> Iterator[tuple[int, int, int]]:
    """Yield the southwest row, southwest column and side of each block that covers a grid, all in cells.

    Large blocks (`LARGE` cells a side) lie where they fit whole, small ones (`SMALL`) in the strips that are left in
    the north and in the east. The last small blocks may reach beyond the grid.

    Args:
      shape: rows and columns of the grid.
    """
    num_rows, num_cols = shape
    # Rows and columns that large blocks cover.
    large_rows = num_rows // LARGE * LARGE
    large_cols = num_cols // LARGE * LARGE

    for row in range(0, large_rows, LARGE):
        for col in range(0, large_cols, LARGE):
            yield row, col, LARGE

    for row in range(0, num_rows, SMALL):
        for col in range(0, num_cols, SMALL):
            if row >= large_rows or col >= large_cols:
                yield row, col, SMALL


def part_of(
    values: np.ndarray, corner: tuple[int, int], shape: tuple[int, int], fill: float
) -> np.ndarray:
    """Return a contiguous rectangular part of an array ``[Y, X]``, filled where the part reaches beyond the array.

    The part may be a view of the array's memory.

    Args:
      values: the array.
      corner: row and column of the array at which the part begins; may be negative.
      shape: rows and columns of the part.
      fill: value of the part's cells outside the array.
    """
    # Where the part lies inside the array, by axis: empty where an end is not above its beginning.
    begins = [max(start, 0) for start in corner]
    ends = [
        min(start + size, whole)
        for start, size, whole in zip(corner, shape, values.shape, strict=True)
    ]
    inner = values[begins[0] : max(ends[0], begins[0]), begins[1] : max(ends[1], begins[1])]
    if inner.shape == shape:
        return np.ascontiguousarray(inner)

    part = np.full(shape, fill, values.dtype)
    row, col = begins[0] - corner[0], begins[1] - corner[1]  # of the inner part in the part
    part[row : row + inner.shape[0], col : col + inner.shape[1]] = inner
    return part


def by_cells(function: Callable[[Array], Any], values: Array, num_together: int) -> Any:
    """Return what a function gives for all cells, calling it for one group of cells after the other.

    Only one group's intermediate arrays are in memory at a time.

    Args:
      function: takes ``[N, C]`` values of a group of C cells; returns an array ``[C]``, or a pytree of such arrays.
      values: ``[N, ...]``, N numbers for each cell.
      num_together: C. Cells of zeros fill the last group up, so that all groups have the same shape.

    Returns:
      The function's pytree, each array in the shape ``[...]`` of the cells.
    """
    shape = values.shape[1:]
    num_cells = math.prod(shape)
    flat = jnp.pad(values.reshape(len(values), num_cells), ((0, 0), (0, -num_cells % num_together)))
    groups = flat.reshape(len(values), -1, num_together).swapaxes(0, 1)
    results = lax.map(function, groups)
    return jax.tree.map(lambda result: result.reshape(-1)[:num_cells].reshape(shape), results)


def by_device_cells(function: Callable[[Array], Any], values: Any) -> Any:
    """Return `by_cells` in groups that suit the device that computes.

    They are small on a CPU, and elsewhere wide ones of equal size, so that hardly a cell is added to fill the last one.
    """
    # Fewer cells than a small group count as one.
    num_cells = max(math.prod(values.shape[1:]), BLOCK_CELLS)
    num_wide_blocks = math.ceil(num_cells / WIDE_BLOCK_CELLS)
    wide_cells = math.ceil(num_cells / num_wide_blocks)
    in_small_blocks = partial(by_cells, function, num_together=BLOCK_CELLS)
    in_wide_blocks = partial(by_cells, function, num_together=wide_cells)
    return lax.platform_dependent(values, cpu=in_small_blocks, default=in_wide_blocks)
