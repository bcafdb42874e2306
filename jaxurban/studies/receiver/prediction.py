"""How a receiver's log is set against maps, and what maps at its times and its antenna's height are made of."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError
from jaxurban.io.read.tracks import LAT, LON, UTC
from jaxurban.maps.task import MapTask
from jaxurban.progress import Report
from jaxurban.satellites.track import Track, quality_along, seen_along
from jaxurban.studies.receiver.logs import ReceiverLog
from jaxurban.world.grid import Grid

OF_CITY, EVERYWHERE = "city", "all"  # what `ReceiverSettings.known` may say
SYSTEMS = "GRECJIS"  # GPS, GLONASS, Galileo, BeiDou, QZSS, NavIC, SBAS
# A satellite moves by half a degree a minute: more would no longer be the log's sky.
MAX_SKY_STEP_S = 300.0


@typed
@dataclass(frozen=True)
class ReceiverSettings:
    """How a receiver's log is set against maps. None of these is fitted to a log.

    Attributes:
      antenna_height_m: of the receiver's antenna above the ground.
      sky_step_s: seconds for which satellites stand still; each epoch takes the sky nearest to it in time.
      piece_m: length of the pieces of track whose medians are compared.
      other_pieces_m: further lengths of pieces for which the same is reported.
      block_m: length of the blocks of track within which ranks are compared, and of which one after the other is left
        out for the interval.
      sky_block_m: length of the blocks of track that the bootstrap of satellites' scores draws.
      known: where the buildings are known: ``"city"``, what their file covers; a number, this many metres around the
        track; a vector file of polygons; or ``"all"``, which judges rays that leave the data as if nothing stood there.
      systems: letters of the satellite systems that are taken, as ``("G", "E")``; empty, all of the log.
      num_displaced: displaced cities of the null.
      seed: of the displacements and of the bootstrap.

    Raises:
      InputError: a length or time that is not positive, a sky that stands still for more than 300 s, or blocks that are
        shorter than pieces.

    Examples:
      >>> settings = ju.studies.ReceiverSettings(piece_m=10.0, other_pieces_m=[50.0])
      >>> settings.pieces_m, settings.block_m
      ((10.0, 50.0), 200.0)
    """

    antenna_height_m: float = 2.0
    sky_step_s: float = 30.0
    piece_m: float = 25.0
    other_pieces_m: Sequence[float] = (10.0, 50.0, 100.0)
    block_m: float = 200.0
    sky_block_m: float = 50.0
    known: str | float | Path = OF_CITY
    systems: Sequence[str] = ()
    num_displaced: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        """Check all settings; an area of ``known`` is read only when it is used."""
        for name in ("antenna_height_m", "piece_m", "block_m", "sky_block_m", "sky_step_s"):
            positive(name, getattr(self, name))
        for length_m in self.other_pieces_m:
            positive("each of other_pieces_m", length_m)
        if not isinstance(self.known, str | Path):
            positive("known", self.known, "metres")
        at_least("num_displaced", self.num_displaced, 1)
        at_least("seed", self.seed)
        unknown = [letter for letter in self.systems if letter not in SYSTEMS]
        if unknown:
            raise InputError(
                f"systems must be letters of {', '.join(SYSTEMS)} (as RINEX has them), got {unknown[0]!r}"
            )
        if self.sky_step_s > MAX_SKY_STEP_S:
            raise InputError(
                f"sky_step_s must be at most {MAX_SKY_STEP_S:g} seconds, got {self.sky_step_s:g}"
            )
        if self.block_m < self.piece_m:
            raise InputError(
                f"block_m must be at least piece_m, {self.piece_m:g}, got {self.block_m:g}: make it longer"
            )

    @property
    def pieces_m(self) -> tuple[float, ...]:
        """All lengths of pieces, from short to long."""
        return tuple(sorted({float(self.piece_m), *map(float, self.other_pieces_m)}))

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain, JSON-ready values.

        Returns:
          Every attribute by its name.

        Examples:
          >>> settings = ju.studies.ReceiverSettings(other_pieces_m=(50.0,), systems=("G",)).to_dict()
          >>> settings["other_pieces_m"], settings["systems"], settings["known"]
          ([50.0], ['G'], 'city')
        """
        return {
            **asdict(self),
            "other_pieces_m": list(self.other_pieces_m),
            "known": self.known if isinstance(self.known, float | int) else str(self.known),
            "systems": list(self.systems),
        }


def track_of(log: ReceiverLog, grid: Grid, sky_step_s: float) -> Track:
    """Return the track of a log; all epochs within a window of ``sky_step_s`` seconds share one sky.

    The first window begins at the first epoch. A window has the sky of its middle, and none if it has no epoch.

    Args:
      log: epochs in order of time, with longitude and latitude.
      grid: that holds all places.
      sky_step_s: length of a window.

    Raises:
      InputError: a place outside the grid.
    """
    lon_deg = log.epochs[LON].to_numpy()
    lat_deg = log.epochs[LAT].to_numpy()
    x_m, y_m = grid.xy_of_lonlat(lon_deg, lat_deg)
    is_inside = grid.contains_xy(x_m, y_m)
    if not is_inside.all():
        num = int((~is_inside).sum())
        spans = (
            f"{lon_deg.min():.4f}, {lat_deg.min():.4f}, {lon_deg.max():.4f}, {lat_deg.max():.4f}"
        )
        raise InputError(
            f"{num} of the {len(is_inside)} places of the receiver log {log.name!r} lie outside "
            "the region: remove these rows, see whether lon_deg and lat_deg are swapped, or let [region] bounds of "
            f"the scenario hold the track, [{spans}] and some metres around it"
        )

    # The windows, by their number since the first epoch, and the UTC time in the middle of each.
    first = log.epochs[UTC].iloc[0]
    elapsed_s = (log.epochs[UTC] - first).dt.total_seconds().to_numpy()
    windows, sky = np.unique((elapsed_s // sky_step_s).astype(np.int64), return_inverse=True)
    to_middles = pd.to_timedelta((windows + 0.5) * sky_step_s, "s")
    times = (first + to_middles).round("s").strftime("%Y-%m-%dT%H:%M:%SZ")
    return Track(x_m, y_m, sky, tuple(times))


def predict(task: MapTask, track: Track, report: Report) -> dict[str, np.ndarray]:
    """Return what the maps of a task predict along a track: ``[N]`` float64 by the names of `quality_along`.

    The values are NaN where the track is in a building, and where the maps have no data.

    Args:
      task: of one altitude; its sky has the track's times.
      track: over the task's region.
      report: is called with the stage, how many skies are done, and how many there are.
    """
    is_seen, is_known = seen_along(task, track, report)
    quality = quality_along(task, track.sky, is_seen)
    return {name: np.where(is_known, values, np.nan) for name, values in quality.items()}
