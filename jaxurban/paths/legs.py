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
        line_m = np.vstack([ends_m[:, 0], ends_m[-1:, 1]])
        return line_m[np.isfinite(line_m).all(axis=1)]


def spans(along_m: np.ndarray, reason: str) -> pd.DataFrame:
    """Return begins and ends along a mission ``[N, 2]`` as a table, with a reason."""
    return pd.DataFrame({"reason": reason, "from_m": along_m[:, 0], "to_m": along_m[:, 1]})


def ground_at(places_m: np.ndarray, maps: MetricMaps) -> np.ndarray:
    """Return the elevation ``[...]`` of the ground at places ``[..., 2]``: NaN outside the maps, 0 if they are flat."""
    if "terrain" not in maps.ds:
        return np.zeros(places_m.shape[:-1])
    grid = maps.grid
    from_corner_m = places_m - grid.bounds_m[:2]
    side_m = np.array(grid.shape[::-1]) * grid.resolution_m
    is_in = ((from_corner_m >= 0) & (from_corner_m <= side_m)).all(axis=-1)
    elevation_m = np.full(is_in.shape, np.nan)
    x_m, y_m = from_corner_m[is_in].T
    elevation_m[is_in] = elevation_at(x_m, y_m, maps.m("terrain"), grid.resolution_m)
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
            corners = _corners_of(leg)
            legs += [number] * (len(corners) - 1)
            ends += [place for pair in pairwise(corners) for place in pair]
        table = pd.DataFrame(ends, columns=list(Place._fields))
        lonlat = table[["lon", "lat"]].to_numpy(float).reshape(-1, 2, 2)
        height_m = table["height_m"].to_numpy(float).reshape(-1, 2)
        return cls(np.array(legs, int), lonlat, height_m, table["datum"].to_numpy().reshape(-1, 2))


def flight_of(mission: Mission, maps: MetricMaps, geoid_m: float | None = None) -> Flight:
    """Return a mission over maps, its heights brought to the ground.

    Args:
      mission: what is flown.
      maps: whose ``terrain`` is the ground; its zero is taken for the geoid. Without it the ground is level.
      geoid_m: height of the geoid above the ellipsoid, for heights above the latter.

    Raises:
      InputError: a mission that is too long over the maps.
    """
    segments = Segments.of(mission)
    lon, lat = np.moveaxis(segments.lonlat, -1, 0)
    ends_m = np.stack(maps.grid.xy_of_lonlat(lon, lat), axis=-1)
    ends_m = np.nan_to_num(ends_m, posinf=NOWHERE_M)
    is_ground = segments.datum == "ground"
    follows = is_ground.all(axis=1)
    base_m = np.where(is_ground, ground_at(ends_m, maps), np.nan)
    for name, zero_m in _zeros_m(mission, maps, geoid_m).items():
        base_m[segments.datum == name] = zero_m
    base_m[follows] = 0.0
    z_m = segments.height_m + base_m
    along_m = _along_m(segments.lonlat, z_m)
    shares = _shares_within(ends_m, maps.grid.bounds_m)
    is_in = shares[:, 0] < shares[:, 1]
    is_known = np.isfinite(z_m).all(axis=1)
    unknown = [spans(along_m[:0], "")]
    for number in np.flatnonzero(~is_known):
        ends = segments.height_m[number], base_m[number], segments.datum[number]
        unknown.append(spans(along_m[[number]], _why_unknown(*ends, geoid_m)))
    enter_m, leave_m = np.where(is_in[:, None], between(along_m, shares), along_m[:, 1:]).T
    before_m = np.column_stack([along_m[:, 0], enter_m])
    after_m = np.column_stack([leave_m, along_m[:, 1]])
    for outside_m in (before_m, after_m):
        is_long = (outside_m[:, 0] < outside_m[:, 1]) | ~is_in
        unknown.append(spans(outside_m[is_long], OUTSIDE))
    flown = np.flatnonzero(is_in & is_known)
    states = np.dstack([ends_m, z_m, along_m])[flown]
    steps = _steps(states, shares[flown], segments.leg[flown], follows[flown], maps)
    return Flight(mission, steps, pd.concat(unknown), float(along_m.max(initial=0.0)))


