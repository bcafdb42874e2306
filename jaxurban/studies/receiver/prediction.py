"""What maps say along a receiver's track, at its times and its antenna's height.

The values are those of maps of these times and this height in the cells of the track, made by the same recipe
(`jaxurban.maps.recipe`), leg by leg, so that memory is that of a leg and its surroundings.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.read.orbits import parse_time
from jaxurban.kernels.shadows.sweep import WORD_BITS
from jaxurban.maps.recipe import TileScene
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import Scene
from jaxurban.metrics.gps import METRIC
from jaxurban.progress import Report
from jaxurban.scenario.run import tasks_of
from jaxurban.scenario.settings import PopulationSettings, Scenario
from jaxurban.studies.receiver.settings import ReceiverSettings
from jaxurban.studies.receiver.track import Track
from jaxurban.world.grid import Grid
from jaxurban.world.sky import Sky

LEG_CELLS = 1_500_000  # of the box around a leg
MAP_CELLS = 1_000_000  # of the picture behind the track
MAP_EDGE_M = 60.0  # around the track in it
NUM_VISIBLE = "num_visible"


@dataclass(frozen=True, eq=False)
class Prediction:
    """What maps say at the epochs of a track. ``N`` epochs, ``S`` satellites.

    Attributes:
      values: ``[N]`` float64 by name: ``num_visible``, the DOPs (inf where undetermined) and ``gps``, m; NaN in a
        building and without data.
      open_sky: ``[N]`` the same without a city: every satellite above the mask is seen.
      is_seen: ``[N, S]`` bool: the satellite is in sight.
      is_above: ``[N, S]`` bool: the satellite is at or above the mask.
      names: ``[S]`` of the satellites.
    """

    values: Mapping[str, np.ndarray]
    open_sky: Mapping[str, np.ndarray]
    is_seen: np.ndarray
    is_above: np.ndarray
    names: tuple[str, ...]

    @property
    def is_known(self) -> np.ndarray:
        """``[N]`` bool: the epoch lies outside buildings and has data."""
        return ~np.isnan(self.values[NUM_VISIBLE])


@dataclass(frozen=True, eq=False)
class Background:
    """The map behind a track. ``Y, X`` cells of ``grid``.

    Attributes:
      num_visible: ``[Y, X]`` satellites in view at ``time``; NaN in buildings and without data.
      is_obstacle: ``[Y, X]`` a roof reaches the antenna's height.
    """

    grid: Grid
    time: str
    num_visible: np.ndarray
    is_obstacle: np.ndarray


def region_of(scenario: Scenario, resolution_m: float | None) -> Grid:
    """Return the grid of a scenario at one of its resolutions, the first if left out.

    Raises:
      InputError: not one of the scenario's resolutions.
    """
    held = scenario.region.resolution_m
    if resolution_m is not None and resolution_m not in held:
        raise InputError(
            f"resolution_m must be one of the scenario's, {', '.join(f'{value:g}' for value in held)}, got "
            f"{resolution_m:g}: set [region] resolution_m"
        )
    return Grid.from_bounds(scenario.region.bounds, resolution_m or held[0], scenario.region.crs, held)


def task_at(scenario: Scenario, times: Sequence[str], grid: Grid, settings: ReceiverSettings) -> MapTask:
    """Return what maps of a scenario at other times, and at the antenna's height alone, are made of.

    Nothing of people, of layers of one's own and of uncertainty is in it: satellites depend on none.
    """
    of_log: dict[str, Any] = {"times": tuple(map(parse_time, times)), "start": None, "stop": None, "step_s": None}
    reference = scenario.gps.reference or grid.centre_lonlat
    gps = replace(scenario.gps, **of_log, reference=reference, series="epochs", bounds=False)
    region = {"resolution_m": (grid.resolution_m,), "altitudes_m": (float(settings.antenna_height_m),)}
    changed = scenario.model_copy(
        update={
            "region": scenario.region.model_copy(update=region),
            "gps": gps,
            "buildings": scenario.buildings.model_copy(update={"height_samples": 0}),
            "population": PopulationSettings(),
            "layers": {},
        }
    )
    (task,) = tasks_of(changed)
    return replace(task, region=grid)  # which nests with all of the scenario's resolutions


def predict(task: MapTask, track: Track, report: Report) -> Prediction:
    """Return what the maps of a task say along a track.

    Args:
      task: from `task_at`; its sky has the track's times.
      track: over the task's region.
      report: how many skies are done.
    """
    num_skies, num = len(track.sky_times), len(track.sky)
    names = task.sky.names
    values: dict[str, np.ndarray] = {}
    open_sky: dict[str, np.ndarray] = {}
    is_seen, is_above = (np.zeros((num, len(names)), bool) for _ in range(2))
    done = 0
    for leg in _legs(track):
        now = (leg[0] <= track.sky) & (track.sky <= leg[-1])
        tile = _tile(task, _box(task.region, track.row[now], track.col[now]), leg)
        first = (
            tile.surface.region.first_row - task.region.first_row,
            tile.surface.region.first_col - task.region.first_col,
        )
        for t, number in enumerate(leg):
            report("skies", done, num_skies)
            epochs = np.flatnonzero(track.sky == number)
            at = track.row[epochs] - first[0], track.col[epochs] - first[1]
            scene = tile.at(METRIC, (t, 0))
            is_known = _is_known(tile)[at]
            for name, layer in METRIC.compute(scene, tile.task.params.gps).items():
                along = values.setdefault(name, np.full(num, np.nan))
                along[epochs] = np.where(is_known, np.asarray(layer)[at], np.nan)
            above = tile.task.satellites_at(t)
            for name, layer in METRIC.compute(_without_city(scene, len(above)), tile.task.params.gps).items():
                open_sky.setdefault(name, np.full(num, np.nan))[epochs] = np.asarray(layer)[0, 0]
            words = np.asarray(scene.words)[:, at[0], at[1]]
            for bit, s in enumerate(above):
                is_seen[epochs, s] = is_known & (words[bit // WORD_BITS] >> np.uint32(bit % WORD_BITS) & 1 == 1)
            is_above[np.ix_(epochs, above)] = True
            tile.forget()
            done += 1
    report("skies", num_skies, num_skies)
    return Prediction(values, open_sky, is_seen, is_above, names)


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
    shape = int(row.max()) - first_row + 1, int(col.max()) - first_col + 1
    return Grid(
        region.crs, region.resolution_m, region.first_row + first_row, region.first_col + first_col, shape[0], shape[1]
    )


def _tile(task: MapTask, region: Grid, skies: Sequence[int]) -> TileScene:
    """Return a part of a task, over another region and at some of its times, ready for its maps."""
    sky, chosen = task.sky, list(skies)
    some = Sky(
        tuple(sky.times[t] for t in chosen),
        sky.names,
        sky.azimuth_rad[chosen],
        sky.elevation_rad[chosen],
        sky.systems,
        sky.element_age_days[chosen],
        sky.guesses,
    )
    part = replace(task, region=region, sky=some)
    return TileScene(part, part.surface())


def _is_known(tile: TileScene) -> np.ndarray:
    """Return ``[y, x]`` bool: data, and no roof that reaches the antenna's height."""
    is_free = ~np.asarray(tile.is_obstacle[0])
    return is_free if tile.has_data is None else is_free & tile.has_data


