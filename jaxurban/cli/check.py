"""jaxurban check."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import jaxurban
from jaxurban.cli.common import (
    CEILING,
    CORRIDOR,
    FILES,
    FOLDER,
    GIVEN,
    JSON_FLAG,
    LIMITS,
    LONLAT,
    METRES,
    NUMBER,
    OVERWRITE,
    RESOLUTION,
    SOURCES,
    TIME_OF_DAY,
    WEIGHTS,
    Point,
    print_json,
)
from jaxurban.cli.options import command
from jaxurban.exit_codes import ExitCode
from jaxurban.knowledge import Caution
from jaxurban.progress import LOG

if TYPE_CHECKING:
    from jaxurban.io.read.mission_parts import Datum
    from jaxurban.paths.route_report import OverflownDensity

CODES = {"clean": ExitCode.DONE, "findings": ExitCode.FINDINGS, "not-judged": ExitCode.NOT_JUDGED}


@command()
@FOLDER
@click.argument("mission", metavar="MISSION", type=GIVEN)
@click.option(
    "--heights",
    type=click.Choice(["home", "ground", "geoid", "ellipsoid"]),
    help="What heights are above, where the file leaves it open (KML, GPX, GeoJSON, CSV).",
)
@METRES("--geoid", "geoid_m", help="Height of the geoid above the ellipsoid: 37 in Tokyo.")
@click.option("--home", type=LONLAT, help="Home: longitude,latitude in degrees.")
@METRES(
    "--home-above-ground",
    "home_above_ground_m",
    help="Height of home above the ground, for a flight that starts from a roof.",
)
@METRES(
    "--return-altitude",
    "return_altitude_m",
    help="Height above home at which the autopilot returns.",
)
@LIMITS
@click.option(
    "--time",
    "times",
    multiple=True,
    help="Time of flight, UTC; repeatable.  [default: the maps' first]",
)
@TIME_OF_DAY
@METRES("--max-no-fix", "max_no_fix_m", help="Most metres without a position fix.")
@NUMBER("--max-people", help="Most people overflown, in a strip of 10 m.")
@CEILING
@CORRIDOR
@WEIGHTS
@SOURCES
@RESOLUTION
@FILES(help="Folder of the report, or a file of findings: .geojson, .csv or .parquet; repeatable.")
@OVERWRITE
@JSON_FLAG
def check_command(
    folder: Path,
    mission: Path,
    heights: "Datum | None",
    home: Point | None,
    return_altitude_m: float | None,
    times: tuple[str, ...],
    time_of_day: str | None,
    corridor: "Callable[..., OverflownDensity] | None",
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
    from jaxurban.io.read.mission import read_mission
    from jaxurban.io.workspace import Workspace

    # Folders are held while it works. The mission is read before what takes a second to import.
    for output in files:
        if not output.suffix:
            click.get_current_context().with_resource(Workspace.held(output, "check"))
    parsed = read_mission(mission, heights=heights, home=home, return_altitude_m=return_altitude_m)
    maps = jaxurban.open_maps(folder, resolution_m)
    result = jaxurban.check(
        maps,
        parsed,
        time=times or None,
        time_of_day=time_of_day,
        **options,  # all other options are its arguments
    )

    # The people beneath the corridor, if one is asked for and the mission has a leg over the maps.
    density = None
    line_m = result.flight.line_m
    if corridor is not None and len(line_m) > 1:
        density = corridor(maps, line_m, time_of_day=time_of_day)
        cautions = [Caution(text, "guess") for text in result.flight.off_line]
        density = replace(density, cautions=[*cautions, *density.cautions])

    # Files, and what is printed.
    for output in files:
        for file in result.save(output, overwrite):
            LOG.info(f"wrote {file}")
    code = CODES[result.state]
    if as_json:
        message = "" if code is ExitCode.DONE else result.sentence
        people = None if density is None else density.to_dict()
        print_json(result.to_dict() | {"density": people}, code, message)
    else:
        print("\n".join(result.lines))
        if density is not None:
            print(f"\n{density.table()}")
    return code
