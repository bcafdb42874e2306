"""What a mission meets: buildings, the ground, no-fly zones and closed cells; and what of it cannot be judged."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import pandas as pd
import shapely

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.clearance import FILE_MARGIN_M
from jaxurban.paths.constraints import Bound, Constraints
from jaxurban.paths.contacts import TOUCH_M, Prisms, contacts, merged
from jaxurban.paths.export.base import GROUND_TOLERANCE_M
from jaxurban.paths.legs import Flight, Steps, spans
from jaxurban.paths.profile import nearest_level_m

# So near an altitude of the maps a step is at it: files round heights up to centimetres.
LEVEL_M = 0.02
ON_SITE = ("climb", "land")  # kinds of legs between the ground and the height of flight
NO_DATA = "lie over cells without data"
NO_CITY = "lie where the source of the buildings does not know what stands"
GUESSED_ROOFS = "lie over roofs of guessed height, or nearer to them than the clearance"
PLACE = ["lon", "lat", "along_m", "to_m", "height_m"]
COLUMNS = ["kind", "what", "item", *PLACE, "building_m", "by_m", "is_guessed"]


def judged(
    flight: Flight,
    maps: MetricMaps,
    buildings: Prisms,
    known: shapely.Geometry,
    limits: Constraints,
    times: Sequence[str | None],
    time_of_day: str | None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return what a mission meets, a row each of `COLUMNS`, and what of it cannot be judged, as ``flight.unknown``.

    Args:
      flight: the mission over the maps.
      maps: the maps.
      buildings: what stands there.
      known: where that is known, in the maps' CRS.
      limits: zones in force, bounds, and clearances, all of which are there.
      times, time_of_day: of the maps that bounds are on.
    """
    steps = flight.steps
    has_data = maps.ds["has_data"].values[tuple(steps.cell.T)]
    is_known = has_data & np.isfinite(steps.z_m).all(axis=1)
    unknown = [flight.unknown, spans(steps.along_m[~is_known], NO_DATA)]
    steps = steps.take(is_known)
    near = contacts(steps, buildings, maps, limits.horizontal_m)
    is_guessed = buildings.is_guessed[near["prism"]]
    unknown += _beyond(flight, steps, maps, known, limits.horizontal_m)
    unknown.append(spans(near.loc[is_guessed, ["from_m", "to_m"]].to_numpy(), GUESSED_ROOFS))
    findings = [
        *_buildings(near, buildings, limits),
        _buried(steps),
        _zones(steps, maps, limits),
        *_closed(steps, maps, limits, times, time_of_day),
    ]
    table = pd.concat(findings, ignore_index=True)
    first = steps.take(table["step"].to_numpy(int))
    lon, lat = maps.grid.lonlat_of_xy(*first.ends_m[:, 0].T)
    items = [flight.mission.legs[leg].item for leg in first.leg]
    table = table.assign(item=items, lon=lon, lat=lat, height_m=first.z_m[:, 0])
    table = table.rename(columns={"from_m": "along_m"}).sort_values("along_m", ignore_index=True)
    return table.reindex(columns=COLUMNS), pd.concat(unknown, ignore_index=True)


def _beyond(
    flight: Flight, steps: Steps, maps: MetricMaps, known: shapely.Geometry, horizontal_m: float
) -> Iterator[pd.DataFrame]:
    """Yield the spans that lie where no building is known, nor within a clearance of there, or off the maps' heights.

    Below the maps count only those that do not lead between the ground and the height of flight.
    """
    reached = shapely.buffer(known, -horizontal_m) if horizontal_m else known
    shapely.prepare(reached)
    is_off = ~shapely.intersects_xy(reached, *steps.ends_m.mean(axis=1).T)
    yield spans(steps.along_m[is_off], NO_CITY)
    kinds = np.array([leg.kind for leg in flight.mission.legs], object)[steps.leg]
    is_on_site = np.isin(kinds, ON_SITE) | (steps.over_m == 0)
    z_m = steps.z_m.mean(axis=1)
    low_m = min(maps.altitudes_m)
    high_m = max(maps.altitudes_m)
    is_below = (z_m < low_m - GROUND_TOLERANCE_M) & ~is_on_site
    is_above = z_m > high_m + GROUND_TOLERANCE_M
    yield spans(steps.along_m[is_below], f"lie below the maps, which begin at {low_m:g} m")
    yield spans(steps.along_m[is_above], f"lie above the maps, which reach to {high_m:g} m")


def _buried(steps: Steps) -> pd.DataFrame:
    """Return the stretches below the ground."""
    z_m = steps.z_m.min(axis=1)
    stretches = _stretches(steps, z_m < -FILE_MARGIN_M, gap_m=z_m)
    texts = [f"flies up to {-gap_m:.1f} m below the ground" for gap_m in stretches["gap_m"]]
    return stretches.assign(kind="terrain", what=texts, by_m=-stretches["gap_m"])


