"""How well maps rank what a receiver did along a track, and what chance leaves of it.

Legend: ``N`` values in the order of the track, ``G`` blocks of the track.

**Within blocks** the ranks are those of the whole track less their mean over the value's block. What is left says
whether the two quantities rise and fall together from one street to the next, and not that one quarter of the city is
denser than another. **Shifts** are the control: the maps' values are moved along the track, its end joined to its
beginning, by every number of places, so that both series stay what they are and only their pairing is lost.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import rankdata
from scipy.stats import t as student

from jaxurban.io.read.receiver import ERROR, TRACKED, UTC
from jaxurban.studies.bootstrap import FEWEST_GROUPS, LEVEL
from jaxurban.studies.receiver.prediction import NUM_VISIBLE, ReceiverSettings

MAIN = {TRACKED: NUM_VISIBLE, ERROR: "hdop"}
MORE_IS_BETTER = (TRACKED, NUM_VISIBLE, "gps")  # of all else, dilutions of precision and errors, less is
WITHIN, SPEARMAN = COEFFICIENTS = ("within", "spearman")
SHIFTS_BELOW = 0.95  # of all shifts score no more than the `_shifts_95` of a coefficient


class Scored(NamedTuple):
    """A coefficient and its 95 % interval; NaN where it is not defined."""

    value: float
    low: float
    high: float


def spearman(a: np.ndarray, b: np.ndarray, blocks: np.ndarray | None = None) -> float:
    """Return Spearman's rank correlation of values ``[N]``, ties by mean ranks; NaN where either does not vary.

    Args:
      a, b: the values.
      blocks: ``[N]`` block of each value, for the correlation within blocks; None: over the whole track.
    """
    return float(_coefficient(*_products(a, b, blocks).sum(axis=1)))


def without_each_block(a: np.ndarray, b: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Return ``[G]`` the correlation within blocks (`spearman`) when one block after the other is left out."""
    products = _products(a, b, blocks)
    return _coefficient(*(products.sum(axis=1, keepdims=True) - products))


def _coefficient(aa: np.ndarray, ab: np.ndarray, bb: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.maximum(aa * bb, 0.0))
    return np.divide(ab, size, out=np.full(np.shape(ab), np.nan), where=size > 0)


def _products(a: np.ndarray, b: np.ndarray, blocks: np.ndarray | None) -> np.ndarray:
    """Return ``[3, G]`` sums over each block of the products of ranks, less their means: a a, a b and b b.

    Without blocks the whole track is one.
    """
    _, number = np.unique(np.zeros(len(a)) if blocks is None else blocks, return_inverse=True)
    ranks = np.array([rankdata(values) for values in (a, b)])
    of_a, of_b = (each - (np.bincount(number, each) / np.bincount(number))[number] for each in ranks)
    return np.array([np.bincount(number, product) for product in (of_a * of_a, of_a * of_b, of_b * of_b)])


def half_width(without_each: np.ndarray) -> float:
    """Return half the 95 % interval of a statistic by the jackknife over blocks: Student's t, G - 2 degrees of freedom.

    NaN with fewer blocks than `jaxurban.studies.bootstrap.FEWEST_GROUPS`, or where the statistic is not defined.

    Args:
      without_each: ``[G]`` the statistic when one block after the other is left out.
    """
    num = len(without_each)
    if num < FEWEST_GROUPS:
        return np.nan
    deviation = np.sqrt((num - 1) * np.var(without_each))
    return float(student.ppf((1 + LEVEL) / 2, num - 2) * deviation)


def within_blocks(a: np.ndarray, b: np.ndarray, blocks: np.ndarray) -> Scored:
    """Return the rank correlation within blocks of values ``[N]``, and its interval on Fisher's scale."""
    value = spearman(a, b, blocks)
    if not abs(value) < 1:
        return Scored(value, np.nan, np.nan)
    half = half_width(np.arctanh(without_each_block(a, b, blocks)))
    low, high = np.tanh(np.arctanh(value) + np.array([-half, half]))
    return Scored(value, float(low), float(high))


