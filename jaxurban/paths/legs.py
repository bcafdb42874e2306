"""The legs of a mission over maps: cut at the borders of cells, with heights above the ground, and what is not known.

Between the ends of a leg the vehicle flies straight, or follows the ground where both ends are above the ground. The
ground is bilinear between the centres of cells, and taken for straight within a quarter of a cell.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyproj
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.mission import Leg, Mission, Place
from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.path import elevation_at
from jaxurban.world.grid import Bounds, Grid

PARTS_A_SIDE = 4  # of a cell, over terrain
MOST_PIECES = 5_000_000
CIRCLE_SAG_M = 0.05  # by which the chords of a loiter leave its circle
FEWEST_CHORDS, MOST_CHORDS = 16, 720
HOVER_M = 1e-3  # climbed where a leg has no length, so that its place counts
GEOD = pyproj.Geod(ellps="WGS84")

OUTSIDE, NO_DATA = "lie outside the maps", "lie over cells without data"
NO_HEIGHT = (
    "have no height in the file: name the altitude of return (return_altitude_m, --return-altitude)"
)
NO_GROUND = "begin or end above ground that the maps do not hold"
NO_HOME = "have heights above home, which is not known: name it (home, --home)"
FAR_HOME = (
    "have heights above home, which the maps do not hold and whose elevation is not in the file"
)
NO_GEOID = (
    "have heights above the geoid, and neither terrain nor the elevation of home says how high the ground is: make "
    "maps with terrain"
)
NO_UNDULATION = "have heights above the ellipsoid: name the geoid's height above it (geoid_m, --geoid; 37 m in Tokyo)"


class Pieces(NamedTuple):
    """Straight parts of legs, each within one cell of the maps, in order of travel. ``P`` of them.

    Attributes:
      ends_m: ``[P, 2, 2]`` x, y of begin and end in the maps' CRS.
      z_m: ``[P, 2]`` height above the ground; NaN where the ground is not known.
      ground_m: ``[P, 2]`` elevation of the ground; 0 over maps without terrain.
      along_m: ``[P, 2]`` metres flown.
      leg: ``[P]`` number of the leg, from 0.
      row, col: ``[P]`` cell.
    """

    ends_m: np.ndarray
    z_m: np.ndarray
    ground_m: np.ndarray
    along_m: np.ndarray
    leg: np.ndarray
    row: np.ndarray
    col: np.ndarray

    def take(self, chosen: np.ndarray) -> "Pieces":
        """Return some of the pieces, by their numbers or a mask."""
        return Pieces(*(values[chosen] for values in self))

    @property
    def over_m(self) -> np.ndarray:
        """``[P]`` length on the ground."""
        return np.linalg.norm(self.ends_m[:, 1] - self.ends_m[:, 0], axis=1)

    @property
    def length_m(self) -> np.ndarray:
        """``[P]`` length in the air."""
        return self.along_m[:, 1] - self.along_m[:, 0]

    @property
    def middle_z_m(self) -> np.ndarray:
        """``[P]`` height of the middle above the ground."""
        return self.z_m.mean(axis=1)

    def cut_at(self, heights_m: Sequence[float]) -> "Pieces":
        """Return the pieces cut where they pass some heights above the ground."""
        with np.errstate(all="ignore"):
            rise_m = self.z_m[:, 1:] - self.z_m[:, :1]
            shares = (np.asarray(heights_m, float) - self.z_m[:, :1]) / rise_m
        shares = np.sort(np.where((shares > 0) & (shares < 1), shares, 1.0), axis=1)
        edges = np.pad(shares, [(0, 0), (1, 1)], constant_values=((0, 0), (0.0, 1.0)))
        piece, part = np.nonzero(edges[:, 1:] > edges[:, :-1])
        first, last = edges[piece, part], edges[piece, part + 1]
        ends = (
            np.stack([between(values[piece], first), between(values[piece], last)], axis=1)
            for values in self[:4]
        )
        return Pieces(*ends, *(values[piece] for values in self[4:]))


@dataclass(frozen=True, eq=False)
class Flight:
    """A mission over maps. ``S`` straight segments.

    Attributes:
      mission: the mission.
      pieces: what of it has a height and lies within the maps.
      unknown: what has none or lies outside: its ``reason``, ``from_m`` and ``to_m`` along the mission.
      length_m: of the whole mission, in the air.
      lonlat: ``[S, 2, 2]`` longitude, latitude of begin and end of each segment.
      leg: ``[S]`` the number of its leg.
    """

    mission: Mission
    pieces: Pieces
    unknown: pd.DataFrame
    length_m: float
    lonlat: np.ndarray
    leg: np.ndarray


def spans(along_m: np.ndarray, reason: str | np.ndarray) -> pd.DataFrame:
    """Return begins and ends along a mission ``[N, 2]`` as a table, with a reason or one for each."""
    return pd.DataFrame({"reason": reason, "from_m": along_m[:, 0], "to_m": along_m[:, 1]})


def lines_of(ends_m: np.ndarray) -> np.ndarray:
    """Return ``[P]`` lines between ends ``[P, 2, 2]``; a micrometre long where both are one place."""
    ends_m = ends_m.copy()
    ends_m[:, 1, 0] += 1e-6 * (ends_m[:, 0] == ends_m[:, 1]).all(axis=1)
    return shapely.linestrings(ends_m)


def between(ends: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return ``[P, ...]`` what lies at a share, from 0 to 1, between ends ``[P, 2, ...]``."""
    share = share.reshape(-1, *[1] * (ends.ndim - 2))
    return ends[:, 0] + share * (ends[:, 1] - ends[:, 0])


