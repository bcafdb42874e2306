"""Census blocks: polygons joined to a population table, or the pixels of a raster of people; and to districts."""

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError, readable
from jaxurban.io.read.districts import (
    Bounds,
    clean_polygons,
    default_commercial,
    largest_overlap,
    read_districts,
    require_field,
    zoning_of,
)
from jaxurban.io.read.raster import RASTER_SUFFIXES, read_bands
from jaxurban.io.read.sampling import pixel_xy
from jaxurban.io.read.vector import open_frame
from jaxurban.world.city import OTHER_DISTRICT, Blocks, ReadIssue, ReadIssues

# Names of the column of total population, the first found wins, case ignored: 2010 SF1 (data.census.gov, American
# FactFinder), 2020 P1 and DHC, TIGER with counts, GIS joins, and plain tables.
COUNT_COLUMNS = (
    *("p001001", "d001", "p1_001n", "p0010001", "pop10", "pop20", "pop100", "u7h001", "h7v001"),
    *("population", "total_population", "pop_total", "pop", "total", "count"),
)
GEO_ID_PREFIX = re.compile(r"^\w{7}US(?=\d)")  # summary level, variant and component, before the digits of the id
# A number as spreadsheets write it (1,200 or 1 200 or +5 or 1.2E+03), with a note such as (r45678) or none.
COUNT = re.compile(r"\s*(\+?\d[\d,\s]*(?:\.\d*)?(?:[eE]\+?\d{1,2})?)\s*(\(.*\))?\s*")


@dataclass(frozen=True)
class CensusFiles:
    """Census blocks, their people and their districts, as files.

    Attributes:
      blocks: block polygons, a vector file; or a raster of people, each pixel of which is a block (WorldPop, GHSL,
        LandScan: `read_people`), which takes no table.
      table: CSV of population with one header row or two (the second is words where the first names columns).
        Its id column is the one that joins most blocks, its count column is found by `COUNT_COLUMNS`, or else is
        the only other column of whole numbers. None: the count is a field of the blocks file, found by
        `COUNT_COLUMNS`.
      districts: district polygons; left out, every block is in district 13.
      block_field: field of the blocks file with one id a block.
      district_field: the districts' label, a whole number.
      commercial: labels of commercial districts; left out, see `jaxurban.io.read.districts.default_commercial`.
      residential: labels of residential districts; left out, see `jaxurban.io.read.districts.zoning_of`.
    """

    blocks: str | Path
    table: str | Path | None = None
    districts: str | Path | None = None
    block_field: str = "GEOID10"
    district_field: str = "BoroCD"
    commercial: Collection[int] | None = None
    residential: Collection[int] | None = None

    @property
    def commercial_labels(self) -> Collection[int]:
        """The labels that count as commercial."""
        return default_commercial(self.district_field) if self.commercial is None else self.commercial


def read_blocks(files: CensusFiles, crs: str, bounds_m: Bounds | None = None) -> tuple[Blocks, ReadIssues]:
    """Return census blocks with their people and districts in the order of their file, and the read issues met.

    Args:
      files: what is read.
      crs: projected CRS of the result, in metres.
      bounds_m: keep only blocks that touch this box of ``crs``; left out, all.

    Raises:
      InputError: a file or field is missing or unreadable, ids are not unique, no row joins any block, or no block
        touches the box.
    """
    issues: ReadIssues = {}
    if Path(files.blocks).suffix.lower() in RASTER_SUFFIXES:
        if files.table is not None:
            raise InputError(f"{str(files.blocks)!r} holds its people itself: leave [population] table out")
        polygons, counts, ids = read_people(files.blocks, crs, bounds_m)
        frame = gpd.GeoDataFrame({"_id": ids, "_count": counts}, geometry=polygons, crs=crs)
        if bounds_m is not None:
            frame = frame[shapely.intersects(polygons, shapely.box(*bounds_m))]
    else:
        frame, issues = _polygons(files, crs, bounds_m)
    if frame.empty:
        raise InputError(f"blocks {str(files.blocks)!r} has no block that touches the region: check [region] bounds")
    district, labels, district_issues = np.full(len(frame), OTHER_DISTRICT, np.int32), np.empty(0, int), Counter[str]()
    commercial, has_districts = files.commercial_labels, files.districts is not None
    if files.districts is not None:
        polygons, labels, district_issues = read_districts(files.districts, crs, files.district_field)
        district = largest_overlap(frame.geometry.to_numpy(), polygons, labels)
    has_count = frame["_count"].notna()
    blocks = Blocks(
        polygons=frame.geometry.to_numpy(),
        night_count=frame["_count"].fillna(0.0).to_numpy(np.float64),
        district=district,
        zoning=zoning_of(district, commercial, files.residential, labels.tolist()),
        block_id=frame["_id"].to_numpy(object),
    )
    return blocks, {
        ReadIssue.BLOCKS_WITHOUT_COUNT: int((~has_count).sum()),
        ReadIssue.COUNTS_UNREADABLE: 0,
        ReadIssue.BLOCKS_WITHOUT_POLYGON: 0,
        ReadIssue.BLOCKS_WITHOUT_DISTRICT: int((district == OTHER_DISTRICT).sum()),
        ReadIssue.INVALID_BLOCK_POLYGONS: 0,
        ReadIssue.INVALID_DISTRICT_POLYGONS: district_issues["invalid_polygons"],
        ReadIssue.COUNTS_WITH_NOTE: 0,
        ReadIssue.COUNTS_WITHOUT_BLOCK: 0,
        ReadIssue.COMMERCIAL_NOT_FOUND: int(has_districts and (~np.isin(list(commercial), labels)).sum()),
    } | issues


