"""How high roofs of guessed height in maps may reach."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps


def roof_limits_m(maps: "MetricMaps") -> np.ndarray:
    """Return ``[y, x]`` the height up to which a roof of guessed height in each cell may reach, 0 where there is none.

    It is inf where nothing bounds it, as of maps up to jaxurban 1.1, which hold no bounds.
    """
    if "roof_limit" in maps.ds:
        return maps.m("roof_limit")
    if "roof_guessed" in maps.ds:
        return np.where(maps.m("roof_guessed") == 1, np.float32(np.inf), np.float32(0))
    return np.zeros(maps.grid.shape, np.float32)
