"""Census blocks: who lives where, and what the districts are for."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import shapely

from jaxurban.world.rows import Rows

OTHER_DISTRICT = 13  # the paper's label for every block that no district claims


class Zoning(IntEnum):
    """What a district is for: decides how its population changes by day."""

    OTHER = 0  # district 13 and districts on neither list; counted with the residential ones
    RESIDENTIAL = 1
    COMMERCIAL = 2


@dataclass(frozen=True)
class Blocks(Rows):
    """Census blocks with their night population. ``N`` blocks.

    Attributes:
      polygons: ``[N]`` object array of shapely Polygons or MultiPolygons, in the city's CRS.
      night_count: ``[N]`` float64 people at night (the census count).
      district: ``[N]`` int32 label of the district of largest overlap, `OTHER_DISTRICT` where none.
      zoning: ``[N]`` uint8, a `Zoning` each.
      block_id: ``[N]`` object array of identifiers.
      day_count: ``[N]`` float64 people by day, of rasters that hold them; None where factors make them of the night's.
    """

    polygons: np.ndarray
    night_count: np.ndarray
    district: np.ndarray
    zoning: np.ndarray
    block_id: np.ndarray
    day_count: np.ndarray | None = None

    @property
    def area_m2(self) -> np.ndarray:
        """Area of each block in the projected CRS, ``[N]``."""
        return shapely.area(self.polygons)
