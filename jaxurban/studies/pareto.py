"""The Pareto front of routes between two or three wishes, as far as weighted sums reach it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, nearest_name
from jaxurban.studies.outcomes import outcomes_of
from jaxurban.studies.pool import RoutePool
from jaxurban.studies.switches import EXACT, OnPlans, Partition, find_switches

# Share that each wish has at least: a route that is cheapest under weights above 0 is on the front, while under a
# weight of 0 it may be worse than need be in that wish.
LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """The supported part of a Pareto front.

    Attributes:
      wishes: names of the weights whose features are traded.
      points: a row a route: its features by those names, and its outcomes.
      partition: of the weights of the wishes: which route is cheapest where.
    """

    wishes: tuple[str, ...]
    points: pd.DataFrame
    partition: Partition


def pareto_front(
    pool: RoutePool,
    wishes: Sequence[str],
    *,
    tolerance: float = EXACT,
    max_plans: int | None = None,
    on_plans: OnPlans | None = None,
) -> ParetoFront:
    """Return the routes that are best for some weights of two or three features, such as distance and population.

    No other route is as good in every chosen feature and better in one. These are the **supported** points only: the
    corners of the front's convex hull. A point of the front inside the hull is the cheapest under no weights, so no
    weighted sum finds it, and it is not here. Features that are not chosen cost nothing.

    Args:
      pool: of one query; routes found join it.
      wishes: two or three of the weights' names.
      tolerance, max_plans, on_plans: as in `find_switches`.

    Raises:
      InputError: other names, a wrong setting, or the query has no path.
    """
    names = pool.queries[0].names
    if len(wishes) not in (2, 3) or len(set(wishes)) < len(wishes):
        raise InputError(f"a front lies between 2 or 3 different wishes, got {', '.join(wishes) or 'none'}")
    for name in wishes:
        if name not in names:
            raise InputError(f"no feature {name!r}{nearest_name(name, names)}: these maps have {', '.join(names)}")
    columns = [names.index(name) for name in wishes]
    alone = np.eye(len(names))[columns]
    # In units of what routes have of each, so that no wish is squeezed into a corner of the triangle.
    size = pool.cheapest(alone[None])[0, 0][:, columns].max(axis=0)
    shares = np.eye(len(wishes)) * (1 - len(wishes) * LEAST) + LEAST
    corners = shares @ (alone / np.where(size > 0, size, 1.0)[:, None])
    found = find_switches(pool, corners, tolerance=tolerance, max_plans=max_plans, on_plans=on_plans)
    points = pd.DataFrame(found.features[:, columns], columns=list(wishes)).assign(
        **outcomes_of(found.integrals, names)
    )
    points.index = pd.RangeIndex(1, len(points) + 1, name="route")
    return ParetoFront(tuple(wishes), points, found)
