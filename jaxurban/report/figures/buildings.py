"""Picture of what buildings cost a route: plan view, outlines coloured by the gradient, the route on top."""

import math
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

from jaxurban.paths.path import PlannedPath
from jaxurban.report.figures.frame import ENDS, LegendEntry, MapPanel, draw_maps
from jaxurban.report.figures.metrics import EMPTY_COLOUR
from jaxurban.report.figures.notes import joined, place_said, rules_said, time_said
from jaxurban.report.figures.paths import draw_ends
from jaxurban.report.figures.style import Colours
from jaxurban.world.city import City
from jaxurban.world.grid import Grid

UNTOUCHED_COLOUR, ROUTE_COLOUR = "#dedede", "#111111"
DECADES = 3  # of colours on each side of zero, up to the whole one that holds the largest
SHOWN_SHARE = 0.01  # buildings with less of the largest effect may lie outside the picture
MARGIN_M = 120.0  # around what the picture shows


def plot_building_costs(city: City, planned: PlannedPath, table: pd.DataFrame, grid: Grid) -> Figure:
    """Return the map of the buildings, coloured by what one more metre of each costs the route.

    Colours are logarithmic on both sides of zero: red costs, blue helps, grey has no effect. The picture holds the
    route and, inside the region, every building with at least a hundredth of the largest effect.

    Args:
      city: whose outlines are drawn.
      planned: the route.
      table: from `jaxurban.studies.weights.buildings.building_costs`.
      grid: the region; buildings beyond it are not drawn.
    """
    assert city.buildings is not None
    settings, polygons = planned.settings, city.buildings.polygons
    place = f"{planned.altitude_m:g} m above ground", time_said(settings["time"]), settings["time_of_day"]
    cells = f"softness {table.attrs['softness_m']:g} m", f"{grid.resolution_m:g} m cells", grid.crs, place_said(grid)
    note = f"{joined(*place, *cells, city.attribution)}\n{rules_said(settings)}"
    most = max(float(table.per_metre.abs().max()) if len(table) else 0.0, 1e-12)
    main = table.building[table.per_metre.abs() >= SHOWN_SHARE * most]
    shown = _around(planned, polygons[main], grid)
    top = 10.0 ** math.ceil(math.log10(most))
    ticks = sorted(sign * top * 10.0**-power for sign in (-1, 1) for power in range(DECADES))
    norm = SymLogNorm(top / 10**DECADES, vmin=-top, vmax=top)
    colours = Colours("RdBu_r", norm, "cost per metre of height", ticks=[*ticks, 0.0])
    heading = "What one more metre of each building costs the route"
    legend: list[LegendEntry] = [("no effect", UNTOUCHED_COLOUR), ("route", ROUTE_COLOUR), *ENDS]
    panels = [MapPanel(f"{planned.search.planner}, cost {planned.cost:,.1f}")]
    figure, (panel,) = draw_maps(shown, panels, heading, note, legend=legend, colours=colours)
    panel.set_facecolor(EMPTY_COLOUR)
    seen = np.flatnonzero(shapely.intersects(polygons, shapely.box(*shown.bounds_m)))
    drawn = table[table.building.isin(seen)].sort_values("per_metre", key=np.abs)  # what matters most comes on top
    how = {"ax": panel, "aspect": None, "autolim": False}
    if len(others := np.setdiff1d(seen, table.building)):
        gpd.GeoSeries(polygons[others]).plot(color=UNTOUCHED_COLOUR, linewidth=0, zorder=1, **how)
    if len(drawn):
        face = list(colours(drawn.per_metre.to_numpy()))
        gpd.GeoSeries(polygons[drawn.building]).plot(color=face, edgecolor="#555555", linewidth=0.25, zorder=2, **how)
    for colour, width, order in (("white", 3.2, 3), (ROUTE_COLOUR, 1.5, 4)):
        panel.plot(*planned.xy_m.T, color=colour, linewidth=width, solid_joinstyle="round", zorder=order)
    draw_ends(panel, [planned])
    return figure


def _around(planned: PlannedPath, polygons: np.ndarray, grid: Grid) -> Grid:
    """Return the part of the grid around a route and some outlines."""
    boxes = np.vstack([np.hstack([planned.xy_m.min(axis=0), planned.xy_m.max(axis=0)]), shapely.bounds(polygons)])
    low = np.maximum(boxes[:, :2].min(axis=0) - MARGIN_M, grid.bounds_m[:2])
    high = np.minimum(boxes[:, 2:].max(axis=0) + MARGIN_M, grid.bounds_m[2:])
    first = np.floor(low / grid.resolution_m + 1e-6).astype(int)
    num_cols, num_rows = map(int, np.ceil(high / grid.resolution_m - 1e-6).astype(int) - first)
    return replace(grid, first_row=int(first[1]), first_col=int(first[0]), num_rows=num_rows, num_cols=num_cols)
