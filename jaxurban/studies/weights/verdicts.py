"""What a study of weights decided, as records (`jaxurban.statistics.conclusions`)."""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.statistics.bootstrap import Clusters
from jaxurban.statistics.conclusions import SAME, Verdict, sized
from jaxurban.studies.decided import Measure, Ranking, border_verdict, ranked
from jaxurban.studies.weights.one_route import OneRoute
from jaxurban.studies.weights.routes import ROUTE_KEY
from jaxurban.studies.weights.settings import SensitivitySettings
from jaxurban.studies.weights.summary import ALL, HEIGHTS, num_routes, pairs_of, regrets_of

PAID_WORDS = {
    "more_length_m": "m of way",
    "more_people_below": "people below",
    "more_no_fix_m": "m without a fix",
}
CHANGE_WORDS = {
    HEIGHTS: "heights drawn within their uncertainty",
    "time": "{layers} of another time",
    "time_of_day": "{layers} of another time of day",
}
LAYER_WORDS = {"gps": "satellites", "population": "people"}  # of metrics that change with the time
GIVEN_AT_EDGE = " (from a route that the border may have made)"
OF_COST = "% of the cost"
PAIRS = "pairs of places"


class WeightVerdict(Enum):
    """Kinds of verdicts on weights; each is a sentence with places for the record's fields."""

    MATTERS_MORE = (
        "{first} matters more than {last}, by {size} where they are {wrong:g} times wrong ({n})"
    )
    TIED = "which of {what} matters more ({first} over {last}: {size}, {n})"
    COSTS = "{first} {wrong:g} times wrong makes routes cost {size} more: {paid} (means of {n})"
    COSTS_OPEN = (
        "how much more routes cost with {first} {wrong:g} times wrong is open: {size} on average, as {share:.0f} % of "
        "these cost more and none less ({n})"
    )
    NO_CHANGE = "no factor of {what} from {low:g} to {high:g} changes any of {n}"
    OTHER_WAY = (
        "{first} times {factor:.3g} sends the drone another way{given}: {paid}, at {size} more cost"
    )
    WAY_AT_EDGE = (
        "{first} times {factor:.3g} sends the drone another way, along the border of the maps{given}: {paid}, "
        "at {size} more cost"
    )
    NO_WAY = "no factor of {what} from {low:g} to {high:g} sends the drone another way"
    OTHER_MAPS = "with {first} {size} of the routes change, and keeping a route there costs {kept:.2g} % more ({n})"
    NO_PATH = "which weights matter, as no path was found ({n}: {why})"
    TOGETHER = (
        "{what} act together by {size}: so much more they cost, both {wrong:g} times wrong, in opposite directions "
        "than in the same one ({n})"
    )
    TOGETHER_OPEN = (
        "whether {what} act together is open: both {wrong:g} times wrong, they cost {size} more in opposite directions "
        "than in the same one ({n})"
    )
    NOT_TOGETHER = "whether weights act together, which was not looked at"
    ONE_ROUTE = "whether other routes change at these factors, which one route cannot say"


def verdicts_of(
    tables: Mapping[str, pd.DataFrame],
    route: OneRoute | None,
    settings: SensitivitySettings,
    ended: Collection[str] = (),
) -> list[Verdict]:
    """Return what a study says of its weights, the most important first.

    Args:
      tables: of the study: ``routes``, ``weights``, ``summary`` and ``together``; ``changed_summary`` where it has one.
      route: what only a study of one route has.
      settings: of the study.
      ended: sides on which the source of the maps ends (`ended_sides`).
    """
    weights = tables["weights"]
    summary = tables["summary"]
    of_all = summary[summary.cut == ALL]
    is_pinned = tables["routes"].at_edge.dropna().to_numpy() > 0
    border = border_verdict(is_pinned, sides=route.edge_sides if route else (), ended=ended)
    together = together_verdicts(tables["together"], settings)
    if route:  # whose place is the first thing to doubt
        verdicts = list(_ways(route, settings, ended, GIVEN_AT_EDGE if border else ""))
        verdicts[1:1] = [*border, *together]
        border = []
    else:
        verdicts = list(_ranks(weights, of_all, settings, ended))
        verdicts[1:1] = together
    if "changed_summary" in tables:
        changed = tables["changed_summary"]
        verdicts += map(on_other_maps, changed[changed.cut == ALL].to_dict("records"))
    return verdicts + border


