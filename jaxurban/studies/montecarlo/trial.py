"""One instance of a Monte Carlo benchmark under each of its planners: one cost map, and a row for each planner."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.tables import Row
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.scenario import Study
from jaxurban.paths.constraints import describe_constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.rows import CRASHED, RouteJob, Run, failure
from jaxurban.planners.base import Cell, Path
from jaxurban.planners.corners import with_corner_bound
from jaxurban.planners.registry import EXACT_PLANNERS, SAMPLING_PLANNERS, find_planner
from jaxurban.studies.decided import edge_band, is_at_edge
from jaxurban.studies.montecarlo.sampling import KEY, weighed_metrics

WEIGHTED, DISTANCE = "weighted", "distance"
INVALID = "invalid"  # beside the names of `Status` and what `jaxurban.paths.rows` adds


@dataclass(frozen=True, kw_only=True)
class Benchmark(RouteJob):
    """Every planner of a study on every instance, under one set of rules.

    Attributes:
      study: planners and budgets.
      cost_model, constraints, preset: see `jaxurban.paths.rows.RouteRules`.
    """

    study: Study = field(default_factory=Study)

    key = (*KEY, "planner", "objective")
    run_key = ("planner", "objective")

    @property
    def runs(self) -> list[Run]:
        """Each planner with its objective, ``"weighted"`` or ``"distance"``."""
        return [
            *((name, WEIGHTED) for name in self.study.planners),
            *((name, DISTANCE) for name in self.study.distance_only),
        ]

    def seed_of(self, instance: int) -> int:
        """Return the seed of sampling planners on an instance, by its number."""
        return int(np.random.SeedSequence([self.study.seed, instance]).generate_state(1)[0])

    def deciding(self, maps: MetricMaps) -> dict[str, Any]:
        """Return what decides a benchmark's rows on maps, by name; the names are shown where two benchmarks differ.

        Zones count by their outlines, whatever file holds them, and only the budget that is used counts.
        """
        rules = self.rules()
        limits = rules.pop("limits")
        budget = f"{float(self.study.budget_s)} s"
        if self.study.budget_iterations is not None:
            budget = f"{self.study.budget_iterations} samples"
        outlines = [zone.get("outline", "") for zone in limits.get("no_fly", ())]
        return {
            **rules,
            "seed": self.study.seed,
            "budget": budget,
            "set of constraints": describe_constraints(limits) or "none",
            "outlines of no-fly zones": ", ".join(outlines),
            **maps.identity,
        }

    def facts(
        self, cost_map: CostMap, instance: Row, runs: Sequence[Run]
    ) -> Iterator[dict[str, Any]]:
        """Yield the columns of a row (see `row_columns`) for each run on an instance, in their order.

        A planner that crashes is an outcome too: its row has the status `CRASHED` and the error as its note.

        Args:
          cost_map: at the instance's altitude and times.
          instance: its ends and weights.
          runs: planners, each with its objective.

        Raises:
          InputError: a place that is not a free cell.
        """
        start, goal, weights = ends_and_weights(cost_map, instance)
        shortest = cost_map.shortest.between(start, goal)
        problems = {DISTANCE: shortest}
        if any(objective == WEIGHTED for _, objective in runs):
            problems[WEIGHTED] = shortest.with_weights(weights)
        seed = self.seed_of(int(instance["instance"]))
        band = edge_band(cost_map.maps)
        for planner, objective in runs:
            problem = problems[objective]
            try:
                # Alone: no planner may profit from tables that an earlier one has made.
                path = limited(planner, self.study)(problem.alone(), seed=seed)
                facts = _facts(cost_map, with_corner_bound(problem, path), weights, planner)
                if "cost" in facts:
                    facts["at_edge"] = float(is_at_edge(path.points_m, cost_map.grid, band))
                yield facts
            except Exception as error:  # whatever a planner does, the benchmark goes on
                yield {**failure(error), "status": CRASHED}

    def row_of(self, instance: Row, run: Run, facts: Row) -> dict[str, Any]:
        """Return a whole row (see `row_columns`)."""
        return dict.fromkeys(row_columns(instance)) | super().row_of(instance, run, facts)


NUMBERS = (
    "cost",
    "search_cost",
    "lower_bound",
    "gap",
    "length_m",
    "detour",
    "at_edge",
)


def row_columns(instance: Iterable[Any] = ()) -> dict[str, str]:
    """Return the columns of the rows, in order, with the names of their Pandas types.

    Args:
      instance: the columns of the instances, whose weights name the metrics of the columns ``m_NAME``.
    """
    means = [f"m_{name}" for name in weighed_metrics(instance)]
    efforts = ("elapsed_s", "setup_s", "num_expanded", "num_samples")
    return {
        "instance": "int64",
        "altitude_m": "float64",
        **dict.fromkeys(("planner", "objective", "status"), "object"),
        **dict.fromkeys((*NUMBERS, *means, *efforts), "float64"),
        **dict.fromkeys(("heuristic", "backend", "note"), "object"),
    }


def ends_and_weights(cost_map: CostMap, instance: Row) -> tuple[Cell, Cell, np.ndarray]:
    """Return the start, the goal (cells, row and column) and the weights ``[K]`` of an instance.

    Args:
      cost_map: with the free cells, and the names of the weights.
      instance: its ends in metres in the CRS of the maps, and a weight ``w_NAME`` for each name.

    Raises:
      InputError: an end that is outside the maps, or no free cell.
    """
    cells = []
    for end in ("start", "goal"):
        x_m, y_m = instance[f"{end}_x_m"], instance[f"{end}_y_m"]
        row, col = map(int, cost_map.grid.cell_of_xy(x_m, y_m))
        if not cost_map.is_free[row, col]:
            raise InputError(
                f"the place {x_m:.1f}, {y_m:.1f} is inside an obstacle, where there are no data, or closed by a "
                "constraint"
            )
        cells.append((row, col))
    start, goal = cells
    return start, goal, np.array([float(instance[f"w_{name}"]) for name in cost_map.weight_names])


def limited(planner: str, study: Study) -> Callable[..., Path]:
    """Return a planner that takes a problem, under the budget of a study.

    Args:
      planner: its name.
      study: its budget is in seconds, or in samples: then a planner that draws no samples has no limit.
    """
    if study.budget_iterations is None:
        is_in_jax = study.backend == "jax" and planner in (*EXACT_PLANNERS, *SAMPLING_PLANNERS)
        search = find_planner(planner, backend="jax" if is_in_jax else "auto")
        return partial(search, budget_s=study.budget_s)
    search = find_planner(planner)
    if planner in SAMPLING_PLANNERS:
        search = partial(search, max_samples=study.budget_iterations)
    return partial(search, budget_s=math.inf)


def _facts(cost_map: CostMap, result: Path, weights: np.ndarray, planner: str) -> dict[str, Any]:
    """Return the columns of one planner's run (see `row_columns`): how it ended, and what its path costs.

    Only a valid path has costs. A path that crosses an obstacle has the status `INVALID`, whatever its planner says.

    Args:
      cost_map: of the instance; costs are counted on it, and not taken from the planner.
      result: of the planner.
      weights: ``[K]`` of the instance; a run with the objective ``"distance"`` is judged by them too.
      planner: its name.
    """
    # How the run ended; a planner that draws samples has their number in each entry of its history.
    num_samples = None
    if planner in SAMPLING_PLANNERS and result.history:
        _, num_samples, _ = result.history[-1]
    facts = {
        "status": result.status.value,
        "lower_bound": result.lower_bound,
        "elapsed_s": result.elapsed_s,
        "setup_s": result.setup_s,
        "num_expanded": int(result.num_expanded),
        "num_samples": num_samples,
        "heuristic": result.heuristic,
        "backend": result.backend,
        "note": result.note,
    }
    if not result.status.has_path:
        return facts

    of_path = cost_map.shortest.features(result.points_m)
    if not of_path.is_valid:
        return facts | {
            "status": INVALID,
            "note": "The planner's path crosses an obstacle or leaves the map.",
        }

    # What it costs, and how long it is beside the straight line.
    straight_m = float(np.hypot(*(result.points_m[-1] - result.points_m[0])))
    length_m = float(of_path.phi[0])
    facts |= {f"m_{name}": m for name, m in cost_map.means(of_path).items()}
    return facts | {
        "cost": of_path.cost(weights),
        "length_m": length_m,
        "search_cost": result.cost,
        "gap": result.gap,
        "detour": length_m / straight_m if straight_m > 0 else None,
    }
