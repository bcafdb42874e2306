"""Whether GPS and lidar complement each other, by altitude: the paper's main finding, put to the numbers."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban.maps import MetricMaps
from jaxurban.studies.analysis import each
from jaxurban.studies.bootstrap import LEVEL, draws_of

GOOD = 0.5  # a sensor serves where its m is at least this
TILE_M = 500.0  # cells nearer than this are much alike, so whole tiles are drawn
FEWEST = 0.005  # share of cells where GPS is poor, below which nothing is said about them
SUMS = ("n", "gps", "lidar", "gps2", "lidar2", "both2", "poor", "lidar_poor", "lidar_good")
RISING = 1e-3  # differences of means smaller than this count as none


def complementarity(maps: MetricMaps, *, time: str | None = None) -> pd.DataFrame:
    """Return how GPS and lidar stand to each other over the free cells, a row for each altitude, lowest first.

    ``gps``, ``lidar``: mean m. ``correlation`` of the two. ``gps_poor``: share of cells with m_gps < 0.5.
    ``lidar_where_gps_poor``, ``lidar_where_gps_good``: mean m_lidar there, and ``difference`` of the two.
    ``gps_serves``, ``lidar_serves``, ``either_serves``: shares with m >= 0.5. ``prefers_gps``: share with m_gps >
    m_lidar. Correlation and difference carry 95 % intervals (``_low``, ``_high``) from the bootstrap over tiles of
    500 m. NaN where a metric does not vary, or GPS is poor in fewer than 0.5 % of the cells.

    Args:
      maps: with gps and lidar.
      time: epoch of the GPS map; the first if left out.
    """
    return pd.DataFrame([_at_altitude(maps, z, time) for z in sorted(maps.altitudes_m)])


def _at_altitude(maps: MetricMaps, altitude_m: float, time: str | None) -> dict[str, float]:
    is_free = maps.is_free(altitude_m)
    gps = maps.m("gps", altitude_m, time=time)[is_free].astype(np.float64)
    lidar = maps.m("lidar", altitude_m)[is_free].astype(np.float64)
    side = max(1, round(TILE_M / maps.grid.resolution_m))
    rows, cols = np.nonzero(is_free)
    _, tile = np.unique((rows // side) * (is_free.shape[1] // side + 1) + cols // side, return_inverse=True)
    is_poor = gps < GOOD
    parts = (np.ones_like(gps), gps, lidar, gps**2, lidar**2, gps * lidar, is_poor, lidar * is_poor, lidar * ~is_poor)
    sums = np.stack([np.bincount(tile, part) for part in parts], axis=1)  # [T, S]
    exact = _statistics(sums.sum(axis=0)[None])
    drawn = _statistics(draws_of(len(sums)) @ sums)
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
    for name, value in exact.items():
        known = drawn[name][np.isfinite(drawn[name])]
        found[name] = float(value[0])
        if name in ("correlation", "difference"):
            ends = np.quantile(known, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) if np.isfinite(value[0]) else (np.nan, np.nan)
            found |= dict(zip((f"{name}_low", f"{name}_high"), map(float, ends), strict=True))
    return found


def _statistics(sums: np.ndarray) -> dict[str, np.ndarray]:
    """Return what sums over cells ``[B, S]`` say, ``[B]`` each."""
    n, gps, lidar, gps2, lidar2, both2, poor, lidar_poor, lidar_good = sums.T
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


class Finding(NamedTuple):
    """A claim of the paper and what the numbers say: ``holds`` is None where they cannot tell."""

    claim: str
    holds: bool | None
    evidence: str


def findings(table: pd.DataFrame) -> list[Finding]:
    """Return the three claims of the paper's finding, each judged by `complementarity`'s numbers."""
    altitudes = table.altitude_m.tolist()
    low, high = table.iloc[0], table.iloc[-1]
    several = len(table) > 1
    trend = bool(np.all(np.diff(table.gps) > -RISING) and np.all(np.diff(table.lidar) < RISING))
    told = table[np.isfinite(table.difference)]
    coexist = [
        f"{row.altitude_m:g} m: m_lidar is {row.lidar_where_gps_poor:.2f} where GPS is poor and "
        f"{row.lidar_where_gps_good:.2f} elsewhere (difference {row.difference:+.2f}, 95 % "
        f"{row.difference_low:+.2f} to {row.difference_high:+.2f})"
        for row in each(told)
    ]
    untold = [f"{z:g}" for z in altitudes if z not in set(told.altitude_m)]
    if untold:
        coexist.append(f"at {', '.join(untold)} m GPS is poor in fewer than {FEWEST:.1%} of the free cells")
    known = table[np.isfinite(table.correlation)]
    listed = ", ".join(
        f"{row.correlation:+.2f} ({row.correlation_low:+.2f} to {row.correlation_high:+.2f}) at {row.altitude_m:g} m"
        for row in each(known)
    )
    return [
        Finding(
            "With altitude GPS gets better and lidar worse",
            trend if several else None,
            f"mean m_gps goes from {low.gps:.2f} at {altitudes[0]:g} m to {high.gps:.2f} at {altitudes[-1]:g} m, mean "
            f"m_lidar from {low.lidar:.2f} to {high.lidar:.2f}",
        ),
        Finding(
            "Where GPS is poor, lidar is good",
            bool((told.difference_low > 0).all()) if len(told) else None,
            "; ".join(coexist),
        ),
        Finding(
            "The higher the flight, the more apparent this is",
            _is_falling(known),
            f"the correlation of m_gps and m_lidar over free cells is {listed or 'not defined at any altitude'}",
        ),
    ]


def _is_falling(known: pd.DataFrame) -> bool | None:
    """Return whether the correlation falls with altitude; None where it rises by less than intervals tell."""
    if len(known) < 2:
        return None
    if np.all(np.diff(known.correlation) < 0):
        return True
    has_risen = known.correlation_low.to_numpy()[1:] > known.correlation_high.to_numpy()[:-1]
    return False if has_risen.any() else None


def verdict(table: pd.DataFrame) -> str:
    """Return one sentence: whether the complementarity of GPS and lidar holds, by `complementarity`'s numbers."""
    told = [each.holds for each in findings(table)]
    if not any(holds is not None for holds in told):
        return (
            "These maps cannot tell whether GPS and lidar complement each other: use more altitudes, or a denser city."
        )
    word = "is refuted" if True not in told else "holds in part" if False in told else "holds"
    low = table.iloc[0]
    return (
        f"The paper's finding that GPS and lidar complement each other {word} here: of its three claims "
        f"{told.count(True)} hold, {told.count(False)} do not, {told.count(None)} cannot be told; at "
        f"{low.altitude_m:g} m GPS serves (m >= {GOOD:g}) in {low.gps_serves:.1%} of the free cells, lidar in "
        f"{low.lidar_serves:.1%}, and one or the other in {low.either_serves:.1%}."
    )
