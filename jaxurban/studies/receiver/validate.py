"""validate: a receiver's log against maps that are made at its times, places and antenna height.

Legend: ``N`` values in the order of the track, ``G`` blocks of the track.

**Within blocks** the ranks are those of the whole track less their mean over the value's block. What is left says
whether the two quantities rise and fall together from one street to the next, and not that one quarter of the city is
denser than another. **Shifts** are the control: the maps' values are moved along the track, its end joined to its
beginning, by every number of places, so that both series stay what they are and only their pairing is lost.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import rankdata
from scipy.stats import t as student

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.read.receivers import read_log
from jaxurban.io.read.tracks import AZIMUTH, CN0, UTC
from jaxurban.io.results import Result
from jaxurban.io.samples import log_of
from jaxurban.knowledge import Caution, Guesses
from jaxurban.maps.run import grid_of
from jaxurban.maps.scenario import Scenario
from jaxurban.progress import Progress, reporting
from jaxurban.satellites.sight import Sight
from jaxurban.satellites.track import NUM_VISIBLE
from jaxurban.studies.bootstrap import FEWEST_GROUPS, LEVEL, Interval
from jaxurban.studies.receiver.agreement import SatelliteAgreement, agreement_of
from jaxurban.studies.receiver.logs import ERROR, TRACKED, ReceiverLog, read_receiver_log
from jaxurban.studies.receiver.logs import log_of as table_log
from jaxurban.studies.receiver.prediction import ReceiverSettings, predict, track_of
from jaxurban.studies.receiver.rinex import with_navigation
from jaxurban.studies.receiver.satellites import counted, known_of, with_directions

MAIN = {TRACKED: NUM_VISIBLE, ERROR: "hdop"}
# Of all else, dilutions of precision and errors, less is better.
MORE_IS_BETTER = (TRACKED, NUM_VISIBLE, "gps")
WITHIN, SPEARMAN = COEFFICIENTS = ("within", "spearman")
SHIFTS_BELOW = 0.95  # of all shifts score no more than the `_shifts_95` of a coefficient
FEWEST_PIECES = 8  # fewer rank nothing


@dataclass(frozen=True, eq=False, repr=False)
class ReceiverValidation(Result):
    """A receiver's log beside what maps say along its track.

    Attributes:
      log: what the receiver logged.
      settings: how the two were set beside each other.
      scenario: the settings that the maps were made with.
      summary: numbers of the whole track: how many epochs there are and how many of them lie in a building, its length,
        and means. Names of metres end in ``_m``.
      epochs: a row for each epoch: time, place, distance along the track, witnesses (what the receiver logged of how
        well it did) and predictions (what the maps say), which are NaN in a building.
      pieces: a row for each piece of track of the length ``settings.piece_m``: medians of the columns of ``epochs``.
      scores: a row per ``witness``, ``prediction`` and ``piece_m``: ``num`` pieces, and for the rank correlation
        ``within`` blocks and ``spearman`` over the whole track the value, what 95 % of all shifts along the track stay
        at or below (``_shifts_95``) and the share of all shifts, that of 0 m among them, that score at least as high
        (``_p``); of ``within`` also the ends of its 95 % interval (``_low``, ``_high``). Above 0 the receiver does
        better where the maps say so; NaN where a coefficient is not defined.
      shifts: a row per witness, length of pieces and ``shift`` of the maps along the track, in pieces, with the
        coefficients.
      attribution: whom to credit for the city.
      guesses: what city and sky rest on that no file says.
      satellites: of a log with a row per satellite, how the maps agree with it, satellite by satellite; else None. Then
        ``num_visible`` and, where the log has none, ``num_tracked`` count the satellites that are judged.

    Examples:
      >>> result = ju.studies.validate(scenario, log, progress=False)
      >>> result.summary["epochs"], result.summary["epochs_left_out"], round(result.summary["length_m"])
      (40, 7, 338)
      >>> result.pieces[["piece", "epochs", "num_tracked", "num_visible"]].head(2)
         piece  epochs  num_tracked  num_visible
      0      0       3          5.0          5.0
      1      1       2          5.0          3.5
    """

    _command = "validate"
    _report = "receiver:validation_outputs"

    log: ReceiverLog
    settings: ReceiverSettings
    scenario: dict[str, Any]
    summary: dict[str, Any]
    epochs: pd.DataFrame
    pieces: pd.DataFrame
    scores: pd.DataFrame
    shifts: pd.DataFrame
    attribution: str = ""
    guesses: Guesses = ()
    satellites: SatelliteAgreement | None = None

    @property
    def known_cautions(self) -> list[Caution]:
        """The guesses that the result rests on, and which rows of satellites were not judged."""
        cautions = [Caution(guess.sentence, "guess", "guess") for guess in self.guesses]
        if self.satellites is not None:
            cautions += self.satellites.known_cautions
        return cautions

    @property
    def main(self) -> pd.DataFrame:
        """The scores of each witness against the prediction that is its own, over pieces of the chosen length."""
        is_main = self.scores.prediction == self.scores.witness.map(MAIN)
        return self.scores[is_main & (self.scores.piece_m == self.settings.piece_m)]

    @property
    def facts(self) -> dict[str, str]:
        """The log, the track and its cells, and what each witness scores."""
        summary = self.summary
        track = f"{summary['length_m'] / 1000:.2f} km, {summary['epochs']} epochs"
        facts = {"log": self.log.name, "track": track, "cells": f"{summary['resolution_m']:g} m"}
        if self.satellites is not None:
            facts |= self.satellites.facts
        for row in self.main.to_dict("records"):
            parts = [
                f"{name} {row[name]:.2f} (p {row[f'{name}_p']:.3f})"
                for name in COEFFICIENTS
                if not np.isnan(row[name])
            ]
            facts[str(row["witness"])] = ", ".join(parts) or "not defined"
        return facts


@typed
def validate(
    scenario: Scenario,
    log: str | Path | pd.DataFrame | None = None,
    settings: ReceiverSettings | None = None,
    *,
    navigation: str | Path | None = None,
    reference: str | Path | pd.DataFrame | None = None,
    progress: Progress = True,
) -> ReceiverValidation:
    """Return how well maps of a scenario predict what a receiver logged on its way through the city.

    For a log with a row per satellite, each C/N0 is compared with whether the city hides that satellite; the result
    holds this as ``satellites``. For a log of counts, maps are made of the scenario's city, orbits and mask, at the
    log's times and the antenna's height, and give satellites in view, dilutions of precision and m of GPS in the cells
    of the track. No number of the maps is fitted to the log.

    Args:
      scenario: of the maps; its times, its altitudes and the layers that a user added are ignored.
      log: the receiver's, as a table or its file (``.csv``, ``.csv.gz``, ``.parquet``), with ``utc``, ``lon_deg``
        (or ``lon``), ``lat_deg`` (or ``lat``), and: with a row per satellite, ``satellite``, ``cn0_dbhz`` (0: above the
        horizon, not received) and the satellite's ``azimuth_deg`` and ``elevation_deg``, without which the scenario's
        orbits give them; with a row per epoch, ``num_tracked``, ``error_2d_m`` or both. Or what the receiver wrote
        itself: observations in RINEX 2 to 4 (also CRINEX, with the extra ``receiver``), NMEA or Android's GnssLogger.
        Left out, the log of the sample city that the scenario names.
      settings: how the two are set beside each other.
      navigation: of such a file the satellites' orbits, broadcast RINEX or what ``[gps] orbits`` takes; they add the
        satellites that the receiver did not hear. Left out, NMEA's own directions, else the scenario's orbits.
      reference: places of the antenna, as a table or its file (`jaxurban.io.read.receivers.read_track`); left out,
        those of the log.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).

    Returns:
      `ReceiverValidation`: its ``scores`` hold rank correlations between what was logged and what the maps say, and
      ``main`` those of each logged quantity with its own prediction; NaN where either does not vary. ``save`` writes
      the report.

    Raises:
      InputError: a log that cannot be read, lies outside the region or is too short, sources of the scenario that
        cannot be used, or orbits too old for the log's times.

    Examples:
      >>> result = ju.studies.validate(scenario, log, progress=False)
      >>> result.main[["witness", "prediction", "num", "spearman"]].round(2).to_dict("records")
      [{'witness': 'num_tracked', 'prediction': 'num_visible', 'num': 13, 'spearman': 0.61}]
    """
    # The log, and its track in the cells of the scenario.
    settings = settings or ReceiverSettings()
    logged = _read(scenario, log, navigation, reference)
    grid = grid_of(scenario)
    track = track_of(logged, grid, settings.sky_step_s)
    num_pieces = len(np.unique(track.along_m // settings.piece_m))
    if logged.satellites is None and num_pieces < FEWEST_PIECES:
        raise InputError(
            f"the track of the receiver log {logged.name!r} is {track.along_m[-1]:.0f} m long, less than "
            f"{FEWEST_PIECES} pieces of {settings.piece_m:g} m: give a longer log, or shorter pieces"
        )
    satellites = None
    guesses: Guesses = ()
    with reporting("validate", progress) as report:
        # The city. The task of its maps, which holds the sky too, is made only if it is needed: where counts are
        # predicted, or where the log lacks the directions of its satellites.
        report("read")
        sight = Sight.of_scenario(scenario, grid)
        city = sight.city
        lacks_angles = logged.satellites is not None and AZIMUTH not in logged.satellites
        needs_counts = logged.satellites is None or bool(logged.witnesses)
        if needs_counts or lacks_angles:
            task = sight.task(track.sky_times, float(settings.antenna_height_m), None)
            guesses = task.sky.guesses

        # How the city agrees with each satellite, if the log has a row for each.
        if logged.satellites is not None:
            if lacks_angles:
                logged = with_directions(logged, track, task.sky, grid)
            known = known_of(settings.known, city, track)
            satellites = agreement_of(
                logged, track, city, known, grid, scenario.gps.mask_deg, settings, report
            )

        # The columns of the epochs: what the maps predict, or, where the log counts nothing, satellites in view and
        # received ones, counted from the rows of the agreement.
        counts = dict[str, np.ndarray]()
        if satellites is None or needs_counts:
            predicted = predict(task, track, report)
        else:
            predicted, counts = counted(satellites.rows, len(logged.epochs))
        report("scores")
        epochs = logged.epochs.assign(
            x_m=track.x_m, y_m=track.y_m, along_m=track.along_m, **predicted, **counts
        )
        scores, shifts = tables(epochs, (*logged.witnesses, *counts), list(predicted), settings)

    return ReceiverValidation(
        log=logged,
        settings=settings,
        scenario=scenario.model_dump(mode="json"),
        summary=_summary(epochs, grid.resolution_m, len(track.sky_times)),
        epochs=epochs,
        pieces=pieces_of(epochs, settings.piece_m, settings.block_m),
        scores=scores,
        shifts=shifts,
        attribution=city.attribution,
        guesses=city.guesses + guesses,
        satellites=satellites,
    )


def _summary(epochs: pd.DataFrame, resolution_m: float, num_skies: int) -> dict[str, Any]:
    """Return what is reported about a track as a whole, the ``summary`` of a `ReceiverValidation`.

    Args:
      epochs: as `ReceiverValidation` holds them.
      resolution_m: side of a cell.
      num_skies: how many skies the track was seen under.
    """
    num_visible = epochs[NUM_VISIBLE]
    summary = {
        "epochs": len(epochs),
        "epochs_left_out": int(num_visible.isna().sum()),
        "first_utc": epochs[UTC].iloc[0].isoformat(),
        "last_utc": epochs[UTC].iloc[-1].isoformat(),
        "length_m": float(epochs["along_m"].iloc[-1]),
        "resolution_m": resolution_m,
        "num_skies": num_skies,
        "mean_num_visible": float(num_visible.mean()),
    }
    if TRACKED in epochs:
        summary[f"mean_{TRACKED}"] = float(epochs[TRACKED].mean())
    return summary


def _read(
    scenario: Scenario,
    log: str | Path | pd.DataFrame | None,
    navigation: str | Path | None,
    reference: str | Path | pd.DataFrame | None,
) -> ReceiverLog:
    """Return the log that the arguments of `validate` name: a table, a receiver's file, or a sample city's own log.

    Args:
      scenario: its sample city, if it has one, gives the log that is left out.
      log, navigation, reference: as in `validate`.

    Raises:
      InputError: a table with navigation or reference, there is no log, or it cannot be read.
    """
    source = log_of(scenario.buildings.source) if log is None else log
    table = read_log(source, reference) if isinstance(source, str | Path) else None
    if table is not None:
        if navigation is None or CN0 not in table:
            return table_log(table, str(source))
        return with_navigation(table, navigation, str(source))
    if navigation is not None or reference is not None:
        raise InputError(
            "navigation and reference are of a receiver's own log (RINEX, NMEA, GnssLogger): name it as log"
        )
    if source is None:
        raise InputError(
            "log is left out, and only a sample city with a log of its own has one: name the file"
        )
    return read_receiver_log(source)


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
    """Return the correlation from the sums of a a, a b and b b; NaN where a or b does not vary."""
    size = np.sqrt(np.maximum(aa * bb, 0.0))
    return np.divide(ab, size, out=np.full(np.shape(ab), np.nan), where=size > 0)


def _products(a: np.ndarray, b: np.ndarray, blocks: np.ndarray | None) -> np.ndarray:
    """Return ``[3, G]`` the sums a a, a b and b b over each block, of ranks less their mean in the block.

    Ranks are those of the whole track.

    Args:
      a, b: ``[N]`` values, which are ranked here.
      blocks: ``[N]`` block of each value; None: the whole track is one block.
    """
    if blocks is None:
        blocks = np.zeros(len(a))
    _, number = np.unique(blocks, return_inverse=True)

    def centred(values: np.ndarray) -> np.ndarray:
        """Return ``[N]`` the ranks of values less their mean in each block."""
        ranks = rankdata(values)
        means = np.bincount(number, ranks) / np.bincount(number)
        return ranks - means[number]

    of_a = centred(a)
    of_b = centred(b)
    products = of_a * of_a, of_a * of_b, of_b * of_b
    return np.array([np.bincount(number, product) for product in products])


def half_width(without_each: np.ndarray) -> float:
    """Return half the width of the 95 % interval of a statistic, by the jackknife over blocks.

    The interval is that of Student's t with G - 2 degrees of freedom. It is NaN with fewer blocks than `FEWEST_GROUPS`,
    or where the statistic is not defined without some block.

    Args:
      without_each: ``[G]`` the statistic when one block after the other is left out.
    """
    num_blocks = len(without_each)
    if num_blocks < FEWEST_GROUPS:
        return np.nan
    standard_error = np.sqrt((num_blocks - 1) * np.var(without_each))
    return float(student.ppf((1 + LEVEL) / 2, num_blocks - 2) * standard_error)


def within_blocks(a: np.ndarray, b: np.ndarray, blocks: np.ndarray) -> Interval:
    """Return the rank correlation of values within blocks, and its 95 % interval.

    The interval is symmetric on Fisher's scale, the inverse hyperbolic tangent of the correlation. It is NaN where the
    correlation is -1, 1 or NaN, or with too few blocks (`half_width`).

    Args:
      a, b: ``[N]`` the values.
      blocks: ``[N]`` block of each value.
    """
    value = spearman(a, b, blocks)
    if not abs(value) < 1:
        return Interval(value, np.nan, np.nan)

    # Where all else agrees wholly without some block, the scale is infinite and there is no interval.
    with np.errstate(divide="ignore", invalid="ignore"):
        half = half_width(np.arctanh(without_each_block(a, b, blocks)))
    low, high = np.tanh(np.arctanh(value) + np.array([-half, half]))
    return Interval(value, float(low), float(high))


def shifted(coefficient: Callable[[np.ndarray], float], values: np.ndarray) -> np.ndarray:
    """Return ``[N]`` a coefficient at every circular shift of the maps' values.

    Number ``s`` compares each place of the track with the values ``s`` places ahead; number 0 is without a shift.

    Args:
      coefficient: of values in the order of the track.
      values: ``[N, ...]`` of the maps, along the track.
    """
    return np.array([coefficient(np.roll(values, -shift, axis=0)) for shift in range(len(values))])


def pieces_of(epochs: pd.DataFrame, piece_m: float, block_m: float) -> pd.DataFrame:
    """Return a row for each piece of track: medians of what the receiver logged and of what the maps say.

    The columns are ``piece`` and ``block`` (numbers along the track), ``utc`` (of the middle epoch), ``epochs`` (how
    many), and the median of every column of numbers. Epochs in a building or without data are left out.

    Args:
      epochs: as `ReceiverValidation` holds them.
      piece_m, block_m: lengths along the track.
    """
    frame = epochs.assign(piece=(epochs.along_m // piece_m).astype(np.int64))
    grouped = frame[frame[NUM_VISIBLE].notna()].groupby("piece")
    medians = grouped.median(numeric_only=True)

    # The columns before the medians.
    medians.insert(0, "block", (medians.index * piece_m // block_m).astype(np.int64))
    medians.insert(1, UTC, grouped[UTC].quantile(0.5, interpolation="nearest"))
    medians.insert(2, "epochs", grouped.size())
    return medians.reset_index()


def compared(
    pieces: pd.DataFrame, witness: str, prediction: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how well the receiver did, how well it should do by the maps, and the block, each ``[N]``.

    The N pieces are those in which both are known. Values of which less is better change their sign: a positive
    coefficient means that the receiver does better where the maps say so.

    Args:
      pieces: from `pieces_of`.
      witness: column of what the receiver logged.
      prediction: column of what the maps say.
    """
    known = pieces.dropna(subset=[witness, prediction])

    def quality(name: str) -> np.ndarray:
        """Return ``[N]`` the values of a column, of which more is better."""
        values = known[name].to_numpy(float)
        return values if name in MORE_IS_BETTER else -values

    return quality(witness), quality(prediction), known["block"].to_numpy()


