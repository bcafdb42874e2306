"""The sections of `benchmarks.gpu`: each computes some things, times them, and keeps the answers for the check.

``python -m benchmarks.gpu_sections SECTION SIDE INPUTS ANSWERS [--small]`` runs one in a process of its own, on the
device that JAX has there. Seconds are medians of runs after a first one, arrays of JAX waited for.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.gpu_inputs import load_surface
from jaxurban.kernels.dop import Geometry
from jaxurban.kernels.shadows.sweep import TOGETHER
from jaxurban.maps.at_once import MapInputs, region_maps
from jaxurban.metrics.gps import Gps, maps_of_choices, maps_of_words, satellites_of, soft_gps
from jaxurban.metrics.lidar import Lidar, beam_heights, compute_lidar, soft_lidar
from jaxurban.metrics.risk import Risk, compute_risk, soft_risk
from jaxurban.metrics.visibility import SkyView, visible_words
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface

RUN_S, MOST_RUNS = 5.0, 5  # after the first run: until so many seconds are spent, or so many runs
ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)
SOFTNESS_M, RANGE_M, CAP_M = 2.0, 100.0, 50.0
TERRAIN_CELLS = 512  # a side of the part that is looked at over terrain

# How far two backends' answers may lie apart, as arguments of `benchmarks.gpu.difference`, and the same in words.
SAME = {"share": 1e-6}, "1e-6 of the answers"
METRES = {"absolute": 1e-5}, "1e-5 m"
DOP = {"relative": 1e-4, "share": 1e-6}, "1e-4 of a DOP, but for 1e-6 of them"
UNIT = {"absolute": 1e-4, "share": 1e-6}, "1e-4, but for 1e-6 of them"
GRADIENT = {"of_largest": 1e-3, "share": 1e-6}, "1e-3 of the largest, but for 1e-6 of them"
Tolerance = tuple[dict[str, float], str]


@dataclass
class Run:
    """One section on one side. `timed` adds a row and writes all of them, so that what was measured outlives a kill.

    Attributes:
      side: the name that the rows carry.
      inputs: folder of `gpu_inputs`.
      answers: folder of rows and answers.
    """

    section: str
    side: str
    inputs: Path
    answers: Path
    is_small: bool
    rows: list[dict] = field(default_factory=list)

    def timed(
        self,
        name: str,
        work: Callable[[], Any],
        units: float,
        unit: str,
        tolerance: Tolerance | None = None,
        *,
        every: int = 1,
    ) -> Any:
        """Time something and return its answer.

        Args:
          name: what is computed; rows of one name are compared.
          work: gives arrays of one shape each time.
          units, unit: how much is computed, of what.
          tolerance: left out, nothing is compared.
          every: of the rows of the answer one is compared in so many.
        """
        first_s, seconds = 0.0, list[float]()
        while not first_s or (len(seconds) < MOST_RUNS and sum(seconds) < RUN_S):
            begin_s = time.perf_counter()
            found = jax.block_until_ready(work())
            elapsed_s = time.perf_counter() - begin_s
            if first_s:
                seconds.append(elapsed_s)
            first_s = first_s or elapsed_s
        row = {
            "section": self.section,
            "name": name,
            "by": self.side,
            "seconds": float(np.median(seconds)),
            "first_s": first_s,
            "units": units,
            "unit": unit,
            # of all that the process did up to here
            "peak_gib": (jax.devices()[0].memory_stats() or {}).get("peak_bytes_in_use", 0) / 2**30
            or None,
        }
        if tolerance is not None:
            row |= {"tolerance": tolerance[0], "allowed": tolerance[1]}
            row["answer"] = f"{self.section}-{self.side}-{len(self.rows)}.npy"
            np.save(
                self.answers / row["answer"],
                np.asarray(found)[..., ::every, :] if every > 1 else np.asarray(found),
            )
        self.rows.append(row)
        (self.answers / f"{self.section}-{self.side}.json").write_text(json.dumps(self.rows))
        return found

    def surface(self, resolution_m: float = 5.0) -> tuple[Surface, np.ndarray, np.ndarray]:
        return load_surface(self.inputs, resolution_m)


def copy(run: Run) -> None:
    """How fast memory is, and what a turn of a loop costs."""
    values = jnp.ones(2 ** (22 if run.is_small else 28), jnp.float32)
    few = jnp.ones(1024)
    num_turns = 2000

    def loop(few: jax.Array, end: jax.Array | int) -> jax.Array:
        return jax.lax.fori_loop(0, end, lambda i, x: jnp.sin(x) + i, few)

    add, known, by_data = (
        jax.jit(lambda x: x + 1),
        jax.jit(lambda x: loop(x, num_turns)),
        jax.jit(loop),
    )
    run.timed("copy, read and written", lambda: add(values), 2 * values.nbytes, "B")
    run.timed("to the host", lambda: np.asarray(values + 0), values.nbytes, "B")
    run.timed("loop of a known number of turns", lambda: known(few), num_turns, "turns")
    run.timed("loop whose end is data", lambda: by_data(few, num_turns), num_turns, "turns")


def occlusion(run: Run) -> None:
    altitudes_m = jnp.asarray(ALTITUDES_M)
    for resolution_m in (5.0, 2.0):
        surface, *angles = run.surface(resolution_m)
        sky = SkyView.of(surface, *angles)
        run.timed(
            f"visibility, {len(angles[0])} satellites x {len(ALTITUDES_M)} altitudes, {resolution_m:g} m",
            lambda at=(surface, altitudes_m, sky): visible_words(*at),
            surface.roof_m.size * len(angles[0]) * len(ALTITUDES_M),
            "answers",
            SAME,
            every=1 if resolution_m == 5.0 else 8,
        )


def over_terrain(surface: Surface) -> Surface:
    """Return a square part of a surface on rolling ground."""
    side = min(TERRAIN_CELLS, *surface.grid.shape)
    first = [(size - side) // 2 for size in surface.grid.shape]
    part = tuple(slice(start, start + side) for start in first)
    rows, cols = jnp.meshgrid(jnp.arange(side), jnp.arange(side), indexing="ij")
    ground_m = (10 * jnp.sin(rows / 40) + 5 * jnp.cos(cols / 25)).astype(surface.roof_m.dtype)
    grid = surface.grid
    region = Grid(
        grid.crs,
        grid.resolution_m,
        grid.first_row + first[0],
        grid.first_col + first[1],
        side,
        side,
    )
    return replace(
        surface, roof_m=surface.roof_m[part], terrain_m=ground_m, grid=region, region=region
    )


def lidar(run: Run) -> None:
    params = Lidar(range_m=RANGE_M)
    surface = run.surface()[0]
    scenes = {"5 m": surface, "2 m": run.surface(2.0)[0], "terrain, 5 m": over_terrain(surface)}
    for name, scene in scenes.items():
        run.timed(
            f"lidar, {name}",
            # In whole returns: their share is rounded.
            lambda scene=scene: jnp.rint(
                params.azimuths * compute_lidar(scene, ALTITUDES_M[:1], params)
            ),
            scene.roof_m.size * params.azimuths,
            "scan positions",
            SAME,
            every=8 if name == "2 m" else 1,
        )


def distance(run: Run) -> None:
    scenes = {
        "5 m": (run.surface()[0], Risk(CAP_M)),
        "2 m": (run.surface(2.0)[0], Risk(CAP_M)),
        "terrain, 5 m": (over_terrain(run.surface()[0]), Risk(CAP_M, "solid")),
    }
    for name, (scene, params) in scenes.items():
        run.timed(
            f"distance, {name}",
            lambda at=(scene, ALTITUDES_M[:1], params): CAP_M * compute_risk(*at)[0],
            scene.roof_m.size,
            "cells",
            METRES,
            every=8 if name == "2 m" else 1,
        )


def dops(run: Run) -> None:
    """GPS maps of random words: on a CPU of the distinct ones, as the host makes them, on a GPU of every cell."""

    def gdop(words: jax.Array, satellites: Geometry) -> jax.Array | np.ndarray:
        if jax.default_backend() != "cpu":
            return maps_of_words(words, satellites, 20.0).gdop
        maps, number = maps_of_choices(np.asarray(words), np.zeros((), bool), satellites, 20.0)
        return maps.gdop[number]

    rng = np.random.default_rng(0)
    side = 256 if run.is_small else 3000
    for num in (9, 31):
        azimuth_rad, elevation_rad = rng.uniform(0, 2 * np.pi, num), rng.uniform(0.1, 1.5, num)
        words = jnp.asarray(rng.integers(0, 2**num, (1, 1, side, side)), jnp.uint32)
        satellites = satellites_of(InView(azimuth_rad, elevation_rad, ()))
        run.timed(
            f"GPS maps of {num} satellites",
            lambda at=(words, satellites): gdop(*at),
            side**2,
            "cells",
            DOP,
            every=8,
        )


def pipeline(run: Run) -> None:
    """All maps of a region at one time by one program: GPS, lidar and risk, left on the device and on the host."""
    for resolution_m in (5.0, 2.0):
        surface, *angles = run.surface(resolution_m)
        altitudes_m = jnp.asarray(ALTITUDES_M)
        ready = {"lidar": jnp.asarray(beam_heights(ALTITUDES_M, Lidar(), surface))}
        fixed = ("lidar", Lidar()), ("risk", Risk())
        inputs = MapInputs(surface, altitudes_m, ready, {"gps": Gps()}, fixed)
        sky = SkyView.of(surface, *angles, TOGETHER)
        skies = jax.tree.map(lambda values: jnp.asarray(values)[None], sky)

        def maps(at: tuple = (inputs, skies)) -> dict[str, jax.Array]:
            return region_maps(*at, keeps_times=True)

        units = surface.roof_m.size * len(ALTITUDES_M)
        name = f"all maps, {resolution_m:g} m"
        run.timed(f"{name}, left on the device", maps, units, "cells x altitudes")
        run.timed(
            f"{name}, on the host", lambda: jax.device_get(maps()), units, "cells x altitudes"
        )

        def metrics() -> jax.Array:
            made = maps()
            return jnp.nan_to_num(jnp.stack([made["gps"][0], made["lidar"], made["risk"]]))

        run.timed(
            f"the metrics, {resolution_m:g} m", metrics, units, "cells x altitudes", UNIT, every=8
        )


def gradients(run: Run) -> None:
    """Gradients by all roofs of the mean metric along a path of 512 cells."""
    surface, azimuth_rad, elevation_rad = run.surface()
    view = SkyView.of(surface, azimuth_rad, elevation_rad)
    side = min(surface.grid.shape)
    cells = jnp.asarray(
        np.random.default_rng(0).integers(side // 4, 3 * side // 4, (512, 2)), jnp.int32
    )
    soft = {
        "GPS": lambda scene: soft_gps(scene, ALTITUDES_M[0], 20.0, SOFTNESS_M, view, cells=cells),
        "lidar": lambda scene: soft_lidar(scene, ALTITUDES_M[0], Lidar(), SOFTNESS_M, cells=cells),
        "risk": lambda scene: soft_risk(scene, ALTITUDES_M[0], Risk(), SOFTNESS_M, cells=cells),
    }
    for name, metric in soft.items():
        slope = jax.jit(
            jax.grad(lambda roof_m, metric=metric: metric(replace(surface, roof_m=roof_m)).mean())
        )
        run.timed(
            f"gradient of {name} along a path",
            lambda slope=slope: slope(surface.roof_m),
            1,
            "gradients",
            GRADIENT,
        )


SECTIONS = {
    section.__name__: section
    for section in (copy, occlusion, lidar, distance, dops, pipeline, gradients)
}


def main() -> None:
    """Run the section that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("section", choices=SECTIONS)
    parser.add_argument("side")
    parser.add_argument("inputs", type=Path)
    parser.add_argument("answers", type=Path)
    parser.add_argument("--small", action="store_true")
    options = parser.parse_args()
    SECTIONS[options.section](
        Run(options.section, options.side, options.inputs, options.answers.resolve(), options.small)
    )


if __name__ == "__main__":
    main()
