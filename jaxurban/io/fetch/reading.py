"""What was downloaded, read as the maps will read it: the check of its kind, and of whether it is whole."""

import io
import json
import re
import tempfile
import zipfile
from datetime import date
from pathlib import Path

import geopandas as gpd
import osmium
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.fetch.download import UnfitError, megabytes
from jaxurban.io.read.districts import read_districts
from jaxurban.io.read.orbits import read_orbits
from jaxurban.io.read.osm import read_osm
from jaxurban.io.read.vector import open_frame
from jaxurban.world.diagnostics import ReadIssue

MOST_AGE_DAYS = 90  # of element sets: what a scenario accepts unless it sets another
SHAPEFILE_PARTS = (".shp", ".shx", ".dbf", ".prj")
BLOCK_ID = r"([0-9]{15})$"  # state 2, county 3, tract 6, block 4 digits; anything may stand before
COUNTY_DIGITS = 5
COUNT = r"[0-9]+(\.0*)?"
BLOCK_FIELDS = ("GEOID20", "GEOID10", "GEOID")


def osm_format(path: Path) -> str:
    """Return ``"osm"`` (XML) or ``"pbf"`` of a whole OpenStreetMap file; one of XML holds a building.

    An extract, which is PBF, is cut to the region first: `check_buildings` then looks at what is left.

    Raises:
      UnfitError: an error message of the Overpass API, or no building.
      RuntimeError, InputError: another kind of file, or a damaged one.
    """
    with path.open("rb") as file:
        head, end = file.read(1000), file.seek(0, 2)
        file.seek(max(0, end - 1000))
        tail = file.read()
    if b"OSMHeader" in head[:20]:
        with osmium.io.Reader(osmium.io.File(str(path), "pbf")) as reader:
            osmium.apply(reader, osmium.filter.EmptyTagFilter())  # unpacks every block; each bears its own checksum
        return "pbf"
    # With status 200 the Overpass API sends what it had when its time or memory ran out.
    if remark := re.search(rb"<remark>\s*(.*?)\s*</remark>", head + tail, re.DOTALL):
        said = remark[1].decode("utf-8", "replace")
        raise UnfitError(f"the server says {said!r}: ask for a smaller region, or later")
    check_buildings(path, "osm")
    return "osm"


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
      UnfitError: it would unpack to more than ``most_bytes``, or holds no Shapefile of blocks.
      zipfile.BadZipFile, OSError: another kind of file, or a damaged one.
    """
    with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory() as folder:
        parts = [info for info in archive.infolist() if Path(info.filename).suffix.lower() in SHAPEFILE_PARTS]
        if sum(info.file_size for info in parts) > most_bytes:
            raise UnfitError(f"it unpacks to more than {megabytes(most_bytes)}: raise --max-size")
        archive.extractall(folder, parts)
        shapes = list(Path(folder).rglob("*.[sS][hH][pP]"))
        if len(shapes) != 1:
            raise UnfitError(f"the zip does not hold one Shapefile, but {', '.join(archive.namelist()[:8])}")
        try:
            frame = open_frame(shapes[0], "blocks")
        except InputError as error:
            raise UnfitError(str(error).replace(f"{folder}/", "")) from error
    field = next((name for name in BLOCK_FIELDS if name in frame.columns), None)
    if field is None:
        raise UnfitError(f"its fields are {', '.join(map(str, frame.columns))}, none of {', '.join(BLOCK_FIELDS)}")
    _check(frame[field].astype(str), BLOCK_ID, "block id", "a block's id has 15 digits")
    return frame[[field, "geometry"]].rename(columns={field: "GEOID"})


def read_counts(path: Path) -> tuple[pd.DataFrame, bool]:
    """Return a table of population by block, as text, and whether the server has more to send.

    It is what TIGERweb sends (JSON), or a CSV with a column of 15-digit block ids.

    Raises:
      UnfitError: an error message of TIGERweb, or ids or counts that are not.
      ValueError, LookupError, TypeError: another kind of file, or a damaged one.
    """
    text = path.read_bytes().decode("utf-8-sig", "replace")
    if not text.lstrip().startswith("{"):
        table = pd.read_csv(io.StringIO(text), dtype=str, keep_default_na=False, index_col=False)
        if not _block_ids(table).size:
            raise UnfitError(f"no column of it holds 15-digit block ids; it begins with {text[:40]!r}")
        return table, False
    content = json.loads(text)
    if "features" not in content:
        raise UnfitError(f"it is JSON without features: {str(content.get('error', content))[:200]}")
    rows = [[str(row["attributes"][name]) for name in ("GEOID", "POP100")] for row in content["features"]]
    table = pd.DataFrame(rows, columns=["GEOID", "POP100"], dtype=str)
    _check(table["GEOID"], BLOCK_ID, "block id", "a block's id has 15 digits")
    _check(table["POP100"], COUNT, "POP100", "it must be a number of people")
    return table, bool(content.get("exceededTransferLimit"))


def counties_of(table: pd.DataFrame) -> list[str]:
    """Return the five-digit ids of the counties whose blocks a table names."""
    return sorted(set(_block_ids(table).str[:COUNTY_DIGITS]))


def _block_ids(table: pd.DataFrame) -> pd.Series:
    columns = [table[name].astype(str).str.extract(BLOCK_ID)[0].dropna() for name in table]
    return max(columns, key=len, default=pd.Series(dtype=str))


def _check(column: pd.Series, pattern: str, what: str, rule: str) -> None:
    if bad := column[~column.str.fullmatch(pattern)].tolist():
        raise UnfitError(f"it has the {what} {bad[0][:40]!r}: {rule}")


def read_geojson(path: Path, crs: str, field: str) -> None:
    """Read the polygons of districts and their labels, in a field, from GeoJSON; ``crs`` is the region's projected one.

    Raises:
      UnfitError: not GeoJSON, or no polygon with an area.
      InputError: it cannot be read, or its labels are not whole numbers.
    """
    with path.open("rb") as file:
        if not file.read(100).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
            raise UnfitError("it is not GeoJSON")
    if not len(read_districts(path, crs, field)[0]):
        raise UnfitError("it holds no polygons on this globe")


def check_orbits(path: Path, day: date | None) -> None:
    """Read element sets, and check their age on the day of the maps, if any.

    Raises:
      UnfitError: they are too old.
      InputError: the element sets cannot be read to their end.
    """
    satellites = read_orbits(path).satellites
    age_days = 0 if day is None else max(abs((one.epoch.utc_datetime().date() - day).days) for one in satellites)
    if age_days > MOST_AGE_DAYS:
        raise UnfitError(
            f"it has elements {age_days} days away from {day}, and SGP4 is not trusted beyond "
            f"{MOST_AGE_DAYS}: choose a --date near them, or leave orbits out of --what"
        )


def orbits_suffix(path: Path) -> str:
    """Return the suffix that fits a file of element sets: ``.csv``, ``.json``, ``.xml`` or ``.tle``."""
    text = path.read_bytes()
    first = text.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    return {b"{": ".json", b"[": ".json", b"<": ".xml"}.get(first, ".csv" if b"MEAN_MOTION" in text else ".tle")
