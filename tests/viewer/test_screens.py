"""The page on a phone, a tablet and a desktop, by touch and by keys: nothing is cut, and the map takes half of it."""

import base64
import json
import math
import re

import numpy as np
import pytest

from jaxurban.knowledge import Guess, GuessKind
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.viewer.viewer import Viewer
from tests.guess_records import FLAT, attribute, heights
from tests.made_maps import made_maps
from tests.viewer.browser import opened, served
from tests.viewer.test_page import middle_of, pixel_of, route_of, saved, settle, text_of, until

pytestmark = pytest.mark.slow
CREDIT = "© OpenStreetMap contributors; US Census Bureau; NYC Open Data"
BEYOND = Guess(GuessKind.BEYOND_DATA, 0.17, facts={"altitude_m": 20.0})
GUESSES = attribute(heights(0.03), FLAT, BEYOND)
MADE = made_maps(160, 200, (10.0, 20.0, 60.0))
MAPS = MetricMaps(MADE.ds.assign_attrs(GUESSES, attribution=CREDIT))
GRID, FREE = MAPS.grid, np.argwhere(MAPS.is_free(20.0))
START, GOAL = FREE[[3000, -3000]].tolist()
PHONE = {"viewport": {"width": 375, "height": 812}, "has_touch": True, "is_mobile": True}
NARROW = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
TABLET = {"viewport": {"width": 768, "height": 1024}, "has_touch": True}
DESKTOP = {"viewport": {"width": 1440, "height": 900}}
BUTTONS = ['[data-format=".geojson"]', '[data-format=".plan"]']
# Texts of which a part cannot be read: beyond the page or a box that clips them, or one over another. Pictures' own
# texts and those of lists are not looked at, nor lines of code, which scroll.
FAULTS = """() => {
  const walker = document.createTreeWalker(document.querySelector(".jv"), NodeFilter.SHOW_TEXT);
  const bar = document.querySelector("header").getBoundingClientRect(), parts = [], faults = [];
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement, range = document.createRange();
    if (!node.data.trim() || !parent.checkVisibility() || parent.closest("select, svg, pre, code")) continue;
    range.selectNodeContents(node);
    for (let { left, right, top, bottom } of range.getClientRects()) {
      if (parent.closest("aside > div")) top = Math.max(top, bar.bottom);
      for (let box = parent; box; box = box.parentElement) {
        const clip = box.getBoundingClientRect(), { display, overflowX } = getComputedStyle(box);
        if (display === "contents" || overflowX === "visible" && box !== document.documentElement) continue;
        if (left < clip.left - 1 || right > clip.right + 1) faults.push(`cut: ${node.data}`);
        [top, bottom] = [Math.max(top, clip.top), Math.min(bottom, clip.bottom)];
      }
      if (bottom - top > 1) parts.push({ node, left, right, top, bottom });
    }
  }
  parts.forEach((a, k) => parts.slice(k + 1).forEach(b => {
    const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (a.node !== b.node && across > 1 && down > 2) faults.push(`over: ${a.node.data} | ${b.node.data}`);
  }));
  if (document.documentElement.scrollWidth > innerWidth) faults.push("wider than the page");
  return parts.length ? faults : ["no text"];
}"""


@pytest.fixture(scope="module")
def url():
    with served(Viewer(MAPS, name="manhattan 2026-11-25")) as server:
        yield server.url


def share_of_map(page) -> float:
    """Return how much of the page the map takes."""
    box, whole = page.locator(".jv-map").bounding_box(), page.viewport_size
    return box["width"] * box["height"] / (whole["width"] * whole["height"])


def is_in_sight(page, name: str) -> bool:
    """Return whether a part of the page is shown whole, on top of all else."""
    return page.locator(name).evaluate(
        """each => { const { left, right, top, bottom } = each.getBoundingClientRect();
          return [[left + 2, top + 2], [right - 2, bottom - 2]].every(at =>
            each.contains(document.elementFromPoint(...at))); }"""
    )


@pytest.mark.parametrize("screen", [PHONE, TABLET, DESKTOP], ids=["375", "768", "1440"])
def test_no_text_is_cut_or_over_another_and_the_map_takes_half_of_each_screen(browser, url, screen):
    with opened(browser, url, **screen) as page:

        def check() -> None:
            page.wait_for_timeout(200)
            assert page.evaluate(FAULTS) == []
            assert share_of_map(page) >= 0.5 - 1e-6

        check()
        for tab in ("look", "check", "plan"):
            page.click(f'[data-tab="{tab}"]')
            check()
        page.click("text=Planners and rules")
        check()
        page.locator("canvas").focus()
        page.keyboard.press("0")
        for cell in (START, GOAL):
            page.mouse.click(*middle_of(page, cell))
        settle(page)
        check()
        until(page, lambda: all(is_in_sight(page, each) for each in BUTTONS if screen is not PHONE))
        report = page.locator("text=Report by segment")
        report.click()
        report.scroll_into_view_if_needed()
        check()


