"""report.md of a comparison of maps, with its table, difference maps and figures, all on one scale around zero."""

from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from matplotlib.figure import Figure

from jaxurban.checks import one_of
from jaxurban.io.geotiff import write_bands
from jaxurban.io.stored import short_number
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
    framed,
    joined_with_and,
    paragraphs,
    plain,
    study_outputs,
    table,
)
from jaxurban.studies.map_comparison import CLOSED, MASKS, MapComparison, unit_of
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
    # The differences of the layer at the time, with their rows of the table, which has one per place in this order.
    places = result.places(one_of("layer", layer, result.layers))
    times = list(dict.fromkeys(place.time for place in places))
    time = times[0] if time is None else one_of("time", time, times)
    is_drawn = [place.time == time for place in places]
    rows: Any = result.table[result.table.layer == layer][is_drawn].itertuples()
    places = list(compress(places, is_drawn))
    differences = [result.of(layer, **place._asdict()) for place in places]

    # One scale for all panels, by the sizes of the changes.
    sizes = np.abs(np.concatenate(differences, axis=None))
    colours = difference_colours(sizes[sizes > result.tolerance], _label(result, layer))

    # A panel for each map: the differences, cut off at the ends of the scale, and blocked cells over them.
    has_data = result.a.ds["has_data"].values & result.b.ds["has_data"].values
    panels = []
    for place, row, values in zip(places, rows, differences, strict=True):
        where = place.time_of_day if place.altitude_m is None else f"{place.altitude_m:g} m"

        # [Y, X] the cells that are shown as blocked: they have data in both maps and no difference; of a mask (`MASKS`)
        # at an altitude they are blocked in both.
        is_grey = np.isnan(values)
        if layer in MASKS and place.altitude_m is not None:
            is_free = result.a.is_free(place.altitude_m, None if layer == CLOSED else "centre")
            is_grey = ~is_free & (values == 0)
        layers = [
            DrawnMap(np.clip(values, colours.norm.vmin, colours.norm.vmax), colours),
            flat_layer(is_grey & has_data, OBSTACLE_COLOUR),
        ]
        text = "unchanged"
        if row.share_changed:
            text = f"mean {row.mean:+.3g}, {precise_percent(row.share_changed)} changed"
        panels.append(MapPanel(joined(where, text), layers))

    # What the picture says.
    blocked = "blocked in A and B" if layer in MASKS else "blocked in A or B"
    legend = [(blocked, OBSTACLE_COLOUR)]
    heading = f"{heading_of(result, layer)}, B - A"
    note = _note(result, time)
    return draw_maps(result.grid, panels, heading, note, legend=legend, colours=colours)[0]


def _label(result: MapComparison, layer: str) -> str:
    """Return the label of a difference's colour bar: layer, unit, which map is the higher one, and what 1 means."""
    unit = unit_of(result.a, layer)
    in_unit = "" if unit == "1" else f" [{unit}]"
    change = "B - A (red: B is higher)"
    if layer not in result.a.metrics:
        return f"{layer}{in_unit}, {change}"
    label = f"{symbol_of(layer)}{in_unit}, {change}"
    meaning = meaning_of(result.a, layer)
    return f"{label}\n(m of 1: {meaning})" if meaning else label


def _note(result: MapComparison, time: str | None) -> str:
    """Return the lines below a picture of differences: the name of both maps, their times and what they guess.

    Args:
      result: the comparison.
      time: A's time of the layer that is drawn; None for a layer without times, whose note names no guesses of the sky.
    """
    lines = []
    for side, name, maps in zip("AB", result.names, (result.a, result.b), strict=True):
        facts = [joined(side, name if name != side else "", by=": ")]
        if time:
            facts.append(time_said(time if side == "A" else result.times[time]))
        guesses = guesses_said(maps, time is not None)
        if guesses:
            facts.append(f"guessed: {guesses}")
        lines.append(joined(*facts))
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
    size = short_number(result.grid.resolution_m)
    outputs = {
        f"difference/{layer}_{size}m.tif": partial(_write_difference, result, layer)
        for layer in result.layers
    }
    report = comparison_markdown(result, list(figures))
    tables = {"layers": result.table}
    if len(result.routes):
        tables |= {"routes": result.routes, "regrets": result.regrets}
        key |= {"routes": result.routes["pair"].nunique(), "seed": result.seed}
        key["values_of_routes"] = crc32(result.routes.to_csv().encode())
    return outputs | study_outputs(report, tables, figures), key


