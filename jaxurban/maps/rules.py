"""How high roofs of guessed height in maps may reach."""

from typing import TYPE_CHECKING

import numpy as np

from jaxurban.settings import UnknownHeights

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps


LIMITS: dict[UnknownHeights, tuple[str, ...]] = {
    "guess": (),
    "likely": ("roof_likely", "roof_limit"),
    "highest": ("roof_limit",),
}


def roof_limits_m(maps: "MetricMaps", unknown_heights: UnknownHeights) -> np.ndarray:
    """Return ``[y, x]`` the height up to which a roof of guessed height in each cell may reach, 0 where there is none.

    Args:
      maps: of which the first raster that they hold counts; without one, no height marked as guessed is bounded.
      unknown_heights: ``"highest"``: their bound, inf where nothing bounds it; ``"likely"``: what 99 % of their kind
        keep below; ``"guess"``: nothing beside the guess itself.
    """
    names = LIMITS[unknown_heights]
    for name in names:
        if name in maps.ds:
            return maps.m(name)
    if names and "roof_guessed" in maps.ds:
        return np.where(maps.m("roof_guessed") == 1, np.float32(np.inf), np.float32(0))
    return np.zeros(maps.grid.shape, np.float32)
