"""report.md of a comparison of maps, with its table, difference maps and figures, all on one scale around zero."""

from functools import partial
from zlib import crc32

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from jaxurban.maps.provenance import NOT_SET
from jaxurban.metrics.base import TIME
from jaxurban.report.figures.frame import (
    OBSTACLE_COLOUR,
    DrawnMap,
    MapPanel,
    draw_maps,
    flat_layer,
    ground_said,
    guesses_said,
    joined,
    meaning_of,
    symbol_of,
    time_said,
)
from jaxurban.report.figures.metrics import precise_percent
from jaxurban.report.figures.style import difference_colours
from jaxurban.report.write import (
    Figures,
    Markdown,
    Written,
    code,
    fill,
    first_lines,
    framed,
    joined_with_and,
    paragraphs,
    plain,
    study_outputs,
    table,
)
from jaxurban.studies.map_comparison import CLOSED, SAME, STATISTICS, MapComparison, unit_of


def comparison_figures(result: MapComparison) -> Figures:
    """Return the functions that draw the layers that changed in any cell, by the layer's name."""
    shares = result.most_changed
    changed = [layer for layer in result.layers if shares[layer] > 0]
    return {layer: partial(plot_difference, result, layer) for layer in changed}


def heading_of(result: MapComparison, layer: str) -> str:
    """Return what figures and reports call a layer."""
    if layer == CLOSED:
        return "Cells that no planner enters"
    metric = result.a.metrics.get(layer)
    return metric.label if metric else str(result.a.ds[layer].attrs.get("long_name", layer))


def plot_difference(result: MapComparison, layer: str) -> Figure:
    """Return panels of B - A of a layer by altitude or time of day, at the first time, on one scale centred at 0.

    Cells that are blocked in either are grey; colours reach as far as 99 % of the changed cells.

    Args:
      result: the comparison.
      layer: one of its layers.

    Raises:
      InputError: a layer that is not compared.
    """
    change = result.difference(layer)
    rows = result.table[result.table.layer == layer]
    time = None
    if TIME in change.dims:
        time = rows.time.iloc[0]
        change = change.isel({TIME: 0})
        rows = rows[rows.time == time]

    # One scale for all panels, by the sizes of the changes.
    sizes = np.abs(change.values)
    unit = unit_of(result.a, layer)
    name = layer if unit == "1" else f"{layer} [{unit}]"
    label = f"{name}, B - A (red: B is higher)"
    if layer in result.a.metrics:
        meaning = meaning_of(result.a, layer)
        label = f"{symbol_of(layer)}, B - A (red: B is higher)\n(m of 1: {meaning})"
    colours = difference_colours(sizes[sizes > SAME], label)

    # A panel for each map: the differences, cut off at the ends of the scale, and blocked cells over them.
    has_data = result.a.ds["has_data"].values & result.b.ds["has_data"].values
    panels = []
    maps = change.values.reshape(-1, *result.grid.shape)
    for values, row in zip(maps, rows.to_dict("records"), strict=True):
        where = f"{row['altitude_m']:g} m" if row["altitude_m"] >= 0 else row["time_of_day"]
        where = "" if pd.isna(where) else where
        text = f"mean {row['mean']:+.3g}, {precise_percent(row['share_changed'])} changed"
        shown = DrawnMap(np.clip(values, colours.norm.vmin, colours.norm.vmax), colours)
        blocked = flat_layer(np.isnan(values) & has_data, OBSTACLE_COLOUR)
        panels.append(MapPanel(joined(where, text), [shown, blocked]))

    # What the picture says: the name of both maps, their times, and what they guess.
    lines = []
    times = (time, result.times.get(time or ""))
    for side, name, maps_of, at in zip(
        "AB", result.names, (result.a, result.b), times, strict=True
    ):
        guesses = guesses_said(maps_of, time is not None)
        said = (at and time_said(at), guesses and f"guessed: {guesses}")
        lines.append(joined(side if name == side else f"{side}: {name}", *said))
    ground = joined(*ground_said(result.grid, result.a.attribution))
    return draw_maps(
        result.grid,
        panels,
        f"{heading_of(result, layer)}, B - A",
        "\n".join([*lines, ground]),
        legend=[("blocked in A or B", OBSTACLE_COLOUR)],
        colours=colours,
    )[0]


def comparison_outputs(result: MapComparison) -> Written:
    """Return what a comparison writes, by file name, and the facts that identify it.

    A folder whose report has other facts is not replaced unless the user asks for it.
    """
    key = {
        "maps": list(result.names),
        "of": [result.a.identity, result.b.identity],
        "times": dict(result.times),
        "values": crc32(result.table.to_csv().encode()),  # maps in memory have no name of their own
    }
    figures = comparison_figures(result)
    report = comparison_markdown(result, list(figures))
    tables = {"layers": result.table}
    if len(result.routes):
        tables["routes"] = result.routes
        key |= {"routes": result.routes["pair"].nunique(), "seed": result.seed}
        key["values_of_routes"] = crc32(result.routes.to_csv().encode())
    return study_outputs(report, tables, figures), key


def comparison_markdown(result: MapComparison, figures: list[str]) -> str:
    """Return the report as Markdown; ``figures`` are the layers whose pictures lie beside it."""
    # The table of values: a row for each map of the layers that differ, at the first time of those that have times.
    rows = result.table
    same = [str(layer) for layer, share in result.most_changed.items() if not share > 0]
    is_first = rows.time.isna() | (rows.time == rows.time.dropna().min())
    changed = rows[is_first & ~rows.layer.isin(same)].drop(columns="time").astype(object)
    values = "Not one value differs."
    if len(changed):
        is_dust = changed[STATISTICS].abs() <= SAME  # below the precision of a map
        changed[STATISTICS] = changed[STATISTICS].mask(is_dust, 0)
        changed["share_changed"] *= 100
        shown = changed.rename(columns={"share_changed": "changed (%)"})
        values = framed(shown.where(shown.notna(), ""))

    pictures = [
        Markdown(f"![{plain(heading_of(result, name))}, B - A](figures/{plain(name)}.png)")
        for name in figures
    ]
    facts = result.a.facts
    routes = result.routes
    if len(routes):
        columns = ["length_m", "regret", "is_closed", "closed_m", "apart_m"]
        shown = routes.assign(regret=100 * routes.regret, is_closed=100 * routes.is_closed)
        routes = shown.groupby("altitude_m")[columns].mean().reset_index()
        routes = routes.rename(columns={"regret": "regret (%)", "is_closed": "closed (%)"})
    return fill(
        "compare",
        {"routes": routes},
        credits=[result.a.attribution, result.b.attribution],
        result=result,
        same=SAME,
        lines=first_lines(result.decided.facts),
        extent=f"Compared are {facts['grid']} ({facts['CRS']}) at {facts['altitudes']}.",
        settings=_settings(result),
        values=values,
        unchanged=f"The same in both: {joined_with_and(same)}." if same else "",
        left_out=f"Not compared: {joined_with_and(result.left_out)}." if result.left_out else "",
        pictures=paragraphs(*pictures) or "None: a layer is drawn where it differs.",
    )


def _settings(result: MapComparison) -> str:
    """Return a table of the settings that differ, or a sentence, as Markdown."""
    if result.settings is None:
        return "Not both sets were made by `jaxurban maps`, so that their settings are not known."
    rows = [
        (code(key), *(NOT_SET if value is None else code(value) for value in pair))
        for key, pair in result.settings.items()
    ]
    return table(("", "A", "B"), rows) if rows else "No setting differs."
