"""How MAVLink's items are flown: legs of them, and what is not understood.

Commands and frames are those of MAVLink's common message set. What an item means where autopilots differ is written
at `FlownItems`, after their sources: of ArduCopter ``mode_auto.cpp`` (circles), ``mode_rtl.cpp`` (returns) and
``AC_WPNav.cpp`` (legs, corners); of PX4 ``navigator/rtl.cpp`` and ``navigator/mission_block.cpp``.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from jaxurban.flights.missions.parts import (
    CORNER_M,
    ENDS_IN_AIR,
    GEOD,
    NO_HOME,
    Account,
    Autopilot,
    Datum,
    Leg,
    LonLat,
    Place,
    Profile,
)

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
OF_AEROPLANES = (84, 85, 3000)  # take-off, landing and transition of VTOL
LOITER_UNLIM = 17
LOITER_TURNS = 18
LOITER_TO_ALT = 31
# And which parameter is the radius.
LOITERS = {LOITER_UNLIM: 2, LOITER_TURNS: 2, 19: 2, LOITER_TO_ALT: 1}
# Fences and rally points.
BESIDE = dict.fromkeys(range(5000, 5100), "its geofence is not judged")
BESIDE[5100] = "its rally points are not judged"
# Commands that move nothing.
STILL = frozenset([SPEED]).union(
    [80, *range(194, 199)],  # regions of interest, and the direction of driving
    [93, 95, 112, 114, 115, 159],  # delays and conditions, and the last of both
    [*range(180, 185), 187],  # a parameter, relays, servos, actuators
    [
        188,
        189,
        600,
    ],  # marks: where the way of a return, or a landing, begins, and where a jump may lead
    range(200, 208),  # video, cameras, mounts; the geofence
    range(209, 213),  # a test of motors, inverted flight, gripper, autotune
    range(214, 218),  # intervals of the camera, sprayer, scripts
    range(219, 224),  # mounts, limits of another controller, engine
    [*range(530, 535), 1000, 1001],  # modes of the camera, gimbals
    [*range(2000, 2006), 2010, 2800],  # pictures, tracking by the camera, panorama
    [*range(2500, 2512), 2600],  # video, logging, telemetry
    [3000, 3001, 4501, 42600],  # transition of VTOL, arming, a gate that is waited for, winch
)
FRAMES: dict[int, Datum] = {
    0: "geoid",
    5: "geoid",
    3: "home",
    6: "home",
    10: "ground",
    11: "ground",
}
MOST_FLOWN = 1_000_000  # after so many flown items, repeated ones counted too, jumps are not followed any more
# So near to a circle's centre, as a share of its radius and in metres, ArduPilot begins the circle in the direction in
# which it is headed.
NEAR_CENTRE = 0.05
NEAR_CENTRE_M = 1.0
# ArduPilot stores radii up to this one in whole metres, and larger ones in tens of metres.
MOST_RADIUS_M = 255.0
# Heights of a return near home, by the autopilots' defaults. ArduCopter (mode_rtl.cpp, compute_return_target): no
# higher than RTL_CONE_SLOPE times the distance, nor lower than RTL_ALT_MIN (2 m; 0.3 m from 4.6 on). PX4 (rtl.cpp,
# calculate_return_alt_from_cone_half_angle): within RTL_MIN_DIST no higher than the distance by the tangent of
# RTL_CONE_ANG, 45 degrees; within twice NAV_ACC_RAD it is up to 2 m higher than that, which does not count here.
CONE_SLOPE, LEAST_RETURN_M = 3.0, 2.0
CONE_REACH_M = 10.0
DJI_NEAR_M = (
    50.0  # from home, within which most of DJI's drones return at the height that they have
)
HAS_HEIGHT = (*TAKEOFFS, WAYPOINT, *LOITERS)  # commands whose items have a height to fly to
PLACED = (*HAS_HEIGHT, *LANDINGS)


class Item(NamedTuple):
    """An item of a mission.

    Attributes:
      number: by which messages name the item.
      key: the number by which jumps name the item; None if no jump can name it.
      command: number of the MAVLink command; -1 for an item that holds none.
      params: the first four parameters of the command; a parameter that is not set is NaN.
      lon, lat: the item's place in degrees; 0, 0 or NaN if the vehicle stays where it is.
      height_m: height above ``datum``; NaN if the vehicle keeps the height that it has.
      datum: what ``height_m`` is above; None in frames that are not of the Earth.
      what: names an item without a command in messages.
      is_straight: whether the way to the item is straight although its height is above the ground.
      goes_on: whether the next item follows by itself; ArduPilot does not look at it, and PX4 waits where it does not.
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
    goes_on: bool = True

    @property
    def has_place(self) -> bool:
        """Whether the item names a place of its own; without one the vehicle stays where it is."""
        return self.datum is not None and self.has_coordinates

    @property
    def has_coordinates(self) -> bool:
        """Whether the item holds longitude and latitude, whatever its frame is."""
        return not math.isnan(self.lon + self.lat) and (self.lon, self.lat) != (0, 0)


