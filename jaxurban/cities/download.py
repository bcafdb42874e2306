"""Downloads, one at a time, into a cache in which every file is whole.

The cache is our own: `pooch.retrieve` keeps a file by a hash known beforehand, and the files here change at a fixed
address, so that the age of a copy decides.
"""

import hashlib
import importlib.metadata
import ipaddress
import os
import socket
import time
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import requests
from requests.adapters import HTTPAdapter
from urllib3 import BaseHTTPResponse, Retry
from urllib3.exceptions import HTTPError

from jaxurban.errors import InputError
from jaxurban.io.files import digest_of, scratch_for
from jaxurban.kept_folders import cache_home
from jaxurban.progress import LOG

CHUNK_BYTES = 1 << 18
CONNECT_TIMEOUT_S = 30.0
TIMEOUT_S = 200.0  # the longest silence; a query of Overpass may take 180 s
MOST_WAIT_S = 120  # a server that asks for more is left for another day
MOST_REDIRECTS = 5
BUSY = (429, 502, 503, 504)
BACKOFF = 2.0  # the waits before the tries are 0, 4 and 8 s
REMEDY = (
    "check the network, its proxy (HTTPS_PROXY) and its certificates (REQUESTS_CA_BUNDLE), and run the same command "
    "again, or name another place for the file with --source"
)


@dataclass(frozen=True)
class Source:
    """A file that a public server sends.

    Attributes:
      name: what users call it (``--source name=URL``).
      url: where it is; a template, what stands in braces is filled in for the region.
      file: its name in the user's folder.
      credit: who made it.
      licence: its terms, in a few words.
      fresh_s: a copy younger than this is used without a request.
      num_tries: how many requests a busy server gets.
    """

    name: str
    url: str
    file: str
    credit: str
    licence: str
    fresh_s: float
    num_tries: int = 4


class _Retry(Retry):
    """Waits as long as a busy server asks, up to `MOST_WAIT_S`."""

    def get_retry_after(self, response: BaseHTTPResponse) -> float | None:
        """Return the seconds that a server asks to wait, None without such a wish; InputError for too many."""
        wait_s = super().get_retry_after(response)
        if wait_s is not None and wait_s > MOST_WAIT_S:
            raise InputError(
                f"the server is busy and asks you to try again in {wait_s:.0f} s: run the same command then"
            )
        return wait_s

    def sleep(self, response: BaseHTTPResponse | None = None) -> None:
        """Wait before the next try, and say so in the log."""
        LOG.info("the server is busy; waiting before the next try")
        super().sleep(response)


class _Adapter(HTTPAdapter):
    """Sends requests; of redirects none that leads from a public server into this machine or its own network."""

    def __init__(self, source: Source, **options: Any) -> None:
        """Make an adapter for a source; ``options`` are those of `HTTPAdapter`."""
        self.source_host = urlsplit(source.url).hostname
        super().__init__(**options)

    def send(
        self, request: requests.PreparedRequest, *args: Any, **options: Any
    ) -> requests.Response:
        """Send a request, the source's own or one that it was redirected to.

        Raises:
          InputError: a public server redirects to an address that is not public.
        """
        host = urlsplit(request.url or "").hostname
        own = self.source_host
        if host != own and _is_private(host) and not _is_private(own):
            raise InputError(f"{own} sends on to {host}, an address of no public server: {REMEDY}")
        return super().send(request, *args, **options)


def _is_private(host: str | None) -> bool:
    """Return whether one of the addresses of a host is not public; False where its name is not known here."""
    try:
        places = {place[0] for *_, place in socket.getaddrinfo(host, None)}
    except OSError:  # perhaps a proxy knows it
        return False
    # Without the interface that may follow a "%"; of IPv4 within IPv6 the IPv4 address counts.
    addresses = [ipaddress.ip_address(str(place).partition("%")[0]) for place in places]
    plain = [getattr(address, "ipv4_mapped", None) or address for address in addresses]
    return not all(address.is_global for address in plain)


