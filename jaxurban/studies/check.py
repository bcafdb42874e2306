"""check: whether a mission that another tool made is safe to fly over maps, as far as these know."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from jaxurban.checks import positive, typed
from jaxurban.errors import InputError
from jaxurban.io.files import write_whole
from jaxurban.io.read.mission import Datum, Mission, read_mission
from jaxurban.io.tables import SUFFIXES, records_of, write_table
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.maps.sources import city_of
from jaxurban.metrics.weights import GivenWeights
from jaxurban.paths.check import COLUMNS, judged
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.contacts import buildings_of, union_m
from jaxurban.paths.flown import costs_of, figures_of
from jaxurban.paths.legs import Flight, flight_of
from jaxurban.paths.plan import rules_on
from jaxurban.public import Caution, caution_lines, caution_of_guesses
from jaxurban.settings import iso_utc, not_negative, parse_time
from jaxurban.studies.queries import Result
from jaxurban.world.city import City

State = Literal["clean", "findings", "not-judged"]
STATES: dict[State, str] = {
    "clean": "Clean: every leg was judged, and nothing was found.",
    "findings": "Findings: {num}.",
    "not-judged": "Not judged: nothing was found, but not all of the mission could be judged.",
}


@dataclass(frozen=True, eq=False, repr=False)
class MissionCheck(Result):
    """What a check of a mission found.

    Attributes:
      findings: a row each: ``kind`` (``"building"``, ``"terrain"``, ``"zone"``, ``"closed"`` or ``"limit"``),
        ``what``, ``item`` (in the file, flown toward), ``lon`` and ``lat`` of the first contact, ``along_m`` and
        ``to_m`` along the mission, ``height_m`` above the ground there, ``building_m`` (the roof's height), ``by_m``
        (metres inside, below the ground or short of the clearance; of a limit, beyond it) and ``is_guessed``.
      not_judged: sentences.
      figures: lengths, metres without a fix, people, cost and exposure; ``cost_note`` says what is missing.
      outlines: ``"exact"``, or ``"by cells"`` where the city behind the maps is gone.
      limits: the constraints, as `Constraints.to_dict` has them.
      flight: the mission over the maps.
      maps: the maps.

    Examples:
      >>> path.save("mission.plan").name
      'mission.plan'
      >>> ju.check(maps, "mission.plan", sources=city)
      MissionCheck(state: Findings: 1.; mission: mission.plan; buildings: exact outlines; ...
        limit: Flies up to 7.8 m into a building: from 831 to 839 m along the mission, toward item 7, at ...
    """

    findings: pd.DataFrame
    not_judged: list[str]
    figures: Mapping[str, Any]
    outlines: str
    limits: Mapping[str, Any]
    flight: Flight
    maps: MetricMaps

    @property
    def state(self) -> State:
        """``"clean"`` only if every leg was judged and nothing was found, else ``"findings"`` or ``"not-judged"``."""
        if len(self.findings):
            return "findings"
        return "not-judged" if self.not_judged else "clean"

    @property
    def sentence(self) -> str:
        """The state, as one sentence."""
        return STATES[self.state].format(num=len(self.findings))

    @property
    def sentences(self) -> list[str]:
        """The findings, a sentence each."""
        return [_said(row) for row in self.findings.to_dict("records")]

    @property
    def numbers(self) -> dict[str, str]:
        """The figures as texts, in the units that their names say; those by layer or time one by one."""
        numbers = {}
        for name, value in self.figures.items():
            parts = value.items() if isinstance(value, Mapping) else [("", value)]
            for part, number in parts:
                if not isinstance(number, str):
                    numbers[f"{name} {part}".replace("_", " ").strip()] = f"{number:,.4g}"
        return numbers

    @property
    def facts(self) -> dict[str, str]:
        """The state, the mission, how buildings were looked at, and the figures."""
        facts = {"state": self.sentence, "mission": self.flight.mission.name}
        facts |= {"buildings": self.outlines, **self.numbers}
        return facts | {"note": self.figures.get("cost_note", "")}

    @property
    def lines(self) -> list[str]:
        """The check for a terminal: the state, findings, what was not judged, and figures."""
        state, *others = self.facts.items()
        figures = (f"{name}: {fact}" for name, fact in others if fact)
        return [state[1], *caution_lines(self.known_cautions), *figures]

    @typed
    def save(self, folder: str | Path, overwrite: bool = False) -> list[Path]:
        """Write the page, the record and the findings to a folder, or the findings alone to a file; return the files.

        Args:
          folder: where to, made if it is not there; or a ``.geojson``, ``.csv`` or ``.parquet`` file.
          overwrite: replace another check in the folder.

        Returns:
          The files. The page is ``report.md``, with a map and a profile.

        Raises:
          InputError: the folder cannot be written to, or holds another study or other files.

        Examples:
          >>> path.save("mission.plan").name
          'mission.plan'
          >>> result = ju.check(maps, "mission.plan", sources=city)
          >>> [file.name for file in result.save("findings.geojson")]
          ['findings.geojson']
          >>> sorted(file.name for file in result.save("checked"))[:3]
          ['check.json', 'findings.csv', 'findings.geojson']
        """
        file = Path(folder)
        if file.suffix == ".geojson":
            write_whole(file, json.dumps(self.to_geojson(), indent=1))
        elif file.suffix in SUFFIXES:
            write_table(self.findings, file)
        else:
            return super().save(folder, overwrite)
        return [file]

    @property
    def known_cautions(self) -> list[Caution]:
        """The findings, what was not judged, and what the maps guess."""
        return [
            *(Caution(sentence, "limit") for sentence in self.sentences),
            *(Caution(sentence, "guess") for sentence in self.not_judged),
            *caution_of_guesses(self.maps.guesses),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the check as plain, JSON-ready values.

        Returns:
          ``state``, ``sentence``, ``mission``, ``findings`` (a dictionary each), ``not_judged``, ``figures``,
          ``outlines``, ``limits`` and ``guesses``; None stands for a number that is missing.

        Examples:
          >>> path.save("mission.plan").name
          'mission.plan'
          >>> record = ju.check(maps, "mission.plan", sources=city).to_dict()
          >>> record["state"], [finding["kind"] for finding in record["findings"]]
          ('findings', ['building'])
        """
        return {
            "state": self.state,
            "sentence": self.sentence,
            "mission": self.flight.mission.name,
            "findings": records_of(self.findings),
            "not_judged": list(self.not_judged),
            "figures": dict(self.figures),
            "outlines": self.outlines,
            "limits": dict(self.limits),
            "guesses": list(self.maps.guesses),
        }

    def to_geojson(self) -> dict[str, Any]:
        """Return the findings that have a place as points of GeoJSON.

        Returns:
          A FeatureCollection; the properties of each point are the columns of ``findings``.

        Examples:
          >>> path.save("mission.plan").name
          'mission.plan'
          >>> points = ju.check(maps, "mission.plan", sources=city).to_geojson()
          >>> [point["properties"]["kind"] for point in points["features"]]
          ['building']
        """
        rows = records_of(self.findings[self.findings["lon"].notna()])
        features = [
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": [row.pop("lon"), row.pop("lat")]},
                "properties": row,
            }
            for row in rows
        ]
        return {"type": "FeatureCollection", "state": self.state, "features": features}


def _said(row: Mapping[Any, Any]) -> str:
    """Return a finding as a sentence with its place."""
    sentence = f"{row['what'][:1].upper()}{row['what'][1:]}"
    if math.isnan(row["lon"]):
        return f"{sentence}."
    where = f"from {row['along_m']:.0f} to {row['to_m']:.0f} m along the mission, toward item {row['item']:.0f}"
    place = f"{row['lon']:.6f}, {row['lat']:.6f}, {row['height_m']:.1f} m above the ground"
    return f"{sentence}: {where}, at {place}."


@typed
def check(
    maps: GivenMaps,
    mission: str | Path | Mission,
    *,
    heights: Datum | None = None,
    home: Sequence[float] | None = None,
    return_altitude_m: float | None = None,
    geoid_m: float | None = None,
    no_fly: str | Path | Iterable[str | Path] = (),
    constraints: Constraints | None = None,
    clearance_m: float | None = None,
    vertical_clearance_m: float | None = None,
    time: str | Sequence[str] | None = None,
    time_of_day: str | None = None,
    max_no_fix_m: float | None = None,
    max_people: float | None = None,
    swath_m: float = 10.0,
    weights: GivenWeights = None,
    sources: City | str | Path | None = None,
) -> MissionCheck:
    """Return what a mission that any tool made meets over maps: findings, what cannot be judged, and figures.

    Buildings are looked at by their exact outlines, read again from the files that the run of the maps recorded, or in
    ``sources``; where these are gone, by the cells that roofs touch, which the result says. A roof is as high above
    the ground at each of its points as its height says. Findings are contacts with buildings and places nearer than
    the clearances, the ground, no-fly zones, closed cells, and limits that are named here; all else is a figure. Not
    judged is what the reader did not understand, what lies outside the maps, over cells without data or beyond the
    maps' altitudes (but for take-off and landing), and what passes over, or within the clearance of, a guessed roof.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder.
      mission: a file (``.plan``, ``.waypoints``, ``.kml``, ``.gpx``, ``.geojson``, ``.csv``), or one that was read.
      heights: what heights are above where the file leaves it open: ``"home"``, ``"ground"``, ``"geoid"`` or
        ``"ellipsoid"``.
      home: longitude, latitude of home where the file has none.
      return_altitude_m: height above home at which the vehicle returns where the file leaves it open.
      geoid_m: height of the geoid above the ellipsoid there, for heights above the latter.
      no_fly: files of no-fly zones, beside those of ``constraints``.
      constraints: zones, bounds, clearances and vehicle; left out, as the maps' scenario has them.
      clearance_m, vertical_clearance_m: instead of those of ``constraints``.
      time: UTC time of the flight, or several: of the GPS maps, and zones count that are in force at one of them.
        Left out, the maps' first time, and every zone.
      time_of_day: of the map of people; the first if left out.
      max_no_fix_m: most metres without a position fix, at the worst of the times.
      max_people: most people overflown.
      swath_m: width of the strip in which people are counted.
      weights: of the cost; left out, as the maps' scenario has them.
      sources: the City, or the folder that the recorded files' paths begin at.

    Returns:
      `MissionCheck`, whose ``state`` is ``"clean"`` only if every leg was judged and nothing was found.

    Raises:
      InputError: a file that cannot be read or leaves open what heights are above, a time that the maps do not hold,
        a wrong limit, or sources that are named and are not those of the maps.

    Examples:
      >>> path.save("mission.plan").name
      'mission.plan'
      >>> result = ju.check(maps, "mission.plan", sources=city, max_people=50)
      >>> print(result.sentence)
      Findings: 1.
      >>> result.findings[["kind", "item", "building_m"]].round(1).to_dict("records")
      [{'kind': 'building', 'item': 7, 'building_m': 7.8}]
    """
    maps = as_maps(maps)
    for name, most in (("max_no_fix_m", max_no_fix_m), ("max_people", max_people)):
        if most is not None:
            not_negative(name, most)
    positive("swath_m", swath_m)
    if not isinstance(mission, Mission):
        place = None if home is None else _lonlat(home)
        mission = read_mission(
            mission, heights=heights, home=place, return_altitude_m=return_altitude_m
        )
    times = [time] if isinstance(time, str) or time is None else [iso_utc(each) for each in time]
    limits = constraints or Constraints()
    limits = replace(limits, zones=(*limits.zones, *Constraints.read(no_fly).zones))
    if clearance_m is not None:
        limits = replace(limits, clearance_m=clearance_m)
    if vertical_clearance_m is not None:
        limits = replace(limits, vertical_clearance_m=vertical_clearance_m)
    _, _, limits = rules_on(maps, None, limits, "")
    flights = [parse_time(each) for each in times if each is not None]
    zones = [zone for zone in limits.zones if not flights or any(map(zone.is_in_force, flights))]
    held, limits = (
        limits,
        replace(limits, zones=tuple(replace(zone, start=None, end=None) for zone in zones)),
    )

    city, outlines = _city_of(maps, sources)
    flight = flight_of(mission, maps, geoid_m)
    findings, unknown = judged(flight, maps, buildings_of(maps, city), limits, times, time_of_day)
    figures: dict[str, Any] = {"num_zones": len(held.zones), "num_zones_in_force": len(zones)}
    figures |= figures_of(flight, maps, times, time_of_day, swath_m)
    figures |= costs_of(flight, maps, weights, limits, times[0], time_of_day)
    beyond, open_limits = _limits(figures, max_no_fix_m, max_people)
    not_judged = [
        *(f"{each[:1].upper()}{each[1:]}." for each in mission.not_judged),
        *(["The mission holds no leg."] if not mission.legs else []),
        *(
            f"{union_m(rows):,.0f} m {reason}."
            for reason, rows in unknown.groupby("reason", sort=False)
        ),
        *open_limits,
    ]
    findings = pd.concat([each for each in (findings, beyond) if len(each)] or [findings])
    return MissionCheck(
        findings.reset_index(drop=True),
        not_judged,
        figures,
        outlines,
        limits.to_dict(),
        flight,
        maps,
    )


def _lonlat(home: Sequence[float]) -> tuple[float, float]:
    """Return a place as longitude and latitude.

    Raises:
      InputError: not two numbers.
    """
    if len(home) != 2:
        raise InputError(f"home must be longitude, latitude in degrees, got {len(home)} numbers")
    return float(home[0]), float(home[1])


def _city_of(maps: MetricMaps, sources: City | str | Path | None) -> tuple[City | None, str]:
    """Return the city behind maps, None where it is gone, and what buildings are looked at by.

    Raises:
      InputError: sources that are named and do not hold it.
    """
    if isinstance(sources, City):
        city = sources
    elif sources is not None and maps.folder is None:
        raise InputError(
            f"sources must be the City that maps in memory were made of, got {str(sources)!r}"
        )
    else:
        try:
            city = city_of(maps, None if sources is None else Path(sources))
        except InputError as error:
            if sources is not None:
                raise
            return None, f"by cells that roofs touch, because {error}"
    if city.buildings is None:
        return None, "by cells that roofs touch, because the city is a raster of heights"
    return city, "exact outlines"


def _limits(
    figures: Mapping[str, Any], max_no_fix_m: float | None, max_people: float | None
) -> tuple[pd.DataFrame, list[str]]:
    """Return findings of limits that are exceeded, and sentences on those that cannot be judged."""
    limits = (
        ("no_fix_m", "fix_unknown_m", max_no_fix_m, "m without a position fix", 1.0),
        ("people_overflown", "people_unknown_m", max_people, "people overflown", math.inf),
    )
    rows, sentences = [], []
    for name, unknown_name, most, unit, most_a_metre in limits:
        if most is None:
            continue
        if name not in figures:
            sentences.append(
                f"The limit of {most:g} {unit} is not judged: the maps do not hold them."
            )
            continue
        value, unknown_m = figures[name], figures[unknown_name]
        if value > most:
            what = f"{value:,.0f} {unit}; the limit is {most:g}"
            rows.append({"kind": "limit", "what": what, "by_m": value - most})
        elif unknown_m > 0 and value + unknown_m * most_a_metre > most:
            sentences.append(
                f"The limit of {most:g} {unit} is not judged: {value:,.0f} are known, and {unknown_m:,.0f} m are not."
            )
    return pd.DataFrame(rows, columns=COLUMNS), sentences
