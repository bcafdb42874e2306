"""Charts: figures with a heading, panels of one look laid out in inches, legends, and plain logarithmic axes."""

import math
from collections.abc import Sequence

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
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
LEGEND_COLUMNS, ROW_IN = 6, 0.17
FEW_TICKS = 3  # that a logarithmic axis has at least
LEFT_IN, EDGE_IN, TITLE_IN, FOOT_IN = 0.75, 0.2, 0.33, 0.55


def chart(width_in: float, height_in: float, heading: str, note: str) -> Figure:
    """Return an empty figure with a heading, the lines of a note below it, broken where they are too long."""
    figure = Figure(figsize=(width_in, height_in))
    write_head(figure, heading, note, EDGE_IN)
    return figure


def head_in(width_in: float, note: str) -> float:
    """Return the height that the heading and the note of a chart take at its top, and the title of a panel."""
    return head_room_in(note, width_in - EDGE_IN) + TITLE_IN


def panels(
    num: int,
    heading: str,
    note: str,
    *,
    panel_in: tuple[float, float] = (2.9, 2.0),
    gap_in: tuple[float, float] = (0.75, 0.8),
    foot_in: float = 0.0,
    most_in_row: int = 3,
    shares_y: bool = False,
    right_in: float = 0.0,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels of equal size.

    Args:
      num: of panels.
      heading, note: see `chart`.
      panel_in: width and height of a panel.
      gap_in: between two panels, for their labels.
      foot_in: room for a legend at the foot.
      most_in_row: panels side by side; four are two above two where that is 3.
      shares_y: whether the panels have one scale, labelled at the left of each row.
      right_in: room for a colour bar at the right.
    """
    num_cols = min(most_in_row, num) if (num, most_in_row) != (4, 3) else 2
    num_rows = math.ceil(num / num_cols)
    width = max(LEFT_IN + num_cols * (panel_in[0] + gap_in[0]) - gap_in[0] + 0.15, 6.4) + right_in
    top_in = head_in(width, note)
    height = top_in + num_rows * (panel_in[1] + gap_in[1]) - gap_in[1] + FOOT_IN + foot_in
    figure = chart(width, height, heading, note)
    axes: list[Axes] = []
    for number in range(num):
        row, col = divmod(number, num_cols)
        x, y = LEFT_IN + col * (panel_in[0] + gap_in[0]), height - top_in - row * (panel_in[1] + gap_in[1])
        box = (x / width, (y - panel_in[1]) / height, panel_in[0] / width, panel_in[1] / height)
        panel = figure.add_axes(box, sharey=axes[0] if axes and shares_y else None)
        dress(panel)
        panel.tick_params(labelleft=not shares_y or col == 0)
        axes.append(panel)
    return figure, axes


def label_rows(axes: Sequence[Axes], label: str) -> None:
    """Name what panels show upward that share that scale: at the first of each row."""
    for panel in axes:
        if panel.yaxis.get_tick_params()["labelleft"]:
            panel.set_ylabel(label)


def dress(panel: Axes, has_grid: bool = True) -> None:
    """Give a panel its ticks and its lines."""
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)
    if has_grid:
        panel.grid(axis="y", linewidth=0.4, alpha=0.5)


def legend_below(figure: Figure, panel: Axes, columns: int = LEGEND_COLUMNS) -> None:
    """Write the legend of a panel at the foot of its figure."""
    handles, names = panel.get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncols=min(columns, len(names)))


def legend_in(num: int) -> float:
    """Return the room that `legend_below` needs at the foot of a figure for so many entries, inches."""
    return 0.1 + ROW_IN * math.ceil(num / LEGEND_COLUMNS)


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
