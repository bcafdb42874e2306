"""Files that tell whether they are as they were written: any flipped bit is told."""

import random

import numpy as np
import pandas as pd
import pytest

from jaxurban.errors import InputError
from jaxurban.io import files
from jaxurban.io.tables import RowStore, write_table


def flips(data: bytes, num: int) -> list[bytes]:
    found = []
    for bit in random.Random(0).sample(range(8 * len(data)), min(num, 8 * len(data))):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        found.append(bytes(damaged))
    return found


def test_any_flipped_bit_of_sealed_json_is_told(tmp_path):
    file, value = tmp_path / "a.json", {"rows": [{"cost": 0.1 + 0.2, "name": "ä"}], "none": None}
    files.write_json(file, value)
    assert files.read_json(file) == value
    whole = file.read_bytes()
    for data in [*flips(whole, 300), whole[:-1], whole[:20], b""]:
        file.write_bytes(data)
        with pytest.raises(ValueError, match="not as it was written"):
            files.read_json(file)


def test_any_flipped_bit_of_a_table_of_results_is_told(tmp_path):
    file, rows = tmp_path / "a.parquet", pd.DataFrame({"k": [1, 2], "x_m": [[0.5, 1.5], None], "name": ["a", "b"]})
    write_table(rows, file)
    assert [row["name"] for row in RowStore(file, ["k"]).rows] == pd.read_parquet(file)["name"].tolist() == ["a", "b"]
    whole = file.read_bytes()
    for data in [*flips(whole, 100), whole[:-9], b""]:
        file.write_bytes(data)
        with pytest.raises(InputError, match="is damaged, or not a file of such results"):
            RowStore(file, ["k"])


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
