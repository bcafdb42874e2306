"""A folder that one run of a command has for itself: nothing is replaced there but what the same run wrote."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxurban.errors import InputError
from jaxurban.io import seal
from jaxurban.io.landing import sha256_of
from jaxurban.io.store import LOCK_FILE, SCRATCH_SUFFIX, check_writable, only_writer, whole_file

RECORD_FILE = "made.json"  # whose folder it is, what was asked, and what was written
ELSEWHERE = "choose another folder with -o"


@contextmanager
def own_folder(folder: Path, command: str, asked: Mapping[str, Any], *, overwrite: bool = False) -> Iterator[None]:
    """Hold a folder, made if it is not there, for one run that writes all its files under it.

    Args:
      folder: where the run writes.
      command: that runs.
      asked: what decides its answer, as JSON holds it; the same again goes on, or writes the same again.
      overwrite: remove what this command wrote there for another question.

    Raises:
      InputError: the folder cannot be written to, another run holds it, it is another command's or answers another
        question, or it holds files that this command did not write, or that were changed since.
    """
    told = json.loads(json.dumps({"command": command, "asked": asked}))
    check_writable(folder)
    with only_writer(folder, ELSEWHERE):
        _claim(folder, told, overwrite)
        _write(folder, told, None)
        try:
            yield
        finally:
            _write(folder, told, {name: sha256_of(folder / name) for name in _names(folder)})


def _names(folder: Path) -> list[str]:
    files = sorted(path for path in folder.rglob("*") if not path.is_dir())
    return [
        path.relative_to(folder).as_posix()
        for path in files
        if path.name not in (RECORD_FILE, LOCK_FILE) and not path.name.endswith(SCRATCH_SUFFIX)
    ]


def _write(folder: Path, told: Mapping[str, Any], written: dict[str, str] | None) -> None:
    with whole_file(folder / RECORD_FILE) as scratch:
        seal.write_json(scratch, {**told, "written": written}, indent=2)


def _claim(folder: Path, told: Mapping[str, Any], overwrite: bool) -> None:
    """Raise InputError unless the folder is empty or this run's; with ``overwrite``, empty one of another question."""
    names, command = _names(folder), told["command"]
    try:
        held = seal.read_json(folder / RECORD_FILE)
        before, written = held["asked"], held["written"]
    except FileNotFoundError:
        if names:
            raise InputError(
                f"{str(folder / names[0])!r} is there already, and not from `jaxurban {command}`: {ELSEWHERE}"
            ) from None
        return
    except (OSError, ValueError, LookupError) as error:
        raise InputError(
            f"{str(folder / RECORD_FILE)!r}, which tells whose folder it is, cannot be read ({error}): {ELSEWHERE}, or "
            "remove this one"
        ) from error
    if held["command"] != command:
        raise InputError(f"{str(folder)!r} holds what `jaxurban {held['command']}` wrote: {ELSEWHERE}")
    # Where a run was killed nobody wrote down what it made; it began in a folder without others' files.
    foreign = [name for name in names if written is not None and written.get(name) != sha256_of(folder / name)]
    if foreign:
        raise InputError(
            f"{str(folder / foreign[0])!r} is not as `jaxurban {command}` wrote it: move it, or {ELSEWHERE}"
        )
    differing = [name for name in told["asked"] if told["asked"][name] != before.get(name)]
    if differing and not overwrite:
        name = differing[0]
        raise InputError(
            f"{str(folder)!r} holds another run of `jaxurban {command}` (its {name} is {before.get(name)}, and "
            f"{told['asked'][name]} is asked for now): {ELSEWHERE}, or pass --overwrite to replace it"
        )
    if overwrite:
        for name in names:
            (folder / name).unlink()
