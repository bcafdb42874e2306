"""The sample with a receiver's log: its figures, and that it scores less where city, time or place is wrong."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from benchmarks.receiver.evidence import Evidence, evidence_of, headings_rad
from jaxurban.io.orbits import read_orbits
from jaxurban.io.samples import located
from jaxurban.maps.run import load_city, scenario_grid
from jaxurban.receivers.log_files import read_reference
from jaxurban.receivers.validation.rinex import angles_along
from tests.benchmarks.made_evidence import FALSE_PRAISE, few_displaced, is_praised, wrong_margins
from tests.satellite_logs import hidden_by_outlines

pytestmark = pytest.mark.slow
SAMPLE = "sample:nihonbashi"
LOG = f"{SAMPLE}/log.csv.gz"
FIELDS = ["utc", "lon_deg", "lat_deg", "satellite"]


@cache
def scenario() -> ju.Scenario:
    return ju.Scenario.from_toml(SAMPLE)


@cache
def table() -> pd.DataFrame:
    return pd.read_csv(located(LOG))


@cache
def found() -> Evidence:
    return evidence_of(scenario())


def test_the_sample_shows_that_the_sky_agrees():
    of, evidence = found().of, found()
    assert of.score().auc == pytest.approx(0.891, abs=0.003)
    assert of.score().within == pytest.approx(0.880, abs=0.003)
    assert of.score().auc_low > 0.85
    assert of.score().share == pytest.approx(0.76, abs=0.01)
    assert of.score("received").auc == pytest.approx(0.897, abs=0.003)
    assert of.score("unguarded").auc == pytest.approx(0.891, abs=0.003)
    assert of.score("unguarded").within == pytest.approx(0.862, abs=0.003)
    assert evidence.displaced.auc.median() < 0.65
    assert evidence.displaced.auc.max() < 0.80
    assert np.hypot(evidence.peak["east_m"], evidence.peak["north_m"]) <= 4.0
    assert evidence.peak["within_95_m"] <= 6.0
    assert evidence.peak["scale_low"] <= 1.0 <= evidence.peak["scale_high"]
    loss = evidence.rivals.set_index("model").log_loss
    assert (
        loss["margin and elevation"]
        < loss["margin"]
        < loss["seen or hidden"]
        < loss["street"]
        < loss["elevation"]
    )
    assert "The margin to the shadow's edge and the elevation predict" in evidence.verdict


def test_500_rows_are_seen_as_a_ray_at_a_time_through_the_outlines_says():
    rows, epochs = found().of.rows, found().of.epochs
    city, grid = load_city(scenario()), scenario_grid(scenario())
    turn_rad = grid.convergence_rad(*grid.centre_lonlat)
    near = shapely.STRtree(city.buildings.polygons)
    chosen = rows[rows.is_judged].sample(500, random_state=0)
    hidden = []
    for row in chosen.itertuples():
        at = epochs.x_m[row.epoch], epochs.y_m[row.epoch]
        around = near.query(shapely.Point(*at).buffer(1300.0))
        angles = np.radians(row.azimuth_deg) - turn_rad, np.radians(row.elevation_deg)
        hidden.append(
            hidden_by_outlines(
                city.buildings.polygons[around], city.buildings.height_m[around], *at, *angles
            )
        )
    assert np.mean(chosen.is_seen.to_numpy() == ~np.array(hidden)) > 0.98


@pytest.mark.parametrize(("east_m", "north_m"), [(50, 0), (0, 50), (-50, 0), (0, -50)])
def test_a_track_that_is_50_m_off_is_not_praised(east_m, north_m):
    lat_m = 111_000.0
    moved = table().assign(
        lon_deg=table().lon_deg + east_m / (lat_m * np.cos(np.radians(35.68))),
        lat_deg=table().lat_deg + north_m / lat_m,
    )
    evidence = few_displaced(moved, scenario())
    assert evidence.of.score().auc_high < found().of.score().auc_low
    assert evidence.verdict.startswith("It is not shown")


def test_shifted_and_swapped_predictions_are_seldom_praised():
    rows, epochs = found().of.rows, found().of.epochs
    rows = rows[rows.is_judged]
    off_rad = (
        np.radians(rows.azimuth_deg)
        - headings_rad(*epochs[["x_m", "y_m"]].to_numpy().T)[rows.epoch]
    )
    of = np.radians(rows.elevation_deg.to_numpy(float)), off_rad.to_numpy()
    rng = np.random.default_rng(0)
    praised = [is_praised(rows, wrong_margins(rows, rng, step_s=1.0), *of) for _ in range(200)]
    assert is_praised(rows, rows.margin_m.to_numpy(), *of)
    assert sum(praised) <= FALSE_PRAISE


@pytest.mark.data
def test_times_that_are_an_hour_off_are_not_praised_and_a_quarter_of_one_is(data_dir):
    folder = data_dir / "tokyo/nihonbashi-rinex"
    orbits = read_orbits(folder / "rover.nav")
    track = read_reference(folder / "reference.csv")
    for hours, low, high in (
        (0, 0.88, 0.90),
        (1, 0.65, 0.75),
        (-0.25, 0.82, 0.86),
    ):
        shift = pd.Timedelta(hours=hours)
        angles = angles_along(orbits, track.assign(utc=track.utc + shift))
        angles["utc"] = (angles.utc - shift).dt.strftime("%Y-%m-%dT%H:%M:%SZ")
        strengths = table()[[*FIELDS, "cn0_dbhz"]]
        angles = angles.drop(columns=["lon_deg", "lat_deg"])
        log = strengths.merge(angles, on=["utc", "satellite"])
        evidence = few_displaced(log[log.elevation_deg >= 5.0], scenario(), 200)
        assert evidence.verdict.startswith("The margin to the shadow's edge") == (abs(hours) < 1)
        assert low < evidence.of.score().auc < high
