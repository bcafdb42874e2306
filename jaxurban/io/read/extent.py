"""Where the data of a file lie."""

from pathlib import Path

import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.buildings import OUTLINE_READERS
from jaxurban.io.read.osm import OSM_SUFFIXES, format_of, header_box
from jaxurban.io.read.raster import RASTER_SUFFIXES, raster_extent_m
from jaxurban.world.grid import WGS84, Bounds, transformer


def lonlat_extent(path: str | Path) -> Bounds:
    """Return west, south, east, north in degrees of the box that a file of buildings or a raster covers.

    Of OpenStreetMap it is the box that the file declares, and without one, as of other outlines, that around all
    outlines: such a file is read whole.

    Raises:
      InputError: a file that cannot be read, or one without an outline.
    """
    if not Path(path).exists():
        raise InputError(f"{str(path)!r} does not exist: check the path")
    suffix = Path(path).suffix.lower()
    if suffix in RASTER_SUFFIXES:
        return raster_extent_m(path, WGS84)
    if suffix not in OUTLINE_READERS:
        known = ", ".join((*OUTLINE_READERS, *RASTER_SUFFIXES))
        raise InputError(f"{str(path)!r} has the suffix {suffix!r}: an extent is read from {known}")
    if suffix in OSM_SUFFIXES and Path(path).is_file() and (box := header_box(path, format_of(path))):
        return box
    outlines = OUTLINE_READERS[suffix](Path(path), None, False)
    if not len(outlines.polygons) or shapely.is_empty(outlines.polygons).all():
        raise InputError(f"{str(path)!r} holds no outline that would say where it lies: give bounds")
    box = shapely.total_bounds(outlines.polygons)
    west, south, east, north = transformer(outlines.crs, WGS84).transform_bounds(*box)
    return west, south, east, north
