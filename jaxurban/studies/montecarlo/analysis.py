"""What a Monte Carlo benchmark says: tables, each a DataFrame that a reader can check.

All take the rows joined with their instances (`with_instances`). A path's *ratio* is its cost over the cheapest one
that any planner found for the same instance at the same altitude, under the benchmark's cost model.
"""

import math
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights
from jaxurban.paths.queries import IN_METRES, WEIGHT_PREFIX
from jaxurban.paths.rows import BAD_INPUT, CRASHED, HAS_PATH
from jaxurban.planners.base import Status
from jaxurban.planners.registry import EXACT_PLANNERS
from jaxurban.statistics.bootstrap import Clusters, Interval, named
from jaxurban.statistics.conclusions import Conclusion, Verdict, concluded
from jaxurban.studies.baseline import SHORTEST, baseline_verdicts
from jaxurban.studies.decided import (
    Measure,
    Ranking,
    border_verdict,
    effects,
    ended_sides,
    ranked,
    wider_bounds,
)
from jaxurban.studies.montecarlo.sampling import KEY
from jaxurban.studies.montecarlo.trial import DISTANCE, WEIGHTED
from jaxurban.studies.queries import ends_option, weights_option

FEWEST_SOLVED = 0.5  # of the joined pairs: planners that solve fewer are ranked by cost apart
ON_FEW = "cost where all find a path"
OF_LENGTH = f"{WEIGHT_PREFIX}distance"  # the weight of a metre


def with_instances(rows: pd.DataFrame, instances: pd.DataFrame) -> pd.DataFrame:
    """Return every row with its instance's columns and ``has_path``, ``is_joined``, ``ratio`` and ``range``.

    ``is_joined`` says that some path joins the pair of places: a planner found one, or no planner proved that there is
    none. A pair with a place that is not free on these maps (``bad-input``) is not joined. ``ratio`` is the path's cost
    over the cheapest one of the same instance and altitude, NaN without a path. ``range`` is ``"any"`` where the
    instances have none.

    Args:
      rows: of a benchmark, one per planner, objective, instance and altitude.
      instances: of the same benchmark.
    """
    wanted = [*KEY, "range", "start_stratum", "goal_stratum", "time_of_day", "distance_m"]
    table = rows.merge(instances.filter(wanted), on=KEY, validate="many_to_one")
    table["range"] = table.get("range", pd.Series(index=table.index)).astype(object).fillna("any")
    table["has_path"] = table.status.isin(HAS_PATH)

    # What any planner, or all of them, say of a pair at an altitude.
    pairs = [table[name] for name in KEY]
    is_reached = table.has_path.groupby(pairs).transform("any")
    is_refuted = (table.status == Status.NO_PATH.value).groupby(pairs).transform("any")
    is_bad = (table.status == BAD_INPUT).groupby(pairs).transform("all")
    table["is_joined"] = (is_reached | ~is_refuted) & ~is_bad

    # The best path has the ratio 1 even if it costs nothing, where there is nothing to divide by.
    best = table.cost.groupby(pairs).transform("min")
    ratio = table.cost / best.where(best > 0)
    ratio = ratio.where(table.cost != best, 1.0)
    table["ratio"] = ratio.where(table.has_path)
    return table


def fact_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns of a path's length and of the mean of each metric along it."""
    return ["length_m", *(name for name in map(str, table.columns) if name.startswith("m_"))]


