"""How far the maps are from exact geometry: prints the tables of docs/evidence/accuracy.md.

``python -m benchmarks.error_table`` goes by metric, altitude and resolution; with ``--by-city`` over every city at one
resolution. Exact geometry is the outlines extruded to their roofs: Embree rays for GPS and lidar, Shapely distances
for risk. Two kinds of points: cell centres, where the map was computed, and (not by city) points anywhere in free
space, where a user looks the map up.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import shapely

from benchmarks.common import machine, table
from benchmarks.embree_peer import EmbreePool, scan_until_first_return, see_satellites
from benchmarks.metric_peers import LEAST_SATELLITES, numpy_inverse
from benchmarks.scenes import ALTITUDES_M, PLACES, Scene, load_place, load_scene
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.gps import Gps, maps_of_choices, satellites_of
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.visibility import visibility
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import obstacles_on

RESOLUTIONS_M = (10.0, 5.0, 2.0, 1.0)
CITY_RESOLUTION_M, CITY_ALTITUDES_M = 5.0, ALTITUDES_M[:2]
NUM_GPS_POINTS, NUM_LIDAR_POINTS = 20_000, 2_000
CLOSE_M = 0.02  # of m_gps
GPS, LIDAR, RISK = Gps(), Lidar(), Risk()


@dataclass(frozen=True)
class Maps:
    """What the engine computed at one resolution. ``A`` altitudes, ``y, x`` cells."""

    seen: np.ndarray  # [A, y, x] uint32, a bit a satellite
    gps: np.ndarray
    lidar: np.ndarray
    risk: np.ndarray
    roof_m: np.ndarray


def compute(scene: Scene, resolution_m: float) -> Maps:
    surface, sky = scene.surface(resolution_m), (scene.azimuth_rad, scene.elevation_rad)
    words = visibility(surface, *sky, ALTITUDES_M)
    satellites, is_obstacle = satellites_of(InView(*sky, ())), obstacles_on(surface, ALTITUDES_M)
    maps, number = maps_of_choices(words, is_obstacle, satellites, GPS.gdop_threshold)
    return Maps(
        np.asarray(words)[0],
        maps.m[number],
        np.asarray(compute_lidar(surface, ALTITUDES_M, LIDAR)),
        np.asarray(compute_risk(surface, ALTITUDES_M, RISK)),
        np.asarray(surface.crop(surface.roof_m)),
    )


def exact_gps(directions: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return ``[N]`` m_gps of ``[S, N]`` visibility, in float64."""
    gdop = np.full(seen.shape[1], np.inf)
    enough = np.flatnonzero(seen.sum(axis=0) >= LEAST_SATELLITES)
    gdop[enough] = numpy_inverse(directions, seen[:, enough].T.astype(float))[0]
    threshold = GPS.gdop_threshold
    return np.clip((threshold - np.minimum(gdop, threshold)) / (threshold - 1), 0, 1)


