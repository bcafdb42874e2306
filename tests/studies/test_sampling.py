"""Instances: what the seed decides, where places lie, what weights they carry, and files of them."""

import numpy as np
import pandas as pd
import pytest
import shapely
from scipy.ndimage import label

from jaxurban.errors import InputError
from jaxurban.io.tables import write_table
from jaxurban.metrics.weights import Weights
from jaxurban.studies.montecarlo.sampling import (
    RANGES,
    STRATA,
    read_instances,
    sample_instances,
    strata_of,
    weight_columns,
)
from jaxurban.world.city import LandCover
from tests.made_maps import made_maps


@pytest.fixture(scope="module")
def maps():
    made = made_maps(150, 120)
    made.ds["roof"][:, 60:] = 0.0
    made.ds["obstacle"][:, :, 60:] = 0
    return made


@pytest.fixture(scope="module")
def instances(maps) -> pd.DataFrame:
    return sample_instances(maps, 60, seed=3)


def test_the_same_seed_gives_the_same_instances_and_more_of_them_begin_alike(maps, instances):
    pd.testing.assert_frame_equal(instances, sample_instances(maps, 60, seed=3))
    few = sample_instances(maps, 20, seed=3)
    pd.testing.assert_frame_equal(few, instances[instances.instance < 20].reset_index(drop=True))
    assert not few.equals(sample_instances(maps, 20, seed=4))


def test_places_are_free_at_every_altitude_and_the_same_at_each(maps, instances):
    by = instances.drop(columns=["altitude_m", "is_connected"]).groupby("instance")
    assert (by.nunique(dropna=False) == 1).all(axis=None)
    for end in ("start", "goal"):
        cells = maps.grid.cell_of_xy(instances[f"{end}_x_m"].to_numpy(), instances[f"{end}_y_m"].to_numpy())
        assert all(maps.is_free(z)[cells].all() for z in maps.altitudes_m)
        assert (np.array(STRATA)[strata_of(maps)[cells]] == instances[f"{end}_stratum"]).all()


def test_water_and_parks_are_strata_where_the_land_cover_is_known(maps):
    grid = maps.grid
    lake = shapely.box(grid.x_max_m - 300, grid.y_min_m, grid.x_max_m, grid.y_max_m)
    park = shapely.box(grid.x_min_m, grid.y_max_m - 200, grid.x_min_m + 400, grid.y_max_m)
    found = sample_instances(maps, 60, cover=LandCover(lake, park))
    assert {"water", "park"} <= set(found.start_stratum) & set(found.goal_stratum)
    for name, shape in (("water", lake), ("park", park)):
        for end in ("start", "goal"):
            at = found[found[f"{end}_stratum"] == name]
            assert shapely.contains_xy(shape, at[f"{end}_x_m"], at[f"{end}_y_m"]).all()


def test_straight_distances_lie_within_the_limits_of_their_range(maps, instances):
    diagonal_m = float(np.hypot(*maps.grid.shape)) * maps.grid.resolution_m
    away_m = np.hypot(instances.goal_x_m - instances.start_x_m, instances.goal_y_m - instances.start_y_m)
    np.testing.assert_allclose(instances.distance_m, away_m)
    for name, (low, high) in RANGES.items():
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
        ends = [islands[maps.grid.cell_of_xy(at[f"{end}_x_m"], at[f"{end}_y_m"])] for end in ("start", "goal")]
        assert ((ends[0] == ends[1]) == at.is_connected).all()


def test_dirichlet_shares_sum_to_one_with_distance_per_reference_length(instances):
    shares = instances[list(weight_columns(()))].to_numpy() * [5.0, 1, 1, 1, 1]
    np.testing.assert_allclose(shares.sum(axis=1), 1)
    assert (shares > 0).all()
    np.testing.assert_allclose(shares.mean(axis=0), 0.2, atol=0.08)


def test_given_weights_take_turns(maps):
    given = [Weights(), Weights(0.2, gps=1, lidar=2, population=3, risk=4)]
    found = sample_instances(maps, 3, altitudes_m=[60], weights=given)
    assert found.altitude_m.tolist() == [60, 60, 60]
    assert found.w_risk.tolist() == [1, 4, 1]
    assert found.w_distance.tolist() == [0.1, 0.2, 0.1]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"num": 0}, "num must be a whole number from 1 up"),
        ({"weights": "uniform"}, "uniform"),
        ({"weights": []}, "at least one Weights"),
        ({"altitudes_m": [33]}, "33"),
        ({"altitudes_m": [60, 60]}, "twice"),
        ({"altitudes_m": []}, "none"),
    ],
)
def test_wrong_arguments_are_named(maps, arguments, word):
    with pytest.raises(InputError, match=word):
        sample_instances(maps, **arguments)


def test_maps_without_two_free_cells_are_refused():
    maps = made_maps(20, 20)
    maps.ds["obstacle"][:] = 1
    with pytest.raises(InputError, match="fewer than two cells"):
        sample_instances(maps, 1)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_instances_survive_their_file(instances, tmp_path, suffix):
    file = write_table(instances, tmp_path / f"instances{suffix}")
    found = read_instances(file)
    for column in instances.columns:
        assert found[column].tolist() == instances[column].tolist()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: table.drop(columns="w_gps"), ["lacks", "w_gps"]),
        (lambda table: table.assign(w_gps=-1.0), ["row 1", "w_gps", ">= 0", "-1.0"]),
        (lambda table: table.assign(w_gps=1e308), ["row 1", "w_gps", "at most 1e+30", "1e+308"]),
        (lambda table: table.assign(w_gps=[1.0, None]), ["row 2", "got nan"]),
        (lambda table: table.assign(instance=0.5), ["whole number"]),
        (lambda table: table.assign(instance=-3), ["whole number >= 0", "got -3"]),
        (lambda table: table.assign(start_x_m="west"), ["start_x_m", "west"]),
        (lambda table: pd.concat([table, table]), ["instance 0 at 20 m twice"]),
        (lambda table: table[:0], ["no row"]),
    ],
)
def test_a_wrong_file_is_named_with_its_fault(instances, tmp_path, change, words):
    file = write_table(change(instances[:2]), tmp_path / "instances.csv")
    with pytest.raises(InputError) as error:
        read_instances(file)
    for word in ("instances.csv", *words):
        assert word in str(error.value)


def test_a_file_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.parquet").write_text("no table")
    for name, word in (("a.parquet", "cannot be read"), ("b.csv", "does not exist"), ("c.txt", "end its name")):
        with pytest.raises(InputError, match=word):
            read_instances(tmp_path / name)
