"""Map panels in a projected frame: layout, scale bar, north arrow, colour bars and legends.

Every figure is laid out in inches: panels of equal size with the map's own proportions, and on the right
a key column with the legend, the colour bar, the north arrow and the scale bar, so that nothing covers the map.
"""

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter

from jaxurban.report.figures.colours import SMALL_PT, Box, Colours, add_colour_bar
from jaxurban.report.figures.notes import GAP
from jaxurban.world.grid import Grid

MAX_CELLS = 1500  # a side; larger maps are thinned before they are drawn
WIDTH_IN, MAX_HEIGHT_IN = 11.0, 9.0
HEAD_IN, LEFT_IN, BOTTOM_IN = 0.62, 0.72, 0.52
TITLE_IN, GAP_IN, KEY_IN = 0.27, 0.22, 1.55
SLOT_IN, MIN_WIDTH_IN = 1.95, 7.2  # room for a panel's title and footer; for the heading
TEXT_PT = 9.0
LETTERS_PER_IN, LINE_IN = 14.0, 0.15  # of TEXT_PT
OBSTACLE_COLOUR, NO_DATA_COLOUR = "#c4c4c4", "#efe4d6"
NO_DATA_PATCH = ("no data", NO_DATA_COLOUR)
INK, FAINT_INK = "#1a1a1a", "#555555"
HATCH, HATCH_COLOUR, HATCHED_GROUND = "////////", "#ffffff", "#7d7c78"
MAP = "map"  # gid of a panel over a grid
ENDS = (("start", "o", 6.5), ("goal", "*", 12.0))  # of a route: name, marker and its size
END_LOOK: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "black", "markerfacecolor": "white"}


@dataclass(frozen=True)
class MapLayer:
    """One map as it is drawn.

    Attributes:
      values: ``[Y, X]`` float, NaN where nothing is drawn; or class numbers.
      colours: how values become colours.
      is_classes: whether values are class numbers, which must not be averaged.
    """

    values: np.ndarray
    colours: Colours
    is_classes: bool = False


@dataclass(frozen=True)
class Frame:
    """A figure with one axes a panel and a key column.

    Attributes:
      figure: the whole.
      axes: the panels, in reading order.
      key: invisible axes over the key column, in inches from its lower left corner.
      grid: what the panels show.
      panel_in: width and height of a panel.
    """

    figure: Figure
    axes: tuple[Axes, ...]
    key: Axes
    grid: Grid
    panel_in: tuple[float, float]


