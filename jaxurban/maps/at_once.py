"""Maps of a region at once: `all_maps`, a pure function of arrays, and tiles of which a device makes the maps by it.

`all_maps` computes the maps of one time, to be jitted, mapped over (`jax.vmap`) and exported. It defines what the maps
are: `jaxurban.maps.recipe`, which makes them layer by layer and on a CPU in threads, gives the same bits outside
obstacles (population: but for float32's last bit). Supersampled maps, bounds, spreads and own layers are the recipe's
alone.

On a device a tile is the whole region where that fits into its memory. It is taken with all that can shadow it, which
moves fewer bytes than shadows that tiles would hand on. Sides are rounded up, so that one program serves all regions of
like size. The device makes one tile at a time, while other threads rasterise and write theirs.
"""

import math
import threading
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.kernels.blocks import rounded_up
from jaxurban.kernels.shadows.sweep import TOGETHER
from jaxurban.maps.free_memory import gpu_free_bytes
from jaxurban.maps.memory import format_bytes
from jaxurban.maps.task import MapTask
from jaxurban.maps.tile_scene import TileScene
from jaxurban.metrics.base import TIME_OF_DAY, Metric, Scene
from jaxurban.metrics.registry import ON_REQUEST, known_metrics
from jaxurban.metrics.variables import HIGHEST, statistics_of_ordered
from jaxurban.metrics.visibility import SkyView, visible_words
from jaxurban.metrics.weights import Weights, WeightsLike
from jaxurban.progress import Stage
from jaxurban.settings import SLABS
from jaxurban.world.grid import Grid
from jaxurban.world.surface import OF_REGION, Surface, obstacle_mask

Window = tuple[slice, slice]  # rows and columns of a region
# Cells x times from which a GPU makes maps: fewer take 16 cores less than 1.5 s, and compiling takes longer.
LEAST_CELLS = 2**22
ONE_AT_A_TIME = threading.Lock()  # so that tiles in several threads fit where one does
SIDE_BITS = 6  # of a rounded side, at most 1/32 longer: a tile's and then its grid's add 13 % of the cells at most


class TooLargeError(InputError):
    """The maps of a tile need more memory than a device has."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MapInputs:
    """What the maps of a region depend on besides the sky. ``A`` altitudes; may be traced.

    Attributes:
      surface: roofs, terrain and census blocks on the region and its margin.
      altitudes_m: ``[A]`` above the ground.
      ready: what metrics have made of these on the host, by name (`Metric.ready`): the lidar's beams go with the
        altitudes.
      settings: of the metrics by name; their leaves may be traced.
      fixed: the same of metrics that look beyond a cell: how far decides shapes, so these are plain numbers.
    """

    surface: Surface
    altitudes_m: Float[Array, " A"]
    ready: dict[str, Any]
    settings: dict[str, Any]
    fixed: tuple[tuple[str, Any], ...] = field(metadata={"static": True})

    @property
    def metrics(self) -> dict[str, tuple[Metric, Any]]:
        """The metrics with their settings, by name, in the order of the cost."""
        settings = self.settings | dict(self.fixed)
        return {
            name: (metric, settings[name])
            for name, metric in known_metrics().items()
            if name in settings
        }


def inputs_of(task: MapTask) -> MapInputs:
    """Return a task's surface and settings, made ready for `all_maps`.

    Raises:
      InputError: the task needs what `all_maps` cannot do: slabs, finer cells for rays, bounds, spreads, own layers, or
        a metric on request without a traced form.
    """
    params = task.params
    traced = {name: metric for name, metric in task.metrics.items() if metric.traced is not None}
    is_asked = {
        'slabs (hanging = "to_ground" leaves them out)': task.city.hanging == SLABS,
        "oversample": params.oversample > 1,
        "bounds": params.gps.bounds,
        "height_samples": params.heights.height_samples > 0,
        "own layers": len(task.layers) > 0,
        **{name: name not in traced for name in task.metrics if name in ON_REQUEST},
    }
    unknown = [what for what, is_so in is_asked.items() if is_so]
    if unknown:
        raise InputError(
            f"the maps as one function hold no {' and no '.join(unknown)}: leave it out, or make the maps with "
            "build_maps"
        )
    return _made_ready(task, task.surface().of_jax(), traced.values())


def _made_ready(task: MapTask, surface: Surface, metrics: Iterable[Metric]) -> MapInputs:
    """Return a surface, and a task's settings of metrics that have a traced form."""
    params = task.params
    ready = {}
    settings = {}
    fixed = {}
    for metric in metrics:
        name = metric.name
        # Settings that say where data are from get their defaults, as a program would be compiled for each of them.
        default = metric.params()
        unread = {source: getattr(default, source) for source in metric.sources}
        own = replace(task.settings_of(metric), **unread)
        if metric.reach_m(own):
            fixed[name] = own
        else:
            settings[name] = own
        if metric.ready is not None:
            ready[name] = metric.ready(surface, params.altitudes_m, own, task.city.blocks)
    altitudes_m = jnp.asarray(params.altitudes_m, surface.roof_m.dtype)
    return MapInputs(surface, altitudes_m, ready, settings, tuple(fixed.items()))


