"""Pictures of the metric maps, by altitude or time of day."""

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure

from jaxurban.errors import InputError, one_of
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.metrics.custom import colour_of
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.rating import RATING_UPPER_GDOP, Rating, rating
from jaxurban.metrics.registry import METRICS, find_metric
from jaxurban.report.figures.frame import (
    NO_DATA_PATCH,
    OBSTACLE_COLOUR,
    MapLayer,
    add_bar_below,
    add_key,
    classes_layer,
    draw_hatch,
    draw_layers,
    flat_layer,
    make_frame,
)
from jaxurban.report.figures.notes import frame_note, meaning_of, short_time, symbol_of
from jaxurban.report.figures.protection import LEVEL_NAMES, median_said, protection_colours
from jaxurban.report.figures.protection import NAMES as PROTECTION_NAMES
from jaxurban.report.figures.style import Colours, ends_of

DOP_NAMES = {
    "gdop": "Geometric dilution of precision (GDOP)",
    "pdop": "Position dilution of precision (PDOP)",
    "hdop": "Horizontal dilution of precision (HDOP)",
    "vdop": "Vertical dilution of precision (VDOP)",
    "tdop": "Time dilution of precision (TDOP)",
}
DOP_NAMES |= {f"w{name}": f"{label}, weighted by elevation" for name, label in DOP_NAMES.items()}
AVAILABILITY, LOW = "gps_availability", "gps_p05"
SERIES_NAMES = {AVAILABILITY: "GPS availability", LOW: "GPS quality that 5 % of the epochs stay below"}
DOP_COLOUR_MAP, HEIGHT_COLOUR_MAP = "viridis_r", "cividis"
MAX_DOP = 20.0  # where the paper's rating turns poor
DISTANCE_COLOUR = "#555555"
FREE_COLOUR, BUILT_COLOUR = "#f4f4ee", "#4a4a4a"
EMPTY_COLOUR = "#ffffff"
ROOF_TICKS_M = (0, 5, 20, 50, 100, 200, 400, 800)


def obstacle_patches(maps: MetricMaps, colour: str = OBSTACLE_COLOUR) -> list[tuple[str, str]]:
    """Return the legend entries of obstacle cells and, where there are any, of cells without data."""
    return [("obstacle", colour), *([] if maps.ds["has_data"].values.all() else [NO_DATA_PATCH])]


def obstacle_layer(maps: MetricMaps, altitude_m: float, colour: str = OBSTACLE_COLOUR) -> MapLayer:
    """Return the obstacle cells at an altitude, also between those of the maps, as they are drawn."""
    is_held = altitude_m in maps.altitudes_m
    is_blocked = maps.m("obstacle", altitude_m) != 0 if is_held else ~maps.is_free(altitude_m, "centre")
    return flat_layer(is_blocked & maps.ds["has_data"].values, colour)


def line_colour(name: str) -> str:
    """Return the colour of a weight's lines: that of its metric, grey for the distance."""
    return DISTANCE_COLOUR if name == "distance" else colour_of(name)


def drawn_names(maps: MetricMaps) -> dict[str, str]:
    """Return the heading of each map that `plot_metric` draws, of those that these maps hold, by name."""
    known = {"obstacle": "Obstacles", **{name: metric.label for name, metric in maps.metrics.items()}}
    known |= {**DOP_NAMES, "num_visible": "Satellites in view", **SERIES_NAMES, **PROTECTION_NAMES}
    medians = [name for name in maps.metrics if maps.variable(name) != name]
    known |= {name: f"{maps.metrics[name].label}, median over the epochs" for name in medians}
    held = {name: heading for name, heading in known.items() if maps.variable(name) in maps.ds}
    return held | ({AVAILABILITY: SERIES_NAMES[AVAILABILITY]} if len(maps.times) > 1 and "gps" in held else {})


