"""What the page is told, against the maps and ``jaxurban plan``, and the page as a widget in a notebook."""

import base64
import html
import json
import math
import re
import shlex
import sys
import tomllib
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.draw.metrics import metric_colours
from jaxurban.draw.paths import colours_of_cost
from jaxurban.errors import InputError
from jaxurban.flights.export.write import FORMATS
from jaxurban.io.files import write_json
from jaxurban.maps.run import run_scenario
from jaxurban.maps.shared import OneMap
from jaxurban.metrics.variables import GROUP_COLOURS
from jaxurban.paths.closed import CAUSES, causes_at
from jaxurban.paths.route_report import short
from jaxurban.receivers.figures import short_name
from jaxurban.viewer.html import part
from jaxurban.viewer.layers import layers_of, legend_of
from jaxurban.viewer.outlines import STEP_M
from jaxurban.viewer.requests import Request
from jaxurban.viewer.viewer import Viewer
from jaxurban.viewer.widget import reply_to, view, widget_of
from jaxurban.world.footprints import HeightOrigin
from jaxurban.world.kinds import EFFECTS, GROUPS
from tests.cli_runs import TOWN, run, write_city
from tests.guess_records import attribute, heights
from tests.made_maps import city_of_boxes, made_maps, maps_of_kinds
from tests.pictures import SVG, pictures_in
from tests.viewer.browser import unpacked

MAPS, LITTLE = made_maps(), made_maps(24, 30)
TILE = {"layer": "gps", "at": [0, 0, 0], "stride": 1, "row": 0, "col": 0}
CELLS = np.argwhere(MAPS.is_free(20.0))
ENDS = [np.round(MAPS.grid.lonlat_of_cell(*CELLS[at]), 7).tolist() for at in (5, -9)]
NEAR = np.round(
    MAPS.grid.lonlat_of_cell(*CELLS[np.hypot(*(CELLS - CELLS[5] - [7, 6]).T).argmin()]), 7
).tolist()
ROOFED = np.argwhere(MAPS.is_free(20.0) & (MAPS.m("roof_touched") > 0))
OVER_ROOF = np.round(MAPS.grid.lonlat_of_cell(*ROOFED[3]), 7).tolist()
WEIGHTS = {"distance": 0.1, "gps": 3.0, "lidar": 0.7, "population": 0.0, "risk": 1.5}
QUERY = {"start": ENDS[0], "goal": ENDS[1], "at": [0, 0, 1], "weights": WEIGHTS}


def square(row: int, col: int, size: int) -> str:
    """Return a zone over a square of cells, as the page sends it."""
    (west, east), (south, north) = np.round(
        MAPS.grid.lonlat_of_cell([row, row + size], [col, col + size]), 7
    )
    shape = shapely.geometry.mapping(shapely.box(west, south, east, north))
    feature = {"type": "Feature", "properties": {"name": "zone 1"}, "geometry": shape}
    return json.dumps({"type": "FeatureCollection", "features": [feature]})


def answer(viewer: Viewer, name: str, **params):
    found = viewer.answer(name, params)
    return json.loads(found.body) if found.kind == "application/json" else found.body


@pytest.fixture(scope="module")
def viewer(tmp_path_factory) -> Viewer:
    folder = tmp_path_factory.mktemp("maps")
    MAPS.save(folder)
    return Viewer(MAPS, folder=str(folder))


def tile_of(viewer: Viewer, layer: str, at: list[int]) -> np.ndarray:
    return unpacked(answer(viewer, "tile", layer=layer, at=at, stride=1, row=0, col=0)).reshape(
        MAPS.grid.shape
    )


def values_in(viewer: Viewer, cell, at=(0, 0, 0)) -> dict:
    """Return what the page says of a cell, by layer."""
    found = answer(viewer, "values", at=[*at], row=int(cell[0]), col=int(cell[1]))
    return {each["name"]: each["value"] for each in found}


def test_tiles_hold_the_maps_values_and_mark_obstacles_and_every_layer_can_be_asked_for(viewer):
    free = MAPS.is_free(60.0, "centre")
    for name in ("gps", "lidar", "risk", "hdop", "num_visible"):
        got = tile_of(viewer, name, [1, 0, 0])
        assert np.array_equal(got[free], MAPS.m(name, 60.0)[free].astype(np.float32))
        assert np.array_equal(got == -np.inf, MAPS.m("obstacle", 60.0) == 1)
    free = MAPS.is_free(20.0, "centre")
    assert np.array_equal(
        tile_of(viewer, "h_norm", [0, 0, 1])[free], MAPS.normalised(20.0, time_of_day="night")[free]
    )
    for name in layers_of(MAPS):
        assert "html" in answer(viewer, "legend", layer=name, at=[0, 0, 0])
        assert tile_of(viewer, name, [0, 0, 0]).shape == MAPS.grid.shape
    assert np.array_equal(tile_of(viewer, "obstacle", [0, 0, 0]), MAPS.m("obstacle", 20.0))


