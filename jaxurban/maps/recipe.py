"""The one recipe for maps: what a surface under a sky holds, layer by layer.

A region in memory is one tile; a tiled run does many of the same; spreads by uncertain heights do it on surfaces
whose roofs have moved. Who runs it, and where the layers go, is the caller's.
"""

from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxurban.io.read.rasterise import build_surface, highest_top_m, layer_values
from jaxurban.kernels.shadows.sweep import Ring
from jaxurban.maps.dataset import variables
from jaxurban.maps.height_uncertainty import Spread, perturbed_cities
from jaxurban.maps.supersampling import (
    Bands,
    build_supersampled_surface,
    lower_bands,
    plain_bands,
    upper_bands,
    visibility_at_centres,
)
from jaxurban.maps.task import MapTask
from jaxurban.metrics.availability import TimeTotals, row_sums, series_statistics
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, UNDERSIDE, AnyArray, Metric, Scene
from jaxurban.metrics.obstacle import obstacles_on, region_roofs
from jaxurban.metrics.population import BlockLayers
from jaxurban.metrics.visibility import visibility
from jaxurban.progress import Stage
from jaxurban.world.city import TO_GROUND, City
from jaxurban.world.surface import Surface


class MapLayer(NamedTuple):
    """One map: variable, place along the variable's axes before y and x, values ``[y, x]``."""

    name: str
    place: tuple[int, ...]
    values: Any  # a NumPy array from `tile_maps` and `metric_layers`


