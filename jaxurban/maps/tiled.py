"""A region in tiles, and the work on one: rasterise it, hand its shadows on, make its maps.

Tasks share nothing but a work folder.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, product
from typing import Any

import numpy as np

from jaxurban.checks import values_given
from jaxurban.errors import InputError
from jaxurban.io.folders import ZARR, WorkFolder
from jaxurban.io.read.rasterise import rasterise, rasterise_blocks
from jaxurban.io.store import write_layer
from jaxurban.kernels.engine import on_device_of
from jaxurban.kernels.shadows.blocks import hand_on
from jaxurban.kernels.shadows.sweep import Ring
from jaxurban.maps.recipe import tile_maps
from jaxurban.maps.task import MapTask
from jaxurban.maps.tile_scene import TileScene
from jaxurban.metrics.visibility import ringed_lines
from jaxurban.progress import Stopwatch
from jaxurban.settings import SLABS
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Slabs, Surface

Tile = tuple[int, int]  # row and column of a tile in its tiling, the southwest one first
# 1 or -1 each: the source stands in the north (1) or south, in the east (1) or west.
Quadrant = tuple[int, int]
QUADRANTS: dict[Quadrant, str] = {(1, 1): "ne", (1, -1): "nw", (-1, 1): "se", (-1, -1): "sw"}


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
    before = outer(low)
    after = outer(max(0, high - (num_inner * side - size)))
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
        spans, first_col, num_cols = _spans(
            region.num_cols, shape[1], cols.start, width - cols.stop
        )
        col_starts = accumulate(spans, initial=region.first_col - sum(spans[:first_col]))
        spans, num_north, num_rows = _spans(
            region.num_rows, shape[0], height - rows.stop, rows.start
        )
        north_end = region.first_row + region.num_rows + sum(spans[:num_north])
        row_starts = accumulate(reversed(spans), initial=north_end - sum(spans))
        first_row = len(spans) - num_north - num_rows
        return cls(
            region,
            tuple(row_starts),
            tuple(col_starts),
            (first_row, first_col),
            (num_rows, num_cols),
        )

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
        (row, col), (num_rows, num_cols) = self.first, self.counts
        return list(product(range(row, row + num_rows), range(col, col + num_cols)))

    def grid_of(self, tile: Tile) -> Grid:
        """Return the grid of a whole tile."""
        row, col = tile
        south, north = self.row_starts[row : row + 2]
        west, east = self.col_starts[col : col + 2]
        place = south, west, north - south, east - west
        return Grid(self.region.crs, self.region.resolution_m, *place)

    def reported(self, tile: Tile) -> tuple[slice, slice]:
        """Return the rows and columns of the region that a tile of the region reports: its last rows, first columns."""
        grid = self.grid_of(tile)
        row = grid.first_row - self.region.first_row
        col = grid.first_col - self.region.first_col
        end_col = min(col + grid.num_cols, self.region.num_cols)
        return slice(max(row, 0), row + grid.num_rows), slice(col, end_col)

    def touching(self, grid: Grid) -> Iterator[Tile]:
        """Yield the tiles that share a cell with ``grid``."""

        def along(starts: Sequence[int], first: int, num: int) -> list[int]:
            spans = enumerate(pairwise(starts))
            return [i for i, (begin, end) in spans if begin < first + num and end > first]

        rows = along(self.row_starts, grid.first_row, grid.num_rows)
        yield from product(rows, along(self.col_starts, grid.first_col, grid.num_cols))

    def upstream(self, tile: Tile, quadrant: Quadrant) -> list[Tile]:
        """Return the neighbours, up to three, whose shadows of a source in ``quadrant`` reach a tile first."""
        (row, col), (north, east) = tile, quadrant
        near = [(row + north, col), (row, col + east), (row + north, col + east)]
        return [(i, j) for i, j in near if 0 <= i < self.shape[0] and 0 <= j < self.shape[1]]

    def hands_on(self, tile: Tile, quadrant: Quadrant) -> bool:
        """Return whether shadows of a source in ``quadrant`` cross a tile on their way to another one of the region."""
        first = np.array(self.first)
        toward = np.array(quadrant)
        end = np.where(toward > 0, first, first + self.counts - 1)
        from_end = (tile - end) * toward
        return bool(from_end.any() and (from_end >= 0).all())


@dataclass(frozen=True)
class TileJob:
    """What every step of one task's tiles needs.

    Attributes:
      task: what the maps are made of.
      work: where steps leave their results for each other.
      tiling: the tiles.
    """

    task: MapTask
    work: WorkFolder
    tiling: Tiling

    @cached_property
    def order(self) -> dict[Quadrant, list[tuple[int, int]]]:
        """Time and number of every satellite above the mask, by the quadrant that it stands in."""
        order: dict[Quadrant, list[tuple[int, int]]] = {quadrant: [] for quadrant in QUADRANTS}
        if (
            self.task.params.oversample > 1
        ):  # supersampled surfaces look beyond the tile: nothing is handed on
            return order
        for t in range(self.task.num_times):
            for s in self.task.sky.in_view(t).numbers:
                azimuth_rad = self.task.sky.azimuth_rad[t, s]
                order[quadrant_of(np.sin(azimuth_rad), np.cos(azimuth_rad))].append((t, int(s)))
        return order

    def haloed(self, tile: Tile) -> Grid:
        """Return the grid of a tile and the halo that its lidar and risk maps look at."""
        return self.task.with_halo(self.tiling.grid_of(tile))

    def looked_at(self, tile: Tile) -> Grid:
        """Return the grid whose tiles' rasters a tile is finished from: with slabs, all that can shadow it."""
        if self.task.city.hanging == SLABS and self.task.params.oversample == 1:
            return self.task.with_margin(self.tiling.grid_of(tile))
        return self.haloed(tile)

    def hands_on(self, tile: Tile, quadrant: Quadrant) -> bool:
        """Return whether a tile has shadows of a quadrant to hand on."""
        return bool(self.order[quadrant]) and self.tiling.hands_on(tile, quadrant)


