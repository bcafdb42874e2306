"""Bodies of three dimensions among outlines: files that hold them, and the prisms that their faces make."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pyogrio
import shapely
from pyogrio.errors import GeometryError

from jaxurban.cities.outlines import Outlines
from jaxurban.world.grid import known_crs

RELIEF_M = 0.5  # a body is higher; what of it is not is its ground
STEP_M = 0.1  # roofs of one body between two multiples of it are one prism
DIFFER_M = 3.0  # what the same file says to be so much higher than a solid counts in its place
MIN_WALLS = 3  # of a body whose faces do not lie above each other
# Faces lie above each other if together they are so many times the area that they cover.
COVERED_TWICE = 1.5


def openable(path: str) -> str | bytes:
    """Return what pyogrio opens of a file of polygons: its path, or a stream that makes MultiPolygons of its features.

    A layer of collections needs a stream, and so do PolyhedralSurfaces and TINs, which pyogrio refuses.
    """
    try:
        if not any("Collection" in str(kind) for _, kind in pyogrio.list_layers(path)):
            return path
    except GeometryError:
        pass
    return streamed(path)


def streamed(path: str, how: str = "") -> bytes:
    """Return a stream that makes MultiPolygons of a file's features, for pyogrio to open.

    Args:
      path: of the file.
      how: further options of reading it, as of `gdal vector pipeline`.
    """
    quoted = json.dumps(str(Path(path).absolute()), ensure_ascii=False)
    command = (
        f"gdal vector pipeline ! read {how} {quoted} ! set-geom-type --geometry-type MULTIPOLYGONZ "
        "! write --output-format stream streamed"
    )
    return json.dumps({"type": "gdal_streamed_alg", "command_line": command}).encode()


def prisms_of_solids(features: Outlines) -> pd.DataFrame:
    """Return the prisms of the faces of solids, and other outlines as they are, ``P`` in all, in order.

    A solid is a MultiPolygon whose vertices differ by more than `RELIEF_M` in height, and that has vertical faces or
    faces above each other. Outlines beside each other whose heights follow the ground are no solid, nor is a Polygon.

    Seen from above, a face stands up to its highest vertex, and of faces above each other the highest counts. Ground
    that no roof covers stands up to the lowest roof, and without any roof as high as the walls.

    Args:
      features: ``N`` of them. Heights are in the unit of their CRS's height axis; without one in that of its other
        axes, in metres where these are degrees. The tag ``num_roofs`` is how many faces, the first ones, are roofs as
        the file says, 0 where it does not say it. No other face of these is a roof, whatever it looks like.

    Returns:
      ``feature``, which outline each is of; ``height_m`` above the lowest vertex of the solid, rising, 0 of the hull of
      one that has walls alone, and NaN of an outline that is no solid; ``polygon``; and ``rise_m``, how far the highest
      vertex of the outline lies above the lowest of all, 0 without heights. Prisms of a solid may overlap.
    """
    outlines = features.polygons
    axis = known_crs(features.crs).axis_info[-1]
    unit_m = 1.0 if axis.unit_name == "degree" else axis.unit_conversion_factor
    has_z = shapely.has_z(outlines)
    rise_m = _rises_m(outlines, unit_m) if has_z.any() else np.zeros(len(outlines))
    may_be = has_z & (shapely.get_num_geometries(outlines) > 1)
    if not may_be.any():
        plain = {"feature": np.arange(len(outlines)), "height_m": math.nan, "polygon": outlines}
        return pd.DataFrame({**plain, "rise_m": rise_m})
    num_roofs = features.tags.get("num_roofs", np.zeros(len(outlines), int))
    rows: list[tuple] = []
    for feature, outline in enumerate(outlines):
        prisms = {math.nan: outline}
        if may_be[feature]:
            prisms = _prisms(outline, unit_m, num_roofs[feature])
        rows += [(feature, *prism, rise_m[feature]) for prism in prisms.items()]
    return pd.DataFrame(rows, columns=["feature", "height_m", "polygon", "rise_m"])


def _rises_m(outlines: np.ndarray, unit_m: float) -> np.ndarray:
    """Return ``[N]`` how far the highest vertex of each outline lies above the lowest of all."""
    vertices, outline = shapely.get_coordinates(outlines, include_z=True, return_index=True)
    height_m = np.nan_to_num(vertices[:, 2]) * unit_m
    rise_m = np.zeros(len(outlines))
    np.maximum.at(rise_m, outline, height_m - height_m.min(initial=np.inf))
    return rise_m


def _prisms(
    outline: shapely.Geometry, unit_m: float, num_roofs: int
) -> dict[float, shapely.Geometry]:
    """Return the polygon of each height of a solid, or an outline that is none at a height of NaN.

    Args:
      outline: a MultiPolygon with heights.
      unit_m: of these.
      num_roofs: as of `prisms_of_solids`.
    """
    faces = shapely.get_parts(outline)
    vertices, face = shapely.get_coordinates(faces, include_z=True, return_index=True)
    height_m = vertices[:, 2] * unit_m
    top_m = np.zeros(len(faces))
    np.maximum.at(top_m, face, height_m - height_m.min())

    # In plan vertical faces are empty.
    plan = shapely.make_valid(shapely.force_2d(faces), method="structure", keep_collapsed=False)
    is_wall = shapely.is_empty(plan)
    is_double = shapely.area(plan).sum() > COVERED_TWICE * shapely.union_all(plan).area
    is_body = num_roofs > 0 or is_double or is_wall.sum() >= MIN_WALLS
    if not (is_body and top_m.max() > RELIEF_M):
        return {math.nan: outline}
    if is_wall.all():
        return {0.0: outline.convex_hull.buffer(0)}  # empty of walls in one line

    is_roof = ~is_wall & (top_m > RELIEF_M)
    is_roof[num_roofs or len(faces) :] = False
    top_m = np.where(is_roof, top_m, top_m[is_roof].min(initial=top_m.max()))
    step = np.ceil(top_m / STEP_M)
    steps = [step == one for one in np.unique(step)]
    return {top_m[same].max(): shapely.union_all(plan[same]) for same in steps}
