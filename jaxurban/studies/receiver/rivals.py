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
from jaxurban.studies.bootstrap import ends_of

MOST_FOLDS = 100  # with more blocks, every hundredth is left out together
RIDGE, NUM_STEPS, LEAST_CHANCE = 1e-3, 12, 1e-6
STREET, MAP = "street", "margin and elevation"


def features_of(
    margin_m: np.ndarray, elevation_rad: np.ndarray, off_street_rad: np.ndarray
) -> Mapping[str, np.ndarray]:
    """Return what each rule predicts from, ``[R, K]`` by its name.

    Margins count by the shape of `jaxurban.metrics.reception.ReceptionCurve`, whose coefficients every fit chooses.

    Args:
      margin_m: ``[R]`` antenna less the shadow's edge.
      elevation_rad: ``[R]`` of the satellite.
      off_street_rad: ``[R]`` angle between its azimuth and the street.
    """
    sky = [elevation_rad, elevation_rad**2]
    across_rad = np.arctan2(np.tan(elevation_rad), np.abs(np.sin(off_street_rad)))  # up the walls of the street
    chance = ReceptionCurve.measured_in_tokyo().chance(jnp.asarray(margin_m))
    of_margin = logit(np.asarray(chance, np.float64))
    rules = {
        "constant": [],
        "elevation": sky,
        STREET: [*sky, across_rad, across_rad**2, across_rad * elevation_rad],
        "seen or hidden": [margin_m >= 0],
        "margin": [of_margin],
        MAP: [*sky, of_margin],
    }
    return {name: np.stack([np.ones(len(margin_m)), *columns], axis=1) for name, columns in rules.items()}


def fitted(features: np.ndarray, is_strong: np.ndarray) -> np.ndarray:
    """Return ``[K]`` coefficients of the logistic regression of ``[R]`` truths on ``[R, K]``, by Newton's method."""
    chosen = np.zeros(features.shape[1])
    ridge = RIDGE * np.eye(len(chosen))
    for _ in range(NUM_STEPS):
        chance = expit(features @ chosen)
        slope = features.T @ (is_strong - chance) - ridge @ chosen
        curvature = (features * (chance * (1 - chance))[:, None]).T @ features + ridge
        chosen += np.linalg.solve(curvature, slope)
    return chosen


def losses(features: np.ndarray, is_strong: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return ``[R]`` -ln(chance of what happened), each block judged by what all others say."""
    lost = np.empty(len(block))
    fold = block % MOST_FOLDS
    for number in np.unique(fold):
        is_left = fold == number
        chance = expit(features[is_left] @ fitted(features[~is_left], is_strong[~is_left]))
        lost[is_left] = -np.log(np.clip(np.where(is_strong[is_left], chance, 1 - chance), LEAST_CHANCE, 1.0))
    return lost


def compared_rules(
    rules: Mapping[str, np.ndarray], is_strong: np.ndarray, block: np.ndarray, weights: np.ndarray
) -> pd.DataFrame:
    """Return a row a rule: ``model``, ``log_loss``, ``gain`` on the rule of the street, with its 95 % interval.

    Args:
      rules: from `features_of`.
      is_strong: ``[R]`` truths.
      block: ``[R]`` number of the block of track, below B.
      weights: ``[D, B]`` how often each draw of the bootstrap holds each block, the first one all of them once.
    """
    num_blocks = weights.shape[1]
    totals = weights @ np.bincount(block, minlength=num_blocks)
    means = {
        name: weights @ np.bincount(block, losses(features, is_strong, block), num_blocks) / totals
        for name, features in rules.items()
    }
    rows = []
    for name, mean in means.items():
        gain = means[STREET] - mean
        low, high = ends_of(gain[1:], num_blocks)
        rows.append({"model": name, "log_loss": mean[0], "gain": gain[0], "gain_low": low, "gain_high": high})
    return pd.DataFrame(rows)
