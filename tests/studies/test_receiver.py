"""A receiver beside maps: the maps' own values, what a true receiver scores and a shuffled one does not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.read.receiver import read_receiver_log
from jaxurban.studies.receiver import prediction
from jaxurban.studies.receiver.prediction import Track
from jaxurban.studies.receiver.validate import paired
from tests.metrics.whole_maps import compute_gps
from tests.receiver_logs import SCENARIO, SETTINGS, drive, found, scenario, seen, surface, true_log

GRID = ju.Grid.from_bounds(SCENARIO["region"]["bounds"], 5.0)


def validated(log: pd.DataFrame, **settings) -> ju.studies.ReceiverValidation:
    chosen = ju.studies.ReceiverSettings(**{**SETTINGS.to_dict(), **settings})
    return ju.studies.validate(scenario(), log, chosen, progress=False)


def score(of: ju.studies.ReceiverValidation, witness: str = "num_tracked") -> pd.Series:
    return of.main.set_index("witness").loc[witness]


def test_the_prediction_is_what_maps_of_those_times_and_that_height_hold():
    track = Track.of(read_receiver_log(true_log()), GRID, SETTINGS.sky_step_s)
    sky = prediction.task_at(scenario(), track.sky_times, GRID, SETTINGS.antenna_height_m).sky
    made = []
    for azimuth_rad, elevation_rad in zip(sky.azimuth_rad, sky.elevation_rad, strict=True):
        above = elevation_rad >= np.radians(10.0)
        made.append(compute_gps(surface(), azimuth_rad[above], elevation_rad[above], np.array([2.0], np.float32)))
    is_free = np.asarray(surface().crop(surface().roof_m) < 2.0)[track.row, track.col]
    for name in ("num_visible", "gdop", "hdop", "m"):
        held = np.stack([np.asarray(getattr(maps, name)[0]) for maps in made])[track.sky, track.row, track.col]
        found_here = found().epochs["gps" if name == "m" else name]
        np.testing.assert_array_equal(found_here, np.where(is_free, held, np.nan))
    assert len(made) > 1


def test_legs_change_no_value(monkeypatch):
    monkeypatch.setattr(prediction, "LEG_CELLS", 100)
    names = [name for name in seen().epochs if name not in ("utc", "num_tracked")]
    again = validated(drive().assign(num_tracked=5))
    pd.testing.assert_frame_equal(again.epochs[names], seen().epochs[names])


def test_a_receiver_that_tracks_what_is_in_view_scores_above_every_shift():
    of = score(found())
    num = len(found().pieces)
    assert of.within > 0.7
    assert of.within_low > 0.6
    assert of.spearman > 0.8
    for name in ("within", "spearman"):
        assert of[f"{name}_p"] == pytest.approx(1 / num)
    assert of.within_shifts_95 < of.within_low
    error = score(found(), "error_2d_m")
    assert error.within > 0.6


@cache
def shuffled() -> ju.studies.ReceiverValidation:
    tracked = np.random.default_rng(7).permutation(true_log().num_tracked.to_numpy())
    return validated(true_log().assign(num_tracked=tracked))


def test_a_shuffled_log_scores_nothing():
    of = score(shuffled())
    assert abs(of.within) < 0.3
    assert of.within_low < 0 < of.within_high
    assert abs(of.spearman) < 0.3
    assert min(of.within_p, of.spearman_p) > 0.05


def test_quarters_alone_score_over_the_whole_track_and_not_within_blocks():
    """A receiver that knows how many are in view in the quarter, and nothing of the street."""
    pieces = true_log().assign(piece=(found().epochs.along_m // 100).to_numpy()).groupby("piece").num_tracked
    rng = np.random.default_rng(9)
    tracked = np.round(pieces.transform("mean") + rng.integers(-2, 3, len(true_log())).clip(-2, 2)).clip(0)
    of = score(validated(true_log().assign(num_tracked=tracked)))
    assert of.spearman > 0.5
    assert of.spearman_p < 0.02
    assert of.within < 0.25


def test_the_scores_and_the_shifts_agree():
    of = found().shifts.query("witness == 'num_tracked' and piece_m == 25.0")
    assert len(of) == len(found().pieces)
    assert set(of["shift"]) == set(range(-(len(of) // 2), len(of) - len(of) // 2))
    row = score(found())
    for name in ("within", "spearman"):
        assert of[of["shift"] == 0][name].item() == row[name]
        assert np.mean(of[name] >= row[name]) == row[f"{name}_p"]
        assert np.quantile(of[of["shift"] != 0][name], 0.95) == pytest.approx(row[f"{name}_shifts_95"])


def test_a_receiver_that_always_tells_the_same_has_no_coefficient():
    assert np.isnan(score(seen()).spearman)
    assert "not defined" in seen().facts["num_tracked"]


def test_pieces_are_medians_of_their_epochs():
    track_m = found().epochs.along_m
    for piece in found().pieces.sample(5, random_state=0).itertuples():
        on = found().epochs[(track_m // 25 == piece.piece) & found().epochs.num_visible.notna()]
        assert len(on) == piece.epochs
        assert on.num_visible.median() == piece.num_visible
        assert on.num_tracked.median() == piece.num_tracked
        assert piece.block == piece.piece * 25 // 100
    assert set(found().scores.piece_m) == {10.0, 25.0, 50.0, 100.0}


def test_paired_differences_are_of_the_same_draws():
    same = paired(found(), found())
    assert (same.value, same.low, same.high) == (0.0, 0.0, 0.0)
    difference = paired(found(), shuffled())
    assert difference.value == pytest.approx(score(shuffled()).within - score(found()).within)
    assert difference.high < 0
    other = paired(found(), found(), predictions=(None, "gdop"))
    gdop = found().scores.query("witness == 'num_tracked' and prediction == 'gdop'").within.item()
    assert other.value == pytest.approx(gdop - score(found()).within)
    with pytest.raises(InputError, match="different logs or pieces"):
        paired(found(), replace(found(), settings=replace(SETTINGS, piece_m=50.0)))


def test_a_log_outside_the_region_is_one_sentence():
    with pytest.raises(InputError, match=r"^693 of the 693 places of the receiver log .* outside .*\[region\] bounds"):
        validated(true_log().assign(lon_deg=true_log().lon_deg + 1))
    with pytest.raises(InputError, match=r"^1 of the 693 places"):
        validated(true_log().assign(lon_deg=[true_log().lon_deg[0] + 1, *true_log().lon_deg[1:]]))
    with pytest.raises(InputError, match=r"whether lon_deg and lat_deg are swapped"):
        validated(true_log().assign(lon_deg=true_log().lat_deg, lat_deg=true_log().lon_deg))


def test_a_short_track_is_one_sentence():
    with pytest.raises(InputError, match="less than 8 pieces of 25 m"):
        validated(true_log().iloc[:10])


@pytest.mark.parametrize(
    "wrong", [{"block_m": 10.0}, {"sky_step_s": 900.0}, {"other_pieces_m": (0.0,)}, {"piece_m": -1.0}]
)
def test_settings_that_make_no_sense_name_themselves(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        ju.studies.ReceiverSettings(**wrong)
