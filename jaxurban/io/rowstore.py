"""RowStore: the rows of a long job on disk, each there once or not at all, whatever kills the job."""

import json
import uuid
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from jaxurban.io.seal import is_whole, write_json
from jaxurban.io.store import sweep_scraps, whole_file
from jaxurban.io.tables import read_table, write_table

ROWS_FILE, PARTS_FOLDER, ASIDE_SUFFIX = "rows.parquet", "parts", ".damaged"
Row = Mapping[str, Any]


class RowStore:
    """Rows by key. Each `add` is a small file that appears whole; `compact` joins all into ``rows.parquet``.

    One process writes. A job killed between the two steps of compacting leaves rows in both places: the table wins.
    """

    def __init__(self, folder: Path, key: Sequence[str]) -> None:
        """Open the store in ``folder``; ``key`` are the columns that name a row.

        A damaged file is told of by a warning and set aside, so that the job makes its rows again.

        Raises:
          InputError: a file of it cannot be read.
        """
        self.folder, self.key = folder, tuple(key)
        (folder / PARTS_FOLDER).mkdir(parents=True, exist_ok=True)
        sweep_scraps(folder)
        sweep_scraps(folder / PARTS_FOLDER)
        self._rows: dict[tuple, dict[str, Any]] = {}
        for part in self._parts():
            if _is_sound(part):
                self._take(json.loads(part.read_text(encoding="utf-8"))["rows"])
        table_file = folder / ROWS_FILE
        if table_file.is_file() and _is_sound(table_file):
            table = read_table(table_file, "rows")
            self._take(table.astype(object).where(table.notna(), None).to_dict("records"))

    def _parts(self) -> list[Path]:
        return sorted((self.folder / PARTS_FOLDER).glob("*.json"))

    def _take(self, rows: Iterable[Mapping[Any, Any]]) -> None:
        for row in rows:
            self._rows[tuple(row[name] for name in self.key)] = dict(row)

    def __contains__(self, key: tuple) -> bool:
        return key in self._rows

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """All rows, in the order of their keys."""
        return [self._rows[key] for key in sorted(self._rows)]

    def add(self, rows: Sequence[Row]) -> None:
        """Keep rows: all of them are on disk when this returns, or none."""
        with whole_file(self.folder / PARTS_FOLDER / f"{uuid.uuid4().hex}.json") as scratch:
            write_json(scratch, {"rows": list(rows)})
        self._take(rows)

    def compact(self, columns: Mapping[str, str]) -> pd.DataFrame:
        """Write all rows into one table, in the order of their keys, remove the parts, and return it as read.

        Args:
          columns: the type of each column; missing numbers become NaN.
        """
        parts = self._parts()
        table = pd.DataFrame(self.rows, columns=list(columns), dtype=object).astype(dict(columns))
        write_table(table, self.folder / ROWS_FILE)
        for part in parts:
            part.unlink()
        return read_table(self.folder / ROWS_FILE, "rows")


def _is_sound(file: Path) -> bool:
    """Return whether a file is as it was written; set it aside if not."""
    if is_whole(file):
        return True
    aside = file.with_name(f"{file.name}{ASIDE_SUFFIX}")
    warnings.warn(
        f"{str(file)!r} is damaged: it is now {aside.name!r}, and the rows that it held are made again", stacklevel=3
    )
    file.replace(aside)
    return False
