"""One request to a server that may be slow, busy, endless or lost: its response, within limits of size and time."""

import importlib.metadata
import re
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from urllib.parse import urljoin, urlsplit

import requests
from requests.auth import HTTPBasicAuth
from requests.utils import get_auth_from_url
from urllib3.exceptions import HTTPError, ProtocolError, ReadTimeoutError

from jaxurban.errors import InputError

CHUNK_BYTES = 1 << 18
LEAST_BYTES_PER_S = 500  # slower than this over the whole time-out counts as silent
CONNECT_TIMEOUT_S = 30.0
MOST_REDIRECTS = 5
MOST_SHOWN = 200  # characters of what a server says
REDIRECTS = (301, 302, 303, 307, 308)
BUSY = (429, 502, 503, 504)
OVERRIDE = "another place for the file can be given with --source"


class BusyError(Exception):
    """Another try may help; ``wait_s`` is what the server wants, None where it did not say."""

    def __init__(self, reason: str, wait_s: float | None = None) -> None:
        super().__init__(reason)
        self.wait_s = wait_s


def _url_auth(request: requests.PreparedRequest) -> requests.PreparedRequest:
    """Send the password that the URL itself holds, if any."""
    user, password = get_auth_from_url(request.url or "")
    return HTTPBasicAuth(user, password)(request) if user or password else request


class Client(requests.Session):
    """Makes requests; sends no password of ``~/.netrc``.

    Attributes:
      most_bytes: the largest body accepted.
      timeout_s: the longest silence of a server, and the longest that the head of its response may take.
      num_requests: made so far.
    """

    def __init__(self, most_bytes: int, timeout_s: float) -> None:
        super().__init__()
        self.most_bytes, self.timeout_s, self.num_requests = most_bytes, timeout_s, 0
        self.auth = _url_auth  # without one, requests looks into ~/.netrc
        self.headers["User-Agent"] = f"jaxurban/{importlib.metadata.version('jaxurban')} (jaxurban fetch)"

    def get_redirect_target(self, resp: requests.Response) -> str | None:
        """Return None: requests would read a redirect's body whole, however long and slow, even to follow none."""
        return None

    @contextmanager
    def open_response(
        self, url: str, headers: dict[str, str], accepted: tuple[int, ...]
    ) -> Iterator[requests.Response]:
        """Yield the response of an accepted status, its body unread; redirects are followed.

        Raises:
          BusyError: the server is busy, or breaks off before it answers.
          InputError: there is none.
        """
        place, whence = url, ""
        for _ in range(MOST_REDIRECTS + 1):
            with self._request(place, headers, whence) as response:
                if response.status_code not in REDIRECTS or "Location" not in response.headers:
                    said = f"{response.status_code} {response.reason}"[:MOST_SHOWN]
                    if response.status_code in BUSY:
                        wait_s = _seconds(response.headers.get("Retry-After"))
                        raise BusyError(f"is busy ({said}){whence and f' at {place}'}", wait_s)
                    if response.status_code not in accepted:
                        raise InputError(f"{place}{whence} answers {said}: {OVERRIDE}")
                    yield response
                    return
                place, whence = _target(response), f", where {url} leads,"
        raise InputError(f"{url} leads in circles (more than {MOST_REDIRECTS} redirects): {OVERRIDE}")

    def _request(self, url: str, headers: dict[str, str], whence: str) -> requests.Response:
        """Return the response to one request, its body unread."""
        host = urlsplit(url).hostname
        self.num_requests += 1
        connect_s = min(self.timeout_s, CONNECT_TIMEOUT_S)

        def get_head() -> requests.Response:
            timeout_s = (connect_s, self.timeout_s)
            return self.get(url, headers=headers, stream=True, allow_redirects=False, timeout=timeout_s)

        try:
            return _within(connect_s + self.timeout_s, get_head)
        except (TimeoutError, requests.ReadTimeout) as error:
            raise InputError(self._silent(url)) from error
        except requests.exceptions.SSLError as error:
            raise InputError(
                f"{host}{whence} does not prove who it is ({error}): check the clock and the certificates of "
                "this machine (REQUESTS_CA_BUNDLE)"
            ) from error
        except requests.ConnectionError as error:
            if error.args and isinstance(error.args[0], ProtocolError):
                raise BusyError(
                    f"breaks off before it answers, or does not speak HTTP{whence and f' at {url}'}"
                ) from error
            raise InputError(
                f"{host}{whence} cannot be reached: check the network and its proxy (HTTPS_PROXY), and run the same "
                f"command again; with --offline it uses what the cache has ({url})"
            ) from error
        except (requests.RequestException, HTTPError, ValueError) as error:
            raise InputError(f"{url}{whence} cannot be requested ({error}): {OVERRIDE}") from error

    def chunks(self, response: requests.Response) -> Iterator[bytes]:
        """Yield the body as it comes, unpacked; stop at one that is too large, too slow or cut off.

        Raises:
          BusyError: it breaks off.
          InputError: it is too large or too slow.
        """
        declared = response.headers.get("Content-Length", "")
        if re.fullmatch("[0-9]+", declared) and int(declared[:18]) > self.most_bytes:
            raise InputError(self._too_large(response.url, int(declared[:18])))
        num_bytes, window_bytes, window_begun_s = 0, 0, time.monotonic()
        while chunk := self._read(response):
            num_bytes += len(chunk)
            window_bytes += len(chunk)
            if num_bytes > self.most_bytes:
                raise InputError(self._too_large(response.url, num_bytes))
            if (now_s := time.monotonic()) > window_begun_s + self.timeout_s:
                if window_bytes < LEAST_BYTES_PER_S * (now_s - window_begun_s):
                    raise InputError(self._silent(response.url))
                window_bytes, window_begun_s = 0, now_s
            yield chunk

    def _read(self, response: requests.Response) -> bytes:
        """Return the next bytes of a body; none at its end."""
        try:
            return response.raw.read1(CHUNK_BYTES, decode_content=True)
        except ReadTimeoutError as error:
            raise InputError(self._silent(response.url)) from error
        except (HTTPError, OSError) as error:
            raise BusyError("broke off in the middle of the file") from error

    def _silent(self, url: str) -> str:
        return (
            f"{url} sends nothing, or next to nothing, for {self.timeout_s:g} s: run the same command later, or "
            "with a longer --timeout"
        )

    def _too_large(self, url: str, num_bytes: int) -> str:
        return (
            f"{url} is larger than {megabytes(self.most_bytes)} ({megabytes(num_bytes)} or more): ask for "
            "a smaller region or extract, or raise --max-size"
        )


