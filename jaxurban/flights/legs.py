"""The legs of a mission over maps: short steps with heights above the ground, and what of them is not known.

A leg is flown in the frame of its end, as ArduPilot does (``AC_WPNav::set_wp_destination``): where the height of the
end is above the ground, the height of the start is brought there too, and the vehicle follows the ground. Otherwise it
flies straight. `Leg.profile` says where this does not hold.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban.flights.missions.parts import GEOD, Leg, Mission, Place, circle_around
from jaxurban.knowledge import Unjudged
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.steps import Steps, between, steps_of
from jaxurban.world.grid import Bounds

NOWHERE_M = 1e12  # x and y where the projection has no value
ON_SITE = ("climb", "land")  # kinds of legs between the ground and the height of flight
CIRCLE_SAG_M = 0.05  # by which the chords of a loiter leave its circle
FEWEST_CHORDS, MOST_CHORDS = 16, 720

OUTSIDE = "lie outside the maps"
NO_HEIGHT = "have a height that the file leaves open"
NO_RETURN = (
    "return at a height that the file leaves open: name it (return_altitude_m, --return-altitude)"
)
NO_ZERO = {  # where the zero of a datum is not known
    "home": "have heights above home, whose place or elevation is not known: name it (home, --home), or "
    "make the maps with a terrain",
    "geoid": "have heights above the geoid, and neither the maps nor the file say how high the ground is above it",
    "ellipsoid": "have heights above the ellipsoid: name the geoid's height above it (geoid_m, "
    "--heights geoid_m=METRES; 37 m in Tokyo)",
    "ground": "begin or end above ground that the maps do not hold",
}


@dataclass(frozen=True, eq=False)
class Flight:
    """A mission over maps.

    Attributes:
      mission: the mission.
      steps: what of it has a height and lies within the maps.
      variants: the same of the ways that another setting of the autopilot, or another reading of the file, flies
        beside it.
      unknown: what has none or lies outside: its ``kind``, ``reason``, ``from_m`` and ``to_m`` along the mission.
      length_m: of the whole mission, in the air, without variants.
      ground: over which it is judged.
      lines_m: ``[N, 2, 2]`` x, y of begin and end of each straight part over the maps, whatever its height.
    """

    mission: Mission
    steps: Steps
    variants: Steps
    unknown: pd.DataFrame
    length_m: float
    ground: Elevation
    lines_m: np.ndarray

    def is_on_site(self, steps: Steps) -> np.ndarray:
        """Return ``[P]`` whether steps lead between the ground and the height of flight, or straight up or down."""
        leg_kinds = np.array([leg.kind for leg in self.mission.legs], object)
        return np.isin(leg_kinds[steps.leg], ON_SITE) | (steps.over_m == 0)

    @property
    def line_m(self) -> np.ndarray:
        """``[N, 3]`` x, y and greatest height above ground, where it leads over the maps, whatever its height there.

        Gaps are closed by straight lines. ``[N, 2]``, without the height, where none is known.
        """
        line_m = np.vstack([self.lines_m[:, 0], self.lines_m[-1:, 1]])  # begins, the last end
        z_m = self.steps.z_m[np.isfinite(self.steps.z_m)]
        return np.insert(line_m, 2, z_m.max(), axis=1) if len(z_m) else line_m

    @property
    def ground_note(self) -> str:
        """By how much the ground below it may be off, words to go after others; empty where it is known."""
        if self.ground.is_exact:
            return ""
        off_m = self.ground.off_m[tuple(self.steps.cell.T)].max(initial=0.0)
        return f"; over the ground of the maps' cells, which may be off by up to {off_m:.1f} m"

    @property
    def home_off_m(self) -> float:
        """How far home's elevation in the file is from the ground there; 0 where no height above the sea is flown."""
        mission = self.mission
        if mission.home is None or mission.home_elevation_m is None:
            return 0.0
        if self.ground.is_flat or "geoid" not in mission.datums:
            return 0.0
        home_m = self.ground.at_lonlat(*mission.home) + mission.home_above_ground_m
        off_m = home_m - mission.home_elevation_m
        return abs(np.nan_to_num(off_m))

    @property
    def off_line(self) -> list[str]:
        """What `line_m` leaves out, or knows no height of: a sentence each."""
        over_m = (
            (self.unknown["to_m"] - self.unknown["from_m"]).groupby(self.unknown["reason"]).sum()
        )
        sentences = []
        if over_m.get(OUTSIDE, 0.0) > 0:
            sentences.append(f"{over_m[OUTSIDE]:,.0f} m of the mission lie outside the maps.")
        open_m = over_m.reindex([NO_HEIGHT, NO_RETURN]).sum()
        if open_m > 0:
            sentences.append(
                f"The height is open on {open_m:,.0f} m: the flight is as high as the rest of it."
            )
        if self.mission.not_judged:
            sentences.append("What of the mission's file is not judged may lead elsewhere.")
        return sentences


