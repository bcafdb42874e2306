"""A made-up drive through the synthetic city: a place and a time each second."""

from functools import cache
from itertools import pairwise

import numpy as np
import pandas as pd

import jaxurban as ju
from jaxurban.io.rasterise import build_surface
from jaxurban.maps.run import load_city
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Problem
from jaxurban.world.surface import Surface

SCENARIO = {
    "region": {
        "bounds": [-74.0, 40.755, -73.993, 40.761],
        "resolution_m": 5.0,
        "altitudes_m": [20],
    },
    "buildings": {"source": "synthetic"},
    "gps": {"mask_deg": 10.0},
}
SPEED_M_S, NUM_LEGS = 6.0, 10


@cache
def scenario() -> ju.Scenario:
    return ju.Scenario.from_dict(SCENARIO)


@cache
def surface() -> Surface:
    """Return the synthetic city's rasters: nothing of it stands beyond the region."""
    grid = ju.Grid.from_bounds(SCENARIO["region"]["bounds"], 5.0)
    return build_surface(load_city(scenario()), grid, grid.padded(20, 20, 20, 20))


@cache
def drive() -> pd.DataFrame:
    """Return a second's place and time a row, by the shortest ways along free streets between random cells."""
    is_free, grid = np.asarray(surface().roof_m)[surface().window] < 2.0, surface().region
    cells, no_costs, model = (
        np.argwhere(is_free),
        np.zeros((1, *is_free.shape)),
        ju.CostModel(connectivity=4),
    )
    stops = cells[np.random.default_rng(17).integers(len(cells), size=NUM_LEGS + 1)].tolist()
    legs = [
        Problem(no_costs, is_free, *map(tuple, ends), grid.resolution_m, 1.0, model)
        for ends in pairwise(stops)
    ]
    corners = np.concatenate([astar(leg).points_m for leg in legs]) + np.array(
        [grid.x_min_m, grid.y_min_m]
    )
    along_m = np.cumsum(np.hypot(*np.diff(corners, axis=0, prepend=corners[:1]).T))
    at_m = np.arange(0.0, along_m[-1], SPEED_M_S)
    lon, lat = grid.lonlat_of_xy(*(np.interp(at_m, along_m, values) for values in corners.T))
    times = pd.date_range("2020-04-27T16:00:00", periods=len(at_m), freq="s", tz="UTC")
    return pd.DataFrame({"utc": times, "lon_deg": lon, "lat_deg": lat})
