"""What a pilot should know of a planned route before it is flown, in short sentences."""

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from jaxurban.errors import typed
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.profile import CLEARANCE, OUTSIDE, OVER_ROOF, VISIBLE, cautious_profile, without_fix
from jaxurban.paths.vehicle import Vehicle

MOST_SEGMENTS = 3  # that a terminal line lists
ROUNDING = 1e-9  # of climbs and turns that are just what the vehicle can


@typed
def cautions(planned: PlannedPath, maps: GivenMaps, profile: pd.DataFrame | None = None) -> list[str]:
    """Return where GPS has no fix, how near buildings and roofs are, and what else to know, a sentence each.

    Also told: an end over a roof; climbs, descents and turns beyond the limits of the vehicle that it was planned for.

    Distances are measured from the route to the edges of cells, so that 0 is contact; obstacles outside the region
    count as far as the risk map knows them (`explain`).

    Args:
      planned: a path, from `plan`.
      maps: the maps it was planned on, or their folder.
      profile: of `explain`; made here if left out.

    Raises:
      InputError: there is no path, or the maps are others.
    """
    maps = as_maps(maps)
    profile = cautious_profile(planned, maps) if profile is None else profile
    return [*_fix(profile), _clearance(profile, maps), *_roofs(profile), *_ends(profile), *_manoeuvres(planned)]


def _fix(profile: pd.DataFrame) -> Iterator[str]:
    if VISIBLE not in profile:
        yield "GPS: these maps hold no satellite counts, so where there is no fix is not known."
        return
    segments = without_fix(profile)
    if not segments:
        return
    lengths_m = [to_m - from_m for from_m, to_m in segments]
    longest = sorted(sorted(range(len(segments)), key=lambda k: -lengths_m[k])[:MOST_SEGMENTS])
    where = ", ".join(f"{segments[k][0]:.0f} to {segments[k][1]:.0f} m" for k in longest)
    left = len(segments) - len(longest)
    more = f" and {left} shorter segment{'s' * (left > 1)}" if left else ""
    yield (
        f"GPS: no fix (fewer than four satellites) on {sum(lengths_m):.0f} of {profile['to_m'].iloc[-1]:.0f} m: "
        f"from {where} along the route{more}."
    )


def _clearance(profile: pd.DataFrame, maps: MetricMaps) -> str:
    inside, outside = (int(np.argmin(profile[name])) for name in (CLEARANCE, OUTSIDE))
    inside_m, outside_m = float(profile[CLEARANCE].iloc[inside]), float(profile[OUTSIDE].iloc[outside])
    if inside_m <= outside_m:
        return f"Buildings: the nearest at flight height is {inside_m:.1f} m away, {_at(profile, inside)}."
    within_m = outside_m + math.sqrt(2) * maps.grid.resolution_m  # what risk takes for its distance, at most
    is_told = within_m < maps.ds.attrs.get("risk_threshold_m", 0.0) and maps.ds.attrs["risk_distance"] == "slice"
    if is_told and profile[CLEARANCE].iloc[outside] > within_m + maps.grid.resolution_m:
        return (
            f"Buildings: the nearest at flight height stands outside the region, {outside_m:.1f} to {within_m:.1f} m "
            f"away, {_at(profile, outside)}."
        )
    known = f"; in the region the nearest is {inside_m:.1f} m away" if math.isfinite(inside_m) else ""
    return (
        f"Buildings: none at flight height is within {outside_m:.1f} m, {_at(profile, outside)}; what stands farther "
        f"outside the region is not known{known}."
    )


def _roofs(profile: pd.DataFrame) -> Iterator[str]:
    is_beside = profile[OVER_ROOF] <= 0  # of a cell that a building only touches
    if is_beside.any():
        beside_m = float((profile["to_m"] - profile["from_m"])[is_beside].sum())
        yield f"Buildings: {beside_m:.1f} m of the route lie in cells that one as high touches, maybe in its outline."
    over_m = profile[OVER_ROOF].where(~is_beside)
    if over_m.notna().any():
        least = int(np.nanargmin(over_m))
        roof_m = float(profile["roof_m"].iloc[least])
        yield (
            f"Roofs: the least height over one is {over_m.iloc[least]:.1f} m, {_at(profile, least)} "
            f"(a roof of {roof_m:.1f} m)."
        )


def _ends(profile: pd.DataFrame) -> Iterator[str]:
    for name, place in (("start", 0), ("goal", -1)):
        roof_m = float(profile["roof_m"].iloc[place])
        if roof_m >= float(profile["z_m"].iloc[place]):
            yield f"The {name} is in a cell that a building of {roof_m:.1f} m touches."
        elif roof_m > 0:
            yield f"The {name} is over a roof of {roof_m:.1f} m, not over the ground."


def _manoeuvres(planned: PlannedPath) -> Iterator[str]:
    """Yield what of a route the vehicle flies only more slowly: its steepest climb and descent, its sharpest turn."""
    vehicle = Vehicle.of(planned.settings)
    moved_m = np.diff(np.column_stack([planned.xy_m, planned.z_m]), axis=0)
    air_m = np.linalg.norm(moved_m, axis=1)
    along_m, speed_m_s = np.append(0.0, np.cumsum(air_m)), vehicle.speed_m_s
    rises = (("climb", vehicle.max_climb_m_s, moved_m[:, 2]), ("descent", vehicle.max_descent_m_s, -moved_m[:, 2]))
    for name, most_m_s, rise_m in rises:
        if most_m_s is None or speed_m_s is None:
            continue
        needed_m_s = speed_m_s * rise_m / np.where(air_m > 0, air_m, 1.0)
        if num := int((needed_m_s > most_m_s * (1 + ROUNDING)).sum()):
            steepest = int(np.argmax(needed_m_s))
            yield (
                f"Vehicle: {num} leg{'s' * (num > 1)} would need more than {most_m_s:g} m/s of {name} at {speed_m_s:g} "
                f"m/s; the steepest, {along_m[steepest]:.0f} m along the route, is flown at "
                f"{speed_m_s * most_m_s / needed_m_s[steepest]:.2g} m/s at most."
            )
    if vehicle.max_turn_deg is None:
        return
    ahead = np.hypot(moved_m[:, 0], moved_m[:, 1]) > 0  # straight up and down there is no heading
    heading_deg = np.degrees(np.arctan2(moved_m[ahead, 1], moved_m[ahead, 0]))
    turn_deg = np.abs((np.diff(heading_deg) + 180) % 360 - 180)
    if num := int((turn_deg > vehicle.max_turn_deg * (1 + ROUNDING)).sum()):
        sharpest = int(np.argmax(turn_deg))
        at_m = along_m[np.flatnonzero(ahead)[sharpest + 1]]
        yield (
            f"Vehicle: {num} turn{'s are' if num > 1 else ' is'} sharper than {vehicle.max_turn_deg:g} degrees; the "
            f"sharpest, of {turn_deg[sharpest]:.0f} degrees, is {at_m:.0f} m along the route."
        )


def _at(profile: pd.DataFrame, place: int) -> str:
    return f"{(profile['from_m'].iloc[place] + profile['to_m'].iloc[place]) / 2:.0f} m along the route"
