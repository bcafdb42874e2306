"""The look of every figure: headings, charts, legends, how values become colours, and the bar that says so."""

import math
import re
import string
import sys
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any, TypeVar, Unpack

import numpy as np
import pandas as pd
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import (
    FuncFormatter,
    Locator,
    LogLocator,
    MaxNLocator,
    NullFormatter,
)
from matplotlib.transforms import Bbox

from jaxurban.checks import nearest_name, typed
from jaxurban.draw.write import DPI, Look
from jaxurban.errors import InputError
from jaxurban.pictures import Form
from jaxurban.public import Hints

SMALL_PT, TEXT_PT, HEADING_PT = 7.0, 8.0, 10.0  # of tick labels and notes; of titles
# One column and two of a journal, by the IEEE Author Center's "Size Requirements for Graphics".
WIDTHS_MM = {"column": 88.9, "page": 182.0}
SMALL_IN = 5.5  # of a cell of a figure: notes and legends would crush its map
LEAST_MM, MOST_MM = 60.0, 1000.0  # the narrowest on which text can be read, and a poster
MM_PER_IN = 25.4
Width = str | float  # a name of `WIDTHS_MM`, or millimetres
Drawing = TypeVar("Drawing", bound=Callable)
INK, FAINT_INK = "#1a1a1a", "#555555"
HEAD_IN, LINE_IN, LETTERS_PER_IN = 0.2, 0.13, 18.0  # of a line of a heading, of SMALL_PT
# Of several series that are no metrics, whose colours these avoid; dark and light ones by turns.
SERIES_COLOURS = ("#1a1a1a", "#d55e00", "#56b4e9", "#7f7f7f", "#8c510a", "#66c2a5", "#f0c800")
MARKERS = "osD^vP*X"
DOT: Look = {"markersize": 4.5, "capsize": 2, "elinewidth": 0.9, "linestyle": "none"}
LABEL_IN, BESIDE_IN = 1.9, 0.6  # of a line of the label of an upright colour bar; left of panels
SYMBOL = re.compile(r"(\$[mH]_\\mathrm\{[^$]*\}\$)|\\?\$")  # of a metric, or a dollar
BOLD = 1.2  # how much wider bold letters are
SHOWN_SHARE = 0.99  # of the cells that changed lie within the colour bar of a difference

# A decorator of functions that draw. Ticks are made later than it works, so `dress` sets them.
styled = rc_context(
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
        "hatch.linewidth": 0.7,
    }
)
printed = rc_context(
    {
        "savefig.dpi": DPI,
        "pdf.fonttype": 42,  # TrueType: text that can be searched, in fonts that journals accept
        "svg.fonttype": "none",
        "svg.hashsalt": "jaxurban",  # else two files of one figure differ
    }
)
ENTRY_IN = 0.45  # of a legend's entry, beside its letters
WIDE, VERY_WIDE = 5.0, 1e3  # factors between the ends of an axis from which its ticks are others
SHOWN_DPI = 110  # of a picture in a notebook, which is as wide as a page
EDGE_IN, TITLE_IN = 0.1, 0.8
PAD_IN = 0.05  # left and right of what a figure or a cell holds
# Of a name beside its mark: steps to the right and up, how it is aligned there, and how far from the mark's middle.
STEPS, ACROSS, UPWARD = (1, -1, 0), ("center", "left", "right"), ("center", "bottom", "top")
AWAY_PT, BESIDE_PT = (5, 8, 12, 17, 23), 8  # farther away than BESIDE_PT it has a line
MARK_PT = 4  # half of a mark's side
POINTS = "offset points"
# Spaces at which no line is broken: before a number, its unit, "cells" after it, and the dot between two facts.
KEPT = re.compile(r"(?<=\S) (?=[%\d]|k?m\b|cells\b| ·)| (?=·)")
FIXED_SPACE = "\N{NO-BREAK SPACE}"
FEWEST_LETTERS = 8  # of a broken line, however narrow its place is


