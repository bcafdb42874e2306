"""Ranks and their controls, against SciPy, by what was put into made-up tracks, and by coverage."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import spearmanr

from jaxurban.studies.receiver.validate import half_width, shifted, spearman, within_blocks, without_each_block

RNG = np.random.default_rng(4)
A, B = RNG.integers(0, 9, 60).astype(float), RNG.integers(0, 9, 60).astype(float)
PIECES = 8  # of a block of 200 m, 25 m each


def track(rng: np.random.Generator, num_blocks: int, num_maps: int = 1, of_blocks: float = 1.0) -> list[np.ndarray]:
    """Return satellites tracked and those on maps: alike within blocks, as neighbours are, and whole blocks alike."""
    num = num_blocks * PIECES
    shared = rng.normal(size=num)
    noise = [shared * 0.67 + 0.74 * rng.normal(size=num) for _ in range(1 + num_maps)]
    along = [lfilter([0.8], [1.0, -0.6], values) for values in noise]
    quarter = rng.normal(size=num_blocks)
    levels = [np.repeat(0.77 * quarter + 0.63 * rng.normal(size=num_blocks), PIECES) for _ in along]
    return [np.round(2 * (values + of_blocks * level)) for values, level in zip(along, levels, strict=True)]


def blocks(num_blocks: int) -> np.ndarray:
    return np.repeat(np.arange(num_blocks), PIECES)


def test_spearman_is_scipys():
    assert spearman(A, B) == pytest.approx(spearmanr(A, B).statistic, abs=1e-12)
    values = np.array([1.0, 2.0, np.inf, np.inf])
    assert spearman(values, np.arange(4.0)) == pytest.approx(spearmanr([0, 1, 2, 2], range(4)).statistic)


def test_what_does_not_vary_has_no_coefficient():
    assert np.isnan(spearman(A, np.zeros(60)))
    assert np.isnan(spearman(A, np.repeat([1.0, 2.0, 3.0], 20), np.repeat([0, 1, 2], 20)))


def test_quarters_that_differ_raise_the_whole_tracks_correlation_and_not_that_within_blocks():
    rng, of = np.random.default_rng(1), blocks(40)
    level = 20.0 * np.repeat(rng.normal(size=40), PIECES)
    receiver, maps = (level + rng.normal(size=len(of)) for _ in range(2))
    assert spearman(receiver, maps) > 0.95
    assert abs(spearman(receiver, maps, of)) < 0.15


def test_streets_that_agree_within_blocks_show_though_blocks_disagree():
    rng, of = np.random.default_rng(2), blocks(40)
    street = rng.normal(size=len(of))
    receiver, maps = (street + sign * 20.0 * np.repeat(rng.normal(size=40), PIECES) for sign in (1, -1))
    assert abs(spearman(receiver, maps)) < 0.3
    assert spearman(receiver, maps, of) > 0.5


def test_every_shift_is_scored_and_only_none_finds_the_pairs_again():
    at_shifts = shifted(lambda maps: spearman(A, maps), A)
    assert len(at_shifts) == 60
    assert at_shifts[0] == pytest.approx(1.0)
    assert at_shifts[1:].max() < 0.6
    assert at_shifts[7] == pytest.approx(spearmanr(A[:-7].tolist() + A[-7:].tolist(), np.roll(A, -7)).statistic)


@pytest.mark.slow
@pytest.mark.parametrize("num_blocks", [8, 39])
def test_the_95_percent_interval_within_blocks_holds_the_truth_in_93_percent_of_2000_tracks(num_blocks):
    truth = spearman(*track(np.random.default_rng(0), 20_000), blocks(20_000))
    rng, of = np.random.default_rng(num_blocks), blocks(num_blocks)
    scored = [within_blocks(*track(rng, num_blocks), of) for _ in range(2000)]
    assert np.mean([each.low <= truth <= each.high for each in scored]) >= 0.93


@pytest.mark.slow
@pytest.mark.parametrize("num_blocks", [8, 39])
def test_the_95_percent_interval_of_a_difference_holds_none_in_93_percent_of_2000_tracks(num_blocks):
    rng, of, holds = np.random.default_rng(num_blocks), blocks(num_blocks), []
    for _ in range(2000):
        receiver, one, other = track(rng, num_blocks, num_maps=2)
        value, without = (
            score(receiver, one, of) - score(receiver, other, of) for score in (spearman, without_each_block)
        )
        holds.append(abs(value) <= half_width(without))
    assert np.mean(holds) >= 0.93


def test_few_blocks_have_no_interval():
    scored = within_blocks(A, B, np.repeat(np.arange(6), 10))
    assert np.isfinite(scored.value)
    assert np.isnan(scored.low)


def test_without_the_one_block_that_disagrees_all_agree_and_no_interval_nor_warning_comes():
    a, blocks = np.arange(80.0), np.repeat(np.arange(8), 10)
    b = np.where(blocks == 7, a[::-1] + 70.0, a)
    scored = within_blocks(a, b, blocks)
    assert 0 < scored.value < 1
    assert np.isnan([scored.low, scored.high]).all()
