"""jaxurban compare."""

from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    CONSTRAINTS,
    COST_MODEL,
    DEGREES,
    DEVICE,
    JSON_FLAG,
    OBSTACLES,
    PATH,
    PRESET,
    RESOLUTION,
    given_rules,
    print_json,
    take_snap,
    tell,
)
from jaxurban.errors import InputError
from jaxurban.progress import reporting


@click.command()
@click.argument("folder_a", metavar="DIR_A", type=PATH)
@click.argument("folder_b", metavar="DIR_B", type=PATH)
@click.option("-o", "output", type=PATH, required=True, help="Output folder.")
@click.option(
    "--routes",
    default="20",
    show_default=True,
    metavar="NUMBER|FILE",
    help="Queries to plan on both: so many sampled at each altitude, or a table (.csv, .parquet); 0 for none.",
)
@click.option(
    "--time", "times", multiple=True, metavar="A=B", help="Set B's time B beside A's time A, UTC; repeatable."
)
@RESOLUTION
@OBSTACLES
@click.option("--weights", "weights_text", default="", help="As gps=1,risk=2; those not named are as DIR_A was made.")
@PRESET
@COST_MODEL
@CONSTRAINTS
@click.option("--snap", is_flag=True, help="Move ends of queries out of obstacles, by 50 m at most.")
@click.option("--snap-distance", "snap_distance_m", type=float, metavar="METRES", help="--snap by at most so far.")
@click.option(
    "--tolerance", type=float, default=1e-6, show_default=True, help="Values that differ by no more are the same."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of sampled queries.")
@click.option("--overwrite", is_flag=True, help="Replace another comparison in the output folder.")
@DEGREES
@DEVICE
@JSON_FLAG
def compare(folder_a: Path, folder_b: Path, output: Path, as_json: bool, overwrite: bool, **given: Any) -> int:
    """Report how the maps in DIR_B differ from those in DIR_A: by layer, altitude and stratum, and in the routes."""
    from jaxurban.io.files import check_writable
    from jaxurban.io.tables import records_of
    from jaxurban.io.workspace import Workspace
    from jaxurban.report.map_comparison import REPORT_FILE, save_comparison
    from jaxurban.studies.map_comparison.compare import compare as compare_maps
    from jaxurban.studies.montecarlo.run import MapsFolder

    sides = [MapsFolder(folder, given["resolution_m"], given["obstacles"]) for folder in (folder_a, folder_b)]
    how = {
        "routes": _routes(given["routes"]),
        "times": _times(given["times"]),
        "snap": take_snap(given),
        "tolerance": given["tolerance"],
        "seed": given["seed"],
        **given_rules(given),
    }
    check_writable(output)
    Workspace.check(output, "compare")
    with reporting("compare") as report:
        found = compare_maps(*sides, **how, progress=report)
        report("report")
        save_comparison(found, output, overwrite, degrees=given["degrees"])
    tell(f"comparison finished: read {output / REPORT_FILE}, look at {output / 'figures'}")
    if as_json:
        made: dict[str, Any] = {"folder": str(output), "report": str(output / REPORT_FILE)}
        made |= {"left_out": dict(found.part.left_out), "settings": found.settings, "layers": records_of(found.table)}
        print_json(made | {"routes": None if found.routes is None else records_of(found.routes.table)})
    return 0


def _routes(text: str) -> Any:
    """Return how many routes are asked for, or the table in a file."""
    if text.isdecimal():
        return int(text)
    from jaxurban.io.tables import read_table

    if not text.endswith((".csv", ".parquet")):
        raise InputError(f"--routes {text!r} must be how many to sample, as 20, or a table (.csv, .parquet)")
    return read_table(text, "routes")


def _times(pairs: tuple[str, ...]) -> dict[str, str] | None:
    """Return B's times by A's."""
    if wrong := [pair for pair in pairs if pair.count("=") != 1]:
        raise InputError(
            f"--time {wrong[0]!r} must be A's time=B's time, as in 2026-07-01T06:00:00Z=2026-07-01T18:00:00Z"
        )
    return dict(pair.split("=") for pair in pairs) or None
