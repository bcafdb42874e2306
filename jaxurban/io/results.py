"""The table of a batch's results on disk: one Parquet file, always whole."""

from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from jaxurban.errors import InputError
from jaxurban.io.seal import is_whole
from jaxurban.io.store import whole_file
from jaxurban.io.tables import write_parquet


def write_results(path: Path, rows: pd.DataFrame) -> None:
    """Write a table as Parquet; the file that was there stays until the new one is complete.

    Raises:
      InputError: the folder cannot be written to.
    """
    with whole_file(path) as scratch:
        write_parquet(rows, scratch)


def read_results(path: Path) -> pd.DataFrame:
    """Return the table that `write_results` wrote.

    Raises:
      InputError: the file cannot be read, or is not as it was written.
    """
    if path.is_file() and not is_whole(path):
        raise InputError(
            f"{str(path)!r} is damaged, or no file of such results: name another file, or remove this one, and what it "
            "held is asked again"
        )
    try:
        return pq.read_table(path).to_pandas()
    except (OSError, pa.ArrowException) as error:
        raise InputError(
            f"cannot read results from {str(path)!r} ({error}): name another file, or remove this one"
        ) from error
