"""The GPS floor against the maps: heights around it, altitudes, tiles, a device's path, and routes that stay above it.

``python -m benchmarks.gps_floor`` prints a line for each city: Lower Manhattan, Bilbao over terrain (left out where its
rasters are missing) and Shinjuku under GPS and Galileo, of a clock each. Every line but those of seconds and of routes
counts what is wrong, which is to be 0.
"""

import math
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import jaxurban as ju
from benchmarks.scenes import DATA
from jaxurban.io import store
from jaxurban.kernels.shadows.sweep import words_along_lines
from jaxurban.maps.at_once import skies_of
from jaxurban.maps.build import compute_maps, region_of, view_sky
from jaxurban.maps.params import PAPER_ALTITUDES_M, MapParams
from jaxurban.maps.run import RunContext, make_zarr
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Gps, maps_of_words
from jaxurban.metrics.gps_floor import GpsFloor
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.profile import cut_on
from jaxurban.progress import Report

NUM_PAIRS, NUM_VOLUMES, NUM_RUNS = 100, 20, 5
AROUND_M = np.array(
    [-0.01, 0.01, 1.0, 10.0, 50.0, 200.0]
)  # heights above the floor; the first is bad
ALTITUDES_M = (20.0, 60.0, 122.0)
FLOWN_M = 60.0


def bilbao() -> ju.City:
    return ju.City.from_files(
        ju.Buildings(DATA / "raster" / "bilbao_building_heights.tif"),
        bounds=(-2.992, 43.308, -2.982, 43.314),
        crs="EPSG:25830",
        terrain=ju.Terrain(DATA / "raster" / "bilbao_dem.tif"),
    )


CITIES: dict[str, tuple[Callable[[], ju.City], float]] = {
    "Lower Manhattan": (lambda: ju.sample_city("lower-manhattan"), 5.0),
    "Bilbao, terrain": (bilbao, 2.5),
    "Shinjuku, GPS and Galileo": (lambda: ju.sample_city("shinjuku"), 5.0),
}


def task_of(city: ju.City, resolution_m: float, has_floor: bool = True, **params) -> MapTask:
    region = region_of(city, None, resolution_m)
    gps = city.gps or Gps()
    sections = {"gps": gps} | ({"gps_floor": GpsFloor()} if has_floor else {})
    return MapTask(city, region, view_sky(region, gps), MapParams(sections=sections, **params))


def wrong_around(task: MapTask, maps: ju.MetricMaps) -> tuple[int, int]:
    """Return at how many of how many heights around the floor GDOP, as the maps make it, is not what the floor says.

    Every cell whose floor is above its roof is looked at, at heights of its own: the kernels of `all_maps` take them.
    """
    floor_m, roof_m = maps.m("gps_floor"), maps.m("roof")
    surface = task.surface()
    rows, cols = surface.window
    ground_m = np.float32(0) if surface.terrain_m is None else surface.crop(surface.terrain_m)
    sky = jax.tree.map(lambda values: values[0], skies_of(task, surface))
    words = words_along_lines(
        surface.of_hiding().top_m,
        ground_m + (np.nan_to_num(floor_m) + AROUND_M[:, None, None]).astype(np.float32),
        sky.lines,
        sky.num,
        window=(rows.start, rows.stop, cols.start, cols.stop),
    )
    is_good = np.asarray(maps_of_words(words, sky.satellites, np.float32(20.0)).gdop) <= 6
    is_looked_at = np.isfinite(floor_m) & (floor_m > roof_m + 0.02)
    is_wrong = is_good != (AROUND_M > 0)[:, None, None]
    return int(is_wrong[:, is_looked_at].sum()), int(is_looked_at.sum()) * len(AROUND_M)


def wrong_at_altitudes(maps: ju.MetricMaps) -> tuple[int, int]:
    """Return at how many of the free cells of all altitudes GDOP is not what the floor says."""
    num_wrong = num_free = 0
    for z_m in maps.altitudes_m:
        is_free = maps.is_free(z_m, "centre")
        is_good = maps.m("gdop", z_m) <= 6
        num_wrong += int((is_good != (maps.m("gps_floor") <= z_m))[is_free].sum())
        num_free += int(is_free.sum())
    return num_wrong, num_free


