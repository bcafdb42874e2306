"""One instance of a study put to its planners: the maps made ready once, and a row for each planner."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from jaxurban.cost import METRICS
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.planners.base import Cell, CostKind, CostModel, Path, Problem
from jaxurban.planners.evaluate import evaluate
from jaxurban.planners.registry import PLANNERS, find_planner

WEIGHTED, DISTANCE = "weighted", "distance"
CRASHED, BAD_INPUT, INVALID = "crashed", "bad-input", "invalid"  # beside the names of `Status`
BLOCK_ROWS = 32  # of a map, weighed at a time, so that they stay in the cache
COST_KINDS: tuple[CostKind, ...] = ("cell", "line")


@dataclass(frozen=True)
class Run:
    """A planner under an objective, ``"weighted"`` or ``"distance"``."""

    planner: str
    objective: str


@dataclass(frozen=True)
class Settings:
    """How every instance is asked.

    Attributes:
      cost_model: see `Problem`.
      budget_s: seconds for each run.
      budget_iterations: instead, samples for planners that draw any; the others run to their end.
      seed: of sampling planners, mixed with the instance's number.
      limits: no-fly zones and bounds that close cells to every planner.
    """

    cost_model: CostModel = field(default_factory=lambda: CostModel("line"))
    budget_s: float = 2.0
    budget_iterations: int | None = None
    seed: int = 0
    limits: Limits = field(default_factory=Limits)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain, JSON-ready values."""
        told = {name: getattr(self, name) for name in ("budget_s", "budget_iterations", "seed")}
        return {**self.cost_model.settings, **told, "limits": self.limits.to_dict()}


NUMBERS = ("cost", "cost_cell", "cost_line", "search_cost", "lower_bound", "gap", "length_m", "detour")
COLUMNS = {  # of the rows, with their types
    "instance": "int64",
    "altitude_m": "float64",
    **dict.fromkeys(("planner", "objective", "status"), "object"),
    **dict.fromkeys((*NUMBERS, *(f"m_{name}" for name in METRICS)), "float64"),
    **dict.fromkeys(("elapsed_s", "num_expanded", "num_samples"), "float64"),
    **dict.fromkeys(("heuristic", "backend", "note"), "object"),
}


class Ground:
    """The maps at one altitude and time, ready for any weights. ``L`` metrics, ``Y`` rows, ``X`` columns.

    Attributes:
      names: the metrics.
      costs: ``[L, Y, X]`` float32 the costs c_j, 0 where there are no data.
      is_free: ``[Y, X]`` bool, where a path may fly.
    """

    def __init__(
        self, maps: MetricMaps, altitude_m: float, time: str | None, time_of_day: str | None, settings: Settings
    ) -> None:
        """Read the maps; arguments and errors as in `weigh`."""
        self.grid, self.settings = maps.grid, settings
        self.is_free = settings.limits.is_free(maps, altitude_m, time=time, time_of_day=time_of_day)
        costs = maps.costs(altitude_m, time=time, time_of_day=time_of_day)
        self.names = tuple(costs)
        self.costs = np.stack([np.nan_to_num(np.asarray(cost, np.float32)) for cost in costs.values()])

    @cached_property
    def shortest(self) -> Problem:
        """The problem of the shortest path, from the first free cell to itself.

        Raises:
          InputError: no cell is free.
        """
        if not self.is_free.any():
            raise InputError("no cell is free at this altitude: fly higher, or loosen the limits")
        row, col = np.unravel_index(np.argmax(self.is_free), self.is_free.shape)
        return Problem(
            layers=np.zeros((1, *self.is_free.shape)),
            is_free=self.is_free,
            start=(int(row), int(col)),
            goal=(int(row), int(col)),
            resolution_m=self.grid.resolution_m,
            distance_weight=1.0,
            cost_model=self.settings.cost_model,
        )

    def weighed(self, weights: np.ndarray) -> Problem:
        """Return the problem under weights ``[1 + L]``, distance first, with the layers summed into one."""
        total = np.empty((1, *self.is_free.shape))
        for low in range(0, total.shape[1], BLOCK_ROWS):
            rows = slice(low, low + BLOCK_ROWS)
            total[0, rows] = np.tensordot(weights[1:], self.costs[:, rows].astype(np.float64), axes=1)
        return self.shortest.with_layers(total, float(weights[0]))

    def cell_of(self, x_m: float, y_m: float) -> Cell:
        """Return the cell of a place (`free_cell`)."""
        return free_cell(self.grid, self.is_free, x_m, y_m)

    def facts(self, points_m: np.ndarray, weights: np.ndarray) -> dict[str, float] | None:
        """Return cost under both models, length and mean metrics of a path ``[N, 2]``; None if it is not valid."""
        facts: dict[str, float] = {}
        for kind in COST_KINDS:
            paid = evaluate(
                points_m,
                self.costs,
                self.is_free,
                self.grid.resolution_m,
                1.0,
                replace(self.settings.cost_model, kind=kind),
            )
            if not paid.is_valid:
                return None
            facts[f"cost_{kind}"] = float(weights[0] * paid.length_m + weights[1:] @ paid.per_layer)
        crossed = paid.crossings
        length_m = crossed.length_m if paid.length_m > 0 else np.ones(1)
        for name, along in zip(self.names, self.costs[:, crossed.row, crossed.col].astype(np.float64), strict=True):
            m = along if name == "population" else 1.0 - along
            facts[f"m_{name}"] = float(m @ length_m / length_m.sum())
        return facts | {"length_m": paid.length_m}


