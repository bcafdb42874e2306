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

from jaxurban.io.read.mission_flight import LEAST_RETURN_M, levels_m
from jaxurban.io.read.mission_parts import Autopilot

ENOUGH_M = 0.01  # by which a return may be lower than it needs to be


class Departure(NamedTuple):
    """A place at which an item of a mission ends, and from which the vehicle may return.

    Attributes:
      item: its number.
      apart_m: distance from home.
      own_m: height above home at which the vehicle is there; NaN where it is not known.
      least_m: least height above home at which a straight, level way home clears everything; NaN where it is not known.
      as_guessed_m: the same if guessed heights are right, in place of their bounds.
      why: the reason why ``least_m`` is not known.
    """

    item: int
    apart_m: float
    own_m: float
    least_m: float
    as_guessed_m: float
    why: str

    def flown_m(self, autopilot: Autopilot, altitude_m: float) -> float:
        """Return the least height at which an autopilot flies home from here, by its default cone.

        It is NaN where the return altitude is not known, and does not count a height of its own that is not known.
        """
        return max(levels_m(autopilot, self.apart_m, altitude_m)[0], self.own_m)

    def is_low(self, autopilot: Autopilot, altitude_m: float) -> bool:
        """Return whether that height is less than the way home needs; not where one of the two is not known."""
        return self.flown_m(autopilot, altitude_m) < self.least_m - ENOUGH_M


# What to type, with places for the altitude in metres and centimetres, and what switches the cone off.
PARAMETERS: dict[Autopilot, tuple[str, str]] = {
    "ardupilot": (
        "ArduCopter: RTL_ALT = {cm} (cm) up to 4.6, RTL_ALT_M = {m} (m) from 4.7 on",
        "RTL_CONE_SLOPE = 0",
    ),
    "px4": ("PX4: RTL_RETURN_ALT = {m} (m)", "RTL_CONE_ANG = 0"),
    "inav": (
        "INAV: nav_rth_altitude = {cm} (cm, at most 65000), nav_rth_alt_mode = AT_LEAST, nav_rth_climb_first = ON",
        "",
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
      departures: places from which it may return. The sentence names the first that the autopilot's default cone leaves
        lower than the way home needs, if there is one. Left out, it says how to switch the cone off.

    Examples:
      >>> from jaxurban.paths.autopilots import parameter_lines
      >>> parameter_lines(73.2, "px4")
      ['PX4: RTL_RETURN_ALT = 74 (m); near home it returns lower by default: set RTL_CONE_ANG = 0.']
    """
    metres = typed_m(altitude_m)
    lines = []
    for name, (text, setting) in PARAMETERS.items():
        if autopilot not in (name, "unknown"):
            continue
        line = text.format(m=metres, cm=100 * metres)
        low = [each for each in departures or () if each.is_low(name, metres)]
        if low:
            line += (
                f"; by its default cone it returns from item {low[0].item}, {low[0].apart_m:.0f} m from home, at "
                f"{low[0].flown_m(name, metres):.1f} m, below the {low[0].least_m:.1f} m needed: set {setting}"
            )
        elif departures is None and setting:
            line += f"; near home it returns lower by default: set {setting}"
        lines.append(f"{line}.")
    return lines
