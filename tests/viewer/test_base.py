"""The base map, opacity, flight between the levels and the address, against shapes and colours made by hand."""

import json
import re
from dataclasses import replace
from urllib.parse import quote, unquote

import geopandas as gpd
import numpy as np
import pytest
import shapely

from jaxurban.draw.metrics import metric_colours
from jaxurban.io.geoparquet import write_geoparquet
from jaxurban.viewer.html import write_page
from jaxurban.viewer.viewer import Viewer
from tests.made_maps import made_maps
from tests.viewer.browser import READY, opened, shown
from tests.viewer.test_page import (
    ink_at,
    metres_per_pixel,
    middle_of,
    pixel_of,
    plan_between,
    route_of,
    settle,
    text_of,
)
from tests.viewer.test_viewer import answer

MAPS = made_maps(160, 200, (10.0, 20.0, 60.0))
GRID, FREE = MAPS.grid, np.argwhere(MAPS.is_free(20.0))
LAKE_M, STREET_M = (
    (0, 0, 1000, 800),
    ((0, 1200), (2000, 1200)),
)  # from the southwest corner, x to the east
ISLAND_M = (400, 300, 600, 500)


@pytest.fixture(scope="module")
def with_base(tmp_path_factory):
    shapes = [
        shapely.box(*LAKE_M) - shapely.box(*ISLAND_M),
        shapely.LineString(STREET_M),
        shapely.Point(1500, 400),
        shapely.Point(1990, 800),
    ]
    corner_m = GRID.x_min_m, GRID.y_min_m
    moved = [shapely.transform(shape, lambda points: points + corner_m) for shape in shapes]
    names = ["The <Lake>", "Main Street", "Hill", "Easternmost Quarter"]
    rows = {"kind": ["water", "major", "place", "place"], "name": names}
    frame = gpd.GeoDataFrame(rows, geometry=moved, crs=GRID.crs).to_crs("EPSG:4326")
    file = tmp_path_factory.mktemp("base") / "basemap.parquet"
    frame.attrs = {"credit": "drawn by hand", "licence": "none"}
    write_geoparquet(file, frame, frame.attrs)
    return replace(MAPS, base=file)


def test_the_base_map_is_in_metres_from_the_corner_and_there_is_none_where_the_source_has_none(
    with_base,
):
    assert answer(Viewer(MAPS), "base") == {}
    assert not answer(Viewer(MAPS), "scene")["has_base"]
    found = answer(Viewer(with_base), "base")
    rings = [np.reshape(ring, (-1, 2)) for ring in found["shapes"]["water"]]
    assert sorted(shapely.Polygon(ring).area for ring in rings) == pytest.approx(
        [200 * 200, 1000 * 800], rel=0.01
    )
    (street,) = (np.reshape(line, (-1, 2)) for line in found["shapes"]["major"])
    assert np.abs(street[[0, -1]] - STREET_M).max() <= 1
    names = {row[2]: row for row in found["names"]}
    assert names["Hill"][:2] == pytest.approx([1500, 400], abs=1)
    assert names["Main Street"][:2] == pytest.approx([1000, 1200], abs=1)
    assert abs(names["Main Street"][4]) < 0.01  # it runs to the east


@pytest.fixture
def page(browser, with_base):
    with shown(browser, Viewer(with_base)) as page:
        page.wait_for_timeout(500)
        yield page


def fade(page, percent: int) -> None:
    page.locator('[name="opacity"]').evaluate(
        "(each, value) => { each.value = value; each.dispatchEvent(new Event('input')); }", percent
    )
    page.wait_for_timeout(400)


@pytest.mark.slow
def test_opacity_blends_the_maps_true_colour_with_the_ground_and_water_lies_below(page):
    page.uncheck('[name="hatch"]')
    page.uncheck('[name="closed"]')
    land, lake, island = ([60, 150], [15, 75], [40, 50])  # rows and columns
    free = [FREE[np.hypot(*(FREE - place).T).argmin()].tolist() for place in (land, lake)]
    fade(page, 0)
    grounds = [np.array(ink_at(page, middle_of(page, cell))) for cell in free]
    assert grounds[0].min() > 240  # bare ground is nearly white
    assert grounds[1][2] > grounds[1][0] + 30  # water is blue
    assert min(ink_at(page, middle_of(page, island))) > 240  # and has its island
    for percent in (40, 70, 100):
        fade(page, percent)
        for cell, ground in zip(free, grounds, strict=True):
            row, col = cell
            near = MAPS.m("gps", 20.0)[row - 1 : row + 2, col - 1 : col + 2]
            colours = 255 * metric_colours(MAPS, "gps")(near)[..., :3].reshape(-1, 3)
            blended = colours * percent / 100 + ground * (1 - percent / 100)
            assert np.abs(blended - ink_at(page, middle_of(page, cell))).max(axis=1).min() <= 5


