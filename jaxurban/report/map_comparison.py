"""report.md of a comparison of maps, with its table, difference maps and figures, all on one scale around zero."""

import math
import re
from functools import partial
from zlib import crc32

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from jaxurban.checks import one_of
from jaxurban.maps.provenance import NOT_SET
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
    bullets,
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
from jaxurban.studies.map_comparison import (
    CLOSED,
    MASKS,
    STATISTICS,
    MapComparison,
    unit_of,
)
from jaxurban.studies.queries import population_norms


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


def plot_difference(result: MapComparison, layer: str, *, time: str | None = None) -> Figure:
    """Return panels of B - A of a layer by altitude or time of day, all on one scale centred at 0.

    Cells that are blocked in either are grey, of ``obstacle`` and ``closed`` those that are blocked in both; colours
    reach as far as 99 % of the changed cells.

    Args:
      result: the comparison.
      layer: one of its layers.
      time: one of A's times; the first if left out.

    Raises:
      InputError: a layer or a time that is not compared.
    """
    # The maps of the layer at the time, and their rows of the table, which are in one order.
    change = result.difference(layer).values
    rows = result.table[result.table.layer == layer].reset_index(drop=True)
    if rows.time.notna().any():
        time = one_of("time", time or rows.time[0], rows.time.unique())
        rows = rows[rows.time == time]
    maps = change.reshape(-1, *result.grid.shape)[rows.index]

    # One scale for all panels, by the sizes of the changes.
    sizes = np.abs(maps)
    label = f"{_named(result, layer)}, B - A (red: B is higher)"
    meaning = meaning_of(result.a, layer) if layer in result.a.metrics else ""
    if meaning:
        label = f"{label}\n(m of 1: {meaning})"
    colours = difference_colours(sizes[sizes > result.tolerance], label)

    # A panel for each map: the differences, cut off at the ends of the scale, and blocked cells over them. These have
    # data in both maps and no difference; of a mask (`MASKS`) at an altitude they are blocked in both.
    has_data = result.a.ds["has_data"].values & result.b.ds["has_data"].values
    panels = []
    for values, row in zip(maps, rows.to_dict("records"), strict=True):
        is_grey = np.isnan(values)
        where = "" if pd.isna(row["time_of_day"]) else row["time_of_day"]
        if not math.isnan(row["altitude_m"]):
            where = f"{row['altitude_m']:g} m"
            if layer in MASKS:
                is_free = result.a.is_free(row["altitude_m"], None if layer == CLOSED else "centre")
                is_grey = ~is_free & (values == 0)
        shown = DrawnMap(np.clip(values, colours.norm.vmin, colours.norm.vmax), colours)
        text = "unchanged"
        if row["share_changed"]:
            text = f"mean {row['mean']:+.3g}, {precise_percent(row['share_changed'])} changed"
        blocked = flat_layer(is_grey & has_data, OBSTACLE_COLOUR)
        panels.append(MapPanel(joined(where, text), [shown, blocked]))

    # What the picture says.
    blocked_in = "blocked in A and B" if layer in MASKS else "blocked in A or B"
    heading = f"{heading_of(result, layer)}, B - A"
    note = _note(result, time)
    legend = [(blocked_in, OBSTACLE_COLOUR)]
    return draw_maps(result.grid, panels, heading, note, legend=legend, colours=colours)[0]


def _named(result: MapComparison, layer: str) -> str:
    """Return what the colour bar calls a layer, with its unit."""
    name = symbol_of(layer) if layer in result.a.metrics else layer
    unit = unit_of(result.a, layer)
    return name if unit == "1" else f"{name} [{unit}]"


def _note(result: MapComparison, time: str | None) -> str:
    """Return the lines below a picture of differences: the name of both maps, their times and what they guess.

    Args:
      result: the comparison.
      time: A's time of the layer that is drawn; None for a layer without times, whose note names no guesses of the sky.
    """
    lines = []
    times = {"A": time, "B": result.times.get(time or "")}
    for side, name, maps in zip("AB", result.names, (result.a, result.b), strict=True):
        head = side if name == side else f"{side}: {name}"
        at = times[side]
        guesses = guesses_said(maps, time is not None)
        lines.append(joined(head, at and time_said(at), guesses and f"guessed: {guesses}"))
    return "\n".join([*lines, joined(*ground_said(result.grid, result.a.attribution))])


def comparison_outputs(result: MapComparison) -> Written:
    """Return what a comparison writes, by file name, and the facts that identify it.

    A folder whose report has other facts is not replaced unless the user asks for it.
    """
    key = {
        "maps": list(result.names),
        "of": [result.a.identity, result.b.identity],
        "times": dict(result.times),
        "tolerance": result.tolerance,
        "values": crc32(result.table.to_csv().encode()),  # maps in memory have no name of their own
    }
    figures = comparison_figures(result)
    report = comparison_markdown(result, list(figures))
    tables = {"layers": result.table}
    if len(result.routes):
        tables |= {"routes": result.routes, "regrets": result.regrets}
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
        is_dust = changed[STATISTICS].abs() <= result.tolerance  # below the precision of a map
        changed[STATISTICS] = changed[STATISTICS].mask(is_dust, 0)
        values = framed(_in_percent(changed).where(changed.notna().to_numpy(), ""))

    pictures = [
        Markdown(f"![{plain(heading_of(result, name))}, B - A](figures/{plain(name)}.png)")
        for name in figures
    ]
    facts = result.a.facts
    left_out = bullets(f"{name}: {why}" for name, why in result.left_out.items())
    return fill(
        "compare",
        {"regrets": _in_percent(result.regrets)},
        credits=[result.a.attribution, result.b.attribution],
        result=result,
        lines=first_lines(result.decided.facts),
        extent=f"Compared are {facts['grid']} ({facts['CRS']}) at {facts['altitudes']}.",
        settings=_settings(result),
        values=values,
        unchanged=f"The same in both: {joined_with_and(same)}." if same else "",
        left_out=paragraphs("Not compared:", left_out) if left_out else "",
        pictures=paragraphs(*pictures) or "None: a layer is drawn where it differs.",
    )


def _in_percent(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with its shares, and the ends of their intervals, as percentages."""
    shown = table.copy()
    for name in map(str, table):
        if re.match("(closed|regret|share)(?!_m)", name):
            shown[name] = 100 * table[name]
    return shown.rename(
        columns=lambda name: re.sub("^(closed|regret|share)(?!_m)", r"\1 (%)", name)
    )


def _settings(result: MapComparison) -> str:
    """Return a table of what the maps were made with and differs, or a sentence, as Markdown.

    These are settings, times of GPS, and what population is divided by.
    """
    if result.settings is None:
        head = "Not both sets were made by `jaxurban maps`, so that their settings are not known."
    else:
        head = "" if result.settings else "No setting differs."
    pairs = {code(key): pair for key, pair in (result.settings or {}).items()}
    pairs |= {Markdown("time of GPS"): pair for pair in result.times.items()}
    norms_b = population_norms(result.b)
    for day, norm in population_norms(result.a).items():
        if "population" in result.layers and day in norms_b:
            name = Markdown(f"population is divided by, {day}")
            pairs[name] = f"{norm:,.0f}", f"{norms_b[day]:,.0f}"
    rows = [
        (name, *(NOT_SET if value is None else code(value) for value in pair))
        for name, pair in pairs.items()
        if pair[0] != pair[1]
    ]
    return paragraphs(head, table(("", "A", "B"), rows) if rows else "")
