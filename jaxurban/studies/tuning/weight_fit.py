"""Weights fitted to demonstrations: those under which the routes that were shown are cheapest."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from jaxurban.checks import at_least, typed
from jaxurban.io.tables import fingerprint
from jaxurban.metrics.weights import Weights
from jaxurban.progress import reporting
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import RouteQuery, check_alike, maps_of, weights_from
from jaxurban.studies.route_pool import FitSettings, RoutePool, pool_of_fit
from jaxurban.studies.tuning.confidence import (
    constant_layers,
    draw_counts,
    feature_units,
    indistinct_weights,
    near_optimal_range,
    refit,
)
from jaxurban.studies.tuning.fenchel_young import (
    FitTask,
    descend,
    draw_log_noise,
    fenchel_young_loss,
    mean_regret,
    regrets,
    trust_of,
    usual_regret,
    weights_of,
)

WeightScale = Literal["simplex", "distance"]
# Standard deviations of log weights: first far from the minimum, in the end close to it.
FIRST_NOISE, LAST_NOISE = 0.3, 0.03
NOISE_ROUNDS = 7  # in which the noise shrinks
# Noises per query in the loss; searches per query and round under perturbed weights.
NUM_NOISE, NUM_PROBES = 32, 2
STEPS, BOOTSTRAP_NOISE = 200, 8
FEW = 2  # demonstrations per weight
TRUST_ROUNDS, DOUBT_ROUNDS = 7, 6  # of full trust; in which patience then falls to 1
FIRST_DOUBT = 30.0  # how many times farther off a route may be at first
SETTLED = 1e-5  # a round that betters no known route by more has nothing to add
REGRET_ROUNDS = 4  # searches for the least regret that any weights reach
IN_ROUND, IN_BOOTSTRAP = 1, 2  # streams of random numbers
WIDE = 10  # a weight whose interval spans a larger factor is hardly pinned down
DISTRUSTED = 0.1  # a demonstration that is trusted less is bad: it hardly counts
# Demonstrations above it on average are not optimal under any weights. Of lines that were redrawn, what redrawing adds
# is left out first; among routes at any angle another one is the cheapest than on the grid, by less than the second.
OPTIMAL_REGRET, OPTIMAL_DRAWN_REGRET = 0.005, 0.01
NEGLIGIBLE = 1e-3  # share of all metrics in the cost: without them no regret changes by more


@dataclass(frozen=True, eq=False, repr=False)
class WeightFit:
    """Weights fitted to demonstrations. ``K`` weights, ``Q`` demonstrations.

    Attributes:
      names: ``"distance"`` and the metrics.
      weights: of the given scale; 0 for a metric whose weight cannot be identified.
      table: a row per weight, by its name: ``weight``; ``low`` and ``high``, 5th and 95th percentile over bootstrap
        fits, widened to all weights that explain the demonstrations as well, or, of lines that were redrawn on the
        grid, any routes within 3 cells of them, NaN without bootstrap; ``share_of_cost``, part
        of the demonstrations' cost that it makes up; ``spread``, w_j x std(phi_j) over the demonstrations, scaled to
        length 1: what fits are compared by.
      draws: ``[B, K]`` the weights of the bootstrap fits.
      regret: ``[Q]`` by which share each is costlier than the cheapest route under the weights, by search.
      trust: ``[Q]`` in [0, 1] weight that each demonstration had in the end.
      best_mean_regret: the least mean regret that any weights were found to reach.
      curve: a row per round: noise, loss, mean_regret, worst_gap (by which share a searched route was cheaper than
        all known ones), new_routes, num_plans, elapsed_s and each weight.
      sentence: whether the demonstrations follow these metrics at all: what a reader must know before the weights.
      unidentified: sentences on weights that the demonstrations say nothing about.
      warnings: further sentences that a reader must know.
      num_plans: searches made.
      elapsed_s: wall time of this run; a resumed one takes its first searches from the state file.
      is_settled: the last round bettered no known route by more than 1e-5.

    Examples:
      >>> routes = ju.fit.demonstrations_from_paths([path], maps)
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
    unidentified: tuple[str, ...]
    warnings: tuple[str, ...]
    num_plans: int
    elapsed_s: float
    is_settled: bool

    @property
    def vector(self) -> np.ndarray:
        """``[K]`` the weights in the order of ``names``."""
        return self.weights.vector(self.names)

    @property
    def cautions(self) -> list[str]:
        """What the demonstrations cannot say: ``unidentified`` and ``warnings``, but for the ``sentence``."""
        sentences = self.unidentified + self.warnings
        return [sentence for sentence in sentences if sentence != self.sentence]

    def __repr__(self) -> str:
        table = self.table.to_string(float_format="{:.3g}".format)
        return "\n".join([self.sentence, *self.cautions, table])

    def _repr_html_(self) -> str:
        cautions = "".join(f"<li>{escape(sentence)}</li>" for sentence in self.cautions)
        table = self.table.to_html(float_format="{:.3g}".format)
        return f"<p><b>{escape(self.sentence)}</b></p><ul>{cautions}</ul>{table}"