def test_the_closed_cells_are_those_of_the_cost_map_under_the_rules_of_the_page(viewer):
    free = ju.cost_map(MAPS, 20.0).is_free
    assert np.array_equal(tile_of(viewer, "closed", [0, 0, 0]) == 0, free)
    limits = ju.Constraints(clearance_m=12.0, vertical_clearance_m=5.0)
    rules = {"clearance_m": 12.0, "vertical_clearance_m": 5.0, "flight_m": 40.0}
    plan = QUERY | {"zones": square(30, 40, 8), "weights": {}} | rules
    on = ju.cost_map(MAPS, 40.0, constraints=limits)
    got = unpacked(
        answer(viewer, "tile", layer="closed", at=[0, 0, 0], plan=plan, stride=1, row=0, col=0)
    ).reshape(free.shape)
    in_zone = got == CAUSES.index("zone or bound")
    assert in_zone[31:37, 41:47].any()
    assert np.array_equal(got == 0, on.is_free & ~in_zone)
    assert not in_zone[:28].any()
    html = answer(viewer, "legend", layer="closed", at=[0, 0, 0], plan=plan)["html"]
    assert "clearance beside" in html
    assert "closed to routes" in answer(viewer, "legend", layer="gps", at=[0, 0, 0])["html"]


def test_a_place_says_why_it_is_closed_and_what_share_each_cause_closes(viewer):
    query = QUERY | {"at": [0, 0, 0], "clearance_m": 12.0}
    on = ju.cost_map(MAPS, 20.0, constraints=ju.Constraints(clearance_m=12.0))
    causes = causes_at(MAPS, on.constraints, 20.0)
    for name, words in {
        "free": "This cell is free to routes.",
        "obstacle": "This cell is inside an obstacle",
        "clearance beside": "This cell is closed by the clearance of 12 m",
    }.items():
        is_named = causes == CAUSES.index(name)
        place = MAPS.grid.lonlat_of_cell(*np.argwhere(is_named)[3])
        said = answer(viewer, "why", **query | {"start": place})
        assert said.startswith(words)
        colon = ":" if name == "free" else ""
        assert f"{name}{colon} {is_named.mean():.1%}".lower() in said.lower()
    with pytest.raises(InputError, match="outside the region"):
        answer(viewer, "why", **query | {"start": [0.0, 0.0]})


def test_colours_are_those_of_the_figures(viewer):
    legend = answer(viewer, "legend", layer="hdop", at=[0, 0, 0])
    assert [legend["ticks"][k] for k in (0, -1)] == [1, 20]
    assert answer(viewer, "legend", layer="obstacle", at=[0, 0, 0])["edges"] == [
        -0.5,
        0.5,
        1.5,
    ]  # two classes
    colours = np.frombuffer(base64.b64decode(legend["colours"]), np.uint8).reshape(-1, 4)[:, :3]
    values = np.linspace(0.5, 25, 777)
    index = np.clip(np.searchsorted(legend["edges"], values, side="right") - 1, 0, len(colours) - 1)
    of_figures = metric_colours(MAPS, "hdop")(values, bytes=True)[:, :3]
    assert (
        np.abs(colours[index].astype(int) - of_figures.astype(int)).max() <= 4
    )  # beside an edge, one colour on
    assert (colours[index] == of_figures).all(axis=1).mean() > 0.99


@pytest.mark.parametrize("at", [[0, 0, 0], [1, 0, 1]])
def test_the_cost_has_the_colours_of_the_picture_of_paths(viewer, at):
    legend = answer(viewer, "legend", layer="h_norm", at=at)
    norm = MAPS.normalised(MAPS.altitudes_m[at[0]], time_of_day=MAPS.times_of_day[at[2]])
    colours = np.frombuffer(base64.b64decode(legend["colours"]), np.uint8).reshape(-1, 4)[:, :3]
    values = norm[np.isfinite(norm)]
    index = np.clip(np.searchsorted(legend["edges"], values, side="right") - 1, 0, len(colours) - 1)
    of_picture = colours_of_cost(norm)(values, bytes=True)[:, :3]
    assert np.abs(colours[index].astype(int) - of_picture.astype(int)).max() <= 2
    # 2 % of the free cells lie beyond each end of the bar, those above it in a darker colour of their own.
    low, high = (legend["ticks"][k] for k in (0, -1))
    assert (values < low).mean() == pytest.approx(0.02, abs=1e-3)
    assert (values > high).mean() == pytest.approx(0.02, abs=1e-3)
    assert colours[-1].sum() < colours[-2].sum() - 50