class Picture(Hints, Figure):
    """A figure whose files are fit for print: text stays text in PDF and SVG, images have 300 dots an inch."""

    def _repr_png_(self) -> bytes:
        """Return the picture that a notebook shows, where no backend of Matplotlib does."""
        file = BytesIO()
        self.savefig(file, format="png", dpi=SHOWN_DPI)
        return file.getvalue()

    def show(self, warn: bool = True) -> None:
        """Show the picture in a notebook; elsewhere there is no window for it.

        Raises:
          InputError: there is no notebook.
        """
        ipython = sys.modules.get("IPython")
        if ipython is None or ipython.get_ipython() is None:
            raise InputError(
                'a picture has no window: write it to a file, as with savefig("picture.png")'
            )
        ipython.display.display(self)

    @printed
    def savefig(self, fname: Any, **options: Any) -> None:
        """Write the figure, with the same bytes each time: PDF and SVG without their date.

        Args:
          fname: the file; its name's end is the format, unless ``format`` is among the options.
          **options: as of Matplotlib's method.
        """
        file_format = str(options.get("format") or Path(str(fname)).suffix[1:]).lower()
        undated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
        options.setdefault("metadata", undated.get(file_format))
        super().savefig(fname, **options)


def drawing(draw: Drawing) -> Drawing:
    """Return a public function that draws: in the look of our figures, and its arguments are checked (`typed`)."""
    return typed(styled(draw))


def inches(width: Width) -> float:
    """Return the width of a figure in inches.

    Args:
      width: ``"column"`` or ``"page"`` of a journal (88.9 or 182 mm), or millimetres.

    Raises:
      InputError: another name, fewer than 60 millimetres, on which no text can be read, or more than 1,000.
    """
    width_mm = WIDTHS_MM.get(width) if isinstance(width, str) else width
    if width_mm is None or not LEAST_MM <= width_mm <= MOST_MM:
        names = " or ".join(f"{name!r} ({each:g} mm)" for name, each in WIDTHS_MM.items())
        raise InputError(
            f"width must be {names}, or from {LEAST_MM:g} to {MOST_MM:g} millimetres, got {width!r}"
        )
    return width_mm / MM_PER_IN


def wrapped(text: str, width_in: float, size_pt: float = SMALL_PT) -> str:
    """Return a text whose lines are broken so that they fit into a width in inches, written in letters of a size.

    Its dollars are no mathematics of Matplotlib, but for symbols such as m_gps (`SYMBOL`).
    """
    text = SYMBOL.sub(lambda match: match[1] or r"\$", text)
    letters_per_in = LETTERS_PER_IN * SMALL_PT / size_pt
    num_letters = max(FEWEST_LETTERS, int((width_in - EDGE_IN) * letters_per_in))
    # As few lines as fit, about equally long, so that no word stands alone.
    lines = []
    for line in KEPT.sub(FIXED_SPACE, text).splitlines():
        num_lines = len(textwrap.wrap(line, num_letters))
        longest = max(map(len, line.split(" ")))
        widths = range(max(longest, 1), num_letters)
        enough = (width for width in widths if len(textwrap.wrap(line, width)) <= num_lines)
        lines.append(textwrap.fill(line, next(enough, num_letters)))
    # Where a line ends between two facts, their dot has nothing more to part.
    return "\n".join(lines).replace(FIXED_SPACE, " ").replace("  ·\n", "\n")