def _write_difference(result: MapComparison, layer: str, file: Path) -> Path:
    """Write a layer's differences as a GeoTIFF, a band for each altitude, time and time of day; return the file.

    A layer without any of these has one band, named ``B - A``.

    Args:
      result: the comparison.
      layer: one of its layers.
      file: the GeoTIFF.
    """
    # The differences ``[Y, X]`` of each band, by its name.
    bands = {}
    for place in result.places(layer):
        altitude = None if place.altitude_m is None else f"{place.altitude_m:g} m"
        name = joined(altitude, place.time, place.time_of_day, by=" ") or "B - A"
        bands[name] = result.of(layer, **place._asdict())

    # What the file says of itself.
    tags = {
        "layer": layer,
        "difference": "B - A",
        "maps_a": result.names[0],
        "maps_b": result.names[1],
    }
    if result.a.attribution:
        tags["attribution"] = result.a.attribution
    return write_bands(file, result.grid, bands, unit_of(result.a, layer), tags)


def comparison_markdown(result: MapComparison, figures: list[str]) -> str:
    """Return the report as Markdown; ``figures`` are the layers whose pictures lie beside it."""
    # The table of values: a row for each map of the layers that differ, at the first time of those that have times.
    rows = result.table
    same = [str(layer) for layer, share in result.most_changed.items() if not share > 0]
    is_first = rows.time.isna() | (rows.time == rows.time.dropna().min())
    changed = rows[is_first & ~rows.layer.isin(same)].drop(columns="time").astype(object)
    values = "Not one value differs."
    if len(changed):
        values = framed(changed.where(changed.notna(), ""))

    pictures = [
        Markdown(f"![{plain(heading_of(result, name))}, B - A](figures/{plain(name)}.png)")
        for name in figures
    ]
    facts = result.a.facts
    left_out = bullets(f"{name}: {why}" for name, why in result.left_out.items())
    return fill(
        "compare",
        {"regrets": result.regrets},
        credits=[result.a.attribution, result.b.attribution],
        result=result,
        extent=f"Compared are {facts['grid']} ({facts['CRS']}) at {facts['altitudes']}.",
        settings=_settings(result),
        values=values,
        unchanged=f"The same in both: {joined_with_and(same)}." if same else "",
        left_out=paragraphs("Not compared:", left_out) if left_out else "",
        pictures=paragraphs(*pictures) or "None: a layer is drawn where it differs.",
    )


def _settings(result: MapComparison) -> str:
    """Return the section of a report on what the maps were made with, as Markdown.

    A table of A's and B's settings that differ, GPS times that differ, and what population is divided by where that
    differs; or a sentence where the settings are not known, or are the same.
    """
    # Rows of a name, A's value and B's value: settings, times of GPS, and what population is divided by.
    rows: list[tuple[str, Any, Any]] = [
        (code(key), of_a, of_b) for key, (of_a, of_b) in (result.settings or {}).items()
    ]
    for of_a, of_b in result.times.items():
        if of_a != of_b:
            rows.append(("time of GPS", of_a, of_b))
    norms_a = population_norms(result.a)
    norms_b = population_norms(result.b)
    for day, norm_a in norms_a.items():
        norm_b = norms_b.get(day, norm_a)  # the same where B does not hold this time of day
        if "population" in result.layers and norm_a != norm_b:
            rows.append((f"population is divided by, {day}", f"{norm_a:,.0f}", f"{norm_b:,.0f}"))

    parts = []
    if result.settings is None:
        parts.append(
            "Not both sets were made by `jaxurban maps`, so that their settings are not known."
        )
    elif not result.settings:
        parts.append("No setting differs.")
    if rows:
        texts = [(name, _value_text(of_a), _value_text(of_b)) for name, of_a, of_b in rows]
        parts.append(table(("", "A", "B"), texts))
    return paragraphs(*parts)


def _value_text(value: Any) -> str:
    return NOT_SET if value is None else code(value)
