"""The benchmarks' arithmetic, and Embree's two ways to scan, on what can be worked out by hand."""

import ast
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from benchmarks.against_commit import interval
from benchmarks.common import Growth, Timing, in_turn, markdown, row
from benchmarks.embree_peer import Caster, scan_until_first_return, see_satellites
from benchmarks.missions import Mission, clearance_m, legs_m, summary
from benchmarks.route_soundness import Outlines, Route, by_planner, price
from benchmarks.same_results import compare
from benchmarks.structure import code_lines_and_tokens, num_arguments, record_classes
from jaxurban.metrics.lidar import LidarParams
from jaxurban.world.city import Buildings
from tests.embree_scene import roof_triangles, wall_triangles


def caster_of_one_tower() -> Caster:
    """A tower of 10 m x 10 m x 100 m around x = 55, y = 5."""
    polygons, height_m = np.array([shapely.box(50, 0, 60, 10)]), np.array([100.0])
    triangles = np.concatenate([wall_triangles(polygons, height_m), roof_triangles(polygons, height_m)])
    return Caster(triangles.astype(np.float32))


def test_a_ratio_is_ours_over_theirs_by_medians():
    ours = Timing([1.0, 9.0, 2.0], [1.0, 1.0, 1.0])
    theirs = Timing([4.0, 3.0, 50.0], [8.0, 8.0, 8.0])
    found = row("a", "b", "cells", (100, ours), (10, theirs))
    assert found.ours_per_s == 50
    assert found.ratio == pytest.approx(50 / 2.5)
    assert found.ratio_cpu == pytest.approx(80)


def test_sides_run_in_turn_after_a_first_run_of_each():
    calls: list[str] = []

    def side(name: str):
        def run():
            calls.append(name)
            return (5.0 if len(calls) <= 2 else 2.0), 1.0

        return run

    times = in_turn({"a": side("a"), "b": side("b")}, 3)
    assert calls == ["a", "b"] * 4
    assert times["a"] == Timing([2.0] * 3, [1.0] * 3, 3.0)


def test_the_slope_of_time_that_grows_with_the_square_of_cells_is_2():
    growth = Growth("a", [2, 4, 8], [4.0, 16.0, 64.0], [2.0, 4.0, 8.0], 1.1)
    assert growth.slope == pytest.approx(2)
    assert growth.slope_cpu == pytest.approx(1)
    assert "| 2.00 | 1.00 |" in markdown([], [growth])


def test_a_tower_hides_a_satellite_behind_it_and_from_no_other_side():
    directions = np.array([[1.0, 0, 0.5], [-1.0, 0, 0.5]]) / np.sqrt(1.25)
    seen = see_satellites(caster_of_one_tower(), np.array([[0.0, 5.0]]), np.array([20.0, 90.0]), directions)
    np.testing.assert_array_equal(seen[..., 0], [[False, True], [True, True]])


def test_a_scan_returns_over_the_angle_that_a_tower_fills():
    points_m = np.array([[0.0, 5.0], [-200.0, 5.0]])
    params = LidarParams()
    share = scan_until_first_return(caster_of_one_tower(), points_m, 20.0, params)
    num_azimuths = 2 * np.floor(np.rad2deg(np.arctan(5 / 50))) + 1  # whole degrees within the near wall
    np.testing.assert_allclose(share, [num_azimuths / 360, 0])


def test_what_a_route_cuts_is_measured_once_on_the_outline_and_at_the_lower_end_of_a_climb():
    polygons = np.array([shapely.box(50, 0, 60, 10), shapely.box(55, 0, 60, 10)])  # the second lies in the first
    zero = np.zeros(2)
    outlines = Outlines(Buildings(polygons, zero + 30.0, zero, zero.astype(np.uint8), zero > 0))
    through = [[0, 4, 20], [100, 4, 20]]
    assert outlines.cut(np.array(through, float)) == pytest.approx((10.0, 4.0), abs=1e-4)
    assert outlines.cut(np.array([[0, 10, 20], [100, 10, 20]], float)) == (0.0, 0.0)  # along the wall
    assert outlines.cut(np.array([[0, 4, 31], [100, 4, 31]], float)) == (0.0, 0.0)
    assert outlines.cut(np.array([[0, 4, 31], [58, 4, 31], [100, 4, 20]], float))[0] == pytest.approx(2.0, abs=1e-4)


