"""jaxurban check."""

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypedDict

import click

import jaxurban
from jaxurban.errors import InputError
from jaxurban.exit_codes import ExitCode
from jaxurban.io.stored import stored_maps
from jaxurban.knowledge import Caution
from jaxurban.progress import LOG
from jaxurban.terminal.common import (
    FILES,
    GIVEN,
    JSON_FLAG,
    KEPT_CLEAR,
    LONLAT,
    METRES,
    OVERWRITE,
    RESOLUTION,
    SOURCES,
    TIME_OF_DAY,
    ZONES,
    NamedPath,
    Point,
    Settings,
    constraints_given,
    print_json,
)
from jaxurban.terminal.options import TYPED, Values, command, grouped_options

CODES = {"clean": ExitCode.DONE, "findings": ExitCode.FINDINGS, "not-judged": ExitCode.NOT_JUDGED}


class FileHeights(TypedDict):
    """What heights of a mission are above, where its file leaves it open.

    Attributes:
      above: home, ground, geoid or ellipsoid, where the file (KML, GPX, GeoJSON, CSV) leaves it open.
      geoid_m: height of the geoid above the ellipsoid: 37 in Tokyo.
      home_above_ground_m: height of home above the ground, for a flight that starts from a roof.
    """

    above: str
    geoid_m: float
    home_above_ground_m: float


class Limits(TypedDict):
    """What a flight must keep within.

    Attributes:
      max_no_fix_m: most metres without a position fix.
      max_people: most people overflown, in a strip of 10 m.
      ceiling_m: greatest height of a return above the ground at home, else 120; legs are not held against it.
    """

    max_no_fix_m: float
    max_people: float
    ceiling_m: int


class Corridor(TypedDict):
    """The corridor of a flight beneath which the density of people is taken (`jaxurban.overflown_density`).

    Attributes:
      half_width_m: width of the volume that is flown in, to each side.
      contingency_m: width of the contingency volume around it, else 0.
      buffer_m: width of the ground risk buffer around both, else the flight's height (1:1 rule).
      cell_m: side of the cells of the mean, else 200; 100 and 500 are reported too.
    """

    half_width_m: float
    contingency_m: float
    buffer_m: float
    cell_m: float


def _check_maps(folder: Path) -> None:
    """Raise InputError of a folder without maps (`stored_maps`), or where a mission and its folder are exchanged."""
    words = [Path(word) for word in click.get_current_context().meta[TYPED]]
    number = words.index(folder) + 1
    if folder.is_file() and any(map(os.path.isdir, words[number : number + 1])):
        raise InputError(
            f"{str(folder)!r} is a file, and {str(words[number])!r} a folder: exchange the two, as in `jaxurban check "
            "DIR MISSION`"
        )
    stored_maps(folder)


@command()
@click.argument("folder", metavar="DIR", type=NamedPath(_check_maps), is_eager=True)
@click.argument("mission", metavar="MISSION", type=GIVEN)
@click.option(
    "--heights", type=Values(FileHeights), default="", help="What heights of the file are above."
)
@click.option("--home", type=LONLAT, help="Home: longitude,latitude in degrees.")
@METRES(
    "--return-altitude",
    "return_altitude_m",
    help="Height above home at which the autopilot returns.",
)
@click.option(
    "--autopilot",
    type=click.Choice(["ardupilot", "px4"]),
    help="Which one flies it, where the file names none.  [default: both, and the worse counts]",
)
@grouped_options("constraints", constraints_given, ZONES, KEPT_CLEAR)
@click.option(
    "--time",
    "times",
    multiple=True,
    help="Time of flight, UTC; repeatable.  [default: the maps' first]",
)
@TIME_OF_DAY
@click.option("--limits", type=Values(Limits), default="", help="What the flight must keep within.")
@click.option(
    "--corridor",
    type=Values(Corridor),
    help="Report the density of people beneath a corridor, for a ground risk assessment.",
)
@SOURCES
@RESOLUTION
@FILES(help="Folder of the report, or a file of findings: .geojson, .csv or .parquet; repeatable.")
@OVERWRITE
@JSON_FLAG
def check_command(
    folder: Path,
    mission: Path,
    heights: Settings,
    home: Point | None,
    return_altitude_m: float | None,
    autopilot: Literal["ardupilot", "px4"] | None,
    times: tuple[str, ...],
    time_of_day: str | None,
    limits: Settings,
    corridor: Settings | None,
    resolution_m: float | None,
    files: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Check MISSION over the maps in DIR.

    MISSION is a file of .plan, .waypoints, .kmz or .wpml (DJI), .kml, .gpx, .geojson, .csv or .ulg.

    It ends with 0 only if every leg was judged and nothing was found, with 5 for findings, and with 6 where nothing was
    found but not all could be judged.
    """
    from jaxurban.flights.missions.mission import read_mission
    from jaxurban.io.workspace import Workspace

    # Folders are held while it works. The mission is read before what takes a second to import.
    for output in files:
        if not output.suffix:
            click.get_current_context().with_resource(Workspace.held(output, "check"))
    parsed = read_mission(
        mission,
        heights=heights.pop("above", None),
        home=home,
        return_altitude_m=return_altitude_m,
        autopilot=autopilot,
    )
    maps = jaxurban.open_maps(folder, resolution_m)
    result = jaxurban.check(
        maps,
        parsed,
        time=times or None,
        time_of_day=time_of_day,
        **heights,
        **limits,
        **options,  # all other options are its arguments
    )

    # The people beneath the corridor, if one is asked for and the mission has a leg over the maps.
    density = None
    line_m = result.flight.line_m
    if corridor is not None and len(line_m) > 1:
        from jaxurban.flights.ground_risk import overflown_density

        density = overflown_density(maps, line_m, time_of_day=time_of_day, **corridor)
        cautions = [Caution(text, "guess") for text in result.flight.off_line]
        density = replace(density, cautions=[*cautions, *density.cautions])

    # Files, and what is printed.
    for output in files:
        for file in result.save(output, overwrite):
            LOG.info(f"wrote {file}")
    code = CODES[result.state]
    with suppress(BrokenPipeError):  # whoever reads the first line alone gets the code all the same
        if as_json:
            message = "" if code is ExitCode.DONE else result.sentence
            people = None if density is None else density.to_dict()
            print_json(result.to_dict() | {"density": people}, code, message)
        else:
            print("\n".join(result.lines))
            if density is not None:
                print(f"\n{density.table()}")
    return code
