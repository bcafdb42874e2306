"""Routes sorted into a few kinds, so that a picture of hundreds can be read."""

import numpy as np


def sort_into_kinds(values: np.ndarray, sizes: np.ndarray, first: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[N]`` the kind of each route, and ``[M]`` the route that stands for each kind, ``M <= most``.

    Kinds are as different as can be: each begins with the route least like all before it (farthest-point
    clustering; Gonzalez 1985), and the others join the most alike. Kind 0 is that of ``first``, which stands for it;
    the route of the largest cell stands for each other kind.

    Args:
      values: ``[N, J]`` by which routes are compared, each in units of its spread.
      sizes: ``[N]`` of the routes' cells.
      first: number of a route.
      most: kinds.
    """
    spread = values.std(axis=0)
    scaled = values / np.where(spread > 0, spread, 1.0)
    seeds = [first]
    apart = np.linalg.norm(scaled - scaled[first], axis=1)
    kind = np.zeros(len(values), int)
    while len(seeds) < most and apart.max() > 0:
        seeds.append(int(apart.argmax()))
        away = np.linalg.norm(scaled - scaled[seeds[-1]], axis=1)
        kind = np.where(away < apart, len(seeds) - 1, kind)
        apart = np.minimum(apart, away)
    standing = [first, *(int(np.argmax(np.where(kind == k, sizes, -1.0))) for k in range(1, len(seeds)))]
    return kind, np.array(standing)
