"""What was downloaded from a public source, checked before it enters the cache: its kind, and whether it is whole."""

import json
import math
import re
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import BinaryIO

import geopandas as gpd
import numpy as np
import osmium
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.fetch.download import UnfitError
from jaxurban.io.fetch.http import megabytes
from jaxurban.io.read.districts import read_districts
from jaxurban.io.read.orbits import read_orbits
from jaxurban.io.read.osm import header_box, read_osm
from jaxurban.io.read.vector import open_frame
from jaxurban.world.diagnostics import ReadIssue

HEAD_BYTES = 1000
PBF_MOST_HEADER_BYTES = 64 << 10  # of a blob's header, by the format's rules
# At the end of a blob's header, in protobuf's encoding (tag 24, seven bits a byte): how many bytes of data follow.
PBF_LENGTH = re.compile(rb"\x18([\x80-\xff]*[\x00-\x7f])\Z")
SHAPEFILE_PARTS = (".shp", ".shx", ".dbf", ".prj")
BLOCK_ID = re.compile(r"([0-9]{15})$")  # state 2, county 3, tract 6, block 4 digits; anything may stand before
COUNTY_DIGITS = 5
COUNT = re.compile(r"[0-9]+(\.0*)?")
BLOCK_FIELDS = ("GEOID20", "GEOID10", "GEOID")


