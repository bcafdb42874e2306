"""Targets: the weights under which routes are as wished, and which wishes conflict."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jaxtyping import Array

from jaxurban.cost import METRICS, Weights
from jaxurban.errors import InputError
from jaxurban.studies.identify import feature_units
from jaxurban.studies.journal import Journal, fingerprint
from jaxurban.studies.perturbed import draw_pairs, known_route_sums
from jaxurban.studies.pool import RoutePool
from jaxurban.studies.queries import Query, check_alike, weights_from
from jaxurban.studies.wishes import Wish, outcome_values

FIRST_RATE, LAST_RATE = 0.2, 0.02  # of Adam, in log weight a step
FIRST_NOISE, LAST_NOISE = 0.7, 0.05  # of the perturbed planner, from the first to the last step
NUM_NOISE, NUM_STEPS = 128, 100
NUM_EXPLORED, CORNER = 16, 30.0  # weights planned under at first; how much more a corner cares for one thing
NUM_CANDIDATES, NUM_STARTS = 1000, 6  # weights looked up in known routes, and descended from, a round
FAR_SPREAD, NEAR_SPREAD = 3.0, 0.1  # of the candidates' log weights about the best
NUM_TRIED, NUM_PROBES = 3, 8  # weights planned for, and searches around the best, a round
PROBE_NOISE = (0.05, 0.8)  # of those searches' log weights, from the nearest to the farthest
PATIENCE = 3  # rounds that better nothing
MET = 0.02  # a wish is met if it is missed by no more than this share


@dataclass(frozen=True, eq=False)
class TargetFit:
    """Weights fitted to wishes.

    Attributes:
      names: ``"distance"`` and the metrics.
      weights: they sum to 1.
      outcomes: a row a wish: wished, shortest (what the shortest routes give), reached, missed_by (share of the
        bound), is_met; by planned routes, without noise.
      alone: a row a wish: the best that was reached when it was wished for alone.
      conflicts: pairs of wishes, each met alone or nearly so, that were not met together.
      is_met: all wishes are met within 2 %.
      is_in_budget: the search ended by itself; a larger budget would find no more.
      curve: a row a round: the least loss so far, its outcomes, and the searches made.
      num_plans, elapsed_s: searches and wall time.
    """

    names: tuple[str, ...]
    weights: Weights
    outcomes: pd.DataFrame
    alone: pd.DataFrame
    conflicts: tuple[tuple[str, str], ...]
    is_met: bool
    is_in_budget: bool
    curve: pd.DataFrame
    num_plans: int
    elapsed_s: float

    @property
    def sentence(self) -> str:
        """What came of it."""
        if self.is_met:
            return "All wishes are met."
        missed = ", ".join(
            f"{wish} (reached {row.reached:.4g})" for wish, row in self.outcomes.iterrows() if not row.is_met
        )
        said = f"Not all wishes were met; the best trade-off found misses {missed}."
        if self.conflicts:
            said += (
                " These conflict, as far as the search could find: "
                + "; ".join(f"{one} with {other}" for one, other in self.conflicts)
                + "."
            )
        elif self.alone["is_met"].all():
            said += " Each two of them can be met together, but not all."
        for wish, row in self.alone.iterrows():
            if not row.is_met:
                said += f" Even alone, {wish} was not reached: at best {row.reached:.4g}."
        if not self.is_in_budget:
            said += " The budget ended the search: a larger one may find better."
        return said


def fit_targets(
    queries: Sequence[Query],
    wishes: Sequence[Wish],
    *,
    start: Weights | None = None,
    max_rounds: int = 20,
    seed: int = 0,
    budget_s: float = np.inf,
    workers: int | None = None,
    backend: Literal["numba", "jax"] = "numba",
    state_file: str | Path | None = None,
    on_round: Callable[[pd.DataFrame], None] | None = None,
) -> TargetFit:
    """Return weights under which planned routes are as wished, or the best trade-off and which wishes conflict.

    The sum of squared misses (each as a share of its bound) is brought down by gradient in log weights, through
    the perturbed planner over the routes found so far (`perturbed.known_route_sums`), with noise that shrinks, from
    the best of many random weights. Routes under the best weights are then planned without noise, and more
    around them, until three rounds better nothing; the best weights by planned routes are returned. If they miss,
    each wish is tried alone, and then each pair of those that can be met. Not met is not proven unreachable: it is
    the best found.

    Args:
      queries: from several maps if liked.
      wishes: bounds on outcomes.
      start: where to begin; equal shares of the shortest routes' cost if left out.
      max_rounds: of searches, for each set of wishes that is tried.
      seed: of the noise.
      budget_s: seconds for everything; what was found by then is returned.
      workers: threads of search; a thread a core if left out.
      backend: of A*: see `RoutePool`.
      state_file: searches are kept in it; a fit of the same queries, wishes and settings goes on from it, to the
        same weights, bit for bit, as if it had not stopped.
      on_round: is told the curve after every round, of whichever wishes are tried.

    Raises:
      InputError: no queries or wishes, a wish for a metric that the maps lack, or a wrong setting.
    """
    begin_s = time.perf_counter()
    names = check_alike(queries)
    if not wishes:
        raise InputError("there are no wishes: give at least one, such as mean_gps>=0.8")
    for wish in wishes:
        metric = {"people": "population"}.get(wish.outcome, wish.outcome.removeprefix("mean_"))
        if metric in METRICS and metric not in names:
            raise InputError(f"wish {str(wish)!r}: {metric} is not among the metrics, {', '.join(names[1:])}")
    if not (max_rounds >= 1 and budget_s > 0 and seed >= 0):
        raise InputError(
            f"max_rounds must be >= 1, budget_s > 0 and seed >= 0, got {max_rounds}, {budget_s} and {seed}"
        )
    settings = {
        "fit": "targets",
        "wishes": [str(wish) for wish in wishes],
        "seed": seed,
        "max_rounds": max_rounds,
        "start": None if start is None else [float(getattr(start, name)) for name in names],
        "of": fingerprint(queries),
    }
    journal = None if state_file is None else Journal(state_file, settings)
    pool = RoutePool(queries, workers=workers, journal=journal, backend=backend)
    only_distance = np.eye(len(names))[0]
    shortest = pool.cheapest(np.broadcast_to(only_distance, (len(queries), 1, len(names))))[:, :, 0]
    shortest_sums = np.concatenate(shortest, axis=-1)
    if start is None:
        first = 1 / feature_units(queries, shortest[0])
    else:
        first = np.maximum([float(getattr(start, name)) for name in names], 1e-6)
    log_first = np.log(first / first.sum())
    search = _Search(
        pool, names, tuple(wishes), shortest_sums, log_first, max_rounds, seed, begin_s + budget_s, on_round
    )
    search.explore()
    with jax.enable_x64(True):
        best = search.run(wishes)
        is_met = bool(np.all(best.missed <= MET))
        single = {wish: best if is_met or len(wishes) == 1 else search.run([wish]) for wish in wishes}
        conflicts: list[tuple[str, str]] = []
        if not is_met:
            reachable = [wish for wish in wishes if single[wish].missed_by(wish) <= MET]
            for pair in itertools.combinations(reachable, 2):
                both = best if len(wishes) == 2 else search.run(pair)
                if max(both.missed_by(wish) for wish in pair) > MET:
                    conflicts.append((str(pair[0]), str(pair[1])))
        outcomes = [wish.outcome for wish in wishes]
        at_shortest = np.asarray(outcome_values(shortest_sums, shortest_sums, names, outcomes))
    return TargetFit(
        names=names,
        weights=weights_from(names, np.exp(best.log_weights) / np.exp(best.log_weights).sum()),
        outcomes=_outcome_table(wishes, dict.fromkeys(wishes, best), at_shortest),
        alone=_outcome_table(wishes, single, at_shortest),
        conflicts=tuple(conflicts),
        is_met=is_met,
        curve=pd.DataFrame(best.rows),
        is_in_budget=time.perf_counter() - begin_s <= budget_s,
        num_plans=pool.num_plans,
        elapsed_s=time.perf_counter() - begin_s,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """The best weights of one search for some wishes."""

    wishes: tuple[Wish, ...]
    log_weights: np.ndarray
    reached: np.ndarray
    missed: np.ndarray
    rows: list[dict]

    def missed_by(self, wish: Wish) -> float:
        return float(self.missed[self.wishes.index(wish)])


@dataclass(frozen=True, eq=False)
class _Search:
    """What searches for different wishes share: the routes that they find, and compiled code."""

    pool: RoutePool
    names: tuple[str, ...]
    wishes: tuple[Wish, ...]
    shortest: np.ndarray
    log_start: np.ndarray
    max_rounds: int
    seed: int
    end_s: float
    on_round: Callable[[pd.DataFrame], None] | None

    def run(self, wishes: Sequence[Wish]) -> _Found:
        """Return the best weights for some of the wishes; the others count as met."""
        bounds = _Bounds.of(self.wishes, wishes)
        outcomes = tuple(wish.outcome for wish in self.wishes)
        rng = np.random.default_rng(self.seed)
        drawn = jnp.asarray(draw_pairs(self.seed, NUM_NOISE, len(self.names)))
        best: _Found | None = None
        rows: list[dict] = []
        for number in range(self.max_rounds):
            features, sums = self.pool.features, np.concatenate([self.pool.features, self.pool.integrals], axis=-1)
            setting = (jnp.asarray(features), jnp.asarray(sums), drawn)
            about = self.log_start if best is None else best.log_weights
            spread = FAR_SPREAD * np.geomspace(1.0, NEAR_SPREAD / FAR_SPREAD, NUM_CANDIDATES)[:, None]
            anywhere = about + spread * rng.normal(size=(NUM_CANDIDATES, len(about)))
            candidates = np.array([about, self.log_start, *self._corners(), *anywhere])
            misses = _known_misses(jnp.asarray(candidates), bounds, setting, self.shortest, self.names, outcomes)
            starts = candidates[np.argsort(np.asarray(misses), kind="stable")[:NUM_STARTS]]
            ended = np.asarray(_descend(jnp.asarray(starts), bounds, setting, self.shortest, self.names, outcomes))
            tried = np.concatenate([ended, starts])
            misses = _known_misses(jnp.asarray(tried), bounds, setting, self.shortest, self.names, outcomes)
            for log_weights in tried[np.argsort(np.asarray(misses), kind="stable")[:NUM_TRIED]]:
                reached = self._planned(log_weights, outcomes)
                missed = np.asarray(bounds.missed(jnp.asarray(reached)))
                if best is None or np.sum(missed**2) < np.sum(best.missed**2):
                    best = _Found(self.wishes, log_weights, reached, missed, rows)
            assert best is not None
            rows.append(
                {"round": number + 1, "loss": float(np.sum(best.missed**2)), "num_plans": self.pool.num_plans}
                | dict(zip(map(str, self.wishes), best.reached.tolist(), strict=True))
            )
            if self.on_round:
                self.on_round(pd.DataFrame(rows))
            is_stuck = number >= PATIENCE and rows[-1]["loss"] >= rows[-1 - PATIENCE]["loss"]
            if not np.any(best.missed) or is_stuck or time.perf_counter() > self.end_s:
                break
            wide = np.geomspace(*PROBE_NOISE, NUM_PROBES)[:, None]
            near = best.log_weights + wide * rng.normal(size=(NUM_PROBES, len(self.names)))
            self.pool.cheapest(np.broadcast_to(np.exp(near), (len(self.shortest), *near.shape)))
        assert best is not None
        return best

    def explore(self) -> None:
        """Fill the pool with routes under weights of all kinds."""
        rng = np.random.default_rng(self.seed)
        anywhere = rng.dirichlet(np.ones(len(self.names)), size=NUM_EXPLORED) * np.exp(self.log_start)
        weights = np.concatenate([np.exp(self.log_start)[None], np.exp(self._corners()), anywhere])
        self.pool.cheapest(np.broadcast_to(weights, (len(self.shortest), *weights.shape)))

    def _corners(self) -> np.ndarray:
        """Return ``[K, K]`` log weights of which each cares for one thing mostly."""
        return self.log_start + np.log(CORNER) * np.eye(len(self.names))

    def _planned(self, log_weights: np.ndarray, outcomes: Sequence[str]) -> np.ndarray:
        """Return the outcomes of the routes under weights, planned without noise."""
        weights = np.broadcast_to(np.exp(log_weights), (len(self.shortest), 1, len(log_weights)))
        sums = np.concatenate(self.pool.cheapest(weights)[:, :, 0], axis=-1)
        return np.asarray(outcome_values(sums, self.shortest, self.names, outcomes))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Bounds:
    """Wishes as arrays ``[N]``: the bound, +1 (at least), -1 (at most) or 0 (not now), and the size of the bound."""

    bound: Array
    sign: Array
    size: Array

    @classmethod
    def of(cls, wishes: Sequence[Wish], active: Sequence[Wish]) -> "_Bounds":
        bound = jnp.array([wish.value for wish in wishes])
        return cls(
            bound,
            jnp.array([float(wish in active) * (1.0 if wish.sense == ">=" else -1.0) for wish in wishes]),
            jnp.maximum(jnp.abs(bound), 1e-3),
        )

    def missed(self, values: Array) -> Array:
        """Return by which share of its bound each wish is missed."""
        return jnp.maximum(self.sign * (self.bound - values) / self.size, 0.0)


@partial(jax.jit, static_argnames=("names", "outcomes"))
def _descend(starts, bounds: _Bounds, setting, shortest, names, outcomes) -> Array:
    """Return log weights ``[S, K]`` after descents from each start over known routes."""
    features, sums, drawn = setting
    optimiser = optax.adam(optax.exponential_decay(FIRST_RATE, NUM_STEPS, LAST_RATE / FIRST_RATE))

    def squared(log_weights, noise):
        expected = known_route_sums(log_weights, features, sums, drawn, noise)
        return jnp.sum(bounds.missed(outcome_values(expected, shortest, names, outcomes)) ** 2)

    def descend(start):
        def step(carry, noise):
            at, state = carry
            updates, state = optimiser.update(jax.grad(squared)(at, noise), state)
            at = optax.apply_updates(at, updates)
            return (at - jax.scipy.special.logsumexp(at), state), None

        noises = jnp.geomspace(FIRST_NOISE, LAST_NOISE, NUM_STEPS)
        (ended, _), _ = jax.lax.scan(step, (start, optimiser.init(start)), noises)
        return ended

    return jax.lax.map(descend, starts)


@partial(jax.jit, static_argnames=("names", "outcomes"))
def _known_misses(candidates, bounds: _Bounds, setting, shortest, names, outcomes) -> Array:
    """Return ``[S]`` the squared misses of the cheapest known routes under log weights ``[S, K]``."""
    features, sums, _ = setting

    def squared(log_weights):
        cheapest = jnp.argmin(features @ jnp.exp(log_weights), axis=-1)
        chosen = jnp.take_along_axis(sums, cheapest[:, None, None], axis=1)[:, 0]
        return jnp.sum(bounds.missed(outcome_values(chosen, shortest, names, outcomes)) ** 2)

    return jax.lax.map(squared, candidates, batch_size=64)


def _outcome_table(wishes: Sequence[Wish], found: dict[Wish, _Found], at_shortest: np.ndarray) -> pd.DataFrame:
    rows = [(found[wish].reached[found[wish].wishes.index(wish)], found[wish].missed_by(wish)) for wish in wishes]
    return pd.DataFrame(
        {
            "wished": [wish.value for wish in wishes],
            "shortest": at_shortest,
            "reached": [reached for reached, _ in rows],
            "missed_by": [missed for _, missed in rows],
            "is_met": [missed <= MET for _, missed in rows],
        },
        index=pd.Index([str(wish) for wish in wishes], name="wish"),
    )
