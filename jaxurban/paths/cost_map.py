"""CostMap: metric maps at one altitude, or between several, under weights, ready for any number of queries."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any, Unpack

import numpy as np

from jaxurban.checks import one_of, typed
from jaxurban.errors import InputError
from jaxurban.maps.levels import Levels, listed_m
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights, WeightsLike, weights_on
from jaxurban.paths.choices import SearchChoice
from jaxurban.paths.closed import causes_at, closed_facts
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.finish import finish, map_notes, map_settings
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY, End, Point, one_place
from jaxurban.paths.search import PathSearch
from jaxurban.paths.snapping import (
    free_to_ground,
    islands_at,
    joined_ends,
    places_near,
    why_closed,
)
from jaxurban.planners.astar import AUTO, make_landmarks
from jaxurban.planners.base import Cell, Path, Problem, Status, islands_of
from jaxurban.planners.corners import with_corner_bound
from jaxurban.planners.cost import CostModel, PathFeatures
from jaxurban.planners.exposure import within_budgets
from jaxurban.planners.refine import check_line_model
from jaxurban.planners.refine import refine as refine_path
from jaxurban.planners.registry import PLANNERS, find_planner
from jaxurban.progress import warn_if_slow
from jaxurban.public import FactsRepr
from jaxurban.settings import Objective, OnGround, as_tuple
from jaxurban.world.grid import Grid

REFINING_SHARE = 0.25  # of the budget, kept for refinement where the caller wants it


@dataclass
class MapCache:
    """What a cost map derives for its queries; None until it is needed.

    Attributes:
      shortest, problem, terrain_m: as of `CostMap`.
    """

    shortest: Problem | None = None
    problem: Problem | None = None
    terrain_m: np.ndarray | None = None


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
      is_prepared: whether landmarks guide the planners that choose their heuristic (see `prepare`).
      cache: what is derived from it.

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
    is_prepared: bool = False
    cache: MapCache = field(init=False, default_factory=MapCache)

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

    @property
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
        """What a cost map says of itself in the settings of the paths on it (`finish.map_settings`)."""
        return map_settings(self)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """The sentences that it adds to the note of every path on it."""
        return tuple(map_notes(self))

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

    @property
    def problem(self) -> Problem:
        """The planners' view of the map under its weights, made once.

        It leads from the first free cell to itself; `Problem.between` gives that of other ends.

        Raises:
          InputError: no cell is free.
        """
        if self.cache.problem is None:
            problem = self.shortest
            if self.is_weighed:
                problem = problem.with_weights(self.weight_vector)
            self.cache.problem = problem
        return self.cache.problem

    @property
    def shortest(self) -> Problem:
        """The same as `problem`, but length alone costs: for the shortest path. Made once.

        Raises:
          InputError: no cell is free.
        """
        if self.cache.shortest is not None:
            return self.cache.shortest
        self.check_any_free()
        indices = np.unravel_index(np.argmax(self.is_free), self.is_free.shape)
        first_free = tuple(map(int, indices))
        self.cache.shortest = Problem(
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
        return self.cache.shortest

    def check_any_free(self) -> None:
        """Refuse a map without a free cell, on which no path can be planned.

        Raises:
          InputError: no cell is free; says what opens cells.

        Examples:
          >>> ju.cost_map(maps, 60.0).check_any_free()
        """
        if not self.is_free.any():
            raise InputError(f"no cell is free at {listed_m(self.altitudes_m)} m: {self.remedy}")

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
        return replace(self, names=kept_names, costs=self.costs[is_kept], is_prepared=False)

    def with_weights(self, weights: WeightsLike) -> "CostMap":
        """Return the map under other weights; both maps share what does not depend on weights (`Problem.with_weights`).

        Returns:
          `CostMap` without landmarks. Weights that are not named are as in the maps' scenario or by default.

        Raises:
          InputError: an invalid weight, or of a metric that the maps lack.

        Examples:
          >>> cost_map = ju.cost_map(maps, 60.0)
          >>> avoiding = cost_map.with_weights({"population": 5.0})
          >>> [round(each.plan(start, goal).length_m) for each in (cost_map, avoiding)]
          [848, 864]
        """
        other = replace(self, weights=weights_on(self.maps, weights), is_prepared=False)
        other.cache.shortest = self.shortest
        other.cache.terrain_m = self.terrain_m
        return other

    def prepare(self) -> "CostMap":
        """Return the map with landmarks, for many queries under these weights, each two to three times as fast.

        They guide ``astar`` where a query names no heuristic. Costs are the same; of equally cheap routes another
        one may be returned. This map stays as it is.

        Returns:
          `CostMap` whose ``is_prepared`` is True.

        Raises:
          InputError: a volume, or no cell is free.

        Examples:
          >>> cost_map = ju.cost_map(maps, 60.0).prepare()
          >>> cost_map.plan(start, goal).search.heuristic
          'landmarks'
        """
        if self.levels is not None:
            raise InputError(
                "landmarks are for one altitude: leave prepare() out of a map between levels"
            )
        # The landmarks are kept by the problem, which the new map shares. Searches on this map pass over them.
        make_landmarks(self.problem)
        prepared = replace(self, is_prepared=True)
        prepared.cache.shortest = self.shortest
        prepared.cache.problem = self.problem
        return prepared

    def cost_of(self, name: str) -> float:
        """Return the largest cost of a metric over free cells, not weighted.

        Returns:
          A number in [0, 1]; 0 where the metric costs nothing anywhere, or no cell is free.

        Examples:
          >>> cost_map = ju.cost_map(maps, 60.0)
          >>> {name: round(cost_map.cost_of(name), 1) for name in cost_map.names}
          {'gps': 0.6, 'lidar': 1.0, 'population': 1.0, 'risk': 0.6}
        """
        return float(self.costs[self.names.index(name)][self.is_free].max(initial=0.0))

    def cell_of(self, name: str, place: Point | XY) -> tuple[tuple[float, float], Cell]:
        """Return where a place is on the maps, free or not (arguments and errors as of `places_near`).

        Returns:
          Easting and northing in metres in the maps' CRS, and row and column of the cell.

        Examples:
          >>> xy_m, cell = ju.cost_map(maps, 60.0).cell_of("start", start)
          >>> [round(value) for value in xy_m], cell
          ([586650, 4514550], (2, 2))
        """
        grid = self.grid
        coordinates: Any = place[:2]  # an altitude does not matter here
        try:
            if isinstance(place, XY):
                x_m, y_m = coordinates
                row, col = grid.cell_of_xy(x_m, y_m)
            else:
                x_m, y_m = grid.xy_of_lonlat(*coordinates)
                row, col = grid.cell_of_lonlat(*coordinates)
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
        return (float(x_m), float(y_m)), (int(row), int(col))

    def ends(
        self,
        start: Point | XY,
        goal: Point | XY,
        *,
        snap: bool | float = False,
        on_ground: OnGround = False,
    ) -> tuple[End, End]:
        """Return the cells of a query; in a volume the nodes. Arguments and errors are as of `places_near`.

        With ``on_ground`` only cells are free above which the air is, from the ground up (`free_to_ground`).

        Snapping takes the free cells nearest to both that a way through free cells joins. An end leaves a free cell
        only where nothing within reach of the other end is joined to it. Where no two within reach are joined, the
        nearest free ones are taken.

        Returns:
          `End` of the start and of the goal.

        Examples:
          >>> [end.cell for end in ju.cost_map(maps, 60.0).ends(start, goal)]
          [(2, 2), (27, 27)]
        """
        # The possible ends of each place, the nearest first.
        starts = places_near(self, "start", start, snap, on_ground is True)
        goals = places_near(self, "goal", goal, snap, bool(on_ground))
        return joined_ends(self, starts, goals) if snap else (starts[0], goals[0])

    @cached_property
    def free_to_ground(self) -> Callable[[int], np.ndarray]:
        """Where missions may take off to a level, by its number, each made once (`snapping.free_to_ground`)."""
        return cache(partial(free_to_ground, self))

    @cached_property
    def islands(self) -> np.ndarray:
        """``[Y, X]`` or ``[K, Y, X]`` the number of the island of joined free cells, 0 where a cell is closed."""
        return islands_of(self.is_free, self.cuts_corners)

    @cached_property
    def islands_at(self) -> Callable[[tuple[float, ...]], np.ndarray]:
        """The islands of other levels, each made once (`snapping.islands_at`)."""
        return cache(partial(islands_at, self))

    @property
    def cuts_corners(self) -> bool:
        """Whether a free cell joins those that it touches with a corner."""
        return self.cost_model.joins_corners and not self.leg_margin_m

    @property
    def leg_margin_m(self) -> float:
        """What straight legs keep from closed cells, for the clearance."""
        return self.constraints.leg_margin_m(self.grid.resolution_m)

    @property
    def levels_free(self) -> np.ndarray:
        """``[K, Y, X]`` where a path may fly, on one altitude too."""
        return self.is_free.reshape(-1, *self.grid.shape)

    @property
    def remedy(self) -> str:
        """What a user can do so that more cells are free, as the end of a message."""
        remedy = "fly higher"
        if self.levels is not None:
            remedy = "fly at another level, raise max_altitude_m"
        constraints = str(self.constraints)
        return f"{remedy}, or loosen the constraints ({constraints})" if constraints else remedy

    def why_closed(self, cell: Cell, level: int = 0) -> str:
        """Return what closes a cell of a level and which level over it is free (`jaxurban.paths.snapping`).

        Returns:
          A phrase that goes after "it is".

        Examples:
          >>> ju.cost_map(maps, 20.0).why_closed((1, 6))
          'closed by the vertical clearance of 3 m that is kept from obstacles and the border at 20 m'
        """
        return why_closed(self, cell, level)

    @typed
    def plan(
        self,
        start: Point | XY | None = None,
        goal: Point | XY | None = None,
        *,
        start_xy_m: Point | None = None,
        goal_xy_m: Point | None = None,
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
        start_place = one_place("start", start, start_xy_m)
        goal_place = one_place("goal", goal, goal_xy_m)
        search = PathSearch.of(is_for_volumes=self.levels is not None, **choice)
        return self.planned(start_place, goal_place, search)

    def planned(self, start: Point | XY, goal: Point | XY, search: PathSearch) -> PlannedPath:
        """Return a path between two places, given as for `cell_of`, searched for as a checked `PathSearch` says.

        Returns:
          `PlannedPath`, as of `plan`, which is simpler to call.

        Examples:
          >>> from jaxurban.paths.search import PathSearch
          >>> ju.cost_map(maps, 60.0).planned(start, goal, PathSearch.of(planner="ptp")).status.value
          'blocked'
        """
        # The planner: landmarks guide it where the map is prepared and the search leaves its heuristic to it.
        is_guided = self.is_prepared and not search.exposure and search.heuristic is None
        if is_guided and PLANNERS[search.planner].default_heuristic == AUTO:
            search = replace(search, heuristic="landmarks")
        find_path = find_planner(
            search.planner,
            search.heuristic,
            is_for_volumes=self.levels is not None,
            backend=search.backend,
        )

        # The problem, and whether it suits what is asked beside the path.
        ends = self.ends(start, goal, snap=search.snap, on_ground=search.on_ground)
        start_end, goal_end = ends
        problem = self.problem.between(start_end.cell, goal_end.cell)
        if search.refine:
            check_line_model(problem, "refinement")
        if search.exposure:
            self._check_exposure(search.exposure)
            find_path = partial(
                within_budgets, planner=find_path, budgets=search.exposure, names=self.names
            )

        # Without a way between ends that could be moved there is nothing to search.
        if search.snap and self.islands[problem.start] != self.islands[problem.goal]:
            nowhere_m = np.empty((0, problem.is_free.ndim))
            apart = Path(Status.NO_PATH, nowhere_m, np.inf, np.inf, 0, 0.0, search.planner)
            return finish(self, apart, ends, search)

        # The search. An anytime planner would leave nothing of the budget to refine with.
        share = 1 - REFINING_SHARE if search.refine else 1.0
        with warn_if_slow(search.planner, search.budget_s):
            path = find_path(problem, budget_s=search.budget_s * share, seed=search.seed)

        # Refinement, for which half of its share of the budget is left even where the search took longer.
        if search.refine and path.status.has_path:
            least_s = search.budget_s * REFINING_SHARE / 2
            left_s = search.budget_s - path.elapsed_s
            path = refine_path(problem, path, budget_s=max(left_s, least_s))
        return finish(self, with_corner_bound(problem, path), ends, search)

    def _check_exposure(self, names: Iterable[str]) -> None:
        """Check that budgets of exposure can be kept on this map.

        Args:
          names: of the metrics that have a budget.

        Raises:
          InputError: a name that is none of the map's metrics, or the cost model ``"cell"``, which sums costs by cell
            and not along the path.
        """
        if self.cost_model.kind == "cell":
            raise InputError(
                "a budget of exposure is of an integral along the path, which cost_model='cell' does not add up: "
                "choose cost_model='line' (--rules cost_model=line)"
            )
        for name in names:
            one_of("exposure", name, self.names)

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

    @property
    def terrain_m(self) -> np.ndarray | None:
        """``[Y, X]`` elevation of the ground; None where the maps hold no terrain."""
        if self.cache.terrain_m is None and "terrain" in self.maps.ds:
            self.cache.terrain_m = self.maps.m("terrain")
        return self.cache.terrain_m
