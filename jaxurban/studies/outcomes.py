"""What matters about a route, from what it adds up: its length, the quality along it, and the population crossed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxurban.metrics.base import Metric
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import AnyArray

LENGTH, PEOPLE = "length_m", "people"
PLAIN = {LENGTH: ("length", "m"), PEOPLE: ("population crossed", "m at the highest density")}  # label, unit


def outcome_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the outcomes of routes on maps with these weights (``"distance"`` and metrics)."""
    return tuple({"distance": LENGTH, "population": PEOPLE}.get(name, f"mean_{name}") for name in names)


def outcome_label(outcome: str, metrics: Mapping[str, Metric] = METRICS) -> str:
    """Return what tables and figures call an outcome of maps that hold these metrics."""
    metric = outcome.removeprefix("mean_")
    return PLAIN[outcome][0] if outcome in PLAIN else metrics[metric].label if metric in metrics else metric


def outcome_unit(outcome: str) -> str:
    """Return the unit of an outcome."""
    return PLAIN[outcome][1] if outcome in PLAIN else "mean m along the route"


def outcomes_of(integrals: Float[AnyArray, "*N K"], names: Sequence[str]) -> dict[str, Any]:
    """Return each outcome ``[*N]`` of routes with these integrals (see `RouteQuery.sums`), in the order of the weights.

    ``length_m``; ``mean_gps`` and the like, the mean of m along the route by length; ``people``, the integral of
    m_population along the route: proportional to the people under a strip of any width. NumPy or JAX.
    """
    length_m = integrals[..., 0]
    return {
        outcome: integrals[..., k] if outcome in (LENGTH, PEOPLE) else integrals[..., k] / length_m
        for k, outcome in enumerate(outcome_names(names))
    }


def cluster_routes(values: np.ndarray, sizes: np.ndarray, first: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[N]`` the cluster of each route, and ``[M]`` the route that represents each, ``M <= most``.

    Clusters are as different as can be: each begins with the route least like all before it (farthest-point
    clustering; Gonzalez 1985), and the others join the most alike. Cluster 0 is that of ``first``, which represents it;
    the route of the largest cell represents each other cluster.

    Args:
      values: ``[N, J]`` by which routes are compared, each in units of its spread.
      sizes: ``[N]`` of the routes' cells.
      first: number of a route.
      most: clusters.
    """
    spread = values.std(axis=0)
    scaled = values / np.where(spread > 0, spread, 1.0)
    seeds = [first]
    apart = np.linalg.norm(scaled - scaled[first], axis=1)
    cluster = np.zeros(len(values), int)
    while len(seeds) < most and apart.max() > 0:
        seeds.append(int(apart.argmax()))
        away = np.linalg.norm(scaled - scaled[seeds[-1]], axis=1)
        cluster = np.where(away < apart, len(seeds) - 1, cluster)
        apart = np.minimum(apart, away)
    largest = [int(np.argmax(np.where(cluster == k, sizes, -1.0))) for k in range(1, len(seeds))]
    return cluster, np.array([first, *largest])
