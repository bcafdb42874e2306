"""The whole pipeline, and how the time of every metric grows from 2 to 50 million cells."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from benchmarks.common import Growth, Row, Timing, clocked, in_turn, row
from benchmarks.scenes import ALTITUDES_M, MASK_DEG, Scene
from jaxurban.build import compute_maps
from jaxurban.demo import demo_city
from jaxurban.grid import Grid
from jaxurban.io.rasterise import build_surface
from jaxurban.metrics.gps import compute_gps
from jaxurban.metrics.lidar import LidarParams, compute_lidar
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.population import population_maps
from jaxurban.metrics.risk import RiskParams, compute_risk
from jaxurban.surface import Surface

GROWTH_CELLS = (2e6, 6e6, 18e6, 50e6)
GROWTH_RESOLUTION_M = 2.0
GROWTH_ALTITUDE_M = 60.0
MOST_SLOPE = 1.10


def whole(scene: Scene, parts: list[Row], num_runs: int) -> list[Row]:
    """Return the row of all maps from a surface in memory, against the peers' rates in the rows before, added up."""
    surface, sky = scene.surface(5.0), scene.sky()
    times = in_turn(
        {"ours": clocked(lambda: compute_maps(scene.city, surface, sky, ALTITUDES_M, mask_deg=MASK_DEG))}, num_runs
    )
    num_cells, num_altitudes = surface.region.num_rows * surface.region.num_cols, len(ALTITUDES_M)
    units = num_cells * len(scene.azimuth_rad) * num_altitudes
    flown = num_cells * num_altitudes
    needed = {"answers": units, "scan positions": flown * LidarParams().num_azimuths, "cells": flown}
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


def cut(surface: Surface, num_cells: float) -> Surface:
    """Return the middle of a surface, of its proportions, all of it the region."""
    grid = surface.grid
    share = math.sqrt(num_cells / (grid.num_rows * grid.num_cols))
    rows, cols = (min(size, round(size * share)) for size in grid.shape)
    row, col = (grid.num_rows - rows) // 2, (grid.num_cols - cols) // 2
    part = Grid(grid.crs, grid.resolution_m, grid.first_row + row, grid.first_col + col, rows, cols)
    window = slice(row, row + rows), slice(col, col + cols)
    assert surface.block is not None
    return replace(
        surface, roof_m=jnp.asarray(surface.roof_m[window]), block=surface.block[window], grid=part, region=part
    )


def growth(scene: Scene, num_runs: int) -> list[Growth]:
    """Return the growth of every metric on the embedded city, one altitude at a time, under 8 GiB."""
    city = demo_city()
    region = Grid(city.crs, GROWTH_RESOLUTION_M, 0, 0, 1, 1)
    x_min, y_min, x_max, y_max = (round(edge / region.resolution_m) for edge in city.extent_m)
    region = replace(region, first_row=y_min, first_col=x_min, num_rows=y_max - y_min, num_cols=x_max - x_min)
    largest = build_surface(city, region, region)
    assert city.blocks is not None
    blocks, z_m = city.blocks, jnp.asarray([GROWTH_ALTITUDE_M])
    metrics = {
        "obstacle": lambda s: obstacle_mask(s.roof_m, z_m),
        "gps": lambda s: compute_gps(s, scene.azimuth_rad, scene.elevation_rad, z_m),
        "lidar": lambda s: compute_lidar(s, [GROWTH_ALTITUDE_M], LidarParams()),
        "population": lambda s: population_maps(s.block, blocks, ("day",)),
        "risk": lambda s: compute_risk(s, z_m, RiskParams()),
    }
    surfaces = [cut(largest, num_cells) for num_cells in GROWTH_CELLS]
    cells = [int(np.prod(surface.region.shape)) for surface in surfaces]
    found = []
    for name, metric in metrics.items():
        sides = {str(k): clocked(lambda s=surface, m=metric: m(s)) for k, surface in enumerate(surfaces)}
        times = in_turn(sides, num_runs).values()
        found.append(Growth(name, cells, [t.median_s for t in times], [t.median_cpu_s for t in times], MOST_SLOPE))
    return found
