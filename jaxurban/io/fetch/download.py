"""A polite client: one connection, a bounded number of tries, and a cache in which every file is whole and checked."""

import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

from jaxurban.errors import InputError, reason_of
from jaxurban.io.fetch.http import OVERRIDE, BusyError, Client
from jaxurban.io.fetch.sources import Source
from jaxurban.io.files import digest_of, only_writer, sweep_scraps, whole_file, write_whole
from jaxurban.progress import LOG

FIRST_WAIT_S = 2.0  # before the second try; it doubles with each
MOST_WAIT_S = 120.0  # a server that asks for more is left for another day
MOST_TIMEOUT_S = 3600.0
MOST_CHECKSUM_BYTES = 1000
OK, NOT_MODIFIED, NOT_FOUND = 200, 304, 404
ELSEWHERE = "set XDG_CACHE_HOME to another folder that can be written to"

Result = TypeVar("Result")


class UnfitError(Exception):
    """What was downloaded is another kind of file, or damaged: the reason, in a few words."""


@dataclass(frozen=True)
class Download:
    """One file to get.

    Attributes:
      source: whose it is, and how it wants requests.
      url: where it is.
      check: raises `UnfitError` or `InputError` for another kind of file, or a damaged one.
      md5_url: where its MD5 is published, None where it is not.
    """

    source: Source
    url: str
    check: Callable[[Path], object]
    md5_url: str | None = None


@dataclass(frozen=True)
class CacheEntry:
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
class Cache:
    """Gets files, and keeps them; from `open_cache`.

    Attributes:
      folder: of the cache.
      client: makes the requests.
      is_offline: use what the cache has, however old, and make no request.
    """

    folder: Path
    client: Client
    is_offline: bool

    def get(self, download: Download) -> CacheEntry:
        """Return a file, from the cache where its copy is fresh or the server says that it has not changed.

        Raises:
          InputError: it cannot be had, or fails its check; the cache is as before.
        """
        url, name = download.url, download.source.name
        entry = self.find(url)
        problem = None if entry is None else _problem(download, entry.path)  # another run's checks may have been wider
        if entry is not None and problem is None and (self.is_offline or is_fresh(entry, download)):
            LOG.info(f"{name}: the copy of {entry.checked_utc} in the cache ({url})")
            return entry
        if self.is_offline:
            state = "is not in the cache"
            if problem is not None:
                state = f"has a copy that does not serve ({problem}) in the cache"
            raise InputError(
                f"{url} ({name}) {state} {str(self.folder)!r}: run once without --offline, where there is a network"
            )
        md5 = None if download.md5_url is None else self._published_md5(download.md5_url)
        known = entry if problem is None else None
        return self._with_tries(url, download.source.num_tries, lambda: self._attempt(download, known, md5))

    def find(self, url: str) -> CacheEntry | None:
        """Return the cached copy of a URL, None where there is none or it is not as it was."""
        path = self._path(url)
        with suppress(OSError, ValueError, TypeError, RecursionError):
            entry = CacheEntry(path=path, **json.loads(path.with_suffix(".json").read_text(encoding="utf-8")))
            if _is_sound(entry) and digest_of(path) == entry.sha256:
                return entry
        return None

    def _path(self, url: str) -> Path:
        return self.folder / f"{hashlib.sha256(url.encode()).hexdigest()[:32]}.body"

    def _keep(self, entry: CacheEntry) -> CacheEntry:
        facts = {name: value for name, value in asdict(entry).items() if name != "path"}
        write_whole(entry.path.with_suffix(".json"), json.dumps(facts))
        return entry

    def _with_tries(self, url: str, num_tries: int, attempt: Callable[[], Result]) -> Result:
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
                        "that; what was downloaded is kept"
                    ) from busy
                if number == num_tries:
                    times = "once" if num_tries == 1 else f"{num_tries} times"
                    raise InputError(
                        f"{url} {busy} (tried {times}): run the same command later; what was downloaded "
                        f"is kept; {OVERRIDE}"
                    ) from busy
                LOG.info(f"{urlsplit(url).hostname} {busy}; trying again in {wait_s:.0f} s")
                time.sleep(wait_s)
        raise AssertionError("unreachable: the last try returns or raises")

    def _attempt(self, download: Download, known: CacheEntry | None, md5: str | None) -> CacheEntry:
        """Make one request; return the new file, or the known one where it has not changed."""
        url, name = download.url, download.source.name
        conditions = {} if known is None else {"If-None-Match": known.etag, "If-Modified-Since": known.last_modified}
        headers = {header: value for header, value in conditions.items() if value}
        LOG.info(f"{name}: asking {url}")
        with self.client.open_response(url, headers, (OK, NOT_MODIFIED) if headers else (OK,)) as response:
            now = datetime.now(UTC).isoformat(timespec="seconds")
            if response.status_code == NOT_MODIFIED:
                assert known is not None
                LOG.info(f"{name}: not changed since {known.fetched_utc}")
                return self._keep(replace(known, checked_utc=now))
            path = self._path(url)
            with whole_file(path) as scratch:
                with scratch.open("wb") as file:
                    file.writelines(self.client.chunks(response))
                if md5 is not None and digest_of(scratch, "md5") != md5:
                    raise InputError(
                        f"{url} does not match its published MD5 checksum: it was replaced or "
                        "damaged on the way; run the same command again"
                    )
                if problem := _problem(download, scratch):
                    raise InputError(f"{url} is not the {name} file that was requested: {problem}")
                num_bytes, sha256 = scratch.stat().st_size, digest_of(scratch)
        etag, last_modified = (_plain(response.headers.get(header)) for header in ("ETag", "Last-Modified"))
        return self._keep(CacheEntry(path, url, now, now, num_bytes, sha256, etag, last_modified))

    def _published_md5(self, url: str) -> str | None:
        """Return the checksum in a published file, None (and say so) where there is no such file."""

        def request() -> str | None:
            body = b""
            with self.client.open_response(url, {}, (OK, NOT_FOUND)) as response:
                if response.status_code == NOT_FOUND:
                    LOG.info(f"checksum: the publisher gives none at {url}")
                    return None
                for chunk in self.client.chunks(response):
                    body += chunk
                    if len(body) > MOST_CHECKSUM_BYTES:
                        break
            words = body[:MOST_CHECKSUM_BYTES].decode("ascii", "replace").split()
            if not words or len(words[0]) != 32 or not set(words[0].lower()) <= set("0123456789abcdef"):
                raise InputError(f"{url} is not an MD5 checksum: give its place with --source checksum=URL")
            return words[0].lower()

        LOG.info(f"checksum: asking {url}")
        return self._with_tries(url, 4, request)


