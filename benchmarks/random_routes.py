"""Random routes by every planner, judged by exact outlines, by their files and by MAVSDK, without any cells.

``python -m benchmarks.random_routes [--pairs 30] [--cities manhattan] [--rules touched]`` plans between random cells
that are joined under the strictest of the rules: on one level, as each planner finds a route and refined, and through
the volume. Each route is written as GeoJSON, KML and ``.plan`` and read back; Shapely measures the lines against the
outlines of buildings as high as they fly. Simplified to half a cell it is written as a mission, which MAVSDK reads
(where it is installed). Prints four tables: inside outlines, what a rule costs, clearance of files, missions.
"""

import argparse
import json
import multiprocessing
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from itertools import cycle, product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyproj
import shapely
from scipy.ndimage import label
from tqdm import tqdm

import jaxurban as ju
from benchmarks.common import machine, table
from benchmarks.scenes import PLACES, Scene, load_place
from jaxurban.flights.export.qgc_plan import END_NOTES
from jaxurban.flights.export.write import write_path
from jaxurban.io.zone import Zone
from jaxurban.maps.build import compute_maps
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.explain import explain
from jaxurban.paths.finish import simplify
from jaxurban.paths.places import XY
from jaxurban.planners.registry import PLANNERS
from jaxurban.typing import PlannedPath
from jaxurban.world.footprints import Footprints
from jaxurban.world.grid import Grid
from tests.free_space import Obstacles

ALTITUDE_M, LEAST_APART_M, SPEED_M_S, BUDGET_S = 20.0, 300.0, 8.0, 0.3
TOUCH_M = 1e-5  # outlines are drawn in by this much, so that a route along a wall is not inside it
STEP_M = 0.25  # between the points whose depth is measured
ENDS_APART_M = (
    8.0  # of missions from roofs: the widest clearance, and as far as a home lies beside its cell
)
RULES: dict[str, tuple[str, dict[str, float]]] = {  # of obstacles, and the clearances
    "centre": ("centre", {"vertical_clearance_m": 0.0}),
    "touched": ("touched", {"vertical_clearance_m": 0.0}),
    "3 m, 5 m": ("touched", {"clearance_m": 3.0, "vertical_clearance_m": 5.0}),
    "5 m, 3 m": ("touched", {"clearance_m": 5.0, "vertical_clearance_m": 3.0}),
}
NUM_ZONES, ZONE_M = 3, 60.0  # made-up no-fly zones of a city
VOLUME = "volume"
KINDS = (
    *((name, refine) for name in PLANNERS if name != "ptp" for refine in (False, True)),
    (VOLUME, False),
)
NAV_WAYPOINT, NAV_TAKEOFF = 16, 22  # MAVLink's numbers of the items that have a place
KML = "{http://www.opengis.net/kml/2.2}"
PARTS = 32  # of a leg that is straight in degrees
Closed = dict[float, Obstacles]  # cells of each level, by its altitude


class Outlines:
    """Exact outlines of a city as the witness. ``N`` points of a route, ``x, y, z``; a leg counts at its lower end."""

    def __init__(self, buildings: Footprints) -> None:
        self.polygons, self.height_m = buildings.polygons, buildings.height_m
        self.tree = shapely.STRtree(self.polygons)

    @cache  # noqa: B019 (lives as long as its process)
    def _as_high_as(self, z_m: float) -> shapely.STRtree:
        return shapely.STRtree(self.polygons[self.height_m >= z_m])

    def _by_height(self, xyz_m: np.ndarray) -> list[tuple[np.ndarray, shapely.STRtree]]:
        """Return the legs by their lower ends, each with the buildings as high."""
        low_m = np.minimum(xyz_m[:-1, 2], xyz_m[1:, 2])
        legs = shapely.linestrings(np.stack([xyz_m[:-1, :2], xyz_m[1:, :2]], axis=1))
        return [(legs[low_m == z_m], self._as_high_as(float(z_m))) for z_m in np.unique(low_m)]

    def cut(self, xyz_m: np.ndarray) -> tuple[float, float]:
        """Return the length of a route inside outlines, and how deep it gets into them, metres."""
        inside_m = depth_m = 0.0
        for legs, tree in self._by_height(xyz_m):
            hit = tree.geometries[np.unique(tree.query(legs, predicate="intersects")[1])]
            if hit.size:
                walls = shapely.union_all(shapely.buffer(hit, -TOUCH_M, join_style="mitre"))
                pieces = shapely.intersection(legs, walls)
                places = shapely.points(shapely.get_coordinates(shapely.segmentize(pieces, STEP_M)))
                inside_m += float(shapely.length(pieces).sum())
                depth_m = max(
                    depth_m, shapely.distance(places, shapely.boundary(walls)).max(initial=0.0)
                )
        return inside_m, depth_m

    def nearest_m(self, xyz_m: np.ndarray) -> float:
        """Return the least distance to outlines of buildings as high; inf without any."""
        away_m = [
            tree.query_nearest(legs, return_distance=True, all_matches=False)[1].min(initial=np.inf)
            for legs, tree in self._by_height(xyz_m)
        ]
        return float(min(away_m))

    def over_roofs_m(self, xyz_m: np.ndarray) -> float:
        """Return the least height over the roofs beneath."""
        low_m = np.minimum(xyz_m[:-1, 2], xyz_m[1:, 2])
        legs = shapely.linestrings(np.stack([xyz_m[:-1, :2], xyz_m[1:, :2]], axis=1))
        leg, roof = self.tree.query(legs, predicate="intersects")
        return float((low_m[leg] - self.height_m[roof]).min(initial=np.inf))