def flight_of(mission: Mission, maps: MetricMaps, geoid_m: float | None = None) -> Flight:
    """Return a mission over maps, its heights brought to the ground.

    Args:
      mission: what is flown.
      maps: whose ``terrain`` is the ground; its zero is taken for the geoid. Without it the ground is level.
      geoid_m: height of the geoid above the ellipsoid, for heights above the latter.

    Raises:
      InputError: a mission that crosses more cells than can be looked at.
    """
    segments = [segment for each in enumerate(mission.legs) for segment in _segments_of(*each)]
    leg = np.array([number for number, *_ in segments], int)
    places = [place for _, *ends in segments for place in ends]
    lonlat = np.array([place[:2] for place in places], float).reshape(-1, 2, 2)
    height_m = np.array([place.height_m for place in places], float).reshape(-1, 2)

    grid, ground = maps.grid, _Ground.of(maps)
    ends_m = np.stack(grid.xy_of_lonlat(lonlat[..., 0], lonlat[..., 1]), axis=-1)
    zero_m, missing = _zeros(mission, ground, geoid_m)
    base_m = np.array([zero_m.get(place.datum, 0.0) for place in places]).reshape(-1, 2)
    is_ground = np.array([place.datum == "ground" for place in places], bool).reshape(-1, 2)
    base_m[is_ground] = ground.at(ends_m)[is_ground]
    follows: np.ndarray = np.logical_and(*is_ground.T)
    z_m = height_m + np.where(follows[:, None], 0.0, base_m)

    over_m = GEOD.inv(*lonlat[:, 0].T, *lonlat[:, 1].T)[2] if len(leg) else np.zeros(0)
    length_m = np.hypot(np.nan_to_num(over_m), np.nan_to_num(z_m[:, 1] - z_m[:, 0]))
    end_m = np.cumsum(length_m)
    along_m = np.stack([end_m - length_m, end_m], axis=1)

    reasons = [missing.get(place.datum, "") for place in places]
    reason = np.array([a or b for a, b in zip(reasons[::2], reasons[1::2], strict=True)], object)
    reason[np.isnan(height_m).any(axis=1)] = NO_HEIGHT
    shares = _shares_within(ends_m, grid.bounds_m)
    reason[(reason == "") & np.isnan(z_m).any(axis=1)] = NO_GROUND
    is_in, is_known = shares[:, 0] <= shares[:, 1], reason == ""
    inside = np.where(is_in[:, None], shares, 1.0)
    cuts_m = [along_m[:, 0], between(along_m, inside[:, 0]), between(along_m, inside[:, 1]), end_m]
    outside_m = np.concatenate([np.stack(cuts_m[:2], axis=1), np.stack(cuts_m[2:], axis=1)])
    is_out = np.diff(outside_m)[:, 0] > 0
    unknown = [
        spans(along_m[~is_known], reason[~is_known]),
        spans(outside_m[is_out], OUTSIDE),
        spans(along_m[~is_in & (length_m == 0)], OUTSIDE),
    ]
    flown = is_in & is_known
    states = np.dstack([ends_m, z_m, along_m])[flown]
    pieces = _pieces(states, shares[flown], leg[flown], follows[flown], ground)
    return Flight(
        mission,
        pieces,
        pd.concat(unknown, ignore_index=True),
        float(end_m.max(initial=0.0)),
        lonlat,
        leg,
    )


