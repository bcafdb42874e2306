"""What a city's files hold against what cities are like: a refusal, or a guess with its number and the remedy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from rasterio.fill import fillnodata

from jaxurban.cities.kinds import WOOD
from jaxurban.cities.raster import GROUND_M, open_raster, pixel_m, raster_window, read_raster
from jaxurban.errors import InputError
from jaxurban.io.burn import UNKNOWN_GROUND_M, burn_heights
from jaxurban.io.sampling import raster_values, resample_raster
from jaxurban.knowledge import Guesses, GuessKind, guessed
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import Bounds, covering_grid
from jaxurban.world.raster import Raster

# Voids in the terrain.
REACH_M = 200.0  # of known ground into a void: to the middle of a hall 400 m wide
FILL_M = 4.0  # of finer pixels one in so many metres is filled: the search is slow
PLACES_A_SIDE = 101  # of a region, where its terrain is looked up

# Terrain that is a surface model. Shares of heights, and correlations: bare ground (Bilbao, Gothenburg) 0.00, 0.01; the
# same with its buildings, as means over 30 m, 0.21, 0.45 and 0.12, 0.36.
AROUND_M = 3000.0  # of a region's middle, looked at
CELL_M = 10.0
NEAR_CELLS = 11  # a side of the square whose mean is the level around a cell: almost every one holds a street
LEAST_RISE = 0.1
LEAST_CORRELATION = 0.2
LEAST_CELLS = 2000  # 20 hectares: on less, slopes of bare ground pass for a rise

# Plants, roofs and people.
TALLEST_PLANT_M = 117.0  # the tallest tree stands at 116 m; birds and cables are above
TALL_PLANT_M = 60.0  # few forests are higher: redwoods, firs and eucalypts of old growth
GIANT_PLANT_M = 100.0  # where trees are above it, others are between
FEW_PLANTS = 0.01  # of the pixels with plants
FULL_COVER = 100  # per cent
# Of the pixels around a city; Gothenburg 0.93, the same as elevations 0.06 and 0.07.
LEAST_BARE = 0.1
WIDEST_PIXEL_M = 30.0  # wider ones hold more than one building and streets
MOST_MEDIAN_M = 60.0  # of a raster's roofs
LEAST_BUILDINGS = 20  # that say whether heights are elevations
LEAST_STATED = 0.1  # of all buildings; in many towns of OpenStreetMap towers alone have heights
HIGH_M = 60.0
FEW_LOW, MOST_ABOVE = 0.01, 0.95  # but for slips; but for sheds, and ground that is off
LEAST_LEVEL_M = 25.0  # of the ground; below it houses may all be higher
HOUSE_M = 25.0  # so far apart roofs of a raster are looked at, about one for each building
MOST_PER_KM2 = 300_000  # the densest quarters of Hong Kong and Manila have about 100,000
DENSEST_SHARE = 0.1  # of the blocks or pixels with people
QUARTER_M2 = 1e6  # on less ground a few towers may hold as many


def filled_terrain(name: str, terrain: Raster, crs: str, box_m: Bounds) -> tuple[Raster, Guesses]:
    """Return a terrain whose voids are interpolated from the ground around, and the guess of how much that is.

    Terrain models of bare ground often hold no data below buildings. Voids are filled as far as `REACH_M` from known
    ground.

    Args:
      name: of the file, for messages.
      terrain: elevation of the ground.
      crs: projected CRS of the city.
      box_m: x_min, y_min, x_max, y_max of the region in it.

    Raises:
      InputError: no elevation is known in the region.
    """
    values = terrain.values
    filled = terrain
    is_void = np.isnan(values)
    if is_void.any():
        side_m = pixel_m(terrain, crs).min()
        step = max(1, int(FILL_M / side_m))
        sparse = values[::step, ::step].copy()  # GDAL writes into it
        reach = REACH_M / (step * side_m)  # in pixels
        coarse = fillnodata(sparse, np.isfinite(sparse), reach, temp_file_driver="MEM")
        fine = coarse.repeat(step, 0).repeat(step, 1)[: len(values), : values.shape[1]]
        filled = replace(terrain, values=np.where(is_void, fine, values))

    grid = covering_grid(box_m, (box_m[2] - box_m[0]) / PLACES_A_SIDE, crs)
    before, after = (
        np.isfinite(resample_raster(raster, grid)).mean() for raster in (terrain, filled)
    )
    if not after:
        raise InputError(
            f"the terrain {name} holds no elevation in the region: give one that covers it, or check its nodata "
            "value (of lidar points: that those of the ground have class 2)"
        )
    return filled, guessed(GuessKind.FILLED_TERRAIN, after - before, file=name, reach_m=REACH_M)


def read_plants(path: str | Path, crs: str, near_m: Bounds, box_m: Bounds) -> Raster:
    """Return heights of plants, 0 where none grow, NaN where they are not known.

    A file that writes 0 where nothing grows does not know what grows where it has no data, nor does one without any
    plant. In a file of plants alone no data mean that nothing grows.

    Args:
      path: of the raster.
      crs: projected CRS of the boxes.
      near_m: x_min, y_min, x_max, y_max of what is read.
      box_m: the same of the region.

    Raises:
      InputError: as for `read_raster`, for either box, or values that are no heights above the ground.
    """
    name = repr(str(path))
    with open_raster(path) as source:
        raster_window(name, source, crs, box_m)
        unit = source.units[0]
    plants = read_raster(path, crs, near_m)
    values = plants.values
    if np.mean(np.abs(values) > GROUND_M) > 1 - LEAST_BARE and not unit:
        raise InputError(
            f"{name} looks like elevations and not heights of plants above the ground: less than {LEAST_BARE:.0%} of "
            "it is near 0; give a canopy height model, as surface less terrain is one, and say of a forest without a "
            "gap with `gdal_edit.py -units m` that it is one"
        )
    if not _are_heights(values, unit):
        farthest = values.flat[np.nanargmax(np.abs(values))]
        raise InputError(
            f"{name} does not hold heights of plants in metres, of which the tallest tree has 116, as {farthest:g} in "
            f"{np.sum(values == farthest):,} cells: replace codes, those of GLAD with `gdal_calc.py -A IN --calc "
            "'A*(A<61)+255*(A>102)' --NoDataValue 255 --outfile OUT`, or declare one as nodata with `gdal_edit.py "
            "-a_nodata VALUE`; name the unit with `gdal_edit.py -scale 0.1` of decimetres, with `-units m` of metres; "
            "a cover in per cent or a mask holds no heights"
        )
    holds_plants_alone = 0 < np.nanmin(values, initial=np.inf) < np.inf
    return replace(plants, values=np.nan_to_num(values)) if holds_plants_alone else plants


def _are_heights(values: np.ndarray, unit: str) -> bool:
    """Return whether values ``[R, C]`` of a raster of plants may be heights in metres; its unit is empty if not said.

    These are none: masks and shares, which end at 1; values above `TALLEST_PLANT_M` or far below 0; and codes above
    `GIANT_PLANT_M` without a tall tree below, as GLAD's heights end at 60 m and 101 to 103 are water, snow and no data.

    Many above `TALL_PLANT_M` are so rare in forests that a file of them must name its unit, if they may be per cent
    (whole numbers to `FULL_COVER`), or if many are the highest value, as a code or a full cover is.
    """
    plants = values[values > GROUND_M]
    tall = values[np.abs(values) > TALL_PLANT_M]  # and what is as far below 0
    highest = np.nanmax(values, initial=0.0)
    if not len(tall):
        is_mask = highest == 1
        return not is_mask
    are_possible = highest <= TALLEST_PLANT_M and 0 < tall.min() <= GIANT_PLANT_M
    few = FEW_PLANTS * len(plants)
    may_be_per_cent = highest <= FULL_COVER and not np.any(plants % 1)
    is_piled_up = np.sum(plants == highest) > few
    is_unclear = len(tall) > few and (may_be_per_cent or is_piled_up)
    return are_possible and (bool(unit) or not is_unclear)


def plants_guesses(name: str, plants: Raster, crs: str, box_m: Bounds) -> Guesses:
    """Return the guess of how much of a region has plants that are not known.

    Args:
      name: of their file, for messages.
      plants: heights, NaN where they are not known, as beyond the raster.
      crs: projected CRS of the box.
      box_m: x_min, y_min, x_max, y_max of the region.
    """
    grid = covering_grid(box_m, (box_m[2] - box_m[0]) / PLACES_A_SIDE, crs)
    share = np.isnan(resample_raster(plants, grid)).mean()
    return guessed(GuessKind.WITHOUT_PLANTS, share, file=name, limit_m=WOOD.limit_m)


def _stated_heights_m(buildings: Footprints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return heights that a file states, of unreadable ones inf, and x and y, ``[N]`` each; none if it states few."""
    is_lost = buildings.origin == HeightOrigin.UNREADABLE
    is_stated = ~buildings.is_guessed | is_lost | (buildings.origin == HeightOrigin.ESTIMATED)
    if is_stated.sum() < LEAST_STATED * len(is_stated):
        is_stated[:] = False
    height_m = np.where(is_lost, np.inf, buildings.height_m)[is_stated]
    x_m, y_m = shapely.get_coordinates(shapely.centroid(buildings.polygons[is_stated])).T
    return height_m, x_m, y_m


