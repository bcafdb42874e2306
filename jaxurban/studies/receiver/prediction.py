"""The track of a receiver over a grid, and what maps say along it, at its times and its antenna's height.

The values are those of maps of these times and this height in the cells of the track, made by the same recipe
(`jaxurban.maps.recipe`), leg by leg, so that memory is that of a leg and its surroundings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError
from jaxurban.io.read.receiver import LAT, LON, UTC, ReceiverLog
from jaxurban.maps.recipe import TileScene
from jaxurban.maps.run import tasks_of
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import METRIC
from jaxurban.metrics.population import Population
from jaxurban.progress import Report
from jaxurban.world.grid import Grid

LEG_CELLS = 1_500_000  # of the box around a leg
NUM_VISIBLE = "num_visible"
OF_CITY, EVERYWHERE = "city", "all"  # what `ReceiverSettings.known` may say
SYSTEMS = "GRECJIS"  # GPS, GLONASS, Galileo, BeiDou, QZSS, NavIC, SBAS
MAX_SKY_STEP_S = (
    300.0  # a satellite moves by half a degree a minute: more would no longer be the log's sky
)


@typed
@dataclass(frozen=True)
class ReceiverSettings:
    """How a receiver's log is set against maps. None of these is fitted to a log.

    Attributes:
      antenna_height_m: of the receiver's antenna above the ground.
      sky_step_s: satellites stand still for so many seconds; each epoch takes the sky nearest to it in time.
      piece_m: length of the pieces of track whose medians are compared.
      other_pieces_m: further lengths of pieces for which the same is reported.
      block_m: length of the blocks of track within which ranks are compared, and of which one after the other is left
        out for the interval.
      sky_block_m: length of the blocks of track that the bootstrap of satellites' scores draws.
      known: where the buildings are known: ``"city"``, what their file covers; a number, so many metres around the
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
        for name in ("antenna_height_m", "piece_m", "block_m", "sky_block_m", "sky_step_s"):
            positive(name, getattr(self, name))
        for value in self.other_pieces_m:
            positive("each of other_pieces_m", value)
        if not isinstance(self.known, str | Path):
            positive("known", self.known, "metres")
        at_least("num_displaced", self.num_displaced, 1)
        at_least("seed", self.seed)
        if unknown := [letter for letter in self.systems if letter not in SYSTEMS]:
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
        of_known = self.known if isinstance(self.known, float | int) else str(self.known)
        lists = {"other_pieces_m": list(self.other_pieces_m), "systems": list(self.systems)}
        return asdict(self) | lists | {"known": of_known}


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
        if not (is_inside := grid.contains_xy(x_m, y_m)).all():
            num = int((~is_inside).sum())
            spans = f"{lon_deg.min():.4f}, {lat_deg.min():.4f}, {lon_deg.max():.4f}, {lat_deg.max():.4f}"
            raise InputError(
                f"{num} of the {len(is_inside)} places of the receiver log {log.name!r} lie outside "
                "the region: remove these rows, see whether lon_deg and lat_deg are swapped, or let [region] bounds of "
                f"the scenario hold the track, [{spans}] and some metres around it"
            )
        row, col = grid.cell_of_xy(x_m, y_m)
        first = log.epochs[UTC].iloc[0]
        window = ((log.epochs[UTC] - first).dt.total_seconds().to_numpy() // sky_step_s).astype(
            np.int64
        )
        numbers, sky = np.unique(window, return_inverse=True)
        middles = [
            (first + pd.Timedelta(seconds=(number + 0.5) * sky_step_s)).round("s")
            for number in numbers
        ]
        return cls(x_m, y_m, row, col, sky, tuple(f"{time:%Y-%m-%dT%H:%M:%S}Z" for time in middles))

    @cached_property
    def along_m(self) -> np.ndarray:
        """``[N]`` distance from the first epoch along the track."""
        return np.cumsum(
            np.hypot(np.diff(self.x_m, prepend=self.x_m[0]), np.diff(self.y_m, prepend=self.y_m[0]))
        )


def region_of(scenario: Scenario) -> Grid:
    """Return the grid of a scenario at the first of its resolutions."""
    held = scenario.region.resolution_m
    return Grid.from_bounds(scenario.region.bounds, held[0], scenario.region.crs, held)


