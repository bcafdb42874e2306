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
from jaxurban.studies.bootstrap import interval_of, named
from jaxurban.studies.receiver.scores import drawn_blocks

MOST_FOLDS = 100  # with more blocks, every hundredth is left out together
RIDGE, NUM_STEPS, LEAST_CHANCE = 1e-3, 12, 1e-6
LENGTHS = 1, 2, 4  # of blocks, times that of the study
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
    # Up the walls of the street.
    across_rad = np.arctan2(np.tan(elevation_rad), np.abs(np.sin(off_street_rad)))
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
    return {
        name: np.stack([np.ones(len(margin_m)), *columns], axis=1)
        for name, columns in rules.items()
    }


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
    """Return ``[R]`` -ln(chance of what happened), each block judged by what all others say; NaN without another."""
    lost = np.full(len(block), np.nan)
    fold = block % MOST_FOLDS
    folds = np.unique(fold)
    if len(folds) == 1:
        return lost
    for number in folds:
        is_left = fold == number
        chance = expit(features[is_left] @ fitted(features[~is_left], is_strong[~is_left]))
        of_truth = np.where(is_strong[is_left], chance, 1 - chance)
        lost[is_left] = -np.log(np.clip(of_truth, LEAST_CHANCE, 1.0))
    return lost


def compared_rules(
    rules: Mapping[str, np.ndarray], is_strong: np.ndarray, place: np.ndarray, seed: int
) -> pd.DataFrame:
    """Return a row per rule: ``model``, ``log_loss``, ``gain`` on the rule of the street, with its 95 % interval.

    Args:
      rules: from `features_of`.
      is_strong: ``[R]`` truths.
      place: ``[R]`` number of the rows' block along the track.
      seed: of the bootstrap.
    """
    block, weights = drawn_blocks(place, seed)
    num_blocks = weights.shape[1]
    totals = weights @ np.bincount(block, minlength=num_blocks)
    means = {
        name: weights @ np.bincount(block, losses(features, is_strong, block), num_blocks) / totals
        for name, features in rules.items()
    }
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
    """Return the gain of margin and elevation where blocks are `LENGTHS` times as long: neighbours are less alike.

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
