"""What a path adds up, for every planner, fit, study and report: its cost is weights . features, here and nowhere else.

cost(path) = weights . phi(path)        phi = (metres, cost of each layer[, metres climbed, metres descended])
"""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxurban.errors import InputError
from jaxurban.kernels.line.traversal import crossed_cells, is_free_way
from jaxurban.planners.moves import STEPS

if TYPE_CHECKING:
    from jaxurban.planners.base import Problem

ROUNDING = 1e-9  # relative: lengths this close are equal
CostKind = Literal["cell", "line"]
Index = tuple[Any, ...]  # (row, col) of cells, or (level, row, col) of nodes in a volume


@dataclass(frozen=True, eq=False)
class PathFeatures:
    """What a path adds up, whatever the weights are. ``L`` layers.

    Attributes:
      phi: ``[W]`` float64 what the weights multiply: metres, then how much of each layer's cost counts, then in a
        volume metres climbed and descended; the layers are inf for a path that is not valid.
      is_valid: every crossed cell is on the map and free, and so is the way through corners (`is_free_way`); in a
        volume, every step is one that the search may take.
      counted: the cells whose costs count, in order of travel, and ``count`` how often each is.
      crossed: the cells that the path crosses, in order of travel, and ``length_m`` how far it runs in each (a node of
        a volume holds half-way to its neighbours).
      costs: of the problem.
    """

    phi: np.ndarray
    is_valid: bool
    counted: Index
    count: np.ndarray
    crossed: Index
    length_m: np.ndarray
    costs: np.ndarray

    def cost(self, weights: np.ndarray) -> float:
        """Return the path's cost under weights ``[W]``; inf for a path that is not valid."""
        if not self.is_valid:
            return np.inf
        return float(weights[0] * self.phi[0] + np.sum(weights[1:] * self.phi[1:]))

    @property
    def mean_costs(self) -> np.ndarray:
        """``[L]`` the mean of each layer's cost along the path, by length; of a path without length, at its place."""
        length_m = self.length_m if self.length_m.sum() > 0 else np.ones(len(self.length_m))
        return self.costs[(slice(None), *self.crossed)].astype(np.float64) @ length_m / length_m.sum()


def path_features(problem: "Problem", points_m: np.ndarray, kind: CostKind | None = None) -> PathFeatures:
    """Return what a path adds up on a problem's map (`Problem.features`).

    Under ``cell`` (the paper's transition cost) each step between states costs the layers of the cell in which it
    ends, whatever its length; states are the path's points, and samples every resolution step of segments longer than
    a diagonal step. A step that ends on a border ends in the cell that it came through. Under ``line`` the layers are
    integrated along the path, cut exactly at cell borders, per reference length. A path of one point, or of no length,
    costs nothing.

    Args:
      problem: whose costs, free cells and cost model count.
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner, ``N >= 1``; in a volume ``[N, 3]`` x, y,
        altitude of neighbouring nodes.
      kind: of cost model, instead of the problem's.

    Raises:
      InputError: points that are not finite metres of these shapes.
    """
    points_m = np.asarray(points_m, np.float64)
    kind = kind or problem.cost_model.kind
    if problem.levels_m is not None:
        return _volume_features(problem, points_m, kind)
    crossings = crossed_cells(points_m, problem.resolution_m)
    metres = [float(np.hypot(*np.diff(points_m, axis=0).T).sum())]
    crossed = (crossings.row, crossings.col)
    if not is_free_way(crossings, problem.is_free, problem.cost_model.passes_corners):
        none = (np.empty(0, np.int64), np.empty(0, np.int64))
        return _features(problem, metres, False, none, np.empty(0), crossed, crossings.length_m)
    if kind == "line":
        counted, count = crossed, crossings.length_m / problem.cost_model.reference_length_m
    else:
        states = crossed_cells(path_states(points_m, problem.resolution_m), problem.resolution_m)
        is_last = np.append(states.segment[1:] != states.segment[:-1], states.length_m[-1] > 0)
        counted, count = (states.row[is_last], states.col[is_last]), np.ones(int(is_last.sum()))
    return _features(problem, metres, True, counted, count, crossed, crossings.length_m)


