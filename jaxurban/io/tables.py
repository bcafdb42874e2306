"""Tables as files, Parquet or CSV by the end of their names, and RowStore: a long job's rows, whatever kills it."""

import csv
import hashlib
import io
import json
import math
import re
import time
import uuid
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from jaxurban.errors import InputError, readable
from jaxurban.io.files import (
    BLANK,
    FIELD,
    UNPACKING,
    is_whole,
    read_json,
    recorder_of,
    sealed,
    write_json,
    write_whole,
)
from jaxurban.io.sniff import sniff, unpacked

SUFFIXES = (".parquet", ".csv")
TABLES = ("", ".txt", ".csv", ".parquet", ".zip")  # of `sniff`
MOST_COLUMNS = 2000
ROWS_FILE = "rows.parquet"
PARTS_FOLDER = "parts"
INSTANCES_FILE = "instances.parquet"  # beside the rows of a Monte Carlo benchmark
SAVE_EVERY_S = 5.0
SAVING_SHARE = 0.05  # of the time, at most, goes into saving
SETTINGS = b"settings"  # in the metadata of a Parquet file
Row = Mapping[str, Any]


def write_table(
    table: pd.DataFrame, file: str | Path, settings: Mapping[str, Any] | None = None
) -> Path:
    """Write a table, whole or not at all, and return its file.

    Args:
      table: without its index.
      file: a name that ends in .parquet or .csv.
      settings: what the rows depend on, as JSON holds it; Parquet keeps it beside its checksum, CSV has neither.

    Raises:
      InputError: the name ends neither in .parquet nor in .csv, or the folder cannot be written to.
    """
    file = Path(file)
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"cannot determine the format of {str(file)!r}: end its name in {' or '.join(SUFFIXES)}"
        )
    if suffix == ".csv":
        write_whole(file, table.to_csv(index=False, lineterminator="\n"))
        return file
    content = pa.Table.from_pandas(table, preserve_index=False)
    facts = {FIELD: BLANK, SETTINGS: json.dumps(settings or {}, sort_keys=True)}
    content = content.replace_schema_metadata({**content.schema.metadata, **facts})
    data = io.BytesIO()
    pq.write_table(content, data, compression="zstd")
    write_whole(file, sealed(data.getvalue()))
    return file


def read_table(file: str | Path, role: str, **options: Any) -> pd.DataFrame:
    """Return the table in a file.

    Args:
      file: Parquet or CSV, as its content says; CSV also packed, as .csv.gz.
      role: what it holds, for messages.
      options: of pandas, for CSV.

    Raises:
      InputError: no such file, another format, a file that cannot be read, or a column of lists or tables.
    """
    if not is_table(file):
        raise InputError(f"{str(file)!r} is no table: give CSV or Parquet")
    what = f"the {role} file {str(file)!r}"
    with (
        readable(file, "a table", "make it again, or name another", *UNPACKING, what=what),
        unpacked(file) as plain,
    ):
        if sniff(plain) == ".parquet":
            _check_width(len(pq.read_schema(plain).names), str(file))
            table = pd.read_parquet(plain)
        else:
            columns = range(check_rows(plain, str(file)))
            table = pd.read_csv(plain, usecols=columns, **options)
        for name, column in table.items():
            is_object = pd.api.types.is_object_dtype(column)
            if is_object and not column.map(pd.api.types.is_hashable).all():
                raise ValueError(f"its column {name!r} holds lists or tables")
        return table


def is_table(file: str | Path) -> bool:
    """Return whether a file is Parquet or no other format that is known (`sniff`), as CSV has no mark."""
    return sniff(file) in TABLES


