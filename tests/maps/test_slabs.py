"""Maps of a city in which something hangs: obstacles, tiles, finer rays, bounds, spreads, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from jaxurban.errors import GuessWarning
from jaxurban.maps.build import compute_maps
from jaxurban.maps.differentiable import soften
from jaxurban.metrics.base import UNDERSIDE
from jaxurban.metrics.custom import Layer
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.settings import TO_GROUND, Heights
from jaxurban.world.surface import Surface
from tests.guess_records import by_name
from tests.hanging_city import DECK_FLOOR_M, DECK_TOP_M, PARAMS, RESOLUTION_M, city, task

ON_DECK = (20, 50)  # a cell of the region in the middle of the deck


@pytest.fixture(scope="module")
def maps():
    return compute_maps(task(city()))


@pytest.fixture(scope="module")
def grounded():
    return compute_maps(task(city(TO_GROUND)))


@pytest.mark.slow
def test_a_slab_is_an_obstacle_from_floor_to_top(maps, grounded):
    at = {z_m: int(maps.m("obstacle", z_m)[ON_DECK]) for z_m in PARAMS.altitudes_m}
    assert at == {2.0: 0, 12.0: 1, 13.0: 1, 20.0: 0, 42.0: 0}
    assert grounded.m("obstacle", 2.0)[ON_DECK] == 1
    assert np.all(maps.ds["obstacle"].values <= grounded.ds["obstacle"].values)


def test_roofs_are_those_of_a_city_that_reaches_the_ground(maps, grounded):
    for name in ("roof", "roof_touched"):
        np.testing.assert_array_equal(maps.m(name), grounded.m(name))
    assert UNDERSIDE not in grounded.ds
    assert maps.m(UNDERSIDE)[ON_DECK] == DECK_FLOOR_M
    assert maps.m(UNDERSIDE)[0, 0] == 0


def test_under_a_deck_the_sky_overhead_is_shut_and_beside_it_more_is_seen(maps, grounded):
    time = maps.times[0]  # with a satellite at the zenith
    seen, before = maps.m("num_visible", 2.0, time=time), grounded.m("num_visible", 2.0, time=time)
    free_in_both = (maps.m("obstacle", 2.0) == 0) & (grounded.m("obstacle", 2.0) == 0)
    assert (
        np.mean(seen[free_in_both] < before[free_in_both]) < 0.02
    )  # edges of slabs are finer than those of roofs
    assert np.mean(seen[free_in_both] > before[free_in_both]) > 0.01
    open_sky = seen[0, 0]
    assert 0 < seen[ON_DECK] < open_sky


@pytest.mark.slow
def test_finer_rays_agree_with_those_of_the_cells_and_bounds_bracket_maps_with_slabs(maps):
    finer = compute_maps(
        task(city(), sections={**PARAMS.sections, "gps": Gps(bounds=True)}, oversample=3)
    )
    same = finer.ds["num_visible"].values == maps.ds["num_visible"].values
    assert same.mean() > 0.93
    assert finer.m("num_visible", 2.0)[ON_DECK] == maps.m("num_visible", 2.0)[ON_DECK]
    np.testing.assert_array_equal(finer.ds["obstacle"], maps.ds["obstacle"])
    assert not finer.ds["lidar"].equals(maps.ds["lidar"])
    lower, gps, upper = (finer.ds[name].values[:, 0] for name in ("gps_lower", "gps", "gps_upper"))
    is_free = np.broadcast_to(finer.ds["obstacle"].values[0] == 0, gps.shape)
    assert np.mean((lower <= gps)[is_free]) > 0.99
    assert np.mean((gps <= upper)[is_free]) > 0.99
    assert (lower < upper).any()


def test_a_slab_moves_as_a_whole_where_heights_are_drawn():
    ds = compute_maps(task(city(), heights=Heights(height_samples=4), altitudes_m=(2.0, 13.0))).ds
    shares = ds["obstacle_share"].values[:, *ON_DECK]
    assert shares[0] == 0
    assert 0 < shares[1] <= 1


def test_lidar_meets_slabs_at_or_below_the_altitude_and_none_above(maps):
    standing = city()
    standing = replace(
        standing, buildings=standing.buildings.take(standing.buildings.min_height_m == 0)
    )
    without = compute_maps(task(standing))
    near_deck = np.s_[24:30, 40:60]
    np.testing.assert_array_equal(
        maps.m("lidar", 2.0)[near_deck], without.m("lidar", 2.0)[near_deck]
    )
    assert np.all(maps.m("lidar", 12.0)[near_deck] > without.m("lidar", 12.0)[near_deck])


def nearest_m(surface: Surface, cell: tuple[int, int], altitude_m: float) -> float:
    """Return the 3-D distance to the nearest building, what hangs as one: by looking at every cell."""
    rows, cols = surface.window
    ground_m = (
        np.zeros(surface.grid.shape) if surface.terrain_m is None else np.asarray(surface.terrain_m)
    )
    row, col = np.indices(surface.grid.shape)
    own = cell[0] + rows.start, cell[1] + cols.start
    run_m = RESOLUTION_M * np.hypot(row - own[0], col - own[1])
    height_m, roof_m = ground_m[own] + altitude_m, np.asarray(surface.roof_m)
    rise_m = np.where(roof_m > 0, np.maximum(height_m - ground_m - roof_m, 0), np.inf)
    slabs, at = surface.slabs.over_cells(surface.grid)
    is_below = slabs.floor_m <= altitude_m
    over_m = np.where(
        is_below, height_m - ground_m[at] - slabs.top_m, ground_m[at] + slabs.floor_m - height_m
    )
    return min(np.hypot(run_m, rise_m).min(), np.hypot(run_m[at], np.maximum(over_m, 0)).min())


@pytest.mark.parametrize("with_terrain", [False, True])
def test_solid_risk_is_the_distance_to_the_nearest_roof_or_floor(with_terrain):
    surface = task(city(with_terrain=with_terrain)).surface()
    altitudes_m = [2.0, 8.0, 16.5]
    found_m = 50 * np.asarray(compute_risk(surface, altitudes_m, Risk(distance="solid")))
    for cell in [ON_DECK, (25, 50), (18, 12), (35, 40), (46, 38), (30, 12), (50, 80)]:
        for a, altitude_m in enumerate(altitudes_m):
            expected_m = min(nearest_m(surface, cell, altitude_m), 50.0)
            assert found_m[a, *cell] == pytest.approx(expected_m, abs=1e-3), (cell, altitude_m)
    if not with_terrain:
        np.testing.assert_allclose(found_m[:, *ON_DECK], [10, 4, 3], rtol=1e-5)


def test_risk_of_a_slice_under_a_deck_does_not_know_of_it(maps):
    assert maps.m("risk", 2.0)[ON_DECK] > 0.5
    assert np.isnan(maps.m("risk", 13.0)[ON_DECK])


def test_own_layers_see_what_their_altitude_meets():
    roofs = Layer(
        lambda surface, altitude_m: surface.crop(surface.roof_m), "high-is-bad", scale=(0, 100)
    )
    of = replace(task(city()), layers={"roofs": roofs})
    found = compute_maps(of)
    assert found.m("roofs", 2.0)[ON_DECK] == 0
    assert found.m("roofs", 12.0)[ON_DECK] == pytest.approx(DECK_TOP_M / 100)


def test_maps_tell_how_metrics_take_what_hangs(maps, grounded):
    assert "5 hanging parts" in by_name(maps.guesses)
    assert not any("hanging" in name for name in by_name(grounded.guesses))
    assert (
        "lidar meets those with their floor at or below"
        in by_name(task(city()).all_guesses)["5 hanging parts"]
    )


def test_soft_layers_say_that_everything_reaches_the_ground():
    with pytest.warns(GuessWarning, match="everything that hangs reaches the ground"):
        soft = soften(task(city()))
    np.testing.assert_array_equal(soft.surface.roof_m, task(city(TO_GROUND)).surface().roof_m)
    assert soft.surface.slabs is None
