"""GeoParquet: the features near a region, the geometry of no other decoded."""

import json
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pyproj

from jaxurban.io.read.near import Near, extent_of, meets
from jaxurban.io.read.wkb import wkb_boxes
from jaxurban.world.grid import Bounds

BATCH_ROWS = 50_000  # some ten megabytes of outlines
BUFFER_BYTES = 1 << 20  # read at a time; a mapped file that is cut meanwhile would end the process without a word
SIDES = ("xmin", "ymin", "xmax", "ymax")
CRS_LEFT_OUT = "OGC:CRS84"  # of a file that names none, by the standard


def read_near_parquet(
    path: str | Path, near: Near, is_wanted: Callable[[str], bool]
) -> tuple[gpd.GeoDataFrame, Bounds] | None:
    """Return the features of a GeoParquet file near a region, in their order, and the box of all features.

    Boxes are those of the file's covering column, and row groups that are elsewhere by its statistics are passed over;
    without such a column, or where it holds none, they are found in the bytes of the geometries. Batch by batch: what
    stays are boxes and what is near.

    Args:
      path: the file.
      near: the region.
      is_wanted: whether a column, by its name, is read beside the geometry.

    Returns:
      None where boxes are not known: a file without a CRS, or of geometries that are not little-endian WKB.
    """
    with pq.ParquetFile(path, buffer_size=BUFFER_BYTES) as file:
        geometry, facts = _geometry_of(file.schema_arrow)
        declared = facts.get("crs", CRS_LEFT_OUT)
        crs = pyproj.CRS.from_user_input(declared) if facts.get("encoding") == "WKB" and declared else None
        box = None if crs is None else near.box_in(crs.to_wkt())
        if box is None:
            return None
        features = _Features(file, geometry, _covering(file, facts))
        is_near = features.near(box)
        if any(np.isinf(boxes).any() for boxes in features.boxes.values()):
            return None
        columns = [name for name in file.schema_arrow.names if name == geometry or is_wanted(name)]
        schema = pa.schema([file.schema_arrow.field(name) for name in columns], file.schema_arrow.metadata)
        rows = [batch for group in is_near for batch in features.rows(group, columns, is_near[group])]
        table = pa.Table.from_batches(rows, schema)
    frame = table.drop_columns(geometry).to_pandas()
    frame = frame.reset_index(level=_index_columns(frame)).reset_index(drop=True)
    shapes = gpd.GeoSeries.from_wkb(np.array(table[geometry]), crs=crs, index=frame.index)
    return gpd.GeoDataFrame(frame, geometry=shapes), features.extent


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


def _covering(file: pq.ParquetFile, facts: dict[str, Any]) -> dict[str, list[str]]:
    """Return where the sides of boxes stand; empty where the file does not say, or a copy left that column out."""
    stated = facts.get("covering", {}).get("bbox", {})
    held = {file.metadata.schema.column(k).path for k in range(len(file.metadata.schema))}
    return stated if all(".".join(stated.get(side, ())) in held for side in SIDES) else {}


@dataclass(frozen=True)
class _Features:
    """The features of a GeoParquet file, row group by row group.

    Attributes:
      file: the file.
      geometry: name of its column of geometries.
      covering: where the sides of their boxes stand, as the file's metadata say it; empty where they do not.
      boxes: ``[N, 4]`` of the features of each row group that was looked at.
    """

    file: pq.ParquetFile
    geometry: str
    covering: dict[str, list[str]]
    boxes: dict[int, np.ndarray] = field(default_factory=dict)

    def near(self, box: Bounds) -> dict[int, np.ndarray]:
        """Return which features of each row group are near, ``[N]`` bool, as `near_rows` does."""
        is_near = self._meeting(box)
        if any(rows.any() for rows in is_near.values()):
            is_near = self._meeting(extent_of(np.concatenate([self.boxes[g][rows] for g, rows in is_near.items()])))
        return {group: rows for group, rows in is_near.items() if rows.any()}

    def rows(self, group: int, columns: list[str], is_near: np.ndarray) -> Iterator[pa.RecordBatch]:
        """Yield the rows of a row group that are near."""
        start = 0
        for batch in self._batches(group, columns):
            yield batch.filter(pa.array(is_near[start : start + len(batch)]))
            start += len(batch)

    @property
    def extent(self) -> Bounds:
        """The box of all features."""
        extents = [self._stated_extents[g] for g in range(self.file.num_row_groups) if g not in self.boxes]
        return extent_of(np.concatenate([np.empty((0, 4)), *(e[None] for e in extents), *self.boxes.values()]))

    def _meeting(self, box: Bounds) -> dict[int, np.ndarray]:
        for group in np.flatnonzero(meets(self._stated_extents, box)):
            if group not in self.boxes:
                self.boxes[int(group)] = self._read_boxes(int(group))
        return {group: meets(self.boxes[group], box) for group in sorted(self.boxes)}

    @cached_property
    def _stated_extents(self) -> np.ndarray:
        """``[G, 4]`` the box of each row group by the statistics of the covering; it may be anywhere without any.

        So may a feature without a box, of which they say nothing else.
        """
        extents = np.tile([-np.inf, -np.inf, np.inf, np.inf], (self.file.num_row_groups, 1))
        for group in range(len(extents)) if self.covering else ():
            facts = self.file.metadata.row_group(group)
            columns = {facts.column(k).path_in_schema: facts.column(k).statistics for k in range(facts.num_columns)}
            stated = [columns.get(".".join(self.covering[side])) for side in SIDES]
            known = [one for one in stated if one is not None and one.has_min_max and not one.null_count]
            if len(known) == len(SIDES):
                extents[group] = [*(one.min for one in known[:2]), *(one.max for one in known[2:])]
        return extents

    def _read_boxes(self, group: int) -> np.ndarray:
        if not self.covering:
            return self._decode_boxes(group)
        paths = [self.covering[side] for side in SIDES]
        stated = [
            np.stack([_numbers(pc.struct_field(batch.column(path[0]), path[1:])) for path in paths], axis=1)
            for batch in self._batches(group, sorted({path[0] for path in paths}))
        ]
        boxes = np.concatenate([np.empty((0, 4)), *stated])
        is_left_out = np.isnan(boxes).any(axis=1)
        if is_left_out.any():
            boxes[is_left_out] = self._decode_boxes(group)[is_left_out]
        return boxes

    def _decode_boxes(self, group: int) -> np.ndarray:
        boxes = [_boxes_of(batch.column(0)) for batch in self._batches(group, [self.geometry])]
        return np.concatenate([np.empty((0, 4)), *boxes])

    def _batches(self, group: int, columns: list[str]) -> Iterator[pa.RecordBatch]:
        return self.file.iter_batches(BATCH_ROWS, [group], columns)


def _numbers(column: pa.Array) -> np.ndarray:
    """Return a column as float64, NaN where it holds nothing."""
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False)


def _boxes_of(column: pa.Array) -> np.ndarray:
    """Return the boxes of geometries in well-known binary, ``[N, 4]``; NaN where there is none."""
    column = column.cast(pa.large_binary())
    _, start, data = column.buffers()
    start = np.frombuffer(start, np.int64)[column.offset : column.offset + len(column) + 1]
    boxes = wkb_boxes(np.frombuffer(data or b"", np.uint8), start)
    boxes[column.is_null().to_numpy(zero_copy_only=False)] = np.nan
    return boxes
