"""How values become colours, and the bar that says so: its ends are always told."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator

SMALL_PT = 8.0  # of tick labels
BAR_SHARE = 0.6  # of the figure's height, about, that a bar beside panels takes
LETTER_IN, LINE_IN = 0.065, 0.17  # width and height that a letter of a tick label takes

Box = tuple[float, float, float, float]  # left, bottom, width, height in figure fractions


@dataclass(frozen=True)
class Colours:
    """How values become colours, and what their colour bar says.

    Attributes:
      cmap: a colour map of matplotlib, or its name.
      norm: brings values to [0, 1].
      label: of the colour bar.
      extend: its open ends, as matplotlib calls them.
      ticks: of the colour bar between its ends; round ones if left out.
    """

    cmap: str | Colormap
    norm: Normalize
    label: str = ""
    extend: str = "neither"
    ticks: Sequence[float] | None = None

    def __call__(self, values: np.ndarray, **options: bool) -> np.ndarray:
        """Return the colours ``[..., 4]`` of values; ``options`` as for matplotlib's colour maps."""
        return colormaps.get_cmap(self.cmap)(self.norm(values), **options)


def ends_of(values: np.ndarray) -> tuple[float, float]:
    """Return the least and the greatest value, 0 and 0 where none is known."""
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)


def tick_label(value: float) -> str:
    """Return a number of a colour bar: whole from 100 on, with commas, else with three digits."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def bar_ticks(colours: Colours, length_in: float, is_lying: bool) -> list[float]:
    """Return both ends of a scale, and between them the ticks whose labels have room on a bar of a length."""
    low, high = float(colours.norm.vmin or 0.0), float(colours.norm.vmax or 0.0)
    if colours.ticks is not None:
        inner = list(colours.ticks)
    else:
        locator = LogLocator() if isinstance(colours.norm, LogNorm) else MaxNLocator(5)
        inner = [float(value) for value in locator.tick_values(low, high)]

    def room_in(one: float, other: float) -> float:
        """Return how far apart two ticks are, beyond what their labels take."""
        apart_in = abs(float(colours.norm(one)) - float(colours.norm(other))) * length_in
        letters = (len(tick_label(one)) + len(tick_label(other))) / 2
        return apart_in - (LETTER_IN * (letters + 1) if is_lying else LINE_IN)

    shown = [low, high]
    for value in inner:
        if low < value < high and all(room_in(value, other) >= 0 for other in shown):
            shown.append(value)
    return sorted(shown)


def add_colour_bar(figure: Figure, place: Box | list[Axes], colours: Colours) -> Colorbar:
    """Add a colour bar in a box (figure fractions), lying if it is wider than tall, or beside panels; return it."""
    is_lying, length_in = False, BAR_SHARE * figure.get_figheight()
    where: dict[str, Any] = {"ax": place}
    if isinstance(place, tuple):
        width_in, height_in = place[2] * figure.get_figwidth(), place[3] * figure.get_figheight()
        is_lying, length_in, where = width_in > height_in, max(width_in, height_in), {"cax": figure.add_axes(place)}
    bar = figure.colorbar(
        ScalarMappable(cmap=colours.cmap, norm=colours.norm),
        orientation="horizontal" if is_lying else "vertical",
        extend=colours.extend,
        **where,
    )
    width = max(24 if is_lying else 12, int(length_in * 15))  # letters on a line of the label
    lines = [part for line in colours.label.splitlines() for part in textwrap.wrap(line, width)]
    bar.set_label("\n".join(lines), size=SMALL_PT)
    bar.ax.tick_params(labelsize=SMALL_PT, length=2.5)
    bar.outline.set(linewidth=0.4)
    bar.ax.minorticks_off()
    axis = bar.ax.xaxis if is_lying else bar.ax.yaxis
    axis.set_major_locator(FixedLocator(bar_ticks(colours, length_in, is_lying)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: tick_label(value)))
    return bar