def routes(maps: ju.MetricMaps) -> None:
    """Print what staying above the floor costs, and the metres below it, by the floor and by the maps' GDOP."""
    limits = Constraints(above_gps_floor=True)
    rng = np.random.default_rng(1)
    for what, altitude_m, num in (
        (f"{FLOWN_M:g} m", FLOWN_M, NUM_PAIRS),
        ("between levels", ju.Levels(), NUM_VOLUMES),
    ):
        free, kept = (
            ju.cost_map(maps, altitude_m, objective="distance", constraints=each)
            for each in (None, limits)
        )
        islands = kept.free_space.islands.reshape(-1, *maps.grid.shape)[-1]
        largest = np.bincount(islands[islands > 0]).argmax()
        cells = np.argwhere(islands == largest)
        longer, below_m, bad_m, before_m = [], 0.0, 0.0, 0.0
        for _ in range(num):
            ends = [
                tuple(map(float, maps.grid.lonlat_of_cell(*cell)))
                for cell in rng.choice(cells, 2, replace=False)
            ]
            if what != f"{FLOWN_M:g} m":
                ends = [(*end, max(maps.altitudes_m)) for end in ends]
            route, plain = kept.plan(*ends, budget_s=120.0), free.plan(*ends, budget_s=120.0)
            below_m += ju.explain(route, maps).totals["below_gps_floor_m"]
            before_m += ju.explain(plain, maps).totals["below_gps_floor_m"]
            _, parts = cut_on(route, maps)
            for z_m in maps.altitudes_m:
                is_here = (parts.z_m == z_m).all(axis=1)
                gdop = maps.m("gdop", z_m)[tuple(parts.cell.T)]
                bad_m += float(parts.length_m[is_here & ~(gdop <= 6)].sum())
            longer.append(route.length_m / plain.length_m - 1)
        print(
            f"  routes, {what}: {num} pairs, longer by {np.mean(longer):.2%} in the mean, {np.median(longer):.2%} in "
            f"the median, {max(longer):.1%} at most, {np.mean(np.array(longer) > 1e-9):.0%} of them at all; below the "
            f"floor {below_m:.0f} m with the rule, by the maps' GDOP {bad_m:.0f} m, {before_m:,.0f} m without"
        )


def tiled(task: MapTask) -> np.ndarray:
    """Return the floor of a region made by three by three tiles, which hand shadows on to each other."""
    known = replace(task, guesses=task.all_guesses)
    shape = tuple(side // 3 + 1 for side in task.region.shape)
    with tempfile.TemporaryDirectory() as folder:
        make_zarr(RunContext(known, Path(folder), "key", 2), Report(), shape)
        return ju.MetricMaps(store.open_zarr(Path(folder), None).load()).m("gps_floor")


def seconds(city: ju.City, resolution_m: float) -> None:
    """Print the CPU seconds of maps of four altitudes without and with the floor, medians of one run."""
    taken: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(NUM_RUNS + 1):
        for has_floor, times in taken.items():
            began_s = time.process_time()
            ju.build_maps(
                city,
                resolution_m=resolution_m,
                altitudes_m=PAPER_ALTITUDES_M,
                progress=False,
                gps_floor=GpsFloor() if has_floor else None,
            )
            times.append(time.process_time() - began_s)
    without_s, with_s = (statistics.median(times[1:]) for times in taken.values())
    print(f"  CPU seconds of four altitudes: {without_s:.2f} without, {with_s:.2f} with the floor")


def main() -> None:
    warnings.simplefilter("ignore")
    for name, (read, resolution_m) in CITIES.items():
        if "Bilbao" in name and not DATA.exists():
            print(f"{name}: left out, as {DATA} is missing")
            continue
        city = read()
        task = task_of(city, resolution_m, altitudes_m=ALTITUDES_M)
        maps = compute_maps(task)
        whole_m = maps.m("gps_floor")
        in_view = task.in_view(0)
        clocks = 1 if in_view.clocks is None else in_view.clocks.num
        print(
            f"{name}: {whole_m.size:,} cells of {resolution_m:g} m, {len(in_view.numbers)} satellites, {clocks} "
            f"clocks, {np.mean(whole_m <= 60):.0%} good from 60 m, median {np.nanmedian(whole_m):.1f} m"
        )
        print("  around the floor, wrong: {:,} of {:,}".format(*wrong_around(task, maps)))
        print(
            "  at 20, 60, 122 m, wrong: {:,} of {:,} free cells".format(*wrong_at_altitudes(maps))
        )

        others = {
            "at once": compute_maps(task, device_bytes=math.inf).m("gps_floor"),
            "by tiles": tiled(task),
        }
        for what, found_m in others.items():
            num_other = int((found_m != whole_m).sum())
            print(f"  {what}, other bits: {num_other:,} of {whole_m.size:,} cells")
        routes(maps)
        seconds(city, resolution_m)


if __name__ == "__main__":
    main()
