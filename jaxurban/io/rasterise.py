"""City to Surface: outlines burnt into cells, what hangs into subcells (`Slabs`), rasters brought onto the grid."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban import wings
from jaxurban.errors import InputError
from jaxurban.io.burn import UNKNOWN_GROUND_M, burn, burn_heights
from jaxurban.io.city import WOOD, City, Counted
from jaxurban.io.sampling import resample_raster
from jaxurban.kernels.blocks import part_of, rounded_up
from jaxurban.metrics.custom import Layer, check_values
from jaxurban.settings import SLABS, highest_of
from jaxurban.world.extent import meets
from jaxurban.world.footprints import BUILDING, Footprints
from jaxurban.world.grid import WGS84, Grid, transformer
from jaxurban.world.kinds import CODES, MOST_WOOD_M
from jaxurban.world.raster import Raster
from jaxurban.world.surface import NO_BUILDING, OF_REGION, PER_CELL, Slabs, Surface

NO_BLOCK = -1
PEOPLE_SAMPLES = 4  # a side of a cell
Bands = tuple[Raster | np.ndarray, ...]
Margins = tuple[float, float, float, float]  # west, south, east, north, metres


def highest_top_m(city: City) -> float:
    """Return a bound on how far the highest roof that hides satellites stands above a city's lowest ground, metres.

    It is the height of the highest roof above its own ground, plus the relief of the terrain.
    """
    hiding = city.hides
    roof_m = 0.0 if hiding.outlines is None else float(hiding.outlines.height_m.max(initial=0.0))
    for raster in (city.roofs, hiding.plants):
        if raster is not None:
            roof_m = float(np.nanmax(raster.values, initial=roof_m))
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
    reach_m = (  # from the region to the end of the data on each side, negative where the region sticks out
        region.x_min_m - x_min,
        region.y_min_m - y_min,
        x_max - region.x_max_m,
        y_max - region.y_max_m,
    )
    margin_m = np.maximum(always_m, np.minimum(toward_m, reach_m))
    cells = np.ceil(margin_m / region.resolution_m).astype(int).tolist()
    return region.padded(*map(rounded_up, cells))


def rasterise(
    city: City,
    grid: Grid,
    all_touched: bool = False,
    has_guessed: bool = False,
    has_kinds: bool = False,
) -> Surface:
    """Return the roofs and the terrain of a city on a grid and where they are known, as NumPy arrays, without blocks.

    Every cell depends on its own place alone. A cell whose centre lies on the south or the east side of an outline is
    under its roof, one on the north or the west side is not: what GDAL burns where row 0 is in the south. Into rasters
    whose row 0 is in the north, as most files are, GDAL burns cells on the north side too. ``roof_touched_m`` takes
    everything that hangs as reaching the ground, always.

    Args:
      city: with outlines or a height raster.
      grid: where to burn; the surface's region too.
      all_touched: ``roof_m`` is ``roof_touched_m`` too.
      has_guessed: for a city with outlines or plants, also return ``roof_guessed``, ``roof_limit_m`` and
        ``roof_likely_m``: whether the height of what stands in a cell is guessed, and how high it may and likely does
        reach.
      has_kinds: also return ``roof_kind``.
    """
    # `has_data` stays None where all cells have data.
    has_data = terrain_m = guessed = limit_m = likely_m = slabs = kind = None

    # Roofs, by centres and by touch.
    standing = city.standing
    roofs_m: Sequence[np.ndarray]
    if standing is not None:
        *roofs_m, guessed, kind = _burn_roofs(standing, grid, has_guessed, has_kinds)
        if has_guessed:
            unsure = standing.take(standing.is_guessed)
            _, limit_m = burn_heights(replace(unsure, height_m=unsure.upper_m), grid)
            _, likely_m = burn_heights(replace(unsure, height_m=unsure.likely_upper_m), grid)
    else:
        assert city.roofs is not None
        roofs_m = _resampled(city.roofs, grid)
        has_data = np.isfinite(roofs_m[all_touched])
        roofs_m = [np.fmax(roof_m, np.float32(0)) for roof_m in roofs_m]
        if has_kinds:
            kind = np.where(roofs_m[1] > 0, CODES[BUILDING], 0)
    if city.plants is not None:
        plants_m = _resampled(city.plants, grid)
        if kind is not None:
            kind = np.where(plants_m[1] > roofs_m[1], CODES[WOOD], kind)
        if has_guessed:
            unsure_m = unknown_plants_m(city, grid)
            guessed = unsure_m > 0 if guessed is None else guessed | (unsure_m > 0)
            limit_m, likely_m = (
                unsure_m if reach_m is None else np.maximum(reach_m, unsure_m)
                for reach_m in (limit_m, likely_m)
            )
        roofs_m = list(map(np.fmax, roofs_m, plants_m))
    roof_m, touched_m = roofs_m[all_touched], roofs_m[1]

    # The ground.
    if city.terrain is not None:
        terrain_m = resample_raster(city.terrain, grid, "bilinear")
        is_known = np.isfinite(terrain_m)
        has_data = is_known if has_data is None else has_data & is_known
        terrain_m[~is_known] = UNKNOWN_GROUND_M
    if has_data is not None and has_data.all():
        has_data = None

    # What counts for rays, where that is not all of it.
    hiding_m, returning_m = (
        None if counted is city.counted else _roofs_of(city, counted, grid, all_touched)
        for counted in (city.hides, city.returns)
    )

    # What hangs. Roofs are then of what stands on the ground, and `burn_hanging` raises the roofs that carry slabs.
    if standing is not None and city.hanging == SLABS:
        roof_m = _roofs_of(city, city.counted, grid, all_touched)
        solid_m = roof_m if hiding_m is None else hiding_m
        slabs = burn_hanging(standing, grid, solid_m, terrain_m, all_touched)
        for others_m in (roof_m, returning_m):
            if others_m is not None:
                np.maximum(others_m, solid_m, out=others_m)
    surface: Any = Surface  # of JAX's arrays by its hints, and here of NumPy's
    return surface(
        roof_m=roof_m,
        terrain_m=terrain_m,
        has_data=has_data,
        block=None,
        grid=grid,
        region=grid,
        roof_touched_m=touched_m,
        roof_guessed=guessed,
        roof_limit_m=limit_m,
        roof_likely_m=likely_m,
        slabs=slabs,
        roof_kind=None if kind is None else kind.astype(np.uint8),
        hiding_m=hiding_m,
        returning_m=returning_m,
    )


def unknown_plants_m(city: City, grid: Grid) -> np.ndarray:
    """Return how high plants may be where a city's raster has no data, ``[Y, X]`` float32 metres, 0 elsewhere."""
    assert city.plants is not None
    highest_m = min(MOST_WOOD_M, highest_of(city.heights, WOOD))
    return np.isnan(resample_raster(city.plants, grid)) * np.float32(highest_m)