def _without_city(scene: Scene, num_satellites: int) -> Scene:
    """Return a scene in which nothing hides a satellite."""
    assert scene.words is not None
    assert scene.is_obstacle is not None
    num_words, *shape = scene.words.shape
    bits = [min(max(num_satellites - WORD_BITS * w, 0), WORD_BITS) for w in range(num_words)]
    words = np.stack([np.full(shape, (1 << num) - 1, np.uint32) for num in bits])
    return replace(scene, words=jax.device_put(words), is_obstacle=jax.device_put(np.zeros(shape, bool)))


def background(task: MapTask, track: Track) -> Background:
    """Return the satellites in view around a track in the middle of its time, on coarser cells if there are many."""
    edge = math.ceil(MAP_EDGE_M / task.region.resolution_m)
    box = _box(task.region, track.row, track.col).padded(edge, edge, edge, edge)
    coarser = math.ceil(math.sqrt(box.num_rows * box.num_cols / MAP_CELLS))
    first_row, first_col = box.first_row // coarser, box.first_col // coarser
    end_row, end_col = (
        -(-(first + num) // coarser) for first, num in ((box.first_row, box.num_rows), (box.first_col, box.num_cols))
    )
    grid = Grid(box.crs, box.resolution_m * coarser, first_row, first_col, end_row - first_row, end_col - first_col)
    middle = len(track.sky_times) // 2
    tile = _tile(task, grid, [middle])
    found = METRIC.compute(tile.at(METRIC, (0, 0)), tile.task.params.gps)[NUM_VISIBLE]
    is_obstacle = np.asarray(tile.is_obstacle[0])
    seen = np.where(_is_known(tile), np.asarray(found, np.float32), np.float32(np.nan))
    return Background(grid, track.sky_times[middle], seen, is_obstacle)