def _name(kind: str, *parts: int | str) -> str:
    """Return the name of a step in the work folder, by its tile and, if it is of one, its quadrant."""
    return "_".join(map(str, (kind, *parts)))


RASTERS = ("roof_m", "terrain_m", "has_data", "roof_guessed")  # of a `Surface`, that are kept


def raster_tile(job: TileJob, tile: Tile) -> dict[str, Any]:
    """Rasterise a tile and return the ``seconds`` it took by stage."""
    watch = Stopwatch()
    name = _name("raster", *tile)
    city = job.task.city
    if job.work.done(name) is None:
        with watch.stage("surface"):
            grid = job.tiling.grid_of(tile)
            is_reported = tile in job.tiling.region_tiles
            has_guessed = is_reported and job.task.has_guessed_roofs
            made = rasterise(city, grid, job.task.params.heights.all_touched, has_guessed)
            arrays = {key: getattr(made, key) for key in RASTERS}
            if made.slabs is not None:
                arrays |= {f"slab_{key}": values for key, values in made.slabs._asdict().items()}
            if is_reported:
                arrays["roof_touched_m"] = made.roof_touched_m
                arrays["block"] = rasterise_blocks(city, grid)
            job.work.save_arrays(name, **values_given(arrays))
    return {"seconds": watch.elapsed_s}


def sweep_tile(job: TileJob, tile: Tile, quadrant: Quadrant) -> dict[str, Any]:
    """Hand the shadows of a quadrant's satellites on across a tile and return the ``seconds`` it took by stage.

    What is kept are the row and the column, of every satellite, that the next tiles' rings take up.
    """
    watch = Stopwatch()
    name = _name("shadows", *tile, QUADRANTS[quadrant])
    sky = job.task.sky
    if job.work.done(name) is None:
        with watch.stage("gps"):
            grid = job.tiling.grid_of(tile)
            kept = job.work.load_arrays(_name("raster", *tile), "roof_m", "terrain_m")
            top_m = kept["roof_m"] + kept.get("terrain_m", np.float32(0))
            pairs = job.order[quadrant]
            azimuth_rad = np.array([sky.azimuth_rad[pair] for pair in pairs])
            elevation_rad = np.array([sky.elevation_rad[pair] for pair in pairs])
            lines = ringed_lines(grid, azimuth_rad, elevation_rad)
            rows, cols = hand_on(top_m, lines, _rings(job, tile, quadrant))
            job.work.save_arrays(name, rows=rows, cols=cols)
    return {"seconds": watch.elapsed_s}