@pytest.mark.parametrize(
    "levels", [[20.0], [20.0, 60.0], [20.0, 60.0, 122.0], [5.0, 9.0, 20.0, 60.0]]
)
def test_the_page_opens_at_the_middle_altitude(levels):
    scene = answer(Viewer(made_maps(24, 30, levels)), "scene")
    opened_m = scene["fields"]["flight_m"]
    below, above = sum(z < opened_m for z in levels), sum(z > opened_m for z in levels)
    assert opened_m in levels
    assert below - above in (0, 1)  # of two in the middle it is the higher


def rings_of(viewer: Viewer) -> list[tuple[np.ndarray, float, bool, str]]:
    """Return the outlines that the page gets: corners in metres, height, whether it is guessed, and group."""
    values = unpacked(answer(viewer, "outlines"))
    num = int(values[0])
    counts, heights_m, guessed, numbers = values[1 : 4 * num + 1].reshape(4, num)
    steps = values[4 * num + 1 :].reshape(2, -1).T
    groups = np.array([*GROUP_COLOURS])[numbers.astype(int)].tolist()
    corners_m = STEP_M * np.cumsum(steps, axis=0)
    parts = np.split(corners_m, np.cumsum(counts.astype(int))[:-1])
    return list(zip(parts, heights_m.tolist(), (guessed == 1).tolist(), groups, strict=True))


def test_outlines_of_maps_in_memory_are_around_their_roofs_and_reach_the_altitudes_that_these_reach(
    caplog,
):
    roof_m = MAPS.m("roof")
    guessed = roof_m == 30
    viewer = Viewer(type(MAPS)(MAPS.ds.assign(roof_guessed=(("y", "x"), guessed))))
    cell_m2 = MAPS.grid.resolution_m**2
    of_height = dict.fromkeys(np.unique(roof_m[roof_m > 0]).tolist(), 0.0)
    for corners_m, height_m, is_guessed, group in rings_of(viewer):
        assert group == "buildings"
        of_height[height_m] += shapely.Polygon(corners_m).area
        assert is_guessed == (height_m == 30)
        row, col = np.floor(np.min(corners_m, axis=0) / MAPS.grid.resolution_m).astype(int)[::-1]
        assert roof_m[row, col] == height_m
    for height_m, area_m2 in of_height.items():
        assert area_m2 == pytest.approx((roof_m == height_m).sum() * cell_m2)
    assert "outlined by the cells of the maps: maps that were made in memory" in caplog.text


def test_outlines_of_a_city_are_exact_to_a_metre_with_their_heights_and_guesses():
    grid = MAPS.grid
    corner_m = grid.x_min_m, grid.y_min_m
    boxes = [(10, 20, 60, 80), (200.5, 100, 260, 190), (-500, -500, -400, -400)]
    buildings = city_of_boxes(boxes, [8.0, 40.0, 9.0], 1000.0, corner_m).buildings
    origin = np.array([HeightOrigin.HEIGHT, HeightOrigin.DEFAULT, HeightOrigin.HEIGHT], np.uint8)
    viewer = Viewer(MAPS)
    viewer.__dict__["_sight"] = SimpleNamespace(
        city=SimpleNamespace(standing=replace(buildings, origin=origin))
    )
    rings = rings_of(viewer)  # the third one lies outside
    assert [ring[1:] for ring in rings] == [(8, False, "buildings"), (40, True, "buildings")]
    for (corners_m, *_), box in zip(rings, boxes, strict=False):
        assert shapely.Polygon(corners_m).bounds == pytest.approx(box, abs=STEP_M / 2)


