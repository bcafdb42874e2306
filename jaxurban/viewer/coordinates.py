"""Longitude and latitude on the page: polynomials of easting and northing, fitted to PROJ over the maps' region."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxurban.world.grid import Grid

DEGREE = 4
NUM_FITTED, NUM_CHECKED = 17, 40  # places a side
MOST_CELLS_OFF = 0.1


@dataclass(frozen=True)
class LonLatFit:
    """Longitude and latitude as polynomials of u and v, which run from -1 to 1 from border to border.

    Attributes:
      powers: ``[P, 2]`` of u and v of each term.
      lon, lat: ``[P]`` coefficients, degrees.
      worst_cells: how far off the worst of many places is, in cells.
    """

    powers: np.ndarray
    lon: np.ndarray
    lat: np.ndarray
    worst_cells: float

    @classmethod
    def of(cls, grid: Grid) -> "LonLatFit":
        """Return the fit by least squares, checked at places between those that it is fitted to."""
        powers = np.array([(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
        terms, lon, lat = _terms(powers, NUM_FITTED), *_lonlat(grid, NUM_FITTED)
        fit_lon, fit_lat = (np.linalg.lstsq(terms, values, rcond=None)[0] for values in (lon, lat))
        checked, true = _terms(powers, NUM_CHECKED), _lonlat(grid, NUM_CHECKED)
        x_m, y_m = grid.xy_of_lonlat(checked @ fit_lon, checked @ fit_lat)
        true_x_m, true_y_m = grid.xy_of_lonlat(*true)
        off_m = np.hypot(x_m - true_x_m, y_m - true_y_m)
        return cls(powers, fit_lon, fit_lat, float(off_m.max() / grid.resolution_m))

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as JSON holds it."""
        return {name: getattr(self, name).tolist() for name in ("powers", "lon", "lat")}


def _places(num: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.linspace(-1, 1, num)] * 2), axis=-1).reshape(-1, 2)


def _terms(powers: np.ndarray, num: int) -> np.ndarray:
    return np.prod(_places(num)[:, None] ** powers, axis=-1)


def _lonlat(grid: Grid, num: int) -> tuple[np.ndarray, np.ndarray]:
    u, v = _places(num).T
    x_m = (grid.x_min_m + grid.x_max_m) / 2 + u * (grid.x_max_m - grid.x_min_m) / 2
    y_m = (grid.y_min_m + grid.y_max_m) / 2 + v * (grid.y_max_m - grid.y_min_m) / 2
    return grid.lonlat_of_xy(x_m, y_m)
