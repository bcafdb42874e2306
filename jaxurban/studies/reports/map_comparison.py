"""report.md of a comparison of maps, with its tables, and figures of differences, each on one scale around zero."""

from functools import partial
from typing import Any, Unpack
from zlib import crc32

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from jaxurban.draw.frame import (
    OBSTACLE_COLOUR,
    DrawnMap,
    MapPanel,
    draw_maps,
    flat_layer,
    ground_said,
    joined,
    rules_said,
    time_said,
)
from jaxurban.draw.style import difference_colours, drawing
from jaxurban.draw.write import Markdown, ResultReport, bullets, plain
from jaxurban.knowledge import names_of
from jaxurban.metrics.base import TIME, ones_said
from jaxurban.paths.plan import cost_map
from jaxurban.pictures import MapForm
from jaxurban.statistics.bootstrap import Clusters, named
from jaxurban.studies.baseline import MEASURES, SHORTEST, baseline_said
from jaxurban.studies.compared_routes import BEST, THERE
from jaxurban.studies.decided import effects
from jaxurban.studies.map_comparison import MapComparison, setting_said

# The rows of routes by weights and maps: how their columns begin, and that of their cost under A's weights.
FLOWN = {
    ("A's", "A", "A"): ("", "cost"),
    ("A's", "A", "B"): (THERE, "cost_there"),
    ("A's", "B", "B"): (BEST, "best_there"),
    ("distance alone", "A", "A"): (SHORTEST, f"{SHORTEST}cost"),
}
COSTS = [cost for _, cost in FLOWN.values()]


@drawing
def plot_difference(result: MapComparison, layer: str, **form: Unpack[MapForm]) -> Figure:
    """Return panels of B - A of a layer by altitude or time of day, at the first time, on one scale centred at 0.

    Cells that are blocked in either are grey; colours reach as far as 99 % of the changed cells.

    Args:
      result: the comparison.
      layer: one of its layers.
      form: width, ax, title and cmap, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: a layer that is not compared.

    Examples:
      >>> other = ju.build_maps(city, grid=maps.grid, altitudes_m=maps.altitudes_m, gps=ju.Gps(mask_deg=20.0))
      >>> result = ju.studies.compare(maps, other, progress=False)
      >>> ju.plot.plot_difference(result, "gps", title="A mask of 20 degrees").savefig("difference.png")
    """
    change = result.difference(layer)
    rows = result.table[result.table.layer == layer]
    has_sky = TIME in change.dims
    change = change.isel({TIME: 0}, missing_dims="ignore")

    # One scale for all panels, by the sizes of the changes.
    sizes = np.abs(change.values)
    unit = f" [{rows.unit.iloc[0]}]".replace(" [1]", "")  # a share has none
    label = f"{layer}{unit}, B - A (red: B is higher)"
    colours = difference_colours(sizes[sizes > 0], label)

    # A panel for each map: the differences, cut off at the ends of the scale, and blocked cells over them.
    has_data = result.a.ds["has_data"].values & result.b.ds["has_data"].values
    panels = []
    maps = change.values.reshape(-1, *has_data.shape)
    for values, row in zip(
        maps, rows.astype(object).where(rows.notna(), "").to_dict("records"), strict=False
    ):
        altitude = "" if row["altitude_m"] == "" else f"{row['altitude_m']:g} m"
        num = row["higher"] + row["lower"]
        text = f"mean {row['mean']:+.3g}, {num:,} of {row['cells']:,} cells changed"
        shown = DrawnMap(np.clip(values, colours.norm.vmin, colours.norm.vmax), colours)
        blocked = flat_layer(np.isnan(values) & has_data, OBSTACLE_COLOUR)
        panels.append(MapPanel(joined(altitude, row["time_of_day"], text), [shown, blocked]))

    # What the picture says: the name and the time of both maps, and what A's rest on.
    notes = []
    for side, name, maps_of in zip("AB", result.names, (result.a, result.b), strict=True):
        time = maps_of.default_time if has_sky else None
        notes.append(joined(f"{side}: {name or 'maps in memory'}", time and time_said(time)))
    notes.append(joined(*ground_said(result.a.grid, result.a.attribution)))
    heading = f"{change.attrs.get('long_name', layer)}, B - A"
    legend = [("blocked in A or B", OBSTACLE_COLOUR)]
    note = "\n".join(notes)
    return draw_maps(result.a.grid, panels, heading, note, legend=legend, colours=colours, **form)[
        0
    ]


