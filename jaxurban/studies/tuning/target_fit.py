"""Weights fitted to targets: those under which routes meet them."""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jaxtyping import Array, Float

from jaxurban.checks import one_of, typed
from jaxurban.errors import InputError
from jaxurban.metrics.weights import AnyArray, Weights
from jaxurban.programs import kept_jit
from jaxurban.progress import Report, reporting
from jaxurban.statistics.conclusions import Conclusion
from jaxurban.studies.demonstrations import Demonstration, optimal_demonstrations
from jaxurban.studies.queries import (
    LENGTH,
    PEOPLE,
    RouteQuery,
    check_alike,
    outcomes_of,
    weight_units,
    weights_from,
)
from jaxurban.studies.route_pool import (
    FitSettings,
    RoutePool,
    draw_pairs,
    known_route_sums,
)
from jaxurban.studies.tuning.confidence import feature_units, without_dust
from jaxurban.studies.tuning.fenchel_young import adam
from jaxurban.studies.tuning.fitted import GIVEN, FitResult
from jaxurban.studies.tuning.target import DETOUR, MEAN, Target
from jaxurban.studies.tuning.tested import FitCommands, split, tested_outcomes, wish_verdicts

FIRST_RATE, LAST_RATE = 0.2, 0.02  # of Adam, in log weight a step
FIRST_NOISE, LAST_NOISE = 0.7, 0.05  # of the perturbed planner, from the first to the last step
NUM_NOISE, NUM_STEPS = 128, 100
NUM_EXPLORED = 16  # weights planned under at first
CORNER = 30.0  # times more that a corner cares for one thing
# Weights evaluated over known routes, and descended from, per round.
NUM_CANDIDATES, NUM_STARTS = 1000, 6
FAR_SPREAD, NEAR_SPREAD = 3.0, 0.1  # of the candidates' log weights about the best
NUM_TRIED, NUM_PROBES = 3, 8  # weights planned for, and searches around the best, a round
PROBE_NOISE = (0.05, 0.8)  # of those searches' log weights, from the nearest to the farthest
PATIENCE = 3  # rounds that better nothing
NUM_AT_ONCE = 64  # candidates judged at once, to bound memory
MET = 0.02  # a target is met if it is missed by no more than this share
LEAST_SHARE = 1e-3  # of the cost of a layer: as much as none where ratios of weights are compared
IN_PYTHON = FitCommands("ju.fit.fit_targets(queries, targets, hold_out={share})")


