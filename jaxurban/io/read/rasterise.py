"""City to Surface: outlines burnt into cells, rasters brought onto the grid."""

import math
import threading
from collections.abc import Iterable
from typing import NamedTuple

import jax
import numpy as np
import shapely
from affine import Affine
from rasterio.features import rasterize

from jaxurban.errors import InputError
from jaxurban.io.read.raster import resample_raster
from jaxurban.kernels.line.traversal import burn_edges
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from jaxurban.world.surface import NO_BUILDING, Surface

NO_BLOCK = -1
UNKNOWN_GROUND_M = -500.0  # below all real ground: what stands where the terrain is unknown shadows nothing
_BURNING = threading.Lock()  # rasterio silences a warning meanwhile, which threads may not do at the same time
Margins = tuple[float, float, float, float]  # west, south, east, north, metres


def burn(polygons: np.ndarray, values: np.ndarray, grid: Grid, fill: float, dtype: str) -> np.ndarray:
    """Return ``values`` burnt at the cells whose centre lies in ``polygons``, the highest value where they overlap.

    Args:
      polygons: ``[N]`` shapely polygons in the grid's CRS.
      values: ``[N]`` numbers.
      grid: where to burn.
      fill: value of cells that no polygon holds.
      dtype: of the result.

    Returns:
      ``[Y, X]`` array of ``dtype``, row 0 in the south.
    """
    near = _near(polygons, grid)
    if near.size == 0:
        return np.full(grid.shape, fill, dtype)
    near = near[np.argsort(values[near], kind="stable")]  # later ones win, so the highest comes last
    in_cells = shapely.transform(polygons[near], lambda xy_m: _cells_of(xy_m, grid))
    shapes = list(zip(in_cells, values[near].tolist(), strict=True))
    with _BURNING:
        return rasterize(shapes, grid.shape, fill=fill, transform=Affine.identity(), dtype=dtype)


def widen(burnt: np.ndarray, polygons: np.ndarray, values: np.ndarray, grid: Grid) -> np.ndarray:
    """Return what `burn` gave, raised to the highest value among the polygons that share area with each cell.

    A polygon that ends on a border of cells does not touch the next one. GDAL's ``all_touched`` is not used: it
    misses cells that an edge enters by less than a hundredth of a side, along up to a whole side.

    Args:
      burnt: ``[Y, X]`` from `burn`.
      polygons, values, grid: as there.
    """
    widened = burnt.copy()
    near = _near(polygons, grid)
    if near.size:
        _, points, (ring_start, polygon_start, *outer) = shapely.to_ragged_array(polygons[near])
        num_rings = np.diff(polygon_start[outer[0]] if outer else polygon_start)
        ring_values = np.repeat(values[near], num_rings).astype(burnt.dtype)
        burn_edges(_cells_of(points, grid), ring_start.astype(np.int64), ring_values, widened)
    return widened


def _near(polygons: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the numbers of the polygons whose box meets a grid."""
    x_min, y_min, x_max, y_max = grid.bounds_m
    west, south, east, north = shapely.bounds(polygons).T
    return np.flatnonzero((west <= x_max) & (east >= x_min) & (south <= y_max) & (north >= y_min))


def _cells_of(xy_m: np.ndarray, grid: Grid) -> np.ndarray:
    """Return coordinates in cell sides from the grid's southwest corner.

    Subtracting whole numbers is exact, so a border that runs through cell centres falls to the same side whatever
    part of the grid is burnt.
    """
    return xy_m / grid.resolution_m - np.array([grid.first_col, grid.first_row])


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
    roof_touched_m: np.ndarray
    terrain_m: np.ndarray | None
    has_data: np.ndarray | None


def rasterise(city: City, grid: Grid, all_touched: bool = False) -> Rasters:
    """Return roofs, terrain and where they are known. Every cell depends on its own place alone.

    Args:
      city: with outlines or a height raster.
      grid: where to burn.
      all_touched: ``roof_m`` is ``roof_touched_m`` too.
    """
    has_data = None
    if city.buildings is not None:
        outlines = city.buildings.polygons, city.buildings.height_m, grid
        roof_m = burn(*outlines, 0.0, "float32")
        touched_m = widen(roof_m, *outlines)
    else:
        assert city.roofs is not None
        centre_m, touched_m = (resample_raster(city.roofs, grid, how) for how in ("nearest", "max"))
        has_data = np.isfinite(touched_m if all_touched else centre_m)
        roof_m, touched_m = (np.fmax(roof, np.float32(0)) for roof in (centre_m, touched_m))
    terrain_m = None
    if city.terrain is not None:
        terrain_m = resample_raster(city.terrain, grid, "bilinear")
        known = np.isfinite(terrain_m)
        has_data = known if has_data is None else has_data & known
        terrain_m = np.where(known, terrain_m, UNKNOWN_GROUND_M).astype(np.float32)
    has_data = None if has_data is None or has_data.all() else has_data
    return Rasters(touched_m if all_touched else roof_m, touched_m, terrain_m, has_data)


def building_index(city: City, grid: Grid, all_touched: bool = False) -> np.ndarray:
    """Return the index of the building whose roof is the highest in each cell, `NO_BUILDING` without one, int32.

    `jaxurban.world.surface.roofs_of` makes of it, with the buildings' heights, the roofs that `rasterise` burns.

    Raises:
      InputError: a city without outlines, whose roofs are a raster.
    """
    if city.buildings is None:
        raise InputError("this city's roofs are a height raster: gradients by building need outlines as its source")
    by_height = np.argsort(city.buildings.height_m, kind="stable")
    rank = np.empty_like(by_height)
    rank[by_height] = np.arange(len(rank))
    burnt = burn(city.buildings.polygons, rank, grid, NO_BUILDING, "int32")
    if all_touched:
        burnt = widen(burnt, city.buildings.polygons, rank, grid)
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

    A roof covers the cells whose centre lies in its outline (``all_touched``: every cell that it shares area with).

    Raises:
      InputError: the terrain or the height raster does not cover any of the region.
    """
    roof_m, touched_m, terrain_m, has_data = rasterise(city, grid, all_touched)
    window = region.window_in(grid)
    check_has_data([None if has_data is None else has_data[window]])
    arrays = {
        "roof_m": roof_m,
        "terrain_m": terrain_m,
        "has_data": has_data,
        "block": rasterise_blocks(city, region),
        "roof_touched_m": touched_m[window],
    }
    return Surface(
        **jax.device_put(arrays),
        grid=grid,
        region=region,
    )
