"""What an output folder already holds for a job: its own maps, whole or broken, or another job's."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.io.damage import broken_chunks, has_whole_metadata

HEAD_BYTES = 1 << 16  # of a GeoTIFF: its tags


def stored_key(folder: Path, resolution_m: float) -> str | None:
    """Return the run key of the maps that lie under ``folder``, None without any, or where they are damaged."""
    if resolution_m not in store.stored_resolutions(folder):
        return None
    try:
        return store.open_zarr(folder, resolution_m).attrs.get("run_key")
    except InputError:
        return None


def _witnesses(folder: Path, resolution_m: float) -> Iterator[Path]:
    """Yield files that name the run which made the maps of a resolution."""
    yield store.zarr_path(folder, resolution_m) / "zarr.json"
    yield folder / store.RUN_FILE
    yield from (folder / store.GEOTIFF_FOLDER).glob(f"*_{store.short_number(resolution_m)}m.tif")


def _names(file: Path, key: str) -> bool:
    try:
        with file.open("rb") as stream:
            return key.encode() in stream.read(HEAD_BYTES)
    except OSError:
        return False


def _is_of(folder: Path, resolution_m: float, key: str) -> bool:
    """Return whether the maps of a resolution are a job's; damaged ones are, where a file still names it."""
    found = stored_key(folder, resolution_m)
    if found is not None:
        return found == key
    return any(_names(file, key) for file in _witnesses(folder, resolution_m))


def has_other_maps(folder: Path, key: str) -> bool:
    """Return whether a folder holds maps of other settings or inputs."""
    return not all(_is_of(folder, resolution_m, key) for resolution_m in store.stored_resolutions(folder))


def prepare_folder(folder: Path, key: str, resolutions_m: Iterable[float]) -> None:
    """Make the output folder ready: remove another job's maps, sweep what a killed run left but for its tiles.

    Raises:
      InputError: a file is where a folder of maps belongs.
    """
    for path in (folder / store.ZARR_FOLDER, folder / store.GEOTIFF_FOLDER):
        if path.exists() and not path.is_dir():
            raise InputError(f"{str(path)!r} is a file where the maps' folder belongs: move it")
    unfinished = [resolution_m for resolution_m in resolutions_m if stored_key(folder, resolution_m) != key]
    store.sweep_scraps(folder, keep=[store.work_path(folder, resolution_m) for resolution_m in unfinished])
    if has_other_maps(folder, key):
        store.remove_maps(folder)


def broken_files(folder: Path, resolution_m: float, num_threads: int) -> list[Path]:
    """Return the files of the maps of a resolution that are missing or not as they were written; all are read."""
    path = store.zarr_path(folder, resolution_m)
    if not path.exists():
        return []
    if not has_whole_metadata(path):
        return [path / "zarr.json"]
    return [chunk.file for chunk in broken_chunks(path, num_threads)]
