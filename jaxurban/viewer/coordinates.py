"""Longitude and latitude on the page: polynomials of easting and northing, fitted to PROJ over the maps' region."""

import numpy as np

from jaxurban.world.grid import Grid

DEGREE, NUM_FITTED = 4, 17  # places a side


def lonlat_fit(grid: Grid) -> dict[str, np.ndarray]:
    """Return longitude and latitude as polynomials of u and v, which run from -1 to 1 from border to border.

    ``powers`` are ``[P, 2]`` of u and v of each term, ``lon`` and ``lat`` ``[P]`` its coefficients, degrees.
    """
    powers = np.array([(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
    uv = np.stack(np.meshgrid(*[np.linspace(-1, 1, NUM_FITTED)] * 2), axis=-1).reshape(-1, 2)
    low_m, high_m = np.array([[grid.x_min_m, grid.y_min_m], [grid.x_max_m, grid.y_max_m]])
    lonlat = np.stack(grid.lonlat_of_xy(*((low_m + high_m) / 2 + uv * (high_m - low_m) / 2).T), axis=-1)
    lon, lat = np.linalg.lstsq(np.prod(uv[:, None] ** powers, axis=-1), lonlat, rcond=None)[0].T
    return {"powers": powers, "lon": lon, "lat": lat}
