"""Obstacle: where a building stands at the height of flight; its soft form leans over one softness above the roof."""

from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxurban.metrics.base import in_type
from jaxurban.world.surface import Surface


def obstacle_mask(roof_m: Float[Array, "Y X"], altitudes_m: Sequence[float] | ArrayLike) -> Bool[Array, "A Y X"]:
    """Return H_obs: True where the highest roof of a cell is at or above the altitude, ``[A, Y, X]``.

    Args:
      roof_m: ``[Y, X]`` roof heights above the ground of their cell, 0 without a building.
      altitudes_m: ``[A]`` heights above ground.

    Receiver and roof are both measured from their own cell's ground, so terrain changes nothing.
    A cell without a building is free at every altitude. Paper: section Obstacle Maps. No gradient.
    """
    return _mask(roof_m, in_type(altitudes_m, roof_m.dtype))


@jax.jit
def _mask(roof: Array, altitudes: Array) -> Array:
    return stands_at(roof, altitudes[:, None, None])


def stands_at(roof_m: Any, altitude_m: Any) -> Any:
    """Return where a roof is at or above the altitude: the rule itself, of arrays of NumPy or JAX."""
    return (roof_m >= altitude_m) & (roof_m > 0)


def region_roofs(surface: Surface, altitude_m: float) -> Float[np.ndarray, "y x"]:
    """Return the roofs of a surface's region on the host, with what hangs at an altitude or below; of inf, with all."""
    return surface.part(np.asarray(surface.at_altitude(altitude_m).roof_m)).cut()


def obstacles_on(surface: Surface, altitudes_m: Iterable[float]) -> Bool[np.ndarray, "A y x"]:
    """Return `obstacle_mask` of a surface's region on the host, where slabs are obstacles from floor to top."""
    altitudes = np.asarray(altitudes_m, surface.roof_m.dtype)
    return np.stack([stands_at(region_roofs(surface, float(z_m)), z_m) for z_m in altitudes])


@jax.jit
def soft_obstacle(roof_m: Float[Array, "*C"], z_m: ArrayLike, softness_m: ArrayLike) -> Float[Array, "*C"]:
    """Return how much of an obstacle each cell is, 1 up to the roof, falling to 0 one softness above it.

    ``1 - q((z - roof) / softness)`` with ``q(t) = t^3 (10 - 15 t + 6 t^2)`` between 0 and 1, twice differentiable. It
    never says less than `obstacle_mask`, which it equals from one softness above the
    roof, at and below it, at softness 0, and in cells without a building (roof 0) everywhere: whole-metre roofs and
    altitudes meet exactly, so a step centred on the roof would not tend to the exact rule there.

    Derivatives: smoothed between the roof and one softness above it, 0 elsewhere and at softness 0, undefined at roof
    0, where a building appears.

    Args:
      roof_m: roof heights above the ground of their cell, 0 without a building.
      z_m: altitude above the ground, a number or one for each cell.
      softness_m: >= 0.
    """
    roof = jnp.asarray(roof_m)
    softness = jnp.asarray(softness_m, roof.dtype)
    clearance_m = jnp.asarray(z_m, roof.dtype) - roof
    t = jnp.clip(clearance_m / jnp.where(softness > 0, softness, 1), 0, 1)
    clear = jnp.where(softness > 0, t**3 * (10 - 15 * t + 6 * t**2), (clearance_m > 0).astype(roof.dtype))
    return jnp.where(roof > 0, 1 - clear, 0)
