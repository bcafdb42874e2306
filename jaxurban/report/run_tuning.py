"""Fitting weights from files, and writing what came of it: tables, pictures, a report, and weights to paste."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.folders import own_folder
from jaxurban.maps.metric_maps import Obstacles, open_maps
from jaxurban.progress import Progress, reporting
from jaxurban.report.figures.tuning import plot_learning, plot_regret, plot_routes, plot_targets, plot_weights
from jaxurban.report.save import Output, save
from jaxurban.report.tuning import (
    FitSource,
    imitation_report,
    targets_report,
    weight_units,
    weights_option,
    weights_toml,
)
from jaxurban.studies.compare import Comparison, compare
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import maps_of
from jaxurban.studies.read_demonstrations import read_demonstrations
from jaxurban.studies.tuning.fit_settings import FitSettings
from jaxurban.studies.tuning.target_fit import TargetFit, fit_targets
from jaxurban.studies.tuning.targets import Target
from jaxurban.studies.tuning.weight_fit import WeightFit, fit_weights

STATE_FILE = "fit-state.npz"


class RoutesOnMaps(NamedTuple):
    """The folder of maps, and a file of routes that lie on them."""

    maps: Path
    routes: Path


@dataclass(frozen=True)
class TuneSettings:
    """How weights are fitted.

    Attributes:
      resolution_m: of the maps; needed where a folder holds several.
      obstacles: where routes may fly (see `jaxurban.maps.metric_maps.MetricMaps`).
      routes: further arguments of `read_demonstrations`: altitude_m, cost_model, constraints, metrics ...
      targets: fit to these, such as ``mean_gps>=0.8``, instead of to the routes.
      weights: further arguments of `fit_weights`: scale, bootstrap.
      fit: of the search.
    """

    resolution_m: float | None = None
    obstacles: Obstacles = "touched"
    routes: Mapping[str, Any] = field(default_factory=dict)
    targets: tuple[str, ...] = ()
    weights: Mapping[str, Any] = field(default_factory=dict)
    fit: FitSettings = field(default_factory=FitSettings)


def run_tuning(
    sources: Sequence[RoutesOnMaps],
    folder: Path,
    settings: TuneSettings,
    *,
    overwrite: bool = False,
    command: str = "jaxurban.report.run_tuning.run_tuning",
    progress: Progress = True,
) -> dict[str, Any]:
    """Fit weights, write everything under ``folder``, and return the facts that ``--json`` prints.

    A run that was interrupted goes on where it stopped; one that had finished ends at the same weights again.

    Args:
      sources: routes and maps; all of them are fitted together.
      folder: written to; made if it is not there.
      settings: of the fit.
      overwrite: forget the fit of other routes or settings that the folder holds.
      command: for the report.
      progress: as in `jaxurban.progress.reporting`.

    Raises:
      InputError: routes or maps that cannot be read or do not go together, a wrong setting, or a folder that holds
        another fit or other files, or cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"cannot write to the output folder {str(folder)!r}: it is a file")
    opened = [open_maps(source.maps, settings.resolution_m, obstacles=settings.obstacles) for source in sources]
    targets = [Target.parse(text, opened[0].metrics) for text in settings.targets]
    with reporting("tune", progress) as report:
        report("routes")
        demonstrations: list[Demonstration] = []
        for source, maps in zip(sources, opened, strict=True):
            demonstrations += read_demonstrations(source.routes, maps, **settings.routes)
        how = replace(settings.fit, state_file=folder / STATE_FILE, progress=report)
        fit: WeightFit | TargetFit
        # Other fits differ in the state of the fit, which holds its settings.
        with own_folder(folder, "tune", {}, overwrite=overwrite):
            report("rounds")
            if targets:
                fit = fit_targets([each.query for each in demonstrations], targets, settings=how)
            else:
                fit = fit_weights(demonstrations, **settings.weights, settings=how)
            report("routes under the fitted weights")
            comparison = compare(demonstrations, fit.weights)
            report("figures and report")
            files = [(str(source.routes), str(source.maps)) for source in sources]
            save(folder, outputs_of(fit, comparison, files, command, targets))
    return _facts(fit, folder)


def outputs_of(
    fit: WeightFit | TargetFit,
    comparison: Comparison,
    files: Sequence[tuple[str, str]],
    command: str,
    targets: Sequence[Target] = (),
) -> dict[str, Output]:
    """Return what a fit writes, by file name: tables, pictures, the report and weights.toml.

    Args:
      fit: of the weights.
      comparison: of the demonstrations with the routes under those weights.
      files: of routes, and the folders of their maps.
      command: that made the fit.
      targets: that the weights were fitted to.
    """
    maps = maps_of(each.query for each in comparison.demonstrations)
    unit = weight_units(maps[0])
    units = [unit[name] for name in fit.names]
    vector = fit.weights.vector(fit.names)
    routes = comparison.table
    pictures = {f"routes_{number}": one for number, one in enumerate(maps, start=1)}
    source = FitSource(tuple(files), command, tuple(pictures))
    outputs: dict[str, Output] = {
        "learning_curve": fit.curve,
        "figures/weights.png": lambda: plot_weights(fit, units),
        "figures/learning_curve.png": lambda: plot_learning(fit),
    }
    if isinstance(fit, WeightFit):
        weights = fit.table().reset_index()
        routes = routes.assign(regret=fit.regret, trust=fit.trust)
        outputs["fewer_examples"] = fit.by_demonstrations
        outputs["figures/regret.png"] = lambda: plot_regret(fit, [*routes["name"]])
        report = imitation_report(fit, comparison, source)
    else:
        weights = pd.DataFrame({"name": fit.names, "weight": vector})
        alone = fit.alone[["reached", "missed_by", "is_met"]].add_suffix("_alone")
        outputs["targets"] = fit.outcomes.join(alone).reset_index()
        outputs["figures/targets.png"] = lambda: plot_targets(fit)
        report = targets_report(fit, comparison, targets, source)
    for name, one in pictures.items():
        outputs[f"figures/{name}.png"] = partial(plot_routes, comparison, one, vector)
    outputs |= {"weights": weights.assign(unit=units), "examples": routes}
    return outputs | {"weights.toml": weights_toml(fit, maps[0]), "report.md": report}


def _facts(fit: WeightFit | TargetFit, folder: Path) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "folder": str(folder),
        "weights": fit.weights.to_dict(),
        "weights_option": weights_option(fit.weights),
        "num_plans": fit.num_plans,
        "elapsed_s": fit.elapsed_s,
    }
    if isinstance(fit, WeightFit):
        low, high = (dict(zip(fit.names, ends.tolist(), strict=True)) for ends in fit.interval)
        has_interval = all(value == value for value in low.values())
        return facts | {
            "interval": {name: [low[name], high[name]] for name in fit.names} if has_interval else None,
            "mean_regret": float(fit.regret.mean()),
            "best_mean_regret": fit.best_mean_regret,
            "is_settled": fit.is_settled,
            "unidentified": list(fit.unidentified),
            "warnings": list(fit.warnings),
        }
    return facts | {
        "is_met": fit.is_met,
        "message": fit.sentence,
        "outcomes": fit.outcomes.reset_index().to_dict("records"),
        "conflicts": [list(pair) for pair in fit.conflicts],
    }
