"""What a route meets, cell by cell: maps at its height, roofs beneath, clearance; and what its pilot should know."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
import shapely
from scipy.ndimage import binary_erosion

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.kernels.line.traversal import Crossings, crossed_cells
from jaxurban.kernels.tolerances import AT_LIMIT, SAME_HEIGHT_M
from jaxurban.maps.levels import values_at
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.gps import FIX, has_no_fix
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.cost import path_states
from jaxurban.public import Caution, Level, caution_of_guesses
from jaxurban.settings import Vehicle

TOUCHED, VISIBLE, GUESSED = "roof_touched", "num_visible", "roof_guessed"
CLEARANCE, OUTSIDE, OVER_ROOF = "nearest_wall_m", "walls_outside_m", "least_over_roofs_m"
TO_GUESSED = "guessed_roof_away_m"
MOST_SEGMENTS = 3  # that a terminal line lists
NEAR_GUESSED_M = (
    50.0  # of a guessed roof a route passes it: what the risk metric counts as near by default
)
LEAST_OVER_ROOFS_M = (
    1.0  # below which a height over a roof is beyond limits, where no vertical clearance was asked
)


def cut_evenly(states_m: np.ndarray, most: int) -> np.ndarray:
    """Return ``[S]`` the number, from 0 up, of the segment that each step belongs to: at most ``most``, nearly equal.

    A segment ends at the end of a step, so that its cost is the sum of its steps' costs.
    """
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(states_m, axis=0), axis=1)))
    wanted_m = along_m[-1] * np.arange(1, most) / most
    after = np.clip(np.searchsorted(along_m, wanted_m), 1, len(along_m) - 1)
    nearest = np.where(wanted_m - along_m[after - 1] <= along_m[after] - wanted_m, after - 1, after)
    cuts = np.setdiff1d(nearest, [0, len(along_m) - 1])
    return np.searchsorted(cuts, np.arange(len(along_m) - 1), side="right")


def clearance_m(ends_m: np.ndarray, is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[M]`` the exact distance from straight lines to the nearest obstacle cell; inf without one.

    From the line itself to the side of the cell's square, without any cap: half a cell where the route passes
    the middle of the cell next to an obstacle. Nothing stands outside the map.

    Args:
      ends_m: ``[M, 2, 2]`` start and end (x, y) of each line, metres from the map's southwest corner.
      is_obstacle: ``[Y, X]`` bool.
      resolution_m: side of a cell.
    """
    # Where all four neighbours within the map are obstacles too, another one is nearer.
    row, col = np.nonzero(is_obstacle & ~binary_erosion(is_obstacle, border_value=1))
    if len(row) == 0:
        return np.full(len(ends_m), np.inf if not is_obstacle.any() else 0.0)
    squares = shapely.STRtree(shapely.box(*(np.stack([col, row, col + 1, row + 1]) * resolution_m)))
    (line, _), distance_m = squares.query_nearest(
        shapely.linestrings(ends_m), return_distance=True, all_matches=False
    )
    nearest_m = np.empty(len(ends_m))
    nearest_m[line] = distance_m
    return nearest_m


def level_below_m(z_m: np.ndarray, levels_m: Sequence[float]) -> np.ndarray:
    """Return ``[M]`` the highest of some levels that is not above each height; the lowest one beneath all of them."""
    ascending_m = np.sort(np.asarray(levels_m, float))
    return ascending_m[
        np.maximum(np.searchsorted(ascending_m, z_m + SAME_HEIGHT_M, side="right") - 1, 0)
    ]


def nearest_level_m(z_m: np.ndarray, levels_m: Sequence[float]) -> np.ndarray:
    """Return ``[M]`` the nearest of some levels, the lower one where two are as near."""
    ascending_m = np.sort(np.asarray(levels_m, float))
    return ascending_m[np.argmin(np.abs(z_m[:, None] - ascending_m), axis=1)]


