"""Demonstrations beside the routes that weights lead to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from jaxurban.metrics.weights import Weights
from jaxurban.studies.demonstrations import Demonstration, optimal_demonstrations


@dataclass(frozen=True, eq=False)
class PlannedBeside:
    """Routes under weights, beside the demonstrations that have the same ends.

    Attributes:
      demonstrations: as given.
      planned: the cheapest routes under the weights.
      table: a row a demonstration: where it lies, ``length_m`` and the mean of each metric along it, the same of the
        planned route (``planned_length_m`` ...), and ``overlap``, the share of the demonstration's cells that the
        planned route shares.
    """

    demonstrations: tuple[Demonstration, ...]
    planned: tuple[Demonstration, ...]
    table: pd.DataFrame


def plan_beside(demonstrations: Sequence[Demonstration], weights: Weights) -> PlannedBeside:
    """Return each demonstration beside the cheapest route under weights between its ends."""
    planned = optimal_demonstrations([each.query for each in demonstrations], weights)
    rows = []
    for number, (given, found) in enumerate(zip(demonstrations, planned, strict=True), start=1):
        on = given.query.cost_map
        cells = _cells(given)
        rows.append(
            {
                "name": given.query.name or f"{number}",
                "altitude_m": on.altitude_m,
                "time": on.time,
                "time_of_day": on.time_of_day,
                **_means(given, ""),
                **_means(found, "planned_"),
                "overlap": len(cells & _cells(found)) / len(cells),
                "note": given.note,
            }
        )
    return PlannedBeside(tuple(demonstrations), tuple(planned), pd.DataFrame(rows))


def _means(route: Demonstration, prefix: str) -> dict[str, float]:
    length_m, *sums = route.sums[1].tolist()
    means = zip(route.query.cost_map.names, sums, strict=True)
    return {f"{prefix}length_m": length_m} | {f"{prefix}mean_{name}": value / length_m for name, value in means}


def _cells(route: Demonstration) -> set[tuple[int, int]]:
    return cells_of(route.points_m, route.query.cost_map.grid.resolution_m)


def cells_of(points_m: np.ndarray, resolution_m: float) -> set[tuple[int, int]]:
    """Return the cells, column and row, of points ``[N, 2]`` in metres from the map's southwest corner."""
    return set(map(tuple, np.floor(points_m / resolution_m).astype(int).tolist()))