@dataclass(frozen=True, eq=False, repr=False)
class TargetFit(FitResult):
    """Weights fitted to targets.

    Attributes:
      names: ``"distance"`` and the metrics.
      weights: they sum to 1; where those without the wish meet all targets, these very weights.
      table: a row for each, by its name: ``weight``, and its ``unit``, per what it is.
      outcomes: a row per target: wished (its bound), shortest (what the shortest routes give), reached, missed_by
        (share of the bound), is_met; by planned routes, without noise.
      is_met: all targets are met within 2 %.
      is_in_budget: the search ended by itself; a larger budget would find no more.
      curve: a row per round: the least loss so far, its outcomes, and the searches made.
      num_plans, elapsed_s: searches and wall time.
      targets: as wished.
      is_held_out: ``[Q]`` bool: the queries that the weights were not fitted to.
      tested: on those queries, or on all where none is held out: what routes are like without the wish and with it, a
        row per target and then per other outcome (`jaxurban.studies.tuning.tested.tested_outcomes`).
      routes: those of all ``Q`` queries without the wish.
      is_kept: nothing was fitted, as the weights without the wish meet all targets.
      commands: what fits again.
      origin: of the queries, in words.

    Examples:
      >>> queries = ju.studies.make_queries(ju.cost_map(maps, 60.0), [(start, goal)])
      >>> fit = ju.fit.fit_targets(queries, ["detour<=0.2"], settings=ju.fit.FitSettings(max_rounds=2))
      >>> fit.is_met, ju.plan(maps, start, goal, altitude_m=60.0, weights=fit.weights).status.value
      (True, 'optimal')
    """

    names: tuple[str, ...]
    weights: Weights
    table: pd.DataFrame
    outcomes: pd.DataFrame
    is_met: bool
    is_in_budget: bool
    curve: pd.DataFrame
    num_plans: int
    elapsed_s: float
    targets: tuple[Target, ...]
    is_held_out: np.ndarray
    tested: pd.DataFrame
    routes: tuple[Demonstration, ...]
    is_kept: bool
    commands: FitCommands = IN_PYTHON
    origin: str = GIVEN

    @property
    def num_pairs(self) -> int:
        """Number of different pairs of ends of the queries."""
        return len({(query.start, query.goal) for query in self.queries})

    @property
    def decided(self) -> Conclusion:
        """Whether the targets hold on other routes, and what the wish costs in every other layer."""
        command = ""
        verdicts, needed = wish_verdicts(
            self.tested,
            self.targets,
            self.outcomes.is_met.tolist(),
            is_tested=bool(self.is_held_out.any()),
            is_kept=self.is_kept,
        )
        if needed:
            share = float(self.is_held_out.mean())
            command = self.commands.holding_out(needed, self.num_pairs, share)
        asked = needed if command else 0.0
        return Conclusion((*verdicts, *self.border), command or self.last_command, asked)

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, and whether all targets are met."""
        return self.decided.facts | {"fit": self.sentence}

    @property
    def sentence(self) -> str:
        """Whether all targets are met; if not, which are missed, and whether the budget ran out."""
        if self.is_kept:
            return "All targets are met without the wish: keep the weights as they are."
        if self.is_met:
            return (
                "All targets are met on the average of the routes that the weights were fitted to."
            )
        rows = self.outcomes[~self.outcomes.is_met].iterrows()
        missed = [f"{target} (reached {row.reached:.4g})" for target, row in rows]
        sentence = f"Not all targets were met; the best trade-off found misses {', '.join(missed)}."
        if not self.is_in_budget:
            sentence += " The budget ended the search: a larger one may find better."
        return sentence


@typed
def fit_targets(
    queries: Sequence[RouteQuery],
    targets: Sequence[Target | str],
    *,
    before: Weights | None = None,
    hold_out: float | None = None,
    settings: FitSettings | None = None,
) -> TargetFit:
    """Return weights under which planned routes meet targets, or the best trade-off between them.

    The sum of squared misses (each as a share of its bound) is brought down by gradient in log weights, through the
    perturbed planner over the routes found so far, with noise that shrinks, from the best of many random weights.
    Routes under the best weights are then planned without noise, and more around them, until three rounds better
    nothing; the best weights by planned routes are returned, of several that meet all targets those nearest to the
    weights without the wish. If these meet all targets, they are returned and nothing is fitted. A target that was
    missed may still be reachable, as the search is not exact; whether it conflicts with another one, a fit to it alone
    says.

    Args:
      queries: from `jaxurban.studies.make_queries`; lists of several maps may be joined with ``+``.
      targets: bounds on outcomes, or texts such as ``"mean_gps>=0.8"``.
      before: the weights without the wish, whose routes are compared; `Weights()` if left out.
      hold_out: share of the queries, from 0 to 0.9, that the weights are not fitted to, to test them; left out, a
        quarter from 16 on, of fewer none. Queries between the same cells stay together.
      settings: of the search.

    Returns:
      ``weights``, which `jaxurban.plan` takes; ``is_met``, and ``sentence``, which names what is
      missed; ``outcomes``, a row per target: its bound, what the shortest routes give, and what was reached; and
      ``decided``, whether the targets hold on other routes and what the wish costs there (``tested``).

    Raises:
      InputError: no queries or targets, a target for a metric that the maps lack, or a wrong setting.

    Examples:
      >>> queries = ju.studies.make_queries(ju.cost_map(maps, 60.0), [(start, goal)])
      >>> fit = ju.fit.fit_targets(queries, ["detour<=0.2"], settings=ju.fit.FitSettings(max_rounds=2))
      >>> fit.sentence
      'All targets are met without the wish: keep the weights as they are.'
      >>> fit.outcomes[["wished", "shortest", "is_met"]]
                     wished  shortest  is_met
      wish
      detour <= 0.2     0.2       0.0    True
    """
    # The targets, and the pool of routes that are searched.
    begin_s = time.perf_counter()
    settings = settings or FitSettings()
    names = check_alike(queries)
    wanted = _wanted(targets, names)
    group, _ = pd.factorize(pd.Series([(query.start, query.goal) for query in queries]))
    is_held_out = split(np.zeros(len(queries)), group, hold_out, settings.seed)
    before = before or Weights()
    without = before.vector(names)
    with jax.enable_x64(True), reporting("fit", settings.progress) as report:
        search_on = partial(
            _Search.of, wanted, without, settings, begin_s + settings.budget_s, report
        )

        # Nothing is fitted where the weights without the wish meet all targets; none of the routes is fitted then.
        search = search_on(queries)
        best = search.planned(without)
        is_kept = not np.any(best.missed)
        if is_kept:
            is_held_out = np.ones(len(queries), bool)
        else:
            search = search_on(list(itertools.compress(queries, ~is_held_out)))
            search.explore()
            best = search.run()
        at_shortest = search.outcomes(search.shortest)
        at_before = search.planned(without).reached
    tested_on = list(itertools.compress(queries, is_held_out)) or queries
    return TargetFit(
        names=names,
        weights=weights_from(queries[0], best.weights),
        table=pd.DataFrame(
            {"weight": best.weights, "unit": weight_units(queries[0].cost_map)},
            pd.Index(names, name="name"),
        ),
        outcomes=_outcome_table(wanted, best, at_shortest, at_before),
        is_met=bool(np.all(best.missed <= MET)),
        curve=pd.DataFrame(best.rows),
        is_in_budget=time.perf_counter() - begin_s <= settings.budget_s,
        num_plans=search.pool.num_plans,
        elapsed_s=time.perf_counter() - begin_s,
        targets=wanted,
        is_held_out=is_held_out,
        tested=tested_outcomes(tested_on, wanted, np.stack([without, best.weights])),
        routes=tuple(optimal_demonstrations(queries, before)),
        is_kept=is_kept,
    )


def _wanted(targets: Sequence[Target | str], names: Sequence[str]) -> tuple[Target, ...]:
    """Return the targets of a fit, the texts among them parsed.

    Args:
      targets: one or more; a single text is one target.
      names: of the weights, ``"distance"`` first, which decide the outcomes that routes have.

    Raises:
      InputError: there is no target, a text has another form, or routes do not have the outcome.
    """
    if not targets:
        raise InputError("there are no targets: give at least one, such as mean_gps>=0.8")

    # The outcomes that routes on these maps have; each target must name one of them.
    outcomes = [DETOUR, "length_m", *(MEAN + name for name in names[1:])]
    if "population" in names:
        outcomes.insert(2, "people")
    wanted = []
    for target in [targets] if isinstance(targets, str) else targets:
        if isinstance(target, str):
            target = Target.parse(target)
        one_of("the outcome of a target", target.outcome, outcomes)
        wanted.append(target)
    return tuple(wanted)


class _Aim(NamedTuple):
    """What weights are judged by over known routes: ``Q`` queries, ``R`` routes of each, ``N`` targets, ``K`` weights.

    Attributes:
      bound: ``[N]`` of each target.
      sign: ``[N]`` +1 (at least) or -1 (at most).
      routes: ``[Q, R, 2 K]`` features and integrals of the known routes.
      shortest: ``[Q, 2 K]`` those of the shortest ones.
    """

    bound: AnyArray
    sign: AnyArray
    routes: AnyArray
    shortest: AnyArray


class _Best(NamedTuple):
    """The best weights of a search so far.

    Attributes:
      weights: ``[K]``, not one of them dust (`without_dust`).
      log_weights: ``[K]`` around which is searched further.
      reached: ``[N]`` the outcomes of the routes planned under them, of all targets.
      missed: ``[N]`` by which share of its bound each target is missed; inf before the first round.
      rows: a row per round; the list grows with the search.
    """

    weights: np.ndarray
    log_weights: np.ndarray
    reached: np.ndarray
    missed: np.ndarray
    rows: list[dict]


class _Search(NamedTuple):
    """A search for weights: the routes that it finds, and what they are judged by."""

    pool: RoutePool
    targets: tuple[Target, ...]
    shortest: np.ndarray  # [Q, 2 K] features and integrals
    # [K] log weights: with an equal share of the cost of the shortest routes for each layer, and without the wish,
    # where a weight of 0 is one that counts for next to nothing.
    log_start: np.ndarray
    log_before: np.ndarray
    settings: FitSettings
    end_s: float
    report: Report

    @classmethod
    def of(
        cls,
        targets: tuple[Target, ...],
        before: np.ndarray,
        settings: FitSettings,
        end_s: float,
        report: Report,
        queries: Sequence[RouteQuery],
    ) -> "_Search":
        """Return a search that knows the shortest route of each query alone; ``before`` are weights ``[K]``."""
        pool = RoutePool(queries)
        shortest = pool.cheapest(np.eye(len(before))[:1])[:, :, 0]
        first = 1 / feature_units(queries, shortest[0])
        shares = before / first
        log_before = np.log(first * np.maximum(shares, LEAST_SHARE * (shares.max() or 1.0)))
        log_start = np.log(first / first.sum())
        sums = np.concatenate(shortest, axis=-1)
        return cls(pool, targets, sums, log_start, log_before, settings, end_s, report)

    @property
    def aim(self) -> _Aim:
        """What weights are judged by over the routes known so far."""
        routes = jnp.asarray(np.concatenate(self.pool.routes, axis=-1))
        bound = jnp.array([target.value for target in self.targets])
        sign = jnp.array([target.sign for target in self.targets])
        return _Aim(bound, sign, routes, self.shortest)

    def planned(self, weights: np.ndarray) -> _Best:
        """Return what routes that are planned under weights ``[K]`` reach and miss, as the first round."""
        sums = self.pool.cheapest(weights[None])[:, :, 0]
        reached = self.outcomes(np.concatenate(sums, axis=-1))
        missed = np.asarray(_missed(reached, self.aim))
        row = {"round": 0, "loss": float(np.sum(missed**2)), "num_plans": self.pool.num_plans}
        return _Best(weights, self.log_before, reached, missed, [row])

    def run(self) -> _Best:
        """Return the best weights for the targets.

        Each round judges many weights over the known routes, descends from the best of them, plans routes under the
        best ends of the descents, and searches around the best weights so far. It ends after the settings' rounds, when
        no target is missed, when three rounds better nothing, or when the time is over.
        """
        # Random numbers. Candidates spread ever less around the best weights, and
        # probes ever more: a standard deviation of the log weights for each of them, [C, 1] and [P, 1].
        rng = np.random.default_rng(self.settings.seed)
        num_weights = len(self.log_start)
        noises = jnp.asarray(draw_pairs(self.settings.seed, NUM_NOISE, num_weights))
        spread = FAR_SPREAD * np.geomspace(1.0, NEAR_SPREAD / FAR_SPREAD, NUM_CANDIDATES)[:, None]
        widths = np.geomspace(*PROBE_NOISE, NUM_PROBES)[:, None]

        # Before the first round nothing is reached, and every target is missed by inf.
        unreached = np.full(len(self.targets), np.inf)
        rows: list[dict] = []
        best = _Best(unreached, self.log_before, unreached, unreached, rows)

        for number in range(self.settings.max_rounds):
            # Candidates, judged over the known routes, and descents from the best of them.
            aim = self.aim
            anywhere = best.log_weights + spread * rng.normal(size=(NUM_CANDIDATES, num_weights))
            usual = self.log_before, self.log_start, self._corners()
            candidates = np.vstack([best.log_weights, *usual, anywhere])
            starts = self._least(candidates, NUM_STARTS, aim)
            descended = _descend(
                jnp.asarray(starts), noises, aim, names=self.pool.names, targets=self.targets
            )

            # The best of the weights by routes that are planned under them, with features and integrals [2, Q, K].
            for log_weights in self._least(np.concatenate([descended, starts]), NUM_TRIED, aim):
                tried = self.planned(without_dust(np.exp(log_weights), self.pool))
                if np.sum(tried.missed**2) < np.sum(best.missed**2):
                    best = tried._replace(log_weights=log_weights, rows=rows)

            # The round as a row of the curve.
            row = {
                "round": number + 1,
                "loss": float(np.sum(best.missed**2)),
                "num_plans": self.pool.num_plans,
            }
            rows.append(row | dict(zip(map(str, self.targets), best.reached.tolist(), strict=True)))
            self.report("rounds", number + 1, loss=f"{row['loss']:.3g}", searches=row["num_plans"])

            # The end: all targets are reached, `PATIENCE` rounds have not lowered the loss, or the time is over. Else
            # routes are planned around the best weights, which the next round judges by.
            is_stuck = number >= PATIENCE and rows[-1]["loss"] >= rows[-1 - PATIENCE]["loss"]
            if not np.any(best.missed) or is_stuck or time.perf_counter() > self.end_s:
                break
            near = best.log_weights + widths * rng.normal(size=(NUM_PROBES, num_weights))
            self.pool.cheapest(np.exp(near))
        return best

    def _least(self, candidates: np.ndarray, num: int, aim: _Aim) -> np.ndarray:
        """Return ``[num, K]`` the log weights, of ``[S, K]``, whose cheapest known routes miss least.

        Those that miss as little are in the order of their ratios' distance to the weights without the wish.
        """
        misses = _known_misses(
            jnp.asarray(candidates), aim, names=self.pool.names, targets=self.targets
        )
        away = np.std(candidates - self.log_before, axis=1)
        return candidates[np.lexsort((away, np.asarray(misses)))[:num]]

    def explore(self) -> None:
        """Fill the pool with routes under weights of all kinds."""
        rng = np.random.default_rng(self.settings.seed)
        start = np.exp(self.log_start)
        anywhere = rng.dirichlet(np.ones(len(start)), size=NUM_EXPLORED) * start
        self.pool.cheapest(np.concatenate([start[None], np.exp(self._corners()), anywhere]))

    def outcomes(self, sums: np.ndarray) -> np.ndarray:
        """Return the targets' outcomes ``[N]`` of routes that add up to ``[Q, 2 K]``."""
        return np.asarray(outcome_values(sums, self.shortest, self.pool.names, self.targets))

    def _corners(self) -> np.ndarray:
        """Return ``[K, K]`` log weights of which each cares for one thing mostly."""
        return self.log_start + np.log(CORNER) * np.eye(len(self.log_start))


