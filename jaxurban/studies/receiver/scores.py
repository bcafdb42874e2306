"""Scores of a prediction along a track: medians over pieces, ranked; every shift along the track and the open sky."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from jaxurban.io.read.receiver import ERROR, LAT, LON, SATELLITE, TRACKED, UTC, ReceiverLog
from jaxurban.studies.receiver.agreement import UNKNOWN, auc, shifted, spearman, within_blocks
from jaxurban.studies.receiver.prediction import NUM_VISIBLE, Prediction
from jaxurban.studies.receiver.satellites import TrackedSatellites, satellite_agreements
from jaxurban.studies.receiver.settings import ReceiverSettings
from jaxurban.studies.receiver.track import Track

MAIN = {TRACKED: NUM_VISIBLE, ERROR: "hdop", SATELLITE: "line of sight", "cn0_dbhz": "line of sight"}
MORE_IS_BETTER = (TRACKED, NUM_VISIBLE, "gps")  # of all else, dilutions of precision and errors, less is
OPEN = "open_"  # before the names of what the open sky says
WITHIN, SPEARMAN, AUC = COEFFICIENTS = ("within", "spearman", "auc")
SHIFTS_BELOW = 0.95  # of all shifts score no more than the `_shifts_95` of a coefficient

Coefficients = Mapping[str, Callable[[np.ndarray], float]]  # of the maps' values


class Row(NamedTuple):
    """What is scored: a witness against a prediction, over pieces of a length, NaN for every epoch by itself."""

    witness: str
    prediction: str
    piece_m: float


def pieces_of(log: ReceiverLog, track: Track, predicted: Prediction, piece_m: float, block_m: float) -> pd.DataFrame:
    """Return a row a piece of track: medians of what the receiver logged and of what maps and the open sky say.

    Columns: ``piece``, ``block`` (numbers along the track), ``utc`` (of the middle epoch), ``epochs``, ``along_m``,
    ``lon_deg``, ``lat_deg``, ``x_m``, ``y_m``, the witnesses, the predictions, and those of the open sky with
    ``open_`` before their names. Epochs in a building or without data are left out.

    Args:
      log, track: of the receiver.
      predicted: at its epochs.
      piece_m, block_m: lengths along the track.
    """
    opened = {f"{OPEN}{name}": values for name, values in predicted.open_sky.items()}
    where = {
        "along_m": track.along_m,
        **{name: log.epochs[name] for name in (LON, LAT)},
        "x_m": track.x_m,
        "y_m": track.y_m,
    }
    witnesses = {name: log.epochs[name] for name in log.witnesses}
    frame = pd.DataFrame(
        {"piece": track.cut(piece_m), UTC: log.epochs[UTC], **where, **witnesses, **predicted.values, **opened}
    )
    frame = frame[predicted.is_known]
    grouped = frame.groupby("piece")
    medians = grouped.median(numeric_only=True)
    medians.insert(0, "block", (medians.index * piece_m // block_m).astype(np.int64))
    medians.insert(1, UTC, grouped[UTC].quantile(0.5, interpolation="nearest"))
    medians.insert(2, "epochs", grouped.size())
    return medians.reset_index()


def compared(pieces: pd.DataFrame, row: Row, prefix: str = "") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``[N]`` of the pieces that have both: how well the receiver did, how well by the maps, and the blocks.

    More is better in both, so that coefficients are positive where the receiver does better where the maps say so.
    """
    known = pieces[pieces[row.witness].notna() & pieces[f"{prefix}{row.prediction}"].notna()]
    receiver, maps = (
        known[column].to_numpy(float) * (1 if name in MORE_IS_BETTER else -1)
        for column, name in ((row.witness, row.witness), (f"{prefix}{row.prediction}", row.prediction))
    )
    return receiver, maps, known["block"].to_numpy()


