"""MissionCheck: what a check of a mission found, and how it is shown."""

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from jaxurban.checks import typed
from jaxurban.flights.legs import Flight
from jaxurban.flights.missions.parts import AUTOPILOTS
from jaxurban.io.files import write_whole
from jaxurban.io.results import Result
from jaxurban.io.tables import SUFFIXES, records_of, write_table
from jaxurban.io.zone import Zone
from jaxurban.knowledge import Caution, caution_of_guesses
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.public import listed
from jaxurban.settings import time_said

State = Literal["clean", "findings", "not-judged"]
STATES: dict[State, str] = {
    "clean": "Clean: every leg was judged, and nothing was found.",
    "findings": "Findings: {num}.",
    "not-judged": "Not judged: nothing was found, but not all of the mission could be judged.",
}
NUMBERS = {  # of `MissionCheck.figures`, in words; one that is missing leaves its line out
    "no-fly zones": "{num_zones_in_force} of {num_zones} in force",
    "length": "{length_m:,.0f} m, {on_maps_m:,.0f} m of it over the maps at a known height",
    "no fix": "{fix_unknown_m}",
    "people overflown": "{people_unknown_m}",
    "densest kilometre": "{densest_km_people:,.0f} people, from {densest_km_from_m:,.0f} m on",
    "nearest obstacle": "{nearest_wall_m:,.1f} m away, by whole cells of {cell_m:g} m, which reach beyond outlines",
    "lowest over roofs": "{least_over_roofs_m:,.1f} m, by the same cells",
}


