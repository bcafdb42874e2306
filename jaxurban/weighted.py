"""WeightedMap: the maps at one altitude and time under weights, ready for any number of queries."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxurban.cost import METRICS, Weights
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.ground import Ground, ground_along
from jaxurban.io.orbits import iso_utc, parse_time
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import Cell, CostKind, CostModel, Path, Problem, Status
from jaxurban.planners.evaluate import PathCost, evaluate
from jaxurban.planners.refine import refine as refine_path
from jaxurban.planners.registry import check_seed, find_planner
from jaxurban.planners.theta import check_line_model
from jaxurban.reachability import Reachability
from jaxurban.snapping import Place as Place
from jaxurban.snapping import free_place, snap_note

Point = tuple[float, float]
REFINING_SHARE = 0.25  # of the budget, kept for refinement where it is asked for


@dataclass(frozen=True, eq=False)
class WeightedMap:
    """Metric maps at one altitude and time under weights. ``L`` metrics, ``Y`` rows, ``X`` columns.

    Queries share it, and with it what planners derive from the map.

    Attributes:
      maps: where it comes from.
      altitude_m: altitude above ground.
      time: epoch of the GPS map; None where a long series keeps statistics over time.
      time_of_day: of the population map; None without one.
      weights: as floats.
      objective: ``"weighted"`` or ``"distance"``.
      cost_model: see `Problem`.
      names: the metrics of the layers.
      m: ``[L, Y, X]`` float32 the metrics; 0 where there are no data.
      layers: ``[L, Y, X]`` float64 weighted costs w_j c_j, whatever the objective is.
      is_free: ``[Y, X]`` bool, where a path may fly: no obstacle, data there, and within the limits.
      limits: what closes cells beside obstacles.
    """

    maps: MetricMaps
    altitude_m: float
    time: str | None
    time_of_day: str | None
    weights: Weights
    objective: str
    cost_model: CostModel
    names: tuple[str, ...]
    m: np.ndarray
    layers: np.ndarray
    is_free: np.ndarray
    limits: Limits = field(default_factory=Limits)

    @cached_property
    def grid(self) -> Grid:
        """The grid of the maps."""
        return self.maps.grid

    @cached_property
    def terrain_m(self) -> np.ndarray | None:
        """``[Y, X]`` elevation of the ground; None where the maps hold no terrain."""
        return self.maps.m("terrain") if "terrain" in self.maps.ds else None

    def cost_of(self, name: str) -> float:
        """Return the largest weighted cost of a metric over free cells; 0 where it costs nothing anywhere."""
        return float(self.layers[self.names.index(name)][self.is_free].max(initial=0.0))

    @cached_property
    def is_weighed(self) -> bool:
        """Whether anything but the shortest path is asked for: not with all weights zero."""
        return self.objective == "weighted" and bool(self.weights.distance > 0 or self.layers.any())

    @cached_property
    def problem(self) -> Problem:
        """The planners' view of the map, from its first free cell to itself; `Problem.between` asks for others.

        Raises:
          InputError: no cell is free.
        """
        if not self.is_free.any():
            raise InputError(f"no cell is free at {self.altitude_m:g} m: {self._remedy}")
        row, col = np.unravel_index(np.argmax(self.is_free), self.is_free.shape)
        free_cell = (int(row), int(col))
        return Problem(
            layers=self.layers if self.is_weighed else np.zeros((1, *self.is_free.shape)),
            is_free=self.is_free,
            start=free_cell,
            goal=free_cell,
            resolution_m=self.grid.resolution_m,
            distance_weight=float(self.weights.distance) if self.is_weighed else 1.0,
            cost_model=self.cost_model,
        )

    def locate(
        self, name: str, lonlat: Point | None = None, xy_m: Point | None = None, *, snap: bool | float = False
    ) -> Place:
        """Return the cell of a place given in degrees or in metres.

        Args:
          name: ``"start"`` or ``"goal"``, for messages.
          lonlat: longitude, latitude in degrees.
          xy_m: easting, northing in the maps' CRS, instead.
          snap: move out of a closed cell to the nearest free one, by at most 50 m, or so many metres (`free_place`).

        Raises:
          InputError: none or both are given, a place outside the maps, or inside an obstacle or
            closed by a limit, unless ``snap`` reaches a free cell (names the limit and the nearest free cell).
        """
        (x_m, y_m), cell = self.cell_of(name, lonlat, xy_m)
        why = "" if self.is_free[cell] else self.why_closed(cell)
        return free_place(
            name, (x_m, y_m), cell, self.is_free, self.grid, snap=snap, why_closed=why, remedy=self._remedy
        )

    def cell_of(self, name: str, lonlat: Point | None = None, xy_m: Point | None = None) -> tuple[Point, Cell]:
        """Return easting, northing and the cell of a place, free or not (arguments and errors as in `locate`)."""
        grid = self.grid
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
        return (float(x_m), float(y_m)), (int(row), int(col))

    @property
    def _remedy(self) -> str:
        return f"fly higher, or loosen the limits ({self.limits})" if self.limits else "fly higher"

    def why_closed(self, cell: Cell) -> str:
        """Return what closes a cell: an obstacle, or each limit by name."""
        if not self.maps.is_free(self.altitude_m)[cell]:
            return f"{why_blocked(self.maps, self.altitude_m, cell)} at {self.altitude_m:g} m"
        reasons = self.limits.reasons(self.maps, self.altitude_m, cell, self.time, self.time_of_day)
        return f"closed by {' and '.join(reasons)} at {self.altitude_m:g} m"

    def plan(
        self,
        start: Point | None = None,
        goal: Point | None = None,
        *,
        start_xy_m: Point | None = None,
        goal_xy_m: Point | None = None,
        planner: str = "astar-plus",
        heuristic: str | None = None,
        budget_s: float = 180.0,
        seed: int = 0,
        snap: bool | float = False,
        refine: bool = False,
    ) -> PlannedPath:
        """Return a path between two places (arguments and errors as in `jaxurban.plan`)."""
        search = find_planner(planner, heuristic)
        check_seed(seed)
        ends = (
            self.locate("start", start, start_xy_m, snap=snap),
            self.locate("goal", goal, goal_xy_m, snap=snap),
        )
        problem = self.problem.between(ends[0].cell, ends[1].cell)
        if refine:
            check_line_model(problem, "refinement")
        # An anytime planner would leave nothing of the budget to refine with.
        found = search(problem, budget_s=budget_s * (1 - REFINING_SHARE) if refine else budget_s, seed=seed)
        if refine and found.status.has_path:
            left_s = budget_s - found.elapsed_s - found.setup_s
            found = refine_path(problem, found, budget_s=max(left_s, budget_s * REFINING_SHARE / 2))
        return self.finish(found, ends, budget_s=budget_s, seed=seed)

    @cached_property
    def reachability(self) -> Reachability:
        """What joins places on these maps."""
        return Reachability(self.maps, self.limits, self.time, self.time_of_day, self.cost_model.joins_corners)

    def finish(
        self, found: Path, ends: tuple[Place, Place], *, budget_s: float, seed: int, remedy: str | None = None
    ) -> PlannedPath:
        """Return a planner's path with its weighted cost, its metrics, its coordinates and its settings.

        Args:
          found: from a planner.
          ends: from `locate`.
          budget_s, seed: for the record.
          remedy: sentence on what would join start and goal where nothing does; left out, it is found here.
        """
        grid = self.grid
        notes = (
            [found.note]
            if self.is_weighed or self.objective == "distance"
            else ["All weights are zero, so every path is as cheap: the distance was minimised instead."]
        )
        notes.append(snap_note(*ends))
        if self.is_weighed and self.weights.distance == 0 and not found.note and found.status.has_path:
            notes.append("The distance weighs nothing, so the path may be far longer than it need be.")
        if self.limits and not found.status.has_path:
            share = 1 - self.is_free.sum() / self.maps.is_free(self.altitude_m).sum()
            notes.append(f"Limits were on ({self.limits}): they close {share:.1%} of the cells without an obstacle.")
        if found.status is Status.NO_PATH:
            if remedy is None:
                remedy = self.reachability.what_would_join(ends[0].cell, ends[1].cell, self.altitude_m)
            notes.append(remedy)
        if unpaid := [name for name in METRICS if name not in self.names and getattr(self.weights, name) > 0]:
            notes.append(f"These maps hold no {' and no '.join(unpaid)}, so that weight is ignored.")
        xy_m = found.points_m + np.array([grid.x_min_m, grid.y_min_m])
        paid = self.evaluate(found.points_m) if found.status.has_path else None
        return PlannedPath(
            status=found.status,
            xy_m=xy_m,
            lonlat=np.stack(grid.lonlat_of_xy(xy_m[:, 0], xy_m[:, 1]), axis=-1) if len(xy_m) else np.empty((0, 2)),
            z_m=np.full(len(xy_m), float(self.altitude_m)),
            altitude_m=float(self.altitude_m),
            cost=float("inf") if paid is None else paid.total,
            cost_by_layer={} if paid is None else self._by_layer(paid),
            length_m=float("inf") if paid is None else paid.length_m,
            metrics={} if paid is None else self._means(paid),
            snap_distance_m=(ends[0].snap_distance_m, ends[1].snap_distance_m),
            search=replace(found, note=" ".join(filter(None, notes))),
            settings={
                "objective": self.objective,
                **self.cost_model.settings,
                "weights": {name: float(getattr(self.weights, name)) for name in ("distance", *self.names)},
                "time": self.time,
                "time_of_day": self.time_of_day,
                "limits": self.limits.to_dict(),
                "obstacles": self.maps.obstacles,
                "resolution_m": grid.resolution_m,
                "budget_s": budget_s if np.isfinite(budget_s) else None,
                "seed": seed,
            },
            crs=grid.crs,
            ground=self._ground_under(found),
        )

    def _ground_under(self, found: Path) -> Ground | None:
        if self.terrain_m is None or not found.status.has_path:
            return None
        return ground_along(found.points_m, self.terrain_m, self.grid)

    def evaluate(self, points_m: np.ndarray) -> PathCost:
        """Return the weighted cost of a polyline ``[N, 2]`` in metres from the map's southwest corner."""
        return evaluate(
            points_m,
            self.layers,
            self.is_free,
            self.grid.resolution_m,
            float(self.weights.distance),
            self.cost_model,
        )

    def _by_layer(self, paid: PathCost) -> dict[str, float]:
        metrics = dict(zip(self.names, (float(value) for value in paid.per_layer), strict=True))
        return {"distance": paid.total - sum(metrics.values()), **metrics}

    def _means(self, paid: PathCost) -> dict[str, float]:
        """Return the mean of each metric along a path, by the exact length in each cell."""
        crossed = paid.crossings
        length_m = crossed.length_m if paid.length_m > 0 else np.ones(1)
        along = self.m[:, crossed.row, crossed.col].astype(np.float64)
        return {name: float(value) for name, value in zip(self.names, along @ length_m / length_m.sum(), strict=True)}


