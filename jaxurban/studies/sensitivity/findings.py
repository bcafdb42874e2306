"""What a weight study supports and what not: each claim, whether its interval bears it, and the numbers."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.studies.bootstrap import FEWEST_GROUPS, Interval, share_of
from jaxurban.studies.montecarlo.analysis import each
from jaxurban.studies.montecarlo.complementarity import Finding
from jaxurban.studies.outcomes import outcome_label
from jaxurban.studies.sensitivity.remade import HEIGHTS
from jaxurban.studies.sensitivity.routes import ROUTE_KEY
from jaxurban.studies.sensitivity.summary import ALL, Drawn, by_stratum

SMALL = 0.01  # of a cost: a regret below this is called small
MOST = 0.5


def findings(
    weights: pd.DataFrame, shares: pd.DataFrame | None, remade: pd.DataFrame | None, wrong: float
) -> list[Finding]:
    """Return every claim that was looked at: ``holds`` is True, False, or None where the routes cannot tell.

    Args:
      weights: from `summary.weights_table`.
      shares: from `summary.shares_table`.
      remade: from `summary.summarise_remade`.
      wrong: factor of a wrong weight.
    """
    found = [*_ranking(weights, wrong), *_sizes(weights, wrong), *_altitudes(weights), *_strata(weights, wrong)]
    if shares is not None:
        found += _outcomes(shares)
    if remade is not None:
        found += _remade(remade)
    return found


def shown(interval: Interval, kind: str = ".1%") -> str:
    """Return a number with its interval in brackets, or that there is none."""
    if not np.isfinite(interval.mean):
        return "nobody knows how much: no route has both"
    if not np.isfinite(interval.low):
        return f"{interval.mean:{kind}} (no interval: fewer than {FEWEST_GROUPS} pairs)"
    return f"{interval.mean:{kind}} ({interval.low:{kind}} to {interval.high:{kind}})"


def above(interval: Interval, value: float = 0.0) -> bool | None:
    """Return whether an interval lies above a value (True), below it (False) or neither (None)."""
    return True if interval.low > value else False if interval.high < value else None


def leaders(weights: pd.DataFrame, column: str) -> tuple[str, str, Interval]:
    """Return the weight of the largest mean of a column, the one that comes nearest to it, and by how much it leads.

    Leads are paired, route by route, over the routes that have both; the nearest is that of the lowest interval.
    """
    wide = weights.pivot(index=list(ROUTE_KEY), columns="weight_name", values=column).dropna(axis=1, how="all")
    first = str(wide.mean().idxmax())
    leads = {}
    for name in map(str, wide.columns.drop(first)):
        both = wide[[first, name]].dropna().reset_index()
        leads[name] = Drawn(both).interval(both[first] - both[name])
    nearest = min(leads, key=lambda name: np.nan_to_num(leads[name].low, nan=-np.inf))
    return first, nearest, leads[nearest]


def _ranking(weights: pd.DataFrame, wrong: float) -> Iterator[Finding]:
    metrics = weights[weights.weight_name != "distance"]
    kinds = (("elasticity", "has the largest share of the cost"), ("regret", f"costs most when {wrong:g} times wrong"))
    for column, said in kinds:
        if metrics[metrics[column].notna()].weight_name.nunique() > 1:
            first, second, ahead = leaders(metrics, column)
            evidence = f"ahead of {second} by {shown(ahead)} of the cost"
            yield Finding(f"Of the metrics' weights, {first} {said}.", above(ahead), evidence)
            yield from _in_every_city(metrics, column, first, said)


def _in_every_city(metrics: pd.DataFrame, column: str, first: str, said: str) -> Iterator[Finding]:
    cities = list(dict.fromkeys(metrics.city))
    if len(cities) < 2:
        return
    holds, evidence = [], []
    for city in cities:
        of_city = metrics[(metrics.city == city) & metrics[column].notna()]
        if of_city.weight_name.nunique() < 2:
            continue
        name, second, ahead = leaders(of_city, column)
        is_clear = above(ahead)
        holds.append(is_clear if name == first else False if is_clear else None)
        tail = "" if is_clear else ", which the routes do not tell apart"
        evidence.append(f"{city}: {name}, ahead of {second} by {shown(ahead)}{tail}")
    verdict = True if all(holds) else False if False in holds else None
    yield Finding(f"In each of these {len(cities)} cities {first} {said}.", verdict, "; ".join(evidence))
    if len(cities) < FEWEST_GROUPS:
        many = f"{len(cities)} cities are too few for an interval over cities, at least {FEWEST_GROUPS} are needed"
        yield Finding(f"In cities in general {first} {said}.", None, many)
        return
    wide = metrics.pivot(index=list(ROUTE_KEY), columns="weight_name", values=column).reset_index()
    drawn, others = Drawn(wide), [name for name in metrics.weight_name.unique() if name != first]
    leads = [drawn.interval(wide[first] - wide[name], over_cities=True) for name in others]
    least = min(leads, key=lambda lead: np.nan_to_num(lead.low, nan=-np.inf))
    evidence_of = f"ahead of every other weight by at least {shown(least)} of the cost, cities drawn too"
    yield Finding(f"In cities in general {first} {said}.", above(least), evidence_of)


def _sizes(weights: pd.DataFrame, wrong: float) -> Iterator[Finding]:
    for name, part in weights[weights.varies].groupby("weight_name", sort=False):
        drawn = Drawn(part)
        lost = drawn.interval(part.regret)
        small = above(lost, SMALL)
        yield Finding(
            f"A weight of {name} that is {wrong:g} times wrong costs less than {SMALL:.0%} on average.",
            None if small is None else not small,
            f"mean regret {shown(lost, '.2%')}",
        )
        changes = drawn.interval((part.nearest <= wrong).astype(float), share_of)
        yield Finding(
            f"Most routes change where the weight of {name} is up to {wrong:g} times wrong.",
            above(changes, MOST),
            f"{shown(changes, '.0%')} of the routes",
        )


def _altitudes(weights: pd.DataFrame) -> Iterator[Finding]:
    altitudes = sorted(weights.altitude_m.unique())
    if len(altitudes) < 2:
        return
    low, high = altitudes[0], altitudes[-1]
    for column, said in (("elasticity", "has a larger share of the cost"), ("regret", "costs more when wrong")):
        for name, part in weights[weights.weight_name != "distance"].groupby("weight_name", sort=False):
            wide = part.pivot(index=["city", "instance"], columns="altitude_m", values=column)
            both = wide.reindex(columns=[low, high]).dropna().reset_index()  # a layer may be at one of them only
            if len(both):
                more = Drawn(both).interval(both[low] - both[high])
                claim = f"The weight of {name} {said} at {low:g} m than at {high:g} m."
                yield Finding(claim, above(more), f"by {shown(more, '.2%')}, pair by pair")


def _strata(weights: pd.DataFrame, wrong: float) -> Iterator[Finding]:
    varied = weights[weights.varies]
    strata = sorted(by_stratum(varied).stratum.unique()) if len(varied) else []
    if len(strata) < 2:
        return
    name = str(varied.groupby("weight_name").regret.mean().idxmax())
    part = varied[varied.weight_name == name].reset_index(drop=True)
    drawn = Drawn(part)
    for stratum in strata:
        is_in = ((part.start_stratum == stratum) | (part.goal_stratum == stratum)).to_numpy()
        if 0 < is_in.sum() < len(is_in):
            more = drawn.difference(part.regret, is_in)
            claim = f"A wrong weight of {name} costs more on routes that start or end in places of stratum {stratum!r}."
            yield Finding(claim, above(more), f"by {shown(more, '.2%')} than on the others ({is_in.sum()} routes)")


def _outcomes(shares: pd.DataFrame) -> Iterator[Finding]:
    for outcome, part in shares.groupby("outcome", sort=False):
        known = part[part.total.notna()]
        if known.weight_name.nunique() > 1:
            first, second, ahead = leaders(known, "total")
            label = outcome_label(str(outcome))
            claim = f"{label[0].upper()}{label[1:]} of the route depends most on the weight of {first}."
            evidence = f"its total Sobol share is ahead of that of {second} by {shown(ahead, '.2f')}"
            yield Finding(claim, above(ahead), evidence)


def _remade(remade: pd.DataFrame) -> Iterator[Finding]:
    has_cities = (remade.cut == "city").any() and remade[remade.cut == "city"].of.nunique() > 1
    for row in each(remade):
        if row.cut == (ALL if row.changed != HEIGHTS or not has_cities else "city"):
            said = change_said(row.changed, row.factor)
            where = f"in {row.of} " if row.cut == "city" else ""  # how well heights are known differs from city to city
            yield from _change(row, where, said)


def change_said(changed: str, factor: float) -> str:
    """Return what was changed in maps that were made anew, in words."""
    if changed == HEIGHTS:
        return "heights drawn as well as they are known"
    return f"a {changed} of {factor:g} times its value"


def _change(row: Any, where: str, said: str) -> Iterable[Finding]:
    """Yield the two claims on one change: whether it changes most routes, and what that costs."""
    other, lost = (
        Interval(getattr(row, name), getattr(row, f"{name}_low"), getattr(row, f"{name}_high"))
        for name in ("is_other", "nominal_regret")
    )
    verb = "change" if row.changed == HEIGHTS else "changes"
    small = above(lost, SMALL)
    changes = f"{where}{said} {verb} most routes."
    yield Finding(f"{changes[0].upper()}{changes[1:]}", above(other, MOST), f"{shown(other, '.0%')} of the routes")
    closed = "" if row.nominal_is_closed == 0 else f"; {row.nominal_is_closed:.0%} of them are closed there"
    costs = f"{where}with {said}, the routes of the nominal maps cost less than {SMALL:.0%} too much."
    yield Finding(
        f"{costs[0].upper()}{costs[1:]}",
        None if small is None else not small,
        f"mean regret {shown(lost, '.2%')} on the maps made anew{closed}",
    )
