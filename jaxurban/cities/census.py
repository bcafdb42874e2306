"""Census blocks: polygons joined to a population table, or the pixels of rasters of people; and their districts."""

import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from jaxurban.checks import nearest_name
from jaxurban.cities.plausible import check_people
from jaxurban.cities.raster import RASTER_SUFFIXES, read_bands
from jaxurban.cities.vector import POLYGONS, open_frame, without_collections
from jaxurban.errors import InputError
from jaxurban.io.issues import ReadIssue, ReadIssues, num_of
from jaxurban.io.sampling import pixel_xy
from jaxurban.io.tables import read_table
from jaxurban.metrics.population import Population
from jaxurban.world.blocks import OTHER_DISTRICT, Blocks, Zoning
from jaxurban.world.grid import Bounds, projected_crs, transformer

# Names of the column of total population, in small letters: 2010 SF1 (data.census.gov, American FactFinder), 2020 P1
# and DHC, GIS joins; TIGER with counts (pop20, pop100), Eurostat's census grids (tot_p_2021), and plain tables.
COUNT_COLUMN = re.compile(
    r"p001001|d001|p1_001n|p0010001|u7h001|h7v001|"
    r"(tot(al)?_)?(pop|population|people)(_total)?_?\d{0,4}|tot_p(_\d{4})?|total|count"
)
# Summary level, variant and component, before the digits of the id.
GEO_ID_PREFIX = re.compile(r"^\w{7}US(?=\d)")
# A number as spreadsheets write it (1,200 or 1 200 or +5 or 1.2E+03 or 12,5), with a note such as (r45678) or none: its
# whole part, in which three digits follow what parts thousands, and its decimals with a power of ten.
MOST_PEOPLE = 1e10  # of a block: more is no count
COUNT = re.compile(
    r"\s*(?P<whole>\+?(?:[1-9]\d{,2}(?:[,\s]\d{3})+(?!\d)|\d+))"
    r"(?P<decimals>(?:[.,]\d*)?(?:[eE]\+?\d{1,2})?)\s*(?:\(.*\))?\s*"
)

PAPER_DISTRICTS = tuple(range(101, 113))  # Manhattan's twelve; 164 is Central Park


def read_blocks(
    files: Population, crs: str, bounds_m: Bounds | None = None, region_m: Bounds | None = None
) -> tuple[Blocks, ReadIssues]:
    """Return census blocks with their people and districts in the order of their file, and the read issues by count.

    Args:
      files: what is read: blocks, or rasters of people by day and by night, and whatever else is named.
      crs: projected CRS of the result, in metres.
      bounds_m: keep only blocks that touch this box of ``crs``; left out, all.
      region_m: box of ``crs`` where both rasters, by day and by night, must hold data; left out, that is not checked.

    Raises:
      InputError: a file or field is missing or unreadable, ids are not unique, no row joins any block, or no block
        touches the box.
    """
    frame, of_people = _people_of(files, crs, bounds_m, region_m)
    issues = Counter(of_people)
    if frame.empty:
        raise InputError(
            f"blocks {str(files.blocks)!r} has no block that touches the region: check [region] bounds"
        )

    # Their districts.
    polygons = frame.geometry.to_numpy()
    commercial = files.commercial_labels
    district = np.full(len(frame), OTHER_DISTRICT, np.int32)
    labels = np.empty(0, int)
    if files.districts is not None:
        areas, labels, issues[ReadIssue.INVALID_DISTRICT_POLYGONS] = read_districts(
            files.districts, crs, files.district_field
        )
        district = largest_overlap(polygons, areas, labels)
        issues[ReadIssue.COMMERCIAL_NOT_FOUND] = num_of(~np.isin(list(commercial), labels))
    zoning = zoning_of(district, commercial, labels.tolist())

    # A count that is missing is 0. Without rasters by day and by night there is one count for both.
    counts = frame.filter(["_count", "_day"])
    issues[ReadIssue.BLOCKS_WITHOUT_COUNT] = num_of(counts.isna().any(axis=1))
    issues[ReadIssue.BLOCKS_WITHOUT_DISTRICT] = num_of(district == OTHER_DISTRICT)
    people = counts.fillna(0.0).astype(np.float64)
    night = people["_count"].to_numpy()
    day = people["_day"].to_numpy() if "_day" in people else None
    check_people(people.to_numpy().max(axis=1), shapely.area(polygons))
    ids = frame["_id"].to_numpy(object)
    return Blocks(polygons, night, district, zoning, ids, day), issues


