"""Maps, rows, JSON and problems on disk: reopened equal, named by the contract, whole or not there, damage is said."""

import fcntl
import itertools
import json
import pickle
import random
import shutil
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio
import xarray as xr
import zarr

from jaxurban.errors import InputError
from jaxurban.io import files, store, stored
from jaxurban.io.geotiff import write_geotiffs
from jaxurban.io.tables import RowStore, write_table
from jaxurban.io.workspace import Workspace
from tests.faulty_disk import flipped
from tests.logs import logged
from tests.made_maps import made_maps


@pytest.fixture(scope="module")
def ds() -> xr.Dataset:
    made = made_maps(30, 40, (20.0, 60.5), 2.5).ds.drop_vars("spatial_ref")
    made["has_data"][0, 0] = False
    made["gps"] = made["gps"].where(made["obstacle"] == 0).where(made["has_data"])
    flown = made[["gps", "num_visible"]]
    later = (0.5 * flown).assign_coords(time=flown.time + np.timedelta64(5, "m"))
    ds = xr.concat([flown, later], "time").astype({"gps": np.float32, "num_visible": np.uint8})
    ds = ds.assign(made[["obstacle", "population", "has_data"]]).assign_attrs(
        made.attrs, pop_norm_per_km2=[3.0, 2.0]
    )
    for name in ("obstacle", "gps", "population"):
        ds[name].attrs.update(units="1", one_means=f"one of {name}")
    return ds


@pytest.fixture(scope="module")
def few(ds) -> xr.Dataset:
    """Return the least that can be opened."""
    return ds[["obstacle", "has_data"]]


@pytest.fixture(scope="module")
def written(ds, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("written")
    with Workspace.open(folder, "maps", is_shared=True):
        store.write_zarr(ds, folder)
    return folder


@pytest.fixture
def path(written, tmp_path) -> Path:
    """Return the Zarr of the maps, a copy of which lies in the test's folder."""
    shutil.copytree(written, tmp_path, dirs_exist_ok=True)
    return tmp_path / "maps.zarr" / "2.5m"


def test_geotiffs_are_named_tagged_and_north_up(ds, tmp_path):
    assert "gps_20m_2.5m.tif" in {
        file.name for file in write_geotiffs(ds.isel(time=[0]), tmp_path / "one epoch")
    }
    files = write_geotiffs(ds, tmp_path)
    times = ("20200427T160000Z", "20200427T160500Z")
    assert {file.name for file in files} == {
        *(f"{name}_2.5m.qml" for name in ("obstacle", "gps", "population")),
        *(f"obstacle_{altitude}_2.5m.tif" for altitude in ("20m", "60.5m")),
        *(f"gps_{altitude}_{time}_2.5m.tif" for altitude in ("20m", "60.5m") for time in times),
        *(f"population_{time}_2.5m.tif" for time in ("day", "night")),
    }
    with rasterio.open(tmp_path / "geotiff" / "population_night_2.5m.tif") as file:
        assert (file.crs.to_epsg(), file.dtypes[0], file.compression.value) == (
            32618,
            "float32",
            "ZSTD",
        )
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
            for bit in {*random.Random(0).sample(range(num_bits), 30), 0, num_bits - 1}:
                file.write_bytes(flipped(whole, bit))
                assert workspace.broken(files) == [file]
            for size in (0, 1, len(whole) - 1):
                file.write_bytes(whole[:size])
                assert workspace.broken(files) == [file]
            file.unlink()
            assert workspace.broken(files) == [file]
            before = [each.stat().st_mtime_ns for each in files if each != file]
            assert write_geotiffs(ds, tmp_path, only=[file]) == [file]
            assert file.read_bytes() == whole
            assert [each.stat().st_mtime_ns for each in files if each != file] == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["obstacle", "gps", "has_data"])
def test_no_flipped_bit_of_a_chunk_changes_a_value_in_silence(ds, path, tmp_path, name):
    """The few flips that are not seen lie in bits of the frame that mean nothing."""
    chunk = min(chunks_in(path / name))
    whole = chunk.read_bytes()
    bits = {
        *range(min(64, 8 * len(whole))),
        *random.Random(0).sample(range(8 * len(whole)), min(30, 8 * len(whole))),
    }
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


