"""Tiles: true values of the maps at every stride, and what is kept."""

import zlib

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.viewer.tiles import TILE, Kept, middles, strides_of, tile_bytes

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
            for i, j in ((0, 0), (got.shape[0] - 1, got.shape[1] - 1)):
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