def spans(along_m: np.ndarray, kind: Unjudged, reason: str) -> pd.DataFrame:
    """Return begins and ends along a mission ``[N, 2]`` as a table, with what is not known there and a reason."""
    from_m, to_m = along_m.T
    return pd.DataFrame({"kind": kind, "reason": reason, "from_m": from_m, "to_m": to_m})


class Segments(NamedTuple):
    """The straight segments of a mission, the chords of its loiters too. ``S`` of them, each with begin and end.

    Attributes:
      leg: ``[S]`` number of the leg, from 0.
      lonlat: ``[S, 2, 2]`` longitude, latitude in degrees.
      height_m: ``[S, 2]`` above the zero of its datum; NaN where the file leaves it open.
      datum: ``[S, 2]`` what the height is above.
      place: ``[S, 2]`` the ends as places.
      follows_ground: ``[S]`` whether it follows the ground, or else is straight.
      is_variant: ``[S]`` whether it is flown beside the next segment that is no variant.
    """

    leg: np.ndarray
    lonlat: np.ndarray
    height_m: np.ndarray
    datum: np.ndarray
    place: np.ndarray
    follows_ground: np.ndarray
    is_variant: np.ndarray

    @classmethod
    def of(cls, mission: Mission, is_flat: bool) -> "Segments":
        """Return the segments of a mission, in the order of travel.

        Where a leg may be straight or follow the ground, it follows it, and is straight as a variant, unless the ground
        is flat, where the two are the same. Ends on the ground at home are as high above it as home is, on a roof.
        """
        rows = []
        ends: list[Place] = []
        for number, leg in enumerate(mission.legs):
            is_above_ground = leg.end.datum == "ground"
            ways = [(is_above_ground and leg.profile != "straight", leg.is_variant)]
            if leg.profile == "both" and is_above_ground and not is_flat:
                ways.insert(0, (False, True))
            for follows_ground, is_variant in ways:
                for pair in pairwise(_corners_of(leg)):
                    rows.append((number, follows_ground, is_variant))
                    ends += pair
        table = pd.DataFrame(ends, columns=list(Place._fields))
        numbers, follow, beside = np.array(rows, int).reshape(-1, 3).T
        lonlat = table[["lon", "lat"]].to_numpy(float).reshape(-1, 2, 2)
        height_m = table["height_m"].to_numpy(float).reshape(-1, 2)
        datum = table["datum"].to_numpy().reshape(-1, 2)
        is_home = (lonlat == np.array(mission.home or np.nan)).all(axis=2)
        is_home &= (datum == "ground") & (height_m == 0)
        return cls(
            leg=numbers,
            lonlat=lonlat,
            height_m=np.where(is_home, mission.home_above_ground_m, height_m),
            datum=datum,
            place=pd.Series(ends, dtype=object).to_numpy().reshape(-1, 2),
            follows_ground=follow.astype(bool),
            is_variant=beside.astype(bool),
        )


