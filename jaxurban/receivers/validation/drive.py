"""The drive of a receiver: its log, the city that it went through, and the rays from its places to satellites."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.rasterise import highest_top_m
from jaxurban.io.samples import log_of
from jaxurban.io.tracks import AZIMUTH, CN0, LAT, LON, UTC
from jaxurban.knowledge import Guesses
from jaxurban.maps.run import scenario_grid
from jaxurban.maps.scenario import Scenario
from jaxurban.progress import Report
from jaxurban.receivers.log_files import read_log
from jaxurban.receivers.rule import FARTHEST_MARGIN_M
from jaxurban.receivers.sight import Sight
from jaxurban.receivers.track import Track
from jaxurban.receivers.validation.logs import ReceiverLog, read_receiver_log, table_log
from jaxurban.receivers.validation.rinex import with_navigation
from jaxurban.receivers.validation.satellites import known_of, with_directions
from jaxurban.receivers.validation.settings import EVERYWHERE, ReceiverSettings
from jaxurban.receivers.walk import LEG_CELLS, LegSurface
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays

LOWEST_RAY_DEG = 0.1  # a ray along the horizon never rises


@dataclass(frozen=True, eq=False)
class Drive:
    """A receiver's way through a city.

    Attributes:
      log: what it recorded, a row per epoch and satellite, with azimuth and elevation in degrees.
      track: places of the log's epochs.
      city: its buildings and terrain, in the CRS of the grid.
      known: where its buildings are known, in the same CRS.
      grid: gives size and alignment of the cells, which may lie beyond it.
      mask_deg: rows with a lower elevation are left out.
      settings: systems, blocks, antenna height, and what counts as known.
      guesses: what city and sky rest on that no file says.
    """

    log: ReceiverLog
    track: Track
    city: City
    known: shapely.Geometry
    grid: Grid
    mask_deg: float
    settings: ReceiverSettings
    guesses: Guesses

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        log: str | Path | pd.DataFrame | None,
        settings: ReceiverSettings,
        navigation: str | Path | None,
        reference: str | Path | pd.DataFrame | None,
        report: Report,
    ) -> "Drive":
        """Return the drive of a log through the city of a scenario; arguments and errors as of `validate`."""
        logged = _read(scenario, log, navigation, reference)
        grid = scenario_grid(scenario)
        track = drive_track(logged.name, logged.epochs, grid, settings.sky_step_s)
        report("read")
        sight = Sight.of_scenario(scenario, grid)
        guesses = sight.city.guesses
        if AZIMUTH not in logged.satellites:
            sky = sight.task(track.sky_times, float(settings.antenna_height_m), None).sky
            logged = with_directions(logged, track, sky, grid)
            guesses += sky.guesses
        known = known_of(settings.known, sight.city, track)
        mask_deg = scenario.gps.mask_deg
        return cls(logged, track, sight.city, known, grid, mask_deg, settings, guesses)

    @property
    def is_guarded(self) -> bool:
        """Whether rays that leave what is known of the city are not judged."""
        return self.settings.known != EVERYWHERE

    @cached_property
    def rise_m(self) -> float:
        """Height of the city's highest top above the antenna."""
        return highest_top_m(self.city) - self.settings.antenna_height_m

    def rows(self) -> tuple[pd.DataFrame, Rays]:
        """Return the rows of the log above the mask, of the systems that are asked for, and the ray of each row.

        The rows have the columns ``system`` and ``block`` besides those of the log, and are numbered from 0.

        Raises:
          InputError: no such row.
        """
        log = self.log
        mask_deg = self.mask_deg
        settings = self.settings
        track = self.track
        system = log.satellites.satellite.astype(str).str[0]
        is_kept = log.satellites.elevation_deg >= max(mask_deg, LOWEST_RAY_DEG)
        if settings.systems:
            is_kept &= system.isin(list(settings.systems))
        rows = log.satellites[is_kept].assign(system=system[is_kept]).reset_index(drop=True)
        if rows.empty:
            systems = f" of the systems {', '.join(settings.systems)}" if settings.systems else ""
            raise InputError(
                f"the receiver log {log.name!r} has no satellite above the mask of {mask_deg:g} degrees{systems}: "
                "lower [gps] mask_deg, or see whether elevation_deg is in degrees"
            )

        # One turn from true to grid north serves all of the track.
        rows["block"] = (track.along_m[rows.epoch] // settings.block_m).astype(int)
        centre = float(log.epochs[LON].median()), float(log.epochs[LAT].median())
        turn_rad = self.grid.convergence_rad(*centre)
        azimuth_rad = np.radians(rows.azimuth_deg.to_numpy(float)) - turn_rad
        elevation_rad = np.radians(rows.elevation_deg.to_numpy(float))
        return rows, Rays(track.x_m[rows.epoch], track.y_m[rows.epoch], azimuth_rad, elevation_rad)

    def grounds(
        self, rows: pd.DataFrame, rays: Rays, moved_m: float = 0.0, scale: float = 1.0
    ) -> Iterator[tuple[np.ndarray, LegSurface]]:
        """Yield the numbers of the rows of each leg of the track, and the ground around that leg.

        The ground around the whole track may not fit into memory.

        Args:
          rows, rays: from `rows`.
          moved_m: how far around the track rays may begin.
          scale: that roofs may be multiplied by.
        """
        # How far away from a place a roof can still come within the margin of the lowest ray.
        highest_m = max(self.rise_m * scale, 0.0) + FARTHEST_MARGIN_M
        reach_m = highest_m / np.tan(rays.elevation_rad.min())
        antenna_m = self.settings.antenna_height_m
        for leg in self.track.legs(self.grid, LEG_CELLS):
            box = self.track.box(self.grid, leg)
            ground = LegSurface.around(self.city, box, moved_m, reach_m, antenna_m)
            yield np.flatnonzero(rows.epoch.isin(leg)), ground


def drive_track(name: str, epochs: pd.DataFrame, grid: Grid, sky_step_s: float) -> Track:
    """Return the track of a log's epochs; all epochs within a window of ``sky_step_s`` seconds share one sky.

    The first window begins at the first epoch. A window has the sky of its middle, and none if it has no epoch.

    Args:
      name: of the log, for messages.
      epochs: in order of time, with longitude and latitude.
      grid: that holds all places.
      sky_step_s: length of a window.

    Raises:
      InputError: a place outside the grid.
    """
    lon_deg = epochs[LON].to_numpy()
    lat_deg = epochs[LAT].to_numpy()
    x_m, y_m = grid.xy_of_lonlat(lon_deg, lat_deg)
    is_inside = grid.contains_xy(x_m, y_m)
    if not is_inside.all():
        num = int((~is_inside).sum())
        spans = (
            f"{lon_deg.min():.4f}, {lat_deg.min():.4f}, {lon_deg.max():.4f}, {lat_deg.max():.4f}"
        )
        raise InputError(
            f"{num} of the {len(is_inside)} places of the receiver log {name!r} lie outside "
            "the region: remove these rows, see whether lon_deg and lat_deg are swapped, or let [region] bounds of "
            f"the scenario hold the track, [{spans}] and some metres around it"
        )

    # The windows, by their number since the first epoch, and the UTC time in the middle of each.
    first = epochs[UTC].iloc[0]
    elapsed_s = (epochs[UTC] - first).dt.total_seconds().to_numpy()
    windows, sky = np.unique((elapsed_s // sky_step_s).astype(np.int64), return_inverse=True)
    to_middles = pd.to_timedelta((windows + 0.5) * sky_step_s, "s")
    times = (first + to_middles).round("s").strftime("%Y-%m-%dT%H:%M:%SZ")
    return Track(x_m, y_m, sky, tuple(times))


def _read(
    scenario: Scenario,
    log: str | Path | pd.DataFrame | None,
    navigation: str | Path | None,
    reference: str | Path | pd.DataFrame | None,
) -> ReceiverLog:
    """Return the log that the arguments of `validate` name: a table, a receiver's file, or a sample city's own log.

    Args:
      scenario: its sample city, if it has one, gives the log that is left out.
      log, navigation, reference: as in `validate`.

    Raises:
      InputError: a table with navigation or reference, there is no log, or it cannot be read.
    """
    source = log_of(scenario.buildings.source) if log is None else log
    table = read_log(source, reference) if isinstance(source, str | Path) else None
    if table is not None:
        if navigation is None or CN0 not in table:
            return table_log(table, str(source))
        return with_navigation(table, navigation, str(source))
    if navigation is not None or reference is not None:
        raise InputError(
            "navigation and reference are of a receiver's own log (RINEX, NMEA, GnssLogger): name it as log"
        )
    if source is None:
        raise InputError(
            "log is left out, and only a sample city with a log of its own has one: name the file"
        )
    return read_receiver_log(source)
