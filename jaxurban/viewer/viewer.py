"""Viewer: maps and what answers the page about them, whichever door it came in by."""

import json
import math
from collections.abc import Callable
from functools import cached_property
from html import escape
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np

from jaxurban.checks import one_of
from jaxurban.errors import InputError, RemadeError
from jaxurban.io.store import OPENED
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.metrics.gps import FIX
from jaxurban.metrics.weights import WeightsLike
from jaxurban.paths.export.base import waypoints
from jaxurban.paths.export.write import FORMATS
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.profile import CLEARANCE, cautious_profile, without_fix
from jaxurban.paths.sight import Sight
from jaxurban.paths.sky import sky_from
from jaxurban.planners.base import Status
from jaxurban.planners.registry import PLANNERS
from jaxurban.report.figures.frame import guesses_said, place_said, rules_said, time_said
from jaxurban.report.figures.metrics import line_colour
from jaxurban.report.figures.paths import planner_colours
from jaxurban.settings import Preset
from jaxurban.studies.map_comparison import OneMap
from jaxurban.viewer import markup
from jaxurban.viewer.base import base_of
from jaxurban.viewer.layers import H_NORM, DrawnLayer, layers_of, legend_of
from jaxurban.viewer.markup import number, options, sentences
from jaxurban.viewer.plans import Plans
from jaxurban.viewer.requests import Cell, Plan, Request, Save, Sky, Tile, View, parse
from jaxurban.viewer.sky import sky_html
from jaxurban.viewer.tiles import TILE, Kept, lonlat_fit, strides_of, tile_bytes

JSON, BYTES = "application/json", "application/octet-stream"
OPACITY_PERCENT = 70  # of a map over streets
BLOCK = 128  # cells a side that are read at once for the values under the pointer
PLANNER_LINES = planner_colours(PLANNERS)
TOTALS = {  # of `RouteReport.totals`, as the page shows them
    "length_m": ("Length", "m"),
    "cost": ("Cost", ""),
    "people_overflown": ("People overflown", ""),
    "no_fix_m": ("Without a fix", "m"),
    "nearest_wall_m": ("Least clearance", "m"),
    "least_over_roofs_m": ("Least over roofs", "m"),
    "time_s": ("Time", "s"),
    "energy_wh": ("Energy", "Wh"),
}


class Answer(NamedTuple):
    """What a request gives."""

    kind: str
    body: bytes