def chart(height_in: float, heading: str, note: str = "", **form: Unpack[Form]) -> Any:
    """Return an empty figure with a heading above and a note below, whose parts Matplotlib's layout places.

    Args:
      height_in: inches between heading and note; the figure is higher by both.
      heading: its first lines, bold, unless the form has a title; broken where they are too long.
      note: the lines below, broken likewise; without any text nothing is written there.
      form: where the figure stands; with axes a part of their figure is returned.

    Raises:
      InputError: an invalid width (see `inches`), or axes that are no cell of a grid.
    """
    width_in = width_in_of(form)
    title = form.get("title")
    if title is not None:
        heading = title
    head = wrapped(heading, width_in, BOLD * HEADING_PT)
    foot = wrapped(note, width_in)
    height_in += HEAD_IN * len(head.splitlines()) + LINE_IN * len(foot.splitlines())
    ax = form.get("ax")
    if ax is None:
        layout = ConstrainedLayoutEngine(w_pad=PAD_IN, h_pad=0.06)
        figure = Picture(figsize=(width_in, height_in), layout=layout, facecolor="white")
        edge_in = EDGE_IN
    else:
        figure = _in_place_of(ax)
        edge_in = PAD_IN
    look = {"x": edge_in / width_in, "ha": "left"}  # x is a share of the figure's width
    figure.suptitle(head, size=HEADING_PT, weight="bold", color=INK, **look)
    if foot:
        figure.supxlabel(foot, size=SMALL_PT, color=FAINT_INK, **look)
    return figure


def width_in_of(form: Form) -> float:
    """Return the width of a picture in inches: that of its form, or of the cell that it fills.

    Raises:
      InputError: an invalid width (see `inches`), or axes that are no cell of a grid.
    """
    ax = form.get("ax")
    if ax is None:
        return inches(form.get("width", "page"))
    if not isinstance(ax, Axes) or ax.get_subplotspec() is None:
        raise InputError(
            "ax must be one cell of a grid of axes, as matplotlib's subplots has them (axes[0] of several)"
        )
    if "width" in form:
        raise InputError("width: a cell that ax names has its own, so leave width out")
    return width_of(ax)


def _in_place_of(ax: Axes) -> Any:
    """Return a part of a figure, in place of a cell of it; the figure places its parts by a layout from now on."""
    whole: Any = ax.get_figure(root=True)
    if not isinstance(whole.get_layout_engine(), ConstrainedLayoutEngine):
        whole.set_layout_engine("constrained")
    cell: Any = ax.get_subplotspec()
    part = ax.figure.add_subfigure(cell)
    ax.remove()
    return part


def grow(figure: Any, by_in: float) -> None:
    """Make a figure higher by some inches; a part of another figure keeps its height."""
    if isinstance(figure, Figure):
        figure.set_figheight(figure.get_figheight() + by_in)


def bare(figure: Figure) -> Figure:
    """Return a figure without its title and its note, which a caption then says; it is altered, and lower by both.

    The note has the credit of the data, which must then stand elsewhere (`jaxurban.cite`).

    Args:
      figure: from any ``plot_*`` function.

    Returns:
      The figure.

    Examples:
      >>> figure = ju.plot.bare(maps.plot("gps", 60.0))
      >>> figure.get_suptitle()
      ''
    """
    lines_in = HEAD_IN * len(figure.get_suptitle().splitlines())
    lines_in += LINE_IN * len(figure.get_supxlabel().splitlines())
    figure.suptitle("")
    figure.supxlabel("")
    grow(figure, -lines_in)
    return figure


def width_of(part: Any) -> float:
    """Return the width of a figure, or of a part of one, in inches."""
    return float(part.bbox.width / part.get_figure(root=True).dpi)


def is_small(form: Form) -> bool:
    """Return whether a picture fills a cell of a figure that is too small for notes and legends (`SMALL_IN`)."""
    ax = form.get("ax")
    if ax is None:
        return False
    dpi = ax.get_figure(root=True).dpi
    return bool(min(ax.bbox.width, ax.bbox.height) < SMALL_IN * dpi)


def panel_columns(num: int) -> int:
    """Return how many of several panels stand side by side."""
    return 2 if num == 4 else min(num, 3)


