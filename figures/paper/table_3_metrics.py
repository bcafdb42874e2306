"""Table 3 of the paper: the metrics by type, as the engine itself lists them."""

import importlib

import pandas as pd

from figures.paper.common import Caption, save_table
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, high_is_bad
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.variables import AUXILIARY_VARIABLES
from jaxurban.metrics.weights import Weights

PAPER = "Five metrics of maps (GPS, lidar, obstacle, population, risk) and one of paths (distance)."
CHANGES = {ALTITUDE: "altitude", TIME: "time", TIME_OF_DAY: "time of day"}


def of_map(
    name: str, described: str, dims: tuple[str, ...], one_means: str, cost: str
) -> dict[str, str]:
    """Return the row of a map."""
    return {
        "Metric": f"m_{name}",
        "Description": described,
        "Type": "map",
        "Changes with": ", ".join(["place", *(CHANGES[dim] for dim in dims)]),
        "m = 1 means": one_means,
        "Unit": "none",
        "Cost c": cost,
    }


def main() -> None:
    obstacle = AUXILIARY_VARIABLES["obstacle"]
    where = "where a building stands at the height of flight"
    rows = [
        of_map("obstacle", where, obstacle.dims, obstacle.one_means, "none: no path may cross it")
    ]
    for name, metric in METRICS.items():
        cost = f"{'m' if metric.cost is high_is_bad else '1 - m'}, weight {Weights()[name]:g}"
        first_line = (
            importlib.import_module(f"jaxurban.metrics.{name}")
            .__doc__.split(":", 1)[1]
            .split(";")[0]
        )
        rows.append(
            of_map(name, first_line.strip().rstrip("."), metric.dims, metric.one_means, cost)
        )
    rows.sort(key=lambda row: row["Metric"])
    (path,) = (name for name in Weights().to_dict() if name not in METRICS)
    rows.append(
        {
            "Metric": f"m_{path}",
            "Description": "length of the path",
            "Type": "path",
            "Changes with": "path",
            "m = 1 means": "",
            "Unit": "m",
            "Cost c": f"m, weight {Weights()[path]:g} per metre",
        }
    )
    table = pd.DataFrame(rows)
    counts = table["Type"].value_counts()
    here = (
        f"The same: {counts['map']} metrics of maps and {counts['path']} of paths, read from the code that makes "
        "them. Four of the maps are costs; the obstacle map forbids. Weights are the defaults of a plan."
    )
    why = (
        "The paper calls GPS and lidar uncertainty, though its m is high where they are good: the table says what 1 "
        "means. It lists the obstacle map among the metrics and drops it from the costs; here that is a rule, which "
        "no weight can buy off."
    )
    save_table(table, "table_3_metrics", "Table 3. Metrics by type", Caption(PAPER, here, why))
