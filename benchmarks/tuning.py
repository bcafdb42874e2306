"""What the tuner recovers of hidden weights, and how long it takes.

Run as ``python -m benchmarks.tuning DIR [--hidden N] [--detours 0.2] [--unit metre|step]``: DIR holds maps of Lower
Manhattan (docs/tuning.md: 10 m, 20 m altitude). A hidden W over distance, gps, population and risk is drawn from
Dirichlet(1) and raised to at least 0.05; 32 demonstrations are the cheapest routes under it, between random free
cells at least 300 m apart. W's distance weight is per metre (``metre``), or per step of one cell side, the unit in
which the other weights of the 'cell' model are (``step``).
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

import jaxurban as ju
from benchmarks.common import load, machine
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.plan import cost_map
from jaxurban.planners.base import Cell
from jaxurban.studies.demonstrations import Demonstration, optimal_demonstrations
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import FitSettings, RoutePool
from jaxurban.studies.tuning.weight_fit import fit_weights

METRICS = ("gps", "population", "risk")
NUM_DEMONSTRATIONS, NUM_UNSEEN, FLOOR = 32, 60, 0.05
LEAST_APART_M, LONGEST_DETOUR = 300.0, 1.6  # of the straight distance, by way of the detour's point


def main() -> None:
    """Print a row a hidden W, and the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--resolution", type=float, default=10.0)
    parser.add_argument("--altitude", type=float, default=20.0)
    parser.add_argument("--cost-model", choices=("cell", "line"), default="cell")
    parser.add_argument("--hidden", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--detours", type=float, default=0.0)
    parser.add_argument("--unit", choices=("metre", "step"), default="metre")
    options = parser.parse_args()
    unit = cost_map(
        ju.open_maps(options.folder, options.resolution),
        options.altitude,
        cost_model=options.cost_model,
    ).only(METRICS)
    print(machine(), "load", load())
    print(f"{options.cost_model} model, distance weight per {options.unit}, {options.detours:.0%} detours")
    print("| hidden W (distance, gps, population, risk) | cosine | regret, % | in interval | s | searches | rounds |")
    print("|---|---|---|---|---|---|---|")
    rows = [run(unit, number, options) for number in range(options.first, options.first + options.hidden)]
    cosines, regrets, inside, seconds = np.array(rows).T
    print(
        f"median cosine {np.median(cosines):.6f}, worst {cosines.min():.6f}; mean regret median "
        f"{100 * np.median(regrets):.4f} %, worst {100 * regrets.max():.4f} %; {inside.mean():.0%} of hidden weights "
        f"in their 5 to 95 % intervals; median {np.median(seconds):.1f} s, worst {seconds.max():.1f} s"
    )


def run(unit: CostMap, number: int, options: argparse.Namespace) -> tuple[float, float, float, float]:
    """Print and return cosine, mean regret, share of weights inside their intervals, and seconds of one fit."""
    rng = np.random.default_rng(number)
    hidden = FLOOR + (1 - 4 * FLOOR) * rng.dirichlet(np.ones(4))
    if options.unit == "step":
        step_m = unit.grid.resolution_m if options.cost_model == "cell" else unit.cost_model.reference_length_m
        hidden[0] /= step_m
    demonstrations = optimal_demonstrations(draw_queries(unit, rng, NUM_DEMONSTRATIONS), weights_of(unit, hidden))
    for k in rng.choice(NUM_DEMONSTRATIONS, round(options.detours * NUM_DEMONSTRATIONS), replace=False):
        demonstrations[k] = detour(demonstrations[k], hidden, rng)
    fit = fit_weights(demonstrations, settings=FitSettings(seed=number))
    spread = hidden * np.array([each.features for each in demonstrations]).std(axis=0)
    cosine = float(fit.table["spread"] @ spread / np.linalg.norm(spread))
    unseen = draw_queries(unit, rng, NUM_UNSEEN)
    costs = [RoutePool(unseen).cheapest(weights[None])[0, :, 0] @ hidden for weights in (hidden, fit.vector)]
    regret = float(np.mean(costs[1] / costs[0]) - 1)
    told = hidden / hidden.sum()
    inside = float(np.mean((fit.table["low"] <= told) & (told <= fit.table["high"])))
    print(
        f"| {', '.join(f'{value:.3f}' for value in told)} | {cosine:.6f} | {100 * regret:.4f} | {inside:.0%} "
        f"| {fit.elapsed_s:.1f} | {fit.num_plans} | {len(fit.curve)} |",
        flush=True,
    )
    return cosine, regret, inside, fit.elapsed_s


def weights_of(unit: CostMap, vector: np.ndarray) -> ju.Weights:
    """Return a vector over distance and the map's metrics as weights, others 0."""
    none = ju.Weights(**dict.fromkeys(ju.Weights().to_dict(), 0.0))
    return replace(none, **dict(zip(("distance", *unit.names), vector.tolist(), strict=True)))


def draw_queries(unit: CostMap, rng: np.random.Generator, num: int) -> list[RouteQuery]:
    """Return queries between random cells of the largest connected free part."""
    free = free_cells(unit)
    queries: list[RouteQuery] = []
    while len(queries) < num:
        start, goal = free[rng.integers(len(free), size=2)]
        if np.hypot(*(start - goal)) * unit.grid.resolution_m >= LEAST_APART_M:
            queries.append(RouteQuery(unit, (int(start[0]), int(start[1])), (int(goal[0]), int(goal[1]))))
    return queries


def detour(shown: Demonstration, hidden: np.ndarray, rng: np.random.Generator) -> Demonstration:
    """Return a demonstration that goes by way of a random cell, each leg the cheapest under the hidden weights."""
    query = shown.query
    free = free_cells(query.cost_map, query.start)
    by_way = sum(np.hypot(*(free - np.array(end)).T) for end in (query.start, query.goal))
    near = free[by_way <= LONGEST_DETOUR * np.hypot(*np.subtract(query.start, query.goal))]
    row, col = near[rng.integers(len(near))]
    via = (int(row), int(col))
    legs = [replace(query, goal=via).cheapest(hidden), replace(query, start=via).cheapest(hidden)]
    points_m = np.concatenate([legs[0], legs[1][1:]])
    return Demonstration(query, points_m)


def free_cells(unit: CostMap, within: Cell | None = None) -> np.ndarray:
    """Return ``[N, 2]`` row and column of the connected free part that holds a cell, or of the largest."""
    labels, _ = ndimage.label(unit.is_free)
    return np.argwhere(labels == (np.bincount(labels[labels > 0]).argmax() if within is None else labels[within]))


if __name__ == "__main__":
    main()
