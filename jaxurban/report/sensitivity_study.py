"""report.md of a weight study over many routes: its tables and figures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.paths.queries import WEIGHT_PREFIX
from jaxurban.paths.rows import HAS_PATH
from jaxurban.report.figures.sensitivity_study import study_figures
from jaxurban.report.write import Output, bullets, files_of, fill, framed, save, table
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.montecarlo.sampling import weighed_metrics, weight_columns
from jaxurban.studies.queries import outcome_label
from jaxurban.studies.weights import summary
from jaxurban.studies.weights.routes import SensitivityStudySettings
from jaxurban.studies.weights.sobol import FEW_SAMPLES
from jaxurban.studies.weights.summary import ALL, CLEAR, CUTS, UNCLEAR, change_said

REPORT_FILE = "report.md"
STATISTICS = {"regret": ".2%", "changes": ".0%", "nearest": ".3g", "share": ".1%"}
SAMPLED = (
    "Routes were drawn by stratum and range in equal numbers, only where a path joins a pair at every altitude, not as "
    "anyone flies: means are over such routes, not over traffic."
)
GIVEN = "The routes are those of the table that was given: means are over them, each once, and tell of no others."
MOST_REASONS = 3


@dataclass(frozen=True, eq=False)
class SensitivityStudy:
    """What a weight study found.

    Attributes:
      folder: where it is kept.
      cities: how the cities are called, with their grids in words.
      instances: the routes asked for.
      rows: what was found for each (`jaxurban.studies.weights.routes.route_facts`).
      remade: how each route differs on maps made anew (`jaxurban.studies.weights.routes.OnPerturbedMaps`).
      skipped: why maps were not made anew, a sentence a city.
      settings: what was asked.
      is_sampled: whether the routes were drawn, by stratum and range, or given.
      norms: what population is divided by in each city at each time of day (`population_norms`).
    """

    folder: Path
    cities: Mapping[str, str]
    instances: pd.DataFrame
    rows: pd.DataFrame
    remade: pd.DataFrame
    skipped: tuple[str, ...]
    settings: SensitivityStudySettings
    norms: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    is_sampled: bool = True

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables by name: ``routes`` and, where any was found, ``weights``, ``summary`` and the like."""
        routes = summary.routes_of(self.rows, self.instances)
        found = {"routes": self.rows}
        if routes.empty:
            return found
        found["weights"] = summary.weights_table(routes, self.settings.factors)
        found["summary"] = summary.summarise(found["weights"], self.settings.wrong)
        shares = summary.shares_table(routes)
        if len(shares):
            found |= {"sobol": shares, "sobol_summary": summary.summarise_shares(shares)}
        found["comparisons"] = summary.comparisons_of(found["weights"], shares)
        if len(self.remade) and self.remade.status.isin(HAS_PATH).any():
            found |= {"remade": self.remade, "remade_summary": summary.summarise_remade(self.remade)}
        return found


TABLES = "routes", "weights", "summary", "sobol", "sobol_summary", "comparisons", "remade", "remade_summary"
FIGURES = "share", "regret", "nearest", "where", "sobol", "remade"
FILES = files_of([*(f"tables/{name}" for name in TABLES), *(f"figures/{name}.png" for name in FIGURES), REPORT_FILE])


def write_sensitivity_study(found: SensitivityStudy) -> list[Path]:
    """Write the report, tables (CSV, Parquet) and figures (PNG) of a study into its folder and return the files."""
    outputs: dict[str, Output] = {f"tables/{name}": made for name, made in found.tables.items()}
    figures: dict[str, Callable] = (
        study_figures(found.tables, found.settings.wrong) if "weights" in found.tables else {}
    )
    outputs |= {f"figures/{name}.png": draw for name, draw in figures.items()}
    return save(found.folder, {**outputs, REPORT_FILE: study_markdown(found)})


def study_markdown(found: SensitivityStudy) -> str:
    """Return the report as Markdown; it names figures and tables as `write_sensitivity_study` does."""
    settings, tables = found.settings, found.tables
    text = fill(
        "sensitivity_study",
        cities=_cities(found),
        settings=settings,
        constraints=str(settings.constraints) or "none",
        weights=weights_said(found.instances),
        origin=SAMPLED if found.is_sampled else GIVEN,
        results=_results(tables, settings) if "weights" in tables else "No route was found.",
        remade=_remade(found),
        fewest=FEWEST_GROUPS,
    )
    return f"{text}\n"


