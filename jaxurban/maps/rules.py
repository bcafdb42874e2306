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
    """Return ``[y, x]`` bool: where a path may fly at an altitude (`MetricMaps.is_free`).

    Args:
      maps: the maps.
      altitude_m: above ground; one of the maps' altitudes, or any other.
      obstacles: the rule; None for that of the maps, which also keeps paths clear of what hangs over a cell.
    """
    rule = obstacles or maps.obstacles
    is_free = maps.ds["has_data"].values
    has_maps = altitude_m in maps.altitudes_m
    if has_maps:
        is_free = is_free & (maps.m("obstacle", altitude_m) == 0)
    avoids_slabs = obstacles is None and UNDERSIDE in maps.ds
    if rule == "touched" or avoids_slabs or not has_maps:
        is_free = is_free & _is_above_roofs(maps, altitude_m, rule)

    # Layers of a user close the cells where they have no value, on the maps next below and above the altitude.
    nearest_m = float(np.clip(altitude_m, min(maps.altitudes_m), max(maps.altitudes_m)))
    for name in maps.metrics:
        if "layer" not in maps.ds[maps.variable(name)].attrs:
            continue
        for z_m in maps.around(nearest_m):
            is_free = is_free & ~np.isnan(maps.m(name, z_m))
    return is_free


def roof_limits_m(maps: "MetricMaps") -> np.ndarray:
    """Return ``[y, x]`` the height up to which a roof of guessed height in each cell may reach, 0 where there is none.

    It is inf where nothing bounds it, as of maps up to jaxurban 1.1, which hold no bounds.
    """
    if "roof_limit" in maps.ds:
        return maps.m("roof_limit")
    if "roof_guessed" in maps.ds:
        return np.where(maps.m("roof_guessed") == 1, np.float32(np.inf), np.float32(0))
    return np.zeros(maps.grid.shape, np.float32)


def _is_above_roofs(maps: "MetricMaps", altitude_m: float, rule: Obstacles) -> np.ndarray:
    """Return ``[y, x]`` bool: where no roof, as the rule sees them, reaches an altitude; False where one is unknown.

    Raises:
      InputError: the rule is ``"touched"``, and the maps hold no touched roofs.
    """
    name = "roof_touched" if rule == "touched" else "roof"
    if rule == "touched" and name not in maps.ds:
        raise InputError(
            "these maps hold no 'roof_touched', the roofs that planners keep clear of: make them again, or "
            'plan with obstacles = "centre" (--obstacles centre), under which paths cut true outlines'
        )
    roof_m = maps.m(name)
    return ~stands_at(roof_m, roof_m.dtype.type(altitude_m)) & ~np.isnan(roof_m)
