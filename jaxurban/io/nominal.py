"""The nominal constellation: the published slots of GPS, as satellites that can be moved to any day."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime

from sgp4.api import WGS72, Satrec
from skyfield.api import EarthSatellite, Timescale

# Degrees a day of UT1, of Earth against the mean equinox of date (IAU 1982).
SIDEREAL_RATE_DEG = 360.98564736629
MARK = "(nominal)"  # ends the names of such satellites in a file


@dataclass(frozen=True)
class Constellation:
    """A nominal constellation: circular orbits that are held so that their ground tracks repeat.

    Attributes:
      name: of a satellite, with a place for its slot.
      first_number: catalogue number of the first one.
      slots: by slot the right ascension of the ascending node, from the mean equinox of date, and the argument of
        latitude; degrees.
      table_date: the day of these angles, at 00:00 UTC.
      inclination_deg, axis_km: inclination and semi-major axis.
      node_rate_deg: degrees a day that the nodes turn.
      turns: orbits while Earth turns once against the orbit's plane.
    """

    name: str
    first_number: int
    slots: Mapping[str, tuple[float, float]]
    table_date: date
    inclination_deg: float
    axis_km: float
    node_rate_deg: float
    turns: float

    @property
    def latitude_rate_deg(self) -> float:
        """Degrees a day by which the argument of latitude grows: what station keeping holds."""
        return self.turns * (SIDEREAL_RATE_DEG - self.node_rate_deg)

    @property
    def perigee_rate_deg(self) -> float:
        """Degrees a day that Earth's flattening turns the perigee; the mean anomaly does the rest.

        It is 3/4 J2 (R/a)^2 n (5 cos^2 i - 1).
        """
        flattening = 0.75 * 1.082616e-3 * (6378.135 / self.axis_km) ** 2
        return (
            flattening
            * self.latitude_rate_deg
            * (5 * math.cos(math.radians(self.inclination_deg)) ** 2 - 1)
        )


# Orbit plane -> right ascension of the ascending node, and argument of latitude of its slots 1 to 4. Source: GPS SPS
# Performance Standard (2001), Table 3-1, Reference Orbit Slot Assignments.
GPS_PLANES = {
    "A": (272.847, (268.126, 161.786, 11.676, 41.806)),
    "B": (332.847, (80.956, 173.336, 309.976, 204.376)),
    "C": (32.847, (111.876, 11.796, 339.666, 241.556)),
    "D": (92.847, (135.226, 265.446, 35.156, 167.356)),
    "E": (152.847, (197.046, 302.596, 66.066, 333.686)),
    "F": (212.847, (238.886, 345.226, 105.206, 135.346)),
}
GPS = Constellation(
    name="GPS slot {}",
    first_number=1,
    slots={
        f"{plane}{slot}": (node, latitude)
        for plane, (node, latitudes) in GPS_PLANES.items()
        for slot, latitude in enumerate(latitudes, start=1)
    },
    table_date=date(1993, 7, 1),
    inclination_deg=55.0,
    axis_km=26_559.7,
    node_rate_deg=-4.4874e-7
    * 86400,  # the same standard's nominal almanac (Table A2-1), -4.4874e-7 deg/s
    turns=2.0,
)


def nominal_satellites(
    day: date, timescale: Timescale, constellation: Constellation = GPS
) -> tuple[EarthSatellite, ...]:
    """Return a nominal constellation's 24 satellites with elements at noon UTC of ``day``, good for that day.

    The planes precess at the published rate and the satellites keep their ground tracks, as
    real ones are held by station keeping: so the constellation stands as the table says at its date
    and never grows old. Within the day SGP4 moves them, which pulls them up to 0.1 degrees (seen from
    the Earth's centre) away by Moon and Sun; over midnight they step by less than 0.01 degrees.

    Args:
      day: in UTC.
      timescale: of Skyfield, which knows how UT1 runs.
      constellation: the published slots.
    """
    # Days of UT1 since the table's date, and days of UTC since SGP4's origin of time.
    noon = timescale.utc(day.year, day.month, day.day, 12)
    table = timescale.utc(*constellation.table_date.timetuple()[:3])
    elapsed_days = noon.ut1 - table.ut1
    sgp4_epoch = datetime(day.year, day.month, day.day, 12) - datetime(1949, 12, 31)
    motion_deg = constellation.latitude_rate_deg - constellation.perigee_rate_deg
    satellites = []
    for number, (slot, (node_deg, latitude_deg)) in enumerate(
        constellation.slots.items(), start=constellation.first_number
    ):
        model = Satrec()
        model.sgp4init(
            WGS72,
            "i",
            number,
            sgp4_epoch.total_seconds() / 86400,
            # Drag, two derivatives of the mean motion that SGP4 does not use, eccentricity, argument of perigee: on a
            # circle the mean anomaly is the argument of latitude.
            *(0.0,) * 5,
            math.radians(constellation.inclination_deg),
            math.radians((latitude_deg + constellation.latitude_rate_deg * elapsed_days) % 360),
            math.radians(motion_deg) / 1440,  # radians a minute
            math.radians((node_deg + constellation.node_rate_deg * elapsed_days) % 360),
        )
        satellite = EarthSatellite.from_satrec(model, timescale)
        satellite.name = constellation.name.format(slot)
        satellites.append(satellite)
    return tuple(satellites)
