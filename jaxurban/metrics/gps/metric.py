"""GPS as metrics of the maps: m of GDOP, and on request of the position alone, level and upright."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Array

from jaxurban.errors import typed
from jaxurban.metrics.base import ALTITUDE, TIME, Metric, Scale, Scene, SoftScene, TracedScene, Variable, low_is_bad
from jaxurban.metrics.gps.hard import Gps, GpsMaps, gps_metric, maps_of_choices, maps_of_words, satellites_of
from jaxurban.metrics.gps.soft import soft_gps
from jaxurban.metrics.settings import check_value, differentiable

DOPS = {"gdop": "geometric", "pdop": "position", "hdop": "horizontal", "vdop": "vertical", "tdop": "time"}
WEIGHTED_DOPS = tuple(f"w{name}" for name in DOPS)  # where satellites count by their elevation


def is_weighted(params: Gps) -> bool:
    """Return whether satellites count by their elevation."""
    return params.weighting == "elevation"


_dop = partial(Variable, inside=np.nan, scale=Scale("viridis_r", 1.0, 20.0, is_better_low=True), is_averaged=False)
ALSO = (  # the scale of DOPs ends where the paper's rating turns poor
    *(_dop(name, f"{kind} dilution of precision", symbol=name.upper()) for name, kind in DOPS.items()),
    Variable(
        "num_visible", "satellites in view", dtype=np.uint8, inside=0, scale=Scale("viridis", high=None, least=4.0)
    ),
    *(
        _dop(name, f"{kind} dilution of precision, weighted by elevation", symbol=name.upper(), is_made=is_weighted)
        for name, kind in zip(WEIGHTED_DOPS, DOPS.values(), strict=True)
    ),
)


def _named(maps: GpsMaps) -> dict[str, Any]:
    return {"gps": maps.m, **{name: getattr(maps, name) for name in (*DOPS, "num_visible")}}


def _maps(scene: Scene, params: Gps) -> dict[str, Any]:
    """Return m, the DOPs and the satellites seen."""
    maps, number = _of_choices(scene, params.gdop_threshold)
    named = {"gps": maps.m} if scene.only_m else _named(maps)
    if is_weighted(params) and not scene.only_m:
        weighted, _ = _of_choices(scene, params.gdop_threshold, is_weighted=True)
        named |= {f"w{name}": getattr(weighted, name) for name in DOPS}
    return {name: np.take(values, number) for name, values in named.items()}


def _of_choices(scene: Scene, threshold: float, is_weighted: bool = False) -> tuple[GpsMaps, np.ndarray]:
    return maps_of_choices(scene.words, scene.is_obstacle, satellites_of(scene.in_view, is_weighted), threshold)


def _traced(scene: TracedScene, params: Gps) -> dict[str, Any]:
    return _named(maps_of_words(scene.words, scene.satellites, params.gdop_threshold))


def _soft(dop: str, threshold: str, scene: SoftScene, params: Any) -> Array:
    """Return soft m of one DOP, whose threshold is a setting of this name."""
    here = scene.surface, scene.altitude_m, getattr(params, threshold), scene.softness_m, scene.view
    return soft_gps(*here, dop=dop, cells=scene.cells)


METRIC = Metric(
    name="gps",
    params=Gps,
    dims=(TIME, ALTITUDE),
    compute=_maps,
    traced=_traced,
    soft=partial(_soft, "gdop", "gdop_threshold"),
    cost=low_is_bad,
    label="GPS quality",
    one_means="GDOP of 1, the best possible",
    colour="#0072b2",
    colour_map="viridis",
    also=ALSO,
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
    maps, number = _of_choices(scene, params.dop_threshold)
    return {name: gps_metric(np.take(getattr(maps, dop), number), params.dop_threshold)}


def _traced_of(name: str, dop: str, scene: TracedScene, params: Dop) -> dict[str, Array]:
    maps = maps_of_words(scene.words, scene.satellites, params.dop_threshold)
    return {name: gps_metric(getattr(maps, dop), params.dop_threshold)}


def _metric(name: str, dop: str, label: str, colour: str, colour_map: str) -> Metric:
    compute: Callable = partial(_map_of, name, dop)
    return Metric(
        name=name,
        params=Dop,
        dims=(TIME, ALTITUDE),
        compute=compute,
        traced=partial(_traced_of, name, dop),
        soft=partial(_soft, dop, "dop_threshold"),
        cost=low_is_bad,
        label=label,
        one_means=f"{dop.upper()} of 1 or less",
        colour=colour,
        colour_map=colour_map,
    )


HORIZONTAL = _metric("gps_horizontal", "hdop", "GPS quality, horizontal", "#117733", "YlGnBu_r")
VERTICAL = _metric("gps_vertical", "vdop", "GPS quality, vertical", "#882255", "PuBuGn_r")
