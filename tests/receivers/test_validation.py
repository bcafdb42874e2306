"""A log with a row a satellite: what is judged, how it is scored, and that nothing wrong is praised."""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
import shapely
from scipy.stats import mannwhitneyu

import jaxurban as ju
from jaxurban.kernels.shadows.sweep import ENTRY_STEPS
from jaxurban.maps.run import load_city, scenario_grid
from jaxurban.receivers.validation import drive
from jaxurban.receivers.validation.scores import aucs, drawn_blocks, levels_of
from jaxurban.receivers.walk import LegSurface
from jaxurban.typing import ReceiverValidation
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays
from tests.receivers.receiver_logs import scenario
from tests.satellite_logs import found, heard, hidden_by_outlines


def validated(log: pd.DataFrame, **settings) -> ReceiverValidation:
    chosen = ju.studies.ReceiverSettings(**settings)
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
    rows, epochs = found().rows, found().epochs
    city, turn_rad = (
        load_city(scenario()),
        scenario_grid(scenario()).convergence_rad(-73.9965, 40.758),
    )
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
    rows, epochs = validated(heard(), known=150.0).rows, found().epochs
    top_m = load_city(scenario()).buildings.height_m.max()
    turn_rad = scenario_grid(scenario()).convergence_rad(-73.9965, 40.758)
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
def test_what_is_judged_follows_from_place_and_direction_alone():
    rows = found().rows
    rng = np.random.default_rng(1)
    shuffled = heard().assign(cn0_dbhz=rng.permutation(heard().cn0_dbhz))
    of_other = validated(shuffled).rows
    np.testing.assert_array_equal(of_other.is_judged, rows.is_judged)
    hides = rows[~rows.is_known & ~rows.is_seen]
    assert len(hides) > 100  # a known roof hides them, and they are left out all the same
    assert not hides.is_judged.any()
    counts = found().summary
    assert counts["unknown"] == (~rows.is_known).sum()
    assert counts["judged"] + counts["unknown"] + counts["inside"] == counts["rows"] == len(rows)
    assert "not judged: their rays leave" in repr(found())


@pytest.mark.slow
def test_places_in_a_building_are_left_out_and_counted():
    city = load_city(scenario())
    lon, lat = scenario_grid(scenario()).lonlat_of_xy(
        *shapely.get_coordinates(city.buildings.polygons[20].centroid)[0]
    )
    log = heard()
    is_there = log.utc <= log.utc.unique()[9]
    log = log.assign(
        lon_deg=log.lon_deg.where(~is_there, lon), lat_deg=log.lat_deg.where(~is_there, lat)
    )
    of = validated(log)
    inside = of.rows[of.rows.epoch < 10]
    assert inside.is_inside.all()
    assert not inside.is_judged.any()
    assert inside.margin_m.isna().all()
    assert inside.is_known.any()
    assert (
        of.summary["inside"] == of.rows[of.rows.is_inside].is_known.sum()
    )  # the drive cuts a corner elsewhere


@pytest.mark.slow
def test_legs_change_no_row(monkeypatch):
    monkeypatch.setattr(drive, "LEG_CELLS", 400)
    rows = validated(heard()).rows
    pd.testing.assert_frame_equal(rows, found().rows)


@pytest.mark.slow
def test_a_receiver_that_stands_is_judged_without_an_interval_and_reported(tmp_path):
    log = heard().assign(lon_deg=heard().lon_deg.iloc[0], lat_deg=heard().lat_deg.iloc[0])
    standing = validated(log)
    assert standing.summary["num_blocks"] == 1
    assert "The track has 1 blocks of 50 m, and an interval takes 8" in repr(standing)
    assert "nan" not in repr(standing)
    standing.save(tmp_path)
    assert "nan" not in (tmp_path / "report.md").read_text()


def test_a_log_in_which_nothing_is_received_is_one_sentence():
    with pytest.raises(ju.InputError, match=r"of which 0 are received, and 100 are needed"):
        validated(heard().assign(cn0_dbhz=0.0))


@pytest.mark.slow
def test_epochs_count_judged_rows():
    rows = found().rows
    judged = rows[rows.is_judged]
    first = judged.epoch.iloc[0]
    of_first = judged[judged.epoch == first]
    epochs = found().epochs
    assert epochs.num_visible[first] == of_first.is_seen.sum()
    assert epochs.num_heard[first] == (of_first.cn0_dbhz > 0).sum()
    assert epochs.num_visible.isna().sum() == len(epochs) - judged.epoch.nunique()


def gap_at(x_m: float, side: int = 40) -> LegSurface:
    """Return flat ground of cells of 1 m with a roof of 20 m, 8 m east of its middle, and no data from x_m on."""
    grid = Grid("EPSG:32618", 1.0, 0, 0, side, side)
    roof_m, has_data = np.zeros(grid.shape, np.float32), np.ones(grid.shape, bool)
    roof_m[:, side // 2 + 8] = 20.0
    has_data[:, int(x_m) :] = False
    return LegSurface(grid, roof_m, None, has_data, 2.0)


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
    around, from_m = LegSurface.around, found().epochs.x_m.quantile(0.8)

    def with_gap(*args) -> LegSurface:
        ground = around(*args)
        x_m = ground.grid.x_min_m + ground.grid.resolution_m * (
            np.arange(ground.grid.num_cols) + 0.5
        )
        return replace(ground, has_data=np.broadcast_to(x_m < from_m, ground.grid.shape))

    monkeypatch.setattr(LegSurface, "around", with_gap)
    of, before = validated(heard()), found().rows
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
def test_the_horizon_of_a_place_is_that_of_its_sky():
    city, mask_deg = load_city(scenario()), scenario().gps.mask_deg
    for of in found().skies:
        here = ju.sky(city, (of.lon_deg, of.lat_deg), 2.0, gps=ju.Gps(mask_deg=mask_deg))
        np.testing.assert_allclose(of.horizon_deg, here.horizon_deg, atol=1e-9)
        assert np.nanmax(of.horizon_deg) > mask_deg


@pytest.mark.slow
def test_each_row_is_seen_hidden_or_unknown():
    rows = found().rows
    is_unknown = ~rows.is_known | rows.is_inside
    expected = np.where(is_unknown, "unknown", np.where(rows.margin_m > 0, "seen", "hidden"))
    np.testing.assert_array_equal(rows.state, expected)
    assert set(rows.state) == {"seen", "hidden", "unknown"}


@pytest.mark.parametrize("option", ["navigation", "reference"])
def test_navigation_and_reference_belong_to_a_receivers_own_log(option):
    with pytest.raises(ju.InputError, match="of a receiver's own log"):
        ju.studies.validate(scenario(), heard(), progress=False, **{option: "rover.nav"})


OUTSIDE = {
    r"^\d+ of the \d+ places of the .* outside .*let bounds of": lambda log: log.assign(
        lon_deg=log.lon_deg + 1
    ),
    "whether lon_deg and lat_deg are swapped": lambda log: log.assign(
        lon_deg=log.lat_deg, lat_deg=log.lon_deg
    ),
    "columns utc .* satellite and cn0_dbhz": lambda log: log.drop(columns="satellite"),
}


@pytest.mark.parametrize("sentence", OUTSIDE)
def test_a_log_outside_the_region_or_without_satellites_is_one_sentence(sentence):
    with pytest.raises(ju.InputError, match=sentence):
        validated(OUTSIDE[sentence](heard()))
