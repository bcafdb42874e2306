"""The site of the docs works where it is read from a folder (`make docs` builds it, and runs this)."""

import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

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


def test_search_works_from_a_folder_and_asks_no_server(page):
    page.goto((SITE / "guides/plan.html").as_uri())
    page.locator("input.md-search__input").fill("courtyard")
    result = page.locator(".md-search-result__link").first
    result.wait_for(timeout=20_000)
    assert re.search(r"/guides/plan\.html|/guides/trouble\.html", result.get_attribute("href"))
    assert [url for url in page.asked if not url.startswith(("file:", "data:", "blob:"))] == []


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
