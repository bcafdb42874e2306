"""Downloads, one at a time, and a cache in which every file is whole and was read once.

The cache is our own: `pooch.retrieve` keeps a file by a hash known beforehand, and the files here change at a fixed
address, so that age, ETag and the reader's check decide.
"""

import hashlib
import importlib.metadata
import json
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urljoin

import requests
from requests.adapters import HTTPAdapter
from urllib3 import BaseHTTPResponse, Retry
from urllib3.exceptions import HTTPError

from jaxurban.errors import InputError
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
FACTS = {"url", "fetched_utc", "num_bytes", "sha256", "etag"}
Content = TypeVar("Content")


@dataclass(frozen=True)
class Source:
    """A public source.

    Attributes:
      name: what users call it (``--source name=URL``).
      url: template; what stands in braces is filled in for the region.
      credit: who made it.
      licence: its terms, in a few words.
      fresh_s: a copy younger than this is used without a request.
      num_tries: how many requests a busy server gets.
    """

    name: str
    url: str
    credit: str
    licence: str
    fresh_s: float
    num_tries: int = 4


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


def cache_folder() -> Path:
    """Return where downloads are kept (``$XDG_CACHE_HOME/jaxurban/fetch``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxurban" / "fetch"


@dataclass
class Cache:
    """Gets files, and keeps them; from `open_cache`.

    Attributes:
      most_bytes: the largest file accepted.
      timeout_s: the longest silence of a server.
      is_offline: use what the cache has, however old, and make no request.
      num_requests: made so far, redirects and further tries not counted.
    """

    most_bytes: int
    timeout_s: float
    is_offline: bool
    num_requests: int = 0

    def get(self, source: Source, url: str, read: Callable[[Path], Content]) -> tuple[Path, dict[str, Any], Content]:
        """Return a file in the cache, its facts, and what ``read`` makes of it; it raises for another kind or damage.

        The file is from the cache where its copy is fresh or the server says that it has not changed. The facts are
        ``url``, ``fetched_utc``, ``num_bytes``, ``sha256`` and ``etag``, "" where the server gave none.

        Raises:
          InputError: it cannot be had, or not read; the cache is as before.
        """
        path = cache_folder() / f"{hashlib.sha256(url.encode()).hexdigest()[:32]}.body"
        facts, problem = _facts(path), ""
        if facts and (self.is_offline or 0 <= time.time() - path.stat().st_mtime < source.fresh_s):
            try:
                content = _read(read, path)
                LOG.info(f"{source.name}: the copy of {facts['fetched_utc']} in the cache ({url})")
                return path, facts, content
            except InputError as error:
                facts, problem = {}, str(error)
        if self.is_offline:
            state = f"has a copy that does not serve ({problem}) in" if problem else "is not in"
            raise InputError(
                f"{url} ({source.name}) {state} the cache {str(cache_folder())!r}: run once without --offline, where "
                "there is a network"
            )
        LOG.info(f"{source.name}: asking {url}")
        with scratch_for(path) as scratch:
            response = self._receive(source, url, facts.get("etag", ""), scratch)
            is_same = response.status_code == requests.codes.not_modified
            try:
                content = _read(read, path if is_same else scratch)
            except InputError as error:
                raise InputError(f"{url} is not the {source.name} file that was requested: {error}") from error
            if is_same:
                os.utime(path)
                return path, facts, content
            facts = {
                "url": url,
                "fetched_utc": datetime.now(UTC).isoformat(timespec="seconds"),
                "num_bytes": scratch.stat().st_size,
                "sha256": digest_of(scratch),
                "etag": response.headers.get("ETag", ""),
            }
            os.replace(scratch, path)
        write_whole(path.with_suffix(".json"), json.dumps(facts))
        return path, facts, content

    def _receive(self, source: Source, url: str, etag: str, scratch: Path) -> requests.Response:
        """Return the response to a request, its body in a file; stop at one that is too large."""
        retry = _Retry(
            source.num_tries - 1,
            connect=0,
            read=0,
            status_forcelist=BUSY,
            backoff_factor=BACKOFF,
            raise_on_status=False,
        )
        timeout_s = (min(self.timeout_s, CONNECT_TIMEOUT_S), self.timeout_s)
        self.num_requests += 1
        try:
            with requests.Session() as session:
                session.trust_env = False  # it would send passwords of ~/.netrc
                session.proxies = requests.utils.get_environ_proxies(url)
                session.verify = os.environ.get("REQUESTS_CA_BUNDLE") or True
                session.max_redirects = MOST_REDIRECTS
                session.hooks["response"].append(_check_redirect)
                session.headers["User-Agent"] = f"jaxurban/{importlib.metadata.version('jaxurban')} (jaxurban fetch)"
                if etag:
                    session.headers["If-None-Match"] = etag
                for scheme in ("http://", "https://"):
                    session.mount(scheme, HTTPAdapter(max_retries=retry))
                with session.get(url, stream=True, timeout=timeout_s) as response, scratch.open("wb") as file:
                    if response.status_code not in (requests.codes.ok, requests.codes.not_modified):
                        remedy = "run the same command later" if response.status_code in BUSY else OVERRIDE
                        what = f"answers {response.status_code} {response.reason or ''}"[:200]
                        raise InputError(f"{response.url} {what}: {remedy}")
                    declared = response.headers.get("Content-Length", "")
                    num_bytes = int(declared[:18]) if declared.isdecimal() else 0
                    for chunk in chain([b""], response.iter_content(CHUNK_BYTES)):  # what is declared comes first
                        num_bytes = max(num_bytes, file.tell() + len(chunk))
                        if num_bytes > self.most_bytes:
                            raise InputError(
                                f"{url} is larger than {megabytes(self.most_bytes)} ({megabytes(num_bytes)} or more): "
                                "ask for a smaller region or extract, or raise --max-size"
                            )
                        file.write(chunk)
                    return response
        except (requests.RequestException, HTTPError) as error:
            said = next((words for kind, words in REASONS if isinstance(error, kind)), None)
            raise InputError(f"{url} {said or f'cannot be requested ({error}): {OVERRIDE}'}") from error


@contextmanager
def open_cache(*, most_bytes: int, timeout_s: float, is_offline: bool) -> Iterator[Cache]:
    """Yield a cache; scraps of killed runs leave it first. Only one process at a time has one that writes.

    Raises:
      InputError: a time-out out of range, the cache cannot be written to, or another process has it.
    """
    if not 0 < timeout_s <= MOST_TIMEOUT_S:
        raise InputError(f"--timeout must be above 0 and at most {MOST_TIMEOUT_S:,.0f} s, got {timeout_s:g}")
    with nullcontext() if is_offline else only_writer(cache_folder(), ELSEWHERE):
        if not is_offline:
            sweep_scraps(cache_folder())
        yield Cache(most_bytes, timeout_s, is_offline)


def megabytes(num_bytes: int) -> str:
    """Return a size as ``--max-size`` is given: in units of 2^20 bytes."""
    return f"{num_bytes / 2**20:,.1f} MB"


def _check_redirect(response: requests.Response, **_: Any) -> None:
    """Raise InputError before a redirect is followed from https to http, InvalidURL where it leads to no URL."""
    try:
        target = urljoin(response.url, response.headers.get("Location", ""))
    except ValueError as error:
        response.close()
        raise requests.exceptions.InvalidURL(error) from error
    if response.is_redirect and response.url.startswith("https:") and not target.startswith("https:"):
        raise InputError(f"{response.url} leads to {target}, which is not encrypted: {OVERRIDE}")


def _facts(path: Path) -> dict[str, Any]:
    """Return the facts of the cached copy at a path, none where there is no copy or it is not as it was."""
    try:
        facts = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        return facts if facts.keys() == FACTS and digest_of(path) == facts["sha256"] else {}
    except (OSError, ValueError, AttributeError, RecursionError):
        return {}


def _read(read: Callable[[Path], Content], path: Path) -> Content:
    """Return what ``read`` makes of a file.

    Raises:
      InputError: the reason why it is another kind of file, or damaged.
    """
    try:
        return read(path)
    except MemoryError:
        raise
    except Exception as error:  # what the readers of a dozen formats raise at foreign bytes is in no list
        said = " ".join(str(error).split())
        reason = said if isinstance(error, InputError) else f"it cannot be read ({said})"
        scratch = rf"{re.escape(str(path))}|{re.escape(tempfile.gettempdir())}/[^' ]*"
        raise InputError(re.sub(rf"(the \w+ file |districts )?'?({scratch})'?", "it", reason)) from error
