"""Each closed cell has the cause that closes it first, against cells that are counted by hand."""

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.zone import Zone
from jaxurban.paths.closed import CAUSES, causes_at, constraints_of, shares_of
from tests.made_maps import made_maps

NOTHING = ju.Constraints(clearance_m=0.0, vertical_clearance_m=0.0)


@pytest.fixture(scope="module")
def maps():
    """Maps of bare ground with single cells: a tower, one that a roof touches, a low roof, a guess, and no data."""
    made = made_maps(20, 20)
    roof_m = np.zeros(made.grid.shape, np.float32)
    roof_m[5, 5] = 50.0
    touched_m = roof_m.copy()
    touched_m[5, 6] = 50.0
    for raster_m in (roof_m, touched_m):
        raster_m[5, 15] = 18.0
        raster_m[15, 5] = 10.0
    limit_m = np.where(roof_m == 10, np.float32(35), np.float32(0))
    has_data = np.ones(made.grid.shape, bool)
    has_data[15, 15] = False
    planes = {
        "roof": roof_m,
        "roof_touched": touched_m,
        "roof_limit": limit_m,
        "roof_guessed": limit_m > 0,
        "has_data": has_data,
    }
    ds = made.ds.assign({name: (("y", "x"), values) for name, values in planes.items()})
    z_m = ds["altitude"].values[:, None, None]
    return type(made)(ds.assign(obstacle=(ds["obstacle"].dims, (roof_m >= z_m).astype(np.uint8))))


def causes_of(maps, limits) -> dict[tuple[int, int], str]:
    """Return the cause of each closed cell, by its row and column."""
    causes = causes_at(maps, limits, 20.0)
    assert np.array_equal(causes == 0, ju.cost_map(maps, 20.0, constraints=limits).is_free)
    return {(int(row), int(col)): CAUSES[causes[row, col]] for row, col in np.argwhere(causes)}


def test_each_cell_has_the_first_cause_that_closes_it(maps):
    closed = {
        (5, 5): "obstacle",
        (5, 6): "touched by an obstacle",
        (15, 5): "unknown height",
        (15, 15): "no data",
    }
    assert causes_of(maps, NOTHING) == closed
    over = ju.Constraints(clearance_m=0.0, vertical_clearance_m=3.0)
    assert causes_of(maps, over) == closed | {(5, 15): "vertical clearance"}


def test_cells_beside_a_guessed_height_are_closed_by_it_and_the_rest_by_the_clearance(maps):
    wide = causes_of(maps, ju.Constraints(clearance_m=12.0, vertical_clearance_m=0.0))
    assert wide[14, 5] == wide[15, 4] == "unknown height"
    assert wide[4, 5] == wide[5, 7] == wide[0, 10] == "clearance beside"


def test_zones_and_bounds_come_last(maps):
    lonlat = maps.grid.lonlat_of_cell
    (west, south), (east, north) = lonlat(9, 9), lonlat(10, 10)
    zone = Zone("park", shapely.box(west, south, east, north))
    limits = ju.Constraints((zone,), clearance_m=0.0, vertical_clearance_m=0.0)
    causes = causes_of(maps, limits)
    assert {causes[cell] for cell in ((9, 9), (9, 10), (10, 9), (10, 10))} == {"zone or bound"}
    assert causes[5, 5] == "obstacle"
    bound = ju.Constraints.read(require="gps>=0.5", clearance_m=0.0, vertical_clearance_m=0.0)
    is_bad = maps.m("gps", 20.0) < 0.5
    assert sum(cause == "zone or bound" for cause in causes_of(maps, bound).values()) == (
        is_bad.sum() - sum(is_bad[cell] for cell in causes_of(maps, NOTHING))
    )


def test_shares_are_of_all_cells_and_add_up(maps):
    shares = shares_of(causes_at(maps, NOTHING, 20.0))
    assert sum(shares.values()) == pytest.approx(1)
    assert shares["obstacle"] == pytest.approx(1 / 400)
    assert shares["free"] == pytest.approx(396 / 400)
    assert list(shares) == list(CAUSES)


def test_a_path_says_under_which_constraints_it_was_planned(maps):
    limits = ju.Constraints.read(
        require="gps>=0.1",
        clearance_m=2.0,
        vertical_clearance_m=0.0,
        vehicle=ju.Vehicle(speed_m_s=5.0),
        unknown_heights="highest",
    )
    ends = maps.grid.lonlat_of_cell(10, 2), maps.grid.lonlat_of_cell(10, 18)
    path = ju.plan(maps, *ends, altitude_m=20.0, constraints=limits, snap=True)
    assert constraints_of(path) == limits
