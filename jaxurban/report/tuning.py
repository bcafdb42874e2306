"""Fitting weights from files, and writing what came of it: tables, pictures, report.md, and weights to paste."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, compress
from pathlib import Path
from typing import Any

import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.stored import ZARR_FOLDER
from jaxurban.io.tables import SUFFIXES, records_of
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights, check_held
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.rows import MapsFolder
from jaxurban.progress import reporting
from jaxurban.report.figures.tuning import plot_routes, plot_weights
from jaxurban.report.write import (
    REPORT_FILE,
    Markdown,
    Outputs,
    bullets,
    code,
    files_of,
    fill,
    first_lines,
    paragraphs,
    save,
)
from jaxurban.studies.demonstrations import (
    Demonstration,
    compared_demonstrations,
    optimal_demonstrations,
    read_demonstrations,
)
from jaxurban.studies.montecarlo.sampling import TIMES, sample_instances
from jaxurban.studies.queries import maps_of
from jaxurban.studies.route_pool import FitSettings
from jaxurban.studies.study_demonstrations import demonstrations_from_study, study_in
from jaxurban.studies.tuning.compared_fits import ALL, FitComparison, compare_fits
from jaxurban.studies.tuning.target import Target
from jaxurban.studies.tuning.target_fit import TargetFit, fit_targets
from jaxurban.studies.tuning.weight_fit import WeightFit

STATE_FILE = "fit-state.parquet"
TABLES = "learning_curve", "fits", "targets", "tested", "weights", "examples"
UNDER = "cost_model", "constraints", "preset"  # settings of routes


@dataclass(frozen=True)
class TuneSettings:
    """How weights are fitted.

    Attributes:
      routes: further arguments of `read_demonstrations` and `demonstrations_from_study`: altitude_m, cost_model,
        constraints, metrics and others.
      sample: how many instances are drawn on each city's maps, at every altitude, whose routes are planned under the
        pilot's weights; None: routes are read from files.
      pilot: weights under which the routes of sampled instances are planned, and those of studies and tables instead of
        under their own.
      planner: of the planners of a study, the one whose routes are taken.
      targets: bounds on outcomes, such as ``mean_gps>=0.8``, that weights are fitted to; empty: weights are fitted to
        the routes.
      fits: further arguments of `compare_fits`: hold_out, by_city, scale, bootstrap; left out, one fit to all.
      fit: settings of the search.
    """

    routes: Mapping[str, Any]
    sample: int | None
    pilot: Weights | None
    planner: str | None
    targets: tuple[str, ...]
    fits: Mapping[str, Any]
    fit: FitSettings


def run_tuning(
    sources: Mapping[MapsFolder, Sequence[Path]],
    folder: Path,
    settings: TuneSettings,
    *,
    overwrite: bool,
) -> dict[str, Any]:
    """Fit weights, write everything under ``folder``, and return the facts that ``--json`` prints.

    A run that was interrupted goes on where it stopped; one that had finished ends at the same weights again.

    Args:
      sources: of each folder of maps the files of routes that lie on them, tables of instances and folders of studies;
        none where instances are sampled or the folder holds its study. All of them are fitted together.
      folder: written to; made if it is not there.
      settings: of the fit.
      overwrite: forget the fit of other routes or settings that the folder holds.

    Raises:
      InputError: routes or maps that cannot be read or do not go together, a wrong setting, or a folder that holds
        another fit or other files, or cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"cannot write to the output folder {str(folder)!r}: it is a file")
    files_by_source = _checked_files(sources, settings)
    maps_of_sources = [source.open() for source in sources]
    targets = [Target.parse(text) for text in settings.targets]

    with reporting("tune") as report:
        # The demonstrations of each city; a folder of maps that stands several times is one city. It has the folder's
        # own name, with a number behind it where another folder before it has that name.
        report("routes")
        cities: dict[str, list[Demonstration]] = {}
        names: dict[Path, str] = {}
        for source, maps in zip(sources, maps_of_sources, strict=True):
            place = Path(source.folder).resolve()
            if place not in names:
                number = sum(other.name == place.name for other in names)
                names[place] = f"{place.name} {number + 1}" if number else place.name
            routes = _demonstrations(files_by_source[source], maps, settings)
            cities.setdefault(names[place], []).extend(routes)
        demonstrations = list(chain.from_iterable(cities.values()))

        # The output folder, with the files that a fit writes there. Those of another fit are recognised by the state
        # file, which holds the settings of its fit.
        pictures = [f"figures/{name}.png" for name in ("weights", *_pictures(demonstrations))]
        outputs = [*TABLES, *pictures, "weights.toml", REPORT_FILE]
        files_written = [STATE_FILE, *files_of(outputs)]
        with Workspace.open(folder, "tune", names=files_written, overwrite=overwrite):
            # The fit, to targets or to routes. Fits to routes leave those out that are held out from them.
            report("rounds")
            fit: WeightFit | TargetFit
            result = None
            settings_of_fit = replace(settings.fit, state_file=folder / STATE_FILE, progress=report)
            if targets:
                before = settings.pilot or Weights()
                queries = [each.query for each in demonstrations]
                fit = fit_targets(
                    queries, targets, before=before, **settings.fits, settings=settings_of_fit
                )
                demonstrations = optimal_demonstrations(queries, before)
                conclusion = fit.decided
            else:
                options = {"by_city": False, **settings.fits}
                result = compare_fits(cities, **options, settings=settings_of_fit)
                fit = result.fits[ALL]
                conclusion = result.decided
                demonstrations = list(compress(demonstrations, ~result.is_held_out))

            # The routes under the fitted weights, and all files. A single fit to all routes is compared with nothing.
            report("routes under the fitted weights")
            planned = optimal_demonstrations([each.query for each in demonstrations], fit.weights)

            report("figures and report")
            texts = {
                "targets": ", ".join(map(str, targets)),
                "sources": Markdown("; ".join(_origins(files_by_source, settings))),
                "lines": first_lines(conclusion.facts),
            }
            if result is not None and len(result.fits) == 1 and not result.is_held_out.any():
                result = None
            save(folder, outputs_of(fit, demonstrations, planned, texts, result))
    facts = _facts(fit, folder) | {"decided": conclusion.to_dict()}
    return facts if result is None else facts | {"fits": records_of(result.table)}


