"""Rows, and JSON, that tell damage: each row once or not at all, whatever was killed when."""

import json
import random
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jaxurban.errors import InputError
from jaxurban.io import files
from jaxurban.io.tables import RowStore, write_table
from jaxurban.io.workspace import Workspace
from tests.faulty_disk import flipped
from tests.logs import logged

COLUMNS = {"k": "int64", "name": "object", "value": "float64"}


@contextmanager
def opened(folder, *key: str):
    with Workspace.open(folder, "study", is_shared=True, is_mended=True):
        yield RowStore(folder / "rows.parquet", key or ("k", "name"), has_parts=True)


def saved(store: RowStore) -> pd.DataFrame:
    store.save(COLUMNS)
    return pd.read_parquet(store.file)


def row(k: int, name: str, value: float | None = None) -> dict:
    return {"k": k, "name": name, "value": value}


def test_saving_joins_all_parts_into_one_table_in_order(tmp_path):
    with opened(tmp_path) as store:
        store.add([row(2, "a", 0.1)])
        store.add([row(1, "b")])
        assert len(list((tmp_path / "parts").iterdir())) == 2
        table = saved(store)
    assert not (tmp_path / "parts").exists()
    assert table.k.tolist() == [1, 2]
    with opened(tmp_path) as again:
        assert again.rows == store.rows == [row(1, "b"), row(2, "a", 0.1)]
        assert (2, "a") in again
        assert (2, "b") not in again


def test_numbers_survive_bit_for_bit(tmp_path):
    values = [0.1 + 0.2, 1e-300, 2**53 + 1.0, None]
    with opened(tmp_path, "k") as store:
        store.add([row(k, "a", value) for k, value in enumerate(values)])
    for _ in range(2):
        with opened(tmp_path, "k") as store:
            assert [each["value"] for each in store.rows] == values
            store.save(COLUMNS)


def other_digit(data: bytes) -> bytes:
    """A digit of a number becomes another: what no reader of the format can see."""
    return flipped(data, 8 * (data.index(b"0.25") + 2 if b"0.25" in data else data.index(b"name") - 1))


@pytest.mark.parametrize("damage", [other_digit, lambda data: data[: len(data) // 2], lambda data: b""])
def test_damaged_rows_are_reported_set_aside_and_made_again(tmp_path, damage):
    with opened(tmp_path) as store:
        store.add([row(1, "a")])
        store.save(COLUMNS)
        store.add([row(2, "b", 0.25)])
    for file in (tmp_path / "rows.parquet", next((tmp_path / "parts").glob("*.json"))):
        data = damage(file.read_bytes())
        file.write_bytes(data)
        with logged() as warned, opened(tmp_path) as store:
            assert [each["k"] for each in store.rows] == ([2] if file.suffix == ".parquet" else [])
        kept = tmp_path / "kept" / file.relative_to(tmp_path)
        assert warned == [f"{str(file)!r} was changed since `jaxurban study` wrote it: it is kept as {str(kept)!r}"]
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
            store.save(COLUMNS)
        assert list((tmp_path / "parts").iterdir()) == [theirs]
        (tmp_path / "rows.parquet").write_text(f"edit {k}")
        with opened(tmp_path) as store:
            assert store.rows == []
    assert [path.read_text() for path in sorted((tmp_path / "kept").iterdir())] == ["edit 1", "edit 2"]


def write_rows(file: Path) -> None:
    write_table(pd.DataFrame({"k": [1, 2], "x_m": [[0.5, 1.5], None], "name": ["a", "b"]}), file)


def write_json(file: Path) -> None:
    files.write_json(file, {"rows": [{"cost": 0.1 + 0.2, "name": "ä"}], "none": None})


@pytest.mark.parametrize(
    ("write", "read", "sentence"),
    [
        (write_rows, lambda file: RowStore(file, ["k"]), "is damaged, or not a file of such results"),
        (write_json, files.read_json, "not as it was written"),
    ],
)
def test_any_flipped_bit_of_results_is_told(tmp_path, write, read, sentence):
    write(file := tmp_path / "a.parquet")
    read(file)
    whole = file.read_bytes()
    flips = (flipped(whole, bit) for bit in random.Random(0).sample(range(8 * len(whole)), 150))
    for data in (*flips, whole[:-1], whole[:20], b""):
        file.write_bytes(data)
        with pytest.raises((InputError, ValueError), match=sentence):
            read(file)


def test_rows_of_other_settings_are_refused_and_settings_are_kept(tmp_path):
    file = tmp_path / "a.parquet"
    store = RowStore(file, ["k"], settings={"seed": 3})
    store.add([{"k": "one", "found": np.arange(3.0).tobytes()}])
    store.save()
    assert np.frombuffer(RowStore(file, ["k"], settings={"seed": 3}).get("one")["found"]).tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(InputError, match=r"of other settings .its seed is 3, and 4 is given now.: pass --overwrite"):
        RowStore(file, ["k"], settings={"seed": 4})
    with pytest.raises(InputError, match=r"a\.npz' must end in \.parquet"):
        RowStore(tmp_path / "a.npz", ["k"])
