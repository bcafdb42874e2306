"""How sure fitted weights are: weights that explain the examples as well, and fits of examples drawn anew or fewer."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.optimize import linprog

from jaxurban.studies.fenchel_young import Task, descend, loss, regrets, weights_of

STEPS = 100  # of each refit, which starts at the fit of all examples
NUM_SUBSETS = 8  # of each size
FAR = 1e6  # times an example's cost: beyond are rows that only fill up the arrays
UNBOUNDED = 3  # status of scipy.optimize.linprog
NO_TRUST = 1e-12  # so that a sum of trusts is never 0


def refit(
    log_weights: np.ndarray, task: Task, num_bootstrap: int, rng: np.random.Generator
) -> tuple[np.ndarray, pd.DataFrame]:
    """Return ``[B, K]`` log weights fitted to examples drawn anew with replacement, and what fewer examples give.

    All over the routes that are known: no search is made. The table has a row for each number of examples 2, 4, 8 ...
    below all of them: ``held_out_regret``, the mean regret of the examples that the fit did not see (trusted ones; the
    mean over 8 random subsets), and ``worst_held_out_regret``, the largest of the 8. It is empty without bootstrap.

    Args:
      log_weights: ``[K]`` of the fit of all examples.
      task: its routes, noise and trust.
      num_bootstrap: B.
      rng: what is drawn.
    """
    num = len(task.demo)
    if num_bootstrap == 0 or num < 2:
        return np.empty((0, len(log_weights))), pd.DataFrame()
    counts = rng.multinomial(num, np.full(num, 1 / num), size=num_bootstrap)
    sizes = [2**k for k in range(1, 31) if 2**k < num]
    masks = np.array([rng.permutation(num) < size for size in sizes for _ in range(NUM_SUBSETS)]).reshape(-1, num)
    trust = np.asarray(task.trust)

    def fit(trust: jax.Array) -> jax.Array:
        return descend(jnp.asarray(log_weights), task._replace(trust=trust), loss, STEPS)[0]

    fits = np.asarray(jax.lax.map(fit, jnp.asarray(np.concatenate([counts, masks]) * trust + NO_TRUST)))
    held_out = []
    for mask, fitted in zip(masks, fits[num_bootstrap:], strict=True):
        left = ~mask * trust + NO_TRUST
        held_out.append(np.sum(left * np.asarray(regrets(weights_of(jnp.asarray(fitted)), task))) / left.sum())
    by_size = np.array(held_out).reshape(-1, NUM_SUBSETS)
    table = pd.DataFrame(
        {
            "num_examples": sizes,
            "held_out_regret": by_size.mean(axis=1),
            "worst_held_out_regret": by_size.max(axis=1, initial=0.0),
        }
    )
    return fits[:num_bootstrap], table


def as_good(weights: np.ndarray, task: Task, scale: np.ndarray, tolerance: float) -> np.ndarray:
    """Return ``[2, F]`` the least and the largest value of each weight among all W that explain the examples as well.

    That is, whose mean regret over the known routes, weighted by trust, is at most that of the fit plus a tolerance:
    a polytope, whose extent along each weight takes two linear programs (costs in the regrets' denominators are
    taken at the fit). Where the examples are exactly cheapest under a hidden W, it holds that W, however many
    examples there are; inf where a weight may grow without end.

    Args:
      weights: ``[F]`` of the fit, of features in the task's units.
      task: its routes and trust.
      scale: ``[F]`` a with a . W = 1 for the W that are compared.
      tolerance: of mean regret.
    """
    demo, routes, trust = (np.asarray(part) for part in (task.demo, task.routes, task.trust))
    num_queries, num_weights = demo.shape
    weights = weights / (scale @ weights)
    cost = demo @ weights
    share = trust / trust.sum() / cost
    query, route = np.nonzero(routes @ weights <= FAR * cost[:, None])
    slack = np.zeros((len(query), num_queries))
    slack[np.arange(len(query)), query] = -cost[query]  # slacks are counted in costs, so that all are near 1
    regret = float(np.sum(share * (cost - np.min(routes @ weights, axis=1))))
    centre = demo.mean(axis=0) / (demo.mean(axis=0) @ weights)
    bound = np.concatenate([-(regret + tolerance) * centre, share * cost])
    above = np.vstack([np.hstack([demo[query] - routes[query, route], slack]), bound])
    equal = np.append(scale, np.zeros(num_queries))[None, :]
    ends = np.tile(weights, (2, 1))
    for k in range(num_weights):
        for row, sign in enumerate((1.0, -1.0)):
            aim = np.zeros(num_weights + num_queries)
            aim[k] = sign
            found = linprog(aim, A_ub=above, b_ub=np.zeros(len(above)), A_eq=equal, b_eq=[1.0], bounds=(0, None))
            if found.x is not None:
                ends[row, k] = found.x[k]
            elif found.status == UNBOUNDED:
                ends[row, k] = np.inf
    return ends
