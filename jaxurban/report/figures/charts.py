"""Charts: figures with a heading, panels of one look, legends, and plain logarithmic axes."""

import math

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, Locator, LogLocator, MaxNLocator, NullFormatter

from jaxurban.report.figures.colours import SMALL_PT
from jaxurban.report.figures.frame import FAINT_INK, INK, TEXT_PT, head_room_in, write_head

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
        "legend.fontsize": SMALL_PT,
        "legend.frameon": False,
        "figure.facecolor": "white",
    }
)
TICKS_PER_DECADE: tuple[tuple[float, ...], ...] = ((1.0,), (1.0, 2.0, 5.0), tuple(range(1, 10)))
LEGEND_COLUMNS = 6
FEW_TICKS = 3  # that a logarithmic axis has at least
EDGE_IN, GAP_IN, TITLE_IN = 0.2, 0.6, 0.8


def chart(width_in: float, height_in: float, heading: str, note: str) -> Figure:
    """Return a figure with a heading and, below it, a note, and so many inches that matplotlib lays out."""
    head_in = head_room_in(note, width_in - EDGE_IN)
    below = (0, 0, 1, height_in / (height_in + head_in))
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06, rect=below)
    figure = Figure(figsize=(width_in, height_in + head_in), layout=layout)
    write_head(figure, heading, note, EDGE_IN)
    return figure


def panels(
    num: int,
    heading: str,
    note: str,
    *,
    panel_in: tuple[float, float] = (2.9, 2.0),
    most_in_row: int = 3,
    shares_y: bool = False,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels of equal size.

    Args:
      num: of panels.
      heading, note: see `chart`.
      panel_in: width and height of a panel, about.
      most_in_row: panels side by side; four are two above two where that is 3.
      shares_y: whether the panels have one scale, labelled at the left of each row.
    """
    num_cols = min(most_in_row, num) if (num, most_in_row) != (4, 3) else 2
    num_rows = math.ceil(num / num_cols)
    width_in, height_in = num_cols * (panel_in[0] + GAP_IN), num_rows * (panel_in[1] + TITLE_IN)
    figure = chart(max(width_in, 6.4), height_in, heading, note)
    axes = figure.subplots(num_rows, num_cols, sharey=shares_y, squeeze=False).ravel().tolist()
    for panel in axes[num:]:
        panel.remove()
    for panel in axes[:num]:
        dress(panel)
    return figure, axes[:num]


def dress(panel: Axes, has_grid: bool = True) -> None:
    """Give a panel its ticks and its lines."""
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)
    if has_grid:
        panel.grid(axis="y", linewidth=0.4, alpha=0.5)


def legend_below(figure: Figure, panel: Axes, columns: int = LEGEND_COLUMNS) -> None:
    """Write the legend of a panel at the foot of its figure."""
    handles, names = panel.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=min(columns, len(names)))


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
