"""Pieces of the page that Python writes: lists to choose from, legends, tables and the profile."""

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np
import pandas as pd

from jaxurban.metrics.variables import BUILT_COLOUR
from jaxurban.paths.export.base import Format
from jaxurban.paths.profile import CLEARANCE, GUESSED
from jaxurban.report.figures.profile import ALTITUDE_COLOUR, NO_FIX_COLOUR

WIDE, HIGH, TOP, MIDDLE, BOTTOM = (
    1000,
    150,
    7,
    62,
    134,
)  # of the profile: its size, the two panels' borders
METRICS_HIGH, LETTERS = 52, 14  # of the profile: pixels of its lower panel and of a line of text
GUESSED_COLOUR = "#b9a473"
MOST_STEPS = 1000  # of a line of the profile


def number(value: float | None) -> str:
    """Return a number as people read it: three digits, whole from 1000 on; a dash for none."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def options(items: Sequence[str], chosen: int = 0) -> str:
    """Return the options of a list, numbered from 0; one of them is chosen, -1 the last."""
    return "".join(
        f'<option value="{k}"{" selected" * (k == chosen % len(items))}>{escape(item)}</option>'
        for k, item in enumerate(items)
    )


def save_buttons(formats: Mapping[str, Format], *, of_waypoints: bool) -> str:
    """Return a button for each format of paths by its suffix, of those of waypoints or of the others."""
    return " ".join(
        f'<button data-format="{suffix}">{escape(each.label)}</button>'
        for suffix, each in formats.items()
        if each.is_of_waypoints == of_waypoints
    )


def layer_options(layers: Iterable[tuple[str, str, str]], first: str) -> str:
    """Return the options of a list of layers, each given by name, heading and group; one of them is chosen."""
    groups: dict[str, str] = {}
    for name, heading, group in layers:
        chosen = " selected" if name == first else ""
        option = f'<option value="{escape(name)}"{chosen}>{escape(heading)}</option>'
        groups[group] = groups.get(group, "") + option
    return "".join(
        f'<optgroup label="{escape(group)}">{inside}</optgroup>' for group, inside in groups.items()
    )


def dot(colour: str) -> str:
    """Return a round mark of a colour."""
    return f'<i class="jv-dot" style="background:{colour}"></i>'


def sliders(labels: Mapping[str, str], colours: Mapping[str, str]) -> str:
    """Return a slider for each weight, over powers of ten."""
    return "".join(
        f"<label><span>{dot(colours[name])}{escape(label)}</span><output></output>"
        f'<input type="range" name="weight-{escape(name)}" min="-3" max="2" step="0.05"></label>'
        for name, label in labels.items()
    )


def planners(summaries: Mapping[str, str], colours: Mapping[str, str], chosen: str) -> str:
    """Return a box to tick for each planner."""
    return "".join(
        f'<label title="{escape(summary)}"><input type="checkbox" value="{name}"'
        f"{' checked' if name == chosen else ''}>{dot(colours[name])}{name}</label>"
        for name, summary in summaries.items()
    )


def rows(cells: Iterable[tuple[str, str]]) -> str:
    """Return rows of a table: label and text."""
    return "".join(
        f"<tr><td>{escape(label)}</td><td>{escape(text)}</td></tr>" for label, text in cells
    )


def costs(parts: Mapping[str, float], labels: Mapping[str, str], colours: Mapping[str, str]) -> str:
    """Return rows of what each weight adds to the cost of a route."""
    return "".join(
        f"<tr><td>{dot(colours[name])}{escape(labels[name])}</td><td>{number(value)}</td></tr>"
        for name, value in parts.items()
    )


def route_button(planner: str, colour: str, text: str, notes: Iterable[str] = ()) -> str:
    """Return the button that chooses a route: what it costs, and below what else must be known of it."""
    below = "".join(f"<small>{escape(note)}</small>" for note in notes)
    return f'<button class="jv-route">{dot(colour)}{escape(planner)}<b>{escape(text)}</b>{below}</button>'


def sentences(texts: Iterable[tuple[str, str]]) -> str:
    """Return paragraphs, each given by its level and its text."""
    return "".join(f'<p class="jv-{escape(level)}">{escape(text)}</p>' for level, text in texts)


def legend(
    label: str,
    colours: np.ndarray,
    ticks: Iterable[tuple[float, str]],
    patches: Iterable[Sequence[str]],
) -> str:
    """Return a legend.

    Args:
      label: above the bar.
      colours: ``[N, 3]`` bytes, from left to right; none for classes alone.
      ticks: place along the bar, 0 to 1, and text.
      patches: name and colour of flat colours.
    """
    bar = ",".join(f"rgb({r},{g},{b})" for r, g, b in colours.tolist())
    ticks = list(ticks)
    shifts = ["0", *["-50%"] * (len(ticks) - 2), "-100%"]  # the ends' texts stay within the bar
    marks = "".join(
        f'<span style="left:{100 * at:.2f}%;transform:translateX({shift})">{escape(text)}</span>'
        for shift, (at, text) in zip(shifts, ticks, strict=False)
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
      table: of `RouteReport.profile`.
      lines: of each metric its label and its colour.
      no_fix: begin and end of segments without a fix, metres.
    """
    total_m = float(table["to_m"].iloc[-1]) or 1.0
    flight_m, roof_m = float(table["z_m"].max()), float(table["roof_m"].max())
    per_m = (MIDDLE - TOP) / max(flight_m, roof_m, 1.0)

    num_steps = min(len(table), MOST_STEPS)
    steps = np.unique(np.linspace(0, len(table) - 1, num_steps).astype(int))
    steps_m = table[["from_m", "to_m"]].to_numpy()[steps].ravel()

    def trace(values: np.ndarray, low: float, per_one: float) -> str:
        """Return the path of a line over the crossings, thinned to `MOST_STEPS`."""
        x = WIDE * steps_m / total_m
        y = np.repeat(low - per_one * values[steps], 2)
        points = np.stack([x, y], axis=-1).tolist()
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)

    roofs_m = table["roof_m"].fillna(0.0).to_numpy()
    roofs = {"roofs beneath": (BUILT_COLOUR, roofs_m)}
    if GUESSED in table:
        roofs["of guessed height"] = GUESSED_COLOUR, roofs_m * table[GUESSED].to_numpy()
    beneath = "".join(
        f'<path d="{trace(values_m, MIDDLE, per_m)}L{WIDE} {MIDDLE}L0 {MIDDLE}Z" fill="{colour}" stroke="none"/>'
        for colour, values_m in roofs.values()
    )
    shaded = "".join(
        f'<rect x="{WIDE * begin / total_m:.1f}" y="{TOP}" height="{BOTTOM - TOP}" fill="{NO_FIX_COLOUR}" '
        f'width="{max(WIDE * (end - begin) / total_m, 1):.1f}"/>'
        for begin, end in no_fix
    )
    metrics = "".join(
        f'<path d="{trace(table[name].to_numpy(), BOTTOM, METRICS_HIGH)}" stroke="{colour}"/>'
        for name, (_, colour) in lines.items()
    )
    heights = {MIDDLE - per_m * flight_m: f"{flight_m:g} m", MIDDLE: "0 m"}
    roof_y = MIDDLE - per_m * roof_m
    if roof_m > 0 and min(abs(roof_y - y) for y in heights) > LETTERS:
        heights[roof_y] = f"{number(roof_m)} m"
    heights |= {BOTTOM - METRICS_HIGH: "m 1", BOTTOM: "0"}
    words = "".join(
        f'<b style="top:{y - LETTERS / 2:.0f}px">{text}</b>' for y, text in heights.items()
    )
    places = [(at_m / total_m, BOTTOM + 2, text) for at_m, text in _distances(total_m)]
    nearest = int(np.argmin(table[CLEARANCE]))
    least_m = float(table[CLEARANCE].iloc[nearest])
    if np.isfinite(least_m):
        share = float(table[["from_m", "to_m"]].iloc[nearest].mean()) / total_m
        places.append((share, MIDDLE + 1, f"least clearance {number(least_m)} m"))
        metrics += f'<path d="M{WIDE * share:.1f} {TOP}V{MIDDLE + 3}" stroke="#1f2429" stroke-dasharray="2 2"/>'
    words += "".join(  # their own share of a text lies left of its place, so that none leaves the drawing
        f'<span style="top:{y}px;left:{share:.2%};transform:translateX({-share:.0%})">{text}</span>'
        for share, y, text in places
    )
    keys = {name: colour for name, (colour, _) in roofs.items()}
    keys |= {"flight": ALTITUDE_COLOUR, **dict(lines.values())}
    if shaded:
        keys["no fix"] = NO_FIX_COLOUR
    flight_line = trace(table["z_m"].to_numpy(), MIDDLE, per_m)
    flight = f'<path d="{flight_line}" stroke="{ALTITUDE_COLOUR}"/>'
    key = "".join(f"<span>{dot(colour)}{escape(label)}</span>" for label, colour in keys.items())
    return (
        f'<div><svg viewBox="0 0 {WIDE} {HIGH}" preserveAspectRatio="none" fill="none" stroke-width="1.4">'
        f'{shaded}{beneath}{flight}{metrics}<path class="jv-here" d="M0 {TOP}V{BOTTOM}" stroke="#000" '
        f'transform="translate(-9)"/></svg>{words}</div><p>{key}</p>'
    )


def _distances(total_m: float) -> list[tuple[float, str]]:
    """Return round distances along a route, seven at most, and how they are written."""
    power = 10.0 ** math.floor(math.log10(total_m / 6))
    step_m = next(factor * power for factor in (1, 2, 5, 10) if factor * power * 6 >= total_m)
    unit, unit_m = ("km", 1000) if total_m >= 1000 else ("m", 1)
    distances_m = [k * step_m for k in range(int(total_m / step_m) + 1)]
    return [(at_m, f"{at_m / unit_m:g} {unit}") for at_m in distances_m]
