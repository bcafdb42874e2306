"""Nominal GPS: the published slots, as satellites that can be moved to a time of a day."""

import math
from datetime import UTC, date, datetime

from sgp4.api import WGS72, Satrec
from skyfield.api import EarthSatellite, Timescale

# Orbit plane -> right ascension of the ascending node, and argument of latitude of its slots 1 to 4; degrees, at
# 1993-07-01 00:00 UTC. Source: GPS SPS Performance Standard (2001), Table 3-1, Reference Orbit Slot Assignments.
PLANES = {
    "A": (272.847, (268.126, 161.786, 11.676, 41.806)),
    "B": (332.847, (80.956, 173.336, 309.976, 204.376)),
    "C": (32.847, (111.876, 11.796, 339.666, 241.556)),
    "D": (92.847, (135.226, 265.446, 35.156, 167.356)),
    "E": (152.847, (197.046, 302.596, 66.066, 333.686)),
    "F": (212.847, (238.886, 345.226, 105.206, 135.346)),
}
SLOTS = {
    f"{plane}{slot}": (node, latitude)
    for plane, (node, latitudes) in PLANES.items()
    for slot, latitude in enumerate(latitudes, start=1)
}
TABLE_DATE = date(1993, 7, 1)  # at 00:00 UTC
INCLINATION_DEG = 55.0  # same table; eccentricity 0, semi-major axis 26,559.7 km
NODE_RATE_DEG = -4.4874e-7 * 86400  # degrees a day: the same standard's nominal almanac (Table A2-1), -4.4874e-7 deg/s
SIDEREAL_RATE_DEG = 360.98564736629  # degrees a day of UT1, of Earth against the mean equinox of date (IAU 1982)
# Twice round while Earth turns once against the orbit's plane: what station keeping holds.
LATITUDE_RATE_DEG = 2 * (SIDEREAL_RATE_DEG - NODE_RATE_DEG)
# Earth's flattening turns the perigee by 3/4 J2 (R/a)^2 n (5 cos^2 i - 1); the mean anomaly does the rest.
FLATTENING = 0.75 * 1.082616e-3 * (6378.135 / 26559.7) ** 2
PERIGEE_RATE_DEG = FLATTENING * LATITUDE_RATE_DEG * (5 * math.cos(math.radians(INCLINATION_DEG)) ** 2 - 1)


def nominal_satellites(day: date, timescale: Timescale) -> tuple[EarthSatellite, ...]:
    """Return the 24 satellites with elements at noon UTC of ``day``, good for that day.

    The planes precess at the standard's nominal rate and the satellites keep their ground tracks, as
    real ones are held by station keeping: so the constellation stands as the table says at its date
    and never grows old. Within the day SGP4 moves them, which pulls them up to 0.1 degrees (seen from
    the Earth's centre) away by Moon and Sun; over midnight they step by less than 0.01 degrees.
    """
    noon = timescale.utc(day.year, day.month, day.day, 12)
    table = timescale.utc(TABLE_DATE.year, TABLE_DATE.month, TABLE_DATE.day)
    elapsed_days = noon.ut1 - table.ut1
    sgp4_epoch = datetime(day.year, day.month, day.day, 12, tzinfo=UTC) - datetime(1949, 12, 31, tzinfo=UTC)
    satellites = []
    for number, (slot, (node_deg, latitude_deg)) in enumerate(SLOTS.items(), start=1):
        model = Satrec()
        model.sgp4init(
            WGS72,
            "i",
            number,
            sgp4_epoch.total_seconds() / 86400,
            # Drag, two derivatives of the mean motion that SGP4 does not use, eccentricity, argument of perigee: on a
            # circle the mean anomaly is the argument of latitude.
            *(0.0,) * 5,
            math.radians(INCLINATION_DEG),
            math.radians((latitude_deg + LATITUDE_RATE_DEG * elapsed_days) % 360),
            math.radians(LATITUDE_RATE_DEG - PERIGEE_RATE_DEG) / 1440,  # radians a minute
            math.radians((node_deg + NODE_RATE_DEG * elapsed_days) % 360),
        )
        satellite = EarthSatellite.from_satrec(model, timescale)
        satellite.name = f"GPS slot {slot}"
        satellites.append(satellite)
    return tuple(satellites)
