"""Pictures of the metric maps, by altitude or time of day."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Unpack

import matplotlib
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure

from jaxurban.checks import one_of
from jaxurban.draw.frame import (
    CLOSED,
    NO_DATA_PATCH,
    OBSTACLE_COLOUR,
    DrawnMap,
    LegendEntry,
    MapPanel,
    availability_threshold,
    classes_layer,
    draw_maps,
    flat_layer,
    frame_note,
    joined,
    meaning_of,
    symbol_of,
    varied,
)
from jaxurban.draw.routes import (
    DrawnPath,
    Paths,
    check_over,
    draw_paths,
    named_paths,
    path_entries,
    planner_colours,
)
from jaxurban.draw.style import Colours, drawing, ends_of
from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, Variable
from jaxurban.metrics.custom import colour_of, held_variables, is_of_sky
from jaxurban.metrics.gps import RATING_UPPER_GDOP, Rating, rating
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.variables import (
    BUILT_COLOUR,
    FREE_COLOUR,
    GROUP_COLOURS,
    GROUP_NUMBERS,
    ROOF_KIND,
    derived,
    stored_name,
)
from jaxurban.paths.closed import obstacles_at
from jaxurban.pictures import MapForm

NO_FREE_CELL = "no free cell"
NO_VALUE_PATCH = ("no value", NO_DATA_PATCH[1])
AVAILABILITY, RATED = "gps_availability", "gdop"
DISTANCE_COLOUR = "#555555"
# Behind what a colour bar names; others as they are.
UNITS = {"": "", "1": "", "km-2": "", "m": " in metres"}
EMPTY_COLOUR = "#ffffff"
Altitudes = float | Sequence[float] | None


def obstacle_patches(
    maps: MetricMaps, colour: str = OBSTACLE_COLOUR, panels: Sequence[MapPanel] = ()
) -> list[Any]:
    """Return the legend entries of obstacle cells and, where there are any, of cells without data and closed ones.

    Args:
      maps: of the picture.
      colour: of obstacles.
      panels: of the picture, where they may hatch closed cells.
    """
    patches: list[Any] = [("obstacle", colour)]
    if not maps.ds["has_data"].values.all():
        patches.append(NO_DATA_PATCH)
    if any(panel.is_closed.any() for panel in panels):
        patches.append(CLOSED)
    return patches


def obstacle_layer(maps: MetricMaps, altitude_m: float, colour: str = OBSTACLE_COLOUR) -> DrawnMap:
    """Return a layer of the obstacle cells at an altitude, which may lie between two altitudes of the maps."""
    return flat_layer(obstacles_at(maps, altitude_m), colour)


def class_patches(variable: Variable, numbers: np.ndarray) -> list[tuple[str, str]]:
    """Return the legend entries of a variable's classes; of more than two, those that occur, by their colours.

    Args:
      variable: whose classes they are.
      numbers: ``[Y, X]`` the class of each cell; NaN is none.
    """
    if len(variable.classes) <= 2:
        return list(variable.classes)
    by_colour: dict[str, str] = {}
    for number in np.unique(numbers[np.isfinite(numbers)]).astype(int):
        name, colour = variable.classes[number]
        by_colour[colour] = joined(by_colour.get(colour), name, by=", ")
    return [(names, colour) for colour, names in by_colour.items()]


def line_colour(name: str) -> str:
    """Return the colour of a weight's lines: that of its metric, grey for the distance."""
    return DISTANCE_COLOUR if name == "distance" else colour_of(name)


def drawn_variables(maps: MetricMaps) -> dict[str, Variable]:
    """Return the variables that `plot_metric` draws, by the name that a user gives.

    Obstacles and metrics come first, then all other variables of the maps. Of a long series a metric's name stands for
    its median. With several times there is also how often GPS is available, even where the maps do not hold that.
    """
    others = held_variables(maps.ds)
    drawn = {name: others.pop(maps.variable(name)) for name in ("obstacle", *maps.metrics)}
    others.pop("has_data", None)
    drawn |= others
    if len(maps.times) > 1 and "gps" in drawn:
        drawn.setdefault(AVAILABILITY, derived(METRICS["gps"])["series"][AVAILABILITY])
    return drawn


