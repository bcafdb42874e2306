"""Downloads, one at a time, and a cache in which every file is whole and was read once."""

import hashlib
import importlib.metadata
import json
import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import urljoin

import requests
from requests.adapters import HTTPAdapter
from requests.auth import HTTPBasicAuth
from urllib3 import BaseHTTPResponse, Retry
from urllib3.exceptions import HTTPError

from jaxurban.errors import InputError, reason_of
from jaxurban.io.fetch.sources import Source
from jaxurban.io.files import digest_of, only_writer, scratch_for, sweep_scraps, write_whole
from jaxurban.progress import LOG

CHUNK_BYTES = 1 << 18
CONNECT_TIMEOUT_S, MOST_TIMEOUT_S = 30.0, 3600.0
MOST_WAIT_S = 120  # a server that asks for more is left for another day
MOST_REDIRECTS = 5
BUSY = (429, 502, 503, 504)
BACKOFF = 2.0  # the waits before the tries are 0, 4 and 8 s
OVERRIDE = "another place for the file can be given with --source"
ELSEWHERE = "set XDG_CACHE_HOME to another folder that can be written to"
CERTIFICATES = "check the clock and the certificates of this machine (REQUESTS_CA_BUNDLE)"
LATER = "run the same command later, or with a longer --timeout"
NETWORK = "check the network and its proxy (HTTPS_PROXY), and run the same command again, or with --offline"
REASONS = (  # the first that fits
    (requests.ReadTimeout, f"sends nothing for too long: {LATER}"),
    (requests.exceptions.SSLError, f"does not prove who it is: {CERTIFICATES}"),
    (requests.exceptions.ChunkedEncodingError, "broke off in the middle of the file: run the same command again"),
    (requests.ConnectionError, f"cannot be reached, falls silent or breaks off: {NETWORK}"),
    (requests.TooManyRedirects, f"leads in circles (more than {MOST_REDIRECTS} redirects): {OVERRIDE}"),
)


class UnfitError(Exception):
    """What was downloaded is another kind of file, or damaged: the reason, in a few words."""


class _Retry(Retry):
    """Waits as long as a busy server asks, up to `MOST_WAIT_S`."""

    def get_retry_after(self, response: BaseHTTPResponse) -> float | None:
        wait_s = super().get_retry_after(response)
        if wait_s is not None and wait_s > MOST_WAIT_S:
            raise HTTPError(f"it is busy and asks to come again in {wait_s:.0f} s")
        return wait_s

    def sleep(self, response: BaseHTTPResponse | None = None) -> None:
        LOG.info("the server is busy; waiting before the next try")
        super().sleep(response)


class _Session(requests.Session):
    """Sends the password of a URL to its own host, and none of ``~/.netrc``; stays on https."""

    def __init__(self, url: str) -> None:
        super().__init__()
        user, password = requests.utils.get_auth_from_url(url)
        self.auth = HTTPBasicAuth(user, password) if user else lambda request: request

    def get_redirect_target(self, resp: requests.Response) -> str | None:
        """Return where a response leads, which is never from https to http."""
        target = super().get_redirect_target(resp)
        if target and resp.url.startswith("https:") and not urljoin(resp.url, target).startswith("https:"):
            raise InputError(f"{resp.url} leads to {target}, which is not encrypted: {OVERRIDE}")
        return target

    def rebuild_auth(self, prepared_request: requests.PreparedRequest, response: requests.Response) -> None:
        """Keep the password within its host when a redirect leads on."""
        if self.should_strip_auth(response.request.url or "", prepared_request.url or ""):
            prepared_request.headers.pop("Authorization", None)


@dataclass(frozen=True)
class Download:
    """One file to get.

    Attributes:
      source: whose it is, and how it wants requests.
      url: where it is.
      check: reads it; raises for another kind of file, or a damaged one.
    """

    source: Source
    url: str
    check: Callable[[Path], object]


@dataclass(frozen=True)
class CacheEntry:
    """A file of the cache: its place, whence and when it came, and its version; looked after at its time stamp."""

    path: Path
    url: str
    fetched_utc: str
    num_bytes: int
    sha256: str
    etag: str


