"""Exact distance, capped at 50 m, against SciPy, and against OpenCV and `edt` where they are installed."""

import importlib.util
import os
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.ndimage import distance_transform_edt

from benchmarks.common import Row, clocked, in_turn, row
from benchmarks.scenes import Scene
from jaxurban.kernels.distance.nearest_cpu import distance_on_host

CAP_M, ALTITUDE_M = 50.0, 20.0


def ours(is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    source_m2 = np.where(is_obstacle, np.float32(0), np.float32(np.inf))
    return distance_on_host(source_m2, 0, resolution_m=resolution_m, cap_m=CAP_M)


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


def measure(scene: Scene, num_runs: int) -> list[Row]:
    """Return a row for each peer and resolution; notes say how far the capped distances differ."""
    peers: dict[str, tuple[Callable[[np.ndarray, float], np.ndarray], float | None]] = {
        "SciPy distance_transform_edt": (scipy_edt, 3.0)
    }
    optional = {"cv2": ("OpenCV distanceTransform", opencv), "edt": ("edt", edt_edt)}
    peers |= {name: (peer, None) for module, (name, peer) in optional.items() if importlib.util.find_spec(module)}
    rows = []
    for resolution_m in (5.0, 2.0):
        surface = scene.surface(resolution_m)
        is_obstacle = np.asarray(surface.crop(surface.roof_m)) >= ALTITUDE_M
        sides = {"ours": clocked(partial(ours, is_obstacle, resolution_m))}
        sides |= {name: clocked(partial(peer, is_obstacle, resolution_m)) for name, (peer, _) in peers.items()}
        times = in_turn(sides, 3 * num_runs)
        distance_m = ours(is_obstacle, resolution_m)
        for name, (peer, bar) in peers.items():
            most_m = np.abs(distance_m - np.minimum(peer(is_obstacle, resolution_m), CAP_M)).max()
            note = f"{resolution_m:g} m cells; differs by {most_m:.1e} m at most"
            units = is_obstacle.size
            rows.append(row("distance to 50 m", name, "cells", (units, times["ours"]), (units, times[name]), bar, note))
    return rows
