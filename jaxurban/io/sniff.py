"""What a file is: by its first bytes and keys, not by its name alone. Packed files are unpacked."""

import bz2
import gzip
import re
import shlex
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from jaxurban.errors import InputError, readable
from jaxurban.io.files import UNPACKING, remove

DATABASE = ".gdb"  # of Esri: a folder, or packed as .gdb.zip
PANIC = "PanicException"  # of libraries in Rust, under a module of its own each
LIDAR = ".laz"  # of LAS and COPC too
FLOWN = (".plan", ".waypoints", ".wpml", ".ulg")  # missions and logs of flights
HEAD_BYTES = 1 << 16  # that are looked at; GDAL looks at fewer
MOST_UNPACKED = 20 * 2**30  # bytes in a packed file
MOST_TIMES = 100  # its size; text of cities takes up to some 40
ALWAYS_UNPACKED = 2**24  # bytes, whatever the size
OLD_S = 7 * 86_400.0  # no run is as long: such a folder is of one that was killed
PACKED: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open}
BEFORE = b"\xef\xbb\xbf \t\r\n\x1e"  # may come before a text, the mark of UTF-8 too
# Of XML, before its first element, but for a DOCTYPE with declarations of its own.
PROLOG = re.compile(rb"<!--.*?-->|<\?[^>]*>|<![^>\[]*>", re.DOTALL)
WKT_COLUMNS = "wkt,geometry,geom,the_geom,wkt_geom,geometry_wkt"  # in tables, as GDAL takes them
# Any JSON before the first key or word that shows that it is GeoJSON.
_JSON = rb'\{(?:(?!"(?:Feature|FeatureCollection|features|geometry|properties|coordinates)").)*'
_ROOT = rb"<[<\s]*(?:[\w.-]+:)?"
# A table with a column of WKT.
_TABLE = rb"(?i:[^\r\n\0]*\b(?:%s)\b[^\r\n]*[\r\n].*" % WKT_COLUMNS.replace(",", "|").encode()
_ARCHIVE = "an archive: unpack it with `%s FILE`, and name the file that was in it"
_INAV = "a mission of INAV: make KML of it with `mission2kml -home LAT,LON,ALT FILE > mission.kml` of bbl2kml"
# How a file begins: the suffix that such files bear, or what it is and the line that helps.
FORMATS = {
    rb"PAR1": ".parquet",
    rb"fgb": ".fgb",
    rb"\0\0\x27\x0a": ".shp",
    rb"....\n\tOSMHeader": ".pbf",
    rb"SQLite format 3\0.{52}\0{4}": ".sqlite",  # SpatiaLite
    rb"SQLite format 3": ".gpkg",
    rb"PK\x03\x04": ".zip",
    rb"7z\xbc\xaf\x27\x1c": _ARCHIVE % "7z x",
    rb".{257}ustar": _ARCHIVE % "tar -xf",
    rb"LASF.{98}\0\0": LIDAR,  # one with 65,536 records or more is damaged, and laspy would not come to their end
    rb"ULog\x01\x12\x35": ".ulg",
    rb"\xa3\x95|FMT, ?128|\0[\4-\7].{6}[\xfd\xfe]": "a log of ArduPilot: make GPX of it with "
    "`TZ=UTC mavtogpx.py FILE` of pymavlink",
    rb"\x1f\x9d": "a file of Unix compress: unpack it with `gzip -dS .Z FILE`, and name the file that was in it",
    rb"\xb5b": "UBX of a u-blox receiver: make RINEX of it with `convbin -r ubx FILE`",
    rb"% (?:program|obs|inp)": "a solution of RTKLIB: write it in UTC (`rnx2rtkp -u`), and make a table with `awk "
    '\'BEGIN {print "utc,lon_deg,lat_deg"} !/^%/ {gsub("/", "-", $1); print $1 "T" $2 "Z," $4 "," $3}\' '
    "FILE > track.csv`",
    rb"\d+ +\S+\.(?i:alm|al3)?\s*\n *\d+ +\d+\s*\n": "a SEM almanac: take the YUMA almanac of the "
    "same week, which navcen.uscg.gov holds too, and make element sets of that with the lines under 'Almanacs' in "
    "docs/guides/formats.md; or take broadcast RINEX or SP3 of that day, which igs.bkg.bund.de holds",
    rb"\*+ *Week +\d+ +almanac": "a YUMA almanac: make element sets of it with the lines under 'Almanacs' in "
    "docs/guides/formats.md; or take broadcast RINEX or SP3 of that day, which igs.bkg.bund.de holds",
    rb"(?:#[^\n]*\n\s*)*QGC WPL": ".waypoints",
    rb"[<\s]*<!DOCTYPE": "XML with a DOCTYPE, which is never read: remove it from the file",
    _ROOT + rb"osm\b": ".osm",
    _ROOT + rb"osmChange\b": "a list of changes to OpenStreetMap: apply it to a whole extract with "
    "`osmium apply-changes -o changed.osm.pbf EXTRACT FILE`",
    rb"\xff\xfe|\xfe\xff": "text in UTF-16: make UTF-8 of it with `iconv -f UTF-16 -t UTF-8 FILE > FILE.utf8`",
    # Waylines of DJI; a template of them is KML that no drone flies.
    _ROOT + rb"kml\b[^>]*/wpmz/(?!.*templateType)": ".wpml",
    _ROOT + rb"kml\b": ".kml",
    _ROOT + rb"gpx\b": ".gpx",
    _ROOT + rb"CityModel\b": ".gml",
    rb"(?i:%smission\b)" % _ROOT: _INAV,
    _JSON + rb'"mission"\s*:\s*\[': _INAV,
    _JSON + rb'"(?:fileType|groundStation|geoFence|rallyPoints|mission"\s*:\s*\{)': ".plan",
    rb"(?i:<[<\s]*html\b)": "a web page: fetch the file again, and look at what the server says",
    _JSON + rb'"City(?:JSON|JSONFeature|Objects)"': ".city.json",
    _JSON + rb'"(?:osm3s|elements)"\s*:': ".osm.json",
    # A whole feature in the first line, or one that is longer than what is looked at.
    _JSON + rb'(?<!\n)"Feature"[^\n]*(?:\}\r?\n|\Z)': ".geojsonl",
    rb"\{": ".geojson",
    _TABLE + rb"\bSRID=\d+;)": "a table of EWKT: make WKT of it with "
    "`sed -E 's/SRID=[0-9]+;//' FILE > wkt.csv` if its coordinates are longitude and latitude",
    _TABLE + rb"(?:POLYGON|SURFACE)\b)": ".csv",
    rb"(?i:(?=[^\r\n]*,)[^\r\n\0]*\blat)": ".txt",
    rb"(?:#[^\n]*\n\s*)*\[[a-z_]+(?:\.\w+)*\]\s": "settings in TOML, as a scenario's: `jaxurban maps` and "
    "`jaxurban study` read a scenario, and here a file of another kind is asked for",
}


