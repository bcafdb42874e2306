"""report.md of a Monte Carlo benchmark of planners, with its tables and figures."""

from collections.abc import Sequence

import pandas as pd

from jaxurban.paths.rows import CRASHED
from jaxurban.report.figures.montecarlo import study_figures
from jaxurban.report.sensitivity_study import weights_said
from jaxurban.report.write import Written, fill, joined_with_and, study_outputs
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.montecarlo import analysis
from jaxurban.studies.montecarlo.study import BenchmarkResult


def benchmark_outputs(result: BenchmarkResult) -> Written:
    """Return what a benchmark writes, by file name: report, tables (CSV) and figures; and no settings.

    Settings would guard a folder against other ones; here the rows alone decide what is written.
    """
    tables = tables_of(result)
    figures = study_figures(result.maps, result.table, tables)
    report = report_markdown(result, tables, list(figures))
    files = {f"{name}.csv": table for name, table in tables.items()}
    return study_outputs(report, files, figures), {}


def tables_of(result: BenchmarkResult) -> dict[str, pd.DataFrame]:
    """Return the tables of a study by name.

    ``complementarity``, which compares GPS with lidar, is among them only where the maps hold both.
    """
    table = result.table
    tables = {
        "choices": analysis.choices(table),
        "success": analysis.success(table),
        "costs": analysis.costs(table),
        "paired": analysis.paired(table),
        "times": analysis.times(table),
        "usage": analysis.usage(table),
        "objectives": analysis.objectives(table),
    }
    if set(analysis.SENSORS) <= set(result.maps.metrics):
        altitudes_m = sorted(table.altitude_m.unique())
        complementarity = analysis.complementarity(result.maps, altitudes_m=altitudes_m)
        tables["complementarity"] = complementarity
    return tables


def report_markdown(
    result: BenchmarkResult, tables: dict[str, pd.DataFrame], figures: Sequence[str] = ()
) -> str:
    """Return the report as Markdown.

    Args:
      result: of the study.
      tables: from `tables_of`.
      figures: names of the pictures that lie beside the report.
    """
    # The shares of joined pairs that were solved: a row per planner and range, a column per altitude.
    success = tables["success"]
    solved = success.pivot(index=["planner", "range"], columns="altitude_m", values="share_joined")
    names = sorted(success.planner.unique()), analysis.range_names(success)
    solved = solved.reindex(pd.MultiIndex.from_product(names, names=solved.index.names))
    solved = solved.rename(columns=lambda z: f"{z:g} m").reset_index()

    # The share of pairs of places that some path joins, by altitude, and the budget of a run in words.
    table = result.table
    settings = result.settings
    study = settings.study
    pairs = table.drop_duplicates(["instance", "altitude_m"])
    share_joined = pairs.groupby("altitude_m").is_joined.mean()
    budget = f"{study.budget_iterations} samples, others to their end"
    if study.budget_iterations is None:
        budget = f"{study.budget_s:g} s a run"
    return fill(
        "study",
        {**tables, "success": solved},
        figures,
        [result.maps.attribution],
        num_instances=table.instance.nunique(),
        num_runs=len(table),
        planners=joined_with_and(sorted(table.planner.unique())),
        grid=result.maps.grid,
        budget=budget,
        settings=settings,
        maps=result.maps,
        weights=weights_said(result.instances),
        constraints=str(settings.constraints) or "none",
        joined=joined_with_and(f"{share:.1%} at {z:g} m" for z, share in share_joined.items()),
        num_crashed=(table.status == CRASHED).sum(),
        num_odd=table.status.isin(["invalid", "bad-input"]).sum(),
        fewest=FEWEST_GROUPS,
        analysis=analysis,
    )
