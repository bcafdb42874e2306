"""report.md of a sensitivity study: what would change the route and what would not, for a reader new to it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import typed
from jaxurban.io.workspace import Workspace
from jaxurban.paths.constraints import constraints_said
from jaxurban.planners.cost_model import CostModel
from jaxurban.report.figures.degrees import in_degrees
from jaxurban.report.figures.sensitivity import sensitivity_figures
from jaxurban.report.markdown import bullets, fill, listed, short, table
from jaxurban.report.save import files_of, save
from jaxurban.studies.outcomes import outcome_label, outcome_names, outcome_unit
from jaxurban.studies.sensitivity.sobol import FEW_SAMPLES
from jaxurban.studies.sensitivity.study import Sensitivity

REPORT_FILE = "report.md"
TABLES = "cost_gradient", "local", "sobol", "sobol_spread", "switches", "pareto", "triangle", "triangle_cells"
FIGURES = "switches", "switch_routes", "sobol", "pareto", "triangle", "triangle_routes"
FILES = files_of([*(f"tables/{name}" for name in TABLES), *(f"figures/{name}.png" for name in FIGURES), REPORT_FILE])
ALIKE = 0.05  # routes are much the same where no outcome differs by more than this share
MORE = 1.1  # the change of a weight that the report tells about: 10 %
CLEAR = 2.0  # standard errors from 0
TOP_BUILDINGS = 10


@typed
def save_sensitivity(
    found: Sensitivity, folder: str | Path, overwrite: bool = False, *, degrees: bool = False
) -> list[Path]:
    """Write the report, tables (CSV, Parquet) and figures (PNG) of a study into a folder and return the files.

    Args:
      found: the study.
      folder: where to; made if it is not there.
      overwrite: replace another study in it.
      degrees: label the maps of figures by longitude and latitude instead of easting and northing.

    Raises:
      InputError: the folder cannot be written to, or holds another study or other files.
    """
    folder, route = Path(folder), found.route
    settings = {"route": route.settings, "lonlat": route.lonlat[[0, -1]].tolist(), "weights": found.weights.tolist()}
    settings |= {"vary": found.vary, "factors": found.factors, "triangle": found.triangle_names}
    asked = json.loads(json.dumps(settings, default=str))
    with Workspace.open(folder, "sensitivity", asked, names=FILES, overwrite=overwrite):
        return write_sensitivity(found, folder, degrees)


def write_sensitivity(found: Sensitivity, folder: Path, degrees: bool = False) -> list[Path]:
    """Write what `save_sensitivity` writes, into a folder that is held already."""
    tables = {f"tables/{name}": table.reset_index() for name, table in found.tables().items()}
    if found.triangle is not None:
        tables["tables/triangle_cells"] = found.triangle_cells()
    drawn = in_degrees(sensitivity_figures(found), found.maps.grid, degrees)
    figures = {f"figures/{name}.png": draw for name, draw in drawn.items()}
    return save(folder, {**tables, **figures, REPORT_FILE: sensitivity_markdown(found)})


def add_buildings(folder: Path, costs: pd.DataFrame) -> None:
    """Add to the report in a folder what `jaxurban.report.buildings.write_buildings` wrote beside it.

    Args:
      folder: that `save_sensitivity` wrote.
      costs: the table of buildings, ranked.
    """
    rows = [
        [
            f"{rank}",
            f"{row.per_metre:+.3g}",
            f"{row.height_m:.1f} m",
            f"{row.lon:.5f},{row.lat:.5f}",
            f"{row.distance_m:.0f} m",
        ]
        for rank, row in costs.head(TOP_BUILDINGS).iterrows()
    ]
    head = ["rank", "cost per metre", "height", "longitude, latitude", "from the route"]
    report = (folder / REPORT_FILE).read_text(encoding="utf-8").rstrip()
    save(folder, {REPORT_FILE: f"{report}\n\n{fill('buildings', ranking=table(head, rows))}\n"})


def sensitivity_markdown(found: Sensitivity) -> str:
    """Return the report as Markdown; it names figures and tables as `save_sensitivity` does."""
    low, high = found.factors
    text = fill(
        "sensitivity",
        found=found,
        route=found.route,
        low=low,
        high=high,
        alike=ALIKE,
        findings=bullets(_finding(found, name) for name in found.vary),
        where=", ".join(_where(found)),
        note="".join(f" {sentence}" for sentence in (found.route.search.note, *found.route.cautions) if sentence),
        costs=_costs(found),
        outcomes=_outcomes(found),
        ranges=_ranges(found),
        more=MORE - 1,
        clear=CLEAR,
        changes=_changes(found),
        too_few=f"**These are too few plans for such indices, and ± below is no 95 % interval: take {FEW_SAMPLES} "
        "`--samples` or more.**"
        if found.sobol.num_evaluations < FEW_SAMPLES * (2 + len(found.vary))
        else "",
        together="The weights vary together and independently, each" if len(found.vary) > 1 else "The weight varies",
        indices=bullets(_indices(found, outcome) for outcome in found.sobol.spread.index),
        triangle=_triangle(found),
        objectives=listed(found.front.objectives),
        num_best=len(found.front.points),
        front_limit=""
        if found.front.partition.is_complete
        else " The limit of searches was reached, so points may be missing.",
        ends=bullets(_best(found, name) for name in found.front.objectives),
    )
    return f"{text}\n"


def ranges(found: Sensitivity, name: str) -> dict[str, float]:
    """Return where, along a weight's range, the route stays the same, and where much the same (see `ALIKE`).

    ``same_from``, ``same_to``, ``alike_from`` and ``alike_to``, values of the weight, ends of the range included.
    """
    table = found.breakpoints(name)
    outcomes = table[list(outcome_names(found.names))]
    given = int(np.argmax(table["is_given"]))
    off = (outcomes - outcomes.iloc[given]).abs() / outcomes.iloc[given].abs().clip(lower=1e-9)
    differs = np.flatnonzero((off > ALIKE).any(axis=1))
    first = max((place + 1 for place in differs if place < given), default=0)
    last = min((place - 1 for place in differs if place > given), default=len(table) - 1)
    return {
        "same_from": float(table["from"].iloc[given]),
        "same_to": float(table["to"].iloc[given]),
        "alike_from": float(table["from"].iloc[first]),
        "alike_to": float(table["to"].iloc[last]),
    }


def _finding(found: Sensitivity, name: str) -> str:
    """Return what a weight alone does to the route."""
    if len(found.lines[name].cells) == 1:
        return f"**{name}** does not change the route at all."
    (low, high), at, weight = found.factors, ranges(found, name), found.weights[found.names.index(name)]
    ends = (at["alike_from"] / weight, at["alike_to"] / weight)
    below = f"below {ends[0]:.3g} times its value" if ends[0] > low * 1.001 else ""
    above = f"above {ends[1]:.4g} times its value" if ends[1] < high * 0.999 else ""
    changes = " or ".join(filter(None, (below, above)))
    said = f"makes it another route {changes}" if changes else "leaves it much the same over the whole range"
    return (
        f"**{name}** {said} (exactly the same route from {at['same_from']:.4g} to {at['same_to']:.4g}; "
        f"given: {weight:g})."
    )


def _where(found: Sensitivity) -> list[str]:
    route, settings = found.route, found.route.settings
    start, goal = route.lonlat[0], route.lonlat[-1]
    return [
        f"From {start[0]:.5f},{start[1]:.5f} to {goal[0]:.5f},{goal[1]:.5f} (longitude, latitude) at "
        f"{route.altitude_m:g} m above ground",
        *([settings["time_of_day"]] if settings["time_of_day"] else []),
        f"{settings['resolution_m']:g} m cells",
        f"cost model {CostModel.from_settings(settings)}",
        *([f"constraints: {said}"] if (said := constraints_said(settings["limits"])) else []),
        f"obstacles: {settings['obstacles']}",
    ]


def _costs(found: Sensitivity) -> str:
    return table(
        ("weight", "value", "derivative of the cost", "share of the cost"),
        [
            (name, f"{row.weight:g}", f"{row.gradient:.4g}", f"{row.elasticity:.1%}")
            for name, row in zip(found.names, found.local.cost.itertuples(), strict=True)
        ],
    )


def _outcomes(found: Sensitivity) -> str:
    values = found.local.outcomes["value"].groupby("outcome", sort=False).first()
    rows = [(outcome_label(name), short(values[name]), outcome_unit(name)) for name in outcome_names(found.names)]
    return table(("outcome", "value", "unit"), rows)


def _ranges(found: Sensitivity) -> str:
    rows = []
    for name in found.vary:
        at = ranges(found, name)
        spans = (f"{at[f'{kind}_from']:.3g} to {at[f'{kind}_to']:.3g}" for kind in ("same", "alike"))
        given = found.weights[found.names.index(name)]
        rows.append((name, f"{given:g}", *spans, str(len(found.lines[name].cells))))
    much = f"much the same ({ALIKE:.0%}) from .. to"
    return table(("weight", "given", "same route from .. to", much, "routes in the range"), rows)


def _changes(found: Sensitivity) -> str:
    """Return the change of each outcome for `MORE` of each weight."""
    outcomes = list(dict.fromkeys(found.local.outcomes.index.get_level_values("outcome")))
    rows = []
    for name in found.names:
        cells = []
        for outcome in outcomes:
            row = found.local.outcomes.loc[(outcome, name)]
            change = row["expected_slope"] * np.log(MORE) / max(abs(row["expected"]), 1e-12)
            is_clear = abs(row["expected_slope"]) > CLEAR * row["expected_slope_se"]
            cells.append(f"{change:+.1%}" if is_clear else "unclear")
        rows.append((name, *cells))
    return table((f"{MORE - 1:.0%} more of", *map(outcome_label, outcomes)), rows)


def _indices(found: Sensitivity, outcome: Any) -> str:
    rows = found.sobol.table.loc[outcome]
    reach = " to ".join(short(found.sobol.spread.loc[outcome, end]) for end in ("lowest", "highest"))
    about = f"**{outcome_label(outcome)}** ({reach})"
    if rows["total"].isna().all():
        return f"{about} does not vary."
    ranked = rows.sort_values("total", ascending=False).itertuples()
    return f"{about}: {', '.join(f'{row.Index} {row.total:.2f} ± {row.total_ci:.2f}' for row in ranked)}."


def _triangle(found: Sensitivity) -> str:
    if found.triangle is None:
        return ""
    parts = found.triangle
    return fill(
        "sensitivity_triangle",
        names=listed(found.triangle_names),
        total=found.weights[[found.names.index(name) for name in found.triangle_names]].sum(),
        num_routes=len(parts.cells),
        completeness="a search at each of their corners shows that no other route is cheaper anywhere by more than "
        f"{parts.tolerance:.2g} of the cost"
        if parts.is_complete
        else "the limit of searches was reached, so routes may be missing",
        num_clusters=len(found.representatives),
    )


def _best(found: Sensitivity, name: str) -> str:
    """Return the route of the front with the least of one objective."""
    best = found.front.points.iloc[int(found.front.points[name].argmin())]
    return f"least {name}: " + ", ".join(f"{other} {short(best[other])}" for other in found.front.objectives)