class Hand:
    """Fingers on a page, as Chromium takes them from a screen."""

    def __init__(self, page):
        self.page, self.driver = page, page.context.new_cdp_session(page)

    def put(self, kind: str, *places) -> None:
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        self.driver.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def move(self, *ways) -> None:
        """Move each finger along its way, which is given by its begin and its end."""
        begins, ends = np.transpose(ways, (1, 0, 2))
        self.put("touchStart", *begins.tolist())
        for share in np.linspace(0.2, 1, 5):
            self.put("touchMove", *(begins + share * (ends - begins)).tolist())
        self.page.wait_for_timeout(100)
        self.put("touchMove", *ends.tolist())  # a finger that lifts at rest flings nothing
        self.put("touchEnd")
        self.page.wait_for_timeout(100)

    def rest(self, place) -> None:
        self.put("touchStart", place)
        self.page.wait_for_timeout(700)
        self.put("touchEnd")

    def tap(self, place) -> None:
        self.page.touchscreen.tap(*place)

    def tap_on(self, name: str) -> None:
        """Tap a button, and wait for its click, which comes after the finger, and for what it draws."""
        button = self.page.locator(name)
        button.evaluate(
            "button => { window.clicked = new Promise(done =>"
            " button.addEventListener('click', () => requestAnimationFrame(() => done()), { once: true })); }"
        )
        button.tap()
        self.page.evaluate("window.clicked")


def metres_per_pixel(page) -> float:
    length, unit = text_of(page, "scale-text").split()
    return (
        float(length)
        * {"m": 1, "km": 1000}[unit]
        / page.locator('[data-is="scale"]').bounding_box()["width"]
    )