def cache_folder() -> Path:
    """Return where downloads are kept (``$XDG_CACHE_HOME/jaxurban/fetch``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxurban" / "fetch"


@dataclass
class Cache:
    """Gets files, and keeps them; from `open_cache`.

    Attributes:
      folder: of the cache.
      most_bytes: the largest file accepted.
      timeout_s: the longest silence of a server.
      is_offline: use what the cache has, however old, and make no request.
      num_requests: made so far, redirects and further tries not counted.
    """

    folder: Path
    most_bytes: int
    timeout_s: float
    is_offline: bool
    num_requests: int = 0

    def get(self, download: Download) -> CacheEntry:
        """Return a file, from the cache where its copy is fresh or the server says that it has not changed.

        Raises:
          InputError: it cannot be had, or fails its check; the cache is as before.
        """
        url, name = download.url, download.source.name
        path = self.folder / f"{hashlib.sha256(url.encode()).hexdigest()[:32]}.body"
        entry = _entry(path)
        problem = "" if entry is None else _problem(download, path)  # another run's checks may have been wider
        if entry is not None and not problem:
            age_s = time.time() - path.stat().st_mtime
            if self.is_offline or 0 <= age_s < download.source.fresh_s:
                LOG.info(f"{name}: the copy of {entry.fetched_utc} in the cache ({url})")
                return entry
        if self.is_offline:
            state = f"has a copy that does not serve ({problem}) in" if problem else "is not in"
            raise InputError(
                f"{url} ({name}) {state} the cache {str(self.folder)!r}: run once without --offline, where there "
                "is a network"
            )
        LOG.info(f"{name}: asking {url}")
        etag = "" if entry is None or problem else entry.etag
        with scratch_for(path) as scratch:
            response = self._receive(download, {"If-None-Match": etag} if etag else {}, scratch)
            if entry is not None and response.status_code == requests.codes.not_modified:
                os.utime(path)
                return entry
            if problem := _problem(download, scratch):
                raise InputError(f"{url} is not the {name} file that was requested: {problem}")
            facts: dict[str, Any] = {
                "url": url,
                "fetched_utc": datetime.now(UTC).isoformat(timespec="seconds"),
                "num_bytes": scratch.stat().st_size,
                "sha256": digest_of(scratch),
                "etag": response.headers.get("ETag", ""),
            }
            os.replace(scratch, path)
        write_whole(path.with_suffix(".json"), json.dumps(facts))
        return CacheEntry(path, **facts)

    def _receive(self, download: Download, headers: dict[str, str], scratch: Path) -> requests.Response:
        """Return the response to a request, its body in a file."""
        url = download.url
        retry = _Retry(
            download.source.num_tries - 1,
            connect=0,
            read=0,
            status_forcelist=BUSY,
            backoff_factor=BACKOFF,
            raise_on_status=False,
        )
        timeout_s = (min(self.timeout_s, CONNECT_TIMEOUT_S), self.timeout_s)
        self.num_requests += 1
        try:
            with _Session(url) as session:
                session.max_redirects = MOST_REDIRECTS
                session.headers["User-Agent"] = f"jaxurban/{importlib.metadata.version('jaxurban')} (jaxurban fetch)"
                for scheme in ("http://", "https://"):
                    session.mount(scheme, HTTPAdapter(max_retries=retry))
                with session.get(url, headers=headers, stream=True, timeout=timeout_s) as response:
                    self._save(response, url, scratch)
                    return response
        except (requests.RequestException, HTTPError) as error:
            said = next((words for kind, words in REASONS if isinstance(error, kind)), None)
            raise InputError(f"{url} {said or f'cannot be requested ({error}): {OVERRIDE}'}") from error

    def _save(self, response: requests.Response, url: str, scratch: Path) -> None:
        """Write the body of a response to a file; stop at one that is too large."""
        if response.status_code not in (requests.codes.ok, requests.codes.not_modified):
            what = f"answers {response.status_code} {response.reason or ''}"[:200]
            remedy = "run the same command later" if response.status_code in BUSY else OVERRIDE
            raise InputError(f"{response.url} {what}: {remedy}")
        declared = response.headers.get("Content-Length", "")
        num_bytes = int(declared[:18]) if declared.isdecimal() else 0
        with scratch.open("wb") as file:
            for chunk in chain([b""], response.iter_content(CHUNK_BYTES)):  # what is declared comes first
                num_bytes = max(num_bytes, file.tell() + len(chunk))
                if num_bytes > self.most_bytes:
                    raise InputError(
                        f"{url} is larger than {megabytes(self.most_bytes)} ({megabytes(num_bytes)} or more): ask for "
                        "a smaller region or extract, or raise --max-size"
                    )
                file.write(chunk)


@contextmanager
def open_cache(*, most_bytes: int, timeout_s: float, is_offline: bool) -> Iterator[Cache]:
    """Yield a cache; scraps of killed runs leave it first. Only one process at a time has one that writes.

    Raises:
      InputError: a time-out out of range, the cache cannot be written to, or another process has it.
    """
    if not 0 < timeout_s <= MOST_TIMEOUT_S:
        raise InputError(f"--timeout must be above 0 and at most {MOST_TIMEOUT_S:,.0f} s, got {timeout_s:g}")
    folder = cache_folder()
    if is_offline:
        yield Cache(folder, most_bytes, timeout_s, is_offline)
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the cache {str(folder)!r} ({reason_of(error)}): {ELSEWHERE}") from error
    with only_writer(folder, ELSEWHERE):
        sweep_scraps(folder)
        yield Cache(folder, most_bytes, timeout_s, is_offline)


def megabytes(num_bytes: int) -> str:
    """Return a size as ``--max-size`` is given: in units of 2^20 bytes."""
    return f"{num_bytes / 2**20:,.1f} MB"


def _entry(path: Path) -> CacheEntry | None:
    """Return the cached copy at a path, None where there is none or it is not as it was."""
    with suppress(OSError, ValueError, TypeError, RecursionError):
        entry = CacheEntry(path, **json.loads(path.with_suffix(".json").read_text(encoding="utf-8")))
        return entry if digest_of(path) == entry.sha256 else None
    return None


def _problem(download: Download, path: Path) -> str:
    """Return why a file fails its check, nothing where it does not."""
    try:
        download.check(path)
    except MemoryError:
        raise
    except Exception as error:  # what the readers of a dozen formats raise at foreign bytes is in no list
        said = " ".join(str(error).split())
        reason = said if isinstance(error, UnfitError | InputError) else f"it cannot be read ({said})"
        return re.sub(rf"(the \w+ file |districts )?'?{re.escape(str(path))}'?", "it", reason)
    return ""
