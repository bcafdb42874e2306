"""Draw which buildings cost a route through the synthetic city most. Writes figures/buildings.png."""

from pathlib import Path

import geopandas as gpd
import jax
import numpy as np
import pandas as pd
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

import jaxurban as ju
from jaxurban.draw.frame import ENDS, mark_ends
from jaxurban.draw.write import write_picture
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.differentiable import SoftParams, soften
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.studies.weights.buildings import building_costs
from jaxurban.world.grid import Grid

FILE = Path(__file__).with_suffix(".png")
ALTITUDE_M, RESOLUTION_M = 25.0, 5.0
AROUND_M = 250.0  # the route


def plot_costs(city: ju.City, xy_m: np.ndarray, table: pd.DataFrame) -> Figure:
    """Return the outlines near a route, coloured by what one more metre of each costs it, and the route."""
    assert city.buildings is not None
    polygons = city.buildings.polygons
    most = 10.0 ** np.ceil(np.log10(table["per_metre"].abs().max()))
    figure = Figure(figsize=(5.5, 7.2), layout="constrained")
    panel = figure.subplots()
    gpd.GeoSeries(polygons).plot(ax=panel, color="white", edgecolor="#999999", linewidth=0.25)
    gpd.GeoDataFrame(table, geometry=polygons[table["building"]]).plot(
        "per_metre",
        ax=panel,
        cmap="RdBu_r",
        norm=SymLogNorm(most / 1000, vmin=-most, vmax=most),
        edgecolor="#555555",
        linewidth=0.25,
        legend=True,
        legend_kwds={
            "label": f"change of the route's cost with one more metre of height, {ALTITUDE_M:g} m up\n"
            "blue: cheaper, as walls return more lidar; red: costlier, as\n"
            "they hide satellites or come near (logarithmic on both sides of 0)",
            "orientation": "horizontal",
            "shrink": 0.8,
            "ticks": [-most, -most / 100, 0, most / 100, most],
            "format": "{x:g}",
        },
    )
    (route,) = panel.plot(*xy_m.T, color="#111111", linewidth=1.5, label="route")
    (west, south), (east, north) = xy_m.min(axis=0) - AROUND_M, xy_m.max(axis=0) + AROUND_M
    panel.set(
        xlim=(west, east),
        ylim=(south, north),
        xlabel="east (m)",
        ylabel="north (m)",
    )
    panel.ticklabel_format(useOffset=False, style="plain")
    panel.locator_params(nbins=4)
    panel.set_title("What one more metre of a building costs the route")
    mark_ends(panel, xy_m[0], xy_m[-1])
    panel.legend(handles=[route, *ENDS], loc="upper left", fontsize="small")
    return figure


def main() -> None:
    city = ju.demo_city(2000, 2000)
    x_min, y_min, _, _ = city.extent_m
    num = round(2000 / RESOLUTION_M)
    region = Grid(
        city.crs, RESOLUTION_M, round(y_min / RESOLUTION_M), round(x_min / RESOLUTION_M), num, num
    )
    sky = view_sky(region, ju.Gps(times=["2020-04-27T16:00:00Z"]))
    task = MapTask(city, region, sky, MapParams(altitudes_m=(ALTITUDE_M,)))
    maps = compute_maps(task)
    ends = [(x_min + 2000 * x, y_min + 2000 * y) for x, y in ((0.3, 0.12), (0.62, 0.9))]
    planned = ju.plan(maps, ju.XY(*ends[0]), ju.XY(*ends[1]), altitude_m=ALTITUDE_M, snap=True)
    with jax.enable_x64(True):
        soft = soften(task, dtype=np.float64)
        table = building_costs(city, soft, planned, SoftParams(ALTITUDE_M))
    write_picture(plot_costs(city, planned.xy_m, table), FILE)


if __name__ == "__main__":
    main()
