"""jaxurban validate."""

from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import DEVICE, JSON_FLAG, PATH, Numbers, print_json, tell
from jaxurban.progress import reporting


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=PATH)
@click.argument("log_file", metavar="LOG", type=PATH)
@click.option("-o", "output", type=PATH, required=True, help="Output folder.")
@click.option("--set", "changes", metavar="KEY=VALUE", multiple=True, help="Change a setting of SCENARIO; repeatable.")
@click.option(
    "--antenna-height",
    "antenna_height_m",
    type=float,
    default=2.0,
    show_default=True,
    metavar="METRES",
    help="Of the receiver's antenna above the ground.",
)
@click.option("--resolution", "resolution_m", type=float, help="Of the maps, metres.  [default: the scenario's first]")
@click.option(
    "--sky-step",
    "sky_step_s",
    type=float,
    default=30.0,
    show_default=True,
    metavar="SECONDS",
    help="Satellites stand still for so long.",
)
@click.option(
    "--piece",
    "piece_m",
    type=float,
    default=25.0,
    show_default=True,
    help="Metres of track; medians are compared.",
)
@click.option(
    "--pieces",
    "other_pieces_m",
    type=Numbers("M,...", "numbers, as in 10,50"),
    default="10,50,100",
    show_default=True,
    help="Lengths to report too, metres.",
)
@click.option(
    "--block",
    "block_m",
    type=float,
    default=200.0,
    show_default=True,
    help="Metres of track within which ranks compare.",
)
@click.option("--overwrite", is_flag=True, help="Replace another validation in the output folder.")
@DEVICE
@JSON_FLAG
def validate(
    scenario_file: Path,
    log_file: Path,
    output: Path,
    changes: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
    **given: Any,
) -> int:
    """Set the log of a receiver (LOG, .csv or .parquet) against maps of SCENARIO made at its times and its height.

    LOG has the columns utc, lon_deg, lat_deg and num_tracked, error_2d_m or satellite (a row each).
    """
    from jaxurban.io.files import check_writable
    from jaxurban.io.workspace import Workspace
    from jaxurban.report.receiver import REPORT_FILE, numbers_of, save_validation
    from jaxurban.scenario.settings import Scenario
    from jaxurban.studies.receiver.settings import ReceiverSettings
    from jaxurban.studies.receiver.validate import validate as validate_log

    scenario = Scenario.from_toml(scenario_file, changes)
    settings = ReceiverSettings(**given)
    check_writable(output)
    Workspace.check(output, "validate")
    with reporting("validate") as report:
        found = validate_log(scenario, log_file, settings, progress=report)
        report("report")
        save_validation(found, output, overwrite)
    tell(f"validation finished: read {output / REPORT_FILE}, look at {output / 'figures'}")
    if as_json:
        print_json({"folder": str(output), "report": str(output / REPORT_FILE), **numbers_of(found)})
    return 0
