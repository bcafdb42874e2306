"""The cheapest route that a check compares a mission's way out with: as clear as the mission, and by cells as it is."""

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.sparse.csgraph import dijkstra

import jaxurban as ju
from jaxurban.flights.flown import cells_as_clear
from jaxurban.flights.missions.parts import Leg, Mission, Place
from tests.made_maps import made_maps
from tests.volumes import ends_at, with_roofs

SIDE_M, FLOWN_M = 10.0, 50.0
BY_LENGTH = ju.Weights(distance=1.0, gps=0.0, lidar=0.0, population=0.0, risk=0.0)


def maps_of(roof_m: np.ndarray) -> ju.MetricMaps:
    """Return maps with these roofs, at the altitude of the missions here."""
    return with_roofs(made_maps(*roof_m.shape, (20.0, FLOWN_M), resolution_m=SIDE_M), roof_m)


def mission_of(
    maps: ju.MetricMaps, *cells: tuple[int, int], kinds: tuple[str, ...] = ()
) -> Mission:
    """Return a mission through the middles of cells, its legs of these kinds or plain ones."""
    places = [
        Place(*map(float, maps.grid.lonlat_of_cell(*cell)), FLOWN_M, "ground") for cell in cells
    ]
    pairs = zip(places[:-1], places[1:], kinds or ["leg"] * (len(cells) - 1), strict=True)
    legs = tuple(Leg(a, b, kind, item) for item, (a, b, kind) in enumerate(pairs, 2))
    return Mission("made", legs, places[0][:2], None, (), None)


def figures_of(maps: ju.MetricMaps, *cells: tuple[int, int], **more) -> dict:
    """Return the figures of a check of a mission through cells, by length alone."""
    return ju.check(maps, mission_of(maps, *cells, **more), weights=BY_LENGTH).figures


def grid_m(is_open: np.ndarray, start: tuple[int, int], end: tuple[int, int]) -> float:
    """Return the shortest way from cell to cell by SciPy, which cuts no corner of a closed cell."""
    number = np.arange(is_open.size).reshape(is_open.shape)
    rows, cols = is_open.shape
    edges = []
    for row, col in np.argwhere(is_open):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            to = row + down, col + right
            if not (to[0] < rows and 0 <= to[1] < cols):
                continue
            if is_open[to] and is_open[row, to[1]] and is_open[to[0], col]:
                edges.append((number[row, col], number[to], SIDE_M * np.hypot(down, right)))
    begin, finish, length_m = np.array(edges).T
    graph = sparse.coo_array(
        (length_m, (begin.astype(int), finish.astype(int))), (rows * cols,) * 2
    )
    return float(dijkstra(graph.tocsr(), directed=False, indices=number[start])[number[end]])


@pytest.mark.parametrize("seed", range(4))
def test_cells_are_as_clear_that_are_no_nearer_to_walls_and_to_higher_roofs(seed):
    rng = np.random.default_rng(seed)
    roof_m = np.where(rng.random((16, 18)) < 0.15, rng.integers(5, 60, (16, 18)), 0).astype(float)
    is_own = np.zeros(roof_m.shape, bool)
    is_own[8, 4:14] = True
    roof_m[5:12, 2:16] = 0  # so that the mission keeps a distance
    roof_m[is_own] = rng.integers(0, 20, is_own.sum())
    row, col = np.indices(roof_m.shape)
    highest_m = roof_m[is_own].max()
    expected = roof_m <= highest_m
    # By brute force: the distance between squares from each cell to all that is as high.
    for is_obstacle in (roof_m > highest_m, roof_m >= FLOWN_M):
        away = np.full(roof_m.shape, np.inf)
        for r, c in np.argwhere(is_obstacle):
            apart = np.hypot(np.maximum(abs(row - r) - 1, 0), np.maximum(abs(col - c) - 1, 0))
            away = np.minimum(away, apart)
        assert away[is_own].min() >= 2
        expected &= away >= away[is_own].min() - 1e-9
    found = cells_as_clear(ju.cost_map(maps_of(roof_m), FLOWN_M), is_own)
    np.testing.assert_array_equal(found, expected)
    assert found[is_own].all()
    assert not found.all()