def metric_colours(maps: MetricMaps, name: str, values: np.ndarray | None = None) -> Colours:
    """Return the colours of a map, the same in every figure.

    Args:
      maps: that hold it.
      name: one of the names of `drawn_variables`.
      values: all values of the variable, for a caller that has read them; None: they are read if they are needed.
    """
    variable = drawn_variables(maps)[name]

    def read() -> np.ndarray:
        return maps.ds[variable.name].values if values is None else values

    return colours_of(variable, read, bar_label(maps, name, variable), maps.ds.attrs)


def bar_label(maps: MetricMaps, name: str, variable: Variable) -> str:
    """Return the label of the colour bar of a map: what the map shows, or what a value of one means.

    Args:
      maps: that hold it.
      name: one of the names of `drawn_variables`.
      variable: that of this name.
    """
    meaning = meaning_of(maps, variable.name, variable.one_means)
    if name in maps.metrics:
        label = symbol_of(name) if variable.name == name else f"{symbol_of(name)}, median"
        return f"{label}\n(1: {meaning})" if meaning else label
    if meaning:
        return f"1: {meaning}"
    unit = UNITS.get(variable.unit, f" in {variable.unit}")
    label = f"{variable.symbol or variable.title or variable.long_name}{unit}"
    if not variable.scale.is_better_low:
        return label
    limit = ""
    if variable.scale.limit:
        limit = f";\nalert limit {maps.ds.attrs[variable.scale.limit]:g} m"
    return f"{label} (lower is better{limit})"


def colours_of(
    variable: Variable,
    read: Callable[[], np.ndarray],
    label: str = "",
    attrs: Mapping[str, Any] | None = None,
) -> Colours:
    """Return the colours of a variable's values.

    Args:
      variable: its classes have a colour each; without classes its scale decides.
      read: returns the values; it is called only where they decide the ends of the scale.
      label: of the colour bar.
      attrs: attributes of the maps, which may hold a limit for the scale.
    """
    # Classes have a colour each, in place of a scale.
    scale = variable.scale
    ticks = None
    if variable.classes:
        colours = ListedColormap([colour for _, colour in variable.classes])
        edges = np.arange(colours.N + 1) - 0.5
        return Colours(colours, BoundaryNorm(edges, colours.N), label, ticks=())

    # The ends of the scale, with ticks at whole numbers for counts, and how it is stretched.
    low, span = scale.range(attrs or {}, lambda: ends_of(read()))
    high = low + span
    if np.issubdtype(variable.dtype, np.integer):
        step = int(high) // 5 or 1
        ticks = range(0, int(high) + 1, step)
    if scale.stretch == "log":
        return Colours(scale.colour_map, LogNorm(high / 1000, high), label, extend="min")
    if scale.stretch == "sqrt":
        return Colours(scale.colour_map, PowerNorm(0.5, low, high), label)

    # Where low values are sought, high ones may lie beyond the scale's end.
    open_end = "max" if scale.is_better_low else "neither"
    return Colours(scale.colour_map, Normalize(low, high), label, open_end, ticks)


def values_of(
    maps: MetricMaps, name: str, altitude_m: float, time: str | None = None
) -> np.ndarray:
    """Return a map ``[y, x]`` by its name among `drawn_variables`.

    The availability of GPS is computed here from the maps of all times, unless the maps hold it, as of a long series.

    Args:
      maps: that hold the map.
      name: of the map.
      altitude_m: one of the maps' altitudes.
      time: UTC time of a map that has times; None: the first.
    """
    if name == AVAILABILITY and name not in maps.ds:
        threshold = availability_threshold(maps)
        is_good = [maps.m("gps", altitude_m, time=each) > threshold for each in maps.times]
        return np.mean(is_good, axis=0)
    return maps.m(name, altitude_m, time=time)


