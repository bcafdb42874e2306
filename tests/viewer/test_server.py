"""The server with 300 hostile requests that it refuses in a sentence, and the parts of the page that it serves."""

import base64
import gzip
import hashlib
import http.client
import json
import re
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pyproj
import pytest

import jaxurban as ju
from jaxurban.viewer import server as serving
from jaxurban.viewer.html import html_page, part, policy_of
from jaxurban.viewer.server import MOST_BODY
from jaxurban.viewer.tiles import TILE, Kept, lonlat_fit, middles, packed_tile, strides_of
from jaxurban.viewer.viewer import JSON, Answer, Viewer
from tests.made_maps import made_maps
from tests.viewer.browser import served, unpacked

MAPS = made_maps(40, 60)
FREE = MAPS.is_free(20.0)
MISSION = {"at": [0, 0, 0], "file": "x.plan", "data": "e30=", "heights": None}
PLAN = {"start": [-75.0, 0.0], "goal": [-75.0, 0.0], "at": [0, 0, 0], "weights": {"distance": 0.1}}
ASKED = {"layer": "gps", "at": [0, 0, 0], "stride": 1, "row": 0, "col": 0}


@pytest.fixture(scope="module")
def server():
    with served(Viewer(MAPS)) as running:
        yield running


def ask(server, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, bytes]:
    """Return status and body of a reply; a header of None is left out."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    given = {
        "Host": f"127.0.0.1:{server.server_port}",
        "Content-Type": "application/json",
    } | headers
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    for name, value in ({"Content-Length": str(len(body))} | given).items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(body)
    with closing(connection), connection.getresponse() as reply:
        return reply.status, reply.read()


def post(server, name: str, body: object = None) -> tuple[int, bytes]:
    return ask(server, "POST", f"/ask/{name}", json.dumps(body or {}).encode())


def test_the_page_is_served_on_this_machine_alone_and_may_load_nothing_from_elsewhere(server):
    with closing(http.client.HTTPConnection("127.0.0.1", server.server_port)) as connection:
        connection.request("GET", "/")
        reply = connection.getresponse()
        policy = reply.headers["Content-Security-Policy"]
        assert b"<!doctype html>" in reply.read()
    assert server.server_address[0] == "127.0.0.1"
    assert "default-src 'none'" in policy
    assert "connect-src 'self'" in policy


def hostile(port: int) -> list[tuple[str, str, bytes, dict]]:
    """Return requests that no page of ours sends: method, path, body, headers."""
    own = f"127.0.0.1:{port}"
    paths = [
        *(
            "/../../etc/passwd",
            "/etc/passwd",
            "//etc/passwd",
            "/%2e%2e/%2e%2e/etc/passwd",
            "/..%2f..%2fetc/passwd",
        ),
        *(
            "/maps.zarr/5m/.zmetadata",
            "/run.json",
            "/ask",
            "/ask/",
            "/favicon.ico",
            "/index.html",
            "/viewer.js",
            "/?a",
        ),
        *(
            "/ask/scene/../tile",
            "/ask/__class__",
            "/ask/_cost_map",
            "/a" * 5000,
            "http://evil.example/",
            "*",
        ),
    ]
    hosts = ["evil.example", f"evil.example:{port}", "127.0.0.1", "localhost:1", "", "0.0.0.0"]
    hosts += [f"[::1]:{port}", own + "."]
    origins = ["evil.example", "127.0.0.1", f"evil.example:{port}"]
    origins = ["null", "https://" + own, "file://", *(f"http://{origin}" for origin in origins)]
    kinds = [
        "text/plain",
        "application/x-www-form-urlencoded",
        "multipart/form-data; boundary=x",
        "application/jsonx",
    ]
    lengths = [
        "-1",
        "1e9",
        "99999999999999999999",
        "0x10",
        "",
        " ",
        "+5",
        str(MOST_BODY + 1),
        "²",
        "1, 1",
    ]
    headers = [{"Host": host} for host in hosts] + [{"Origin": origin} for origin in origins]
    methods = ("PUT", "DELETE", "OPTIONS", "TRACE", "PATCH", "CONNECT", "FOO")
    bodies = [
        b"",
        b"{",
        b"[]",
        b"null",
        b"1",
        b'"x"',
        b"\xff\xfe",
        b"[" * 60_000,
        b'{"a":1}',
        b"NaN",
    ]
    bodies += [b"{" + b'"a":' * 9000]
    found = [
        *(
            (method, path, body, {})
            for path in paths
            for method, body in (("GET", b""), ("POST", b"{}"))
        ),
        *((method, "/", b"{}", {}) for method in methods),
        *(("POST", "/ask/scene", b"{}", header) for header in headers),
        *(("GET", "/", b"", header) for header in headers),
        *(("POST", "/ask/scene", b"{}", {"Content-Type": kind}) for kind in kinds),
        *(
            ("POST", "/ask/scene", b"{}", {"Content-Length": n.encode().decode("latin-1")})
            for n in lengths
        ),
        ("POST", "/ask/scene", b"0\r\n\r\n", {"Transfer-Encoding": "chunked"}),
        *(
            ("POST", f"/ask/{name}", body, {})
            for name in ("scene", "tile", "plan")
            for body in bodies
        ),
    ]
    odd = [-1, 10**9, 10**30, 1.5, "0", None, [], {}, True, "x" * 5000, [0] * 999]
    cell = {"at": [0, 0, 0], "row": 0, "col": 0}
    asked = [("tile", ASKED), ("plan", PLAN | {"planner": "astar-plus"}), ("values", cell)]
    asked += [("check", MISSION)]
    wrong = [
        (name, given | {key: value}) for name, given in asked for key in given for value in odd
    ]
    wrong += [
        ("tile", ASKED | each) for each in ({"stride": 0}, {"stride": 3}, {"row": 1}, {"col": 1})
    ]
    zones = [
        "x",
        "[]",
        '{"features":1}',
        '{"features":[{}]}',
        "{" * 999,
        '{"type":"FeatureCollection","features":[]}',
    ]
    rings = [
        [[0, 0], [1, 1]],
        [[0, 0]],
        [],
        [["a", "b"]],
        [[1e9, 0], [0, 1], [1, 1]],
        [[0, 0, 0, 0]] * 4,
        None,
    ]
    shapes = [{"type": "Polygon", "coordinates": [ring]} for ring in rings]
    zones += [
        json.dumps({"features": [{"type": "Feature", "geometry": shape}]}) for shape in shapes
    ]
    weights = ({"noise": 1}, {"gps": -1}, {"gps": "1"}, {"gps": 1e31}, {"": 1}, {"own": 1})
    odd_plans = [{"zones": text} for text in zones] + [{"weights": each} for each in weights]
    odd_plans += [
        {"planner": "rm -rf"},
        {"planner": "astar-volume"},
        {"unknown_heights": "x"},
    ]
    odd_plans += [
        {"clearance_m": -1},
        {"clearance_m": "1"},
        {"extra": 1},
        {"start": [0, 0]},
        {"goal": [40.0, -75.0]},
    ]
    wrong += [("plan", PLAN | each) for each in odd_plans]
    odd_asked = ({}, {"format": "../x"}, {"at": []})
    wrong += [
        (name, given) for name in ("save", "report", "legend", "values") for given in odd_asked
    ]
    return found + [
        ("POST", f"/ask/{name}", json.dumps(given).encode(), {}) for name, given in wrong
    ]


def test_300_hostile_requests_are_refused_in_a_sentence_and_none_reaches_a_traceback(
    server, caplog, capfd
):
    requests = hostile(server.server_port)
    for method, path, body, headers in requests:
        status, said = ask(server, method, path, body, **headers)
        assert 400 <= status < 500, (status, method, path[:60], body[:120], headers, said[:200])
        assert b"Traceback" not in said
        assert len(said.splitlines()) <= 1, said[:300]
    assert len(requests) >= 300
    assert not caplog.records
    out, err = capfd.readouterr()
    assert "Traceback" not in out + err
    assert post(server, "scene")[0] == 200


@pytest.mark.parametrize(
    "raw",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\nHost: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 200 + b"\r\n",
        b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n",
        b"POST /ask/scene HTTP/1.1\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nhello",
    ],
)
def test_what_is_no_request_is_refused(server, raw, capfd):
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=20) as connection:
        connection.sendall(raw)
        connection.shutdown(socket.SHUT_WR)
        reply = b"".join(iter(lambda: connection.recv(65536), b""))
    assert b" 4" in reply.split(b"\r\n")[0] or reply[:4] != b"HTTP", reply[:200]
    assert b"Traceback" not in reply
    assert "Traceback" not in "".join(capfd.readouterr())


def test_texts_are_compressed_where_the_browser_takes_that_and_say_the_same(server):
    plain = post(server, "scene")[1]
    reply = ask(server, "POST", "/ask/scene", b"{}", **{"Accept-Encoding": "gzip, br"})[1]
    assert gzip.decompress(reply) == plain
    assert len(reply) < len(plain) / 2


def test_maps_that_were_made_again_are_refused_until_the_page_is_loaded_again(tmp_path):
    def opened() -> Viewer:
        return Viewer(ju.open_maps(tmp_path))

    MAPS.save(tmp_path)
    with served(opened(), again=opened) as server:
        key = json.loads(post(server, "scene")[1])["key"]
        status, old = post(server, f"tile?{key}", ASKED)
        assert status == 200
        type(MAPS)(MAPS.ds.assign(gps=0.5 * MAPS.ds["gps"])).save(tmp_path)
        for name in ("tile", f"tile?{key}"):  # also what is kept of the old ones
            status, sentence = post(server, name, ASKED)
            assert status == 409
            assert b"were made again" in sentence
        assert ask(server, "GET", "/")[0] == 200
        assert post(server, f"tile?{key}", ASKED)[0] == 409  # another page, still open
        other = json.loads(post(server, "scene")[1])["key"]
        status, new = post(server, f"tile?{other}", ASKED)
        is_free = np.isfinite(unpacked(old))
        assert np.allclose(unpacked(new)[is_free], 0.5 * unpacked(old)[is_free])


@pytest.mark.slow
def test_none_of_500_connections_at_once_is_reset(server):
    with ThreadPoolExecutor(500) as threads:
        replies = [threads.submit(post, server, "scene") for _ in range(500)]
    assert {reply.result()[0] for reply in replies} == {200}


def test_a_request_that_does_not_go_on_ends(server, monkeypatch):
    monkeypatch.setattr(server.RequestHandlerClass, "timeout", 0.4)
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=5) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nA: ")
        assert connection.recv(1) == b""


VALUES = np.random.default_rng(3).normal(size=(700, 530)).astype(np.float32)


@pytest.mark.parametrize("stride", strides_of(VALUES.shape))
def test_tiles_of_a_stride_hold_the_middle_cell_of_each_square(stride):
    num_rows, num_cols = (-(-size // stride) for size in VALUES.shape)
    for row in range(-(-num_rows // TILE)):
        for col in range(-(-num_cols // TILE)):
            got = unpacked(packed_tile(VALUES, stride, row, col)).reshape(
                min(TILE, num_rows - row * TILE), -1
            )
            for i, j in ((0, 0), np.subtract(got.shape, 1)):
                south, west = (row * TILE + i) * stride, (col * TILE + j) * stride
                square = VALUES[south : south + stride, west : west + stride]
                assert got[i, j] in square
                if square.shape == (stride, stride):
                    assert got[i, j] == square[stride // 2, stride // 2]


def test_at_stride_1_every_value_is_there_bit_for_bit():
    odd = VALUES.copy()
    odd[0, :4] = np.nan, np.inf, -np.inf, -0.0
    assert (
        unpacked(packed_tile(odd, 1, 0, 0)).tobytes()
        == np.ascontiguousarray(odd[:TILE, :TILE]).tobytes()
    )


def test_the_last_stride_is_one_tile():
    assert strides_of((256, 256)) == [1]
    assert strides_of((257, 10)) == [1, 2]
    assert len(middles(700, strides_of(VALUES.shape)[-1])) <= TILE


def test_what_is_kept_stays_below_its_bound():
    kept, made = Kept(3 * 80), []

    def make(key: int) -> np.ndarray:
        made.append(key)
        return np.zeros(10)

    for key in (1, 2, 3, 1, 4, 1, 2):
        kept.get(key, lambda key=key: make(key))
        assert kept.size <= 3 * 80
    assert made == [1, 2, 3, 4, 2]


@pytest.mark.parametrize(
    ("crs", "corner", "size_m"),
    [
        ("EPSG:32618", (584_000, 4_505_000), 20_000),
        ("EPSG:32618", (300_000, 7_800_000), 20_000),  # far north, far from the central meridian
        ("EPSG:32755", (320_000, 5_810_000), 40_000),
        ("EPSG:2154", (640_000, 6_850_000), 20_000),  # Lambert's conic
        ("EPSG:3035", (4_320_000, 3_200_000), 20_000),  # equal areas
    ],
)
@pytest.mark.parametrize("resolution_m", [1.0, 5.0])
def test_the_fit_is_within_a_tenth_of_a_cell_of_proj(crs, corner, size_m, resolution_m):
    first_col, first_row = (int(value / resolution_m) for value in corner)
    size = int(size_m / resolution_m)
    fit = lonlat_fit(ju.Grid(crs, resolution_m, first_row, first_col, size, size))
    rng = np.random.default_rng(5)
    u, v = rng.uniform(-1, 1, (2, 2000))
    terms = u[:, None] ** fit["powers"][:, 0] * v[:, None] ** fit["powers"][:, 1]
    to_metres = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    x_m, y_m = to_metres.transform(terms @ fit["lon"], terms @ fit["lat"])
    off_m = np.hypot(x_m - corner[0] - (u + 1) / 2 * size_m, y_m - corner[1] - (v + 1) / 2 * size_m)
    assert off_m.max() < 0.1 * resolution_m


def test_the_page_is_at_most_1060_lines_of_script_and_style():
    assert len(part("script").splitlines()) + len(part("style").splitlines()) <= 1060
    assert max(len(line) for name in ("script", "style") for line in part(name).splitlines()) <= 120


def test_the_page_names_no_other_host():
    assert not re.findall(r"https?:|//[a-z]+\.", html_page())
    assert not re.findall(r"@import|url\(", part("style"))


def test_data_in_the_page_cannot_end_its_element():
    page = html_page('{"a": "</script><script>alert(1)</script>"}', "<b>")
    assert "alert(1)</script>" not in page
    assert "<title>&lt;b&gt;</title>" in page
    assert "connect-src 'none'" in page


def test_the_policy_allows_the_page_its_own_script_alone():
    policy = policy_of("'self'")
    script = re.findall(r'<script type="module">(.*?)</script>', html_page(), re.DOTALL)[-1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    assert "unsafe-eval" not in policy


def test_missions_take_turns_and_nobody_waits_for_one_who_sends_nothing(monkeypatch):
    at_once, most = [], []

    def answer(viewer, name, params):
        at_once.append(name)
        most.append(len(at_once))
        time.sleep(0.05)
        at_once.remove(name)
        return Answer(JSON, b"{}")

    monkeypatch.setattr(Viewer, "answer", answer)
    with served(Viewer(MAPS)) as server, ThreadPoolExecutor(8) as pool:
        silent = [socket.create_connection(server.server_address) for _ in range(8)]
        for each in silent:
            head = f"POST /ask/check HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\n"
            each.sendall(f"{head}Content-Type: {JSON}\r\nContent-Length: 9\r\n\r\n".encode())
        began = time.perf_counter()
        replies = list(pool.map(lambda _: post(server, "check", MISSION), range(8)))
        assert [status for status, _ in replies] == [200] * 8
        assert max(most) == 1
        assert time.perf_counter() - began < 5
        list(pool.map(lambda _: post(server, "plan", PLAN), range(8)))
        assert max(most) > 1
        for each in silent:
            each.close()


def test_one_who_stops_within_a_mission_is_given_up_soon(monkeypatch):
    monkeypatch.setattr(serving, "TURN_PATIENCE_S", 0.2)
    with served(Viewer(MAPS)) as server, closing(socket.socket()) as stopped:
        stopped.connect(server.server_address)
        head = f"POST /ask/check HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\n"
        stopped.sendall(f"{head}Content-Type: {JSON}\r\nContent-Length: 9\r\n\r\n{{".encode())
        time.sleep(0.05)
        began = time.perf_counter()
        assert post(server, "check", MISSION)[0] == 400
        assert time.perf_counter() - began < 5
        assert stopped.recv(9) == b""
