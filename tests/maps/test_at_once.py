"""What a device makes at once is what the host makes, to the bit on a CPU: whole, cut, tiled; and when it does so."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
import xarray as xr

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io import store
from jaxurban.maps import at_once, build, run
from jaxurban.maps.build import compute_maps, view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Dop, Gps
from jaxurban.progress import Report
from jaxurban.world.grid import Grid
from tests import hanging_city, tiled_runs

GIB = 2**30


def several_systems(task: MapTask) -> MapTask:
    """Return a task whose sky has satellites of two systems, and so two receiver clocks."""
    systems = ("gps", "galileo") * 3
    names = tuple(f"{system}-{s}" for s, system in enumerate(systems))
    return replace(task, sky=replace(task.sky, systems=systems, names=names))


def with_host_s_own(task: MapTask) -> MapTask:
    """Return a task with what the host makes beside a device: bounds, a spread, own layers, on request one DOP."""
    params = replace(
        task.params,
        heights=ju.Heights(height_samples=2),
        sections={**task.params.sections, "gps": Gps(bounds=True), "gps_horizontal": Dop()},
    )
    return replace(task, params=params)


TASKS = {
    "flat": lambda: tiled_runs.task(tiled_runs.city()),
    "flat, statistics": lambda: tiled_runs.task(tiled_runs.city(), "statistics"),
    "terrain with holes": lambda: tiled_runs.task(tiled_runs.city(with_terrain=True)),
    "terrain, statistics": lambda: tiled_runs.task(
        tiled_runs.city(with_terrain=True), "statistics"
    ),
    "two systems": lambda: several_systems(tiled_runs.task(tiled_runs.city())),
    "bounds and spreads": lambda: with_host_s_own(tiled_runs.task(tiled_runs.city())),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_a_device_makes_the_bits_of_the_host(name):
    task = TASKS[name]()
    found, expected = compute_maps(task, device_bytes=math.inf).ds, compute_maps(task).ds
    xr.testing.assert_identical(found, expected)
    assert {key: values.dtype for key, values in found.items()} == {
        key: values.dtype for key, values in expected.items()
    }


@pytest.fixture
def tried(monkeypatch) -> list[tuple[int, int]]:
    """The shape of each tile that a device was to make."""
    shapes = []
    make = at_once.tile_at_once

    def spy(task, tile, *further):
        shapes.append(tile.shape)
        return make(task, tile, *further)

    monkeypatch.setattr(build, "tile_at_once", spy)
    return shapes


@pytest.mark.slow
@pytest.mark.parametrize(("series", "limit"), [("epochs", 1_000_000.0), ("statistics", 600_000.0)])
def test_what_does_not_fit_is_cut_into_tiles_of_the_same_bits(series, limit, tried, monkeypatch):
    task = tiled_runs.task(tiled_runs.city(), series)
    task = replace(task, params=replace(task.params, altitudes_m=tuple(range(5, 65, 5))))
    monkeypatch.setattr(build, "shape_of_tiles", lambda task: tiled_runs.RAGGED)
    found = compute_maps(task, device_bytes=limit).ds
    assert tried == [task.region.shape, *[tiled_runs.RAGGED] * 12]  # four by three tiles
    xr.testing.assert_identical(found, compute_maps(task).ds)
    with pytest.raises(
        InputError, match=r"a tile needs about .* of the GPU's memory and 0\.98 kiB"
    ):
        compute_maps(task, device_bytes=1000.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flat, statistics", "terrain with holes"])
def test_a_device_makes_the_tiles_of_a_run(name, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "free_device_bytes", lambda task: math.inf)
    task = TASKS[name]()
    context = tiled_runs.maker(tmp_path, task.city, task.params.gps.series)
    run.make_zarr(context, Report(), tiled_runs.RAGGED)
    found = store.open_zarr(tmp_path, None).load()
    expected = compute_maps(replace(task, guesses=context.task.guesses)).ds
    for key, values in expected.items():
        np.testing.assert_array_equal(found[key], values, err_msg=key)


def square(side: int, **options) -> MapTask:
    city = ju.demo_city(500, 500)
    first_col, first_row = (round(edge / 5) for edge in city.extent_m[:2])
    region = Grid(city.crs, 5.0, first_row, first_col, side, side)
    gps = Gps(times="2020-04-27T16:00:00Z")
    params = MapParams(sections={"gps": gps}, **options)
    return MapTask(city, region, view_sky(region, gps), params)


def test_a_gpu_makes_large_regions_without_slabs_and_finer_rays_and_the_host_all_else(monkeypatch):
    monkeypatch.setattr(at_once, "gpu_free_bytes", lambda: GIB)
    assert at_once.free_device_bytes(square(2048)) == GIB
    for of in (square(2047), square(2048, oversample=3), square(2048, engine="numba")):
        assert at_once.free_device_bytes(of) is None
    hanging = hanging_city.task(hanging_city.city())
    large = replace(hanging.region, num_rows=4096, num_cols=4096)
    assert at_once.free_device_bytes(replace(hanging, region=large)) is None
    monkeypatch.setattr(at_once, "gpu_free_bytes", lambda: None)
    assert at_once.free_device_bytes(square(2048)) is None


def test_sides_are_rounded_up_by_at_most_15_percent_of_the_cells():
    for side in (1, 63, 65, 129, 1025, 2017, 4000, 16_385):
        task = square(side)
        tile, around = at_once._grown(task, task.region)
        assert tile.num_rows * tile.num_cols <= 1.07 * side**2
        needed = task.with_margin()
        rows, cols = task.region.window_in(needed)
        beyond = needed.num_rows - rows.stop, needed.num_cols - cols.stop
        margin = max(rows.start, cols.start, *beyond)
        assert math.prod(around.shape) <= 1.15 * (side + 2 * margin) ** 2
        needed.window_in(around)  # lies within it
        assert (tile.first_col, tile.first_row + tile.num_rows) == (
            task.region.first_col,
            task.region.first_row + task.region.num_rows,
        )
    assert {at_once._rounded(side) for side in range(3970, 4033)} == {4032}


@pytest.mark.slow
def test_a_second_city_of_like_size_compiles_nothing():
    cities = [ju.demo_city(900, 900), ju.demo_city(900, 900, seed=5, centre_lonlat=(9.0, 45.0))]
    compiled = []

    def listen(event, seconds, **facts):
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(facts.get("fun_name", "?"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    for number, city in enumerate(cities):
        first_col, first_row = (round(edge / 5) + 30 for edge in city.extent_m[:2])
        region = Grid(city.crs, 5.0, first_row, first_col, 127 + number, 126 - number)
        gps = Gps(10.0 + number, times=f"2020-04-27T{6 + 12 * number:02d}:00:00Z")
        params = MapParams((20.0, 60.0 + number), sections={"gps": gps, "risk": ju.Risk(37.0)})
        compiled.clear()
        compute_maps(MapTask(city, region, view_sky(region, gps), params), device_bytes=math.inf)
        assert ("region_maps" in " ".join(compiled)) is (number == 0), compiled
