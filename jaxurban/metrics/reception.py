"""The chance that a receiver hears a satellite well, by its margin to a shadow's edge, as a receiver's log has it."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.checks import typed
from jaxurban.metrics.settings import check_fields, differentiable, is_positive


@differentiable("intercept", "slope", "scale_m", "cut_m")
@typed
@dataclass(frozen=True)
class ReceptionCurve:
    """The chance that a receiver hears a satellite well. A pytree; every leaf can be traced and differentiated by.

    ``P = 1 / (1 + exp(-intercept - slope x))``, ``x = sign(m) log(1 + |m| / scale)``, of the margin m that
    `ReceptionCurve.chance` describes, cut at ``cut_m`` to both sides.

    `ReceptionCurve.measured_in_tokyo` is one that is measured.

    Attributes:
      intercept: log odds at the edge.
      slope: log odds that one more of x adds.
      scale_m: margin about which x turns from linear to logarithmic.
      cut_m: margin from which on no more counts, and what a satellite has that no roof shadows.
      source: the log that the coefficients were fitted to.

    Raises:
      InputError: a coefficient that is not finite, or a slope, scale or cut that is not positive.

    Examples:
      >>> steep = ju.grad.ReceptionCurve(intercept=0.0, slope=1.5, scale_m=2.0, cut_m=60.0)
      >>> params = ju.grad.SoftParams(altitude_m=60.0, reception=steep)
      >>> soft = ju.grad.soft_city(city, maps.grid, params)
      >>> cells = np.array([[17, 15], [12, 12]])  # row, column
      >>> print(soft.layer("gps", soft.height_m, params, cells).round(2))
      [0.11 0.11]
    """

    intercept: Float[Array, "..."] | float
    slope: Float[Array, "..."] | float
    scale_m: Float[Array, "..."] | float
    cut_m: Float[Array, "..."] | float
    source: str = ""

    def __post_init__(self) -> None:
        """Check the numbers of the curve; errors as of the class."""
        check_fields(self, ["intercept"], "a finite number", np.isfinite)
        check_fields(self, ["slope"], "a positive number", is_positive)
        check_fields(self, ["scale_m", "cut_m"], "a positive number of metres", is_positive)

    @classmethod
    def measured_in_tokyo(cls) -> "ReceptionCurve":
        """Return the curve of one drive: the chance that a u-blox in a car received 35 dBHz or more.

        It is fitted to 251 s in Nihonbashi, Tokyo. In another city it kept the order and the ends, but said 0.44 near
        the edge where the share was 0.82. No flight has validated it.

        Returns:
          The curve, its log as the source.

        Examples:
          >>> curve = ju.grad.ReceptionCurve.measured_in_tokyo()
          >>> curve.intercept, curve.slope, curve.scale_m, curve.cut_m
          (-0.19, 0.64, 2.0, 60.0)
          >>> params = ju.grad.SoftParams(altitude_m=60.0, reception=curve)
          >>> soft = ju.grad.soft_city(city, maps.grid, params)
          >>> cells = np.array([[17, 15], [12, 12]])  # row, column
          >>> print(soft.layer("gps", soft.height_m, params, cells).round(2))
          [0.14 0.13]
        """
        source = "taroz/ge-gnss-visibility 58e26fe, data/kinematic: u-blox in a car, Nihonbashi, 251 s, 2023-06-22"
        return cls(intercept=-0.19, slope=0.64, scale_m=2.0, cut_m=60.0, source=source)

    def chance(self, margin_m: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the chance at a margin; differentiable at the edge too, with a derivative of 0 beyond the cut.

        Args:
          margin_m: height of the antenna less that of the edge of the roofs' shadow, positive where the satellite is in
            view; of any shape. Inf where no roof shadows it.

        Returns:
          The chances, 0 to 1, in the shape and type of the margins.

        Examples:
          >>> margin_m = np.array([-40.0, -1.0, 0.0, 1.0, 40.0, np.inf])
          >>> print(np.asarray(ju.grad.ReceptionCurve.measured_in_tokyo().chance(margin_m)).round(2))
          [0.11 0.39 0.45 0.52 0.85 0.88]
        """
        margin = jnp.asarray(margin_m)
        leaves = (self.intercept, self.slope, self.scale_m, self.cut_m)
        intercept, slope, scale, cut = (jnp.asarray(leaf, margin.dtype) for leaf in leaves)
        margin = jnp.clip(margin, -cut, cut)
        # Not jnp.sign, which is 0 at the edge, so that the derivative there would be lost.
        side = jnp.where(margin < 0, -1, 1).astype(margin.dtype)
        return jax.nn.sigmoid(intercept + slope * side * jnp.log(1 + side * margin / scale))