def _people_of(
    files: Population, crs: str, bounds_m: Bounds | None, region_m: Bounds | None
) -> tuple[gpd.GeoDataFrame, ReadIssues]:
    """Return blocks or pixels with their people, and the read issues by count.

    Arguments and errors are those of `read_blocks`.

    Returns:
      ``geometry``, ``_id`` and ``_count``, of rasters by day and by night also ``_day``; NaN where there is no count.
    """
    if files.blocks_night is not None and files.blocks_day is not None:
        night = read_people(files.blocks_night, crs, bounds_m, region_m)
        day = read_people(files.blocks_day, crs, bounds_m, region_m)
        return _by_night_and_day(night, day), {}
    is_raster = Path(str(files.blocks)).suffix.lower() in RASTER_SUFFIXES
    if not is_raster:
        return _polygons(files, crs, bounds_m)
    if files.table is not None or files.column is not None:
        raise InputError(
            f"{str(files.blocks)!r} holds its people itself: leave [population] table and column out"
        )
    return read_people(str(files.blocks), crs, bounds_m), {}


def _by_night_and_day(night: gpd.GeoDataFrame, day: gpd.GeoDataFrame) -> gpd.GeoDataFrame:
    """Return the pixels of two rasters on one grid (see `read_people`), with people by night and by day.

    Returns:
      ``geometry``, ``_id``, ``_count`` by night and ``_day``, both float64, NaN where the raster has no data.

    Raises:
      InputError: pixels of the same row and column do not lie at the same place, to a millimetre.
    """
    day = day.rename(columns={"_count": "_day"})
    both = night.merge(day, on="_id", how="outer", suffixes=("", "_day"))
    pairs = both.dropna(subset=["geometry", "geometry_day"])
    if not pairs["geometry"].geom_equals_exact(pairs["geometry_day"], tolerance=1e-3).all():
        raise InputError(
            "[population] blocks_night and blocks_day lie on two grids: put one on the pixels of the other with "
            "`gdalwarp -r sum -tr ... -te ...`, which keeps the number of people"
        )
    return both.assign(geometry=both["geometry"].fillna(both["geometry_day"]))


def read_people(
    path: str | Path, crs: str, bounds_m: Bounds | None = None, region_m: Bounds | None = None
) -> gpd.GeoDataFrame:
    """Return the pixels of a raster of people as polygons in ``crs``, with their people and their ids.

    WorldPop, GHSL and LandScan give such rasters. Pixels that share a corner share it in ``crs`` too, so that they
    cover the ground without gap or overlap, and nobody is lost or counted twice. Pixels without data are left out.

    Args:
      path: a single-band file whose name ends as in `DRIVERS`, with a CRS; values are counts of people, not densities.
      crs: projected CRS in metres.
      bounds_m: keep only the pixels that touch this box of ``crs``; left out, all.
      region_m: box of ``crs`` that a pixel with data must touch; left out, none must.

    Returns:
      ``geometry``, ``_count`` (float64), and ``_id`` such as ``"12,7"``: the file's row and column.

    Raises:
      InputError: a file that cannot be read, has several bands, no CRS or no position, does not reach the bounds or
        holds no data in the region, or holds negative counts that are not declared empty.
    """
    (raster,) = read_bands(path, crs, bounds_m, holds="people in each pixel", dtype=np.float64)
    num_bad = num_of(raster.values < 0)
    if num_bad:
        raise InputError(
            f"{str(path)!r} holds {num_bad} pixels of less than 0 people: declare their value as nodata with "
            "`gdal_edit.py -a_nodata VALUE`"
        )

    # Of each pixel the corners from southwest round, the first once more: [N, 5].
    row, col = np.nonzero(np.isfinite(raster.values))
    down = row[:, None] + [1, 1, 0, 0, 1]
    right = col[:, None] + [0, 1, 1, 0, 0]
    rings = np.stack(pixel_xy(raster, down, right, crs), axis=-1)

    places = zip(row + raster.first_row, col + raster.first_col, strict=True)
    columns = {
        "_id": np.array([f"{row},{col}" for row, col in places], object),
        "_count": raster.values[row, col],
    }
    frame = gpd.GeoDataFrame(columns, geometry=shapely.polygons(rings), crs=crs)
    if region_m is not None and not frame.intersects(shapely.box(*region_m)).any():
        raise InputError(
            f"{str(path)!r} holds no data in the region: give a raster of people that covers it"
        )
    return frame if bounds_m is None else frame[frame.intersects(shapely.box(*bounds_m))]


