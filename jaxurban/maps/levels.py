"""Levels to fly between: which altitudes, and what the maps say there, also between their own altitudes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxurban.checks import finite, positive, typed
from jaxurban.errors import InputError

SAME_M = 1e-6  # altitudes this close are one
MOST_LEVELS = 10_000
MORE_BY = {  # what makes maps hold further values
    "altitude": "name it in [region] altitudes_m to make a map of it",
    "time": "name it in [gps] times to make a map of it",
}


@typed
@dataclass(frozen=True)
class Levels:
    """Between which altitudes a path may climb and descend, and what that costs.

    The path runs between levels: the maps' altitudes within the bounds, and those that ``level_step_m`` puts between
    them. There metrics are taken linearly from the maps below and above, and obstacles from the heights of the roofs.

    Attributes:
      min_altitude_m, max_altitude_m: between which to fly, metres above ground; left out, the maps' range.
      level_step_m: levels this far apart too, from the lowest altitude up, and at both bounds.
      climb_cost: cost per metre climbed, beside the length. Left out, the weight of the distance: hovering aside,
        lifting a small multirotor by a metre takes about the energy of one metre of level flight.
      descent_cost: cost per metre descended.

    Raises:
      InputError: a cost that is negative or not finite.

    Examples:
      >>> levels = ju.Levels(level_step_m=10.0)
      >>> planned = ju.plan(maps, start, goal, altitude_m=levels)
      >>> sorted(set(planned.z_m.tolist()))
      [20.0, 30.0]
    """

    min_altitude_m: float | None = None
    max_altitude_m: float | None = None
    level_step_m: float | None = None
    climb_cost: float | None = None
    descent_cost: float = 0.0

    def __post_init__(self) -> None:
        """Check that all values are finite and costs not negative; errors as of the class."""
        for name, value in vars(self).items():
            if value is not None and finite(name, value) < 0 and name.endswith("cost"):
                raise InputError(f"{name} must be a finite cost per metre >= 0, got {value:g}")

    def of(self, altitudes_m: Iterable[float]) -> np.ndarray:
        """Return the levels over some maps: their altitudes within the bounds, and all steps between them.

        Args:
          altitudes_m: of the maps, metres above ground.

        Returns:
          The levels, ``[K]`` ascending, metres above ground.

        Raises:
          InputError: bounds that hold no altitude, or a step that is not positive.

        Examples:
          >>> ju.Levels(level_step_m=15.0).of(maps.altitudes_m).tolist()
          [20.0, 35.0, 50.0, 60.0]
        """
        maps_m = np.array(sorted(altitudes_m))
        step_m = self.level_step_m

        # The bounds, and the maps' altitudes within them.
        min_m = maps_m[0] if self.min_altitude_m is None else self.min_altitude_m
        max_m = maps_m[-1] if self.max_altitude_m is None else self.max_altitude_m
        inside = maps_m[(maps_m >= min_m) & (maps_m <= max_m)]
        low_m = max(min_m, maps_m[0])
        high_m = min(max_m, maps_m[-1])
        if low_m > high_m or (step_m is None and not inside.size):
            raise InputError(
                f"the maps hold no altitude from {min_m:g} to {max_m:g} m, only {listed_m(maps_m)} m: change "
                "min_altitude_m or max_altitude_m, or give level_step_m to fly between the maps' altitudes"
            )
        if step_m is None:
            return inside

        # The steps between them, without those that are a level already.
        positive("level_step_m", step_m)
        if (high_m - low_m) / step_m > MOST_LEVELS:
            raise InputError(
                f"level_step_m {step_m:g} makes more than {MOST_LEVELS} levels: choose a longer step"
            )
        fixed = np.unique([low_m, *inside, high_m])
        steps = np.arange(low_m, high_m, step_m)
        is_new = np.abs(fixed - steps[:, None]).min(axis=1) > SAME_M
        return np.sort(np.concatenate([fixed, steps[is_new]]))


def around(altitude_m: float, altitudes_m: Sequence[float]) -> list[float]:
    """Return an altitude if maps hold it, else those next below and next above it that they hold.

    Args:
      altitude_m: above ground.
      altitudes_m: of the maps.

    Returns:
      The altitudes, ascending, metres above ground.

    Raises:
      InputError: it is no number, or lies outside the range of the maps.

    Examples:
      >>> from jaxurban.maps.levels import around
      >>> around(60.0, maps.altitudes_m), around(40.0, maps.altitudes_m)
      ([60.0], [20.0, 60.0])
    """
    altitude_m = finite("altitude_m", altitude_m)
    low_m, high_m = min(altitudes_m), max(altitudes_m)
    if not low_m <= altitude_m <= high_m:
        remedy = f"; to fly there, make maps with {altitude_m:g} in [region] altitudes_m too"
        raise InputError(
            f"there are no maps for altitude {altitude_m:g} m: these maps reach from {low_m:g} to {high_m:g} m "
            f"({listed_m(altitudes_m)}){remedy if altitude_m > 0 else ''}"
        )
    below_m = max(z_m for z_m in altitudes_m if z_m <= altitude_m)
    above_m = min(z_m for z_m in altitudes_m if z_m >= altitude_m)
    return sorted({below_m, above_m})


def index_of(name: str, value: Any, values: Sequence) -> int:
    """Return the index of a value among those that maps hold; 0, that of the first, where it is None.

    Args:
      name: what messages call the value.
      value: the value that is looked for.
      values: that the maps hold.

    Raises:
      InputError: the maps do not hold the value.
    """
    if value is None:
        return 0
    if value not in values:
        listed_values = ", ".join(map(str, values)) or "none, so leave it out"
        remedy = f"; {MORE_BY[name]}" if name in MORE_BY and values else ""
        raise InputError(
            f"there are no maps for {name} {value}: these maps hold {listed_values}{remedy}"
        )
    return values.index(value)


def values_at(
    z_m: float | np.ndarray,
    altitudes_m: Sequence[float],
    read: Callable[[float], np.ndarray],
    is_under_sky: Callable[[float], np.ndarray],
    *,
    is_count: bool = False,
    cells: Any = ...,
) -> np.ndarray:
    """Return a map's values ``[y, x]`` at an altitude within the maps' range, or in cells each at its own altitude.

    Between two of the maps' altitudes the values run linearly from the lower map to the upper one. A count stays that
    of the lower one, as what is in view there is in view above it too. Where a roof reaches the lower altitude, or
    something hangs over it, the value is the upper map's.

    Args:
      z_m: the altitude, metres above ground; or one for each cell that is read, all between the same two altitudes.
      altitudes_m: of the maps.
      read: returns the values at one of these altitudes.
      is_under_sky: returns, for one of these altitudes, where no roof reaches it and nothing hangs above it.
      is_count: whether the values count whole things, such as satellites.
      cells: rows and columns of the cells that are read; left out, all.
    """
    low_m = max(altitude_m for altitude_m in altitudes_m if np.all(altitude_m <= z_m))
    if np.all(z_m == low_m):
        return read(low_m)[cells]
    high_m = min(altitude_m for altitude_m in altitudes_m if np.all(altitude_m > z_m))
    share = (z_m - low_m) / (high_m - low_m)
    lower, upper = read(low_m)[cells], read(high_m)[cells]
    if not is_count:
        lower = (1 - share) * lower + share * upper
    return np.where(is_under_sky(low_m)[cells], lower, upper)


def listed_m(altitudes_m: Iterable[float]) -> str:
    """Return altitudes as people read them."""
    return ", ".join(f"{z_m:g}" for z_m in altitudes_m)
