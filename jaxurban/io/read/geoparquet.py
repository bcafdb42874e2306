"""GeoParquet: the features near a region."""

import json
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pyproj
import shapely

from jaxurban.io.read.near import Near, extent_of, near_rows
from jaxurban.world.grid import Bounds

BATCH_ROWS = 50_000  # some ten megabytes of outlines
BUFFER_BYTES = 1 << 20  # read at a time; a mapped file that is cut meanwhile would end the process without a word
SIDES = ("xmin", "ymin", "xmax", "ymax")
CRS_LEFT_OUT = "OGC:CRS84"  # of a file that names none, by the standard


def read_near_parquet(
    path: str | Path, near: Near, is_wanted: Callable[[str], bool]
) -> tuple[gpd.GeoDataFrame, Bounds] | None:
    """Return the features of a GeoParquet file near a region, in their order, and the box of all features.

    Boxes are those of the file's covering column; without such a column, or where it lacks any, all geometries are
    looked at. Batch by batch: what stays are boxes and what is near; row groups with nothing near are passed over.

    Args:
      path: the file.
      near: the region.
      is_wanted: whether a column, by its name, is read beside the geometry.

    Returns:
      None where boxes are not known: a file without a CRS, or of geometries that are not WKB.
    """
    with pq.ParquetFile(path, buffer_size=BUFFER_BYTES) as file:
        geometry, facts = _geometry_of(file.schema_arrow)
        declared = facts.get("crs", CRS_LEFT_OUT)
        crs = pyproj.CRS.from_user_input(declared) if facts.get("encoding") == "WKB" and declared else None
        box = None if crs is None else near.box_in(crs.to_wkt())
        if box is None:
            return None
        boxes = _stated_boxes(file, facts)
        if boxes is None or np.isnan(boxes).any():
            batches = file.iter_batches(BATCH_ROWS, columns=[geometry])
            found = [shapely.bounds(shapely.from_wkb(np.array(batch.column(0), object))) for batch in batches]
            boxes = np.concatenate([np.empty((0, 4)), *found])
        is_near = near_rows(boxes, box)
        of_group = np.split(
            is_near, np.cumsum([file.metadata.row_group(g).num_rows for g in range(file.num_row_groups)])
        )
        groups = [group for group, rows in enumerate(of_group) if rows.any()]
        is_near = np.concatenate([of_group[group] for group in groups] or [is_near[:0]])
        columns = [name for name in file.schema_arrow.names if name == geometry or is_wanted(name)]
        schema = pa.schema([file.schema_arrow.field(name) for name in columns], file.schema_arrow.metadata)
        rows, start = [], 0
        for batch in file.iter_batches(BATCH_ROWS, groups, columns) if groups else ():
            rows.append(batch.filter(pa.array(is_near[start : start + len(batch)])))
            start += len(batch)
        table = pa.Table.from_batches(rows, schema)
    frame = table.drop_columns(geometry).to_pandas()
    frame = frame.reset_index(level=_index_columns(frame)).reset_index(drop=True)
    shapes = gpd.GeoSeries.from_wkb(np.array(table[geometry]), crs=crs, index=frame.index)
    return gpd.GeoDataFrame(frame, geometry=shapes), extent_of(boxes)


def read_whole_parquet(path: str | Path) -> gpd.GeoDataFrame:
    """Return all features of a GeoParquet file."""
    _geometry_of(pq.read_schema(path))
    frame = gpd.read_parquet(path)
    return frame.reset_index(level=_index_columns(frame))


def _geometry_of(schema: pa.Schema) -> tuple[str, dict[str, Any]]:
    """Return the name of the column of geometries, and what the "geo" metadata say of it; empty where there are none.

    Raises:
      ValueError: damaged metadata.
    """
    written = (schema.metadata or {}).get(b"geo")
    if written is None:
        return "", {}
    try:
        geo = json.loads(written)
        name = geo["primary_column"]
        facts, bbox = geo["columns"][name], geo["columns"][name].get("covering", {}).get("bbox", {})
        is_sound = name in schema.names and all(isinstance(part, str) for path in bbox.values() for part in path)
    except (ValueError, LookupError, TypeError, AttributeError):
        is_sound = False
    if not is_sound:
        raise ValueError('its "geo" metadata are damaged')
    return name, facts


def _index_columns(frame: pd.DataFrame) -> list[Hashable]:
    """Return the columns of a file that pandas wrote as an index, and reads as one."""
    return [name for name in frame.index.names if name is not None and name not in frame.columns]


def _stated_boxes(file: pq.ParquetFile, facts: dict[str, Any]) -> np.ndarray | None:
    """Return the boxes of all features by the covering column, ``[N, 4]``, NaN where it holds none.

    None where the metadata name no such column, or a copy left it out.
    """
    stated = facts.get("covering", {}).get("bbox", {})
    paths = [stated.get(side, ()) for side in SIDES]
    held = {file.metadata.schema.column(k).path for k in range(len(file.metadata.schema))}
    if not held.issuperset(".".join(path) for path in paths):
        return None
    boxes = [np.empty((0, 4))]
    for batch in file.iter_batches(BATCH_ROWS, columns=sorted({path[0] for path in paths})):
        sides = [pc.struct_field(batch.column(path[0]), path[1:]).cast(pa.float64()) for path in paths]
        boxes.append(np.stack([side.to_numpy(zero_copy_only=False) for side in sides], axis=1))
    return np.concatenate(boxes)
