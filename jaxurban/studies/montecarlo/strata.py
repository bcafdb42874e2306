"""Strata: what kind of place each cell lies in, found from the maps and, where it is known, the land cover."""

import numpy as np
import shapely

from jaxurban.io.read.rasterise import burn
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.world.city import LandCover

STRATA = ("water", "park", "wide-open", "open", "low-rise", "high-rise")
NEAR_M = 125.0  # half the side of the square that makes a place built-up
FAR_M = 250.0  # half the side of the square without a roof that makes a place wide-open
BUILT_SHARE = 0.1  # of the square's cells
HIGH_RISE_M = 35.0  # roofs from here up are high-rise buildings (Emporis' definition)
NO_STRATUM = -1


def strata_of(maps: MetricMaps, cover: LandCover | None = None) -> np.ndarray:
    """Return ``[Y, X]`` int8, the number of each cell's stratum in `STRATA`, `NO_STRATUM` where there are no data.

    **water** and **park** are cells whose centre lies in the land cover's. Elsewhere, within the 250 m square around a
    cell: **high-rise** where at least a tenth of the cells carry a roof of 35 m or more, else **low-rise** where at
    least a tenth carry any roof, else **open** (squares, shores, yards). **wide-open** is an open cell with no roof in
    the 500 m square around it; without a land cover, wide water and the middle of a large park are that. At the maps'
    edges the squares are what lies inside.

    Args:
      maps: their roofs count.
      cover: water and parks in the maps' CRS; left out, neither is known.
    """
    roof_m, has_data, resolution_m = maps.m("roof"), maps.ds["has_data"].values, maps.grid.resolution_m
    near, far = (max(1, round(half_m / resolution_m)) for half_m in (NEAR_M, FAR_M))
    is_high = share_around(roof_m >= HIGH_RISE_M, near) >= BUILT_SHARE
    is_built = share_around(roof_m > 0, near) >= BUILT_SHARE
    is_wide = share_around(roof_m > 0, far) == 0
    chosen = [STRATA.index(name) for name in ("high-rise", "low-rise", "wide-open")]
    strata = np.select([is_high, is_built, is_wide], chosen, STRATA.index("open")).astype(np.int8)
    if cover is not None:
        for name, shape in (("park", cover.park), ("water", cover.water)):
            parts = shapely.get_parts(shape)
            strata[burn(parts, np.ones(len(parts), np.uint8), maps.grid, 0, "uint8") == 1] = STRATA.index(name)
    strata[~has_data] = NO_STRATUM
    return strata


def share_around(mask: np.ndarray, half: int) -> np.ndarray:
    """Return ``[Y, X]`` the share of set cells in the square up to ``half`` cells away from each, cut at edges."""
    total = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), np.int64)
    np.cumsum(np.cumsum(mask, axis=0, dtype=np.int64), axis=1, out=total[1:, 1:])
    (low_r, high_r), (low_c, high_c) = (
        (np.maximum(np.arange(size) - half, 0), np.minimum(np.arange(size) + half + 1, size)) for size in mask.shape
    )
    count = total[np.ix_(high_r, high_c)] - total[np.ix_(low_r, high_c)]
    count -= total[np.ix_(high_r, low_c)] - total[np.ix_(low_r, low_c)]
    return count / np.outer(high_r - low_r, high_c - low_c)
