"""The report of a Monte Carlo benchmark: tables and figures under one folder."""

import re
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from jaxurban.io.workspace import Workspace
from jaxurban.report.figures.montecarlo import study_figures
from jaxurban.report.run_montecarlo import BenchmarkResult
from jaxurban.report.sensitivity_study import weights_said
from jaxurban.report.write import Output, counted, fill, framed, listed, save
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.montecarlo import analysis
from jaxurban.studies.montecarlo.complementarity import complementarity
from jaxurban.studies.montecarlo.trial import CRASHED

REPORT_FILE, TABLES, FIGURES = "report.md", "tables", "figures"
SECTIONS = {  # title of each table, and what it says
    "choices": (
        "Which planner, when",
        "`cheapest`: least mean cost over the cheapest known, among planners that solve at least "
        f"{analysis.RELIABLE:.0%} of the joined pairs. `fastest_near_best`: least median time among those within 5 % "
        "of the cheapest on nine of ten pairs. `straight_enough`: share of pairs whose straight line is free and "
        f"within {analysis.NEAR - 1:.0%}.",
    ),
    "success": (
        "How often a path is found",
        "Share of the pairs that some path joins, by planner, range and altitude.",
    ),
    "surroundings": (
        "Where it starts and ends",
        "Share of joined pairs that each planner solves at the lowest altitude, each pair in both of its strata.",
    ),
    "costs": (
        "Cost",
        "Cost over the cheapest path known, where a path is found; `best_share` of them are within 1 %. A path may be "
        "`optimal` and above 1: it is the cheapest on its planner's grid, and another is off it.",
    ),
    "paired": (
        "Planners two by two",
        "`cost_ratio`: first over second, on the pairs that both solved. Where its interval holds 1, no difference is "
        "shown.",
    ),
    "times": ("Time", "Search times, of the machine that ran the benchmark, with its other load."),
    "usage": (
        "Metrics along the paths",
        "Means over the instances that all of these planners solved; planners that answer fewer than four joined pairs "
        "in five are left out.",
    ),
    "objectives": (
        "Shortest path against cheapest path",
        "`cost_ratio` and `length_ratio`: the shortest path's cost and length over those of the cheapest, by planner.",
    ),
    "complementarity": (
        "GPS and lidar",
        "Over the free cells: mean m, the correlation of m_gps and m_lidar with its interval, m_lidar where GPS is "
        "poor (m < 0.5) and elsewhere, and the shares of cells where GPS, lidar, or either serves (m >= 0.5). They "
        "complement each other where the correlation is below 0 and lidar is good where GPS is poor.",
    ),
}


def tables_of(result: BenchmarkResult) -> dict[str, pd.DataFrame]:
    """Return the tables of a study by name; complementarity only where the maps hold gps and lidar."""
    table = result.table
    tables = {
        "choices": analysis.choices(table),
        "success": analysis.success(table),
        "surroundings": analysis.surroundings(table),
        "costs": analysis.costs(table),
        "paired": analysis.paired(table),
        "times": analysis.times(table),
        "usage": analysis.usage(table),
        "objectives": analysis.objectives(table),
    }
    if {"gps", "lidar"} <= set(result.maps.metrics):
        tables["complementarity"] = complementarity(result.maps, altitudes_m=sorted(table.altitude_m.unique()))
    return tables


def write_analysis(result: BenchmarkResult, folder: str | Path) -> Path:
    """Write report.md with its tables (CSV) and figures (PNG) under ``folder`` and return the report's file.

    Raises:
      InputError: the folder cannot be written to, or holds files that this did not write, or that were changed since.
    """
    tables = tables_of(result)
    figures = study_figures(result.maps, result.table, tables)
    outputs: dict[str, Output] = {f"{TABLES}/{name}.csv": table for name, table in tables.items()}
    outputs |= {f"{FIGURES}/{name}.png": draw for name, draw in figures.items()}
    with Workspace.open(Path(folder), "study"):
        return save(folder, {**outputs, REPORT_FILE: report_markdown(result, tables, list(figures))})[-1]


def report_markdown(result: BenchmarkResult, tables: dict[str, pd.DataFrame], figures: Sequence[str] = ()) -> str:
    """Return the report; ``figures`` are the names of the pictures beside it."""
    table, settings = result.table, result.settings
    sections = []
    for name, (title, meaning) in SECTIONS.items():
        if name not in tables or tables[name].empty:
            continue
        picture = [f"![{title}]({FIGURES}/{name}.png)"] if name in figures else []
        sections += [f"## {title}", meaning, *picture, framed(_shown(name, tables[name]))]
    joined = table.drop_duplicates(["instance", "altitude_m"]).groupby("altitude_m").is_joined.mean()
    text = fill(
        "study",
        instances=counted(table.instance.nunique(), "instance"),
        altitudes=listed(f"{z:g} m" for z in joined.index),
        num_runs=len(table),
        planners=listed(sorted(table.planner.unique())),
        grid=result.maps.grid,
        budget=f"{settings.budget_s:g} s a run"
        if settings.budget_iterations is None
        else f"{settings.budget_iterations} samples a run, other planners to their end",
        settings=settings,
        maps=result.maps,
        weights=weights_said(result.instances),
        constraints=f"\n- Constraints: {said}." if (said := str(settings.constraints)) else "",
        joined=listed(f"{share:.1%} at {z:g} m" for z, share in joined.items()),
        num_crashed=(table.status == CRASHED).sum(),
        num_odd=table.status.isin(["invalid", "bad-input"]).sum(),
        fewest=FEWEST_GROUPS,
        sections="\n\n".join(sections),
    )
    return f"{text}\n"


SHOWN = {
    "paired": ["first", "second", "both", "only_first", "only_second", "cost_ratio", "low", "high", "time_ratio"],
    "complementarity": [
        "altitude_m", "gps", "lidar", "correlation", "correlation_low", "correlation_high", "gps_poor",
        "lidar_where_gps_poor", "lidar_where_gps_good", "gps_serves", "lidar_serves", "either_serves",
    ],
    "objectives": ["planner", "altitude_m", "pairs", "cost_ratio", "length_ratio"],
}  # fmt: skip


def _shown(name: str, table: pd.DataFrame) -> pd.DataFrame:
    """Return what the report shows of a table; the CSV holds all."""
    if name == "success":
        shares = table.pivot(index=["planner", "range"], columns="altitude_m", values="share_joined")
        ranges = analysis.range_names(table)
        shares = shares.reindex([(planner, each) for planner in sorted(table.planner.unique()) for each in ranges])
        return shares.rename(columns=lambda z: f"{z:g} m").reset_index()
    if name == "surroundings":
        low = table[table.altitude_m == table.altitude_m.min()]
        return low.pivot(index=["stratum", "pairs"], columns="planner", values="share").reset_index()
    wanted = SHOWN.get(name)
    if name == "objectives":
        changes = [column for column in map(str, table.columns) if re.fullmatch(r"m_\w+_change", column)]
        wanted = [*SHOWN[name], *changes]
    return table if wanted is None else table[[column for column in wanted if column in table]]
