"""How sure fitted weights are: what demonstrations cannot show, and what others would have shown."""

from collections.abc import Iterator, Sequence
from enum import Enum

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import linprog

from jaxurban.programs import kept_jit
from jaxurban.statistics.conclusions import Verdict
from jaxurban.studies.queries import RouteQuery, maps_of
from jaxurban.studies.route_pool import NOT_A_ROUTE, RoutePool
from jaxurban.studies.tuning.fenchel_young import FitTask, descend, fenchel_young_loss

STEPS = 100  # of each refit, which starts at the fit of all demonstrations
FAR = 1e6  # times a demonstration's cost: beyond are rows that only fill up the arrays
UNBOUNDED = 3  # status of scipy.optimize.linprog
NO_TRUST = 1e-12  # so that a sum of trusts is never 0
FLAT = 1e-6  # a layer that varies by less over free cells is constant
COMPETES = 0.1  # routes within this share of the cheapest are those that weights choose between
# Of the largest variance: a direction of W with less leaves every comparison as it is.
UNSEEN = 1e-6
MUCH = 0.1  # of the largest: a weight with such a part in a direction belongs to it
LEAST_COST = 0.01  # c of each step, of a route that avoids a metric altogether
DUST = 1e-4  # a weight that adds a smaller share to the cost of every route is 0
LEAST_WEIGHT = 1e-5  # of all weights: one that counts is not smaller


class FitVerdict(Enum):
    """What a fit to routes decides, and what the routes cannot say."""

    FOLLOWED = (
        "routes that the fit did not see cost {size} more than the cheapest under the weights ({n}{left_out}), and of "
        "all such routes at most {most:.0f} % are not the cheapest"
    )
    UNTESTED = (
        "how much more than the cheapest other routes cost is open: {size} on {n}; an interval takes {takes} pairs of "
        "ends that are held out"
    )
    WEIGHED = "the weight of {first} is {size} at 90 %"
    AT_MOST = "the weight of {first} is at most {high}, which adds less than {share} to the cost of any route"
    CONSTANT = "{first} is the same everywhere on these maps: its weight cannot be identified and is left at 0"
    STEPS = (
        "{first} is the same everywhere on these maps: its weight cannot be identified and stands for the steps that "
        "diagonals save under the cost model 'cell'"
    )
    WIDE = "the weight of {first} is hardly pinned down, as others move with it: {size}"
    UNSEEN = "the weight of {first} cannot be identified: no competing route differs in it"
    MIXED = "the weights of {what} cannot be distinguished: {num} of their mixtures change no comparison"
    ONE_RATE = (
        "the weights of {what} cannot be distinguished: competing routes trade them at one rate"
    )


def draw_counts(cities: np.ndarray, num_draws: int, rng: np.random.Generator) -> np.ndarray:
    """Return ``[B, N]`` how often each of ``N`` members counts in each of B bootstrap draws.

    Where there are several cities, cities are drawn first, with replacement and as many as there are. Then each drawn
    city draws as many members as it has. This serves percentiles of refits; for intervals of means
    `jaxurban.statistics.bootstrap` draws one group less.

    Args:
      cities: ``[N]`` the number of each member's city, from 0.
      num_draws: B.
      rng: what is drawn.
    """
    members = [np.flatnonzero(cities == city) for city in range(cities.max(initial=0) + 1)]
    counts = np.zeros((num_draws, len(cities)))
    for row in counts:
        drawn = rng.integers(len(members), size=len(members)) if len(members) > 1 else [0]
        for city in drawn:
            of_city = members[city]
            num = len(of_city)
            row[of_city] += rng.multinomial(num, np.full(num, 1 / num))
    return counts


def refit(log_weights: np.ndarray, task: FitTask, counts: np.ndarray) -> np.ndarray:
    """Return ``[B, K]`` log weights fitted to demonstrations that are drawn with replacement.

    Fits are made over the known routes, without any search. B is 0 without draws, or with a single demonstration.

    Args:
      log_weights: ``[K]`` of the fit of all demonstrations.
      task: its routes, noise and trust.
      counts: ``[B, Q]`` how often each demonstration is drawn.
    """
    if len(counts) == 0 or len(task.demo) < 2:
        return np.empty((0, len(log_weights)))
    trusts = jnp.asarray(counts * np.asarray(task.trust) + NO_TRUST)
    return np.asarray(_fits(jnp.asarray(log_weights), task, trusts))