def free_layer(maps: MetricMaps, name: str, altitude_m: float, time: str | None) -> DrawnMap:
    """Return a layer of a map at one altitude: free cells only, values cut at the upper end of their scale."""
    colours = metric_colours(maps, name)
    values = values_of(maps, name, altitude_m, time).astype(np.float32)
    values = np.minimum(values, np.float32(colours.norm.vmax))
    is_free = maps.is_free(altitude_m, "centre")
    return DrawnMap(np.where(is_free, values, np.float32(np.nan)), colours)


def altitudes_of(maps: MetricMaps, altitude_m: Altitudes) -> Sequence[float]:
    """Return the altitudes that a figure shows: one, several, or all of the maps where none is named."""
    if altitude_m is None:
        return maps.altitudes_m
    return np.atleast_1d(np.asarray(altitude_m, float)).tolist() or maps.altitudes_m


@drawing
def plot_metric(
    maps: MapsLike,
    name: str,
    *,
    altitude_m: Altitudes = None,
    time: str | None = None,
    time_of_day: str | None = None,
    paths: Paths = (),
    **form: Unpack[MapForm],
) -> Figure:
    """Return panels of one metric (of the cost, a user's own too, a DOP or num_visible), all on one scale.

    Of several altitudes, one at which the map is the same everywhere has no panel, and the note says which.

    Args:
      maps: from `build_maps` or `open_maps`.
      name: which metric.
      altitude_m: which altitude, or which ones; left out, those of the paths, or all where there is none.
      time: UTC time of the GPS maps; the first if left out.
      time_of_day: of the population maps; all of them, a panel each, if left out.
      paths: one, several, a batch, or a dictionary by name, each drawn on the map of its altitude.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: a name, altitude, time or time of day that these maps do not hold, a map without a value in any free
        cell, a width that is none, or paths of which none is at an altitude that is drawn.

    Examples:
      >>> figure = ju.plot.plot_metric(maps, "gps", altitude_m=[20.0, 60.0], cmap="cividis")
      >>> own = figure.axes[0].plot(*path.xy_m.T)  # axes are in metres, as routes are
      >>> ju.plot.plot_metric(maps, "gps", paths={"cheapest": path}).savefig("gps.png")
    """
    maps = as_maps(maps)
    variables = drawn_variables(maps)
    name = name if name in variables else stored_name(name, maps.ds)
    variable = variables[one_of("a map to draw from these maps", name, variables)]
    if name == "obstacle":
        return plot_obstacles(maps, altitude_m=altitude_m, paths=paths, **form)
    named = named_paths(paths, None)
    colours = metric_colours(maps, name)
    patches = obstacle_patches(maps)
    has_sky = is_of_sky(maps.ds, variable)

    # A map with altitudes has a panel for each of them, in which its mean stands.
    if ALTITUDE in variable.dims:
        time = (time or maps.times[0]) if TIME in variable.dims else None
        panels = [
            _panel(maps, name, variable, f"{z:g} m", z, time)
            for z in _altitudes_drawn(maps, altitude_m, named)
        ]
        heading = variable.heading
        if variable.name not in maps.ds:  # computed here, from the maps of all times
            heading += f" over {len(maps.times)} epochs"
        heading += ", by altitude above ground"
        panels, note = varied(panels, frame_note(maps, time, has_sky=has_sky, of=name))

    # A map without altitudes has no obstacles, and a panel for each time of day if it varies with that. One of heights
    # from which GPS is good says over which share of the area each altitude is high enough.
    else:
        time = (time or maps.times[0]) if TIME in variable.dims else None
        times_of_day: Sequence[str | None] = (None,)
        if TIME_OF_DAY in variable.dims:
            times_of_day = maps.times_of_day if time_of_day is None else (time_of_day,)
        panels = []
        for day in times_of_day:
            values = maps.m(name, time=time, time_of_day=day)
            title = _enough_of(values, maps.altitudes_m) if has_sky else day or ""
            # Where no height suffices it is infinite, which is drawn as the highest.
            drawn = np.minimum(values, np.float32(colours.norm.vmax)) if has_sky else values
            panels.append(MapPanel(title, [DrawnMap(drawn, colours)]))
        heading = variable.heading
        if has_sky:
            heading += f": {maps.ds[name].attrs['long_name']}"
        note = frame_note(maps, time, has_sky=has_sky, of=name)
        patches = patches[1:]  # all but obstacles
        is_known = maps.ds["has_data"].values
        if any(np.isnan(panel.layers[0].values[is_known]).any() for panel in panels):
            patches = [NO_VALUE_PATCH]

    _check_has_values(name, panels)

    # The legend of classes, whose second one means a value of one, or a colour bar.
    numbers = maps.m(name) if len(variable.classes) > 2 else np.empty(0)
    classes = class_patches(variable, numbers)
    meaning = meaning_of(maps, name, variable.one_means)
    if classes and meaning:
        positive, colour = classes[1]
        classes[1] = f"{positive}\n({meaning})", colour
    legend, bar = [*classes, *patches], None if classes else colours
    return _with_routes(maps, panels, heading, note, named, legend=legend, colours=bar, **form)


