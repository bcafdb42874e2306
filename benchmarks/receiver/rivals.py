"""Rivals of the maps: rules that predict from less, or from more, whether a receiver hears a satellite well.

Each is a logistic regression that is fitted to all blocks of the track but one and judged on that one, by log-loss:
the mean of -ln(chance given to what happened), 0.69 for a rule that always says one half.
"""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.special import expit, logit

from jaxurban.metrics.reception import ReceptionCurve
from jaxurban.receivers.rule import is_seen
from jaxurban.receivers.validation.scores import drawn_blocks
from jaxurban.statistics.bootstrap import interval_of, named

MOST_FOLDS = 100  # with more blocks, every hundredth is left out together
RIDGE, NUM_STEPS, LEAST_CHANCE = 1e-3, 12, 1e-6
LENGTHS = 1, 2, 4  # of blocks, times that of the study
STREET, MAP = "street", "margin and elevation"


def features_of(
    margin_m: np.ndarray, elevation_rad: np.ndarray, off_street_rad: np.ndarray
) -> Mapping[str, np.ndarray]:
    """Return what each rule predicts from: ``[R, K]`` features by the rule's name, the first of them 1.

    Rules that know the margin take it as the log odds of `jaxurban.metrics.reception.ReceptionCurve`, whose slope and
    offset every fit chooses for itself.

    Args:
      margin_m: ``[R]`` height of the antenna less that of the shadow's edge; may be inf.
      elevation_rad: ``[R]`` of the satellite.
      off_street_rad: ``[R]`` angle between the satellite's azimuth and the street's direction.
    """
    sky = [elevation_rad, elevation_rad**2]

    # The elevation in the plane across the street, in which the walls of the street hide satellites.
    across_rad = np.arctan2(np.tan(elevation_rad), np.abs(np.sin(off_street_rad)))
    chance = ReceptionCurve.measured_in_tokyo().chance(jnp.asarray(margin_m))
    log_odds = logit(np.asarray(chance, np.float64))

    # What each rule knows beside the constant.
    rules = {
        "constant": [],
        "elevation": sky,
        STREET: [*sky, across_rad, across_rad**2, across_rad * elevation_rad],
        "seen or hidden": [is_seen(margin_m)],
        "margin": [log_odds],
        MAP: [*sky, log_odds],
    }
    ones = np.ones(len(margin_m))
    return {name: np.stack([ones, *columns], axis=1) for name, columns in rules.items()}


def fitted(features: np.ndarray, is_strong: np.ndarray) -> np.ndarray:
    """Return ``[K]`` the coefficients of a logistic regression, by Newton's method with a small ridge.

    Args:
      features: ``[R, K]``.
      is_strong: ``[R]`` bool, the truths.
    """
    coefficients = np.zeros(features.shape[1])
    ridge = RIDGE * np.eye(len(coefficients))
    for _ in range(NUM_STEPS):
        # Gradient and negative Hessian of the log likelihood less the ridge's penalty.
        chance = expit(features @ coefficients)
        slope = features.T @ (is_strong - chance) - ridge @ coefficients
        variance = chance * (1 - chance)
        curvature = (features * variance[:, None]).T @ features + ridge
        coefficients += np.linalg.solve(curvature, slope)
    return coefficients


def losses(features: np.ndarray, is_strong: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return ``[R]`` -ln of the chance that a rule gave to what happened in each row.

    Each block is judged by a fit to all blocks but those of its fold; with a single fold all values are NaN.

    Args:
      features: ``[R, K]`` of the rule.
      is_strong: ``[R]`` bool, what happened.
      block: ``[R]`` number of each row's block; blocks whose numbers agree modulo `MOST_FOLDS` form a fold.
    """
    # The folds, of which one after the other is judged by a fit to all others.
    result = np.full(len(block), np.nan)
    fold = block % MOST_FOLDS
    folds = np.unique(fold)
    if len(folds) == 1:
        return result
    for number in folds:
        is_judged = fold == number
        coefficients = fitted(features[~is_judged], is_strong[~is_judged])
        chance = expit(features[is_judged] @ coefficients)
        of_truth = np.where(is_strong[is_judged], chance, 1 - chance)
        result[is_judged] = -np.log(np.clip(of_truth, LEAST_CHANCE, 1.0))
    return result


def compared_rules(
    rules: Mapping[str, np.ndarray], is_strong: np.ndarray, place: np.ndarray, seed: int
) -> pd.DataFrame:
    """Return a row for each rule: ``model``, its name; ``log_loss``; and ``gain`` with its 95 % interval.

    The gain is the log-loss of the rule `STREET` less that of the rule; above 0 the rule predicts better.

    Args:
      rules: from `features_of`; `STREET` must be one of them.
      is_strong: ``[R]`` truths.
      place: ``[R]`` number of the rows' block along the track.
      seed: of the bootstrap.
    """
    # [D] the mean loss of each rule under each draw of blocks, the first one without drawing.
    block, weights = drawn_blocks(place, seed)
    num_blocks = weights.shape[1]
    totals = weights @ np.bincount(block, minlength=num_blocks)
    means = {}
    for name, features in rules.items():
        of_blocks = np.bincount(block, losses(features, is_strong, block), num_blocks)
        means[name] = weights @ of_blocks / totals

    # The gain on the rule that knows the street, with its interval over the draws.
    rows = []
    for name, mean in means.items():
        gain = means[STREET] - mean
        interval = interval_of(gain[0], gain[1:], num_blocks)
        rows.append({"model": name, "log_loss": mean[0], **named("gain", interval)})
    return pd.DataFrame(rows)


def gain_by_length(
    rules: Mapping[str, np.ndarray],
    is_strong: np.ndarray,
    place: np.ndarray,
    block_m: float,
    seed: int,
) -> pd.DataFrame:
    """Return the gain of margin and elevation with blocks that are once, twice and four times as long.

    Neighbouring blocks are more alike the shorter they are, which makes intervals too narrow. A gain that holds with
    longer blocks does not rest on this.

    Args:
      rules: from `features_of`.
      is_strong: ``[R]`` truths.
      place: ``[R]`` number of the rows' block along the track.
      block_m: length of these blocks.
      seed: of the bootstrap.

    Returns:
      Rows of ``block_m``, ``num_blocks``, ``gain``, ``gain_low``, ``gain_high``.
    """
    compared = {name: rules[name] for name in (STREET, MAP)}
    rows = []
    for times in LENGTHS:
        longer = place // times
        judged = compared_rules(compared, is_strong, longer, seed).set_index("model")
        gain = judged.loc[MAP].drop("log_loss")
        rows.append({"block_m": times * block_m, "num_blocks": len(np.unique(longer)), **gain})
    return pd.DataFrame(rows)
