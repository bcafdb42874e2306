"""Maps in a projected frame: panels with scale bar, north arrow and colour bar, a legend, and a note beneath."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.offsetbox import AnchoredOffsetbox, AnchoredText
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from jaxurban.draw.style import (
    FAINT_INK,
    INK,
    LETTERS_PER_IN,
    LINE_IN,
    SMALL_PT,
    TEXT_PT,
    Colours,
    add_colour_bar,
    bar_ticks,
    chart,
    is_small,
    legend_columns,
    letter,
    panel_columns,
    recoloured,
    styled,
    tick_label,
    width_in_of,
    wrapped,
)
from jaxurban.draw.write import Look
from jaxurban.errors import InputError
from jaxurban.knowledge import OF_SKY, names_of
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.variables import CAVEAT, names_in
from jaxurban.paths.constraints import describe_clearances, describe_kept
from jaxurban.pictures import Form
from jaxurban.settings import time_said as time_said
from jaxurban.world.grid import Grid, crs_said

MAX_CELLS = 4000  # a side: of larger maps every second, third ... row and column is drawn
MAX_HEIGHT_IN, MIN_HEIGHT_IN = 6.5, 0.8  # of all panels and what is below them; of a panel
FIRST_IN, BAR_IN = 6.0, 0.6  # height of a row before the layout settles; of a bar below a panel
BAR_AT_IN, THICK_IN = 0.15, 0.07  # of a bar below its panel
NORTHING_IN, SIDE_IN = 0.55, 1.9  # left of all panels, right of them where a legend fits there
MIN_WIDTH_IN, SMALL_PANEL_IN = 1.45, 0.7  # of a column of panels; in small axes
LEAST_BAR_IN = 0.9  # of a bar that holds its numbers
FILLED = 0.6  # share of a bar below a panel that its numbers fill at most
TICK_IN, MAX_TICKS = 0.75, 3  # width of an easting; most of them below a panel
OBSTACLE_COLOUR, NO_DATA_COLOUR, GUESSED_ROOF_COLOUR = "#c4c4c4", "#efe4d6", "#d98c4a"
NO_DATA_PATCH = ("no data", NO_DATA_COLOUR)
GAP = "  ·  "  # between two facts of a line
MOST_RULES = 2  # weights, or the like, of the routes of one picture
MAP = "map"  # gid of a panel over a grid
# Of a panel, as shares of it: scale bars stand in the first that is clear, north in the last; an end is in the way.
CORNERS = {"lower left": (0, 0), "lower right": (1, 0), "upper left": (0, 1), "upper right": (1, 1)}
NEAR = 0.2
GUESSED, GUESSED_SAID = "Guessed: ", "Rests on guesses (maps.guesses)."  # of a note; in small axes
ORIENTED_IN = 1.5  # narrower panels have no room for a scale bar and north
NORTH = "▲\nN"
SAME = 0.01  # share of a scale, which no eye tells apart
# Around what is drawn over maps, so that it is seen over any colour.
HALO: Look = {"path_effects": [withStroke(linewidth=2.4, foreground="white")]}
SETTLING = 3  # runs of the layout, after which a figure's height is right to 0.01 inches
END_LOOK: Look = {
    "linestyle": "none",
    "markeredgecolor": "black",
    "markerfacecolor": "white",
}
ENDS = tuple(  # of a route, in a legend
    Line2D([], [], marker=marker, markersize=size, label=name, **END_LOOK)
    for name, marker, size in (("start", "o", 6.0), ("goal", "*", 11.0))
)
BLOCKED_COLOUR = "#d9c08c"  # obstacles over the pale cost map
HATCH, VEIL_COLOUR = "///////", f"{BLOCKED_COLOUR}40"  # of cells that are closed and no obstacle
CLOSED = Patch(
    facecolor=VEIL_COLOUR,
    edgecolor=BLOCKED_COLOUR,
    hatch=HATCH,
    linewidth=0.4,
    label="closed to routes by\nclearance, unknown\nheight or zone",
)
MARGIN, LEAST_CELLS = 0.15, 30  # around points, of their longer side; from their middle to a side
NOWHERE = np.empty((0, 0), bool)
LegendEntry = tuple[str, str] | Artist  # a name and its colour, or what is drawn


class DrawnMap(NamedTuple):
    """One map as it is drawn.

    Attributes:
      values: ``[Y, X]`` float, NaN where nothing is drawn; or class numbers.
      colours: how values become colours.
    """

    values: np.ndarray
    colours: Colours


class MapPanel(NamedTuple):
    """A map of a figure.

    Attributes:
      title: above it.
      layers: later ones over earlier ones.
      foot: lines below it.
      grid: its own, if any.
      is_closed: ``[Y, X]`` bool: cells that are hatched; `NOWHERE`: none.
      altitude_m: of the map; None: it has none.
    """

    title: str
    layers: Sequence[DrawnMap] = ()
    foot: str = ""
    grid: Grid | None = None
    is_closed: np.ndarray = NOWHERE
    altitude_m: float | None = None


class Size(NamedTuple):
    """How the panels of a figure stand, and how large they are.

    Attributes:
      num_rows: of panels.
      num_cols: of panels.
      cell_in: width of a column in inches.
      panel_in: width of a panel in inches, unless the layout leaves it less.
      tall: height of a panel by its width.
      is_beside: whether the legend stands beside all panels.
    """

    num_rows: int
    num_cols: int
    cell_in: float
    panel_in: float
    tall: float
    is_beside: bool


def varied(panels: list[MapPanel], note: str) -> tuple[list[MapPanel], str]:
    """Return the panels of more than one colour, and the note with the titles of others; all if all have only one.

    Args:
      panels: each of a map and of a layer over it, whose classes below 0 are not drawn.
      note: of their figure.
    """
    flat = []
    for panel in panels:
        (values, colours), over = panel.layers
        shown = colours.norm(values[values >= 0])
        if shown.size and np.ptp(shown) < SAME and over.values.max() < 0:
            flat.append(panel.title)
    if len(flat) in (0, len(panels)):
        return panels, note
    kept = [panel for panel in panels if panel.title not in flat]
    return kept, f"Not drawn, as the map is the same everywhere: {'; '.join(flat)}\n{note}"


@styled
def draw_maps(
    grid: Grid,
    panels: Sequence[MapPanel],
    heading: str,
    note: str = "",
    *,
    legend: Iterable[LegendEntry] = (),
    colours: Colours | None = None,
    has_ticks: bool = True,
    cmap: Any = None,
    **form: Unpack[Form],
) -> tuple[Figure, list[Axes]]:
    """Return a figure of maps and the axes of its panels, in reading order.

    The legend stands where a panel is missing to a full row, beside the panels where these are narrow, else below. In a
    cell of a figure that is small (`is_small`) there are the maps alone, with a bar and the first words of what it is.

    Args:
      grid: of all panels without their own; all keep its proportions.
      panels: what they show.
      heading: first line of the figure, bold.
      note: the lines beneath it, broken where they are too long.
      legend: entries beside the panels.
      colours: of one bar for all panels; left out, each panel whose last layer is none of classes has one below it.
      has_ticks: whether eastings and northings are shown, where no bar is in their place.
      cmap: in place of the colours of all maps that have a scale, and of the bar.
      form: see `jaxurban.draw.style.chart`.

    Returns:
      The figure, and one axes per panel.

    Raises:
      InputError: a width that the figure cannot have, axes that are no cell, or a colour map that is none, or where no
        map has a scale.
    """
    if cmap is not None:
        panels = [_recoloured_panel(panel, cmap) for panel in panels]
        if colours is not None:
            colours = recoloured(colours, cmap)
        elif not any(map(_own_bar, panels)):
            raise InputError("cmap: this map has classes, each of its own colour: leave cmap out")

    width_in = width_in_of(form)
    least_in = MIN_WIDTH_IN
    fits = not is_small(form)
    if not fits:
        note = GUESSED_SAID * (GUESSED in note)
        legend, has_ticks = (), False
        heading = heading.partition(",")[0]
        panels = [panel._replace(foot="") for panel in panels]
        least_in = SMALL_PANEL_IN

    # How large the panels are, and how much room ticks, feet and colour bars leave them.
    bars = [_own_bar(panel) for panel in panels]
    if len(panels) == 1:
        colours = colours or bars[0]
    if colours is not None:
        bars = [None] * len(panels)
    if not fits:
        colours = colours and replace(colours, label=colours.label.partition("\n")[0])
        bars = [bar and replace(bar, label="") for bar in bars]
    if len(panels) == 1 and form.get("ax") is not None and not panels[0].foot:
        # As wide as the map, which a low cell makes narrower than the cell.
        bars, colours = [colours], None
    foot_in = LINE_IN * max(len(panel.foot.splitlines()) for panel in panels)
    if any(bars):
        has_ticks = False
        foot_in += BAR_IN
    if has_ticks:
        width_in -= NORTHING_IN
    size = _size(grid, len(panels), width_in, foot_in, least_in)

    # The cells of the panels, in rows. Where no cell is left for the legend, a low row is added below them.
    figure = chart(FIRST_IN * size.num_rows, heading, note, **form)
    row_heights = [1.0] * size.num_rows
    is_full = len(panels) == size.num_rows * size.num_cols
    if is_full and not size.is_beside:
        row_heights.append(0.01)
    col_widths = [size.cell_in] * size.num_cols + [SIDE_IN] * size.is_beside
    cells = figure.add_gridspec(
        len(row_heights), len(col_widths), width_ratios=col_widths, height_ratios=row_heights
    )
    axes = [
        figure.add_subplot(cells[divmod(number, size.num_cols)]) for number in range(len(panels))
    ]

    # Each panel with its title, and its ticks or the bar below it.
    for number, (spot, panel, bar) in enumerate(zip(axes, panels, bars, strict=True)):
        title = letter(number, len(panels)) + panel.title
        _draw_panel(spot, panel._replace(title=title), panel.grid or grid, size)
        spot.title.set_size(TEXT_PT if fits else SMALL_PT)
        if size.panel_in > ORIENTED_IN:
            _orient(spot)
        if has_ticks:
            is_left = number % size.num_cols == 0
            is_bottom = number + size.num_cols >= len(panels)
            _add_ticks(spot, size, is_left=is_left, is_bottom=is_bottom)
        if bar is not None:
            _add_bar_below(figure, spot, bar, size)

    # The one colour bar and the legend, and then the figure's height, which depends on them.
    if colours is not None:
        gap_share = (1 - size.panel_in / size.cell_in) / size.num_cols  # right of the last panel
        add_colour_bar(figure, axes, colours, "bottom", share=1 - gap_share)
    gap = cells[:, -1] if size.is_beside else cells[len(panels) :]
    gap_in = SIDE_IN if size.is_beside else len(gap.colspan) * size.cell_in
    _add_key(figure, legend, gap, gap_in)
    _settle(figure, axes, size)
    return figure, axes


def _recoloured_panel(panel: MapPanel, cmap: Any) -> MapPanel:
    """Return a panel whose maps with a scale have another colour map."""
    layers = [DrawnMap(values, recoloured(colours, cmap)) for values, colours in panel.layers]
    return panel._replace(layers=layers)


def _size(grid: Grid, num: int, width_in: float, foot_in: float, least_in: float) -> Size:
    """Return how the panels of a figure stand, and how large they are.

    Panels are as wide as their columns unless they would then be too high together.

    Args:
      grid: whose proportions every panel has.
      num: number of panels.
      width_in: of all columns together, inches.
      foot_in: height of what stands below each panel, inches.
      least_in: width of a column, inches.
    """
    num_cols = min(panel_columns(num), max(1, int(width_in / least_in)))
    num_rows = math.ceil(num / num_cols)
    tall = (grid.y_max_m - grid.y_min_m) / (grid.x_max_m - grid.x_min_m)
    height_in = max(MIN_HEIGHT_IN, MAX_HEIGHT_IN / num_rows - foot_in)
    panel_in = min(width_in / num_cols, height_in / tall)
    is_beside = least_in == MIN_WIDTH_IN and width_in - num_cols * panel_in > SIDE_IN
    if is_beside:
        width_in -= SIDE_IN
    return Size(num_rows, num_cols, width_in / num_cols, panel_in, tall, is_beside)


def _draw_panel(spot: Axes, panel: MapPanel, grid: Grid, size: Size) -> None:
    """Draw a map into its axes: title, foot and layers, without ticks.

    Args:
      spot: the axes.
      panel: what to draw.
      grid: of its layers.
      size: of the panels.
    """
    spot.set(xticks=[], yticks=[], facecolor=NO_DATA_COLOUR, gid=MAP)
    spot.set_title(wrapped(panel.title, size.cell_in, TEXT_PT), pad=4)
    spot.set_xlabel(wrapped(panel.foot, size.cell_in), loc="left")
    spot.spines[:].set_visible(True)
    if panel.layers:
        draw_layers(spot, grid, panel.layers, panel.is_closed)
    spot.set(xlim=(grid.x_min_m, grid.x_max_m), ylim=(grid.y_min_m, grid.y_max_m))


def _add_ticks(spot: Axes, size: Size, is_left: bool, is_bottom: bool) -> None:
    """Add ticks to a panel: eastings where it is at the bottom, northings where it is at the left, both in km.

    What is written below the panel moves under the label of the eastings.

    Args:
      spot: the panel's axes, in metres.
      size: of the panels, which decides how many ticks there are.
      is_left: whether the panel is the first of its row.
      is_bottom: whether no panel stands below it.
    """
    num_ticks = int(np.clip(size.panel_in / TICK_IN, 1, MAX_TICKS))
    for axis in (spot.xaxis, spot.yaxis):
        axis.set_major_locator(MaxNLocator(num_ticks, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(lambda value, _: f"{value / 1000:.7g}")
    spot.tick_params(
        labelleft=is_left, labelbottom=is_bottom, labelsize=SMALL_PT, length=3, color=FAINT_INK
    )
    if is_left:
        spot.set_ylabel("northing (km)")
    if is_bottom:
        foot = spot.get_xlabel()
        spot.set_xlabel(joined("easting (km)", foot, by="\n\n"), loc="left" if foot else "center")


def _add_bar_below(figure: Figure, spot: Axes, bar: Colours, size: Size) -> None:
    """Add a colour bar as wide as a panel below it, with two ticks where there is no room for more.

    Args:
      figure: that holds the panel.
      spot: the panel's axes.
      bar: the colours, with the bar's label and ticks.
      size: of the panels.
    """
    ticks = bar_ticks(bar)
    num_letters = sum(len(tick_label(tick)) for tick in ticks)
    if num_letters > FILLED * LETTERS_PER_IN * size.panel_in:
        ticks = [ticks[0], ticks[-1]]
    height_in = size.panel_in * size.tall
    under = spot.inset_axes((0, -BAR_AT_IN / height_in, 1, THICK_IN / height_in))
    label = wrapped(bar.label, size.cell_in)
    add_colour_bar(figure, [spot], replace(bar, ticks=ticks, label=label), cax=under)
    if size.panel_in < LEAST_BAR_IN:  # too narrow for both numbers within its ends
        under.get_xticklabels()[-1].set_horizontalalignment("center")


def _add_key(
    figure: Figure, legend: Iterable[LegendEntry], gap: SubplotSpec, gap_in: float
) -> None:
    """Add a legend to a figure of maps.

    Args:
      figure: of the maps.
      legend: the entries, in order; a name with a colour becomes a filled patch.
      gap: cells of the grid of panels that hold no panel: the legend stands there, in as many columns as fit.
      gap_in: width of these cells, inches.
    """
    handles = []
    for entry in legend:
        if isinstance(entry, tuple):
            name, colour = entry
            entry = Patch(facecolor=colour, label=name, edgecolor=FAINT_INK, linewidth=0.4)
        handles.append(entry)
    holder = figure.add_subplot(gap)
    holder.set_axis_off()
    names = [str(handle.get_label()) for handle in handles]
    num_cols = legend_columns(names, gap_in)
    look: Look = {"loc": "upper left", "borderaxespad": 0, "handlelength": 1.4}
    holder.legend(handles=handles, ncols=num_cols, **look)


def _settle(figure: Any, axes: Sequence[Axes], size: Size) -> None:
    """Give a figure the height that its panels need, and then each panel its true proportions.

    The layout decides how high a cell becomes, so the height is corrected by what the cells lack, a few times
    (`SETTLING`). Until then the panels fill their cells. A part of another figure keeps its height.
    """
    layout: Any = figure.get_layout_engine()
    num_times = 0
    if isinstance(figure, Figure):
        num_times = SETTLING
    for _ in range(num_times):
        layout.execute(figure)
        cell = axes[0].get_position()
        height_in = figure.get_figheight()
        panel_in = min(size.panel_in, cell.width * figure.get_figwidth())
        lack_in = panel_in * size.tall - cell.height * height_in
        figure.set_figheight(height_in + size.num_rows * lack_in)
    for panel in axes:
        panel.set(aspect="equal", anchor="NW")


def _own_bar(panel: MapPanel) -> Colours | None:
    """Return the colours of the bar below a panel, None where it shows nothing or classes."""
    colours = panel.layers[-1].colours if panel.layers else None
    return None if colours is None or isinstance(colours.norm, BoundaryNorm) else colours


def mark_ends(
    panel: Axes, start_xy_m: Iterable[Any], goal_xy_m: Iterable[Any], size: float = 1.1
) -> None:
    """Mark where a route starts (circle) and ends (star), and move scale bar and north to corners without either.

    Args:
      panel: a map that has its scale bar and its north arrow.
      start_xy_m: easting and northing of the start.
      goal_xy_m: easting and northing of the goal.
      size: of the marks, by those in the legend (`ENDS`).
    """
    for end, end_xy_m in zip(ENDS, (start_xy_m, goal_xy_m), strict=True):
        look = END_LOOK | {"marker": end.get_marker(), "markersize": size * end.get_markersize()}
        panel.plot(*end_xy_m, zorder=20, clip_on=False, **look)

    # A corner is clear of an end that is far from it in one direction at least; two ends leave two corners clear.
    ends = panel.transLimits.transform([[*start_xy_m], [*goal_xy_m]])  # as shares of the panel
    clear = [
        name for name, corner in CORNERS.items() if (abs(ends - corner) > NEAR).any(axis=1).all()
    ]
    marks = [mark for mark in panel.artists if isinstance(mark, AnchoredOffsetbox)]
    for mark, name in zip(marks, (clear[0], clear[-1]), strict=False):
        mark.loc = AnchoredOffsetbox.codes[name]


def surroundings(whole: Grid, points_m: np.ndarray) -> Grid:
    """Return the part of a grid around points: a square with a margin, smaller where the grid is.

    Args:
      whole: the grid.
      points_m: ``[N, 2]`` easting and northing of points on it.
    """
    cells = ((points_m - whole.bounds_m[:2]) / whole.resolution_m).astype(int)  # column, row
    low, high = cells.min(axis=0), cells.max(axis=0)
    half = max(LEAST_CELLS, int((0.5 + MARGIN) * (high - low).max()))
    shape = np.array(whole.shape[::-1])
    size = np.minimum(2 * half, shape)
    first = np.clip((low + high) // 2 - half, 0, shape - size)
    west, south = (-first).tolist()
    east, north = (first + size - shape).tolist()
    return whole.padded(west, south, east, north)


def cropped(panel: MapPanel, whole: Grid, part: Grid) -> MapPanel:
    """Return a panel of maps on a grid as one of a part of the grid."""
    window = part.window_in(whole)
    layers = [layer._replace(values=layer.values[window]) for layer in panel.layers]
    return panel._replace(layers=layers, is_closed=panel.is_closed[window])


def draw_layers(spot: Axes, grid: Grid, layers: Sequence[DrawnMap], is_closed: np.ndarray) -> None:
    """Draw maps into axes, later ones over earlier ones, and hatch what is closed.

    Layers become one image before it is scaled to the page, so that thin streets and small roofs blend
    into their surroundings instead of flickering in and out. Where no layer has a colour, the image has that of cells
    without data.

    Args:
      spot: the axes.
      grid: of the maps.
      layers: one at least, ``[Y, X]`` each; of more than `MAX_CELLS` a side only every second, third ... is drawn.
      is_closed: ``[Y, X]`` bool, of which the same cells are looked at.
    """
    step = math.ceil(max(layers[0].values.shape) / MAX_CELLS)
    image = np.round(255 * np.array(to_rgb(NO_DATA_COLOUR))).astype(np.uint8)
    for values, colours in layers:
        rgba = colours(np.ma.masked_invalid(values[::step, ::step]), bytes=True)
        image = np.where(rgba[..., 3:] > 0, rgba[..., :3], image)  # the layer where it is not clear
    rows, cols = image.shape[:2]
    side_m = step * grid.resolution_m
    x_max_m = grid.x_min_m + cols * side_m
    y_max_m = grid.y_min_m + rows * side_m
    extent = (grid.x_min_m, x_max_m, grid.y_min_m, y_max_m)
    spot.imshow(image, extent=extent, origin="lower", interpolation="auto", aspect="auto")
    if is_closed.any():
        hatched = spot.contourf(
            is_closed[::step, ::step],
            [0.5, 1.5],
            colors=[VEIL_COLOUR],
            hatches=[HATCH],
            origin="lower",
            extent=extent,
        )
        hatched.set(edgecolor=BLOCKED_COLOUR, linewidth=0)


def classes_layer(values: np.ndarray, colours: Sequence[str]) -> DrawnMap:
    """Return class numbers 0, 1, ... as a layer with a colour each; negative ones are not drawn."""
    cmap = ListedColormap(list(colours)).with_extremes(under=(0, 0, 0, 0))
    norm = BoundaryNorm(np.arange(len(colours) + 1) - 0.5, len(colours))
    return DrawnMap(values, Colours(cmap, norm))


def flat_layer(is_drawn: np.ndarray, colour: str) -> DrawnMap:
    """Return the cells of a mask as a layer of one colour."""
    return classes_layer(np.where(is_drawn, np.int8(0), np.int8(-1)), [colour])


def _orient(panel: Axes) -> None:
    """Draw a north arrow, and a scale bar of at most 0.3 of the panel's width: 1, 2 or 5 x 10^k metres long."""
    low_m, high_m = panel.get_xlim()
    most_m = 0.3 * (high_m - low_m)
    power_m = 10.0 ** math.floor(math.log10(most_m))
    lengths_m = (power_m, 2 * power_m, 5 * power_m)
    length_m = max(each_m for each_m in lengths_m if each_m <= most_m)
    name = f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"

    thick_m = 0.006 * (high_m - low_m)
    scale = AnchoredSizeBar(
        panel.transData,
        length_m,
        name,
        "lower left",
        sep=2,
        label_top=True,
        color=INK,
        size_vertical=thick_m,
        pad=0.25,
        frameon=False,
    )
    letters = {"color": INK, "ha": "center", "linespacing": 0.9}
    north = AnchoredText(NORTH, "upper right", prop=letters, pad=0.15, frameon=False)
    for mark in (scale, north):
        mark.borderpad = 0.3
        mark.set_zorder(15)
        panel.add_artist(mark)
        for part in mark.findobj():
            # Letters stand on one white patch, which over black and over scattered roofs a thin edge is not.
            part.set_path_effects([withStroke(linewidth=6.0, foreground="white")])


