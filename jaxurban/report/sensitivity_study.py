"""report.md of a weight study over many routes: its tables and figures."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import pandas as pd

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.queries import WEIGHT_PREFIX
from jaxurban.paths.rows import HAS_PATH
from jaxurban.public import FactsRepr
from jaxurban.report.figures.sensitivity_study import sensitivity_study_figures
from jaxurban.report.write import (
    REPORT_FILE,
    Markdown,
    bullets,
    files_of,
    fill,
    framed,
    save,
    study_outputs,
)
from jaxurban.studies.bootstrap import FEWEST_GROUPS, interval_columns
from jaxurban.studies.montecarlo.sampling import weighed_metrics, weight_columns
from jaxurban.studies.queries import outcome_label, population_norms
from jaxurban.studies.weights import summary
from jaxurban.studies.weights.routes import SensitivityStudySettings
from jaxurban.studies.weights.sobol import FEW_SAMPLES
from jaxurban.studies.weights.summary import ALL, CLEAR, CUTS, OVER_CITIES, UNCLEAR

TABLES = [
    "routes",
    "weights",
    "summary",
    "sobol",
    "sobol_summary",
    "remade",
    "remade_summary",
    "parameters",
    "parameters_summary",
]
FIGURES = ["figures/regret.png", "figures/nearest.png"]
FILES = files_of([*(f"tables/{name}" for name in TABLES), *FIGURES, REPORT_FILE])
SAMPLED = (
    "Routes were drawn by stratum and range in equal numbers, only where a path joins a pair at every altitude, not as "
    "anyone flies: means are over such routes, not over traffic."
)
GIVEN = (
    "The routes are those of the table that was given: "
    "means are over them, each once, and say nothing about others."
)
MOST_REASONS = 3


@dataclass(frozen=True, eq=False, repr=False)
class SensitivityStudy(FactsRepr):
    """What a weight study found.

    Attributes:
      folder: where it is kept.
      maps: of each city by its name.
      instances: the routes asked for.
      rows: what was found for each, a row per route: its status, cost and outcomes, and of each weight its share of the
        cost, the nearest factors at which the route changes, and what a wrong weight costs.
      skipped: why some other maps were not made, a sentence each.
      settings: what was asked.
      is_sampled: whether the routes were drawn, by stratum and range, or given.
      remade: how each route differs on maps of perturbed heights; empty where none were asked for.
      parameters: how each route differs on maps of other parameters; empty where none were asked for.

    Examples:
      >>> chosen = ju.studies.SensitivityStudySettings(vary=("gps",), num_samples=0)
      >>> result = ju.studies.sensitivity_study(
      ...     {"demo": maps}, "weights", 2, altitudes_m=[60.0], settings=chosen, progress=False
      ... )
      >>> list(result.tables), result.is_sampled
      (['routes', 'weights', 'summary'], True)
    """

    folder: Path
    maps: Mapping[str, MetricMaps]
    instances: pd.DataFrame
    rows: pd.DataFrame
    skipped: tuple[str, ...]
    settings: SensitivityStudySettings
    is_sampled: bool = True
    remade: pd.DataFrame = field(default_factory=pd.DataFrame)
    parameters: pd.DataFrame = field(default_factory=pd.DataFrame)

    @property
    def facts(self) -> dict[str, str]:
        """The cities, how many routes there are, and how many of them have a path."""
        num_paths = self.rows.status.isin(HAS_PATH).sum()
        routes = f"{len(self.rows)}, {num_paths} with a path"
        return {"cities": ", ".join(self.maps), "routes": routes}

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables by name: ``routes``, and those that can be made of them.

        Where any route was found ``weights`` and ``summary``; with Sobol shares ``sobol``, and with routes on other
        maps ``remade`` and ``parameters``, each beside its summary (``sobol_summary`` and so on).
        """
        routes = summary.routes_of(self.rows, self.instances)
        result = {"routes": self.rows}
        if routes.empty:
            return result
        result["weights"] = summary.weights_table(routes, self.settings.factors)
        result["summary"] = summary.summarise(result["weights"], self.settings.wrong)
        shares = summary.shares_table(routes)
        if len(shares):
            result["sobol"] = shares
            result["sobol_summary"] = summary.summarise_shares(shares, self.settings.num_samples)
        for name, rows in {"remade": self.remade, "parameters": self.parameters}.items():
            if len(rows) and rows.status.isin(HAS_PATH).any():
                result[name] = rows
                result[f"{name}_summary"] = summary.summarise_changed(rows)
        return result


def write_sensitivity_study(result: SensitivityStudy) -> list[Path]:
    """Write the report, tables (CSV, Parquet) and figures (PNG) of a study into its folder and return the files."""
    figures = {}
    if "weights" in result.tables:
        figures = sensitivity_study_figures(result.tables, result.settings.wrong)
    return save(result.folder, study_outputs(study_markdown(result), result.tables, figures))