@pytest.mark.slow
def test_colours_over_water_and_land_are_the_legends_until_the_map_is_faded(page):
    page.uncheck('[name="hatch"]')
    page.uncheck('[name="closed"]')
    page.wait_for_timeout(400)
    for place in ([60, 150], [15, 75]):  # on land and in the lake
        row, col = FREE[np.hypot(*(FREE - place).T).argmin()].tolist()
        near = MAPS.m("gps", 20.0)[row - 1 : row + 2, col - 1 : col + 2]
        colours = 255 * metric_colours(MAPS, "gps")(near)[..., :3].reshape(-1, 3)
        ink = ink_at(page, middle_of(page, (row, col)))
        assert np.abs(colours - ink).max(axis=1).min() <= 2


@pytest.mark.slow
def test_an_exported_page_draws_the_base_map_without_any_server(browser, with_base, tmp_path):
    write_page(Viewer(with_base, name="city"), file := tmp_path / "page.html", 10 * 2**20)
    with opened(browser, file.as_uri()) as page:
        page.uncheck('[name="hatch"]')
        page.uncheck('[name="closed"]')
        fade(page, 0)
        red, _, blue = ink_at(page, pixel_of(page, 15, 75))
        assert blue > red + 30


@pytest.mark.slow
def test_a_reload_keeps_the_plan_and_an_address_of_other_maps_is_refused_in_a_sentence(page):
    plan_between(page)
    page.fill('[name="flight_m"]', "37.5")
    page.fill('[name="vertical_clearance_m"]', "6")
    page.keyboard.press("Tab")
    settle(page)
    assert re.search(r"map shows .*\b(20|60) m", text_of(page, "between"))
    before, address = route_of(page), page.url
    assert "37.5" in json.dumps(before["properties"])
    page.reload()
    page.wait_for_selector(READY, timeout=60_000)
    settle(page)
    assert route_of(page) == before
    assert page.url == address
    plan = json.loads(unquote(address.partition("#")[2]))
    parts = (
        {"ofMaps": "others"},
        {"zones": [[]]},
        {"fields": []},
        {"ends": plan["ends"] | {"via": [1, 1]}},
    )
    for wrong in ("#nonsense", *("#" + quote(json.dumps(plan | part)) for part in parts)):
        page.goto("about:blank")
        page.goto(address.partition("#")[0] + wrong)
        page.wait_for_selector(READY, timeout=60_000)
        page.wait_for_timeout(300)
        assert "holds no plan of these maps" in text_of(page, "tell")
        assert page.locator(".jv-route").count() == 0


