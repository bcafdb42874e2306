"""What a mission is made of, whichever tool made it: places, legs, and what of it could not be read."""

import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import pyproj

from jaxurban.io.zone import Zone
from jaxurban.settings import FlownBy

Datum = Literal["home", "ground", "geoid", "ellipsoid"]  # what a height is above
Profile = Literal["frame", "straight", "both"]  # how a leg runs between the heights of its ends
Autopilot = FlownBy | Literal["inav", "dji", "unknown"]
BOTH: tuple[FlownBy, ...] = get_args(FlownBy)
AUTOPILOTS = {"ardupilot": "ArduPilot", "px4": "PX4", "inav": "INAV", "dji": "DJI"}
LonLat = tuple[float, float]
DATUMS: tuple[Datum, ...] = get_args(Datum)
NO_HOME = "the file names no home"
# There autopilots hover: of ArduCopter mode_auto.cpp, exit_mission; of PX4 mission_base.cpp, setEndOfMissionItems.
ENDS_IN_AIR = "It ends in the air at {} {}: nothing in the file lands it or brings it home."
MOST_HEIGHT_M = 100_000.0  # above or below any datum
MOST = 1e15  # of any number of a file
MOST_NAMED = 50  # sentences on what is not judged
# How near to a waypoint autopilots turn: by default WPNAV_RADIUS of ArduPilot's multicopters, and NAV_ACC_RAD of PX4's.
CORNER_M = 2.0
GEOD = pyproj.Geod(ellps="WGS84")
SAME_M = 0.01  # two heights of one place that differ by more are two heights
# A number as ground stations write it: no underscore, no digits of other scripts.
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)


class DamagedError(ValueError):
    """What is wrong with a mission's file, in words of ours; other errors of reading it are those of libraries."""


class Place(NamedTuple):
    """One end of a leg.

    Attributes:
      lon, lat: degrees of WGS 84.
      height_m: above its datum; NaN where the file leaves it open, as on the autopilot's own way home.
      datum: what the height is above.
      level_with: a place whose height it has, above the ground where the datum is the ground, else above the sea;
        its own height counts where it is not NaN and more than that.
    """

    lon: float
    lat: float
    height_m: float
    datum: Datum
    level_with: "Place | None" = None


class Leg(NamedTuple):
    """A straight way, or a circle.

    Attributes:
      start, end: its ends.
      kind: ``climb`` (from home, or another vertical take-off), ``leg``, ``loiter``, ``land``, ``return`` or ``jump``.
      item: the number of the item in its file that the vehicle flies to, as ground stations count: the first is 1.
      radius_m: of a loiter's circle around ``end``, which begins and ends at ``start``: on the circle, or at ``end``
        itself where autopilots fly to the centre first; 0 for hovering.
      profile: ``"frame"``: in the frame of its end, so that it follows the ground where the end's height is above the
        ground, and is straight otherwise; ``"straight"``: straight whatever the heights are above; ``"both"``: the file
        does not say which of the two.
      is_variant: it is not flown after the leg before it, but beside the next leg that is none, as another setting of
        the autopilot, or another reading of the file, would fly.
      turn_m: how near to its end the vehicle turns, and so cuts the corner there; 0 where it stops.
    """

    start: Place
    end: Place
    kind: str
    item: int
    radius_m: float = 0.0
    profile: Profile = "frame"
    is_variant: bool = False
    turn_m: float = CORNER_M


class Account(NamedTuple):
    """What became of one thing of a mission's file.

    Attributes:
      what: names the thing, such as ``"item 3"`` or ``"line 2 (Track)"``.
      num: how many things of the file it stands for: 1 of an item, of a line the number of its points.
      legs: numbers of the mission's legs that fly it, from 0; empty where it moves nothing or is not judged.
      why: it is in no leg, ``""`` where it is. A thing that moves nothing, which a reader knows for certain, says so;
        any other reason is also a sentence of ``Mission.not_judged``.
    """

    what: str
    num: int
    legs: tuple[int, ...]
    why: str = ""


@dataclass(frozen=True, eq=False)
class Mission:
    """A mission that another tool made.

    Attributes:
      name: of the file.
      legs: in the order flown, each once: a jump's leg back too, however often it is flown.
      home: longitude, latitude; None where neither the file nor the user names one.
      home_elevation_m: above the geoid, as the file says it; None where it does not, or says 0.
      not_judged: a sentence for each thing that is not in ``legs`` though it may be flown, or not as it is there.
      speed_m_s: the first that the mission sets, or that its ground station planned with; None where it has none.
      accounts: of everything in the file; empty for a mission that no file holds.
      num_things: how many things the file holds, counted apart from ``accounts``: the two must agree.
      home_above_ground_m: how high home lies above the ground, on a roof; heights above home count from there.
      zones: where its geofence lets it not fly.
      autopilot: which one flies it, as the file or the user says; ``"unknown"``: either of `BOTH`.
      return_altitude_m: height above home at which it returns; NaN where neither the file nor the user names it.
      notes: sentences on what to know of it that leave the verdict as it is.
      other: of an unknown autopilot, the same mission as PX4 flies it, where ArduPilot flies it otherwise, as this one;
        its zones are here. None where there is one way.
    """

    name: str
    legs: tuple[Leg, ...]
    home: LonLat | None
    home_elevation_m: float | None
    not_judged: tuple[str, ...]
    speed_m_s: float | None
    accounts: tuple[Account, ...] = ()
    num_things: int = 0
    home_above_ground_m: float = 0.0
    zones: Sequence[Zone] = ()
    autopilot: Autopilot = "unknown"
    return_altitude_m: float = math.nan
    notes: tuple[str, ...] = ()
    other: "Mission | None" = None

    @property
    def ways(self) -> "dict[str, Mission]":
        """The mission as each autopilot flies it, by its name; by ``""`` where there is one way."""
        return dict(zip(BOTH, (self, self.other), strict=True)) if self.other else {"": self}

    @property
    def autopilots(self) -> tuple[Autopilot, ...]:
        """Those for which it is judged."""
        return flyers(self.autopilot)

    @property
    def datums(self) -> set[Datum]:
        """What the heights of its legs are above."""
        return {place.datum for leg in self.legs for place in (leg.start, leg.end)}

    @property
    def num_lost(self) -> int:
        """How many things of the file are in no account, or in one that names neither a leg nor a reason."""
        sound = [each.num for each in self.accounts if each.why or each.legs]
        return abs(self.num_things - sum(sound))


