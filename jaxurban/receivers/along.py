"""The sky at a place, at one or several times, and along a track: what the city hides, and what is left."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pandas as pd

from jaxurban.checks import one_of, positive, typed
from jaxurban.errors import InputError
from jaxurban.io.orbits import rinex_name
from jaxurban.io.tracks import ALTITUDE, CN0, LAT, LON, SATELLITE, UTC, track_of
from jaxurban.knowledge import Caution
from jaxurban.maps.sources import CityLike
from jaxurban.metrics.gps import FIX, Gps, has_no_fix
from jaxurban.paths.lines import along_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY, Point
from jaxurban.pictures import Form
from jaxurban.public import FactsRepr, listed
from jaxurban.receivers.rule import STATES
from jaxurban.receivers.sight import Sight, cautions_of, xy_of
from jaxurban.settings import as_tuple, parse_time


@dataclass(frozen=True, eq=False, repr=False)
class SkyAt(FactsRepr):
    """The sky at a place, at one or several times.

    Attributes:
      lonlat: longitude, latitude of the place, degrees.
      altitude_m: above the ground there.
      table: a row per time and satellite above the mask: ``time`` (UTC), ``satellite``, ``system``, ``azimuth_deg``
        from true and ``grid_azimuth_deg`` from grid north, clockwise, ``elevation_deg``, ``state``: ``"seen"``,
        ``"hidden"`` or ``"unknown"``, as its ray leaves the known buildings or terrain before it is above all roofs.
        ``margin_m``, how far the ray is above the roof (or below the floor of what hangs) that it
        clears by least: 0 or less where it is hidden, inf from 60 m on, NaN where it is unknown; and of the roof that
        hides it, NaN for others, ``roof_height_m`` above its ground (NaN: the ground hides it), ``roof_distance_m``
        along the ground to where the ray enters the outline, ``roof_lon`` and ``roof_lat`` of that place, and
        ``roof_is_guessed``.
      dops: a row per time: ``time``, ``num_visible``, ``num_hidden``, ``num_unknown``, ``gdop``, ``pdop``, ``hdop``,
        ``vdop``, ``tdop`` of the satellites that are seen, with a clock for each system; inf without a fix.
      cautions: what whoever uses it must know.
      attribution: whom to credit for the city.

    Examples:
      >>> here = ju.sky(city, (-73.971, 40.7795), 20.0)
      >>> here.dops[["num_visible", "num_hidden", "num_unknown"]].to_numpy().tolist()
      [[0, 1, 6]]
    """

    lonlat: tuple[float, float]
    altitude_m: float
    table: pd.DataFrame
    dops: pd.DataFrame
    cautions: list[Caution]
    attribution: str
    _sight: Sight = field(repr=False)

    @property
    def times(self) -> tuple[str, ...]:
        """The times, UTC."""
        return tuple(self.dops["time"])

    def at(self, time: str) -> "SkyAt":
        """Return the sky at one of its times, of which alone the cautions speak.

        Returns:
          `SkyAt` with the rows of that time.

        Raises:
          InputError: no such time.

        Examples:
          >>> here = ju.sky(city, (-73.971, 40.7795), 20.0)
          >>> here.at(here.times[0]).facts["satellites"]
          '0 seen, 1 hidden, 6 unknown'
        """
        one_of("time", time, self.times)
        return sky_from(self._sight, self.lonlat, self.altitude_m, time=time)

    @typed
    def plot(self, time: str | None = None, **form: Unpack[Form]) -> Any:
        """Return a picture of the sky at a time: the horizon, and which satellites are seen and hidden.

        Args:
          time: one of its times; the first, if left out.
          form: width, ax and title, as in `MetricMaps.plot`.

        Returns:
          A Matplotlib figure, which a notebook shows.

        Raises:
          InputError: no such time.

        Examples:
          >>> ju.sky(city, (-73.971, 40.7795), 20.0).plot().savefig("sky.png")
        """
        from jaxurban import plot  # imported here: it brings Matplotlib

        return plot.plot_sky(self, time, **form)

    @property
    def facts(self) -> dict[str, str]:
        """Place, height, times, and how many satellites are seen, hidden and unknown."""
        lon, lat = self.lonlat
        counts = [f"{(self.table['state'] == state).sum()} {state}" for state in STATES]
        return {
            "place": f"{lon:.6f}, {lat:.6f}",
            "altitude": f"{self.altitude_m:g} m above ground",
            "times": listed(self.times),
            "satellites": ", ".join(counts),
            "HDOP": listed([f"{value:.3g}" for value in self.dops[FIX]]),
            "credit": self.attribution,
        }

    @cached_property
    def horizon_deg(self) -> np.ndarray:
        """``[360]`` elevation in degrees up to which buildings and hills fill the sky.

        At each whole degree of azimuth, clockwise from true north; at least the elevation mask, or 1 degree where that
        is lower. NaN where a ray along the horizon leaves what is known.
        """
        sight = self._sight
        mask_deg = sight.params.gps.mask_deg
        return sight.hiding.horizon_deg(sight.region, self.lonlat, self.altitude_m, mask_deg)


@typed
def sky(
    where: CityLike,
    place: Point,
    altitude_m: float,
    *,
    time: str | Sequence[str] | None = None,
    gps: Gps | None = None,
    sources: str | Path | None = None,
) -> SkyAt:
    """Return which satellites are seen from a place, which roof hides the others, DOPs, and the horizon.

    Every ray is followed through the exact outlines of the city (of a raster of roofs every metre, of terrain every
    5 m), with satellites as the place sees them.

    A ray that leaves the known buildings or terrain before it is above all roofs is unknown, whatever it meets. In a
    building all that is not unknown is hidden.

    Args:
      where: a `City`; or maps that were opened from a folder, or the folder, whose city is read again from the files
        that their run recorded, if these have not changed.
      place: longitude, latitude in degrees, or an `XY` in the CRS of the city.
      altitude_m: above the ground.
      time: UTC, one or several; left out, those of the maps, or of the city's own satellites.
      gps: satellites and elevation mask; left out, those of the maps or of the city.
      sources: folder of the files that the run recorded; left out, they are looked for beside the maps.

    Returns:
      `SkyAt`: a table of satellites, DOPs by time, and the horizon.

    Raises:
      InputError: no such place or time, an altitude that is not above 0, no satellite above the mask, files that are
        gone or were changed, or maps in memory.

    Examples:
      >>> here = ju.sky(city, (-73.971, 40.7795), 20.0)
      >>> list(here.table)[:7]
      ['time', 'satellite', 'system', 'azimuth_deg', 'grid_azimuth_deg', 'elevation_deg', 'state']
    """
    sight = Sight.of(where, gps, sources)
    return sky_from(sight, place, altitude_m, time=time)


def sky_from(sight: Sight, place: Point, altitude_m: float, *, time: Any = None) -> SkyAt:
    """Return the sky at a place of a city that is read already.

    Args:
      sight: the city, and how maps of it are made.
      place, altitude_m, time: as for `sky`, with its errors.
    """
    positive("altitude_m", altitude_m)
    xy_m = xy_of("place", [place], sight.region)
    times = None if time is None else as_tuple(time)
    look = sight.look(xy_m, altitude_m, times)
    cautions = cautions_of(sight, look, xy_m)

    # The tables of the look, which nobody else holds, get the times of their rows.
    utc = np.array(look.sky.times)
    look.rows.insert(0, "time", utc[look.epoch])
    look.dops.insert(0, "time", utc)
    lonlat = sight.region.lonlat_of_xy(*xy_m[:, 0].tolist())
    credit = sight.city.attribution
    return SkyAt(lonlat, altitude_m, look.rows, look.dops, cautions, credit, sight)


@dataclass(frozen=True, eq=False, repr=False)
class SkyAlong(FactsRepr):
    """The sky along a track.

    Attributes:
      table: a row a place: ``time`` (UTC), ``lon``, ``lat``, ``altitude_m``, ``num_visible``, ``num_hidden``,
        ``num_unknown``, ``gdop``, ``pdop``, ``hdop``, ``vdop``, ``tdop`` (inf without a fix) and ``has_fix``; as
        `SkyAt.dops` has them.
      satellites: a row a place and satellite above the mask: ``utc``, ``lon_deg`` and ``lat_deg`` of the place, and the
        columns of `SkyAt.table` from ``satellite`` on; with a receiver's log also ``cn0_dbhz``, NaN where the log does
        not name the satellite.
      cautions: what whoever uses it must know.
      attribution: whom to credit for the city.

    Examples:
      >>> along = ju.sky_along(city, [start, goal], 60.0, "2020-04-27T16:00:00Z")
      >>> along.table[["num_visible", "has_fix"]].to_numpy().tolist()
      [[2, False], [3, False]]
    """

    table: pd.DataFrame
    satellites: pd.DataFrame
    cautions: list[Caution]
    attribution: str

    @property
    def facts(self) -> dict[str, str]:
        """Places, times, how many satellites are seen, and where no fix is known."""
        table = self.table
        return {
            "places": f"{len(table):,}",
            "times": listed(list(dict.fromkeys(table["time"]))),
            "satellites seen": f"{table['num_visible'].mean():.1f} in the mean",
            "no fix, or none known": f"{(~table['has_fix']).mean():.0%} of places",
            "credit": self.attribution,
        }


@typed
def sky_along(
    where: CityLike,
    places: PlannedPath | pd.DataFrame | Sequence[Point],
    altitude_m: float | Sequence[float] | None = None,
    times: str | Sequence[str] | None = None,
    *,
    speed_m_s: float | None = None,
    gps: Gps | None = None,
    sources: str | Path | None = None,
) -> SkyAlong:
    """Return how many satellites are seen along a track, and the DOPs: a flight's log, or a route at its speed.

    Args:
      where, gps, sources: as for `sky`.
      places: longitude, latitude in degrees, or an `XY`, each; a path from `plan`; or a table of the columns ``utc``,
        ``lon_deg``, ``lat_deg`` and, if ``altitude_m`` is left out, ``altitude_m``; one with ``satellite``, a
        receiver's log, has several rows a place.
      altitude_m: above the ground, of all places or of each; left out, that of a path or a table.
      times: UTC of each place, to the second, or one for all; with a speed, that of departure. Left out, those of a
        table, else the first of the maps or of the city's own satellites.
      speed_m_s: the places are the corners of a route that is flown at this speed in straight legs, and the table has
        a row for each of its seconds.

    Returns:
      `SkyAlong`: a table with a row a place, in their order.

    Raises:
      InputError: as of `sky`; numbers of places, altitudes and times that differ, or no place.

    Examples:
      >>> flown = ju.sky_along(city, path, times="2020-04-27T16:00:00Z", speed_m_s=10.0)
      >>> len(flown.table), list(flown.table)[:4]
      (86, ['time', 'lon', 'lat', 'altitude_m'])
    """
    sight = Sight.of(where, gps, sources)
    heard = None

    # Places, heights and times, each as many as were given.
    if isinstance(places, PlannedPath):
        if altitude_m is None:
            altitude_m = places.z_m.tolist()
        places = [XY(*xy_m) for xy_m in places.xy_m.tolist()]
    elif isinstance(places, pd.DataFrame):
        table = track_of(places, "the table of places")
        if SATELLITE in table:
            is_of_place = table.groupby([UTC, LON, LAT], sort=False)
            if CN0 in table:
                heard = table.groupby([is_of_place.ngroup(), SATELLITE], observed=True)[CN0].max()
            table = is_of_place.head(1)
        if altitude_m is None and ALTITUDE in table:
            altitude_m = table[ALTITUDE].tolist()
        if times is None:
            times = table[UTC].tolist()
        places = list(zip(table[LON], table[LAT], strict=True))
    if altitude_m is None:
        raise InputError("altitude_m is missing: give metres above the ground")
    x_m, y_m = xy_of("places", places, sight.region)
    z_m = np.array([positive("altitude_m", value) for value in as_tuple(altitude_m)])
    if times is None:
        times = sight.task(None, float(z_m.min()), None).sky.times[0]
    utc = pd.to_datetime([parse_time(time) for time in as_tuple(times)]).round("s")
    if len({1, len(x_m), len(z_m)}) > 2 or len({1, len(x_m), len(utc)}) > 2:
        raise InputError(
            f"altitude_m and times must be one for all {len(x_m)} places or one for each, got {len(z_m)} and {len(utc)}"
        )
    x_m, y_m, z_m = np.broadcast_arrays(x_m, y_m, z_m)

    # A route that is flown at a speed has a place a second instead.
    if speed_m_s is not None:
        positive("speed_m_s", speed_m_s)
        if len(utc) > 1:
            raise InputError(
                "with speed_m_s times must be one, of departure: leave one of the two out"
            )
        x_m, y_m, z_m, elapsed_s = _flown(np.stack([x_m, y_m, z_m]), speed_m_s)
        utc = (utc[0] + pd.to_timedelta(elapsed_s, "s")).round("s")

    # What the places see, each under the sky of its time.
    time_of_place = np.broadcast_to(utc.strftime("%Y-%m-%dT%H:%M:%SZ"), len(x_m))
    sky_times, sky = np.unique(time_of_place, return_inverse=True)
    xy_m = np.stack([x_m, y_m])
    look = sight.look(xy_m, z_m, sky_times.tolist(), sky)
    lon, lat = sight.region.lonlat_of_xy(x_m, y_m)
    table = pd.DataFrame({"time": time_of_place, "lon": lon, "lat": lat, "altitude_m": z_m})
    table = table.join(look.dops).assign(has_fix=~has_no_fix(look.dops[FIX].to_numpy()))
    moments = table.iloc[look.epoch, :3].set_axis([UTC, LON, LAT], axis="columns")
    satellites = moments.reset_index(drop=True).join(look.rows)
    if heard is not None:
        names = look.rows["satellite"].map(rinex_name)
        keys = pd.MultiIndex.from_arrays([look.epoch, names])
        satellites[CN0] = heard.reindex(keys).to_numpy()
    return SkyAlong(table, satellites, cautions_of(sight, look, xy_m), sight.city.attribution)


def _flown(corners_m: np.ndarray, speed_m_s: float) -> np.ndarray:
    """Return ``[4, N]`` x, y, z in metres and the time in seconds at each second of a flight, and at its end.

    Args:
      corners_m: ``[3, K]`` x, y, z of the corners, between which the flight is straight.
      speed_m_s: of the flight.
    """
    corner_s = along_of(corners_m.T) / speed_m_s
    end_s = corner_s[-1]
    elapsed_s = np.append(np.arange(0.0, end_s), end_s)
    xyz_m = [np.interp(elapsed_s, corner_s, values_m) for values_m in corners_m]
    return np.stack([*xyz_m, elapsed_s])
