"""Pieces of the page that Python writes: lists to choose from, legends, tables and figures."""

from base64 import b64encode
from collections.abc import Container, Iterable, Mapping, Sequence
from html import escape
from io import BytesIO
from threading import Lock

import numpy as np
from matplotlib.figure import Figure

from jaxurban.draw.profile import plot_profile
from jaxurban.draw.style import bare
from jaxurban.flights.check_result import MissionCheck
from jaxurban.flights.export.write import FORMATS
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.variables import GROUP_COLOURS
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.route_report import RouteReport, short

PROFILE_MM = 85.0  # width of a profile, whose letters then are 10 px high on a phone
PANEL_IN = 1.2  # height of its panels
DRAWING = Lock()  # the look of figures is set for the whole process while one is drawn


def options(items: Sequence[str], chosen: int = 0) -> str:
    """Return the options of a list, whose values are their numbers from 0; "" without items.

    Number ``chosen`` is selected, -1 the last one.
    """
    html = ""
    for k, item in enumerate(items):
        selected = " selected" if k == chosen % len(items) else ""
        html += f'<option value="{k}"{selected}>{escape(item)}</option>'
    return html


def save_buttons(*, of_waypoints: bool) -> str:
    """Return a button for each format of paths (by suffix) that holds waypoints, or for each that does not."""
    return " ".join(
        f'<button data-format="{suffix}">{escape(path_format.label)}</button>'
        for suffix, path_format in FORMATS.items()
        if path_format.is_of_waypoints == of_waypoints
    )


def layer_options(layers: Iterable[tuple[str, str, str]], first: str) -> str:
    """Return the options of a list of layers by group, each given by name, heading and group.

    Groups come in the order of their first layers. The layer named ``first`` is chosen; none if that is "".
    """
    groups: dict[str, str] = {}
    for name, heading, group in layers:
        chosen = " selected" if name == first else ""
        option = f'<option value="{escape(name)}"{chosen}>{escape(heading)}</option>'
        groups[group] = groups.get(group, "") + option
    return "".join(
        f'<optgroup label="{escape(group)}">{inside}</optgroup>' for group, inside in groups.items()
    )


def dot(colour: str) -> str:
    """Return a round mark of a colour, which is one of CSS."""
    return f'<i class="jv-dot" style="background:{colour}"></i>'


def sliders(labels: Mapping[str, str], colours: Mapping[str, str]) -> str:
    """Return a slider for each weight, given by labels and colours by name; it moves the weight's power of ten."""
    return "".join(
        f"<label><span>{dot(colours[name])}{escape(label)}</span><output></output>"
        f'<input type="range" name="weight-{escape(name)}" min="-3" max="2" step="0.05"></label>'
        for name, label in labels.items()
    )


def planners(summaries: Mapping[str, str], colours: Mapping[str, str], chosen: str) -> str:
    """Return a box to tick for each planner, given by summaries and colours by name; ``chosen`` is ticked."""
    html = ""
    for name, summary in summaries.items():
        checked = " checked" if name == chosen else ""
        box = f'<input type="checkbox" value="{name}"{checked}>'
        html += f'<label title="{escape(summary)}">{box}{dot(colours[name])}{name}</label>'
    return html


def group_boxes(numbers: Container[int]) -> str:
    """Return a ticked box for each group of what stands, of `GROUP_COLOURS`, whose number is given."""
    return "".join(
        f'<label><input type="checkbox" name="group-{number}" checked>{dot(colour)}{name}</label>'
        for number, (name, colour) in enumerate(GROUP_COLOURS.items())
        if number in numbers
    )


def rows(cells: Iterable[tuple[str, str]]) -> str:
    """Return rows of a table, each given by its label and its text."""
    return "".join(
        f"<tr><td>{escape(label)}</td><td>{escape(text)}</td></tr>" for label, text in cells
    )