def thin(values: np.ndarray, is_classes: bool = False, max_cells: int = MAX_CELLS) -> tuple[np.ndarray, int, int]:
    """Return a map of at most ``max_cells`` a side, and how many rows and columns one of its cells stands for.

    Numbers become the mean of the block's cells that are not NaN, NaN where most are NaN; classes become
    the class of the block's middle cell. Rows and columns beyond the last whole block are left out.
    """
    high, wide = (math.ceil(size / max_cells) for size in values.shape)
    if high == wide == 1:
        return values, 1, 1
    rows, cols = values.shape[0] // high, values.shape[1] // wide
    blocks = values[: rows * high, : cols * wide].reshape(rows, high, cols, wide)
    if is_classes:
        return blocks[:, high // 2, :, wide // 2], high, wide
    is_known = ~np.isnan(blocks)
    count = is_known.sum(axis=(1, 3))
    total = np.where(is_known, blocks, 0).sum(axis=(1, 3), dtype=np.float32)
    return np.where(2 * count >= high * wide, total / np.maximum(count, 1), np.float32(np.nan)), high, wide


def make_frame(
    grid: Grid,
    titles: Sequence[str],
    heading: str,
    note: str,
    footer_in: float = 0.0,
    with_ticks: bool = True,
) -> Frame:
    """Return an empty frame with a panel for each title.

    Args:
      grid: the map's grid; panels keep its proportions.
      titles: one a panel.
      heading: first line of the figure, bold.
      note: the lines below it, broken where they are too long.
      footer_in: room under each panel.
      with_ticks: whether eastings and northings are shown.
    """
    tall = (grid.y_max_m - grid.y_min_m) / (grid.x_max_m - grid.x_min_m)
    num_rows, num_cols, width, height = _best_layout(len(titles), tall, footer_in)
    slot = max(width, SLOT_IN, (MIN_WIDTH_IN - LEFT_IN - KEY_IN) / num_cols - GAP_IN)
    total_w = LEFT_IN + num_cols * (slot + GAP_IN) + KEY_IN
    head_in = head_room_in(note, total_w - LEFT_IN)
    row_in = TITLE_IN + height + footer_in
    bottom_in = BOTTOM_IN if with_ticks else 0.12
    total_h = head_in + num_rows * row_in + bottom_in
    figure = Figure(figsize=(total_w, total_h), facecolor="white")
    write_head(figure, heading, note, LEFT_IN)
    axes = []
    for number, title in enumerate(titles):
        row, col = divmod(number, num_cols)
        x_in = LEFT_IN + col * (slot + GAP_IN) + (slot - width) / 2
        y_in = total_h - head_in - row * row_in - TITLE_IN - height
        panel = figure.add_axes((x_in / total_w, y_in / total_h, width / total_w, height / total_h))
        _dress(panel, grid, title, width, height)
        is_left, is_bottom = col == 0 and with_ticks, number + num_cols >= len(titles) and with_ticks
        panel.tick_params(labelleft=is_left, labelbottom=is_bottom, left=with_ticks, bottom=with_ticks)
        panel.set_ylabel("northing (km)" if is_left else "", size=SMALL_PT)
        panel.set_xlabel("easting (km)" if is_bottom else "", size=SMALL_PT)
        axes.append(panel)
    key_h = total_h - head_in - TITLE_IN - bottom_in
    key_w = KEY_IN - 0.12
    key = figure.add_axes((1 - (key_w + 0.04) / total_w, bottom_in / total_h, key_w / total_w, key_h / total_h))
    key.set(xlim=(0, key_w), ylim=(0, key_h))
    key.set_axis_off()
    return Frame(figure, tuple(axes), key, grid, (width, height))


def write_head(figure: Figure, heading: str, note: str, left_in: float) -> None:
    """Write a figure's heading and, below it, the lines of a note, broken where they are too long."""
    width, height = figure.get_size_inches()
    lines = _wrapped(note, width - left_in)
    figure.text(left_in / width, 1 - 0.10 / height, heading, va="top", size=12, weight="bold", color=INK)
    figure.text(left_in / width, 1 - 0.36 / height, "\n".join(lines), va="top", size=TEXT_PT, color=FAINT_INK)


def head_room_in(note: str, width_in: float) -> float:
    """Return the height in inches that `write_head` takes, where a note has a width to itself."""
    return HEAD_IN + LINE_IN * (len(_wrapped(note, width_in)) - 1)


def _wrapped(note: str, width_in: float) -> list[str]:
    """Return the lines of a note, broken between facts, and within one only where it is longer than a line."""
    lines: list[str] = []
    for line in note.replace(" %", "\N{NO-BREAK SPACE}%").splitlines():
        shown = ""
        for fact in line.split(GAP):
            if shown and len(together := f"{shown}{GAP}{fact}") <= int(width_in * LETTERS_PER_IN):
                shown = together
                continue
            *whole, last = textwrap.wrap(fact, int(width_in * LETTERS_PER_IN)) or [""]
            lines += [*filter(None, [shown]), *whole]
            shown = last
        lines.append(shown)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def _best_layout(num: int, tall: float, footer_in: float) -> tuple[int, int, float, float]:
    """Return rows, columns, panel width and height in inches of the layout with the largest panels."""
    layouts = []
    for num_cols in range(1, num + 1):
        num_rows = math.ceil(num / num_cols)
        room_w = (WIDTH_IN - LEFT_IN - KEY_IN) / num_cols - GAP_IN
        if num_cols > 1 and room_w < SLOT_IN:
            break
        room_h = (MAX_HEIGHT_IN - HEAD_IN - BOTTOM_IN) / num_rows - TITLE_IN - footer_in
        width = min(room_w, max(room_h, 0.5) / tall)
        layouts.append((num_rows, num_cols, width))
    widest = max(width for *_, width in layouts)
    # A flatter figure reads better on a screen: worth panels smaller by a tenth.
    num_rows, num_cols, width = min(layout for layout in layouts if layout[2] > 0.9 * widest)
    return num_rows, num_cols, width, width * tall


def _dress(panel: Axes, grid: Grid, title: str, width_in: float, height_in: float) -> None:
    panel.set(xlim=(grid.x_min_m, grid.x_max_m), ylim=(grid.y_min_m, grid.y_max_m), aspect="equal")
    panel.set_title(title, size=TEXT_PT, loc="left", pad=4, color=INK)
    panel.set_facecolor(NO_DATA_COLOUR)
    panel.set_gid(MAP)
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)
    for axis, room_in, label_in, clear_in in (
        # The last label stays clear of the next panel's first one.
        (panel.xaxis, width_in, 0.55, 0.18),
        (panel.yaxis, height_in, 0.5, 0.0),
    ):
        low_m, high_m = axis.get_view_interval()
        ticks_m, step_m = round_ticks(low_m, high_m, room_in / label_in, clear_in / room_in)
        axis.set_major_locator(FixedLocator(ticks_m.tolist()))
        decimals = decimals_of(step_m / 1000)
        axis.set_major_formatter(FuncFormatter(lambda value, _, n=decimals: f"{value / 1000:.{n}f}"))
    for spine in panel.spines.values():
        spine.set(linewidth=0.6, color=FAINT_INK)


