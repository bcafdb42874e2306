"""jaxurban tune."""

from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    CONSTRAINTS,
    DEVICE,
    JSON_FLAG,
    OBSTACLES,
    PATH,
    PRESET,
    RESOLUTION,
    given_constraints,
    names_in,
    print_json,
)
from jaxurban.progress import LOG


@click.command()
@click.argument("words", metavar="DIR [ROUTES]...", type=PATH, nargs=-1, required=True)
@click.option("-o", "out", type=PATH, required=True, help="Output folder.")
@click.option(
    "--sample",
    type=click.IntRange(min=1),
    help="Number of queries to draw in each city instead of reading ROUTES.",
)
@click.option(
    "--pilot",
    help="Weights such as gps=1,risk=2 that plan the routes of --sample, of studies and of tables; 0 if not named.",
)
@click.option(
    "--planner",
    help="Planner of a study whose routes to take.  [default: the one that most often proved them the cheapest]",
)
@click.option(
    "--hold-out",
    type=float,
    help="Share of the routes that is kept from the fits, to test them.  [default: 0]",
)
@click.option(
    "--by-city", is_flag=True, help="Also fit to each city alone, and to all cities but it."
)
@click.option(
    "--wish",
    "wishes",
    multiple=True,
    help="Target for an outcome, such as mean_gps>=0.8; repeatable.",
)
@click.option(
    "--metrics",
    help="Metrics to fit, such as gps,risk; the others get weight 0.  [default: all of the maps]",
)
@click.option(
    "--altitude",
    "altitude_m",
    type=float,
    help="Altitude of every route, metres.  [default: the routes' altitude_m]",
)
@click.option(
    "--time-of-day",
    help="Time of day of the population map.  [default: the routes' own, else the first]",
)
@click.option(
    "--time", help="Time of the GPS map, UTC.  [default: the routes' own, else the first]"
)
@RESOLUTION
@click.option(
    "--cost-model",
    type=click.Choice(["cell", "line"]),
    help="Cost model; cell is the paper's.  [default: the routes' own, else the scenario's]",
)
@OBSTACLES
@PRESET
@CONSTRAINTS
@click.option(
    "--scale",
    type=click.Choice(["simplex", "distance"]),
    help="Weights sum to 1, or distance has 1.",
)
@click.option(
    "--bootstrap",
    type=click.IntRange(min=0),
    help="Number of fits for the intervals.  [default: 200]",
)
@click.option("--rounds", "max_rounds", type=click.IntRange(min=1), help="Most rounds of searches.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of random numbers.",
)
@click.option(
    "--budget", "budget_s", type=float, help="Seconds after which no further round begins."
)
@click.option(
    "--overwrite",
    is_flag=True,
    help="Replace a fit of other routes or settings in the output folder.",
)
@DEVICE
@JSON_FLAG
def tune(words: tuple[Path, ...], out: Path, **options: Any) -> int:
    """Fit weights to demonstrated ROUTES over the maps in each DIR, or to targets for outcomes.

    ROUTES are files of lines (GeoJSON, KML, GPX), tables of instances (.csv, .parquet) or folders of a study; without
    any, the study that `jaxurban study` kept in DIR. Several DIRs, each with its ROUTES, are fitted together.
    """
    from jaxurban.io.store import ZARR_FOLDER
    from jaxurban.io.tables import ROWS_FILE
    from jaxurban.metrics.weights import Weights
    from jaxurban.paths.rows import MapsFolder
    from jaxurban.report.tuning import TuneSettings, run_tuning
    from jaxurban.studies.route_pool import FitSettings
    from jaxurban.studies.study_demonstrations import study_in

    def named(*names: str) -> dict[str, Any]:
        return {name: options[name] for name in names if options[name] is not None}

    fits = named("scale", "bootstrap", "hold_out") | (
        {"by_city": True} if options["by_city"] else {}
    )
    if options["wishes"] and fits:
        raise click.UsageError(
            "--scale, --bootstrap, --hold-out and --by-city belong to fits without --wish: leave them out"
        )
    on_maps = named("altitude_m", "time", "time_of_day", "cost_model", "preset")
    on_maps["constraints"] = given_constraints(options)
    if options["metrics"] is not None:
        on_maps["metrics"] = names_in(options["metrics"])
    nothing = Weights(**dict.fromkeys(Weights().to_dict(), 0.0))
    settings = TuneSettings(
        routes=on_maps,
        sample=options["sample"],
        pilot=None if options["pilot"] is None else Weights.parse(options["pilot"], nothing),
        planner=options["planner"],
        targets=options["wishes"],
        fits=fits,
        fit=FitSettings(**named("max_rounds", "seed", "budget_s")),
    )
    of_maps = {name: options[name] for name in ("resolution_m", "obstacles")}
    sources: dict[MapsFolder, list[Path]] = {}
    folder = MapsFolder(words[0], **of_maps)
    for word in words:
        is_study = (word / ROWS_FILE).is_file() and not (word / ZARR_FOLDER).exists()
        if (
            sources and options["sample"] is None and study_in(word)
        ):  # of maps that have no routes yet
            is_study = is_study or not (sources[folder] or study_in(Path(folder.folder)))
        if not sources or (word.is_dir() and not is_study):
            folder = MapsFolder(word.parent if is_study else word, **of_maps)
            sources.setdefault(folder, [])
        if is_study or not word.is_dir():
            sources[folder].append(word)
    facts = run_tuning(sources, out, settings, overwrite=options["overwrite"])
    LOG.info(facts["message"])
    for warning in facts.get("unidentified", []) + facts.get("warnings", []):
        if warning != facts["message"]:
            LOG.info(f"warning: {warning}")
    LOG.info(f"tune finished: read {out / 'report.md'}; the weights are in {out / 'weights.toml'}")
    if options["as_json"]:
        print_json(facts)
    else:
        print(facts["weights_option"])
    return 0
