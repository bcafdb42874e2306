"""What a folder of maps holds, by its record of files: looked at without xarray, in a moment."""

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from jaxurban.errors import InputError, not_there, reason_of
from jaxurban.io.files import SCRATCH_SUFFIX, read_json
from jaxurban.io.workspace import recorded
from jaxurban.public import listed

RUN_FILE = "run.json"
REPORT_FILE = "report.md"  # of a study or a check
ZARR_FOLDER = "maps.zarr"
GEOTIFF_FOLDER = "geotiff"
DONE_FOLDER, ZARR = (
    "done",
    "zarr",
)  # of unfinished maps: the marks of steps, and the step that makes the Zarr
METADATA = ".zmetadata"  # of a Zarr: its metadata and those of its arrays once more
# Files by which a Zarr is known, of version 3 the last.
OF_ZARR = (METADATA, ".zattrs", ".zgroup", "zarr.json")


def short_number(value: float) -> str:
    """Return a number as file names carry it: ``5``, ``2.5``."""
    return f"{value:g}"


def zarr_path(folder: Path, resolution_m: float) -> Path:
    """Return where the maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f"{short_number(resolution_m)}m"


NUMBER_M = r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)m"  # as `short_number` writes it


def stored_resolutions(folder: Path) -> dict[float, Path]:
    """Return the folders of the Zarrs under ``folder`` that its record names and that are there.

    Returns:
      Paths such as ``maps.zarr/5m`` by resolution in metres, in ascending order; empty without a record.

    Raises:
      InputError: the record cannot be read.
    """
    pattern = re.compile(rf"{ZARR_FOLDER}/{NUMBER_M}/{METADATA}")
    matches = filter(None, map(pattern.fullmatch, recorded(folder)))
    paths = {float(match[1]): (folder / match[0]).parent for match in matches}
    return {resolution_m: path for resolution_m, path in sorted(paths.items()) if path.is_dir()}


def work_paths(folder: Path) -> list[Path]:
    """Return where unfinished maps lie under an output folder, those of each resolution (`work_path`)."""
    return sorted((folder / ZARR_FOLDER).glob(f".*m{SCRATCH_SUFFIX}"))


def stored_maps(folder: Path) -> dict[float, Path]:
    """Return the folders of the Zarrs under ``folder``, as of `stored_resolutions`, of which there is one at least.

    Raises:
      InputError: there are none, or a file is in the folder's place.
    """
    if folder.is_file():
        raise InputError(f"{str(folder)!r} is a file: give the folder that holds the maps")
    if not os.path.exists(folder):  # which raises nothing, whatever the name
        raise InputError(
            f"{not_there(folder)}, or make maps there with `jaxurban maps SCENARIO -o {folder}`"
        )
    paths = stored_resolutions(folder)
    if not paths:
        _check_unfinished(folder)
        folders = [repr(str(each)) for each in folders_of_maps(folder)]
        if folders:
            raise InputError(
                f"{str(folder)!r} holds no maps itself, but folders of maps: name one of them, {listed(folders)}"
            )
        lack = "holds no metric maps, or not their checksums.json"
        if not any(folder.iterdir()):
            lack = "is empty"
        raise InputError(
            f"{str(folder)!r} {lack}: make them with `jaxurban maps SCENARIO -o {folder}`"
        )
    return paths


def folders_of_maps(folder: Path) -> list[Path]:
    """Return the folders in a folder that hold maps, as those of several scenarios do."""
    if not folder.is_dir():
        return []
    return [each for each in sorted(folder.iterdir()) if (each / ZARR_FOLDER).is_dir()]


def num_tiles_in(work: Path) -> tuple[int, int]:
    """Return how many tiles of unfinished maps are there, and how many there will be; none before their Zarr is there.

    Args:
      work: one of `work_paths`.
    """
    done = work / DONE_FOLDER
    with suppress(OSError, ValueError, LookupError):  # made by another version, too
        return len([*done.glob("tile_*")]), read_json(done / f"{ZARR}.json")["num_tiles"]
    return 0, 0


def unfinished_said(folder: Path) -> str:
    """Return how far unfinished maps under a folder are, and what goes on with them; empty where all are finished."""
    finished = stored_resolutions(folder)
    states = [f"{short_number(resolution_m)} m is finished" for resolution_m in finished]
    for work in work_paths(folder):
        num_done, num_tiles = num_tiles_in(work)
        resolution = work.name.removeprefix(".").removesuffix(f"m{SCRATCH_SUFFIX}")
        state = "is not begun"
        if num_tiles:
            state = f"has {num_done} of {num_tiles} tiles"
        if 0 < num_tiles == num_done:
            state += ", and files are still to be written"
        states.append(f"{resolution} m {state}")
    if len(states) == len(finished):
        if (folder / RUN_FILE).exists() or not are_of_a_run(folder):
            return ""
        states.append(f"{RUN_FILE} is still to be written")
    return f"{'; '.join(states)}: the same `jaxurban maps` command goes on, if none is at work"


def _check_unfinished(folder: Path) -> None:
    """Raise InputError where unfinished maps lie under a folder, with how many of their tiles there are."""
    state = unfinished_said(folder)
    if state:
        raise InputError(f"{str(folder)!r} holds unfinished maps: {state}")


def root_files(folder: Path) -> list[Path]:
    """Return the files of the group above the resolutions, by which xarray and GDAL open all of them."""
    return [folder / ZARR_FOLDER / name for name in (".zgroup", METADATA)]


def are_of_a_run(folder: Path) -> bool:
    """Return whether maps under ``folder`` are those of ``jaxurban maps``, which writes `RUN_FILE` too."""
    files = [path / METADATA for path in stored_resolutions(folder).values()]
    return any(b'"run_key"' in file.read_bytes() for file in files if file.is_file())


def stored_settings(folder: Path) -> dict[str, Any]:
    """Return the settings of the run that made the maps in ``folder``, from `RUN_FILE`.

    They are empty where the maps were saved from Python, or where there are none.

    Raises:
      InputError: the file is damaged, or it is missing though a run made the maps, which may not have ended.
    """
    try:
        return read_json(folder / RUN_FILE)["settings"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        is_missing = isinstance(error, FileNotFoundError)
        if is_missing and not are_of_a_run(folder):
            return {}
        if is_missing:
            _check_unfinished(folder)
        raise InputError(
            f"{str(folder / RUN_FILE)!r}, with the settings of the maps, cannot be read ({reason_of(error)}): run the "
            "same `jaxurban maps` command again, which writes it again"
        ) from error


def work_path(folder: Path, resolution_m: float) -> Path:
    """Return where the unfinished maps of one resolution lie under an output folder."""
    return folder / ZARR_FOLDER / f".{short_number(resolution_m)}m{SCRATCH_SUFFIX}"
