"""BIT* here against OMPL's BITstar driven from Python: same map, cost, start, goal and heuristic.

``python -m benchmarks.bitstar_ompl`` needs the package ``ompl`` (2.x, BSD) beside jaxurban, and is left
out with a sentence where it is missing. ``--maps DIR`` takes a folder that ``jaxurban maps`` wrote; without
one, a synthetic city of 800 x 800 cells at 5 m. Prints a Markdown table.

OMPL costs its edges through callbacks into Python, here into the compiled function that our own search
uses. That call, not OMPL's C++, is most of its time: the times compare what a Python user gets, and say
nothing of OMPL's own speed. The comparison at an equal number of samples is free of it.
"""

import argparse
import importlib.util
import math
import sys

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, label
from tqdm import tqdm

from jaxurban.kernels.line.segment_cost import segment_cost
from jaxurban.maps.metric_maps import open_maps
from jaxurban.metrics.weights import Weights
from jaxurban.planners.any_angle import refine, theta_star
from jaxurban.planners.base import Path, Problem
from jaxurban.planners.bitstar.bounds import cost_grid_of
from jaxurban.planners.bitstar.planner import bitstar_dist, bitstar_plus


def problem_on(layers: np.ndarray, is_free: np.ndarray, resolution_m: float, distance_weight: float) -> Problem:
    """Return a problem on weighted layers ``[L, Y, X]``; start and goal are set by `far_apart`."""
    anywhere = tuple(int(v) for v in np.argwhere(is_free)[0])
    return Problem(layers, is_free, anywhere, anywhere, resolution_m, distance_weight, "line")


def problem_of_maps(folder: str, altitude_m: float) -> Problem:
    """Return a problem with the default weights on the maps of a folder; costs inside obstacles are kept."""
    maps, weights = open_maps(folder), Weights()
    costs = maps.costs(altitude_m)
    layers = np.stack([weights[name] * np.nan_to_num(np.asarray(c), nan=1.0) for name, c in costs.items()])
    return problem_on(layers, maps.is_free(altitude_m), maps.grid.resolution_m, weights.distance)


def synthetic_problem(seed: int, num_rows: int, num_cols: int) -> Problem:
    """Return a synthetic city: streets between blocks of buildings, three smooth layers and a risk layer."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:num_rows, :num_cols]
    is_street = (rows % 18 < 4) | (cols % 40 < 6)
    is_free = is_street | (rng.random((num_rows, num_cols)) < 0.3) | (gaussian_filter(rng.random(rows.shape), 20) > 0.5)
    risk = 1 - np.minimum(distance_transform_edt(is_free) * 5.0 / 50.0, 1.0)
    smooth = np.stack([gaussian_filter(rng.standard_normal(rows.shape), sigma) for sigma in (4, 8, 25)])
    smooth /= 2 * smooth.std(axis=(1, 2), keepdims=True)
    layers = np.concatenate([np.where(is_free, np.clip(smooth, 0, 1), 1.0), risk[None]])
    layers[2] *= 0.1  # population relative to its densest block
    return problem_on(layers, is_free, 5.0, 0.1)


def far_apart(problem: Problem, seed: int) -> Problem:
    """Return the problem between two cells that are joined and lie at least 0.7 of the map's side apart."""
    islands, _ = label(problem.is_free)
    cells = np.argwhere(islands == np.bincount(islands[problem.is_free]).argmax())
    rng = np.random.default_rng(seed)
    while True:
        start, goal = (tuple(int(v) for v in cells[k]) for k in rng.choice(len(cells), 2, replace=False))
        if math.dist(start, goal) > 0.7 * max(problem.is_free.shape):
            return problem.between(start, goal)


def solve_with_ompl(problem: Problem, budget_s: float, seed: int) -> tuple[float, int, int]:
    """Return the cost of OMPL's path, and how many samples it drew and edges it costed."""
    from ompl import base, geometric, util

    util.noOutputHandler()
    util.RNG.setSeed(seed + 1)
    cost_grid = cost_grid_of(problem, problem.is_free)
    num_rows, num_cols = problem.is_free.shape
    count = {"samples": 0, "edges": 0}

    def cost_between(_, a, b):
        count["edges"] += 1
        return base.Cost(segment_cost(cost_grid, a[0], a[1], b[0], b[1], math.inf))

    def bound_between(_, a, b):
        return base.Cost(cost_grid.per_side * math.hypot(a[0] - b[0], a[1] - b[1]))

    objective = type(
        "Cost",
        (base.OptimizationObjective,),
        {
            "stateCost": lambda *_: base.Cost(0.0),
            "motionCost": cost_between,
            "motionCostHeuristic": bound_between,
        },
    )
    # A blocked edge costs inf, so that each edge is walked once.
    no_check = type("NoCheck", (base.MotionValidator,), {"checkMotion": lambda *_: True})

    def is_valid(state) -> bool:
        is_free = bool(problem.is_free[min(int(state[1]), num_rows - 1), min(int(state[0]), num_cols - 1)])
        count["samples"] += is_free
        return is_free

    space = base.RealVectorStateSpace(2)
    box = base.RealVectorBounds(2)
    for axis, size in enumerate((num_cols, num_rows)):
        box.setLow(axis, 0.0)
        box.setHigh(axis, float(size) - 1e-6)
    space.setBounds(box)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(is_valid)
    information.setMotionValidator(no_check(information))
    information.setup()
    definition = base.ProblemDefinition(information)
    ends = [space.allocState(), space.allocState()]
    for state, (row, col) in zip(ends, (problem.start, problem.goal), strict=True):
        state[0], state[1] = col + 0.5, row + 0.5
    definition.setStartAndGoalStates(*ends)
    definition.setOptimizationObjective(objective(information))
    planner = geometric.BITstar(information)
    planner.setProblemDefinition(definition)
    planner.setup()
    planner.solve(base.timedPlannerTerminationCondition(budget_s))
    cost = math.inf
    if definition.hasExactSolution():
        states = definition.getSolutionPath().getStates()
        points_m = np.array([[state[0], state[1]] for state in states]) * problem.resolution_m
        cost = problem.cost_of(points_m)
    return cost, count["samples"], count["edges"]


