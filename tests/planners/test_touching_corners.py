"""Two blocked cells that touch at a corner leave no gap: every walker of segments and every planner keeps to it."""

import itertools
from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from shapely import LineString

from jaxurban.errors import InputError
from jaxurban.kernels.line.segment_cost import CostGrid, segment_cost, segment_costs
from jaxurban.planners.any_angle import refine
from jaxurban.planners.astar import volume_astar
from jaxurban.planners.base import Path, Problem, Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import PLANNERS
from tests.free_space import Obstacles
from tests.planners.problems import costed, volume_problem

SHAPE = (10, 12)
NUM_SEGMENTS = 1500
OFFSETS = (0.0, 1e-12, 1e-9, 1e-7)  # of a segment from a corner, in cell sides
DIRECTIONS = np.array([(1, 1), (1, -1), (2, 1), (1, 3), (3, -2), (5, 4)])
PLAIN = [(name, model) for name in PLANNERS for model in ("cell", "line") if model == "line" or name != "theta-star"]
SIZE = 9
WALL = ~np.eye(SIZE, dtype=bool)  # from the southwest to the northeast


def pinched_map(seed):
    """A checkerboard with cells turned over: about every third corner has two blocked cells that touch there."""
    rng = np.random.default_rng(seed)
    return (np.indices(SHAPE).sum(axis=0) % 2 == 0) ^ (rng.random(SHAPE) < 0.3)


def segments_by_corners(seed):
    """Segments ``[E, 2, 2]`` that run through corners, or by them at an offset; their ends lie inside cells."""
    rng = np.random.default_rng(seed)
    corner = rng.integers(2, np.array(SHAPE[::-1]) - 1, (NUM_SEGMENTS, 2)).astype(float)
    along = rng.choice(DIRECTIONS, NUM_SEGMENTS) * rng.choice([-1, 1], (NUM_SEGMENTS, 1))
    along = along / np.hypot(*along.T)[:, None]
    is_any = rng.random(NUM_SEGMENTS) < 0.2
    angle = rng.uniform(0, 2 * np.pi, NUM_SEGMENTS)
    along[is_any] = np.stack([np.cos(angle), np.sin(angle)], axis=1)[is_any]
    corner += (rng.choice(OFFSETS, NUM_SEGMENTS) * rng.choice([-1, 1], NUM_SEGMENTS))[:, None] * rng.choice(
        [(1.0, 0.0), (0.0, 1.0), (0.6, -0.8)], NUM_SEGMENTS
    )
    ends = np.stack([corner - rng.uniform(0.05, 0.8, (NUM_SEGMENTS, 1)) * along, corner + 0.37 * along], axis=1)
    ends[::2, 1] = corner[::2] + rng.uniform(0.05, 1.4, (len(corner[::2]), 1)) * along[::2]
    return ends


@cache
def by_evaluation(seed, cost_model, diagonal):
    """What the evaluation of paths says that segments by corners cost."""
    is_free = pinched_map(seed)
    layers = np.random.default_rng(seed).random((1, *SHAPE))
    segments = segments_by_corners(seed)
    return np.array(
        [
            costed(ends, layers, is_free, 1.0, 0.3, CostModel(cost_model, 1.0, diagonal=diagonal)).total
            for ends in segments
        ]
    )


def cell_cost_of(seed):
    return np.where(pinched_map(seed), np.random.default_rng(seed).random((1, *SHAPE))[0], np.inf)


def bulk_costs(cell_cost, segments, is_line, passes_corners):
    with jax.enable_x64(True):
        return segment_costs(cell_cost, segments[:, 0], segments[:, 1], 0.3, is_line, passes_corners)


def compiled_costs(cell_cost, segments, is_line, passes_corners):
    cost_grid = CostGrid(cell_cost, 0.3, is_line, passes_corners)
    return [segment_cost(cost_grid, *a, *b, np.inf) for a, b in segments]


@pytest.mark.parametrize("diagonal", ["both-free", "always"])
@pytest.mark.parametrize("cost_model", ["line", "cell"])
@pytest.mark.parametrize("walk", [bulk_costs, compiled_costs])
def test_every_walker_finds_the_way_free_where_the_evaluation_does(walk, cost_model, diagonal):
    num_pinched = 0
    for seed in range(3):
        expected = by_evaluation(seed, cost_model, diagonal)
        found = walk(cell_cost_of(seed), segments_by_corners(seed), cost_model == "line", diagonal == "always")
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        num_pinched += (np.isinf(expected) & np.isfinite(by_evaluation(seed, cost_model, "always"))).sum()
        assert 100 < np.isfinite(expected).sum() < NUM_SEGMENTS - 100
    assert num_pinched > (200 if diagonal == "both-free" else -1)


