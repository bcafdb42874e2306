"""Where planners may fly: no cell that a building touches, by any way; what is said where that closes the way."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.paths import snapping
from jaxurban.paths.queries import IN_METRES
from jaxurban.planners.base import Status, islands_of
from tests.made_maps import city_of_boxes
from tests.volumes import plan_volume

X_M, Y_M = 500_000.0, 4_500_000.0  # southwest corner of the region
ENDS = {"start": ju.XY(X_M + 102.5, Y_M + 12.5), "goal": ju.XY(X_M + 102.5, Y_M + 187.5)}


def walled(*walls, height_m=50.0):
    """Return maps of a square with walls: x_min, y_min, x_max, y_max each, metres from its corner."""
    city = city_of_boxes(walls, height_m, 200.0, (X_M, Y_M))
    return ju.build_maps(city, resolution_m=5.0, altitudes_m=(20.0, 60.0))


WALLS = (-50, 97.6, 97.4, 102.4), (109.4, 97.6, 250, 102.4)


@pytest.fixture(scope="module")
def gap():
    """A wall across the region with a gap of 12 m, whose edges lie beyond the middle of cells."""
    return walled(*WALLS)


@pytest.mark.parametrize("planner", ["ptp", "astar-plus", "theta-star", "bitstar-plus"])
def test_no_path_enters_a_cell_that_a_building_touches(gap, planner):
    heights_m = gap.m("roof_touched")
    assert (heights_m > gap.m("roof")).any()
    path = ju.plan(gap, **ENDS, altitude_m=20.0, planner=planner, cost_model="line", budget_s=0.2)
    assert path.settings["obstacles"] == "touched"
    if path.status.has_path:
        line = shapely.LineString(path.xy_m - (X_M, Y_M))
        assert not shapely.intersects(line, shapely.box(*np.transpose(WALLS))).any()
    else:
        assert path.status is Status.BLOCKED


def test_a_wall_between_centres_of_cells_stops_the_straight_line_only_under_the_cautious_rule():
    maps = walled((-50, 98.0, 250, 102.4))  # rows of centres lie at 97.5 and 102.5 m
    blocked = ju.plan(maps, **ENDS, altitude_m=20.0, planner="ptp")
    assert blocked.status is Status.BLOCKED
    through = ju.plan(maps.with_obstacles("centre"), **ENDS, altitude_m=20.0, planner="ptp")
    assert through.status.has_path
    assert through.settings["obstacles"] == "centre"


def test_the_cautious_mask_closes_all_that_the_paper_closes(gap):
    for z_m in (10.0, 20.0, 49.0, 60.0):
        assert not np.any(gap.is_free(z_m) & ~gap.is_free(z_m, "centre"))
    assert gap.is_free(20.0).sum() < gap.is_free(20.0, "centre").sum()
    np.testing.assert_array_equal(gap.is_free(60.0), gap.is_free(60.0, "centre"))


def test_what_is_blocked_by_hand_and_a_roof_of_unknown_height_are_blocked(gap):
    closed = ju.MetricMaps(gap.ds.assign(obstacle=gap.ds["obstacle"] * 0 + 1))
    unknown = ju.MetricMaps(gap.ds.assign(roof_touched=gap.ds["roof_touched"] * np.float32(np.nan)))
    assert not any(
        maps.is_free(z_m).any() for maps, z_m in ((closed, 20.0), (unknown, 20.0), (unknown, 21.0))
    )


NARROW = (-50, 97.6, 97.4, 102.4), (103.5, 97.6, 250, 102.4)  # a gap of 6.1 m: one cell by centres


def test_no_path_says_what_would_join_start_and_goal_and_what_would_not():
    narrow, closed = walled(*NARROW), walled((-50, 95.0, 250, 105.0), height_m=90.0)
    joined = "Start and goal are joined at 60 m. Looser constraints, finer maps or known heights may join them too"
    for path, words in (
        (ju.plan(narrow, **ENDS, altitude_m=20.0), joined),
        (
            plan_volume(narrow, **ENDS, max_altitude_m=20.0),
            "joined with max_altitude_m 60 m. Looser constraints",
        ),
        (
            ju.plan(closed, **ENDS, altitude_m=20.0),
            "not joined at a greater altitude of these maps",
        ),
        (
            plan_volume(closed, **ENDS, max_altitude_m=20.0),
            "not joined at a greater altitude of these maps",
        ),
    ):
        assert path.status is Status.NO_PATH
        assert words in path.to_dict()["message"]
    assert (
        ju.plan(narrow.with_obstacles("centre"), **ENDS, altitude_m=20.0).status is Status.OPTIMAL
    )
    assert plan_volume(narrow, **ENDS, max_altitude_m=60.0).status is Status.OPTIMAL
    assert "altitude of these maps" not in plan_volume(closed, **ENDS).to_dict()["message"]


def test_what_would_join_is_found_once_for_a_batch(monkeypatch):
    maps, labelled = walled(*NARROW), []

    def label_and_count(is_free, cuts_corners):
        labelled.append(is_free)
        return islands_of(is_free, cuts_corners)

    monkeypatch.setattr(snapping, "islands_of", label_and_count)
    ends = pd.DataFrame([[*ENDS["start"][:2], *ENDS["goal"][:2]]] * 3, columns=list(IN_METRES))
    answers = ju.plan_many(maps, ends, altitude_m=20.0, progress=False).to_dataframe()
    assert all("joined at 60 m" in message for message in answers["message"])
    assert len(labelled) == 2  # at 20 and at 60 m


def test_a_study_of_a_route_that_is_not_there_says_what_would_join_its_ends(tmp_path):
    maps = walled(*NARROW)
    ends = [maps.grid.lonlat_of_xy(*xy_m[:2]) for xy_m in ENDS.values()]
    found = ju.studies.sensitivity(maps, tmp_path, [ends], altitudes_m=[20.0], progress=False)
    assert found.route is None
    assert "joined at 60 m" in found.rows.note.item()
    assert "joined at 60 m" in (tmp_path / "report.md").read_text()


def test_ends_that_only_a_touch_closes_are_told_apart_and_name_the_rule_under_which_they_are_free(
    gap,
):
    row, col = np.argwhere(gap.is_free(20.0, "centre") & ~gap.is_free(20.0))[0]
    ends = {**ENDS, "start": ju.XY(*map(float, gap.grid.xy_of_cell(row, col)))}
    with pytest.raises(InputError, match="in a cell that an obstacle touches"):
        ju.plan(gap, **ends, altitude_m=20.0)
    with pytest.raises(
        InputError, match="in a cell that an obstacle touches at 20 m; the lowest free level there"
    ):
        plan_volume(gap, **ends, start_altitude_m=20.0)
    by_centre = gap.with_obstacles("centre")
    path = ju.plan(by_centre, **ends, altitude_m=20.0)
    assert ju.fit.demonstrations([path], by_centre)
    (moved,) = ju.fit.demonstrations([path], gap)
    assert "The start was not free: it was moved" in moved.note


def test_maps_without_touched_roofs_are_refused_for_planning(gap):
    old = ju.MetricMaps(gap.ds.drop_vars("roof_touched"))
    with pytest.raises(InputError, match="these maps hold no 'roof_touched'"):
        ju.plan(old, **ENDS, altitude_m=20.0)
    assert ju.plan(old.with_obstacles("centre"), **ENDS, altitude_m=20.0).status.has_path
    with pytest.raises(InputError, match="'touched', 'centre'"):
        replace(gap, rule="edges")