def frame_note(
    maps: MetricMaps, time: str | None = None, *, has_sky: bool = True, of: str | None = None
) -> str:
    """Return the lines below a figure's heading: caveats and guesses, if any; the sky, cells, CRS, place, credit.

    Args:
      maps: that the figure shows.
      time: UTC time of the GPS maps; None: all times of the series.
      has_sky: whether the figure shows something of GPS; without it neither the sky nor its guesses nor caveats are
        named.
      of: name of the map that is shown alone; None: caveats are those of all metrics.
    """
    sky = sky_said(maps, time) if has_sky else ""
    caveats = caveats_said(maps, of) if has_sky else []
    guesses = guesses_said(maps, has_sky)
    guessed = f"{GUESSED}{guesses}" if guesses else ""
    ground = ground_said(maps.grid, maps.attribution)
    return joined(*caveats, guessed, joined(sky, *ground), by="\n")


def rules_said(*settings: Mapping[str, Any]) -> str:
    """Return a line that says what routes were planned under: cost model, weights, obstacles and clearances.

    Where routes differ in one of these, the first `MOST_RULES` are named, and dots stand for others.

    Args:
      settings: of each route (`PlannedPath.settings`); without any the line is empty.
    """
    rules: dict[str, list[str]] = {"cost model": [], "weights": [], "obstacles": []}
    for route in settings:
        weights = ", ".join(f"{name} {weight:.3g}" for name, weight in route["weights"].items())
        if route["objective"] == "distance":
            weights = "the distance alone"
        limits = route["limits"]
        kept = describe_kept(limits, route["resolution_m"])
        obstacles = joined(route["obstacles"], *describe_clearances(limits), kept, by=", ")
        rules["cost model"].append(route["cost_model"])
        rules["weights"].append(weights)
        rules["obstacles"].append(obstacles)

    # A fact for each rule, with the different values of the routes.
    facts = []
    for name, values in rules.items():
        different = list(dict.fromkeys(values))
        fact = " or ".join(different[:MOST_RULES])
        if len(different) > MOST_RULES:
            fact += " ..."
        if fact:
            facts.append(f"{name}: {fact}")
    return joined(*facts)


