"""The page in a real browser, every other host blocked: what a person sees, clicks, drags and saves."""

import base64
import json
import math
import shlex
import time

import numpy as np
import pytest

from jaxurban.draw.metrics import metric_colours
from jaxurban.flights.export.write import FORMATS
from jaxurban.maps.run import run_scenario
from jaxurban.maps.saving import open_maps
from jaxurban.maps.scenario import Scenario
from jaxurban.viewer.html import part, write_page
from jaxurban.viewer.viewer import Viewer
from jaxurban.viewer.widget import reply_to
from jaxurban.world.kinds import CODES
from tests.cli_runs import run
from tests.made_maps import made_maps, maps_of_kinds
from tests.viewer.browser import READY, SIZE, opened, shown

pytestmark = pytest.mark.slow
MAPS = made_maps(160, 200, (10.0, 20.0, 60.0))
GRID = MAPS.grid
FREE = np.argwhere(MAPS.is_free(20.0))
SKY = '[data-is="sky"] img'
LANDING = np.argwhere(MAPS.m("roof_touched") == 0)  # where missions may take off and land


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps") / "city"
    folder.mkdir()
    MAPS.save(folder)
    return folder


@pytest.fixture(scope="module")
def page(browser, folder):
    with shown(browser, Viewer(MAPS, folder=str(folder), name="city")) as page:
        yield page


def pixel_of(page, row: float, col: float) -> tuple[float, float]:
    """Return where on the page a place lies, by cells from the southwest corner, while the whole map is shown."""
    box = page.locator('[data-is="map"]').bounding_box()
    scale = 1.06 * max(GRID.num_cols / box["width"], GRID.num_rows / box["height"])
    x = box["x"] + box["width"] / 2 + (col - GRID.num_cols / 2) / scale
    return x, box["y"] + box["height"] / 2 - (row - GRID.num_rows / 2) / scale


def middle_of(page, cell) -> tuple[float, float]:
    return pixel_of(page, cell[0] + 0.5, cell[1] + 0.5)


def text_of(page, name: str) -> str:
    return page.locator(f'[data-is="{name}"]').inner_text()


def drag(page, at, by) -> None:
    page.mouse.move(*at)
    page.mouse.down()
    page.mouse.move(at[0] + by[0], at[1] + by[1], steps=4)
    page.mouse.up()
    settle(page)


def show_all(page) -> None:
    page.locator('[data-is="map"]').focus()
    page.keyboard.press("0")


def point_at(page, cell) -> dict[str, float | None]:
    """Point at a cell; return what the page says of it by layer."""
    page.mouse.move(*middle_of(page, cell))
    until(
        page,
        lambda: (
            page.locator('[data-is="values"]').get_attribute("data-cell") == f"{cell[0]} {cell[1]}"
        ),
    )
    rows = page.locator('[data-is="values"] tr[data-layer]')
    said = rows.evaluate_all("rows => rows.map(row => [row.dataset.layer, row.dataset.value])")
    return {name: None if value == "null" else float(value) for name, value in said}


def until(page, is_so) -> None:
    """Wait until something is so."""
    for _ in range(300):
        if is_so():
            return
        page.wait_for_timeout(100)
    raise AssertionError("that did not happen within half a minute")


def settle(page) -> None:
    """Wait until nothing is planned or asked any more."""
    page.wait_for_timeout(300)
    until(page, lambda: text_of(page, "tell") != "Planning …")
    page.wait_for_timeout(100)
    until(page, lambda: page.locator('[aria-busy="true"]').count() == 0)  # the report
    page.wait_for_timeout(700)


