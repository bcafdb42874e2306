"""Maps weighed part by part: searches find what they do on whole maps, and leave out what they do not come to."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from jaxurban.kernels.search.tiles import PART
from jaxurban.planners.anytime import astar_anytime
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.planners.cost_model import CostModel

SHAPE = (7 * PART[0] + 5, 2 * PART[1] + 3)


def large_problem(kind="cell", seed=0):
    """Three layers over several parts of a map, a tenth of it closed."""
    rng = np.random.default_rng(seed)
    is_free = rng.random(SHAPE) < 0.9
    is_free[[20, 40, 400], [30, 900, 2000]] = True
    layers = np.where(is_free, rng.random((3, *SHAPE), np.float32) + 0.2, np.nan).astype(np.float32)
    return Problem(layers, is_free, (20, 30), (40, 900), 2.0, [0.3, 1.0, 0.0, 0.5], CostModel(kind))


def test_made_parts_hold_what_the_whole_map_does():
    problem = large_problem()
    weighed, whole = problem.weighed, problem.with_weights(problem.weights).cost
    for part in np.ndindex(weighed.readiness().shape):
        weighed.make(part)
        row, col = (index * side for index, side in zip(part, PART, strict=True))
        rows = slice(max(row - 1, 0), row + PART[0] + 1)
        cols = slice(max(col - 1, 0), col + PART[1] + 1)
        np.testing.assert_array_equal(weighed.cost[rows, cols], whole[rows, cols])
    np.testing.assert_array_equal(weighed.whole(), whole)
    np.testing.assert_array_equal(problem.cost, whole)
    assert problem.cost is problem.between((20, 30), (400, 2000)).cost


@pytest.mark.parametrize("kind", ["cell", "line"])
def test_a_search_makes_the_parts_that_it_comes_to_and_finds_what_it_does_on_a_whole_map(kind):
    problem = large_problem(kind)
    path = astar(problem, heuristic="tiles")
    made = problem.weighed.readiness()
    assert 0 < made.sum() < made.size
    whole = problem.with_weights(problem.weights)
    assert whole.cost.shape == SHAPE
    assert whole.weighed.readiness().all()
    other = astar(whole, heuristic="tiles")
    np.testing.assert_array_equal(path.points_m, other.points_m)
    assert (path.cost, path.num_expanded) == (other.cost, other.num_expanded)
    assert path.cost == pytest.approx(astar(problem, heuristic="octile").cost, rel=1e-12)


def test_anytime_search_ends_at_the_same_cost_on_a_map_in_parts():
    problem = large_problem()
    found = astar_anytime(problem, heuristic="tiles")
    assert found.gap == 0
    assert found.cost == pytest.approx(astar(problem, heuristic="plus").cost, rel=1e-12)


def test_searches_in_threads_share_the_parts():
    problem = large_problem()
    ends = [((20, 30), (40, 900)), ((400, 2000), (20, 30)), ((40, 900), (400, 2000)), ((40, 900), (20, 30))]
    with ThreadPoolExecutor(4) as pool:
        costs = list(pool.map(lambda pair: astar(problem.between(*pair), heuristic="tiles").cost, ends * 2))
    alone = [astar(problem.with_weights(problem.weights).between(*pair), heuristic="tiles").cost for pair in ends]
    assert costs == alone * 2
