"""CostMap: metric maps at one altitude, or between several, under weights, ready for any number of queries."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from jaxurban import wings
from jaxurban.checks import one_of, typed
from jaxurban.errors import InputError
from jaxurban.maps.levels import Levels, around, listed_m
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.variables import ROOF_KIND
from jaxurban.metrics.weights import Weights, WeightsLike, weights_on
from jaxurban.paths.choices import SearchChoice
from jaxurban.paths.closed import CAUSES, causes_at, closed_facts
from jaxurban.paths.constraints import Constraints, describe_kept
from jaxurban.paths.finish import measured, plan_on
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY, Point, one_place
from jaxurban.paths.search import PathSearch
from jaxurban.paths.snapping import FreeSpace
from jaxurban.planners.base import Problem
from jaxurban.planners.cost import CostModel, PathFeatures
from jaxurban.public import FactsRepr
from jaxurban.settings import Objective, as_tuple
from jaxurban.world.grid import Grid

NO_WEIGHT = "All weights are zero, so every path is as cheap: the distance was minimised instead."
NOT_THE_PAPER = (
    "The paper's preset knows buildings alone, and these maps hold other kinds of obstacles too: to compare, make them "
    'with [obstacles] kinds = ["building"].'
)


class LineCost(NamedTuple):
    """What a line costs, and where no route may fly as it does.

    Attributes:
      cost: as of a path, under the map's weights and cost model. Closed cells count with what their layers cost, the
        most where the maps have no value.
      cost_by_layer: parts of ``cost``: "distance" and each metric.
      length_m: in plan.
      metrics: mean of each metric m along the line, by name.
      closed_m: metres in cells that are closed to routes, by cause (`jaxurban.paths.closed.CAUSES`).
      is_free: whether a route may fly so: over no closed cell, through no corner between two, and with its clearance.
      notes: what of a mission's file is not in its way, sentences without full stops.

    Examples:
      >>> straight = ju.cost_map(maps, 20.0).cost_of([start, goal])
      >>> straight.is_free, {cause: round(metres) for cause, metres in straight.closed_m.items() if metres}
      (False, {'obstacle': 28, 'touched by an obstacle': 113, 'vertical clearance': 57})
    """

    cost: float
    cost_by_layer: dict[str, float]
    length_m: float
    metrics: dict[str, float]
    closed_m: dict[str, float]
    is_free: bool
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class CostMap(FactsRepr):
    """Metric maps at one altitude, or between levels, under weights. ``L`` metrics, ``Y`` rows, ``X`` columns.

    Queries share it, and with it what planners derive from the map. The cost of a path is weights . features
    (`jaxurban.planners.cost`), here as for every planner.

    Attributes:
      maps: where it comes from.
      altitudes_m: ``[K]`` the altitude above ground, or the ascending levels of a volume.
      levels: how the path may climb and descend; None on one altitude.
      time: UTC time of the GPS map; None where a long series keeps statistics over time.
      time_of_day: of the population map; None without one.
      weights: of the path's cost.
      objective: ``"weighted"``, or ``"distance"`` for the shortest path (its weighted cost is reported).
      cost_model: how steps are costed and which are allowed.
      constraints: no-fly zones, bounds on maps and clearances; no path enters a cell that they close. A zone between
        two levels closes the lower one.
      names: the metrics of the layers.
      costs: ``[L, Y, X]`` float32 their costs c_j in [0, 1], not weighted, those of m = 0 where a closed cell has no
        value; ``[L, K, Y, X]`` in a volume.
      is_free: ``[Y, X]`` or ``[K, Y, X]`` bool, where a path may fly: no obstacle, data there, within the constraints.

    Examples:
      >>> cost_map = ju.cost_map(maps, 60.0)
      >>> cost_map.costs.shape, cost_map.names
      ((4, 30, 30), ('gps', 'lidar', 'population', 'risk'))
      >>> [cost_map.plan(start, goal).status.value, cost_map.plan(goal, start).status.value]
      ['optimal', 'optimal']
    """

    maps: MetricMaps
    altitudes_m: np.ndarray
    levels: Levels | None
    time: str | None
    time_of_day: str | None
    weights: Weights
    objective: Objective
    cost_model: CostModel
    constraints: Constraints
    names: tuple[str, ...]
    costs: np.ndarray
    is_free: np.ndarray

    @property
    def facts(self) -> dict[str, str]:
        """Grid, altitude or levels, weights and cost model, constraints, and the shares of closed and free cells."""
        weights = zip(self.weight_names, self.weight_vector, strict=True)
        heights_name = "altitude" if self.levels is None else "levels"
        shares = {"free": f"{self.is_free.mean():.1%} of the cells"}
        if self.levels is None:
            shares = closed_facts(self.causes)
        return {
            "grid": self.maps.facts["grid"],
            heights_name: f"{listed_m(self.altitudes_m)} m",
            "weights": ", ".join(f"{name} {weight:g}" for name, weight in weights),
            "objective": self.objective,
            "cost model": str(self.cost_model),
            "constraints": str(self.constraints),
            **shares,
        }

    @property
    def when(self) -> dict[str, str | None]:
        """Time and time of day of its maps, as arguments."""
        return {"time": self.time, "time_of_day": self.time_of_day}

    @cached_property
    def causes(self) -> np.ndarray:
        """``[Y, X]`` what closes each cell (`jaxurban.paths.closed.causes_at`), on one altitude."""
        return causes_at(self.maps, self.constraints, self.altitude_m, **self.when)

    @property
    def altitude_m(self) -> float:
        """The altitude above ground; the lowest level of a volume."""
        return float(self.altitudes_m[0])

    @cached_property
    def grid(self) -> Grid:
        """The grid of the maps."""
        return self.maps.grid

    @property
    def weight_names(self) -> tuple[str, ...]:
        """What each weight of `weight_vector` counts: distance, each metric, and in a volume climb and descent."""
        names = ("distance", *self.names)
        return names if self.levels is None else (*names, "climb", "descent")

    @cached_property
    def weight_vector(self) -> np.ndarray:
        """``[W]`` the weight of each of `weight_names` in the cost of a path: in a volume two more than on a plane."""
        weights = self.weights.vector(("distance", *self.names))
        if self.levels is None:
            return weights
        climb_cost = self.levels.climb_cost
        if climb_cost is None:  # a metre of climb then costs what a metre of distance does
            climb_cost = weights[0]
        return np.append(weights, [climb_cost, self.levels.descent_cost])

    @cached_property
    def record(self) -> dict[str, Any]:
        """What it says of itself in the settings of the paths on it: plain values, by the names of their record."""
        settings: dict[str, Any] = {
            "objective": self.objective,
            **self.cost_model.settings,
            "weights": {name: float(self.weights[name]) for name in ("distance", *self.names)},
            **self.when,
            "limits": self.constraints.to_dict(),
            "obstacles": self.maps.obstacles,
            "resolution_m": self.grid.resolution_m,
        }
        if self.levels is None:
            around_m = around(self.altitude_m, self.maps.altitudes_m)
            if len(around_m) == 2:
                settings["metrics_between_m"] = around_m
            return settings
        climb_cost, descent_cost = self.weight_vector[-2:].tolist()
        return settings | {
            "min_altitude_m": self.levels.min_altitude_m,
            "max_altitude_m": self.levels.max_altitude_m,
            "level_step_m": self.levels.level_step_m,
            "levels_m": self.altitudes_m.tolist(),
            "climb_cost": climb_cost,
            "descent_cost": descent_cost,
        }

    @cached_property
    def note(self) -> str:
        """The sentences that it adds to the note of every path on it."""
        return " ".join(filter(None, self._notes()))

    def _notes(self) -> Iterator[str]:
        """Yield the sentences of `note`, some of which may be empty."""
        if not self.is_weighed and self.objective == "weighted":
            yield NO_WEIGHT
        constraints = self.constraints
        kept = describe_kept(constraints.to_dict(), self.grid.resolution_m)
        if kept:
            yield f"Distance to obstacles: {constraints.horizontal_m:g} m asked, {kept}."
        between_m = self.record.get("metrics_between_m")
        if between_m:
            low_m, high_m = between_m
            yield f"Metrics at {self.altitude_m:g} m are interpolated between the maps of {low_m:g} and {high_m:g} m."
        if self.maps.planning.preset == "paper" and ROOF_KIND in self.maps.ds:
            yield NOT_THE_PAPER

        # Metrics that the maps lack, and the caveats of those that count.
        weighed = [name for name, weight in self.weights.to_dict().items() if weight > 0]
        missing = [name for name in weighed if name not in ("distance", *self.names)]
        if missing:
            yield f"These maps hold no {' and no '.join(missing)}, so that weight is ignored."
        bounded = {bound.variable for bound in constraints.bounds}
        for name, metric in self.maps.metrics.items():
            is_paid_for = name in self.names and self.weights[name] > 0
            if is_paid_for or not bounded.isdisjoint(metric.variables):
                yield metric.caveat

    @cached_property
    def is_weighed(self) -> bool:
        """Whether paths are planned under the weights, and not just for the shortest length.

        False under the objective ``"distance"``, and where no weight above 0 is of anything that costs: then every
        path would be as cheap.
        """
        if self.objective == "distance":
            return False
        distance_weight, *other_weights = self.weight_vector
        climb_and_descent = other_weights[len(self.names) :]  # empty on one altitude
        if distance_weight > 0 or max(climb_and_descent, default=0.0) > 0:
            return True
        layers = zip(self.costs, other_weights, strict=False)
        return any(weight > 0 and costs.any() for costs, weight in layers)

    @cached_property
    def free_space(self) -> FreeSpace:
        """Where its paths may fly: ends of queries, islands of joined cells, and what closes a cell."""
        joins_corners = self.cost_model.joins_corners and not self.leg_margin_m
        return FreeSpace(
            self.maps, self.altitudes_m, self.constraints, self.is_free, self.when, joins_corners
        )

    @cached_property
    def problem(self) -> Problem:
        """The planners' view of the map under its weights, made once.

        It leads from the first free cell to itself; `Problem.between` gives that of other ends.

        Raises:
          InputError: no cell is free.
        """
        return self.shortest.with_weights(self.weight_vector) if self.is_weighed else self.shortest

    @cached_property
    def shortest(self) -> Problem:
        """The same as `problem`, but length alone costs: for the shortest path. Made once.

        Raises:
          InputError: no cell is free.
        """
        self.free_space.check_any()
        indices = np.unravel_index(np.argmax(self.is_free), self.is_free.shape)
        first_free = tuple(map(int, indices))
        return Problem(
            costs=self.costs,
            is_free=self.is_free,
            start=first_free,
            goal=first_free,
            resolution_m=self.grid.resolution_m,
            weights=np.eye(len(self.weight_vector))[0],  # 1 for distance, 0 for all else
            cost_model=self.cost_model,
            levels_m=None if self.levels is None else self.altitudes_m,
            leg_margin_m=self.leg_margin_m,
        )

    @typed
    def only(self, metrics: Iterable[str]) -> "CostMap":
        """Return the map with the layers of these metrics alone, so that the others cost nothing.

        Args:
          metrics: names of metrics, each once.

        Returns:
          `CostMap` with the layers in the order of this one, which stays as it is.

        Raises:
          InputError: no name, a name given twice, or a metric that the maps lack.

        Examples:
          >>> ju.cost_map(maps, 60.0).only(["risk", "gps"]).weight_names
          ('distance', 'gps', 'risk')
        """
        names = as_tuple(metrics)
        for name in names:
            one_of("metric", name, self.names)
        if not names or len(set(names)) < len(names):
            raise InputError(
                f"metrics must name different metrics, and at least one, got {', '.join(names) or 'none'}"
            )
        is_kept = np.isin(self.names, names)
        kept_names = tuple(name for name in self.names if name in names)
        return replace(self, names=kept_names, costs=self.costs[is_kept])

    def with_weights(self, weights: WeightsLike) -> "CostMap":
        """Return the map under other weights; both maps share what does not depend on weights (`Problem.with_weights`).

        Returns:
          `CostMap`. Weights that are not named are as in the maps' scenario or by default.

        Raises:
          InputError: an invalid weight, or of a metric that the maps lack.

        Examples:
          >>> cost_map = ju.cost_map(maps, 60.0)
          >>> avoiding = cost_map.with_weights({"population": 5.0})
          >>> [round(each.plan(start, goal).length_m) for each in (cost_map, avoiding)]
          [848, 864]
        """
        other = replace(self, weights=weights_on(self.maps, weights))
        vars(other).update(shortest=self.shortest, free_space=self.free_space)
        return other

    @property
    def leg_margin_m(self) -> float:
        """What straight legs keep from closed cells, for the clearance."""
        return self.constraints.leg_margin_m(self.grid.resolution_m)

    @typed
    def plan(
        self,
        start: Point | XY,
        goal: Point | XY,
        **choice: Unpack[SearchChoice],
    ) -> PlannedPath:
        """Return a path between two places, given as in `jaxurban.plan`, searched for as `PathSearch.of` says.

        Returns:
          `PlannedPath`, whose status says how the search ended; errors are those of `jaxurban.plan`.

        Examples:
          >>> cost_map = ju.cost_map(maps, 60.0, objective="distance")
          >>> shortest = cost_map.plan(start, goal, planner="theta-star")
          >>> shortest.status.value, len(shortest.xy_m), round(shortest.length_m)
          ('feasible', 6, 711)
        """
        start_place = one_place("start", start)
        goal_place = one_place("goal", goal)
        search = PathSearch.of(is_for_volumes=self.levels is not None, **choice)
        return plan_on(self, start_place, goal_place, search)

    @typed
    def cost_of(self, line: PlannedPath | str | Path | np.ndarray | Sequence[Point]) -> LineCost:
        """Return what a line costs that was not planned here, by the same sum as the cost of a path.

        Args:
          line: ``[N, 2]`` longitudes and latitudes in degrees; a path; or the file of a mission, as `jaxurban.check`
            takes it. It counts as flown at this map's altitude, whatever its heights are.

        Returns:
          `LineCost`, which also says where no route may fly as the line does.

        Raises:
          InputError: a line that leaves the maps, places that are not in degrees, a cost map of levels, or as
            `jaxurban.check` of a file.

        Examples:
          >>> cost_map = ju.cost_map(maps, 60.0)
          >>> cost_map.cost_of(path).cost == path.cost
          True
          >>> cost_map.cost_of([start, goal]).is_free
          False
        """
        notes: tuple[str, ...] = ()
        if isinstance(line, str | Path):
            line, notes = wings.read_way(line)
        grid = self.grid
        xy_m = line.xy_m if isinstance(line, PlannedPath) else grid.xy_at(np.asarray(line, float))
        grid.cell_of_xy(*xy_m.T)  # refuses a place outside

        # What it adds up as if no cell were closed, and how far it runs in those that are.
        points_m = xy_m - grid.bounds_m[:2]
        features = self.problem.features(points_m)
        everywhere = replace(self, is_free=np.ones_like(self.is_free), constraints=Constraints())
        measures = measured(everywhere, points_m)
        metres = np.bincount(self.causes[features.crossed], features.length_m, len(CAUSES))
        return LineCost(
            **{name: measures[name] for name in ("cost", "cost_by_layer", "length_m", "metrics")},
            closed_m=dict(zip(CAUSES[1:], metres[1:].tolist(), strict=True)),
            is_free=features.is_valid,
            notes=notes,
        )

    def means(self, features: PathFeatures) -> dict[str, float]:
        """Return the mean of each metric m along a path, by the exact length in each cell.

        Args:
          features: of the path, as from ``problem.features``.

        Returns:
          Numbers in [0, 1] by the metric's name; of a path without length, m at its place.

        Examples:
          >>> cost_map = ju.cost_map(maps, 60.0)
          >>> means = cost_map.means(cost_map.problem.features(path.search.points_m))
          >>> {name: round(m, 2) for name, m in means.items()}
          {'gps': 0.88, 'lidar': 0.02, 'population': 0.07, 'risk': 1.0}
        """
        metrics = self.maps.metrics
        means = {}
        for name, mean_cost in zip(self.names, features.mean_costs, strict=True):
            # The same function turns c into m and m into c. Rounding may leave the range.
            m = float(metrics[name].cost(mean_cost))
            means[name] = min(max(m, 0.0), 1.0)
        return means