@drawing
def plot_epochs(
    maps: MapsLike, name: str = "gps", *, altitude_m: float | None = None, **form: Unpack[MapForm]
) -> Figure:
    """Return panels of one map at every time that these maps hold, at one altitude and all on one scale.

    Args:
      maps: from `build_maps` or `open_maps`.
      name: which map: gps, a DOP or num_visible.
      altitude_m: at which altitude; the lowest if left out.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: a map that has no times or no altitudes, or an altitude that these maps do not hold.

    Examples:
      >>> times = "2020-04-27T16:00:00Z", "2020-04-27T18:00:00Z"
      >>> series = ju.build_maps(city, grid=maps.grid, altitudes_m=(20.0,), gps=ju.Gps(times=times))
      >>> ju.plot.plot_epochs(series, "gps", title="GPS").savefig("epochs.png")
    """
    maps = as_maps(maps)
    z = min(maps.altitudes_m) if altitude_m is None else altitude_m
    variables = drawn_variables(maps)
    timed = [each for each in variables if {TIME, ALTITUDE} <= {*variables[each].dims}]
    variable = variables[one_of("a map of each time", name, timed)]
    panels = [
        _panel(maps, name, variable, time[5:16].replace("T", " "), z, time) for time in maps.times
    ]
    heading = f"{variable.heading} at each epoch, {z:g} m above ground"
    note = frame_note(maps, of=name)
    legend = obstacle_patches(maps)
    colours = metric_colours(maps, name)
    return draw_maps(maps.grid, panels, heading, note, legend=legend, colours=colours, **form)[0]


def _panel(
    maps: MetricMaps, name: str, variable: Variable, what: str, altitude_m: float, time: str | None
) -> MapPanel:
    """Return the panel of a map at an altitude and a time: free cells in colours, obstacles over them.

    Args:
      maps: that hold the map.
      name: one of the names of `drawn_variables`.
      variable: that of this name.
      what: the beginning of the title, such as ``"60 m"``; the mean of the map follows.
      altitude_m: of the panel.
      time: UTC time of a map that has times, else None.
    """
    layers = [free_layer(maps, name, altitude_m, time), obstacle_layer(maps, altitude_m)]
    values = values_of(maps, name, altitude_m, time)[maps.is_free(altitude_m, "centre")]
    return MapPanel(f"{what}  ·  {_middle_of(values, variable)}", layers, altitude_m=altitude_m)


def _middle_of(values: np.ndarray, variable: Variable) -> str:
    """Return the mean of a map's values over its free cells that have one as a text, with its unit.

    Of two classes it is the share of the second one; of counts, and of values that may be infinite, the median.
    """
    unit = "" if variable.unit == "1" else f" {variable.unit}"
    if values.size == 0:
        return NO_FREE_CELL
    values = values[~np.isnan(values)]
    if values.size == 0:
        return "no value"
    if variable.classes:
        return f"{precise_percent(values.mean(dtype=np.float64))} {variable.classes[1][0]}"
    if np.issubdtype(variable.dtype, np.integer) or not variable.is_averaged:
        median = np.quantile(values, 0.5, method="higher")
        if not np.isfinite(median):
            return "undetermined in most free cells"
        return f"median {median:.3g}{unit}"
    num_decimals = 0 if unit else 2
    return f"mean {values.mean(dtype=np.float64):.{num_decimals}f}{unit}"


