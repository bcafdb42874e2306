"""Tables as files: Parquet or CSV by the end of their names."""

from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from jaxurban.errors import InputError, readable
from jaxurban.io.files import BLANK, FIELD, seal, whole_file, write_whole

SUFFIXES = (".parquet", ".csv")


def write_table(table: pd.DataFrame, file: str | Path) -> Path:
    """Write a table, whole or not at all, Parquet with its checksum, and return its file.

    Raises:
      InputError: the name ends neither in .parquet nor in .csv, or the folder cannot be written to.
    """
    file = Path(file)
    if _suffix(file) == ".csv":
        write_whole(file, table.to_csv(index=False, lineterminator="\n"))
        return file
    made = pa.Table.from_pandas(table, preserve_index=False)
    made = made.replace_schema_metadata({**(made.schema.metadata or {}), FIELD: BLANK})
    with whole_file(file) as scratch:
        pq.write_table(made, scratch, compression="zstd")
        seal(scratch)
    return file


def read_table(file: str | Path, role: str) -> pd.DataFrame:
    """Return the table in a file.

    Args:
      file: a .parquet or .csv file.
      role: what it holds, for messages.

    Raises:
      InputError: no such file, or it cannot be read.
    """
    file = Path(file)
    suffix = _suffix(file)
    what = f"the {role} file {str(file)!r}"
    with readable(file, suffix[1:], "make it again, or name another", what=what):
        table = pd.read_parquet(file) if suffix == ".parquet" else pd.read_csv(file)
        for name in table.columns[[pd.api.types.is_object_dtype(kind) for kind in table.dtypes]]:
            if not all(pd.api.types.is_hashable(value) for value in table[name]):
                raise ValueError(f"its column {name!r} holds lists or tables")
        return table


def records_of(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as plain values, None where there is no value or no number."""
    rows = table.astype(object).where(table.notna(), None).to_dict("records")
    return [{str(name): value for name, value in row.items()} for row in rows]


def _suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"cannot tell the format of {str(file)!r}: end its name in {' or '.join(SUFFIXES)}")
    return suffix
