"""The benchmarks' arithmetic, and Embree's two ways to scan, on what can be worked out by hand."""

import ast
import json
import sys

import jax
import numpy as np
import pandas as pd
import pytest
import shapely

from benchmarks import engines, gpu, gpu_sections
from benchmarks.against_commit import compare, interval
from benchmarks.common import ROOT, Row, Timing, in_turn, markdown
from benchmarks.embree_peer import Caster, scan_until_first_return, see_satellites
from benchmarks.random_routes import Outlines, legs_m, prices, tables
from benchmarks.structure import (
    SOURCES,
    code_lines_and_tokens,
    files_of,
    import_graph,
    num_arguments,
    num_lazy_imports,
)
from jaxurban.metrics.lidar import Lidar
from tests.embree_scene import roof_triangles, wall_triangles
from tests.made_maps import city_of_boxes

MOST_LAZY = 191  # imports inside functions


@pytest.fixture
def caster() -> Caster:
    """A tower of 10 m x 10 m x 100 m around x = 55, y = 5."""
    polygons, height_m = np.array([shapely.box(50, 0, 60, 10)]), np.array([100.0])
    triangles = np.concatenate(
        [wall_triangles(polygons, height_m), roof_triangles(polygons, height_m)]
    )
    return Caster(triangles.astype(np.float32))


def test_a_ratio_is_of_rates_by_medians_of_cpu_seconds():
    ours = Timing([1.0, 9.0, 2.0], [1.0, 1.0, 4.0], 0.5)
    theirs = Timing([4.0, 3.0, 50.0], [8.0, 9.0, 8.0])
    row = Row("a", "b", "cells", 100, 10, ours, theirs, bar=3)
    assert row.ratio == pytest.approx(100 / (10 / 8))
    assert markdown([row]).endswith("| a | b | cells | 100 | 1.25 | 80 | 3 | 0.50 s |  |")


def test_sides_run_in_turn_after_a_first_run_of_each_which_compiles():
    calls: list[str] = []

    def side(name: str):
        def run():
            calls.append(name)
            return 1.0, (5.0 if len(calls) <= 2 else 2.0)

        return run

    times = in_turn({"a": side("a"), "b": side("b")}, 3)
    assert calls == ["a", "b"] * 4
    assert times["a"] == Timing([1.0] * 3, [2.0] * 3, 3.0)


def test_a_tower_hides_a_satellite_behind_it_and_from_no_other_side(caster):
    directions = np.array([[1.0, 0, 0.5], [-1.0, 0, 0.5]]) / np.sqrt(1.25)
    seen = see_satellites(caster, np.array([[0.0, 5.0]]), np.array([20.0, 90.0]), directions)
    np.testing.assert_array_equal(seen[..., 0], [[False, True], [True, True]])


def test_a_scan_returns_over_the_angle_that_a_tower_fills(caster):
    share = scan_until_first_return(caster, np.array([[0.0, 5.0], [-200.0, 5.0]]), 20.0, Lidar())
    num_azimuths = (
        2 * np.floor(np.rad2deg(np.arctan(5 / 50))) + 1
    )  # whole degrees within the near wall
    np.testing.assert_allclose(share, [num_azimuths / 360, 0])


@pytest.mark.parametrize(
    ("route", "found"),
    [
        ([[0, 4, 20], [100, 4, 20]], (10.0, 4.0)),
        ([[0, 10, 20], [100, 10, 20]], (0.0, 0.0)),  # along the wall
        ([[0, 4, 31], [100, 4, 31]], (0.0, 0.0)),
        ([[0, 4, 31], [58, 4, 31], [100, 4, 20]], (2.0, 2.0)),
    ],
)
def test_what_a_route_cuts_is_measured_once_on_the_outline_and_at_the_lower_end_of_a_climb(
    route, found
):
    both = city_of_boxes(
        [(50, 0, 60, 10), (55, 0, 60, 10)], 30.0, 100.0
    )  # the second lies in the first
    assert Outlines(both.buildings).cut(np.array(route, float)) == pytest.approx(found, abs=1e-4)


def test_clearance_is_to_the_outlines_that_reach_the_lower_end_of_a_leg_and_height_over_those_beneath():
    tower = Outlines(city_of_boxes([(50, 0, 60, 10)], 40.0, 100.0).buildings)
    beside = np.array([[0.0, 22, 30], [100, 22, 30], [100, 60, 30]])
    assert tower.nearest_m(beside) == pytest.approx(12.0)
    assert tower.nearest_m(beside + np.array([0, 0, 20])) == tower.over_roofs_m(beside) == np.inf
    climbing = np.array([[55.0, 14, 60], [55, 14, 20]])
    assert tower.nearest_m(climbing) == pytest.approx(4.0)
    assert tower.over_roofs_m(np.array([[55.0, 14, 60], [55, 4, 46]])) == pytest.approx(6.0)
    np.testing.assert_allclose(legs_m(climbing), [40.0])