def test_any_flipped_bit_of_the_metadata_is_told_on_opening(ds, path, tmp_path):
    for file in sorted(path.rglob(".z*")):
        whole = file.read_bytes()
        for bit in (*random.Random(0).sample(range(8 * len(whole)), 5), None):
            file.unlink() if bit is None else file.write_bytes(flipped(whole, bit))
            with pytest.raises(
                InputError, match=r"\.zmetadata.*not as they were written.*jaxurban maps"
            ):
                store.open_zarr(tmp_path, None)
        file.write_bytes(whole)
    xr.testing.assert_identical(store.open_zarr(tmp_path, None), ds)


def test_every_missing_or_empty_chunk_is_told_on_opening(path, tmp_path):
    chunks = chunks_in(path)
    assert len(chunks) == 2 + 4 + 4 + 2 + 1 + 5  # maps, and coordinates
    for file in chunks:
        whole = file.read_bytes()
        for left in (b"", whole[:-1], None):
            file.unlink() if left is None else file.write_bytes(left)
            with pytest.raises(
                InputError, match="is missing or cut: run the same `jaxurban maps`"
            ) as told:
                store.open_zarr(tmp_path, None)
            assert str(file) in str(told.value)
        file.write_bytes(whole)


def test_a_chunk_that_goes_after_opening_reads_as_blocked_or_unknown(path, tmp_path):
    found = store.open_zarr(tmp_path, None)
    for name in ("obstacle", "gps", "num_visible", "has_data"):
        for file in chunks_in(path / name):
            file.unlink()
    assert (found["obstacle"].values == 1).all()
    assert np.isnan(found["gps"].values).all()
    assert not found["has_data"].values.any()
    assert not found["num_visible"].values.any()


def chunks_in(path: Path) -> list[Path]:
    return [file for file in path.rglob("*") if file.is_file() and not file.name.startswith(".z")]


def test_opening_says_what_there_is(few, tmp_path):
    with pytest.raises(InputError, match="is empty: make them with"):
        store.open_zarr(tmp_path, None)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds no metric maps"):
        store.open_zarr(tmp_path, None)
    assert store.write_zarr(few, tmp_path) == tmp_path / "maps.zarr" / "2.5m"
    store.write_zarr(few.assign_attrs(resolution_m=5.0), tmp_path)
    with pytest.raises(InputError, match=r"holds maps at 2\.5, 5 m"):
        store.open_zarr(tmp_path, None)
    xr.testing.assert_identical(store.open_zarr(tmp_path, 2.5), few)
    with pytest.raises(InputError, match="holds no maps at 3 m"):
        store.open_zarr(tmp_path, 3.0)


def test_the_group_above_holds_what_is_whole_and_comes_again(few, tmp_path):
    whole = tmp_path / "maps.zarr"

    def found() -> list[str]:
        return sorted(xr.open_datatree(whole, engine="zarr").children)

    store.write_zarr(few, tmp_path)
    store.write_zarr(few.assign_attrs(resolution_m=5.0), tmp_path)
    kept = {file.name: file.read_bytes() for file in stored.root_files(tmp_path)}
    assert found() == ["2.5m", "5m"]
    for file in stored.root_files(tmp_path):  # as 1.0.0 left them
        file.unlink()
    assert store.open_zarr(tmp_path, 5.0).sizes == few.sizes
    store.put_root(tmp_path)
    assert {file.name: file.read_bytes() for file in stored.root_files(tmp_path)} == kept
    (whole / "2.5m" / ".zmetadata").write_text("{junk")
    store.write_zarr(few.assign_attrs(resolution_m=5.0), tmp_path)
    assert found() == ["5m"]


def test_no_metadata_of_older_maps_stand_above_newer_ones(few, path, tmp_path, monkeypatch):
    """A run that is killed between the two leaves a group without consolidated metadata, which xarray then reads."""
    monkeypatch.setattr(store, "put_root", lambda folder: None)
    store.write_zarr(few.isel(y=slice(0, 10)), tmp_path)
    assert [file.name for file in stored.root_files(tmp_path) if file.exists()] == [".zgroup"]
    with pytest.warns(RuntimeWarning, match="consolidated"):
        assert xr.open_zarr(tmp_path / "maps.zarr", group="2.5m").sizes["y"] == 10


