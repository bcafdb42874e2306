"""The rounds of a fit to demonstrations: searches for routes, descents of the weights, and trust in demonstrations."""

import time
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd

from jaxurban.progress import Report
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.route_pool import FitSettings, RoutePool
from jaxurban.studies.tuning.confidence import draw_counts, feature_units, near_optimal_range, refit
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

# Standard deviations of log weights: first far from the minimum, in the end close to it.
FIRST_NOISE, LAST_NOISE = 0.3, 0.03
NOISE_ROUNDS = 7  # in which the noise shrinks
# Noises per query in the loss; searches per query and round under perturbed weights.
NUM_NOISE, NUM_PROBES = 32, 2
STEPS, BOOTSTRAP_NOISE = 200, 8
TRUST_ROUNDS, DOUBT_ROUNDS = 7, 6  # of full trust; in which patience then falls to 1
FIRST_DOUBT = 30.0  # how many times farther off a route may be at first
SETTLED = 1e-5  # a round that betters no known route by more has nothing to add
REGRET_ROUNDS = 4  # searches for the least regret that any weights reach
IN_ROUND, IN_BOOTSTRAP = 1, 2  # streams of random numbers


class FitUnderWay:
    """A fit to ``Q`` demonstrations between its rounds. ``F`` of the ``K`` weights are fitted; the others are 0.

    Attributes:
      demonstrations: to which weights are fitted.
      demo: ``[Q, K]`` features of the demonstrations.
      is_fitted: ``[K]`` whether each weight is fitted.
      seed: of all noise.
      noise_rounds: in which the noise shrinks.
      pool: the routes known so far.
      unit: ``[K]`` what features are counted in.
      log_weights: ``[F]`` of features in these units.
      trust: ``[Q]`` in each demonstration, from 0 to 1.
    """

    def __init__(
        self,
        demonstrations: Sequence[Demonstration],
        is_fitted: np.ndarray,
        settings: FitSettings,
    ) -> None:
        """Begin with all weights alike, full trust, and no known routes but the demonstrations.

        Args:
          demonstrations: at least one.
          is_fitted: ``[K]`` whether each weight is fitted.
          settings: of the search.
        """
        self.demonstrations = demonstrations
        queries = [each.query for each in demonstrations]
        self.demo = np.array([each.features for each in demonstrations])
        self.is_fitted = is_fitted
        self.seed = settings.seed
        self.noise_rounds = min(settings.max_rounds, NOISE_ROUNDS)
        self.pool = RoutePool(queries, [each.sums for each in demonstrations])
        self.unit: np.ndarray = np.where(is_fitted, feature_units(queries, self.demo), 1.0)
        self.log_weights = np.zeros(is_fitted.sum())
        self.trust = np.ones(len(queries))

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

    def run_round(self, number: int) -> dict[str, Any]:
        """Search under perturbed weights, set the trust of each demonstration again, and descend.

        Changes ``log_weights``, ``trust`` and the pool.

        Args:
          number: of the round, from 0; the first `TRUST_ROUNDS` trust all demonstrations alike.

        Returns:
          The row of the round in ``curve`` of a `WeightFit`, but for its time and weights.
        """
        # The noise falls from the first to the last by equal factors.
        progress = min(number / max(1, self.noise_rounds - 1), 1.0)
        noise = FIRST_NOISE * (LAST_NOISE / FIRST_NOISE) ** progress
        rng = np.random.default_rng([IN_ROUND, number, self.seed])
        num_known = self.pool.num_routes

        # [Q, 1 + NUM_PROBES, K] weights for searches, which add routes to the pool: the current ones first, then
        # perturbed ones.
        probes = np.exp(rng.normal(size=(len(self.demo), 1 + NUM_PROBES, len(self.unit))) * noise)
        probes[:, 0] = 1.0
        probed = self.weights * probes

        # [Q, 1 + NUM_PROBES] the cheapest costs among the routes known so far, and by search.
        expected = np.min(np.einsum("qmk,qrk->qmr", probed, self.pool.routes[0]), axis=-1)
        searched = np.einsum("qmk,qmk->qm", probed, self.pool.cheapest(probed)[0])

        # The first rounds minimise the loss, which leads from anywhere. Later ones minimise the mean regret, in which
        # demonstrations that are far costlier than most count less. Patience with them falls to 1 over the rounds
        # (graduated non-convexity): doubt from the first round on would make wrong weights believe only the
        # demonstrations that suit them.
        task = self.task(NUM_NOISE, noise, rng)
        objective = fenchel_young_loss
        if number >= TRUST_ROUNDS:
            objective = mean_regret
            patience = FIRST_DOUBT ** max(0.0, 1 - (number - TRUST_ROUNDS) / DOUBT_ROUNDS)
            regret = np.asarray(regrets(weights_of(jnp.asarray(self.log_weights)), task))
            self.trust = trust_of(regret, usual_regret(regret) * patience)
            task = task._replace(trust=jnp.asarray(self.trust))
        log_weights, loss = descend(
            jnp.asarray(self.log_weights), task, objective=objective, num_steps=STEPS
        )
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

    def task_without_noise(self) -> FitTask:
        """Return the task for what noise plays no part in, such as the regret; two noises are the fewest."""
        return self.task(2, LAST_NOISE, np.random.default_rng(self.seed))

    def least_mean_regret(self, best: float) -> float:
        """Return the least mean regret, over all demonstrations alike, that any weights are found to reach.

        The fit itself, which trusts some demonstrations less, may have more. Rounds of descents and searches end where
        a search finds no cheaper routes than the descent knew. The pool grows; the fit's weights stay.

        Args:
          best: a mean regret that is already reached, above which the result never is.
        """
        lowest = jnp.asarray(self.log_weights)
        for _ in range(REGRET_ROUNDS):
            task = self.task_without_noise()._replace(trust=jnp.ones(len(self.demo)))
            lowest, expected = descend(lowest, task, objective=mean_regret, num_steps=STEPS)
            weights = self.weights_of(np.asarray(lowest))
            reached = float(searched_regret(self.pool, self.demo, weights).mean())
            best = min(best, reached)
            if reached <= float(expected) + SETTLED:
                break
        return best


