"""RowStore: each row once or not at all, whatever was killed when."""

import json
from contextlib import contextmanager

import pandas as pd
import pytest

from jaxurban.io.tables import RowStore
from jaxurban.io.workspace import Workspace
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


def test_rows_are_there_again_after_any_end(tmp_path):
    with opened(tmp_path) as store:
        store.add([row(2, "a", 0.1), row(1, "b")])
    with opened(tmp_path) as again:
        assert again.rows == [row(1, "b"), row(2, "a", 0.1)]
        assert (2, "a") in again
        assert (2, "b") not in again


def test_saving_joins_all_parts_into_one_table_in_order(tmp_path):
    with opened(tmp_path) as store:
        store.add([row(2, "a", 0.1)])
        store.add([row(1, "b")])
        assert len(list((tmp_path / "parts").iterdir())) == 2
        table = saved(store)
    assert not (tmp_path / "parts").exists()
    assert table.k.tolist() == [1, 2]
    with opened(tmp_path) as again:
        assert again.rows == store.rows


def test_a_kill_between_table_and_parts_doubles_nothing(tmp_path, monkeypatch):
    with monkeypatch.context() as patched, opened(tmp_path) as store:
        store.add([row(1, "a", 0.5)])
        patched.setattr(Workspace, "remove", lambda *_: None)
        store.save(COLUMNS)
    assert len(list((tmp_path / "parts").iterdir())) == 1
    with opened(tmp_path) as again:
        assert len(again) == 1
        assert len(saved(again)) == 1
    assert not (tmp_path / "parts").exists()


def test_numbers_survive_bit_for_bit(tmp_path):
    values = [0.1 + 0.2, 1e-300, 2**53 + 1.0, None]
    with opened(tmp_path, "k") as store:
        store.add([row(k, "a", value) for k, value in enumerate(values)])
    for _ in range(2):
        with opened(tmp_path, "k") as store:
            assert [each["value"] for each in store.rows] == values
            store.save(COLUMNS)


def flipped(data: bytes) -> bytes:
    """A digit of a number becomes another: what no reader of the format can see."""
    place = data.index(b"0.25") + 2 if b"0.25" in data else data.index(b"name") - 1
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


@pytest.mark.parametrize("damage", [flipped, lambda data: data[: len(data) // 2], lambda data: b""])
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