@dataclass(frozen=True, eq=False, repr=False)
class MissionCheck(Result):
    """What a check of a mission found.

    Attributes:
      findings: a row each: ``kind`` (``"building"``, ``"terrain"``, ``"zone"``, ``"closed"`` or ``"limit"``), ``what``,
        ``item`` (in the file, flown toward), ``lon`` and ``lat`` of the first contact, ``along_m`` and ``to_m`` along
        the mission, ``height_m`` above the ground there, ``building_m`` (the roof's height), ``by_m`` (metres inside,
        below the ground or the GPS floor, or short of the clearance; of a limit, beyond it) ``is_guessed``; ``clear_m``
        (the height above the ground that clears it, up to the ceiling) and ``aside_m`` (how far to go to the right, or
        to the left where it is negative), NaN where none is known; ``to_item``, toward which the end of that stretch is
        flown: if it is another one than ``item``, the corners between these are moved with their legs; ``autopilot``,
        the only one that meets it (``""``: all that it is judged for). A limit, for which no way out is looked for, is
        placed where the fix is first and last lost, or at the densest kilometre.
      not_judged: sentences, of stretches with the place at which the first begins.
      figures: lengths, metres without a fix, people, and clearances by cells, as in the report of a route.
      outlines: ``"exact outlines"``, or ``"by cells"``, with the reason.
      limits: the constraints, as `Constraints.to_dict` has them.
      flight: the mission over the maps; of those of several autopilots that with the most findings.
      maps: the maps.
      left_out: a sentence on the kinds of obstacles that were not looked at, ``""`` if none was left out: as the maps'
        ``[obstacles]`` say, and in maps that are older than it plants and wires.
      zones: the no-fly zones, with those of the mission's geofence: closed, open or unknown, as of their ``state``.
      return_altitudes: a row for each place at which an item ends: its ``item``, ``apart_m`` (from home), ``own_m``
        (its height above home), ``least_m``, the least height above home at which a straight, level way home clears
        everything, up to the bound of guessed heights (NaN where that is not known), and ``way_m``, the least from
        wherever on the way to it. No row without a home.
      return_lines: at which altitude it may return from wherever it is, a sentence each, and what to type.
      unjudged: a row for each stretch that is not judged: its ``kind``, its ``reason``, the ``item`` that it is flown
        toward, ``lon`` and ``lat`` of its begin (NaN where the mission has no place over the maps), ``along_m`` and
        ``to_m`` along the mission, and ``autopilot``, as of the findings.

    Examples:
      >>> ju.check(maps, path, sources=city, max_people=30)
      MissionCheck(state: Findings: 1.; mission: path of astar; autopilot: ArduPilot and PX4; ...
        limit: 69 people overflown; the limit is 30: above all from 0 to 848 m along the mission, toward item 2, at ...
        ...
    """

    _command = "check"
    _report = "jaxurban.flights.report:check_report"

    findings: pd.DataFrame
    not_judged: list[str]
    figures: Mapping[str, Any]
    outlines: str
    limits: Mapping[str, Any]
    flight: Flight
    maps: MetricMaps
    zones: Sequence[Zone] = ()
    left_out: str = ""
    return_altitudes: pd.DataFrame = field(default_factory=pd.DataFrame)
    return_lines: Sequence[str] = ()
    unjudged: pd.DataFrame = field(default_factory=pd.DataFrame)

    @property
    def state(self) -> State:
        """``"clean"`` only if every leg was judged and nothing was found, else ``"findings"`` or ``"not-judged"``."""
        if len(self.findings):
            return "findings"
        return "not-judged" if self.not_judged else "clean"

    @property
    def sentence(self) -> str:
        """The state, as one sentence; another one follows if kinds of obstacles were left out.

        Of a mission that lies nowhere over the maps it says where it lies, and where the maps do.
        """
        state = STATES[self.state].format(num=len(self.findings))
        legs = self.flight.mission.legs
        if legs and self.state == "not-judged" and not len(self.flight.lines_m):
            place = legs[0].end
            where = self.maps.grid.outside_said(place.lon, place.lat)
            state = f"Nothing was judged, as the mission lies elsewhere: {where}."
        return f"{state} {self.left_out}".rstrip()

    @property
    def sentences(self) -> list[str]:
        """The findings, a sentence each."""
        return [_sentence_of(row) for row in self.findings.to_dict("records")]

    @property
    def numbers(self) -> dict[str, str]:
        """The figures in words, by what they are about, such as ``"no fix"``."""
        by_time = self.figures.get("no_fix_by_time_m", {})
        lost = [f"{lost_m:,.0f} m at {time_said(time)}" for time, lost_m in by_time.items()]
        texts = {**self.figures, "cell_m": self.maps.grid.resolution_m}
        people = self.figures.get("people_overflown", 0.0)
        known = {
            "fix_unknown_m": (", ".join(lost), any(by_time.values())),
            "people_unknown_m": (f"{people:,.0f}", people),
        }
        for name in known.keys() & texts.keys():
            text, is_more = known[name]
            unknown_m = round(texts[name])
            # Nothing on a mission of which nothing is known is no 0.
            parts = [text] if is_more or unknown_m < round(texts["length_m"]) else []
            if unknown_m or not parts:
                parts.append(f"not known on {unknown_m:,} m")
            texts[name] = "; ".join(parts)
        numbers = {}
        num_more = len(self.maps.times) - len(by_time)
        if by_time and num_more > 0:
            times = listed([*map(time_said, by_time)])
            numbers["time"] = f"{times}; the maps hold {num_more} more, not judged (time, --time)"
        for name, words in NUMBERS.items():
            with suppress(KeyError):
                numbers[name] = words.format_map(texts)
        return numbers

    @property
    def autopilots(self) -> tuple[str, ...]:
        """Those for which it was judged: both where nothing says which flies the mission, and the worse counts."""
        return self.flight.mission.autopilots

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of the mission that leaves the state as it is, such as that it ends in the air: sentences."""
        return self.flight.mission.notes

    @property
    def facts(self) -> dict[str, str]:
        """The state, the mission, how buildings were looked at, and the figures."""
        return {
            "state": self.sentence,
            "mission": self.flight.mission.name,
            "autopilot": " and ".join(AUTOPILOTS[name] for name in self.autopilots),
            "buildings": self.outlines,
            **self.numbers,
        }

    @property
    def lines(self) -> list[str]:
        """The check for a terminal: state, findings, what was not judged or was guessed, figures, and the return."""
        facts = self.facts
        state = facts.pop("state")
        figures = [f"{name}: {fact}" for name, fact in facts.items()]
        parts = {
            "finding": self.sentences,
            "not judged": self.not_judged,
            "note": self.notes,
            "guessed": [guess.name for guess in self.maps.guesses],
        }
        listed = [f"  {name}: {text}" for name, texts in parts.items() for text in texts]
        return [state, *listed, *figures, *(f"return: {text}" for text in self.return_lines)]

    @property
    def known_cautions(self) -> list[Caution]:
        """The findings, what was not judged, and what the maps guess."""
        return [
            *(Caution(sentence, "limit", "finding") for sentence in self.sentences),
            *(Caution(sentence, "guess", "not judged") for sentence in self.not_judged),
            *map(Caution, self.notes),
            *caution_of_guesses(self.maps.guesses),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the check as plain, JSON-ready values.

        Returns:
          ``state``, ``sentence``, ``mission``, ``autopilots``, ``findings`` (a dictionary each), ``not_judged``,
          ``unjudged`` (a dictionary each), ``notes``, ``figures``, ``outlines``, ``limits``, ``guesses``,
          ``return_altitudes`` (a dictionary each) and ``return_lines``; None stands for a number that is missing.

        Examples:
          >>> record = ju.check(maps, path, sources=city, max_people=30).to_dict()
          >>> record["state"], [finding["kind"] for finding in record["findings"]]
          ('findings', ['limit'])
        """
        return {
            "state": self.state,
            "sentence": self.sentence,
            "mission": self.flight.mission.name,
            "autopilots": list(self.autopilots),
            "findings": records_of(self.findings),
            "not_judged": list(self.not_judged),
            "unjudged": records_of(self.unjudged),
            "notes": list(self.notes),
            "figures": dict(self.figures),
            "outlines": self.outlines,
            "limits": dict(self.limits),
            "guesses": [guess.name for guess in self.maps.guesses],
            "return_altitudes": records_of(self.return_altitudes),
            "return_lines": list(self.return_lines),
        }

    def to_geojson(self) -> dict[str, Any]:
        """Return the findings as points of GeoJSON.

        Returns:
          A FeatureCollection; the properties of each point are the columns of ``findings``.

        Examples:
          >>> points = ju.check(maps, path, sources=city, max_people=30).to_geojson()
          >>> [point["properties"]["kind"] for point in points["features"]]
          ['limit']
        """
        features = []
        for row in records_of(self.findings):
            point = {"type": "Point", "coordinates": [row.pop("lon"), row.pop("lat")]}
            features.append({"type": "Feature", "geometry": point, "properties": row})
        return {"type": "FeatureCollection", "state": self.state, "features": features}

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
          >>> result = ju.check(maps, path, sources=city, max_people=30)
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


