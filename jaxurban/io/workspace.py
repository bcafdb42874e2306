"""Workspace: a folder that commands write into, and the record of every file by its checksum as it was written.

A command removes or replaces only files that this record holds and whose bytes are still those; all else is the
user's. Each output is recorded by its own writer (`jaxurban.io.files.whole_file`) before it is put in place: in a
journal, a line each, which a killed run leaves behind, and at the end of the run in ``checksums.json``.
"""

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from jaxurban.errors import InputError, reason_of
from jaxurban.io.files import (
    ELSEWHERE,
    HELD,
    LOCK_FILE,
    RECORDER,
    SCRATCH_NAME,
    SCRATCH_SUFFIX,
    check_writable,
    checksum_of,
    during,
    is_as_written,
    only_writer,
    read_json,
    recorder_of,
    remove,
    write_json,
)
from jaxurban.progress import LOG

RECORD_FILE = "checksums.json"
JOURNAL_FILE = ".checksums.jsonl"
KEPT_FOLDER = "kept"  # where files go that were in the way of an output
LONGEST_SETTINGS = 200  # characters of two settings that differ, in an error
Each = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]  # `map`, or one on threads
Sections = dict[str, dict[str, Any]]  # by command: ``settings``, and ``written``, checksums by name
Differing = dict[str, tuple[Any, Any]]  # old and new value by dotted key, None for what is not set


