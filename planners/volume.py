"""Planning through a stack of levels: the problem, and what a path through it costs."""

import copy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import CostModel, positive_m
from jaxurban.planners.moves import STEPS, allowed_moves

Node = tuple[int, int, int]  # level, row, column; level 0 is the lowest, row 0 in the south


@dataclass(frozen=True, eq=False)
class VolumeProblem:
    """One planning question in a stack of levels, as plain arrays. ``K`` levels, ``Y`` rows, ``X`` columns.

    A node is the centre of a cell at a level's altitude. A step leads to one of the neighbours on the same
    level, the level above or the level below (26 with ``connectivity`` 8, 14 with 4). It is as long as in
    space, and costs ``distance_weight`` per metre, ``climb_cost`` or ``descent_cost`` per metre up or down,
    and of the map, from P to Q of length d: ``cost(Q)`` under ``cell``, ``d / reference_length_m * (cost(P)
    + cost(Q)) / 2`` under ``line`` (a node's cost holds half-way to its neighbours, so that half of every
    step lies in each). A horizontal step is allowed as in 2-D; one that changes levels only where it is
    allowed on both, that is, where all cells that it passes are free at its lower and its upper end.

    Attributes:
      cost: ``[K, Y, X]`` float64 weighted map cost, >= 0 and finite on free nodes; kept as inf elsewhere.
      is_free: ``[K, Y, X]`` bool.
      levels_m: ``[K]`` ascending altitudes above ground.
      start, goal: nodes.
      resolution_m: side of a cell.
      distance_weight: cost per metre of path.
      climb_cost, descent_cost: cost per metre climbed and descended, beside the distance; >= 0.
      cost_model: see `base.Problem`.
      moves: ``[K, Y, X]`` uint8: bit j is set where horizontal step j of `moves.STEPS` is allowed on its level.
    """

    cost: np.ndarray
    is_free: np.ndarray
    levels_m: np.ndarray
    start: Node
    goal: Node
    resolution_m: float
    distance_weight: float
    climb_cost: float = 0.0
    descent_cost: float = 0.0
    cost_model: CostModel = field(default_factory=CostModel)
    moves: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        is_free, levels_m = np.asarray(self.is_free, bool), np.asarray(self.levels_m, np.float64)
        if is_free.ndim != 3 or np.shape(self.cost) != is_free.shape or levels_m.shape != is_free.shape[:1]:
            raise InputError(
                f"cost and is_free must be [K, Y, X] over levels_m [K], got {np.shape(self.cost)}, {is_free.shape} "
                f"and {levels_m.shape}"
            )
        if not (np.isfinite(levels_m).all() and np.all(np.diff(levels_m) > 0)):
            raise InputError(f"levels_m must be finite and ascending, got {levels_m.tolist()}")
        model = CostModel.of(self.cost_model)
        object.__setattr__(self, "cost_model", model)
        positive_m("resolution_m", self.resolution_m)
        for name in ("distance_weight", "climb_cost", "descent_cost"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be a finite cost per metre >= 0, got {getattr(self, name)}")
        cost = np.where(is_free, np.asarray(self.cost, np.float64), np.inf)
        if not np.all((cost >= 0) & ((cost < np.inf) == is_free)):
            raise InputError("costs must be finite and not negative on free cells: check the weights and the maps")
        moves = np.stack([allowed_moves(free, model.connectivity, model.diagonal == "both-free") for free in is_free])
        for name, array in (("cost", cost), ("is_free", is_free), ("levels_m", levels_m), ("moves", moves)):
            object.__setattr__(self, name, array)
        self._check_endpoints()

    def _check_endpoints(self) -> None:
        for name in ("start", "goal"):
            node = getattr(self, name)
            if not all(0 <= index < size for index, size in zip(node, self.is_free.shape, strict=True)):
                raise InputError(f"{name} {node} is outside the volume of {self.is_free.shape} levels, rows, columns")
            if not self.is_free[node]:
                raise InputError(f"{name} {node} is inside an obstacle: move it to a free cell or level")

    def between(self, start: Node, goal: Node) -> "VolumeProblem":
        """Return the same question between other nodes; the volume, checked already, is shared.

        Raises:
          InputError: a node is outside the volume or inside an obstacle.
        """
        other = copy.copy(self)
        object.__setattr__(other, "start", start)
        object.__setattr__(other, "goal", goal)
        other._check_endpoints()
        return other


class VolumeCost(NamedTuple):
    """What a path from node to node costs. ``N`` nodes.

    Attributes:
      total: all of it; inf where a step is not allowed.
      length_m: length in space.
      climb_m, descent_m: metres climbed and descended.
      nodes: ``[N, 3]`` int64 level, row, column.
      charged: ``[N]`` float64 how many times the map cost of each node is paid.
      node_length_m: ``[N]`` float64 length of path in each node's cell.
    """

    total: float
    length_m: float
    climb_m: float
    descent_m: float
    nodes: np.ndarray
    charged: np.ndarray
    node_length_m: np.ndarray


def charge(problem: VolumeProblem, points_m: np.ndarray) -> VolumeCost:
    """Return the cost of a path of neighbouring nodes, given as points ``[N, 3]`` (x, y, altitude; ``N >= 1``).

    Its total is inf where a step is not one that the search may take (see `VolumeProblem`).
    """
    cells = np.floor(points_m[:, 1::-1] / problem.resolution_m).astype(np.int64)
    nodes = np.column_stack([np.searchsorted(problem.levels_m, points_m[:, 2]), cells])
    length_m = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    rise_m = np.diff(points_m[:, 2])
    climb_m, descent_m = float(np.maximum(rise_m, 0).sum()), float(np.maximum(-rise_m, 0).sum())
    node_length_m = (np.append(length_m, 0.0) + np.append(0.0, length_m)) / 2
    charged = np.append(0.0, np.ones(len(length_m)))
    if problem.cost_model.kind == "line":
        charged = node_length_m / problem.cost_model.reference_length_m
    total = (
        problem.distance_weight * length_m.sum()
        + problem.climb_cost * climb_m
        + problem.descent_cost * descent_m
        + charged @ problem.cost[tuple(nodes.T)]
    )
    if not _is_allowed(problem, nodes):
        total = np.inf
    return VolumeCost(float(total), float(length_m.sum()), climb_m, descent_m, nodes, charged, node_length_m)


def _is_allowed(problem: VolumeProblem, nodes: np.ndarray) -> bool:
    """Return whether every step between nodes ``[N, 3]`` leads to a neighbour and is allowed on both of its levels."""
    steps = np.diff(nodes, axis=0)
    if np.abs(steps).max(initial=0) > 1 or not problem.is_free[tuple(nodes.T)].all():
        return False
    # The bit of the horizontal part of each step; 0 straight up or down.
    bit = (steps[:, None, 1:] == np.array(STEPS)).all(axis=2) @ (1 << np.arange(len(STEPS)))
    level, row, col = nodes[:-1].T
    return bool(np.all(problem.moves[level, row, col] & problem.moves[nodes[1:, 0], row, col] & bit == bit))
