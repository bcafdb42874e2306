"""The picture of what buildings cost a route."""

import math

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

from jaxurban.draw.frame import (
    ENDS,
    MapPanel,
    draw_maps,
    ground_said,
    joined,
    rules_said,
    time_said,
)
from jaxurban.draw.paths import draw_ends
from jaxurban.draw.style import Colours
from jaxurban.io.city import City
from jaxurban.paths.path import PlannedPath
from jaxurban.world.grid import Grid, covering_grid

ROUTE_COLOUR, LAND_COLOUR = "#111111", "#d9d9d9"
MARGIN_M = 250.0  # around the route


def plot_building_costs(
    city: City, planned: PlannedPath, table: pd.DataFrame, grid: Grid
) -> Figure:
    """Return the map of the buildings near a route, coloured by what one more metre of each costs the route.

    Colours are logarithmic on both sides of zero: red costs, blue helps, white has no effect.

    Args:
      city: whose outlines are drawn; it has buildings.
      planned: the route.
      table: from `jaxurban.studies.weights.buildings.building_costs`.
      grid: the region; what lies beyond it is not drawn.
    """
    assert city.buildings is not None
    settings = planned.settings
    polygons = city.buildings.polygons
    facts = joined(
        f"{planned.altitude_m:g} m above ground",
        time_said(settings["time"]),
        f"softness {table.attrs['softness_m']:g} m",
        *ground_said(grid, city.attribution),
    )

    # The scale of colours ends at the power of ten above all costs and gains, and is linear up to a thousandth of that.
    most = 10.0 ** math.ceil(math.log10(table.per_metre.abs().to_numpy().max(initial=1e-12)))
    ticks = -most, -most / 100, 0.0, most / 100, most
    norm = SymLogNorm(most / 1000, vmin=-most, vmax=most)
    colours = Colours(
        "RdBu_r", norm, "cost per metre of height, on a logarithmic scale", ticks=ticks
    )

    # The part of the region around the route.
    low = np.maximum(planned.xy_m.min(axis=0) - MARGIN_M, grid.bounds_m[:2])
    high = np.minimum(planned.xy_m.max(axis=0) + MARGIN_M, grid.bounds_m[2:])
    near = covering_grid((*low, *high), grid.resolution_m, grid.crs)

    # The map with its heading, note and legend.
    panels = [MapPanel(f"{planned.search.planner}, cost {planned.cost:,.1f}")]
    heading = joined(
        "What one more metre of each building costs the route", settings["time_of_day"], by=", "
    )
    note = f"{facts}\n{rules_said(settings)}"
    figure, (panel,) = draw_maps(
        near, panels, heading, note, legend=[("route", ROUTE_COLOUR), *ENDS], colours=colours
    )
    panel.set_facecolor(LAND_COLOUR)

    # The outlines near the route, in the colour of no effect where the table has no row, and the route over them.
    per_metre = np.zeros(len(polygons))
    per_metre[table.building] = table.per_metre
    is_near = shapely.intersects(polygons, shapely.box(*near.bounds_m))
    if is_near.any():
        gpd.GeoSeries(polygons[is_near]).plot(
            ax=panel,
            edgecolor="#555555",
            linewidth=0.25,
            aspect=None,
            autolim=False,
            color=list(colours(per_metre[is_near])),
        )
    panel.plot(
        *planned.xy_m.T, zorder=4, color=ROUTE_COLOUR, linewidth=1.5, solid_joinstyle="round"
    )
    draw_ends(panel, [planned])
    return figure