def _check_has_values(name: str, panels: Sequence[MapPanel]) -> None:
    """Raise InputError where a map would be drawn without a value in any cell."""
    drawn = [panel.layers[0].values for panel in panels if NO_FREE_CELL not in panel.title]
    if drawn and all(np.isnan(values).all() for values in drawn):
        raise InputError(
            f"{name} has no value in any free cell of these maps, so its picture would be empty: check its source, "
            "or name another altitude_m, time or time_of_day"
        )


def _enough_of(values_m: np.ndarray, altitudes_m: Sequence[float]) -> str:
    """Return over which share of the cells with data each altitude is at or above a height, as a text."""
    known_m = values_m[~np.isnan(values_m)]
    shares = [
        f"at {z_m:g} m over {precise_percent(np.mean(known_m <= z_m))}"
        for z_m in sorted(altitudes_m)
    ]
    return (
        f"good GPS: {', '.join(shares)} of the area, roofs included" if known_m.size else "no data"
    )


@drawing
def plot_obstacles(
    maps: MapsLike, *, altitude_m: Altitudes = None, paths: Paths = (), **form: Unpack[MapForm]
) -> Figure:
    """Return panels of free and obstacle cells by altitude; titles give the share of obstacles.

    Args:
      maps: from `build_maps` or `open_maps`.
      altitude_m: which altitude, or which ones; left out, those of the paths, or all where there is none.
      paths: as in `plot_metric`.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: an altitude that these maps do not hold, or paths of which none is at one that is drawn.

    Examples:
      >>> ju.plot.plot_obstacles(maps, altitude_m=20.0).savefig("obstacles.png")
    """
    maps = as_maps(maps)
    has_data = maps.ds["has_data"].values
    named = named_paths(paths, None)
    panels = []
    group = group_numbers(maps)
    numbers = set[int]()
    for z in _altitudes_drawn(maps, altitude_m, named):
        share = "no data"
        if has_data.any():
            share = f"{precise_percent(maps.m('obstacle', z)[has_data].mean())} blocked"
        drawn = np.where(obstacle_layer(maps, z).values == 0, group, -1)
        numbers.update(np.unique(drawn).tolist())
        obstacles = classes_layer(drawn, [*GROUP_COLOURS.values()])
        layers = [flat_layer(has_data, FREE_COLOUR), obstacles]
        panels.append(MapPanel(f"{z:g} m  ·  {share}", layers, altitude_m=z))

    # The groups that are drawn; buildings alone are obstacles.
    patches = obstacle_patches(maps, BUILT_COLOUR)
    numbers.discard(-1)
    if any(numbers):
        entries = list(GROUP_COLOURS.items())
        patches[:1] = [entries[number] for number in sorted(numbers)]
    legend = [("free", FREE_COLOUR), *patches]
    heading = "Obstacles, by altitude above ground"
    panels, note = varied(panels, frame_note(maps, has_sky=False))
    return _with_routes(maps, panels, heading, note, named, legend=legend, **form)


def _altitudes_drawn(
    maps: MetricMaps, altitude_m: Altitudes, named: Sequence[DrawnPath]
) -> Sequence[float]:
    """Return the altitudes that a figure shows: those named, or of its paths, or else all of the maps."""
    if altitude_m is None:
        altitude_m = sorted({each.path.altitude_m for each in named})
    return altitudes_of(maps, altitude_m)


