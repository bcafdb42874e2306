"""The viewer in a notebook: messages of the page and their replies, and a notebook that shows it."""

import json
import shlex
import sys

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.io.files import write_json
from jaxurban.viewer.html import part
from jaxurban.viewer.requests import Request
from jaxurban.viewer.viewer import Viewer
from jaxurban.viewer.widget import reply_to, view, widget_of
from tests.cli_runs import run
from tests.made_maps import made_maps

MAPS = made_maps(24, 30)
TILE = {"layer": "gps", "at": [0, 0, 0], "stride": 1, "row": 0, "col": 0}


def test_messages_are_answered_as_requests_are():
    viewer = Viewer(MAPS)
    reply, buffers = reply_to(viewer, {"id": 7, "name": "scene", "parameters": {}})
    assert (reply["id"], reply["json"]["rows"], buffers) == (7, 24, [])
    reply, buffers = reply_to(viewer, {"id": 8, "name": "tile", "parameters": TILE})
    assert reply == {"id": 8}
    assert buffers == [viewer.answer("tile", TILE).body]


@pytest.mark.parametrize("message", [None, [], {}, {"id": 1, "name": "tile"}, {"id": 1, "name": [], "parameters": {}}])
def test_what_is_no_request_is_answered_by_a_sentence(message):
    reply, buffers = reply_to(Viewer(MAPS), message)
    assert reply["error"]
    assert not buffers


def test_the_widget_carries_the_page_and_replies_to_it(monkeypatch):
    pytest.importorskip("anywidget", reason="anywidget is not installed")
    widget, sent = widget_of(Viewer(MAPS)), []
    monkeypatch.setattr(type(widget), "send", lambda _, content, buffers: sent.append((content, buffers)))
    assert widget._esm == part("script")
    assert widget.markup == part("markup")
    widget._handle_custom_msg({"id": 3, "name": "tile", "parameters": TILE}, [])
    ((reply, buffers),) = sent
    assert reply == {"id": 3}
    assert len(buffers[0]) > 100


def test_over_a_runs_folder_the_page_plans_as_the_command_that_it_prints(tmp_path, monkeypatch, capsys):
    made = made_maps()
    made.save(tmp_path)
    planning = {"clearance_m": 4.0, "vertical_clearance_m": 15.0, "diagonal": "always", "objective": "distance"}
    settings = {"planning": planning, "vehicle": {"radius_m": 7.0}, "weights": {"gps": 3.0}}
    write_json(tmp_path / "run.json", {"settings": settings})
    monkeypatch.setattr("jaxurban.viewer.widget.widget_of", lambda viewer: viewer)
    viewer = view(str(tmp_path))
    scene = viewer.scene(Request())
    assert (scene["weights"]["gps"], scene["fields"]["clearance_m"]) == (3.0, 4.0)
    free = np.argwhere(made.is_free(60.0))
    start, goal = (np.round(made.grid.lonlat_of_cell(*free[k]), 7).tolist() for k in (5, -9))
    query = {"start": start, "goal": goal, "at": [1, 0, 0], "weights": scene["weights"], "clearance_m": 4.0}
    found = json.loads(viewer.answer("plan", query).body)
    code, _, err = run(capsys, *shlex.split(found["command"])[1:], "-o", tmp_path / "route.geojson")
    assert code == 0, err
    saved = viewer.answer("save", query | {"format": "geojson"}).body, (tmp_path / "route.geojson").read_bytes()
    page, command = ([each["geometry"] for each in json.loads(data)["features"]] for data in saved)
    assert page == command


def test_without_anywidget_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(InputError, match=r"pip install 'jaxurban\[notebook\]'"):
        view(MAPS)


@pytest.mark.slow
def test_a_notebook_that_shows_the_viewer_runs_and_holds_the_widget(tmp_path):
    pytest.importorskip("anywidget", reason="anywidget is not installed")
    import nbformat
    from nbclient import NotebookClient

    MAPS.save(tmp_path / "city")
    code = "import jaxurban as ju\nju.view(ju.open_maps('city'), weights={'gps': 2})"
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(code)])
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    (shown,) = [output for output in notebook.cells[0].outputs if output.output_type == "execute_result"]
    model = shown["data"]["application/vnd.jupyter.widget-view+json"]["model_id"]
    state = notebook.metadata["widgets"]["application/vnd.jupyter.widget-state+json"]["state"][model]["state"]
    assert state["_anywidget_id"].endswith("ViewerWidget")
    assert "jv-map" in state["markup"]


def test_the_public_name_stays_the_function_after_its_package_was_imported():
    import jaxurban as ju
    import jaxurban.viewer.server

    assert jaxurban.viewer.server
    assert ju.view is view
    assert ju.view is view  # once more: the first look imports
