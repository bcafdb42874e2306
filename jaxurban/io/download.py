"""A polite client: one connection, a bounded number of tries, and a cache in which every file is whole and checked."""

import hashlib
import importlib.metadata
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlsplit

import requests
from urllib3.exceptions import HTTPError, ReadTimeoutError

from jaxurban.errors import InputError
from jaxurban.io.store import only_writer, sweep_scraps, whole_file

CHUNK_BYTES = 1 << 18
LEAST_BYTES_PER_S = 500  # slower than this over the whole time-out is as good as silent
CONNECT_TIMEOUT_S = 30.0
FIRST_WAIT_S = 2.0  # before the second try; it doubles with each
MOST_WAIT_S = 120.0  # a server that asks for more is left for another day
MOST_REDIRECTS = 5
BUSY = (429, 502, 503, 504)
OK, NOT_MODIFIED, NOT_FOUND = 200, 304, 404
OVERRIDE = "another place for the file can be given with --source"

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


class _BusyError(Exception):
    """Another try may help; ``wait_s`` is what the server asked for, None where it did not say."""

    def __init__(self, reason: str, wait_s: float | None = None) -> None:
        super().__init__(reason)
        self.wait_s = wait_s


class _Session(requests.Session):
    """A session that never leaves https for http on the way."""

    def get_redirect_target(self, resp: requests.Response) -> str | None:
        target = super().get_redirect_target(resp)
        if target and resp.url.startswith("https:") and target.startswith("http:"):
            raise InputError(f"{resp.url} leads to {target}, which is not encrypted: {OVERRIDE}")
        return target


def cache_folder() -> Path:
    """Return where downloads are kept (``$XDG_CACHE_HOME/jaxurban/fetch``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxurban" / "fetch"


@dataclass
class Client:
    """Gets files through a cache; from `open_client`.

    Attributes:
      folder: of the cache.
      most_bytes: the largest file accepted.
      timeout_s: the longest silence of a server.
      is_offline: use what the cache has, however old, and make no request.
      tell: shows the user a message.
      num_requests: made so far.
    """

    folder: Path
    most_bytes: int
    timeout_s: float
    is_offline: bool
    tell: Callable[[str], None]
    session: requests.Session
    num_requests: int = 0

    def get(self, wanted: Wanted) -> Kept:
        """Return a file, from the cache where its copy is fresh or the server says that it has not changed.

        Raises:
          InputError: it cannot be had, or is not what was asked for; the cache is as before.
        """
        kept = self.find(wanted.url)
        if kept is not None and (self.is_offline or is_fresh(kept, wanted)):
            self.tell(f"{wanted.source}: the copy of {kept.checked_utc} in the cache ({wanted.url})")
            self._check(wanted, kept.path)  # another run's limits may have been wider
            return kept
        if self.is_offline:
            raise InputError(
                f"{wanted.url} ({wanted.source}) is not in the cache {str(self.folder)!r}: "
                "run once without --offline, where there is a network"
            )
        md5 = None if wanted.md5_url is None else self._published_md5(wanted.md5_url)
        return self._with_tries(wanted.url, wanted.num_tries, lambda: self._attempt(wanted, kept, md5))

    def find(self, url: str) -> Kept | None:
        """Return the kept copy of a URL, None where there is none or it is not as it was."""
        path = self._path(url)
        try:
            entry = Kept(path=path, **json.loads(path.with_suffix(".json").read_text(encoding="utf-8")))
            is_whole = _digest(path, "sha256") == entry.sha256
        except (OSError, ValueError, TypeError):
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
            except _BusyError as busy:
                wait_s = FIRST_WAIT_S * 2 ** (number - 1) if busy.wait_s is None else busy.wait_s
                if wait_s > MOST_WAIT_S:
                    raise InputError(
                        f"{url} {busy} and asks to wait {wait_s:.0f} s: run the same command after "
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

    @contextmanager
    def _answer(self, url: str, headers: dict[str, str], accepted: tuple[int, ...]) -> Iterator[requests.Response]:
        """Yield the server's answer of an accepted status, its body unread."""
        host = urlsplit(url).hostname
        self.num_requests += 1
        try:
            response = self.session.get(
                url, headers=headers, stream=True, timeout=(min(self.timeout_s, CONNECT_TIMEOUT_S), self.timeout_s)
            )
        except requests.TooManyRedirects as error:
            raise InputError(f"{url} leads in circles (more than {MOST_REDIRECTS} redirects): {OVERRIDE}") from error
        except requests.ReadTimeout as error:
            raise InputError(self._silent(url)) from error
        except requests.exceptions.SSLError as error:
            raise InputError(
                f"{host} does not prove who it is ({error}): check the clock and the certificates of "
                "this machine (REQUESTS_CA_BUNDLE)"
            ) from error
        except requests.ConnectionError as error:
            raise InputError(
                f"{host} cannot be reached: check the network and its proxy (HTTPS_PROXY), and run the same command "
                f"again; with --offline it uses what the cache has ({url})"
            ) from error
        except requests.RequestException as error:
            raise InputError(f"{url} cannot be asked for ({error}): {OVERRIDE}") from error
        with response:
            if response.status_code in BUSY:
                wait_s = _seconds(response.headers.get("Retry-After"))
                raise _BusyError(f"is busy ({response.status_code} {response.reason})", wait_s)
            if response.status_code not in accepted:
                raise InputError(f"{url} answers {response.status_code} {response.reason}: {OVERRIDE}")
            yield response

    def _attempt(self, wanted: Wanted, kept: Kept | None, md5: str | None) -> Kept:
        """Ask once; return the new file, or the kept one where it has not changed."""
        headers = {}
        if kept is not None and kept.etag:
            headers["If-None-Match"] = kept.etag
        if kept is not None and kept.last_modified:
            headers["If-Modified-Since"] = kept.last_modified
        self.tell(f"{wanted.source}: asking {wanted.url}")
        with self._answer(wanted.url, headers, (OK, NOT_MODIFIED) if headers else (OK,)) as response:
            now = datetime.now(UTC).isoformat(timespec="seconds")
            if response.status_code == NOT_MODIFIED:
                assert kept is not None
                self.tell(f"{wanted.source}: not changed since {kept.fetched_utc}")
                self._check(wanted, kept.path)
                return self._keep(replace(kept, checked_utc=now))
            path = self._path(wanted.url)
            with whole_file(path) as scratch:
                num_bytes = self._save(response, scratch)
                if md5 is not None and _digest(scratch, "md5") != md5:
                    raise InputError(
                        f"{wanted.url} does not match its published MD5 checksum: it was replaced or "
                        "damaged on the way; run the same command again"
                    )
                self._check(wanted, scratch)
                sha256 = _digest(scratch, "sha256")
        etag, last_modified = response.headers.get("ETag"), response.headers.get("Last-Modified")
        return self._keep(Kept(path, wanted.url, now, now, num_bytes, sha256, etag, last_modified))

    def _check(self, wanted: Wanted, path: Path) -> None:
        try:
            wanted.check(path)
        except (UnfitError, InputError) as error:
            reason = str(error).replace(str(path), "what arrived")
            raise InputError(f"{wanted.url} is not the {wanted.source} file that was asked for: {reason}") from error

    def _save(self, response: requests.Response, path: Path) -> int:
        """Write the body and return its length in bytes; stop at one that is too large, too slow or cut off."""
        declared = response.headers.get("Content-Length", "")
        if declared.isdigit() and int(declared) > self.most_bytes:
            raise InputError(self._too_large(response.url, int(declared)))
        num_bytes, window_bytes, window_begun_s = 0, 0, time.monotonic()
        with path.open("wb") as file:
            while chunk := self._read(response):
                file.write(chunk)
                num_bytes += len(chunk)
                window_bytes += len(chunk)
                if num_bytes > self.most_bytes:
                    raise InputError(self._too_large(response.url, num_bytes))
                if (now_s := time.monotonic()) > window_begun_s + self.timeout_s:
                    if window_bytes < LEAST_BYTES_PER_S * (now_s - window_begun_s):
                        raise InputError(self._silent(response.url))
                    window_bytes, window_begun_s = 0, now_s
        return num_bytes

    def _read(self, response: requests.Response) -> bytes:
        """Return the next bytes of a body as they come, unpacked; none at its end."""
        try:
            return response.raw.read1(CHUNK_BYTES, decode_content=True)
        except ReadTimeoutError as error:
            raise InputError(self._silent(response.url)) from error
        except (HTTPError, OSError) as error:
            raise _BusyError("broke off in the middle of the file") from error

    def _published_md5(self, url: str) -> str | None:
        """Return the checksum in a published file, None (and say so) where there is no such file."""

        def ask() -> str | None:
            with self._answer(url, {}, (OK, NOT_FOUND)) as response:
                if response.status_code == NOT_FOUND:
                    self.tell(f"checksum: none is published at {url}")
                    return None
                words = self._read(response)[:1000].decode("ascii", "replace").split()
            if not words or len(words[0]) != 32 or not set(words[0].lower()) <= set("0123456789abcdef"):
                raise InputError(f"{url} is no MD5 checksum: give its place with --source checksum=URL")
            return words[0].lower()

        self.tell(f"checksum: asking {url}")
        return self._with_tries(url, 4, ask)

    def _silent(self, url: str) -> str:
        return (
            f"{url} sends nothing, or next to nothing, for {self.timeout_s:g} s: run the same command later, or "
            "with a longer --timeout"
        )

    def _too_large(self, url: str, num_bytes: int) -> str:
        return (
            f"{url} is larger than {self.most_bytes / 1e6:,.1f} MB ({num_bytes / 1e6:,.1f} MB or more): ask for "
            "a smaller region or extract, or raise --max-size"
        )