@dataclass(frozen=True, eq=False)
class TileScene:
    """A tile of a task, ready for its maps; the whole region is one too.

    Attributes:
      task: what the maps are made of.
      surface: roofs, terrain and blocks of the tile (``surface.region``) and of what its metrics look at around it.
      rings: what the tiles around hand on, by time and satellite; None where the surface holds all that shadows.
      totals: the tile's sums over free cells by metric, where statistics over time are kept; `tile_maps` fills it.
    """

    task: MapTask
    surface: Surface
    rings: Mapping[tuple[int, int], Ring] | None = None
    totals: dict[str, TimeTotals] = field(default_factory=dict, init=False)
    _seen: dict[int, np.ndarray] = field(default_factory=dict, init=False, repr=False)
    _met: dict[float, tuple[Surface, Surface | None]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def is_obstacle(self) -> np.ndarray:
        """``[A, y, x]`` bool: a roof reaches the altitude, or it lies in a slab."""
        return obstacles_on(self.surface, self.task.params.altitudes_m)

    @cached_property
    def has_data(self) -> np.ndarray | None:
        """``[y, x]`` bool: something is known of the cell; None where it is of all."""
        return None if self.surface.has_data is None else np.asarray(self.surface.crop(self.surface.has_data))

    @cached_property
    def supersampled(self) -> Surface | None:
        """The surface ``oversample`` times finer that rays see; None where that is the tile's own."""
        params = self.task.params
        return None if params.oversample == 1 else self.supersampled_surface(params.heights.all_touched)

    @cached_property
    def _bands(self) -> Bands:
        assert self.supersampled is not None
        return plain_bands(self.supersampled, self.task.params.oversample)

    def supersampled_surface(self, all_touched: bool, city: City | None = None) -> Surface:
        """Return the tile and all that shadows it, rasterised ``oversample`` times finer, of another city if given."""
        task, region = self.task, self.surface.region
        return build_supersampled_surface(
            city or task.city, region, task.with_margin(region), task.params.oversample, all_touched
        )

    def surfaces_at(self, altitude_m: float) -> tuple[Surface, Surface | None]:
        """Return what an altitude meets: the surface and the finer one, if any; keeps the last."""
        if altitude_m not in self._met:
            fine = self.supersampled and self.supersampled.at_altitude(altitude_m)
            self._met.clear()
            self._met[altitude_m] = self.surface.at_altitude(altitude_m), fine
        return self._met[altitude_m]

    def words(self, time_index: int) -> np.ndarray:
        """Return the visibility words ``[W, A, y, x]`` of a time; keeps the last."""
        if time_index not in self._seen:
            self.keep(time_index, np.asarray(self._words(time_index)))
        return self._seen[time_index]

    def keep(self, time_index: int, words: np.ndarray) -> None:
        """Let `words` return these for a time, and forget all others."""
        self.forget()
        self._seen[time_index] = words

    def forget(self) -> None:
        """Free the memory of the words that are kept."""
        self._seen.clear()

    def _words(self, time_index: int) -> AnyArray:
        in_view = self.task.in_view(time_index)
        altitudes_m = np.asarray(self.task.params.altitudes_m)
        if self.supersampled is not None:
            return visibility_at_centres(self._bands, *in_view.angles, altitudes_m)
        rings = None
        if self.rings is not None:
            rings = [self.rings[time_index, int(s)] for s in in_view.numbers]
        return visibility(self.surface, *in_view.angles, altitudes_m, rings, self.task.params.engine)

    def at(self, metric: Metric, place: tuple[int, ...], only_m: bool = False) -> Scene:
        """Return what a metric may look at, at one place along its dims; ``only_m``: for m and nothing else."""
        index = dict(zip(metric.dims, place, strict=True))
        params = self.task.params
        scene = Scene(self.surface, oversample=params.oversample, only_m=only_m, engine=params.engine)
        if (d := index.get(TIME_OF_DAY)) is not None:
            assert self.task.population is not None
            scene = replace(scene, population=BlockLayers(*(values[d] for values in self.task.population)))
        if (a := index.get(ALTITUDE)) is not None:
            altitude_m = params.altitudes_m[a]
            surface, fine = self.surfaces_at(altitude_m)
            scene = replace(
                scene, surface=surface, altitude_m=altitude_m, is_obstacle=self.is_obstacle[a], supersampled=fine
            )
        if (t := index.get(TIME)) is not None:
            assert a is not None
            scene = replace(scene, in_view=self.task.in_view(t), words=self.words(t)[:, a])
        if metric.name in self.task.bands:
            values = layer_values(self.task.bands[metric.name], self.surface.region, self.task.region, a)
            scene = replace(scene, rasters={metric.name: values})
        return scene


def tile_maps(tile: TileScene, stage: Stage = nullcontext) -> Iterator[MapLayer]:
    """Yield every layer of a tile, one at a time, so that few of them need be in memory.

    NaN where nothing is known, and inside obstacles what its `Variable` says; integers keep 0 there. Each cell depends
    on the city around it alone, so a tile's layers equal the crop of the region's.

    Args:
      tile: what the maps are made of.
      stage: gives the context that the work on each stage runs in.
    """
    held = variables(tile.task)
    for name, place, values in _layers(tile, stage):
        inside, dims = held[name].inside, held[name].dims
        if inside is not None and ALTITUDE in dims:
            values = values.copy()
            np.putmask(values, tile.is_obstacle[place[dims.index(ALTITUDE)]], inside)
        if tile.has_data is not None and np.issubdtype(values.dtype, np.floating):
            values = np.where(tile.has_data, values, np.float32(np.nan))
        yield MapLayer(name, place, values)
    has_data = np.ones(tile.surface.region.shape, bool) if tile.has_data is None else tile.has_data
    yield MapLayer("has_data", (), has_data)


def _layers(tile: TileScene, stage: Stage) -> Iterator[MapLayer]:
    task = tile.task
    yield from _staged(_obstacles(tile), stage, "obstacle")
    by_sky = sorted(task.metrics.items(), key=lambda item: TIME not in item[1].dims)  # of one view after the other
    for number, (name, metric) in enumerate(by_sky):
        is_series = TIME in metric.dims and not task.keeps_times
        yield from _staged((_statistics if is_series else _maps)(tile, metric), stage, name)
        has_bounds = TIME in metric.dims and metric.is_monotone and task.params.gps.bounds
        if has_bounds:
            yield from _staged(_bounds(tile, metric), stage, f"{name}_bounds")
        if has_bounds or not any(TIME in later.dims for _, later in by_sky[number + 1 :]):
            tile.forget()
    if task.params.heights.height_samples:
        yield from _staged(_height_spread(tile), stage, "height_spread")
    yield from _staged(_rasters(tile), stage, "surface")


def _staged(layers: Iterator[MapLayer], stage: Stage, name: str) -> Iterator[MapLayer]:
    """Yield layers that are made, and waited for, within a stage."""
    while True:
        with stage(name):
            layer = next(layers, None)
            if layer is not None:
                layer = layer._replace(values=np.asarray(layer.values))
        if layer is None:
            return
        yield layer


def _obstacles(tile: TileScene) -> Iterator[MapLayer]:
    for a, is_obstacle in enumerate(tile.is_obstacle):
        yield MapLayer("obstacle", (a,), is_obstacle.astype(np.uint8))


def _maps(tile: TileScene, metric: Metric, only_m: bool = False) -> Iterator[MapLayer]:
    """Yield the maps of a metric, place by place along its dims; ``only_m``: without its further variables."""
    settings = tile.task.settings_of(metric)
    for place in np.ndindex(*(tile.task.sizes[dim] for dim in metric.dims)):
        for name, values in metric.compute(tile.at(metric, place, only_m), settings).items():
            if name == metric.name or not only_m:
                yield MapLayer(name, place, values)


def _statistics(tile: TileScene, metric: Metric) -> Iterator[MapLayer]:
    """Yield statistics over the times, whose sums go to the tile's totals."""
    is_counted = ~tile.is_obstacle
    if tile.has_data is not None:
        is_counted &= tile.has_data
    counted = [jax.device_put(of_altitude) for of_altitude in is_counted]
    totals = TimeTotals.zero(tile.task.num_times, len(is_counted))
    totals.num_free[:] = is_counted.sum(axis=(1, 2))
    m = np.empty((tile.task.num_times, *is_counted.shape), np.float32)
    is_available = np.empty(m.shape, np.uint8) if metric.available else None
    for name, (t, a), values in _maps(tile, metric, only_m=is_available is None):
        if is_available is not None and name == metric.available:
            is_available[t, a] = values
        if name != metric.name:
            continue
        m[t, a] = m_now = values
        totals.m_sum[t, a] = np.asarray(row_sums(m_now, counted[a])).sum(dtype=np.int64)
    tile.totals[metric.name] = totals
    for a in range(m.shape[1]):
        threshold, of_altitude = tile.task.params.gps.availability_threshold, None
        if is_available is not None:
            of_altitude = is_available[:, a]
        for what, values in series_statistics(m[:, a], threshold, of_altitude).items():
            yield MapLayer(f"{metric.name}_{what}", (a,), values)


def _bounds(tile: TileScene, metric: Metric) -> Iterator[MapLayer]:
    """Yield ``{metric}_lower`` and ``_upper``, which bracket the true m of free cells: roofs from above and below.

    What hangs reaches the ground in the one, and is not there in the other.
    """
    task = tile.task
    settings, altitudes_m = task.settings_of(metric), np.asarray(task.params.altitudes_m)
    to_ground = replace(task.city, hanging=TO_GROUND)
    for end, make_bands, *rules in (("lower", upper_bands, True, to_ground), ("upper", lower_bands, False, None)):
        bands = make_bands(tile.supersampled_surface(*rules), task.params.oversample)
        for t in range(task.num_times):
            tile.keep(t, visibility_at_centres(bands, *task.in_view(t).angles, altitudes_m))
            for a in range(len(altitudes_m)):
                found = metric.compute(tile.at(metric, (t, a), only_m=True), settings)
                yield MapLayer(f"{metric.name}_{end}", (t, a), found[metric.name])


def _height_spread(tile: TileScene) -> Iterator[MapLayer]:
    """Yield the spread of the metrics over cities whose building heights are drawn.

    ``{metric}_{mean, std, p05, p95}`` of every metric that buildings decide, and ``obstacle_share``, the share of
    samples with an obstacle; in those m is 0. Time: that of the plain maps once a sample; memory: about ten arrays of
    a metric's size.
    """
    task, region = tile.task, tile.surface.region
    heights = task.params.heights

    def cities():
        bare = replace(task.city, blocks=None)
        return perturbed_cities(bare, heights.height_std_m, heights.height_samples, heights.height_seed)

    grid = task.with_margin(region, max(highest_top_m(city) for city in cities()))
    spreads: dict[tuple, Spread] = {}
    for city in cities():
        moved = TileScene(replace(task, city=city), build_surface(city, region, grid, heights.all_touched))
        made = [_obstacles(moved), *(_maps(moved, task.metrics[name], only_m=True) for name in task.spread_metrics)]
        for name, place, values in (layer for layers in made for layer in layers):
            spreads.setdefault((name, place), Spread(heights.height_samples)).add(values)
    for (name, place), spread in spreads.items():
        if name == "obstacle":
            yield MapLayer("obstacle_share", place, spread.mean)
            continue
        for what, values in spread.results().items():
            yield MapLayer(f"{name}_{what}", place, values)


def _rasters(tile: TileScene) -> Iterator[MapLayer]:
    surface = tile.surface
    yield MapLayer("roof", (), region_roofs(surface, np.inf))
    assert surface.roof_touched_m is not None
    yield MapLayer("roof_touched", (), surface.roof_touched_m)
    if surface.slabs is not None:
        yield MapLayer(UNDERSIDE, (), surface.slabs.lowest_floors(surface.region))
    if surface.roof_guessed is not None:
        yield MapLayer("roof_guessed", (), surface.roof_guessed)
    if surface.terrain_m is not None:
        yield MapLayer("terrain", (), surface.crop(surface.terrain_m))