def _checked_files(
    sources: Mapping[MapsFolder, Sequence[Path]], settings: TuneSettings
) -> dict[MapsFolder, Sequence[Path]]:
    """Return the files of routes on each folder of maps, when pilot and planner suit them.

    Args:
      sources: the files that the user named; a folder of maps without any may hold a study (`_files_of`).
      settings: of the fit.

    Raises:
      InputError: a pilot who prefers nothing, a folder of maps without routes, or a pilot or planner where all files
        hold lines, which are the routes already.
    """
    if settings.pilot is not None and not any(settings.pilot.to_dict().values()):
        raise InputError(
            "every weight of the pilot is 0, so that all routes cost the same: give one above 0 (--pilot)"
        )
    files_by_source = {
        source: _files_of(source, files, settings.sample) for source, files in sources.items()
    }
    files = list(chain.from_iterable(files_by_source.values()))
    if (settings.pilot or settings.planner) and files and all(map(_holds_lines, files)):
        raise InputError(
            "a pilot and a planner are of sampled instances, studies and tables, and the files hold lines: leave "
            "--pilot and --planner out"
        )
    return files_by_source


def _origins(sources: Mapping[MapsFolder, Sequence[Path]], settings: TuneSettings) -> Iterator[str]:
    """Return for each folder of maps what the report says of its routes: their files, or how they were sampled."""
    for source, files in sources.items():
        routes = f"{settings.sample} instances sampled with seed {settings.fit.seed}"
        if files:
            routes = ", ".join(map(str, files))
        yield f"{code(routes)} over the maps in {code(source.folder)}"


