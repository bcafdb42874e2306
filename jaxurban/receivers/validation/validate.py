"""validate: a receiver's log against the city, satellite by satellite, at its times, places and antenna height.

**AUC** is the chance that of one seen and one hidden satellite the seen one has the higher C/N0, where ties count by
half. **Within satellites** both are the same satellite at two times, so that it adds nothing if high satellites have
strong signals. Neighbouring rows of a drive are alike, so intervals are of the bootstrap over blocks of the track.
"""

import math
import shlex
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import pandas as pd

from jaxurban.checks import typed
from jaxurban.io.results import Result
from jaxurban.io.tracks import UTC
from jaxurban.knowledge import Caution, Guesses
from jaxurban.maps.scenario import Scenario
from jaxurban.progress import Progress, Report, reporting
from jaxurban.receivers.track import NUM_VISIBLE
from jaxurban.receivers.validation.agreement import (
    PlaceSky,
    example_skies,
    judged_rows,
    strong_dbhz,
)
from jaxurban.receivers.validation.drive import Drive
from jaxurban.receivers.validation.logs import ReceiverLog
from jaxurban.receivers.validation.satellites import NUM_HEARD, counted
from jaxurban.receivers.validation.scores import score_table
from jaxurban.receivers.validation.settings import EVERYWHERE, ReceiverSettings
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, interval_columns
from jaxurban.statistics.conclusions import Conclusion, Verdict, runs_needed

CHANCE = 0.5  # AUC of what does not tell seen from hidden


class SkyVerdict(Enum):
    """What a log decides of the city's hidden satellites; an AUC of 0.5 is that of chance."""

    MORE = "{what}: what the maps see is heard more strongly than what they hide, AUC {size} ({n})"
    LESS = "{what}: what the maps see is heard less strongly than what they hide, AUC {size} ({n})"
    NONE = "{what}: the maps do not have both seen and hidden ones, so there is nothing to compare ({n})"
    OPEN = "{what}: whether what the maps see is heard more strongly is open, AUC {size} ({n})"


