"""A polite client: one connection, a bounded number of tries, and a cache in which every file is whole and checked."""

import hashlib
import importlib.metadata
import json
import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

from jaxurban.errors import InputError
from jaxurban.io.store import only_writer, sweep_scraps, whole_file
from jaxurban.io.webrequest import OVERRIDE, Asker, BusyError, Session

FIRST_WAIT_S = 2.0  # before the second try; it doubles with each
MOST_WAIT_S = 120.0  # a server that asks for more is left for another day
MOST_TIMEOUT_S = 3600.0
MOST_CHECKSUM_BYTES = 1000
OK, NOT_MODIFIED, NOT_FOUND = 200, 304, 404
ELSEWHERE = "set XDG_CACHE_HOME to another folder that can be written to"

Answer = TypeVar("Answer")


class UnfitError(Exception):
    """What arrived is not what was asked for: the reason, in a few words."""


@dataclass(frozen=True)
class Wanted:
    """One file to be had.

    Attributes:
      source: the source's name.
      url: where it is.
      check: raises `UnfitError` or `InputError` for a file that is not what was asked for.
      fresh_s: a kept copy younger than this is used without a request.
      num_tries: how often a busy server is asked.
      md5_url: where its MD5 is published, None where it is not.
    """

    source: str
    url: str
    check: Callable[[Path], object]
    fresh_s: float = 0.0
    num_tries: int = 4
    md5_url: str | None = None


@dataclass(frozen=True)
class Kept:
    """A file of the cache: its place, whence and when it came, and what tells its version."""

    path: Path
    url: str
    fetched_utc: str
    checked_utc: str
    num_bytes: int
    sha256: str
    etag: str | None
    last_modified: str | None