def _along_m(lonlat: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """Return ``[S, 2]`` metres flown at begin and end of segments, which are level where a height is not known.

    Args:
      lonlat: ``[S, 2, 2]`` longitude, latitude of their ends in degrees.
      z_m: ``[S, 2]`` their heights above one zero; NaN where they are not known.
    """
    _, _, over_m = GEOD.inv(*lonlat[:, 0].T, *lonlat[:, 1].T)
    length_m = np.hypot(over_m, np.nan_to_num(z_m[:, 1] - z_m[:, 0]))
    end_m = np.cumsum(length_m)
    return np.stack([end_m - length_m, end_m], axis=1)


def _why_unknown(
    height_m: np.ndarray, base_m: np.ndarray, datum: np.ndarray, geoid_m: float | None
) -> str:
    """Return why a segment has no height over the ground; arguments are of its begin and end, ``[2]``."""
    if np.isnan(height_m).any():
        return NO_HEIGHT
    open_datum = datum[np.argmax(np.isnan(base_m))]
    if open_datum == "ellipsoid" and geoid_m is not None:
        open_datum = "geoid"  # which is what lacks a height then
    return NO_ZERO[open_datum]


def _steps(
    states: np.ndarray, shares: np.ndarray, leg: np.ndarray, follows: np.ndarray, maps: MetricMaps
) -> Steps:
    """Return the steps of segments, as far as the maps hold them.

    Args:
      states: ``[S, 2, 4]`` x, y, height and metres flown at begin and end.
      shares: ``[S, 2]`` from which share to which the maps hold a segment.
      leg: ``[S]`` its leg.
      follows: ``[S]`` its height is above the ground, else above the zero of the terrain.
      maps: the maps.
    """
    grid = maps.grid
    share = shares[:, 1] - shares[:, 0]
    inside_m = share * (states[:, 1, 3] - states[:, 0, 3])
    total_m = float(inside_m.sum())
    step_m = max(STEP_M, total_m / MOST_STEPS)
    if step_m > MOST_STEP_M:
        raise InputError(
            f"mission flies {total_m / 1000:,.0f} km over the maps, too far to be looked at: split the file"
        )
    num = np.maximum(np.ceil(inside_m / step_m), 1).astype(int)
    each = np.repeat(np.arange(len(num)), num)
    number = np.arange(len(each)) - np.repeat(np.cumsum(num) - num, num)
    ends = number[:, None] + [0, 1]
    parts = shares[each, :1] + (share / num)[each, None] * ends
    x_m, y_m, height_m, along_m = np.moveaxis(between(states[each], parts), -1, 0)
    places_m = np.stack([x_m, y_m], axis=-1)
    ground_m = ground_at(places_m, maps)
    z_m = height_m - np.where(follows[each, None], 0.0, ground_m)
    middle = (places_m.mean(axis=1) - grid.bounds_m[:2]) / grid.resolution_m
    cell = np.clip(middle[:, ::-1].astype(int), 0, np.array(grid.shape) - 1)
    return Steps(places_m, z_m, ground_m, along_m, leg[each], cell)


def between(ends: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return ``[S, K, ...]`` what lies at shares ``[S, K]``, from 0 to 1, between ends ``[S, 2, ...]``."""
    share = share.reshape(*share.shape, *[1] * (ends.ndim - 2))
    return ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])


def _corners_of(leg: Leg) -> list[Place]:
    """Return the places that a leg runs through: its ends, and the corners of a loiter's circle between them."""
    if not leg.radius_m:
        return [leg.start, leg.end]
    radius_m = abs(leg.radius_m)
    wanted = math.pi * math.sqrt(radius_m / (2 * CIRCLE_SAG_M))
    azimuths = np.linspace(0.0, 360.0, int(np.clip(wanted, FEWEST_CHORDS, MOST_CHORDS)))
    lons, lats, radii_m = np.full((len(azimuths), 3), [leg.end.lon, leg.end.lat, radius_m]).T
    lon, lat, _ = GEOD.fwd(lons, lats, azimuths, radii_m)
    circle = [leg.end._replace(lon=x, lat=y) for x, y in zip(lon, lat, strict=True)]
    return [leg.start, *circle, leg.end]


def _zeros_m(mission: Mission, maps: MetricMaps, geoid_m: float | None) -> dict[str, float]:
    """Return the elevation of the zero of each datum in that of the ground, NaN where it is not known."""
    home_m = above_geoid_m = math.nan
    if mission.home_elevation_m is not None:
        above_geoid_m = mission.home_elevation_m
    if mission.home is not None:
        home_xy_m = np.array(maps.grid.xy_of_lonlat(*mission.home))
        home_m = float(ground_at(home_xy_m, maps))
        if math.isnan(home_m):
            home_m = above_geoid_m
    geoid_zero_m = 0.0 if "terrain" in maps.ds else -above_geoid_m
    ellipsoid_m = math.nan if geoid_m is None else geoid_zero_m - geoid_m
    return {"home": home_m, "geoid": geoid_zero_m, "ellipsoid": ellipsoid_m}


def _shares_within(ends_m: np.ndarray, bounds_m: Bounds) -> np.ndarray:
    """Return ``[S, 2]`` from which share to which a box holds lines ``[S, 2, 2]``; twice the same where nothing."""
    low_m, high_m = np.reshape(bounds_m, (2, 2))
    begin_m = ends_m[:, 0]
    moved_m = ends_m[:, 1] - ends_m[:, 0]
    moved_m[moved_m == 0] = 1e-9  # it stays beside the box, or within its sides
    cuts = np.sort([(low_m - begin_m) / moved_m, (high_m - begin_m) / moved_m], axis=0)
    first, last = np.clip([cuts[0].max(axis=1), cuts[1].min(axis=1)], 0.0, 1.0)
    return np.stack([np.minimum(first, last), last], axis=1)