@pytest.mark.slow
def test_the_route_is_never_under_the_report_and_the_fit_follows_the_window(page):
    south, north = FREE[0].tolist(), FREE[-1].tolist()
    plan_between(page, north, south)
    for width, height in ((1280, 720), (1024, 700), (1920, 1080)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(500)
        report = page.locator('[data-is="report"]').bounding_box()
        lon, lat = route_of(page)["geometry"]["coordinates"][-1][:2]  # the southern end
        at = middle_of(page, GRID.cell_of_lonlat(lon, lat))
        assert at[1] < report["y"] or at[0] > report["x"] + report["width"]
        assert max(ink_at(page, at)) < 60  # the goal's mark


def written(page) -> list[list]:
    """Return the level texts on the map when it is drawn again: each text, its ends and height in pixels."""
    found = page.evaluate(
        """async () => { const pen = CanvasRenderingContext2D.prototype, write = pen.fillText, found = [];
          pen.fillText = function (text, x, y) {
            const { a, b, e, f } = this.getTransform(), { width } = this.measureText(text);
            const left = e + a * (this.textAlign === 'center' ? x - width / 2 : x);
            if (b === 0) found.push([String(text), left, left + width, f + a * y]);
            write.call(this, text, x, y);
          };
          document.querySelector('[name="opacity"]').dispatchEvent(new Event('input'));
          await new Promise(done => setTimeout(done, 200));
          pen.fillText = write;
          return found; }"""
    )
    box = page.locator("canvas").bounding_box()
    west, north = box["x"], box["y"]
    return [[text, west + left, west + right, north + y] for text, left, right, y in found]


@pytest.mark.slow
def test_a_name_that_would_lie_below_the_legend_is_not_written(page):
    box, canvas = (page.locator(each).bounding_box() for each in ('[data-is="legend"]', "canvas"))
    (left, right, y), *_ = [place for text, *place in written(page) if text == "Hill"]
    at = canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2
    by = box["x"] + box["width"] / 2 - (left + right) / 2, box["y"] + box["height"] / 2 - y
    page.mouse.move(*at)
    page.mouse.down()
    page.mouse.move(at[0] + by[0], at[1] + by[1], steps=5)
    page.mouse.up()
    assert "Hill" not in {text for text, *_ in written(page)}


@pytest.mark.slow
def test_names_stay_inside_the_maps_area_and_labels_of_ends_inside_the_page(page):
    west, east = (pixel_of(page, 0, col)[0] for col in (0, GRID.num_cols))
    texts = written(page)
    assert {text for text, *_ in texts} >= {"Hill", "Easternmost Quarter"}
    assert all(west <= left and right <= east for _, left, right, _ in texts)

    # Arrows move the map, and with it the goal over the eastern edge of the page.
    plan_between(page)
    canvas = page.locator("canvas").bounding_box()
    edge, seen = canvas["x"] + canvas["width"], []
    for _ in range(20):
        seen += [right for text, _, right, _ in written(page) if text == "goal"]
        page.keyboard.press("ArrowLeft")
    assert 3 < len(seen) < 20
    assert max(seen) <= edge


@pytest.mark.slow
def test_a_route_is_a_wide_line_of_its_planners_colour_on_every_layer(page):
    plan_between(page)
    length_px = route_of(page)["properties"]["length_m"] / metres_per_pixel(page)
    colour = page.locator(".jv-route .jv-dot").evaluate("e => getComputedStyle(e).backgroundColor")
    for layer in ("gps", "lidar", "risk", "population", "h_norm"):
        page.locator('[name="layer"]').evaluate(
            "(each, name) => { each.value = name; each.dispatchEvent(new Event('change')); }", layer
        )
        settle(page)
        (num_pixels,) = pixels_of(page, [colour])
        assert num_pixels > 3 * length_px


@pytest.mark.slow
def test_routes_that_coincide_are_both_in_sight(page):
    plan_between(page, (82, 20), (82, 180))  # along a street
    for name in ("gps", "lidar", "population", "risk"):
        page.locator(f'[name="weight-{name}"]').press("Home")  # so that it weighs nothing
    page.click("text=Planners and rules")
    page.check('[value="ptp"]')
    settle(page)
    colours = page.locator(".jv-route .jv-dot").evaluate_all(
        "all => all.map(e => getComputedStyle(e).backgroundColor)"
    )
    num_pixels = pixels_of(page, colours)
    assert len(num_pixels) == 2
    assert min(num_pixels) > 0.3 * max(num_pixels)
    page.check('[value="theta-star"]')
    settle(page)
    assert text_of(page, "tell") == ""
    assert page.locator(".jv-route").count() == 3


def pixels_of(page, colours: list[str]) -> list[int]:
    """Return how many pixels of the map have each of some colours."""
    return page.evaluate(
        """colours => { const map = document.querySelector('[data-is="map"]');
          const inks = map.getContext('2d').getImageData(0, 0, map.width, map.height).data, found = {};
          for (let k = 0; k < inks.length; k += 4) {
            const ink = `rgb(${inks[k]}, ${inks[k + 1]}, ${inks[k + 2]})`;
            found[ink] = (found[ink] ?? 0) + 1;
          }
          return colours.map(colour => found[colour] ?? 0); }""",
        colours,
    )


@pytest.mark.slow
def test_the_hatch_of_a_coarser_tile_shows_nowhere_that_a_finer_one_has_a_fix(browser):
    maps = made_maps(300, 300)  # two strides; the coarse one takes every second cell
    hdop = np.ones(maps.ds["hdop"].shape, np.float32)
    hdop[..., 1::2, 1::2] = np.inf
    with shown(
        browser, Viewer(type(maps)(maps.ds.assign(hdop=(maps.ds["hdop"].dims, hdop))))
    ) as page:
        page.wait_for_timeout(1500)
        share = page.evaluate(
            """() => { const map = document.querySelector('[data-is="map"]'), middle = map.width / 2;
              const inks = map.getContext('2d').getImageData(middle - 150, map.height / 2 - 150, 300, 300).data;
              let red = 0;
              for (let k = 0; k < inks.length; k += 4) red += inks[k] === 208 && inks[k + 1] === 24;
              return red / inks.length * 4; }"""
        )
    assert 0.02 < share < 0.13  # lines of a third, over a quarter of the cells at most


@pytest.mark.slow
def test_reset_draws_the_layer_that_the_list_then_names(page):
    first = page.locator(".jv-legend").inner_text()
    page.select_option('[name="layer"]', "roof")
    page.wait_for_timeout(500)
    assert page.locator(".jv-legend").inner_text() != first
    page.click('[data-do="reset"]')
    page.wait_for_timeout(500)
    assert page.locator('[name="layer"]').input_value() == "gps"
    assert page.locator(".jv-legend").inner_text() == first
