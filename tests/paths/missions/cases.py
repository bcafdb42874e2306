"""Random missions: a flight is drawn first, and then written in one of the formats, with what is true of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tests.paths.missions import files
from tests.paths.missions.flights import (
    JUMP,
    LAND,
    LOITER_TIME,
    LOITER_TURNS,
    RETURN,
    SPEED,
    TAKEOFF,
    WAYPOINT,
    XY,
    Autopilot,
    Datum,
    Firmware,
    Flown,
    Item,
    fly_lines,
    height_in,
)
from tests.paths.missions.worlds import BLOCK_M, GEOID_M, MARGIN_M, SIDE_M, World

STREETS_M = np.arange(BLOCK_M / 2 - MARGIN_M / 4, SIDE_M, BLOCK_M)[1:]  # between houses
OFF_STREET_M = 5.0
HEIGHTS_M = (5.0, 15.0, 30.0, 60.0, 110.0)  # above the ground
HIGH_M = 150.0  # above everything
FORMATS = (".plan", ".waypoints", ".kml", ".gpx", ".geojson", ".csv")
ITEM_FORMATS = FORMATS[:2]
FIRMWARES: tuple[Firmware, ...] = ("ardupilot", "px4", "other")
HOLD_S = 3.0
ASIDE_M = 33.0  # of a house's centre, and so outside all houses


@dataclass(frozen=True, eq=False)
class Case:
    """A mission's file, and what is flown of it.

    Attributes:
      kind: of mission.
      world: over which it is flown.
      suffix: of the file.
      text: of the file.
      datum: what heights are above, ``"mixed"`` for several.
      flown: what is flown.
      options: of the check.
      is_damaged: what its findings are is not known.
    """

    kind: str
    world: World
    suffix: str
    text: str
    datum: str
    flown: Flown
    options: Mapping[str, Any] = field(default_factory=dict)
    is_damaged: bool = False

    @property
    def clearances_m(self) -> tuple[float, float]:
        """The clearances beside and over buildings that the check asks for."""
        return self.options.get("clearance_m", 0.0), self.options.get("vertical_clearance_m", 0.0)


class Draw:
    """Draws flights over a world."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self.world, self.rng = world, rng

    def one_of(self, *values: Any) -> Any:
        """Return one of some values."""
        return values[self.rng.integers(len(values))]

    def is_so(self, probability: float) -> bool:
        """Return whether something happens."""
        return bool(self.rng.random() < probability)

    def place_m(self, last_m: XY | None = None) -> XY:
        """Return a place in a street, more often than not along the street from the last one."""
        xy_m = self.rng.choice(STREETS_M, 2)
        if last_m and self.is_so(0.6):
            axis = self.rng.integers(2)
            xy_m[axis] = STREETS_M[np.abs(STREETS_M - last_m[axis]).argmin()]
        return tuple(np.round(xy_m + self.rng.uniform(-OFF_STREET_M, OFF_STREET_M, 2), 2).tolist())

    def places_m(self, least: int, most: int) -> list[XY]:
        """Return places, each after the one before it."""
        places: list[XY] = []
        for _ in range(self.rng.integers(least, most + 1)):
            places.append(self.place_m(places[-1] if places else None))
        return places

    def above_m(self) -> float:
        """Return a height above the ground: any, or near that of a roof."""
        if self.is_so(0.4):
            return max(2.0, float(self.rng.choice(self.world.top_m)) + self.rng.uniform(-4, 8))
        return self.one_of(*HEIGHTS_M)

    def item(
        self, command: int, xy_m: XY, datum: Datum, home_m: XY, above_m: float, **more: Any
    ) -> Item:
        """Return an item so high above the ground."""
        height_m = height_in(self.world, datum, xy_m, above_m, home_m)
        return Item(command, xy_m, height_m, datum, **more)

    def datum(self, others: tuple[Datum, ...] = ("home", "ground", "geoid")) -> Datum:
        """Return what heights of items are above."""
        return self.one_of(*others)

    def clearances(self) -> dict[str, float]:
        """Return options that ask for clearances."""
        return {
            "clearance_m": self.one_of(0.0, 0.0, 4.0),
            "vertical_clearance_m": self.one_of(0.0, 3.0),
        }

    def house(self) -> int:
        """Return the number of a house that stands, of 12 m or more, well within the maps."""
        centres_m = np.array([outline.centroid.coords[0] for outline in self.world.outlines])
        inside = ((centres_m > 60) & (centres_m < SIDE_M - 60)).all(axis=1)
        solid = np.array([outline.area > 60 for outline in self.world.outlines])
        fits = inside & solid & np.isinf(self.world.floor_m) & (self.world.top_m >= 12)
        return int(self.rng.choice(np.flatnonzero(fits)))

    def through_house(self) -> tuple[list[XY], float]:
        """Return two places on either side of a house, and half its height."""
        house = self.house()
        centre_m = np.array(self.world.outlines[house].centroid.coords[0])
        angle = self.rng.uniform(0, 2 * math.pi)
        away_m = ASIDE_M * np.array([math.cos(angle), math.sin(angle)])
        starts_m, ends_m = np.round([centre_m + away_m, centre_m - away_m], 2).tolist()
        return [tuple(starts_m), tuple(ends_m)], float(self.world.top_m[house] / 2)


