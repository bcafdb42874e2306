"""The legs of a mission over maps: short steps with heights above the ground, and what of them is not known.

Between the ends of a leg the vehicle flies straight, or follows the ground where both ends are above the ground.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyproj

from jaxurban.errors import InputError
from jaxurban.io.read.mission import Leg, Mission, Place
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.ground import elevation_at
from jaxurban.world.grid import Bounds

STEP_M, MOST_STEPS = 0.5, 1_000_000  # steps of very long missions are longer,
MOST_STEP_M = 5.0  # and no longer than this
NOWHERE_M = 1e12  # x and y where the projection has no value
CIRCLE_SAG_M = 0.05  # by which the chords of a loiter leave its circle
FEWEST_CHORDS, MOST_CHORDS = 16, 720
GEOD = pyproj.Geod(ellps="WGS84")

OUTSIDE = "lie outside the maps"
NO_HEIGHT = "have a height that the file leaves open: name that of a return (return_altitude_m, --return-altitude)"
NO_ZERO = {  # where the zero of a datum is not known
    "home": "have heights above home, whose place or elevation is not known: name it (home, --home)",
    "geoid": "have heights above the geoid, and neither the maps nor the file say how high the ground is above it",
    "ellipsoid": "have heights above the ellipsoid: name the geoid's height above it (geoid_m, --geoid; 37 m in Tokyo)",
    "ground": "begin or end above ground that the maps do not hold",
}


class Steps(NamedTuple):
    """Short straight parts of legs over the maps, in order of travel. ``P`` of them.

    Attributes:
      ends_m: ``[P, 2, 2]`` x, y of begin and end in the maps' CRS.
      z_m: ``[P, 2]`` height above the ground; NaN where the ground is not known.
      ground_m: ``[P, 2]`` elevation of the ground; 0 over maps without terrain.
      along_m: ``[P, 2]`` metres flown.
      leg: ``[P]`` number of the leg, from 0.
      cell: ``[P, 2]`` row and column of the middle.
    """

    ends_m: np.ndarray
    z_m: np.ndarray
    ground_m: np.ndarray
    along_m: np.ndarray
    leg: np.ndarray
    cell: np.ndarray

    def take(self, chosen: np.ndarray) -> "Steps":
        """Return some of the steps."""
        return Steps(*(values[chosen] for values in self))

    @property
    def over_m(self) -> np.ndarray:
        """``[P]`` length on the ground."""
        return np.linalg.norm(self.ends_m[:, 1] - self.ends_m[:, 0], axis=1)

    @property
    def length_m(self) -> np.ndarray:
        """``[P]`` length in the air."""
        return self.along_m[:, 1] - self.along_m[:, 0]


@dataclass(frozen=True, eq=False)
class Flight:
    """A mission over maps.

    Attributes:
      mission: the mission.
      steps: what of it has a height and lies within the maps.
      unknown: what has none or lies outside: its ``reason``, ``from_m`` and ``to_m`` along the mission.
      length_m: of the whole mission, in the air.
    """

    mission: Mission
    steps: Steps
    unknown: pd.DataFrame
    length_m: float

    @property
    def line_m(self) -> np.ndarray:
        """``[N, 3]`` x, y and height above ground where it flies over the maps; gaps are closed by straight lines."""
        ends_m = np.dstack([self.steps.ends_m, self.steps.z_m])
        line_m = np.vstack([ends_m[:, 0], ends_m[-1:, 1]])  # each begin, and the last end
        return line_m[np.isfinite(line_m).all(axis=1)]


def spans(along_m: np.ndarray, reason: str) -> pd.DataFrame:
    """Return begins and ends along a mission ``[N, 2]`` as a table, with a reason."""
    return pd.DataFrame({"reason": reason, "from_m": along_m[:, 0], "to_m": along_m[:, 1]})


def ground_at(places_m: np.ndarray, maps: MetricMaps) -> np.ndarray:
    """Return the elevation of the ground at places, metres above the terrain's zero.

    Args:
      places_m: ``[..., 2]`` x, y in the maps' CRS.
      maps: whose ``terrain`` is the ground.

    Returns:
      ``[...]``: NaN outside the maps, 0 everywhere if they hold no terrain.
    """
    if "terrain" not in maps.ds:
        return np.zeros(places_m.shape[:-1])
    grid = maps.grid
    from_corner_m = places_m - grid.bounds_m[:2]
    sides_m = np.array(grid.shape[::-1]) * grid.resolution_m  # along x, y
    is_inside = ((from_corner_m >= 0) & (from_corner_m <= sides_m)).all(axis=-1)
    elevation_m = np.full(is_inside.shape, np.nan)
    x_m, y_m = from_corner_m[is_inside].T
    elevation_m[is_inside] = elevation_at(x_m, y_m, maps.m("terrain"), grid.resolution_m)
    return elevation_m


class Segments(NamedTuple):
    """The straight segments of a mission, the chords of its loiters too. ``S`` of them, each with begin and end.

    Attributes:
      leg: ``[S]`` number of the leg, from 0.
      lonlat: ``[S, 2, 2]`` longitude, latitude in degrees.
      height_m: ``[S, 2]`` above the zero of its datum; NaN where the file leaves it open.
      datum: ``[S, 2]`` what the height is above.
    """

    leg: np.ndarray
    lonlat: np.ndarray
    height_m: np.ndarray
    datum: np.ndarray

    @classmethod
    def of(cls, mission: Mission) -> "Segments":
        """Return the segments of a mission, in the order of travel."""
        legs, ends = [], []
        for number, leg in enumerate(mission.legs):
            for start, end in pairwise(_corners_of(leg)):
                legs.append(number)
                ends += [start, end]
        table = pd.DataFrame(ends, columns=list(Place._fields))
        return cls(
            leg=np.array(legs, int),
            lonlat=table[["lon", "lat"]].to_numpy(float).reshape(-1, 2, 2),
            height_m=table["height_m"].to_numpy(float).reshape(-1, 2),
            datum=table["datum"].to_numpy().reshape(-1, 2),
        )


def flight_of(mission: Mission, maps: MetricMaps, geoid_m: float | None = None) -> Flight:
    """Return a mission over maps, its heights brought to the ground.

    Args:
      mission: what is flown.
      maps: whose ``terrain`` is the ground; its zero is taken for the geoid. Without it the ground is level.
      geoid_m: height of the geoid above the ellipsoid, for heights above the latter.

    Raises:
      InputError: a mission that is too long over the maps.
    """
    # Where the segments of the mission begin and end.
    segments = Segments.of(mission)
    lon, lat = np.moveaxis(segments.lonlat, -1, 0)
    ends_m = np.stack(maps.grid.xy_of_lonlat(lon, lat), axis=-1)
    ends_m = np.nan_to_num(ends_m, posinf=NOWHERE_M)

    # Their heights: above the zero of the terrain, or above the ground for segments that follow it.
    is_ground = segments.datum == "ground"
    follows_ground = is_ground.all(axis=1)
    datum_m = np.where(is_ground, ground_at(ends_m, maps), np.nan)  # elevation of each datum
    for name, zero_m in _zeros_m(mission, maps, geoid_m).items():
        datum_m[segments.datum == name] = zero_m
    datum_m[follows_ground] = 0.0
    z_m = segments.height_m + datum_m
    along_m = _along_m(segments.lonlat, z_m)

    # Segments without a height over the ground, each with the reason.
    is_known = np.isfinite(z_m).all(axis=1)
    unknown = [spans(along_m[:0], "")]  # a table without rows, where nothing else is
    for number in np.flatnonzero(~is_known):
        reason = _why_unknown(
            segments.height_m[number], datum_m[number], segments.datum[number], geoid_m
        )
        unknown.append(spans(along_m[[number]], reason))

    # What lies outside the maps: of a segment what comes before it enters them and after it leaves them. A segment that
    # does not meet them is taken to enter and leave them at its end, so that all of it comes before.
    shares = _shares_within(ends_m, maps.grid.bounds_m)
    enters = shares[:, 0] < shares[:, 1]
    enter_m, leave_m = np.where(enters[:, None], between(along_m, shares), along_m[:, 1:]).T
    before_m = np.column_stack([along_m[:, 0], enter_m])
    after_m = np.column_stack([leave_m, along_m[:, 1]])
    for outside_m in (before_m, after_m):
        is_stretch = (outside_m[:, 0] < outside_m[:, 1]) | ~enters
        unknown.append(spans(outside_m[is_stretch], OUTSIDE))

    # The rest, cut into steps.
    flown = np.flatnonzero(enters & is_known)
    states = np.dstack([ends_m, z_m, along_m])[flown]
    steps = _steps(states, shares[flown], segments.leg[flown], follows_ground[flown], maps)
    return Flight(mission, steps, pd.concat(unknown), float(along_m.max(initial=0.0)))


def _along_m(lonlat: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """Return ``[S, 2]`` metres flown since take-off at begin and end of each segment.

    A segment with an end whose height is not known is taken to be level.

    Args:
      lonlat: ``[S, 2, 2]`` longitude, latitude of their ends in degrees.
      z_m: ``[S, 2]`` their heights above one zero; NaN where they are not known.
    """
    _, _, over_m = GEOD.inv(*lonlat[:, 0].T, *lonlat[:, 1].T)
    length_m = np.hypot(over_m, np.nan_to_num(z_m[:, 1] - z_m[:, 0]))
    end_m = np.cumsum(length_m)
    return np.stack([end_m - length_m, end_m], axis=1)


def _why_unknown(
    height_m: np.ndarray, datum_m: np.ndarray, datum: np.ndarray, geoid_m: float | None
) -> str:
    """Return why a segment has no height over the ground, a phrase that goes after "legs".

    Args:
      height_m: ``[2]`` at its begin and end, above the datum; NaN where the file leaves it open.
      datum_m: ``[2]`` elevation of the datum; NaN where it is not known.
      datum: ``[2]`` name of the datum.
      geoid_m: height of the geoid above the ellipsoid; None where it is not given.
    """
    if np.isnan(height_m).any():
        return NO_HEIGHT
    unknown_datum = datum[np.argmax(np.isnan(datum_m))]
    if unknown_datum == "ellipsoid" and geoid_m is not None:
        unknown_datum = "geoid"  # which is what lacks a height then
    return NO_ZERO[unknown_datum]


def _steps(
    states: np.ndarray,
    shares: np.ndarray,
    leg: np.ndarray,
    follows_ground: np.ndarray,
    maps: MetricMaps,
) -> Steps:
    """Return the steps of ``S`` segments, as far as the maps hold them.

    Args:
      states: ``[S, 2, 4]`` x, y, height and metres flown at begin and end.
      shares: ``[S, 2]`` of a segment's length, from 0 to 1, at which it enters and leaves the maps.
      leg: ``[S]`` number of its leg.
      follows_ground: ``[S]`` whether its heights are above the ground, or else above the zero of the terrain.
      maps: the maps.

    Raises:
      InputError: more than `MOST_STEPS` steps of `MOST_STEP_M`.
    """
    # How long a step is, and how many a segment has.
    grid = maps.grid
    share = shares[:, 1] - shares[:, 0]
    begin_m, end_m = states[:, :, 3].T
    inside_m = share * (end_m - begin_m)
    total_m = inside_m.sum()
    step_m = max(STEP_M, total_m / MOST_STEPS)
    if step_m > MOST_STEP_M:
        raise InputError(
            f"mission flies {total_m / 1000:,.0f} km over the maps, too far to be looked at: split the file"
        )
    num_steps = np.maximum(np.ceil(inside_m / step_m), 1).astype(int)

    # The segment of each step, its number within the segment, and the shares at which it begins and ends.
    segment = np.repeat(np.arange(len(num_steps)), num_steps)
    first_step = np.cumsum(num_steps) - num_steps
    number = np.arange(len(segment)) - first_step[segment]
    ends = number[:, None] + [0, 1]
    step_shares = shares[segment, :1] + (share / num_steps)[segment, None] * ends

    # Place, height over the ground and cell of each step.
    step_states = between(states[segment], step_shares)
    places_m = step_states[..., :2]
    height_m, along_m = np.moveaxis(step_states[..., 2:], -1, 0)
    ground_m = ground_at(places_m, maps)
    z_m = height_m - np.where(follows_ground[segment, None], 0.0, ground_m)
    middle = (places_m.mean(axis=1) - grid.bounds_m[:2]) / grid.resolution_m
    cell = np.clip(middle[:, ::-1].astype(int), 0, np.array(grid.shape) - 1)
    return Steps(places_m, z_m, ground_m, along_m, leg[segment], cell)


def between(ends: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return ``[S, K, ...]`` values on the straight line between ends ``[S, 2, ...]``, at shares ``[S, K]`` of it.

    A share of 0 is the first end, 1 the second.
    """
    share = share.reshape(*share.shape, *[1] * (ends.ndim - 2))
    return ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])


