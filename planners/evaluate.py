"""The cost of a path, computed the same way for every planner."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from jaxurban.kernels.traversal import Crossings, crossed_cells, is_free_way
from jaxurban.planners.base import CostModel, Problem

ROUNDING = 1e-9  # relative: lengths this close are equal


@dataclass(frozen=True, eq=False)
class PathCost:
    """What a path costs. ``L`` layers.

    Attributes:
      total: ``distance_weight * length_m + per_layer.sum()``; inf for a path that is not valid.
      length_m: Euclidean length.
      per_layer: ``[L]`` float64 what each layer charges, weights included; inf for a path that is not valid.
      is_valid: every crossed cell is on the map and free, and so is the way through corners (`is_free_way`).
      crossings: the cells that the path crosses.
    """

    total: float
    length_m: float
    per_layer: np.ndarray
    is_valid: bool
    crossings: Crossings


def sample_segment(start_m: np.ndarray, end_m: np.ndarray, step_m: float) -> np.ndarray:
    """Return ``[N, 2]`` points on a segment every ``step_m`` from its start, its end included.

    The paper's straight path (eq. for alpha, with y's component mended): the last step is the shorter
    one. A segment of no length is one point.
    """
    length_m = float(np.hypot(*(end_m - start_m)))
    if length_m == 0:
        return np.array([start_m], np.float64)
    num_steps = max(1, int(np.ceil(length_m / step_m * (1 - ROUNDING))))
    along = np.arange(num_steps + 1)[:, None] * (step_m / length_m)
    points = start_m + along * (end_m - start_m)
    points[-1] = end_m
    return points


def path_states(points_m: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[M, 2]`` the states that the ``cell`` model charges: the points, and samples of long segments.

    A segment longer than a diagonal step is sampled every resolution step; a shorter one is one step.
    """
    points = np.asarray(points_m, np.float64)
    is_long = np.hypot(*np.diff(points, axis=0).T) > np.sqrt(2) * resolution_m * (1 + ROUNDING)
    if not is_long.any():
        return points
    pieces = [points[:1]]
    for i, long in enumerate(is_long):
        pieces.append(sample_segment(points[i], points[i + 1], resolution_m)[1:] if long else points[i + 1 : i + 2])
    return np.concatenate(pieces)


def evaluate(
    points_m: np.ndarray,
    layers: np.ndarray,
    is_free: np.ndarray,
    resolution_m: float,
    distance_weight: float,
    model: CostModel,
) -> PathCost:
    """Return the cost of a polyline, its parts, and whether it is valid.

    Under ``cell`` (the paper's transition cost) each step between states is charged the layers of the
    cell in which it ends, whatever its length; states are the path's points, and samples every
    resolution step of segments longer than a diagonal step. A step that ends on a border ends in the
    cell that it came through. Under ``line`` the layers are integrated along the path, cut exactly at
    cell borders, per reference length. A path of one point, or of no length, costs nothing.

    Args:
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner, ``N >= 1``.
      layers: ``[L, Y, X]`` weighted cost layers.
      is_free: ``[Y, X]`` bool.
      resolution_m: side of a cell.
      distance_weight: cost per metre.
      model: how steps are charged, and whether a path may pass between blocked cells that touch at a corner.

    Raises:
      InputError: points that are not ``[N, 2]`` finite metres.
    """
    crossings = crossed_cells(points_m, resolution_m)
    length_m = float(np.hypot(*np.diff(np.asarray(points_m, np.float64), axis=0).T).sum())
    if not is_free_way(crossings, is_free, model.passes_corners):
        return PathCost(np.inf, length_m, np.full(len(layers), np.inf), False, crossings)
    charged = _charged_cells(points_m, crossings, resolution_m, model)
    per_layer = np.asarray(layers[:, charged[0], charged[1]], np.float64) @ charged[2]
    total = distance_weight * length_m + float(per_layer.sum())
    return PathCost(total, length_m, per_layer, True, crossings)


def _charged_cells(
    points_m: np.ndarray, crossings: Crossings, resolution_m: float, model: CostModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return row and column of the cells whose layers are charged, and how often each is, ``[C]`` each."""
    if model.kind == "line":
        return crossings.row, crossings.col, crossings.length_m / model.reference_length_m
    states = crossed_cells(path_states(points_m, resolution_m), resolution_m)
    is_last = np.append(states.segment[1:] != states.segment[:-1], states.length_m[-1] > 0)
    return states.row[is_last], states.col[is_last], np.ones(int(is_last.sum()))


def charge_map(problem: Problem, points_m: np.ndarray) -> np.ndarray:
    """Return ``[Y, X]`` how often a valid path is charged each cell: the derivative of its cost by the cell's cost."""
    crossings = crossed_cells(points_m, problem.resolution_m)
    row, col, times = _charged_cells(points_m, crossings, problem.resolution_m, problem.cost_model)
    charges = np.zeros(problem.is_free.shape)
    np.add.at(charges, (row, col), times)
    return charges


def evaluate_on(problem: Problem, points_m: np.ndarray) -> PathCost:
    """Return the cost of a polyline under a problem's own map and cost model (see `evaluate`)."""
    return evaluate(
        points_m,
        problem.layers,
        problem.is_free,
        problem.resolution_m,
        problem.distance_weight,
        problem.cost_model,
    )


@cache
def warm_up() -> None:
    """Compile what an evaluation runs, once, so that a planner's time is its own."""
    crossed_cells(np.array([[0.5, 0.5], [1.5, 0.5]]), 1.0)
