"""plan_volume: a path that climbs and descends between the altitudes of metric maps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import psutil
from scipy.ndimage import generate_binary_structure, label

from jaxurban.cost import Weights, metric_cost
from jaxurban.errors import InputError
from jaxurban.levels import SAME_M, Stack, listed, read_stack, volume_levels
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.memory import gib
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import Cell, CostKind, CostModel, Status
from jaxurban.planners.volume import Node, VolumeCost, VolumeProblem, charge
from jaxurban.planners.volume_astar import volume_astar
from jaxurban.reachability import CENTRE_REMEDY, joined_sentence
from jaxurban.snapping import Place, free_place
from jaxurban.weighted import Point, WeightedMap, weigh, why_blocked

NODE_BYTES = 48  # of a volume and a search that visits all of it; 37 measured over Lower Manhattan (docs/volume.md)


@dataclass(frozen=True, eq=False)
class WeightedVolume:
    """Metric maps of several altitudes under weights, as levels to fly between.

    Attributes:
      flat: what does not depend on altitude, as a map without obstacles; its ``layers`` and ``m`` hold nothing.
      stack: the metrics.
      problem: the planners' view, from a free node to itself; `VolumeProblem.between` asks for others.
      climb_cost, descent_cost: cost per metre.
      limits: what closes nodes beside obstacles; already in ``problem``.
      asked: bounds and step of the levels, for the record.
    """

    flat: WeightedMap
    stack: Stack
    problem: VolumeProblem
    climb_cost: float
    descent_cost: float
    limits: Limits
    asked: Mapping[str, float | None]

    def plan(
        self,
        start: Point | None = None,
        goal: Point | None = None,
        *,
        start_xy_m: Point | None = None,
        goal_xy_m: Point | None = None,
        start_altitude_m: float | None = None,
        goal_altitude_m: float | None = None,
        heuristic: str = "plus",
        budget_s: float = 180.0,
        snap: bool | float = False,
    ) -> PlannedPath:
        """Return a path between two places (arguments and errors as in `plan_volume`)."""
        ends = (
            self._locate("start", start, start_xy_m, start_altitude_m, snap),
            self._locate("goal", goal, goal_xy_m, goal_altitude_m, snap),
        )
        problem = self.problem.between(ends[0][0], ends[1][0])
        found = volume_astar(problem, budget_s=budget_s, heuristic=heuristic)
        seen_from_above = replace(found, points_m=found.points_m[:, :2])
        remedy = self._what_would_join(problem) if found.status is Status.NO_PATH else ""
        places = ends[0][1], ends[1][1]
        planned = self.flat.finish(seen_from_above, places, budget_s=budget_s, seed=0, remedy=remedy)
        planned = replace(
            planned,
            z_m=found.points_m[:, 2],
            altitude_m=float(problem.levels_m[problem.start[0]]),
            search=replace(found, note=planned.search.note),
            settings={
                **planned.settings,
                **self.asked,
                "goal_altitude_m": float(problem.levels_m[problem.goal[0]]),
                "levels_m": problem.levels_m.tolist(),
                "climb_cost": self.climb_cost,
                "descent_cost": self.descent_cost,
                "limits": self.limits.to_dict(),
            },
        )
        return self._charged(planned, charge(problem, found.points_m)) if found.status.has_path else planned

    def _locate(
        self, name: str, lonlat: Point | None, xy_m: Point | None, altitude_m: float | None, snap: bool | float
    ) -> tuple[Node, Place]:
        """Return the node of a place and how far it lies from it."""
        levels_m, is_free = self.problem.levels_m, self.problem.is_free
        place_xy_m, cell = self.flat.cell_of(name, lonlat, xy_m)
        free = np.flatnonzero(is_free[(slice(None), *cell)])
        if altitude_m is None:
            level = int(free[0]) if free.size else 0
        else:
            level = int(np.argmin(np.abs(levels_m - altitude_m)))
            if not abs(levels_m[level] - altitude_m) < SAME_M:
                raise InputError(
                    f"{name} altitude {altitude_m:g} m is none of the levels {listed(levels_m)} m: choose one of them"
                )
        why = "" if is_free[(level, *cell)] else self._why_closed(level, free, cell)
        remedy = "fly at another level, or loosen the limits" if self.limits else "fly at another level"
        place = free_place(
            name, place_xy_m, cell, is_free[level], self.flat.grid, snap=snap, why_closed=why, remedy=remedy
        )
        return (level, *place.cell), place

    def _why_closed(self, level: int, free: np.ndarray, cell: Cell) -> str:
        """Return where a closed node lies and which level or altitude over its cell is free."""
        levels_m, maps = self.problem.levels_m, self.flat.maps
        times = (self.flat.time, self.flat.time_of_day)
        closing = self.limits.reasons(maps, float(levels_m[level]), cell, *times) if self.limits else []
        how = why_blocked(maps, float(levels_m[level]), cell)
        where = f"closed by {' and '.join(closing)}" if closing else how
        if free.size:
            return f"{where} at {levels_m[level]:g} m; the lowest free level there is {levels_m[free[0]]:g} m"
        higher = [z for z in sorted(maps.altitudes_m) if z > levels_m[-1] and maps.is_free(z)[cell]]
        above = f"; the lowest free altitude there is {higher[0]:g} m (raise max_altitude_m)" if higher else ""
        return f"{where} at every level from {levels_m[0]:g} to {levels_m[-1]:g} m{above}"

    def _what_would_join(self, problem: VolumeProblem) -> str:
        """Return a sentence on what would join two nodes that nothing joins: the paper's obstacles, higher levels."""
        maps, levels_m = self.flat.maps, problem.levels_m
        # On one level as at one altitude; from level to level straight up and down, which all climbs come to.
        touching = generate_binary_structure(3, 1)
        touching[1] = generate_binary_structure(2, 2 if problem.cost_model.joins_corners else 1)

        def joins(maps: MetricMaps, levels_m: np.ndarray) -> bool:
            is_free = free_levels(maps, levels_m, self.limits, self.flat.time, self.flat.time_of_day)
            islands, _ = label(is_free, touching)
            return bool(islands[problem.start] == islands[problem.goal] != 0)

        tried = {}
        if maps.obstacles == "touched":
            tried[CENTRE_REMEDY] = joins(maps.with_obstacles("centre"), levels_m)
        if higher_m := [z_m for z_m in sorted(maps.altitudes_m) if z_m > levels_m[-1]]:
            tops = (k for k in range(len(higher_m)) if joins(maps, np.append(levels_m, higher_m[: k + 1])))
            top = next(tops, None)
            told = "at any greater altitude of these maps" if top is None else f"with max_altitude_m {higher_m[top]:g}"
            tried[told] = top is not None
        return f"{joined_sentence(tried)} Finer maps may join them too.".strip()

    def _charged(self, planned: PlannedPath, paid: VolumeCost) -> PlannedPath:
        """Return a path with its weighted cost and its metrics."""
        weights, names = self.flat.weights, self.flat.names
        m = [self._along(name, paid.nodes) for name in names]
        cost_by_layer = {"distance": float(weights.distance) * paid.length_m}
        for name, along in zip(names, m, strict=True):
            cost_by_layer[name] = float(getattr(weights, name)) * float(paid.charged @ metric_cost(name, along))
        cost_by_layer["climb"] = self.climb_cost * paid.climb_m
        cost_by_layer["descent"] = self.descent_cost * paid.descent_m
        length_m = paid.node_length_m if paid.length_m > 0 else np.ones(1)
        return replace(
            planned,
            cost=sum(cost_by_layer.values()),
            cost_by_layer=cost_by_layer,
            length_m=paid.length_m,
            metrics={name: float(length_m @ along / length_m.sum()) for name, along in zip(names, m, strict=True)},
        )

    def _along(self, name: str, nodes: np.ndarray) -> np.ndarray:
        """Return ``[N]`` float32 a metric at nodes ``[N, 3]``."""
        along = np.empty(len(nodes), np.float32)
        for level in np.unique(nodes[:, 0]):
            is_here = nodes[:, 0] == level
            along[is_here] = self.stack.metric(name, self.problem.levels_m[level], tuple(nodes[is_here, 1:].T))
        return along


