"""Gradient descent, compiled whole."""

from collections.abc import Callable

import jax
import optax
from jaxtyping import Array, Float


def adam(
    objective: Callable[[Array, Array], Array],
    start: Float[Array, " K"],
    rates: optax.Schedule,
    each: Float[Array, " N"],
    tidy: Callable[[Array], Array] = lambda at: at,
) -> Float[Array, " K"]:
    """Return where ``N`` steps of Adam end.

    Args:
      objective: of a place ``[K]`` and of ``each`` step's own number.
      start: ``[K]``.
      rates: of learning, by step.
      each: ``[N]`` what the objective takes at each step.
      tidy: brings a place back to its standard form after each step.
    """
    optimiser = optax.adam(rates)

    def step(carry, now):
        at, state = carry
        updates, state = optimiser.update(jax.grad(objective)(at, now), state)
        return (tidy(optax.apply_updates(at, updates)), state), None

    (ended, _), _ = jax.lax.scan(step, (start, optimiser.init(start)), each)
    return ended
