"""What is asked of every route of a study of weights; light to import, as the command's options are made of it."""

import math
from dataclasses import dataclass

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError

EXACT = 1e-9  # relative: costs this close are equal, being sums of thousands of terms in float64


@typed
@dataclass(frozen=True)
class SensitivitySettings:
    """What is asked of every route of a study of weights.

    Attributes:
      vary: names of weights; left out: all metrics of a route's maps whose weight is above 0. The distance keeps its
        weight as the unit unless it is named, since only ratios of weights choose a route.
      factors: breakpoints are looked for, and weights of the Sobol indices drawn, from the first to the second of
        these times each weight.
      wrong: factor by which a wrong weight is too large or too small.
      num_samples: N of each route's Sobol indices, a power of two, N x (2 + weights that vary) searches; 0: none; left
        out: 128 of one route, 32 of each of several.
      tolerance: of the Pareto front of one route, between the distance and the two varied metrics with the largest
        shares of the cost: a share of the cost.
      max_plans: searches that the front may take.
      num_heights: draws of all heights, on the maps of each of which every route is planned too.
      seed: of the sampling of routes and weights, with the place of the city among those of the study and the route's
        number.

    Raises:
      InputError: factors that do not enclose 1, a number of samples that is no power of two, or another wrong value.

    Examples:
      >>> settings = ju.studies.SensitivitySettings(vary=("gps", "risk"), factors=(0.5, 2.0), num_samples=16)
      >>> settings.vary, settings.wrong
      (('gps', 'risk'), 2.0)
    """

    vary: tuple[str, ...] = ()
    factors: tuple[float, float] = (0.1, 10.0)
    wrong: float = 2.0
    num_samples: int | None = None
    tolerance: float = 1e-3
    max_plans: int = 5000
    num_heights: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check all numbers; names are checked against the maps when the study runs."""
        at_least("seed", self.seed)
        if len(set(self.vary)) < len(self.vary):
            raise InputError(f"vary must name each weight once, got {', '.join(self.vary)}")
        factors: tuple[float, ...] = self.factors
        if len(factors) != 2 or not 0 < factors[0] < 1 < factors[1] < math.inf:
            raise InputError(
                f"factors must be two (--range), from below 1 to above 1 times the weights, as 0.1,10, got {factors}"
            )
        if not positive("wrong", self.wrong) > 1:
            raise InputError(f"wrong must be a factor above 1 such as 2, got {self.wrong}")
        num = self.num_samples or 0
        is_power = num & (num - 1) == 0  # of two, with a single binary digit 1; or 0
        if num < 0 or num == 1 or not is_power:
            raise InputError(f"num_samples must be a power of two such as 32, got {num}")
        if not EXACT <= self.tolerance < 1:
            raise InputError(
                f"tolerance must be at least {EXACT:g} and below 1, got {self.tolerance}"
            )
        at_least("max_plans", self.max_plans, 1)
        at_least("num_heights", self.num_heights)
