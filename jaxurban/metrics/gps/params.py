"""Settings of the GPS metric."""

from dataclasses import dataclass
from typing import Literal

from jaxurban.errors import InputError, one_of, typed
from jaxurban.metrics.settings import check_value, differentiable

MAX_STORED_TIMES = 24  # a longer series keeps statistics over time instead of every time's maps
SERIES = ("auto", "epochs", "statistics")
CLOCKS = ("system", "one")
WEIGHTINGS = ("none", "elevation")


@differentiable("gdop_threshold")
@typed
@dataclass(frozen=True)
class GpsParams:
    """Settings of the GPS metric. A pytree whose leaf is the threshold.

    Attributes:
      gdop_threshold: GDOP at and above which m is 0, > 1.
      series: what is kept of several times: every one of them (``"epochs"``), statistics over time
        (``"statistics"``, see `jaxurban.metrics.availability`), or statistics above `MAX_STORED_TIMES`
        (``"auto"``).
      availability_threshold: m above which a position counts as available, in [0, 1).
      clocks: of the receiver, which are solved for beside the position: one for each ``"system"`` that is seen, as
        their times differ by what nobody knows, or ``"one"`` for all, as in the paper, which has but one system.
      weighting: ``"elevation"`` gives the weighted DOPs ``wgdop``, ``wpdop``, ``whdop``, ``wvdop`` and ``wtdop`` too.

    Raises:
      InputError: a value that is none of these.
    """

    gdop_threshold: float = 20.0
    series: Literal["auto", "epochs", "statistics"] = "auto"
    availability_threshold: float = 0.5
    clocks: Literal["system", "one"] = "system"
    weighting: Literal["none", "elevation"] = "none"

    def __post_init__(self) -> None:
        what = "a number above 1 (such as 20)"
        check_value("gdop_threshold", self.gdop_threshold, what, lambda threshold: threshold > 1)
        one_of("series", self.series, SERIES)
        one_of("clocks", self.clocks, CLOCKS)
        one_of("weighting", self.weighting, WEIGHTINGS)
        if not 0 <= self.availability_threshold < 1:
            raise InputError(
                f"availability_threshold must be a value of m from 0 to below 1, got {self.availability_threshold}"
            )

    def keeps_times(self, num_times: int) -> bool:
        """Return whether the maps of every time are kept, not statistics over them."""
        return self.series == "epochs" or (self.series == "auto" and num_times <= MAX_STORED_TIMES)
