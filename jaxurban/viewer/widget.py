"""The viewer in a notebook: the same page as a widget, whose requests are messages to the kernel."""

import json
from typing import TYPE_CHECKING, Any

from jaxurban.errors import InputError, typed
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.metrics.weights import GivenWeights
from jaxurban.paths.preset import under_preset
from jaxurban.studies.map_comparison import shared_part
from jaxurban.viewer.html import part
from jaxurban.viewer.plans import PlanDefaults
from jaxurban.viewer.viewer import JSON, Viewer

if TYPE_CHECKING:
    from anywidget import AnyWidget


@typed
def view(maps: GivenMaps, *, weights: GivenWeights = None, other: GivenMaps | None = None, preset: str = "") -> Any:
    """Return a widget to look at maps and plan on them, which a notebook shows as the last line of a cell.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder; routes are planned as their scenario's ``[planning]`` and
        ``[vehicle]`` say, if there is one.
      weights: where the sliders start; left out, those of the scenario, else `Weights()`.
      other: further maps that hold every cell, altitude and time of these, to look at differences.
      preset: ``"paper"``: where the page starts, as in `jaxurban.cost_map`.

    Raises:
      InputError: anywidget is not installed, or the maps cannot be opened.
    """
    held = as_maps(maps)
    folder = None if held is maps else str(maps)
    return widget_of(viewer_of(held, None if other is None else as_maps(other), folder, weights, preset))


def viewer_of(
    maps: MetricMaps,
    other: MetricMaps | None,
    folder: str | None,
    weights: GivenWeights = None,
    preset: str = "",
    **shown: Any,
) -> Viewer:
    """Return the viewer of maps, which plans as their scenario says, and of the same part of further ones.

    Args:
      maps, other, weights, preset: as for `view`.
      folder: of the maps, for the commands that the page shows; None for maps in memory.
      shown: further arguments of `Viewer`.

    Raises:
      InputError: further maps that do not hold every cell, altitude and time of the first.
    """
    if other is not None:
        shared = shared_part(maps, other)
        if (shared.a.grid, shared.a.altitudes_m, shared.a.times) != (maps.grid, maps.altitudes_m, maps.times):
            raise InputError("the other maps must hold every cell, altitude and time of those that are planned on")
        other = shared.b
    command = () if folder is None else (folder, "--resolution", repr(maps.grid.resolution_m))
    defaults = PlanDefaults.of(maps, command, weights, preset)
    maps, *_ = under_preset(preset, maps, None, None)
    return Viewer(maps, other, defaults=defaults, **shown)


def widget_of(viewer: Viewer) -> "AnyWidget":
    """Return the widget of a viewer.

    Raises:
      InputError: anywidget is not installed.
    """
    try:
        from anywidget import AnyWidget
        from traitlets import Unicode
    except ModuleNotFoundError as error:
        raise InputError("the viewer in a notebook needs anywidget: pip install 'jaxurban[notebook]'") from error

    class ViewerWidget(AnyWidget):
        """The page, and its requests answered."""

        _esm = part("script")
        _css = part("style")
        markup = Unicode(part("markup")).tag(sync=True)

    made = ViewerWidget()
    made.on_msg(lambda widget, message, _: widget.send(*reply_to(viewer, message)))
    return made


def reply_to(viewer: Viewer, message: Any) -> tuple[dict[str, Any], list[bytes]]:
    """Return the reply to a message of the page, and its buffers: its ``id`` with ``json``, bytes or ``error``."""
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
