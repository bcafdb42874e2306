"""report.md of a Monte Carlo benchmark of planners, with its tables and figures."""

from functools import partial
from typing import Unpack

import pandas as pd
from matplotlib.figure import Figure

from jaxurban.draw.paths import plot_paths
from jaxurban.draw.write import Figures, ResultReport, bullets, joined_with_and
from jaxurban.knowledge import names_of
from jaxurban.metrics.base import ones_said
from jaxurban.paths.batch import plan_many
from jaxurban.paths.rows import CRASHED
from jaxurban.pictures import MapForm
from jaxurban.planners.registry import PLANNERS
from jaxurban.statistics.bootstrap import FEWEST_GROUPS
from jaxurban.studies.baseline import baseline_said
from jaxurban.studies.decided import FEWEST_RUNS
from jaxurban.studies.figures.montecarlo import plot_costs
from jaxurban.studies.montecarlo import analysis
from jaxurban.studies.montecarlo.sampling import KEY, query_columns
from jaxurban.studies.montecarlo.study import BenchmarkResult
from jaxurban.studies.reports.sensitivity import weights_said

# The column of each table that counts runs.
COUNTS = {"success": "joined", "costs": "runs", "times": "runs", "objectives": "pairs"}
NO_BASELINE = (
    "planners are compared with each other alone, as no A* planned both the cheapest and the shortest paths "
    "(study.planners, study.distance_only)"
)
NUM_DRAWN = 4  # routes of a picture


def border_figure(result: BenchmarkResult, pinned: pd.DataFrame, **form: Unpack[MapForm]) -> Figure:
    """Return the cheapest grid routes of the first `NUM_DRAWN` pairs of places at the lowest altitude.

    Args:
      result: of the study.
      pinned: rows whose paths come near the border.
      form: see `MetricMaps.plot`.
    """
    drawn = pinned[pinned.altitude_m == pinned.altitude_m.min()].head(NUM_DRAWN)
    rules = result.settings
    columns = ["altitude_m", *query_columns(result.instances.columns)]
    queries = result.instances.merge(drawn[KEY])[columns]
    paths = plan_many(
        result.maps,
        queries.drop(columns="crs"),
        cost_model=rules.cost_model,
        constraints=rules.constraints,
        planner="astar",
        progress=False,
    )
    names = [f"instance {each}" for each in drawn.instance]
    return plot_paths(result.maps, paths, names=names, **form)


def tables_of(result: BenchmarkResult) -> dict[str, pd.DataFrame]:
    """Return the tables of a study by name."""
    table = result.table
    tables = {
        "success": analysis.success(table),
        "costs": analysis.costs(table),
        "times": analysis.times(table),
        "objectives": analysis.objectives(table),
    }
    rankings = analysis.rankings(table).values()
    if rankings:
        tables["ranks"] = pd.concat(each.table for each in rankings)
        tables["pairs"] = pd.concat(each.pairs.assign(measure=each.measure) for each in rankings)
    return tables


def benchmark_report(result: BenchmarkResult) -> ResultReport:
    """Return what a benchmark writes."""
    table = result.table
    settings = result.settings
    study = settings.study
    figures: Figures = {}
    weighted = analysis.weighted_rows(table)
    if weighted.has_path.any() and weighted.is_joined.any():
        figures["costs"] = partial(plot_costs, weighted[weighted.is_joined])
    best = analysis.best_rows(table)
    if (best.at_edge == 1).any():
        figures["border"] = partial(border_figure, result, best[best.at_edge == 1])

    # The report shows what has enough runs.
    tables = tables_of(result)
    shown = dict(tables)
    for name, num in COUNTS.items():
        if len(shown[name]):
            shown[name] = shown[name].query(f"{num} >= {FEWEST_RUNS}")

    # The share of pairs of places that some path joins, by altitude, and the budget of a run in words.
    pairs = table.drop_duplicates(["instance", "altitude_m"])
    share_joined = pairs.groupby("altitude_m").is_joined.mean()
    budget = f"{study.budget_iterations} samples, others to their end"
    if study.budget_iterations is None:
        budget = f"{study.budget_s:g} s a run"
    planners = sorted(table.planner.unique())
    fields = {
        "tables": shown,
        "credits": [result.maps.attribution],
        "legend": ones_said(result.maps.metrics),
        "guessed": [names_of(result.maps.guesses)],
        "num_instances": table.instance.nunique(),
        "num_runs": len(table),
        "num_shortest": len(table) - len(weighted),
        "num_all_solve": weighted.groupby(KEY).has_path.all().groupby("instance").any().sum(),
        "planners": bullets(f"{name}: {PLANNERS[name].summary}" for name in planners),
        "grid": result.maps.grid,
        "budget": budget,
        "settings": settings,
        "maps": result.maps,
        "weights": weights_said(result.instances, [result.maps]),
        "constraints": str(settings.constraints) or "none",
        "joined": joined_with_and(f"{share:.1%} at {z:g} m" for z, share in share_joined.items()),
        "baseline": baseline_said(result.decided) or NO_BASELINE,
        "num_crashed": (table.status == CRASHED).sum(),
        "num_odd": table.status.isin(["invalid", "bad-input"]).sum(),
        "fewest": FEWEST_GROUPS,
        "fewest_runs": FEWEST_RUNS,
    }
    files = {f"{name}.csv": table for name, table in tables.items()}
    key = settings.deciding(result.maps)
    return ResultReport(
        "studies/templates/study", fields, files, figures, key=key, decided=result.decided
    )
