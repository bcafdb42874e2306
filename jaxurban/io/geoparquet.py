"""GeoParquet files of ours: features, and in the file's metadata the credit, the licence and what the file covers."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import geopandas as gpd

from jaxurban.io.files import whole_file

FACTS = b"jaxurban"  # the key in a file's metadata
ZSTD_LEVEL = 19


def write_geoparquet(path: Path, frame: gpd.GeoDataFrame, facts: Mapping[str, Any]) -> None:
    """Write features, whole or not at all.

    Args:
      path: the file.
      frame: the features.
      facts: ``credit``, ``licence``, ``boxes`` (west, south, east, north each, that the file covers) and ``issues``
        (`jaxurban.io.read.issues.ReadIssue` by name, counted), all optional.

    Raises:
      InputError: the folder cannot be written to.
    """
    import pyarrow.parquet as pq  # imported here: it takes 0.1 s to load

    with whole_file(path) as scratch:
        frame.to_parquet(scratch, index=False)
        table = pq.read_table(scratch)
        table = table.replace_schema_metadata(
            {**table.schema.metadata, FACTS: json.dumps(facts).encode()}
        )
        pq.write_table(table, scratch, compression="zstd", compression_level=ZSTD_LEVEL)


def facts_of(metadata: Mapping[bytes, bytes] | None) -> dict[str, Any]:
    """Return the facts that `write_geoparquet` wrote into a file's metadata, empty for files of others."""
    return json.loads((metadata or {}).get(FACTS, b"{}"))
