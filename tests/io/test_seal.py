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


@pytest.mark.parametrize("is_compressed", [False, True])
def test_any_flipped_bit_of_arrays_is_told(tmp_path, is_compressed):
    file, arrays = tmp_path / "a.npz", {"roof_m": np.arange(6.0), "terrain_m": np.ones(5, np.float32)}
    files.write_npz(file, arrays, is_compressed)
    assert all(np.array_equal(values, arrays[name]) for name, values in files.read_npz(file).items())
    with np.load(file) as kept:  # NumPy's own format still
        assert kept.files == [*arrays]
    whole = file.read_bytes()
    for data in [*flips(whole, 200), whole[:-1], b""]:
        file.write_bytes(data)
        with pytest.raises(ValueError, match="not as it was written"):
            files.read_npz(file)


def test_any_flipped_bit_of_a_table_of_results_is_told(tmp_path):
    file, rows = tmp_path / "a.parquet", pd.DataFrame({"k": [1, 2], "x_m": [[0.5, 1.5], None], "name": ["a", "b"]})
    write_table(rows, file)
    assert [row["name"] for row in RowStore(file, ["k"]).rows] == pd.read_parquet(file)["name"].tolist() == ["a", "b"]
    whole = file.read_bytes()
    for data in [*flips(whole, 100), whole[:-9], b""]:
        file.write_bytes(data)
        with pytest.raises(InputError, match="is damaged, or not a file of such results"):
            RowStore(file, ["k"])


def test_files_that_belong_together_are_sealed_together(tmp_path):
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    first.write_text(f'{{"checksum": "{files.BLANK}"}}')
    second.write_text("[1]")
    files.seal(first, second)
    assert files.is_whole(first, second)
    assert not files.is_whole(first)
    second.write_text("[2]")
    assert not files.is_whole(first, second)
    second.unlink()
    assert not files.is_whole(first, second)
