"""The whole pipeline, and how the time of every metric grows from 2 to 50 million cells."""

import math
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

from benchmarks.common import Growth, Row, Side, Timing, clocked, in_turn, row
from benchmarks.scenes import ALTITUDES_M, Scene
from jaxurban.io.read.rasterise import build_surface
from jaxurban.maps.build import compute_maps
from jaxurban.metrics.gps import Gps, maps_of_choices, satellites_of
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.population import Population, block_layers, map_blocks
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.visibility import visibility
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface, obstacle_mask
from jaxurban.world.synthetic import demo_city

GROWTH_RESOLUTION_M = 2.0
TILE_SHAPE = (2000, 1000)  # 2 M cells
NUM_TILES = ((1, 1), (3, 1), (3, 3), (5, 5))  # 50 M cells are the whole city
GROWTH_ALTITUDE_M = 60.0
MOST_SLOPE = 1.10


def whole(scene: Scene, parts: list[Row], num_runs: int) -> list[Row]:
    """Return the row of all maps from a surface in memory, against the peers' rates in the rows before, added up."""
    task, surface = scene.task(5.0), scene.surface(5.0)
    times = in_turn({"ours": clocked(lambda: compute_maps(task, surface))}, num_runs)
    num_cells, num_altitudes = surface.region.num_rows * surface.region.num_cols, len(ALTITUDES_M)
    units = num_cells * len(scene.azimuth_rad) * num_altitudes
    flown = num_cells * num_altitudes
    needed = {"answers": units, "scan positions": flown * Lidar().azimuths, "cells": flown}
    chosen = [
        next(r for r in parts if (r.name, r.unit) == wanted)
        for wanted in (
            ("GPS occlusion", "answers"),
            ("DOPs", "cells"),
            ("lidar", "scan positions"),
            ("distance to 50 m", "cells"),
        )
    ]
    peers = Timing(
        [sum(needed[r.unit] / r.peer_per_s for r in chosen)],
        [sum(r.peer_runs.median_cpu_s * needed[r.unit] / (r.peer_per_s * r.peer_runs.median_s) for r in chosen)],
    )
    note = f"{scene.name}, 5 m, {len(scene.azimuth_rad)} satellites x 3 altitudes; lidar of all altitudes as at 20 m"
    unit = "cells x satellites x altitudes"
    return [row("all maps", "Embree + NumPy + SciPy", unit, (units, times["ours"]), (units, peers), note=note)]


def cut(surface: Surface, rows: slice, cols: slice) -> Surface:
    """Return a part of the surface as a region; what stands around it still counts."""
    assert surface.block is not None
    grid = surface.grid
    size = rows.stop - rows.start, cols.stop - cols.start
    region = Grid(grid.crs, grid.resolution_m, grid.first_row + rows.start, grid.first_col + cols.start, *size)
    return replace(surface, block=surface.block[rows, cols], region=region)


def tiles_of(surface: Surface, num_down: int, num_across: int) -> list[Surface]:
    """Return tiles around the middle of the surface."""
    down, across = TILE_SHAPE
    row, col = (surface.grid.num_rows - num_down * down) // 2, (surface.grid.num_cols - num_across * across) // 2
    return [
        cut(surface, slice(row + i * down, row + (i + 1) * down), slice(col + j * across, col + (j + 1) * across))
        for i in range(num_down)
        for j in range(num_across)
    ]


def alone(surface: Surface, num_down: int, num_across: int) -> Surface:
    """Return the same area in one piece, and nothing around it."""
    first, last = (tiles_of(surface, num_down, num_across)[k].region.window_in(surface.grid) for k in (0, -1))
    rows, cols = (slice(start.start, end.stop) for start, end in zip(first, last, strict=True))
    part = cut(surface, rows, cols)
    return replace(part, roof_m=jnp.array(surface.roof_m[rows, cols]), grid=part.region)


def growth(scene: Scene, num_runs: int) -> list[Growth]:
    """Return the growth of every metric on the synthetic city at 2 m, one altitude.

    GPS sweeps whole areas; the others are computed tile by tile, as a region of that size must be.
    """
    city = demo_city()
    x_min, y_min, x_max, y_max = (round(edge / GROWTH_RESOLUTION_M) for edge in city.extent_m)
    region = Grid(city.crs, GROWTH_RESOLUTION_M, y_min, x_min, y_max - y_min, x_max - x_min)
    largest = build_surface(city, region, region)
    assert city.blocks is not None
    blocks, z_m = city.blocks, jnp.asarray([GROWTH_ALTITUDE_M])
    sky = scene.azimuth_rad, scene.elevation_rad

    def gps(tile: Surface) -> object:
        is_obstacle = obstacle_mask(tile.crop(tile.roof_m), z_m)
        words, satellites = visibility(tile, *sky, z_m), satellites_of(InView(*sky, ()))
        maps, number = maps_of_choices(words, is_obstacle, satellites, Gps().gdop_threshold)
        return [values[number] for values in maps]

    metrics: dict[str, Callable[[Surface], object]] = {
        "obstacle": lambda tile: obstacle_mask(tile.crop(tile.roof_m), z_m),
        "gps": gps,
        "lidar": lambda tile: compute_lidar(tile, [GROWTH_ALTITUDE_M], Lidar()),
        "population": lambda tile: map_blocks(tile.block, block_layers(blocks, Population(time_of_day="day")).m),
        "risk": lambda tile: compute_risk(tile, z_m, Risk()),
    }

    def each(metric: Callable[[Surface], object], pieces: list[Surface]) -> Side:
        def run() -> None:  # keeps no result: a tile is written and dropped
            for piece in pieces:
                jax.block_until_ready(metric(piece))

        return clocked(run)

    cells = [math.prod(TILE_SHAPE) * down * across for down, across in NUM_TILES]
    found = []
    for name, metric in metrics.items():
        sides = {}
        for size in NUM_TILES:
            pieces = [alone(largest, *size)] if name == "gps" else tiles_of(largest, *size)
            sides[str(size)] = each(metric, pieces)
        times = in_turn(sides, num_runs).values()
        found.append(Growth(name, cells, [t.median_s for t in times], [t.median_cpu_s for t in times], MOST_SLOPE))
    return found
