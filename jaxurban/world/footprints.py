"""Building outlines, and where their heights came from."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from jaxurban.world.rows import Rows


class HeightOrigin(IntEnum):
    """Where a building's height came from."""

    HEIGHT = 0  # a height tag or column
    LEVELS = 1  # number of levels x level height
    DEFAULT = 2  # neither: the default height
    RASTER = 3  # a height raster
    GENERATED = 4  # the synthetic city
    LAYER = 5  # of a bridge's deck: its layer x a clearance


GUESSED_BY = {  # the origins of heights that are guesses, as reports say them with the settings of the buildings
    HeightOrigin.LEVELS: "from the number of levels at {level_height_m:g} m each",
    HeightOrigin.DEFAULT: "by the default of {default_height_m:g} m",
    HeightOrigin.LAYER: "decks of bridges from their layer at {layer_clearance_m:g} m each",
}


@dataclass(frozen=True)
class Footprints(Rows):
    """Building outlines as prisms with a flat roof. ``B`` buildings.

    Attributes:
      polygons: ``[B]`` object array of valid shapely Polygons or MultiPolygons, in the city's CRS.
      height_m: ``[B]`` float64 roof height above ground, > 0.
      min_height_m: ``[B]`` float64 height of the underside, 0 for most; `City.hanging` says what it means.
      origin: ``[B]`` uint8, a `HeightOrigin` each.
      is_part: ``[B]`` bool, from ``building:part``.
    """

    polygons: np.ndarray
    height_m: np.ndarray
    min_height_m: np.ndarray
    origin: np.ndarray
    is_part: np.ndarray

    @property
    def is_guessed(self) -> np.ndarray:
        """``[B]`` bool: no height is known, and what `GUESSED_BY` names stands in."""
        return np.isin(self.origin, list(GUESSED_BY))

    def origin_counts(self) -> dict[str, int]:
        """Return the number of buildings by the origin of their height, only origins that occur."""
        counts = {
            origin.name.lower(): int(np.sum(self.origin == origin)) for origin in HeightOrigin
        }
        return {name: count for name, count in counts.items() if count}
