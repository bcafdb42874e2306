"""Fitting weights from files, and writing what came of it: tables, pictures, report.md, and weights to paste."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd

from jaxurban.draw.write import (
    Figures,
    Markdown,
    Outputs,
    ResultReport,
    bullets,
    code,
    files_of,
    fill,
    joined_with_and,
    paragraphs,
    save,
)
from jaxurban.errors import InputError
from jaxurban.io.stored import REPORT_FILE
from jaxurban.io.tables import INSTANCES_FILE, SUFFIXES, fingerprint, write_table
from jaxurban.io.workspace import Workspace
from jaxurban.knowledge import names_of
from jaxurban.metrics.base import ones_said
from jaxurban.metrics.weights import Weights, check_held
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.rows import MapsFolder
from jaxurban.progress import reporting
from jaxurban.statistics.conclusions import VERDICTS
from jaxurban.studies.demonstrations import (
    Demonstration,
    compared_demonstrations,
    optimal_demonstrations,
)
from jaxurban.studies.figures.tuning import plot_fitted_routes, plot_weights
from jaxurban.studies.montecarlo.sampling import sample_instances
from jaxurban.studies.queries import command_to_plan, maps_of, weights_option
from jaxurban.studies.route_pool import FitSettings
from jaxurban.studies.study_demonstrations import demonstrations
from jaxurban.studies.tuning.target import Target
from jaxurban.studies.tuning.target_fit import TargetFit, fit_targets
from jaxurban.studies.tuning.tested import FitCommands
from jaxurban.studies.tuning.weight_fit import WeightFit, fit_weights

TABLES = ("learning_curve", "weights", "examples", "targets", "tested")
UNDER = "cost_model", "constraints", "preset"  # settings of routes
AT = {"altitude_m": "--altitude", "time": "--time", "time_of_day": "--time-of-day"}
ROUNDING = 1e-6  # of weights that sum to 1


@dataclass(frozen=True)
class TuneSettings:
    """How weights are fitted.

    Attributes:
      routes: further arguments of `demonstrations`: altitude_m, cost_model, constraints, metrics and others.
      sample: how many instances are drawn on each city's maps, at every altitude, whose routes are planned under the
        pilot's weights; None: routes are read from files.
      pilot: weights under which the routes of sampled instances are planned, and those of tables instead of under
        their own.
      targets: bounds on outcomes, such as ``mean_gps>=0.8``, that weights are fitted to; empty: weights are fitted to
        the routes.
      fits: further arguments of `fit_weights` or `fit_targets`: hold_out, bootstrap.
      fit: settings of the search.
      commands: what fits again.
    """

    routes: Mapping[str, Any]
    sample: int | None
    pilot: Weights | None
    targets: tuple[str, ...]
    fits: Mapping[str, Any]
    fit: FitSettings
    commands: FitCommands


def run_tuning(
    sources: Mapping[MapsFolder, Sequence[Path]],
    folder: Path,
    settings: TuneSettings,
    *,
    overwrite: bool,
) -> dict[str, Any]:
    """Fit weights, write everything under ``folder``, and return the facts that ``--json`` prints.

    Args:
      sources: of each folder of maps the files of lines and tables of instances that lie on them; none where instances
        are sampled. All of them are fitted together.
      folder: written to; made if it is not there.
      settings: of the fit.
      overwrite: forget the fit of other routes or settings that the folder holds.

    Raises:
      InputError: routes or maps that cannot be read or do not go together, a wrong setting, or a folder that holds
        another fit or other files, or cannot be written to.
    """
    if settings.pilot is not None and not any(settings.pilot.to_dict().values()):
        raise InputError(
            "every weight of the pilot is 0, so that all routes cost the same: give one above 0 (--pilot)"
        )
    targets = [Target.parse(text) for text in settings.targets]

    with reporting("tune") as report:
        report("routes")
        drawn: list[pd.DataFrame] = []
        of_cities = [
            _routes_on(source, files, settings, drawn) for source, files in sources.items()
        ]
        routes = list(chain.from_iterable(of_cities))

        # The output folder, what identifies the fit there, and the files that it may write.
        key = {
            "routes": fingerprint(*(each.features for each in routes)),
            "maps": [cost_map.maps.identity for cost_map in maps_of(each.query for each in routes)],
            "targets": list(settings.targets),
            "fit": dict(settings.fits),
            "max_rounds": settings.fit.max_rounds,
            "seed": settings.fit.seed,
            "pilot": settings.pilot and settings.pilot.to_dict(),
        }
        pictures = [f"figures/{name}.png" for name in ("weights", *_pictures(routes))]
        names = [INSTANCES_FILE, *files_of([*TABLES, VERDICTS, *pictures, REPORT_FILE])]
        with Workspace.open(folder, "tune", key, names=names, overwrite=overwrite):
            # The fit, to targets or to routes. Fits to routes leave those out that are held out from them.
            report("rounds")
            fit: WeightFit | TargetFit
            options = {"hold_out": None, **settings.fits}
            settings_of_fit = replace(settings.fit, progress=report)
            if targets:
                queries = [each.query for each in routes]
                options["before"] = settings.pilot
                fit = fit_targets(queries, targets, **options, settings=settings_of_fit)
            else:
                fit = fit_weights(routes, **options, settings=settings_of_fit)

            # All files, with the routes under the fitted weights.
            report("figures and report")
            nums = map(len, of_cities)
            origins = [
                _origin(source, files, settings, num)
                for (source, files), num in zip(sources.items(), nums, strict=True)
            ]
            commands = settings.commands
            if settings.sample is None:  # others that are drawn answer the same question
                same = _shared_options(routes, settings)
                commands = commands._replace(
                    more=commands.more.replace("--sample", f"{same}--sample")
                )
            fit = replace(fit, commands=commands, origin=Markdown("; ".join(origins)))
            if len(drawn) == 1:  # of one city, which a further fit takes again
                write_table(drawn[0], folder / INSTANCES_FILE)
            save(folder, fit_report(fit).outputs)
    return _facts(fit, folder)


def _shared_options(routes: Sequence[Demonstration], settings: TuneSettings) -> str:
    """Return the options of the altitude and the times that all routes share, with a space behind each.

    Args:
      routes: of the fit.
      settings: of the fit; what it names is in the command already.
    """
    cost_maps = maps_of(each.query for each in routes)
    options = ""
    for name, option in AT.items():
        shared = {getattr(each, name) for each in cost_maps} - {None}
        if len(shared) == 1 and name not in settings.routes:
            options += f"{option} {shared.pop()} "
    return options


def _origin(source: MapsFolder, files: Sequence[Path], settings: TuneSettings, num: int) -> str:
    """Return what the report says of the routes on the maps of a folder: their files, or how they were sampled.

    Args:
      source: the folder.
      files: of the routes; none where instances are sampled.
      settings: of the fit.
      num: of the routes that are of use.
    """
    routes = f"{settings.sample} instances sampled with seed {settings.fit.seed}"
    joined = ""
    if files:
        routes = ", ".join(map(str, files))
    else:
        joined = f", of which a path joins the ends of {num} routes,"
    return f"{code(routes)}{joined} over the maps in {code(source.folder)}"


def _routes_on(
    source: MapsFolder, files: Sequence[Path], settings: TuneSettings, drawn: list[pd.DataFrame]
) -> list[Demonstration]:
    """Return the routes on the maps of one folder: those of its files, or the pilot's between sampled places.

    A fit to targets needs only the routes' ends: without a pilot its routes are planned under the default weights.

    Args:
      source: the folder.
      files: of the routes; none where instances are sampled.
      settings: of the fit.
      drawn: gets the instances, where these are drawn.

    Raises:
      InputError: routes that are of no use on these maps, files beside sampled instances, or no pilot who flies these.
    """
    maps = source.open()
    pilot = settings.pilot
    if pilot is not None:  # the weights that its text does not name are 0
        check_held(pilot.to_dict(), maps.metrics)
    elif settings.targets:
        pilot = Weights()
    if settings.sample is None:
        routes: list[Demonstration] = []
        for file in files:
            is_table = file.suffix.lower() in SUFFIXES
            flown_by = pilot if is_table else settings.pilot
            routes += demonstrations(file, maps, pilot=flown_by, **settings.routes)
        return routes
    if files:
        raise InputError(
            f"{str(files[0])!r} holds routes, and others are to be sampled: choose one of both"
        )
    if pilot is None:
        raise InputError(
            "sampled instances have no routes of their own: name the weights of the pilot who flies them"
        )

    # Draw instances at one altitude, or at all of the maps', and take those that some path joins.
    options = settings.routes
    altitude_m = options.get("altitude_m")
    under = {name: options[name] for name in UNDER if name in options}
    instances = sample_instances(
        maps,
        settings.sample,
        altitudes_m=None if altitude_m is None else (altitude_m,),
        weights=[pilot],
        seed=settings.fit.seed,
        **under,
    )
    joined = instances[instances.is_connected]
    drawn.append(joined)
    return demonstrations(joined, maps, pilot=pilot, **options)


def fit_report(fit: WeightFit | TargetFit) -> ResultReport:
    """Return what a fit writes."""
    # The maps by the names of their pictures, the weights [K], and a table of the routes.
    pictures = _pictures(fit.routes)
    num = len(fit.routes)
    vector = fit.weights.vector(fit.names)
    num_held_out = int(fit.is_held_out.sum())
    fitted = routes = compared_demonstrations(fit.routes, fit.planned)
    tables = {}
    fields: dict[str, Any] = {}
    figures: Figures = {}
    others: Outputs = {"learning_curve": fit.curve}

    # What depends on the kind of the fit: the template of its report, its table of weights, and further tables.
    if isinstance(fit, WeightFit):
        template = "studies/templates/imitation"
        noun = "demonstration"
        planned = optimal_demonstrations([each.query for each in fit.others], fit.weights)
        unseen = compared_demonstrations(fit.others, planned)
        unseen = unseen.assign(is_held_out=True, regret=fit.others_regret, trust=fit.others_trust)
        fitted = fitted.assign(is_held_out=False, regret=fit.regret, trust=fit.trust)
        routes = pd.concat([fitted, unseen], ignore_index=True)
        figures["weights"] = partial(plot_weights, fit)
        fields["cautions"] = bullets(fit.cautions)
        fields["contains"] = _contains(fit.table)
        held_out = fill("studies/templates/held_out", num=num_held_out, fit=fit)
        fields["held_out"] = held_out if num_held_out else ""
    else:
        template = "studies/templates/targets"
        noun = "usual route"
        routes = routes.assign(is_held_out=fit.is_held_out)
        tables["outcomes"] = others["targets"] = fit.outcomes.reset_index()
        tables["tested"] = others["tested"] = fit.tested
        fields["tested"] = num_held_out or num
        num -= num_held_out
        fields["targets"] = ", ".join(map(str, fit.targets))
        fields["seen"] = "none" if num_held_out else "all"

    # What every fit has: tables of its weights and of its routes, and a picture of the routes on each map.
    weights = fit.table.reset_index()
    others |= {"weights": weights, "examples": routes}
    for name, cost_map in pictures.items():
        figures[name] = partial(plot_fitted_routes, fit.routes, fit.planned, cost_map, vector, noun)
    setting = _setting([*pictures.values()])
    fields |= {
        "tables": tables | {"weights": weights, "setting": setting, "means": _means(fitted)},
        "legend": ones_said(fit.queries[0].cost_map.maps.metrics),
        "credits": [cost_map.maps.attribution for cost_map in pictures.values()],
        "guessed": [names_of(cost_map.maps.guesses) for cost_map in pictures.values()],
        "fit": fit,
        "num": num,
        "num_held_out": num_held_out,
        "overlap": fitted["overlap"].mean(),
        "pictures": paragraphs(*(Markdown(f"![Routes](figures/{name}.png)") for name in pictures)),
        "command": command_to_plan(fit.queries[0], fit.weights),
        "pilots": Markdown(" or ".join(map(code, fit.pilots)) or "not on record"),
    }
    key = {"weights": fit.weights.to_dict(), "routes": str(fit.origin), "pilots": list(fit.pilots)}
    return ResultReport(
        template, fields, figures=figures, others=others, key=key, decided=fit.decided
    )


def _pictures(demonstrated: Sequence[Demonstration]) -> dict[str, CostMap]:
    """Return the maps of some routes, each once, by the name of the picture in which their routes are drawn."""
    cost_maps = maps_of(each.query for each in demonstrated)
    return {f"routes_{number}": each for number, each in enumerate(cost_maps, start=1)}


def _setting(maps: Sequence[CostMap]) -> pd.DataFrame:
    """Return a table of what routes were planned under: a row per map of the cost."""
    rows = [
        {
            "altitude (m)": cost_map.altitude_m,
            "time of day": cost_map.time_of_day or "",
            "time": cost_map.time or "",
            "cells (m)": cost_map.grid.resolution_m,
            "cost model": str(cost_map.cost_model),
            "constraints": str(cost_map.constraints) or "none",
            "obstacles": cost_map.maps.obstacles,
        }
        for cost_map in maps
    ]
    return pd.DataFrame(rows)


def _means(routes: pd.DataFrame) -> pd.DataFrame:
    """Return the means over routes of their length and each metric, as demonstrated and under the weights."""
    planned = routes.filter(regex="^planned_").mean()
    planned.index = planned.index.str.removeprefix("planned_")
    means = pd.DataFrame({"demonstrated": routes[planned.index].mean(), "planned": planned})
    return means.rename_axis("mean over routes").reset_index()


def _contains(table: pd.DataFrame) -> str:
    """Return which intervals of weights contain the weights of the pilot; empty where either is not known."""
    known = table.dropna(subset=["pilot", "low"])
    if known.empty:
        return ""
    is_outside = (known.pilot < known.low - ROUNDING) | (known.pilot > known.high + ROUNDING)
    outside = known.index[is_outside].tolist()
    if not outside:
        return "The interval of each weight contains the pilot's (column *pilot*, scaled to sum 1)."
    return (
        f"The pilot's weight of {joined_with_and(outside)} lies outside its interval, the others within theirs "
        "(column *pilot*, scaled to sum 1)."
    )


def _facts(fit: WeightFit | TargetFit, folder: Path) -> dict[str, Any]:
    """Return what ``--json`` says of a fit to routes or to targets, by name."""
    facts = {
        "folder": str(folder),
        "message": fit.sentence,
        "weights": fit.weights.to_dict(),
        "weights_option": weights_option(fit.weights),
        "pilots": list(fit.pilots),
        "num_plans": fit.num_plans,
        "elapsed_s": fit.elapsed_s,
        "decided": fit.decided.to_dict(),
    }
    if isinstance(fit, WeightFit):
        return facts | {
            "mean_regret": float(fit.regret.mean()),
            "best_mean_regret": fit.best_mean_regret,
            "is_settled": fit.is_settled,
            "warnings": list(fit.warnings),
        }
    return facts | {
        "is_met": fit.is_met,
        "outcomes": fit.outcomes.reset_index().to_dict("records"),
    }
