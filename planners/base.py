"""What every planner takes and gives: Problem, Path, Status, and the planner contract."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from scipy.ndimage import label

from jaxurban.errors import InputError
from jaxurban.kernels.heuristic import line_minima
from jaxurban.planners.moves import allowed_moves

CostKind = Literal["cell", "line"]
Diagonal = Literal["both-free", "always"]
Cell = tuple[int, int]  # row, column; row 0 in the south
T = TypeVar("T")

EXIT_PATH, EXIT_NO_PATH, EXIT_BUDGET = 0, 3, 4


class Status(Enum):
    """How a planner ended. The value is the name that files and ``--json`` carry."""

    OPTIMAL = "optimal"  # the best path of this planner's graph, proven
    FEASIBLE = "feasible"  # a path, with no proof that it is the best
    BUDGET_FEASIBLE = "budget-feasible"  # the budget ended with a path in hand
    NO_PATH = "no-path"  # proven: start and goal are not connected
    BLOCKED = "blocked"  # the straight line crosses an obstacle
    BUDGET_EMPTY = "budget-empty"  # the budget ended with no path

    @property
    def has_path(self) -> bool:
        """Whether a path was found."""
        return self in (Status.OPTIMAL, Status.FEASIBLE, Status.BUDGET_FEASIBLE)

    @property
    def exit_code(self) -> int:
        """The command line's exit code for this status."""
        if self.has_path:
            return EXIT_PATH
        return EXIT_BUDGET if self is Status.BUDGET_EMPTY else EXIT_NO_PATH

    @property
    def sentence(self) -> str:
        """What happened and, where it helps, the remedy."""
        return {
            Status.OPTIMAL: "The path is the cheapest one that this planner's graph holds.",
            Status.FEASIBLE: "A path was found; it is not proven to be the cheapest.",
            Status.BUDGET_FEASIBLE: "The budget ended with a path in hand; a larger one may find a cheaper path.",
            Status.NO_PATH: "No path of this planner's graph joins start and goal: fly higher, or move one of them.",
            Status.BLOCKED: "The straight line crosses an obstacle: fly higher, or use a search such as astar-dist.",
            Status.BUDGET_EMPTY: "The budget ended before a path was found: raise it, or try astar-anytime.",
        }[self]


@dataclass(frozen=True)
class CostModel:
    """How steps are charged, and which steps the grid allows: one argument, so that none of it is lost on the way.

    Attributes:
      kind: ``"cell"`` (the paper) or ``"line"`` (see `Problem`).
      reference_length_m: ``l_0`` of the line model.
      connectivity: 4 or 8 neighbours, for grid planners.
      diagonal: ``"both-free"`` allows a diagonal step only where both orthogonal neighbours are free, and no path of
        any planner between two blocked cells that touch at a corner; ``"always"`` allows either.

    Raises:
      InputError: a value that is none of these.
    """

    kind: CostKind = "cell"
    reference_length_m: float = 5.0
    connectivity: Literal[4, 8] = 8
    diagonal: Diagonal = "both-free"

    def __post_init__(self) -> None:
        if self.kind not in ("cell", "line"):
            raise InputError(f"cost_model must be 'cell' or 'line', got {self.kind!r}")
        if self.connectivity not in (4, 8):
            raise InputError(f"connectivity must be 4 or 8, got {self.connectivity}")
        if self.diagonal not in ("both-free", "always"):
            raise InputError(f"diagonal must be 'both-free' or 'always', got {self.diagonal!r}")
        object.__setattr__(self, "reference_length_m", positive_m("reference_length_m", self.reference_length_m))

    @classmethod
    def of(cls, given: "CostModel | CostKind") -> "CostModel":
        """Return a cost model as it is, or the one of a kind that is named."""
        return given if isinstance(given, CostModel) else cls(given)

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> "CostModel":
        """Return the model that settings give under the names of `settings`; what they leave out is the default."""
        given = {name: settings.get(name, default) for name, default in cls().settings.items()}
        return cls(given.pop("cost_model"), **given)

    @property
    def passes_corners(self) -> bool:
        """Whether a path may pass between two blocked cells that touch at a corner."""
        return self.diagonal == "always"

    @property
    def settings(self) -> dict[str, Any]:
        """The model under the names of its parts in scenarios and files, ``kind`` as ``cost_model``."""
        parts = asdict(self)
        return {"cost_model": parts.pop("kind"), **parts}

    @property
    def joins_corners(self) -> bool:
        """Whether a step may pass between two blocked cells that touch at a corner."""
        return self.connectivity == 8 and self.diagonal == "always"

    def __str__(self) -> str:
        return (
            f"{self.kind!r} (reference length {self.reference_length_m:g} m, {self.connectivity} neighbours, "
            f"diagonal steps {self.diagonal!r})"
        )