class Viewer:
    """Maps, and the answers to what the page asks.

    Args:
      maps: that are looked at and planned on.
      name: what they are called.
      folder, weights, preset: of `Plans`.

    Raises:
      InputError: as of `Plans`.

    Attributes:
      key: of this viewer alone: a page that has another's answers asks for no more of them here.
    """

    def __init__(
        self,
        maps: MetricMaps,
        *,
        name: str = "the maps",
        folder: str = "",
        weights: WeightsLike = None,
        preset: Preset = "",
    ) -> None:
        self.plans = Plans(maps, folder, weights, preset)
        self.maps, self.name = self.plans.maps, name
        self.layers = layers_of(self.maps)
        self.kept, self.key = Kept(), uuid4().hex
        self._answers: dict[str, tuple[type[Request], Callable[[Any], Any]]] = {
            "scene": (Request, self.scene),
            "base": (Request, self.base),
            "legend": (View, self.legend),
            "tile": (Tile, self.tile),
            "values": (Cell, self.values_at),
            "sky": (Sky, self.sky),
            "plan": (Plan, self.plan),
            "report": (Plan, self.report),
            "save": (Save, self.save),
        }

    def answer(self, name: Any, params: Any) -> Answer:
        """Return what a request gives: JSON, or the bytes of a tile or a file.

        Raises:
          InputError: no such request, or parameters that it does not take.
          RemadeError: the maps were made again.
        """
        self.check_current()
        kind, make = self._answers[one_of("the request", name, self._answers)]
        made = make(parse(kind, params))
        return Answer(BYTES, made) if isinstance(made, bytes) else Answer(JSON, as_json(made))

    def check_current(self, key: str = "") -> None:
        """Raise RemadeError if the maps were written again since they were opened, or a page has another viewer's key.

        What is kept of them would be drawn beside what is read now.
        """
        if key not in ("", self.key):
            raise RemadeError(
                "the maps of this page were made again or removed since they were opened: load it again"
            )
        if OPENED in self.maps.ds.encoding:
            self.maps.ds.encoding[OPENED].check()

    def scene(self, _: Request) -> dict[str, Any]:
        """Return what the page must know before it asks for anything else; ``html`` fills its places by name."""
        grid = self.maps.grid
        north_deg = math.degrees(grid.convergence_rad(*grid.centre_lonlat))
        return {
            "key": self.key,
            "rows": grid.num_rows,
            "cols": grid.num_cols,
            "resolution_m": grid.resolution_m,
            "corner_m": [grid.x_min_m, grid.y_min_m],
            "lonlat": lonlat_fit(grid),
            "layers": [
                {"name": name, "dims": layer.dims} | _words(layer)
                for name, layer in self.layers.items()
            ],
            "tile": TILE,
            "strides": strides_of(grid.shape),
            "weights": {name: float(self.plans.weights[name]) for name in self._labels},
            "planner_colours": PLANNER_LINES,
            "altitudes_m": self.maps.altitudes_m,
            "has_base": self.maps.base_map is not None,
            "no_fix": FIX if FIX in self.layers else None,
            "fields": {
                "cost_model": self.plans.cost_model.kind,
                "obstacles": self.maps.obstacles,
                "clearance_m": self.plans.limits.clearance_m,
                "vertical_clearance_m": self.plans.limits.vertical_clearance_m,
                "flight_m": next(iter(self.maps.altitudes_m), 0.0),
                "opacity": 100 if self.maps.base_map is None else OPACITY_PERCENT,
            },
            "can_plan": True,
            "html": self._texts(north_deg),
        }

    def base(self, _: Request) -> dict[str, Any]:
        """Return the base map (`base_of`)."""
        return base_of(self.maps)

    def _texts(self, north_deg: float) -> dict[str, str]:
        """Return the texts and lists of the page by the names of their places."""
        grid, maps, layers = self.maps.grid, self.maps, self.layers
        cells = f"{grid.num_rows:,} × {grid.num_cols:,} cells of {grid.resolution_m:g} m"
        summaries = {name: entry.summary for name, entry in PLANNERS.items()}
        first = next((name for name in ("gps", H_NORM) if name in layers), next(iter(layers)))
        north = f"true north {abs(north_deg):.2f}° {'west' if north_deg > 0 else 'east'} of the grid's north"
        guessed = guesses_said(maps, has_sky=True)
        return {
            "title": escape(self.name),
            "guesses": escape(guessed and f"Guessed: {guessed}"),
            "guesses-text": escape("\n".join(maps.guesses.values())),
            "place": "<br>".join([place_said(grid), f"{cells} · {grid.crs}", north]),
            "credit": escape(maps.attribution),
            "sliders": markup.sliders(self._labels, self._colours),
            "planners": markup.planners(summaries, PLANNER_LINES, "astar-plus"),
            "formats": markup.save_buttons(FORMATS, of_waypoints=False),
            "formats-of-waypoints": markup.save_buttons(FORMATS, of_waypoints=True),
            "altitude": options([f"{z_m:g} m" for z_m in maps.altitudes_m]),
            "time_of_day": options(maps.times_of_day),
            "time": options([*map(time_said, self.axes[TIME])]),
            "layer": markup.layer_options(
                ((name, each.variable.heading, each.group) for name, each in layers.items()), first
            ),
            "north": f'<path d="M0-12 5 8 0 4-5 8Z" transform="rotate({-north_deg:.2f})"/>',
        }

    @cached_property
    def axes(self) -> dict[str, tuple]:
        """The altitudes, times and times of day that maps are chosen by; no times of a series with statistics."""
        maps = self.maps
        times = maps.times if maps.default_time is not None else ()
        return {ALTITUDE: maps.altitudes_m, TIME: times, TIME_OF_DAY: maps.times_of_day}

    @cached_property
    def _labels(self) -> dict[str, str]:
        return {"distance": "Distance"} | {
            name: metric.label for name, metric in self.maps.metrics.items()
        }

    @cached_property
    def _colours(self) -> dict[str, str]:
        return {name: line_colour(name) for name in self._labels}

    def place(
        self, at: tuple[int, int, int], dims: tuple[str, ...] = (ALTITUDE, TIME, TIME_OF_DAY)
    ) -> OneMap:
        """Return altitude, time and time of day by their numbers, those of the dims alone.

        Raises:
          InputError: a number beyond the list.
        """
        chosen: list[Any] = []
        for (dim, values), index in zip(self.axes.items(), at, strict=True):
            if dim not in dims or not values:
                chosen.append(None)
            elif index < len(values):
                chosen.append(values[index])
            else:
                raise InputError(
                    f"{dim} {index} does not exist: these maps hold {len(values)}, numbered from 0"
                )
        return OneMap(*chosen)

    def flight(self, query: Plan) -> OneMap:
        """Return altitude, time and time of day of a route; the altitude may lie between those of the maps."""
        at = self.place(query.at)
        if query.flight_m is None or at.altitude_m is None:
            return at
        return at._replace(altitude_m=query.flight_m)

    def values(self, view: View) -> np.ndarray:
        """Return the values ``[Y, X]`` of a map as they travel (`DrawnLayer.values`)."""
        layer = self.layers[one_of("layer", view.layer, self.layers)]
        at = self.place(view.at, layer.dims)
        return self.kept.get((view.layer, at), lambda: layer.values(at))

    def legend(self, view: View) -> dict[str, Any]:
        """Return how these values become colours (`legend_of`)."""
        values = self.values(view)  # refuses an unknown layer
        return legend_of(self.layers[view.layer], values)

    def tile(self, tile: Tile) -> bytes:
        """Return a tile of what is drawn (`tile_bytes`)."""
        return tile_bytes(self.values(tile), tile.stride, tile.row, tile.col)

    def values_at(self, cell: Cell) -> list[dict[str, Any]]:
        """Return the value of every layer in a cell: name, value (None for none) and its words (`_words`)."""
        grid = self.maps.grid
        if not (cell.row < grid.num_rows and cell.col < grid.num_cols):
            raise InputError(
                f"the cell {cell.row}, {cell.col} is outside: there are {grid.num_rows} x {grid.num_cols}"
            )
        is_inside = self._value_in(self.layers["obstacle"], cell) != 0
        values = []
        for name, layer in self.layers.items():
            words = _words(layer)
            if not words["told"]:
                continue
            value = math.nan if is_inside and layer.is_hidden else self._value_in(layer, cell)
            values.append({"name": name, "value": _number(value), **words})
            if name == "density":
                words |= {"told": "People in the cell", "unit": ""}
                people = value * grid.resolution_m**2 / 1e6
                values.append({"name": "people", "value": _number(people), **words})
        return values

    def _value_in(self, layer: DrawnLayer, cell: Cell) -> float:
        """Return a layer's value in a cell; of maps on disk a block around it is read and kept."""
        at = self.place(cell.at, layer.dims)
        variable = self.maps.variable(layer.name)
        if variable not in self.maps.ds:
            value = self.values(View(layer=layer.name, at=cell.at))[cell.row, cell.col]
            return float(value) if np.isfinite(value) else math.nan
        array = self.maps.ds[variable]
        row, col = cell.row // BLOCK * BLOCK, cell.col // BLOCK * BLOCK
        part: dict[str, Any] = dict(zip((ALTITUDE, TIME, TIME_OF_DAY), cell.at, strict=True))
        part |= {"y": slice(row, row + BLOCK), "x": slice(col, col + BLOCK)}
        key = "block", layer.name, at, row, col
        block = self.kept.get(key, lambda: array.isel(part, missing_dims="ignore").values)
        return float(block[cell.row - row, cell.col - col])

    @cached_property
    def _sight(self) -> Sight:
        """The city of the maps, read again when the first sky is asked for."""
        return Sight.of(self.maps, None, None, None)

    def sky(self, query: Sky) -> str:
        """Return the sky over a place (`sky_html`).

        Raises:
          InputError: maps in memory, or whose files are gone; without altitudes or times; a place far away.
        """
        at = self.place(query.at)
        if at.altitude_m is None:
            raise InputError("these maps hold no altitudes, so a sky has no height to be seen from")
        return sky_html(sky_from(self._sight, query.place, at.altitude_m, time=at.time))

    def plan(self, query: Plan) -> dict[str, Any]:
        """Return a route: its points, cost and message, and the command that gives the same."""
        at = self.flight(query)
        planned = self.plans.route(query, at)
        has_path, text = planned.status.has_path, "no path"
        if has_path:
            text = f"cost {number(planned.cost)} · {planned.length_m / 1000:.2f} km"
        notes = [status_said(planned), *self.plans.moved(query, at)]
        return {
            "planner": query.planner,
            "has_path": has_path,
            "xy_m": planned.xy_m,
            "cost": _number(planned.cost),
            "cost_by_layer": dict(planned.cost_by_layer),
            "button": markup.route_button(query.planner, PLANNER_LINES[query.planner], text, notes),
            "html": markup.costs(planned.cost_by_layer, self._labels, self._colours),
            "message": " ".join(filter(None, (planned.search.sentence, planned.search.note))),
            "command": self.plans.command(query, at),
        }

    def report(self, query: Plan) -> dict[str, Any]:
        """Return what a route meets: cautions, totals, the profile and where its crossings lie, its report as text.

        ``mission`` are the points of files of waypoints, and ``saved`` their number, their cost and least clearance.
        """
        at = self.flight(query)
        report, planned = self.plans.report(query, at)
        mission = self.plans.mission(query, at)
        table, totals = report.profile, report.totals
        lines = {
            name: (metric.label, self._colours[name]) for name, metric in self.maps.metrics.items()
        }
        drawing = markup.profile(table, lines, without_fix(table))
        rows = [
            (label, f"{number(totals[name])} {unit}")
            for name, (label, unit) in TOTALS.items()
            if name in totals
        ]
        lonlat = waypoints(mission).lonlat
        saved = [f"{len(lonlat)} waypoints, cost {number(mission.cost)}"]
        if planned.cost > 0:
            saved.append(f"{mission.cost / planned.cost - 1:+.1%}")
        saved += self._least_clearance(mission, totals[CLEARANCE])
        return {
            "cautions": sentences((each.level, each) for each in report.cautions),
            "totals": markup.rows(rows),
            "profile": drawing + sentences([("note", rules_said(planned.settings))]),
            "to_share": np.round(table["to_m"].to_numpy() / max(planned.length_m, 1e-9), 5),
            "xy": self._on_page(table[["lon", "lat"]].to_numpy()),
            "report-text": escape(report.table()),
            "mission": self._on_page(lonlat),
            "saved": ", ".join(saved),
        }

    def _least_clearance(self, mission: PlannedPath, route_m: float) -> list[str]:
        """Return the least clearance of a mission as HTML, beside the route's where that is more; [] without one."""
        least_m = float(cautious_profile(mission, self.maps)[CLEARANCE].min())
        if not math.isfinite(least_m):
            return []
        text = f"least clearance {number(least_m)} m"
        if least_m < route_m and number(least_m) != number(route_m):
            text = f"{text}, the route {number(route_m)} m"
        level = next(each.level for each in mission.cautions if each.startswith("Buildings"))
        return [f'<b class="jv-{level}">{text}</b>']

    def _on_page(self, lonlat: np.ndarray) -> np.ndarray:
        """Return places ``[N, 2]`` in metres from the maps' southwest corner."""
        grid = self.maps.grid
        x_m, y_m = grid.xy_of_lonlat(*lonlat.T)
        return np.round(np.stack([x_m - grid.x_min_m, y_m - grid.y_min_m], axis=-1), 1)

    def save(self, query: Save) -> bytes:
        """Return a route as a file."""
        route = Plan(**query.model_dump(exclude={"format"}))
        return self.plans.file(route, self.flight(query), query.format)


