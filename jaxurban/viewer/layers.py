"""The layers that the viewer draws: which there are, their values and their colours, which are those of our figures."""

import base64
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm

from jaxurban.draw.frame import BLOCKED_COLOUR, NO_DATA_PATCH, OBSTACLE_COLOUR
from jaxurban.draw.metrics import (
    EMPTY_COLOUR,
    class_patches,
    colours_of,
    drawn_variables,
    metric_colours,
    obstacle_patches,
    values_of,
)
from jaxurban.draw.paths import colours_of_cost
from jaxurban.draw.style import Colours, bar_ticks, ends_of, tick_label
from jaxurban.flights.return_altitude import LONG_NAME, NAME
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.shared import OneMap
from jaxurban.metrics.base import ALTITUDE, Scale, Variable
from jaxurban.metrics.custom import is_of_sky
from jaxurban.metrics.gps import DOPS, FIX
from jaxurban.metrics.variables import BUILT_COLOUR, FREE_COLOUR
from jaxurban.paths.closed import CAUSES, causes_at, obstacles_at
from jaxurban.paths.plan import rules_on
from jaxurban.viewer.markup import legend

# Of the causes that close cells without an obstacle.
CAUSE_COLOURS = "#8da0cb", "#66c2a5", "#a6d854", "#fc8d62", "#e78ac3"
H_NORM, DILUTION = "h_norm", "Dilution of precision"
BAR_COLOURS = 256  # steps of the bar of a layer without classes
CLOSED = Variable(
    "closed",
    "closed to routes",
    dims=(ALTITUDE,),
    classes=tuple(
        zip(
            CAUSES,
            (FREE_COLOUR, BUILT_COLOUR, NO_DATA_PATCH[1], *CAUSE_COLOURS),
            strict=True,
        )
    ),
)
# Of cells without a fix and of those that are closed: the colour of their stripes, and its slope; and as CSS.
STRIPES = "repeating-linear-gradient({}deg,{} 0 1px,transparent 1px 4px)"
HATCHES = {"no-fix": ["#d01824", 1], "closed": ["#3a3f4599", -1]}
CLOSED_PATCH = "closed to routes", STRIPES.format(45, HATCHES["closed"][0])
RETURN = Variable(
    NAME, LONG_NAME, "m", title="Return altitude: click home", scale=Scale(low=None, high=None)
)
LABELS = {
    CLOSED.name: "closed to routes, by the first cause",
    NAME: f"{LONG_NAME}, in metres",
}
NO_FIX_PATCH = "no fix", STRIPES.format(135, HATCHES["no-fix"][0])
# How values travel of a cell in an obstacle, and of a cell that is not drawn.
OBSTACLE, NOTHING = np.float32(-np.inf), np.float32(np.nan)


@dataclass(frozen=True)
class DrawnLayer:
    """A layer of maps that can be drawn.

    Attributes:
      maps: the maps.
      name: the layer's name in requests.
      variable: its heading, unit, classes and dimensions.
      group: heading of the list in which the page offers it.
    """

    maps: MetricMaps
    name: str
    variable: Variable
    group: str

    @property
    def dims(self) -> tuple[str, ...]:
        """Which of ``altitude``, ``time`` and ``time_of_day`` it varies with."""
        return self.variable.dims

    @property
    def is_hidden(self) -> bool:
        """Whether it has no values inside obstacles."""
        return ALTITUDE in self.dims and self.name not in ("obstacle", CLOSED.name)

    @property
    def blocked(self) -> str:
        """Colour of cells inside obstacles."""
        return BLOCKED_COLOUR if self.name == H_NORM else OBSTACLE_COLOUR

    def values(self, at: OneMap) -> np.ndarray:
        """Return the values ``[Y, X]`` float32 at an altitude, time and time of day.

        In a layer without values inside obstacles, a cell that is not free at the altitude is `OBSTACLE` where
        the obstacle is in the maps, and `NOTHING` where they have no data.
        """
        values = np.asarray(self._read(at), np.float32)
        if not self.is_hidden or at.altitude_m is None:
            return values

        values = np.where(self.maps.is_free(at.altitude_m, "centre"), values, NOTHING)
        return np.where(obstacles_at(self.maps, at.altitude_m), OBSTACLE, values)

    def _read(self, at: OneMap) -> np.ndarray:
        """Return the values ``[Y, X]`` without regard to obstacles: a map's, or computed from maps.

        The sum of costs, `H_NORM`, is that of the lowest altitude where none is asked for.
        """
        maps, name = self.maps, self.name
        altitude_m = maps.altitudes_m[0] if at.altitude_m is None else at.altitude_m
        if name == CLOSED.name:
            return causes_at(maps, rules_on(maps, None, None, "")[2], altitude_m)
        if name == H_NORM:
            return maps.normalised(altitude_m, time=at.time, time_of_day=at.time_of_day)

        # A map, or what is computed from several maps at an altitude.
        if maps.variable(name) not in maps.ds and at.altitude_m is not None:
            return values_of(maps, name, at.altitude_m, at.time)
        return maps.m(name, at.altitude_m, time=at.time, time_of_day=at.time_of_day)

    def colours(self, values: np.ndarray) -> Colours:
        """Return the colour map, scale and label by which values ``[Y, X]`` of this layer are drawn.

        A layer that varies with nothing, and all costs together, have a scale of their own values; all maps of another
        layer share one scale.
        """
        if self.name == H_NORM:
            return colours_of_cost(values)
        if self.name in LABELS:
            return colours_of(self.variable, lambda: values, LABELS[self.name])
        return metric_colours(self.maps, self.name, None if self.dims else values)