def test_a_file_in_the_place_of_the_group_above_is_the_users(ds, path, tmp_path):
    group, _ = stored.root_files(tmp_path)
    with Workspace.open(tmp_path, "maps", is_shared=True) as workspace:
        workspace.remove(["maps.zarr/.zgroup"])
    group.write_text("mine")
    with pytest.raises(InputError, match=r"zgroup' is in the way"):
        store.write_zarr(ds, tmp_path)
    assert group.read_text() == "mine"


def test_maps_of_another_layout_are_refused_as_are_those_that_name_none(few, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "LAYOUT", 3)
    store.write_zarr(few, tmp_path / "newer")
    monkeypatch.undo()
    before = sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*"))
    with pytest.raises(
        InputError, match="have layout 3, and this version of jaxurban reads 2: update jaxurban, or"
    ):
        store.open_zarr(tmp_path / "newer", None)
    assert sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*")) == before
    monkeypatch.setattr(store, "LAYOUT_KEY", "another_attribute")
    written = store.write_zarr(few, tmp_path / "older")
    monkeypatch.undo()
    assert store.LAYOUT_KEY not in xr.open_zarr(written).attrs
    with pytest.raises(InputError, match="have layout 1, and this version of jaxurban reads 2"):
        store.open_zarr(tmp_path / "older", None)
    assert xr.open_zarr(store.write_zarr(few, tmp_path / "today")).attrs[store.LAYOUT_KEY] == 2
    assert store.LAYOUT_KEY not in store.open_zarr(tmp_path / "today", None).attrs


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
    assert sorted(file.name for file in chunks_in(path / "gps")) == [
        f"{t}.{a}.0.0" for t in (0, 1) for a in (0, 1)
    ]


def test_a_tile_is_written_as_the_zarr_library_writes_it(ds, tmp_path):
    tile, rng = (16, 24), np.random.default_rng(3)  # neither divides the 30 rows and 40 columns
    for name in ("ours", "theirs"):
        store.create_zarr(ds, tmp_path / name, tile)
    for name, array in ds.data_vars.items():
        theirs = zarr.open_array(tmp_path / "theirs" / name, mode="r+", zarr_format=2)
        values = (8 * rng.random((30, 40))).astype(array.dtype)
        for index in np.ndindex(array.shape[:-2]):
            for rows, cols in itertools.product(
                (slice(14, 30), slice(0, 14)), (slice(0, 24), slice(24, 40))
            ):
                store.write_layer(tmp_path / "ours", name, index, (rows, cols), values[rows, cols])
            theirs[index] = values[::-1]
        assert {path.name for path in (tmp_path / "ours" / name).iterdir()} == {
            path.name for path in (tmp_path / "theirs" / name).iterdir()
        }
        for path in (tmp_path / "theirs" / name).iterdir():
            assert (tmp_path / "ours" / name / path.name).read_bytes() == path.read_bytes()


def test_any_part_of_opened_maps_is_that_part_of_all_of_them(ds, path, tmp_path):
    maps = store.open_zarr(tmp_path, None)
    every, parts = (
        slice(None),
        (slice(3, 17), slice(-5, None), slice(0, 100), slice(20, 2, -3), 4, [1, 5]),
    )
    for name, array in ds[["obstacle", "gps", "has_data"]].items():
        for rows, cols in itertools.product((every, *parts), (every, slice(2, 30), 7, [3, 3])):
            for at in (0, slice(None), [1, 0]):
                key = {"y": rows, "x": cols, **dict.fromkeys(array.dims[:-2], at)}
                found = maps[name].isel(key).values
                assert np.array_equal(
                    found, array.isel(key).values, equal_nan=array.dtype.kind == "f"
                )


@contextmanager
def opened(folder):
    with Workspace.open(folder, "study", is_shared=True, is_mended=True):
        yield RowStore(folder / "rows.parquet", ("k", "name"), has_parts=True)