def status_said(planned: PlannedPath) -> str:
    """Return how a planner ended, among which paths, and how far above the cheapest of them its path is at most."""
    search, has_path = planned.search, planned.status.has_path
    text = planned.status.value
    if has_path and search.graph:
        text = f"{text} ({search.graph})"
    if has_path and planned.status is not Status.OPTIMAL and search.gap < math.inf:
        text = f"{text}, at most {search.gap:.1%} above the cheapest"
    return text


def unit_of(layer: DrawnLayer) -> str:
    """Return the unit of a layer's values as people read it; "" for m, for counts and for dilutions of precision."""
    return {"1": "", "km-2": "per km²"}.get(layer.variable.unit, layer.variable.unit)


def _words(layer: DrawnLayer) -> dict[str, Any]:
    """Return what a layer is told as in the list of values of a cell ("" where it is not in it), classes and unit."""
    variable = layer.variable
    label = variable.symbol or variable.heading
    if layer.group == "Costs" and layer.name != H_NORM:
        label = ""
    classes = [name for name, _ in variable.classes]
    return {"told": label, "classes": classes, "unit": unit_of(layer)}


def as_json(value: Any) -> bytes:
    """Return a value as JSON; arrays are lists."""
    return json.dumps(
        value, allow_nan=False, separators=(",", ":"), default=lambda array: array.tolist()
    ).encode()


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
