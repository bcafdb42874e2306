"""report.md of a weight study over many routes: what they support and what not, tables and figures."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.paths.queries import WEIGHT_PREFIX
from jaxurban.report.figures.sensitivity_study import study_figures
from jaxurban.report.markdown import bullets, counted, fill, listed, table
from jaxurban.report.save import Output, files_of, save
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.montecarlo.sampling import weighed_metrics, weight_columns
from jaxurban.studies.montecarlo.trial import HAS_PATH
from jaxurban.studies.outcomes import outcome_label
from jaxurban.studies.sensitivity import summary
from jaxurban.studies.sensitivity.findings import Finding, change_said, findings
from jaxurban.studies.sensitivity.routes import SensitivityStudySettings
from jaxurban.studies.sensitivity.sobol import FEW_SAMPLES
from jaxurban.studies.sensitivity.summary import ALL, CLEAR, CONSTANT, OVER_CITIES, UNCLEAR

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
      rows: what was found for each (`jaxurban.studies.sensitivity.routes.route_row`).
      remade: how each route differs on maps made anew (`jaxurban.studies.sensitivity.remade.remade_rows`).
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
        if len(self.remade) and self.remade.status.isin(HAS_PATH).any():
            found |= {"remade": self.remade, "remade_summary": summary.summarise_remade(self.remade)}
        return found

    @cached_property
    def findings(self) -> list[Finding]:
        """Every claim that was looked at, and whether the routes bear it out."""
        tables = self.tables
        if "weights" not in tables:
            return []
        return findings(tables["weights"], tables.get("sobol"), tables.get("remade_summary"), self.settings.wrong)


TABLES = "routes", "weights", "summary", "sobol", "sobol_summary", "remade", "remade_summary"
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
    if "weights" not in found.tables:
        return (
            f"# What the weights do to many routes\n\n{_asked(found)}\n\nNo route was found, so nothing can be said.\n"
        )
    claims, of_all = found.findings, found.tables["summary"]
    by_verdict = {holds: [each for each in claims if each.holds is holds] for holds in (True, False, None)}
    settings = found.settings
    text = fill(
        "sensitivity_study",
        asked=_asked(found),
        settings=settings,
        constraints=str(settings.constraints) or "none",
        wrong=settings.wrong,
        limit=min(settings.factors[1], 1 / settings.factors[0]),
        num_claims=len(claims),
        num_clear=len(by_verdict[True]),
        num_refuted=len(by_verdict[False]),
        num_open=len(by_verdict[None]),
        answer=_answer(of_all, settings.wrong),
        few=_few(found),
        supported=_claims(by_verdict[True]),
        refuted=_claims(by_verdict[False]),
        undecided=_claims(by_verdict[None]),
        by_all=_rows(of_all[of_all.cut.isin([ALL, "city"])]),
        over_cities=_over_cities(of_all),
        where=_where(of_all),
        sobol=_sobol(found),
        remade=_remade(found),
        cities="; ".join(f"{city}, {grid}" for city, grid in found.cities.items()),
        weights=weights_said(found.instances),
        norms=_norms(found.norms),
        origin=SAMPLED if found.is_sampled else GIVEN,
        fewest=FEWEST_GROUPS,
    )
    return f"{text}\n"


def _asked(found: SensitivityStudy) -> str:
    instances, statuses = found.instances, found.rows.status.value_counts()
    num = instances.groupby("city").instance.nunique()
    altitudes = listed(f"{z:g} m" for z in sorted(instances.altitude_m.unique()))
    pairs = listed(f"{counted(int(each), 'pair')} of places in {city}" for city, each in num.items())
    lost = {name: count for name, count in statuses.items() if name not in HAS_PATH}
    failed = listed(f"{count} with status {name}" for name, count in lost.items()) if lost else "none"
    return (
        f"{pairs}, at {altitudes}: {counted(len(found.rows), 'route')}, {statuses.sum() - sum(lost.values())} of them "
        f"found; not found: {failed}.{_reasons(found.rows)}"
    )


def _reasons(rows: pd.DataFrame) -> str:
    """Return why routes were not found, each reason once and the commonest first; nothing where all were."""
    counts = rows.loc[~rows.status.isin(HAS_PATH), "note"].value_counts()
    if counts.empty:
        return ""
    lines = [f"{note} ({counted(int(count), 'route')})" for note, count in counts.head(MOST_REASONS).items()]
    more = len(counts) - len(lines)
    return "\n\n" + bullets(lines + ([f"further reasons: {more}, in `tables/routes`"] if more else []))


def _few(found: SensitivityStudy) -> str:
    pairs = found.instances.groupby("city").instance.nunique()
    few = [f"{city} ({each})" for city, each in pairs.items() if each < FEWEST_GROUPS]
    return f"**Too few pairs of places for an interval: {listed(few)}; draw more.**" if few else ""


def _answer(of_all: pd.DataFrame, wrong: float) -> str:
    """Return one sentence: what the cost is made of, and which wrong weight costs most."""
    rows = of_all[of_all.cut == ALL].sort_values("share", ascending=False)
    rows = rows[rows.cities == rows.cities.max()]  # a layer of one city says nothing of all routes
    parts = listed(f"{row['weight_name']} {row['share']:.0%}" for row in rows.to_dict("records"))
    made_of = f"In these routes {parts.replace(' ', ' makes up ', 1)} of the cost"
    varied = rows[rows.regret.notna()]
    if varied.empty:
        return f"{made_of}."
    most = varied.loc[varied.regret.idxmax()]
    regret = interval_said(most, "regret", ".2%")
    return f"{made_of}; a weight of {most.weight_name} {wrong:g} times wrong costs most: a mean regret of {regret}."


def _claims(claims: Iterable[Finding]) -> str:
    lines = [f"{each.claim} *{each.evidence}.*" for each in claims]
    return bullets(lines) if lines else "Nothing that was looked at."


def interval_said(row: Any, name: str, kind: str) -> str:
    """Return a number of a table's row with its interval; nothing for no number."""
    value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    if not np.isfinite(value):
        return ""
    return f"{value:{kind}} ({low:{kind}} to {high:{kind}})" if np.isfinite(low) else f"{value:{kind}} (too few)"