def positive_m(name: str, value: Any) -> float:
    """Return a length as a float.

    Raises:
      InputError: it is not a positive number of metres.
    """
    try:
        length_m = float(value)
    except (TypeError, ValueError):
        length_m = np.nan
    if not 0 < length_m < np.inf:
        raise InputError(f"{name} must be a positive number of metres, got {value}")
    return length_m


@dataclass(frozen=True, eq=False)
class Problem:
    """One planning question on one map, as plain arrays. ``Y`` rows, ``X`` columns, ``L`` layers.

    Points are in metres from the map's southwest corner: cell (row, col) has its centre at
    ``((col + 0.5) * resolution_m, (row + 0.5) * resolution_m)``.

    A step from cell P to cell Q of length d costs, under ``cell`` (the paper):
    ``distance_weight * d + c(Q)``; under ``line``:
    ``distance_weight * d + (1 / reference_length_m) * integral of c ds`` with c constant in each cell.

    The arrays are kept as read-only views (do not alter them meanwhile); many queries on one map share
    them, and what is derived from them, through `between`.

    Attributes:
      layers: ``[L, Y, X]`` float64 weighted cost layers ``w_j c_j``, >= 0 and finite on free cells.
      is_free: ``[Y, X]`` bool; a path may cross free cells only.
      start, goal: cells; paths begin and end at their centres.
      resolution_m: side of a cell.
      distance_weight: ``w_0``, cost per metre, >= 0.
      cost_model: how steps are charged, and which are allowed; its kind stands for the rest's defaults.
    """

    layers: np.ndarray
    is_free: np.ndarray
    start: Cell
    goal: Cell
    resolution_m: float
    distance_weight: float
    cost_model: CostModel = CostModel()
    cost: np.ndarray = field(init=False, repr=False)  # [Y, X] float64: the sum of the layers
    shared: dict[str, Any] = field(init=False, repr=False, default_factory=dict)  # what `once` made

    def __post_init__(self) -> None:
        layers = _read_only(self.layers, np.float64)
        is_free = _read_only(self.is_free, np.bool_)
        if layers.ndim != 3 or layers.shape[1:] != is_free.shape:
            raise InputError(f"layers must be [L, Y, X] over is_free [Y, X], got {layers.shape} and {is_free.shape}")
        object.__setattr__(self, "cost_model", CostModel.of(self.cost_model))
        positive_m("resolution_m", self.resolution_m)
        if not (np.isfinite(self.distance_weight) and self.distance_weight >= 0):
            raise InputError(f"the distance weight must be finite and not negative, got {self.distance_weight}")
        # Each layer, not only the sum, so that a negative one cannot hide behind another; NaN fails too.
        if not all(np.all(((layer >= 0) & (layer < np.inf))[is_free]) for layer in layers):
            raise InputError("costs must be finite and not negative on free cells: check the weights and the maps")
        object.__setattr__(self, "layers", layers)
        object.__setattr__(self, "is_free", is_free)
        object.__setattr__(self, "cost", _read_only(layers.sum(axis=0), np.float64))
        self._check_endpoints()

    def _check_endpoints(self) -> None:
        for name in ("start", "goal"):
            row, col = getattr(self, name)
            if not (0 <= row < self.is_free.shape[0] and 0 <= col < self.is_free.shape[1]):
                raise InputError(f"{name} {(row, col)} is outside the map of {self.is_free.shape} cells")
            if not self.is_free[row, col]:
                raise InputError(f"{name} {(row, col)} is inside an obstacle: move it to a free cell")

    def between(self, start: Cell, goal: Cell) -> "Problem":
        """Return the same question between other cells; the map, checked already, is shared.

        Raises:
          InputError: a cell is outside the map or inside an obstacle.
        """
        other = copy.copy(self)
        object.__setattr__(other, "start", start)
        object.__setattr__(other, "goal", goal)
        other._check_endpoints()
        return other

    def alone(self) -> "Problem":
        """Return the same question with nothing made for it but its moves, so that no earlier search helps this one."""
        other = copy.copy(self)
        object.__setattr__(other, "shared", {"moves": self.moves})
        return other

    def with_layers(self, layers: np.ndarray, distance_weight: float) -> "Problem":
        """Return the same question with other cost layers ``[L, Y, X]`` and distance weight.

        What does not depend on costs is shared.

        Raises:
          InputError: layers of another shape, or a cost on a free cell or the weight is negative or not finite.
        """
        other = replace(self, layers=layers, distance_weight=float(distance_weight))
        other.shared["moves"] = self.moves
        return other

    def reweighted(self, layer_factors: np.ndarray, distance_weight: float) -> "Problem":
        """Return the same question with each layer multiplied by a factor ``[L]``, and another distance weight.

        Raises:
          InputError: a factor or the distance weight is negative or not finite.
        """
        factors = np.asarray(layer_factors, np.float64)
        if not np.all((factors >= 0) & (factors < np.inf)):
            raise InputError(f"factors of layers must be finite and not negative, got {factors.tolist()}")
        return self.with_layers(self.layers * factors[:, None, None], distance_weight)

    def once(self, name: str, make: Callable[[], T]) -> T:
        """Return what ``make`` gives, made once for all queries on this map (see `between`)."""
        if name not in self.shared:
            self.shared[name] = make()
        made: T = self.shared[name]
        return made

    @property
    def moves(self) -> np.ndarray:
        """``[Y, X]`` uint8: bit k is set where step k of `moves.STEPS` is allowed."""
        return self.once(
            "moves",
            lambda: _read_only(
                allowed_moves(self.is_free, self.cost_model.connectivity, self.cost_model.diagonal == "both-free"),
                np.uint8,
            ),
        )

    @property
    def islands(self) -> np.ndarray:
        """``[Y, X]`` the number of the part of the map in which paths off the grid join a cell; 0: blocked."""
        return np.asarray(label(self.is_free, np.ones((3, 3)) if self.cost_model.passes_corners else None)[0])

    @property
    def line_minima(self) -> tuple[np.ndarray, np.ndarray]:
        """Cheapest free cell of every row ``[Y]`` and of every column ``[X]``."""
        return self.once("line_minima", lambda: line_minima(self.cost, self.is_free))


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
      elapsed_s: wall time of the search, compilation left out where it can be, and ``setup_s`` too.
      planner, heuristic, backend: what ran.
      note: one more sentence, where there is something to say.
      history: of an anytime planner, after each batch: seconds, samples drawn (of `astar-anytime`: nodes
        expanded), cost of the best path.
      bounds: of `astar-anytime`: the lower bound proven by each entry of ``history``.
      setup_s: what later queries on the same map (or goal) are spared: seconds spent on tables before the
        search; they count towards the budget.
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
    bounds: tuple[float, ...] = ()
    setup_s: float = 0.0

    @property
    def gap(self) -> float:
        """How much costlier the path may be than the best one: (cost - lower_bound) / lower_bound.

        0 where the bound is met (both 0 included); inf without a path, or where the bound is not positive.
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


def cell_centre_m(cell: Cell, resolution_m: float) -> tuple[float, float]:
    """Return x, y of a cell's centre, metres from the map's southwest corner."""
    row, col = cell
    return (col + 0.5) * resolution_m, (row + 0.5) * resolution_m
