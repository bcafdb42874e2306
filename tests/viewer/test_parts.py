"""Parts of the page: tiles of the maps' true values, longitude and latitude by polynomials, and the one file of all."""

import base64
import hashlib
import re
import zlib

import numpy as np
import pyproj
import pytest

from jaxurban.errors import InputError
from jaxurban.viewer.html import html_page, part, policy_of
from jaxurban.viewer.tiles import TILE, Kept, lonlat_fit, middles, strides_of, tile_bytes
from jaxurban.world.grid import Grid

VALUES = np.random.default_rng(3).normal(size=(700, 530)).astype(np.float32)


def unpacked(data: bytes) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(data), np.uint8).reshape(4, -1)
    return np.ascontiguousarray(planes.T).view("<f4").ravel()


@pytest.mark.parametrize("stride", strides_of(VALUES.shape))
def test_tiles_of_a_stride_hold_the_middle_cell_of_each_square(stride):
    num_rows, num_cols = (-(-size // stride) for size in VALUES.shape)
    for row in range(-(-num_rows // TILE)):
        for col in range(-(-num_cols // TILE)):
            got = unpacked(tile_bytes(VALUES, stride, row, col)).reshape(min(TILE, num_rows - row * TILE), -1)
            for i, j in ((0, 0), np.subtract(got.shape, 1)):
                south, west = (row * TILE + i) * stride, (col * TILE + j) * stride
                square = VALUES[south : south + stride, west : west + stride]
                assert got[i, j] in square
                if square.shape == (stride, stride):
                    assert got[i, j] == square[stride // 2, stride // 2]


def test_at_stride_1_every_value_is_there_bit_for_bit():
    odd = VALUES.copy()
    odd[0, :4] = np.nan, np.inf, -np.inf, -0.0
    assert unpacked(tile_bytes(odd, 1, 0, 0)).tobytes() == np.ascontiguousarray(odd[:TILE, :TILE]).tobytes()


def test_the_last_stride_is_one_tile():
    assert strides_of((256, 256)) == [1]
    assert strides_of((257, 10)) == [1, 2]
    assert len(middles(700, strides_of(VALUES.shape)[-1])) <= TILE


@pytest.mark.parametrize("place", [(3, 0, 0), (1, -1, 0), (1, 3, 0), (1, 0, 99), (0, 0, 0)])
def test_a_tile_that_is_not_there_is_refused(place):
    with pytest.raises(InputError):
        tile_bytes(VALUES, *place)


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
    fit = lonlat_fit(Grid(crs, resolution_m, first_row, first_col, size, size))
    rng = np.random.default_rng(5)
    u, v = rng.uniform(-1, 1, (2, 2000))
    terms = u[:, None] ** fit["powers"][:, 0] * v[:, None] ** fit["powers"][:, 1]
    to_metres = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    x_m, y_m = to_metres.transform(terms @ fit["lon"], terms @ fit["lat"])
    off_m = np.hypot(x_m - corner[0] - (u + 1) / 2 * size_m, y_m - corner[1] - (v + 1) / 2 * size_m)
    assert off_m.max() < 0.1 * resolution_m


def test_the_page_is_at_most_650_lines_of_script_and_style():
    assert len(part("script").splitlines()) + len(part("style").splitlines()) <= 650
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