def _polygons(
    files: Population, crs: str, bounds_m: Bounds | None
) -> tuple[gpd.GeoDataFrame, ReadIssues]:
    """Return the polygons of blocks, as of `_people_of`, and how many counts and polygons were missing or unusable.

    Args:
      files: blocks, and a table of their people if they have none themselves.
      crs: projected CRS of the result.
      bounds_m: keep only blocks that touch this box of ``crs``; None keeps all.

    Raises:
      InputError: as of `read_blocks`.
    """
    path = str(files.blocks)
    field = files.block_field
    features = _open(path, "blocks", field)
    block_id = _ids(features[field])
    key = _keys(features[field])
    is_second = key.duplicated()
    if is_second.any():
        raise InputError(
            f"blocks {path!r} has the id {block_id[is_second].iloc[0]!r} more than once in {field!r}: "
            "set [population] block_field to the field with one id a block (a 15-digit GEOID for US blocks)"
        )

    # Join the counts, by key.
    if files.table is None:
        fields = features.drop(columns=[field, "geometry"])
        count = _count_column(fields, files.column, f"[population] blocks {path!r}")
        counts = _parse_counts(fields[count]).set_axis(key)
    else:
        counts = _counts_in_table(files, key, f"{field!r} of {path!r}")
    joined = features.assign(_id=block_id, _count=key.map(counts), _has_row=key.isin(counts.index))

    frame, num_lost, num_invalid = clean_polygons(joined, crs, bounds_m)
    num_unreadable = num_of(frame["_count"].isna() & frame["_has_row"])
    if num_unreadable == len(frame) > 0:
        raise InputError(
            f"not one count of people of the blocks {path!r} can be read as a number: check the column of population, "
            "in which a comma parts either thousands or decimals"
        )
    return frame, {
        ReadIssue.COUNTS_WITHOUT_BLOCK: num_of(~counts.index.isin(key)),
        ReadIssue.COUNTS_UNREADABLE: num_unreadable,
        ReadIssue.BLOCKS_WITHOUT_POLYGON: num_lost,
        ReadIssue.INVALID_BLOCK_POLYGONS: num_invalid,
    }


def _open(path: str | Path, role: str, field: str) -> gpd.GeoDataFrame:
    """Return the features of a file that must have a field.

    Args:
      path: of the file.
      role: what it holds, ``"blocks"`` or ``"districts"``, for messages.
      field: its name.

    Raises:
      InputError: a file that cannot be read, or that has no such field; the message names the nearest one.
    """
    frame = open_frame(path, role)
    fields = [str(column) for column in frame.columns if column != "geometry"]
    if field not in fields:
        hint = nearest_name(field, fields) or f"; it has {', '.join(fields) or 'none'}"
        raise InputError(
            f"{role} {str(path)!r} has no field {field!r}{hint}: [population] {role[:-1]}_field names it"
        )
    return frame


def clean_polygons(
    frame: gpd.GeoDataFrame, crs: str, bounds_m: Bounds | None = None
) -> tuple[gpd.GeoDataFrame, int, int]:
    """Return features as valid polygons in ``crs``, how many were left out without one, and how many repaired.

    Args:
      frame: features in any CRS.
      crs: projected CRS in metres.
      bounds_m: keep only what touches this box of ``crs``, and count only what is near it; left out, all.
    """
    near = frame
    if bounds_m is not None:
        assert frame.crs is not None
        to_file = transformer(crs, frame.crs.to_wkt())
        x_min, y_min, x_max, y_max = to_file.transform_bounds(*bounds_m, densify_pts=21)
        near = frame.cx[x_min:x_max, y_min:y_max]
    projected = near.to_crs(projected_crs(crs))

    # Repair what is invalid, and leave out what has no area then.
    polygons = projected.geometry.to_numpy().copy()
    is_invalid = ~shapely.is_valid(polygons) & ~shapely.is_missing(polygons)
    polygons[is_invalid] = shapely.make_valid(polygons[is_invalid], method="structure")
    polygons = without_collections(polygons)
    polygons[~np.isin(shapely.get_type_id(polygons), POLYGONS)] = None
    is_kept = shapely.area(polygons) > 0
    num_lost = num_of(~is_kept)
    num_invalid = num_of(is_invalid)
    if bounds_m is not None:
        is_kept &= shapely.intersects(polygons, shapely.box(*bounds_m))
    repaired = projected.set_geometry(polygons, crs=projected.crs)
    return repaired[is_kept], num_lost, num_invalid


