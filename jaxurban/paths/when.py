"""when: the same routes planned at every time that maps hold, and the one at which they cost the least together."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from typing import Unpack

import numpy as np
import pandas as pd

from jaxurban.checks import typed
from jaxurban.errors import InputError, in_words
from jaxurban.kernels.tolerances import SAME_ROUTE_COST
from jaxurban.knowledge import Caution
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.maps.shared import population_norms
from jaxurban.metrics.gps import FIX
from jaxurban.paths.batch import plan_many
from jaxurban.paths.choices import PathChoice, parted
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import cost_map
from jaxurban.paths.profile import (
    SWATH_M,
    cut_on,
    guess_cautions,
    people_below,
    profile_of,
    without_fix,
)
from jaxurban.paths.queries import PlannedPaths, QueriesLike, table_of
from jaxurban.paths.route_report import DENSITY
from jaxurban.progress import Progress
from jaxurban.public import FactsRepr, listed
from jaxurban.settings import parse_time

TIMES = ["time", "time_of_day"]
PEOPLE = "people_overflown"
DAY, NIGHT = "day", "night"
DAY_H = 7, 19  # from and to, in local solar time
OWN_DAY = ", each with the people of its own day (7 to 19 h of local solar time) or night"


@dataclass(frozen=True, eq=False, repr=False)
class Departures(FactsRepr):
    """Routes at every time of their maps, and the time at which all of them together cost the least.

    Attributes:
      table: a row per time: ``time`` (UTC) and ``time_of_day``; summed over the routes ``cost``, ``length_m``,
        ``no_fix_m`` (length without a position fix) and ``people_overflown``, both as of `explain`, and
        ``exposure_*``, NaN where one of them has no path; ``longest_no_fix_m``, the longest stretch without a fix on
        any of them; ``above_best``, the share by which the cost exceeds the least one; ``kept_above``, by which share a
        route of the best time costs more now than this time's own, at most (inf where it is closed), and
        ``num_changed``, how many routes that is so of. Queries that have a path at no time are in no sum. What the maps
        do not hold is left out.
      routes: a row per time and route, as of `PlannedPaths.to_dataframe`, with the same of each: ``departure`` is the
        row of ``table``, ``query`` the number of the route.
      paths: of the rows of ``routes``.

    Examples:
      >>> departures = ju.when(maps, [(start, goal)], altitude_m=60.0, progress=False)
      >>> departures.facts["best"]
      '2020-04-27T16:00:00Z, day, cost 283.30'
      >>> departures.best, len(departures.table), len(departures.paths)
      (0, 2, 2)
    """

    table: pd.DataFrame
    routes: pd.DataFrame
    paths: PlannedPaths

    @property
    def best(self) -> int | None:
        """The number of the first row of ``table`` with the least cost.

        None where at no time all routes have a path.
        """
        is_best = self.table["above_best"] == 0
        return int(is_best.to_numpy().argmax()) if is_best.any() else None

    @property
    def cautions(self) -> list[Caution]:
        """What a pilot should know of the routes at the best time (`jaxurban.cautions`).

        Of several routes, what the maps guess, and what of each route is beyond limits. Without a best time, what the
        maps guess.
        """
        first_path = next(filter(None, self.paths))  # all are planned on the same maps
        cautions = guess_cautions(first_path.maps)
        if self.best is None:
            return cautions
        rows = self.routes.index[self.routes["departure"] == self.best]
        best_paths = [self.paths[row] for row in rows]
        if len(best_paths) == 1:
            return best_paths[0].cautions
        for number, path in enumerate(best_paths):
            path_cautions = [] if path is None else path.cautions
            limits = [caution for caution in path_cautions if caution.level == "limit"]
            cautions += [Caution(f"Route {number}: {limit}", "limit") for limit in limits]
        return cautions

    @property
    def facts(self) -> dict[str, str]:
        """The best and the worst time, how small the effect is, and which routes have no path at some time."""
        table = self.table
        facts = {"times": f"{len(table)}"}
        maps = next(filter(None, self.paths)).maps
        if maps is not None and [*table["time_of_day"]] == _days_and_nights(table["time"], maps):
            facts["times"] += OWN_DAY

        # The effect, where at some time all routes have a path.
        if self.best is not None:
            best = table.iloc[self.best]
            worst = table.iloc[table["cost"].argmax()]
            num_best = (table["above_best"] == 0).sum()
            shared = f", the same at {num_best} of {len(table)} times" if num_best > 1 else ""
            has_changed = self.routes.groupby("query")["num_changed"].any()
            most_kept = table["kept_above"].max()
            facts["best"] = f"{_time_of(best)}, cost {best['cost']:,.2f}{shared}"
            facts["worst"] = f"{_time_of(worst)}, {worst['above_best']:.2%} above the best"
            facts["routes that change"] = f"{has_changed.sum()} of {len(has_changed)}"
            facts["keeping those of the best"] = f"up to {most_kept:.2%} more at another time"
            if PEOPLE in table:
                facts["people overflown"] = self._people_said

        # Routes without a path at some of the times, with the message of the first.
        missing = self.routes[self.routes["cost"].isna()]
        num_times = missing.groupby("query").size()
        without_path = listed([f"route {query} at {num}" for query, num in num_times.items()])
        if without_path:
            without_path += f" ({missing['message'].iloc[0]})"
        return facts | {"times without a path": without_path}

    @property
    def _people_said(self) -> str:
        """The fewest and the most people overflown, and whether the costs of times of day compare them."""
        ordered = self.table.sort_values(PEOPLE)
        few, most = ordered.iloc[0], ordered.iloc[-1]
        said = f"{few[PEOPLE]:,.0f} at {_time_of(few)} to {most[PEOPLE]:,.0f} at {_time_of(most)}"
        maps = next(filter(None, self.paths)).maps
        if maps is not None and len({*population_norms(maps).values()}) > 1:
            said += (
                "; costs do not compare them, as people count relative to the densest place of each time of day: make "
                f"maps with one number of people per km2 for all, {in_words('[population] normalise')}"
            )
        return said


def _time_of(row: pd.Series) -> str:
    """Return the time and the time of day of a row of `Departures` as a text; one that the maps lack is left out."""
    return ", ".join(filter(None, row[TIMES]))


@typed
def when(
    maps: MapsLike,
    queries: QueriesLike,
    *,
    altitude_m: float | None = None,
    progress: Progress = True,
    **choice: Unpack[PathChoice],
) -> Departures:
    """Plan each route at every time that maps hold (`plan_many`), and return what the routes cost and lead over.

    Of several times of the GPS maps each is taken with the people of its own day or night: day is from 7 to 19 hours of
    local solar time, UTC and an hour for every 15 degrees of longitude. One time alone is taken with both, and with
    every hour of the week each time is. Where ``time`` or ``time_of_day`` is given, that one alone is taken.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      queries: pairs ``((lon, lat), (lon, lat))`` in degrees, one or many, or a table as `plan_many` takes it.
      altitude_m: flight altitude above ground of queries without an altitude of their own.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).
      weights, objective, cost_model, time, time_of_day, constraints, preset: which map, as in `plan`.
      planner, heuristic, backend, budget_s, max_samples, seed, snap, on_ground: of each query, as in `plan_many`.
      refine, exposure: of a single plan only.

    Returns:
      `Departures`: a table of the times, one of the routes at each time, and their paths.

    Raises:
      InputError: the maps hold one time alone, a query has a time of its own, or no query can be planned at any time.

    Examples:
      >>> departures = ju.when(maps, [(start, goal), (goal, start)], altitude_m=60.0, progress=False)
      >>> departures.table[["time_of_day", "num_changed"]].to_numpy().tolist()
      [['day', 0], ['night', 2]]
      >>> [round(share, 3) for share in departures.table["above_best"].tolist()]
      [0.0, 0.088]
    """
    # The times, and the queries.
    maps = as_maps(maps)
    table = _times_held(maps, choice.get("time"), choice.get("time_of_day"))
    query_table = queries if isinstance(queries, pd.DataFrame) else table_of(queries)
    num_queries = len(query_table)
    if not num_queries or {*TIMES} & {*query_table}:
        raise InputError(
            "queries must be one or more and have no times of their own: drop time and time_of_day"
        )

    # Every query at every time: the queries of the first time come first.
    paths = plan_many(
        maps,
        table.merge(query_table, how="cross"),
        altitude_m=altitude_m,
        progress=progress,
        **choice,
    )
    if paths.was_interrupted:
        raise KeyboardInterrupt
    if all(path is None for path in paths):
        raise InputError(paths.rows[0]["message"])

    # A row for each route at each time. `plan_many` numbers them all in order; here the number is parted into that of
    # the time and that of the query.
    routes = paths.to_dataframe().astype({"cost": float, "length_m": float})
    routes["departure"], routes["query"] = np.divmod(routes["query"], num_queries)
    routes = routes.join(pd.DataFrame(list(map(_along, paths))))
    table = _with_sums(table, routes)

    # What the routes of the best time would cost at each time. Where no time has a path for all routes, the first time
    # stands for the best. The routes of one time follow each other and share a map, so that one map is kept.
    best = Departures(table, routes, paths).best or 0
    kept_paths = [paths[best * num_queries + query] for query in routes["query"]]
    map_of = partial(cost_map, maps, **parted(choice)[0])
    times = table.loc[routes["departure"]]
    kept_costs = np.array(_costs_at(kept_paths, times, lru_cache(maxsize=1)(map_of)))

    # By how much the kept routes cost more than those of each time, and how many of these are other routes.
    kept_above = kept_costs / routes["cost"] - 1
    routes["kept_above"] = kept_above.mask(kept_costs <= routes["cost"], 0.0)
    routes["num_changed"] = routes["kept_above"] > SAME_ROUTE_COST

    by_time = routes.groupby("departure")
    table = table.join(by_time[[*routes.filter(like="longest_"), "kept_above"]].max())
    return Departures(table.join(by_time["num_changed"].sum()), routes, paths)


def _times_held(maps: MetricMaps, time: str | None, time_of_day: str | None) -> pd.DataFrame:
    """Return a table with the columns `TIMES`: a row for every time of maps with every time of day that it may be.

    Args:
      maps: the maps; where they hold no times, or no times of day, the column holds None.
      time, time_of_day: the only time, or time of day, that is taken; None for all.

    Raises:
      InputError: there is one row alone.
    """
    times = maps.times if maps.default_time and time is None else (time,)
    times_of_day = (
        maps.times_of_day if maps.times_of_day and time_of_day is None else (time_of_day,)
    )
    table = pd.DataFrame(product(times, times_of_day), columns=TIMES)
    if len(times) > 1 and {DAY, NIGHT} <= {*times_of_day}:
        is_own = table["time_of_day"] == _days_and_nights(table["time"], maps)
        is_own |= ~table["time_of_day"].isin([DAY, NIGHT])  # an hour of the week
        table = table[is_own].reset_index(drop=True)
    if len(table) == 1:
        raise InputError(
            "there is one time alone to fly at: make maps of several, as with gps=Gps(times=(FIRST, LAST), "
            'step_s=3600, series="epochs"), and leave time or time_of_day out'
        )
    return table


def _days_and_nights(times: Iterable[str | None], maps: MetricMaps) -> list[str]:
    """Return whether it is day or night (`DAY_H`) in the middle of maps, at each UTC time that there is."""
    moments = [parse_time(time) for time in filter(None, times)]
    hours = np.array([moment.hour + moment.minute / 60 for moment in moments])
    solar_h = (hours + maps.grid.centre_lonlat[0] / 15) % 24
    return np.where((solar_h >= DAY_H[0]) & (solar_h < DAY_H[1]), DAY, NIGHT).tolist()


def _with_sums(table: pd.DataFrame, routes: pd.DataFrame) -> pd.DataFrame:
    """Return a table of times with the sums over all routes at each time, and the share above the least cost.

    A sum is NaN at a time at which one of the routes has no path. Routes that have a path at no time are in no sum.

    Args:
      table: a row for each time.
      routes: a row for each time and route: ``departure`` is the number of the time's row in ``table``, ``query`` the
        number of the route.

    Returns:
      The rows of ``table``, with a column for each sum, and ``above_best``: cost / least cost - 1, which is 0 where the
      costs are the same but for rounding.
    """
    # The sums. A group with fewer values than there are routes sums to NaN (`min_count`).
    summed = list(routes.filter(regex=f"^(cost|length_m|no_fix_m|{PEOPLE}|exposure_.+)$"))
    has_path_at_times = routes.groupby("query")["cost"].transform("count") > 0
    flown = routes[has_path_at_times]
    num_flown = flown["query"].nunique()
    table = table.join(flown.groupby("departure")[summed].sum(min_count=num_flown))

    cost = table["cost"]
    least = cost.min()
    above_best = (cost / least - 1).mask(cost <= least * (1 + SAME_ROUTE_COST), 0.0)
    table.insert(3, "above_best", above_best)  # behind time, time_of_day and cost
    return table


def _costs_at(
    paths: Sequence[PlannedPath | None], times: pd.DataFrame, map_of: Callable[..., CostMap]
) -> list[float]:
    """Return what paths cost at other times: inf for a path that is closed then, NaN where there is no path.

    Args:
      paths: ``N`` planned paths.
      times: ``N`` rows with the columns `TIMES`: when each path is flown.
      map_of: returns the cost map of an altitude, a ``time`` and a ``time_of_day``.
    """
    costs = []
    for path, time, time_of_day in zip(paths, times["time"], times["time_of_day"], strict=True):
        cost = np.nan
        if path is not None and path.status.has_path:
            cost_map = map_of(path.altitude_m, time=time, time_of_day=time_of_day)
            cost_map = cost_map.with_weights(path.settings["weights"])
            features = cost_map.shortest.features(path.search.points_m)
            cost = features.cost(cost_map.weight_vector)
        costs.append(cost)
    return costs


def _along(path: PlannedPath | None) -> dict[str, float]:
    """Return measures of a route by column: exposure to each layer, people, and metres without a fix.

    There are none without a path. What the maps do not hold is left out.
    """
    if path is None or path.maps is None or not path.status.has_path:
        return {}
    measures = {f"exposure_{name}": value for name, value in path.exposure_by_layer.items()}
    _, parts = cut_on(path, path.maps)
    profile = profile_of(parts, path.maps, {FIX: FIX, "density": DENSITY}, path.settings)
    if DENSITY in profile:
        measures[PEOPLE] = people_below(profile[DENSITY], parts, SWATH_M).sum()
    if FIX in profile:
        lengths_m = [to_m - from_m for from_m, to_m in without_fix(profile)]
        measures["no_fix_m"] = sum(lengths_m, 0.0)
        measures["longest_no_fix_m"] = max(lengths_m, default=0.0)
    return measures
