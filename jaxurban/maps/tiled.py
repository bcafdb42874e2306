"""A region in tiles, and the work on one: rasterise it, hand its shadows on, make its maps.

Tasks share nothing but a work folder.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise, product
from typing import Any, NamedTuple

import numpy as np

from jaxurban.checks import values_given
from jaxurban.io.folders import WorkFolder
from jaxurban.io.rasterise import rasterise, rasterise_blocks
from jaxurban.io.store import write_layer
from jaxurban.io.stored import ZARR
from jaxurban.kernels.engine import on_host
from jaxurban.kernels.shadows.blocks import hand_on
from jaxurban.kernels.shadows.sweep import Ring
from jaxurban.maps.at_once import Window, tile_at_once
from jaxurban.maps.recipe import tile_maps
from jaxurban.maps.task import MapTask
from jaxurban.maps.tile_scene import TileScene
from jaxurban.metrics.visibility import ringed_lines
from jaxurban.progress import Stage, Stopwatch
from jaxurban.settings import SLABS
from jaxurban.world.grid import Grid
from jaxurban.world.surface import OF_REGION, ROOFS, Slabs, Surface

Tile = tuple[int, int]  # row and column of a tile in its tiling, the southwest one first
# 1 or -1 each: the source stands in the north (1) or south, in the east (1) or west.
Quadrant = tuple[int, int]
QUADRANTS: dict[Quadrant, str] = {(1, 1): "ne", (1, -1): "nw", (-1, 1): "se", (-1, -1): "sw"}


class _Spans(NamedTuple):
    """The lengths of tiles along one axis, in cells, and which of them cover the region."""

    lengths: list[int]
    num_before: int  # tiles before the region
    num_inside: int  # tiles that cover it


def _spans(size: int, side: int, before: int, after: int) -> _Spans:
    """Return the tiles along one axis of a region with its margins.

    The tiles that cover the region begin where it begins; the last of them may reach into the margin behind it. Those
    of the margins are of equal length, at most ``side``, and reach beyond the margins by less than a cell each.

    Args:
      size: cells of the region along the axis.
      side: cells of a tile of the region.
      before: cells of the margin before the region.
      after: cells of the margin behind it.
    """

    def tiles_of_margin(margin: int) -> list[int]:
        """Return the lengths of the fewest equal tiles that cover a margin; none where it is empty."""
        num = -(-margin // side)
        return [-(-margin // num)] * num if num else []

    num_inside = -(-size // side)
    overhang = num_inside * side - size
    lengths_before = tiles_of_margin(before)
    lengths_after = tiles_of_margin(max(0, after - overhang))
    return _Spans(
        [*lengths_before, *[side] * num_inside, *lengths_after], len(lengths_before), num_inside
    )


@dataclass(frozen=True)
class Tiling:
    """A region and the margin around it in tiles.

    The tiles of the region are of one shape, so that nothing compiles twice, and begin at its northwest corner, where
    files begin; the southernmost and the easternmost tiles may stick out of it and are cropped when written. The tiles
    of the margin, which only carry shadows, have few further shapes.

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

        Args:
          region: the grid that maps report.
          surface: the region with its margin.
          shape: rows and columns of a tile's cells.

        Raises:
          InputError: a region that is not a part of the surface.
        """
        tile_rows, tile_cols = shape
        rows, cols = region.window_in(surface)

        # Columns from west to east.
        across = _spans(region.num_cols, tile_cols, cols.start, surface.num_cols - cols.stop)
        west = region.first_col - sum(across.lengths[: across.num_before])
        col_starts = accumulate(across.lengths, initial=west)

        # Rows from north to south, then turned around, as rows count from the south.
        down = _spans(region.num_rows, tile_rows, surface.num_rows - rows.stop, rows.start)
        north = region.first_row + region.num_rows + sum(down.lengths[: down.num_before])
        row_starts = accumulate(reversed(down.lengths), initial=north - sum(down.lengths))
        first_row = len(down.lengths) - down.num_before - down.num_inside
        return cls(
            region,
            tuple(row_starts),
            tuple(col_starts),
            first=(first_row, across.num_before),
            counts=(down.num_inside, across.num_inside),
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
        num_rows, num_cols = north - south, east - west
        return replace(
            self.region, first_row=south, first_col=west, num_rows=num_rows, num_cols=num_cols
        )

    def reported(self, tile: Tile) -> Window:
        """Return the rows and columns of the region that a tile of the region reports.

        A tile that sticks out of the region in the south or east reports its northern rows and western columns alone.
        """
        grid = self.grid_of(tile)
        row = grid.first_row - self.region.first_row
        col = grid.first_col - self.region.first_col
        end_col = min(col + grid.num_cols, self.region.num_cols)
        return slice(max(row, 0), row + grid.num_rows), slice(col, end_col)

    def touching(self, grid: Grid) -> Iterator[Tile]:
        """Yield the tiles that share a cell with ``grid``, row by row from the southwest."""

        def along(starts: Sequence[int], first: int, num: int) -> list[int]:
            """Return which tiles along an axis share one of ``num`` cells from ``first`` on."""
            spans = enumerate(pairwise(starts))
            return [number for number, (begin, end) in spans if begin < first + num and end > first]

        rows = along(self.row_starts, grid.first_row, grid.num_rows)
        cols = along(self.col_starts, grid.first_col, grid.num_cols)
        yield from product(rows, cols)

    def upstream(self, tile: Tile, quadrant: Quadrant) -> list[Tile]:
        """Return the neighbours of a tile toward a source in ``quadrant``, from which its shadows come.

        They are the one beside it in its column, the one beside it in its row, and the one at the corner between them,
        as far as the tiling has them.
        """
        row, col = tile
        north, east = quadrant
        num_rows, num_cols = self.shape
        near = [(row + north, col), (row, col + east), (row + north, col + east)]
        return [(i, j) for i, j in near if 0 <= i < num_rows and 0 <= j < num_cols]

    def hands_on(self, tile: Tile, quadrant: Quadrant) -> bool:
        """Return whether shadows of a source in ``quadrant`` cross a tile on their way to another one of the region."""
        first = np.array(self.first)
        toward = np.array(quadrant)
        # Shadows run away from the source, to the region's last tile: its corner opposite to the quadrant. A tile on
        # their way is no farther from the source than that one in rows and columns, and is not that one itself.
        last = np.where(toward > 0, first, first + self.counts - 1)
        before_last = (tile - last) * toward
        return bool(before_last.any() and (before_last >= 0).all())


@dataclass(frozen=True)
class TileJob:
    """What every step of one task's tiles needs.

    Attributes:
      task: what the maps are made of.
      work: where steps leave their results for each other.
      tiling: the tiles.
      device_bytes: of memory, in which a device makes each tile's maps at once (`jaxurban.maps.at_once`); None where
        the host makes them.
    """

    task: MapTask
    work: WorkFolder
    tiling: Tiling
    device_bytes: float | None = None

    @cached_property
    def order(self) -> dict[Quadrant, list[tuple[int, int]]]:
        """Time and number of every satellite above the mask, by the quadrant that it stands in.

        The lists are empty where the surface is supersampled: it then holds all that shadows a tile, and no tile hands
        shadows on.
        """
        order: dict[Quadrant, list[tuple[int, int]]] = {quadrant: [] for quadrant in QUADRANTS}
        if self.task.params.oversample > 1:
            return order
        sky = self.task.sky
        for t in range(self.task.num_times):
            for s in sky.in_view(t).numbers:
                azimuth_rad = sky.azimuth_rad[t, s]
                # Due north and south count as east, due east and west as north.
                north = 1 if np.cos(azimuth_rad) >= 0 else -1
                east = 1 if np.sin(azimuth_rad) >= 0 else -1
                order[north, east].append((t, int(s)))
        return order

    def haloed(self, tile: Tile) -> Grid:
        """Return the grid of a tile and the halo that its lidar and risk maps look at."""
        return self.task.with_halo(self.tiling.grid_of(tile))

    def looked_at(self, tile: Tile) -> Grid:
        """Return the grid of all rasters that the maps of a tile are made from.

        It is the tile with its halo; with slabs, which no tile hands on as shadows, it is all that can shadow the tile.
        """
        if self.task.city.hanging == SLABS and self.task.params.oversample == 1:
            return self.task.with_margin(self.tiling.grid_of(tile))
        return self.haloed(tile)

    def hands_on(self, tile: Tile, quadrant: Quadrant) -> bool:
        """Return whether a tile has shadows of a quadrant to hand on."""
        return bool(self.order[quadrant]) and self.tiling.hands_on(tile, quadrant)


def _name(kind: str, *parts: int | str) -> str:
    """Return the name of a step in the work folder, such as ``shadows_0_2_ne``.

    Args:
      kind: of the step.
      *parts: row and column of its tile, and the name of its quadrant if it has one.
    """
    return "_".join(map(str, (kind, *parts)))


RASTERS = (*ROOFS, "terrain_m", "has_data")


def raster_tile(job: TileJob, tile: Tile) -> dict[str, Any]:
    """Rasterise a tile into the work folder, unless that is done, and return the ``seconds`` it took by stage.

    A tile of the region also gets what is known of its roofs by touch (`OF_REGION`), and its census blocks.

    Args:
      job: what the tiles need, and the work folder.
      tile: any tile, also one of the margin.
    """
    watch = Stopwatch()
    name = _name("raster", *tile)
    city = job.task.city
    if not job.work.is_done(name):
        with watch.stage("surface"):
            grid = job.tiling.grid_of(tile)
            is_reported = tile in job.tiling.region_tiles
            has_guessed = is_reported and job.task.has_guessed_roofs
            has_kinds = is_reported and job.task.has_kinds
            surface = rasterise(city, grid, has_guessed=has_guessed, has_kinds=has_kinds)
            names = (*RASTERS, *OF_REGION) if is_reported else RASTERS
            arrays = {key: getattr(surface, key) for key in names}
            if surface.slabs is not None:
                arrays |= {f"slab_{key}": values for key, values in surface.slabs._asdict().items()}
            if is_reported:
                arrays["block"] = rasterise_blocks(city, grid)
            job.work.save_arrays(name, **values_given(arrays))
    return {"seconds": watch.elapsed_s}


def sweep_tile(job: TileJob, tile: Tile, quadrant: Quadrant) -> dict[str, Any]:
    """Hand the shadows of a quadrant's satellites on across a tile and return the ``seconds`` it took by stage.

    Unless that is done, the work folder gets the tile's last row and column of shadows for each satellite, which the
    next tiles take up in their rings.

    Args:
      job: what the tiles need, and the work folder, which holds the rasters of the tile and the shadows before it.
      tile: any tile, also one of the margin.
      quadrant: that the satellites stand in.
    """
    watch = Stopwatch()
    name = _name("shadows", *tile, QUADRANTS[quadrant])
    sky = job.task.sky
    if not job.work.is_done(name):
        with watch.stage("gps"):
            grid = job.tiling.grid_of(tile)
            kept = job.work.load_arrays(_name("raster", *tile), *ROOFS, "terrain_m")
            top_m = kept.get("hiding_m", kept["roof_m"]) + kept.get("terrain_m", np.float32(0))
            pairs = job.order[quadrant]
            azimuth_rad = np.array([sky.azimuth_rad[pair] for pair in pairs])
            elevation_rad = np.array([sky.elevation_rad[pair] for pair in pairs])
            lines = ringed_lines(grid, azimuth_rad, elevation_rad)
            rows, cols = hand_on(top_m, lines, _rings(job, tile, quadrant))
            job.work.save_arrays(name, rows=rows, cols=cols)
    return {"seconds": watch.elapsed_s}


def _rings(job: TileJob, tile: Tile, quadrant: Quadrant) -> Ring:
    """Return the shadows that the upstream tiles hand on to a tile, on the ring of cells around it.

    The ring holds heights in metres, ``[S, ...]`` for the ``S`` satellites of a quadrant. It is -inf where nothing is
    handed on, as always on the two sides away from the source.

    Args:
      job: what the tiles need, and the work folder, which holds the shadows of the upstream tiles.
      tile: that the ring is around.
      quadrant: that the satellites stand in.
    """
    north, east = quadrant
    num_rows, num_cols = job.tiling.grid_of(tile).shape
    num = len(job.order[quadrant])
    no_row = np.full((num, num_cols + 2), -np.inf, np.float32)
    no_col = np.full((num, num_rows), -np.inf, np.float32)

    # The row and the column toward the source: from the tile beyond each, and a corner from the tile beyond both.
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

    south_row, north_row = (no_row, row) if north > 0 else (row, no_row)
    west_col, east_col = (no_col, col) if east > 0 else (col, no_col)
    return Ring(south_row, north_row, west_col, east_col)


def finish_tile(job: TileJob, tile: Tile) -> dict[str, Any]:
    """Make and write every map of a tile of the region, unless that is done, and mark it done.

    Args:
      job: what the tiles need, and the work folder, which holds the rasters and shadows around the tile.
      tile: of the region.

    Returns:
      ``seconds`` by stage, none where it was done before; ``finished``: the tile.
    """
    name = _name("tile", *tile)
    if job.work.is_done(name):
        return {"finished": tile, "seconds": {}}
    watch = Stopwatch()
    window = job.tiling.reported(tile)
    checksums: dict[str, str] = {}
    with on_host():
        scene = _scene(job, tile, window, watch.stage)
        # The maps, each written when it is made.
        for layer in tile_maps(scene, watch.stage):
            with watch.stage("write_zarr"):
                checksums |= write_layer(
                    job.work.zarr, layer.name, layer.place, window, layer.values
                )

    written = {f"{ZARR}/{file}": checksum for file, checksum in checksums.items()}
    job.work.mark_done(name, written)
    return {"finished": tile, "seconds": watch.elapsed_s}


def _scene(job: TileJob, tile: Tile, window: Window, stage: Stage) -> TileScene:
    """Return a tile of which a device makes the maps, or one with what the tiles around have left for it."""
    if job.device_bytes is not None:
        grid = job.tiling.grid_of(tile)
        return tile_at_once(job.task, grid, window, stage, job.device_bytes)
    with stage("surface"):
        surface = _surface(job, tile)
    with stage("gps"):
        rings = {}
        for quadrant in QUADRANTS:
            sides = _rings(job, tile, quadrant)
            for number, time_and_satellite in enumerate(job.order[quadrant]):
                rings[time_and_satellite] = Ring(*(side[number] for side in sides))
    return TileScene(job.task, surface, rings)


def _surface(job: TileJob, tile: Tile) -> Surface:
    """Return a tile of the region with the halo that lidar and risk look at, put together from the tiles around.

    What sticks out of the region has no data.

    Args:
      job: what the tiles need, and the work folder, which holds the rasters.
      tile: of the region.
    """
    region = job.tiling.grid_of(tile)
    grid = job.haloed(tile)
    halo = region.first_row - grid.first_row

    # Each tile around gives the part of its rasters that lies on the tile with its halo.
    rasters: dict[str, Any] = {
        "roof_m": np.zeros(grid.shape, np.float32),
        "has_data": np.ones(grid.shape, bool),
    }
    city = job.task.city
    is_needed = {
        "terrain_m": job.task.has_terrain,
        "hiding_m": city.hides is not city.counted,
        "returning_m": city.returns is not city.counted,
    }
    for key, needed in is_needed.items():
        if needed:
            rasters[key] = np.zeros(grid.shape, np.float32)
    for near in job.tiling.touching(grid):
        other = job.tiling.grid_of(near)
        row = other.first_row - grid.first_row
        col = other.first_col - grid.first_col
        target = slice(max(row, 0), row + other.num_rows), slice(max(col, 0), col + other.num_cols)
        source = slice(max(-row, 0), grid.num_rows - row), slice(max(-col, 0), grid.num_cols - col)
        for key, values in job.work.load_arrays(_name("raster", *near), *rasters).items():
            rasters[key][target] = values[source]

    # Rows in the south and columns in the east that stick out of the region count as without data.
    rows, cols = job.tiling.reported(tile)
    north_rows = halo + region.num_rows - (rows.stop - rows.start)
    west_cols = halo + (cols.stop - cols.start)
    rasters["has_data"][halo:north_rows] = False
    rasters["has_data"][:, west_cols : grid.num_cols - halo] = False

    if rasters["has_data"].all():
        rasters["has_data"] = None
    own: dict[str, Any] = job.work.load_arrays(_name("raster", *tile), "block", *OF_REGION)
    given = {"terrain_m": None, "block": None, **rasters, **own}
    return Surface(
        **given,
        grid=grid,
        region=region,
        slabs=_slabs(job, tile) if city.hanging == SLABS else None,
    )


def _slabs(job: TileJob, tile: Tile) -> Slabs:
    """Return the slabs over a tile and over all that can shadow it, joined from the tiles that hold them."""
    names = [f"slab_{name}" for name in Slabs._fields]
    parts = []
    for near in job.tiling.touching(job.looked_at(tile)):
        kept = job.work.load_arrays(_name("raster", *near), *names)
        parts.append(Slabs(*(kept[name] for name in names)))
    return Slabs.joined(parts)
