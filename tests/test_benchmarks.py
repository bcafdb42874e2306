"""The benchmarks' arithmetic, and Embree's two ways to scan, on what can be worked out by hand."""

import ast

import numpy as np
import pandas as pd
import pytest
import shapely

from benchmarks.against_commit import compare, interval
from benchmarks.common import Growth, Timing, in_turn, markdown, row
from benchmarks.embree_peer import Caster, scan_until_first_return, see_satellites
from benchmarks.random_routes import Outlines, legs_m, prices, tables
from benchmarks.structure import code_lines_and_tokens, num_arguments, record_classes
from jaxurban.metrics.lidar import Lidar
from jaxurban.world.city import Footprints
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
    params = Lidar()
    share = scan_until_first_return(caster_of_one_tower(), points_m, 20.0, params)
    num_azimuths = 2 * np.floor(np.rad2deg(np.arctan(5 / 50))) + 1  # whole degrees within the near wall
    np.testing.assert_allclose(share, [num_azimuths / 360, 0])


def test_what_a_route_cuts_is_measured_once_on_the_outline_and_at_the_lower_end_of_a_climb():
    polygons = np.array([shapely.box(50, 0, 60, 10), shapely.box(55, 0, 60, 10)])  # the second lies in the first
    zero = np.zeros(2)
    outlines = Outlines(Footprints(polygons, zero + 30.0, zero, zero.astype(np.uint8), zero > 0))
    through = [[0, 4, 20], [100, 4, 20]]
    assert outlines.cut(np.array(through, float)) == pytest.approx((10.0, 4.0), abs=1e-4)
    assert outlines.cut(np.array([[0, 10, 20], [100, 10, 20]], float)) == (0.0, 0.0)  # along the wall
    assert outlines.cut(np.array([[0, 4, 31], [100, 4, 31]], float)) == (0.0, 0.0)
    assert outlines.cut(np.array([[0, 4, 31], [58, 4, 31], [100, 4, 20]], float))[0] == pytest.approx(2.0, abs=1e-4)


def routes() -> pd.DataFrame:
    """Four pairs under two rules: the third without a path under the first rule, the fourth from a place to itself."""
    same = {"city": "a", "planner": "astar-plus", "planned": 9, "written": 5, "shortest planned": 1.0, "shortest": 2.0}
    same |= dict.fromkeys((".geojson", ".kml", ".plan", "in degrees", "over .geojson", "over .kml", "over .plan"), 4.0)
    same |= {"apart": 2.5, "dearer": 0.5, "crossed": 0.0, "from outlines": 3.0, "read equal": True}
    lengths_m = {"centre": (100, 200, np.inf, 0), "touched": (110, 200, 300, 0)}
    inside_m = {"centre": (4.0, 0.0, 0.0, 0.0), "touched": (0.0, 0.0, 0.0, 0.0)}
    return pd.DataFrame(
        same | {"rule": rule, "pair": k, "length_m": m, "cost": 2 * m, "inside": inside_m[rule][k], "depth": 2.0}
        for rule in lengths_m
        for k, m in enumerate(lengths_m[rule])
    )


def test_shares_count_paths_alone_and_prices_pairs_with_both():
    inside, price, clearance, missions = tables(routes()).split("\n\n")
    assert "| a | centre | astar-plus | 3 | 33% | 4.0 m, 4.0 m | 2.0 m |" in inside
    assert "| a | touched | astar-plus | 4 | 0% | 0.0 m, 0.0 m | 2.0 m |" in inside
    assert price.endswith("| a | touched | astar-plus | 5.00% (9.5%; 10.0%) | 5.00% (9.5%; 10.0%) |")
    assert clearance.count(" 4.000 m |") == 10
    assert missions.endswith("| 9 (9) | 5 (5) | 1.00 m, 2.00 m | 2.50 m | +50.00% (+50.00%) | 0.000 m | 3.000 m | 4 |")
    assert prices(routes()[lambda rows: rows.rule == "touched"]) == {}


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


def test_clearance_is_to_the_outlines_that_reach_the_lower_end_of_a_leg_and_height_over_those_beneath():
    one = np.zeros(1)
    outlines = Outlines(
        Footprints(np.array([shapely.box(50, 0, 60, 10)]), one + 40, one, one.astype(np.uint8), one > 0)
    )
    beside = np.array([[0.0, 22, 30], [100, 22, 30], [100, 60, 30]])
    assert outlines.nearest_m(beside) == pytest.approx(12.0)
    assert outlines.nearest_m(beside + np.array([0, 0, 20])) == outlines.over_roofs_m(beside) == np.inf
    climbing = np.array([[55.0, 14, 60], [55, 14, 20]])
    assert outlines.nearest_m(climbing) == pytest.approx(4.0)
    assert outlines.over_roofs_m(np.array([[55.0, 14, 60], [55, 4, 46]])) == pytest.approx(6.0)
    np.testing.assert_allclose(legs_m(climbing), [40.0])
