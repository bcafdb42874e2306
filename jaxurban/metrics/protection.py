"""Protection levels: how far off a position from the satellites in line of sight can be without a warning.

Made on request, for a dual-frequency aviation receiver under open sky; every distinct choice of satellites is solved
once.
"""

import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from jaxtyping import Bool, Float, UInt

from jaxurban.checks import one_of, typed
from jaxurban.errors import InputError, readable
from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.base import (
    ALTITUDE,
    TIME,
    AnyArray,
    Metric,
    Scale,
    Scene,
    Variable,
    low_is_bad,
)
from jaxurban.metrics.settings import check_fields, differentiable, is_not_negative, is_positive
from jaxurban.metrics.visibility import distinct_choices
from jaxurban.world.sky import InView

if TYPE_CHECKING:  # imported where they are used: they bring Numba
    from jaxurban.kernels.protection import Ranging, RiskBudget


@typed
@dataclass(frozen=True, kw_only=True)
class IntegritySupport:
    """Integrity support data (ISD): what is promised of the satellites, and how the risk is shared out.

    Sources: Blanch et al. 2015 (IEEE Trans. AES 51) and EU-US Working Group C, ARAIM Milestone 3 report (2016); the GPS
    SPS performance standard (2020) for ``p_const_gps``.

    Attributes:
      sigma_ura_m: standard deviation of a satellite's orbit and clock errors that integrity counts on.
      sigma_ure_m: that of accuracy and continuity.
      bias_m: largest nominal bias of a satellite.
      p_sat: prior probability that a satellite is faulty.
      p_const_gps: that of a fault of all GPS satellites at once.
      p_const: that of every other constellation.
      phmi_horizontal, phmi_vertical: integrity risk of an approach, by direction.
      pfa_horizontal, pfa_vertical: probability of false alerts, by direction.
      p_unmonitored: most probability of faults that no subset of the satellites stands for.
      tolerance_m: by how much a level may be rounded up: east and north each, then vertical.

    Raises:
      InputError: a length that is not positive, a bias below 0, or a probability out of order.

    Examples:
      >>> worse = ju.typing.IntegritySupport(sigma_ura_m=2.4)
      >>> ju.metrics.Protection(isd=worse).isd.sigma_ura_m
      2.4
    """

    sigma_ura_m: float = 0.75
    sigma_ure_m: float = 0.5
    bias_m: float = 0.75
    p_sat: float = 1e-5
    p_const_gps: float = 1e-8
    p_const: float = 1e-4
    phmi_horizontal: float = 2e-9
    phmi_vertical: float = 9.8e-8
    pfa_horizontal: float = 9e-8
    pfa_vertical: float = 3.9e-6
    p_unmonitored: float = 8e-8
    tolerance_m: tuple[float, float] = (0.05, 1e-4)

    def __post_init__(self) -> None:
        """Check the settings; errors as of the class."""
        lengths = "sigma_ura_m", "sigma_ure_m", "tolerance_m"
        check_fields(self, lengths, "positive metres", is_positive)
        check_fields(self, ["bias_m"], "0 or more metres", is_not_negative)
        check_fields(
            self,
            ("p_sat", "p_const_gps", "p_const", "p_unmonitored"),
            "a probability from 0 to below 0.1",
            lambda p: (p >= 0) & (p < 0.1),
        )
        check_fields(
            self,
            ("phmi_horizontal", "phmi_vertical", "pfa_horizontal", "pfa_vertical"),
            "a probability from 1e-15 to 0.1",
            lambda p: (p >= 1e-15) & (p <= 0.1),
        )
        if len(self.tolerance_m) != 2:
            raise InputError(
                f"tolerance_m must be two numbers of metres such as [0.05, 0.0001], got {self.tolerance_m}"
            )
        object.__setattr__(self, "tolerance_m", tuple(self.tolerance_m))

    @property
    def budget(self) -> "RiskBudget":
        """How risk is shared out, for the kernel."""
        from jaxurban.kernels.protection import RiskBudget

        shares = self.phmi_horizontal, self.phmi_vertical, self.pfa_horizontal, self.pfa_vertical
        # In the order of the kernel's fields.
        return RiskBudget(*map(float, (*shares, self.p_unmonitored, *self.tolerance_m)))


def support_in(file: str | Path) -> IntegritySupport:
    """Return the integrity support data in a TOML file, which gives every attribute by its name.

    Raises:
      InputError: no such file, not TOML, a name that is missing or unknown, or a wrong value.
    """
    remedy = "give each name of ju.typing.IntegritySupport a value"
    with readable(file, "integrity support data in TOML", remedy):
        values = tomllib.loads(Path(file).read_text(encoding="utf-8-sig"))
    names = [item.name for item in fields(IntegritySupport)]
    for name in values:
        one_of(f"a name in {str(file)!r}", name, names)
    missing = [name for name in names if name not in values]
    if missing:
        raise InputError(f"{str(file)!r} lacks {', '.join(missing)}: {remedy}")
    return IntegritySupport(**values)


