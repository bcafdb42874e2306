"""Which weights the outcomes of routes depend on over a whole range: Sobol indices.

The first-order index of a factor is the share of an outcome's variance that this factor explains alone; the total
index is the share that would be left if all others were known, so it counts its interactions too (Saltelli et al.,
Comput. Phys. Commun. 181(2), 2010; computed by SALib). Both need factors that vary independently. Weights on a
simplex do not: a larger one makes the others smaller, and no share could be put down to one of them. So weights
vary freely here. Only their ratios choose a route; leave one of them, such as the distance's, as the unit.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from scipy import special

from jaxurban.checks import one_of
from jaxurban.errors import InputError
from jaxurban.statistics.bootstrap import interval_reach
from jaxurban.studies.queries import outcomes_of
from jaxurban.studies.route_pool import RoutePool

NUM_RESAMPLES = 1000  # of the bootstrap that gives the confidence intervals
CONFIDENCE = 0.95
FEW_SAMPLES = 64  # with fewer, intervals contain known indices in 62 to 94 % of the cases only
CONSTANT = 1e-12  # relative: an outcome that varies by less does not vary
OF_SHARE = ("first", "first_ci", "total", "total_ci")  # columns of Sobol shares


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
    ``first_ci`` and ``total_ci`` half the width of their 95 % intervals; all are NaN for an outcome that does not vary.

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

    Raises:
      InputError: a query without a path.
    """
    low, high = np.outer(factors, weights[columns])

    def evaluate(unit: np.ndarray) -> Mapping[str, np.ndarray]:
        """Return the mean outcomes at points ``[N, D]`` of the unit cube, weights spaced by logarithm."""
        varied = np.tile(weights, (len(unit), 1))
        varied[:, columns] = low * (high / low) ** unit
        outcomes = outcomes_of(pool.cheapest(varied)[1], pool.names)
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
    factors = pd.Index(problem["names"], name="factor")
    table = pd.DataFrame(np.nan, factors, list(OF_SHARE))
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
