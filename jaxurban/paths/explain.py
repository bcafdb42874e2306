"""A planned route explained: what each layer and each segment costs, who is below, where GPS or room is scarce."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd

from jaxurban import wings
from jaxurban.checks import positive, typed, values_given
from jaxurban.errors import InputError
from jaxurban.kernels.tolerances import SAME_HEIGHT_M
from jaxurban.maps.levels import Levels
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.gps import FIX, has_no_fix
from jaxurban.metrics.variables import stored_name
from jaxurban.metrics.weights import Weights
from jaxurban.paths.closed import constraints_of
from jaxurban.paths.constraints import GPS_FLOOR, Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY
from jaxurban.paths.plan import map_at
from jaxurban.paths.profile import (
    SWATH_M,
    cautions,
    cut_evenly,
    cut_on,
    people_below,
    profile_of,
)
from jaxurban.paths.route_report import (
    CLEARANCE,
    COST_OF,
    DENSITY,
    FLOOR,
    OUTSIDE,
    OVER_ROOF,
    VISIBLE,
    RouteReport,
)
from jaxurban.paths.steps import Steps
from jaxurban.planners.cost import CostModel
from jaxurban.settings import Vehicle

SECONDS_PER_HOUR = 3600.0
EXTRA_MAPS = {VISIBLE: VISIBLE, FIX: FIX, "density": DENSITY, "terrain": "terrain_m"}


@typed
def explain(
    planned: PlannedPath,
    maps: MapsLike | None = None,
    *,
    speed_m_s: float | None = None,
    power_w: float | None = None,
    swath_m: float = SWATH_M,
    num_segments: int = 10,
) -> RouteReport:
    """Return what a planned route costs and meets, in whole and by segment.

    People overflown are those under a strip of width ``swath_m`` along the route: the integral of density x
    ``swath_m`` over the length on the ground, where the strip is taken to be as dense as the cell that the
    route crosses. Who lives under two passes counts twice. Time is length / speed, energy time x power: no wind,
    no acceleration, the same power in climb and descent. Clearance (``nearest_wall_m``) is the exact distance from the
    route to the square of the nearest cell with a roof at its altitude (see `clearance_m`). The highest roof that
    touches a cell counts, where the maps hold it, so that 0 is contact. The maps do not hold what stands outside their
    region: ``walls_outside_m`` is the distance to the border, which those obstacles exceed.
    Where a route climbs, each cell takes the maps at its height: those of an altitude within a metre of it, else
    both around it. The number of satellites there is that of the one below, where there are fewer.

    Args:
      planned: from `plan`; its settings say which weights, cost model, time and time of day.
      maps: the maps it was planned on, or their folder; left out, those that the path names.
      speed_m_s: through the air; left out, that of the vehicle that it was planned for, or else no time. The vehicle's
        limits of climb and descent make it slower where the route is steep.
      power_w: mean electrical power in flight; left out, that of the vehicle, or else no energy.
      swath_m: width of the strip in which people are counted.
      num_segments: into how many segments of nearly equal length the table is cut, at most.

    Returns:
      `RouteReport`: totals of the route, a table of its segments and one of its cells, and cautions.

    Raises:
      InputError: there is no path, no maps are given and it names none, the maps are others, or a speed, power, width
        or number that cannot be.

    Examples:
      >>> report = ju.explain(path, maps, speed_m_s=10.0)
      >>> [round(report.totals[name]) for name in ("length_m", "time_s", "people_overflown")]
      [848, 85, 69]
      >>> report.segments[["from_m", "to_m"]].round().to_numpy().tolist()[:2]
      [[0.0, 80.0], [80.0, 160.0]]
    """
    maps = planned.maps if maps is None else maps
    if maps is None:
        raise InputError("the path names no maps: give them, as in ju.explain(path, maps)")
    maps = as_maps(maps)
    if num_segments < 1:
        raise InputError(f"num_segments must be at least 1, got {num_segments}")
    positive("swath_m", swath_m)
    # The route by cell, who flies it, and the map that it was planned on.
    states, parts = cut_on(planned, maps)
    metrics = list(maps.metrics)
    shown = {name: name for name in metrics} | EXTRA_MAPS | {stored_name(GPS_FLOOR, maps.ds): FLOOR}
    profile = profile_of(parts, maps, shown, planned.settings)
    given = values_given({"speed_m_s": speed_m_s, "power_w": power_w})
    vehicle = replace(Vehicle.of(planned.settings), **given)
    amounts = _amounts(parts, profile, vehicle, swath_m)
    cost_map = _cost_map_of(planned, maps)
    num_axes = 2 if cost_map.levels is None else 3

    def row(first: int, last: int) -> dict[str, float]:
        """Return a row of `RouteReport.segments`: the part of the route between two states, by their numbers."""
        is_part = (first <= parts.leg) & (parts.leg < max(last, 1))
        part = profile[is_part]
        features = cost_map.shortest.features(states[first : last + 1, :num_axes])
        costs = (cost_map.weight_vector * features.phi).tolist()
        sums = amounts[is_part].sum(skipna=False)
        return {
            "from_m": part["from_m"].min(),
            "to_m": part["to_m"].max(),
            "length_m": sums.pop("length_m"),
            "cost": sum(costs),
            **dict(zip([COST_OF + name for name in cost_map.weight_names], costs, strict=True)),
            **{f"mean_{name}": mean for name, mean in cost_map.means(features).items()},
            **sums,
            **part[[CLEARANCE, OUTSIDE, OVER_ROOF]].min(),
            **part[metrics].min().add_prefix("min_"),
            **part[metrics].max().add_prefix("max_"),
        }

    # The whole, and its segments, each from one step to another.
    num_steps = len(states) - 1
    whole = row(0, num_steps)
    segment = cut_evenly(states, num_segments)
    _, first_steps = np.unique(segment, return_index=True)
    ends = list(pairwise([*first_steps.tolist(), num_steps]))
    rows = [row(first, last) for first, last in ends]
    numbers = pd.RangeIndex(1, len(ends) + 1, name="segment")

    not_of_whole = ("from_", "to_", "min_", "max_")
    return RouteReport(
        totals={name: whole[name] for name in whole if not name.startswith(not_of_whole)},
        segments=pd.DataFrame(rows, index=numbers, columns=list(whole)),
        profile=profile,
        settings={
            "swath_m": swath_m,
            "speed_m_s": vehicle.speed_m_s,
            "power_w": vehicle.power_w,
        },
        cautions=cautions(planned, maps, profile),
    )


def with_return_altitude(
    report: RouteReport, planned: PlannedPath, maps: MetricMaps
) -> RouteReport:
    """Return a report with one more of its totals: ``return_altitude_m``, above the ground at the start of the route.

    It clears a straight flight back to the start from anywhere on the route, under its clearances (`return_altitude`);
    NaN where none is known. It is left out where none is known at the start. As it is computed in
    JAX, which does not work in a forked process, `explain` leaves it out.
    """
    limits = constraints_of(planned)
    _, parts = cut_on(planned, maps)
    try:
        home = wings.return_altitude(
            maps,
            XY(*planned.xy_m[0]),
            clearance_m=limits.clearance_m,
            vertical_clearance_m=limits.vertical_clearance_m,
        )
    except InputError:
        return report
    least_m = float(home.altitude_m[tuple(parts.cell.T)].max())
    return replace(report, totals={**report.totals, "return_altitude_m": least_m})


def _amounts(parts: Steps, profile: pd.DataFrame, vehicle: Vehicle, swath_m: float) -> pd.DataFrame:
    """Return a row for each part of a route with what adds up along it: lengths, people, time and energy.

    What the maps or the vehicle do not say is left out.
    """
    length_m = parts.length_m
    amounts = {"length_m": length_m}
    if DENSITY in profile:
        amounts["people_overflown"] = people_below(profile[DENSITY], parts, swath_m)
    if FIX in profile:
        amounts["no_fix_m"] = length_m * has_no_fix(profile[FIX].to_numpy())
    if FLOOR in profile:
        is_below = ~(profile[FLOOR].to_numpy() <= parts.z_m.min(axis=1) + SAME_HEIGHT_M)
        amounts["below_gps_floor_m"] = length_m * is_below
    if vehicle.speed_m_s is not None:
        rise_m = parts.z_m[:, 1] - parts.z_m[:, 0]
        amounts["time_s"] = vehicle.flight_s(length_m, rise_m, vehicle.speed_m_s)
        if vehicle.power_w is not None:
            amounts["energy_wh"] = amounts["time_s"] * vehicle.power_w / SECONDS_PER_HOUR
    return pd.DataFrame(amounts)


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
