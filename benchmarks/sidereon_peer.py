"""Protection levels by sidereon, a library of its own, a call for each choice of satellites."""

from collections.abc import Sequence

import numpy as np
import sidereon

from jaxurban.kernels.protection import Ranging, RiskBudget

SYSTEMS = {
    "gps": sidereon.GnssSystem.GPS,
    "galileo": sidereon.GnssSystem.GALILEO,
    "qzss": sidereon.GnssSystem.QZSS,
}
# A receiver on the equator at Greenwich, whose up, east and north are the axes of the Earth.
RECEIVER = sidereon.Wgs84Geodetic(0.0, 0.0, 0.0)
P_EMT = 1e-5  # does not enter the levels
MOST_FAULTS = 2  # at once, in a fault mode


class Peer:
    """The same satellites and budget as the kernel has, in the library's own types."""

    def __init__(self, ranging: Ranging, systems: Sequence[str], budget: RiskBudget) -> None:
        counts: dict[str, int] = {}
        self._rows, satellites, self._systems = [], [], [SYSTEMS[name] for name in systems]
        for s, (name, system) in enumerate(zip(systems, self._systems, strict=True)):
            counts[name] = counts.get(name, 0) + 1
            label = f"{system.letter}{counts[name]:02d}"
            east, north, up = ranging.directions[s]
            elevation_rad = float(np.arcsin(np.clip(up, -1, 1)))
            self._rows.append(
                sidereon.AraimRow(label, np.array([up, east, north]), elevation_rad, system)
            )
            values = (
                ranging.bias_m[s],
                ranging.p_sat[s],
                ranging.sigma_int_m[s],
                ranging.sigma_acc_m[s],
            )
            satellites.append(
                sidereon.SatelliteIsm.new_with_effective_sigmas(
                    label, 1.0, 1.0, *map(float, values)
                )
            )
        first = {system: s for s, system in reversed(list(enumerate(self._systems)))}
        constellations = [
            sidereon.ConstellationIsm(
                system,
                float(ranging.p_const[ranging.constellation[s]]),
                sidereon.SatelliteIsmModel(1.0, 1.0, 0.0, 0.0),
            )
            for system, s in first.items()
        ]
        self._ism = sidereon.Ism(constellations, satellites)
        phmi = budget.phmi_horizontal + budget.phmi_vertical
        shares = (
            budget.phmi_vertical,
            budget.phmi_horizontal,
            budget.pfa_vertical,
            budget.pfa_horizontal,
        )
        self._budget = sidereon.IntegrityAllocation(
            phmi, *shares, budget.p_unmonitored, MOST_FAULTS, P_EMT
        )

    def levels(self, patterns: np.ndarray) -> np.ndarray:
        """Return ``[2, P]`` horizontal and vertical levels of patterns ``[W, P]``, inf where it gives none."""
        words = np.repeat(patterns, 32, axis=0)[: len(self._rows)]
        is_seen = (words >> (np.arange(len(words), dtype=np.uint32) % 32)[:, None]) & 1 == 1
        return np.array([self._levels_of(np.flatnonzero(seen)) for seen in is_seen.T]).T.reshape(
            2, -1
        )

    def _levels_of(self, seen: np.ndarray) -> tuple[float, float]:
        clocks = list(dict.fromkeys(self._systems[s] for s in seen))
        try:
            geometry = sidereon.AraimGeometry([self._rows[s] for s in seen], RECEIVER, clocks)
            found = sidereon.araim(geometry, self._ism, self._budget)
        except ValueError as error:
            if "insufficient ARAIM geometry" in str(error):
                return np.inf, np.inf
            raise
        return found.hpl_m, found.vpl_m
