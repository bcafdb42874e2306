"""What a weight study supports and what not: each claim, whether the routes bear it out, and the numbers.

Claims are many, and weights are named as the first of several on the routes that are tested: there the one-sided p is
multiplied by the number of weights that could have been named, and Holm's correction is over all claims.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jaxurban.studies.bootstrap import FEWEST_GROUPS, LEVEL, Interval, holm, p_value, share_of
from jaxurban.studies.montecarlo.analysis import each
from jaxurban.studies.outcomes import outcome_label
from jaxurban.studies.sensitivity.remade import HEIGHTS
from jaxurban.studies.sensitivity.routes import ROUTE_KEY
from jaxurban.studies.sensitivity.summary import ALL, Drawn, by_stratum

SMALL = 0.01  # of a cost: a regret below this is called small
MOST = 0.5


class Finding(NamedTuple):
    """A claim and what the numbers say: ``holds`` is None where they cannot tell."""

    claim: str
    holds: bool | None
    evidence: str


class Claim(NamedTuple):
    """A sentence and its test.

    Attributes:
      claim: the sentence.
      is_above: whether it says that the number lies above ``value``, or below.
      p: of ``value``, two-sided (see `leader` for claims that are picked); NaN where untested.
      evidence: the number with its interval, in words.
      interval: the number.
      value: that it is compared with.
    """

    claim: str
    is_above: bool
    p: float
    evidence: str
    interval: Interval
    value: float = 0.0


def findings(
    weights: pd.DataFrame, shares: pd.DataFrame | None, remade: pd.DataFrame | None, wrong: float
) -> list[Finding]:
    """Return every claim that was looked at: ``holds`` is True, False, or None where the routes cannot tell.

    A claim is decided where its p, adjusted by Holm's method over all claims, is below 0.05.

    Args:
      weights: from `summary.weights_table`.
      shares: from `summary.shares_table`.
      remade: from `summary.summarise_remade`.
      wrong: factor of a wrong weight.
    """
    claims = [*_ranking(weights, wrong), *_sizes(weights, wrong), *_altitudes(weights), *_strata(weights)]
    if shares is not None:
        claims += _outcomes(shares)
    if remade is not None:
        claims += _remade(remade)
    adjusted = holm([claim.p for claim in claims])
    return [_judged(claim, p) for claim, p in zip(claims, adjusted.tolist(), strict=True)]


def _judged(claim: Claim, p: float) -> Finding:
    if np.isnan(p):
        return Finding(claim.claim, None, claim.evidence)
    holds = (claim.interval.mean > claim.value) == claim.is_above if p < 1 - LEVEL else None
    return Finding(claim.claim, holds, f"{claim.evidence}; p {f'= {p:.2g}' if p >= 1e-4 else '< 0.0001'} by Holm")


def shown(interval: Interval, kind: str = ".1%") -> str:
    """Return a number with its interval in brackets, or that there is none."""
    if not np.isfinite(interval.mean):
        return "unknown: no route has both"
    if not np.isfinite(interval.low):
        return f"{interval.mean:{kind}} (no interval: too few pairs)"
    return f"{interval.mean:{kind}} ({interval.low:{kind}} to {interval.high:{kind}})"


def leader(rows: pd.DataFrame, column: str, claim: str, kind: str, *, over_cities: bool = False) -> Iterator[Claim]:
    """Yield the claim that the weight of the largest mean of a column is ahead of every other one, where there are two.

    Weights that some city lacks are left out. Leads are paired, route by route. The p is that of the least clear
    lead, one-sided, times the number of weights that could have been named.

    Args:
      rows: a row a route and weight.
      column: whose means are compared.
      claim: the sentence, with ``{first}`` for the weight.
      kind: format of a lead.
      over_cities: whole cities are drawn.
    """
    wide = rows.pivot(index=list(ROUTE_KEY), columns="weight_name", values=column)
    wide = wide.loc[:, wide.notna().groupby(level="city").any().all()]
    if wide.shape[1] < 2:
        return
    first = str(wide.mean().idxmax())
    tests = []
    for name in map(str, wide.columns.drop(first)):
        both = wide[[first, name]].dropna().reset_index()
        drawn = Drawn(both)
        lead = drawn.interval(both[first] - both[name], over_cities=over_cities)
        tests.append((p_value(lead, 0.0, drawn.num_cities if over_cities else drawn.num_groups), name, lead))
    p, second, lead = max(tests, key=lambda test: np.nan_to_num(test[0], nan=np.inf))
    evidence = f"ahead of {second} by {shown(lead, kind)}"
    yield Claim(claim.format(first=first), True, float(np.minimum(1.0, p / 2 * len(wide.columns))), evidence, lead)


def _ranking(weights: pd.DataFrame, wrong: float) -> Iterator[Claim]:
    varied, costs = weights[weights.varies & weights.regret.notna()], f"costs most when {wrong:g} times wrong."
    yield from leader(varied, "regret", f"Of all weights, that of {{first}} {costs}", ".2%")
    cities = varied.city.nunique()
    if cities < 2:
        return
    for city, rows in varied.groupby("city", sort=False):
        yield from leader(rows, "regret", f"In {city} the weight of {{first}} {costs}", ".2%")
    few = f"{cities} cities are too few for an interval over cities, at least {FEWEST_GROUPS} are needed"
    claim = f"In cities in general the weight of {{first}} {costs}"
    for general in leader(varied, "regret", claim, ".2%", over_cities=True):
        yield general if cities >= FEWEST_GROUPS else general._replace(p=np.nan, evidence=few)


def _sizes(weights: pd.DataFrame, wrong: float) -> Iterator[Claim]:
    for name, part in weights[weights.varies].groupby("weight_name", sort=False):
        drawn = Drawn(part)
        lost, changes = drawn.interval(part.regret), drawn.interval((part.nearest <= wrong).astype(float), share_of)
        claim = f"A weight of {name} that is {wrong:g} times wrong costs less than {SMALL:.0%} on average."
        yield _test(claim, False, lost, SMALL, drawn.num_groups, f"mean regret {shown(lost, '.2%')}")
        claim = f"Most routes change where the weight of {name} is up to {wrong:g} times wrong."
        yield _test(claim, True, changes, MOST, drawn.num_groups, f"{shown(changes, '.0%')} of the routes")


def _test(claim: str, is_above: bool, interval: Interval, value: float, num_groups: int, evidence: str) -> Claim:
    return Claim(claim, is_above, p_value(interval, value, num_groups), evidence, interval, value)


def _altitudes(weights: pd.DataFrame) -> Iterator[Claim]:
    altitudes = sorted(weights.altitude_m.unique())
    if len(altitudes) < 2:
        return
    low, high = altitudes[0], altitudes[-1]
    for name, part in weights[weights.varies].groupby("weight_name", sort=False):
        wide = part.pivot(index=["city", "instance"], columns="altitude_m", values="regret")
        both = wide.reindex(columns=[low, high]).dropna().reset_index()  # a layer may be at one of them only
        if len(both):
            drawn = Drawn(both)
            more = drawn.interval(both[low] - both[high])
            claim = f"A wrong weight of {name} costs more at {low:g} m than at {high:g} m."
            yield _test(claim, True, more, 0.0, drawn.num_groups, f"by {shown(more, '.2%')}, pair by pair")


def _strata(weights: pd.DataFrame) -> Iterator[Claim]:
    """Yield claims on every weight and stratum: those of the costliest weight alone would be picked."""
    varied = weights[weights.varies]
    strata = sorted(by_stratum(varied).stratum.unique()) if len(varied) else []
    for name, rows in varied.groupby("weight_name", sort=False):
        part = rows.reset_index(drop=True)
        drawn = Drawn(part)
        for stratum in strata if len(strata) > 1 else ():
            is_in = ((part.start_stratum == stratum) | (part.goal_stratum == stratum)).to_numpy()
            if 0 < is_in.sum() < len(is_in):
                more, num_groups = drawn.difference(part.regret, is_in)
                claim = f"A wrong weight of {name} costs more on routes that start or end in places of {stratum!r}."
                evidence = f"by {shown(more, '.2%')} than on the others ({is_in.sum()} routes)"
                yield _test(claim, True, more, 0.0, num_groups, evidence)


def _outcomes(shares: pd.DataFrame) -> Iterator[Claim]:
    for outcome, part in shares.groupby("outcome", sort=False):
        label = outcome_label(str(outcome))
        claim = f"{label[0].upper()}{label[1:]} of the route depends most on the weight of {{first}}."
        for first in leader(part[part.total.notna()], "total", claim, ".2f"):
            yield first._replace(evidence=f"its total Sobol share is {first.evidence}")


def _remade(remade: pd.DataFrame) -> Iterator[Claim]:
    has_cities = (remade.cut == "city").any() and remade[remade.cut == "city"].of.nunique() > 1
    for row in each(remade):
        if row.cut == (ALL if row.changed != HEIGHTS or not has_cities else "city"):
            where = f"in {row.of} " if row.cut == "city" else ""  # how well heights are known differs from city to city
            yield from _change(row, where, change_said(row.changed, row.factor))


def change_said(changed: str, factor: float) -> str:
    """Return what was changed in perturbed maps, in words."""
    if changed == HEIGHTS:
        return "heights drawn as well as they are known"
    return f"a {changed} of {factor:g} times its value"


def _change(row: Any, where: str, said: str) -> Iterator[Claim]:
    """Yield the two claims on one change: whether it changes most routes, and what that costs."""
    other, lost = (
        Interval(getattr(row, name), getattr(row, f"{name}_low"), getattr(row, f"{name}_high"))
        for name in ("is_other", "nominal_regret")
    )
    verb = "change" if row.changed == HEIGHTS else "changes"
    changes = f"{where}{said} {verb} most routes."
    evidence = f"{shown(other, '.0%')} of the routes"
    yield _test(f"{changes[0].upper()}{changes[1:]}", True, other, MOST, row.groups, evidence)
    closed = "" if row.nominal_is_closed == 0 else f"; {row.nominal_is_closed:.0%} of them are closed there"
    costs = f"{where}with {said}, the routes of the nominal maps cost less than {SMALL:.0%} too much."
    evidence = f"mean regret {shown(lost, '.2%')} on the perturbed maps{closed}"
    yield _test(f"{costs[0].upper()}{costs[1:]}", False, lost, SMALL, row.groups, evidence)
