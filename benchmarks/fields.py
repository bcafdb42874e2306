"""What fields take by each backend: CPU seconds of Numba's Dijkstra and JAX's active tiles, rounds and relaxations.

``python -m benchmarks.fields``: a synthetic city of streets and blocks, goals far apart; costs are compared, too.
Prints a Markdown table. Compiling is left out; runs are taken in turn, and the median counts.
"""

import argparse

import jax
import numpy as np

from benchmarks.common import Side, Timing, clocked, in_turn, load, machine
from benchmarks.printed_heuristic import made_up_problem
from jaxurban.planners.base import Problem
from jaxurban.planners.landmarks import landmark_cells
from jaxurban.planners.search.fields import FieldRun, symmetric_costs


def measure(problem: Problem, num_goals: int, num_runs: int) -> str:
    """Return a line of the table."""
    queries = [problem.between(cell, cell) for cell in landmark_cells(problem, num_goals)]
    found: dict[str, list[np.ndarray]] = {}
    run = FieldRun(queries)  # compiles
    found["jax"] = run.costs()
    num_rounds, num_visits = int(run.fields.num_rounds), int(np.sum(run.fields.num_visits))
    relaxations = num_visits * run.work.num_passes * run.work.tile**2 / (num_goals * problem.is_free.size)

    def side(backend: str) -> Side:
        def work() -> None:
            found[backend] = list(symmetric_costs(queries, backend))

        return clocked(work)

    timings: dict[str, Timing] = in_turn({name: side(name) for name in ("numba", "jax")}, num_runs)
    of_numba, of_jax = (np.stack(found[name]) for name in ("numba", "jax"))
    np.testing.assert_array_equal(np.isfinite(of_jax), np.isfinite(of_numba))
    known = np.isfinite(of_numba)
    gap = np.max(np.abs(of_jax[known] - of_numba[known]) / np.maximum(of_numba[known], 1e-300))
    numba_s, jax_s = (timings[name] for name in ("numba", "jax"))
    return (
        f"| {' x '.join(map(str, problem.is_free.shape))} | {num_goals} | {numba_s.median_cpu_s:.3f} "
        f"| {jax_s.median_cpu_s:.3f} | {jax_s.median_cpu_s / numba_s.median_cpu_s:.1f} | {numba_s.median_s:.3f} "
        f"| {jax_s.median_s:.3f} | {num_rounds} | {relaxations:.0f} | {gap:.1e} |"
    )


def main() -> None:
    """Run the sizes and numbers of goals that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[512, 1024], help="cells along a side")
    parser.add_argument("--goals", type=int, nargs="+", default=[1, 4, 16])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--cost-model", choices=["cell", "line"], default="cell")
    options = parser.parse_args()
    print(f"JAX on {jax.devices()[0].device_kind}, cost model {options.cost_model}\n")
    print(
        "| cells | goals | CPU s, Numba | CPU s, JAX | JAX over Numba | wall s, Numba | wall s, JAX | rounds "
        "| relaxations a cell and goal | differ by at most |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for size in options.sizes:
        problem = made_up_problem(options.cost_model, 0, size, size)
        for num_goals in options.goals:
            print(measure(problem, num_goals, options.runs), flush=True)
    print(f"\n{machine()}\nload {load()}")


if __name__ == "__main__":
    main()
