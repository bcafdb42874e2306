"""Under a preset: the one place where what a caller leaves out of a query takes its default."""

from typing import Protocol, Self, TypeVar

from jaxurban.maps.metric_maps import Obstacles
from jaxurban.paths.constraints import Constraints
from jaxurban.planners.cost import CostKind
from jaxurban.planners.cost_model import DEFAULT_MODEL, CostModel
from jaxurban.presets import Preset


class _UnderRule(Protocol):
    def with_obstacles(self, obstacles: Obstacles) -> Self: ...


Maps = TypeVar("Maps", bound=_UnderRule)  # `MetricMaps`, or their folder


def under_preset(
    preset: str, maps: Maps, cost_model: CostModel | CostKind | None, constraints: Constraints | None
) -> tuple[Maps, CostModel, Constraints]:
    """Return maps, cost model and constraints of routes, what is left out as a preset has it.

    Args:
      preset: a name (`jaxurban.presets.PRESETS`), ``""`` for the defaults.
      maps: under their rule of obstacles, which a preset that is named replaces.
      cost_model: taken whole; None: the preset's kind.
      constraints: None: no zones and no bounds; a vertical clearance that they were made without is the preset's.

    Raises:
      InputError: an unknown preset.
    """
    chosen = Preset.of(preset)
    limits = Constraints(clearance_m=chosen.clearance_m) if constraints is None else constraints
    maps = maps.with_obstacles(chosen.obstacles) if preset else maps
    return maps, CostModel.of(cost_model or chosen.cost_model), limits.under(chosen)


class _Rules(Protocol):
    @property
    def preset(self) -> str: ...
    @property
    def cost_model(self) -> CostModel: ...
    @property
    def constraints(self) -> Constraints: ...


def settle_preset(settings: _Rules) -> None:
    """Give frozen settings what they leave out of their preset's cost model and clearance, as they are made.

    Raises:
      InputError: an unknown preset.
    """
    chosen = Preset.of(settings.preset)
    if settings.preset and settings.cost_model is DEFAULT_MODEL:
        object.__setattr__(settings, "cost_model", CostModel(chosen.cost_model))
    object.__setattr__(settings, "constraints", settings.constraints.under(chosen))