@pytest.mark.parametrize("by_outlines", [True, False])
def test_outlines_name_their_groups_each_of_which_the_page_switches(by_outlines):
    maps, city = maps_of_kinds()
    viewer = Viewer(maps)
    if by_outlines:
        viewer.__dict__["_sight"] = SimpleNamespace(city=city)
    area_m2 = dict.fromkeys(GROUP_COLOURS, 0.0)
    for corners_m, height_m, is_guessed, group in rings_of(viewer):
        area_m2[group] += shapely.Polygon(corners_m).area
        assert is_guessed == (group == "trees" and height_m == 12)
    if by_outlines:
        assert area_m2["buildings"] == 40 * 40 + 40 * 60
        assert area_m2["other structures"] == 100
        assert 50 < area_m2["wires"] <= 150  # of 1 m of width, to a metre
        assert area_m2["trees"] == pytest.approx(2400 + 5 * np.pi * 16, rel=0.04)
    else:
        group = np.array(["", *map(GROUPS.get, EFFECTS)])[maps.m("roof_kind")]
        for name, metres2 in area_m2.items():
            assert metres2 == 25 * ((group == name) & (maps.m("roof") > 0)).sum()
    boxes = answer(viewer, "scene")["html"]["groups"]
    names = ["buildings", "trees", "wires", "other structures"]
    assert re.findall(r'name="group-(\d)" checked', boxes) == ["0", "1", "2", "3"]
    assert re.findall(r"</i>([a-z ]+)</label>", boxes) == names
    assert answer(Viewer(MAPS), "scene")["html"]["groups"] == ""


def test_holes_of_outlines_run_against_their_outer_rings():
    shape = shapely.box(10, 10, 90, 90) - shapely.box(30, 30, 50, 60)
    buildings = city_of_boxes([(0, 0, 1, 1)], [8.0], 200.0, MAPS.grid.bounds_m[:2]).buildings
    moved = shapely.transform(shape, lambda xy: xy + MAPS.grid.bounds_m[:2])
    for polygon in (moved, moved.reverse()):
        viewer = Viewer(MAPS)
        standing = replace(buildings, polygons=np.array([polygon]))
        viewer.__dict__["_sight"] = SimpleNamespace(city=SimpleNamespace(standing=standing))
        turns = [shapely.is_ccw(shapely.LinearRing(corners)) for corners, *_ in rings_of(viewer)]
        assert turns[0] != turns[1]


@pytest.mark.slow
def test_outlines_and_skies_are_of_moved_files_where_their_folder_is_named(
    tmp_path, capsys, caplog
):
    scenario = write_city(tmp_path, shapely.box(-73.998, 40.757, -73.997, 40.758))
    assert run(capsys, "maps", scenario, "-o", tmp_path / "out")[0] == 0
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (tmp_path / "city.geojson").rename(moved / "city.geojson")
    rings_of(Viewer(ju.open_maps(tmp_path / "out")))
    assert "name the folder of these files (sources, --sources)" in caplog.text
    caplog.clear()
    (ring,) = rings_of(Viewer(ju.open_maps(tmp_path / "out"), sources=moved))
    assert len(ring[0]) == 5
    assert caplog.text == ""
    page = tmp_path / "page.html"
    for options in ([], ["--sources", moved]):
        assert run(capsys, "view", tmp_path / "out", "--export", page, *options)[0] == 0
        assert ("outlined by the cells" in caplog.text) == (not options)
        caplog.clear()
        page.unlink()


@pytest.mark.slow
def test_a_report_has_the_time_and_the_energy_as_the_command_and_files_do(viewer, capsys):
    before = answer(viewer, "report", **QUERY)["totals"]
    assert "time s" not in before
    query = QUERY | {"speed_m_s": 12.5, "power_w": 300.0}
    totals = answer(viewer, "report", **query)["totals"]
    shown = answer(viewer, "plan", **query)
    code, out, err = run(capsys, *shlex.split(shown["command"])[1:], "--json")
    assert code == 0, err
    report = json.loads(out)["report"]
    for words in (
        f"<td>time s</td><td>{short(report['time_s'])}</td>",
        f"<td>energy wh</td><td>{short(report['energy_wh'])}</td>",
    ):
        assert words in totals
    assert shown["xy_m"] == answer(viewer, "plan", **QUERY)["xy_m"]
    mission = json.loads(answer(viewer, "save", **query, format=".plan"))["mission"]
    assert mission["cruiseSpeed"] == 12.5
    with pytest.raises(InputError, match="give the speed"):
        viewer.answer("report", QUERY | {"power_w": 300.0})


