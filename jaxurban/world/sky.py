"""Sky: where the satellites stand, seen from one reference point."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np


class InView(NamedTuple):
    """The satellites at or above the elevation mask at one time. ``S`` satellites.

    Attributes:
      azimuth_rad: ``[S]`` float64, clockwise from **grid** north.
      elevation_rad: ``[S]`` float64 above the horizon.
      systems: ``[S]`` constellation of each, as in `Sky`.
    """

    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    systems: tuple[str, ...]


@dataclass(frozen=True)
class Sky:
    """Look angles of every satellite at every time. ``T`` times, ``S`` satellites.

    Attributes:
      times: ``[T]`` UTC times, ISO 8601 with a trailing ``Z``.
      names: ``[S]`` satellite names.
      azimuth_rad: ``[T, S]`` float64, clockwise from **grid** north.
      elevation_rad: ``[T, S]`` float64 above the horizon, negative below it, no refraction.
      systems: ``[S]`` constellation of each satellite: "gps", "galileo", "glonass", "beidou" ... or "unknown".
      element_age_days: ``[T, S]`` float64 age of each element set at each time (0 for nominal orbits).
      guesses: what was supposed of time and satellites, see `jaxurban.maps.guesses`.
    """

    times: tuple[str, ...]
    names: tuple[str, ...]
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    systems: tuple[str, ...]
    element_age_days: np.ndarray
    guesses: Mapping[str, str] = field(default_factory=dict)

    @property
    def system_numbers(self) -> np.ndarray:
        """``[S]`` int number of each satellite's constellation, in the order in which the names name them."""
        order = list(dict.fromkeys(self.systems))
        return np.array([order.index(system) for system in self.systems], int)

    def above(self, mask_rad: float) -> "Sky":
        """Return the satellites that are at or above the elevation mask at any time."""
        keep = np.flatnonzero((self.elevation_rad >= mask_rad).any(axis=0))
        return replace(
            self,
            names=tuple(self.names[i] for i in keep),
            azimuth_rad=self.azimuth_rad[:, keep],
            elevation_rad=self.elevation_rad[:, keep],
            systems=tuple(self.systems[i] for i in keep),
            element_age_days=self.element_age_days[:, keep],
        )

    def count_by_system(self, mask_rad: float) -> dict[str, list[int]]:
        """Return how many satellites of each constellation are at or above the mask, by time."""
        is_above, systems = self.elevation_rad >= mask_rad, np.asarray(self.systems)
        return {name: is_above[:, systems == name].sum(axis=1).tolist() for name in sorted(set(self.systems))}
