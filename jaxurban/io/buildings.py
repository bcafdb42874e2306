"""Buildings from any file that knows them: the reader is chosen by the file's suffix."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import shapely

from jaxurban.city import Buildings, Raster
from jaxurban.errors import InputError
from jaxurban.grid import Bounds, projected_crs
from jaxurban.io.heights import MAX_HEIGHT_M
from jaxurban.io.knownarea import area_of_outlines, area_of_raster
from jaxurban.io.osm import read_osm
from jaxurban.io.outlines import count_tags, to_buildings
from jaxurban.io.raster import check_limits, raster_extent_m, read_raster
from jaxurban.io.surfacemodel import check_is_no_surface, heights_of_surface
from jaxurban.io.vector import read_vector
from jaxurban.io.vectorfile import PARQUET_SUFFIXES

Kind = Literal["height", "surface"]  # of a raster of buildings

OSM_FORMATS = {".pbf": "pbf", ".osm": "osm"}
VECTOR_SUFFIXES = (".geojson", ".json", ".gpkg", ".shp", *PARQUET_SUFFIXES)
RASTER_SUFFIXES = (".tif", ".tiff", ".vrt", ".asc", ".img")
LOWEST_ROOF_M = -100.0  # surface minus terrain dips below 0 by noise, at cuttings by tens of metres


@dataclass(frozen=True)
class BuildingSource:
    """What a file of buildings holds: outlines, or a raster of roof heights.

    Attributes:
      buildings: outlines that stand, or None for a raster.
      roofs: roof heights above ground, or None for outlines.
      area: where it knows what stands, in the city's CRS: of what was kept; the whole file's where nothing was.
      file_extent_m: x_min, y_min, x_max, y_max in the city's CRS of the whole file.
      faults: what was met, mended and left out in the whole file, counted by name (see `read_osm`, `read_vector`,
        `to_buildings`).
      counts: outlines of the whole file by tags, before any rule (see `count_tags`); empty for a raster.
    """

    buildings: Buildings | None
    roofs: Raster | None
    area: shapely.Geometry
    file_extent_m: Bounds
    faults: dict[str, int]
    counts: dict[str, int]


def read_buildings(
    path: str | Path,
    crs: str,
    *,
    bounds_m: Bounds | None = None,
    default_height_m: float = 10.0,
    level_height_m: float = 3.0,
    kind: Kind = "height",
    terrain: Raster | None = None,
) -> BuildingSource:
    """Return the buildings in a file.

    Args:
      path: ``.osm.pbf``, ``.osm``, ``.geojson``, ``.gpkg``, ``.shp``, ``.parquet``, or a height raster (``.tif``,
        ``.vrt``, ``.asc``, ``.img``), in any CRS that the file declares.
      crs: projected CRS of what comes back.
      bounds_m: x_min, y_min, x_max, y_max in ``crs``; buildings whose box does not touch it are left out. Which parts
        replace which outlines does not depend on it. None keeps all.
      default_height_m: height of a building without a usable height or levels.
      level_height_m: height of one level.
      kind: of a raster: ``"height"`` above ground, or ``"surface"``, elevations from which the terrain is taken.
      terrain: elevation of the ground; also tells whether a raster of heights is one.

    Raises:
      InputError: no such file, an unknown suffix, a file that cannot be read or is in a wrong CRS, a height
        setting that is no height, (raster) cells that are no heights or look like elevations, or a surface without
        terrain or that is no raster.
    """
    projected_crs(crs)
    for name, value in (("default_height_m", default_height_m), ("level_height_m", level_height_m)):
        if not 0 < value <= MAX_HEIGHT_M:
            raise InputError(f"{name} must be above 0 and at most {MAX_HEIGHT_M:g} metres, got {value}")
    if not Path(path).is_file():
        raise InputError(f"{str(path)!r} is not there: check the path of the buildings")
    suffix = Path(path).suffix.lower()
    if suffix in RASTER_SUFFIXES:
        return _read_roofs(path, crs, bounds_m, kind, terrain)
    if kind == "surface":
        raise InputError(f'[buildings] kind = "surface" is for rasters and {str(path)!r} is none: leave it out')
    if suffix in OSM_FORMATS:
        outlines = read_osm(path, OSM_FORMATS[suffix])
    elif suffix in VECTOR_SUFFIXES:
        outlines = read_vector(path)
    else:
        raise InputError(
            f"{str(path)!r} has the suffix {suffix!r}: buildings are read from "
            f"{', '.join((*OSM_FORMATS, *VECTOR_SUFFIXES, *RASTER_SUFFIXES))}"
        )
    buildings, boxes_m, faults = to_buildings(
        path, outlines, crs, default_height_m=default_height_m, level_height_m=level_height_m
    )
    area = area_of_outlines(buildings.polygons, boxes_m)
    file_extent_m = area.bounds
    if bounds_m is not None:
        x_min, y_min, x_max, y_max = shapely.bounds(buildings.polygons).T
        buildings = buildings.take(
            (x_min <= bounds_m[2]) & (x_max >= bounds_m[0]) & (y_min <= bounds_m[3]) & (y_max >= bounds_m[1])
        )
        near = shapely.intersection(shapely.box(*bounds_m), [shapely.box(*box) for box in boxes_m])
        kept = area_of_outlines(buildings.polygons, [box.bounds for box in near if box.area])
        area = area if kept.is_empty else kept
    return BuildingSource(buildings, None, area, file_extent_m, faults, count_tags(outlines))


def _read_roofs(
    path: str | Path, crs: str, bounds_m: Bounds | None, kind: Kind, terrain: Raster | None
) -> BuildingSource:
    """Return a raster's heights; those below 0 (noise of surface minus terrain) are ground and are counted."""
    name, raster = repr(str(path)), read_raster(path, crs, bounds_m)
    if kind == "surface":
        roofs, faults = heights_of_surface(name, raster, terrain, crs)
    else:
        check_is_no_surface(name, raster, terrain, crs)
        is_below = raster.values < 0
        roofs = replace(raster, values=np.where(is_below, np.float32(0), raster.values))
        faults = {"cells_below_ground": int(np.sum(is_below))}
    check_limits(name, raster.values if kind == "height" else roofs.values, (LOWEST_ROOF_M, MAX_HEIGHT_M))
    return BuildingSource(None, roofs, area_of_raster(roofs, crs), raster_extent_m(path, crs), faults, {})