def items_case(draw: Draw, kind: str, items: list[Item], home_m: XY, **more: Any) -> Case:
    """Return a mission of items as a file, by any firmware that the format can name."""
    suffix = more.pop("suffix", None) or draw.one_of(*ITEM_FORMATS)
    firmware = "ardupilot" if suffix == ".waypoints" else draw.one_of(*FIRMWARES)
    if suffix == ".waypoints":
        items = [replace(item, is_calculated=False) for item in items]
        text = files.waypoints_text(files.waypoints(draw.world, items, home_m))
    else:
        text = files.to_json(files.plan(draw.world, items, firmware, home_m))
    options = more.pop("options", None) or draw.clearances()
    return_m = options.get("return_altitude_m")
    flown = Autopilot(draw.world, firmware, home_m, return_m).fly(items)
    flown.unknown += more.pop("unknown", [])
    datums = {"calculated" if item.is_calculated else item.datum for item in items if item.xy_m}
    datum = datums.pop() if len(datums) == 1 else "mixed"
    return Case(kind, draw.world, suffix, text, datum, flown, options, **more)


def items_of(
    draw: Draw, places: list[XY], is_mixed: bool, has_calculated: bool = True
) -> list[Item]:
    """Return a take-off from the first place and waypoints at all others."""
    home_m = places[0]
    datum, above_m = draw.datum(), draw.above_m()
    is_calculated = has_calculated and draw.is_so(0.15)
    items = []
    for number, xy_m in enumerate(places):
        if is_mixed:
            datum = draw.datum()
        if draw.is_so(0.5):
            above_m = draw.above_m()
        command = WAYPOINT if number else TAKEOFF
        hold_s = HOLD_S if draw.is_so(0.5) else 0.0
        item = draw.item(command, xy_m, datum, home_m, above_m, hold_s=hold_s)
        if is_calculated and number:
            item = replace(item, height_m=round(above_m, 2), datum="ground", is_calculated=True)
        items.append(item)
    return items


def simple(draw: Draw, kind: str) -> Case:
    """Return a mission of waypoints, from a take-off to a landing."""
    places = draw.places_m(3, 6)
    items = items_of(draw, places, kind == "mixed", kind == "mixed")
    items.insert(1, Item(SPEED))
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def open_heights(draw: Draw, kind: str) -> Case:
    """Return a mission some of whose waypoints leave their height open."""
    places = draw.places_m(4, 7)
    items = items_of(draw, places, is_mixed=False, has_calculated=False)
    items = [
        replace(item, height_m=math.nan) if number > 1 and draw.is_so(0.5) else item
        for number, item in enumerate(items)
    ]
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def jumps(draw: Draw, kind: str) -> Case:
    """Return a mission with a jump back or on, past waypoints that may leave their height open."""
    places = draw.places_m(5, 7)
    items = items_of(draw, places, draw.is_so(0.3), has_calculated=False)
    to = int(draw.rng.integers(1, len(items) - 1))
    if draw.is_so(0.6):
        items[to] = replace(items[to], height_m=math.nan)
    at = int(draw.rng.integers(1, len(items) + 1))
    moved = to + (to >= at)
    items.insert(at, Item(JUMP, to=moved, repeats=int(draw.one_of(1, 1, 2, 0))))
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def loiters(draw: Draw, kind: str) -> Case:
    """Return a mission with a circle, and sometimes a stay."""
    places = draw.places_m(4, 6)
    items = items_of(draw, places, is_mixed=False, has_calculated=False)
    number = int(draw.rng.integers(1, len(items) - 1))
    circle = replace(
        items[number], command=LOITER_TURNS, radius_m=float(draw.one_of(12, 25, 40, 60)), hold_s=0.0
    )
    items[number] = circle
    if draw.is_so(0.15):  # begun in its centre
        items.insert(number, replace(circle, command=WAYPOINT))
    if draw.is_so(0.3):
        items[-1] = replace(items[-1], command=LOITER_TIME, hold_s=0.0)
    return items_case(draw, kind, [*items, Item(LAND)], places[0])