def _segments_of(number: int, leg: Leg) -> Iterator[tuple[int, Place, Place]]:
    """Yield the straight segments of a leg: itself, and the chords of the circle of a loiter round its end."""
    yield number, leg.start, leg.end
    if not leg.radius_m:
        return
    wanted = math.pi / math.sqrt(2 * CIRCLE_SAG_M / abs(leg.radius_m))
    num = int(np.clip(math.ceil(min(wanted, MOST_CHORDS)), FEWEST_CHORDS, MOST_CHORDS))
    azimuths = np.linspace(0.0, 360.0, num + 1)
    lons, lats = np.full((2, num + 1), [[leg.end.lon], [leg.end.lat]])
    lon, lat, _ = GEOD.fwd(lons, lats, azimuths, np.full(num + 1, abs(leg.radius_m)))
    circle = [
        leg.end._replace(lon=x, lat=y) for x, y in zip(lon.tolist(), lat.tolist(), strict=True)
    ]
    corners = [leg.end, *circle]
    yield from ((number, *ends) for ends in pairwise(corners))


@dataclass(frozen=True, eq=False)
class _Ground:
    """The ground of maps: its grid, and ``[Y, X]`` its elevation, None where it is level."""

    grid: Grid
    terrain_m: np.ndarray | None

    @classmethod
    def of(cls, maps: MetricMaps) -> "_Ground":
        return cls(maps.grid, maps.m("terrain") if "terrain" in maps.ds else None)

    def at(self, places_m: np.ndarray) -> np.ndarray:
        """Return ``[...]`` the elevation at places ``[..., 2]``: 0 where it is level, NaN outside."""
        if self.terrain_m is None:
            return np.zeros(places_m.shape[:-1])
        x_min_m, y_min_m, x_max_m, y_max_m = self.grid.bounds_m
        x_m, y_m = np.moveaxis(places_m, -1, 0)
        is_in = (x_min_m <= x_m) & (x_m <= x_max_m) & (y_min_m <= y_m) & (y_m <= y_max_m)
        elevation_m = np.full(x_m.shape, np.nan)
        elevation_m[is_in] = elevation_at(
            x_m[is_in] - x_min_m, y_m[is_in] - y_min_m, self.terrain_m, self.grid.resolution_m
        )
        return elevation_m


def _zeros(
    mission: Mission, ground: _Ground, geoid_m: float | None
) -> tuple[dict[str, float], dict[str, str]]:
    """Return the elevation of each datum's zero in that of the ground, NaN where it is not known, and why it is not."""
    home_m, of_home = math.nan, NO_HOME
    if mission.home is not None:
        at_m = np.stack(ground.grid.xy_of_lonlat(*mission.home), axis=-1)
        home_m, of_home = float(ground.at(at_m[None])[0]), FAR_HOME
    above_geoid_m = math.nan if mission.home_elevation_m is None else mission.home_elevation_m
    if ground.terrain_m is None:
        geoid_zero_m = -above_geoid_m
    else:
        geoid_zero_m = 0.0
        home_m = above_geoid_m if math.isnan(home_m) and mission.home is not None else home_m
    ellipsoid_m = math.nan if geoid_m is None else geoid_zero_m - geoid_m
    zero_m = {"home": home_m, "geoid": geoid_zero_m, "ellipsoid": ellipsoid_m}
    why = {
        "home": of_home,
        "geoid": NO_GEOID,
        "ellipsoid": NO_UNDULATION if geoid_m is None else NO_GEOID,
    }
    return zero_m, {datum: text for datum, text in why.items() if math.isnan(zero_m[datum])}