@contextmanager
def in_own_words(*errors: type[Exception]) -> Iterator[None]:
    """Say that a file is damaged, in place of what a library says of it; what the system says passes.

    Args:
      errors: what the block raises of a damaged file, beside OSError and `BROKEN`.

    Raises:
      ValueError: the file is damaged.
    """
    from jaxurban.io.broken import BROKEN  # imported here: it brings Shapely

    caught = (OSError, *BROKEN, *errors)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="pyogrio")
            yield
    except BaseException as error:
        is_caught = isinstance(error, caught) or type(error).__name__ == PANIC
        if not is_caught or isinstance(error, InputError) or getattr(error, "errno", None):
            raise
        raise ValueError("it is damaged or cut short, or holds what is not read") from error


def sniff(path: str | Path, data: bytes | None = None) -> str:
    """Return the suffix that files with such content bear, of a packed file that of what is in it.

    Bytes that are given count in place of the file's, of which the name alone is then looked at.

    It is one of ``.osm``, ``.pbf`` and ``.osm.json`` (OpenStreetMap), ``.geojson``, ``.geojsonl`` (one feature a
    line), ``.csv`` (with outlines as WKT), ``.fgb``, ``.gpkg``, ``.parquet``, ``.shp``, ``.kml``, ``.gpx``, ``.gml``
    (CityGML), ``.city.json`` (CityJSON, in lines too), ``.sqlite`` (SpatiaLite), ``.gdb`` (Esri's folder, packed as
    ``.gdb.zip`` or not), ``.laz`` (lidar points, of LAS and COPC too), ``.plan``, ``.waypoints``, ``.wpml``, ``.ulg``,
    ``.txt`` (a table of places) and ``.zip``; empty for any other content.

    Raises:
      InputError: no such file, a packed one that is damaged, or a format that is known and not read; the message
        names it and the line that converts it.
    """
    path = Path(path)
    if path.name.lower().endswith((DATABASE, f"{DATABASE}.zip")) and path.exists():
        return DATABASE
    if path.is_dir():
        return ""
    if data is None:
        with (
            readable(path, "a file", "fetch it again"),
            in_own_words(*UNPACKING),
            (_opener(path) or open)(path, "rb") as file,
        ):
            data = file.read(HEAD_BYTES)
    text = PROLOG.sub(b"<", data[:HEAD_BYTES].lstrip(BEFORE))
    for beginning, what in FORMATS.items():
        if re.match(beginning, text, re.DOTALL):
            if not what.startswith("."):
                raise InputError(f"{str(path)!r} is {what.replace('FILE', shlex.quote(str(path)))}")
            return what
    return ""


