"""Which weights examples cannot tell apart."""

from collections.abc import Sequence

import numpy as np

from jaxurban.studies.pool import NOT_A_ROUTE, RoutePool
from jaxurban.studies.queries import Query

FLAT = 1e-6  # a layer that varies by less over free cells is constant
NEAR_OPTIMAL = 0.1  # routes within this share of the cheapest are those that weights choose between
UNSEEN = 1e-6  # of the largest variance: a direction of W with less leaves every comparison as it is
MUCH = 0.1  # of the largest: a weight with such a part in a direction belongs to it
LEAST_SHARE = 0.01


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


def feature_units(queries: Sequence[Query], demo: np.ndarray) -> np.ndarray:
    """Return ``[K]`` the size of each feature: its mean over examples, never under 1 % of a random walk's as long.

    The floor keeps weights finite where every example avoids a cost altogether.
    """
    num_steps = demo[:, 0].mean() / queries[0].unit.grid.resolution_m
    if queries[0].unit.cost_model.kind == "line":
        num_steps = demo[:, 0].mean() / queries[0].unit.cost_model.reference_length_m
    units = {id(query.unit): query.unit for query in queries}.values()
    usual = np.mean([unit.layers[:, unit.is_free].mean(axis=1) for unit in units], axis=0) * num_steps
    return np.maximum(demo.mean(axis=0), np.append(0.0, np.maximum(LEAST_SHARE * usual, 1e-12)))


def tradeoff_covariance(pool: RoutePool, unit: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``[K, K]`` the covariance of what routes that compete with the cheapest have more or less of each feature.

    A direction v with v C v = 0 can be added to W without changing any comparison between these routes.

    Args:
      pool: the routes.
      unit: ``[K]`` in which features are counted, and 1 / weights.
      weights: ``[K]`` W of features in their own units.
    """
    routes = pool.features
    cost = np.where(routes[..., 0] < NOT_A_ROUTE, routes @ weights, np.inf)
    competes = cost <= cost.min(axis=1, keepdims=True) * (1 + NEAR_OPTIMAL)
    cheapest = np.take_along_axis(routes, cost.argmin(axis=1)[:, None, None], axis=1)
    more = ((routes - cheapest) / unit)[competes]
    return more.T @ more / max(len(more), 1)


def indistinct_weights(covariance: np.ndarray, names: Sequence[str]) -> list[str]:
    """Return sentences on the directions of W, but its length, that examples say nothing about.

    Args:
      covariance: ``[K, K]`` from `tradeoff_covariance`.
      names: ``[K]``.
    """
    least = UNSEEN * max(float(np.max(np.diag(covariance))), 1e-300)
    is_seen = np.diag(covariance) > least
    sentences = [
        f"The weight of {name} cannot be identified: no competing route differs in it."
        for name, is_one in zip(names, is_seen, strict=True)
        if not is_one
    ]
    kept = [name for name, is_one in zip(names, is_seen, strict=True) if is_one]
    if len(kept) < 2:
        return sentences
    values, directions = np.linalg.eigh(covariance[np.ix_(is_seen, is_seen)])
    unseen = directions[:, values <= UNSEEN * values[-1]]
    if num := unseen.shape[1]:
        part = np.linalg.norm(unseen, axis=1)
        involved = [name for name, size in zip(kept, part, strict=True) if size > MUCH * part.max()]
        listed = f"{', '.join(involved[:-1])} and {involved[-1]}"
        why = "competing routes trade them at one rate" if num == 1 else f"{num} of their mixtures change no comparison"
        sentences.append(f"The weights of {listed} cannot be told apart: {why}.")
    return sentences
