"""The page of the viewer: its markup, style and script, put together from the package's files.

It can hold its answers, for whoever has neither Python nor the maps.
"""

import base64
import hashlib
import json
import math
from collections.abc import Iterator
from functools import cache
from html import escape
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any

from jaxurban.errors import InputError
from jaxurban.io.files import write_whole
from jaxurban.viewer.requests import Request, View
from jaxurban.viewer.tiles import TILE, strides_of
from jaxurban.viewer.viewer import Viewer, as_json

SUFFIX = ".html"
PARTS = {
    "markup": ["viewer.html"],
    "style": ["viewer.css"],
    "script": ["doors.js", "drawing.js", "missions.js", "viewer.js"],
}


@cache
def part(name: str) -> str:
    """Return a part of the page, ``"markup"``, ``"style"`` or ``"script"``: its files' texts, one after another."""
    page = files("jaxurban.viewer") / "page"
    return "".join((page / file).read_text(encoding="utf-8") for file in PARTS[name])


def html_page(data: str = "", title: str = "jaxurban") -> str:
    """Return the page as the text of one HTML file.

    Args:
      data: all answers as JSON, for a page that has no server; "" for a page that asks its server.
      title: the title of the window, as plain text.
    """
    # No text within it ends the element that holds it.
    answers = data.replace("<", "\\u003c")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n<link rel="icon" href="data:,">\n'
        f"{_policy_tag(data)}<title>{escape(title, quote=False)}</title>\n<style>\n{part('style')}</style>\n</head>\n"
        f'<body style="margin: 0">\n<div class="jv">\n{part("markup")}</div>\n'
        f'<script type="application/json" id="jv-data">{answers}</script>\n'
        f'<script type="module">\n{part("script")}</script>\n</body>\n</html>\n'
    )


def policy_of(connect: str) -> str:
    """Return the policy of the page (Content-Security-Policy): what it may load.

    These are its own script, named by its digest, its style, and requests to ``connect``, such as "'self'" or "'none'".
    """
    digest = base64.b64encode(hashlib.sha256(f"\n{part('script')}".encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def _policy_tag(data: str) -> str:
    """Return the policy as an element of a page that is a file, which has no server to state it.

    It is "" for a page without answers ``data``, which has a server. Frames, the last rule, cannot be forbidden here.
    """
    if not data:
        return ""
    rules, _, _ = policy_of("'none'").rpartition("; frame-ancestors")
    return f'<meta http-equiv="Content-Security-Policy" content="{rules}">\n'


def write_page(viewer: Viewer, file: str | Path, most_bytes: int) -> int:
    """Write the page with all maps of the viewer to a file, and return how many bytes the file has.

    The page holds every n-th cell, the middle one of n x n, where n is the smallest power of two with which the file is
    small enough. It shows layers and their values under the pointer; routes cannot be planned without the maps.

    Args:
      viewer: the viewer of the maps.
      file: the path of the file, which ends in .html.
      most_bytes: how many bytes the file may have.

    Raises:
      InputError: the file has another suffix or cannot be written, or even the coarsest page is larger.
    """
    file = Path(file)
    if file.suffix.lower() != SUFFIX or file.is_dir() or not file.parent.is_dir():
        raise InputError(
            f"the page {str(file)!r} must be a file that ends in {SUFFIX}, in a folder that exists"
        )

    # The finest stride that fits.
    maps = list(_maps_of(viewer))
    for stride in strides_of(viewer.maps.grid.shape):
        page = _page(viewer, maps, stride, most_bytes)
        if page is not None:
            write_whole(file, page)
            return len(page)
    raise InputError(
        f"no page of these {len(maps)} maps has at most {most_bytes / 2**20:g} MiB: allow more (--size)"
    )


def _maps_of(viewer: Viewer) -> Iterator[View]:
    """Yield every map: each layer at each altitude, time and time of day that it varies with, number 0 of all else."""
    for name, layer in viewer.layers.items():
        indices = []
        for dim, values in viewer.axes.items():
            num_values = len(values) if dim in layer.dims else 1
            indices.append(range(max(num_values, 1)))
        for altitude, time, day in product(*indices):
            yield View(layer=name, at=(altitude, time, day))


def _page(viewer: Viewer, maps: list[View], stride: int, most_bytes: int) -> bytes | None:
    """Return the page with every map at one stride, as UTF-8; None where it has more than ``most_bytes``.

    Its answers are stored by the requests that the page would send to a server (`_key`); bytes are in base64.
    """
    # What the page asks for first; it plans no routes.
    scene = viewer.scene(Request()) | {"strides": [stride], "can_plan": False, "key": ""}
    outlines = base64.b64encode(viewer.answer("outlines", {}).body).decode()
    answers: dict[str, Any] = {
        _key("scene", {}): scene,
        _key("base", {}): viewer.base(Request()),
        _key("outlines", {}): outlines,
    }

    # Legend and tiles of each map; stop once they alone are too large.
    num_bytes = len(outlines)
    num_rows, num_cols = (math.ceil(size / stride / TILE) for size in viewer.maps.grid.shape)
    for view in maps:
        params = view.model_dump(mode="json", exclude_none=True)
        answers[_key("legend", params)] = viewer.legend(view)
        for row, col in product(range(num_rows), range(num_cols)):
            tile_params = params | {"stride": stride, "row": row, "col": col}
            tile = base64.b64encode(viewer.answer("tile", tile_params).body).decode()
            answers[_key("tile", tile_params)] = tile
            num_bytes += len(tile)
        if num_bytes > most_bytes:
            return None

    # With all else the page may still be too large.
    page = html_page(as_json(answers).decode(), viewer.name).encode()
    return page if len(page) <= most_bytes else None


def _key(name: str, params: dict[str, Any]) -> str:
    """Return the text by which the page looks an answer up: the request as its own script writes it, name and JSON."""
    return name + json.dumps(params, separators=(",", ":"), ensure_ascii=False)
