"""Detours around the densest cells of a flight's corridor."""

from bisect import bisect_left
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.checks import typed
from jaxurban.io.read.zone import touched_cells
from jaxurban.paths.corridor import cell_means, cells_within
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.ground_risk import DENSITY, OverflownDensity, overflown_density
from jaxurban.paths.lines import line_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.snapping import XY

DETOUR = [DENSITY, "lowered_share", "length_m", "extra_m", "cost"]
ROUND = 1.002  # by how much a polygon of 16 corners a quarter lies within its circle, and more


@typed
def density_detours(
    planned: PlannedPath, cost_map: CostMap, density: OverflownDensity
) -> pd.DataFrame:
    """Return what detours between the same ends would lower, and how much longer they are.

    A route is planned clear of all cells of the density's grid above a bound, with the whole corridor: at the least
    bound under which the ends are still joined, and halfway between that and the route's own density. Cells that the
    corridor touches at the ends stay open, as none can avoid them. Where no density is known is closed like the
    densest, but for what the route itself comes near.

    Args:
      planned: the route that ``density`` is of.
      cost_map: the cost map that it was planned on.
      density: of the route, whose corridor, grid and times of day are taken.

    Returns:
      A row a detour, the least dense first, none where no route is less dense: ``density_per_km2``, ``lowered_share``,
      ``length_m``, ``extra_m`` and ``cost``.

    Raises:
      InputError: a cost map in another region.

    Examples:
      >>> cost_map, ends = ju.cost_map(maps, 60.0), (maps.grid.lonlat_of_cell(14, 4), maps.grid.lonlat_of_cell(14, 25))
      >>> path = cost_map.plan(*ends)
      >>> density = ju.overflown_density(maps, path, half_width_m=5.0, buffer_m=5.0, cell_m=100.0)
      >>> detours = ju.density_detours(path, cost_map, density)
      >>> detours[["lowered_share", "extra_m"]].round(2).to_numpy().tolist()
      [[0.51, 327.7], [0.26, 16.57]]
    """
    grid = cost_map.grid
    reach_m = density.reach_m
    most = density.density_per_km2
    times = [name or None for name in density.largest["time_of_day"].unique()]
    cells = cells_within(shapely.box(*grid.bounds_m), reach_m, density.settings["cell_m"], grid)
    people = [cost_map.maps.m("density", time_of_day=name) for name in times]
    means = np.fmax.reduce([cell_means(each, grid, cells)[0] for each in people])
    is_kept = shapely.dwithin(cells.boxes, shapely.MultiPoint(planned.xy_m[[0, -1]]), reach_m)
    least = np.nanmax(means[is_kept], initial=0.0)
    is_kept |= np.isnan(means) & shapely.dwithin(cells.boxes, line_of(planned.xy_m), reach_m)
    level = np.where(np.isnan(means), np.inf, means)
    corners_m = planned.xy_m
    if cost_map.levels is not None:
        corners_m = np.column_stack([planned.xy_m, planned.z_m])
    start = XY(*corners_m[0])
    goal = XY(*corners_m[-1])
    nodes = [end.cell for end in cost_map.ends(start, goal)]

    def up_to(bound: float) -> CostMap:
        dense = shapely.union_all(cells.boxes[(level > bound) & ~is_kept])
        closed = touched_cells(shapely.buffer(dense, reach_m * ROUND, quad_segs=16), grid)
        return replace(cost_map, is_free=cost_map.is_free & ~closed)

    def joins(bound: float) -> bool:
        islands = up_to(bound).islands
        of_start, of_goal = (islands[node] for node in nodes)
        return bool(of_start > 0 and of_start == of_goal)

    bounds = np.unique(level[(level >= least) & (level < most)]).tolist()
    corridor: dict[str, Any] = {**density.settings}
    if len(times) == 1:
        corridor["time_of_day"] = times[0]
    joining = bounds[bisect_left(bounds, True, key=joins) :]
    rows: list[dict[str, float]] = []
    for bound in [joining[0], (joining[0] + most) / 2] if joining else []:
        route = up_to(bound).plan(start, goal, budget_s=planned.settings.get("budget_s"))
        if not route.status.has_path:
            continue
        beneath = overflown_density(cost_map.maps, route, **corridor).density_per_km2
        rows.append(
            {
                DENSITY: beneath,
                "lowered_share": 1 - beneath / most,
                "length_m": route.length_m,
                "extra_m": route.length_m - planned.length_m,
                "cost": route.cost,
            }
        )
    return pd.DataFrame(rows, columns=DETOUR)
