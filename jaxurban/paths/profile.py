"""What a route meets, cell by cell: maps at its height, roofs beneath, clearance; and what its pilot should know."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.zone import unknown_cautions
from jaxurban.kernels.tolerances import AT_LIMIT, BESIDE_M, GROUND_TOLERANCE_M
from jaxurban.knowledge import Caution, Level, caution_of_guesses, sentences_of
from jaxurban.maps.levels import values_at
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.maps.rules import roof_limits_m
from jaxurban.metrics.gps import FIX, has_no_fix
from jaxurban.metrics.population import M2_PER_KM2
from jaxurban.metrics.variables import ROOF_KIND
from jaxurban.paths.closed import constraints_of
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.lines import along_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.route_report import (
    CLEARANCE,
    GUESSED,
    OUTSIDE,
    OVER_ROOF,
    REACH,
    TO_GUESSED,
    TOUCHED,
    VISIBLE,
)
from jaxurban.paths.steps import Steps, steps_of
from jaxurban.planners.cost import path_states
from jaxurban.settings import Vehicle
from jaxurban.world.footprints import BUILDING
from jaxurban.world.kinds import EFFECTS
from jaxurban.world.surface import stands_at

MOST_SEGMENTS = 3  # that a terminal line lists
SWATH_M = 10.0  # width of the strip along a route in which people are counted
# Of a guessed roof a route passes it: what the risk metric counts as near by default.
NEAR_GUESSED_M = 50.0
# Below which a height over a roof is beyond limits, where no vertical clearance was asked.
LEAST_OVER_ROOFS_M = 1.0
MOST_LEVELS = 16  # at which the distance to obstacles is measured


def cut_evenly(states_m: np.ndarray, most: int) -> np.ndarray:
    """Return ``[S]`` the number, from 0 up, of the segment that each step of a route belongs to.

    A segment ends at the end of a step, so that its cost is the sum of its steps' costs. Segments are as nearly equal
    in length as steps allow, and fewer than ``most`` where a step is longer than a segment would be.

    Args:
      states_m: ``[S + 1, D]`` the corners between which the steps run.
      most: the number of segments, at least 1.
    """
    along_m = along_of(states_m)
    ideal_m = along_m[-1] * np.arange(1, most) / most  # where segments of equal length would end
    middle_m = (along_m[:-1] + along_m[1:]) / 2
    _, segment = np.unique(np.digitize(middle_m, ideal_m), return_inverse=True)
    return segment


def clearance_m(
    ends_m: np.ndarray, is_obstacle: np.ndarray, resolution_m: float, most_m: float | None = None
) -> np.ndarray:
    """Return ``[M]`` the exact distance from straight lines to the nearest obstacle cell; inf without one.

    It is measured from the line itself to the side of the cell's square: half a cell where a line passes the middle of
    the cell next to an obstacle. Distances have no upper limit, and nothing stands outside the map. An obstacle cell
    that obstacles surround is left out, so that a line within it is some metres from its neighbours.

    Args:
      ends_m: ``[M, 2, 2]`` start and end (x, y) of each line, metres from the map's southwest corner.
      is_obstacle: ``[Y, X]`` bool.
      resolution_m: side of a cell.
      most_m: distances beyond it need not be known, and are inf: a quicker search.
    """
    from scipy.ndimage import binary_erosion

    # Where all four neighbours within the map are obstacles too, another one is nearer to a line outside.
    row, col = np.nonzero(is_obstacle & ~binary_erosion(is_obstacle, border_value=1))
    if len(row) == 0:  # no obstacle, or nothing else
        return np.full(len(ends_m), 0.0 if is_obstacle.any() else np.inf)
    sides_m = np.stack([col, row, col + 1, row + 1]) * resolution_m  # west, south, east, north
    squares = shapely.STRtree(shapely.box(*sides_m))
    (line, _), distance_m = squares.query_nearest(
        shapely.linestrings(ends_m), most_m, return_distance=True, all_matches=False
    )
    nearest_m = np.full(len(ends_m), np.inf)
    nearest_m[line] = distance_m
    return nearest_m


def nearest_level_m(z_m: np.ndarray, levels_m: Sequence[float]) -> np.ndarray:
    """Return ``[M]`` the nearest of some levels, the lower one where two are as near."""
    ascending_m = np.sort(levels_m)
    return ascending_m[np.argmin(np.abs(z_m[:, None] - ascending_m), axis=1)]


def cut_on(planned: PlannedPath, maps: MetricMaps) -> tuple[np.ndarray, Steps]:
    """Return a route as its cost model steps along it, and cut further, at the borders of its maps' cells (`steps_of`).

    Returns:
      ``[N, 3]`` x, y from the maps' southwest corner, and height: the corners of the model's steps that have a length.
      A step of the ``cell`` model ends where it counts a cell. And the parts of the route; ``leg`` is the number of the
      model's step that each belongs to.

    Raises:
      InputError: there is no path, or the maps are others than those that it was planned on.
    """
    grid, settings = maps.grid, planned.settings
    if not planned.status.has_path:
        raise InputError(f"there is no path to explain: {planned.status.sentence}")
    if (planned.crs, settings["resolution_m"]) != (grid.crs, grid.resolution_m):
        raise InputError(
            f"the path was planned at {settings['resolution_m']:g} m in {planned.crs}, and these maps are "
            f"{grid.resolution_m:g} m in {grid.crs}: give the maps that it was planned on"
        )
    points_m = planned.xy_m - grid.bounds_m[:2]
    sides_m = np.array(grid.shape[::-1]) * grid.resolution_m
    if (points_m < 0).any() or (points_m > sides_m).any():
        raise InputError(
            "the path leaves the region of these maps: give the maps that it was planned on"
        )
    corners_m = path_states(np.column_stack([points_m, planned.z_m]), grid.resolution_m)
    has_length = np.any(np.diff(corners_m, axis=0) != 0, axis=1)
    corners_m = corners_m[np.append(True, has_length)]

    xyz_m = corners_m + np.array([*grid.bounds_m[:2], 0.0])
    states = np.column_stack([xyz_m, along_of(corners_m)])
    states = np.stack([states[:-1], states[1:]], axis=1) if has_length.any() else states[[[0, 0]]]
    leg = np.arange(len(states))
    return corners_m, steps_of(states, leg, leg >= 0, Elevation(maps, None), np.inf)


def profile_of(
    parts: Steps,
    maps: MetricMaps,
    shown: Mapping[str, str],
    settings: Mapping[str, Any],
) -> pd.DataFrame:
    """Return a row for each part of a flight: its place, the values of maps there (`values_on`), roofs and clearances.

    Where the maps know which roofs are guessed, also whether the one beneath is, and how far the nearest is; where they
    know kinds, that of the highest roof that touches the cell, of ``jaxurban.world.kinds.EFFECTS``, else ``""``.

    Args:
      parts: of the flight, each within a cell.
      maps: the maps that it leads over.
      shown: names of columns by the names of the maps that fill them; maps that are missing are left out.
      settings: of the route, which name the time and the time of day.
    """
    grid = maps.grid
    when = {name: settings[name] for name in ("time", "time_of_day")}
    from_m, to_m = parts.along_m.T
    lon, lat = grid.lonlat_of_xy(*parts.ends_m.mean(axis=1).T)
    columns = {
        "from_m": from_m,
        "to_m": to_m,
        "lon": lon,
        "lat": lat,
        "z_m": parts.z_m.mean(axis=1),
    }
    for name, column in shown.items():
        if maps.variable(name) in maps.ds:
            columns[column] = values_on(maps, name, parts, **when)
    if VISIBLE in columns:
        columns[VISIBLE] = columns[VISIBLE].astype(int)

    # Guessed roofs. `clearance_m` leaves out what roofs surround, so that over one the distance is set here.
    if GUESSED in maps.ds:
        is_guessed = maps.m(GUESSED).astype(bool)
        away_m = clearance_m(parts.ends_m - grid.bounds_m[:2], is_guessed, grid.resolution_m)
        columns[GUESSED] = is_guessed[tuple(parts.cell.T)]
        columns[TO_GUESSED] = np.where(columns[GUESSED], 0.0, away_m)
        columns[REACH] = roof_limits_m(maps, "highest")[tuple(parts.cell.T)]
    if ROOF_KIND in maps.ds:
        names = np.array(["", *EFFECTS], object)
        columns[ROOF_KIND] = names[maps.m(ROOF_KIND)[tuple(parts.cell.T)]]
    return pd.DataFrame(columns | clearances_on(maps, parts))


def clearances_on(
    maps: MetricMaps, parts: Steps, most_m: float | None = None
) -> dict[str, np.ndarray]:
    """Return how far parts of a flight are from roofs and the border, ``[P]`` metres each, by the names of columns.

    They are the roof of the cell; the least height over it, NaN over none; the distance to the maps' border; and the
    distance to the nearest cell whose roof reaches the lowest point of the part, or a height less than that where the
    parts are at more than `MOST_LEVELS` heights. What stands outside the maps is not known: it is no nearer than the
    border.

    Args:
      maps: the maps.
      parts: ``P`` of them.
      most_m: distances to obstacles beyond it need not be known (`clearance_m`).
    """
    # Over the roofs, and to the border.
    grid = maps.grid
    lowest_m = parts.z_m.min(axis=1)
    touched_m = maps.m(TOUCHED)
    roof_m = touched_m[tuple(parts.cell.T)].astype(float)
    lines_m = parts.ends_m - grid.bounds_m[:2]
    sides_m = np.array(grid.shape[::-1]) * grid.resolution_m
    border_m = np.minimum(lines_m, sides_m - lines_m).min(axis=(1, 2))

    # To the obstacles of each level.
    levels_m = np.unique(lowest_m)
    if len(levels_m) > MOST_LEVELS:
        shares = np.linspace(0, 1, MOST_LEVELS)
        levels_m = np.unique(np.quantile(lowest_m, shares, method="inverted_cdf"))
    level = np.searchsorted(levels_m, lowest_m, side="right") - 1
    away_m = np.empty(len(lines_m))
    for number, z_m in enumerate(levels_m.tolist()):
        is_obstacle = stands_at(touched_m, z_m)
        lines_there_m = lines_m[level == number]
        away_m[level == number] = clearance_m(lines_there_m, is_obstacle, grid.resolution_m, most_m)
    over_m = np.where(roof_m > 0, lowest_m - roof_m, np.nan)
    return {"roof_m": roof_m, OVER_ROOF: over_m, OUTSIDE: border_m, CLEARANCE: away_m}


def values_on(
    maps: MetricMaps,
    name: str,
    parts: Steps,
    time: str | None = None,
    time_of_day: str | None = None,
) -> np.ndarray:
    """Return ``[P]`` float64 the values of a map in the cells of parts of a flight, at the height of their middle.

    A height within `GROUND_TOLERANCE_M` of an altitude of the maps takes the map there: files round heights, and follow
    the ground by straight lines. One between two altitudes takes both (`values_at`), one beyond all of them none: NaN.

    Args:
      maps: the maps.
      name: of the map.
      parts: ``P`` of them, each within a cell.
      time, time_of_day: of the map; the first if None.
    """
    read = partial(maps.m, name, time=time, time_of_day=time_of_day)
    rows, cols = parts.cell.T
    if "altitude" not in maps.ds[maps.variable(name)].dims:
        return read()[rows, cols].astype(float)

    z_m = parts.z_m.mean(axis=1)
    levels_m = sorted(maps.altitudes_m)
    nearest_m = nearest_level_m(z_m, levels_m)
    z_m = np.where(np.abs(z_m - nearest_m) <= GROUND_TOLERANCE_M, nearest_m, z_m)

    # Each altitude has a group, as has what lies between two of them; the first and the last lie beyond all.
    group = np.searchsorted(levels_m, z_m) + np.searchsorted(levels_m, z_m, side="right")
    values = np.full(len(z_m), np.nan)
    for number in np.setdiff1d(group, [0, 2 * len(levels_m)]):
        here = np.flatnonzero(group == number)
        values[here] = values_at(
            z_m[here],
            levels_m,
            read,
            maps.is_under_sky,
            is_count=name == VISIBLE,
            cells=(rows[here], cols[here]),
        )
    return values


def people_below(density: ArrayLike, parts: Steps, swath_m: float) -> np.ndarray:
    """Return ``[P]`` the people below parts of a flight: of a density ``[P]`` per km2, in a strip of a width."""
    return np.asarray(density) * parts.over_m * swath_m / M2_PER_KM2


def cautious_profile(planned: PlannedPath, maps: MetricMaps) -> pd.DataFrame:
    """Return HDOP, roofs and clearance along a route: the profile of a report without metrics and people.

    Raises:
      InputError: there is no path, or the maps are others.
    """
    _, parts = cut_on(planned, maps)
    return profile_of(parts, maps, {FIX: FIX}, planned.settings)


def without_fix(profile: pd.DataFrame) -> list[tuple[float, float]]:
    """Return begin and end along the route, in metres, of each stretch without a fix (`has_no_fix`), in their order.

    Empty where there is none, or where the maps hold no HDOP.

    Args:
      profile: of the route (`profile_of`), or a part of it.
    """
    if FIX not in profile:
        return []
    # Where the fix is lost and regained, by turns: the first row of a stretch and the first one after it.
    is_without = np.pad(has_no_fix(profile[FIX].to_numpy()), 1)
    first, after = np.flatnonzero(np.diff(is_without)).reshape(-1, 2).T
    from_m, to_m = profile[["from_m", "to_m"]].to_numpy().T
    return list(zip(from_m[first].tolist(), to_m[after - 1].tolist(), strict=True))


@typed
def cautions(
    planned: PlannedPath, maps: MapsLike, profile: pd.DataFrame | None = None
) -> list[Caution]:
    """Return what the maps guess, where GPS has no fix, how near buildings and roofs are, and what else to know.

    A route that passes nearer than 3 m to a building as high says so first, with the place.

    Also reported: zones of which it is not known what they close; an end in a cell that a roof touches; climbs,
    descents and turns beyond the limits of the vehicle that it was planned for; and what the path's message notes. A
    sentence each, what is guessed first.

    Distances are measured from the route to the edges of cells, so that 0 is contact; obstacles outside the region are
    not known.

    Args:
      planned: a path, from `plan`.
      maps: the maps it was planned on, or their folder.
      profile: of `explain`; made here if left out.

    Returns:
      Texts (`Caution`), each with a ``level``, which is ``"guess"``, ``"limit"`` or ``"note"``.

    Raises:
      InputError: there is no path, or the maps are others.

    Examples:
      >>> for caution in ju.cautions(path, maps):
      ...     print(caution.level, caution)
      note Buildings: the nearest that reaches the flight height is 30.0 m away, 486 m along the route.
      note Roofs: the lowest pass leaves 37.0 m above a roof of 23.0 m, 812 m along the route.
    """
    maps = as_maps(maps)
    profile = cautious_profile(planned, maps) if profile is None else profile
    limits = constraints_of(planned)
    clearance = _clearance(profile, limits.horizontal_m)
    is_beside = bool(profile[CLEARANCE].min() < BESIDE_M - AT_LIMIT)
    return [
        *unknown_cautions(planned.zones),
        *_unknown_heights(profile),
        *[clearance] * is_beside,
        *guess_cautions(maps, profile),
        *_fix(profile),
        *[clearance] * (not is_beside),
        *_roofs(profile, limits.vertical_m or LEAST_OVER_ROOFS_M),
        *_ends(profile),
        *(Caution(sentence, "limit", "manoeuvre") for sentence in _manoeuvres(planned)),
        *(Caution(sentence, kind="search") for sentence in sentences_of(planned.search.note)),
    ]


def guess_cautions(maps: MetricMaps | None, profile: pd.DataFrame | None = None) -> list[Caution]:
    """Return a caution of what maps rest on that no file says; empty where they guess nothing.

    Args:
      maps: the maps; None for a path without them, of which nothing is known.
      profile: of a route (`profile_of`), for how much of it is near roofs of guessed height; None without a route.
    """
    of_route = ""
    if profile is not None and GUESSED in profile:
        length_m = profile["to_m"] - profile["from_m"]
        near_m = length_m[profile[TO_GUESSED] < NEAR_GUESSED_M].sum()
        over_m = length_m[profile[GUESSED]].sum()
        of_route = (
            f"{near_m:.0f} of {length_m.sum():.0f} m of the route pass within {NEAR_GUESSED_M:g} m of guessed roofs, "
            f"{over_m:.0f} m over them"
        )
    guesses = () if maps is None else maps.guesses
    return caution_of_guesses(guesses, of_route)


def _unknown_heights(profile: pd.DataFrame) -> Iterator[Caution]:
    """Yield the caution of metres at which what has no known height may reach the route, by kind."""
    if REACH not in profile:
        return
    rows = profile[(profile[REACH] > 0) & (profile[REACH] >= profile["z_m"])]
    if rows.empty:
        return
    length_m = rows["to_m"] - rows["from_m"]
    kinds = np.full(len(rows), BUILDING, object)
    if ROOF_KIND in rows:
        kinds = rows[ROOF_KIND].replace("", BUILDING).to_numpy()
    of_kind = ", ".join(f"{kind} {m:.0f} m" for kind, m in length_m.groupby(kinds).sum().items())
    yield Caution(
        f"Unknown heights: on {length_m.sum():.0f} of {profile['to_m'].iloc[-1]:.0f} m of the route what stands below "
        f'may reach the flight ({of_kind}); with unknown_heights = "highest" (--rules) a route '
        "stays above all that it may reach.",
        "limit",
        "unknown heights",
    )


def _fix(profile: pd.DataFrame) -> Iterator[Caution]:
    """Yield the caution of metres without a position fix, which names the longest stretches (`MOST_SEGMENTS`).

    Nothing is yielded where the route has a fix everywhere; without an HDOP in the maps, a note says so.
    """
    if FIX not in profile:
        yield Caution(
            f"GPS: these maps hold no {FIX}, so where there is no fix is not known.", kind="fix"
        )
        return
    stretches = without_fix(profile)
    if not stretches:
        return

    # The longest, the earlier of two as long, and then in the order of travel.
    longest = sorted(stretches, key=lambda stretch: stretch[0] - stretch[1])[:MOST_SEGMENTS]
    listed = ", ".join(f"{max(0, from_m):.0f} to {to_m:.0f} m" for from_m, to_m in sorted(longest))
    where = f"from {listed} along the route"
    if len(stretches) > len(longest):
        where += f" and {len(stretches) - len(longest)} shorter"
    no_fix_m = sum(to_m - from_m for from_m, to_m in stretches)
    route_m = profile["to_m"].iloc[-1]
    yield Caution(f"GPS: no fix on {no_fix_m:.0f} of {route_m:.0f} m: {where}.", "limit", "fix")


def _clearance(profile: pd.DataFrame, least_m: float) -> Caution:
    """Return the caution of the nearest building at flight height, or of how far around none is known.

    Its level is ``"limit"`` where the route is nearer than allowed or touches, ``"guess"`` where it rests on guesses.

    Args:
      profile: of the route (`profile_of`).
      least_m: the distance that the route should keep from buildings.
    """
    # The nearest obstacle of the region, and the border, beyond which obstacles are not known.
    nearest = int(profile[CLEARANCE].argmin())
    border = int(profile[OUTSIDE].argmin())
    nearest_m = profile[CLEARANCE].iloc[nearest]
    border_m = profile[OUTSIDE].iloc[border]
    if nearest_m <= border_m:
        place = ""
        if nearest_m < BESIDE_M - AT_LIMIT:
            lon, lat = profile[["lon", "lat"]].iloc[nearest]
            place = f" from {lon:.6f},{lat:.6f}"
        sentence = (
            f"Buildings: the nearest that reaches the flight height is {nearest_m:.1f} m away{place}, "
            f"{_at(profile, nearest)}"
        )
    else:
        sentence = (
            f"Buildings: none that reaches the flight height is within {border_m:.1f} m, "
            f"{_at(profile, border)}, as far as the maps reach; what stands beyond their border is not known"
        )
        if np.isfinite(nearest_m):
            sentence += f"; in the region the nearest is {nearest_m:.1f} m away"

    level: Level = "note"
    if nearest_m < least_m - AT_LIMIT or nearest_m <= 0:
        level = "limit"
    return Caution(f"{sentence}.", level, "clearance")


def _roofs(profile: pd.DataFrame, limit_m: float) -> Iterator[Caution]:
    """Yield the length of a route in cells that a building as high touches, and where it is lowest over a roof.

    There is a caution of each only where there is such a place.

    Args:
      profile: of the route (`profile_of`).
      limit_m: the height over roofs below which the caution has the level ``"limit"``.
    """
    over_m = profile[OVER_ROOF]
    is_beside = over_m <= 0  # in a cell that a building touches, maybe not in its outline
    if is_beside.any():
        length_m = profile["to_m"] - profile["from_m"]
        yield Caution(
            f"Buildings: {length_m[is_beside].sum():.1f} m of the route lie in cells that a building "
            "as high as the route touches, perhaps inside its outline.",
            "limit",
            "roof",
        )
    over_m = over_m.mask(is_beside)
    if not over_m.notna().any():
        return
    lowest = int(over_m.argmin())
    least_m = over_m.iloc[lowest]
    roof = _roof(profile, lowest)
    yield Caution(
        f"Roofs: the lowest pass leaves {least_m:.1f} m above {roof}, {_at(profile, lowest)}.",
        "limit" if least_m < limit_m - AT_LIMIT else roof.level,
        "roof",
    )


def _ends(profile: pd.DataFrame) -> Iterator[Caution]:
    """Yield a caution for each end of a route that is in a cell that a roof touches: cells do not know of outlines."""
    for name, place in (("start", 0), ("goal", -1)):
        row = profile.iloc[place]
        if row["roof_m"] >= row["z_m"]:
            yield Caution(
                f"The {name} is in a cell that a building of {row['roof_m']:.1f} m touches.",
                "limit",
                "end",
            )
        elif row["roof_m"] > 0:
            roof = _roof(profile, place)
            yield Caution(
                f"The {name} is in a cell that {roof} touches, over it or beside it.",
                roof.level,
                "end",
            )


def _roof(profile: pd.DataFrame, place: int) -> Caution:
    """Return the roof beneath a row of a profile in words, such as "a roof of 8.9 m".

    Its level is ``"guess"`` where the height is guessed, else ``"note"``.
    """
    roof = f"roof of {profile['roof_m'].iloc[place]:.1f} m"
    if GUESSED in profile and profile[GUESSED].iloc[place]:
        return Caution(f"a guessed {roof}", "guess")
    return Caution(f"a {roof}")


def _manoeuvres(planned: PlannedPath) -> Iterator[str]:
    """Yield a sentence on each limit of the vehicle that a route exceeds: of climb, of descent and of turns.

    Limits that the vehicle does not name are not checked, nor climb and descent without its speed.
    """
    vehicle = Vehicle.of(planned.settings)
    points_m = np.column_stack([planned.xy_m, planned.z_m])
    legs_m = np.diff(points_m, axis=0)
    along_m = along_of(points_m)

    # Climb and descent: at its speed in the air, a vehicle rises by this share of it.
    speed_m_s = vehicle.speed_m_s
    air_m = np.linalg.norm(legs_m, axis=1)
    rise = legs_m[:, 2] / np.where(air_m > 0, air_m, 1.0)
    for name, limit_m_s, share in (
        ("climb", vehicle.max_climb_m_s, rise),
        ("descent", vehicle.max_descent_m_s, -rise),
    ):
        if limit_m_s is None or speed_m_s is None:
            continue
        num_legs = (speed_m_s * share > limit_m_s * (1 + AT_LIMIT)).sum()
        if num_legs:
            steepest = np.argmax(share)
            yield (
                f"Vehicle: legs that would need more than {limit_m_s:g} m/s of {name} at {speed_m_s:g} m/s: "
                f"{num_legs}; the steepest, {along_m[steepest]:.0f} m along the route, is flown at "
                f"{limit_m_s / share[steepest]:.2g} m/s at most."
            )

    # Turns between legs that have a heading: straight up and down has none.
    if vehicle.max_turn_deg is None:
        return
    headed = np.flatnonzero(legs_m[:, :2].any(axis=1))
    east_m, north_m, _ = legs_m[headed].T
    heading_deg = np.degrees(np.arctan2(north_m, east_m))
    turn_deg = np.abs((np.diff(heading_deg) + 180) % 360 - 180)  # from 0 to 180, left or right
    num_turns = (turn_deg > vehicle.max_turn_deg * (1 + AT_LIMIT)).sum()
    if num_turns:
        sharpest = np.argmax(turn_deg)
        yield (
            f"Vehicle: turns sharper than {vehicle.max_turn_deg:g} degrees: {num_turns}; the sharpest, of "
            f"{turn_deg[sharpest]:.0f} degrees, is {along_m[headed[sharpest + 1]]:.0f} m along the route."
        )


def _at(profile: pd.DataFrame, place: int) -> str:
    """Return in words how far along the route the middle of a row of its profile is."""
    middle_m = profile[["from_m", "to_m"]].iloc[place].mean()
    return f"{middle_m:.0f} m along the route"
