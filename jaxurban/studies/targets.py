"""Targets: the weights under which routes are as wished, and which wishes conflict."""

import itertools
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jaxtyping import Array, Float

from jaxurban.cost import METRICS, AnyArray, Weights
from jaxurban.errors import InputError, nearest_name
from jaxurban.studies.perturbed import draw_pairs, known_route_sums
from jaxurban.studies.pool import RoutePool
from jaxurban.studies.queries import Query, check_alike

OUTCOMES = ("detour", "length_m", "people", *(f"mean_{name}" for name in METRICS))
FIRST_RATE, LAST_RATE = 0.2, 0.02  # of Adam, in log weight a step
FIRST_NOISE, LAST_NOISE = 0.7, 0.05  # of the perturbed planner, from the first to the last step
NUM_NOISE, NUM_STEPS = 128, 100
NUM_EXPLORED, CORNER = 16, 30.0  # weights planned under at first; how much more a corner cares for one thing
NUM_TRIED, NUM_PROBES, PROBE_NOISE = 3, 4, 0.2  # descents planned for, and searches around the best, a round
MET = 0.02  # a wish is met if it is missed by no more than this share


@dataclass(frozen=True)
class Wish:
    """A bound on an outcome of routes, averaged over a set of queries.

    Attributes:
      outcome: one of `OUTCOMES`. ``detour``: mean of length over the shortest route's, less 1. ``mean_gps`` and
        the like: mean over queries of the mean m along the route. ``people``: sum over queries of the
        integral of m_population along the route, as a share of the shortest routes'. ``length_m``: mean length.
      sense: ``">="`` or ``"<="``.
      value: the bound.
    """

    outcome: str
    sense: str
    value: float

    @classmethod
    def parse(cls, text: str) -> "Wish":
        """Return the wish in ``"mean_gps>=0.8"``.

        Raises:
          InputError: another form, an unknown outcome, or a value that is no number.
        """
        match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(\S+)\s*", text)
        if not match:
            raise InputError(f"wish {text!r} must read like mean_gps>=0.8 or detour<=0.15")
        outcome, sense, number = match.groups()
        if outcome not in OUTCOMES:
            raise InputError(
                f"unknown outcome {outcome!r}{nearest_name(outcome, OUTCOMES)}: choose one of {', '.join(OUTCOMES)}"
            )
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(f"wish {text!r} must end in a finite number")
        return cls(outcome, sense, value)

    def __str__(self) -> str:
        return f"{self.outcome} {self.sense} {self.value:g}"


@dataclass(frozen=True, eq=False)
class TargetFit:
    """Weights fitted to wishes.

    Attributes:
      names: ``"distance"`` and the metrics.
      weights: they sum to 1.
      outcomes: a row a wish: wished, reached, missed_by (share of the bound), is_met; by planned routes,
        without noise.
      alone: a row a wish: the best that was reached when it was wished for alone.
      conflicts: pairs of wishes, each met alone or nearly so, that were not met together.
      is_met: all wishes are met within 2 %.
      curve: a row a round: the least loss so far, its outcomes, and the searches made.
      num_plans, elapsed_s: searches and wall time.
    """

    names: tuple[str, ...]
    weights: Weights
    outcomes: pd.DataFrame
    alone: pd.DataFrame
    conflicts: tuple[tuple[str, str], ...]
    is_met: bool
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
        said = f"Not all wishes can be met; the best trade-off found misses {missed}."
        if self.conflicts:
            said += " These conflict: " + "; ".join(f"{one} with {other}" for one, other in self.conflicts) + "."
        for wish, row in self.alone.iterrows():
            if not row.is_met:
                said += f" Even alone, {wish} was not reached: at best {row.reached:.4g}."
        return said


