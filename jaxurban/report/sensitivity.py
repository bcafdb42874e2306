"""report.md of a sensitivity study: what would change the route and what would not, as tables and figures."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import typed
from jaxurban.io.workspace import Workspace
from jaxurban.paths.constraints import constraints_said
from jaxurban.planners.cost_model import CostModel
from jaxurban.report.figures.frame import in_degrees
from jaxurban.report.figures.notes import joined
from jaxurban.report.figures.sensitivity import sensitivity_figures
from jaxurban.report.write import files_of, fill, framed, listed, save, short, table
from jaxurban.studies.queries import outcome_label, outcome_names, outcome_unit
from jaxurban.studies.weights.sobol import FEW_SAMPLES
from jaxurban.studies.weights.study import Sensitivity

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
        (str(rank), f"{row.per_metre:+.3g}", f"{row.height_m:.1f}", f"{row.lon:.5f},{row.lat:.5f}", row.distance_m)
        for rank, row in costs.head(TOP_BUILDINGS).iterrows()
    ]
    ranking = table(("rank", "cost per metre", "height (m)", "longitude, latitude", "from the route (m)"), rows)
    report = (folder / REPORT_FILE).read_text(encoding="utf-8").rstrip()
    save(folder, {REPORT_FILE: f"{report}\n\n{fill('buildings', ranking=ranking)}\n"})


def sensitivity_markdown(found: Sensitivity) -> str:
    """Return the report as Markdown; it names figures and tables as `save_sensitivity` does."""
    points, settings = found.front.points, found.route.settings
    outcomes = found.local.outcomes["value"].groupby("outcome", sort=False).first()
    at = [{"weight": name, **ranges(found, name), "routes": len(found.lines[name].cells)} for name in found.vary]
    text = fill(
        "sensitivity",
        found=found,
        route=found.route,
        start=found.route.lonlat[0],
        goal=found.route.lonlat[-1],
        where=joined(f"{found.route.altitude_m:g} m above ground", settings["time_of_day"]),
        settings=settings,
        limits=constraints_said(settings["limits"]) or "none",
        cost_model=CostModel.from_settings(settings),
        alike=ALIKE,
        ranges=framed(pd.DataFrame(at)),
        note=" ".join(filter(None, (found.route.search.note, *found.route.cautions))),
        costs=framed(found.local.cost.reset_index()),
        outcomes=table(
            ("outcome", "value", "unit"),
            [(outcome_label(str(name)), short(value), outcome_unit(str(name))) for name, value in outcomes.items()],
        ),
        more=MORE - 1,
        clear=CLEAR,
        changes=_changes(found),
        few=FEW_SAMPLES,
        indices=_indices(found),
        triangle=_triangle(found),
        objectives=listed(found.front.objectives),
        ends=framed(points.loc[[points[name].idxmin() for name in found.front.objectives], [*found.front.objectives]]),
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


def _indices(found: Sensitivity) -> str:
    """Return the total Sobol index of each weight for each outcome, beside where the outcome lies."""
    rows = []
    for outcome, reach in found.sobol.spread.iterrows():
        shares = found.sobol.table.loc[str(outcome)][["total", "total_ci"]].to_numpy()
        said = ("" if np.isnan(total) else f"{total:.2f} ± {half:.2f}" for total, half in shares)
        rows.append((outcome_label(str(outcome)), short(reach.lowest), short(reach.highest), *said))
    return table(("outcome", "lowest", "highest", *found.vary), rows)


def _triangle(found: Sensitivity) -> str:
    if found.triangle is None:
        return ""
    total = found.weights[[found.names.index(name) for name in found.triangle_names]].sum()
    return fill(
        "sensitivity_triangle",
        found=found,
        names=listed(found.triangle_names),
        total=total,
        num_routes=len(found.triangle.cells),
        num_clusters=len(found.representatives),
    )
