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
from jaxurban.paths.route_report import (
    CLEARANCE,
    GUESSED,
    OUTSIDE,
    OVER_ROOF,
    TO_GUESSED,
    TOUCHED,
    VISIBLE,
    guessed_clearances,
)
from jaxurban.planners.cost import path_states
from jaxurban.public import Caution, caution_of_guesses, sentences_of
from jaxurban.settings import Vehicle

MOST_SEGMENTS = 3  # that a terminal line lists
# Of a guessed roof a route passes it: what the risk metric counts as near by default.
NEAR_GUESSED_M = 50.0
# Below which a height over a roof is beyond limits, where no vertical clearance was asked.
LEAST_OVER_ROOFS_M = 1.0


def cut_evenly(states_m: np.ndarray, most: int) -> np.ndarray:
    """Return ``[S]`` the number, from 0 up, of the segment that each step of a route belongs to.

    A segment ends at the end of a step, so that its cost is the sum of its steps' costs. Segments are as nearly equal
    in length as steps allow, and fewer than ``most`` where a step is longer than a segment would be.

    Args:
      states_m: ``[S + 1, D]`` the corners between which the steps run.
      most: the number of segments, at least 1.
    """
    along_m = along_of(states_m)
    last = len(along_m) - 1
    ideal_m = along_m[-1] * np.arange(1, most) / most  # where segments of equal length would end
    after = np.clip(np.searchsorted(along_m, ideal_m), 1, last)
    before = after - 1
    is_before_nearer = ideal_m - along_m[before] <= along_m[after] - ideal_m
    cuts = np.setdiff1d(np.where(is_before_nearer, before, after), [0, last])
    return np.searchsorted(cuts, np.arange(last), side="right")