def outcome_values(
    sums: Float[AnyArray, "Q J"],
    shortest: Float[AnyArray, "Q J"],
    names: Sequence[str],
    targets: Sequence[Target],
) -> Float[Array, " N"]:
    """Return the outcome of routes that each target bounds (see `Target`).

    Args:
      sums: features and then integrals ``[Q, 2 K]`` of a route of each query.
      shortest: the same of the shortest routes, to which detours and people are related.
      names: ``[K]`` the weights, ``"distance"`` first.
      targets: ``[N]`` name the outcomes.
    """
    # Integrals begin after K features.
    num = len(names)
    outcomes = outcomes_of(sums[:, num:], names)
    at_shortest = outcomes_of(shortest[:, num:], names)
    values = {name: jnp.mean(outcome) for name, outcome in outcomes.items()}
    values[DETOUR] = jnp.mean(outcomes[LENGTH] / at_shortest[LENGTH]) - 1
    if PEOPLE in outcomes:
        # The shortest routes may pass no people: nothing is divided by 0.
        most = jnp.maximum(jnp.sum(at_shortest[PEOPLE]), 1e-9)
        values[PEOPLE] = jnp.sum(outcomes[PEOPLE]) / most
        values[f"{MEAN}population"] = jnp.mean(outcomes[PEOPLE] / outcomes[LENGTH])
    return jnp.stack([values[target.outcome] for target in targets])


