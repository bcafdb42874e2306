"""PlannedPaths: the results of a batch of queries, and the file that keeps them."""

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, typed
from jaxurban.io.rows import RowStore
from jaxurban.io.tables import SUFFIXES, write_table
from jaxurban.paths.export.write import FORMATS, write_path
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.queries import Query
from jaxurban.planners.base import Path, Status
from jaxurban.world.show import Shown

BAD_INPUT, CRASHED, NOT_RUN = "bad-input", "crashed", "not-run"  # beside the names of `Status`
ENDED_BY_BUDGET = (Status.BUDGET_EMPTY.value, Status.BUDGET_FEASIBLE.value)
NEEDED = {"query", "status", "message", "key", "budget_s", "search", "x_m", "y_m"}  # of a file of results


@dataclass(frozen=True, eq=False)
class QueryResult:
    """What became of one query.

    Attributes:
      status: the name of a `Status`, or `BAD_INPUT`, `CRASHED` or `NOT_RUN`.
      message: what happened, in a sentence or two.
      path: what the planner gave; None where it did not run to its end.
      key: stands for the query: map, weights, places, planner and settings.
    """

    status: str
    message: str
    path: PlannedPath | None = None
    key: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class PlannedPaths(Shown, Sequence[PlannedPath | None]):
    """The paths of a batch in the order of its queries; None where there is not even a planner's verdict.

    Attributes:
      queries: of the batch.
      results: what became of each.
      was_interrupted: whether Ctrl-C ended the batch before its end.
    """

    queries: Sequence[Query]
    results: Sequence[QueryResult]
    was_interrupted: bool = False

    def __len__(self) -> int:
        return len(self.results)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [result.path for result in self.results[index]]
        return self.results[index].path

    @property
    def facts(self) -> dict[str, str]:
        """How many queries ended how, and what the paths cost and measure together."""
        ends = Counter(result.status for result in self.results)
        found = [path for path in self if path is not None and path.status.has_path]
        heuristics = Counter(path.search.heuristic for path in self if path is not None)
        return {
            "queries": f"{len(self):,}" + (" (interrupted)" if self.was_interrupted else ""),
            "statuses": ", ".join(f"{status} {number:,}" for status, number in ends.most_common()) or "none",
            "heuristics": ", ".join(f"{name} {number:,}" for name, number in heuristics.most_common()) or "none",
            "cost": f"{sum(path.cost for path in found):,.2f} of {len(found):,} paths",
            "length": f"{sum(path.length_m for path in found) / 1000:,.1f} km",
        }

    @typed
    def save(self, file: str | FilePath) -> FilePath:
        """Write the batch and return the file, by its suffix a table or the paths themselves.

        ``.parquet`` and ``.csv`` hold `to_dataframe`; ``.geojson`` and ``.kml`` a line for each path that was found,
        whose name is the query's number.

        Raises:
          InputError: another suffix, no path at all, or a folder that does not exist or cannot be written to.
        """
        file = FilePath(file)
        if file.suffix.lower() in SUFFIXES:
            return write_table(self.to_dataframe(), file)
        if file.suffix.lower() not in FORMATS:
            known = ", ".join((*SUFFIXES, *FORMATS))
            raise InputError(f"cannot tell the format of {str(file)!r}: end its name in one of {known}")
        if not write_path(self, file, names=[f"query {k}" for k in range(len(self))]):
            raise InputError("there is no path to save: to_dataframe tells what became of each query")
        return file

    @typed
    def to_dataframe(self, *, with_points: bool = False) -> pd.DataFrame:
        """Return a table with one row a query: the query, status and message, costs, metrics, search.

        Args:
          with_points: also the columns ``x_m`` and ``y_m``, the path's eastings and northings as lists, and
            ``search``, the rest of what the planner reported, as JSON.
        """
        rows = [_row(k, *pair) for k, pair in enumerate(zip(self.queries, self.results, strict=True))]
        table = pd.DataFrame(rows, columns=list(dict.fromkeys(name for row in rows for name in row)))
        return table if with_points else table.drop(columns=["x_m", "y_m", "search", "key"], errors="ignore")


