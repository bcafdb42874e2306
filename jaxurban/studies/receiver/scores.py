"""Scores of a prediction along a track: medians over pieces, ranked, and every shift along the track."""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jaxurban.io.read.receiver import ERROR, LAT, LON, TRACKED, UTC, ReceiverLog
from jaxurban.studies.receiver.agreement import UNKNOWN, shifted, spearman, within_blocks
from jaxurban.studies.receiver.prediction import NUM_VISIBLE
from jaxurban.studies.receiver.settings import ReceiverSettings
from jaxurban.studies.receiver.track import Track

MAIN = {TRACKED: NUM_VISIBLE, ERROR: "hdop"}
MORE_IS_BETTER = (TRACKED, NUM_VISIBLE, "gps")  # of all else, dilutions of precision and errors, less is
WITHIN, SPEARMAN = COEFFICIENTS = ("within", "spearman")
SHIFTS_BELOW = 0.95  # of all shifts score no more than the `_shifts_95` of a coefficient


class Row(NamedTuple):
    """What is scored: a witness against a prediction, over pieces of a length."""

    witness: str
    prediction: str
    piece_m: float


def pieces_of(
    log: ReceiverLog, track: Track, predicted: Mapping[str, np.ndarray], piece_m: float, block_m: float
) -> pd.DataFrame:
    """Return a row a piece of track: medians of what the receiver logged and of what the maps say.

    Columns: ``piece``, ``block`` (numbers along the track), ``utc`` (of the middle epoch), ``epochs``, ``along_m``,
    ``lon_deg``, ``lat_deg``, ``x_m``, ``y_m``, the witnesses and the predictions. Epochs in a building or without data
    are left out.

    Args:
      log, track: of the receiver.
      predicted: ``[N]`` by name, at its epochs.
      piece_m, block_m: lengths along the track.
    """
    places = {"along_m": track.along_m, **{name: log.epochs[name] for name in (LON, LAT)}}
    places |= {"x_m": track.x_m, "y_m": track.y_m} | {name: log.epochs[name] for name in log.witnesses}
    frame = pd.DataFrame({"piece": track.cut(piece_m), UTC: log.epochs[UTC], **places, **predicted})
    grouped = frame[frame[NUM_VISIBLE].notna()].groupby("piece")
    medians = grouped.median(numeric_only=True)
    medians.insert(0, "block", (medians.index * piece_m // block_m).astype(np.int64))
    medians.insert(1, UTC, grouped[UTC].quantile(0.5, interpolation="nearest"))
    medians.insert(2, "epochs", grouped.size())
    return medians.reset_index()


def compared(pieces: pd.DataFrame, row: Row) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``[N]`` of the pieces that have both: how well the receiver did, how well by the maps, and the blocks.

    More is better in both, so that coefficients are positive where the receiver does better where the maps say so.
    """
    known = pieces[pieces[row.witness].notna() & pieces[row.prediction].notna()]
    receiver, maps = (
        known[name].to_numpy(float) * (1 if name in MORE_IS_BETTER else -1) for name in (row.witness, row.prediction)
    )
    return receiver, maps, known["block"].to_numpy()


def tables(
    log: ReceiverLog, track: Track, predicted: Mapping[str, np.ndarray], settings: ReceiverSettings
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the scores and the shifts, as `jaxurban.studies.receiver.validate.ReceiverValidation` holds them.

    At the chosen length of pieces every prediction is scored, at others each witness's own.
    """
    scores, shifts = [], []
    for piece_m in settings.pieces_m:
        pieces = pieces_of(log, track, predicted, piece_m, settings.block_m)
        for witness in log.witnesses:
            for prediction in predicted if piece_m == settings.piece_m else (MAIN[witness],):
                row = Row(witness, prediction, piece_m)
                receiver, maps, blocks = compared(pieces, row)
                at_shifts = {
                    WITHIN: shifted(partial(spearman, receiver, blocks=blocks), maps),
                    SPEARMAN: shifted(partial(spearman, receiver), maps),
                }
                interval = within_blocks(receiver, maps, blocks)[1:] if len(maps) else UNKNOWN
                scores.append(_score_row(row, at_shifts, interval))
                if prediction == MAIN[witness]:
                    shift = (np.arange(len(maps)) + len(maps) // 2) % max(len(maps), 1) - len(maps) // 2
                    shifts.append(pd.DataFrame({**row._asdict(), "shift": shift, **at_shifts}))
    return pd.DataFrame(scores), pd.concat(shifts, ignore_index=True)


def _score_row(row: Row, at_shifts: Mapping[str, np.ndarray], interval: tuple[float, float]) -> dict[str, Any]:
    made: dict[str, Any] = {**row._asdict(), "num": len(at_shifts[WITHIN])}
    for name, values in at_shifts.items():
        is_defined = len(values) > 1 and bool(np.isfinite(values[0]))
        made[name] = values[0] if is_defined else np.nan
        if name == WITHIN:
            made[f"{name}_low"], made[f"{name}_high"] = interval
        made[f"{name}_shifts_95"] = np.nanquantile(values[1:], SHIFTS_BELOW) if is_defined else np.nan
        made[f"{name}_p"] = np.mean(values >= values[0]) if is_defined else np.nan
    return made
