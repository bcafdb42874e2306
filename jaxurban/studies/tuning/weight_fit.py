"""Weights fitted to demonstrations: those under which the routes that were shown are cheapest."""

import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
import pandas as pd

from jaxurban.checks import at_least, typed
from jaxurban.knowledge import Caution
from jaxurban.metrics.weights import Weights
from jaxurban.progress import reporting
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, Clusters, Interval
from jaxurban.statistics.conclusions import Conclusion, Verdict
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import (
    RouteQuery,
    check_alike,
    command_to_vary,
    maps_of,
    weight_units,
    weights_from,
)
from jaxurban.studies.route_pool import FitSettings, RoutePool
from jaxurban.studies.tuning.confidence import (
    FitVerdict,
    constant_layers,
    feature_units,
    indistinct_weights,
    without_dust,
)
from jaxurban.studies.tuning.fenchel_young import trust_of, usual_regret
from jaxurban.studies.tuning.fitted import GIVEN, FitResult
from jaxurban.studies.tuning.tested import PAIRS, FitCommands, split
from jaxurban.studies.tuning.weight_fit_rounds import (
    FitUnderWay,
    city_numbers,
    refitted,
    run_rounds,
    searched_regret,
)
from jaxurban.studies.weights.settings import SensitivitySettings

# Demonstrations above it on average are not optimal under any weights. Of lines that were redrawn, what redrawing adds
# is left out first; among routes at any angle another one is the cheapest than on the grid, by less than the second.
OPTIMAL_REGRET, OPTIMAL_DRAWN_REGRET = 0.005, 0.01
IN_PYTHON = FitCommands("ju.fit.fit_weights(demonstrations, hold_out={share})")
DIGITS = 6  # of percents; what is less is rounding
FEW = 2  # demonstrations per weight
WIDE = 6  # a weight whose interval spans a larger factor is hardly pinned down
DISTRUSTED = 0.1  # a demonstration that is trusted less is bad: it hardly counts
NEGLIGIBLE = 1e-3  # share of all metrics in the cost: without them no regret changes by more
SMALL = 0.05  # share of the least cost of routes: a weight that adds no more where c is 1 everywhere is next to 0