def _roofs_of(city: City, counted: Counted, grid: Grid, all_touched: bool) -> np.ndarray:
    """Return the roofs of a part of a city by centres or by touch, ``[Y, X]`` float32 metres.

    Where what hangs does so, they are of what stands on the ground.
    """
    if counted.outlines is None:
        assert city.roofs is not None
        roof_m = np.fmax(_resampled(city.roofs, grid)[all_touched], np.float32(0))
    else:
        on_ground = (counted.outlines.min_height_m == 0) | (city.hanging != SLABS)
        roof_m = burn_heights(counted.outlines.take(on_ground), grid, all_touched)[all_touched]
    if counted.plants is None:
        return roof_m
    return np.fmax(roof_m, _resampled(counted.plants, grid)[all_touched])


def _resampled(heights: Raster, grid: Grid) -> list[np.ndarray]:
    """Return a raster of heights by cells' centres and by touch, ``[Y, X]`` float32, NaN without data."""
    return [resample_raster(heights, grid), resample_raster(heights, grid, "max")]


def _burn_roofs(
    buildings: Footprints, grid: Grid, has_guessed: bool, has_kinds: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Return roofs by centres and by touch as `burn_heights`, and what is known of them.

    This is where the height of either roof is guessed, ``[Y, X]`` bool, None without ``has_guessed``, and the code of
    what touches a cell, ``[Y, X]``, 0 for nothing, None without ``has_kinds``.
    """
    if not (has_guessed or has_kinds):
        return *burn_heights(buildings, grid), None, None
    by_height, centre, touched = _burn_ranks(buildings, grid)
    # By rank; without a building the rank is -1, the last entry.
    roofs_m = np.append(buildings.height_m[by_height], 0.0).astype(np.float32)
    guessed = kind = None
    if has_guessed:
        is_guessed = np.append(buildings.is_guessed[by_height], False)
        guessed = is_guessed[touched] | is_guessed[centre]
    if has_kinds:
        codes = [CODES[name] for name in buildings.kinds[by_height]]
        kind = np.append(codes, 0)[touched]
    return roofs_m[centre], roofs_m[touched], guessed, kind


def _burn_ranks(buildings: Footprints, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the buildings from low to high, and the rank in this order of the highest one over each cell.

    Of buildings of one height the last one counts as the higher one.

    Returns:
      ``[B]`` indices of buildings by rank, and ranks by centres and by touch (see `burn`), ``[Y, X]`` int32 each,
      `NO_BUILDING` (-1) without a building.
    """
    by_height = np.argsort(buildings.height_m, kind="stable")
    rank = np.empty_like(by_height)
    rank[by_height] = np.arange(len(rank))
    return by_height, *burn(
        buildings.polygons, rank, grid, NO_BUILDING, "int32", boxes_m=buildings.boxes_m
    )


def building_index(city: City, grid: Grid) -> np.ndarray:
    """Return the index of the building that has the highest roof in each cell, ``[Y, X]`` int32.

    It is `NO_BUILDING` without one. Of the heights `jaxurban.world.surface.roofs_of` makes the roofs of buildings.

    Args:
      city: with outlines.
      grid: of the result.

    Raises:
      InputError: a city without outlines, whose roofs are a raster.
    """
    if city.buildings is None:
        raise InputError(
            "this city's roofs are a height raster: gradients by building need outlines as its source"
        )
    by_height, centre, _ = _burn_ranks(city.buildings, grid)
    return np.append(by_height, NO_BUILDING).astype(np.int32)[centre]


def rasterise_blocks(city: City, grid: Grid) -> np.ndarray | None:
    """Return the index of the census block under each cell, `NO_BLOCK` where there is none.

    Blocks with counts of their own by day are pixels of a raster, or pieces of them, and may be smaller than a cell.
    They are sampled at ``n`` x ``n`` subcells of each cell (`PEOPLE_SAMPLES` a side), so that maps hold their people
    to 0.5 %.

    Returns:
      int32 ``[Y, X]`` at the cells' centres or, with such counts, ``[Y, X, n * n]`` at the centres of their subcells,
      row by row from the south; None for a city without blocks.
    """
    blocks = city.blocks
    if blocks is None:
        return None
    is_sampled = blocks.day_count is not None
    n = PEOPLE_SAMPLES if is_sampled else 1
    index, _ = burn(
        blocks.polygons,
        np.arange(len(blocks)),
        grid.refined(n),
        NO_BLOCK,
        "int32",
        boxes_m=blocks.boxes_m,
        has_touched=False,
    )
    if not is_sampled:
        return index
    # From rows and columns of all subcells to [Y, n, X, n], then [Y, X, n, n], and one axis of the n x n subcells.
    by_cell = index.reshape(grid.num_rows, n, grid.num_cols, n).swapaxes(1, 2)
    return by_cell.reshape(*grid.shape, n * n)


def check_has_data(has_data: Iterable[Any], city: City) -> None:
    """Raise InputError unless one of the parts of a region has a cell with data.

    Args:
      has_data: bool array of each part, None where all of it has data; not read beyond the first part with data.
      city: what was read, for the message.
    """
    if not any(part is None or part.any() for part in has_data):
        names = [city.sources[role] for role in ("buildings", "terrain") if role in city.sources]
        box = transformer(city.crs, WGS84).transform_bounds(*city.known_extent_m)
        raise InputError(
            f"{' and '.join(names) or 'the rasters'} hold no data in the region: what was read covers "
            f"{', '.join(f'{value:.4f}' for value in box)} (west, south, east, north): move [region] bounds there, or "
            "check the raster's CRS and its nodata value"
        )


def build_surface(
    city: City,
    region: Grid,
    grid: Grid,
    all_touched: bool = False,
    has_guessed: bool = False,
    has_kinds: bool = False,
) -> Surface:
    """Return the city as rasters on a grid, with blocks, of which a region is the part that maps report.

    Args:
      city: what stands there.
      region: a part of ``grid``; blocks and what is known of roofs by touch have its shape.
      grid: of roofs and terrain.
      all_touched: a roof covers every cell that its outline shares area with, and not only those whose centre it holds.
      has_guessed, has_kinds: as for `rasterise`.
    """
    surface = replace(rasterise(city, grid, all_touched, has_guessed, has_kinds), region=region)
    of_region: dict[str, Any] = {"block": rasterise_blocks(city, region)}
    for name in OF_REGION:
        of_region[name] = surface.crop(getattr(surface, name))
    return replace(surface, **of_region)


def burn_hanging(
    buildings: Footprints,
    grid: Grid,
    roof_m: np.ndarray,
    terrain_m: np.ndarray | None,
    all_touched: bool,
) -> Slabs:
    """Return what hangs freely over the cells of a grid; what rests on a roof raises it.

    A slab covers subcells, and cells, as a roof does: those whose centre lies in its outline (``all_touched``: every
    one that it shares area with). Every cell depends on its own place alone.

    Args:
      buildings: of which those with an underside above the ground hang.
      grid: where to burn.
      roof_m: ``[Y, X]`` float32 roofs of the buildings that stand; raised in place.
      terrain_m: ``[Y, X]`` elevation of the ground; None for flat ground.
      all_touched: see above.

    Returns:
      One slab for each subcell that something hangs over, in the order of cells and floors.
    """
    from jaxurban.kernels.outlines import settle

    is_near = meets(buildings.boxes_m.T, grid.bounds_m)
    finer = grid.refined(PER_CELL)

    # The subcells under each outline, and its floor and top at each of them; the empty arrays stand for no outline.
    places = [np.empty((2, 0), np.int64)]
    heights = [np.empty((2, 0), np.float32)]
    for i in np.flatnonzero(is_near & (buildings.min_height_m > 0)):
        window = _window(finer, buildings.boxes_m[:, i])
        covered = burn(buildings.polygons[i : i + 1], np.ones(1), window, 0.0, "float32")
        cells = np.stack(np.nonzero(covered[all_touched]))
        places.append(cells + np.array([[window.first_row], [window.first_col]]))
        ends_m = np.array([[buildings.min_height_m[i]], [buildings.height_m[i]]], np.float32)
        heights.append(np.broadcast_to(ends_m, cells.shape))

    # In the order of the cells that they lie in, from the lowest floor up, as `settle` takes them.
    row, col = np.concatenate(places, axis=1)
    floor_m, top_m = np.concatenate(heights, axis=1)
    cell = (row // PER_CELL - grid.first_row) * grid.num_cols + col // PER_CELL - grid.first_col
    order = np.lexsort((floor_m, cell))
    row, col, cell, floor_m, top_m = (values[order] for values in (row, col, cell, floor_m, top_m))

    # A cell is under a slab where the slab covers the subcell in its middle (``all_touched``: any of its subcells).
    is_middle = (row % PER_CELL == PER_CELL // 2) & (col % PER_CELL == PER_CELL // 2)
    is_of_cell = is_middle | all_touched
    hangs = settle(roof_m.reshape(-1), cell, floor_m, top_m, is_of_cell)
    ground_m = np.zeros(len(cell), np.float32) if terrain_m is None else terrain_m.reshape(-1)[cell]
    return Slabs(row, col, floor_m, top_m, ground_m, is_of_cell).take(hangs)


def _window(grid: Grid, box_m: np.ndarray) -> Grid:
    """Return the part of a grid around a box, with a cell more on each side as far as the grid reaches.

    The box is x_min, y_min, x_max, y_max in metres in the grid's CRS, and must touch the grid.
    """
    west, south, east, north = box_m / grid.resolution_m
    first_row = max(math.floor(south) - 1, grid.first_row)
    first_col = max(math.floor(west) - 1, grid.first_col)
    end_row = min(math.ceil(north) + 1, grid.first_row + grid.num_rows)
    end_col = min(math.ceil(east) + 1, grid.first_col + grid.num_cols)
    return Grid(
        grid.crs, grid.resolution_m, first_row, first_col, end_row - first_row, end_col - first_col
    )


def bands_of(
    layers: Mapping[str, Layer],
    region: Grid,
    altitudes_m: Sequence[float],
    folder: Path | None = None,
) -> dict[str, Bands]:
    """Return the bands of every layer that is a raster or an array, by name: one, or one for each flight altitude.

    Args:
      layers: by name.
      region: grid of the maps; of a raster file the part around it is read, and arrays have its shape.
      altitudes_m: of flight.
      folder: that a raster's relative path is relative to; left out, the working folder.

    Raises:
      InputError: a file that cannot be read, another number of bands or another shape than needed, or no band for an
        altitude.
    """
    by_name: dict[str, Bands] = {}
    for name, layer in layers.items():
        if callable(layer.source):
            continue
        bands: Sequence[Raster | np.ndarray]
        if isinstance(layer.source, str):
            path = (folder or Path()) / layer.source
            bands = wings.read_bands(path, region.crs, region.bounds_m)
        else:
            bands = _bands_of_array(name, layer.source, region)
        for band in bands:
            check_values(name, layer, band.values if isinstance(band, Raster) else band)
        num = 1 if layer.altitudes_m is None else len(layer.altitudes_m)
        if len(bands) != num:
            raise InputError(
                f"layer {name!r} has {len(bands)} band(s) for {num} altitude(s): name the altitude of each band in "
                "altitudes_m, or give one band for all"
            )

        # One for each flight altitude, or one for all.
        if layer.altitudes_m is not None:
            band_at: dict[float, Any] = dict(zip(layer.altitudes_m, bands, strict=True))
            missing_m = [z_m for z_m in altitudes_m if z_m not in band_at]
            if missing_m:
                known = ", ".join(f"{z_m:g}" for z_m in band_at)
                raise InputError(
                    f"layer {name!r} has no band for {missing_m[0]:g} m, only for {known} m: add one, or leave "
                    "altitudes_m out and give one band for all altitudes"
                )
            bands = [band_at[z_m] for z_m in altitudes_m]
        by_name[name] = tuple(bands)
    return by_name


def _bands_of_array(name: str, source: Any, region: Grid) -> list[np.ndarray]:
    """Return the bands of an array ``[Y, X]`` or ``[A, Y, X]``, each ``[Y, X]`` float32, NaN without a finite value.

    Args:
      name: of the layer, for messages.
      source: anything that NumPy makes an array of.
      region: grid of the maps.

    Raises:
      InputError: it does not hold real numbers, or has another shape than the maps.
    """
    array = np.ma.asarray(source)  # what is masked holds no value
    if array.dtype.kind not in "biuf":
        raise InputError(f"layer {name!r} must be an array of real numbers, got {array.dtype}")
    values = np.ma.filled(array.astype(np.float32), np.nan)
    values[np.isinf(values)] = np.nan  # as in a raster
    if values.ndim > 3 or values.shape[-2:] != region.shape:
        raise InputError(
            f"layer {name!r} has values of shape {values.shape} for maps of {region.num_rows} x {region.num_cols} "
            "cells: give one value for each cell, rows south to north"
        )
    return list(values if values.ndim == 3 else values[None])


def layer_values(bands: Bands, part: Grid, region: Grid, altitude: int | None = None) -> np.ndarray:
    """Return a layer's values ``[y, x]`` float32 on a part of the region, NaN beyond it and where there are none.

    Rasters are interpolated between pixel centres; every cell depends on its own place alone.

    Args:
      bands: from `bands_of`.
      part: may stick out of the region, as the last tiles do.
      region: grid of the maps.
      altitude: which of the flight altitudes; None where one band serves all.
    """
    band = bands[altitude or 0]
    if isinstance(band, Raster):
        return resample_raster(band, part, "bilinear")
    corner = part.first_row - region.first_row, part.first_col - region.first_col
    return part_of(band, corner, part.shape, np.nan)