def read_geojson(file: Path) -> np.ndarray:
    """Return ``[N, 3]`` longitude, latitude and altitude."""
    (feature,) = json.loads(file.read_text())["features"]
    return np.column_stack([feature["geometry"]["coordinates"], feature["properties"]["z_m"]])


def read_kml(file: Path) -> np.ndarray:
    """Return ``[N, 3]`` longitude, latitude and altitude."""
    text = ElementTree.parse(file).getroot().find(f".//{KML}LineString/{KML}coordinates").text
    return np.array([[float(number) for number in place.split(",")] for place in text.split()])


def read_plan(file: Path) -> np.ndarray:
    """Return ``[N, 3]`` longitude, latitude and altitude over home: above ground, as these maps are flat."""
    items = [
        item
        for item in json.loads(file.read_text())["mission"]["items"]
        if item["type"] == "SimpleItem"
    ]
    places = [
        item["params"][4:7] for item in items if item["command"] in (NAV_WAYPOINT, NAV_TAKEOFF)
    ]
    return np.array(places)[:, [1, 0, 2]]


READERS = {".geojson": read_geojson, ".kml": read_kml, ".plan": read_plan}


def legs_m(xyz_m: np.ndarray) -> np.ndarray:
    """Return the lengths of legs in space."""
    return np.linalg.norm(np.diff(xyz_m, axis=0), axis=1)


def crossed_m(closed: Closed, xyz_m: np.ndarray) -> float:
    """Return how much of level legs lies in the closed cells of their level."""
    total = 0.0
    for level_m, obstacles in closed.items():
        here = np.abs(xyz_m[:, 2] - level_m) < 0.01
        legs = np.flatnonzero(here[:-1] & here[1:])
        total += sum(obstacles.crossed_m(xyz_m[leg : leg + 2, :2]) for leg in legs)
    return total


def closed_cells(on: CostMap) -> Closed:
    """Return the closed cells of each level, as Shapely sees them."""
    is_free = [on.is_free] if on.levels is None else on.is_free
    frame = (on.grid.resolution_m, on.grid.x_min_m, on.grid.y_min_m)
    return {
        float(z_m): Obstacles(free, *frame)
        for z_m, free in zip(on.altitudes_m, is_free, strict=True)
    }


