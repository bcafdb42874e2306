"""What every planner takes and gives: Problem, Path, Status, and the planner contract."""

import copy
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Protocol, Self

import numpy as np

from jaxurban.checks import positive
from jaxurban.errors import InputError
from jaxurban.exit_codes import ExitCode
from jaxurban.kernels.search.bounds import LandmarkBound, tile_minima
from jaxurban.kernels.search.heap import NO_PARENT
from jaxurban.kernels.search.weighing import weighted_sum
from jaxurban.kernels.tolerances import SAME_COST
from jaxurban.planners.cost import CostModel, PathFeatures, allowed_moves, path_features

# Row, column; in a volume level, row, column. Row 0 is in the south, level 0 the lowest.
Cell = tuple[int, ...]

EVERY_PATH = "paths at any angle"  # of `Path.graph`
NO_COST = "The path costs nothing under these weights, so its shape means nothing: weigh the distance too."


class Status(Enum):
    """How a planner ended. The value is the name that files and ``--json`` carry."""

    OPTIMAL = "optimal"  # the best path of this planner's graph, proven
    FEASIBLE = "feasible"  # a path, with no proof that it is the best
    BUDGET_FEASIBLE = "budget-feasible"  # the budget ended with a path in hand
    NO_PATH = "no-path"  # proven: start and goal are not connected
    OVER_EXPOSURE = "over-exposure"  # proven: every path exceeds a budget of exposure
    BLOCKED = "blocked"  # the straight line crosses an obstacle
    BUDGET_EMPTY = "budget-empty"  # the budget ended with no path
    UNDECIDED = "undecided"  # the method ended with no path, and no proof that there is none

    @property
    def has_path(self) -> bool:
        """Whether a path was found."""
        return self in (Status.OPTIMAL, Status.FEASIBLE, Status.BUDGET_FEASIBLE)

    @property
    def exit_code(self) -> ExitCode:
        """The command line's exit code for this status."""
        if self.has_path:
            return ExitCode.DONE
        is_unknown = self in (Status.BUDGET_EMPTY, Status.UNDECIDED)
        return ExitCode.UNKNOWN if is_unknown else ExitCode.NO_PATH

    @property
    def sentence(self) -> str:
        """What happened and, where it helps, the remedy."""
        return {
            Status.OPTIMAL: "The path is the cheapest one that this planner's graph holds.",
            Status.FEASIBLE: "A path was found; it is not proven to be the cheapest.",
            Status.BUDGET_FEASIBLE: "The budget ended with a path in hand; a larger one may find a cheaper path.",
            Status.NO_PATH: "No path of this planner's graph joins start and goal: fly higher, or move one of them.",
            Status.OVER_EXPOSURE: "Every path exceeds a budget of exposure: raise it, fly higher, or move an end.",
            Status.BLOCKED: "The straight line crosses an obstacle: fly higher, or use a search such as astar-dist.",
            Status.BUDGET_EMPTY: "The search ended before a path was found: raise its budget.",
            Status.UNDECIDED: "Neither a path nor a proof that there is none was found: more time changes nothing.",
        }[self]


@dataclass(eq=False)
class CellCache:
    """What is derived from free cells alone, once for all layers and weights (`Problem.moves`)."""

    moves: np.ndarray | None = None