def _with_routes(
    maps: MetricMaps,
    panels: Sequence[MapPanel],
    heading: str,
    note: str,
    named: Sequence[DrawnPath],
    *,
    legend: Sequence[LegendEntry],
    colours: Colours | None = None,
    **form: Unpack[MapForm],
) -> Figure:
    """Return a figure of maps with the routes that were planned at the altitude of each; a map without one has all.

    Args:
      maps: on whose grid the panels lie.
      panels, heading, note, legend, colours, form: see `draw_maps`.
      named: the routes with what they are called.

    Raises:
      InputError: routes of which none is at an altitude of the panels, or one that lies nowhere over the maps.
    """
    check_over(maps.grid, [each.path for each in named])
    drawn = [
        [each for each in named if panel.altitude_m in (None, each.path.altitude_m)]
        for panel in panels
    ]
    if named and not any(drawn):
        heights = ", ".join(f"{z:g}" for z in sorted({each.path.altitude_m for each in named}))
        raise InputError(f"no path is at an altitude that is drawn: they are at {heights} m")
    tones = planner_colours(each.name for each in named)
    paths_at = [[each.path for each in here] for here in drawn]
    legend = [*legend, *path_entries(tones, *paths_at)]
    figure, axes = draw_maps(
        maps.grid, panels, heading, note, legend=legend, colours=colours, **form
    )
    for panel, here, shown in zip(axes, drawn, paths_at, strict=True):
        draw_paths(panel, shown, [tones[each.name] for each in here])
    return figure


def group_numbers(maps: MetricMaps) -> np.ndarray:
    """Return ``[Y, X]`` the number, in `GROUP_COLOURS`, of the highest thing's group; without kinds 0, no array."""
    return np.array([0, *GROUP_NUMBERS.values()])[np.asarray(maps.ds.get(ROOF_KIND, 0))]


def precise_percent(share: float) -> str:
    """Return a share (0 to 1) as a percentage: whole, but with one decimal below 10 % and above 90 %.

    ``0 %`` and ``100 %`` stand only where they are exact; else it says ``< 0.1 %`` or ``> 99.9 %``.
    """
    if 0 < share < 0.0005:
        return "< 0.1 %"
    if 0.9995 <= share < 1:
        return "> 99.9 %"
    has_decimal = 0 < share < 0.0995 or 0.9005 <= share < 1  # else it would be rounded to 10 or 90
    return f"{100 * share:.1f} %" if has_decimal else f"{100 * share:.0f} %"


def _class_figure(
    maps: MetricMaps,
    numbers_at: Mapping[float, np.ndarray],
    classes: Sequence[tuple[str, str]],
    last: int,
    of_share: str,
    heading: str,
    time: str | None,
    **form: Unpack[MapForm],
) -> Figure:
    """Return panels of the class of each free cell by altitude, with obstacles over them.

    Args:
      maps: with the altitudes.
      numbers_at: ``[Y, X]`` class of each cell, from 0, by altitude.
      classes: name and colour of each class, in the order of their numbers.
      last: the titles give the share of free cells whose class is this one or an earlier one; 0 without free cells.
      of_share: what the titles say: ``{}`` in it stands for that share, and the altitude before it.
      heading: of the figure; ``by altitude above ground`` follows.
      time: UTC time of the GPS maps.
      form: of the figure.
    """
    panels = []
    for z, numbers in numbers_at.items():
        is_free = maps.is_free(z, "centre")
        share = (numbers[is_free] <= last).mean() if is_free.any() else 0.0
        drawn = classes_layer(np.where(is_free, numbers, -1), [colour for _, colour in classes])
        text = f"{z:g} m  ·  {of_share.format(precise_percent(share))}"
        panels.append(MapPanel(text, [drawn, obstacle_layer(maps, z)]))
    heading += ", by altitude above ground"
    panels, note = varied(panels, frame_note(maps, time))
    legend = [*classes, *obstacle_patches(maps)]
    return draw_maps(maps.grid, panels, heading, note, legend=legend, **form)[0]


