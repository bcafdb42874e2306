"""The site of the docs works where it is read from a folder (`make docs` builds it, and runs this)."""

import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import jaxurban as ju
from tests.test_docs import NOTEBOOKS
from tests.test_docstrings import NAMES

SITE = Path(os.environ.get("JAXURBAN_SITE", "none")).resolve()
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not SITE.is_dir(), reason="make docs builds the site and names it"),
]


@pytest.fixture
def page() -> Iterator[Any]:
    """A page of a browser, which knows what it asked for."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("there is no chromium here")
    with api.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.asked = []
        page.on("request", lambda request: page.asked.append(request.url))
        yield page
        browser.close()


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ("courtyard", r"/guides/plan\.html|/guides/trouble\.html"),
        ("no-fly zone", r"/guides/plan\.html"),
        ("vertical_clearance_m", r"/guides/plan\.html|/reference/commands\.html"),
        ("plan_many", r"/reference/functions/plan_many\.html"),
        ("ju.return_altitude", r"/reference/functions/return_altitude\.html"),
    ],
)
def test_search_works_from_a_folder_and_asks_no_server(words, first, page):
    page.goto((SITE / "guides/sky.html").as_uri())
    page.locator("input.md-search__input").fill(words)
    result = page.locator(".md-search-result__link").first
    result.wait_for(timeout=20_000)
    assert re.search(first, result.get_attribute("href"))
    assert [url for url in page.asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.mark.parametrize("width", [375, 1440])
def test_no_line_of_code_is_cut(width, page):
    page.set_viewport_size({"width": width, "height": 900})
    for name in ("reference/scenario", "guides/plan", "reference/functions/plan", "index"):
        page.goto((SITE / f"{name}.html").as_uri())
        is_cut = "[...document.querySelectorAll('pre > code')].some(e => e.scrollWidth > e.clientWidth + 1)"
        assert not page.evaluate(is_cut), name
        assert not page.evaluate("document.documentElement.scrollWidth > innerWidth + 1"), name


def test_the_site_names_its_version_and_no_path_of_a_machine():
    assert f"jaxurban {ju.__version__}" in (SITE / "index.html").read_text(encoding="utf-8")
    for file in (SITE / "notebooks").glob("*.html"):
        assert "ipykernel_" not in file.read_text(encoding="utf-8"), file.name


def test_every_public_name_has_a_page_with_an_example_and_leads_there_from_its_former_address():
    index = (SITE / "reference/api.html").read_text(encoding="utf-8")
    pages = dict(re.findall(r'href="(\w+/[\w.]+)\.html" id="jaxurban\.([\w.]+)"', index))
    assert len(pages) == len(NAMES)
    for page, name in pages.items():
        text = (SITE / f"reference/{page}.html").read_text(encoding="utf-8")
        assert f'id="jaxurban.{name}"' in text
        assert "Examples:" in text


def test_every_notebook_can_be_downloaded_as_it_ran():
    for source in NOTEBOOKS:
        page = (SITE / f"notebooks/{source.stem}.html").read_text(encoding="utf-8")
        assert f'href="{source.stem}.ipynb"' in page
        assert json.loads((SITE / f"notebooks/{source.stem}.ipynb").read_text())["cells"]
