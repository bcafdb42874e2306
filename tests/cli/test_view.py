"""jaxurban view: what it writes, tells and refuses, and how it ends."""

import re
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    made_maps(24, 30).save(folder)
    return folder


def test_it_writes_one_file_that_asks_nobody(folder, tmp_path, capsys):
    code, _, err = run(capsys, "view", folder, "--export", tmp_path / "page.html")
    assert code == 0
    assert "open it in a browser" in err
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "connect-src 'none'" in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--export", "page.txt"], ["page.txt", ".html"]),
        (["--export", "no/such/place/page.html"], ["no/such/place"]),
        (["--resolution", "7"], ["7 m"]),
        (["--size", "0.0001"], ["--size"]),
        (["--port", "99999"], ["--port"]),
    ],
)
def test_bad_input_is_a_sentence(folder, arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, "view", folder, "--no-browser", *arguments)
    assert code == 2
    assert_one_sentence(err, *words)


def test_a_port_that_is_taken_is_a_sentence(folder, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        code, _, err = run(capsys, "view", folder, "--no-browser", "--port", taken.getsockname()[1])
    assert code == 2
    assert_one_sentence(err, "cannot listen", "--port")


@pytest.mark.slow
def test_it_serves_until_ctrl_c_and_then_ends_without_an_error(folder):
    command = [sys.executable, "-m", "jaxurban", "view", str(folder), "--no-browser"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        address = re.search(r"http://127\.0\.0\.1:\d+/", running.stderr.readline())[0]
        with urllib.request.urlopen(address, timeout=20) as page:
            assert b"<!doctype html>" in page.read()
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=30)
    assert running.returncode == 0
    assert "Traceback" not in said
