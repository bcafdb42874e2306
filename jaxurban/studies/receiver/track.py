"""The way of a receiver over a grid: distances along it, pieces, blocks, and the skies that it was under."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.read.receiver import LAT, LON, UTC, ReceiverLog
from jaxurban.world.grid import Grid


@dataclass(frozen=True, eq=False)
class Track:
    """Where a receiver was, epoch by epoch. ``N`` epochs, ``T`` skies.

    Attributes:
      x_m, y_m: ``[N]`` places in the grid's CRS.
      row, col: ``[N]`` the grid's cells that hold them.
      sky: ``[N]`` number of the sky of each epoch, not falling.
      sky_times: ``[T]`` UTC times of the skies, whole seconds, ISO 8601 with a trailing ``Z``.
    """

    x_m: np.ndarray
    y_m: np.ndarray
    row: np.ndarray
    col: np.ndarray
    sky: np.ndarray
    sky_times: tuple[str, ...]

    @classmethod
    def of(cls, log: ReceiverLog, grid: Grid, sky_step_s: float) -> "Track":
        """Return the track of a log, its time cut into windows of ``sky_step_s`` with a sky in the middle of each.

        Raises:
          InputError: a place outside the grid.
        """
        lon_deg, lat_deg = (log.epochs[name].to_numpy() for name in (LON, LAT))
        x_m, y_m = grid.xy_of_lonlat(lon_deg, lat_deg)
        _check_inside(log, grid, grid.contains_xy(x_m, y_m))
        row, col = grid.cell_of_xy(x_m, y_m)
        first = log.epochs[UTC].iloc[0]
        window = ((log.epochs[UTC] - first).dt.total_seconds().to_numpy() // sky_step_s).astype(np.int64)
        numbers, sky = np.unique(window, return_inverse=True)
        middles = [(first + pd.Timedelta(seconds=(number + 0.5) * sky_step_s)).round("s") for number in numbers]
        return cls(x_m, y_m, row, col, sky, tuple(f"{time:%Y-%m-%dT%H:%M:%S}Z" for time in middles))

    @cached_property
    def along_m(self) -> np.ndarray:
        """``[N]`` distance from the first epoch along the track."""
        return np.cumsum(np.hypot(np.diff(self.x_m, prepend=self.x_m[0]), np.diff(self.y_m, prepend=self.y_m[0])))

    @property
    def length_m(self) -> float:
        """From the first epoch to the last along the track."""
        return float(self.along_m[-1])

    def cut(self, length_m: float) -> np.ndarray:
        """Return ``[N]`` the number of the piece of track of a length that each epoch lies on."""
        return (self.along_m // length_m).astype(np.int64)


def _check_inside(log: ReceiverLog, grid: Grid, is_inside: np.ndarray) -> None:
    if is_inside.all():
        return
    lon_deg, lat_deg = (log.epochs[name].to_numpy() for name in (LON, LAT))
    (west, south), (east, north) = (
        grid.lonlat_of_xy(x_m, y_m) for x_m, y_m in ((grid.x_min_m, grid.y_min_m), (grid.x_max_m, grid.y_max_m))
    )
    with np.errstate(invalid="ignore"):
        is_swapped = not is_inside.any() and grid.contains_xy(*grid.xy_of_lonlat(lat_deg, lon_deg)).all()
    remedy = (
        "lon_deg and lat_deg are swapped"
        if is_swapped
        else (
            "remove these rows, or let [region] bounds hold the track: "
            f"[{lon_deg.min():.4f}, {lat_deg.min():.4f}, {lon_deg.max():.4f}, {lat_deg.max():.4f}] and some "
            "metres around it"
        )
    )
    raise InputError(
        f"{int((~is_inside).sum())} of the {len(is_inside)} places of the receiver log {log.name!r} lie outside the "
        f"scenario's region, which spans about {west:.4f} to {east:.4f} and {south:.4f} to {north:.4f}: {remedy}"
    )