def _closed(
    steps: Steps,
    maps: MetricMaps,
    limits: Constraints,
    times: Sequence[str | None],
    time_of_day: str | None,
) -> Iterator[pd.DataFrame]:
    """Yield the stretches in cells that a bound closes, or where a layer of the user has no value."""
    closing = {f"do not keep {bound}": bound for bound in limits.bounds}
    for name in maps.metrics:
        if "layer" in maps.ds[maps.variable(name)].attrs:
            closing[f"have no value of {name}"] = Bound(name, ">=", 0.0)
    for what, bound in closing.items():
        stretches = _stretches(steps, _is_closed(steps, maps, bound, times, time_of_day))
        yield stretches.assign(kind="closed", what=f"enters cells that {what}")


def _buildings(near: pd.DataFrame, buildings: Prisms, limits: Constraints) -> list[pd.DataFrame]:
    """Return where a mission flies into buildings, and where it comes nearer than the clearances, of its contacts."""
    is_over = near["apart_m"] == 0
    is_close = near["gap_m"] < limits.vertical_m - FILE_MARGIN_M
    is_close &= is_over | (near["apart_m"] < limits.horizontal_m - FILE_MARGIN_M)
    over_gap_m = near["gap_m"].where(is_over)
    is_hit = over_gap_m <= 0
    close = merged(near.assign(gap_m=over_gap_m)[is_hit | is_close], "prism")
    # Coming to what it hits, and leaving it, a mission is near that and what stands around.
    around = merged(close.loc[close["gap_m"] <= 0, ["from_m", "to_m"]])
    place = np.searchsorted(around["from_m"] - TOUCH_M, close["from_m"], side="right") - 1
    close = close[close["to_m"] > np.append(around["to_m"] + TOUCH_M, -np.inf)[place]]
    hits = merged(near[is_hit])
    over = merged(close[close["gap_m"] > 0])
    beside = merged(close[close["gap_m"].isna()])
    into_m = -hits["gap_m"]
    over_m = over["gap_m"]
    beside_m = beside["apart_m"]
    above = "passes {:.1f} m over or under a building"
    aside = "passes {:.1f} m beside a building"
    return [
        _described(hits, buildings, "flies up to {:.1f} m into a building", into_m),
        _described(over, buildings, above, over_m, limits.vertical_m),
        _described(beside, buildings, aside, beside_m, limits.horizontal_m),
    ]


def _described(
    rows: pd.DataFrame, buildings: Prisms, text: str, metres: pd.Series, asked_m: float = 0.0
) -> pd.DataFrame:
    """Return stretches near or in buildings as findings; metres are short of what is asked, or as far inside."""
    prism = rows["prism"].to_numpy(int)
    is_guessed = buildings.is_guessed[prism]
    guesses = np.where(is_guessed, " of guessed height", "")
    what = [text.format(number) + guess for number, guess in zip(metres, guesses, strict=True)]
    more = {"what": what, "is_guessed": is_guessed, "kind": "building"}
    by_m = (asked_m - metres).abs()
    return rows.assign(**more, by_m=by_m, building_m=buildings.top_m[prism])


def _zones(steps: Steps, maps: MetricMaps, limits: Constraints) -> pd.DataFrame:
    """Return where a mission enters no-fly zones."""
    zones = limits.zones
    shapes = np.array([zone.on(maps.grid) for zone in zones], object)
    floor_m, ceiling_m = np.array([[z.floor_m, z.ceiling_m] for z in zones]).reshape(-1, 2).T
    rows = contacts(steps, Prisms(shapes, floor_m, ceiling_m, np.zeros(len(zones), bool)), maps)
    rows = merged(rows[rows["gap_m"] <= 0], "prism")
    entered = [zones[number] for number in rows["prism"]]
    what = [f"enters the no-fly zone {zone.label}, {zone.heights}" for zone in entered]
    return rows.assign(kind="zone", what=what)


def _is_closed(
    steps: Steps,
    maps: MetricMaps,
    bound: Bound,
    times: Sequence[str | None],
    time_of_day: str | None,
) -> np.ndarray:
    """Return ``[P]`` bool: a bound is not kept at one of some times; beyond the maps' altitudes that of the nearest."""
    levels_m = sorted(maps.altitudes_m)
    middles_m = [sum(pair) / 2 for pair in pairwise(levels_m)] or levels_m
    between = np.searchsorted(levels_m, steps.z_m.mean(axis=1), side="right") - 1
    between = np.clip(between, 0, len(middles_m) - 1)
    nearest_m = nearest_level_m(steps.z_m.mean(axis=1), levels_m)
    is_level = np.abs(steps.z_m - nearest_m[:, None]).max(axis=1) < LEVEL_M
    map_m = np.where(is_level, nearest_m, np.array(middles_m)[between])
    is_closed = np.zeros(len(between), bool)
    for z_m in np.unique(map_m).tolist():
        at = map_m == z_m
        for time in times:
            is_kept = bound.is_kept(maps, z_m, time, time_of_day)
            is_closed[at] |= ~is_kept[tuple(steps.cell[at].T)]
    return is_closed


def _stretches(steps: Steps, chosen: np.ndarray, **columns: np.ndarray) -> pd.DataFrame:
    """Return a row for each stretch of steps that are chosen."""
    from_m, to_m = steps.along_m.T
    rows = {"step": np.arange(len(chosen)), "from_m": from_m, "to_m": to_m, **columns}
    return merged(pd.DataFrame(rows)[chosen])