def test_every_cell_is_as_clear_where_nothing_is_higher_than_below_the_mission():
    roof_m = np.full((16, 18), 12.0)
    is_own = np.zeros(roof_m.shape, bool)
    is_own[8, 4:14] = True
    assert cells_as_clear(ju.cost_map(maps_of(roof_m), FLOWN_M), is_own).all()


@pytest.fixture(scope="module")
def walled() -> ju.MetricMaps:
    """Maps with a wall from the south border to row 14, higher than the missions fly."""
    roof_m = np.zeros((40, 41))
    roof_m[:15, 20] = 80.0
    return maps_of(roof_m)


ROUND_THE_WALL = (10, 4), (25, 4), (25, 36), (10, 36)  # 10 cells between it and the wall's end


@pytest.mark.slow
def test_a_mission_that_stays_away_from_a_wall_is_compared_with_routes_that_do(walled):
    figures = figures_of(walled, *ROUND_THE_WALL)
    row, col = np.indices(walled.grid.shape)
    away = np.hypot(np.maximum(row - 15, 0), np.maximum(abs(col - 20) - 1, 0))
    is_beside = (abs(row - 25) <= 1) & (col >= 3) & (col <= 37)
    is_beside |= (np.minimum(abs(col - 4), abs(col - 36)) <= 1) & (row >= 9) & (row <= 26)
    is_far = away >= 10
    ends = (10, 4), (10, 36)
    length_m, own_m = grid_m(is_far | is_beside, *ends), grid_m(is_beside, *ends)
    assert own_m > length_m > grid_m(walled.m("roof") == 0, *ends) + 50
    assert figures["cheapest_length_m"] == pytest.approx(length_m)
    assert figures["saved_share"] == pytest.approx(1 - length_m / own_m)
    assert figures["saved_cost"] == pytest.approx(
        figures["cost_by_cells"] - figures["cheapest_cost"]
    )


def test_what_is_flown_from_the_return_home_on_is_left_out(walled):
    out = figures_of(walled, *ROUND_THE_WALL)
    back = *ROUND_THE_WALL, ROUND_THE_WALL[0]
    kinds = "leg", "leg", "leg", "return"
    with_return = figures_of(walled, *back, kinds=kinds)
    after = figures_of(walled, *back, (20, 4), kinds=(*kinds, "leg"))
    names = "cost", "cost_by_cells", "cheapest_cost", "saved_cost", "saved_share"
    for figures in (with_return, after):
        assert [figures[name] for name in names] == [out[name] for name in names]


def test_no_figure_is_given_where_no_route_is_like_the_mission(walled):
    through = figures_of(walled, (10, 4), (10, 36))
    assert through["cost_note"] == (
        "No route to compare with: the mission passes where no route at its height may."
    )
    round_trip = figures_of(walled, (10, 4), (30, 4), (30, 18), (10, 4))
    assert round_trip["cost_note"] == (
        "No route to compare with: the mission ends where it starts, or costs nothing."
    )
    from_wall = figures_of(walled, (10, 20), (10, 36))
    assert from_wall["cost_note"].startswith("No route to compare with: ")
    for figures in (through, round_trip, from_wall):
        assert "cost" in figures
        assert not {"cheapest_cost", "saved_cost", "saved_share"} & figures.keys()


@pytest.mark.parametrize("clearances_m", [(0.0, 3.0), (10.0, 3.0), (12.0, 20.0), (0.0, 25.0)])
def test_a_planned_mission_saves_nothing_whatever_it_was_kept_clear_by(tmp_path, clearances_m):
    maps = made_maps(60, 70, (20.0, 60.0))
    limits = ju.Constraints(clearance_m=clearances_m[0], vertical_clearance_m=clearances_m[1])
    free = np.argwhere(limits.is_free_to_ground(maps, 20.0))
    ends = ends_at(maps, *free[[5, -5]])
    path = ju.plan(maps, altitude_m=20.0, constraints=limits, **ends)
    path.save(tmp_path / "x.plan")
    figures = ju.check(maps, tmp_path / "x.plan").figures
    most = 1e-9 if clearances_m == (0.0, 3.0) else 2e-3
    assert 0 <= figures["saved_share"] <= most
    assert figures["cheapest_cost"] <= path.cost * (1 + 1e-9)
