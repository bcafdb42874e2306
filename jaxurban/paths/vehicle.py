"""Vehicle: what flies a route, how wide it is and how fast it moves, climbs, descends and turns."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from jaxurban.errors import InputError, finite, positive, typed

UNITS = {"_m_s": "metres per second", "_deg": "degrees", "_w": "watts"}
FULL_TURN_DEG = 180.0
PREFIX = "vehicle_"  # of its entries among the constraints that a path was planned under


@typed
@dataclass(frozen=True)
class Vehicle:
    """What flies, as ``[vehicle]`` of a scenario says it; what is left out limits nothing and tells nothing.

    Enforced: the radius, which every route keeps beside the clearance. Told (`cautions`, and the time of `explain`):
    climbs, descents and turns beyond the limits, since a multirotor slows down for them and may then fly them all.

    Attributes:
      radius_m: from its middle to its outermost point, seen from above.
      max_climb_m_s, max_descent_m_s: fastest change of height.
      max_turn_deg: sharpest change of heading at one waypoint without slowing down.
      speed_m_s: along the route, in cruise.
      power_w: mean electrical power in flight.

    Raises:
      InputError: a value that is not a positive number (of the radius: not a number from 0 up), a turn above 180
        degrees, or a power without a speed.
    """

    radius_m: float = 0.0
    max_climb_m_s: float | None = None
    max_descent_m_s: float | None = None
    max_turn_deg: float | None = None
    speed_m_s: float | None = None
    power_w: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius_m", finite("radius_m", self.radius_m, "metres"))
        if self.radius_m < 0:
            raise InputError(f"radius_m must be 0 or a positive number of metres, got {self.radius_m:g}")
        for field in fields(self)[1:]:
            if (value := getattr(self, field.name)) is not None:
                unit = next(unit for end, unit in UNITS.items() if field.name.endswith(end))
                object.__setattr__(self, field.name, positive(field.name, value, unit))
        if self.max_turn_deg is not None and self.max_turn_deg > FULL_TURN_DEG:
            raise InputError(f"max_turn_deg must be at most {FULL_TURN_DEG:g} degrees, got {self.max_turn_deg:g}")
        if self.power_w is not None and self.speed_m_s is None:
            raise InputError("power_w tells an energy only over a time: give the speed (speed_m_s, --speed) too")

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> "Vehicle":
        """Return the vehicle that a path was planned for, from its ``settings``; one without limits where none is."""
        held = settings.get("limits", {})
        return cls(**{field.name: held[key] for field in fields(cls) if (key := PREFIX + field.name) in held})

    def to_dict(self) -> dict[str, float]:
        """Return what is known of it as plain values, ``vehicle_radius_m`` ...; empty where that is nothing."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {PREFIX + name: float(value) for name, value in named.items() if value}

    def flight_s(self, air_m: np.ndarray, rise_m: np.ndarray, speed_m_s: float) -> np.ndarray:
        """Return ``[M]`` seconds for straight parts of a route, longer where climb or descent limits the speed.

        Args:
          air_m: ``[M]`` their lengths in the air.
          rise_m: ``[M]`` how much higher each ends than it begins.
          speed_m_s: along the route.
        """
        climb_m_s, descent_m_s = self.max_climb_m_s or np.inf, self.max_descent_m_s or np.inf
        return np.maximum(air_m / speed_m_s, np.maximum(rise_m / climb_m_s, -rise_m / descent_m_s))
