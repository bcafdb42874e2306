"""Lidar visibility: the share of a spinning lidar's scan positions that see a building."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError
from jaxurban.kernels import lidar as kernel
from jaxurban.kernels.fine_lidar import phase_starts
from jaxurban.kernels.terrain_lidar import count_returns_on_terrain, distinct_looks
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.settings import differentiable, holds
from jaxurban.surface import Surface


@differentiable("range_m")
@dataclass(frozen=True)
class LidarParams:
    """A puck lidar that turns about the vertical. A pytree whose leaf is the range.

    Attributes:
      num_beams: beams of a scan position, b.
      field_of_view_deg: elevation of the lowest and of the highest beam above the horizon; the
        beams lie at equal steps between them, a single one in the middle.
      num_azimuths: scan positions of a turn, k, equally spaced from grid north.
      range_m: slant range along a beam, r.

    Raises:
      InputError: a count below 1, a field of view out of order or not within -90 to 90 degrees, or a
        range that is not a positive number.
    """

    num_beams: int = 16
    field_of_view_deg: tuple[float, float] = (-15.0, 15.0)
    num_azimuths: int = 360
    range_m: float = 100.0

    def __post_init__(self) -> None:
        for name in ("num_beams", "num_azimuths"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= 1):
                raise InputError(f"lidar {name} must be a whole number of at least 1, got {value!r}")
        low, high = self.field_of_view_deg
        if not -90 < low <= high < 90:
            raise InputError(
                "lidar field_of_view_deg must be the lowest and the highest beam's elevation, ascending and "
                f"within -90 and 90 degrees, such as (-15.0, 15.0), got {self.field_of_view_deg}"
            )
        if not holds(self.range_m, lambda range_m: np.isfinite(range_m) & (range_m > 0)):
            raise InputError(f"lidar range_m must be a positive number of metres, got {self.range_m}")

    @property
    def elevations_rad(self) -> np.ndarray:
        """Elevation of each beam above the horizon, ascending, ``[B]``."""
        low, high = np.deg2rad(self.field_of_view_deg)
        return np.linspace(low, high, self.num_beams) if self.num_beams > 1 else np.array([(low + high) / 2])


def reach_m(params: LidarParams) -> float:
    """Return how far beyond a cell its metric looks, rounded up to whole cells by the caller."""
    return params.range_m


def compute_lidar(
    surface: Surface, altitudes_m: Sequence[float] | jax.Array, params: LidarParams
) -> Float[Array, "A y x"]:
    """Return m_lidar, the share of scan positions that return, on the region, ``[A, y, x]`` float32 in [0, 1].

    A scan position returns when any of its beams meets a building within range before the ground,
    which is no landmark. With terrain, receivers and roofs stand on it and it ends beams too.
    0 inside obstacles. What stands more than the range beyond the region changes nothing; beyond the
    surface nothing stands. Paper: section Lidar Visibility, scan(j) and m_lidar = s / k.
    Departures: the ground ends beams, and rays follow the stepping rule of `jaxurban.kernels.lidar`.
    The gradient is zero.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitudes_m: ``[A]`` heights above ground.
      params: the lidar.
    """
    resolution_m = surface.grid.resolution_m
    steps = kernel.num_steps(resolution_m, params.range_m)
    offsets = kernel.ray_offsets(params.num_azimuths, steps)
    lowest_m = kernel.lowest_heights(
        np.asarray(altitudes_m, float), params.elevations_rad, resolution_m, params.range_m, steps
    )
    roof_m = surface.crop_with_halo(surface.roof_m, steps - 1)
    if surface.terrain_m is None:
        thresholds_m = kernel.round_up(kernel.flat_thresholds(lowest_m), roof_m.dtype)
        returns = kernel.count_returns(roof_m, jnp.asarray(thresholds_m), jnp.asarray(offsets))
    else:
        terrain_m = surface.crop_with_halo(surface.terrain_m, steps - 1)
        beams_m = jnp.asarray(kernel.round_up(lowest_m, roof_m.dtype))
        looks = distinct_looks(phase_starts(offsets, 1))
        returns = count_returns_on_terrain(roof_m[None], terrain_m[None], beams_m, looks, halo=steps - 1)
    share = returns.astype(roof_m.dtype) / params.num_azimuths
    return jnp.where(obstacle_mask(surface.crop(surface.roof_m), altitudes_m), 0.0, share)
