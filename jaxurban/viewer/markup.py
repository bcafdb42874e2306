"""Pieces of the page that Python writes: lists to choose from, legends, tables and the profile."""

from collections.abc import Container, Iterable, Mapping, Sequence
from html import escape

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from jaxurban.draw.profile import ALTITUDE_COLOUR, NO_FIX_COLOUR, beneath
from jaxurban.flights.export.write import FORMATS
from jaxurban.metrics.variables import GROUP_COLOURS
from jaxurban.paths.route_report import CLEARANCE, GUESSED, short

# Of the profile, in pixels: its size, the borders of its two panels from above, the height of the lower panel's axis,
# and that of a line of text.
WIDE, HIGH = 1000, 150
TOP, MIDDLE, BOTTOM = 7, 62, 134
METRICS_HIGH, LETTERS = 52, 14
GUESSED_HATCH = "repeating-linear-gradient(135deg,#4a4a4a 0 2px,#fff 2px 4px)"
HATCHES = (
    '<pattern id="jv-guessed" width="6" height="6" patternUnits="userSpaceOnUse">'
    '<path d="M0 6L6 0" stroke="#fff"/></pattern>'
)
MOST_STEPS = 1000  # of a line of the profile


def number(value: float | None) -> str:
    """Return a number as people read it: three digits, whole from 1000 on; a dash for None, inf and NaN."""
    return "–" if value is None or not np.isfinite(value) else short(value)


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
        f"<tr><td>{dot(colours[name])}{escape(labels[name])}</td><td>{number(value)}</td></tr>"
        for name, value in parts.items()
    )


def route_button(planner: str, colour: str, text: str, notes: Iterable[str]) -> str:
    """Return the button that chooses a route: its planner and a text, and below these each note on a line."""
    below = "".join(f"<small>{escape(note)}</small>" for note in notes)
    return f'<button class="jv-route">{dot(colour)}{escape(planner)}<b>{escape(text)}</b>{below}</button>'


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


