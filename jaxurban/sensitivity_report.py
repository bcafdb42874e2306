"""report.md of a sensitivity study: what would change the route and what would not, for a reader new to it."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.io.ownfolder import own_folder
from jaxurban.io.store import whole_file
from jaxurban.io.tables import write_tables
from jaxurban.limits import limits_said
from jaxurban.planners.base import CostModel
from jaxurban.plotting.files import write_png
from jaxurban.plotting.sensitivity import LABELS, sensitivity_figures
from jaxurban.studies.outcomes import UNITS
from jaxurban.studies.sensitivity import Sensitivity

ALIKE = 0.05  # routes are much the same where no outcome differs by more than this share
MORE = 1.1  # the change of a weight that the report tells about: 10 %
CLEAR = 2.0  # standard errors from 0
FEW_PLANS = 300  # for Sobol indices: with fewer their intervals mean little
TOP_BUILDINGS = 10


def save_sensitivity(found: Sensitivity, folder: str | Path, overwrite: bool = False) -> list[Path]:
    """Write the report, tables (CSV, Parquet) and figures (PNG) of a study into a folder and return the files.

    Args:
      found: the study.
      folder: where to; made if it is not there.
      overwrite: replace another study in it.

    Raises:
      InputError: the folder cannot be written to, or holds another study or other files.
    """
    folder, route = Path(folder), found.route
    asked = {"route": route.settings, "lonlat": route.lonlat[[0, -1]].tolist(), "weights": found.weights.tolist()}
    asked |= {"vary": found.vary, "factors": found.factors, "triangle": found.triangle_names}
    with own_folder(folder, "sensitivity", json.loads(json.dumps(asked, default=str)), overwrite=overwrite):
        return write_sensitivity(found, folder)


def write_sensitivity(found: Sensitivity, folder: Path) -> list[Path]:
    """Write what `save_sensitivity` writes, into a folder that is held already."""
    files = write_tables(found.tables(), folder / "tables")
    for name, draw in sensitivity_figures(found).items():
        files.append(folder / "figures" / f"{name}.png")
        with whole_file(files[-1]) as scratch:
            write_png(draw(), scratch)
    files.append(folder / "report.md")
    with whole_file(files[-1]) as scratch:
        scratch.write_text(sensitivity_markdown(found), encoding="utf-8")
    return files


def add_buildings(folder: Path, costs: pd.DataFrame) -> None:
    """Add to the report in a folder what `jaxurban.costly_buildings.write_buildings` wrote beside it.

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
    section = "\n\n".join(
        [
            "## Which buildings cost the route most",
            "By how much the route's cost would change if a building were a metre higher, the route kept: a gradient "
            "through soft maps, so that it tells of small changes, and is no forecast of a building's removal.",
            _table(["rank", "cost per metre", "height", "longitude, latitude", "from the route"], rows),
            "![Buildings by what a metre of each costs](buildings/buildings.png)",
            "`buildings/buildings.csv` and `.parquet` list them all, with the parts of gps, lidar and risk.",
        ]
    )
    report = folder / "report.md"
    text = report.read_text(encoding="utf-8")
    with whole_file(report) as scratch:
        scratch.write_text(f"{text.rstrip()}\n\n{section}\n", encoding="utf-8")


