"""plan_many: thousands of queries over metric maps, none of which is lost once it is done."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, taken_by, typed
from jaxurban.io.tables import fingerprint
from jaxurban.maps.metric_maps import GivenMaps, as_maps
from jaxurban.paths.cost_map import CostMap, map_for
from jaxurban.paths.path import finish
from jaxurban.paths.preset import MapQuery, PathSearch
from jaxurban.paths.queries import BatchResults, PlannedPaths, QueryResult, read_queries
from jaxurban.paths.rows import BAD_INPUT, failure
from jaxurban.paths.snapping import Place, Point
from jaxurban.planners.base import Path
from jaxurban.planners.batch import Backend, solve_many
from jaxurban.progress import LOG, Progress, reporting

HELD_BYTES = 2 * 2**30  # of weighed maps at a time
BYTES_A_CELL = 160  # of a cost map: layers, metrics, landmarks


@partial(typed, makers=(MapQuery.of, PathSearch.of))
def plan_many(
    maps: GivenMaps,
    queries: pd.DataFrame | Sequence[tuple[Point, Point]],
    *,
    altitude_m: float | None = None,
    backend: Backend = "auto",
    strict: bool = False,
    file: str | FilePath | None = None,
    num_threads: int | None = None,
    progress: Progress = True,
    **asked: Any,
) -> PlannedPaths:
    """Return the paths of many queries, in their order.

    A query that cannot be planned (a start in a wall, an altitude beyond the maps') and one whose planner crashes are
    results too, each with its sentence. Ctrl-C returns what is done; searches that run end by their budgets.

    With ``file`` every result goes to a Parquet table, rewritten whole every few seconds, at the end and on the
    way out of any error. The same call again takes from it what is done and plans only the rest; with a larger budget
    also what a smaller one ended.

    Planners that choose their heuristic, as ``astar-plus``, are given it by the whole table of queries (see
    `choose_heuristics`), whatever is done already: resumed or not, on one thread or more, the routes are the same. The
    column ``heuristic`` names it.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps; what is left out is as their
        scenario gives it, as in `plan`.
      queries: pairs of places or a table (see `read_queries`); a table's rows may have altitude, time, time of
        day and weights of their own.
      altitude_m: for queries that say nothing of their own.
      backend: ``"numba"``, ``"jax"`` or ``"auto"`` (see `solve_many`).
      strict: raise the first error or crash instead.
      file: where to keep the results, named ``.parquet``.
      num_threads: of the ``"numba"`` backend.
      progress: as in `jaxurban.progress.reporting`.
      asked: of all queries, as in `plan`: ``weights``, ``time`` and ``time_of_day`` for queries that say nothing of
        their own, ``objective``, ``cost_model``, ``constraints`` and ``preset``, ``planner``, ``heuristic``,
        ``budget_s`` and ``seed`` of each query, and ``snap``; not ``refine``.

    Raises:
      InputError: an argument that is wrong for all queries, a file that holds results of other queries; with
        ``strict`` any query's error too.
    """
    maps = as_maps(maps)
    search = PathSearch.of(maps, **taken_by(PathSearch.of, asked))
    if search.refine:
        raise InputError("refine is of a single plan: leave it out, and refine the paths that matter")
    if file is not None and (FilePath(file).suffix != ".parquet" or not FilePath(file).parent.is_dir()):
        raise InputError(f"file {str(file)!r} must end in .parquet and lie in a folder that exists")
    maps, query = MapQuery.of(maps, **taken_by(MapQuery.of, asked))

    @lru_cache(maxsize=max(1, HELD_BYTES // (BYTES_A_CELL * int(np.prod(maps.grid.shape)))))
    def map_of(altitude_m: float, time: str | None, time_of_day: str | None) -> CostMap:
        return map_for(maps, replace(query, time=time, time_of_day=time_of_day), altitude_m)

    map_of(maps.altitudes_m[0] if altitude_m is None else altitude_m, query.time, query.time_of_day)  # wrong for all
    defaults = {"altitude_m": altitude_m, "metrics": maps.metrics} | taken_by(read_queries, vars(query))
    batch = read_queries(queries, **defaults)
    book = BatchResults(batch, None if file is None else FilePath(file))
    job = _Job(map_of, search, backend, num_threads, strict, book)
    was_interrupted = False
    try:
        with reporting("plan_many", progress) as report:
            for _ in job.run():
                report("queries", len(book.results), len(batch), **book.counts)
    except KeyboardInterrupt:
        was_interrupted = True
        LOG.warning("interrupted: %d of %d queries are done", len(book.results), len(batch))
    finally:
        book.save()
    return book.paths(was_interrupted)


@dataclass(frozen=True, eq=False)
class _Job:
    """The way of a batch: cost maps are made as far as they can be held, their queries located and solved."""

    map_of: Any  # of altitude, time and time of day; which holds as many as there is room for
    search: PathSearch
    backend: Backend
    num_threads: int | None
    strict: bool
    book: BatchResults

    def run(self) -> Iterator[int]:
        """Do the batch; yield each query's number when it has its result."""
        by_map: dict[tuple, list[int]] = {}
        for k, query in enumerate(self.book.queries):
            if query.error:
                yield self._refuse(k, query.error)
            else:
                by_map.setdefault((query.altitude_m, query.time, query.time_of_day, query.weights), []).append(k)
        groups, at_once = list(by_map.values()), self.map_of.cache_info().maxsize
        for first in range(0, len(groups), at_once):
            yield from self._run_groups(groups[first : first + at_once])

    def _run_groups(self, groups: Sequence[list[int]]) -> Iterator[int]:
        located: list[tuple[int, str, CostMap, tuple[Place, Place]]] = []
        waiting: list[int] = []  # by their numbers among those located
        search = self.search
        for group in groups:
            first = self.book.queries[group[0]]
            try:
                shared = self.map_of(first.altitude_m, first.time, first.time_of_day).with_weights(first.weights)
            except InputError as error:
                yield from [self._refuse(k, str(error)) for k in group]
                continue
            digest = self._digest(shared)
            for k in group:
                try:
                    ends = shared.ends(self.book.queries[k].start, self.book.queries[k].goal, snap=search.snap)
                except InputError as error:
                    yield self._refuse(k, str(error))
                    continue
                key = fingerprint(digest, ends)
                located.append((k, key, shared, ends))
                if self.book.take(k, key, search.budget_s, partial(finish, shared, ends=ends, search=search)):
                    yield k
                else:
                    waiting.append(len(located) - 1)
        problems = [shared.problem.between(ends[0].cell, ends[1].cell) for _, _, shared, ends in located]
        outcomes = solve_many(
            problems,
            planner=search.planner,
            heuristic=search.heuristic,
            backend=self.backend,
            budget_s=search.budget_s,
            seed=search.seed,
            num_threads=self.num_threads,
            only=waiting,
        )
        with closing(outcomes):
            for i, outcome in outcomes:
                k, key, shared, ends = located[i]
                if isinstance(outcome, Path):
                    planned = finish(shared, outcome, ends, search)
                    self.book.add(k, QueryResult(planned.status.value, planned.message, planned, key))
                elif self.strict:
                    raise outcome
                else:
                    failed = failure(outcome)
                    self.book.add(k, QueryResult(failed["status"], failed["note"], key=key))
                yield k

    def _refuse(self, k: int, error: str) -> int:
        if self.strict:
            raise InputError(f"query {k}: {error}")
        self.book.add(k, QueryResult(BAD_INPUT, error))
        return k

    def _digest(self, shared: CostMap) -> str:
        """Return what stands for a cost map and the settings of the search, but for its budget."""
        search = (replace(self.search, snap=False, budget_s=np.inf), self.backend)
        settings = (shared.weights, shared.objective, shared.cost_model, shared.leg_margin_m, search)
        return fingerprint(shared.costs, shared.is_free, settings)
