"""The report of a Monte Carlo benchmark: tables, figures, and the sentence that each supports, under one folder."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.io.workspace import Workspace
from jaxurban.planners.base import Status
from jaxurban.report.figures.montecarlo import study_figures
from jaxurban.report.markdown import bullets, counted, fill, framed, listed
from jaxurban.report.run_montecarlo import BenchmarkResult
from jaxurban.report.save import Output, save
from jaxurban.report.sensitivity_study import weights_said
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.montecarlo import analysis
from jaxurban.studies.montecarlo.analysis import each
from jaxurban.studies.montecarlo.complementarity import complementarity, findings, verdict
from jaxurban.studies.montecarlo.trial import CRASHED

REPORT_FILE, TABLES, FIGURES = "report.md", "tables", "figures"


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
    writers: dict[str, tuple[str, Callable[[pd.DataFrame, pd.DataFrame], str]]] = {
        "choices": ("Which planner, when", _choices_text),
        "success": ("How often a path is found", _success_text),
        "surroundings": ("Where it starts and ends", _surroundings_text),
        "costs": ("Cost", _costs_text),
        "paired": ("Planners two by two", _paired_text),
        "times": ("Time", _times_text),
        "usage": ("Metrics along the paths", _usage_text),
        "objectives": ("Shortest path against cheapest path", _objectives_text),
        "complementarity": ("GPS and lidar", _complementarity_text),
    }
    sections = []
    for name, (title, write) in writers.items():
        if name not in tables or tables[name].empty:
            continue
        picture = [f"![{title}]({FIGURES}/{name}.png)"] if name in figures else []
        sections += [f"## {title}", write(tables[name], table), *picture, framed(_shown(name, tables[name]))]
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


def _choices_text(choices: pd.DataFrame, table: pd.DataFrame) -> str:
    best = choices.cheapest[choices.cheapest != "none"]
    straight = choices.straight_enough.dropna()
    parts = []
    if len(best):
        name, times = best.value_counts().index[0], best.value_counts().iloc[0]
        parts.append(f"**`{name}` is the cheapest reliable planner in {times} of {len(choices)} cells of this table.**")
    if len(straight):
        parts.append(
            f"The straight line is there and within {analysis.NEAR - 1:.0%} of the cheapest path for "
            f"{straight.min():.0%} to {straight.max():.0%} of the pairs, cell by cell (`straight_enough`)."
        )
    parts.append(
        f"Reliable: solves at least {analysis.RELIABLE:.0%} of the joined pairs. `cheapest`: least mean cost over the "
        "cheapest known. `fastest_near_best`: least median time among those within 5 % of the cheapest on nine of ten "
        "pairs."
    )
    return " ".join(parts)


def _success_text(success: pd.DataFrame, table: pd.DataFrame) -> str:
    by = success.groupby("planner")[["paths", "joined"]].sum()
    share = (by.paths / by.joined).sort_values(ascending=False)
    low = success[success.altitude_m == success.altitude_m.min()].groupby("planner")[["paths", "joined"]].sum()
    low_share = (low.paths / low.joined).reindex(share.index)
    found = listed(f"`{name}` solves {value:.0%}" for name, value in share.items())
    if success.altitude_m.nunique() == 1:
        return f"**Of the pairs that some path joins, {found}.**"
    order = " in the same order" if len(share) > 1 else ""
    shares = listed(f"{value:.0%}" for value in low_share)
    return f"**Of the pairs that some path joins, {found}; at {success.altitude_m.min():g} m {shares}{order}.**"


def _surroundings_text(found: pd.DataFrame, table: pd.DataFrame) -> str:
    low = found[found.altitude_m == found.altitude_m.min()]
    share = low.groupby("stratum").share.mean().sort_values()
    return (
        f"**At {low.altitude_m.iloc[0]:g} m the hardest places to start from or to reach are *{share.index[0]}* ones, "
        f"where the planners solve {share.iloc[0]:.0%} of the joined pairs on average, the easiest "
        f"*{share.index[-1]}* ones ({share.iloc[-1]:.0%}).** Shares at that altitude, each pair counted in both of its "
        "strata:"
    )


def _costs_text(costs: pd.DataFrame, table: pd.DataFrame) -> str:
    rows = analysis.weighted_rows(table)
    rows = rows[rows.has_path]
    median = rows.groupby("planner").ratio.median().sort_values()
    best = rows.groupby("planner").ratio.apply(lambda ratio: (ratio <= analysis.CLOSE).mean()).reindex(median.index)
    shares = zip(median.items(), best, strict=True)
    found = listed(f"`{name}` {value:.3f} (within 1 % on {share:.0%})" for (name, value), share in shares)
    return (
        f"**Where it finds a path, a planner's median cost over the cheapest known is: {found}.**{_dearer_optima(rows)}"
    )


def _dearer_optima(rows: pd.DataFrame) -> str:
    """Return why paths that are optimal may be dearer than the cheapest known; nothing where none is."""
    optimal = rows[rows.status == Status.OPTIMAL.value]
    dearer = optimal[optimal.ratio > analysis.CLOSE]
    if dearer.empty:
        return ""
    return (
        f" {len(dearer)} of the {len(optimal)} paths with the status `{Status.OPTIMAL.value}` "
        f"({listed(f'`{name}`' for name in dict.fromkeys(dearer.planner))}) are more than "
        f"{analysis.CLOSE - 1:.0%} dearer than the cheapest known: they are the cheapest on their planner's grid, and "
        "others are off it."
    )


def _paired_text(paired: pd.DataFrame, table: pd.DataFrame) -> str:
    compared = paired[np.isfinite(paired.cost_ratio)]
    if compared.low.isna().all():
        return "No two planners solved enough pairs in common for an interval: nothing is said of which is cheaper."
    compared = compared[compared.low.notna()]
    clear = compared[(compared.low > 1) | (compared.high < 1)]
    equal = len(compared) - len(clear)
    sentences = [
        f"`{row.first if row.cost_ratio < 1 else row.second}` is cheaper than "
        f"`{row.second if row.cost_ratio < 1 else row.first}` by {abs(1 - min(row.cost_ratio, 1 / row.cost_ratio)):.1%}"
        for row in clear.reindex(
            clear.cost_ratio.map(lambda ratio: -abs(np.log(ratio))).sort_values().index
        ).itertuples()
    ]
    unclear = (
        f" For {equal} of {len(compared)} pairs of planners the interval holds 1: no difference is shown."
        if equal
        else ""
    )
    return (f"**On the pairs that both solved, {'; '.join(sentences[:6])}.**" if sentences else "") + unclear


def _times_text(times: pd.DataFrame, table: pd.DataFrame) -> str:
    rows = analysis.weighted_rows(table)
    median = rows.groupby("planner").elapsed_s.median().sort_values()
    found = listed(f"`{name}` {value:.3g} s" for name, value in median.items())
    return f"**Median search time: {found}.** Times are of the machine that ran the benchmark, with its other load."


def _usage_text(usage: pd.DataFrame, table: pd.DataFrame) -> str:
    sentences = []
    for name in analysis.facts_of(usage)[1:]:
        column = usage[usage.objective == "weighted"].groupby("planner")[name].mean().dropna()
        if len(column):
            ends = f"from {column.min():.3f} (`{column.idxmin()}`) to {column.max():.3f} (`{column.idxmax()}`)"
            is_one = f"{column.min():.3f}" == f"{column.max():.3f}"
            sentences.append(f"{name} {f'{column.min():.3f} for all' if is_one else ends}")
    least, most = int(usage.instances.min()), int(usage.instances.max())
    left_out = [f"`{name}`" for name in sorted(set(table.planner) - set(usage.planner))]
    return (
        f"**Mean over altitudes along the paths: {'; '.join(sentences)}.** Only instances that all of these planners "
        f"solved count ({least if least == most else f'{least} to {most}'} an altitude)"
        + (f"; {listed(left_out)}, answering fewer than four joined pairs in five, left out." if left_out else ".")
    )


def _objectives_text(objectives: pd.DataFrame, table: pd.DataFrame) -> str:
    planner = objectives.planner.iloc[0]
    rows = objectives[(objectives.planner == planner) & np.isfinite(objectives.get("cost_ratio", np.nan))]
    if rows.empty:
        return f"`{planner}` solved no query both ways at a cost above 0: nothing to compare."
    sentences = []
    for row in each(rows):
        known = np.isfinite(row.cost_ratio_low)
        ends = f" ({row.cost_ratio_low - 1:.0%} to {row.cost_ratio_high - 1:.0%})" if known else ""
        sentences.append(
            f"at {row.altitude_m:g} m the shortest path costs {row.cost_ratio - 1:.0%} more{ends} and is "
            f"{1 - row.length_ratio:.1%} shorter"
        )
    return f"**Against the cheapest path of `{planner}`: {'; '.join(sentences)}.**"


def _complementarity_text(found: pd.DataFrame, table: pd.DataFrame) -> str:
    words = {True: "holds", False: "does not hold", None: "cannot be decided"}
    claims = [f"*{each.claim}*: **{words[each.holds]}**. {each.evidence}." for each in findings(found)]
    return f"**{verdict(found)}**\n\n{bullets(claims)}"


SHOWN = {
    "paired": ["first", "second", "both", "only_first", "only_second", "cost_ratio", "low", "high", "time_ratio"],
    "complementarity": [
        "altitude_m", "gps", "lidar", "correlation", "gps_poor", "lidar_where_gps_poor", "lidar_where_gps_good",
        "gps_serves", "lidar_serves", "either_serves",
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
