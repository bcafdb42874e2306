"""simplify: a planned path with as few waypoints as keep it within a tolerance, clear of closed cells."""

from dataclasses import replace

import numpy as np
import shapely

from jaxurban.errors import InputError, positive, typed
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.finish import measured
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.simplify import simplify as simplify_path


@typed
def simplify(planned: PlannedPath, on: CostMap, tolerance_m: float) -> PlannedPath:
    """Return the path with the fewest straight legs that keep within a tolerance of it and to free cells.

    A mission of tens of waypoints comes out of one of hundreds. Every leg keeps 2 cm from every cell that is closed by
    an obstacle or a constraint, so that no rounding of coordinates takes it into one (`jaxurban.planners.simplify`
    says what is done where the path itself passes nearer). The altitudes above ground stay, and so do the ends. Cost,
    metrics and length are those of the new path; its message tells the tolerance, the waypoints before and after, how
    far the path was moved at most, and how its cost changed.

    Args:
      planned: from `plan`, or from a batch; without a path it comes back as it is.
      on: the cost map that it was planned on, as from `cost_map` with the same arguments: it knows the free cells.
      tolerance_m: how far the path may be from where it was, in plan.

    Raises:
      InputError: a tolerance that is not a positive number of metres, or another cost map than the path's.
    """
    tolerance_m = positive("tolerance_m", tolerance_m, "metres")
    if not planned.status.has_path:
        return planned
    _check_same_maps(planned, on)
    points_m = planned.search.points_m
    found = simplify_path(on.problem, planned.search, tolerance_m)
    after = measured(on, found.points_m)
    moved_m = farthest_m(points_m[:, :2], found.points_m[:, :2])
    said = (
        f"Simplified to {tolerance_m:g} m: {len(found.points_m)} of {len(points_m)} waypoints, at most {moved_m:.2f} m "
        f"from the planned path; {_change(planned.cost, after['cost'])}."
    )
    search = replace(found, note=" ".join(filter(None, (found.note, said))))
    settings = {**planned.settings, "simplify_m": tolerance_m}
    return replace(planned, **after, status=found.status, search=search, settings=settings)


def farthest_m(before_m: np.ndarray, after_m: np.ndarray) -> float:
    """Return how far the points of a path ``[N, 2]`` are at most from what it became, ``[W, 2]``."""
    line = shapely.LineString(after_m if len(after_m) > 1 else np.repeat(after_m, 2, axis=0))
    return float(shapely.distance(shapely.points(before_m), line).max())


def _change(before: float, after: float) -> str:
    if before == 0:
        return f"the weighted cost is {after:.3f}, before {before:.3f}"
    share = after / before - 1
    if abs(share) < 5e-5:
        return f"the weighted cost stays {after:.3f}"
    return f"the weighted cost is {abs(share):.2%} {'higher' if share > 0 else 'lower'}, {after:.3f}"


def _check_same_maps(planned: PlannedPath, on: CostMap) -> None:
    """Raise InputError unless the path can be of this cost map."""
    levels_m = planned.settings.get("levels_m", [planned.altitude_m])
    if (planned.crs, planned.settings.get("resolution_m"), levels_m) != (
        on.grid.crs,
        on.grid.resolution_m,
        on.altitudes_m.tolist(),
    ) or ("levels_m" in planned.settings) != (on.levels is not None):
        raise InputError(
            f"the path was planned at {planned.altitude_m:g} m in {planned.crs}, and this cost map is of "
            f"{on.facts['grid']} at {on.altitude_m:g} m: give the cost map that it was planned on"
        )