@kept_jit
def _fits(log_weights: jax.Array, task: FitTask, trusts: jax.Array) -> jax.Array:
    """Return ``[T, K]`` the log weights fitted under each row of trusts ``[T, Q]``, all from the same start ``[K]``."""

    def fit(trust: jax.Array) -> jax.Array:
        """Return ``[K]`` the log weights fitted under trusts ``[Q]``."""
        return descend(
            log_weights, task._replace(trust=trust), objective=fenchel_young_loss, num_steps=STEPS
        )[0]

    return jax.lax.map(fit, trusts)


def near_optimal_range(
    weights: np.ndarray, task: FitTask, scale: np.ndarray, tolerance: float
) -> np.ndarray:
    """Return ``[2, F]`` the least and the largest value of each weight among all W that explain the routes as well.

    W explains the routes as well if its mean regret over the known routes, weighted by trust, is at most the regret of
    the fit plus a tolerance. Such W form a polytope, whose extent along each weight takes two linear programs (costs in
    the regrets' denominators are taken at the fit). Where the demonstrations are exactly cheapest under a hidden W, the
    polytope contains that W, however many demonstrations there are. The largest value is inf where a weight may grow
    without end; where a program fails, an end is the fit's own value.

    Of demonstrations that are known as a line only, ``demo`` holds features that are nowhere above the true ones. Their
    cost is then nowhere above the true cost either, so the hidden W is contained too.

    Args:
      weights: ``[F]`` of the fit, of features in the task's units.
      task: its routes and trust, with the least that the demonstrations may add up as ``demo``.
      scale: ``[F]``: only weights W with scale . W = 1 are compared.
      tolerance: by how much the mean regret may exceed that of the fit; regrets are shares of costs.
    """
    # [Q, F] features of the demonstrations, [Q, R, F] of the known routes, and [Q] the trust.
    demo, routes, trust = map(np.asarray, (task.demo, task.routes, task.trust))
    num_queries, num_weights = demo.shape

    # [Q] the cost of each demonstration, and what a unit of cost above the cheapest route adds to the mean regret.
    weights = weights / (scale @ weights)
    cost = demo @ weights
    share = trust / trust.sum() / cost
    route_costs = routes @ weights
    regret = float(np.sum(share * np.maximum(cost - np.min(route_costs, axis=1), 0.0)))

    # Unknowns are the F weights, then a slack for each query: how much more its demonstration costs than its cheapest
    # route, as a share of its cost. A row for each known route: demo . W - route . W is at most the slack.
    query, route = np.nonzero(route_costs <= FAR * cost[:, None])
    slack = np.diag(-cost)[query]
    rows = np.hstack([demo[query] - routes[query, route], slack])

    # The last row: the slacks' mean, weighted by trust, is at most the allowed regret of the mean demonstration.
    centre = demo.mean(axis=0) / (demo.mean(axis=0) @ weights)
    bound = np.concatenate([-(regret + tolerance) * centre, share * cost])
    above = np.vstack([rows, bound])
    equal = np.append(scale, np.zeros(num_queries))[None, :]

    # The least value of each weight (sign 1), then the largest (sign -1, as programs minimise).
    ends = np.tile(weights, (2, 1))
    for column in range(num_weights):
        for row, sign in enumerate((1.0, -1.0)):
            aim = np.zeros(num_weights + num_queries)
            aim[column] = sign
            result = linprog(
                aim, A_ub=above, b_ub=np.zeros(len(above)), A_eq=equal, b_eq=[1.0], bounds=(0, None)
            )
            if result.x is not None:
                ends[row, column] = result.x[column]
            elif result.status == UNBOUNDED:
                ends[row, column] = np.inf
    return ends


def constant_layers(queries: Sequence[RouteQuery]) -> tuple[str, ...]:
    """Return the metrics whose cost is the same, within `FLAT`, over all free cells of all the queries' maps."""
    # [maps, 2, metrics] the least and the largest cost on each map.
    free = (cost_map.costs[:, cost_map.is_free] for cost_map in maps_of(queries))
    ends = np.array([(costs.min(axis=1), costs.max(axis=1)) for costs in free], np.float64)
    spans = ends[:, 1].max(axis=0) - ends[:, 0].min(axis=0)
    return tuple(
        name for name, span in zip(queries[0].cost_map.names, spans, strict=True) if span < FLAT
    )


