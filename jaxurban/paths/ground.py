"""The ground under a path, at its points and wherever it bends between them."""

from dataclasses import dataclass

import numpy as np

from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.kernels.tolerances import MOST_BULGE_M
from jaxurban.world.grid import Grid


@dataclass(frozen=True)
class Ground:
    """The ground under a path, at its points and between them. ``G`` places in order of travel.

    Every second place is halfway between its neighbours, between which the ground is a parabola.

    Attributes:
      at: ``[G]`` places along the path, counted in its points: 2.5 is halfway from the third point to the fourth.
      lonlat: ``[G, 2]`` longitude, latitude in degrees.
      elevation_m: ``[G]`` above the zero of the terrain file, whatever its vertical datum is.
    """

    at: np.ndarray
    lonlat: np.ndarray
    elevation_m: np.ndarray

    @property
    def cover_m(self) -> np.ndarray:
        """``[G]`` elevations that, joined by straight lines, are nowhere below the ground."""
        # A parabola that bulges up lies below its tangents at both ends. These meet halfway, as high above the parabola
        # as that is above the straight line between the ends. Odd places are those halfway.
        cover_m = self.elevation_m.copy()
        cover_m[1::2] += np.maximum(cover_m[1::2] - (cover_m[:-1:2] + cover_m[2::2]) / 2, 0.0)
        return cover_m


def ground_along(points_m: np.ndarray, terrain_m: np.ndarray, grid: Grid) -> Ground:
    """Return the ground under a polyline: at its points, where the ground bends, and between them on curved stretches.

    The ground is bilinear between the centres of cells, so that it bends where the line crosses from centre to centre,
    and is a parabola in between. Parabolas are cut until none leaves its straight line by more than `MOST_BULGE_M`.

    Args:
      points_m: ``[N, 2]`` x, y from the grid's southwest corner, N at least 1.
      terrain_m: ``[Y, X]`` elevation of the ground in each cell.
      grid: of ``terrain_m``.
    """

    def halved(bends: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return ``B`` places along the path and those halfway between neighbours, their x, y and elevation.

        Places are counted in the path's points (2.5 is halfway from the third to the fourth), ascending; metres.
        """
        at = np.interp(np.arange(2 * len(bends) - 1) / 2, np.arange(len(bends)), bends)
        x_m, y_m = (np.interp(at, np.arange(len(points_m)), values) for values in points_m.T)
        return at, x_m, y_m, elevation_at(x_m, y_m, terrain_m, grid.resolution_m)

    # Where the ground bends: where the line leaves a square between four centres for another on the same leg.
    between_centres = crossed_cells(points_m + grid.resolution_m / 2, grid.resolution_m)
    leg = between_centres.segment
    square_ends = leg + between_centres.shares[:, 1]  # counted in points of the line
    is_bend = np.diff(leg) == 0
    bends = np.unique(np.append(np.arange(len(points_m)), square_ends[:-1][is_bend]))

    # Into how many pieces the ground between two bends is cut: each of n bulges by the bulge / n².
    *_, elevation_m = halved(bends)
    bulge_m = np.abs(elevation_m[1::2] - (elevation_m[:-1:2] + elevation_m[2::2]) / 2)
    num_pieces = np.fmax(np.ceil(np.sqrt(bulge_m / MOST_BULGE_M)), 1)
    pieces_before = np.append(0, np.cumsum(num_pieces))
    bends = np.interp(np.arange(pieces_before[-1] + 1), pieces_before, bends)

    at, x_m, y_m, elevation_m = halved(bends)
    lonlat = np.stack(grid.lonlat_of_xy(x_m + grid.x_min_m, y_m + grid.y_min_m), axis=-1)
    return Ground(at, lonlat, elevation_m)


def elevation_at(
    x_m: np.ndarray, y_m: np.ndarray, terrain_m: np.ndarray, resolution_m: float
) -> np.ndarray:
    """Return ``[M]`` the elevation at points, bilinear between the four cell centres around each.

    Where one of the four has no data, it is that of the cell that holds the point, which may be NaN.

    Args:
      x_m, y_m: ``[M]`` from the southwest corner.
      terrain_m: ``[Y, X]`` elevation at cell centres; beyond the outermost centres it goes on level.
      resolution_m: side of a cell.
    """
    from scipy.ndimage import map_coordinates

    last_cell = np.array(terrain_m.shape)[:, None] - 1
    row_col = np.clip(np.stack([y_m, x_m]) / resolution_m - 0.5, 0, last_cell)
    smooth_m = map_coordinates(terrain_m, row_col, np.float64, order=1, mode="nearest")
    rows, cols = np.rint(row_col).astype(int)
    return np.where(np.isnan(smooth_m), terrain_m[rows, cols], smooth_m)
