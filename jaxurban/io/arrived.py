"""What arrived from a public source, looked at before it enters the cache: its kind, and whether it is whole."""

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
from jaxurban.grid import Bounds
from jaxurban.io.districts import read_districts
from jaxurban.io.download import UnfitError
from jaxurban.io.orbits import read_orbits
from jaxurban.io.osm import read_osm
from jaxurban.io.vectorfile import open_frame
from jaxurban.io.webrequest import megabytes

HEAD_BYTES = 1000
PBF_MOST_HEADER_BYTES = 64 << 10  # of a blob's header, by the format's rules
PBF_LENGTH_FIELD = 3  # of a blob's header: how many bytes of data follow
SHAPEFILE_PARTS = (".shp", ".shx", ".dbf", ".prj")
BLOCK_ID = re.compile(r"([0-9]{15})$")  # state 2, county 3, tract 6, block 4 digits; anything may stand before
COUNTY_DIGITS = 5
COUNT = re.compile(r"[0-9]+(\.0*)?")
BLOCK_FIELDS = ("GEOID20", "GEOID10", "GEOID")


def osm_suffix(path: Path) -> str:
    """Return ``".osm"`` or ``".osm.pbf"`` for a whole OpenStreetMap file of that kind.

    Raises:
      UnfitError: another kind of file, one that is cut off, or an error message of the Overpass API.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        if b"OSMHeader" in head[:20]:
            file.seek(0)
            _walk_blobs(file, size)
            return ".osm.pbf"
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
    return ".osm"


def _walk_blobs(file: BinaryIO, size: int) -> None:
    """Check that the blobs of a PBF file fill it exactly."""
    place = 0
    while place < size:
        file.seek(place)
        header_bytes = int.from_bytes(file.read(4), "big")
        header = file.read(header_bytes) if header_bytes <= PBF_MOST_HEADER_BYTES else b""
        data_bytes = _number_in(header, PBF_LENGTH_FIELD)
        if data_bytes is None:
            raise UnfitError(f"it is an OSM PBF file that is damaged or cut off at byte {place:,}")
        place += 4 + header_bytes + data_bytes
    if place != size:
        raise UnfitError(f"it is an OSM PBF file that is cut off: {size:,} bytes of {place:,} or more")


def _number_in(message: bytes, wanted_field: int) -> int | None:
    """Return a whole number of a protobuf message, None where it has none or is cut off."""
    place = 0

    def varint() -> int:
        nonlocal place
        value = shift = 0
        while True:
            byte = message[place]
            place += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    try:
        while place < len(message):
            field, kind = divmod(varint(), 8)
            value = varint()  # of a text it is the length
            if kind == 2:
                place += value
            elif field == wanted_field:
                return value
    except IndexError:
        return None
    return None


def check_osm(path: Path) -> None:
    """Check that an OpenStreetMap file can be read to its end, and, in XML, that it holds buildings.

    An extract, which is PBF, is cut to the region first: `check_buildings` then looks at what is left.

    Raises:
      UnfitError: another kind of file, a damaged one, or one without a whole building.
      InputError: the XML is damaged.
    """
    suffix = osm_suffix(path)
    osm_box(path, suffix)
    if suffix == ".osm":
        check_buildings(path, "osm")
        return
    try:
        with osmium.io.Reader(osmium.io.File(str(path), "pbf")) as reader:
            osmium.apply(reader, osmium.filter.EmptyTagFilter())  # unpacks every block; each bears its own checksum
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
        raise UnfitError(f"it is an OSM PBF file that is damaged ({error})") from error


def check_buildings(path: Path, file_format: str) -> None:
    """Check that an OpenStreetMap file, read as the maps will read it, holds a building.

    Raises:
      UnfitError: it holds none, or none with its nodes.
      InputError: it cannot be read to its end.
    """
    outlines = read_osm(path, file_format)
    if any(polygon is not None and not polygon.is_empty for polygon in outlines.polygons):
        return
    if num_bare := outlines.faults["ways_with_missing_nodes"]:
        raise UnfitError(f"it has {num_bare:,} buildings but not their nodes: ask for them too, as with (._;>;)")
    raise UnfitError("it has no building in the region: check --bounds, longitude first")


def osm_box(path: Path, suffix: str) -> Bounds | None:
    """Return west, south, east, north of an OSM file by its header, None where the header does not say.

    Raises:
      UnfitError: the header is damaged.
    """
    try:
        with osmium.io.Reader(osmium.io.File(str(path), suffix.rpartition(".")[2]), osmium.osm.NOTHING) as reader:
            box = reader.header().box()
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
        raise UnfitError(f"its header cannot be read ({error})") from error
    if not box.valid():
        return None
    return box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat


def read_block_zip(path: Path, most_bytes: int) -> gpd.GeoDataFrame:
    """Return the blocks of a zipped Shapefile: their id, as ``GEOID``, and their polygons.

    Raises:
      UnfitError: no zip, a damaged one, one that would unpack to more than ``most_bytes``, or no blocks in it.
      InputError: the Shapefile in it cannot be read.
    """
    if not zipfile.is_zipfile(path):
        raise UnfitError(f"it is no zip file, but {_what(path.read_bytes()[:HEAD_BYTES])}")
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

    It is what TIGERweb answers (JSON), or a CSV with a column of 15-digit block ids.

    Raises:
      UnfitError: neither, an error message of TIGERweb, or ids or counts of it that are none.
    """
    text = path.read_bytes().decode("utf-8-sig", "replace")
    if text.lstrip()[:1] in ("{", "["):
        answer = _json(text)
        if not isinstance(answer, dict) or not isinstance(answer.get("features"), list):
            said = answer.get("error", answer) if isinstance(answer, dict) else answer
            raise UnfitError(f"it is JSON without features: {str(said)[:200]}")
        try:
            rows = [(str(row["attributes"]["GEOID"]), str(row["attributes"]["POP100"])) for row in answer["features"]]
        except (KeyError, TypeError) as error:
            raise UnfitError(f"a feature of it lacks GEOID and POP100 ({error})") from error
        table = pd.DataFrame(rows, columns=["GEOID", "POP100"], dtype=str)
        _check_ids(table["GEOID"])
        if bad := [f"{count!r} in block {block}" for block, count in rows if not COUNT.fullmatch(count)]:
            raise UnfitError(f"its POP100 is {bad[0]}: it must be a number of people")
        return table, bool(answer.get("exceededTransferLimit"))
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
      InputError: it cannot be read, or its labels are no whole numbers.
    """
    text = path.read_bytes().decode("utf-8-sig", "replace")
    answer = _json(text) if text.lstrip()[:1] == "{" else None
    if not isinstance(answer, dict) or not answer.get("features"):
        raise UnfitError(f"it is no GeoJSON with features, but {_what(text.encode())}")
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
        raise ValueError(f"{word[:20]} is no number of JSON")

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
    """Return in words what the beginning of a file looks like."""
    if not head.strip():
        return "empty"
    text = head[:HEAD_BYTES].decode("utf-8", "replace")
    if _is_web_page(head):
        words = " ".join(re.sub(r"<(script|style|head).*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL).split())
        return f"a web page ({words[:120]!r})"
    return f"something that begins with {text[:40]!r}"
