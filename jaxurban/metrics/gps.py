"""GPS: how well the satellites seen from each cell fix a position; on request level and upright apart."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt, UInt8

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError
from jaxurban.kernels.blocks import BLOCK_CELLS, by_device_cells
from jaxurban.kernels.dop import Geometry, dops_of_words, geometry, unit_vectors
from jaxurban.metrics.base import (
    ALTITUDE,
    TIME,
    AnyArray,
    Metric,
    Scale,
    Scene,
    SoftScene,
    Variable,
    low_is_bad,
)
from jaxurban.metrics.gps_soft import gps_metric, soft_gps
from jaxurban.metrics.settings import check_fields, differentiable
from jaxurban.metrics.visibility import distinct_choices
from jaxurban.programs import kept_jit
from jaxurban.settings import NOMINAL, as_tuple, iso_utc, parse_time
from jaxurban.world.sky import InView

MOST_TIMES = 100_000  # a year in steps of five minutes
MAX_STORED_TIMES = 24  # a longer series keeps statistics over time instead of every time's maps
DOP_THRESHOLD = "a number above 1 (such as 20)"


def is_dop_threshold(values: Any) -> Any:
    """Return whether numbers are above the DOP at which m is 1."""
    return values > 1


@differentiable("gdop_threshold")
@typed
@dataclass(frozen=True)
class Gps:
    """Settings of the GPS metric, and which satellites are seen when. A pytree whose leaf is the threshold.

    Attributes:
      gdop_threshold: GDOP at and above which m is 0, > 1.
      series: what is kept of several times: every one of them (``"epochs"``), statistics over time
        (``"statistics"``, see `jaxurban.metrics.variables`), or statistics above `MAX_STORED_TIMES`
        (``"auto"``).
      availability_threshold: m above which a position counts as available, in [0, 1).
      bounds: also make ``gps_lower`` and ``gps_upper``, which bracket the true m (``oversample`` odd, one clock).
      clocks: of the receiver, which are solved for beside the position: one for each ``"system"`` that is seen, as
        their times differ by what nobody knows, or ``"one"`` for all, as in the paper, which has but one system.
      orbits: ``"nominal"``, a file of TLE, OMM, broadcast RINEX or SP3, or several of these (other
        constellations).
      times: UTC times, ISO 8601, whole seconds; left out, see `jaxurban.maps.build.view_sky`.
      step_s: a series of times so many seconds apart, of which ``times`` names the first and the last possible one.
      mask_deg: elevation mask; lower satellites are not used.
      max_age_days: older element sets are refused.
      reference: longitude, latitude where look angles are taken; left out, the region's centre.
      plants: whether trees and woods let signals through (``"pass"``), or hide satellites (``"hide"``): the two bounds.

    Raises:
      InputError: a value out of its range, or times that are not different.

    Examples:
      >>> gps = ju.Gps(times=("2020-04-27T12:00:00Z", "2020-04-27T15:00:00Z"), step_s=3600, mask_deg=10.0)
      >>> len(gps.utc_times)
      4
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), gps=gps)
      >>> made.ds["gps"].shape  # time, altitude, y, x
      (4, 1, 30, 30)
    """

    gdop_threshold: float = 20.0
    series: Literal["auto", "epochs", "statistics"] = "auto"
    availability_threshold: float = 0.5
    bounds: bool = False
    clocks: Literal["system", "one"] = "system"
    orbits: str | Path | Sequence[str | Path] = (NOMINAL,)
    times: str | Sequence[str] | None = None
    step_s: int | None = None
    mask_deg: float = 5.0
    max_age_days: float = 90.0
    reference: tuple[float, float] | None = None
    plants: Literal["pass", "hide"] = "pass"

    def __post_init__(self) -> None:
        """Check the settings, and write orbits and times, in place, as tuples; errors as of the class."""
        check_fields(self, ["gdop_threshold"], DOP_THRESHOLD, is_dop_threshold)
        check_fields(
            self,
            ["availability_threshold"],
            "a value of m from 0 to below 1",
            lambda m: (m >= 0) & (m < 1),
        )
        if not 0 <= self.mask_deg < 90:
            raise InputError(
                f"mask_deg must be an angle from 0 to less than 90 degrees, got {self.mask_deg}"
            )
        positive("max_age_days", self.max_age_days, "days")
        place: Sequence[float] = self.reference or (0, 0)
        if len(place) != 2 or not (abs(place[0]) <= 180 and abs(place[1]) <= 90):
            raise InputError(
                f"reference must be a longitude and a latitude in degrees, got {self.reference}"
            )
        object.__setattr__(self, "orbits", as_tuple(self.orbits))
        self._check_times()

    @property
    def lowest_mask_deg(self) -> float:
        """The least elevation of a satellite that is used: how far away buildings may stand and hide one."""
        return self.mask_deg

    def _check_times(self) -> None:
        """Check the times, and write them, in place, as UTC.

        Raises:
          InputError: the same time twice, a time that is not a whole second, or a series without its two ends, with a
            step below a second, or of more than `MOST_TIMES`.
        """
        if self.times is not None:
            object.__setattr__(self, "times", tuple(map(iso_utc, as_tuple(self.times))))
        if self.step_s is not None:
            self._check_series()
        times = self.utc_times
        if times is None:
            return
        if not times or len(set(times)) < len(times):
            raise InputError(
                f"times must be different UTC times such as 2020-04-27T16:00:00Z, got {list(times)}"
            )
        if any("." in time for time in times):
            raise InputError("times must be whole seconds, as file names carry them")

    def _check_series(self) -> None:
        """Check a series of times.

        Raises:
          InputError: times that are not two, in their order, a step below a second, or more than `MOST_TIMES`.
        """
        step_s = at_least("step_s", self.step_s, 1)
        ends = self.times or ()
        if len(ends) != 2 or ends[1] < ends[0]:
            raise InputError(
                f"step_s needs two times, first the beginning of the series and then its end, got {list(ends)}"
            )
        start, stop = map(parse_time, ends)
        num_steps = (stop - start).total_seconds() / step_s
        if num_steps >= MOST_TIMES:
            raise InputError(f"step_s makes {num_steps:.3g} times: make it longer")

    @property
    def utc_times(self) -> tuple[str, ...] | None:
        """The UTC times, ISO 8601 with a trailing Z; None where `jaxurban.maps.build.view_sky` chooses."""
        if self.times is None:
            return None
        if self.step_s is None:
            return tuple(self.times)
        start, stop = map(parse_time, self.times)
        step = timedelta(seconds=self.step_s)
        num_steps = (stop - start) // step
        return tuple(iso_utc(start + step * number) for number in range(num_steps + 1))

    def keeps_times(self, num_times: int) -> bool:
        """Return whether the maps of every time are kept, not statistics over them.

        Returns:
          False where statistics over the times are kept instead.

        Examples:
          >>> ju.Gps().keeps_times(4), ju.Gps(series="statistics").keeps_times(4)
          (True, False)
        """
        return self.series == "epochs" or (self.series == "auto" and num_times <= MAX_STORED_TIMES)


# The paper's table of DOP ratings, Poor above the last.
RATING_UPPER_GDOP = (1.0, 4.0, 6.0, 8.0, 20.0)
SATELLITES_STEP = 8  # the DOP program is compiled for 8, 16, 24 ... satellites


class GpsMaps(NamedTuple):
    """GPS maps of one time. ``C`` stands for any axes of cells.

    Inside obstacles m and num_visible are 0 and the DOPs inf.

    Attributes:
      m: the metric, 0 to 1.
      gdop, pdop, hdop, vdop, tdop: dilutions of precision; inf where the satellites that are seen leave the position
        undetermined, as with fewer of them than three and one for each clock.
      num_visible: number of satellites that are seen.
    """

    m: Float[AnyArray, "*C"]
    gdop: Float[AnyArray, "*C"]
    pdop: Float[AnyArray, "*C"]
    hdop: Float[AnyArray, "*C"]
    vdop: Float[AnyArray, "*C"]
    tdop: Float[AnyArray, "*C"]
    num_visible: UInt8[AnyArray, "*C"]


@kept_jit
def maps_of_words(
    words: UInt[AnyArray, "W ..."], satellites: Geometry, gdop_threshold: float | Array
) -> GpsMaps:
    """Return the GPS maps of cells, each of which sees the satellites whose bits are set in its words.

    Args:
      words: ``[W, ...]`` satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells after the first.
      satellites: the geometry of all of them.
      gdop_threshold: GDOP at and above which m is 0, see `gps_metric`.
    """

    def maps(words: Array) -> GpsMaps:
        """Return the maps of one block of cells, ``[W, C]`` words."""
        dops = dops_of_words(satellites, words)
        num_visible = jnp.sum(lax.population_count(words), axis=0).astype(jnp.uint8)
        m = gps_metric(dops.gdop, gdop_threshold)
        return GpsMaps._make((m, *dops, num_visible))

    return by_device_cells(maps, words)


def satellites_of(in_view: InView) -> Geometry:
    """Return the geometry of the satellites in view, for DOPs; rounded up to a multiple of `SATELLITES_STEP`."""
    return geometry(
        unit_vectors(*in_view.angles), multiple_of=SATELLITES_STEP, clocks=in_view.clocks
    )


def maps_of_choices(
    words: UInt[AnyArray, "W ..."],
    is_obstacle: Bool[AnyArray, "..."],
    satellites: Geometry,
    gdop_threshold: float,
) -> tuple[GpsMaps, Int[np.ndarray, "..."]]:
    """Return the GPS maps by distinct choice of satellites, which are far fewer than cells, and each cell's choice.

    Args:
      words, satellites, gdop_threshold: as for `maps_of_words`.
      is_obstacle: cells that see no satellite.

    Returns:
      The maps, ``[P]`` of P choices, and for each cell the number of its choice: ``maps.m[number]`` is the map of m.
    """
    choices, number = distinct_choices(words, is_obstacle)
    num_choices = choices.shape[1]
    # Choices that see nothing fill the last block, so that one program serves all blocks.
    padded = np.pad(choices, [(0, 0), (0, -num_choices % BLOCK_CELLS)])
    blocks = np.split(padded, padded.shape[1] // BLOCK_CELLS, axis=1)
    parts = [maps_of_words(block, satellites, gdop_threshold) for block in blocks]
    maps = GpsMaps(*(np.concatenate(values)[:num_choices] for values in zip(*parts, strict=True)))
    return maps, number


class Rating(IntEnum):
    """The paper's classes of GDOP."""

    IDEAL = 0  # 1 and less
    EXCELLENT = 1  # above 1, up to 4
    GOOD = 2  # up to 6
    MODERATE = 3  # up to 8
    FAIR = 4  # up to 20
    POOR = 5  # above 20, or undetermined