def osm_format(path: Path) -> str:
    """Return ``"osm"`` (XML) or ``"pbf"`` for a whole OpenStreetMap file of that kind.

    Raises:
      UnfitError: another kind of file, one that is cut off, or an error message of the Overpass API.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        if b"OSMHeader" in head[:20]:
            file.seek(0)
            _walk_blobs(file, size)
            return "pbf"
        if b"<osm" not in head:
            raise UnfitError(f"it is neither OSM XML nor PBF, but {_what(head)}")
        file.seek(max(0, size - HEAD_BYTES))
        tail = file.read()
    # With status 200 the Overpass API sends what it had when its time or memory ran out.
    if remark := re.search(rb"<remark>\s*(.*?)\s*</remark>", head + tail, re.DOTALL):
        said = remark[1].decode("utf-8", "replace")
        raise UnfitError(f"the server says {said!r}: ask for a smaller region, or later")
    if not tail.rstrip().endswith(b"</osm>"):
        raise UnfitError("it is OSM XML that is cut off before its end")
    return "osm"


def _walk_blobs(file: BinaryIO, size: int) -> None:
    """Check that the blobs of a PBF file fill it exactly."""
    place = 0
    while place < size:
        file.seek(place)
        header_bytes = int.from_bytes(file.read(4), "big")
        header = file.read(header_bytes) if header_bytes <= PBF_MOST_HEADER_BYTES else b""
        length = PBF_LENGTH.search(header)
        if length is None:
            raise UnfitError(f"it is an OSM PBF file that is damaged or cut off at byte {place:,}")
        data_bytes = sum((byte & 0x7F) << 7 * i for i, byte in enumerate(length[1]))
        place += 4 + header_bytes + data_bytes
    if place != size:
        raise UnfitError(f"it is an OSM PBF file that is cut off: {size:,} bytes of {place:,} or more")


def check_osm(path: Path) -> None:
    """Check that an OpenStreetMap file can be read to its end, and, in XML, that it holds buildings.

    An extract, which is PBF, is cut to the region first: `check_buildings` then looks at what is left.

    Raises:
      UnfitError: another kind of file, a damaged one, or one without a whole building.
      InputError: the XML is damaged.
    """
    file_format = osm_format(path)
    try:
        header_box(path, file_format)
        if file_format == "pbf":
            with osmium.io.Reader(osmium.io.File(str(path), "pbf")) as reader:
                osmium.apply(reader, osmium.filter.EmptyTagFilter())  # unpacks every block; each bears its own checksum
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
        raise UnfitError(f"it is an OSM file that is damaged ({error})") from error
    if file_format == "osm":
        check_buildings(path, "osm")


def check_buildings(path: Path, file_format: str) -> None:
    """Check that an OpenStreetMap file, read as the maps will read it, holds a building.

    Raises:
      UnfitError: it holds none, or none with its nodes.
      InputError: it cannot be read to its end.
    """
    outlines = read_osm(path, file_format)
    if any(polygon is not None and not polygon.is_empty for polygon in outlines.polygons):
        return
    if num_bare := outlines.issues[ReadIssue.WAYS_WITH_MISSING_NODES]:
        raise UnfitError(f"it has {num_bare:,} buildings but not their nodes: ask for them too, as with (._;>;)")
    raise UnfitError("it has no building in the region: check --bounds, longitude first")


def read_block_zip(path: Path, most_bytes: int) -> gpd.GeoDataFrame:
    """Return the blocks of a zipped Shapefile: their id, as ``GEOID``, and their polygons.

    Raises:
      UnfitError: not a zip file, a damaged one, one that would unpack to more than ``most_bytes``, or no blocks in it.
      InputError: the Shapefile in it cannot be read.
    """
    if not zipfile.is_zipfile(path):
        raise UnfitError(f"it is not a zip file, but {_what(path.read_bytes()[:HEAD_BYTES])}")
    with tempfile.TemporaryDirectory() as folder:
        try:
            _unpack(path, Path(folder), most_bytes)
        except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError, ValueError) as error:
            reason = str(error).replace(f"{folder}/", "")
            raise UnfitError(f"it is a zip file that is damaged or cannot be unpacked ({reason})") from error
        try:
            frame = open_frame(next(Path(folder).rglob("*.[sS][hH][pP]")), "blocks")
        except InputError as error:
            raise UnfitError(str(error).replace(f"{folder}/", "")) from error
    field = next((name for name in BLOCK_FIELDS if name in frame.columns), None)
    if field is None:
        raise UnfitError(f"its fields are {', '.join(map(str, frame.columns))}, none of {', '.join(BLOCK_FIELDS)}")
    _check_ids(frame[field])
    return frame[[field, "geometry"]].rename(columns={field: "GEOID"})


def _unpack(path: Path, folder: Path, most_bytes: int) -> None:
    """Unpack the Shapefile of a zip, checking the CRC of each part."""
    with zipfile.ZipFile(path) as archive:
        parts = [info for info in archive.infolist() if Path(info.filename).suffix.lower() in SHAPEFILE_PARTS]
        if sorted(Path(info.filename).suffix.lower() for info in parts) != sorted(SHAPEFILE_PARTS):
            raise UnfitError(
                f"the zip does not hold one Shapefile, but {', '.join(archive.namelist()[:8]) or 'nothing'}"
            )
        if sum(info.file_size for info in parts) > most_bytes:
            raise UnfitError(f"it unpacks to more than {megabytes(most_bytes)}: raise --max-size")
        archive.extractall(folder, parts)


def read_counts(path: Path) -> tuple[pd.DataFrame, bool]:
    """Return a table of population by block, as text, and whether the server has more to send.

    It is what TIGERweb sends (JSON), or a CSV with a column of 15-digit block ids.

    Raises:
      UnfitError: neither, an error message of TIGERweb, or ids or counts that are not.
    """
    text = path.read_bytes().decode("utf-8-sig", "replace")
    if text.lstrip()[:1] in ("{", "["):
        content = _json(text)
        if not isinstance(content, dict) or not isinstance(content.get("features"), list):
            said = content.get("error", content) if isinstance(content, dict) else content
            raise UnfitError(f"it is JSON without features: {str(said)[:200]}")
        try:
            rows = [(str(row["attributes"]["GEOID"]), str(row["attributes"]["POP100"])) for row in content["features"]]
        except (KeyError, TypeError) as error:
            raise UnfitError(f"a feature of it lacks GEOID and POP100 ({error})") from error
        table = pd.DataFrame(rows, columns=["GEOID", "POP100"], dtype=str)
        _check_ids(table["GEOID"])
        if bad := [f"{count!r} in block {block}" for block, count in rows if not COUNT.fullmatch(count)]:
            raise UnfitError(f"its POP100 is {bad[0]}: it must be a number of people")
        return table, bool(content.get("exceededTransferLimit"))
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8-sig", index_col=False)
    except (ValueError, OSError) as error:
        raise UnfitError(f"it is neither JSON nor CSV, but {_what(text.encode())}") from error
    if not _block_ids(table).size:
        raise UnfitError(f"no column of it holds 15-digit block ids; it is {_what(text.encode())}")
    return table, False


def counties_of(table: pd.DataFrame) -> list[str]:
    """Return the five-digit ids of the counties whose blocks a table names."""
    return sorted(set(_block_ids(table).str[:COUNTY_DIGITS]))


def _block_ids(table: pd.DataFrame) -> pd.Series:
    columns = [table[name].astype(str).str.extract(BLOCK_ID)[0].dropna() for name in table]
    return max(columns, key=len, default=pd.Series(dtype=str))


def _check_ids(column: pd.Series) -> None:
    if bad := [block for block in column.astype(str) if not BLOCK_ID.fullmatch(block)]:
        raise UnfitError(f"it has the block id {bad[0][:40]!r}: a block's id has 15 digits")


def check_districts(path: Path, crs: str, field: str) -> None:
    """Check that a file is GeoJSON, whole, with polygons and their labels.

    Args:
      path: the file.
      crs: projected CRS of the region.
      field: of the labels.

    Raises:
      UnfitError: it is not.
      InputError: it cannot be read, or its labels are not whole numbers.
    """
    text = path.read_bytes().decode("utf-8-sig", "replace")
    content = _json(text) if text.lstrip()[:1] == "{" else None
    if not isinstance(content, dict) or not content.get("features"):
        raise UnfitError(f"it is not GeoJSON with features, but {_what(text.encode())}")
    polygons, _, _ = read_districts(path, crs, field)
    if not (len(polygons) and np.isfinite(shapely.get_coordinates(polygons)).all()):
        raise UnfitError("it holds no polygons on this globe")


def orbits_suffix(path: Path) -> str:
    """Return the suffix that fits a file of element sets: ``.csv``, ``.json``, ``.xml`` or ``.tle``.

    Raises:
      UnfitError: a web page.
      InputError: the element sets cannot be read to their end.
    """
    head = path.read_bytes()[:HEAD_BYTES]
    if _is_web_page(head):
        raise UnfitError(f"it is {_what(head)}")
    read_orbits(path)
    first = head.lstrip()[:1]
    return {b"{": ".json", b"[": ".json", b"<": ".xml"}.get(first, ".csv" if b"MEAN_MOTION" in head else ".tle")


def _json(text: str) -> object:
    """Return what a JSON text says; other than Python's reader it takes no NaN and no infinite number."""

    def refuse(word: str) -> float:
        raise ValueError(f"{word[:20]} is not a number of JSON")

    def finite(digits: str) -> float:
        return value if math.isfinite(value := float(digits)) else refuse(digits)

    try:
        return json.loads(text, parse_constant=refuse, parse_float=finite)
    except RecursionError as error:
        raise UnfitError("it is JSON that is nested too deep") from error
    except ValueError as error:
        raise UnfitError(f"it is JSON that is cut off or damaged ({error})") from error


def _is_web_page(head: bytes) -> bool:
    return re.search(rb"<!doctype html|<html", head[:HEAD_BYTES], re.IGNORECASE) is not None


def _what(head: bytes) -> str:
    """Return what the beginning of a file looks like, for messages."""
    if not head.strip():
        return "empty"
    text = head[:HEAD_BYTES].decode("utf-8", "replace")
    if _is_web_page(head):
        words = " ".join(re.sub(r"<(script|style|head).*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL).split())
        return f"a web page ({words[:120]!r})"
    return f"something that begins with {text[:40]!r}"