def weigh_volume(
    maps: MetricMaps,
    *,
    min_altitude_m: float | None = None,
    max_altitude_m: float | None = None,
    level_step_m: float | None = None,
    climb_cost: float | None = None,
    descent_cost: float = 0.0,
    weights: Weights | None = None,
    objective: str = "weighted",
    cost_model: CostModel | CostKind = "cell",
    time: str | None = None,
    time_of_day: str | None = None,
    limits: Limits | None = None,
) -> WeightedVolume:
    """Return the maps of several altitudes as a volume, in which any number of paths can be planned.

    Arguments and errors are those of `plan_volume`.
    """
    for name, value in (("climb_cost", climb_cost), ("descent_cost", descent_cost)):
        if value is not None and not 0 <= value < np.inf:
            raise InputError(f"{name} must be a finite cost per metre >= 0, got {value:g}")
    levels_m = volume_levels(maps.altitudes_m, min_altitude_m, max_altitude_m, level_step_m)
    _check_memory((len(levels_m), *maps.grid.shape))
    flat = weigh(
        maps,
        maps.altitudes_m[0],
        weights=weights,
        objective=objective,
        cost_model=cost_model,
        time=time,
        time_of_day=time_of_day,
    )
    weights = flat.weights
    climb_cost = float(weights.distance) if climb_cost is None else float(climb_cost)
    paid = [getattr(weights, name) for name in ("distance", *flat.names)] + [climb_cost, descent_cost]
    is_weighed = objective == "weighted" and max(paid) > 0
    flat = replace(
        flat,
        is_free=np.ones(flat.is_free.shape, bool),
        m=np.broadcast_to(np.float32(0), flat.m.shape),
        layers=np.broadcast_to(np.float64(is_weighed), flat.layers.shape),  # for what it says of the weights
    )
    stack = read_stack(maps, flat.names, levels_m, time=flat.time, time_of_day=flat.time_of_day)
    limits = limits or Limits()
    is_free = free_levels(maps, levels_m, limits, flat.time, flat.time_of_day)
    if not is_free.any():
        remedy = "raise max_altitude_m, or loosen the limits" if limits else "raise max_altitude_m"
        raise InputError(f"no cell is free from {levels_m[0]:g} to {levels_m[-1]:g} m: {remedy}")
    level, row, col = (int(index) for index in np.unravel_index(np.argmax(is_free), is_free.shape))
    cost = np.zeros(is_free.shape)
    for at_level, z_m in zip(cost, levels_m, strict=True):
        for name in flat.names if is_weighed else ():
            at_level += getattr(weights, name) * metric_cost(name, stack.metric(name, z_m)).astype(np.float64)
    problem = VolumeProblem(
        cost=cost,
        is_free=is_free,
        levels_m=levels_m,
        start=(level, row, col),
        goal=(level, row, col),
        resolution_m=maps.grid.resolution_m,
        distance_weight=float(weights.distance) if is_weighed else 1.0,
        climb_cost=climb_cost if is_weighed else 0.0,
        descent_cost=float(descent_cost) if is_weighed else 0.0,
        cost_model=flat.cost_model,
    )
    asked = {"min_altitude_m": min_altitude_m, "max_altitude_m": max_altitude_m, "level_step_m": level_step_m}
    return WeightedVolume(flat, stack, problem, climb_cost, float(descent_cost), limits, asked)


