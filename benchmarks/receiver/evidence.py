"""Whether a receiver hears well the satellites that the maps call seen: scores that convince a sceptic.

``jaxurban validate`` says how C/N0 separates seen from hidden satellites. This asks whether that is more than chance,
and more than rules without a map would give. The null are cities displaced by 80 to 450 m. They overlap each other, so
they give no p-value; they show what a wrong city scores. ``python -m benchmarks.receiver.evidence sample:nihonbashi``
prints all of it, of any scenario and log.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.common import exit_code
from benchmarks.receiver.displaced import AROUND_M, FARTHEST_M, SCALES, STEP_M, Displaced
from benchmarks.receiver.rivals import MAP, compared_rules, features_of, gain_by_length
from jaxurban.draw.write import framed, interval, without_ends
from jaxurban.maps.scenario import Scenario
from jaxurban.progress import Progress, reporting
from jaxurban.receivers.report import HEADS, ROWS
from jaxurban.receivers.track import Track
from jaxurban.receivers.validation.drive import Drive
from jaxurban.receivers.validation.settings import ReceiverSettings
from jaxurban.receivers.validation.validate import ReceiverValidation, validation_of
from jaxurban.statistics.bootstrap import FEWEST_GROUPS
from jaxurban.world.known import Rays

MOST_MOVED = 20_000  # rows that are set against displaced cities and other roofs, of a longer log every n-th epoch
NUM_DISPLACED = 200
FEWEST_CITIES = 50  # displaced ones that could be scored, for a verdict
STREET_M, STILL_M = 20.0, 1.0  # each way, for the street's direction; a car that moves less stands
SCORES = "share", "auc", "within", "log_loss", "gain"  # with three digits in tables
EVIDENCE_HEADS = HEADS | {
    "model": "rule",
    "log_loss": "log-loss",
    "gain": "gain on the street rule",
    "east_m": "moved east (m)",
    "north_m": "moved north (m)",
    "within_95_m": "95 % of resampled tracks within (m)",
    "scale": "heights times",
    "scale_low": "heights times_low",
    "scale_high": "heights times_high",
    "block_m": "blocks of (m)",
    "num_blocks": "blocks",
}


@dataclass(frozen=True, eq=False)
class Evidence:
    """How a validation stands against cities in wrong places, other roofs, and rules without a map.

    Attributes:
      of: the validation, whose rows are compared.
      displaced: a row for each displaced city of the null: ``east_m``, ``north_m``, ``rows``, ``auc``, ``within``.
      field: AUC of cities displaced by up to 40 m, in steps of 2 m: ``east_m``, ``north_m``, ``rows``, ``auc``.
      scales: AUC of cities whose roofs are ``scale`` times as high.
      peak: the displacement at which the field is highest (``east_m``, ``north_m``); ``within_95_m``, how far from no
        displacement 95 % of the bootstrap's peaks lie at most; the ``scale`` of roofs with the highest AUC, and its
        interval (``scale_low``, ``scale_high``). All are NaN where no value is the highest, or with fewer than 8
        blocks.
      rivals: log-loss of rules that predict ``is_strong``, one block left out (`benchmarks.receiver.rivals`).
      block_lengths: the gain of margin and elevation in ``rivals``, with its interval, where blocks are once, twice
        and four times as long: ``block_m``, ``num_blocks``, ``gain``, ``gain_low``, ``gain_high``.
      num_blocks: with judged rows, along the track.
      every: n where only every n-th epoch of a long log is compared with displaced cities, other roofs and rivals.
      verdict: what this shows, in one sentence that claims no more than its interval.
    """

    of: ReceiverValidation
    displaced: pd.DataFrame
    field: pd.DataFrame
    scales: pd.DataFrame
    peak: dict[str, float]
    rivals: pd.DataFrame
    block_lengths: pd.DataFrame
    num_blocks: int
    every: int
    verdict: str

    @property
    def is_peak_at_edge(self) -> bool:
        """Whether the best fit may lie beyond the search: places, heights or the CRS may be wrong."""
        away_m = np.hypot(self.peak["east_m"], self.peak["north_m"])
        return bool(away_m > AROUND_M - STEP_M or self.peak["scale"] in (SCALES[0], SCALES[-1]))


def evidence_of(
    scenario: Scenario,
    log: str | Path | pd.DataFrame | None = None,
    settings: ReceiverSettings | None = None,
    num_displaced: int = NUM_DISPLACED,
    progress: Progress = False,
) -> Evidence:
    """Return how a city agrees with the satellites of a log, and how wrong cities and rules without a map do.

    Args:
      scenario, log, settings, progress: as of `jaxurban.studies.validate`.
      num_displaced: displaced cities of the null.

    Raises:
      InputError: as of `jaxurban.studies.validate`.
    """
    settings = settings or ReceiverSettings()
    with reporting("evidence", progress) as report:
        drive = Drive.of(scenario, log, settings, None, None, report)
        of = validation_of(drive, scenario, report)
        rows = of.rows
        _, rays = drive.rows()

        # [R] bool: of a long log rivals and displaced cities take only the rows of every n-th epoch. Of these displaced
        # cities take only rows with known rays, unless rays count wherever they lead.
        every = max(1, len(rows) // MOST_MOVED)
        is_taken = (rows.epoch % every == 0).to_numpy()
        is_moved = is_taken & (rows.is_known.to_numpy() | (not drive.is_guarded))
        displaced = Displaced(num_displaced, settings.seed, int(is_moved.sum()))

        # What each ray meets in displaced cities and under other roofs, where each moved row has a column.
        guard = drive.known if drive.is_guarded else None
        columns = np.cumsum(is_moved) - 1
        for of_leg, ground in drive.grounds(rows, rays, FARTHEST_M, SCALES[-1]):
            moved = of_leg[is_moved[of_leg]]
            leg_rays = rays.take(moved)
            displaced.fill(columns[moved], ground, leg_rays, guard, drive.rise_m, report)

        # The scores of displaced cities, and of rivals.
        report("scores")
        of_displaced = displaced.tables(rows[is_moved], settings.seed)
        chosen = rows[is_taken & rows.is_judged]
        rivals, block_lengths = _rivals(chosen, rays, drive.track, settings)
    num_blocks = int(chosen.block.nunique())
    return Evidence(
        of=of,
        **of_displaced,
        rivals=rivals,
        block_lengths=block_lengths,
        num_blocks=num_blocks,
        every=every,
        verdict=verdict_of(of.scores, of_displaced["displaced"], rivals, num_blocks),
    )


def headings_rad(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` the street's direction at each epoch, radians clockwise from grid north.

    It is the direction from the place 20 m behind along the track to the place 20 m ahead; the ends of the track stand
    for places beyond them. While the receiver stands the direction does not change.

    Args:
      x_m, y_m: ``[N]`` easting and northing of each epoch.
    """
    # Anchors are epochs whose places are at least `STILL_M` apart. An epoch has the distance along the track of its
    # last anchor, which does not change while the receiver stands.
    places = np.column_stack([x_m, y_m])
    anchors = [0]
    anchor_of_epoch = np.zeros(len(places), int)
    for number, place in enumerate(places):
        if np.hypot(*(place - places[anchors[-1]])) >= STILL_M:
            anchors.append(number)
        anchor_of_epoch[number] = len(anchors) - 1
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(places[anchors], axis=0).T)))
    epoch_m = along_m[anchor_of_epoch]

    def moved_m(values: np.ndarray) -> np.ndarray:
        """Return ``[N]`` by how much a coordinate ``[N]`` changes from behind each epoch to ahead of it."""
        ahead = np.interp(epoch_m + STREET_M, along_m, values[anchors])
        return ahead - np.interp(epoch_m - STREET_M, along_m, values[anchors])

    return np.arctan2(moved_m(x_m), moved_m(y_m))