@dataclass(frozen=True)
class Workspace:
    """A folder while one command writes there. Threads share it.

    Attributes:
      folder: where the command writes.
      command: without ``jaxurban``.
      settings: what decides its result, as JSON holds it.
      written: the checksum of each file as the command wrote it, by its name under the folder.
      is_mended: what it wrote and was changed since is set aside when it is written again.
    """

    folder: Path
    command: str
    settings: dict[str, Any] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    is_mended: bool = False

    @classmethod
    @contextmanager
    def open(
        cls,
        folder: Path,
        command: str,
        settings: Mapping[str, Any] | None = None,
        *,
        names: Iterable[str] = (),
        overwrite: bool = False,
        is_shared: bool = False,
        is_mended: bool = False,
    ) -> Iterator["Workspace"]:
        """Hold a folder for one run, and record what is written under it in the block.

        The folder is made if it is missing, and removed after the block if nothing was written into it.

        Args:
          folder: where the run writes.
          command: the command that runs, without ``jaxurban``.
          settings: what decides the result, as JSON holds it. A run with the settings of the run before goes on with
            its files, or writes the same again.
          names: of files under the folder that the run will write; what is at one of them must be this command's.
          overwrite: remove what this command wrote there before; with ``is_mended`` only if it is of other settings.
            What was changed since, or is not this command's, stays.
          is_shared: other commands and the user may have files in the folder. Otherwise it must be empty, or hold
            files of this command alone, all as they were written.
          is_mended: the files of ``names`` may have been changed since this command wrote them; what was changed is set
            aside when it is written again.

        Raises:
          InputError: the folder cannot be written to, another run holds it, it is another command's or of other
            settings, or it holds files in the way that this command did not write, or that were changed since.
        """
        # The settings as they will be read from the record: JSON makes lists of tuples.
        new_settings = json.loads(json.dumps(settings or {}))
        with _held(folder):
            sections = _sections(folder)
            is_first = command not in sections
            section = sections.setdefault(command, {"settings": {}, "written": {}})
            # The workspace alters the two dictionaries of its section in place, and `_save` writes them.
            workspace = cls(folder, command, section["settings"], section["written"], is_mended)

            # Checks come first, so that files of an earlier run are removed only if nothing is wrong.
            if not is_shared:
                workspace._check_alone(sections, is_first)
            workspace.check_way((folder / name for name in names), is_mended=is_mended)
            if not is_first:
                workspace._replace(new_settings, overwrite)
            if new_settings:
                workspace.settings.clear()
                workspace.settings.update(new_settings)
            _save(folder, sections)

            # The block of the caller, after which the record has what it wrote.
            try:
                with during(RECORDER, workspace):
                    yield workspace
            finally:
                _recover(folder, sections)
                if is_first and not workspace.written:
                    del sections[command]
                _save(folder, sections)

    @classmethod
    @contextmanager
    def shared(cls, folder: Path, command: str, names: Iterable[str] = ()) -> Iterator["Workspace"]:
        """Record the files that are written in the block.

        Within the run of another command that holds the folder they are recorded as that command's, and ``command`` and
        ``names`` do not matter. Otherwise the folder is opened for ``command`` and shared.

        Raises:
          InputError: as of `open`.
        """
        recorder = recorder_of(folder / RECORD_FILE)
        if recorder:
            yield recorder
            return
        with cls.open(folder, command, names=names, is_shared=True) as workspace:
            yield workspace

    @staticmethod
    def settings_of(folder: Path, command: str) -> dict[str, Any]:
        """Return the settings that a command last ran with in a folder, empty where there are none.

        Raises:
          InputError: the record of the folder cannot be read.
        """
        return _read(folder).get(command, {"settings": {}})["settings"]

    @classmethod
    def check(
        cls, folder: Path, command: str, names: Iterable[str] = (), *, is_shared: bool = False
    ) -> None:
        """Raise InputError if `open` would refuse a run that writes files of these names; nothing stays changed."""
        with cls.open(folder, command, names=names, is_shared=is_shared):
            pass

    @classmethod
    @contextmanager
    def held(cls, folder: Path, command: str) -> Iterator[None]:
        """Hold a folder while a run works that opens it when it saves; it stays unchanged until then.

        Raises:
          InputError: as of `check`.
        """
        cls.check(folder, command)
        with _held(folder), during(HELD, HELD.get() | {folder.resolve()}):
            yield

    def _check_alone(self, sections: Sections, is_first: bool) -> None:
        """Raise InputError unless the folder is this command's alone.

        Before the first run it must be empty. Later it may hold what this command wrote, unchanged, and files that no
        command wrote.

        Args:
          sections: the record of the folder.
          is_first: whether this command has never run there.
        """
        others = [command for command in sections if command != self.command]
        if others:
            raise InputError(
                f"{str(self.folder)!r} holds what `jaxurban {others[0]}` wrote: {ELSEWHERE}"
            )
        files = _files_under(self.folder) if is_first else []
        if files:
            raise InputError(
                f"{str(self.folder / files[0])!r} is there already, and not from `jaxurban {self.command}`: {ELSEWHERE}"
            )
        self.check_way(self.folder / name for name in self.written)

    def _replace(self, new_settings: Mapping[str, Any], overwrite: bool) -> None:
        """Remove what an earlier run wrote, where its settings were others or ``overwrite`` asks for it.

        Raises:
          InputError: the settings were others, files of the earlier run are there, and ``overwrite`` is False.
        """
        names = [name for name in new_settings if new_settings[name] != self.settings.get(name)]
        has_files = any(os.path.lexists(self.folder / name) for name in self.written)
        if names and has_files and not overwrite:
            first = names[0]
            pairs = differing({first: self.settings.get(first)}, {first: new_settings[first]})
            words = [
                f"its {key.replace('_', ' ')} is {old}, now {new}"
                for key, (old, new) in pairs.items()
            ]
            difference = "; ".join(words)
            if len(difference) > LONGEST_SETTINGS:
                difference = f"other {first.replace('_', ' ')}"
            raise InputError(
                f"{str(self.folder)!r} holds another run of `jaxurban {self.command}` ({difference}): {ELSEWHERE}, or "
                "pass --overwrite to replace it"
            )
        if names or (overwrite and not self.is_mended):
            self.remove_all()

    def name_of(self, path: Path) -> str | None:
        """Return the name of an output under the folder; None where a path is elsewhere, or in scratch of a writer."""
        place = self._place_of(path)
        if place is None or any(part.endswith(SCRATCH_SUFFIX) for part in place.parts):
            return None
        return place.as_posix()

    def _place_of(self, path: Path) -> PurePosixPath | None:
        """Return where a path is, relative to the folder; None if it is not under it.

        Links above the path, then links above the folder too, are followed only where the paths as they are written
        have nothing in common. The path itself is not followed: it may be a link in the way of an output.
        """
        written = os.path.abspath
        followed = os.path.realpath
        pairs = ((written, written), (written, followed), (followed, followed))
        for form_of_path, form_of_folder in pairs:
            absolute = Path(form_of_path(path.parent), path.name)
            with suppress(ValueError):  # it is elsewhere in these forms
                return PurePosixPath(absolute.relative_to(form_of_folder(self.folder)).as_posix())
        return None

    def _obstacle(self, path: Path) -> Path | None:
        """Return the first of the folders between this one and a path that is a link or no folder, if any is."""
        return _obstacle_in(self.folder, self._place_of(path) or PurePosixPath())

    def is_own(self, path: Path) -> bool:
        """Return whether a path is a file as this command wrote it; a link is not, nor a file behind a link."""
        name = self.name_of(path)
        if name not in self.written or os.path.islink(path) or self._obstacle(path):
            return False
        return is_as_written(path, [self.written[name]])

    def is_changed(self, path: Path) -> bool:
        """Return whether something is at a path that this command wrote, and it is not as it was written."""
        is_recorded = self.name_of(path) in self.written and os.path.lexists(path)
        return is_recorded and not self.is_own(path) and not self._obstacle(path)

    def broken(self, paths: Iterable[Path], each: Each = map) -> list[Path]:
        """Return which of some paths are missing, or are not as this command wrote them.

        Args:
          paths: the paths, all of whose files are read.
          each: calls a function with each path and returns the results in order, as `map` does; on several threads it
            is faster.
        """
        paths = list(paths)
        are_own = each(self.is_own, paths)
        return [path for path, is_own in zip(paths, are_own, strict=True) if not is_own]

    def check_way(
        self, paths: Iterable[Path], remedy: str = ELSEWHERE, *, is_mended: bool = False
    ) -> None:
        """Raise InputError if something that may not be replaced is at one of these paths, or in the way of its folder.

        Args:
          paths: under the folder, where outputs are to be written.
          remedy: ends the message, after "move it, or".
          is_mended: what this command wrote may be replaced even where it was changed since.
        """
        for path in paths:
            self._check_folders(path, remedy)
            is_replaceable = self.is_own(path) or (is_mended and self.is_changed(path))
            if os.path.lexists(path) and not is_replaceable:
                reason = f"it is not as `jaxurban {self.command}` wrote it"
                raise InputError(f"{str(path)!r} is in the way ({reason}): move it, or {remedy}")

    def _check_folders(self, path: Path, remedy: str = ELSEWHERE) -> None:
        """Raise InputError if a link or a file is in the way of a folder above a path; ``remedy`` ends the message."""
        obstacle = self._obstacle(path)
        if obstacle:
            kind = "link" if obstacle.is_symlink() else "file"
            raise InputError(
                f"{str(obstacle)!r} is a {kind} in the way of a folder: move it, or {remedy}"
            )

    def begin(self, scratch: Path) -> None:
        """Record the name of a file that is about to be written, so that it is swept if the run is killed.

        Raises:
          InputError: a link or a file is in the way of the folder that it lies in.
        """
        self._check_folders(scratch)
        self._note([{"scratch": str(self._place_of(scratch))}])

    def put(self, scratch: Path, path: Path) -> None:
        """Record a finished file under its name, and give it that name.

        A file of the user's with the same bytes stays the user's and is not recorded.

        Args:
          scratch: the finished file.
          path: its name to be, under the folder.

        Raises:
          InputError: something is there that this command did not write, or that was changed since; with `is_mended`
            what was changed since is set aside.
        """
        name = self.name_of(path)
        checksum = checksum_of(scratch)
        assert name is not None
        if not self.is_own(path):
            if is_as_written(path, [checksum]):
                return
            if self.is_mended and self.is_changed(path):
                self.set_aside(path)
            self.check_way([path])

        # The checksum is noted before the file gets its name, in case of a kill between the two.
        self._note([{"name": name, "checksum": checksum}])
        os.replace(scratch, path)
        self.written[name] = checksum

    def put_folder(self, made: Path, path: Path, checksums: Mapping[str, str], last: str) -> None:
        """Record the files of a finished folder, and give the folder its name.

        Where a folder of that name is there already, the files that this command wrote in it are removed. Files that
        were changed since are set aside, and files of others stay.

        Args:
          made: the finished folder.
          path: its name to be, under the folder of the workspace.
          checksums: of its files, by their names in it.
          last: the name of the file that readers look for first: it is removed before all others, and put last.

        Raises:
          InputError: a file of others is in the way of one of these.
        """
        prefix = self.name_of(path)
        written = {f"{prefix}/{name}": checksum for name, checksum in checksums.items()}
        paths = [self.folder / name for name in written]
        self.check_way(paths, is_mended=True)

        # Clear the way: files as this command wrote them are removed; what is left was changed, and is set aside.
        older = [name for name in self.written if name.startswith(f"{prefix}/")]
        self.remove([f"{prefix}/{last}", *older])
        for changed in filter(os.path.lexists, paths):
            self.set_aside(changed)

        # Record before the files come, in case of a kill between the two.
        self._note([{"name": name, "checksum": checksum} for name, checksum in written.items()])
        path.parent.mkdir(parents=True, exist_ok=True)
        if not os.path.lexists(path):
            made.rename(path)
        else:
            for name in sorted(checksums, key=lambda name: name == last):
                (path / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(made / name, path / name)
        self.written.update(written)

    def set_aside(self, path: Path, name: str | None = None) -> None:
        """Move what is in the way of an output to `KEPT_FOLDER`, and report it.

        Args:
          path: under the folder.
          name: to be, in `KEPT_FOLDER`; left out, the path's own. A number is added where something has that name.

        Raises:
          InputError: it cannot be moved there.
        """
        aside = _unused(self.folder / KEPT_FOLDER / (name or str(self.name_of(path))))
        try:
            obstacle = self._obstacle(aside)
            if obstacle:
                raise OSError(f"{str(obstacle)!r} is no folder")
            aside.parent.mkdir(parents=True, exist_ok=True)
            path.rename(aside)
        except FileNotFoundError:  # a worker that still ran has put it in place, or removed it
            return
        except OSError as error:
            raise InputError(
                f"{str(path)!r} is in the way and cannot be moved ({reason_of(error)}): move it, or {ELSEWHERE}"
            ) from error
        LOG.warning(
            f"{str(path)!r} was changed since `jaxurban {self.command}` wrote it: it is kept as {str(aside)!r}"
        )

    def remove_all(self) -> None:
        """Remove all files that are as this command wrote them.

        What else lies in the folder, or in folders that this command wrote into, stays, and a warning names it.
        """
        folders = {PurePosixPath(name).parent for name in self.written} - {PurePosixPath()}
        self.remove(self.written)
        places = map(PurePosixPath, _files_under(self.folder))
        others = [
            place
            for place in places
            if len(place.parts) == 1 or folders.intersection(place.parents)
        ]
        if others:
            stay = f" and {len(others) - 1} more stay" if len(others) > 1 else " stays"
            LOG.warning(
                f"{str(self.folder / others[0])!r}{stay}: not from `jaxurban {self.command}`, or changed since"
            )

    def remove(self, names: Iterable[str]) -> None:
        """Remove files by their names under the folder, and folders that are empty then.

        Only files that are as this command wrote them are removed. Names at which nothing is then are removed from the
        record too.
        """
        unique = list(dict.fromkeys(names))
        folders = set[Path]()
        for path in [self.folder / name for name in unique]:
            if self.is_own(path):
                path.unlink()
                folders |= {parent for parent in path.parents if self.folder in parent.parents}

        recorded_names = [name for name in unique if name in self.written]
        missing = [name for name in recorded_names if not os.path.lexists(self.folder / name)]
        self._note({"name": name, "checksum": None} for name in missing)
        for name in missing:
            del self.written[name]

        # Inner folders first.
        for folder in sorted(folders, key=lambda folder: -len(folder.parts)):
            with suppress(OSError):  # others have files there
                folder.rmdir()

    def _note(self, lines: Iterable[Mapping[str, str | None]]) -> None:
        """Append lines of this command to the journal: ``scratch``, or ``name`` and ``checksum`` (None: removed)."""
        text = "".join(f"\n{json.dumps({'command': self.command, **line})}" for line in lines)
        with (self.folder / JOURNAL_FILE).open("ab", buffering=0) as file:
            file.write(text.encode())


def is_inside(name: str) -> bool:
    """Return whether a name is that of a file under a folder on every system.

    Such a name is relative, has no empty part and no ``.`` or ``..`` among its parts, and can be encoded.
    """
    # An absolute path has an empty first part; on Windows a drive such as `C:` leads out of the folder too.
    parts = re.split(r"[/\\]", name)
    has_drive = re.match("[A-Za-z]:", name)
    # No system encodes NUL, nor surrogates but those (U+DC80 to U+DCFF) by which Python stands for undecoded bytes.
    has_no_code = re.search("[\0\ud800-\udc7f\udd00-\udfff]", name)
    return {"", ".", ".."}.isdisjoint(parts) and not has_drive and not has_no_code


def _obstacle_in(folder: Path, name: PurePosixPath) -> Path | None:
    """Return the first of the folders between a folder and a name under it that is a link or no folder, if any is."""
    for parent in reversed(name.parents[:-1]):
        above = folder / parent
        if above.is_symlink() or (above.exists() and not above.is_dir()):
            return above
    return None


def _unused(path: Path) -> Path:
    """Return the path, or where something is there, the first of ``path.2``, ``path.3`` ... at which nothing is."""
    unused = path
    number = 1
    while os.path.lexists(unused):
        number += 1
        unused = path.with_name(f"{path.name}.{number}")
    return unused


def _files_under(folder: Path) -> list[str]:
    """Return the names of the files and links under a folder, but for the files by which it is locked and recorded."""
    files = [path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()]
    names = {path.relative_to(folder).as_posix() for path in files}
    names -= {RECORD_FILE, JOURNAL_FILE, LOCK_FILE}
    return sorted(name for name in names if SCRATCH_SUFFIX not in name)


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Hold a folder during the block; it is made, and removed afterwards if it was not there and nothing is in it.

    Folders above it that were made with it are removed with it.

    Raises:
      InputError: the folder cannot be written to, or another run holds it.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    check_writable(folder)
    try:
        with only_writer(folder, ELSEWHERE):
            yield
    finally:
        for path in made:
            with suppress(OSError):  # it holds what was written
                path.rmdir()


def recorded(folder: Path) -> dict[str, set[str]]:
    """Return the checksums of the files that commands wrote under a folder, by name; during a run old and new ones.

    Raises:
      InputError: the record cannot be read.
    """
    # The journal first, as it is removed when the record has taken its lines: so nothing is missed between the two.
    pairs = [(line["name"], line["checksum"]) for line in _journal(folder) if "name" in line]
    for section in _read(folder).values():
        pairs += section["written"].items()
    checksums: dict[str, set[str]] = {}
    for name, checksum in pairs:
        if checksum is not None:
            checksums.setdefault(name, set()).add(checksum)
    return checksums


def _read(folder: Path) -> Sections:
    """Return the record of a folder by command, without the journal; empty where there is none.

    Raises:
      InputError: the record cannot be read, is of another version, or names a file that is not under the folder.
    """
    try:
        sections = read_json(folder / RECORD_FILE)
        if not all(map(_is_section, sections.values())):
            raise ValueError("of another version")
        for section in sections.values():
            for name in section["written"]:
                if not is_inside(name):
                    raise ValueError(f"it names {name!r}, which is not under the folder")
        return sections
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{str(folder / RECORD_FILE)!r}, which records whose folder it is, cannot be read ({error}): {ELSEWHERE}, "
            "or remove this one"
        ) from error