def weighted_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the weighted objective."""
    return table[table.objective == WEIGHTED]


def success(table: pd.DataFrame) -> pd.DataFrame:
    """Return for how many pairs each planner found a path, a row per planner, altitude and range, and for all ranges.

    ``pairs``, ``paths``, ``joined`` and ``crashed`` are counts. ``solved`` is the percentage of the pairs that some
    path joins for which the planner found one (NaN if there is none), and ``proven`` that of all pairs with the
    status optimal. ``no_way``, ``blocked`` and ``budget`` count the pairs without a path for their reason: it is proven
    that there is none, the straight line meets an obstacle, the budget ended. ``gap`` is by how many
    percent a path may cost more than the cheapest of its planner's graph, on average and by the planner's lower bound:
    0 where all are proven.

    Args:
      table: from `with_instances`; only runs of the weighted objective count.
    """
    rows = weighted_rows(table)
    gap = rows.gap.astype(float)
    rows = rows.assign(
        proven=rows.status == Status.OPTIMAL.value,
        has_crashed=rows.status == CRASHED,
        no_way=rows.status == Status.NO_PATH.value,
        blocked=rows.status == Status.BLOCKED.value,
        budget=rows.status == Status.BUDGET_EMPTY.value,
        gap=gap.where(rows.has_path & np.isfinite(gap)),
    )
    if rows["range"].nunique() > 1:
        rows = pd.concat([rows, rows.assign(range="all")])
    grouped = rows.groupby(["planner", "altitude_m", "range"], sort=True)
    result = grouped.agg(
        pairs=("has_path", "size"), paths=("has_path", "sum"), joined=("is_joined", "sum")
    )
    result["solved"] = 100 * result.paths / result.joined.where(result.joined > 0)
    result["proven"] = 100 * grouped.proven.mean()
    result["gap"] = 100 * grouped.gap.mean()
    reasons = grouped[["no_way", "blocked", "budget"]].sum()
    return result.join(reasons).assign(crashed=grouped.has_crashed.sum()).reset_index()


def costs(table: pd.DataFrame) -> pd.DataFrame:
    """Return by how many percent paths cost more than the cheapest known ones, a row per planner and altitude.

    ``runs`` counts those that found a path; ``cheapest`` is the percentage of them that are the cheapest known;
    ``above_median``, ``above_p95`` and ``above_most`` are quantiles of what they cost more.

    Args:
      table: from `with_instances`; only runs of the weighted objective count.
    """
    rows = weighted_rows(table)
    rows = rows[rows.has_path & rows.ratio.notna()]
    rows = rows.assign(more=100 * (rows.ratio - 1), is_cheapest=np.isclose(rows.ratio, 1.0))
    grouped = rows.groupby(["planner", "altitude_m"])
    result = grouped.agg(
        runs=("more", "size"),
        above_median=("more", "median"),
        above_p95=("more", lambda more: more.quantile(0.95)),
        above_most=("more", "max"),
    )
    result.insert(1, "cheapest", 100 * grouped.is_cheapest.mean())
    return result.reset_index()


def times(table: pd.DataFrame) -> pd.DataFrame:
    """Return seconds, expansions and samples of each planner, a row per planner and altitude.

    ``runs`` counts the runs that found a path, as refusing a pair takes no search; the other columns are quantiles over
    them, NaN where a planner counts neither expansions nor samples.

    Args:
      table: from `with_instances`; only runs of the weighted objective count.
    """
    rows = weighted_rows(table).astype({"num_expanded": float, "num_samples": float})
    grouped = rows[rows.has_path].groupby(["planner", "altitude_m"])
    return grouped.agg(
        runs=("elapsed_s", "size"),
        median_s=("elapsed_s", "median"),
        p95_s=("elapsed_s", lambda seconds: seconds.quantile(0.95)),
        median_expanded=("num_expanded", "median"),
        median_samples=("num_samples", "median"),
    ).reset_index()


def objectives(table: pd.DataFrame) -> pd.DataFrame:
    """Return what it costs to fly the shortest path instead of the cheapest one, a row per planner and altitude.

    Distance-only runs are compared with weighted runs of the same planner: ``cost_change`` in percent,
    ``length_m_change`` in metres and ``m_NAME_change`` are means of distance-only less weighted, each with its 95 %
    interval over instances. Exact planners of the grid (`EXACT_PLANNERS`) may take each other's shortest paths. The
    table is empty where no planner found paths both ways.

    Args:
      table: from `with_instances`.
    """
    # Of each planner its pairs of places that were solved under both objectives, by altitude.
    result = []
    of_distance = {*table[table.objective == DISTANCE].planner}
    for planner in sorted({*weighted_rows(table).planner}):
        shortest = {planner} & of_distance
        if planner in EXACT_PLANNERS and not shortest:
            shortest = {*sorted(of_distance & {*EXACT_PLANNERS})[:1]}
        is_weighted = (table.planner == planner) & (table.objective == WEIGHTED)
        is_shortest = table.planner.isin(shortest) & (table.objective == DISTANCE)
        paths = table[(is_weighted | is_shortest) & table.has_path]
        if {*paths.objective} != {WEIGHTED, DISTANCE}:
            continue
        rows = paths.set_index([*KEY, "objective"])
        wide = rows[["cost", *fact_columns(rows)]].unstack("objective")
        for altitude_m, runs in wide.groupby(level="altitude_m"):
            has_both = runs["cost"].notna().all(axis=1) & (runs["cost"] > 0).all(axis=1)
            pairs = runs[has_both]
            row = {"planner": planner, "altitude_m": altitude_m, "pairs": len(pairs)}
            is_exact = planner in EXACT_PLANNERS
            result.append(row | _changes(pairs.astype(float), is_exact))
    return pd.DataFrame(result)


def _changes(pairs: pd.DataFrame, is_exact: bool) -> dict[str, float]:
    """Return how the shortest paths differ from the cheapest ones: means with intervals that hold at once.

    Each is a column ``NAME_change``, that of the cost in percent. A number that some path lacks has none.

    Args:
      pairs: a row per instance, indexed by `KEY`; columns of two levels, a number of a path and the objective.
      is_exact: no other path costs less than the cheapest one or is shorter than the shortest one, and so no interval
        goes beyond 0 there.
    """
    names = pairs.columns.unique(0)
    changes = pd.DataFrame({name: pairs[name, DISTANCE] - pairs[name, WEIGHTED] for name in names})
    changes["cost"] *= 100 / pairs["cost", WEIGHTED]
    changes = changes.dropna(axis=1)
    table = effects(changes, Clusters(pairs.index.get_level_values("instance")))
    if is_exact:
        table.loc["cost", "low"] = table.low.clip(0)["cost"]
        table.loc["length_m", "high"] = table.high.clip(upper=0)["length_m"]
    columns: dict[str, float] = {}
    rows: Any = table.itertuples()
    for row in rows:
        columns |= named(f"{row.Index}_change", Interval(row.size, row.low, row.high))
    return columns


class StudyVerdict(Enum):
    """What a benchmark decides of two planners, by each measure of `rankings`."""

    FAILS = "{first} finds no path for {size} of the joined pairs ({n})"
    COSTS_MORE = "{last} costs {size} more than {first} ({n})"
    FINDS_LESS = "{last} finds a path for {size} fewer of the joined pairs than {first} ({n})"
    COST_TIED = (
        "{what} cannot be told apart in {measure} ({last} costs {size} more than {first}, {n})"
    )
    FINDS_TIED = (
        "{what} cannot be told apart in {measure} "
        "({last} finds a path for {size} fewer than {first}, {n})"
    )
    ALONE = "there is nothing to compare, as {first} is the only planner"


OF_COST = StudyVerdict.COSTS_MORE, "instances that all of these solve", StudyVerdict.COST_TIED
KINDS = {  # of each measure: where two planners differ, what runs are, and where they cannot be told apart
    "cost": OF_COST,
    ON_FEW: OF_COST,
    "pairs solved": (StudyVerdict.FINDS_LESS, "joined instances", StudyVerdict.FINDS_TIED),
}


def rankings(table: pd.DataFrame) -> dict[str, Ranking]:
    """Return the planners in groups of ranks by ``"cost"`` and by ``"pairs solved"``.

    Costs are compared by their ratio on the pairs that all planners solved, in percent; pairs solved in percentage
    points of the joined pairs. Planners that solve fewer than `FEWEST_SOLVED` of these are ranked by cost in a measure
    of its own, `ON_FEW`, as the few pairs that they solve say nothing of the others. All intervals hold at once;
    instances are drawn, with all their altitudes. Without a joined pair there is no rank.

    Args:
      table: from `with_instances`; only runs of the weighted objective count.
    """
    rows = _joined_rows(table)
    if rows.empty:
        return {}
    costs = rows.cost.where(rows.has_path & (rows.cost > 0)).unstack("planner")
    percent = 100.0 * rows.has_path.unstack("planner").astype(float)
    few = [each.what[0] for each in failing(table)]
    common = costs.drop(columns=few).dropna()
    measures = {
        "cost": Measure(common.reindex(costs.index), is_ratio=True),
        "pairs solved": Measure(percent, "percentage points", is_better_high=True, largest=100.0),
    }
    solved_by_all = costs.dropna()
    if few and len(solved_by_all):
        measures[ON_FEW] = Measure(solved_by_all.reindex(costs.index), is_ratio=True)
    return ranked(measures, Clusters(costs.index.get_level_values("instance")))


def _joined_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the weighted objective between joined pairs, by `KEY` and planner."""
    rows = weighted_rows(table)
    return rows[rows.is_joined].set_index([*KEY, "planner"])


