"""jaxurban check."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    CONSTRAINTS,
    CORRIDOR,
    JSON_FLAG,
    LONLAT,
    OF_CORRIDOR,
    PATH,
    RESOLUTION,
    check_belong,
    density_beneath,
    given_constraints,
    print_json,
)
from jaxurban.exit_codes import ExitCode
from jaxurban.progress import LOG

CODES = {"clean": ExitCode.DONE, "findings": ExitCode.FINDINGS, "not-judged": ExitCode.NOT_JUDGED}
METRES = partial(click.option, type=float, metavar="METRES")

NAMED = (  # options that Python takes by the same names
    "heights",
    "geoid_m",
    "home",
    "return_altitude_m",
    "time_of_day",
    "max_no_fix_m",
    "max_people",
    "sources",
)


@click.command()
@click.argument("folder", metavar="DIR", type=PATH)
@click.argument("mission", metavar="MISSION", type=PATH)
@click.option(
    "--heights",
    type=click.Choice(["home", "ground", "geoid", "ellipsoid"]),
    help="What heights are above, where the file leaves it open (KML, GPX, GeoJSON, CSV).",
)
@METRES("--geoid", "geoid_m", help="Height of the geoid above the ellipsoid: 37 in Tokyo.")
@click.option("--home", type=LONLAT, help="Home: longitude,latitude in degrees.")
@METRES(
    "--return-altitude",
    "return_altitude_m",
    help="Height above home at which the autopilot returns.",
)
@CONSTRAINTS
@click.option(
    "--time", multiple=True, help="Time of flight, UTC; repeatable.  [default: the maps' first]"
)
@click.option("--time-of-day", help="Time of day of the map of people.  [default: the first]")
@METRES("--max-no-fix", "max_no_fix_m", help="Most metres without a position fix.")
@click.option("--max-people", type=float, help="Most people overflown, in a strip of 10 m.")
@CORRIDOR
@click.option("--weights", "weights_text", default="", help="Weights such as gps=1,risk=2.")
@click.option(
    "--sources", type=PATH, help="Folder where the relative paths of the maps' sources begin."
)
@RESOLUTION
@click.option(
    "-o",
    "outputs",
    type=PATH,
    multiple=True,
    help="Folder of the report, or a file of findings: .geojson, .csv or .parquet; repeatable.",
)
@click.option("--overwrite", is_flag=True, help="Replace another check in the output folder.")
@JSON_FLAG
def check(
    folder: Path,
    mission: Path,
    outputs: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    resolution_m: float | None,
    weights_text: str,
    time: tuple[str, ...],
    **options: Any,
) -> int:
    """Check MISSION (.plan, .waypoints, .kml, .gpx, .geojson, .csv) over the maps in DIR.

    It ends with 0 only if every leg was judged and nothing was found, with 5 for findings, and with 6 where nothing was
    found but not all could be judged.
    """
    from jaxurban.maps.saving import open_maps
    from jaxurban.metrics.weights import Weights
    from jaxurban.report.mission import check as check_mission

    has_corridor = options["corridor_m"] is not None
    check_belong("--corridor", has_corridor, OF_CORRIDOR, options)
    maps = open_maps(folder, resolution_m)
    result = check_mission(
        maps,
        mission,
        time=time or None,
        constraints=given_constraints(options),
        weights=Weights.named_in(weights_text),
        **{name: options[name] for name in NAMED},
    )
    line_m = result.flight.line_m
    density = density_beneath(maps, line_m, options) if has_corridor and len(line_m) > 1 else None
    for output in outputs:
        for file in result.save(output, overwrite):
            LOG.info(f"wrote {file}")
    code = CODES[result.state]
    if as_json:
        message = "" if code is ExitCode.DONE else result.sentence
        people = None if density is None else density.to_dict()
        print_json(result.to_dict() | {"density": people}, code, message)
    else:
        print("\n".join(result.lines))
        print("" if density is None else f"\n{density.table()}")
    return code