def _corners_of(leg: Leg) -> list[Place]:
    """Return the places that a leg runs through: its ends, and the corners of a loiter's circle between them.

    A circle is drawn once around the end of the leg, at the height of the end, by chords that leave it by no more than
    about `CIRCLE_SAG_M`.
    """
    if not leg.radius_m:
        return [leg.start, leg.end]
    # A chord of an angle a leaves a circle by radius x a² / 8 at most, and a is 2 pi / n of n chords.
    radius_m = abs(leg.radius_m)
    num_chords = math.pi * math.sqrt(radius_m / (2 * CIRCLE_SAG_M))
    azimuths = np.linspace(0.0, 360.0, int(np.clip(num_chords, FEWEST_CHORDS, MOST_CHORDS)))
    lons, lats, radii_m = np.full((len(azimuths), 3), [leg.end.lon, leg.end.lat, radius_m]).T
    lons, lats, _ = GEOD.fwd(lons, lats, azimuths, radii_m)
    circle = [leg.end._replace(lon=lon, lat=lat) for lon, lat in zip(lons, lats, strict=True)]
    return [leg.start, *circle, leg.end]


def _zeros_m(mission: Mission, maps: MetricMaps, geoid_m: float | None) -> dict[str, float]:
    """Return the elevation of the zero of each datum, measured as the maps' ground is; NaN where it is not known.

    Over terrain elevations are above the geoid. Without terrain they are above the level ground, which home stands on.

    Args:
      mission: whose home has a place, an elevation above the geoid, both or neither.
      maps: the maps.
      geoid_m: height of the geoid above the ellipsoid; None where it is not given.
    """
    home_m = home_above_geoid_m = math.nan
    if mission.home_elevation_m is not None:
        home_above_geoid_m = mission.home_elevation_m
    if mission.home is not None:
        home_xy_m = np.array(maps.grid.xy_of_lonlat(*mission.home))
        home_m = float(ground_at(home_xy_m, maps))
        if math.isnan(home_m):  # home lies outside the maps
            home_m = home_above_geoid_m
    geoid_zero_m = 0.0 if "terrain" in maps.ds else -home_above_geoid_m
    ellipsoid_zero_m = math.nan if geoid_m is None else geoid_zero_m - geoid_m
    return {"home": home_m, "geoid": geoid_zero_m, "ellipsoid": ellipsoid_zero_m}


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
