"""What routes are planned under where the caller leaves it out: the one holder of these defaults, and of the paper's.

A preset sets only what the caller leaves out. docs/mathematics.md lists every departure from the paper.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from jaxurban.errors import one_of

BUDGET_S = 10.0  # seconds of search, for one plan
PAPER = "paper"


@dataclass(frozen=True)
class Preset:
    """Settings of routes, under the names of a scenario's ``[planning]``.

    Attributes:
      cost_model: how steps are costed (`jaxurban.planners.cost_model.CostModel`).
      obstacles: where planners may fly (`jaxurban.maps.metric_maps.MetricMaps`).
      clearance_m: horizontal distance from buildings as high as the path.
      vertical_clearance_m: height over roofs.
    """

    cost_model: Literal["cell", "line"] = "line"
    obstacles: Literal["touched", "centre"] = "touched"
    clearance_m: float = 0.0
    vertical_clearance_m: float = 3.0

    @classmethod
    def of(cls, name: str) -> "Preset":
        """Return the preset of a name, ``""`` for the defaults.

        Raises:
          InputError: an unknown name.
        """
        return PRESETS[one_of("preset", name, PRESETS)]


DEFAULTS = Preset()
PRESETS = {"": DEFAULTS, PAPER: Preset("cell", "centre", 0.0, 0.0)}


def planning_under(preset: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of a ``[planning]``: those given, and else those of a preset, theirs where none is named.

    Raises:
      InputError: an unknown preset.
    """
    return {**asdict(Preset.of(preset or given.get("preset", ""))), **given}
