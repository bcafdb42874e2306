"""jaxurban sky."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import JSON_FLAG, LONLAT, PATH, Settings, print_json
from jaxurban.progress import LOG

if TYPE_CHECKING:
    from jaxurban.paths.sky_along import SkyAlong

PICTURE, MOST_ROWS = ".png", 40


@click.command()
@click.argument("folder", metavar="DIR", type=PATH)
@click.option("--at", "place", type=LONLAT, help="Place: longitude,latitude in degrees.")
@click.option(
    "--track",
    type=PATH,
    metavar="FILE",
    help="Instead of a place: a table (.csv, .parquet) with utc, lon_deg, lat_deg and maybe altitude_m, or a route "
    "(.geojson, .kml, .gpx) that is flown at --speed.",
)
@click.option("--altitude", "altitude_m", type=float, help="Altitude in metres above ground.")
@click.option(
    "--time",
    "times",
    multiple=True,
    help="Time, UTC; repeatable with --at; of a route that of departure.  [default: the maps']",
)
@click.option("--speed", "speed_m_s", type=float, help="Of a route, metres per second.")
@click.option(
    "--by",
    type=click.Choice(["outlines", "map"]),
    default="outlines",
    show_default=True,
    help="Exact rays through the outlines, or the maps' own answer in the cell.",
)
@click.option(
    "--sources",
    type=PATH,
    help="Folder of the files that the maps were made of.  [default: beside the maps]",
)
@click.option(
    "--resolution", "resolution_m", type=float, help="Cell size of the maps, for --by map."
)
@click.option(
    "-o",
    "files",
    type=PATH,
    multiple=True,
    help="File to write: .csv or .parquet, or a picture (.png) of the sky at a place; repeatable.",
)
@JSON_FLAG
def sky(
    folder: Path,
    place: tuple[float, float] | None,
    track: Path | None,
    files: Sequence[Path],
    as_json: bool,
    **options: Any,
) -> int:
    """Say which satellites are seen from a place, or along a track, over the maps in DIR, and what hides the others."""
    from jaxurban.io.tables import SUFFIXES, records_of
    from jaxurban.paths.sky import sky as sky_at
    from jaxurban.report.figures.sky import plot_sky
    from jaxurban.report.write import save

    if (place is None) == (track is None):
        raise click.UsageError("give either --at, a place, or --track, a file")
    suffixes = SUFFIXES if place is None else (*SUFFIXES, PICTURE)
    for file in files:
        if file.suffix.lower() not in suffixes:
            raise click.UsageError(f"-o must end in {' or '.join(suffixes)}, got {str(file)!r}")
    if track is not None and any(file.resolve() == track.resolve() for file in files):
        raise click.UsageError(f"-o must not be the track itself, {str(track)!r}")
    of_maps = {name: options[name] for name in ("by", "sources", "resolution_m")}
    made: Any
    if track is not None:
        made = _along(folder, track, options, of_maps)
        tables = {"table": made.table}
    else:
        assert place is not None
        if options["altitude_m"] is None or options["speed_m_s"] is not None:
            raise click.UsageError("--at needs --altitude, and takes no --speed")
        times = options["times"] or None
        made = sky_at(folder, place, options["altitude_m"], time=times, **of_maps)
        tables = {"table": made.table, "dops": made.dops}
    for file in files:
        is_picture = file.suffix.lower() == PICTURE
        save(file.parent, {file.name: partial(plot_sky, made) if is_picture else made.table})
        LOG.info(f"wrote {file}")
    for sentence in made.cautions:
        LOG.info(sentence)
    if as_json:
        plain = {
            name: records_of(table.replace(float("inf"), float("nan")))
            for name, table in tables.items()
        }
        print_json({"facts": dict(made.facts), "cautions": made.cautions} | plain)
        return 0
    for table in tables.values():
        shown = table.drop(columns=["grid_azimuth_deg", "roof_is_guessed"], errors="ignore")
        how = {"index": False, "max_rows": MOST_ROWS, "na_rep": "", "float_format": "{:.8g}".format}
        print(shown.to_string(**how), end="\n\n")
    print("\n".join(f"{name}: {fact}" for name, fact in made.facts.items() if fact))
    return 0


def _along(folder: Path, file: Path, options: Settings, of_maps: Settings) -> "SkyAlong":
    """Return the sky along the track or the route in a file."""
    from jaxurban.io.read.receiver import ALTITUDE, LAT, LON, UTC, read_track
    from jaxurban.io.read.routes import read_routes
    from jaxurban.io.tables import SUFFIXES
    from jaxurban.paths.sky_along import sky_along

    altitude_m, times, speed_m_s = (options[name] for name in ("altitude_m", "times", "speed_m_s"))
    if file.suffix.lower() in SUFFIXES:
        if times or speed_m_s is not None:
            raise click.UsageError("a table has its own times: leave --time and --speed out")
        rows = read_track(file)
        places = [*zip(rows[LON], rows[LAT], strict=True)]
        if altitude_m is None and ALTITUDE in rows:
            altitude_m = rows[ALTITUDE].tolist()
        return sky_along(folder, places, altitude_m, rows[UTC].tolist(), **of_maps)
    if speed_m_s is None or len(times) > 1:
        raise click.UsageError("a route needs --speed, and one --time, of departure")
    route = read_routes(file)[0]
    altitude_m = route.altitude_m if altitude_m is None else altitude_m
    departure = times[0] if times else None
    places = [(lon, lat) for lon, lat in route.lonlat.tolist()]
    return sky_along(folder, places, altitude_m, departure, speed_m_s=speed_m_s, **of_maps)
