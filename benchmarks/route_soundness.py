"""How much of planned routes lies inside true outlines, and what caution costs; writes docs/route_soundness.md.

Run as ``python -m benchmarks.route_soundness``. Random routes by every planner, as it is and refined, and through the
volume, under both rules of obstacles; Shapely judges them by the outlines themselves, not by cells. What caution costs:
how much longer and costlier routes become, and which share of places is no longer joined.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.ndimage import label
from tqdm import tqdm

from benchmarks.common import ROOT, load, machine
from benchmarks.scenes import ALTITUDES_M, PLACES, Scene, load_place
from jaxurban.io.read.rasterise import rasterise
from jaxurban.maps.build import compute_maps
from jaxurban.maps.levels import Levels
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.paths.snapping import XY
from jaxurban.planners.base import Cell, Status
from jaxurban.planners.refine import refine
from jaxurban.planners.registry import PLANNERS, find_planner
from jaxurban.world.city import Buildings

RULES = ("touched", "centre")
RESOLUTION_M, ALTITUDE_M = 5.0, 20.0
MASK_RESOLUTIONS_M, MASK_ALTITUDES_M = (2.0, 5.0, 10.0, 20.0), (20.0, 60.0)
TOUCH_M = 1e-5  # outlines are drawn in by this much, so that a route along a wall is not inside it
STEP_M = 0.25  # between the points whose depth is measured
VOLUME = "volume"
BUDGET_S = {"bitstar-dist": 0.25, "bitstar-plus": 0.25}  # the others end by themselves
REFINE_S = 0.3


class Outlines:
    """Exact outlines of a city, for measuring what routes cut."""

    def __init__(self, buildings: Buildings) -> None:
        drawn_in = shapely.buffer(buildings.polygons, -TOUCH_M, join_style="mitre")
        is_left = ~shapely.is_empty(drawn_in)
        self.polygons, self.height_m = drawn_in[is_left], buildings.height_m[is_left]

    @cache  # noqa: B019 (lives as long as its process)
    def _from(self, z_m: float) -> shapely.STRtree:
        return shapely.STRtree(self.polygons[self.height_m >= z_m])

    def cut(self, xyz_m: np.ndarray) -> tuple[float, float]:
        """Return the length of a route ``[N, 3]`` inside outlines, and how deep it gets into them, metres.

        A segment that climbs is taken at its lower end, so an outline that it climbs over within a step counts.
        """
        inside_m = depth_m = 0.0
        low_m = np.minimum(xyz_m[:-1, 2], xyz_m[1:, 2])
        for z_m in np.unique(low_m):
            of_level = low_m == z_m
            route = shapely.multilinestrings(np.stack([xyz_m[:-1, :2], xyz_m[1:, :2]], axis=1)[of_level])
            tree = self._from(float(z_m))
            hit = tree.geometries[tree.query(route, predicate="intersects")]
            if hit.size:
                pieces = shapely.union_all(shapely.intersection(hit, route))
                walls = shapely.boundary(shapely.union_all(hit))
                places = shapely.points(shapely.get_coordinates(shapely.segmentize(pieces, STEP_M)))
                inside_m += pieces.length
                depth_m = max(depth_m, shapely.distance(places, walls).max(initial=0.0))
        return inside_m, depth_m


@dataclass(frozen=True)
class Route:
    """What one planner made of one pair under one rule."""

    rule: str
    planner: str
    status: str
    length_m: float
    cost: float
    inside_m: float
    depth_m: float


@dataclass(frozen=True, eq=False)
class Bench:
    """What a worker process plans on, by rule, and judges by."""

    flat: dict[str, CostMap]
    volume: dict[str, CostMap]
    outlines: Outlines

    def routes(self, number: int, start: Cell, goal: Cell, rules: tuple[str, ...]) -> list[Route]:
        """Return the routes of every planner between two cells under each rule."""
        found = []
        for rule in rules:
            flat, volume = self.flat[rule], self.volume[rule]
            problem = flat.problem.between(start, goal)
            for name in PLANNERS:
                path = find_planner(name)(problem, budget_s=BUDGET_S.get(name, np.inf), seed=number)
                for label_, kept in ((name, path), (f"{name}, refined", refine(problem, path, budget_s=REFINE_S))):
                    xy_m = kept.points_m + np.array([flat.grid.x_min_m, flat.grid.y_min_m])
                    xyz_m = np.column_stack([xy_m, np.full(len(xy_m), ALTITUDE_M)])
                    found.append(self._judged(rule, label_, kept.status, kept.cost, xyz_m))
            planned = volume.plan(*(XY(*flat.grid.xy_of_cell(*cell), ALTITUDE_M) for cell in (start, goal)))
            xyz_m = np.column_stack([planned.xy_m, planned.z_m])
            found.append(self._judged(rule, VOLUME, planned.status, planned.search.cost, xyz_m))
        return found

    def _judged(self, rule: str, planner: str, status: Status, cost: float, xyz_m: np.ndarray) -> Route:
        if not status.has_path:
            return Route(rule, planner, status.value, np.inf, np.inf, 0.0, 0.0)
        length_m = float(np.linalg.norm(np.diff(xyz_m, axis=0), axis=1).sum())
        return Route(rule, planner, status.value, length_m, float(cost), *self.outlines.cut(xyz_m))


_bench: Bench


def _begin(maps: MetricMaps, buildings: Buildings) -> None:
    """Make a worker process ready."""
    global _bench
    by_rule = {rule: maps.with_obstacles(rule) for rule in RULES}
    nothing_kept = Constraints(vertical_clearance_m=0.0)  # the rule of obstacles alone is tried
    flat = {rule: cost_map(held, ALTITUDE_M, constraints=nothing_kept) for rule, held in by_rule.items()}
    volume = {rule: cost_map(held, Levels(), constraints=nothing_kept) for rule, held in by_rule.items()}
    _bench = Bench(flat, volume, Outlines(buildings))


def _plan(task: tuple[int, Cell, Cell, tuple[str, ...]]) -> list[Route]:
    return _bench.routes(*task)


def fly(scene: Scene, num_pairs: dict[str, int]) -> list[Route]:
    """Return the routes between random cells that are free and joined under the cautious rule, by every core."""
    maps = compute_maps(scene.task(RESOLUTION_M))
    is_free = maps.is_free(ALTITUDE_M)
    islands, _ = label(is_free)
    cells = np.argwhere(is_free & (islands == np.argmax(np.bincount(islands[is_free]))))
    rng = np.random.default_rng(0)
    pairs = cells[rng.choice(len(cells), (max(num_pairs.values()), 2))]
    tasks = [
        (number, tuple(start), tuple(goal), tuple(rule for rule in RULES if number < num_pairs[rule]))
        for number, (start, goal) in enumerate(pairs.tolist())
    ]
    with ProcessPoolExecutor(
        os.cpu_count(), multiprocessing.get_context("spawn"), _begin, (maps, scene.city.buildings)
    ) as pool:
        done = tqdm(pool.map(_plan, tasks), total=len(tasks), file=sys.stderr, desc=scene.name, mininterval=10)
        return [route for routes in done for route in routes]


def by_planner(routes: list[Route]) -> dict[str, dict[str, dict[str, float]]]:
    """Return figures by rule and planner: of the paths found, the share that cuts outlines, how long and how deep."""
    figures: dict[str, dict[str, dict[str, float]]] = {}
    for rule in RULES:
        for planner in dict.fromkeys(route.planner for route in routes):
            paths = [r for r in routes if (r.rule, r.planner) == (rule, planner) and np.isfinite(r.length_m)]
            inside_m = np.array([path.inside_m for path in paths])
            cuts = inside_m[inside_m > 0]
            figures.setdefault(rule, {})[planner] = {
                "paths": len(paths),
                "share_cutting": len(cuts) / max(1, len(paths)),
                "mean_inside_of_those_m": float(cuts.mean()) if len(cuts) else 0.0,
                "most_inside_m": float(inside_m.max(initial=0.0)),
                "deepest_m": max((path.depth_m for path in paths), default=0.0),
            }
    return figures


def price(routes: list[Route]) -> dict[str, dict[str, float]]:
    """Return how much longer and costlier a planner's paths are under ``touched`` than under ``centre``, percent."""
    prices = {}
    for planner in ("astar-plus", "theta-star", VOLUME):
        kept = {rule: [r for r in routes if (r.rule, r.planner) == (rule, planner)] for rule in RULES}
        more = {
            name: 100
            * np.array(
                [
                    getattr(cautious, name) / getattr(bold, name) - 1
                    for cautious, bold in zip(kept["touched"], kept["centre"], strict=False)
                    if np.isfinite(cautious.length_m) and bold.length_m > 0
                ]
            )
            for name in ("length_m", "cost")
        }
        prices[planner] = {
            f"{name.removesuffix('_m')}_{kind}": float(value)
            for name, ratios in more.items()
            for kind, value in (("mean", ratios.mean()), ("95", np.quantile(ratios, 0.95)), ("most", ratios.max()))
        }
    return prices


