"""One instance of a Monte Carlo benchmark under each of its planners: one cost map, and a row for each planner."""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from jaxurban.errors import InputError, at_least, positive, typed
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.planners.base import Cell, CostKind, Path, Status
from jaxurban.planners.cost_model import CostModel
from jaxurban.planners.registry import PLANNERS, find_planner
from jaxurban.presets import Preset
from jaxurban.scenario.settings import PAPER_PLANNERS
from jaxurban.studies.montecarlo.sampling import weighed_metrics
from jaxurban.world.grid import Grid

WEIGHTED, DISTANCE = "weighted", "distance"
CRASHED, BAD_INPUT, INVALID = "crashed", "bad-input", "invalid"  # beside the names of `Status`
KILLED = "Its worker process was killed again and again, most likely for lack of memory."
HAS_PATH = frozenset(status.value for status in Status if status.has_path)
COST_KINDS: tuple[CostKind, ...] = ("cell", "line")


class PlannerRun(NamedTuple):
    """A planner under an objective, ``"weighted"`` or ``"distance"``."""

    planner: str
    objective: str


class InstanceRules:
    """Base of the settings of a study, for what every instance's cost map is made under."""

    cost_model: CostModel | CostKind | None
    constraints: Constraints
    preset: str

    def cost_map(self, maps: MetricMaps, altitude_m: float, time: str | None, time_of_day: str | None) -> CostMap:
        """Return the cost map of instances at one altitude and time (errors as in `jaxurban.cost_map`)."""
        return cost_map(
            maps,
            altitude_m,
            cost_model=self.cost_model,
            time=time,
            time_of_day=time_of_day,
            constraints=self.constraints,
            preset=self.preset,
        )


@typed
@dataclass(frozen=True)
class BenchmarkSettings(InstanceRules):
    """How every instance is solved.

    Attributes:
      planners: each plans every instance.
      distance_only: planners that also plan the shortest path; its weighted cost is reported.
      cost_model: see `Problem`, or its kind alone. Costs are reported under both kinds.
      budget_s: seconds for each run.
      budget_iterations: instead, samples for planners that draw any, while the others run to their end: rows then
        repeat exactly, whatever the number of workers, but for ``elapsed_s``.
      seed: of the sampling of instances, and of sampling planners, mixed with the instance's number.
      constraints: no-fly zones, bounds and clearances that close cells to starts, goals and every planner.
      preset: ``"paper"`` for its cost model, obstacles and clearance instead of the defaults of what is left out here
        and in the scenario of the maps, from which the study takes what it gives.

    Raises:
      InputError: no planner, an unknown one, or an unknown preset.
    """

    planners: Sequence[str] | str = PAPER_PLANNERS
    distance_only: Sequence[str] | str = ("astar-dist",)
    cost_model: CostModel | CostKind | None = None
    budget_s: float = 2.0
    budget_iterations: int | None = None
    seed: int = 0
    constraints: Constraints = field(default_factory=Constraints)
    preset: str = ""

    def __post_init__(self) -> None:
        Preset.of(self.preset)  # refuses an unknown one, as the next line does
        CostModel.of(self.cost_model)
        for name in ("planners", "distance_only"):
            given = getattr(self, name)
            object.__setattr__(self, name, tuple(dict.fromkeys([given] if isinstance(given, str) else given)))
        if not self.planners:
            raise InputError("planners is empty: name at least one planner")
        for planner in (*self.planners, *self.distance_only):
            find_planner(planner)
        positive("budget_s", self.budget_s, "seconds")
        at_least("seed", self.seed)
        if self.budget_iterations is not None:
            at_least("budget_iterations", self.budget_iterations, 1)

    @property
    def runs(self) -> list[PlannerRun]:
        """What is run on every instance."""
        return [
            *(PlannerRun(name, WEIGHTED) for name in self.planners),
            *(PlannerRun(name, DISTANCE) for name in self.distance_only),
        ]

    def seed_of(self, instance: int) -> int:
        """Return the seed of sampling planners on an instance, by its number."""
        return int(np.random.SeedSequence([self.seed, instance]).generate_state(1)[0])

    def to_dict(self) -> dict[str, Any]:
        """Return what decides a row, but for its planner, as plain, JSON-ready values."""
        numbers = {name: getattr(self, name) for name in ("budget_s", "budget_iterations", "seed")}
        numbers["budget_s"] = float(self.budget_s)
        return {**CostModel.of(self.cost_model).settings, **numbers, "limits": self.constraints.to_dict()}

    def solve(self, on: CostMap, instance: Mapping[str, Any], runs: Sequence[tuple[str, ...]]) -> list[dict[str, Any]]:
        """Return a row (see `row_columns`) for each planner on an instance; a planner that crashes is a row too."""
        return solve_instance(on, instance, [PlannerRun(*run) for run in runs], self)

    def killed(self, instance: Mapping[str, Any], run: tuple[str, ...]) -> dict[str, Any]:
        """Return the row of a planner whose worker was killed again and again."""
        return row_of(instance, PlannerRun(*run), status=CRASHED, note=KILLED)


