"""Strata, against the definition counted cell by cell."""

import numpy as np

from jaxurban.studies.strata import HIGH_RISE_M, NO_STRATUM, STRATA, share_around, strata_of
from tests.made_maps import made_maps


def around(mask: np.ndarray, row: int, col: int, half: int) -> np.ndarray:
    return mask[max(0, row - half) : row + half + 1, max(0, col - half) : col + half + 1]


def test_the_share_around_a_cell_is_counted_over_the_square_inside_the_map():
    mask = np.random.default_rng(0).random((13, 9)) < 0.3
    found = share_around(mask, 2)
    for row, col in np.ndindex(mask.shape):
        assert found[row, col] == around(mask, row, col, 2).mean()


def test_every_cell_lies_in_the_stratum_that_its_surroundings_define():
    maps = made_maps(150, 120)
    maps.ds["roof"][:, 50:] = 0.0
    maps.ds["has_data"][:5] = False
    roof_m, strata = maps.m("roof"), strata_of(maps)
    assert set(np.unique(strata)) == {NO_STRATUM, *range(len(STRATA))}
    assert (strata[:5] == NO_STRATUM).all()
    rng = np.random.default_rng(1)
    for row, col in zip(rng.integers(5, 150, 300), rng.integers(0, 120, 300), strict=True):
        near, far = around(roof_m, row, col, 12), around(roof_m, row, col, 25)
        if (near >= HIGH_RISE_M).mean() >= 0.1:
            wanted = "high-rise"
        elif (near > 0).mean() >= 0.1:
            wanted = "low-rise"
        else:
            wanted = "open" if far.any() else "wide-open"
        assert STRATA[strata[row, col]] == wanted
