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
from jaxurban.paths.lines import along_of
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.cost import path_states
from jaxurban.public import Caution, caution_of_guesses
from jaxurban.settings import Vehicle

TOUCHED, VISIBLE, GUESSED = "roof_touched", "num_visible", "roof_guessed"
CLEARANCE, OUTSIDE, OVER_ROOF = "nearest_wall_m", "walls_outside_m", "least_over_roofs_m"
TO_GUESSED = "guessed_roof_away_m"
MOST_SEGMENTS = 3  # that a terminal line lists
# Of a guessed roof a route passes it: what the risk metric counts as near by default.
NEAR_GUESSED_M = 50.0
# Below which a height over a roof is beyond limits, where no vertical clearance was asked.
LEAST_OVER_ROOFS_M = 1.0


def cut_evenly(states_m: np.ndarray, most: int) -> np.ndarray:
    """Return ``[S]`` the number, from 0 up, of the segment that each step belongs to: at most ``most``, nearly equal.

    A segment ends at the end of a step, so that its cost is the sum of its steps' costs.
    """
    along_m = along_of(states_m)
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
    points_m = planned.xy_m - grid.bounds_m[:2]
    sides_m = np.array(grid.shape[::-1]) * grid.resolution_m
    if (points_m < 0).any() or (points_m > sides_m).any():
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
    lines_m = ends_m[:, :, :2]
    lowest_m = ends_m[:, :, 2].min(axis=1)
    x_m, y_m, z_m = ends_m.mean(axis=1).T
    lon, lat = grid.lonlat_of_xy(x_m + grid.x_min_m, y_m + grid.y_min_m)
    to_m = np.cumsum(cut.length_m)
    places = {"from_m": to_m - cut.length_m, "to_m": to_m, "lon": lon, "lat": lat, "z_m": z_m}
    profile = pd.DataFrame(places)
    levels_m = planned.settings.get("levels_m") or [planned.altitude_m]
    level_m = nearest_level_m(z_m, levels_m)
    # The highest roof that touches a cell where the maps hold it, else that at its middle.
    roofs = TOUCHED if TOUCHED in maps.ds else "roof"
    for name, column in {**shown, roofs: "roof_m", GUESSED: GUESSED}.items():
        if maps.variable(name) in maps.ds:
            profile[column] = _sample(planned, maps, cut, name, level_m)
    if VISIBLE in profile:
        profile[VISIBLE] = profile[VISIBLE].astype(int)
    if GUESSED in profile:
        is_over = profile[GUESSED] = profile[GUESSED].astype(bool)
        away_m = clearance_m(lines_m, maps.m(GUESSED).astype(bool), grid.resolution_m)
        # `clearance_m` leaves out what roofs surround.
        profile[TO_GUESSED] = np.where(is_over, 0.0, away_m)
    over_m = lowest_m - profile["roof_m"]
    profile[OVER_ROOF] = over_m.where(profile["roof_m"] > 0)
    sides_m = np.array(grid.shape[::-1]) * grid.resolution_m
    profile[OUTSIDE] = np.minimum(lines_m, sides_m - lines_m).min(axis=(1, 2))
    profile[CLEARANCE] = _to_obstacles_m(lines_m, level_below_m(lowest_m, levels_m), maps, roofs)
    return profile


def _to_obstacles_m(
    lines_m: np.ndarray, level_m: np.ndarray, maps: MetricMaps, roofs: str
) -> np.ndarray:
    """Return ``[M]`` the distance from straight lines to the nearest obstacle cell of a level (`clearance_m`).

    Args:
      lines_m: ``[M, 2, 2]`` start and end of each, metres from the maps' southwest corner.
      level_m: ``[M]`` the altitude at which each meets obstacles.
      maps: their obstacles count at an altitude of theirs, unless they hold the roofs that touch a cell.
      roofs: the map of roofs that count else.
    """
    away_m = np.empty(len(lines_m))
    for z_m in np.unique(level_m).tolist():
        is_obstacle = maps.m(roofs) >= z_m
        if roofs != TOUCHED and z_m in maps.altitudes_m:
            is_obstacle = maps.m("obstacle", z_m) == 1
        is_at = level_m == z_m
        away_m[is_at] = clearance_m(lines_m[is_at], is_obstacle, maps.grid.resolution_m)
    return away_m


