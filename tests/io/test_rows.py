"""RowStore: each row once or not at all, whatever was killed when."""

import json

import pandas as pd
import pytest

from jaxurban.io.tables import RowStore
from jaxurban.io.workspace import Workspace

COLUMNS = {"k": "int64", "name": "object", "value": "float64"}


def opened(folder, *key: str) -> RowStore:
    return RowStore(folder / "rows.parquet", key or ("k", "name"), has_parts=True)


def saved(store: RowStore) -> pd.DataFrame:
    store.save(COLUMNS)
    return pd.read_parquet(store.file)


def row(k: int, name: str, value: float | None = None) -> dict:
    return {"k": k, "name": name, "value": value}


def test_rows_are_there_again_after_any_end(tmp_path):
    store = opened(tmp_path)
    store.add([row(2, "a", 0.1), row(1, "b")])
    again = opened(tmp_path)
    assert again.rows == [row(1, "b"), row(2, "a", 0.1)]
    assert (2, "a") in again
    assert (2, "b") not in again


def test_saving_joins_all_parts_into_one_table_in_order(tmp_path):
    store = opened(tmp_path)
    store.add([row(2, "a", 0.1)])
    store.add([row(1, "b")])
    table = saved(store)
    assert not list((tmp_path / "parts").iterdir())
    assert table.k.tolist() == [1, 2]
    assert opened(tmp_path).rows == store.rows


def test_a_kill_between_table_and_parts_doubles_nothing(tmp_path):
    store = opened(tmp_path)
    store.add([row(1, "a", 0.5)])
    part = next((tmp_path / "parts").glob("*.json"))
    text = part.read_text()
    store.save(COLUMNS)
    part.write_text(text)  # as if it had not been removed yet
    again = opened(tmp_path)
    assert len(again) == 1
    assert len(saved(again)) == 1
    assert not list((tmp_path / "parts").iterdir())


def test_what_was_being_written_is_swept(tmp_path):
    opened(tmp_path).add([row(1, "a")])
    half = tmp_path / "parts" / ".x.json.0a1b2c3d.jaxurban-part"
    half.write_text(json.dumps([row(2, "a")])[:9])
    assert len(opened(tmp_path)) == 1
    assert not half.exists()


def test_numbers_survive_bit_for_bit(tmp_path):
    values = [0.1 + 0.2, 1e-300, 2**53 + 1.0, None]
    store = opened(tmp_path, "k")
    store.add([row(k, "a", value) for k, value in enumerate(values)])
    assert [each["value"] for each in opened(tmp_path, "k").rows] == values
    store.save(COLUMNS)
    assert [each["value"] for each in opened(tmp_path, "k").rows] == values


def flipped(data: bytes) -> bytes:
    """A digit of a number becomes another: what no reader of the format can see."""
    place = data.index(b"0.25") + 2 if b"0.25" in data else data.index(b"name") - 1
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


@pytest.mark.parametrize("damage", [flipped, lambda data: data[: len(data) // 2], lambda data: b""])
def test_damaged_rows_are_told_set_aside_and_made_again(tmp_path, damage):
    store = opened(tmp_path)
    store.add([row(1, "a")])
    store.save(COLUMNS)
    store.add([row(2, "b", 0.25)])
    for file in (tmp_path / "rows.parquet", next((tmp_path / "parts").glob("*.json"))):
        file.write_bytes(damage(file.read_bytes()))
        with pytest.warns(UserWarning, match=rf"{file.name}.* is damaged.* made again"):
            left = opened(tmp_path).rows
        assert [each["k"] for each in left] == ([2] if file.suffix == ".parquet" else [])
    store = opened(tmp_path)
    store.add([row(1, "a"), row(2, "b", 0.25)])
    assert saved(store).k.tolist() == [1, 2]


def test_parts_and_damaged_rows_of_the_users_are_kept(tmp_path):
    for k in (1, 2):
        with Workspace.open(tmp_path, "study", is_shared=True):
            store = opened(tmp_path)
            store.add([row(k, "a")])
            theirs = tmp_path / "parts" / f"{32 * 'b'}.json"
            theirs.write_text("mine")
            store.save(COLUMNS)
        assert list((tmp_path / "parts").iterdir()) == [theirs]
        file = tmp_path / "rows.parquet"
        file.write_text(f"edit {k}")
        with Workspace.open(tmp_path, "study", is_shared=True):
            aside = f"rows.parquet.damaged{'2' * (k == 2)}"
            with pytest.warns(UserWarning, match=rf"now '{aside}'"):
                assert opened(tmp_path).rows == []
    asides = sorted(tmp_path.glob("*.damaged*"))
    assert [path.read_text() for path in asides] == ["edit 1", "edit 2"]
