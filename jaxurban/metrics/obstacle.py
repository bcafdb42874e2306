"""Obstacle: where a building stands at the height of flight."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def obstacle_mask(roof_m: Float[Array, "Y X"], altitudes_m: Sequence[float] | jax.Array) -> Bool[Array, "A Y X"]:
    """Return H_obs: True where the highest roof of a cell is at or above the altitude, ``[A, Y, X]``.

    Args:
      roof_m: ``[Y, X]`` roof heights above the ground of their cell, 0 without a building.
      altitudes_m: ``[A]`` heights above ground.

    Receiver and roof are both measured from their own cell's ground, so terrain changes nothing.
    A cell without a building is free at every altitude. Paper: section Obstacle Maps. No gradient.
    """
    roof = jnp.asarray(roof_m)
    altitudes = jnp.asarray(altitudes_m, roof.dtype)
    return (roof >= altitudes[:, None, None]) & (roof > 0)
