"""plan_many: thousands of queries over metric maps, none of which is lost once it is done."""

import hashlib
import inspect
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from jaxurban.answers import BAD_INPUT, CRASHED, NOT_RUN, Answer, AnswerBook, PlannedPaths
from jaxurban.cost import Weights
from jaxurban.errors import InputError, nearest_name
from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import Path
from jaxurban.planners.batch import Backend, solve_many
from jaxurban.planners.registry import check_seed, find_planner
from jaxurban.queries import Point, Query, read_queries
from jaxurban.snapping import Place, snap_limit_m
from jaxurban.weighted import WeightedMap, weigh

HELD_BYTES = 2 * 2**30  # of weighed maps at a time
BYTES_A_CELL = 160  # of a weighed map: layers, metrics, landmarks
OPTIONS = tuple(inspect.signature(weigh).parameters)  # of a map, beside those of the batch


def plan_many(
    maps: MetricMaps,
    queries: pd.DataFrame | Sequence[tuple[Point, Point]],
    *,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    weights: Weights | None = None,
    planner: str = "astar-plus",
    heuristic: str | None = None,
    backend: Backend = "auto",
    budget_s: float = 180.0,
    seed: int = 0,
    snap: bool | float = False,
    strict: bool = False,
    file: str | FilePath | None = None,
    num_threads: int | None = None,
    progress: bool = True,
    **map_options: Any,
) -> PlannedPaths:
    """Return the paths of many queries, in their order; a progress bar runs on stderr where that is a terminal.

    A query that cannot be asked (a start in a wall, an altitude without maps) and one whose planner crashes are
    answers too, each with its sentence. Ctrl-C returns what is done; searches that run end by their budgets.

    With ``file`` every answer goes to a Parquet table, rewritten whole every few seconds, at the end and on the
    way out of any error. The same call again takes from it what is done and asks only the rest.

    Args:
      maps: from `build_maps` or `open_maps`.
      queries: pairs of places or a table (see `read_queries`); a table's rows may have altitude, time, time of
        day and weights of their own.
      altitude_m, time, time_of_day, weights: for queries that say nothing of their own.
      planner, heuristic: as in `plan`.
      backend: ``"numba"``, ``"jax"`` or ``"auto"`` (see `solve_many`).
      budget_s: seconds for each query.
      seed: for sampling planners, the same for each query.
      snap: move starts and goals out of obstacles, by at most 50 m, or so many metres.
      strict: raise the first fault or crash instead.
      file: where to keep the answers, named ``.parquet``.
      num_threads: of the ``"numba"`` backend.
      progress: show the bar.
      map_options: ``objective``, ``cost_model``, ``limits`` of `weigh`, for all queries.

    Raises:
      InputError: an argument that is wrong for all queries, a file that holds answers to other questions; with
        ``strict`` any query's fault too.
    """
    find_planner(planner, heuristic)
    check_seed(seed)
    if file is not None and (FilePath(file).suffix != ".parquet" or not FilePath(file).parent.is_dir()):
        raise InputError(f"file {str(file)!r} must end in .parquet and lie in a folder that exists")
    if unknown := set(map_options) - set(OPTIONS):
        raise InputError(f"plan_many has no option {min(unknown)!r}{nearest_name(min(unknown), OPTIONS)}")
    snap_limit_m(snap)  # a wrong one is told once, not with every query
    asked = read_queries(queries, altitude_m=altitude_m, time=time, time_of_day=time_of_day, weights=weights)
    search = {"planner": planner, "heuristic": heuristic, "backend": backend, "budget_s": budget_s, "seed": seed}
    book = AnswerBook(asked, None if file is None else FilePath(file))
    job = _Job(maps, asked, search, num_threads, snap, strict, map_options, book)
    was_interrupted = False
    bar = tqdm(total=len(asked), desc="queries", unit="query", file=sys.stderr, disable=None if progress else True)
    try:
        for _ in job.run():
            bar.update(book.num_done - bar.n)
            bar.set_postfix(book.counts, refresh=False)
    except KeyboardInterrupt:
        was_interrupted = True
        tqdm.write(f"interrupted: {book.num_done} of {len(asked)} queries are done", file=sys.stderr)
    finally:
        bar.close()
        book.save()
    not_run = Answer(NOT_RUN, "The batch ended before this query was done.")
    return PlannedPaths(asked, [book.answers.get(k, not_run) for k in range(len(asked))], was_interrupted)


