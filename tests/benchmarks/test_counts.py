"""A receiver beside maps: rank correlations with their controls, and what a true receiver scores and others do not."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from scipy.stats import spearmanr

import jaxurban as ju
from benchmarks.receiver import counts
from benchmarks.receiver.counts import (
    CountValidation,
    counted,
    half_width,
    read_counts,
    score_table,
    shifted,
    spearman,
    with_interval,
    within_blocks,
    without_each_block,
)
from jaxurban.receivers.sight import Sight
from jaxurban.receivers.validation.drive import drive_track
from tests.benchmarks.count_logs import OF_ONE_LENGTH, SETTINGS, found, seen, true_log
from tests.metrics.whole_maps import compute_gps
from tests.receivers.receiver_logs import SCENARIO, drive, scenario, surface

GRID = ju.Grid.from_bounds(SCENARIO["region"]["bounds"], 5.0)


def validated(log: pd.DataFrame) -> CountValidation:
    return counted(scenario(), log, OF_ONE_LENGTH)


def tracking(num_tracked: np.ndarray) -> pd.Series:
    """Return the score of a receiver on the drive that tracks so many satellites."""
    return score(validated(drive().assign(num_tracked=num_tracked)))


def score(of: CountValidation, witness: str = "num_tracked") -> pd.Series:
    return of.main.set_index("witness").loc[witness]


@pytest.mark.slow
def test_the_prediction_is_what_maps_of_those_times_and_that_height_hold():
    drive = drive_track("a log", read_counts(true_log()), GRID, SETTINGS.sky_step_s)
    sky = (
        Sight.of_scenario(scenario(), GRID)
        .task(drive.sky_times, SETTINGS.antenna_height_m, None)
        .sky
    )
    made = [
        compute_gps(surface(), azimuth[above], elevation[above], np.array([2.0], np.float32))
        for azimuth, elevation in zip(sky.azimuth_rad, sky.elevation_rad, strict=True)
        for above in [elevation >= np.radians(10.0)]
    ]
    cells = GRID.cell_of_xy(drive.x_m, drive.y_m)
    is_free = np.asarray(surface().crop(surface().roof_m) < 2.0)[cells]
    for name in ("num_visible", "gdop", "hdop", "m"):
        values = np.stack([np.asarray(getattr(maps, name)[0]) for maps in made])
        held = values[drive.sky, *cells]
        found_here = found().epochs["gps" if name == "m" else name]
        np.testing.assert_array_equal(found_here, np.where(is_free, held, np.nan))
    assert len(made) > 1


@pytest.mark.slow
def test_legs_change_no_value(monkeypatch):
    monkeypatch.setattr(counts, "LEG_CELLS", 100)
    pd.testing.assert_frame_equal(validated(drive().assign(num_tracked=5)).epochs, seen().epochs)


@pytest.mark.slow
def test_a_receiver_that_tracks_what_is_in_view_scores_above_every_shift():
    of = score(found())
    assert of.within > 0.7
    assert of.within_low > max(0.6, of.within_shifts_95)
    assert of.spearman > 0.8
    assert [of.within_p, of.spearman_p] == pytest.approx([1 / len(found().pieces)] * 2)
    assert score(found(), "error_2d_m").within > 0.6


@pytest.mark.slow
def test_a_shuffled_log_scores_nothing():
    of = tracking(np.random.default_rng(7).permutation(true_log().num_tracked.to_numpy()))
    assert abs(of.within) < 0.3
    assert of.within_low < 0 < of.within_high
    assert abs(of.spearman) < 0.3
    assert min(of.within_p, of.spearman_p) > 0.05


@pytest.mark.slow
def test_quarters_alone_score_over_the_whole_track_and_not_within_blocks():
    """A receiver that knows how many are in view in the quarter, and nothing of the street."""
    pieces = (
        true_log()
        .assign(piece=(found().epochs.along_m // 100).to_numpy())
        .groupby("piece")
        .num_tracked
    )
    rng = np.random.default_rng(9)
    tracked = np.round(
        pieces.transform("mean") + rng.integers(-2, 3, len(true_log())).clip(-2, 2)
    ).clip(0)
    of = tracking(tracked)
    assert of.spearman > 0.5
    assert of.spearman_p < 0.02
    assert of.within < 0.25


@pytest.mark.slow
def test_the_scores_and_the_shifts_agree_and_pieces_are_medians_of_their_epochs():
    of = found().shifts.query("witness == 'num_tracked' and piece_m == 25.0")
    assert len(of) == len(found().pieces)
    assert set(of["shift"]) == set(range(-(len(of) // 2), len(of) - len(of) // 2))
    row = score(found())
    for name in ("within", "spearman"):
        assert of[of["shift"] == 0][name].item() == row[name]
        assert np.mean(of[name] >= row[name]) == row[f"{name}_p"]
        assert np.quantile(of[of["shift"] != 0][name], 0.95) == pytest.approx(
            row[f"{name}_shifts_95"]
        )
    epochs = found().epochs[found().epochs.num_visible.notna()]
    for piece in found().pieces.sample(5, random_state=0).itertuples():
        on = epochs[epochs.along_m // 25 == piece.piece]
        assert len(on) == piece.epochs
        assert on.num_visible.median() == piece.num_visible
        assert on.num_tracked.median() == piece.num_tracked
        assert piece.block == piece.piece * 25 // 100
    assert set(found().scores.piece_m) == {10.0, 25.0, 50.0, 100.0}


REFUSED = {
    "^1 of the 626 places": lambda log: log.assign(lon_deg=log.lon_deg + (log.index == 0)),
    "without the columns utc, lon_deg, lat_deg and num_tracked or error_2d_m": lambda log: log.drop(
        columns=["num_tracked", "error_2d_m"]
    ),
    "two rows at 2020-04-27T16:00:00": lambda log: log.assign(utc=log.utc[0]),
    "has -1 in num_tracked .* a number from 0 to 200": lambda log: log.assign(num_tracked=-1),
    "a number from 0 to 200": lambda log: log.assign(num_tracked=1e9),
    "has True in num_tracked": lambda log: log.assign(num_tracked=True),
    "has -0.5 in error_2d_m .* from 0 to inf": lambda log: log.assign(error_2d_m=-0.5),
    "'many'": lambda log: log.assign(num_tracked="many"),
    r"nan in num_tracked of 626 row\(s\)": lambda log: log.assign(num_tracked=np.nan),
    "less than 8 pieces of 25 m": lambda log: log.iloc[:10],
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_a_log_that_cannot_be_used_is_one_sentence(sentence):
    with pytest.raises(ju.InputError, match=sentence):
        validated(REFUSED[sentence](true_log()))


RNG = np.random.default_rng(4)
A, B = RNG.integers(0, 9, 60).astype(float), RNG.integers(0, 9, 60).astype(float)
PIECES = 8  # of a block of 200 m, 25 m each


def track(rng: np.random.Generator, num_blocks: int, num_maps: int = 1) -> list[np.ndarray]:
    """Return satellites tracked and those on maps: alike within blocks, as neighbours are, and whole blocks alike."""
    num = num_blocks * PIECES
    shared = rng.normal(size=num)
    noise = [shared * 0.67 + 0.74 * rng.normal(size=num) for _ in range(1 + num_maps)]
    along = [lfilter([0.8], [1.0, -0.6], values) for values in noise]
    quarter = rng.normal(size=num_blocks)
    levels = [np.repeat(0.77 * quarter + 0.63 * rng.normal(size=num_blocks), PIECES) for _ in along]
    return [np.round(2 * (values + level)) for values, level in zip(along, levels, strict=True)]


def blocks(num_blocks: int) -> np.ndarray:
    return np.repeat(np.arange(num_blocks), PIECES)


def test_spearman_is_scipys():
    assert spearman(A, B) == pytest.approx(spearmanr(A, B).statistic, abs=1e-12)
    values = np.array([1.0, 2.0, np.inf, np.inf])
    assert spearman(values, np.arange(4.0)) == pytest.approx(
        spearmanr([0, 1, 2, 2], range(4)).statistic
    )


def test_what_does_not_vary_has_no_coefficient():
    assert np.isnan(score(seen()).spearman)
    assert np.isnan(spearman(A, np.zeros(60)))
    assert np.isnan(spearman(A, np.repeat([1.0, 2.0, 3.0], 20), np.repeat([0, 1, 2], 20)))


def test_within_blocks_quarters_that_differ_add_nothing_and_hide_no_streets_that_agree():
    rng, of = np.random.default_rng(1), blocks(40)
    level, other = (20.0 * np.repeat(rng.normal(size=40), PIECES) for _ in range(2))
    receiver, maps, street = rng.normal(size=(3, len(of)))
    assert spearman(level + receiver, level + maps) > 0.95
    assert abs(spearman(level + receiver, level + maps, of)) < 0.15
    assert abs(spearman(street + level, street + other)) < 0.3
    assert spearman(street + level, street + other, of) > 0.5


def test_every_shift_is_scored_and_only_none_finds_the_pairs_again():
    at_shifts = shifted(lambda maps: spearman(A, maps), A)
    assert len(at_shifts) == 60
    assert at_shifts[0] == pytest.approx(1.0)
    assert at_shifts[1:].max() < 0.6
    assert at_shifts[7] == pytest.approx(
        spearmanr(A[:-7].tolist() + A[-7:].tolist(), np.roll(A, -7)).statistic
    )


@pytest.mark.slow
@pytest.mark.parametrize("num_blocks", [8, 39])
def test_95_percent_intervals_within_blocks_and_of_differences_hold_the_truth_in_93_percent_of_2000_tracks(
    num_blocks,
):
    truth = spearman(*track(np.random.default_rng(0), 20_000), blocks(20_000))
    (rng, of_two), of, holds = (
        (np.random.default_rng(num_blocks) for _ in range(2)),
        blocks(num_blocks),
        [],
    )
    for _ in range(2000):
        scored = within_blocks(*track(rng, num_blocks), of)
        receiver, one, other = track(of_two, num_blocks, num_maps=2)
        value, without = (
            score(receiver, one, of) - score(receiver, other, of)
            for score in (spearman, without_each_block)
        )
        holds.append((scored.low <= truth <= scored.high, abs(value) <= half_width(without)))
    assert np.mean(holds, axis=0).min() >= 0.93


def test_few_blocks_or_one_that_disagrees_with_all_others_that_agree_have_no_interval():
    scored = within_blocks(A, B, np.repeat(np.arange(6), 10))
    assert np.isfinite(scored.value)
    assert np.isnan(scored.low)
    a, of = np.arange(80.0), np.repeat(np.arange(8), 10)
    scored = within_blocks(a, np.where(of == 7, a[::-1] + 70.0, a), of)
    assert 0 < scored.value < 1
    assert np.isnan([scored.low, scored.high]).all()


def test_epochs_come_in_the_order_of_their_times_and_some_may_lack_a_count():
    log = read_counts(true_log()[::-1].assign(num_tracked=[np.nan, *[7.0] * (len(true_log()) - 1)]))
    assert log.utc.is_monotonic_increasing
    assert log.num_tracked.isna().sum() == 1


def test_the_table_holds_the_numbers_of_the_scores():
    text = score_table(found().scores)
    for row in found().main.to_dict("records"):
        assert with_interval(row, "within") in text
    assert "95 % of shifts below" in text
    assert "nan" not in text


@pytest.mark.slow
def test_a_log_of_errors_alone_is_scored_and_a_short_still_one_has_no_interval():
    errors = counted(scenario(), true_log()[["utc", "lon_deg", "lat_deg", "error_2d_m"]], SETTINGS)
    assert list(errors.main.witness) == ["error_2d_m"]
    short = counted(scenario(), true_log()[:60].assign(num_tracked=[5, 8] * 30), SETTINGS)
    assert short.scores.within_low.isna().all()


@pytest.mark.slow
def test_the_command_prints_the_scores_of_a_log_or_one_sentence(tmp_path, capsys):
    toml, log = tmp_path / "town.toml", tmp_path / "log.csv"
    toml.write_text(scenario().to_toml())
    true_log().to_csv(log, index=False)
    assert counts.main([str(toml), str(log)]) == 0
    assert "| satellites tracked | satellites in view | 25 m |" in capsys.readouterr().out
    log.write_text("utc,lon_deg,lat_deg\n2020-04-27T16:00:00Z,-73.9,40.7\n")
    assert counts.main([str(toml), str(log)]) == 2
    assert "num_tracked" in capsys.readouterr().err
