"""Queries through the altitude stack: expansions, time and cost, by levels and heuristic.

Run as ``python -m benchmarks.volume DIR [--queries N] [--fine DIR2]``: DIR holds maps (docs/volume.md: Lower Manhattan,
5 m, 20, 60, 122 and 600 m); DIR2 maps of 20, 60 and 122 m and of altitudes between them, to see what
interpolating between maps is worth.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import jaxurban as ju
from benchmarks.common import load, machine
from jaxurban.levels import read_stack
from jaxurban.volume import WeightedVolume, weigh_volume

HEURISTICS = ("octile", "plus")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--queries", type=int, default=50)
    parser.add_argument("--fine", type=Path)
    options = parser.parse_args()
    print(machine(), "load", load())
    maps = ju.open_maps(options.folder)
    print("| levels | cost model | made in, s | heuristic | expansions | median s | 95 % s | expansions/s |")
    print("|---|---|---|---|---|---|---|---|")
    for levels in ({}, {"max_altitude_m": 122.0, "level_step_m": 10.0}):
        for cost_model in ("cell", "line"):
            begin_s = time.perf_counter()
            volume = weigh_volume(maps, cost_model=cost_model, **levels)
            made_s = time.perf_counter() - begin_s
            print(
                *speed(volume, f"{len(volume.problem.levels_m)} | {cost_model} | {made_s:.2f}", options.queries),
                sep="\n",
            )
    if options.fine is not None:
        print(*interpolation(ju.open_maps(options.fine)), sep="\n")


def speed(volume: WeightedVolume, label: str, num_queries: int) -> list[str]:
    """Return a row for each heuristic over random queries at the lowest level; they must agree on every cost."""
    rng = np.random.default_rng(0)
    grid, free = volume.flat.grid, np.argwhere(volume.problem.is_free[0])
    queries = [[grid.xy_of_cell(*free[k]) for k in rng.choice(len(free), 2)] for _ in range(num_queries)]
    rows, costs = [], []
    for heuristic in HEURISTICS:
        found = [volume.plan(start_xy_m=s, goal_xy_m=g, heuristic=heuristic).search for s, g in queries]
        expanded, elapsed_s = (
            np.array([getattr(path, name) for path in found]) for name in ("num_expanded", "elapsed_s")
        )
        costs.append([path.cost for path in found])
        np.testing.assert_allclose(costs[0], costs[-1], rtol=1e-9)
        rows.append(
            f"| {label} | {heuristic} | {np.median(expanded):,.0f} | {np.median(elapsed_s):.3f} | "
            f"{np.quantile(elapsed_s, 0.95):.3f} | {expanded.sum() / elapsed_s.sum():,.0f} |"
        )
    return rows


def interpolation(maps: ju.MetricMaps) -> list[str]:
    """Return the error of each metric between 20, 60 and 122 m, over free cells, against maps made there."""
    rows = ["| altitude | metric | mean error | bias | mean error over roofs |", "|---|---|---|---|---|"]
    held = [20.0, 60.0, 122.0]
    coarse = ju.MetricMaps(maps.ds.sel(altitude=held))
    for z_m in (z_m for z_m in maps.altitudes_m if z_m not in held and z_m < held[-1]):
        free = maps.is_free(z_m, "centre")
        low_m = max(held_m for held_m in held if held_m < z_m)
        over_roofs = free & ~maps.is_free(low_m, "centre")
        stack = read_stack(coarse, ("gps", "lidar", "risk"), np.array([z_m]), time=None, time_of_day=None)
        for name in stack.m:
            error = stack.metric(name, z_m) - maps.m(name, z_m)
            rows.append(
                f"| {z_m:g} m | {name} | {np.abs(error[free]).mean():.3f} | {error[free].mean():+.3f} | "
                f"{np.abs(error[over_roofs]).mean():.3f} |"
            )
    return rows


if __name__ == "__main__":
    main()