def lost(scene: Scene) -> list[dict[str, float]]:
    """Return, by altitude and resolution, what caution closes and cuts apart.

    The share of pairs joined is exact: of cells that are free under both rules, by the sizes of the islands that they
    lie in (a path on the grid passes between cells that share a side).
    """
    rows = []
    rasters = {resolution_m: rasterise(scene.city, scene.region(resolution_m)) for resolution_m in MASK_RESOLUTIONS_M}
    for altitude_m in MASK_ALTITUDES_M:
        for resolution_m, (roof_m, roof_touched_m, *_) in rasters.items():
            is_free = {"centre": roof_m < altitude_m, "touched": roof_touched_m < altitude_m}
            joined = {}
            for rule, free in is_free.items():
                sizes = np.bincount(label(free)[0][is_free["touched"]]).astype(float)
                joined[rule] = float(np.sum((sizes / sizes.sum()) ** 2))
            closed = 1 - is_free["touched"].sum() / is_free["centre"].sum()
            rows.append(
                {"altitude_m": altitude_m, "resolution_m": resolution_m, "closed": float(closed)}
                | {f"joined_{rule}": share for rule, share in joined.items()}
            )
    return rows


def document(report: dict[str, Any]) -> str:
    """Return docs/route_soundness.md."""
    cities = report["cities"]
    commit = report["machine"]["commit"]
    about = f"""\
# Routes and true outlines

Every planner keeps clear of each cell that shares area with a roof that reaches its altitude (`[planning] obstacles =
"touched"`). The paper closes a cell where a roof covers its centre (`"centre"`), and routes then cut true outlines.
Here Shapely judges routes by the outlines themselves: random pairs of cells of the largest island that is free under
`touched`, {RESOLUTION_M:g} m cells, {ALTITUDE_M:g} m up, cost model `line`, default weights;
{BUDGET_S["bitstar-plus"]:g} s a route for BIT\\*, {REFINE_S:g} s for refinement, levels of
{", ".join(f"{z:g}" for z in ALTITUDES_M)} m for the volume. A route along a wall (within 0.01 mm) is not inside it.
Made by `python -m benchmarks.route_soundness` at commit {commit}; the cities are those of
[errors by city](error_by_city.md).
<!-- measured code: planners jaxurban/paths -->

## Inside outlines
"""
    parts = [about]
    for rule in RULES:
        head = [f"{name}, {city['num_pairs'][rule]} pairs" for name, city in cities.items()]
        rows = []
        for planner in next(iter(cities.values()))["by_planner"][rule]:
            figures = [city["by_planner"][rule][planner] for city in cities.values()]
            cells = [
                f"{f['paths']}: {f['share_cutting']:.0%}, {f['mean_inside_of_those_m']:.1f} m, "
                f"{f['most_inside_m']:.1f} m, {f['deepest_m']:.1f} m"
                for f in figures
            ]
            rows.append([f"`{planner}`", *cells])
        parts.append(
            f"Under `{rule}`: paths found, share of them that cuts an outline, mean length inside of those, the most "
            "inside,\nthe deepest.\n\n" + table(["planner", *head], rows)
        )
    rows = []
    for name, city in cities.items():
        for planner, p in city["price"].items():
            more = [f"{p[f'{n}_mean']:.2f} % ({p[f'{n}_95']:.1f}; {p[f'{n}_most']:.1f})" for n in ("length", "cost")]
            rows.append([name, f"`{planner}`", *more])
    parts.append(
        "## What caution costs\n\n"
        "Paths under `touched` against those of the same pairs under `centre`: mean (95 % within; the most).\n\n"
        + table(["city", "planner", "longer by", "costlier by"], rows)
    )
    rows = []
    for of_cities in zip(*(city["lost"] for city in cities.values()), strict=True):
        figures = [f"{r['joined_centre']:.3f}, {r['joined_touched']:.3f} ({r['closed']:.0%})" for r in of_cities]
        rows.append([f"{of_cities[0]['altitude_m']:g} m", f"{of_cities[0]['resolution_m']:g} m", *figures])
    parts.append(
        "Share of the pairs of cells, free under both rules, that free cells join, under `centre` and under\n"
        "`touched` (exact, by the sizes of islands); *closed*: free cells of `centre` that `touched` closes. Where\n"
        "caution cuts a city apart, plan on finer cells, fly higher, or name `centre`: a `no-path` says which of these"
        "\nwould join start and goal.\n\n"
        + table(["altitude", "cells", *(f"{name}: centre, touched (closed)" for name in cities)], rows)
    )
    return "\n".join(parts)


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *rows))


