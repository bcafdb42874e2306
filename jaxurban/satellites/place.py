"""The sky at a place: which satellites the city hides there, behind which roof, and what is left."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.checks import positive, typed
from jaxurban.maps.sources import CityLike
from jaxurban.metrics.gps import FIX, Gps
from jaxurban.paths.places import Point
from jaxurban.public import Caution, FactsRepr, listed
from jaxurban.satellites.rule import STATES
from jaxurban.satellites.sight import By, Sight, cautions_of, xy_of
from jaxurban.settings import as_tuple


@dataclass(frozen=True, eq=False, repr=False)
class SkyAt(FactsRepr):
    """The sky at a place, at one or several times.

    Attributes:
      lonlat: longitude, latitude of the place, degrees.
      altitude_m: above the ground there.
      by: ``"outlines"``, exact rays through outlines, or ``"map"``, the kernel of the maps in the cell of the place.
      table: a row per time and satellite above the mask: ``time`` (UTC), ``satellite``, ``system``, ``azimuth_deg``
        from true and ``grid_azimuth_deg`` from grid north, clockwise, ``elevation_deg``, ``state``: ``"seen"``,
        ``"hidden"`` or ``"unknown"``, as its ray leaves the known buildings or terrain before it is above all roofs.
        By outlines also ``margin_m``, how far the ray is above the roof (or below the floor of what hangs) that it
        clears by least: 0 or less where it is hidden, inf from 60 m on, NaN where it is unknown; and of the roof that
        hides it, NaN for others, ``roof_height_m`` above its ground (NaN: the ground hides it), ``roof_distance_m``
        along the ground to where the ray enters the outline, ``roof_lon`` and ``roof_lat`` of that place, and
        ``roof_is_guessed``.
      dops: a row per time: ``time``, ``num_visible``, ``num_hidden``, ``num_unknown``, ``gdop``, ``pdop``, ``hdop``,
        ``vdop``, ``tdop`` of the satellites that are seen, with a clock for each system; inf without a fix. By the map
        ``num_visible`` and the DOPs are those of the map, which counts unknown ones as clear.
      cautions: what whoever uses it must know.
      attribution: whom to credit for the city.

    Examples:
      >>> here = ju.sky(city, (-73.971, 40.7795), 20.0)
      >>> here.dops[["num_visible", "num_hidden", "num_unknown"]].to_numpy().tolist()
      [[1, 0, 6]]
    """

    lonlat: tuple[float, float]
    altitude_m: float
    by: By
    table: pd.DataFrame
    dops: pd.DataFrame
    cautions: list[Caution]
    attribution: str
    _sight: Sight = field(repr=False)

    @property
    def times(self) -> tuple[str, ...]:
        """The times, UTC."""
        return tuple(self.dops["time"])

    @property
    def facts(self) -> dict[str, str]:
        """Place, height, times, how it was computed, and how many satellites are seen, hidden and unknown."""
        lon, lat = self.lonlat
        counts = [f"{(self.table['state'] == state).sum()} {state}" for state in STATES]
        return {
            "place": f"{lon:.6f}, {lat:.6f}",
            "altitude": f"{self.altitude_m:g} m above ground",
            "times": listed(self.times),
            "by": self.by,
            "satellites": ", ".join(counts),
            "HDOP": listed([f"{value:.3g}" for value in self.dops[FIX]]),
            "credit": self.attribution,
        }

    @cached_property
    def horizon_deg(self) -> np.ndarray:
        """``[360]`` elevation in degrees up to which buildings and hills fill the sky, by outlines.

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
    by: By = "outlines",
    gps: Gps | None = None,
    sources: str | Path | None = None,
    resolution_m: float | None = None,
) -> SkyAt:
    """Return which satellites are seen from a place, which roof hides the others, DOPs, and the horizon.

    By outlines every ray is followed through the exact outlines of the city (of a raster of roofs every metre, of
    terrain every 5 m), with satellites as the place sees them. By the map the answer is that of the maps' kernel in
    the cell that holds the place: at its centre it is the map's own.

    A ray that leaves the known buildings or terrain before it is above all roofs is unknown, whatever it meets. In a
    building all that is not unknown is hidden.

    Args:
      where: a `City`; or maps that were opened from a folder, or the folder, whose city is read again from the files
        that their run recorded, if these have not changed.
      place: longitude, latitude in degrees, or an `XY` in the CRS of the city.
      altitude_m: above the ground.
      time: UTC, one or several; left out, those of the maps, or of the city's own satellites.
      by: ``"outlines"`` or ``"map"``.
      gps: satellites and elevation mask; left out, those of the maps or of the city.
      sources: folder of the files that the run recorded; left out, they are looked for beside the maps.
      resolution_m: of the maps, for ``by="map"``; left out, 5 m of a city, of a folder its first.

    Returns:
      `SkyAt`: a table of satellites, DOPs by time, and the horizon.

    Raises:
      InputError: no such place or time, an altitude that is not above 0, no satellite above the mask, files that are
        gone or were changed, maps in memory, or by the map a place beyond its region.

    Examples:
      >>> here = ju.sky(city, (-73.971, 40.7795), 20.0)
      >>> list(here.table)[:7]
      ['time', 'satellite', 'system', 'azimuth_deg', 'grid_azimuth_deg', 'elevation_deg', 'state']
    """
    sight = Sight.of(where, gps, sources, resolution_m, by)
    return sky_from(sight, place, altitude_m, time=time, by=by)


def sky_from(
    sight: Sight, place: Point, altitude_m: float, *, time: Any = None, by: By = "outlines"
) -> SkyAt:
    """Return the sky at a place of a city that is read already.

    Args:
      sight: the city, and how maps of it are made.
      place, altitude_m, time, by: as for `sky`, with its errors.
    """
    positive("altitude_m", altitude_m)
    xy_m = xy_of("place", [place], sight.region)
    times = None if time is None else as_tuple(time)
    look = sight.look(by, xy_m, altitude_m, times)
    cautions = cautions_of(sight, look, by, xy_m)

    # The tables of the look, which nobody else holds, get the times of their rows.
    utc = np.array(look.task.sky.times)
    look.rows.insert(0, "time", utc[look.epoch])
    look.dops.insert(0, "time", utc)
    lon, lat = sight.region.lonlat_of_xy(*xy_m[:, 0].tolist())
    credit = sight.city.attribution
    return SkyAt((lon, lat), altitude_m, by, look.rows, look.dops, cautions, credit, sight)
