"""Routes for the viewer: planned as ``jaxurban plan`` does, on cost maps that are kept while only weights change."""

import json
import shlex
import tempfile
from dataclasses import replace
from pathlib import Path as FilePath

from jaxurban.checks import one_of
from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights, WeightsLike
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap, weights_on
from jaxurban.paths.explain import RouteReport, explain
from jaxurban.paths.export.write import FORMATS
from jaxurban.paths.path import PlannedPath, simplify
from jaxurban.paths.plan import cost_map, rules_on
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.settings import DEFAULTS, Preset
from jaxurban.studies.map_comparison import OneMap
from jaxurban.viewer.requests import Plan
from jaxurban.viewer.tiles import Kept

ZONES_FILE = "zones.geojson"  # what the page saves drawn zones as, and the command names
SAMPLING_BUDGET_S = 2.0  # sampling planners take all that they may
NUM_ROUTES = 16  # that are kept


class Plans:
    """Plans routes over maps, one at a time; what the page does not say is as in the maps' scenario, or the preset.

    Args:
      maps: the maps.
      folder: that they lie in; empty for maps in memory.
      weights: where the sliders start; left out, those of the scenario, else `Weights()`.
      preset: as in `jaxurban.cost_map`.

    Attributes:
      maps: under the preset's rule of obstacles.
      cost_model: its kind is where the page starts, all else of it stays.
      limits: their clearance is where the page starts, all else of them stays.
    """

    def __init__(
        self, maps: MetricMaps, folder: str = "", weights: WeightsLike = None, preset: Preset = ""
    ) -> None:
        self.maps, self.cost_model, self.limits = rules_on(maps, None, None, preset)
        self.weights, self.folder = weights_on(maps, weights), folder
        self._cost_maps = Kept(2, _count_one)
        self._routes = Kept(NUM_ROUTES, _count_one)
        self._reports = Kept(NUM_ROUTES, _count_one)

    def route(self, query: Plan, at: OneMap) -> PlannedPath:
        """Return the route that is asked for.

        Raises:
          InputError: as for `jaxurban.plan`.
        """

        def make() -> PlannedPath:
            return self._cost_map(query, at).plan(
                query.start,
                query.goal,
                planner=query.planner,
                budget_s=_budget_s(query.planner),
                snap=query.snap,
            )

        # Without its cost map, which is large.
        return self._routes.get(_route_key(query), make)

    def report(self, query: Plan, at: OneMap) -> tuple[RouteReport, PlannedPath]:
        """Return a route explained, with what its pilot should know, and the route.

        Raises:
          InputError: there is no route.
        """
        planned = self.route(query, at)
        report = self._reports.get(query.model_dump_json(), lambda: self._explained(planned, query))
        return report, planned

    def _explained(self, planned: PlannedPath, query: Plan) -> RouteReport:
        maps = self.maps.with_obstacles(query.obstacles)
        return explain(planned, maps, speed_m_s=query.speed_m_s, power_w=query.power_w)

    def file(self, query: Plan, at: OneMap, suffix: str) -> bytes:
        """Return a route as ``jaxurban plan -o`` writes it; as waypoints, simplified by half a cell.

        Raises:
          InputError: no such format, or there is no route.
        """
        file_format = FORMATS[one_of("format", suffix, FORMATS)]
        planned = self.route(query, at)
        if file_format.is_of_waypoints:
            planned = self.mission(query, at)
        if not planned.status.has_path:
            raise InputError(f"there is no route to save: {planned.status.sentence}")
        has_flight = query.speed_m_s is not None or query.power_w is not None
        report = self._explained(planned, query) if has_flight else None
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
            key, lambda: simplify(planned, self._cost_map(query, at), half_cell_m)
        )

    def moved(self, query: Plan, at: OneMap) -> list[str]:
        """Return how far each end of a route was moved and out of what; nothing of an end that was free."""
        start_m, goal_m = self.route(query, at).snap_distance_m
        costs, sentences = self._cost_map(query, at), []
        for name, place, moved_m in (
            ("start", query.start, start_m),
            ("goal", query.goal, goal_m),
        ):
            _, cell = costs.cell_of(name, place)
            if not costs.is_free[cell]:
                sentences.append(f"{name} moved {moved_m:.0f} m: it was {costs.why_closed(cell)}")
        return sentences

    def command(self, query: Plan, at: OneMap) -> str:
        """Return the command that gives the same route, coordinate for coordinate; empty for maps in memory.

        (Of a planner that stops when its time is over, `SAMPLING_BUDGET_S`, another run may come further.)
        """
        if not self.folder:
            return ""
        values = {
            "--resolution": repr(self.maps.grid.resolution_m),
            "--start": ",".join(map(repr, query.start)),
            "--goal": ",".join(map(repr, query.goal)),
            "--altitude": repr(at.altitude_m),
            "--time": at.time,
            "--time-of-day": at.time_of_day,
            "--weights": ",".join(f"{name}={value!r}" for name, value in query.weights.items()),
            "--planner": query.planner,
            "--objective": "weighted",
            "--budget": repr(_budget_s(query.planner)),
            "--seed": "0",
            "--cost-model": query.cost_model,
            "--obstacles": query.obstacles,
            "--clearance": repr(query.clearance_m),
            "--vertical-clearance": repr(self._over_roofs_m(query)),
            "--no-fly": ZONES_FILE if query.zones else None,
            "--speed": _written(query.speed_m_s),
            "--power": _written(query.power_w),
        }
        words = ["jaxurban", "plan", self.folder]
        for option, value in values.items():
            if value is not None:
                words += [option, value]
        if query.snap:
            words.append("--snap")
        return shlex.join(words)

    def _cost_map(self, query: Plan, at: OneMap) -> CostMap:
        """Return the cost map of a query; what does not depend on the weights is made once."""
        find_planner(query.planner)
        for name in query.weights:
            one_of("weight", name, ("distance", *self.maps.metrics))
        weights = Weights.of({**self.weights.to_dict(), **query.weights})
        key = (
            at,
            query.cost_model,
            query.obstacles,
            query.clearance_m,
            query.vertical_clearance_m,
            query.zones,
        )
        return self._cost_maps.get(key, lambda: self._made(query, at)).with_weights(weights)

    def _made(self, query: Plan, at: OneMap) -> CostMap:
        """Return the cost map that a plan of the page asks for."""
        settings = self.cost_model.settings | {"cost_model": query.cost_model}
        if at.altitude_m is None:
            raise InputError("these maps hold no altitude to plan at")
        return cost_map(
            self.maps.with_obstacles(query.obstacles),
            at.altitude_m,
            cost_model=CostModel.from_settings(settings),
            time=at.time,
            time_of_day=at.time_of_day,
            objective="weighted",
            constraints=self._constraints(query),
        )

    def _over_roofs_m(self, query: Plan) -> float | None:
        if query.vertical_clearance_m is None:
            return self.limits.vertical_clearance_m
        return query.vertical_clearance_m

    def _constraints(self, query: Plan) -> Constraints:
        """Return what closes cells: drawn zones are read from a file as those of the command are."""
        kept = replace(
            self.limits,
            clearance_m=query.clearance_m,
            vertical_clearance_m=self._over_roofs_m(query),
        )
        if not query.zones:
            return kept
        try:
            json.loads(query.zones)
        except (ValueError, RecursionError) as error:
            raise InputError("zones: must be GeoJSON of polygons") from error
        with tempfile.TemporaryDirectory() as folder:
            file = FilePath(folder) / ZONES_FILE
            file.write_text(query.zones, encoding="utf-8")
            return replace(kept, zones=Constraints.read(file).zones)


def _count_one(_: object) -> int:
    """Return the size of whatever is kept by number."""
    return 1


def _written(value: float | None) -> str | None:
    return None if value is None else repr(value)


def _route_key(query: Plan) -> str:
    """Return what two queries of one route share: how fast it is flown does not change it."""
    return query.model_dump_json(exclude={"speed_m_s", "power_w"})


def _budget_s(planner: str) -> float:
    return SAMPLING_BUDGET_S if planner.startswith("bitstar") else DEFAULTS.budget_s