@dataclass(eq=False)
class ProblemCache:
    """What is derived from a map under its weights, once for all queries that share it (`Problem.between`).

    It equals itself alone, so that it is the key by which queries on one map are collected.

    Attributes:
      cells: what holds under other weights too.
      cost, tile_minima: as of `Problem`.
      landmarks: from `astar.make_landmarks`.
      costs_to_go: by goal, from `astar.exact_cost_to_go`.
      corner_bounds: by start and goal, from `corners.with_corner_bound`.
    """

    cells: CellCache = field(default_factory=CellCache)
    cost: np.ndarray | None = None
    tile_minima: np.ndarray | None = None
    landmarks: LandmarkBound | None = None
    costs_to_go: dict[Cell, np.ndarray] = field(default_factory=dict)
    corner_bounds: dict[tuple[Cell, Cell], float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Problem:
    """One planning query on one map or volume, as plain arrays. ``Y`` rows, ``X`` columns, ``L`` layers.

    **The cost of a path is weights . features** (`planners.cost.PathFeatures`), for every planner, fit and study.

    Points are in metres from the map's southwest corner: cell (row, col) has its centre at
    ``((col + 0.5) * resolution_m, (row + 0.5) * resolution_m)``.

    On one altitude a step from cell P to cell Q of length d costs, with c the weighted sum of the layers, under
    ``cell`` (the paper): ``distance_weight * d + c(Q)``; under ``line``: ``distance_weight * d + (1 /
    reference_length_m) * integral of c ds`` with c constant in each cell.

    In a volume of ``K`` levels a node is the centre of a cell at a level's altitude. A step leads to one of the
    neighbours on the same level, the level above or the level below (26 with ``connectivity`` 8, 14 with 4). It is as
    long as in space, and costs ``distance_weight`` per metre, ``climb_cost`` or ``descent_cost`` per metre up or
    down, and of the map, from P to Q of length d: ``c(Q)`` under ``cell``, ``d / reference_length_m * (c(P) + c(Q)) /
    2`` under ``line`` (a node's cost holds half-way to its neighbours, so that half of every step lies in each). A
    horizontal step is allowed as in 2-D; one that changes levels only where it is allowed on both, that is, where all
    cells that it passes are free at its lower and its upper end.

    The arrays are kept as read-only views (do not alter them meanwhile); many queries on one map share
    them, and what is derived from them, through `between`.

    Attributes:
      costs: ``[L, Y, X]`` float32 (or float64) costs c_j, **not weighted**, >= 0 and finite on free cells; in a volume
        ``[L, K, Y, X]``.
      is_free: ``[Y, X]`` or ``[K, Y, X]`` bool; a path may cross free cells only.
      start, goal: cells, or nodes (level, row, column) of a volume; paths begin and end at their centres.
      resolution_m: side of a cell.
      weights: ``[W]`` float64, >= 0: w_0 per metre, then of each layer, then in a volume of each metre climbed and
        descended. One number stands for w_0, with layers of weight 1, and climb and descent of none.
      cost_model: how steps are costed, and which are allowed; its kind stands for the rest's defaults.
      levels_m: ``[K]`` ascending altitudes above ground of a volume; None on one altitude.
      leg_margin_m: that straight legs keep from cells that are not free and from the map's border, less than half a
        cell. Steps between the centres of neighbours keep it; with one, no diagonal step passes a closed cell.
    """

    costs: np.ndarray
    is_free: np.ndarray
    start: Cell
    goal: Cell
    resolution_m: float
    weights: Any  # kept as an array
    cost_model: CostModel = field(default_factory=CostModel)
    levels_m: Any = None  # kept as an array
    leg_margin_m: float = 0.0
    cache: ProblemCache = field(init=False, repr=False, default_factory=ProblemCache)

    def __post_init__(self) -> None:
        """Keep the arrays as read-only views of the types that compiled searches take, and check all values.

        Raises:
          InputError: a value out of its range.
        """
        costs = np.asarray(self.costs)
        costs = _read_only(costs, np.float32 if costs.dtype == np.float32 else np.float64)
        is_free = _read_only(self.is_free, np.bool_)
        if self.levels_m is not None:
            object.__setattr__(self, "levels_m", np.asarray(self.levels_m, np.float64))
        object.__setattr__(self, "cost_model", CostModel.of(self.cost_model))
        positive("resolution_m", self.resolution_m, "metres")
        # Each layer, not only the sum, so that a negative one cannot hide behind another; NaN fails too.
        if not (((costs >= 0) & (costs < np.inf)) | ~is_free).all():
            raise InputError("costs must be finite and not negative on free cells: check the maps")
        object.__setattr__(self, "costs", costs)
        object.__setattr__(self, "is_free", is_free)
        self._set_weights(self.weights)
        self._check_endpoints()

    def _set_weights(self, weights: Any) -> None:
        """Set the weights ``[1 + L]``, in a volume ``[3 + L]``.

        One number alone is the weight of distance; then layers have weight 1, climb and descent weight 0.

        Raises:
          InputError: too many or too few weights, or one that is negative or not finite.
        """
        weights = np.asarray(weights, np.float64)
        num_heights = 0 if self.levels_m is None else 2
        if weights.ndim == 0:
            weights = np.concatenate([[weights], np.ones(len(self.costs)), np.zeros(num_heights)])
        num_weights = 1 + len(self.costs) + num_heights
        if weights.shape != (num_weights,) or not np.all((weights >= 0) & (weights < np.inf)):
            raise InputError(
                f"weights must be {num_weights} finite numbers that are not negative, got {weights.tolist()}"
            )
        object.__setattr__(self, "weights", _read_only(weights, np.float64))

    def _check_endpoints(self) -> None:
        """Check that the start and the goal are free cells of the map.

        Raises:
          InputError: one of them is outside the map or not free.
        """
        where = "map" if self.levels_m is None else "volume"
        for name in ("start", "goal"):
            node = getattr(self, name)
            if not all(
                0 <= index < size for index, size in zip(node, self.is_free.shape, strict=True)
            ):
                raise InputError(
                    f"{name} {node} is outside the {where} of {self.is_free.shape} cells"
                )
            if not self.is_free[node]:
                raise InputError(f"{name} {node} is inside an obstacle: move it to a free cell")

    @property
    def distance_weight(self) -> float:
        """``w_0``, cost per metre."""
        return float(self.weights[0])

    @property
    def layer_weights(self) -> np.ndarray:
        """``[L]`` the weights of the layers."""
        return self.weights[1 : 1 + len(self.costs)]

    @property
    def height_costs(self) -> tuple[float, float]:
        """Cost per metre climbed and per metre descended, beside the distance; 0 on one altitude."""
        climb, descent = (0.0, 0.0) if self.levels_m is None else self.weights[-2:].tolist()
        return climb, descent

    def between(self, start: Cell, goal: Cell) -> "Problem":
        """Return the same query between other cells; the map, which is checked already, and its cache are shared.

        Raises:
          InputError: a cell is outside the map or inside an obstacle.
        """
        other = self._changed(start=start, goal=goal)
        other._check_endpoints()
        return other

    def alone(self) -> "Problem":
        """Return the same query with an empty cache, but for moves and map cost: no earlier search helps this one."""
        return self._changed(cache=ProblemCache(CellCache(self.moves), self.cost))

    def with_weights(self, weights: np.ndarray | float) -> "Problem":
        """Return the same query under other weights (see ``weights``); what does not depend on them is shared.

        Raises:
          InputError: a weight that is negative or not finite, or too many or too few.
        """
        other = self._changed(cache=ProblemCache(self.cache.cells))
        other._set_weights(weights)
        return other

    def with_costs(self, costs: np.ndarray, weights: np.ndarray | float | None = None) -> "Problem":
        """Return the same query with other layers ``[L, Y, X]`` and weights; what does not depend on them is shared.

        Raises:
          InputError: layers of another shape, or a cost on a free cell or a weight is negative or not finite.
        """
        other = replace(self, costs=costs, weights=self.weights if weights is None else weights)
        return other._changed(cache=ProblemCache(self.cache.cells))

    def features(self, points_m: np.ndarray) -> PathFeatures:
        """Return what a path adds up (see `planners.cost.path_features`): its cost is weights . features."""
        return path_features(self, points_m)

    def cost_of(self, points_m: np.ndarray) -> float:
        """Return the cost of a path (points as in `features`); inf where it is not valid."""
        return self.features(points_m).cost(self.weights)

    def checked_cost(self, points_m: np.ndarray) -> float:
        """Return the cost of a path (points as in `features`).

        Raises:
          InputError: the path is not valid.
        """
        cost = self.cost_of(points_m)
        if cost == np.inf:
            raise InputError(
                "the path crosses cells that are not free on this cost map, passes between two closed ones that touch "
                "at a corner, or leaves the map: give one that was planned on it"
            )
        return cost

    def _changed(self, **values: Any) -> "Problem":
        """Return a copy with other values of some attributes, which are not checked."""
        other = copy.copy(self)
        for name, value in values.items():
            object.__setattr__(other, name, value)
        return other

    @property
    def cost(self) -> np.ndarray:
        """``[Y, X]`` or ``[K, Y, X]`` float64 the weighted sum of the layers; inf where a volume is not free."""
        if self.cache.cost is None:
            cost = weighted_sum(self.costs, self.layer_weights)
            if self.levels_m is not None:
                cost[~self.is_free] = np.inf  # as the search through a volume knows closed nodes
            self.cache.cost = _read_only(cost, np.float64)
        return self.cache.cost

    @property
    def grid_name(self) -> str:
        """What grid planners search, in words: the neighbours that a cell has, and whether it has levels."""
        num = self.cost_model.connectivity
        if self.levels_m is None:
            return f"{num}-neighbour grid"
        return f"{3 * num + 2}-neighbour grid of levels"

    @property
    def is_by_length(self) -> bool:
        """Whether paths cost by their length in each cell: under ``line``, and where only length costs."""
        return self.cost_model.kind == "line" or not self.cost[self.is_free].any()

    @property
    def moves(self) -> np.ndarray:
        """``[Y, X]`` or ``[K, Y, X]`` uint8: bit k is set where horizontal step k of `planners.cost.STEPS` is allowed.

        They are kept for all queries with the same free cells.
        """
        cells = self.cache.cells
        if cells.moves is None:
            levels = self.is_free.reshape(-1, *self.is_free.shape[-2:])
            keeps_corners = self.cost_model.diagonal == "both-free" or self.leg_margin_m > 0
            allowed = [
                allowed_moves(is_free, self.cost_model.connectivity, keeps_corners)
                for is_free in levels
            ]
            cells.moves = _read_only(np.reshape(allowed, self.is_free.shape), np.uint8)
        return cells.moves

    @property
    def islands(self) -> np.ndarray:
        """``[Y, X]`` the number of the part of the map in which paths off the grid join a cell; 0: blocked."""
        return islands_of(self.is_free, self.cost_model.passes_corners and not self.leg_margin_m)

    @property
    def tile_minima(self) -> np.ndarray:
        """``[I + 2, J + 2]`` the cheapest free cell of every tile, in a frame (see `kernels.search.bounds`)."""
        if self.cache.tile_minima is None:
            self.cache.tile_minima = tile_minima(self.cost, self.is_free)
        return self.cache.tile_minima


def islands_of(is_free: np.ndarray, cuts_corners: bool) -> np.ndarray:
    """Return the number of the island of each free cell, from 1 up, and 0 where a cell is closed.

    An island is a set of free cells that are joined. Cells of one level join if they touch with a side, or also with a
    corner; cells of two levels only straight up and down, as every way that climbs also leads through such steps.

    Args:
      is_free: ``[Y, X]`` or ``[K, Y, X]`` bool; the result has the same shape.
      cuts_corners: whether cells that touch with a corner are joined.
    """
    from scipy.ndimage import generate_binary_structure, label

    joins = joins_on_level = generate_binary_structure(2, 2 if cuts_corners else 1)
    if is_free.ndim == 3:
        joins = generate_binary_structure(3, 1)  # the six cells that share a side
        joins[1] = joins_on_level
    islands, _ = label(is_free, joins)
    return islands


def way_to(node: int, parent: np.ndarray) -> list[int]:
    """Return the nodes on the way to a node, itself included, from the first, whose parent is `NO_PARENT`."""
    way = [node]
    while parent[way[-1]] != NO_PARENT:
        way.append(int(parent[way[-1]]))
    return way[::-1]


def grouped(
    problems: Sequence[Problem], chosen: Iterable[int], key: Callable[[Problem], Hashable]
) -> list[list[int]]:
    """Return the numbers of chosen problems, those with equal keys together."""
    groups: dict[Hashable, list[int]] = {}
    for index in chosen:
        groups.setdefault(key(problems[index]), []).append(index)
    return list(groups.values())


def cell_index(problem: Problem, cell: Cell) -> int:
    """Return the number of a cell in the problem's grid, row upon row."""
    return int(np.ravel_multi_index(cell, problem.is_free.shape))


def _read_only(values: np.ndarray, dtype: type) -> np.ndarray:
    """Return a contiguous read-only view, so that compiled searches meet one kind of array only."""
    view: np.ndarray = np.ascontiguousarray(values, dtype).view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, eq=False)