def _missed(values: AnyArray, aim: _Aim) -> Array:
    """Return ``[N]`` by which share of its bound each outcome misses its target, 0 where the target is met.

    A bound whose size is below 0.001 counts as that, so that nothing is divided by 0.

    Args:
      values: ``[N]`` outcomes.
      aim: its bounds and signs count.
    """
    size = jnp.maximum(jnp.abs(aim.bound), 1e-3)
    return jnp.maximum(aim.sign * (aim.bound - values) / size, 0.0)


def _squared_misses(
    sums: AnyArray, aim: _Aim, names: Sequence[str], targets: Sequence[Target]
) -> Array:
    """Return the sum of the squared misses of routes that add up to ``[Q, 2 K]``."""
    values = outcome_values(sums, aim.shortest, names, targets)
    return jnp.sum(_missed(values, aim) ** 2)


@partial(kept_jit, static_argnames=("names", "targets"))
def _descend(starts: Array, draws: Array, aim: _Aim, *, names: Any, targets: Any) -> Array:
    """Return log weights ``[S, K]`` after a descent from each start, over the known routes with noise that shrinks.

    Args:
      starts: ``[S, K]`` log weights.
      draws: ``[M, K]`` normal noise, the same at every step.
      aim: what is missed least.
      names, targets: as in `outcome_values`.
    """

    def squared(log_weights: Any, noise: Any) -> Array:
        """Return the squared misses of the expected sums of routes under perturbed weights."""
        expected = known_route_sums(log_weights, aim.routes, draws, noise)
        return _squared_misses(expected, aim, names, targets)

    rates = optax.exponential_decay(FIRST_RATE, NUM_STEPS, LAST_RATE / FIRST_RATE)
    noises = jnp.geomspace(FIRST_NOISE, LAST_NOISE, NUM_STEPS)
    return jax.lax.map(
        lambda start: adam(squared, start, rates, noises, jax.nn.log_softmax), starts
    )


