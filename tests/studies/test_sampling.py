"""Instances: what the seed decides, where places lie, what weights they carry, and the strata of the maps."""

import numpy as np
import pandas as pd
import pytest
import shapely
from scipy.ndimage import label

from jaxurban.io.tables import write_table
from jaxurban.maps.scenario_files import read_scenario
from jaxurban.metrics.weights import Weights
from jaxurban.studies.montecarlo import sampling
from jaxurban.studies.montecarlo.sampling import STRATA, read_instances, sample_instances, strata_of
from jaxurban.world.land_cover import LandCover
from tests.made_maps import made_maps


@pytest.fixture(scope="module")
def maps():
    """Return maps whose eastern half is open and whose southern edge has no data."""
    made = made_maps(150, 120)
    made.ds["roof"][:, 60:] = 0.0
    made.ds["obstacle"][:, :, 60:] = 0
    made.ds["has_data"][:5] = False
    return made


@pytest.fixture(scope="module")
def instances(maps) -> pd.DataFrame:
    return sample_instances(maps, 60, seed=3)


def test_the_same_seed_gives_the_same_instances_and_more_of_them_begin_alike(maps, instances):
    pd.testing.assert_frame_equal(instances, sample_instances(maps, 60, seed=3))
    few = sample_instances(maps, 20, seed=3)
    pd.testing.assert_frame_equal(few, instances[instances.instance < 20].reset_index(drop=True))
    assert not few.equals(sample_instances(maps, 20, seed=4))


def test_further_instances_are_drawn_with_the_weights_that_a_file_has(maps, instances, tmp_path):
    assert sampling.weights_setting(instances) == ""  # each has its own, drawn
    few = sample_instances(maps, 12, seed=3, weights=[Weights(gps=3.0), Weights(risk=2.0)])
    setting = sampling.weights_setting(few)
    assert setting.startswith("study.weights=[{distance = 0.1, gps = 3, ")
    file = tmp_path / "city.toml"
    file.write_text('[region]\n[buildings]\nsource = "sample:lower-manhattan"\n')
    assert [each.risk for each in read_scenario(file, [setting]).study.weights] == [1.0, 2.0]


def test_places_are_free_at_every_altitude_and_the_same_at_each(maps, instances):
    by = instances.drop(columns=["altitude_m", "is_connected"]).groupby("instance")
    assert (by.nunique(dropna=False) == 1).all(axis=None)
    for end in ("start", "goal"):
        cells = maps.grid.cell_of_xy(
            instances[f"{end}_x_m"].to_numpy(), instances[f"{end}_y_m"].to_numpy()
        )
        assert all(maps.is_free(z)[cells].all() for z in maps.altitudes_m)
        assert (np.array(STRATA)[strata_of(maps)[cells]] == instances[f"{end}_stratum"]).all()


def test_straight_distances_lie_within_the_limits_of_their_range(maps, instances):
    diagonal_m = float(np.hypot(*maps.grid.shape)) * maps.grid.resolution_m
    away_m = np.hypot(
        instances.goal_x_m - instances.start_x_m, instances.goal_y_m - instances.start_y_m
    )
    np.testing.assert_allclose(instances.distance_m, away_m)
    for name, (low, high) in sampling.RANGES.items():
        share = away_m[instances.range == name] / diagonal_m
        assert len(share)
        assert share.between(low, high).all()


def test_kinds_take_turns(instances):
    at = instances[instances.altitude_m == 20]
    counts = at.groupby(["start_stratum", "goal_stratum", "range"]).size()
    assert counts.max() <= 3  # 60 instances, 48 kinds of which some are not to be had
    assert len(counts) >= 30
    assert set(at.time_of_day) == {"day", "night"}


def test_the_mark_of_connection_is_that_of_the_islands_of_free_cells(maps, instances):
    for altitude_m, at in instances.groupby("altitude_m"):
        islands, _ = label(maps.is_free(altitude_m))
        ends = [
            islands[maps.grid.cell_of_xy(at[f"{end}_x_m"], at[f"{end}_y_m"])]
            for end in ("start", "goal")
        ]
        assert ((ends[0] == ends[1]) == at.is_connected).all()


def test_dirichlet_shares_sum_to_one_with_distance_per_reference_length(instances):
    shares = instances[list(sampling.weight_columns(()))].to_numpy() * [5.0, 1, 1, 1, 1]
    np.testing.assert_allclose(shares.sum(axis=1), 1)
    assert (shares > 0).all()
    np.testing.assert_allclose(shares.mean(axis=0), 0.2, atol=0.08)


def test_given_weights_take_turns(maps):
    given = [Weights(), Weights(0.2, gps=1, lidar=2, population=3, risk=4)]
    found = sample_instances(maps, 3, altitudes_m=[60], weights=given)
    assert found.altitude_m.tolist() == [60, 60, 60]
    assert found.w_risk.tolist() == [1, 4, 1]
    assert found.w_distance.tolist() == [0.1, 0.2, 0.1]


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_instances_survive_their_file(instances, tmp_path, suffix):
    found = read_instances(write_table(instances, tmp_path / f"instances{suffix}"))
    is_exact = suffix == ".parquet" or pd.__version__ >= "3"  # CSV to the last bit but one before
    pd.testing.assert_frame_equal(
        found[instances.columns], instances, check_dtype=False, check_exact=is_exact, rtol=1e-15
    )


def around(mask: np.ndarray, row: int, col: int, half: int) -> np.ndarray:
    return mask[max(0, row - half) : row + half + 1, max(0, col - half) : col + half + 1]


def test_every_cell_lies_in_the_stratum_that_its_surroundings_define(maps):
    roof_m, strata = maps.m("roof"), strata_of(maps)
    assert {*np.unique(strata[5:])} == {
        STRATA.index(each) for each in {*STRATA} - {"water", "park"}
    }
    assert (strata[:5] == sampling.NO_STRATUM).all()
    rng = np.random.default_rng(1)
    for row, col in zip(rng.integers(5, 150, 300), rng.integers(0, 120, 300), strict=True):
        near, far = around(roof_m, row, col, 12), around(roof_m, row, col, 25)
        if (near >= sampling.HIGH_RISE_M).mean() >= 0.1:
            wanted = "high-rise"
        elif (near > 0).mean() >= 0.1:
            wanted = "low-rise"
        else:
            wanted = "open" if far.any() else "wide-open"
        assert STRATA[strata[row, col]] == wanted


def test_water_and_parks_are_the_cells_whose_centre_they_hold_and_places_lie_in_them(maps):
    x_m, y_m = maps.grid.x_min_m, maps.grid.y_min_m
    river, park = (
        shapely.box(x_m, y_m, x_m + 304, y_m + 1500),
        shapely.box(x_m + 294, y_m + 96, x_m + 700, y_m + 504),
    )
    strata, plain = strata_of(maps, LandCover(river, park)), strata_of(maps)
    in_river, in_park = np.zeros((2, *maps.grid.shape), bool)
    in_river[5:, :30] = True  # centres at 5, 15, ... 295 m; water wins over a park
    in_park[10:50, 30:70] = True
    assert (strata[in_river] == STRATA.index("water")).all()
    assert (strata[in_park] == STRATA.index("park")).all()
    assert np.array_equal(strata[~(in_river | in_park)], plain[~(in_river | in_park)])
    found = sample_instances(maps, 60, cover=LandCover(river, park))
    for name, shape in (("water", river), ("park", park)):
        for end in ("start", "goal"):
            at = found[found[f"{end}_stratum"] == name]
            assert len(at)
            assert shapely.contains_xy(shape, at[f"{end}_x_m"], at[f"{end}_y_m"]).all()
