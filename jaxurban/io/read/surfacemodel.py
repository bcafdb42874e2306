"""Surface models (roofs, trees and ground above sea level): made from heights above ground, and made into them."""

import warnings
from dataclasses import replace

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.read.sampling import heights_above, pixel_xy, thinned
from jaxurban.world.city import Raster, ReadIssue, ReadIssues

GROUND_M = 2.0  # nothing this low above the terrain is a building: noise of two models, cars, hedges
BLOCK_M = 100.0  # wider than most halls: a street, a yard or a clearing lies in almost every block of a city
SAMPLES_A_SIDE = 20  # of a block
LOW_SHARE = 0.05  # of a block's samples lie below its low level: pits, noise and holes
RELIEF_M = 3.0  # of a block on which something stands: water and fields tell nothing
# Shares of blocks whose low level is more than GROUND_M from 0. Heights above ground: Bilbao 0.002, Gothenburg (surface
# less terrain) 0; surfaces: Gothenburg 0.62 (a quay), Bilbao 0.83 (a river and hills).
MOST_RAISED = 0.4
MOST_SUNKEN = 0.05  # of a surface may lie below the terrain; heights above ground lie there wherever ground is open
MOST_COMPARED = 10**6  # pixels of heights looked at to tell
LEAST_HILLY = 0.05  # of the cells must stand on higher terrain than GROUND_M for that to tell


def heights_of_surface(name: str, surface: Raster, terrain: Raster | None, crs: str) -> tuple[Raster, ReadIssues]:
    """Return the heights of a surface model above the terrain, and how many cells were taken for ground, by issue.

    What stands less than `GROUND_M` above the terrain, or below it, is ground.

    Args:
      name: of the file, for messages.
      surface: elevations.
      terrain: of the ground, on any grid.
      crs: projected CRS in metres.

    Raises:
      InputError: no terrain, or surface and terrain do not belong together.
    """
    if terrain is None:
        raise InputError(
            f'[buildings] kind = "surface" takes the ground from below {name}: give its elevation as [terrain] source'
        )
    above = heights_above(surface, terrain)
    if (sunken := _share(above.values < -GROUND_M, np.isfinite(above.values))) > 0.5:
        raise InputError(
            f"{name} lies below the terrain in {sunken:.0%} of its cells: if it holds heights above ground, leave out "
            '[buildings] kind = "surface"; else bring both to one vertical datum and unit'
        )
    if (raised := _raised_share(above, crs)) > MOST_RAISED:
        raise InputError(
            f"{name} is more than {GROUND_M:g} m off the terrain all over {raised:.0%} of its blocks of {BLOCK_M:g} m, "
            "streets and yards included: bring both to one vertical datum and unit, and check which of them is the "
            "terrain"
        )
    warnings.warn(
        f"heights are {name} less the terrain: trees, bridges and cranes in it count as buildings, and what is lower "
        f"than {GROUND_M:g} m as ground",
        stacklevel=2,
    )
    is_ground = above.values < GROUND_M
    issues = {
        ReadIssue.CELLS_BELOW_GROUND: int(np.sum(above.values < 0)),
        ReadIssue.CELLS_NEAR_GROUND: int(np.sum(is_ground)),
    }
    return replace(above, values=np.where(is_ground, np.float32(0), above.values)), issues


def check_is_no_surface(name: str, heights: Raster, terrain: Raster | None, crs: str) -> None:
    """Raise InputError if a raster of heights above ground looks like a surface model.

    With terrain: elevations are nowhere below it, heights are wherever open ground lies higher than they. Without (or
    where the terrain is near 0): in a city's heights almost every block of 100 m has some ground, which is near 0.

    Args:
      name: of the file, for messages.
      heights: the raster.
      terrain: of the ground, on any grid; None where it is not known.
      crs: projected CRS in metres.
    """
    remedy = (
        'set [buildings] kind = "surface" and give the elevation of the ground as [terrain] source, or give heights '
        "above ground (0 where nothing stands)"
    )
    if terrain is not None:
        some = thinned(heights, MOST_COMPARED)
        above_m = heights_above(some, terrain).values
        is_hilly = some.values - above_m > GROUND_M
        if _share(is_hilly, np.isfinite(above_m)) >= LEAST_HILLY:
            if (sunken := _share(is_hilly & (above_m < -GROUND_M), is_hilly)) < MOST_SUNKEN:
                raise InputError(
                    f"{name} looks like a surface model, elevations and not heights above ground: only {sunken:.1%} of "
                    f"its cells lie below the terrain, as heights do on open ground; {remedy}"
                )
            return
    if (raised := _raised_share(heights, crs)) > MOST_RAISED:
        raise InputError(
            f"{name} looks like a surface model, elevations and not heights above ground: {raised:.0%} of its blocks "
            f"of {BLOCK_M:g} m with something on them have no ground near 0; {remedy}"
        )


def _share(part: np.ndarray, whole: np.ndarray) -> float:
    return float(np.sum(part)) / max(int(np.sum(whole)), 1)


def _raised_share(raster: Raster, crs: str) -> float:
    """Return the share of the blocks on which something stands without ground near 0; 0 if nothing stands."""
    level_m = low_levels(raster, crs)
    return _share(np.abs(level_m) > GROUND_M, np.ones_like(level_m))


def low_levels(raster: Raster, crs: str) -> np.ndarray:
    """Return the low level of each block of 100 m of a raster on which something stands, ``[N]`` metres.

    Args:
      raster: elevations or heights, metres.
      crs: projected CRS in metres, to measure pixels in.
    """
    num_rows, num_cols = raster.values.shape
    row, col = num_rows / 2 + np.array([0, 1, 0]), num_cols / 2 + np.array([0, 0, 1])
    x_m, y_m = pixel_xy(raster, row, col, crs)
    down_m, right_m = np.hypot(x_m[1:] - x_m[0], y_m[1:] - y_m[0])
    height, width = (max(1, round(BLOCK_M / pixel_m)) for pixel_m in (down_m, right_m))  # of a block
    padded = np.pad(raster.values, ((0, -num_rows % height), (0, -num_cols % width)), constant_values=np.nan)
    blocks = padded.reshape(len(padded) // height, height, -1, width).swapaxes(1, 2)
    samples = blocks[..., :: -(-height // SAMPLES_A_SIDE), :: -(-width // SAMPLES_A_SIDE)]
    values = np.sort(samples.reshape(samples.shape[0] * samples.shape[1], -1), axis=1)  # NaN last
    num = np.isfinite(values).sum(axis=1)
    is_told = num >= values.shape[1] / 4
    values, num = values[is_told], num[is_told]
    each = np.arange(len(values))
    low_m, high_m = values[each, (LOW_SHARE * num).astype(int)], values[each, num - 1]
    return low_m[high_m - low_m >= RELIEF_M]