def panels(
    num: int,
    heading: str,
    *,
    height_in: float = 2.0,
    shares_y: bool = False,
    **form: Unpack[Form],
) -> tuple[Figure, list[Axes]]:
    """Return a figure with several panels of equal size, and the axes of the panels in reading order.

    Args:
      num: number of panels, one at least.
      heading: see `chart`.
      height_in: height of a panel in inches, about: the layout decides.
      shares_y: whether the panels have one scale, labelled at the left of each row.
      form: see `chart`.
    """
    # The panels of full rows; those that are too many are removed.
    num_cols = panel_columns(num)
    num_rows = math.ceil(num / num_cols)
    figure = chart(num_rows * (height_in + TITLE_IN), heading, **form)
    axes = figure.subplots(num_rows, num_cols, sharey=shares_y, squeeze=False).ravel().tolist()
    for panel in axes[num:]:
        panel.remove()
    for panel in axes[:num]:
        dress(panel)
    return figure, axes[:num]


def letter(number: int, num: int) -> str:
    """Return what stands before the title of one of several panels: (a) , (b) ...; nothing for a panel alone."""
    return f"({string.ascii_lowercase[number]}) " if 1 < num <= len(string.ascii_lowercase) else ""


def letter_all(axes: Sequence[Axes], label: str = "") -> None:
    """Put letters before the titles of panels, break titles that are too long, and label the first panel of each row.

    Args:
      axes: the panels of a figure, in reading order; their titles are set.
      label: of the vertical axis; without one, the labels stay as they are.
    """
    for number, panel in enumerate(axes):
        grid: Any = panel.get_gridspec()
        room_in = width_of(grid.figure) / grid.ncols
        title = letter(number, len(axes)) + panel.get_title(loc="left")
        panel.set_title(wrapped(title, room_in, TEXT_PT))
        if label and number % grid.ncols == 0:
            panel.set_ylabel(label)


def dress(panel: Axes) -> None:
    """Give a panel its ticks and its lines across."""
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)
    panel.grid(axis="y", linewidth=0.4, alpha=0.5)


def legend_columns(names: Sequence[str], width_in: float) -> int:
    """Return in how many columns a legend of these names fits into a width."""
    letters = max((len(line) for name in names for line in name.splitlines()), default=0)
    return max(1, int((width_in - EDGE_IN) / (ENTRY_IN + letters / LETTERS_PER_IN)))


def legend_above(panel: Axes, lift: float = 0.0) -> None:
    """Write the legend of a panel above it, in as many columns as the figure's width has room for.

    Args:
      panel: whose labelled lines and areas the legend names.
      lift: how far above the panel the legend begins, as a share of the panel's height.
    """
    names = panel.get_legend_handles_labels()[1]
    figure: Any = panel.figure
    panel.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1 + lift),
        borderaxespad=0.3,
        columnspacing=1.2,
        ncols=legend_columns(names, width_of(figure)),
    )


def legend_below(figure: Figure, panel: Axes) -> None:
    """Write the legend of a panel at the foot of its figure, which has no note, in as many columns as fit."""
    handles, names = panel.get_legend_handles_labels()
    num_cols = min(len(names), legend_columns(names, width_of(figure)))
    figure.legend(handles, names, loc="outside lower center", ncols=num_cols)


def label_apart(panel: Axes, names: Iterable[str], marks: np.ndarray, **look: Any) -> None:
    """Write names beside marks so that none covers a mark or another name, nor leaves the panel.

    To be called last, as the layout of the figure is settled here. A line joins a name to its mark where it is far
    from it or another mark is as near; a name that has no such place is left out.

    Args:
      panel: to write in.
      names: of the first marks, the most important first.
      marks: ``[M, 2]`` where all marks are, in the panel's coordinates.
      look: of the names, as Matplotlib's keywords.
    """
    figure: Any = panel.get_figure(root=True)
    figure.draw_without_rendering()
    dots_per_pt = figure.dpi / 72
    line = {"arrowstyle": "-", "linewidth": 0.5, "shrinkA": 0}
    middles = panel.transData.transform(marks)
    mark_boxes = [Bbox([place, place]).padded(MARK_PT * dots_per_pt) for place in middles]
    taken = mark_boxes.copy()
    for name, place in zip(names, marks, strict=False):
        text = panel.annotate(name, place, (0, 0), textcoords=POINTS, parse_math=False, **look)

        # The nearest free place: if there is one, such that no mark but its own is as near.
        for most, away_pt, right, up in product((1, len(marks)), AWAY_PT, STEPS, STEPS):
            text.set(ha=ACROSS[right], va=UPWARD[up])
            text.xyann = right * away_pt, up * away_pt
            box = text.get_window_extent().padded(dots_per_pt / 2)
            num_near = box.padded((away_pt - MARK_PT) * dots_per_pt).count_overlaps(mark_boxes)
            is_inside = panel.bbox.count_contains([box.min, box.max]) == 2
            if is_inside and num_near <= most and not box.count_overlaps(taken):
                taken.append(box)
                if num_near > 1 or away_pt > BESIDE_PT:
                    panel.annotate("", place, text.xyann, textcoords=POINTS, arrowprops=line)
                break
        else:
            text.remove()