def exact_risk(slice_tree: shapely.STRtree, xy_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` m_risk of points by their distance to the nearest outline of the slice."""
    points = shapely.points(xy_m)
    pairs, distance_m = slice_tree.query_nearest(
        points, max_distance=RISK.threshold_m, return_distance=True, all_matches=False
    )
    m = np.ones(len(points))
    m[pairs[0]] = np.minimum(distance_m / RISK.threshold_m, 1.0)
    return m


def mean_of(values: np.ndarray, scale: float = 1.0, digits: int = 4) -> str:
    """Return a mean with its standard error."""
    error = values.std() / np.sqrt(len(values))
    return f"{scale * values.mean():.{digits}f} ± {scale * error:.{digits}f}"


def share(is_right: np.ndarray, among: np.ndarray) -> str:
    """Return the percentage of right answers ``[S, N]`` among some.

    Its standard error is by points, because a point's answers hang together.
    """
    right, asked = (is_right & among).sum(axis=0), among.sum(axis=0)
    part = right.sum() / asked.sum()
    error = np.sqrt(np.sum((right - part * asked) ** 2)) / asked.sum()
    return f"{100 * part:.2f} ± {100 * error:.2f}"


@dataclass(frozen=True)
class Truth:
    """A city's exact geometry, and the rays through it."""

    scene: Scene
    pool: EmbreePool
    directions: np.ndarray  # [S, 3]

    def slice_tree(self, altitude_m: float) -> shapely.STRtree:
        """Return the outlines that reach an altitude."""
        buildings = self.scene.city.buildings
        assert buildings is not None
        return shapely.STRtree(buildings.polygons[buildings.height_m >= altitude_m])

    def errors(
        self,
        maps: Maps,
        k: int,
        slice_tree: shapely.STRtree,
        xy_m: np.ndarray,
        y: np.ndarray,
        x: np.ndarray,
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return by metric the map's m in cells less the truth at points, and the visibility ``[S, N]`` there."""
        altitude_m, few = ALTITUDES_M[k], slice(NUM_LIDAR_POINTS)
        seen = self.pool.run(see_satellites, xy_m, np.array([altitude_m]), self.directions).found[0]
        scan = self.pool.run(scan_until_first_return, xy_m[few], altitude_m, LIDAR).found
        return {
            "gps": maps.gps[k, y, x] - exact_gps(self.directions, seen),
            "lidar": maps.lidar[k, y[few], x[few]] - scan,
            "risk": maps.risk[k, y, x] - exact_risk(slice_tree, xy_m),
        }, seen


@contextmanager
def exact(scene: Scene) -> Iterator[Truth]:
    """Give a city's exact geometry, its rays traced on every core."""
    assert scene.city.buildings is not None
    with EmbreePool(scene.city.buildings) as pool:
        yield Truth(scene, pool, unit_vectors(scene.azimuth_rad, scene.elevation_rad))


def free_centres(
    maps: Maps, k: int, region: Grid, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the centres ``[N, 2]`` of random free cells, and their rows and columns."""
    row, col = rng.choice(np.argwhere(maps.roof_m < ALTITUDES_M[k]), NUM_GPS_POINTS).T
    return np.column_stack([region.x_m[col], region.y_m[row]]), row, col


def is_right(maps: Maps, k: int, seen: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ``[S, N]`` whether the map's answers in cells are those of rays."""
    answers = (maps.seen[k, y, x] >> np.arange(len(seen), dtype=np.uint32)[:, None]) & 1 == 1
    return answers == seen


def compare(truth: Truth, resolution_m: float, rows: dict[str, list[list[str]]]) -> None:
    """Add the rows of one resolution to each metric's table."""
    maps, region = compute(truth.scene, resolution_m), truth.scene.region(resolution_m)
    for k, altitude_m in enumerate(ALTITUDES_M):
        rng = np.random.default_rng(k)
        slice_tree = truth.slice_tree(altitude_m)
        centres = free_centres(maps, k, region, rng)
        x_min, y_min, x_max, y_max = region.bounds_m
        anywhere_m = rng.uniform((x_min, y_min), (x_max, y_max), (2 * NUM_GPS_POINTS, 2))
        inside = np.zeros(len(anywhere_m), bool)
        inside[slice_tree.query(shapely.points(anywhere_m), predicate="intersects")[0]] = True
        cell = ((anywhere_m - (x_min, y_min)) / resolution_m).astype(int)
        called = maps.roof_m[cell[:, 1], cell[:, 0]] >= altitude_m
        free = np.flatnonzero(~inside & ~called)[:NUM_GPS_POINTS]
        start = (f"{altitude_m:.0f} m", f"{resolution_m:g} m")
        rows["obstacle"].append([*start, mean_of(called != inside, 100, 2)])

        centre, seen = truth.errors(maps, k, slice_tree, *centres)
        anywhere, _ = truth.errors(
            maps, k, slice_tree, anywhere_m[free], cell[free, 1], cell[free, 0]
        )
        right = is_right(maps, k, seen, *centres[1:])
        shares = (share(right, among) for among in (np.ones_like(seen), ~seen, seen))
        rows["gps"].append(
            [*start, *shares, *(mean_of(np.abs(errors["gps"])) for errors in (centre, anywhere))]
        )
        for name in ("lidar", "risk"):
            cells = (np.abs(centre[name]), centre[name], np.abs(anywhere[name]), anywhere[name])
            rows[name].append([*start, *map(mean_of, cells)])


def city_rows(truth: Truth) -> list[list[str]]:
    """Return a city's rows of the table by city."""
    maps, region = compute(truth.scene, CITY_RESOLUTION_M), truth.scene.region(CITY_RESOLUTION_M)
    rows = []
    for k, altitude_m in enumerate(CITY_ALTITUDES_M):
        centres = free_centres(maps, k, region, np.random.default_rng(k))
        errors, seen = truth.errors(maps, k, truth.slice_tree(altitude_m), *centres)
        right = is_right(maps, k, seen, *centres[1:])
        true_risk = maps.risk[(k, *centres[1:])] - errors["risk"]
        near_m = RISK.threshold_m * errors["risk"][true_risk < 1]
        cells = [
            f"{100 * np.mean(np.abs(errors['gps']) <= CLOSE_M):.1f}",
            mean_of(np.abs(errors["gps"])),
            *(share(right, among) for among in (np.ones_like(seen), ~seen, seen)),
            *(mean_of(values) for values in (np.abs(errors["lidar"]), errors["lidar"])),
            f"{mean_of(near_m, digits=2)} m",
            f"{100 * np.mean(true_risk < 1):.0f}",
        ]
        rows.append([truth.scene.name, f"{altitude_m:.0f} m", *cells])
    return rows


ERRORS = ["error of m at centres", "its bias", "error of m anywhere", "its bias"]
SIGHT = ["lines of sight right, %", "of those blocked", "of those clear"]
TABLES = {  # title and columns, after those of altitude and cells
    "gps": (
        "GPS: lines of sight and m_gps",
        [*SIGHT, "error of m at centres", "error of m anywhere"],
    ),
    "lidar": ("Lidar: m_lidar, 16 beams x 360 azimuths, 100 m", ERRORS),
    "risk": ("Risk: m_risk, 50 m, by distance to the outlines of the slice", ERRORS),
    "obstacle": ("Obstacle: free or not", ["points called wrongly, %"]),
}
CITY_HEAD = [
    *("city", "altitude", "cells with m_gps within 0.02, %", "error of m_gps", *SIGHT),
    *("error of m_lidar", "its bias", "near walls seem farther by", "cells near walls, %"),
]


def main() -> None:
    """Print the tables that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--resolutions", type=float, nargs="+", default=RESOLUTIONS_M, help="metres"
    )
    parser.add_argument(
        "--by-city", action="store_true", help="every city at hand at one resolution instead"
    )
    options = parser.parse_args()
    print(f"commit {machine()['commit']}")
    if options.by_city:
        found = []
        for place in (place for place in PLACES.values() if place.is_here):
            with exact(load_place(place)) as truth:
                found += city_rows(truth)
        print(table(CITY_HEAD, found))
        return
    rows: dict[str, list[list[str]]] = {name: [] for name in TABLES}
    with exact(load_scene()) as truth:
        for resolution_m in sorted(options.resolutions, reverse=True):
            compare(truth, resolution_m, rows)
    for name, (title, head) in TABLES.items():
        by_altitude = sorted(rows[name], key=lambda row: float(row[0].split()[0]))
        print(f"\n## {title}\n\n{table(['altitude', 'cells', *head], by_altitude)}", flush=True)


if __name__ == "__main__":
    main()
