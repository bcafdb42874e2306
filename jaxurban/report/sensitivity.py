"""report.md of a sensitivity study: what would change the route and what would not, as tables and figures."""

import json
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.paths.constraints import describe_constraints
from jaxurban.planners.cost import CostModel
from jaxurban.report.figures.frame import joined
from jaxurban.report.figures.sensitivity import sensitivity_figures
from jaxurban.report.results import Result, savable
from jaxurban.report.write import REPORT_FILE, Output, files_of, fill, listed, study_outputs
from jaxurban.studies.queries import outcome_label, outcome_names, outcome_unit
from jaxurban.studies.weights import study as computed
from jaxurban.studies.weights.sobol import FEW_SAMPLES, NOISE

TABLES = "cost_gradient", "local", "sobol", "switches", "pareto"
FIGURES = "switches", "switch_routes", "pareto"
FILES = files_of(
    [
        *(f"tables/{name}" for name in TABLES),
        *(f"figures/{name}.png" for name in FIGURES),
        REPORT_FILE,
    ]
)
ALIKE = 0.05  # routes are much the same where no outcome differs by more than this share
MORE = 1.1  # the change of a weight that the report speaks of: 10 %
CLEAR = 2.0  # standard errors from 0
TOP_BUILDINGS = 10
RANKING = "rank", "per_metre", "height_m", "lon", "lat", "distance_m"


def sensitivity_outputs(result: computed.Sensitivity) -> tuple[dict[str, Output], dict[str, Any]]:
    """Return what a study of one route writes, by file name, and what it is of."""
    route = result.route
    settings = {
        "route": route.settings,
        "lonlat": route.lonlat[[0, -1]].tolist(),
        "weights": result.weights.tolist(),
    }
    settings |= asdict(result.settings)
    tables = {name: table.reset_index() for name, table in result.tables().items()}
    outputs = study_outputs(sensitivity_markdown(result), tables, sensitivity_figures(result))
    return outputs, json.loads(json.dumps(settings, default=str))


def sensitivity_markdown(
    result: computed.Sensitivity, buildings: pd.DataFrame | None = None
) -> str:
    """Return the report as Markdown; it names figures and tables as `sensitivity_outputs` does.

    ``buildings``: what `jaxurban.report.buildings.write_buildings` wrote beside it.
    """
    route, settings, tables = result.route, result.route.settings, shown_tables(result)
    if buildings is not None:
        ranking = buildings.head(TOP_BUILDINGS).rename_axis("rank").reset_index()[[*RANKING]]
        tables["ranking"] = ranking.round({"lon": 5, "lat": 5}).astype({"lon": str, "lat": str})
    return fill(
        "sensitivity",
        tables,
        sensitivity_figures(result),
        [result.maps.attribution],
        result=result,
        route=route,
        start=route.lonlat[0],
        goal=route.lonlat[-1],
        where=joined(f"{route.altitude_m:g} m above ground", settings["time_of_day"]),
        settings=settings,
        limits=describe_constraints(settings["limits"]) or "none",
        cost_model=CostModel.from_settings(settings),
        note=" ".join(filter(None, (route.search.note, *route.cautions))),
        objectives=listed(result.front.objectives),
        ALIKE=ALIKE,
        MORE=MORE - 1,
        CLEAR=CLEAR,
        FEW_SAMPLES=FEW_SAMPLES,
        NOISE=NOISE,
    )


def shown_tables(result: computed.Sensitivity) -> dict[str, pd.DataFrame]:
    """Return the tables of the report by name."""
    points, outcomes, sobol = (
        result.front.points[[*result.front.objectives]],
        result.outcomes,
        result.sobol,
    )
    at = [
        {"weight": name, **ranges(result, name), "routes": len(result.lines[name].cells)}
        for name in result.lines
    ]
    values = outcomes["value"].groupby("outcome", sort=False).first()
    change = (
        outcomes["expected_slope"] * np.log(MORE) / outcomes["expected"].abs().clip(lower=1e-12)
    )
    is_clear = outcomes["expected_slope"].abs() > CLEAR * outcomes["expected_slope_se"]
    changes = (
        change.map("{:+.1%}".format)
        .where(is_clear, "unclear")
        .unstack()
        .loc[values.index, [*result.names]]
        .T
    )
    spread = sobol.groupby("outcome", sort=False)[["lowest", "highest"]].first()
    total = [f"{total:.2f} ± {half:.2f}" for total, half in sobol[["total", "total_ci"]].to_numpy()]
    shares = (
        pd.Series(total, sobol.index).where(sobol["total"].notna(), "").unstack()[[*result.lines]]
    )
    tables = {
        "outcomes": pd.DataFrame(
            {"value": values, "unit": [outcome_unit(str(name)) for name in values.index]}
        ),
        "indices": spread.join(shares).loc[spread.index],
    }
    tables = {
        name: table.rename(index=outcome_label).rename_axis("outcome")
        for name, table in tables.items()
    }
    tables["changes"] = changes.rename(columns=outcome_label).rename_axis(
        f"{MORE - 1:.0%} more of", axis=0
    )
    tables |= {"costs": result.cost, "ends": points.loc[[points[name].idxmin() for name in points]]}
    return {name: table.reset_index() for name, table in tables.items()} | {
        "ranges": pd.DataFrame(at)
    }


def ranges(result: computed.Sensitivity, name: str) -> dict[str, float]:
    """Return where, along a weight's range, the route stays the same, and where much the same (see `ALIKE`).

    ``same_from``, ``same_to``, ``alike_from`` and ``alike_to``, values of the weight, ends of the range included.
    """
    table = result.breakpoints(name)
    outcomes = table[list(outcome_names(result.names))]
    given_row = int(np.argmax(table["is_given"]))
    off = (outcomes - outcomes.iloc[given_row]).abs() / outcomes.iloc[given_row].abs().clip(
        lower=1e-9
    )
    differs = np.flatnonzero((off > ALIKE).any(axis=1))
    first = max((place + 1 for place in differs if place < given_row), default=0)
    last = min((place - 1 for place in differs if place > given_row), default=len(table) - 1)
    return {
        "same_from": float(table["from"].iloc[given_row]),
        "same_to": float(table["to"].iloc[given_row]),
        "alike_from": float(table["from"].iloc[first]),
        "alike_to": float(table["to"].iloc[last]),
    }


class Sensitivity(computed.Sensitivity, Result):
    """What the weights do to one route. ``K`` weights.

    Attributes:
      maps: on which it is planned.
      route: the cheapest route under the given weights.
      names: ``"distance"`` and the metrics.
      weights: ``[K]`` as given.
      settings: what was varied, how far, and how finely; what was left out is filled in.
      cost, outcomes: derivatives at the given weights (`cost_gradient`, `outcome_slopes`).
      sobol: shares of variance over the whole range (`sobol_indices`).
      lines: of each varied weight, the routes along its range, the others as given.
      front: routes between objectives.
      line_routes: ``[N, 2]`` easting and northing of the routes of each line, in the order of its cells.
      num_plans, elapsed_s: searches and wall time.

    Examples:
      >>> quick = ju.studies.SensitivitySettings(vary=("gps",), num_samples=4, max_plans=20)
      >>> result = ju.studies.sensitivity(ju.cost_map(maps, 60.0), start, goal, settings=quick)
      >>> {name: len(line.cells) for name, line in result.lines.items()}, result.route.status.value
      ({'gps': 3}, 'optimal')
    """

    _command = "sensitivity"
    _outputs = sensitivity_outputs


sensitivity = savable(computed.sensitivity, Sensitivity)
