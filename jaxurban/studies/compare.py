"""Example routes beside the routes that weights lead to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from jaxurban.cost import Weights
from jaxurban.studies.examples import Example, optimal_examples


@dataclass(frozen=True, eq=False)
class Comparison:
    """Routes under weights, beside the examples that have the same ends.

    Attributes:
      examples: as given.
      planned: the cheapest routes under the weights.
      table: a row an example: where it lies, ``length_m`` and the mean of each metric along it, the same of the planned
        route (``planned_length_m`` ...), and ``overlap``, the share of the example's cells that the planned route
        shares.
    """

    examples: tuple[Example, ...]
    planned: tuple[Example, ...]
    table: pd.DataFrame


def compare(examples: Sequence[Example], weights: Weights) -> Comparison:
    """Return each example beside the cheapest route under weights between its ends."""
    planned = optimal_examples([example.query for example in examples], weights)
    rows = []
    for number, (given, found) in enumerate(zip(examples, planned, strict=True), start=1):
        unit = given.query.unit
        rows.append(
            {
                "name": given.query.name or f"{number}",
                "altitude_m": unit.altitude_m,
                "time": unit.time,
                "time_of_day": unit.time_of_day,
                **_means(given, ""),
                **_means(found, "planned_"),
                "overlap": _overlap(given, found),
                "note": given.note,
            }
        )
    return Comparison(tuple(examples), tuple(planned), pd.DataFrame(rows))


def _means(example: Example, prefix: str) -> dict[str, float]:
    length_m, *sums = example.route.integrals.tolist()
    means = {
        f"{prefix}mean_{name}": value / length_m for name, value in zip(example.query.unit.names, sums, strict=True)
    }
    return {f"{prefix}length_m": length_m, **means}


def _overlap(given: Example, found: Example) -> float:
    cells, others = (
        {tuple(cell) for cell in np.floor(route.points_m / route.query.unit.grid.resolution_m).astype(int).tolist()}
        for route in (given, found)
    )
    return len(cells & others) / len(cells)
