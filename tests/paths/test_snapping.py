"""Snapping: how far a start or goal in a closed cell may be moved, and that it is told."""

import json

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.store import write_zarr
from jaxurban.paths.plan import cost_map
from jaxurban.studies.queries import make_queries
from tests.cli_runs import run
from tests.made_maps import made_maps
from tests.paths.volumes import ends_at, options_of, plan_volume, with_roofs

ALTITUDE_M, SIDE = 20.0, 30
START_CELL, GOAL_CELL = (15, 6), (15, 27)


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    """One block of 13 x 13 cells of 10 m: the start is in its middle, the goal outside."""
    roof_m = np.zeros((SIDE, SIDE))
    roof_m[9:22, 0:13] = 30.0
    return with_roofs(made_maps(SIDE, SIDE), roof_m)


@pytest.fixture(scope="module")
def ends(maps) -> dict:
    return ends_at(maps, START_CELL, GOAL_CELL)


def snapped(way, maps, ends, snap) -> float:
    """Return how far one way of planning moves the start."""
    pairs = [tuple(tuple(map(float, maps.grid.lonlat_of_xy(*xy_m))) for xy_m in ends.values())]
    if way == "study":
        (query,) = make_queries(cost_map(maps, ALTITUDE_M), pairs, snap=snap)
        return 10.0 * np.hypot(*np.subtract(query.start, maps.grid.cell_of_xy(*ends["start_xy_m"])))
    path = {
        "plan": lambda: ju.plan(maps, **ends, altitude_m=ALTITUDE_M, snap=snap),
        "volume": lambda: plan_volume(maps, **ends, start_altitude_m=20.0, snap=snap),
        "many": lambda: ju.plan_many(maps, pairs, altitude_m=ALTITUDE_M, snap=snap, strict=True)[0],
    }[way]()
    return path.snap_distance_m[0]


@pytest.mark.parametrize("way", ["plan", "volume", "many", "study"])
def test_a_place_is_moved_by_at_most_50_m_or_as_far_as_is_said(way, maps, ends):
    for snap, cap in ((True, "50 m"), (69.0, "69 m")):
        told = rf"70 m away, farther than it may be moved \({cap}\).*--snap 7[01]"
        with pytest.raises(InputError, match=told):
            snapped(way, maps, ends, snap)
    assert snapped(way, maps, ends, 75.0) == pytest.approx(70.0, abs=0.01)
    near = ends_at(maps, (15, 10), GOAL_CELL)
    assert snapped(way, maps, near, True) == pytest.approx(30.0, abs=0.01)


def test_the_free_cell_nearest_to_the_place_itself_is_taken(maps, ends):
    corner_m = np.array(maps.grid.xy_of_cell(21, 12))  # of the block; its two free neighbours are as near to its middle
    for aside, cell in (((4.0, 0.0), (21, 13)), ((0.0, 4.0), (22, 12))):
        path = ju.plan(maps, **(ends | {"start_xy_m": tuple(corner_m + aside)}), altitude_m=ALTITUDE_M, snap=True)
        assert tuple(map(int, maps.grid.cell_of_xy(*path.xy_m[0]))) == cell
        assert path.snap_distance_m[0] == pytest.approx(6.0)
    just_as_far = ju.plan(maps, **ends, altitude_m=ALTITUDE_M, snap=70.0)
    assert just_as_far.snap_distance_m[0] == 70.0


def test_how_far_is_told_in_text_json_and_files(maps, ends, tmp_path, capsys):
    write_zarr(maps.ds, tmp_path / "maps")
    arguments = ("plan", tmp_path / "maps", *options_of(maps, **ends))
    files = [tmp_path / f"path{suffix}" for suffix in (".geojson", ".kml", ".plan")]
    code, out, _ = run(capsys, *arguments, "--snap", 80, *(part for file in files for part in ("-o", file)))
    told = "The start was not free: it was moved 70.0 m, to a free cell."
    assert code == 0
    assert told in out
    assert "start 70.0 m, goal 0.0 m" in out
    assert all(told in file.read_text() for file in files)
    (feature,) = json.loads(files[0].read_text())["features"]
    assert feature["properties"]["snap_distance_m"]["start"] == pytest.approx(70.0, abs=0.01)
    facts = json.loads(run(capsys, *arguments, "--snap", 80, "--json")[1])
    assert told in facts["message"]
    assert facts["snap_distance_m"] == pytest.approx({"start": 70.0, "goal": 0.0}, abs=0.01)


@pytest.fixture(scope="module")
def with_court(maps) -> ju.MetricMaps:
    """The block with a court of 3 x 2 cells east of the start's middle: 20 m from it, the street 70 m."""
    roof_m = maps.m("roof").copy()
    roof_m[14:17, 8:10] = 0
    return with_roofs(maps, roof_m)


@pytest.mark.parametrize("way", ["plan", "many", "study"])
def test_a_court_that_is_closed_in_is_passed_for_the_nearest_cell_joined_to_the_other_end(way, with_court, ends):
    assert snapped(way, with_court, ends, 75.0) == pytest.approx(70.0, abs=0.01)
    assert snapped(way, with_court, ends, 25.0) == pytest.approx(20.0, abs=0.01)  # no such cell within reach
    backward = dict(zip(ends, reversed(ends.values()), strict=True))
    path = ju.plan(with_court, **backward, altitude_m=ALTITUDE_M, snap=75.0)
    assert path.status.has_path
    assert path.snap_distance_m == pytest.approx((0.0, 70.0), abs=0.01)
    assert "The goal was not free: it was moved 70.0 m, to a free cell." in path.to_dict()["message"]


def test_two_ends_in_the_block_move_to_cells_that_are_joined(with_court):
    """Together they move the least: both into the court, although the street is as near to the second one."""
    near, far = (
        ju.plan(with_court, **ends_at(with_court, (15, 7), goal), altitude_m=ALTITUDE_M, snap=True).snap_distance_m
        for goal in ((15, 11), (9, 12))
    )
    assert near == pytest.approx((10.0, 20.0), abs=0.01)
    assert far[0] == pytest.approx(10.0)


def test_no_path_names_the_pocket_and_the_nearest_cell_that_is_joined(with_court, ends):
    message = ju.plan(with_court, **ends, altitude_m=ALTITUDE_M, snap=25.0).to_dict()["message"]
    pocket = "The start lies in a pocket of 6 free cells, and the nearest cell that is joined to the goal is 50 m"
    assert pocket in message


def test_a_free_place_says_nothing_of_snapping(maps, tmp_path):
    path = ju.plan(maps, **ends_at(maps, (3, 3), GOAL_CELL), altitude_m=20.0, snap=True)
    assert "not free" not in path.to_dict()["message"]
    assert "not free" not in path.save(tmp_path / "path.kml").read_text()
