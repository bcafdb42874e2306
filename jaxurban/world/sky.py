"""Sky: where the satellites stand, seen from one reference point, and which of them are above the elevation mask."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jaxurban.kernels.dop import Clocks
from jaxurban.knowledge import Guesses


class InView(NamedTuple):
    """The satellites at or above the elevation mask at one time. ``S`` satellites.

    Attributes:
      azimuth_rad: ``[S]`` float64, clockwise from **grid** north.
      elevation_rad: ``[S]`` float64 above the horizon.
      systems: ``[S]`` constellation of each, as in `Sky`.
      numbers: ``[S]`` of the satellites in their sky.
      clocks: a receiver clock for each constellation of the sky; None where it has but one.
    """

    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    systems: tuple[str, ...]
    numbers: np.ndarray = np.empty(0, int)
    clocks: Clocks | None = None

    @property
    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Azimuths and elevations."""
        return self.azimuth_rad, self.elevation_rad


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
      guesses: what was supposed of time and satellites, see `jaxurban.knowledge`.
      mask_deg: elevation mask; lower satellites are not in view.
    """

    times: tuple[str, ...]
    names: tuple[str, ...]
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    systems: tuple[str, ...]
    element_age_days: np.ndarray
    guesses: Guesses = ()
    mask_deg: float = 0.0

    @cached_property
    def is_in_view(self) -> np.ndarray:
        """``[T, S]`` bool: which satellites are at or above the mask."""
        return self.elevation_rad >= np.radians(self.mask_deg)

    def in_view(self, time_index: int) -> InView:
        """Return the satellites in view at a time, with a receiver clock for each constellation of the sky.

        Clocks are numbered in the order in which the sky first names the constellations, also those out of view.
        """
        numbers = np.flatnonzero(self.is_in_view[time_index])
        systems = tuple(self.systems[s] for s in numbers)
        clocks = None
        order = list(dict.fromkeys(self.systems))
        if len(order) > 1:
            clocks = Clocks(np.array([order.index(system) for system in systems], int), len(order))
        return InView(
            self.azimuth_rad[time_index, numbers],
            self.elevation_rad[time_index, numbers],
            systems,
            numbers,
            clocks,
        )

    def under(self, mask_deg: float) -> "Sky":
        """Return the sky with an elevation mask, of the satellites alone that are at or above it at some time."""
        sky = replace(self, mask_deg=mask_deg)
        kept = np.flatnonzero(sky.is_in_view.any(axis=0))
        return replace(
            sky,
            names=tuple(self.names[s] for s in kept),
            azimuth_rad=self.azimuth_rad[:, kept],
            elevation_rad=self.elevation_rad[:, kept],
            systems=tuple(self.systems[s] for s in kept),
            element_age_days=self.element_age_days[:, kept],
        )