@differentiable()
@typed
@dataclass(frozen=True)
class Protection:
    """Settings of the protection levels; the alert limits and probabilities are by default those of LPV-200.

    LPV-200 (ICAO Annex 10, table 3.7.2.4-1) has two further criteria that are not computed: an effective monitor
    threshold (EMT) of at most 15 m and a standard deviation of the vertical accuracy of at most 1.87 m. So a position
    within both alert limits need not meet LPV-200.

    Attributes:
      horizontal_alert_limit_m: the horizontal protection level at and above which m is 0.
      vertical_alert_limit_m: the vertical protection level up to which a position counts as available.
      isd: integrity support data, or a TOML file of it, which is read at once.

    Raises:
      InputError: a limit that is not positive, or a file that lacks a name of `IntegritySupport` or holds another.

    Examples:
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), protection=ju.metrics.Protection())
      >>> round(float(np.nanmin(made.m("hpl"))))  # metres
      15
    """

    horizontal_alert_limit_m: float = 40.0
    vertical_alert_limit_m: float = 35.0
    isd: IntegritySupport | str | Path = IntegritySupport()

    def __post_init__(self) -> None:
        """Check the limits and read the file; errors as of the class."""
        limits = "horizontal_alert_limit_m", "vertical_alert_limit_m"
        check_fields(self, limits, "positive metres", is_positive)
        if not isinstance(self.isd, IntegritySupport):
            object.__setattr__(self, "isd", support_in(self.isd))


L1_HZ, L5_HZ = 1575.42e6, 1176.45e6
# Of a range without ionosphere from those of two frequencies (Blanch et al. 2012, annex A).
IONOSPHERE_FREE = np.sqrt((L1_HZ**4 + L5_HZ**4) / (L1_HZ**2 - L5_HZ**2) ** 2)
GALILEO_STEP_DEG, GALILEO_FIRST_DEG = 5.0, 5.0
GALILEO_SIGMA_M = (  # from 5 to 90 degrees in steps of 5 (Blanch et al. 2015, table A.I)
    *(0.4529, 0.3553, 0.3063, 0.2638, 0.2593, 0.2555, 0.2504, 0.2438, 0.2396),
    *(0.2359, 0.2339, 0.2302, 0.2295, 0.2278, 0.2297, 0.2310, 0.2274, 0.2277),
)


