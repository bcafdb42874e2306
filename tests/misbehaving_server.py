"""A server in this process that answers as it is told: well, late, cut off, in circles, without end."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

LONGEST_S = 20.0  # so that a client which waits for ever fails its test and does not hang it

Reply = Callable[[BaseHTTPRequestHandler], None]


class Handler(BaseHTTPRequestHandler):
    """Gives the replies of its server."""

    def do_GET(self) -> None:
        self.server.asked.append((self.path, dict(self.headers)))
        replies = self.server.replies.get(urlsplit(self.path).path, [send(b"nothing here", 404)])
        with suppress(BrokenPipeError, ConnectionResetError):
            (replies.pop(0) if len(replies) > 1 else replies[0])(self)

    def log_message(self, *_: object) -> None:
        """Stay quiet."""


class Server(ThreadingHTTPServer):
    """Replies by path, and what was asked: path with query, and headers."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server_port}"
        self.replies: dict[str, list[Reply]] = {}
        self.asked: list[tuple[str, dict[str, str]]] = []
        self.ended = threading.Event()  # set when the test is over: the silent replies end too

    def put(self, path: str, *replies: Reply) -> str:
        """Set the replies of a path, one a request, the last for all that follow; return the URL."""
        self.replies[path] = list(replies)
        return self.url + path

    def paths(self) -> list[str]:
        """Return the paths asked for, without queries."""
        return [urlsplit(path).path for path, _ in self.asked]


def send(body: bytes, status: int = 200, **headers: str) -> Reply:
    """Reply with a body; ``Content_Length`` stands for the header of that name and replaces the right one."""

    def reply(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        for name, value in ({"Content_Length": str(len(body))} | headers).items():
            if value:
                handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.wfile.write(body)

    return reply


def drip(piece: bytes, every_s: float) -> Reply:
    """Reply with a piece again and again, for `LONGEST_S` at most; an empty one is silence."""

    def reply(handler: BaseHTTPRequestHandler) -> None:
        send(b"", Content_Length="")(handler)
        begun_s = time.monotonic()
        while not handler.server.ended.wait(every_s) and time.monotonic() < begun_s + LONGEST_S:
            handler.wfile.write(piece)

    return reply


@contextmanager
def serve() -> Iterator[Server]:
    """Yield a server on a port of its own."""
    with Server() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server
        finally:
            server.ended.set()
            server.shutdown()
            thread.join()