def profile(
    table: pd.DataFrame, lines: Mapping[str, tuple[str, str]], no_fix: Iterable[tuple[float, float]]
) -> str:
    """Return what a route meets as SVG: flight and roofs above, the metrics below, labels and a key.

    The drawing is stretched to the page's width, `WIDE` for the whole route; its height and its letters are not.

    Args:
      table: a row for each crossing of a cell, as `RouteReport.profile`.
      lines: label and colour of each metric, by name.
      no_fix: begin and end of each segment without a fix, metres along the route.
    """
    # Scales: `WIDE` for the whole route (a metre, if it has no length), the upper panel for what is highest.
    total_m = table["to_m"].iloc[-1] or 1.0
    flight_m = table["z_m"].max()
    roof_m = table["roof_m"].max()
    per_m = (MIDDLE - TOP) / max(flight_m, roof_m, 1.0)

    # Lines go through a begin and an end of each crossing, or of `MOST_STEPS` among them.
    num_steps = min(len(table), MOST_STEPS)
    steps = np.unique(np.linspace(0, len(table) - 1, num_steps).astype(int))
    steps_m = table[["from_m", "to_m"]].to_numpy()[steps].ravel()

    def trace(column: pd.Series, zero_y: float, per_one: float) -> str:
        """Return the path of a line of values by crossing, 0 at ``zero_y`` and 1 higher by ``per_one`` pixels."""
        x = WIDE * steps_m / total_m
        y = np.repeat(zero_y - per_one * column.to_numpy()[steps], 2)
        points = np.stack([x, y], axis=-1).tolist()
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)

    # Roofs by group, over them hatches where their heights are guessed.
    roofs = beneath(table)
    keys = {name: colour for name, (colour, _) in roofs.items()}
    if GUESSED in table:
        roofs["guessed"] = "url(#jv-guessed)", table["roof_m"].fillna(0.0) * table[GUESSED]
        keys["of guessed height"] = GUESSED_HATCH
    shapes = HATCHES + "".join(
        f'<path d="{trace(values_m, MIDDLE, per_m)}L{WIDE} {MIDDLE}L0 {MIDDLE}Z" fill="{colour}" stroke="none"/>'
        for colour, values_m in roofs.values()
    )

    # Segments without a fix, the metrics and the flight.
    shaded = "".join(
        f'<rect x="{WIDE * begin / total_m:.1f}" y="{TOP}" height="{BOTTOM - TOP}" fill="{NO_FIX_COLOUR}" '
        f'width="{max(WIDE * (end - begin) / total_m, 1):.1f}"/>'
        for begin, end in no_fix
    )
    metrics = "".join(
        f'<path d="{trace(table[name], BOTTOM, METRICS_HIGH)}" stroke="{colour}"/>'
        for name, (_, colour) in lines.items()
    )
    flight_line = trace(table["z_m"], MIDDLE, per_m)
    flight = f'<path d="{flight_line}" stroke="{ALTITUDE_COLOUR}"/>'

    # Texts along the route: round distances, and the least clearance, which has a line of its own too.
    places = [(at_m / total_m, BOTTOM + 2, text) for at_m, text in _distances(total_m)]
    nearest = table.iloc[np.argmin(table[CLEARANCE])]
    least_m = nearest[CLEARANCE]
    if np.isfinite(least_m):
        share = nearest[["from_m", "to_m"]].mean() / total_m
        places.append((share, MIDDLE + 1, f"least clearance {number(least_m)} m"))
        metrics += f'<path d="M{WIDE * share:.1f} {TOP}V{MIDDLE + 3}" stroke="#1f2429" stroke-dasharray="2 2"/>'
    # At a third of the way a third of a text lies left of its place, and so on, so that none leaves the drawing.
    words = _height_words(flight_m, roof_m, per_m) + "".join(
        f'<span style="top:{y}px;left:{share:.2%};transform:translateX({-share:.0%})">{text}</span>'
        for share, y, text in places
    )

    # The key.
    keys |= {"flight": ALTITUDE_COLOUR, **dict(lines.values())}
    if shaded:
        keys["no fix"] = NO_FIX_COLOUR
    key = "".join(f"<span>{dot(colour)}{escape(label)}</span>" for label, colour in keys.items())
    return (
        f'<div><svg viewBox="0 0 {WIDE} {HIGH}" preserveAspectRatio="none" fill="none" stroke-width="1.4">'
        f'{shaded}{shapes}{flight}{metrics}<path class="jv-here" d="M0 {TOP}V{BOTTOM}" stroke="#000" '
        f'transform="translate(-9)"/></svg>{words}</div><p>{key}</p>'
    )


def _height_words(flight_m: float, roof_m: float, per_m: float) -> str:
    """Return the texts on the axes of both panels.

    Args:
      flight_m, roof_m: the highest flight and the highest roof; the roof's text is left out where it has no room.
      per_m: pixels of the upper panel for a metre.
    """
    text_at = {MIDDLE - per_m * flight_m: f"{flight_m:g} m", MIDDLE: "0 m"}
    roof_y = MIDDLE - per_m * roof_m
    if roof_m > 0 and min(abs(roof_y - y) for y in text_at) > LETTERS:
        text_at[roof_y] = f"{number(roof_m)} m"
    text_at |= {BOTTOM - METRICS_HIGH: "1", BOTTOM: "0"}
    return "".join(
        f'<b style="top:{y - LETTERS / 2:.0f}px">{text}</b>' for y, text in text_at.items()
    )


def _distances(total_m: float) -> list[tuple[float, str]]:
    """Return round distances along a route of ``total_m`` above 0, seven at most, each in metres and as a text.

    The first text alone has the unit, so that they do not touch on a narrow page.
    """
    # The least of 1, 2, 5 and 10 times a power of ten that makes six steps or fewer.
    distances_m = MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(0, total_m)
    unit, unit_m = ("km", 1000) if total_m >= 1000 else ("m", 1)
    places = [(at_m, f"{at_m / unit_m:g}") for at_m in distances_m if at_m <= total_m]
    return [(0.0, f"0 {unit}"), *places[1:]]
