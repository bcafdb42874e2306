"""What a mission meets: buildings, the ground, no-fly zones and closed cells; and what of it cannot be judged."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.constraints import FILE_MARGIN_M, Bound, Constraints
from jaxurban.paths.contacts import TOUCH_M, Prisms, contacts, merged
from jaxurban.paths.legs import NO_DATA, Flight, Pieces, spans

ON_SITE = ("climb", "land")  # kinds of legs between the ground and the height of flight
GUESSED_ROOFS = "lie over or beside roofs whose height is guessed"
COLUMNS = [
    "kind",
    "what",
    "item",
    "lon",
    "lat",
    "along_m",
    "to_m",
    "height_m",
    "building_m",
    "by_m",
    "is_guessed",
]


class Judgement(NamedTuple):
    """What was seen of a mission.

    Attributes:
      findings: a row each, of `COLUMNS`.
      unknown: what could not be judged: ``reason``, ``from_m`` and ``to_m`` along the mission.
    """

    findings: pd.DataFrame
    unknown: pd.DataFrame


def judged(
    flight: Flight,
    maps: MetricMaps,
    buildings: Prisms,
    constraints: Constraints,
    times: Iterable[str | None],
    time_of_day: str | None,
) -> Judgement:
    """Return what a mission meets, and what cannot be judged.

    Args:
      flight: the mission over the maps.
      maps: the maps.
      buildings: what stands there.
      constraints: zones in force, bounds, and clearances, all of which are there.
      times, time_of_day: of the maps that bounds are on.
    """
    pieces, low_m, high_m = flight.pieces, min(maps.altitudes_m), max(maps.altitudes_m)
    pieces = pieces.cut_at(maps.altitudes_m)
    unknown = [flight.unknown]
    has_data = maps.ds["has_data"].values[pieces.row, pieces.col]
    is_known = has_data & np.isfinite(pieces.z_m).all(axis=1)
    unknown.append(spans(pieces.along_m[~is_known], NO_DATA))
    pieces = pieces.take(is_known)
    kinds = np.array([leg.kind for leg in flight.mission.legs], dtype=object)[pieces.leg]
    is_on_site = np.isin(kinds, ON_SITE) | (pieces.over_m == 0)
    z_m = pieces.middle_z_m
    is_below = (z_m < low_m) & (z_m >= 0) & ~is_on_site
    unknown += [
        spans(pieces.along_m[is_below], f"lie below the maps, which begin at {low_m:g} m"),
        spans(pieces.along_m[z_m > high_m], f"lie above the maps, which reach to {high_m:g} m"),
    ]
    guessed = buildings.take(buildings.is_guessed)
    endless = guessed._replace(floor_m=guessed.floor_m - np.inf, top_m=guessed.top_m + np.inf)
    over = contacts(pieces, endless, maps, beside_m=constraints.horizontal_m)
    unknown.append(spans(over[["from_m", "to_m"]].to_numpy(), GUESSED_ROOFS))

    findings = [
        _buildings(pieces, buildings, maps, constraints),
        _terrain(pieces),
        _zones(pieces, maps, constraints),
    ]
    for what, is_closed, is_unknown in _closed(
        pieces, maps, constraints.bounds, times, time_of_day
    ):
        findings.append(_of_pieces(pieces, is_closed, "closed", f"enters cells that {what}"))
        reason = f"lie where it is not known whether {what}"
        unknown.append(spans(pieces.along_m[is_unknown], reason))
    table = pd.concat(findings, ignore_index=True)
    table["item"] = [flight.mission.legs[leg].item for leg in pieces.leg[table["piece"]]]
    table["lon"], table["lat"] = maps.grid.lonlat_of_xy(table["x_m"], table["y_m"])
    table = table.rename(columns={"from_m": "along_m", "z_m": "height_m"})
    table = table.sort_values("along_m", ignore_index=True)
    return Judgement(table.reindex(columns=COLUMNS), pd.concat(unknown, ignore_index=True))


def _buildings(
    pieces: Pieces, buildings: Prisms, maps: MetricMaps, constraints: Constraints
) -> pd.DataFrame:
    """Return where a mission flies into buildings, and where it comes nearer than the clearances."""
    beside_m = max(0.0, constraints.horizontal_m - FILE_MARGIN_M)
    above_m = max(0.0, constraints.vertical_m - FILE_MARGIN_M)
    hits = contacts(pieces, buildings, maps)
    near = contacts(pieces, buildings, maps, beside_m=beside_m, above_m=above_m)
    near = near[~_is_around(near, hits)]
    is_beside = (near["apart_m"] > 0).to_numpy()
    least_m = near["apart_m"].where(is_beside, near["gap_m"])
    asked_m = np.where(is_beside, constraints.horizontal_m, constraints.vertical_m)
    near = merged(near.assign(short_m=asked_m - least_m, is_beside=is_beside), "is_beside")
    hits = merged(hits)
    what = [f"flies into a building, by up to {-gap_m:.1f} m" for gap_m in hits["gap_m"]]
    for is_beside, short_m in zip(near["is_beside"], near["short_m"], strict=True):
        asked = constraints.horizontal_m if is_beside else constraints.vertical_m
        where = "beside a building" if is_beside else "over or under a building"
        what.append(f"passes {asked - short_m:.1f} m {where}; the clearance is {asked:g} m")
    rows = pd.concat([hits.assign(by_m=-hits["gap_m"]), near.assign(by_m=near["short_m"])])
    prism = rows["prism"].to_numpy(int)
    is_guessed = buildings.is_guessed[prism]
    what = [
        text + " (of guessed height)" * guess
        for text, guess in zip(what, is_guessed.tolist(), strict=True)
    ]
    return rows.assign(
        kind="building", what=what, is_guessed=is_guessed, building_m=buildings.top_m[prism]
    )


def _is_around(near: pd.DataFrame, hits: pd.DataFrame) -> np.ndarray:
    """Return ``[N]`` bool: a stretch lies where the mission approaches, crosses and leaves a prism that it hits."""
    stretches = merged(near, "prism")
    pairs = stretches.merge(hits[["prism", "from_m", "to_m"]], on="prism", suffixes=("", "_hit"))
    is_hit = (pairs["from_m"] - TOUCH_M <= pairs["from_m_hit"]) & (
        pairs["to_m_hit"] <= pairs["to_m"] + TOUCH_M
    )
    around = merged(pairs.loc[is_hit, ["from_m", "to_m"]])
    place = np.searchsorted(around["from_m"] - TOUCH_M, near["from_m"], side="right") - 1
    reach_m = np.append(around["to_m"].to_numpy(), -np.inf)[place]
    return near["to_m"].to_numpy() <= reach_m + TOUCH_M


def _terrain(pieces: Pieces) -> pd.DataFrame:
    """Return where a mission flies below the ground."""
    buried = _of_pieces(pieces, pieces.z_m.min(axis=1) < -FILE_MARGIN_M, "terrain", "")
    what = [f"flies {depth_m:.1f} m below the ground" for depth_m in buried["by_m"]]
    return buried.assign(what=what)


def _zones(pieces: Pieces, maps: MetricMaps, constraints: Constraints) -> pd.DataFrame:
    """Return where a mission enters no-fly zones."""
    zones = constraints.zones
    shapes = np.array([zone.on(maps.grid) for zone in zones], dtype=object)
    floor_m, ceiling_m = np.array([[z.floor_m, z.ceiling_m] for z in zones]).reshape(-1, 2).T
    prisms = Prisms(shapes, floor_m, ceiling_m, np.zeros(len(zones), bool))
    rows = merged(contacts(pieces, prisms, maps), "prism")
    entered = [zones[int(number)] for number in rows["prism"]]
    what = [f"enters the no-fly zone {zone.label} ({zone.heights})" for zone in entered]
    return rows.assign(kind="zone", what=what, by_m=np.nan)


def _closed(
    pieces: Pieces,
    maps: MetricMaps,
    bounds: Iterable[Bound],
    times: Iterable[str | None],
    time_of_day: str | None,
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield what closes cells, in words, and ``[P]`` bool: pieces in closed cells, and pieces where it is not known."""
    z_m, times = pieces.middle_z_m, list(times)
    low_m, high_m = min(maps.altitudes_m), max(maps.altitudes_m)
    is_in_range = (low_m <= z_m) & (z_m <= high_m)
    levels_m = np.array(sorted(maps.altitudes_m))
    gap = np.clip(np.searchsorted(levels_m, z_m, side="right"), 1, max(1, len(levels_m) - 1))
    middles_m = np.append(levels_m[0], (levels_m[:-1] + levels_m[1:]) / 2)
    at_m = middles_m[gap if len(levels_m) > 1 else np.zeros_like(gap)]
    for bound in bounds:
        is_closed = np.zeros(len(z_m), bool)
        for between_m in np.unique(at_m[is_in_range]).tolist():
            at = is_in_range & (at_m == between_m)
            for time in times:
                is_kept = bound.is_kept(maps, between_m, time, time_of_day)
                is_closed[at] |= ~is_kept[pieces.row[at], pieces.col[at]]
        yield f"the bound {bound} closes", is_closed, ~is_in_range
    for name in maps.metrics:
        if "layer" in maps.ds[maps.variable(name)].attrs:
            is_missing = np.zeros(len(z_m), bool)
            for level_m in np.unique(at_m).tolist():
                at = at_m == level_m
                for z in maps.around(level_m):
                    is_missing[at] |= np.isnan(maps.m(name, z))[pieces.row[at], pieces.col[at]]
            yield f"lack a value of {name} and are closed", is_missing, np.zeros(len(z_m), bool)


def _of_pieces(pieces: Pieces, chosen: np.ndarray, kind: str, what: str) -> pd.DataFrame:
    """Return a row for each stretch of pieces that were chosen; by how much it lies below the ground."""
    piece = np.flatnonzero(chosen)
    (x_m, y_m), (from_m, to_m) = pieces.ends_m[piece, 0].T, pieces.along_m[piece].T
    z_m = pieces.z_m[piece]
    rows = {
        "piece": piece,
        "from_m": from_m,
        "to_m": to_m,
        "x_m": x_m,
        "y_m": y_m,
        "z_m": z_m[:, 0],
    }
    table = merged(pd.DataFrame(rows | {"gap_m": z_m.min(axis=1)}))
    depth_m = -table["gap_m"] if kind == "terrain" else np.nan
    return table.assign(kind=kind, what=what, by_m=depth_m)