def test_the_values_under_the_pointer_the_legend_and_the_colours_are_those_of_the_zarr(page):
    for cell in FREE[[900, 9000, 15000]].tolist():
        said = point_at(page, cell)
        for name in ("gps", "lidar", "risk"):
            assert said[name] == float(MAPS.m(name, 20.0)[tuple(cell)])
        assert said["num_visible"] == float(MAPS.m("num_visible", 20.0)[tuple(cell)])
        assert said["roof"] == float(MAPS.m("roof")[tuple(cell)])
        lon, lat = GRID.lonlat_of_cell(*cell)
        shown = text_of(page, "at").replace("°", "").split()
        assert math.isclose(-float(shown[0]), lon, abs_tol=6e-5)
        assert math.isclose(float(shown[2]), lat, abs_tol=6e-5)
    assert "Obstacles\tfree" in page.locator('[data-is="values"]').inner_text()
    ticks = page.locator(".jv-ticks span").all_inner_texts()
    assert (ticks[0], ticks[-1]) == ("0", "1")
    page.select_option('[name="layer"]', "roof")
    until(page, lambda: "Roof height in metres" in page.locator(".jv-legend").inner_text())
    ticks = page.locator(".jv-ticks span").all_inner_texts()
    assert float(ticks[-1]) == float(MAPS.m("roof").max())
    page.select_option('[name="layer"]', "hdop")
    until(page, lambda: "\u2265" in page.locator(".jv-legend").inner_text())
    heights = page.locator(".jv-ticks span").evaluate_all(
        "all => all.map(each => each.offsetHeight)"
    )
    assert len(set(heights)) == 1  # no text breaks within a tick
    page.select_option('[name="layer"]', "gps")
    page.wait_for_timeout(500)
    cell = FREE[5000].tolist()
    got = ink_at(page, middle_of(page, cell))
    near = MAPS.m("gps", 20.0)[max(cell[0] - 1, 0) : cell[0] + 2, max(cell[1] - 1, 0) : cell[1] + 2]
    colours = metric_colours(MAPS, "gps")(near, bytes=True)[..., :3].reshape(-1, 3).astype(int)
    assert np.abs(colours - got).max(axis=1).min() <= 4


def ink_at(page, at) -> list[int]:
    """Return red, green and blue of a pixel of the map."""
    box = page.locator('[data-is="map"]').bounding_box()
    return page.evaluate(
        "([x, y]) => [...document.querySelector('[data-is=\"map\"]').getContext('2d').getImageData(x, y, 1, 1).data]",
        [round(at[0] - box["x"]), round(at[1] - box["y"])],
    )[:3]


def plan_between(page, *cells) -> None:
    page.click('[data-tab="plan"]')
    page.click('[data-do="clear"]')
    show_all(page)
    for cell in cells or LANDING[[330, -330]].tolist():
        page.mouse.click(*middle_of(page, cell))
    settle(page)


