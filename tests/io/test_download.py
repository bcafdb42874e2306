"""The polite client, against a server that misbehaves: what enters the cache is whole."""

import gzip
import hashlib
import os
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from io import BytesIO

import pytest
import requests

from jaxurban.errors import InputError
from jaxurban.io import download
from jaxurban.io.download import Source, cache_folder
from tests.misbehaving_server import drip, send, serve

BODY = b"good " * 2000
MB = 2**20


@pytest.fixture
def server(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(download, "BACKOFF", 0.01)
    with serve() as running:
        yield running


def get(url, *, most_bytes=MB, fresh_s=0.0, num_tries=4):
    return download.download(Source("osm", url, "a.osm", "credit", "licence", fresh_s, num_tries), most_bytes)


def assert_refused(url, match, **options):
    """Check that a download is refused in one sentence and leaves nothing at all in the cache."""
    with pytest.raises(InputError, match=match) as caught:
        get(url, **options)
    assert "\n" not in str(caught.value)
    assert list(cache_folder().iterdir()) == []


def test_a_file_arrives_whole_and_its_name_has_its_checksum(server):
    path = get(server.put("/a", send(BODY)))
    assert path.read_bytes() == BODY
    assert path.name.split("-")[1:] == [hashlib.sha256(BODY).hexdigest(), "a.osm"]
    assert list(cache_folder().iterdir()) == [path]


def test_the_client_names_itself_and_asks_once(server):
    get(server.put("/a", send(BODY)))
    ((_, headers),) = server.asked
    assert headers["User-Agent"].startswith("jaxurban/0.")


def test_a_packed_answer_is_unpacked(server):
    assert get(server.put("/a", send(gzip.compress(BODY), Content_Encoding="gzip"))).read_bytes() == BODY


def test_a_fresh_copy_makes_no_request_and_a_changed_file_replaces_an_old_one(server):
    url = server.put("/a", send(BODY), send(b"new"))
    assert get(url) == get(url, fresh_s=3600.0)
    assert len(server.asked) == 1
    assert get(url).read_bytes() == b"new"
    assert len(list(cache_folder().iterdir())) == 1


def test_a_damaged_copy_is_fetched_again(server):
    url = server.put("/a", send(BODY))
    get(url).write_bytes(BODY[:-1])
    assert get(url, fresh_s=3600.0).read_bytes() == BODY
    assert len(server.asked) == 2


def test_a_packed_file_cut_off_is_refused(server):
    packed = gzip.compress(os.urandom(20_000))
    url = server.put("/a", send(packed[:9000], Content_Length=str(len(packed)), Content_Encoding="gzip"))
    assert_refused(url, "cannot be downloaded", num_tries=1)


def test_a_file_cut_off_is_refused(server):
    url = server.put("/a", send(BODY[:5000], Content_Length=str(len(BODY))))
    assert_refused(url, r"cannot be downloaded \(ChunkedEncodingError\): .*run the same command again")


def test_a_server_that_closes_at_once_is_one_sentence(server):
    assert_refused(
        server.put("/a", lambda handler: None), r"cannot be downloaded \(ConnectionError\): check the network"
    )


def test_a_silent_server_is_left(server, monkeypatch):
    monkeypatch.setattr(download, "TIMEOUT_S", 0.3)
    begun_s = time.monotonic()
    assert_refused(server.put("/a", drip(server, b"", 10.0)), "cannot be downloaded")
    assert time.monotonic() - begun_s < 5.0
    assert len(server.asked) == 1


def test_no_redirect_leads_from_an_encrypted_place_to_an_open_one(server, monkeypatch):
    url = server.put("/a", send(BODY))

    def moved(self, request, **options):  # the server here has no certificate: one that has leads to it
        response = requests.Response()
        response.status_code, response.url, response.request, response.raw = 302, request.url, request, BytesIO()
        response.headers["Location"] = url
        return response

    monkeypatch.setattr(requests.adapters.HTTPAdapter, "send", moved)
    assert_refused("https://here.invalid/a", r"cannot be downloaded \(InvalidSchema\): .*--source")
    assert not server.asked


def test_a_declared_giant_is_refused_before_it_is_read(server):
    url = server.put("/a", send(b"good", Content_Length=str(900 * MB)))
    assert_refused(url, "larger than 1.0 MB: .*--max-size")


def test_an_undeclared_giant_is_stopped_at_the_limit(server):
    assert_refused(server.put("/a", drip(server, b"good" * 50_000, 0.0)), "larger than 1.0 MB")


def test_a_packed_giant_is_stopped_at_the_limit(server):
    packed = gzip.compress(b"good" + bytes(50 * MB))
    assert len(packed) < MB
    assert_refused(server.put("/a", send(packed, Content_Encoding="gzip")), "larger than 1.0 MB")


@pytest.mark.parametrize("status", [403, 404, 410, 500])
def test_a_refusal_is_taken_at_once(server, status):
    assert_refused(server.put("/a", send(b"no", status)), f"answers {status} .*--source")
    assert len(server.asked) == 1


@pytest.mark.parametrize("status", [429, 502, 503, 504])
def test_a_busy_server_is_asked_again(server, status, caplog):
    caplog.set_level("INFO", "jaxurban")
    assert get(server.put("/a", send(b"", status), send(b"", status), send(BODY))).read_bytes() == BODY
    assert sum("waiting before the next try" in line for line in caplog.messages) == 2


def test_a_busy_server_is_not_asked_for_ever(server):
    assert_refused(server.put("/a", send(b"", 503)), "answers 503 .*: run the same command later")
    assert len(server.asked) == 4


def test_a_busy_server_is_asked_once_where_it_wants_that(server):
    assert_refused(server.put("/a", send(b"", 503)), "answers 503", num_tries=1)
    assert len(server.asked) == 1


def test_a_server_is_given_the_time_it_asks_for(server):
    begun_s = time.monotonic()
    get(server.put("/a", send(b"", 429, Retry_After="1"), send(BODY)))
    assert time.monotonic() - begun_s >= 1.0


@pytest.mark.parametrize("is_date", [False, True])
def test_a_long_wait_is_the_users_to_make(server, is_date):
    wait = format_datetime(datetime.now(UTC) + timedelta(hours=1), usegmt=True) if is_date else "3600"
    assert_refused(server.put("/a", send(b"", 429, Retry_After=wait)), r"busy and asks to come again in 3[56]\d\d s")
    assert len(server.asked) == 1


def test_redirects_are_followed_but_not_in_circles(server):
    server.put("/here", send(b"", 302, Location="/there"))
    server.put("/there", send(BODY))
    assert get(server.url + "/here").read_bytes() == BODY
    server.put("/there", send(b"", 302, Location="/here"))
    assert_refused(server.url + "/here", r"cannot be downloaded \(TooManyRedirects\)")
    assert len(server.asked) == 2 + download.MOST_REDIRECTS + 1


def test_a_redirect_to_what_is_no_url_is_one_sentence(server):
    url = server.put("/here", send(b"", 302, Location="http://[there"))
    assert_refused(url, "cannot be downloaded .*--source")


@pytest.mark.parametrize("wait", ["-5", "soon"])
def test_a_wait_that_makes_no_sense_is_one_sentence(server, wait):
    assert_refused(server.put("/a", send(b"", 429, Retry_After=wait)), "cannot be downloaded")


@pytest.mark.parametrize("length", ["\xb2", "-5"])
def test_a_length_that_is_none_is_passed_over(server, length):
    assert get(server.put("/a", send(BODY, Content_Length=length))).read_bytes() == BODY


@pytest.mark.parametrize("num_digits", [400, 5000])  # of the second Python makes no number
def test_a_length_of_many_digits_is_refused(server, num_digits):
    assert_refused(server.put("/a", send(BODY, Content_Length="9" * num_digits)), "--max-size|cannot be downloaded")


def test_a_killed_run_leaves_nothing_that_is_used(server):
    url = server.put("/a", drip(server, b"good" * 1000, 0.02))
    code = f"from jaxurban.io.download import *\ndownload(Source('osm', {url!r}, 'a.osm', '', '', 3600.0), 10**9)\n"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL) as process:
        while not (server.asked and any(cache_folder().glob(".*"))):
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    server.put("/a", send(BODY))
    assert get(url, fresh_s=3600.0).read_bytes() == BODY


def test_no_password_of_netrc_is_sent_but_that_of_the_url_to_its_own_host(server, tmp_path, monkeypatch):
    (tmp_path / "netrc").write_text(
        "machine 127.0.0.1 login me password secret\nmachine localhost login me password b\n"
    )
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
