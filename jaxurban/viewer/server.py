"""The viewer for a browser on this machine: Python's own server, which serves one page and answers its requests.

No file is ever served by its name. A request must name this host, as a page of another site that resolves to
127.0.0.1 would not, and must not come from a page of another origin.
"""

import gzip
import json
from collections.abc import Callable
from contextlib import nullcontext
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock
from typing import Any

from jaxurban.errors import InputError, RemadeError
from jaxurban.flights.missions.mission import MOST_BYTES
from jaxurban.progress import LOG
from jaxurban.viewer.html import html_page, policy_of
from jaxurban.viewer.tiles import LEVEL
from jaxurban.viewer.viewer import BYTES, JSON, Answer, Viewer

HOST = "127.0.0.1"
MOST_BODY = 128 * 1024  # bytes of a request
MOST_MISSION = 3 * MOST_BYTES // 2  # of one with a mission, which base64 lengthens by a third
PATIENCE_S = 20.0  # for the next bytes of a request
TURN_PATIENCE_S = 2.0  # for those of one for which others may wait
ASK = "/ask/"
CHECK = "check"


class _RefusedError(Exception):
    """A request that is refused with a status of HTTP, and why in a sentence."""

    def __init__(self, status: HTTPStatus, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


class ViewerServer(ThreadingHTTPServer):
    """Serves one viewer.

    Args:
      viewer: answers the requests.
      port: number of the port; 0 for any that is free.
      again: returns a new viewer, for the page that is loaded once the maps were made again; None: there is none.

    Raises:
      InputError: the port is taken, or cannot be listened at.
    """

    daemon_threads = True
    # How many connections may wait to be taken; more at once are reset by the system.
    request_queue_size = 1024

    def __init__(
        self, viewer: Viewer, port: int = 0, again: Callable[[], Viewer] | None = None
    ) -> None:
        self.viewer, self.again = viewer, again
        self._lock = Lock()  # while another viewer is made
        # By the name of requests that take turns: a mission of 15 MB may take half a GB while it is read and judged.
        self.turns = {CHECK: Lock()}
        self.page = html_page()
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"cannot listen at {HOST}:{port} ({error}): name another --port"
            ) from error
        self.hosts = {f"{name}:{self.server_port}" for name in (HOST, "localhost")}

    def renew(self) -> None:
        """Replace the viewer by a new one if its maps were made again."""
        with self._lock:
            try:
                self.viewer.check_current()
            except RemadeError:
                if self.again is not None:
                    self.viewer = self.again()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that has left."""


class _Handler(BaseHTTPRequestHandler):
    """Answers one connection; Python's server calls ``do_GET`` and its like, and reads the attributes below."""

    server: ViewerServer
    rfile: Any  # a BufferedReader
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "jaxurban", ""
    # Else an answer waits 40 ms for the browser to acknowledge its head.
    disable_nagle_algorithm = True
    wbufsize = -1
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        self._give(self._page)

    def do_HEAD(self) -> None:
        self._give(self._page)

    def do_POST(self) -> None:
        self._give(self._answer)

    def _page(self) -> Answer:
        """Return the page, from now on of the latest maps.

        Raises:
          _RefusedError: another path is asked for.
        """
        if self.path != "/":
            raise _RefusedError(HTTPStatus.NOT_FOUND, "there is one page here, /")
        self.server.renew()
        return Answer("text/html; charset=utf-8", self.server.page.encode())

    def _answer(self) -> Answer:
        """Return the answer to a POST of ``/ask/NAME?KEY``, whose body has the parameters as JSON.

        Raises:
          _RefusedError: it is no such request.
          RemadeError: the maps were made again since the viewer with this key opened them.
          InputError: as for `Viewer.answer`.
        """
        path, _, key = self.path.partition("?")
        if not path.startswith(ASK):
            raise _RefusedError(HTTPStatus.NOT_FOUND, f"requests go to {ASK}NAME")
        if self.headers.get_content_type() != JSON:
            raise _RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, f"a request is {JSON}")
        name = path.removeprefix(ASK)[:40]
        length = self._length(MOST_MISSION if name == CHECK else MOST_BODY)
        if length:
            self.rfile.peek()  # so that nobody waits for one who sends nothing
        with self.server.turns.get(name, nullcontext()):
            self.connection.settimeout(TURN_PATIENCE_S)
            try:
                params = json.loads(self.rfile.read(length))
            except (ValueError, RecursionError) as error:
                raise _RefusedError(HTTPStatus.BAD_REQUEST, "the request is no JSON") from error
            self.connection.settimeout(PATIENCE_S)
            viewer = self.server.viewer
            viewer.check_current(key)
            return viewer.answer(name, params)

    def _length(self, most: int) -> int:
        """Return how many bytes the body of a request has.

        Raises:
          _RefusedError: the request does not say it, or it has more than ``most``.
        """
        length = self.headers.get("Content-Length", "")
        if "Transfer-Encoding" in self.headers or not length.isdecimal():
            raise _RefusedError(HTTPStatus.LENGTH_REQUIRED, "give the length of the request")
        if len(length) > 9 or int(length) > most:
            raise _RefusedError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request is at most {most} bytes"
            )
        return int(length)

    def _check_sender(self) -> None:
        """Refuse a request that names another host than this one, or comes from a page of another origin.

        Raises:
          _RefusedError: it is one of these.
        """
        hosts = self.server.hosts
        if self.headers.get_all("Host") not in [[host] for host in hosts]:
            raise _RefusedError(HTTPStatus.FORBIDDEN, "this server answers to its own name alone")
        origins = self.headers.get_all("Origin", [])
        if not {f"http://{host}" for host in hosts}.issuperset(origins):
            raise _RefusedError(HTTPStatus.FORBIDDEN, "this server answers its own page alone")

    def _give(self, make: Any) -> None:
        """Send the answer that ``make`` returns, or in one sentence why there is none; nothing to a browser that left.

        No error leaves it: an unexpected one is logged, and the browser is told no more than that.
        """
        try:
            self._check_sender()
            status, answer = HTTPStatus.OK, make()
        except _RefusedError as refused:
            self.close_connection = True  # its body may be unread
            status, answer = refused.status, _sentence(refused)
        except RemadeError as error:
            status, answer = HTTPStatus.CONFLICT, _sentence(error)
        except InputError as error:
            status, answer = HTTPStatus.BAD_REQUEST, _sentence(error)
        except (ConnectionError, TimeoutError):
            self.close_connection = True
            return
        except Exception as error:
            LOG.warning(
                f"the viewer failed to answer {self.path[:60]!r}: {type(error).__name__}: {error}"
            )
            status = HTTPStatus.INTERNAL_SERVER_ERROR
            answer = _sentence("that failed: see where the server runs")
        self._send(status, answer)

    def _send(self, status: HTTPStatus, answer: Answer) -> None:
        """Send an answer, with the headers that keep other pages and caches out of it.

        Text is compressed where the browser takes that. A HEAD gets the headers alone.
        """
        body = answer.body
        # A request that was refused early may have no headers.
        is_text = status == HTTPStatus.OK and answer.kind != BYTES
        is_compressed = is_text and "gzip" in self.headers.get("Accept-Encoding", "")
        if is_compressed:
            body = gzip.compress(body, LEVEL)

        headers = {
            "Content-Type": answer.kind,
            "Content-Length": str(len(body)),
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "Content-Security-Policy": policy_of("'self'"),
        }
        if is_compressed:
            headers["Content-Encoding"] = "gzip"
        if self.close_connection:
            headers["Connection"] = "close"

        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse what is no request of HTTP, in a sentence; Python's server calls this and leaves the rest out.

        The fault is the sender's, so a status of the server's faults (500 and above) becomes one of the sender's.
        """
        self.close_connection = True
        status = HTTPStatus(code)
        if status == HTTPStatus.NOT_IMPLEMENTED:
            status = HTTPStatus.METHOD_NOT_ALLOWED
        if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
            status = HTTPStatus.BAD_REQUEST
        self._send(status, _sentence((message or status.phrase)[:200]))

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing of requests."""


def _sentence(text: object) -> Answer:
    """Return a text, or an error's text, as an answer."""
    return Answer("text/plain; charset=utf-8", str(text).encode("utf-8", "replace"))
