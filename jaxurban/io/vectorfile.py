"""Vector files of any format, opened the same way for every use."""

from pathlib import Path
from typing import Literal

import geopandas as gpd
import pyogrio
import shapely

from jaxurban.errors import InputError

Shapes = Literal["polygons", "lines"]
KINDS = {"polygons": ("Polygon", "Surface", "Unknown"), "lines": ("LineString", "Unknown")}  # parts of GDAL's names
PARQUET_SUFFIXES = (".parquet", ".geoparquet")


def open_frame(
    path: str | Path, role: str, *, allow_empty: bool = False, shapes: Shapes = "polygons"
) -> gpd.GeoDataFrame:
    """Return the features of a vector file (any format of GDAL, or GeoParquet), as they are.

    A ring of too few points becomes an empty place, and no error.

    Args:
      path: the file.
      role: what it holds, for messages; the layer of this name is taken where several hold its shapes.
      allow_empty: accept a file without a single feature.
      shapes: what it must hold.

    Raises:
      InputError: no such file, not a readable vector file, no geometry, no CRS, coordinates beyond the globe though
        the CRS is in degrees, or several layers of such shapes of which none is called ``role``.
    """
    name = f"the {role} file {str(path)!r}"
    if not Path(path).exists():
        raise InputError(f"{name} does not exist: check the path")
    try:
        if Path(path).suffix.lower() in PARQUET_SUFFIXES:
            frame = gpd.read_parquet(path)
        else:
            frame = pyogrio.read_dataframe(path, layer=_layer(path, role, shapes), on_invalid="ignore")
    except InputError:
        raise
    except (RuntimeError, ValueError, OSError, shapely.errors.ShapelyError) as error:
        reason = " ".join(str(error).split())  # some libraries' messages have several lines
        raise InputError(
            f"{name} cannot be read as a vector file ({reason}): give a whole one, with its companions"
        ) from error
    if not isinstance(frame, gpd.GeoDataFrame):
        raise InputError(f"{name} holds no geometry: give a file of {shapes}")
    if not allow_empty and (frame.empty or frame.geometry.isna().all()):
        raise InputError(f"{name} holds no {shapes}: give a file of {shapes}")
    if frame.crs is None:
        raise InputError(
            f"{name} declares no CRS: write it into the file, as with `ogr2ogr -a_srs EPSG:... OUT IN` "
            "(a Shapefile has it in its .prj)"
        )
    _check_degrees(name, frame)
    return frame


def _layer(path: str | Path, wanted: str, shapes: Shapes) -> str:
    """Return the name of the layer of such shapes: the only layer, the only one of them, or ``wanted``."""
    layers = {str(layer): str(kind) for layer, kind in pyogrio.list_layers(path)}
    if len(layers) == 1:
        return next(iter(layers))
    kinds = KINDS[shapes]
    fitting = [layer for layer, kind in layers.items() if any(name in kind for name in kinds)]
    if len(fitting) != 1:
        fitting = [layer for layer in fitting if layer.lower() == wanted]
    if len(fitting) != 1:
        raise InputError(
            f"{str(path)!r} has the layers {', '.join(layers) or 'none'}: call the one of {shapes} "
            f"{wanted!r}, or write it to a file of its own with `ogr2ogr OUT IN LAYER`"
        )
    return fitting[0]


def _check_degrees(name: str, frame: gpd.GeoDataFrame) -> None:
    x_min, y_min, x_max, y_max = frame.total_bounds
    if frame.crs is not None and frame.crs.is_geographic and (max(-x_min, x_max) > 360 or max(-y_min, y_max) > 90):
        raise InputError(
            f"{name} is in degrees by its CRS but has coordinates such as {x_max:.0f}, {y_max:.0f}: declare the CRS "
            "that they are in, or convert them with `ogr2ogr -s_srs EPSG:... -t_srs EPSG:4326 OUT IN` (GeoJSON is "
            "always in longitude and latitude)"
        )
