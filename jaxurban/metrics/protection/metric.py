"""Protection levels as a metric of the maps, made where it is asked for."""

import numpy as np

from jaxurban.metrics.base import ALTITUDE, TIME, Metric, Scene, low_is_bad
from jaxurban.metrics.protection.hard import protection_maps
from jaxurban.metrics.protection.params import ProtectionParams

LEVELS = ("hpl", "vpl")
WITHIN_LIMITS = "within_limits"
CAVEAT = (
    "Protection levels of the satellites in line of sight, as if under open sky: no multipath and no reflections are "
    "in them. In a street canyon this is no integrity."
)


def _maps(scene: Scene, params: ProtectionParams) -> dict[str, np.ndarray]:
    """Return m, both levels, and where both are within their alert limits."""
    assert scene.in_view is not None
    assert scene.words is not None
    assert scene.is_obstacle is not None
    maps = protection_maps(scene.words, scene.is_obstacle, scene.in_view, params)
    if scene.only_m:
        return {"protection": maps.m}
    return {"protection": maps.m, "hpl": maps.hpl, "vpl": maps.vpl, WITHIN_LIMITS: maps.within_limits}


METRIC = Metric(
    name="protection",
    params=ProtectionParams,
    dims=(TIME, ALTITUDE),
    compute=_maps,
    cost=low_is_bad,
    label="Protection",
    one_means="an HPL of 0 m",
    colour="#332288",
    colour_map="cividis",
    also={**dict.fromkeys(LEVELS, np.float32), WITHIN_LIMITS: np.uint8},
    available=WITHIN_LIMITS,
    is_monotone=False,
    caveat=CAVEAT,
    cell_bytes=40,  # the distinct patterns at worst, their number in each cell, and one altitude's maps
)