class Path:
    """What a planner found. ``N`` points.

    Attributes:
      status: how the planner ended.
      points_m: ``[N, 2]`` float64 x, y from the map's southwest corner (through a volume ``[N, 3]``: x, y,
        altitude); empty without a path. Grid planners give every cell centre, `ptp` every sample.
      cost: cost of the path under the problem's own model and objective; inf without a path.
      lower_bound: no path of this planner's graph is cheaper than this (-inf: nothing known).
      num_expanded: nodes expanded (edges evaluated for sampling planners).
      elapsed_s: seconds of the budget that were used: of the search, and of the tables that its heuristic needs.
      planner, heuristic, backend: what ran.
      note: one more sentence, where there is something to say.
      history: of an anytime planner, after each batch: seconds, samples drawn, cost of the best path.
      setup_s: seconds before the search, which count for no budget, in which code was compiled or loaded; 0 for none.
      graph: what OPTIMAL and ``lower_bound`` are of: a grid (`Problem.grid_name`) or `EVERY_PATH`; empty where
        nothing is known of others.
    """

    status: Status
    points_m: np.ndarray
    cost: float
    lower_bound: float
    num_expanded: int
    elapsed_s: float
    planner: str
    heuristic: str = "none"
    backend: str = "numpy"
    note: str = ""
    history: tuple[tuple[float, int, float], ...] = ()
    setup_s: float = 0.0
    graph: str = ""

    @classmethod
    def of(
        cls,
        problem: Problem,
        points_m: np.ndarray,
        status: Status,
        lower_bound: float,
        begin_s: float,
        *,
        note: str = "",
        graph: str | None = None,
        backend: str = "numba",
        **search: Any,
    ) -> Self:
        """Return a planner's result, its path costed along the exact cells.

        Args:
          problem: the query.
          points_m: ``[N, 2]`` (through a volume ``[N, 3]``) points of the path; of no elements without a path.
          status: how the planner ended. A path at any angle whose cost meets the bound becomes OPTIMAL.
          lower_bound: what the planner proved. For an OPTIMAL path its cost stands instead, for NO_PATH inf, and
            otherwise it is at most the cost.
          begin_s: time of `time.perf_counter` at which the planner began; ``elapsed_s`` counts from it.
          note: sentences about the search.
          graph: which paths the search chose from, as in the attributes; left out, the problem's grid.
          backend: ``"numba"``, ``"jax"`` or ``"numpy"``.
          search: other attributes, by name.
        """
        cost = np.inf
        if len(points_m):
            cost = problem.cost_of(points_m)
        else:
            points_m = np.empty((0, problem.is_free.ndim))
        if status.has_path and graph == EVERY_PATH and cost <= lower_bound * SAME_COST:
            status = Status.OPTIMAL
        if status is Status.OPTIMAL:
            lower_bound = cost
        elif status is Status.NO_PATH:
            lower_bound = np.inf
        else:
            lower_bound = min(lower_bound, cost)
        if problem.distance_weight == 0 and cost == 0 and NO_COST not in note:
            note = f"{note} {NO_COST}".lstrip()
        return cls(
            status=status,
            points_m=points_m,
            cost=cost,
            lower_bound=lower_bound,
            elapsed_s=time.perf_counter() - begin_s,
            note=note,
            graph=problem.grid_name if graph is None else graph,
            backend=backend,
            **search,
        )

    @property
    def ran(self) -> dict[str, Any]:
        """The attributes that say what ran, by name: a path that is made from this one gives them to `Path.of`."""
        names = (
            "num_expanded",
            "planner",
            "heuristic",
            "backend",
            "note",
            "history",
            "setup_s",
            "graph",
        )
        return {name: getattr(self, name) for name in names}

    @property
    def sentence(self) -> str:
        """What happened and, where it helps, the remedy; of the cheapest path, on which graph it is."""
        if self.status is not Status.OPTIMAL or not self.graph:
            return self.status.sentence
        if self.graph == EVERY_PATH:
            return "No path at any angle is cheaper: the cost meets a lower bound of them all."
        return f"The path is the cheapest one on the {self.graph}; one off it, at any angle, may be cheaper."

    @property
    def gap(self) -> float:
        """By what share the path may be costlier than the best one: (cost - lower_bound) / lower_bound.

        It is 0 where the cost meets the bound (both may be 0), and inf without a path or where the bound is not
        positive.
        """
        if not self.status.has_path:
            return np.inf
        if self.cost <= self.lower_bound:
            return 0.0
        return (self.cost - self.lower_bound) / self.lower_bound if self.lower_bound > 0 else np.inf


class Planner(Protocol):
    """A planner: a function of a problem and a budget."""

    def __call__(self, problem: Problem, *, budget_s: float, seed: int) -> Path:
        """Return the path found within ``budget_s`` seconds of search."""
