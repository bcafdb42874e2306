"""Viewer: maps and what answers the page about them, whichever door it came in by."""

import json
import math
import re
import warnings
from collections.abc import Callable
from functools import cached_property, partial
from html import escape
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np
import pandas as pd

from jaxurban.checks import one_of
from jaxurban.draw.frame import guesses_said, place_said, rules_said, time_said
from jaxurban.draw.metrics import group_numbers, line_colour
from jaxurban.draw.profile import ALTITUDE_COLOUR
from jaxurban.draw.routes import EDGE_PT, LINE_PT, planner_colours, widths_of
from jaxurban.errors import InputError, JaxurbanError, RemadeError
from jaxurban.flights.check import check
from jaxurban.flights.export.base import waypoints
from jaxurban.flights.missions.mission import MOST_BYTES, read_mission
from jaxurban.flights.report import FOUND_COLOUR
from jaxurban.flights.return_altitude import NAME, return_altitude
from jaxurban.io.city import NEAR_M, City
from jaxurban.io.store import OPENED
from jaxurban.io.tables import number_or_none
from jaxurban.knowledge import shown_rule
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.shared import OneMap
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.metrics.gps import FIX
from jaxurban.metrics.variables import GROUP_COLOURS
from jaxurban.metrics.weights import WeightsLike
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.profile import cautious_profile
from jaxurban.paths.route_report import CLEARANCE, short
from jaxurban.planners.registry import BY_METHOD, PLANNERS
from jaxurban.progress import LOG
from jaxurban.receivers.along import sky_from
from jaxurban.receivers.sight import Sight
from jaxurban.settings import CLEARANCES, DEFAULTS, Preset, Vehicle
from jaxurban.viewer import markup
from jaxurban.viewer.base import base_of
from jaxurban.viewer.layers import (
    CLOSED,
    H_NORM,
    HATCHES,
    NOTHING,
    DrawnLayer,
    layers_of,
    legend_of,
)
from jaxurban.viewer.markup import options, sentences
from jaxurban.viewer.outlines import STEP_M, packed_outlines
from jaxurban.viewer.plans import Plans
from jaxurban.viewer.requests import (
    Cell,
    MissionRequest,
    Plan,
    Request,
    Save,
    SkyRequest,
    Tile,
    View,
    parse,
)
from jaxurban.viewer.sky import sky_html
from jaxurban.viewer.tiles import TILE, Kept, lonlat_fit, packed_tile, strides_of
from jaxurban.world.grid import crs_said

JSON, BYTES = "application/json", "application/octet-stream"
BLOCK = 128  # cells a side that are read at once for the values under the pointer
PX_PER_PT = 96 / 72  # of CSS
PLANNER_LINES = planner_colours(PLANNERS)
TOTALS = (  # of `RouteReport.facts`; the costs of layers stand below these, and the whole report is in a fold
    "length m",
    "cost",
    "people overflown",
    "no fix m",
    "below gps floor m",
    "nearest wall m",
    "least over roofs m",
    "return altitude m",
    "time s",
    "energy wh",
)


# In brackets: an option of the command, behind its argument or alone; the page has no field for it.
OF_COMMAND = re.compile(r"\((?:\w+, )?(?=--)")
STATE_LEVELS = {"clean": "note", "findings": "limit", "not-judged": "guess"}  # as of cautions


class Answer(NamedTuple):
    """The answer to a request: its media type, such as `JSON`, and its bytes."""

    kind: str
    body: bytes


