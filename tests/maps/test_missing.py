"""Missing is missing: what maps hold inside obstacles and where nothing is known, in memory and in every file."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
import xarray as xr

import jaxurban as ju
from jaxurban.maps.build import compute_maps
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.custom import Layer
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.protection import Protection
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from tests import hanging_city, tiled_runs

DOPS = "gdop pdop hdop vdop tdop"
MISSING = {  # undefined inside obstacles
    *f"gps gps_lower gps_upper {DOPS} lidar risk protection hpl vpl".split(),
    *(
        f"{name}_{what}"
        for name in ("gps", "lidar", "risk", "protection")
        for what in ("mean", "std", "p05", "p95")
    ),
    *(
        f"{name}_{what}"
        for name in ("gps", "protection")
        for what in ("availability", "median", "p05")
    ),
}
NONE = {"num_visible", "within_limits"}  # of satellites that nobody sees
HELD = {
    *(
        "obstacle",
        "obstacle_share",
        "population",
        "density",
        "noise",
        "roof",
        "roof_touched",
        "roof_guessed",
    ),
    *("underside", "terrain", "has_data"),
}
TIMES = ["2020-04-27T16:00:00Z", "2020-04-27T18:00:00Z"]


def made(name: str) -> MetricMaps:
    if name == "terrain and holes":
        return compute_maps(tiled_runs.task(tiled_runs.city(with_terrain=True)))
    how = {"resolution_m": 20.0, "altitudes_m": (20.0, 60.0)}
    if name == "slabs":
        return ju.build_maps(hanging_city.city(), **how | {"altitudes_m": (5.0, 12.5)})
    noise = Layer(
        lambda surface, altitude_m: surface.crop(surface.roof_m) + altitude_m,
        "high-is-bad",
        (0, 100),
    )
    how |= {"protection": Protection()}
    how |= {
        "times": {"layers": {"noise": noise}, "gps": Gps(times=TIMES)},
        "bounds and spreads": {
            "oversample": 3,
            "gps": Gps(bounds=True),
            "heights": ju.Heights(height_samples=2),
        },
        "series": {"gps": Gps(times=TIMES, series="statistics")},
    }[name]
    return ju.build_maps(ju.demo_city(600, 500), **how)


@pytest.fixture(
    scope="module",
    params=[
        "terrain and holes",
        "slabs",
        "times",
        "series",
        pytest.param("bounds and spreads", marks=pytest.mark.slow),
    ],
)
def maps(request) -> MetricMaps:
    return made(request.param)


@pytest.fixture(scope="module")
def folder(maps, tmp_path_factory) -> Path:
    return maps.save(tmp_path_factory.mktemp("maps"), layers=("all",))


@pytest.mark.slow
def test_every_map_is_missing_where_its_variable_says_so(maps):
    is_lost, is_obstacle = ~maps.ds["has_data"].values, maps.ds["obstacle"].values != 0
    for name, array in maps.ds.data_vars.items():
        if array.dims[-2:] != ("y", "x"):
            continue
        values, is_inside = (
            array.values,
            np.broadcast_to("altitude" in array.dims and is_obstacle, array.shape),
        )
        assert (name in MISSING) + (name in NONE) + (name in HELD) == 1, name
        if name in NONE:
            assert not values[is_inside].any(), name
        if values.dtype.kind == "f":
            np.testing.assert_array_equal(
                np.isnan(values), (is_inside & (name in MISSING)) | is_lost, str(name)
            )
    assert is_obstacle.any()


@pytest.mark.slow
def test_files_hold_what_memory_holds(maps, folder):
    opened, raw = ju.open_maps(folder), xr.open_zarr(folder / "maps.zarr/20m")
    assert [*opened.metrics] == [*maps.metrics]
    for name, array in maps.ds.data_vars.items():
        assert opened.ds[name].values.tobytes() == array.values.tobytes(), name
        if array.dims[-2:] == ("y", "x"):
            np.testing.assert_array_equal(
                raw[name].values[..., ::-1, :], array.values.astype(float), str(name)
            )


def test_geotiffs_hold_what_memory_holds_and_nothing_where_nothing_is_known(maps, folder):
    files = list((folder / "geotiff").glob("*.tif"))
    assert len(files) == sum(
        array[..., 0, 0].size for array in maps.ds.data_vars.values() if "y" in array.dims
    )
    for path in files:
        with rasterio.open(path) as file:
            tags, values = file.tags(), file.read(1, masked=True).astype(float).filled(np.nan)[::-1]
        at = {"time": tags.get("time"), "time_of_day": tags.get("time_of_day")}
        at["time"] = at["time"] if "time" in maps.ds[tags["metric"]].dims else None
        held = maps.m(
            tags["metric"], float(tags["altitude_m"]) if "altitude_m" in tags else None, **at
        ).astype(float)
        if tags["metric"] != "has_data":
            held[~maps.ds["has_data"].values] = np.nan
        np.testing.assert_array_equal(values, held, path.name)


@pytest.mark.parametrize("obstacles", ["touched", "centre"])
def test_no_free_cell_misses_a_value_at_or_between_the_altitudes(maps, obstacles):
    maps, (low_m, high_m) = maps.with_obstacles(obstacles), maps.altitudes_m
    for altitude_m in (
        low_m,
        (low_m + high_m) / 2,
        high_m,
        ju.Levels(level_step_m=(high_m - low_m) / 4),
    ):
        on = ju.cost_map(maps, altitude_m)
        assert on.is_free.any()
        assert np.isfinite(on.costs).all()
    assert not np.isnan(maps.normalised(low_m)[maps.is_free(low_m, "centre")]).any()


@pytest.mark.parametrize("make", [ju.build_maps, ju.grad.map_inputs])
def test_rasters_without_data_are_refused_in_the_region(make):
    nothing = np.full((8, 8), np.nan, np.float32)
    roofs = Raster(nothing, (10.0, 0.0, 500_000.0, 0.0, -10.0, 4_500_080.0), "EPSG:32618")
    city = ju.City("EPSG:32618", (500_000.0, 4_500_000.0, 500_080.0, 4_500_080.0), roofs=roofs)
    grid = Grid("EPSG:32618", 20.0, 225_000, 25_000, 4, 4)
    with pytest.raises(ju.InputError, match="hold no data in the region"):
        make(city, grid=grid, altitudes_m=(20.0,))