def test_maps_of_a_long_series_are_shown_by_their_median(viewer):
    ds = MAPS.ds.drop_vars(["num_visible", "hdop"])
    gps = ds["gps"].isel(time=0, drop=True)
    ds = ds.drop_vars("gps").assign(gps_median=gps, gps_p05=0.5 * gps, gps_availability=gps)
    series = Viewer(type(MAPS)(ds))
    assert np.array_equal(
        tile_of(series, "gps", [0, 0, 0]), tile_of(viewer, "gps", [0, 0, 0]), equal_nan=True
    )
    assert values_in(series, CELLS[700])["gps"] == float(gps[0, *CELLS[700]])
    assert answer(series, "plan", **QUERY)["has_path"]
    assert answer(series, "scene")["html"]["time"] == ""


def test_values_in_a_cell_are_the_maps_own_and_inside_an_obstacle_there_is_no_quality(viewer):
    row, col = CELLS[700].tolist()
    found = values_in(viewer, CELLS[700], at=(1, 0, 1))
    for name in ("gps", "lidar", "risk", "num_visible"):
        assert found[name] == float(MAPS.m(name, 60.0)[row, col])
    assert found["population"] == float(MAPS.m("population", time_of_day="night")[row, col])
    assert found["density"] == float(MAPS.m("density", time_of_day="night")[row, col])
    assert found["roof"] == float(MAPS.m("roof")[row, col])
    wall = tuple(np.argwhere(MAPS.m("obstacle", 20.0) != 0)[0])
    said = values_in(viewer, wall)
    assert (said["gps"], said["lidar"], said["num_visible"], said["obstacle"]) == (
        None,
        None,
        None,
        1,
    )
    assert said["roof"] == MAPS.m("roof")[wall]


def test_values_in_a_cell_stand_under_the_headings_of_the_list_of_layers_the_five_dops_under_one():
    kinds = ("gdop", "pdop", "hdop", "vdop", "tdop")
    ds = MAPS.ds.assign({name: MAPS.ds["hdop"] for name in kinds})
    viewer = Viewer(type(MAPS)(ds))
    rows = answer(viewer, "values", at=[0, 0, 0], row=3, col=4)
    groups = [row["group"] for row in rows]
    assert len(set(groups)) == sum(a != b for a, b in pairwise(["", *groups]))  # each one in a row
    of_dops = [row["name"] for row in rows if row["group"] == "Dilution of precision"]
    assert sorted(of_dops) == sorted(kinds)
    layers = answer(viewer, "scene")["html"]["layer"]
    for offered in layers.split("<optgroup ")[1:]:
        label = re.search('label="(.*?)"', offered)[1]
        named = set(re.findall('value="(.*?)"', offered)) - {"closed"}
        assert named == {row["name"] for row in rows if row["group"] == label}


def test_what_is_yes_or_no_in_a_cell_is_told_in_words():
    guessed = MAPS.ds["roof"] > 0
    viewer = Viewer(type(MAPS)(MAPS.ds.assign(roof_guessed=guessed)))
    cell = np.argwhere(guessed.values)[0].tolist()
    found = answer(viewer, "values", at=[0, 0, 0], row=cell[0], col=cell[1])
    (told,) = (each for each in found if each["name"] == "roof_guessed")
    assert (told["told"], told["classes"][int(told["value"])]) == (
        "Guessed heights",
        "height guessed",
    )
    assert all(
        each["classes"] == [] for each in found if each["name"] in ("gps", "roof", "density")
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        {"planner": "astar-plus"},
        {"planner": "astar-dist", "clearance_m": 12.5},
        {"planner": "ptp", "snap": False},
        {"on_ground": True, "start": OVER_ROOF},
        {"weights": WEIGHTS | {"gps": 20.0, "lidar": 0.0}},
        {"planner": "theta-star"},
        {"flight_m": 37.5, "vertical_clearance_m": 6.25},  # between the levels of 20 and 60 m
        {"planner": "astar-plus", "zones": square(30, 40, 14)},
    ],
)
def test_a_route_is_that_of_the_printed_command_coordinate_for_coordinate(
    viewer, more, capsys, tmp_path, monkeypatch
):
    for _ in range(9):  # what planners remember of a map must not count
        shown = answer(viewer, "plan", **QUERY | more)
    program, *arguments = shlex.split(shown["command"])
    assert (program, "--no-fly" in arguments) == ("jaxurban", "zones" in more)
    assert arguments[arguments.index("--altitude") + 1] == str(more.get("flight_m", 20.0))
    monkeypatch.chdir(tmp_path)
    if zones := more.get("zones"):
        (tmp_path / "zones.geojson").write_text(zones, encoding="utf-8")
    code, out, err = run(capsys, *arguments, "--json")
    found = json.loads(out)
    assert code == (0 if shown["has_path"] else 3), err
    assert all(found[name] == shown[name] for name in ("xy_m", "cost"))
    assert found["settings"]["weights"] == (QUERY | more)["weights"]
    if shown["has_path"]:
        saved = json.loads(answer(viewer, "save", **QUERY | more | {"format": ".geojson"}))
        assert (
            saved["features"][0]["geometry"]["coordinates"] == np.round(found["lonlat"], 7).tolist()
        )
        assert all(
            len(answer(viewer, "save", **QUERY | more, format=suffix)) > 300 for suffix in FORMATS
        )


