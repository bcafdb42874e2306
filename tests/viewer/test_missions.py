"""Missions in the viewer: what the server says of one, against `jaxurban.check`, and the page that opens it."""

import base64
import html
import json
import tempfile
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.draw.profile import ALTITUDE_COLOUR
from jaxurban.draw.routes import PLANNER_COLOURS
from jaxurban.errors import InputError
from jaxurban.flights.export.write import FORMATS
from jaxurban.paths.suffixes import FLOWN
from jaxurban.viewer.server import MOST_BODY, MOST_MISSION
from jaxurban.viewer.viewer import Viewer
from tests.made_maps import made_maps
from tests.viewer.browser import opened, served
from tests.viewer.test_base import pixels_of
from tests.viewer.test_page import ink_at, text_of, until
from tests.viewer.test_screens import DESKTOP, FAULTS, share_of_map
from tests.viewer.test_server import ask
from tests.viewer.test_viewer import answer

MAPS = made_maps(60, 80)
GRID = MAPS.grid
AT = {"at": [0, 0, 0]}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
SCREENS = pytest.mark.parametrize("screen", [PHONE, DESKTOP], ids=["390", "1440"])
RED = np.array([208, 0, 0])
ROUTE, MISSION = (
    f"rgb{tuple(bytes.fromhex(colour[1:]))}"
    for colour in (PLANNER_COLOURS["astar"], ALTITUDE_COLOUR)
)


