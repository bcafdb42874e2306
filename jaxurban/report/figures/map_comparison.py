"""The picture of two sets of maps side by side: what differs in a layer, on one scale around zero."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from jaxurban.errors import one_of
from jaxurban.report.figures.colours import Colours
from jaxurban.report.figures.frame import (
    MapLayer,
    add_key,
    classes_layer,
    draw_layers,
    flat_layer,
    make_frame,
    round_length_m,
)
from jaxurban.report.figures.metrics import DOP_NAMES, FREE_COLOUR, OBSTACLE_COLOUR, percent
from jaxurban.report.figures.notes import ground_said, guesses_said, joined, meaning_of, symbol_of, time_said
from jaxurban.studies.map_comparison.compare import CLOSED, MASKS, MapComparison, Place, unit_of

DIVERGING = "RdBu_r"  # red: B is higher
MASK_COLOURS = {
    "free in both": FREE_COLOUR,
    "blocked in both": "#9a9a9a",
    "blocked only in A": "#2166ac",
    "blocked only in B": "#b2182b",
}
SHOWN_SHARE = 0.99  # of the changed cells lie within the colour bar
MOST_DOP = 5.0  # of the colour bar of dilutions of precision, whose tail has no end


def comparison_figures(found: MapComparison) -> dict[str, Callable[[], Figure]]:
    """Return what draws each layer that changed anywhere, by its name."""
    most = found.most_changed
    return {layer: partial(plot_difference, found, layer) for layer in found.layers if most[layer] > 0}


def heading_of(found: MapComparison, layer: str) -> str:
    """Return what figures and reports call a layer."""
    if layer == CLOSED:
        return "Cells that no planner enters"
    return (
        found.a.metrics[layer].label
        if layer in found.a.metrics
        else str(found.a.ds[layer].attrs.get("long_name", layer))
    )


def plot_difference(found: MapComparison, layer: str, *, time: str | None = None) -> Figure:
    """Return panels of B - A of a layer by altitude or time of day, all on one scale centred at 0.

    Cells that are blocked in either are grey; colours reach as far as 99 % of the changed cells (of dilutions of
    precision to 5 at most). Of ``obstacle`` and ``closed``: cells that are blocked in both, in A alone and in B alone.

    Args:
      found: the comparison.
      layer: one of its layers.
      time: one of A's times; the first if left out.

    Raises:
      InputError: a layer or a time that is not compared.
    """
    places = found.places(one_of("layer", layer, found.layers))
    times = list(dict.fromkeys(place.time for place in places))
    time = times[0] if time is None else one_of("time", time, times)
    places = [place for place in places if place.time == time]
    by = ", by altitude above ground" if places[0].altitude_m is not None else ""
    titles = [_title(found, layer, place) for place in places]
    frame = make_frame(found.grid, titles, f"{heading_of(found, layer)}, B - A{by}", _note(found, time))
    if layer in MASKS:
        for panel, place in zip(frame.axes, places, strict=True):
            draw_layers(panel, found.grid, [_mask_layer(found, layer, place)])
        add_key(frame, [*MASK_COLOURS.items()])
        return frame.figure
    maps = [found.of(layer, **place._asdict()) for place in places]
    colours = _colours(found, layer, maps)
    has_data = found.a.ds["has_data"].values & found.b.ds["has_data"].values
    for panel, values in zip(frame.axes, maps, strict=True):
        blocked = [flat_layer(np.isnan(values) & has_data, OBSTACLE_COLOUR)] if by else []
        shown = MapLayer(np.clip(values, colours.norm.vmin, colours.norm.vmax), colours)
        draw_layers(panel, found.grid, [shown, *blocked])
    add_key(frame, [("blocked in A or B", OBSTACLE_COLOUR)] if by else [], colours)
    return frame.figure


def _mask_layer(found: MapComparison, layer: str, place: Place) -> MapLayer:
    """Return `MASK_COLOURS`' classes of blocked cells."""
    assert place.altitude_m is not None
    change = found.of(layer, place.altitude_m)
    is_blocked = ~found.a.is_free(place.altitude_m) if layer == CLOSED else found.a.m(layer, place.altitude_m) != 0
    classes = np.select([np.isnan(change), change < 0, change > 0, is_blocked], [-1, 2, 3, 1], 0).astype(np.int8)
    return classes_layer(classes, list(MASK_COLOURS.values()))


def _colours(found: MapComparison, layer: str, maps: Sequence[np.ndarray]) -> Colours:
    """Return one scale for all panels, as far on either side of 0."""
    size = np.concatenate([np.abs(values[np.isfinite(values) & (np.abs(values) > found.tolerance)]) for values in maps])
    limit = round_length_m(max(float(np.quantile(size, SHOWN_SHARE)) if len(size) else 1.0, 1e-12), down=False)
    limit = min(limit, MOST_DOP) if layer in DOP_NAMES else limit
    is_beyond = any(bool((np.abs(values) > limit).any()) for values in maps)
    is_metric, unit = layer in found.a.metrics, unit_of(found.a, layer)
    label = f"{symbol_of(layer) if is_metric else layer}{'' if unit == '1' else f' [{unit}]'}, B - A (red: B is higher)"
    if is_metric and (meaning := meaning_of(found.a, layer)):
        label += f"\n(m of 1: {meaning})"
    return Colours(DIVERGING, Normalize(-limit, limit), label, "both" if is_beyond else "neither", (-limit, 0.0, limit))


def _title(found: MapComparison, layer: str, place: Place) -> str:
    chosen = found.table.layer == layer
    for name, value in place._asdict().items():
        if value is not None:
            chosen &= found.table[name] == value
    row = found.table[chosen].iloc[0]
    where = place.time_of_day if place.altitude_m is None else f"{place.altitude_m:g} m"
    if layer in MASKS:
        return joined(where, f"{row.gained:,} cells gained, {row.lost:,} lost")
    changed = f"mean {row['mean']:+.3g}, {percent(row.share_changed)} changed" if row.share_changed else "unchanged"
    return joined(where, changed)


def _note(found: MapComparison, time: str | None) -> str:
    """Return the name of both, what each guesses, and each one's time where the layer has any."""
    times = (None, None) if time is None else (time, found.part.times[time])
    lines = []
    for side, name, maps, its_time in zip("AB", found.names, (found.a, found.b), times, strict=True):
        guessed = guesses_said(maps, time is not None)
        lines.append(joined(f"{side}: {name}", its_time and time_said(its_time), guessed and f"guessed: {guessed}"))
    return "\n".join([*lines, joined(*ground_said(found.a))])
