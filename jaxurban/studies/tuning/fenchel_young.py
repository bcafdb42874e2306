"""What fits of weights bring down over the routes of a pool, the perturbed Fenchel-Young loss and regrets, and how."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from jaxurban.programs import kept_jit

FIRST_RATE, LAST_RATE = 0.05, 0.005  # of Adam, in log weight a step
LEAST_REGRET = 0.01  # demonstrations much nearer than this to the cheapest are trusted; less distrusted good ones


class FitTask(NamedTuple):
    """What a fit looks at. ``Q`` queries, ``R`` routes a query, ``M`` noises a query, ``K`` weights.

    Attributes:
      demo: ``[Q, K]`` features of the demonstrations, in units in which their means are 1.
      routes: ``[Q, R, K]`` features of all known routes, in the same units.
      log_noise: ``[Q, M, K]`` Z of the noise exp(Z); the mean of exp(Z) over M is 1.
      trust: ``[Q]`` weight of each demonstration in the loss.
    """

    demo: Float[Array, "Q K"]
    routes: Float[Array, "Q R K"]
    log_noise: Float[Array, "Q M K"]
    trust: Float[Array, " Q"]


def draw_log_noise(
    rng: np.random.Generator, shape: tuple[int, int, int], sigma: float
) -> np.ndarray:
    """Return ``[Q, M, K]`` normal Z in antithetic pairs, shifted so that exp(Z) has the mean 1 over M exactly.

    The loss is then never negative, and its minimum is not moved by the luck of the draw.

    Args:
      rng: draws them.
      shape: Q, M and K; M is even.
      sigma: standard deviation of Z.
    """
    num_queries, num_noise, num_weights = shape
    half = rng.normal(size=(num_queries, num_noise // 2, num_weights)) * sigma
    drawn = np.concatenate([half, -half], axis=1)
    return drawn - np.log(np.exp(drawn).mean(axis=1, keepdims=True))


def weights_of(log_weights: Float[Array, " K"]) -> Float[Array, " K"]:
    """Return positive weights that sum to 1."""
    return jax.nn.softmax(log_weights)


def fenchel_young_loss(log_weights: Float[Array, " K"], task: FitTask) -> Float[Array, ""]:
    """Return the mean of (W . phi_demo - E[min over routes of (W exp(Z)) . phi]) / sum(phi_demo), weighted by trust.

    Its gradient with respect to W is phi_demo - E[exp(Z) phi*], phi* the features of the route that is
    cheapest under W exp(Z) (Berthet et al. 2020, Dalle et al. 2022: multiplicative noise keeps costs positive).
    It is convex in W and at least 0; 0 only if the demonstration is cheapest under every perturbed W.

    Args:
      log_weights: any numbers; `weights_of` makes weights W of them.
      task: demonstrations, routes, noise Z and trust.
    """
    # [Q, M] the cost of the cheapest route of each query under each noise, and [Q] the losses.
    weights = weights_of(log_weights)
    noisy = weights * jnp.exp(task.log_noise)
    cheapest = jnp.min(jnp.einsum("qmk,qrk->qmr", noisy, task.routes), axis=-1)
    losses = (task.demo @ weights - cheapest.mean(axis=-1)) / task.demo.sum(axis=-1)
    return jnp.sum(task.trust * losses) / jnp.sum(task.trust)


def regrets(weights: Float[Array, " K"], task: FitTask) -> Float[Array, " Q"]:
    """Return by which share each demonstration is costlier than the cheapest known route."""
    return (task.demo @ weights) / jnp.min(task.routes @ weights, axis=-1) - 1.0


def mean_regret(log_weights: Float[Array, " K"], task: FitTask) -> Float[Array, ""]:
    """Return the mean of `regrets`, weighted by trust; its gradient is a subgradient where routes tie."""
    return jnp.sum(task.trust * regrets(weights_of(log_weights), task)) / jnp.sum(task.trust)


def usual_regret(regret: np.ndarray) -> float:
    """Return the regret that is nothing out of the ordinary among regrets ``[Q]``."""
    return max(3 * float(np.median(regret)), LEAST_REGRET)


def trust_of(regret: np.ndarray, usual: float) -> np.ndarray:
    """Return ``[Q]`` in (0, 1] how far demonstrations are trusted: little where a regret is far above the usual."""
    return 1 / (1 + (np.maximum(regret, 0) / usual) ** 2) ** 2


def adam(
    objective: Callable[[Array, Array], Array],
    start: Float[Array, " K"],
    rates: optax.Schedule,
    numbers: Float[Array, " N"],
    normalised: Callable[[Array], Array] = lambda place: place,
) -> Float[Array, " K"]:
    """Return the place where ``N`` steps of Adam end.

    Args:
      objective: a function of a place ``[K]`` and of the step's number in ``numbers``, to be minimised.
      start: the first place.
      rates: of learning, by step.
      numbers: what the objective takes at each step, such as its noise.
      normalised: brings a place back to its standard form after each step; left out, places stay as they are.
    """
    optimiser = optax.adam(rates)

    def step(carry: Any, number: Any) -> Any:
        """Return the place and Adam's state after one step, as `jax.lax.scan` takes them, and no output."""
        place, state = carry
        updates, state = optimiser.update(jax.grad(objective)(place, number), state)
        return (normalised(optax.apply_updates(place, updates)), state), None

    (ended, _), _ = jax.lax.scan(step, (start, optimiser.init(start)), numbers)
    return ended


@partial(kept_jit, static_argnames=("objective", "num_steps"))
def descend(
    log_weights: Float[Array, " K"], task: FitTask, *, objective: Callable, num_steps: int
) -> tuple[Float[Array, " K"], Float[Array, ""]]:
    """Return log weights after a descent by Adam, and the value of the objective there.

    Args:
      log_weights: where the descent begins.
      task: what the objective looks at.
      objective: a function of log weights and task, to be minimised.
      num_steps: of Adam.
    """
    rates = optax.cosine_decay_schedule(FIRST_RATE, num_steps, LAST_RATE / FIRST_RATE)
    ended = adam(lambda place, _: objective(place, task), log_weights, rates, jnp.arange(num_steps))
    return ended, objective(ended, task)