def test_touch_alone_opens_the_sheet_plans_a_route_and_a_zone_moves_the_map_and_reads_a_cell(
    browser, url
):
    with opened(browser, url, **PHONE) as page:
        hand = Hand(page)
        is_open = page.locator('[name="altitude"]').is_visible
        assert not is_open()
        x, y = (100, page.locator("header").bounding_box()["y"] + 20)
        hand.move([(x, y), (x, y - 100)])
        until(page, is_open)
        hand.tap_on('[data-do="sheet"]')
        until(page, lambda: not is_open())

        hand.tap_on('[data-tab="plan"]')
        for cell in (START, GOAL):
            page.wait_for_timeout(200)
            hand.tap(middle_of(page, cell))
        settle(page)
        assert "cost" in page.locator(".jv-route").inner_text()
        until(page, lambda: is_in_sight(page, ".jv-route"))
        until(page, lambda: is_in_sight(page, '[data-is="cautions"] p >> nth=0'))
        first = route_of(page)["geometry"]["coordinates"]

        hand.tap_on('[data-do="zone"]')
        hand.tap_on('[data-do="fit"]')
        middle = GRID.cell_of_lonlat(*first[len(first) // 2][:2])
        for row, col in ((-14, -14), (-14, 14), (14, 14), (14, -14)):
            hand.tap(pixel_of(page, middle[0] + row, middle[1] + col))
        hand.tap_on('[data-do="zone"]')
        settle(page)
        second = route_of(page)["geometry"]["coordinates"]
        assert second != first
        assert len(json.loads(saved(page, '[data-do="save-zones"]'))["features"]) == 1

        hand.tap_on('[data-do="fit"]')
        at = middle_of(page, GRID.cell_of_lonlat(*second[-1][:2]))
        hand.move([at, (at[0] - 30, at[1] + 40)])  # the goal
        settle(page)
        third = route_of(page)["geometry"]["coordinates"]
        assert third[-1] != second[-1]
        assert third[0] == second[0]

        hand.tap_on('[data-do="fit"]')
        box, before = page.locator(".jv-map").bounding_box(), metres_per_pixel(page)
        x, y = box["x"] + 150, box["y"] + 160
        hand.move([(x - 30, y), (x - 60, y)], [(x + 30, y), (x + 60, y)])
        until(page, lambda: math.isclose(metres_per_pixel(page), before / 2, rel_tol=0.03))
        hand.move([(x - 60, y), (x - 30, y)], [(x + 60, y), (x + 30, y)])
        until(page, lambda: math.isclose(metres_per_pixel(page), before, rel_tol=0.03))
        hand.move([(x, y), (x, y + 50)])
        assert route_of(page)["geometry"]["coordinates"] == third  # none of these set an end

        hand.tap_on('[data-do="fit"]')
        cell = FREE[9000].tolist()
        hand.rest(middle_of(page, cell))
        values = page.locator('[data-is="values"]')
        until(page, lambda: values.get_attribute("data-cell") == f"{cell[0]} {cell[1]}")
        until(page, lambda: is_in_sight(page, '[data-is="values"] tr >> nth=0'))
        gps = page.locator('[data-layer="gps"]').get_attribute("data-value")
        assert float(gps) == float(MAPS.m("gps", 20.0)[tuple(cell)])


@pytest.mark.parametrize("screen", [PHONE, DESKTOP], ids=["375", "1440"])
def test_keys_alone_plan_a_route_close_a_zone_and_save_both(browser, url, screen):
    with opened(browser, url, **screen) as page:

        def reach(name: str) -> None:
            for _ in range(80):
                if page.evaluate("name => document.activeElement.matches(name)", name):
                    return
                page.keyboard.press("Tab")
            raise AssertionError(f"no key reaches {name}")

        def press(*keys: str) -> None:
            for key in keys:
                page.keyboard.press(key)

        def kept(name: str) -> bytes:
            reach(name)
            with page.expect_download() as waiting:
                press("Enter")
            return waiting.value.path().read_bytes()

        reach('[data-tab="plan"]')
        press("Enter")
        page.wait_for_timeout(300)
        reach("canvas")
        assert page.locator(".jv-keys").is_visible()
        press("0", "ArrowLeft", "ArrowLeft", "s", "ArrowRight", "ArrowRight", "ArrowRight", "g")
        settle(page)
        assert page.locator(".jv-route").count() == 1
        first = json.loads(kept('[data-format=".geojson"]'))["features"][0]

        reach('[data-do="zone"]')
        press("Enter")
        assert page.evaluate("document.activeElement.matches('canvas')")
        press("0", "ArrowUp", "Enter", "ArrowLeft", "Enter", "ArrowDown", "ArrowDown", "Enter", "z")
        settle(page)
        second = json.loads(kept('[data-format=".geojson"]'))["features"][0]
        assert second["geometry"] != first["geometry"]
        assert len(json.loads(kept('[data-do="save-zones"]'))["features"]) == 1


@pytest.mark.parametrize("screen", [NARROW, DESKTOP], ids=["390", "1440"])
def test_three_steps_of_tab_lead_to_the_map_from_the_start_and_from_each_tab(browser, url, screen):
    with opened(browser, url, **screen) as page:

        def steps_to(name: str) -> int:
            for num in range(80):
                if page.evaluate("name => document.activeElement.matches(name)", name):
                    return num
                page.keyboard.press("Tab")
            raise AssertionError(f"no key reaches {name}")

        assert steps_to("canvas") <= 3
        for tab in ("look", "plan", "check"):
            page.locator(f'[data-tab="{tab}"]').focus()
            page.keyboard.press("Enter")
            assert steps_to('[data-do="map"]') <= 3
            skip = page.locator('[data-do="map"]')
            assert skip.evaluate("each => getComputedStyle(each).opacity") == "1"
            page.keyboard.press("Enter")
            assert page.evaluate("document.activeElement.matches('canvas')")


@pytest.mark.parametrize("screen", [NARROW, DESKTOP], ids=["390", "1440"])
def test_the_letters_of_the_profile_are_10_pixels_high(browser, url, screen):
    with opened(browser, url, **screen) as page:
        page.click('[data-tab="plan"]')
        if screen is NARROW:
            page.locator('[data-do="sheet"]').tap()
        page.locator("canvas").focus()
        page.keyboard.press("0")
        for cell in (START, GOAL):
            page.mouse.click(*middle_of(page, cell))
        settle(page)
        picture = page.locator('[data-is="profile"] img')
        source = base64.b64decode(picture.get_attribute("src").partition(",")[2]).decode()
        wide = float(re.search(r'viewBox="0 0 ([\d.]+) ', source)[1])
        sizes = {float(size) for size in re.findall(r"font(?:-size)?: ([\d.]+)px", source)}
        shown = picture.evaluate("each => each.getBoundingClientRect().width")
        assert min(sizes) * shown / wide >= 10


def test_on_a_phone_what_the_maps_guess_is_one_line_that_opens(browser, url):
    with opened(browser, url, **NARROW) as page:
        bar = page.locator(".jv-guess")
        assert bar.inner_text() == f"What these maps guess ({len(MAPS.guesses)})"
        assert bar.bounding_box()["height"] < 0.04 * 844
        bar.locator("summary").tap()
        for guess in MAPS.guesses:
            assert guess.sentence in bar.inner_text()
    with opened(browser, url, **DESKTOP) as page:
        assert page.locator(".jv-guess").inner_text().startswith("Guessed: 3 % of heights")
