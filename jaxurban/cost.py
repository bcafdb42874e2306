"""Weights and cost maps: what a path pays for the metrics of the cells it crosses."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError, nearest_name

AnyArray = Array | np.ndarray
METRICS = ("gps", "lidar", "population", "risk")  # the layers of the cost, in the paper's order
MOST_WEIGHT = 1e30  # no path's cost overflows up to here, not even in float32


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Weights:
    """The paper's W: cost per metre, and cost per step (or per reference length) of each metric's cost.

    Attributes:
      distance: w_0, cost per metre of path.
      gps, lidar, population, risk: weight of each metric's cost c in [0, 1].
    """

    distance: float | jax.Array = 0.1
    gps: float | jax.Array = 1.0
    lidar: float | jax.Array = 1.0
    population: float | jax.Array = 1.0
    risk: float | jax.Array = 1.0

    @classmethod
    def parse(cls, text: str, base: "Weights | None" = None) -> "Weights":
        """Return the weights in ``"gps=1,risk=2"``; those not named are taken from ``base``.

        Raises:
          InputError: an unknown name, or a value that is not a number >= 0.
        """
        values = asdict(base or cls())
        for part in filter(None, (item.strip() for item in text.split(","))):
            name, _, number = (item.strip() for item in part.partition("="))
            if name not in values:
                hint = nearest_name(name, values) or f": the weights are {', '.join(values)}"
                raise InputError(f"unknown weight {name!r}{hint}")
            try:
                values[name] = float(number)
            except ValueError as error:
                raise InputError(f"weight {part!r} must read name=number, as in gps=1,risk=0.5") from error
        return cls(**values).checked()

    def checked(self) -> "Weights":
        """Return the same weights as floats.

        Raises:
          InputError: a weight that is negative, above `MOST_WEIGHT` or not finite.
        """
        values = {item.name: float(getattr(self, item.name)) for item in fields(self)}
        for name, value in values.items():
            if not 0 <= value <= MOST_WEIGHT:
                raise InputError(f"weight {name} must be a finite number >= 0, at most {MOST_WEIGHT:g}, got {value}")
        return Weights(**values)


def metric_cost(name: str, m: Float[AnyArray, "*cells"]) -> Float[AnyArray, "*cells"]:
    """Return the cost c in [0, 1] of a metric m: c = m for population, c = 1 - m for the others.

    Raises:
      InputError: not one of the four cost metrics.
    """
    if name not in METRICS:
        raise InputError(f"{name!r} is no metric of the cost{nearest_name(name, METRICS)}: use {', '.join(METRICS)}")
    return m if name == "population" else 1.0 - m


def cost_map(costs: Mapping[str, Float[AnyArray, "Y X"]], weights: Weights) -> Float[Array, "Y X"]:
    """Return the weighted sum of cost layers, the sum over j of w_j c_j (Eq. c_cost_fun without distance)."""
    return sum((getattr(weights, name) * jnp.asarray(cost) for name, cost in costs.items()), jnp.zeros(()))


def total_map(costs: Mapping[str, Float[AnyArray, "Y X"]]) -> Float[Array, "Y X"]:
    """Return H_total, the unweighted sum of the cost layers."""
    return sum((jnp.asarray(cost) for cost in costs.values()), jnp.zeros(()))


def normalised_map(total: Float[Array, "Y X"], is_free: Array) -> Float[Array, "Y X"]:
    """Return H_norm: ``total`` brought to [0, 1] by its minimum and maximum over free cells.

    NaN outside free cells; 0 everywhere where the total is constant.
    """
    low = jnp.min(jnp.where(is_free, total, jnp.inf))
    high = jnp.max(jnp.where(is_free, total, -jnp.inf))
    span = jnp.where(high > low, high - low, 1.0)
    return jnp.where(is_free, (total - low) / span, jnp.nan)