def cache_folder() -> Path:
    """Return where downloads are kept (``$XDG_CACHE_HOME/jaxurban/fetch``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxurban" / "fetch"


@dataclass
class Client:
    """Gets files through a cache; from `open_client`.

    Attributes:
      folder: of the cache.
      asker: makes the requests.
      is_offline: use what the cache has, however old, and make no request.
      tell: shows the user a message.
    """

    folder: Path
    asker: Asker
    is_offline: bool
    tell: Callable[[str], None]

    def get(self, wanted: Wanted) -> Kept:
        """Return a file, from the cache where its copy is fresh or the server says that it has not changed.

        Raises:
          InputError: it cannot be had, or is not what was asked for; the cache is as before.
        """
        kept = self.find(wanted.url)
        fault = None if kept is None else _fault(wanted, kept.path)  # another run's limits may have been wider
        if kept is not None and fault is None and (self.is_offline or is_fresh(kept, wanted)):
            self.tell(f"{wanted.source}: the copy of {kept.checked_utc} in the cache ({wanted.url})")
            return kept
        if self.is_offline:
            state = "is not in the cache" if fault is None else f"has a copy that does not serve ({fault}) in the cache"
            raise InputError(
                f"{wanted.url} ({wanted.source}) {state} {str(self.folder)!r}: "
                "run once without --offline, where there is a network"
            )
        md5 = None if wanted.md5_url is None else self._published_md5(wanted.md5_url)
        known = kept if fault is None else None
        return self._with_tries(wanted.url, wanted.num_tries, lambda: self._attempt(wanted, known, md5))

    def find(self, url: str) -> Kept | None:
        """Return the kept copy of a URL, None where there is none or it is not as it was."""
        path = self._path(url)
        try:
            entry = Kept(path=path, **json.loads(path.with_suffix(".json").read_text(encoding="utf-8")))
            is_whole = _is_sound(entry) and _digest(path, "sha256") == entry.sha256
        except (OSError, ValueError, TypeError, RecursionError):
            return None
        return entry if is_whole else None

    def _path(self, url: str) -> Path:
        return self.folder / f"{hashlib.sha256(url.encode()).hexdigest()[:32]}.body"

    def _keep(self, entry: Kept) -> Kept:
        facts = {name: value for name, value in asdict(entry).items() if name != "path"}
        with whole_file(entry.path.with_suffix(".json")) as scratch:
            scratch.write_text(json.dumps(facts), encoding="utf-8")
        return entry

    def _with_tries(self, url: str, num_tries: int, attempt: Callable[[], Answer]) -> Answer:
        """Return what an attempt returns, made again while the server is busy and asks for no long wait."""
        for number in range(1, num_tries + 1):
            try:
                return attempt()
            except BusyError as busy:
                wait_s = FIRST_WAIT_S * 2 ** (number - 1) if busy.wait_s is None else busy.wait_s
                if wait_s > MOST_WAIT_S:
                    wait = f"{wait_s:.0f} s" if wait_s <= 86_400 else "more than a day"
                    raise InputError(
                        f"{url} {busy} and asks to wait {wait}: run the same command after "
                        "that; what has arrived is kept"
                    ) from busy
                if number == num_tries:
                    times = "once" if num_tries == 1 else f"{num_tries} times"
                    raise InputError(
                        f"{url} {busy} (asked {times}): run the same command later; what has arrived "
                        f"is kept; {OVERRIDE}"
                    ) from busy
                self.tell(f"{urlsplit(url).hostname} {busy}; trying again in {wait_s:.0f} s")
                time.sleep(wait_s)
        raise AssertionError("unreachable: the last try returns or raises")

    def _attempt(self, wanted: Wanted, kept: Kept | None, md5: str | None) -> Kept:
        """Ask once; return the new file, or the kept one where it has not changed."""
        headers = {}
        if kept is not None and kept.etag:
            headers["If-None-Match"] = kept.etag
        if kept is not None and kept.last_modified:
            headers["If-Modified-Since"] = kept.last_modified
        self.tell(f"{wanted.source}: asking {wanted.url}")
        with self.asker.answer(wanted.url, headers, (OK, NOT_MODIFIED) if headers else (OK,)) as response:
            now = datetime.now(UTC).isoformat(timespec="seconds")
            if response.status_code == NOT_MODIFIED:
                assert kept is not None
                self.tell(f"{wanted.source}: not changed since {kept.fetched_utc}")
                return self._keep(replace(kept, checked_utc=now))
            path = self._path(wanted.url)
            with whole_file(path) as scratch:
                with scratch.open("wb") as file:
                    for chunk in self.asker.chunks(response):
                        file.write(chunk)
                if md5 is not None and _digest(scratch, "md5") != md5:
                    raise InputError(
                        f"{wanted.url} does not match its published MD5 checksum: it was replaced or "
                        "damaged on the way; run the same command again"
                    )
                if fault := _fault(wanted, scratch):
                    raise InputError(f"{wanted.url} is not the {wanted.source} file that was asked for: {fault}")
                num_bytes, sha256 = scratch.stat().st_size, _digest(scratch, "sha256")
        etag, last_modified = (_plain(response.headers.get(name)) for name in ("ETag", "Last-Modified"))
        return self._keep(Kept(path, wanted.url, now, now, num_bytes, sha256, etag, last_modified))

    def _published_md5(self, url: str) -> str | None:
        """Return the checksum in a published file, None (and say so) where there is no such file."""

        def ask() -> str | None:
            body = b""
            with self.asker.answer(url, {}, (OK, NOT_FOUND)) as response:
                if response.status_code == NOT_FOUND:
                    self.tell(f"checksum: none is published at {url}")
                    return None
                for chunk in self.asker.chunks(response):
                    body += chunk
                    if len(body) > MOST_CHECKSUM_BYTES:
                        break
            words = body[:MOST_CHECKSUM_BYTES].decode("ascii", "replace").split()
            if not words or len(words[0]) != 32 or not set(words[0].lower()) <= set("0123456789abcdef"):
                raise InputError(f"{url} is no MD5 checksum: give its place with --source checksum=URL")
            return words[0].lower()

        self.tell(f"checksum: asking {url}")
        return self._with_tries(url, 4, ask)


@contextmanager
def open_client(
    *, most_bytes: int, timeout_s: float, is_offline: bool, tell: Callable[[str], None]
) -> Iterator[Client]:
    """Yield a client; scraps of killed runs leave the cache first. Only one process at a time has one that writes.

    Raises:
      InputError: a time-out out of range, the cache cannot be written to, or another process has it.
    """
    if not 0 < timeout_s <= MOST_TIMEOUT_S:
        raise InputError(f"--timeout must be above 0 and at most {MOST_TIMEOUT_S:,.0f} s, got {timeout_s:g}")
    folder = cache_folder()
    if not is_offline:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make the cache {str(folder)!r} ({error.strerror}): {ELSEWHERE}") from error
    with nullcontext() if is_offline else only_writer(folder, ELSEWHERE), Session() as session:
        if not is_offline:
            sweep_scraps(folder)
        session.headers["User-Agent"] = f"jaxurban/{importlib.metadata.version('jaxurban')} (jaxurban fetch)"
        yield Client(folder, Asker(session, most_bytes, timeout_s), is_offline, tell)


def is_fresh(kept: Kept, wanted: Wanted) -> bool:
    """Return whether a kept copy is young enough to be used without a request."""
    age_s = (datetime.now(UTC) - datetime.fromisoformat(kept.checked_utc)).total_seconds()
    return 0 <= age_s < wanted.fresh_s


def _digest(path: Path, name: str) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, name).hexdigest()


def _fault(wanted: Wanted, path: Path) -> str | None:
    """Return in words why a file is not what was asked for, None where it is."""
    try:
        wanted.check(path)
    except MemoryError:
        raise
    except Exception as error:  # what the readers of a dozen formats raise at foreign bytes is in no list
        said = " ".join(str(error).split())
        reason = said if isinstance(error, UnfitError | InputError) else f"it cannot be read ({said})"
        return re.sub(rf"(the \w+ file |districts )?'?{re.escape(str(path))}'?", "it", reason)
    return None


def _plain(header: str | None) -> str | None:
    """Return a header that can be sent back, None for another."""
    return header if header and header.isascii() and header.isprintable() else None


def _is_sound(entry: Kept) -> bool:
    """Return whether what is known of a file makes sense.

    Raises:
      TypeError, ValueError: it does not.
    """
    texts = (entry.url, entry.fetched_utc, entry.sha256, entry.etag or "-", entry.last_modified or "-")
    has_zone = datetime.fromisoformat(entry.checked_utc).tzinfo is not None
    return has_zone and all(isinstance(text, str) and _plain(text) for text in texts) and entry.num_bytes >= 0
