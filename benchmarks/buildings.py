"""Hold what buildings cost a route by the soft gradient against the exact maps of a city where they are raised or gone.

A route over Lower Manhattan (10 m cells, 20 m up). For the costliest buildings, the most helpful ones and some in
between: the gradient per metre, and what the fixed route costs more on exact maps with the building 2 m higher, 2 m
lower, and gone.

Run: ``python -m benchmarks.buildings [--num 5]``
"""

import argparse
from dataclasses import replace

import jax
import numpy as np
import pandas as pd

from benchmarks.scenes import BOUNDS, CRS, DATA, ORBITS, OSM, REFERENCE, TIME
from jaxurban.errors import InputError
from jaxurban.maps.build import compute_maps, soften, view_sky
from jaxurban.maps.differentiable import SoftParams
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.paths.plan import plan
from jaxurban.studies.sensitivity.buildings import building_costs, route_visits
from jaxurban.world.city import City
from jaxurban.world.grid import Grid

ALTITUDE_M, SOFTNESS_M, STEP_M = 20.0, 2.0, 2.0
ENDS = (-74.0145, 40.7035), (-73.9875, 40.7225)
GONE_M = 1e-3  # a roof this low does nothing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--num", type=int, default=5)
    num = parser.parse_args().num
    if not OSM.exists():
        raise InputError(f"real data not found at {DATA}: set JAXURBAN_DATA")
    city = City.from_files(OSM, bounds=BOUNDS, crs=CRS)
    region = Grid.from_bounds(BOUNDS, 10.0, CRS)
    sky = view_sky(region, ORBITS, [TIME], mask_deg=5.0, reference=REFERENCE, max_age_days=90)
    task = MapTask(city, region, sky, MapParams(altitudes_m=(ALTITUDE_M,)))
    maps = compute_maps(task)
    route = plan(maps, *ENDS, altitude_m=ALTITUDE_M, snap=True)
    with jax.enable_x64(True):
        soft = soften(task, dtype=np.float64)
        table = building_costs(city, soft, route, SoftParams(ALTITUDE_M, SOFTNESS_M))
    visits = route_visits(soft, route)
    row, col = np.asarray(visits.cells).T
    times = np.asarray(visits.times)

    def exact(buildings_m: np.ndarray) -> float:
        other: City = replace(city, buildings=replace(city.buildings, height_m=buildings_m))
        found = compute_maps(replace(task, city=other))
        return sum(float(cost[row, col] @ times) for cost in found.costs(ALTITUDE_M).values())

    height_m = city.buildings.height_m
    here = exact(height_m)
    middle = table.iloc[np.linspace(num, len(table) - num - 1, num).astype(int)]
    chosen = pd.concat([table.head(num), middle, table.tail(num)])
    for name, moved in (("higher", STEP_M), ("lower", -STEP_M), ("gone", -np.inf)):
        changes = []
        for building in chosen.building:
            other_m = height_m.copy()
            other_m[building] = max(GONE_M, other_m[building] + moved)
            changes.append(exact(other_m) - here)
        chosen[name] = changes
    columns = ["building", "height_m", "distance_m", "per_metre", "gps", "lidar", "risk", "higher", "lower", "gone"]
    print(
        f"route: cost {route.cost:.1f} exact, {table.attrs['soft_cost']:.1f} soft; "
        f"{len(table)} buildings have an effect"
    )
    print(chosen[columns].to_string(index=False, float_format="{:.4f}".format))
    both = chosen[(chosen.higher - chosen.lower).abs() > 1e-6]
    agree = np.sign(both.higher - both.lower) == np.sign(both.per_metre)
    rank = both.per_metre.corr(both.higher - both.lower, method="spearman")
    print(
        f"{len(both)} of {len(chosen)} change the exact cost; "
        f"sign agrees for {agree.sum()}, rank correlation {rank:.2f}"
    )


if __name__ == "__main__":
    main()