def megabytes(num_bytes: int) -> str:
    """Return a size as ``--max-size`` is given: in units of 2^20 bytes."""
    return f"{num_bytes / 2**20:,.1f} MB"


def _within(limit_s: float, get: Callable[[], requests.Response]) -> requests.Response:
    """Return what ``get`` returns; TimeoutError if that takes too long.

    Sockets know only how long they may be silent, so that a server can send the head of its response letter by letter;
    hence the thread, which ends when its server does, or with the process.
    """
    future: Future[requests.Response] = Future()

    def work() -> None:
        try:
            future.set_result(get())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    try:
        return future.result(limit_s)
    except TimeoutError:
        future.add_done_callback(_close)
        raise


def _close(late: Future[requests.Response]) -> None:
    if late.exception() is None:
        late.result().close()


def _target(response: requests.Response) -> str:
    """Return where a redirect leads."""
    said = response.headers["Location"]
    try:
        target = urljoin(response.url, said.encode("latin-1").decode("utf-8"))
        parts = urlsplit(target)
        is_address = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:  # a damaged host or port
        is_address = False
    if not is_address:
        raise InputError(
            f"{response.url} leads to {said[:MOST_SHOWN]!r}, which is not an http:// or https:// address: {OVERRIDE}"
        )
    if response.url.startswith("https:") and parts.scheme == "http":
        raise InputError(f"{response.url} leads to {target}, which is not encrypted: {OVERRIDE}")
    return target


def _seconds(retry_after: str | None) -> float | None:
    """Return the seconds that a Retry-After header asks for (a number or a date), None where it says nothing."""
    try:
        if re.fullmatch("[0-9]+", (retry_after or "").strip()):
            return float(retry_after or "")
        wait = parsedate_to_datetime(retry_after or "") - datetime.now(UTC)
        return max(0.0, wait.total_seconds())
    except (TypeError, ValueError, OverflowError):
        return None
