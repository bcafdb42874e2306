"""Water and parks of a city."""

from dataclasses import dataclass

import shapely


@dataclass(frozen=True)
class LandCover:
    """Where there is water and where there are parks: polygons in a city's CRS, empty where there are none."""

    water: shapely.Geometry
    park: shapely.Geometry