def tables(
    epochs: pd.DataFrame,
    witnesses: Sequence[str],
    predictions: Iterable[str],
    settings: ReceiverSettings,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the scores and the shifts, as `ReceiverValidation` holds them.

    With pieces of the chosen length (``piece_m``) every prediction is scored against each witness. With pieces of
    another length only the prediction that is the witness's own (`MAIN`) is.

    Args:
      epochs: what the receiver logged and what the maps say, with ``along_m`` and ``utc``.
      witnesses: columns of what the receiver logged.
      predictions: columns of what the maps say; read several times, so no iterator.
      settings: lengths of pieces and of blocks.
    """
    scores, shifts = [], []
    for piece_m in settings.pieces_m:
        pieces = pieces_of(epochs, piece_m, settings.block_m)
        for witness in witnesses:
            scored = predictions if piece_m == settings.piece_m else (MAIN[witness],)
            for prediction in scored:
                row = {
                    "witness": witness,
                    "prediction": prediction,
                    "piece_m": piece_m,
                }

                # Both coefficients with the maps' values in their place, and at every shift along the track.
                receiver, maps, blocks = compared(pieces, witness, prediction)
                at_shifts = {
                    WITHIN: shifted(partial(spearman, receiver, blocks=blocks), maps),
                    SPEARMAN: shifted(partial(spearman, receiver), maps),
                }
                num = len(maps)
                if prediction == MAIN[witness]:
                    # Shifts of more than half the track count as shifts back.
                    shift = np.fft.ifftshift(np.arange(num) - num // 2)  # 0, 1, ..., -2, -1
                    shifts.append(pd.DataFrame({**row, "shift": shift, **at_shifts}))

                # The score, without its shifts: the interval, and how many shifts do as well.
                interval = within_blocks(receiver, maps, blocks)
                row |= {"num": num, "within_low": interval.low, "within_high": interval.high}
                for name, values in at_shifts.items():
                    row |= _against_shifts(name, values)
                scores.append(row)
    return pd.DataFrame(scores), pd.concat(shifts, ignore_index=True)


def _against_shifts(name: str, values: np.ndarray) -> dict[str, float]:
    """Return the columns of a coefficient: its value, what 95 % of the shifts stay below, and p.

    p is the share of all shifts, none among them, at which the coefficient is at least as high. All three are NaN where
    the coefficient is not defined.

    Args:
      name: of the coefficient, with which the columns begin.
      values: ``[N]`` at every shift (`shifted`).
    """
    value = below = share = np.nan
    if len(values) > 1 and np.isfinite(values[0]):
        value = values[0]
        below = np.nanquantile(values[1:], SHIFTS_BELOW)
        share = np.mean(values >= value)
    return {name: value, f"{name}_shifts_95": below, f"{name}_p": share}