def check_rows(source: Path | io.BytesIO, name: str) -> int:
    """Return how many columns a CSV file has, each of whose rows fits its header.

    Blank lines do not matter, nor do blank values beyond the header, which tools write that end each row with a comma,
    nor notes: rows of one value of several words. Not looked at are lines of more letters than a value may have, and
    files with another mark between the values.

    Args:
      source: the file, which pandas unpacks by its name.
      name: of the file.

    Raises:
      InputError: a row has more or fewer values than the header, or there are too many columns.
      ValueError, csv.Error: no line, or a quote without its other one.
    """
    lines = pd.read_csv(
        source,
        sep="\x1f",
        names=["line"],
        dtype=str,
        quoting=csv.QUOTE_NONE,
        na_filter=False,
        skip_blank_lines=False,
        encoding_errors="replace",
    )["line"].tolist()
    _check_width("".join(lines[:1]).count(",") + 1, name)
    reader = csv.reader((line for line in lines if len(line) < csv.field_size_limit()), strict=True)
    rows = filter(None, reader)
    header = next(rows, [])
    num = len(header)
    if num == 1 and re.search(r"[;\t]", header[0]):
        return num
    for row in rows:
        has_more = "".join(row[num:]).strip()
        if num > 1 and (has_more or (len(row) < num and not is_note(row))):
            raise InputError(
                f"line {reader.line_num} of {name!r} and its header differ in their number of values, {len(row)} and "
                f"{num}: mend that line, or remove it"
            )
    return num


def is_note(row: Sequence[str]) -> bool:
    """Return whether a row of a CSV file is a note: one value of several words."""
    return len(row) == 1 and " " in row[0]


def _check_width(num: int, name: str) -> None:
    """Raise InputError for more columns, in a file of a name, than are read: many take minutes."""
    if num > MOST_COLUMNS:
        raise InputError(
            f"{name!r} has {num:,} columns, and {MOST_COLUMNS:,} are read at most: leave some out"
        )


