"""Under a preset: the one place where what a caller leaves out of a query takes its default."""

from dataclasses import dataclass
from typing import Any

from jaxurban.errors import InputError, at_least
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import GivenWeights, Weights
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.snapping import snap_limit_m
from jaxurban.paths.vehicle import Vehicle
from jaxurban.planners.base import CostKind
from jaxurban.planners.cost_model import CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.presets import BUDGET_S, planning_under


def under_preset(
    preset: str, maps: MetricMaps, cost_model: CostModel | CostKind | None, constraints: Constraints | None
) -> tuple[MetricMaps, CostModel, Constraints]:
    """Return maps, cost model and constraints of routes.

    What is left out is as it was given in the maps' scenario (`MetricMaps.recorded`), and else as the preset has it.

    Args:
      preset: a name (`jaxurban.presets.PRESETS`), ``""`` for the scenario's, else the defaults.
      maps: under their rule of obstacles, or none of their own.
      cost_model: taken whole, or its kind alone.
      constraints: None: no zones and no bounds.

    Raises:
      InputError: an unknown preset, or recorded settings that are none.
    """
    planning = planning_under(preset, maps.recorded.get("planning", {}))
    if preset and maps.rule is None:
        maps = maps.with_obstacles(planning["obstacles"])
    if not isinstance(cost_model, CostModel):
        cost_model = CostModel.from_settings(planning | ({} if cost_model is None else {"cost_model": cost_model}))
    limits = Constraints() if constraints is None else constraints
    return maps, cost_model, limits.under(planning, Vehicle(**maps.recorded.get("vehicle", {})))


def weights_on(maps: MetricMaps, given: GivenWeights) -> Weights:
    """Return weights that are given whole, or with what they do not name as the maps' scenario has it.

    Raises:
      InputError: a weight that is none, or of a metric that the maps do not hold.
    """
    return Weights.of(given, maps.recorded.get("weights")).checked(maps.metrics)


def objective_on(maps: MetricMaps, objective: str | None) -> str:
    """Return an objective, where none is given as the maps' scenario has it."""
    return objective or maps.recorded.get("planning", {}).get("objective", "weighted")


@dataclass(frozen=True)
class PathSearch:
    """How a path is searched for: what does not change the map.

    Attributes:
      planner: ``"ptp"``, ``"astar-dist"``, ``"astar-plus"`` ...
      heuristic: left out, the planner's own.
      budget_s: seconds that the search may take.
      seed: for sampling planners.
      snap: move a start or goal inside an obstacle or closed by a constraint to the nearest free cell instead of
        failing: True by at most 50 m, a number by at most so many metres. The path's message says how far.
      refine: move the waypoints of what the planner found downhill, off the grid (`planners.refine`); within what
        is left of the budget. It takes the ``line`` cost model, or the ``distance`` objective.
    """

    planner: str
    heuristic: str | None = None
    budget_s: float = BUDGET_S
    seed: int = 0
    snap: bool | float = False
    refine: bool = False

    @classmethod
    def of(cls, maps: MetricMaps | None = None, *, is_for_volumes: bool = False, **given: Any) -> "PathSearch":
        """Return a search whose values can be, what is left out (or None) as the maps' scenario says it.

        Args:
          maps: None where no scenario is asked.
          is_for_volumes: whether the path may climb, for which no scenario names planner or seed.
          given: the attributes.

        Raises:
          InputError: an unknown planner, a heuristic that it does not take, a wrong seed, budget or distance of
            snapping, or refinement of a path that may climb.
        """
        recorded = {} if maps is None else maps.recorded.get("planning", {})
        names = ("budget_s",) if is_for_volumes else ("budget_s", "planner", "seed")
        chosen = {"planner": "astar-volume" if is_for_volumes else "astar-plus"}
        chosen |= {name: recorded[name] for name in names if name in recorded}
        search = cls(**chosen | {name: value for name, value in given.items() if value is not None})
        at_least("seed", search.seed)
        if not search.budget_s > 0:
            raise InputError(f"budget_s must be a positive number of seconds, got {search.budget_s}")
        snap_limit_m(search.snap)
        if is_for_volumes and search.refine:
            raise InputError("refine moves waypoints on one altitude: leave it out of a path that climbs and descends")
        find_planner(search.planner, search.heuristic, is_for_volumes=is_for_volumes)
        return search
