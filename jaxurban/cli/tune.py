"""jaxurban tune."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import click

from jaxurban.checks import values_given
from jaxurban.cli.common import (
    DEVICE,
    GIVEN,
    JSON_FLAG,
    MAPS,
    NAMES,
    NUMBER,
    OUTPUT,
    OVERWRITE,
    POSITIVE_COUNT,
    RULES,
    MapsOf,
    Settings,
    log_lines,
    print_json,
)
from jaxurban.cli.options import Values, command
from jaxurban.progress import LOG

if TYPE_CHECKING:
    from jaxurban.paths.rows import MapsFolder


OF_SEARCH = ("max_rounds", "seed", "budget_s")  # of `Fit`: the settings of the search


class Fit(TypedDict):
    """How weights are fitted; what is left out is as `compare_fits` and `FitSettings` have it.

    Attributes:
      scale: simplex (weights sum to 1) or distance (it has the weight 1), else what fits.
      bootstrap: number of fits for the intervals, else 200.
      hold_out: share of the routes to keep from the fits, to test them, else 0.25 from 16 routes on.
      by_city: true: also fit to each city alone, and to all cities but it.
      max_rounds: most rounds of searches, else 20.
      seed: of all noise, else 0.
      budget_s: seconds after which no further round begins.
    """

    scale: Literal["simplex", "distance"]
    bootstrap: int
    hold_out: float
    by_city: bool
    max_rounds: int
    seed: int
    budget_s: float


@command()
@click.argument("words", metavar="DIR [ROUTES]...", type=GIVEN, nargs=-1, required=True)
@OUTPUT
@click.option(
    "--sample",
    type=POSITIVE_COUNT,
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
    "--wish",
    "wishes",
    multiple=True,
    help="Target for an outcome, such as mean_gps>=0.8; repeatable.",
)
@NAMES(
    "--metrics",
    default=None,
    help="Metrics to fit, such as gps,risk; the others get weight 0.  [default: all of the maps]",
)
@NUMBER(
    "--altitude",
    "altitude_m",
    help="Altitude of every route, metres.  [default: the routes' altitude_m]",
)
@click.option(
    "--time-of-day",
    help="Time of day of the population map.  [default: the routes' own, else the first]",
)
@click.option(
    "--time", help="Time of the GPS map, UTC.  [default: the routes' own, else the first]"
)
@MAPS
@RULES
@click.option("--fit", type=Values(Fit), default="", help="How weights are fitted.")
@OVERWRITE
@DEVICE
@JSON_FLAG
def tune_command(
    words: tuple[Path, ...],
    output: Path,
    sample: int | None,
    pilot: str | None,
    planner: str | None,
    wishes: tuple[str, ...],
    maps_of: MapsOf,
    rules: Settings,
    fit: Settings,
    overwrite: bool,
    as_json: bool,
    **routes: Any,
) -> None:
    """Fit weights to demonstrated ROUTES, or to targets.

    ROUTES are over the maps in each DIR, and targets are for outcomes.

    ROUTES are files of lines (GeoJSON, KML, GPX), tables of instances (.csv, .parquet) or folders of a study; without
    any, the study that `jaxurban study` kept in DIR. Several DIRs, each with its ROUTES, are fitted together.
    """
    search = {name: fit.pop(name) for name in OF_SEARCH if name in fit}
    beside = fit.keys() - {"hold_out"}
    if wishes and beside:
        raise click.UsageError(
            f"--fit {', '.join(sorted(beside))} belongs to fits without --wish: leave it out"
        )

    from jaxurban.metrics.weights import Weights
    from jaxurban.report.tuning import TuneSettings, run_tuning
    from jaxurban.studies.route_pool import FitSettings

    # What decides the fit: ``routes`` holds all further options, which are of the routes, and gets the rules. A preset
    # that is not given is an empty text, and weights that the pilot does not name are 0.
    obstacles = rules.pop("obstacles")
    routes |= rules | {"preset": rules["preset"] or None}
    pilot_weights = None
    if pilot is not None:
        no_weights = Weights(**dict.fromkeys(Weights().to_dict(), 0.0))
        pilot_weights = Weights.parse(pilot, no_weights)
    settings = TuneSettings(
        routes=values_given(routes),
        sample=sample,
        pilot=pilot_weights,
        planner=planner,
        targets=wishes,
        fits=fit,
        fit=FitSettings(**search),
    )
    sources = _sources_of(
        words, partial(maps_of, obstacles=obstacles), has_routes=sample is not None
    )
    facts = run_tuning(sources, output, settings, overwrite=overwrite)

    # What is printed: the message, warnings that it does not hold, and the weights.
    log_lines(facts["decided"]["lines"])
    LOG.info(facts["message"])
    for warning in facts.get("warnings", []):
        if warning != facts["message"]:
            LOG.info(f"warning: {warning}")
    LOG.info(
        f"tune finished: read {output / 'report.md'}; the weights are in {output / 'weights.toml'}"
    )
    if as_json:
        print_json(facts)
    else:
        print(facts["weights_option"])


def _sources_of(
    words: tuple[Path, ...], maps_of: MapsOf, has_routes: bool
) -> "dict[MapsFolder, list[Path]]":
    """Return the files and studies of each folder of maps, in the order of the command line.

    A folder is a study's where it holds rows and no maps, or where it holds a study and the maps before it have no
    routes yet. A study that comes first lies beside its maps.

    Args:
      words: names of folders and files, as the user gives them.
      maps_of: returns the maps of a folder, not opened yet.
      has_routes: whether routes are drawn, so that none need be read.
    """
    from jaxurban.io.stored import ZARR_FOLDER
    from jaxurban.io.tables import ROWS_FILE
    from jaxurban.studies.study_demonstrations import study_in

    # ``routes`` is the list of the last folder of maps, and ``needs_routes`` says whether it has no study of its own.
    sources: dict[MapsFolder, list[Path]] = {}
    routes: list[Path] = []
    needs_routes = False
    for word in words:
        # A study beside or after its maps.
        is_study = (word / ROWS_FILE).is_file() and not (word / ZARR_FOLDER).exists()
        if needs_routes and not routes and study_in(word):
            is_study = True

        # The first word and every folder of maps begin a new list; all else joins the last one.
        if not sources or (word.is_dir() and not is_study):
            folder = word.parent if is_study else word
            routes = sources.setdefault(maps_of(folder), [])
            needs_routes = not has_routes and not study_in(folder)
        if is_study or not word.is_dir():
            routes.append(word)
    return sources
