"""Every map of a region as one pure function of arrays, to be jitted, mapped over (`jax.vmap`) and exported.

`inputs_of` and `skies_of` make ready on the host what a city, a sky and settings say; `all_maps` then computes the maps
of one time. It defines what the maps are: `jaxurban.maps.recipe`, which makes them layer by layer and on a CPU in
threads, gives the same bits (population: the same but for float32's last bit). Supersampled maps, bounds, spreads,
statistics over time and own layers are the recipe's alone; soft maps are `SoftCity`'s.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError, typed
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Gps, maps_of_words
from jaxurban.metrics.lidar import Lidar, beam_heights, lidar_of_beams
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.population import BlockPopulation, Population, day_share, layers_of_blocks, map_blocks
from jaxurban.metrics.registry import METRICS, ON_REQUEST
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.visibility import SkyView, visible_words
from jaxurban.metrics.weights import GivenWeights, Weights
from jaxurban.world.city import SLABS
from jaxurban.world.surface import Surface


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MapInputs:
    """What the maps of a region depend on besides the sky. ``A`` altitudes, ``D`` times of day; may be traced.

    Attributes:
      surface: roofs, terrain and census blocks on the region and its margin.
      altitudes_m: ``[A]`` above the ground.
      beams_m: ``[A, N]`` or ``[A, N, B]`` from `jaxurban.metrics.lidar.beam_heights`; goes with the altitudes.
      day_share: ``[D]`` how far the population has moved from night to day.
      population: the census blocks; None without them.
      gps: of which the threshold may be traced.
      people: settings of the population, of which the gammas may be traced.
      risk, lidar: their ranges decide shapes: plain numbers.
    """

    surface: Surface
    altitudes_m: Float[Array, " A"]
    beams_m: Float[Array, "A N ..."]
    day_share: Float[Array, " D"]
    population: BlockPopulation | None
    gps: Gps
    people: Population
    risk: Risk = field(metadata={"static": True})
    lidar: Lidar = field(metadata={"static": True})

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
        beams_m = jnp.asarray(beam_heights(altitudes_m, self.lidar, self.surface))
        return replace(self, altitudes_m=jnp.asarray(altitudes_m, self.surface.roof_m.dtype), beams_m=beams_m)


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
    is_more = params.oversample > 1 or params.gps_bounds or params.height_samples or task.layers
    if is_more or params.gps.weighting != "none":
        raise InputError(
            "the maps as one function know no oversample, bounds, weighting, height_samples or own layers: leave them "
            "out, or make the maps with build_maps"
        )
    if asked := [name for name in task.metrics if name in ON_REQUEST]:
        raise InputError(
            f"the maps as one function hold no {' and no '.join(asked)}: leave it out of others, or make the maps with "
            "build_maps"
        )
    surface = jax.tree.map(jnp.asarray, task.surface())
    blocks = task.city.blocks
    return MapInputs(
        surface,
        jnp.asarray(params.altitudes_m, surface.roof_m.dtype),
        jnp.asarray(beam_heights(params.altitudes_m, params.lidar, surface)),
        jnp.asarray([day_share(time_of_day, params.population) for time_of_day in params.times_of_day], np.float32),
        None if blocks is None else BlockPopulation.of(blocks, task.region.bounds_m),
        params.gps,
        params.population,
        params.risk,
        params.lidar,
    )


def skies_of(task: MapTask, surface: Surface) -> SkyView:
    """Return the skies of all times of a task over its surface, every field stacked along the times ``[T, ...]``.

    One time is ``jax.tree.map(lambda values: values[t], views)``; all of them are mapped over by
    ``jax.vmap(all_maps, (None, 0))``. Times with fewer satellites than the fullest are filled up.
    """
    angles = [task.angles(t) for t in range(task.num_times)]
    most = max(1, *(len(azimuth_rad) for azimuth_rad, _ in angles))
    views = [SkyView.of(surface, *of_time, most, task.clocks(t)) for t, of_time in enumerate(angles)]
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
      ``obstacle`` uint8, ``gps``, ``gdop``, ``pdop``, ``hdop``, ``vdop``, ``tdop``, ``num_visible``, ``lidar`` and
      ``risk`` ``[A, y, x]``, and with census blocks ``population`` and ``density`` ``[D, y, x]``. NaN where the
      surface has no data; integers keep what they are there.

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
    gps = maps_of_words(words, sky.satellites, inputs.gps.gdop_threshold)
    maps = {
        "obstacle": is_obstacle.astype(jnp.uint8),
        "gps": gps.m,
        **{name: getattr(gps, name) for name in ("gdop", "pdop", "hdop", "vdop", "tdop", "num_visible")},
        "lidar": lidar_of_beams(surface, altitudes_m, inputs.beams_m, inputs.lidar),
        "risk": compute_risk(surface, altitudes_m, inputs.risk, "jax"),
    }
    if (blocks := inputs.population) is not None and surface.block is not None:
        layers = layers_of_blocks(blocks, inputs.day_share, inputs.people)
        of_blocks = {"population": layers.m, "density": layers.density_per_km2}
        maps |= {name: map_blocks(surface.block, values) for name, values in of_blocks.items()}
    if weights is not None:
        maps["cost"] = _weighted(maps, Weights.of(weights))
    if surface.has_data is not None:
        has_data = surface.crop(surface.has_data)  # after the cost, so that its derivatives stay finite
        maps = {
            name: jnp.where(has_data, values, jnp.nan) if jnp.issubdtype(values.dtype, jnp.floating) else values
            for name, values in maps.items()
        }
    return maps


def _weighted(maps: dict[str, Array], weights: Weights) -> Array:
    """Return the sum of the metrics' costs times their weights."""
    has_people = "population" in maps
    total = jnp.zeros(())
    for name, metric in METRICS.items():
        if name in maps:
            m = maps[name]
            if has_people:
                m = m[None] if name == "population" else m[:, None]
            total = total + jnp.asarray(weights[name]) * metric.cost(m)
    return total
