"""GPS as metrics of the maps: m of GDOP, and on request of the position alone, level and upright."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Array

from jaxurban.errors import typed
from jaxurban.metrics.base import (
    ALTITUDE,
    TIME,
    AnyArray,
    Metric,
    Scale,
    Scene,
    SoftScene,
    TracedScene,
    Variable,
    low_is_bad,
)
from jaxurban.metrics.gps.hard import Gps, gps_metric, maps_of_words
from jaxurban.metrics.gps.soft import soft_gps
from jaxurban.metrics.settings import check_value, differentiable

DOPS = {"gdop": "geometric", "pdop": "position", "hdop": "horizontal", "vdop": "vertical", "tdop": "time"}
WEIGHTED_DOPS = tuple(f"w{name}" for name in DOPS)  # where satellites count by their elevation
DOP_SCALE = Scale("viridis_r", 1.0, 20.0, is_better_low=True)  # up to where the paper's rating turns poor


def _maps(scene: Scene, params: Gps) -> dict[str, AnyArray]:
    """Return m, the DOPs and the satellites seen; they were made ready under the same settings."""
    if scene.only_m:
        return {"gps": scene.satellites.m(scene.words, scene.is_obstacle)}
    maps = scene.satellites.maps(scene.words, scene.is_obstacle)
    found = {"gps": maps.m, **{name: getattr(maps, name) for name in (*DOPS, "num_visible")}}
    if (weighted := scene.satellites.weighted) is not None:
        maps = weighted.maps(scene.words, scene.is_obstacle)
        found |= {f"w{name}": getattr(maps, name) for name in DOPS}
    return found


def is_weighted(params: Gps) -> bool:
    """Return whether satellites count by their elevation."""
    return params.weighting == "elevation"


def _dop_variable(name: str, kind: str) -> Variable:
    dop = Variable(name, f"{kind} dilution of precision", inside=np.nan, scale=DOP_SCALE, is_averaged=False)
    return replace(dop, symbol=name.upper())


def _weighted(dop: Variable) -> Variable:
    name, long_name = f"w{dop.name}", f"{dop.long_name}, weighted by elevation"
    return replace(dop, name=name, long_name=long_name, symbol=name.upper(), is_made=is_weighted)


DOP_VARIABLES = tuple(_dop_variable(name, kind) for name, kind in DOPS.items())
NUM_VISIBLE = Variable(
    "num_visible", "satellites in view", dtype=np.uint8, inside=np.nan, scale=Scale("viridis", high=None, least=4.0)
)


def _traced(scene: TracedScene, params: Gps) -> dict[str, Array]:
    """Return the same at all altitudes."""
    maps = maps_of_words(scene.words, scene.satellites, params.gdop_threshold)
    return {"gps": maps.m, **{name: getattr(maps, name) for name in (*DOPS, "num_visible")}}


def _soft(scene: SoftScene, params: Gps) -> Array:
    here = scene.surface, scene.altitude_m, params.gdop_threshold, scene.softness_m, scene.view
    return soft_gps(*here, cells=scene.cells)


METRIC = Metric(
    name="gps",
    params=Gps,
    dims=(TIME, ALTITUDE),
    compute=_maps,
    traced=_traced,
    soft=_soft,
    cost=low_is_bad,
    label="GPS quality",
    one_means="GDOP of 1, the best possible",
    colour="#0072b2",
    colour_map="viridis",
    also=(*DOP_VARIABLES, NUM_VISIBLE, *map(_weighted, DOP_VARIABLES)),
    cell_bytes=72,  # DOPs, m, and both weighted ones once more
)


@differentiable("dop_threshold")
@typed
@dataclass(frozen=True)
class Dop:
    """Settings of a metric of one DOP. A pytree whose leaf is the threshold.

    Attributes:
      dop_threshold: DOP at and above which m is 0, > 1; m is 1 at a DOP of 1 and below.

    Raises:
      InputError: a value that is none.
    """

    dop_threshold: float = 20.0

    def __post_init__(self) -> None:
        what = "a number above 1 (such as 20)"
        check_value("dop_threshold", self.dop_threshold, what, lambda threshold: threshold > 1)


def _map_of(name: str, dop: str, scene: Scene, params: Dop) -> dict[str, Array]:
    """Return m of one DOP of a scene."""
    dops = scene.satellites.maps(scene.words, scene.is_obstacle)
    return {name: gps_metric(getattr(dops, dop), params.dop_threshold)}


def _traced_of(name: str, dop: str, scene: TracedScene, params: Dop) -> dict[str, Array]:
    maps = maps_of_words(scene.words, scene.satellites, params.dop_threshold)
    return {name: gps_metric(getattr(maps, dop), params.dop_threshold)}


def _soft_of(dop: str, scene: SoftScene, params: Dop) -> Array:
    here = scene.surface, scene.altitude_m, params.dop_threshold, scene.softness_m, scene.view
    return soft_gps(*here, dop=dop, cells=scene.cells)


def _metric(name: str, dop: str, label: str, colour: str, colour_map: str) -> Metric:
    compute: Callable = partial(_map_of, name, dop)
    return Metric(
        name=name,
        params=Dop,
        dims=(TIME, ALTITUDE),
        compute=compute,
        traced=partial(_traced_of, name, dop),
        soft=partial(_soft_of, dop),
        cost=low_is_bad,
        label=label,
        one_means=f"{dop.upper()} of 1 or less",
        colour=colour,
        colour_map=colour_map,
    )


HORIZONTAL = _metric("gps_horizontal", "hdop", "GPS quality, horizontal", "#117733", "YlGnBu_r")
VERTICAL = _metric("gps_vertical", "vdop", "GPS quality, vertical", "#882255", "PuBuGn_r")
