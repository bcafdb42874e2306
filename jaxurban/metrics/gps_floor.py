"""The GPS floor: from which height above each cell on GPS is good, exactly; made on request, and no cost of paths."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Array, Float

from jaxurban.checks import typed
from jaxurban.kernels.blocks import part_of, rounded_up
from jaxurban.kernels.least_heights import least_heights
from jaxurban.metrics.base import TIME, Metric, Scale, Scene, Variable, none_of_it
from jaxurban.metrics.gps import SATELLITES_STEP, DopName, satellites_of
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
    shadow_m, ground_m = scene.shadows
    num, *shape = shadow_m.shape
    roof_m = np.asarray(scene.surface.crop(scene.surface.roof_m))
    rows = shadow_m.reshape(num, -1), ground_m.reshape(1, -1), roof_m.reshape(1, -1)
    num_filled = rounded_up(num, SATELLITES_STEP), 1, 1
    floor = partial(
        least_heights,
        satellites=satellites_of(scene.in_view),
        num=np.int32(num),
        threshold=np.float32(params.dop_threshold),
        dop=params.dop,
    )
    num_cells = roof_m.size
    floors = np.empty(rounded_up(num_cells, CELLS_AT_ONCE), np.float32)
    for first in range(0, num_cells, CELLS_AT_ONCE):
        shadows, ground, roof = (
            part_of(values, (0, first), (num_rows, CELLS_AT_ONCE), 0)
            for values, num_rows in zip(rows, num_filled, strict=True)
        )
        floors[first : first + CELLS_AT_ONCE] = floor(shadows, ground[0], roof[0])
    return {METRIC.name: floors[:num_cells].reshape(shape)}


def _traced(scene: Scene, params: GpsFloor) -> dict[str, Float[Array, "y x"]]:
    """Return the same of arrays that JAX may trace (`Metric.traced`)."""
    shadow_m, ground_m = traced_shadows(scene.surface, scene.sky)
    roof_m = scene.surface.crop(scene.surface.roof_m)
    floors = least_heights(
        shadow_m,
        ground_m,
        roof_m,
        scene.sky.satellites,
        scene.sky.num,
        params.dop_threshold,
        dop=params.dop,
    )
    return {METRIC.name: floors}


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
    cell_bytes=24,  # the map, its group of cells, and the surface's rasters; the shadows are counted apart
)
