"""The one recipe for maps: what a surface under a sky holds, layer by layer.

A region in memory is one tile; a tiled run makes many of the same; spreads by uncertain heights use surfaces whose
roofs have moved. Who runs it, and where the layers go, is the caller's.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from jaxurban.checks import values_given
from jaxurban.io.rasterise import build_surface, highest_top_m
from jaxurban.maps.task import variables
from jaxurban.maps.tile_scene import TileScene
from jaxurban.maps.uncertain_heights import Spread, perturbed_cities
from jaxurban.metrics.base import ALTITUDE, TIME, UNDERSIDE, Metric
from jaxurban.metrics.variables import HIGHEST, series_statistics
from jaxurban.metrics.visibility import bounding_visibility
from jaxurban.progress import Stage
from jaxurban.settings import TO_GROUND
from jaxurban.world.surface import region_roofs


class MapLayer(NamedTuple):
    """One map: variable, place along the variable's axes before y and x, values ``[y, x]``."""

    name: str
    place: tuple[int, ...]
    values: Any  # a NumPy array from `tile_maps`


def tile_maps(tile: TileScene, stage: Stage) -> Iterator[MapLayer]:
    """Yield every layer of a tile, one at a time, so that few of them need be in memory.

    A layer is NaN where nothing is known of the cell (integers keep their value there); inside obstacles it is what
    its `Variable` says. Each cell depends on the city around it alone, so a tile's layers equal the crop of the
    region's.

    Args:
      tile: what the maps are made of.
      stage: gives the context that the work on each stage runs in.
    """
    by_name = variables(tile.task)
    for name, place, values in _layers(tile, stage):
        variable = by_name[name]
        if variable.inside is not None and ALTITUDE in variable.dims:
            altitude = place[variable.dims.index(ALTITUDE)]
            values = values.copy()
            np.putmask(values, tile.is_obstacle[altitude], variable.inside)
        if tile.has_data is not None and np.issubdtype(values.dtype, np.floating):
            values = np.where(tile.has_data, values, np.float32(np.nan))
        yield MapLayer(name, place, values)
    for name, made in tile.made.items():
        for place in np.ndindex(made.shape[:-2]):
            yield MapLayer(name, place, made[place])

    has_data = tile.has_data
    if has_data is None:
        has_data = np.ones(tile.surface.region.shape, bool)
    yield MapLayer("has_data", (), has_data)


def _layers(tile: TileScene, stage: Stage) -> Iterator[MapLayer]:
    """Yield all maps of a tile: obstacles, metrics of satellites, other metrics, spreads, and the rasters below them.

    Args:
      tile: what the maps are made of.
      stage: gives the context that the work on each stage runs in.
    """
    task = tile.task
    yield from _staged(_obstacles(tile), stage, "obstacle")

    # Metrics of satellites come first, as they share the visibility words of each time; then these are forgotten.
    of_sky = [metric for metric in task.metrics.values() if TIME in metric.dims]
    others = [metric for metric in task.metrics.values() if metric not in of_sky]
    for metric in of_sky:
        make = _maps if task.keeps_times else _statistics
        if not metric.is_cost:
            make = _with_highest
        if metric not in tile.of_device:
            yield from _staged(make(tile, metric), stage, metric.name)
        if task.has_bounds(metric):
            yield from _staged(_bounds(tile, metric), stage, f"{metric.name}_bounds")
            tile.forget()
    tile.forget()

    for metric in others:
        if metric not in tile.of_device:
            yield from _staged(_maps(tile, metric), stage, metric.name)
    if task.params.heights.height_samples:
        yield from _staged(_height_spread(tile), stage, "height_spread")
    yield from _staged(_rasters(tile), stage, "surface")


def _staged(layers: Iterator[MapLayer], stage: Stage, name: str) -> Iterator[MapLayer]:
    """Yield layers, each of them made within a stage of this name; what the caller does with it is outside.

    JAX computes in the background: turning the values into NumPy's waits for them within the stage too.

    Args:
      layers: makes each layer when the next one is asked of it.
      stage: gives the context of a stage by its name.
      name: of the stage.
    """
    while True:
        with stage(name):
            layer = next(layers, None)
            if layer is not None:
                layer = layer._replace(values=np.asarray(layer.values))
        if layer is None:
            return
        yield layer


def _obstacles(tile: TileScene) -> Iterator[MapLayer]:
    """Yield the map of obstacles of each altitude, uint8, 1 inside them."""
    for a, is_obstacle in enumerate(tile.is_obstacle):
        yield MapLayer("obstacle", (a,), is_obstacle.astype(np.uint8))


def _maps(tile: TileScene, metric: Metric, only_m: bool = False) -> Iterator[MapLayer]:
    """Yield the maps of a metric at each place along its dims, such as each time and altitude.

    Args:
      tile: what the maps are made of.
      metric: any but those kept as statistics over time.
      only_m: whether its further variables are left out.
    """
    settings = tile.task.settings_of(metric)
    sizes = [tile.task.sizes[dim] for dim in metric.dims]
    for place in np.ndindex(*sizes):
        maps = metric.compute(tile.at(metric, place, only_m), settings)
        for name, values in maps.items():
            if name == metric.name or not only_m:
                yield MapLayer(name, place, values)


