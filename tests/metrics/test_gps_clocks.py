"""A receiver clock for each system, more satellites than a word holds, HDOP and VDOP as metrics; their gradients."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.kernels.dop import unit_vectors
from jaxurban.maps.build import compute_maps, skies_of, view_sky
from jaxurban.maps.differentiable import soften
from jaxurban.maps.recipe import TileScene
from jaxurban.maps.run import run_scenario
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.gps import DOPS, Gps, satellites_of
from jaxurban.metrics.lidar import Lidar
from tests.io.test_orbits import WALKER, walker_tle
from tests.kernels.test_dop import inverse_dops
from tests.metrics.soft.scene import check_gradient

TIMES = ("2020-04-27T03:00:00Z", "2020-04-27T09:00:00Z")
SYSTEMS = ("gps", "galileo")
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
    grid = ju.Grid(city.crs, 10.0, *(int(np.ceil(v / 10.0)) + 5 for v in city.extent_m[1::-1]), 32, 32)
    sky = view_sky(grid, ju.Gps(orbits=["nominal", file], times=TIMES, mask_deg=10.0))
    return MapTask(city, grid, sky, MapParams(altitudes_m=(Z_M,), sections=SECTIONS))


@pytest.fixture(scope="module")
def maps(task) -> ju.MetricMaps:
    return compute_maps(task)


def test_maps_of_two_systems_equal_float64_with_two_clocks(task, maps):
    scene = TileScene(task, task.surface()).at(task.metrics["gps"], (0, 0))
    words = np.where(scene.is_obstacle, 0, np.asarray(scene.words[0], np.int64))
    azimuth, elevation, systems = map(np.asarray, task.in_view(0)[:3])
    is_seen = (words.reshape(-1, 1) >> np.arange(len(azimuth))) & 1
    dops = inverse_dops(unit_vectors(azimuth, elevation), (systems == "galileo").astype(int), is_seen)
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
    shared = replace(task.params, sections={"lidar": LIDAR, "gps": Gps(clocks="one", mask_deg=10.0)})
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
        expected = np.clip((threshold - np.minimum(maps.m(dop, Z_M), threshold)) / (threshold - 1), 0, 1)
        np.testing.assert_allclose(maps.m(name, Z_M), expected, atol=1e-6)
        np.testing.assert_allclose(maps.costs(Z_M)[name], 1 - expected, atol=1e-6)


def test_clocks_keep_their_numbers_at_every_time_and_skies_of_all_times_stack(task):
    clocks = [task.in_view(t).clocks for t in range(len(TIMES))]
    assert {each.num for each in clocks} == {2}
    for t, each in enumerate(clocks):
        systems = np.asarray(task.in_view(t).systems)
        np.testing.assert_array_equal(np.asarray(SYSTEMS)[each.numbers], systems)
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
                jnp.sum(soft.layer(name, inputs["height_m"], params, cells)) for name in ("gps", "gps_horizontal")
            )

        check_gradient(jax.jit(jax.value_and_grad(total)), {"height_m": soft.height_m}, rtol=1e-5)


def test_more_than_32_satellites_of_four_systems_count_in_the_dops_of_an_open_sky_and_in_run_json(tmp_path):
    files = [tmp_path / f"{system}.tle" for system in WALKER]
    for i, file in enumerate(files):
        file.write_text(walker_tle(file.stem, 40_000 + 100 * i))
    region = {"bounds": [-74.0, 40.755, -73.995, 40.76], "resolution_m": 20, "altitudes_m": [20, 800]}
    gps = {"orbits": ["nominal", *map(str, files)], "times": TIMES[0], "mask_deg": 5.0}
    sections = {"region": region, "buildings": {"source": "synthetic"}, "gps": gps, "lidar": {"azimuths": 12}}
    made = run_scenario(ju.Scenario.from_dict(sections), tmp_path / "out")
    record, ds = made.record, made.maps[20.0].ds
    above = [s for s in record["satellites"] if s["elevation_deg"][0] >= 5.0]
    assert len(above) > 32
    azimuth, elevation = (np.radians([s[name][0] for s in above]) for name in ("azimuth_grid_deg", "elevation_deg"))
    clocks = np.array([("gps", *WALKER).index(s["system"]) for s in above])
    gdop = inverse_dops(unit_vectors(azimuth, elevation), clocks, np.ones((1, len(above))))[0, 0]
    low, high = (ds.sel(altitude=z_m) for z_m in (20, 800))
    assert (high["num_visible"] == len(above)).all()  # above all roofs
    np.testing.assert_allclose(high["gdop"], gdop, rtol=1e-4)
    assert low["num_visible"].min() < len(above)
    counts = record["satellites_above_mask"]
    assert set(counts) == {"gps", *WALKER}
    assert sum(count for (count,) in counts.values()) == len(above)
    assert {role for role in record["inputs"] if role.startswith("orbits")} == {"orbits", "orbits_2", "orbits_3"}
    assert record["settings"]["gps"]["orbits"][0] == "nominal"
