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
from collections.abc import Iterable
from typing import NamedTuple

from jaxurban.io.read.mission_flight import CONE_REACH_M, CONE_SLOPE, LEAST_RETURN_M, levels_m
from jaxurban.io.read.mission_parts import Autopilot

ENOUGH_M = 0.01  # by which a return may be lower than it needs to be


class Parameter(NamedTuple):
    """How an autopilot holds its return altitude.

    Attributes:
      text: what to type, with places for the altitude in metres, ``m``, and in centimetres, ``cm``.
      cone_slope: greatest height of a return for each metre from home, by default; inf where there is no cone.
      reach_m: how far from home the cone counts.
      without_cone: the setting that switches the cone off.
    """

    text: str
    cone_slope: float = math.inf
    reach_m: float = math.inf
    without_cone: str = ""


class Departure(NamedTuple):
    """A place from which a vehicle may return.

    Attributes:
      what: names the place: ``"item 3"``.
      apart_m: its distance from home.
      own_m: its height above home, at which the vehicle is there.
      least_m: height above home that a level flight home needs.
    """

    what: str
    apart_m: float
    own_m: float
    least_m: float

    def flown_m(self, autopilot: Autopilot, altitude_m: float) -> float:
        """Return the least height at which an autopilot flies home from here, by its default cone."""
        return max(self.own_m, levels_m(autopilot, self.apart_m, altitude_m)[0])


PARAMETERS: dict[Autopilot, Parameter] = {
    "ardupilot": Parameter(
        "ArduCopter: RTL_ALT = {cm} (cm) up to 4.6, RTL_ALT_M = {m} (m) from 4.7 on",
        CONE_SLOPE,
        without_cone="RTL_CONE_SLOPE = 0",
    ),
    "px4": Parameter(
        "PX4: RTL_RETURN_ALT = {m} (m)", 1.0, CONE_REACH_M, without_cone="RTL_CONE_ANG = 0"
    ),
    "inav": Parameter(
        "INAV: nav_rth_altitude = {cm} (cm, at most 65000), nav_rth_alt_mode = AT_LEAST, nav_rth_climb_first = ON"
    ),
}


def typed_m(altitude_m: float) -> int:
    """Return an altitude as it is typed: whole metres, rounded up, and no less than autopilots climb."""
    return math.ceil(max(altitude_m - ENOUGH_M, LEAST_RETURN_M))


def parameter_lines(
    altitude_m: float,
    autopilot: Autopilot = "unknown",
    departures: Iterable[Departure] | None = None,
) -> list[str]:
    """Return what to type into an autopilot for a return altitude, a sentence for each autopilot.

    Args:
      altitude_m: metres above home that a return needs; it is rounded up to whole metres (`typed_m`).
      autopilot: the one that is asked for; of ``"unknown"`` all are, of ``"dji"`` none, whose app asks for the height.
      departures: places from which it may return, of which all heights are known. The sentence names the one that the
        autopilot's default cone leaves lowest below what it needs, if there is one. Left out, it says where they count.

    Examples:
      >>> from jaxurban.paths.autopilots import parameter_lines
      >>> parameter_lines(73.2, "px4")
      ['PX4: RTL_RETURN_ALT = 74 (m); within 10 m of home it returns lower by default: set RTL_CONE_ANG = 0.']
    """
    metres = typed_m(altitude_m)
    lines = []
    for name, (text, slope, reach_m, setting) in PARAMETERS.items():
        if autopilot not in (name, "unknown"):
            continue
        line = text.format(m=metres, cm=100 * metres)
        within_m = min(reach_m, metres / slope)
        if departures is None and within_m > 0:
            line += f"; within {within_m:.0f} m of home it returns lower by default: set {setting}"
        short_m = {each: each.least_m - each.flown_m(name, metres) for each in departures or ()}
        worst = max(short_m, key=short_m.__getitem__, default=None)
        if worst is not None and short_m[worst] > ENOUGH_M:
            line += (
                f"; by its default cone it returns from {worst.what}, {worst.apart_m:.0f} m from home, at "
                f"{worst.flown_m(name, metres):.1f} m, below the {worst.least_m:.1f} m needed: set {setting}"
            )
        lines.append(f"{line}.")
    return lines