def _volume_features(problem: "Problem", points_m: np.ndarray, kind: CostKind) -> PathFeatures:
    """Return the features of a path of neighbouring nodes, each step costed as `Problem` states."""
    if points_m.ndim != 2 or points_m.shape[1] != 3 or not np.isfinite(points_m).all():
        raise InputError(f"a path through a volume must be [N, 3] finite metres, got shape {points_m.shape}")
    cells = np.floor(points_m[:, 1::-1] / problem.resolution_m).astype(np.int64)
    nodes = np.column_stack([np.searchsorted(problem.levels_m, points_m[:, 2]), cells])
    length_m = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    rise_m = np.diff(points_m[:, 2])
    node_length_m = (np.append(length_m, 0.0) + np.append(0.0, length_m)) / 2
    count = np.append(0.0, np.ones(len(length_m)))
    if kind == "line":
        count = node_length_m / problem.cost_model.reference_length_m
    metres = [float(length_m.sum()), float(np.maximum(rise_m, 0).sum()), float(np.maximum(-rise_m, 0).sum())]
    at = tuple(nodes.T)
    return _features(problem, metres, _is_allowed(problem, nodes), at, count, at, node_length_m)


def _features(
    problem: "Problem",
    metres: list[float],
    is_valid: bool,
    counted: Index,
    count: np.ndarray,
    crossed: Index,
    length_m: np.ndarray,
) -> PathFeatures:
    layers = np.full(len(problem.costs), np.inf)
    if is_valid:
        layers = problem.costs[(slice(None), *counted)].astype(np.float64) @ count
    phi = np.concatenate([metres[:1], layers, metres[1:]])
    return PathFeatures(phi, is_valid, counted, count, crossed, length_m, problem.costs)


def _is_allowed(problem: "Problem", nodes: np.ndarray) -> bool:
    """Return whether every step between nodes ``[N, 3]`` leads to a neighbour and is allowed on both of its levels."""
    steps = np.diff(nodes, axis=0)
    if np.abs(steps).max(initial=0) > 1 or not problem.is_free[tuple(nodes.T)].all():
        return False
    # The bit of the horizontal part of each step; 0 straight up or down.
    bit = (steps[:, None, 1:] == np.array(STEPS)).all(axis=2) @ (1 << np.arange(len(STEPS)))
    level, row, col = nodes[:-1].T
    return bool(np.all(problem.moves[level, row, col] & problem.moves[nodes[1:, 0], row, col] & bit == bit))


def visit_counts(problem: "Problem", points_m: np.ndarray) -> np.ndarray:
    """Return ``[Y, X]`` how often a valid path's cost counts each cell: its derivative by the cell's cost."""
    found = path_features(problem, points_m)
    counts = np.zeros(problem.is_free.shape)
    np.add.at(counts, found.counted, found.count)
    return counts


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
    """Return ``[M, 2]`` the states whose cells the ``cell`` model counts: the points, and samples of long segments.

    A segment longer than a diagonal step is sampled every resolution step; a shorter one is one step.
    """
    points = np.asarray(points_m, np.float64)
    is_long = np.hypot(*np.diff(points, axis=0).T) > np.sqrt(2) * resolution_m * (1 + ROUNDING)
    if not is_long.any():
        return points
    segments = [points[:1]]
    for i, long in enumerate(is_long):
        segments.append(sample_segment(points[i], points[i + 1], resolution_m)[1:] if long else points[i + 1 : i + 2])
    return np.concatenate(segments)


@cache
def warm_up() -> None:
    """Compile what an evaluation runs, once, so that a planner's time is its own."""
    crossed_cells(np.array([[0.5, 0.5], [1.5, 0.5]]), 1.0)