def study_markdown(result: SensitivityStudy) -> str:
    """Return the report as Markdown; it names figures and tables as `write_sensitivity_study` does."""
    settings = result.settings
    tables = result.tables

    # Why routes were not found: the most frequent statuses, with their notes and the number of routes.
    lost = result.rows[~result.rows.status.isin(HAS_PATH)].fillna({"note": ""})
    reasons = lost.value_counts(["status", "note"]).head(MOST_REASONS).reset_index(name="routes")
    return fill(
        "sensitivity_study",
        {"cities": _cities(result), **shown_tables(tables)},
        credits=[maps.attribution for maps in result.maps.values()],
        lost=framed(reasons) if len(reasons) else "",
        skipped=bullets(f"Not planned on other maps: {reason}" for reason in result.skipped),
        limit=min(settings.factors[1], 1 / settings.factors[0]),
        settings=settings,
        constraints=str(settings.constraints) or "none",
        weights=weights_said(result.instances),
        origin=SAMPLED if result.is_sampled else GIVEN,
        FEWEST_GROUPS=FEWEST_GROUPS,
        FEW_SAMPLES=FEW_SAMPLES,
        ABOVE_ONE=1 + summary.ABOVE_ONE,
    )


def _cities(result: SensitivityStudy) -> pd.DataFrame:
    """Return a row per city: its maps, its altitudes, how many of its routes have a path, and norms of population."""
    rows = []
    for city, part in result.rows.groupby("city", sort=False):
        maps = result.maps[str(city)]
        norms = population_norms(maps).items()
        norms_by_day = ", ".join(f"{number:,.0f} ({day})" for day, number in norms)
        altitudes = ", ".join(f"{z:g} m" for z in sorted(part.altitude_m.unique()))
        rows.append(
            {
                "city": city,
                "maps": maps.facts["grid"],
                "altitudes": altitudes,
                "pairs of places": part.instance.nunique(),
                "routes": len(part),
                "found": part.status.isin(HAS_PATH).sum(),
                "population is divided by": norms_by_day,
            }
        )
    return pd.DataFrame(rows)


def shown_tables(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the tables of the report by name, made of those of the study; none where no route was found.

    ``by_all`` (all routes, and each city) and ``where`` (further parts of the routes): statistics of each weight, of
    each part the costliest wrong weight first. ``sobol``, ``perturbed`` and ``parameters`` where the study has them.
    """
    if "summary" not in tables:
        return {}

    # The statistics, in the order of the parts of the routes, and in each part by falling regret.
    parts, _ = pd.factorize(tables["summary"].value)
    by_regret = tables["summary"].assign(part=parts)
    by_regret = by_regret.sort_values(["part", "regret"], ascending=[True, False])
    by_regret = by_regret.rename(columns={"value": "of", "weight_name": "weight"})
    is_whole = by_regret.cut.isin([ALL, OVER_CITIES, "city"])
    is_part = by_regret.cut.isin(CUTS) & ~is_whole & (by_regret.weight != "distance")
    statistics = interval_columns("regret", "changes", "nearest", "share")
    columns = ["of", "weight", "cities", "routes", *statistics]
    result = {
        "by_all": by_regret.loc[is_whole, columns],
        "where": by_regret.loc[is_part, columns],
    }

    if "sobol_summary" in tables:
        # A share and its interval stand only where the share is clear of 0. Where that is unclear ``at most`` is the
        # upper end of the interval; the verdict also says how many samples would settle it, where that is known.
        sobol = tables["sobol_summary"]
        total = sobol[sobol.kind == "total"].copy()
        share = interval_columns("share")  # with the ends of its interval
        total["at most"] = total.share_high.where(total.verdict == UNCLEAR).clip(lower=0)
        total[share] = total[share].where(total.verdict == CLEAR)
        remedy = total.samples_needed.map(": about {:.0f} samples should do".format)
        total["verdict"] += remedy.where(total.samples_needed > 0, "")
        total["outcome"] = total.outcome.map(outcome_label)
        result["sobol"] = total[["outcome", "weight_name", *share, "at most", "verdict"]]
    if "remade_summary" in tables:
        statistics = interval_columns("is_other", "nominal_regret", "nominal_is_closed")
        result["perturbed"] = tables["remade_summary"][["of", "routes", *statistics]]
    if "parameters_summary" in tables:
        changed = tables["parameters_summary"]
        statistics = interval_columns("is_other", "overlap", "nominal_regret")
        columns = ["parameter", "factor", "of", "routes", *statistics]
        result["parameters"] = changed.loc[changed.cut.isin([ALL, "city"]), columns]
    return result


def weights_said(instances: pd.DataFrame) -> str:
    """Return the weights that all instances share, by name; where they differ, words that say where they stand."""
    columns = list(weight_columns(weighed_metrics(instances.columns)))
    weights = instances[columns]
    if len(weights.drop_duplicates()) > 1:
        return Markdown("those of each route (`instances.parquet`)")
    first = weights.iloc[0].items()
    return ", ".join(
        f"{str(name).removeprefix(WEIGHT_PREFIX)} {weight:g}" for name, weight in first
    )