def step_up(panel: Axes, values: np.ndarray, end: float, **look: Any) -> None:
    """Draw how the share of values that are at most x grows with x, as steps from x = 1 to x = ``end``.

    Args:
      panel: to draw in.
      values: ``[N]`` from 1 up; NaN counts as larger than every x.
      end: the largest x.
      look: of the line, as Matplotlib's keywords.
    """
    # After each value the share is higher by one value; the line goes on level to the end.
    reached = np.sort(values[values < end])
    share = np.arange(len(reached) + 1) / max(1, len(values))
    panel.step([1.0, *reached, end], [*share, share[-1]], where="post", **look)


def dots(panel: Axes, y: np.ndarray, rows: pd.DataFrame, name: str, **look: Any) -> None:
    """Draw a statistic of a table's rows as dots with their intervals as bars; dots without an interval are hollow.

    Args:
      panel: to draw in.
      y: ``[N]`` place of each row.
      rows: ``N`` rows with the columns NAME, NAME_low and NAME_high; NaN where a value or an interval is not known.
      name: of the statistic.
      look: of the dots, as Matplotlib's keywords: a ``color``, and maybe a ``label`` for the legend.
    """
    # How far each bar reaches to the left and right of its dot; NaN, which is drawn as 0, without an interval.
    columns = [name, f"{name}_low", f"{name}_high"]
    values, low, high = rows[columns].to_numpy(np.float64).T
    below = values - low
    bars = np.nan_to_num([below, high - values]).clip(min=0)
    has_bar = np.isfinite(below)

    # Dots with a bar, filled, and known values without one, hollow.
    label = look.get("label")
    for is_drawn, face in ((has_bar, look["color"]), (~has_bar & np.isfinite(values), "white")):
        if is_drawn.any():
            look["label"] = label
            panel.errorbar(
                values[is_drawn],
                y[is_drawn],
                xerr=bars[:, is_drawn],
                markerfacecolor=face,
                **DOT,
                **look,
            )
            label = None  # the legend names a series once


def name_rows(panel: Axes, names: Sequence[str]) -> None:
    """Give a panel a row for each name, the first one on top, and lines upright in place of those across."""
    panel.set_yticks(range(len(names)), names)
    panel.set_ylim(len(names) - 0.4, -0.6)
    panel.grid(visible=False)
    panel.grid(axis="x", linewidth=0.4, alpha=0.5)


def show_plain(axis: Axis) -> None:
    """Label an axis with plain numbers."""
    axis.set_major_formatter(tick_label)
    axis.set_minor_formatter(NullFormatter())


