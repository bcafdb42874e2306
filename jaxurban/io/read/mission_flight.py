"""How MAVLink's items are flown: legs of them, and what is not understood.

Commands and frames are those of MAVLink's common message set. What an item means where autopilots differ is written
at `Flight`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from jaxurban.io.read.mission_parts import NO_HOME, Account, Datum, Leg, LonLat, Place

WAYPOINT = 16
RETURN = 20
LAND = 21
TAKEOFF = 22
SPLINE = 82
JUMP = 177
SPEED = 178
SET_HOME = 179
TAKEOFFS = (TAKEOFF, 24, 84)
LANDINGS = (LAND, 85)
LOITER_TURNS = 18
LOITER_TO_ALT = 31
LOITERS = {17: 2, LOITER_TURNS: 2, 19: 2, LOITER_TO_ALT: 1}  # and which parameter is the radius
FENCES = range(5000, 5100)
RALLY = 5100
# Commands that move nothing: regions of interest, delays and conditions, servos and relays, cameras and gimbals, ...
STILL = frozenset(
    [80, 93, 95, 112, 114, 115, 159, SPEED, 187, 188, 189, 600, 1000, 1001, 2010, 2600, 2800]
).union(
    [3000, 3001, 4501, 42600],
    range(180, 185),
    range(193, 199),
    range(200, 208),
    range(209, 213),
    range(214, 218),
    range(219, 224),
    range(530, 535),
    range(2000, 2006),
    range(2500, 2512),
)
FRAMES: dict[int, Datum] = {
    0: "geoid",
    5: "geoid",
    3: "home",
    6: "home",
    10: "ground",
    11: "ground",
}
HAS_HEIGHT = (*TAKEOFFS, WAYPOINT, *LOITERS)  # commands that lead to a height
PLACED = (*HAS_HEIGHT, *LANDINGS)


class Item(NamedTuple):
    """An item of a mission.

    Attributes:
      number: in messages.
      key: what jumps call it; None for an item that no jump can name.
      command: of MAVLink; -1 for what is none.
      params: the first four, NaN where they are not set.
      lon, lat: of its place; 0, 0 or NaN where the vehicle stays where it is.
      height_m: above ``datum``; NaN where the vehicle keeps its own.
      datum: None in frames that are not of the Earth.
      what: it is, where that is no command.
      is_straight: whether the way to it is straight, though its height is above the ground.
    """

    number: int
    key: int | None
    command: int
    params: tuple[float, ...] = ()
    lon: float = math.nan
    lat: float = math.nan
    height_m: float = math.nan
    datum: Datum | None = None
    what: str = ""
    is_straight: bool = False

    @property
    def has_place(self) -> bool:
        """Return whether it names a place, and not that where the vehicle is."""
        return self.datum is not None and self.has_coordinates

    @property
    def has_coordinates(self) -> bool:
        """Return whether numbers stand where a place does, in whatever frame."""
        is_set = not (math.isnan(self.lon) or math.isnan(self.lat))
        return is_set and (self.lon, self.lat) != (0, 0)


class Flight:
    """How an autopilot flies items: `legs` and what is `not_judged` of them.

    A multicopter climbs straight up from home to the take-off's height; PX4 flies to the take-off's place then,
    ArduPilot knows of none. It lands at the height that it has, and comes down at the landing's place. It returns at
    the return altitude, or at its own height where that is more. Where a jump leads, it flies straight from the item
    before. After an item that is not understood no place is known until the next one is reached.

    Attributes:
      legs: in the order flown.
      not_judged: a sentence for each thing that the legs leave out or may not show as it is flown.
      speed_m_s: the first speed that an item sets, None without one.
    """

    def __init__(
        self, items: Sequence[Item], home: LonLat | None, return_altitude_m: float
    ) -> None:
        """Fly all items.

        Args:
          items: in the order of the file.
          home: longitude and latitude in degrees, None where it is not known.
          return_altitude_m: metres above home, NaN where it is not known.
        """
        self.legs: list[Leg] = []
        self.not_judged: list[str] = []
        self.speed_m_s: float | None = None
        self._home = home
        self._return_altitude_m = return_altitude_m
        self._has_moved_home = False
        self._at: Place | None = None  # where the vehicle is, None while that is not known
        self._since = 0  # number of the item by which its place was lost, 0 before the first one
        self._ground = home and Place(*home, 0.0, "ground")  # that it takes off from
        self._arrivals: dict[int, Place] = {}  # where an item that has a place leads, by its number
        # Of each jump: the index of the leg that it comes before, where it begins, and its item.
        self._jumps: list[tuple[int, Place, Item]] = []
        for item in items:
            self._fly(item)
        self._add_jumps(items)
        legs: dict[int, list[int]] = {item.number: [] for item in items}
        for index, leg in enumerate(self.legs):
            legs[leg.item].append(index)
        self.accounts = [
            Account(f"item {number}", 1, tuple(own), "" if own else "it is in no leg")
            for number, own in legs.items()
        ]

    def _fly(self, item: Item) -> None:
        """Fly an item by its command, or say why it is not judged; a command that moves nothing has no effect.

        The first case that fits counts, and those of a place that cannot be read come before those of the commands.
        """
        command = item.command
        leads_somewhere = command in HAS_HEIGHT or (command in LANDINGS and item.has_coordinates)
        if leads_somewhere and item.datum is None:
            self._pass_over(item, f"command {command} in a frame that is none of the Earth")
        elif command in PLACED and math.isnan(item.lon) != math.isnan(item.lat):
            self._pass_over(item, f"command {command} at half a place")
        elif command in TAKEOFFS:
            self._take_off(item)
        elif command == WAYPOINT:
            self._fly_to(item)
        elif command in LOITERS:
            self._loiter(item)
        elif command in LANDINGS:
            self._land(item)
        elif command == RETURN:
            self._return(item)
        elif command == JUMP:
            self._jump(item)
        elif command == SET_HOME:
            self._say(
                f"item {item.number} moves home: heights above it, and a return, are not judged after it"
            )
            self._has_moved_home = True
            self._home = None
        elif command == SPEED and self.speed_m_s is None and item.params[1] > 0:
            self.speed_m_s = item.params[1]
        elif command in FENCES:
            self._say("its geofence is not judged")
        elif command == RALLY:
            self._say("its rally points are not judged")
        elif command == SPLINE:
            self._pass_over(item, "a spline waypoint")
        elif command not in STILL:
            self._pass_over(item, item.what or f"command {command}")

    def _say(self, sentence: str) -> None:
        """Note a sentence on what is not judged."""
        self.not_judged.append(sentence)

    def _pass_over(self, item: Item, what: str) -> None:
        """Say that an item is not read, by what it is (``"a spline waypoint"``), and forget where the vehicle is."""
        self._say(f"item {item.number} is {what}, which is not read")
        self._lose(item)

    def _lose(self, item: Item, ground: Place | None = None) -> None:
        """Forget where the vehicle is after an item.

        ``ground`` is where the vehicle has landed, from which a take-off may follow; None if it has not landed at a
        known place.
        """
        self._at = None
        self._since = item.number
        self._ground = ground

    def _place_of(self, item: Item) -> Place | None:
        """Return where an item leads: to its own place and height, or the vehicle's where the item leaves them out.

        The height is NaN where home was moved and the item counts from it. None where the item has no place, and that
        of the vehicle is not known.
        """
        at = self._at
        if item.has_place:
            lon, lat = item.lon, item.lat
        elif at:
            lon, lat = at.lon, at.lat
        else:
            return None
        keeps_height = math.isnan(item.height_m) or (not item.has_place and item.height_m == 0)
        if at and keeps_height:
            return Place(lon, lat, at.height_m, at.datum)
        datum = item.datum or "home"
        is_open = self._has_moved_home and datum == "home"
        return Place(lon, lat, math.nan if is_open else item.height_m, datum)

    def _fly_to(self, item: Item, place: Place | None = None) -> None:
        """Add the straight leg to a place and move the vehicle there.

        Where the vehicle's place is not known, there is no leg but a sentence; the vehicle is at the place then too.

        Args:
          item: by which it flies.
          place: where to; left out, where the item leads, to which jumps may lead then.
        """
        is_of_item = place is None
        place = place or self._place_of(item)
        if place is None:
            self._say(f"item {item.number} is flown where the vehicle is, which is not known")
            self._lose(item)
            return
        if is_of_item and item.has_place:
            self._arrivals[item.number] = place
        if self._at is None:
            self._begin(item)
        elif place != self._at:
            self.legs.append(Leg(self._at, place, "leg", item.number))
        self._at = place
        self._ground = None

    def _begin(self, item: Item) -> None:
        """Say that the way to an item is not judged: the climb from home, or the way from where the place was lost."""
        why = f"no take-off comes before item {item.number}" if self._home else NO_HOME
        if self._since:
            self._say(f"the way from item {self._since} to item {item.number} is not judged")
        else:
            self._say(f"the climb from home is not judged, as {why}")

    def _take_off(self, item: Item) -> None:
        """Climb straight up to the item's height, then fly to its place if it has one.

        The climb begins where the vehicle is, else on the ground where it stands; where neither is known, it only flies
        to the item.
        """
        start = self._at or self._ground
        if start is None:
            self._fly_to(item)
            return
        straight_up = item._replace(lon=start.lon, lat=start.lat)
        above = self._place_of(straight_up) or start
        self.legs.append(Leg(start, above, "climb", item.number))
        self._at = above
        self._ground = None
        if item.has_place:
            self._fly_to(item)

    def _loiter(self, item: Item) -> None:
        """Fly to the item and circle there, at the radius that it names; hover where it names none (0 or NaN)."""
        self._fly_to(item)
        if self._at is None:
            return
        radius_m = abs(item.params[LOITERS[item.command]])  # negative ones circle the other way
        if not radius_m > 0:  # NaN too
            radius_m = 0.0
            if item.command == LOITER_TURNS:
                self._say(f"item {item.number} circles at a radius that is the autopilot's own")
        self.legs.append(Leg(self._at, self._at, "loiter", item.number, radius_m))

    def _land(self, item: Item) -> None:
        """Fly level to above the item's place if it has one, and descend to the ground.

        Where the vehicle's place is not known, nothing is flown. After a landing its place in the air is not known, and
        a take-off begins on the ground where it has landed.
        """
        if self._at is None:
            self._begin(item)
            ground = Place(item.lon, item.lat, 0.0, "ground") if item.has_place else None
            self._lose(item, ground)
            return
        if item.has_place:
            self._fly_to(item, self._at._replace(lon=item.lon, lat=item.lat))
        ground = Place(self._at.lon, self._at.lat, 0.0, "ground")
        self.legs.append(Leg(self._at, ground, "land", item.number))
        self._lose(item, ground)

    def _return(self, item: Item) -> None:
        """Rise to the return altitude, fly home and land; a sentence says what is not known of it.

        Without a return altitude the height over home is NaN, and the vehicle flies there without a rise. It never
        sinks to the return altitude: its own height above home counts where that is more.
        """
        at = self._at
        if self._home is None or at is None:
            why = "where it begins" if self._home else "home"
            self._say(f"the return of item {item.number} is not judged: {why} is not known")
            self._lose(item)
            return
        height_m = self._return_altitude_m
        if at.datum == "home" and at.height_m > height_m:
            height_m = at.height_m
        if at.datum != "home":
            self._say(
                f"the return of item {item.number} may be higher than judged: how high it begins "
                "above home is not known"
            )

        over_home = Place(*self._home, height_m, "home")
        ground = Place(*self._home, 0.0, "ground")
        if not math.isnan(height_m):
            above = over_home._replace(lon=at.lon, lat=at.lat)
            self.legs.append(Leg(at, above, "return", item.number))
            at = above
        self.legs.append(Leg(at, over_home, "return", item.number))
        self.legs.append(Leg(over_home, ground, "land", item.number))
        self._lose(item, ground)

    def _jump(self, item: Item) -> None:
        """Note a jump that is flown at least once, for `_add_jumps`: its target may come later."""
        if item.params[1] == 0:  # how often it is flown
            return
        if self._at is None:
            self._say(f"the jump of item {item.number} is not judged: where it begins is not known")
        else:
            self._jumps.append((len(self.legs), self._at, item))

    def _add_jumps(self, items: Sequence[Item]) -> None:
        """Put the legs of jumps among the others, where they are flown.

        A jump to an item that moves nothing leads to the next item that does.
        """
        targets: dict[float | None, Item] = {}  # by the key that jumps name
        moving = None
        for item in reversed(items):
            moving = moving if item.command in STILL else item
            if moving:
                targets[item.key] = moving

        # From the last one, so that the indices of the legs before it stay.
        for index, start, item in reversed(self._jumps):
            target = targets.get(item.params[0])
            end = self._arrivals.get(target.number) if target else None
            if target is None or end is None:
                self._say(
                    f"the jump of item {item.number} is not judged: no waypoint is read there"
                )
            elif end != start:
                self.legs.insert(index, Leg(start, end, "jump", target.number))