class State(NamedTuple):
    """What a vehicle's next item depends on.

    Attributes:
      home: longitude and latitude in degrees; None if home is not known.
      ground: the place on the ground from which the vehicle takes off; None if it has not landed at a known place.
      at: where the vehicle is; None while that is not known.
      since: number of the item after which the vehicle's place was not known any more; 0 before the first item.
      has_moved_home: whether an item has moved home, so that heights above home are not known.
    """

    home: LonLat | None
    ground: Place | None
    at: Place | None = None
    since: int = 0
    has_moved_home: bool = False


class FlownItems:
    """Items as an autopilot flies them: `legs`, what is `not_judged` of them, and an account of each item.

    A multicopter climbs straight up from home to the take-off's height; PX4 flies to the take-off's place then,
    ArduPilot knows of none. It lands at the height that it has, and comes down at the landing's place. After an item
    that is not understood no place is known until the next one is reached.

    A circle (`LOITER_TURNS`) is refused by PX4, and taken as a stop at its centre. ArduPilot flies to the nearest point
    of the circle and, after whole turns, on from there. Every other loiter is a stop at its place, and a circle around
    it as an aeroplane would fly.

    A return rises to the return altitude, or keeps its own height where that is more. Near home the autopilots rise
    less by their defaults: that is a variant.

    Jumps are flown as often as they say, straight from the item before to their target. What follows where the flight
    stays, or comes round without end, is not flown. A height that an item leaves open is that with which the vehicle
    comes to it, each time it does. After the last item autopilots hover where they are.

    Attributes:
      legs: the legs in the order flown, each once.
      not_judged: a sentence for each thing that the legs leave out, or may not show as it is flown.
      notes: sentences on what to know of it, such as that it ends in the air.
      speed_m_s: the first speed that an item sets; None if no item sets one.
      accounts: what became of each item.
      autopilot, return_altitude_m: by which it is flown; see `Mission`.
    """

    def __init__(
        self,
        items: Sequence[Item],
        home: LonLat | None,
        return_altitude_m: float,
        autopilot: Autopilot,
    ) -> None:
        """Fly all items.

        Args:
          items: the items in the order of the file.
          home: longitude and latitude in degrees; None if home is not known.
          return_altitude_m: metres above home; NaN if the return altitude is not known.
          autopilot: which one flies the items.
        """
        self.legs: list[Leg] = []
        self.not_judged: list[str] = []
        self.notes: list[str] = []
        self.speed_m_s: float | None = None
        self._items = items
        self.autopilot = autopilot
        self.return_altitude_m = return_altitude_m
        self._state = State(home, home and Place(*home, 0.0, "ground"))
        # By the index of an item and the state before it.
        self._after: dict[tuple[int, State], State] = {}
        self._why: dict[int, str] = {}  # the first sentence on an item, by its number
        self._why_ended = ""  # the sentence on what is never flown
        self._number = 0  # of the item that is flown
        self._is_jump = False  # it is flown to from a jump
        self._run()
        self.accounts = self._accounts()
        if self._state.at and not self._why_ended:
            last = self.legs[-1].item if self.legs else self._number
            self.notes.append(ENDS_IN_AIR.format("item", last))

    def _run(self) -> None:
        """Fly all items and their jumps, until the last one.

        A jump without end is not flown again where the vehicle comes to it as before: all that follows was flown then,
        and the flight has no end.
        """
        index_of: dict[float | None, int] = {
            item.key: index for index, item in enumerate(self._items)
        }
        flown: Counter[int] = Counter()  # how often jumps were flown
        rounds: set[tuple[int, State, int]] = set()  # in which they were flown
        index = num_flown = num_counted = 0  # the last: jumps flown that end
        while index < len(self._items) and num_flown < MOST_FLOWN:
            item = self._items[index]
            self._number = item.number
            num_flown += 1
            if item.command != JUMP:
                key = index, self._state
                if key in self._after:  # flown from the same state before: it adds nothing
                    self._state = self._after[key]
                    self._is_jump &= self._state == key[1]
                else:
                    self._fly(item)
                    self._after[key] = self._state
                if self._stays_at(item):
                    return
                index += 1
                continue
            target_key, times, *_ = item.params
            target = index_of.get(target_key)
            way = index, self._state, num_counted
            is_endless = not times >= 0  # NaN, too
            if is_endless and way in rounds:
                self._end(item, "jumps without end")
                return
            is_left = is_endless or flown[index] < times
            if is_left and target is not None:
                flown[index] += 1
                num_counted += times > 0
                rounds.add(way)
                self._is_jump = True
                index = target
                continue
            if is_left:
                self._say(f"the jump of item {item.number} is not judged: no item is its target")
            index += 1
        if num_flown == MOST_FLOWN:
            self._say("its jumps are flown more often than is followed")

    def _stays_at(self, item: Item) -> bool:
        """Return whether the vehicle stays at an item for good, and say so."""
        if item.command == LOITER_UNLIM:
            self._end(item, "circles without end")
        elif not item.goes_on and self.autopilot != "ardupilot":
            self._end(item, "does not go on by itself (autoContinue)")
        return bool(self._why_ended)

    def _end(self, item: Item, does: str) -> None:
        """Say that what follows an item is never flown, for what it does."""
        self._say(
            f"item {item.number} {does}, so the flight has no end: what follows is not flown, and not judged"
        )
        self._why_ended = self.not_judged[-1]

    def _accounts(self) -> list[Account]:
        """Return what became of each item: its legs, or the sentence on it, or that it moves nothing."""
        legs_of: defaultdict[int, list[int]] = defaultdict(list)
        for index, leg in enumerate(self.legs):
            legs_of[leg.item].append(index)
        reached = {self._items[index].number for index, _ in self._after}
        accounts = []
        for item in self._items:
            legs = tuple(legs_of[item.number])
            passed = self._why_ended or "jumps pass over it"
            still = "it moves nothing" if item.number in reached else passed
            why = "" if legs else self._why.get(item.number, still)
            accounts.append(Account(f"item {item.number}", 1, legs, why))
        return accounts

    def _fly(self, item: Item) -> None:
        """Fly an item by its command, or say why it is not judged; a command that moves nothing has no effect.

        The first case that fits counts, and those of a place that cannot be read come before those of the commands.
        """
        command = item.command
        if command in OF_AEROPLANES:
            self._say(
                f"item {item.number} is flown as an aeroplane, whose turns and glide path are not judged"
            )
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
        elif command == SET_HOME:
            self._say(
                f"item {item.number} moves home: heights above it, and a return, are not judged after it"
            )
            self._state = self._state._replace(home=None, has_moved_home=True)
        elif command == SPEED and self.speed_m_s is None and item.params[1] > 0:
            self.speed_m_s = item.params[1]
        elif command in BESIDE:
            self._say(BESIDE[command])
        elif command == SPLINE:
            self._pass_over(item, "a spline waypoint")
        elif command not in STILL:
            self._pass_over(item, item.what or f"command {command}")

    def _say(self, sentence: str) -> None:
        """Note a sentence on what is not judged."""
        self.not_judged.append(sentence)
        self._why.setdefault(self._number, sentence)

    def _pass_over(self, item: Item, what: str) -> None:
        """Say that an item is not read, by what it is (``"a spline waypoint"``), and forget where the vehicle is."""
        self._say(f"item {item.number} is {what}, which is not read")
        self._lose(item)

    def _lose(self, item: Item, ground: Place | None = None) -> None:
        """Forget where the vehicle is after an item.

        ``ground`` is where the vehicle has landed, from which a take-off may follow; None if it has not landed at a
        known place.
        """
        self._state = self._state._replace(at=None, since=item.number, ground=ground)

    def _move(self, item: Item, place: Place, kind: str = "leg") -> None:
        """Add the leg to a place, if the vehicle is elsewhere, and move it there.

        Args:
          item: the item that the vehicle flies to.
          place: where the leg ends.
          kind: of the leg; see `Leg`.
        """
        at = self._state.at
        assert at is not None
        if self._is_jump and kind == "leg":
            kind = "jump"
        self._is_jump = False
        profile: Profile = "straight" if item.is_straight else "frame"
        if at != place:
            turn_m = self._turn_m(item)
            self.legs.append(Leg(at, place, kind, item.number, profile=profile, turn_m=turn_m))
        self._state = self._state._replace(at=place, ground=None)

    def _place_of(self, item: Item) -> Place | None:
        """Return where an item leads: its own place and height, or those of the vehicle if the item leaves them out.

        The height is NaN if it is above a home that was moved. The result is None if the item has no place and the
        place of the vehicle is not known.
        """
        at = self._state.at
        where = item if item.has_place else at
        if where is None:
            return None
        lon, lat = where.lon, where.lat
        keeps_height = math.isnan(item.height_m) or (not item.has_place and item.height_m == 0)
        if at and keeps_height:
            if item.has_place and (at.datum == "ground") != (item.datum == "ground"):
                self._say(
                    f"item {item.number} keeps its height, and whether above the ground or level is not known"
                )
            return at._replace(lon=lon, lat=lat)
        if at and item.height_m == 0 and self.autopilot == "ardupilot":
            return _kept(at, lon, lat, item.datum)
        datum = item.datum or "home"
        is_open = self._state.has_moved_home and datum == "home"
        return Place(lon, lat, math.nan if is_open else item.height_m, datum)

    def _turn_m(self, item: Item) -> float:
        """Return how near to an item, in metres, the vehicle turns to the next one; 0 if it stops at the item.

        PX4 turns as early as the waypoint's own radius says, ArduPilot always at its default.
        """
        if item.command != WAYPOINT:
            return CORNER_M
        if item.params[0] > 0:
            return 0.0
        return CORNER_M if self.autopilot == "ardupilot" else max(CORNER_M, item.params[1])

    def _fly_to(self, item: Item, place: Place | None = None) -> None:
        """Add the straight leg to a place and move the vehicle there.

        Where the vehicle's place is not known, a sentence says so instead of a leg. The vehicle is at the place
        afterwards all the same.

        Args:
          item: the item that the vehicle flies to.
          place: where the leg ends; left out, where the item leads.
        """
        place = place or self._place_of(item)
        if place is None:
            self._say(f"item {item.number} is flown where the vehicle is, which is not known")
            self._lose(item)
        elif self._state.at is None:
            self._begin(item)
            self._state = self._state._replace(at=place, ground=None)
        else:
            self._move(item, place)

    def _begin(self, item: Item) -> None:
        """Say that the way to an item is not judged: the climb from home, or the way from where the place was lost."""
        since = self._state.since
        why = f"no take-off comes before item {item.number}" if self._state.home else NO_HOME
        if since:
            self._say(f"the way from item {since} to item {item.number} is not judged")
        else:
            self._say(f"the climb from home is not judged, as {why}")

    def _take_off(self, item: Item) -> None:
        """Climb straight up to the item's height, then fly to its place if it has one; ArduPilot knows of none.

        The climb begins where the vehicle is, else on the ground where it stands; where neither is known, it only flies
        to the item. Drones of DJI climb at least to a height above home, the first parameter, and fly level.
        """
        if self.autopilot == "ardupilot":
            item = item._replace(lon=0.0, lat=0.0)
        start = self._state.at or self._state.ground
        if start is None:
            self._fly_to(item)
            return
        above = self._place_of(item._replace(lon=start.lon, lat=start.lat)) or start
        place = None
        if self.autopilot == "dji":
            above = Place(start.lon, start.lat, item.params[0], "home", level_with=above)
            place = above._replace(lon=item.lon, lat=item.lat)
        self._state = self._state._replace(at=start)
        self._move(item, above, "climb")
        if item.has_place:
            self._fly_to(item, place)

    def _loiter(self, item: Item) -> None:
        """Fly to the item and circle there, at the radius that it names; hover where it names none (0 or NaN).

        ArduPilot's turns are flown from the nearest point of the circle, all others from the centre.
        """
        centre = self._place_of(item)
        if centre is None:
            self._fly_to(item)
            return
        # Negative radii circle the other way; NaN becomes 0, too.
        radius_m = max(0.0, abs(item.params[LOITERS[item.command]]))
        is_turns = item.command == LOITER_TURNS
        has_edge = is_turns and radius_m > 0 and self.autopilot == "ardupilot"
        edge = None
        at = self._state.at
        if has_edge and at and not 0 < item.params[0] < 1:
            edge = _edge(at, centre, radius_m)
        begin = edge or centre
        if item.command == LOITER_TO_ALT and at and self.autopilot == "px4":  # climbs there
            self._fly_to(item, _kept(at, centre.lon, centre.lat, "geoid"))
        self._fly_to(item, begin)
        self.legs.append(Leg(begin, centre, "loiter", item.number, radius_m))
        if is_turns and not radius_m:
            self._say(f"item {item.number} circles at a radius that is the autopilot's own")
        elif has_edge and (radius_m % 1 or radius_m > MOST_RADIUS_M):
            self._say(f"item {item.number} circles at {radius_m:g} m, which ArduPilot rounds down")
        elif has_edge and edge is None:
            self._say(
                f"the way out of the circle of item {item.number} is not judged: where it begins is not known"
            )

    def _land(self, item: Item) -> None:
        """Fly level to above the item's place if it has one, and descend to the ground.

        Where the vehicle's place is not known, nothing is flown. After a landing its place in the air is not known, and
        a take-off begins on the ground where it has landed.
        """
        at = self._state.at
        if at is None:
            self._begin(item)
            ground = Place(item.lon, item.lat, 0.0, "ground") if item.has_place else None
            self._lose(item, ground)
            return
        if item.has_place:
            # PX4 flies level; ArduPilot in the frame of the item, so that it may follow the ground.
            datum = "geoid" if self.autopilot == "px4" else item.datum
            at = _kept(at, item.lon, item.lat, datum)
            self._fly_to(item, at)
        ground = Place(at.lon, at.lat, 0.0, "ground")
        self._move(item, ground, "land")
        self._lose(item, ground)

    def _return(self, item: Item) -> None:
        """Rise to the return altitude, fly home and land; where home or the vehicle's place is not known, say so.

        Autopilots return at different heights. The way at the greatest of them is flown; those at the others are
        variants.
        """
        home, at = self._state.home, self._state.at
        if home is None or at is None:
            why = "where it begins" if home else "home"
            self._say(f"the return of item {item.number} is not judged: {why} is not known")
            self._lose(item)
            return
        ground = Place(*home, 0.0, "ground")
        _, _, apart_m = GEOD.inv(at.lon, at.lat, *home)
        heights_m = levels_m(self.autopilot, apart_m, self.return_altitude_m)
        for level_m in heights_m:
            is_variant = level_m < heights_m[-1]
            # It rises first, or stays as high as it is where that is more, then flies home level. Where the height is
            # not known, it flies home without a rise and arrives at a height that is not known.
            above = Place(at.lon, at.lat, level_m, "home", level_with=at)
            way = [at, above, Place(*home, level_m, "home", level_with=at)]
            if math.isnan(level_m):
                way = [at, Place(*home, level_m, "home")]
            for start, end in pairwise((*way, ground)):
                kind = "land" if end == ground else "return"
                if start != end:
                    self.legs.append(Leg(start, end, kind, item.number, is_variant=is_variant))
        self._lose(item, ground)


