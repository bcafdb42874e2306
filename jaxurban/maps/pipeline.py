"""Every map of a region as one pure function of arrays, to be jitted, mapped over (`jax.vmap`) and exported.

`inputs_of` and `skies_of` make ready on the host what a city, a sky and settings say; `all_maps` then computes the maps
of one time. It defines what the maps are: `jaxurban.maps.recipe`, which makes them layer by layer and on a CPU in
threads, gives the same bits outside obstacles (population: but for float32's last bit). Supersampled maps, bounds,
spreads, statistics over time and own layers are the recipe's alone; soft maps are `SoftCity`'s.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError, typed
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import ALTITUDE, TIME_OF_DAY, Metric, TracedScene
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.registry import ON_REQUEST, known_metrics
from jaxurban.metrics.visibility import SkyView, visible_words
from jaxurban.metrics.weights import GivenWeights, Weights
from jaxurban.world.city import SLABS
from jaxurban.world.surface import Surface


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
        held = self.settings | dict(self.fixed)
        return {name: (metric, held[name]) for name, metric in known_metrics().items() if name in held}

    def at_altitudes(self, altitudes_m: Sequence[float]) -> "MapInputs":
        """Return these inputs at other altitudes above the ground, none below the lowest of them.

        Raises:
          InputError: no altitude, or a lower one: the surface's margin holds what shadows the lowest one, and no more.
        """
        lowest_m = float(jnp.min(self.altitudes_m))
        if not len(altitudes_m) or not all(lowest_m <= altitude_m < np.inf for altitude_m in altitudes_m):
            raise InputError(
                f"the surface holds what shadows {lowest_m:g} m and higher, got altitudes_m {list(altitudes_m)}: make "
                "the inputs at the lowest altitude"
            )
        flown = {name: held for name, held in self.metrics.items() if ALTITUDE in held[0].dims}
        ready = {
            name: metric.ready(self.surface, altitudes_m, settings, None)
            for name, (metric, settings) in flown.items()
            if metric.ready is not None
        }
        altitudes = jnp.asarray(altitudes_m, self.surface.roof_m.dtype)
        return replace(self, altitudes_m=altitudes, ready=self.ready | ready)


def inputs_of(task: MapTask) -> MapInputs:
    """Return a task's surface and settings, made ready for `all_maps`.

    Raises:
      InputError: what `all_maps` knows nothing of: slabs, finer cells for rays, bounds, spreads and own layers.
    """
    params = task.params
    if task.city.hanging == SLABS:
        raise InputError(
            'the maps as one function know no slabs: read the city with hanging = "to_ground", or make the maps with '
            "build_maps"
        )
    is_more = params.oversample > 1 or params.gps.bounds or params.heights.height_samples or task.layers
    if is_more or params.gps.weighting != "none":
        raise InputError(
            "the maps as one function know no oversample, bounds, weighting, height_samples or own layers: leave them "
            "out, or make the maps with build_maps"
        )
    if asked := [name for name, metric in task.metrics.items() if name in ON_REQUEST and metric.traced is None]:
        raise InputError(
            f"the maps as one function hold no {' and no '.join(asked)}: leave it out, or make the maps with build_maps"
        )
    surface, blocks = jax.tree.map(jnp.asarray, task.surface()), task.city.blocks
    ready: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    fixed: dict[str, Any] = {}
    for name, metric in task.metrics.items():
        if metric.traced is None:
            continue
        given = task.settings_of(metric)
        (fixed if metric.reach_m(given) else settings)[name] = given
        if metric.ready is not None:
            ready[name] = metric.ready(surface, params.altitudes_m, given, blocks)
    altitudes_m = jnp.asarray(params.altitudes_m, surface.roof_m.dtype)
    return MapInputs(surface, altitudes_m, ready, settings, tuple(fixed.items()))


def skies_of(task: MapTask, surface: Surface) -> SkyView:
    """Return the skies of all times of a task over its surface, every field stacked along the times ``[T, ...]``.

    One time is ``jax.tree.map(lambda values: values[t], views)``; all of them are mapped over by
    ``jax.vmap(all_maps, (None, 0))``. Times with fewer satellites than the fullest are filled up.
    """
    skies = [task.in_view(t) for t in range(task.num_times)]
    most = max(1, *(len(in_view.numbers) for in_view in skies))
    views = [SkyView.of(surface, *in_view.angles, most, in_view.clocks) for in_view in skies]
    return jax.tree.map(lambda *values: jnp.asarray(np.stack(values)), *views)


@typed
def all_maps(inputs: MapInputs, sky: SkyView, weights: GivenWeights = None) -> dict[str, Array]:
    """Return every map of a region at one time, by its variable. Pure: jit it, map over it, export it.

    ``jax.vmap`` over any leaf: skies or times (`skies_of`), roofs, altitudes with their beams, the GDOP threshold,
    gammas, weights. Gradients are those of the hard maps: of the threshold, the gammas and the weights.

    Args:
      inputs: from `inputs_of`.
      sky: of one time.
      weights: give ``cost`` too, the weighted sum of the metrics' costs, ``[A, y, x]`` or, with population,
        ``[A, D, y, x]``: what a step into a cell costs beside its length.

    Returns:
      ``obstacle`` uint8 ``[A, y, x]`` and all maps of each metric with a traced form: ``gps``, its DOPs and
      ``num_visible``, ``lidar`` and ``risk`` ``[A, y, x]``, and with census blocks ``population`` and ``density``
      ``[D, y, x]``. Inside obstacles, where `build_maps` has NaN, they are finite or, as DOPs, inf, so that gradients
      stay finite; NaN where the surface has no data, but integers keep what they are there.

    Raises:
      InputError: skies of several times, or weights that are none.
    """
    if np.ndim(sky.num):
        raise InputError(
            f"sky must be of one time, got {len(sky.num)}: take jax.vmap(all_maps, (None, 0)), or one by "
            "jax.tree.map(lambda values: values[0], skies)"
        )
    surface, altitudes_m = inputs.surface, inputs.altitudes_m
    is_obstacle = obstacle_mask(surface.crop(surface.roof_m), altitudes_m)
    words = jnp.where(is_obstacle, jnp.uint32(0), visible_words(surface, altitudes_m, sky))
    maps = {"obstacle": is_obstacle.astype(jnp.uint8)}
    scene = TracedScene(surface, altitudes_m, sky.satellites, words)
    for name, (metric, settings) in inputs.metrics.items():
        assert metric.traced is not None
        maps |= metric.traced(scene._replace(ready=inputs.ready.get(name)), settings)
    if weights is not None:
        maps["cost"] = _weighted(inputs, maps, Weights.of(weights))
    if surface.has_data is not None:
        has_data = surface.crop(surface.has_data)  # after the cost, so that its derivatives stay finite
        maps = {
            name: jnp.where(has_data, values, jnp.nan) if jnp.issubdtype(values.dtype, jnp.floating) else values
            for name, values in maps.items()
        }
    return maps


def _weighted(inputs: MapInputs, maps: dict[str, Array], weights: Weights) -> Array:
    """Return the sum of the metrics' costs times their weights."""
    metrics = [metric for metric, _ in inputs.metrics.values()]
    has_times = any(TIME_OF_DAY in metric.dims for metric in metrics)
    total = jnp.zeros(())
    for metric in metrics:
        m = maps[metric.name]
        if has_times:
            m = m[None] if TIME_OF_DAY in metric.dims else m[:, None]
        total = total + jnp.asarray(weights[metric.name]) * metric.cost(m)
    return total