def _is_section(section: Any) -> bool:
    """Return whether a value of the record is the section of a command: its settings, and texts of checksums."""
    match section:
        case {"settings": dict(), "written": dict(written)}:
            return all(isinstance(checksum, str) for checksum in written.values())
    return False


def _sections(folder: Path) -> Sections:
    """Return the record of a folder by command, after what a killed run left behind is put in order.

    Half-written records are removed, and the lines of the journal go into the record. Only the run that holds the
    folder may call this.

    Raises:
      InputError: the record cannot be read.
    """
    for scrap in folder.glob(f".{RECORD_FILE}.*{SCRATCH_SUFFIX}"):
        remove(scrap)
    sections = _read(folder)
    if os.path.lexists(folder / JOURNAL_FILE):
        _recover(folder, sections)
        _save(folder, sections)
    return sections


def _recover(folder: Path, sections: Sections) -> None:
    """Take the lines of the journal into ``sections``, which is altered, and remove the scratch that they name.

    Where a run was killed after it noted a checksum and before the file came, the file still has the checksum before:
    of several checksums of one file the one that the file has counts, and the last one where it has none of them.
    """
    # The checksums of each command and name, in the order of the journal; None: it was removed.
    checksums_of: dict[tuple[str, str], list[str | None]] = {}
    for line in _journal(folder):
        if "scratch" in line:
            scratch = PurePosixPath(line["scratch"])
            if SCRATCH_NAME.fullmatch(scratch.name) and not _obstacle_in(folder, scratch):
                remove(folder / scratch)
        elif line["command"] in sections:
            key = line["command"], line["name"]
            checksums_of.setdefault(key, []).append(line["checksum"])

    for (command, name), checksums in checksums_of.items():
        written = sections[command]["written"]
        # The checksum before the run may still be the file's, so that it is possible too.
        possible = {*checksums, written.pop(name, None)} - {None}
        if checksums[-1] is not None:
            written[name] = checksums[-1]

        # Which of several checksums the file has, if it is a file of its own and no link leads to it.
        file = folder / name
        is_there = (
            os.path.isfile(file)
            and not os.path.islink(file)
            and not _obstacle_in(folder, PurePosixPath(name))
        )
        if len(possible) > 1 and is_there:
            checksum = checksum_of(file)
            if checksum in possible:
                written[name] = checksum