def searched_regret(pool: RoutePool, demo: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``[Q]`` by which share routes of features ``[Q, K]`` cost more than the cheapest that a search finds."""
    cheapest = pool.cheapest(weights[None])[0, :, 0]
    return (demo @ weights) / (cheapest @ weights) - 1


def run_rounds(
    fit: FitUnderWay, settings: FitSettings, begin_s: float, report: Report
) -> tuple[pd.DataFrame, bool]:
    """Run rounds of a fit until one betters no known route, or until the allowed rounds or seconds are used up.

    Args:
      fit: before its first round; it changes.
      settings: of the search.
      begin_s: reading of `time.perf_counter` from which seconds count.
      report: of the progress.

    Returns:
      ``curve`` of a `WeightFit`, a row for each round; and whether the last round bettered no known route.
    """
    least_rounds = min(settings.max_rounds, TRUST_ROUNDS + DOUBT_ROUNDS + 1)
    rows = []
    for number in range(settings.max_rounds):
        row = fit.run_round(number)
        row["elapsed_s"] = time.perf_counter() - begin_s
        rows.append(row | dict(zip(fit.pool.names, scaled(fit.weights), strict=True)))
        report("rounds", number + 1, loss=f"{row['loss']:.3g}", searches=row["num_plans"])
        if row["worst_gap"] <= SETTLED and number + 1 >= least_rounds:
            return pd.DataFrame(rows), True
        if row["elapsed_s"] > settings.budget_s:
            break
    return pd.DataFrame(rows), False


def refitted(fit: FitUnderWay, bootstrap: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights ``[B, K]`` of bootstrap fits, and the lower and upper ends ``[2, K]`` of their intervals.

    An interval reaches from the 5th to the 95th percentile, and as far as weights explain the demonstrations as well as
    the fit does. A single demonstration has no bootstrap fits (B is 0) and the second part alone.

    Args:
      fit: when it has ended.
      bootstrap: how many fits; with 0 the intervals are NaN.
    """
    # [B, K] the weights of fits to demonstrations that are drawn again, cities first.
    rng = np.random.default_rng([IN_BOOTSTRAP, 0, fit.seed])
    num = len(fit.unit)
    cities = city_numbers(fit.demonstrations)
    task = fit.task(BOOTSTRAP_NOISE, LAST_NOISE, rng)
    log_draws = refit(fit.log_weights, task, draw_counts(cities, bootstrap, rng))
    draws = np.array([scaled(fit.weights_of(row)) for row in log_draws]).reshape(-1, num)
    if not bootstrap:
        return draws, np.full((2, num), np.nan)

    # [2, K] the range of weights that explain the demonstrations as well, among those with the sum 1: 0
    # to 0 where a weight is not fitted, and found in the units of the task.
    is_fitted = fit.is_fitted
    unit = fit.unit[is_fitted]
    least = np.array([each.least_features for each in fit.demonstrations])
    task = fit.task_without_noise()._replace(demo=(least / fit.unit)[:, is_fitted])
    in_units = (fit.weights * fit.unit)[is_fitted]
    ends = np.zeros((2, num))
    ends[:, is_fitted] = near_optimal_range(in_units, task, 1 / unit, SETTLED) / unit
    low, high = ends
    if len(draws):
        drawn_low, drawn_high = np.percentile(draws, [5, 95], axis=0)
        low = np.minimum(drawn_low, low)
        high = np.maximum(drawn_high, high)
    return draws, np.stack([low, high])


def city_numbers(demonstrations: Sequence[Demonstration]) -> np.ndarray:
    """Return ``[N]`` the number of each demonstration's city, which is one set of maps, in their order."""
    maps = np.array([id(each.query.cost_map.maps) for each in demonstrations])
    return pd.factorize(maps)[0]


def scaled(weights: np.ndarray) -> np.ndarray:
    """Return weights ``[K]`` that sum to 1."""
    return weights / weights.sum()