def returns(draw: Draw, kind: str) -> Case:
    """Return a mission that returns home, from near or far, and at a height that is mostly named."""
    places = draw.places_m(2, 4)
    if draw.is_so(0.6):
        angle, away_m = draw.rng.uniform(0, 2 * math.pi), draw.rng.uniform(15, 60)
        places.append(
            (
                round(places[0][0] + away_m * math.cos(angle), 2),
                round(places[0][1] + away_m * math.sin(angle), 2),
            )
        )
    items = items_of(draw, places, is_mixed=False, has_calculated=False)
    options = draw.clearances()
    if draw.is_so(0.8):
        options["return_altitude_m"] = float(draw.one_of(20, 60, 100))
    return items_case(draw, kind, [*items, Item(RETURN)], places[0], options=options)


def corners(draw: Draw, kind: str) -> Case:
    """Return a mission round the corner of a house, which it clears by a metre only if it does not cut it."""
    house = draw.house()
    ring_m = np.array(draw.world.outlines[house].exterior.coords)[:-1]
    sides_m = np.stack([ring_m[1] - ring_m[0], ring_m[-1] - ring_m[0]])
    sides_m /= np.linalg.norm(sides_m, axis=1)[:, None]
    outward = -sides_m.sum(axis=0)
    corner_m = ring_m[0] + outward / np.linalg.norm(outward)
    places = [
        tuple(np.round(each, 2).tolist())
        for each in (corner_m + 20 * sides_m[0], corner_m, corner_m + 20 * sides_m[1])
    ]
    datum, above_m = draw.datum(), draw.world.top_m[house] * 0.4
    items = [
        draw.item(WAYPOINT if number else TAKEOFF, xy_m, datum, places[0], above_m)
        for number, xy_m in enumerate(places)
    ]
    options = {"clearance_m": 0.0, "vertical_clearance_m": 0.0}
    return items_case(draw, kind, [*items, Item(LAND)], places[0], options=options)


def lines(draw: Draw, kind: str) -> Case:
    """Return lines of points, with heights above anything."""
    suffix = draw.one_of(*FORMATS[2:])
    datums: tuple[Datum, ...] = ("home", "ground")
    if draw.world.terrain_m is not None:
        datums = ("home", "ground", "geoid", "ellipsoid")
    datum = draw.datum(datums)
    num_lines = 2 if suffix != ".csv" and draw.is_so(0.1) else 1
    drawn = [_line(draw) for _ in range(num_lines)]
    first_m = (float(drawn[0][0, 0]), float(drawn[0][0, 1]))
    home_m = draw.place_m(first_m) if draw.is_so(0.3) else first_m
    for line in drawn:
        line[:, 2] = [
            height_in(draw.world, datum, (x_m, y_m), z_m, home_m) for x_m, y_m, z_m in line.tolist()
        ]
    options: dict[str, Any] = draw.clearances() | {"heights": datum}
    if datum == "ellipsoid":
        options["geoid_m"] = GEOID_M
    has_home = datum == "home" or draw.is_so(0.9)
    if has_home:
        options["home"] = draw.world.lonlat(*home_m)
    text = _lines_text(draw, suffix, drawn, options)
    flown = fly_lines(draw.world, drawn, datum, home_m if has_home else None)
    return Case(kind, draw.world, suffix, text, datum, flown, options)


def _line(draw: Draw) -> np.ndarray:
    """Return a line of points with heights above the ground."""
    places = draw.places_m(2, 6)
    above_m = [draw.above_m()] * len(places)
    if draw.is_so(0.5):
        above_m = [draw.above_m() for _ in places]
    return np.column_stack([places, above_m])


def _lines_text(draw: Draw, suffix: str, drawn: list[np.ndarray], options: dict[str, Any]) -> str:
    """Return the text of lines; where the file says what heights are above, the option does not."""
    world = draw.world
    if suffix == ".kml":
        modes = {"ground": "relativeToGround", "geoid": "absolute", "ellipsoid": "absolute"}
        mode = modes.get(options["heights"], "") if draw.is_so(0.7) else ""
        if mode and options["heights"] != "ellipsoid":
            del options["heights"]
        tag = draw.one_of("LineString", "gx:Track")
        return files.kml(*(files.kml_line(world, line, mode, tag) for line in drawn))
    if suffix == ".gpx":
        return files.gpx(world, drawn, is_track=draw.is_so(0.5))
    if suffix == ".geojson":
        return files.to_json(files.geojson(world, drawn, has_property=draw.is_so(0.5)))
    names = draw.one_of(
        ("lon", "lat", "altitude_m"), ("longitude", "latitude", "alt"), ("Lng", "Lat", "Height")
    )
    return files.csv(names, files.placed(world, drawn[0]))


MAKERS = {
    "mixed": simple,
    "lines": lines,
    "jump": jumps,
    "loiter": loiters,
    "return": returns,
    "corner": corners,
    "open": open_heights,
}


def plain(draw: Draw, kind: str) -> Case:
    """Return a mission of simple items or lines, whose reading nobody disputes."""
    return draw.one_of(simple, lines)(draw, kind)
