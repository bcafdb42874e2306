"""Small files of every kind that is read, written where a test wants them, and the check that one is refused."""

import json
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine

from jaxurban.errors import InputError

UTM, WGS84 = "EPSG:32618", "EPSG:4326"
X, Y = 583_000.0, 4_506_000.0  # a place in Lower Manhattan
LON, LAT = -74.0, 40.7
FEET = {
    "crs": "EPSG:2263",
    "transform": Affine(10, 0, 980_000, 0, -10, 200_000),
}  # New York's state plane
SQUARE = shapely.box(LON, LAT, LON + 0.001, LAT + 0.001)


def box(x_min, y_min, x_max, y_max):
    """Return a box in metres from the place."""
    return shapely.box(X + x_min, Y + y_min, X + x_max, Y + y_max)


def refused(read, path, content, sentence):
    """Check that what is written at a path is refused in one sentence that names it; return the sentence."""
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        content(path)
    with pytest.raises(InputError, match=sentence) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    return str(caught.value)


def write_vector(path: Path, shapes, crs=UTM, to=None, **columns) -> Path:
    """Write shapes and their columns, converted to another CRS if one is given, in the format that the name says."""
    frame = gpd.GeoDataFrame(columns, geometry=list(shapes), crs=crs)
    frame = frame if to is None else frame.to_crs(to)
    frame.to_parquet(path) if path.suffix == ".parquet" else frame.to_file(path)
    return path


def write_features(path: Path, *features, **more) -> Path:
    """Write pairs of a shape (of Shapely or of JSON) and its properties as GeoJSON, also what no library would."""
    pairs = [(getattr(shape, "__geo_interface__", shape), about) for shape, about in features]
    listed = [{"type": "Feature", "properties": about, "geometry": shape} for shape, about in pairs]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": listed} | more))
    return path


def north_up(pixel_m: float, num_rows: int, x_m: float = X, y_m: float = Y) -> Affine:
    """Return the transform of a raster whose southwest corner is given."""
    return Affine(pixel_m, 0, x_m, 0, -pixel_m, y_m + pixel_m * num_rows)


def write_raster(path: Path, values, transform=None, crs=UTM, nodata=None, bands=1, **more) -> Path:
    """Write one or several bands (row 0 in the north) as a GeoTIFF of 10 m pixels at the place, or elsewhere."""
    values = np.asarray(values)
    transform = transform or north_up(10, values.shape[-2])
    profile = {
        "driver": "GTiff",
        "count": bands,
        "dtype": values.dtype,
        "crs": crs,
        "nodata": nodata,
    }
    height, width = values.shape[-2:]
    with rasterio.open(
        path, "w", height=height, width=width, transform=transform, **profile
    ) as file:
        file.write(np.broadcast_to(values, (bands, height, width)))
        for name, value in more.items():
            setattr(file, name, [value] * bands)
    return path


def _tags(values) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in values.items())


def node(number: int, lon: float, lat: float, **tags) -> str:
    """Return a node of OpenStreetMap's XML."""
    return f'<node id="{number}" version="1" lon="{lon:.9f}" lat="{lat:.9f}">{_tags(tags)}</node>'


def way(number: int, nodes, **tags) -> str:
    """Return a way along numbered nodes."""
    refs = "".join(f'<nd ref="{ref}"/>' for ref in nodes)
    return f'<way id="{number}" version="1">{refs}{_tags(tags)}</way>'


def relation(number: int, members, **tags) -> str:
    """Return a relation, a multipolygon unless its tags say otherwise, of pairs of a way and its role."""
    refs = "".join(f'<member type="way" ref="{ref}" role="{role}"/>' for ref, role in members)
    return f'<relation id="{number}" version="1">{refs}{_tags({"type": "multipolygon"} | tags)}</relation>'


def line(number: int, lonlat, **tags) -> str:
    """Return a way with nodes of its own, closed where its last place is its first."""
    numbers: dict = {}
    for place in lonlat:
        numbers.setdefault(tuple(place), 100 * number + len(numbers))
    nodes = "".join(node(each, *place) for place, each in numbers.items())
    return nodes + way(number, [numbers[tuple(place)] for place in lonlat], **tags)


def osm(*elements: str, boxes=()) -> str:
    """Return a file of OpenStreetMap's XML with the boxes that it says to cover (west, south, east, north)."""
    bounds = [
        f'<bounds minlon="{a}" minlat="{b}" maxlon="{c}" maxlat="{d}"/>' for a, b, c, d in boxes
    ]
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            '<osm version="0.6">',
            *bounds,
            *elements,
            "</osm>",
        ]
    )