def skies_of(task: MapTask, surface: Surface) -> SkyView:
    """Return the skies of all times of a task over its surface, every field stacked along the times ``[T, ...]``.

    The sky of one time is ``jax.tree.map(lambda values: values[t], views)``; ``jax.vmap(all_maps, (None, 0))`` maps
    over all of them. Satellites without effect round their number up to one for all times, a multiple of `TOGETHER`.

    Args:
      task: whose sky and clocks count.
      surface: the task's, from `inputs_of`.
    """
    skies = [task.in_view(t) for t in range(task.num_times)]
    most = max(1, *(len(in_view.numbers) for in_view in skies))  # satellites at a time
    most = rounded_up(most, TOGETHER)
    views = [SkyView.of(surface, *in_view.angles, most, in_view.clocks) for in_view in skies]
    return jax.tree.map(lambda *values: jnp.asarray(np.stack(values)), *views)


@typed
def all_maps(inputs: MapInputs, sky: SkyView, weights: WeightsLike = None) -> dict[str, Array]:
    """Return every map of a region at one time, by its variable. Pure: jit it, map over it, export it.

    ``jax.vmap`` over any leaf: skies or times, roofs, altitudes with their beams, the GDOP threshold,
    gammas, weights. Gradients are those of the hard maps: of the threshold, the gammas and the weights.

    Args:
      inputs: from `map_inputs`, which gives the skies too.
      sky: of one time.
      weights: give ``cost`` too, the weighted sum of the metrics' costs, ``[A, y, x]`` or, with population,
        ``[A, D, y, x]``: what a step into a cell costs beside its length.

    Returns:
      ``obstacle`` uint8 ``[A, y, x]`` and all maps of each metric with a traced form: ``gps``, its DOPs and
      ``num_visible``, ``lidar`` and ``risk`` ``[A, y, x]``, and with census blocks ``population`` and ``density``
      ``[D, y, x]``. Inside obstacles, where `build_maps` has NaN, they are finite or, as DOPs, inf, so that gradients
      stay finite; NaN where the surface has no data, but integers keep what they are there.

    Raises:
      InputError: skies of several times, or invalid weights.

    Examples:
      >>> import jax
      >>> inputs, skies = ju.grad.map_inputs(city, maps.grid, altitudes_m=(60.0,))
      >>> made = jax.jit(jax.vmap(ju.grad.all_maps, (None, 0)))(inputs, skies)  # all times
      >>> made["gps"].shape, made["population"].shape
      ((1, 1, 30, 30), (1, 2, 30, 30))
    """
    if np.ndim(sky.num):
        raise InputError(
            f"sky must be of one time, got {len(sky.num)}: take jax.vmap(all_maps, (None, 0)), or one by "
            "jax.tree.map(lambda values: values[0], skies)"
        )
    surface = inputs.surface
    altitudes_m = inputs.altitudes_m
    is_obstacle = obstacle_mask(surface.crop(surface.roof_m), altitudes_m)
    maps = {"obstacle": is_obstacle.astype(jnp.uint8)}

    # Which satellites each cell sees, none inside obstacles; then the metrics.
    words = jnp.where(is_obstacle, jnp.uint32(0), visible_words(surface, altitudes_m, sky))
    scene = Scene(surface, altitudes_m, words=words, sky=sky, engine="jax")
    for name, (metric, settings) in inputs.metrics.items():
        assert metric.traced is not None
        maps |= metric.traced(replace(scene, ready=inputs.ready.get(name)), settings)

    if weights is not None:
        maps["cost"] = _weighted(inputs, maps, Weights.of(weights))
    if surface.has_data is not None:  # after the cost, so that its derivatives stay finite
        has_data = surface.crop(surface.has_data)
        for name, values in maps.items():
            if jnp.issubdtype(values.dtype, jnp.floating):
                maps[name] = jnp.where(has_data, values, jnp.nan)
    return maps