def task_at(
    scenario: Scenario, times: Sequence[str], grid: Grid, antenna_height_m: float
) -> MapTask:
    """Return what maps of a scenario at other times, and at the antenna's height alone, are made of.

    People, layers that a user added and uncertainty are left out: satellites depend on none of them.
    """
    of_log: dict[str, Any] = {"times": tuple(times), "start": None, "stop": None, "step_s": None}
    of_log |= {
        "reference": scenario.gps.reference or grid.centre_lonlat,
        "series": "epochs",
        "bounds": False,
    }
    region = replace(
        scenario.region, resolution_m=(grid.resolution_m,), altitudes_m=(antenna_height_m,)
    )
    update = {
        "region": region,
        "gps": replace(scenario.gps, **of_log),
        "buildings": replace(scenario.buildings, height_samples=0),
        "population": Population(),
        "layers": {},
    }
    (task,) = tasks_of(scenario.model_copy(update=update))
    return replace(task, region=grid)  # which nests with all of the scenario's resolutions


def predict(task: MapTask, track: Track, report: Report) -> dict[str, np.ndarray]:
    """Return what the maps of a task say along a track of N epochs.

    By name ``[N]`` float64: ``num_visible``, the DOPs (inf where undetermined) and ``gps``, m; NaN in a building and
    without data.

    Args:
      task: from `task_at`; its sky has the track's times.
      track: over the task's region.
      report: how many skies are done.
    """
    num_skies, values = len(track.sky_times), dict[str, np.ndarray]()
    for leg in _legs(track):
        now = (leg[0] <= track.sky) & (track.sky <= leg[-1])
        tile = _tile(task, _box(task.region, track.row[now], track.col[now]), leg)
        region = tile.surface.region
        for t, number in enumerate(leg):
            report("skies", number, num_skies)
            epochs = np.flatnonzero(track.sky == number)
            row = track.row[epochs] - region.first_row + task.region.first_row
            at = row, track.col[epochs] - region.first_col + task.region.first_col
            is_known = ~np.asarray(tile.is_obstacle[0])[at]
            if tile.has_data is not None:
                is_known &= tile.has_data[at]
            for name, layer in METRIC.compute(
                tile.at(METRIC, (t, 0)), tile.task.params.gps
            ).items():
                along = values.setdefault(name, np.full(len(track.sky), np.nan))
                along[epochs] = np.where(is_known, np.asarray(layer)[at], np.nan)
            tile.forget()
    report("skies", num_skies, num_skies)
    return values


def _legs(track: Track) -> Iterator[list[int]]:
    """Yield runs of skies whose places lie in one box that is not too large; one sky at least."""
    leg: list[int] = []
    low, high = np.array([np.inf, np.inf]), np.array([-np.inf, -np.inf])
    for number in range(int(track.sky[-1]) + 1):
        cells = np.stack([track.row, track.col])[:, track.sky == number]
        joined = np.minimum(low, cells.min(axis=1)), np.maximum(high, cells.max(axis=1))
        if leg and np.prod(joined[1] - joined[0] + 1) > LEG_CELLS:
            yield leg
            leg, joined = [], (cells.min(axis=1), cells.max(axis=1))
        low, high = joined
        leg.append(number)
    yield leg


def _box(region: Grid, row: np.ndarray, col: np.ndarray) -> Grid:
    """Return the part of a region that holds cells."""
    first_row, first_col = int(row.min()), int(col.min())
    num_rows, num_cols = int(row.max()) - first_row + 1, int(col.max()) - first_col + 1
    corner = {"first_row": region.first_row + first_row, "first_col": region.first_col + first_col}
    return Grid(region.crs, region.resolution_m, **corner, num_rows=num_rows, num_cols=num_cols)


def _tile(task: MapTask, region: Grid, skies: list[int]) -> TileScene:
    """Return a part of a task, over another region and at some of its times, ready for its maps."""
    sky = task.sky
    of_time = {
        name: getattr(sky, name)[skies]
        for name in ("azimuth_rad", "elevation_rad", "element_age_days")
    }
    part = replace(
        task, region=region, sky=replace(sky, times=tuple(sky.times[t] for t in skies), **of_time)
    )
    return TileScene(part, part.surface())
