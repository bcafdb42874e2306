"""Routes for the viewer: planned as ``jaxurban plan`` does, on cost maps that are kept while only weights change."""

import json
import shlex
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from operator import attrgetter
from pathlib import Path as FilePath
from typing import Any, cast

from jaxurban.checks import one_of, values_given
from jaxurban.errors import InputError
from jaxurban.flights.export.write import FORMATS
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.shared import OneMap
from jaxurban.metrics.weights import Weights, WeightsLike, weights_on
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.explain import explain, with_return_altitude
from jaxurban.paths.finish import simplify
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import cell_at
from jaxurban.paths.plan import cost_map, rules_on
from jaxurban.paths.route_report import RouteReport
from jaxurban.planners.registry import find_planner
from jaxurban.settings import DEFAULTS, PlannerName, Preset
from jaxurban.viewer.requests import Plan, RulesRequest
from jaxurban.viewer.tiles import Kept

ZONES_FILE = "zones.geojson"  # what the page saves drawn zones as, and the command names
SAMPLING_BUDGET_S = 2.0  # sampling planners take all that they may
NUM_ROUTES = 16  # that are kept
OF_MAP = attrgetter(  # of a query: what its cost map depends on, beside its place in the maps and weights
    "clearance_m", "vertical_clearance_m", "unknown_heights", "zones"
)


