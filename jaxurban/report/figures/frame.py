"""Maps in a projected frame: panels of one grid with scale bar, north arrow, colour bar and legend.

Matplotlib lays all of it out.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import Affine2D
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from jaxurban.report.figures.style import FAINT_INK, INK, SMALL_PT, TEXT_PT, Colours, add_colour_bar, chart
from jaxurban.world.grid import Grid

MAX_CELLS = 1500  # a side; larger maps are thinned before they are drawn
WIDTH_IN, MAX_HEIGHT_IN = 11.0, 9.0
SIDE_IN, TICKS_IN = 3.3, 0.4  # what northings, a colour bar and the legend take beside panels; eastings below them
TITLE_IN, GAP_IN, BAR_IN, LINE_IN = 0.42, 0.3, 0.66, 0.15  # of a title, between panels, of a bar below one, of a line
SLOT_IN, MIN_WIDTH_IN = 1.95, 7.2  # room for a panel's title and foot; for the heading
OBSTACLE_COLOUR, NO_DATA_COLOUR = "#c4c4c4", "#efe4d6"
NO_DATA_PATCH = ("no data", NO_DATA_COLOUR)
HATCH, HATCH_COLOUR, HATCHED_GROUND = "////////", "#ffffff", "#7d7c78"
MAP = "map"  # gid of a panel over a grid
END_LOOK: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "black", "markerfacecolor": "white"}
ENDS = tuple(  # of a route, in a legend
    Line2D([], [], marker=marker, markersize=size, label=name, **END_LOOK)
    for name, marker, size in (("start", "o", 6.0), ("goal", "*", 11.0))
)
LegendEntry = tuple[str, str] | Artist  # a name and its colour, or what is drawn


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


class MapPanel(NamedTuple):
    """A map of a figure: its title, its layers, later ones over earlier ones, and the lines below it."""

    title: str
    layers: Sequence[MapLayer] = ()
    foot: str = ""


def draw_maps(
    grid: Grid,
    panels: Sequence[MapPanel],
    heading: str,
    note: str = "",
    *,
    legend: Iterable[LegendEntry] = (),
    colours: Colours | None = None,
    has_ticks: bool = True,
) -> tuple[Figure, list[Axes]]:
    """Return a figure of maps and the axes of its panels, in reading order.

    Args:
      grid: of all panels, which keep its proportions.
      panels: what they show.
      heading: first line of the figure, bold.
      note: the lines beneath it, broken where they are too long.
      legend: entries beside the panels.
      colours: of the bar beside the panels; left out, each panel whose last layer is none of classes has one below it.
      has_ticks: whether eastings and northings are shown.
    """
    tall = (grid.y_max_m - grid.y_min_m) / (grid.x_max_m - grid.x_min_m)
    has_bar = [colours is None and bool(panel.layers) and not panel.layers[-1].is_classes for panel in panels]
    foot_in = BAR_IN * any(has_bar) + LINE_IN * max(len(panel.foot.splitlines()) for panel in panels)
    num_rows, num_cols, width_in = _best_layout(len(panels), tall, foot_in)
    height_in = num_rows * (TITLE_IN + width_in * tall + foot_in) + TICKS_IN * has_ticks
    total_in = max(num_cols * (max(width_in, SLOT_IN) + GAP_IN) + SIDE_IN, MIN_WIDTH_IN)
    figure = chart(total_in, height_in, heading, note)
    axes = figure.subplots(num_rows, num_cols, squeeze=False).ravel().tolist()
    for empty in axes[len(panels) :]:
        empty.remove()
    axes = axes[: len(panels)]
    for number, (panel, (title, layers, foot)) in enumerate(zip(axes, panels, strict=True)):
        _dress(panel, grid, title, width_in, width_in * tall)
        is_left, is_bottom = number % num_cols == 0 and has_ticks, number + num_cols >= len(panels) and has_ticks
        panel.tick_params(labelleft=is_left, labelbottom=is_bottom, left=has_ticks, bottom=has_ticks)
        panel.set_ylabel("northing (km)" if is_left else "", size=SMALL_PT)
        below = "\n".join(filter(None, ("easting (km)" if is_bottom else "", foot)))
        panel.set_xlabel(below, size=SMALL_PT, loc="left" if foot else "center")
        if layers:
            draw_layers(panel, grid, layers)
        if has_bar[number]:
            add_colour_bar(figure, [panel], layers[-1].colours, max(width_in, SLOT_IN), "bottom")
    add_scale(axes[0])
    if colours is not None:
        add_colour_bar(figure, axes, colours, 0.8 * height_in)
    add_legend(figure, [*legend, north_entry(grid)])
    return figure, axes


def _best_layout(num: int, tall: float, foot_in: float) -> tuple[int, int, float]:
    """Return rows, columns and panel width in inches of the layout with the largest panels."""
    layouts = []
    for num_cols in range(1, num + 1):
        num_rows = math.ceil(num / num_cols)
        room_w = (WIDTH_IN - SIDE_IN) / num_cols - GAP_IN
        if num_cols > 1 and room_w < SLOT_IN:
            break
        room_h = (MAX_HEIGHT_IN - 1.0 - TICKS_IN) / num_rows - TITLE_IN - foot_in
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
    for axis, room_in, label_in in ((panel.xaxis, width_in, 0.75), (panel.yaxis, height_in, 0.5)):
        axis.set_major_locator(round_ticks(room_in / label_in))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 1000:.7g}"))
    panel.spines[:].set(linewidth=0.6, color=FAINT_INK)


def round_ticks(most: float) -> MaxNLocator:
    """Return what places as many round ticks as have room, at most six."""
    return MaxNLocator(int(min(6.0, max(1.0, most))), steps=[1, 2, 5, 10], min_n_ticks=1)


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


def mark_ends(panel: Axes, start_xy_m: Iterable[Any], goal_xy_m: Iterable[Any], size: float = 1.1) -> None:
    """Mark where a route starts (circle) and ends (star); `ENDS` are their entries in a legend."""
    for end, at in zip(ENDS, (start_xy_m, goal_xy_m), strict=True):
        look = END_LOOK | {"marker": end.get_marker(), "markersize": size * end.get_markersize()}
        panel.plot(*at, zorder=20, clip_on=False, **look)


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


def add_legend(figure: Figure, entries: Iterable[LegendEntry]) -> None:
    """Write a legend at the right of a figure."""
    look: dict[str, Any] = {"edgecolor": FAINT_INK, "linewidth": 0.4}
    handles = [Patch(facecolor=each[1], label=each[0], **look) if isinstance(each, tuple) else each for each in entries]
    figure.legend(handles=handles, loc="outside right center", fontsize=SMALL_PT, frameon=False, handlelength=1.4)


def round_length_m(length_m: float, down: bool = True) -> float:
    """Return the nearest of 1, 2, 5 x 10^k metres that is not longer (``down``) or not shorter."""
    power = 10.0 ** math.floor(math.log10(length_m))
    steps = [factor * power for factor in (1, 2, 5, 10)]
    fits = [s for s in steps if (s <= length_m * (1 + 1e-9) if down else s >= length_m * (1 - 1e-9))]
    return max(fits) if down else min(fits)


def add_scale(panel: Axes) -> None:
    """Draw a scale bar in a panel's lower left corner."""
    low_m, high_m = panel.get_xlim()
    length_m = round_length_m(0.3 * (high_m - low_m))
    name = f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"
    look: dict[str, Any] = {"color": INK, "label_top": True, "fontproperties": {"size": SMALL_PT}}
    look["size_vertical"] = 0.006 * (high_m - low_m)
    bar = AnchoredSizeBar(panel.transData, length_m, name, "lower left", pad=0.25, borderpad=0.3, sep=2, **look)
    bar.patch.set(edgecolor="none", boxstyle="square,pad=0")
    bar.set_zorder(15)
    panel.add_artist(bar)


def north_entry(grid: Grid) -> Line2D:
    """Return the legend entry of true north: an arrow at grid azimuth, less the meridian convergence of the centre."""
    east, north = true_north(grid)
    arrow = MarkerStyle("$\\uparrow$", transform=Affine2D().rotate(math.atan2(-east, north)))
    return Line2D([], [], linestyle="none", marker=arrow, markersize=11, color=INK, label="north")


def true_north(grid: Grid) -> tuple[float, float]:
    """Return the unit vector (east, north in the grid's frame) toward true north at the grid's centre."""
    azimuth_rad = -grid.convergence_rad(*grid.centre_lonlat)
    return math.sin(azimuth_rad), math.cos(azimuth_rad)