def failing(table: pd.DataFrame) -> list[Verdict]:
    """Return how often each planner fails that solves fewer than `FEWEST_SOLVED` of the joined pairs.

    Empty where all planners do.

    Args:
      table: from `with_instances`.
    """
    lost = 1 - _joined_rows(table).has_path.unstack("planner").astype(float)
    few = lost.loc[:, lost.mean() > 1 - FEWEST_SOLVED]
    if few.shape == lost.shape:
        return []
    clusters = Clusters(lost.index.get_level_values("instance"))
    verdicts = []
    for name, is_lost in few.items():
        share = 100 * np.array(clusters.interval(is_lost, "share"))
        about = *share, clusters.num_groups, "%", "joined instances"
        verdicts.append(Verdict(StudyVerdict.FAILS, (str(name),), *about))
    return verdicts


def best_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Return the row of the cheapest path of each pair of places that has one; rows of the weighted objective."""
    rows = weighted_rows(table)
    rows = rows[rows.has_path & rows.cost.notna()]
    return rows.loc[rows.groupby(KEY).cost.idxmin()]


def beside_baseline(table: pd.DataFrame, instances: pd.DataFrame) -> list[Verdict]:
    """Return how much less exposure the cheapest grid paths have than the shortest ones; nothing without both.

    Only exact planners of the grid count (`EXACT_PLANNERS`), whose paths are the cheapest of one graph.

    Args:
      table: from `with_instances`.
      instances: of the benchmark, for the weight of the distance.
    """
    exact = table[table.planner.isin(EXACT_PLANNERS) & table.has_path]
    paths = exact.drop_duplicates([*KEY, "objective"]).merge(instances[[*KEY, OF_LENGTH]], on=KEY)
    exposure = paths.cost - paths[OF_LENGTH] * paths.length_m
    columns = [*KEY, "length_m", "exposure"]
    by_objective = paths.assign(exposure=exposure).groupby("objective")[columns]
    found = {str(objective): part.set_index(KEY) for objective, part in by_objective}
    if found.keys() != {WEIGHTED, DISTANCE}:
        return []
    both = found[WEIGHTED].join(found[DISTANCE].add_prefix(SHORTEST), how="inner")
    pairs = both.index.get_level_values("instance")
    return list(baseline_verdicts(both, pairs, "instances that a grid path joins"))


def conclusion(
    table: pd.DataFrame,
    instances: pd.DataFrame,
    maps: MetricMaps,
    again: str,
    wider: str,
    rules: str = "",
) -> Conclusion:
    """Return what a benchmark decided: the planners' ranks, and how many routes the border may have made.

    Args:
      table: from `with_instances`.
      instances: of the benchmark.
      maps: of the benchmark.
      again: command of the same benchmark, which ends in its folder; empty: that of the maps' scenario.
      wider: command of a benchmark of the same instances, over maps whose bounds are still to be named.
      rules: options of its constraints.
    """
    verdicts = failing(table)
    rankings_of = rankings(table)
    for measure, ranking in rankings_of.items():
        verdicts += ranking.verdicts(*KINDS[measure])
    verdicts += beside_baseline(table, instances)
    planners = table.planner.unique()
    if len(planners) == 1:
        verdicts.append(Verdict(StudyVerdict.ALONE, (str(planners[0]),), needed=math.nan))
    best = best_rows(table)
    verdicts += border_verdict(best.at_edge.to_numpy() == 1, ended=ended_sides(maps))
    planner = str(table.planner.iloc[0])
    if rankings_of:
        planner = rankings_of["cost"].names[0].partition(" = ")[0]
    folder = maps.folder or "DIR"
    again = again or f"jaxurban study {maps.folder or 'SCENARIO'} -o {folder}"
    solved = instances.merge(best[KEY], on=KEY)
    first = (instances if solved.empty else solved).iloc[0]
    of_first = first.filter(like=WEIGHT_PREFIX).rename(
        lambda name: name.removeprefix(WEIGHT_PREFIX)
    )
    weights = weights_option(Weights(**of_first.astype(float)), maps.metrics)
    ends = ends_option(maps.grid, first[[*IN_METRES]].to_numpy(float).reshape(2, 2))
    bounds = wider_bounds(maps)
    more = "--set study.instances="
    return concluded(
        verdicts,
        more=f"{again} {more}{{needed}}",
        wider=bounds and f'{wider} --set "region.bounds={bounds}"',
        done=f"jaxurban plan {folder} {ends} --altitude {first.altitude_m:g} {rules}--planner {planner} "
        f"--weights {weights}",
        ran=table.instance.nunique(),
    )
