"""Strata, against the definition counted cell by cell."""

import numpy as np
import shapely

from jaxurban.studies.montecarlo.sampling import HIGH_RISE_M, NO_STRATUM, STRATA, share_around, strata_of
from jaxurban.world.city import LandCover
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
    told = {STRATA.index(name) for name in STRATA if name not in ("water", "park")}
    assert set(np.unique(strata)) == {NO_STRATUM, *told}
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


def test_water_and_parks_are_the_cells_whose_centre_they_hold():
    maps = made_maps(60, 60)
    grid = maps.grid
    x_m, y_m = grid.x_min_m, grid.y_min_m
    river, park = shapely.box(x_m, y_m, x_m + 104, y_m + 600), shapely.box(x_m + 94, y_m + 96, x_m + 300, y_m + 204)
    strata, plain = strata_of(maps, LandCover(river, park)), strata_of(maps)
    in_river, in_park = np.zeros((2, *grid.shape), bool)
    in_river[:, :10] = True  # centres at 5, 15, ... 95 m; water wins over a park
    in_park[10:20, 10:30] = True
    assert (strata[in_river] == STRATA.index("water")).all()
    assert (strata[in_park] == STRATA.index("park")).all()
    assert np.array_equal(strata[~(in_river | in_park)], plain[~(in_river | in_park)])
