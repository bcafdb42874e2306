"""jaxurban fetch."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import JSON_FLAG, PATH, Numbers, names_in, print_json, tell
from jaxurban.errors import InputError

if TYPE_CHECKING:
    from jaxurban.io.fetch_plan import FetchJob


@click.command()
@click.option("--bounds", type=Numbers("W,S,E,N", "west, south, east, north", 4), required=True, help="Degrees.")
@click.option("-o", "folder", type=PATH, required=True, help="Folder for the files.")
@click.option("--what", default="osm,census,districts,orbits", show_default=True, help="What to fetch.")
@click.option(
    "--date",
    "day",
    type=click.DateTime(["%Y-%m-%d"]),
    help="Day of the GPS maps (UTC).  [default: that of the element sets]",
)
@click.option("--extract", metavar="URL", help="OSM extract (.osm.pbf or .osm) to use instead of the Overpass API.")
@click.option("--districts", metavar="URL", help="District polygons (GeoJSON).")
@click.option("--district-field", default="BoroCD", show_default=True, help="Field of their labels, whole numbers.")
@click.option("--census", "census_year", type=click.Choice(["2020", "2010"]), default="2020", show_default=True)
@click.option("--county", "counties", multiple=True, help="Five digits, such as 36061; repeatable.")
@click.option("--margin", "margin_m", type=float, default=1000.0, show_default=True, help="Of buildings, metres.")
@click.option("--source", "sources", metavar="NAME=URL", multiple=True, help="Use another place (see docs/fetch.md).")
@click.option("--max-size", default="500MB", show_default=True, help="The largest file accepted (units of 1,024).")
@click.option(
    "--timeout",
    "timeout_s",
    type=float,
    default=200.0,
    show_default=True,
    help="The longest silence of a server, seconds.",
)
@click.option("--offline", "is_offline", is_flag=True, help="Make no request: use what the cache has.")
@click.option("--overwrite", is_flag=True, help="Move files that are in the way to the folder kept.")
@click.option("--dry-run", "is_dry_run", is_flag=True, help="List the requests, and make none.")
@JSON_FLAG
def fetch(
    folder: Path,
    max_size: str,
    timeout_s: float,
    is_offline: bool,
    overwrite: bool,
    is_dry_run: bool,
    as_json: bool,
    **settings: Any,
) -> int:
    """Download what the maps of a region need from public sources, and write a scenario that uses it."""
    import tomli_w

    from jaxurban.io.download import open_cache
    from jaxurban.io.fetch import SCENARIO_FILE, staged
    from jaxurban.io.fetch import fetch as fetch_files
    from jaxurban.maps.memory import parse_bytes
    from jaxurban.maps.scenario import Scenario

    job, most_bytes = _job(**settings), parse_bytes(max_size, "--max-size")
    if is_dry_run:
        return _list(job, as_json)
    with (
        staged(folder, job.what, overwrite=overwrite) as stage,
        open_cache(most_bytes=most_bytes, timeout_s=timeout_s, is_offline=is_offline) as cache,
    ):
        parts, record = fetch_files(job, stage, cache)
        scenario = folder / SCENARIO_FILE if "buildings" in parts else None
        if scenario is not None:
            Scenario.from_dict(parts, name=SCENARIO_FILE)
            credits = sorted({f"# {file['source']}: {file['credit']} ({file['licence']})" for file in record["files"]})
            head = "\n".join(["# Made by jaxurban fetch; fetch.json says where each file is from.", *credits])
            (stage / SCENARIO_FILE).write_text(f"{head}\n\n{tomli_w.dumps(parts)}", encoding="utf-8")
    for note in record["left_out"]:
        tell(note)
    if scenario is None:
        tell(f"fetched into {folder}; no scenario is written without osm, as maps need buildings")
    else:
        tell(f"fetched into {folder}: run `jaxurban maps {scenario} -o OUT`")
    if as_json:
        print_json(record | {"scenario": None if scenario is None else str(scenario)})
    return 0


def _job(
    *,
    bounds: tuple[float, ...],
    what: str,
    day: datetime | None,
    extract: str | None,
    districts: str | None,
    sources: Sequence[str],
    **settings: Any,
) -> "FetchJob":
    """Return the job that the options describe."""
    from jaxurban.io.fetch_plan import FetchJob

    if bad := [text for text in sources if "=" not in text]:
        example = "osm=https://a.mirror/api?data={query}"
        raise InputError(f"--source must be NAME=URL, such as {example}, got {bad[0]!r}")
    named = {name.strip(): url.strip() for name, _, url in (text.partition("=") for text in sources)}
    return FetchJob(
        bounds=bounds,
        what=names_in(what),
        day=None if day is None else day.date(),
        given_urls=named | {name: url for name, url in (("osm", extract), ("districts", districts)) if url},
        **settings,
    )


def _list(job: "FetchJob", as_json: bool) -> int:
    """Show the requests that would be made, were nothing in the cache."""
    from jaxurban.io.fetch_plan import plan_fetch

    requests, left_out = plan_fetch(job)
    if as_json:
        print_json({"requests": [{"source": name, "url": url} for name, url in requests], "left_out": left_out})
    else:
        print("\n".join(f"{name}: {url}" for name, url in requests))
    for note in left_out:
        tell(note)
    return 0
