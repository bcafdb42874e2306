"""The GPS floor: from which height above each cell on GPS is good, exactly; made on request, and no cost of paths."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Array

from jaxurban.checks import typed
from jaxurban.kernels.blocks import part_of
from jaxurban.kernels.dop import Geometry
from jaxurban.kernels.least_heights import least_heights
from jaxurban.metrics.base import TIME, Metric, Scale, Scene, Variable, none_of_it
from jaxurban.metrics.gps import DopName, satellites_of
from jaxurban.metrics.settings import check_fields, differentiable, is_positive
from jaxurban.metrics.visibility import traced_shadows

CELLS_AT_ONCE = 2**14  # on a host, so that one program serves regions of any shape


@differentiable("dop_threshold")
@typed
@dataclass(frozen=True)
class GpsFloor:
    """Settings of the GPS floor: which DOP has to stay at or below what. A pytree whose leaf is the threshold.

    Attributes:
      dop_threshold: the highest DOP that is good; 6 is where the paper's class Good ends.
      dop: which one: ``"gdop"``, ``"pdop"``, ``"hdop"``, ``"vdop"`` or ``"tdop"``.

    Raises:
      InputError: a threshold that is not positive, or an unknown DOP.

    Examples:
      >>> floor = ju.metrics.GpsFloor(dop_threshold=3.0, dop="hdop")
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), gps_floor=floor)
      >>> made.ds["gps_floor"].dims, round(float(made.ds["gps_floor"].median()))  # metres above the ground
      (('time', 'y', 'x'), 0)
    """

    dop_threshold: float = 6.0
    dop: DopName = "gdop"

    def __post_init__(self) -> None:
        check_fields(self, ["dop_threshold"], "a positive number (such as 6)", is_positive)


def _maps(scene: Scene, params: GpsFloor) -> dict[str, np.ndarray]:
    """Return the map of one time (`Metric.compute`), group of cells by group of cells."""
    satellites = satellites_of(scene.in_view)
    roof_m = np.asarray(scene.surface.crop(scene.surface.roof_m))
    rows = np.stack([roof_m, *scene.shadows]).reshape(1 + len(scene.shadows), -1)
    shape = 1 + len(satellites.rows), CELLS_AT_ONCE
    floors = []
    for first in range(0, roof_m.size, CELLS_AT_ONCE):
        roof, *shadows = part_of(rows, (0, first), shape, 0)
        floors.append(_floor(np.stack(shadows), roof, satellites, params))
    floor_m = np.concatenate(floors)[: roof_m.size]
    return {METRIC.name: floor_m.reshape(roof_m.shape)}


def _traced(scene: Scene, params: GpsFloor) -> dict[str, Array]:
    """Return the same of arrays that JAX may trace (`Metric.traced`)."""
    roof_m = scene.surface.crop(scene.surface.roof_m)
    shadow_m = traced_shadows(scene.surface, scene.sky)
    return {METRIC.name: _floor(shadow_m, roof_m, scene.sky.satellites, params)}


def _floor(shadow_m: Any, roof_m: Any, satellites: Geometry, params: GpsFloor) -> Array:
    """Return `least_heights` under settings."""
    return least_heights(shadow_m, roof_m, satellites, params.dop_threshold, dop=params.dop)


def _attributes(params: GpsFloor) -> dict[str, str]:
    """Return what files say of the map under its settings (`Metric.attributes`)."""
    condition = f"{params.dop.upper()} stays at or below {params.dop_threshold:g}"
    return {"long_name": f"least height above the ground from which {condition}"}


CAVEAT = (
    "Of the satellites in line of sight, without reflections, which are worst low in streets; over a roof at least the "
    "roof's top."
)
METRIC = Metric(
    name="gps_floor",
    params=GpsFloor,
    dims=(TIME,),
    compute=_maps,
    traced=_traced,
    cost=none_of_it,
    label="GPS floor",
    one_means="",
    colour="#aa4499",
    colour_map="YlOrRd",
    own=Variable(
        "gps_floor",
        "least height above the ground from which GPS is good",
        "m",
        scale=Scale("YlOrRd", high=120.0, is_better_low=True),
        title="GPS floor",
        is_averaged=False,
        is_inf_missing=True,
    ),
    attributes=_attributes,
    caveat=CAVEAT,
    cell_bytes=400,  # the shadows of up to 48 satellites, twice
)
