"""Proximity risk: how far the nearest building is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError, nearest_name
from jaxurban.kernels import distance as kernel
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.settings import differentiable, holds
from jaxurban.surface import Surface

DISTANCES = ("slice", "solid")


@differentiable("threshold_m")
@dataclass(frozen=True)
class RiskParams:
    """What counts as close. A pytree whose leaf is the threshold.

    Attributes:
      threshold_m: distance from which there is no risk, d_thresh.
      distance: ``"slice"``: to the nearest obstacle of the slice at the height of flight;
        ``"solid"``: to the nearest point of a building in 3-D, roofs below included.

    Raises:
      InputError: a threshold that is not a positive number, or an unknown distance.
    """

    threshold_m: float = 50.0
    distance: Literal["slice", "solid"] = "slice"

    def __post_init__(self) -> None:
        if not holds(self.threshold_m, lambda threshold_m: np.isfinite(threshold_m) & (threshold_m > 0)):
            raise InputError(f"risk threshold_m must be a positive number of metres, got {self.threshold_m}")
        if self.distance not in DISTANCES:
            hint = nearest_name(str(self.distance), DISTANCES)
            raise InputError(f"risk distance must be 'slice' or 'solid', got {self.distance!r}{hint}")


def reach_m(params: RiskParams) -> float:
    """Return how far beyond a cell its metric looks, rounded up to whole cells by the caller."""
    return params.threshold_m


def compute_risk(
    surface: Surface, altitudes_m: Sequence[float] | jax.Array, params: RiskParams
) -> Float[Array, "A y x"]:
    """Return m_risk = min(d / d_thresh, 1) on the region, ``[A, y, x]`` float32; 0 inside obstacles.

    d is the exact Euclidean distance between cell centres to the nearest obstacle cell of the slice
    at the altitude, which follows the terrain as the altitudes do. ``"solid"`` adds the roofs below:
    each cell with a building is a column up to its roof, and d runs from the receiver to the nearest
    column; with terrain, receivers and columns stand on it. Bare ground is no obstacle in either form.
    What stands more than the threshold beyond the region changes nothing; beyond the surface nothing
    stands. Paper: eq. proximity_risk. Gradients: see `jaxurban.kernels.distance`; ``"slice"`` has none
    in heights.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitudes_m: ``[A]`` heights above ground.
      params: the risk.
    """
    resolution_m, cap_m = surface.grid.resolution_m, params.threshold_m
    halo = kernel.window_cells(cap_m, resolution_m)
    roof_m = surface.crop_with_halo(surface.roof_m, halo)
    has_building = roof_m > 0
    is_solid = params.distance == "solid"
    terrain_m = None if surface.terrain_m is None else surface.crop_with_halo(surface.terrain_m, halo)

    def distance_at(altitude_m: jax.Array) -> jax.Array:
        if is_solid and terrain_m is not None:
            return kernel.capped_distance_over_terrain(
                terrain_m + altitude_m, terrain_m + roof_m, has_building, resolution_m=resolution_m, cap_m=cap_m
            )
        if is_solid:
            source_m2 = jnp.where(has_building, jnp.maximum(altitude_m - roof_m, 0.0) ** 2, jnp.inf)
        else:
            source_m2 = jnp.where(obstacle_mask(roof_m, altitude_m[None])[0], 0.0, jnp.inf).astype(roof_m.dtype)
        return kernel.capped_distance(source_m2, resolution_m=resolution_m, cap_m=cap_m)

    # A loop over jitted kernels: a scan over this closure would be compiled anew at each call.
    distance_m = jnp.stack([distance_at(altitude_m) for altitude_m in jnp.asarray(altitudes_m, roof_m.dtype)])
    rows, cols = surface.region.shape
    return distance_m[:, halo : halo + rows, halo : halo + cols] / cap_m