def _rows(part: pd.DataFrame) -> str:
    """Return a table of a summary's rows, those of one part together, the costliest wrong weight first."""
    order = part.assign(part=pd.factorize(part.value)[0]).sort_values(["part", "regret"], ascending=[True, False])
    most = part.groupby("value").cities.transform("max")
    lines = [
        (
            row["value"]
            if row["cities"] == most[index]
            else f"{row['value']} ({row['cities']} of {most[index]} cities)",
            row["weight_name"],
            str(row["routes"]),
            *(interval_said(row, *each) for each in STATISTICS.items()),
        )
        for index, row in zip(order.index, order.to_dict("records"), strict=True)
    ]
    return table(("of", "weight", "routes", *STATISTICS), lines)


def _over_cities(of_all: pd.DataFrame) -> str:
    """Return the intervals over cities, or that there are too few of them."""
    rows = of_all[of_all.cut == ALL]
    num = int(rows.cities.max())
    if num < FEWEST_GROUPS:
        here = "this city" if num == 1 else f"these {num} cities"
        return f"These intervals are of {here} and no others: one over cities needs at least {FEWEST_GROUPS} of them."
    lines = [
        (
            row["weight_name"],
            *(
                f"{row[f'{name}_{OVER_CITIES}low']:{kind}} to {row[f'{name}_{OVER_CITIES}high']:{kind}}"
                for name, kind in STATISTICS.items()
            ),
        )
        for row in rows[rows[f"nearest_{OVER_CITIES}low"].notna()].to_dict("records")
    ]
    return f"Over cities like these {num}, whole cities drawn:\n\n{table(('weight', *STATISTICS), lines)}"


