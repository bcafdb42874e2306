"""Missions of planned routes: how simple, how near the route, how far from outlines, and read back by MAVSDK.

Run as ``python -m benchmarks.missions``; writes docs/missions.md. Random routes by every planner, as it is and
refined, and through the volume, over the cities whose data are at hand, around made-up no-fly zones. Each is simplified
to half a cell and written as a ``.plan`` with one of the three ends, two of three at a speed. What is measured is the
file: its places, against the route that was planned and against exact outlines by Shapely; and MAVSDK reads it back.
"""

import argparse
import json
import sys
import tempfile
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.ndimage import label

from benchmarks.common import ROOT, machine
from benchmarks.route_soundness import table
from benchmarks.scenes import PLACES, Scene, load_place
from jaxurban.io.read.zone import Zone
from jaxurban.maps.build import compute_maps
from jaxurban.maps.levels import Levels
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.paths.explain import explain
from jaxurban.paths.export.qgc_plan import ENDS, MAV_FRAME_GLOBAL_RELATIVE_ALT
from jaxurban.paths.export.waypoints import waypoints
from jaxurban.paths.export.write import write_path
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.simplify import simplify
from jaxurban.paths.snapping import XY
from jaxurban.planners.registry import PLANNERS
from tests.free_space import Obstacles

RESOLUTION_M, ALTITUDE_M, SPEED_M_S = 5.0, 20.0, 8.0
TOLERANCE_M = RESOLUTION_M / 2
BUDGET_S = 0.3  # of a search and of its refinement
NUM_ZONES, ZONE_M = 3, 60.0
VOLUME = "volume"
KINDS = (*((name, refine) for name in PLANNERS if name != "ptp" for refine in (False, True)), (VOLUME, False))


@dataclass(frozen=True)
class Mission:
    """One mission, as its file says it is."""

    planner: str
    end: str
    planned: int  # waypoints of the route as it was planned
    written: int  # of the file
    shortest_planned_m: float
    shortest_m: float
    apart_m: float  # most, from the route as it was planned
    clearance_m: float  # least, to the outline of a building that reaches the flight's height
    cost: float  # of the simplified route, times that of the planned one
    crossed_m: float  # in cells that are closed
    fence_points: int
    differences: int  # between what was written and what MAVSDK read


def zones_over(scene: Scene, rng: np.random.Generator) -> tuple[Zone, ...]:
    """Return a few made-up zones over a city."""
    west, south, east, north = scene.region(RESOLUTION_M).bounds_m
    centres = rng.uniform([west, south], [east, north], (NUM_ZONES, 2))
    return tuple(
        Zone(f"zone {number}", shapely.Point(*centre).buffer(ZONE_M), scene.place.crs)
        for number, centre in enumerate(centres)
    )


def clearance_m(scene: Scene, xyz_m: np.ndarray) -> float:
    """Return the least distance of legs to the exact outlines that reach their lower ends."""
    least = np.inf
    buildings = scene.city.buildings
    low_m = np.minimum(xyz_m[:-1, 2], xyz_m[1:, 2])
    for z_m in np.unique(low_m):
        legs = shapely.multilinestrings(np.stack([xyz_m[:-1, :2], xyz_m[1:, :2]], axis=1)[low_m == z_m])
        tree = shapely.STRtree(buildings.polygons[buildings.height_m >= z_m])
        near = tree.query_nearest(legs, return_distance=True)[1]
        least = min(least, float(near.min(initial=np.inf)))
    return least


def legs_m(xyz_m: np.ndarray) -> np.ndarray:
    """Return the lengths of legs in space."""
    return np.linalg.norm(np.diff(xyz_m, axis=0), axis=1)


def crossed_m(on: CostMap, xyz_m: np.ndarray) -> float:
    """Return how much of level legs lies in closed cells of their level."""
    grid, total = on.grid, 0.0
    for level, z_m in enumerate(on.altitudes_m):
        is_free = on.is_free if on.levels is None else on.is_free[level]
        here = np.abs(xyz_m[:, 2] - z_m) < 0.01
        obstacles = Obstacles(is_free, RESOLUTION_M, grid.x_min_m, grid.y_min_m)
        for leg in np.flatnonzero(here[:-1] & here[1:]):
            total += obstacles.crossed_m(xyz_m[leg : leg + 2, :2])
    return total


def places_of(on: CostMap, file: Path) -> np.ndarray:
    """Return x, y and height ``[W, 3]`` of the places that a mission flies to, its landing left out."""
    items = json.loads(file.read_text())["mission"]["items"]
    flown = [item["params"][4:7] for item in items if item["frame"] == MAV_FRAME_GLOBAL_RELATIVE_ALT]
    lat, lon, z_m = np.array(flown)[: -1 if items[-1]["command"] == 21 else None].T
    return np.column_stack([*on.grid.xy_of_lonlat(lon, lat), z_m])


def judged(scene: Scene, on: CostMap, planned: PlannedPath, name: str, end: str, file: Path, reader: Any) -> Mission:
    """Return what the mission of a route is like."""
    simple = simplify(planned, on, TOLERANCE_M)
    report = explain(simple, on.maps, speed_m_s=SPEED_M_S) if end != "none" else None
    write_path(simple, file, report, end=end)
    before = waypoints(planned)
    before_m = np.column_stack([*on.grid.xy_of_lonlat(*before.lonlat.T), before.z_m])
    xyz_m = places_of(on, file)
    fence = json.loads(file.read_text())["geoFence"]["polygons"]
    return Mission(
        planner=name,
        end=end,
        planned=len(before_m),
        written=len(xyz_m),
        shortest_planned_m=float(legs_m(before_m).min()),
        shortest_m=float(legs_m(xyz_m).min()),
        apart_m=shapely.hausdorff_distance(
            shapely.LineString(planned.xy_m), shapely.LineString(xyz_m[:, :2]), densify=0.05
        ),
        clearance_m=clearance_m(scene, xyz_m),
        cost=simple.cost / planned.cost,
        crossed_m=crossed_m(on, xyz_m),
        fence_points=sum(len(ring["polygon"]) for ring in fence),
        differences=-1 if reader is None else len(reader.differences(file)),
    )


