"""jaxurban sky."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import jaxurban
from jaxurban import wings
from jaxurban.paths.suffixes import PICTURES
from jaxurban.terminal.common import (
    FILES,
    FOLDER,
    GIVEN,
    JSON_FLAG,
    LONLAT,
    NUMBER,
    SOURCES,
    Point,
    Settings,
    check_over_maps,
    finite_records,
    print_json,
    write_outputs,
)
from jaxurban.terminal.options import command

if TYPE_CHECKING:
    import pandas as pd

MOST_ROWS = 40
NOT_PRINTED = ["grid_azimuth_deg", "roof_is_guessed"]  # columns


@command()
@FOLDER
@click.option(
    "--at",
    "place",
    type=LONLAT,
    callback=check_over_maps,
    help="Place: longitude,latitude in degrees.",
)
@click.option(
    "--track",
    type=GIVEN,
    metavar="FILE",
    help="Instead of a place: a table (.csv, .parquet) with utc, lon_deg, lat_deg and maybe altitude_m, a receiver's "
    "log (RINEX, NMEA, GnssLogger), a flight with times (.gpx, .kml, .ulg), or a route (.geojson, .kml, .gpx) that is "
    "flown at --speed.",
)
@click.option(
    "--reference", type=GIVEN, help="Table of the antenna's places, for a receiver's log."
)
@click.option(
    "--by-satellite",
    is_flag=True,
    help="With --track: a row a place and satellite, with C/N0 of a log.",
)
@NUMBER("--altitude", "altitude_m", help="Altitude in metres above ground.")
@click.option(
    "--time",
    "times",
    multiple=True,
    help="Time, UTC; repeatable with --at; of a route that of departure.  [default: the maps']",
)
@NUMBER("--speed", "speed_m_s", help="Of a route, metres per second.")
@SOURCES
@FILES(
    help="File to write: .csv or .parquet, or a picture (.png, .pdf, .svg) of the sky at a place; repeatable."
)
@JSON_FLAG
def sky_command(
    folder: Path,
    place: Point | None,
    track: Path | None,
    reference: Path | None,
    by_satellite: bool,
    altitude_m: float | None,
    times: tuple[str, ...],
    speed_m_s: float | None,
    files: tuple[Path, ...],
    as_json: bool,
    **source: Any,
) -> None:
    """Say which satellites are seen, and what hides others.

    They are seen from a place, or along a track, over the maps in DIR.
    """
    from jaxurban.receivers.log_files import read_log

    # The sky at a place, or along a track; further options are arguments of both.
    _check_files(files, track)
    logged = None if track is None else read_log(track, reference)
    if (by_satellite and track is None) or (reference is not None and logged is None):
        raise click.UsageError(
            "--by-satellite needs --track, and --reference a receiver's log there"
        )
    result: Any
    if place is not None and track is None:
        if altitude_m is None or speed_m_s is not None:
            raise click.UsageError("--at needs --altitude, and takes no --speed")
        result = jaxurban.sky(folder, place, altitude_m, time=times or None, **source)
        tables = {"table": result.table, "dops": result.dops}
    elif track is not None and place is None:
        way = _way_along(track, logged, altitude_m, times, speed_m_s)
        result = jaxurban.sky_along(folder, **way, **source)
        tables = {"table": result.satellites if by_satellite else result.table}
    else:
        raise click.UsageError("give either --at, a place, or --track, a file")

    # Files, and what is printed.
    from jaxurban.receivers.figures import plot_sky

    write_outputs(files, partial(plot_sky, result), tables["table"], result.cautions)
    if as_json:
        facts = {"facts": dict(result.facts), "cautions": result.cautions}
        print_json(facts | finite_records(tables))
        return
    for table in tables.values():
        table = table.drop(columns=NOT_PRINTED, errors="ignore")
        rounded = {name: 2 for name in table if {"lon", "lat"}.isdisjoint(name.split("_"))}
        text = table.round(rounded).to_string(
            index=False, max_rows=MOST_ROWS, na_rep="", float_format="{:.8g}".format
        )
        print(f"{text}\n")
    for name, fact in result.facts.items():
        if fact:
            print(f"{name}: {fact}")


def _way_along(
    track: Path,
    logged: "pd.DataFrame | None",
    altitude_m: float | None,
    times: tuple[str, ...],
    speed_m_s: float | None,
) -> Settings:
    """Return where and when a track leads, as keywords of `jaxurban.sky_along`.

    A table has a time and a place in each row, and maybe an altitude; the log of a flight has no altitude above the
    ground. A route is flown at a speed from the time of departure on.

    Args:
      track: the file.
      logged: its places and times if it is a receiver's log.
      altitude_m, times, speed_m_s: as the options say.

    Raises:
      InputError: a file that cannot be read.
      UsageError: a time or a speed that such a file does not take, or that is missing.
    """
    from jaxurban.io.routes import read_routes
    from jaxurban.io.tables import is_table
    from jaxurban.io.tracks import read_track

    if logged is not None or is_table(track):
        if times or speed_m_s is not None:
            raise click.UsageError("a table has its own times: leave --time and --speed out")
        places = read_track(track) if logged is None else logged
        return {"places": places, "altitude_m": altitude_m}
    if speed_m_s is None and not times:
        return {"places": wings.read_flight(track), "altitude_m": altitude_m}
    if speed_m_s is None or len(times) > 1:
        raise click.UsageError("a route needs --speed, and one --time, of departure")
    route = read_routes(track)[0]
    return {
        "places": [(lon, lat) for lon, lat in route.lonlat.tolist()],
        "altitude_m": route.altitude_m if altitude_m is None else altitude_m,
        "times": times[0] if times else None,
        "speed_m_s": speed_m_s,
    }


def _check_files(files: tuple[Path, ...], track: Path | None) -> None:
    """Raise UsageError for a file that cannot be written, or is the track that is read.

    Args:
      files: to write: tables, and of the sky at a place pictures too.
      track: that the sky is wanted along; None: it is wanted at a place.
    """
    from jaxurban.io.tables import SUFFIXES

    suffixes = (*SUFFIXES, *PICTURES) if track is None else SUFFIXES
    for file in files:
        if file.suffix.lower() not in suffixes:
            raise click.UsageError(f"-o must end in {' or '.join(suffixes)}, got {str(file)!r}")
        if track is not None and file.resolve() == track.resolve():
            raise click.UsageError(f"-o must not be the track itself, {str(track)!r}")
