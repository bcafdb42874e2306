"""Whether GPS and lidar complement each other, by altitude: the numbers of the paper's main finding."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.studies.bootstrap import draws_of, ends_of

GOOD = 0.5  # a sensor serves where its m is at least this
TILE_M = 500.0  # cells nearer than this are much alike, so whole tiles are drawn
FEWEST = 0.005  # share of cells where GPS is poor, below which nothing is said about them


def complementarity(
    maps: MetricMaps, *, altitudes_m: Sequence[float] | None = None, time: str | None = None
) -> pd.DataFrame:
    """Return how GPS and lidar stand to each other over the free cells, a row for each altitude, lowest first.

    ``gps``, ``lidar``: mean m. ``correlation`` of the two, and ``step``, its change from the altitude below.
    ``gps_poor``: share of cells with m_gps < 0.5. ``lidar_where_gps_poor``, ``lidar_where_gps_good``: mean m_lidar
    there, and ``difference`` of the two. ``gps_serves``, ``lidar_serves``, ``either_serves``: shares with m >= 0.5.
    ``prefers_gps``: share with m_gps > m_lidar. Correlation, step and difference carry 95 % intervals (``_low``,
    ``_high``) from the bootstrap over tiles of 500 m, the same tiles drawn at every altitude. NaN where a metric does
    not vary, GPS is poor in fewer than 0.5 % of the cells, or there are fewer than eight tiles.

    Args:
      maps: with gps and lidar.
      altitudes_m: some of the maps' altitudes; all if left out.
      time: UTC time of the GPS map; the first if left out.
    """
    side = max(1, round(TILE_M / maps.grid.resolution_m))
    rows, cols = np.indices(maps.grid.shape, np.int32) // side
    tile = rows * (int(cols.max()) + 1) + cols
    free_tiles = np.unique(tile[np.logical_or.reduce([maps.is_free(z, "centre") for z in maps.altitudes_m])])
    tile = np.searchsorted(free_tiles, tile)
    draws = draws_of(len(free_tiles))
    found: list[dict[str, float]] = []
    below: dict[str, np.ndarray] | None = None
    for altitude_m in sorted(maps.altitudes_m if altitudes_m is None else altitudes_m):
        row, sums = _at_altitude(maps, altitude_m, time, tile, len(free_tiles))
        exact, drawn = _statistics(sums.sum(axis=0)[None]), _statistics(draws @ sums)
        row |= {name: float(value[0]) for name, value in exact.items()}
        drawn["step"] = drawn["correlation"] - (np.nan if below is None else below["correlation"])
        row["step"] = row["correlation"] - (found[-1]["correlation"] if found else np.nan)
        for name in ("correlation", "step", "difference"):
            ends = ends_of(drawn[name], len(free_tiles)) if np.isfinite(row[name]) else (np.nan, np.nan)
            row |= dict(zip((f"{name}_low", f"{name}_high"), ends, strict=True))
        found.append(row)
        below = drawn
    return pd.DataFrame(found)


def _at_altitude(
    maps: MetricMaps, altitude_m: float, time: str | None, tile: np.ndarray, num_tiles: int
) -> tuple[dict[str, float], np.ndarray]:
    """Return shares and means over the free cells, and the sums over each tile ``[T, S]``."""
    is_free = maps.is_free(altitude_m, "centre")
    gps = maps.m("gps", altitude_m, time=time)[is_free].astype(np.float64)
    lidar = maps.m("lidar", altitude_m)[is_free].astype(np.float64)
    is_poor = gps < GOOD
    parts = (np.ones_like(gps), gps, lidar, gps**2, lidar**2, gps * lidar, is_poor, lidar * is_poor, lidar * ~is_poor)
    sums = np.stack([np.bincount(tile[is_free], part, num_tiles) for part in parts], axis=1)
    found = {
        "altitude_m": altitude_m,
        "gps": float(gps.mean()),
        "lidar": float(lidar.mean()),
        "gps_poor": float(is_poor.mean()),
        "gps_serves": float((gps >= GOOD).mean()),
        "lidar_serves": float((lidar >= GOOD).mean()),
        "either_serves": float(((gps >= GOOD) | (lidar >= GOOD)).mean()),
        "prefers_gps": float((gps > lidar).mean()),
    }
    return found, sums


def _statistics(sums: np.ndarray) -> dict[str, np.ndarray]:
    """Return what sums over cells ``[B, S]`` say, ``[B]`` each."""
    n, gps, lidar, gps2, lidar2, both2, poor, lidar_poor, lidar_good = sums.T
    n = np.maximum(n, 1.0)  # a draw of tiles without a free cell at this altitude varies in nothing
    spread = np.maximum(gps2 / n - (gps / n) ** 2, 0) * np.maximum(lidar2 / n - (lidar / n) ** 2, 0)
    varies = spread > 1e-12
    correlation = np.where(varies, (both2 / n - gps * lidar / n**2) / np.sqrt(np.where(varies, spread, 1.0)), np.nan)
    enough = (poor >= FEWEST * n) & (poor < n)
    where_poor = np.where(enough, lidar_poor / np.where(enough, poor, 1.0), np.nan)
    where_good = lidar_good / np.maximum(n - poor, 1.0)
    return {
        "correlation": correlation,
        "lidar_where_gps_poor": where_poor,
        "lidar_where_gps_good": where_good,
        "difference": where_poor - where_good,
    }
