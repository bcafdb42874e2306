"""The synthetic city of `benchmarks.gpu` as compressed arrays: surfaces and a sky, a few megabytes."""

from pathlib import Path

import numpy as np

from jaxurban.metrics.gps import Gps
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface

RESOLUTIONS_M = (5.0, 2.0)
SIZE_M, SMALL_SIZE_M = (10_000.0, 20_000.0), (1_000.0, 1_000.0)  # width, height
CM = 100.0  # roofs are kept in whole centimetres


def make_inputs(folder: Path, is_small: bool) -> None:
    """Write the arrays of the city that are not in the folder yet."""
    if (folder / f"surface_{RESOLUTIONS_M[-1]:g}m.npz").exists():
        return
    import jaxurban as ju  # the readers, which a machine that gets these files needs not have
    from jaxurban.io.rasterise import build_surface
    from jaxurban.maps.build import view_sky

    folder.mkdir(parents=True, exist_ok=True)
    city = ju.demo_city(*(SMALL_SIZE_M if is_small else SIZE_M))
    for resolution_m in RESOLUTIONS_M:
        x_min, y_min, x_max, y_max = (round(edge / resolution_m) for edge in city.extent_m)
        region = Grid(city.crs, resolution_m, y_min, x_min, y_max - y_min, x_max - x_min)
        surface = build_surface(city, region, region)
        sky = view_sky(region, Gps())
        np.savez_compressed(
            folder / f"surface_{resolution_m:g}m.npz",
            roof_cm=np.round(np.asarray(surface.roof_m) * CM).astype(np.uint16),
            azimuth_rad=sky.azimuth_rad[0],
            elevation_rad=sky.elevation_rad[0],
            grid=np.array([region.first_row, region.first_col, *region.shape]),
            crs=city.crs,
        )


def load_surface(folder: Path, resolution_m: float) -> tuple[Surface, np.ndarray, np.ndarray]:
    """Return the city on flat ground, with nothing around it, and azimuths and elevations of the satellites."""
    import jax.numpy as jnp

    kept = np.load(folder / f"surface_{resolution_m:g}m.npz")
    grid = Grid(str(kept["crs"]), resolution_m, *(int(number) for number in kept["grid"]))
    roof_m = jnp.asarray(kept["roof_cm"].astype(np.float32) / np.float32(CM))
    return Surface(roof_m, None, None, None, grid, grid), kept["azimuth_rad"], kept["elevation_rad"]
