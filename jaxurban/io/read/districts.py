"""Districts: polygons read from any vector file, and the district that each block lies in."""

from collections import Counter
from collections.abc import Collection
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError, nearest_name
from jaxurban.io.read.outlines import polygonal
from jaxurban.io.read.vector import open_frame
from jaxurban.world.city import OTHER_DISTRICT, Zoning
from jaxurban.world.grid import Bounds, projected_crs, transformer

AREAL = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)
PAPER_DISTRICTS = tuple(range(101, 113))  # Manhattan's twelve; 164 is Central Park
PAPER_COMMERCIAL = PAPER_DISTRICTS[:6]


def default_commercial(field: str) -> tuple[int, ...]:
    """Return the districts that are commercial where nobody says which: the paper's, of New York's own labels only.

    Args:
      field: of the labels; New York calls it ``BoroCD`` (``boro_cd`` in some exports). Any other gives none.
    """
    return PAPER_COMMERCIAL if field.lower().replace("_", "") == "borocd" else ()


def require_field(frame: pd.DataFrame, field: str, role: str, path: str | Path, setting: str) -> None:
    """Check that a file has a field.

    Raises:
      InputError: it has not; the message names the nearest one.
    """
    fields = [str(column) for column in frame.columns if column != "geometry"]
    if field not in fields:
        hint = nearest_name(field, fields) or f"; it has {', '.join(fields) or 'none'}"
        raise InputError(f"{role} {str(path)!r} has no field {field!r}{hint}: {setting} names it")


def clean_polygons(
    frame: gpd.GeoDataFrame, crs: str, bounds_m: Bounds | None = None
) -> tuple[gpd.GeoDataFrame, Counter]:
    """Return the polygons of ``frame`` in ``crs``, valid, and the issues met.

    Args:
      frame: features in any CRS.
      crs: projected CRS in metres.
      bounds_m: keep only what touches this box of ``crs``; left out, all.

    Returns:
      The frame, and a count of ``without_polygon`` (left out) and ``invalid_polygons`` (repaired). Both count
      only features near the box.
    """
    if bounds_m is not None:
        assert frame.crs is not None
        near = transformer(crs, frame.crs.to_wkt()).transform_bounds(*bounds_m, densify_pts=21)
        frame = frame.cx[near[0] : near[2], near[1] : near[3]]
    frame = frame.to_crs(projected_crs(crs))
    polygons, invalid = valid_polygons(frame.geometry.to_numpy())
    kept = shapely.area(polygons) > 0
    issues = Counter(without_polygon=int((~kept).sum()), invalid_polygons=int(invalid.sum()))
    frame = frame.set_geometry(gpd.GeoSeries(polygons, index=frame.index, crs=frame.crs))
    if bounds_m is not None:
        kept &= shapely.intersects(polygons, shapely.box(*bounds_m))
    return frame[kept], issues


def valid_polygons(geometries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the valid polygonal part of each geometry (None where there is none), and which were invalid."""
    invalid = ~shapely.is_valid(geometries) & ~shapely.is_missing(geometries)
    polygons = geometries.copy()
    polygons[invalid] = shapely.make_valid(geometries[invalid], method="structure")
    for i in np.flatnonzero(shapely.get_type_id(polygons) == shapely.GeometryType.GEOMETRYCOLLECTION):
        polygons[i] = polygonal(polygons[i])
    polygons[~np.isin(shapely.get_type_id(polygons), AREAL)] = None
    return polygons, invalid


def read_districts(path: str | Path, crs: str, field: str = "BoroCD") -> tuple[np.ndarray, np.ndarray, Counter]:
    """Return district polygons in ``crs``, their labels (int32), and the issues met.

    A label may stand on several polygons.

    Raises:
      InputError: an unreadable file, no such field (names the nearest one), or a label that is not a whole number.
    """
    role = "districts"
    frame = open_frame(path, role)
    require_field(frame, field, role, path, "[population] district_field")
    labels = pd.to_numeric(frame[field], errors="coerce").to_numpy(np.float64)
    unusable = ~((labels % 1 == 0) & (np.abs(labels) < 2**31))  # NaN too
    if unusable.any():
        raise InputError(
            f"{role} {str(path)!r} has the label {frame[field][unusable].iloc[0]} in field {field!r}: "
            "labels must be whole numbers (set [population] district_field to the field that holds them)"
        )
    frame, issues = clean_polygons(frame.assign(**{field: labels.astype(np.int32)}), crs)
    return frame.geometry.to_numpy(), frame[field].to_numpy(), issues


def largest_overlap(polygons: np.ndarray, districts: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return the label of the district that covers most of each polygon, `OTHER_DISTRICT` where none does.

    Args:
      polygons: ``[N]`` valid polygons.
      districts: ``[D]`` valid polygons in the same projected CRS.
      labels: ``[D]`` whole numbers; polygons of one label count together.

    Returns:
      ``[N]`` int32. Touching does not count as overlap; of equal overlaps the smallest label wins.
    """
    index, candidate = shapely.STRtree(districts).query(polygons, predicate="intersects")
    shapely.prepare(districts)
    # Most blocks lie wholly within one district: no need to cut them out of its long shoreline.
    inside = shapely.contains_properly(districts[candidate], polygons[index])
    area_m2 = shapely.area(polygons[index])
    area_m2[~inside] = shapely.area(shapely.intersection(polygons[index[~inside]], districts[candidate[~inside]]))
    pairs = pd.DataFrame({"index": index, "label": labels[candidate], "area_m2": area_m2})
    pairs = pairs[pairs["area_m2"] > 0].groupby(["index", "label"], as_index=False).sum()
    best = pairs.sort_values(["area_m2", "label"], ascending=[False, True]).drop_duplicates("index")
    result = np.full(len(polygons), OTHER_DISTRICT, np.int32)
    result[best["index"].to_numpy()] = best["label"].to_numpy()
    return result


def zoning_of(
    district: np.ndarray, commercial: Collection[int], residential: Collection[int] | None, labels: Collection[int]
) -> np.ndarray:
    """Return the `Zoning` of each district label, uint8.

    Args:
      district: ``[N]`` labels.
      commercial: labels of commercial districts.
      residential: labels of residential districts. None: Manhattan's twelve (101 to 112) less the commercial
        ones; where the districts file has none of the twelve, every district of it but the commercial ones.
      labels: every label of the districts file.

    Returns:
      OTHER for labels on neither list (Central Park is 164, no district is 13); such blocks change by day like
      residential ones and are counted apart.
    """
    if residential is None:
        twelve = set(PAPER_DISTRICTS).intersection(labels)
        residential = (twelve or set(labels)) - {OTHER_DISTRICT}
    is_commercial = np.isin(district, list(commercial))
    is_residential = np.isin(district, list(residential)) & ~is_commercial
    return np.select([is_commercial, is_residential], [Zoning.COMMERCIAL, Zoning.RESIDENTIAL], Zoning.OTHER).astype(
        np.uint8
    )
