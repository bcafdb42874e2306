"""Under a preset: the one place where what a caller leaves out of a query takes its default."""

from typing import Any

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import GivenWeights, Weights
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.vehicle import Vehicle
from jaxurban.planners.cost import CostKind
from jaxurban.planners.cost_model import CostModel
from jaxurban.presets import planning_under


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


def search_on(maps: MetricMaps, *, is_for_volumes: bool = False, **given: Any) -> dict[str, Any]:
    """Return how a path is searched for, by name: what is given (not None), and else what the maps' scenario says.

    Args:
      maps: the maps.
      is_for_volumes: whether the path may climb, for which no scenario names planner or seed.
      given: as in `jaxurban.plan`.
    """
    names = ("objective", "budget_s", *(() if is_for_volumes else ("planner", "seed")))
    planning = maps.recorded.get("planning", {})
    stored = {name: planning[name] for name in names if name in planning}
    return stored | {name: value for name, value in given.items() if value is not None}