def cache_folder() -> Path:
    """Return where downloads are kept (``$XDG_CACHE_HOME/jaxurban/fetch``)."""
    return cache_home() / "jaxurban" / "fetch"


def download(source: Source, most_bytes: int) -> Path:
    """Return the copy of a source's file in the cache, downloaded now unless it is fresh and whole.

    The copy is called ``KEY-SHA256-FILE``: a key of the URL, the digest of its bytes, and the source's name for it.

    Args:
      source: where it is, its URL filled in.
      most_bytes: the largest file accepted, unpacked.

    Raises:
      InputError: the file cannot be downloaded, or is too large; the cache then holds no copy of it.
    """
    folder = cache_folder()
    key = hashlib.sha256(source.url.encode()).hexdigest()[:32]

    # A copy in the cache is used if it is fresh and whole, and removed otherwise.
    for path in folder.glob(f"{key}-*"):
        is_fresh = 0 <= time.time() - path.stat().st_mtime < source.fresh_s
        _, digest, *_ = path.name.split("-")
        if is_fresh and digest_of(path) == digest:
            LOG.info(f"{source.name}: a copy in the cache ({source.url})")
            return path
        path.unlink()

    # The server is asked.
    LOG.info(f"{source.name}: asking {source.url}")
    with scratch_for(folder / key) as scratch:
        try:
            _receive(source, scratch, most_bytes)
        except InputError:  # which is a ValueError too
            raise
        except (requests.RequestException, HTTPError, ValueError) as error:
            raise InputError(
                f"{source.url} cannot be downloaded ({type(error).__name__}): {REMEDY}"
            ) from error
        path = folder / f"{key}-{digest_of(scratch)}-{source.file}"
        os.replace(scratch, path)
    return path


def _receive(source: Source, scratch: Path, most_bytes: int) -> None:
    """Write what a server sends to a file.

    Args:
      source: its URL, and how often a busy server is asked.
      scratch: the file to write.
      most_bytes: the largest file accepted, unpacked.

    Raises:
      InputError: the server refuses or asks to wait too long, or the file is larger.
      requests.RequestException, HTTPError, ValueError: the connection fails, or the URL is none.
    """
    adapter = _Adapter(
        source,
        max_retries=_Retry(
            source.num_tries - 1,
            connect=0,
            read=0,
            status_forcelist=BUSY,
            backoff_factor=BACKOFF,
            raise_on_status=False,
        ),
    )
    with requests.Session() as session:
        # A session that takes proxies and certificates from the environment, but no passwords.
        session.trust_env = False  # it would send passwords of ~/.netrc
        session.proxies = requests.utils.get_environ_proxies(source.url)
        session.verify = os.environ.get("REQUESTS_CA_BUNDLE") or True
        session.max_redirects = MOST_REDIRECTS
        session.headers["User-Agent"] = (
            f"jaxurban/{importlib.metadata.version('jaxurban')} (jaxurban fetch)"
        )
        session.adapters.clear()
        session.mount("https://", adapter)
        if not source.url.startswith("https:"):  # so that no redirect leads from https to http
            session.mount("http://", adapter)

        with (
            session.get(
                source.url, stream=True, timeout=(CONNECT_TIMEOUT_S, TIMEOUT_S)
            ) as response,
            scratch.open("wb") as file,
        ):
            if response.status_code != requests.codes.ok:
                remedy = "run the same command later" if response.status_code in BUSY else REMEDY
                raise InputError(
                    f"{response.url} answers {response.status_code} {response.reason!r:.200}: {remedy}"
                )

            # An empty chunk comes first, so that a declared length is checked before anything is received.
            declared = response.headers.get("Content-Length", "")
            num_bytes = int(declared) if declared.isdecimal() else 0
            for chunk in chain([b""], response.iter_content(CHUNK_BYTES)):
                num_bytes = max(num_bytes, file.tell() + len(chunk))
                if num_bytes > most_bytes:
                    raise InputError(
                        f"{source.url} is larger than {most_bytes / 2**20:,.1f} MB: ask for a smaller region or "
                        "extract, or raise --max-size"
                    )
                file.write(chunk)