def flyers(autopilot: Autopilot) -> tuple[Autopilot, ...]:
    """Return those that may fly a mission: both where it is not known."""
    return BOTH if autopilot == "unknown" else (autopilot,)


def json_of(data: bytes) -> Any:
    """Return what JSON holds, and NaN and Infinity, which are no numbers of JSON, as texts.

    Raises:
      DamagedError: it is damaged, or an object has a key twice.
      ValueError, RecursionError: it is no text, has a number of thousands of digits, or is nested too deeply.
    """
    try:
        return json.loads(data, object_pairs_hook=_once, parse_constant=str)
    except json.JSONDecodeError as error:
        raise DamagedError(
            f"its JSON is damaged in line {error.lineno}, column {error.colno}"
        ) from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON; DamagedError where a key has two values, of which readers take one or the other."""
    values: dict[str, Any] = {}
    for key, value in pairs:
        if key in values:
            one_value(f"{key[:40]!r} in an object", ([values[key]], [value]))
        values[key] = value
    return values


def one_value(what: str, values: Iterable[Any], most: float = 0.0) -> Any:
    """Return the value of a quantity that a file may give in several places, None where it gives none.

    Programs take one or the other place, so that values that differ are not judged: every reader asks here.

    Args:
      what: names the quantity in the message of an error.
      values: numbers, or texts, of which those of one number are the same. None is left out; NaN is like no other.
      most: by how much two numbers may differ.

    Raises:
      DamagedError: two values differ.
    """
    first = None
    for value in values:
        if first is None:
            first = value
        elif value is not None and not _is_same(first, value, most):
            one, other = (str(each)[:40] for each in (first, value))
            raise DamagedError(f"it has two values of {what}, {one} and {other}: keep one")
    return first


def _is_same(one: Any, other: Any, most: float) -> bool:
    """Return whether two values are equal, or numbers or texts of numbers that differ by no more than ``most``."""
    try:
        return one == other or abs(float(one) - float(other)) <= most
    except (TypeError, ValueError):
        return False


def decimal_of(what: str, text: str | None) -> float:
    """Return a number that a file holds as text, NaN where it is blank.

    Raises:
      DamagedError: it is no `NUMBER`, or as of `number_of`; ``what`` begins the message.
    """
    text = (text or "").strip()
    if not text:
        return math.nan
    if not NUMBER.fullmatch(text):
        raise DamagedError(f"{what} must be a number, got {text[:40]!r}")
    return number_of(what, float(text))


def number_of(what: str, value: Any) -> float:
    """Return a number of a file, NaN where it is null.

    Args:
      what: names the number, and begins the message of an error.
      value: as JSON holds it.

    Raises:
      DamagedError: it is infinite, larger than `MOST`, or no number, such as a text or true.
    """
    if value is None:
        return math.nan
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or abs(value) > MOST:
        raise DamagedError(f"{what} must be a finite number, got {str(value)[:40]!r}")
    return float(value)


def whole_of(what: str, value: Any) -> int:
    """Return a whole number of a file.

    Raises:
      DamagedError: it is not whole, or as of `number_of`; ``what`` begins the message.
    """
    number = number_of(what, value)
    if number % 1 != 0:  # NaN too
        raise DamagedError(f"{what} must be a whole number, got {value!r}")
    return int(number)


def check_place(what: str, lon: float, lat: float, height_m: float = 0.0) -> None:
    """Raise DamagedError unless a place lies on the Earth, and its height is one that is flown.

    Args:
      what: names the place, and begins the message of the error.
      lon, lat: degrees; NaN passes.
      height_m: above any datum; NaN passes.
    """
    if abs(lat) > 90 or abs(lon) > 180:
        raise DamagedError(
            f"{what} lies at latitude {lat:g} and longitude {lon:g}, which is no place on the Earth"
        )
    if abs(height_m) > MOST_HEIGHT_M:
        raise DamagedError(f"{what} has a height of {height_m:g} m, which no drone reaches")


def circle_around(lon: float, lat: float, radius_m: float, azimuths_deg: np.ndarray) -> np.ndarray:
    """Return ``[2, N]`` longitude and latitude in degrees of places on a circle, by their azimuths from its centre."""
    around: Any = np.broadcast_arrays(lon, lat, azimuths_deg, radius_m)
    return np.stack(GEOD.fwd(*around)[:2])


def first_sentences(sentences: Sequence[str]) -> tuple[str, ...]:
    """Return sentences, each once; of more than `MOST_NAMED` the first of them, and one that counts the others."""
    distinct = tuple(dict.fromkeys(sentences))
    num_more = len(distinct) - MOST_NAMED
    if num_more <= 0:
        return distinct
    return (*distinct[:MOST_NAMED], f"{num_more} more such things are not judged")
