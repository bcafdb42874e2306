"""Plans a second of each backend on the same random queries, and how far their costs differ.

``python -m benchmarks.plan_many MAPS --altitude 20`` takes a folder that ``jaxurban maps`` wrote; without one,
the synthetic city in the size of Lower Manhattan is used. Where JAX has a GPU, a batch of 256 queries on a city of
2000 x 4000 cells follows, in JAX there and in Numba on the processors; where not, a line says so. Prints Markdown
tables. Each row runs in one go, its compilation and the first look at the map left out; the landmarks are in.
"""

import argparse
import time
from collections.abc import Sequence

import jax
import numpy as np
from scipy.ndimage import label

import jaxurban as ju
from benchmarks.common import load, machine
from jaxurban.planners.base import Problem
from jaxurban.planners.batch import solve_many

CITY_M, RESOLUTION_M = (10_000.0, 20_000.0), 5.0
GPU_QUERIES = 256
Rows = list[tuple[str, dict]]

BACKENDS: Rows = [
    ("Numba, octile, 1 thread", {"backend": "numba", "heuristic": "octile", "num_threads": 1}),
    ("Numba, octile", {"backend": "numba", "heuristic": "octile"}),
    ("Numba, its own choice", {"backend": "numba"}),
    ("JAX, frontier", {"backend": "jax"}),
]
TO_ONE_GOAL: Rows = [
    ("Numba, octile, one goal", {"backend": "numba", "heuristic": "octile"}),
    ("Numba, cost-to-go, one goal", {"backend": "numba"}),
    ("JAX, cost-to-go, one goal", {"backend": "jax"}),
]


def random_queries(problem: Problem, num_queries: int, seed: int) -> list[Problem]:
    """Return queries between cells of the largest part of the map that hangs together."""
    parts, _ = label(problem.is_free)
    cells = np.argwhere(parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]))
    pairs = np.random.default_rng(seed).choice(len(cells), (num_queries, 2))
    return [problem.between(*(tuple(int(v) for v in cells[k]) for k in pair)) for pair in pairs]


def measure(maps: ju.MetricMaps, altitude_m: float, rows: Rows, queries: Sequence[Problem]) -> list[str]:
    """Return table lines: each row's plans a second, and its largest relative difference of cost from the first's."""
    lines = ["| backend | heuristic | queries | seconds | plans a second | CPU s a plan | differs by at most |"]
    lines.append("|---|---|---|---|---|---|---|")
    reference = np.empty(0)
    for name, options in rows:
        for warm in (True, False):
            # A fresh map each time: landmarks and fields of the row before must not help this one.
            fresh = ju.cost_map(maps, altitude_m).problem
            asked = [fresh.between(query.start, query.goal) for query in (queries[:40] if warm else queries)]
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            found = dict(solve_many(asked, **options))
            wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
        costs = np.array([found[k].cost for k in range(len(asked))])
        reference = costs if not reference.size else reference
        gap = np.max(np.abs(costs - reference) / np.maximum(reference, 1e-300))
        heuristics = ", ".join(sorted({path.heuristic for path in found.values()}))
        lines.append(
            f"| {name} | {heuristics} | {len(asked)} | {wall_s:.1f} | {len(asked) / wall_s:.1f} "
            f"| {cpu_s / len(asked):.4f} | {gap:.1e} |"
        )
    return lines


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", nargs="?", help="folder of maps; left out: the synthetic city")
    parser.add_argument("--resolution", type=float, help="metres, where the folder holds several")
    parser.add_argument("--altitude", type=float, default=20.0, help="metres")
    parser.add_argument("--queries", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    maps = (
        ju.build_maps(ju.demo_city(3_400, 3_400), resolution_m=RESOLUTION_M, altitudes_m=(options.altitude,))
        if options.maps is None
        else ju.open_maps(options.maps, options.resolution)
    )
    problem = ju.cost_map(maps, options.altitude).problem
    queries = random_queries(problem, options.queries, options.seed)
    print(f"{' x '.join(map(str, problem.is_free.shape))} cells, {options.altitude:g} m, seed {options.seed}\n")
    print("\n".join(measure(maps, options.altitude, BACKENDS, queries)))
    to_one = [query.between(query.start, queries[0].goal) for query in queries]
    print("\n" + "\n".join(measure(maps, options.altitude, TO_ONE_GOAL, to_one)))
    if jax.default_backend() == "cpu":
        print("\nJAX sees no GPU: the batch of 256 on 2000 x 4000 cells was not measured.")
    else:
        city = ju.build_maps(ju.demo_city(*CITY_M), resolution_m=RESOLUTION_M, altitudes_m=(20.0,))
        queries = random_queries(ju.cost_map(city, 20.0).problem, GPU_QUERIES, options.seed)
        print(f"\n{' x '.join(map(str, city.grid.shape))} cells\n")
        print("\n".join(measure(city, 20.0, [BACKENDS[3], BACKENDS[1], BACKENDS[2]], queries)))
    print(f"\n{machine()}\nload {load()}")


if __name__ == "__main__":
    main()
