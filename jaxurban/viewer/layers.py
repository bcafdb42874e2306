"""The layers that the viewer draws: which there are, their values and their colours, which are those of our figures."""

import base64
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize

from jaxurban.errors import one_of
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, high_is_bad
from jaxurban.report.figures.frame import NO_DATA_PATCH, OBSTACLE_COLOUR
from jaxurban.report.figures.map_comparison import difference_colours
from jaxurban.report.figures.metrics import (
    BUILT_COLOUR,
    EMPTY_COLOUR,
    FREE_COLOUR,
    HEIGHT_COLOUR_MAP,
    density_colours,
    drawn_names,
    metric_colours,
    roof_colours,
    values_of,
)
from jaxurban.report.figures.paths import BLOCKED_COLOUR, COST_COLOURS
from jaxurban.report.figures.style import Colours, bar_ticks, ends_of, tick_label
from jaxurban.viewer.markup import legend

H_NORM, COST_OF = "h_norm", "cost:"
OBSTACLE, NOTHING = np.float32(-np.inf), np.float32(np.nan)  # how values travel: a cell in an obstacle; one not drawn
DIFFERENCE = "the first less the second (red: the first is higher)"
BAR_IN = 2.6  # length of the colour bar on the page, which decides how many ticks have room
HIDDEN = ("has_data", "gps_median")


@dataclass(frozen=True)
class Place:
    """Which of a layer's maps: altitude, time and time of day, None where a layer does not vary with it."""

    altitude_m: float | None = None
    time: str | None = None
    time_of_day: str | None = None


@dataclass(frozen=True)
class Layer:
    """A layer that can be drawn.

    Attributes:
      name: as requests name it.
      heading: what it is called.
      group: of the list that it stands in.
      dims: of ``altitude``, ``time`` and ``time_of_day``, those that it varies with.
      read: returns its values ``[Y, X]`` at a place.
      colours: returns how these values are drawn.
      zero: what a value of 0 means and its colour, where 0 is drawn apart.
      blocked: colour of cells inside obstacles.
      unit: of its values; "" for m, for counts and for dilutions of precision.
    """

    name: str
    heading: str
    group: str
    dims: tuple[str, ...]
    read: Callable[[Place], np.ndarray]
    colours: Callable[[np.ndarray], Colours]
    zero: tuple[str, str] | None = None
    blocked: str = OBSTACLE_COLOUR
    unit: str = ""

    def values(self, maps: MetricMaps, at: Place) -> np.ndarray:
        """Return ``[Y, X]`` float32; at an altitude `OBSTACLE` and `NOTHING` stand where there is no value."""
        values = np.asarray(self.read(at), np.float32)
        if ALTITUDE not in self.dims or self.name == "obstacle" or at.altitude_m is None:
            return values
        values = np.where(maps.is_free(at.altitude_m, "centre"), values, NOTHING)
        is_blocked = (maps.m("obstacle", at.altitude_m) != 0) & maps.ds["has_data"].values
        np.copyto(values, OBSTACLE, where=is_blocked)
        return values


def layers_of(maps: MetricMaps) -> dict[str, Layer]:
    """Return every layer of these maps that can be drawn, by name, those that are looked at most first."""
    found: dict[str, Layer] = {}

    def add(name: str, heading: str, group: str, colours: Callable[[np.ndarray], Colours], **more: Any) -> None:
        facts = more if "read" in more else {"dims": _dims(maps, name), "read": partial(_held, maps, name)} | more
        found[name] = Layer(name, heading, group, colours=colours, **facts)

    headings = drawn_names(maps)
    for name in maps.metrics:
        add(name, headings[name], "Metrics", partial(_metric, maps, name))
    flown = tuple(dict.fromkeys((ALTITUDE, *(dim for name in maps.metrics for dim in _dims(maps, name)))))
    total = {"dims": flown, "read": partial(_h_norm, maps), "blocked": BLOCKED_COLOUR}
    add(H_NORM, "All costs together, H_norm", "Costs", partial(_always, COST_COLOURS), **total)
    for name, metric in maps.metrics.items():
        label = f"c_{name}, cost before its weight (0: best, 1: worst)"
        is_m = metric.cost is high_is_bad
        scale = Colours(metric.colour_map if is_m else f"{metric.colour_map}_r", Normalize(0, 1), label)
        cost = {"dims": _dims(maps, name), "read": partial(_cost, maps, name)}
        add(f"{COST_OF}{name}", f"Cost of {metric.label}", "Costs", partial(_always, scale), **cost)
    for name, heading in headings.items():
        if name not in found and name != "obstacle":
            add(name, heading, "Satellites", partial(_metric, maps, name))
    add("obstacle", headings["obstacle"], "Ground", _obstacles)
    for name, (heading, unit, zero, colours) in GROUND.items():
        if name in maps.ds:
            add(name, heading, "Ground", colours, zero=zero, unit=unit)
    for name in [str(name) for name, array in maps.ds.data_vars.items() if array.dims[-2:] == ("y", "x")]:
        if name not in found and name not in HIDDEN and maps.ds[name].dtype.kind in "fiub":
            unit = str(maps.ds[name].attrs.get("units", "1"))
            add(name, name, "Further maps", partial(_plain, f"{name} ({unit})"))
    return found


def _dims(maps: MetricMaps, name: str) -> tuple[str, ...]:
    variable = maps.variable(name)
    if variable not in maps.ds:  # the availability over several times, which is made here
        return (ALTITUDE,)
    return tuple(dim for dim in (ALTITUDE, TIME, TIME_OF_DAY) if dim in maps.ds[variable].dims)


