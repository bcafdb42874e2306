"""A search on a cost map, and its path made a `PlannedPath`: measured, with settings, and what is said of it."""

import math
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from jaxurban.checks import one_of, typed
from jaxurban.errors import InputError
from jaxurban.kernels.tolerances import BESIDE_M, SAME_EXPOSURE, SAME_PLACE_M
from jaxurban.paths.clearance import closing_step_m
from jaxurban.paths.closed import closed_facts
from jaxurban.paths.ground import ground_along
from jaxurban.paths.lines import line_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY, End, Point
from jaxurban.paths.search import PathSearch
from jaxurban.paths.snapping import snap_note
from jaxurban.planners.base import Path, Status
from jaxurban.planners.corners import with_corner_bound
from jaxurban.planners.exposure import within_budgets
from jaxurban.planners.refine import check_line_model
from jaxurban.planners.refine import refine as refine_path
from jaxurban.planners.registry import find_planner
from jaxurban.planners.simplify import simplify_path
from jaxurban.progress import warn_if_slow

if TYPE_CHECKING:
    from jaxurban.paths.cost_map import CostMap

REFINING_SHARE = 0.25  # of the budget, kept for refinement where the caller wants it
ABOVE_HIGHEST = (
    "Roofs of unknown height count up to their bound: with unknown_heights likely (--rules) they "
    "count up to what 99 % of their kind keep below."
)
NOT_MEASURED: dict[str, Any] = {  # of a search without a path, under the names of `PlannedPath`
    "xy_m": np.empty((0, 2)),
    "lonlat": np.empty((0, 2)),
    "z_m": np.empty(0),
    "cost": math.inf,
    "cost_by_layer": {},
    "length_m": math.inf,
    "metrics": {},
}


def plan_on(
    cost_map: "CostMap", start: Point | XY, goal: Point | XY, search: PathSearch
) -> PlannedPath:
    """Return a path between two places, searched for as a checked `PathSearch` says.

    Args:
      cost_map: the map to plan on.
      start, goal: longitude, latitude in degrees, or `XY`; in a volume with an altitude, if liked.
      search: how to search.

    Returns:
      `PlannedPath`, as of `CostMap.plan`, which is simpler to call; errors too.
    """
    find_path = find_planner(
        search.planner,
        search.heuristic,
        is_for_volumes=cost_map.levels is not None,
        backend=search.backend,
    )

    # The problem, and whether it suits what is asked beside the path.
    space = cost_map.free_space
    ends = space.ends(start, goal, snap=search.snap, on_ground=search.on_ground)
    start_end, goal_end = ends
    problem = cost_map.problem.between(start_end.cell, goal_end.cell)
    if search.refine:
        check_line_model(problem, "refinement")
    if search.exposure:
        _check_exposure(cost_map, search.exposure)
        find_path = partial(
            within_budgets, planner=find_path, budgets=search.exposure, names=cost_map.names
        )

    # Without a way between ends that could be moved there is nothing to search.
    if search.snap and space.islands[problem.start] != space.islands[problem.goal]:
        nowhere_m = np.empty((0, problem.is_free.ndim))
        apart = Path(Status.NO_PATH, nowhere_m, np.inf, np.inf, 0, 0.0, search.planner)
        return finish(cost_map, apart, ends, search)

    # The search. An anytime planner would leave nothing of the budget to refine with.
    share = 1 - REFINING_SHARE if search.refine else 1.0
    with warn_if_slow(search.planner, search.budget_s):
        path = find_path(problem, **search.limits | {"budget_s": search.budget_s * share})

    # Refinement, for which half of its share of the budget is left even where the search took longer.
    if search.refine and path.status.has_path:
        least_s = search.budget_s * REFINING_SHARE / 2
        left_s = search.budget_s - path.elapsed_s
        path = refine_path(problem, path, budget_s=max(left_s, least_s))
    return finish(cost_map, with_corner_bound(problem, path), ends, search)


def _check_exposure(cost_map: "CostMap", names: Iterable[str]) -> None:
    """Check that budgets of exposure can be kept on a cost map.

    Args:
      cost_map: to plan on.
      names: of the metrics that have a budget.

    Raises:
      InputError: a name that is none of the map's metrics, or the cost model ``"cell"``, which sums costs by cell
        and not along the path.
    """
    if cost_map.cost_model.kind == "cell":
        raise InputError(
            "a budget of exposure is of an integral along the path, which cost_model='cell' does not add up: "
            "choose cost_model='line' (without --preset paper)"
        )
    for name in names:
        one_of("exposure", name, cost_map.names)


