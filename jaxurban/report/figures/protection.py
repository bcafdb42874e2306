"""How maps of protection levels are named and coloured."""

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import Normalize

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.protection import METRIC, WITHIN_LIMITS
from jaxurban.report.figures.style import Colours

LEVEL_NAMES = {"hpl": "Horizontal protection level (HPL)", "vpl": "Vertical protection level (VPL)"}
LIMITS = {"hpl": "horizontal_alert_limit_m", "vpl": "vertical_alert_limit_m"}
AVAILABILITY, LOW = f"{METRIC.name}_availability", f"{METRIC.name}_p05"
SERIES_NAMES = {
    AVAILABILITY: "Availability of both protection levels",
    LOW: "Protection that 5 % of the epochs stay below",
}
NAMES: Mapping[str, str] = {
    **LEVEL_NAMES,
    WITHIN_LIMITS: "Both protection levels within their alert limits",
    **SERIES_NAMES,
}


def limits_said(maps: MetricMaps) -> str:
    """Return the alert limits in words."""
    return " and ".join(f"{name.upper()} ≤ {maps.ds.attrs[LIMITS[name]]:g} m" for name in LEVEL_NAMES)


def median_said(level_m: np.ndarray) -> str:
    """Return the median of levels in words."""
    middle_m = np.quantile(level_m, 0.5, method="higher")
    return f"median {middle_m:.0f} m" if np.isfinite(middle_m) else "undetermined in most free cells"


def protection_colours(maps: MetricMaps, name: str) -> Colours:
    """Return how one of `NAMES` is drawn; levels run to twice their alert limit, larger ones in that colour."""
    if name in LEVEL_NAMES:
        limit_m = maps.ds.attrs[LIMITS[name]]
        label = f"{name.upper()} in metres (lower is better;\nalert limit {limit_m:g} m)"
        return Colours(f"{METRIC.colour_map}_r", Normalize(0, 2 * limit_m), label, "max")
    if name == LOW:
        return Colours(METRIC.colour_map, Normalize(0, 1), f"$m_\\mathrm{{{METRIC.name}}}$, 5th percentile")
    what, ticks = ("share of epochs with", None) if name == AVAILABILITY else ("1 where", ())
    return Colours(METRIC.colour_map, Normalize(0, 1), f"{what}\n{limits_said(maps)}", ticks=ticks)
