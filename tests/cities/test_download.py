"""The polite client, against a server that misbehaves: what enters the cache is whole."""

import gzip
import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from importlib.metadata import version
from io import BytesIO

import pytest
import requests

from jaxurban.cities import download
from jaxurban.cities.download import Source, cache_folder
from jaxurban.errors import InputError
from tests.misbehaving_server import drip, send

BODY = b"good " * 2000
MB = 2**20
PACKED = gzip.compress(os.urandom(20_000))


def in_an_hour() -> str:
    """Return the time an hour from now, as a server writes it."""
    return format_datetime(datetime.now(UTC) + timedelta(hours=1), usegmt=True)


LATER = r"busy and asks you to try again in 3[56]\d\d s"


def get(url, *, fresh_s=0.0, num_tries=4):
    return download.download(
        Source("osm", url, "a.osm", "credit", "licence", fresh_s, num_tries), MB
    )


def assert_refused(url, match, **options):
    """Check that a download is refused in one sentence and leaves nothing at all in the cache."""
    with pytest.raises(InputError, match=match) as caught:
        get(url, **options)
    assert "\n" not in str(caught.value)
    assert list(cache_folder().iterdir()) == []


@pytest.mark.parametrize(
    ("replies", "body"),
    [
        ([send(BODY)], BODY),
        ([send(gzip.compress(BODY), Content_Encoding="gzip")], BODY),
        ([send(b"", 302, Location="/there")], b"there"),
        *(([send(BODY, Content_Length=none)], BODY) for none in ("\xb2", "-5")),
    ],
)
def test_a_file_arrives_whole_and_its_name_has_its_checksum(server, replies, body):
    server.put("/there", send(b"there"))
    path = get(server.put("/a", *replies))
    assert path.read_bytes() == body
    assert path.name.split("-")[1:] == [hashlib.sha256(body).hexdigest(), "a.osm"]
    assert list(cache_folder().iterdir()) == [path]
    assert server.asked[0][1]["User-Agent"].startswith(f"jaxurban/{version('jaxurban')} ")
    assert server.paths().count("/a") == 1


def test_a_fresh_copy_makes_no_request_unless_it_is_damaged_and_a_changed_file_replaces_an_old_one(
    server,
):
    url = server.put("/a", send(BODY), send(b"new"))
    assert get(url) == get(url, fresh_s=3600.0)
    assert len(server.asked) == 1
    get(url).write_bytes(b"ne")
    assert get(url, fresh_s=3600.0).read_bytes() == b"new"
    assert len(server.asked) == 3
    assert len(list(cache_folder().iterdir())) == 1


@pytest.mark.parametrize(
    ("reply", "sentence", "num_asked"),
    [
        (
            send(PACKED[:9000], Content_Length="20000", Content_Encoding="gzip"),
            "cannot be downloaded",
            1,
        ),
        (
            send(BODY[:99], Content_Length="999"),
            r"d \(ChunkedEncodingError\): .*run the same command again",
            1,
        ),
        (lambda handler: None, r"cannot be downloaded \(ConnectionError\): check the network", 1),
        (send(b"good", Content_Length=str(900 * MB)), "larger than 1.0 MB: .*--max-size", 1),
        (drip(b"good" * 50_000, 0.0), "larger than 1.0 MB", 1),
        (
            send(gzip.compress(b"good" + bytes(50 * MB)), Content_Encoding="gzip"),
            "larger than 1.0 MB",
            1,
        ),
        *(
            (send(b"no", status), f"answers {status} .*--source", 1)
            for status in (403, 404, 410, 500)
        ),
        (send(b"", 503), "answers 503 .*: run the same command later", 4),
        (send(b"", 429, Retry_After="3600"), LATER, 1),
        (lambda handler: send(b"", 429, Retry_After=in_an_hour())(handler), LATER, 1),
        *((send(b"", 429, Retry_After=wait), "cannot be downloaded", 1) for wait in ("-5", "soon")),
        (send(b"", 302, Location="http://[there"), "cannot be downloaded .*--source", 1),
        (
            send(b"", 302, Location="/a"),
            r"cannot be downloaded \(TooManyRedirects\)",
            download.MOST_REDIRECTS + 1,
        ),
        (send(BODY, Content_Length="9" * 400), "--max-size|cannot be downloaded", 1),
        (
            send(BODY, Content_Length="9" * 5000),
            "--max-size|cannot be downloaded",
            1,
        ),  # Python makes no number of it
    ],
)
def test_what_a_server_does_wrong_is_one_sentence_after_as_many_tries_as_are_polite(
    server, reply, sentence, num_asked
):
    assert_refused(server.put("/a", reply), sentence)
    assert len(server.asked) == num_asked


def test_a_busy_server_is_asked_once_where_it_wants_that(server):
    assert_refused(server.put("/a", send(b"", 503)), "answers 503", num_tries=1)
    assert len(server.asked) == 1


