"""Rays through exact outlines against Embree, brute force over every prism, and closed forms."""

import numpy as np
import pytest
import shapely

from jaxurban.kernels.dop import unit_vectors
from jaxurban.receivers.outlines import NO_HIT, BuildingTrees
from jaxurban.receivers.rule import FARTHEST_MARGIN_M
from jaxurban.settings import SLABS, TO_GROUND
from jaxurban.world.footprints import Footprints
from jaxurban.world.known import Rays
from tests.embree_scene import CityScene

EAST = np.pi / 2
SIDE_M, NUM_PLACES = 600.0, 40


def footprints(polygons: list, height_m: list, min_height_m: float | list = 0.0) -> Footprints:
    num = len(polygons)
    floors = np.broadcast_to(np.asarray(min_height_m, float), num)
    none = np.zeros(num)
    return Footprints(
        np.array(polygons, object),
        np.array(height_m, float),
        floors,
        none.astype(np.uint8),
        none > 0,
    )


def town(seed: int) -> Footprints:
    """Return towers, courtyards, and buildings in two parts, some over others."""
    rng = np.random.default_rng(seed)
    polygons = []
    for kind in rng.integers(0, 3, 120):
        x_m, y_m = rng.uniform(0, SIDE_M, 2)
        block = shapely.affinity.rotate(
            shapely.box(x_m, y_m, x_m + rng.uniform(8, 50), y_m + rng.uniform(8, 50)),
            rng.uniform(0, 90),
        )
        if kind == 1:
            block = block.difference(block.buffer(-5.0))
        if kind == 2:
            block = block.union(shapely.affinity.translate(block, 70.0, 10.0))
        polygons.append(block)
    return footprints(polygons, rng.choice([4.0, 9.0, 20.0, 35.0, 80.0, 230.0], 120).tolist())


