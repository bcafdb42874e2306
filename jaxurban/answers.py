"""PlannedPaths: the answers to a batch of queries, and the file that keeps them."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.results import read_results, write_results
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import Path, Status
from jaxurban.queries import Query

BAD_INPUT, CRASHED, NOT_RUN = "bad-input", "crashed", "not-run"  # beside the names of `Status`
SAVE_EVERY_S = 5.0
SAVING_SHARE = 0.05  # of the time, at most, goes into saving


@dataclass(frozen=True, eq=False)
class Answer:
    """What became of one query.

    Attributes:
      status: the name of a `Status`, or `BAD_INPUT`, `CRASHED` or `NOT_RUN`.
      message: what happened, in a sentence or two.
      path: what the planner gave; None where it did not run to its end.
      key: stands for the question: map, weights, places, planner and settings.
    """

    status: str
    message: str
    path: PlannedPath | None = None
    key: str = ""


@dataclass(frozen=True, eq=False)
class PlannedPaths(Sequence[PlannedPath | None]):
    """The paths of a batch in the order of its queries; None where there is not even a planner's verdict.

    Attributes:
      queries: what was asked.
      answers: what became of each.
      was_interrupted: whether Ctrl-C ended the batch before its end.
    """

    queries: Sequence[Query]
    answers: Sequence[Answer]
    was_interrupted: bool = False

    def __len__(self) -> int:
        return len(self.answers)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [answer.path for answer in self.answers[index]]
        return self.answers[index].path

    def to_dataframe(self, *, with_points: bool = False) -> pd.DataFrame:
        """Return a table with one row a query: what was asked, status and message, costs, metrics, search.

        Args:
          with_points: also the columns ``x_m`` and ``y_m``, the path's eastings and northings as lists, and
            ``search``, the rest of what the planner reported, as JSON.
        """
        rows = [
            _row(k, query, answer) for k, (query, answer) in enumerate(zip(self.queries, self.answers, strict=True))
        ]
        table = pd.DataFrame(rows, columns=list(dict.fromkeys(name for row in rows for name in row)))
        return table if with_points else table.drop(columns=["x_m", "y_m", "search", "key"], errors="ignore")


class AnswerBook:
    """The answers so far, and their file."""

    def __init__(self, asked: list[Query], file: FilePath | None) -> None:
        self.asked, self.file = asked, file
        self.answers: dict[int, Answer] = {}
        self.counts = {"paths": 0, "none": 0}
        self._kept = {} if file is None or not file.exists() else _kept_rows(file, len(asked))
        self._saved_s, self._saving_s = time.perf_counter(), 0.0
        self._is_saved = True

    @property
    def num_done(self) -> int:
        """How many queries are answered."""
        return len(self.answers)

    def add(self, k: int, answer: Answer) -> None:
        """Note an answer; now and then, save all."""
        self.answers[k] = answer
        has_path = answer.path is not None and answer.path.status.has_path
        self.counts["paths" if has_path else "none"] += 1
        self._is_saved = False
        if time.perf_counter() - self._saved_s > max(SAVE_EVERY_S, self._saving_s / SAVING_SHARE):
            self.save()

    def take(self, k: int, key: str, finish: Callable[[Path], PlannedPath]) -> bool:
        """Return whether the file holds the answer to a question, and note it."""
        row = self._kept.get(k)
        if row is None or row["status"] == BAD_INPUT:
            return False
        if row["key"] != key:
            raise InputError(
                f"{str(self.file)!r} holds answers to other questions (query {k} differs in its place, map, weights "
                "or planner): name another file, or remove it"
            )
        path = None if row["search"] is None else finish(_path_of(row))
        self.add(k, Answer(row["status"], row["message"], path, key))
        return True

    def save(self) -> None:
        """Write what is known, with what an earlier run knew and this one has not come to yet."""
        if self.file is None or self._is_saved:
            return
        begin_s = time.perf_counter()
        numbers = sorted(self.answers)
        table = PlannedPaths([self.asked[k] for k in numbers], [self.answers[k] for k in numbers]).to_dataframe(
            with_points=True
        )
        table["query"] = numbers
        ahead = [row for k, row in self._kept.items() if k not in self.answers]
        write_results(self.file, pd.concat([table, pd.DataFrame(ahead)]) if ahead else table)
        self._saved_s = time.perf_counter()
        self._saving_s = self._saved_s - begin_s
        self._is_saved = True


def _kept_rows(file: FilePath, num_queries: int) -> dict[int, dict[str, Any]]:
    """Return the rows of an earlier run by query."""
    table = read_results(file)
    needed = {"query", "status", "message", "key", "search", "x_m", "y_m"}
    if not needed <= set(table.columns) or (table["query"] >= num_queries).any():
        raise InputError(f"{str(file)!r} holds no answers to these queries: name another file, or remove it")
    return {row["query"]: {str(name): row[name] for name in row} for row in table.to_dict("records")}


def _row(k: int, query: Query, answer: Answer) -> dict[str, Any]:
    """Return an answer as a flat row."""
    row: dict[str, Any] = {"query": k, **query.to_dict(), "status": answer.status, "message": answer.message}
    planned = answer.path
    points: dict[str, Any] = {"x_m": None, "y_m": None, "search": None}
    if planned is not None:
        facts = planned.to_dict()
        row |= {name: facts[name] for name in ("cost", "length_m")}
        row |= {f"cost_{name}": value for name, value in facts["cost_by_layer"].items()}
        row |= {f"m_{name}": value for name, value in facts["metrics"].items()}
        names = ("objective_cost", "lower_bound", "num_points", "num_expanded", "elapsed_s")
        row |= {name: facts[name] for name in (*names, "planner", "heuristic", "backend")}
        row |= {f"{name}_snap_m": value for name, value in facts["snap_distance_m"].items()}
        rest = {item.name: getattr(planned.search, item.name) for item in fields(Path)}
        rest |= {"status": rest["status"].value, "points_m": planned.search.points_m[:1].tolist()}
        points = {"x_m": planned.xy_m[:, 0], "y_m": planned.xy_m[:, 1], "search": json.dumps(rest)}
    return row | points | {"key": answer.key}


def _path_of(row: dict[str, Any]) -> Path:
    """Return the planner's path from a row that `_row` made."""
    rest = json.loads(row["search"])
    points_m = np.empty((0, 2))
    if rest["points_m"]:
        xy_m = np.stack([row["x_m"], row["y_m"]], axis=1)
        points_m = xy_m - (xy_m[0] - rest["points_m"][0])
    rest |= {"history": tuple(map(tuple, rest["history"])), "bounds": tuple(rest["bounds"])}
    return Path(**(rest | {"status": Status(rest["status"]), "points_m": points_m}))
