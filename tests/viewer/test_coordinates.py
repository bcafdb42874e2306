"""Longitude and latitude by polynomials, against PROJ."""

import numpy as np
import pyproj
import pytest

from jaxurban.viewer.tiles import lonlat_fit
from jaxurban.world.grid import Grid


@pytest.mark.parametrize(
    ("crs", "corner", "size_m"),
    [
        ("EPSG:32618", (584_000, 4_505_000), 20_000),
        ("EPSG:32618", (300_000, 7_800_000), 20_000),  # far north, far from the central meridian
        ("EPSG:32755", (320_000, 5_810_000), 40_000),
        ("EPSG:2154", (640_000, 6_850_000), 20_000),  # Lambert's conic
        ("EPSG:3035", (4_320_000, 3_200_000), 20_000),  # equal areas
    ],
)
@pytest.mark.parametrize("resolution_m", [1.0, 5.0])
def test_the_fit_is_within_a_tenth_of_a_cell_of_proj(crs, corner, size_m, resolution_m):
    first_col, first_row = (int(value / resolution_m) for value in corner)
    size = int(size_m / resolution_m)
    fit = lonlat_fit(Grid(crs, resolution_m, first_row, first_col, size, size))
    rng = np.random.default_rng(5)
    u, v = rng.uniform(-1, 1, (2, 2000))
    terms = u[:, None] ** fit["powers"][:, 0] * v[:, None] ** fit["powers"][:, 1]
    to_metres = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    x_m, y_m = to_metres.transform(terms @ fit["lon"], terms @ fit["lat"])
    off_m = np.hypot(x_m - corner[0] - (u + 1) / 2 * size_m, y_m - corner[1] - (v + 1) / 2 * size_m)
    assert off_m.max() < 0.1 * resolution_m
