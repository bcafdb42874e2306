"""Which weights the outcomes of routes depend on: derivatives at given weights, Sobol indices over a whole range.

The first-order index of a factor is the share of an outcome's variance that this factor explains alone; the total
index is the share that would be left if all others were known, so it counts its interactions too (Saltelli et al.,
Comput. Phys. Commun. 181(2), 2010; computed by SALib). Both need factors that vary independently. Weights on a
simplex do not: a larger one makes the others smaller, and no share could be put down to one of them. So weights
vary freely here. Only their ratios choose a route; leave one of them, such as the distance's, as the unit.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from SALib.analyze import sobol as analysis
from SALib.sample import sobol as sampling
from scipy import special

from jaxurban.errors import InputError, one_of, positive
from jaxurban.studies.bootstrap import reach_of
from jaxurban.studies.queries import outcomes_of
from jaxurban.studies.route_pool import RoutePool, draw_pairs, mean_and_slope
from jaxurban.studies.weights.breakpoints import OnPlans

NUM_REPEATS, NUM_NOISE = 8, 16  # estimates of each slope, and searches for each
NUM_RESAMPLES = 1000  # of the bootstrap that gives the confidence intervals
CONFIDENCE = 0.95
FEW_SAMPLES = 64  # with fewer, intervals contain known indices in 62 to 94 % of the cases only
CONSTANT = 1e-12  # relative: an outcome that varies by less does not vary
NUM_AT_ONCE = 64  # weights planned under between two reports of progress

Evaluate = Callable[[np.ndarray], Mapping[str, np.ndarray]]


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """Sobol indices of several outcomes.

    Attributes:
      table: a row for each outcome and factor (the index): ``first``, ``total``, and half the width of their 95 %
        confidence intervals, ``first_ci`` and ``total_ci``; NaN for an outcome that does not vary.
      spread: a row for each outcome: ``mean``, ``std``, ``lowest`` and ``highest`` over the samples.
      num_evaluations: N (D + 2).
    """

    table: pd.DataFrame
    spread: pd.DataFrame
    num_evaluations: int


def sobol_indices(
    evaluate: Evaluate,
    factors: Sequence[str],
    low: np.ndarray,
    high: np.ndarray,
    *,
    is_log: bool = False,
    num_samples: int = 128,
    seed: int = 0,
) -> SobolIndices:
    """Return first-order and total indices of a function's outcomes with respect to its ``D`` factors.

    Args:
      evaluate: takes ``[N (D + 2), D]`` points and returns each outcome there.
      factors: names.
      low, high: ``[D]`` range of each factor.
      is_log: factors are uniform in their logarithms.
      num_samples: N, a power of two (the Sobol sequence is balanced only then).
      seed: of the sequence's scrambling and of the bootstrap.

    Raises:
      InputError: a range that is empty, or not positive with ``is_log``, or N no power of two.
    """
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if num_samples < 2 or num_samples & (num_samples - 1):
        raise InputError(f"samples must be a power of two, such as 64 or 128, got {num_samples}")
    if not np.all((low < high) & np.isfinite(low) & np.isfinite(high)) or (is_log and np.any(low <= 0)):
        raise InputError(f"the range of each factor must grow{' from above 0' if is_log else ''}, got {low} to {high}")
    problem = {"num_vars": len(factors), "names": list(factors), "bounds": [[0.0, 1.0]] * len(factors)}
    unit = sampling.sample(problem, num_samples, calc_second_order=False, seed=seed)
    points = low * (high / low) ** unit if is_log else low + (high - low) * unit
    outcomes = evaluate(points)
    return SobolIndices(
        table=pd.concat(
            {name: _indices(problem, values, seed) for name, values in outcomes.items()}, names=["outcome"]
        ),
        spread=pd.DataFrame(
            {
                name: {"mean": v.mean(), "std": v.std(), "lowest": v.min(), "highest": v.max()}
                for name, v in outcomes.items()
            }
        ).T.rename_axis("outcome"),
        num_evaluations=len(points),
    )


def sobol_of_weights(
    pool: RoutePool,
    weights: np.ndarray,
    vary: Sequence[str],
    *,
    factors: tuple[float, float] = (0.1, 10.0),
    num_samples: int = 128,
    seed: int = 0,
    on_plans: OnPlans | None = None,
) -> SobolIndices:
    """Return how the outcomes of the cheapest routes depend on weights, each log-uniform around the given one.

    Outcomes are means over the pool's queries (see `outcomes_of`); N (D + 2) weights are planned under, for each.

    Args:
      pool: the queries; routes found join it.
      weights: ``[K]`` the given ones; those not varied stay.
      vary: names of the weights that vary.
      factors: each goes from the first to the second of these times its given value.
      num_samples, seed: as in `sobol_indices`.
      on_plans: gets the number of searches made so far.

    Raises:
      InputError: a weight that is 0 or not there, a wrong setting, or a query without a path.
    """
    weights = np.asarray(weights, np.float64)
    columns = check_vary(pool, weights, vary, factors)

    def evaluate(points: np.ndarray) -> Mapping[str, np.ndarray]:
        varied = np.tile(weights, (len(points), 1))
        varied[:, columns] = points
        parts = []
        for begin in range(0, len(varied), NUM_AT_ONCE):
            some = varied[begin : begin + NUM_AT_ONCE]
            parts.append(pool.cheapest(some)[1])
            if on_plans is not None:
                on_plans((begin + len(some)) * len(pool.queries))
        found = outcomes_of(np.concatenate(parts, axis=1), pool.names)
        return {name: values.mean(axis=0) for name, values in found.items()}

    low, high = (weights[columns] * factor for factor in factors)
    return sobol_indices(evaluate, vary, low, high, is_log=True, num_samples=num_samples, seed=seed)


def check_vary(
    pool: RoutePool, weights: np.ndarray, vary: Sequence[str], factors: tuple[float, float] = (0.1, 10.0)
) -> list[int]:
    """Return the columns of the weights to vary.

    Raises:
      InputError: a weight that is not there or 0, or factors that do not go from below 1 to above it.
    """
    names = pool.names
    if not 0 < factors[0] < 1 < factors[1] < np.inf:
        raise InputError(f"the range must go from below 1 to above 1 times the weights, as 0.1,10, got {factors}")
    if not vary or len(set(vary)) < len(vary):
        raise InputError(f"name at least one weight to vary, each once, got {', '.join(vary) or 'none'}")
    columns = [names.index(one_of("a weight that varies", name, names)) for name in vary]
    for name, column in zip(vary, columns, strict=True):
        if not weights[column] > 0:
            raise InputError(f"weight {name} is 0, which no factor changes: give it a value above 0, or do not vary it")
    return columns


def _indices(problem: dict, values: np.ndarray, seed: int) -> pd.DataFrame:
    """Return the indices of one outcome, a row a factor."""
    index = pd.Index(problem["names"], name="factor")
    columns = ["first", "first_ci", "total", "total_ci"]
    if np.ptp(values) <= CONSTANT * np.abs(values).max():
        return pd.DataFrame(np.nan, index, columns)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Constant values encountered")  # of a part: the intervals tell
        found = analysis.analyze(
            problem,
            np.asarray(values, np.float64),
            calc_second_order=False,
            num_resamples=NUM_RESAMPLES,
            conf_level=CONFIDENCE,
            seed=seed + 1,  # SALib takes 0 for none
        )
    num_samples = len(values) // (len(index) + 2)
    wider = reach_of(num_samples) / special.ndtri((1 + CONFIDENCE) / 2)  # SALib's ends are those of the normal law
    parts = found["S1"], found["S1_conf"] * wider, found["ST"], found["ST_conf"] * wider
    return pd.DataFrame(dict(zip(columns, parts, strict=True)), index)


@dataclass(frozen=True, eq=False)
class LocalSensitivity:
    """Derivatives at one W. Of several queries: the mean of their costs and outcomes.

    Attributes:
      cost: a row a weight: ``weight``; ``gradient``, dV/dw of the optimal cost V; ``elasticity``,
        d log V / d log w, which is also the weight's share of the cost: elasticities sum to 1.
      outcomes: a row for each outcome and weight (the index): ``value`` under W; ``slope``, its exact derivative,
        0 between breakpoints; ``expected``, its mean under weights W exp(noise Z); ``expected_slope``, the derivative
        of that mean by log w, and ``expected_slope_se``, the standard error of this estimate.
      noise: standard deviation of the log weights in ``expected``.
    """

    cost: pd.DataFrame
    outcomes: pd.DataFrame
    noise: float


def local_sensitivity(pool: RoutePool, weights: np.ndarray, *, noise: float = 0.2, seed: int = 0) -> LocalSensitivity:
    """Return how the optimal cost and the outcomes of routes respond to a small change of each weight.

    The optimal cost V(W) = min W . f has the gradient f, the features of the cheapest route, wherever that is unique
    (envelope theorem; Danskin 1967); where routes tie it is one of V's supergradients. The outcomes of the
    cheapest route itself are constant between breakpoints, so their derivative is 0 and says nothing; what
    tells is the slope of their mean over perturbed weights (`perturbed`).

    Args:
      pool: the queries; routes found join it.
      weights: ``[K]``, not all 0.
      noise: of log weights: about the size of the change.
      seed: of the noise.

    Raises:
      InputError: a wrong setting, or a query without a path.
    """
    noise, names = positive("noise", noise), pool.names
    weights = np.asarray(weights, np.float64)
    features, integrals = pool.cheapest(weights[None])[:, :, 0]
    gradient = features.mean(axis=0)
    total = float(weights @ gradient)
    cost = pd.DataFrame(
        {"weight": weights, "gradient": gradient, "elasticity": weights * gradient / total if total > 0 else np.nan},
        pd.Index(names, name="weight_name"),
    )
    values = {name: float(np.mean(value)) for name, value in outcomes_of(integrals, names).items()}
    repeats = range(seed * NUM_REPEATS, (seed + 1) * NUM_REPEATS)
    expected, slopes = map(np.array, zip(*(_expected(pool, weights, noise, each) for each in repeats), strict=True))
    index = pd.MultiIndex.from_product([values, names], names=["outcome", "weight_name"])
    table = pd.DataFrame({"value": np.repeat(list(values.values()), len(names)), "slope": 0.0}, index)
    table["expected"] = np.repeat(expected.mean(axis=0), len(names))
    table["expected_slope"] = slopes.mean(axis=0).ravel()
    table["expected_slope_se"] = slopes.std(axis=0, ddof=1).ravel() / np.sqrt(len(slopes))
    return LocalSensitivity(cost, table, noise)


def _expected(pool: RoutePool, weights: np.ndarray, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an estimate ``[J]`` of expected outcomes and ``[J, K]`` of their slopes by log weights."""
    drawn = draw_pairs(seed, NUM_NOISE, len(weights))
    integrals = pool.cheapest(weights * np.exp(noise * drawn))[1]
    mean, slope = mean_and_slope(integrals, drawn, noise)
    slope = np.where(weights > 0, slope, 0.0)

    def outcomes(integrals):
        return jnp.stack([value.mean() for value in outcomes_of(integrals, pool.names).values()])

    with jax.enable_x64(True):
        by_integral = np.asarray(jax.jacfwd(outcomes)(jnp.asarray(mean)))  # [J, Q, K]
        return np.asarray(outcomes(mean)), np.einsum("jqi,qik->jk", by_integral, slope)