def _weighted(inputs: MapInputs, maps: dict[str, Array], weights: Weights) -> Array:
    """Return the sum of the metrics' costs times their weights, ``[A, y, x]`` or, with times of day, ``[A, D, y, x]``.

    Args:
      inputs: name the metrics.
      maps: of each metric, ``[A, y, x]`` or, with times of day, ``[D, y, x]``.
      weights: by metric.
    """
    metrics = [metric for metric, _ in inputs.metrics.values() if metric.is_cost]
    has_times = any(TIME_OF_DAY in metric.dims for metric in metrics)
    total = jnp.zeros(())
    for metric in metrics:
        m = maps[metric.name]
        if has_times:  # to the axes [A, D, y, x]
            m = m[None] if TIME_OF_DAY in metric.dims else m[:, None]
        total = total + jnp.asarray(weights[metric.name]) * metric.cost(m)
    return total


@partial(jax.jit, static_argnames="keeps_times")
def region_maps(inputs: MapInputs, skies: SkyView, keeps_times: bool) -> dict[str, Array]:
    """Return the maps of a region at all times as `build_maps` keeps them, by variable: `all_maps`.

    Args:
      inputs: of metrics without a time, which look beyond a cell, and of those of satellites, which do not.
      skies: of all times.
      keeps_times: False gives statistics over the times.

    Returns:
      Each map with the axes of its variable before ``[y, x]``, NaN inside obstacles if it has altitudes.
    """
    still = all_maps(replace(inputs, settings={}), jax.tree.map(lambda values: values[0], skies))
    is_obstacle = still.pop("obstacle") == 1

    def kept(values: Array) -> Array:
        """Return a map that is NaN inside obstacles, if it has altitudes; whole numbers are 0 there already."""
        is_hidden = jnp.issubdtype(values.dtype, jnp.floating) and values.ndim == is_obstacle.ndim
        return jnp.where(is_obstacle, jnp.nan, values) if is_hidden else values

    def of_time(sky: SkyView) -> dict[str, Array]:
        """Return the maps of one time, for statistics m alone."""
        maps = all_maps(replace(inputs, fixed=()), sky)
        names = maps.keys() - {"obstacle"} if keeps_times else inputs.settings
        return {name: kept(maps[name]) for name in names}

    by_time = lax.map(of_time, skies)
    maps = jax.tree.map(kept, still)
    no_costs = [name for name, (metric, _) in inputs.metrics.items() if not metric.is_cost]
    if len(skies.num) > 1 or not keeps_times:
        maps |= {f"{name}_{HIGHEST}": jnp.max(by_time[name], axis=0) for name in no_costs}
    if keeps_times:
        return maps | by_time
    threshold = inputs.settings["gps"].availability_threshold
    for name in [
        name for name in by_time if name not in no_costs
    ]:  # in order: one program, as a set has none
        m = by_time[name]
        ordered = jnp.sort(jnp.moveaxis(m, 0, -1))
        for what, values in statistics_of_ordered(ordered, ordered > threshold).items():
            maps[f"{name}_{what}"] = jnp.where(jnp.isnan(m[0]), jnp.nan, values)
    return maps


