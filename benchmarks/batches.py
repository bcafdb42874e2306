"""CPU seconds a query of a batch under each bound, its making included. Run as ``python -m benchmarks.batches``."""

import time
import warnings

import numpy as np

import jaxurban as ju
from jaxurban.errors import GuessWarning

ALTITUDE_M = 20.0
BOUNDS = ("octile", "tiles", "landmarks", "auto")


def main(num_queries: int = 100, num_runs: int = 5) -> None:
    """Print the medians over runs in turn, the first of each left out: Lower Manhattan, 5 m cells, preset ``paper``."""
    warnings.simplefilter("ignore", GuessWarning)
    city = ju.sample_city("lower-manhattan", kinds=["building"])
    maps = ju.build_maps(city, resolution_m=5.0, altitudes_m=(ALTITUDE_M,), progress=False)
    free = np.argwhere(ju.cost_map(maps, ALTITUDE_M, preset="paper").is_free)
    cells = np.random.default_rng(0).choice(free, (num_queries, 2))
    pairs = [
        tuple(ju.XY(*map(float, maps.grid.xy_of_cell(*cell))) for cell in pair) for pair in cells
    ]
    cpu_s: dict[str, list[float]] = {bound: [] for bound in BOUNDS}
    for _ in range(1 + num_runs):
        for bound, seconds in cpu_s.items():
            began_s = time.process_time()
            paths = ju.plan_many(
                maps,
                pairs,
                altitude_m=ALTITUDE_M,
                preset="paper",
                planner="astar-plus",
                heuristic=bound,
                progress=False,
            )
            seconds.append((time.process_time() - began_s) / num_queries)
    for bound, seconds in cpu_s.items():
        print(f"{bound}: {np.median(seconds[1:]):.4f} CPU s a query")
    print(f"auto took: {paths.facts['heuristics']}")


if __name__ == "__main__":
    main()