def feature_units(
    queries: Sequence[RouteQuery], demo: np.ndarray, least: float = LEAST_COST
) -> np.ndarray:
    """Return ``[K]`` the size of each feature: its mean over routes.

    That of a metric is at least its cost where c is ``least`` at every step. This floor keeps weights finite where
    every demonstration avoids a cost altogether.

    Args:
      queries: of the routes; their maps say how long a step is.
      demo: ``[Q, K]`` features of the routes, metres first.
      least: c, at most 1, with which a metric costs the most that it can.
    """
    # Steps of the mean route: cells, or reference lengths under the cost model ``line``.
    first = queries[0].cost_map
    step_m = first.grid.resolution_m
    if first.cost_model.kind == "line":
        step_m = first.cost_model.reference_length_m
    num_steps = demo[:, 0].mean() / step_m
    floor = np.full(demo.shape[1], least * num_steps)
    floor[0] = 0.0  # the length has none
    return np.maximum(demo.mean(axis=0), floor)


def without_dust(weights: np.ndarray, pool: RoutePool) -> np.ndarray:
    """Return ``[K]`` weights that sum to 1; those that change the cost of no known route by `DUST` are 0.

    A weight stays without which the cheapest routes cost more by `DUST`: no known route pays for what it keeps away.

    Args:
      weights: ``[K]`` of features in their own units.
      pool: the known routes; those that are cheapest without a weight join it.
    """
    routes = pool.routes[0]
    costs = routes[routes[..., 0] < NOT_A_ROUTE] * weights
    shares = costs / np.maximum(costs.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    kept = np.maximum(weights / weights.sum(), LEAST_WEIGHT)
    for column in np.flatnonzero(shares.max(axis=0) < DUST):
        without = kept.copy()
        without[column] = 0.0
        with_it, without_it = (pool.cheapest(np.stack([kept, without]))[0] @ kept).T
        if np.all(without_it <= (1 + DUST) * with_it):
            kept = without
    return kept / kept.sum()


def indistinct_weights(
    pool: RoutePool, unit: np.ndarray, weights: np.ndarray, is_fitted: np.ndarray
) -> Iterator[Verdict]:
    """Yield what is not decided of the weights, alone or mixed, about which the demonstrations say nothing.

    Routes that cost within 10 % of the cheapest one compete with it. C is the covariance of their features less those
    of the cheapest. A direction v with v C v = 0 can be added to W without changing any comparison between these
    routes. That the length of W is open goes without saying.

    Args:
      pool: the known routes.
      unit: ``[K]`` in which features are counted.
      weights: ``[K]`` W, of features in their own units.
      is_fitted: ``[K]`` bool: the weights that are judged.
    """
    # [Q, R] which routes compete, and [K', K'] the covariance C of what they have more than the cheapest, for the K'
    # weights that are judged.
    routes = pool.routes[0]
    names = np.array(pool.names)[is_fitted]
    cost = np.where(routes[..., 0] < NOT_A_ROUTE, routes @ weights, np.inf)
    competes = cost <= cost.min(axis=1, keepdims=True) * (1 + COMPETES)
    cheapest = np.take_along_axis(routes, cost.argmin(axis=1)[:, None, None], axis=1)
    more = ((routes - cheapest) / unit)[competes]
    covariance = (more.T @ more / max(len(more), 1))[np.ix_(is_fitted, is_fitted)]

    # Weights of features in which competing routes do not differ.
    variances = np.diag(covariance)
    is_seen = variances > UNSEEN * max(float(np.max(variances)), 1e-300)
    for name in names[~is_seen]:
        yield Verdict(FitVerdict.UNSEEN, (str(name),), needed=np.nan)
    if is_seen.sum() < 2:
        return

    # Mixtures of the others that change nothing: eigenvectors of C with next to no variance. Named are the
    # weights that have much part in them.
    values, directions = np.linalg.eigh(covariance[np.ix_(is_seen, is_seen)])
    unseen = directions[:, values <= UNSEEN * values[-1]]
    num = unseen.shape[1]
    if num:
        part = np.linalg.norm(unseen, axis=1)
        involved = tuple(names[is_seen][part > MUCH * part.max()].tolist())
        kind = FitVerdict.MIXED if num > 1 else FitVerdict.ONE_RATE
        yield Verdict(kind, involved, needed=np.nan, facts={"num": num})
