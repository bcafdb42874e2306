"""Levels to fly between: which altitudes, and the metrics and obstacles there, also between the maps' own altitudes."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.maps import MetricMaps

SAME_M = 1e-6  # altitudes this close are one
MOST_LEVELS = 10_000


@dataclass(frozen=True, eq=False)
class Stack:
    """The metrics of several altitudes, and between them. ``A`` altitudes.

    Attributes:
      altitudes_m: ``[A]`` ascending.
      is_free: ``[A, Y, X]`` bool, where the metrics are defined: no roof reaches the altitude at the cell's centre.
      m: by name ``[A, Y, X]`` float32, or ``[1, Y, X]`` where a metric is the same at all altitudes.
    """

    altitudes_m: np.ndarray
    is_free: np.ndarray
    m: Mapping[str, np.ndarray]

    def metric(self, name: str, z_m: float, cells: Any = ...) -> np.ndarray:
        """Return a metric at an altitude within the stack, at an index of cells or ``[Y, X]`` everywhere.

        Between two altitudes it runs linearly from one map to the other; where the lower one holds an obstacle,
        and so no metric, the upper one's value stands.
        """
        values = self.m[name]
        if len(values) == 1:
            return values[0][cells]
        low = int(np.searchsorted(self.altitudes_m, z_m, side="right")) - 1
        if self.altitudes_m[low] == z_m:
            return values[low][cells]
        share = float((z_m - self.altitudes_m[low]) / (self.altitudes_m[low + 1] - self.altitudes_m[low]))
        lower, upper = values[low][cells], values[low + 1][cells]
        return np.where(self.is_free[low][cells], (1 - share) * lower + share * upper, upper)


def volume_levels(
    altitudes_m: Iterable[float],
    min_altitude_m: float | None = None,
    max_altitude_m: float | None = None,
    step_m: float | None = None,
) -> np.ndarray:
    """Return ``[K]`` ascending levels: the altitudes within the bounds, and with a step also every step between.

    Raises:
      InputError: bounds that cross or hold no altitude, or a step that is not positive.
    """
    held = np.array(sorted(altitudes_m))
    lowest = held[0] if min_altitude_m is None else min_altitude_m
    highest = held[-1] if max_altitude_m is None else max_altitude_m
    if not lowest <= highest:
        raise InputError(
            f"min_altitude_m {lowest:g} must not be above max_altitude_m {highest:g}: the maps hold {listed(held)} m"
        )
    inside = held[(held >= lowest) & (held <= highest)]
    if step_m is None:
        if inside.size == 0:
            raise InputError(
                f"the maps hold no altitude from {lowest:g} to {highest:g} m, only {listed(held)} m: widen "
                "min_altitude_m or max_altitude_m, or give level_step_m to fly between them"
            )
        return inside
    if not 0 < step_m < np.inf:
        raise InputError(f"level_step_m must be a positive number of metres, got {step_m:g}")
    low, high = max(lowest, held[0]), min(highest, held[-1])
    if low > high:
        raise InputError(
            f"the maps reach from {held[0]:g} to {held[-1]:g} m, not to {lowest:g} to {highest:g} m: move the bounds"
        )
    if (high - low) / step_m > MOST_LEVELS:
        raise InputError(f"level_step_m {step_m:g} makes more than {MOST_LEVELS} levels: choose a longer step")
    fixed = np.unique([low, *inside, high])
    between = [z_m for z_m in np.arange(low, high, step_m) if np.abs(fixed - z_m).min() > SAME_M]
    return np.sort(np.concatenate([fixed, between]))


def read_stack(
    maps: MetricMaps, names: Iterable[str], levels_m: np.ndarray, *, time: str | None, time_of_day: str | None
) -> Stack:
    """Return the metrics of the maps' altitudes between which the levels lie."""
    held = np.array(sorted(maps.altitudes_m))
    low = np.searchsorted(held, levels_m[0], side="right") - 1
    high = np.searchsorted(held, levels_m[-1])
    altitudes = held[low : high + 1].tolist()
    m = {}
    for name in names:
        read = altitudes if "altitude" in maps.ds[maps.variable(name)].dims else altitudes[:1]
        m[name] = np.stack([maps.m(name, z_m, time=time, time_of_day=time_of_day) for z_m in read])
    return Stack(np.array(altitudes), np.stack([maps.is_free(z_m, "centre") for z_m in altitudes]), m)


def listed(altitudes_m: np.ndarray) -> str:
    """Return altitudes as people read them."""
    return ", ".join(f"{z_m:g}" for z_m in altitudes_m)
