"""Targets: bounds on what routes add up to, averaged over queries."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.errors import InputError, nearest_name, typed
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import AnyArray

MEAN = "mean_"  # of a metric along a route


def target_outcomes(metrics: Iterable[str] = METRICS) -> tuple[str, ...]:
    """Return the outcomes that targets may bound on maps of these metrics (see `Target`)."""
    return ("detour", "length_m", "people", *(f"{MEAN}{name}" for name in metrics))


@typed
@dataclass(frozen=True)
class Target:
    """A bound on an outcome of routes, averaged over a set of queries.

    Attributes:
      outcome: one of `target_outcomes`. ``detour``: mean of length over the shortest route's, less 1. ``mean_gps`` and
        the like: mean over queries of the mean m along the route. ``people``: sum over queries of the
        integral of m_population along the route, as a share of the shortest routes'. ``length_m``: mean length.
      sense: ``">="`` or ``"<="``.
      value: the bound.
    """

    outcome: str
    sense: str
    value: float

    def __post_init__(self) -> None:
        if not self.outcome.startswith(MEAN):
            self.checked()
        if self.sense not in (">=", "<="):
            raise InputError(f"a target's sense must be '>=' or '<=', got {self.sense!r}")
        if not np.isfinite(self.value):
            raise InputError(f"target {str(self)!r} must end in a finite number")
        least, most = (0.0, 1.0) if self.outcome.startswith(MEAN) else (0.0, np.inf)
        if (self.sense == ">=" and self.value > most) or (self.sense == "<=" and self.value < least):
            raise InputError(f"target {str(self)!r} cannot be met: {self.outcome} lies between {least:g} and {most:g}")

    @classmethod
    @typed
    def parse(cls, text: str, metrics: Iterable[str] = METRICS) -> "Target":
        """Return the target in ``"mean_gps>=0.8"``; ``metrics`` are those that may be named.

        Raises:
          InputError: another form, an unknown outcome, or a value that is not a number.
        """
        match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(\S+)\s*", text)
        if not match:
            raise InputError(f"target {text!r} must read like mean_gps>=0.8 or detour<=0.15")
        outcome, sense, number = match.groups()
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        return cls(outcome, sense, value).checked(metrics)

    def checked(self, metrics: Iterable[str] = METRICS) -> "Target":
        """Return the same target.

        Raises:
          InputError: it bounds no outcome of maps of these metrics (names the nearest one).
        """
        outcomes = target_outcomes(metrics)
        if self.outcome not in outcomes:
            raise InputError(
                f"unknown outcome {self.outcome!r}{nearest_name(self.outcome, outcomes)}: choose one of "
                f"{', '.join(outcomes)}"
            )
        return self

    @property
    def metric(self) -> str | None:
        """The metric that the outcome is of; None for lengths."""
        if self.outcome.startswith(MEAN):
            return self.outcome.removeprefix(MEAN)
        return "population" if self.outcome == "people" else None

    def __str__(self) -> str:
        return f"{self.outcome} {self.sense} {self.value:g}"


def outcome_values(
    sums: Float[AnyArray, "Q J"], shortest: Float[AnyArray, "Q J"], names: Sequence[str], targets: Sequence[Target]
) -> Float[Array, " N"]:
    """Return the targets' outcomes of routes.

    Args:
      sums: features and integrals ``[Q, 2 K]`` of the routes.
      shortest: those of the shortest routes.
      names: ``[K]`` the weights.
      targets: ``[N]``.
    """
    num = len(names)
    length_m, base_m = sums[:, num], shortest[:, num]
    values = []
    for target in targets:
        if target.metric is None:
            values.append(jnp.mean(length_m) if target.outcome == "length_m" else jnp.mean(length_m / base_m) - 1)
            continue
        along, base = (each[:, num + list(names).index(target.metric)] for each in (sums, shortest))
        is_share = target.outcome == "people"
        values.append(jnp.sum(along) / jnp.maximum(jnp.sum(base), 1e-9) if is_share else jnp.mean(along / length_m))
    return jnp.stack(values)
