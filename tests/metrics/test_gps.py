"""The GPS metric: equations, subsets, supersampling; several systems' clocks; HDOP and VDOP as metrics; gradients."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.kernels.dop import Clocks, unit_vectors
from jaxurban.kernels.shadows.sweep import digital_line, shadow_height
from jaxurban.maps.at_once import skies_of
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.differentiable import soften
from jaxurban.maps.params import MapParams
from jaxurban.maps.run import run_scenario
from jaxurban.maps.task import MapTask
from jaxurban.maps.tile_scene import TileScene
from jaxurban.metrics import gps
from jaxurban.metrics.gps import DOPS, Gps, Rating, gps_metric, maps_of_words, rating, satellites_of
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.visibility import bounding_visibility, shadow_reach_m, visibility
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface
from tests.io.test_orbits import WALKER, walker_tle
from tests.kernels.test_dop import inverse_dops
from tests.metrics.soft.scene import check_gradient
from tests.metrics.whole_maps import compute_gps, gps_maps, surface_on

# Axes, diagonals and directions a hair beside them, high and low.
AZIMUTH_DEG = [
    0.0,
    90.0,
    180.0,
    270.0,
    45.0,
    135.0,
    225.0,
    315.0,
    44.999,
    89.999,
    200.0,
    20.0,
    155.0,
]
ELEVATION_DEG = [35.0, 50.0, 15.0, 60.0, 30.0, 40.0, 70.0, 25.0, 55.0, 20.0, 80.0, 10.0, 45.0]
RNG = np.random.default_rng(0)
GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 40, 50)  # far from the CRS's origin

ROOF_M = np.where(RNG.random(GRID.shape) < 0.3, RNG.uniform(5, 60, GRID.shape), 0)


def test_m_falls_from_1_at_gdop_1_to_0_at_the_threshold():
    gdop = jnp.array([0.5, 1.0, 10.5, 20.0, 40.0, jnp.inf])
    np.testing.assert_allclose(gps_metric(gdop, 20.0), [1, 1, 0.5, 0, 0, 0], rtol=1e-6)
    assert np.all(np.isfinite(jax.vmap(jax.grad(gps_metric), (0, None))(gdop, 20.0)))


def test_ratings_follow_the_papers_table():
    gdop = np.array([[0.9, 1.0, 1.1, 4.0], [4.1, 6.0, 7.9, 8.1], [20.0, 20.1, 300.0, np.inf]])
    names = "IDEAL IDEAL EXCELLENT EXCELLENT GOOD GOOD MODERATE FAIR FAIR POOR POOR POOR"
    assert " ".join(Rating(each).name for each in rating(gdop).flat) == names


def test_shadow_reach_is_the_length_of_the_longest_shadow_by_side():
    west, south, east, north = shadow_reach_m(
        np.radians([90.0, 225.0]), np.radians([45.0, 45.0]), 120.0, 20.0, 5.0
    )
    np.testing.assert_allclose(
        [west, south, east], [100 / math.sqrt(2) + 5, 100 / math.sqrt(2) + 5, 105]
    )
    assert north < 5.1  # cos 90 degrees is not quite 0
    assert shadow_reach_m(np.radians([90.0]), np.radians([45.0]), 20.0, 20.0, 5.0) == (0, 0, 0, 0)
    assert shadow_reach_m(np.array([1.0]), np.array([0.0]), 30.0, 20.0, 5.0) == (
        0,
        0,
        math.inf,
        math.inf,
    )


@pytest.mark.slow
def test_visibility_keeps_float64_where_only_the_caller_enabled_it():
    with jax.enable_x64(True):
        roof_m = jnp.asarray(
            np.where(ROOF_M > 50, 20 + 1e-9, 0.0)
        )  # one nanometre above the altitude hides
        surface = Surface(roof_m, None, None, None, GRID, GRID)
        for azimuth_rad in (0.0, np.pi / 2):
            words = visibility(surface, [azimuth_rad], [0.0], [20.0])
            line = digital_line(azimuth_rad, 0.0, 5.0, GRID.first_row, GRID.first_col, GRID.shape)
            expected = np.asarray(shadow_height(surface.roof_m, line)) <= 20.0
            assert 0 < expected.sum() < expected.size
            np.testing.assert_array_equal(np.asarray(words)[0, 0] == 1, expected)


def test_without_satellites_m_is_0():
    maps = compute_gps(surface_on(ROOF_M, GRID, GRID), [], [], [5.0, 60.0])
    assert maps.m.shape == (2, *GRID.shape)
    assert not np.any(maps.m)
    assert not np.any(maps.num_visible)


@pytest.mark.slow
@pytest.mark.parametrize(("num", "clocks"), [(40, None), (20, Clocks(np.arange(20) % 2, 2))])
def test_maps_by_way_of_the_subsets_that_are_seen_are_those_of_every_cell_to_the_bit(
    num, clocks, monkeypatch
):
    rng = np.random.default_rng(num)
    in_view = InView(rng.uniform(0, 2 * np.pi, num), rng.uniform(0.1, 1.5, num), (), clocks=clocks)
    bits = rng.random((40, num)) < 0.5
    subsets = np.stack(
        [(bits[:, w : w + 32] << np.arange(bits[:, w : w + 32].shape[1])).sum(1) for w in (0, 32)]
    )
    words = jnp.asarray(subsets[: -(-num // 32), rng.integers(0, 40, (150, 130))], jnp.uint32)
    is_obstacle = jnp.asarray(rng.random((150, 130)) < 0.2)
    expected = maps_of_words(
        jnp.where(is_obstacle, 0, words), satellites_of(in_view), Gps().gdop_threshold
    )

    def of_a_block(block, *arguments):
        assert block.shape[1:] == (gps.BLOCK_CELLS,)
        return maps_of_words(block, *arguments)

    monkeypatch.setattr(gps, "maps_of_words", of_a_block)
    found = gps_maps(words, is_obstacle, in_view)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype
    assert len(np.unique(found.gdop)) > 20


OUTER = Grid("EPSG:32618", 6.0, 750_000, 96_000, 40, 44)
REGION = Grid("EPSG:32618", 6.0, 750_009, 96_007, 20, 24)
ANGLES = np.radians([AZIMUTH_DEG, ELEVATION_DEG])


def fine_city(oversample: int, terrain: bool = False) -> Surface:
    """Return boxes of subcells, the same for every oversample."""
    grid, rng = OUTER.refined(oversample), np.random.default_rng(3)
    row, col = np.indices(grid.shape)
    coarse = rng.uniform(0, 40, (20, 20)) * (rng.random((20, 20)) < 0.3)
    roof_m = coarse[row * 20 // grid.num_rows, col * 20 // grid.num_cols]
    ground_m = 6 * np.sin(row / grid.num_rows * 9) + 5 * np.cos(col / grid.num_cols * 7)
    return surface_on(roof_m, grid, REGION.refined(oversample), ground_m if terrain else None)


@pytest.mark.slow
@pytest.mark.parametrize("terrain", [False, True])
@pytest.mark.parametrize("oversample", [3, 2])
def test_satellites_at_centres_are_those_of_the_full_fine_sweep(oversample, terrain):
    supersampled = fine_city(oversample, terrain=terrain)
    centre = slice(oversample // 2, None, oversample)
    found = visibility(supersampled, *ANGLES, [10.0, 25.0], every=oversample)
    expected = np.asarray(visibility(supersampled, *ANGLES, [10.0, 25.0]))[..., centre, centre]
    assert len(np.unique(expected)) > 10
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("oversample", [1, 3])
def test_who_is_seen_past_roofs_that_hide_most_is_seen_past_those_that_hide_least(oversample):
    view = fine_city(oversample), *ANGLES, [10.0, 25.0], oversample
    most, least = (
        bounding_visibility(*view, hides_most=hides_most) for hides_most in (True, False)
    )
    assert np.all(most & ~least == 0)
    assert np.any(most != least)


TIMES = ("2020-04-27T03:00:00Z", "2020-04-27T09:00:00Z")
Z_M = 5.0
LIDAR = Lidar(beams=2, azimuths=8, range_m=40.0)
NEW = {"gps_horizontal": ju.metrics.Dop(4.0), "gps_vertical": ju.metrics.Dop()}
SECTIONS = {"gps": Gps(mask_deg=10.0), "lidar": LIDAR, **NEW}


@pytest.fixture(scope="module")
def task(tmp_path_factory) -> MapTask:
    """A synthetic district under nominal GPS and a synthetic Galileo, with all that can be asked for."""
    file = tmp_path_factory.mktemp("orbits") / "galileo.tle"
    file.write_text(walker_tle("galileo", 40_000))
    city = ju.demo_city(width_m=500, height_m=500)
    grid = ju.Grid(
        city.crs, 10.0, *(int(np.ceil(v / 10.0)) + 5 for v in city.extent_m[1::-1]), 32, 32
    )
    sky = view_sky(grid, ju.Gps(orbits=["nominal", file], times=TIMES, mask_deg=10.0))
    return MapTask(city, grid, sky, MapParams(altitudes_m=(Z_M,), sections=SECTIONS))


@pytest.fixture(scope="module")
def maps(task) -> ju.MetricMaps:
    return compute_maps(task)


@pytest.mark.slow
def test_maps_of_two_systems_equal_float64_with_two_clocks(task, maps):
    scene = TileScene(task, task.surface()).at(task.metrics["gps"], (0, 0))
    words = np.where(scene.is_obstacle, 0, np.asarray(scene.words[0], np.int64))
    azimuth, elevation, systems = map(np.asarray, task.in_view(0)[:3])
    is_seen = (words.reshape(-1, 1) >> np.arange(len(azimuth))) & 1
    dops = inverse_dops(
        unit_vectors(azimuth, elevation), (systems == "galileo").astype(int), is_seen
    )
    exact = dops.reshape(5, *words.shape)
    is_useful = exact[0] < 20
    assert is_useful.sum() > 500
    is_free = ~np.asarray(scene.is_obstacle)
    assert np.isinf(exact[0][is_free]).any()
    for name, expected in zip(DOPS, exact, strict=True):
        found = maps.m(name, Z_M)
        np.testing.assert_allclose(found[is_useful], expected[is_useful], rtol=1e-5)
        np.testing.assert_array_equal(np.isinf(found), np.isinf(expected) & is_free)


def test_one_clock_for_all_gives_smaller_dops_and_as_before_for_one_system(task, maps):
    shared = replace(
        task.params, sections={"lidar": LIDAR, "gps": Gps(clocks="one", mask_deg=10.0)}
    )
    one = compute_maps(replace(task, params=shared))
    less, more = (each.m("pdop", Z_M)[maps.is_free(Z_M, "centre")] for each in (one, maps))
    assert np.all(less <= more * (1 + 1e-5))
    assert np.median(more[np.isfinite(more)] / less[np.isfinite(more)]) > 1.02
    assert maps.ds.attrs["gps_clocks"] == "system"
    assert one.ds.attrs["gps_clocks"] == "one"
    alone = replace(task, sky=view_sky(task.region, ju.Gps(times=TIMES, mask_deg=10.0)))
    assert alone.in_view(0).clocks is None
    both = alone, replace(alone, params=shared)
    tables = (satellites_of(each.in_view(0)) for each in both)
    for found, other in zip(*map(jax.tree.leaves, tables), strict=True):
        np.testing.assert_array_equal(found, other)


def test_hdop_and_vdop_are_cost_layers(maps):
    for name, dop, threshold in (("gps_horizontal", "hdop", 4.0), ("gps_vertical", "vdop", 20.0)):
        expected = np.clip(
            (threshold - np.minimum(maps.m(dop, Z_M), threshold)) / (threshold - 1), 0, 1
        )
        np.testing.assert_allclose(maps.m(name, Z_M), expected, atol=1e-6)
        np.testing.assert_allclose(maps.costs(Z_M)[name], 1 - expected, atol=1e-6)


def test_clocks_keep_their_numbers_at_every_time_and_skies_of_all_times_stack(task):
    clocks = [task.in_view(t).clocks for t in range(len(TIMES))]
    assert {each.num for each in clocks} == {2}
    for t, each in enumerate(clocks):
        systems = np.asarray(task.in_view(t).systems)
        np.testing.assert_array_equal(np.array(["gps", "galileo"])[each.numbers], systems)
    views = skies_of(task, task.surface())
    assert views.satellites.members.shape[:2] == (len(TIMES), 2)


@pytest.mark.slow
def test_soft_maps_follow_the_clocks_and_their_gradients_equal_finite_differences(task):
    cells = jnp.asarray(np.argwhere(np.ones((6, 5), bool)) * 3)
    with jax.enable_x64(True):
        soft = soften(task, dtype=np.float64)
        params = ju.grad.SoftParams(Z_M, 3.0, sections=SECTIONS)
        assert {*NEW} <= set(soft.names)

        def total(inputs):
            return sum(
                jnp.sum(soft.layer(name, inputs["height_m"], params, cells))
                for name in ("gps", "gps_horizontal")
            )

        check_gradient(jax.jit(jax.value_and_grad(total)), {"height_m": soft.height_m}, rtol=1e-5)


@pytest.mark.slow
def test_more_than_32_satellites_of_four_systems_count_in_the_dops_of_an_open_sky_and_in_run_json(
    tmp_path,
):
    files = [tmp_path / f"{system}.tle" for system in WALKER]
    for i, file in enumerate(files):
        file.write_text(walker_tle(file.stem, 40_000 + 100 * i))
    region = {
        "bounds": [-74.0, 40.755, -73.995, 40.76],
        "resolution_m": 20,
        "altitudes_m": [20, 800],
    }
    gps = {"orbits": ["nominal", *map(str, files)], "times": TIMES[0], "mask_deg": 5.0}
    sections = {
        "region": region,
        "buildings": {"source": "synthetic"},
        "gps": gps,
        "lidar": {"azimuths": 12},
    }
    made = run_scenario(ju.Scenario.from_dict(sections), tmp_path / "out")
    record, ds = made.record, made.maps[20.0].ds
    above = view_sky(made.maps[20.0].grid, Gps(**gps)).in_view(0)
    num_above = len(above.systems)
    assert num_above > 32
    clocks = np.array([("gps", *WALKER).index(system) for system in above.systems])
    gdop = inverse_dops(unit_vectors(*above.angles), clocks, np.ones((1, num_above)))[0, 0]
    low, high = (ds.sel(altitude=z_m) for z_m in (20, 800))
    assert (high["num_visible"] == num_above).all()  # above all roofs
    np.testing.assert_allclose(high["gdop"], gdop, rtol=1e-4)
    assert low["num_visible"].min() < num_above
    assert set(above.systems) == {"gps", *WALKER}
    assert {role for role in record["inputs"] if role.startswith("orbits")} == {
        "orbits",
        "orbits_2",
        "orbits_3",
    }
    assert record["settings"]["gps"]["orbits"][0] == "nominal"


@pytest.mark.parametrize("reference", [(1.0,), (1.0, 2.0, 3.0), (200.0, 0.0)])
def test_a_reference_that_is_no_longitude_and_latitude_is_refused(reference):
    with pytest.raises(ju.InputError, match="a longitude and a latitude in degrees"):
        Gps(reference=reference)
