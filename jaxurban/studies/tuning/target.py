"""A target of a fit: a bound on what routes are like."""

import re
from dataclasses import dataclass

import numpy as np

from jaxurban.checks import finite, one_of, typed
from jaxurban.errors import InputError
from jaxurban.metrics.registry import METRICS

MEAN = "mean_"  # of a metric along a route
DETOUR = "detour"


@typed
@dataclass(frozen=True)
class Target:
    """A bound on an outcome of routes, averaged over a set of queries.

    Attributes:
      outcome: ``detour``: mean of length over the shortest route's, less 1. ``mean_gps`` and the like: mean over
        queries of the mean m along the route. ``people``: sum over queries of the integral of m_population along the
        route, as a share of the shortest routes'. ``length_m``: mean length.
      sense: ``">="`` or ``"<="``.
      value: the bound.

    Raises:
      InputError: another outcome or sense, or a value that no route reaches or that is no number.

    Examples:
      >>> str(ju.fit.Target("detour", "<=", 0.15))
      'detour <= 0.15'
    """

    outcome: str
    sense: str
    value: float

    def __post_init__(self) -> None:
        """Check outcome, sense and value; ``mean_NAME`` is checked against the maps' metrics by `fit_targets`."""
        if not self.outcome.startswith(MEAN):
            mean = f"{MEAN}{self.outcome if self.outcome in METRICS else 'NAME of a metric'}"
            one_of("outcome", self.outcome, (mean, DETOUR, "length_m", "people"))
        one_of("the sense of a target", self.sense, (">=", "<="))
        if not np.isfinite(self.value):
            raise InputError(f"target {str(self)!r} must end in a finite number")
        most = 1.0 if self.outcome.startswith(MEAN) else np.inf
        is_too_high = self.sense == ">=" and self.value > most
        is_too_low = self.sense == "<=" and self.value < 0
        if is_too_high or is_too_low:
            raise InputError(
                f"target {str(self)!r} cannot be met: {self.outcome} lies between 0 and {most:g}"
            )

    @classmethod
    @typed
    def parse(cls, text: str) -> "Target":
        """Return the target that a text such as ``"mean_gps>=0.8"`` names.

        Returns:
          The target; spaces in the text do not count.

        Raises:
          InputError: another form, or a value that is not a number.

        Examples:
          >>> ju.fit.Target.parse("mean_gps >= 0.8")
          Target(outcome='mean_gps', sense='>=', value=0.8)
        """
        match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(\S+)\s*", text)
        if not match:
            raise InputError(f"target {text!r} must read like mean_gps>=0.8 or detour<=0.15")
        outcome, sense, number = match.groups()
        return cls(outcome, sense, finite(f"the bound of target {text!r}", number))

    @property
    def sign(self) -> float:
        """1 where more is wished, -1 where less is."""
        return 1.0 if self.sense == ">=" else -1.0

    def is_met(self, value: float) -> bool:
        """Return whether an outcome of this value meets the target.

        Returns:
          A bool.

        Examples:
          >>> ju.fit.Target.parse("detour <= 0.15").is_met(0.1)
          True
        """
        return self.sign * (value - self.value) >= 0

    def __str__(self) -> str:
        return f"{self.outcome} {self.sense} {self.value:g}"
