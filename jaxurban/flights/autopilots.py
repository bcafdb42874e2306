"""The parameter that holds the return altitude of each autopilot, and what its cone near home would change.

After the sources and documents of the autopilots, as of November 2026:

- ArduCopter: ``RTL_ALT`` in centimetres, 30 (200 before 4.6) to 300,000 (``ArduCopter/Parameters.cpp``); from 4.7 on
  ``RTL_ALT_M`` in metres (pull request 31970, "Parameter Name Changes" of its documents). The cone is
  ``RTL_CONE_SLOPE``, 3 by default, and 0 switches it off (``ArduCopter/mode_rtl.cpp``, ``compute_return_target``).
- PX4: ``RTL_RETURN_ALT`` in metres, without a greatest one; the cone is ``RTL_CONE_ANG`` within ``RTL_MIN_DIST``, 45
  degrees within 10 m by default, and 0 switches it off (``src/modules/navigator/rtl_params.yaml``, ``rtl.cpp``).
- INAV: ``nav_rth_altitude`` in centimetres, at most 65,000 (``src/main/fc/settings.yaml``). It counts as here in the
  mode ``AT_LEAST`` of ``nav_rth_alt_mode``, with ``nav_rth_climb_first`` and without ``nav_rth_use_linear_descent``,
  all of which are the defaults (``docs/Navigation.md``, ``src/main/navigation/navigation.c``). It knows of no cone.
"""

import math

import numpy as np
import pandas as pd

from jaxurban.flights.missions.flight import LEAST_RETURN_M, levels_m
from jaxurban.flights.missions.parts import Autopilot

ENOUGH_M = 0.01  # by which a return may be lower than it needs to be


# Its program; what to type, with places for the altitude in metres and centimetres; and what switches the cone off.
PARAMETERS: dict[Autopilot, tuple[str, str, str]] = {
    "ardupilot": (
        "ArduCopter",
        "RTL_ALT = {cm} (cm) up to 4.6, RTL_ALT_M = {m} (m) from 4.7 on",
        "RTL_CONE_SLOPE = 0",
    ),
    "px4": ("PX4", "RTL_RETURN_ALT = {m} (m)", "RTL_CONE_ANG = 0"),
    "inav": (
        "INAV",
        "nav_rth_altitude = {cm} (cm, at most 65000), nav_rth_alt_mode = AT_LEAST, nav_rth_climb_first = ON",
        "",
    ),
}

LOW_IN_CONE = (
    "; by its default cone it returns from item {item}, {apart_m:.0f} m from home, at {flown_m:.1f} m, below the "
    "{least_m:.1f} m needed"
)


def typed_m(altitude_m: float) -> int:
    """Return an altitude as it is typed: whole metres, rounded up, and no less than autopilots climb."""
    return math.ceil(max(altitude_m - ENOUGH_M, LEAST_RETURN_M))


def low_returns(departures: pd.DataFrame, autopilot: Autopilot, altitude_m: float) -> pd.DataFrame:
    """Return the rows of places from which an autopilot flies home lower than needed, by its default cone.

    What is not known is not low; a height of the flight's own that is not known does not count.

    Args:
      departures: places from which a flight may return: ``apart_m`` from home, ``own_m``, its height there, and
        ``least_m``, the height that the way home needs, both above home.
      autopilot: which returns.
      altitude_m: the return altitude, above home; NaN if it is not known.

    Returns:
      The rows with ``flown_m``, the least height above home at which it flies.
    """
    levels = [levels_m(autopilot, apart_m, altitude_m)[0] for apart_m in departures["apart_m"]]
    flown_m = np.maximum(levels, departures["own_m"].fillna(-np.inf))
    is_low = flown_m < departures["least_m"] - ENOUGH_M
    return departures.assign(flown_m=flown_m)[is_low]


def parameter_texts(
    altitude_m: float, autopilot: Autopilot = "unknown", departures: pd.DataFrame | None = None
) -> dict[str, str]:
    """Return what to type into an autopilot for a return altitude, by the name of the autopilot's program.

    Args:
      altitude_m: metres above home that a return needs; it is rounded up to whole metres (`typed_m`).
      autopilot: the one that is asked for; of ``"unknown"`` all are, of ``"dji"`` none, whose app asks for the height.
      departures: places from which it may return, the ``item`` to which each belongs, and what `low_returns` asks for.
        The text names the first that the autopilot's default cone leaves lower than the way home needs, if there is
        one. Left out, it says how to switch the cone off.

    Examples:
      >>> from jaxurban.flights.autopilots import parameter_texts
      >>> parameter_texts(73.2, "px4")
      {'PX4': 'RTL_RETURN_ALT = 74 (m); near home it returns lower by default: set RTL_CONE_ANG = 0.'}
    """
    metres = typed_m(altitude_m)
    texts = {}
    for name, (program, text, setting) in PARAMETERS.items():
        if autopilot not in (name, "unknown"):
            continue
        lower = ["; near home it returns lower by default"]
        if departures is not None:
            low = low_returns(departures, name, metres).to_dict("records")
            lower = [LOW_IN_CONE.format_map(row) for row in low]
        cone = f"{lower[0]}: set {setting}" if setting and lower else ""
        texts[program] = f"{text.format(m=metres, cm=100 * metres)}{cone}."
    return texts
