"""jaxurban fetch."""

from datetime import datetime
from pathlib import Path

import click

from jaxurban.errors import InputError
from jaxurban.progress import LOG
from jaxurban.terminal.common import (
    FLAG,
    JSON_FLAG,
    NAMES,
    PATH,
    SHOWN,
    Settings,
    print_json,
)
from jaxurban.terminal.options import Number, Numbers, command


@command()
@click.option(
    "--bounds",
    type=Numbers("W,S,E,N", "west, south, east, north", 4),
    required=True,
    help="Region in degrees.",
)
@click.option("-o", "folder", type=PATH, required=True, help="Folder for the files.")
@NAMES("--what", default="osm,census,districts,orbits", show_default=True, help="What to fetch.")
@click.option(
    "--date",
    "day",
    type=click.DateTime(["%Y-%m-%d"]),
    help="Day of the GPS maps, UTC.  [default: that of the element sets]",
)
@SHOWN(
    "--margin",
    "margin_m",
    type=Number(),
    default=1000.0,
    help="Width in metres of the margin whose buildings are fetched too.",
)
@click.option(
    "--source",
    "places",
    metavar="NAME=URL",
    multiple=True,
    help="Fetch one of --what from another place, such as an OSM extract (.osm.pbf); repeatable.",
)
@SHOWN("--max-size", default="500MB", help="Largest file accepted.")
@FLAG("--overwrite", help="Move existing files to the folder `kept` and fetch them again.")
@FLAG("--dry-run", "is_dry_run", help="List the requests without making them.")
@JSON_FLAG
def fetch_command(
    bounds: tuple[float, ...],
    folder: Path,
    what: tuple[str, ...],
    day: datetime | None,
    margin_m: float,
    places: tuple[str, ...],
    max_size: str,
    overwrite: bool,
    is_dry_run: bool,
    as_json: bool,
) -> None:
    """Download what the maps of a region need.

    The sources are public. A scenario that uses the files is written beside them.
    """
    from jaxurban.cities.fetch import SCENARIO_FILE, FetchJob, fetch
    from jaxurban.maps.free_memory import parse_bytes

    # The addresses of other places, by the name of what is fetched from there.
    urls = {}
    for text in places:
        name, equals, url = text.partition("=")
        if not equals:
            raise InputError(
                f"--source must be NAME=URL, such as osm=https://a.mirror/town.osm.pbf, got {text!r}"
            )
        urls[name.strip()] = url.strip()
    job = FetchJob(bounds, what, day.date() if day else None, urls, margin_m)
    most_bytes = parse_bytes(max_size, "--max-size")

    # List the requests, or make them.
    if is_dry_run:
        requests = [{"source": each.name, "url": each.url} for each in job.requests()]
        record: Settings = {"requests": requests}
        if not as_json:
            for request in requests:
                print(f"{request['source']}: {request['url']}")
    else:
        record = fetch(job, folder, most_bytes=most_bytes, overwrite=overwrite)
        for note in record["left_out"]:
            LOG.info(note)
        if "osm" in job.what:
            LOG.info(f"fetched into {folder}: run `jaxurban maps {folder / SCENARIO_FILE} -o OUT`")
        else:
            LOG.info(
                f"fetched into {folder}; no scenario is written without osm, as maps need buildings"
            )
    if as_json:
        print_json(record)
