"""What BIT* pays for costing its edges in bulk with JAX instead of one by one with Numba.

``python -m benchmarks.bitstar_backends``: a synthetic city of 800 x 800 cells at 5 m, line model; equal samples
and seeds, so that both backends search the same graphs. Prints a Markdown table. Compiling is left out.
"""

import argparse
import math
import time

import jax
import numpy as np

from benchmarks.bitstar_ompl import far_apart
from benchmarks.printed_heuristic import made_up_problem
from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.segment_cost import CostGrid, segment_cost
from jaxurban.planners.bitstar.bulk import BULK, BulkCosts
from jaxurban.planners.bitstar.planner import BitStarOptions, bitstar_plus
from jaxurban.planners.cost_grid import cost_grid_of


@compiled()
def cost_each(cost_grid, start, end, costs):
    """Cost edges one by one, as the compiled search does."""
    for k in range(len(costs)):
        costs[k] = segment_cost(cost_grid, start[k, 0], start[k, 1], end[k, 0], end[k, 1], np.inf)


def edge_seconds(cost_grid: CostGrid, length: float, num_runs: int) -> tuple[float, float]:
    """Return the median seconds an edge of about ``length`` cell sides takes, by Numba and by JAX."""
    rng = np.random.default_rng(0)
    size = np.array(cost_grid.cell_cost.shape[::-1])
    start = rng.uniform(0, size, (BULK, 2))
    turn = rng.uniform(0, 2 * np.pi, BULK)
    end = np.clip(start + length * np.stack([np.cos(turn), np.sin(turn)], axis=1), 1e-6, size - 1e-6)
    costs, in_bulk = np.empty(BULK), BulkCosts(cost_grid)
    cost_each(cost_grid, start, end, costs)
    np.testing.assert_allclose(in_bulk(start, end), costs, rtol=1e-12)
    seconds: dict[str, list[float]] = {"numba": [], "jax": []}
    for _ in range(num_runs):
        for name, work in (
            ("numba", lambda: cost_each(cost_grid, start, end, costs)),
            ("jax", lambda: in_bulk(start, end)),
        ):
            begin_s = time.perf_counter()
            work()
            seconds[name].append((time.perf_counter() - begin_s) / BULK)
    return float(np.median(seconds["numba"])), float(np.median(seconds["jax"]))


def main() -> None:
    """Run the comparison that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--query", type=int, default=1, help="seed of start and goal")
    options = parser.parse_args()
    problem = far_apart(made_up_problem("line", 0, 800, 800), options.query)
    cost_grid = cost_grid_of(problem, problem.is_free)
    print(f"JAX on {jax.devices()[0].device_kind}\n")
    print("| work | Numba | JAX | JAX over Numba |\n|---|---|---|---|")
    for length in (5.0, 20.0, 80.0):
        numba_s, jax_s = edge_seconds(cost_grid, length, 20)
        print(
            f"| an edge of {length:g} cells, {BULK} in bulk | {1e6 * numba_s:.3f} us | {1e6 * jax_s:.3f} us "
            f"| {jax_s / numba_s:.1f} |"
        )
    elapsed_s: dict[str, list[float]] = {"numba": [], "jax": []}
    num_costed: dict[str, list[int]] = {"numba": [], "jax": []}
    for seed in range(options.seeds):
        for backend in ("numba", "jax"):
            how = {"max_samples": options.samples, "options": BitStarOptions(backend=backend)}
            path = bitstar_plus(problem, budget_s=math.inf, seed=seed, **how)
            elapsed_s[backend].append(path.elapsed_s)
            num_costed[backend].append(path.num_expanded)
    numba_s, jax_s = (float(np.median(seconds)) for seconds in elapsed_s.values())
    edges = " and ".join(f"{np.median(counts):.0f}" for counts in num_costed.values())
    work = f"a search of {options.samples} samples ({edges} edges)"
    print(f"| {work} | {numba_s:.2f} s | {jax_s:.2f} s | {jax_s / numba_s:.1f} |")


if __name__ == "__main__":
    main()
