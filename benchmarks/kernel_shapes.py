"""Do the shapes of a kernel, one for a CPU and one for a GPU, answer alike over real cities, and what does each cost?

``python -m benchmarks.kernel_shapes [--places NAME ...] [--resolution M]`` prints a row for each city whose data are at
hand: how many visibility answers (cell x satellite x altitude) differ between the sweep and doubling, flat and, on made
hills, over terrain, and the CPU seconds of each on JAX's platform.
"""

import argparse
import time
from dataclasses import replace

import jax
import numpy as np

from benchmarks.scenes import ALTITUDES_M, PLACES, load_place
from jaxurban.metrics.visibility import KernelShape, visibility
from jaxurban.world.surface import Surface

SHAPES: tuple[KernelShape, ...] = ("sweep", "doubling")


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
    print(f"| city, {asked.resolution:g} m | ground | answers | differ | sweep, CPU s | doubling, CPU s |")
    print("|---|---|---|---|---|---|")
    for place in (PLACES[name] for name in asked.places):
        if not place.is_here:
            continue
        scene = load_place(place)
        flat = scene.surface(asked.resolution)
        for ground, surface in (("flat", flat), ("hills", on_hills(flat))):
            words, seconds = {}, {}
            for shape in SHAPES:
                for _ in range(2):  # the first one compiles
                    began_s = time.process_time()
                    found = visibility(surface, scene.azimuth_rad, scene.elevation_rad, ALTITUDES_M, shape=shape)
                    words[shape] = np.asarray(jax.block_until_ready(found))
                    seconds[shape] = time.process_time() - began_s
            num = words["sweep"][0].size * len(scene.azimuth_rad)
            differ = int(np.bitwise_count(words["sweep"] ^ words["doubling"]).sum())
            print(
                f"| {scene.name} | {ground} | {num:,} | {differ} | {seconds['sweep']:.2f} | {seconds['doubling']:.2f} |"
            )


if __name__ == "__main__":
    main()