@dataclass(frozen=True, eq=False, repr=False)
class WeightFit(FitResult):
    """Weights fitted to demonstrations. ``K`` weights, ``Q`` demonstrations that were fitted of ``N``.

    Attributes:
      names: ``"distance"`` and the metrics.
      weights: they sum to 1; 0 for a metric whose weight cannot be identified.
      table: a row for each weight, by its name. ``weight``; ``low`` and ``high``, the 5th and the 95th percentile over
        bootstrap fits, widened to all weights that explain the demonstrations as well (of lines that were redrawn on
        the grid: that explain any routes within 3 cells of them as well), NaN without bootstrap; ``share_of_cost``, the
        part of the demonstrations' cost that the weight makes up; ``spread``, w_j x std(phi_j) over the demonstrations,
        scaled so that all of them have the length 1 together, by which fits can be compared; ``pilot``, the weights
        under which all routes were planned, scaled to sum 1, NaN where these are not on record, several, or all 0;
        ``unit``, per what it is.
      draws: ``[B, K]`` the weights of the bootstrap fits.
      regret: ``[Q]`` by which share each demonstration costs more than the cheapest route that a search finds under
        the weights.
      trust: ``[Q]`` in [0, 1] the weight that each demonstration had in the end.
      best_mean_regret: the least mean regret that any weights were found to reach.
      curve: a row for each round: noise, loss, mean_regret, worst_gap (by which share a searched route was cheaper than
        all known ones), new_routes, num_plans, elapsed_s and each weight.
      sentence: whether the demonstrations follow these metrics at all: what a reader must know before the weights.
      verdicts: what the demonstrations do not decide of the weights; ``unidentified`` has their sentences.
      warnings: further sentences that a reader must know.
      num_plans: number of searches made.
      elapsed_s: wall time.
      is_settled: whether the last round bettered no known route by more than 1e-5.
      is_held_out: ``[N]`` bool: the demonstrations that the weights were not fitted to.
      tested: by which share these cost more than the cheapest ones on average, with its interval over pairs of ends
        (some 90 %, as regrets are skewed), bad ones left out; NaN where there are none.
      not_cheapest: the share of these that are not the cheapest, with its interval.
      num_tested: pairs of ends that both rest on.
      num_held_out, num_pairs: pairs of ends that were held out, and of all demonstrations.
      routes: the ``Q`` demonstrations that were fitted.
      others: those that were held out; ``others_regret`` and ``others_trust`` are the regret and the trust of each.
      commands: what fits again.
      origin: of the routes, in words.

    Examples:
      >>> routes = ju.fit.demonstrations(path, maps)
      >>> fit = ju.fit.fit_weights(routes, bootstrap=0, settings=ju.fit.FitSettings(max_rounds=2))
      >>> dict(zip(fit.names, fit.vector.round(2).tolist(), strict=True)) == fit.table["weight"].round(2).to_dict()
      True
      >>> again = ju.plan(maps, start, goal, altitude_m=60.0, weights=fit.weights)
    """

    names: tuple[str, ...]
    weights: Weights
    table: pd.DataFrame
    draws: np.ndarray
    regret: np.ndarray
    trust: np.ndarray
    best_mean_regret: float
    curve: pd.DataFrame
    sentence: str
    verdicts: tuple[Verdict, ...]
    warnings: tuple[str, ...]
    num_plans: int
    elapsed_s: float
    is_settled: bool
    is_held_out: np.ndarray
    tested: Interval
    not_cheapest: Interval
    num_tested: int
    num_held_out: int
    num_pairs: int
    routes: tuple[Demonstration, ...]
    others: tuple[Demonstration, ...]
    others_regret: np.ndarray
    others_trust: np.ndarray
    commands: FitCommands = IN_PYTHON
    origin: str = GIVEN

    @property
    def vector(self) -> np.ndarray:
        """``[K]`` the weights in the order of ``names``."""
        return self.weights.vector(self.names)

    @property
    def unidentified(self) -> tuple[str, ...]:
        """Sentences on weights that the demonstrations say nothing about."""
        return tuple(f"{each.sentence}." for each in self.verdicts if not each.is_decided)

    @property
    def decided(self) -> Conclusion:
        """How far routes that were held out follow the weights, which of these are known, and which are not."""
        tested = self.tested if self.num_tested else Interval(self.regret.mean(), np.nan, np.nan)
        size, low, high = (100 * np.array(tested)).round(DIGITS).tolist()
        num = self.num_tested or len(self.regret)
        command = ""
        if np.isnan(low):
            # As many pairs of ends as have an interval, beside the outliers, which do not count.
            needed = max(FEWEST_GROUPS, self.num_tested + 1) + self.num_held_out - self.num_tested
            open_size = Verdict(FitVerdict.UNTESTED, (), size, n=num, unit="%", needed=np.nan)
            verdicts = [replace(open_size, facts={"takes": needed})]
            command = self.commands.holding_out(
                needed, self.num_pairs, self.num_held_out / self.num_pairs
            )
        else:
            facts = {"most": 100 * self.not_cheapest.high, "left_out": self._left_out}
            about = size, low, high, num, "%", PAIRS
            verdicts = [Verdict(FitVerdict.FOLLOWED, (), *about, facts=facts)]

        # The weights that are known, those of the largest shares of the cost first, and what the routes cannot say.
        judged = {name: verdict.needed for verdict in self.verdicts for name in verdict.what}
        table = self.table.sort_values("share_of_cost", ascending=False)
        known = table[np.isfinite(table.high) & ~table.index.isin([*judged])]
        num = len(self.routes)
        verdicts += [_weight_verdict(FitVerdict.WEIGHED, row, num) for row in known.itertuples()]
        verdicts += self.verdicts

        # Where no further fit decides more: whether what is open matters to routes, unless nothing can say it. An open
        # weight whose interval reaches further up than the factors of that study do is asked about at the upper end.
        if not command and not all(each.needed in (0, np.inf) for each in verdicts):
            query = self.queries[0]
            folder = self.commands.folder or str(query.cost_map.maps.folder or "DIR")
            is_open = self.table.index.map(judged) != 0  # NaN of what further fits do not decide
            reached = self.table.weight * SensitivitySettings().factors[1]
            is_beyond = is_open & np.isfinite(self.table.high) & (reached < self.table.high)
            asked = self.table.weight.mask(is_beyond, self.table.high)
            weights = weights_from(query, asked.to_numpy())
            is_length_open = judged.get("distance", 0.0) != 0
            command = command_to_vary(query, weights, f"{folder}-weights", is_length_open)
        return Conclusion((*verdicts, *self.border), command or self.last_command)

    @property
    def _left_out(self) -> str:
        """Words on the routes that were held out and hardly count, with their regrets; empty where all count."""
        regret = 100 * self.others_regret
        bad = regret[self.others_trust < DISTRUSTED]
        if not len(bad):
            return ""
        return (
            f"; not counted: {len(bad)} of {len(regret)} routes, with up to {bad.max():.2g} % more; all of them have "
            f"{regret.mean():.2g} % on average"
        )

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, and whether the routes follow these metrics at all."""
        return self.decided.facts | {"fit": self.sentence}

    @property
    def cautions(self) -> list[Caution]:
        """What the demonstrations cannot say: ``unidentified`` and ``warnings``."""
        return [Caution(text, "guess") for text in (*self.unidentified, *self.warnings)]


@typed
def fit_weights(
    demonstrations: Sequence[Demonstration],
    *,
    hold_out: float | None = 0.0,
    bootstrap: int = 200,
    settings: FitSettings | None = None,
) -> WeightFit:
    """Return the weights under which demonstrated routes are as close to cheapest as any weights make them.

    A perturbed Fenchel-Young loss is minimised by gradient in log weights, over the routes found so far. Rounds of
    searches under the current and under perturbed weights find more routes, until a round finds no cheaper one. The
    noise shrinks from round to round: wide noise leads from anywhere, narrow noise ends near the middle of the weights
    that explain the demonstrations. From there the mean regret itself is minimised, and demonstrations that stay far
    costlier than most are trusted less (a redescending weight on their regret), so that some detours do not bend the
    fit.

    Only the direction of W can be found; weights sum to 1. The weight of a layer that is constant
    over the maps cannot be identified, and ``unidentified`` says so: under ``line`` (or where it costs nothing) it
    is left at 0; under ``cell`` such a layer counts steps, which diagonals save, and the fit takes that into account.

    Args:
      demonstrations: from `demonstrations`; of one or several maps.
      hold_out: share of the demonstrations of each city, from 0 to 0.9, that the weights are not fitted to, to test
        them; those between the same cells stay together. None: a quarter from 16 routes on, of fewer none.
      bootstrap: fits on demonstrations drawn with replacement, for intervals, cities first where there are several; 0
        for none.
      settings: of the search. The noise shrinks over 7 rounds, patience with far costlier demonstrations over 6 more;
        after them it ends where a round betters nothing.

    Returns:
      ``weights``, which `jaxurban.plan` takes; ``table``, a row for each weight with its interval and its share of the
      cost; ``regret``, by which share each demonstration costs more than the cheapest route; ``unidentified`` and
      ``warnings``, sentences on what the routes cannot say. Printed, it shows the table and the sentences.

    Raises:
      InputError: no demonstrations, maps that do not go together, too few to hold some out, or a wrong setting.

    Examples:
      >>> back = ju.plan(maps, goal, start, altitude_m=60.0)
      >>> routes = ju.fit.demonstrations([path, back], maps)
      >>> fit = ju.fit.fit_weights(routes, bootstrap=0, settings=ju.fit.FitSettings(max_rounds=5))
      >>> fit.regret.round(2).tolist(), round(float(fit.vector.sum()), 3)
      ([0.0, 0.0], 1.0)
      >>> list(fit.table.columns)
      ['weight', 'low', 'high', 'share_of_cost', 'spread', 'pilot', 'unit']
    """
    at_least("bootstrap", bootstrap)
    begin_s = time.perf_counter()
    settings = settings or FitSettings()

    # The demonstrations that are held out, those between the same ends together, and those that are fitted.
    check_alike([each.query for each in demonstrations])
    city = city_numbers(demonstrations)
    ends = [(each.query.start, each.query.goal) for each in demonstrations]
    group, _ = pd.factorize(pd.Series(list(zip(city.tolist(), ends, strict=True))))
    is_held_out = split(city, group, hold_out, settings.seed)
    held_out = list(itertools.compress(demonstrations, is_held_out))
    demonstrations = list(itertools.compress(demonstrations, ~is_held_out))

    # The weights that can be fitted: of a layer that is the same everywhere demonstrations say nothing.
    queries = [demonstration.query for demonstration in demonstrations]
    names = check_alike(queries)
    constant = constant_layers(queries)
    left_out = _left_out(constant, queries)
    is_fitted = np.array([name not in left_out for name in names])

    # The rounds, the weights [K] without dust, then the regret [Q] of each demonstration, the least mean regret of any
    # weights, and refits for the intervals.
    fit = FitUnderWay(demonstrations, is_fitted, settings)
    with jax.enable_x64(True), reporting("fit", settings.progress) as report:
        curve, is_settled = run_rounds(fit, settings, begin_s, report)
        weights = without_dust(fit.weights, fit.pool)
        regret = searched_regret(fit.pool, fit.demo, weights)
        best = fit.least_mean_regret(float(regret.mean()))
        draws, interval = refitted(fit, bootstrap)

    # What each weight costs on average, and how much that differs between demonstrations.
    cost = weights * fit.demo.mean(axis=0)
    spread = weights * fit.demo.std(axis=0)
    table = pd.DataFrame(
        {
            "weight": weights,
            "low": np.minimum(interval[0], weights),
            "high": np.maximum(interval[1], weights),
            "share_of_cost": cost / cost.sum(),
            "spread": spread / max(float(np.linalg.norm(spread)), 1e-300),  # 0 / 0 is 0
            "pilot": _pilot(demonstrations, names),
            "unit": weight_units(queries[0].cost_map),
        },
        pd.Index(names, name="name"),
    )

    # Sentences on what the fit says, and on what it cannot say.
    open_weights = []
    for name in constant:
        kind = FitVerdict.CONSTANT if name in left_out else FitVerdict.STEPS
        open_weights.append(Verdict(kind, (name,), needed=np.inf))
    highest = table.high * feature_units(queries, fit.demo, least=1.0)
    is_small = highest <= SMALL * (table.low @ fit.unit)
    open_weights += _wide_weights(
        table.assign(is_small=is_small).drop([*constant]), len(demonstrations)
    )
    open_weights += indistinct_weights(fit.pool, fit.unit, weights, is_fitted)
    # The regret without what redrawing on the grid adds: that of the cheapest route near each demonstration.
    near = np.array([each.cheapest_near(weights) for each in demonstrations])
    near_regret = (1 + regret) * (near @ weights) / (fit.demo @ weights) - 1
    drawn_cells = [each.drawn_cells for each in demonstrations]
    bar = float(np.where(drawn_cells, OPTIMAL_DRAWN_REGRET, OPTIMAL_REGRET).mean())
    metric_share = 1 - table.share_of_cost["distance"]
    verdict = _verdict_sentence(near_regret, bar, fit.trust, best, metric_share)
    warnings = _warning_sentences(demonstrations, names, fit.trust, is_settled)

    # The regret of those that are held out. One far above the usual one of those that were fitted is bad.
    fitted = weights_from(queries[0], table.weight.to_numpy())
    others_regret = np.empty(0)
    if held_out:
        pool = RoutePool([each.query for each in held_out])
        demo = np.array([each.features for each in held_out])
        others_regret = searched_regret(pool, demo, fitted.vector(names))
    others_trust = trust_of(others_regret, usual_regret(regret))
    is_tested = others_trust >= DISTRUSTED
    num_held_out = len(np.unique(group[is_held_out]))
    num_pairs = len(np.unique(group))
    group, city = (each[is_held_out][is_tested] for each in (group, city))
    pairs = Clusters(group, city, settings.seed)
    tested = others_regret[is_tested]
    is_above = (100 * tested).round(DIGITS) > 0
    return WeightFit(
        names=names,
        weights=fitted,
        table=table,
        draws=draws,
        regret=regret,
        trust=fit.trust,
        best_mean_regret=best,
        curve=curve,
        sentence=verdict,
        verdicts=tuple(open_weights),
        warnings=tuple(warnings),
        num_plans=fit.pool.num_plans,
        elapsed_s=time.perf_counter() - begin_s,
        is_settled=is_settled,
        is_held_out=is_held_out,
        tested=pairs.interval(tested),
        not_cheapest=pairs.interval(is_above.astype(float), "share"),
        num_tested=len(np.unique(group)),
        num_held_out=num_held_out,
        num_pairs=num_pairs,
        routes=tuple(demonstrations),
        others=tuple(held_out),
        others_regret=others_regret,
        others_trust=others_trust,
    )


def _pilot(demonstrations: Sequence[Demonstration], names: Sequence[str]) -> np.ndarray:
    """Return ``[K]`` the weights under which all routes were planned, scaled to sum 1.

    They are NaN if not all routes were planned under one W, or if it weighs nothing that the fit weighs.
    """
    pilots = {each.pilot for each in demonstrations}
    pilot = pilots.pop()
    if pilot is None or pilots or _weighs_nothing(pilot, names):
        return np.full(len(names), np.nan)
    vector = pilot.vector(names)
    return vector / vector.sum()


def _weighs_nothing(pilot: Weights | None, names: Sequence[str]) -> bool:
    """Return whether a pilot is known and every weight of these names is 0."""
    return pilot is not None and not pilot.vector(names).any()


def _left_out(constant: Sequence[str], queries: Sequence[RouteQuery]) -> set[str]:
    """Return which of the constant layers get the weight 0.

    Under the cost model ``line`` these are all of them. Under ``cell`` a constant cost still counts steps, of which
    diagonals save some, and to leave it out would bend the other weights: only layers that cost nothing are left out.

    Args:
      constant: names of the layers that are the same everywhere (`constant_layers`).
      queries: whose maps and cost model count; at least one.
    """
    if queries[0].cost_map.cost_model.kind != "cell":
        return set(constant)
    costing = set()
    for cost_map in maps_of(queries):
        is_costing = cost_map.costs[:, cost_map.is_free].any(axis=1)
        costing.update(np.array(cost_map.names)[is_costing].tolist())
    return set(constant) - costing


def _wide_weights(table: pd.DataFrame, num: int) -> Iterator[Verdict]:
    """Yield which weights the demonstrations leave open within a wide range, and which they say are next to 0.

    Args:
      table: of the weights; ``is_small`` where the upper end of the interval costs next to nothing anywhere.
      num: of demonstrations.
    """
    is_wide = np.isfinite(table.high) & (table.high > 0) & (table.low < table.high / WIDE)
    for row in table[is_wide].itertuples():
        kind, needed = (FitVerdict.AT_MOST, 0.0) if row.is_small else (FitVerdict.WIDE, np.nan)
        yield _weight_verdict(kind, row, num, needed)


def _weight_verdict(kind: FitVerdict, row: Any, num: int, needed: float = 0.0) -> Verdict:
    """Return the verdict on a weight, by its row of a table, from a number of routes."""
    facts = {"high": f"{row.high:.2g}", "share": f"{100 * SMALL:g} %"}
    return Verdict(
        kind, (row.Index,), row.weight, row.low, row.high, num, needed=needed, facts=facts
    )


def _verdict_sentence(
    regret: np.ndarray, bar: float, trust: np.ndarray, best: float, metric_share: float
) -> str:
    """Return a sentence on whether the demonstrations follow the metrics, most of them do, or they do not.

    Args:
      regret: ``[Q]`` of each demonstration under the fitted weights, a share of the cheapest cost, without what
        redrawing it on the grid adds.
      bar: the mean of that regret up to which the routes follow.
      trust: ``[Q]`` in the end, from 0 to 1.
      best: the least mean regret that any weights reach, with what redrawing adds.
      metric_share: of the metrics in the cost; where it is negligible the routes follow distance alone.
    """
    percent = round(max(0.0, 100 * best), 4)  # rounding may bring it below 0
    share = f"at best they cost {percent:.3g} % more than the cheapest ones between their ends, on average"
    added = round(percent - 100 * regret.mean(), 2)
    if added > 0:
        share += f", of which redrawing them on the grid adds {added:.3g} %"
    if min(best, regret.mean()) <= bar and metric_share <= NEGLIGIBLE:
        return (
            f"Distance alone explains the fitted routes as well as any of these metrics: {share}."
        )
    if min(best, regret.mean()) <= bar:
        return f"These routes follow these metrics: {share}."
    is_trusted = trust >= DISTRUSTED
    if is_trusted.mean() > 0.5 and regret[is_trusted].mean() <= bar:
        followed = "the distance alone" if metric_share <= NEGLIGIBLE else "these metrics"
        return f"Most of these routes, {is_trusted.sum()} of {len(trust)}, follow {followed}; with the others {share}."
    return f"These routes do not follow these metrics: {share}, under any weights that were found."


def _warning_sentences(
    demonstrations: Sequence[Demonstration],
    names: Sequence[str],
    trust: np.ndarray,
    is_settled: bool,
) -> Iterator[str]:
    """Yield the further sentences that a reader of the fit must know: few, bad or altered routes, an unfinished search.

    Args:
      demonstrations: all, of which those with a note have a sentence each.
      names: ``[K]`` of the weights.
      trust: ``[Q]`` in the end.
      is_settled: the last round found no better routes.
    """
    num = len(demonstrations)
    num_strange = sum(_weighs_nothing(each.pilot, names) for each in demonstrations)
    if num_strange:
        yield (
            f"The pilot of {num_strange} of {num} demonstrations gives no weight to any of {', '.join(names)}, so that "
            "the fitted weights cannot be set beside the pilot's: fit the metrics that it weighs (--metrics, metrics=)."
        )
    if num < FEW * len(names):
        yield (
            f"There are few demonstrations ({num}) for {len(names)} weights, which are fitted all the same: others of "
            "the same kind may ask for quite other ones."
        )
    num_bad = int((trust < DISTRUSTED).sum())
    if num_bad:
        yield f"{num_bad} of {num} demonstrations cost far more than the others' weights explain, and hardly count."
    if not is_settled:
        yield "The last round still found better routes; its weights are given: allow more rounds or a larger budget."
    for number, demonstration in enumerate(demonstrations, start=1):
        if demonstration.note:
            yield f"Demonstration {demonstration.query.name or number!r}: {demonstration.note}."