def flight_of(mission: Mission, ground: Elevation, geoid_m: float | None = None) -> Flight:
    """Return a mission over maps, its heights brought to the ground.

    Args:
      mission: what is flown.
      ground: of the maps; its zero is taken for the geoid. Without terrain the ground is level.
      geoid_m: height of the geoid above the ellipsoid, for heights above the latter.

    Raises:
      InputError: a mission that is too long over the maps.
    """
    # Where the segments of the mission begin and end, how high, and how much of each lies over the maps.
    maps = ground.maps
    segments = Segments.of(mission, ground.is_flat)
    ends_m = np.nan_to_num(maps.grid.xy_at(segments.lonlat), posinf=NOWHERE_M)
    z_m, lacks = _heights_m(mission, segments, ends_m, ground, geoid_m)
    shares = _shares_within(ends_m, maps.grid.bounds_m)
    along_m = _along_m(segments, ends_m, z_m, (shares == [0, 1]).all(axis=1))
    is_known = np.isfinite(z_m).all(axis=1)
    enters = shares[:, 0] < shares[:, 1]

    # What is not known is not judged.
    unknown = [
        *_without_height(mission, segments, along_m, z_m, lacks),
        *_outside(along_m, shares, enters),
    ]

    # The rest, cut into steps: of the mission, and of its variants.
    states = np.dstack([ends_m, z_m, along_m])
    is_main = ~segments.is_variant
    ways = []
    for is_of_way in (is_main, ~is_main):
        flown = np.flatnonzero(enters & is_known & is_of_way)
        inside = between(states[flown], shares[flown])
        follows_ground = segments.follows_ground[flown]
        ways.append(steps_of(inside, segments.leg[flown], follows_ground, ground))
    steps, variants = ways
    length_m = float(along_m[is_main].max(initial=0.0))
    lines_m = between(ends_m, shares)[enters & is_main]
    return Flight(mission, steps, variants, pd.concat(unknown), length_m, ground, lines_m)


