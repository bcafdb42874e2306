"""Input that planners and their kernels refuse, each in a sentence that names it."""

from dataclasses import replace

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.planners.any_angle import theta_star
from jaxurban.planners.astar import astar, volume_astar
from jaxurban.planners.base import Problem
from jaxurban.planners.bitstar.planner import BitStarOptions, bitstar
from jaxurban.planners.bulk import solve_batched
from jaxurban.planners.cost import CostModel
from jaxurban.planners.refine import refine
from jaxurban.planners.registry import find_planner, solve_many
from jaxurban.planners.simplify import simplify_path

FREE = np.array([[True, True, True], [True, False, True]])
LAYERS = np.ones((2, 2, 3))
NEGATIVE_UNDER_POSITIVE = np.array([-np.ones((2, 3)), 2 * np.ones((2, 3))])
NO_COST = "costs must be finite and not negative on free cells"
NO_PATH = "a path must be"


def make(
    costs=LAYERS, is_free=FREE, start=(0, 0), goal=(0, 2), resolution_m=1.0, weights=1.0, **options
):
    return Problem(costs, is_free, start, goal, resolution_m, weights, **options)


def volume(**changed):
    layers, free = np.zeros((1, 2, 3, 3)), np.ones((2, 3, 3), bool)
    sound = {
        "costs": layers,
        "is_free": free,
        "levels_m": [1.0, 2.0],
        "start": (0, 0, 0),
        "goal": (0, 2, 2),
    }
    return make(**(sound | {"weights": [1.0, 1.0, 0.0, 0.0]} | changed))


def wall(start=(0, 0), goal=(0, 2), **options):
    return make(LAYERS[:1], start=start, goal=goal, **options)


def model(**settings):
    return CostModel.from_settings(settings)


def with_points(points_m):
    return replace(astar(wall()), points_m=np.array(points_m))


def bit_star(**options):
    return bitstar(wall(), budget_s=1.0, options=BitStarOptions(**options))


def batched(problem=None, **options):
    return list(
        solve_batched(
            [problem or wall()], planner="bitstar", heuristic="plus", max_samples=1, **options
        )
    )


