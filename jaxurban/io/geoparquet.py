"""GeoParquet files of ours: features, and in the file's metadata the credit, the licence and what the file covers."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd

from jaxurban.io.files import whole_file
from jaxurban.world.grid import known_crs

FACTS = b"jaxurban"  # the key in a file's metadata
ZSTD_LEVEL = 19


def write_geoparquet(path: Path, frame: gpd.GeoDataFrame, facts: Mapping[str, Any]) -> None:
    """Write features, whole or not at all.

    Args:
      path: the file.
      frame: the features.
      facts: ``credit``, ``licence``, ``boxes`` (west, south, east, north each, that the file covers) and ``issues``
        (`jaxurban.io.issues.ReadIssue` by name, counted), all optional.

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


def read_geoparquet(path: str | Path, columns: Sequence[str] | None = None) -> gpd.GeoDataFrame:
    """Return the features of a GeoParquet file; ``attrs`` are the facts of `write_geoparquet`, empty for other files.

    Args:
      path: the file.
      columns: to read; None: all.

    Raises:
      InputError: a CRS that is not known or names another file.
      ValueError: no GeoParquet, or a damaged one.
    """
    import pyarrow as pa  # imported here: these take 0.1 s to load
    import pyarrow.parquet as pq

    metadata = pq.read_schema(path).metadata or {}
    for shapes in json.loads(metadata.get(b"geo", b"{}")).get("columns", {}).values():
        crs = shapes.get("crs")
        if crs:
            known_crs(crs if isinstance(crs, str) else json.dumps(crs), f" of {str(path)!r}")
    frame = gpd.read_parquet(path, columns=columns)
    pa.default_memory_pool().release_unused()  # which it may keep for a third of the file's shapes
    frame.attrs = json.loads(metadata.get(FACTS, b"{}"))
    return frame
