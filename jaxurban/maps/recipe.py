"""The one recipe for maps: what a surface under a sky holds, layer by layer.

A region in memory is one tile; a tiled run does many of the same; spreads by uncertain heights do it on surfaces
whose roofs have moved. Who runs it, and where the layers go, is the caller's.

Uncertain heights: every sample draws one error for each building (never one for each cell: a roof moves as a whole),
and the city is rasterised and mapped again. Errors are normal, independent between buildings, with a standard deviation
by where the height came from; heights never fall below 0.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from jaxurban.io.city import City
from jaxurban.io.read.rasterise import build_surface, highest_top_m, layer_values
from jaxurban.kernels.shadows.sweep import Ring
from jaxurban.maps.task import MapTask, variables
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, UNDERSIDE, Metric, Scene
from jaxurban.metrics.custom import LAYERS
from jaxurban.metrics.population import BlockLayers
from jaxurban.metrics.variables import SCALE, TimeTotals, series_statistics
from jaxurban.metrics.visibility import bounding_visibility, visibility
from jaxurban.progress import Stage
from jaxurban.settings import TO_GROUND, HeightStd
from jaxurban.world.footprints import HeightOrigin
from jaxurban.world.surface import Surface, obstacles_on, region_roofs


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
    _met: dict[float, tuple[Surface, Surface | None]] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def is_obstacle(self) -> np.ndarray:
        """``[A, y, x]`` bool: a roof reaches the altitude, or it lies in a slab."""
        return obstacles_on(self.surface, self.task.params.altitudes_m)

    @cached_property
    def has_data(self) -> np.ndarray | None:
        """``[y, x]`` bool: something is known of the cell; None where it is of all."""
        return (
            None
            if self.surface.has_data is None
            else np.asarray(self.surface.crop(self.surface.has_data))
        )

    @cached_property
    def supersampled(self) -> Surface | None:
        """The surface ``oversample`` times finer that rays see; None where that is the tile's own."""
        params = self.task.params
        return (
            None
            if params.oversample == 1
            else self.finer(self.task.city, params.heights.all_touched)
        )

    def finer(self, city: City, all_touched: bool) -> Surface:
        """Return a city on the tile and all that shadows it, rasterised ``oversample`` times finer."""
        task, region, n = self.task, self.surface.region, self.task.params.oversample
        bare, grids = (
            replace(city, blocks=None),
            (region.refined(n), task.with_margin(region).refined(n)),
        )
        return replace(build_surface(bare, *grids, all_touched), roof_touched_m=None)

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
            in_view, params, rings = self.task.in_view(time_index), self.task.params, None
            if self.rings is not None and self.supersampled is None:
                rings = [self.rings[time_index, int(s)] for s in in_view.numbers]
            where = self.supersampled or self.surface, *in_view.angles, params.altitudes_m
            self.keep(time_index, visibility(*where, rings, params.oversample))
        return self._seen[time_index]

    def keep(self, time_index: int, words: np.ndarray) -> None:
        """Let `words` return these for a time, and forget all others."""
        self.forget()
        self._seen[time_index] = words

    def forget(self) -> None:
        """Free the memory of the words that are kept."""
        self._seen.clear()

    def at(self, metric: Metric, place: tuple[int, ...], only_m: bool = False) -> Scene:
        """Return what a metric may look at, at one place along its dims; ``only_m``: for m and nothing else."""
        index = dict(zip(metric.dims, place, strict=True))
        params = self.task.params
        scene = Scene(
            self.surface, oversample=params.oversample, only_m=only_m, engine=params.engine
        )
        if (d := index.get(TIME_OF_DAY)) is not None:
            assert self.task.population is not None
            scene = replace(
                scene, population=BlockLayers(*(values[d] for values in self.task.population))
            )
        if (a := index.get(ALTITUDE)) is not None:
            altitude_m = params.altitudes_m[a]
            surface, fine = self.surfaces_at(altitude_m)
            scene = replace(
                scene,
                surface=surface,
                altitude_m=altitude_m,
                is_obstacle=self.is_obstacle[a],
                supersampled=fine,
            )
        if (t := index.get(TIME)) is not None:
            assert a is not None
            scene = replace(scene, in_view=self.task.in_view(t), words=self.words(t)[:, a])
        if metric.section == LAYERS and metric.name in self.task.bands:
            values = layer_values(
                self.task.bands[metric.name], self.surface.region, self.task.region, a
            )
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
    by_sky = sorted(
        task.metrics.items(), key=lambda item: TIME not in item[1].dims
    )  # of one view after the other
    for number, (name, metric) in enumerate(by_sky):
        is_series = TIME in metric.dims and not task.keeps_times
        yield from _staged((_statistics if is_series else _maps)(tile, metric), stage, name)
        has_bounds = name == "gps" and task.params.gps.bounds
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
    m = np.empty((tile.task.num_times, *is_counted.shape), np.float32)
    totals = TimeTotals(np.zeros(m.shape[:2], np.int64), is_counted.sum(axis=(1, 2)))
    is_available = np.empty(m.shape, np.uint8) if metric.available else None
    for name, (t, a), values in _maps(tile, metric, only_m=is_available is None):
        if is_available is not None and name == metric.available:
            is_available[t, a] = values
        if name != metric.name:
            continue
        m[t, a] = values
        totals.m_sum[t, a] = np.sum(
            np.rint(m[t, a] * np.float32(SCALE)), where=is_counted[a], dtype=float
        )
    tile.totals[metric.name] = totals
    for a in range(m.shape[1]):
        threshold, of_altitude = tile.task.params.gps.availability_threshold, None
        if is_available is not None:
            of_altitude = is_available[:, a]
        for what, values in series_statistics(m[:, a], threshold, of_altitude).items():
            yield MapLayer(f"{metric.name}_{what}", (a,), values)