def _where(of_all: pd.DataFrame) -> str:
    parts = []
    for cut in ("altitude_m", "stratum", "range", "time_of_day", "time"):
        part = of_all[(of_all.cut == cut) & (of_all.weight_name != "distance")]
        if len(part):
            title = {"altitude_m": "altitude", "time_of_day": "time of day"}.get(cut, cut)
            note = " (a route counts in both of its strata)" if cut == "stratum" else ""
            parts += [f"By {title}{note}:", _rows(part)]
    return "\n\n".join(parts) or "All routes are of one altitude, stratum, range and time."


def _sobol(found: SensitivityStudy) -> str:
    if "sobol_summary" not in found.tables:
        return ""
    rows = found.tables["sobol_summary"]
    rows, num = rows[rows.kind == "total"], found.settings.num_samples
    names = list(dict.fromkeys(rows.weight_name))
    lines = []
    for outcome, part in rows.groupby("outcome", sort=False):
        by_name = part.set_index("weight_name")
        lines.append(
            (
                outcome_label(str(outcome)),
                *(share_said(by_name.loc[name]) if name in by_name.index else "" for name in names),
            )
        )
    low, high = found.settings.factors
    few = (
        f" **{num} samples are few for one route: read no single route's shares from `tables/sobol`.**"
        if num < FEW_SAMPLES
        else ""
    )
    beyond = [row for row in rows.to_dict("records") if row["verdict"] == CLEAR and row["share_high"] > 1]
    if beyond:
        said = listed(f"{outcome_label(row['outcome'])} by {row['weight_name']}" for row in beyond)
        few += (
            f" **No true share is above 1: where its interval reaches beyond ({said}), the samples are too few, "
            "because the outcome hardly varies on some routes.**"
        )
    own_ci = float(rows.own_ci.median())
    wide = f"; one route's own 95 % interval is some ± {own_ci:.2f} wide, which the mean of many narrows"
    return fill(
        "sensitivity_sobol",
        low=low,
        high=high,
        num_samples=num,
        own=wide if np.isfinite(own_ci) and num >= FEW_SAMPLES else "",
        few=few,
        rows=table(("outcome", *names), lines),
    )


def share_said(row: Any) -> str:
    """Return a mean Sobol share in words: its number and interval only where it is told from 0."""
    if row["verdict"] == CLEAR:
        return interval_said(row, "share", ".2f")
    if row["verdict"] == UNCLEAR:
        return f"not told from 0 (at most {max(row['share_high'], 0.0):.2f})"
    return str(row["verdict"]) if row["verdict"] != CONSTANT else "route does not vary"


def _remade(found: SensitivityStudy) -> str:
    skipped = bullets(f"Not made anew: {reason}" for reason in found.skipped) if found.skipped else ""
    if "remade_summary" not in found.tables:
        return f"## Other heights, other parameters\n\n{skipped}" if skipped else ""
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
    picture = "![Other heights, other parameters](figures/remade.png)"
    return fill("sensitivity_remade", rows=rows, skipped=skipped, picture=picture)


def _norms(norms: Mapping[str, Mapping[str, float]]) -> str:
    """Return that population is divided by other numbers from city to city; nothing where it is not."""
    held = {city: of_city for city, of_city in norms.items() if of_city}
    if all(of_city == next(iter(held.values())) for of_city in held.values()):
        return ""
    said = "; ".join(
        f"{city} {listed(f'{number:,.0f} at {day}' for day, number in of_city.items())}"
        for city, of_city in held.items()
    )
    return (
        f"\n- **Population is normalised by different numbers ({said}), so that one weight of population means "
        "different things in these cities**: set `[population] normalise` to a number to compare them."
    )


def weights_said(instances: pd.DataFrame) -> str:
    """Return the weights that all instances share, or that each has its own."""
    columns = weight_columns(weighed_metrics(instances.columns))
    if len(instances[list(columns)].drop_duplicates()) > 1:
        return "those of each route (`instances.parquet`)"
    return ", ".join(f"{name.removeprefix(WEIGHT_PREFIX)} {instances[name].iloc[0]:g}" for name in columns)