def layers_of(maps: MetricMaps) -> dict[str, DrawnLayer]:
    """Return every layer of these maps that can be drawn, by name.

    The order is that of the page's list: metrics, all costs together, satellites, the ground, all else.
    """
    variables = drawn_variables(maps)
    layers: dict[str, DrawnLayer] = {}

    def add(name: str, variable: Variable, group: str) -> None:
        """Add a layer behind the others."""
        layers[name] = DrawnLayer(maps, name, variable, group)

    # Metrics, and their costs together, which vary with all that a metric varies with.
    metric_dims = [ALTITUDE]
    for name in maps.metrics:
        add(name, variables[name], "Metrics")
        metric_dims += variables[name].dims
    total = Variable(H_NORM, "all costs together", dims=tuple(dict.fromkeys(metric_dims)))
    add(H_NORM, total, "Costs")

    add(CLOSED.name, CLOSED, "Costs")

    # The variables that are no metric.
    for group in ("Satellites", DILUTION, "Ground", "Further maps"):
        for name, variable in variables.items():
            if name not in maps.metrics and group == _group(maps, variable):
                add(name, variable, group)
    add(NAME, RETURN, "Ground")
    return layers


def _group(maps: MetricMaps, variable: Variable) -> str:
    """Return the heading of the list in which a variable stands that is neither a metric nor a cost."""
    if variable.name in DOPS:
        return DILUTION
    if is_of_sky(maps.ds, variable):
        return "Satellites"
    return "Further maps" if ALTITUDE in variable.dims and variable.name != "obstacle" else "Ground"


def legend_of(layer: DrawnLayer, values: np.ndarray) -> dict[str, Any]:
    """Return how values ``[Y, X]`` of a layer become colours on the page, as JSON holds it.

    Returns:
      ``edges``, ``[N + 1]`` values, and ``colours``, ``[N, 4]`` bytes (red, green, blue and 255) in base64: colour k is
      drawn from edge k up to edge k + 1, the first and the last one beyond them too. Of a bar the last one is that of
      values beyond its end, where there are any. ``ticks`` are the values that are marked on the bar, [] for classes.
      ``flat`` are the colours (`_packed`) of a cell in an obstacle, of a cell without a value, and of the value 0, None
      where 0 has no colour of its own. ``html`` is the legend.
    """
    maps = layer.maps
    scale = layer.colours(values)
    zero = layer.variable.scale.zero  # what the value 0 is called where it has a colour of its own

    # Flat colours: of pixels, and of the patches of the legend.
    zero_pixel = _packed(EMPTY_COLOUR) if zero else None
    obstacle, *no_data = obstacle_patches(maps, layer.blocked)
    if np.isnan(values).any():
        no_data = [NO_DATA_PATCH]
    candidates = {
        (zero, EMPTY_COLOUR): zero,
        obstacle: layer.is_hidden,
        CLOSED_PATCH: layer.name != CLOSED.name,
        NO_FIX_PATCH: FIX in maps.ds,
    }
    patches = [patch for patch, is_drawn in candidates.items() if is_drawn] + no_data

    # Classes are patches too and have no bar; a bar has `BAR_COLOURS` colours, each that of its middle.
    ticks: list[float] = []
    if isinstance(scale.norm, BoundaryNorm):
        edges = scale.norm.boundaries
        colours = scale.cmap(np.arange(len(edges) - 1), bytes=True)  # type: ignore[operator]
        patches = [*class_patches(layer.variable, values), *patches]
    else:
        steps = np.linspace(0, 1, BAR_COLOURS + 1)
        edges = scale.norm.inverse(steps)
        middles = scale.norm.inverse((steps[:-1] + steps[1:]) / 2)
        colours = scale(np.asarray(middles), bytes=True)
        ticks = bar_ticks(scale)

    # Every eighth colour is enough for the bar's gradient. What lies beyond its end has a colour of its own.
    gradient = colours[::8, :3]
    _, greatest = ends_of(values)
    if ticks and greatest > edges[-1]:
        edges = np.append(edges, greatest)
        colours = np.append(colours, scale(np.array([greatest]), bytes=True), axis=0)
    return {
        "flat": [_packed(layer.blocked), _packed(NO_DATA_PATCH[1]), zero_pixel],
        # Digits enough for a float32.
        "edges": [float(f"{edge:.9g}") for edge in np.asarray(edges, float)],
        "colours": base64.b64encode(colours.tobytes()).decode("ascii"),
        "ticks": ticks,
        "html": legend(plain_label(scale.label), gradient, _marks(scale, ticks), patches),
    }


def _marks(scale: Colours, ticks: list[float]) -> list[tuple[float, str]]:
    """Return where each tick stands along the bar, from 0 to 1, and its text; [] without ticks.

    Where the end of the bar stands for all values beyond it too, its tick says so by ≤ or ≥.
    """
    texts = [tick_label(value) for value in ticks]
    if ticks and scale.extend in ("min", "both"):
        texts[0] = f"≤ {texts[0]}"
    if ticks and scale.extend in ("max", "both"):
        texts[-1] = f"≥ {texts[-1]}"
    places = [float(scale.norm(value)) for value in ticks]
    return list(zip(places, texts, strict=True))


def _packed(colour: str) -> int:
    """Return a colour as a pixel of the page: its bytes are red, green, blue and 255."""
    return int.from_bytes(bytes.fromhex(colour.removeprefix("#")) + b"\xff", "little")


def plain_label(label: str) -> str:
    """Return a label of matplotlib without its mathematics: ``m_gps``."""
    return re.sub(r"\$(\w)_\\mathrm\{(\w+)\}\$", r"\1_\2", label).replace("\n", " ")