@dataclass(frozen=True, eq=False, repr=False)
class ReceiverValidation(Result):
    """A receiver's log beside what maps say of each of its satellites.

    Attributes:
      log: what the receiver logged.
      settings: how the two were set beside each other.
      scenario: the settings that the maps were made with.
      summary: numbers of the whole track: how many epochs, rows, judged rows, rows of unknown rays, rows in buildings,
        satellites and blocks there are, its length, and means. Names of metres end in ``_m``.
      epochs: a row for each epoch: time, place, distance along the track, and of the satellites that are judged how
        many are in view on the maps (``num_visible``) and how many are heard (``num_heard``), NaN where none is judged.
      rows: a row for each epoch and satellite: ``epoch`` (number in the log's epochs), ``satellite``, ``system`` (its
        first letter), ``azimuth_deg`` (from true north), ``elevation_deg``, ``cn0_dbhz`` (0: not received),
        ``margin_m`` (the height of the antenna less that of the edge of the roofs' shadow; at or below 0 a roof hides
        the satellite, and margins of 60 m or more are inf), ``state`` (``"seen"``, ``"hidden"`` or ``"unknown"``),
        ``is_seen``, ``is_known`` (the whole ray lies above known ground until it is above all roofs), ``is_inside``
        (the place lies in a building), ``is_judged`` (the place is not inside, and the ray is known unless the settings
        judge all rays), ``is_strong`` (C/N0 is at least ``strong_dbhz``), ``block`` (number of the block along the
        track).
      scores: a row for each choice of rows, which ``which`` names: ``"all"`` rows that are judged; of these the
        ``"received"`` ones, and those of each system by its letter; ``"unguarded"``, in which rows of unknown rays
        count too. ``rows`` and their ``share`` of all rows; ``auc`` and ``within`` satellites with the ends of their
        95 % intervals (``_low``, ``_high``); ``num_satellites``, how many satellites are seen at one time and hidden
        at another.
      skies: the sky over a place in the block of least agreement, and over one in the block of most agreement.
      strong_dbhz: the median C/N0 of the judged rows; where that is 0, the C/N0 of the weakest received one.
      attribution: whom to credit for the city.
      guesses: what city and sky rest on that no file says.

    Examples:
      >>> result = ju.studies.validate(scenario, log, progress=False)
      >>> result.summary["judged"], result.summary["unknown"], result.summary["inside"]
      (124, 15, 21)
      >>> result.rows[["satellite", "margin_m", "state", "cn0_dbhz"]].head(1).to_dict("records")
      [{'satellite': 'G05', 'margin_m': inf, 'state': 'seen', 'cn0_dbhz': 44.0}]
    """

    _command = "validate"
    _report = "jaxurban.receivers.validation.report:validation_report"

    log: ReceiverLog
    settings: ReceiverSettings
    scenario: dict[str, Any]
    summary: dict[str, Any]
    epochs: pd.DataFrame
    rows: pd.DataFrame
    scores: pd.DataFrame
    skies: tuple[PlaceSky, ...]
    strong_dbhz: float
    attribution: str = ""
    guesses: Guesses = ()

    @property
    def decided(self) -> Conclusion:
        """Whether satellites that the maps see are heard more strongly, all together and each for itself."""
        num = self.summary["num_blocks"]
        noun = f"blocks of {self.settings.block_m:g} m of track"
        verdicts = []
        for name, what in (("auc", "All satellites"), ("within", "Each satellite for itself")):
            value, low, high = self.score()[interval_columns(name)]
            needed = runs_needed(value - CHANCE, low - CHANCE, high - CHANCE, num)
            kind = SkyVerdict.MORE if value > CHANCE else SkyVerdict.LESS
            if math.isnan(value):
                kind, needed = SkyVerdict.NONE, math.nan
            elif needed:
                kind = SkyVerdict.OPEN
            verdicts.append(Verdict(kind, (what,), value, low, high, num, "", noun, needed))
        log = shlex.quote(self.log.name)
        command = f"jaxurban validate SCENARIO {log} -o OUT  # with the log of a longer drive there"
        return Conclusion(tuple(verdicts), command)

    @property
    def known_cautions(self) -> list[Caution]:
        """The guesses that the result rests on, which rows were not judged, and which satellites were left out."""
        cautions = [Caution(guess.sentence, "guess", "guess") for guess in self.guesses]
        summary = self.summary
        sentences = []
        if summary["unknown"]:
            judged = "not judged"
            if self.settings.known == EVERYWHERE:
                judged = "judged as if nothing stood beyond"
            sentences.append(
                f"{summary['unknown']:,} rows are {judged}: their rays leave what is known of the city."
            )
        if summary["inside"]:
            sentences.append(
                f"{summary['inside']:,} rows are not judged: their places lie in buildings."
            )
        if summary["num_blocks"] < FEWEST_GROUPS:
            sentences.append(
                f"The track has {summary['num_blocks']} blocks of {self.settings.block_m:g} m, and an interval takes "
                f"{FEWEST_GROUPS}: give a longer log, or shorter blocks."
            )
        sentences += [
            f"{name} is left out: {reason}." for name, reason in self.log.left_out.items()
        ]
        return cautions + [Caution(sentence) for sentence in sentences]

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, the log, and `track_facts`."""
        return self.decided.facts | {"log": self.log.name} | self.track_facts

    @property
    def track_facts(self) -> dict[str, str]:
        """The time and the track, how the maps were made, and how many rows, one a satellite and time, were judged."""
        summary = self.summary
        gps = self.scenario["gps"]
        return {
            "time": f"{summary['first_utc']} to {summary['last_utc']}",
            "track": f"{summary['length_m'] / 1000:.2f} km, {summary['epochs']:,} epochs, of which "
            f"{summary['epochs_left_out']:,} have no judged row",
            "maps": f"cells of {summary['resolution_m']:g} m, mask {gps['mask_deg']} degrees, antenna "
            f"{self.settings.antenna_height_m:g} m above the ground",
            "rows judged": f"{summary['judged']:,} of {summary['rows']:,}",
            "satellites, mean": f"{summary['mean_num_visible']:.1f} in view, {summary['mean_num_heard']:.1f} heard",
        }

    def score(self, which: str = "all") -> pd.Series:
        """Return the scores of a choice of rows.

        Returns:
          A row of ``scores``.

        Examples:
          >>> result = ju.studies.validate(scenario, log, progress=False)
          >>> result.score("G")[["which", "rows"]].to_dict()
          {'which': 'G', 'rows': 124}
        """
        return self.scores[self.scores.which == which].iloc[0]


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
    """Return which satellites of a receiver's log the city hides, beside how strongly the receiver heard each.

    No number of the maps is fitted to the log.

    Args:
      scenario: of the maps; its times, its altitudes and the layers that a user added are ignored.
      log: the receiver's, as a table or its file (``.csv``, ``.csv.gz``, ``.parquet``) with a row per satellite:
        ``utc``, ``lon_deg`` (or ``lon``), ``lat_deg`` (or ``lat``), ``satellite``, ``cn0_dbhz`` (0: above the horizon,
        not received) and the satellite's ``azimuth_deg`` and ``elevation_deg``, without which the scenario's orbits
        give them. Or what the receiver wrote itself: observations in RINEX 2 to 4 (also CRINEX, with the extra
        ``receiver``), NMEA or Android's GnssLogger. Left out, the log of the sample city that the scenario names.
      settings: how the two are set beside each other.
      navigation: of such a file the satellites' orbits, broadcast RINEX or what ``[gps] orbits`` takes; they add the
        satellites that the receiver did not hear. Left out, NMEA's own directions, else the scenario's orbits.
      reference: places of the antenna, as a table or its file (`jaxurban.receivers.log_files.read_reference`); left
        out, those of the log.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).

    Returns:
      `ReceiverValidation`: ``rows`` holds each satellite with its margin to the shadow's edge, metres, and its C/N0,
      dBHz; ``scores`` how well C/N0 separates seen from hidden ones. ``save`` writes the report.

    Raises:
      InputError: a log that cannot be read, lies outside the region or is too short, sources of the scenario that
        cannot be used, or orbits too old for the log's times.

    Examples:
      >>> result = ju.studies.validate(scenario, log, progress=False)
      >>> result.rows["state"].value_counts().to_dict()
      {'seen': 103, 'unknown': 36, 'hidden': 21}
    """
    settings = settings or ReceiverSettings()
    with reporting("validate", progress) as report:
        drive = Drive.of(scenario, log, settings, navigation, reference, report)
        return validation_of(drive, scenario, report)


def validation_of(drive: Drive, scenario: Scenario, report: Report) -> ReceiverValidation:
    """Return how a drive agrees with the city that it went through; errors as of `validate`.

    Args:
      drive: through the city of the scenario.
      scenario: of the maps.
      report: of the progress.
    """
    report("satellites")
    rows = judged_rows(drive)
    report("scores")
    log = drive.log
    track = drive.track
    places = {"x_m": track.x_m, "y_m": track.y_m, "along_m": track.along_m}
    epochs = log.epochs.assign(**places, **counted(rows, len(log.epochs)))
    return ReceiverValidation(
        log=log,
        settings=drive.settings,
        scenario=scenario.model_dump(mode="json"),
        summary=_summary(epochs, rows, drive),
        epochs=epochs,
        rows=rows,
        scores=score_table(rows, drive.settings.seed),
        skies=example_skies(rows, drive),
        strong_dbhz=strong_dbhz(rows.cn0_dbhz[rows.is_judged]),
        attribution=drive.city.attribution,
        guesses=drive.guesses,
    )


def _summary(epochs: pd.DataFrame, rows: pd.DataFrame, drive: Drive) -> dict[str, Any]:
    """Return what is reported about a track as a whole, the ``summary`` of a `ReceiverValidation`.

    Args:
      epochs, rows: as `ReceiverValidation` holds them.
      drive: whose they are.
    """
    is_open = rows.is_known | (not drive.is_guarded)
    return {
        "epochs": len(epochs),
        "epochs_left_out": int(epochs[NUM_VISIBLE].isna().sum()),
        "first_utc": epochs[UTC].iloc[0].isoformat(),
        "last_utc": epochs[UTC].iloc[-1].isoformat(),
        "length_m": float(epochs["along_m"].iloc[-1]),
        "resolution_m": drive.grid.resolution_m,
        "rows": len(rows),
        "judged": int(rows.is_judged.sum()),
        "unknown": int((~rows.is_known).sum()),
        "inside": int((is_open & rows.is_inside).sum()),
        "num_satellites": int(rows.satellite.nunique()),
        "num_blocks": int(rows.block[rows.is_judged].nunique()),
        "mean_num_visible": float(epochs[NUM_VISIBLE].mean()),
        "mean_num_heard": float(epochs[NUM_HEARD].mean()),
    }
