"""Finer answers and uncertainty: what they add to the layers of a region, or of a tile of one."""

from collections.abc import Iterator
from functools import cached_property

import jax
import numpy as np

from jaxurban.city import City
from jaxurban.grid import Grid
from jaxurban.layers import MapParams, Stage
from jaxurban.oversample import (
    Bands,
    build_fine_surface,
    compute_gps_bounds,
    lidar_at_centres,
    plain_bands,
    visibility_at_centres,
)
from jaxurban.sky import Sky
from jaxurban.surface import Surface
from jaxurban.uncertainty import metric_spread


class RegionDetail:
    """Answers on a surface ``oversample`` times finer, bounds of m_gps, and spreads by uncertain heights.

    Each cell depends on the city around it alone, so a tile's values equal the crop of the whole region's.

    Args:
      city: rasterised anew, finer, or with other heights.
      region: grid of the maps, or a tile of it.
      grid: the region and the margin that shadows it (`jaxurban.layers.margin_of`).
      sky: epochs and satellites.
      params: settings.
    """

    def __init__(self, city: City, region: Grid, grid: Grid, sky: Sky, params: MapParams) -> None:
        self.city, self.region, self.grid, self.sky, self.params = city, region, grid, sky, params

    @classmethod
    def wanted(cls, city: City, region: Grid, grid: Grid, sky: Sky, params: MapParams) -> "RegionDetail | None":
        """Return the detail that the settings ask for, None for plain maps."""
        if params.oversample == 1 and not params.gps_bounds and not params.height_samples:
            return None
        return cls(city, region, grid, sky, params)

    @cached_property
    def fine(self) -> Surface:
        """The finer surface."""
        return build_fine_surface(self.city, self.region, self.grid, self.params.oversample, self.params.all_touched)

    @cached_property
    def bands(self) -> Bands:
        """The finer surface, made ready for sweeps."""
        return plain_bands(self.fine, self.params.oversample)

    def angles(self, epoch: int) -> tuple[np.ndarray, np.ndarray]:
        """Return azimuths and elevations of the satellites above the mask at an epoch."""
        seen = self.params.satellites_at(self.sky, epoch)
        return self.sky.azimuth_rad[epoch, seen], self.sky.elevation_rad[epoch, seen]

    def words(self, epoch: int) -> jax.Array:
        """Return the visibility words ``[W, A, y, x]`` of an epoch, from the finer surface."""
        return visibility_at_centres(self.bands, *self.angles(epoch), np.asarray(self.params.altitudes_m))

    def lidar(self, is_obstacle: jax.Array, altitude_m: float) -> jax.Array:
        """Return m_lidar on the finer surface, ``[1, y, x]``."""
        return lidar_at_centres(
            self.fine, self.params.oversample, is_obstacle, np.array([altitude_m]), self.params.lidar
        )

    def layers(self, is_obstacle: jax.Array, stage: Stage) -> Iterator[tuple[str, tuple[int, ...], np.ndarray]]:
        """Yield name, place before y and x, and values of bounds and spreads."""
        params = self.params
        found: dict[str, np.ndarray] = {}
        if params.gps_bounds:
            with stage("gps_bounds"):
                epochs = [self.angles(t) for t in range(len(self.sky.times))]
                found |= compute_gps_bounds(
                    self.city,
                    self.region,
                    self.grid,
                    params.oversample,
                    is_obstacle,
                    epochs,
                    np.asarray(params.altitudes_m),
                    params.gps,
                )
        if params.height_samples:
            with stage("height_spread"):
                spread = metric_spread(
                    self.city,
                    self.region,
                    self.sky,
                    params.altitudes_m,
                    height_std=params.height_std,
                    mask_deg=params.mask_deg,
                    gps=params.gps,
                    lidar=params.lidar,
                    risk=params.risk,
                    all_touched=params.all_touched,
                    oversample=params.oversample,
                    num_samples=params.height_samples,
                    seed=params.height_seed,
                )
                found |= {str(name): array.values for name, array in spread.items()}
        for name, values in found.items():
            for place in np.ndindex(values.shape[:-2]):
                yield name, place, values[place].astype(np.float32)