def shifted(coefficient: Callable[[np.ndarray], float], values: np.ndarray) -> np.ndarray:
    """Return ``[N]`` a coefficient at every circular shift of the maps' values ``[N, ...]``, the first at none.

    At number ``s`` each place of the track is set against the values ``s`` places ahead.
    """
    return np.array([coefficient(np.roll(values, -shift, axis=0)) for shift in range(len(values))])


def pieces_of(epochs: pd.DataFrame, piece_m: float, block_m: float) -> pd.DataFrame:
    """Return a row a piece of track: medians of what the receiver logged and of what the maps say.

    Columns: ``piece``, ``block`` (numbers along the track), ``utc`` (of the middle epoch), ``epochs`` (how many), and
    those of the epochs. Epochs in a building or without data are left out.

    Args:
      epochs: as `jaxurban.studies.receiver.validate.ReceiverValidation` holds them.
      piece_m, block_m: lengths along the track.
    """
    frame = epochs.assign(piece=(epochs.along_m // piece_m).astype(np.int64))
    grouped = frame[frame[NUM_VISIBLE].notna()].groupby("piece")
    medians = grouped.median(numeric_only=True)
    medians.insert(0, "block", (medians.index * piece_m // block_m).astype(np.int64))
    medians.insert(1, UTC, grouped[UTC].quantile(0.5, interpolation="nearest"))
    medians.insert(2, "epochs", grouped.size())
    return medians.reset_index()


def compared(pieces: pd.DataFrame, witness: str, prediction: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``[N]`` of the pieces that have both: how well the receiver did, how well by the maps, and the blocks.

    More is better in both, so that coefficients are positive where the receiver does better where the maps say so.
    """
    known = pieces[pieces[witness].notna() & pieces[prediction].notna()]
    receiver, maps = (
        known[name].to_numpy(float) * (1 if name in MORE_IS_BETTER else -1) for name in (witness, prediction)
    )
    return receiver, maps, known["block"].to_numpy()


def tables(
    epochs: pd.DataFrame, witnesses: Sequence[str], predictions: Iterable[str], settings: ReceiverSettings
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the scores and the shifts, as `jaxurban.studies.receiver.validate.ReceiverValidation` holds them.

    At the chosen length of pieces every prediction is scored, at others each witness's own.
    """
    scores, shifts = [], []
    for piece_m in settings.pieces_m:
        pieces = pieces_of(epochs, piece_m, settings.block_m)
        for witness in witnesses:
            for prediction in predictions if piece_m == settings.piece_m else (MAIN[witness],):
                row: dict[str, Any] = {"witness": witness, "prediction": prediction, "piece_m": piece_m}
                receiver, maps, blocks = compared(pieces, witness, prediction)
                at_shifts = {
                    WITHIN: shifted(partial(spearman, receiver, blocks=blocks), maps),
                    SPEARMAN: shifted(partial(spearman, receiver), maps),
                }
                if prediction == MAIN[witness]:
                    shift = (np.arange(len(maps)) + len(maps) // 2) % max(len(maps), 1) - len(maps) // 2
                    shifts.append(pd.DataFrame({**row, "shift": shift, **at_shifts}))
                row["num"] = len(maps)
                row["within_low"], row["within_high"] = within_blocks(receiver, maps, blocks)[1:]
                for name, values in at_shifts.items():
                    is_defined = len(values) > 1 and bool(np.isfinite(values[0]))
                    row[name] = values[0] if is_defined else np.nan
                    row[f"{name}_shifts_95"] = np.nanquantile(values[1:], SHIFTS_BELOW) if is_defined else np.nan
                    row[f"{name}_p"] = np.mean(values >= values[0]) if is_defined else np.nan
                scores.append(row)
    return pd.DataFrame(scores), pd.concat(shifts, ignore_index=True)
