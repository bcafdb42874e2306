"""The evidence of a log: what is wrong is not praised; displaced cities, rivals, and what the command prints."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

from benchmarks.receiver import evidence as command
from benchmarks.receiver import rivals
from benchmarks.receiver.displaced import displacements, near_by, peaks
from benchmarks.receiver.evidence import headings_rad, text_of, verdict_of
from benchmarks.receiver.pictures import plot_displacement
from jaxurban.receivers.validation.scores import drawn_blocks
from jaxurban.receivers.walk import LegSurface
from tests.benchmarks.made_evidence import (
    FALSE_PRAISE,
    evidence,
    few_displaced,
    is_praised,
    made_evidence,
    wrong_margins,
)
from tests.made_agreement import made
from tests.satellite_logs import heard


@pytest.mark.slow
def test_a_receiver_that_hears_what_the_city_leaves_open_is_believed():
    of = evidence().of
    assert of.score().auc_low > 0.8
    assert of.score().within_low > 0.8
    assert of.score().auc > evidence().displaced.auc.max() + 0.1
    assert evidence().peak["within_95_m"] <= 10.0  # two cells
    assert "The margin to the shadow's edge and the elevation predict" in evidence().verdict
    assert set(of.scores.which) == {"all", "received", "E", "G", "unguarded"}
    assert of.score("E").rows + of.score("G").rows == of.score().rows
    assert of.strong_dbhz == of.rows[of.rows.is_judged].cn0_dbhz.median()
    table = evidence().rivals.set_index("model").log_loss
    assert (
        table["margin"] < table["street"] <= table["constant"] == pytest.approx(np.log(2), abs=0.01)
    )


@pytest.mark.slow
def test_a_shuffled_log_is_not_praised():
    rng = np.random.default_rng(3)
    found = few_displaced(heard().assign(cn0_dbhz=rng.permutation(heard().cn0_dbhz)))
    assert abs(found.of.score().auc - 0.5) < 0.1
    assert found.verdict.startswith("It is not shown")


def test_a_street_has_the_direction_of_twenty_metres_each_way_and_keeps_it_while_the_car_stands():
    east = np.concatenate(
        [np.arange(0, 100, 5.0), np.full(10, 95.0) + 0.1 * np.arange(10) % 0.3, np.full(20, 95.0)]
    )
    north = np.concatenate([np.zeros(30), np.arange(5, 105, 5.0)])
    heading_deg = np.degrees(headings_rad(east, north))
    np.testing.assert_allclose(heading_deg[:15], 90.0, atol=1e-6)
    np.testing.assert_allclose(
        heading_deg[20:30], heading_deg[20], atol=1.0
    )  # it stands before the corner
    np.testing.assert_allclose(heading_deg[-10:], 0.0, atol=1e-6)
    assert heading_deg[29] == pytest.approx(45.0, abs=10.0)


def test_displacements_are_even_over_the_ring_and_the_field_is_a_disc_of_steps():
    away_m = np.hypot(*displacements(4000, seed=0).T)
    assert away_m.min() >= 80.0
    assert away_m.max() <= 450.0
    share = (450.0**2 - 300.0**2) / (450.0**2 - 80.0**2)
    assert np.mean(away_m > 300.0) == pytest.approx(share, abs=0.03)
    np.testing.assert_array_equal(displacements(3, seed=5), displacements(3, seed=5))
    assert len(near_by()) == sum(
        x * x + y * y <= 400 for x in range(-20, 21) for y in range(-20, 21)
    )
    assert near_by()[0].tolist() == [0.0, 0.0]


def test_a_draw_has_its_peak_where_it_is_highest_and_none_where_nothing_is_known_or_all_is_alike():
    unknown = np.nan
    values = np.array(
        [[0.6, 0.1, unknown, 0.5], [0.7, 0.2, unknown, 0.5], [0.5, unknown, unknown, unknown]]
    )
    np.testing.assert_array_equal(
        peaks(values, np.array([0.0, 2.0, 4.0])), [2.0, 2.0, np.nan, np.nan]
    )


@pytest.mark.slow
def test_blocks_without_a_row_are_none():
    block, weights = drawn_blocks(np.array([7, 3, 7, 90]), seed=0)
    np.testing.assert_array_equal(block, [1, 0, 1, 2])
    assert weights.shape[1] == 3
    of = evidence().of
    assert evidence().num_blocks == of.rows[of.rows.is_judged].block.nunique()
    assert evidence().block_lengths.num_blocks.tolist() == [
        (of.rows[of.rows.is_judged].block // times).nunique() for times in (1, 2, 4)
    ]
    of_one, of_map = (
        evidence().block_lengths.iloc[0],
        evidence().rivals.set_index("model").loc[rivals.MAP],
    )
    assert (
        of_one[["gain", "gain_low", "gain_high"]].tolist()
        == of_map[["gain", "gain_low", "gain_high"]].tolist()
    )


def test_a_block_alone_has_no_loss():
    assert np.isnan(rivals.losses(np.ones((9, 1)), np.arange(9) < 5, np.zeros(9, int))).all()


@pytest.mark.slow
def test_a_verdict_says_why_there_is_none():
    parts = made().scores, made_evidence().displaced, made_evidence().rivals
    unknown = made().scores.assign(auc_low=np.nan)
    assert verdict_of(unknown, *parts[1:], 40).startswith(
        "There is no verdict: on these 40 blocks of track too few"
    )
    assert verdict_of(*parts, 7).startswith("The track is too short for a verdict")


def test_left_out_blocks_make_the_loss_of_noise_no_better_than_a_constant():
    rng = np.random.default_rng(4)
    block = np.repeat(np.arange(20), 10)
    is_strong, noise = rng.random(200) < 0.5, rng.normal(size=(200, 30))
    one = np.ones((200, 1))
    of_noise, of_none = (
        rivals.losses(features, is_strong, block).mean()
        for features in (np.hstack([one, noise]), one)
    )
    assert of_noise > of_none > 0.68


@cache
def judged() -> tuple[pd.DataFrame, np.ndarray, np.ndarray]:
    """Return the judged rows, their elevation and the angle to the street."""
    of, epochs = evidence().of, evidence().of.epochs
    rows = of.rows[of.rows.is_judged]
    off_rad = (
        np.radians(rows.azimuth_deg)
        - headings_rad(*epochs[["x_m", "y_m"]].to_numpy().T)[rows.epoch]
    )
    return rows, np.radians(rows.elevation_deg.to_numpy(float)), off_rad.to_numpy()


@pytest.mark.slow
def test_shifted_and_swapped_predictions_are_seldom_praised():
    rows, elevation_rad, off_rad = judged()
    rng = np.random.default_rng(0)
    margins = (wrong_margins(rows, rng, step_s=4.0) for _ in range(200))
    praised = [is_praised(rows, margin_m, elevation_rad, off_rad) for margin_m in margins]
    assert is_praised(rows, rows.margin_m.to_numpy(), elevation_rad, off_rad)
    assert sum(praised) <= FALSE_PRAISE


@pytest.mark.slow
def test_a_receiver_that_stands_has_no_verdict():
    log = heard().assign(lon_deg=heard().lon_deg.iloc[0], lat_deg=heard().lat_deg.iloc[0])
    standing = few_displaced(log)
    assert standing.num_blocks == 1
    assert standing.verdict.startswith("The track is too short for a verdict")
    assert np.isnan(list(standing.peak.values())).all()
    assert standing.rivals.log_loss.isna().all()
    assert "nan" not in text_of(standing)


@pytest.mark.slow
def test_displaced_cities_have_fewer_rows_where_cells_lack_data(monkeypatch):
    around, from_m = LegSurface.around, evidence().of.epochs.x_m.quantile(0.8)

    def with_gap(*args) -> LegSurface:
        ground = around(*args)
        x_m = ground.grid.x_min_m + ground.grid.resolution_m * (
            np.arange(ground.grid.num_cols) + 0.5
        )
        return replace(ground, has_data=np.broadcast_to(x_m < from_m, ground.grid.shape))

    monkeypatch.setattr(LegSurface, "around", with_gap)
    found = few_displaced(heard())
    assert found.displaced.rows.max() < evidence().displaced.rows.max()


def test_every_number_is_printed_with_its_interval_and_a_part_or_an_edge_is_named():
    text = text_of(made_evidence())
    assert text.startswith("Maps and receiver agree.\n")
    assert (
        "| all judged | 342 | 0.957 | 0.842 (0.811 to 0.873) | 0.742 (0.711 to 0.773) | 6 |" in text
    )
    assert "| GLONASS | 342 | 0.957 | 0.847 (0.816 to 0.878) |" in text
    assert "| in its place | 0.842 | 0.742 |" in text
    assert "| 9 of 9 displaced ones that could be scored, median | 0.567 | 0.467 |" in text
    assert "| most | 0.622 | 0.522 |" in text
    assert "| margin and elevation | 0.550 | 0.000 (-0.031 to 0.047) |" in text
    assert "| 2 | 0 | 5.7 | 1 (0.94 to 1.06) |" in text
    assert "| 100 | 6 | 0.010 (-0.030 to 0.050) |" in text
    assert "| 200 | 3 | 0.010 |" in text
    assert "one of" not in text
    assert "edge of the search" not in text
    peak = dict.fromkeys(made_evidence().peak, np.nan)
    rules = made_evidence().rivals.assign(gain=-0.0001)
    other = text_of(replace(made_evidence(), every=3, peak=peak, rivals=rules))
    assert "take one of 3 epochs of this long log" in other
    assert "None: that takes 8 blocks of track" in other
    assert "-0.000" not in other
    edge = replace(made_evidence(), peak=made_evidence().peak | {"east_m": 40.0})
    assert "edge of the search" in text_of(edge)


def test_the_picture_of_displaced_cities_names_what_it_shows():
    figure = plot_displacement(made_evidence())
    said = " ".join(text.get_text() for text in figure.findobj(Text))
    labels = ("city moved east (m)", "AUC", "the city in its place: 0.84", "9 cities")
    assert [label for label in labels if label not in said] == []
    unknown = {
        name: getattr(made_evidence(), name).assign(auc=np.nan)
        for name in ("displaced", "field", "scales")
    }
    peak = dict.fromkeys(made_evidence().peak, np.nan)
    assert plot_displacement(replace(made_evidence(), **unknown, peak=peak)).axes


def test_the_command_refuses_a_log_in_one_sentence(tmp_path, capsys):
    log = tmp_path / "log.csv"
    log.write_text("utc,lon_deg,lat_deg\n2020-04-27T16:00:00Z,-73.9,40.7\n")
    assert command.main(["sample:nihonbashi", str(log)]) == 2
    assert "satellite and cn0_dbhz" in capsys.readouterr().err
