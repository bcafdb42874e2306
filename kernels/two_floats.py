"""What rounding leaves of a sum or a product, as a second float, so that a difference of near numbers keeps its digits.

Sources: Knuth 1969, The Art of Computer Programming 2, 4.2.2 (sum); Dekker 1971, A floating-point technique for
extending the available precision (product). Exact but for underflow; what is left has no derivative of its own.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float


def sum_and_rest(a: Float[Array, "..."], b: Float[Array, "..."]) -> tuple[Array, Array]:
    """Return the float nearest to a + b, and how much more the sum is."""
    total = a + b
    of_b = total - a
    return total, lax.stop_gradient((a - (total - of_b)) + (b - of_b))


def product_and_rest(a: Float[Array, "..."], b: Float[Array, "..."]) -> tuple[Array, Array]:
    """Return the float nearest to a b, and how much more the product is."""
    product = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    return product, lax.stop_gradient(rest)


def _halves(value: Array) -> tuple[Array, Array]:
    """Return two numbers of half the digits that add up to one."""
    digits = jnp.finfo(value.dtype).nmant + 1
    scaled = value * (2.0 ** -(-digits // 2) + 1)
    high = scaled - (scaled - value)
    return high, value - high
