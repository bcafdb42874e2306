"""The satellites of a receiver's log over a city: the margin of each ray to the shadow's edge, and which are known.

Legend: ``N`` epochs of the log, ``R`` its rows, an epoch and a satellite each, ``Y, X`` cells.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import shapely

from jaxurban.io.city import City
from jaxurban.io.read.orbits import matching
from jaxurban.io.read.rasterise import rasterise, surface_grid
from jaxurban.io.read.vector import open_frame
from jaxurban.kernels.shadows.rays import Walks, shadows_at, walks
from jaxurban.maps.track import NUM_VISIBLE, Track
from jaxurban.settings import TO_GROUND
from jaxurban.studies.receiver.logs import (
    AZIMUTH,
    CN0,
    ELEVATION,
    EPOCH,
    SATELLITE,
    TRACKED,
    ReceiverLog,
)
from jaxurban.studies.receiver.prediction import EVERYWHERE, OF_CITY
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays
from jaxurban.world.sky import Sky
from jaxurban.world.surface import stands_at

LEG_CELLS = 4_000_000  # of the box around a leg of the track
# `ReceptionCurve` cuts margins there: what stands farther from the line is not looked for.
FARTHEST_MARGIN_M = 60.0
HORIZON_DEG = np.arange(360.0)


@dataclass(frozen=True, eq=False)
class Ground:
    """Roofs and terrain around a leg of a track. What hangs is taken to reach the ground.

    Attributes:
      grid: of the cells.
      roof_m: ``[Y, X]`` highest roof above the ground of its cell, 0 without one.
      terrain_m: ``[Y, X]`` elevation; None where the ground is flat.
      has_data: ``[Y, X]`` bool; None where all cells have.
      antenna_m: height of the receiver above the ground.
    """

    grid: Grid
    roof_m: np.ndarray
    terrain_m: np.ndarray | None
    has_data: np.ndarray | None
    antenna_m: float

    @classmethod
    def around(cls, city: City, box: Grid, reach_m: float, antenna_m: float) -> "Ground":
        """Return the ground of a box, and of what stands within ``reach_m`` of it on each side.

        Args:
          city: its buildings and terrain; parts that hang, as bridges do, are taken to reach the ground.
          box: the cells that hold the track.
          reach_m: as far as a building can hide a satellite.
          antenna_m: height of the receiver above the ground.
        """
        whole = replace(city, blocks=None, hanging=TO_GROUND)
        surface = rasterise(whole, surface_grid(city, box, box.resolution_m, (reach_m,) * 4))
        return cls(
            grid=surface.grid,
            roof_m=np.asarray(surface.roof_m),
            terrain_m=None if surface.terrain_m is None else np.asarray(surface.terrain_m),
            has_data=None if surface.has_data is None else np.asarray(surface.has_data),
            antenna_m=antenna_m,
        )

    @cached_property
    def _most_m(self) -> float:
        """How far a ray must rise to be `FARTHEST_MARGIN_M` above all."""
        climb_m = 0.0 if self.terrain_m is None else float(np.ptp(self.terrain_m))
        return float(self.roof_m.max(initial=0.0)) + climb_m + FARTHEST_MARGIN_M

    @cached_property
    def _tops_m(self) -> jax.Array:
        """Tops of roofs, -inf where none is: flat ground throws no shadow of its own."""
        bottom_m = 0.0 if self.terrain_m is None else self.terrain_m
        return jax.device_put(
            np.where(self.roof_m > 0, bottom_m + self.roof_m, -np.inf).astype(np.float32)
        )

    @cached_property
    def _hills_m(self) -> jax.Array:
        return jax.device_put(self.terrain_m)

    @cached_property
    def _gaps_m(self) -> jax.Array:
        """0 where no data are, -inf elsewhere."""
        assert self.has_data is not None
        return jax.device_put(np.where(self.has_data, -np.inf, 0.0).astype(np.float32))

    def with_roofs(self, scale: float) -> "Ground":
        """Return the ground with the height of all roofs multiplied by a factor."""
        return replace(self, roof_m=np.float32(scale) * self.roof_m)

    def is_inside(self, rays: Rays) -> np.ndarray:
        """Return ``[R]`` which places lie in a building."""
        return stands_at(self.roof_m[self.grid.cell_of_xy(rays.x_m, rays.y_m)], self.antenna_m)

    def margins_m(self, rays: Rays) -> np.ndarray:
        """Return ``[R]`` metres by which the antenna of each ray lies above the edge of the shadow of roofs and hills.

        Below 0 a roof or a hill hides the satellite. Margins of `FARTHEST_MARGIN_M` or more are +inf. Terrain counts
        only where it hides: a ray that passes near over a hill keeps the margin of the roofs.

        Args:
          rays: from places in the box.
        """
        # [R] the height of the shadow's edge at each place, and of the antenna, both above the same level.
        row, col, lines = self._lines(rays)
        shadow_m = shadows_at(self._tops_m, row, col, lines, self._most_m)
        height_m = np.float32(self.antenna_m)
        if self.terrain_m is not None:
            height_m = self.terrain_m[row, col] + height_m

            # The shadow of the ground alone counts where it lies above the antenna.
            hill_m = shadows_at(self._hills_m, row, col, lines, self._most_m)
            shadow_m = np.maximum(shadow_m, np.where(hill_m > height_m, hill_m, -np.inf))
        margin_m = height_m - shadow_m
        return np.where(margin_m < FARTHEST_MARGIN_M, margin_m, np.inf)

    def crosses_gap(self, rays: Rays, rise_m: float) -> np.ndarray:
        """Return ``[R]`` which rays begin over a cell without data, or cross one before they rise by ``rise_m``."""
        if self.has_data is None:
            return np.zeros(len(rays.x_m), bool)
        row, col, lines = self._lines(rays)
        gap_m = shadows_at(self._gaps_m, row, col, lines, max(rise_m, 0.0))
        return ~self.has_data[row, col] | (gap_m > -np.inf)

    def _lines(self, rays: Rays) -> tuple[np.ndarray, np.ndarray, Walks]:
        """Return rows and columns of the places, and the digital lines of the rays."""
        row, col = self.grid.cell_of_xy(rays.x_m, rays.y_m)
        start = row + self.grid.first_row, col + self.grid.first_col
        return row, col, walks(rays.azimuth_rad, rays.elevation_rad, self.grid.resolution_m, *start)

    def horizon_deg(self, x_m: float, y_m: float) -> np.ndarray:
        """Return ``[360]`` elevation of roofs and hills, degrees above 0, at each degree of grid azimuth from a place.

        A picture of the horizon, not a judgement: cells are sampled one cell apart along each azimuth.
        """
        # [steps, 360] the cells at each distance, in cell sides, and azimuth, those beyond the grid moved to its edge.
        row, col = map(int, self.grid.cell_of_xy(x_m, y_m))
        away = np.arange(1, max(self.grid.shape))[:, None]
        azimuth_rad = np.radians(HORIZON_DEG)
        rows = np.rint(row + away * np.cos(azimuth_rad)).astype(int)
        cols = np.rint(col + away * np.sin(azimuth_rad)).astype(int)
        cells = rows.clip(0, self.grid.num_rows - 1), cols.clip(0, self.grid.num_cols - 1)
        is_on_grid = (cells[0] == rows) & (cells[1] == cols)

        # How high each stands above the antenna; beyond the grid nothing does.
        above_m = self.roof_m[cells] - self.antenna_m
        if self.terrain_m is not None:
            above_m += self.terrain_m[cells] - self.terrain_m[row, col]
        angle_rad = np.arctan2(np.where(is_on_grid, above_m, 0.0), away * self.grid.resolution_m)
        return np.degrees(angle_rad.max(axis=0, initial=0.0))


def legs(x_m: np.ndarray, y_m: np.ndarray, resolution_m: float) -> Iterator[slice]:
    """Yield runs of consecutive epochs whose places lie in one box of at most `LEG_CELLS` cells.

    Each run holds one epoch at least, and together they hold all.

    Args:
      x_m, y_m: ``[N]`` place of each epoch.
      resolution_m: side of a cell.
    """
    # The first epoch of the run, and the southwest and northeast corners of its box.
    first = 0
    low = np.array([np.inf, np.inf])
    high = np.array([-np.inf, -np.inf])
    for number, place in enumerate(np.column_stack([x_m, y_m])):
        # The box of the run with this epoch; where it is too large the run ends before it.
        low = np.minimum(low, place)
        high = np.maximum(high, place)
        if number > first and np.prod((high - low) / resolution_m + 1) > LEG_CELLS:
            yield slice(first, number)
            first = number
            low = high = place
    yield slice(first, len(x_m))


def box_of(grid: Grid, rays: Rays, around_m: float) -> Grid:
    """Return the cells, aligned with a grid, that hold the places of rays and ``around_m`` metres on each side."""
    low_m = np.array([rays.y_m.min(), rays.x_m.min()]) - around_m
    high_m = np.array([rays.y_m.max(), rays.x_m.max()]) + around_m
    first = np.floor(low_m / grid.resolution_m).astype(int)
    last = np.floor(high_m / grid.resolution_m).astype(int)
    return Grid(grid.crs, grid.resolution_m, *first.tolist(), *(last - first + 1).tolist())


def known_of(known: str | float | Path, city: City, track: Track) -> shapely.Geometry:
    """Return where the buildings of a city are known, as a geometry in its CRS.

    Args:
      known: as in `ReceiverSettings`: what the city's file covers, or all; a file of polygons; or metres around the
        places of the track.
      city: of the buildings.
      track: its places.

    Raises:
      InputError: a file of polygons that cannot be read.
    """
    if known in (OF_CITY, EVERYWHERE):
        return city.known_ground
    if isinstance(known, str | Path):
        frame = open_frame(known, "known area").to_crs(city.crs)
        return shapely.union_all(frame.geometry.to_numpy())
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
    assert rows is not None
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
    left_out = {**log.left_out, **dict.fromkeys(names, "no orbit of [gps] orbits has its name")}
    result = rows.assign(**angles)
    return replace(log, satellites=result[is_up].reset_index(drop=True), left_out=left_out)


def counted(
    rows: pd.DataFrame, num_epochs: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return how many satellites each epoch sees by the maps, and how many the receiver tracks.

    Both are ``[N]`` float, by the name of their column, and count judged rows only. An epoch without a judged row has
    NaN.

    Args:
      rows: of a `jaxurban.studies.receiver.agreement.SatelliteAgreement`.
      num_epochs: N.
    """
    judged = rows[rows.is_judged]
    columns = {NUM_VISIBLE: judged.is_seen, TRACKED: judged[CN0] > 0}
    table = pd.DataFrame(columns).groupby(judged.epoch).sum().reindex(range(num_epochs))
    in_view, received = ({name: table[name].to_numpy(float)} for name in columns)
    return in_view, received