def round_ticks(low: float, high: float, most: float, clear: float = 0.0) -> tuple[np.ndarray, float]:
    """Return round numbers in a range but for a share at its end, as many as have room, at most six; their step."""
    step = round_length_m((high - low) / max(1.0, min(6.0, most)), down=False)
    end = high - clear * (high - low)
    return np.arange(math.ceil(low / step), math.floor(end / step) + 1) * step, step


def decimals_of(step: float) -> int:
    """Return how many decimals multiples of a step need."""
    return max(0, -math.floor(math.log10(step)))


def mark_ends(panel: Axes, start_xy_m: Iterable[Any], goal_xy_m: Iterable[Any], size: float = 1.0) -> None:
    """Mark where a route starts (circle) and ends (star); `add_key` names the two."""
    for (_, marker, markersize), at in zip(ENDS, (start_xy_m, goal_xy_m), strict=True):
        panel.plot(*at, marker=marker, markersize=size * markersize, zorder=20, clip_on=False, **END_LOOK)


def draw_layers(panel: Axes, grid: Grid, layers: Sequence[MapLayer]) -> None:
    """Draw maps into a panel, later ones over earlier ones, thinned where they are large.

    Layers become one image before it is scaled to the page, so that thin streets and small roofs blend
    into their surroundings instead of flickering in and out.
    """
    thinned = [thin(layer.values, layer.is_classes) for layer in layers]
    (rows, cols), (high, wide) = thinned[0][0].shape, thinned[0][1:]
    image = np.empty((rows, cols, 3), np.uint8)
    image[:] = np.round(255 * np.array(to_rgb(NO_DATA_COLOUR)))
    for layer, (values, *_) in zip(layers, thinned, strict=True):
        rgba = layer.colours(np.ma.masked_invalid(values), bytes=True)
        is_drawn = rgba[..., 3] > 0
        image[is_drawn] = rgba[is_drawn][:, :3]
    x_end_m = grid.x_min_m + cols * wide * grid.resolution_m
    y_end_m = grid.y_min_m + rows * high * grid.resolution_m
    extent = (grid.x_min_m, x_end_m, grid.y_min_m, y_end_m)
    panel.imshow(image, extent=extent, origin="lower", interpolation="auto", aspect="equal")


def draw_hatch(panel: Axes, grid: Grid, is_hatched: np.ndarray) -> None:
    """Hatch the cells of a mask ``[Y, X]`` in a panel."""
    marks, high, wide = thin(is_hatched.astype(np.float32))
    x_m, y_m = (
        start_m + (np.arange(size) + 0.5) * step * grid.resolution_m
        for start_m, size, step in ((grid.x_min_m, marks.shape[1], wide), (grid.y_min_m, marks.shape[0], high))
    )
    with rc_context({"hatch.linewidth": 0.5, "hatch.color": HATCH_COLOUR}):
        panel.contourf(x_m, y_m, marks, [0.5, 1.5], colors="none", hatches=[HATCH])


def classes_layer(values: np.ndarray, colours: Sequence[str]) -> MapLayer:
    """Return class numbers 0, 1, ... as a layer with a colour each; negative ones are not drawn."""
    cmap = ListedColormap(list(colours)).with_extremes(under=(0, 0, 0, 0))
    norm = BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours))
    return MapLayer(values, Colours(cmap, norm), is_classes=True)


def flat_layer(is_drawn: np.ndarray, colour: str) -> MapLayer:
    """Return the cells of a mask as a layer of one colour."""
    return classes_layer(np.where(is_drawn, np.int8(0), np.int8(-1)), [colour])