def fly(scene: Scene, num_missions: int, reader: Any, file: Path) -> list[Mission]:
    """Return missions between random places that free cells join."""
    rng = np.random.default_rng(0)
    maps = compute_maps(scene.task(RESOLUTION_M))
    limits = Constraints(zones_over(scene, rng))
    flat = cost_map(maps, ALTITUDE_M, cost_model="line", constraints=limits)
    volume = cost_map(maps, Levels(), cost_model="line", constraints=limits)
    islands, _ = label(flat.is_free)
    cells = np.argwhere(islands == np.argmax(np.bincount(islands[flat.is_free])))
    missions: list[Mission] = []
    for number, (name, refine) in enumerate(islice(cycle(KINDS), 3 * num_missions)):
        if len(missions) == num_missions:
            break
        start, goal = (XY(*flat.grid.xy_of_cell(*cell)) for cell in rng.choice(cells, 2, replace=False))
        on = volume if name == VOLUME else flat
        how = {} if name == VOLUME else {"planner": name, "refine": refine, "budget_s": BUDGET_S, "seed": number}
        planned = on.plan(start, goal, **how)
        if planned.status.has_path and planned.length_m > 0:
            told = f"{name}, refined" if refine else name
            missions.append(judged(scene, on, planned, told, ENDS[number % len(ENDS)], file, reader))
    return missions


def summary(missions: list[Mission]) -> list[str]:
    """Return one row of the table."""

    def of(name: str) -> np.ndarray:
        return np.array([getattr(mission, name) for mission in missions], float)

    read = "not tried" if (of("differences") < 0).any() else f"{int((of('differences') == 0).sum())}"
    return [
        f"{len(missions)}",
        f"{np.median(of('planned')):.0f} ({of('planned').max():.0f})",
        f"{np.median(of('written')):.0f} ({of('written').max():.0f})",
        f"{of('shortest_planned_m').min():.2f} m, {of('shortest_m').min():.2f} m",
        f"{of('apart_m').max():.2f} m",
        f"{100 * (of('cost').mean() - 1):+.2f} % ({100 * (of('cost').max() - 1):+.2f} %)",
        f"{of('crossed_m').max():.3f} m",
        f"{of('clearance_m').min():.3f} m",
        read,
    ]


def document(cities: dict[str, list[Mission]]) -> str:
    """Return docs/missions.md."""
    head = [
        "missions",
        "waypoints planned",
        "written",
        "shortest leg planned, written",
        "from the route",
        "cost",
        "in closed cells",
        "from outlines",
        "read back equal",
    ]
    by_city = [[name, *summary(missions)] for name, missions in cities.items()]
    every = [mission for missions in cities.values() for mission in missions]
    planners = dict.fromkeys(mission.planner for mission in every)
    by_planner = [[f"`{name}`", *summary([m for m in every if m.planner == name])] for name in planners]
    return f"""\
# Missions, measured on their files

Random routes over {RESOLUTION_M:g} m cells, {ALTITUDE_M:g} m up (the volume: between the maps' altitudes),
cost model `line`, around {NUM_ZONES} made-up no-fly zones a city, {BUDGET_S:g} s a route for sampling planners
and as much for refinement, simplified to {TOLERANCE_M:g} m and written as `.plan` with each of the ends, two of
three at {SPEED_M_S:g} m/s. Measured on the places in the file: waypoints (median and most), the shortest leg, the
largest distance to the planned route (rounding of places adds up to 8 mm), the weighted cost against it (mean and
most), the length in closed cells, and the least distance to the exact outline of a building that reaches the flight's
height (Shapely). MAVSDK reads each file:
commands, frames, parameters, places and the geofence, item by item.
Made by `python -m benchmarks.missions` at commit {machine()["commit"]}.
<!-- measured code: planners jaxurban/paths -->

{table(["city", *head], by_city)}
{table(["planner", *head], by_planner)}"""


def main() -> None:
    """Fly, judge, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "missions.md")
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "missions.json")
    parser.add_argument("--missions", type=int, default=200, help="over all cities")
    parser.add_argument("--cities", nargs="+", choices=PLACES, default=list(PLACES))
    options = parser.parse_args()
    try:
        from tests.mavlink import mission_reader
    except ImportError:
        print("MAVSDK is not installed (pip install mavsdk), so no mission is read back", file=sys.stderr)
        mission_reader = nullcontext
    places = [PLACES[name] for name in options.cities if PLACES[name].is_here]
    shares = [options.missions // len(places) + (k < options.missions % len(places)) for k in range(len(places))]
    cities: dict[str, list[Mission]] = {}
    with tempfile.TemporaryDirectory() as folder, mission_reader() as reader:
        for place, num_missions in zip(places, shares, strict=True):
            scene = load_place(place)
            cities[place.name] = fly(scene, num_missions, reader, Path(folder) / "mission.plan")
            print(place.name, *summary(cities[place.name]), sep=" | ", file=sys.stderr)
    text = document(cities)
    options.output.write_text(text)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    missions = {name: [asdict(mission) for mission in flown] for name, flown in cities.items()}
    options.json.write_text(json.dumps({"machine": machine(), "cities": missions}) + "\n")
    print(text)


if __name__ == "__main__":
    main()
