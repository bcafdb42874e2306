"""A log with a row a satellite: what is judged, how it is scored, and that nothing wrong is praised."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pandas as pd
import pytest
import shapely
from scipy.stats import mannwhitneyu

import jaxurban as ju
from jaxurban.kernels.shadows.sweep import ENTRY_STEPS
from jaxurban.maps.run import grid_of, load_city
from jaxurban.satellites.walk import Ground
from jaxurban.studies.receiver import agreement, displaced, rivals
from jaxurban.studies.receiver.agreement import headings_rad, verdict_of
from jaxurban.studies.receiver.displaced import displacements, near_by, peaks
from jaxurban.studies.receiver.scores import aucs, drawn_blocks, levels_of
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays
from tests.made_agreement import made
from tests.receiver_logs import scenario
from tests.satellite_logs import (
    FALSE_PRAISE,
    SETTINGS,
    found,
    heard,
    hidden_by_outlines,
    is_praised,
    wrong_margins,
)


def validated(log: pd.DataFrame, **settings) -> ju.studies.ReceiverValidation:
    """Return a validation of few displaced cities, with a small field."""
    chosen = replace(SETTINGS, **{"num_displaced": 1, **settings})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(displaced, "AROUND_M", 4.0)
        return ju.studies.validate(scenario(), log, chosen, progress=False)


def by_pairs(is_seen: np.ndarray, cn0: np.ndarray, group: np.ndarray) -> float:
    """Return the AUC over pairs of one group, one pair after the other."""
    wins = [
        float(cn0[i] > cn0[j]) + 0.5 * float(cn0[i] == cn0[j])
        for i, j in product(np.flatnonzero(is_seen), np.flatnonzero(~is_seen))
        if group[i] == group[j]
    ]
    return float(np.mean(wins))


def test_aucs_are_those_of_all_pairs_of_scipy_and_of_draws_written_out():
    rng = np.random.default_rng(0)
    is_seen, cn0 = rng.random(90) < 0.4, np.round(rng.normal(35, 5, 90))
    group, block = rng.integers(0, 4, 90), rng.integers(0, 9, 90)
    level = levels_of(pd.Series(cn0))
    weights = drawn_blocks(np.arange(9), seed=1)[1][:4]
    pooled, within = (
        aucs(is_seen, level, block, weights),
        aucs(is_seen, level, block, weights, group),
    )
    of_scipy = mannwhitneyu(cn0[is_seen], cn0[~is_seen]).statistic / (
        is_seen.sum() * (~is_seen).sum()
    )
    assert pooled[0] == pytest.approx(of_scipy, abs=1e-12)
    for draw, counts in enumerate(weights.astype(int)):
        rows = np.repeat(np.arange(90), counts[block])
        assert pooled[draw] == pytest.approx(
            by_pairs(is_seen[rows], cn0[rows], np.zeros(len(rows))), abs=1e-12
        )
        assert within[draw] == pytest.approx(
            by_pairs(is_seen[rows], cn0[rows], group[rows]), abs=1e-12
        )


def test_what_is_all_seen_has_no_auc():
    assert np.isnan(aucs(np.ones(5, bool), np.arange(5), np.zeros(5, int), np.ones((1, 1)))[0])


@pytest.mark.slow
def test_rows_are_seen_as_a_ray_at_a_time_through_the_outlines_says():
    rows, epochs = found().satellites.rows, found().epochs
    city, turn_rad = load_city(scenario()), grid_of(scenario()).convergence_rad(-73.9965, 40.758)
    outlines = city.buildings.polygons, city.buildings.height_m
    chosen = rows[rows.is_judged].sample(300, random_state=0)
    hidden = [
        hidden_by_outlines(
            *outlines,
            epochs.x_m[row.epoch],
            epochs.y_m[row.epoch],
            np.radians(row.azimuth_deg) - turn_rad,
            np.radians(row.elevation_deg),
        )
        for row in chosen.itertuples()
    ]
    assert 0.2 < np.mean(hidden) < 0.8
    assert (
        np.mean(chosen.is_seen.to_numpy() == ~np.array(hidden)) > 0.9
    )  # cells of 5 m, 2 m up between walls
    np.testing.assert_array_equal(chosen.margin_m > 0, chosen.is_seen)


@pytest.mark.slow
def test_a_stated_radius_judges_rays_that_stay_so_near_to_the_track():
    """A witness of its own: the distance to the places of each point along a ray, a metre apart."""
    rows, epochs = validated(heard(), known=150.0).satellites.rows, found().epochs
    top_m = load_city(scenario()).buildings.height_m.max()
    turn_rad = grid_of(scenario()).convergence_rad(-73.9965, 40.758)
    places = shapely.MultiPoint(epochs[["x_m", "y_m"]].to_numpy())
    for row in rows.sample(60, random_state=1).itertuples():
        away_m = np.arange(0, (top_m - 2.0) / np.tan(np.radians(row.elevation_deg)))
        azimuth_rad = np.radians(row.azimuth_deg) - turn_rad
        x_m, y_m = epochs.x_m[row.epoch], epochs.y_m[row.epoch]
        points = shapely.points(
            x_m + away_m * np.sin(azimuth_rad), y_m + away_m * np.cos(azimuth_rad)
        )
        farthest_m = shapely.distance(points, places).max()
        assert (
            row.is_known == (farthest_m <= 150.0) or abs(farthest_m - 150.0) < 3.0
        )  # a disc has 64 sides
    assert 0.1 < rows.is_known.mean() < 0.9


@pytest.mark.slow
def test_a_receiver_that_hears_what_the_city_leaves_open_is_believed():
    of = found().satellites
    assert of.score().auc_low > 0.8
    assert of.score().within_low > 0.8
    assert of.score().auc > of.displaced.auc.max() + 0.1
    assert of.peak["within_95_m"] <= 10.0  # two cells
    assert "The margin to the shadow's edge and the elevation predict" in of.verdict
    assert set(of.scores.which) == {"all", "received", "E", "G", "unguarded"}
    assert of.score("E").rows + of.score("G").rows == of.score().rows
    assert of.strong_dbhz == of.rows[of.rows.is_judged].cn0_dbhz.median()
    table = of.rivals.set_index("model").log_loss
    assert (
        table["margin"] < table["street"] <= table["constant"] == pytest.approx(np.log(2), abs=0.01)
    )


@pytest.mark.slow
def test_what_is_judged_follows_from_place_and_direction_alone():
    rows = found().satellites.rows
    rng = np.random.default_rng(1)
    shuffled = heard().assign(cn0_dbhz=rng.permutation(heard().cn0_dbhz))
    of_other = validated(shuffled).satellites.rows
    np.testing.assert_array_equal(of_other.is_judged, rows.is_judged)
    hides = rows[~rows.is_known & ~rows.is_seen]
    assert len(hides) > 100  # a known roof hides them, and they are left out all the same
    assert not hides.is_judged.any()
    counts = found().satellites.counts
    assert counts["unknown"] == (~rows.is_known).sum()
    assert counts["judged"] + counts["unknown"] + counts["inside"] == counts["rows"] == len(rows)
    assert "not judged: their rays leave" in repr(found())


@pytest.mark.slow
def test_places_in_a_building_are_left_out_and_counted():
    city = load_city(scenario())
    lon, lat = grid_of(scenario()).lonlat_of_xy(
        *shapely.get_coordinates(city.buildings.polygons[20].centroid)[0]
    )
    log = heard()
    is_there = log.utc <= log.utc.unique()[9]
    log = log.assign(
        lon_deg=log.lon_deg.where(~is_there, lon), lat_deg=log.lat_deg.where(~is_there, lat)
    )
    of = validated(log).satellites
    inside = of.rows[of.rows.epoch < 10]
    assert inside.is_inside.all()
    assert not inside.is_judged.any()
    assert inside.margin_m.isna().all()
    assert of.counts["inside"] == inside.is_known.sum() > 0


@pytest.mark.slow
def test_a_shuffled_log_is_not_praised():
    rng = np.random.default_rng(3)
    of = validated(heard().assign(cn0_dbhz=rng.permutation(heard().cn0_dbhz))).satellites
    assert abs(of.score().auc - 0.5) < 0.1
    assert of.verdict.startswith("It is not shown")


@pytest.mark.slow
def test_legs_change_no_row(monkeypatch):
    monkeypatch.setattr(agreement, "LEG_CELLS", 400)
    rows = validated(heard()).satellites.rows
    pd.testing.assert_frame_equal(rows, found().satellites.rows)


@pytest.mark.slow
def test_a_receiver_that_stands_is_judged_without_a_verdict_and_reported(tmp_path):
    log = heard().assign(lon_deg=heard().lon_deg.iloc[0], lat_deg=heard().lat_deg.iloc[0])
    standing = validated(log)
    of = standing.satellites
    assert of.counts["num_blocks"] == 1
    assert of.verdict.startswith("The track is too short for a verdict")
    assert np.isnan(list(of.peak.values())).all()
    assert of.rivals.log_loss.isna().all()
    assert "nan" not in repr(of)
    standing.save(tmp_path)
    assert "nan" not in (tmp_path / "report.md").read_text()


def test_a_log_in_which_nothing_is_received_is_one_sentence():
    with pytest.raises(ju.InputError, match=r"of which 0 are received, and 100 are needed"):
        validated(heard().assign(cn0_dbhz=0.0))


@pytest.mark.slow
def test_counts_of_judged_rows_come_second():
    rows = found().satellites.rows
    judged = rows[rows.is_judged]
    first = judged.epoch.iloc[0]
    of_first = judged[judged.epoch == first]
    epochs = found().epochs
    assert epochs.num_visible[first] == of_first.is_seen.sum()
    assert epochs.num_tracked[first] == (of_first.cn0_dbhz > 0).sum()
    assert epochs.num_visible.isna().sum() == len(epochs) - judged.epoch.nunique()
    assert list(found().main.witness) == ["num_tracked"]


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
    of = found().satellites
    assert of.counts["num_blocks"] == of.rows[of.rows.is_judged].block.nunique()
    assert of.block_lengths.num_blocks.tolist() == [
        (of.rows[of.rows.is_judged].block // times).nunique() for times in (1, 2, 4)
    ]
    of_one, of_map = of.block_lengths.iloc[0], of.rivals.set_index("model").loc[rivals.MAP]
    assert (
        of_one[["gain", "gain_low", "gain_high"]].tolist()
        == of_map[["gain", "gain_low", "gain_high"]].tolist()
    )


def test_a_block_alone_has_no_loss():
    assert np.isnan(rivals.losses(np.ones((9, 1)), np.arange(9) < 5, np.zeros(9, int))).all()


def gap_at(x_m: float, side: int = 40) -> Ground:
    """Return flat ground of cells of 1 m with a roof of 20 m, 8 m east of its middle, and no data from x_m on."""
    grid = Grid("EPSG:32618", 1.0, 0, 0, side, side)
    roof_m, has_data = np.zeros(grid.shape, np.float32), np.ones(grid.shape, bool)
    roof_m[:, side // 2 + 8] = 20.0
    has_data[:, int(x_m) :] = False
    return Ground(grid, roof_m, None, has_data, 2.0)


@pytest.mark.slow
def test_a_ray_that_crosses_cells_without_data_before_it_is_above_all_roofs_is_unknown():
    places = np.full(5, 20.5)
    azimuth_rad, elevation_rad = (
        np.radians([90.0, 90.0, 90.0, 270.0, 90.0]),
        np.radians([50.0, 60.0, 70.0, 10.0, 85.0]),
    )
    rays = Rays(places, places, azimuth_rad, elevation_rad)
    climb_m = 9.5 * np.tan(elevation_rad)  # to the first cell without data
    np.testing.assert_array_equal(
        gap_at(30).crosses_gap(rays, 18.0), (climb_m < 18.0) & (azimuth_rad < np.pi)
    )
    assert gap_at(20).crosses_gap(rays, 18.0).all()  # they begin there
    assert not replace(gap_at(30), has_data=None).crosses_gap(rays, 18.0).any()


@pytest.mark.slow
def test_rows_over_cells_without_data_are_not_judged(monkeypatch):
    around, from_m = Ground.around, found().epochs.x_m.quantile(0.8)

    def with_gap(*args) -> Ground:
        ground = around(*args)
        x_m = ground.grid.x_min_m + ground.grid.resolution_m * (
            np.arange(ground.grid.num_cols) + 0.5
        )
        return replace(ground, has_data=np.broadcast_to(x_m < from_m, ground.grid.shape))

    monkeypatch.setattr(Ground, "around", with_gap)
    of, before = validated(heard()).satellites, found().satellites.rows
    x_m = found().epochs.x_m.to_numpy()[before.epoch]
    assert not of.rows.is_judged[x_m > from_m + 5.0].any()
    is_west = (
        before.is_judged
        & (x_m < from_m - 5.0)
        & (before.azimuth_deg > 200)
        & (before.azimuth_deg < 320)
    )
    assert is_west.sum() > 50
    assert of.rows.is_judged[is_west].all()
    assert of.displaced.rows.max() < found().satellites.displaced.rows.max()


def test_a_margin_does_not_depend_on_roofs_that_are_elsewhere():
    ground = gap_at(40, side=400)
    taller_m = ground.roof_m.copy()
    taller_m[0, 0] = 300.0
    places, east = np.full(40, 200.5), np.full(40, np.pi / 2)
    rays = Rays(places, places, east, np.radians(np.linspace(5.0, 88.0, 40)))
    margin_m = ground.margins_m(rays)
    np.testing.assert_array_equal(margin_m, replace(ground, roof_m=taller_m).margins_m(rays))
    expected_m = 2.0 + (8 - ENTRY_STEPS) * np.tan(rays.elevation_rad) - 20.0
    np.testing.assert_allclose(margin_m, np.where(expected_m < 60.0, expected_m, np.inf), atol=1e-3)


@pytest.mark.slow
def test_a_verdict_says_why_there_is_none():
    parts = made().scores, made().displaced, made().rivals
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
    of, epochs = found().satellites, found().epochs
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
def test_the_horizon_of_a_place_is_that_of_its_sky():
    city, mask_deg = load_city(scenario()), scenario().gps.mask_deg
    for of in found().satellites.skies:
        here = ju.sky(city, (of.lon_deg, of.lat_deg), 2.0, gps=ju.Gps(mask_deg=mask_deg))
        np.testing.assert_allclose(of.horizon_deg, here.horizon_deg, atol=1e-9)
        assert np.nanmax(of.horizon_deg) > mask_deg