def free_device_bytes(task: MapTask) -> float | None:
    """Return the free memory of the GPU that makes a task's maps; None where the host does, as of small regions."""
    num_cells = math.prod(task.region.shape) * task.num_times
    if task.params.engine == "numba" or num_cells < LEAST_CELLS or not _made_at_once(task):
        return None
    return gpu_free_bytes()


def _made_at_once(task: MapTask) -> list[Metric]:
    """Return the metrics that a device makes, none with slabs or finer cells for rays; the host makes people."""
    if task.city.hanging == SLABS or task.params.oversample > 1:
        return []
    metrics = task.metrics.values()
    return [each for each in metrics if each.traced is not None and TIME_OF_DAY not in each.dims]


def _rounded(side: int) -> int:
    """Return one of the few lengths to which sides of arrays are rounded up, in cells."""
    return rounded_up(side, 1 << max(0, side.bit_length() - SIDE_BITS))


def _grown(task: MapTask, tile: Grid) -> tuple[Grid, Grid]:
    """Return a tile, grown in the south and the east, and the same with all that can shadow it; of few shapes.

    The margin is as wide in the west as in the east, and in the south as in the north: so one program serves all skies.
    """
    num_rows, num_cols = map(_rounded, tile.shape)
    region = tile.padded(0, num_rows - tile.num_rows, num_cols - tile.num_cols, 0)
    beyond_m = np.abs(np.subtract(task.with_margin(tile).bounds_m, tile.bounds_m))
    margin = round(beyond_m.max() / tile.resolution_m)
    down, across = ((_rounded(side + 2 * margin) - side) // 2 for side in region.shape)
    return region, region.padded(across, down, across, down)


def tile_at_once(
    task: MapTask, tile: Grid, window: Window, stage: Stage, device_bytes: float
) -> TileScene:
    """Return a tile with the maps that JAX's first device makes of it, one tile at a time.

    The tile is rounded up: it may stick out of its window in the south and in the east.

    Args:
      task: what the maps are made of.
      tile: a part of the region, whose northwest corner is that of its window.
      window: rows and columns of the region that it reports.
      stage: gives the context that the work on each stage runs in.
      device_bytes: what the maps may take of the device's memory.

    Raises:
      TooLargeError: the maps need more memory, as compiled.
    """
    with stage("surface"):
        surface: Any = task.surface(*_grown(task, tile))

    # Nothing is known, nor counted, of cells beyond the window.
    rows, cols = window
    has_data: Any = np.zeros(surface.grid.shape, bool)
    surface.crop(has_data)[rows.start - rows.stop :, : cols.stop - cols.start] = True
    if surface.has_data is not None:
        has_data &= surface.has_data
    surface = replace(surface, has_data=has_data)

    unread: dict[str, Any] = dict.fromkeys(("block", *OF_REGION))
    metrics = _made_at_once(task)
    inputs = _made_ready(task, replace(surface, **unread), metrics), skies_of(task, surface)
    with ONE_AT_A_TIME, stage("device"):
        arguments = jax.device_put(inputs, jax.local_devices()[0])
        program = region_maps.lower(*arguments, keeps_times=task.keeps_times).compile()
        held: Any = program.memory_analysis()
        needed = held.argument_size_in_bytes + held.output_size_in_bytes + held.temp_size_in_bytes
        if needed > device_bytes:
            raise TooLargeError(
                f"a tile needs about {format_bytes(needed)} of the GPU's memory and {format_bytes(device_bytes)} are "
                "free: end what else uses it, choose a shorter [lidar] range_m or fewer altitudes or times, or take "
                "--device cpu"
            )
        made = jax.device_get(program(*arguments))

    return TileScene(task, surface, of_device=metrics, made=made)
