"""How autopilots fly a mission's items, and what a mission of lines may mean: the ways that are really flown.

Where the file or its firmware leaves open how a leg is flown, all of its ways are here: the worse one counts.

Rules of ArduCopter: ``mode_auto.cpp``, ``mode_rtl.cpp`` and ``AC_WPNav.cpp`` of ArduPilot; of PX4: ``mission.cpp`` and
``rtl_direct.cpp``.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from tests.flights.missions.worlds import GEOID_M, World

WAYPOINT, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF, SPEED, JUMP = (
    16,
    18,
    19,
    20,
    21,
    22,
    178,
    177,
)
Datum = Literal["ground", "home", "geoid", "ellipsoid"]
Firmware = Literal["ardupilot", "px4", "other"]
XY = tuple[float, float]
STEP_M = 0.2  # between the points of a way
NUM_EXITS = 24  # of a circle that is left nobody knows where
MOST_ITEMS = 200  # that are flown, however often jumps lead back
CONE = 3.0  # ArduCopter's RTL_CONE_SLOPE: height for each metre from home
LEAST_RETURN_M = 2.5
PX4_CONE_M = 10.0  # RTL_MIN_DIST, within which RTL_CONE_ANG of 45 degrees counts
CUT_M = 2.0  # by which a corner may be cut
LEAST_TURN = math.radians(10)


@dataclass(frozen=True)
class Item:
    """An item of a mission.

    Attributes:
      command: of MAVLink.
      xy_m: its place; None for that of the vehicle.
      height_m: above ``datum``; NaN keeps the vehicle's.
      datum: what the height is above.
      hold_s: the delay at a waypoint.
      radius_m: of a loiter.
      to: of a jump, the index of its target.
      repeats: how often a jump is flown.
      is_calculated: the height is QGroundControl's above terrain, without one above the geoid.
    """

    command: int
    xy_m: XY | None = None
    height_m: float = math.nan
    datum: Datum = "home"
    hold_s: float = 0.0
    radius_m: float = 0.0
    to: int = 0
    repeats: int = 1
    is_calculated: bool = False


class Way(NamedTuple):
    """A way that may be flown: ``[N, 3]`` x, y and height above the ground every `STEP_M`, in order of travel."""

    points_m: np.ndarray


class At(NamedTuple):
    """Where a vehicle may be: its place, elevation, and the height by which it came there, above its datum."""

    xy_m: XY
    z_m: float
    height_m: float
    datum: Datum


@dataclass
class Flown:
    """What is flown of a mission.

    Attributes:
      ways: all that may be flown.
      corners: ``[3, 3]`` each: x, y, elevation of the corner of a way, and of the ends of what may be cut off there.
      unknown: why a part of it cannot be known, so that it is never clean; empty where all is known.
    """

    ways: list[Way] = field(default_factory=list)
    corners: list[np.ndarray] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)

    @property
    def points_m(self) -> np.ndarray:
        """``[N, 3]`` x, y and height above the ground of all ways."""
        return np.concatenate([way.points_m for way in self.ways] or [np.zeros((0, 3))])


def zero_m(world: World, datum: Datum, xy_m: XY, home_m: XY) -> float:
    """Return the elevation of the zero of a datum at a place."""
    zeros_m = {"geoid": 0.0, "ellipsoid": -GEOID_M}
    if datum in zeros_m:
        return zeros_m[datum]
    return float(world.ground_m(*(xy_m if datum == "ground" else home_m)))


def straight(
    world: World, begin_m: Sequence[float], end_m: Sequence[float], follows: bool = False
) -> Way:
    """Return the way between two places, each x, y and elevation.

    It is straight, or follows the ground: then its height above the ground changes evenly.
    """
    begin_m, end_m = np.array(begin_m, float), np.array(end_m, float)
    num = max(2, math.ceil(np.linalg.norm(end_m - begin_m) / STEP_M) + 1)
    x_m, y_m, z_m = np.linspace(begin_m, end_m, num).T
    ground_m = world.ground_m(x_m, y_m)
    above_m = z_m - ground_m
    if follows:
        above_m = np.linspace(above_m[0], above_m[-1], num)
    return Way(np.column_stack([x_m, y_m, above_m]))


def circle(world: World, centre_m: XY, radius_m: float, z_m: float, follows: bool) -> Way:
    """Return a circle at the elevation of its centre, or at its height above the ground there if it follows that."""
    angles = np.linspace(0, 2 * math.pi, math.ceil(2 * math.pi * radius_m / STEP_M) + 1)
    x_m = centre_m[0] + radius_m * np.cos(angles)
    y_m = centre_m[1] + radius_m * np.sin(angles)
    ground_m = world.ground_m(*centre_m) if follows else world.ground_m(x_m, y_m)
    return Way(np.column_stack([x_m, y_m, np.zeros(len(angles)) + z_m - ground_m]))


class Autopilot:
    """What flies items, from a take-off at home on.

    It may be at several places at once (``at``), where it is not known by which of several ways it came.
    """

    def __init__(
        self, world: World, firmware: Firmware, home_m: XY, return_m: float | None
    ) -> None:
        self.world, self.firmware, self.home_m, self.return_m = world, firmware, home_m, return_m
        self.flown = Flown()
        home_z_m = float(world.ground_m(*home_m))
        self.at = {At(home_m, home_z_m, 0.0, "home")}
        self._came_from: list[
            np.ndarray
        ] = []  # where the legs to a waypoint begin whose corner may be cut

    def fly(self, items: Sequence[Item]) -> Flown:
        """Fly items, with their jumps."""
        repeats_left = {number: item.repeats for number, item in enumerate(items)}
        number = num_flown = 0
        while number < len(items) and num_flown < MOST_ITEMS:
            item = items[number]
            number += 1
            num_flown += 1
            if item.command == JUMP:
                if repeats_left[number - 1] > 0:
                    repeats_left[number - 1] -= 1
                    number = item.to
            elif item.command in (RETURN, LAND):
                self._end(item)
                break
            elif item.command in (TAKEOFF, WAYPOINT, LOITER_TIME, LOITER_TURNS):
                self._fly(item)
        return self.flown

    def _targets(self, at: At, item: Item) -> Iterator[tuple[At, bool]]:
        """Yield where an item leads from a place, each with whether the way there follows the ground."""
        xy_m = item.xy_m or at.xy_m
        if item.command == TAKEOFF and self.firmware == "ardupilot":
            xy_m = at.xy_m
        datum, height_m = item.datum, item.height_m
        if math.isnan(height_m):
            datum, height_m = at.datum, at.height_m
        z_m = height_m + zero_m(self.world, datum, xy_m, self.home_m)
        follows = {item.datum == "ground", datum == "ground"}
        for each in {False} if item.is_calculated else follows:
            yield At(xy_m, z_m, height_m, datum), each

    def _fly(self, item: Item) -> None:
        """Fly to an item's place, climb straight up to it first if it is a take-off, or round it if it is a circle."""
        came_from, reached = [], set()
        for at in self.at:
            for target, follows in self._targets(at, item):
                if item.command == TAKEOFF:
                    above = At(at.xy_m, target.z_m, target.height_m, target.datum)
                    if item.datum == "ground":
                        above = above._replace(
                            z_m=float(self.world.ground_m(*at.xy_m)) + target.height_m
                        )
                    self._leg(at, above)
                    at = above
                if item.command == LOITER_TURNS:
                    reached |= set(self._circle(at, target, item.radius_m, follows))
                else:
                    self._leg(at, target, follows)
                    reached.add(target)
                came_from.append(np.array([*at.xy_m, at.z_m]))
        self.at = reached
        may_cut = item.command == WAYPOINT and item.hold_s == 0 and item.xy_m is not None
        self._came_from = came_from if may_cut else []

    def _leg(self, at: At, target: At, follows: bool = False) -> None:
        """Fly from one place to another, and note the corners where it begins."""
        begin_m, end_m = np.array([*at.xy_m, at.z_m]), np.array([*target.xy_m, target.z_m])
        self.flown.ways.append(straight(self.world, begin_m, end_m, follows))
        for before_m in self._came_from:
            sides_m = [before_m - begin_m, end_m - begin_m]
            lengths_m = [float(np.linalg.norm(side_m[:2])) for side_m in sides_m]
            if min(lengths_m) < 2 * CUT_M:
                continue
            ends_m = [
                begin_m + side * CUT_M / m for side, m in zip(sides_m, lengths_m, strict=True)
            ]
            turn = math.pi - math.acos(
                np.clip(sides_m[0][:2] @ sides_m[1][:2] / math.prod(lengths_m), -1, 1)
            )
            if turn > LEAST_TURN:
                self.flown.corners.append(np.array([begin_m, *ends_m]))

    def _circle(self, at: At, centre: At, radius_m: float, follows: bool) -> Iterator[At]:
        """Fly round a circle; yield where it may be left: its nearest point (ArduPilot) or its centre (PX4)."""
        round_it = circle(self.world, centre.xy_m, radius_m, centre.z_m, follows)
        self.flown.ways.append(round_it)
        if self.firmware != "ardupilot":
            self._leg(at, centre, follows)
            yield centre
        if self.firmware != "px4":
            x_m, y_m = np.subtract(at.xy_m, centre.xy_m)
            angles = [math.atan2(y_m, x_m)]
            if math.hypot(x_m, y_m) < 1e-6:
                self.flown.unknown.append("the way out of a circle that begins in its centre")
                angles = np.linspace(0, 2 * math.pi, NUM_EXITS).tolist()
                yield centre
            for angle in angles:
                edge = self._edge(centre, radius_m, angle, follows)
                self._leg(at, edge, follows)
                yield edge

    def _edge(self, centre: At, radius_m: float, angle: float, follows: bool) -> At:
        """Return a place on a circle."""
        x_m = centre.xy_m[0] + radius_m * math.cos(angle)
        y_m = centre.xy_m[1] + radius_m * math.sin(angle)
        z_m = centre.z_m
        if follows:
            z_m += float(self.world.ground_m(x_m, y_m)) - float(self.world.ground_m(*centre.xy_m))
        return centre._replace(xy_m=(x_m, y_m), z_m=z_m)

    def _end(self, item: Item) -> None:
        """Return home and land, or land where it is."""
        home_z_m = float(self.world.ground_m(*self.home_m))
        self._came_from = []
        if item.command == RETURN and self.return_m is None:
            self.flown.unknown.append("a return at a height that nobody names")
            return
        for at in self.at:
            if item.command == LAND:
                self._leg(at, at._replace(z_m=float(self.world.ground_m(*at.xy_m))))
                continue
            own_m = at.z_m - home_z_m
            for rise_m in self._rises_m(own_m, math.dist(at.xy_m, self.home_m)):
                above = at._replace(z_m=home_z_m + rise_m)
                over_home = above._replace(xy_m=self.home_m)
                self._leg(at, above)
                self._leg(above, over_home)
                self._leg(over_home, over_home._replace(z_m=home_z_m))

    def _rises_m(self, own_m: float, distance_m: float) -> set[float]:
        """Return the heights above home at which it may return."""
        high_m = self.return_m
        near_m = distance_m if distance_m <= PX4_CONE_M else high_m
        cones_m = {"ardupilot": max(CONE * distance_m, LEAST_RETURN_M), "px4": near_m}
        chosen = cones_m.values() if self.firmware == "other" else [cones_m[self.firmware]]
        return {max(own_m, high_m), *(max(own_m, min(high_m, cone_m)) for cone_m in chosen)}


