"""What a city's files hold against what cities are like: a refusal, or a guess with its number and the remedy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from rasterio.fill import fillnodata

from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.read.guesses import Guesses, share_guess
from jaxurban.io.read.raster import (
    GROUND_M,
    check_range,
    open_raster,
    pixel_m,
    raster_extent_m,
    raster_window,
    read_raster,
)
from jaxurban.io.read.sampling import resample_raster
from jaxurban.settings import TO_GROUND
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
TALLEST_PLANT_M = 150.0  # the tallest tree stands at 116 m; birds and cables are above
LEAST_BARE = (
    0.1  # of the pixels around a city; Gothenburg 0.93, the same as elevations 0.06 and 0.07
)
WIDEST_PIXEL_M = 30.0  # wider ones hold more than one building and streets
MOST_MEDIAN_M = 60.0  # of a raster's roofs
MOST_PER_KM2 = 300_000  # the densest quarters of Hong Kong and Manila have about 100,000
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
    side_m = pixel_m(terrain, crs).min()
    step = max(1, int(FILL_M / side_m))
    coarse = values[::step, ::step].copy()  # GDAL writes into it
    reach = REACH_M / (step * side_m)  # in pixels
    coarse = fillnodata(coarse, np.isfinite(coarse), reach, temp_file_driver="MEM")
    fine = coarse.repeat(step, 0).repeat(step, 1)[: len(values), : values.shape[1]]
    filled = replace(terrain, values=np.where(np.isnan(values), fine, values))

    grid = covering_grid(box_m, (box_m[2] - box_m[0]) / PLACES_A_SIDE, crs)
    before, after = (
        np.isfinite(resample_raster(raster, grid)).mean() for raster in (terrain, filled)
    )
    if not after:
        raise InputError(
            f"the terrain {name} holds no elevation in the region: give one that covers it, or check its nodata "
            "value (of lidar points: that those of the ground have class 2)"
        )
    return filled, share_guess(
        after - before,
        "the terrain filled",
        f"the region has no elevation in the terrain {name} and takes that of the ground around, up to {REACH_M:g} m "
        "away: give a terrain without voids where that is too rough",
    )


def read_plants(
    path: str | Path, crs: str, wide_m: Bounds, box_m: Bounds
) -> tuple[Raster, Guesses]:
    """Return heights of plants, NaN where none grow, and the guess that none do where the raster ends.

    Args:
      path: of the raster.
      crs: projected CRS of the boxes.
      wide_m: x_min, y_min, x_max, y_max of what is read.
      box_m: the same of the region.

    Raises:
      InputError: as for `read_raster`, for either box, or values that are no heights above the ground.
    """
    name = repr(str(path))
    with open_raster(path) as source:
        raster_window(name, source, crs, box_m)
    plants = read_raster(path, crs, wide_m)
    check_range(name, plants.values, (-TALLEST_PLANT_M, TALLEST_PLANT_M))
    if np.mean(np.abs(plants.values) > GROUND_M) > 1 - LEAST_BARE:
        raise InputError(
            f"{name} looks like elevations and not heights of plants above the ground: less than {LEAST_BARE:.0%} of "
            "it is near 0; give a canopy height model, as surface less terrain is one"
        )
    region = shapely.box(*box_m)
    beyond = shapely.difference(region, shapely.box(*raster_extent_m(path, crs)))
    return plants, share_guess(
        beyond.area / region.area,
        "the region without a raster of plants",
        f"the region lies beyond {name} and is taken to hold no plants: give a raster that covers it",
    )


def pixel_guesses(roofs: Raster, crs: str) -> Guesses:
    """Return the guesses that a raster holds single roofs, and that it is in metres, where these are doubtful."""
    guesses = {}
    side_m = pixel_m(roofs, crs).max()
    if side_m > WIDEST_PIXEL_M:
        guesses["heights averaged over pixels"] = (
            f"the pixels of the raster of buildings are {side_m:.0f} m wide, wider than most buildings, so their "
            "heights are averages: streets are built over, and towers are higher than it says; give outlines, or a "
            "raster of 10 m or finer"
        )
    median_m = np.median(np.append(roofs.values[roofs.values > GROUND_M], 0.0))
    if median_m > MOST_MEDIAN_M:
        guesses["the unit of heights"] = (
            f"half of the built pixels of the raster of buildings are above {median_m:.0f} m, as in no city, read in "
            "metres: if it holds decimetres, say so with `gdal_edit.py -scale 0.1`"
        )
    return guesses


def terrain_guesses(city: City, terrain: Raster, box_m: Bounds) -> Guesses:
    """Return the guess that terrain which rises under buildings is bare ground; empty where it does not rise.

    Args:
      city: what stands.
      terrain: elevation of the ground.
      box_m: x_min, y_min, x_max, y_max of the region in the city's CRS, of which the middle is looked at.
    """
    from scipy.ndimage import binary_erosion, uniform_filter

    around_m = shapely.box(*box_m).centroid.buffer(AROUND_M).bounds
    grid = covering_grid(around_m, CELL_M, city.crs)
    from jaxurban.io.read.rasterise import rasterise  # imported here: it brings JAX

    surface = rasterise(replace(city, terrain=terrain, hanging=TO_GROUND), grid)
    has_data = np.ones(grid.shape) if surface.has_data is None else surface.has_data

    # Terrain and roofs above their mean around, where all around is known.
    is_known = binary_erosion(has_data, np.ones((NEAR_CELLS, NEAR_CELLS)))
    if is_known.sum() < LEAST_CELLS:
        return {}
    rise_m, height_m = (
        (values - uniform_filter(values, NEAR_CELLS))[is_known]
        for values in (surface.terrain_m, surface.roof_m)
    )
    (of_rise, both), (_, of_height) = np.cov(rise_m, height_m)
    is_related = both > LEAST_CORRELATION * np.sqrt(of_rise * of_height)
    return share_guess(
        both / of_height if is_related else 0.0,
        "heights in the terrain",
        "the heights of buildings are in the terrain already, as in a surface model (SRTM, Copernicus GLO-30), so "
        "roofs stand at wrong elevations by as much: give a terrain model of the bare ground",
        LEAST_RISE,
    )


def check_people(people: np.ndarray, area_m2: np.ndarray) -> None:
    """Raise InputError if a tenth of the blocks or pixels with people hold more of them than any quarter on the Earth.

    Args:
      people: ``[N]`` number in each block.
      area_m2: ``[N]`` of the blocks.
    """
    per_km2 = 1e6 * people / area_m2
    high = np.quantile(np.append(per_km2[people > 0], 0.0), 0.9)
    if high > MOST_PER_KM2 and area_m2.sum() > QUARTER_M2:
        raise InputError(
            f"the people of [population] are {high:,.0f} per km2 or more in a tenth of the blocks or pixels, and no "
            f"quarter has {MOST_PER_KM2:,}: give the number of people in each of them, not people per km2"
        )