def clearance_m(ends_m: np.ndarray, is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[M]`` the exact distance from straight lines to the nearest obstacle cell; inf without one.

    It is measured from the line itself to the side of the cell's square: half a cell where a line passes the middle of
    the cell next to an obstacle. Distances have no upper limit, and nothing stands outside the map. An obstacle cell
    that obstacles surround is left out, so that a line within it is some metres from its neighbours.

    Args:
      ends_m: ``[M, 2, 2]`` start and end (x, y) of each line, metres from the map's southwest corner.
      is_obstacle: ``[Y, X]`` bool.
      resolution_m: side of a cell.
    """
    # Where all four neighbours within the map are obstacles too, another one is nearer to a line outside.
    row, col = np.nonzero(is_obstacle & ~binary_erosion(is_obstacle, border_value=1))
    if len(row) == 0:  # no obstacle, or nothing else
        return np.full(len(ends_m), 0.0 if is_obstacle.any() else np.inf)
    sides_m = np.stack([col, row, col + 1, row + 1]) * resolution_m  # west, south, east, north
    squares = shapely.STRtree(shapely.box(*sides_m))
    (line, _), distance_m = squares.query_nearest(
        shapely.linestrings(ends_m), return_distance=True, all_matches=False
    )
    nearest_m = np.empty(len(ends_m))
    nearest_m[line] = distance_m
    return nearest_m


def level_below_m(z_m: np.ndarray, levels_m: Sequence[float]) -> np.ndarray:
    """Return ``[M]`` the highest of some levels that is not above each height ``[M]``.

    For a height beneath all levels it is the lowest of them.
    """
    ascending_m = np.sort(np.asarray(levels_m, float))
    below = np.searchsorted(ascending_m, z_m + SAME_HEIGHT_M, side="right") - 1
    return ascending_m[np.maximum(below, 0)]


def nearest_level_m(z_m: np.ndarray, levels_m: Sequence[float]) -> np.ndarray:
    """Return ``[M]`` the nearest of some levels, the lower one where two are as near."""
    ascending_m = np.sort(np.asarray(levels_m, float))
    return ascending_m[np.argmin(np.abs(z_m[:, None] - ascending_m), axis=1)]


def cut_on(planned: PlannedPath, maps: MetricMaps) -> Crossings:
    """Return a route cut at the borders of its maps' cells, x and y measured from the maps' southwest corner.

    A step ends where the ``cell`` cost model counts a cell, and steps without length are left out.

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
    has_length = np.any(np.diff(states_m, axis=0) != 0, axis=1)
    return crossed_cells(states_m[np.append(True, has_length)], grid.resolution_m)


def profile_of(
    planned: PlannedPath, maps: MetricMaps, cut: Crossings, shown: Mapping[str, str]
) -> pd.DataFrame:
    """Return a row for each crossing of a cell: its place, the values of maps there, roofs and clearances.

    Where the maps know which roofs are guessed, also whether the one beneath is, and how far the nearest is.

    Each crossing takes the maps of the level nearest to it, as the planner did. The number of satellites and obstacles
    are those of the level below, where there are fewer satellites and more obstacles. What stands outside the region is
    not known: it is no nearer than the border.

    Args:
      planned: the route.
      maps: the maps that it was planned on.
      cut: the route cut at the borders of cells, from `cut_on`.
      shown: names of columns by the names of the maps that fill them; maps that are missing are left out.
    """
    # Where each crossing lies.
    ends_m, grid = cut.ends_m, maps.grid
    lines_m = ends_m[:, :, :2]
    lowest_m = ends_m[:, :, 2].min(axis=1)
    x_m, y_m, z_m = ends_m.mean(axis=1).T
    lon, lat = grid.lonlat_of_xy(x_m + grid.x_min_m, y_m + grid.y_min_m)
    to_m = np.cumsum(cut.length_m)
    places = {"from_m": to_m - cut.length_m, "to_m": to_m, "lon": lon, "lat": lat, "z_m": z_m}
    profile = pd.DataFrame(places)

    # The values of maps. A roof is the highest that touches a cell where the maps hold it, else that at its middle.
    levels_m = planned.settings.get("levels_m") or [planned.altitude_m]
    level_m = nearest_level_m(z_m, levels_m)
    roofs = TOUCHED if TOUCHED in maps.ds else "roof"
    for name, column in {**shown, roofs: "roof_m", GUESSED: GUESSED}.items():
        if maps.variable(name) in maps.ds:
            profile[column] = _sample(planned, maps, cut, name, level_m)
    if VISIBLE in profile:
        profile[VISIBLE] = profile[VISIBLE].astype(int)

    # Guessed roofs. `clearance_m` leaves out what roofs surround, so that over one the distance is set here.
    if GUESSED in profile:
        profile[GUESSED] = profile[GUESSED].astype(bool)
        away_m = clearance_m(lines_m, maps.m(GUESSED).astype(bool), grid.resolution_m)
        profile[TO_GUESSED] = np.where(profile[GUESSED], 0.0, away_m)

    # The height over roofs, NaN over none; the distance to the border, and that to obstacles.
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
      maps: the maps. Without roofs that touch a cell, their own obstacles count at their altitudes.
      roofs: name of the map of roofs, which are obstacles elsewhere if they reach the level.
    """
    away_m = np.empty(len(lines_m))
    for z_m in np.unique(level_m).tolist():
        is_obstacle = maps.m(roofs) >= z_m
        if roofs != TOUCHED and z_m in maps.altitudes_m:
            is_obstacle = maps.m("obstacle", z_m) == 1
        is_on_level = level_m == z_m
        away_m[is_on_level] = clearance_m(lines_m[is_on_level], is_obstacle, maps.grid.resolution_m)
    return away_m


def _sample(
    planned: PlannedPath, maps: MetricMaps, cut: Crossings, name: str, level_m: np.ndarray
) -> np.ndarray:
    """Return ``[M]`` float64 the values of a map in the cells that a route crosses, each at its own level.

    A level between two altitudes of the maps takes its value from both (`values_at`).

    Args:
      planned: the route, whose settings name the time and the time of day.
      maps: the maps that it was planned on.
      cut: the route cut at the borders of cells: ``M`` crossings.
      name: of the map.
      level_m: ``[M]`` the level of each crossing.
    """
    when = {key: planned.settings[key] for key in ("time", "time_of_day")}
    if "altitude" not in maps.ds[maps.variable(name)].dims:
        return maps.m(name, **when)[cut.row, cut.col].astype(float)

    def values_in(z_m: float, cells: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the map's values on a level in some cells: their rows and their columns."""
        return values_at(
            z_m,
            maps.altitudes_m,
            lambda map_m: maps.m(name, map_m, **when)[cells],
            lambda map_m: maps.is_under_sky(map_m)[cells],
            is_count=name == VISIBLE,
        )

    values = np.empty(len(level_m))
    for z_m in np.unique(level_m).tolist():
        is_on_level = level_m == z_m
        values[is_on_level] = values_in(z_m, (cut.row[is_on_level], cut.col[is_on_level]))
    return values


def cautious_profile(planned: PlannedPath, maps: MetricMaps) -> pd.DataFrame:
    """Return HDOP, roofs and clearance along a route: the profile of a report without metrics and people.

    Raises:
      InputError: there is no path, or the maps are others.
    """
    return profile_of(planned, maps, cut_on(planned, maps), {FIX: FIX})


def without_fix(profile: pd.DataFrame) -> list[tuple[float, float]]:
    """Return begin and end along the route, in metres, of each stretch without a fix (`has_no_fix`), in their order.

    Empty where there is none, or where the maps hold no HDOP.

    Args:
      profile: of the route (`profile_of`), or a part of it.
    """
    if FIX not in profile:
        return []
    # Where the fix is lost and regained, by turns: the first row of a stretch and the first one after it.
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
    for; and what the path's message notes. A sentence each, what is guessed first.

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
    horizontal_m = limits.get("clearance_m", 0.0) + limits.get("vehicle_radius_m", 0.0)
    vertical_m = limits.get("vertical_clearance_m") or LEAST_OVER_ROOFS_M
    return [
        *guess_cautions(maps, profile),
        *_fix(profile),
        _clearance(profile, horizontal_m),
        *_roofs(profile, vertical_m),
        *_ends(profile),
        *(Caution(sentence, "limit") for sentence in _manoeuvres(planned)),
        *map(Caution, sentences_of(planned.search.note)),
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
    guesses = {} if maps is None else maps.guesses
    return caution_of_guesses(guesses, of_route)


def _fix(profile: pd.DataFrame) -> Iterator[Caution]:
    """Yield the caution of metres without a position fix, which names the longest stretches (`MOST_SEGMENTS`).

    Nothing is yielded where the route has a fix everywhere; without an HDOP in the maps, a note says so.
    """
    if FIX not in profile:
        yield Caution(f"GPS: these maps hold no {FIX}, so where there is no fix is not known.")
        return
    stretches = without_fix(profile)
    if not stretches:
        return

    # The longest, the earlier of two as long, and then in the order of travel.
    longest = sorted(stretches, key=lambda stretch: stretch[0] - stretch[1])[:MOST_SEGMENTS]
    listed = ", ".join(f"{from_m:.0f} to {to_m:.0f} m" for from_m, to_m in sorted(longest))
    where = f"from {listed} along the route"
    if len(stretches) > len(longest):
        where += f" and {len(stretches) - len(longest)} shorter"
    no_fix_m = sum(to_m - from_m for from_m, to_m in stretches)
    route_m = profile["to_m"].iloc[-1]
    yield Caution(f"GPS: no fix on {no_fix_m:.0f} of {route_m:.0f} m: {where}.", "limit")


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
        sentence = (
            f"Buildings: the nearest that reaches the flight height is {nearest_m:.1f} m away, "
            f"{_at(profile, nearest)}"
        )
    else:
        sentence = (
            f"Buildings: none that reaches the flight height is within {border_m:.1f} m, "
            f"{_at(profile, border)}, as far as the maps reach; what stands beyond their border is not known"
        )
        if np.isfinite(nearest_m):
            sentence += f"; in the region the nearest is {nearest_m:.1f} m away"

    is_guess = CLEARANCE in guessed_clearances(profile)
    if is_guess:
        guessed_m = profile[TO_GUESSED].min()
        where = f"the nearest of them is {guessed_m:.1f} m away"
        if guessed_m <= 0:
            where = "the route passes over some of them"
        sentence += f". This holds only if guessed roofs are right: {where}"
    if nearest_m < least_m - AT_LIMIT or nearest_m <= 0:
        return Caution(f"{sentence}.", "limit")
    return Caution(f"{sentence}.", "guess" if is_guess else "note")


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
    )


def _ends(profile: pd.DataFrame) -> Iterator[Caution]:
    """Yield a caution for each end of a route that is over a roof, or in a cell that a roof as high touches."""
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
