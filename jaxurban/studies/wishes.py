"""Wishes: bounds on what routes add up to, averaged over queries."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.cost import METRICS, AnyArray
from jaxurban.errors import InputError, nearest_name

OUTCOMES = ("detour", "length_m", "people", *(f"mean_{name}" for name in METRICS))


@dataclass(frozen=True)
class Wish:
    """A bound on an outcome of routes, averaged over a set of queries.

    Attributes:
      outcome: one of `OUTCOMES`. ``detour``: mean of length over the shortest route's, less 1. ``mean_gps`` and
        the like: mean over queries of the mean m along the route. ``people``: sum over queries of the
        integral of m_population along the route, as a share of the shortest routes'. ``length_m``: mean length.
      sense: ``">="`` or ``"<="``.
      value: the bound.
    """

    outcome: str
    sense: str
    value: float

    def __post_init__(self) -> None:
        if self.outcome not in OUTCOMES:
            raise InputError(
                f"unknown outcome {self.outcome!r}{nearest_name(self.outcome, OUTCOMES)}: choose one of "
                f"{', '.join(OUTCOMES)}"
            )
        if self.sense not in (">=", "<="):
            raise InputError(f"a wish's sense must be '>=' or '<=', got {self.sense!r}")
        if not np.isfinite(self.value):
            raise InputError(f"wish {str(self)!r} must end in a finite number")
        least, most = (0.0, 1.0) if self.outcome.startswith("mean_") else (0.0, np.inf)
        if (self.sense == ">=" and self.value > most) or (self.sense == "<=" and self.value < least):
            raise InputError(f"wish {str(self)!r} cannot be met: {self.outcome} lies between {least:g} and {most:g}")

    @classmethod
    def parse(cls, text: str) -> "Wish":
        """Return the wish in ``"mean_gps>=0.8"``.

        Raises:
          InputError: another form, an unknown outcome, or a value that is no number.
        """
        match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(\S+)\s*", text)
        if not match:
            raise InputError(f"wish {text!r} must read like mean_gps>=0.8 or detour<=0.15")
        outcome, sense, number = match.groups()
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        return cls(outcome, sense, value)

    def __str__(self) -> str:
        return f"{self.outcome} {self.sense} {self.value:g}"


def outcome_values(
    sums: Float[AnyArray, "Q J"], shortest: Float[AnyArray, "Q J"], names: Sequence[str], outcomes: Sequence[str]
) -> Float[Array, " N"]:
    """Return outcomes of routes from their features and integrals ``[Q, 2 K]``, beside the shortest routes' sums."""
    num = len(names)
    length, base = sums[:, num], shortest[:, num]
    values = []
    for outcome in outcomes:
        if outcome == "detour":
            values.append(jnp.mean(length / base) - 1)
        elif outcome == "length_m":
            values.append(jnp.mean(length))
        elif outcome == "people":
            column = num + list(names).index("population")
            values.append(jnp.sum(sums[:, column]) / jnp.maximum(jnp.sum(shortest[:, column]), 1e-9))
        else:
            column = num + list(names).index(outcome.removeprefix("mean_"))
            values.append(jnp.mean(sums[:, column] / length))
    return jnp.stack(values)
