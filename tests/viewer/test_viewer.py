"""What the page is told, against the maps themselves, and routes against ``jaxurban plan``."""

import base64
import json
import shlex
import zlib

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.metrics.weights import Weights
from jaxurban.paths.plan import plan
from jaxurban.report.figures.metrics import metric_colours
from jaxurban.viewer.layers import Place, layers_of, legend_of
from jaxurban.viewer.plans import PlanDefaults
from jaxurban.viewer.viewer import Viewer
from tests.cli_runs import run
from tests.made_maps import made_maps

MAPS = made_maps()
CELLS = np.argwhere(MAPS.is_free(20.0))
ENDS = [np.round(MAPS.grid.lonlat_of_cell(*CELLS[at]), 7).tolist() for at in (5, -9)]
WEIGHTS = {"distance": 0.1, "gps": 3.0, "lidar": 0.7, "population": 0.0, "risk": 1.5}
QUERY = {"start": ENDS[0], "goal": ENDS[1], "at": [0, 0, 1], "weights": WEIGHTS}


def square(row: int, col: int, size: int) -> str:
    """Return a zone over a square of cells, as the page sends it."""
    corners = [(row, col), (row, col + size), (row + size, col + size), (row + size, col), (row, col)]
    ring = [np.round(MAPS.grid.lonlat_of_cell(*corner), 7).tolist() for corner in corners]
    feature = {
        "type": "Feature",
        "properties": {"name": "zone 1"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    return json.dumps({"type": "FeatureCollection", "features": [feature]})


def answer(viewer: Viewer, name: str, **params):
    found = viewer.answer(name, params)
    return json.loads(found.body) if found.kind == "application/json" else found.body


@pytest.fixture(scope="module")
def viewer(tmp_path_factory) -> Viewer:
    folder = tmp_path_factory.mktemp("maps")
    MAPS.save(folder)
    return Viewer(MAPS, MAPS, defaults=PlanDefaults(command=(str(folder), "--resolution", "10.0")))


def tile_of(viewer: Viewer, layer: str, at: list[int], **more) -> np.ndarray:
    data = answer(viewer, "tile", layer=layer, at=at, stride=1, row=0, col=0, **more)
    planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(4, -1)
    return np.ascontiguousarray(planes.T).view("<f4").reshape(MAPS.grid.shape)


@pytest.mark.parametrize("name", ["gps", "lidar", "risk", "hdop", "num_visible"])
def test_tiles_hold_the_maps_values_and_mark_obstacles(viewer, name):
    got, free = tile_of(viewer, name, [1, 0, 0]), MAPS.is_free(60.0, "centre")
    assert np.array_equal(got[free], MAPS.m(name, 60.0)[free].astype(np.float32))
    assert np.array_equal(got == -np.inf, MAPS.m("obstacle", 60.0) == 1)


def test_a_cost_is_that_of_the_metric_and_h_norm_that_of_the_maps(viewer):
    free = MAPS.is_free(20.0, "centre")
    assert np.array_equal(tile_of(viewer, "cost:gps", [0, 0, 0])[free], (1 - MAPS.m("gps", 20.0))[free])
    assert np.array_equal(tile_of(viewer, "h_norm", [0, 0, 1])[free], MAPS.normalised(20.0, time_of_day="night")[free])


def test_a_difference_is_that_of_the_two_maps(viewer):
    minus = {"layer": "gps", "at": [1, 0, 0], "run": 1}
    got = tile_of(viewer, "gps", [0, 0, 0], minus=minus)
    both = MAPS.is_free(20.0, "centre") & MAPS.is_free(60.0, "centre")
    assert np.array_equal(got[both], (MAPS.m("gps", 20.0) - MAPS.m("gps", 60.0))[both])
    assert (got[~both] == -np.inf).all()
    legend = answer(viewer, "legend", layer="gps", at=[0, 0, 0], minus=minus)
    assert legend["edges"][0] == -legend["edges"][-1]


def test_colours_are_those_of_the_figures(viewer):
    legend = answer(viewer, "legend", layer="hdop", at=[0, 0, 0])
    colours = np.frombuffer(base64.b64decode(legend["colours"]), np.uint8).reshape(-1, 3)
    values = np.linspace(0.5, 25, 777)
    index = np.clip(np.searchsorted(legend["edges"], values, side="right") - 1, 0, len(colours) - 1)
    of_figures = metric_colours(MAPS, "hdop")(values, bytes=True)[:, :3]
    assert np.abs(colours[index].astype(int) - of_figures.astype(int)).max() <= 4  # beside an edge, one colour on
    assert (colours[index] == of_figures).all(axis=1).mean() > 0.99
    assert legend["ticks"][0] == 1
    assert legend["ticks"][-1] == 20


def test_every_layer_of_the_maps_can_be_asked_for(viewer):
    for name in layers_of(MAPS):
        assert "html" in answer(viewer, "legend", layer=name, at=[0, 0, 0])
        assert len(answer(viewer, "tile", layer=name, at=[0, 0, 0], stride=1, row=0, col=0)) > 50


def test_obstacles_are_drawn_by_classes(viewer):
    legend = answer(viewer, "legend", layer="obstacle", at=[0, 0, 0])
    assert legend["edges"] == [-0.5, 0.5, 1.5]
    assert "free" in legend["html"]
    assert np.array_equal(tile_of(viewer, "obstacle", [0, 0, 0]), MAPS.m("obstacle", 20.0))


def test_maps_of_a_long_series_are_shown_by_their_median(viewer):
    ds = MAPS.ds.drop_vars(["num_visible", "hdop"])
    gps = ds["gps"].isel(time=0, drop=True)
    ds = ds.drop_vars("gps").assign(gps_median=gps, gps_p05=0.5 * gps, gps_availability=gps)
    series = Viewer(type(MAPS)(ds))
    assert np.array_equal(tile_of(series, "gps", [0, 0, 0]), tile_of(viewer, "gps", [0, 0, 0]), equal_nan=True)
    row, col = CELLS[700].tolist()
    found = {each["name"]: each["value"] for each in answer(series, "values", at=[0, 0, 0], row=row, col=col)}
    assert found["gps"] == float(gps[0, row, col])
    assert answer(series, "plan", **QUERY)["has_path"]
    assert answer(series, "scene")["html"]["time"] == ""


def test_values_in_a_cell_are_the_maps_own(viewer):
    row, col = CELLS[700].tolist()
    found = {each["name"]: each["value"] for each in answer(viewer, "values", at=[1, 0, 1], row=row, col=col)}
    for name in ("gps", "lidar", "risk", "num_visible"):
        assert found[name] == float(MAPS.m(name, 60.0)[row, col])
    assert found["population"] == float(MAPS.m("population", time_of_day="night")[row, col])
    assert found["people"] == pytest.approx(float(MAPS.m("density", time_of_day="night")[row, col]) * 1e-4)
    assert found["roof"] == float(MAPS.m("roof")[row, col])


@pytest.mark.parametrize(
    "more",
    [
        {"planner": "astar-plus"},
        {"planner": "astar-dist", "clearance_m": 12.5},
        {"planner": "ptp", "snap": False},
        {"planner": "theta-star", "cost_model": "line"},
        {"planner": "astar-plus", "obstacles": "centre", "zones": square(30, 40, 14)},
    ],
)
def test_a_route_is_that_of_the_printed_command_coordinate_for_coordinate(viewer, more, capsys, tmp_path, monkeypatch):
    for _ in range(9):  # what planners remember of a map must not count
        shown = answer(viewer, "plan", **QUERY | more)
    program, *arguments = shlex.split(shown["command"])
    assert program == "jaxurban"
    monkeypatch.chdir(tmp_path)
    if zones := more.get("zones"):
        (tmp_path / "zones.geojson").write_text(zones, encoding="utf-8")
    code, out, err = run(capsys, *arguments, "--json")
    found = json.loads(out)
    assert code == (0 if shown["has_path"] else 3), err
    assert found["xy_m"] == shown["xy_m"]
    assert found["cost"] == shown["cost"]
    assert found["cost_by_layer"] == shown["cost_by_layer"]
    assert found["settings"]["weights"] == WEIGHTS
    saved = answer(viewer, "save", **QUERY | more | {"format": "geojson"}) if shown["has_path"] else None
    if saved is not None:
        assert json.loads(saved)["features"][0]["geometry"]["coordinates"] == np.round(found["lonlat"], 7).tolist()


def test_a_zone_changes_the_route_and_no_point_of_it_lies_inside(viewer):
    plain = answer(viewer, "plan", **QUERY)
    middle = np.array(plain["xy_m"])[len(plain["xy_m"]) // 2]
    row, col = (int(value) for value in MAPS.grid.cell_of_xy(*middle))
    around = answer(viewer, "plan", **QUERY, zones=square(row - 4, col - 4, 8))
    cells = np.stack(MAPS.grid.cell_of_xy(*np.array(around["xy_m"]).T), axis=-1)
    assert not (np.abs(cells - [row, col]) <= 4).all(axis=1).any()
    assert around["cost"] > plain["cost"]


def test_new_weights_give_what_a_plan_from_scratch_gives(viewer):
    for gps in (0.0, 0.3, 20.0):
        weights = WEIGHTS | {"gps": gps}
        shown = answer(viewer, "plan", **QUERY | {"weights": weights})
        scratch = plan(MAPS, *ENDS, altitude_m=20.0, weights=Weights(**weights), snap=True, time_of_day="night")
        assert np.array_equal(shown["xy_m"], scratch.xy_m)
        assert shown["cost"] == scratch.cost


def test_the_coarse_route_begins_and_ends_where_it_was_asked_for(viewer):
    found = answer(viewer, "coarse", **QUERY)
    assert found["has_path"]
    ends = np.stack(MAPS.grid.xy_of_lonlat(*np.array(ENDS).T), axis=-1)
    assert np.allclose(np.array(found["xy_m"])[[0, -1]], ends)


def test_a_report_tells_what_the_route_meets(viewer):
    found = answer(viewer, "report", **QUERY)
    assert len(found["xy"]) == len(found["to_share"]) > 10
    assert found["to_share"][-1] == pytest.approx(1, abs=1e-4)
    assert "<svg" in found["profile"]
    assert "Least clearance" in found["totals"]
    assert "segment" in found["report-text"]


@pytest.mark.parametrize("name", ["geojson", "kml", "plan", "gpx"])
def test_a_route_is_saved_in_every_format(viewer, name):
    assert len(answer(viewer, "save", **QUERY, format=name)) > 300


def test_maps_in_memory_have_no_command():
    assert answer(Viewer(MAPS), "plan", **QUERY)["command"] == ""


@pytest.mark.parametrize(
    ("name", "params"),
    [("tile", {"layer": "gps", "at": [0, 0, 0], "stride": 3, "row": 0, "col": 0}), ("study", {}), ("nothing", {})],
)
def test_what_is_not_there_is_refused(viewer, name, params):
    with pytest.raises(InputError):
        viewer.answer(name, params)


def test_names_out_of_files_cannot_become_markup():
    ds = MAPS.ds.assign_attrs(attribution="<script>alert(1)</script>")
    scene = answer(Viewer(type(MAPS)(ds), names=("<b>x</b>",)), "scene")
    assert "<script" not in json.dumps(scene)
    assert "<b>" not in scene["html"]["title"]


def test_the_legend_names_cells_without_a_value_where_there_are_any():
    layer = layers_of(MAPS)["risk"]
    values = layer.values(MAPS, Place(20.0))
    assert "no data" not in legend_of(MAPS, layer, values)["html"]
    values[3, 4] = np.nan
    assert "no data" in legend_of(MAPS, layer, values)["html"]


def test_a_cell_inside_an_obstacle_has_no_quality(viewer):
    row, col = np.argwhere(MAPS.m("obstacle", 20.0) != 0)[0].tolist()
    said = {each["name"]: each["value"] for each in answer(viewer, "values", at=[0, 0, 0], row=row, col=col)}
    assert (said["gps"], said["lidar"], said["num_visible"], said["obstacle"]) == (None, None, None, 1)
    assert said["roof"] == MAPS.m("roof")[row, col]