def _demonstrations(
    files: Sequence[Path], maps: MetricMaps, settings: TuneSettings
) -> list[Demonstration]:
    """Return the routes on the maps of one folder: those of its files, or the pilot's between sampled places.

    Args:
      files: of the routes; none where instances are sampled.
      maps: of the folder.
      settings: of the fit.

    Raises:
      InputError: files although instances are sampled, or no pilot who flies these.
    """
    if settings.pilot is not None:  # the weights that its text does not name are 0
        check_held(settings.pilot.to_dict(), maps.metrics)
    if settings.sample is None:
        return [each for file in files for each in _read(file, maps, settings)]
    if files:
        raise InputError(
            f"{str(files[0])!r} holds routes, and others are to be sampled: choose one of both"
        )
    if settings.pilot is None and not settings.targets:
        raise InputError(
            "sampled instances have no routes of their own: name the weights of the pilot who flies them"
        )

    # Draw instances at one altitude, or at all of the maps', and take those that some path joins.
    options = settings.routes
    altitude_m = options.get("altitude_m")
    under = {name: options[name] for name in UNDER if name in options}
    pilot = settings.pilot or Weights()
    instances = sample_instances(
        maps,
        settings.sample,
        altitudes_m=None if altitude_m is None else (altitude_m,),
        weights=[pilot],
        seed=settings.fit.seed,
        **under,
    )
    times = {name: options[name] for name in TIMES if options.get(name) is not None}
    return demonstrations_from_study(
        instances[instances.is_connected].assign(**times),
        maps,
        planner=settings.planner,
        pilot=pilot,
        **options,
    )


def _files_of(source: MapsFolder, files: Sequence[Path], sample: int | None) -> Sequence[Path]:
    """Return the files and folders of routes on the maps of a folder: without any, the study that it holds.

    Args:
      source: the folder of maps.
      files: that the user named.
      sample: number of instances that are sampled, so that no routes are needed and ``files`` comes back; None: routes
        are needed.

    Raises:
      InputError: there is neither a file nor a study, or the folder holds a study and no maps.
    """
    if files or sample is not None:
        return files
    folder = Path(source.folder)
    study = study_in(folder)
    if study is None:
        raise InputError(
            f"there are no routes for the maps in {str(source.folder)!r}: name files of routes or a study after it, or "
            "sample instances (--sample)"
        )
    if not (folder / ZARR_FOLDER).exists():
        raise InputError(
            f"{str(folder)!r} holds a study and no maps: name the folder of its maps before it"
        )
    return [study]


def _holds_lines(file: Path) -> bool:
    """Return whether a file holds lines, and is no table of instances and no folder of a study."""
    return not file.is_dir() and file.suffix.lower() not in SUFFIXES


def _read(file: Path, maps: MetricMaps, settings: TuneSettings) -> list[Demonstration]:
    """Return the routes of a file of lines, a table of instances or the folder of a study, as demonstrations.

    A fit to targets needs only the routes' ends: without a pilot its routes are planned under the default weights.

    Args:
      file: a file of lines or a table, or the folder of a study.
      maps: that the routes lie on.
      settings: of the fit, with the pilot, the planner and further arguments for the readers.

    Raises:
      InputError: routes that cannot be read, or that are of no use on these maps.
    """
    if _holds_lines(file):
        return read_demonstrations(file, maps, **settings.routes)
    pilot = settings.pilot
    planner = settings.planner
    if settings.targets and pilot is None:
        pilot = Weights()
        planner = None
    return demonstrations_from_study(file, maps, planner=planner, pilot=pilot, **settings.routes)


