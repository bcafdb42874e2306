"""jaxurban validate."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import DEVICE, JSON_FLAG, PATH, Numbers, run_study


def _number(flag: str, name: str, default: float, text: str) -> Callable[[Callable], Callable]:
    return click.option(flag, name, type=float, default=default, show_default=True, help=text)


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=PATH)
@click.argument("log_file", metavar="LOG", type=PATH)
@click.option("-o", "output", type=PATH, required=True, help="Output folder.")
@click.option("--set", "changes", metavar="KEY=VALUE", multiple=True, help="Change a setting of SCENARIO; repeatable.")
@_number("--antenna-height", "antenna_height_m", 2.0, "Metres of the receiver's antenna above the ground.")
@_number("--sky-step", "sky_step_s", 30.0, "Seconds for which satellites stand still.")
@_number("--piece", "piece_m", 25.0, "Metres of track; medians are compared.")
@click.option(
    "--pieces",
    "other_pieces_m",
    type=Numbers("M,...", "numbers, as in 10,50"),
    default="10,50,100",
    show_default=True,
    help="Lengths to report too, metres.",
)
@_number("--block", "block_m", 200.0, "Metres of track within which ranks compare.")
@click.option("--overwrite", is_flag=True, help="Replace another validation in the output folder.")
@DEVICE
@JSON_FLAG
def validate(scenario_file: Path, log_file: Path, output: Path, changes: tuple[str, ...], **given: Any) -> int:
    """Set the log of a receiver (LOG, .csv or .parquet) against maps of SCENARIO made at its times and its height.

    LOG has the columns utc, lon_deg, lat_deg and num_tracked or error_2d_m, a row an epoch.
    """
    import pandas as pd

    from jaxurban.io.tables import records_of
    from jaxurban.maps.scenario import Scenario
    from jaxurban.studies.receiver.prediction import ReceiverSettings
    from jaxurban.studies.receiver.validate import ReceiverValidation
    from jaxurban.studies.receiver.validate import validate as validate_log

    scenario = Scenario.from_toml(scenario_file, changes)
    settings = ReceiverSettings(**{name: given.pop(name) for name in ReceiverSettings.__dataclass_fields__})

    def facts(found: ReceiverValidation) -> dict[str, Any]:
        (summary,) = records_of(pd.DataFrame([found.summary]))
        return {"summary": summary, "scores": records_of(found.scores), "guesses": list(found.guesses)}

    study = partial(validate_log, scenario, log_file, settings)
    return run_study("validate", output, lambda report: study(progress=report), facts, given)
