"""What matters about a route, from what it adds up: its length, the quality along it, and people."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxurban.cost import AnyArray

UNITS = {  # of each outcome, for tables and figures
    "length_m": "m",
    "mean_gps": "mean m along the route",
    "mean_lidar": "mean m along the route",
    "people": "m at the highest density",
    "mean_risk": "mean m along the route",
}


def outcome_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the outcomes of routes on maps with these weights (``"distance"`` and metrics)."""
    return tuple({"distance": "length_m", "population": "people"}.get(name, f"mean_{name}") for name in names)


def outcomes_of(integrals: Float[AnyArray, "*N K"], names: Sequence[str]) -> dict[str, Any]:
    """Return each outcome ``[*N]`` of routes with these integrals (see `RouteFacts`), in the order of the weights.

    ``length_m``; ``mean_gps`` and the like, the mean of m along the route by length; ``people``, the integral of
    m_population along the route: proportional to the people under a strip of any width. NumPy or JAX.
    """
    length_m = integrals[..., 0]
    along = np.array([name not in ("distance", "population") for name in names])
    return {
        outcome: integrals[..., k] / length_m if along[k] else integrals[..., k]
        for k, outcome in enumerate(outcome_names(names))
    }
