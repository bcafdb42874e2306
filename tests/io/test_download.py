"""The polite client, against a server that misbehaves: what enters the cache is whole and passes its check."""

import gzip
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from io import BytesIO
from types import SimpleNamespace

import pytest
import requests

from jaxurban.errors import InputError
from jaxurban.io import download
from jaxurban.io.download import Source, cache_folder, open_cache
from jaxurban.io.files import LOCK_FILE
from jaxurban.maps.memory import parse_bytes
from tests.misbehaving_server import drip, send, serve, unless_known

BODY = b"good " * 2000
MB = 2**20


@pytest.fixture
def server(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(download, "BACKOFF", 0.01)
    with serve() as running:
        yield running


def is_good(path):
    if not path.read_bytes().startswith(b"good"):
        raise InputError("it is not good")
    return path


def get(url, *, most_bytes=MB, timeout_s=5.0, is_offline=False, **options):
    """Return the facts of a file, and where the cache has it."""
    source = Source("osm", url, "credit", "licence", **({"fresh_s": 0.0} | options))
    with open_cache(most_bytes=most_bytes, timeout_s=timeout_s, is_offline=is_offline) as cache:
        _, facts, _ = cache.get(source, url, is_good)
    return SimpleNamespace(
        path=next(cache_folder().glob(f"{hashlib.sha256(url.encode()).hexdigest()[:9]}*.body")), **facts
    )


def files_in_cache():
    return sorted(path.name for path in cache_folder().iterdir())


def assert_refused(url, match, **options):
    """Check that a download is refused in one sentence and leaves nothing at all in the cache."""
    with pytest.raises(InputError, match=match) as caught:
        get(url, **options)
    assert "\n" not in str(caught.value)
    assert files_in_cache() == []


def test_a_file_arrives_whole_and_says_what_it_is(server):
    kept = get(server.put("/a", send(BODY, ETag='"1"')))
    assert kept.path.read_bytes() == BODY
    assert (kept.num_bytes, kept.sha256) == (len(BODY), hashlib.sha256(BODY).hexdigest())
    assert len(files_in_cache()) == 2  # the body and what is known of it


def test_the_client_names_itself_and_asks_once(server):
    get(server.put("/a", send(BODY)))
    ((_, headers),) = server.asked
    assert headers["User-Agent"].startswith("jaxurban/0.")


def test_a_packed_answer_is_unpacked(server):
    kept = get(server.put("/a", send(gzip.compress(BODY), Content_Encoding="gzip")))
    assert kept.path.read_bytes() == BODY


def test_a_fresh_copy_makes_no_request(server):
    url = server.put("/a", send(BODY))
    assert get(url).path == get(url, fresh_s=3600.0).path
    assert len(server.asked) == 1


def test_an_old_copy_is_asked_after_and_kept_if_it_has_not_changed(server):
    url = server.put("/a", unless_known('"7"', BODY))
    first, second = get(url), get(url)
    assert [headers.get("If-None-Match") for _, headers in server.asked] == [None, '"7"']
    assert (second.path.read_bytes(), second.fetched_utc) == (BODY, first.fetched_utc)


def test_a_changed_file_replaces_the_old_copy(server):
    url = server.put("/a", send(BODY, ETag='"1"'), send(b"good, and new"))
    get(url)
    assert get(url).path.read_bytes() == b"good, and new"
    assert server.asked[1][1]["If-None-Match"] == '"1"'
    assert len(files_in_cache()) == 2


@pytest.mark.parametrize("damage", [lambda path: path.write_bytes(BODY[:-1]), lambda path: path.unlink()])
def test_a_copy_that_is_not_as_it_was_is_fetched_again(server, damage):
    url = server.put("/a", send(BODY))
    damage(get(url).path)
    assert get(url, fresh_s=3600.0).path.read_bytes() == BODY
    assert len(server.asked) == 2


def test_a_refused_new_version_leaves_the_old_copy(server):
    url = server.put("/a", send(BODY), send(b"<html>maintenance</html>"))
    get(url)
    with pytest.raises(InputError, match="not good"):
        get(url)
    assert get(url, is_offline=True).path.read_bytes() == BODY


def test_a_packed_file_cut_off_is_refused(server):
    packed = gzip.compress(os.urandom(20_000))
    url = server.put("/a", send(packed[:9000], Content_Length=str(len(packed)), Content_Encoding="gzip"))
    assert_refused(url, "broke off", num_tries=1)


def test_a_file_cut_off_is_refused(server):
    url = server.put("/a", send(BODY[:5000], Content_Length=str(len(BODY))))
    assert_refused(url, "broke off in the middle of the file: run the same command again")


def test_a_server_that_closes_at_once_is_one_sentence(server):
    assert_refused(server.put("/a", lambda handler: None), "breaks off: check the network")


def test_no_redirect_leads_from_an_encrypted_place_to_an_open_one(server, monkeypatch):
    url = server.put("/a", send(BODY))

    def moved(self, request, **options):  # the server here has no certificate: one that has leads to it
        response = requests.Response()
        response.status_code, response.url, response.request, response.raw = 302, request.url, request, BytesIO()
        response.headers["Location"] = url
        return response

    monkeypatch.setattr(requests.adapters.HTTPAdapter, "send", moved)
    assert_refused("https://here.invalid/a", "leads to http:.*, which is not encrypted")
    assert not server.asked


def test_a_silent_server_is_left(server):
    begun_s = time.monotonic()
    assert_refused(server.put("/a", drip(server, b"", 10.0)), "falls silent", timeout_s=0.3)
    assert time.monotonic() - begun_s < 5.0
    assert len(server.asked) == 1


def test_a_declared_giant_is_refused_before_it_is_read(server):
    url = server.put("/a", send(b"good", Content_Length=str(900 * MB)))
    assert_refused(url, r"larger than 1.0 MB \(900.0 MB or more\): .*--max-size")


def test_an_undeclared_giant_is_stopped_at_the_limit(server):
    assert_refused(server.put("/a", drip(server, b"good" * 50_000, 0.0)), "larger than 1.0 MB")


def test_a_packed_giant_is_stopped_at_the_limit(server):
    packed = gzip.compress(b"good" + bytes(50 * MB))
    assert len(packed) < MB
    assert_refused(server.put("/a", send(packed, Content_Encoding="gzip")), "larger than 1.0 MB")


def test_a_web_page_instead_of_the_file_is_refused(server):
    assert_refused(server.put("/a", send(b"<html>log in</html>")), "not the osm file that was requested: it is not")


def test_an_empty_answer_is_refused(server):
    assert_refused(server.put("/a", send(b"")), "not the osm file")


@pytest.mark.parametrize("status", [403, 404, 410, 500])
def test_a_refusal_is_taken_at_once(server, status):
    assert_refused(server.put("/a", send(b"no", status)), f"answers {status} .*--source")
    assert len(server.asked) == 1


@pytest.mark.parametrize("status", [429, 502, 503, 504])
def test_a_busy_server_is_asked_again(server, status, caplog):
    caplog.set_level("INFO", "jaxurban")
    kept = get(server.put("/a", send(b"", status), send(b"", status), send(BODY)))
    assert kept.path.read_bytes() == BODY
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
    assert get(server.url + "/here").path.read_bytes() == BODY
    for name in files_in_cache():
        (cache_folder() / name).unlink()
    server.put("/there", send(b"", 302, Location="/here"))
    assert_refused(server.url + "/here", "leads in circles")
    assert len(server.asked) == 2 + download.MOST_REDIRECTS + 1


def test_a_redirect_to_what_is_no_url_is_one_sentence(server):
    assert_refused(server.put("/here", send(b"", 302, Location="http://[there")), "cannot be requested .*--source")


@pytest.mark.parametrize("length", ["\xb2", "-5"])
def test_a_length_that_is_none_is_passed_over(server, length):
    assert get(server.put("/a", send(BODY, Content_Length=length))).path.read_bytes() == BODY


def test_a_length_of_many_digits_is_too_large(server):
    assert_refused(server.put("/a", send(BODY, Content_Length="9" * 5000)), "larger than 1.0 MB")


def test_a_size_is_told_as_it_was_given():
    assert download.megabytes(parse_bytes("500MB")) == "500.0 MB"


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
    assert get("http://far.invalid/a").path.read_bytes() == BODY
    assert server.asked[0][0] == "http://far.invalid/a"


@pytest.mark.parametrize("wait", ["-5", "soon", "9" * 400])
def test_a_wait_that_makes_no_sense_is_one_sentence(server, wait):
    assert_refused(server.put("/a", send(b"", 429, Retry_After=wait)), "cannot be requested")


def test_without_a_network_the_remedy_is_named(server):
    url = server.put("/a", send(BODY))
    nowhere = "http://127.0.0.1:9/a"  # the discard port: nobody listens
    assert_refused(nowhere, "127.0.0.1:9/a cannot be reached.*: check the network .*--offline")
    assert_refused(url, "is not in the cache .*without --offline", is_offline=True)
    get(url)
    assert get(url, is_offline=True).path.read_bytes() == BODY


def test_two_runs_do_not_share_the_cache_at_a_time(server):
    url = server.put("/a", send(BODY))
    with (
        open_cache(most_bytes=MB, timeout_s=5.0, is_offline=False),
        pytest.raises(InputError, match=r"another run is writing .*XDG_CACHE_HOME"),
    ):
        get(url)


def test_a_killed_run_leaves_nothing_that_is_used(server):
    url = server.put("/a", drip(server, b"good" * 1000, 0.02))
    code = (
        "from jaxurban.io.download import *\n"
        "with open_cache(most_bytes=10**9, timeout_s=60.0, is_offline=False) as cache:\n"
        f"    cache.get(Source('osm', '', '', '', 0.0), {url!r}, print)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL) as process:
        while not (server.asked and any(cache_folder().glob(".*"))):
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    assert not list(cache_folder().glob("*.json"))
    server.put("/a", send(BODY))
    assert get(url).path.read_bytes() == BODY
    assert len(files_in_cache()) == 2


def test_what_is_known_of_a_file_is_json(server):
    url = server.put("/a", send(BODY))
    facts = json.loads(get(url).path.with_suffix(".json").read_text())
    assert facts["url"] == url


@pytest.mark.parametrize(
    "damage",
    [
        {"sha256": 5},
        {"colour": "red"},
    ],
)
def test_a_damaged_entry_of_the_cache_is_fetched_again(server, damage):
    url = server.put("/a", send(BODY))
    facts_file = get(url).path.with_suffix(".json")
    facts_file.write_text(json.dumps(json.loads(facts_file.read_text()) | damage))
    assert get(url, fresh_s=3600.0).path.read_bytes() == BODY
    assert len(server.asked) == 2
    facts_file.write_text("[" * 100_000)
    assert get(url, fresh_s=3600.0).path.read_bytes() == BODY


def test_a_copy_that_fails_its_check_is_asked_for_anew(server, monkeypatch):
    url = server.put("/a", send(b"bad"), unless_known('"7"', BODY))
    with monkeypatch.context() as patch:
        patch.setitem(globals(), "is_good", lambda path: None)  # an earlier version saw no fault
        get(url)
    with pytest.raises(InputError, match=r"has a copy that does not serve .it is not good"):
        get(url, is_offline=True)
    assert get(url, fresh_s=3600.0).path.read_bytes() == BODY


def test_a_cache_that_cannot_be_written_to_can_be_read(server):
    url = server.put("/a", send(BODY))
    get(url)
    (cache_folder() / LOCK_FILE).mkdir()
    with pytest.raises(InputError, match=r"cannot write to .*set XDG_CACHE_HOME"):
        get(url)
    assert get(url, is_offline=True).path.read_bytes() == BODY