class BatchResults:
    """The results so far, and their file, from which a batch that was ended goes on."""

    def __init__(self, queries: list[Query], file: FilePath | None) -> None:
        self.queries = queries
        self.results: dict[int, QueryResult] = {}
        self.counts = {"paths": 0, "none": 0}
        self._store = None if file is None else RowStore(file, ["query"])
        for row in () if self._store is None else self._store.rows:
            if not row.keys() >= NEEDED or row["query"] >= len(queries):
                raise InputError(f"{str(file)!r} holds no results of these queries: name another file, or remove it")

    def add(self, k: int, result: QueryResult) -> None:
        """Note a result, and keep it in the file."""
        self.results[k] = result
        has_path = result.path is not None and result.path.status.has_path
        self.counts["paths" if has_path else "none"] += 1
        if self._store is not None:
            self._store.add([_row(k, self.queries[k], result)])

    def take(self, k: int, key: str, budget_s: float, finish: Callable[[Path], PlannedPath]) -> bool:
        """Return whether the file holds the result of a query, and note it; not one that a smaller budget ended."""
        row = None if self._store is None else self._store.get(k)
        if self._store is None or row is None or row["status"] == BAD_INPUT:
            return False
        if row["key"] == key and row["status"] in ENDED_BY_BUDGET and row["budget_s"] < budget_s:
            return False
        if row["key"] != key:
            raise InputError(
                f"{str(self._store.file)!r} holds results of other queries (query {k} differs in its place, map, "
                "weights or planner): name another file, or remove it"
            )
        path = None if row["search"] is None else finish(_path_of(row))
        if path is not None:
            kept_s = row["budget_s"] if np.isfinite(row["budget_s"]) else None
            path = replace(path, settings={**path.settings, "budget_s": kept_s})
        self.add(k, QueryResult(row["status"], row["message"], path, key))
        return True

    def save(self) -> None:
        """Write what is known, with what an earlier run knew and this one has not come to yet."""
        if self._store is not None:
            self._store.save()


def _row(k: int, query: Query, result: QueryResult) -> dict[str, Any]:
    """Return a result as a flat row."""
    row: dict[str, Any] = {"query": k, **query.to_dict(), "status": result.status, "message": result.message}
    planned = result.path
    points: dict[str, Any] = {"budget_s": None, "x_m": None, "y_m": None, "search": None}
    if planned is not None:
        facts = planned.to_dict()
        row |= {name: facts[name] for name in ("cost", "length_m")}
        row |= {f"cost_{name}": value for name, value in facts["cost_by_layer"].items()}
        row |= {f"m_{name}": value for name, value in facts["metrics"].items()}
        names = ("objective_cost", "lower_bound", "num_points", "num_expanded", "elapsed_s", "setup_s")
        row |= {name: facts[name] for name in (*names, "planner", "heuristic", "backend")}
        row |= {f"{name}_snap_m": value for name, value in facts["snap_distance_m"].items()}
        rest = {item.name: getattr(planned.search, item.name) for item in fields(Path)}
        rest |= {"status": rest["status"].value, "points_m": planned.search.points_m[:1].tolist()}
        budget_s = planned.settings["budget_s"]
        points = {"budget_s": np.inf if budget_s is None else budget_s, "search": json.dumps(rest)}
        points |= {"x_m": planned.xy_m[:, 0], "y_m": planned.xy_m[:, 1]}
    return row | points | {"key": result.key}


def _path_of(row: dict[str, Any]) -> Path:
    """Return the planner's path from a row that `_row` made."""
    rest = json.loads(row["search"])
    points_m = np.empty((0, 2))
    if rest["points_m"]:
        xy_m = np.stack([row["x_m"], row["y_m"]], axis=1)
        points_m = xy_m - (xy_m[0] - rest["points_m"][0])
    rest.pop("bounds", None)  # of files that hold those of `astar-anytime`
    rest["history"] = tuple(map(tuple, rest["history"]))
    return Path(**(rest | {"status": Status(rest["status"]), "points_m": points_m}))