REFUSED = {
    "NaN on free cells": (lambda: make(np.where(FREE, np.nan, 0)[None]), NO_COST),
    "a negative layer under a positive one": (lambda: make(NEGATIVE_UNDER_POSITIVE), NO_COST),
    "an endless cost": (lambda: make(np.full((1, 2, 3), np.inf)), NO_COST),
    "a start off the map": (lambda: make(start=(0, 3)), "outside the map"),
    "a goal off the map": (lambda: make(goal=(-1, 0)), "outside the map"),
    "a goal in an obstacle": (lambda: make(goal=(1, 1)), "inside an obstacle"),
    "another goal in an obstacle": (lambda: make().between((0, 0), (1, 1)), "inside an obstacle"),
    "no resolution": (lambda: make(resolution_m=0.0), "resolution_m must be a positive"),
    "a negative weight": (
        lambda: make(weights=-0.1),
        "weights must be 3 finite numbers that are not negative",
    ),
    "a weight of NaN": (lambda: make(weights=np.nan), "weights must be"),
    "an endless weight": (lambda: make(weights=np.inf), "weights must be"),
    "another negative weight": (lambda: make().with_weights([0.5, -1.0, 0.0]), "weights must be"),
    "an unknown model": (
        lambda: make(cost_model="cells"),
        "kind must be 'cell' or 'line', got 'cells'",
    ),
    "NaN in a volume": (lambda: volume(costs=np.full((1, 2, 3, 3), np.nan)), NO_COST),
    "a negative climb": (lambda: volume(weights=[1.0, 1.0, -1.0, 0.0]), "weights must be"),
    "a descent of NaN": (lambda: volume(weights=[1.0, 1.0, 0.0, np.nan]), "weights must be"),
    "a start off the volume": (lambda: volume(start=(2, 0, 0)), "outside the volume"),
    "a closed volume": (lambda: volume(is_free=np.zeros((2, 3, 3), bool)), "inside an obstacle"),
    "a model of settings": (
        lambda: model(cost_model="cells"),
        "cost_model must be 'cell' or 'line', got 'cells'",
    ),
    "a length of NaN": (
        lambda: model(reference_length_m=np.nan),
        "must be a positive number of metres, got nan",
    ),
    "a length in words": (
        lambda: model(reference_length_m="far"),
        "reference_length_m must be a number",
    ),
    "26 neighbours": (lambda: model(connectivity=26), "connectivity must be 4 or 8"),
    "a diagonal rule": (
        lambda: model(diagonal="never"),
        "diagonal must be 'both-free' or 'always'",
    ),
    "a planner's name": (
        lambda: find_planner("astar-pluss"),
        "planner on one altitude must be .* .did you mean 'astar-plus'",
    ),
    "a heuristic's name": (
        lambda: find_planner("astar-dist", "octil"),
        "no heuristic 'octil' .did you mean 'octile'",
    ),
    "a heuristic for none": (
        lambda: find_planner("ptp", "octile"),
        "takes no heuristic 'octile': leave it out",
    ),
    "A*'s heuristic": (
        lambda: astar(wall(), heuristic="plus-print"),
        "did you mean 'plus-printed'",
    ),
    "a volume's heuristic": (
        lambda: volume_astar(volume(), heuristic="octil"),
        "did you mean 'octile'",
    ),
    "theta*'s heuristic": (
        lambda: theta_star(wall(), heuristic="octile"),
        "'euclidean' or 'plus', got 'octile'",
    ),
    "BIT*'s heuristic": (
        lambda: bitstar(wall(), heuristic="pluss"),
        "got 'pluss' .did you mean 'plus'",
    ),
    "theta* by cells": (
        lambda: theta_star(wall(cost_model="cell")),
        "'theta-star' weighs .* cost_model='line'",
    ),
    "refinement by cells": (
        lambda: refine(wall(cost_model="cell"), astar(wall())),
        "weighs .* cost_model='line'",
    ),
    "refinement off the map": (
        lambda: refine(wall(), with_points([[0.5, 0.5], [9.0, 0.5]])),
        "leaves the map",
    ),
    "a path off free cells": (
        lambda: simplify_path(wall(), with_points([[0.5, 0.5], [1.5, 1.5]]), 1.0),
        "not free on this",
    ),
    "a tolerance of 0": (
        lambda: simplify_path(wall(), astar(wall()), 0),
        "tolerance_m must be a positive number of metres",
    ),
    "a tolerance below 0": (
        lambda: simplify_path(wall(), astar(wall()), -1.0),
        "tolerance_m must be",
    ),
    "a tolerance of NaN": (
        lambda: simplify_path(wall(), astar(wall()), np.nan),
        "tolerance_m must be",
    ),
    "a tolerance in words": (
        lambda: simplify_path(wall(), astar(wall()), "wide"),
        "tolerance_m must be",
    ),
    "a search without an end": (
        lambda: bitstar(wall(), budget_s=np.inf),
        "nothing else ends the search",
    ),
    "no batch": (
        lambda: bit_star(batch_samples=0),
        "batch_samples must be a whole number from 1 up, got 0",
    ),
    "samples below 0": (
        lambda: bitstar(wall(), max_samples=-1),
        "max_samples must be a whole number from 0 up",
    ),
    "ptp in JAX": (lambda: solve_many([], planner="ptp", backend="jax"), "take backend='numba'"),
    "landmarks in JAX": (
        lambda: solve_many([], heuristic="landmarks", backend="jax"),
        "take backend='numba'",
    ),
    "a backend": (
        lambda: solve_many([], backend="cuda"),
        "backend must be 'auto', 'numba' or 'jax', got 'cuda'",
    ),
    "no thread": (
        lambda: solve_many([], num_threads=0),
        "num_threads must be a whole number from 1 up",
    ),
    "no radius": (lambda: bit_star(eta=np.nan), "eta must be a positive number, got nan"),
    "batches that shrink": (
        lambda: bit_star(growth=-0.5),
        "growth must be a number >= 0, got -0.5",
    ),
    "a gain below 0": (
        lambda: bit_star(min_improvement=-1),
        "min_improvement must be a number >= 0, got -1",
    ),
    "many by an unknown planner": (
        lambda: solve_many([], planner="dijkstra"),
        "planner on one altitude must be",
    ),
    "many without an end": (
        lambda: solve_many([wall()], planner="bitstar-plus", backend="jax"),
        "nothing else ends",
    ),
    "seeds of others": (
        lambda: batched(seeds=[0, 1]),
        "seeds must be one for each of 1 problems, got 2",
    ),
    "a clearance in batches": (
        lambda: batched(wall(leg_margin_m=0.1), seeds=[0]),
        "tests no legs for this clearance",
    ),
    "no points": (lambda: crossed_cells(np.empty(0), 1.0), NO_PATH),
    "a row of numbers": (lambda: crossed_cells(np.array([1.0, 2.0]), 1.0), NO_PATH),
    "points of four numbers": (lambda: crossed_cells(np.ones((1, 4)), 1.0), NO_PATH),
    "a point of NaN": (lambda: crossed_cells(np.array([[np.nan, 1.0]]), 1.0), NO_PATH),
    "an endless point": (lambda: crossed_cells(np.array([[np.inf, 1.0], [0, 0]]), 1.0), NO_PATH),
}


@pytest.mark.parametrize(("call", "sentence"), REFUSED.values(), ids=REFUSED)
def test_wrong_input_is_refused_in_a_sentence_that_names_it(call, sentence):
    with pytest.raises(InputError, match=sentence):
        call()


def test_theta_star_takes_the_cell_model_where_the_map_costs_nothing():
    costless = Problem(np.zeros((1, 4, 4)), np.ones((4, 4), bool), (0, 0), (3, 2), 2.0, 1.0, "cell")
    assert theta_star(costless).cost == pytest.approx(2 * np.hypot(3, 2))
