"""simplify: a planned path with as few waypoints as keep it within a tolerance, clear of closed cells."""

from dataclasses import replace

import numpy as np

from jaxurban.errors import InputError, positive, typed
from jaxurban.paths.constraints import constraints_said
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.path import PlannedPath, map_settings, measured
from jaxurban.planners.simplify import farthest
from jaxurban.planners.simplify import simplify as simplify_path

SAME_PLACE_M = 1e-6  # of a path in the maps' CRS and from its map's corner


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
      InputError: a tolerance that is not a positive number of metres, or a cost map under other settings, constraints
        or in another region than the path's.
    """
    tolerance_m = positive("tolerance_m", tolerance_m, "metres")
    if not planned.status.has_path:
        return planned
    _check_same_maps(planned, on)
    points_m = planned.search.points_m
    simpler = simplify_path(on.problem, planned.search, tolerance_m)
    after = measured(on, simpler.points_m)
    moved_m = farthest(points_m[:, :2], simpler.points_m[:, :2])
    said = (
        f"Simplified to {tolerance_m:g} m: {len(simpler.points_m)} of {len(points_m)} waypoints, at most "
        f"{moved_m:.2f} m from the planned path; {_change(planned.cost, after['cost'])}."
    )
    search = replace(simpler, note=" ".join(filter(None, (simpler.note, said))))
    settings = {**planned.settings, "simplify_m": tolerance_m}
    return replace(planned, **after, status=simpler.status, search=search, settings=settings)


def _change(before: float, after: float) -> str:
    if before == 0:
        return f"the weighted cost is {after:.3f}, before {before:.3f}"
    share = after / before - 1
    if abs(share) < 5e-5:
        return f"the weighted cost stays {after:.3f}"
    return f"the weighted cost is {abs(share):.2%} {'higher' if share > 0 else 'lower'}, {after:.3f}"


def _check_same_maps(planned: PlannedPath, on: CostMap) -> None:
    """Raise InputError unless the path can be of this cost map: only that one knows what the path keeps clear of."""
    a_level = {"levels_m": None, "altitude_m": planned.altitude_m}  # unless the cost map has levels
    of_path = {"crs": planned.crs, **a_level, **planned.settings}
    of_map = {"crs": on.grid.crs, **a_level, **map_settings(on)}
    if on.levels is None:
        of_map["altitude_m"] = on.altitude_m
    for name, held in of_map.items():
        if (had := of_path.get(name)) != held:
            said = [constraints_said(of or {}) or "none" if name == "limits" else of for of in (had, held)]
            raise InputError(
                f"the path was planned with {name} {said[0]}, and this cost map has "
                f"{'others' if said[0] == said[1] else said[1]}: give the cost map that it was planned on"
            )
    corner_m = np.array([on.grid.x_min_m, on.grid.y_min_m])
    if not np.allclose(planned.search.points_m[:, :2] + corner_m, planned.xy_m, rtol=0.0, atol=SAME_PLACE_M):
        raise InputError(
            f"the path was planned in another region than that of {on.facts['grid']}: give the cost map that it was "
            "planned on"
        )