def rating(gdop: np.ndarray) -> np.ndarray:
    """Return the `Rating` of each GDOP as uint8, in the shape of the GDOPs; a class holds its own upper limit."""
    return np.searchsorted(RATING_UPPER_GDOP, gdop, side="left").astype(np.uint8)


DopName = Literal["gdop", "pdop", "hdop", "vdop", "tdop"]
DOPS = {
    "gdop": "geometric",
    "pdop": "position",
    "hdop": "horizontal",
    "vdop": "vertical",
    "tdop": "time",
}

_dop = partial(
    Variable,
    inside=np.nan,
    scale=Scale("viridis_r", 1.0, 20.0, is_better_low=True),
    is_averaged=False,
)
ALSO = (  # the scale of DOPs ends where the paper's rating turns poor
    *(
        _dop(name, f"{kind} dilution of precision", symbol=name.upper())
        for name, kind in DOPS.items()
    ),
    Variable(
        "num_visible",
        "satellites in view",
        dtype=np.uint8,
        inside=0,
        scale=Scale("viridis", high=None, least=4.0),
    ),
)


FIX = "hdop"  # the map that says where satellites fix a position


def has_no_fix(hdop: np.ndarray) -> np.ndarray:
    """Return where satellites fix no position, bool in the shape of HDOP: where that is infinite or unknown (NaN).

    A fix needs three satellites and one more for each clock of the receiver (`Gps`), and not all of them on one cone.
    """
    return ~np.isfinite(hdop)