class Viewer:
    """Maps, and the answers to what the page asks.

    Args:
      maps: the maps that are looked at and planned on.
      name: what the page calls the maps.
      folder, weights, preset: as for `Plans`.
      sources: the folder at which the relative paths of the maps' sources begin, from which outlines and skies are
        read; left out, the folder beside the maps.

    Raises:
      InputError: as for `Plans`.

    Attributes:
      key: a text that no other viewer has; a page with another viewer's key gets no answers.
      kept: the arrays that were drawn or looked at last.
    """

    def __init__(
        self,
        maps: MetricMaps,
        *,
        name: str = "the maps",
        folder: str = "",
        weights: WeightsLike = None,
        preset: Preset = "",
        sources: str | Path | None = None,
    ) -> None:
        # The maps, under the preset's rule of obstacles.
        self.plans = Plans(maps, folder, weights, preset)
        self.maps, self.name = self.plans.maps, name
        self.layers = layers_of(self.maps)

        self.sources = sources
        self.kept = Kept()
        self.key = uuid4().hex
        # The class of the parameters and the function that answers, by the name of a request.
        self._answers: dict[str, tuple[type[Request], Callable[[Any], Any]]] = {
            "scene": (Request, self.scene),
            "base": (Request, self.base),
            "outlines": (Request, self.outlines),
            "legend": (View, self.legend),
            "tile": (Tile, self.tile),
            "values": (Cell, self.values_at),
            "sky": (SkyRequest, self.sky),
            "plan": (Plan, self.plan),
            "why": (Plan, self.why),
            "stands": (SkyRequest, self.stands),
            "report": (Plan, self.report),
            "save": (Save, self.save),
            "check": (MissionRequest, self.check),
        }

    def answer(self, name: Any, params: Any) -> Answer:
        """Return the answer to a request: JSON, or the bytes of a tile, of outlines or of a file.

        Args:
          name: of the request, as in the page's script; any value of JSON.
          params: its parameters, any value of JSON; they are checked here.

        Raises:
          InputError: there is no such request, or it does not take these parameters.
          RemadeError: the maps were made again.
        """
        self.check_current()
        request_type, answer_to = self._answers[one_of("the request", name, self._answers)]
        result = answer_to(parse(request_type, params))
        if isinstance(result, bytes):
            return Answer(BYTES, result)
        return Answer(JSON, as_json(result))

    def check_current(self, key: str = "") -> None:
        """Check that maps and page are the ones that this viewer opened and answers; "" is the key of no page.

        Otherwise values that were kept of the maps before would be drawn beside values that are read now.

        Raises:
          RemadeError: the maps were written again since they were opened, or the page has another viewer's key.
        """
        if key not in ("", self.key):
            raise RemadeError(
                "the maps of this page were made again or removed since they were opened: load it again"
            )
        if OPENED in self.maps.ds.encoding:
            self.maps.ds.encoding[OPENED].check()

    def scene(self, _: Request) -> dict[str, Any]:
        """Return what the page must know before it asks for anything else.

        ``fields`` are the values at which the page's controls start, "" for an empty control; ``html`` holds the texts
        that are put into the page, by the names of their places.
        """
        grid = self.maps.grid
        north_deg = math.degrees(grid.convergence_rad(*grid.centre_lonlat))
        vehicle = self.plans.limits.vehicle or Vehicle()
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
            "hatches": HATCHES,
            "line_px": PX_PER_PT * np.array([widths_of(1)[0], LINE_PT, EDGE_PT]),
            "mission_colours": [ALTITUDE_COLOUR, FOUND_COLOUR],
            "most_bytes": MOST_BYTES,
            "altitudes_m": self.maps.altitudes_m,
            "has_base": self.maps.base_map is not None,
            "no_fix": FIX if FIX in self.layers else None,
            "file_name": re.sub(r"[^\w.-]+", "-", self.name).strip("-."),
            "step_m": STEP_M,
            "group_colours": list(GROUP_COLOURS.values()),
            "fields": {
                "clearance_m": self.plans.limits.clearance_m,
                "vertical_clearance_m": self.plans.limits.vertical_clearance_m,
                "unknown_heights": self.plans.limits.of_unknown,
                "flight_m": self._first_altitude_m,
                "opacity": 100,
                "speed_m_s": vehicle.speed_m_s or "",
                "power_w": vehicle.power_w or "",
            },
            "can_plan": True,
            "html": self._texts(north_deg),
        }

    def base(self, _: Request) -> dict[str, Any]:
        """Return the base map (`base_of`)."""
        return base_of(self.maps)

    def outlines(self, _: Request) -> bytes:
        """Return the outlines of all that stands (`packed_outlines`): exact ones where the city can be read again."""
        city = self._city  # reads it
        return packed_outlines(self.maps, None if city is None else city.standing)

    def _texts(self, north_deg: float) -> dict[str, str]:
        """Return the texts and lists of the page as HTML, by the names of their places.

        Args:
          north_deg: by how many degrees true north is west of the grid's north; below 0 it is east of it.
        """
        # What is said of the maps.
        maps, grid = self.maps, self.maps.grid
        cells = f"{grid.num_rows:,} × {grid.num_cols:,} cells of {grid.resolution_m:g} m"
        cells = escape(f"{cells} · {crs_said(grid.crs)}")
        side = "left" if north_deg > 0 else "right"
        north = f"true north {abs(north_deg):.2f}° to the {side} of up"
        guessed = guesses_said(maps, has_sky=True)
        groups = np.unique(group_numbers(maps)).tolist()

        # Lists to choose from. `H_NORM` is a layer of all maps.
        first = "gps" if "gps" in self.layers else H_NORM
        headings = [
            (name, layer.variable.heading, layer.group) for name, layer in self.layers.items()
        ]
        summaries = {name: PLANNERS[name].summary for name in BY_METHOD}
        return {
            "title": escape(self.name),
            "guesses": escape(guessed and f"Guessed: {guessed}"),
            "num-guesses": f"What these maps guess ({len(maps.guesses)})",
            "guesses-text": escape("\n".join(guess.sentence for guess in maps.guesses)),
            "place": "<br>".join([place_said(grid), cells, north]),
            "credit": escape(maps.attribution),
            "groups": markup.group_boxes(groups if any(groups) else ()),
            "sliders": markup.sliders(self._labels, self._colours),
            "planners": markup.planners(summaries, PLANNER_LINES, DEFAULTS.planner),
            "formats": markup.save_buttons(of_waypoints=False),
            "formats-of-waypoints": markup.save_buttons(of_waypoints=True),
            "altitude": options([f"{z_m:g} m" for z_m in maps.altitudes_m]),
            "time_of_day": options(maps.times_of_day),
            "time": options([*map(time_said, self.axes[TIME])]),
            "layer": markup.layer_options(headings, first),
            "north": f'<path d="M0-12 5 8 0 4-5 8Z" transform="rotate({-north_deg:.2f})"/>',
        }

    @cached_property
    def axes(self) -> dict[str, tuple]:
        """The altitudes, times and times of day by which maps are chosen, each () where the maps hold none.

        A series with statistics over its times has no times here.
        """
        maps = self.maps
        times = maps.times if maps.default_time is not None else ()
        return {ALTITUDE: maps.altitudes_m, TIME: times, TIME_OF_DAY: maps.times_of_day}

    @property
    def _first_altitude_m(self) -> float:
        """The altitude at which the page opens: the middle one of the maps, of two the higher; 0 without altitudes."""
        altitudes_m = self.maps.altitudes_m
        return altitudes_m[len(altitudes_m) // 2] if altitudes_m else 0.0

    @cached_property
    def _labels(self) -> dict[str, str]:
        """The label of each weight and cost: of the distance and of the metrics."""
        return {"distance": "Distance flown"} | {
            name: metric.cost_label for name, metric in self.maps.metrics.items()
        }

    @cached_property
    def _colours(self) -> dict[str, str]:
        """The colour of each weight in lists and lines."""
        return {name: line_colour(name) for name in self._labels}

    def place(
        self, at: tuple[int, int, int], dims: tuple[str, ...] = (ALTITUDE, TIME, TIME_OF_DAY)
    ) -> OneMap:
        """Return the altitude, time and time of day that a request names by their numbers in `axes`.

        Args:
          at: the three numbers, from 0.
          dims: which of the three count; the others are None, and so is one of which the maps hold no values.

        Raises:
          InputError: a number beyond its list.
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
        """Return the altitude, time and time of day of a route; its altitude may lie between altitudes of the maps."""
        at = self.place(query.at)
        if query.flight_m is None or at.altitude_m is None:
            return at
        return at._replace(altitude_m=query.flight_m)

    def values(self, view: View) -> np.ndarray:
        """Return the values ``[Y, X]`` of a map, as the page gets them.

        Raises:
          InputError: an unknown layer, or a number beyond its list.
        """
        layer = self.layers[one_of("layer", view.layer, self.layers)]
        at = self.place(view.at, layer.dims)
        plan = view.plan
        if plan and view.layer == CLOSED.name:
            key = CLOSED.name, plan.model_dump_json()
            return self.kept.get(key, lambda: self.plans.cost_map(plan, self.flight(plan)).causes)
        if view.layer != NAME:
            return self.kept.get((view.layer, at), lambda: layer.values(at))
        if view.home is None:
            return np.full(self.maps.grid.shape, NOTHING)
        kept = {name: getattr(self.plans.limits, name) for name in CLEARANCES}
        returns = partial(return_altitude, self.maps, view.home, **kept)
        return self.kept.get((view.layer, view.home), lambda: returns().altitude_m)

    def why(self, query: Plan) -> str:
        """Return why the start of a query is closed to routes, or that it is free (`Plans.why`)."""
        return self.plans.why(query, self.flight(query))

    def stands(self, query: SkyRequest) -> str:
        """Return what stands at a place, and by which rule, as HTML (`City.why`); "" where no city can be read.

        Raises:
          InputError: the place lies outside the city.
        """
        city = self._city
        if city is None:
            return ""
        things = city.why(*query.place)
        things["rule"] = things["rule"].map(shown_rule)
        shown = things[["kind", "height_m", "highest_m", "known_by", "rule"]]
        shown.columns = shown.columns.str.replace("_", " ")
        table = shown.to_html(index=False, index_names=False, border=0, na_rep="?")
        said = str(things.columns.name)
        away_m = things["distance_m"].min()
        if away_m > NEAR_M:
            said += f"; the nearest thing is {away_m:.1f} m away:"
        return sentences([("note", said)]) + table

    def legend(self, view: View) -> dict[str, Any]:
        """Return how the values of a view become colours (`legend_of`).

        Raises:
          InputError: as for `values`.
        """
        values = self.values(view)  # refuses an unknown layer
        return legend_of(self.layers[view.layer], values)

    def tile(self, tile: Tile) -> bytes:
        """Return a tile of the values of a view (`packed_tile`).

        Raises:
          InputError: as for `values`, or no such tile.
        """
        return packed_tile(self.values(tile), tile.stride, tile.row, tile.col)

    def values_at(self, cell: Cell) -> list[dict[str, Any]]:
        """Return what the list under the pointer shows of a cell, in its order.

        A row has the name of a layer, its value (None where it has none) and its `_words`.

        Raises:
          InputError: a cell outside the maps, a number beyond its list, or as for `values`.
        """
        grid = self.maps.grid
        if not (cell.row < grid.num_rows and cell.col < grid.num_cols):
            raise InputError(
                f"the cell {cell.row}, {cell.col} is outside: there are {grid.num_rows} x {grid.num_cols}"
            )
        is_inside = self._value_in(self.layers["obstacle"], cell) != 0

        # The layers; those that are hidden inside obstacles have no value there.
        rows: list[dict[str, Any]] = []
        for name, layer in self.layers.items():
            words = _words(layer)
            if not words["told"]:
                continue
            is_hidden = is_inside and layer.is_hidden
            value = math.nan if is_hidden else self._value_in(layer, cell)
            rows.append({"name": name, "value": number_or_none(value), **words})
        return rows

    def _value_in(self, layer: DrawnLayer, cell: Cell) -> float:
        """Return a layer's value in a cell, NaN where it has none.

        A layer that the maps do not hold is computed from them for all cells at once. Of one that they hold the block
        of cells around the cell is read and kept.

        Raises:
          InputError: a number beyond its list.
        """
        variable = self.maps.variable(layer.name)
        if variable not in self.maps.ds:
            view = View(layer=layer.name, at=cell.at, home=cell.home)
            value = self.values(view)[cell.row, cell.col]
            return float(value) if np.isfinite(value) else math.nan
        at = self.place(cell.at, layer.dims)
        array = self.maps.ds[variable]
        # The row and the column of the southwest corner of the block.
        row = cell.row // BLOCK * BLOCK
        col = cell.col // BLOCK * BLOCK
        plane = {"y": slice(row, row + BLOCK), "x": slice(col, col + BLOCK)}
        part = plane | dict(zip(self.axes, cell.at, strict=True))
        key = "block", layer.name, at, row, col
        # The array may lack some of the dimensions of `part`.
        block = self.kept.get(key, lambda: array.isel(part, missing_dims="ignore").values)
        return float(block[cell.row - row, cell.col - col])

    @cached_property
    def _sight(self) -> Sight:
        """The city of the maps, read again when its outlines or a sky are asked for first.

        Raises:
          InputError: maps in memory, or whose files are gone.
        """
        with warnings.catch_warnings(
            action="ignore", category=UserWarning
        ):  # the page shows what the maps guess
            return Sight.of(self.maps, None, self.sources)

    @cached_property
    def _city(self) -> City | None:
        """The city of the maps, None where it cannot be read again: then what stands is known by their cells."""
        try:
            return self._sight.city
        except (JaxurbanError, OSError) as error:
            LOG.info(f"buildings are outlined by the cells of the maps: {error}")
            return None

    def check(self, query: MissionRequest) -> dict[str, Any]:
        """Return what the page shows of a mission, as `jaxurban.check` judges it; its file is nowhere written.

        Returns:
          As HTML ``state``, a sentence, and notes, ``findings``, a button each, ``not-judged`` and ``figures``. Metres:
          ``lines``, ``[N, 2, 2]`` the straight parts over the maps, ``places``, ``[F, 2]`` of the findings, and
          ``heights``, ``[F]`` theirs above the ground, None where that is not known, and ``cruise_m``, the median
          height above the ground without climbs and landings, None where none is known.

        Raises:
          InputError: a name that is not that of a file alone, or as for `jaxurban.check`.
        """
        if PureWindowsPath(query.file).name != query.file:
            raise InputError(f"file must be a name without a folder, got {query.file!r}")
        at = self.place(query.at)
        result = check(
            self.maps,
            read_mission(
                query.file, heights=query.heights, autopilot=query.autopilot, data=query.data
            ),
            constraints=self.plans.constraints(query),
            time=at.time,
            time_of_day=at.time_of_day,
            sources=self._city or self.sources,
        )
        facts = result.facts
        state = STATE_LEVELS[result.state], facts.pop("state")
        notes = (("note", text) for text in result.notes)
        figures = [f"return: {text}" for text in result.return_lines]
        figures += [f"{name}: {fact}" for name, fact in facts.items() if fact]
        found = result.findings
        steps = result.flight.steps
        cruise_m = pd.Series(steps.z_m[~result.flight.is_on_site(steps), 0]).median()
        return {
            "state": sentences([state, *notes]),
            "findings": markup.findings(result),
            "not-judged": sentences(
                ("guess", OF_COMMAND.sub("(with jaxurban check DIR FILE ", f"Not judged: {text}"))
                for text in result.not_judged
            ),
            "figures": sentences(("note", text) for text in figures),
            "lines": np.round(result.flight.lines_m - self.maps.grid.bounds_m[:2], 1),
            "places": self._on_page(found[["lon", "lat"]].to_numpy(float)),
            "heights": [*map(number_or_none, found["height_m"])],
            "cruise_m": number_or_none(cruise_m),
        }

    def sky(self, query: SkyRequest) -> str:
        """Return the sky over a place as HTML (`sky_html`).

        Raises:
          InputError: maps in memory, or whose files are gone, or without altitudes or times; a place far away.
        """
        at = self.place(query.at)
        if at.altitude_m is None:
            raise InputError("these maps hold no altitudes, so a sky has no height to be seen from")
        return sky_html(sky_from(self._sight, query.place, at.altitude_m, time=at.time))

    def plan(self, query: Plan) -> dict[str, Any]:
        """Return what the page shows of a route: its points, its costs, how its search ended, and its command.

        Without a path there are no points, and ``message`` says why.

        Raises:
          InputError: as for `Plans.route`.
        """
        at = self.flight(query)
        planned = self.plans.route(query, at)
        text = "no path"
        if planned.status.has_path:
            text = f"cost {short(planned.cost)} · {planned.length_m / 1000:.2f} km"
        return {
            "planner": query.planner,
            "has_path": planned.status.has_path,
            "xy_m": planned.xy_m,
            "cost": number_or_none(planned.cost),
            "button": markup.route_button(
                query.planner, PLANNER_LINES[query.planner], text, planned.search.sentence
            ),
            "html": markup.cost_rows(planned.cost_by_layer, self._labels, self._colours),
            "message": planned.message,
            "command": self.plans.command(query, at),
        }

    def report(self, query: Plan) -> dict[str, Any]:
        """Return what the page shows of the report of a route; texts are HTML.

        Returns:
          ``cautions``, ``totals``, ``profile`` and ``report-text``, the whole report; ``xy``, ``[N, 2]`` where its
          crossings of cells lie, and ``to_share``, ``[N]`` at which share of the route each ends; ``mission``,
          ``[W, 2]`` the waypoints of its files; ``saved``, in words, their number, cost and least clearance.

        Raises:
          InputError: there is no route.
        """
        at = self.flight(query)
        report, planned = self.plans.report(query, at)
        mission = self.plans.mission(query, at)
        table, facts = report.profile, report.facts

        rules = sentences([("note", rules_said(planned.settings))])

        # The waypoints, and how they differ from the route.
        lonlat = waypoints(mission).lonlat
        saved = [f"{len(lonlat)} waypoints, cost {short(mission.cost)}"]
        if planned.cost > 0:
            saved.append(f"{mission.cost / planned.cost - 1:+.1%}")
        saved += self._least_clearance(mission, report.totals[CLEARANCE])

        length_m = max(planned.length_m, 1e-9)  # a route of no length has one crossing, to 0 m
        return {
            "cautions": sentences((caution.level, caution) for caution in report.cautions),
            "totals": markup.rows((name, facts[name]) for name in TOTALS if name in facts),
            "profile": markup.profile(planned, self.maps, report) + rules,
            "to_share": np.round(table["to_m"].to_numpy() / length_m, 5),
            "xy": self._on_page(table[["lon", "lat"]].to_numpy()),
            "report-text": escape(report.table()),
            "mission": self._on_page(lonlat),
            "saved": ", ".join(saved),
        }

    def _least_clearance(self, mission: PlannedPath, route_m: float) -> list[str]:
        """Return the least clearance of a mission in words.

        The clearance of its route, ``route_m``, follows if it is greater. Without buildings no clearance is finite, and
        the list is empty.
        """
        least_m = cautious_profile(mission, self.maps)[CLEARANCE].min()
        if not math.isfinite(least_m):
            return []
        text = f"least clearance {short(least_m)} m"
        if least_m < route_m and short(least_m) != short(route_m):
            text = f"{text}, the route {short(route_m)} m"
        return [text]

    def _on_page(self, lonlat: np.ndarray) -> np.ndarray:
        """Return places ``[N, 2]``, given by longitude and latitude, as x and y in metres from the southwest corner."""
        grid = self.maps.grid
        return np.round(grid.xy_at(lonlat) - grid.bounds_m[:2], 1)

    def save(self, query: Save) -> bytes:
        """Return a route as the bytes of a file (`Plans.file`).

        Raises:
          InputError: there is no such format, or no route.
        """
        return self.plans.file(query, self.flight(query), query.format)


def _words(layer: DrawnLayer) -> dict[str, Any]:
    """Return the words for a layer in the list of the values of a cell.

    ``told`` is the layer's label in the list, "" for that of closed cells, which the list leaves out. ``classes``
    are the names of the layer's classes, ``unit`` is its unit, and ``group`` the heading that it stands under.
    """
    variable = layer.variable
    label = variable.symbol or variable.heading
    if layer.name == CLOSED.name:
        label = ""
    classes = [name for name, _ in variable.classes]
    unit = {"1": "", "km-2": "per km²"}.get(variable.unit, variable.unit)
    return {"told": label, "classes": classes, "unit": unit, "group": layer.group}


def as_json(value: Any) -> bytes:
    """Return a value as JSON in UTF-8; arrays become lists.

    Raises:
      ValueError: a number is not finite.
    """
    return json.dumps(
        value, allow_nan=False, separators=(",", ":"), default=lambda array: array.tolist()
    ).encode()
