"""The picture of two sets of maps side by side: what differs in a layer, on one scale around zero."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from jaxurban.errors import one_of
from jaxurban.metrics.gps import DOPS
from jaxurban.report.figures.frame import OBSTACLE_COLOUR, MapLayer, MapPanel, draw_maps, flat_layer
from jaxurban.report.figures.metrics import percent
from jaxurban.report.figures.notes import ground_said, guesses_said, joined, meaning_of, symbol_of, time_said
from jaxurban.report.figures.style import Colours
from jaxurban.studies.map_comparison import CLOSED, MASKS, MapComparison, unit_of

DIVERGING = "RdBu_r"  # red: B is higher
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
    metric = found.a.metrics.get(layer)
    return metric.label if metric else str(found.a.ds[layer].attrs.get("long_name", layer))


def plot_difference(found: MapComparison, layer: str, *, time: str | None = None) -> Figure:
    """Return panels of B - A of a layer by altitude or time of day, all on one scale centred at 0.

    Cells that are blocked in either are grey, of ``obstacle`` and ``closed`` those that are blocked in both; colours
    reach as far as 99 % of the changed cells (of dilutions of precision to 5 at most).

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
    rows: list[Any] = list(found.table[found.table.layer == layer].itertuples())
    drawn = [(place, row) for place, row in zip(places, rows, strict=True) if place.time == time]
    maps = [found.of(layer, **place._asdict()) for place, _ in drawn]
    changed = np.concatenate([np.abs(values[np.abs(values) > found.tolerance]) for values in maps])
    most = MOST_DOP if layer in DOPS else np.inf
    colours = difference_colours(changed, _label(found, layer), most)
    has_data, panels = found.a.ds["has_data"].values & found.b.ds["has_data"].values, []
    for (place, row), values in zip(drawn, maps, strict=True):
        is_grey = np.isnan(values)
        if layer in MASKS and place.altitude_m is not None:
            is_grey = ~found.a.is_free(place.altitude_m, None if layer == CLOSED else "centre") & (values == 0)
        shown = MapLayer(np.clip(values, colours.norm.vmin, colours.norm.vmax), colours)
        where = place.time_of_day if place.altitude_m is None else f"{place.altitude_m:g} m"
        share = f"mean {row.mean:+.3g}, {percent(row.share_changed)} changed" if row.share_changed else "unchanged"
        panels.append(MapPanel(joined(where, share), [shown, flat_layer(is_grey & has_data, OBSTACLE_COLOUR)]))
    heading, legend = f"{heading_of(found, layer)}, B - A", f"blocked in A {'and' if layer in MASKS else 'or'} B"
    look: dict[str, Any] = {"legend": [(legend, OBSTACLE_COLOUR)], "colours": colours}
    return draw_maps(found.grid, panels, heading, _note(found, time), **look)[0]


def difference_colours(changed: np.ndarray, label: str, most: float = np.inf) -> Colours:
    """Return a scale as far on either side of 0, at most ``most``, which holds `SHOWN_SHARE` of changes' sizes."""
    finite = changed[np.isfinite(changed)]
    limit = min(most, max(1e-12, float(np.quantile(finite, SHOWN_SHARE)))) if len(finite) else 1.0
    extend = "both" if len(changed) and float(changed.max()) > limit else "neither"
    return Colours(DIVERGING, Normalize(-limit, limit), label, extend, (-limit, 0.0, limit))


def _label(found: MapComparison, layer: str) -> str:
    is_metric, unit = layer in found.a.metrics, unit_of(found.a, layer)
    label = f"{symbol_of(layer) if is_metric else layer}{'' if unit == '1' else f' [{unit}]'}, B - A (red: B is higher)"
    meaning = meaning_of(found.a, layer) if is_metric else ""
    return f"{label}\n(m of 1: {meaning})" if meaning else label


def _note(found: MapComparison, time: str | None) -> str:
    """Return the name of both, what each guesses, and each one's time where the layer has any."""
    times = (None, None) if time is None else (time, found.times[time])
    lines = []
    for side, name, maps, its_time in zip("AB", found.names, (found.a, found.b), times, strict=True):
        guessed = guesses_said(maps, time is not None)
        lines.append(joined(f"{side}: {name}", its_time and time_said(its_time), guessed and f"guessed: {guessed}"))
    return "\n".join([*lines, joined(*ground_said(found.a))])