def _journal(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the lines of the journal of a folder, each as `_parsed`, without damaged ones; none without a journal.

    The last line of a killed run may be damaged.

    Raises:
      InputError: a line names a file that is not under the folder.
    """
    journal = folder / JOURNAL_FILE
    if journal.is_symlink() or not journal.is_file():  # no run leaves a link or a pipe
        return
    for text in journal.read_text(encoding="utf-8", errors="replace").splitlines():
        line = _parsed(text)
        if line is None:
            continue
        name = line["scratch"] if "scratch" in line else line["name"]
        if not is_inside(name):
            raise InputError(
                f"{str(journal)!r} names {name!r}, which is not under the folder: {ELSEWHERE}, or remove it"
            )
        yield line


def _parsed(text: str) -> dict[str, Any] | None:
    """Return the values of a line of a journal by their keys, None of a damaged line.

    The keys are ``scratch`` alone, or ``command``, ``name`` and ``checksum``. All values are texts, but a checksum may
    be None.
    """
    with suppress(ValueError, RecursionError):
        match json.loads(text):
            case {"scratch": scratch}:
                return {"scratch": scratch} if isinstance(scratch, str) else None
            case {"command": str(), "name": str(), "checksum": str() | None} as line:
                return line
    return None


def _save(folder: Path, sections: Sections) -> None:
    """Write the record, with sorted names, and remove the journal; without any section remove the record too.

    A record that cannot be read now, though it could when the run began, is kept under another name.
    """
    ordered = {
        command: {**section, "written": dict(sorted(section["written"].items()))}
        for command, section in sections.items()
    }
    record = folder / RECORD_FILE
    stored = None
    try:
        with suppress(OSError):
            stored = read_json(record)
    except ValueError:
        aside = _unused(record)
        record.rename(aside)
        LOG.warning(f"{str(record)!r} was changed during the run: it is {str(aside)!r} now")
    if not ordered:
        record.unlink(missing_ok=True)
    elif ordered != stored:
        write_json(record, ordered, indent=2)
    (folder / JOURNAL_FILE).unlink(missing_ok=True)


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings by dotted key, such as ``region.resolution_m``; settings that are None are left out.

    Args:
      settings: nested, sections by name.
      prefix: in front of every key, with its dot.
    """
    by_key: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            by_key |= _flat(value, f"{prefix}{name}.")
        elif value is not None:
            by_key[f"{prefix}{name}"] = value
    return by_key


def differing(old: Mapping[str, Any], new: Mapping[str, Any]) -> Differing:
    """Return what differs between two sets of settings, as JSON holds them.

    Returns:
      Old and new value by dotted key; None where a setting is not set.
    """
    before, after = _flat(old), _flat(new)
    pairs = {key: (before.get(key), after.get(key)) for key in after | before}
    return {key: (value, other) for key, (value, other) in pairs.items() if value != other}