def _opener(path: Path) -> Callable[..., Any] | None:
    """Return what opens a packed file, by its first bytes; None of any other."""
    with path.open("rb") as file:
        start = file.read(3)
    return next((PACKED[mark] for mark in PACKED if start.startswith(mark)), None)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a folder for temporary files that ends with the block; those of runs that were killed long ago end too."""
    for old in Path(tempfile.gettempdir()).glob("jaxurban-unpacked-*"):
        with suppress(OSError):  # another run may remove it now
            if time.time() - old.lstat().st_mtime > OLD_S:
                remove(old)
    with tempfile.TemporaryDirectory(prefix="jaxurban-unpacked-") as folder:
        yield Path(folder)


def most_unpacked(path: Path) -> int:
    """Return how many bytes a packed file may hold: `MOST_TIMES` its size, and never more than `MOST_UNPACKED`."""
    return min(MOST_UNPACKED, ALWAYS_UNPACKED + MOST_TIMES * path.stat().st_size)


@contextmanager
def unpacked(path: str | Path) -> Iterator[Path]:
    """Yield the path of a file with the content of another: itself, or a temporary one if it is packed.

    Raises:
      InputError: as `sniff`, or a packed file with more in it than `most_unpacked`.
      ValueError: a packed file that is damaged.
    """
    path = Path(path)
    opener = None if path.is_dir() else _opener(path)
    if opener is None:
        yield path
        return
    with scratch_folder() as folder:
        plain = folder / f"unpacked{sniff(path)}"
        with (
            in_own_words(*UNPACKING),
            opener(path) as source,
            plain.open("wb") as target,
        ):
            while block := source.read(HEAD_BYTES):
                target.write(block)
                if target.tell() > most_unpacked(path):
                    raise InputError(
                        f"{str(path)!r} unpacks to more than {MOST_TIMES} times its size or "
                        f"{MOST_UNPACKED / 2**30:g} GiB: unpack it yourself if you trust it"
                    )
        yield plain