@dataclass(frozen=True)
class Judge:
    """What routes over a city are held against, and where their files go."""

    outlines: Outlines
    to_metres: Callable
    reader: Any
    folder: Path

    def written(self, path: PlannedPath) -> dict[str, float]:
        """Return how near the files of a path come to outlines and roofs, read straight in metres and in degrees."""
        found = {}
        for suffix, read in READERS.items():
            path.save(self.folder / f"route{suffix}")
            lonlatz = read(self.folder / f"route{suffix}")
            xyz_m = np.column_stack([*self.to_metres(*lonlatz[:, :2].T), lonlatz[:, 2]])
            found |= {
                suffix: self.outlines.nearest_m(xyz_m),
                f"over {suffix}": self.outlines.over_roofs_m(xyz_m),
            }
        at = np.linspace(
            0, len(lonlatz) - 1, PARTS * (len(lonlatz) - 1) + 1
        )  # of the .plan, whose legs are longest
        lon, lat, z_m = (np.interp(at, np.arange(len(lonlatz)), values) for values in lonlatz.T)
        bowed_m = np.column_stack([*self.to_metres(lon, lat), z_m])
        return found | {
            "in degrees": self.outlines.nearest_m(bowed_m),
            "shortest planned": legs_m(xyz_m).min(),
        }

    def mission(
        self, on: CostMap, closed: Closed, planned: PlannedPath, end: str
    ) -> dict[str, float]:
        """Return what the simplified route's mission is like, by its file."""
        simple, file = simplify(planned, on, on.grid.resolution_m / 2), self.folder / "mission.plan"
        write_path(
            simple,
            file,
            explain(simple, on.maps, speed_m_s=SPEED_M_S) if end != "none" else None,
            end=end,
        )
        lonlatz = read_plan(file)
        xyz_m = np.column_stack([*self.to_metres(*lonlatz[:, :2].T), lonlatz[:, 2]])
        lines = (shapely.LineString(planned.xy_m), shapely.LineString(xyz_m[:, :2]))
        return {
            "planned": len(read_plan(self.folder / "route.plan")),
            "written": len(xyz_m),
            "shortest": legs_m(xyz_m).min(),
            "apart": shapely.hausdorff_distance(*lines, densify=0.05),
            "dearer": simple.cost / planned.cost - 1,
            "crossed": crossed_m(closed, xyz_m),
            "from outlines": self.outlines.nearest_m(xyz_m),
            "read equal": np.nan if self.reader is None else not self.reader.differences(file),
        }

    def row(self, on: CostMap, closed: Closed, planned: PlannedPath, end: str) -> dict[str, float]:
        """Return all that is measured of a route."""
        if not planned.status.has_path:
            return {"length_m": np.inf, "cost": np.inf}
        xyz_m = np.column_stack([planned.xy_m, planned.z_m])
        inside_m, depth_m = self.outlines.cut(xyz_m)
        found = {
            "length_m": planned.length_m,
            "cost": planned.cost,
            "inside": inside_m,
            "depth": depth_m,
            "refused": 0.0,
        }
        try:
            return found | self.written(planned) | self.mission(on, closed, planned, end)
        except ju.InputError:  # a mission that its own check finds in a building is not written
            return found | {"refused": 1.0}


def zones_over(scene: Scene, resolution_m: float, rng: np.random.Generator) -> tuple[Zone, ...]:
    """Return a few made-up zones over a city."""
    west, south, east, north = scene.region(resolution_m).bounds_m
    centres = rng.uniform([west, south], [east, north], (NUM_ZONES, 2))
    shapes = (shapely.Point(*centre).buffer(ZONE_M) for centre in centres)
    return tuple(Zone(f"zone {k}", shape, scene.place.crs) for k, shape in enumerate(shapes))


def on_the_ground(cells: np.ndarray, grid: Grid, buildings: Footprints) -> np.ndarray:
    """Return those of ``[N, 2]`` rows and columns that are `ENDS_APART_M` from all roofs, as missions land there."""
    places = shapely.points(np.array([grid.xy_of_cell(*cell) for cell in cells.tolist()]))
    tree = shapely.STRtree(buildings.polygons)
    near, _ = tree.query(places, predicate="dwithin", distance=ENDS_APART_M)
    return np.delete(cells, near, axis=0)


def fly(city: str, rules: list[str], num_pairs: int, resolution_m: float) -> pd.DataFrame:
    """Return a row for each route over a city: rule, planner, pair, and what is measured of it."""
    try:
        from tests.mavlink import mission_reader
    except ImportError:
        mission_reader = nullcontext
    scene, rng = load_place(PLACES[city]), np.random.default_rng(0)
    maps, zones = compute_maps(scene.task(resolution_m)), zones_over(scene, resolution_m, rng)
    on: dict[tuple[str, bool], CostMap] = {}
    for rule, is_flat in product(rules, (True, False)):
        obstacles, kept = RULES[rule]
        constraints, at = ju.Constraints(zones, **kept), ALTITUDE_M if is_flat else ju.Levels()
        on[rule, is_flat] = ju.cost_map(
            maps.with_obstacles(obstacles), at, cost_model="line", constraints=constraints
        )
    closed = {key: closed_cells(each) for key, each in on.items()}
    islands, _ = label(np.logical_and.reduce([on[rule, True].is_free for rule in rules]))
    cells = np.argwhere(islands == np.argmax(np.bincount(islands[islands > 0])))
    cells = on_the_ground(cells, maps.grid, scene.city.buildings)
    pairs = cells[rng.integers(len(cells), size=(20 * num_pairs, 2))]
    pairs = pairs[np.hypot(*(pairs[:, 1] - pairs[:, 0]).T) * resolution_m >= LEAST_APART_M][
        :num_pairs
    ]
    to_metres = pyproj.Transformer.from_crs("EPSG:4326", maps.grid.crs, always_xy=True).transform
    rows, ends = [], cycle(END_NOTES)
    with tempfile.TemporaryDirectory() as folder, mission_reader() as reader:
        judge = Judge(Outlines(scene.city.buildings), to_metres, reader, Path(folder))
        for number, pair in enumerate(
            tqdm(pairs, desc=scene.name, mininterval=20, file=sys.stderr)
        ):
            for rule, (name, refine) in product(rules, KINDS):
                z_m, key = ((ALTITUDE_M,) if name == VOLUME else ()), (rule, name != VOLUME)
                places = (XY(*map(float, maps.grid.xy_of_cell(*cell)), *z_m) for cell in pair)
                how = {"planner": name, "refine": refine, "budget_s": BUDGET_S, "seed": number}
                planned = on[key].plan(*places, **({} if name == VOLUME else how))
                found = {
                    "city": scene.name,
                    "rule": rule,
                    "planner": f"{name}, refined" if refine else name,
                }
                rows.append(
                    found | {"pair": number} | judge.row(on[key], closed[key], planned, next(ends))
                )
    return pd.DataFrame(rows)


