"""How well a dual-frequency aviation receiver under open sky ranges to satellites, by their elevation."""

import numpy as np
from jaxtyping import Float

from jaxurban.kernels.dop import unit_vectors
from jaxurban.kernels.protection import Ranging
from jaxurban.metrics.protection.params import ProtectionParams
from jaxurban.world.sky import InView

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
    """Return the same for Galileo, linear between the table's elevations; below the lowest as there."""
    at_deg = GALILEO_FIRST_DEG + GALILEO_STEP_DEG * np.arange(len(GALILEO_SIGMA_M))
    return np.interp(np.degrees(elevation_rad), at_deg, GALILEO_SIGMA_M)


def ranging_of(in_view: InView, params: ProtectionParams) -> Ranging:
    """Return what is known of the ranges to satellites; constellations other than Galileo range as GPS does."""
    elevation_rad, systems = np.asarray(in_view.elevation_rad, float), np.asarray(in_view.systems, str)
    names, constellation = np.unique(systems, return_inverse=True)
    receiver_m = np.where(
        systems == "galileo", galileo_receiver_sigma_m(elevation_rad), gps_receiver_sigma_m(elevation_rad)
    )
    local_m2 = troposphere_sigma_m(elevation_rad) ** 2 + receiver_m**2
    num = len(systems)
    return Ranging(
        unit_vectors(in_view.azimuth_rad, elevation_rad),
        constellation.astype(np.int64),
        np.sqrt(float(params.sigma_ura_m) ** 2 + local_m2),
        np.sqrt(float(params.sigma_ure_m) ** 2 + local_m2),
        np.full(num, float(params.bias_m)),
        np.full(num, float(params.p_sat)),
        np.array([float(params.p_const_gps if name == "gps" else params.p_const) for name in names]),
    )