def fit_targets(
    queries: Sequence[Query],
    wishes: Sequence[Wish],
    *,
    start: Weights | None = None,
    max_rounds: int = 8,
    seed: int = 0,
    budget_s: float = np.inf,
    workers: int | None = None,
) -> TargetFit:
    """Return weights under which planned routes are as wished, or the best trade-off and which wishes conflict.

    The sum of squared misses (each as a share of its bound) is brought down by gradient in log weights, through
    the perturbed planner over the routes found so far (`perturbed.known_route_sums`), from several starts and with
    noise that shrinks. Routes under the best weights are then planned without noise, and more around them, until
    nothing new turns up; the best weights by planned routes are returned. If they miss, each wish is tried
    alone, and then each pair of those that can be met. Not met is not proven unreachable: it is the best found.

    Args:
      queries: from several maps if liked.
      wishes: bounds on outcomes.
      start: where to begin; equal shares of the shortest routes' cost if left out.
      max_rounds: of searches, for each set of wishes that is tried.
      seed: of the noise.
      budget_s: seconds for everything; what was found by then is returned.
      workers: threads of search.

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
            raise InputError(f"wish {str(wish)!r}: these maps hold no {metric}")
    pool = RoutePool(queries, workers=workers)
    only_distance = np.eye(len(names))[0]
    shortest = pool.cheapest(np.broadcast_to(only_distance, (len(queries), 1, len(names))))[:, :, 0]
    shortest_sums = np.concatenate(shortest, axis=-1)
    if start is None:
        first = 1 / np.maximum(shortest[0].mean(axis=0), 1e-9)
    else:
        first = np.maximum([float(getattr(start, name)) for name in names], 1e-6)
    search = _Search(pool, names, shortest_sums, np.log(first / first.sum()), max_rounds, seed, begin_s + budget_s)
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
    weights = np.exp(best.log_weights)
    weights /= weights.sum()
    return TargetFit(
        names=names,
        weights=Weights(
            **dict.fromkeys(Weights.__dataclass_fields__, 0.0) | dict(zip(names, weights.tolist(), strict=True))
        ),
        outcomes=_outcome_table(wishes, dict.fromkeys(wishes, best)),
        alone=_outcome_table(wishes, single),
        conflicts=tuple(conflicts),
        is_met=is_met,
        curve=pd.DataFrame(best.rows),
        num_plans=pool.num_plans,
        elapsed_s=time.perf_counter() - begin_s,
    )


def outcome_values(
    sums: Float[AnyArray, "Q J"], shortest: Float[AnyArray, "Q J"], names: Sequence[str], outcomes: Sequence[str]
) -> Float[Array, " N"]:
    """Return outcomes of routes from their features and integrals ``[Q, 2 K]``, beside the shortest routes' sums."""
    num = len(names)
    length, base = sums[:, num], shortest[:, num]
    values = []
    for outcome in outcomes:
        if outcome == "detour":
            values.append(jnp.mean(length / base) - 1)
        elif outcome == "length_m":
            values.append(jnp.mean(length))
        elif outcome == "people":
            column = num + list(names).index("population")
            values.append(jnp.sum(sums[:, column]) / jnp.maximum(jnp.sum(shortest[:, column]), 1e-9))
        else:
            column = num + list(names).index(outcome.removeprefix("mean_"))
            values.append(jnp.mean(sums[:, column] / length))
    return jnp.stack(values)


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
    """What searches for different wishes share: above all the routes that they find."""

    pool: RoutePool
    names: tuple[str, ...]
    shortest: np.ndarray
    log_start: np.ndarray
    max_rounds: int
    seed: int
    end_s: float

    def run(self, wishes: Sequence[Wish]) -> _Found:
        """Return the best weights for some wishes."""
        bounds = _Bounds.of(wishes)
        outcomes = tuple(wish.outcome for wish in wishes)
        rng = np.random.default_rng(self.seed)
        drawn = jnp.asarray(draw_pairs(self.seed, NUM_NOISE, len(self.names)))
        best: _Found | None = None
        rows: list[dict] = []
        for number in range(self.max_rounds):
            starts = np.array([self.log_start, *self._corners(), *([] if best is None else [best.log_weights])])
            features, sums = self.pool.features, np.concatenate([self.pool.features, self.pool.integrals], axis=-1)
            setting = (jnp.asarray(features), jnp.asarray(sums), drawn)
            ended, misses = _descend(jnp.asarray(starts), bounds, setting, self.shortest, self.names, outcomes)
            tried = np.asarray(ended)[np.argsort(np.asarray(misses))[:NUM_TRIED]]
            for log_weights in tried:
                reached = self._planned(log_weights, outcomes)
                missed = np.asarray(bounds.missed(jnp.asarray(reached)))
                if best is None or np.sum(missed**2) < np.sum(best.missed**2):
                    best = _Found(tuple(wishes), log_weights, reached, missed, rows)
            assert best is not None
            rows.append(
                {"round": number + 1, "loss": float(np.sum(best.missed**2)), "num_plans": self.pool.num_plans}
                | dict(zip(map(str, wishes), best.reached.tolist(), strict=True))
            )
            known = self.pool.num_routes
            if not np.any(best.missed) or time.perf_counter() > self.end_s:
                break
            near = best.log_weights + rng.normal(size=(NUM_PROBES, len(self.names))) * PROBE_NOISE
            self.pool.cheapest(np.broadcast_to(np.exp(near), (len(self.shortest), *near.shape)))
            if self.pool.num_routes == known:
                break
        if best is None:
            raise InputError(f"max_rounds must be at least 1, got {self.max_rounds}")
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
    """Wishes as arrays ``[N]``: the bound, +1 for at least and -1 for at most, and the size of the bound."""

    bound: Array
    sign: Array
    size: Array

    @classmethod
    def of(cls, wishes: Sequence[Wish]) -> "_Bounds":
        bound = jnp.array([wish.value for wish in wishes])
        return cls(
            bound,
            jnp.array([1.0 if wish.sense == ">=" else -1.0 for wish in wishes]),
            jnp.maximum(jnp.abs(bound), 1e-3),
        )

    def missed(self, values: Array) -> Array:
        """Return by which share of its bound each wish is missed."""
        return jnp.maximum(self.sign * (self.bound - values) / self.size, 0.0)


@partial(jax.jit, static_argnames=("names", "outcomes"))
def _descend(starts, bounds: _Bounds, setting, shortest, names, outcomes) -> tuple[Array, Array]:
    """Return log weights ``[S, K]`` after descents from each start over known routes, and the squared misses there."""
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
        return ended, squared(ended, noises[-1] * 1e-3)

    return jax.lax.map(descend, starts)


def _outcome_table(wishes: Sequence[Wish], found: dict[Wish, _Found]) -> pd.DataFrame:
    rows = [(found[wish].reached[found[wish].wishes.index(wish)], found[wish].missed_by(wish)) for wish in wishes]
    return pd.DataFrame(
        {
            "wished": [wish.value for wish in wishes],
            "reached": [reached for reached, _ in rows],
            "missed_by": [missed for _, missed in rows],
            "is_met": [missed <= MET for _, missed in rows],
        },
        index=pd.Index([str(wish) for wish in wishes], name="wish"),
    )
