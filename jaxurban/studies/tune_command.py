"""jaxurban tune."""

import shlex
from itertools import chain
from pathlib import Path
from typing import Any, TypedDict

import click

from jaxurban.checks import values_given
from jaxurban.progress import LOG
from jaxurban.terminal.common import (
    DEVICE,
    GIVEN,
    JSON_FLAG,
    NAMES,
    NUMBER,
    OUTPUT,
    OVERWRITE,
    POSITIVE_COUNT,
    RESOLUTION,
    RULES,
    Settings,
    again,
    finished_said,
    log_lines,
    print_json,
)
from jaxurban.terminal.options import Values, command

OF_SEARCH = ("max_rounds", "seed", "budget_s")  # of `Fit`: the settings of the search


class Fit(TypedDict):
    """How weights are fitted; what is left out is as `fit_weights` and `FitSettings` have it.

    Attributes:
      bootstrap: number of fits for the intervals, else 200.
      hold_out: share of the routes to keep from the fit, to test it, else 0.25 from 16 routes on.
      max_rounds: most rounds of searches, else 20.
      seed: of all noise, else 0.
      budget_s: seconds after which no further round begins.
    """

    bootstrap: int
    hold_out: float
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
    help="Weights such as gps=1,risk=2 that plan the routes of --sample and of tables; 0 if not named.",
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
@RESOLUTION
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
    wishes: tuple[str, ...],
    resolution_m: float | None,
    rules: Settings,
    fit: Settings,
    overwrite: bool,
    as_json: bool,
    **routes: Any,
) -> None:
    """Fit weights to demonstrated ROUTES, or to targets.

    ROUTES are over the maps in each DIR, and targets are for outcomes.

    ROUTES are files of lines (GeoJSON, KML, GPX) or tables of instances (.csv, .parquet), such as the
    study/instances.parquet of `jaxurban study`. Several DIRs, each with its ROUTES, are fitted together.
    """
    fits = [f"{name}={value}" for name, value in fit.items() if name != "hold_out"]
    search = {name: fit.pop(name) for name in OF_SEARCH if name in fit}
    beside = fit.keys() - {"hold_out"}
    if wishes and beside:
        raise click.UsageError(
            f"--fit {', '.join(sorted(beside))} belongs to fits without --wish: leave it out"
        )

    from jaxurban.io.tables import INSTANCES_FILE
    from jaxurban.metrics.weights import Weights
    from jaxurban.paths.rows import MapsFolder
    from jaxurban.studies.reports.tuning import TuneSettings, run_tuning
    from jaxurban.studies.route_pool import FitSettings
    from jaxurban.studies.tuning.tested import FitCommands

    # What decides the fit: ``routes`` holds all further options, which are of the routes, and gets the rules. A preset
    # that is not given is an empty text, and weights that the pilot does not name are 0.
    routes |= rules | {"preset": rules["preset"] or None}
    pilot_weights = None
    if pilot is not None:
        no_weights = Weights(**dict.fromkeys(Weights().to_dict(), 0.0))
        pilot_weights = Weights.parse(pilot, no_weights)

    # The files of each folder of maps; a folder begins a new list.
    files_of: dict[Path, list[Path]] = {}
    for word in words:
        if not files_of or word.is_dir():
            files = files_of.setdefault(word, [])
        else:
            files.append(word)

    # What fits again: these routes, of which more are held out, or routes that are drawn.
    tested = (
        f"{again('-o', '--fit')} --fit {','.join([*fits, 'hold_out={share}'])} -o {output}-tested"
    )
    more = ""
    if sample or wishes:
        own = map(str, chain(*files_of.values()))
        more = f"{again('-o', '--sample', *own)} --sample {{needed}} -o {output}-{{needed}}"
    wider = ""
    if len(files_of) == 1:
        maps, *files_on_maps = map(str, words)
        place = f"{maps}-wider"
        wider = (
            f'jaxurban maps {shlex.join([maps, "-o", place])} --set "region.bounds={{bounds}}" && '
        )
        if sample:  # the pairs that were drawn
            files_on_maps = [str(output / INSTANCES_FILE)]
        same = shlex.join([place, *files_on_maps])
        wider += f"{again('-o', '--sample', *map(str, words))} {same} -o {output}-wider"
    commands = FitCommands(tested, more, str(output), sample, wider)
    settings = TuneSettings(
        routes=values_given(routes),
        sample=sample,
        pilot=pilot_weights,
        targets=wishes,
        fits=fit,
        fit=FitSettings(**search),
        commands=commands,
    )
    sources = {MapsFolder(folder, resolution_m): files for folder, files in files_of.items()}
    facts = run_tuning(sources, output, settings, overwrite=overwrite)

    # What is printed: the message, warnings that it does not hold, and the weights.
    log_lines(facts["decided"]["lines"])
    LOG.info(facts["message"])
    for warning in facts.get("warnings", []):
        LOG.info(f"warning: {warning}")
    LOG.info(finished_said("tune", output))
    if as_json:
        print_json(facts)
    else:
        print(facts["weights_option"])
