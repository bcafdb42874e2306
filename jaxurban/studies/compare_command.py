"""jaxurban compare, of maps with others."""

import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

import jaxurban
from jaxurban.terminal.common import (
    COUNT,
    DEVICE,
    JSON_FLAG,
    MAPS_PATH,
    OUTPUT,
    OVERWRITE,
    RESOLUTION,
    SEED,
    SHOWN,
    finite_records,
    log_lines,
    number_or_file,
    print_json,
    report_places,
    run_study,
)
from jaxurban.terminal.options import command


@command()
@click.argument("folder_a", metavar="DIR_A", type=MAPS_PATH)
@click.argument("folder_b", metavar="DIR_B", type=MAPS_PATH)
@OUTPUT
@RESOLUTION
@SHOWN(
    "--routes",
    metavar="NUMBER|FILE",
    callback=partial(number_or_file, COUNT),
    default="0",
    help="Pairs of places whose route on A, at each altitude, is judged on B: how many, or a table (.csv, .parquet).",
)
@SEED
@OVERWRITE
@DEVICE
@JSON_FLAG
def compare_command(
    folder_a: Path,
    folder_b: Path,
    output: Path,
    resolution_m: float | None,
    overwrite: bool,
    as_json: bool,
    routes: int | Path,
    **options: Any,
) -> None:
    """Report how the maps in DIR_B differ from DIR_A's.

    Differences are given by layer, altitude and time, and for routes.
    """

    # All options that are not named above are arguments of the comparison, which is imported when it runs.
    def study(progress: Any) -> Any:
        from jaxurban.io.tables import read_table
        from jaxurban.paths.rows import MapsFolder

        a, b = MapsFolder(folder_a, resolution_m), MapsFolder(folder_b, resolution_m)
        asked: Any = routes
        if isinstance(routes, Path):
            asked = read_table(routes, "routes")
        result = jaxurban.studies.compare(a, b, routes=asked, progress=progress, **options)
        return replace(result, routes_file=shlex.quote(f"{output / 'tables' / 'routes.csv'}"))

    result = run_study("compare", output, study, overwrite)
    log_lines(result.decided.facts)
    if as_json:
        tables = finite_records({"layers": result.table, "routes": result.routes})
        facts = {
            "left_out": list(result.left_out),
            "settings": result.settings,
            "decided": result.decided.to_dict(),
        }
        print_json(report_places(output) | tables | facts)
