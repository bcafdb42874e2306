"""Imitation: the weights under which example routes are cheapest."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from jaxurban.cost import Weights
from jaxurban.errors import InputError
from jaxurban.studies.examples import Example
from jaxurban.studies.fenchel_young import (
    Task,
    descend,
    draw_log_noise,
    loss,
    mean_regret,
    regrets,
    weights_of,
)
from jaxurban.studies.fitstate import load_state, save_state
from jaxurban.studies.identify import constant_layers, indistinct_weights
from jaxurban.studies.pool import RoutePool
from jaxurban.studies.queries import check_alike

FIRST_NOISE, LAST_NOISE = 0.3, 0.03  # standard deviation of log weights: first far, in the end close to the minimum
NUM_NOISE, NUM_PROBES = 32, 2  # noises a query in the loss; searches a query and round under perturbed weights
STEPS, BOOTSTRAP_STEPS, BOOTSTRAP_NOISE = 200, 100, 8
LEAST_REGRET = 1e-4  # examples within this of the cheapest are never distrusted
SETTLED = 1e-5  # a round that betters no known route by more has nothing to add
OPTIMAL_REGRET = 0.005  # on average beyond this, the examples are not optimal under any weights


@dataclass(frozen=True, eq=False)
class WeightFit:
    """Weights fitted to example routes. ``K`` weights, ``Q`` examples.

    Attributes:
      names: ``"distance"`` and the metrics.
      weights: scaled as asked; 0 for a metric whose weight cannot be identified.
      shares: ``[K]`` part of the examples' cost that each weight makes up; they sum to 1.
      spread: ``[K]`` w_j x std(phi_j) over the examples, scaled to length 1: what fits are compared by.
      interval: ``[2, K]`` 5th and 95th percentile of the weights over bootstrap fits; NaN without.
      regret: ``[Q]`` by which share each example is costlier than the cheapest route under the weights, by search.
      trust: ``[Q]`` in [0, 1] weight that each example had in the end.
      best_mean_regret: the least mean regret that any weights were found to reach.
      curve: a row a round: noise, loss, mean_regret, new_routes, num_plans, elapsed_s and each weight.
      warnings: sentences a reader must know.
      num_plans: searches made.
      elapsed_s: wall time.
      is_settled: the last round bettered no known route by more than 1e-5.
    """

    names: tuple[str, ...]
    weights: Weights
    shares: np.ndarray
    spread: np.ndarray
    interval: np.ndarray
    regret: np.ndarray
    trust: np.ndarray
    best_mean_regret: float
    curve: pd.DataFrame
    warnings: tuple[str, ...]
    num_plans: int
    elapsed_s: float
    is_settled: bool

    @property
    def vector(self) -> np.ndarray:
        """``[K]`` the weights in the order of ``names``."""
        return np.array([float(getattr(self.weights, name)) for name in self.names])

    def table(self) -> pd.DataFrame:
        """Return a row a weight: weight, its 5 to 95 % interval, share of cost, spread."""
        return pd.DataFrame(
            {
                "weight": self.vector,
                "low": self.interval[0],
                "high": self.interval[1],
                "share_of_cost": self.shares,
                "spread": self.spread,
            },
            index=pd.Index(self.names, name="name"),
        )


def fit_weights(
    examples: Sequence[Example],
    *,
    scale: str = "simplex",
    max_rounds: int = 12,
    bootstrap: int = 200,
    seed: int = 0,
    budget_s: float = np.inf,
    workers: int | None = None,
    state_file: str | Path | None = None,
    on_round: Callable[[pd.DataFrame], None] | None = None,
) -> WeightFit:
    """Return the weights under which example routes are as close to cheapest as any weights make them.

    A perturbed Fenchel-Young loss (see `fenchel_young.loss`) is brought down by gradient in log weights, over the
    routes found so far; rounds of searches under the current and under perturbed weights find more, until a
    round betters none. The noise shrinks from round to round: wide noise leads from anywhere, narrow noise ends
    in the middle of the weights that explain the examples. Examples that stay far costlier than most are
    trusted less (a redescending weight on their regret), so that some detours do not bend the fit.

    Only the direction of W can be found; its length is set by ``scale``. A layer that is constant over the maps
    cannot be told from distance (or from nothing), so its weight is left at 0 and a warning says so.

    Args:
      examples: from `example_from_path`, `example_from_line` or `read_examples`; of one or several maps.
      scale: ``"simplex"``: weights sum to 1; ``"distance"``: the distance weight is 1.
      max_rounds: of searches; fewer where a round at the least noise betters nothing.
      bootstrap: fits on examples drawn anew, for intervals; 0 for none.
      seed: of all noise.
      budget_s: seconds; the fit ends after the round in which they run out.
      workers: threads of search; a thread a core if left out.
      state_file: kept after every round; a fit of the same examples and settings goes on from it.
      on_round: is told the learning curve after every round.

    Raises:
      InputError: no examples, maps that do not go together, or a wrong setting.
    """
    if scale not in ("simplex", "distance"):
        raise InputError(f"scale must be 'simplex' or 'distance', got {scale!r}")
    if not (max_rounds >= 1 and bootstrap >= 0 and budget_s > 0):
        raise InputError(
            f"max_rounds must be >= 1, bootstrap >= 0 and budget_s > 0, got {max_rounds}, {bootstrap} and {budget_s}"
        )
    begin_s = time.perf_counter()
    queries = [example.query for example in examples]
    names = check_alike(queries)
    constant = constant_layers(queries)
    fitted = np.array([name not in constant for name in names])
    demo = np.array([example.route.features for example in examples])
    unit = np.where(fitted, np.maximum(demo.mean(axis=0), 1e-12), 1.0)
    pool = RoutePool(queries, [example.route for example in examples], workers)
    settings = {"names": list(names), "seed": seed, "max_rounds": max_rounds}
    state = load_state(state_file, settings, pool)
    log_weights = np.zeros(fitted.sum()) if state is None else state.log_weights
    rows: list[dict[str, Any]] = [] if state is None else state.rows
    before_s = rows[-1]["elapsed_s"] if rows else 0.0
    trust = np.ones(len(demo))

    def task(num_noise: int, noise: float, rng: np.random.Generator) -> Task:
        shape = (len(demo), num_noise, int(fitted.sum()))
        return Task(
            jnp.asarray((demo / unit)[:, fitted]),
            jnp.asarray((pool.features / unit)[:, :, fitted]),
            jnp.asarray(draw_log_noise(rng, shape, noise)),
            jnp.asarray(trust),
        )

    def full(log_weights: np.ndarray) -> np.ndarray:
        """The weights of features in their own units."""
        weights = np.zeros(len(names))
        weights[fitted] = np.asarray(weights_of(jnp.asarray(log_weights)))
        return weights / unit

    with jax.enable_x64(True):
        is_settled = False
        while len(rows) < max_rounds:
            number = len(rows)
            rng = np.random.default_rng([seed, number])
            noise = FIRST_NOISE * (LAST_NOISE / FIRST_NOISE) ** min(number / max(1, max_rounds - 3), 1.0)
            probes = np.exp(rng.normal(size=(len(demo), 1 + NUM_PROBES, len(names))) * noise)
            probes[:, 0] = 1.0
            known = pool.num_routes
            probed = full(log_weights) * probes
            expected = np.min(np.einsum("qmk,qrk->qmr", probed, pool.features), axis=-1)
            searched = np.einsum("qmk,qmk->qm", probed, pool.cheapest(probed)[0])
            worst_gap = float(np.max(expected / searched - 1))
            here = task(NUM_NOISE, noise, rng)
            regret = np.asarray(regrets(weights_of(jnp.asarray(log_weights)), here))
            trust = _trust(regret) if number else trust
            here = here._replace(trust=jnp.asarray(trust))
            ended, reached = descend(jnp.asarray(log_weights), here, loss, STEPS)
            log_weights = np.asarray(ended)
            is_settled = worst_gap <= SETTLED and noise <= LAST_NOISE * 1.001
            rows.append(
                {
                    "round": number + 1,
                    "noise": noise,
                    "loss": float(reached),
                    "mean_regret": float(np.mean(np.asarray(regrets(weights_of(ended), here)))),
                    "new_routes": pool.num_routes - known,
                    "num_plans": pool.num_plans,
                    "elapsed_s": before_s + time.perf_counter() - begin_s,
                }
                | dict(zip(names, (_scaled(full(log_weights), scale)).tolist(), strict=True))
            )
            save_state(state_file, settings, pool, log_weights, rows)
            if on_round:
                on_round(pd.DataFrame(rows))
            if is_settled or time.perf_counter() - begin_s > budget_s:
                break
        final = task(NUM_NOISE, LAST_NOISE, np.random.default_rng([seed, max_rounds]))
        lowest, _ = descend(jnp.asarray(log_weights), final, mean_regret, STEPS)
        regret = _searched_regret(pool, demo, full(log_weights))
        best = min(float(regret.mean()), float(_searched_regret(pool, demo, full(np.asarray(lowest))).mean()))
        resampled = _bootstrap(
            log_weights, task(BOOTSTRAP_NOISE, LAST_NOISE, np.random.default_rng(seed)), bootstrap, seed
        )
        indistinct = indistinct_weights(pool, demo, full(log_weights), names, fitted)
    weights = full(log_weights)
    drawn = np.array([_scaled(full(row), scale) for row in resampled]).reshape(-1, len(names))
    interval = np.percentile(drawn, [5, 95], axis=0) if len(drawn) else np.full((2, len(names)), np.nan)
    cost = weights * demo.mean(axis=0)
    spread = weights * demo.std(axis=0)
    return WeightFit(
        names=names,
        weights=Weights(
            **dict.fromkeys(Weights.__dataclass_fields__, 0.0)
            | dict(zip(names, _scaled(weights, scale).tolist(), strict=True))
        ),
        shares=cost / cost.sum(),
        spread=spread / max(float(np.linalg.norm(spread)), 1e-300),
        interval=interval,
        regret=regret,
        trust=trust,
        best_mean_regret=best,
        curve=pd.DataFrame(rows),
        warnings=tuple(_warnings(examples, constant, indistinct, best, trust, is_settled)),
        num_plans=pool.num_plans,
        elapsed_s=before_s + time.perf_counter() - begin_s,
        is_settled=is_settled,
    )


def _scaled(weights: np.ndarray, scale: str) -> np.ndarray:
    """Return weights of the length that was asked for."""
    return weights / (weights.sum() if scale == "simplex" else weights[0])


def _trust(regret: np.ndarray) -> np.ndarray:
    """Return ``[Q]`` in (0, 1] how far each example is trusted: little where its regret is far above most others'."""
    usual = max(3 * float(np.median(regret)), LEAST_REGRET)
    return 1 / (1 + (np.maximum(regret, 0) / usual) ** 2) ** 2