def main() -> None:
    """Fly, judge, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "route_soundness.md")
    parser.add_argument("--json", type=Path, default=ROOT / "out" / "route_soundness.json")
    parser.add_argument("--pairs", type=int, default=300, help="that every planner joins under the cautious rule")
    parser.add_argument("--centre-pairs", type=int, default=100, help="of these, under the paper's rule too")
    parser.add_argument("--cities", nargs="+", choices=PLACES, default=list(PLACES))
    options = parser.parse_args()
    report: dict[str, Any] = {"machine": machine(), "load": load(), "cities": {}}
    for place in (PLACES[name] for name in options.cities):
        if not place.is_here:
            print(f"{place.name}: no data at {place.buildings}, left out", file=sys.stderr)
            continue
        begin_s = time.perf_counter()
        scene = load_place(place)
        num_pairs = {"touched": options.pairs, "centre": min(options.pairs, options.centre_pairs)}
        routes = fly(scene, num_pairs)
        report["cities"][place.name] = {
            "num_pairs": num_pairs,
            "by_planner": by_planner(routes),
            "price": price(routes),
            "lost": lost(scene),
            "elapsed_s": time.perf_counter() - begin_s,
            "routes": [asdict(route) for route in routes],
        }
        text = document(report)  # as far as it goes, so that an interrupted run is not lost
        options.output.write_text(text)
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(report) + "\n")
    print(text)


if __name__ == "__main__":
    main()
