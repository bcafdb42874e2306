"""What the tuner recovers of hidden weights, and how long it takes.

Run as ``python -m benchmarks.tuning DIR [--hidden N] [--detours 0.2] [--unit metre|step]``: DIR holds maps of Lower
Manhattan (docs/tuning.md: 10 m, 20 m altitude). A hidden W over distance, gps, population and risk is drawn from
Dirichlet(1) and raised to at least 0.05; 32 demonstrations are the cheapest routes under it, between random free
cells at least 300 m apart. W's distance weight is per metre (``metre``), or per step of one cell side, the unit in
which the other weights of the 'cell' model are (``step``).

``--cities`` fits over the three cities of `benchmarks.scenes` at once instead, over distance, gps, lidar and risk:
instances of `sample_instances` at two altitudes each, on maps of 20 m that are made and kept in DIR. A quarter of the
instances is held out, and the losses and the cities are compared (`compare_fits`).
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import ndimage

import jaxurban as ju
from benchmarks.common import load, machine
from benchmarks.scenes import PLACES, SYNTHETIC, Place, load_place
from jaxurban.maps.build import build_maps
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.planners.base import Cell
from jaxurban.planners.cost_model import CostModel
from jaxurban.report.markdown import framed
from jaxurban.studies.demonstrations import Demonstration, optimal_demonstrations
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.tuning.compared_fits import compare_fits
from jaxurban.studies.tuning.fenchel_young import LOSSES
from jaxurban.studies.tuning.fit_settings import FitSettings
from jaxurban.studies.tuning.weight_fit import fit_weights

METRICS = ("gps", "population", "risk")
NUM_DEMONSTRATIONS, NUM_UNSEEN, FLOOR = 32, 60, 0.05
CITY_METRICS, CITY_ALTITUDES_M, CITY_RESOLUTION_M = ("gps", "lidar", "risk"), (20.0, 60.0), 20.0
BAD = 0.02  # a detour that costs more than this share is one that a fit should find
ENDS = ("start", "goal")
LEAST_APART_M, LONGEST_DETOUR = 300.0, 1.6  # of the straight distance, by way of the detour's point


def main() -> None:
    """Print a row a hidden W, and the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cities", action="store_true")
    parser.add_argument("--instances", type=int, default=20, help="of each city, with --cities")
    parser.add_argument("--resolution", type=float, default=10.0)
    parser.add_argument("--altitude", type=float, default=20.0)
    parser.add_argument("--cost-model", choices=("cell", "line"), default="cell")
    parser.add_argument("--hidden", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--detours", type=float, default=0.0)
    parser.add_argument("--unit", choices=("metre", "step"), default="metre")
    options = parser.parse_args()
    if options.cities:
        compare_over_cities(options)
        return
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
    cosine = float(fit.spread @ spread / np.linalg.norm(spread))
    unseen = draw_queries(unit, rng, NUM_UNSEEN)
    costs = [RoutePool(unseen).cheapest(weights[None])[0, :, 0] @ hidden for weights in (hidden, fit.vector)]
    regret = float(np.mean(costs[1] / costs[0]) - 1)
    told = hidden / hidden.sum()
    inside = float(np.mean((fit.interval[0] <= told) & (told <= fit.interval[1])))
    print(
        f"| {', '.join(f'{value:.3f}' for value in told)} | {cosine:.6f} | {100 * regret:.4f} | {inside:.0%} "
        f"| {fit.elapsed_s:.1f} | {fit.num_plans} | {len(fit.curve)} |",
        flush=True,
    )
    return cosine, regret, inside, fit.elapsed_s


def compare_over_cities(options: argparse.Namespace) -> None:
    """Print the fits of each hidden W over the three cities, as Markdown."""
    maps = {place.name: maps_of(place, options.folder) for place in PLACES.values() if place.is_here}
    print(machine(), "load", load())
    print(
        f"{options.cost_model} model, {options.instances} instances a city at {CITY_ALTITUDES_M} m, "
        f"{options.detours:.0%} detours"
    )
    rows = []
    for number in range(options.first, options.first + options.hidden):
        rng, begin_s = np.random.default_rng(number), time.perf_counter()
        hidden = FLOOR + (1 - 4 * FLOOR) * rng.dirichlet(np.ones(4))
        unit = maps[SYNTHETIC.name]
        hidden[0] /= unit.grid.resolution_m if options.cost_model == "cell" else CostModel("line").reference_length_m
        pilot = ju.Weights(
            **{"population": 0.0, **dict(zip(("distance", *CITY_METRICS), hidden.tolist(), strict=True))}
        )
        cities, are_bad = {}, []
        for name, each in maps.items():
            shown = drawn_routes(each, pilot, number, options)
            bad = rng.choice(len(shown), round(options.detours * len(shown)), replace=False)
            costs = np.array([each.features @ hidden for each in shown])
            for k in bad:
                shown[k] = detour(shown[k], hidden, rng)
            cities[name] = shown
            are_bad += (np.array([each.features @ hidden for each in shown]) > costs * (1 + BAD)).tolist()
        found = compare_fits(cities, losses=tuple(LOSSES), pilot=pilot, bootstrap=50, settings=FitSettings(seed=number))
        rows.append(found.table.assign(number=number))
        told = ", ".join(f"{value:.3f}" for value in hidden / hidden.sum())
        said, bad = found.routes.is_bad.to_numpy(), np.array(are_bad)
        print(
            f"\nhidden W {number} (distance, gps, lidar, risk): {told}; {(said & bad).sum()} of {bad.sum()} detours of "
            f"more than {BAD:.0%} found, {(said & ~bad).sum()} of {(~bad).sum()} other routes taken for bad; "
            f"{time.perf_counter() - begin_s:.0f} s\n\n{framed(shown_table(found.table))}",
            flush=True,
        )
    by_fit = pd.concat(rows).groupby("fit", sort=False)
    print(f"\nover {options.hidden} hidden W:")
    for name, each in by_fit:
        print(f"{name}: least cosine {each.cosine.min():.6f}, largest regret {100 * each.pilot_regret.max():.2g} %")


def maps_of(place: Place, folder: Path) -> MetricMaps:
    """Return the maps of a city, made where the folder does not hold them yet."""
    kept = folder / place.name.split()[0].lower()
    if not kept.exists():
        build_maps(
            load_place(place).city,
            place.bounds,
            resolution_m=CITY_RESOLUTION_M,
            altitudes_m=CITY_ALTITUDES_M,
            orbits=place.orbits if place.orbits.exists() else "nominal",
            times=[place.time],
            progress=False,
        ).save(kept)
    return ju.open_maps(kept)


def drawn_routes(maps: MetricMaps, pilot: ju.Weights, seed: int, options: argparse.Namespace) -> list[Demonstration]:
    """Return the cheapest routes of sampled instances under the pilot's weights, at both altitudes."""
    instances = ju.sample_instances(maps, options.instances, weights=[pilot], cost_model=options.cost_model, seed=seed)
    units = {z: cost_map(maps, z, cost_model=options.cost_model).only(CITY_METRICS) for z in CITY_ALTITUDES_M}
    shown = []
    for row in instances[instances.is_connected].itertuples():
        unit = units[row.altitude_m]
        ends = [unit.locate(end, ju.XY(getattr(row, f"{end}_x_m"), getattr(row, f"{end}_y_m"))).cell for end in ENDS]
        shown += optimal_demonstrations([RouteQuery(unit, *ends, f"{row.instance}")], pilot)
    return shown


def shown_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return the columns that tell the fits apart, regrets in percent."""
    regrets = [name for name in table if "regret" in name or name == "worst"]
    shown = table.assign(**{name: 100 * table[name] for name in regrets})
    for name in ("cosine", "cosine_low", "cosine_high"):
        shown[name] = [f"{value:.6f}" for value in table[name]]
    kept = ["fit", "num_fitted", "num_bad", "cosine", "cosine_low", "cosine_high", *regrets]
    return shown[kept].rename(columns={name: f"{name}, %" for name in regrets})


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