def _heights_m(
    mission: Mission,
    segments: Segments,
    ends_m: np.ndarray,
    ground: Elevation,
    geoid_m: float | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[S, 2]`` heights of begin and end of each segment, NaN where not known, and which datum these lack.

    Heights are above the zero of the terrain, or above the ground for segments that follow it.

    Args:
      mission, ground, geoid_m: as of `flight_of`.
      segments: of the mission.
      ends_m: ``[S, 2, 2]`` x, y of begin and end of each.
    """
    ground_m = ground.at(ends_m)
    zeros_m = _zeros_m(mission, ground, geoid_m)
    zero_m = np.vectorize(zeros_m.get, otypes=[float])(segments.datum, ground_m)
    z_m = segments.height_m + zero_m
    is_level = np.vectorize(lambda place: bool(place.level_with), otypes=[bool])(segments.place)
    for end in zip(*np.nonzero(is_level), strict=True):
        z_m[end] = _elevation_m(segments.place[end], ground, zeros_m)
    follows_ground = segments.follows_ground
    z_m[follows_ground] -= ground_m[follows_ground]
    is_given = (segments.datum == "ground") & follows_ground[:, None] & ~is_level
    z_m = np.where(is_given, segments.height_m, z_m)  # off the maps, too
    lacks = np.where(follows_ground[:, None] & np.isnan(ground_m), "ground", segments.datum)
    if geoid_m is not None:
        lacks[lacks == "ellipsoid"] = "geoid"  # which is what lacks a height then
    return z_m, lacks


def _without_height(
    mission: Mission, segments: Segments, along_m: np.ndarray, z_m: np.ndarray, lacks: np.ndarray
) -> Iterator[pd.DataFrame]:
    """Yield the spans of segments without a height over the ground, by the reason.

    The first of a segment's ends that has none counts.

    Args:
      mission: what is flown.
      segments: of the mission.
      along_m: ``[S, 2]`` metres flown at begin and end of each.
      z_m, lacks: their heights and what they lack, from `_heights_m`.
    """
    is_known = np.isfinite(z_m).all(axis=1)
    is_open = np.zeros(len(z_m), bool)
    for number in np.flatnonzero(~is_known):
        is_open[number] = any(map(_is_open, segments.place[number]))

    # Returns from a known height: a return altitude answers for these alone.
    legs = mission.legs
    returns = {leg.item for leg in legs if leg.kind == "return" and not _is_open(leg.start)}
    answers = is_open & np.array([leg.item in returns for leg in legs], bool)[segments.leg]
    yield spans(along_m[answers], "height", NO_RETURN)
    yield spans(along_m[is_open & ~answers], "height", NO_HEIGHT)

    first_lacks = np.where(np.isnan(z_m[:, 0]), lacks[:, 0], lacks[:, 1])
    for datum, reason in NO_ZERO.items():
        is_without = ~is_known & ~is_open & (first_lacks == datum)
        yield spans(along_m[is_without], "height", reason)


def _outside(along_m: np.ndarray, shares: np.ndarray, enters: np.ndarray) -> Iterator[pd.DataFrame]:
    """Yield the spans outside the maps: of a segment before it enters them, and after it leaves them.

    A segment that does not meet them enters and leaves them at one place.

    Args:
      along_m: ``[S, 2]`` metres flown at begin and end of each segment.
      shares: ``[S, 2]`` of the way, from `_shares_within`.
      enters: ``[S]`` whether each meets the maps.
    """
    enter_m, leave_m = between(along_m, shares).T
    before_m = np.column_stack([along_m[:, 0], enter_m])
    after_m = np.column_stack([leave_m, along_m[:, 1]])
    for outside_m in (before_m, after_m):
        is_stretch = (outside_m[:, 0] < outside_m[:, 1]) | ~enters
        yield spans(outside_m[is_stretch], "outside", OUTSIDE)


def _along_m(
    segments: Segments, ends_m: np.ndarray, z_m: np.ndarray, is_inside: np.ndarray
) -> np.ndarray:
    """Return ``[S, 2]`` metres flown since take-off at begin and end of each segment.

    Segments within the maps are measured in their CRS, as plans are, others on the ellipsoid. A segment with an end
    whose height is not known is taken to be level. Variants begin where the next segment that is none does, or where
    the variant before them ends, if they go on from there; what follows does not count them.

    Args:
      segments: of the mission.
      ends_m: ``[S, 2, 2]`` x, y of begin and end of each.
      z_m: ``[S, 2]`` their heights above one zero; NaN where they are not known.
      is_inside: ``[S]`` whether each lies within the maps.
    """
    lonlat = segments.lonlat
    _, _, over_m = GEOD.inv(*lonlat[:, 0].T, *lonlat[:, 1].T)
    over_m = np.where(is_inside, np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=1), over_m)
    length_m = np.hypot(over_m, np.nan_to_num(z_m[:, 1] - z_m[:, 0]))
    flown_m = np.where(segments.is_variant, 0.0, length_m)
    begin_m = np.cumsum(flown_m) - flown_m
    goes_on = (lonlat[1:, 0] == lonlat[:-1, 1]).all(axis=1)
    goes_on &= segments.is_variant[1:] & segments.is_variant[:-1]
    for number in np.flatnonzero(goes_on):
        begin_m[number + 1] = begin_m[number] + length_m[number]
    return np.stack([begin_m, begin_m + length_m], axis=1)


def _corners_of(leg: Leg) -> list[Place]:
    """Return the places that a leg runs through: its ends, and the corners of a loiter's circle between them.

    A circle is drawn once around the end of the leg, at the height of the end, by chords that leave it by no more than
    about `CIRCLE_SAG_M`. It begins and ends at the start, where that lies on it.
    """
    if not leg.radius_m:
        return [leg.start, leg.end]
    # A chord of an angle a leaves a circle by radius x a² / 8 at most, and a is 2 pi / n of n chords.
    radius_m = abs(leg.radius_m)
    num_chords = math.pi * math.sqrt(radius_m / (2 * CIRCLE_SAG_M))
    first_deg, _, _ = GEOD.inv(leg.end.lon, leg.end.lat, leg.start.lon, leg.start.lat)
    azimuths = first_deg + np.linspace(
        0.0, 360.0, int(np.clip(num_chords, FEWEST_CHORDS, MOST_CHORDS))
    )
    lons, lats = circle_around(leg.end.lon, leg.end.lat, radius_m, azimuths)
    circle = [leg.end._replace(lon=lon, lat=lat) for lon, lat in zip(lons, lats, strict=True)]
    is_on_circle = leg.start[:2] != leg.end[:2]
    return [leg.start, *circle, leg.start] if is_on_circle else circle


def _zeros_m(mission: Mission, ground: Elevation, geoid_m: float | None) -> dict[str, float]:
    """Return the elevation of the zero of each datum, measured as the maps' ground is; NaN where it is not known.

    Home may be on a roof. Over terrain elevations are above the geoid. Without terrain they are above the level ground.

    Args:
      mission: whose home has a place, an elevation above the geoid, both or neither.
      ground: of the maps.
      geoid_m: height of the geoid above the ellipsoid; None where it is not given.
    """
    home_m = ground_above_geoid_m = math.nan  # of the ground at home
    if mission.home_elevation_m is not None:
        ground_above_geoid_m = mission.home_elevation_m - mission.home_above_ground_m
    if mission.home is not None:
        home_m = ground.at_lonlat(*mission.home)
        if math.isnan(home_m):  # home lies outside the maps
            home_m = ground_above_geoid_m
    geoid_zero_m = -ground_above_geoid_m if ground.is_flat else 0.0
    ellipsoid_zero_m = math.nan if geoid_m is None else geoid_zero_m - geoid_m
    return {
        "home": home_m + mission.home_above_ground_m,
        "geoid": geoid_zero_m,
        "ellipsoid": ellipsoid_zero_m,
    }


def _elevation_m(place: Place, ground: Elevation, zeros_m: dict[str, float]) -> float:
    """Return the elevation of a place, NaN where it is not known.

    Args:
      place: that may be level with another one.
      ground: of the maps.
      zeros_m: elevation of the zero of each datum but the ground.
    """
    zero_m = zeros_m.get(place.datum, ground.at_lonlat(place.lon, place.lat))
    other = place.level_with
    if other is None:
        return place.height_m + zero_m
    other_m = _elevation_m(other, ground, zeros_m)
    if place.datum == "ground":
        other_m += zero_m - ground.at_lonlat(other.lon, other.lat)
    return other_m if math.isnan(place.height_m) else np.maximum(place.height_m + zero_m, other_m)


def _is_open(place: Place) -> bool:
    """Return whether a file leaves the height of a place open: its own, or that of the place that it is level with."""
    return _is_open(place.level_with) if place.level_with else math.isnan(place.height_m)


def _shares_within(ends_m: np.ndarray, bounds_m: Bounds) -> np.ndarray:
    """Return ``[S, 2]`` the shares of straight lines at which they enter and leave a box.

    Both are from 0, the begin of the line, to 1, its end. They are equal where the line does not meet the box.

    Args:
      ends_m: ``[S, 2, 2]`` x, y of begin and end of each line.
      bounds_m: least x and y, greatest x and y of the box.
    """
    low_m, high_m = np.reshape(bounds_m, (2, 2))
    begin_m = ends_m[:, 0]
    moved_m = ends_m[:, 1] - ends_m[:, 0]
    # Along an axis on which it does not move, a line stays beside the box or within it: its shares there are huge.
    moved_m[moved_m == 0] = 1e-9
    # Of each axis the share at which the line comes within the box's two sides, and that at which it leaves them.
    enter, leave = np.sort([(low_m - begin_m) / moved_m, (high_m - begin_m) / moved_m], axis=0)
    first, last = np.clip([enter.max(axis=1), leave.min(axis=1)], 0.0, 1.0)
    return np.stack([np.minimum(first, last), last], axis=1)
