"""Vector files of any format, opened the same way for every use."""

from collections.abc import Callable
from pathlib import Path

import geopandas as gpd
import pyogrio
import shapely

from jaxurban.errors import InputError

PARQUET_SUFFIXES = (".parquet", ".geoparquet")


def open_frame(path: str | Path, role: str, *, allow_empty: bool = False) -> gpd.GeoDataFrame:
    """Return the features of a vector file (any format of GDAL, or GeoParquet), as they are.

    A ring of too few points becomes an empty place, and no error.

    Args:
      path: the file.
      role: what it holds, for messages; the layer of this name is taken where several hold polygons.

      allow_empty: accept a file without a single feature.

    Raises:
      InputError: no such file, not a readable vector file, no geometry, no CRS, coordinates beyond the globe though
        the CRS is in degrees, or several layers of polygons of which none is called ``role``.
    """
    (frame,) = _read(path, role, lambda: [_polygon_layer(path, role)], on_invalid="ignore")
    if not allow_empty and (frame.empty or frame.geometry.isna().all()):
        raise InputError(f"the {role} file {str(path)!r} holds no polygons: give a file of polygons")
    return frame


def open_layers(path: str | Path, role: str) -> list[gpd.GeoDataFrame]:
    """Return the features of every layer of a vector file, those without geometry left out.

    Every folder of a KML file is a layer. Nothing is passed over: a ring of too few points is an error.

    Raises:
      InputError: as `open_frame`, but for several layers.
    """
    return _read(path, role, lambda: [str(layer) for layer, _ in pyogrio.list_layers(path)], on_invalid="raise")


def _read(path: str | Path, role: str, pick_layers: Callable[[], list[str]], on_invalid: str) -> list[gpd.GeoDataFrame]:
    """Return the picked layers of a file, checked."""
    name = f"the {role} file {str(path)!r}"
    if not Path(path).exists():
        raise InputError(f"{name} does not exist: check the path")
    try:
        if Path(path).suffix.lower() in PARQUET_SUFFIXES:
            frames = [gpd.read_parquet(path)]
        else:
            frames = [pyogrio.read_dataframe(path, layer=layer, on_invalid=on_invalid) for layer in pick_layers()]
    except InputError:
        raise
    except (RuntimeError, ValueError, OSError, shapely.errors.ShapelyError) as error:
        reason = " ".join(str(error).split())  # some libraries' messages have several lines
        raise InputError(
            f"{name} cannot be read as a vector file ({reason}): give a whole one, with its companions"
        ) from error
    frames = [frame for frame in frames if isinstance(frame, gpd.GeoDataFrame)]
    if not frames:
        raise InputError(f"{name} holds no geometry: give a file of polygons")
    for frame in frames:
        if frame.crs is None:
            raise InputError(
                f"{name} declares no CRS: write it into the file, as with `ogr2ogr -a_srs EPSG:... OUT IN` "
                "(a Shapefile has it in its .prj)"
            )
        _check_degrees(name, frame)
    return frames


def _polygon_layer(path: str | Path, wanted: str) -> str:
    """Return the name of the layer of polygons: the only one, the only one of polygons, or ``wanted``."""
    layers = {str(layer): str(kind) for layer, kind in pyogrio.list_layers(path)}
    if len(layers) == 1:
        return next(iter(layers))
    areal = [layer for layer, kind in layers.items() if "Polygon" in kind or "Unknown" in kind or "Surface" in kind]
    if len(areal) != 1:
        areal = [layer for layer in areal if layer.lower() == wanted]
    if len(areal) != 1:
        raise InputError(
            f"{str(path)!r} has the layers {', '.join(layers) or 'none'}: call the one of polygons "
            f"{wanted!r}, or write it to a file of its own with `ogr2ogr OUT IN LAYER`"
        )
    return areal[0]


def _check_degrees(name: str, frame: gpd.GeoDataFrame) -> None:
    x_min, y_min, x_max, y_max = frame.total_bounds
    if frame.crs is not None and frame.crs.is_geographic and (max(-x_min, x_max) > 360 or max(-y_min, y_max) > 90):
        raise InputError(
            f"{name} is in degrees by its CRS but has coordinates such as {x_max:.0f}, {y_max:.0f}: declare the CRS "
            "that they are in, or convert them with `ogr2ogr -s_srs EPSG:... -t_srs EPSG:4326 OUT IN` (GeoJSON is "
            "always in longitude and latitude)"
        )
