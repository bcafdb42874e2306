"""Fitting weights from files, and writing what came of it: tables, pictures, a report, and weights to paste."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from jaxurban.errors import InputError
from jaxurban.io.store import whole_file
from jaxurban.maps import Obstacles, open_maps
from jaxurban.plotting.files import write_png
from jaxurban.plotting.tuning import plot_learning, plot_regret, plot_routes, plot_targets, plot_weights
from jaxurban.studies.compare import Comparison, compare
from jaxurban.studies.examples import Example
from jaxurban.studies.imitation import WeightFit, fit_weights
from jaxurban.studies.reading import read_examples
from jaxurban.studies.targets import TargetFit, fit_targets
from jaxurban.studies.wishes import Wish
from jaxurban.tuning_report import (
    Asked,
    imitation_report,
    targets_report,
    weight_units,
    weights_option,
    weights_toml,
)

STATE_FILE, FIGURES = "fit-state.npz", "figures"
OnRound = Callable[[pd.DataFrame], None]


@dataclass(frozen=True)
class Source:
    """A file of routes and the folder of the maps that they lie on."""

    maps: Path
    routes: Path


@dataclass(frozen=True)
class TuneSettings:
    """How weights are fitted.

    Attributes:
      resolution_m: of the maps; needed where a folder holds several.
      obstacles: where routes may fly (see `jaxurban.maps.MetricMaps`).
      altitude_m, time, time_of_day: of every route; left out, the routes' own.
      maps: further settings of `read_examples`: metrics, cost_model, limits ...
      wishes: fit to these, instead of to the routes.
      fit: further settings of `fit_weights` or `fit_targets`.
    """

    resolution_m: float | None = None
    obstacles: Obstacles = "touched"
    altitude_m: float | None = None
    time: str | None = None
    time_of_day: str | None = None
    maps: Mapping[str, Any] = field(default_factory=dict)
    wishes: tuple[Wish, ...] = ()
    fit: Mapping[str, Any] = field(default_factory=dict)


def run_tuning(
    sources: Sequence[Source],
    folder: Path,
    settings: TuneSettings,
    *,
    overwrite: bool = False,
    command: str = "jaxurban.tuning.run_tuning",
    on_round: OnRound | None = None,
    on_stage: Callable[[str], None] = lambda name: None,
) -> dict[str, Any]:
    """Fit weights, write everything under ``folder``, and return the facts that ``--json`` prints.

    A run that was interrupted goes on where it stopped; one that had finished ends at the same weights again.

    Args:
      sources: routes and maps; all of them are fitted together.
      folder: written to; made if it is not there.
      settings: of the fit.
      overwrite: forget the fit of other routes or settings that the folder holds.
      command: for the report.
      on_round: is told the learning curve after every round.
      on_stage: is told what happens.

    Raises:
      InputError: routes or maps that cannot be read or do not go together, a wrong setting, or a folder that holds
        another fit or cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"cannot write to the output folder {str(folder)!r}: it is a file")
    on_stage("routes")
    examples: list[Example] = []
    for source in sources:
        examples += read_examples(
            source.routes,
            open_maps(source.maps, settings.resolution_m, obstacles=settings.obstacles),
            settings.altitude_m,
            settings.time,
            settings.time_of_day,
            **settings.maps,
        )
    state_file = folder / STATE_FILE
    if overwrite:
        state_file.unlink(missing_ok=True)
    given: dict[str, Any] = {**settings.fit, "state_file": state_file, "on_round": on_round}
    on_stage("fit")
    fit: WeightFit | TargetFit
    if settings.wishes:
        fit = fit_targets([example.query for example in examples], settings.wishes, **given)
    else:
        fit = fit_weights(examples, **given)
    on_stage("routes under the fitted weights")
    comparison = compare(examples, fit.weights)
    on_stage("figures and report")
    write_fit(fit, comparison, sources, settings.wishes, folder, command)
    return _facts(fit, folder)


def write_fit(
    fit: WeightFit | TargetFit,
    comparison: Comparison,
    sources: Sequence[Source],
    wishes: Sequence[Wish],
    folder: Path,
    command: str,
) -> None:
    """Write tables, pictures, the report and weights.toml of a fit.

    Raises:
      InputError: the folder cannot be written to.
    """
    unit = comparison.examples[0].query.unit
    units = {id(example.query.unit): example.query.unit for example in comparison.examples}.values()
    weight_unit = weight_units(unit)
    examples = comparison.table
    tables = {"learning_curve": fit.curve}
    draw: dict[str, Callable[[], Figure]] = {
        "weights": lambda: plot_weights(fit, [weight_unit[name] for name in fit.names]),
        "learning_curve": lambda: plot_learning(fit),
    }
    if isinstance(fit, WeightFit):
        weights = fit.table().reset_index()
        examples = examples.assign(regret=fit.regret, trust=fit.trust)
        tables["fewer_examples"] = fit.by_examples
        draw["regret"] = lambda: plot_regret(fit, [*examples["name"]])
    else:
        weights = pd.DataFrame({"name": fit.names, "weight": [getattr(fit.weights, name) for name in fit.names]})
        alone = fit.alone[["reached", "missed_by", "is_met"]].add_suffix("_alone")
        tables["targets"] = fit.outcomes.join(alone).reset_index()
        draw["targets"] = lambda: plot_targets(fit)
    tables |= {"weights": weights.assign(unit=[weight_unit[name] for name in weights["name"]]), "examples": examples}
    vector = weights["weight"].to_numpy()
    pictures = {f"routes_{number}": one for number, one in enumerate(units, start=1)}
    for name, table in tables.items():
        _write_table(table, folder, name)
    for name, figure in draw.items():
        _write_figure(figure(), folder, name)
    for name, one in pictures.items():
        _write_figure(plot_routes(comparison, one, vector), folder, name)
    asked = Asked(tuple((str(source.routes), str(source.maps)) for source in sources), command, tuple(pictures))
    if isinstance(fit, WeightFit):
        report = imitation_report(fit, comparison, asked)
    else:
        report = targets_report(fit, comparison, wishes, asked)
    for file, text in (("weights.toml", weights_toml(fit, unit)), ("report.md", report)):
        with whole_file(folder / file) as scratch:
            scratch.write_text(text, encoding="utf-8")


def _write_table(table: pd.DataFrame, folder: Path, name: str) -> None:
    with whole_file(folder / f"{name}.csv") as scratch:
        table.to_csv(scratch, index=False)
    with whole_file(folder / f"{name}.parquet") as scratch:
        table.to_parquet(scratch, index=False)


def _write_figure(figure: Figure, folder: Path, name: str) -> None:
    with whole_file(folder / FIGURES / f"{name}.png") as scratch:
        write_png(figure, scratch)


def _facts(fit: WeightFit | TargetFit, folder: Path) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "folder": str(folder),
        "weights": asdict(fit.weights),
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
