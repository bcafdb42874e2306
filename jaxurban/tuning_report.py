"""report.md and weights.toml of a fit of weights, for a reader who has not seen the code."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from jaxurban.cost import Weights
from jaxurban.studies.compare import Comparison
from jaxurban.studies.imitation import WeightFit
from jaxurban.studies.targets import TargetFit
from jaxurban.studies.wishes import Wish
from jaxurban.weighted import WeightedMap

EXPLAINED = 1e-4  # an example within this share of the cheapest route is explained
OUTCOMES = {
    "detour": "how much longer routes are than the shortest ones, as a share, mean over the queries",
    "length_m": "length of a route in metres, mean over the queries",
    "people": "people overflown (the integral of m_population along all routes), as a share of the shortest routes'",
}


@dataclass(frozen=True)
class Asked:
    """What a fit was asked for, as its report tells it.

    Attributes:
      sources: the files of routes, and the folders of the maps that they lie on.
      command: that made the fit.
      figures: names of the pictures of routes.
    """

    sources: tuple[tuple[str, str], ...]
    command: str
    figures: tuple[str, ...]


def weight_units(unit: WeightedMap) -> dict[str, str]:
    """Return the unit of each weight on a map."""
    per = "cell entered" if unit.cost_model.kind == "cell" else f"{unit.cost_model.reference_length_m:g} m flown"
    return {"distance": "per metre"} | dict.fromkeys(unit.names, f"per {per}")


def weights_option(weights: Weights) -> str:
    """Return weights as ``--weights`` takes them."""
    return ",".join(f"{name}={value:.6g}" for name, value in asdict(weights).items())


def weights_toml(fit: WeightFit | TargetFit, unit: WeightedMap) -> str:
    """Return a [weights] table for a scenario, with how to use it as comments."""
    lines = [
        "# Weights fitted by `jaxurban tune`; report.md says how sure they are. Paste the table into a scenario.",
        f"# They belong to the cost model {unit.cost_model.kind!r}{_where(unit)}: plan with",
        f"#   --cost-model {unit.cost_model.kind} --weights {weights_option(fit.weights)}",
        "[weights]",
        *(f"{name} = {_toml_number(value)}" for name, value in asdict(fit.weights).items()),
    ]
    return "\n".join(lines) + "\n"


def _toml_number(value: float) -> str:
    text = f"{value:.6g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _where(unit: WeightedMap) -> str:
    if unit.cost_model.kind == "cell":
        return (
            f" on cells of {unit.grid.resolution_m:g} m (a step is charged by the cell, so other sizes need other ones)"
        )
    return f" with a reference length of {unit.cost_model.reference_length_m:g} m"


def imitation_report(fit: WeightFit, comparison: Comparison, asked: Asked) -> str:
    """Return the report of weights that were fitted to examples."""
    unit = comparison.examples[0].query.unit
    units = weight_units(unit)
    num = len(fit.regret)
    explained = int((fit.regret <= EXPLAINED).sum())
    sections = [
        "# Weights fitted to example routes",
        f"**Asked.** {num} example routes ({_sources(asked)}): under which weights are they the cheapest routes "
        f"between their ends? {_setting(comparison, fit.names)}",
        "A route costs w_distance x its length plus, for each metric, w x the metric's cost c along it, with c between "
        "0 (best) and 1 (worst). Only the ratios of weights matter: multiplying all of them by one number changes "
        "no route. The *regret* of an example is by which share it costs more than the cheapest route between its "
        "ends: 0 if the weights explain it fully.",
        "## What came out",
        _table(
            ["weight", "unit", "value", "low", "high", "share of the examples' cost"],
            [
                [name, units[name], f"{weight:.4g}", _number(low), _number(high), f"{share:.1%}"]
                for name, (weight, low, high, share, _) in zip(fit.names, fit.table().to_numpy().tolist(), strict=True)
            ],
        ),
        "![Weights and their intervals](figures/weights.png)",
        "## How well the weights explain the examples",
        f"{explained} of {num} examples are the cheapest routes (within {EXPLAINED:.2%}). The mean regret is "
        f"{_percent(fit.regret.mean())}, the median {_percent(np.median(fit.regret))}, the largest "
        f"{_percent(fit.regret.max())}. The least mean regret that any weights were found to reach is "
        f"{_percent(fit.best_mean_regret)}. Routes planned under the weights share "
        f"{comparison.table['overlap'].mean():.0%} of the examples' cells; routes of equal cost may lie apart.",
        _mean_table(comparison),
        "![Regret of each example](figures/regret.png)",
        *(f"![Routes](figures/{name}.png)" for name in asked.figures),
        "## How sure",
        _confidence(fit),
        "![Learning curves](figures/learning_curve.png)",
        "## What the examples cannot tell",
        _bullets(fit.unidentified)
        or "Nothing: every weight decides between competing routes, no two do so alike, and no interval is wide.",
        "## Warnings",
        _bullets(fit.warnings) or "None.",
        _use(fit, unit),
        _files(
            ("examples", "each example: regret, trust, what it crosses and what the planned route crosses"),
            ("fewer_examples", "the regret of examples left out, by the number of those fitted"),
        ),
        f"Made by `{asked.command}` in {fit.elapsed_s:.0f} s with {fit.num_plans:,} searches.",
    ]
    return "\n\n".join(sections) + "\n"


def _confidence(fit: WeightFit) -> str:
    if not np.isfinite(fit.interval).any():
        return "No intervals were asked for (--bootstrap 0)."
    said = (
        "Low and high are the 5th and 95th percentile of fits to examples drawn anew with replacement (bootstrap), "
        "widened to all weights that explain these very examples as well. They say what other examples of the same "
        "kind would change, not whether these examples are good ones."
    )
    if len(fit.by_examples):
        rows = [
            [f"{num:.0f}", _percent(mean), _percent(worst)] for num, mean, worst in fit.by_examples.to_numpy().tolist()
        ]
        head = ["examples fitted", "regret of the others, mean", "worst of 8 draws"]
        said += (
            "\n\nWith fewer examples (those left out are what the fit did not see; if the last rows hardly differ, "
            f"more examples would add little):\n\n{_table(head, rows)}"
        )
    return said


def targets_report(fit: TargetFit, comparison: Comparison, wishes: Sequence[Wish], asked: Asked) -> str:
    """Return the report of weights that were fitted to wishes."""
    unit = comparison.examples[0].query.unit
    units = weight_units(unit)
    meanings = {
        wish.outcome: OUTCOMES.get(
            wish.outcome, f"mean of m_{wish.outcome.removeprefix('mean_')} along a route, mean over the queries"
        )
        for wish in wishes
    }
    outcomes = fit.outcomes.join(fit.alone["reached"].rename("alone"))
    sections = [
        "# Weights fitted to wishes",
        f"**Asked.** Weights under which the cheapest routes between {len(comparison.examples)} pairs of ends (those "
        f"of {_sources(asked)}) are as wished: {', '.join(map(str, wishes))}. {_setting(comparison, fit.names)}",
        _bullets([f"`{name}`: {meaning}" for name, meaning in meanings.items()]),
        "## What came out",
        f"**{fit.sentence}**",
        _table(
            ["wish", "shortest routes", "reached, all together", "reached, alone", "missed by", "met"],
            [
                [
                    str(wish),
                    f"{row.shortest:.4g}",
                    f"{row.reached:.4g}",
                    f"{row.alone:.4g}",
                    _percent(row.missed_by),
                    "yes" if row.is_met else "no",
                ]
                for wish, row in outcomes.iterrows()
            ],
        ),
        "A wish is met if it is missed by no more than 2 % of its bound. Outcomes are those of planned routes. "
        + (
            "Many weights meet the same wishes; these are the first that were found, and no wish was tried alone."
            if fit.is_met
            else "What was not met is not proven to be out of reach: it is the best that the search found."
        ),
        "![Wishes and outcomes](figures/targets.png)",
        _table(
            ["weight", "unit", "value"],
            [[name, units[name], f"{getattr(fit.weights, name):.4g}"] for name in fit.names],
        ),
        "![Weights](figures/weights.png)",
        "![Learning curve](figures/learning_curve.png)",
        "## What the routes are like",
        _mean_table(comparison),
        *(f"![Routes](figures/{name}.png)" for name in asked.figures),
        _use(fit, unit),
        _files(
            ("targets", "each wish: its bound, what shortest routes give, what was reached together and alone"),
            ("examples", "each query: what the given route crosses, and what the planned one crosses"),
        ),
        f"Made by `{asked.command}` in {fit.elapsed_s:.0f} s with {fit.num_plans:,} searches.",
    ]
    return "\n\n".join(sections) + "\n"


def _sources(asked: Asked) -> str:
    return "; ".join(f"`{routes}` over the maps in `{maps}`" for routes, maps in asked.sources)


def _setting(comparison: Comparison, names: Sequence[str]) -> str:
    units = {id(example.query.unit): example.query.unit for example in comparison.examples}.values()
    flown = "; ".join(
        ", ".join(filter(None, (f"{unit.altitude_m:g} m", unit.time_of_day, unit.time))) for unit in units
    )
    cells = ", ".join(f"{value:g}" for value in sorted({unit.grid.resolution_m for unit in units}))
    first = next(iter(units))
    limits = f" Limits: {first.limits}." if first.limits else ""
    return (
        f"Weights fitted: {', '.join(names)}. Cost model: {first.cost_model} on cells of {cells} m.{limits} "
        f"Obstacles: {first.maps.obstacles}. Altitudes and times: {flown}."
    )


def _mean_table(comparison: Comparison) -> str:
    table = comparison.table
    rows = [["length", f"{table['length_m'].mean():,.0f} m", f"{table['planned_length_m'].mean():,.0f} m"]]
    rows += [
        [f"mean m_{name}", f"{table[f'mean_{name}'].mean():.3f}", f"{table[f'planned_mean_{name}'].mean():.3f}"]
        for name in comparison.examples[0].query.unit.names
    ]
    return _table(["mean over routes", "as given", "under the fitted weights"], rows)


def _use(fit: WeightFit | TargetFit, unit: WeightedMap) -> str:
    return (
        "## How to use the weights\n\n`weights.toml` holds a `[weights]` table to paste into a scenario. On the "
        f"command line:\n\n```sh\njaxurban plan DIR --start LON,LAT --goal LON,LAT --altitude {unit.altitude_m:g} \\\n"
        f"    --cost-model {unit.cost_model.kind} --weights {weights_option(fit.weights)}\n```\n\nThey belong to the "
        f"cost model `{unit.cost_model.kind}`{_where(unit)}."
    )


def _files(*more: tuple[str, str]) -> str:
    files = [
        ("weights", "the table of weights"),
        *more,
        ("learning_curve", "the fit by round"),
    ]
    return "## Files\n\n" + _bullets([f"`{name}.csv`, `{name}.parquet`: {what}" for name, what in files])


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _bullets(lines: Sequence[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _number(value: float) -> str:
    return "" if pd.isna(value) else f"{value:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share >= 1e-6 else "0 %"
