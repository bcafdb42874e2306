"""jaxurban validate, of maps with a receiver's log."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from jaxurban.receivers.validation.settings import ReceiverSettings
from jaxurban.terminal.common import (
    CHANGES,
    DEVICE,
    GIVEN,
    JSON_FLAG,
    OUTPUT,
    OVERWRITE,
    SCENARIO,
    log_lines,
    print_json,
    report_places,
    run_study,
)
from jaxurban.terminal.options import command, options_of


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
    from jaxurban.receivers.validation.validate import validate

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
        print_json(report_places(output) | facts)
