"""Do the shapes of a kernel, one for a CPU and one for a GPU, answer alike over real cities, and what does each cost?

``python -m benchmarks.kernel_shapes [--places NAME ...] [--resolution M]`` prints a row for each city whose data are at
hand: how many visibility answers (cell x satellite x altitude) differ between the sweep and doubling, flat and, on made
hills, over terrain, how many of lidar's counts (cell x altitude), and the CPU seconds of each on JAX's platform.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.lidar_terrain import PARAMS, counters
from benchmarks.scenes import ALTITUDES_M, PLACES, Scene, load_place
from jaxurban.kernels.lidar.flat import num_steps
from jaxurban.metrics.visibility import KernelShape, visibility
from jaxurban.world.surface import Surface

SHAPES: dict[str, KernelShape] = {"cpu": "sweep", "gpu": "doubling"}


def on_hills(surface: Surface) -> Surface:
    """Return a surface with hills of 30 m under its roofs."""
    row, col = np.arange(surface.grid.num_rows)[:, None], np.arange(surface.grid.num_cols)
    hills_m = 15 * np.sin(row / 90) * np.cos(col / 70)
    return replace(surface, terrain_m=hills_m.astype(np.float32))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--places", nargs="+", choices=PLACES, default=list(PLACES))
    parser.add_argument("--resolution", type=float, default=5.0, help="metres")
    asked = parser.parse_args()
    print(f"| city, {asked.resolution:g} m | ground | what | answers | differ | for a CPU, CPU s | for a GPU, CPU s |")
    print("|---|---|---|---|---|---|---|")
    for place in (PLACES[name] for name in asked.places):
        if place.is_here:
            scene = load_place(place)
            flat = scene.surface(asked.resolution)
            for ground, surface in (("flat", flat), ("hills", on_hills(flat))):
                for what, found in answers(scene, surface, ground == "hills").items():
                    print(f"| {scene.name} | {ground} | {what} | {found}", flush=True)


def answers(scene: Scene, surface: Surface, is_hilly: bool) -> dict[str, str]:
    """Return the cells of the table for each kernel."""

    def seen(shape: str) -> jax.Array:
        return visibility(surface, scene.azimuth_rad, scene.elevation_rad, ALTITUDES_M, shape=SHAPES[shape])[0]

    resolution_m = surface.grid.resolution_m
    halo = num_steps(resolution_m, PARAMS.range_m) - 1
    terrain_m = jnp.zeros_like(surface.roof_m) if surface.terrain_m is None else surface.terrain_m
    roofs, grounds = (surface.crop_with_halo(jnp.asarray(raster), halo) for raster in (surface.roof_m, terrain_m))
    count = counters(np.asarray(roofs), np.asarray(grounds), tuple(ALTITUDES_M), resolution_m)[is_hilly]
    return {
        "satellites": compare(seen, lambda a, b: np.bitwise_count(a ^ b), len(scene.azimuth_rad)),
        "lidar": compare(count, np.not_equal),
    }


def compare(work: Callable[[str], jax.Array], differ: Callable[..., np.ndarray], each: int = 1) -> str:
    """Return how many answers, how many of them differ between the shapes, and the CPU seconds of each."""
    found, seconds = {}, {}
    for shape in SHAPES:
        for _ in range(2):  # the first one compiles
            began_s = time.process_time()
            found[shape] = np.asarray(jax.block_until_ready(work(shape)))
            seconds[shape] = time.process_time() - began_s
    num = found["cpu"].size * each
    return f"{num:,} | {differ(*found.values()).sum()} | {seconds['cpu']:.2f} | {seconds['gpu']:.2f} |"


if __name__ == "__main__":
    main()
