"""What planned routes add up on average under perturbed weights: a smooth function of the weights.

The route under one W changes by jumps, so what it adds up is constant but for jumps and its derivative says nothing.
Averaged over W exp(Z), Z normal, it is smooth (Berthet et al. 2020, with the multiplicative noise of Dalle et al.
2022), and its derivative by log W is an average too: E[f(W exp(Z)) Z] / sigma^2 (Stein's identity).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.metrics.weights import AnyArray


def draw_pairs(seed: int, num_noise: int, num_weights: int) -> np.ndarray:
    """Return ``[M, K]`` standard normal numbers in antithetic pairs; ``num_noise`` is even."""
    half = np.random.default_rng(seed).normal(size=(num_noise // 2, num_weights))
    return np.concatenate([half, -half])


def mean_and_slope(sums: AnyArray, drawn: AnyArray, noise: float | AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the mean of what routes under W exp(noise Z) add up, and its derivative by log W. NumPy or JAX.

    The derivative ``[Q, J, K]`` is the Monte Carlo estimate of the derivative of the expectation, with the mean as
    baseline; it is **not** the derivative of the mean ``[Q, J]`` itself, which has none, and its error falls with the
    square root of ``M``.

    Args:
      sums: ``[Q, M, J]`` of the routes under each Z.
      drawn: ``[M, K]`` Z, from `draw_pairs`.
      noise: sigma, standard deviation of log weights: wider is smoother, and farther from the route under W.
    """
    mean = sums.mean(axis=1)
    return mean, (sums - mean[:, None]).swapaxes(1, 2) @ drawn / (noise * len(drawn))


@jax.custom_jvp
def known_route_sums(
    log_weights: Float[Array, " K"],
    routes: Float[Array, "Q R J"],
    drawn: Float[Array, "M K"],
    noise: Float[Array, ""],
) -> Float[Array, "Q J"]:
    """Return the expected sums of the cheapest of known routes under perturbed weights.

    A few multiplications a noise, so that thousands are affordable. Differentiable in ``log_weights`` only, first
    derivatives, by `mean_and_slope`.

    Args:
      log_weights: W.
      routes: what the known routes add up, the features first.
      drawn, noise: as in `mean_and_slope`.
    """
    return _known_mean_and_slope(log_weights, routes, drawn, noise)[0]


@known_route_sums.defjvp
def _known_route_sums_jvp(primals, tangents):
    mean, slope = _known_mean_and_slope(*primals)
    return mean, slope @ tangents[0]


def _known_mean_and_slope(log_weights, routes, drawn, noise):
    perturbed = jnp.exp(log_weights + noise * drawn)
    features = routes[..., : len(log_weights)]
    cheapest = jnp.argmin(jnp.einsum("mk,qrk->qmr", perturbed, features), axis=-1)
    return mean_and_slope(jnp.take_along_axis(routes, cheapest[..., None], axis=1), drawn, noise)