def free_cell(grid: Grid, is_free: np.ndarray, x_m: float, y_m: float) -> Cell:
    """Return the cell of a place.

    Raises:
      InputError: it is outside the grid, or not free.
    """
    row, col = (int(value) for value in grid.cell_of_xy(x_m, y_m))
    if not is_free[row, col]:
        raise InputError(
            f"the place {x_m:.1f}, {y_m:.1f} is inside an obstacle, where there are no data, or closed by a limit"
        )
    return row, col


def put_to(ground: Ground, instance: Mapping[str, Any], runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return a row (see `COLUMNS`) for each planner that is asked an instance; a planner that crashes is a row too."""
    settings = ground.settings
    weights = np.array([float(instance[f"w_{name}"]) for name in ("distance", *ground.names)])
    number = int(instance["instance"])
    head = {"instance": number, "altitude_m": float(instance["altitude_m"])}
    try:
        start, goal = (ground.cell_of(instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal"))
        weighed = ground.weighed(weights) if any(run.objective == WEIGHTED for run in runs) else ground.shortest
    except InputError as error:
        return [row_of(head, run, status=BAD_INPUT, note=str(error)) for run in runs]
    seed = int(np.random.SeedSequence([settings.seed, number]).generate_state(1)[0])
    rows = []
    for run in runs:
        problem = weighed if run.objective == WEIGHTED else ground.shortest
        try:
            found = limited(run.planner, settings)(problem.between(start, goal).alone(), seed=seed)
            facts = _facts(ground, found, weights, run)
        except Exception as error:  # whatever a planner does, the study goes on
            facts = {"status": CRASHED, "note": f"{type(error).__name__}: {error}"}
        rows.append(row_of(head, run, **facts))
    return rows


def limited(planner: str, settings: Settings) -> Callable[..., Path]:
    """Return a planner under the study's budget: seconds, or samples where it draws any."""
    search: Callable[..., Path] = find_planner(planner)
    if settings.budget_iterations is None:
        return partial(search, budget_s=settings.budget_s)
    if draws_samples(planner):
        search = partial(search, max_samples=settings.budget_iterations)
    return partial(search, budget_s=math.inf)


def draws_samples(planner: str) -> bool:
    """Return whether a planner draws samples."""
    return "max_samples" in inspect.signature(PLANNERS[planner].run).parameters


def _facts(ground: Ground, found: Path, weights: np.ndarray, run: Run) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "status": found.status.value,
        "lower_bound": found.lower_bound,
        "elapsed_s": found.elapsed_s + found.setup_s,
        "num_expanded": int(found.num_expanded),
        "num_samples": found.history[-1][1] if draws_samples(run.planner) and found.history else None,
        "heuristic": found.heuristic,
        "backend": found.backend,
        "note": found.note,
    }
    if not found.status.has_path:
        return facts
    paid = ground.facts(found.points_m, weights)
    if paid is None:
        return facts | {"status": INVALID, "note": "The planner's path crosses an obstacle or leaves the map."}
    straight_m = float(np.hypot(*(found.points_m[-1] - found.points_m[0])))
    return (
        facts
        | paid
        | {
            "cost": paid[f"cost_{ground.settings.cost_model.kind}"],
            "search_cost": found.cost,
            "gap": found.gap,
            "detour": paid["length_m"] / straight_m if straight_m > 0 else None,
        }
    )


def row_of(head: Mapping[str, Any], run: Run, **facts: Any) -> dict[str, Any]:
    """Return a whole row: the instance's key, the run, and what is known; None for what is not, or is no number."""
    row = dict.fromkeys(COLUMNS) | dict(head) | {"planner": run.planner, "objective": run.objective} | facts
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in row.items()
    }
