"""Tiled maps equal untiled ones bit for bit, whoever works on the tiles."""

import numpy as np
import pytest
import xarray as xr

from jaxurban.build import compute_maps, make_surface
from jaxurban.io import store
from tests import tiled_runs
from tests.tiled_runs import RAGGED, files_of, make, params, region, sky


def untiled(city, series) -> xr.Dataset:
    surface = make_surface(city, region(city), sky(), params(series))
    return compute_maps(city, surface, sky(), params(series)).ds


@pytest.fixture(scope="module")
def city():
    return tiled_runs.city()


@pytest.fixture(scope="module")
def made(city, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiled")
    make(folder, city)
    return folder


def assert_equal(folder, expected: xr.Dataset) -> None:
    found = store.open_zarr(folder, None)
    assert found.attrs.pop("run_key") == "key"
    xr.testing.assert_identical(found.load(), expected)


def test_ragged_tiles_equal_the_untiled_maps(city, made):
    expected = untiled(city, "epochs")
    assert expected["num_visible"].values.max() > expected["num_visible"].values.min()
    assert_equal(made, expected)


def test_statistics_over_time_of_tiles_equal_the_untiled_ones(city, tmp_path):
    make(tmp_path, city, series="statistics")
    assert_equal(tmp_path, untiled(city, "statistics"))


def test_tiles_on_terrain_with_holes_in_the_data_equal_the_untiled_maps(tmp_path):
    city = tiled_runs.city(with_terrain=True)
    make(tmp_path, city)
    expected = untiled(city, "epochs")
    assert np.isnan(expected["gps"].values).any()
    assert_equal(tmp_path, expected)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(41, 53), (1, 53), (41, 5), (7, 11), (40, 52)])
def test_any_shape_of_tiles_gives_the_same_maps(city, tmp_path, shape):
    make(tmp_path, city, shape)
    assert_equal(tmp_path, untiled(city, "epochs"))


def test_nothing_of_the_work_is_left(made):
    assert [path.name for path in (made / "maps.zarr").iterdir()] == ["20m"]


def test_a_chunk_is_a_tile(made):
    assert store.open_zarr(made, None)["risk"].encoding["chunks"] == (1, *RAGGED)


@pytest.mark.parametrize("num_workers", [1, 2, 4])
def test_any_number_of_dask_workers_gives_the_same_bytes(city, made, tmp_path, num_workers):
    distributed = pytest.importorskip("distributed", reason="needs the cluster extra")
    options = {"processes": False, "dashboard_address": None, "threads_per_worker": 1}
    with distributed.LocalCluster(n_workers=num_workers, **options) as cluster, distributed.Client(cluster) as client:
        make(tmp_path, city, client=client)
    assert files_of(tmp_path) == files_of(made)


@pytest.mark.slow
def test_worker_processes_give_the_same_bytes(city, made, tmp_path):
    from jaxurban.cluster import cluster_client

    with cluster_client(None, 2) as client:
        make(tmp_path, city, client=client)
    assert files_of(tmp_path) == files_of(made)