def _by_altitude(routes: pd.DataFrame) -> pd.DataFrame:
    """Return a row per altitude of the routes of a comparison; none where there are no routes."""
    rows: list[dict[str, float]] = []
    if routes.empty:
        return pd.DataFrame(rows)
    for altitude_m, each in routes.groupby("altitude_m"):
        regret = effects(100 * each[["regret"]], Clusters(each.pair), least=0.0).loc["regret"]
        row = {
            "altitude_m": altitude_m,
            "routes": each.pair.count(),
            "changed": each.is_changed.sum(),
            "closed": each.is_closed.sum(),
            "regret %": regret["size"],
            "regret %_low": regret["low"],
            "regret %_high": regret["high"],
            "median %": 100 * each.regret.median(),
            "length_m": each.length_m.mean(),
            "apart_m": each.apart_m.max(),
        }
        rows.append(row)
    return pd.DataFrame(rows)


def _flown(routes: pd.DataFrame) -> pd.DataFrame:
    """Return what routes cost and what is flown by altitude, weights and maps, of the pairs that have all of them."""
    if routes.empty:
        return routes
    rows: list[dict[str, Any]] = []
    known = routes.dropna(subset=COSTS)
    for (weights, planned_on, flown_on), (of, cost) in FLOWN.items():
        measures = {"cost": cost, **{name: f"{of}{name}" for name in MEASURES}}
        for altitude_m, each in known.groupby("altitude_m"):
            row = {"altitude_m": altitude_m, "weights": weights, "planned on": planned_on}
            row |= {"flown on": flown_on, "routes": len(each)}
            clusters = Clusters(each.pair)
            for name, column in measures.items():
                row |= named(name, clusters.interval(each[column]))
            rows.append(row)
    table = pd.DataFrame(rows).dropna(axis=1, how="all")
    return table.sort_values("altitude_m", kind="stable") if rows else table


def comparison_report(result: MapComparison) -> ResultReport:
    """Return what a comparison writes."""
    table = result.table
    tables = {"layers": table}
    routes = result.routes
    rules, weights = "", {}
    if len(routes):
        tables["routes"] = routes
        record = cost_map(result.a, result.a.altitudes_m[0]).record
        rules, weights = rules_said(record), record["weights"]

    # The layers that differ, and a row for each of their maps, at the first time of those that have times.
    changed = table[table.higher + table.lower > 0].layer.unique().tolist()
    values = table[table.layer.isin(changed)]
    values = values[values.time.isna() | (values.time == values.time.min())]
    settings = (
        f"{key}: {setting_said(a)} in A, {setting_said(b)} in B"
        for key, (a, b) in result.settings.items()
    )
    pictures = (f"![{layer}, B - A](figures/{layer}.png)" for layer in map(plain, changed))
    return ResultReport(
        "studies/templates/compare",
        {
            "tables": {
                "values": values.drop(columns="time"),
                "routes": _by_altitude(routes),
                "flown": _flown(routes),
            },
            "credits": [result.a.attribution, result.b.attribution],
            "names": result.names,
            "facts": result.a.facts,
            "legend": ones_said(result.a.metrics),
            "guessed": [names_of(result.a.guesses), names_of(result.b.guesses)],
            "baseline": baseline_said(result.decided),
            "rules": rules,
            "pairs": routes.pair.nunique() if len(routes) else 0,
            "settings": bullets(settings) or "None that is known.",
            "left_out": ", ".join(result.left_out) or "nothing",
            "pictures": Markdown("\n\n".join(pictures)) or "None: no layer differs.",
        },
        tables=tables,
        figures={layer: partial(plot_difference, result, layer) for layer in changed},
        key={
            "maps": list(result.names),
            "routes": len(routes) // len(result.a.altitudes_m),
            "weights": weights,
            "values": crc32((table.to_csv() + routes.to_csv()).encode()),
        },
        decided=result.decided,
    )
