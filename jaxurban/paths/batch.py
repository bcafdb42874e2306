"""plan_many: thousands of queries over metric maps, none of which is lost once it is done."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path as FilePath
from typing import NamedTuple, Unpack

import numpy as np

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.tables import RowStore, fingerprint, number_or_none
from jaxurban.maps.metric_maps import MapsLike, as_maps
from jaxurban.paths.choices import PathChoice, parted
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.finish import finish
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import End
from jaxurban.paths.plan import cost_map
from jaxurban.paths.queries import (
    NOT_RUN,
    PlannedPaths,
    QueriesLike,
    Query,
    path_of,
    read_queries,
    row_of,
)
from jaxurban.paths.rows import BAD_INPUT, failure
from jaxurban.paths.search import PathSearch
from jaxurban.planners.base import Path, Status
from jaxurban.planners.registry import solve_many
from jaxurban.progress import LOG, Progress, Report, reporting

HELD_BYTES = 2 * 2**30  # most memory of the cost maps that are kept at a time
BYTES_A_CELL = 160  # memory of a cost map for each of its cells: layers, metrics, landmarks
ENDED_BY_BUDGET = (Status.BUDGET_EMPTY.value, Status.BUDGET_FEASIBLE.value)
# Columns that every file of results has.
NEEDED = {"query", "status", "message", "key", "budget_s", "search", "x_m", "y_m"}


@typed
def plan_many(
    maps: MapsLike,
    queries: QueriesLike,
    *,
    altitude_m: float | None = None,
    file: str | FilePath | None = None,
    num_threads: int | None = None,
    progress: Progress = True,
    **choice: Unpack[PathChoice],
) -> PlannedPaths:
    """Return the paths of many queries, in their order.

    A query that cannot be planned (a start in a wall, an altitude beyond the maps') and one whose planner crashes are
    results too, each with its sentence. Ctrl-C returns what is done; searches that run end by their budgets.

    With ``file`` every result goes to a Parquet table, rewritten whole every few seconds, at the end and on the
    way out of any error. The same call again takes from it what is done and plans only the rest; with a larger budget
    also what a smaller one ended.

    For planners that choose their heuristic, as ``astar``, the whole table of queries decides it (see
    `choose_heuristics`), whatever is done already. So the routes are the same, resumed or not, on one thread or more.
    The column ``heuristic`` names it.

    Lower bounds are those of the planners: `plan` adds a bound to routes off the grid, which needs one more search and
    may cost more than the query, so that it is left out here.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps; what is left out is as their
        scenario gives it, as in `plan`.
      queries: pairs of places ``((lon, lat), (lon, lat))``, which may be an array ``[N, 2, 2]``, pairs of `XY`, or
        a table (see `read_queries`), whose rows may have altitude, time, time of day and weights of their own.
      altitude_m: flight altitude above ground of queries without an altitude of their own.
      backend: ``"numba"``, ``"jax"`` or ``"auto"`` (see `solve_many`).
      file: where to keep the results, named ``.parquet``.
      num_threads: how many threads the ``"numba"`` backend uses.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).
      weights, time, time_of_day: as in `plan`, for queries without such values of their own.
      objective, cost_model, constraints, preset: which map is planned on, as in `plan`.
      planner, heuristic, budget_s, max_samples, seed, snap, on_ground: of each query, as in `plan`.
      refine, exposure: of a single plan only.

    Returns:
      `PlannedPaths`: a `PlannedPath` for each query, and None where its planner did not run to its end.

    Raises:
      InputError: an argument that is wrong for all queries, or a file that holds results of other queries.

    Examples:
      >>> paths = ju.plan_many(maps, [(start, goal), (goal, start)], altitude_m=60.0, progress=False)
      >>> [path.status.value for path in paths]
      ['optimal', 'optimal']
      >>> paths.to_dataframe()[["query", "status"]].to_numpy().tolist()
      [[0, 'optimal'], [1, 'optimal']]
    """
    maps = as_maps(maps)
    map_choice, search_choice = parted(choice)
    search = PathSearch.of(maps.planning, **search_choice)
    if search.refine or search.exposure:
        raise InputError(
            "refine and exposure are of a single plan: leave them out, and plan the paths that matter"
        )
    if file is not None and not FilePath(file).parent.is_dir():
        raise InputError(
            f"the folder of {str(file)!r} does not exist: make it first, or name another file"
        )

    # The cost map of an altitude, a time and a time of day, which queries share, under the weights of the call. As many
    # are kept as `HELD_BYTES` of memory hold.
    most_maps = max(1, HELD_BYTES // (BYTES_A_CELL * int(np.prod(maps.grid.shape))))
    map_of = lru_cache(maxsize=most_maps)(partial(cost_map, maps, **map_choice))

    # Making the first map refuses what is wrong for all queries.
    first_altitude_m = maps.altitudes_m[0] if altitude_m is None else altitude_m
    time, time_of_day = choice.get("time"), choice.get("time_of_day")
    first_map = map_of(first_altitude_m, time=time, time_of_day=time_of_day)
    batch = read_queries(
        queries,
        altitude_m=altitude_m,
        weights=first_map.weights,
        metrics=maps.metrics,
        time=time,
        time_of_day=time_of_day,
    )

    # The results, with those of an earlier run that the file holds.
    store = None if file is None else RowStore(FilePath(file), ["query"])
    results = _Results(batch, store)
    was_interrupted = False
    try:
        with reporting("plan_many", progress) as report:
            results.report = report
            _plan_batch(results, map_of, most_maps, search, num_threads)
    except KeyboardInterrupt:
        was_interrupted = True
        num_done = sum(results.counts.values())
        LOG.warning("interrupted: %d of %d queries are done", num_done, len(batch))
    finally:
        if store is not None:  # with an earlier run's results that were not asked for yet
            store.save()
    return PlannedPaths(results.rows, results.paths, was_interrupted)


class _Located(NamedTuple):
    """Where a query lies on a cost map.

    Attributes:
      k: number of the query.
      key: digest of all that decides the path of the query but its budget (`row_of`).
      cost_map: the map that the query is planned on.
      ends: its start and its goal on the map.
    """

    k: int
    key: str
    cost_map: CostMap
    ends: tuple[End, End]


class _Results:
    """What became of each query so far, and the file that keeps it, from which a batch that was ended goes on.

    Attributes:
      queries: the queries of the batch.
      rows: a row for each query, as of `row_of`.
      paths: the path of each query; None where its planner did not run to its end.
      counts: how many queries are done, with a path and without one.
      report: gets these counts whenever a query is done.
    """

    def __init__(self, queries: Sequence[Query], store: RowStore | None) -> None:
        """Begin with no query done: each has the row of a query that was not run, and no path.

        Args:
          queries: the queries of the batch.
          store: the file with results of an earlier run, which are taken one by one (`take`); None to keep no file.

        Raises:
          InputError: a row of the file lacks a column, or has a number that is none of these queries'.
        """
        self.queries, self._store = queries, store
        self.report = Report()
        message = "The batch ended before this query was done."
        self.rows = [row_of(k, query, NOT_RUN, message) for k, query in enumerate(queries)]
        self.paths: list[PlannedPath | None] = [None] * len(queries)
        self.counts = {"paths": 0, "none": 0}
        if store is None:
            return
        if not all(row.keys() >= NEEDED and row["query"] < len(queries) for row in store.rows):
            raise InputError(
                f"{str(store.file)!r} holds no results of these queries: name another file, or remove it"
            )

    def add(
        self, k: int, status: str, message: str, path: PlannedPath | None = None, key: str = ""
    ) -> None:
        """Note a result, keep it in the file if there is one, and report the progress.

        Args:
          k: number of the query.
          status, message, path, key: as of `row_of`; ``path`` is None if the planner did not run to its end.
        """
        self.rows[k] = row_of(k, self.queries[k], status, message, path, key)
        self.paths[k] = path
        outcome = "paths" if path is not None and path.status.has_path else "none"
        self.counts[outcome] += 1
        if self._store is not None:
            self._store.add([self.rows[k]])
        self.report("queries", sum(self.counts.values()), len(self.queries), **self.counts)

    def refuse(self, k: int, error: InputError | str) -> None:
        """Note that a query cannot be planned.

        Args:
          k: number of the query.
          error: why.
        """
        self.add(k, BAD_INPUT, str(error))

    def take(self, located: _Located, search: PathSearch) -> bool:
        """Note the result of a query that the file holds, and return whether it holds one.

        A result does not count if a smaller budget ended its search. Nor does an error of input, which is found again
        at no cost.

        Args:
          located: the query.
          search: how its path would be searched for now.

        Raises:
          InputError: the file's result is of another query.
        """
        if self._store is None:
            return False
        k, key, cost_map, ends = located
        row = self._store.get(k)
        if row is None or row["status"] == BAD_INPUT:
            return False
        if row["key"] != key:
            raise InputError(
                f"{str(self._store.file)!r} holds results of other queries (query {k} differs in its place, map, "
                "weights or planner): name another file, or remove it"
            )
        if row["status"] in ENDED_BY_BUDGET and row["budget_s"] < search.budget_s:
            return False

        # The row has a path if the planner ran to its end; its settings say under which budget.
        path = None
        if row["search"] is not None:
            path = finish(cost_map, path_of(row), ends, search)
            settings = {**path.settings, "budget_s": number_or_none(row["budget_s"])}
            path = replace(path, settings=settings)
        self.add(k, row["status"], row["message"], path, key)
        return True


def _plan_batch(
    results: _Results,
    map_of: Callable[..., CostMap],
    most_maps: int,
    search: PathSearch,
    num_threads: int | None,
) -> None:
    """Plan the queries of a batch and add what becomes of each to the results.

    Queries on one cost map are planned together, so the order is not that of the batch.

    Args:
      results: hold the queries.
      map_of: returns the cost map of an altitude, a ``time`` and a ``time_of_day``.
      most_maps: on how many cost maps queries are planned before further maps are made.
      search: how each path is searched for.
      num_threads: as of `plan_many`.

    Raises:
      InputError: the file holds results of other queries.
    """
    # The numbers of the queries that share a cost map and weights.
    by_map: dict[tuple, list[int]] = {}
    for k, asked in enumerate(results.queries):
        if asked.error:
            results.refuse(k, asked.error)
        else:
            map_key = asked.altitude_m, asked.time, asked.time_of_day, asked.weights
            by_map.setdefault(map_key, []).append(k)

    groups = list(by_map.values())
    for first in range(0, len(groups), most_maps):
        # Where the queries of these maps lie. What the file holds of them is done.
        located: list[_Located] = []
        problems = []
        unsolved = []  # indices in both
        for numbers in groups[first : first + most_maps]:
            for query in _locate(results, numbers, map_of, search):
                start, goal = query.ends
                problems.append(query.cost_map.problem.between(start.cell, goal.cell))
                if not results.take(query, search):
                    unsolved.append(len(located))
                located.append(query)

        # The rest is solved. The problems that are solved already are given too, as all of them together decide which
        # heuristic is chosen.
        outcomes = solve_many(
            problems,
            planner=search.planner,
            heuristic=search.heuristic,
            backend=search.backend,
            num_threads=num_threads,
            only=unsolved,
            **search.limits,
        )
        with closing(outcomes):
            for index, outcome in outcomes:
                k, key, cost_map, ends = located[index]
                if isinstance(outcome, Path):
                    planned = finish(cost_map, outcome, ends, search)
                    results.add(k, planned.status.value, planned.message, planned, key)
                else:  # the planner crashed
                    failed = failure(outcome)
                    results.add(k, failed["status"], failed["note"], key=key)


def _locate(
    results: _Results,
    numbers: Sequence[int],
    map_of: Callable[..., CostMap],
    search: PathSearch,
) -> Iterator[_Located]:
    """Yield where queries lie on the cost map that they share; those that cannot be planned on it are refused.

    Args:
      results: hold the queries, and take the refusals.
      numbers: of the queries; one or more, of one altitude, one time, one time of day and one set of weights.
      map_of, search: as of `_plan_batch`.
    """
    queries = results.queries
    shared = queries[numbers[0]]
    try:
        cost_map = map_of(shared.altitude_m, time=shared.time, time_of_day=shared.time_of_day)
        cost_map = cost_map.with_weights(shared.weights)
    except InputError as error:
        for k in numbers:
            results.refuse(k, error)
        return
    digest = _digest(cost_map, search)
    for k in numbers:
        try:
            start, goal = queries[k].start, queries[k].goal
            ends = cost_map.free_space.ends(
                start, goal, snap=search.snap, on_ground=search.on_ground
            )
        except InputError as error:
            results.refuse(k, error)
        else:
            yield _Located(k, fingerprint(digest, ends), cost_map, ends)


def _digest(cost_map: CostMap, search: PathSearch) -> str:
    """Return a digest of all that decides a path except for its ends and its budget: the map and the search's settings.

    Args:
      cost_map: the map.
      search: the settings. Snapping changes a path only by its ends, so neither snapping nor the budget counts here.
    """
    search = replace(search, snap=False, budget_s=np.inf)
    settings = (
        cost_map.weights,
        cost_map.objective,
        cost_map.cost_model,
        cost_map.leg_margin_m,
        search,
    )
    return fingerprint(cost_map.costs, cost_map.is_free, settings)
