"""Lidar over terrain against lidar over flat ground: CPU seconds in turn, on the same roofs.

Run as ``python -m benchmarks.lidar_terrain [--resolution 5] [--runs 7] [--shape cpu|gpu]``: a synthetic city on made
hills, and Bilbao on its own where its rasters are at hand. Over level ground the counts must be those of the flat
kernel.
"""

import argparse
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.common import clocked, in_turn, load, machine
from benchmarks.scenes import DATA, MASK_DEG, TIME
from jaxurban.kernels.lidar import flat
from jaxurban.kernels.lidar.supersampled import phase_starts
from jaxurban.kernels.lidar.terrain import count_returns_on_terrain
from jaxurban.maps.build import view_sky
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.lidar import LidarParams
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from jaxurban.world.synthetic import demo_city_for_bounds

ALTITUDES_M = (20.0, 60.0, 122.0)
BILBAO, BILBAO_CRS = (-3.0, 43.303, -2.978, 43.319), "EPSG:25830"
HILLS_M = (1.0, 5.0, 20.0)  # from the middle to the top along each axis
HILL_LENGTHS_M = (1900.0, 1400.0)  # from top to top, northward and eastward
PARAMS = LidarParams()

Grounds = dict[str, np.ndarray]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--resolution", type=float, default=5.0)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--shape", choices=("cpu", "gpu"))
    options = parser.parse_args()
    print(machine(), "load", load())
    print("| city | ground | altitude, m | flat, CPU ns a cell | terrain, CPU ns a cell | ratio |")
    print("|---|---|---|---|---|---|")
    warnings.simplefilter("ignore")
    for name, roof_m, grounds in cities(options.resolution):
        for ground, terrain_m in grounds.items():
            for altitude_m in (*ALTITUDES_M, None):
                heights_m = ALTITUDES_M if altitude_m is None else (altitude_m,)
                ns = compare(roof_m, terrain_m, heights_m, options)
                label = "all" if altitude_m is None else f"{altitude_m:g}"
                print(f"| {name} | {ground} | {label} | {ns[0]:.1f} | {ns[1]:.1f} | {ns[1] / ns[0]:.2f} |", flush=True)


def cities(resolution_m: float) -> list[tuple[str, np.ndarray, Grounds]]:
    """Return names, roofs with a halo of the lidar's range, and grounds to stand on."""
    found = [("synthetic", *synthetic(resolution_m))]
    files = [DATA / "raster" / f"bilbao_{name}.tif" for name in ("building_heights", "dem")]
    if all(file.exists() for file in files):
        city = City.from_files(files[0], bounds=BILBAO, crs=BILBAO_CRS, terrain=files[1])
        roof_m, terrain_m = rasters(city, BILBAO, resolution_m)
        assert terrain_m is not None
        found.append(("Bilbao", roof_m, {"level": np.zeros_like(roof_m), "its own": terrain_m}))
    return found


def synthetic(resolution_m: float) -> tuple[np.ndarray, Grounds]:
    """Return the synthetic city's roofs, level ground and hills of several heights."""
    bounds, crs = (-74.01, 40.708, -73.99, 40.722), "EPSG:32618"
    roof_m, _ = rasters(demo_city_for_bounds(bounds, crs), bounds, resolution_m)
    north, east = (
        np.sin(2 * np.pi * resolution_m * np.arange(size) / length_m)
        for size, length_m in zip(roof_m.shape, HILL_LENGTHS_M, strict=True)
    )
    hills = {f"hills of {2 * top_m:g} m": top_m * (north[:, None] + east) for top_m in HILLS_M}
    grounds = {"level": np.zeros_like(roof_m), **hills}
    return roof_m, {name: ground.astype(roof_m.dtype) for name, ground in grounds.items()}


def rasters(city: City, bounds: tuple, resolution_m: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Return roofs and terrain of a region with a halo of the lidar's range."""
    region = Grid.from_bounds(bounds, resolution_m, city.crs)
    sky = view_sky(region, "nominal", [TIME], mask_deg=MASK_DEG, reference=None, max_age_days=90)
    surface = MapTask(city, region, sky, MapParams(altitudes_m=ALTITUDES_M)).surface()
    halo = flat.num_steps(resolution_m, PARAMS.range_m) - 1
    terrain_m = surface.terrain_m
    return np.asarray(surface.crop_with_halo(surface.roof_m, halo)), (
        None if terrain_m is None else np.asarray(surface.crop_with_halo(terrain_m, halo))
    )


Counter = Callable[[str | None], jax.Array]


def counters(
    roof_m: np.ndarray, terrain_m: np.ndarray, altitudes_m: tuple[float, ...], resolution_m: float
) -> tuple[Counter, Counter]:
    """Return what counts lidar's returns over flat ground and over terrain, in the shape for a CPU or for a GPU."""
    steps = flat.num_steps(resolution_m, PARAMS.range_m)
    offsets = flat.ray_offsets(PARAMS.azimuths, steps)
    lowest_m = flat.lowest_heights(np.array(altitudes_m), PARAMS.elevations_rad, resolution_m, PARAMS.range_m, steps)
    thresholds_m = jnp.asarray(flat.round_up(flat.flat_thresholds(lowest_m), roof_m.dtype))
    beams_m = jnp.asarray(flat.round_up(lowest_m, roof_m.dtype))
    roofs, grounds, rays = jnp.asarray(roof_m), jnp.asarray(terrain_m), jnp.asarray(offsets)

    def over_flat(shape: Any = None) -> jax.Array:
        return flat.count_returns(roofs, thresholds_m, rays, shape=shape)

    def over_terrain(shape: Any = None) -> jax.Array:
        starts = phase_starts(offsets, 1)
        return count_returns_on_terrain(roofs[None], grounds[None], beams_m, starts, halo=steps - 1, shape=shape)

    return over_flat, over_terrain


def compare(
    roof_m: np.ndarray, terrain_m: np.ndarray, altitudes_m: tuple[float, ...], options: argparse.Namespace
) -> tuple[float, float]:
    """Return median CPU nanoseconds a cell, over flat ground and over terrain, of all altitudes together."""
    over_flat, over_terrain = (
        partial(count, options.shape) for count in counters(roof_m, terrain_m, altitudes_m, options.resolution)
    )
    if not terrain_m.any():
        np.testing.assert_array_equal(over_terrain(), over_flat())
    timing = in_turn({"flat": clocked(over_flat), "terrain": clocked(over_terrain)}, options.runs)
    halo = flat.num_steps(options.resolution, PARAMS.range_m) - 1
    num_cells = np.prod([size - 2 * halo for size in roof_m.shape])
    return tuple(1e9 * timing[side].median_cpu_s / num_cells for side in ("flat", "terrain"))


if __name__ == "__main__":
    main()