def add_key(
    frame: Frame,
    patches: Sequence[tuple[str, str]] = (),
    colours: Colours | None = None,
    *,
    has_scale: bool = True,
    has_ends: bool = False,
    hatched: str = "",
) -> None:
    """Fill the key column: legend patches (name, colour), colour bar with its label, north arrow, scale bar.

    ``hatched``: a legend entry of its own for what `draw_hatch` marks.
    ``has_ends``: entries for what `mark_ends` draws.
    ``has_scale``: not where panels show windows of different sizes, which each want a scale bar of their own.
    """
    _, top = frame.key.get_ylim()
    add_north(frame)
    if has_scale:
        add_scale(frame.key, (frame.grid.x_max_m - frame.grid.x_min_m) / frame.panel_in[0])
    entries: dict[str, Artist] = {
        name: Patch(facecolor=colour, edgecolor=FAINT_INK, linewidth=0.4) for name, colour in patches
    }
    if hatched:
        entries[hatched] = Patch(facecolor=HATCHED_GROUND, edgecolor=HATCH_COLOUR, hatch=HATCH, linewidth=0.4)
    if has_ends:
        entries |= {
            name: Line2D([], [], marker=marker, markersize=0.9 * size, **END_LOOK) for name, marker, size in ENDS
        }
    if entries:
        write_legend(frame, entries)
        lines = sum(1 + name.count("\n") for name in entries)
        top -= 0.175 * lines + 0.06 * len(entries) + 0.1
    if colours is not None:
        height = min(3.0, top - 1.4)
        add_colour_bar(frame.figure, _key_box(frame, 0.02, top - height, 0.16, height), colours)


def write_legend(frame: Frame, entries: Mapping[str, Artist]) -> None:
    """Write a legend at the top of the key column."""
    frame.key.legend(
        entries.values(),
        entries.keys(),
        loc="upper left",
        bbox_to_anchor=(-0.04, 1.02),
        fontsize=SMALL_PT,
        frameon=False,
        handlelength=1.2,
        handleheight=1.0,
        borderpad=0.2,
        labelspacing=0.45,
    )


def _key_box(frame: Frame, x_in: float, y_in: float, width_in: float, height_in: float) -> Box:
    """Return a box of the key column, inches, as figure fractions."""
    corner = frame.key.transData.transform([(x_in, y_in), (x_in + width_in, y_in + height_in)])
    (x0, y0), (x1, y1) = frame.figure.transFigure.inverted().transform(corner)
    return x0, y0, x1 - x0, y1 - y0


def drop_in(panel: Axes) -> float:
    """Return how far below a panel its footer begins, inches: under the tick labels, where it has them."""
    return BOTTOM_IN - 0.06 if panel.xaxis.get_tick_params()["labelbottom"] else 0.07


def add_bar_below(frame: Frame, panel: Axes, colours: Colours) -> None:
    """Add a lying colour bar in the footer of a panel."""
    box, (total_w, total_h) = panel.get_position(), frame.figure.get_size_inches()
    # The numbers at its ends stay beneath the map, and a narrow map's bar still has room for them.
    width, height = max(box.width - 0.36 / total_w, 1.1 / total_w), 0.09 / total_h
    below = (box.x0 + (box.width - width) / 2, box.y0 - drop_in(panel) / total_h - height, width, height)
    add_colour_bar(frame.figure, below, colours)


def round_length_m(length_m: float, down: bool = True) -> float:
    """Return the nearest of 1, 2, 5 x 10^k metres that is not longer (``down``) or not shorter."""
    power = 10.0 ** math.floor(math.log10(length_m))
    steps = [factor * power for factor in (1, 2, 5, 10)]
    fits = [s for s in steps if (s <= length_m * (1 + 1e-9) if down else s >= length_m * (1 - 1e-9))]
    return max(fits) if down else min(fits)


def add_north(frame: Frame) -> None:
    """Draw the arrow to true north, at grid azimuth minus the meridian convergence of the region's centre."""
    key, (east, north) = frame.key, true_north(frame.grid)
    x_in, y_in, half_in = 0.3, 0.82, 0.22
    tip, tail = (x_in + half_in * east, y_in + half_in * north), (x_in - half_in * east, y_in - half_in * north)
    key.annotate("", tip, tail, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.2})
    key.text(x_in + 0.3 * east, y_in + 0.3 * north, "N", ha="center", va="center", size=TEXT_PT, color=INK)


def add_scale(key: Axes, metres_per_in: float) -> None:
    """Draw a scale bar at the foot of axes over inches."""
    length_m = round_length_m(1.1 * metres_per_in)
    length_in = length_m / metres_per_in
    name = f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"
    for start_in, colour in ((0.05, INK), (0.05 + length_in / 2, "white")):
        key.add_patch(Rectangle((start_in, 0.12), length_in / 2, 0.07, facecolor=colour, edgecolor=INK, linewidth=0.7))
    key.text(0.05 + length_in / 2, 0.23, name, ha="center", va="bottom", size=SMALL_PT, color=INK, gid="scale")


def true_north(grid: Grid) -> tuple[float, float]:
    """Return the unit vector (east, north in the grid's frame) toward true north at the grid's centre."""
    azimuth_rad = -grid.convergence_rad(*grid.centre_lonlat)
    return math.sin(azimuth_rad), math.cos(azimuth_rad)