def test_a_format_that_there_is_not_is_refused_with_those_that_there_are(viewer):
    with pytest.raises(ju.InputError, match=r"format must be '\.geojson', .*, got '\.pdf'"):
        viewer.answer("save", QUERY | {"format": ".pdf"})


def test_a_report_tells_what_the_route_meets_and_cautions_stand_outside_it_each_with_its_level(
    viewer,
):
    found = answer(viewer, "report", **QUERY)
    told = ju.cautions(
        ju.plan(MAPS, *ENDS, altitude_m=20.0, weights=ju.Weights(**WEIGHTS), time_of_day="night"),
        MAPS,
    )
    assert found["cautions"] == "".join(
        f'<p class="jv-{each.level}">{html.escape(each)}</p>' for each in told
    )
    assert told
    assert not any(each in found["report-text"] for each in told)
    assert len(found["xy"]) == len(found["to_share"]) > 10
    assert found["to_share"][-1] == pytest.approx(1, abs=1e-4)
    assert len(pictures_in(found["profile"])) == 1
    assert "nearest wall m" in found["totals"]
    assert re.search(
        "cost model: line .* gps 3, .* obstacles: touched, vertical clearance of 3 m",
        found["profile"],
    )
    assert "segment" in found["report-text"]


def test_a_route_names_its_status_and_the_report_once_each_end_that_was_moved(viewer):
    obstacle = MAPS.grid.lonlat_of_cell(*np.argwhere(MAPS.m("obstacle", 20.0) != 0)[40].tolist())
    query = QUERY | {"goal": np.round(obstacle, 7).tolist()}
    route, report = answer(viewer, "plan", **query), answer(viewer, "report", **query)
    moved_m = math.dist(route["xy_m"][-1], np.array(MAPS.grid.xy_of_lonlat(*obstacle)))
    assert "<small>The path is the cheapest one on the 8-neighbour grid" in route["button"]
    said = report["cautions"] + report["report-text"] + route["button"]
    assert said.count(f"The goal was not free: it was moved {moved_m:.1f} m") == 1
    assert "start was" not in said
    assert "moved" not in route["button"] + answer(viewer, "report", **QUERY)["cautions"]


@pytest.mark.slow
def test_the_mission_that_is_drawn_is_the_one_that_is_saved_and_bears_its_cost(viewer):
    query = QUERY
    found, route = answer(viewer, "report", **query), answer(viewer, "plan", **query)
    saved = json.loads(answer(viewer, "save", **query, format=".plan"))
    places = np.array(
        [item["params"][4:6] for item in saved["mission"]["items"][:-1]]
    )  # the last one lands
    xy_m = np.stack(MAPS.grid.xy_of_lonlat(places[:, 1], places[:, 0]), axis=-1)
    corner = np.array([MAPS.grid.x_min_m, MAPS.grid.y_min_m])
    assert np.allclose(found["mission"], xy_m - corner, atol=0.06)
    on = ju.cost_map(MAPS, 20.0, weights=ju.Weights(**WEIGHTS), time_of_day="night")
    planned = on.plan(*ENDS)
    assert planned.cost == route["cost"]
    mission = ju.simplify(planned, on, MAPS.grid.resolution_m / 2)
    prices = f"cost {short(mission.cost)}, {mission.cost / route['cost'] - 1:+.1%}"
    least_m = ju.explain(mission, MAPS).totals["nearest_wall_m"]
    least, route_m = (
        f"least clearance {short(least_m)} m",
        ju.explain(planned, MAPS).totals["nearest_wall_m"],
    )
    if least_m < route_m - 0.01:
        least = f"{least}, the route {short(route_m)} m"
    assert found["saved"] == f"{len(places)} waypoints, {prices}, {least}"


