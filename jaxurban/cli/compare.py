"""jaxurban compare, of maps with others, and jaxurban validate, of maps with a receiver's log."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import (
    DEVICE,
    JSON_FLAG,
    OBSTACLES,
    PATH,
    RESOLUTION,
    Numbers,
    print_json,
    run_study,
)

if TYPE_CHECKING:
    from jaxurban.studies.receiver.agreement import SatelliteAgreement


@click.command()
@click.argument("folder_a", metavar="DIR_A", type=PATH)
@click.argument("folder_b", metavar="DIR_B", type=PATH)
@click.option("-o", "output", type=PATH, required=True, help="Output folder.")
@RESOLUTION
@OBSTACLES
@click.option(
    "--tolerance",
    type=float,
    default=1e-6,
    show_default=True,
    help="Values that differ by no more count as equal.",
)
@click.option(
    "--routes",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Pairs of places at each altitude whose route on one map is judged on the other.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of these places."
)
@click.option("--overwrite", is_flag=True, help="Replace another comparison in the output folder.")
@DEVICE
@JSON_FLAG
def compare(folder_a: Path, folder_b: Path, output: Path, **options: Any) -> int:
    """Report how the maps in DIR_B differ from those in DIR_A: by layer, altitude and time, and for routes."""
    from jaxurban.io.tables import records_of
    from jaxurban.paths.rows import MapsFolder
    from jaxurban.report.map_comparison import compare as compare_maps

    study = partial(
        compare_maps,
        *(
            MapsFolder(folder, options["resolution_m"], options["obstacles"])
            for folder in (folder_a, folder_b)
        ),
        **{name: options[name] for name in ("tolerance", "routes", "seed")},
    )
    result = run_study(
        "compare", output, lambda report: study(progress=report), options["overwrite"]
    )
    if options["as_json"]:
        facts = {
            "left_out": dict(result.left_out),
            "settings": result.settings,
            "layers": records_of(result.table),
        }
        facts["regrets"] = records_of(result.regrets)
        print_json({"folder": str(output), "report": str(output / "report.md"), **facts})
    return 0


NUMBER = partial(click.option, type=float, show_default=True)


class Known(click.ParamType):
    """Where buildings are known: a word, metres, or a file."""

    name = "known"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> str | float:
        """Return metres as a number, all else as it is."""
        try:
            return float(value)
        except ValueError:
            return str(value)


class Letters(click.ParamType):
    """Letters with commas between them."""

    name = "letters"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the letters."""
        return value if isinstance(value, tuple) else tuple(filter(None, str(value).split(",")))


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=PATH)
@click.argument("log_file", metavar="[LOG]", type=PATH, required=False)
@click.option("-o", "output", type=PATH, required=True, help="Output folder.")
@click.option(
    "--navigation",
    type=PATH,
    help="Broadcast orbits in RINEX 3; LOG is then a file of observations.",
)
@click.option("--reference", type=PATH, help="Table of the antenna's places, for a log in RINEX.")
@click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change a setting of SCENARIO; repeatable.",
)
@NUMBER(
    "--antenna-height",
    "antenna_height_m",
    default=2.0,
    help="Height of the antenna above the ground, metres.",
)
@NUMBER("--sky-step", "sky_step_s", default=30.0, help="Seconds for which one sky is used.")
@NUMBER(
    "--piece",
    "piece_m",
    default=25.0,
    help="Length of the pieces of track whose medians are compared, metres.",
)
@click.option(
    "--pieces",
    "other_pieces_m",
    type=Numbers("M,...", "numbers, as in 10,50"),
    default="10,50,100",
    show_default=True,
    help="Further lengths of pieces to report, metres.",
)
@NUMBER(
    "--block",
    "block_m",
    default=200.0,
    help="Length of the blocks of track within which ranks are compared, metres.",
)
@NUMBER(
    "--sky-block",
    "sky_block_m",
    default=50.0,
    help="Length of the blocks that satellites' intervals draw, metres.",
)
@click.option(
    "--known",
    type=Known(),
    default="city",
    show_default=True,
    metavar="city|all|M|FILE",
    help="Where buildings are known: what their file covers, everywhere, so many metres around the track, or polygons.",
)
@click.option(
    "--systems",
    type=Letters(),
    default="",
    help="Letters of the satellite systems to take, as G,E.",
)
@click.option(
    "--displaced",
    "num_displaced",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    help="Displaced cities that satellites are set against.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of displacements and draws.",
)
@click.option("--overwrite", is_flag=True, help="Replace another validation in the output folder.")
@DEVICE
@JSON_FLAG
def validate(
    scenario_file: Path,
    log_file: Path | None,
    output: Path,
    changes: tuple[str, ...],
    **options: Any,
) -> int:
    """Compare the log of a receiver (LOG, .csv or .parquet) with maps of SCENARIO made at its times and its height.

    LOG has the columns utc, lon_deg, lat_deg, and with a row a satellite satellite and cn0_dbhz (azimuth_deg and
    elevation_deg too, or the scenario's orbits give them), with a row an epoch num_tracked or error_2d_m. Left out, it
    is that of the sample city which SCENARIO names.
    """
    import pandas as pd

    from jaxurban.io.tables import records_of
    from jaxurban.maps.scenario import Scenario
    from jaxurban.report.receiver import validate as validate_log
    from jaxurban.studies.receiver.prediction import ReceiverSettings

    settings = ReceiverSettings(
        **{name: options[name] for name in ReceiverSettings.__dataclass_fields__}
    )
    files = {name: options[name] for name in ("navigation", "reference")}
    study = partial(
        validate_log, Scenario.from_toml(scenario_file, changes), log_file, settings, **files
    )
    result = run_study(
        "validate", output, lambda report: study(progress=report), options["overwrite"]
    )
    if options["as_json"]:
        (summary,) = records_of(pd.DataFrame([result.summary]))
        facts: dict[str, Any] = {
            "summary": summary,
            "scores": records_of(result.scores),
            "guesses": list(result.guesses),
        }
        if result.satellites is not None:
            facts["satellites"] = _satellite_facts(result.satellites)
        print_json({"folder": str(output), "report": str(output / "report.md"), **facts})
    return 0


def _satellite_facts(of: "SatelliteAgreement") -> dict[str, Any]:
    """Return what the rows of satellites amount to; of the displaced cities the median and the most."""
    from jaxurban.io.tables import records_of

    null = of.displaced[["auc", "within"]]
    (median, most) = records_of(null.agg(["median", "max"]))
    facts = {
        "verdict": of.verdict,
        "strong_dbhz": of.strong_dbhz,
        "peak": of.peak,
        "counts": of.counts,
    }
    tables = {"scores": records_of(of.scores), "rivals": records_of(of.rivals)}
    return {**facts, **tables, "displaced": {"median": median, "most": most}}