def levels_m(autopilot: Autopilot, apart_m: float, altitude_m: float) -> list[float]:
    """Return the heights above home at which a return may be flown, the lowest first.

    INAV knows of no cone. Where the return altitude is not known, NaN is the only height.

    Args:
      autopilot: which returns; those of ArduPilot and PX4 count where it is not known.
      apart_m: how far the place where the return begins is from home.
      altitude_m: the return altitude, above home.
    """
    if math.isnan(altitude_m):
        return [altitude_m]
    if autopilot == "dji":
        return [0.0, altitude_m] if apart_m <= DJI_NEAR_M else [altitude_m]
    heights_m = {altitude_m}
    if autopilot in ("ardupilot", "unknown"):
        heights_m.add(min(altitude_m, max(CONE_SLOPE * apart_m, LEAST_RETURN_M)))
    if autopilot in ("px4", "unknown") and apart_m <= CONE_REACH_M:
        heights_m.add(min(altitude_m, apart_m))
    return sorted(heights_m)


def _kept(at: Place, lon: float, lat: float, datum: Datum | None) -> Place:
    """Return a place at the height of another: above the ground where ``datum`` is the ground, else above the sea."""
    if (at.datum == "ground") == (datum == "ground"):
        return at._replace(lon=lon, lat=lat)
    return Place(lon, lat, math.nan, datum or "geoid", level_with=at)


def _edge(start: Place, centre: Place, radius_m: float) -> Place | None:
    """Return the nearest point of a circle, at the height of its centre; None from where ArduPilot's is not known."""
    azimuth_deg, _, apart_m = GEOD.inv(centre.lon, centre.lat, start.lon, start.lat)
    if apart_m < max(NEAR_CENTRE_M, NEAR_CENTRE * radius_m):
        return None
    lon, lat, _ = GEOD.fwd(centre.lon, centre.lat, azimuth_deg, radius_m)
    return centre._replace(lon=lon, lat=lat)
