"""BIT* whose graphs are searched in bulk by JAX, against Numba's search in order of lower bounds, and OMPL's.

``python -m benchmarks.bitstar_backends``: a synthetic city, line model. One query with equal samples and seeds: costs,
edges costed and seconds; OMPL's costs at as many samples, where the package ``ompl`` is installed. Then many queries at
once: how many a second. Prints Markdown tables. Compiling is left out.
"""

import argparse
import importlib.util
import math
import time

import jax
import numpy as np

from benchmarks.bitstar_ompl import far_apart, solve_with_ompl
from benchmarks.printed_heuristic import made_up_problem, random_pairs
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.bitstar.batched import solve_batched
from jaxurban.planners.bitstar.batches import BitStarOptions
from jaxurban.planners.bitstar.planner import bitstar_plus

BACKENDS = ("numba", "jax")


def told(paths: list[Path]) -> str:
    """Return the medians of cost, edges costed and seconds as cells of a table."""
    cost, num_costed, elapsed_s = (
        float(np.median([getattr(path, name) for path in paths])) for name in ("cost", "num_expanded", "elapsed_s")
    )
    return f"{cost:.3f} | {num_costed:.0f} | {elapsed_s:.3f} s"


def one_query(problem: Problem, num_samples: list[int], num_seeds: int, ompl_s: float) -> str:
    """Return the table of one query at equal samples."""
    lines = [
        "| samples | backend | cost, median | edges costed | seconds | against Numba's cost, median (worst) |",
        "|---|---|---|---|---|---|",
    ]
    has_ompl = importlib.util.find_spec("ompl") is not None
    by_ompl = [solve_with_ompl(problem, ompl_s, seed) for seed in range(num_seeds)] if has_ompl else []
    if by_ompl:
        num_samples = [*num_samples, int(np.median([found[1] for found in by_ompl]))]
    for num in num_samples:
        paths: dict[str, list[Path]] = {}
        for backend in BACKENDS:
            options = BitStarOptions(backend=backend)
            paths[backend] = [
                bitstar_plus(problem, budget_s=math.inf, max_samples=num, seed=seed, options=options)
                for seed in range(num_seeds)
            ]
        for backend in BACKENDS:
            pairs = zip(paths[backend], paths["numba"], strict=True)
            above = np.array([path.cost / other.cost - 1 for path, other in pairs])
            lines.append(
                f"| {num} | {backend} | {told(paths[backend])} | {np.median(above):+.2%} ({above.max():+.2%}) |"
            )
    if by_ompl:
        cost, _, num_edges = np.median(by_ompl, axis=0)
        lines.append(f"| {num_samples[-1]} | OMPL, {ompl_s:g} s | {cost:.3f} | {num_edges:.0f} | | |")
    else:
        lines.append("\nOMPL was left out: the package is not installed beside jaxurban (pip install ompl).")
    return "\n".join(lines)


def many_queries(problem: Problem, num_queries: int, num_samples: int) -> str:
    """Return the table of many queries at once."""
    problems = [problem.between(*pair) for pair in random_pairs(problem, num_queries, 0)]
    run = {
        "numba": lambda: [bitstar_plus(p, budget_s=math.inf, max_samples=num_samples) for p in problems],
        "jax": lambda: [
            path
            for _, path in sorted(
                solve_batched(
                    problems,
                    planner="bitstar-plus",
                    heuristic="plus",
                    seeds=[0] * num_queries,
                    max_samples=num_samples,
                )
            )
        ],
    }
    lines = [
        "| backend | paths | queries a second | CPU seconds a query | edges costed a query |",
        "|---|---|---|---|---|",
    ]
    found = {}
    for backend, work in run.items():
        work()  # compiles
        begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
        found[backend] = paths = work()
        wall_s, cpu_s = time.perf_counter() - begin_s, time.process_time() - begin_cpu_s
        num_found = sum(path.status.has_path for path in paths)
        lines.append(
            f"| {backend} | {num_found} of {num_queries} | {num_queries / wall_s:.1f} "
            f"| {cpu_s / num_queries:.4f} | {np.mean([path.num_expanded for path in paths]):.0f} |"
        )
    costs = np.array([[path.cost for path in found[backend]] for backend in BACKENDS])
    above = costs[1, np.isfinite(costs).all(axis=0)] / costs[0, np.isfinite(costs).all(axis=0)] - 1
    spread = f"{np.median(above):+.3%} (least {above.min():+.2%}, most {above.max():+.2%})"
    return "\n".join([*lines, f"\nCosts in bulk against Numba's where both found a path, median: {spread}."])


def main() -> None:
    """Run the comparison that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=400, help="side of the city, cells")
    parser.add_argument("--samples", type=int, nargs="+", default=[1000, 4000])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--query", type=int, default=1, help="seed of start and goal")
    parser.add_argument("--queries", type=int, default=64, help="at once")
    parser.add_argument("--samples-each", type=int, default=1000, help="of many queries")
    parser.add_argument("--ompl-budget", type=float, default=10.0, help="seconds")
    options = parser.parse_args()
    problem = made_up_problem("line", 0, options.size, options.size)
    print(f"JAX on {jax.devices()[0].device_kind}; {options.size} x {options.size} cells\n")
    print(one_query(far_apart(problem, options.query), options.samples, options.seeds, options.ompl_budget))
    print(f"\n{options.queries} random queries at once, {options.samples_each} samples each:\n")
    print(many_queries(problem, options.queries, options.samples_each))


if __name__ == "__main__":
    main()