@contextmanager
def open_cache(*, most_bytes: int, timeout_s: float, is_offline: bool) -> Iterator[Cache]:
    """Yield a cache; scraps of killed runs leave it first. Only one process at a time has one that writes.

    Raises:
      InputError: a time-out out of range, the cache cannot be written to, or another process has it.
    """
    if not 0 < timeout_s <= MOST_TIMEOUT_S:
        raise InputError(f"--timeout must be above 0 and at most {MOST_TIMEOUT_S:,.0f} s, got {timeout_s:g}")
    folder = cache_folder()
    with ExitStack() as stack:
        if not is_offline:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"cannot make the cache {str(folder)!r} ({reason_of(error)}): {ELSEWHERE}") from error
            stack.enter_context(only_writer(folder, ELSEWHERE))
            sweep_scraps(folder)
        yield Cache(folder, stack.enter_context(Client(most_bytes, timeout_s)), is_offline)


def is_fresh(entry: CacheEntry, download: Download) -> bool:
    """Return whether a cached copy is young enough to be used without a request."""
    age_s = (datetime.now(UTC) - datetime.fromisoformat(entry.checked_utc)).total_seconds()
    return 0 <= age_s < download.source.fresh_s


def _problem(download: Download, path: Path) -> str | None:
    """Return why a file fails its check, None where it does not."""
    try:
        download.check(path)
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


def _is_sound(entry: CacheEntry) -> bool:
    """Return whether what is known of a file makes sense.

    Raises:
      TypeError, ValueError: it does not.
    """
    texts = (entry.url, entry.fetched_utc, entry.sha256, entry.etag or "-", entry.last_modified or "-")
    has_zone = datetime.fromisoformat(entry.checked_utc).tzinfo is not None
    return has_zone and all(isinstance(text, str) and _plain(text) for text in texts) and entry.num_bytes >= 0
