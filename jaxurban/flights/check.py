"""check: whether a mission that another tool made is safe to fly over maps, as far as these know."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.checks import finite, typed, values_given
from jaxurban.errors import InputError
from jaxurban.flights.by_autopilot import as_one, concatenated
from jaxurban.flights.check_result import MissionCheck, begins_said, flown_by
from jaxurban.flights.contacts import Prisms, buildings_of
from jaxurban.flights.flown import figures_of
from jaxurban.flights.item_returns import by_item, departures_of, return_lines
from jaxurban.flights.judge import SPAN, below_home, judged, placed, unjudged_stretches
from jaxurban.flights.legs import Flight, flight_of
from jaxurban.flights.missions.mission import read_mission
from jaxurban.flights.missions.parts import Datum, Leg, LonLat, Mission, Place
from jaxurban.io.city import City
from jaxurban.io.zone import check_reach, unknown_cautions
from jaxurban.kernels.tolerances import FILE_MARGIN_M, GROUND_TOLERANCE_M
from jaxurban.knowledge import GuessKind
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.maps.sources import Standing, left_out, standing_on
from jaxurban.paths.ceiling import CEILING_M
from jaxurban.paths.clearance import reaches_m
from jaxurban.paths.closed import constraints_of
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import rules_on
from jaxurban.settings import FlownBy, Vehicle, as_tuple, iso_utc, not_negative, parse_time

MOST_HOME_OFF_M = 20.0  # by which elevation models of a place may differ
CHANGED = "The files that the maps were made of have changed since: what stands now is not judged."
ZONES_NOT_COUNTED = (
    "No-fly zones are not counted in these returns: look whether a straight way home crosses one."
)
IN_THE_AIR = "a path begins and ends in the air, so its climb and landing are not judged: check the .plan of it"


@typed
def check(
    maps: MapsLike,
    mission: str | Path | Mission | PlannedPath,
    *,
    heights: Datum | None = None,
    home: LonLat | None = None,
    home_above_ground_m: float | None = None,
    return_altitude_m: float | None = None,
    autopilot: FlownBy | None = None,
    geoid_m: float | None = None,
    constraints: Constraints | None = None,
    time: str | Sequence[str] | None = None,
    time_of_day: str | None = None,
    max_no_fix_m: float | None = None,
    max_people: float | None = None,
    ceiling_m: int = CEILING_M,
    sources: City | str | Path | None = None,
) -> MissionCheck:
    """Return the findings of a mission over maps, whatever tool made it, with what cannot be judged and figures.

    Buildings count by their exact outlines, read again from the files that the run of the maps recorded, or from
    ``sources``. Where these are gone, the cells that roofs touch count instead, and the result says so. A roof has its
    height above the ground at each of its points.

    Findings are contacts with buildings or the ground, places that are nearer than the clearances allow, no-fly zones,
    breaches of a geofence that a ``.plan`` holds, closed cells, and limits that are exceeded; all else is a figure.
    Parts of a mission are not judged if the reader did not understand them, if they lie outside the maps, over cells
    without data or beyond the maps' altitudes (except for take-off and landing), or if they pass over a guessed roof or
    within the clearance of one.

    Where the file does not say which autopilot flies it, as no ``.waypoints`` does, it is judged as ArduPilot and as
    PX4 fly it, and the worse counts. What only one of them meets is named by it.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      mission: a file (``.plan``, ``.waypoints``, ``.kmz``, ``.wpml``, ``.kml``, ``.gpx``, ``.geojson``, ``.csv``,
        ``.ulg``), a `Mission` that was read from one, or a path from `plan`: its legs in the air, whose climb and
        landing are not judged.
      heights: the level from which heights count where the file leaves it open: ``"home"``, ``"ground"``, ``"geoid"``
        or ``"ellipsoid"``.
      home: longitude and latitude of home, for a file that has none.
      home_above_ground_m: how high home lies above the ground, for a flight that starts from a roof: heights above home
        count from there. Left out, home is on the ground.
      return_altitude_m: height above home at which the vehicle returns, for a file that has none.
      autopilot: ``"ardupilot"`` or ``"px4"``, for a file that names none.
      geoid_m: height of the geoid above the ellipsoid, for heights above the ellipsoid.
      constraints: zones, bounds, clearances and vehicle; left out, those that a path was planned under, and of a file
        those of the maps' scenario.
      time: one or several UTC times of the flight. The GPS maps of these times count, and the zones that are in force
        at one of them. Left out, the maps' first time and every zone count.
      time_of_day: of the map of people; the first if left out.
      max_no_fix_m: most metres without a position fix that are allowed, at the worst of the times.
      max_people: most people overflown that are allowed, in a strip of 10 m.
      ceiling_m: whole metres above the ground, which no height that clears a finding exceeds, and no return altitude
        to type.
      sources: the City, or the folder at which the recorded files' paths begin.

    Returns:
      `MissionCheck`, whose ``state`` is ``"clean"`` only if every leg was judged and nothing was found.

    Raises:
      InputError: a file that cannot be read, leaves open what heights are above or names another autopilot, a time that
        the maps do not hold, a wrong limit, or sources that are named and are not those of the maps.

    Examples:
      >>> flight = ju.plan(maps, start, goal, altitude_m=60.0, snap=True, on_ground=True)
      >>> flight.save("mission.plan").name
      'mission.plan'
      >>> print(ju.check(maps, "mission.plan", sources=city, max_people=100).sentence)
      Clean: every leg was judged, and nothing was found.
      >>> result = ju.check(maps, "mission.plan", sources=city, max_people=30)
      >>> print(result.sentence)
      Findings: 1.
      >>> result.findings[["kind", "what"]].to_dict("records")
      [{'kind': 'limit', 'what': '69 people overflown; the limit is 30'}]
    """
    # The arguments, the mission as it was read, and the times of the flight: None stands for the maps' first time.
    maps = as_maps(maps)
    for name, value in values_given({"max_no_fix_m": max_no_fix_m, "ceiling_m": ceiling_m}).items():
        not_negative(name, value)
    if max_people is not None:
        not_negative("max_people", max_people, "people")
    if isinstance(mission, PlannedPath):
        constraints = constraints or constraints_of(mission)
    of_file: dict[str, Any] = {
        "heights": heights,
        "home": home,
        "return_altitude_m": return_altitude_m,
        "autopilot": autopilot,
    }
    mission = _mission_of(mission, values_given(of_file), home_above_ground_m)
    if home is not None and maps.grid.is_swapped(*home[:2]):
        raise InputError(f"home: {maps.grid.outside_said(*home[:2])}")
    if geoid_m is not None:
        _check_geoid(mission, geoid_m)
    named_times = () if time is None else as_tuple(time)
    times: list[str | None] = [iso_utc(text) for text in named_times] or [None]

    # Constraints: those of the argument, with the geofence. What is still left out is as in the maps' scenario. Of the
    # zones those count that are in force.
    limits = constraints or Constraints()
    zones = (*limits.zones, *mission.zones)
    _, _, limits = rules_on(maps, None, replace(limits, zones=zones), "")
    limits = _in_force(limits, named_times)
    check_reach(limits.zones, maps.grid)
    num_in_force = sum(zone.state != "open" for zone in limits.zones)
    figures = {"num_zones": len(zones), "num_zones_in_force": num_in_force}

    # What is found along the mission, which parts of it are unknown, and the figures; limits are on figures.
    standing = standing_on(maps, sources)
    city = standing.city
    known = shapely.box(*maps.grid.bounds_m)
    if city and not standing.reason:  # a raster of plants is looked at in the maps' cells alone
        known = shapely.intersection(known, city.known_ground) if city.plants else city.known_ground
    buildings = buildings_of(maps, city)
    found, unknown, unjudged, flown, departures = {}, {}, {}, {}, []
    for name, way in mission.ways.items():
        flight = flight_of(way, Elevation(maps, city), geoid_m)
        findings, parts, legs = judged(
            flight, buildings, known, limits, times, time_of_day, ceiling_m
        )
        numbers = figures | figures_of(flight, maps, times, time_of_day)
        exceeded, open_limits = _against_maxima(flight, numbers, max_no_fix_m, max_people)
        open_limits += unknown_cautions(limits.zones)
        found[name] = concatenated([findings, exceeded])
        unjudged[name] = unjudged_stretches(parts, flight)
        unknown[name] = _not_judged(maps, standing, flight, buildings, unjudged[name], open_limits)
        notes = [*way.notes, *_height_notes(flight), *_home_notes(flight, buildings), *legs]
        flown[name] = replace(flight, mission=replace(way, notes=tuple(notes))), numbers
        departures.append(departures_of(flight, buildings, known, limits))

    # Of two autopilots that with the most findings, and what the other one meets.
    flight, numbers = flown[max(found, key=lambda name: len(found[name]))]
    not_judged = as_one(unknown)
    returns = pd.concat(departures)
    lines = return_lines(returns, flight, ceiling_m)
    if lines and num_in_force:
        lines.append(ZONES_NOT_COUNTED)
    return MissionCheck(
        findings=as_one(found),
        not_judged=[
            *map(flown_by, not_judged["autopilot"], not_judged["what"] + not_judged["where"])
        ],
        figures=numbers,
        outlines=standing.outlines + flight.ground_note,
        limits=limits.to_dict(),
        flight=flight,
        maps=maps,
        zones=limits.zones,
        left_out=left_out(maps, city),
        return_altitudes=by_item(returns),
        return_lines=lines,
        unjudged=as_one(unjudged),
    )


def _in_force(limits: Constraints, times: Sequence[str]) -> Constraints:
    """Return constraints with the zones open that do not count for a flight, each as if it were always in force.

    Args:
      limits: the constraints.
      times: UTC times of the flight. A zone counts if it is in force at one of them; without times every zone counts.
    """
    moments = [parse_time(text) for text in times]
    zones = [zone.at(moments) for zone in limits.zones]
    return replace(limits, zones=tuple(replace(zone, start=None, end=None) for zone in zones))


def _swapped(mission: Mission, maps: MetricMaps) -> list[str]:
    """Return a sentence on the first item of a mission that lies on maps with longitude and latitude swapped."""
    grid = maps.grid
    lon, lat = np.array([leg.end[:2] for leg in mission.legs]).T
    is_on = grid.contains_xy(*grid.xy_of_lonlat(lon, lat))
    is_swapped = ~is_on & grid.contains_xy(*grid.xy_of_lonlat(lat, lon))
    return [
        f"Item {mission.legs[number].item} lies elsewhere: {grid.outside_said(lon[number], lat[number])}."
        for number in np.flatnonzero(is_swapped)[:1]
    ]


def _above_roof(flight: Flight, buildings: Prisms) -> list[str]:
    """Return a sentence where home is named higher above the ground than any roof there is known to be."""
    above_m = flight.mission.home_above_ground_m
    is_there = below_home(flight, buildings) & ~buildings.is_guessed
    roof_m = buildings.top_m[is_there].max(initial=0.0)
    if flight.mission.home is None or above_m <= roof_m + FILE_MARGIN_M:
        return []
    return [
        f"Home is said to be {above_m:.1f} m above the ground, and the known roofs there reach {roof_m:.1f} m, so the "
        "flight may be lower than judged: correct home_above_ground_m (--heights home_above_ground_m=METRES)."
    ]


def _height_notes(flight: Flight) -> list[str]:
    """Return a sentence where legs are higher above the ground than most countries allow."""
    most_m = flight.steps.z_m.max(initial=0.0, where=np.isfinite(flight.steps.z_m))
    if most_m <= CEILING_M + GROUND_TOLERANCE_M:
        return []
    return [
        f"Legs reach {most_m:.0f} m above the ground, over the {CEILING_M} m that most countries allow: if the heights "
        "were meant in feet, give them in metres."
    ]


def _home_notes(flight: Flight, buildings: Prisms) -> list[str]:
    """Return a sentence where home is inside a known building, with what to name and the nearest free cell."""
    mission, maps = flight.mission, flight.ground.maps
    if mission.home is None:
        return []
    home_m = np.array(maps.grid.xy_of_lonlat(*mission.home))
    above_m = mission.home_above_ground_m + FILE_MARGIN_M
    is_there = shapely.intersects(buildings.polygons, shapely.Point(home_m))
    is_there &= (buildings.floor_m <= above_m) & (buildings.top_m > above_m)
    if not is_there.any():
        return []
    where = ""
    cells = np.argwhere(np.maximum(*reaches_m(maps, 0.0, "highest")) <= 0)
    if len(cells):
        away_m = np.linalg.norm(np.column_stack(maps.grid.xy_of_cell(*cells.T)) - home_m, axis=1)
        lon, lat = maps.grid.lonlat_of_cell(*cells[away_m.argmin()])
        where = f" (--home {lon:.6f},{lat:.6f} is the nearest free cell, {away_m.min():.0f} m away)"
    return [
        f"Home is inside a building of {buildings.top_m[is_there].max():.1f} m: if it is on the roof, name its height "
        f"(home_above_ground_m, --heights home_above_ground_m=METRES), else move it to free ground{where}."
    ]


def _not_judged(
    maps: MetricMaps,
    standing: Standing,
    flight: Flight,
    buildings: Prisms,
    unjudged: pd.DataFrame,
    open_limits: list[str],
) -> pd.DataFrame:
    """Return sentences on what of a flight cannot be judged, by the maps, by its mission and by limits.

    The columns are ``what``, and ``where`` it begins along the mission, ``""`` of what has no place.

    Args:
      maps: the maps.
      standing: what is known of what stands on them.
      flight: over the maps.
      buildings: that it was judged against.
      unjudged: its stretches that are not judged (`unjudged_stretches`).
      open_limits: sentences on limits that are not judged.
    """
    mission = flight.mission
    sentences = [CHANGED] * standing.has_changed
    for guess in maps.guesses:
        if guess.kind is GuessKind.WITHOUT_SHAPE:
            sentences.append(f"{guess.name}.")
    if mission.home is not None and maps.grid.is_swapped(*mission.home):
        sentences.append(f"Home lies elsewhere: {maps.grid.outside_said(*mission.home)}.")
    if len(flight.lines_m):  # else the state says where the mission lies
        sentences += _swapped(mission, maps)
    sentences += _above_roof(flight, buildings)
    sentences += [f"{text[:1].upper()}{text[1:]}." for text in mission.not_judged]
    if not mission.legs:
        sentences.append("The mission holds no leg.")
    if flight.home_off_m > MOST_HOME_OFF_M:
        sentences.append(
            f"Home is {flight.home_off_m:.0f} m from the ground of the maps by the elevation in the file, so heights "
            "above the sea may be off by as much."
        )
    if mission.num_lost:
        sentences.append(
            f"{mission.num_lost:,} things of the file are in no leg and in no reason here."
        )
    where = {}
    for reason, rows in unjudged.groupby("reason", sort=False):
        sentence = f"{(rows['to_m'] - rows['along_m']).sum():,.0f} m {reason}."
        sentences.append(sentence)
        where[sentence] = begins_said(rows)
    sentences += open_limits
    for guess in maps.guesses:
        if standing.reason and guess.kind is GuessKind.WITHOUT_DATA:
            sentences.append(
                f"The city is gone, and with it where what it leaves open lies: {guess.name}."
            )
    return pd.DataFrame(
        {"what": sentences, "where": [where.get(text, "") for text in sentences]}, dtype=object
    )


def _mission_of(
    mission: str | Path | Mission | PlannedPath,
    of_file: Mapping[str, Any],
    home_above_ground_m: float | None,
) -> Mission:
    """Return what is checked as a mission: read from its file, or of a planned path the legs in the air.

    Args:
      mission: as of `check`.
      of_file: keywords of `read_mission` that are given.
      home_above_ground_m: how high home lies above the ground; None: as the mission has it.

    Raises:
      InputError: as `read_mission`, keywords without a file, a path that is none, or a height of a home that is none.
    """
    if isinstance(mission, str | Path):
        mission = read_mission(mission, **of_file)
    elif of_file:
        raise InputError(
            "heights, home, return_altitude_m and autopilot are of a file, and mission was read already: leave them out"
        )
    if isinstance(mission, PlannedPath):
        mission = _in_the_air(mission)
    if home_above_ground_m is None:
        return mission
    if mission.home is None:
        raise InputError(
            "home_above_ground_m is of a home, and the mission has none: name it (home, --home)"
        )
    above_m = not_negative("home_above_ground_m", home_above_ground_m)
    return replace(mission, home_above_ground_m=above_m)


def _check_geoid(mission: Mission, geoid_m: float) -> None:
    """Raise InputError where the geoid's height is no number, or no leg has a height above the ellipsoid."""
    finite("geoid_m", geoid_m)
    if "ellipsoid" not in mission.datums:
        raise InputError(
            f"{mission.name!r} has no height above the ellipsoid: leave geoid_m (--heights geoid_m=) out"
        )