def caveats_said(maps: MetricMaps, of: str | None) -> list[str]:
    """Return what a reader must know of a map, a sentence each.

    Args:
      maps: that hold it.
      of: its name; None: all metrics of the maps.
    """
    variables = [maps.variable(name) for name in ([of] if of else maps.metrics)]
    caveats = [maps.ds[name].attrs.get(CAVEAT) for name in variables if name in maps.ds]
    return list(dict.fromkeys(filter(None, caveats)))


def guesses_said(maps: MetricMaps, has_sky: bool) -> str:
    """Return the names of what maps rest on that no file says; those of satellites where the figure shows GPS."""
    return names_of(each for each in maps.guesses if has_sky or each.kind not in OF_SKY)


def ground_said(grid: Grid, credit: str) -> tuple[str, ...]:
    """Return the size of a cell, the CRS, where on Earth maps lie, and whom to credit."""
    return f"{grid.resolution_m:g} m cells", crs_said(grid.crs), place_said(grid), credit


def joined(*facts: str | None, by: str = GAP) -> str:
    """Return facts with ``by`` between them, without those that are empty or None."""
    return by.join(filter(None, facts))


def place_said(grid: Grid) -> str:
    """Return where on Earth a grid lies: its centre, to about 100 m."""
    lon, lat = grid.centre_lonlat
    return f"around {abs(lat):.3f}°{'N' if lat >= 0 else 'S'} {abs(lon):.3f}°{'E' if lon >= 0 else 'W'}"


