"""MapParams: all settings that metric maps depend on, checked together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

from jaxurban.checks import at_least, different_lengths, typed
from jaxurban.errors import InputError
from jaxurban.kernels.engine import Engine
from jaxurban.metrics.gps import Dop, Gps
from jaxurban.metrics.gps_floor import GpsFloor
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.population import Population
from jaxurban.metrics.protection import Protection
from jaxurban.metrics.registry import checked_sections
from jaxurban.metrics.risk import Risk
from jaxurban.settings import Heights

PAPER_ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)


class MetricSettings(TypedDict, total=False):
    """Settings of metrics, as in `jaxurban.build_maps`; None for those that are left out."""

    gps: Gps | None
    lidar: Lidar | None
    population: Population | None
    risk: Risk | None
    gps_horizontal: Dop | None
    gps_vertical: Dop | None
    protection: Protection | None
    gps_floor: GpsFloor | None


@typed
@dataclass(frozen=True)
class MapParams:
    """Everything that metric maps depend on besides city, sky and grid.

    Attributes:
      altitudes_m: flight altitudes above ground.
      oversample: n: occlusion and lidar on a surface n times finer (odd is best).
      heights: how roofs are rasterised, and how well their heights are known.
      sections: settings of metrics, by name; metrics that are not named have their defaults. A metric of `ON_REQUEST`
        is made only if it is named.
      engine: which form of the kernels runs; it changes no bit of the maps on a CPU.

    Raises:
      InputError: invalid altitudes, an invalid oversample, an unknown engine, sections that belong to no metric, bounds
        or spreads of a series that does not keep the maps of every time, or bounds with an even oversample.
    """

    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M
    oversample: int = 1
    heights: Heights = field(default_factory=Heights)
    sections: Mapping[str, Any] = field(default_factory=dict)
    engine: Engine = "auto"

    def __post_init__(self) -> None:
        """Check the settings; write altitudes as floats, and sections with their defaults. Errors as of the class."""
        altitudes_m = different_lengths("altitudes_m", self.altitudes_m)
        object.__setattr__(self, "altitudes_m", altitudes_m)
        at_least("oversample", self.oversample, 1)
        object.__setattr__(self, "sections", checked_sections(self.sections))

        # What the settings of satellites do not allow together with others.
        gps = self.gps
        keeps_times = gps.keeps_times(len(gps.utc_times or (None,)))
        if (gps.bounds or self.heights.height_samples) and not keeps_times:
            raise InputError(
                "[gps] bounds and [buildings] height_samples need the maps of every time: give fewer times, or set "
                "[gps] series = 'epochs'"
            )
        if gps.bounds and self.oversample % 2 == 0:
            raise InputError(
                f"[gps] bounds need an odd oversample, got {self.oversample}: use 3 or 5"
            )

    @property
    def gps(self) -> Gps:
        """The settings of satellites."""
        return self.sections.get("gps") or Gps()

    @property
    def population(self) -> Population:
        """The settings of people."""
        return self.sections.get("population") or Population()