def _shares_within(ends_m: np.ndarray, bounds_m: Bounds) -> np.ndarray:
    """Return ``[S, 2]`` from which share to which a box holds lines; nothing of them if the first is the larger."""
    low_m, high_m = np.reshape(bounds_m, (2, 2))
    begin_m, moved_m = ends_m[:, 0], ends_m[:, 1] - ends_m[:, 0]
    with np.errstate(all="ignore"):
        cuts = np.stack([(low_m - begin_m) / moved_m, (high_m - begin_m) / moved_m])
    is_still = moved_m == 0
    is_beside = is_still & ((begin_m < low_m) | (begin_m > high_m))
    first = np.where(is_still, np.where(is_beside, 2.0, 0.0), cuts.min(axis=0)).max(axis=1)
    last = np.where(is_still, 1.0, cuts.max(axis=0)).min(axis=1)
    shares = np.clip(np.stack([first, last], axis=1), [0.0, -1.0], [2.0, 1.0])
    shares[~np.isfinite(ends_m).all(axis=(1, 2))] = [1.0, 0.0]
    return shares


def _pieces(
    states: np.ndarray,
    shares: np.ndarray,
    leg: np.ndarray,
    follows: np.ndarray,
    ground: _Ground,
) -> Pieces:
    """Return segments as far as the maps hold them, cut at the borders of cells.

    Args:
      states: ``[S, 2, 4]`` x, y, height and metres flown at begin and end.
      shares: ``[S, 2]`` from which share to which the maps hold a segment.
      leg: ``[S]`` its leg.
      follows: ``[S]`` its height is above the ground, else above the ground's zero.
      ground: under the maps.
    """
    grid, parts = ground.grid, 1 if ground.terrain_m is None else PARTS_A_SIDE
    side_m, corner_m = grid.resolution_m / parts, np.array([grid.x_min_m, grid.y_min_m, 0.0])
    held = np.stack([between(states, share) for share in shares.T], axis=1)
    is_hover = (held[:, 0, :3] == held[:, 1, :3]).all(axis=1)
    held[is_hover, 1, 2] += HOVER_M
    points_m = held[..., :3].reshape(-1, 3) - corner_m
    num = np.abs(np.diff(np.floor(points_m[:, :2] / side_m), axis=0)).sum() + len(points_m)
    if num > MOST_PIECES:
        raise InputError(
            f"mission crosses some {num:,.0f} cells of the maps, more than {MOST_PIECES:,}: split the file"
        )
    if not len(points_m):
        nothing = np.zeros((0, 2))
        return Pieces(np.zeros((0, 2, 2)), nothing, nothing, nothing, *np.zeros((3, 0), int))
    cut = crossed_cells(points_m, side_m)
    is_leg = cut.segment % 2 == 0  # between them lies the way from a segment's end to the next one
    segment = cut.segment[is_leg] // 2
    begin_end = np.stack([between(held[segment], share) for share in cut.shares[is_leg].T], axis=1)
    elevation_m = ground.at(np.clip(begin_end[..., :2], *np.reshape(grid.bounds_m, (2, 2))))
    height_m = begin_end[..., 2] - np.where(follows[segment, None], 0.0, elevation_m)
    last = np.array(grid.shape)[:, None] - 1
    row, col = np.clip(np.stack([cut.row[is_leg], cut.col[is_leg]]) // parts, 0, last)
    return Pieces(
        begin_end[..., :2], height_m, elevation_m, begin_end[..., 3], leg[segment], row, col
    )