class Plans:
    """Plans routes over maps, one at a time; what the page does not say is as in the maps' scenario, or the preset.

    Args:
      maps: the maps.
      folder: where the maps are; "" for maps in memory.
      weights: where the sliders start; left out, those of the scenario, else `Weights()`.
      preset: as in `jaxurban.cost_map`.

    Attributes:
      maps: the maps under the preset's rule of obstacles.
      cost_model: how routes are costed.
      limits: of these the page chooses clearances and zones, and leaves the others; it starts at their clearances.
    """

    def __init__(
        self, maps: MetricMaps, folder: str = "", weights: WeightsLike = None, preset: Preset = ""
    ) -> None:
        # Its routes are saved to be flown.
        limits = Constraints().for_flight(maps.planning, preset)
        self.maps, self.cost_model, self.limits = rules_on(maps, None, limits, preset)
        self.weights, self.folder = weights_on(maps, weights), folder
        self._cost_maps = Kept(2, _count_one)
        self._routes = Kept(NUM_ROUTES, _count_one)
        self._reports = Kept(NUM_ROUTES, _count_one)

    def route(self, query: Plan, at: OneMap) -> PlannedPath:
        """Return the route of a query; ``at`` are the altitude, time and time of day of its flight.

        Raises:
          InputError: as for `jaxurban.plan`.
        """

        def make() -> PlannedPath:
            """Return the route, planned now."""
            return self.cost_map(query, at).plan(
                query.start,
                query.goal,
                planner=cast(PlannerName, query.planner),  # `plan` refuses an unknown one
                budget_s=_budget_s(query.planner),
                snap=query.snap,
                on_ground=query.on_ground,
            )

        # The route is kept, but not its cost map, which is large.
        return self._routes.get(_route_key(query), make)

    def report(self, query: Plan, at: OneMap) -> tuple[RouteReport, PlannedPath]:
        """Return the report of a query's route, with all that its pilot should know, and the route.

        Raises:
          InputError: there is no route.
        """
        planned = self.route(query, at)
        report = self._reports.get(query.model_dump_json(), lambda: self._explain(planned, query))
        return report, planned

    def _explain(self, planned: PlannedPath, query: Plan) -> RouteReport:
        """Return the report of a route, flown at the speed and with the power of the query."""
        report = explain(planned, self.maps, speed_m_s=query.speed_m_s, power_w=query.power_w)
        return with_return_altitude(report, planned, self.maps)

    def file(self, query: Plan, at: OneMap, suffix: str) -> bytes:
        """Return a route as the bytes of a file, as ``jaxurban plan -o`` writes it.

        A format of waypoints gets the `mission`. Where speed or power are given, the file has the report of the flight.

        Args:
          query, at: the query of the route, as in `route`.
          suffix: ends the file's name, and names its format.

        Raises:
          InputError: there is no such format, or no route.
        """
        file_format = FORMATS[one_of("format", suffix, FORMATS)]
        planned = self.route(query, at)
        if file_format.is_of_waypoints:
            planned = self.mission(query, at)
        if not planned.status.has_path:
            raise InputError(f"there is no route to save: {planned.status.sentence}")
        has_flight = query.speed_m_s is not None or query.power_w is not None
        report = self._explain(planned, query) if has_flight else None
        return file_format.encode([("", planned)], report)

    def mission(self, query: Plan, at: OneMap) -> PlannedPath:
        """Return the route that files of waypoints hold: simplified by half a cell, priced by the route's cost model.

        Raises:
          InputError: as for `jaxurban.plan`.
        """
        planned = self.route(query, at)
        key = "mission", _route_key(query)
        half_cell_m = self.maps.grid.resolution_m / 2
        return self._routes.get(
            key, lambda: simplify(planned, self.cost_map(query, at), half_cell_m)
        )

    def why(self, query: Plan, at: OneMap) -> str:
        """Return whether the start of a query is free, or what closes it, and which share of the cells each cause does.

        Raises:
          InputError: as for `jaxurban.plan`.
        """
        costs = self.cost_map(query, at)
        _, cell = cell_at(self.maps.grid, "the place", query.start)
        said = "free to routes" if costs.is_free[cell] else costs.free_space.why_closed(cell)
        facts = costs.facts
        return f"This cell is {said}. Free: {facts['free']}; closed: {facts['closed']}."

    def command(self, query: Plan, at: OneMap) -> str:
        """Return the command that gives the same route, coordinate for coordinate; "" for maps in memory.

        (Of a planner that stops when its time is over, `SAMPLING_BUDGET_S`, another run may come further.)
        """
        if not self.folder:
            return ""

        # The values of options with several, and the value of each option, None for one that is left out; the text of a
        # number gives the same number again.
        limits = self.constraints(query)
        search = {"planner": query.planner, "budget_s": _budget_s(query.planner), "seed": 0}
        rules = {
            "clearance_m": limits.clearance_m,
            "vertical_clearance_m": limits.vertical_clearance_m,
            "unknown_heights": limits.unknown_heights,
        }
        flight = {"speed_m_s": query.speed_m_s, "power_w": query.power_w}
        values = {
            "--resolution": self.maps.grid.resolution_m,
            "--start": ",".join(map(str, query.start)),
            "--goal": ",".join(map(str, query.goal)),
            "--altitude": at.altitude_m,
            "--time": at.time,
            "--time-of-day": at.time_of_day,
            "--weights": _named(query.weights),
            "--preset": self.maps.planning.preset or None,
            "--planner": _named(search),
            "--rules": _named(rules),
            "--no-fly": ZONES_FILE if query.zones else None,
            "--report": _named(flight) or None,
        }
        words = ["jaxurban", "plan", self.folder]
        for option, value in values.items():
            if value is not None:
                words += [option, str(value)]
        if query.snap:
            words.append("--snap")
        if query.on_ground:
            words.append("--on-ground")
        return shlex.join(words)

    def cost_map(self, query: Plan, at: OneMap) -> CostMap:
        """Return the cost map of a query; what does not depend on the weights is kept for the next query.

        Raises:
          InputError: as for `jaxurban.plan`, an unknown planner or weight before a cost map is made.
        """
        # These two raise the errors.
        find_planner(query.planner)
        for name in query.weights:
            one_of("weight", name, ("distance", *self.maps.metrics))

        altitude_m = at.altitude_m
        if altitude_m is None:
            raise InputError("these maps hold no altitude to plan at")

        def make() -> CostMap:
            """Return the cost map, made from the maps; the query's weights are not in it yet."""
            return cost_map(
                self.maps,
                altitude_m,
                cost_model=self.cost_model,
                time=at.time,
                time_of_day=at.time_of_day,
                objective="weighted",
                constraints=self.constraints(query),
            )

        # Weights that the page does not say stay. The key holds all else that a cost map depends on.
        weights = Weights.of(self.weights.to_dict() | query.weights)
        return self._cost_maps.get((at, OF_MAP(query)), make).with_weights(weights)

    def constraints(self, query: RulesRequest) -> Constraints:
        """Return what closes cells to a query: the scenario's limits with the query's clearances and drawn zones.

        Raises:
          InputError: the zones are no GeoJSON of polygons.
        """
        rules = {
            "vertical_clearance_m": query.vertical_clearance_m,
            "unknown_heights": query.unknown_heights,
        }
        limits = replace(self.limits, clearance_m=query.clearance_m, **values_given(rules))
        if not query.zones:
            return limits

        # Zones go through a file, as the command reads them from one; what is no JSON is refused before.
        try:
            json.loads(query.zones)
        except (ValueError, RecursionError) as error:
            raise InputError("zones: must be GeoJSON of polygons") from error
        with tempfile.TemporaryDirectory() as folder:
            file = FilePath(folder) / ZONES_FILE
            file.write_text(query.zones, encoding="utf-8")
            return replace(limits, zones=Constraints.read(file).zones)


def _count_one(_: object) -> int:
    """Return the size of a thing of which a number is kept, whatever its bytes: 1."""
    return 1


def _route_key(query: Plan) -> str:
    """Return a text that is the same for all queries of one route; speed, power and its file do not change it."""
    return query.model_dump_json(exclude={"speed_m_s", "power_w", "format"})


def _budget_s(planner: str) -> float:
    """Return the seconds that a planner may take."""
    return SAMPLING_BUDGET_S if planner.startswith("bitstar") else DEFAULTS.budget_s


def _named(values: Mapping[str, Any]) -> str:
    """Return values as an option takes them, ``NAME=VALUE,...``, without those that are None."""
    return ",".join(f"{name}={value}" for name, value in values_given(values).items())