def tables(
    log: ReceiverLog,
    track: Track,
    predicted: Prediction,
    tracked: TrackedSatellites | None,
    settings: ReceiverSettings,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the scores and the shifts, as `jaxurban.studies.receiver.validate.ReceiverValidation` holds them."""
    scores: list[dict[str, Any]] = []
    shifts: list[pd.DataFrame] = []
    for piece_m in settings.pieces_m:
        pieces = pieces_of(log, track, predicted, piece_m, settings.block_m)
        for row in _rows(log, predicted, piece_m, settings):
            receiver, maps, blocks = compared(pieces, row)
            at_shifts = _at_shifts(_coefficients(row, receiver, blocks, settings), maps)
            interval = within_blocks(receiver, maps, blocks)[1:] if len(maps) else UNKNOWN
            receiver, maps, blocks = compared(pieces, row, OPEN)
            opened = {name: of(maps) for name, of in _coefficients(row, receiver, blocks, settings).items()}
            scores.append(_score_row(row, at_shifts, interval, opened))
            if row.prediction == MAIN[row.witness]:
                shifts.append(_shift_rows(row, at_shifts))
    if tracked is not None:
        for witness, coefficient in satellite_agreements(tracked, predicted).items():
            row = Row(witness, MAIN[witness], np.nan)
            at_shifts = _at_shifts({AUC: coefficient}, predicted.is_seen[predicted.is_known])
            scores.append(_score_row(row, at_shifts, UNKNOWN, {AUC: 0.5}))
            shifts.append(_shift_rows(row, at_shifts))
    return pd.DataFrame(scores), pd.concat(shifts, ignore_index=True)


def _rows(log: ReceiverLog, predicted: Prediction, piece_m: float, settings: ReceiverSettings) -> list[Row]:
    """Return what is scored at a length: at the chosen one every prediction, at others each witness's own."""
    is_chosen = piece_m == settings.piece_m
    return [
        Row(witness, name, piece_m)
        for witness in log.witnesses
        for name in predicted.values
        if is_chosen or name == MAIN[witness]
    ]


def _coefficients(row: Row, receiver: np.ndarray, blocks: np.ndarray, settings: ReceiverSettings) -> Coefficients:
    """Return what is computed of the maps' values: both correlations and, of counts, the AUC."""
    is_few = receiver <= settings.at_most_tracked
    of_counts = {AUC: lambda maps: auc(rankdata(-maps), is_few)} if row.witness == TRACKED else {}
    return {
        WITHIN: lambda maps: spearman(receiver, maps, blocks),
        SPEARMAN: lambda maps: spearman(receiver, maps),
        **of_counts,
    }


def _at_shifts(coefficients: Coefficients, maps: np.ndarray) -> dict[str, np.ndarray]:
    """Return ``[N]`` each coefficient at every shift of the maps' values, NaN where it is not computed."""
    return {
        name: shifted(coefficients[name], maps) if name in coefficients else np.full(len(maps), np.nan)
        for name in COEFFICIENTS
    }


def _score_row(
    row: Row, at_shifts: Mapping[str, np.ndarray], interval: tuple[float, float], opened: Mapping[str, float]
) -> dict[str, Any]:
    made: dict[str, Any] = {**row._asdict(), "num": len(at_shifts[WITHIN])}
    for name, values in at_shifts.items():
        is_defined = len(values) > 1 and bool(np.isfinite(values[0]))
        made[name] = values[0] if is_defined else np.nan
        if name == WITHIN:
            made[f"{name}_low"], made[f"{name}_high"] = interval
        made[f"{name}_shifts_95"] = np.nanquantile(values[1:], SHIFTS_BELOW) if is_defined else np.nan
        made[f"{name}_p"] = np.mean(values >= values[0]) if is_defined else np.nan
        made[f"{name}_open"] = opened.get(name, np.nan)
    return made


def _shift_rows(row: Row, at_shifts: Mapping[str, np.ndarray]) -> pd.DataFrame:
    num = len(at_shifts[WITHIN])
    return pd.DataFrame({**row._asdict(), "shift": (np.arange(num) + num // 2) % num - num // 2, **at_shifts})
