"""City models, and folders and archives of these and of vector files, which are joined."""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

from jaxurban import settings
from jaxurban.cities.bodies import outlines_of
from jaxurban.cities.citygml import read_citygml
from jaxurban.cities.cityjson import read_cityjson
from jaxurban.cities.outlines import Near, Outlines, joined_outlines
from jaxurban.cities.vector import VECTOR_SUFFIXES, read_vector
from jaxurban.errors import GuessWarning, InputError, readable, warn
from jaxurban.io.broken import BROKEN
from jaxurban.io.files import UNPACKING, visible_files
from jaxurban.io.sniff import (
    DATABASE,
    MOST_TIMES,
    MOST_UNPACKED,
    in_own_words,
    most_unpacked,
    scratch_folder,
    sniff,
    unpacked,
)

READERS = {".gml": read_citygml, ".city.json": read_cityjson}
ARCHIVE = ".zip"
MEMBER_BYTES = 2**14  # that each counts more, for the time that a file takes
# Pages, and indexes of Shapefiles, which begin as these do.
BESIDE = (".htm", ".html", ".shx", ".sbn", ".sbx")


def read_tiles(
    path: Path,
    near: Near | None = None,
    file: settings.Buildings | None = None,
    crs: str | None = None,
) -> Outlines:
    """Return the objects of city models (see `bodies_of`) and the features of vector files as outlines.

    Args:
      path: a file of CityGML or CityJSON, packed or not, or a folder or an archive of such files, of vector files (see
        `read_vector`), and of archives.
      near, file: as of `read_vector`; city models are read as a whole, and have no columns to name.
      crs: of all coordinates, in place of the one that the files declare.

    Raises:
      InputError: no such file among others, of which a warning says how many they are, one that cannot be read or has
        a format that is known and not read, an archive with more in it than `most_unpacked`, or files in several
        CRSs; as of `outlines_of` and `read_vector`.
    """
    bodies: list[dict[str, Any]] = []
    crs_names: set[str] = set()
    tables = []
    kinds = {}  # of each file by its name
    for name, tile in _files(path, str(path)):
        kind = kinds[name] = _tile_kind(name, tile)
        if kind in READERS:
            bodies += _read_model(name, tile, kind, crs_names)
        elif kind in VECTOR_SUFFIXES:
            tables.append(read_vector(tile, near, file, crs))
    if bodies:
        tables.append(outlines_of(path, bodies, {crs} if crs else crs_names - {""}))
    if not kinds:
        raise InputError(f"{str(path)!r} is empty: name the file of buildings, or a folder of maps")
    if not tables:
        raise InputError(
            f"{str(path)!r} holds no object of CityGML or CityJSON and no outlines: name the file of buildings"
        )

    # What is beside them, but for the companions of Shapefiles.
    stems = {Path(name).stem for name, kind in kinds.items() if kind == ".shp"}
    read = (*READERS, *VECTOR_SUFFIXES)
    others = [name for name in kinds if kinds[name] not in read and Path(name).stem not in stems]
    if others:
        warn(
            f"{len(others)} files in {str(path)!r}, such as {others[0]!r}, hold no city model and no outlines, and are "
            "left out",
            GuessWarning,
        )
    return joined_outlines(path, tables)


def _tile_kind(name: str, tile: Path) -> str:
    """Return what a file is, as of `sniff`; nothing of what stands beside others (`BESIDE`).

    Args:
      name: of the file, for messages.
      tile: its path, or that of its content in an archive.

    Raises:
      InputError: a format that is known and not read, or an archive that `_files` could not open.
    """
    if tile.suffix.lower() in BESIDE:
        return ""
    try:
        kind = sniff(tile)
    except InputError as error:
        raise InputError(str(error).replace(str(tile), name)) from error
    if kind == ARCHIVE:
        raise InputError(f"{name!r} is an archive that is damaged: fetch it again")
    return kind


def _read_model(name: str, tile: Path, kind: str, crs_names: set[str]) -> list[dict[str, Any]]:
    """Return the bodies of a city model (see `bodies_of`).

    Args:
      name, tile: as of `_tile_kind`; the model may be packed.
      kind: its format, of `READERS`.
      crs_names: gets what the model names as its CRS.

    Raises:
      InputError: it cannot be read.
    """
    with (
        readable(tile, "a city model", "fetch it again", ExpatError, what=repr(name)),
        unpacked(tile) as plain,
    ):
        try:
            with in_own_words():
                return list(READERS[kind](plain, crs_names))
        except InputError as error:
            raise InputError(f"{name!r} {error}") from error


def _files(path: Path, name: str, room: int = MOST_UNPACKED) -> Iterator[tuple[str, Path]]:
    """Yield the names and paths of all files and databases in a folder or an archive; of another file its own.

    Args:
      path: of it, and ``name`` for messages.
      room: how many bytes archives in it may hold.

    Raises:
      InputError: an archive that is damaged or holds more.
    """
    if path.name.lower().endswith((DATABASE, f"{DATABASE}.zip")):
        yield name, path
    elif path.is_dir():
        files = [
            file.parent if file.parent.suffix.lower() == DATABASE else file
            for file in visible_files(path)
        ]
        for file in dict.fromkeys(files):
            yield from _files(file, f"{name}/{file.relative_to(path).as_posix()}", room)
    elif zipfile.is_zipfile(path):
        with (
            readable(
                path,
                "an archive",
                "unpack it yourself if you trust it, and name the folder",
                *BROKEN,
                *UNPACKING,
                what=repr(name),
            ),
            scratch_folder() as folder,
            zipfile.ZipFile(path) as archive,
        ):
            num_bytes = sum(member.file_size + MEMBER_BYTES for member in archive.infolist())
            rest_of_room = min(room, most_unpacked(path)) - num_bytes
            if rest_of_room < 0:
                raise ValueError(
                    f"it unpacks to more than {MOST_TIMES} times its size or {MOST_UNPACKED / 2**30:g} GiB, with "
                    f"{MEMBER_BYTES >> 10} kB for each of its {len(archive.infolist()):,} files"
                )
            archive.extractall(folder)
            yield from _files(folder, name, rest_of_room)
    else:
        yield name, path
