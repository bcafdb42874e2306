"""PlannedPath: a path over metric maps with its cost, metrics and settings, and what must be said of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxurban.errors import InputError, typed
from jaxurban.io.read.zone import Zone
from jaxurban.paths.constraints import kept_said
from jaxurban.paths.export.write import MISSION, write_path
from jaxurban.paths.ground import Ground, ground_along
from jaxurban.paths.preset import PathSearch
from jaxurban.paths.snapping import Place, pocket_note, snap_note, what_would_join
from jaxurban.planners.base import Path, Status
from jaxurban.world.show import Shown

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.cautions import Caution
    from jaxurban.paths.cost_map import CostMap
    from jaxurban.paths.explain import RouteReport


OF_SEARCH = ("graph", "num_expanded", "elapsed_s", "setup_s", "planner", "heuristic", "backend")


@dataclass(frozen=True, repr=False)
class PlannedPath(Shown):
    """A path over metric maps with its cost and metrics. ``N`` points.

    Attributes:
      status: how the planner ended; `Status.has_path` tells whether there is a path.
      xy_m: ``[N, 2]`` easting, northing of the path's points in the maps' CRS; empty without a path.
      lonlat: ``[N, 2]`` longitude, latitude in degrees.
      z_m: ``[N]`` altitude above ground of each point.
      altitude_m: flight altitude above ground; of a path that climbs or descends, the one that it starts at.
      cost: weighted cost under ``cost_model``, whatever the objective was; inf without a path.
      cost_by_layer: parts of ``cost``: "distance" and each metric.
      length_m: length of the path.
      metrics: mean of each metric m along the path, weighted by length, by name.
      snap_distance_m: how far start and goal were moved to the centres of their cells (or, with
        ``snap``, of the nearest free cells; the message tells which of them).
      search: what the planner itself reported: bound, expansions, time, heuristic, backend, note.
      settings: planner, weights, cost model, objective and the like, for the record.
      crs: CRS of ``xy_m``.
      ground: the ground under the path; None without a path, or over maps without terrain.
      zones: the no-fly zones that it was planned around, for the geofence of a mission.
      maps: that it was planned on; None of a path made by hand.
    """

    status: Status
    xy_m: np.ndarray
    lonlat: np.ndarray
    z_m: np.ndarray
    altitude_m: float
    cost: float
    cost_by_layer: Mapping[str, float]
    length_m: float
    metrics: Mapping[str, float]
    snap_distance_m: tuple[float, float]
    search: Path
    settings: Mapping[str, Any]
    crs: str
    ground: Ground | None = None
    zones: tuple[Zone, ...] = ()
    maps: "MetricMaps | None" = field(default=None, compare=False)

    @cached_property
    def cautions(self) -> "list[Caution]":
        """What a pilot should know of it (`jaxurban.cautions`); empty without a path, or without its maps."""
        from jaxurban.paths.cautions import cautions

        return [] if self.maps is None or not self.status.has_path else cautions(self, self.maps)

    @property
    def message(self) -> str:
        """What happened, and what a reader of the path must know beside it."""
        return " ".join(filter(None, (self.search.sentence, self.search.note)))

    @property
    def facts(self) -> dict[str, str]:
        """How the planner ended, and the path's cost, length, altitudes and metrics."""
        search = self.search
        facts = {"status": self.status.value, "planner": f"{search.planner} ({search.heuristic}, {search.backend})"}
        if not self.status.has_path:
            return facts | {"message": self.search.sentence}
        low_m, high_m = self.z_m.min(), self.z_m.max()
        metrics = ", ".join(f"{name} {m:.2f}" for name, m in self.metrics.items())
        return facts | {
            "cost": f"{self.cost:,.2f}",
            "length": f"{self.length_m:,.0f} m in {len(self.xy_m):,} points",
            "altitude": f"{low_m:g} m" if low_m == high_m else f"{low_m:g} to {high_m:g} m",
            "mean metrics": metrics or "none",
        }

    @typed
    def save(
        self,
        file: str | FilePath,
        *more: str | FilePath,
        report: "RouteReport | None" = None,
        end: str | None = None,
    ) -> FilePath:
        """Write the path in the format that a file's suffix names, and return the (first) file.

        Args:
          file: ``.geojson``, ``.kml``, ``.gpx`` or ``.plan`` (see `jaxurban.paths.export.write.FORMATS`).
          more: further files, for further formats.
          report: from `jaxurban.explain`, to be written too.
          end: of a ``.plan``: ``"land"``, ``"return"`` or ``"none"`` (see `write_path`).

        Raises:
          InputError: there is no path, another suffix, an end that is none or without a ``.plan``, or a folder that
            does not exist or cannot be written to.
        """
        if not self.status.has_path:
            raise InputError(f"there is no path to save: {self.status.sentence}")
        files = [FilePath(each) for each in (file, *more)]
        missions = [each for each in files if each.suffix.lower() == MISSION] or files  # which refuse an end
        for each in files:
            write_path(self, each, report, end=end if each in missions else None)
        return FilePath(file)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the points' arrays as plain, JSON-ready values (None for no number)."""
        return {
            "status": self.status.value,
            "message": self.message,
            "cost": _number(self.cost),
            "cost_by_layer": {name: _number(value) for name, value in self.cost_by_layer.items()},
            "length_m": _number(self.length_m),
            "metrics": {name: _number(value) for name, value in self.metrics.items()},
            "altitude_m": self.altitude_m,
            "snap_distance_m": {"start": self.snap_distance_m[0], "goal": self.snap_distance_m[1]},
            "objective_cost": _number(self.search.cost),
            "lower_bound": _number(self.search.lower_bound),
            "gap": _number(self.search.gap),
            **{name: getattr(self.search, name) for name in OF_SEARCH},
            "num_points": len(self.xy_m),
            "batches": [
                {"elapsed_s": seconds, "samples": samples, "cost": _number(cost)}
                for seconds, samples, cost in self.search.history
            ],
            "crs": self.crs,
            "settings": dict(self.settings),
        }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def finish(on: "CostMap", path: Path, ends: tuple[Place, Place], search: PathSearch) -> PlannedPath:
    """Return a planner's path with its weighted cost, its metrics, its coordinates and its settings.

    Args:
      path: from a planner.
      ends: from `locate`.
      search: how it was searched for, for the record.
    """
    budget_s = search.budget_s if np.isfinite(search.budget_s) else None
    settings = map_settings(on) | {"budget_s": budget_s, "seed": search.seed}
    if on.levels is not None:
        settings["goal_altitude_m"] = float(on.altitudes_m[ends[1].cell[0]])
    nowhere: dict[str, Any] = {"xy_m": np.empty((0, 2)), "lonlat": np.empty((0, 2)), "z_m": np.empty(0), "metrics": {}}
    no_path = nowhere | {"cost": math.inf, "cost_by_layer": {}, "length_m": math.inf}
    return PlannedPath(
        **(measured(on, path.points_m) if path.status.has_path else no_path),
        status=path.status,
        altitude_m=float(on.altitudes_m[0 if on.levels is None else ends[0].cell[0]]),
        snap_distance_m=(ends[0].snap_distance_m, ends[1].snap_distance_m),
        search=replace(path, note=_note(on, path, ends)),
        settings=settings,
        crs=on.grid.crs,
        zones=on.constraints.zones,
        maps=on.maps,
    )


