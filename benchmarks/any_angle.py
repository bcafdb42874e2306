"""Any-angle planning against the grid, under the line cost model: Theta*, and refinement of any path.

``python -m benchmarks.any_angle --maps DIR`` takes a folder that ``jaxurban maps`` wrote; without one, a
synthetic city of 400 x 400 cells at 5 m. Prints Markdown. Every path is weighed by the same exact function.

The reference is the cheapest of everything found for a query, Theta* on cells three times finer with
refinement among it: no proven optimum, but the best known.
"""

import argparse
import sys
from collections.abc import Callable
from functools import partial

import numpy as np
from tqdm import tqdm

from benchmarks.printed_heuristic import made_up_problem, problem_of_arrays, problem_of_maps, random_pairs
from jaxurban.planners.any_angle import theta_star
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.bitstar.planner import bitstar_plus
from jaxurban.planners.cost_model import CostModel
from jaxurban.planners.refine import refine


def refined(planner: Callable[[Problem], Path], problem: Problem, **options) -> Path:
    """Return a planner's path after refinement."""
    return refine(problem, planner(problem), **options)


PLANNERS: dict[str, Callable[[Problem], Path]] = {
    "`astar-plus`": partial(astar, heuristic="plus"),
    "`astar-plus`, refined": partial(refined, partial(astar, heuristic="plus")),
    "`theta-star`": theta_star,
    "`theta-star`, shortcuts only": partial(refined, theta_star, moves=()),
    "`theta-star`, refined by gradient only": partial(refined, theta_star, moves=("gradient",)),
    "`theta-star`, refined by compass only": partial(refined, theta_star, moves=("compass",)),
    "`theta-star`, refined": partial(refined, theta_star),
}


def on_finer_cells(problem: Problem, factor: int = 3) -> Path:
    """Return Theta*'s path on cells ``factor`` times finer, odd, refined on the problem's own; weighed there."""
    start, goal = (tuple(factor * v + factor // 2 for v in cell) for cell in (problem.start, problem.goal))
    fine = Problem(
        np.kron(problem.cost, np.ones((factor, factor)))[None],
        np.kron(problem.is_free, np.ones((factor, factor), bool)),
        start,
        goal,
        problem.resolution_m / factor,
        problem.distance_weight,
        CostModel("line", problem.cost_model.reference_length_m),
    )
    return refine(problem, theta_star(fine))


def length_m(path: Path) -> float:
    return float(np.hypot(*np.diff(path.points_m, axis=0).T).sum())


def compare(problem: Problem, num_queries: int, bitstar_s: float) -> str:
    """Return the table over random queries."""
    planners = dict(PLANNERS)
    if bitstar_s > 0:
        planners[f"`bitstar-plus`, {bitstar_s:g} s"] = partial(bitstar_plus, budget_s=bitstar_s)
    figures: dict[str, list] = {name: [] for name in planners}
    best, bounds = [], []
    pairs = random_pairs(problem, num_queries, 0)
    for name in planners:
        planners[name](problem.between(*pairs[0]))  # what is compiled is compiled before the clock runs
    for start, goal in tqdm(pairs, file=sys.stderr):
        query = problem.between(start, goal)
        paths = {name: planner(query) for name, planner in planners.items()}
        for name, path in paths.items():
            assert path.cost == query.cost_of(path.points_m)
            figures[name].append((path.cost, length_m(path), path.elapsed_s, len(path.points_m)))
        best.append(min(on_finer_cells(query).cost, *(path.cost for path in paths.values())))
        bounds.append(paths["`theta-star`"].lower_bound)
    grid = np.array(figures["`astar-plus`"])
    above = grid[:, 0] / best - 1
    lines = [
        f"{' x '.join(map(str, problem.is_free.shape))} cells at {problem.resolution_m:g} m, {num_queries} random "
        f"queries, mean length of the grid path {grid[:, 1].mean():.0f} m. Grid paths cost {above.mean():.2%} more "
        f"than the reference on average, {above.max():.2%} at most; the lower bound of every curve is "
        f"{np.mean(np.array(bounds) / best):.0%} of the reference.\n",
        "| planner | cost against the grid path, mean (least, largest gain) | length against the grid path "
        "| above the reference, mean (worst) | seconds, median (worst) | points |",
        "|---|---|---|---|---|---|",
    ]
    for name, values in figures.items():
        cost, length, seconds, points = np.array(values).T
        gain, excess = cost / grid[:, 0] - 1, cost / best - 1
        lines.append(
            f"| {name} | {gain.mean():+.2%} ({gain.max():+.2%}, {gain.min():+.2%}) "
            f"| {np.mean(length / grid[:, 1] - 1):+.2%} | {excess.mean():.2%} ({excess.max():.2%}) "
            f"| {np.median(seconds):.3f} ({seconds.max():.3f}) | {points.mean():.0f} |"
        )
    return "\n".join(lines)


def on_an_empty_map(num_queries: int) -> str:
    """Return how much longer than the straight line paths on an empty map are."""
    problem = problem_of_arrays(np.zeros((1, 400, 400)), np.ones((400, 400), bool), 5.0, 0.1, "line")
    excess: dict[str, list[float]] = {"`astar-plus`": [], "`theta-star`": []}
    for start, goal in random_pairs(problem, num_queries, 0):
        query = problem.between(start, goal)
        straight_m = problem.resolution_m * np.hypot(*np.subtract(start, goal))
        for name, lengths in excess.items():
            path = PLANNERS[name](query)
            lengths.append(length_m(path) / straight_m - 1)
            assert name != "`theta-star`" or path.status is Status.OPTIMAL
    return f"On an empty map of 400 x 400 cells, {num_queries} queries, paths are longer than the straight line by " + (
        "; ".join(f"{name} {np.mean(v):.2%} on average, {max(v):.2%} at most" for name, v in excess.items()) + "."
    )


def main() -> None:
    """Run the comparison that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", help="folder of maps; left out: a synthetic city")
    parser.add_argument("--altitude", type=float, default=20.0, help="metres")
    parser.add_argument("--queries", type=int, default=50)
    parser.add_argument(
        "--bitstar", type=float, default=0.0, help="seconds for BIT* beside the others; 0 leaves it out"
    )
    options = parser.parse_args()
    if options.maps is None:
        problem = made_up_problem("line", 0, 400, 400)
    else:
        problem = problem_of_maps(options.maps, None, options.altitude, None, "line")
    print(on_an_empty_map(options.queries), end="\n\n")
    print(compare(problem, options.queries, options.bitstar))


if __name__ == "__main__":
    main()