@pytest.mark.slow
def test_the_profile_is_the_figure_and_the_line_along_it_spans_its_panels(viewer):
    shown = answer(viewer, "report", **QUERY | {"goal": NEAR})["profile"]
    (drawn,) = pictures_in(shown)
    path = ju.plan(MAPS, ENDS[0], NEAR, altitude_m=20.0, weights=ju.Weights(**WEIGHTS))
    least_m = ju.explain(path, MAPS).totals["nearest_wall_m"]
    assert {"flight altitude", "distance flown (km)", f"least: {least_m:.3g} m"} <= {
        text.text for text in drawn.iter(f"{SVG}text")
    }
    assert f'alt="Route profile: astar, {path.length_m / 1000:.2f} km' in shown
    top, right, bottom, left = (float(each) for each in re.findall(r"([\d.]+)%", shown))
    width, height = map(float, drawn.get("viewBox").split()[2:])
    frames = [
        np.array(re.findall(r"[\d.]+ [\d.]+", axes.find(f"{SVG}g/{SVG}path").get("d")))
        for axes in drawn.iter(f"{SVG}g")
        if axes.get("id", "").startswith("axes_")
    ]
    corners = np.concatenate([np.loadtxt(frame) for frame in frames]) / (width, height)
    low, high = corners.min(axis=0), corners.max(axis=0)
    expected = low[1], 1 - high[0], 1 - high[1], low[0]
    assert np.allclose(np.array([top, right, bottom, left]) / 100, expected, atol=1e-4)


def test_guesses_stand_on_the_page_before_any_route_names_cannot_become_markup_and_maps_in_memory_have_no_command():
    attrs = attribute(heights(0.89, "<all>"))
    ds = MAPS.ds.assign_attrs(attrs, attribution="<script>alert(1)</script>")
    scene = answer(Viewer(type(MAPS)(ds), name="<b>x</b>"), "scene")
    assert scene["html"]["guesses"] == "Guessed: 89 % of heights"
    assert "are guessed (&lt;all&gt;)" in scene["html"]["guesses-text"]
    assert "<script" not in json.dumps(scene)
    assert "<b>" not in scene["html"]["title"]
    assert answer(Viewer(MAPS), "scene")["html"]["guesses"] == ""
    assert answer(Viewer(MAPS), "plan", **QUERY)["command"] == ""


def test_the_legend_names_cells_without_a_value_where_there_are_any():
    layer = layers_of(MAPS)["risk"]
    values = layer.values(OneMap(20.0))
    assert "no data" not in legend_of(layer, values)["html"]
    values[3, 4] = np.nan
    assert "no data" in legend_of(layer, values)["html"]


def test_messages_are_answered_as_requests_are():
    viewer = Viewer(LITTLE)
    reply, buffers = reply_to(viewer, {"id": 7, "name": "scene", "parameters": {}})
    assert (reply["id"], reply["json"]["rows"], buffers) == (7, 24, [])
    reply, buffers = reply_to(viewer, {"id": 8, "name": "tile", "parameters": TILE})
    assert reply == {"id": 8}
    assert buffers == [viewer.answer("tile", TILE).body]


@pytest.mark.parametrize(
    "message", [None, [], {}, {"id": 1, "name": "tile"}, {"id": 1, "name": [], "parameters": {}}]
)
def test_what_is_no_request_is_answered_by_a_sentence(message):
    reply, buffers = reply_to(Viewer(LITTLE), message)
    assert reply["error"]
    assert not buffers


def test_the_widget_carries_the_page_and_replies_to_it(monkeypatch):
    pytest.importorskip("anywidget", reason="anywidget is not installed")
    widget, sent = widget_of(Viewer(LITTLE)), []
    monkeypatch.setattr(
        type(widget), "send", lambda _, content, buffers: sent.append((content, buffers))
    )
    assert widget._esm == part("script")
    assert widget.markup == part("markup")
    widget._handle_custom_msg({"id": 3, "name": "tile", "parameters": TILE}, [])
    ((reply, buffers),) = sent
    assert reply == {"id": 3}
    assert len(buffers[0]) > 100


def test_over_a_runs_folder_the_page_plans_as_the_command_that_it_prints(
    tmp_path, monkeypatch, capsys
):
    MAPS.save(tmp_path)
    planning = {
        "clearance_m": 4.0,
        "vertical_clearance_m": 15.0,
    }
    settings = {"planning": planning, "vehicle": {"speed_m_s": 7.0}, "weights": {"gps": 3.0}}
    write_json(tmp_path / "run.json", {"settings": settings})
    monkeypatch.setattr("jaxurban.viewer.widget.widget_of", lambda viewer: viewer)
    viewer = view(str(tmp_path))
    scene = viewer.scene(Request())
    assert (scene["weights"]["gps"], scene["fields"]["clearance_m"]) == (3.0, 4.0)
    query = QUERY | {"at": [1, 0, 0], "weights": scene["weights"], "clearance_m": 4.0}
    found = json.loads(viewer.answer("plan", query).body)
    code, _, err = run(capsys, *shlex.split(found["command"])[1:], "-o", tmp_path / "route.geojson")
    assert code == 0, err
    saved = (
        viewer.answer("save", query | {"format": ".geojson"}).body,
        (tmp_path / "route.geojson").read_bytes(),
    )
    page, command = ([each["geometry"] for each in json.loads(data)["features"]] for data in saved)
    assert page == command


