"""Tiling: a region and its margin cut into tiles, and the order in which shadows cross them. No arrays."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, product

from jaxurban.errors import InputError
from jaxurban.world.grid import Grid

Tile = tuple[int, int]  # row and column of a tile in its tiling, the southwest one first
Quadrant = tuple[int, int]  # 1 or -1 each: the source stands in the north (1) or south, in the east (1) or west
QUADRANTS: tuple[Quadrant, ...] = ((1, 1), (1, -1), (-1, 1), (-1, -1))
MAX_SIDE = 1024  # cells of a tile's side at most: about 0.2 GiB of work at four altitudes


def tile_shape(shape: tuple[int, int], max_side: int = MAX_SIDE) -> tuple[int, int]:
    """Return rows and columns of the fewest equal tiles of at most ``max_side`` that cover ``shape``.

    It depends on the region alone, never on the machine, as files are cut into the same tiles.
    """
    rows, cols = (-(-size // -(-size // max_side)) for size in shape)
    return rows, cols


def quadrant_of(east: float, north: float) -> Quadrant:
    """Return the quadrant of a direction; due north and south count as east, due east and west as north."""
    return (1 if north >= 0 else -1), (1 if east >= 0 else -1)


def _spans(size: int, side: int, low: int, high: int) -> tuple[list[int], int, int]:
    """Return the lengths of the tiles along one axis, how many lie before the region, and how many in it.

    The tiles in it begin where it begins, ``low`` cells after the margin does; the last may reach into the margin of
    ``high`` cells behind it.
    """

    def outer(margin: int) -> list[int]:
        num = -(-margin // side)
        return [-(-margin // num)] * num if num else []

    num_inner = -(-size // side)
    before, after = outer(low), outer(max(0, high - (num_inner * side - size)))
    return [*before, *[side] * num_inner, *after], len(before), num_inner


@dataclass(frozen=True)
class Tiling:
    """A region and the margin around it in tiles.

    The tiles of the region are of one shape and anchored at its northwest corner, where files begin, so that nothing
    compiles twice; the southernmost and the easternmost ones may stick out of it and are cropped when written. Those
    of the margin, which only carry shadows, are of few more.

    Attributes:
      region: the grid that maps report.
      row_starts, col_starts: global numbers of the first row (column) of each tile, and of the end.
      first: the region's southwest tile.
      counts: rows and columns of tiles in the region.
    """

    region: Grid
    row_starts: tuple[int, ...]
    col_starts: tuple[int, ...]
    first: Tile
    counts: tuple[int, int]

    @classmethod
    def over(cls, region: Grid, surface: Grid, shape: tuple[int, int]) -> "Tiling":
        """Return the tiling of ``region`` in tiles of ``shape`` that also covers ``surface`` around it.

        Raises:
          InputError: a shape below 1, or a region that is not a part of the surface.
        """
        if min(shape) < 1:
            raise InputError(f"tiles need at least one cell a side, got {shape[0]} x {shape[1]}")
        (rows, cols), (height, width) = region.window_in(surface), surface.shape
        spans, first_col, num_cols = _spans(region.num_cols, shape[1], cols.start, width - cols.stop)
        col_starts = accumulate(spans, initial=region.first_col - sum(spans[:first_col]))
        spans, num_north, num_rows = _spans(region.num_rows, shape[0], height - rows.stop, rows.start)
        north_end = region.first_row + region.num_rows + sum(spans[:num_north])
        row_starts = accumulate(reversed(spans), initial=north_end - sum(spans))
        first_row = len(spans) - num_north - num_rows
        return cls(region, tuple(row_starts), tuple(col_starts), (first_row, first_col), (num_rows, num_cols))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of tiles, the margin's included."""
        return len(self.row_starts) - 1, len(self.col_starts) - 1

    @property
    def tiles(self) -> list[Tile]:
        """Every tile, the margin's included, row by row from the southwest."""
        return list(product(range(self.shape[0]), range(self.shape[1])))

    @property
    def region_tiles(self) -> list[Tile]:
        """The tiles that maps report, row by row from the southwest."""
        rows, cols = (range(first, first + num) for first, num in zip(self.first, self.counts, strict=True))
        return list(product(rows, cols))

    def grid_of(self, tile: Tile) -> Grid:
        """Return the grid of a whole tile."""
        row, col = tile
        (south, north), (west, east) = self.row_starts[row : row + 2], self.col_starts[col : col + 2]
        return Grid(self.region.crs, self.region.resolution_m, south, west, north - south, east - west)

    def reported(self, tile: Tile) -> tuple[slice, slice]:
        """Return the rows and columns of the region that a tile of the region reports: its last rows, first columns."""
        grid = self.grid_of(tile)
        row, col = grid.first_row - self.region.first_row, grid.first_col - self.region.first_col
        return slice(max(row, 0), row + grid.num_rows), slice(col, min(col + grid.num_cols, self.region.num_cols))

    def touching(self, grid: Grid) -> Iterator[Tile]:
        """Yield the tiles that share a cell with ``grid``."""

        def along(starts: Sequence[int], begin: int, end: int) -> list[int]:
            return [i for i in range(len(starts) - 1) if starts[i] < end and starts[i + 1] > begin]

        rows = along(self.row_starts, grid.first_row, grid.first_row + grid.num_rows)
        yield from product(rows, along(self.col_starts, grid.first_col, grid.first_col + grid.num_cols))

    def upstream(self, tile: Tile, quadrant: Quadrant) -> list[Tile]:
        """Return the neighbours, up to three, whose shadows of a source in ``quadrant`` reach a tile first."""
        (row, col), (north, east) = tile, quadrant
        near = [(row + north, col), (row, col + east), (row + north, col + east)]
        return [(i, j) for i, j in near if 0 <= i < self.shape[0] and 0 <= j < self.shape[1]]

    def hands_on(self, tile: Tile, quadrant: Quadrant) -> bool:
        """Return whether shadows of a source in ``quadrant`` cross a tile on their way to another one of the region."""
        last = tuple(first + num - 1 for first, num in zip(self.first, self.counts, strict=True))
        end = tuple(low if toward > 0 else high for low, high, toward in zip(self.first, last, quadrant, strict=True))
        return tile != end and all((tile[i] - end[i]) * quadrant[i] >= 0 for i in range(2))


def max_side_for(bytes_per_cell: float, target_bytes: float) -> int:
    """Return the side of the largest square tile whose cells take at most ``target_bytes``, 64 to `MAX_SIDE`."""
    return int(min(MAX_SIDE, max(64, math.sqrt(target_bytes / bytes_per_cell))))
