"""What a small change of each weight does: to the optimal cost exactly, to what routes add up on average."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from jaxurban.errors import positive
from jaxurban.studies.outcomes import outcomes_of
from jaxurban.studies.perturbed import draw_pairs, mean_and_slope
from jaxurban.studies.route_pool import RoutePool

NUM_REPEATS, NUM_NOISE = 8, 16  # estimates of each slope, and searches for each


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
