"""Whether routes planned with a clearance keep it in the files they are written to; writes docs/clearance.md.

Run as ``python -m benchmarks.clearance``. Random routes by several planners, on one altitude, between the maps' and
through the volume, are written as GeoJSON, KML and .plan and read back; Shapely measures how near the lines come to the
outlines of buildings as high as they fly, and how high they pass over the roofs below, without any cells.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyproj
import shapely
from scipy.ndimage import label
from tqdm import tqdm

import jaxurban as ju
from benchmarks.common import ROOT, machine
from benchmarks.route_soundness import table
from benchmarks.scenes import MANHATTAN, TOKYO, Place, load_place
from jaxurban.maps.build import compute_maps
from jaxurban.paths.snapping import XY
from jaxurban.world.city import Buildings

RESOLUTION_M = 2.0
PLACES = (  # a square kilometre of each, on fine cells
    replace(MANHATTAN, bounds=(-74.016, 40.702, -74.002, 40.713)),
    replace(TOKYO, bounds=(139.693, 35.687, 139.707, 35.698)),
)
CLEARANCES_M = ((5.0, 3.0), (3.0, 5.0))  # horizontal, vertical
ALTITUDES_M = (20.0, 35.0)  # of flat routes by turns; the maps hold no 35 m
LEAST_APART_M = 300.0
WEIGHTS = ju.Weights(distance=1.0, gps=0.1, lidar=0.1, population=0.0, risk=0.0)  # so that routes hug walls
PLANNERS = {  # what `plan` takes, by name
    "astar-plus": {"planner": "astar-plus"},
    "theta-star": {"planner": "theta-star"},
    "theta-star, refined": {"planner": "theta-star", "refine": True, "budget_s": 2.0},
    "bitstar-plus": {"planner": "bitstar-plus", "budget_s": 0.5},
    "volume": {},
}
NAV_WAYPOINT, NAV_TAKEOFF = 16, 22  # MAVLink's numbers of the items that have a place
KML = "{http://www.opengis.net/kml/2.2}"
PARTS = 32  # of a leg that is straight in degrees


class Outlines:
    """Exact outlines of a city, for measuring how near routes come to them. ``N`` points of a route, ``x, y, z``."""

    def __init__(self, buildings: Buildings) -> None:
        self.polygons, self.height_m = buildings.polygons, buildings.height_m
        self.tree = shapely.STRtree(self.polygons)

    @cache  # noqa: B019 (lives as long as the process)
    def _as_high_as(self, z_m: float) -> shapely.STRtree:
        return shapely.STRtree(self.polygons[self.height_m >= z_m])

    def nearest_m(self, xyz_m: np.ndarray) -> float:
        """Return the least distance to outlines of buildings as high as the lower end of each leg."""
        low_m = np.minimum(xyz_m[:-1, 2], xyz_m[1:, 2])
        found = [np.inf]
        for z_m in np.unique(low_m):
            legs = shapely.linestrings(np.stack([xyz_m[:-1, :2], xyz_m[1:, :2]], axis=1)[low_m == z_m])
            _, away_m = self._as_high_as(float(z_m)).query_nearest(legs, return_distance=True, all_matches=False)
            found.append(away_m.min(initial=np.inf))
        return float(min(found))

    def over_roofs_m(self, xyz_m: np.ndarray) -> float:
        """Return the least height over the roofs beneath, of the lower end of each leg."""
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
    items = [item for item in json.loads(file.read_text())["mission"]["items"] if item["type"] == "SimpleItem"]
    places = [item["params"][4:7] for item in items if item["command"] in (NAV_WAYPOINT, NAV_TAKEOFF)]
    return np.array(places)[:, [1, 0, 2]]


READERS = {".geojson": read_geojson, ".kml": read_kml, ".plan": read_plan}


@dataclass(frozen=True)
class City:
    """A city to fly over: its maps, and its outlines as the witness."""

    place: Place
    maps: ju.MetricMaps
    outlines: Outlines

    def routes(self, constraints: ju.Constraints, num_pairs: int, planners: dict[str, dict]) -> Iterator[tuple]:
        """Yield planner and path of every planner between random cells that the constraints join."""
        flat = {
            z_m: ju.cost_map(self.maps, z_m, weights=WEIGHTS, cost_model="line", constraints=constraints)
            for z_m in ALTITUDES_M
        }
        volume = ju.cost_map(
            self.maps, ju.Levels(level_step_m=40.0), weights=WEIGHTS, cost_model="line", constraints=constraints
        )
        islands, _ = label(flat[ALTITUDES_M[0]].is_free)
        cells = np.argwhere(islands == np.argmax(np.bincount(islands[islands > 0])))
        rng = np.random.default_rng(0)
        for number in range(num_pairs):
            start, goal = cells[rng.choice(len(cells), 2, replace=False)]
            while np.hypot(*(goal - start)) * self.maps.grid.resolution_m < LEAST_APART_M:
                start, goal = cells[rng.choice(len(cells), 2, replace=False)]
            for name, how in planners.items():
                on, z_m = (volume, (20.0,)) if name == "volume" else (flat[ALTITUDES_M[number % 2]], ())
                ends = (XY(*map(float, self.maps.grid.xy_of_cell(*cell)), *z_m) for cell in (start, goal))
                yield name, on.plan(*ends, seed=number, **how)

    def measured(self, path: ju.PlannedPath, folder: Path) -> dict[str, float]:
        """Return how near the files of a path come to outlines and roofs, read straight in metres and in degrees."""
        to_metres = pyproj.Transformer.from_crs("EPSG:4326", self.maps.grid.crs, always_xy=True)
        found: dict[str, float] = {}
        for suffix, read in READERS.items():
            path.save(folder / f"route{suffix}")
            lonlatz = read(folder / f"route{suffix}")
            xyz_m = np.column_stack([*to_metres.transform(*lonlatz[:, :2].T), lonlatz[:, 2]])
            found[suffix] = self.outlines.nearest_m(xyz_m)
            found[f"over roofs {suffix}"] = self.outlines.over_roofs_m(xyz_m)
        at = np.linspace(0, len(lonlatz) - 1, PARTS * (len(lonlatz) - 1) + 1)  # of the .plan, whose legs are longest
        lon, lat, z_m = (np.interp(at, np.arange(len(lonlatz)), values) for values in lonlatz.T)
        bowed_m = np.column_stack([*to_metres.transform(lon, lat), z_m])
        return found | {"in degrees": self.outlines.nearest_m(bowed_m)}


def fly(place: Place, num_pairs: int) -> pd.DataFrame:
    """Return a row for each route over a place: what was kept, by whom, and how near it came."""
    scene = load_place(place)
    city = City(place, compute_maps(scene.task(RESOLUTION_M)), Outlines(scene.city.buildings))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for horizontal_m, vertical_m in (*CLEARANCES_M, (0.0, 0.0)):
            constraints = ju.Constraints.read(clearance_m=horizontal_m, vertical_clearance_m=vertical_m)
            planners = PLANNERS if horizontal_m else {"theta-star": PLANNERS["theta-star"]}  # shows what is at stake
            routes = city.routes(constraints, num_pairs, planners)
            for name, path in tqdm(routes, total=num_pairs * len(planners), desc=place.name, mininterval=20):
                row = {"city": place.name, "clearance": horizontal_m, "vertical": vertical_m, "planner": name}
                rows.append(row | {"status": path.status.value})
                if path.status.has_path:
                    rows[-1] |= city.measured(path, Path(folder))
    return pd.DataFrame(rows)


def document(rows: pd.DataFrame, commit: str, elapsed_s: float) -> str:
    """Return docs/clearance.md."""
    found = rows.dropna(subset=[*READERS])
    lines, over = [], [f"over roofs {suffix}" for suffix in READERS]
    for key, group in found.groupby(["city", "clearance", "vertical", "planner"], sort=False):
        city, horizontal_m, vertical_m, planner = key
        asked = f"{horizontal_m:g} m, {vertical_m:g} m" if horizontal_m else "none"
        figures = [group[name].min() for name in (*READERS, "in degrees")] + [group[over].min(axis=None)]
        lines.append([city, asked, f"`{planner}`", f"{len(group)}", *map(_metres, figures)])
    kept = found[found.clearance > 0]
    nearest_m = kept[[*READERS, "in degrees"]].min(axis=1)
    num_kept = int(((nearest_m >= kept.clearance) & (kept[over].min(axis=1) >= kept.vertical)).sum())
    about = f"""\
