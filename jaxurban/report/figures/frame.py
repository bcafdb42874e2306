"""Map panels in a projected frame, with scale bar, north arrow, colour bars and legends; by metres or by degrees.

Matplotlib lays the panels and the colour bars out; a key column on the right holds the legend, the north arrow and the
scale bar, so that nothing covers the map.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter
from matplotlib.transforms import offset_copy
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from jaxurban.report.figures.style import FAINT_INK, INK, SMALL_PT, TEXT_PT, Colours, add_colour_bar, chart
from jaxurban.world.grid import Grid

MAX_CELLS = 1500  # a side; larger maps are thinned before they are drawn
WIDTH_IN, MAX_HEIGHT_IN = 11.0, 9.0
LEFT_IN, BOTTOM_IN, BAR_IN = 0.75, 0.52, 1.0  # what the ticks of outer panels and a colour bar beside them take
TITLE_IN, GAP_IN, KEY_IN = 0.32, 0.22, 1.4
SLOT_IN, MIN_WIDTH_IN = 1.95, 7.2  # room for a panel's title and footer; for the heading
OBSTACLE_COLOUR, NO_DATA_COLOUR = "#c4c4c4", "#efe4d6"
NO_DATA_PATCH = ("no data", NO_DATA_COLOUR)
HATCH, HATCH_COLOUR, HATCHED_GROUND = "////////", "#ffffff", "#7d7c78"
MAP, KEY = "map", "key"  # gid of a panel over a grid, and of the key column
NUM_PLACES = 65  # along an edge, between which degrees are interpolated
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
      panel_in: width and height of a panel, about.
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
    num_rows, num_cols, width = _best_layout(len(titles), tall, footer_in)
    width_in = LEFT_IN + num_cols * (max(width, SLOT_IN) + GAP_IN) + BAR_IN + KEY_IN
    height_in = num_rows * (TITLE_IN + width * tall + footer_in) + BOTTOM_IN * with_ticks
    figure = chart(max(width_in, MIN_WIDTH_IN), height_in, heading, note, right_in=KEY_IN)
    axes = figure.subplots(num_rows, num_cols, squeeze=False).ravel().tolist()
    for panel in axes[len(titles) :]:
        panel.remove()
    for number, (panel, title) in enumerate(zip(axes, titles, strict=False)):
        _dress(panel, grid, title, width, width * tall)
        is_left, is_bottom = number % num_cols == 0 and with_ticks, number + num_cols >= len(titles) and with_ticks
        panel.tick_params(labelleft=is_left, labelbottom=is_bottom, left=with_ticks, bottom=with_ticks)
        panel.set_ylabel("northing (km)" if is_left else "", size=SMALL_PT)
        panel.set_xlabel("easting (km)" if is_bottom else "", size=SMALL_PT)
    key_w, key_h = KEY_IN - 0.1, height_in - TITLE_IN - 0.1
    total_w, total_h = figure.get_size_inches()
    key = figure.add_axes((1 - key_w / total_w, 0.1 / total_h, key_w / total_w, key_h / total_h))
    key.set(xlim=(0, key_w), ylim=(0, key_h), gid=KEY)
    key.set_axis_off()
    return Frame(figure, tuple(axes[: len(titles)]), key, grid, (width, width * tall))


def _best_layout(num: int, tall: float, footer_in: float) -> tuple[int, int, float]:
    """Return rows, columns and panel width in inches of the layout with the largest panels."""
    layouts = []
    for num_cols in range(1, num + 1):
        num_rows = math.ceil(num / num_cols)
        room_w = (WIDTH_IN - LEFT_IN - BAR_IN - KEY_IN) / num_cols - GAP_IN
        if num_cols > 1 and room_w < SLOT_IN:
            break
        room_h = (MAX_HEIGHT_IN - 0.62 - BOTTOM_IN) / num_rows - TITLE_IN - footer_in
        layouts.append((num_rows, num_cols, min(room_w, max(room_h, 0.5) / tall)))
    widest = max(width for *_, width in layouts)
    # A flatter figure reads better on a screen: worth panels smaller by a tenth.
    return min(layout for layout in layouts if layout[2] > 0.9 * widest)


def _dress(panel: Axes, grid: Grid, title: str, width_in: float, height_in: float) -> None:
    panel.set(xlim=(grid.x_min_m, grid.x_max_m), ylim=(grid.y_min_m, grid.y_max_m), aspect="equal", anchor="NW")
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
    """Add a colour bar beside the panels, and to the key column legend patches (name, colour), north arrow, scale bar.

    ``hatched``: a legend entry of its own for what `draw_hatch` marks.
    ``has_ends``: entries for what `mark_ends` draws.
    ``has_scale``: not where panels show windows of different sizes, which each want a scale bar of their own.
    """
    add_north(frame)
    if has_scale:
        add_scale(frame, frame.axes[0], frame.key)
    look: dict[str, Any] = {"edgecolor": FAINT_INK, "linewidth": 0.4}
    entries: list[Artist] = [Patch(facecolor=colour, label=name, **look) for name, colour in patches]
    if hatched:
        look |= {"edgecolor": HATCH_COLOUR, "hatch": HATCH}
        entries.append(Patch(facecolor=HATCHED_GROUND, label=hatched, **look))
    for name, marker, size in ENDS if has_ends else ():
        entries.append(Line2D([], [], marker=marker, markersize=0.9 * size, label=name, **END_LOOK))
    if entries:
        write_legend(frame.key, entries)
    if colours is not None:
        add_colour_bar(frame.figure, [*frame.axes], colours, 0.9 * frame.key.get_ylim()[1])


def write_legend(panel: Axes, entries: Sequence[Artist], y: float = 1.0, drop_in: float = 0.0) -> None:
    """Write a legend at a height of axes (1: their top) and below it, so many inches further down."""
    panel.legend(
        handles=list(entries),
        loc="upper left",
        bbox_to_anchor=(0, y),
        bbox_transform=offset_copy(panel.transAxes, panel.get_figure(root=True), y=-drop_in),
        fontsize=SMALL_PT,
        frameon=False,
        handlelength=1.4,
        borderpad=0,
        borderaxespad=0,
        labelspacing=0.35,
    )


def drop_in(panel: Axes) -> float:
    """Return how far below a panel its footer begins, inches: under the tick labels, where it has them."""
    return 0.42 if panel.xaxis.get_tick_params()["labelbottom"] else 0.07


def add_bar_below(frame: Frame, panel: Axes, colours: Colours) -> None:
    """Add a lying colour bar in the footer of a panel."""
    add_colour_bar(frame.figure, [panel], colours, max(frame.panel_in[0], SLOT_IN), "bottom")


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


def add_scale(frame: Frame, panel: Axes, place: Axes, drop_in: float = 0.0) -> None:
    """Draw a panel's scale bar at the foot of axes, or so many inches below it."""
    low_m, high_m = panel.get_xlim()
    metres_per_in = (high_m - low_m) / frame.panel_in[0]
    length_m = round_length_m(0.8 * metres_per_in)
    name = f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"
    bar = AnchoredSizeBar(
        panel.transData,
        length_m,
        name,
        "lower left",
        pad=0.2,
        borderpad=0,
        frameon=False,
        size_vertical=0.05 * metres_per_in,
        color=INK,
        label_top=True,
        fontproperties={"size": SMALL_PT},
        bbox_to_anchor=(0, 0),
        bbox_transform=offset_copy(place.transAxes, frame.figure, y=-drop_in),
    )
    place.add_artist(bar)


