"""plan: a path between two places over metric maps, evaluated the same way for every planner."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxurban.cost import METRICS, Weights
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.orbits import iso_utc, parse_time
from jaxurban.maps import MetricMaps
from jaxurban.planners.base import Cell, CostModel, Diagonal, Path, Problem, Status
from jaxurban.planners.evaluate import PathCost, evaluate
from jaxurban.planners.registry import find_planner

Point = tuple[float, float]


@dataclass(frozen=True)
class PlannedPath:
    """A path over metric maps with its cost and metrics. ``N`` points.

    Attributes:
      status: how the planner ended; `Status.has_path` tells whether there is a path.
      xy_m: ``[N, 2]`` easting, northing of the path's points in the maps' CRS; empty without a path.
      lonlat: ``[N, 2]`` longitude, latitude in degrees.
      altitude_m: flight altitude above ground.
      cost: weighted cost under ``cost_model``, whatever the objective was; inf without a path.
      cost_by_layer: parts of ``cost``: "distance" and each metric.
      length_m: length of the path.
      metrics: mean of each metric m along the path, weighted by length, by name.
      snap_distance_m: how far start and goal were moved to the centres of their cells (or, with
        ``snap``, out of an obstacle).
      search: what the planner itself reported: bound, expansions, time, heuristic, backend, note.
      settings: planner, weights, cost model, objective and the like, for the record.
      crs: CRS of ``xy_m``.
    """

    status: Status
    xy_m: np.ndarray
    lonlat: np.ndarray
    altitude_m: float
    cost: float
    cost_by_layer: Mapping[str, float]
    length_m: float
    metrics: Mapping[str, float]
    snap_distance_m: tuple[float, float]
    search: Path
    settings: Mapping[str, Any]
    crs: str

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the points' arrays as plain, JSON-ready values (None for no number)."""
        return {
            "status": self.status.value,
            "message": " ".join(filter(None, (self.status.sentence, self.search.note))),
            "cost": _number(self.cost),
            "cost_by_layer": {name: _number(value) for name, value in self.cost_by_layer.items()},
            "length_m": _number(self.length_m),
            "metrics": {name: _number(value) for name, value in self.metrics.items()},
            "altitude_m": self.altitude_m,
            "snap_distance_m": {"start": self.snap_distance_m[0], "goal": self.snap_distance_m[1]},
            "objective_cost": _number(self.search.cost),
            "lower_bound": _number(self.search.lower_bound),
            "num_expanded": self.search.num_expanded,
            "elapsed_s": self.search.elapsed_s,
            "planner": self.search.planner,
            "heuristic": self.search.heuristic,
            "backend": self.search.backend,
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


def plan(
    maps: MetricMaps,
    start: Point | None = None,
    goal: Point | None = None,
    *,
    altitude_m: float,
    start_xy_m: Point | None = None,
    goal_xy_m: Point | None = None,
    weights: Weights | None = None,
    planner: str = "astar-plus",
    heuristic: str | None = None,
    objective: str = "weighted",
    cost_model: CostModel = "cell",
    time: str | None = None,
    time_of_day: str | None = None,
    connectivity: int = 8,
    diagonal: Diagonal = "both-free",
    reference_length_m: float = 5.0,
    budget_s: float = 180.0,
    seed: int = 0,
    snap: bool = False,
) -> PlannedPath:
    """Return a path from ``start`` to ``goal`` at one altitude.

    Args:
      maps: from `build_maps` or `open_maps`.
      start, goal: longitude, latitude in degrees.
      altitude_m: one of the maps' altitudes.
      start_xy_m, goal_xy_m: easting, northing in the maps' CRS, instead of ``start`` and ``goal``.
      weights: default `Weights()`.
      planner: ``"ptp"``, ``"astar-dist"``, ``"astar-plus"`` ...
      heuristic: left out, the planner's own.
      objective: ``"weighted"``, or ``"distance"`` for the shortest path (its weighted cost is reported).
      cost_model: ``"cell"`` (the paper) or ``"line"``.
      time: epoch of the GPS map; the first if left out.
      time_of_day: of the population map; the first if left out.
      connectivity, diagonal: neighbours of the grid planners.
      reference_length_m: l_0 of the line model.
      budget_s: seconds that the search may take.
      seed: for sampling planners.
      snap: move a start or goal inside an obstacle to the nearest free cell instead of failing.

    Raises:
      InputError: a place outside the maps or inside an obstacle (names the nearest free cell), or an
        unknown altitude, planner, heuristic or objective.
    """
    weights = (weights or Weights()).checked()
    if objective not in ("weighted", "distance"):
        raise InputError(f"objective must be 'weighted' or 'distance', got {objective!r}")
    search = find_planner(planner, heuristic)
    is_free = maps.is_free(altitude_m)
    costs = maps.costs(altitude_m, time=time, time_of_day=time_of_day)
    grid = maps.grid
    ends = [
        _locate(name, grid, is_free, lonlat, xy_m, snap)
        for name, lonlat, xy_m in (("start", start, start_xy_m), ("goal", goal, goal_xy_m))
    ]
    layers = np.zeros((len(costs), *grid.shape))
    for layer, (name, cost) in zip(layers, costs.items(), strict=True):
        layer[:] = getattr(weights, name) * np.where(is_free, cost, np.nan_to_num(cost)).astype(np.float64)
    is_weighted = objective == "weighted" and (weights.distance > 0 or layers.any())
    problem = Problem(
        layers=layers if is_weighted else np.zeros((1, *grid.shape)),
        is_free=is_free,
        start=ends[0][0],
        goal=ends[1][0],
        resolution_m=grid.resolution_m,
        distance_weight=float(weights.distance) if is_weighted else 1.0,
        cost_model=cost_model,
        reference_length_m=reference_length_m,
        connectivity=connectivity,
        diagonal=diagonal,
    )
    found = search(problem, budget_s=budget_s, seed=seed)
    if objective == "weighted" and not is_weighted:
        found = replace(found, note="All weights are zero, so every path is as cheap: this is the shortest one.")
    if unpaid := [name for name in METRICS if name not in costs and getattr(weights, name) > 0]:
        note = f"These maps hold no {' and no '.join(unpaid)}, so that weight is ignored."
        found = replace(found, note=" ".join(filter(None, (found.note, note))))
    xy_m = found.points_m + np.array([grid.x_min_m, grid.y_min_m])
    paid = None
    if found.status.has_path:
        paid = evaluate(
            found.points_m,
            layers,
            is_free,
            grid.resolution_m,
            float(weights.distance),
            cost_model,
            reference_length_m,
        )
    return PlannedPath(
        status=found.status,
        xy_m=xy_m,
        lonlat=np.stack(grid.lonlat_of_xy(xy_m[:, 0], xy_m[:, 1]), axis=-1) if len(xy_m) else np.empty((0, 2)),
        altitude_m=float(altitude_m),
        cost=float("inf") if paid is None else paid.total,
        cost_by_layer=_by_layer(paid, list(costs)),
        length_m=float("inf") if paid is None else paid.length_m,
        metrics=_means(maps, found, grid, altitude_m, time, time_of_day),
        snap_distance_m=(ends[0][1], ends[1][1]),
        search=found,
        settings={
            "objective": objective,
            "cost_model": cost_model,
            "reference_length_m": reference_length_m,
            "connectivity": connectivity,
            "diagonal": diagonal,
            "weights": {name: float(getattr(weights, name)) for name in ("distance", *costs)},
            "time": maps.default_time if time is None else iso_utc(parse_time(time)),
            "time_of_day": time_of_day or next(iter(maps.times_of_day), None),
            "resolution_m": grid.resolution_m,
            "budget_s": budget_s,
            "seed": seed,
        },
        crs=grid.crs,
    )


def _locate(
    name: str, grid: Grid, is_free: np.ndarray, lonlat: Point | None, xy_m: Point | None, snap: bool
) -> tuple[Cell, float]:
    """Return the cell of a place and how far its centre is from the place, metres."""
    try:
        if lonlat is not None and xy_m is None:
            x_m, y_m = (float(value) for value in grid.xy_of_lonlat(*lonlat))
            row, col = grid.cell_of_lonlat(*lonlat)
        elif xy_m is not None and lonlat is None:
            x_m, y_m = xy_m
            row, col = grid.cell_of_xy(x_m, y_m)
        else:
            raise InputError(f"give it either as longitude, latitude or as {name}_xy_m, and not both")
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    cell = (int(row), int(col))
    if not is_free[cell]:
        nearest = _nearest_free(cell, is_free)
        if nearest is None:
            raise InputError(f"{name} is inside an obstacle and no cell is free at this altitude: fly higher")
        near_lon, near_lat = grid.lonlat_of_cell(*nearest)
        if not snap:
            away_m = np.hypot(nearest[0] - cell[0], nearest[1] - cell[1]) * grid.resolution_m
            raise InputError(
                f"{name} is inside an obstacle (or where there are no data) at this altitude; the nearest free cell "
                f"is at {near_lon:.6f},{near_lat:.6f}, {away_m:.0f} m away: start there, fly higher, or pass --snap "
                "(snap=True) to move there"
            )
        cell = nearest
    centre_x_m, centre_y_m = grid.xy_of_cell(*cell)
    return cell, float(np.hypot(centre_x_m - x_m, centre_y_m - y_m))


def _nearest_free(cell: Cell, is_free: np.ndarray) -> Cell | None:
    rows, cols = np.nonzero(is_free)
    if rows.size == 0:
        return None
    nearest = np.argmin((rows - cell[0]) ** 2 + (cols - cell[1]) ** 2)
    return int(rows[nearest]), int(cols[nearest])


def _by_layer(paid: PathCost | None, names: list[str]) -> dict[str, float]:
    if paid is None:
        return {}
    metrics = dict(zip(names, (float(value) for value in paid.per_layer), strict=True))
    return {"distance": paid.total - sum(metrics.values()), **metrics}


def _means(
    maps: MetricMaps, found: Path, grid: Grid, altitude_m: float, time: str | None, time_of_day: str | None
) -> dict[str, float]:
    """Return the mean of each metric along a path, by the exact length in each cell."""
    if not found.status.has_path:
        return {}
    m = [np.nan_to_num(maps.m(name, altitude_m, time=time, time_of_day=time_of_day)) for name in maps.metrics]
    free = np.ones(grid.shape, bool)
    if len(found.points_m) == 1:
        row, col = (int(value // grid.resolution_m) for value in found.points_m[0][::-1])
        return {name: float(values[row, col]) for name, values in zip(maps.metrics, m, strict=True)}
    # The line model with l_0 = 1 m and no distance weight integrates each layer along the path.
    integral = evaluate(found.points_m, np.stack(m).astype(np.float64), free, grid.resolution_m, 0.0, "line", 1.0)
    return {
        name: float(value) / integral.length_m for name, value in zip(maps.metrics, integral.per_layer, strict=True)
    }
