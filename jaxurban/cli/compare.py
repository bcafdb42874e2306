"""jaxurban compare, of maps with others, and jaxurban validate, of maps with a receiver's log."""

from functools import partial
from pathlib import Path
from typing import Any

import click

import jaxurban
from jaxurban.cli.common import (
    CHANGES,
    COUNT,
    DEVICE,
    GIVEN,
    JSON_FLAG,
    MAPS,
    MAPS_PATH,
    OUTPUT,
    OVERWRITE,
    SCENARIO,
    SEED,
    SHOWN,
    MapsOf,
    Settings,
    finite_records,
    log_lines,
    print_json,
    run_study,
)
from jaxurban.cli.options import command, options_of
from jaxurban.studies.receiver.settings import ReceiverSettings


@command()
@click.argument("folder_a", metavar="DIR_A", type=MAPS_PATH)
@click.argument("folder_b", metavar="DIR_B", type=MAPS_PATH)
@OUTPUT
@MAPS
@SHOWN(
    "--routes",
    type=COUNT,
    default=0,
    help="Pairs of places whose route on A, at each altitude, is judged on B.",
)
@SEED
@OVERWRITE
@DEVICE
@JSON_FLAG
def compare_command(
    folder_a: Path,
    folder_b: Path,
    output: Path,
    maps_of: MapsOf,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Report how the maps in DIR_B differ from DIR_A's.

    Differences are given by layer, altitude and time, and for routes.
    """

    # All options that are not named above are arguments of the comparison, which is imported when it runs.
    def study(progress: Any) -> Any:
        return jaxurban.studies.compare(
            maps_of(folder_a), maps_of(folder_b), progress=progress, **options
        )

    result = run_study("compare", output, study, overwrite)
    log_lines(result.decided.facts)
    if as_json:
        tables = finite_records({"layers": result.table, "routes": result.routes})
        facts = {
            "left_out": list(result.left_out),
            "settings": result.settings,
            "decided": result.decided.to_dict(),
        }
        print_json(_places_of(output) | tables | facts)


def _places_of(output: Path) -> Settings:
    """Return where a report lies, as ``--json`` prints it."""
    return {"folder": str(output), "report": str(output / "report.md")}


@command()
@SCENARIO
@click.argument("log_file", metavar="[LOG]", type=GIVEN, required=False)
@OUTPUT
@click.option(
    "--navigation",
    type=GIVEN,
    help="Orbits of a receiver's own log: broadcast RINEX, or what [gps] orbits takes.",
)
@click.option(
    "--reference", type=GIVEN, help="Table of the antenna's places, for a receiver's own log."
)
@CHANGES
@options_of(ReceiverSettings)
@OVERWRITE
@DEVICE
@JSON_FLAG
def validate_command(
    scenario_file: Path,
    log_file: Path | None,
    output: Path,
    changes: tuple[str, ...],
    settings: ReceiverSettings,
    overwrite: bool,
    as_json: bool,
    **files: Any,
) -> None:
    """Say which satellites of a receiver's log a city hides.

    The city is that of SCENARIO, and C/N0 stands beside the margin of each satellite.

    LOG is what the receiver wrote itself (RINEX, NMEA, GnssLogger), or a table with a row per satellite and the columns
    utc, lon_deg, lat_deg, satellite, cn0_dbhz (azimuth_deg and elevation_deg too, or the scenario's orbits give them).
    Left out, it is that of the sample city which SCENARIO names.
    """
    from jaxurban.maps.scenario import Scenario

    scenario = Scenario.from_toml(scenario_file, changes)
    import pandas as pd

    from jaxurban.io.tables import records_of
    from jaxurban.studies.receiver.validate import validate

    study = partial(validate, scenario, log_file, settings, **files)
    result = run_study("validate", output, study, overwrite)
    log_lines(result.decided.facts)
    if as_json:
        (summary,) = records_of(pd.DataFrame([result.summary]))
        facts = {
            "summary": summary,
            "scores": records_of(result.scores),
            "strong_dbhz": result.strong_dbhz,
            "left_out": dict(result.log.left_out),
            "guesses": [guess.sentence for guess in result.guesses],
            "decided": result.decided.to_dict(),
        }
        print_json(_places_of(output) | facts)