def records_of(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as plain values, None where there is no value or no number."""
    rows = table.astype(object).where(table.notna(), None).to_dict("records")
    return [{str(name): value for name, value in row.items()} for row in rows]


def is_blank(value: Any) -> bool:
    """Return whether a value says nothing: None, NaN or blank text."""
    return not value.strip() if isinstance(value, str) else value is None or value != value


def number_or_none(value: float | None) -> float | None:
    """Return a number as JSON takes it: None for one that is missing or not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def numbers_or_none(values: Mapping[Any, float | None]) -> dict[str, float | None]:
    """Return numbers by name as JSON takes them (`number_or_none`)."""
    return {str(name): number_or_none(value) for name, value in values.items()}


class RowStore:
    """Rows by key in one Parquet file that is always whole. One process writes.

    With parts each `add` is a small file at once, and `save` joins all of them into the file; a job killed between the
    two steps of that leaves rows in both places: the file wins. Without, the file is written again by `save`, and by
    `add` every few seconds.
    """

    def __init__(
        self,
        file: Path,
        key: Sequence[str],
        *,
        has_parts: bool = False,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        """Open the store, with the rows that an earlier run left in its file and its parts.

        Args:
          file: ends in .parquet; where there is none, the store begins without a row.
          key: names of the columns whose values together name a row.
          has_parts: in a run that records files (`jaxurban.io.workspace.Workspace`) each `add` is kept at once in a
            file of the folder `PARTS_FOLDER`, and a damaged file is set aside and reported, so that the job makes its
            rows again.
          settings: what all rows depend on, as JSON holds it.

        Raises:
          InputError: the file cannot be read, is damaged, holds rows of other settings or without a column of the key.
        """
        if file.suffix != ".parquet":
            raise InputError(f"{str(file)!r} must end in .parquet: give it another name")
        self.file = file
        self.key = tuple(key)
        self._settings = settings or {}
        self._workspace = recorder_of(file) if has_parts else None
        self._rows: dict[tuple, dict[str, Any]] = {}
        self._is_saved = True
        self._saved_s = time.perf_counter()  # when it was saved last
        self._saving_s = 0.0  # how long that took

        # The file comes last, as it wins over parts that were joined into it before a kill.
        for part in self._parts():
            if self._is_sound(part):
                self._take(read_json(part)["rows"])
        if file.exists() and self._is_sound(file):
            self._take(_read_rows(file, self._settings))

    def _parts(self) -> list[Path]:
        """Return the files of parts that the workspace has recorded, none without parts."""
        folder = self.file.parent / PARTS_FOLDER
        workspace = self._workspace
        paths = [workspace.folder / name for name in workspace.written] if workspace else []
        return [path for path in paths if path.parent == folder]

    def _is_sound(self, file: Path) -> bool:
        """Return whether a file can be read: with parts, as it was written; a changed one is set aside."""
        if self._workspace is None:
            return True
        if self._workspace.is_changed(file):
            self._workspace.set_aside(file)
        return self._workspace.is_own(file)

    def _take(self, rows: Iterable[Mapping[Any, Any]]) -> None:
        """Keep rows in memory by their keys; InputError of a row without a column of the key."""
        for row in rows:
            for name in self.key:
                if name not in row:
                    raise InputError(
                        f"{str(self.file)!r} holds no {name!r}: name another file, or remove it"
                    )
            self._rows[tuple(row[name] for name in self.key)] = dict(row)

    def __contains__(self, key: tuple) -> bool:
        return key in self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def get(self, *key: Any) -> dict[str, Any] | None:
        """Return the row of a key, None where there is none."""
        return self._rows.get(key)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """All rows, in the order of their keys."""
        return [self._rows[key] for key in sorted(self._rows)]

    def add(self, rows: Sequence[Row]) -> None:
        """Keep rows, in place of rows with the same keys.

        With parts all of them, or none, are on disk when this returns. Otherwise the file is saved if the last time is
        `SAVE_EVERY_S` ago, or longer where saving takes more than `SAVING_SHARE` of the time.
        """
        if self._workspace:
            part = self.file.parent / PARTS_FOLDER / f"{uuid.uuid4().hex}.json"
            write_json(part, {"rows": list(rows)})
        self._take(rows)
        self._is_saved = False
        pause_s = max(SAVE_EVERY_S, self._saving_s / SAVING_SHARE)
        if not self._workspace and time.perf_counter() - self._saved_s > pause_s:
            self.save()

    def save(self, columns: Mapping[str, str] | None = None) -> None:
        """Write all rows into the file, in the order of their keys, and remove the parts; nothing if none is new.

        Args:
          columns: the type of each column of the table by its name, NaN for missing numbers; left out, pandas guesses
            them.

        Raises:
          InputError: the file cannot be written.
        """
        if self._is_saved and not self._workspace:
            return
        begin_s = time.perf_counter()
        parts = self._parts()
        if columns:
            table = pd.DataFrame(self.rows, columns=list(columns), dtype=object).astype(columns)
        else:
            table = pd.DataFrame(self.rows)
        write_table(table, self.file, self._settings)
        if self._workspace:
            self._workspace.remove(str(self._workspace.name_of(part)) for part in parts)
        self._is_saved = True
        self._saved_s = time.perf_counter()
        self._saving_s = self._saved_s - begin_s


def fingerprint(*parts: Any) -> str:
    """Return 16 hexadecimal digits that stand for values: arrays count by their bytes, others by their ``repr``."""
    digest = hashlib.sha256()
    for part in parts:
        is_array = isinstance(part, np.ndarray)
        digest.update(np.ascontiguousarray(part).tobytes() if is_array else repr(part).encode())
    return digest.hexdigest()[:16]


def _read_rows(file: Path, settings: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of a file of a `RowStore`, each a dictionary of its values by column.

    Args:
      file: a Parquet table with a checksum and with its settings as JSON in its metadata.
      settings: by name, what the file's settings must be; others in the file do not matter.

    Raises:
      InputError: the file cannot be read, is damaged, or has another value of one of these ``settings``.
    """
    remedy = "name another file or folder, or remove this one, and its rows are made again"
    with readable(file, "results", remedy, pa.ArrowException):
        data = file.read_bytes()
        if not is_whole(data):
            raise InputError(f"{str(file)!r} is damaged, or not a file of such results: {remedy}")
        table = pq.read_table(io.BytesIO(data))

    # The settings of the file. Those of the call go through JSON too, so that tuples compare as lists.
    before = json.loads((table.schema.metadata or {}).get(SETTINGS, b"{}"))
    for name, value in json.loads(json.dumps(settings)).items():
        if before.get(name) != value:
            difference = f"its {name.replace('_', ' ')} is {before.get(name)}, now {value}"
            raise InputError(
                f"{str(file)!r} is of other settings ({difference}): pass --overwrite, or {remedy}"
            )
    return records_of(table.to_pandas())
