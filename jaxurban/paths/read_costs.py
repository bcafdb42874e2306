"""What maps hold at the levels of paths, at one time: where a path may fly, and what each metric costs there."""

import math
from functools import cache, partial
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.maps.levels import values_at
from jaxurban.maps.memory import free_bytes, told_bytes
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.constraints import Constraints

NODE_BYTES = 64  # of a volume and a search that visits all of it (docs/volume.md)


def costs_at(
    maps: MetricMaps, levels_m: np.ndarray, constraints: Constraints, **when: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[K, Y, X]`` where a path may fly, and ``[L, K, Y, X]`` the costs, of levels within the maps' range."""
    is_free = constraints.free_levels(maps, levels_m.tolist(), **when)
    costs = np.empty((len(maps.metrics), *is_free.shape), np.float32)
    is_under_sky = cache(maps.is_under_sky)
    for (name, metric), layers in zip(maps.metrics.items(), costs, strict=True):
        read = cache(partial(maps.m, name, **when))
        is_flat = "altitude" not in maps.ds[maps.variable(name)].dims
        for level, z_m in enumerate(levels_m.tolist()):
            m = read(maps.altitudes_m[0]) if is_flat else values_at(z_m, maps.altitudes_m, read, is_under_sky)
            layers[level] = np.asarray(metric.cost(m))
            is_nothing = ~np.isfinite(layers[level])
            is_nothing &= ~is_free[level]
            layers[level][is_nothing] = np.nan_to_num(layers[level][is_nothing])
    return is_free, costs


def check_memory(shape: tuple[int, int, int]) -> None:
    """Raise InputError unless a volume of ``[K, Y, X]`` nodes fits in the memory that is free."""
    needed, free = math.prod(shape) * NODE_BYTES, free_bytes()
    if needed > free:
        raise InputError(
            f"a volume of {shape[0]} levels of {shape[1]} x {shape[2]} cells takes up to {told_bytes(needed)} of "
            f"memory and {told_bytes(free)} are free: choose a longer level_step_m, closer altitude bounds, or "
            "coarser maps"
        )