def cut_on(planned: PlannedPath, maps: MetricMaps) -> Crossings:
    """Return a route cut at the borders of its maps' cells.

    A step ends where the ``cell`` cost model counts a cell, and those without length are left out.

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
    points_m = planned.xy_m - [grid.x_min_m, grid.y_min_m]
    if (points_m < 0).any() or (points_m[:, ::-1] > np.array(grid.shape) * grid.resolution_m).any():
        raise InputError(
            "the path leaves the region of these maps: give the maps that it was planned on"
        )
    states_m = path_states(np.column_stack([points_m, planned.z_m]), grid.resolution_m)
    states_m = states_m[np.append(True, np.any(np.diff(states_m, axis=0) != 0, axis=1))]
    return crossed_cells(states_m, grid.resolution_m)


def profile_of(
    planned: PlannedPath, maps: MetricMaps, cut: Crossings, shown: Mapping[str, str]
) -> pd.DataFrame:
    """Return a row for each crossing: its place, the maps that are shown by their columns, roofs and clearance.

    Where the maps know which roofs are guessed, also whether the one beneath is, and how far the nearest is.

    Each takes the maps of the level nearest to it, as the planner did; of satellites and obstacles that below, where
    there are fewer of the ones and more of the others. What stands outside the region is not known: it is no nearer
    than the border.

    Args:
      planned: the route.
      maps: that it was planned on.
      cut: from `cut_on`.
      shown: columns by map.
    """
    ends_m, grid = cut.ends_m, maps.grid
    middle, to_m, lines_m = ends_m.mean(axis=1), np.cumsum(cut.length_m), ends_m[:, :, :2]
    lon, lat = grid.lonlat_of_xy(middle[:, 0] + grid.x_min_m, middle[:, 1] + grid.y_min_m)
    columns = {
        "from_m": to_m - cut.length_m,
        "to_m": to_m,
        "lon": lon,
        "lat": lat,
        "z_m": middle[:, 2],
    }
    levels_m = planned.settings.get("levels_m") or [planned.altitude_m]
    level_m, lowest_m = nearest_level_m(middle[:, 2], levels_m), ends_m[:, :, 2].min(axis=1)
    # The highest roof that touches a cell where the maps hold it, else that at its middle.
    roofs = TOUCHED if TOUCHED in maps.ds else "roof"
    for name, column in {**shown, roofs: "roof_m", GUESSED: GUESSED}.items():
        if maps.variable(name) in maps.ds:
            columns[column] = _sample(planned, maps, cut, name, level_m)
    if VISIBLE in columns:
        columns[VISIBLE] = columns[VISIBLE].astype(int)
    if GUESSED in columns:
        is_over = columns[GUESSED] = columns[GUESSED].astype(bool)
        away_m = clearance_m(lines_m, maps.m(GUESSED).astype(bool), grid.resolution_m)
        columns[TO_GUESSED] = np.where(
            is_over, 0.0, away_m
        )  # `clearance_m` leaves out what roofs surround
    columns[OVER_ROOF] = np.where(columns["roof_m"] > 0, lowest_m - columns["roof_m"], np.nan)
    side_m = np.array([grid.num_cols, grid.num_rows]) * grid.resolution_m
    columns[OUTSIDE] = np.minimum(lines_m, side_m - lines_m).min(axis=(1, 2))
    columns[CLEARANCE], below_m = np.empty(len(to_m)), level_below_m(lowest_m, levels_m)
    for z_m in np.unique(below_m).tolist():
        is_held = roofs != TOUCHED and z_m in maps.altitudes_m
        is_obstacle = maps.m("obstacle", z_m) == 1 if is_held else maps.m(roofs) >= z_m
        columns[CLEARANCE][below_m == z_m] = clearance_m(
            lines_m[below_m == z_m], is_obstacle, grid.resolution_m
        )
    return pd.DataFrame(columns)


def _sample(
    planned: PlannedPath, maps: MetricMaps, cut: Crossings, name: str, level_m: np.ndarray
) -> np.ndarray:
    """Return ``[M]`` float64 the values of a map in the cells crossed, each at its own level (`values_at`)."""
    when = {"time": planned.settings["time"], "time_of_day": planned.settings["time_of_day"]}
    if "altitude" not in maps.ds[maps.variable(name)].dims:
        return maps.m(name, **when)[cut.row, cut.col].astype(float)

    def at(z_m: float, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        def read(map_m: float) -> np.ndarray:
            return maps.m(name, map_m, **when)[row, col]

        is_count = name == VISIBLE
        return values_at(
            z_m,
            maps.altitudes_m,
            read,
            lambda z_m: maps.is_under_sky(z_m)[row, col],
            is_count=is_count,
        )

    values = np.empty(len(level_m))
    for z_m in np.unique(level_m).tolist():
        is_at = level_m == z_m
        values[is_at] = at(z_m, cut.row[is_at], cut.col[is_at])
    return values


def cautious_profile(planned: PlannedPath, maps: MetricMaps) -> pd.DataFrame:
    """Return HDOP, roofs and clearance along a route: the profile of a report without metrics and people.

    Raises:
      InputError: there is no path, or the maps are others.
    """
    return profile_of(planned, maps, cut_on(planned, maps), {FIX: FIX})


def guessed_clearances(profile: pd.DataFrame) -> set[str]:
    """Return which least clearances, `CLEARANCE` and `OVER_ROOF`, rest on roofs of guessed height.

    The distance to buildings does where one of guessed height is as near, since it may reach the flight.
    """
    names, over_m = set(), profile[OVER_ROOF]
    if GUESSED in profile:
        if profile[TO_GUESSED].min() <= profile[[CLEARANCE, OUTSIDE]].to_numpy().min():
            names.add(CLEARANCE)
        if over_m.notna().any() and profile[GUESSED].iloc[int(np.nanargmin(over_m))]:
            names.add(OVER_ROOF)
    return names


def without_fix(profile: pd.DataFrame) -> list[tuple[float, float]]:
    """Return begin and end along the route of each segment without a fix (`has_no_fix`), metres."""
    if FIX not in profile:
        return []
    is_without = np.concatenate([[False], has_no_fix(profile[FIX].to_numpy()), [False]])
    changes = np.flatnonzero(is_without[1:] != is_without[:-1]).reshape(-1, 2)
    return [
        (float(profile["from_m"].iloc[a]), float(profile["to_m"].iloc[b - 1])) for a, b in changes
    ]


@typed
def cautions(
    planned: PlannedPath, maps: MapsLike, profile: pd.DataFrame | None = None
) -> list[Caution]:
    """Return what the maps guess, where GPS has no fix, how near buildings and roofs are, and what else to know.

    Also reported: an end over a roof; climbs, descents and turns beyond the limits of the vehicle that it was planned
    for. A sentence each, what is guessed first.

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
      note Buildings: the nearest at flight height is 14.1 m away, 239 m along the route.
      note Roofs: the least height over one is 23.7 m, 267 m along the route (a roof of 36.3 m).
      note The goal is over a roof of 8.9 m, not over the ground.
    """
    maps = as_maps(maps)
    profile = cautious_profile(planned, maps) if profile is None else profile
    limits = planned.settings.get("limits", {})
    apart_m = limits.get("clearance_m", 0.0) + limits.get("vehicle_radius_m", 0.0)
    above_m = limits.get("vertical_clearance_m") or LEAST_OVER_ROOFS_M
    return [
        *guess_cautions(maps, profile),
        *_fix(profile),
        _clearance(profile, apart_m),
        *_roofs(profile, above_m),
        *_ends(profile),
        *(Caution(sentence, "limit") for sentence in _manoeuvres(planned)),
    ]


def guess_cautions(maps: MetricMaps | None, profile: pd.DataFrame | None = None) -> list[Caution]:
    """Return what maps rest on that no file says and, of a route, how much of it is near roofs of guessed height."""
    past = ""
    if profile is not None and GUESSED in profile:
        length_m = profile["to_m"] - profile["from_m"]
        near_m, over_m = (
            length_m[profile[TO_GUESSED] < NEAR_GUESSED_M].sum(),
            length_m[profile[GUESSED]].sum(),
        )
        past = (
            f"{near_m:.0f} of {length_m.sum():.0f} m of the route pass within {NEAR_GUESSED_M:g} m of guessed roofs, "
            f"{over_m:.0f} m over them"
        )
    return caution_of_guesses({} if maps is None else maps.guesses, past)


def _fix(profile: pd.DataFrame) -> Iterator[Caution]:
    if FIX not in profile:
        yield Caution(f"GPS: these maps hold no {FIX}, so where there is no fix is not known.")
        return
    segments = without_fix(profile)
    if not segments:
        return
    longest = sorted(sorted(segments, key=lambda ends: ends[0] - ends[1])[:MOST_SEGMENTS])
    where = ", ".join(f"{from_m:.0f} to {to_m:.0f} m" for from_m, to_m in longest)
    no_fix_m = sum(to_m - from_m for from_m, to_m in segments)
    if len(segments) > len(longest):
        where += f" along the route and {len(segments) - len(longest)} shorter"
    else:
        where += " along the route"
    yield Caution(
        f"GPS: no fix on {no_fix_m:.0f} of {profile['to_m'].iloc[-1]:.0f} m: from {where}.", "limit"
    )


def _clearance(profile: pd.DataFrame, apart_m: float) -> Caution:
    inside = int(np.argmin(profile[CLEARANCE]))
    outside = int(np.argmin(profile[OUTSIDE]))
    inside_m = float(profile[CLEARANCE].iloc[inside])
    outside_m = float(profile[OUTSIDE].iloc[outside])
    if inside_m <= outside_m:
        sentence = f"Buildings: the nearest at flight height is {inside_m:.1f} m away, {_at(profile, inside)}"
    else:
        sentence = (
            f"Buildings: none at flight height is within {outside_m:.1f} m, {_at(profile, outside)}, as far as the "
            "maps reach; what stands beyond their border is not known"
        )
        if np.isfinite(inside_m):
            sentence += f"; in the region the nearest is {inside_m:.1f} m away"
    is_guess = CLEARANCE in guessed_clearances(profile)
    if is_guess:
        guessed_m = float(profile[TO_GUESSED].min())
        nearest = f"the nearest of those is {guessed_m:.1f} m away"
        if guessed_m <= 0:
            nearest = "the route passes over some"
        sentence += f", if guessed roofs are right: {nearest}"
    if inside_m < apart_m - AT_LIMIT or inside_m <= 0:
        return Caution(f"{sentence}.", "limit")
    return Caution(f"{sentence}.", "guess" if is_guess else "note")


def _roofs(profile: pd.DataFrame, above_m: float) -> Iterator[Caution]:
    is_beside = profile[OVER_ROOF] <= 0  # of a cell that a building only touches
    if is_beside.any():
        beside_m = float((profile["to_m"] - profile["from_m"])[is_beside].sum())
        yield Caution(
            f"Buildings: {beside_m:.1f} m of the route lie in cells that one as high touches, maybe in its outline.",
            "limit",
        )
    over_m = profile[OVER_ROOF].where(~is_beside)
    if over_m.notna().any():
        least = int(np.nanargmin(over_m))
        roof, level = _roof(profile, least)
        yield Caution(
            f"Roofs: the least height over one is {over_m.iloc[least]:.1f} m, {_at(profile, least)} ({roof}).",
            "limit" if over_m.iloc[least] < above_m - AT_LIMIT else level,
        )


def _ends(profile: pd.DataFrame) -> Iterator[Caution]:
    for name, place in (("start", 0), ("goal", -1)):
        roof_m = float(profile["roof_m"].iloc[place])
        if roof_m >= float(profile["z_m"].iloc[place]):
            yield Caution(
                f"The {name} is in a cell that a building of {roof_m:.1f} m touches.", "limit"
            )
        elif roof_m > 0:
            roof, level = _roof(profile, place)
            yield Caution(f"The {name} is over {roof}, not over the ground.", level)


def _roof(profile: pd.DataFrame, place: int) -> tuple[str, Level]:
    is_guessed = GUESSED in profile and bool(profile[GUESSED].iloc[place])
    said = f"a {'guessed ' * is_guessed}roof of {float(profile['roof_m'].iloc[place]):.1f} m"
    return said, "guess" if is_guessed else "note"


def _manoeuvres(planned: PlannedPath) -> Iterator[str]:
    """Yield what of a route the vehicle flies only more slowly: its steepest climb and descent, its sharpest turn."""
    vehicle = Vehicle.of(planned.settings)
    moved_m = np.diff(np.column_stack([planned.xy_m, planned.z_m]), axis=0)
    air_m = np.linalg.norm(moved_m, axis=1)
    along_m, speed_m_s = np.append(0.0, np.cumsum(air_m)), vehicle.speed_m_s
    slope = moved_m[:, 2] / np.where(air_m > 0, air_m, 1.0)
    for name, most_m_s, share in (
        ("climb", vehicle.max_climb_m_s, slope),
        ("descent", vehicle.max_descent_m_s, -slope),
    ):
        if most_m_s is None or speed_m_s is None:
            continue
        if num := int((speed_m_s * share > most_m_s * (1 + AT_LIMIT)).sum()):
            steepest = int(np.argmax(share))
            yield (
                f"Vehicle: legs that would need more than {most_m_s:g} m/s of {name} at {speed_m_s:g} m/s: {num}; the "
                f"steepest, {along_m[steepest]:.0f} m along the route, is flown at {most_m_s / share[steepest]:.2g} "
                "m/s at most."
            )
    if vehicle.max_turn_deg is None:
        return
    ahead = np.flatnonzero(
        np.hypot(moved_m[:, 0], moved_m[:, 1])
    )  # straight up and down there is no heading
    heading_deg = np.degrees(np.arctan2(moved_m[ahead, 1], moved_m[ahead, 0]))
    turn_deg = np.abs((np.diff(heading_deg) + 180) % 360 - 180)
    if num := int((turn_deg > vehicle.max_turn_deg * (1 + AT_LIMIT)).sum()):
        sharpest = int(np.argmax(turn_deg))
        yield (
            f"Vehicle: turns sharper than {vehicle.max_turn_deg:g} degrees: {num}; the sharpest, of "
            f"{turn_deg[sharpest]:.0f} degrees, is {along_m[ahead[sharpest + 1]]:.0f} m along the route."
        )


def _at(profile: pd.DataFrame, place: int) -> str:
    return (
        f"{(profile['from_m'].iloc[place] + profile['to_m'].iloc[place]) / 2:.0f} m along the route"
    )