def _bounds(tile: TileScene, metric: Metric) -> Iterator[MapLayer]:
    """Yield ``{metric}_lower`` and ``_upper``, which bracket the true m of free cells: roofs that hide most and least.

    What hangs reaches the ground in the one, and is not there in the other. One satellite more never makes m less.
    """
    task, params = tile.task, tile.task.params
    to_ground = replace(task.city, hanging=TO_GROUND)
    for end, city, is_lower in (("lower", to_ground, True), ("upper", task.city, False)):
        fine = replace(tile.finer(city, all_touched=is_lower), slabs=None)
        for t in range(task.num_times):
            view = *task.in_view(t).angles, params.altitudes_m, params.oversample
            tile.keep(t, bounding_visibility(fine, *view, hides_most=is_lower))
            for a in range(len(params.altitudes_m)):
                made = metric.compute(
                    tile.at(metric, (t, a), only_m=True), task.settings_of(metric)
                )
                yield MapLayer(f"{metric.name}_{end}", (t, a), made[metric.name])


def _height_spread(tile: TileScene) -> Iterator[MapLayer]:
    """Yield the spread of the metrics over cities whose building heights are drawn.

    ``{metric}_{mean, std, p05, p95}`` of every metric that buildings decide, and ``obstacle_share``, the share of
    samples with an obstacle; in those m is 0. Time: that of the plain maps once a sample; memory: about ten arrays of
    a metric's size.
    """
    task, region = tile.task, tile.surface.region
    heights = task.params.heights

    def cities() -> Iterator[City]:
        bare = replace(task.city, blocks=None)
        return perturbed_cities(
            bare, heights.height_std_m, heights.height_samples, heights.height_seed
        )

    grid = task.with_margin(region, max(highest_top_m(city) for city in cities()))
    spreads: dict[tuple, Spread] = {}
    for city in cities():
        moved = TileScene(
            replace(task, city=city), build_surface(city, region, grid, heights.all_touched)
        )
        made = [
            _obstacles(moved),
            *(_maps(moved, task.metrics[name], only_m=True) for name in task.spread_metrics),
        ]
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


TAIL = 0.05  # the percentiles reported are the 5th and the 95th


def perturbed_cities(
    city: City, height_std_m: HeightStd, num_samples: int, seed: int
) -> Iterator[City]:
    """Yield the city with heights drawn again, once a sample; the same seed gives the same cities."""
    if city.roofs is not None:
        from scipy.ndimage import label

        labels, num_buildings = label(
            np.nan_to_num(city.roofs.values) > 0, structure=np.ones((3, 3))
        )
    for sample in range(num_samples):
        rng = np.random.default_rng([seed, sample])
        if city.buildings is not None:
            by_origin = asdict(height_std_m) | {"layer": height_std_m.default, "generated": 0.0}
            std_m = np.array([by_origin[origin.name.lower()] for origin in HeightOrigin])[
                city.buildings.origin
            ]
            errors_m = rng.standard_normal(len(city.buildings)) * std_m
            height_m = np.maximum(city.buildings.height_m + errors_m, 0.0)
            floor_m = city.buildings.min_height_m
            floor_m = np.where(
                floor_m > 0, np.maximum(floor_m + errors_m, 0.0), floor_m
            )  # what hangs moves as a whole
            yield replace(
                city, buildings=replace(city.buildings, height_m=height_m, min_height_m=floor_m)
            )
        else:
            assert city.roofs is not None
            errors_m = np.append(0.0, rng.standard_normal(num_buildings) * height_std_m.raster)[
                labels
            ]
            values = np.where(
                labels > 0, np.maximum(city.roofs.values + errors_m, 0.0), city.roofs.values
            )
            yield replace(city, roofs=replace(city.roofs, values=values.astype(np.float32)))


class Spread:
    """Mean, standard deviation and the two tail percentiles of arrays that come one by one.

    Mean and deviation after Welford (1962). For the percentiles only the lowest and the highest few arrays are kept:
    of 32 samples three each.
    """

    def __init__(self, num_samples: int):
        self.num_samples, self.count = num_samples, 0
        position = TAIL * (num_samples - 1)
        self.below = math.floor(position)
        self.share = position - self.below
        self.kept = min(self.below + 2, num_samples)

    def add(self, values: np.ndarray) -> None:
        """Take in one more array, of the shape of all others."""
        values = np.asarray(values, np.float32)
        if self.count == 0:
            self.mean, self.squares = np.zeros_like(values), np.zeros_like(values)
            self.lowest = self.highest = np.empty((0, *values.shape), np.float32)
        self.count += 1
        from_old = values - self.mean
        self.mean += from_old / self.count
        self.squares += from_old * (values - self.mean)
        self.lowest = np.sort(np.concatenate([self.lowest, values[None]]), axis=0)[: self.kept]
        self.highest = np.sort(np.concatenate([self.highest, values[None]]), axis=0)[-self.kept :]

    def results(self) -> dict[str, np.ndarray]:
        """Return ``mean``, ``std`` (of the sample, n - 1), ``p05`` and ``p95`` (linear between samples)."""
        last = self.kept - 1
        low, low_next = self.lowest[self.below], self.lowest[min(self.below + 1, last)]
        high, high_next = (
            self.highest[last - self.below],
            self.highest[max(last - self.below - 1, 0)],
        )
        return {
            "mean": self.mean,
            "std": np.sqrt(self.squares / max(self.count - 1, 1)),
            "p05": low + self.share * (low_next - low),
            "p95": high + self.share * (high_next - high),
        }
