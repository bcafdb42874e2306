"""Pictures of the metric maps, by altitude or time of day."""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.colors import Colormap, LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure

from jaxurban.errors import InputError
from jaxurban.maps import MetricMaps
from jaxurban.metrics.gps import RATING_UPPER_GDOP, Rating, rating
from jaxurban.plotting.frame import (
    NO_DATA_PATCH,
    OBSTACLE_COLOUR,
    Layer,
    add_bar_below,
    add_key,
    classes_layer,
    draw_layers,
    flat_layer,
    make_frame,
)

NAMES = {
    "obstacle": "Obstacles",
    "gps": "GPS quality",
    "lidar": "Lidar quality",
    "population": "Population",
    "risk": "Risk (clearance from obstacles)",
    "gdop": "Geometric dilution of precision (GDOP)",
    "pdop": "Position dilution of precision (PDOP)",
    "hdop": "Horizontal dilution of precision (HDOP)",
    "vdop": "Vertical dilution of precision (VDOP)",
    "tdop": "Time dilution of precision (TDOP)",
    "num_visible": "Satellites in view",
}
# Perceptually uniform, each metric its own.
COLOUR_MAPS = {
    "gps": "viridis",
    "lidar": "plasma",
    "population": "magma_r",
    "risk": "inferno",
    "num_visible": "viridis",
}
DOP_COLOUR_MAP, HEIGHT_COLOUR_MAP = "viridis_r", "cividis"
MAX_DOP = 20.0  # where the paper's rating turns poor
GPS_COLOUR, LIDAR_COLOUR = "#0072b2", "#e69f00"
FREE_COLOUR, BUILT_COLOUR = "#f4f4ee", "#4a4a4a"
EMPTY_COLOUR = "#ffffff"
ROOF_TICKS_M = (0, 5, 20, 50, 100, 200, 400, 800)


def colour_map(name: str) -> Colormap:
    """Return matplotlib's colour map of that name."""
    return matplotlib.colormaps[name]


def frame_note(maps: MetricMaps, time: str | None = None) -> str:
    """Return the second line of a figure: epoch, size of a cell, CRS."""
    epoch = [] if time is None else [f"{time[:10]} {time[11:16]} UTC"]
    if "gps_median" in maps.ds:
        epoch = [f"GPS: median of {len(maps.times)} epochs"]
    credit = [maps.ds.attrs["attribution"]] if "attribution" in maps.ds.attrs else []
    return "  ·  ".join([*epoch, f"{maps.grid.resolution_m:g} m cells", maps.grid.crs, *credit])


def obstacle_patches(maps: MetricMaps, colour: str = OBSTACLE_COLOUR) -> list[tuple[str, str]]:
    """Return the legend entries of obstacle cells and, where there are any, of cells without data."""
    return [("obstacle", colour), *([] if maps.ds["has_data"].values.all() else [NO_DATA_PATCH])]


def obstacle_layer(maps: MetricMaps, altitude_m: float, colour: str = OBSTACLE_COLOUR) -> Layer:
    """Return the obstacle cells at an altitude as they are drawn."""
    return flat_layer((maps.m("obstacle", altitude_m) != 0) & maps.ds["has_data"].values, colour)


@dataclass(frozen=True)
class Style:
    """How a metric is drawn: colours, the ends of its scale, the colour bar's label and open ends."""

    cmap: Colormap
    low: float
    high: float
    label: str
    extend: str = "neither"

    @property
    def scale(self) -> tuple[Colormap, Normalize]:
        """Colour map and norm."""
        return self.cmap, Normalize(self.low, self.high)


def metric_style(maps: MetricMaps, name: str) -> Style:
    """Return how a metric is drawn, the same in every figure."""
    if name == "num_visible":
        return Style(colour_map(COLOUR_MAPS[name]), 0, max(4, int(maps.ds[name].max())), "satellites in view")
    if name not in COLOUR_MAPS:
        return Style(colour_map(DOP_COLOUR_MAP), 1, MAX_DOP, f"{name.upper()} (lower is better)", "max")
    one_means = maps.ds[maps.variable(name)].attrs.get("one_means", "")
    label = f"$m_\\mathrm{{{name}}}$" + (f"\n(1: {one_means})" if one_means else "")
    return Style(colour_map(COLOUR_MAPS[name]), 0, 1, label)


