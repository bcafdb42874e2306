"""A made-up drive through the synthetic city, whose receiver is known: it tracks what the maps see, and some noise."""

from functools import cache

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

import jaxurban as ju
from jaxurban.io.read.rasterise import build_surface
from jaxurban.maps.run import load_city
from jaxurban.studies.receiver.validate import ReceiverValidation
from jaxurban.world.surface import Surface

SCENARIO = {
    "region": {"bounds": [-74.0, 40.755, -73.993, 40.761], "resolution_m": 5.0, "altitudes_m": [20]},
    "buildings": {"source": "synthetic"},
    "gps": {"mask_deg": 10.0},
}
SETTINGS = ju.studies.ReceiverSettings(sky_step_s=240.0, block_m=100.0)
SPEED_M_S, NUM_LEGS = 6.0, 8


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
    """Return a second's place and time a row, by the shortest ways along free cells between random ones."""
    is_free = np.asarray(surface().roof_m)[surface().window] < 2.0
    cells = np.argwhere(is_free)
    number = np.where(is_free, np.cumsum(is_free).reshape(is_free.shape) - 1, -1)
    beside = ((number[1:], number[:-1]), (number[:, 1:], number[:, :-1]))
    pairs = np.concatenate([np.reshape(each, (2, -1)) for each in beside], axis=1)
    pairs = pairs[:, (pairs >= 0).all(axis=0)]
    graph = coo_matrix((np.ones(pairs.shape[1]), pairs), shape=(len(cells),) * 2)
    stops = np.random.default_rng(5).integers(len(cells), size=NUM_LEGS + 1)
    _, before = dijkstra(graph, directed=False, indices=stops[:-1], return_predecessors=True, unweighted=True)
    way: list[int] = []
    for leg, goal in enumerate(stops[1:]):
        back = [goal]
        while before[leg, back[-1]] >= 0:
            back.append(before[leg, back[-1]])
        way += back[::-1]
    grid = surface().region
    corners = np.stack(grid.xy_of_cell(*cells[way].T), axis=1)
    along_m = np.cumsum(np.hypot(*np.diff(corners, axis=0, prepend=corners[:1]).T))
    at_m = np.arange(0.0, along_m[-1], SPEED_M_S)
    lon, lat = grid.lonlat_of_xy(*(np.interp(at_m, along_m, values) for values in corners.T))
    times = pd.date_range("2020-04-27T16:00:00", periods=len(at_m), freq="s", tz="UTC")
    return pd.DataFrame({"utc": times, "lon_deg": lon, "lat_deg": lat})


@cache
def seen() -> ReceiverValidation:
    """Return what the maps say along the drive; its witness is of no interest."""
    return ju.studies.validate(scenario(), drive().assign(num_tracked=5), SETTINGS, progress=False)


@cache
def true_log() -> pd.DataFrame:
    """Return the drive of a receiver that tracks what is in view, one more or less, and errs as HDOP says."""
    rng = np.random.default_rng(6)
    epochs = seen().epochs
    in_view = epochs.num_visible.fillna(0).to_numpy()
    error_m = 3.0 * np.minimum(epochs.hdop.fillna(50.0), 50.0) * rng.lognormal(0.0, 0.3, len(epochs))
    return drive().assign(num_tracked=np.maximum(in_view + rng.integers(-1, 2, len(epochs)), 0), error_2d_m=error_m)


@cache
def found() -> ReceiverValidation:
    return ju.studies.validate(scenario(), true_log(), SETTINGS, progress=False)
