"""The GPU benchmark's check of answers, and its table, on what can be worked out by hand."""

import numpy as np
import pytest

from benchmarks import gpu, gpu_sections
from benchmarks.gpu import GPU, blanks, check, difference, table


def test_answers_agree_within_what_is_allowed_and_equal_infinities_do():
    expected = np.array([1.0, 2.0, np.inf, 4.0])
    assert difference(expected.copy(), expected)["is_wrong"] is False
    near = np.where(expected == 2.0, 2.01, expected)
    assert difference(near, expected)["is_wrong"]
    assert difference(near, expected)["most"] == pytest.approx(0.01)
    assert difference(near, expected)["share_off"] == pytest.approx(0.25)
    for allowed in ({"absolute": 0.011}, {"relative": 0.006}, {"of_largest": 0.003}, {"share": 0.25}):
        assert not difference(near, expected, **allowed)["is_wrong"]
    for allowed in ({"absolute": 0.009}, {"relative": 0.004}, {"of_largest": 0.002}, {"share": 0.24}):
        assert difference(near, expected, **allowed)["is_wrong"]


def test_an_infinity_for_a_number_and_another_shape_are_wrong():
    assert difference(np.array([1.0, np.inf]), np.array([1.0, 1.0]), absolute=1.0)["is_wrong"]
    assert difference(np.array([1.0, 1.0]), np.array([1.0, np.inf]), absolute=1.0)["is_wrong"]
    assert "shape" in difference(np.zeros(3), np.zeros(4))["differs"]


def row(name: str, by: str, seconds: float, answer: str) -> dict:
    return {
        **{"section": "lidar", "name": name, "by": by, "seconds": seconds, "first_s": 1.5, "units": 100.0},
        **{"unit": "rays", "answer": answer, "tolerance": {}, "allowed": "0", "peak_gib": None},
    }


def test_every_row_is_held_against_the_first_of_its_name(tmp_path):
    for name, values in (("cpu", [1, 2]), ("gpu", [1, 2]), ("graphs", [1, 3]), ("other", [7, 7])):
        np.save(tmp_path / f"{name}.npy", values)
    rows = [row("5 m", "CPU", 2.0, "cpu.npy"), row("2 m", "CPU", 1.0, "other.npy")]
    rows += [row("5 m", "GPU", 0.5, "gpu.npy"), row("5 m", "graphs", 0.5, "graphs.npy")]
    check(rows, tmp_path)
    assert [each.get("is_wrong") for each in rows] == [None, None, False, True]
    lines = table(rows).splitlines()
    assert "| GPU | 0.5 | 200 rays/s | 4 | 1.50 s |" in lines[4]
    assert "too much" in lines[5]
    assert "too much" not in lines[4]


def test_without_a_gpu_its_figures_are_blank():
    shown = blanks([row("5 m", "CPU", 2.0, "cpu.npy"), row("5 m", "CPU, jax", 2.0, "cpu.npy")])
    assert [each["by"] for each in shown] == ["CPU", "CPU, jax", GPU]
    assert table(shown).splitlines()[-1] == "| lidar | 5 m | GPU |  |  |  |  |  |  |  |"


def test_every_section_has_its_seconds_and_they_fit_into_the_run():
    assert list(gpu.SECTIONS) == list(gpu_sections.SECTIONS)
    assert set(gpu.LOOPS) <= set(gpu.SECTIONS)
    assert gpu.BUDGET_S < 600
