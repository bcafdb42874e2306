"""Pictures of two sets of maps side by side: what differs, on one scale around zero, and the routes that change."""

import re
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from jaxurban.errors import InputError, one_of
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
from jaxurban.report.figures.metrics import DOP_NAMES, FREE_COLOUR, OBSTACLE_COLOUR, SERIES_NAMES, percent
from jaxurban.report.figures.notes import (
    ground_said,
    guesses_said,
    joined,
    meaning_of,
    rules_said,
    short_time,
    sky_said,
    symbol_of,
    time_said,
)
from jaxurban.report.figures.paths import draw_ends
from jaxurban.studies.map_comparison.compare import CLOSED, EVERYWHERE, MASKS, MapComparison, Place, unit_of

DIVERGING = "RdBu_r"  # red: B is higher
LOST_COLOUR, GAINED_COLOUR = "#2166ac", "#b2182b"  # the ends of it
MASK_COLOURS = {
    "free in both": FREE_COLOUR,
    "blocked in both": "#9a9a9a",
    "blocked only in A": LOST_COLOUR,
    "blocked only in B": GAINED_COLOUR,
}
A_COLOUR, B_COLOUR = "#111111", "#f59b00"
SHOWN_SHARE = 0.99  # of the changed cells lie within the colour bar
MOST_DOP = 5.0  # of the colour bar of dilutions of precision, whose tail has no end
EPOCHS = "_epochs"  # ends the name of a figure with a panel for each time
MOST_ROUTES = 8  # in a panel
UNITS = {"1": "", "m": "m", "km-2": "people per km²"}
LABELS = {
    CLOSED: "Cells that no planner enters",
    "obstacle": "Obstacles",
    "roof": "Roof height",
    "roof_touched": "Highest roof that touches the cell",
    "terrain": "Terrain",
    "density": "Population density",
    "num_visible": "Satellites in view",
    **DOP_NAMES,
    **SERIES_NAMES,
}


def comparison_figures(found: MapComparison) -> dict[str, Callable[[], Figure]]:
    """Return what draws each layer that changed anywhere, by its name, and ``routes`` where any changed."""
    whole = found.table[found.table.stratum == EVERYWHERE].groupby("layer", sort=False)["share_changed"].max()
    changed = [layer for layer in found.layers if whole[layer] > 0]
    figures: dict[str, Callable[[], Figure]] = {layer: partial(plot_difference, found, layer) for layer in changed}
    if "gps" in changed and len(found.part.times) > 1:
        figures[f"gps{EPOCHS}"] = partial(plot_difference, found, "gps", altitude_m=min(found.a.altitudes_m))
    if found.routes is not None and found.routes.both.is_changed.any():
        figures["routes"] = partial(plot_changed_routes, found)
    return figures


def heading_of(found: MapComparison, layer: str) -> str:
    """Return what figures and reports call a layer."""
    metrics = found.a.metrics
    return metrics[layer].label if layer in metrics else LABELS.get(layer, layer)


def plot_difference(
    found: MapComparison,
    layer: str,
    *,
    time: str | None = None,
    time_of_day: str | None = None,
    altitude_m: float | None = None,
) -> Figure:
    """Return panels of B - A of a layer by altitude, by time or by time of day, all on one scale centred at 0.

    Cells that are blocked in either are grey; colours reach as far as 99 % of the changed cells (of dilutions of
    precision to 5 at most). Of ``obstacle`` and ``closed``: cells that are blocked in both, in A alone and in B alone.

    Args:
      found: the comparison.
      layer: one of its layers.
      time: one of A's times; the first if left out.
      time_of_day: one of them; all of them, a panel each, if left out.
      altitude_m: this one at every time, a panel each; left out, all of them at one time.

    Raises:
      InputError: a layer that is not compared, or a time or an altitude that is not.
    """
    one_of("layer", layer, found.layers)
    times = list(dict.fromkeys(place.time for place in found.places(layer)))
    shown_time = times[0] if time is None else one_of("time", time, times)
    if altitude_m is None:
        places = [place for place in found.places(layer) if place.time == shown_time]
    else:
        shown_time = None
        altitudes_m = list(dict.fromkeys(place.altitude_m for place in found.places(layer)))
        places = [
            place for place in found.places(layer) if place.altitude_m == one_of("altitude_m", altitude_m, altitudes_m)
        ]
    if time_of_day is not None:
        days = [place.time_of_day for place in places]
        places = [place for place in places if place.time_of_day == one_of("time_of_day", time_of_day, days)]
    titles = [_title(found, layer, place, by_time=altitude_m is not None) for place in places]
    by = ", by altitude above ground" if places[0].altitude_m is not None else ""
    by = by if altitude_m is None else f" at each epoch, {altitude_m:g} m above ground"
    has_sky = places[0].time is not None or layer == "gps" or layer in SERIES_NAMES
    frame = make_frame(found.grid, titles, f"{heading_of(found, layer)}, B - A{by}", _note(found, shown_time, has_sky))
    if layer in MASKS:
        for panel, place in zip(frame.axes, places, strict=True):
            draw_layers(panel, found.grid, [_mask_layer(found, layer, place.altitude_m)])
        add_key(frame, [*MASK_COLOURS.items()])
        return frame.figure
    maps = [found.of(layer, place.altitude_m, time=place.time, time_of_day=place.time_of_day) for place in places]
    colours = _colours(found, layer, maps)
    is_flown = places[0].altitude_m is not None
    has_data = found.a.ds["has_data"].values & found.b.ds["has_data"].values
    for panel, values in zip(frame.axes, maps, strict=True):
        blocked = [flat_layer(np.isnan(values) & has_data, OBSTACLE_COLOUR)] if is_flown else []
        draw_layers(
            panel, found.grid, [MapLayer(np.clip(values, colours.norm.vmin, colours.norm.vmax), colours), *blocked]
        )
    add_key(frame, [("blocked in A or B", OBSTACLE_COLOUR)] if is_flown else [], colours)
    return frame.figure