def true_north(grid: Grid) -> tuple[float, float]:
    """Return the unit vector (east, north in the grid's frame) toward true north at the grid's centre."""
    azimuth_rad = -grid.convergence_rad(*grid.centre_lonlat)
    return math.sin(azimuth_rad), math.cos(azimuth_rad)


def show_degrees(figure: Figure, grid: Grid) -> Figure:
    """Label the maps of a figure by degrees, and return it; maps without ticks, as in the overview, stay without.

    A tick stands where its meridian or parallel meets the map's lower or left edge: in a projection these run a little
    askew, so that it holds at that edge.

    Args:
      figure: from any function that draws maps.
      grid: any grid in the CRS of its maps.
    """
    for panel in figure.axes:
        if panel.get_gid() == MAP:
            (west_m, east_m), (south_m, north_m) = panel.get_xlim(), panel.get_ylim()
            x_m, y_m = np.linspace(west_m, east_m, NUM_PLACES), np.linspace(south_m, north_m, NUM_PLACES)
            longitudes = grid.lonlat_of_xy(x_m, np.full(NUM_PLACES, south_m))[0]
            latitudes = grid.lonlat_of_xy(np.full(NUM_PLACES, west_m), y_m)[1]
            tall = (north_m - south_m) / (east_m - west_m)
            slot_in = panel.get_position().size * figure.get_size_inches()
            width_in = min(slot_in[0], slot_in[1] / tall)
            _label(panel, panel.xaxis, x_m, np.unwrap(longitudes, period=360.0), "EW", width_in)
            _label(panel, panel.yaxis, y_m, latitudes, "NS", width_in * tall)
    return figure


def in_degrees(
    figures: Mapping[str, Callable[[], Figure]], grid: Grid, is_wanted: bool
) -> dict[str, Callable[[], Figure]]:
    """Return what draws figures, their maps labelled by degrees where that is wanted."""

    def labelled(draw: Callable[[], Figure]) -> Figure:
        return show_degrees(draw(), grid)

    return {name: partial(labelled, draw) if is_wanted else draw for name, draw in figures.items()}


def _label(panel: Axes, axis: Axis, at_m: np.ndarray, degrees: np.ndarray, sides: str, room_in: float) -> None:
    is_x = axis is panel.xaxis
    # A tick of longitude needs more room, and the last one leaves some free for the next panel's first.
    ticks, step = round_ticks(degrees[0], degrees[-1], room_in / (0.75 if is_x else 0.5), 0.3 * is_x / room_in)
    axis.set_major_locator(FixedLocator(np.interp(ticks, degrees, at_m).tolist()))
    shown, decimals = (ticks + 180) % 360 - 180 if is_x else ticks, decimals_of(step)
    names = [f"{abs(tick):.{decimals}f}°{sides[0 if tick >= 0 else 1]}" for tick in shown]
    axis.set_major_formatter(FixedFormatter(names))
    axis.set_label_text("")  # the letters say which it is
