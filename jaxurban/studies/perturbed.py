"""What planned routes add up on average under perturbed weights: a smooth function of the weights.

The route under one W changes by jumps, so what it adds up is constant but for jumps and its derivative says nothing.
Averaged over W exp(Z), Z normal, it is smooth (Berthet et al. 2020, with the multiplicative noise of Dalle et al.
2022), and its derivative by log W is an average too: E[f(W exp(Z)) Z] / sigma^2 (Stein's identity).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError
from jaxurban.planners.host import call_on_host
from jaxurban.studies.pool import RoutePool

RouteSums = Callable[[Float[Array, " K"]], Float[Array, "Q J"]]


def perturbed_sums(pool: RoutePool, noise: float = 0.1, num_noise: int = 32, seed: int = 0) -> RouteSums:
    """Return a JAX function of weights ``[K]``: the expected features and integrals ``[Q, 2 K]`` of planned routes.

    Values are means over searches under ``num_noise`` perturbed weights, in antithetic pairs that are the same at
    every call. The derivative with respect to the weights (forward mode; reverse mode by its transpose) is the
    Monte Carlo estimate of the derivative of the expectation, with the mean as baseline; it is **not** the
    derivative of the printed value, which has none, and its error falls with the square root of ``num_noise``.
    First derivatives only.

    Args:
      pool: the queries; routes found join it.
      noise: sigma, standard deviation of log weights: wider is smoother, and farther from the route under W.
      num_noise: even.
      seed: of the noise.

    Raises:
      InputError: a wrong setting.
    """
    if not noise > 0 or num_noise < 2 or num_noise % 2:
        raise InputError(f"noise must be positive and num_noise even, got {noise} and {num_noise}")
    num_weights = len(pool.queries[0].names)
    drawn = draw_pairs(seed, num_noise, num_weights)
    out = (len(pool.queries), 2 * num_weights)

    def search(weights) -> tuple[np.ndarray, np.ndarray]:
        """The mean ``[Q, 2 K]`` and its derivative by log weights ``[Q, 2 K, K]``."""
        each = np.asarray(weights, np.float64) * np.exp(noise * drawn)
        found = pool.cheapest(np.broadcast_to(each, (out[0], *each.shape)))
        sums = np.concatenate([found[0], found[1]], axis=-1)  # [Q, M, 2 K]
        mean = sums.mean(axis=1)
        slope = np.einsum("qmj,mk->qjk", sums - mean[:, None], drawn) / (noise * num_noise)
        return mean.astype(weights.dtype), slope.astype(weights.dtype)

    def call(weights):
        shapes = (
            jax.ShapeDtypeStruct(out, weights.dtype),
            jax.ShapeDtypeStruct((*out, num_weights), weights.dtype),
        )
        return call_on_host(search, shapes, weights)

    @jax.custom_jvp
    def sums(weights):
        return call(weights)[0]

    @sums.defjvp
    def sums_jvp(primals, tangents):
        (weights,), (change,) = primals, tangents
        mean, slope = call(weights)
        return mean, slope @ (change / jnp.maximum(weights, jnp.finfo(weights.dtype).tiny))

    return sums


def draw_pairs(seed: int, num_noise: int, num_weights: int) -> np.ndarray:
    """Return ``[M, K]`` standard normal numbers in antithetic pairs."""
    half = np.random.default_rng(seed).normal(size=(num_noise // 2, num_weights))
    return np.concatenate([half, -half])


@jax.custom_jvp
def known_route_sums(
    log_weights: Float[Array, " K"],
    features: Float[Array, "Q R K"],
    sums: Float[Array, "Q R J"],
    drawn: Float[Array, "M K"],
    noise: Float[Array, ""],
) -> Float[Array, "Q J"]:
    """Return the expected sums of the cheapest of known routes under perturbed weights.

    As `perturbed_sums`, with a pool in place of searches: a few multiplications a noise, so that thousands are
    affordable. Differentiable in ``log_weights`` only, first derivatives.
    """
    return _known_mean_and_slope(log_weights, features, sums, drawn, noise)[0]


@known_route_sums.defjvp
def _known_route_sums_jvp(primals, tangents):
    mean, slope = _known_mean_and_slope(*primals)
    return mean, slope @ tangents[0]


def _known_mean_and_slope(log_weights, features, sums, drawn, noise):
    perturbed = jnp.exp(log_weights + noise * drawn)
    cheapest = jnp.argmin(jnp.einsum("mk,qrk->qmr", perturbed, features), axis=-1)
    chosen = jnp.take_along_axis(sums, cheapest[..., None], axis=1)  # [Q, M, J]
    mean = chosen.mean(axis=1)
    slope = jnp.einsum("qmj,mk->qjk", chosen - mean[:, None], drawn) / (noise * len(drawn))
    return mean, slope
