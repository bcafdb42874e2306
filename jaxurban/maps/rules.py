"""Which cells of maps are free: where planners may fly, and where metrics are defined."""

from typing import TYPE_CHECKING

import numpy as np

from jaxurban.errors import InputError
from jaxurban.metrics.base import UNDERSIDE
from jaxurban.settings import Obstacles
from jaxurban.world.surface import stands_at

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps


def free_cells(maps: "MetricMaps", altitude_m: float, obstacles: Obstacles | None) -> np.ndarray:
    """Return ``[y, x]`` bool, as `MetricMaps.is_free` says; without a rule also clear of what hangs over a cell."""
    rule = obstacles or maps.obstacles
    is_free = maps.ds["has_data"].values
    has_maps = altitude_m in maps.altitudes_m
    if has_maps:
        is_free = is_free & (maps.m("obstacle", altitude_m) == 0)
    avoids_slabs = obstacles is None and UNDERSIDE in maps.ds
    if rule == "touched" or avoids_slabs or not has_maps:
        is_free = is_free & _is_above_roofs(maps, altitude_m, rule)
    nearest_m = float(np.clip(altitude_m, min(maps.altitudes_m), max(maps.altitudes_m)))
    for name in maps.metrics:
        if "layer" not in maps.ds[maps.variable(name)].attrs:
            continue
        for z_m in maps.around(nearest_m):
            is_free = is_free & ~np.isnan(maps.m(name, z_m))
    return is_free


def _is_above_roofs(maps: "MetricMaps", altitude_m: float, rule: Obstacles) -> np.ndarray:
    """Return ``[y, x]`` bool: no roof of the rule reaches an altitude; False where its height is unknown (NaN)."""
    name = "roof_touched" if rule == "touched" else "roof"
    if rule == "touched" and name not in maps.ds:
        raise InputError(
            "these maps hold no 'roof_touched', the roofs that planners keep clear of: make them again, or "
            'plan with obstacles = "centre" (--obstacles centre), under which paths cut true outlines'
        )
    roof_m = maps.m(name)
    return ~stands_at(roof_m, roof_m.dtype.type(altitude_m)) & ~np.isnan(roof_m)
