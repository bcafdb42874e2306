"""Settings of the protection levels: alert limits, range errors, fault probabilities and how risk is shared out."""

from dataclasses import dataclass

from jaxurban.errors import InputError, typed
from jaxurban.kernels.protection import RiskBudget
from jaxurban.metrics.settings import check_value, differentiable


@differentiable()
@typed
@dataclass(frozen=True)
class ProtectionParams:
    """Settings of the protection levels; the alert limits and probabilities are by default those of LPV-200.

    LPV-200 has two further criteria that are not computed: an effective monitor threshold (EMT) of at most 15 m and a
    standard deviation of the vertical accuracy of at most 1.87 m. So a position within both alert limits need not
    meet LPV-200.

    Sources: Blanch et al. 2015 (IEEE Trans. AES 51) and EU-US Working Group C, ARAIM Milestone 3 report (2016) for
    errors, faults and budget; ICAO Annex 10, table 3.7.2.4-1 (LPV-200) for the alert limits; the GPS SPS performance
    standard (2020) for ``p_const_gps``.

    Attributes:
      horizontal_alert_limit_m: the horizontal protection level at and above which m is 0.
      vertical_alert_limit_m: the vertical protection level up to which a position counts as available.
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
    """

    horizontal_alert_limit_m: float = 40.0
    vertical_alert_limit_m: float = 35.0
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
        lengths = ("horizontal_alert_limit_m", "vertical_alert_limit_m", "sigma_ura_m", "sigma_ure_m", "tolerance_m")
        for name in lengths:
            check_value(name, getattr(self, name), "positive metres", lambda length_m: length_m > 0)
        check_value("bias_m", self.bias_m, "0 or more metres", lambda bias_m: bias_m >= 0)
        for name in ("p_sat", "p_const_gps", "p_const", "p_unmonitored"):
            check_value(name, getattr(self, name), "a probability from 0 to below 0.1", lambda p: (p >= 0) & (p < 0.1))
        for name in ("phmi_horizontal", "phmi_vertical", "pfa_horizontal", "pfa_vertical"):
            check_value(
                name, getattr(self, name), "a probability from 1e-15 to 0.1", lambda p: (p >= 1e-15) & (p <= 0.1)
            )
        if len(self.tolerance_m) != 2:
            raise InputError(
                f"tolerance_m must be two numbers of metres such as [0.05, 0.0001], got {self.tolerance_m}"
            )

    @property
    def budget(self) -> RiskBudget:
        """How risk is shared out, for the kernel."""
        shares = self.phmi_horizontal, self.phmi_vertical, self.pfa_horizontal, self.pfa_vertical
        return RiskBudget(*map(float, (*shares, self.p_unmonitored, *self.tolerance_m)))
