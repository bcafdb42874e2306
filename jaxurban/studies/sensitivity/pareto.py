"""The Pareto front of routes between two or three objectives, as far as weighted sums reach it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, one_of
from jaxurban.studies.outcomes import outcomes_of
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.sensitivity.breakpoints import EXACT, OnPlans, Partition, find_breakpoints

# Share that each objective has at least: a route that is cheapest under weights above 0 is on the front, while under a
# weight of 0 it may be worse than need be in that objective.
LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """The supported part of a Pareto front.

    Attributes:
      objectives: names of the weights whose features are traded.
      points: a row a route: its features by those names, and its outcomes.
      partition: of the weights of the objectives: which route is cheapest where.
    """

    objectives: tuple[str, ...]
    points: pd.DataFrame
    partition: Partition


def pareto_front(
    pool: RoutePool,
    objectives: Sequence[str],
    *,
    tolerance: float = EXACT,
    max_plans: int | None = None,
    on_plans: OnPlans | None = None,
) -> ParetoFront:
    """Return the routes that are best for some weights of two or three features, such as distance and population.

    No other route is as cheap in every chosen feature and better in one. These are the **supported** points only: the
    corners of the front's convex hull. A point of the front inside the hull is the cheapest under no weights, so no
    weighted sum finds it, and it is not here. Features that are not chosen cost nothing.

    Args:
      pool: of one query; routes found join it.
      objectives: two or three of the weights' names.
      tolerance, max_plans, on_plans: as in `find_breakpoints`.

    Raises:
      InputError: other names, a wrong setting, or the query has no path.
    """
    columns = check_objectives(objectives, pool.names)
    alone = np.eye(len(pool.names))[columns]
    # In units of what routes have of each, so that no objective is squeezed into a corner of the triangle.
    size = pool.cheapest(alone)[0, 0][:, columns].max(axis=0)
    shares = np.eye(len(objectives)) * (1 - len(objectives) * LEAST) + LEAST
    corners = shares @ (alone / np.where(size > 0, size, 1.0)[:, None])
    found = find_breakpoints(pool, corners, tolerance=tolerance, max_plans=max_plans, on_plans=on_plans)
    points = pd.DataFrame(found.features[:, columns], columns=list(objectives)).assign(
        **outcomes_of(found.integrals, pool.names)
    )
    points.index = pd.RangeIndex(1, len(points) + 1, name="route")
    return ParetoFront(tuple(objectives), points, found)


def check_objectives(objectives: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return the columns of the objectives among the weights' names.

    Raises:
      InputError: not two or three, one twice, or an unknown name (names the nearest one).
    """
    if len(objectives) not in (2, 3) or len(set(objectives)) < len(objectives):
        raise InputError(f"a front lies between 2 or 3 different objectives, got {', '.join(objectives) or 'none'}")
    return [names.index(one_of("a feature of these maps", name, names)) for name in objectives]
