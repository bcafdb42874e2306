"""Hold the gradient of the planned cost against finite differences of replanned costs: the envelope theorem at work.

Random queries on Lower Manhattan's soft maps (10 m cells, 20 m up, softness 2 m, float64), each under weights of its
own. The gradient of A*'s cost is that of its path's cost, made from the path's cells alone. The finite difference makes
the whole maps again at both sides of a parameter, and plans again on each. Where they differ, the two new paths tell
why.

Run: ``python -m benchmarks.envelope [--queries 100] [--cost-model cell] [--step-scale 1] [-o FILE.json]``; with steps
100 times as long routes switch in between, and the differences are no derivatives any more. ``--jitter-m 0.05`` moves
all roofs by up to so much at random: heights of whole decimetres tie, and where two roofs tie the soft maps have kinks.
"""

import argparse
import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pandas as pd
from scipy import ndimage

from benchmarks.common import machine
from benchmarks.scenes import BOUNDS, CRS, DATA, ORBITS, OSM, REFERENCE, TIME
from jaxurban.errors import InputError
from jaxurban.maps.build import soften, view_sky
from jaxurban.maps.differentiable import SoftCity, SoftParams, path_visits
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.population import PopulationParams
from jaxurban.metrics.risk import RiskParams
from jaxurban.metrics.weights import Weights
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.world.city import City
from jaxurban.world.grid import Grid

ALTITUDE_M, SOFTNESS_M, RESOLUTION_M = 20.0, 2.0, 10.0
THRESHOLD_M = 47.0  # at 50 m many cells of 10 m lie just on the threshold, where risk has a kink
COMMERCIAL = (101, 102)  # so that both gammas matter: all districts of the region are commercial in the paper
NORM_PER_KM2 = 200_000.0  # by the maximum, the gamma of the densest block's kind would cancel
NUM_BUILDINGS = 10
AGREES = 1e-3  # relative
NOTHING = 1e-7  # derivatives below are rounding of the finite differences: cost 1e3 x 1e-16 / step
NUM_DIRECTIONS = 3  # random ones, in which all buildings of the city grow or shrink at once
STEPS = {"weight": 1e-5, "gamma": 1e-4, "d_thresh": 1e-3, "height": 1e-3, "all heights": 1e-5}


def lower_manhattan() -> tuple[SoftCity, SoftParams, Grid, np.ndarray]:
    """Return the soft city, its parameters, the region and where is free."""
    if not OSM.exists():
        raise InputError(f"real data not found at {DATA}: set JAXURBAN_DATA")
    census = DATA / "census"
    city = City.from_files(
        OSM,
        bounds=BOUNDS,
        crs=CRS,
        blocks=census / "tl_2010_36061_tabblock10.shp",
        table=census / "DECENNIALSF12010.P1_nyc_blocks.csv",
        districts=DATA / "districts" / "nyc_community_districts.geojson",
        commercial=COMMERCIAL,
    )
    region = Grid.from_bounds(BOUNDS, RESOLUTION_M, CRS)
    sky = view_sky(region, ORBITS, [TIME], mask_deg=5.0, reference=REFERENCE, max_age_days=90)
    people = PopulationParams(normalise=NORM_PER_KM2)
    maps = MapParams(altitudes_m=(ALTITUDE_M,), risk=RiskParams(THRESHOLD_M), population=people)
    soft = soften(MapTask(city, region, sky, maps), dtype=np.float64)
    params = SoftParams(ALTITUDE_M, SOFTNESS_M, risk=maps.risk, population=people)
    is_free = np.asarray(soft.surface.crop(soft.surface.roof_m)) < ALTITUDE_M
    reach_m = dict(soft.reach_m) | {"risk": THRESHOLD_M + 1}
    return replace(soft, reach_m=tuple(reach_m.items())), params, region, is_free