def _in_the_air(path: PlannedPath) -> Mission:
    """Return a planned path as a mission: its legs in the air, above the ground.

    Raises:
      InputError: there is no path.
    """
    if not path.status.has_path:
        raise InputError(f"there is no path to check: {path.status.sentence}")
    points = np.column_stack([path.lonlat, path.z_m]).tolist()
    places = [Place(lon, lat, z_m, "ground") for lon, lat, z_m in points]
    pairs = pairwise(places if len(places) > 1 else places * 2)
    return Mission(
        f"path of {path.search.planner}",
        legs=tuple(Leg(*pair, "leg", number) for number, pair in enumerate(pairs, start=2)),
        home=None,
        home_elevation_m=None,
        not_judged=(IN_THE_AIR,),
        speed_m_s=Vehicle.of(path.settings).speed_m_s,
    )


def _against_maxima(
    flight: Flight,
    figures: Mapping[str, Any],
    max_no_fix_m: float | None,
    max_people: float | None,
) -> tuple[pd.DataFrame, list[str]]:
    """Return findings, one row for each limit that is exceeded, and sentences on limits that cannot be judged.

    A limit cannot be judged if the maps do not hold its figure, or if the figure keeps the limit but could exceed it
    with what is unknown: each unknown metre may be without a fix, and any number of people may be below it.

    Args:
      flight: the mission over the maps.
      figures: the figures of the mission, by name.
      max_no_fix_m, max_people: the limits; None if there is no such limit.
    """
    limits = (  # figure, its unknown metres, limit, unit, most units that one of them may add, and where it is shown
        ("no_fix_m", "fix_unknown_m", max_no_fix_m, "m without a position fix", 1.0, "no_fix"),
        (
            "people_overflown",
            "people_unknown_m",
            max_people,
            "people overflown",
            math.inf,
            "densest_km",
        ),
    )
    steps = flight.steps
    rows, sentences = [], []
    for name, unknown_name, limit, unit, most_per_metre, stretch in limits:
        if limit is None:
            continue
        value = figures.get(name, 0.0)
        unknown_m = figures.get(unknown_name, 0.0)
        reason = ""
        if name not in figures:
            reason = "the maps do not hold them"
        elif value > limit:
            shown = f"{value:,.0f}"
            if round(value) <= limit:  # as of a quarter of a person beside a limit of 0
                shown = f"{value:.3g}"
            what = f"{shown} {unit}; the limit is {limit:g}"
            from_m = figures[f"{stretch}_from_m"]
            step = np.searchsorted(steps.along_m[:, 0], from_m)
            rows.append((what, value - limit, step, from_m, figures[f"{stretch}_to_m"]))
        elif unknown_m > 0 and value + unknown_m * most_per_metre > limit:
            reason = f"{value:,.0f} are known, and {unknown_m:,.0f} m are not"
        if reason:
            sentences.append(f"The limit of {limit:g} {unit} is not judged: {reason}.")
    table = pd.DataFrame(rows, columns=["what", "by_m", "step", *SPAN])
    return placed(table.assign(kind="limit"), flight, steps), sentences