def _sample(
    planned: PlannedPath, maps: MetricMaps, cut: Crossings, name: str, level_m: np.ndarray
) -> np.ndarray:
    """Return ``[M]`` float64 the values of a map in the cells crossed, each at its own level (`values_at`)."""
    when = {key: planned.settings[key] for key in ("time", "time_of_day")}
    if "altitude" not in maps.ds[maps.variable(name)].dims:
        return maps.m(name, **when)[cut.row, cut.col].astype(float)

    def at(z_m: float, cells: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return values_at(
            z_m,
            maps.altitudes_m,
            lambda map_m: maps.m(name, map_m, **when)[cells],
            lambda map_m: maps.is_under_sky(map_m)[cells],
            is_count=name == VISIBLE,
        )

    values = np.empty(len(level_m))
    for z_m in np.unique(level_m).tolist():
        is_at = level_m == z_m
        values[is_at] = at(z_m, (cut.row[is_at], cut.col[is_at]))
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
    if GUESSED not in profile:
        return set()
    names = set()
    over_m = profile[OVER_ROOF]
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
    first, after = np.flatnonzero(np.diff(is_without)).reshape(-1, 2).T
    from_m, to_m = profile[["from_m", "to_m"]].to_numpy().T
    return list(zip(from_m[first].tolist(), to_m[after - 1].tolist(), strict=True))


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
      note Buildings: the nearest that reaches the flight height is 14.1 m away, 239 m along the route.
      note Roofs: the lowest pass leaves 23.7 m above a roof of 36.3 m, 267 m along the route.
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
        near_m = length_m[profile[TO_GUESSED] < NEAR_GUESSED_M].sum()
        over_m = length_m[profile[GUESSED]].sum()
        past = (
            f"{near_m:.0f} of {length_m.sum():.0f} m of the route pass within {NEAR_GUESSED_M:g} m of guessed roofs, "
            f"{over_m:.0f} m over them"
        )
    return caution_of_guesses({} if maps is None else maps.guesses, past)


def _fix(profile: pd.DataFrame) -> Iterator[Caution]:
    """Yield the caution of metres without a position fix, with the longest stretches."""
    if FIX not in profile:
        yield Caution(f"GPS: these maps hold no {FIX}, so where there is no fix is not known.")
        return
    segments = without_fix(profile)
    if not segments:
        return
    longest = sorted(segments, key=lambda ends: ends[0] - ends[1])[:MOST_SEGMENTS]
    listed = ", ".join(f"{from_m:.0f} to {to_m:.0f} m" for from_m, to_m in sorted(longest))
    where = f"from {listed} along the route"
    if len(segments) > len(longest):
        where += f" and {len(segments) - len(longest)} shorter"
    no_fix_m = sum(to_m - from_m for from_m, to_m in segments)
    length_m = profile["to_m"].iloc[-1]
    yield Caution(f"GPS: no fix on {no_fix_m:.0f} of {length_m:.0f} m: {where}.", "limit")


def _clearance(profile: pd.DataFrame, apart_m: float) -> Caution:
    """Return the caution of the nearest building at flight height, or of how far around none is known."""
    inside = int(np.argmin(profile[CLEARANCE]))
    outside = int(np.argmin(profile[OUTSIDE]))
    inside_m = float(profile[CLEARANCE].iloc[inside])
    outside_m = float(profile[OUTSIDE].iloc[outside])
    if inside_m <= outside_m:
        sentence = (
            f"Buildings: the nearest that reaches the flight height is {inside_m:.1f} m away, "
            f"{_at(profile, inside)}"
        )
    else:
        sentence = (
            f"Buildings: none that reaches the flight height is within {outside_m:.1f} m, "
            f"{_at(profile, outside)}, as far as the maps reach; what stands beyond their border is not known"
        )
        if np.isfinite(inside_m):
            sentence += f"; in the region the nearest is {inside_m:.1f} m away"
    is_guess = CLEARANCE in guessed_clearances(profile)
    if is_guess:
        guessed_m = float(profile[TO_GUESSED].min())
        nearest = f"the nearest of them is {guessed_m:.1f} m away"
        if guessed_m <= 0:
            nearest = "the route passes over some of them"
        sentence += f". This holds only if guessed roofs are right: {nearest}"
    if inside_m < apart_m - AT_LIMIT or inside_m <= 0:
        return Caution(f"{sentence}.", "limit")
    return Caution(f"{sentence}.", "guess" if is_guess else "note")


def _roofs(profile: pd.DataFrame, above_m: float) -> Iterator[Caution]:
    """Yield where a route is beside a building in its own cells, and where it is lowest over a roof.

    Args:
      profile: of the route.
      above_m: the height over roofs below which it is beyond limits.
    """
    over_m = profile[OVER_ROOF]
    is_beside = over_m <= 0  # of a cell that a building only touches
    if is_beside.any():
        length_m = profile["to_m"] - profile["from_m"]
        yield Caution(
            f"Buildings: {length_m[is_beside].sum():.1f} m of the route lie in cells that a building "
            "as high as the route touches, perhaps inside its outline.",
            "limit",
        )
    over_m = over_m.mask(is_beside)
    if not over_m.notna().any():
        return
    least = int(np.nanargmin(over_m))
    least_m = over_m.iloc[least]
    roof = _roof(profile, least)
    yield Caution(
        f"Roofs: the lowest pass leaves {least_m:.1f} m above {roof}, {_at(profile, least)}.",
        "limit" if least_m < above_m - AT_LIMIT else roof.level,
    )


def _ends(profile: pd.DataFrame) -> Iterator[Caution]:
    """Yield a caution for each end that is over a roof, or beside one that touches its cell."""
    for name, place in (("start", 0), ("goal", -1)):
        row = profile.iloc[place]
        if row["roof_m"] >= row["z_m"]:
            yield Caution(
                f"The {name} is in a cell that a building of {row['roof_m']:.1f} m touches.",
                "limit",
            )
        elif row["roof_m"] > 0:
            roof = _roof(profile, place)
            yield Caution(f"The {name} is over {roof}, not over the ground.", roof.level)


def _roof(profile: pd.DataFrame, place: int) -> Caution:
    """Return the roof beneath a place of a profile, in words, with the level of what rests on its height."""
    roof = f"roof of {profile['roof_m'].iloc[place]:.1f} m"
    if GUESSED in profile and profile[GUESSED].iloc[place]:
        return Caution(f"a guessed {roof}", "guess")
    return Caution(f"a {roof}")


def _manoeuvres(planned: PlannedPath) -> Iterator[str]:
    """Yield what of a route the vehicle flies only more slowly: its steepest climb and descent, its sharpest turn."""
    vehicle = Vehicle.of(planned.settings)
    points_m = np.column_stack([planned.xy_m, planned.z_m])
    moved_m = np.diff(points_m, axis=0)
    along_m = along_of(points_m)
    speed_m_s = vehicle.speed_m_s
    air_m = np.linalg.norm(moved_m, axis=1)
    slope = moved_m[:, 2] / np.where(air_m > 0, air_m, 1.0)
    for name, most_m_s, share in (
        ("climb", vehicle.max_climb_m_s, slope),
        ("descent", vehicle.max_descent_m_s, -slope),
    ):
        if most_m_s is None or speed_m_s is None:
            continue
        num = int((speed_m_s * share > most_m_s * (1 + AT_LIMIT)).sum())
        if num:
            steepest = int(np.argmax(share))
            yield (
                f"Vehicle: legs that would need more than {most_m_s:g} m/s of {name} at {speed_m_s:g} m/s: {num}; the "
                f"steepest, {along_m[steepest]:.0f} m along the route, is flown at {most_m_s / share[steepest]:.2g} "
                "m/s at most."
            )
    if vehicle.max_turn_deg is None:
        return
    ahead = np.flatnonzero(moved_m[:, :2].any(axis=1))  # straight up and down has no heading
    east_m, north_m, _ = moved_m[ahead].T
    heading_deg = np.degrees(np.arctan2(north_m, east_m))
    turn_deg = np.abs((np.diff(heading_deg) + 180) % 360 - 180)
    num = int((turn_deg > vehicle.max_turn_deg * (1 + AT_LIMIT)).sum())
    if num:
        sharpest = int(np.argmax(turn_deg))
        yield (
            f"Vehicle: turns sharper than {vehicle.max_turn_deg:g} degrees: {num}; the sharpest, of "
            f"{turn_deg[sharpest]:.0f} degrees, is {along_m[ahead[sharpest + 1]]:.0f} m along the route."
        )


def _at(profile: pd.DataFrame, place: int) -> str:
    middle_m = profile[["from_m", "to_m"]].iloc[place].mean()
    return f"{middle_m:.0f} m along the route"
