"""Patterns of visibility words against NumPy's."""

import numpy as np
import pytest

from jaxurban.kernels.patterns import MOST_WORDS, distinct_patterns, look_up


def city_words(num_words, num_cells=30_000, num_patterns=9_000, seed=0):
    """Return words of cells that often see what the cell before sees."""
    rng = np.random.default_rng(seed)
    patterns = rng.integers(0, 2**32, (num_words, num_patterns), np.uint32)
    return patterns[:, np.repeat(rng.integers(0, num_patterns, num_cells // 2), 2)]


@pytest.mark.parametrize("num_words", range(1, MOST_WORDS + 1))
def test_every_cell_finds_its_pattern_and_each_is_there_once(num_words):
    words = city_words(num_words)
    is_nothing = np.random.default_rng(1).random(words.shape[1]) < 0.3
    patterns, number = distinct_patterns(words, is_nothing, words.shape[1])
    expected = np.where(is_nothing, np.uint32(0), words)
    np.testing.assert_array_equal(patterns[:, number], expected)
    assert patterns.shape == np.unique(expected, axis=1).shape
    table = np.random.default_rng(2).random((patterns.shape[1], 3), np.float32)
    found = np.empty((3, len(number)), np.float32)
    look_up(table, number, found)
    np.testing.assert_array_equal(found, table[number].T)


def test_too_many_patterns_are_none():
    words, nowhere = np.arange(100, dtype=np.uint32)[None], np.zeros(100, bool)
    assert distinct_patterns(words, nowhere, 99) is None
    patterns, number = distinct_patterns(words, nowhere, 100)
    np.testing.assert_array_equal(patterns, words)
    np.testing.assert_array_equal(number, np.arange(100))
    assert distinct_patterns(np.zeros((MOST_WORDS + 1, 4), np.uint32), np.zeros(4, bool), 4) is None
    assert distinct_patterns(np.zeros((1, 0), np.uint32), np.zeros(0, bool), 0) is not None
