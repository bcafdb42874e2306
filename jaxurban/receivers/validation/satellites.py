"""The satellites of a receiver's log over a city: where buildings are known, directions by orbits, and counts."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import in_words
from jaxurban.io.city import City
from jaxurban.io.orbits import matching
from jaxurban.io.tracks import AZIMUTH, CN0, ELEVATION, SATELLITE
from jaxurban.receivers.track import NUM_VISIBLE, Track
from jaxurban.receivers.validation.logs import EPOCH, ReceiverLog
from jaxurban.receivers.validation.settings import EVERYWHERE, OF_CITY
from jaxurban.world.grid import Grid
from jaxurban.world.sky import Sky

NUM_HEARD = "num_heard"


def known_of(known: str | float, city: City, track: Track) -> shapely.Geometry:
    """Return where the buildings of a city are known, as a geometry in its CRS.

    Args:
      known: as in `ReceiverSettings`: what the city's file covers, or all; or metres around the places of the track.
      city: of the buildings.
      track: its places.
    """
    if known in (OF_CITY, EVERYWHERE):
        return city.known_ground
    places = np.unique(np.column_stack([track.x_m, track.y_m]), axis=0)
    return shapely.union_all(shapely.buffer(shapely.points(places), float(known)))


def with_directions(log: ReceiverLog, track: Track, sky: Sky, grid: Grid) -> ReceiverLog:
    """Return a log with the azimuth and elevation of each row, in degrees, by the orbits of a sky.

    The satellites of the log that have no orbit are listed as left out. Rows of such satellites, and rows below the
    horizon, are dropped.

    Args:
      log: with a row per epoch and satellite.
      track: says which time of the sky each epoch takes.
      sky: directions by time and satellite, azimuths from grid north.
      grid: whose north the azimuths are turned from, to true north.

    Raises:
      InputError: no satellite of the log has an orbit.
    """
    # Of each row the number of its satellite in the sky, -1 without an orbit, and its time there.
    rows = log.satellites
    satellites = rows[SATELLITE].cat
    of_category = matching(list(satellites.categories), sky)
    number = of_category[satellites.codes]
    time_and_satellite = track.sky[rows[EPOCH]], number

    turn_rad = grid.convergence_rad(*grid.centre_lonlat)
    azimuth_deg = np.degrees((sky.azimuth_rad[time_and_satellite] + turn_rad) % math.tau)
    elevation_deg = np.degrees(sky.elevation_rad[time_and_satellite])
    angles = {AZIMUTH: azimuth_deg.astype(np.float32), ELEVATION: elevation_deg.astype(np.float32)}
    is_up = (number >= 0) & (elevation_deg >= 0)
    names = satellites.categories[of_category < 0]
    left_out = {
        **log.left_out,
        **dict.fromkeys(names, in_words("no orbit of [gps] orbits has its name")),
    }
    seen = rows.assign(**angles)[is_up].reset_index(drop=True)
    return replace(log, satellites=seen, left_out=left_out)


def counted(rows: pd.DataFrame, num_epochs: int) -> pd.DataFrame:
    """Return how many satellites each epoch sees by the maps, and how many the receiver hears.

    Both are ``[N]`` float, ``num_visible`` and ``num_heard``, and count judged rows only. An epoch without a judged row
    has NaN.

    Args:
      rows: of a `jaxurban.receivers.validation.validate.ReceiverValidation`.
      num_epochs: N.
    """
    judged = rows[rows.is_judged]
    table = pd.DataFrame({NUM_VISIBLE: judged.is_seen, NUM_HEARD: judged[CN0] > 0})
    return table.groupby(judged.epoch).sum().reindex(range(num_epochs)).astype(float)