def first_time(path: Path, cost: float) -> float:
    """Return when a path's history first meets a cost, seconds; inf for never."""
    return next((at_s for at_s, _, found in path.history if found <= cost * (1 + 1e-9)), math.inf)


def compare(problem: Problem, num_seeds: int, ompl_s: float, ours_s: float) -> str:
    """Return the comparison as Markdown; a run that found no path counts with a cost of inf."""
    progress = tqdm(total=3 * num_seeds, file=sys.stderr)
    theirs = []
    for seed in range(num_seeds):
        theirs.append(solve_with_ompl(problem, ompl_s, seed))
        progress.update()
    ompl_cost, num_samples, num_edges = np.array(theirs).T
    if not np.isfinite(ompl_cost).any():
        return f"OMPL BITstar found no path in {ompl_s:g} s with any of {num_seeds} seeds: nothing to compare with."
    target = float(np.median(ompl_cost[np.isfinite(ompl_cost)]))
    reference = refine(problem, theta_star(problem)).cost
    lines = [
        f"OMPL BITstar, {ompl_s:g} s, {num_seeds} seeds: a path in {np.isfinite(ompl_cost).sum()} runs, median cost of "
        f"these {target:.2f}, best {ompl_cost.min():.2f}; {np.median(num_samples):.0f} samples and "
        f"{np.median(num_edges):.0f} edges costed (medians).",
        f"Any-angle reference: {reference:.2f} (theta-star, refined).\n",
        "| planner | reaches OMPL's median cost after, median (worst) | reaches OMPL's best after "
        "| median cost at OMPL's numbers of samples, against OMPL's (paths found) | seconds for that "
        f"| above the reference after {ours_s:g} s, median (worst) |",
        "|---|---|---|---|---|---|",
    ]
    for planner in (bitstar_dist, bitstar_plus):
        equal, timed = [], []
        for seed in range(num_seeds):
            equal.append(planner(problem, budget_s=math.inf, max_samples=int(num_samples[seed]), seed=seed))
            timed.append(planner(problem, budget_s=ours_s, seed=seed))
            progress.update()
        at_s = [first_time(path, target) for path in timed]
        at_best_s = [first_time(path, ompl_cost.min()) for path in timed]
        equal_cost = np.array([path.cost for path in equal])
        above = np.array([path.cost / reference - 1 for path in timed])
        lines.append(
            f"| {timed[0].planner} | {np.median(at_s):.3f} s ({max(at_s):.3f} s) | {np.median(at_best_s):.3f} s "
            f"| {np.median(equal_cost) / np.median(ompl_cost) - 1:+.2%} ({np.isfinite(equal_cost).sum()}) "
            f"| {np.median([path.elapsed_s for path in equal]):.2f} s | {np.median(above):+.2%} ({above.max():+.2%}) |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the comparison that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", help="folder of maps; left out: a synthetic city")
    parser.add_argument("--altitude", type=float, default=20.0, help="metres")
    parser.add_argument("--size", type=int, default=800, help="side of the synthetic city, cells")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--ompl-budget", type=float, default=30.0, help="seconds")
    parser.add_argument("--budget", type=float, default=10.0, help="seconds for ours")
    parser.add_argument("--query", type=int, default=1, help="seed of start and goal")
    options = parser.parse_args()
    if importlib.util.find_spec("ompl") is None:
        print("left out: the package ompl is not installed beside jaxurban (pip install ompl)")
        return
    if options.maps is None:
        problem = synthetic_problem(0, options.size, options.size)
    else:
        problem = problem_of_maps(options.maps, options.altitude)
    problem = far_apart(problem, options.query)
    print(f"{' x '.join(map(str, problem.is_free.shape))} cells, from {problem.start} to {problem.goal}\n")
    print(compare(problem, options.seeds, options.ompl_budget, options.budget))


if __name__ == "__main__":
    main()