@partial(kept_jit, static_argnames=("names", "targets"))
def _known_misses(candidates: Array, aim: _Aim, *, names: Any, targets: Any) -> Array:
    """Return ``[S]`` the squared misses of the cheapest known routes under each of log weights ``[S, K]``.

    Args:
      candidates: the log weights.
      aim: what is missed.
      names, targets: as in `outcome_values`.
    """

    def squared(log_weights: Any) -> Array:
        """Return the squared misses under log weights ``[K]``."""
        costs = aim.routes[..., : len(names)] @ jnp.exp(log_weights)
        cheapest = jnp.argmin(costs, axis=-1)[:, None, None]
        chosen = jnp.take_along_axis(aim.routes, cheapest, axis=1)[:, 0]
        return _squared_misses(chosen, aim, names, targets)

    return jax.lax.map(squared, candidates, batch_size=NUM_AT_ONCE)


def _outcome_table(
    targets: Sequence[Target], best: _Best, at_shortest: np.ndarray, at_before: np.ndarray
) -> pd.DataFrame:
    """Return a row per target, indexed by its text: its bound, and what was reached and missed.

    Args:
      targets: ``[N]``.
      best: of the search.
      at_shortest, at_before: ``[N]`` the outcomes of the shortest routes, and of those without the wish.
    """
    table = pd.DataFrame(
        {
            "wished": [target.value for target in targets],
            "shortest": at_shortest,
            "before": at_before,
            "reached": best.reached,
            "missed_by": best.missed,
        },
        index=pd.Index(map(str, targets), name="wish"),
    )
    return table.assign(is_met=table.missed_by <= MET)