def _held(maps: MetricMaps, name: str, at: Place) -> np.ndarray:
    if maps.variable(name) not in maps.ds and at.altitude_m is not None:
        return values_of(maps, name, at.altitude_m, at.time)
    return maps.m(name, at.altitude_m, time=at.time, time_of_day=at.time_of_day)


def _cost(maps: MetricMaps, name: str, at: Place) -> np.ndarray:
    return np.asarray(maps.metrics[name].cost(_held(maps, name, at)))


def _h_norm(maps: MetricMaps, at: Place) -> np.ndarray:
    altitude_m = maps.altitudes_m[0] if at.altitude_m is None else at.altitude_m
    return maps.normalised(altitude_m, time=at.time, time_of_day=at.time_of_day)


def _metric(maps: MetricMaps, name: str, _: np.ndarray) -> Colours:
    return metric_colours(maps, name)


def _always(colours: Colours, _: np.ndarray) -> Colours:
    return colours


def _plain(label: str, values: np.ndarray, colour_map: str = "viridis") -> Colours:
    low, high = ends_of(values)
    return Colours(colour_map, Normalize(low, high if high > low else low + 1), label)


def _obstacles(_: np.ndarray) -> Colours:
    return Colours(
        ListedColormap([FREE_COLOUR, BUILT_COLOUR]), BoundaryNorm([-0.5, 0.5, 1.5], 2), "Obstacles", ticks=()
    )


def _roofs(values: np.ndarray) -> Colours:
    return replace(roof_colours(ends_of(values)[1]), label="roof above ground (m)")


NO_BUILDING, NOBODY = ("no building", EMPTY_COLOUR), ("no people in the data", EMPTY_COLOUR)
GROUND: dict[str, tuple[str, str, tuple[str, str] | None, Callable[[np.ndarray], Colours]]] = {
    # heading, unit, what 0 means and its colour, colours
    "roof": ("Roofs, at the middle of a cell", "m", NO_BUILDING, _roofs),
    "roof_touched": ("Roofs, the highest that touches a cell", "m", NO_BUILDING, _roofs),
    "density": ("People", "per km²", NOBODY, lambda values: density_colours(ends_of(values)[1])),
    "terrain": ("Terrain", "m", None, partial(_plain, "elevation of the ground (m)", colour_map=HEIGHT_COLOUR_MAP)),
}


def difference(values: np.ndarray, minus: np.ndarray) -> np.ndarray:
    """Return ``[Y, X]`` values less others: `OBSTACLE` where one of them is, `NOTHING` where no number comes out."""
    with np.errstate(invalid="ignore"):
        found = values - minus
    found[~np.isfinite(found)] = NOTHING
    found[(values == OBSTACLE) | (minus == OBSTACLE)] = OBSTACLE
    return found


def legend_of(maps: MetricMaps, layer: Layer, values: np.ndarray, *, is_difference: bool = False) -> dict[str, Any]:
    """Return how values become colours on the page, as JSON holds it.

    ``edges`` has one number more than there are ``colours`` (base64, three bytes each): colour k is drawn from edge k
    up to edge k + 1, the first and the last one beyond them too. ``flat`` are the colours of cells in obstacles, of
    those without a value, and of a value of 0, where that is drawn apart; ``html`` is the legend.
    """
    is_changed = np.isfinite(values) & (values != 0)
    scale = difference_colours(np.abs(values[is_changed]), DIFFERENCE) if is_difference else layer.colours(values)
    zero = None if is_difference else layer.zero
    patches = [zero] if zero else []
    patches += [("obstacle", layer.blocked)] if ALTITUDE in layer.dims and layer.name != "obstacle" else []
    patches += [NO_DATA_PATCH] if np.isnan(values).any() or not maps.ds["has_data"].values.all() else []
    flat = [layer.blocked, NO_DATA_PATCH[1], zero and zero[1]]
    if isinstance(scale.norm, BoundaryNorm):  # classes, and no bar
        edges, ticks, marks = scale.norm.boundaries, [], []
        colours = scale.cmap(np.arange(len(edges) - 1), bytes=True)[:, :3]  # type: ignore[operator]
        patches = [("free", FREE_COLOUR), ("obstacle", BUILT_COLOUR), *patches]
    else:
        steps = np.linspace(0, 1, 257)
        edges = scale.norm.inverse(steps)
        colours = scale(np.asarray(scale.norm.inverse((steps[:-1] + steps[1:]) / 2)), bytes=True)[:, :3]
        ticks = bar_ticks(scale, BAR_IN, is_lying=True)
        texts = [tick_label(value) for value in ticks]
        texts[0] = f"≤ {texts[0]}" if scale.extend in ("min", "both") else texts[0]
        texts[-1] = f"≥ {texts[-1]}" if scale.extend in ("max", "both") else texts[-1]
        marks = [(float(scale.norm(value)), text) for value, text in zip(ticks, texts, strict=True)]
    return {
        "flat": flat,
        "edges": [float(f"{edge:.9g}") for edge in np.asarray(edges, float)],  # as fine as a float32
        "colours": base64.b64encode(colours.tobytes()).decode("ascii"),
        "ticks": ticks,
        "html": legend(plain_label(scale.label), colours[::8], marks, patches),
    }


def find_layer(layers: Mapping[str, Layer], name: Any) -> Layer:
    """Return a layer by its name.

    Raises:
      InputError: there is none.
    """
    return layers[one_of("layer", name, layers)]


def plain_label(label: str) -> str:
    """Return a label of matplotlib without its mathematics: ``m_gps``."""
    return re.sub(r"\$(\w)_\\mathrm\{(\w+)\}\$", r"\1_\2", label).replace("\n", " ")
