"""GPS as a metric of the maps."""

import numpy as np
from jaxtyping import Array

from jaxurban.metrics.base import ALTITUDE, TIME, AnyArray, Metric, Scene, SoftScene, low_is_bad
from jaxurban.metrics.gps.params import GpsParams
from jaxurban.metrics.gps.soft import soft_gps

DOPS = ("gdop", "pdop", "hdop", "vdop", "tdop")
WEIGHTED_DOPS = tuple(f"w{name}" for name in DOPS)  # where satellites count by their elevation


def _maps(scene: Scene, params: GpsParams) -> dict[str, AnyArray]:
    """Return m, the DOPs and the satellites seen; they were made ready under the same settings."""
    assert scene.satellites is not None
    assert scene.words is not None
    assert scene.is_obstacle is not None
    if scene.only_m:
        return {"gps": scene.satellites.m(scene.words, scene.is_obstacle)}
    maps = scene.satellites.maps(scene.words, scene.is_obstacle)
    found = {"gps": maps.m, **{name: getattr(maps, name) for name in (*DOPS, "num_visible")}}
    if (weighted := scene.satellites.weighted) is not None:
        maps = weighted.maps(scene.words, scene.is_obstacle)
        found |= {f"w{name}": getattr(maps, name) for name in DOPS}
    return found


def _also_under(params: GpsParams) -> dict[str, type]:
    """Return the weighted DOPs, where they are wanted."""
    return dict.fromkeys(WEIGHTED_DOPS, np.float32) if params.weighting == "elevation" else {}


def _soft(scene: SoftScene, params: GpsParams) -> Array:
    return soft_gps(scene.surface, scene.altitude_m, params, scene.softness_m, scene.view, cells=scene.cells)


METRIC = Metric(
    name="gps",
    params=GpsParams,
    dims=(TIME, ALTITUDE),
    compute=_maps,
    soft=_soft,
    cost=low_is_bad,
    label="GPS quality",
    one_means="GDOP of 1, the best possible",
    colour="#0072b2",
    colour_map="viridis",
    also={**dict.fromkeys(DOPS, np.float32), "num_visible": np.uint8},
    also_under=_also_under,
    cell_bytes=72,  # DOPs, m, and both weighted ones once more
)
