"""DOPs against NumPy, distances against SciPy, OpenCV and edt, and all maps against the sum of their peers."""

import importlib.util
import os
import sys
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy.ndimage import distance_transform_edt

from benchmarks.common import Row, Timing, clocked, in_turn
from benchmarks.scenes import ALTITUDES_M, Scene
from jaxurban.kernels.distance.nearest import capped_distance, squared_runs, window_cells
from jaxurban.kernels.dop import Dops, Geometry, dops_of_words, geometry, unit_vectors
from jaxurban.maps.build import compute_maps
from jaxurban.metrics.gps import BLOCK_CELLS, SATELLITES_STEP
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.visibility import visibility

LEAST_SATELLITES = 4  # three coordinates and the clock
BATCH = 2**16  # matrices in one call of the peer: more or fewer are slower
CAP_M, ALTITUDE_M = 50.0, 20.0  # of the distance


@jax.jit
def dops_by_blocks(satellites: Geometry, words: jax.Array) -> Dops:
    """Return the DOPs of ``[N, W, BLOCK_CELLS]`` words, block by block as the GPS maps do."""
    return lax.map(lambda block: dops_of_words(satellites, block), words)


def numpy_inverse(directions: np.ndarray, bits: np.ndarray) -> np.ndarray:
    """Return ``[5, N]`` GDOP, PDOP, HDOP, VDOP and TDOP of ``[N, S]`` visibility, at least four seen."""
    matrix = np.column_stack([directions, -np.ones(len(directions))])
    products = (matrix[:, :, None] * matrix[:, None, :]).reshape(-1, 16)
    out = np.empty((5, len(bits)))
    for first in range(0, len(bits), BATCH):
        part = slice(first, first + BATCH)
        normal = (bits[part] @ products).reshape(-1, 4, 4)
        variance = np.diagonal(np.linalg.inv(normal), axis1=1, axis2=2)
        position = variance[:, :3].sum(axis=1)
        level = variance[:, :2].sum(axis=1)
        out[:, part] = np.sqrt(
            [position + variance[:, 3], position, level, variance[:, 2], variance[:, 3]]
        )
    return out


def dilutions(scene: Scene, num_runs: int) -> list[Row]:
    surface = scene.surface(5.0)
    directions = unit_vectors(scene.azimuth_rad, scene.elevation_rad)
    shifts = np.arange(len(directions), dtype=np.uint32)[:, None]
    words = np.asarray(visibility(surface, scene.azimuth_rad, scene.elevation_rad, ALTITUDES_M))
    words = words.reshape(len(words), -1)
    words = words[:, ((words[0] >> shifts) & 1).sum(axis=0) >= LEAST_SATELLITES]
    num_cells = words.shape[1] // BLOCK_CELLS * BLOCK_CELLS
    words = words[:, :num_cells]
    bits = ((words[0] >> shifts) & 1).T.astype(float)
    blocks = jnp.asarray(words.reshape(len(words), -1, BLOCK_CELLS).swapaxes(0, 1))
    satellites = geometry(directions, multiple_of=SATELLITES_STEP)
    sides = {
        "ours": clocked(lambda: dops_by_blocks(satellites, blocks)),
        "NumPy": clocked(lambda: numpy_inverse(directions, bits)),
    }
    times = in_turn(sides, num_runs).values()
    gdop, exact = (
        np.asarray(dops_by_blocks(satellites, blocks).gdop).ravel(),
        numpy_inverse(directions, bits)[0],
    )
    note = f"differs by {np.abs(gdop / exact - 1)[exact < 20].max():.0e} of a GDOP below 20 at most"
    return [Row("DOPs", "NumPy linalg.inv", "cells", num_cells, num_cells, *times, note=note)]


def distance_to(is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    halo = window_cells(CAP_M, resolution_m)
    source_m2 = np.where(np.pad(is_obstacle, halo), np.float32(0), np.float32(np.inf))
    run_m2 = squared_runs(halo, resolution_m, np.float32)
    return np.asarray(capped_distance(source_m2, run_m2, np.float32(CAP_M)))


def scipy_edt(is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    return distance_transform_edt(~is_obstacle, resolution_m)


def opencv(is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    import cv2  # bundles FFmpeg under the LGPL: only for those who ask for the extra

    cv2.setNumThreads(os.cpu_count() or 1)
    cells = cv2.distanceTransform((~is_obstacle).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return cells * np.float32(resolution_m)


def edt_edt(is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    import edt  # LGPL: the same

    return edt.edt(~is_obstacle, (resolution_m, resolution_m), parallel=os.cpu_count())


def distances(scene: Scene, num_runs: int) -> list[Row]:
    """Return a row for each peer and resolution; notes say how far the capped distances differ."""
    peers: dict[str, tuple[Callable[[np.ndarray, float], np.ndarray], float | None]] = {
        "SciPy distance_transform_edt": (scipy_edt, 3.0)
    }
    optional = {"cv2": ("OpenCV distanceTransform", opencv), "edt": ("edt", edt_edt)}
    peers |= {
        name: (peer, None)
        for module, (name, peer) in optional.items()
        if importlib.util.find_spec(module)
    }
    rows = []
    for resolution_m in (5.0, 2.0):
        surface = scene.surface(resolution_m)
        is_obstacle = np.asarray(surface.crop(surface.roof_m)) >= ALTITUDE_M
        sides = {"ours": clocked(partial(distance_to, is_obstacle, resolution_m))}
        sides |= {
            name: clocked(partial(peer, is_obstacle, resolution_m))
            for name, (peer, _) in peers.items()
        }
        times = in_turn(sides, 3 * num_runs)
        distance_m, num = distance_to(is_obstacle, resolution_m), is_obstacle.size
        for name, (peer, bar) in peers.items():
            most_m = np.abs(distance_m - np.minimum(peer(is_obstacle, resolution_m), CAP_M)).max()
            note = f"{resolution_m:g} m cells; differs by {most_m:.1e} m at most"
            rows.append(
                Row(
                    "distance to 50 m",
                    name,
                    "cells",
                    num,
                    num,
                    times["ours"],
                    times[name],
                    bar,
                    note,
                )
            )
    return rows


def all_maps(scene: Scene, num_runs: int, parts: list[Row]) -> list[Row]:
    """Return the row of all maps from a surface in memory, against the peers' rates in the rows before, added up."""
    task, surface = scene.task(5.0), scene.surface(5.0)
    flown = surface.region.num_rows * surface.region.num_cols * len(ALTITUDES_M)
    answers = flown * len(scene.azimuth_rad)
    needed = {
        "GPS occlusion": answers,
        "DOPs": flown,
        "lidar": flown * Lidar().azimuths,
        "distance to 50 m": flown,
    }
    rates = {
        row.name: row.per_cpu_s[1] for row in reversed(parts)
    }  # of the first peer where there are several
    if missing := needed.keys() - rates.keys():
        print(
            f"maps are left out: their peers are those of {', '.join(sorted(missing))}",
            file=sys.stderr,
        )
        return []
    (ours,) = in_turn({"ours": clocked(lambda: compute_maps(task, surface))}, num_runs).values()
    cpu_s = sum(units / rates[name] for name, units in needed.items())
    note = f"{scene.name}, 5 m, {len(scene.azimuth_rad)} satellites x 3 altitudes; lidar of all altitudes as at 20 m"
    unit, peer = "cells x satellites x altitudes", "Embree + NumPy + SciPy"
    return [Row("all maps", peer, unit, answers, answers, ours, Timing([], [cpu_s]), note=note)]
