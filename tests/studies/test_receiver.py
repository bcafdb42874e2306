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
from jaxurban.studies.receiver.satellites import TrackedSatellites
from jaxurban.studies.receiver.track import Track
from jaxurban.studies.receiver.validate import paired
from tests.metrics.whole_maps import compute_gps
from tests.receiver_logs import SCENARIO, SETTINGS, drive, found, scenario, seen, surface, true_log

GRID = ju.Grid.from_bounds(SCENARIO["region"]["bounds"], 5.0)


def validated(log: pd.DataFrame, **settings) -> ju.ReceiverValidation:
    chosen = ju.ReceiverSettings(**{**SETTINGS.to_dict(), **settings})
    return ju.validate(scenario(), log, chosen, progress=False)


def score(of: ju.ReceiverValidation, witness: str = "num_tracked") -> pd.Series:
    return of.main.set_index("witness").loc[witness]


def test_the_prediction_is_what_maps_of_those_times_and_that_height_hold():
    track = Track.of(read_receiver_log(true_log()), GRID, SETTINGS.sky_step_s)
    sky = prediction.task_at(scenario(), track.sky_times, GRID, SETTINGS).sky
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
    assert of.auc > 0.9
    for name in ("within", "spearman", "auc"):
        assert of[f"{name}_p"] == pytest.approx(1 / num)
    assert of.within_shifts_95 < of.within_low
    assert not of.spearman_open > 0.3
    error = score(found(), "error_2d_m")
    assert error.within > 0.6
    assert np.isnan(error.auc)


@cache
def shuffled() -> ju.ReceiverValidation:
    tracked = np.random.default_rng(7).permutation(true_log().num_tracked.to_numpy())
    return validated(true_log().assign(num_tracked=tracked))


def test_a_shuffled_log_scores_nothing():
    of = score(shuffled())
    assert abs(of.within) < 0.3
    assert of.within_low < 0 < of.within_high
    assert abs(of.spearman) < 0.3
    assert abs(of.auc - 0.5) < 0.15
    assert min(of.within_p, of.spearman_p, of.auc_p) > 0.05


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
    for name in ("within", "spearman", "auc"):
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


def test_satellites_in_sight_are_told_from_hidden_ones():
    rng = np.random.default_rng(8)
    track = Track.of(read_receiver_log(true_log()), GRID, SETTINGS.sky_step_s)
    task = prediction.task_at(scenario(), track.sky_times, GRID, SETTINGS)
    made = prediction.predict(task, track, lambda *_, **__: None)
    epoch, s = np.nonzero(made.is_above)
    in_sight = made.is_seen[epoch, s]
    kept = rng.random(len(epoch)) < np.where(in_sight, 0.95, 0.3)  # reflections keep some
    log = (
        drive()
        .iloc[epoch[kept]]
        .assign(
            satellite=np.array(made.names)[s[kept]].astype(str),
            cn0_dbhz=np.where(in_sight, 45.0, 35.0)[kept] + rng.normal(0, 3, kept.sum()),
        )
    )
    of = validated(log)
    tracked, heard = score(of, "satellite"), score(of, "cn0_dbhz")
    assert tracked.auc == pytest.approx(0.5 * (1 + 0.95 - 0.3), abs=0.03)
    assert tracked.auc_p < 0.01
    assert tracked.auc_shifts_95 < tracked.auc
    assert heard.auc == pytest.approx(0.991, abs=0.01)  # Phi(10 / 3 / sqrt 2): 10 dB apart
    hidden = of.satellites[of.satellites.in_sight < 0.9]
    assert (hidden.tracked_in_sight > hidden.tracked_hidden).all()
    assert of.log.epochs.num_tracked.sum() == kept.sum()
    with pytest.raises(InputError, match=r"'G99'.*call them as the orbits do") as refused:
        validated(log.assign(satellite=["G99", *log.satellite[1:]]))
    assert "\n" not in str(refused.value)


def test_satellites_are_known_by_the_numbers_in_their_names():
    names = ("GPS BIIR-2  (PRN 13)", "GPS BIIF-1  (PRN 05)", "BEIDOU-3 M1 (C19)")
    log = read_receiver_log(drive().iloc[:3].assign(satellite=["G13", "g05", "C19"]))
    tracked = TrackedSatellites.of(log, names, names)
    np.testing.assert_array_equal(tracked.is_tracked, np.eye(3, dtype=bool))
    twice = drive().iloc[[0, 1, 1]].assign(satellite=["G13", "g05", names[1]])
    with pytest.raises(InputError, match=r"under two names at one time, 'g05' and 'GPS BIIF-1  \(PRN 05\)'"):
        TrackedSatellites.of(read_receiver_log(twice), names, names)


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
    with pytest.raises(InputError, match=r"lon_deg and lat_deg are swapped$"):
        validated(true_log().assign(lon_deg=true_log().lat_deg, lat_deg=true_log().lon_deg))


def test_a_short_track_and_another_resolution_are_one_sentence():
    with pytest.raises(InputError, match="less than 8 pieces of 25 m"):
        validated(true_log().iloc[:10])
    with pytest.raises(InputError, match="resolution_m must be one of the scenario's, 5, got 3"):
        validated(true_log(), resolution_m=3.0)


@pytest.mark.parametrize(
    "wrong", [{"block_m": 10.0}, {"sky_step_s": 900.0}, {"other_pieces_m": (0.0,)}, {"piece_m": -1.0}]
)
def test_settings_that_make_no_sense_name_themselves(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        ju.ReceiverSettings(**wrong)