def show_plain_log(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers: 1, 2 and 5 of each decade, or round numbers where it is short.

    An axis of many decades (`VERY_WIDE`) has a label at some of them.
    """
    low, high = axis.get_view_interval()
    locator: Locator = LogLocator(subs=(1.0, 2.0, 5.0))
    if high > VERY_WIDE * low:
        locator = LogLocator(numticks=8)
    elif high < WIDE * low:
        locator = MaxNLocator(4)
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


def recoloured(colours: Colours, cmap: Any) -> Colours:
    """Return colours with another colour map, those of classes unchanged.

    Args:
      colours: of a map.
      cmap: a colour map of matplotlib, or its name.

    Raises:
      InputError: a name that matplotlib does not know.
    """
    if isinstance(colours.norm, BoundaryNorm):
        return colours
    if not isinstance(cmap, Colormap) and cmap not in colormaps:
        hint = nearest_name(str(cmap), colormaps)
        raise InputError(f"cmap must be a colour map of Matplotlib or its name, got {cmap!r}{hint}")
    return replace(colours, cmap=cmap)


def ends_of(values: np.ndarray) -> tuple[float, float]:
    """Return the least and the greatest value, 0 and 0 where none is known."""
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)


def tick_label(value: float, _: float = 0.0) -> str:
    """Return a number of an axis: whole from 100 on, with commas, else with three digits."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def bar_ticks(colours: Colours) -> list[float]:
    """Return where a colour bar has ticks, as values: its own, else at equal distances on the bar.

    Those at the ends are exact; those between are rounded, on a scale that is not linear to one digit.
    """
    if colours.ticks is not None:
        return list(colours.ticks)
    num_ticks = 4 if isinstance(colours.norm, LogNorm) else 5
    ticks = np.asarray(colours.norm.inverse(np.linspace(0, 1, num_ticks))).tolist()
    digits = (
        ".1e" if type(colours.norm) is Normalize else ".0e"
    )  # of round numbers between the ends
    ticks[1:-1] = [float(format(tick, digits)) for tick in ticks[1:-1]]
    return ticks


def add_colour_bar(
    figure: Figure,
    axes: Sequence[Axes],
    colours: Colours,
    location: str = "right",
    cax: Axes | None = None,
    share: float = 1.0,
) -> None:
    """Add a colour bar to a figure.

    Args:
      figure: that holds the panels.
      axes: the panels that the bar is of.
      colours: what it shows, and its label and ticks.
      location: ``"right"`` of the panels, upright, or at their ``"bottom"``.
      cax: axes that the bar fills, lying, in place of a location.
      share: of the panels' width, from its left, that a bar at the bottom fills.
    """
    # Where the bar stands: beside all panels, or in axes of its own.
    place: Look = {"ax": axes, "location": location, "panchor": False}
    place["aspect"] = 25 if location == "right" else 50  # length of the bar by its width
    if location == "bottom":
        place |= {"shrink": share, "anchor": (0, 1)}
    if cax is not None:
        place = {"cax": cax, "orientation": "horizontal"}
    bar = figure.colorbar(
        ScalarMappable(cmap=colours.cmap, norm=colours.norm),
        extend=colours.extend,
        ticks=bar_ticks(colours),
        format=FuncFormatter(tick_label),
        **place,
    )

    # The label, which has the width of all panels below them.
    has_page_width = cax is None and location == "bottom"
    label_in = width_of(figure) - BESIDE_IN if has_page_width else LABEL_IN
    bar.set_label(wrapped(colours.label, label_in))
    bar.ax.tick_params(labelsize=SMALL_PT, length=2.5)
    if cax is not None or location == "bottom":  # no long number stands beyond a lying bar
        bar.ax.get_xticklabels()[-1].set_horizontalalignment("right")
    bar.outline.set(linewidth=0.4)
    bar.ax.minorticks_off()


def difference_colours(changed: np.ndarray, label: str) -> Colours:
    """Return colours from blue over white at 0 to red, whose ends are equally far from 0.

    Args:
      changed: ``[N]`` sizes of the changes, from 0 up; the ends, of two digits, hold about the share
        `SHOWN_SHARE` of them, and are -1 and 1 where none is finite.
      label: of the colour bar.
    """
    finite = changed[np.isfinite(changed)]
    limit = max(1e-12, float(np.quantile(finite, SHOWN_SHARE))) if len(finite) else 1.0
    limit = float(f"{limit:.2g}")
    return Colours("RdBu_r", Normalize(-limit, limit), label, "both", (-limit, 0.0, limit))