@typed
def fit_weights(
    demonstrations: Sequence[Demonstration],
    *,
    scale: WeightScale = "simplex",
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

    Only the direction of W can be found; its length is set by ``scale``. The weight of a layer that is constant
    over the maps cannot be identified, and ``unidentified`` says so: under ``line`` (or where it costs nothing) it
    is left at 0; under ``cell`` such a layer counts steps, which diagonals save, and the fit takes that into account.

    Args:
      demonstrations: from `read_demonstrations` or `demonstrations_from_paths`; of one or several maps.
      scale: ``"simplex"``: weights sum to 1; ``"distance"``: the distance weight is 1.
      bootstrap: fits on demonstrations drawn with replacement, for intervals, cities first where there are several; 0
        for none.
      settings: of the search. The noise shrinks over 7 rounds, patience with far costlier demonstrations over 6 more;
        after them it ends where a round betters nothing.

    Returns:
      ``weights``, which `jaxurban.plan` takes; ``table``, a row per weight with its interval and its share of the cost;
      ``regret``, by which share each demonstration costs more than the cheapest route; ``unidentified`` and
      ``warnings``, sentences on what the routes cannot say. Printed, it shows the table and the sentences.

    Raises:
      InputError: no demonstrations, maps that do not go together, or a wrong setting.

    Examples:
      >>> back = ju.plan(maps, goal, start, altitude_m=60.0)
      >>> routes = ju.fit.demonstrations_from_paths([path, back], maps)
      >>> fit = ju.fit.fit_weights(routes, bootstrap=0, settings=ju.fit.FitSettings(max_rounds=5))
      >>> fit.regret.round(2).tolist(), round(float(fit.vector.sum()), 3)
      ([0.0, 0.0], 1.0)
      >>> list(fit.table.columns)
      ['weight', 'low', 'high', 'share_of_cost', 'spread']
    """
    at_least("bootstrap", bootstrap)
    begin_s = time.perf_counter()
    settings = settings or FitSettings()
    demonstrations = list(demonstrations)

    # The weights that can be fitted, and the features of the demonstrations.
    queries = [demonstration.query for demonstration in demonstrations]
    names = check_alike(queries)
    constant = constant_layers(queries)
    left_out = _left_out(constant, queries)
    is_fitted = np.array([name not in left_out for name in names])
    demo = np.array([demonstration.features for demonstration in demonstrations])  # [Q, K]

    # What is fitted over: the routes found so far, beginning with the demonstrations themselves.
    noise_rounds = min(settings.max_rounds, NOISE_ROUNDS)
    pool = pool_of_fit(
        settings,
        queries,
        [demonstration.sums for demonstration in demonstrations],
        fit="imitation",
        noise_rounds=noise_rounds,
        demonstrations=fingerprint(demo),
    )
    unit = np.where(is_fitted, feature_units(queries, demo), 1.0)  # [K] of each feature
    fit = _Fit(pool, demo, unit, is_fitted, settings.seed)

    # Rounds of searches, each a row of the curve, until one betters no known route or the budget ends. Then the regret
    # [Q] of each demonstration, the least mean regret of any weights, and refits for the intervals.
    least_rounds = min(settings.max_rounds, TRUST_ROUNDS + DOUBT_ROUNDS + 1)
    rows = []
    with jax.enable_x64(True), reporting("fit", settings.progress) as report:
        for number in range(settings.max_rounds):
            row = fit.run_round(number, _noise_of(number, noise_rounds))
            row["elapsed_s"] = time.perf_counter() - begin_s
            rows.append(row | dict(zip(names, _scaled(fit.weights, scale), strict=True)))
            report("rounds", number + 1, loss=f"{row['loss']:.3g}", searches=row["num_plans"])
            is_settled = row["worst_gap"] <= SETTLED and number + 1 >= least_rounds
            if is_settled or row["elapsed_s"] > settings.budget_s:
                break
        regret = fit.searched_regret(fit.log_weights)
        best = fit.least_mean_regret(float(regret.mean()))
        draws, interval = _refitted(fit, demonstrations, scale, bootstrap)

    # The regret [Q] without what redrawing adds: that of the cheapest route near each redrawn line.
    near = np.array([each.cheapest_near(fit.weights) for each in demonstrations])
    near_regret = (1 + regret) * (near @ fit.weights) / (demo @ fit.weights) - 1
    drawn_cells = [each.drawn_cells for each in demonstrations]
    bar = float(np.where(drawn_cells, OPTIMAL_DRAWN_REGRET, OPTIMAL_REGRET).mean())

    # What the fit says, and what it cannot say.
    table = _weight_table(fit, scale, interval)
    unidentified = [_constant_sentence(name, name in left_out) for name in constant]
    unidentified += _wide_sentences(table.drop(index=list(constant)))
    unidentified += indistinct_weights(pool, fit.unit, fit.weights, is_fitted)
    metric_share = 1 - table.share_of_cost.iloc[0]
    verdict = _verdict(near_regret, bar, fit.trust, best, metric_share)
    warnings = [verdict] if min(best, near_regret.mean()) > bar else []
    warnings += _warnings(demonstrations, len(names), fit.trust, is_settled)
    return WeightFit(
        names=names,
        weights=weights_from(queries[0], table.weight.to_numpy()),
        table=table,
        draws=draws,
        regret=regret,
        trust=fit.trust,
        best_mean_regret=best,
        curve=pd.DataFrame(rows),
        sentence=verdict,
        unidentified=tuple(unidentified),
        warnings=tuple(warnings),
        num_plans=pool.num_plans,
        elapsed_s=time.perf_counter() - begin_s,
        is_settled=is_settled,
    )


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
    costs = [cost_map.cost_of for cost_map in maps_of(queries)]
    return {name for name in constant if not np.any([cost_of(name) for cost_of in costs])}


def _noise_of(number: int, noise_rounds: int) -> float:
    """Return the noise of a round, which falls from the first to the last by equal factors."""
    progress = min(number / max(1, noise_rounds - 1), 1.0)
    return FIRST_NOISE * (LAST_NOISE / FIRST_NOISE) ** progress


@dataclass(eq=False)
class _Fit:
    """A fit under way. ``F`` of the ``K`` weights are fitted; the others are 0."""

    pool: RoutePool
    demo: np.ndarray  # [Q, K]
    unit: np.ndarray  # [K] what features are counted in
    is_fitted: np.ndarray  # [K]
    seed: int
    log_weights: np.ndarray = field(init=False)  # [F] of features in those units
    trust: np.ndarray = field(init=False)  # [Q]

    def __post_init__(self) -> None:
        self.log_weights = np.zeros(int(self.is_fitted.sum()))
        self.trust = np.ones(len(self.demo))

    @property
    def weights(self) -> np.ndarray:
        """``[K]`` the weights of features in their own units."""
        return self.weights_of(self.log_weights)

    def weights_of(self, log_weights: np.ndarray) -> np.ndarray:
        """Return ``[K]`` weights of features in their own units for log weights ``[F]``; 0 where none is fitted."""
        weights = np.zeros(len(self.unit))
        weights[self.is_fitted] = np.asarray(weights_of(jnp.asarray(log_weights)))
        return weights / self.unit

    def task(self, num_noise: int, noise: float, rng: np.random.Generator) -> FitTask:
        """Return the demonstrations, known routes, noise and trust that the loss looks at now, of the fitted weights.

        Args:
          num_noise: M noises of each query, even.
          noise: their standard deviation, in log weight.
          rng: draws them.
        """
        shape = (len(self.demo), num_noise, len(self.log_weights))
        return FitTask(
            demo=jnp.asarray((self.demo / self.unit)[:, self.is_fitted]),
            routes=jnp.asarray((self.pool.routes[0] / self.unit)[:, :, self.is_fitted]),
            log_noise=jnp.asarray(draw_log_noise(rng, shape, noise)),
            trust=jnp.asarray(self.trust),
        )

    def run_round(self, number: int, noise: float) -> dict[str, Any]:
        """Search under perturbed weights, set the trust of each demonstration again, and descend.

        Changes ``log_weights``, ``trust`` and the pool.

        Args:
          number: of the round, from 0; the first `TRUST_ROUNDS` trust all demonstrations alike.
          noise: standard deviation of the log weights about the current ones.

        Returns:
          The row of the round in `WeightFit.curve`, but for its time and weights.
        """
        # [Q, 1 + NUM_PROBES, K] weights for searches: the current ones first, then perturbed ones.
        rng = np.random.default_rng([IN_ROUND, number, self.seed])
        probes = np.exp(rng.normal(size=(len(self.demo), 1 + NUM_PROBES, len(self.unit))) * noise)
        probes[:, 0] = 1.0
        probed = self.weights * probes

        # [Q, 1 + NUM_PROBES] the cheapest costs among the routes known so far, and by search. Where a search finds a
        # cheaper route, its cost is below the expected one; the largest such gap says how much was not known.
        num_known = self.pool.num_routes
        expected = np.min(np.einsum("qmk,qrk->qmr", probed, self.pool.routes[0]), axis=-1)
        searched = np.einsum("qmk,qmk->qm", probed, self.pool.cheapest(probed)[0])

        # What is minimised: in the first rounds the loss, which leads from anywhere; then the mean regret, in which
        # demonstrations that are far costlier than most count less, and the less the later the round.
        task = self.task(NUM_NOISE, noise, rng)
        objective = fenchel_young_loss
        if number >= TRUST_ROUNDS:
            objective = mean_regret
            patience = FIRST_DOUBT ** max(0.0, 1 - (number - TRUST_ROUNDS) / DOUBT_ROUNDS)
            regret = np.asarray(regrets(weights_of(jnp.asarray(self.log_weights)), task))
            # Patience falls to 1 over the rounds (graduated non-convexity): doubt at first sight would make wrong
            # weights believe only the demonstrations that suit them.
            self.trust = trust_of(regret, usual_regret(regret) * patience)
            task = task._replace(trust=jnp.asarray(self.trust))
        log_weights, loss = descend(jnp.asarray(self.log_weights), task, objective, STEPS)
        self.log_weights = np.asarray(log_weights)
        return {
            "round": number + 1,
            "noise": noise,
            "loss": float(loss),
            "mean_regret": float(np.mean(np.asarray(regrets(weights_of(log_weights), task)))),
            "worst_gap": float(np.max(expected / searched - 1)),
            "new_routes": self.pool.num_routes - num_known,
            "num_plans": self.pool.num_plans,
        }

    def searched_regret(self, log_weights: np.ndarray) -> np.ndarray:
        """Return ``[Q]`` the regret of each demonstration under weights, against the cheapest route by search."""
        weights = self.weights_of(log_weights)
        cheapest = self.pool.cheapest(weights[None])[0, :, 0]
        return (self.demo @ weights) / (cheapest @ weights) - 1

    def near_optimal_range(self, scale: np.ndarray, least: np.ndarray) -> np.ndarray:
        """Return ``[2, K]`` the least and the largest value of each weight that explain the routes as well as the fit.

        The weights W that are compared have a . W = 1. Weights that are not fitted have the range 0 to 0.

        Args:
          scale: ``[K]`` a: ones where weights sum to 1, or 1 for the distance alone.
          least: ``[Q, K]`` features that the demonstrations have at least (`Demonstration.least_features`).
        """
        # In the units of the task.
        unit = self.unit[self.is_fitted]
        task = self._task_without_noise()._replace(demo=(least / self.unit)[:, self.is_fitted])
        scaled = (self.weights * self.unit)[self.is_fitted]
        sides = scale[self.is_fitted] / unit
        ends = np.zeros((2, len(self.unit)))
        ends[:, self.is_fitted] = near_optimal_range(scaled, task, sides, SETTLED) / unit
        return ends

    def _task_without_noise(self) -> FitTask:
        """Return the task for what noise plays no part in, such as the regret; two noises are the fewest."""
        return self.task(2, LAST_NOISE, np.random.default_rng(self.seed))

    def least_mean_regret(self, best: float) -> float:
        """Return the least mean regret, over all demonstrations alike, that any weights are found to reach.

        The fit itself, which trusts some demonstrations less, may have more. Rounds of descents and searches end where
        a search finds no cheaper routes than the descent knew. The pool grows; the fit's weights stay.

        Args:
          best: a mean regret that is already reached, above which the result never is.
        """
        lowest = self.log_weights
        for _ in range(REGRET_ROUNDS):
            task = self._task_without_noise()._replace(trust=jnp.ones(len(self.demo)))
            ended, expected = descend(jnp.asarray(lowest), task, mean_regret, STEPS)
            lowest = np.asarray(ended)
            reached = float(self.searched_regret(lowest).mean())
            best = min(best, reached)
            if reached <= float(expected) + SETTLED:
                break
        return best


def _refitted(
    fit: _Fit, demonstrations: Sequence[Demonstration], scale: str, bootstrap: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights ``[B, K]`` of bootstrap fits, and the lower and upper ends ``[2, K]`` of their intervals.

    An interval reaches from the 5th to the 95th percentile, and as far as weights explain the demonstrations as well as
    the fit does. A single demonstration has no bootstrap fits (B is 0) and the second part alone.

    Args:
      fit: of all demonstrations.
      demonstrations: all of them.
      scale: of the weights, ``"simplex"`` or ``"distance"``.
      bootstrap: how many fits; with 0 the intervals are NaN.
    """
    # [B, K] the weights of fits to demonstrations that are drawn again, cities first.
    rng = np.random.default_rng([IN_BOOTSTRAP, 0, fit.seed])
    num = len(fit.unit)
    maps = [id(demonstration.query.cost_map.maps) for demonstration in demonstrations]
    cities, _ = pd.factorize(np.array(maps))  # a city is one set of maps
    task = fit.task(BOOTSTRAP_NOISE, LAST_NOISE, rng)
    log_draws = refit(fit.log_weights, task, draw_counts(cities, bootstrap, rng))
    draws = np.array([_scaled(fit.weights_of(row), scale) for row in log_draws]).reshape(-1, num)
    if not bootstrap:
        return draws, np.full((2, num), np.nan)

    # The range of weights that explain the demonstrations as well, among those with the sum 1 or the distance weight 1.
    sides = np.ones(num) if scale == "simplex" else np.eye(num)[0]
    least = np.array([demonstration.least_features for demonstration in demonstrations])
    low, high = fit.near_optimal_range(sides, least)
    if len(draws):
        drawn_low, drawn_high = np.percentile(draws, [5, 95], axis=0)
        low = np.minimum(drawn_low, low)
        high = np.maximum(drawn_high, high)
    return draws, np.stack([low, high])


def _scaled(weights: np.ndarray, scale: str) -> np.ndarray:
    """Return weights ``[K]`` that sum to 1 (``"simplex"``), or of which the distance's is 1 (``"distance"``)."""
    return weights / (weights.sum() if scale == "simplex" else weights[0])


def _weight_table(fit: _Fit, scale: str, interval: np.ndarray) -> pd.DataFrame:
    """Return the table of a `WeightFit`, a row per weight by its name.

    Args:
      fit: when it has ended.
      scale: of its weights.
      interval: ``[2, K]`` lower and upper ends, of the same scale.
    """
    # What each weight costs on average, and how much that differs between demonstrations.
    cost = fit.weights * fit.demo.mean(axis=0)
    spread = fit.weights * fit.demo.std(axis=0)
    columns = {
        "weight": _scaled(fit.weights, scale),
        "low": interval[0],
        "high": interval[1],
        "share_of_cost": cost / cost.sum(),
        "spread": spread / max(float(np.linalg.norm(spread)), 1e-300),  # 0 / 0 is 0
    }
    return pd.DataFrame(columns, pd.Index(fit.pool.names, name="name"))


def _constant_sentence(name: str, is_left_out: bool) -> str:
    """Return a sentence on the weight of a layer that is constant, and on what the fit did with it.

    Args:
      name: of the layer.
      is_left_out: whether the fit left its weight at 0.
    """
    outcome = "stands for the steps that diagonals save under the cost model 'cell'"
    if is_left_out:
        outcome = "is left at 0"
    return f"The {name} layer is the same everywhere on these maps, so its weight cannot be identified and {outcome}."


def _wide_sentences(table: pd.DataFrame) -> list[str]:
    """Return a sentence for each weight of a table that the demonstrations leave open within a wide range."""
    is_wide = np.isfinite(table.high) & (table.high > 0) & (table.low < table.high / WIDE)
    return [
        f"The weight of {row.Index} is hardly pinned down: with other weights to match, nothing from {row.low:.3g} to "
        f"{row.high:.3g} is ruled out; the value given is one of them."
        for row in table[is_wide].itertuples()
    ]


def _verdict(
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
    followed = "these metrics"
    if metric_share <= NEGLIGIBLE:
        followed = "distance alone and none of these metrics"
    percent = round(max(0.0, 100 * best), 4)  # rounding may bring it below 0
    share = f"at best they cost {percent:.3g} % more than the cheapest ones between their ends, on average"
    added = round(percent - 100 * regret.mean(), 2)
    if added > 0:
        share += f", of which redrawing them on the grid adds {added:.3g} %"
    if min(best, regret.mean()) <= bar:
        return f"These routes follow {followed}: {share}."
    is_trusted = trust >= DISTRUSTED
    if is_trusted.mean() > 0.5 and regret[is_trusted].mean() <= bar:
        return f"Most of these routes, {is_trusted.sum()} of {len(trust)}, follow {followed}; with the others {share}."
    return f"These routes do not follow these metrics: {share}, under any weights that were found."


def _warnings(
    demonstrations: Sequence[Demonstration], num_weights: int, trust: np.ndarray, is_settled: bool
) -> Iterator[str]:
    """Yield the further sentences that a reader of the fit must know: few, bad or altered routes, an unfinished search.

    Args:
      demonstrations: all, of which those with a note have a sentence each.
      num_weights: K.
      trust: ``[Q]`` in the end.
      is_settled: the last round found no better routes.
    """
    num = len(demonstrations)
    if num < FEW * num_weights:
        yield (
            f"There are few demonstrations ({num}) for {num_weights} weights, which are fitted all the same: others of "
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
