"""Scores of a prediction along a track: medians over pieces, ranked; the shifted city and the open sky beside."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jaxurban.io.read.receiver import ERROR, LAT, LON, SATELLITE, TRACKED, UTC, ReceiverLog
from jaxurban.studies.receiver.agreement import Agreement, Scored, auc, scored, spearman
from jaxurban.studies.receiver.prediction import NUM_VISIBLE, Prediction
from jaxurban.studies.receiver.satellites import TrackedSatellites, satellite_agreements
from jaxurban.studies.receiver.settings import ReceiverSettings
from jaxurban.studies.receiver.track import Track

MAIN = {TRACKED: NUM_VISIBLE, ERROR: "hdop", SATELLITE: "line of sight", "cn0_dbhz": "line of sight"}
MORE_IS_BETTER = (TRACKED, NUM_VISIBLE, "gps")  # of all else, dilutions of precision and errors, less is
OPEN = "open_"  # before the names of what the open sky says
SPEARMAN, AUC = "spearman", "auc"


class Row(NamedTuple):
    """What is scored: a witness against a prediction, over pieces of a length, NaN for every epoch by itself."""

    witness: str
    prediction: str
    piece_m: float


def pieces_of(
    log: ReceiverLog, track: Track, predicted: Prediction, piece_m: float, block_m: float, shift: int = 0
) -> pd.DataFrame:
    """Return a row a piece of track: medians of what the receiver told and of what maps and the open sky say.

    Columns: ``piece``, ``block`` (numbers along the track), ``utc`` (of the middle epoch), ``epochs``, ``along_m``,
    ``lon_deg``, ``lat_deg``, ``x_m``, ``y_m``, the witnesses, the predictions, and those of the open sky with
    ``open_`` before their names. Epochs in a building or without data are left out.

    Args:
      log, track: of the receiver.
      predicted: at its epochs.
      piece_m, block_m: lengths along the track.
      shift: number of the shift.
    """
    said = {name: values[shift] for name, values in predicted.values.items()}
    opened = {f"{OPEN}{name}": values for name, values in predicted.open_sky.items()}
    where = {
        "along_m": track.along_m,
        **{name: log.epochs[name] for name in (LON, LAT)},
        "x_m": track.x_m,
        "y_m": track.y_m,
    }
    told = {name: log.epochs[name] for name in log.witnesses}
    frame = pd.DataFrame({"piece": track.cut(piece_m), UTC: log.epochs[UTC], **where, **told, **said, **opened})
    frame = frame[~np.isnan(predicted.values[NUM_VISIBLE][shift])]
    grouped = frame.groupby("piece")
    made = grouped.median(numeric_only=True)
    made.insert(0, "block", (made.index * piece_m // block_m).astype(np.int64))
    made.insert(1, UTC, grouped[UTC].quantile(0.5, interpolation="nearest"))
    made.insert(2, "epochs", grouped.size())
    return made.reset_index()


def agreements(
    pieces: pd.DataFrame, row: Row, settings: ReceiverSettings, prefix: str = ""
) -> tuple[dict[str, Agreement], np.ndarray]:
    """Return Spearman's coefficient and, of counts, the AUC, as functions of how often each piece counts; the blocks.

    Both are positive (above a half) where the receiver does better where the maps say so.
    """
    known = pieces[pieces[row.witness].notna() & pieces[f"{prefix}{row.prediction}"].notna()]
    told, said = known[row.witness].to_numpy(), known[f"{prefix}{row.prediction}"].to_numpy()
    told, said = (
        values if name in MORE_IS_BETTER else -values for name, values in ((row.witness, told), (row.prediction, said))
    )
    found: dict[str, Agreement] = {SPEARMAN: lambda counts: spearman(told, said, counts)}
    if row.witness == TRACKED:
        is_few = told <= settings.at_most_tracked
        found[AUC] = lambda counts: auc(-said, is_few, counts)
    return found, known["block"].to_numpy()


def score(found: tuple[dict[str, Agreement], np.ndarray], seed: int) -> dict[str, Scored]:
    """Return each coefficient with its interval."""
    functions, blocks = found
    return {name: scored(function, blocks, seed) for name, function in functions.items()}


def plain(found: tuple[dict[str, Agreement], np.ndarray]) -> dict[str, float]:
    """Return each coefficient without its interval."""
    functions, blocks = found
    once = np.ones((1, len(blocks)), np.int64)
    return {name: float(function(once)[0]) if len(blocks) else np.nan for name, function in functions.items()}


def tables(
    log: ReceiverLog,
    track: Track,
    predicted: Prediction,
    tracked: TrackedSatellites | None,
    settings: ReceiverSettings,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the scores and the shifts, as `jaxurban.studies.receiver.validate.ReceiverValidation` holds them."""
    scores: list[dict[str, Any]] = []
    shifts: list[dict[str, Any]] = []
    for piece_m in settings.pieces_m:
        by_shift = [
            pieces_of(log, track, predicted, piece_m, settings.block_m, q) for q in range(len(predicted.shifts_m))
        ]
        for row in _rows(log, predicted, piece_m, settings):
            found = score(agreements(by_shift[0], row, settings), settings.seed)
            opened = plain(agreements(by_shift[0], row, settings, OPEN))
            moved = [plain(agreements(pieces, row, settings)) for pieces in by_shift]
            num = int(by_shift[0][row.witness].notna().sum())
            scores.append(_score_row(row, num, found, opened, moved, predicted, settings))
            shifts += _shift_rows(row, moved, predicted)
    if tracked is not None:
        blocks = (track.along_m // settings.block_m).astype(np.int64)
        made = [satellite_agreements(tracked, predicted, q, blocks) for q in range(len(predicted.shifts_m))]
        for witness, (agreement, of_block) in made[0].items():
            row = Row(witness, MAIN[witness], np.nan)
            moved = [plain(({AUC: each[witness][0]}, each[witness][1])) for each in made]
            found = score(({AUC: agreement}, of_block), settings.seed)
            scores.append(_score_row(row, len(log.epochs), found, {AUC: 0.5}, moved, predicted, settings))
            shifts += _shift_rows(row, moved, predicted)
    return pd.DataFrame(scores), pd.DataFrame(shifts)


def _rows(log: ReceiverLog, predicted: Prediction, piece_m: float, settings: ReceiverSettings) -> list[Row]:
    """Return what is scored at a length: at the chosen one every prediction, at others each witness's own."""
    is_chosen = piece_m == settings.piece_m
    return [
        Row(witness, name, piece_m)
        for witness in log.witnesses
        for name in predicted.values
        if is_chosen or name == MAIN[witness]
    ]


def _score_row(
    row: Row,
    num: int,
    found: dict[str, Scored],
    opened: dict[str, float],
    moved: Sequence[dict[str, float]],
    predicted: Prediction,
    settings: ReceiverSettings,
) -> dict[str, Any]:
    is_control = np.abs(predicted.shifts_m) >= settings.block_m
    made: dict[str, Any] = {**row._asdict(), "num": num}
    for name in (SPEARMAN, AUC):
        of = found.get(name)
        made |= {name: np.nan if of is None else of.value}
        made |= {f"{name}_low": np.nan if of is None else of.low, f"{name}_high": np.nan if of is None else of.high}
        made[f"{name}_open"] = opened.get(name, np.nan)
        values = np.array([each.get(name, np.nan) for each in moved])
        values[~is_control] = np.nan
        has_any = bool(np.isfinite(values).any())
        made[f"{name}_shifted"] = float(np.nanmax(values)) if has_any else np.nan
        made[f"{name}_shifted_by_m"] = float(predicted.shifts_m[np.nanargmax(values)]) if has_any else np.nan
    return made


def _shift_rows(row: Row, moved: Sequence[dict[str, float]], predicted: Prediction) -> list[dict[str, Any]]:
    if row.prediction != MAIN[row.witness]:
        return []
    return [
        {**row._asdict(), "shift_m": float(shift_m), SPEARMAN: each.get(SPEARMAN, np.nan), AUC: each.get(AUC, np.nan)}
        for shift_m, each in zip(predicted.shifts_m, moved, strict=True)
    ]
