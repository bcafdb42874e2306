"""Maps of one metric in one call, from the parts that the recipe puts together."""

from dataclasses import replace

from jaxurban.metrics.gps import Gps, SatelliteSet
from jaxurban.metrics.obstacle import obstacles_on
from jaxurban.metrics.population import BlockLayers, Population, block_layers, map_blocks
from jaxurban.metrics.visibility import visibility


def compute_gps(surface, azimuth_rad, elevation_rad, altitudes_m, params=None, clocks=None):
    """Return the GPS maps of a region at every altitude, for one time."""
    words = visibility(surface, azimuth_rad, elevation_rad, altitudes_m)
    satellites = SatelliteSet.of(azimuth_rad, elevation_rad, params or Gps(), clocks)
    return satellites.maps(words, obstacles_on(surface, altitudes_m))


def population_maps(block, blocks, times_of_day=("day", "night"), params=None, bounds_m=None):
    """Return the metric and the density over a region at each time of day, and the norm."""
    m, density, norm = block_layers(blocks, replace(params or Population(), time_of_day=times_of_day), bounds_m)
    return BlockLayers(map_blocks(block, m), map_blocks(block, density), norm)