class Study:
    """Queries on one map, planned again and again. ``Q`` queries, ``L`` layers."""

    def __init__(self, num: int, is_free: np.ndarray, num_layers: int, cost_model: str, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        number, _ = ndimage.label(is_free)
        cells = np.argwhere(number == np.bincount(number[number > 0]).argmax())
        self.ends: list[tuple[tuple[int, int], tuple[int, int]]] = []
        while len(self.ends) < num:
            start, goal = (tuple(map(int, cell)) for cell in cells[rng.integers(len(cells), size=2)])
            if np.hypot(start[0] - goal[0], start[1] - goal[1]) > 30:
                self.ends.append((start, goal))
        self.weights = 0.05 + 0.75 * rng.dirichlet(np.ones(1 + num_layers), size=num)  # [Q, 1 + L]
        self.weights[:, 0] /= RESOLUTION_M  # by metre, the others by step
        self.base = Problem(
            np.zeros((num_layers, *is_free.shape)), is_free, *self.ends[0], RESOLUTION_M, 0.0, cost_model
        )

    def plan(self, layers: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the optimal cost ``[Q]`` and the path of each query."""

        def one(query: int):
            w = weights[query]
            problem = self.base.with_costs(layers, w).between(*self.ends[query])
            found = astar(problem)
            return found.cost, found.points_m

        with ThreadPoolExecutor(os.cpu_count()) as threads:
            costs, paths = zip(*threads.map(one, range(len(self.ends))), strict=True)
        return np.array(costs), list(paths)


def compare(study: Study, soft: SoftCity, params: SoftParams, region: Grid, scale: float) -> pd.DataFrame:
    """Return a line for each query and parameter: gradient, finite difference, and whether the route switches."""
    make = jax.jit(lambda soft, height_m, params: soft.layers(height_m, params))
    layers = np.asarray(make(soft, soft.height_m, params))
    here, paths = study.plan(layers, study.weights)

    @jax.jit
    def slopes(soft, weights, visits):
        return jax.grad(soft.path_cost, (0, 1, 2))(soft.height_m, params, weights, visits)

    by_height, by_params, by_weight = [], [], []
    for points, w in zip(paths, study.weights, strict=True):
        visits = path_visits(points, region.shape, RESOLUTION_M, study.base.cost_model)
        weights = Weights(**dict(zip(("distance", *soft.names), map(float, w), strict=True)))
        found = slopes(soft, weights, visits)
        by_height.append(np.asarray(found[0]))
        by_params.append(found[1])
        by_weight.append([float(getattr(found[2], name)) for name in ("distance", *soft.names)])
    heights = np.array(by_height)
    # Those that matter to most routes; among equals those that matter most.
    chosen = np.lexsort((-np.abs(heights).sum(axis=0), -(np.abs(heights) > NOTHING).sum(axis=0)))[:NUM_BUILDINGS]
    tables = []

    def add(kind: str, name: str, gradient, sides) -> None:
        """Plan at both sides; ``sides(step)`` gives layers and weights."""
        step = scale * STEPS[kind]
        (above, upper), (below, lower) = (study.plan(*sides(sign * step)) for sign in (1, -1))
        tables.append(
            pd.DataFrame(
                {
                    "kind": kind,
                    "parameter": name,
                    "query": range(len(study.ends)),
                    "gradient": gradient,
                    "difference": (above - below) / (2 * step),
                    "right": (above - here) / step,
                    "left": (here - below) / step,
                    "switches": [not np.array_equal(a, b) for a, b in zip(upper, lower, strict=True)],
                }
            )
        )

    for k, name in enumerate(("distance", *soft.names)):
        unit = np.eye(study.weights.shape[1])[k]
        add("weight", name, np.array(by_weight)[:, k], lambda step, unit=unit: (layers, study.weights + step * unit))
    for name in ("gamma_commercial", "gamma_residential"):
        gradient = [float(getattr(found.population, name)) for found in by_params]

        def sides(step, name=name):
            moved = replace(params.population, **{name: getattr(params.population, name) + step})
            return np.asarray(make(soft, soft.height_m, replace(params, population=moved))), study.weights

        add("gamma", name, gradient, sides)

    def thresholds(step):
        moved = replace(params, risk=RiskParams(THRESHOLD_M + step))
        return np.asarray(make(soft, soft.height_m, moved)), study.weights

    add("d_thresh", "d_thresh", [float(found.risk.threshold_m) for found in by_params], thresholds)
    for building in chosen:

        def taller(step, building=building):
            return np.asarray(make(soft, soft.height_m.at[building].add(step), params)), study.weights

        add("height", f"building {building}", heights[:, building], taller)
    rng = np.random.default_rng(1)
    for number in range(NUM_DIRECTIONS):
        along = rng.normal(size=heights.shape[1])

        def moved_heights(step, along=along):
            return np.asarray(make(soft, soft.height_m + step * along, params)), study.weights

        add("all heights", f"direction {number}", heights @ along, moved_heights)
    return pd.concat(tables, ignore_index=True)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return how many agree, by kind of parameter: of all, and of those whose derivative is not nothing."""
    size = np.maximum(np.abs(table.gradient), np.abs(table.difference))
    table = table.assign(
        matters=size > NOTHING, agrees=np.abs(table.gradient - table.difference) <= np.maximum(AGREES * size, NOTHING)
    )
    error = np.abs(table.gradient - table.difference)
    is_kink = np.abs(table.right - table.left) >= error  # the slopes on both sides differ by as much
    table["off_by_switch"] = ~table.agrees & table.switches
    table["off_by_kink"] = ~table.agrees & ~table.switches & is_kink
    table["off_else"] = ~table.agrees & ~table.switches & ~is_kink
    groups = {kind: table[table.kind == kind] for kind in STEPS} | {"all": table}
    return pd.DataFrame(
        {
            kind: {
                "pairs": len(rows),
                "not_zero": int(rows.matters.sum()),
                "agree_%": 100 * rows.agrees.mean(),
                "agree_of_not_zero_%": 100 * rows.agrees[rows.matters].mean(),
                "off_by_switch": int(rows.off_by_switch.sum()),
                "off_by_kink": int(rows.off_by_kink.sum()),
                "off_else": int(rows.off_else.sum()),
                "switches": int(rows.switches.sum()),
            }
            for kind, rows in groups.items()
        }
    ).T


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--queries", type=int, default=100)
    parser.add_argument("--cost-model", choices=("cell", "line"), default="cell")
    parser.add_argument("--step-scale", type=float, default=1.0)
    parser.add_argument("--jitter-m", type=float, default=0.0)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    with jax.enable_x64(True):
        soft, params, region, is_free = lower_manhattan()
        jitter_m = np.random.default_rng(2).uniform(-options.jitter_m, options.jitter_m, soft.height_m.shape)
        soft = replace(soft, height_m=soft.height_m + jitter_m)
        study = Study(options.queries, is_free, len(soft.names), options.cost_model)
        table = compare(study, soft, params, region, options.step_scale)
    found = summary(table)
    print(found.to_string(float_format="{:.2f}".format))
    if options.output:
        report = {"machine": machine(), "summary": found.to_dict("index"), "rows": table.to_dict("list")}
        options.output.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
