"""What only a study of one route has: every route along the range of each weight."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from jaxurban.checks import one_of, typed
from jaxurban.io.tables import Row
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY
from jaxurban.progress import Report
from jaxurban.studies.decided import SIDES, sides_at_edge
from jaxurban.studies.demonstrations import overlap_of
from jaxurban.studies.queries import RouteQuery, outcomes_of, weights_from
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.breakpoints import WeightLine, find_breakpoints
from jaxurban.studies.weights.paid import PAID, paid_on
from jaxurban.studies.weights.routes import WeightsJob, query_of, varied_columns

SAME_WAY = 0.5  # of a route's cells: one that keeps less of them goes another way
MORE = [f"more_{name}" for name in PAID if name != "at_edge"]
OF_WAY = [
    "weight_name",
    "side",
    "first",
    "factor",
    "overlap",
    "more_cost",
    *MORE,
    "at_edge",
    "edge_sides",
]


@dataclass(frozen=True, eq=False, repr=False)
class OneRoute:
    """What the weights do to one route, exactly. ``K`` weights.

    Attributes:
      path: the cheapest route under the given weights.
      names: ``"distance"`` and the metrics.
      weights: ``[K]`` as given.
      factors: the ends of the range of each weight, as multiples of it.
      features: ``[K]`` what the weights multiply on this route, which is the gradient of its cost by the weights.
      lines: of each varied weight, the routes along its range, the others as given.
      ways: where each weight, made less or more, sends the drone another way (`_ways`).
      line_routes: ``[N, 2]`` easting and northing of the routes of each line, in the order of its cells.
      edge_sides: sides on which the path runs along the border of the maps.

    Examples:
      >>> quick = ju.studies.SensitivitySettings(vary=("gps",))
      >>> result = ju.studies.sensitivity(
      ...     maps, "why", [(start, goal)], altitudes_m=[60.0], settings=quick, progress=False
      ... )
      >>> {name: len(line.cells) for name, line in result.route.lines.items()}, result.route.path.status.value
      ({'gps': 5}, 'optimal')
    """

    path: PlannedPath
    names: tuple[str, ...]
    weights: np.ndarray
    factors: tuple[float, float]
    features: np.ndarray
    lines: dict[str, WeightLine]
    line_routes: dict[str, list[np.ndarray]]
    ways: pd.DataFrame
    edge_sides: tuple[str, ...] = ()

    @property
    def other_edge_sides(self) -> tuple[str, ...]:
        """Sides on which another way runs along the border of the maps."""
        near = ", ".join(self.ways.edge_sides.dropna())
        return tuple(side for side in SIDES if side in near)

    @typed
    def breakpoints(self, name: str) -> pd.DataFrame:
        """Return the routes along the range of one weight, and their outcomes.

        ``from`` and ``to`` are the values of the weight between which a route is the cheapest; ``is_given`` marks the
        route under the given weights. ``more_cost`` is by which share it costs more than that one under the given
        weights.

        Args:
          name: of a weight that was varied.

        Returns:
          A row per route, numbered from 1 in the order of the weight.

        Raises:
          InputError: the weight was not varied.

        Examples:
          >>> quick = ju.studies.SensitivitySettings(vary=("gps",))
          >>> result = ju.studies.sensitivity(
          ...     maps, "why", [(start, goal)], altitudes_m=[60.0], settings=quick, progress=False
          ... )
          >>> result.route.breakpoints("gps")["is_given"].tolist()
          [True, False, False, False, False]
        """
        line = self.lines[one_of("name", name, self.lines)]

        # Values of the weight at both ends of the line and at the breakpoints between, from the shares of the second
        # corner there. The given weight lies between two of them.
        column = self.names.index(name)
        shares = np.concatenate([[0.0], line.breakpoints, [1.0]])
        values = line.weights_at(np.stack([1 - shares, shares], axis=-1))[:, column]
        given_route = np.searchsorted(values[1:-1], self.weights[column], side="right")
        num_routes = len(line.cells)
        columns = {
            "weight_name": name,
            "from": values[:-1],
            "to": values[1:],
            **outcomes_of(line.integrals, self.names),
            "more_cost": line.features @ self.weights / (self.features @ self.weights) - 1,
            "is_given": np.arange(num_routes) == given_route,
        }
        return pd.DataFrame(columns, pd.RangeIndex(1, num_routes + 1, name="route"))


def one_route(cost_map: CostMap, instance: Row, job: WeightsJob, report: Report) -> OneRoute | None:
    """Return what the weights do to the route of an instance, exactly; None where no path joins its ends.

    Along the range of each weight all breakpoints are found.

    Args:
      cost_map: at the instance's altitude and times.
      instance: its ends and weights.
      job: which weights vary, and how far.
      report: gets the stage and the number of searches so far.

    Raises:
      InputError: an end that is not free, or both in one cell.
    """
    # The query, its route, and the columns of the weights that vary.
    settings = job.settings
    query, weights, _ = query_of(cost_map, instance, job.snap)
    places = [XY(instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal")]
    weighed = cost_map.with_weights(weights_from(query, weights))
    path = weighed.plan(*places, planner="astar", budget_s=np.inf, snap=job.snap)
    if not path.status.has_path:
        return None
    pool = RoutePool([query])
    names = query.names
    columns = varied_columns(names, weights, settings.vary)
    features = pool.cheapest(weights[None])[0, 0, 0]

    # One by one: the routes along a line of weights whose ends [2, K] differ in the one that varies.
    lines = {}
    for name, column in columns.items():
        ends = np.tile(weights, (2, 1))
        ends[:, column] *= settings.factors
        on_plans = partial(report, f"breakpoints of {name}")
        lines[name] = find_breakpoints(pool, ends, on_plans=on_plans)

    report("routes")
    route = OneRoute(
        path=path,
        names=names,
        weights=weights,
        factors=settings.factors,
        features=features,
        lines=lines,
        line_routes={name: _routes(query, line) for name, line in lines.items()},
        ways=pd.DataFrame(),
    )
    sides = sides_at_edge(path.xy_m - cost_map.grid.bounds_m[:2], cost_map.maps)
    return replace(route, ways=_ways(route, cost_map), edge_sides=tuple(sides))


def _routes(query: RouteQuery, line: WeightLine) -> list[np.ndarray]:
    """Return the cheapest route in the middle of each cell of a line, each ``[N, 2]`` easting, northing in metres."""
    southwest_m = query.cost_map.grid.bounds_m[:2]
    with ThreadPoolExecutor() as threads:
        routes = threads.map(query.cheapest, line.weights_at(line.middles))
        return [points_m + southwest_m for points_m in routes]


def _ways(route: OneRoute, cost_map: CostMap) -> pd.DataFrame:
    """Return at which factor each weight sends the drone another way: a row per weight, made less and made more.

    ``first`` is the nearest factor at which the route changes at all. ``factor`` is the nearest one from which on it
    keeps less than `SAME_WAY` of its cells; of the route there, ``overlap`` is this share, ``more_cost`` as in
    `OneRoute.breakpoints`, and ``more_length_m``, ``more_people_below`` and ``more_no_fix_m`` what it costs more than
    the given one (`paid_on`); ``at_edge`` is 1 where it runs along the border of the maps, on ``edge_sides``. NaN where
    there is none.
    """
    southwest_m = cost_map.grid.bounds_m[:2]
    paid = paid_on(cost_map)
    given_m = route.path.xy_m - southwest_m
    own = paid(given_m)
    rows = []
    for name, routes_m in route.line_routes.items():
        others_m = [points_m - southwest_m for points_m in routes_m]
        overlap = [overlap_of(given_m, each, cost_map.grid.resolution_m) for each in others_m]
        table = route.breakpoints(name).reset_index().assign(overlap=overlap)
        weight = route.weights[route.names.index(name)]
        table = table.assign(less=table["to"] / weight, more=table["from"] / weight)
        given = int(np.argmax(table.is_given))
        for side, part in (("less", table[:given][::-1]), ("more", table[given + 1 :])):
            row = {"weight_name": name, "side": side, "first": part[side].head(1).max()}
            away = part.index[part.overlap < SAME_WAY]
            if len(away):
                place = int(away[0])
                other = paid(others_m[place])
                row |= dict(part.loc[place, ["overlap", "more_cost"]])
                row |= {f"more_{each}": other[each] - own[each] for each in own}
                row |= {"factor": part[side][place], "at_edge": other["at_edge"]}
                row["edge_sides"] = ", ".join(sides_at_edge(others_m[place], cost_map.maps))
            rows.append(row)
    return pd.DataFrame(rows).reindex(columns=OF_WAY)