def _searched_regret(pool: RoutePool, demo: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``[Q]`` the regret of each example under weights, against the cheapest route by search."""
    cheapest = pool.cheapest(np.broadcast_to(weights, (len(demo), 1, len(weights))))[0, :, 0]
    return (demo @ weights) / (cheapest @ weights) - 1


def _bootstrap(log_weights: np.ndarray, task: Task, num: int, seed: int) -> np.ndarray:
    """Return ``[num, K]`` log weights fitted to examples drawn anew with replacement, over the known routes."""
    if num == 0 or len(task.demo) < 2:
        return np.empty((0, len(log_weights)))
    rng = np.random.default_rng([seed, 1])
    counts = rng.multinomial(len(task.demo), np.full(len(task.demo), 1 / len(task.demo)), size=num)

    def fit(trust: jax.Array) -> jax.Array:
        return descend(jnp.asarray(log_weights), task._replace(trust=trust), loss, BOOTSTRAP_STEPS)[0]

    return np.asarray(jax.lax.map(fit, jnp.asarray(counts * np.asarray(task.trust) + 1e-12)))


def _warnings(examples, constant, indistinct, best: float, trust: np.ndarray, is_settled: bool) -> list[str]:
    said = [
        f"The {name} layer is the same everywhere on these maps, so its weight cannot be identified and is left at 0."
        for name in constant
    ]
    said += indistinct
    if best > OPTIMAL_REGRET:
        said.append(
            f"The examples are not optimal under any weights: at best they cost {100 * best:.2f} % more than the "
            "cheapest routes on average."
        )
    if num := int((trust < 0.1).sum()):
        said.append(f"{num} of {len(trust)} examples cost far more than the others' weights explain, and hardly count.")
    if not is_settled:
        said.append("The last round still found better routes: allow more rounds or a larger budget.")
    said += [
        f"Example {example.query.name or number!r}: {example.note}."
        for number, example in enumerate(examples, 1)
        if example.note
    ]
    return said
