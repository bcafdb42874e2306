"""What maps say along a receiver's track, at its times and its antenna's height.

The values are those of maps of these times and this height in the cells of the track, made by the same recipe
(`jaxurban.maps.recipe`), leg by leg, so that memory is that of a leg and its surroundings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.read.orbits import parse_time
from jaxurban.maps.recipe import TileScene
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import METRIC
from jaxurban.progress import Report
from jaxurban.scenario.run import tasks_of
from jaxurban.scenario.settings import PopulationSettings, Scenario
from jaxurban.studies.receiver.settings import ReceiverSettings
from jaxurban.studies.receiver.track import Track
from jaxurban.world.grid import Grid
from jaxurban.world.sky import Sky

LEG_CELLS = 1_500_000  # of the box around a leg
NUM_VISIBLE = "num_visible"


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
            for name, layer in METRIC.compute(tile.at(METRIC, (t, 0)), tile.task.params.gps).items():
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
