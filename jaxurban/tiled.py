"""The work on one tile: rasterise it, hand its shadows on, make its maps. Tasks share nothing but a work folder."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.city import City
from jaxurban.detail import RegionDetail
from jaxurban.grid import Grid
from jaxurban.io.damage import broken_chunks, has_whole_metadata
from jaxurban.io.rasterise import rasterise, rasterise_blocks
from jaxurban.io.store import write_layer
from jaxurban.io.workfolder import WorkFolder
from jaxurban.kernels.occlusion import Ring, digital_line, hand_on
from jaxurban.layers import MapParams, halo_cells, make_layers, margin_of
from jaxurban.metrics.availability import EpochTotals
from jaxurban.metrics.gps import visibility
from jaxurban.metrics.population import BlockLayers
from jaxurban.sky import Sky
from jaxurban.surface import Surface
from jaxurban.tiles import QUADRANTS, Quadrant, Tile, Tiling, quadrant_of

Seconds = dict[str, float]


@dataclass
class Timer:
    """Seconds of one thread by stage."""

    seconds: Seconds = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under ``name``."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began


@dataclass(frozen=True)
class TileJob:
    """What every task of one resolution's maps needs.

    Attributes:
      work: where tasks leave their results for each other.
      tiling: the tiles.
      sky, params, people: see `jaxurban.layers.make_layers`.
      city: what is rasterised.
    """

    work: WorkFolder
    tiling: Tiling
    sky: Sky
    params: MapParams
    people: BlockLayers | None
    city: City

    @cached_property
    def order(self) -> dict[Quadrant, list[tuple[int, int]]]:
        """Epoch and number of every satellite above the mask, by the quadrant that it stands in."""
        order: dict[Quadrant, list[tuple[int, int]]] = {quadrant: [] for quadrant in QUADRANTS}
        if self.params.oversample > 1:  # finer surfaces look beyond the tile by themselves: nothing is handed on
            return order
        for t in range(len(self.sky.times)):
            for s in self.params.satellites_at(self.sky, t):
                azimuth_rad = self.sky.azimuth_rad[t, s]
                order[quadrant_of(np.sin(azimuth_rad), np.cos(azimuth_rad))].append((t, int(s)))
        return order

    def haloed(self, tile: Tile) -> Grid:
        """Return the grid of a tile and the halo that its lidar and risk maps look at."""
        grid = self.tiling.grid_of(tile)
        halo = halo_cells(grid.resolution_m, self.params)
        return grid.padded(halo, halo, halo, halo)

    def hands_on(self, tile: Tile, quadrant: Quadrant) -> bool:
        """Return whether a tile has shadows of a quadrant to hand on."""
        return bool(self.order[quadrant]) and self.tiling.hands_on(tile, quadrant)


def _name(kind: str, tile: Tile, quadrant: Quadrant | None = None) -> str:
    side = "" if quadrant is None else ("_n" if quadrant[0] > 0 else "_s") + ("e" if quadrant[1] > 0 else "w")
    return f"{kind}_{tile[0]}_{tile[1]}{side}"


def unmark_damaged(job: TileJob, num_threads: int) -> list[Path]:
    """Return what is damaged of the finished tiles that an earlier run left, and make them unfinished."""
    path, tiles = job.work.zarr, {tile: _name("tile", tile) for tile in job.tiling.region_tiles}
    if not path.exists():
        job.work.unmark(tiles.values())
        return []
    if not has_whole_metadata(path):
        job.work.remove_maps(tiles.values())
        return [path / "zarr.json"]
    broken = broken_chunks(path, num_threads)
    if lost := [chunk.file for chunk in broken if len(chunk.place) < 2]:  # coordinates
        job.work.remove_maps(tiles.values())
        return lost
    row, col = job.tiling.first
    at = {(chunk.place[-2] + row, chunk.place[-1] + col): chunk.file for chunk in broken}
    done = {tile: name for tile, name in tiles.items() if tile in at and job.work.done(name) is not None}
    job.work.unmark(done.values())
    return [at[tile] for tile in done]


def raster_tile(job: TileJob, tile: Tile) -> dict[str, Seconds]:
    """Rasterise a tile and return the ``seconds`` it took by stage."""
    timer, name = Timer(), _name("raster", tile)
    if not job.work.has_arrays(name):
        with timer.stage("surface"):
            grid = job.tiling.grid_of(tile)
            rasters = rasterise(job.city, grid, job.params.all_touched)
            arrays = rasters._asdict()
            if tile in job.tiling.region_tiles:
                arrays["block"] = rasterise_blocks(job.city, grid)
            else:
                del arrays["roof_touched_m"]
            job.work.save_arrays(name, **{key: values for key, values in arrays.items() if values is not None})
    return {"seconds": timer.seconds}


def sweep_tile(job: TileJob, tile: Tile, quadrant: Quadrant) -> dict[str, Seconds]:
    """Hand the shadows of a quadrant's satellites on across a tile and return the ``seconds`` it took by stage.

    What is kept are the row and the column, of every satellite, that the next tiles' rings take up.
    """
    timer, name = Timer(), _name("shadows", tile, quadrant)
    if not job.work.has_arrays(name):
        with timer.stage("gps"):
            grid = job.tiling.grid_of(tile)
            kept = job.work.load_arrays(_name("raster", tile), "roof_m", "terrain_m")
            top_m = jnp.asarray(kept["roof_m"] + kept.get("terrain_m", np.float32(0)))
            ringed = grid.padded(1, 1, 1, 1)
            num = len(job.order[quadrant])
            rows, cols = (np.empty((num, size), np.float32) for size in (grid.num_cols, grid.num_rows))
            rings = _rings(job, tile, quadrant)
            for n, (t, s) in enumerate(job.order[quadrant]):
                line = digital_line(
                    job.sky.azimuth_rad[t, s],
                    job.sky.elevation_rad[t, s],
                    grid.resolution_m,
                    ringed.first_row,
                    ringed.first_col,
                    ringed.shape,
                )
                edge = hand_on(top_m, line, rings[n])
                rows[n] = edge.south if quadrant[0] > 0 else edge.north
                cols[n] = edge.west if quadrant[1] > 0 else edge.east
            job.work.save_arrays(name, rows=rows, cols=cols)
    return {"seconds": timer.seconds}


def _rings(job: TileJob, tile: Tile, quadrant: Quadrant) -> list[Ring]:
    """Return what the upstream tiles hand on to a tile, for every satellite of a quadrant."""
    (north, east), (num_rows, num_cols) = quadrant, job.tiling.grid_of(tile).shape
    num = len(job.order[quadrant])
    nothing = np.full((num, num_cols + 2), -np.inf, np.float32), np.full((num, num_rows), -np.inf, np.float32)
    row, col = (values.copy() for values in nothing)
    for near in job.tiling.upstream(tile, quadrant):
        if not job.hands_on(near, quadrant):
            continue
        kept = job.work.load_arrays(_name("shadows", near, quadrant), "rows", "cols")
        if near == (tile[0] + north, tile[1]):
            row[:, 1:-1] = kept["rows"]
        elif near == (tile[0], tile[1] + east):
            col[:] = kept["cols"]
        else:
            row[:, -1 if east > 0 else 0] = kept["rows"][:, 0 if east > 0 else -1]
    sides = (nothing[0], row) if north > 0 else (row, nothing[0])
    ends = (nothing[1], col) if east > 0 else (col, nothing[1])
    return [Ring(sides[0][n], sides[1][n], ends[0][n], ends[1][n]) for n in range(num)]


def finish_tile(job: TileJob, tile: Tile) -> dict[str, Any]:
    """Make and write every map of a tile of the region, mark it done, and return what is marked.

    ``seconds`` by stage; ``m_sum`` and ``num_free`` of `EpochTotals`, where statistics over time are kept.
    """
    name = _name("tile", tile)
    if (facts := job.work.done(name)) is not None:
        return {**facts, "seconds": {}}
    timer = Timer()
    with timer.stage("surface"):
        surface = _surface(job, tile)
    with timer.stage("gps"):
        ring_of = {
            seen: ring
            for quadrant in QUADRANTS
            for seen, ring in zip(job.order[quadrant], _rings(job, tile, quadrant), strict=True)
        }

    region = job.tiling.grid_of(tile)
    margin = margin_of(job.city, region, job.sky, job.params)
    detail = RegionDetail.wanted(job.city, region, margin, job.sky, job.params)

    def words(t: int) -> jax.Array:
        if detail is not None and job.params.oversample > 1:
            return detail.words(t)
        seen = job.params.satellites_at(job.sky, t)
        return visibility(
            surface,
            job.sky.azimuth_rad[t, seen],
            job.sky.elevation_rad[t, seen],
            job.params.altitudes_m,
            [ring_of[t, int(s)] for s in seen],
        )

    totals = EpochTotals.zero(len(job.sky.times), len(job.params.altitudes_m))
    window = job.tiling.reported(tile)
    for layer in make_layers(surface, job.sky, job.params, job.people, words, totals, timer.stage, detail):
        with timer.stage("write_zarr"):
            write_layer(job.work.zarr, layer.name, layer.place, window, layer.values)
    job.work.mark_done(name, totals.facts)
    return {**totals.facts, "seconds": timer.seconds}


def _surface(job: TileJob, tile: Tile) -> Surface:
    """Return a tile of the region with the halo that lidar and risk look at, put together from the tiles around."""
    region = job.tiling.grid_of(tile)
    grid = job.haloed(tile)
    halo = region.first_row - grid.first_row
    kinds = {"roof_m": np.zeros(grid.shape, np.float32), "has_data": np.ones(grid.shape, bool)}
    if job.city.terrain is not None:
        kinds["terrain_m"] = np.zeros(grid.shape, np.float32)
    for near in job.tiling.touching(grid):
        other = job.tiling.grid_of(near)
        row, col = other.first_row - grid.first_row, other.first_col - grid.first_col
        target = slice(max(row, 0), row + other.num_rows), slice(max(col, 0), col + other.num_cols)
        source = slice(max(-row, 0), grid.num_rows - row), slice(max(-col, 0), grid.num_cols - col)
        for key, values in job.work.load_arrays(_name("raster", near), *kinds).items():
            kinds[key][target] = values[source]
    # What sticks out of the region counts for nothing.
    rows, cols = (halo + part.stop - part.start for part in job.tiling.reported(tile))
    kinds["has_data"][rows : grid.num_rows - halo] = False
    kinds["has_data"][:, cols : grid.num_cols - halo] = False
    own = job.work.load_arrays(_name("raster", tile), "block", "roof_touched_m")
    block = own.get("block")
    return Surface(
        roof_m=jnp.asarray(kinds["roof_m"]),
        terrain_m=jnp.asarray(kinds["terrain_m"]) if "terrain_m" in kinds else None,
        has_data=None if kinds["has_data"].all() else jnp.asarray(kinds["has_data"]),
        block=None if block is None else jnp.asarray(block),
        grid=grid,
        region=region,
        roof_touched_m=jnp.asarray(own["roof_touched_m"]),
    )