def saved(store: RowStore) -> pd.DataFrame:
    store.save({"k": "int64", "name": "object", "value": "float64"})
    return pd.read_parquet(store.file)


def row(k: int, name: str, value: float | None = None) -> dict:
    return {"k": k, "name": name, "value": value}


def test_saving_joins_all_parts_into_one_table_in_order_and_keeps_numbers_bit_for_bit(tmp_path):
    rows = [row(k, "a", value) for k, value in enumerate((0.1 + 0.2, 1e-300, 2**53 + 1.0, None))]
    with opened(tmp_path) as store:
        store.add(rows[2:])
        store.add(rows[:2])
        assert len(list((tmp_path / "parts").iterdir())) == 2
    for _ in range(2):  # as they are in the parts, and in the table
        with opened(tmp_path) as store:
            assert saved(store).k.tolist() == [0, 1, 2, 3]
            assert store.rows == rows
            assert [(2, name) in store for name in "ab"] == [True, False]
        assert not (tmp_path / "parts").exists()


def other_digit(data: bytes) -> bytes:
    """A digit of a number becomes another: what no reader of the format can see."""
    return flipped(
        data, 8 * (data.index(b"0.25") + 2 if b"0.25" in data else data.index(b"name") - 1)
    )


@pytest.mark.parametrize(
    "damage", [other_digit, lambda data: data[: len(data) // 2], lambda data: b""]
)
def test_damaged_rows_are_reported_set_aside_and_made_again(tmp_path, damage):
    with opened(tmp_path) as store:
        store.add([row(1, "a")])
        saved(store)
        store.add([row(2, "b", 0.25)])
    for file in (tmp_path / "rows.parquet", next((tmp_path / "parts").glob("*.json"))):
        data = damage(file.read_bytes())
        file.write_bytes(data)
        with logged() as warned, opened(tmp_path) as store:
            assert [each["k"] for each in store.rows] == ([2] if file.suffix == ".parquet" else [])
        kept = tmp_path / "kept" / file.relative_to(tmp_path)
        assert warned == [
            f"{str(file)!r} was changed since `jaxurban study` wrote it: it is kept as {str(kept)!r}"
        ]
        assert kept.read_bytes() == data
    with opened(tmp_path) as store:
        store.add([row(1, "a"), row(2, "b", 0.25)])
        assert saved(store).k.tolist() == [1, 2]


def test_parts_and_damaged_rows_of_the_users_are_kept(tmp_path):
    theirs = tmp_path / "parts" / f"{32 * 'b'}.json"
    for k in (1, 2):
        with opened(tmp_path) as store:
            store.add([row(k, "a")])
            theirs.write_text(json.dumps({"rows": [row(3, "c")]}))
            saved(store)
        assert list((tmp_path / "parts").iterdir()) == [theirs]
        (tmp_path / "rows.parquet").write_text(f"edit {k}")
        with opened(tmp_path) as store:
            assert store.rows == []
    assert [path.read_text() for path in sorted((tmp_path / "kept").iterdir())] == [
        "edit 1",
        "edit 2",
    ]


TABLE = pd.DataFrame({"k": [1, 2], "x_m": [[0.5, 1.5], None], "name": ["a", "b"]})
RESULTS = {"rows": [{"cost": 0.1 + 0.2, "name": "ä"}], "none": None}


@pytest.mark.parametrize(
    ("write", "read", "sentence"),
    [
        (
            partial(write_table, TABLE),
            lambda file: RowStore(file, ["k"]),
            "is damaged, or not a file of such results",
        ),
        (lambda file: files.write_json(file, RESULTS), files.read_json, "not as it was written"),
    ],
)
def test_any_flipped_bit_of_results_is_told(tmp_path, write, read, sentence):
    write(file := tmp_path / "a.parquet")
    read(file)
    whole = file.read_bytes()
    flips = (flipped(whole, bit) for bit in random.Random(0).sample(range(8 * len(whole)), 60))
    for data in (*flips, whole[:-1], whole[:20], b""):
        file.write_bytes(data)
        with pytest.raises((InputError, ValueError), match=sentence):
            read(file)


def test_rows_of_other_settings_are_refused_and_settings_are_kept(tmp_path):
    file = tmp_path / "a.parquet"
    store = RowStore(file, ["k"], settings={"seed": 3})
    store.add([{"k": "one", "found": np.arange(3.0).tobytes()}])
    store.save()
    assert np.frombuffer(
        RowStore(file, ["k"], settings={"seed": 3}).get("one")["found"]
    ).tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(
        InputError, match=r"of other settings .its seed is 3, now 4.: pass --overwrite"
    ):
        RowStore(file, ["k"], settings={"seed": 4})
    with pytest.raises(InputError, match=r"a\.npz' must end in \.parquet"):
        RowStore(tmp_path / "a.npz", ["k"])


class RunsCode:
    """Touches a file when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple:
        return Path.touch, (self.file,)


CODES = {  # what the metadata of a Zarr say of an array that is not as ours are
    "pickle in a filter of text": {
        "dtype": "|O",
        "filters": [{"id": "vlen-utf8"}, {"id": "pickle"}],
    },
    "pickle": {"dtype": "|O", "filters": [{"id": "pickle"}]},
    "JSON": {"dtype": "|O", "filters": [{"id": "json2"}]},
    "objects": {"dtype": "|O", "filters": None},
    "records": {"dtype": [["a", "|O"]]},
    "another filter": {"filters": [{"id": "delta", "dtype": "<f8"}]},
    "pickle as compressor": {"compressor": {"id": "pickle"}},
    "another compressor": {"compressor": {"id": "zlib", "level": 1}},
    "no compressor": {"compressor": None},
}


def seal(folder: Path) -> None:
    """Record the files of maps as they are now."""
    record = files.read_json(folder / "checksums.json")
    written = record["maps"]["written"]
    written |= {each: files.checksum_of(folder / each) for each in written}
    files.write_json(folder / "checksums.json", record)


@pytest.mark.parametrize(
    "facts",
    [
        *({"resolution_m": length_m} for length_m in ("5", 0, -5.0, np.nan, np.inf)),
        {"guesses": "[" * 10_000},
        {"guesses": "[1]"},
        {"guesses": '[{"kind": "none"}]'},
        {"guesses": '[{"kind": "heights", "facts": {}}]'},
        {"guesses": '[{"kind": "heights", "share": "all", "facts": {"kinds": ""}}]'},
    ],
)
def test_maps_whose_attributes_are_of_another_kind_are_refused(path, tmp_path, facts):
    metadata = json.loads((path / ".zmetadata").read_bytes())
    metadata["metadata"][".zattrs"] |= facts
    (path / ".zmetadata").write_text(json.dumps(metadata))
    (path / ".zattrs").write_text(json.dumps(metadata["metadata"][".zattrs"]))
    seal(tmp_path)
    with pytest.raises(InputError, match=r"are not those of maps|cannot be read"):
        store.open_zarr(tmp_path, None)


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("array", ["x", "gps"])
def test_an_array_that_is_not_coded_as_ours_is_refused_before_anything_of_it_is_decoded(
    path, tmp_path, array, name
):
    marker = tmp_path / "code ran"
    metadata = json.loads((path / ".zmetadata").read_bytes())
    coded = metadata["metadata"][f"{array}/.zarray"]
    coded |= {"chunks": coded["shape"]} | CODES[name]
    (path / ".zmetadata").write_text(json.dumps(metadata))
    (path / array / ".zarray").write_text(json.dumps(coded))
    for chunk in (path / array).glob("[0-9]*"):
        chunk.write_bytes(pickle.dumps(RunsCode(marker)))
    seal(tmp_path)
    with pytest.raises(
        InputError, match=r"zmetadata' names arrays that are not coded as jaxurban codes maps"
    ):
        store.open_zarr(tmp_path, None)["gps"].load()
    assert not marker.exists()


def test_text_that_users_added_to_maps_is_read_in_either_form(few, tmp_path):
    names = ["low", "at 60.5 m"]
    for kind in (object, str, np.dtypes.StringDType()):
        store.write_zarr(
            few.assign(called=("altitude", np.array(names, kind))),
            tmp_path / str(kind),
        )
        found = store.open_zarr(tmp_path / str(kind), None)
        assert found["called"].values.tolist() == names
