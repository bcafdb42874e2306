"""Pieces of the page that Python writes: lists to choose from, legends, tables, the profile and the triangle."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np
import pandas as pd

from jaxurban.report.figures.metrics import BUILT_COLOUR
from jaxurban.report.figures.profile import ALTITUDE_COLOUR, NO_FIX_COLOUR

WIDE, HIGH, LEFT, MIDDLE, FOOT = 900, 150, 36, 60, 16  # of the profile: its size, the axis, the two panels, the foot
MOST_STEPS = 900  # of a line of the profile: one a pixel
CORNERS = np.array([[0.0, 0.866], [1.0, 0.866], [0.5, 0.0]])  # of the triangle on the page


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


def layer_options(layers: Iterable[tuple[str, str, str]], first: str) -> str:
    """Return the options of a list of layers, each given by name, heading and group; one of them is chosen."""
    groups: dict[str, str] = {}
    for name, heading, group in layers:
        chosen = " selected" if name == first else ""
        option = f'<option value="{escape(name)}"{chosen}>{escape(heading)}</option>'
        groups[group] = groups.get(group, "") + option
    return "".join(f'<optgroup label="{escape(group)}">{inside}</optgroup>' for group, inside in groups.items())


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
    return "".join(f"<tr><td>{escape(label)}</td><td>{escape(text)}</td></tr>" for label, text in cells)


def costs(parts: Mapping[str, float], labels: Mapping[str, str], colours: Mapping[str, str]) -> str:
    """Return rows of what each weight adds to the cost of a route."""
    return "".join(
        f"<tr><td>{dot(colours[name])}{escape(labels[name])}</td><td>{number(value)}</td></tr>"
        for name, value in parts.items()
    )


def route_button(planner: str, colour: str, text: str) -> str:
    """Return the button that chooses a route."""
    return f'<button class="jv-route">{dot(colour)}{escape(planner)}<b>{escape(text)}</b></button>'


def legend(
    label: str, colours: np.ndarray, ticks: Iterable[tuple[float, str]], patches: Iterable[Sequence[str]]
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
    flat = "".join(f'<span><i style="background:{colour}"></i>{escape(name)}</span>' for name, colour in patches)
    return f'<figcaption>{escape(label)}</figcaption>{scale}<div class="jv-patches">{flat}</div>'


def profile(table: pd.DataFrame, lines: Mapping[str, tuple[str, str]], no_fix: Iterable[tuple[float, float]]) -> str:
    """Return what a route meets as SVG: flight and roofs above, the metrics below, and a key.

    Args:
      table: of `RouteReport.profile`.
      lines: of each metric its label and its colour.
      no_fix: begin and end of segments with under four satellites, metres.
    """
    total_m = float(table["to_m"].iloc[-1]) or 1.0
    top_m = 1.1 * max(float(table["z_m"].max()), float(table["roof_m"].max()), 1.0)
    bottom = HIGH - FOOT

    def trace(values: np.ndarray, low: float, high: float, most: float) -> str:
        """Return the path of a line over the crossings, thinned to one step a pixel."""
        at = np.unique(np.linspace(0, len(table) - 1, min(len(table), MOST_STEPS)).astype(int))
        x = LEFT + (WIDE - LEFT) * table[["from_m", "to_m"]].to_numpy()[at].ravel() / total_m
        y = np.repeat(low - (low - high) * values[at] / most, 2)
        return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))

    roofs = trace(table["roof_m"].fillna(0.0).to_numpy(), MIDDLE, 4, top_m)
    shaded = "".join(
        f'<rect x="{LEFT + (WIDE - LEFT) * begin / total_m:.1f}" y="4" height="{bottom - 4}" fill="{NO_FIX_COLOUR}" '
        f'width="{max((WIDE - LEFT) * (end - begin) / total_m, 1):.1f}"/>'
        for begin, end in no_fix
    )
    metrics = "".join(
        f'<path d="{trace(table[name].to_numpy(), bottom, MIDDLE + 8, 1.0)}" stroke="{colour}"/>'
        for name, (_, colour) in lines.items()
    )
    texts: list[tuple[float, float, str, str]] = [
        (LEFT - 4, 13, "end", f"{top_m:.0f} m"),
        (LEFT - 4, MIDDLE, "end", "0 m"),
    ]
    texts += [(LEFT - 4, MIDDLE + 16, "end", "m 1"), (LEFT - 4, bottom, "end", "0")]
    for k, anchor in enumerate(("start", "middle", "middle", "middle", "end")):
        texts.append((LEFT + (WIDE - LEFT) * k / 4, HIGH - 3, anchor, f"{total_m * k / 4000:.1f} km"))
    words = "".join(
        f'<text x="{x:.0f}" y="{y}" text-anchor="{anchor}" fill="#5c6670" font-size="11">{text}</text>'
        for x, y, anchor, text in texts
    )
    keys = {"roofs beneath": BUILT_COLOUR, "flight": ALTITUDE_COLOUR} | dict(lines.values())
    keys |= {"under 4 satellites": NO_FIX_COLOUR} if shaded else {}
    key = "".join(f"<span>{dot(colour)}{escape(label)}</span>" for label, colour in keys.items())
    return (
        f'<svg viewBox="0 0 {WIDE} {HIGH}" fill="none" stroke-width="1.4">{shaded}'
        f'<path d="{roofs}L{WIDE} {MIDDLE}L{LEFT} {MIDDLE}Z" fill="{BUILT_COLOUR}" stroke="none"/>'
        f'<path d="{trace(table["z_m"].to_numpy(), MIDDLE, 4, top_m)}" stroke="{ALTITUDE_COLOUR}"/>{metrics}{words}'
        f'<path class="jv-here" d="M0 4V{bottom}" stroke="#000" transform="translate(-9)"/></svg><p>{key}</p>'
    )


def triangle(names: Sequence[str], cells: Iterable[tuple[np.ndarray, str]], given: np.ndarray) -> str:
    """Return the triangle of three weights as SVG.

    Args:
      names: of the weights.
      cells: ``[V, 3]`` corners of each cell, as shares of the weights, and its colour.
      given: ``[3]`` shares of the weights that were given.
    """
    drawn = "".join(
        f'<polygon points="{" ".join(f"{x:.4f},{y:.4f}" for x, y in corners @ CORNERS)}" fill="{colour}" tabindex="0" '
        f'role="button" aria-label="route {k + 1}"/>'
        for k, (corners, colour) in enumerate(cells)
    )
    words = "".join(
        f'<text x="{x}" y="{y + drop}" text-anchor="middle">all on {escape(name)}</text>'
        for name, (x, y), drop in zip(names, CORNERS.tolist(), (0.07, 0.07, -0.02), strict=True)
    )
    x, y = given @ CORNERS
    look = 'fill="#fff" stroke="#000" stroke-width="0.008" pointer-events="none"'
    return f'{drawn}{words}<circle cx="{x:.4f}" cy="{y:.4f}" r="0.016" {look}/>'
