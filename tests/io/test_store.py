"""Maps on disk: reopened equal, named by the contract, whole or not there."""

import fcntl
import itertools
import random
from pathlib import Path

import numpy as np
import pytest
import rasterio
import xarray as xr
import zarr

from jaxurban.errors import InputError
from jaxurban.io import files, store
from jaxurban.io.geotiff import missing_geotiffs, write_geotiffs
from jaxurban.io.workspace import Workspace
from tests.faulty_disk import flipped


@pytest.fixture
def ds() -> xr.Dataset:
    rng = np.random.default_rng(0)
    flown, shape = ("altitude", "y", "x"), (2, 30, 40)
    ds = xr.Dataset(
        {
            "obstacle": (flown, (rng.random(shape) > 0.8).astype(np.uint8)),
            "gps": (("time", *flown), rng.random((2, *shape), np.float32)),
            "population": (("time_of_day", "y", "x"), rng.random((2, 30, 40), np.float32)),
            "num_visible": (("time", *flown), np.ones((2, *shape), np.uint8)),
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
    ds["gps"] = ds["gps"].where(ds["obstacle"] == 0).where(ds["has_data"])
    return ds


def test_geotiffs_are_named_tagged_and_north_up(ds, tmp_path):
    assert "gps_20m_2.5m.tif" in {file.name for file in write_geotiffs(ds.isel(time=[0]), tmp_path / "one epoch")}
    files = write_geotiffs(ds, tmp_path)
    times = ("20200427T160000Z", "20200427T160500Z")
    assert {file.name for file in files} == {
        *(f"{name}_2.5m.qml" for name in ("obstacle", "gps", "population")),
        *(f"obstacle_{altitude}_2.5m.tif" for altitude in ("20m", "60.5m")),
        *(f"gps_{altitude}_{time}_2.5m.tif" for altitude in ("20m", "60.5m") for time in times),
        *(f"population_{time}_2.5m.tif" for time in ("day", "night")),
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


def test_any_flipped_bit_of_a_geotiff_or_style_is_noticed(ds, tmp_path):
    """Data, overviews, tags and place alike: GDAL itself reads most of them without a word."""
    with Workspace.open(tmp_path, "maps") as workspace:
        files = write_geotiffs(ds, tmp_path)
        assert workspace.broken(files) == []
        for file in (files[0], files[-1]):
            whole = file.read_bytes()
            num_bits = 8 * len(whole)
            for bit in {*random.Random(0).sample(range(num_bits), 100), 0, num_bits - 1}:
                file.write_bytes(flipped(whole, bit))
                assert workspace.broken(files) == [file]
            for size in (0, 1, len(whole) - 1):
                file.write_bytes(whole[:size])
                assert workspace.broken(files) == [file]
                assert missing_geotiffs(ds, tmp_path) == ([] if size else [file])
            file.unlink()
            assert missing_geotiffs(ds, tmp_path) == workspace.broken(files) == [file]
            before = [each.stat().st_mtime_ns for each in files if each != file]
            assert write_geotiffs(ds, tmp_path, only=[file]) == [file]
            assert file.read_bytes() == whole
            assert [each.stat().st_mtime_ns for each in files if each != file] == before


@pytest.mark.parametrize("name", ["obstacle", "gps", "has_data"])
def test_no_flipped_bit_of_a_chunk_changes_a_value_in_silence(ds, tmp_path, name):
    """The few flips that are not seen lie in bits of the frame that mean nothing."""
    path = store.write_zarr(ds, tmp_path)
    chunk = min(chunks_in(path / name))
    whole = chunk.read_bytes()
    bits = {*range(min(64, 8 * len(whole))), *random.Random(0).sample(range(8 * len(whole)), min(60, 8 * len(whole)))}
    found, unseen = store.open_zarr(tmp_path, None)[name], 0
    for bit in bits:
        chunk.write_bytes(flipped(whole, bit))
        told = ""
        try:
            values = found.isel(x=slice(None)).values  # not kept in memory
        except InputError as error:
            told = str(error)
        if not told:
            np.testing.assert_array_equal(values, ds[name].values)
            unseen += 1
        assert not told or (str(chunk) in told and "jaxurban maps" in told)
    assert unseen < 0.03 * len(bits)


def test_any_flipped_bit_of_the_metadata_is_told_on_opening(ds, tmp_path):
    path = store.write_zarr(ds, tmp_path)
    for file in sorted(path.rglob(".z*")):
        whole = file.read_bytes()
        for bit in random.Random(0).sample(range(8 * len(whole)), 15):
            file.write_bytes(flipped(whole, bit))
            with pytest.raises(InputError, match=r"\.zmetadata.*not as they were written.*jaxurban maps"):
                store.open_zarr(tmp_path, None)
        file.unlink()
        with pytest.raises(InputError, match=r"\.zmetadata.*not as they were written.*jaxurban maps"):
            store.open_zarr(tmp_path, None)
        file.write_bytes(whole)
    xr.testing.assert_identical(store.open_zarr(tmp_path, None), ds)


def test_every_missing_or_empty_chunk_is_told_on_opening(ds, tmp_path):
    path = store.write_zarr(ds, tmp_path)
    chunks = chunks_in(path)
    assert len(chunks) == 2 + 4 + 4 + 2 + 1 + 5  # maps, and coordinates
    for file in chunks:
        whole = file.read_bytes()
        for damage in (lambda file: file.unlink(), lambda file: file.write_bytes(b""), cut):
            damage(file)
            with pytest.raises(InputError, match="is missing or cut: run the same `jaxurban maps`") as told:
                store.open_zarr(tmp_path, None)
            assert str(file) in str(told.value)
        file.write_bytes(whole)


def test_a_chunk_that_goes_after_opening_reads_as_blocked_or_unknown(ds, tmp_path):
    path = store.write_zarr(ds, tmp_path)
    found = store.open_zarr(tmp_path, None)
    for name in ("obstacle", "gps", "num_visible", "has_data"):
        for file in chunks_in(path / name):
            file.unlink()
    assert (found["obstacle"].values == 1).all()
    assert np.isnan(found["gps"].values).all()
    assert not found["has_data"].values.any()
    assert not found["num_visible"].values.any()


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-1])


def chunks_in(path: Path) -> list[Path]:
    return [file for file in path.rglob("*") if file.is_file() and not file.name.startswith(".z")]


def test_opening_says_what_there_is(ds, tmp_path):
    with pytest.raises(InputError, match="holds no metric maps"):
        store.open_zarr(tmp_path, None)
    assert store.write_zarr(ds, tmp_path) == tmp_path / "maps.zarr" / "2.5m"
    store.write_zarr(ds.assign_attrs(resolution_m=5.0), tmp_path)
    with pytest.raises(InputError, match=r"holds maps at 2\.5, 5 m"):
        store.open_zarr(tmp_path, None)
    xr.testing.assert_identical(store.open_zarr(tmp_path, 2.5), ds)
    with pytest.raises(InputError, match="holds no maps at 3 m"):
        store.open_zarr(tmp_path, 3.0)


def test_a_lock_on_a_removed_file_holds_nothing(tmp_path, monkeypatch):
    """Between our opening and our locking of the file the first holder leaves and another run comes."""
    first, second = files.only_writer(tmp_path), files.only_writer(tmp_path)
    lock = fcntl.flock

    def lock_late(file, how):
        monkeypatch.setattr(fcntl, "flock", lock)
        first.__exit__(None, None, None)
        second.__enter__()
        lock(file, how)

    first.__enter__()
    monkeypatch.setattr(fcntl, "flock", lock_late)
    with pytest.raises(InputError, match="another run is writing"), files.only_writer(tmp_path):
        pytest.fail("two runs hold one folder")
    second.__exit__(None, None, None)
    with files.only_writer(tmp_path):
        pass
    assert not list(tmp_path.iterdir())


def test_tiles_without_a_value_are_on_disk_like_all_others(ds, tmp_path):
    path = store.write_zarr(ds.assign(gps=ds["gps"] * np.nan), tmp_path)
    assert sorted(file.name for file in chunks_in(path / "gps")) == [f"{t}.{a}.0.0" for t in (0, 1) for a in (0, 1)]


def test_a_tile_is_written_as_the_zarr_library_writes_it(ds, tmp_path):
    tile, rng = (16, 24), np.random.default_rng(3)  # neither divides the 30 rows and 40 columns
    for name in ("ours", "theirs"):
        store.create_zarr(ds, tmp_path / name, tile)
    for name, array in ds.data_vars.items():
        theirs = zarr.open_array(tmp_path / "theirs" / name, mode="r+", zarr_format=2)
        values = (8 * rng.random((30, 40))).astype(array.dtype)
        for index in np.ndindex(array.shape[:-2]):
            for rows, cols in itertools.product((slice(14, 30), slice(0, 14)), (slice(0, 24), slice(24, 40))):
                store.write_layer(tmp_path / "ours", name, index, (rows, cols), values[rows, cols])
            theirs[index] = values[::-1]
        assert {path.name for path in (tmp_path / "ours" / name).iterdir()} == {
            path.name for path in (tmp_path / "theirs" / name).iterdir()
        }
        for path in (tmp_path / "theirs" / name).iterdir():
            assert (tmp_path / "ours" / name / path.name).read_bytes() == path.read_bytes()


def test_any_part_of_opened_maps_is_that_part_of_all_of_them(ds, tmp_path):
    store.write_zarr(ds, tmp_path)
    maps = store.open_zarr(tmp_path, None)
    every, parts = slice(None), (slice(3, 17), slice(-5, None), slice(0, 100), slice(20, 2, -3), 4, [1, 5])
    for name, array in ds.data_vars.items():
        for rows, cols in itertools.product((every, *parts), (every, slice(2, 30), 7, [3, 3])):
            for at in (0, slice(None), [1, 0]):
                key = {"y": rows, "x": cols, **dict.fromkeys(array.dims[:-2], at)}
                found = maps[name].isel(key).values
                assert np.array_equal(found, array.isel(key).values, equal_nan=array.dtype.kind == "f")
