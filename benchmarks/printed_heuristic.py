"""What the paper's h_plus costs: paths found with it against optimal ones, on random queries.

``python -m benchmarks.printed_heuristic MAPS --altitude 20`` takes a folder that ``jaxurban maps``
wrote; without one, a synthetic city of blocks and streets is used. Prints a Markdown table.
"""

import argparse
import sys

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter
from tqdm import tqdm

from jaxurban.maps.metric_maps import open_maps
from jaxurban.metrics.weights import Weights
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Cell, Problem, Status

VARIANTS = [(name, reopen) for name in ("plus-printed", "plus-printed-from-0") for reopen in (False, True)]
Results = dict[tuple[str, bool], tuple[np.ndarray, np.ndarray]]
LABELS = {"plus-printed": "i = 1..dx", "plus-printed-from-0": "i = 0..dx - 1"}


def problem_of_maps(folder: str, resolution_m, altitude_m: float, time_of_day, cost_model) -> Problem:
    """Return a problem with the default weights on the maps of a folder; costs inside obstacles are kept."""
    maps = open_maps(folder, resolution_m)
    weights = Weights()
    costs = maps.costs(altitude_m, time_of_day=time_of_day)
    layers = np.stack([weights[name] * np.nan_to_num(np.asarray(c), nan=1.0) for name, c in costs.items()])
    return problem_of_arrays(layers, maps.is_free(altitude_m), maps.grid.resolution_m, weights.distance, cost_model)


def problem_of_arrays(layers, is_free, resolution_m: float, distance_weight: float, cost_model) -> Problem:
    """Return a problem on weighted layers ``[L, Y, X]``; start and goal are set query by query."""
    anywhere = tuple(int(v) for v in np.argwhere(is_free)[0])
    return Problem(layers, is_free, anywhere, anywhere, resolution_m, distance_weight, cost_model)


def made_up_problem(cost_model, seed: int, num_rows: int = 240, num_cols: int = 200) -> Problem:
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
    return problem_of_arrays(layers, is_free, 5.0, 0.1, cost_model)


def random_pairs(problem: Problem, num_queries: int, seed: int) -> list[tuple[Cell, Cell]]:
    """Return start and goal cells that are joined by a path."""
    rng = np.random.default_rng(seed)
    free = np.argwhere(problem.is_free)
    pairs: list[tuple[Cell, Cell]] = []
    while len(pairs) < num_queries:
        start, goal = (tuple(int(v) for v in free[k]) for k in rng.choice(len(free), 2, replace=False))
        if astar(problem.between(start, goal)).status is Status.OPTIMAL:
            pairs.append((start, goal))
    return pairs


def compare(problem: Problem, pairs: list[tuple[Cell, Cell]], budget_s: float) -> Results:
    """Return, for each reading with and without reopening, ``[Q]`` excess cost and ``[Q]`` expansions over octile's.

    A search that outlasts the budget has an excess of inf: reopening can take exponentially long.
    """
    excess = {variant: np.zeros(len(pairs)) for variant in VARIANTS}
    expansions = {variant: np.zeros(len(pairs)) for variant in VARIANTS}
    for k, pair in enumerate(tqdm(pairs, desc="queries", file=sys.stderr)):
        query = problem.between(*pair)
        optimal = astar(query, heuristic="octile")
        for name, reopen in VARIANTS:
            path = astar(query, heuristic=name, reopen=reopen, budget_s=budget_s)
            excess[name, reopen][k] = path.cost / optimal.cost - 1
            expansions[name, reopen][k] = path.num_expanded / optimal.num_expanded
    return {variant: (excess[variant], expansions[variant]) for variant in VARIANTS}


def markdown_table(results: Results) -> str:
    """Return the results as a Markdown table."""
    lines = [
        "| index range | reopens | costlier than optimal | median excess | 95th percentile | maximum "
        "| expansions over octile's, median (mean) | unfinished |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for (name, reopen), (excess, expansions) in results.items():
        is_done = np.isfinite(excess)
        percentiles = " | ".join(f"{100 * abs(np.percentile(excess[is_done], q)):.2f} %" for q in (50, 95, 100))
        ratio = f"{np.median(expansions[is_done]):.2f} ({expansions[is_done].mean():.2f})"
        lines.append(
            f"| {LABELS[name]} | {'yes' if reopen else 'no'} | {100 * np.mean(excess[is_done] > 1e-9):.1f} % "
            f"| {percentiles} | {ratio} | {np.sum(~is_done)} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the study that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", nargs="?", help="folder of maps; left out: a synthetic city")
    parser.add_argument("--resolution", type=float, help="metres, where the folder holds several")
    parser.add_argument("--altitude", type=float, default=20.0, help="metres")
    parser.add_argument("--time-of-day", help="day or night")
    parser.add_argument("--cost-model", choices=["cell", "line"], default="cell")
    parser.add_argument("--queries", type=int, default=200)
    parser.add_argument("--budget", type=float, default=20.0, help="seconds for one search")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.maps is None:
        problem = made_up_problem(options.cost_model, options.seed)
    else:
        problem = problem_of_maps(
            options.maps, options.resolution, options.altitude, options.time_of_day, options.cost_model
        )
    size = " x ".join(map(str, problem.is_free.shape))
    pairs = random_pairs(problem, options.queries, options.seed)
    print(f"{size} cells, {len(pairs)} queries, seed {options.seed}, cost model {options.cost_model}\n")
    print(markdown_table(compare(problem, pairs, options.budget)))


if __name__ == "__main__":
    main()
