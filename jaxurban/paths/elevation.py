"""The ground over which a mission is judged: the terrain of the city's file, or that of the maps' cells."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from jaxurban.io.city import City
from jaxurban.io.sampling import raster_values
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.ground import elevation_at
from jaxurban.world.raster import Raster

# Share of the relief of a cell and its eight neighbours by which the ground within may leave what their centres say. On
# the open terrain models of Bilbao (5 m) and Gothenburg (1 m) it holds at 99.6 to 99.9 % of the places, for cells of
# 5, 10 and 20 m.
OFF_SHARE = 0.75


@dataclass(frozen=True, eq=False)
class Elevation:
    """The elevation of the ground, above the zero of the terrain's file.

    Attributes:
      maps: whose cells hold the ground where no file does.
      city: that the maps are of; None where it is gone.
    """

    maps: MetricMaps
    city: City | None

    @property
    def _terrain(self) -> Raster | None:
        return None if self.city is None else self.city.terrain

    @property
    def is_flat(self) -> bool:
        """Whether the ground is level, at 0, as neither the city nor the maps hold terrain."""
        return self._terrain is None and "terrain" not in self.maps.ds

    @property
    def is_exact(self) -> bool:
        """Whether it is known at every place, and not from the maps' cells alone."""
        return self._terrain is not None or self.is_flat

    def at(self, places_m: np.ndarray) -> np.ndarray:
        """Return the elevation at places: of the file between its pixels, or of the cells between their centres.

        Args:
          places_m: ``[..., 2]`` x, y in the maps' CRS.

        Returns:
          ``[...]``: NaN outside the maps and where the file has no data, 0 everywhere on level ground.
        """
        if self.is_flat:
            return np.zeros(places_m.shape[:-1])
        grid = self.maps.grid
        low_m, high_m = np.reshape(grid.bounds_m, (2, 2))
        is_inside = ((places_m >= low_m) & (places_m <= high_m)).all(axis=-1)
        inside_m = places_m[is_inside]
        elevation_m = np.full(is_inside.shape, np.nan)
        if self._terrain is None:
            x_m, y_m = (inside_m - low_m).T
            cells_m = self.maps.m("terrain")
            elevation_m[is_inside] = elevation_at(x_m, y_m, cells_m, grid.resolution_m)
        else:
            x_m, y_m = inside_m.T
            elevation_m[is_inside] = raster_values(self._terrain, x_m, y_m, grid.crs, "bilinear")
        return elevation_m

    def at_lonlat(self, lon: float, lat: float) -> float:
        """Return the elevation at longitude and latitude in degrees, as `at` does."""
        return float(self.at(np.array(self.maps.grid.xy_of_lonlat(lon, lat))))

    @cached_property
    def off_m(self) -> np.ndarray:
        """``[Y, X]`` by how many metres the ground in each cell may leave `at`, where it is of cells."""
        terrain_m = self.maps.m("terrain")
        return OFF_SHARE * (maximum_filter(terrain_m, 3) - minimum_filter(terrain_m, 3))

    @cached_property
    def highest_m(self) -> np.ndarray:
        """``[Y, X]`` float32 what the ground in each cell does not exceed; 0 on level ground."""
        if self.is_flat:
            return np.zeros(self.maps.grid.shape, np.float32)
        highest_m = maximum_filter(np.nan_to_num(self.maps.m("terrain")), 3)
        return highest_m if self.is_exact else highest_m + np.nan_to_num(self.off_m)