def check_are_heights(
    name: str,
    stands: Footprints | Raster | None,
    crs: str,
    extent_m: Bounds,
    terrain: Raster | None,
) -> None:
    """Raise InputError if the heights of `LEAST_BUILDINGS` or more buildings look like elevations above the sea.

    They do where hardly one is below `HIGH_M`, or where nearly all are greater than the elevation of their ground and
    the median of that is above `LEAST_LEVEL_M`. Heights above all buildings of the Earth, which count as unreadable,
    are among them. Heights of few of the buildings, as mappers give them to towers, say nothing.

    Args:
      name: of the file of buildings, for messages.
      stands: buildings near a region, by outlines or as a raster of roofs.
      crs: projected CRS of the city.
      extent_m: x_min, y_min, x_max, y_max of the buildings in it.
      terrain: elevation of the ground; None where it is not known.
    """
    if isinstance(stands, Footprints):
        height_m, x_m, y_m = _stated_heights_m(stands)
    else:
        assert stands is not None
        grid = covering_grid(extent_m, HOUSE_M, crs)
        roof_m = resample_raster(stands, grid)
        row, col = np.nonzero(roof_m > GROUND_M)
        height_m = roof_m[row, col]
        x_m, y_m = grid.xy_of_cell(row, col)
    if len(height_m) < LEAST_BUILDINGS:
        return
    is_high = np.mean(height_m < HIGH_M) < FEW_LOW
    if terrain is not None:
        ground_m = raster_values(terrain, x_m, y_m, crs, "nearest")
        is_known = np.isfinite(ground_m)
        if is_known.sum() >= LEAST_BUILDINGS and np.median(ground_m[is_known]) > LEAST_LEVEL_M:
            is_high |= np.mean(height_m[is_known] > ground_m[is_known]) > MOST_ABOVE
    if is_high:
        raise InputError(
            f"{name} seems to hold elevations above the sea in place of heights above the ground: of {len(height_m):,} "
            f"hardly one is below {HIGH_M:g} m, or below the elevation of its ground; set [buildings] ground_column "
            '(with height_column and unit), name a column of heights, or of a raster set kind = "surface" or its unit '
            "(`gdal_edit.py -scale 0.1` of decimetres); if they are heights in metres, set allow = ['high']"
        )


