"""Draw which buildings cost a route through the synthetic city most. Writes figures/buildings.png."""

from pathlib import Path

import jax
import numpy as np

import jaxurban as ju
from jaxurban.draw.write import write_picture
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.differentiable import SoftParams, soften
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.studies.reports.buildings import plot_building_costs
from jaxurban.studies.weights.buildings import building_costs
from jaxurban.world.grid import Grid

FILE = Path(__file__).with_suffix(".png")
ALTITUDE_M, RESOLUTION_M = 25.0, 5.0


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
    write_picture(plot_building_costs(city, planned, table, region), FILE)


if __name__ == "__main__":
    main()
