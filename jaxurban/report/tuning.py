"""report.md and weights.toml of a fit of weights, for a reader who has not seen the code."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.metrics.weights import Weights
from jaxurban.paths.cost_map import CostMap
from jaxurban.report.write import bullets, counted, fill, framed, table
from jaxurban.studies.demonstrations import PlannedBeside
from jaxurban.studies.tuning.compared_fits import FitComparison
from jaxurban.studies.tuning.target_fit import TargetFit
from jaxurban.studies.tuning.targets import Target
from jaxurban.studies.tuning.weight_fit import WeightFit

EXPLAINED = 1e-4  # a demonstration within this share of the cheapest route is explained
OUTCOMES = {
    "detour": "how much longer routes are than the shortest ones, as a share, mean over the queries",
    "length_m": "length of a route in metres, mean over the queries",
    "people": "the integral of m_population along all routes, as a share of the shortest routes'",
}

INTERVALS = (
    "Low and high are the 5th and 95th percentile of fits to demonstrations drawn anew with replacement (bootstrap), "
    "widened to all weights that explain these very demonstrations as well. Of lines that were redrawn on the grid "
    "they contain all weights under which any routes within 3 cells of the lines are the cheapest. They say what other "
    "demonstrations of the same kind would change, not whether these demonstrations are good ones."
)


@dataclass(frozen=True)
class FitSource:
    """What a fit was made from, for its report.

    Attributes:
      files: of routes, and the folders of the maps that they lie on.
      command: that made the fit.
      figures: names of the pictures of routes.
    """

    files: tuple[tuple[str, str], ...]
    command: str
    figures: tuple[str, ...]


def weight_units(on: CostMap) -> dict[str, str]:
    """Return the unit of each weight on a map."""
    per = "cell entered" if on.cost_model.kind == "cell" else f"{on.cost_model.reference_length_m:g} m flown"
    return {"distance": "per metre"} | dict.fromkeys(on.names, f"per {per}")


def weights_option(weights: Weights) -> str:
    """Return weights as ``--weights`` takes them."""
    return ",".join(f"{name}={value:.6g}" for name, value in weights.to_dict().items())


def weights_toml(fit: WeightFit | TargetFit, on: CostMap) -> str:
    """Return a [weights] table for a scenario, with how to use it as comments."""
    lines = [
        "# Weights fitted by `jaxurban tune`; report.md says how sure they are. Paste the table into a scenario.",
        f"# They belong to the cost model {on.cost_model.kind!r}{_where(on)}: plan with",
        f"#   --cost-model {on.cost_model.kind} --weights {weights_option(fit.weights)}",
        "[weights]",
        *(f"{name} = {_toml_number(value)}" for name, value in fit.weights.to_dict().items()),
    ]
    return "\n".join(lines) + "\n"


def _toml_number(value: float) -> str:
    text = f"{value:.6g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _where(on: CostMap) -> str:
    if on.cost_model.kind == "cell":
        return f" on cells of {on.grid.resolution_m:g} m (a step costs by the cell, so other sizes need other ones)"
    return f" with a reference length of {on.cost_model.reference_length_m:g} m"


def imitation_report(fit: WeightFit, beside: PlannedBeside, source: FitSource, fits: str = "") -> str:
    """Return the report of weights that were fitted to demonstrations, with a section on further fits."""
    units = weight_units(_unit(beside))
    rows = [
        [name, units[name], f"{weight:.4g}", _number(low), _number(high), f"{share:.1%}"]
        for name, (weight, low, high, share, _) in zip(fit.names, fit.table().to_numpy().tolist(), strict=True)
    ]
    text = fill(
        "imitation",
        fits=fits,
        **_common(fit, beside, source),
        given=counted(len(fit.regret), "demonstration"),
        weights=table(["weight", "unit", "value", "low", "high", "share of the demonstrations' cost"], rows),
        num_explained=int((fit.regret <= EXPLAINED).sum()),
        explained=EXPLAINED,
        mean_regret=_percent(fit.regret.mean()),
        median_regret=_percent(np.median(fit.regret)),
        largest_regret=_percent(fit.regret.max()),
        best_mean_regret=_percent(fit.best_mean_regret),
        overlap=beside.table["overlap"].mean(),
        confidence=INTERVALS if np.isfinite(fit.interval).any() else "No intervals were asked for (--bootstrap 0).",
        fewer=_fewer(fit),
        unidentified=bullets(fit.unidentified)
        or "Nothing: every weight decides between competing routes, no two do so alike, and no interval is wide.",
        warnings=bullets(fit.warnings) or "None.",
    )
    return f"{text}\n"


def is_compared(found: FitComparison) -> bool:
    """Return whether there is more to report than one fit to all routes."""
    return len(found.fits) > 1 or bool(found.is_held_out.any())


def fits_section(found: FitComparison) -> str:
    """Return the section of a report on several fits."""
    num_held_out, num_bad = int(found.is_held_out.sum()), int(found.is_bad.sum())
    fits = framed(found.table.filter(regex="^(?!w_)"))
    return fill("fits", fits=fits, num=len(found.is_bad), num_held_out=num_held_out, num_bad=num_bad)


def _fewer(fit: WeightFit) -> str:
    """Return what fewer demonstrations would have given, where intervals were made."""
    if not np.isfinite(fit.interval).any() or not len(fit.by_demonstrations):
        return ""
    rows = [
        [f"{num:.0f}", _percent(mean), _percent(worst)]
        for num, mean, worst in fit.by_demonstrations.to_numpy().tolist()
    ]
    head = ["demonstrations fitted", "regret of the others, mean", "worst of 8 draws"]
    return (
        "With fewer demonstrations (those left out are what the fit did not see; if the last rows hardly differ, "
        f"more demonstrations would add little):\n\n{table(head, rows)}"
    )


def targets_report(fit: TargetFit, beside: PlannedBeside, targets: Sequence[Target], source: FitSource) -> str:
    """Return the report of weights that were fitted to targets."""
    units = weight_units(_unit(beside))
    meanings = {
        target.outcome: OUTCOMES.get(
            target.outcome, f"mean of m_{target.outcome.removeprefix('mean_')} along a route, mean over the queries"
        )
        for target in targets
    }
    outcomes = [
        [
            str(target),
            *(f"{value:.4g}" for value in (row.shortest, row.reached, row.alone)),
            _percent(row.missed_by),
            "yes" if row.is_met else "no",
        ]
        for target, row in fit.outcomes.join(fit.alone["reached"].rename("alone")).iterrows()
    ]
    values = fit.weights.to_dict()
    text = fill(
        "targets",
        **_common(fit, beside, source),
        pairs=counted(len(beside.demonstrations), "pair of ends", "pairs of ends"),
        targets=", ".join(map(str, targets)),
        meanings=bullets(f"`{name}`: {meaning}" for name, meaning in meanings.items()),
        outcomes=table(
            ["target", "shortest routes", "reached, all together", "reached, alone", "missed by", "met"], outcomes
        ),
        completeness="Many weights meet the same targets; these are the first that were found, and no target was tried "
        "alone."
        if fit.is_met
        else "What was not met is not proven to be out of reach: it is the best that the search found.",
        weights=table(["weight", "unit", "value"], [[name, units[name], f"{values[name]:.4g}"] for name in fit.names]),
    )
    return f"{text}\n"


def _unit(beside: PlannedBeside) -> CostMap:
    return beside.demonstrations[0].query.cost_map


def _common(fit: WeightFit | TargetFit, beside: PlannedBeside, source: FitSource) -> dict[str, Any]:
    """Return the fields that both reports have."""
    unit = _unit(beside)
    return {
        "fit": fit,
        "sources": "; ".join(f"`{routes}` over the maps in `{maps}`" for routes, maps in source.files),
        "setting": _setting(beside, fit.names),
        "means": _mean_table(beside),
        "pictures": "\n\n".join(f"![Routes](figures/{name}.png)" for name in source.figures),
        "use": fill("use_weights", unit=unit, option=weights_option(fit.weights), where=_where(unit)),
        "command": source.command,
    }


def _setting(beside: PlannedBeside, names: Sequence[str]) -> str:
    units = {id(each.query.cost_map): each.query.cost_map for each in beside.demonstrations}.values()
    flown = "; ".join(
        ", ".join(filter(None, (f"{each.altitude_m:g} m", each.time_of_day, each.time))) for each in units
    )
    cells = ", ".join(f"{value:g}" for value in sorted({each.grid.resolution_m for each in units}))
    first = next(iter(units))
    constraints = f" Constraints: {said}." if (said := str(first.constraints)) else ""
    return (
        f"Weights fitted: {', '.join(names)}. Cost model: {first.cost_model} on cells of {cells} m.{constraints} "
        f"Obstacles: {first.maps.obstacles}. Altitudes and times: {flown}."
    )


def _mean_table(beside: PlannedBeside) -> str:
    mean = beside.table.mean(numeric_only=True)
    rows = [["length", f"{mean['length_m']:,.0f} m", f"{mean['planned_length_m']:,.0f} m"]]
    rows += [
        [f"mean m_{name}", f"{mean[f'mean_{name}']:.3f}", f"{mean[f'planned_mean_{name}']:.3f}"]
        for name in _unit(beside).names
    ]
    return table(["mean over routes", "as given", "under the fitted weights"], rows)


def _number(value: float) -> str:
    return "" if pd.isna(value) else f"{value:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share >= 1e-6 else "0 %"