def measured(on: "CostMap", points_m: np.ndarray) -> dict[str, Any]:
    """Return where a path lies, what it costs and what it meets, under the names of `PlannedPath`.

    Args:
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner; in a volume ``[N, 3]``, with the altitude.
    """
    grid = on.grid
    xy_m = points_m[:, :2] + np.array([grid.x_min_m, grid.y_min_m])
    features = on.problem.features(points_m)
    parts = zip(on.weight_names, on.weight_vector * features.phi, strict=True)
    return {
        "xy_m": xy_m,
        "lonlat": np.stack(grid.lonlat_of_xy(xy_m[:, 0], xy_m[:, 1]), axis=-1),
        "z_m": np.full(len(xy_m), on.altitude_m) if on.levels is None else points_m[:, 2],
        "cost": features.cost(on.weight_vector),
        "cost_by_layer": {name: float(cost) for name, cost in parts},
        "length_m": float(features.phi[0]),
        "metrics": on.means(features),
        "ground": None if on.terrain_m is None else ground_along(points_m[:, :2], on.terrain_m, grid),
    }


def _note(on: "CostMap", path: Path, ends: tuple[Place, Place]) -> str:
    """Return what the planner noted, and what a reader of the path must know beside it."""
    has_path = path.status.has_path
    notes = [path.note]
    if not on.is_weighed and on.objective == "weighted":
        notes = ["All weights are zero, so every path is as cheap: the distance was minimised instead."]
    notes.append(snap_note(*ends))
    if kept := kept_said(on.constraints.to_dict(), on.grid.resolution_m):
        notes.append(f"Distance to obstacles: {on.constraints.horizontal_m:g} m asked, {kept}.")
    if on.is_weighed and on.weights.distance == 0 and not path.note and has_path:
        notes.append("The distance weighs nothing, so the path may be far longer than it need be.")
    if between := _between_m(on):
        low_m, high_m = between
        notes.append(f"Metrics at {on.altitude_m:g} m are interpolated between the maps of {low_m:g} and {high_m:g} m.")
    if (said := str(on.constraints)) and not has_path:
        without = sum(int(on.maps.is_free(z_m).sum()) for z_m in on.altitudes_m.tolist())
        share = 1 - on.is_free.sum() / without
        notes.append(f"Constraints were on ({said}): they close {share:.1%} of the cells without an obstacle.")
    if path.status is Status.NO_PATH:
        notes += [pocket_note(on, *ends), what_would_join(on, ends[0].cell, ends[1].cell)]
    asked = [name for name, weight in on.weights.to_dict().items() if weight > 0]
    if missing := [name for name in asked if name not in ("distance", *on.names)]:
        notes.append(f"These maps hold no {' and no '.join(missing)}, so that weight is ignored.")
    bounded = {bound.variable for bound in on.constraints.bounds}
    for name, metric in on.maps.metrics.items():  # that the path pays for or is bounded by
        if (name in on.names and on.weights[name] > 0) or bounded & {*metric.variables}:
            notes.append(metric.caveat)
    return " ".join(filter(None, notes))


def map_settings(on: "CostMap") -> dict[str, Any]:
    """Return what a cost map says of the paths that are planned on it, as their settings hold it."""
    settings: dict[str, Any] = {
        "objective": on.objective,
        **on.cost_model.settings,
        "weights": {name: float(on.weights[name]) for name in ("distance", *on.names)},
        "time": on.time,
        "time_of_day": on.time_of_day,
        "limits": on.constraints.to_dict(),
        "obstacles": on.maps.obstacles,
        "resolution_m": on.grid.resolution_m,
    }
    if on.levels is None:
        between = _between_m(on)
        return settings | ({"metrics_between_m": between} if between else {})
    asked = {name: getattr(on.levels, name) for name in ("min_altitude_m", "max_altitude_m", "level_step_m")}
    climb_cost, descent_cost = on.weight_vector[-2:].tolist()
    levels = {"levels_m": on.altitudes_m.tolist(), "climb_cost": climb_cost, "descent_cost": descent_cost}
    return settings | asked | levels


def _between_m(on: "CostMap") -> list[float]:
    """Return the two altitudes that metrics are interpolated between; none in a volume or where the maps hold it."""
    around = [] if on.levels is not None else on.maps.around(on.altitude_m)
    return around if len(around) == 2 else []
