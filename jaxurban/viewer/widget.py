"""The viewer in a notebook: the same page as a widget, whose requests are messages to the kernel."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MapsLike, as_maps
from jaxurban.metrics.weights import WeightsLike
from jaxurban.settings import Preset
from jaxurban.viewer.html import part
from jaxurban.viewer.viewer import JSON, Viewer

if TYPE_CHECKING:
    from anywidget import AnyWidget


@typed
def view(
    maps: MapsLike,
    *,
    weights: WeightsLike = None,
    preset: Preset = "",
    sources: str | Path | None = None,
) -> Any:
    """Return a widget to look at maps and plan on them. A notebook shows it where it is the last line of a cell.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder; routes are planned as their scenario's ``[planning]`` and
        ``[vehicle]`` say, if there is one.
      weights: where the sliders start; left out, those of the scenario, else `Weights()`.
      preset: ``"paper"``: where the page starts, as in `jaxurban.cost_map`.
      sources: folder where the relative paths of the maps' sources begin, from which outlines and skies are read; left
        out, beside the maps.

    Returns:
      An ``anywidget.AnyWidget`` that answers the page as long as the kernel runs.

    Raises:
      InputError: anywidget is not installed, or the maps cannot be opened.

    Examples:
      >>> widget = ju.view(maps, weights={"gps": 2.0})
      >>> type(widget).__name__
      'ViewerWidget'
    """
    opened = as_maps(maps)
    folder = "" if opened is maps else str(maps)
    viewer = Viewer(
        opened,
        name=getattr(opened.folder, "name", "the maps"),
        folder=folder,
        weights=weights,
        preset=preset,
        sources=sources,
    )
    return widget_of(viewer)


def widget_of(viewer: Viewer) -> "AnyWidget":
    """Return the widget of a viewer: the page, whose requests the viewer answers.

    Raises:
      InputError: anywidget is not installed.
    """
    try:
        from anywidget import AnyWidget
        from traitlets import Unicode
    except ModuleNotFoundError as error:
        raise InputError(
            "the viewer in a notebook needs anywidget: pip install 'jaxurban[notebook]'"
        ) from error

    class ViewerWidget(AnyWidget):
        """The page, and its requests answered."""

        _esm = part("script")
        _css = part("style")
        markup = Unicode(part("markup")).tag(sync=True)

    page = ViewerWidget()
    page.on_msg(lambda widget, message, _: widget.send(*reply_to(viewer, message)))
    return page


def reply_to(viewer: Viewer, message: Any) -> tuple[dict[str, Any], list[bytes]]:
    """Return the reply to a message of the page, and the buffers that go with it.

    Args:
      viewer: answers the request.
      message: ``id``, ``name`` of the request and its ``parameters``; any other value gets an error.

    Returns:
      The message's ``id`` and the answer as ``json``, or an ``error`` sentence, with no buffers; for an answer in bytes
      the ``id`` alone, with the bytes as the one buffer.
    """
    if not isinstance(message, dict):
        return {"error": "a request is an object"}, []
    reply: dict[str, Any] = {"id": message.get("id")}
    try:
        answer = viewer.answer(message.get("name"), message.get("parameters"))
    except InputError as error:
        return reply | {"error": str(error)}, []
    if answer.kind == JSON:
        return reply | {"json": json.loads(answer.body)}, []
    return reply, [answer.body]