@pytest.fixture
def routes() -> pd.DataFrame:
    """Four pairs under two rules: the third without a path under the first rule, the fourth from a place to itself."""
    same = {
        "city": "a",
        "planner": "astar-plus",
        "planned": 9,
        "written": 5,
        "shortest planned": 1.0,
        "shortest": 2.0,
    }
    same |= dict.fromkeys(
        (".geojson", ".kml", ".plan", "in degrees", "over .geojson", "over .kml", "over .plan"), 4.0
    )
    same |= {"apart": 2.5, "dearer": 0.5, "crossed": 0.0, "from outlines": 3.0, "read equal": True}
    lengths_m = {"centre": (100, 200, np.inf, 0), "touched": (110, 200, 300, 0)}
    inside_m = {"centre": (4.0, 0.0, 0.0, 0.0), "touched": (0.0, 0.0, 0.0, 0.0)}
    return pd.DataFrame(
        same
        | {
            "rule": rule,
            "pair": k,
            "length_m": m,
            "cost": 2 * m,
            "inside": inside_m[rule][k],
            "depth": 2.0,
            "refused": float(rule == "centre" and k == 0),
        }
        for rule in lengths_m
        for k, m in enumerate(lengths_m[rule])
    )


def test_shares_count_paths_alone_and_prices_pairs_with_both(routes):
    inside, price, clearance, missions = tables(routes).split("\n\n")
    assert "| a | centre | astar-plus | 3 | 33% | 4.0 m, 4.0 m | 2.0 m | 1 |" in inside
    assert "| a | touched | astar-plus | 4 | 0% | 0.0 m, 0.0 m | 2.0 m | 0 |" in inside
    assert price.endswith(
        "| a | touched | astar-plus | 5.00% (9.5%; 10.0%) | 5.00% (9.5%; 10.0%) |"
    )
    assert clearance.count(" 4.000 m |") == 10
    assert missions.endswith(
        "| 9 (9) | 5 (5) | 1.00 m, 2.00 m | 2.50 m | +50.00% (+50.00%) | 0.000 m | 3.000 m | 4 |"
    )
    assert prices(routes[routes.rule == "touched"]) == {}


CODE = '''
class B(A):
    def f(self, a, /, b, *c, d, **e):  # a comment
        """Return ``[Y, X]`` heights in metres, NaN outside the map."""

        return """not
        a docstring"""
'''


def test_code_lines_are_no_blanks_comments_or_docstrings_and_self_is_no_argument():
    lines, num_tokens = code_lines_and_tokens(CODE)
    assert (len(lines), num_tokens) == (4, 28)
    assert [
        num_arguments(node)
        for node in ast.walk(ast.parse(CODE))
        if isinstance(node, ast.FunctionDef)
    ] == [5]


def test_results_differ_by_name_and_by_share_and_ratios_have_an_interval():
    old, new = {"a": "2.0", "b": "x", "c": "1"}, {"a": "2.5", "b": "x", "d": "1"}
    assert compare(old, new) == [
        "a: 2.0 -> 2.5 (by 2.5e-01)",
        "c: only in OLD (1)",
        "d: only in NEW (1)",
    ]
    assert interval(np.full(15, 1.25)) == (1.25, 1.25)
    low, high = interval(np.linspace(0.9, 1.1, 15))
    assert 0.9 < low < 1.0 < high < 1.1


EXPECTED, NEAR = np.array([1.0, 2.0, np.inf, 4.0]), np.array([1.0, 2.01, np.inf, 4.0])
LEAST = {
    "absolute": 0.01,
    "relative": 0.005,
    "of_largest": 0.0025,
    "share": 0.25,
}  # under which NEAR is right


@pytest.mark.parametrize(
    ("found", "allowed", "is_wrong"),
    [
        (EXPECTED, {}, False),
        (EXPECTED[:3], {}, True),
        (np.where(EXPECTED == 1.0, np.inf, EXPECTED), {"absolute": 1.0}, True),
        (np.minimum(EXPECTED, 4.0), {"absolute": 1.0}, True),
        *[(NEAR, {name: 1.1 * least}, False) for name, least in LEAST.items()],
        *[(NEAR, {name: 0.9 * least}, True) for name, least in LEAST.items()],
    ],
)
def test_answers_of_a_gpu_agree_within_what_is_allowed_and_equal_infinities_do(
    found, allowed, is_wrong
):
    assert gpu.difference(found, EXPECTED, **allowed)["is_wrong"] is is_wrong


def gpu_row(name: str, by: str, seconds: float, answer: str) -> dict:
    return {
        **{
            "section": "lidar",
            "name": name,
            "by": by,
            "seconds": seconds,
            "first_s": 1.5,
            "units": 100.0,
        },
        **{"unit": "rays", "answer": answer, "tolerance": {}, "allowed": "0", "peak_gib": None},
    }