def finish(
    cost_map: "CostMap", path: Path, ends: tuple[End, End], search: PathSearch
) -> PlannedPath:
    """Return a planner's path with its weighted cost, its metrics, its coordinates and its settings.

    Args:
      cost_map: the map that it was planned on.
      path: from a planner, or its verdict that there is none.
      ends: start and goal, from `FreeSpace.ends`.
      search: how it was searched for, for the record.
    """
    budget_s = search.budget_s if np.isfinite(search.budget_s) else None
    settings = deepcopy(cost_map.record) | search.limits | {"budget_s": budget_s}
    if search.exposure:
        settings["exposure"] = dict(search.exposure)
    start, goal = ends
    start_altitude_m = cost_map.altitude_m
    if cost_map.levels is not None:  # the first index of a cell is then its level
        start_altitude_m = float(cost_map.altitudes_m[start.cell[0]])
        settings["goal_altitude_m"] = float(cost_map.altitudes_m[goal.cell[0]])
    measures = measured(cost_map, path.points_m) if path.status.has_path else NOT_MEASURED
    return PlannedPath(
        **measures,
        status=path.status,
        altitude_m=start_altitude_m,
        snap_distance_m=(start.snap_distance_m, goal.snap_distance_m),
        search=replace(path, note=_note(cost_map, path, ends)),
        settings=settings,
        crs=cost_map.grid.crs,
        zones=cost_map.constraints.zones,
        maps=cost_map.maps,
    )


def measured(cost_map: "CostMap", points_m: np.ndarray) -> dict[str, Any]:
    """Return where a path lies, what it costs and what it meets, under the names of `PlannedPath`.

    Args:
      cost_map: the map that it is costed on.
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner; in a volume ``[N, 3]``, with the altitude.
    """
    # Where it lies.
    grid, weights = cost_map.grid, cost_map.weight_vector
    from_corner_m = points_m[:, :2]
    xy_m = from_corner_m + grid.bounds_m[:2]
    z_m = np.full(len(xy_m), cost_map.altitude_m)
    if cost_map.levels is not None:
        z_m = points_m[:, 2]
    ground = None
    terrain_m = cost_map.free_space.terrain_m
    if terrain_m is not None:
        ground = ground_along(from_corner_m, terrain_m, grid)

    # What it costs: phi holds, of each weight, what the weight is multiplied by.
    features = cost_map.problem.features(points_m)
    costs = (weights * features.phi).tolist()
    reference_m = cost_map.cost_model.reference_length_m
    exposures = (features.mean_costs * features.length_m.sum() / reference_m).tolist()
    return {
        "xy_m": xy_m,
        "lonlat": grid.lonlat_at(xy_m),
        "z_m": z_m,
        "cost": features.cost(weights),
        "cost_by_layer": dict(zip(cost_map.weight_names, costs, strict=True)),
        "exposure_by_layer": dict(zip(cost_map.names, exposures, strict=True)),
        "length_m": float(features.phi[0]),
        "metrics": cost_map.means(features),
        "ground": ground,
    }


def _note(cost_map: "CostMap", path: Path, ends: tuple[End, End]) -> str:
    """Return what the planner noted, and what else a reader of the path must know: sentences, or ``""``.

    Args:
      cost_map: the map that it was planned on.
      path: from a planner, or its verdict that there is none.
      ends: start and goal, from `FreeSpace.ends`.
    """
    start, goal = ends
    has_path = path.status.has_path
    notes = [path.note]
    if path.status is Status.NO_PATH:
        notes.append(cost_map.free_space.apart_note(start, goal))
        if cost_map.constraints.of_unknown == "highest" and "roof_limit" in cost_map.maps.ds:
            notes.append(ABOVE_HIGHEST)
    notes.append(snap_note(start, goal))
    if cost_map.is_weighed and cost_map.weights.distance == 0 and not path.note and has_path:
        notes.append("The distance weighs nothing, so the path may be far longer than it need be.")

    # Why there may be no path.
    constraints = cost_map.constraints
    if not has_path and str(constraints):
        free_on_maps = [cost_map.maps.is_free(z_m) for z_m in cost_map.altitudes_m.tolist()]
        share = 1 - cost_map.is_free.sum() / np.sum(free_on_maps)
        notes.append(
            f"Constraints were on ({constraints}): they close {share:.1%} of the cells without an obstacle."
        )
        if cost_map.levels is None:
            notes.append(f"Closed are {closed_facts(cost_map.causes)['closed']}.")
    return " ".join(filter(None, [*notes, cost_map.note]))


