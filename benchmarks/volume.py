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
    for levels in (ju.Levels(), ju.Levels(max_altitude_m=122.0, level_step_m=10.0)):
        for cost_model in ("cell", "line"):
            begin_s = time.perf_counter()
            volume = ju.cost_map(maps, levels, cost_model=cost_model)
            made_s = time.perf_counter() - begin_s
            print(
                *speed(volume, f"{len(volume.altitudes_m)} | {cost_model} | {made_s:.2f}", options.queries),
                sep="\n",
            )
    if options.fine is not None:
        print(*interpolation(ju.open_maps(options.fine)), sep="\n")


def speed(volume: ju.CostMap, label: str, num_queries: int) -> list[str]:
    """Return a row for each heuristic over random queries at the lowest level; they must agree on every cost."""
    rng = np.random.default_rng(0)
    grid, free = volume.grid, np.argwhere(volume.is_free[0])
    queries = [[ju.XY(*grid.xy_of_cell(*free[k])) for k in rng.choice(len(free), 2)] for _ in range(num_queries)]
    rows, costs = [], []
    for heuristic in HEURISTICS:
        found = [volume.plan(s, g, heuristic=heuristic).search for s, g in queries]
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
        between = ju.cost_map(coarse, ju.Levels(z_m, z_m, 1.0)).only(("gps", "lidar", "risk"))
        for name, costs in zip(between.names, between.costs, strict=True):
            error = 1 - costs[0] - maps.m(name, z_m)
            rows.append(
                f"| {z_m:g} m | {name} | {np.abs(error[free]).mean():.3f} | {error[free].mean():+.3f} | "
                f"{np.abs(error[over_roofs]).mean():.3f} |"
            )
    return rows


if __name__ == "__main__":
    main()
