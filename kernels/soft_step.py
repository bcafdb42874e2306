"""The smooth step that every soft metric is made of, and how much a satellite counts near a roof's edge."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float


def soft_step(
    margin_m: Float[Array, "*n"], softness_m: Float[Array, ""] | float
) -> Float[Array, "*n"]:
    """Return 1 where a margin is well above 0 and 0 where it is well below, sigmoid(margin / softness).

    At softness 0 the exact result, ``margin_m >= 0``, whose gradient is zero. Elsewhere the gradient is finite, also in
    the softness.

    Args:
      margin_m: by how much a condition holds; any shape.
      softness_m: of the same unit, not negative; may be traced.
    """
    # Where softness is 0, the inner `where` keeps a division by it out of the gradient.
    margin = jnp.asarray(margin_m)
    softness = jnp.asarray(softness_m, margin.dtype)
    is_soft = softness > 0
    scaled = jnp.where(is_soft, margin / jnp.where(is_soft, softness, 1.0), 0.0)
    return jnp.where(is_soft, jax.nn.sigmoid(scaled), (margin >= 0).astype(margin.dtype))


def satellite_weights(
    height_m: ArrayLike,
    shadows_m: Float[Array, "S y x"],
    softness_m: ArrayLike,
    chance: Callable[[Array], Array] | None = None,
) -> Float[Array, "S y x"]:
    """Return the weight of each satellite in the normal matrix, 0 to 1, ``[S, y, x]``.

    The weight is ``p^2`` with ``p = 1 / (1 + exp(-(height - shadow) / softness))``: p is the probability that the
    satellite is seen if roofs have a logistic error of this scale; its range error grows as 1 / p. As softness goes
    to 0 this becomes the rule of `jaxurban.kernels.shadows.sweep.shadow_height`, 1 where the shadow is not above the
    receiver; at 0 it is that rule, with all derivatives 0.

    The square makes small weights smaller: a fourth satellite brings GDOP below 20 from a weight of a hundredth on, and
    under p it did so 4 softnesses deep in the shadow. On Lower Manhattan (5 m cells, 20 m up, softness 2 m) the mean
    difference of m to the exact map was 0.019 with p, 0.010 with p^2, 0.013 with p moved 2 softnesses toward the
    light, the best of 0 to 4; the synthetic city and 60 m order them alike.

    With a measured ``chance`` p is that chance, squared too. If satellites are heard independently by these chances, m
    of few satellites is far nearer to its mean over what is heard at p^2 than at p; of many it is near at both.
    Mean differences in Nihonbashi (2 m cells, 2, 20 and 60 m up): of 8 satellites 0.17, 0.17 and 0.08 at p^2 and 0.40,
    0.31 and 0.15 at p; of 33 satellites 0.025, 0.017 and 0.009 and 0.038, 0.015 and 0.007, the largest 0.19 and 0.58.
    At p^3 8 satellites come nearer still, and 33 do not.

    Args:
      height_m: absolute height of the receivers, a number or ``[y, x]``.
      shadows_m: from `jaxurban.kernels.shadows.sweep.shadow_heights`; -inf, where nothing shadows, counts 1 with all
        derivatives 0; with ``chance`` as at a clearance of inf.
      softness_m: >= 0; not looked at with ``chance``.
      chance: p of clearances in metres, in place of the logistic.
    """
    is_open = jnp.isneginf(shadows_m)
    clearance_m = jnp.asarray(height_m, shadows_m.dtype) - jnp.where(is_open, 0, shadows_m)
    if chance is not None:
        return chance(jnp.where(is_open, jnp.inf, clearance_m)) ** 2
    return jnp.where(is_open, 1, soft_step(clearance_m, jnp.asarray(softness_m)) ** 2)