def _ids(column: pd.Series) -> pd.Series:
    """Return identifiers as text: numbers without decimals, census GEO_IDs without what stands before the digits."""
    # Whole numbers with a gap are read as floats.
    if pd.api.types.is_float_dtype(column) and (column.dropna() % 1 == 0).all():
        column = column.astype("Int64")
    texts = column.astype(str).str.strip()
    return texts.str.replace(GEO_ID_PREFIX, "", regex=True).str.removesuffix(".0")


def _keys(column: pd.Series) -> pd.Series:
    """Return identifiers to join by: spreadsheets drop leading zeros, so no zero leads here."""
    return _ids(column).str.lstrip("0")


def _parse_counts(column: pd.Series) -> pd.Series:
    """Return counts of people, float64 by row, NaN for what is no number as in `COUNT` or above `MOST_PEOPLE`.

    All are NaN where a comma parts thousands in some and decimals in others, as in 1,200 beside 12,5.

    Args:
      column: ``[N]`` counts as they stand.
    """
    parts = column.astype(str).str.extract(f"^{COUNT.pattern}$").fillna("")
    whole, decimals = parts["whole"], parts["decimals"]
    is_clear = not (whole.str.contains(",").any() and decimals.str.startswith(",").any())
    digits = whole.str.replace(r"[,\s]", "", regex=True) + decimals.str.replace(",", ".")
    people = pd.to_numeric(digits, errors="coerce").astype(np.float64)
    return people.where(is_clear & (people <= MOST_PEOPLE))


def _count_column(table: pd.DataFrame, column: str | None, name: str) -> str:
    """Return the column of people: the one that the settings name, else that of `COUNT_COLUMN`.

    Args:
      table: with a row for each block.
      column: that the settings name.
      name: of the file, for messages.

    Raises:
      InputError: there is none, or several may be it, and their counts differ.
    """
    if column is not None:
        candidates = [column] if column in table else []
    else:
        fields = map(str, table)
        candidates = [field for field in fields if COUNT_COLUMN.fullmatch(field.lower())]
    if not candidates:
        raise InputError(
            f"{name} has no field {column or 'of population (such as POP10)'}: name one of "
            f"{', '.join(map(repr, table))} in [population] column, or set [population] table to the table that has it"
        )
    counts = [_parse_counts(table[candidate]) for candidate in candidates]
    if not all(count.equals(counts[0]) for count in counts):
        raise InputError(
            f"{name} has several columns that may be of people, {', '.join(candidates)}: name the one in "
            "[population] column"
        )
    return candidates[0]


def _counts_in_table(files: Population, block_keys: pd.Series, wanted: str) -> pd.Series:
    """Return the counts of a CSV table, float64 by key, each key once.

    The column of ids is the one that most rows join by; the column of counts is named, or known by its name.

    Args:
      files: the path of the table, and the column that the settings name.
      block_keys: of the blocks, from `_keys`.
      wanted: the field of the blocks that the table is to join, for messages.

    Raises:
      InputError: the table cannot be read, joins no block, has no column of population or several, or two counts of one
        block.
    """
    path = str(files.table)
    name = f"[population] table {path!r}"
    table = read_table(
        path, "population", dtype=str, encoding_errors="replace", keep_default_na=False
    )

    # Which column holds the ids, and which the counts.
    count = _count_column(table, files.column, name)
    others = table.drop(columns=count)
    num_joined = others.apply(lambda column: _keys(column).isin(block_keys).sum())
    if not num_joined.any():
        shown = table.iloc[-1].to_dict() if len(table) else list(table.columns)
        raise InputError(
            f"{name} joins no block: no column holds ids such as {block_keys.iloc[0]!r} from {wanted}; "
            f"its last row is {shown}: check [population] block_field and that the table is of the same census"
        )
    id_column = num_joined.idxmax()
    # Tables of the census may have a second header row, which is of no block and holds no count.
    is_first_a_block = _keys(table[id_column][:1]).isin(block_keys).any()
    if not COUNT.fullmatch(table[count].iloc[0]) and not is_first_a_block:
        table = table.iloc[1:]

    # A row may stand twice, but not with another count. Of rows that join no block it does not matter.
    by_row = _parse_counts(table[count]).set_axis(_keys(table[id_column]))
    counts = by_row[~by_row.reset_index().duplicated().to_numpy()]
    twice = counts.index[counts.index.duplicated() & counts.index.isin(block_keys)]
    if len(twice):
        raise InputError(
            f"{name} has more than one count for the block {twice[0]!r}: give a table with one row of total "
            "population a block"
        )
    return counts[~counts.index.duplicated()]