def test_shares_count_paths_alone_and_prices_pairs_with_both():
    def route(rule: str, length_m: float, inside_m: float) -> Route:
        return Route(rule, "astar-plus", "", length_m, 2 * length_m, inside_m, inside_m / 2)

    none = np.inf
    centre = [route("centre", length_m, inside_m) for length_m, inside_m in ((100, 4), (200, 0), (none, 0))]
    touched = [route("touched", length_m, 0) for length_m in (110, 200, none, 400)]
    others = [
        Route(rule, planner, "", 10, 10, 0, 0) for rule in ("touched", "centre") for planner in ("theta-star", "volume")
    ]
    figures = by_planner(centre + touched + others)
    assert figures["centre"]["astar-plus"] == {
        "paths": 2,
        "share_cutting": 0.5,
        "mean_inside_of_those_m": 4.0,
        "most_inside_m": 4.0,
        "deepest_m": 2.0,
    }
    assert figures["touched"]["astar-plus"]["share_cutting"] == 0.0
    prices = price(centre + touched + others)["astar-plus"]
    assert prices["length_mean"] == pytest.approx(5.0)
    assert prices["length_most"] == prices["cost_most"] == pytest.approx(10.0)


CODE = '''"""A module."""

# a comment
class A(NamedTuple):
    """In metres."""

    x: int


class B(A):
    def f(self, a, /, b, *c, d, **e):
        """Return ``[Y, X]`` heights in metres, NaN outside the map."""
        return """not
        a docstring"""
'''


def test_code_lines_are_no_blanks_comments_or_docstrings_and_self_is_no_argument():
    tree = ast.parse(CODE)
    lines, num_tokens = code_lines_and_tokens(CODE)
    assert (len(lines), num_tokens) == (6, 37)
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    assert record_classes(classes) == ["A", "B"]
    assert [num_arguments(node) for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)] == [5]


def test_results_differ_by_name_and_by_share_and_ratios_have_an_interval():
    old, new = {"a": "2.0", "b": "x", "c": "1"}, {"a": "2.5", "b": "x", "d": "1"}
    assert compare(old, new) == ["a: 2.0 -> 2.5 (by 2.5e-01)", "c: only in OLD (1)", "d: only in NEW (1)"]
    assert interval(np.full(15, 1.25)) == (1.25, 1.25)
    low, high = interval(np.linspace(0.9, 1.1, 15))
    assert 0.9 < low < 1.0 < high < 1.1


def test_a_missions_clearance_is_to_the_outlines_that_reach_the_lower_end_of_a_leg():
    one = np.zeros(1)
    tower = Buildings(np.array([shapely.box(50, 0, 60, 10)]), one + 40, one, one.astype(np.uint8), one > 0)
    scene = SimpleNamespace(city=SimpleNamespace(buildings=tower))
    beside = np.array([[0.0, 22, 30], [100, 22, 30], [100, 60, 30]])
    assert clearance_m(scene, beside) == pytest.approx(12.0)
    assert clearance_m(scene, beside + np.array([0, 0, 20])) == np.inf
    climbing = np.array([[55.0, 14, 60], [55, 14, 20]])
    assert clearance_m(scene, climbing) == pytest.approx(4.0)
    np.testing.assert_allclose(legs_m(climbing), [40.0])


def test_the_row_of_missions_tells_how_many_were_read_back_equal():
    flown = [Mission("a", "land", 100 * k, 10 * k, 1.0, 5.0 * k, 2.0, 3.0 * k, 1.0, 0.0, 0, k - 1) for k in (1, 2)]
    row_ = summary(flown)
    assert (row_[0], row_[1], row_[2], row_[-1]) == ("2", "150 (200)", "15 (20)", "1")