def flown_by(autopilot: str, sentence: str) -> str:
    """Return a sentence with the only autopilot of which it is true, if it is not true of all (``""``)."""
    return f"Flown by {AUTOPILOTS[autopilot]}: {sentence}" if autopilot else sentence


def begins_said(stretches: pd.DataFrame) -> str:
    """Return where the first of some stretches begins that has a place, as a sentence after others; else ``""``."""
    with_place = stretches[stretches["lon"].notna()]
    if with_place.empty:
        return ""
    first = with_place.iloc[0]
    which = f"The first of {len(stretches)} stretches begins" if len(stretches) > 1 else "It begins"
    return (
        f" {which} {first['along_m']:.0f} m along the mission, toward item {first['item']:.0f}, at "
        f"{first['lon']:.6f}, {first['lat']:.6f}."
    )


def _sentence_of(row: Mapping[Any, Any]) -> str:
    """Return a finding, a row of `MissionCheck.findings`, as a sentence."""
    sentence = flown_by(row["autopilot"], f"{row['what'][:1].upper()}{row['what'][1:]}")
    worst = "above all " if row["kind"] == "limit" else ""
    span = f"from {row['along_m']:z.0f} to {row['to_m']:z.0f} m"
    where = f"{worst}{span} along the mission, toward item {row['item']:.0f}"
    place = f"{row['lon']:.6f}, {row['lat']:.6f}"
    if not math.isnan(row["height_m"]):
        place += f", {row['height_m']:.1f} m above the ground"
    side = "left" if row["aside_m"] < 0 else "right"
    corner = ""
    if row["to_item"] > row["item"]:
        items = f"item {row['item']:.0f} to before item {row['to_item']:.0f}"
        corner = f", with each corner from {items} moved so that its legs stay parallel"
    ways = {
        f"at {row['clear_m']:.0f} m above the ground": row["clear_m"],
        f"{abs(row['aside_m']):.0f} m to the {side}{corner}": row["aside_m"],
    }
    clear = " or ".join(way for way, metres in ways.items() if not math.isnan(metres))
    return f"{sentence}: {where}, at {place}.{clear and f' It is clear {clear}.'}"
