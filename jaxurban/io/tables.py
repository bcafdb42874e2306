"""Tables of a study as files."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from jaxurban.io.store import whole_file


def write_tables(tables: Mapping[str, pd.DataFrame], folder: Path) -> list[Path]:
    """Write each table as CSV and as Parquet under ``folder`` and return the files; each appears whole or not at all.

    Raises:
      InputError: the folder cannot be written to.
    """
    files = []
    for name, table in tables.items():
        plain = table.reset_index()
        for suffix in (".csv", ".parquet"):
            file = folder / f"{name}{suffix}"
            with whole_file(file) as scratch:
                if suffix == ".csv":
                    plain.to_csv(scratch, index=False)
                else:
                    plain.to_parquet(scratch, index=False)
            files.append(file)
    return files
