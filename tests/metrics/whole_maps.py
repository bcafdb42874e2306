"""Maps of one metric in one call, from the parts that the recipe puts together."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jaxurban.metrics.gps import Gps, GpsMaps, maps_of_choices, satellites_of
from jaxurban.metrics.population import BlockLayers, Population, block_layers, map_blocks
from jaxurban.metrics.visibility import visibility
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface, obstacles_on


def surface_on(roof_m, grid, region, terrain_m=None):
    """Return a float32 surface of roofs, and terrain where there is any."""
    terrain_m = None if terrain_m is None else jnp.asarray(terrain_m, jnp.float32)
    return Surface(jnp.asarray(roof_m, jnp.float32), terrain_m, None, None, grid, region)


def compute_gps(surface, azimuth_rad, elevation_rad, altitudes_m, params=None, clocks=None):
    """Return the GPS maps of a region at every altitude, for one time."""
    words = visibility(surface, azimuth_rad, elevation_rad, altitudes_m)
    in_view = InView(azimuth_rad, elevation_rad, (), clocks=clocks)
    return gps_maps(words, obstacles_on(surface, altitudes_m), in_view, params)


def gps_maps(words, is_obstacle, in_view, params=None):
    """Return the GPS maps of visibility words, by the choices of satellites that are seen."""
    maps, number = maps_of_choices(
        words, is_obstacle, satellites_of(in_view), (params or Gps()).gdop_threshold
    )
    return GpsMaps(*(values[number] for values in maps))


def population_maps(block, blocks, times_of_day=("day", "night"), params=None, bounds_m=None):
    """Return the metric and the density over a region at each time of day, and the norm."""
    m, density, norm = block_layers(
        blocks, replace(params or Population(), time_of_day=times_of_day), bounds_m
    )
    return BlockLayers(map_blocks(block, m), map_blocks(block, density), norm)


def seen(words, num):
    """Return visibility words as ``[S, A, y, x]`` bool."""
    return np.array(
        [(np.asarray(words)[s // 32] >> np.uint32(s % 32)) & 1 == 1 for s in range(num)]
    )


def gdop_by_inverse(weights, directions):
    """Return GDOP by NumPy's inverse for weights ``[S, ...]``, inf where the position is undetermined."""
    rows = np.column_stack([directions, -np.ones(len(directions))])
    normal = np.einsum("s...,si,sj->...ij", weights, rows, rows)
    is_determined = np.linalg.cond(normal) < 1e8
    inverse = np.linalg.inv(np.where(is_determined[..., None, None], normal, np.eye(4)))
    return np.where(is_determined, np.sqrt(np.trace(inverse, axis1=-2, axis2=-1)), np.inf)
