"""A log of numbers of satellites and position errors against maps of its times, places and antenna height.

``python -m benchmarks.receiver.counts scenario.toml log.csv`` prints the scores. The log is a table with ``utc``,
``lon_deg``, ``lat_deg`` and ``num_tracked``, ``error_2d_m`` or both.

Legend: ``N`` values in the order of the track, ``G`` blocks of the track.

**Within blocks** the ranks are those of the whole track less their mean over the value's block. What is left says
whether the two quantities rise and fall together from one street to the next, and not that one quarter of the city is
denser than another. **Shifts** are the control: the maps' values are moved along the track, its end joined to its
beginning, by every number of places, so that both series stay what they are and only their pairing is lost.
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import rankdata
from scipy.stats import t as student

from benchmarks.common import exit_code
from jaxurban.draw.write import interval, table
from jaxurban.errors import InputError
from jaxurban.io.samples import located
from jaxurban.io.tables import read_table
from jaxurban.io.tracks import LAT, LON, RULES, UTC, Rule, checked, renamed
from jaxurban.kernels.shadows.sweep import WORD_BITS
from jaxurban.maps.run import scenario_grid
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.task import MapTask
from jaxurban.maps.tile_scene import TileScene
from jaxurban.progress import Progress, Report, reporting
from jaxurban.receivers.sight import Sight
from jaxurban.receivers.track import NUM_VISIBLE, Track, quality_along
from jaxurban.receivers.validation.drive import drive_track
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, LEVEL, Interval
from jaxurban.world.grid import Grid

# What a log holds of how well the receiver did.
WITNESSES = TRACKED, ERROR = ("num_tracked", "error_2d_m")
LEG_CELLS = 1_500_000  # of the box around a leg of which maps are made
# No receiver has channels for more satellites.
OF_COUNTS = RULES | {
    TRACKED: Rule(0.0, 200.0, may_lack=True),
    ERROR: Rule(0.0, np.inf, may_lack=True),
}
MAIN = {TRACKED: NUM_VISIBLE, ERROR: "hdop"}
# Of all else, dilutions of precision and errors, less is better.
MORE_IS_BETTER = (TRACKED, NUM_VISIBLE, "gps")
WITHIN, SPEARMAN = COEFFICIENTS = ("within", "spearman")
SHIFTS_BELOW = 0.95  # of all shifts score no more than the `_shifts_95` of a coefficient
FEWEST_PIECES = 8  # fewer rank nothing
NAMES = {NUM_VISIBLE: "satellites in view", "gps": "GPS quality m"}
LABELS = {TRACKED: "satellites tracked", ERROR: "horizontal error (m)"}
HEADS = {WITHIN: "rank correlation within blocks", SPEARMAN: "over the whole track"}


@dataclass(frozen=True)
class CountSettings:
    """How counts and errors are set against maps. None of these is fitted to a log.

    Attributes:
      antenna_height_m: of the receiver's antenna above the ground.
      sky_step_s: seconds for which satellites stand still; each epoch takes the sky nearest to it in time.
      piece_m: length of the pieces of track whose medians are compared.
      other_pieces_m: further lengths of pieces for which the same is reported.
      block_m: length of the blocks of track within which ranks are compared, and of which one after the other is left
        out for the interval.
    """

    antenna_height_m: float = 2.0
    sky_step_s: float = 30.0
    piece_m: float = 25.0
    other_pieces_m: Sequence[float] = (10.0, 50.0, 100.0)
    block_m: float = 200.0

    @property
    def pieces_m(self) -> tuple[float, ...]:
        """All lengths of pieces, from short to long."""
        return tuple(sorted({float(self.piece_m), *map(float, self.other_pieces_m)}))


@dataclass(frozen=True, eq=False)
class CountValidation:
    """A receiver's counts and errors beside what maps say along its track.

    Attributes:
      settings: how the two were set beside each other.
      summary: numbers of the whole track: its length, and means. Names of metres end in ``_m``.
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
    """

    settings: CountSettings
    summary: dict[str, float]
    epochs: pd.DataFrame
    pieces: pd.DataFrame
    scores: pd.DataFrame
    shifts: pd.DataFrame

    @property
    def main(self) -> pd.DataFrame:
        """The scores of each witness against the prediction that is its own, over pieces of the chosen length."""
        is_main = self.scores.prediction == self.scores.witness.map(MAIN)
        return self.scores[is_main & (self.scores.piece_m == self.settings.piece_m)]


def read_counts(source: str | Path | pd.DataFrame) -> pd.DataFrame:
    """Return the epochs of a log of counts, in the order of their times.

    Args:
      source: a table, or its file (.csv, .csv.gz, .parquet), with ``utc``, ``lon_deg`` (or ``lon``), ``lat_deg`` (or
        ``lat``), and ``num_tracked``, ``error_2d_m`` or both.

    Raises:
      InputError: a file that cannot be read, a column that is missing, invalid times, coordinates or numbers, or two
        rows of one time.
    """
    what = "the log of counts"
    if not isinstance(source, pd.DataFrame):
        what = f"{what} {str(source)!r}"
        source = read_table(located(source), "log of counts")
    log = renamed(source)
    known = [name for name in (UTC, LON, LAT, *WITNESSES) if name in log]
    if known[:3] != [UTC, LON, LAT] or len(known) == 3 or log.empty:
        raise InputError(
            f"{what} has {len(log)} rows without the columns {UTC}, {LON}, {LAT} and {' or '.join(WITNESSES)}: add them"
        )
    log = checked(log, known, what, OF_COUNTS).sort_values(UTC, kind="stable", ignore_index=True)
    is_second = log.duplicated(UTC)
    if is_second.any():
        raise InputError(
            f"{what} has two rows at {log[UTC][is_second].iloc[0].isoformat()}: keep one row an epoch"
        )
    return log


def counted(
    scenario: Scenario,
    log: str | Path | pd.DataFrame,
    settings: CountSettings | None = None,
    progress: Progress = False,
) -> CountValidation:
    """Return how well maps of a scenario predict numbers of satellites and errors along a track.

    Maps are made of the scenario's city, orbits and mask, at the log's times and the antenna's height, and give
    satellites in view, dilutions of precision and m of GPS in the cells of the track. No number of the maps is fitted
    to the log.

    Args:
      scenario: of the maps; its times, its altitudes and the layers that a user added are ignored.
      log: a table or its file, see `read_counts`.
      settings: how the two are set beside each other.
      progress: as of `jaxurban.studies.validate`.

    Raises:
      InputError: a log that cannot be read, lies outside the region or is too short.
    """
    settings = settings or CountSettings()
    logged = read_counts(log)
    grid = scenario_grid(scenario)
    track = drive_track("of counts", logged, grid, settings.sky_step_s)
    num_pieces = len(np.unique(track.along_m // settings.piece_m))
    if num_pieces < FEWEST_PIECES:
        raise InputError(
            f"the track of the log of counts is {track.along_m[-1]:.0f} m long, less than {FEWEST_PIECES} pieces of "
            f"{settings.piece_m:g} m: give a longer log, or shorter pieces"
        )
    with reporting("counts", progress) as report:
        report("read")
        sight = Sight.of_scenario(scenario, grid)
        task = sight.task(track.sky_times, float(settings.antenna_height_m), None)
        predicted = predict(task, track, report)
        report("scores")
        places = {"x_m": track.x_m, "y_m": track.y_m, "along_m": track.along_m}
        epochs = logged.assign(**places, **predicted)
        witnesses = [name for name in WITNESSES if name in epochs]
        scores, shifts = tables(epochs, witnesses, list(predicted), settings)
    summary = {
        "length_m": float(track.along_m[-1]),
        "mean_num_visible": float(epochs[NUM_VISIBLE].mean()),
    }
    if TRACKED in epochs:
        summary[f"mean_{TRACKED}"] = float(epochs[TRACKED].mean())
    return CountValidation(
        settings=settings,
        summary=summary,
        epochs=epochs,
        pieces=pieces_of(epochs, settings.piece_m, settings.block_m),
        scores=scores,
        shifts=shifts,
    )


def seen_along(task: MapTask, track: Track, report: Report) -> tuple[np.ndarray, np.ndarray]:
    """Return which satellites the maps see from each epoch of a track, and which places they know to be outdoors.

    In a building, and without data, no satellite is seen.

    Args:
      task: of one altitude; its sky has the track's times.
      track: over the task's region.
      report: is called with the stage, how many skies are done, and how many there are.

    Returns:
      ``[N, S]`` bool of epochs and satellites, and ``[N]`` bool of epochs.
    """
    num_skies = len(track.sky_times)
    is_seen = np.zeros((len(track.sky), len(task.sky.names)), bool)
    is_known = np.zeros(len(track.sky), bool)
    for leg in track.legs(task.region, LEG_CELLS):
        # One tile holds all places of a leg; its times are the leg's skies.
        skies = np.unique(track.sky[leg]).tolist()
        tile = _tile(task, track.box(task.region, leg), skies)
        part = tile.surface.region
        for t, number in enumerate(skies):
            report("skies", number, num_skies)
            epochs = np.flatnonzero(track.sky == number)
            row, col = part.cell_of_xy(track.x_m[epochs], track.y_m[epochs])
            is_known[epochs] = ~np.asarray(tile.is_obstacle[0])[row, col]
            if tile.has_data is not None:
                is_known[epochs] &= tile.has_data[row, col]

            words = tile.words(t)[:, 0, row, col]
            for k, satellite in enumerate(task.in_view(number).numbers):
                is_seen[epochs, satellite] = (words[k // WORD_BITS] >> (k % WORD_BITS)) & 1
            tile.forget()
    report("skies", num_skies, num_skies)
    return is_seen & is_known[:, None], is_known


def _tile(task: MapTask, region: Grid, skies: list[int]) -> TileScene:
    """Return a task's tile over a part of its region at some of its times, ready for its maps.

    Args:
      task: the whole.
      region: the part.
      skies: numbers of the times in the task's sky.
    """
    sky = replace(
        task.sky,
        times=tuple(task.sky.times[t] for t in skies),
        azimuth_rad=task.sky.azimuth_rad[skies],
        elevation_rad=task.sky.elevation_rad[skies],
        element_age_days=task.sky.element_age_days[skies],
    )
    part = replace(task, region=region, sky=sky)
    return TileScene(part, part.surface())


def predict(task: MapTask, track: Track, report: Report) -> dict[str, np.ndarray]:
    """Return what the maps of a task predict along a track: ``[N]`` float64 by the names of `quality_along`.

    The values are NaN where the track is in a building, and where the maps have no data.

    Args:
      task: of one altitude; its sky has the track's times.
      track: over the task's region.
      report: is called with the stage, how many skies are done, and how many there are.
    """
    is_seen, is_known = seen_along(task, track, report)
    quality = quality_along(task, track.sky, is_seen)
    return {name: np.where(is_known, values, np.nan) for name, values in quality.items()}


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
      epochs: as `CountValidation` holds them.
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
    settings: CountSettings,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the scores and the shifts, as `CountValidation` holds them.

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


def name_of(prediction: str) -> str:
    """Return what tables call a quantity of the maps."""
    return NAMES.get(prediction, prediction.upper())


def with_interval(row: Mapping[Any, Any], coefficient: str) -> str:
    """Return a coefficient with the interval that it has, as ``0.42 (0.29 to 0.54)``; nothing where it is undefined."""
    return interval(row, coefficient, _number)


def score_table(scores: pd.DataFrame) -> str:
    """Return scores as a table in Markdown, a line per row.

    Of each coefficient there are three columns: the value with its interval, what 95 % of all shifts of the maps along
    the track stay below, and p.
    """
    head = ["receiver", "maps", "pieces of", "number"]
    for name in COEFFICIENTS:
        head += [HEADS[name], "95 % of shifts below", "p"]
    rows = []
    for row in scores.to_dict("records"):
        cells = [
            LABELS[row["witness"]],
            name_of(row["prediction"]),
            f"{row['piece_m']:g} m",
            f"{row['num']:,}",
        ]
        for name in COEFFICIENTS:
            cells += [
                with_interval(row, name),
                _number(row[f"{name}_shifts_95"]),
                _number(row[f"{name}_p"], digits=3),
            ]
        rows.append(cells)
    return table(head, rows)


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the scores of a log of counts, and return the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.receiver.counts", description=__doc__)
    parser.add_argument("scenario", help="TOML file, or sample:CITY")
    parser.add_argument("log", type=Path, help="table of counts")
    parser.add_argument(
        "--set", dest="changes", action="append", default=[], help="of the scenario"
    )
    options = parser.parse_args(arguments)

    def answer() -> None:
        """Print the scores."""
        scenario = Scenario.from_toml(options.scenario, options.changes)
        print(score_table(counted(scenario, options.log, progress=True).scores))

    return exit_code(answer)


if __name__ == "__main__":
    sys.exit(main())