def fly_lines(
    world: World, lines: Sequence[np.ndarray], datum: Datum, home_m: XY | None, is_own: bool = False
) -> Flown:
    """Return what is flown of lines of points, ``[N, 3]`` x, y and height above a datum each, after a climb from home.

    Heights above the ground leave open whether the ways between points follow it, except in files of jaxurban's own.
    """
    flown = Flown()
    if home_m is None:
        flown.unknown.append("the climb from a home that nobody names")
    if len(lines) > 1:
        flown.unknown.append("the ways between lines")
    for number, line in enumerate(lines):
        places = [(x_m, y_m) for x_m, y_m, _ in line]
        heights_m = [height_m for *_, height_m in line]
        if home_m and number == 0:
            places.insert(0, home_m)
            heights_m.insert(0, heights_m[0])
        z_m = [
            height_m + zero_m(world, datum, place, home_m or places[0])
            for place, height_m in zip(places, heights_m, strict=True)
        ]
        ends_m = np.column_stack([places, z_m])
        if home_m and number == 0:
            ground_m = float(world.ground_m(*home_m))
            flown.ways.append(straight(world, (*home_m, ground_m), ends_m[0]))
        readings = {True} if is_own else {False, datum == "ground"}
        for follows in readings:
            for begin_m, end_m in pairwise(ends_m):
                flown.ways.append(straight(world, begin_m, end_m, follows))
    return flown


def height_in(world: World, datum: Datum, xy_m: XY, above_m: float, home_m: XY) -> float:
    """Return the height above a datum of a place so high above the ground, to the centimetre."""
    elevation_m = float(world.ground_m(*xy_m)) + above_m
    return round(elevation_m - zero_m(world, datum, xy_m, home_m), 2)