def _named(maps: GpsMaps) -> dict[str, Any]:
    """Return the maps by the names of their variables."""
    named = maps._asdict()
    return {"gps": named.pop("m"), **named}


def _maps(scene: Scene, params: Gps) -> dict[str, Any]:
    """Return m and, unless only that is wanted, the DOPs and the number of satellites seen (`Metric.compute`)."""
    maps, number = _of_choices(scene, params.gdop_threshold)
    named = {"gps": maps.m} if scene.only_m else _named(maps)
    return {name: np.take(values, number) for name, values in named.items()}


def _of_choices(scene: Scene, threshold: float) -> tuple[GpsMaps, np.ndarray]:
    """Return `maps_of_choices` of a scene at one time and altitude."""
    return maps_of_choices(scene.words, scene.is_obstacle, satellites_of(scene.in_view), threshold)


def _traced(scene: Scene, params: Gps) -> dict[str, Any]:
    """Return the maps of all altitudes, of arrays that JAX may trace (`Metric.traced`)."""
    return _named(maps_of_words(scene.words, scene.sky.satellites, params.gdop_threshold))


def _soft(dop: str, threshold: str, scene: SoftScene, params: Any) -> Array:
    """Return soft m of one DOP (`Metric.soft`).

    Args:
      dop: which one, such as ``"hdop"``.
      threshold: name of the setting that is its threshold.
      scene: what the metric may look at.
      params: settings of the metric.
    """
    return soft_gps(
        scene.surface,
        scene.altitude_m,
        getattr(params, threshold),
        scene.softness_m,
        scene.view,
        dop=dop,
        cells=scene.cells,
        reception=scene.reception,
    )


