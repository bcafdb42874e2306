"""A made-up drive through the synthetic city with a row a satellite: a receiver that hears by exact outlines."""

from functools import cache

import numpy as np
import pandas as pd
import shapely

import jaxurban as ju
from jaxurban.maps.run import load_city, scenario_grid
from jaxurban.typing import ReceiverValidation
from tests.receivers.receiver_logs import drive, scenario

ANTENNA_M = 2.0
SYSTEMS = "GE"


def hidden_by_outlines(
    polygons: np.ndarray,
    height_m: np.ndarray,
    x_m: float,
    y_m: float,
    azimuth_rad: float,
    elevation_rad: float,
) -> bool:
    """Return whether a ray meets a prism, by the exact outlines: a ray at a time, in a way of its own."""
    run_m = height_m.max() / np.tan(elevation_rad)
    far = x_m + run_m * np.sin(azimuth_rad), y_m + run_m * np.cos(azimuth_rad)
    ray, place = shapely.LineString([(x_m, y_m), far]), shapely.Point(x_m, y_m)
    met = shapely.intersects(polygons, ray)
    near_m = shapely.distance(place, shapely.intersection(polygons[met], ray))
    return bool(np.any(height_m[met] > ANTENNA_M + near_m * np.tan(elevation_rad)))


@cache
def heard() -> pd.DataFrame:
    """Return the log: 8 satellites that stand still, each weak behind a building and strong in the open, with noise."""
    rng = np.random.default_rng(2)
    buildings = load_city(scenario()).buildings
    epochs = drive().iloc[::4].reset_index(drop=True)
    x_m, y_m = scenario_grid(scenario()).xy_of_lonlat(epochs.lon_deg, epochs.lat_deg)
    turn_rad = scenario_grid(scenario()).convergence_rad(-73.9965, 40.758)
    rows = []
    for number, elevation_deg in enumerate([35, 50, 65, 40] * 2):
        name, azimuth_deg = f"{SYSTEMS[number % 2]}{number + 1:02d}", 20.0 + 45 * number
        for epoch, at in enumerate(zip(x_m, y_m, strict=True)):
            angles = np.radians(azimuth_deg) - turn_rad, np.radians(elevation_deg)
            is_hidden = hidden_by_outlines(buildings.polygons, buildings.height_m, *at, *angles)
            cn0_dbhz = rng.normal(27 if is_hidden else 42, 6)
            rows.append(
                (
                    epoch,
                    name,
                    azimuth_deg,
                    elevation_deg,
                    0.0 if cn0_dbhz < 22 else min(cn0_dbhz, 55.0),
                )
            )
    columns = ["epoch", "satellite", "azimuth_deg", "elevation_deg", "cn0_dbhz"]
    table = pd.DataFrame(rows, columns=columns)
    return table.join(epochs, on="epoch").drop(columns="epoch")


@cache
def found() -> ReceiverValidation:
    return ju.studies.validate(scenario(), heard(), progress=False)
