"""jaxurban compare, of maps with others, and jaxurban validate, of maps with a receiver's log."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    NAMES,
    OUTPUT,
    OVERWRITE,
    POSITIVE_COUNT,
    SCENARIO,
    SEED,
    SHOWN,
    MapsOf,
    Numbers,
    Settings,
    print_json,
    run_study,
)

if TYPE_CHECKING:
    from jaxurban.studies.receiver.agreement import SatelliteAgreement


@click.command()
@click.argument("folder_a", metavar="DIR_A", type=MAPS_PATH)
@click.argument("folder_b", metavar="DIR_B", type=MAPS_PATH)
@OUTPUT
@MAPS
@SHOWN("--tolerance", default=1e-6, help="Values that differ by no more count as equal.")
@SHOWN(
    "--routes",
    type=COUNT,
    default=0,
    help="Pairs of places at each altitude whose route on one map is judged on the other.",
)
@SEED
@OVERWRITE
@DEVICE
@JSON_FLAG
def compare(
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
    if as_json:
        from jaxurban.io.tables import records_of

        facts = {
            "left_out": dict(result.left_out),
            "settings": result.settings,
            "layers": records_of(result.table),
            "regrets": records_of(result.regrets),
        }
        print_json(_places_of(output) | facts)


def _places_of(output: Path) -> Settings:
    """Return where a report lies, as ``--json`` prints it."""
    return {"folder": str(output), "report": str(output / "report.md")}


def number_or_text(ctx: click.Context, param: click.Parameter, text: str) -> str | float:
    """Return metres as a number, all else as it is."""
    try:
        return float(text)
    except ValueError:
        return text


@click.command()
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
@SHOWN(
    "--antenna-height",
    "antenna_height_m",
    default=2.0,
    help="Height of the antenna above the ground, metres.",
)
@SHOWN("--sky-step", "sky_step_s", default=30.0, help="Seconds for which one sky is used.")
@SHOWN(
    "--piece",
    "piece_m",
    default=25.0,
    help="Length of the pieces of track whose medians are compared, metres.",
)
@SHOWN(
    "--pieces",
    "other_pieces_m",
    type=Numbers("M,...", "numbers, as in 10,50"),
    default="10,50,100",
    help="Further lengths of pieces to report, metres.",
)
@SHOWN(
    "--block",
    "block_m",
    default=200.0,
    help="Length of the blocks of track within which ranks are compared, metres.",
)
@SHOWN(
    "--sky-block",
    "sky_block_m",
    default=50.0,
    help="Length of the blocks that satellites' intervals draw, metres.",
)
@SHOWN(
    "--known",
    callback=number_or_text,
    default="city",
    metavar="city|all|M|FILE",
    help="Where buildings are known: what their file covers, everywhere, so many metres around the track, or polygons.",
)
@NAMES("--systems", help="Letters of the satellite systems to take, as G,E.")
@SHOWN(
    "--displaced",
    "num_displaced",
    type=POSITIVE_COUNT,
    default=200,
    help="Displaced cities that satellites are set against.",
)
@SEED
@OVERWRITE
@DEVICE
@JSON_FLAG
def validate(
    scenario_file: Path,
    log_file: Path | None,
    output: Path,
    navigation: Path | None,
    reference: Path | None,
    changes: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
    **settings: Any,
) -> None:
    """Compare the log of a receiver with maps of SCENARIO.

    The maps are made at the times and the height of LOG.

    LOG is what the receiver wrote itself (RINEX, NMEA, GnssLogger), or a table of the columns utc, lon_deg, lat_deg,
    and with a row per satellite satellite and cn0_dbhz (azimuth_deg and elevation_deg too, or the scenario's orbits
    give them), with a row per epoch num_tracked or error_2d_m. Left out, it is that of the sample city which SCENARIO
    names.
    """
    from jaxurban.maps.scenario import Scenario
    from jaxurban.studies.receiver.prediction import ReceiverSettings

    receiver = ReceiverSettings(**settings)  # all other options are its fields
    scenario = Scenario.from_toml(scenario_file, changes)
    import pandas as pd

    from jaxurban.io.tables import records_of
    from jaxurban.studies.receiver.validate import validate as validate_log

    result = run_study(
        "validate",
        output,
        partial(
            validate_log,
            scenario,
            log_file,
            receiver,
            navigation=navigation,
            reference=reference,
        ),
        overwrite,
    )
    if as_json:
        (summary,) = records_of(pd.DataFrame([result.summary]))
        facts = {
            "summary": summary,
            "scores": records_of(result.scores),
            "guesses": [guess.sentence for guess in result.guesses],
        }
        if result.satellites is not None:
            facts["satellites"] = _satellite_facts(result.satellites)
        print_json(_places_of(output) | facts)


def _satellite_facts(agreement: "SatelliteAgreement") -> Settings:
    """Return what ``--json`` says of satellites, by name; of displaced cities the median and the largest scores."""
    from jaxurban.io.tables import records_of

    displaced = agreement.displaced[["auc", "within"]].agg(["median", "max"])
    median, most = records_of(displaced)
    return {
        "verdict": agreement.verdict,
        "strong_dbhz": agreement.strong_dbhz,
        "peak": agreement.peak,
        "counts": agreement.counts,
        "scores": records_of(agreement.scores),
        "rivals": records_of(agreement.rivals),
        "displaced": {"median": median, "most": most},
    }
