"""The smooth step that every soft metric is made of."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def soft_step(margin_m: Float[Array, "*n"], softness_m: Float[Array, ""] | float) -> Float[Array, "*n"]:
    """Return 1 where a margin is well above 0 and 0 where it is well below, sigmoid(margin / softness).

    At softness 0 the exact result, ``margin_m >= 0``, whose gradient is zero. Elsewhere the gradient is finite, also in
    the softness.

    Args:
      margin_m: by how much a condition holds; any shape.
      softness_m: of the same unit, not negative; may be traced.
    """
    margin = jnp.asarray(margin_m)
    softness = jnp.asarray(softness_m, margin.dtype)
    is_soft = softness > 0
    scaled = jnp.where(is_soft, margin / jnp.where(is_soft, softness, 1.0), 0.0)
    return jnp.where(is_soft, jax.nn.sigmoid(scaled), (margin >= 0).astype(margin.dtype))