class _Job:
    """The way of a batch: maps are weighed as far as they can be held, their queries located and solved."""

    def __init__(
        self,
        maps: MetricMaps,
        asked: list[Query],
        search: dict[str, Any],
        num_threads: int | None,
        snap: bool | float,
        strict: bool,
        map_options: dict[str, Any],
        book: AnswerBook,
    ) -> None:
        self.maps, self.asked, self.search, self.num_threads = maps, asked, search, num_threads
        self.snap, self.strict, self.map_options, self.book = snap, strict, map_options, book

    def run(self) -> Iterator[int]:
        """Do the batch; yield each query's number when it is answered."""
        by_map: dict[tuple, list[int]] = {}
        for k, query in enumerate(self.asked):
            if query.fault:
                yield self._refuse(k, query.fault)
            else:
                by_map.setdefault((query.altitude_m, query.time, query.time_of_day, query.weights), []).append(k)
        maps_at_once = max(1, HELD_BYTES // (BYTES_A_CELL * int(np.prod(self.maps.grid.shape))))
        groups = list(by_map.values())
        for first in range(0, len(groups), maps_at_once):
            yield from self._run_groups(groups[first : first + maps_at_once])

    def _run_groups(self, groups: Sequence[list[int]]) -> Iterator[int]:
        waiting: list[tuple[int, str, WeightedMap, tuple[Place, Place]]] = []
        for group in groups:
            weighted, fault = self._weigh(self.asked[group[0]])
            if weighted is None:
                yield from [self._refuse(k, fault) for k in group]
                continue
            digest = self._digest(weighted)
            for k in group:
                query = self.asked[k]
                try:
                    ends = (
                        weighted.locate("start", query.start, query.start_xy_m, snap=self.snap),
                        weighted.locate("goal", query.goal, query.goal_xy_m, snap=self.snap),
                    )
                except InputError as error:
                    yield self._refuse(k, str(error))
                    continue
                key = hashlib.sha256(f"{digest} {ends}".encode()).hexdigest()[:16]
                kept = self.book.take(k, key, partial(self._finish, weighted, ends))
                if kept:
                    yield k
                else:
                    waiting.append((k, key, weighted, ends))
        problems = [weighted.problem.between(ends[0].cell, ends[1].cell) for _, _, weighted, ends in waiting]
        with closing(solve_many(problems, num_threads=self.num_threads, **self.search)) as outcomes:
            for i, outcome in outcomes:
                k, key, weighted, ends = waiting[i]
                if isinstance(outcome, Path):
                    planned = self._finish(weighted, ends, outcome)
                    self.book.add(k, Answer(planned.status.value, planned.to_dict()["message"], planned, key))
                elif self.strict:
                    raise outcome
                elif isinstance(outcome, InputError):
                    self.book.add(k, Answer(BAD_INPUT, str(outcome), key=key))
                else:
                    self.book.add(k, Answer(CRASHED, f"{type(outcome).__name__}: {outcome}", key=key))
                yield k

    def _weigh(self, query: Query) -> tuple[WeightedMap | None, str]:
        """Return the map of a query and those like it, or why there is none. Wrong settings of the batch are raised."""
        try:
            self.maps.is_free(query.altitude_m)
            self.maps.costs(query.altitude_m, time=query.time, time_of_day=query.time_of_day)
        except InputError as error:
            return None, str(error)
        weighted = weigh(
            self.maps,
            query.altitude_m,
            weights=query.weights,
            time=query.time,
            time_of_day=query.time_of_day,
            **self.map_options,
        )
        return weighted, ""

    def _finish(self, weighted: WeightedMap, ends: tuple[Place, Place], found: Path) -> PlannedPath:
        return weighted.finish(found, ends, budget_s=self.search["budget_s"], seed=self.search["seed"])

    def _refuse(self, k: int, fault: str) -> int:
        if self.strict:
            raise InputError(f"query {k}: {fault}")
        self.book.add(k, Answer(BAD_INPUT, fault))
        return k

    def _digest(self, weighted: WeightedMap) -> str:
        """Return what stands for a weighed map and the settings of the search."""
        digest = hashlib.sha256()
        for array in (weighted.layers, weighted.is_free):
            digest.update(np.ascontiguousarray(array).data)
        digest.update(repr((weighted.weights, weighted.objective, weighted.cost_model, self.search)).encode())
        return digest.hexdigest()