@drawing
def plot_gps_rating(
    maps: MapsLike,
    *,
    altitude_m: Altitudes = None,
    time: str | None = None,
    **form: Unpack[MapForm],
) -> Figure:
    """Return panels of the paper's GPS rating by altitude; titles give the share of free cells rated good or better.

    Args:
      maps: from `build_maps` or `open_maps`.
      altitude_m: which altitude, or which ones; all if left out.
      time: UTC time of the GPS maps; the first if left out.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: an altitude or time that these maps do not hold.

    Examples:
      >>> ju.plot.plot_gps_rating(maps, altitude_m=20.0).savefig("rating.png")
    """
    maps = as_maps(maps)
    time = time or maps.times[0]

    # A class per rating, the best first, with its range of GDOP and a colour of the metric.
    colours = matplotlib.colormaps[METRICS["gps"].colour_map](np.linspace(1, 0, len(Rating)))
    ranges = [f"up to {high:g}" for high in RATING_UPPER_GDOP]
    ranges.append(f"above {RATING_UPPER_GDOP[-1]:g}")
    classes = []
    for item, dops, colour in zip(Rating, ranges, colours, strict=True):
        name = f"{item.name.capitalize()}\n(GDOP {dops})"
        classes.append((name, matplotlib.colors.to_hex(colour)))

    ratings = {
        z: np.asarray(rating(maps.m(RATED, z, time=time))).astype(int)
        for z in altitudes_of(maps, altitude_m)
    }
    of_share = "{} good or better"
    return _class_figure(maps, ratings, classes, Rating.GOOD, of_share, "GPS rating", time, **form)


@drawing
def plot_sensor_choice(
    maps: MapsLike,
    *,
    altitude_m: Altitudes = None,
    time: str | None = None,
    **form: Unpack[MapForm],
) -> Figure:
    """Return panels of the better sensor by altitude: GPS where m_gps > m_lidar, else lidar.

    Args:
      maps: from `build_maps` or `open_maps`.
      altitude_m: which altitude, or which ones; all if left out.
      time: UTC time of the GPS maps; the first if left out.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: an altitude or time that these maps do not hold.

    Examples:
      >>> ju.plot.plot_sensor_choice(maps).savefig("sensors.png")
    """
    maps = as_maps(maps)
    time = time or maps.default_time
    classes = [
        ("GPS\n($m_\\mathrm{gps}$ > $m_\\mathrm{lidar}$)", METRICS["gps"].colour),
        ("lidar\n(otherwise)", METRICS["lidar"].colour),
    ]
    sensors = {
        z: np.where(maps.prefers_gps(z, time=time), 0, 1) for z in altitudes_of(maps, altitude_m)
    }
    heading = "The better sensor"
    return _class_figure(maps, sensors, classes, 0, "GPS in {}", heading, time, **form)


@drawing
def plot_population(maps: MapsLike, **form: Unpack[MapForm]) -> Figure:
    """Return panels of people per km2 by time of day, on one logarithmic scale; titles give the people in the region.

    Args:
      maps: from `build_maps` or `open_maps`.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: maps without population.

    Examples:
      >>> ju.plot.plot_population(maps).savefig("people.png")
    """
    maps = as_maps(maps)
    if "density" not in maps.ds:
        raise InputError("these maps hold no population: make them with [population] blocks")
    cell_km2 = maps.grid.resolution_m**2 / 1e6
    colours = metric_colours(maps, "density")
    panels = []
    for time_of_day in maps.times_of_day:
        per_km2 = maps.m("density", time_of_day=time_of_day)
        num_people = np.nansum(per_km2, dtype=np.float64) * cell_km2
        title = f"{time_of_day}  ·  {num_people:,.0f} people"
        panels.append(MapPanel(title, layers_above_zero(per_km2, colours)))
    legend = [("no people, or\nno data of them", EMPTY_COLOUR), *obstacle_patches(maps)[1:]]
    heading = "Population density"
    note = frame_note(maps, has_sky=False)
    return draw_maps(maps.grid, panels, heading, note, legend=legend, colours=colours, **form)[0]


def layers_above_zero(values: np.ndarray, colours: Colours) -> list[DrawnMap]:
    """Return the layers of a map on which 0 means nothing, as of people or roofs: such cells are drawn in white.

    Args:
      values: ``[Y, X]`` from 0 up, NaN where none is known.
      colours: of the values above 0.
    """
    return [
        flat_layer(values == 0, EMPTY_COLOUR),
        DrawnMap(np.where(values > 0, values, np.float32(np.nan)), colours),
    ]


def roof_layers(maps: MetricMaps) -> list[DrawnMap]:
    """Return roof heights as they are drawn, white where there is no roof."""
    roof_m = maps.m("roof")
    return layers_above_zero(roof_m, replace(metric_colours(maps, "roof", roof_m), label=""))
