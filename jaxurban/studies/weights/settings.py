"""What is asked of every route of a study of weights; light to import, as the command's options are made of it."""

import math
from dataclasses import dataclass
from typing import Any

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError


@typed
@dataclass(frozen=True)
class SensitivitySettings:
    """What is asked of every route of a study of weights.

    Attributes:
      vary: name of a weight, or of several; left out: all metrics of a route's maps whose weight is above 0. The
        distance keeps its weight as the unit unless it is named, since only ratios of weights choose a route.
      factors: breakpoints are looked for from the first to the second of these times each weight.
      wrong: factor by which a wrong weight is too large or too small.
      num_heights: draws of all heights, on the maps of each of which every route is planned too.
      seed: of the sampling of routes, with the place of the city among those of the study.
      height_seed: of the draws of heights.

    Raises:
      InputError: factors that do not enclose 1, or another wrong value.

    Examples:
      >>> settings = ju.studies.SensitivitySettings(vary=("gps", "risk"), factors=(0.5, 2.0))
      >>> settings.vary, settings.wrong
      (('gps', 'risk'), 2.0)
    """

    vary: tuple[str, ...] = ()
    factors: tuple[float, float] = (0.1, 10.0)
    wrong: float = 2.0
    num_heights: int = 0
    seed: int = 0
    height_seed: int = 0

    def __post_init__(self) -> None:
        """Check all numbers; names are checked against the maps when the study runs."""
        at_least("seed", self.seed)
        at_least("height_seed", self.height_seed)
        vary: Any = self.vary
        if isinstance(vary, str):  # which is a sequence of letters too
            object.__setattr__(self, "vary", (vary,))
        if len(set(self.vary)) < len(self.vary):
            raise InputError(f"vary must name each weight once, got {', '.join(self.vary)}")
        factors: tuple[float, ...] = self.factors
        if len(factors) != 2 or not 0 < factors[0] < 1 < factors[1] < math.inf:
            raise InputError(
                f"factors must be two (--range), from below 1 to above 1 times the weights, as 0.1,10, got {factors}"
            )
        if not positive("wrong", self.wrong) > 1:
            raise InputError(f"wrong must be a factor above 1 such as 2, got {self.wrong}")
        at_least("num_heights", self.num_heights)