def metric_colours(maps: MetricMaps, name: str) -> Colours:
    """Return how a metric is drawn, the same in every figure.

    Raises:
      InputError: a name that is none of `drawn_names`.
    """
    if name == "num_visible":
        most = max(4, int(maps.ds[name].max()))
        ticks = range(0, most + 1, most // 5 or 1)
        return Colours("viridis", Normalize(0, most), "satellites in view", ticks=ticks)
    if name in DOP_NAMES:
        return Colours(DOP_COLOUR_MAP, Normalize(1, MAX_DOP), f"{name.upper()} (lower is better)", "max")
    if name in PROTECTION_NAMES:
        return protection_colours(maps, name)
    if name == AVAILABILITY:
        label = f"share of epochs with $m_\\mathrm{{gps}}$ > {availability_threshold(maps):g}"
        return Colours(METRICS["gps"].colour_map, Normalize(0, 1), label)
    metric = find_metric("gps" if name == LOW else name, maps.metrics)
    over = ", 5th percentile" if name == LOW else ", median" if maps.variable(name) != name else ""
    one_is = f"\n(1: {meaning})" if (meaning := meaning_of(maps, name)) else ""
    label = f"{symbol_of(metric.name)}{over}{one_is}"
    return Colours(metric.colour_map, Normalize(0, 1), label)


def availability_threshold(maps: MetricMaps) -> float:
    """Return the m_gps above which a position counts as available: that of the maps, or what it is if not set."""
    return float(maps.ds.attrs.get("gps_availability_threshold", Gps().availability_threshold))


def values_of(maps: MetricMaps, name: str, altitude_m: float, time: str | None = None) -> np.ndarray:
    """Return a map ``[y, x]``; the availability of several epochs too, which maps hold of a long series alone."""
    if name == AVAILABILITY and name not in maps.ds:
        threshold = availability_threshold(maps)
        return np.mean([maps.m("gps", altitude_m, time=each) > threshold for each in maps.times], axis=0)
    return maps.m(name, altitude_m, time=time)


def free_layer(maps: MetricMaps, name: str, altitude_m: float, time: str | None = None) -> MapLayer:
    """Return a metric at one altitude as it is drawn: free cells only, DOPs cut at the end of their scale."""
    colours = metric_colours(maps, name)
    values = np.minimum(values_of(maps, name, altitude_m, time).astype(np.float32), np.float32(colours.norm.vmax))
    return MapLayer(np.where(maps.is_free(altitude_m, "centre"), values, np.float32(np.nan)), colours)


def plot_metric(
    maps: GivenMaps,
    name: str,
    *,
    altitudes_m: Sequence[float] | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
) -> Figure:
    """Return panels of one metric (of the cost, one's own too, a DOP or num_visible), all on one scale.

    Args:
      maps: from `build_maps` or `open_maps`.
      name: which metric.
      altitudes_m: which altitudes; all if left out.
      time: UTC time of the GPS maps; the first if left out.
      time_of_day: of the population maps; all of them, a panel each, if left out.

    Raises:
      InputError: a name, altitude, time or time of day that these maps do not hold.
    """
    maps = as_maps(maps)
    headings = drawn_names(maps)
    one_of("a map to draw from these maps", name, headings)
    if name == "obstacle":
        return plot_obstacles(maps, altitudes_m=altitudes_m)
    colours = metric_colours(maps, name)
    is_of_all = name == AVAILABILITY and name not in maps.ds
    dims = (ALTITUDE,) if is_of_all else maps.ds[maps.variable(name)].dims
    if ALTITUDE not in dims:
        times_of_day = maps.times_of_day if time_of_day is None else (time_of_day,)
        items = times_of_day if TIME_OF_DAY in dims else (None,)
        panels = [(item or "", [MapLayer(maps.m(name, time_of_day=item), colours)]) for item in items]
        return _figure(maps, headings[name], panels, obstacle_patches(maps)[1:], colours=colours, has_sky=False)
    time = (time or maps.times[0]) if TIME in dims else None
    has_sky = TIME in dims or maps.variable(name) != name or name in {**SERIES_NAMES, **PROTECTION_NAMES}
    panels = [
        (f"{z:g} m  ·  {_middle_of(maps, name, z, time)}", [free_layer(maps, name, z, time), obstacle_layer(maps, z)])
        for z in altitudes_m or maps.altitudes_m
    ]
    heading = f"{headings[name]}, by altitude above ground"
    if is_of_all:
        heading = f"{headings[name]} over {len(maps.times)} epochs, by altitude above ground"
    return _figure(
        maps,
        heading,
        panels,
        obstacle_patches(maps),
        time=time,
        colours=colours,
        has_sky=has_sky,
        is_median=name not in {**SERIES_NAMES, **PROTECTION_NAMES},
        of=name,
    )


def plot_epochs(maps: GivenMaps, name: str = "gps", *, altitude_m: float | None = None) -> Figure:
    """Return panels of one map at every time that these maps hold, at one altitude and all on one scale.

    Args:
      maps: from `build_maps` or `open_maps`.
      name: which map: gps, a DOP or num_visible.
      altitude_m: at which altitude; the lowest if left out.

    Raises:
      InputError: a map that has no times, or an altitude that these maps do not hold.
    """
    maps = as_maps(maps)
    headings, z = drawn_names(maps), min(maps.altitudes_m) if altitude_m is None else altitude_m
    one_of("a map of each time", name, [each for each in headings if each in maps.ds and TIME in maps.ds[each].dims])
    panels = [
        (
            f"{short_time(time)}  ·  {_middle_of(maps, name, z, time)}",
            [free_layer(maps, name, z, time), obstacle_layer(maps, z)],
        )
        for time in maps.times
    ]
    colours = metric_colours(maps, name)
    heading = f"{headings[name]} at each epoch, {z:g} m above ground"
    return _figure(maps, heading, panels, obstacle_patches(maps), colours=colours, of=name)


def _figure(
    maps: MetricMaps,
    heading: str,
    panels: Sequence[tuple[str, Sequence[MapLayer]]],
    patches: Sequence[tuple[str, str]],
    *,
    time: str | None = None,
    colours: Colours | None = None,
    has_sky: bool = True,
    is_median: bool = True,
    of: str = "gps",
) -> Figure:
    """Return panels of a map (``of``), each a title and its layers, with a key of patches and a colour bar."""
    note = frame_note(maps, time, has_sky=has_sky, is_median=is_median, of=of)
    frame = make_frame(maps.grid, [title for title, _ in panels], heading, note)
    for panel, (_, layers) in zip(frame.axes, panels, strict=True):
        draw_layers(panel, maps.grid, layers)
    add_key(frame, patches, colours)
    return frame.figure


def _middle_of(maps: MetricMaps, name: str, altitude_m: float, time: str | None) -> str:
    """Return the mean over free cells as a text; the median for DOPs and levels, maybe inf, and for satellites."""
    values = values_of(maps, name, altitude_m, time)[maps.is_free(altitude_m, "centre")]
    if values.size == 0:
        return "no free cell"
    if name == "num_visible":
        return f"median {np.quantile(values, 0.5, method='lower'):.0f}"
    if name in DOP_NAMES:
        return f"median {np.median(values):.2f}"
    if name in LEVEL_NAMES:
        return median_said(values)
    return f"mean {values.mean(dtype=np.float64):.2f}"


def plot_obstacles(maps: GivenMaps, *, altitudes_m: Sequence[float] | None = None) -> Figure:
    """Return panels of free and obstacle cells by altitude; titles give the share of obstacles.

    Raises:
      InputError: an altitude that these maps do not hold.
    """
    maps = as_maps(maps)
    has_data = maps.ds["has_data"].values
    panels = [
        (
            f"{z:g} m  ·  "
            + (f"{percent(maps.m('obstacle', z)[has_data].mean())} blocked" if has_data.any() else "no data"),
            [flat_layer(has_data, FREE_COLOUR), obstacle_layer(maps, z, BUILT_COLOUR)],
        )
        for z in altitudes_m or maps.altitudes_m
    ]
    patches = [("free", FREE_COLOUR), *obstacle_patches(maps, BUILT_COLOUR)]
    return _figure(maps, "Obstacles, by altitude above ground", panels, patches, has_sky=False)


def percent(share: float) -> str:
    """Return a share as a percentage, with a decimal near 0 and 1, which it shows only where they are exact."""
    if 0 < share < 0.0005:
        return "< 0.1 %"
    if 0.9995 <= share < 1:
        return "> 99.9 %"
    return f"{100 * share:.1f} %" if 0 < share < 0.0995 or 0.9005 <= share < 1 else f"{100 * share:.0f} %"


def _plot_classes(
    maps: MetricMaps,
    heading: str,
    time: str | None,
    found: Mapping[float, tuple[str, np.ndarray]],
    names: Sequence[tuple[str, str]],
) -> Figure:
    """Return panels (title, class numbers) by altitude over free cells, the classes being (name, colour)."""
    panels = []
    for z, (title, numbers) in found.items():
        shown = np.where(maps.is_free(z, "centre"), numbers.astype(int), -1)
        layers = [classes_layer(shown, [colour for _, colour in names]), obstacle_layer(maps, z)]
        panels.append((f"{z:g} m  ·  {title}", layers))
    heading = f"{heading}, by altitude above ground"
    return _figure(maps, heading, panels, [*names, *obstacle_patches(maps)], time=time)


def plot_gps_rating(maps: GivenMaps, *, altitudes_m: Sequence[float] | None = None, time: str | None = None) -> Figure:
    """Return panels of the paper's GPS rating by altitude; titles give the share of free cells rated good or better.

    Raises:
      InputError: an altitude or time that these maps do not hold.
    """
    maps = as_maps(maps)
    time, found = time or maps.times[0], {}
    for z in altitudes_m or maps.altitudes_m:
        rank = np.asarray(rating(maps.m("gdop", z, time=time)))
        found[z] = f"{percent(_share(rank <= Rating.GOOD, maps, z))} good or better", rank
    steps = matplotlib.colormaps[METRICS["gps"].colour_map](np.linspace(1, 0, len(Rating)))
    ranges = [f"up to {high:g}" for high in RATING_UPPER_GDOP] + [f"above {RATING_UPPER_GDOP[-1]:g}"]
    names = [
        (f"{item.name.capitalize()}\n(GDOP {dop_range})", matplotlib.colors.to_hex(colour))
        for item, dop_range, colour in zip(Rating, ranges, steps, strict=True)
    ]
    return _plot_classes(maps, "GPS rating", time, found, names)


def _share(is_so: np.ndarray, maps: MetricMaps, altitude_m: float) -> float:
    is_free = maps.is_free(altitude_m, "centre")
    return float(is_so[is_free].mean()) if is_free.any() else 0.0


def plot_sensor_choice(
    maps: GivenMaps, *, altitudes_m: Sequence[float] | None = None, time: str | None = None
) -> Figure:
    """Return panels of the better sensor by altitude: GPS where m_gps > m_lidar, else lidar.

    Raises:
      InputError: an altitude or time that these maps do not hold.
    """
    maps = as_maps(maps)
    time, found = time or maps.default_time, {}
    for z in altitudes_m or maps.altitudes_m:
        is_gps = maps.prefers_gps(z, time=time)
        found[z] = f"GPS in {percent(_share(is_gps, maps, z))}", np.where(is_gps, 0, 1)
    names = [
        ("GPS\n($m_\\mathrm{gps}$ > $m_\\mathrm{lidar}$)", METRICS["gps"].colour),
        ("lidar\n(otherwise)", METRICS["lidar"].colour),
    ]
    return _plot_classes(maps, "The better sensor", time, found, names)


def density_colours(highest_per_km2: float) -> Colours:
    """Return the colours of people per km2: three decades up to the highest, zero left white."""
    highest = max(highest_per_km2, 1.0)
    norm = LogNorm(highest / 1000, highest)
    return Colours(METRICS["population"].colour_map, norm, "people per km²", extend="min")


def plot_population(maps: GivenMaps) -> Figure:
    """Return panels of people per km2 by time of day, on one logarithmic scale; titles give the people in the region.

    Raises:
      InputError: maps without population.
    """
    maps = as_maps(maps)
    if "density" not in maps.ds:
        raise InputError("these maps hold no population: give [population] sources in the scenario and make them again")
    cell_km2 = maps.grid.resolution_m**2 / 1e6
    colours = density_colours(ends_of(maps.ds["density"].values)[1])
    panels = []
    for item in maps.times_of_day:
        values = maps.m("density", time_of_day=item)
        title = f"{item}  ·  {np.nansum(values, dtype=np.float64) * cell_km2:,.0f} people"
        panels.append((title, density_layers(values, colours)))
    patches = [("no people\nin the data", EMPTY_COLOUR), *obstacle_patches(maps)[1:]]
    return _figure(maps, "Population density", panels, patches, colours=colours, has_sky=False)


def density_layers(values: np.ndarray, colours: Colours) -> list[MapLayer]:
    """Return people per km2 as they are drawn, cells with nobody in white."""
    return [flat_layer(values == 0, EMPTY_COLOUR), MapLayer(np.where(values > 0, values, np.float32(np.nan)), colours)]


def roof_colours(highest_m: float) -> Colours:
    """Return the colours of roof heights: on a square-root scale."""
    ticks = [tick for tick in ROOF_TICKS_M if tick <= highest_m]
    return Colours(HEIGHT_COLOUR_MAP, PowerNorm(0.5, 0, max(highest_m, 1.0)), ticks=ticks)


def roof_layers(maps: MetricMaps) -> list[MapLayer]:
    """Return roof heights as they are drawn, white where there is no roof."""
    roof_m = maps.m("roof")
    values = np.where(roof_m > 0, roof_m, np.float32(np.nan))
    return [flat_layer(roof_m == 0, EMPTY_COLOUR), MapLayer(values, roof_colours(ends_of(roof_m)[1]))]


def plot_heights(maps: GivenMaps) -> Figure:
    """Return roof heights above ground and, where it is not flat, the terrain's elevation.

    Roofs of guessed height are hatched.
    """
    maps = as_maps(maps)
    roofs = roof_layers(maps)
    titles = [f"roofs above ground, up to {ends_of(maps.m('roof'))[1]:.0f} m"]
    if "terrain" in maps.ds:
        terrain_m = maps.m("terrain")
        low_m, high_m = ends_of(terrain_m)
        titles.append(f"terrain, {low_m:.0f} to {high_m:.0f} m")
        ground = MapLayer(terrain_m, Colours(HEIGHT_COLOUR_MAP, Normalize(low_m, max(high_m, low_m + 1))))
    frame = make_frame(maps.grid, titles, "Heights (m)", frame_note(maps, has_sky=False), footer_in=0.4)
    draw_layers(frame.axes[0], maps.grid, roofs)
    hatched = ""
    if "roof_guessed" in maps.ds:
        is_guessed = maps.m("roof_guessed") & (maps.m("roof") > 0)
        draw_hatch(frame.axes[0], maps.grid, is_guessed)
        hatched = f"height guessed\n({percent(is_guessed.sum() / max((maps.m('roof') > 0).sum(), 1))} of roofs)"
    add_bar_below(frame, frame.axes[0], roofs[1].colours)
    if "terrain" in maps.ds:
        draw_layers(frame.axes[1], maps.grid, [ground])
        add_bar_below(frame, frame.axes[1], ground.colours)
    add_key(frame, [("no building", EMPTY_COLOUR), *obstacle_patches(maps)[1:]], hatched=hatched)
    return frame.figure
