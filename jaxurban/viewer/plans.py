"""Routes for the viewer: planned as ``jaxurban plan`` does, on cost maps that are kept while only weights change."""

import json
import shlex
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from threading import RLock
from typing import Any, TypeVar

import numpy as np

from jaxurban.errors import InputError, one_of
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import GivenWeights, Weights
from jaxurban.paths.constraints import CLEARANCES, Constraints
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.paths.explain import RouteReport, explain
from jaxurban.paths.export.write import FORMATS, WAYPOINTS
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.preset import under_preset, weights_on
from jaxurban.paths.simplify import simplify
from jaxurban.paths.vehicle import Vehicle
from jaxurban.planners.cost_model import CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.presets import BUDGET_S, DEFAULTS
from jaxurban.viewer.layers import Place
from jaxurban.viewer.requests import Plan

ZONES_FILE = "zones.geojson"  # what the page saves drawn zones as, and the command names
SAMPLING_BUDGET_S = 2.0  # sampling planners take all that they may
NUM_COST_MAPS, NUM_ROUTES = 2, 16  # that are kept
Made = TypeVar("Made")


@dataclass(frozen=True)
class PlanDefaults:
    """What routes are planned under where the page says nothing else.

    Attributes:
      weights: where the sliders start.
      cost_model: its kind is where the page starts, all else of it stays.
      clearance_m: where the page starts.
      vertical_clearance_m, vehicle: of every route.
      command: the folder and the resolution, as ``jaxurban plan`` takes them; empty for maps in memory.
    """

    weights: Weights = field(default_factory=Weights)
    cost_model: CostModel = field(default_factory=CostModel)
    clearance_m: float = DEFAULTS.clearance_m
    vertical_clearance_m: float = DEFAULTS.vertical_clearance_m
    vehicle: Vehicle | None = None
    command: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, maps: MetricMaps, command: tuple[str, ...] = (), weights: GivenWeights = None, preset: str = ""
    ) -> "PlanDefaults":
        """Return what routes over maps are planned under where weights and a preset are given, and nothing else."""
        _, model, limits = under_preset(preset, maps, None, None)
        clearances = {name: float(getattr(limits, name)) for name in CLEARANCES}
        return cls(weights_on(maps, weights), model, **clearances, vehicle=limits.vehicle, command=command)