@typed
def simplify(planned: PlannedPath, cost_map: "CostMap", tolerance_m: float) -> PlannedPath:
    """Return the path with the fewest straight legs that keep within a tolerance of it and to free cells.

    A mission of hundreds of waypoints becomes one of tens. Every leg keeps 2 cm from every cell that is closed by
    an obstacle or a constraint, so that no rounding of coordinates takes it into one (`jaxurban.planners.simplify`
    says what is done where the path itself passes nearer). Legs that leave the path stay 3 m from cells that obstacles
    touch, so that none is nearer to an outline than 3 m or, where that is less, than the path itself. The altitudes
    above ground stay, and so do the ends. Cost, metrics and length are those of the new path; its message says the
    tolerance, the waypoints before and after, how far the path was moved at most, and how its cost changed.

    Args:
      planned: from `plan`, or from a batch; without a path it comes back as it is.
      cost_map: that it was planned on, as from `jaxurban.cost_map` with the same arguments: it knows the free cells.
      tolerance_m: how far the path may be from where it was, in plan.

    Returns:
      `PlannedPath`, whose status is feasible where the path was optimal and anything moved.

    Raises:
      InputError: a tolerance that is not a positive number of metres, or a cost map under other settings, constraints
        or in another region than the path's.

    Examples:
      >>> short = ju.simplify(path, ju.cost_map(maps, 60.0), tolerance_m=20.0)
      >>> len(path.xy_m), len(short.xy_m), short.status.value
      (38, 5, 'feasible')
      >>> short.message
      '...Simplified to 20 m: 5 of 38 waypoints, at most 18.27 m from the planned path; ...'
    """
    if not planned.status.has_path:
        return planned
    _check_same_map(planned, cost_map)
    points_m = planned.search.points_m
    resolution_m = cost_map.grid.resolution_m
    step_m, _ = closing_step_m(cost_map.constraints.horizontal_m, resolution_m)  # closed beside
    simpler = simplify_path(cost_map.problem, planned.search, tolerance_m, BESIDE_M - step_m)
    after = measured(cost_map, simpler.points_m)

    # The path stays as it is where a simpler one exceeds a budget.
    exceeded = [
        f"the budget of {most:g} for {name}"
        for name, most in planned.settings.get("exposure", {}).items()
        if after["exposure_by_layer"][name] > most * (1 + 2 * SAME_EXPOSURE)
    ]
    if exceeded:
        budgets = " and ".join(exceeded)
        note = f"{planned.search.note} Not simplified to {tolerance_m:g} m, which would exceed {budgets}."
        return replace(planned, search=replace(planned.search, note=note))

    away_m = shapely.distance(shapely.points(points_m[:, :2]), line_of(simpler.points_m[:, :2]))
    note = (
        f"Simplified to {tolerance_m:g} m: {len(simpler.points_m)} of {len(points_m)} waypoints, at most "
        f"{away_m.max():.2f} m from the planned path; the weighted cost is "
        f"{after['cost']:.3f}, before {planned.cost:.3f}."
    )
    search = replace(simpler, note=" ".join(filter(None, (simpler.note, note))))
    settings = {**planned.settings, "simplify_m": tolerance_m}
    return replace(planned, **after, status=simpler.status, search=search, settings=settings)


def _check_same_map(planned: PlannedPath, cost_map: "CostMap") -> None:
    """Check that a path was planned on a cost map, which alone knows what the path keeps clear of.

    Raises:
      InputError: the path's CRS, altitude or levels, a setting or the region is another one than the cost map's.
    """
    # Settings of a volume hold its levels. On one altitude both records get that altitude, and no levels.
    on_one_altitude = {"levels_m": None, "altitude_m": planned.altitude_m}
    path_record = {"crs": planned.crs, **on_one_altitude, **planned.settings}
    map_record = {"crs": cost_map.grid.crs, **on_one_altitude, **cost_map.record}
    if cost_map.levels is None:
        map_record["altitude_m"] = cost_map.altitude_m
    different = [name for name, value in map_record.items() if path_record.get(name) != value]
    xy_m = planned.search.points_m[:, :2] + cost_map.grid.bounds_m[:2]
    if not np.allclose(xy_m, planned.xy_m, rtol=0.0, atol=SAME_PLACE_M):
        different.append("region")
    if different:
        raise InputError(
            f"the path was planned under another {' and another '.join(different)} than those of this cost map: give "
            "the cost map that it was planned on"
        )
