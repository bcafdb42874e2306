"""jaxurban fetch."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import JSON_FLAG, PATH, print_json, tell
from jaxurban.errors import InputError

if TYPE_CHECKING:
    from jaxurban.io.fetch.download import Cache
    from jaxurban.io.fetch.plan import FetchJob


class BoxType(click.ParamType):
    """``W,S,E,N`` in degrees."""

    name = "W,S,E,N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Return the four numbers of ``value``."""
        try:
            west, south, east, north = (float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(
                f"{value!r} must be west,south,east,north in degrees, as in -74.02,40.70,-73.98,40.73", param, ctx
            )
        return west, south, east, north


@click.command()
@click.option("--bounds", type=BoxType(), required=True, help="West, south, east, north of the region in degrees.")
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
    folder: Path, timeout_s: float, is_offline: bool, overwrite: bool, is_dry_run: bool, as_json: bool, **settings: Any
) -> int:
    """Download what the maps of a region need from public sources, and write a scenario that uses it."""
    from jaxurban.io.fetch.download import open_cache
    from jaxurban.io.fetch.fetch import targets
    from jaxurban.io.fetch.staging import SCENARIO_FILE, staged

    job = _job(**settings)
    if is_dry_run:
        return _list(job, as_json)
    with (
        staged(folder, targets(job.what), overwrite=overwrite) as stage,
        open_cache(most_bytes=job.most_bytes, timeout_s=timeout_s, is_offline=is_offline) as cache,
    ):
        record, has_scenario = _fetch(job, stage, cache)
    scenario = folder / SCENARIO_FILE if has_scenario else None
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
    what: str,
    day: datetime | None,
    sources: Sequence[str],
    max_size: str,
    extract: str | None,
    districts: str | None,
    **settings: Any,
) -> "FetchJob":
    """Return the job that the options describe."""
    from jaxurban.io.fetch.plan import FetchJob
    from jaxurban.maps.memory import parse_bytes

    given = {"osm": extract, "districts": districts}
    return FetchJob(
        what=tuple(name.strip() for name in what.split(",") if name.strip()),
        day=None if day is None else day.date(),
        today=datetime.now(UTC).date(),
        given_urls=_named_urls(sources) | {name: url for name, url in given.items() if url},
        most_bytes=parse_bytes(max_size, "--max-size"),
        **settings,
    )


def _named_urls(sources: Sequence[str]) -> dict[str, str]:
    """Return URL templates by source."""
    if bad := [text for text in sources if "=" not in text]:
        raise InputError(f"--source must be NAME=URL, such as osm=https://a.mirror/api?data={{query}}, got {bad[0]!r}")
    return {name.strip(): url.strip() for name, _, url in (text.partition("=") for text in sources)}


def _list(job: "FetchJob", as_json: bool) -> int:
    """Show the requests that would be made, were nothing in the cache."""
    from jaxurban.io.fetch.plan import plan_fetch

    plan = plan_fetch(job)
    rows = [{"source": download.source.name, "url": download.url} for download in plan.downloads]
    if as_json:
        print_json({"requests": rows, "left_out": plan.left_out})
    else:
        for row in rows:
            print(f"{row['source']}: {row['url']}")
    for note in plan.left_out:
        tell(note)
    return 0


def _fetch(job: "FetchJob", folder: Path, cache: "Cache") -> tuple[dict[str, Any], bool]:
    """Get the files and write the scenario; return the record, and whether there is a scenario."""
    import tomli_w

    from jaxurban.io.fetch.fetch import fetch
    from jaxurban.io.fetch.staging import SCENARIO_FILE
    from jaxurban.io.files import write_whole
    from jaxurban.scenario.settings import Scenario

    settings, record = fetch(job, folder, cache)
    has_scenario = "buildings" in settings
    if has_scenario:
        Scenario.from_dict(settings, name=SCENARIO_FILE)
        credits = sorted({f"# {file['source']}: {file['credit']} ({file['licence']})" for file in record["files"]})
        head = "\n".join(["# Made by jaxurban fetch; fetch.json says where each file is from.", *credits])
        write_whole(folder / SCENARIO_FILE, f"{head}\n\n{tomli_w.dumps(settings)}")
    return record, has_scenario