# Clearance, measured on written files

Routes planned with `--clearance` and `--vertical-clearance`, written as GeoJSON, KML and `.plan` and read back. Shapely
measures the lines against the outlines themselves, in the maps' CRS and without cells: the least distance to the
outlines of buildings as high as the route, and the least height over roofs beneath. *In degrees*: the same of the
`.plan`, whose legs are the longest, drawn straight in longitude and latitude. Random pairs of free cells at least
{LEAST_APART_M:g} m apart, cells of {RESOLUTION_M:g} m, altitudes {ALTITUDES_M[0]:g} m and {ALTITUDES_M[1]:g} m by turns
(the maps hold 20, 60 and 122 m), the volume in levels 40 m apart, weights that send routes along the walls (1 a metre,
0.1 of GPS and lidar, nothing of risk). The last rows of a city are without a clearance.

**{num_kept} of {len(kept)} routes keep what was asked** ({len(rows[rows.clearance > 0]) - len(kept)} found no path).
Made by `python -m benchmarks.clearance` at commit {commit} in {elapsed_s / 60:.0f} minutes.
<!-- measured code: planners jaxurban/paths -->

"""
    head = ["city", "clearance, vertical", "planner", "routes", "GeoJSON", "KML", "`.plan`", "in degrees", "over roofs"]
    return about + table(head, lines)


def _metres(value: float) -> str:
    return f"{value:.3f} m" if np.isfinite(value) else "none"


def main() -> None:
    """Fly, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "clearance.md")
    parser.add_argument("--csv", type=Path, default=ROOT / "out" / "clearance.csv")
    parser.add_argument("--pairs", type=int, default=30, help="of places, for each clearance and city")
    options = parser.parse_args()
    begin_s, rows = time.perf_counter(), []
    for place in PLACES:
        if not place.is_here:
            raise SystemExit(f"no data of {place.name} at {place.buildings}")
        rows.append(fly(place, options.pairs))
        options.csv.parent.mkdir(parents=True, exist_ok=True)
        pd.concat(rows).to_csv(options.csv, index=False)
    text = document(pd.concat(rows), machine()["commit"], time.perf_counter() - begin_s)
    options.output.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