def troposphere_sigma_m(elevation_rad: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Return the standard deviation of what a troposphere model leaves (RTCA DO-229D, A.4.2.4)."""
    return 0.12 * 1.001 / np.sqrt(0.002001 + np.sin(elevation_rad) ** 2)


def gps_receiver_sigma_m(elevation_rad: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Return the standard deviation of noise and of an airframe's multipath (Blanch et al. 2012, annex A)."""
    elevation_deg = np.degrees(elevation_rad)
    multipath_m = 0.13 + 0.53 * np.exp(-elevation_deg / 10)
    noise_m = 0.15 + 0.43 * np.exp(-elevation_deg / 6.9)
    return IONOSPHERE_FREE * np.hypot(multipath_m, noise_m)


def galileo_receiver_sigma_m(elevation_rad: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Return the standard deviation of a Galileo receiver's noise and multipath (Blanch et al. 2015, table A.I).

    It is linear between the table's elevations, and below the lowest of them as at that one.
    """
    table_deg = GALILEO_FIRST_DEG + GALILEO_STEP_DEG * np.arange(len(GALILEO_SIGMA_M))
    return np.interp(np.degrees(elevation_rad), table_deg, GALILEO_SIGMA_M)


def ranging_of(in_view: InView, isd: IntegritySupport) -> "Ranging":
    """Return the geometry and the errors of the ranges to ``S`` satellites, for the kernel: metres and probabilities.

    Only Galileo has errors of the receiver of its own; satellites of other constellations have those of GPS.

    Args:
      in_view: the satellites.
      isd: errors of orbits and clocks, biases, and probabilities of faults.
    """
    from jaxurban.kernels.protection import Ranging

    elevation_rad = np.asarray(in_view.elevation_rad, float)
    systems = np.asarray(in_view.systems, str)
    names, constellation = np.unique(systems, return_inverse=True)
    receiver_m = np.where(
        systems == "galileo",
        galileo_receiver_sigma_m(elevation_rad),
        gps_receiver_sigma_m(elevation_rad),
    )

    # The variance that the troposphere and the receiver leave, to which those of orbits and clocks are added.
    local_m2 = troposphere_sigma_m(elevation_rad) ** 2 + receiver_m**2
    num = len(systems)
    p_const = [isd.p_const_gps if name == "gps" else isd.p_const for name in names]
    return Ranging(
        unit_vectors(in_view.azimuth_rad, elevation_rad),
        constellation.astype(np.int64),
        np.sqrt(float(isd.sigma_ura_m) ** 2 + local_m2),
        np.sqrt(float(isd.sigma_ure_m) ** 2 + local_m2),
        np.full(num, float(isd.bias_m)),
        np.full(num, float(isd.p_sat)),
        np.array(p_const, float),
    )


def levels_of_satellites(
    in_view: InView, isd: IntegritySupport, patterns: UInt[np.ndarray, "W P"]
) -> np.ndarray:
    """Return ``[2, P]`` float64 the protection levels of P choices of satellites, horizontal and vertical, in metres.

    A level is inf where it is undetermined.

    Args:
      in_view: all satellites that may be chosen.
      isd: errors, biases and probabilities.
      patterns: the choices: satellite ``s`` is bit ``s % 32`` of word ``s // 32``.
    """
    from jaxurban.kernels.protection import protection_levels

    return protection_levels(patterns, ranging_of(in_view, isd), isd.budget)


def protection_maps(
    words: UInt[AnyArray, "W ..."],
    is_obstacle: Bool[AnyArray, "..."],
    in_view: InView,
    params: Protection,
) -> dict[str, np.ndarray]:
    """Return the protection maps of one time by variable: m, both levels, and where these are within their limits.

    Inside obstacles no satellite is seen; levels are inf there and wherever they are undetermined. No gradient.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
      is_obstacle: where nobody flies.
      in_view: the satellites.
      params: settings.
    """
    choices, number = distinct_choices(words, is_obstacle)
    hpl_m, vpl_m = levels_of_satellites(in_view, cast(IntegritySupport, params.isd), choices)
    limit_m = params.horizontal_alert_limit_m
    is_within = (hpl_m <= limit_m) & (vpl_m <= params.vertical_alert_limit_m)
    m = 1 - np.minimum(hpl_m, limit_m) / limit_m  # 0 from the limit up, and at HPL = inf
    by_choice = {METRIC.name: m, "hpl": hpl_m, "vpl": vpl_m, WITHIN_LIMITS: is_within}

    # Each cell gets the values of its choice, in the type of their variable.
    variables = METRIC.variables
    return {
        name: values.astype(variables[name].dtype)[number] for name, values in by_choice.items()
    }


WITHIN_LIMITS = "within_limits"
WITHIN = Variable(
    WITHIN_LIMITS,
    "both protection levels within their alert limits",
    dtype=np.uint8,
    inside=0,
    one_means="an HPL up to horizontal_alert_limit_m and a VPL up to vertical_alert_limit_m",
    classes=(("beyond an alert limit", "#d55e00"), ("within both alert limits", "#f4f4ee")),
)
CAVEAT = (
    "Protection levels of the satellites in line of sight, as if under open sky: no multipath and no reflections are "
    "in them. In a street canyon this is no integrity."
)


def _maps(scene: Scene, params: Protection) -> dict[str, np.ndarray]:
    """Return the maps of one time and altitude (`Metric.compute`)."""
    return protection_maps(scene.words, scene.is_obstacle, scene.in_view, params)


def _level(name: str, direction: str) -> Variable:
    """Return the variable of a protection level in metres, better the lower it is.

    Args:
      name: of the variable.
      direction: ``"horizontal"`` or ``"vertical"``.
    """
    return Variable(
        name,
        f"{direction} protection level",
        "m",
        inside=np.nan,
        scale=Scale("cividis_r", limit=f"{direction}_alert_limit_m", is_better_low=True),
        symbol=name.upper(),
        is_averaged=False,
    )


METRIC = Metric(
    name="protection",
    params=Protection,
    dims=(TIME, ALTITUDE),
    compute=_maps,
    cost=low_is_bad,
    label="Protection",
    cost_label="Lack of protection",
    one_means="an HPL of 0 m",
    colour="#332288",
    colour_map="cividis",
    also=(_level("hpl", "horizontal"), _level("vpl", "vertical"), WITHIN),
    available=WITHIN_LIMITS,
    recorded={name: name for name in ("horizontal_alert_limit_m", "vertical_alert_limit_m")},
    caveat=CAVEAT,
    cell_bytes=40,  # the distinct patterns at worst, their number in each cell, and one altitude's maps
)
