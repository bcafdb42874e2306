"""City to Surface: outlines burnt into cells, rasters brought onto the grid."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import jax
import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.read.burn import burn, burn_by_rule, burn_hanging, burn_touched
from jaxurban.io.read.sampling import resample_raster
from jaxurban.world.city import SLABS, Buildings, City
from jaxurban.world.grid import WGS84, Grid, transformer
from jaxurban.world.surface import NO_BUILDING, Slabs, Surface

NO_BLOCK = -1
UNKNOWN_GROUND_M = -500.0  # below all real ground: what stands where the terrain is unknown shadows nothing
Margins = tuple[float, float, float, float]  # west, south, east, north, metres


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
    """A city on one grid, as `Surface` holds it, in host memory; ``has_data`` is None where data are everywhere.

    ``roof_touched_m``, what planners keep clear of, takes everything that hangs as reaching the ground, always.
    """

    roof_m: np.ndarray
    roof_touched_m: np.ndarray
    terrain_m: np.ndarray | None
    has_data: np.ndarray | None
    roof_guessed: np.ndarray | None
    slabs: Slabs | None = None


def rasterise(city: City, grid: Grid, all_touched: bool = False, tells_guessed: bool = False) -> Rasters:
    """Return roofs, terrain and where they are known. Every cell depends on its own place alone.

    A cell whose centre lies on the south or the east side of an outline is under its roof, one on the north or the west
    side is not: what GDAL burns where row 0 is in the south. Into rasters whose row 0 is in the north, as most files
    are, GDAL burns those on the north side too.

    Args:
      city: with outlines or a height raster.
      grid: where to burn.
      all_touched: ``roof_m`` is ``roof_touched_m`` too.
      tells_guessed: whether the height of each cell's roof is guessed is wanted too (of outlines).
    """
    has_data = guessed = None
    if city.buildings is not None:
        roof_m, touched_m, guessed = _burn_roofs(city.buildings, grid, all_touched, tells_guessed)
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
    roof_m, slabs = touched_m if all_touched else roof_m, None
    if city.buildings is not None and city.hanging == SLABS:
        roof_m, slabs = _standing_and_hanging(city.buildings, grid, terrain_m, all_touched)
    return Rasters(roof_m, touched_m, terrain_m, has_data, guessed, slabs)


def _standing_and_hanging(
    buildings: Buildings, grid: Grid, terrain_m: np.ndarray | None, all_touched: bool
) -> tuple[np.ndarray, Slabs]:
    """Return the roofs of what stands on the ground, raised by what rests on them, and what hangs freely."""
    standing = buildings.take(buildings.min_height_m == 0)
    roof_m = burn_by_rule(standing.polygons, standing.height_m, grid, all_touched, boxes_m=standing.boxes_m)
    return roof_m, burn_hanging(buildings, grid, roof_m, terrain_m, all_touched)


def _burn_roofs(
    buildings: Buildings, grid: Grid, all_touched: bool, tells_guessed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return roofs by centres and by touch, and, if wanted, whether the height of either of a cell is guessed."""
    polygons, height_m = buildings.polygons, buildings.height_m
    if not tells_guessed:
        return *burn_touched(polygons, height_m, grid, 0.0, "float32", boxes_m=buildings.boxes_m), None
    by_height, centre, touched = _burn_ranks(buildings, grid)
    roofs_m = np.append(height_m[by_height], 0.0).astype(np.float32)  # without a building the rank is -1
    is_guessed = np.append(buildings.is_guessed[by_height], False)
    return roofs_m[centre], roofs_m[touched], is_guessed[touched] | is_guessed[centre]


def _burn_ranks(buildings: Buildings, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the buildings from low to high, ``[B]``, and which of them has each cell, by centres and by touch.

    Of buildings of one height the last one is the higher one. Without a building the rank is `NO_BUILDING`.
    """
    by_height = np.argsort(buildings.height_m, kind="stable")
    rank = np.empty_like(by_height)
    rank[by_height] = np.arange(len(rank))
    return by_height, *burn_touched(buildings.polygons, rank, grid, NO_BUILDING, "int32", boxes_m=buildings.boxes_m)


def building_index(city: City, grid: Grid, all_touched: bool = False) -> np.ndarray:
    """Return the index of the building whose roof is the highest in each cell, `NO_BUILDING` without one, int32.

    `jaxurban.world.surface.roofs_of` makes of it, with the buildings' heights, the roofs that `rasterise` burns.

    Raises:
      InputError: a city without outlines, whose roofs are a raster.
    """
    if city.buildings is None:
        raise InputError("this city's roofs are a height raster: gradients by building need outlines as its source")
    by_height, centre, touched = _burn_ranks(city.buildings, grid)
    return np.append(by_height, NO_BUILDING).astype(np.int32)[touched if all_touched else centre]


def rasterise_blocks(city: City, grid: Grid) -> np.ndarray | None:
    """Return the index of the census block under each cell, `NO_BLOCK` without one; None without blocks."""
    if city.blocks is None:
        return None
    blocks = city.blocks
    return burn(blocks.polygons, np.arange(len(blocks)), grid, NO_BLOCK, "int32", boxes_m=blocks.boxes_m)


def check_has_data(has_data: Iterable[np.ndarray | None], city: City) -> None:
    """Raise InputError unless a part of the region has data; stops at the first one."""
    if not any(part is None or part.any() for part in has_data):
        names = [city.sources[role] for role in ("buildings", "terrain") if role in city.sources]
        box = transformer(city.crs, WGS84).transform_bounds(*city.known_extent_m)
        raise InputError(
            f"{' and '.join(names) or 'the rasters'} hold no data in the region: what was read covers "
            f"{', '.join(f'{value:.4f}' for value in box)} (west, south, east, north): move [region] bounds there, or "
            "check the raster's CRS and its nodata value"
        )


def build_surface(
    city: City, region: Grid, grid: Grid, all_touched: bool = False, tells_guessed: bool = False
) -> Surface:
    """Return the city as rasters on ``grid``, of which ``region`` is the part that maps report.

    A roof covers the cells whose centre lies in its outline (``all_touched``: every cell that it shares area with);
    ``tells_guessed``: with its `roof_guessed`.

    Raises:
      InputError: the terrain or the height raster does not cover any of the region.
    """
    roof_m, touched_m, terrain_m, has_data, guessed, slabs = rasterise(city, grid, all_touched, tells_guessed)
    window = region.window_in(grid)
    check_has_data([None if has_data is None else has_data[window]], city)
    arrays = {
        "roof_m": roof_m,
        "terrain_m": terrain_m,
        "has_data": has_data,
        "block": rasterise_blocks(city, region),
        "roof_touched_m": touched_m[window],
        "roof_guessed": None if guessed is None else guessed[window],
    }
    return Surface(
        **jax.device_put(arrays),
        grid=grid,
        region=region,
        slabs=slabs,
    )