def why_blocked(maps: MetricMaps, altitude_m: float, cell: Cell) -> str:
    """Return how the rule of obstacles blocks a cell: by its centre or, under ``"touched"``, only by its edge."""
    if maps.is_free(altitude_m, "centre")[cell]:
        return "in a cell that an obstacle touches"
    return "inside an obstacle (or where there are no data)"


def weigh(
    maps: MetricMaps,
    altitude_m: float,
    *,
    weights: Weights | None = None,
    objective: str = "weighted",
    cost_model: CostModel | CostKind = "cell",
    time: str | None = None,
    time_of_day: str | None = None,
    limits: Limits | None = None,
) -> WeightedMap:
    """Return the maps at one altitude under weights, on which any number of paths can be planned.

    Args:
      maps: from `build_maps` or `open_maps`.
      altitude_m: one of the maps' altitudes.
      weights: default `Weights()`.
      objective: ``"weighted"``, or ``"distance"`` for the shortest path (its weighted cost is reported).
      cost_model: how steps are charged and which are allowed, or its kind alone: ``"cell"`` (the paper) or
        ``"line"``.
      time: epoch of the GPS map; the first if left out.
      time_of_day: of the population map; the first if left out.
      limits: no-fly zones and bounds that close cells to every planner.

    Raises:
      InputError: an unknown altitude, time, time of day or objective, a wrong weight, or a bound on a map that
        is not there.
    """
    weights = (weights or Weights()).checked()
    if objective not in ("weighted", "distance"):
        raise InputError(f"objective must be 'weighted' or 'distance', got {objective!r}")
    limits = limits or Limits()
    is_free = limits.is_free(maps, altitude_m, time=time, time_of_day=time_of_day)
    costs = maps.costs(altitude_m, time=time, time_of_day=time_of_day)
    m = np.zeros((len(costs), *is_free.shape), np.float32)
    layers = np.zeros(m.shape)
    for row, (name, cost) in enumerate(costs.items()):
        m[row] = np.nan_to_num(maps.m(name, altitude_m, time=time, time_of_day=time_of_day))
        layers[row] = getattr(weights, name) * np.where(is_free, cost, np.nan_to_num(cost)).astype(np.float64)
    return WeightedMap(
        maps=maps,
        altitude_m=float(altitude_m),
        time=maps.default_time if time is None else iso_utc(parse_time(time)),
        time_of_day=time_of_day or next(iter(maps.times_of_day), None),
        weights=weights,
        objective=objective,
        cost_model=CostModel.of(cost_model),
        names=tuple(costs),
        m=m,
        layers=layers,
        is_free=is_free,
        limits=limits,
    )
