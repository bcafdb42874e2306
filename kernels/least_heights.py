"""From which height on enough satellites are in view: exactly, of the heights at which each leaves the shadows."""

from functools import partial

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxurban.kernels.blocks import by_device_cells
from jaxurban.kernels.dop import Geometry, dops
from jaxurban.programs import kept_jit


@partial(kept_jit, static_argnames=("dop",))
def least_heights(
    shadow_m: Float[Array, "S ..."],
    roof_m: Float[Array, "..."],
    satellites: Geometry,
    threshold: ArrayLike,
    *,
    dop: str,
) -> Float[Array, "..."]:
    """Return the least height above the ground from which a DOP stays at or below a threshold, in metres.

    A receiver that rises sees a satellite from the height of its shadow on, so that the satellites in view change at
    these heights alone: the DOPs of what is seen at each of them are those of all heights. Where a further satellite
    makes the DOP worse, as the first of a system with a clock of its own can, only heights above the highest bad one
    count. Heights inside a roof count as its top. There is no gradient.

    Args:
      shadow_m: how high each satellite's shadow reaches above the ground; ``...`` are any axes of cells.
      roof_m: height of the roof above the ground, 0 without one.
      satellites: their geometry; those of weight 0 fill up, and their shadows do not matter.
      threshold: the highest DOP that is good.
      dop: which one, such as ``"gdop"``.

    Returns:
      The heights, from the roof's up; inf where even all satellites are too few.
    """
    # Heights at which satellites come into view, those that fill up last.
    weights = jnp.asarray(satellites.weights).reshape(-1, *[1] * roof_m.ndim)
    height_m = jnp.where(weights > 0, jnp.maximum(shadow_m, roof_m[None]), jnp.inf)

    def least(heights_m: Array) -> Array:
        """Return the least good height of each of a block of cells, from ``[S, C]`` heights of satellites."""

        def bad(at_m: Array) -> Array:
            """Return ``[C]`` heights where the DOP there is bad, else -inf."""
            is_seen = (heights_m <= at_m[None]).astype(heights_m.dtype)
            values = getattr(dops(satellites, is_seen), dop)
            return jnp.where(values <= threshold, -jnp.inf, at_m)

        highest_bad_m = jnp.max(lax.map(bad, heights_m), axis=0)
        return jnp.min(jnp.where(heights_m > highest_bad_m[None], heights_m, jnp.inf), axis=0)

    return by_device_cells(least, height_m)