def outputs_of(
    fit: WeightFit | TargetFit,
    demonstrations: Sequence[Demonstration],
    planned: Sequence[Demonstration],
    texts: Mapping[str, str],
    result: FitComparison | None = None,
) -> Outputs:
    """Return what a fit writes, by file name: tables, pictures, the report and weights.toml.

    Args:
      fit: the fit of the weights, to routes or to targets.
      demonstrations: ``N`` routes, at least one: those that were fitted, or the routes without the wish.
      planned: ``N`` routes between the same ends under the fitted weights.
      texts: for the report: its first ``lines``, ``sources`` of the routes, and ``targets``.
      result: further fits, which the fit is compared with, and routes that were held out; None: there are none.
    """
    # The maps by the names of their pictures, the weights [K], a table of the routes, and fields of the report.
    pictures = _pictures(demonstrations)
    first = next(iter(pictures.values()))
    vector = fit.weights.vector(fit.names)
    fields = dict[str, Any](texts)
    routes = compared_demonstrations(demonstrations, planned)
    tables = {}
    outputs: Outputs = {"learning_curve": fit.curve}

    # What depends on the kind of the fit: the template of its report, its table of weights, and further tables.
    if isinstance(fit, WeightFit):
        template = "imitation"
        noun = "demonstration"
        weights = fit.table.reset_index()
        routes = routes.assign(regret=fit.regret, trust=fit.trust)
        outputs["figures/weights.png"] = lambda: plot_weights(fit)
        fields |= {"fits": "", "cautions": bullets(fit.cautions)}
        if result is not None:
            outputs["fits"] = result.table
            fields["fits"] = fits_section(result)
    else:
        template = "targets"
        noun = "usual route"
        weights = pd.DataFrame({"name": fit.names, "weight": vector})
        alone = fit.alone[["reached", "missed_by", "is_met"]].add_suffix("_alone")
        tables["outcomes"] = outputs["targets"] = fit.outcomes.join(alone).reset_index()
        tables["tested"] = outputs["tested"] = fit.tested
        num_tested = int(fit.is_held_out.sum())
        fields |= {"tested": num_tested or len(demonstrations), "seen": "none"}
        if not num_tested:
            fields["seen"] = "all"

    # What every fit has: tables of its weights and of its routes, and a picture of the routes on each map.
    model = first.cost_model
    unit = f"per {model.reference_length_m:g} m flown"
    if model.kind == "cell":
        unit = "per cell entered"
    units = {"distance": "per metre"} | dict.fromkeys(first.names, unit)
    weights = weights.assign(unit=weights["name"].map(units))
    outputs |= {"weights": weights, "examples": routes}
    for name, cost_map in pictures.items():
        outputs[f"figures/{name}.png"] = partial(
            plot_routes, demonstrations, planned, cost_map, vector, noun
        )

    # The report.
    setting = _setting([*pictures.values()])
    tables |= {"weights": weights, "setting": setting, "means": _means(routes)}
    report = fill(
        template,
        tables,
        credits=[cost_map.maps.attribution for cost_map in pictures.values()],
        fit=fit,
        num=len(routes),
        overlap=routes["overlap"].mean(),
        pictures=paragraphs(*(Markdown(f"![Routes](figures/{name}.png)") for name in pictures)),
        use=fill(
            "use_weights", unit=first, option=weights_option(fit.weights), where=_where(first)
        ),
        **fields,
    )
    return outputs | {"weights.toml": weights_toml(fit, first), REPORT_FILE: report}


def fits_section(result: FitComparison) -> str:
    """Return the section of a report on several fits, as Markdown; its table leaves out the weights (``w_``)."""
    return fill(
        "fits",
        {"fits": result.table.filter(regex="^(?!w_)")},
        num=len(result.is_bad),
        num_held_out=result.is_held_out.sum(),
        num_bad=result.is_bad.sum(),
    )


def _pictures(demonstrations: Sequence[Demonstration]) -> dict[str, CostMap]:
    """Return the maps of some routes, each once, by the name of the picture in which their routes are drawn."""
    cost_maps = maps_of(each.query for each in demonstrations)
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


def _facts(fit: WeightFit | TargetFit, folder: Path) -> dict[str, Any]:
    """Return what ``--json`` says of a fit to routes or to targets, by name."""
    facts = {
        "folder": str(folder),
        "message": fit.sentence,
        "weights": fit.weights.to_dict(),
        "weights_option": weights_option(fit.weights),
        "num_plans": fit.num_plans,
        "elapsed_s": fit.elapsed_s,
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
        "conflicts": [list(pair) for pair in fit.conflicts],
    }


def weights_option(weights: Weights) -> str:
    """Return weights as ``--weights`` takes them."""
    return ",".join(f"{name}={value:.6g}" for name, value in weights.to_dict().items())


def weights_toml(fit: WeightFit | TargetFit, cost_map: CostMap) -> str:
    """Return a [weights] table for a scenario, with how to use it as comments."""
    lines = [
        f"# {fit.sentence}",
        "# Weights fitted by `jaxurban tune`; report.md says how sure they are. Paste the table into a scenario.",
        f"# They belong to the cost model {cost_map.cost_model.kind!r} {_where(cost_map)}: plan with",
        f"#   --rules cost_model={cost_map.cost_model.kind} --weights {weights_option(fit.weights)}",
        "[weights]",
        *(f"{name} = {value:.6g}" for name, value in fit.weights.to_dict().items()),
    ]
    return "\n".join(lines) + "\n"


def _where(cost_map: CostMap) -> str:
    """Return the end of a sentence on weights: on which cells, or with which reference length, they apply."""
    if cost_map.cost_model.kind == "cell":
        side = f"{cost_map.grid.resolution_m:g} m"
        return f"on cells of {side} (a step costs by the cell, so other sizes need other ones)"
    return f"with a reference length of {cost_map.cost_model.reference_length_m:g} m"