def plot_changed_routes(found: MapComparison) -> Figure:
    """Return, by altitude, the routes that change most: A's and B's over the cells that are blocked in either.

    Those of A that are blocked on B come first, then those of the largest regret.

    Raises:
      InputError: no route changes.
    """
    if found.routes is None or not found.routes.both.is_changed.any():
        raise InputError("no route changes: there is nothing to draw")
    changed = found.routes.both[found.routes.both.is_changed.astype(bool)]
    changed = changed.sort_values("regret", ascending=False)
    panels = [
        (z_m, changed[changed.altitude_m == z_m]) for z_m in found.a.altitudes_m if (changed.altitude_m == z_m).any()
    ]
    titles = [f"{z_m:g} m  ·  {min(len(rows), MOST_ROUTES)} of {len(rows)} that change" for z_m, rows in panels]
    routes = (*found.routes.a, *found.routes.b)
    note = f"{_note(found, None, False)}\n{rules_said(*(path.settings for path in routes if path is not None))}"
    frame = make_frame(found.grid, titles, "Routes that change, by altitude above ground", note)
    for panel, (z_m, rows) in zip(frame.axes, panels, strict=True):
        draw_layers(panel, found.grid, [_mask_layer(found, CLOSED, z_m)])
        for number in rows["query"].head(MOST_ROUTES):
            a, b = found.routes.a[number], found.routes.b[number]
            panel.plot(*a.xy_m.T, color=A_COLOUR, linewidth=2.4, solid_joinstyle="round", zorder=3)
            panel.plot(*b.xy_m.T, color=B_COLOUR, linewidth=1.3, solid_joinstyle="round", zorder=4)
            draw_ends(panel, [a])
    add_key(frame, [("route on A", A_COLOUR), ("route on B", B_COLOUR), *MASK_COLOURS.items()], has_ends=True)
    return frame.figure


def _mask_layer(found: MapComparison, layer: str, altitude_m: float | None) -> MapLayer:
    """Return `MASK_COLOURS`' classes of blocked cells."""
    assert altitude_m is not None
    change = found.of(layer, altitude_m)
    is_blocked = ~found.a.is_free(altitude_m) if layer == CLOSED else found.a.m(layer, altitude_m) != 0
    classes = np.select([np.isnan(change), change < 0, change > 0, is_blocked], [-1, 2, 3, 1], 0).astype(np.int8)
    return classes_layer(classes, list(MASK_COLOURS.values()))


def _colours(found: MapComparison, layer: str, maps: Sequence[np.ndarray]) -> Colours:
    """Return one scale for all panels, as far on either side of 0."""
    size = np.concatenate([np.abs(values[np.isfinite(values) & (np.abs(values) > found.tolerance)]) for values in maps])
    limit = round_length_m(max(float(np.quantile(size, SHOWN_SHARE)) if len(size) else 1.0, 1e-12), down=False)
    limit = min(limit, MOST_DOP) if layer in DOP_NAMES else limit
    is_beyond = any(bool((np.abs(values) > limit).any()) for values in maps)
    unit = UNITS.get(given := unit_of(found.a, layer), given)
    meaning = meaning_of(found.a, layer) if layer in found.a.metrics else ""
    name = symbol_of(layer) if layer in found.a.metrics else layer.upper() if layer in DOP_NAMES else unit
    label = f"{name or heading_of(found, layer)}, B - A (red: B is higher)" + (
        f"\n(m of 1: {meaning})" if meaning else ""
    )
    return Colours(DIVERGING, Normalize(-limit, limit), label, "both" if is_beyond else "neither", (-limit, 0.0, limit))


def _title(found: MapComparison, layer: str, place: Place, by_time: bool) -> str:
    table = found.table
    chosen = (table.layer == layer) & (table.stratum == EVERYWHERE)
    for name, value in place._asdict().items():
        if value is not None:
            chosen &= table[name] == value
    row = table[chosen].iloc[0]
    where = f"{place.altitude_m:g} m" if place.altitude_m is not None else place.time_of_day
    if by_time and place.time is not None:
        return f"{short_time(place.time)}  ·  mean {row['mean']:+.3g}"
    if layer in MASKS:
        return f"{where}  ·  {row.gained:,} cells gained, {row.lost:,} lost"
    changed = f"mean {row['mean']:+.3g}, {percent(row.share_changed)} changed" if row.share_changed else "unchanged"
    return joined(where, changed)


def _note(found: MapComparison, time: str | None, has_sky: bool) -> str:
    """Return the names of both and what each rests on, and each one's sky where it is not the same."""
    skies = [sky_said(maps, time) if has_sky else "" for maps in (found.a, found.b)]
    of_b = {time_said(a): time_said(b) for a, b in found.part.times.items()}  # B's maps carry the names of A's times
    skies[1] = re.sub(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", lambda time: of_b.get(time[0], time[0]), skies[1])
    is_same = skies[0] == skies[1]
    guesses = [guesses_said(maps, has_sky) for maps in (found.a, found.b)]
    told = []
    for side, name, sky, guessed in zip("AB", found.names, skies, guesses, strict=True):
        its_own = ["" if is_same else f", {sky}", f"; guessed: {guessed}" if guessed else ""]
        told.append(f"{side}: {name}{''.join(its_own)}")
    if has_sky and time is None and any(a != b for a, b in of_b.items()):
        told.append(f"Panels name A's times; B's beside them: {', '.join(of_b.values())}")
    return "\n".join([*told, joined(skies[0] if is_same else "", *ground_said(found.a))])
