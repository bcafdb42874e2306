"""Embree as the peer: one process a core, each with its own scene; only the ray queries are timed.

Each process makes its scene and its rays first. The rays are `occluded` queries (any hit ends a ray) in batches
of at least 1e5, float32 in local coordinates, neighbours in space next to each other.
"""

import multiprocessing
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.lidar import Lidar
from jaxurban.world.footprints import Footprints
from tests.embree_scene import roof_triangles, wall_triangles

BATCH_RAYS = 200_000


class Answers(NamedTuple):
    """One process's share: seconds inside Embree, and what was found."""

    wall_s: float
    cpu_s: float
    found: np.ndarray


class Caster:
    """A scene of one process, and a clock that runs during its queries only."""

    def __init__(self, triangles: np.ndarray):
        self.scene = EmbreeScene()
        self.mesh = TriangleMesh(self.scene, triangles)
        self.wall_s = self.cpu_s = 0.0

    def is_blocked(
        self, start_m: np.ndarray, direction: np.ndarray, length_m: np.ndarray
    ) -> np.ndarray:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        hit = self.scene.run(start_m, direction, length_m, query="OCCLUDED")
        self.wall_s += time.perf_counter() - wall_s
        self.cpu_s += time.process_time() - cpu_s
        return hit == 0  # -1 where nothing is hit


def see_satellites(
    caster: Caster, xy_m: np.ndarray, altitudes_m: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """Return ``[A, S, N]`` bool: which satellites are seen from points."""
    seen = np.empty((len(altitudes_m), len(directions), len(xy_m)), bool)
    for k, altitude_m in enumerate(altitudes_m):
        start_m = np.column_stack([xy_m, np.full(len(xy_m), altitude_m)]).astype(np.float32)
        for s, direction in enumerate(directions.astype(np.float32)):
            for first in range(0, len(xy_m), BATCH_RAYS):
                part = slice(first, first + BATCH_RAYS)
                rays = np.ascontiguousarray(np.broadcast_to(direction, start_m[part].shape))
                seen[k, s, part] = ~caster.is_blocked(
                    start_m[part], rays, np.full(len(rays), np.inf, np.float32)
                )
    return seen


def beams_of(params: Lidar, altitude_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[B, K, 3]`` directions, beams nearest the horizon first, and ``[B]`` lengths: to the ground at most."""
    elevation_rad = np.array(sorted(params.elevations_rad, key=abs))
    azimuth_rad = 2 * np.pi * np.arange(params.azimuths) / params.azimuths
    down = np.maximum(-np.sin(elevation_rad), 1e-12)
    directions = np.stack(
        [unit_vectors(azimuth_rad, np.full(len(azimuth_rad), e)) for e in elevation_rad]
    )
    return directions.astype(np.float32), np.minimum(params.range_m, altitude_m / down).astype(
        np.float32
    )


def scan_until_first_return(
    caster: Caster, xy_m: np.ndarray, altitude_m: float, params: Lidar
) -> np.ndarray:
    """Return ``[N]`` share of scan positions that return; the beams of those that have are left out."""
    directions, length_m = beams_of(params, altitude_m)
    share = np.empty(len(xy_m))
    step = -(-BATCH_RAYS // params.azimuths)
    for first in range(0, len(xy_m), step):
        part = xy_m[first : first + step]
        start_m = np.column_stack([part, np.full(len(part), altitude_m)]).astype(np.float32)
        returned = np.zeros((len(part), params.azimuths), bool)
        for direction, length in zip(directions, length_m, strict=True):
            point, k = np.nonzero(~returned)
            lengths = np.full(len(point), length, np.float32)
            returned[point, k] = caster.is_blocked(start_m[point], direction[k], lengths)
        share[first : first + step] = returned.mean(axis=1)
    return share


def _serve(pipe: Connection, triangles: np.ndarray) -> None:
    """Answer jobs ``(function, arguments)`` until the pipe closes."""
    caster = Caster(triangles)
    pipe.send(None)
    while (job := pipe.recv()) is not None:
        function, arguments = job
        caster.wall_s = caster.cpu_s = 0.0
        found = function(caster, *arguments)
        pipe.send(Answers(caster.wall_s, caster.cpu_s, found))


class EmbreePool:
    """Embree on every core; each of n processes takes every n-th point, so that all have as much to do."""

    def __init__(self, buildings: Footprints):
        polygons, height_m = buildings.polygons, buildings.height_m
        triangles = np.concatenate(
            [wall_triangles(polygons, height_m), roof_triangles(polygons, height_m)]
        )
        self.origin_m = np.round(triangles.reshape(-1, 3).mean(axis=0))[:2]
        triangles = (triangles - np.append(self.origin_m, 0.0)).astype(np.float32)
        context = multiprocessing.get_context("spawn")
        self.pipes, self.processes = [], []
        for _ in range(os.cpu_count() or 1):
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs, triangles), daemon=True)
            process.start()
            self.pipes.append(ours)
            self.processes.append(process)
        for pipe in self.pipes:
            pipe.recv()

    def __enter__(self) -> "EmbreePool":
        return self

    def __exit__(self, *_: object) -> None:
        for pipe, process in zip(self.pipes, self.processes, strict=True):
            pipe.send(None)
            process.join()

    def run(
        self, function: Callable[..., np.ndarray], xy_m: np.ndarray, *arguments: object
    ) -> Answers:
        """Return the slowest process's seconds, the CPU seconds of all, and what was found."""
        local_m = xy_m - self.origin_m
        num = len(self.pipes)
        for k, pipe in enumerate(self.pipes):
            pipe.send((function, (local_m[k::num], *arguments)))
        answers: list[Answers] = [pipe.recv() for pipe in self.pipes]
        found = np.empty((*answers[0].found.shape[:-1], len(xy_m)), answers[0].found.dtype)
        for k, answer in enumerate(answers):
            found[..., k::num] = answer.found
        return Answers(
            max(answer.wall_s for answer in answers), sum(answer.cpu_s for answer in answers), found
        )
