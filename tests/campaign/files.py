"""Hostile files: what readers of outlines, rasters, people, orbits, zones, routes and tables may be given."""

import itertools
import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import rasterio
import shapely
from affine import Affine

from tests.campaign.cases import REFUSED, TOLD, Case
from tests.campaign.settings import MAPS, PLAN

WEST, SOUTH, EAST, NORTH = -74.0, 40.755, -73.995, 40.759
LOCAL_CRS = 'LOCAL_CS["a site",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
UTM, X, Y = "EPSG:32618", 584_000.0, 4_511_800.0
DEEP = 100_000


def scenario(folder: Path, buildings: str, more: str = "") -> None:
    """Write a scenario over these sources."""
    (folder / "scenario.toml").write_text(
        f"[region]\nbounds = [{WEST}, {SOUTH}, {EAST}, {NORTH}]\nresolution_m = 25\naltitudes_m = [20]\n"
        f'[buildings]\nsource = "{buildings}"\n[gps]\ntimes = ["2020-04-27T16:00:00Z"]\n{more}'
    )


def box(west: float = WEST + 0.001, south: float = SOUTH + 0.001, size: float = 5e-4) -> list[list[float]]:
    """Return a ring."""
    return [[west, south], [west + size, south], [west + size, south + size], [west, south + size], [west, south]]


def collection(properties: Any, geometry: Any = None) -> str:
    """Return a GeoJSON of a sound building and one of these properties, or of that geometry."""
    sound = {"type": "Feature", "properties": {"height": 12}, "geometry": {"type": "Polygon", "coordinates": [box()]}}
    other = geometry or {"type": "Polygon", "coordinates": [box(WEST + 0.002)]}
    features = [sound, {"type": "Feature", "properties": properties, "geometry": other}]
    return json.dumps({"type": "FeatureCollection", "features": features})