def weight_ranking(weights: pd.DataFrame) -> Ranking | None:
    """Return the weights in groups of ranks by their regrets, in % of the cost; None of fewer than two.

    Weights that change no route, or that a city lacks, have no rank.

    Args:
      weights: a row per route and weight.
    """
    changes = _changes(weights)
    regrets = 100 * regrets_of(weights)
    measure = Measure(regrets[changes.index[changes]].dropna(axis=1), OF_COST, is_better_high=True)
    if measure.values.shape[1] < 2:
        return None
    return ranked({"regret": measure}, pairs_of(regrets.index.to_frame()))["regret"]


def _changes(weights: pd.DataFrame) -> pd.Series:
    """Return whether each weight that varies changes any route, by its name."""
    varied = weights[weights.varies]
    is_changed = varied[["below", "above"]].notna().any(axis=1)
    return is_changed.groupby(varied.weight_name, sort=False).any()


def _ranks(
    weights: pd.DataFrame,
    of_all: pd.DataFrame,
    settings: SensitivitySettings,
    ended: Collection[str],
) -> Iterator[Verdict]:
    """Yield how the weights rank, what each costs where it is wrong, and which change nothing.

    Args:
      weights: a row per route and weight.
      of_all: the rows of the summary of all routes, whose intervals are those of the report and its picture.
      settings: of the study.
      ended: sides on which the source of the maps ends.
    """
    wrong = {"wrong": settings.wrong}
    ranking = weight_ranking(weights)
    if ranking is not None:
        kinds = WeightVerdict.MATTERS_MORE, PAIRS, WeightVerdict.TIED
        for verdict in ranking.verdicts(*kinds):
            yield replace(verdict, facts={**verdict.facts, **wrong})

    # The weights that change any route, and those that change none. How much a weight costs is open where its interval
    # reaches 0.
    changes = _changes(weights)
    dead = changes.index[~changes].tolist()
    varied = weights[weights.varies]
    costs = of_all.set_index("weight_name").loc[changes.index[changes]]
    rows: Any = costs.sort_values("regret", ascending=False).itertuples()
    for row in rows:
        of_weight = varied[varied.weight_name == row.Index]
        facts = wrong | {"paid": paid_on_average(of_weight, pairs_of(of_weight))}
        size, low, high = 100 * np.array([row.regret, row.regret_low, row.regret_high])
        kind = WeightVerdict.COSTS
        if 0 < row.regret_needed < math.inf:
            kind = WeightVerdict.COSTS_OPEN
            facts["share"] = 100 * (of_weight.regret > SAME).mean()
        about = size, low, high, row.pairs, "%", PAIRS, row.regret_needed
        yield Verdict(kind, (row.Index,), *about, facts)
    if dead:
        num = num_routes(varied)
        yield Verdict(WeightVerdict.NO_CHANGE, tuple(dead), 0.0, n=num, facts=_range(settings))

    # Routes that the border may have made, if one of the weights is wrong.
    sent = varied.groupby([*ROUTE_KEY]).more_at_edge.max()
    noun = f"routes, only with one weight {settings.wrong:g} times wrong,"
    yield from border_verdict(sent.to_numpy() > 0, noun, ended=ended)


