"""Draw which buildings cost a route through the embedded city most. Writes figures/buildings.png."""

from pathlib import Path

import jax
import numpy as np

import jaxurban as ju
from jaxurban.build import compute_maps, make_surface, soft_city, view_sky
from jaxurban.grid import Grid
from jaxurban.layers import MapParams
from jaxurban.plotting.buildings import plot_building_costs
from jaxurban.plotting.files import write_png
from jaxurban.soft.engine import SoftParams
from jaxurban.studies.buildings import building_costs

FILE = Path(__file__).with_suffix(".png")
ALTITUDE_M, RESOLUTION_M = 25.0, 5.0


def main() -> None:
    city = ju.demo_city(2000, 2000)
    x_min, y_min, _, _ = city.extent_m
    num = round(2000 / RESOLUTION_M)
    region = Grid(city.crs, RESOLUTION_M, round(y_min / RESOLUTION_M), round(x_min / RESOLUTION_M), num, num)
    sky = view_sky(region, "nominal", ["2020-04-27T16:00:00Z"], mask_deg=5.0, reference=None, max_age_days=90)
    params = MapParams(altitudes_m=(ALTITUDE_M,))
    maps = compute_maps(city, make_surface(city, region, sky, params), sky, params)
    ends = [(x_min + 2000 * x, y_min + 2000 * y) for x, y in ((0.3, 0.12), (0.62, 0.9))]
    planned = ju.plan(maps, start_xy_m=ends[0], goal_xy_m=ends[1], altitude_m=ALTITUDE_M, snap=True)
    with jax.enable_x64(True):
        soft = soft_city(city, region, sky, params, dtype=np.float64)
        table = building_costs(city, soft, planned, SoftParams(ALTITUDE_M))
    write_png(plot_building_costs(city, planned, table, region), FILE)


if __name__ == "__main__":
    main()