def test_a_silent_server_is_left(server, monkeypatch):
    monkeypatch.setattr(download, "TIMEOUT_S", 0.3)
    begun_s = time.monotonic()
    assert_refused(server.put("/a", drip(b"", 10.0)), "cannot be downloaded")
    assert time.monotonic() - begun_s < 5.0
    assert len(server.asked) == 1


def test_no_redirect_leads_from_an_encrypted_place_to_an_open_one(server, monkeypatch):
    url = server.put("/a", send(BODY))

    def moved(
        self, request, **options
    ):  # the server here has no certificate: one that has leads to it
        response = requests.Response()
        response.status_code, response.url, response.request, response.raw = (
            302,
            request.url,
            request,
            BytesIO(),
        )
        response.headers["Location"] = url
        return response

    monkeypatch.setattr(requests.adapters.HTTPAdapter, "send", moved)
    assert_refused("https://here.invalid/a", r"cannot be downloaded \(InvalidSchema\): .*--source")
    assert not server.asked


PLACES = {"far.example": "93.184.215.14", "near.example": "192.168.1.1"}


@pytest.mark.parametrize(
    ("host", "num_asked"),
    [
        *(
            (host, 1)
            for host in (
                "127.0.0.1",
                "127.1",
                "2130706433",
                "0.0.0.0",
                "[::1]",
                "[::ffff:127.0.0.1]",
                "localhost",
            )
        ),
        *((host, 1) for host in ("10.0.0.1", "169.254.169.254", "[fe80::1]", "near.example")),
        ("93.184.215.15", 2),
    ],
)
def test_no_redirect_leads_from_a_public_server_into_this_machine_or_its_network(
    server, monkeypatch, host, num_asked
):
    """All requests go by a proxy of this process; a place that is asked for by itself may lie there."""
    find = socket.getaddrinfo
    monkeypatch.setattr(
        socket, "getaddrinfo", lambda name, *how, **more: find(PLACES.get(name, name), *how, **more)
    )
    server.put("/a", send(b"", 302, Location=f"http://{host}/b"))
    server.put("/b", send(BODY))
    for name in ("NO_PROXY", "no_proxy", "http_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HTTP_PROXY", server.url)
    if num_asked == 2:
        assert get("http://far.example/a").read_bytes() == BODY
    else:
        assert_refused(
            "http://far.example/a",
            r"far\.example sends on to .*, an address of no public server: .*--source",
        )
    assert len(server.asked) == num_asked
    assert get("http://near.example/a").read_bytes() == BODY


@pytest.mark.parametrize("status", [429, 502, 503, 504])
def test_a_busy_server_is_asked_again(server, status, caplog):
    caplog.set_level("INFO", "jaxurban")
    assert (
        get(server.put("/a", send(b"", status), send(b"", status), send(BODY))).read_bytes() == BODY
    )
    assert sum("waiting before the next try" in line for line in caplog.messages) == 2


def test_a_server_is_given_the_time_it_asks_for(server):
    begun_s = time.monotonic()
    get(server.put("/a", send(b"", 429, Retry_After="1"), send(BODY)))
    assert time.monotonic() - begun_s >= 1.0


def test_a_killed_run_leaves_nothing_that_is_used(server):
    url = server.put("/a", drip(b"good" * 1000, 0.02))
    code = f"from jaxurban.cities.download import *\ndownload(Source('osm', {url!r}, 'a.osm', '', '', 3600.0), 10**9)\n"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL) as process:
        while not (server.asked and any(cache_folder().glob(".*"))):
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    server.put("/a", send(BODY))
    assert get(url, fresh_s=3600.0).read_bytes() == BODY


def test_no_password_of_netrc_is_sent_but_that_of_the_url_to_its_own_host(
    server, tmp_path, monkeypatch
):
    logins = (f"machine {host} login me password secret\n" for host in ("127.0.0.1", "localhost"))
    (tmp_path / "netrc").write_text("".join(logins))
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    url = server.put("/a", send(BODY))
    get(url)
    get(url.replace("//", "//me:mine@"))
    moved = server.put("/b", send(b"", 302, Location=url.replace("127.0.0.1", "localhost") + "?b"))
    get(moved.replace("//", "//me:mine@"))
    sent = [headers.get("Authorization") for _, headers in server.asked]
    assert sent == [None, "Basic bWU6bWluZQ==", "Basic bWU6bWluZQ==", None]


def test_proxies_are_used(server, monkeypatch):
    for name in ("NO_PROXY", "no_proxy", "http_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HTTP_PROXY", server.url)
    server.put("/a", send(BODY))
    assert get("http://far.invalid/a").read_bytes() == BODY
    assert server.asked[0][0] == "http://far.invalid/a"
