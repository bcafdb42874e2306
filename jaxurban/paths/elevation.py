"""The ground over which a mission is judged: the terrain of the city's file, or that of the maps' cells."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from jaxurban.io.city import City
from jaxurban.io.read.sampling import values_at
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.ground import elevation_at

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
    def is_flat(self) -> bool:
        """Whether the ground is level, at 0, as neither the city nor the maps hold terrain."""
        return not self._is_of_file and "terrain" not in self.maps.ds

    @property
    def is_exact(self) -> bool:
        """Whether it is known at every place, and not from the maps' cells alone."""
        return self._is_of_file or self.is_flat

    @property
    def _is_of_file(self) -> bool:
        return self.city is not None and self.city.terrain is not None

    def at(self, places_m: np.ndarray) -> np.ndarray:
        """Return the elevation at places: of the file between its pixels, or of the cells between their centres.

        Args:
          places_m: ``[..., 2]`` x, y in the maps' CRS.

        Returns:
          ``[...]``: NaN outside the maps and where the file has no data, 0 everywhere on level ground.
        """
        return self._within(places_m, self._elevation_m)

    def off_m(self, places_m: np.ndarray) -> np.ndarray:
        """Return ``[...]`` by how many metres the ground at places may leave `at`: 0 but for ground of cells."""
        if self.is_exact:
            return np.zeros(places_m.shape[:-1])
        return self._within(places_m, self._relief_m)

    def _within(
        self, places_m: np.ndarray, value_at: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Return ``[...]`` a value at places ``[..., 2]`` within the maps, NaN elsewhere; 0 on level ground."""
        if self.is_flat:
            return np.zeros(places_m.shape[:-1])
        grid = self.maps.grid
        from_corner_m = places_m - grid.bounds_m[:2]
        sides_m = np.array(grid.shape[::-1]) * grid.resolution_m  # along x, y
        is_inside = ((from_corner_m >= 0) & (from_corner_m <= sides_m)).all(axis=-1)
        values = np.full(is_inside.shape, np.nan)
        values[is_inside] = value_at(from_corner_m[is_inside])
        return values

    def _elevation_m(self, from_corner_m: np.ndarray) -> np.ndarray:
        """Return ``[M]`` the elevation at ``[M, 2]`` x, y from the maps' corner."""
        grid = self.maps.grid
        x_m, y_m = from_corner_m.T
        if self.city is None or self.city.terrain is None:
            return elevation_at(x_m, y_m, self.maps.m("terrain"), grid.resolution_m)
        west_m, south_m = grid.bounds_m[:2]
        return values_at(self.city.terrain, x_m + west_m, y_m + south_m, grid.crs, "bilinear")

    @cached_property
    def _off_of_cells_m(self) -> np.ndarray:
        terrain_m = self.maps.m("terrain")
        relief_m = maximum_filter(terrain_m, 3) - minimum_filter(terrain_m, 3)
        return OFF_SHARE * relief_m

    def _relief_m(self, from_corner_m: np.ndarray) -> np.ndarray:
        """Return ``[M]`` by how much the ground of the cell at ``[M, 2]`` x, y from the maps' corner may be off."""
        grid = self.maps.grid
        cell = np.clip(from_corner_m[:, ::-1] / grid.resolution_m, 0, np.array(grid.shape) - 1)
        return self._off_of_cells_m[tuple(cell.astype(int).T)]
