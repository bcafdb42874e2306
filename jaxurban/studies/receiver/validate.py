"""validate: a receiver's log against maps that are made at its times, places and antenna height."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, typed
from jaxurban.io.read.receiver import TRACKED, UTC, ReceiverLog, read_receiver_log
from jaxurban.maps.scenario import Scenario
from jaxurban.progress import Progress, reporting
from jaxurban.studies.receiver.prediction import NUM_VISIBLE, ReceiverSettings, Track, predict, region_of, task_at
from jaxurban.studies.receiver.scores import (
    COEFFICIENTS,
    MAIN,
    Scored,
    compared,
    half_width,
    pieces_of,
    spearman,
    tables,
    without_each_block,
)
from jaxurban.studies.result import Result

FEWEST_PIECES = 8  # fewer rank nothing


@dataclass(frozen=True, eq=False, repr=False)
class ReceiverValidation(Result):
    """A receiver's log beside what maps say along its track.

    Attributes:
      log: what the receiver logged.
      settings: how the two were set beside each other.
      scenario: the settings that the maps were made with.
      summary: numbers of the whole: epochs, those in a building, length of the track, means.
      epochs: a row an epoch: time, place, distance along the track, witnesses and predictions; NaN in a building.
      pieces: a row a piece of track of ``settings.piece_m``: medians of the same (see `pieces_of`).
      scores: a row a ``witness``, ``prediction`` and ``piece_m``: ``num`` pieces, and for the rank correlation
        ``within`` blocks and ``spearman`` over the whole track the value, what 95 % of all shifts along the track stay
        at or below (``_shifts_95``) and the share of all shifts, that of 0 m among them, that score at least as high
        (``_p``); of ``within`` also the ends of its 95 % interval (``_low``, ``_high``). Above 0 the receiver does
        better where the maps say so; NaN where a coefficient is not defined.
      shifts: a row a witness, length of pieces and ``shift`` of the maps along the track, in pieces, with the
        coefficients.
      attribution: whom to credit for the city.
      guesses: what city and sky rest on that no file says, a sentence each.
    """

    log: ReceiverLog
    settings: ReceiverSettings
    scenario: dict[str, Any]
    summary: dict[str, Any]
    epochs: pd.DataFrame
    pieces: pd.DataFrame
    scores: pd.DataFrame
    shifts: pd.DataFrame
    attribution: str = ""
    guesses: tuple[str, ...] = ()

    @property
    def main(self) -> pd.DataFrame:
        """The scores of each witness against the prediction that is its own, over pieces of the chosen length."""
        is_main = self.scores.prediction == self.scores.witness.map(MAIN)
        return self.scores[is_main & (self.scores.piece_m == self.settings.piece_m)]

    @property
    def facts(self) -> dict[str, str]:
        """Log, track, and what each witness scores."""
        of = self.summary
        length = f"{of['length_m'] / 1000:.2f} km, {of['epochs']} epochs"
        facts = {"log": self.log.name, "track": length, "cells": f"{of['resolution_m']:g} m"}
        for row in self.main.to_dict("records"):
            parts = [
                f"{name} {row[name]:.2f} (p {row[f'{name}_p']:.3f})" for name in COEFFICIENTS if row[name] == row[name]
            ]
            facts[str(row["witness"])] = ", ".join(parts) or "not defined"
        return facts


@typed
def validate(
    scenario: Scenario,
    log: str | Path | pd.DataFrame,
    settings: ReceiverSettings | None = None,
    *,
    progress: Progress = True,
) -> ReceiverValidation:
    """Return how well maps of a scenario predict what a receiver logged on its way through the city.

    Satellites in view, dilutions of precision and m of GPS are those of maps of the scenario's city, orbits and mask,
    at the log's times and the antenna's height, in the cells of the track. No number of theirs is fitted to the log.

    Args:
      scenario: of the maps; its times, altitudes and layers of one's own are not looked at.
      log: the receiver's, as `jaxurban.io.read.receiver.read_receiver_log` takes it.
      settings: how the two are set beside each other.
      progress: as in `jaxurban.progress.reporting`.

    Raises:
      InputError: a log that cannot be read, lies outside the region or is too short, sources of the scenario that
        cannot be used, or orbits too old for the log's times.
    """
    chosen = settings or ReceiverSettings()
    told = read_receiver_log(log)
    grid = region_of(scenario)
    track = Track.of(told, grid, chosen.sky_step_s)
    if len(np.unique(track.along_m // chosen.piece_m)) < FEWEST_PIECES:
        raise InputError(
            f"the track of the receiver log {told.name!r} is {track.along_m[-1]:.0f} m long, less than {FEWEST_PIECES} "
            f"pieces of {chosen.piece_m:g} m: give a longer log, or shorter pieces"
        )
    with reporting("validate", progress) as report:
        report("read")
        task = task_at(scenario, track.sky_times, grid, float(chosen.antenna_height_m))
        predicted = predict(task, track, report)
        report("scores")
        epochs = told.epochs.assign(x_m=track.x_m, y_m=track.y_m, along_m=track.along_m, **predicted)
        scores, shifts = tables(epochs, told.witnesses, list(predicted), chosen)
    seen = epochs[NUM_VISIBLE]
    summary = {
        "epochs": len(epochs),
        "epochs_left_out": int(seen.isna().sum()),
        "first_utc": epochs[UTC].iloc[0].isoformat(),
        "last_utc": epochs[UTC].iloc[-1].isoformat(),
        "length_m": float(track.along_m[-1]),
        "resolution_m": grid.resolution_m,
        "num_skies": len(track.sky_times),
        "mean_num_visible": float(seen.mean()),
    }
    if TRACKED in epochs:
        summary[f"mean_{TRACKED}"] = float(epochs[TRACKED].mean())
    return ReceiverValidation(
        log=told,
        settings=chosen,
        scenario=scenario.model_dump(mode="json"),
        summary=summary,
        epochs=epochs,
        pieces=pieces_of(epochs, chosen.piece_m, chosen.block_m),
        scores=scores,
        shifts=shifts,
        attribution=task.city.attribution,
        guesses=(*task.city.guesses.values(), *task.sky.guesses.values()),
    )


def paired(
    a: ReceiverValidation,
    b: ReceiverValidation,
    witness: str = TRACKED,
    predictions: tuple[str | None, str | None] = (None, None),
) -> Scored:
    """Return how much higher the correlation within blocks is with the maps of ``b`` than with those of ``a``.

    With its 95 % interval: the same blocks of the pieces that both have are left out in turn.

    Args:
      a, b: of one log under the same settings.
      witness: of the log.
      predictions: of ``a`` and of ``b`` that are set against the witness; None: the witness's own.

    Raises:
      InputError: validations of different logs, or that cut the track otherwise.
    """
    if len({(side.settings.piece_m, side.settings.block_m, len(side.log.epochs)) for side in (a, b)}) > 1:
        raise InputError("a and b are of different logs or pieces: make both with one log and the same settings")
    numbers = [side.pieces.piece[side.pieces[witness].notna()].to_numpy() for side in (a, b)]
    common = np.intersect1d(numbers[0], numbers[1])
    sides = [
        compared(side.pieces[side.pieces.piece.isin(common)], witness, prediction or MAIN[witness])
        for side, prediction in zip((a, b), predictions, strict=True)
    ]
    value = spearman(*sides[1]) - spearman(*sides[0])
    half = half_width(without_each_block(*sides[1]) - without_each_block(*sides[0]))
    return Scored(value, value - half, value + half)