def some_rays(seed: int, least_deg: float = 5.0) -> tuple[Rays, np.ndarray]:
    """Return rays from a few places and heights, twelve from each."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, SIDE_M, (NUM_PLACES, 2)).repeat(12, axis=0)
    num = len(places)
    angles = rng.uniform(0, 2 * np.pi, num), np.radians(rng.uniform(least_deg, 89, num))
    return Rays(*places.T, *angles), rng.choice([2.0, 15.0, 60.0], NUM_PLACES).repeat(12)


def by_brute_force(buildings: Footprints, rays: Rays, height_m: np.ndarray) -> np.ndarray:
    """Return the clearance of every ray over every prism, ``[R, B]``, inf where it does not cross it."""
    far_m = 20_000.0
    ends = np.stack([rays.places_m(np.arange(len(height_m)), away) for away in (0.0, far_m)])
    lines = shapely.linestrings(ends.transpose(2, 0, 1))
    starts = shapely.points(rays.x_m, rays.y_m)
    entry_m = np.full((len(lines), len(buildings)), np.inf)
    for b, polygon in enumerate(buildings.polygons):
        crosses = shapely.intersects(lines, polygon)
        cut = shapely.intersection(lines[crosses], polygon)
        entry_m[crosses, b] = shapely.distance(starts[crosses], cut)
    rise = np.tan(rays.elevation_rad)[:, None]
    return height_m[:, None] + entry_m * rise - buildings.height_m


def test_rays_are_hidden_where_embree_meets_a_wall_and_by_the_roof_that_clears_least():
    buildings, (rays, height_m) = town(0), some_rays(1)
    found = BuildingTrees(buildings, TO_GROUND).clearances(rays, height_m)
    every = by_brute_force(buildings, rays, height_m)
    least = every.min(axis=1)
    expected = np.where(least < FARTHEST_MARGIN_M, least, np.inf)
    np.testing.assert_allclose(found.margin_m, expected, atol=1e-6)
    is_near = np.isfinite(expected)
    chosen = every[np.flatnonzero(is_near), found.building[is_near]]
    np.testing.assert_allclose(chosen, least[is_near], atol=1e-6)
    assert (found.building[~is_near] == NO_HIT).all()
    assert np.isnan(found.distance_m[~is_near]).all()
    outdoors = ~shapely.intersects_xy(shapely.union_all(buildings.polygons), rays.x_m, rays.y_m)
    start_m = np.column_stack([rays.x_m, rays.y_m, height_m])
    toward = unit_vectors(rays.azimuth_rad, rays.elevation_rad)
    distance_m = CityScene(buildings.polygons, buildings.height_m).distance_m(start_m, toward)
    is_hidden = found.margin_m <= 0
    agree = (np.isfinite(distance_m) == is_hidden)[outdoors]
    assert agree.mean() >= 0.995
    assert 0.2 < is_hidden[outdoors].mean() < 0.8


def test_a_wall_hides_up_to_its_roof_and_the_margin_is_the_closed_form():
    wall = footprints([shapely.box(100, -10, 110, 10)], [50.0])
    elevation_rad = np.arctan2([40.0, 47.9, 48.1, 107.0, 109.0], 100.0)
    ones = np.ones(5)
    rays = Rays(0 * ones, 0 * ones, EAST * ones, elevation_rad)
    found = BuildingTrees(wall, TO_GROUND).clearances(rays, 2 * ones)
    np.testing.assert_allclose(found.margin_m, [-8.0, -0.1, 0.1, 59.0, np.inf], atol=1e-9)
    np.testing.assert_allclose(found.distance_m[:4], 100.0)
    away = BuildingTrees(wall, TO_GROUND).clearances(Rays(*-ones[:4, None]), 2 * ones[:1])
    assert away.margin_m == np.inf


@pytest.mark.parametrize(("hanging", "hidden"), [(SLABS, [0, 1, 1, 0]), (TO_GROUND, [1, 1, 1, 0])])
def test_what_hangs_hides_between_its_floor_and_its_roof(hanging, hidden):
    """The ray at 100 m is under, in, and over a deck 20 m wide from 30 m to 40 m."""
    deck = footprints([shapely.box(100, -10, 120, 10)], [40.0], 30.0)
    elevation_rad = np.arctan2([24.0, 26.0, 37.0, 39.5], 100.0)
    ones = np.ones(4)
    rays = Rays(0 * ones, 0 * ones, EAST * ones, elevation_rad)
    found = BuildingTrees(deck, hanging).clearances(rays, 1 * ones)
    np.testing.assert_array_equal(found.margin_m <= 0, np.array(hidden, bool))
    if hanging == SLABS:  # under it, how far below the floor at its far edge
        assert found.margin_m[0] == pytest.approx(30.0 - 1.0 - 1.2 * 24.0)


def test_a_ray_through_a_slab_is_as_deep_as_the_nearer_of_its_faces():
    """Over a slab from 30 m to 40 m, 100 m wide: brute force along each ray; what stands has one face, its roof."""
    boxes = [shapely.box(100, -10, 200, 10)]
    slope = np.arange(0.05, 0.6, 0.01)
    ones = np.ones_like(slope)
    rays = Rays(0 * ones, 0 * ones, EAST * ones, np.arctan(slope))
    z_m = 1.0 + slope[:, None] * np.linspace(100, 200, 100_001)
    for floor_m, depth_m in ((30.0, np.minimum(40 - z_m, z_m - 30)), (0.0, 40 - z_m)):
        found = BuildingTrees(footprints(boxes, [40.0], floor_m), SLABS).clearances(rays, ones)
        margin_m = -depth_m.max(axis=1)
        near = margin_m < FARTHEST_MARGIN_M
        np.testing.assert_allclose(found.margin_m[near], margin_m[near], atol=1e-3)
        np.testing.assert_array_equal(found.margin_m[~near], np.inf)


def test_ground_that_rises_raises_what_stands_on_it():
    """On a plane that rises by a tenth, walls are as over flat ground for rays whose slope is a tenth more."""
    wall = footprints([shapely.box(100, -10, 110, 10)], [50.0])
    slope = np.array([0.4, 0.47, 0.49, 0.6])
    ones = np.ones(4)

    def rays(steeper: float) -> Rays:
        return Rays(0 * ones, 0 * ones, EAST * ones, np.arctan(slope + steeper))

    flat = BuildingTrees(wall, TO_GROUND).clearances(rays(0.0), 2 * ones)
    rising = BuildingTrees(wall, TO_GROUND, lambda x_m, y_m: 0.1 * x_m, 20.0)
    found = rising.clearances(rays(0.1), 2 * ones)
    np.testing.assert_allclose(found.margin_m, flat.margin_m, atol=1e-9)
