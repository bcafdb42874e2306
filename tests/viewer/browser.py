"""The viewer served and its page opened, for tests: with every other host blocked."""

import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Any

import numpy as np

from jaxurban.viewer.server import ViewerServer
from jaxurban.viewer.viewer import Viewer

SIZE = {"width": 1280, "height": 720}
Again = Callable[[], Viewer] | None
READY = '.jv[data-ready="yes"]'


def unpacked(data: bytes) -> np.ndarray:
    """Return the values of a tile."""
    planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(4, -1)
    return np.ascontiguousarray(planes.T).view("<f4").ravel()


@contextmanager
def served(viewer: Viewer, again: Again = None) -> Iterator[ViewerServer]:
    """Serve a viewer from a thread of this process."""
    with ViewerServer(viewer, again=again) as server:
        Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        yield server
        server.shutdown()


@contextmanager
def opened(browser: Any, url: str, is_well: bool = True, **screen: Any) -> Iterator[Any]:
    """Open a page and yield it; in the end it has asked nobody else, and, if it is to be well, nothing went wrong.

    ``screen`` are options of a context of Playwright: its size, and whether it is touched.
    """
    asked, wrong = list[str](), list[str]()

    def let_through(route: Any) -> None:
        asked.append(route.request.url)
        is_here = route.request.url.startswith(("http://127.0.0.1:", "file:", "data:", "blob:"))
        route.continue_() if is_here else route.abort()

    context = browser.new_context(**{"viewport": SIZE, "accept_downloads": True} | screen)
    page = context.new_page()
    page.route("**/*", let_through)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on(
        "console", lambda message: wrong.append(message.text) if message.type == "error" else None
    )
    page.goto(url)
    page.wait_for_selector(READY, timeout=60_000)
    yield page
    assert asked
    assert all(address.startswith((url, "data:", "blob:")) for address in asked)
    assert not (is_well and wrong), wrong
    context.close()


@contextmanager
def shown(browser: Any, viewer: Viewer, again: Again = None, is_well: bool = True) -> Iterator[Any]:
    """Serve a viewer and open its page."""
    with served(viewer, again) as server, opened(browser, server.url, is_well) as page:
        yield page
