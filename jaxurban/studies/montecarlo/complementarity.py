"""Whether GPS and lidar complement each other, by altitude: the paper's main finding, judged by the numbers."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.studies.bootstrap import draws_of, ends_of
from jaxurban.studies.montecarlo.analysis import each

GOOD = 0.5  # a sensor serves where its m is at least this
TILE_M = 500.0  # cells nearer than this are much alike, so whole tiles are drawn
FEWEST = 0.005  # share of cells where GPS is poor, below which nothing is said about them
SUMS = ("n", "gps", "lidar", "gps2", "lidar2", "both2", "poor", "lidar_poor", "lidar_good")
RISING = 1e-3  # differences of means smaller than this count as none


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


class Finding(NamedTuple):
    """A claim and what the numbers say: ``holds`` is None where they cannot tell."""

    claim: str
    holds: bool | None
    evidence: str


def findings(table: pd.DataFrame) -> list[Finding]:
    """Return the three claims of the paper's finding, each judged by `complementarity`'s numbers."""
    altitudes = table.altitude_m.tolist()
    low, high = table.iloc[0], table.iloc[-1]
    several = len(table) > 1
    trend = bool(np.all(np.diff(table.gps) > -RISING) and np.all(np.diff(table.lidar) < RISING))
    clear = table[np.isfinite(table.difference)]
    coexist = [
        f"{row.altitude_m:g} m: m_lidar is {row.lidar_where_gps_poor:.2f} where GPS is poor and "
        f"{row.lidar_where_gps_good:.2f} elsewhere, difference {row.difference:+.2f}"
        f"{_interval(row.difference_low, row.difference_high)}"
        for row in each(clear)
    ]
    unclear = [f"{z:g}" for z in altitudes if z not in set(clear.altitude_m)]
    if unclear:
        coexist.append(f"at {', '.join(unclear)} m GPS is poor in fewer than {FEWEST:.1%} of the free cells")
    known = table[np.isfinite(table.correlation)]
    listed = ", ".join(
        f"{row.correlation:+.2f}{_interval(row.correlation_low, row.correlation_high)} at {row.altitude_m:g} m"
        for row in each(known)
    )
    steps = "; ".join(
        f"to {row.altitude_m:g} m it changes by {row.step:+.2f}{_interval(row.step_low, row.step_high)}"
        for row in each(known[np.isfinite(known.step)])
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
            _is_good(clear),
            "; ".join(coexist),
        ),
        Finding(
            "The higher the flight, the more apparent this is",
            _is_falling(known),
            f"the correlation of m_gps and m_lidar over free cells is {listed or 'not defined at any altitude'}"
            + (f"; {steps}" if steps else ""),
        ),
    ]


def _interval(low: float, high: float) -> str:
    """Return an interval as text, or nothing where it is not known."""
    return f" ({low:+.2f} to {high:+.2f})" if np.isfinite(low) else ""


def _is_good(clear: pd.DataFrame) -> bool | None:
    """Return whether lidar is good where GPS is poor, and better than elsewhere; None where intervals cannot tell.

    Altitudes at which no interval is known, as GPS is poor in too few cells, are passed over.
    """
    clear = clear[np.isfinite(clear.difference_low)]
    if ((clear.lidar_where_gps_poor < GOOD) | (clear.difference_high < 0)).any():
        return False
    return True if len(clear) and (clear.difference_low > 0).all() else None


def _is_falling(known: pd.DataFrame) -> bool | None:
    """Return whether the correlation falls from altitude to altitude; None where a step's interval holds 0."""
    steps = known[np.isfinite(known.step)]
    if (steps.step_low > 0).any():
        return False
    return True if len(steps) and (steps.step_high < 0).all() else None


def verdict(table: pd.DataFrame) -> str:
    """Return one sentence: whether the complementarity of GPS and lidar holds, by `complementarity`'s numbers."""
    held = [each.holds for each in findings(table)]
    if not any(holds is not None for holds in held):
        return (
            "These maps cannot tell whether GPS and lidar complement each other: use more altitudes, or a denser city."
        )
    if all(held):
        word = "holds"
    elif True in held:
        word = "is borne out in part only"
    else:
        word = "is refuted" if None not in held else "is not borne out as far as these maps can tell"
    low = table.iloc[0]
    return (
        f"The paper's finding that GPS and lidar complement each other {word}: of its three claims "
        f"{held.count(True)} {'holds' if held.count(True) == 1 else 'hold'}, {held.count(False)} "
        f"{'does' if held.count(False) == 1 else 'do'} not, {held.count(None)} cannot be told; at "
        f"{low.altitude_m:g} m GPS serves (m >= {GOOD:g}) in {low.gps_serves:.1%} of the free cells, lidar in "
        f"{low.lidar_serves:.1%}, and one or the other in {low.either_serves:.1%}."
    )