def sensitivity_markdown(found: Sensitivity) -> str:
    """Return the report as Markdown; it names figures and tables as `save_sensitivity` does."""
    sections = [
        "# What would change this route, and what would not",
        _answer(found),
        "## The route under the given weights",
        _route(found),
        "## One weight at a time",
        _lines(found),
        "## A small change of each weight",
        _local(found),
        "## All weights at once",
        _sobol(found),
        _triangle(found),
        f"## Trade-offs between {_listed(found.front.wishes)}",
        _front(found),
        "## How to read this, and its limits",
        _limits(found),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def ranges(found: Sensitivity, name: str) -> dict[str, float]:
    """Return where, along a weight's range, the route stays the same, and where much the same (see `ALIKE`).

    ``same_from``, ``same_to``, ``alike_from`` and ``alike_to``, values of the weight, ends of the range included.
    """
    table = found.switches(name)
    outcomes = table[[outcome for outcome in LABELS if outcome in table]]
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


def _answer(found: Sensitivity) -> str:
    low, high = found.factors
    lines = [
        f"Each weight was changed alone, from {low:g} to {high:g} times its value, the others as given. "
        f"Routes are *much the same* where no outcome (length, mean metrics, people) differs by more than {ALIKE:.0%}."
    ]
    for name in found.vary:
        at, weight = ranges(found, name), found.weights[found.names.index(name)]
        if len(found.lines[name].cells) == 1:
            lines.append(f"- **{name}** does not change the route at all.")
            continue
        ends = (at["alike_from"] / weight, at["alike_to"] / weight)
        below = f"below {ends[0]:.3g} times its value" if ends[0] > low * 1.001 else ""
        above = f"above {ends[1]:.4g} times its value" if ends[1] < high * 0.999 else ""
        changes = " or ".join(filter(None, (below, above)))
        said = f"makes it another route {changes}" if changes else "leaves it much the same over the whole range"
        lines.append(
            f"- **{name}** {said} (exactly the same route from {at['same_from']:.4g} to {at['same_to']:.4g}; "
            f"given: {weight:g})."
        )
    return lines[0] + "\n\n" + "\n".join(lines[1:])


def _route(found: Sensitivity) -> str:
    route, settings = found.route, found.route.settings
    start, goal = route.lonlat[0], route.lonlat[-1]
    where = [
        f"From {start[0]:.5f},{start[1]:.5f} to {goal[0]:.5f},{goal[1]:.5f} (longitude, latitude) at "
        f"{route.altitude_m:g} m above ground",
        *([settings["time_of_day"]] if settings["time_of_day"] else []),
        f"{settings['resolution_m']:g} m cells",
        f"cost model {CostModel.from_settings(settings)}",
        *([f"limits: {said}"] if (said := limits_said(settings["limits"])) else []),
        f"obstacles: {settings['obstacles']}",
    ]
    rows = [
        (name, f"{row.weight:g}", f"{row.gradient:.4g}", f"{row.elasticity:.1%}")
        for name, row in zip(found.names, found.local.cost.itertuples(), strict=True)
    ]
    values = found.local.outcomes["value"].groupby("outcome", sort=False).first()
    outcomes = {name: values[name] for name in LABELS if name in values}
    return (
        ", ".join(where)
        + " ".join([f". It is {route.length_m:,.0f} m long and costs {route.cost:,.1f}.", route.search.note]).rstrip()
        + "\n\n"
        + _table(("weight", "value", "derivative of the cost", "share of the cost"), rows)
        + "\n\nThe derivative of the cheapest cost by a weight is what the route adds up of it (metres; the sum of the "
        "metric's cost c), exactly, by the envelope theorem. The share is also the elasticity: the cost grows by so "
        "many percent when the weight grows by one percent.\n\n"
        + _table(("outcome", "value", "unit"), [(LABELS[n], _short(v), UNITS[n]) for n, v in outcomes.items()])
    )


def _lines(found: Sensitivity) -> str:
    rows = []
    for name in found.vary:
        at = ranges(found, name)
        rows.append(
            (
                name,
                f"{found.weights[found.names.index(name)]:g}",
                f"{at['same_from']:.3g} to {at['same_to']:.3g}",
                f"{at['alike_from']:.3g} to {at['alike_to']:.3g}",
                str(len(found.lines[name].cells)),
            )
        )
    head = (
        "weight",
        "given",
        "same route from .. to",
        f"much the same ({ALIKE:.0%}) from .. to",
        "routes in the range",
    )
    return (
        "![Cheapest cost along the range of each weight](figures/switches.png)\n\n"
        + _table(head, rows)
        + "\n\nThe switches are exact: a search at every one of them found nothing cheaper. Many only move the route "
        "by a cell or two. `tables/switches.csv` lists every route with its outcomes.\n\n"
        "![Cheapest routes along the range of each weight](figures/switch_routes.png)"
    )


def _local(found: Sensitivity) -> str:
    table = found.local.outcomes
    outcomes = list(dict.fromkeys(table.index.get_level_values("outcome")))
    rows = []
    for name in found.names:
        cells = []
        for outcome in outcomes:
            row = table.loc[(outcome, name)]
            change = row["expected_slope"] * np.log(MORE) / max(abs(row["expected"]), 1e-12)
            is_clear = abs(row["expected_slope"]) > CLEAR * row["expected_slope_se"]
            cells.append(f"{change:+.1%}" if is_clear else "unclear")
        rows.append((name, *cells))
    return (
        "Between two switches the route, and with it every outcome, does not change at all: the exact derivative is 0. "
        f"What tells is how their mean changes when all weights are uncertain by about {found.local.noise:.0%}. "
        f"For {MORE - 1:.0%} more of each weight:\n\n"
        + _table((f"{MORE - 1:.0%} more of", *[LABELS[outcome] for outcome in outcomes]), rows)
        + f"\n\n*unclear*: within {CLEAR:g} standard errors of 0. `tables/local.csv` holds slopes and errors."
    )


def _sobol(found: Sensitivity) -> str:
    table, spread = found.sobol.table, found.sobol.spread
    low, high = found.factors
    lines = []
    for outcome in spread.index:
        rows = table.loc[outcome]
        reach = " to ".join(_short(spread.loc[outcome, end]) for end in ("lowest", "highest"))
        about = f"**{LABELS[outcome]}** ({reach})"
        if rows["total"].isna().all():
            lines.append(f"- {about} does not vary.")
            continue
        ranked = rows["total"].sort_values(ascending=False)
        parts = [f"{name} {value:.2f} ± {rows.loc[name, 'total_ci']:.2f}" for name, value in ranked.items()]
        lines.append(f"- {about}: {', '.join(parts)}.")
    few = found.sobol.num_evaluations < FEW_PLANS
    together = "The weights vary together and independently, each" if len(found.vary) > 1 else "The weight varies"
    return (
        ("**These are too few plans for such indices: take more `--samples`.**\n\n" if few else "")
        + f"{together} between {low:g} and {high:g} times its value (evenly "
        f"in the logarithm), over {found.sobol.num_evaluations:,} plans. The total Sobol index of a weight is the "
        "share of an outcome's variance that would remain if all other weights were known; 95 % confidence:\n\n"
        + "\n".join(lines)
        + "\n\n![Which weights decide what the route is like](figures/sobol.png)\n\n"
        "First-order indices count what a weight does alone; where the total is much larger, it acts together with "
        "others. Estimates may fall a little below 0 or above 1; more samples narrow them."
    )


def _triangle(found: Sensitivity) -> str:
    if found.triangle is None:
        return ""
    parts, names = found.triangle, _listed(found.triangle_names)
    total = found.weights[[found.names.index(name) for name in found.triangle_names]].sum()
    found_all = (
        f"a search at each of their corners shows that no other route is cheaper anywhere by more than "
        f"{parts.tolerance:.2g} of the cost"
        if parts.is_complete
        else "the limit of searches was reached, so routes may be missing"
    )
    return (
        f"## The weights of {names} against each other\n\n"
        f"{names} share their total of {total:g} in all ways, the others as given. {len(parts.cells)} routes are the "
        f"cheapest somewhere; {found_all}. They are sorted into {len(found.standing)} kinds by their outcomes; the "
        "first is that of the given weights.\n\n"
        "![Cheapest routes over a triangle of weights](figures/triangle.png)\n\n"
        "![Kinds of route over a triangle of weights](figures/triangle_routes.png)"
    )


def _front(found: Sensitivity) -> str:
    front = found.front
    ends = []
    for name in front.wishes:
        best = front.points.iloc[int(front.points[name].argmin())]
        ends.append(f"- least {name}: " + ", ".join(f"{wish} {_short(best[wish])}" for wish in front.wishes))
    limit = "" if front.partition.is_complete else " The limit of searches was reached, so points may be missing."
    return (
        f"{len(front.points)} routes are the best for some weights of {_listed(front.wishes)} alone: none of them "
        f"can be bettered in one without losing in another.{limit}\n\n" + "\n".join(ends) + "\n\n"
        "![Best trade-offs](figures/pareto.png)\n\n"
        "These are the *supported* points: weighted sums find the corners of the front's convex hull and no point "
        f"inside it. Routes never cheaper by more than {front.partition.tolerance:.2g} of the cost are left out."
    )


def _limits(found: Sensitivity) -> str:
    return (
        "- Only the ratios of weights choose a route: doubling all of them changes nothing. The weights that are not "
        "varied are the unit.\n"
        "- Weights vary independently. Shares that must sum to 1 would not: one grows at the others' cost, and Sobol "
        "indices could not tell whose effect it is.\n"
        "- Grid maps have many routes that add up the same; they cost the same under all weights and count as one "
        "route, of which one is drawn.\n"
        "- Routes are those of a grid search over these maps. Other maps (resolution, altitude, time) have others.\n"
        f"- This study took {found.num_plans:,} searches and {found.elapsed_s:.0f} s."
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _short(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _listed(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
