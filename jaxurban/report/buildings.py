"""What buildings cost a route over a folder of maps: the sources read again, a table and a map written."""

import math
from functools import partial
from pathlib import Path

import geopandas as gpd
import jax
import numpy as np
import pandas as pd
import shapely
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.workspace import Workspace
from jaxurban.maps.differentiable import SoftParams, soften
from jaxurban.maps.run import tasks_of
from jaxurban.maps.sources import scenario_of
from jaxurban.paths.path import PlannedPath
from jaxurban.report.figures.frame import (
    ENDS,
    MapPanel,
    draw_maps,
    ground_said,
    joined,
    rules_said,
    time_said,
)
from jaxurban.report.figures.paths import draw_ends
from jaxurban.report.figures.style import Colours
from jaxurban.report.write import save
from jaxurban.studies.weights.buildings import building_costs
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


BUILDINGS_FILES = "buildings.csv", "buildings.parquet", "buildings.png"


@typed
def write_buildings(
    folder: str | Path,
    planned: PlannedPath,
    out: str | Path,
    *,
    scenario: str | Path | None = None,
    softness_m: float = 2.0,
) -> pd.DataFrame:
    """Write what every building costs a route: ``buildings.csv``, ``buildings.parquet`` and ``buildings.png``.

    Soft maps are made on the maps' own cells, also where the exact ones were made on finer ones (``oversample``).

    Args:
      folder: of the maps, with their run.json, which names the sources of the city.
      planned: a route over these maps.
      out: where the files go; made if it is not there.
      scenario: file that the maps were made from, where sources have relative names.
      softness_m: see `jaxurban.grad.SoftParams`.

    Returns:
      The table of `jaxurban.studies.building_costs`, a row per building with any effect, the costliest first.

    Raises:
      InputError: there is no route, sources that are not found or changed, buildings from a height raster, a route over
        statistics of many epochs, or files of these names that were not written so, or changed since.

    Examples:
      >>> from pathlib import Path
      >>> from jaxurban.maps.run import run_scenario  # what `jaxurban maps` runs
      >>> settings = {"bounds": [-73.974, 40.778, -73.968, 40.782], "resolution_m": 20.0, "altitudes_m": [60]}
      >>> scenario = ju.Scenario.from_dict({"region": settings, "buildings": {"source": "synthetic"}})
      >>> run = run_scenario(scenario, Path("maps"), progress=False)
      >>> flown = ju.plan("maps", (-73.973, 40.779), (-73.969, 40.781), altitude_m=60.0, snap=True)
      >>> table = ju.studies.write_buildings("maps", flown, "costs")
      >>> sorted(file.name for file in Path("costs").iterdir())
      ['buildings.csv', 'buildings.parquet', 'buildings.png', 'checksums.json']
    """
    # The task that made the maps of the route's resolution, from the sources that the maps' record names.
    if scenario is not None and not Path(scenario).is_file():
        raise InputError(f"there is no scenario {str(scenario)!r}: check the path")
    sources = None if scenario is None else Path(scenario).parent
    settings = scenario_of(Path(folder), sources)
    if not softness_m > 0:
        raise InputError(
            f"softness_m must be a positive number of metres such as 2, got {softness_m}"
        )
    resolution_m = planned.settings["resolution_m"]
    time = planned.settings["time"]
    tasks = {task.region.resolution_m: task for task in tasks_of(settings)}
    if resolution_m not in tasks:
        raise InputError(
            f"the route lies on cells of {resolution_m:g} m, which these maps do not hold"
        )
    task = tasks[resolution_m]
    if time not in task.sky.times:
        raise InputError(
            "the route was planned on GPS statistics over many epochs, which have no gradient by building: make maps "
            "of one time, and plan on them"
        )

    # The soft maps, at the time and time of day of the route, and the derivatives, which are computed in float64.
    city = task.city
    params = SoftParams(planned.altitude_m, softness_m, dict(task.params.sections))
    time_index = task.sky.times.index(time)
    time_of_day = planned.settings["time_of_day"] or "day"
    with jax.enable_x64(True):
        soft = soften(task, time_index=time_index, time_of_day=time_of_day, dtype=np.float64)
        table = building_costs(city, soft, planned, params)
    picture = {"buildings.png": partial(plot_building_costs, city, planned, table, task.region)}
    with Workspace.shared(Path(out), "sensitivity --buildings", BUILDINGS_FILES):
        save(out, {"buildings": table.reset_index(), **picture})
    return table
