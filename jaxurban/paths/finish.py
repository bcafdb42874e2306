"""What comes of a planner's path over a cost map: cost by layer, metrics, coordinates, and what must be said of it."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxurban.metrics.registry import METRICS, ON_REQUEST
from jaxurban.paths.constraints import kept_said
from jaxurban.paths.ground import ground_along
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.search import PathSearch
from jaxurban.paths.snapping import Place, snap_note
from jaxurban.planners.base import Path, Status

if TYPE_CHECKING:
    from jaxurban.paths.cost_map import CostMap


def finish(on: "CostMap", found: Path, ends: tuple[Place, Place], search: PathSearch) -> PlannedPath:
    """Return a planner's path with its weighted cost, its metrics, its coordinates and its settings.

    Args:
      found: from a planner.
      ends: from `locate`.
      search: how it was searched for, for the record.
    """
    has_path = found.status.has_path
    return PlannedPath(
        **(measured(on, found.points_m) if has_path else NO_PATH),
        status=found.status,
        altitude_m=float(on.altitudes_m[0 if on.levels is None else ends[0].cell[0]]),
        snap_distance_m=(ends[0].snap_distance_m, ends[1].snap_distance_m),
        search=replace(found, note=_note(on, found, ends)),
        settings=_settings(on, ends, search),
        crs=on.grid.crs,
        zones=on.constraints.zones,
        maps=on.maps,
    )


NO_PATH: dict[str, Any] = {
    "xy_m": np.empty((0, 2)),
    "lonlat": np.empty((0, 2)),
    "z_m": np.empty(0),
    "cost": math.inf,
    "cost_by_layer": {},
    "length_m": math.inf,
    "metrics": {},
}


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


def _note(on: "CostMap", found: Path, ends: tuple[Place, Place]) -> str:
    """Return what the planner noted, and what a reader of the path must know beside it."""
    has_path = found.status.has_path
    notes = [found.note]
    if not on.is_weighed and on.objective == "weighted":
        notes = ["All weights are zero, so every path is as cheap: the distance was minimised instead."]
    notes.append(snap_note(*ends))
    if kept := kept_said(on.constraints.to_dict(), on.grid.resolution_m):
        notes.append(f"Distance to obstacles: {on.constraints.horizontal_m:g} m asked, {kept}.")
    if on.is_weighed and on.weights.distance == 0 and not found.note and has_path:
        notes.append("The distance weighs nothing, so the path may be far longer than it need be.")
    if between := _between_m(on):
        low_m, high_m = between
        notes.append(f"Metrics at {on.altitude_m:g} m are interpolated between the maps of {low_m:g} and {high_m:g} m.")
    if (said := str(on.constraints)) and not has_path:
        without = sum(int(on.maps.is_free(z_m).sum()) for z_m in on.altitudes_m.tolist())
        share = 1 - on.is_free.sum() / without
        notes.append(f"Constraints were on ({said}): they close {share:.1%} of the cells without an obstacle.")
    if found.status is Status.NO_PATH:
        notes.append(on.what_would_join(*ends))
    weighed = on.weights.to_dict()
    asked = [*(name for name in METRICS if on.weights[name] > 0), *(name for name in ON_REQUEST if weighed.get(name))]
    if missing := [name for name in asked if name not in on.names]:
        notes.append(f"These maps hold no {' and no '.join(missing)}, so that weight is ignored.")
    return " ".join(filter(None, (*notes, *caveats_of(on))))


def caveats_of(on: "CostMap") -> list[str]:
    """Return what a reader must know of the metrics that a path pays for or is bounded by."""
    bounded = {bound.variable for bound in on.constraints.bounds}
    return [
        metric.caveat
        for name, metric in on.maps.metrics.items()
        if metric.caveat and ((name in on.names and on.weights[name] > 0) or bounded & {*metric.variables})
    ]


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


def _settings(on: "CostMap", ends: tuple[Place, Place], search: PathSearch) -> dict[str, Any]:
    settings = map_settings(on) | {
        "budget_s": search.budget_s if np.isfinite(search.budget_s) else None,
        "seed": search.seed,
    }
    if on.levels is not None:
        settings["goal_altitude_m"] = float(on.altitudes_m[ends[1].cell[0]])
    return settings


def _between_m(on: "CostMap") -> list[float]:
    """Return the two altitudes that metrics are interpolated between; none in a volume or where the maps hold it."""
    around = [] if on.levels is not None else on.maps.around(on.altitude_m)
    return around if len(around) == 2 else []
