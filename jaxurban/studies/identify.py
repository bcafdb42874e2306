"""Which weights examples cannot tell apart."""

from collections.abc import Sequence

import numpy as np

from jaxurban.studies.pool import NOT_A_ROUTE, RoutePool
from jaxurban.studies.queries import Query

FLAT = 1e-6  # a layer that varies by less over free cells is constant
NEAR_OPTIMAL = 0.1  # routes within this share of the cheapest are those that weights choose between
UNSEEN = 1e-4  # of the largest eigenvalue: a direction of W with less leaves every comparison as it is
MUCH = 0.5  # of the largest: a weight with such a part in a direction belongs to it


def constant_layers(queries: Sequence[Query]) -> tuple[str, ...]:
    """Return the metrics whose cost is the same over all free cells of all the queries' maps."""
    names = queries[0].unit.names
    units = {id(query.unit): query.unit for query in queries}.values()
    flat = []
    for layer, name in enumerate(names):
        free = [unit.layers[layer][unit.is_free] for unit in units]
        low, high = min(values.min() for values in free), max(values.max() for values in free)
        if high - low < FLAT:
            flat.append(name)
    return tuple(flat)


def tradeoff_covariance(pool: RoutePool, demo: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``[K, K]`` the covariance of what routes that compete with the examples have more or less of each feature.

    Features are in units of their means over the examples. A direction v with v C v = 0 can be added to W without
    changing any comparison between these routes.
    """
    unit = np.maximum(demo.mean(axis=0), 1e-12)
    routes = pool.features
    cost = np.where(routes[..., 0] < NOT_A_ROUTE, routes @ weights, np.inf)
    competes = cost <= cost.min(axis=1, keepdims=True) * (1 + NEAR_OPTIMAL)
    cheapest = np.take_along_axis(routes, cost.argmin(axis=1)[:, None, None], axis=1)
    more = ((routes - cheapest) / unit)[competes]
    return more.T @ more / max(len(more), 1)


def indistinct_weights(
    pool: RoutePool, demo: np.ndarray, weights: np.ndarray, names: Sequence[str], fitted: np.ndarray
) -> list[str]:
    """Return a sentence for each direction of W, but its length, that the examples say nothing about."""
    unit = np.maximum(demo.mean(axis=0), 1e-12)[fitted]
    kept = [name for name, is_fitted in zip(names, fitted, strict=True) if is_fitted]
    covariance = tradeoff_covariance(pool, demo, weights)[np.ix_(fitted, fitted)]
    # W itself is no direction to find: only its length lies along it.
    along = weights[fitted] * unit
    along /= np.linalg.norm(along)
    across = np.eye(len(kept)) - np.outer(along, along)
    values, directions = np.linalg.eigh(across @ covariance @ across)
    sentences = []
    for value, direction in list(zip(values, directions.T, strict=True)):
        if abs(direction @ along) > 0.99 or value > UNSEEN * max(values[-1], 1e-300):
            continue
        part = np.abs(direction)
        involved = [name for name, size in zip(kept, part, strict=True) if size > MUCH * part.max()]
        if len(involved) == 1:
            sentences.append(f"The weight of {involved[0]} cannot be identified: no competing route differs in it.")
        else:
            sentences.append(
                f"The weights of {', '.join(involved[:-1])} and {involved[-1]} cannot be told apart: competing routes "
                "trade them at one rate."
            )
    return sentences
