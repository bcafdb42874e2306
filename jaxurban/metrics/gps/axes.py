"""How well the satellites seen fix the position alone, level and upright: metrics of their own, made on request."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from jaxtyping import Array

from jaxurban.errors import typed
from jaxurban.metrics.base import ALTITUDE, TIME, Metric, Scene, SoftScene, low_is_bad
from jaxurban.metrics.gps.hard import gps_metric
from jaxurban.metrics.gps.soft import soft_dop_metric
from jaxurban.metrics.settings import check_value, differentiable


@differentiable("dop_threshold")
@typed
@dataclass(frozen=True)
class DopParams:
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


def _map(name: str, dop: str, scene: Scene, params: DopParams) -> dict[str, Array]:
    """Return m of one DOP of a scene."""
    assert scene.satellites is not None
    assert scene.words is not None
    assert scene.is_obstacle is not None
    dops = scene.satellites.maps(scene.words, scene.is_obstacle)
    return {name: gps_metric(getattr(dops, dop), params.dop_threshold)}


def _soft(dop: str, scene: SoftScene, params: DopParams) -> Array:
    here = scene.surface, scene.altitude_m, params.dop_threshold, scene.softness_m, scene.view
    return soft_dop_metric(*here, dop=dop, cells=scene.cells)


def _metric(name: str, dop: str, label: str, colour: str, colour_map: str) -> Metric:
    compute: Callable = partial(_map, name, dop)
    return Metric(
        name=name,
        params=DopParams,
        dims=(TIME, ALTITUDE),
        compute=compute,
        soft=partial(_soft, dop),
        cost=low_is_bad,
        label=label,
        one_means=f"{dop.upper()} of 1 or less",
        colour=colour,
        colour_map=colour_map,
    )


HORIZONTAL = _metric("gps_horizontal", "hdop", "GPS quality, horizontal", "#117733", "YlGnBu_r")
VERTICAL = _metric("gps_vertical", "vdop", "GPS quality, vertical", "#882255", "PuBuGn_r")