def cost_rows(
    parts: Mapping[str, float], labels: Mapping[str, str], colours: Mapping[str, str]
) -> str:
    """Return rows of a table: the part of a route's cost that each weight adds; parts, labels, colours are by name."""
    return "".join(
        f"<tr><td>{dot(colours[name])}{escape(labels[name])}</td><td>{short(value)}</td></tr>"
        for name, value in parts.items()
    )


def route_button(planner: str, colour: str, text: str, note: str) -> str:
    """Return the button that chooses a route: its planner and a text, and a note below these."""
    below = f"<small>{escape(note)}</small>"
    return f'<button class="jv-route">{dot(colour)}{escape(planner)}<b>{escape(text)}</b>{below}</button>'


def findings(result: MissionCheck) -> str:
    """Return a button for each finding of a mission: its number, kind and depth, and its sentence."""
    html = ""
    rows = result.findings[["kind", "by_m"]].itertuples(index=False)
    for number, ((kind, by_m), text) in enumerate(zip(rows, result.sentences, strict=True), 1):
        depth = "" if np.isnan(by_m) else f", by {by_m:.1f} m"
        html += f"<button><b>{number} {kind}{depth}: </b>{escape(text)}</button>"
    return html


def sentences(texts: Iterable[tuple[str, str]]) -> str:
    """Return paragraphs, each given by its level and its text."""
    return "".join(f'<p class="jv-{escape(level)}">{escape(text)}</p>' for level, text in texts)


def legend(
    label: str,
    colours: np.ndarray,
    ticks: Sequence[tuple[float, str]],
    patches: Iterable[Sequence[str]],
) -> str:
    """Return a legend: a label, below it a bar with ticks, and patches of flat colours.

    Args:
      label: what the colours show, and its unit.
      colours: ``[N, 3]`` bytes, of the bar from left to right.
      ticks: each a place along the bar, 0 to 1 ascending, and a text; without ticks there is no bar.
      patches: each a name and a colour of CSS.
    """
    bar = ",".join(f"rgb({r},{g},{b})" for r, g, b in colours.tolist())

    # Texts stand in the middle below their ticks, but the first and the last one within the bar. (Without ticks these
    # two shifts have no text.)
    shifts = ["0", *["-50%"] * (len(ticks) - 2), "-100%"]
    marks = "".join(
        f'<span style="left:{100 * place:.2f}%;transform:translateX({shift})">{escape(text)}</span>'
        for shift, (place, text) in zip(shifts, ticks, strict=False)
    )
    gradient = f'<div class="jv-bar" style="background:linear-gradient(90deg,{bar})"></div>'
    scale = f'{gradient}<div class="jv-ticks">{marks}</div>' if ticks else ""

    flat = "".join(
        f'<span><i style="background:{colour}"></i>{escape(name)}</span>'
        for name, colour in patches
    )
    return f'<figcaption>{escape(label)}</figcaption>{scale}<div class="jv-patches">{flat}</div>'


def picture(figure: Figure, text: str) -> str:
    """Return a figure as an image, of which ``text`` says what it shows."""
    file = BytesIO()
    figure.savefig(file, format="svg", transparent=True)
    data = b64encode(file.getvalue()).decode()
    return f'<img alt="{escape(text)}" src="data:image/svg+xml;base64,{data}">'


def profile(planned: PlannedPath, maps: MetricMaps, report: RouteReport) -> str:
    """Return the profile of a route (`plot_profile`) and, over its panels, a line at the place that is pointed at."""
    with DRAWING:
        figure = plot_profile(planned, maps, report, width=PROFILE_MM)
        text = " ".join(figure.get_suptitle().split())
        bare(figure).set_figheight(PANEL_IN * len(figure.axes))
        image = picture(figure, text)
    highest, *_, lowest = (panel.get_position() for panel in figure.axes)
    inset = f"{1 - highest.y1:.2%} {1 - highest.x1:.2%} {lowest.y0:.2%} {highest.x0:.2%}"
    along = f'<div class="jv-along" style="inset:{inset}"><i class="jv-here" hidden></i></div>'
    return f"<div>{image}{along}</div>"
