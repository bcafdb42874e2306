"""Pictures of how high a city stands: of its maps, or of the city before there are any."""

from collections.abc import Mapping
from typing import Unpack

import numpy as np
from matplotlib.figure import Figure

from jaxurban.draw.frame import (
    GUESSED_ROOF_COLOUR,
    NO_DATA_PATCH,
    OBSTACLE_COLOUR,
    DrawnMap,
    MapPanel,
    draw_maps,
    flat_layer,
    frame_note,
    ground_said,
    joined,
)
from jaxurban.draw.metrics import EMPTY_COLOUR, colours_of, layers_above_zero, precise_percent
from jaxurban.draw.style import drawing, ends_of
from jaxurban.io.city import City
from jaxurban.io.rasterise import rasterise
from jaxurban.maps.metric_maps import MapsLike, as_maps
from jaxurban.metrics.variables import AUXILIARY_VARIABLES
from jaxurban.pictures import MapForm
from jaxurban.world.grid import Grid, box_of, covering_grid

CELLS = 500  # along the longer side of a city's picture, about as many as a page shows
ROOF, TERRAIN, GUESSED = "roof", "terrain", "roof_guessed"


@drawing
def plot_heights(maps: MapsLike, **form: Unpack[MapForm]) -> Figure:
    """Return roof heights above ground and, where it is not flat, the terrain's elevation.

    Where maps know which roofs have a guessed height, a panel shows these.

    Args:
      maps: from `build_maps` or `open_maps`.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> ju.plot.plot_heights(maps, width="column").savefig("heights.pdf")
    """
    maps = as_maps(maps)
    rasters = {name: maps.m(name) for name in (ROOF, TERRAIN, GUESSED) if name in maps.ds}
    return _heights_figure(maps.grid, rasters, frame_note(maps, has_sky=False), **form)


@drawing
def plot_city(city: City, **form: Unpack[MapForm]) -> Figure:
    """Return what a city's files say of heights, as `plot_heights` does of maps, before any map is made.

    Heights are those of all that counts: buildings, structures and plants. Each is that at the centre of a cell, of
    which the longer side of the region has about 500.

    Args:
      city: from `City.from_files`, `sample_city` or `demo_city`.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> ju.plot.plot_city(city).savefig("city.png")
    """
    box_m = city.extent_m if city.bounds is None else box_of(city.bounds, city.crs)
    x_min, y_min, x_max, y_max = box_m
    side_m = max(x_max - x_min, y_max - y_min) / CELLS
    grid = covering_grid(box_m, float(f"{side_m:.1g}"), city.crs)
    surface = rasterise(city, grid, has_guessed=True)
    has_data = surface.has_data is None or surface.has_data
    rasters = {ROOF: np.where(has_data, surface.roof_m, np.float32(np.nan))}
    if surface.terrain_m is not None:
        rasters[TERRAIN] = np.where(has_data, surface.terrain_m, np.float32(np.nan))
    if surface.roof_guessed is not None:
        rasters[GUESSED] = np.asarray(surface.roof_guessed)
    note = joined(*ground_said(grid, city.attribution))
    return _heights_figure(grid, rasters, note, **form)


def _heights_figure(
    grid: Grid, rasters: Mapping[str, np.ndarray], note: str, **form: Unpack[MapForm]
) -> Figure:
    """Return panels of roofs, of the ground where there is a raster of it, and of guessed roofs where they are known.

    Args:
      grid: of all of them.
      rasters: ``[Y, X]`` by name: `ROOF` and, where they are known, `TERRAIN` and `GUESSED`; NaN without data.
      note: below the heading.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.
    """
    legend = [("no roof", EMPTY_COLOUR)]
    roof_m = rasters[ROOF]
    if np.isnan(roof_m).any():
        legend.append(NO_DATA_PATCH)
    colours = colours_of(AUXILIARY_VARIABLES[ROOF], lambda: roof_m)
    layers = layers_above_zero(roof_m, colours)
    _, highest_m = ends_of(roof_m)
    panels = [MapPanel(f"roofs above ground, up to {highest_m:.0f} m", layers)]

    if TERRAIN in rasters:
        terrain_m = rasters[TERRAIN]
        colours = colours_of(AUXILIARY_VARIABLES[TERRAIN], lambda: terrain_m)
        low_m, high_m = ends_of(terrain_m)
        title = f"terrain, {low_m:.0f} to {high_m:.0f} m"
        panels.append(MapPanel(title, [DrawnMap(terrain_m, colours)]))

    if GUESSED in rasters:
        is_roof = roof_m > 0
        is_guessed = (rasters[GUESSED] == 1) & is_roof
        share = precise_percent(is_guessed.sum() / max(is_roof.sum(), 1))
        layers = [
            flat_layer(roof_m == 0, EMPTY_COLOUR),
            flat_layer(is_roof, OBSTACLE_COLOUR),
            flat_layer(is_guessed, GUESSED_ROOF_COLOUR),
        ]
        panels.append(MapPanel(f"height guessed: {share} of cells with a roof", layers))
        legend += [("height known", OBSTACLE_COLOUR), ("height guessed", GUESSED_ROOF_COLOUR)]
    return draw_maps(grid, panels, "Heights (m)", note, legend=legend, **form)[0]
