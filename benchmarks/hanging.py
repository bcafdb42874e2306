"""What slabs change in a real city's maps, and how often satellites are told as exact geometry tells them.

    python -m benchmarks.hanging [--resolution 2]

Lower Manhattan with everything reaching the ground, with slabs of parts, and with decks of bridges too, at one time:
obstacles, satellites, GPS quality and lidar near what hangs. Its witness is Embree, rays through the exact prisms with
their floors. Needs the data folder (``JAXURBAN_DATA``) and the test dependencies.
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

from jaxurban.io.read.buildings import BuildingFile
from jaxurban.io.read.city import read_city
from jaxurban.kernels.dop import unit_vectors
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.visibility import visibility
from jaxurban.world.city import SLABS, City, Hanging
from jaxurban.world.grid import Grid
from tests.embree_scene import CityScene

BOUNDS, CRS = (-74.02, 40.70, -73.98, 40.73), "EPSG:32618"
TIME, MASK_DEG = "2020-04-27T16:00:00Z", 5.0
ALTITUDES_M = (2.0, 20.0, 60.0, 122.0)
NEAR_M = 30.0  # of what hangs
NUM_CELLS = 5000  # that Embree looks at
TO_GROUND, PARTS, ALL = NAMES = ("to the ground", "slabs of parts", "slabs of parts and decks")


def tasks_of(resolution_m: float) -> dict[str, MapTask]:
    data = Path(os.environ.get("JAXURBAN_DATA", "../shared/data"))
    grid = Grid.from_bounds(BOUNDS, resolution_m, CRS, (2, 5, 10))
    orbits = data / "gps" / "gps-ops_2020-04-27.tle"
    sky = view_sky(grid, orbits, [TIME], mask_deg=MASK_DEG, reference=None, max_age_days=90.0)
    params = MapParams(altitudes_m=ALTITUDES_M, mask_deg=MASK_DEG)

    def city(hanging: Hanging) -> City:
        file = BuildingFile(data / "osm" / "lower-manhattan.osm.pbf", hanging=hanging)
        return read_city(file, bounds=BOUNDS, crs=CRS, mask_deg=MASK_DEG)

    plain = city("to_ground")
    cities = {TO_GROUND: plain, PARTS: replace(plain, hanging=SLABS), ALL: city(SLABS)}
    return {name: MapTask(of, grid, sky, params) for name, of in cities.items()}


def near_hanging(task: MapTask) -> np.ndarray:
    """Return ``[y, x]`` bool: a part or a deck hangs within `NEAR_M` of the cell's centre."""
    buildings = task.city.buildings
    assert buildings is not None
    tree = shapely.STRtree(buildings.polygons[buildings.min_height_m > 0])
    x, y = task.region.xy_of_cell(*np.indices(task.region.shape).reshape(2, -1))
    near = np.unique(tree.query(shapely.points(x, y), predicate="dwithin", distance=NEAR_M)[0])
    return np.isin(np.arange(x.size), near).reshape(task.region.shape)


def told_right(tasks: dict[str, MapTask], near: np.ndarray) -> dict[tuple[str, float], float]:
    """Return the share of answers that are Embree's, by way of hanging and altitude, near what hangs.

    Beside what hangs every way is asked, under it, where cells are obstacles if it reaches the ground, the last alone.
    """
    buildings = tasks[ALL].city.buildings
    assert buildings is not None
    scene = CityScene(buildings.polygons, buildings.height_m, buildings.min_height_m)
    angles = tasks[ALL].angles(0)
    directions = unit_vectors(*angles)
    seen, roofs = {}, {}
    for name, task in tasks.items():
        surface = task.surface()
        words = np.asarray(visibility(surface, *angles, ALTITUDES_M))[0]
        seen[name] = (words >> np.arange(len(directions), dtype=np.uint32)[:, None, None, None]) & 1 == 1
        roofs[name] = np.asarray(surface.crop(surface.roof_m))
    lowest_m = surface.slabs.lowest_floors(surface.region)  # of the last task
    found, rng = {}, np.random.default_rng(0)
    for a, altitude_m in enumerate(ALTITUDES_M):
        under = near & (roofs[ALL] < altitude_m) & (lowest_m > altitude_m)
        open_m = np.maximum(roofs[TO_GROUND], roofs[ALL])
        for where, is_free in (("beside", near & (open_m < altitude_m) & (lowest_m == 0)), ("under", under)):
            cells = np.argwhere(is_free)
            if not len(cells):
                continue
            row, col = rng.choice(cells, min(NUM_CELLS, len(cells)), replace=False).T
            start_m = np.column_stack([*tasks[ALL].region.xy_of_cell(row, col), np.full(len(row), altitude_m)])
            is_blocked = np.array([scene.is_blocked(start_m, np.tile(d, (len(row), 1))) for d in directions])
            for name in NAMES if where == "beside" else (ALL,):
                found[f"{name}, {where}", altitude_m] = float((seen[name][:, a, row, col] != is_blocked).mean())
    return found


def changes(before: MetricMaps, after: MetricMaps, altitude_m: float, near: np.ndarray) -> dict[str, str]:
    """Return what differs at an altitude, as text by what it is."""
    blocked_before, blocked = (one.m("obstacle", altitude_m) != 0 for one in (before, after))
    both = ~blocked_before & ~blocked
    opened = blocked_before & ~blocked
    seen_before, seen = (one.m("num_visible", altitude_m).astype(int) for one in (before, after))
    return {
        "cells open that were obstacles": f"{opened.sum():,}",
        "cells closed that were free": f"{(blocked & ~blocked_before).sum():,}",
        "satellites in view there": f"{seen[opened].mean():.2f}" if opened.any() else "-",
        "free cells that see more": f"{(seen > seen_before)[both].mean():.2%}",
        "free cells that see fewer": f"{(seen < seen_before)[both].mean():.2%}",
        **{
            f"mean {name} near it, before / after": f"{before.m(name, altitude_m)[both & near].mean():.4f} / "
            f"{after.m(name, altitude_m)[both & near].mean():.4f}"
            for name in ("num_visible", "gps", "lidar")
        },
    }


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--resolution", type=float, default=2.0, help="side of a cell, metres")
    tasks = tasks_of(parser.parse_args().resolution)
    near = near_hanging(tasks[ALL])
    print(f"{near.mean():.2%} of {near.size:,} cells lie within {NEAR_M:g} m of what hangs")
    maps = {name: compute_maps(task) for name, task in tasks.items()}
    for altitude_m in ALTITUDES_M:
        for name in NAMES[1:]:
            print(f"{altitude_m:g} m up, {name}")
            for what, text in changes(maps[TO_GROUND], maps[name], altitude_m, near).items():
                print(f"  {what}: {text}")
    for (name, altitude_m), share in told_right(tasks, near).items():
        print(f"{altitude_m:g} m up, {name}: {share:.2%} of the answers are Embree's")


if __name__ == "__main__":
    main()