def read_districts(
    path: str | Path, crs: str, field: str = "BoroCD"
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return district polygons in ``crs``, their labels (int32), and how many polygons were repaired.

    A label may stand on several polygons. Polygons without area are left out.

    Args:
      path: of the districts.
      crs: projected CRS of the result.
      field: that holds the labels.

    Raises:
      InputError: an unreadable file, no such field (names the nearest one), or a label that is not a whole number.
    """
    frame = _open(path, "districts", field)
    labels = pd.to_numeric(frame[field], errors="coerce").to_numpy(np.float64)
    is_unusable = ~((labels % 1 == 0) & (np.abs(labels) < 2**31))  # NaN too
    if is_unusable.any():
        raise InputError(
            f"districts {str(path)!r} has the label {frame[field][is_unusable].iloc[0]} in field {field!r}: "
            "labels must be whole numbers (set [population] district_field to the field that holds them)"
        )
    labelled = frame.assign(**{field: labels.astype(np.int32)})
    districts, _, num_invalid = clean_polygons(labelled, crs)
    return districts.geometry.to_numpy(), districts[field].to_numpy(), num_invalid


def largest_overlap(polygons: np.ndarray, districts: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the label of the district that covers most of each polygon, `OTHER_DISTRICT` where none does.

    Args:
      polygons: ``[N]`` valid polygons.
      districts: ``[D]`` valid polygons in the same projected CRS.
      labels: ``[D]`` whole numbers; polygons of one label count together.

    Returns:
      ``[N]`` int32. Touching does not count as overlap; of equal overlaps the smallest label wins.
    """
    polygon, near = shapely.STRtree(districts).query(polygons, predicate="intersects")
    shapely.prepare(districts)  # which makes the next step quick, and changes no shape

    # The area of each pair. Most blocks lie wholly within one district: no need to cut them out of its long shoreline.
    may_stick_out = ~shapely.contains_properly(districts[near], polygons[polygon])
    area_m2 = shapely.area(polygons[polygon])
    area_m2[may_stick_out] = shapely.area(
        shapely.intersection(polygons[polygon[may_stick_out]], districts[near[may_stick_out]])
    )

    # Of equal overlaps the smallest label comes first.
    pairs = pd.DataFrame({"polygon": polygon, "label": labels[near], "area_m2": area_m2})
    overlaps = pairs[pairs["area_m2"] > 0].groupby(["polygon", "label"], as_index=False).sum()
    in_order = overlaps.sort_values(["area_m2", "label"], ascending=[False, True])
    best = in_order.drop_duplicates("polygon")
    district = np.full(len(polygons), OTHER_DISTRICT, np.int32)
    district[best["polygon"].to_numpy()] = best["label"].to_numpy()
    return district


def zoning_of(
    district: np.ndarray, commercial: Collection[int], labels: Collection[int]
) -> np.ndarray:
    """Return the `Zoning` of each district label, uint8.

    Residential are the districts of Manhattan (101 to 112), but for the commercial ones; where the districts file has
    none of these, all its districts but the commercial ones.

    Args:
      district: ``[N]`` labels.
      commercial: labels of commercial districts.
      labels: every label of the districts file, empty without one.

    Returns:
      ``[N]``. OTHER for labels on neither list (164, Central Park, and `OTHER_DISTRICT`): such blocks change by day as
      residential ones do, and are counted apart.
    """
    manhattan = set(PAPER_DISTRICTS).intersection(labels)
    residential = (manhattan or set(labels)) - {OTHER_DISTRICT}
    is_commercial = np.isin(district, list(commercial))
    is_residential = np.isin(district, list(residential)) & ~is_commercial
    return np.select(
        [is_commercial, is_residential], [Zoning.COMMERCIAL, Zoning.RESIDENTIAL], Zoning.OTHER
    ).astype(np.uint8)