def test_a_segment_with_an_end_on_a_border_is_never_taken_where_the_evaluation_finds_no_way():
    rng = np.random.default_rng(2)
    taken = 0
    for seed in range(4):
        is_free = pinched_map(seed)
        cost_grid = CostGrid(np.where(is_free, 0.0, np.inf), 1.0, True, False)
        # Polylines of three points on halves: corners, middles of borders and of cells.
        for points in rng.integers(2, 18, (600, 1, 2)) / 2 + rng.integers(-1, 2, (600, 3, 2)) / 2:
            costs = [segment_cost(cost_grid, *a, *b, np.inf) for a, b in itertools.pairwise(points)]
            if np.isfinite(costs).all():
                taken += 1
                assert costed(points, np.zeros((1, *SHAPE)), is_free, 1.0, 1.0, CostModel()).is_valid
    assert taken > 100


def run(name: str, problem: Problem) -> Path:
    if name.startswith("bitstar"):
        return PLANNERS[name].run(problem, budget_s=np.inf, max_samples=300)
    return PLANNERS[name].run(problem, budget_s=60.0)


def always(problem: Problem) -> Problem:
    return replace(problem, cost_model=replace(problem.cost_model, diagonal="always"))


def walled_problem(is_free, model="line", **options):
    """From one side of the wall to the other, straight through the corner of its middle cells."""
    at = SIZE // 2
    layers = np.random.default_rng(0).random((1, *is_free.shape))
    return Problem(layers, is_free, (at + 2, at - 1), (at - 1, at + 2), 5.0, 0.1, CostModel(model, **options))


@pytest.mark.parametrize(("name", "model"), PLAIN)
def test_no_planner_passes_a_diagonal_wall_unless_always_is_set(name, model):
    path = run(name, walled_problem(WALL, model))
    assert path.status is (Status.BLOCKED if name == "ptp" else Status.NO_PATH)
    assert (path.cost, len(path.points_m)) == (np.inf, 0)
    path = run(name, walled_problem(WALL, model, diagonal="always"))
    assert path.status.has_path
    assert np.isfinite(path.cost)


@pytest.mark.parametrize("name", PLANNERS)
def test_neither_a_planner_nor_refinement_takes_a_short_cut_through_a_diagonal_wall(name):
    is_free = WALL.copy()
    is_free[-1, -1] = True  # the way around
    problem = walled_problem(is_free)
    through = run(name, always(problem))
    with pytest.raises(InputError, match="passes between two closed ones that touch at a corner"):
        refine(problem, through)
    assert refine(always(problem), through).cost <= through.cost < np.inf
    path = run(name, problem)
    if name == "ptp":
        assert path.status is Status.BLOCKED
        return
    wall = LineString([[0.0, 0.0], [5.0 * (SIZE - 1) - 1e-6] * 2])
    refined = refine(problem, path)
    for found in (path, refined):
        assert not LineString(found.points_m).intersects(wall)
    assert through.cost < refined.cost <= path.cost < np.inf


def test_paths_on_maps_full_of_touching_corners_are_found_free_again():
    num_paths = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        is_free = rng.random((24, 24)) < 0.62
        for row, col in rng.integers(0, 18, (4, 2)):
            is_free[row : row + 6, col : col + 6] = ~np.eye(6, dtype=bool)[:: rng.choice([-1, 1])]
        start, goal = (tuple(int(v) for v in cell) for cell in rng.choice(np.argwhere(is_free), 2))
        for diagonal in ("both-free", "always"):
            model = CostModel("line", diagonal=diagonal)
            problem = Problem(rng.random((1, 24, 24)), is_free, start, goal, 5.0, 0.2, model)
            for name in PLANNERS:
                path = run(name, problem)
                for found in (path, refine(problem, path)) if path.status.has_path else ():
                    costs = costed(found.points_m, problem.costs, is_free, 5.0, 0.2, model)
                    assert costs.is_valid
                    assert found.cost == pytest.approx(costs.total, rel=1e-12)
                    obstacles = Obstacles(is_free, 5.0)
                    assert obstacles.crossed_m(found.points_m) < 1e-6
                    assert diagonal == "always" or not obstacles.is_pinched(found.points_m)
                    num_paths += 1
    assert num_paths > 40


def test_a_diagonal_wall_through_all_levels_closes_a_volume_and_a_path_through_it_costs_infinity():
    def problem(diagonal, is_free):
        ends = (0, 6, 3), (0, 3, 6)
        return volume_problem(
            np.ones((2, *WALL.shape)),
            is_free,
            np.array([20.0, 30.0]),
            *ends,
            5.0,
            1.0,
            cost_model=CostModel(diagonal=diagonal),
        )

    walled = np.stack([WALL, WALL])
    assert volume_astar(problem("both-free", walled)).status is Status.NO_PATH
    through = volume_astar(problem("always", walled))
    assert through.status is Status.OPTIMAL
    assert problem("always", walled).cost_of(through.points_m) == through.cost
    assert problem("both-free", walled).cost_of(through.points_m) == np.inf
    over = volume_astar(problem("both-free", np.stack([WALL, np.ones_like(WALL)])))
    assert over.cost > through.cost
    assert over.points_m[:, 2].max() == 30.0
