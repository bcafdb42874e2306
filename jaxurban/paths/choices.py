"""The keywords of a plan, written once: which map is planned on, and how a path is searched for on it."""

from collections.abc import Mapping
from typing import Any, TypedDict

from jaxurban.metrics.weights import WeightsLike
from jaxurban.paths.constraints import Constraints
from jaxurban.planners.cost import CostModel
from jaxurban.settings import (
    Backend,
    CostKind,
    HeuristicName,
    Objective,
    OnGround,
    PlannerName,
    Preset,
)


class RulesChoice(TypedDict, total=False):
    """Under which rules is planned, as in `jaxurban.cost_map`."""

    cost_model: CostModel | CostKind | None
    constraints: Constraints | None
    preset: Preset


class MapChoice(RulesChoice, total=False):
    """Which map is planned on, as in `jaxurban.cost_map`."""

    weights: WeightsLike
    objective: Objective
    time: str | None
    time_of_day: str | None


class SearchChoice(TypedDict, total=False):
    """How a path is searched for, as in `PathSearch.of`."""

    planner: PlannerName | None
    heuristic: HeuristicName | None
    backend: Backend
    budget_s: float | None
    max_samples: int | None
    seed: int | None
    snap: bool | float
    on_ground: OnGround
    refine: bool
    exposure: Mapping[str, float] | None


class PathChoice(MapChoice, SearchChoice, total=False):
    """Which map is planned on, and how."""


def parted(choice: PathChoice) -> tuple[MapChoice, SearchChoice]:
    """Return the choice of the map, and the choice of the search."""
    of_map: Any = {**choice}
    names = SearchChoice.__annotations__.keys() & choice
    of_search: Any = {name: of_map.pop(name) for name in names}
    return of_map, of_search