NUMBERS = ("cost", "cost_cell", "cost_line", "search_cost", "lower_bound", "gap", "length_m", "detour")


def row_columns(instance: Iterable[Any] = ()) -> dict[str, str]:
    """Return the columns of the rows with their types, for instances of these columns."""
    return {
        "instance": "int64",
        "altitude_m": "float64",
        **dict.fromkeys(("planner", "objective", "status"), "object"),
        **dict.fromkeys((*NUMBERS, *(f"m_{name}" for name in weighed_metrics(instance))), "float64"),
        **dict.fromkeys(("elapsed_s", "setup_s", "num_expanded", "num_samples"), "float64"),
        **dict.fromkeys(("heuristic", "backend", "note"), "object"),
    }


def free_cell(grid: Grid, is_free: np.ndarray, x_m: float, y_m: float) -> Cell:
    """Return the cell of a place.

    Raises:
      InputError: it is outside the grid, or not free.
    """
    row, col = (int(value) for value in grid.cell_of_xy(x_m, y_m))
    if not is_free[row, col]:
        raise InputError(
            f"the place {x_m:.1f}, {y_m:.1f} is inside an obstacle, where there are no data, or closed by a constraint"
        )
    return row, col


def solve_instance(
    on: CostMap, instance: Mapping[str, Any], runs: Sequence[PlannerRun], settings: BenchmarkSettings
) -> list[dict[str, Any]]:
    """Return a row (see `row_columns`) for each planner on an instance; a planner that crashes is a row too."""
    weights = np.array([float(instance[f"w_{name}"]) for name in on.weight_names])
    ends = ((instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal"))
    try:
        start, goal = (free_cell(on.grid, on.is_free, x_m, y_m) for x_m, y_m in ends)
        shortest = on.shortest.between(start, goal)
    except InputError as error:
        return [row_of(instance, run, status=BAD_INPUT, note=str(error)) for run in runs]
    by_objective = {DISTANCE: shortest}
    if any(run.objective == WEIGHTED for run in runs):
        by_objective[WEIGHTED] = shortest.with_weights(weights)
    seed = settings.seed_of(int(instance["instance"]))
    rows = []
    for run in runs:
        try:
            found = limited(run.planner, settings)(by_objective[run.objective].alone(), seed=seed)
            facts = _facts(on, found, weights, run)
        except Exception as error:  # whatever a planner does, the benchmark goes on
            facts = {"status": CRASHED, "note": f"{type(error).__name__}: {error}"}
        rows.append(row_of(instance, run, **facts))
    return rows


def limited(planner: str, settings: BenchmarkSettings) -> Callable[..., Path]:
    """Return a planner under the benchmark's budget: seconds, or samples where it draws any."""
    search: Callable[..., Path] = find_planner(planner)
    if settings.budget_iterations is None:
        return partial(search, budget_s=settings.budget_s)
    if draws_samples(planner):
        search = partial(search, max_samples=settings.budget_iterations)
    return partial(search, budget_s=math.inf)


def draws_samples(planner: str) -> bool:
    """Return whether a planner draws samples."""
    return "max_samples" in inspect.signature(PLANNERS[planner].run).parameters


def _facts(on: CostMap, found: Path, weights: np.ndarray, run: PlannerRun) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "status": found.status.value,
        "lower_bound": found.lower_bound,
        "elapsed_s": found.elapsed_s,
        "setup_s": found.setup_s,
        "num_expanded": int(found.num_expanded),
        "num_samples": found.history[-1][1] if draws_samples(run.planner) and found.history else None,
        "heuristic": found.heuristic,
        "backend": found.backend,
        "note": found.note,
    }
    if not found.status.has_path:
        return facts
    features = {kind: on.shortest.features(found.points_m, kind) for kind in COST_KINDS}
    of_path = features[on.cost_model.kind]
    if not of_path.is_valid:
        return facts | {"status": INVALID, "note": "The planner's path crosses an obstacle or leaves the map."}
    straight_m, length_m = float(np.hypot(*(found.points_m[-1] - found.points_m[0]))), float(of_path.phi[0])
    facts |= {f"cost_{kind}": features[kind].cost(weights) for kind in COST_KINDS}
    facts |= {f"m_{name}": m for name, m in on.means(of_path).items()}
    return facts | {
        "cost": of_path.cost(weights),
        "length_m": length_m,
        "search_cost": found.cost,
        "gap": found.gap,
        "detour": length_m / straight_m if straight_m > 0 else None,
    }


def row_of(instance: Mapping[str, Any], run: PlannerRun, **facts: Any) -> dict[str, Any]:
    """Return a whole row: the instance's key, the run, and what is known; None for what is not, or is not a number."""
    key = {"instance": int(instance["instance"]), "altitude_m": float(instance["altitude_m"])}
    row = dict.fromkeys(row_columns(instance)) | key | run._asdict() | facts
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in row.items()
    }
