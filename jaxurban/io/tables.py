"""Plain tables as files: Parquet or CSV by the name's end."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from jaxurban.errors import InputError
from jaxurban.io.seal import BLANK, FIELD, seal
from jaxurban.io.store import whole_file

SUFFIXES = (".parquet", ".csv")


def write_table(table: pd.DataFrame, file: str | Path) -> Path:
    """Write a table, whole or not at all, and return its file.

    Raises:
      InputError: the name ends neither in .parquet nor in .csv, or the folder cannot be written to.
    """
    file = Path(file)
    suffix = _suffix(file)
    with whole_file(file) as scratch:
        if suffix == ".parquet":
            write_parquet(table, scratch)
        else:
            table.to_csv(scratch, index=False, lineterminator="\n")
    return file


def write_parquet(table: pd.DataFrame, scratch: Path) -> None:
    """Write a table as Parquet, with its checksum, into a scratch file."""
    made = pa.Table.from_pandas(table, preserve_index=False)
    made = made.replace_schema_metadata({**(made.schema.metadata or {}), FIELD: BLANK})
    pq.write_table(made, scratch, compression="zstd")
    seal(scratch)


def write_tables(tables: Mapping[str, pd.DataFrame], folder: Path) -> list[Path]:
    """Write each table, index included, as CSV and as Parquet under ``folder`` and return the files.

    Raises:
      InputError: the folder cannot be written to.
    """
    return [
        write_table(table.reset_index(), folder / f"{name}{suffix}")
        for name, table in tables.items()
        for suffix in (".csv", ".parquet")
    ]


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
    try:
        return pd.read_parquet(file) if suffix == ".parquet" else pd.read_csv(file)
    except FileNotFoundError as error:
        raise InputError(f"the {role} file {str(file)!r} does not exist: check the path") from error
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"the {role} file {str(file)!r} cannot be read as {suffix[1:]} ({reason})") from error


def _suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"cannot tell the format of {str(file)!r}: end its name in {' or '.join(SUFFIXES)}")
    return suffix