def test_without_anywidget_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(ju.InputError, match=r"pip install 'jaxurban\[notebook\]'"):
        view(LITTLE)


@pytest.mark.slow
def test_a_notebook_that_shows_the_viewer_runs_and_holds_the_widget(tmp_path):
    pytest.importorskip("anywidget", reason="anywidget is not installed")
    import nbformat
    from nbclient import NotebookClient

    LITTLE.save(tmp_path / "city")
    code = "import jaxurban as ju\nju.view(ju.open_maps('city'), weights={'gps': 2})"
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(code)])
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    (shown,) = [
        output for output in notebook.cells[0].outputs if output.output_type == "execute_result"
    ]
    model = shown["data"]["application/vnd.jupyter.widget-view+json"]["model_id"]
    state = notebook.metadata["widgets"]["application/vnd.jupyter.widget-state+json"]["state"][
        model
    ]["state"]
    assert state["_anywidget_id"].endswith("ViewerWidget")
    assert "jv-map" in state["markup"]


def test_the_public_name_stays_the_function_after_its_package_was_imported():
    import jaxurban.viewer.server

    assert jaxurban.viewer.server
    assert jaxurban.view is view
    assert jaxurban.view is view  # once more: the first look imports


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_a_sky_is_that_of_the_library_and_maps_in_memory_say_why_they_have_none(tmp_path):
    run_scenario(ju.Scenario.from_dict(tomllib.loads(TOWN)), tmp_path / "maps", progress=False)
    maps = ju.open_maps(tmp_path / "maps")
    place = (-73.999, 40.756)
    html = json.loads(Viewer(maps).answer("sky", {"at": [0, 0, 0], "place": place}).body)
    here = ju.sky(maps, place, maps.altitudes_m[0])
    counts = [int((here.table["state"] == state).sum()) for state in ("seen", "hidden", "unknown")]
    assert "{} seen, {} hidden, {} unknown".format(*counts) in html
    assert min(counts) > 0
    (drawn,) = pictures_in(html)
    names = {(text.text or "").split()[0] for text in drawn.iter(f"{SVG}text") if text.text}
    assert {short_name(name) for name in here.table["satellite"]} <= names
    with pytest.raises(InputError, match="made in memory do not hold their city"):
        Viewer(MAPS).answer("sky", {"at": [0, 0, 0], "place": place})


def test_a_place_says_what_stands_there_and_why_and_maps_alone_say_nothing_of_it():
    viewer = Viewer(MAPS)
    corner_m = MAPS.grid.x_min_m, MAPS.grid.y_min_m
    city = city_of_boxes([(10, 20, 60, 80), (200, 100, 260, 190)], [8.0, 40.0], 1000.0, corner_m)
    named = replace(
        city.buildings,
        kind=np.array(["building", "unknown"], object),
        label=np.array(["", "attraction=<b>wheel"], object),
        rule=np.array(["building", "attraction: *"], object),
    )
    viewer.__dict__["_sight"] = SimpleNamespace(city=replace(city, buildings=named))

    def said(east_m: float, north_m: float) -> str:
        place = MAPS.grid.lonlat_of_xy(corner_m[0] + east_m, corner_m[1] + north_m)
        return answer(viewer, "stands", at=[0, 0, 0], place=place)

    cells = re.findall(r"<td>(.*?)</td>", said(30, 40))
    assert cells == ["building", "8.0", "8.0", "a height in its file", "building"]
    assert "this stands at" in said(30, 40)
    assert "nothing stands at" in said(120, 40)
    assert "; the nearest thing is 60.0 m away:" in said(120, 40)
    assert "attraction=&lt;b&gt;wheel" in said(230, 150)
    assert "<td>?</td>" in said(230, 150)  # of unknown height
    with pytest.raises(InputError, match="give a place in the city"):
        said(-3000, 0)
    assert answer(Viewer(MAPS), "stands", at=[0, 0, 0], place=ENDS[0]) == ""
