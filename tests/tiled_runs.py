"""A small job cut into many tiles, for tests in this process and in others: ``python -m tests.tiled_runs FOLDER``."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from jaxurban.cities.synthetic import demo_city
from jaxurban.io import store, stored
from jaxurban.io.city import City
from jaxurban.maps.build import compute_maps
from jaxurban.maps.params import MapParams
from jaxurban.maps.run import RunContext, make_zarr
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.lidar import Lidar
from jaxurban.progress import Report
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from jaxurban.world.sky import Sky

RESOLUTION_M = 20.0
RAGGED = (14, 18)  # neither side divides the region's
# Two epochs: a satellite at 6 degrees, whose shadows cross the whole city, at the zenith, along axes and a diagonal.
AZIMUTH_DEG = [[117.0, 0.0, 90.0, 222.0, 305.0, 45.0], [297.0, 180.0, 270.0, 31.0, 160.0, 225.0]]
ELEVATION_DEG = [[6.0, 21.0, 33.0, 90.0, 47.0, 12.0], [6.0, 8.0, 33.0, 52.0, 3.0, 12.0]]


def sky() -> Sky:
    names = tuple(f"G{s}" for s in range(6))
    azimuth_rad, elevation_rad = (np.radians(values) for values in (AZIMUTH_DEG, ELEVATION_DEG))
    times = ("2020-04-27T16:00:00Z", "2020-04-27T18:00:00Z")
    return Sky(
        times, names, azimuth_rad, elevation_rad, ("gps",) * 6, np.zeros((2, 6)), mask_deg=5.0
    )


def city(with_terrain: bool = False) -> City:
    """Return the synthetic city; with terrain, as a height raster over hills, with a hole in its data."""
    made = demo_city(1_500, 1_500)
    if not with_terrain:
        return made
    x_min, y_min, x_max, y_max = made.extent_m
    rng = np.random.default_rng(0)
    size = int((x_max - x_min) // 25), int((y_max - y_min) // 25)
    heights = np.where(rng.random(size) < 0.3, rng.uniform(5, 200, size), 0).astype(np.float32)
    heights[20:24, 30:33] = np.nan
    place = (25.0, 0.0, x_min, 0.0, -25.0, y_max), made.crs
    terrain = Raster((rng.random(size) * 40).astype(np.float32), *place)
    return City(made.crs, made.extent_m, roofs=Raster(heights, *place), terrain=terrain)


def region(of: City) -> Grid:
    """Return a region of 47 x 39 cells inside a city, with buildings all around."""
    first_col, first_row = (int(np.ceil(value / RESOLUTION_M)) for value in of.extent_m[:2])
    return Grid(of.crs, RESOLUTION_M, first_row + RAGGED[0], first_col + RAGGED[1], 47, 39)


def params(series: str = "epochs") -> MapParams:
    return MapParams(
        altitudes_m=(20.0, 60.0),
        sections={"gps": Gps(series=series), "lidar": Lidar(azimuths=36, range_m=70.0)},
    )


def task(of: City, series: str = "epochs") -> MapTask:
    return MapTask(of, region(of), sky(), params(series))


def maker(
    folder: Path, of: City, series: str = "epochs", num_workers: int = 2, client=None, **options
) -> RunContext:
    return RunContext(task(of, series), folder, "key", num_workers, client, **options)


def make(
    folder: Path, of: City, shape=RAGGED, series: str = "epochs", num_workers: int = 2, client=None
) -> Path:
    """Make the job's Zarr under ``folder``."""
    make_zarr(maker(folder, of, series, num_workers, client), Report(), shape)
    return folder / "maps.zarr" / "20m"


def check_tiles(of: MapTask, folder: Path, shape=RAGGED, **options) -> xr.Dataset:
    """Make the tiles of a task under ``folder``, with ``options`` of its parameters: they equal the untiled maps."""
    made = replace(of, guesses=of.all_guesses, params=replace(of.params, **options))
    make_zarr(RunContext(made, folder, "key", 2), Report(), shape)
    left = {path.name for path in (folder / "maps.zarr").iterdir()}
    maps = stored.zarr_path(folder, of.region.resolution_m).name
    assert left == {maps, ".zgroup", ".zmetadata"}  # nothing of the work
    found, expected = store.open_zarr(folder, None).load(), compute_maps(of).ds
    assert found.attrs.pop("run_key") == "key"
    xr.testing.assert_identical(found, expected)
    assert {name: array.dtype for name, array in found.items()} == {
        n: array.dtype for n, array in expected.items()
    }
    return found


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


if __name__ == "__main__":
    make(Path(sys.argv[1]), city())
