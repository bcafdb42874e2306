"""What is told of a planned route without being asked for: no fix, clearance and roofs, ends over roofs."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.flights.export.write import FORMATS
from jaxurban.typing import PlannedPath
from tests.cli_runs import run
from tests.guess_records import NOMINAL, attribute, heights
from tests.made_maps import made_maps
from tests.volumes import ends_at, options_of, plan_volume, with_roofs

ALTITUDE_M, ROW = 20.0, 20


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    """Open ground of 10 m cells, a roof of 12 m under columns 30 to 39, and a tower north of columns 60 to 69."""
    maps = made_maps(40, 100, altitudes_m=(20.0, 60.0))
    shape = maps.grid.shape
    roof_m, visible, hdop = np.zeros(shape, np.float32), np.full(shape, 7, np.uint8), np.ones(shape)
    roof_m[ROW + 4 : ROW + 9, 60:70] = 30.0
    roof_m[ROW, 30:40] = 12.0
    for low, high in ((25, 27), (40, 50), (52, 53), (70, 75), (85, 88)):
        visible[:, low:high], hdop[:, low:high] = (
            4,
            np.inf,
        )  # of two systems, whose clocks are two unknowns
    by_cell = {"num_visible": visible, "hdop": hdop}
    return with_roofs(
        maps,
        roof_m,
        **{name: maps.ds["num_visible"] * 0 + values for name, values in by_cell.items()},
    )


def levels_of(path, maps) -> dict[str, str]:
    """Return the level of each caution by its first word."""
    return {line.split(":")[0]: line.level for line in ju.cautions(path, maps)}


def straight(maps, first=10, last=90, **options) -> PlannedPath:
    """Return the path due east along the middle row, from the middle of one cell to that of another."""
    ends = ends_at(maps, (ROW, first), (ROW, last))
    return ju.plan(maps, **ends, altitude_m=ALTITUDE_M, objective="distance", **options)


def with_guesses(maps, part) -> ju.MetricMaps:
    """Return maps whose roofs in a part are guessed, each bounded 3 m above its guess, and whose sky is nominal."""
    is_guessed = np.zeros(maps.grid.shape, bool)
    is_guessed[part] = True
    limit_m = (maps.m("roof_touched") + 3) * is_guessed
    ds = maps.ds.assign(roof_guessed=(("y", "x"), is_guessed), roof_limit=(("y", "x"), limit_m))
    return ju.MetricMaps(ds.assign_attrs(attribute(*GUESSES)))


GUESSES = heights(0.4), NOMINAL


LOW_ROOF, TOWER = np.s_[ROW, 30:40], np.s_[ROW + 4 : ROW + 9, 60:70]


def test_what_the_maps_guess_is_the_first_caution_with_the_length_past_guessed_roofs(maps):
    guessed = with_guesses(maps, LOW_ROOF)
    first, *others = ju.cautions(straight(guessed), guessed)
    # 100 m over the roof and 50 m on either side of it
    assert first == (
        "Guessed: 40 % of heights, nominal satellites; 200 of 800 m of the route pass within 50 m of guessed roofs, "
        "100 m over them."
    )
    assert first.level == "guess"
    assert any("leaves 8.0 m above a guessed roof of 12.0 m, " in line for line in others)
    assert any("35.0 m away, " in line for line in others)
    assert not any("uess" in line for line in ju.cautions(straight(maps), maps))
    (table,) = {ju.explain(straight(each), each).table() for each in (guessed, maps)}
    assert "uess" not in table  # the first caution says it once


def test_only_what_rests_on_a_guessed_roof_is_called_guessed(maps):
    far = with_guesses(maps, TOWER)
    told = ju.cautions(straight(far), far)
    assert any("above a roof of 12.0 m, " in line and line.level == "note" for line in told)
    assert " of 800 m of the route pass within 50 m of guessed roofs, 0 m over them" in told[0]
    over = with_guesses(maps, LOW_ROOF)
    (start,) = (
        line for line in ju.cautions(straight(over, first=33), over) if line.startswith("The start")
    )
    assert (start, start.level) == (
        "The start is in a cell that a guessed roof of 12.0 m touches, over it or beside it.",
        "guess",
    )


def test_a_stretch_without_a_fix_and_a_roof_close_below_are_beyond_limits(maps):
    assert levels_of(straight(maps), maps) == {"GPS": "limit", "Buildings": "note", "Roofs": "note"}
    roof_m = np.where(maps.m("roof") == 12.0, ALTITUDE_M - 0.4, maps.m("roof"))
    low = with_roofs(maps, roof_m)
    assert (
        levels_of(straight(low, constraints=ju.Constraints(vertical_clearance_m=0.0)), low)["Roofs"]
        == "limit"
    )


def test_every_file_of_a_route_says_what_is_guessed(maps, tmp_path):
    guessed = with_guesses(maps, LOW_ROOF)
    path = straight(guessed)
    told = ju.cautions(path, guessed)
    assert all(told[0] in path.save(tmp_path / f"route{suffix}").read_text() for suffix in FORMATS)
    properties = json.loads((tmp_path / "route.geojson").read_text())["features"][0]["properties"]
    assert properties["cautions"] == told == path.cautions == ju.explain(path, guessed).cautions
    assert json.loads((tmp_path / "route.plan").read_text())["note"].startswith(told[0])
    several = ju.plan_many(guessed, [(path.lonlat[0], path.lonlat[-1])] * 2, altitude_m=ALTITUDE_M)
    several.save(tmp_path / "several.geojson")
    features = json.loads((tmp_path / "several.geojson").read_text())["features"]
    assert [each["properties"]["cautions"] for each in features] == [
        [told[0].split(";")[0] + "."]
    ] * 2


def test_what_was_asked_of_clearances_is_the_limit(maps):
    path = straight(maps)  # 35 m from the tower, 8 m over the roof
    for beside_m, roof_m, level in ((34.0, 8.0, "note"), (36.0, 8.5, "limit")):
        limits = {"clearance_m": beside_m, "vertical_clearance_m": roof_m}
        levels = levels_of(replace(path, settings=path.settings | {"limits": limits}), maps)
        assert (levels["Buildings"], levels["Roofs"]) == (level, level)


def test_segments_without_a_fix_are_told_with_their_places(maps):
    assert ju.cautions(straight(maps), maps)[0] == (
        "GPS: no fix on 210 of 800 m: from 295 to 395 m, 595 to 645 m, 745 to 775 m along the route and 2 shorter."
    )
    always = ju.MetricMaps(maps.ds.assign(hdop=maps.ds["gps"] * 0 + 2))
    assert "GPS" not in levels_of(straight(always), always)
    series = ju.MetricMaps(maps.ds.drop_vars("hdop"))
    unknown = "GPS: these maps hold no hdop, so where there is no fix is not known."
    assert unknown in ju.cautions(straight(maps), series)


def test_a_route_nearer_than_3_m_to_a_wall_says_so_first_with_the_place(maps):
    beside = straight(maps)
    tall = np.argwhere(maps.m("roof_touched") > beside.z_m[0])
    x_m, y_m = maps.grid.xy_of_cell(*tall[0])
    half_m = maps.grid.resolution_m / 2
    for away_m, is_first in ((2.0, True), (2.99, True), (3.0, False)):
        xy_m = np.array([[x_m - half_m - away_m, y_m], [x_m - half_m - away_m, y_m + 0.1]])
        there = replace(beside, xy_m=xy_m, z_m=beside.z_m[:1].repeat(2))
        said = ju.cautions(there, maps)
        lon, lat = maps.grid.lonlat_of_xy(*xy_m.mean(axis=0))
        near = f"height is {away_m:.1f} m away from {lon:.6f},{lat:.6f}, 0 m along the route"
        assert (near in said[0]) == is_first
        assert sum("reaches the flight height" in sentence for sentence in said) == 1


def test_the_nearest_building_the_least_height_over_a_roof_and_an_end_over_one_are_told(maps):
    told = ju.cautions(straight(maps), maps)
    assert re.match(
        r"Buildings: the nearest that reaches the flight height is 35\.0 m away, (49|5\d)\d m along the route\.",
        told[1],
    )
    assert re.match(
        r"Roofs: the lowest pass leaves 8\.0 m above a roof of 12\.0 m, [12]\d\d m along the route\.",
        told[2],
    )
    for options, ends in (({}, []), ({"first": 33}, ["start"]), ({"last": 33}, ["goal"])):
        told = ju.cautions(straight(maps, **options), maps)
        at_ends = [line for line in told if line.startswith(("The start", "The goal"))]
        assert at_ends == [
            f"The {end} is in a cell that a roof of 12.0 m touches, over it or beside it."
            for end in ends
        ]


def test_roofs_that_touch_a_cell_count_where_the_maps_hold_them(maps):
    touched_m = maps.m("roof").copy()
    touched_m[ROW + 3, 60:70] = 30.0
    touched_m[ROW, 29] = 15.0
    both = ju.MetricMaps(maps.ds.assign(roof_touched=(("y", "x"), touched_m)))
    totals = ju.explain(straight(maps), both).totals
    assert totals["nearest_wall_m"] == pytest.approx(25.0)
    assert totals["least_over_roofs_m"] == pytest.approx(5.0)


def test_a_route_through_cells_that_a_building_touches_is_not_told_as_over_its_roof(maps):
    touched_m = maps.m("roof").copy()
    touched_m[ROW, 40:51] = 30.0
    by_centre = ju.MetricMaps(maps.ds.assign(roof_touched=(("y", "x"), touched_m)), "centre")
    told = ju.cautions(straight(by_centre, last=50), by_centre)
    assert (
        "Buildings: 105.0 m of the route lie in cells that a building as high as the route touches, perhaps inside "
        "its outline." in told
    )
    assert "The goal is in a cell that a building of 30.0 m touches." in told
    assert any(sentence.startswith("Roofs: the lowest pass leaves 8.0 m") for sentence in told)


def test_what_may_stand_outside_the_region_is_no_nearer_than_the_border(maps):
    bare = with_roofs(maps, np.zeros(maps.grid.shape, np.float32))
    south, north = ends_at(maps, (1, 60), (4, 60)), ends_at(maps, (38, 60), (35, 60))
    for on, ends, nearest_m in ((bare, south, np.inf), (maps, south, 195.0), (maps, north, 65.0)):
        path = ju.plan(on, **ends, altitude_m=ALTITUDE_M, objective="distance")
        totals = ju.explain(path, on).totals
        assert (totals["walls_outside_m"], totals["nearest_wall_m"]) == (15.0, nearest_m)
        (caution,) = (each for each in ju.cautions(path, on) if each.startswith("Buildings"))
        assert caution.startswith("Buildings: none that reaches the flight height is within 15.0 m")
        assert "what stands beyond their border is not known" in caution
        assert caution.level == "note"
        assert (f"in the region the nearest is {nearest_m} m away" in caution) == np.isfinite(
            nearest_m
        )


def test_satellites_are_whole_numbers_and_between_two_altitudes_those_of_the_lower_map(maps):
    assert ju.explain(straight(maps), maps).profile["num_visible"].dtype.kind == "i"
    visible = maps.ds["num_visible"].copy(deep=True)
    visible[:, 1] = 10
    higher = ju.MetricMaps(maps.ds.assign(num_visible=visible))
    path = ju.plan(
        higher, **ends_at(maps, (ROW, 20), (ROW, 30)), altitude_m=30.0, objective="distance"
    )
    profile = ju.explain(path, higher).profile
    cells = higher.grid.cell_of_lonlat(profile["lon"], profile["lat"])
    assert profile["num_visible"].tolist() == higher.m("num_visible", 20.0)[cells].tolist()
    assert set(profile["num_visible"]) == {4, 7}


def test_the_command_line_tells_it_on_stderr_and_in_json(maps, tmp_path, capsys):
    with_guesses(maps, LOW_ROOF).save(tmp_path / "maps")
    arguments = (
        "plan",
        tmp_path / "maps",
        *options_of(maps, **ends_at(maps, (ROW, 33), (ROW, 90))),
    )
    code, out, err = run(capsys, *arguments)
    assert code == 0
    for words in (
        "GPS: no fix",
        "Buildings: the nearest that reaches the flight height",
        "Roofs: the lowest pass",
        "The start is in a cell",
    ):
        assert (words in err, words in out) == (True, False)
    _, out, err = run(capsys, *arguments, "--json")
    told = json.loads(out)["cautions"]
    assert err.splitlines() == [f"jaxurban: {sentence}" for sentence in told]
    assert told[0].startswith("Guessed: 40 % of heights, nominal satellites; ")


def test_a_wall_beside_a_climb_counts_as_soon_as_it_reaches_above_the_route(maps):
    roof_m = np.zeros(maps.grid.shape, np.float32)
    roof_m[ROW + 4 : ROW + 9, 40:45] = (
        55.0  # beside the climb from 20 to 60 m, nearer to 60 than to 20 at its top
    )
    around = with_roofs(maps, roof_m)
    climb = {"start_altitude_m": 20.0, "goal_altitude_m": 60.0, "objective": "distance"}
    path = plan_volume(around, **ends_at(maps, (ROW, 41), (ROW, 43)), **climb)
    climbing = ju.explain(path, around).profile
    is_low = (climbing["z_m"] > 41.0) & (climbing["z_m"] < 55.0)
    assert (climbing.loc[is_low, "nearest_wall_m"] == 35.0).all()
    assert is_low.any()


def test_what_a_result_knows_stands_in_its_text_and_in_its_table(maps):
    guessed = with_guesses(maps, LOW_ROOF)
    path = straight(guessed)
    said = [(each.level, each) for each in path.cautions]
    assert [level for level, _ in said[:2]] == ["guess", "limit"]
    city = replace(ju.demo_city(400, 400), guesses=GUESSES)
    short = [("guess", "Guessed: 40 % of heights, nominal satellites.")]
    for shown, cautions in (
        (path, said),
        (ju.explain(path, guessed), said),
        (guessed, short),
        (city, short),
    ):
        html = re.findall(r"<th>(guess|limit|note)</th><td[^>]*>(.*?)</td>", shown._repr_html_())
        assert html == cautions
        assert re.findall(r"^  (guess|limit|note): (.*)$", repr(shown), re.MULTILINE) == cautions
    assert "guess" not in repr(maps)


def test_what_is_shown_does_not_fail_where_its_maps_are_gone(maps, tmp_path):
    opened = ju.open_maps(maps.save(tmp_path / "maps"))
    path = replace(straight(maps), maps=opened)
    shutil.rmtree(tmp_path / "maps")
    assert "What to be cautious of is not known: " in repr(path)
