"""City to Surface: outlines burnt into cells, rasters brought onto the grid."""

import math
import threading
from collections.abc import Iterable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import shapely
from affine import Affine
from rasterio.features import rasterize

from jaxurban.city import City
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.raster import resample_raster
from jaxurban.surface import NO_BUILDING, Surface

NO_BLOCK = -1
UNKNOWN_GROUND_M = -500.0  # below all real ground: what stands where the terrain is unknown shadows nothing
_BURNING = threading.Lock()  # rasterio silences a warning meanwhile, which threads may not do at the same time
Margins = tuple[float, float, float, float]  # west, south, east, north, metres


def burn(polygons: np.ndarray, values: np.ndarray, grid: Grid, fill: float, dtype: str, all_touched: bool = False):
    """Return ``values`` burnt at the cells of ``polygons``, the highest value where they overlap.

    Args:
      polygons: ``[N]`` shapely polygons in the grid's CRS.
      values: ``[N]`` numbers.
      grid: where to burn.
      fill: value of cells that no polygon holds.
      dtype: of the result.
      all_touched: burn every touched cell, not only those whose centre is inside.

    Returns:
      ``[Y, X]`` array of ``dtype``, row 0 in the south.
    """
    x_min, y_min, x_max, y_max = grid.bounds_m
    west, south, east, north = shapely.bounds(polygons).T
    near = np.flatnonzero((west <= x_max) & (east >= x_min) & (south <= y_max) & (north >= y_min))
    if near.size == 0:
        return np.full(grid.shape, fill, dtype)
    near = near[np.argsort(values[near], kind="stable")]  # later ones win, so the highest comes last
    # In cells rather than metres: subtracting whole numbers is exact, so a border that runs through cell
    # centres falls to the same side whatever part of the grid is burnt. (Rows run north, as ours do.)
    corner = np.array([grid.first_col, grid.first_row])
    in_cells = shapely.transform(polygons[near], lambda xy_m: xy_m / grid.resolution_m - corner)
    if all_touched:
        # An outline that ends exactly on a cell border does not touch the next cell.
        in_cells = shapely.buffer(in_cells, -1e-6, join_style="mitre")
        kept = ~shapely.is_empty(in_cells)
        in_cells, near = in_cells[kept], near[kept]
    shapes = list(zip(in_cells, values[near].tolist(), strict=True))
    if not shapes:
        return np.full(grid.shape, fill, dtype)
    with _BURNING:
        return rasterize(
            shapes, grid.shape, fill=fill, transform=Affine.identity(), all_touched=all_touched, dtype=dtype
        )


def highest_top_m(city: City) -> float:
    """Return how far the highest roof can stand above the lowest ground, metres."""
    if city.buildings is not None:
        roof_m = float(city.buildings.height_m.max(initial=0.0))
    else:
        assert city.roofs is not None
        roof_m = float(np.nanmax(city.roofs.values, initial=0.0))
    if city.terrain is None:
        return roof_m
    return roof_m + float(np.nanmax(city.terrain.values) - np.nanmin(city.terrain.values))


def surface_grid(city: City, region: Grid, always_m: float, toward_m: Margins) -> Grid:
    """Return the region's grid grown by the margins that its maps need.

    Args:
      city: its extent bounds the margin toward the satellites.
      region: the grid that maps report.
      always_m: margin on every side (lidar range, risk threshold), also beyond the data.
      toward_m: west, south, east, north margins toward the satellites, as far as the data reach.
    """
    x_min, y_min, x_max, y_max = city.known_extent_m
    reach_m = (region.x_min_m - x_min, region.y_min_m - y_min, x_max - region.x_max_m, y_max - region.y_max_m)
    cells = (
        math.ceil(max(always_m, min(toward, reach)) / region.resolution_m)
        for toward, reach in zip(toward_m, reach_m, strict=True)
    )
    return region.padded(*cells)


class Rasters(NamedTuple):
    """A city on one grid, as `Surface` holds it, in host memory; ``has_data`` is None where data are everywhere."""

    roof_m: np.ndarray
    terrain_m: np.ndarray | None
    has_data: np.ndarray | None


def rasterise(city: City, grid: Grid, all_touched: bool = False) -> Rasters:
    """Return roofs, terrain and where they are known. Every cell depends on its own place alone."""
    has_data = None
    if city.buildings is not None:
        roof_m = burn(city.buildings.polygons, city.buildings.height_m, grid, 0.0, "float32", all_touched)
    else:
        assert city.roofs is not None
        roof_m = resample_raster(city.roofs, grid, "max" if all_touched else "nearest")
        has_data = np.isfinite(roof_m)
        roof_m = np.where(has_data, np.maximum(roof_m, 0.0), 0.0).astype(np.float32)
    terrain_m = None
    if city.terrain is not None:
        terrain_m = resample_raster(city.terrain, grid, "bilinear")
        known = np.isfinite(terrain_m)
        has_data = known if has_data is None else has_data & known
        terrain_m = np.where(known, terrain_m, UNKNOWN_GROUND_M).astype(np.float32)
    return Rasters(roof_m, terrain_m, None if has_data is None or has_data.all() else has_data)


def building_index(city: City, grid: Grid, all_touched: bool = False) -> np.ndarray:
    """Return the index of the building whose roof is the highest in each cell, `NO_BUILDING` without one, int32.

    `jaxurban.surface.roofs_of` makes of it, with the buildings' heights, the roofs that `rasterise` burns.

    Raises:
      InputError: a city without outlines, whose roofs are a raster.
    """
    if city.buildings is None:
        raise InputError("this city's roofs are a height raster: gradients by building need outlines as its source")
    by_height = np.argsort(city.buildings.height_m, kind="stable")
    rank = np.empty_like(by_height)
    rank[by_height] = np.arange(len(rank))
    burnt = burn(city.buildings.polygons, rank, grid, NO_BUILDING, "int32", all_touched)
    return np.append(by_height, NO_BUILDING).astype(np.int32)[burnt]  # NO_BUILDING, -1, is the last entry


def rasterise_blocks(city: City, grid: Grid) -> np.ndarray | None:
    """Return the index of the census block under each cell, `NO_BLOCK` without one; None without blocks."""
    if city.blocks is None:
        return None
    return burn(city.blocks.polygons, np.arange(len(city.blocks)), grid, NO_BLOCK, "int32")


def check_has_data(has_data: Iterable[np.ndarray | None]) -> None:
    """Raise InputError unless a part of the region has data; stops at the first one."""
    if not any(part is None or part.any() for part in has_data):
        raise InputError("the rasters hold no data in the region: check [region] bounds and the raster's CRS")


def build_surface(city: City, region: Grid, grid: Grid, all_touched: bool = False) -> Surface:
    """Return the city as rasters on ``grid``, of which ``region`` is the part that maps report.

    A roof covers the cells whose centre lies in its outline (``all_touched``: every cell it touches).

    Raises:
      InputError: the terrain or the height raster does not cover any of the region.
    """
    roof_m, terrain_m, has_data = rasterise(city, grid, all_touched)
    check_has_data([None if has_data is None else has_data[region.window_in(grid)]])
    block = rasterise_blocks(city, region)
    return Surface(
        roof_m=jnp.asarray(roof_m),
        terrain_m=None if terrain_m is None else jnp.asarray(terrain_m),
        has_data=None if has_data is None else jnp.asarray(has_data),
        block=None if block is None else jnp.asarray(block),
        grid=grid,
        region=region,
    )
