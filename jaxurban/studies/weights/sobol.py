"""Which weights the outcomes of routes depend on: derivatives at given weights, Sobol indices over a whole range.

The first-order index of a factor is the share of an outcome's variance that this factor explains alone; the total
index is the share that would be left if all others were known, so it counts its interactions too (Saltelli et al.,
Comput. Phys. Commun. 181(2), 2010; computed by SALib). Both need factors that vary independently. Weights on a
simplex do not: a larger one makes the others smaller, and no share could be put down to one of them. So weights
vary freely here. Only their ratios choose a route; leave one of them, such as the distance's, as the unit.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy import special

from jaxurban.checks import at_least, one_of
from jaxurban.errors import InputError
from jaxurban.studies.bootstrap import interval_reach
from jaxurban.studies.queries import outcomes_of
from jaxurban.studies.route_pool import RoutePool, draw_pairs, mean_and_slope
from jaxurban.studies.weights.breakpoints import OnPlans

NUM_REPEATS, NUM_NOISE = 8, 16  # estimates of each slope, and searches for each
NOISE = 0.2  # standard deviation of the log weights in them
NUM_RESAMPLES = 1000  # of the bootstrap that gives the confidence intervals
CONFIDENCE = 0.95
FEW_SAMPLES = 64  # with fewer, intervals contain known indices in 62 to 94 % of the cases only
CONSTANT = 1e-12  # relative: an outcome that varies by less does not vary
OF_SHARE = ("first", "first_ci", "total", "total_ci")  # columns of Sobol shares
NUM_AT_ONCE = 64  # weights planned under between two reports of progress


def check_sampling(settings: Any) -> None:
    """Raise InputError unless the settings of weights that vary make sense.

    Args:
      settings: with ``vary`` (names, each once), ``factors`` (two, below and above 1), ``num_samples`` (0 or a power of
        two above 1) and ``seed`` (0 or more).
    """
    at_least("seed", settings.seed)
    if len(set(settings.vary)) < len(settings.vary):
        raise InputError(f"vary must name each weight once, got {', '.join(settings.vary)}")
    factors = settings.factors
    if len(factors) != 2 or not 0 < factors[0] < 1 < factors[1] < math.inf:
        raise InputError(
            f"factors must be two (--range), from below 1 to above 1 times the weights, as 0.1,10, got {factors}"
        )
    num = settings.num_samples
    is_power = num & (num - 1) == 0  # of two, with a single binary digit 1; or 0
    if num < 0 or num == 1 or not is_power:
        raise InputError(f"num_samples must be a power of two such as 32, got {num}")


def varied_columns(
    names: Sequence[str], weights: np.ndarray, vary: Sequence[str], where: str = ""
) -> dict[str, int]:
    """Return the columns of the weights to vary, by name.

    Args:
      names: ``[K]`` of the weights, ``"distance"`` first.
      weights: ``[K]``.
      vary: names of the weights to vary; empty: all metrics whose weight is above 0.
      where: ends "weight gps is 0" in an error, such as " on every route".

    Raises:
      InputError: no weight varies, or one is named that does not exist or is 0.
    """
    if not vary:
        vary = [name for name, weight in zip(names[1:], weights[1:], strict=True) if weight > 0]
    if not vary:
        raise InputError(
            f"every metric has weight 0{where}, so nothing varies: give one a weight above 0, or name vary"
        )
    columns = {name: names.index(one_of("a weight that varies", name, names)) for name in vary}
    for name, column in columns.items():
        if not weights[column] > 0:
            raise InputError(
                f"weight {name} is 0{where}, which no factor changes: give it a value above 0, or do not vary it"
            )
    return columns


def sobol_indices(
    evaluate: Callable[[np.ndarray], Mapping[str, np.ndarray]],
    factors: Sequence[str],
    num_samples: int,
    seed: int = 0,
) -> pd.DataFrame:
    """Return Sobol indices of a function's outcomes with respect to its ``D`` factors, uniform from 0 to 1.

    The table has a row for each outcome and factor, which are its index. ``first`` and ``total`` are the indices, and
    ``first_ci`` and ``total_ci`` half the width of their 95 % intervals; these four are NaN for an outcome that does
    not vary. ``mean``, ``std``, ``lowest`` and ``highest`` are of the outcome over the samples.

    Args:
      evaluate: takes ``[N (D + 2), D]`` points and returns each outcome there.
      factors: names.
      num_samples: N, a power of two (the Sobol sequence is balanced only then).
      seed: of the sequence's scrambling and of the bootstrap.
    """
    problem = {
        "num_vars": len(factors),
        "names": list(factors),
        "bounds": [[0.0, 1.0]] * len(factors),
    }
    from SALib.sample import sobol as sampling  # here: reports import this module too

    points = sampling.sample(problem, num_samples, calc_second_order=False, seed=seed)
    tables = {name: _indices(problem, values, seed) for name, values in evaluate(points).items()}
    return pd.concat(tables, names=["outcome"])


def sobol_of_weights(
    pool: RoutePool,
    weights: np.ndarray,
    columns: Sequence[int],
    factors: tuple[float, float],
    num_samples: int,
    seed: int = 0,
    on_plans: OnPlans | None = None,
) -> pd.DataFrame:
    """Return Sobol indices of the outcomes of the cheapest routes, with respect to ``D`` weights that vary.

    Each weight is log-uniform around its given value. Outcomes are means over the pool's queries (see `outcomes_of`).
    Each query is searched under N (D + 2) sets of weights. The table is that of `sobol_indices`.

    Args:
      pool: the queries; routes found join it.
      weights: ``[K]`` the given weights; a weight that does not vary keeps its value.
      columns: of the weights that vary.
      factors: a weight goes from the first to the second of these times its given value.
      num_samples, seed: as in `sobol_indices`.
      on_plans: gets the number of searches made so far.

    Raises:
      InputError: a query without a path.
    """
    low, high = np.outer(factors, weights[columns])

    def evaluate(unit: np.ndarray) -> Mapping[str, np.ndarray]:
        """Return the mean outcomes at points ``[N, D]`` of the unit cube, weights spaced by logarithm."""
        varied = np.tile(weights, (len(unit), 1))
        varied[:, columns] = low * (high / low) ** unit

        # Integrals [Q, N, K], some weights at a time, so that progress shows.
        parts = []
        for begin in range(0, len(varied), NUM_AT_ONCE):
            some = varied[begin : begin + NUM_AT_ONCE]
            parts.append(pool.cheapest(some)[1])
            if on_plans is not None:
                on_plans((begin + len(some)) * len(pool.queries))
        outcomes = outcomes_of(np.concatenate(parts, axis=1), pool.names)
        return {name: values.mean(axis=0) for name, values in outcomes.items()}

    return sobol_indices(evaluate, [pool.names[column] for column in columns], num_samples, seed)


def _indices(problem: dict, values: np.ndarray, seed: int) -> pd.DataFrame:
    """Return the indices of one outcome, a row per factor (see `sobol_indices`).

    Args:
      problem: the factors' names and bounds, as SALib takes them.
      values: ``[N (D + 2)]`` the outcome at SALib's points.
      seed: of the points; the bootstrap has the next one.
    """
    # A table without indices, which is all of an outcome that does not vary.
    facts = {
        **dict.fromkeys(OF_SHARE, np.nan),
        "mean": values.mean(),
        "std": values.std(),
        "lowest": values.min(),
        "highest": values.max(),
    }
    table = pd.DataFrame(facts, pd.Index(problem["names"], name="factor"))
    if np.ptp(values) <= CONSTANT * np.abs(values).max():
        return table
    from SALib.analyze import sobol as analysis

    with warnings.catch_warnings():
        # SALib warns where a part of the values is constant; the intervals show it.
        warnings.filterwarnings("ignore", "Constant values encountered")
        result = analysis.analyze(
            problem,
            np.asarray(values, np.float64),
            calc_second_order=False,
            num_resamples=NUM_RESAMPLES,
            conf_level=CONFIDENCE,
            seed=seed + 1,  # SALib takes 0 for none
        )

    # SALib's intervals are those of the normal law, and ours those of few samples.
    num_samples = len(values) // (len(table) + 2)
    wider = interval_reach(num_samples) / special.ndtri((1 + CONFIDENCE) / 2)
    return table.assign(
        first=result["S1"],
        first_ci=result["S1_conf"] * wider,
        total=result["ST"],
        total_ci=result["ST_conf"] * wider,
    )


def cost_gradient(names: Sequence[str], weights: np.ndarray, features: np.ndarray) -> pd.DataFrame:
    """Return how the optimal cost V responds to a small change of each weight, a row per weight.

    V(W) = min W . f has the gradient f, the features of the cheapest route, wherever this route is unique (envelope
    theorem; Danskin 1967). Where routes tie, f is one of V's supergradients. For several queries V is their mean cost.

    The columns are ``weight``; ``gradient``, dV/dw; and ``elasticity``, d log V / d log w, which is also the weight's
    share of the cost. Elasticities sum to 1; they are NaN where the cost is 0.

    Args:
      names: ``[K]`` of the weights.
      weights: ``[K]``, not all 0.
      features: ``[Q, K]`` of the cheapest route of each query.
    """
    gradient = features.mean(axis=0)
    total = float(weights @ gradient)
    elasticity = weights * gradient / total if total > 0 else np.nan
    columns = {"weight": weights, "gradient": gradient, "elasticity": elasticity}
    return pd.DataFrame(columns, pd.Index(names, name="weight_name"))


def outcome_slopes(
    pool: RoutePool, weights: np.ndarray, integrals: np.ndarray, noise: float = NOISE, seed: int = 0
) -> pd.DataFrame:
    """Return how the outcomes of the cheapest routes respond to a small change of each weight.

    Between breakpoints outcomes are constant, so their derivative is 0 and says nothing. What counts is the slope of
    their mean over perturbed weights W exp(noise Z), Z normal.

    The table has a row for each outcome and weight, which are its index. ``value`` is the outcome under W, a mean over
    the queries; ``expected`` its mean under perturbed weights; ``expected_slope`` the derivative of that mean by log w,
    and ``expected_slope_se`` the standard error of this estimate.

    Args:
      pool: the queries; routes found join it.
      weights: ``[K]``, not all 0.
      integrals: ``[Q, K]`` of the cheapest route of each query.
      noise: of log weights: about the size of the change.
      seed: of the noise.

    Raises:
      InputError: a query without a path.
    """
    values = {name: np.mean(value) for name, value in outcomes_of(integrals, pool.names).items()}

    # Independent estimates, with seeds that no other seed of the caller uses: their scatter is the standard error.
    seeds = range(seed * NUM_REPEATS, (seed + 1) * NUM_REPEATS)
    estimates = [_expected(pool, weights, noise, each) for each in seeds]
    expected, slopes = map(np.array, zip(*estimates, strict=True))
    num = len(pool.names)
    columns = {
        "value": np.repeat([*values.values()], num),
        "expected": np.repeat(expected.mean(axis=0), num),
        "expected_slope": slopes.mean(axis=0).ravel(),
        "expected_slope_se": slopes.std(axis=0, ddof=1).ravel() / np.sqrt(len(slopes)),
    }
    rows = pd.MultiIndex.from_product([values, pool.names], names=["outcome", "weight_name"])
    return pd.DataFrame(columns, rows)


def _expected(
    pool: RoutePool, weights: np.ndarray, noise: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return estimates of the expected outcomes ``[J]`` and of their slopes by log weights ``[J, K]``.

    Args:
      pool: the queries; routes found join it.
      weights: ``[K]``; the slope by a weight that is 0 is 0.
      noise: of log weights.
      seed: of the noise.
    """
    # Means [Q, K] and slopes [Q, K, K] of the integrals, of which outcomes are made.
    drawn = draw_pairs(seed, NUM_NOISE, len(weights))
    integrals = pool.cheapest(weights * np.exp(noise * drawn))[1]
    mean, slope = mean_and_slope(integrals, drawn, noise)
    slope = np.where(weights > 0, slope, 0.0)

    def outcomes(integrals: Any) -> Any:
        """Return ``[J]`` the outcomes, as means over the queries, of integrals ``[Q, K]``."""
        return jnp.stack([value.mean() for value in outcomes_of(integrals, pool.names).values()])

    # The chain rule.
    with jax.enable_x64(True):
        by_integral = np.asarray(jax.jacfwd(outcomes)(jnp.asarray(mean)))  # [J, Q, K]
        return np.asarray(outcomes(mean)), np.einsum("jqi,qik->jk", by_integral, slope)
