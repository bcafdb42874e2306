"""A receiver beside maps: the maps' own values, what a true receiver scores and a shuffled one does not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.read.receiver import read_receiver_log
from jaxurban.metrics.gps import compute_gps
from jaxurban.studies.receiver import prediction
from jaxurban.studies.receiver.satellites import TrackedSatellites
from jaxurban.studies.receiver.scores import Row, agreements
from jaxurban.studies.receiver.scores import score as scores_of
from jaxurban.studies.receiver.track import Track
from jaxurban.studies.receiver.validate import paired
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
    again = validated(drive().assign(num_tracked=5), shifts_m=(100.0,))
    pd.testing.assert_frame_equal(again.epochs[names], seen().epochs[names])


def test_a_receiver_that_tracks_what_is_in_view_scores_high_and_a_shifted_city_does_not():
    of = score(found())
    assert of.spearman > 0.8
    assert of.spearman_low > 0.6
    assert of.auc > 0.9
    assert of.spearman_shifted < of.spearman_low
    assert not of.spearman_open > 0.3
    error = score(found(), "error_2d_m")
    assert error.spearman > 0.7
    assert np.isnan(error.auc)


@cache
def shuffled() -> ju.ReceiverValidation:
    told = np.random.default_rng(7).permutation(true_log().num_tracked.to_numpy())
    return validated(true_log().assign(num_tracked=told))


def test_a_shuffled_log_scores_nothing():
    of = score(shuffled())
    assert abs(of.spearman) < 0.3
    assert abs(of.auc - 0.5) < 0.15
    assert of.spearman_low < 0 < of.spearman_high


@pytest.mark.slow
def test_the_intervals_of_shuffled_pieces_cover_nothing_about_as_often_as_they_say():
    rng, row = np.random.default_rng(3), Row("num_tracked", "num_visible", 25.0)
    pieces, is_covered = found().pieces.assign(block=lambda table: table.piece), []
    for _ in range(60):
        told = rng.permutation(pieces.num_tracked.to_numpy())
        made = scores_of(agreements(pieces.assign(num_tracked=told), row, SETTINGS), 0)
        is_covered.append([made["spearman"].low < 0 < made["spearman"].high, made["auc"].low < 0.5 < made["auc"].high])
    assert (np.mean(is_covered, axis=0) > 0.87).all()  # 0.95 less three standard errors


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
    made = prediction.predict(task, track, (), lambda *_, **__: None)
    epoch, s = np.nonzero(made.is_above)
    in_sight = made.is_seen[0, epoch, s]
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
    assert tracked.auc_low > tracked.auc_shifted
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
    assert difference.value == pytest.approx(score(shuffled()).spearman - score(found()).spearman)
    assert difference.high < 0
    other = paired(found(), found(), predictions=(None, "gdop"))
    gdop = found().scores.query("witness == 'num_tracked' and prediction == 'gdop'").spearman.item()
    assert other.value == pytest.approx(gdop - score(found()).spearman)
    with pytest.raises(InputError, match="different logs or pieces"):
        paired(found(), replace(found(), settings=replace(SETTINGS, piece_m=50.0)))


def test_a_shift_looks_ahead_along_the_track_and_joins_its_ends():
    track = Track.of(read_receiver_log(true_log()), GRID, SETTINGS.sky_step_s)
    ahead = track.shifted(100.0)
    apart_m = (track.along_m[ahead] - track.along_m) % track.length_m
    np.testing.assert_allclose(apart_m, 100.0, atol=7.0)
    np.testing.assert_array_equal(track.shifted(0.0), np.arange(len(ahead)))


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
    "wrong", [{"block_m": 10.0}, {"sky_step_s": 900.0}, {"shifts_m": (0.0,)}, {"piece_m": -1.0}, {"seed": -1}]
)
def test_settings_that_make_no_sense_name_themselves(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        ju.ReceiverSettings(**wrong)