def command_gives(page, capsys) -> dict:
    """Run the printed command; return what it found."""
    program, *arguments = shlex.split(text_of(page, "command"))
    assert program == "jaxurban"
    code, out, err = run(capsys, *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


def saved(page, button: str) -> bytes:
    with page.expect_download() as waiting:
        page.click(button)
    return waiting.value.path().read_bytes()


def route_of(page) -> dict:
    """Return the route that the page saves."""
    return json.loads(saved(page, '[data-format=".geojson"]'))["features"][0]


def test_start_and_goal_a_weight_and_a_zone_change_the_route_and_the_command_gives_it(
    page, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    plan_between(page)
    first = command_gives(page, capsys)
    route = route_of(page)
    assert route["geometry"]["coordinates"] == np.round(first["lonlat"], 7).tolist()
    assert route["properties"]["cost"] == first["cost"]

    slider = page.locator('[name="weight-gps"]')
    slider.focus()
    for _ in range(16):
        page.keyboard.press("ArrowRight")
    settle(page)
    second = command_gives(page, capsys)
    assert second["settings"]["weights"]["gps"] > 5 * first["settings"]["weights"]["gps"]
    assert second["xy_m"] != first["xy_m"]

    middle = GRID.cell_of_xy(*second["xy_m"][len(second["xy_m"]) // 2])
    page.click('[data-do="zone"]')
    show_all(page)
    for row, col in ((-8, -8), (-8, 8), (8, 8), (8, -8)):
        page.mouse.click(*pixel_of(page, middle[0] + row, middle[1] + col))
    page.click('[data-do="zone"]')
    settle(page)
    (tmp_path / "zones.geojson").write_bytes(saved(page, '[data-do="save-zones"]'))
    third = command_gives(page, capsys)
    assert third["settings"]["limits"]["no_fly"][0]["name"] == "zone 1"
    assert third["xy_m"] != second["xy_m"]
    assert route_of(page)["geometry"]["coordinates"] == np.round(third["lonlat"], 7).tolist()
    assert b"<kml" in saved(page, '[data-format=".kml"]')
    assert json.loads(saved(page, '[data-format=".plan"]'))["fileType"] == "Plan"
    assert page.locator('[data-is="profile"] img').is_visible()


def test_a_goal_in_a_building_moves_out_of_it_a_caution_says_so_and_dragging_it_takes_the_route_along(
    browser,
):
    ds, row, col = MAPS.ds.copy(deep=True), 80, 100
    for name, value in (("obstacle", 1), ("roof", 90), ("roof_touched", 90)):
        ds[name][..., row - 4 : row + 5, col - 4 : col + 5] = value
    with shown(browser, Viewer(type(MAPS)(ds))) as page:
        plan_between(page, FREE[300].tolist(), (row, col))
        assert "The goal was not free: it was moved 50.0 m" in text_of(page, "cautions")
        show_all(page)
        page.wait_for_timeout(300)
        end = route_of(page)["geometry"]["coordinates"][-1]
        beside = np.array(GRID.cell_of_lonlat(*end[:2]))
        assert np.abs(beside - (row, col)).max() == 5
        at = middle_of(page, beside)
        assert max(ink_at(page, at)) < 60  # the middle of the goal's mark
        assert max(ink_at(page, middle_of(page, (row, col)))) < 60  # and where it was asked for
        drag(page, at, (60, 60))  # which takes the mark along
        assert route_of(page)["geometry"]["coordinates"][-1] != end


def test_cautions_stand_open_the_mission_is_drawn_before_it_is_saved(
    page,
):
    plan_between(page)
    cautions = page.locator('[data-is="cautions"] p')
    assert all(cautions.nth(k).is_visible() for k in range(cautions.count()))
    assert "Buildings: the nearest" in " ".join(cautions.all_inner_texts())
    limits = page.locator('[data-is="cautions"] .jv-limit')
    assert set(limits.evaluate_all("all => all.map(each => getComputedStyle(each).color)")) == {
        "rgb(176, 0, 32)"
    }
    button = page.locator('[data-is="saved"]').inner_text()
    items = json.loads(saved(page, '[data-format=".plan"]'))["mission"]["items"][
        :-1
    ]  # the last one lands
    assert f"{len(items)} waypoints, cost" in button
    show_all(page)
    page.wait_for_timeout(300)
    lat, lon = np.array([item["params"][4:6] for item in items]).T
    x_m, y_m = GRID.xy_of_lonlat(lon, lat)
    cells = np.stack([y_m - GRID.y_min_m, x_m - GRID.x_min_m], axis=1) / GRID.resolution_m
    places = np.array([pixel_of(page, *cell) for cell in cells])
    apart = (
        np.linalg.norm(places[1:-1] - places[:-2], axis=1) > 14
    )  # those nearer to one another have one dot
    assert apart.sum() > 3
    for place in places[1:-1][apart]:
        assert min(ink_at(page, place)) > 100  # its ring is white within


def metres_per_pixel(page) -> float:
    length, unit = text_of(page, "scale-text").split()
    width = page.locator('[data-is="scale"]').bounding_box()["width"]
    return float(length) * {"m": 1, "km": 1000}[unit] / width


def test_the_view_fits_the_route_the_map_is_whole_until_then_and_0_shows_all(page):
    page.set_viewport_size({"width": 1440, "height": 800})
    page.click('[data-tab="plan"]')
    page.click('[data-do="clear"]')
    show_all(page)
    page.wait_for_timeout(300)
    map_box = page.locator('[data-is="map"]').bounding_box
    before, whole = map_box(), metres_per_pixel(page)
    assert before["height"] == 800
    ends = [[60, 80], [90, 120]]
    for end in ends:
        near = FREE[np.hypot(*(FREE - end).T).argmin()].tolist()
        page.mouse.click(*middle_of(page, near))
    settle(page)
    before = map_box()
    assert 500 < before["height"] < 600  # the report has the rest
    fitted = metres_per_pixel(page)
    lonlat = np.array(route_of(page)["geometry"]["coordinates"])[:, :2]
    x_m, y_m = GRID.xy_of_lonlat(*lonlat.T)
    share = max(np.ptp(x_m) / before["width"], np.ptp(y_m) / before["height"]) / fitted
    assert 0.5 < share < 0.95
    page.set_viewport_size({"width": 1300, "height": 600})
    page.wait_for_timeout(400)
    assert metres_per_pixel(page) > 1.1 * fitted  # it still fits the route
    show_all(page)
    page.set_viewport_size({"width": 1440, "height": 800})
    page.wait_for_timeout(400)
    page.click('[data-do="clear"]')
    page.wait_for_timeout(400)
    assert math.isclose(metres_per_pixel(page), whole, rel_tol=0.02)
    page.set_viewport_size(SIZE)


def test_groups_of_what_stands_are_switched_off_and_on(browser):
    maps, _ = maps_of_kinds()
    maps.ds["gps"][:] = 1  # which is yellow
    row, col = np.argwhere((maps.m("roof_kind") == CODES["wood"]) & (maps.m("roof") == 15))[20]

    def ink() -> list[int]:
        """Return the colour in the middle of a wood, of which the page shows all maps."""
        page.wait_for_timeout(700)
        box = page.locator('[data-is="map"]').bounding_box()
        scale = 1.06 * max(40 / box["width"], 40 / box["height"])
        x = box["x"] + box["width"] / 2 + (col + 0.5 - 20) / scale
        return ink_at(page, (x, box["y"] + box["height"] / 2 - (row + 0.5 - 20) / scale))

    with shown(browser, Viewer(maps)) as page:
        wood = ink()
        assert wood[1] > wood[0] + 40
        assert wood[1] > wood[2] + 30
        page.uncheck('[name="group-1"]')
        assert np.ptp(ink()) < 10  # the grey of obstacles
        page.reload()
        page.wait_for_selector(READY)
        assert not page.is_checked('[name="group-1"]')  # the address keeps it
        page.check('[name="group-1"]')
        assert np.allclose(ink(), wood, atol=2)


def test_outlines_of_buildings_below_the_flight_are_pale_and_guessed_ones_dashed(browser):
    ds = MAPS.ds.copy(deep=True)
    heights_m = {(40, 40): 30.0, (40, 60): 80.0, (40, 80): 80.0}
    for name in ("roof", "roof_touched", "obstacle"):
        ds[name][:] = 0
    ds["gps"][:] = 1  # which is yellow
    guessed = np.zeros(GRID.shape, bool)
    for (row, col), height_m in heights_m.items():
        place = {"y": slice(row, row + 12), "x": slice(col, col + 12)}
        for name in ("roof", "roof_touched"):
            ds[name][place] = height_m
        ds["obstacle"][place] = np.reshape(MAPS.altitudes_m, (3, 1, 1)) <= height_m
    guessed[40:52, 80:92] = True
    maps = type(MAPS)(ds.assign(roof_guessed=(("y", "x"), guessed)))

    def inks(page, row: int, col: int) -> np.ndarray:
        """Return the darkest inks across the western wall of a building, from its south to its north."""
        steps = np.arange(2, 10, 0.05)
        return np.array(
            [
                min(
                    max(ink_at(page, pixel_of(page, row + step, col + off)))
                    for off in (-0.3, 0, 0.3)
                )
                for step in steps
            ]
        )

    with shown(browser, Viewer(maps)) as page:
        page.uncheck('[name="hatch"]')
        page.uncheck('[name="closed"]')
        page.wait_for_timeout(1000)
        low, tall, dashed = (inks(page, *place) for place in heights_m)
        assert max(low.max(), tall.max()) < 150
        assert dashed.min() < 150 < 190 < dashed.max()
        page.select_option('[name="altitude"]', "2")
        page.wait_for_timeout(700)
        assert np.median(inks(page, 40, 60)) < 150
        assert 160 < np.median(inks(page, 40, 40)) < 245


def test_a_report_that_is_refused_leaves_none_of_another_route(browser):
    with shown(browser, Viewer(MAPS), is_well=False) as page:
        plan_between(page)
        totals = page.locator('[data-is="totals"]')
        until(page, totals.is_visible)
        page.fill('[name="power_w"]', "100")  # without a speed, of which no energy is known
        page.keyboard.press("Tab")
        until(page, lambda: not totals.is_visible())
        assert "speed" in text_of(page, "tell")
        assert page.locator('[data-is="report"]').get_attribute("aria-busy") == "false"
        page.fill('[name="power_w"]', "")
        page.keyboard.press("Tab")
        until(page, totals.is_visible)


def test_nothing_is_drawn_beyond_the_border_and_tiles_in_view_are_asked_for_once(browser):
    maps = made_maps(41, 1500)
    maps.ds["gps"][:] = 1  # which is yellow
    with shown(browser, Viewer(maps)) as page:
        tiles = []
        page.on("request", lambda request: tiles.append(request.post_data))
        page.wait_for_timeout(1500)
        box = page.locator('[data-is="map"]').bounding_box()
        pixels_per_row = box["width"] / (1.06 * 1500)

        def ink_of(row: float) -> list[int]:
            up = (row - 41 / 2) * pixels_per_row
            return ink_at(page, (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2 - up))

        assert np.ptp(ink_of(39.5)) > 100
        assert np.ptp(ink_of(45.0)) < 30
        assert len(tiles) == len(set(tiles))


def test_every_format_of_paths_has_a_button_whose_file_bears_city_altitude_time_and_planner(page):
    plan_between(page)
    for suffix, each in FORMATS.items():
        button = page.locator(f'[data-format="{suffix}"]')
        assert button.inner_text() == each.label
        with page.expect_download() as waiting:
            button.click()
        name = f"city_20m_day_2020-04-27T1600Z_astar{suffix}"
        assert waiting.value.suggested_filename == name


def test_a_mission_that_would_land_on_a_roof_is_refused_in_sight_until_its_ends_are_on_the_ground(
    browser,
):
    low = np.argwhere(MAPS.is_free(20.0) & (MAPS.m("roof") == 12))
    with shown(browser, Viewer(MAPS), is_well=False) as page:
        plan_between(page, LANDING[300].tolist(), low[-1].tolist())
        page.click('[data-format=".plan"]')
        tell = page.locator('[data-is="tell"]')
        until(page, lambda: "the mission is not written" in tell.inner_text())
        assert "let its ends be moved to free ground" in tell.inner_text()
        assert tell.is_visible()
        page.click("text=Planners and rules")
        page.check('[name="on_ground"]')
        settle(page)
        assert "the mission is not written" not in tell.inner_text()
        assert json.loads(saved(page, '[data-format=".plan"]'))["fileType"] == "Plan"


@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_a_click_shows_the_sky_over_the_place_and_another_altitude_shows_that_of_there(
    browser, tmp_path
):
    region = {"bounds": (139.766, 35.679, 139.768, 35.681), "resolution_m": 20}
    sample = {"region": region, "buildings": {"source": "sample:nihonbashi"}}
    run_scenario(Scenario.from_dict(sample), tmp_path / "maps", progress=False)
    with shown(browser, Viewer(open_maps(tmp_path / "maps"))) as page:
        corner = page.locator('[data-is="map"]').bounding_box()
        page.mouse.click(corner["x"] + corner["width"] / 2, corner["y"] + corner["height"] / 2)
        page.wait_for_selector(SKY)
        low = page.locator('[data-is="sky"]').inner_html()
        page.select_option('[name="altitude"]', "1")
        until(page, lambda: page.locator('[data-is="sky"]').inner_html() != low)
        assert " seen, " in low
        assert " stands at 139.76" in page.locator('[data-is="stands"]').inner_text()
        box = page.locator(SKY).bounding_box()
        assert box["y"] + box["height"] / 2 < SIZE["height"]  # in sight without scrolling
        page.set_viewport_size({"width": 1440, "height": 900})
        page.wait_for_timeout(300)
        last = page.locator('[data-is="values"] tr').last.bounding_box()
        box = page.locator(SKY).bounding_box()
        assert last["x"] + last["width"] < box["x"]  # the sky stands beside the list, both in sight
        assert max(each["y"] + each["height"] for each in (last, box)) < 900
        shown_map = page.locator(".jv-map").bounding_box()
        assert shown_map["width"] * shown_map["height"] >= 0.5 * 1440 * 900
        page.click('[data-do="leave"]')
        until(page, lambda: not page.locator('[data-is="sky-box"]').is_visible())
        page.set_viewport_size(SIZE)
        show_all(page)
        page.keyboard.press("Enter")
        page.wait_for_selector(SKY)
        page.keyboard.press("Escape")
        until(page, lambda: page.locator('[data-is="sky"]').inner_html() == "")
        until(page, lambda: page.locator('[data-is="stands"]').inner_html() == "")
        page.keyboard.press("Enter")
        page.wait_for_selector(SKY)


def test_a_sky_that_is_refused_says_so_where_it_would_stand_and_nothing_while_planning(browser):
    with shown(browser, Viewer(MAPS), is_well=False) as page:
        corner = page.locator('[data-is="map"]').bounding_box()
        page.mouse.click(corner["x"] + corner["width"] / 2, corner["y"] + corner["height"] / 2)
        sky = page.locator('[data-is="sky"]')
        until(page, lambda: "made in memory" in sky.inner_text())
        until(page, lambda: page.locator('[data-is="tell"]').inner_text() == "")
        page.click('[data-tab="plan"]')
        assert not sky.is_visible()


def test_the_keyboard_alone_plans_a_route(page):
    page.click('[data-tab="plan"]')
    page.click('[data-do="clear"]')
    show_all(page)
    page.keyboard.press("Enter")
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    settle(page)
    assert page.locator(".jv-route").count() == 1


def test_a_page_of_few_bytes_holds_fewer_cells_and_is_no_larger(tmp_path):
    viewer, file = Viewer(made_maps(300, 300)), tmp_path / "page.html"
    whole = write_page(viewer, file, 20 * 2**20)
    assert b'"strides":[1]' in file.read_bytes()
    assert write_page(viewer, file, whole // 2) <= whole // 2
    assert b'"strides":[2]' in file.read_bytes()


def test_the_exported_file_shows_maps_and_values_without_any_server(browser, tmp_path):
    file = tmp_path / "page.html"
    assert (
        write_page(Viewer(MAPS, name="city"), file, 10 * 2**20) == file.stat().st_size < 10 * 2**20
    )
    with opened(browser, file.as_uri()) as page:
        cell = FREE[5000].tolist()
        assert point_at(page, cell)["gps"] == float(MAPS.m("gps", 20.0)[tuple(cell)])
        page.select_option('[name="altitude"]', "2")
        page.select_option('[name="layer"]', "h_norm")
        until(page, lambda: "normalised cost" in page.locator(".jv-legend").inner_text())
        point_at(page, FREE[900].tolist())
        assert point_at(page, cell)["gps"] == float(MAPS.m("gps", 60.0)[tuple(cell)])
        assert not page.locator('[data-tab="plan"]').is_visible()


def test_the_page_works_as_a_widget_by_messages_alone(browser):
    viewer = Viewer(MAPS)

    def kernel(message):
        reply, buffers = reply_to(viewer, message)
        return {"reply": reply, "buffers": [base64.b64encode(each).decode() for each in buffers]}

    page = browser.new_page(viewport={"width": 800, "height": 700})
    page.expose_function("kernel", kernel)
    page.set_content(f"<style>{part('style')}</style><div id='cell'></div>")
    page.evaluate(
        """async ([script, markup]) => {
          let told;
          const bytes = text => new DataView(Uint8Array.from(atob(text), letter => letter.charCodeAt(0)).buffer);
          const model = { get: () => markup, on: (_, callback) => { told = callback; },
            send: async message => { const { reply, buffers } = await window.kernel(message);
              told(reply, buffers.map(bytes)); } };
          const address = URL.createObjectURL(new Blob([script], { type: 'text/javascript' }));
          (await import(address)).default.render({ model, el: document.getElementById('cell') });
        }""",
        [part("script"), part("markup")],
    )
    page.wait_for_selector(READY, timeout=60_000)
    page.wait_for_timeout(500)
    assert point_at(page, FREE[5000].tolist())["gps"] == float(
        MAPS.m("gps", 20.0)[tuple(FREE[5000])]
    )
    plan_between(page)
    assert "cost" in page.locator(".jv-route").inner_text()
    assert not page.locator('[data-is="command"]').is_visible()
    page.evaluate("() => { document.onkeydown = ({ key }) => { window.passed = key; }; }")
    page.locator("canvas").press("b")
    assert page.evaluate("window.passed ?? null") is None  # else a notebook adds a cell
    cell, drawn, button = (
        page.locator(each).bounding_box() for each in (".jv", ".jv-map", '[data-format=".plan"]')
    )
    assert drawn["width"] * drawn["height"] >= 0.5 * cell["width"] * cell["height"]
    assert cell["y"] <= button["y"] <= cell["y"] + cell["height"] - button["height"]
    page.close()


def test_maps_that_were_made_again_are_named_on_the_page_and_a_button_loads_them(browser, tmp_path):
    def opened_viewer() -> Viewer:
        return Viewer(open_maps(tmp_path))

    cell = FREE[5000].tolist()
    MAPS.save(tmp_path)
    with shown(browser, opened_viewer(), opened_viewer, is_well=False) as page:
        before = point_at(page, cell)["gps"]
        type(MAPS)(MAPS.ds.assign(gps=0.5 * MAPS.ds["gps"])).save(tmp_path)
        page.select_option('[name="layer"]', "risk")
        until(page, lambda: "were made again" in text_of(page, "tell"))
        page.select_option('[name="layer"]', "gps")
        page.wait_for_timeout(500)
        assert "were made again" in text_of(page, "tell")  # which nothing takes away
        page.click('[data-do="reload"]')
        page.wait_for_selector(READY, timeout=60_000)
        assert math.isclose(point_at(page, cell)["gps"], 0.5 * before, rel_tol=1e-6)
        assert not page.locator('[data-do="reload"]').is_visible()


def test_a_refused_request_leaves_no_other_route_and_no_command_standing(browser, folder):
    with shown(browser, Viewer(MAPS, folder=str(folder)), is_well=False) as page:
        page.click('[data-tab="plan"]')
        page.mouse.click(*middle_of(page, FREE[900]), button="right")  # which asks for nothing
        assert text_of(page, "hint") == "Click the map for the start."
        plan_between(page, *FREE[[900, 15000]].tolist())
        page.click("text=Planners and rules")
        page.check('[value="theta-star"]')
        settle(page)
        assert page.locator(".jv-route").count() == 2
        page.fill('[name="clearance_m"]', "-5")
        page.keyboard.press("Tab")
        settle(page)
        assert "clearance_m" in text_of(page, "tell")
        tell, at = (page.locator(f'[data-is="{name}"]').bounding_box() for name in ("tell", "at"))
        assert tell["y"] >= at["y"] + at["height"]  # one reads both
        assert page.locator(".jv-route").count() == 0
        assert not page.locator('[data-is="command"]').is_visible()


def test_the_old_profile_bears_the_pointer_until_the_new_one_is_there(browser):
    class Slow(Viewer):
        def report(self, query):
            time.sleep(1)
            return super().report(query)

    with shown(browser, Slow(MAPS)) as page:
        plan_between(page, *FREE[[900, 15000]].tolist())
        page.wait_for_selector('[data-is="profile"] .jv-along')
        box = page.locator('[data-is="profile"] .jv-along').bounding_box()
        page.locator('[name="weight-gps"]').press("ArrowRight")
        page.wait_for_timeout(200)
        until(page, lambda: text_of(page, "tell") == "")
        for share in np.linspace(0.1, 0.9, 40):
            page.mouse.move(box["x"] + share * box["width"], box["y"] + 40)
        page.wait_for_timeout(1500)