def _ways(
    route: OneRoute, settings: SensitivitySettings, ended: Collection[str], given: str
) -> Iterator[Verdict]:
    """Yield where a weight of a single route sends the drone another way, the nearest factors first.

    Args:
      route: the single route.
      settings: of the study.
      ended: sides on which the source of the maps ends.
      given: a caution on the given route, for each sentence on another one.
    """
    ways = route.ways[route.ways.factor.notna()]
    nearest = np.log(ways.factor).abs().sort_values().index
    for row in ways.loc[nearest].to_dict("records"):
        kind = WeightVerdict.WAY_AT_EDGE if row["at_edge"] else WeightVerdict.OTHER_WAY
        facts = {"factor": row["factor"], "paid": paid_said(row), "given": given}
        more = 100 * row["more_cost"]
        yield Verdict(kind, (row["weight_name"],), more, n=1, unit="%", facts=facts)
    calm = tuple(name for name in route.lines if name not in set(ways.weight_name))
    if calm:
        yield Verdict(WeightVerdict.NO_WAY, calm, n=1, facts=_range(settings))
    is_pinned = ways.at_edge.to_numpy() > 0
    yield from border_verdict(is_pinned, "other ways", route.other_edge_sides, ended)
    yield Verdict(WeightVerdict.ONE_ROUTE, tuple(route.lines), n=1, needed=math.nan)


def together_verdicts(table: pd.DataFrame, settings: SensitivitySettings) -> Iterator[Verdict]:
    """Yield which weights act together, or the nearest to it; of one route none is decided.

    Args:
      table: from `act_together`.
      settings: of the study.
    """
    if table.empty:
        yield Verdict(WeightVerdict.NOT_TOGETHER, needed=math.nan)
        return
    shown = table[table.needed == 0]
    if shown.empty:
        shown = table.nsmallest(1, "needed")
    rows: Any = shown.itertuples()
    for row in rows:
        needed = row.needed if row.n > 1 else math.nan
        kind = WeightVerdict.TOGETHER_OPEN if needed else WeightVerdict.TOGETHER
        about = row.size, row.low, row.high, row.n, OF_COST, PAIRS, needed
        facts = {"wrong": settings.wrong}
        yield Verdict(kind, tuple(row.weights.split(",")), *about, facts)


def on_other_maps(row: Mapping[Any, Any]) -> Verdict:
    """Return how a change of maps changes routes, from a row of the summary of them."""
    share, low, high = (100 * row[f"is_other{end}"] for end in ("", "_low", "_high"))
    names = [LAYER_WORDS.get(name, f"m_{name}") for name in row["layers"].split(",")]
    words = CHANGE_WORDS[row["change"]].format(layers=" and ".join(names))
    facts = {"kept": 100 * row["nominal_regret"]}
    kind = WeightVerdict.OTHER_MAPS
    noun = "route" if row["routes"] == 1 else "routes"
    if row["change"] == HEIGHTS:
        noun += f", each on the maps of {row['draws']} draws"
    return Verdict(kind, (words,), share, low, high, row["routes"], "%", noun, facts=facts)


def _range(settings: SensitivitySettings) -> dict[str, float]:
    """Return the ends of the factors in which breakpoints are looked for."""
    low, high = settings.factors
    return {"low": low, "high": high}


def paid_on_average(rows: pd.DataFrame, clusters: Clusters) -> str:
    """Return the mean of what a user pays more, in words: that of which the interval excludes 0.

    Args:
      rows: the columns of `PAID_WORDS`, as far as they are known.
      clusters: draws of the rows.
    """
    words = []
    has_any = rows.notna().any()
    known = {name: unit for name, unit in PAID_WORDS.items() if has_any.get(name, False)}
    for name, unit in known.items():
        size, low, high = clusters.interval(rows[name])
        if low > 0 or high < 0:
            words.append(sized(size, low, high, unit))
    return ", ".join(words) or f"no more {' or '.join(known.values())} that can be told from 0"


def paid_said(more: Mapping[Any, Any]) -> str:
    """Return what a user pays more for a route, in words, as far as the maps know it."""
    known = {words: more[name] for name, words in PAID_WORDS.items() if np.isfinite(more[name])}
    return ", ".join(f"{round(value):+,} {words}" for words, value in known.items())