def _rings(job: TileJob, tile: Tile, quadrant: Quadrant) -> Ring:
    """Return what the upstream tiles hand on to a tile, ``[S, ...]`` for the satellites of a quadrant."""
    north, east = quadrant
    num_rows, num_cols = job.tiling.grid_of(tile).shape
    num = len(job.order[quadrant])
    no_row = np.full((num, num_cols + 2), -np.inf, np.float32)
    no_col = np.full((num, num_rows), -np.inf, np.float32)
    row, col = no_row.copy(), no_col.copy()
    for near in job.tiling.upstream(tile, quadrant):
        if not job.hands_on(near, quadrant):
            continue
        kept = job.work.load_arrays(_name("shadows", *near, QUADRANTS[quadrant]), "rows", "cols")
        if near == (tile[0] + north, tile[1]):
            row[:, 1:-1] = kept["rows"]
        elif near == (tile[0], tile[1] + east):
            col[:] = kept["cols"]
        else:
            corner, nearest = (-1, 0) if east > 0 else (0, -1)
            row[:, corner] = kept["rows"][:, nearest]
    sides = (no_row, row) if north > 0 else (row, no_row)
    ends = (no_col, col) if east > 0 else (col, no_col)
    return Ring(*sides, *ends)


def finish_tile(job: TileJob, tile: Tile) -> dict[str, Any]:
    """Make and write every map of a tile of the region, mark it done, and return what is marked.

    ``seconds`` by stage; ``totals``: the facts of `TimeTotals` by metric, where statistics over time are kept.
    """
    name = _name("tile", *tile)
    facts = job.work.done(name)
    if facts is not None:
        return {**facts, "seconds": {}}
    watch = Stopwatch()
    with watch.stage("surface"):
        surface = _surface(job, tile)
    with watch.stage("gps"):
        rings = {}
        for quadrant in QUADRANTS:
            sides = _rings(job, tile, quadrant)
            for number, seen in enumerate(job.order[quadrant]):
                rings[seen] = Ring(*(side[number] for side in sides))
    scene = TileScene(job.task, surface, rings)
    window = job.tiling.reported(tile)
    checksums: dict[str, str] = {}
    with on_device_of(job.task.params.engine):
        for layer in tile_maps(scene, watch.stage):
            with watch.stage("write_zarr"):
                checksums |= write_layer(
                    job.work.zarr, layer.name, layer.place, window, layer.values
                )
    facts = {"totals": {metric: totals.facts for metric, totals in scene.totals.items()}}
    job.work.mark_done(name, {f"{ZARR}/{file}": of for file, of in checksums.items()}, facts)
    return {**facts, "seconds": watch.elapsed_s}


def _surface(job: TileJob, tile: Tile) -> Surface:
    """Return a tile of the region with the halo that lidar and risk look at, put together from the tiles around."""
    region = job.tiling.grid_of(tile)
    grid = job.haloed(tile)
    halo = region.first_row - grid.first_row
    rasters: dict[str, Any] = {
        "roof_m": np.zeros(grid.shape, np.float32),
        "has_data": np.ones(grid.shape, bool),
    }
    if job.task.has_terrain:
        rasters["terrain_m"] = np.zeros(grid.shape, np.float32)
    for near in job.tiling.touching(grid):
        other = job.tiling.grid_of(near)
        row = other.first_row - grid.first_row
        col = other.first_col - grid.first_col
        target = slice(max(row, 0), row + other.num_rows), slice(max(col, 0), col + other.num_cols)
        source = slice(max(-row, 0), grid.num_rows - row), slice(max(-col, 0), grid.num_cols - col)
        for key, values in job.work.load_arrays(_name("raster", *near), *rasters).items():
            rasters[key][target] = values[source]
    # What sticks out of the region counts for nothing.
    rows, cols = (part.stop - part.start for part in job.tiling.reported(tile))
    rasters["has_data"][halo : halo + region.num_rows - rows] = False
    rasters["has_data"][:, halo + cols : grid.num_cols - halo] = False
    own: dict[str, Any] = job.work.load_arrays(
        _name("raster", *tile), "block", "roof_touched_m", "roof_guessed"
    )
    return Surface(
        roof_m=rasters["roof_m"],
        terrain_m=rasters.get("terrain_m"),
        has_data=None if rasters["has_data"].all() else rasters["has_data"],
        block=own.get("block"),
        grid=grid,
        region=region,
        roof_touched_m=own["roof_touched_m"],
        roof_guessed=own.get("roof_guessed"),
        slabs=_slabs(job, tile) if job.task.city.hanging == SLABS else None,
    )


def _slabs(job: TileJob, tile: Tile) -> Slabs:
    """Return the slabs over a tile and over all that it looks at."""
    parts = []
    for near in job.tiling.touching(job.looked_at(tile)):
        kept = job.work.load_arrays(
            _name("raster", *near), *(f"slab_{name}" for name in Slabs._fields)
        )
        parts.append(Slabs(**{name.removeprefix("slab_"): values for name, values in kept.items()}))
    return Slabs.joined(parts)