def _cities(found: SensitivityStudy) -> str:
    """Return what was asked in each city, and the reasons why routes were not found."""
    rows = []
    for city, part in found.rows.groupby("city", sort=False):
        norms = ", ".join(f"{number:,.0f} ({day})" for day, number in found.norms.get(str(city), {}).items())
        altitudes = ", ".join(f"{z:g} m" for z in sorted(part.altitude_m.unique()))
        counts = part.instance.nunique(), len(part), part.status.isin(HAS_PATH).sum()
        rows.append((city, found.cities[str(city)], altitudes, *map(str, counts), norms))
    head = ("city", "maps", "altitudes", "pairs of places", "routes", "found", "population is divided by")
    tables = [table(head, rows)]
    if len(lost := found.rows[~found.rows.status.isin(HAS_PATH)]):
        reasons = lost.fillna({"note": ""}).value_counts(["status", "note"]).head(MOST_REASONS)
        tables.append(framed(reasons.rename("routes").reset_index()))
    return "\n\n".join(tables)


def _results(tables: Mapping[str, pd.DataFrame], settings: SensitivityStudySettings) -> str:
    of_all = tables["summary"]
    return fill(
        "sensitivity_results",
        wrong=settings.wrong,
        limit=min(settings.factors[1], 1 / settings.factors[0]),
        by_all=_rows(of_all[of_all.cut.isin([ALL, "city"])]),
        where=_where(of_all),
        sobol=_sobol(tables["sobol_summary"], settings) if "sobol_summary" in tables else "",
        comparisons=framed(tables["comparisons"]),
    )


def interval_said(row: Any, name: str, kind: str) -> str:
    """Return a number of a table's row with its interval; nothing for no number."""
    value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    if not np.isfinite(value):
        return ""
    return f"{value:{kind}} ({low:{kind}} to {high:{kind}})" if np.isfinite(low) else f"{value:{kind}} (too few)"


def _rows(part: pd.DataFrame) -> str:
    """Return a table of a summary's rows, those of one part together, the costliest wrong weight first."""
    order = part.assign(part=pd.factorize(part.value)[0]).sort_values(["part", "regret"], ascending=[True, False])
    lines = [
        (
            *(str(row[name]) for name in ("value", "weight_name", "cities", "routes")),
            *(interval_said(row, *each) for each in STATISTICS.items()),
        )
        for row in order.to_dict("records")
    ]
    return table(("of", "weight", "cities", "routes", *STATISTICS), lines)


def _where(of_all: pd.DataFrame) -> str:
    parts = [of_all[(of_all.cut == cut) & (of_all.weight_name != "distance")] for cut in CUTS if cut != "city"]
    return "\n\n".join(_rows(part) for part in parts if len(part))


def _sobol(shares: pd.DataFrame, settings: SensitivityStudySettings) -> str:
    total = shares[shares.kind == "total"]
    told = total.assign(told=[share_said(row) for row in total.to_dict("records")])
    wide = told.pivot(index="outcome", columns="weight_name", values="told").fillna("")
    wide = wide.reindex(total.outcome.unique())[list(total.weight_name.unique())]
    lines = [(outcome_label(str(outcome)), *row) for outcome, row in zip(wide.index, wide.to_numpy(), strict=True)]
    low, high = settings.factors
    rows = table(("outcome", *wide.columns), lines)
    return fill("sensitivity_sobol", low=low, high=high, settings=settings, few=FEW_SAMPLES, rows=rows)


def share_said(row: Any) -> str:
    """Return a mean Sobol share in words: its number and interval only where it is told from 0."""
    if row["verdict"] == CLEAR:
        return interval_said(row, "share", ".2f")
    if row["verdict"] == UNCLEAR:
        return f"not told from 0 (at most {max(row['share_high'], 0.0):.2f})"
    return str(row["verdict"])


def _remade(found: SensitivityStudy) -> str:
    skipped = bullets(f"Not made anew: {reason}" for reason in found.skipped) if found.skipped else ""
    if "remade_summary" not in found.tables:
        return skipped
    kinds = {"is_other": ".0%", "nominal_regret": ".2%", "nominal_is_closed": ".0%"}
    lines = [
        (
            change_said(row["changed"], row["factor"]),
            row["of"],
            str(row["routes"]),
            *(interval_said(row, *each) for each in kinds.items()),
        )
        for row in found.tables["remade_summary"].to_dict("records")
    ]
    rows = table(("maps with", "of", "routes", "changes", "regret", "closed"), lines)
    return fill("sensitivity_remade", rows=rows, skipped=skipped)


def weights_said(instances: pd.DataFrame) -> str:
    """Return the weights that all instances share, or that each has its own."""
    columns = weight_columns(weighed_metrics(instances.columns))
    if len(instances[list(columns)].drop_duplicates()) > 1:
        return "those of each route (`instances.parquet`)"
    return ", ".join(f"{name.removeprefix(WEIGHT_PREFIX)} {instances[name].iloc[0]:g}" for name in columns)
