"""A receiver's own log with the directions of its satellites by broadcast orbits, to `ReceiverLog`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.io.orbits import Orbits, look_angles, read_orbits, rinex_name
from jaxurban.io.tracks import AZIMUTH, CN0, ELEVATION, HEIGHT, LAT, LON, SATELLITE, UTC
from jaxurban.receivers.validation.logs import ReceiverLog, table_log

NO_MESSAGE = "no navigation message of the time"
LOWEST_HEARD_DEG = 5.0  # lowest elevation of a satellite that has rows in a log


def with_navigation(table: pd.DataFrame, navigation: str | Path, name: str) -> ReceiverLog:
    """Return a receiver's log with the directions of its satellites, and with those that it did not receive.

    The log has a row for each epoch and each satellite that by its orbit stands at least `LOWEST_HEARD_DEG` above the
    horizon then, of the systems that the receiver received; where it did not receive the satellite, its C/N0 is 0. A
    satellite that its navigation message calls unhealthy has no row, nor has one without a message of the time.

    Args:
      table: from `jaxurban.receivers.log_files.read_log`, with satellites and their C/N0.
      navigation: broadcast RINEX, or other orbits that `read_orbits` reads.
      name: of the log.

    Returns:
      The log; ``left_out`` names the satellites without a row though they were received, or have messages.

    Raises:
      InputError: orbits that cannot be read, or of another time.
    """
    orbits = read_orbits(navigation)
    angles = angles_along(orbits, table.drop_duplicates(UTC))
    is_heard = angles[SATELLITE].str[0].isin(table[SATELLITE].str[0])
    rows = angles[is_heard & (angles[ELEVATION] >= LOWEST_HEARD_DEG)]
    rows = rows.merge(table[[UTC, SATELLITE, CN0]], "left").fillna({CN0: 0.0})

    left_out = dict.fromkeys(table[SATELLITE], NO_MESSAGE)
    for each in orbits.satellites:
        health = getattr(each, "health", 0)
        reason = (
            f"unhealthy by its navigation message (health {health:.0f})" if health else NO_MESSAGE
        )
        left_out[rinex_name(each.name)] = reason
    for satellite in angles[SATELLITE][is_heard].unique():
        del left_out[satellite]
    left_out |= dict.fromkeys(
        angles[SATELLITE][~is_heard], "no C/N0 of L1, E1 or B1 in the observations"
    )
    return replace(table_log(rows, name), left_out=dict(sorted(left_out.items())))


def angles_along(orbits: Orbits, track: pd.DataFrame) -> pd.DataFrame:
    """Return where the satellites stand along a track, without those that have no place at the time.

    Args:
      orbits: the satellites.
      track: ``utc``, ``lon_deg``, ``lat_deg`` and, if known, ``height_m`` above the ellipsoid.

    Returns:
      A row for each place and satellite: time and place, ``satellite``, ``azimuth_deg`` (clockwise from true north) and
      ``elevation_deg`` (negative below the horizon).
    """
    places = track[[UTC, LON, LAT]].reset_index(drop=True)
    height_m = track.get(HEIGHT, 0.0)
    sky = look_angles(orbits, places[UTC].tolist(), places[LON], places[LAT], height_m)
    place, number = np.nonzero(np.isfinite(sky.elevation_rad))
    columns = {
        SATELLITE: np.array([rinex_name(name) for name in sky.names])[number],
        AZIMUTH: np.degrees(sky.azimuth_rad[place, number]),
        ELEVATION: np.degrees(sky.elevation_rad[place, number]),
    }
    return places.iloc[place].reset_index(drop=True).assign(**columns)