@contextmanager
def open_client(
    *, most_bytes: int, timeout_s: float, is_offline: bool, tell: Callable[[str], None]
) -> Iterator[Client]:
    """Yield a client; scraps of killed runs leave the cache first. Only one process at a time has one.

    Raises:
      InputError: the cache cannot be written to, or another process has it.
    """
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot make the cache {str(folder)!r} ({error.strerror}): set XDG_CACHE_HOME to a folder "
            "that can be written to"
        ) from error
    with only_writer(folder), _Session() as session:
        sweep_scraps(folder)
        session.max_redirects = MOST_REDIRECTS
        session.headers["User-Agent"] = f"jaxurban/{importlib.metadata.version('jaxurban')} (jaxurban fetch)"
        yield Client(folder, most_bytes, timeout_s, is_offline, tell, session)


def is_fresh(kept: Kept, wanted: Wanted) -> bool:
    """Return whether a kept copy is young enough to be used without a request."""
    age_s = (datetime.now(UTC) - datetime.fromisoformat(kept.checked_utc)).total_seconds()
    return 0 <= age_s < wanted.fresh_s


def _digest(path: Path, name: str) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, name).hexdigest()


def _seconds(retry_after: str | None) -> float | None:
    """Return the seconds that a Retry-After header asks for (a number or a date), None where it says nothing."""
    if retry_after is None:
        return None
    try:
        if retry_after.strip().isdigit():
            return float(retry_after)
        return max(0.0, (parsedate_to_datetime(retry_after) - datetime.now(UTC)).total_seconds())
    except (TypeError, ValueError):
        return None
