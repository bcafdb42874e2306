"""Table 3 of the paper: the metrics by type, as the engine itself lists them."""

import importlib
from dataclasses import fields

import pandas as pd

from figures.paper.common import Caption, save_table
from jaxurban.cost import METRICS, Weights, metric_cost
from jaxurban.layers import UNITS, MapParams, variables

PAPER = "Five metrics of maps (GPS, lidar, obstacle, population, risk) and one of paths (distance)."
AXES = {"altitude": "altitude", "time": "time", "time_of_day": "time of day"}


def of_map(name: str, held: dict) -> dict[str, str]:
    """Return the row of a metric that has maps, from its module's first line and the layers' registry."""
    unit, one_means = UNITS[name]
    if name in METRICS:
        weight = f"weight {getattr(Weights(), name):g}"
        cost = f"{'m' if metric_cost(name, 1.0) == 1.0 else '1 - m'}, {weight}"
    else:
        cost = "none: no path may cross it"
    return {
        "Metric": f"m_{name}",
        "Description": importlib.import_module(f"jaxurban.metrics.{name}").__doc__.split(":", 1)[1].strip().rstrip("."),
        "Type": "map",
        "Changes with": ", ".join(["place", *(AXES[axis] for axis in held[name][0] if axis in AXES)]),
        "m = 1 means": one_means,
        "Unit": "none" if unit == "1" else unit,
        "Cost c": cost,
    }


def main() -> None:
    held = variables(MapParams(), num_epochs=1, has_people=True, has_terrain=False)
    rows = [of_map(name, held) for name in sorted({*METRICS, "obstacle"})]
    (path,) = (item.name for item in fields(Weights) if item.name not in METRICS)
    rows.append(
        {
            "Metric": f"m_{path}",
            "Description": "length of the path",
            "Type": "path",
            "Changes with": "path",
            "m = 1 means": "",
            "Unit": "m",
            "Cost c": f"m, weight {getattr(Weights(), path):g} per metre",
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


if __name__ == "__main__":
    main()