def free_layer(maps: MetricMaps, name: str, altitude_m: float, time: str | None = None) -> Layer:
    """Return a metric at one altitude as it is drawn: free cells only, DOPs cut at the end of their scale."""
    style = metric_style(maps, name)
    values = np.minimum(maps.m(name, altitude_m, time=time).astype(np.float32), np.float32(style.high))
    return Layer(np.where(maps.is_free(altitude_m, "centre"), values, np.float32(np.nan)), *style.scale)


def plot_metric(
    maps: MetricMaps,
    name: str,
    *,
    altitudes_m: Sequence[float] | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
) -> Figure:
    """Return panels of one metric (gps, lidar, risk, population, a DOP or num_visible), all on one scale.

    Args:
      maps: from `build_maps` or `open_maps`.
      name: which metric.
      altitudes_m: which altitudes; all if left out.
      time: epoch of the GPS maps; the first if left out.
      time_of_day: of the population maps; all of them, a panel each, if left out.

    Raises:
      InputError: a name, altitude, time or time of day that these maps do not hold.
    """
    if name not in NAMES or maps.variable(name) not in maps.ds:
        drawn = ", ".join(known for known in NAMES if maps.variable(known) in maps.ds)
        raise InputError(f"{name!r} cannot be drawn from these maps: choose one of {drawn}")
    if name == "obstacle":
        return plot_obstacles(maps, altitudes_m=altitudes_m)
    style = metric_style(maps, name)
    if name == "population":
        times_of_day = maps.times_of_day if time_of_day is None else (time_of_day,)
        frame = make_frame(maps.grid, times_of_day, NAMES[name], frame_note(maps))
        for panel, item in zip(frame.axes, times_of_day, strict=True):
            draw_layers(panel, maps.grid, [Layer(maps.m(name, time_of_day=item), *style.scale)])
        add_key(frame, obstacle_patches(maps)[1:], style.scale, style.label)
        return frame.figure
    shown = maps.altitudes_m if altitudes_m is None else tuple(altitudes_m)
    time = (time or maps.times[0]) if "time" in maps.ds[maps.variable(name)].dims else None
    layers = [free_layer(maps, name, z, time=time) for z in shown]
    titles = [f"{z:g} m  ·  {_middle_of(maps, name, z, time)}" for z in shown]
    frame = make_frame(maps.grid, titles, f"{NAMES[name]}, by altitude above ground", frame_note(maps, time))
    for panel, z, layer in zip(frame.axes, shown, layers, strict=True):
        draw_layers(panel, maps.grid, [layer, obstacle_layer(maps, z)])
    most = style.high if name == "num_visible" else 0
    ticks = range(0, int(most) + 1, max(1, int(most) // 5)) if most else None
    add_key(frame, obstacle_patches(maps), style.scale, style.label, style.extend, ticks)
    return frame.figure


def _middle_of(maps: MetricMaps, name: str, altitude_m: float, time: str | None) -> str:
    """Return the mean over free cells in words; the median for DOPs, which may be inf, and for satellites."""
    values = maps.m(name, altitude_m, time=time)[maps.is_free(altitude_m, "centre")]
    if values.size == 0:
        return "no free cell"
    if name == "num_visible":
        return f"median {np.quantile(values, 0.5, method='lower'):.0f}"
    if name not in COLOUR_MAPS:
        return f"median {np.median(values):.2f}"
    return f"mean {values.mean(dtype=np.float64):.2f}"


def plot_obstacles(maps: MetricMaps, *, altitudes_m: Sequence[float] | None = None) -> Figure:
    """Return panels of free and obstacle cells by altitude; titles give the share of obstacles.

    Raises:
      InputError: an altitude that these maps do not hold.
    """
    shown = maps.altitudes_m if altitudes_m is None else tuple(altitudes_m)
    has_data = maps.ds["has_data"].values
    titles = [f"{z:g} m  ·  {percent(maps.m('obstacle', z)[has_data].mean())} blocked" for z in shown]
    frame = make_frame(maps.grid, titles, "Obstacles, by altitude above ground", frame_note(maps))
    for panel, z in zip(frame.axes, shown, strict=True):
        draw_layers(panel, maps.grid, [flat_layer(has_data, FREE_COLOUR), obstacle_layer(maps, z, BUILT_COLOUR)])
    add_key(frame, [("free", FREE_COLOUR), *obstacle_patches(maps, BUILT_COLOUR)])
    return frame.figure


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
    panels: Sequence[tuple[float, str, np.ndarray]],
    names: Sequence[tuple[str, str]],
) -> Figure:
    """Return panels (altitude, title, class numbers) over free cells, the classes being (name, colour)."""
    titles = [title for _, title, _ in panels]
    frame = make_frame(maps.grid, titles, f"{heading}, by altitude above ground", frame_note(maps, time))
    for panel, (z, _, numbers) in zip(frame.axes, panels, strict=True):
        layer = classes_layer(np.where(maps.is_free(z, "centre"), numbers, -1), [colour for _, colour in names])
        draw_layers(panel, maps.grid, [layer, obstacle_layer(maps, z)])
    add_key(frame, [*names, *obstacle_patches(maps)])
    return frame.figure


def plot_gps_rating(maps: MetricMaps, *, altitudes_m: Sequence[float] | None = None, time: str | None = None) -> Figure:
    """Return panels of the paper's GPS rating by altitude; titles give the share of free cells rated good or better.

    Raises:
      InputError: an altitude or time that these maps do not hold.
    """
    shown = maps.altitudes_m if altitudes_m is None else tuple(altitudes_m)
    time = time or maps.times[0]
    ranks = [np.asarray(rating(maps.m("gdop", z, time=time))) for z in shown]
    titles = [
        f"{z:g} m  ·  {percent(_share(rank <= Rating.GOOD, maps, z))} good or better"
        for z, rank in zip(shown, ranks, strict=True)
    ]
    steps = colour_map(COLOUR_MAPS["gps"])(np.linspace(1, 0, len(Rating)))
    ranges = [f"up to {high:g}" for high in RATING_UPPER_GDOP] + [f"above {RATING_UPPER_GDOP[-1]:g}"]
    names = [
        (f"{item.name.capitalize()}\n(GDOP {dop_range})", matplotlib.colors.to_hex(colour))
        for item, dop_range, colour in zip(Rating, ranges, steps, strict=True)
    ]
    return _plot_classes(maps, "GPS rating", time, list(zip(shown, titles, ranks, strict=True)), names)


def _share(is_so: np.ndarray, maps: MetricMaps, altitude_m: float) -> float:
    is_free = maps.is_free(altitude_m, "centre")
    return float(is_so[is_free].mean()) if is_free.any() else 0.0


def plot_sensor_choice(
    maps: MetricMaps, *, altitudes_m: Sequence[float] | None = None, time: str | None = None
) -> Figure:
    """Return panels of the better sensor by altitude: GPS where m_gps > m_lidar, else lidar.

    Raises:
      InputError: an altitude or time that these maps do not hold.
    """
    shown = maps.altitudes_m if altitudes_m is None else tuple(altitudes_m)
    time = time or maps.default_time
    is_gps = [maps.prefers_gps(z, time=time) for z in shown]
    titles = [f"{z:g} m  ·  GPS in {percent(_share(g, maps, z))}" for z, g in zip(shown, is_gps, strict=True)]
    names = [("GPS\n($m_\\mathrm{gps}$ > $m_\\mathrm{lidar}$)", GPS_COLOUR), ("lidar\n(otherwise)", LIDAR_COLOUR)]
    panels = [(z, title, np.where(g, 0, 1)) for z, title, g in zip(shown, titles, is_gps, strict=True)]
    return _plot_classes(maps, "The better sensor", time, panels, names)


def density_style(maps: MetricMaps) -> tuple[Colormap, LogNorm]:
    """Return colour map and norm of people per km2: three decades up to the densest cell, zero left white."""
    highest = max(float(np.nanmax(maps.ds["density"].values)), 1.0)
    return colour_map(COLOUR_MAPS["population"]), LogNorm(highest / 1000, highest)


def plot_population(maps: MetricMaps) -> Figure:
    """Return panels of people per km2 by time of day, on one logarithmic scale; titles give the people in the region.

    Raises:
      InputError: maps without population.
    """
    if "density" not in maps.ds:
        raise InputError("these maps hold no population: give [population] sources in the scenario and make them again")
    cell_km2 = maps.grid.resolution_m**2 / 1e6
    density = [maps.m("density", time_of_day=item) for item in maps.times_of_day]
    titles = [
        f"{item}  ·  {np.nansum(values, dtype=np.float64) * cell_km2:,.0f} people"
        for item, values in zip(maps.times_of_day, density, strict=True)
    ]
    cmap, norm = density_style(maps)
    frame = make_frame(maps.grid, titles, "Population density", frame_note(maps))
    for panel, values in zip(frame.axes, density, strict=True):
        draw_layers(panel, maps.grid, density_layers(values, cmap, norm))
    patches = [("nobody", EMPTY_COLOUR), *obstacle_patches(maps)[1:]]
    add_key(frame, patches, (cmap, norm), "people per km²", extend="min")
    return frame.figure


def density_layers(values: np.ndarray, cmap: Colormap, norm: Normalize) -> list[Layer]:
    """Return people per km2 as they are drawn, cells with nobody in white."""
    return [flat_layer(values == 0, EMPTY_COLOUR), Layer(np.where(values > 0, values, np.float32(np.nan)), cmap, norm)]


def highest_roof_m(maps: MetricMaps) -> float:
    """Return the top of the roof heights' scale."""
    return max(float(np.nanmax(maps.m("roof"))), 1.0)


def roof_layers(maps: MetricMaps) -> list[Layer]:
    """Return roof heights as they are drawn: on a square-root scale, white where there is no roof."""
    roof_m, norm = maps.m("roof"), PowerNorm(0.5, 0, highest_roof_m(maps))
    values = np.where(roof_m > 0, roof_m, np.float32(np.nan))
    return [flat_layer(roof_m == 0, EMPTY_COLOUR), Layer(values, colour_map(HEIGHT_COLOUR_MAP), norm)]


def roof_ticks(maps: MetricMaps) -> list[float]:
    """Return the ticks of the roof heights' colour bar."""
    return [tick for tick in ROOF_TICKS_M if tick <= highest_roof_m(maps)]


def plot_heights(maps: MetricMaps) -> Figure:
    """Return roof heights above ground and, where it is not flat, the terrain's elevation."""
    roofs = roof_layers(maps)
    titles = [f"roofs above ground, up to {np.nanmax(maps.m('roof')):.0f} m"]
    if "terrain" in maps.ds:
        terrain_m = maps.m("terrain")
        low_m, high_m = float(np.nanmin(terrain_m)), float(np.nanmax(terrain_m))
        titles.append(f"terrain, {low_m:.0f} to {high_m:.0f} m")
        ground = Layer(terrain_m, colour_map(HEIGHT_COLOUR_MAP), Normalize(low_m, max(high_m, low_m + 1)))
    frame = make_frame(maps.grid, titles, "Heights (m)", frame_note(maps), footer_in=0.4)
    draw_layers(frame.axes[0], maps.grid, roofs)
    add_bar_below(frame, frame.axes[0], (roofs[1].cmap, roofs[1].norm), ticks=roof_ticks(maps))
    if "terrain" in maps.ds:
        draw_layers(frame.axes[1], maps.grid, [ground])
        add_bar_below(frame, frame.axes[1], (ground.cmap, ground.norm))
    add_key(frame, [("no building", EMPTY_COLOUR), *obstacle_patches(maps)[1:]])
    return frame.figure