def pixel_guesses(roofs: Raster, crs: str) -> Guesses:
    """Return the guesses that a raster holds single roofs, and that it is in metres, where these are doubtful."""
    side_m = pixel_m(roofs, crs).max()
    median_m = np.median(np.append(roofs.values[roofs.values > GROUND_M], 0.0))
    is_wide = float(side_m > WIDEST_PIXEL_M)
    is_high = float(median_m > MOST_MEDIAN_M)
    wide = guessed(GuessKind.WIDE_PIXELS, is_wide, side_m=side_m)
    return wide + guessed(GuessKind.UNIT_OF_HEIGHTS, is_high, height_m=median_m)


def terrain_guesses(
    stands: Footprints | Raster | None, terrain: Raster, crs: str, box_m: Bounds
) -> Guesses:
    """Return the guess that terrain which rises under buildings is bare ground; empty where it does not rise.

    Args:
      stands: what stands, by outlines, or as a raster of roofs.
      terrain: elevation of the ground.
      crs: projected CRS of the city.
      box_m: x_min, y_min, x_max, y_max of the region in it, of which the middle is looked at.
    """
    from scipy.ndimage import binary_erosion, uniform_filter

    around_m = shapely.box(*box_m).centroid.buffer(AROUND_M).bounds
    grid = covering_grid(around_m, CELL_M, crs)
    terrain_m = resample_raster(terrain, grid, "bilinear")
    has_data = np.isfinite(terrain_m)
    terrain_m[~has_data] = UNKNOWN_GROUND_M
    if isinstance(stands, Footprints):
        roof_m, _ = burn_heights(stands, grid, has_touched=False)
    else:
        assert stands is not None
        roof_m = resample_raster(stands, grid)
        has_data &= np.isfinite(roof_m)
        roof_m = np.fmax(roof_m, np.float32(0))

    # Terrain and roofs above their mean around, where all around is known.
    is_known = binary_erosion(has_data, np.ones((NEAR_CELLS, NEAR_CELLS)))
    if is_known.sum() < LEAST_CELLS:
        return ()
    rise_m, height_m = (
        (values - uniform_filter(values, NEAR_CELLS))[is_known] for values in (terrain_m, roof_m)
    )
    (of_rise, both), (_, of_height) = np.cov(rise_m, height_m)
    is_related = both > LEAST_CORRELATION * np.sqrt(of_rise * of_height)
    share = both / of_height if is_related else 0.0
    return guessed(GuessKind.RISING_TERRAIN, share, least=LEAST_RISE)


def check_people(people: np.ndarray, area_m2: np.ndarray) -> None:
    """Raise InputError if the densest tenth of blocks or pixels holds more people than any part of a city on the Earth.

    On less ground than `QUARTER_M2` all may be.

    Args:
      people: ``[N]`` number in each block.
      area_m2: ``[N]`` of the blocks.
    """
    per_km2 = 1e6 * people / area_m2
    or_none = np.append(per_km2[people > 0], 0.0)  # for blocks without anybody
    high_per_km2 = np.quantile(or_none, 1 - DENSEST_SHARE)
    if high_per_km2 > MOST_PER_KM2 and area_m2.sum() > QUARTER_M2:
        raise InputError(
            f"the people of [population] blocks are {high_per_km2:,.0f} per km2 or more in a tenth of the blocks or "
            f"pixels, and no quarter has {MOST_PER_KM2:,}: give the number of people in each of them, not people per "
            "km2"
        )