def _with_highest(tile: TileScene, metric: Metric) -> Iterator[MapLayer]:
    """Yield a metric that costs nothing at each time, where these maps are kept, and its highest over several times."""
    highest = np.float32(-np.inf)
    for layer in _maps(tile, metric):
        highest = np.maximum(highest, layer.values)
        if tile.task.keeps_times:
            yield layer
    if tile.task.has_series(metric):
        yield MapLayer(f"{metric.name}_{HIGHEST}", (), highest)


def _statistics(tile: TileScene, metric: Metric) -> Iterator[MapLayer]:
    """Yield the statistics over time of a metric, altitude by altitude.

    The metric of all times is in memory at once, ``[T, A, y, x]`` float32, with a byte more of each value where a
    variable of its own says which positions are available.

    Args:
      tile: what the maps are made of.
      metric: of times and altitudes.
    """
    # The metric at every time.
    m = np.empty((tile.task.num_times, *tile.is_obstacle.shape), np.float32)
    is_available = np.empty(m.shape, np.uint8) if metric.available else None
    for name, place, values in _maps(tile, metric, only_m=is_available is None):
        if name == metric.name:
            m[place] = values
        elif is_available is not None and name == metric.available:
            is_available[place] = values

    # The statistics of each cell.
    threshold = tile.task.params.gps.availability_threshold
    for a in range(m.shape[1]):
        available = None if is_available is None else is_available[:, a]
        for what, values in series_statistics(m[:, a], threshold, available).items():
            yield MapLayer(f"{metric.name}_{what}", (a,), values)


def _bounds(tile: TileScene, metric: Metric) -> Iterator[MapLayer]:
    """Yield ``{metric}_lower`` and ``{metric}_upper``, which bracket the true m of free cells, by time and altitude.

    The lower bound is from roofs that hide most, with everything that hangs reaching the ground; the upper bound is
    from roofs that hide least, without anything that hangs. They bracket m as one satellite more never makes it less.
    The tile's visibility words are then those of a bound.
    """
    task = tile.task
    params = task.params
    cities = {"lower": replace(task.city, hanging=TO_GROUND), "upper": task.city}
    for bound, city in cities.items():
        is_lower = bound == "lower"
        fine = replace(tile.finer(city, all_touched=is_lower), slabs=None)
        for t in range(task.num_times):
            angles = task.in_view(t).angles
            words = bounding_visibility(
                fine, *angles, params.altitudes_m, params.oversample, hides_most=is_lower
            )
            tile.keep(t, words)
            for a in range(len(params.altitudes_m)):
                scene = tile.at(metric, (t, a), only_m=True)
                maps = metric.compute(scene, task.settings_of(metric))
                yield MapLayer(f"{metric.name}_{bound}", (t, a), maps[metric.name])


def _height_spread(tile: TileScene) -> Iterator[MapLayer]:
    """Yield the spread of the metrics over cities whose building heights are drawn at random.

    The maps are ``{metric}_{mean, std, p05, p95}`` of every metric that buildings decide, and ``obstacle_share``, the
    share of samples in which a cell is inside an obstacle; m counts as 0 in those samples. Each sample takes the time
    of the plain maps, and all of them the memory of about ten arrays of a metric's size.
    """
    task = tile.task
    region = tile.surface.region
    heights = task.params.heights
    without_people = replace(task.city, blocks=None)
    draws = without_people, heights.height_std_m, heights.height_samples

    # The same cities are drawn twice, so that one at a time is in memory: first for the highest roof, which sets how
    # large the surfaces must be, then for their maps.
    highest_m = max(map(highest_top_m, perturbed_cities(*draws)))
    grid = task.with_margin(region, highest_m)
    spreads: dict[tuple, Spread] = {}  # by variable and place
    for city in perturbed_cities(*draws):
        surface = build_surface(city, region, grid)
        perturbed = TileScene(replace(task, city=city), surface)
        maps = [_maps(perturbed, task.metrics[name], only_m=True) for name in task.spread_metrics]
        for name, place, values in chain(_obstacles(perturbed), *maps):
            spreads.setdefault((name, place), Spread(heights.height_samples)).add(values)

    for (name, place), spread in spreads.items():
        if name == "obstacle":
            yield MapLayer("obstacle_share", place, spread.mean)
            continue
        for what, values in spread.results().items():
            yield MapLayer(f"{name}_{what}", place, values)


def _rasters(tile: TileScene) -> Iterator[MapLayer]:
    """Yield the rasters that the maps rest on: roofs, undersides, guessed roofs and terrain, where the city has them.

    Lengths are in metres. Roofs count what hangs (an altitude of inf meets all slabs).
    """
    surface = tile.surface
    slabs = surface.slabs
    rasters = {
        "roof": region_roofs(surface, np.inf),
        "roof_touched": surface.roof_touched_m,
        UNDERSIDE: None if slabs is None else slabs.lowest_floors(surface.region),
        "roof_guessed": surface.roof_guessed,
        "roof_limit": surface.roof_limit_m,
        "roof_likely": surface.roof_likely_m,
        "roof_kind": surface.roof_kind,
        "terrain": surface.crop(surface.terrain_m),
    }
    for name, values in values_given(rasters).items():
        yield MapLayer(name, (), values)