def read_people(
    path: str | Path, crs: str, bounds_m: Bounds | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels of a raster of people as polygons in ``crs``, with their people and their ids.

    WorldPop, GHSL and LandScan give such rasters. Pixels that share a corner share it in ``crs`` too, so that they
    cover the ground without gap or overlap, and nobody is lost or counted twice. Pixels without data are left out.

    Args:
      path: a single-band file whose name ends as in `DRIVERS`, with a CRS; values are counts of people, not densities.
      crs: projected CRS in metres.
      bounds_m: read only the pixels around this box of ``crs``; left out, all.

    Returns:
      Polygons ``[N]``, night counts ``[N]`` float64, and ids ``[N]`` such as ``"12,7"``: the file's row and column.

    Raises:
      InputError: a file that cannot be read, has several bands, no CRS or no position, does not reach the bounds, or
        holds negative counts that are not declared empty.
    """
    (raster,) = read_bands(path, crs, bounds_m, holds="people in each pixel", dtype=np.float64)
    if num_bad := int((raster.values < 0).sum()):
        raise InputError(
            f"{str(path)!r} holds {num_bad} pixels of less than 0 people: declare their value as nodata with "
            "`gdal_edit.py -a_nodata VALUE`"
        )
    row, col = np.nonzero(np.isfinite(raster.values))
    corners = [(row + down, col + right) for down, right in ((1, 0), (1, 1), (0, 1), (0, 0), (1, 0))]
    rings = np.stack([np.stack(pixel_xy(raster, *corner, crs), axis=-1) for corner in corners], axis=1)
    ids = np.array([f"{r + raster.first_row},{c + raster.first_col}" for r, c in zip(row, col, strict=True)], object)
    return shapely.polygons(rings), raster.values[row, col], ids


def _polygons(files: CensusFiles, crs: str, bounds_m: Bounds | None) -> tuple[gpd.GeoDataFrame, ReadIssues]:
    """Return block polygons with ``_id`` and ``_count``, NaN where there is none, and the read issues met."""
    role, path, field = "blocks", str(files.blocks), files.block_field
    frame = open_frame(path, role)
    require_field(frame, field, role, path, "[population] block_field")
    block_id, frame["_key"] = _ids(frame[field]), _keys(frame[field])
    twice = frame["_key"].duplicated()
    if twice.any():
        raise InputError(
            f"{role} {path!r} has the id {block_id[twice].iloc[0]!r} more than once in {field!r}: "
            "set [population] block_field to the field with one id a block (a 15-digit GEOID for US blocks)"
        )
    if files.table is None:
        counts = _counts_in_blocks(frame.drop(columns=[field, "geometry"]), path)
    else:
        counts = _counts_in_table(files.table, frame["_key"], f"{field!r} of {path!r}")
    frame = frame.assign(_id=block_id, _count=frame["_key"].map(counts.number), _note=frame["_key"].map(counts.note))
    frame["_has_row"] = frame["_key"].isin(counts.index)
    counts_without_block = int((~counts.index.isin(frame["_key"])).sum())
    frame, polygon_issues = clean_polygons(frame, crs, bounds_m)
    is_lost = frame["_count"].isna()
    if (is_lost & frame["_has_row"]).sum() == len(frame) > 0:
        raise InputError(
            f"not one count of people of the {role} {path!r} can be read as a number: check the column of population"
        )
    return frame, {
        ReadIssue.COUNTS_UNREADABLE: int((is_lost & frame["_has_row"]).sum()),
        ReadIssue.BLOCKS_WITHOUT_POLYGON: polygon_issues["without_polygon"],
        ReadIssue.INVALID_BLOCK_POLYGONS: polygon_issues["invalid_polygons"],
        ReadIssue.COUNTS_WITH_NOTE: int(frame["_note"].eq(True).sum()),
        ReadIssue.COUNTS_WITHOUT_BLOCK: counts_without_block,
    }


def _ids(column: pd.Series) -> pd.Series:
    """Return identifiers as text: numbers without decimals, census GEO_IDs without what stands before the digits."""
    if pd.api.types.is_float_dtype(column) and (column.dropna() % 1 == 0).all():  # of whole numbers with a gap
        column = column.astype("Int64")
    return column.astype(str).str.strip().str.replace(GEO_ID_PREFIX, "", regex=True).str.removesuffix(".0")


def _keys(column: pd.Series) -> pd.Series:
    """Return identifiers to join by: spreadsheets drop leading zeros, so no zero leads here."""
    return _ids(column).str.lstrip("0")


def _parse_counts(column: pd.Series, key: pd.Series) -> pd.DataFrame:
    """Return ``number`` (NaN where unreadable) and ``note`` (whether the count carries one) by key."""
    parts = column.astype(str).str.extract(f"^{COUNT.pattern}$")
    number = pd.to_numeric(parts[0].str.replace(r"[,\s]", "", regex=True), errors="coerce").to_numpy(np.float64)
    return pd.DataFrame({"number": number, "note": parts[1].notna().to_numpy()}, index=pd.Index(key))


def _count_column(columns: pd.Index) -> str | None:
    """Return the first column that `COUNT_COLUMNS` names, None where it names none."""
    by_name = {str(column).lower(): str(column) for column in columns[::-1]}
    return next((by_name[name] for name in COUNT_COLUMNS if name in by_name), None)


def _counts_in_blocks(fields: pd.DataFrame, path: str | Path) -> pd.DataFrame:
    """Return the counts that the blocks file itself holds, by key."""
    column = _count_column(fields.columns)
    if column is None:
        raise InputError(
            f"[population] blocks {str(path)!r} has no field of population (such as POP10): set [population] table "
            f"to the table that has it; the file's fields are {', '.join(fields.columns.drop('_key'))}"
        )
    return _parse_counts(fields[column], fields["_key"])


def _counts_in_table(path: str | Path, block_keys: pd.Series, wanted: str) -> pd.DataFrame:
    """Return the counts of a CSV by key; ``wanted`` names the field that they are to join, for messages."""
    name = f"[population] table {str(path)!r}"
    with readable(path, "CSV", "check the path and the file", what=name):  # pandas' parser errors are ValueErrors
        table = pd.read_csv(
            path, dtype=str, encoding="utf-8-sig", encoding_errors="replace", keep_default_na=False, index_col=False
        )
    num_joined = {str(column): int(_keys(table[column]).isin(block_keys).sum()) for column in table}
    count = _count_column(table.columns)
    id_column = max((column for column in num_joined if column != count), key=num_joined.__getitem__, default=None)
    if id_column is None or num_joined[id_column] == 0:
        shown = table.iloc[-1].to_dict() if len(table) else list(table.columns)
        raise InputError(
            f"{name} joins no block: no column holds ids such as {block_keys.iloc[0]!r} from {wanted}; "
            f"its last row is {shown}: check [population] block_field and that the table is of the same census"
        )
    if count is None:
        numeric = [c for c in num_joined if c != id_column and table[c].iloc[1:].str.fullmatch(COUNT.pattern).all()]
        if len(numeric) != 1:
            raise InputError(
                f"{name} has no column of population that its name makes known: "
                f"name one of {', '.join(repr(column) for column in num_joined if column != id_column)} 'population'"
            )
        count = numeric[0]
    if not COUNT.fullmatch(table[count].iloc[0]) and not _keys(table[id_column][:1]).isin(block_keys).any():
        table = table.iloc[1:]  # the second header row
    counts = _parse_counts(table[count], _keys(table[id_column]))
    counts = counts[~(counts.index.duplicated() & counts.reset_index().duplicated().to_numpy())]
    twice = counts.index[counts.index.duplicated() & counts.index.isin(block_keys)]
    if len(twice):
        raise InputError(
            f"{name} has more than one count for the block {twice[0]!r}: give a table with one row of total "
            "population a block"
        )
    return counts[~counts.index.duplicated()]