class Plans:
    """Plans routes over maps, one at a time; threads wait for each other."""

    def __init__(self, maps: MetricMaps, defaults: PlanDefaults) -> None:
        self.maps, self.defaults = maps, defaults
        self._lock = RLock()
        self._cost_maps: OrderedDict[Hashable, CostMap] = OrderedDict()
        self._routes: OrderedDict[Hashable, PlannedPath] = OrderedDict()  # without their cost maps, which are large
        self._reports: OrderedDict[Hashable, RouteReport] = OrderedDict()

    def route(self, query: Plan, at: Place) -> PlannedPath:
        """Return the route that is asked for.

        Raises:
          InputError: as for `jaxurban.plan`.
        """

        def make() -> PlannedPath:
            on = self._cost_map(query, at)
            budget_s = _budget_s(query.planner)
            return on.plan(query.start, query.goal, planner=query.planner, budget_s=budget_s, snap=query.snap)

        with self._lock:
            return _kept(self._routes, query.model_dump_json(), NUM_ROUTES, make)

    def report(self, query: Plan, at: Place) -> tuple[RouteReport, PlannedPath]:
        """Return a route explained, with what its pilot should know, and the route.

        Raises:
          InputError: there is no route.
        """
        with self._lock:
            planned, maps = self.route(query, at), self.maps.with_obstacles(query.obstacles)
            found = _kept(self._reports, query.model_dump_json(), NUM_ROUTES, lambda: explain(planned, maps))
            return found, planned

    def file(self, query: Plan, at: Place, suffix: str) -> bytes:
        """Return a route as ``jaxurban plan -o`` writes it; as waypoints, simplified by half a cell.

        Raises:
          InputError: there is no route.
        """
        planned = self.mission(query, at) if suffix in WAYPOINTS else self.route(query, at)
        if not planned.status.has_path:
            raise InputError(f"there is no route to save: {planned.status.sentence}")
        return FORMATS[suffix]([("", planned)], None)

    def mission(self, query: Plan, at: Place) -> PlannedPath:
        """Return the route that files of waypoints hold: simplified by half a cell, priced by the route's cost model.

        Raises:
          InputError: as for `jaxurban.plan`.
        """
        with self._lock:
            planned, key = self.route(query, at), ("mission", query.model_dump_json())
            tolerance_m = self.maps.grid.resolution_m / 2
            return _kept(
                self._routes, key, NUM_ROUTES, lambda: simplify(planned, self._cost_map(query, at), tolerance_m)
            )

    def moved(self, query: Plan, at: Place) -> dict[str, str]:
        """Return how far each end of a route was moved and out of what, by name; nothing of an end that was free."""
        with self._lock:
            planned, on, sentences = self.route(query, at), self._cost_map(query, at), {}
            for name, moved_m in zip(("start", "goal"), planned.snap_distance_m, strict=True):
                _, cell = on.cell_of(name, getattr(query, name))
                if not on.is_free[cell]:
                    sentences[name] = f"{name} moved {moved_m:.0f} m: it was {on.why_closed(cell)}"
            return sentences

    def command(self, query: Plan, at: Place) -> str:
        """Return the command that gives the same route, coordinate for coordinate; empty for maps in memory.

        (Of a planner that stops when its time is over, `SAMPLING_BUDGET_S`, another run may come further.)
        """
        if not self.defaults.command:
            return ""
        folder, *resolution = self.defaults.command
        values = {
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
            "--vertical-clearance": repr(self.defaults.vertical_clearance_m),
            "--no-fly": ZONES_FILE if query.zones else None,
        }
        given = [part for name, value in values.items() if value is not None for part in (name, value)]
        return shlex.join(["jaxurban", "plan", folder, *resolution, *given, *(["--snap"] if query.snap else [])])

    def _cost_map(self, query: Plan, at: Place) -> CostMap:
        """Return the cost map of a query; what does not depend on the weights is made once."""
        find_planner(query.planner)
        for name in query.weights:
            one_of("weight", name, ("distance", *self.maps.metrics))
        weights = Weights.of({**self.defaults.weights.to_dict(), **query.weights})
        key = at, query.cost_model, query.obstacles, query.clearance_m, query.zones
        on = _kept(self._cost_maps, key, NUM_COST_MAPS, lambda: self._made(query, at))
        return on.with_weights(weights)

    def _made(self, query: Plan, at: Place) -> CostMap:
        settings = self.defaults.cost_model.settings | {"cost_model": query.cost_model}
        if at.altitude_m is None:
            raise InputError("these maps hold no altitude to plan at")
        return cost_map(
            self.maps.with_obstacles(query.obstacles),
            at.altitude_m,
            cost_model=CostModel.from_settings(settings),
            time=at.time,
            time_of_day=at.time_of_day,
            constraints=self._constraints(query),
        )

    def _constraints(self, query: Plan) -> Constraints:
        """Return what closes cells: drawn zones are read from a file as those of the command are."""
        defaults = self.defaults
        kept = Constraints((), (), query.clearance_m, defaults.vertical_clearance_m, defaults.vehicle)
        if not query.zones:
            return kept
        _check_zones(query.zones)
        with tempfile.TemporaryDirectory() as folder:
            file = FilePath(folder) / ZONES_FILE
            file.write_text(query.zones, encoding="utf-8")
            return replace(kept, zones=Constraints.read(file).zones)


def _kept(held: OrderedDict[Hashable, Made], key: Hashable, most: int, make: Callable[[], Made]) -> Made:
    """Return what is held under a key, made if it is not; the ones used last are held."""
    if key not in held:
        held[key] = make()
    held.move_to_end(key)
    while len(held) > most:
        held.popitem(last=False)
    return held[key]


def _budget_s(planner: str) -> float:
    return SAMPLING_BUDGET_S if planner.startswith("bitstar") else BUDGET_S


def _check_zones(text: str) -> None:
    """Raise InputError unless a text is a GeoJSON collection of polygons in longitude and latitude."""
    try:
        features: Any = json.loads(text)["features"]
        rings = [ring for each in features for ring in each["geometry"]["coordinates"]]
        points = np.array([point for ring in rings for point in ring], float)
        are_polygons = all(each["geometry"]["type"] == "Polygon" for each in features)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError("zones must be a GeoJSON FeatureCollection of polygons") from error
    if not (are_polygons and points.ndim == 2 and points.shape[1] == 2 and np.isfinite(points).all()):
        raise InputError("zones must be polygons of longitude and latitude")
    if np.abs(points).max() > 180:
        raise InputError("zones must be polygons of longitude and latitude, in degrees")
