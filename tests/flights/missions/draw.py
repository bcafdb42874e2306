"""What random missions are drawn by: places, heights, items, and the file of items with what is flown of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely

from tests.flights.missions import files
from tests.flights.missions.flights import (
    TAKEOFF,
    WAYPOINT,
    XY,
    Autopilot,
    Datum,
    Firmware,
    Flown,
    Item,
    height_in,
)
from tests.flights.missions.worlds import SIDE_M, STREETS_M, World

OFF_STREET_M = 5.0
HEIGHTS_M = (5.0, 15.0, 30.0, 60.0, 110.0)  # above the ground
HIGH_M, LOW_M = 150.0, (10.0, 20.0)  # above everything, and between houses
FORMATS = (".plan", ".waypoints", ".kml", ".gpx", ".geojson", ".csv")
ITEM_FORMATS = FORMATS[:2]
FIRMWARES: tuple[Firmware, ...] = ("ardupilot", "px4", "other")
HOLD_S = 3.0
ASIDE_M, WALL_ASIDE_M = 33.0, 4.5  # of the centre of a house or a wall, and so outside all of them
LARGEST_WALL_M2 = 20.0
SURE_M = 0.5  # below a top


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

    def datum(self, datums: tuple[Datum, ...] = ("home", "ground", "geoid")) -> Datum:
        """Return what heights are above, of items if nothing else is named."""
        return self.one_of(*datums)

    def clearances(self) -> dict[str, float]:
        """Return options that ask for clearances."""
        return {
            "clearance_m": self.one_of(0.0, 0.0, 4.0),
            "vertical_clearance_m": self.one_of(0.0, 3.0),
        }

    def house(self, is_wall: bool = False) -> int:
        """Return the number of a house or a wall that stands, of 12 m or more, well within the maps."""
        centres_m = shapely.get_coordinates(shapely.centroid(self.world.outlines))
        inside = ((centres_m > 60) & (centres_m < SIDE_M - 60)).all(axis=1)
        fits = inside & np.isinf(self.world.floor_m) & (self.world.top_m >= 12)
        fits &= (shapely.area(self.world.outlines) < LARGEST_WALL_M2) == is_wall
        fits[self.world.num_houses :] = False
        return int(self.rng.choice(np.flatnonzero(fits)))

    def around(self) -> list[XY]:
        """Return places on one side of a house or a wall, beyond its end, and on its other side."""
        is_wall = self.is_so(0.5)
        outline = self.world.outlines[self.house(is_wall)]
        centre_m = np.array(outline.centroid.coords[0])
        first_m, second_m, *_ = np.array(outline.exterior.coords)
        along, across = second_m - first_m, (second_m - first_m)[::-1] * (-1, 1)
        sides_m = np.array([along, across]) / np.linalg.norm(along)
        if is_wall and np.linalg.norm(along) < 1.0:
            sides_m = sides_m[::-1]
        along_m, across_m = sides_m * [[ASIDE_M], [WALL_ASIDE_M if is_wall else ASIDE_M]]
        places = [centre_m + across_m, centre_m + along_m, centre_m - across_m]
        return [(x_m, y_m) for x_m, y_m in np.round(places, 2).tolist()]

    def through_house(self) -> tuple[list[XY], float]:
        """Return two places on either side of a house, and half its height."""
        house = self.house()
        centre_m = np.array(self.world.outlines[house].centroid.coords[0])
        return self._across(centre_m), float(self.world.top_m[house] / 2)

    def through_thing(self) -> tuple[list[XY], float]:
        """Return two places on either side of a thing that stands, and a height at which it stands."""
        thing = int(self.rng.integers(self.world.num_houses, len(self.world.outlines)))
        inside_m = self.world.outlines[thing].representative_point().coords[0]
        low_m = max(1.0, self.world.floor_m[thing] + SURE_M)
        z_m = self.rng.uniform(low_m, max(low_m, self.world.top_m[thing] - SURE_M))
        return self._across(np.array(inside_m)), float(z_m)

    def _across(self, centre_m: np.ndarray) -> list[XY]:
        """Return two places on either side of one, in any direction."""
        angle = self.rng.uniform(0, 2 * math.pi)
        away_m = ASIDE_M * np.array([math.cos(angle), math.sin(angle)])
        starts_m, ends_m = np.round([centre_m + away_m, centre_m - away_m], 2).tolist()
        return [tuple(starts_m), tuple(ends_m)]


def items_case(draw: Draw, kind: str, items: list[Item], home_m: XY, **more: Any) -> Case:
    """Return a mission of items as a file, by any firmware that the format can name."""
    suffix = more.pop("suffix", None) or draw.one_of(*ITEM_FORMATS)
    firmware = "other" if suffix == ".waypoints" else draw.one_of(*FIRMWARES)
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
    is_calculated = has_calculated and draw.is_so(0.25)
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