def free_levels(
    maps: MetricMaps, levels_m: np.ndarray, limits: Limits, time: str | None, time_of_day: str | None
) -> np.ndarray:
    """Return ``[K, Y, X]`` bool: where a path may fly, by level."""
    is_free = np.stack([maps.is_free(z_m) for z_m in levels_m.tolist()])
    if limits:
        is_free &= ~limits.closed_levels(maps, levels_m.tolist(), time=time, time_of_day=time_of_day)
    return is_free


def plan_volume(
    maps: MetricMaps,
    start: Point | None = None,
    goal: Point | None = None,
    *,
    start_xy_m: Point | None = None,
    goal_xy_m: Point | None = None,
    start_altitude_m: float | None = None,
    goal_altitude_m: float | None = None,
    min_altitude_m: float | None = None,
    max_altitude_m: float | None = None,
    level_step_m: float | None = None,
    climb_cost: float | None = None,
    descent_cost: float = 0.0,
    weights: Weights | None = None,
    heuristic: str = "plus",
    objective: str = "weighted",
    cost_model: CostModel | CostKind = "cell",
    time: str | None = None,
    time_of_day: str | None = None,
    budget_s: float = 180.0,
    snap: bool | float = False,
    limits: Limits | None = None,
) -> PlannedPath:
    """Return the cheapest path from ``start`` to ``goal`` that may climb and descend on its way.

    The path runs between levels: the maps' altitudes, and those that ``level_step_m`` puts between them. What it
    pays is told in docs/volume.md: the metrics of the cells it enters, its length in space, and each metre of
    climb and descent. For many queries, `weigh_volume` once and call its ``plan``.

    Args:
      maps: from `build_maps` or `open_maps`.
      start, goal: longitude, latitude in degrees.
      start_xy_m, goal_xy_m: easting, northing in the maps' CRS, instead of ``start`` and ``goal``.
      start_altitude_m, goal_altitude_m: one of the levels; left out, the lowest that is free there.
      min_altitude_m, max_altitude_m: between which to fly, metres above ground; left out, the maps' range.
      level_step_m: levels this far apart too, from the lowest altitude up, and at both bounds. Metrics are then
        taken linearly from the maps below and above, obstacles from the roofs' own heights.
      climb_cost, descent_cost: cost per metre of height, beside the length. Left out, a metre of climb costs
        ``weights.distance``: hovering aside, lifting a small multirotor by a metre takes about the energy of
        one metre of level flight.
      weights, objective, cost_model, time, time_of_day: as in `jaxurban.plan`; 8 neighbours are 26 in a volume.
        ``objective="distance"`` leaves climb and descent out too.
      heuristic: a name of `VOLUME_HEURISTICS`.
      budget_s: seconds that the search may take.
      snap: move a start or goal inside an obstacle to the nearest free cell of its level instead of failing, by at
        most 50 m, or so many metres.
      limits: no-fly zones and bounds at every node; a zone between two levels closes the lower one.

    Raises:
      InputError: a place outside the maps, inside an obstacle or closed by a limit (names the lowest free level),
        bounds that hold no altitude of the maps, a volume that memory cannot hold, or what `jaxurban.plan` refuses.
    """
    volume = weigh_volume(
        maps,
        min_altitude_m=min_altitude_m,
        max_altitude_m=max_altitude_m,
        level_step_m=level_step_m,
        climb_cost=climb_cost,
        descent_cost=descent_cost,
        weights=weights,
        objective=objective,
        cost_model=cost_model,
        time=time,
        time_of_day=time_of_day,
        limits=limits,
    )
    return volume.plan(
        start,
        goal,
        start_xy_m=start_xy_m,
        goal_xy_m=goal_xy_m,
        start_altitude_m=start_altitude_m,
        goal_altitude_m=goal_altitude_m,
        heuristic=heuristic,
        budget_s=budget_s,
        snap=snap,
    )


def _check_memory(shape: tuple[int, int, int]) -> None:
    needed, free = math.prod(shape) * NODE_BYTES, psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"a volume of {shape[0]} levels of {shape[1]} x {shape[2]} cells takes up to {gib(needed)} of memory and "
            f"{gib(free)} are free: choose a longer level_step_m, closer altitude bounds, or coarser maps"
        )