def _rivals(
    rows: pd.DataFrame, rays: Rays, track: Track, settings: ReceiverSettings
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return how well rules predict that know less or more than the margin, such as the street's direction.

    These are ``rivals`` and ``block_lengths`` of an `Evidence`.

    Args:
      rows: judged rows of the validation.
      rays: of all rows, also of others.
      track: gives the street's direction at each epoch.
      settings: length of the blocks, and seed.
    """
    rays = rays.take(rows.index.to_numpy())
    off_street_rad = rays.azimuth_rad - headings_rad(track.x_m, track.y_m)[rows.epoch]
    rules = features_of(rows.margin_m.to_numpy(), rays.elevation_rad, off_street_rad)
    of_rows = rules, rows.is_strong.to_numpy(), rows.block.to_numpy()
    return (
        compared_rules(*of_rows, settings.seed),
        gain_by_length(*of_rows, settings.block_m, settings.seed),
    )


def verdict_of(
    scores: pd.DataFrame, displaced: pd.DataFrame, rivals: pd.DataFrame, num_blocks: int
) -> str:
    """Return what scores and rivals show, in one sentence.

    Praise takes two things: margin and elevation predict better than elevation and the street, and C/N0 separates seen
    from hidden better than in every displaced city, both by their intervals. The first alone does not show that place
    and time are right: satellites that stand still are predicted at any hour.

    Args:
      scores, displaced, rivals: tables of a `ReceiverValidation` and an `Evidence`.
      num_blocks: of the track, with judged rows.
    """
    score = scores.set_index("which").loc["all"]
    gain = rivals.set_index("model").loc[MAP]
    most = float(displaced.auc.max())
    where = f"on these {num_blocks} blocks of track"
    if num_blocks < FEWEST_GROUPS:
        return f"The track is too short for a verdict: {where} there is no interval (it takes {FEWEST_GROUPS} blocks)."
    if not np.isfinite([gain.gain_low, score.auc_low]).all():
        return f"There is no verdict: {where} too few rows are hidden, or too few in view, for an interval."

    # First whether the maps predict better, then whether the city's place is the best one.
    gained = f"the gain in log-loss is {gain.gain:.3f} (95 % interval {gain.gain_low:.3f} to {gain.gain_high:.3f})"
    auc = f"an AUC of {score.auc:.2f} ({score.auc_low:.2f} to {score.auc_high:.2f})"
    if not gain.gain_low > 0:
        return (
            f"It is not shown that the maps predict what this receiver hears {where} better than the "
            f"elevation and the street's direction do: {gained}."
        )
    num_cities = int(displaced.auc.notna().sum())
    if num_cities < FEWEST_CITIES:
        return (
            f"There is no verdict: {where} {num_cities} of {len(displaced)} displaced cities could be scored, and it "
            f"takes {FEWEST_CITIES} ({gained})."
        )
    if not score.auc_low > most:
        return (
            f"It is not shown that the city fits this receiver better than displaced ones do {where}: C/N0 separates "
            f"seen from hidden satellites with {auc}, and displaced cities reach {most:.2f}, though the margin to the "
            f"shadow's edge and the elevation predict better than the elevation and the street's direction ({gained}); "
            "check whether times and places are right."
        )
    return (
        f"The margin to the shadow's edge and the elevation predict what this receiver hears {where} better than the "
        f"elevation and the street's direction do: {gained}; C/N0 separates seen from hidden satellites "
        f"with {auc}, and displaced cities reach at most {most:.2f}."
    )


def tables_of(evidence: Evidence) -> dict[str, pd.DataFrame]:
    """Return the tables that are printed, by name.

    ``scores`` by kind of rows; ``cities``: scores of the city in its place, and the median and the most of displaced
    cities; ``rivals``: rules beside that of the maps; ``lengths``: scores by length of the blocks of track.
    """
    # Rows of both scores: of the city in its place, and of the displaced cities that could be scored.
    names = ["auc", "within"]
    in_place = evidence.of.scores.loc[evidence.of.scores.which == "all", names]
    displaced = evidence.displaced[names].quantile([0.5, 1.0])
    cities = pd.concat([in_place, displaced])
    num_scored = evidence.displaced.auc.notna().sum()
    num = f"{num_scored} of {len(evidence.displaced)} displaced ones that could be scored"
    cities.insert(0, "the city", ["in its place", f"{num}, median", "most"])
    scores = evidence.of.scores.replace({"which": ROWS})
    tables = {
        "scores": scores,
        "cities": cities,
        "rivals": evidence.rivals,
        "lengths": evidence.block_lengths,
    }
    return {
        name: _with_digits(table).rename(columns=EVIDENCE_HEADS) for name, table in tables.items()
    }


def peak_text(evidence: Evidence) -> str:
    """Return where the city fits the receiver best, as a table; in words where that is not known (NaN)."""
    if not np.isfinite(list(evidence.peak.values())).all():
        return f"None: that takes {FEWEST_GROUPS} blocks of track, and satellites both hidden and in view."
    return framed(pd.DataFrame([evidence.peak]).rename(columns=EVIDENCE_HEADS))


def _with_digits(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of the report, in which a value and its interval (NAME_low, NAME_high) share one column.

    Of scores and losses (`SCORES`) that column holds texts with three digits behind the point.
    """
    rows = table.to_dict("records")
    columns = without_ends(table)
    texts = table[columns].reset_index(drop=True)
    for name in texts.columns.intersection([*SCORES]):
        texts[name] = [interval(row, name, _three_digits) for row in rows]
    return texts


def _three_digits(value: float) -> str:
    """Return a number with three digits behind the point, never ``-0.000``; nothing for NaN."""
    return "" if math.isnan(value) else f"{value:z.3f}"


def text_of(evidence: Evidence) -> str:
    """Return the verdict, the tables and where the city fits best, as Markdown."""
    parts = [evidence.verdict, *map(framed, tables_of(evidence).values()), peak_text(evidence)]
    if evidence.every > 1:
        parts.append(
            f"All that moves cities or roofs, and the rules, take one of {evidence.every} epochs of this long log."
        )
    if evidence.is_peak_at_edge:
        parts.append(
            "The city fits best at the edge of the search (40 m, heights times 0.8 or 1.2): see whether places, "
            "heights and the CRS are right."
        )
    return "\n\n".join(parts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the evidence of a log, and return the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.receiver.evidence", description=__doc__)
    parser.add_argument("scenario", help="TOML file, or sample:CITY")
    parser.add_argument("log", nargs="?", help="of the receiver; left out: the sample city's")
    parser.add_argument(
        "--set", dest="changes", action="append", default=[], help="of the scenario"
    )
    parser.add_argument("--systems", default="", help="letters of the satellite systems, as G,E")
    parser.add_argument("--displaced", type=int, default=NUM_DISPLACED, help="cities of the null")
    options = parser.parse_args(arguments)

    def answer() -> None:
        """Print the evidence."""
        scenario = Scenario.from_toml(options.scenario, options.changes)
        settings = ReceiverSettings(systems=tuple(filter(None, options.systems.split(","))))
        print(text_of(evidence_of(scenario, options.log, settings, options.displaced, True)))

    return exit_code(answer)


if __name__ == "__main__":
    sys.exit(main())