def line_of(height_m: float) -> str:
    """Return a line across the maps, over the highest roofs, as GeoJSON that leaves open what its heights are above."""
    walls = np.argwhere(MAPS.m("roof") == 80.0)
    row = int(walls[len(walls) // 2][0])
    ends = [[*GRID.lonlat_of_cell(row, col), height_m] for col in (2, 77)]
    shape = {"type": "LineString", "coordinates": ends}
    return json.dumps({"type": "Feature", "properties": {}, "geometry": shape})


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    """Missions by the state that they have: the last one is not judged, as no climb to it is known."""
    folder = tmp_path_factory.mktemp("missions")
    landing = np.argwhere(MAPS.m("roof_touched") == 0)
    start, goal = (GRID.lonlat_of_cell(*landing[k]) for k in (200, -200))
    found = {
        state: folder / name
        for state, name in {
            "clean": "clean.plan",
            "findings": "wall.geojson",
            "not-judged": "high.geojson",
            "broken": "broken.plan",
        }.items()
    }
    path = ju.plan(MAPS, start, goal, altitude_m=60.0, snap=True, on_ground=True)
    path.save(found["clean"])
    found["findings"].write_text(line_of(40.0))
    found["not-judged"].write_text(line_of(100.0))
    found["broken"].write_bytes(found["clean"].read_bytes()[:900])
    return found


@pytest.fixture(scope="module")
def url():
    with served(Viewer(MAPS, name="city")) as server:
        yield server.url


def mission(file: Path, **more) -> dict:
    """Return the parameters of a request for a file."""
    data = base64.b64encode(file.read_bytes()).decode()
    heights = "ground" if file.suffix == ".geojson" else None
    return AT | {"file": file.name, "data": data, "heights": heights} | more


@pytest.mark.parametrize("state", ["clean", "findings", "not-judged"])
def test_a_mission_is_judged_in_the_words_of_check_and_placed_on_the_map(files, state):
    file = files[state]
    query = mission(file)
    result = ju.check(MAPS, file, heights=query["heights"])
    shown = answer(Viewer(MAPS), "check", **query)
    assert result.state == state
    assert html.escape(result.sentence) in shown["state"]
    buttons = shown["findings"].split("</button>")[:-1]
    assert len(buttons) == len(result.findings)
    for button, text, by_m in zip(buttons, result.sentences, result.findings["by_m"], strict=True):
        assert html.escape(text) in button
        assert f"building, by {by_m:.1f} m" in button
    for text in result.not_judged:
        assert html.escape(f"Not judged: {text}") in shown["not-judged"]
    for text in result.notes:
        assert html.escape(text) in shown["state"]
    for text in (*result.return_lines, *result.numbers.values(), result.outlines):
        assert html.escape(text) in shown["figures"]
    corner_m = np.array(GRID.bounds_m[:2])
    lonlat = result.findings[["lon", "lat"]].to_numpy(float)
    assert np.allclose(
        np.reshape(shown["places"], (-1, 2)), GRID.xy_at(lonlat) - corner_m, atol=0.1
    )
    assert shown["heights"] == result.findings["height_m"].tolist()
    assert np.allclose(np.array(shown["lines"]) + corner_m, result.flight.lines_m, atol=0.1)


def test_a_mission_is_judged_under_the_clearances_and_the_zones_of_the_page(files):
    viewer, query = Viewer(MAPS), mission(files["clean"])
    for more in ({"clearance_m": 30.0}, {"vertical_clearance_m": 45.0}):
        kept = ju.Constraints(**more)
        result = ju.check(MAPS, files["clean"], constraints=kept)
        assert result.state == "findings"
        assert result.sentence in answer(viewer, "check", **query, **more)["state"]
    (west, east), (south, north) = GRID.lonlat_of_cell([0, 59], [0, 79])
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    shape = {"type": "Polygon", "coordinates": [ring]}
    zone = {"type": "Feature", "properties": {"name": "zone 1"}, "geometry": shape}
    zones = json.dumps({"type": "FeatureCollection", "features": [zone]})
    shown = answer(viewer, "check", **query, zones=zones)
    assert html.escape("Enters the no-fly zone 'zone 1'") in shown["findings"]
    assert "no-fly zones: 1 of 1 in force" in shown["figures"]


@pytest.mark.filterwarnings("ignore::jaxurban.errors.IgnoredZoneWarning")
def test_a_zone_that_is_no_polygon_is_named_on_the_page_and_no_mission_is_saved(files):
    viewer = Viewer(MAPS)
    west, south = GRID.lonlat_of_cell(56, 76)
    shapes = shapely.box(west, south, west + 1e-4, south + 1e-4), shapely.Point(west, south)
    features = [
        {
            "type": "Feature",
            "properties": {"name": name},
            "geometry": shapely.geometry.mapping(shape),
        }
        for name, shape in zip(("field", "heliport"), shapes, strict=True)
    ]
    zones = json.dumps({"type": "FeatureCollection", "features": features})
    shown = answer(viewer, "check", **mission(files["clean"]), zones=zones)
    assert ju.check(MAPS, files["clean"]).state == "clean"
    assert "Not judged: nothing was found" in shown["state"]
    assert html.escape("'heliport' of 'zones.geojson'") in shown["not-judged"]

    free = np.argwhere(MAPS.m("roof_touched") == 0)
    start, goal = (list(map(float, GRID.lonlat_of_cell(*free[k]))) for k in (200, 1000))
    route = AT | {"start": start, "goal": goal, "weights": {}, "zones": zones, "flight_m": 60.0}
    for suffix in FORMATS:
        is_flown = suffix in FLOWN
        with pytest.raises(InputError, match="'heliport'") if is_flown else nullcontext():
            viewer.answer("save", route | {"format": suffix})


@pytest.mark.parametrize(
    ("heights", "remedy"),
    [
        ("home", "name it (with jaxurban check DIR FILE --home)"),
        ("ellipsoid", "(with jaxurban check DIR FILE --heights geoid_m=METRES; 37 m in Tokyo)"),
    ],
)
def test_what_the_page_has_no_field_for_is_named_with_its_command(files, heights, remedy):
    shown = answer(Viewer(MAPS), "check", **mission(files["findings"], heights=heights))
    assert remedy in shown["not-judged"]


def test_a_file_that_is_none_is_refused_in_a_sentence_and_no_file_is_left_or_read(
    files, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "own.plan").symlink_to(files["clean"])
    before = sorted(tmp_path.iterdir())
    viewer, broken = Viewer(MAPS), mission(files["broken"])
    refused = {
        "cannot be read as a mission": [{}, {"file": "own.plan"}, {"data": ""}],
        "must be a name without a folder": [
            {"file": name}
            for name in ("../own.plan", "/etc/own.plan", "a/own.plan", "a\\own.plan", "C:own.plan")
        ],
        "is none of the files that are read here": [
            {"file": name, "data": "AAEC"} for name in ("..", "", "own", "own.exe")
        ],
        "more than 16 MB": [{"data": base64.b64encode(bytes(2**24 + 1)).decode()}],
        "at most 100 characters": [{"file": 100 * "é" + ".plan"}],
        "Base64": [{"data": "abcde"}],
        "does not say what its heights": [mission(files["findings"], heights=None)],
        "heights": [{"heights": "roofs"}],
        "autopilot": [{"autopilot": "inav"}],
        "leave autopilot='ardupilot' out": [mission(files["clean"], autopilot="ardupilot")],
        "at.2: ": [{"at": [0, 0]}],
    }
    for words, parts in refused.items():
        for part in parts:
            with pytest.raises(InputError) as error:
                viewer.answer("check", broken | part)
            assert words in str(error.value)
            assert len(str(error.value).splitlines()) == 1
            assert str(tmp_path) not in str(error.value)
    viewer.answer("check", mission(files["clean"]))
    assert sorted(tmp_path.iterdir()) == before


def test_a_mission_may_be_larger_than_other_requests_up_to_a_bound_and_passes_the_same_guards(
    files,
):
    query = mission(files["clean"])
    body = json.dumps(query).encode()
    with served(Viewer(MAPS)) as server:
        assert ask(server, "POST", "/ask/check", body.ljust(MOST_BODY + 1))[0] == 200
        for path, most in (("/ask/check", MOST_MISSION), ("/ask/plan", MOST_BODY)):
            length = {"Content-Length": str(most + 1)}
            status, said = ask(server, "POST", path, b"{}", **length)
            assert (status, said) == (413, f"a request is at most {most} bytes".encode())
        for header in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
            assert ask(server, "POST", "/ask/check", body, **header)[0] == 403
        plain = {"Content-Type": "text/plain"}
        assert ask(server, "POST", "/ask/check", body, **plain)[0] == 415
        assert ask(server, "POST", "/ask/check?old", body)[0] == 409


def drop(page, file: Path) -> None:
    """Drop a file onto the page, which takes it."""
    is_passed = page.evaluate(
        """([name, text]) => {
          const dataTransfer = new DataTransfer(), aside = document.querySelector('aside');
          dataTransfer.items.add(new File([text], name));
          return ['dragover', 'drop'].map(kind => aside.dispatchEvent(
            new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }))); }""",
        [file.name, file.read_text()],
    )
    assert is_passed == [False, False]  # else the browser leaves the page for the file


def by_button(page, file: Path) -> None:
    """Open a file by the button."""
    page.click('[data-tab="check"]')
    with page.expect_file_chooser() as waiting:
        page.click('[data-do="mission"]')
    waiting.value.set_files(file)


def by_keys(page, file: Path) -> None:
    """Open a file by the keys alone."""
    choosers = []
    page.on("filechooser", lambda chooser: choosers.append(chooser))
    page.locator("canvas").focus()
    page.wait_for_timeout(500)  # until the browser hands its dialogs over
    page.keyboard.press("o")
    until(page, lambda: choosers)
    choosers[0].set_files(file)


def middle_ink(page) -> list[int]:
    """Return the colour in the middle of the map."""
    box = page.locator("canvas").bounding_box()
    page.wait_for_timeout(500)
    ratio = page.evaluate("devicePixelRatio")
    assert ratio == 1
    return ink_at(page, (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2))


@pytest.mark.slow
@SCREENS
@pytest.mark.parametrize("open_file", [drop, by_button, by_keys])
def test_a_mission_is_opened_its_findings_are_listed_and_each_one_moves_the_map(
    browser, url, files, screen, open_file
):
    expected = ju.check(MAPS, files["findings"], heights="ground")
    with opened(browser, url, is_well=False, **screen) as page:
        open_file(page, files["findings"])
        until(page, lambda: "what its heights are above" in text_of(page, "state"))
        assert text_of(page, "mission") == "wall.geojson"
        page.select_option('[name="heights"]', "ground")
        until(page, lambda: expected.sentence in text_of(page, "state"))
        for note in expected.notes:
            assert note in text_of(page, "state")
        assert page.evaluate(FAULTS) == []
        assert share_of_map(page) >= 0.5 - 1e-6

        buttons = page.locator('[data-is="findings"] button')
        texts = buttons.all_inner_texts()
        assert len(texts) == len(expected.sentences) > 2
        for number, (text, sentence) in enumerate(zip(texts, expected.sentences, strict=True), 1):
            assert text.split("\n")[0].startswith(f"{number} building, by ")
            assert sentence in text
        live = page.locator('[aria-live="polite"]:has([data-is="findings"])')
        assert expected.sentence in live.inner_text()
        assert "Not judged: The climb from home" in live.inner_text()

        # A click or a key moves the map there; the level below the finding's 40 m is shown.
        for choose in (lambda: buttons.nth(1).click(), lambda: page.keyboard.press("ArrowDown")):
            choose()
            assert np.abs(middle_ink(page) - RED).max() < 40
        pressed = buttons.evaluate_all("all => all.map(each => each.ariaPressed)")
        assert pressed[:4] == ["false", "false", "true", "false"]
        assert page.evaluate("document.activeElement.ariaPressed") == "true"
        assert page.input_value('[name="flight_m"]') == "40"

        # On the map N and P walk on, and what they come to is said.
        page.locator("canvas").focus()
        for key, number in (("n", 4), ("n", 5), ("n", 5), ("p", 4)):
            page.keyboard.press(key)
            said = page.locator('[data-is="tell"][role="status"]').inner_text()
            assert said.startswith(f"{number} building, by ")
            assert f" m: {expected.sentences[number - 1]}" in said
        buttons.nth(0).click()
        assert text_of(page, "tell") == ""  # else it would go on about another finding


@pytest.mark.slow
@SCREENS
def test_a_bar_is_shown_with_its_words_while_a_mission_is_judged(browser, url, files, screen):
    with opened(browser, url, is_well=False, **screen) as page:
        held = []
        page.route("**/ask/check*", lambda route: held.append(route))
        by_button(page, files["clean"])
        until(page, lambda: held)
        bar = page.get_by_role("progressbar", name="Judging the mission")
        assert bar.is_visible()
        assert page.evaluate(FAULTS) == []
        held[0].continue_()
        until(page, lambda: "Clean" in text_of(page, "state"))
        assert bar.count() == 0


@pytest.mark.slow
def test_another_file_takes_the_place_of_the_first_and_close_leaves_none(browser, url, files):
    with opened(browser, url, is_well=False, **DESKTOP) as page:
        texts = '[data-is="state"], [data-is="findings"], [data-is="not-judged"]'
        texts = page.locator(texts)
        page.click('[data-tab="check"]')
        page.select_option('[name="heights"]', "ground")
        drop(page, files["findings"])
        until(page, lambda: "Findings" in text_of(page, "state"))
        page.select_option('[name="heights"]', "")
        for state, words in (
            ("clean", "Clean: every leg was judged, and nothing was found."),
            ("broken", "'broken.plan' cannot be read as a mission"),
        ):
            drop(page, files[state])
            until(page, lambda words=words: words in text_of(page, "state"))
            assert text_of(page, "mission") == files[state].name
            ink = page.locator('[data-is="state"]').evaluate("each => getComputedStyle(each).color")
            assert (ink == "rgb(176, 0, 32)") == (state == "broken")  # the colour of limits
            assert page.locator('[data-is="findings"] button').count() == 0

        # The map shows the level of its flight.
        drop(page, files["clean"])
        until(page, lambda: page.input_value('[name="flight_m"]') == "60")
        assert text_of(page, "drawn") == "The map shows the level of 60 m."

        # What it is judged by changes: it is judged again, and not where that does not count.
        drop(page, files["clean"])
        until(page, lambda: "Clean" in text_of(page, "state"))
        asked = []
        page.on("request", lambda request: asked.append(request.url.split("?")[0]))
        page.click('[data-tab="plan"]')
        page.locator('[name="weight-gps"]').press("ArrowRight")
        page.fill('[name="vertical_clearance_m"]', "45")
        page.keyboard.press("Tab")
        page.click('[data-tab="check"]')
        until(page, lambda: "Findings" in text_of(page, "state"))
        assert sum(each.endswith("/ask/check") for each in asked) == 1

        page.click("text=Close it")
        until(page, lambda: "".join(texts.all_inner_texts()) == "")
        assert not page.locator("text=Figures").is_visible()


@pytest.mark.slow
def test_a_click_on_a_finding_chooses_it_and_a_planned_route_keeps_its_altitude(
    browser, url, files
):
    with opened(browser, url, is_well=False, **DESKTOP) as page:
        page.click('[data-tab="check"]')
        page.select_option('[name="heights"]', "ground")
        drop(page, files["findings"])
        until(page, lambda: "Findings" in text_of(page, "state"))
        buttons = page.locator('[data-is="findings"] button')
        buttons.nth(0).click()
        page.wait_for_timeout(300)
        box = page.locator("canvas").bounding_box()
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        for _ in range(6):
            page.keyboard.press("ArrowDown")
        assert buttons.nth(0).get_attribute("aria-pressed") == "false"
        page.locator('[data-tab="plan"]').click()
        page.fill('[name="flight_m"]', "60")
        page.keyboard.press("Tab")
        page.click('[data-do="fit"]')
        for shift in (-60, 60):
            page.mouse.click(middle[0] + shift, middle[1])
        until(page, lambda: page.locator(".jv-route").count() == 1)
        until(page, lambda: page.locator('[data-is="report"]').is_visible())
        in_plan, in_check = [], []
        for tab, inks in (("plan", in_plan), ("check", in_check)):
            page.click(f'[data-tab="{tab}"]')
            page.wait_for_timeout(300)
            inks += pixels_of(page, [ROUTE, MISSION])
        assert in_plan[0] > 50 > in_check[0]  # where there are both, the other tab's line is pale
        assert in_check[1] > 50 > in_plan[1]
        assert not page.locator('[data-is="report"]').is_visible()  # it is of another route
        buttons.nth(0).click()
        page.wait_for_timeout(300)
        assert page.input_value('[name="flight_m"]') == "60"
        buttons.nth(1).click()
        page.wait_for_timeout(300)
        box = page.locator("canvas").bounding_box()
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        assert buttons.nth(1).get_attribute("aria-pressed") == "true"


@pytest.mark.slow
def test_a_page_without_a_server_takes_no_mission(browser, tmp_path, files):
    from jaxurban.viewer.html import write_page

    file = tmp_path / "page.html"
    write_page(Viewer(MAPS), file, 10 * 2**20)
    with opened(browser, file.as_uri(), **DESKTOP) as page:
        assert not page.locator('[data-tab="check"]').is_visible()
        page.locator("canvas").focus()
        page.keyboard.press("o")
        assert not page.locator('[data-do="mission"]').is_visible()