def tables(rows: pd.DataFrame) -> str:
    """Return the four tables in Markdown."""
    flown = rows[np.isfinite(rows.length_m)]
    keys = ["city", "rule", "planner"]
    files, over = [*READERS, "in degrees"], [f"over {suffix}" for suffix in READERS]
    inside, clearance, missions = {}, {}, {}
    for key, group in flown.groupby(keys, sort=False):
        cuts = group.inside[group.inside > 0]
        inside[key] = {
            "routes": f"{len(group)}",
            "that cut outlines": f"{len(cuts) / len(group):.0%}",
            "mean length inside of these, most": f"{cuts.mean() if len(cuts) else 0:.1f} m, {group.inside.max():.1f} m",
            "deepest": f"{group.depth.max():.1f} m",
            "missions refused": f"{group.refused.sum():.0f}",
        }
        clearance[key] = {name: f"{group[name].min():.3f} m" for name in files}
        clearance[key]["over roofs"] = f"{group[over].min(axis=None):.3f} m"
        missions[key] = {
            "waypoints planned": f"{group.planned.median():.0f} ({group.planned.max():.0f})",
            "written": f"{group.written.median():.0f} ({group.written.max():.0f})",
            "shortest leg planned, written": f"{group['shortest planned'].min():.2f} m, {group.shortest.min():.2f} m",
            "from the route": f"{group.apart.max():.2f} m",
            "cost": f"{group.dearer.mean():+.2%} ({group.dearer.max():+.2%})",
            "in closed cells": f"{group.crossed.max():.3f} m",
            "from outlines": f"{group['from outlines'].min():.3f} m",
            "read back equal": f"{group['read equal'].sum():.0f}"
            if group["read equal"].notna().all()
            else "not tried",
        }
    return "\n\n".join(
        markdown(keys, each) for each in (inside, prices(flown), clearance, missions)
    )


def prices(flown: pd.DataFrame) -> dict[tuple[str, ...], dict[str, str]]:
    """Return how much longer and costlier paths are than under the first rule, of the same pairs."""
    found = {}
    first = flown[(flown.rule == flown.rule.iloc[0]) & (flown.length_m > 0)]
    both = flown.merge(first, on=["city", "planner", "pair"], suffixes=("", "_first"))
    for key, group in both[both.rule != both.rule_first].groupby(
        ["city", "rule", "planner"], sort=False
    ):
        found[key] = {}
        for name, column in (("longer by", "length_m"), ("costlier by", "cost")):
            more = group[column] / group[f"{column}_first"] - 1
            found[key][name] = f"{more.mean():.2%} ({more.quantile(0.95):.1%}; {more.max():.1%})"
    return found


def markdown(keys: list[str], rows: dict[tuple[str, ...], dict[str, str]]) -> str:
    """Return rows by city, rule and planner."""
    head = [*keys, *next(iter(rows.values()), {})]
    return table(head, [[*key, *row.values()] for key, row in rows.items()])


def main() -> None:
    """Fly, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=30, help="of each city")
    parser.add_argument("--resolution", type=float, default=5.0, help="metres")
    parser.add_argument(
        "--cities",
        nargs="+",
        choices=PLACES,
        default=[name for name in PLACES if PLACES[name].is_here],
    )
    parser.add_argument("--rules", nargs="+", choices=RULES, default=list(RULES))
    parser.add_argument("--csv", type=Path, help="of every route")
    asked = parser.parse_args()
    how = [(city, asked.rules, asked.pairs, asked.resolution) for city in asked.cities]
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        rows = pd.concat(pool.map(fly, *zip(*how, strict=True)))
    if asked.csv:
        rows.to_csv(asked.csv, index=False)
    print(f"{tables(rows)}\n\n{machine()}")


if __name__ == "__main__":
    main()