METRIC = Metric(
    name="gps",
    params=Gps,
    dims=(TIME, ALTITUDE),
    compute=_maps,
    traced=_traced,
    soft=partial(_soft, "gdop", "gdop_threshold"),
    cost=low_is_bad,
    label="GPS quality",
    cost_label="Poor GPS",
    one_means="GDOP of 1, the best possible",
    colour="#0072b2",
    colour_map="viridis",
    also=ALSO,
    cell_bytes=72,  # DOPs, m and the number of the choice, and what makes them
    sources=("orbits", "times", "step_s", "max_age_days", "reference"),
    is_bracketed=True,
)


@differentiable("dop_threshold")
@typed
@dataclass(frozen=True)
class Dop:
    """Settings of a metric of one DOP. A pytree whose leaf is the threshold.

    Attributes:
      dop_threshold: DOP at and above which m is 0, > 1; m is 1 at a DOP of 1 and below.

    Raises:
      InputError: an invalid value.

    Examples:
      >>> horizontal = ju.metrics.Dop(dop_threshold=5.0)
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), gps_horizontal=horizontal)
      >>> list(made.metrics)
      ['gps', 'lidar', 'population', 'risk', 'gps_horizontal']
    """

    dop_threshold: float = 20.0

    def __post_init__(self) -> None:
        check_fields(self, ["dop_threshold"], DOP_THRESHOLD, is_dop_threshold)


def _map_of(name: str, dop: str, scene: Scene, params: Dop) -> dict[str, Array]:
    """Return m of one DOP of a scene (`Metric.compute`) under the name of its metric; ``dop`` as in `_soft`."""
    maps, number = _of_choices(scene, params.dop_threshold)
    return {name: gps_metric(np.take(getattr(maps, dop), number), params.dop_threshold)}


def _traced_of(name: str, dop: str, scene: Scene, params: Dop) -> dict[str, Array]:
    """Return the same at all altitudes, of arrays that JAX may trace (`Metric.traced`)."""
    maps = maps_of_words(scene.words, scene.sky.satellites, params.dop_threshold)
    return {name: gps_metric(getattr(maps, dop), params.dop_threshold)}


def _metric(name: str, dop: str, label: str, colour: str, colour_map: str) -> Metric:
    """Return the metric of one dilution of precision.

    Args:
      name: of the metric.
      dop: which one, such as ``"hdop"``.
      label: of the metric in figures.
      colour, colour_map: of its lines and of its maps.
    """
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
        cost_label=f"Poor {dop.upper()}",
        one_means=f"{dop.upper()} of 1 or less",
        colour=colour,
        colour_map=colour_map,
    )


HORIZONTAL = _metric("gps_horizontal", "hdop", "GPS quality, horizontal", "#117733", "YlGnBu_r")
VERTICAL = _metric("gps_vertical", "vdop", "GPS quality, vertical", "#882255", "PuBuGn_r")
