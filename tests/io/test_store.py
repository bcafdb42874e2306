"""Maps on disk: reopened equal, named by the contract, whole or not there."""

import fcntl

import numpy as np
import pytest
import rasterio
import xarray as xr

from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.io.geotiff import write_geotiffs


@pytest.fixture
def ds() -> xr.Dataset:
    rng = np.random.default_rng(0)
    flown, shape = ("altitude", "y", "x"), (2, 30, 40)
    ds = xr.Dataset(
        {
            "obstacle": (flown, (rng.random(shape) > 0.8).astype(np.uint8)),
            "gps": (("time", *flown), rng.random((2, *shape), np.float32)),
            "population": (("time_of_day", "y", "x"), rng.random((2, 30, 40), np.float32)),
            "has_data": (("y", "x"), np.arange(1200).reshape(30, 40) > 0),
        },
        coords={
            "y": 1000.0 + np.arange(30) * 2.5 + 1.25,
            "x": 500.0 + np.arange(40) * 2.5 + 1.25,
            "altitude": [20.0, 60.5],
            "time": np.array(["2020-04-27T16:00:00", "2020-04-27T16:05:00"], "datetime64[ns]"),
            "time_of_day": np.array(["day", "night"], np.dtypes.StringDType()),
        },
        attrs={
            "crs": "EPSG:32618",
            "resolution_m": 2.5,
            "first_row": 400,
            "first_col": 200,
            "pop_norm_per_km2": [3.0, 2.0],
        },
    )
    for name in ("obstacle", "gps", "population"):
        ds[name].attrs.update(units="1", one_means=f"one of {name}")
    return ds


def test_zarr_reopens_equal(ds, tmp_path):
    assert store.write_zarr(ds, tmp_path) == tmp_path / "maps.zarr" / "2.5m"
    xr.testing.assert_identical(store.open_zarr(tmp_path, None), ds)
    xr.testing.assert_identical(store.open_zarr(tmp_path, 2.5), ds)


def test_geotiffs_are_named_tagged_and_north_up(ds, tmp_path):
    files = write_geotiffs(ds, tmp_path)
    assert {file.name for file in files} == {
        "obstacle_20m_2.5m.tif",
        "obstacle_60.5m_2.5m.tif",
        "gps_20m_20200427T160000Z_2.5m.tif",
        "gps_20m_20200427T160500Z_2.5m.tif",
        "gps_60.5m_20200427T160000Z_2.5m.tif",
        "gps_60.5m_20200427T160500Z_2.5m.tif",
        "population_day_2.5m.tif",
        "population_night_2.5m.tif",
    }
    with rasterio.open(tmp_path / "geotiff" / "population_night_2.5m.tif") as file:
        assert (file.crs.to_epsg(), file.dtypes[0], file.compression.value) == (32618, "float32", "ZSTD")
        assert file.tags()["pop_norm_per_km2"] == "2.0"
        assert file.tags()["one_means"] == "one of population"
        # The value under a coordinate must be the value of that cell, whichever way rows run.
        ((value,),) = file.sample([(float(ds.x[7]), float(ds.y[3]))])
        assert value == np.float32(ds["population"].isel(time_of_day=1, y=3, x=7))
        ((nothing,),) = file.sample([(float(ds.x[0]), float(ds.y[0]))])
        assert np.isnan(nothing)


def test_one_epoch_is_left_out_of_names(ds, tmp_path):
    names = {file.name for file in write_geotiffs(ds.isel(time=[0]), tmp_path)}
    assert "gps_20m_2.5m.tif" in names


def test_same_maps_give_the_same_bytes(ds, tmp_path):
    def files(folder):
        store.write_zarr(ds, folder)
        write_geotiffs(ds, folder)
        return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    assert files(tmp_path / "a") == files(tmp_path / "b")


def test_a_failed_write_leaves_the_old_file_and_no_scrap(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")

    def write_half():
        with store.whole_file(path) as scratch:
            scratch.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]
    assert path.read_text() == "old"


def test_files_of_the_same_run_are_left_alone(ds, tmp_path):
    (first, *_) = write_geotiffs(ds, tmp_path, skip_key="a")
    before = first.stat().st_mtime_ns
    write_geotiffs(ds, tmp_path, skip_key="a")
    assert first.stat().st_mtime_ns == before
    write_geotiffs(ds, tmp_path, skip_key="b")
    assert first.stat().st_mtime_ns > before


def test_a_torn_file_of_the_same_run_is_written_again(ds, tmp_path):
    (first, *_) = write_geotiffs(ds, tmp_path, skip_key="a")
    whole = first.read_bytes()
    first.write_bytes(whole[:100])
    write_geotiffs(ds, tmp_path, skip_key="a")
    assert first.read_bytes() == whole


def test_opening_says_what_there_is(ds, tmp_path):
    with pytest.raises(InputError, match="holds no metric maps"):
        store.open_zarr(tmp_path, None)
    store.write_zarr(ds, tmp_path)
    store.write_zarr(ds.assign_attrs(resolution_m=5.0), tmp_path)
    with pytest.raises(InputError, match=r"holds maps at 2\.5, 5 m"):
        store.open_zarr(tmp_path, None)
    with pytest.raises(InputError, match="holds no maps at 3 m"):
        store.open_zarr(tmp_path, 3.0)


def test_a_lock_on_a_removed_file_holds_nothing(tmp_path, monkeypatch):
    """Between our opening and our locking of the file the first holder leaves and another run comes."""
    first, second = store.only_writer(tmp_path), store.only_writer(tmp_path)
    lock = fcntl.flock

    def lock_late(file, how):
        monkeypatch.setattr(fcntl, "flock", lock)
        first.__exit__(None, None, None)
        second.__enter__()
        lock(file, how)

    first.__enter__()
    monkeypatch.setattr(fcntl, "flock", lock_late)
    with pytest.raises(InputError, match="another run is writing"), store.only_writer(tmp_path):
        pytest.fail("two runs hold one folder")
    second.__exit__(None, None, None)
    with store.only_writer(tmp_path):
        pass
    assert not list(tmp_path.iterdir())
