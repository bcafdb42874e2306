"""The look of every figure: headings, charts, legends, how values become colours, and the bar that says so."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedLocator, FuncFormatter, Locator, LogLocator, MaxNLocator, NullFormatter

SMALL_PT, TEXT_PT = 8.0, 9.0  # of tick labels, of titles and notes
INK, FAINT_INK = "#1a1a1a", "#555555"
HEAD_IN, LINE_IN, LETTERS_PER_IN = 0.4, 0.15, 15.0  # of a heading; of a line of SMALL_PT
# Of several series: told apart by the colour-blind too (Okabe and Ito 2008).
SERIES_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#e69f00", "#cc79a7", "#56b4e9", "#f0e442")
MARKERS = "osD^vP*X"
DOT: dict[str, Any] = {"markersize": 4.5, "capsize": 2, "elinewidth": 0.9, "linestyle": "none"}
LETTER_IN, LABEL_IN = 0.065, 0.17  # width and height that a letter of a tick label takes

styled = rc_context(  # a decorator of functions that draw; ticks are made later, so `dress` sets theirs
    {
        "font.size": SMALL_PT,
        "axes.titlesize": TEXT_PT,
        "axes.titlelocation": "left",
        "axes.titlecolor": INK,
        "axes.labelsize": SMALL_PT,
        "axes.edgecolor": FAINT_INK,
        "axes.linewidth": 0.6,
        "axes.axisbelow": True,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "legend.fontsize": SMALL_PT,
        "legend.frameon": False,
        "figure.facecolor": "white",
    }
)
TICKS_PER_DECADE: tuple[tuple[float, ...], ...] = ((1.0,), (1.0, 2.0, 5.0), tuple(range(1, 10)))
LEGEND_COLUMNS = 6
FEW_TICKS = 3  # that a logarithmic axis has at least
EDGE_IN, GAP_IN, TITLE_IN = 0.2, 0.6, 0.8


def chart(width_in: float, height_in: float, heading: str, note: str = "") -> Figure:
    """Return an empty figure with a heading above and a note beneath so many inches, all laid out by matplotlib."""
    lines = [textwrap.fill(line, int(width_in * LETTERS_PER_IN)) for line in note.splitlines()]
    size_in = width_in, height_in + HEAD_IN + LINE_IN * sum(line.count("\n") + 1 for line in lines)
    figure = Figure(figsize=size_in, layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.09), facecolor="white")
    look = {"x": EDGE_IN / width_in, "ha": "left"}
    figure.suptitle(heading, size=12, weight="bold", color=INK, **look)
    if lines:
        figure.supxlabel("\n".join(lines), size=SMALL_PT, color=FAINT_INK, **look)
    return figure


def panels(
    num: int, heading: str, *, panel_in: tuple[float, float] = (2.9, 2.0), most_in_row: int = 3, shares_y: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels of equal size.

    Args:
      num: of panels.
      heading: see `chart`.
      panel_in: width and height of a panel, about.
      most_in_row: panels side by side; four are two above two where that is 3.
      shares_y: whether the panels have one scale, labelled at the left of each row.
    """
    num_cols = min(most_in_row, num) if (num, most_in_row) != (4, 3) else 2
    num_rows = math.ceil(num / num_cols)
    width_in, height_in = num_cols * (panel_in[0] + GAP_IN), num_rows * (panel_in[1] + TITLE_IN)
    figure = chart(max(width_in, 6.4), height_in, heading)
    axes = figure.subplots(num_rows, num_cols, sharey=shares_y, squeeze=False).ravel().tolist()
    for panel in axes[num:]:
        panel.remove()
    for panel in axes[:num]:
        dress(panel)
    return figure, axes[:num]


def dress(panel: Axes) -> None:
    """Give a panel its ticks and its lines across."""
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)
    panel.grid(axis="y", linewidth=0.4, alpha=0.5)


def legend_below(figure: Figure, panel: Axes) -> None:
    """Write the legend of a panel at the foot of its figure."""
    handles, names = panel.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=min(LEGEND_COLUMNS, len(names)))


def dots(panel: Axes, x: np.ndarray, rows: pd.DataFrame, name: str, look: Mapping[str, Any]) -> None:
    """Draw a statistic of a table's rows with its intervals at ``x``; hollow where there is none."""
    values, low, high = (rows[f"{name}{end}"].to_numpy(np.float64) for end in ("", "_low", "_high"))
    is_known, label = np.isfinite(low), look.get("label")
    for which, face in ((is_known, look["color"]), (~is_known & np.isfinite(values), "white")):
        if which.any():
            ends = np.nan_to_num(np.stack([values - low, high - values])[:, which]).clip(min=0)
            look_here = {**DOT, **look, "label": label, "markerfacecolor": face}
            panel.errorbar(x[which], values[which], yerr=ends, **look_here)
            label = None


def show_plain(axis: Axis) -> None:
    """Label an axis with plain numbers."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}" if value >= 1000 else f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def show_plain_log(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers: powers of ten, and where these are few finer ones."""
    low, high = axis.get_view_interval()
    for subs in TICKS_PER_DECADE:
        locator: Locator = LogLocator(subs=subs)
        if sum(low <= tick <= high for tick in locator.tick_values(low, high)) >= FEW_TICKS:
            break
    else:
        locator = MaxNLocator(FEW_TICKS)
    axis.set_major_locator(locator)
    show_plain(axis)


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
        return apart_in - (LETTER_IN * (letters + 1) if is_lying else LABEL_IN)

    shown = [low, high]
    for value in inner:
        if low < value < high and all(room_in(value, other) >= 0 for other in shown):
            shown.append(value)
    return sorted(shown)


def add_colour_bar(
    figure: Figure, axes: Sequence[Axes], colours: Colours, length_in: float, location: str = "right"
) -> None:
    """Add a colour bar of about a length beside (``right``) or below (``bottom``) panels."""
    is_lying = location == "bottom"
    bar = figure.colorbar(
        ScalarMappable(cmap=colours.cmap, norm=colours.norm),
        ax=axes,
        location=location,
        extend=colours.extend,
        aspect=length_in / (0.09 if is_lying else 0.16),
        panchor="NW" if is_lying else False,
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
