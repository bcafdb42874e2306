"""What is asked of a path: which map, and how to search; the one place where what is left out takes its default."""

from dataclasses import dataclass
from typing import Any, get_args

from jaxurban.errors import InputError, at_least, one_of, typed
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import GivenWeights, Weights
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.snapping import snap_limit_m
from jaxurban.planners.cost_model import CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.settings import DEFAULTS, CostKind, Objective, Vehicle


def weights_on(maps: MetricMaps, given: GivenWeights) -> Weights:
    """Return weights that are given whole, or with what they do not name as the maps' scenario has it.

    Raises:
      InputError: a weight that is none, or of a metric that the maps do not hold.
    """
    return Weights.of(given, maps.recorded.get("weights")).checked(maps.metrics)


@dataclass(frozen=True, eq=False, kw_only=True)
class MapQuery:
    """Which map a path is planned on, beside the altitude.

    Attributes:
      time: UTC time of the GPS map; None: the first.
      time_of_day: of the population map; None: the first.
      weights: of the path's cost.
      objective: ``"weighted"``, or ``"distance"`` for the shortest path (its weighted cost is reported).
      cost_model: how steps are costed and which are allowed.
      constraints: no-fly zones, bounds on maps and clearances; no path enters a cell that they close. A zone between
        two levels closes the lower one.
    """

    time: str | None
    time_of_day: str | None
    weights: Weights
    objective: str
    cost_model: CostModel
    constraints: Constraints

    @classmethod
    @typed
    def of(
        cls,
        maps: MetricMaps,
        *,
        weights: GivenWeights = None,
        objective: str | None = None,
        cost_model: CostModel | CostKind | None = None,
        time: str | None = None,
        time_of_day: str | None = None,
        constraints: Constraints | None = None,
        preset: str = "",
    ) -> "tuple[MetricMaps, MapQuery]":
        """Return maps under their rule of obstacles, and the query, left out in which is what their scenario says.

        Args:
          maps: from `build_maps` or `open_maps`, under their rule of obstacles, or none of their own: the preset's.
          weights: numbers by name leave the others as the scenario has them, or as in `Weights()`.
          objective: if nothing names it, ``"weighted"``.
          cost_model: or its kind alone: ``"line"``, the default, or ``"cell"`` (the paper).
          time, time_of_day: where a time is named, zones that are not in force then, nor within an hour, close nothing
            (`Constraints.at`).
          constraints: from `Constraints.read`. Left out, paths keep 3 m over roofs.
          preset: ``"paper"`` for the paper's ``cell``, obstacles at centres and no clearance, instead of the defaults
            of what is left out here and in the scenario.

        Raises:
          InputError: an unknown preset, objective or cost model, or a wrong weight.
        """
        planning = maps.planning.under(preset)
        if preset and maps.rule is None:
            maps = maps.with_obstacles(planning.obstacles)
        if not isinstance(cost_model, CostModel):
            cost_model = CostModel.from_settings(vars(planning) | ({"cost_model": cost_model} if cost_model else {}))
        limits = Constraints() if constraints is None else constraints
        return maps, MapQuery(
            time=time,
            time_of_day=time_of_day,
            weights=weights_on(maps, weights),
            objective=one_of("objective", objective or planning.objective, get_args(Objective)),
            cost_model=cost_model,
            constraints=limits.under(planning, Vehicle(**maps.recorded.get("vehicle", {}))),
        )


@dataclass(frozen=True)
class PathSearch:
    """How a path is searched for: what does not change the map.

    Attributes:
      planner: ``"ptp"``, ``"astar-dist"``, ``"astar-plus"`` ...
      heuristic: None: the planner's own.
      budget_s: seconds that the search may take.
      seed: for sampling planners.
      snap: move a start or goal inside an obstacle or closed by a constraint to the nearest free cell (of its level)
        that is joined to the other end, instead of failing: True by at most 50 m, a number by at most so many metres.
        The path's message says how far.
      refine: move the waypoints of what the planner found downhill, off the grid (`planners.refine`); within what
        is left of the budget. It takes the ``line`` cost model, or the ``distance`` objective.
    """

    planner: str
    heuristic: str | None = None
    budget_s: float = DEFAULTS.budget_s
    seed: int = DEFAULTS.seed
    snap: bool | float = False
    refine: bool = False

    @classmethod
    @typed
    def of(
        cls,
        maps: MetricMaps | None = None,
        is_for_volumes: bool = False,
        *,
        planner: str | None = None,
        heuristic: str | None = None,
        budget_s: float | None = None,
        seed: int | None = None,
        snap: bool | float = False,
        refine: bool = False,
    ) -> "PathSearch":
        """Return a search whose values can be; what is left out is as the maps' scenario says it.

        Args:
          maps: None where no scenario is asked.
          is_for_volumes: whether the path may climb, for which no scenario names planner or seed.
          planner: if nothing names it, ``"astar-plus"``, and between levels ``"astar-volume"``.
          heuristic, budget_s, seed, snap, refine: the attributes.

        Raises:
          InputError: an unknown planner, a heuristic that it does not take, a wrong seed, budget or distance of
            snapping, or refinement of a path that may climb.
        """
        planning = DEFAULTS if maps is None else maps.planning
        chosen: dict[str, Any] = {"planner": planning.planner, "seed": planning.seed}
        chosen = {"budget_s": planning.budget_s} | ({"planner": "astar-volume"} if is_for_volumes else chosen)
        given = {"planner": planner, "heuristic": heuristic, "budget_s": budget_s, "seed": seed}
        chosen |= {name: value for name, value in given.items() if value is not None}
        search = cls(**chosen, snap=snap, refine=refine)
        at_least("seed", search.seed)
        if not search.budget_s > 0:
            raise InputError(f"budget_s must be a positive number of seconds, got {search.budget_s}")
        snap_limit_m(search.snap)
        if is_for_volumes and search.refine:
            raise InputError("refine moves waypoints on one altitude: leave it out of a path that climbs and descends")
        find_planner(search.planner, search.heuristic, is_for_volumes=is_for_volumes)
        return search