TEXTS: dict[str, str | bytes] = {
    **{
        "nothing": "",
        "a null": "null",
        "a number": "5",
        "a list": "[]",
        "an object": "{}",
        "blanks": " \n\t",
        "zeros": b"\0" * 999,
    },
    **{
        "noise": bytes(range(256)) * 9,
        "a cut one": collection({})[:-40],
        "latin-1": '{"type": "\xe9'.encode("latin-1"),
    },
    **{"deep lists": "[" * DEEP, "deep objects": '{"a":' * DEEP, "deep and whole": "[" * DEEP + "]" * DEEP},
    "a deep property": collection({}).replace('"properties": {}', '"properties": {"a": ' + "[" * 999 + "]" * 999 + "}"),
    "xml": "<osm><way id='1'><nd ref='9'/></way></osm>",
    "an entity bomb": '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;">]><osm>&c;</osm>',
    "no features": '{"type": "FeatureCollection", "features": []}',
    "features as text": '{"type": "FeatureCollection", "features": "none"}',
}
PROPERTIES: dict[str, Any] = {
    "a list for a height": {"height": [1, 2]},
    "an object for a height": {"height": {"m": 3}},
    "lists for all": {"height": ["a"], "building": ["yes"], "levels": [[3]], "min_height": [None], "layer": [0]},
    "an infinite height": {"height": 1e308},
    "a long height": {"height": "9" * 10_000},
    "true for a height": {"height": True},
    "a height of nan": {"height": "nan"},
    "no properties": None,
    "a negative height": {"height": -5},
    "minutes for a height": {"height": "1e3000"},
}
GEOMETRIES: dict[str, Any] = {
    "coordinates beyond floats": {"type": "Polygon", "coordinates": [box(1e300)]},
    "null coordinates": {"type": "Polygon", "coordinates": None},
    "texts for coordinates": {"type": "Polygon", "coordinates": [[["a", "b"]] * 4]},
    "an open ring of two": {"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]},
    "a ring within itself": {"type": "Polygon", "coordinates": [[box()[i] for i in (0, 2, 1, 3, 0)]]},
    "no type": {"coordinates": [box()]},
    "another type": {"type": "Ball", "coordinates": [box()]},
    "a collection of collections": {
        "type": "GeometryCollection",
        "geometries": [{"type": "GeometryCollection", "geometries": []}],
    },
}


def write(name: str, content: str | bytes, buildings: str, more: str, folder: Path) -> None:
    """Write a file and a scenario that names it."""
    data = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
    (folder / name).write_bytes(data)
    scenario(folder, buildings, more)


def of_texts() -> Iterator[Case]:
    """Yield junk in place of every kind of file that is text."""
    orbits = '[population]\nblocks = "blocks.geojson"\n'
    for (told, content), suffix in itertools.product(
        TEXTS.items(), (".geojson", ".osm", ".gpkg", ".parquet", ".pbf", ".shp", ".tif")
    ):
        codes = TOLD if told == "a deep property" else REFUSED
        yield Case(f"buildings{suffix}: {told}", MAPS, partial(write, f"b{suffix}", content, f"b{suffix}", ""), codes)
    for told, content in TEXTS.items():
        yield Case(f"blocks: {told}", MAPS, partial(write_sound, "blocks.geojson", content, orbits))
        yield Case(f"orbits: {told}", MAPS, partial(write_sound, "o.tle", content, "", "orbits = 'o.tle'\n"))
        yield Case(
            f"zones.geojson: {told}", (*PLAN, "--no-fly", "{in}/z.geojson"), partial(put, "z.geojson", content), TOLD
        )
        yield Case(f"zones.kml: {told}", (*PLAN, "--no-fly", "{in}/z.kml"), partial(put, "z.kml", content), TOLD)
        for suffix in (".geojson", ".csv", ".parquet", ".kml"):
            yield Case(
                f"routes{suffix}: {told}",
                ("tune", "{base}", "{in}/r" + suffix, "-o", "{out}"),
                partial(put, f"r{suffix}", content),
            )
        yield Case(f"scenario: {told}", ("maps", "{in}/s.toml", "-o", "{out}"), partial(put, "s.toml", content))
    for told, properties in PROPERTIES.items():
        yield Case(
            f"building with {told}", MAPS, partial(write, "b.geojson", collection(properties), "b.geojson", ""), TOLD
        )
        yield Case(
            f"zone with {told}",
            (*PLAN, "--no-fly", "{in}/z.geojson"),
            partial(put, "z.geojson", zone(properties)),
            TOLD,
        )
        yield Case(
            f"route with {told}",
            ("tune", "{base}", "{in}/r.geojson", "-o", "{out}"),
            partial(put, "r.geojson", route(properties)),
        )
    for told, geometry in GEOMETRIES.items():
        yield Case(
            f"building of {told}", MAPS, partial(write, "b.geojson", collection({}, geometry), "b.geojson", ""), TOLD
        )
        yield Case(
            f"zone of {told}",
            (*PLAN, "--no-fly", "{in}/z.geojson"),
            partial(put, "z.geojson", collection({}, geometry)),
            TOLD,
        )


def zone(properties: Any) -> str:
    """Return a no-fly zone far from the route, with properties as they are named there."""
    named = {
        "lower": 0,
        "upper": 100,
        **{("upper" if name == "height" else name): value for name, value in (properties or {}).items()},
    }
    return json.dumps(
        {
            "type": "Feature",
            "properties": named,
            "geometry": {"type": "Polygon", "coordinates": [box(-73.9999, 40.7588, 1e-5)]},
        }
    )


def route(properties: Any) -> str:
    """Return a line with properties as routes carry them."""
    named = {("altitude_m" if name == "height" else name): value for name, value in (properties or {}).items()}
    return json.dumps(
        {
            "type": "Feature",
            "properties": named | {"time": [1], "weights": [2]},
            "geometry": {"type": "LineString", "coordinates": [[WEST, SOUTH]] * 2},
        }
    )


def put(name: str, content: str | bytes, folder: Path) -> None:
    """Write a file."""
    (folder / name).write_bytes(content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content)


def write_sound(name: str, content: str | bytes, more: str, gps: str, folder: Path | None = None) -> None:
    """Write a file that a scenario of sound buildings names."""
    folder, gps = (Path(gps), "") if folder is None else (folder, gps)
    put(name, content, folder)
    put("b.geojson", collection({"height": 20}), folder)
    scenario(folder, "b.geojson", gps + more)


def write_raster(
    values: Any, transform: Affine | None, crs: str | None, role: str, folder: Path, **options: Any
) -> None:
    """Write a raster in the part of buildings, terrain or people."""
    values = np.atleast_2d(np.asarray(values))
    transform = transform or Affine(10, 0, X, 0, -10, Y + 10 * values.shape[0])
    shape = {"count": 1, "height": values.shape[0], "width": values.shape[1], "dtype": values.dtype}
    with rasterio.open(folder / "r.tif", "w", driver="GTiff", crs=crs, transform=transform, **shape, **options) as file:
        file.write(values, 1)
    put("b.geojson", collection({"height": 20}), folder)
    more = {
        "terrain": '[terrain]\nsource = "r.tif"\n',
        "blocks": '[population]\nblocks = "r.tif"\n',
        "layer": '[layers.n]\nsource = "r.tif"\ncost = "high-is-bad"\nscale = [0, 80]\n',
    }
    scenario(folder, "r.tif" if role == "buildings" else "b.geojson", more.get(role, ""))


def of_rasters() -> Iterator[Case]:
    """Yield rasters of no place, no area, no CRS, no values."""
    flat = np.ones((60, 60), np.float32) * 5
    for role in ("buildings", "terrain", "blocks", "layer"):
        for told, transform in {
            "pixels without width": Affine(0, 0, X, 0, -10, Y),
            "pixels without area": Affine(10, 10, X, 10, 10, Y),
            "pixels of nan": Affine(float("nan"), 0, X, 0, -10, Y),
            "endless pixels": Affine(1e300, 0, X, 0, -1e300, Y),
            "tiny pixels": Affine(1e-300, 0, X, 0, -1e-300, Y),
            "a place beyond the globe": Affine(10, 0, 1e12, 0, -10, 1e12),
        }.items():
            yield Case(f"{role} with {told}", MAPS, partial(write_raster, flat, transform, UTM, role))
        for told, crs in {
            "a local CRS": LOCAL_CRS,
            "no CRS": None,
            "degrees": "EPSG:4326",
            "earth-centred metres": "EPSG:4978",
        }.items():
            yield Case(f"{role} in {told}", MAPS, partial(write_raster, flat, None, crs, role))
        for told, values in {
            "nan alone": flat * np.nan,
            "infinity": flat * np.inf,
            "huge values": flat * 1e37,
            "one pixel": flat[:1, :1],
            "complex values": flat.astype(np.complex64),
        }.items():
            codes = (
                TOLD
                if (role, told)
                in (
                    ("layer", "huge values"),
                    ("layer", "nan alone"),
                    ("layer", "infinity"),
                    ("blocks", "huge values"),
                    ("blocks", "one pixel"),
                )
                else REFUSED
            )
            yield Case(f"{role} of {told}", MAPS, partial(write_raster, values, None, UTM, role), codes)


def blocks_frame(ids: Any, crs: str | None = UTM, **fields: Any) -> geopandas.GeoDataFrame:
    """Return three blocks over the region."""
    x = X + 100.0 * np.arange(len(ids))
    return geopandas.GeoDataFrame(
        {"GEOID10": ids, **fields}, geometry=shapely.box(x, Y + 100, x + 100, Y + 300), crs=crs
    )


def write_blocks(frame: geopandas.GeoDataFrame, table: str | None, folder: Path, strip: Callable | None = None) -> None:
    """Write census blocks, and the table of their people where there is one."""
    put("b.geojson", collection({"height": 20}), folder)
    frame.to_parquet(folder / "blocks.parquet")
    if strip is not None:
        data = pq.read_table(folder / "blocks.parquet")
        pq.write_table(strip(data), folder / "blocks.parquet")
    more = ""
    if table is not None:
        put("t.csv", table, folder)
        more = 'table = "t.csv"\n'
    scenario(folder, "b.geojson", f'[population]\nblocks = "blocks.parquet"\n{more}')


def without_primary(data: Any) -> Any:
    """Return a GeoParquet whose metadata name a column that is not there."""
    meta = {**data.schema.metadata}
    meta[b"geo"] = meta[b"geo"].replace(b"geometry", b"geomatry")
    return data.replace_schema_metadata(meta)


IDS = [360610001001000, 360610001001001, 360610001001002]


def of_people() -> Iterator[Case]:
    """Yield blocks and tables as spreadsheets leave them."""
    counts = {
        **{"signs": ["+5", "+6", "+7"], "blanks": ["1 200", " 7 ", "8"], "exponents": ["1e3", "2E+2", "3"]},
        **{
            "minus": ["-5", "-6", "-7"],
            "words": ["many", "few", "none"],
            "nothing": ["", "", ""],
            "nan": ["nan", "NaN", "inf"],
        },
        **{"huge": ["9" * 400] * 3, "lists": ["[1]", "[2]", "[3]"], "thousands": ["1,200", "1.200,5", "1'200"]},
    }
    ids = {
        **{"whole": IDS, "floats": [float(i) for i in IDS], "broken floats": [i + 0.5 for i in (1, 2, 3)]},
        **{
            "texts of floats": [f"{i}.0" for i in IDS],
            "exponents": [f"{i:.4E}" for i in IDS],
            "gaps": [IDS[0], None, None],
        },
    }
    for told, values in counts.items():
        rows = "".join(f'{i},"{value}"\n' for i, value in zip(IDS, values, strict=True))
        yield Case(
            f"counts with {told}",
            MAPS,
            partial(write_blocks, blocks_frame(list(map(str, IDS))), "GEOID,population\n" + rows),
            TOLD,
        )
        yield Case(
            f"counts in blocks with {told}",
            MAPS,
            partial(write_blocks, blocks_frame(list(map(str, IDS)), POP10=values), None),
            TOLD,
        )
    for (told, values), (other, keys) in itertools.product(ids.items(), ids.items()):
        rows = "".join(f"{key},{n}\n" for n, key in enumerate(keys, start=1))
        yield Case(
            f"ids as {told}, in the table as {other}",
            MAPS,
            partial(write_blocks, blocks_frame(values), "GEOID,population\n" + rows),
            TOLD,
        )
    sound = blocks_frame(list(map(str, IDS)), POP10=[1, 2, 3])
    for told, strip in {
        "no primary column": without_primary,
        "no metadata": lambda data: data.replace_schema_metadata({}),
        "junk for metadata": lambda data: data.replace_schema_metadata({b"geo": b"{"}),
        "empty metadata": lambda data: data.replace_schema_metadata({b"geo": b"{}"}),
        "no geometry": lambda data: data.drop_columns(["geometry"]),
    }.items():
        yield Case(f"GeoParquet with {told}", MAPS, partial(write_blocks, sound, None, strip=strip))
    for crs in (LOCAL_CRS, "EPSG:4978", None):
        yield Case(
            f"blocks in {crs}",
            MAPS,
            partial(write_blocks, blocks_frame(list(map(str, IDS)), crs, POP10=[1, 2, 3]), None),
        )


def of_tables() -> Iterator[Case]:
    """Yield tables of queries and instances with holes, lists, texts, numbers beyond all measure."""
    sound: dict[str, Any] = {
        "start_lon": -73.999,
        "start_lat": 40.7555,
        "goal_lon": -73.9955,
        "goal_lat": 40.7585,
        "altitude_m": 20.0,
        "w_gps": 1.0,
    }
    queries = "--queries", "{in}/q.csv"
    for name, value in itertools.product(sound, ("", "x", 1e300, "nan", -1e300, "[1]")):
        table = pd.DataFrame([sound | {name: value}])
        yield Case(
            f"a query with {name} {value!r}",
            ("tune", "{base}", "{in}/q.csv", "-o", "{out}"),
            partial(put, "q.csv", table.to_csv(index=False)),
        )
        yield Case(
            f"sensitivity with {name} {value!r}",
            ("sensitivity-study", "{base}", "-o", "{out}", "--samples", "0", "--workers", "1", *queries),
            partial(put, "q.csv", table.to_csv(index=False)),
            TOLD,
        )
