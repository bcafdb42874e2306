"""What a pilot should know of a planned route before it is flown, in short sentences, each with its level."""

from collections.abc import Iterator
from typing import Literal

import numpy as np
import pandas as pd

from jaxurban.errors import typed
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.profile import (
    CLEARANCE,
    GUESSED,
    OUTSIDE,
    OVER_ROOF,
    TO_GUESSED,
    VISIBLE,
    cautious_profile,
    guessed_clearances,
    without_fix,
)
from jaxurban.settings import Vehicle

MOST_SEGMENTS = 3  # that a terminal line lists
ROUNDING = 1e-9  # of climbs and turns that are just what the vehicle can
NEAR_GUESSED_M = 50.0  # of a guessed roof a route passes it: what the risk metric counts as near by default
LEAST_OVER_ROOFS_M = 1.0  # below which a height over a roof is beyond limits, where no vertical clearance was asked
Level = Literal["guess", "note", "limit"]


class Caution(str):
    """A sentence to a pilot, a `str` that also has a level.

    Attributes:
      level: ``"guess"``: it rests on what no file says. ``"limit"``: something lies beyond limits: a stretch without a
        fix, cells that a building as high touches, a height over a roof below the vertical clearance (1 m where none
        was asked), a building nearer than the clearance and the vehicle's radius, or a manoeuvre beyond the vehicle.
        ``"note"``: all else.
    """

    level: Level

    def __new__(cls, text: str, level: Level = "note") -> "Caution":
        """Return a sentence with a level."""
        caution = super().__new__(cls, text)
        caution.level = level
        return caution


@typed
def cautions(planned: PlannedPath, maps: GivenMaps, profile: pd.DataFrame | None = None) -> list[Caution]:
    """Return what the maps guess, where GPS has no fix, how near buildings and roofs are, and what else to know.

    Also reported: an end over a roof; climbs, descents and turns beyond the limits of the vehicle that it was planned
    for. A sentence each, what is guessed first.

    Distances are measured from the route to the edges of cells, so that 0 is contact; obstacles outside the region are
    not known.

    Args:
      planned: a path, from `plan`.
      maps: the maps it was planned on, or their folder.
      profile: of `explain`; made here if left out.

    Raises:
      InputError: there is no path, or the maps are others.
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
    facts = ["" if maps is None else ", ".join(maps.guesses)]
    if profile is not None and GUESSED in profile:
        length_m = profile["to_m"] - profile["from_m"]
        near_m, over_m = length_m[profile[TO_GUESSED] < NEAR_GUESSED_M].sum(), length_m[profile[GUESSED]].sum()
        facts.append(
            f"{near_m:.0f} of {length_m.sum():.0f} m of the route pass within {NEAR_GUESSED_M:g} m of guessed roofs, "
            f"{over_m:.0f} m over them"
        )
    return [Caution(f"Guessed: {'; '.join(filter(None, facts))}.", "guess")] if any(facts) else []


def _fix(profile: pd.DataFrame) -> Iterator[Caution]:
    if VISIBLE not in profile:
        yield Caution("GPS: these maps hold no satellite counts, so where there is no fix is not known.")
        return
    segments = without_fix(profile)
    if not segments:
        return
    longest = sorted(sorted(segments, key=lambda ends: ends[0] - ends[1])[:MOST_SEGMENTS])
    where = ", ".join(f"{from_m:.0f} to {to_m:.0f} m" for from_m, to_m in longest)
    all_m, left = sum(to_m - from_m for from_m, to_m in segments), len(segments) - len(longest)
    yield Caution(
        f"GPS: no fix (fewer than four satellites) on {all_m:.0f} of {profile['to_m'].iloc[-1]:.0f} m: "
        f"from {where} along the route{f' and {left} shorter' * (left > 0)}.",
        "limit",
    )


def _clearance(profile: pd.DataFrame, apart_m: float) -> Caution:
    inside, outside = (int(np.argmin(profile[name])) for name in (CLEARANCE, OUTSIDE))
    inside_m, outside_m = float(profile[CLEARANCE].iloc[inside]), float(profile[OUTSIDE].iloc[outside])
    if inside_m <= outside_m:
        sentence = f"Buildings: the nearest at flight height is {inside_m:.1f} m away, {_at(profile, inside)}"
    else:
        nearest = f"; in the region the nearest is {inside_m:.1f} m away" if np.isfinite(inside_m) else ""
        sentence = (
            f"Buildings: none at flight height is within {outside_m:.1f} m, {_at(profile, outside)}, as far as the "
            f"maps reach; what stands beyond their border is not known{nearest}"
        )
    if is_guess := CLEARANCE in guessed_clearances(profile):
        guessed_m = float(profile[TO_GUESSED].min())
        nearest = f"the nearest of those is {guessed_m:.1f} m away" if guessed_m > 0 else "the route passes over some"
        sentence += f", if guessed roofs are right: {nearest}"
    is_beyond = inside_m < apart_m - ROUNDING or inside_m <= 0
    return Caution(f"{sentence}.", "limit" if is_beyond else "guess" if is_guess else "note")


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
            "limit" if over_m.iloc[least] < above_m - ROUNDING else level,
        )


def _ends(profile: pd.DataFrame) -> Iterator[Caution]:
    for name, place in (("start", 0), ("goal", -1)):
        roof_m = float(profile["roof_m"].iloc[place])
        if roof_m >= float(profile["z_m"].iloc[place]):
            yield Caution(f"The {name} is in a cell that a building of {roof_m:.1f} m touches.", "limit")
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
        if num := int((speed_m_s * share > most_m_s * (1 + ROUNDING)).sum()):
            steepest = int(np.argmax(share))
            yield (
                f"Vehicle: legs that would need more than {most_m_s:g} m/s of {name} at {speed_m_s:g} m/s: {num}; the "
                f"steepest, {along_m[steepest]:.0f} m along the route, is flown at {most_m_s / share[steepest]:.2g} "
                "m/s at most."
            )
    if vehicle.max_turn_deg is None:
        return
    ahead = np.flatnonzero(np.hypot(moved_m[:, 0], moved_m[:, 1]))  # straight up and down there is no heading
    heading_deg = np.degrees(np.arctan2(moved_m[ahead, 1], moved_m[ahead, 0]))
    turn_deg = np.abs((np.diff(heading_deg) + 180) % 360 - 180)
    if num := int((turn_deg > vehicle.max_turn_deg * (1 + ROUNDING)).sum()):
        sharpest = int(np.argmax(turn_deg))
        yield (
            f"Vehicle: turns sharper than {vehicle.max_turn_deg:g} degrees: {num}; the sharpest, of "
            f"{turn_deg[sharpest]:.0f} degrees, is {along_m[ahead[sharpest + 1]]:.0f} m along the route."
        )


def _at(profile: pd.DataFrame, place: int) -> str:
    return f"{(profile['from_m'].iloc[place] + profile['to_m'].iloc[place]) / 2:.0f} m along the route"