def test_every_row_of_a_gpu_is_held_against_the_first_of_its_name_and_without_one_is_blank(
    tmp_path,
):
    for name, values in (("cpu", [1, 2]), ("gpu", [1, 2]), ("graphs", [1, 3]), ("other", [7, 7])):
        np.save(tmp_path / f"{name}.npy", values)
    rows = [gpu_row("5 m", "CPU", 2.0, "cpu.npy"), gpu_row("2 m", "CPU", 1.0, "other.npy")]
    blank = gpu.blanks(rows[:1])[1]
    assert (blank["by"], gpu.cells_of(blank)[3:]) == (gpu.GPU, [""] * 7)
    rows += [gpu_row("5 m", "GPU", 0.5, "gpu.npy"), gpu_row("5 m", "graphs", 0.5, "graphs.npy")]
    gpu.check(rows, tmp_path)
    assert [each.get("is_wrong") for each in rows] == [None, None, False, True]
    assert gpu.cells_of(rows[2])[2:7] == ["GPU", "0.5", "200 rays/s", "4", "1.50 s"]
    assert ["too much" in gpu.cells_of(row)[8] for row in rows[2:]] == [False, True]


def test_every_section_of_a_gpu_has_its_seconds_and_they_fit_into_the_run():
    assert list(gpu.SECTIONS) == list(gpu_sections.SECTIONS)
    assert set(gpu.LOOPS) <= set(gpu.SECTIONS)
    assert gpu.BUDGET_S < 480


@pytest.mark.slow
def test_a_section_of_a_gpu_that_breaks_off_fails_the_run_and_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(gpu, "make_inputs", lambda folder, is_small: None)  # so that none loads
    monkeypatch.setattr(gpu, "gpu_name", lambda: None)
    report = tmp_path / "gpu.json"
    monkeypatch.setattr(sys, "argv", ["gpu", "occlusion", "--small", "-o", str(report)])
    assert gpu.main() == 1
    broken, blank = json.loads(report.read_text())["rows"]
    assert broken["name"] == blank["name"]
    assert broken["name"].startswith("broke off: FileNotFoundError")


def test_programs_are_counted_at_the_first_call_of_a_shape_alone():
    events, doubled = engines.count_programs(), jax.jit(lambda values: 2 * values)
    values, longer = np.ones(17, np.float32), np.ones(18, np.float32)

    def num_programs(argument: np.ndarray) -> float:
        cost = engines.measured(lambda: jax.block_until_ready(doubled(argument)), events)
        return cost.num_compiled + cost.num_loaded

    assert [num_programs(each) for each in (values, values, longer)] == [1, 0, 1]


@pytest.mark.slow
def test_a_run_whose_memory_was_given_back_leaves_the_next_ones_greatest_memory_alone():
    events, mib = engines.count_programs(), 2**17
    large = engines.measured(lambda: np.ones(400 * mib), events)
    small = engines.measured(lambda: np.ones(mib), events)
    assert 380 < large.peak_mib - small.peak_mib < 420


def test_cells_of_engines_are_held_against_the_first_and_runs_have_their_own():
    cold = engines.Cost(16.0, 20.0, 700.0, 4, 0, 1.5)
    warm = engines.Cost(0.5, 0.25, 700.0, 0, 0, 0.0)
    other = engines.Cost(4.0, 30.0, 600.0, 0, 7, 0.25)
    sides = [[cold, warm], [other, warm]]
    assert engines.cells(sides, 0) == [
        "16.0 / 20.0 / 700 / 4 + 0 / 1.50",
        "4.00 / 30.0 / 600 / 0 + 7 / 0.25 (0.25, 1.50)",
    ]
    assert engines.cells(sides, 1)[1].endswith(" (1.00, 1.00)")


def test_an_excepted_import_is_an_arrow_upward_and_modules_that_import_each_other_are_a_circle(
    tmp_path,
):
    package = tmp_path / "jaxurban"
    files = {
        "__init__": "",
        "high": "import jaxurban.low\nimport jaxurban.beside",
        "beside": "import jaxurban.high",
        "low": "def call():\n    import jaxurban.high",
        "none": "import jaxurban.high",  # in no layer
    }
    package.mkdir()
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    (tmp_path / "pyproject.toml").write_text(
        '[[tool.importlinter.contracts]]\ntype = "layers"\n'
        'layers = ["jaxurban.high : jaxurban.beside", "jaxurban.low"]\n'
        'ignore_imports = ["jaxurban.low -> jaxurban.high"]\n'
    )
    graph = import_graph(tmp_path)
    assert graph.upward == ["jaxurban.low -> jaxurban.high"]
    assert graph.circles == [["jaxurban.beside", "jaxurban.high", "jaxurban.low"]]


def test_no_import_of_jaxurban_goes_upward_nor_a_circle_beyond_two_files():
    graph = import_graph(ROOT)
    assert graph.upward == []
    assert [circle for circle in graph.circles if len(circle) > 2] == []


def test_imports_inside_functions_are_counted_once_each():
    inner = "def f():\n    import a\n    def g():\n        from b import c, d\n"
    assert num_lazy_imports(f"import e\nif True:\n    import h\n{inner}") == 2


def test_imports_inside_functions_grow_no_more():
    files = files_of(ROOT, SOURCES, ".py")
    assert sum(num_lazy_imports(file.read_text(encoding="utf-8")) for file in files) <= MOST_LAZY
