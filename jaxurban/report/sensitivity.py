"""report.md of a sensitivity study: what would change the route and what would not, as tables and figures."""

import json
from dataclasses import asdict

import numpy as np
import pandas as pd

from jaxurban.paths.constraints import describe_constraints
from jaxurban.planners.cost import CostModel
from jaxurban.report.figures.frame import joined
from jaxurban.report.figures.sensitivity import sensitivity_figures
from jaxurban.report.write import Written, fill, joined_with_and, study_outputs
from jaxurban.studies.queries import outcome_label, outcome_names, outcome_unit
from jaxurban.studies.weights.sobol import FEW_SAMPLES, NOISE
from jaxurban.studies.weights.study import Sensitivity

ALIKE = 0.05  # routes are much the same where no outcome differs by more than this share
MORE = 1.1  # the change of a weight that the report speaks of: 10 %
CLEAR = 2.0  # standard errors from 0
TOP_BUILDINGS = 10
RANKING = "rank", "per_metre", "height_m", "lon", "lat", "distance_m"


def sensitivity_outputs(result: Sensitivity) -> Written:
    """Return what a study of one route writes, by file name, and the settings that identify it, as JSON holds them."""
    route = result.route
    settings = {
        "route": route.settings,
        "lonlat": route.lonlat[[0, -1]].tolist(),
        "weights": result.weights.tolist(),
        **asdict(result.settings),
    }
    tables = {name: table.reset_index() for name, table in result.tables().items()}
    outputs = study_outputs(sensitivity_markdown(result), tables, sensitivity_figures(result))
    return outputs, json.loads(json.dumps(settings, default=str))


def sensitivity_markdown(result: Sensitivity, buildings: pd.DataFrame | None = None) -> str:
    """Return the report as Markdown; it names figures and tables as `sensitivity_outputs` does.

    Args:
      result: of the study.
      buildings: what `jaxurban.report.buildings.write_buildings` wrote beside it: a row per building, the costliest
        first, of which the report shows the first `TOP_BUILDINGS`; None: the report has no such table.
    """
    route = result.route
    settings = route.settings
    tables = report_tables(result)
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
        note=" ".join(route.cautions),
        objectives=joined_with_and(result.front.objectives),
        ALIKE=ALIKE,
        MORE=MORE - 1,
        CLEAR=CLEAR,
        FEW_SAMPLES=FEW_SAMPLES,
        NOISE=NOISE,
    )


def report_tables(result: Sensitivity) -> dict[str, pd.DataFrame]:
    """Return the tables of the report by name.

    ``outcomes``, ``indices`` and ``changes``: what the route is like, total Sobol shares, and what a larger weight
    changes, a row per outcome (of ``changes`` per weight); ``costs``: the gradient of the cost; ``ends``: the routes
    that are best for one objective; ``ranges``: where along each weight the route stays (see `ranges`).
    """
    # By what share each outcome changes where a weight is `MORE` times as large, as slopes are by the logarithm of a
    # weight; ``unclear`` where a slope is not clear of 0.
    slopes = result.outcomes
    size = slopes["expected"].abs().clip(lower=1e-12)
    change = slopes["expected_slope"] * np.log(MORE) / size
    is_clear = slopes["expected_slope"].abs() > CLEAR * slopes["expected_slope_se"]
    changes = change.map("{:+.1%}".format).where(is_clear, "unclear").unstack()

    # The range of each outcome, and the total Sobol share of each varied weight with its interval, as text.
    sobol = result.sobol
    spread = sobol.groupby("outcome", sort=False)[["lowest", "highest"]].first()
    totals = sobol["total"].map("{:.2f}".format) + sobol["total_ci"].map(" ± {:.2f}".format)
    shares = totals.where(sobol["total"].notna(), "").unstack()

    # Tables with a row per outcome, by the labels of the outcomes.
    values = slopes["value"].groupby("outcome", sort=False).first()
    units = [outcome_unit(str(name)) for name in values.index]
    by_outcome = {
        "outcomes": pd.DataFrame({"value": values, "unit": units}),
        "indices": spread.join(shares[[*result.lines]]),
        "changes": changes.loc[values.index, [*result.names]],
    }
    tables = {
        name: table.rename(index=outcome_label).rename_axis("outcome")
        for name, table in by_outcome.items()
    }

    # Tables with a row per weight, or per objective of the Pareto front.
    tables["changes"] = tables["changes"].T.rename_axis(f"{MORE - 1:.0%} more of", axis=0)
    tables["costs"] = result.cost
    points = result.front.points[[*result.front.objectives]]
    tables["ends"] = points.loc[points.idxmin().tolist()]
    tables = {name: table.reset_index() for name, table in tables.items()}

    rows = [
        {"weight": name, **ranges(result, name), "routes": len(line.cells)}
        for name, line in result.lines.items()
    ]
    tables["ranges"] = pd.DataFrame(rows)
    return tables


def ranges(result: Sensitivity, name: str) -> dict[str, float]:
    """Return where, along a weight's range, the route stays the same, and where much the same.

    Args:
      result: of the study.
      name: of the weight.

    Returns:
      Values of the weight: between ``same_from`` and ``same_to`` the cheapest route is the given one; between
      ``alike_from`` and ``alike_to`` no outcome differs from its by more than the share `ALIKE`.
    """
    # A row for each route along the range, with the values between which it is the cheapest.
    table = result.breakpoints(name)

    # Which routes differ from the given one in any outcome.
    outcomes = table[list(outcome_names(result.names))]
    given = table.index[table["is_given"]][0]
    route = outcomes.loc[given]
    change = (outcomes - route).abs() / route.abs().clip(lower=1e-9)
    is_other = (change > ALIKE).any(axis=1)

    # The routes around the given one, as far as the next one that is not alike on either side. There the number of such
    # routes so far is the same as at the given route.
    num_others = is_other.cumsum()
    alike = table[~is_other & (num_others == num_others[given])]
    return {
        "same_from": table.loc[given, "from"],
        "same_to": table.loc[given, "to"],
        "alike_from": alike["from"].iloc[0],
        "alike_to": alike["to"].iloc[-1],
    }
