"""A planned route explained: what each layer and each segment costs, who is below, where GPS or room is scarce."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
import pandas as pd

from jaxurban.checks import positive, typed, values_given
from jaxurban.errors import InputError
from jaxurban.kernels.line.traversal import Crossings
from jaxurban.maps.levels import Levels
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.gps import FIX
from jaxurban.metrics.population import M2_PER_KM2
from jaxurban.metrics.weights import Weights
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import map_at
from jaxurban.paths.profile import (
    cautions,
    cut_evenly,
    cut_on,
    profile_of,
    without_fix,
)
from jaxurban.paths.route_report import (
    CLEARANCE,
    COST_OF,
    DENSITY,
    NO_FIX_IN_1_0,
    OUTSIDE,
    OVER_ROOF,
    VISIBLE,
    OverflownDensity,
    RouteReport,
)
from jaxurban.planners.cost import CostModel
from jaxurban.settings import Vehicle

SECONDS_PER_HOUR = 3600.0
EXTRA_MAPS = {VISIBLE: VISIBLE, FIX: FIX, "density": DENSITY, "terrain": "terrain_m"}


@typed
def explain(
    planned: PlannedPath,
    maps: MapsLike,
    *,
    speed_m_s: float | None = None,
    power_w: float | None = None,
    swath_m: float = 10.0,
    num_segments: int = 10,
    density: OverflownDensity | None = None,
) -> RouteReport:
    """Return what a planned route costs and meets, in whole and by segment.

    People overflown are those under a strip of width ``swath_m`` along the route: the integral of density x
    ``swath_m`` over the length on the ground, where the strip is taken to be as dense as the cell that the
    route crosses. Who lives under two passes counts twice. Time is length / speed, energy time x power: no wind,
    no acceleration, the same power in climb and descent. Clearance (``nearest_wall_m``) is the exact distance from the
    route to the square of the nearest cell with a roof at its altitude (see `clearance_m`). The highest roof that
    touches a cell counts, where the maps hold it, so that 0 is contact. The maps do not hold what stands outside their
    region: ``walls_outside_m`` is the distance to the border, which those obstacles exceed.
    Where a route climbs, each cell takes the maps of the level nearest to it, as the planner did. The number of
    satellites and obstacles are those of the level below, where there are fewer satellites and more obstacles.

    Args:
      planned: from `plan`; its settings say which weights, cost model, time and time of day.
      maps: the maps it was planned on, or their folder.
      speed_m_s: through the air; left out, that of the vehicle that it was planned for, or else no time. The vehicle's
        limits of climb and descent make it slower where the route is steep.
      power_w: mean electrical power in flight; left out, that of the vehicle, or else no energy.
      swath_m: width of the strip in which people are counted.
      num_segments: into how many segments of nearly equal length the table is cut, at most.
      density: of people beneath the corridor, from `overflown_density`, which the report then shows and files hold.

    Returns:
      `RouteReport`: totals of the route, a table of its segments and one of its cells, and cautions.

    Raises:
      InputError: there is no path, the maps are others, or a speed, power, width or number that cannot be.

    Examples:
      >>> report = ju.explain(path, maps, speed_m_s=10.0)
      >>> [round(report.totals[name]) for name in ("length_m", "time_s", "people_overflown")]
      [719, 72, 37]
      >>> report.segments[["from_m", "to_m"]].round().to_numpy().tolist()[:2]
      [[0.0, 77.0], [77.0, 133.0]]
    """
    maps = as_maps(maps)
    if num_segments < 1:
        raise InputError(f"num_segments must be at least 1, got {num_segments}")
    positive("swath_m", swath_m)
    # The route by cell, and who flies it.
    cut = cut_on(planned, maps)
    metrics = tuple(maps.metrics)
    profile = profile_of(planned, maps, cut, {name: name for name in metrics} | EXTRA_MAPS)
    given = values_given({"speed_m_s": speed_m_s, "power_w": power_w})
    vehicle = replace(Vehicle.of(planned.settings), **given)
    route = _Route(cut, profile, _cost_map_of(planned, maps), vehicle, swath_m)

    # The whole, and its segments, each from one step to another.
    num_steps = len(route.states) - 1
    whole = route.row(0, num_steps, metrics)
    segment = cut_evenly(cut.points_m, num_segments)
    _, first_steps = np.unique(segment, return_index=True)
    parts = list(pairwise([*first_steps.tolist(), num_steps]))
    rows = [route.row(first, last, metrics) for first, last in parts]
    numbers = pd.RangeIndex(1, len(parts) + 1, name="segment")

    lonlat = maps.grid.lonlat_at(route.states[:, :2] + maps.grid.bounds_m[:2])
    not_of_whole = ("from_", "to_", "min_", "max_")
    return RouteReport(
        totals={name: whole[name] for name in whole if not name.startswith(not_of_whole)},
        segments=pd.DataFrame(rows, index=numbers, columns=list(whole)),
        profile=profile,
        lines=tuple(lonlat[first : last + 1] for first, last in parts),
        settings={
            "swath_m": swath_m,
            "speed_m_s": vehicle.speed_m_s,
            "power_w": vehicle.power_w,
        },
        cautions=cautions(planned, maps, profile),
        density=density,
    )


@dataclass(frozen=True)
class _Route:
    """A route over maps; a part of it runs from one of its states to another, by their numbers.

    Attributes:
      cut: the route, cut at the borders of cells.
      profile: a row for each cell that it crosses (`profile_of`).
      cost_map: the map that it was planned on.
      vehicle: what flies it.
      swath_m: width of the strip in which people are counted.
    """

    cut: Crossings
    profile: pd.DataFrame
    cost_map: CostMap
    vehicle: Vehicle
    swath_m: float

    @property
    def states(self) -> np.ndarray:
        """Corners of the route as the cost map takes them: ``[N, 2]`` x, y, in a volume ``[N, 3]`` with altitude."""
        num_axes = 2 if self.cost_map.levels is None else 3
        return self.cut.points_m[:, :num_axes]

    def row(self, first: int, last: int, metrics: Iterable[str]) -> dict[str, float]:
        """Return a row of `RouteReport.segments`: where a part lies, what it costs and meets, extremes of metrics.

        Args:
          first, last: numbers of the states at which the part begins and ends; both 0 for a route without length.
          metrics: names of those whose least and greatest value are returned.
        """
        step = self.cut.segment  # of each cell that is crossed
        is_part = (first <= step) & (step < max(last, 1))
        part = self.profile[is_part]
        row = {"from_m": part["from_m"].min(), "to_m": part["to_m"].max()}
        row |= self._sums(first, last, is_part)
        for extreme, metric in product(("min", "max"), metrics):
            row[f"{extreme}_{metric}"] = part[metric].agg(extreme)
        return row

    def _sums(self, first: int, last: int, is_part: np.ndarray) -> dict[str, float]:
        """Return what a part costs and meets, by name: sums, means, and the nearest obstacles.

        What the maps or the vehicle do not say (people, fix, time, energy) is left out.

        Args:
          first, last: numbers of the states at which it begins and ends.
          is_part: ``[M]`` bool: the rows of the profile that belong to it.
        """
        # Length, cost, its parts, and the mean of each metric.
        part = self.profile[is_part]
        features = self.cost_map.shortest.features(self.states[first : last + 1])
        costs = (self.cost_map.weight_vector * features.phi).tolist()
        row = {"length_m": float((part["to_m"] - part["from_m"]).to_numpy().sum())}
        row["cost"] = sum(costs)
        for name, cost in zip(self.cost_map.weight_names, costs, strict=True):
            row[COST_OF + name] = cost
        for name, mean in self.cost_map.means(features).items():
            row[f"mean_{name}"] = mean

        # People, fix and clearances.
        east_m, north_m, rise_m = np.diff(self.cut.ends_m, axis=1)[is_part, 0].T
        if DENSITY in part:
            people_m = float(part[DENSITY] @ np.hypot(east_m, north_m))
            row["people_overflown"] = people_m * self.swath_m / M2_PER_KM2
        if FIX in part:
            no_fix_m = sum((to_m - from_m for from_m, to_m in without_fix(part)), 0.0)
            row["no_fix_m"] = row[NO_FIX_IN_1_0] = no_fix_m
        for name in (CLEARANCE, OUTSIDE, OVER_ROOF):
            row[name] = float(part[name].min())

        # Time and energy.
        speed_m_s, power_w = self.vehicle.speed_m_s, self.vehicle.power_w
        if speed_m_s is not None:
            flight_s = self.vehicle.flight_s(self.cut.length_m[is_part], rise_m, speed_m_s)
            row["time_s"] = float(flight_s.sum())
            if power_w is not None:
                row["energy_wh"] = row["time_s"] * power_w / SECONDS_PER_HOUR
        return row


def _cost_map_of(planned: PlannedPath, maps: MetricMaps) -> CostMap:
    """Return the map that a path was planned on, made again from the path's settings.

    In a volume it has only the levels between the lowest and the highest point of the path. Every cell is free, as
    settings do not keep what closed cells.

    Raises:
      InputError: the maps lack a metric that the path was planned on.
    """
    settings = planned.settings
    levels = None
    altitudes_m = np.array([planned.altitude_m])
    if "levels_m" in settings:
        levels = Levels(
            climb_cost=settings.get("climb_cost"), descent_cost=settings.get("descent_cost", 0.0)
        )
        levels_m = np.asarray(settings["levels_m"], float)
        altitudes_m = levels_m[(levels_m >= planned.z_m.min()) & (levels_m <= planned.z_m.max())]
    cost_map = map_at(
        maps.with_obstacles("centre"),
        altitudes_m,
        levels,
        time=settings["time"],
        time_of_day=settings["time_of_day"],
        objective=settings["objective"],
        weights=Weights.of(settings["weights"]),
        cost_model=CostModel.from_settings(settings),
        constraints=Constraints(clearance_m=0.0, vertical_clearance_m=0.0),
    )
    metrics = [name for name in settings["weights"] if name != "distance"]
    return replace(cost_map, is_free=np.ones_like(cost_map.is_free)).only(metrics)