def symbol_of(name: str) -> str:
    """Return m with the name of a metric below it, as Matplotlib writes mathematics."""
    written = name.replace("_", "\\_")  # else what follows would be a subscript of its own
    return f"$m_\\mathrm{{{written}}}$"


def availability_threshold(maps: MetricMaps) -> float:
    """Return the m_gps above which a position counts as available: that of the maps, or what it is if not set."""
    return float(maps.ds.attrs.get("gps_availability_threshold", Gps().availability_threshold))


def meaning_of(maps: MetricMaps, name: str, said: str = "") -> str:
    """Return what a value of one means on a map, with the maps' own numbers in place of names.

    Args:
      maps: that hold it, with their settings as attributes.
      name: of a metric or a variable.
      said: the meaning where the maps do not give one.
    """
    attrs = maps.ds.attrs
    variable = maps.variable(name)
    meaning = said
    if variable in maps.ds:
        meaning = str(maps.ds[variable].attrs.get("one_means", said))

    # "the threshold": metres of a metric such as risk, or the m above which a position counts as available.
    threshold_m = attrs.get(f"{variable}_threshold_m")
    if threshold_m is not None:
        meaning = meaning.replace("the threshold", f"{threshold_m:g} m")
    elif variable.endswith("_availability"):
        meaning = meaning.replace("the threshold", f"{availability_threshold(maps):g}")

    # Names of attributes: alert limits in metres, and what population is divided by, by time of day.
    for limit in re.findall(r"\w+_limit_m", meaning):
        meaning = meaning.replace(limit, f"{attrs[limit]:g} m")
    for norm, unit in (("pop_norm_per_km2", " per km²"), ("pop_norm_per_block", "")):
        if norm in attrs:
            numbers = " and ".join(f"{number:,.0f}" for number in dict.fromkeys(attrs[norm]))
            meaning = meaning.replace(f"({norm})", f"({numbers}{unit})")
    return meaning


def sky_said(maps: MetricMaps, time: str | None) -> str:
    """Return the time of GPS maps and their constellations, on one line.

    Args:
      maps: that hold GPS; those of a long series have no single time, and all of its times are named.
      time: UTC, as the maps have it; None: the first and the last of all times.
    """
    times = maps.times if time is None or maps.default_time is None else (time,)
    span = time_said(times[0])
    if len(times) > 1:
        span = f"{len(times)} epochs, {span} to {time_said(times[-1])}"
    systems = " and ".join(name.upper() for name in names_in(maps.ds.attrs, "constellations"))
    return joined(span, systems, by=", ")
