"""Files that come into a folder all together or not at all, and over nobody else's."""

import json
import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxurban.errors import InputError, reason_of
from jaxurban.io.files import SCRATCH_SUFFIX, check_writable, digest_of, only_writer

RECORD_FILE = "fetch.json"
SCENARIO_FILE = "scenario.toml"
STAGE_PREFIX = ".fetch."
ELSEWHERE = "choose another folder with -o"


@contextmanager
def staged(folder: Path, names: Collection[str], *, overwrite: bool) -> Iterator[Path]:
    """Yield a scratch folder whose files move into ``folder`` if the block succeeds, the scenario last.

    Args:
      folder: where to; made if it is not there.
      names: the files that may come.
      overwrite: replace what is there under these names; else only what an earlier fetch wrote, and nobody changed.

    Raises:
      InputError: a file of these names is in the way, or the folder cannot be written to.
    """
    _check_way(folder, names, overwrite)
    check_writable(folder)
    with only_writer(folder, ELSEWHERE):
        for scrap in folder.glob(f"{STAGE_PREFIX}*{SCRATCH_SUFFIX}"):  # of a killed run
            shutil.rmtree(scrap, ignore_errors=True)
        stage = Path(tempfile.mkdtemp(SCRATCH_SUFFIX, STAGE_PREFIX, folder))
        try:
            yield stage
            for path in sorted(stage.iterdir(), key=lambda path: path.name == SCENARIO_FILE):
                target = folder / path.name
                try:
                    os.replace(path, target)
                except OSError as error:
                    raise InputError(f"cannot write {str(target)!r} ({reason_of(error)}): {ELSEWHERE}") from error
        finally:
            shutil.rmtree(stage, ignore_errors=True)


def _check_way(folder: Path, names: Collection[str], overwrite: bool) -> None:
    """Raise InputError if something of these names may not be replaced."""
    there = [folder / name for name in names if os.path.lexists(folder / name)]
    if blocked := [path for path in there if path.is_dir()]:
        raise InputError(f"a folder is in the way of the file {str(blocked[0])!r}: move it, or {ELSEWHERE}")
    if overwrite:
        return
    written = _written(folder / RECORD_FILE)
    if foreign := [path for path in there if not _is_as_written(path, written)]:
        raise InputError(
            f"{str(foreign[0])!r} is there already, and not as an earlier fetch wrote it: {ELSEWHERE}, "
            "or replace it with --overwrite"
        )


def _written(record: Path) -> dict[str, str]:
    """Return the SHA-256 of each file that the fetch of a record wrote, the record's own among them."""
    try:
        return json.loads(record.read_text(encoding="utf-8"))["written"] | {record.name: digest_of(record)}
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return {}


def _is_as_written(path: Path, written: dict[str, str]) -> bool:
    try:
        return written.get(path.name) == digest_of(path)
    except OSError:
        return False
