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
from jaxurban.paths.ground_risk import overflown_density
from jaxurban.paths.lines import line_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.places import XY
from jaxurban.paths.route_report import DENSITY, OverflownDensity

DETOUR = [DENSITY, "lowered_share", "length_m", "extra_m", "cost"]
ROUND = 1.002  # by how much a polygon of 16 corners a quarter lies within its circle, and more


@typed
def density_detours(
    planned: PlannedPath, cost_map: CostMap, density: OverflownDensity
) -> pd.DataFrame:
    """Return what detours between the same ends would lower, and how much longer they are.

    A detour keeps its whole corridor clear of all cells of the density's grid above a bound. Two bounds are tried: the
    least under which the ends are still joined, and the one halfway between that and the route's own density. Cells
    that the corridor touches at the ends stay open, as no route can avoid them. Cells whose density is not known are
    closed like the densest, except those that the corridor of the route itself touches.

    Args:
      planned: the route that ``density`` is of.
      cost_map: the cost map that it was planned on.
      density: of the route, whose corridor, grid and times of day are taken.

    Returns:
      A row for each detour, the least dense first; no row where no route is less dense. Columns: ``density_per_km2``,
      ``lowered_share`` (of the route's density), ``length_m``, ``extra_m`` (beyond the route's length) and ``cost``.

    Raises:
      InputError: a cost map in another region than the route's.

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
    route_density = density.density_per_km2

    # The mean density of each cell, at the time of day when it is largest; inf where it is never known.
    times = [name or None for name in density.largest["time_of_day"].unique()]
    cells = cells_within(shapely.box(*grid.bounds_m), reach_m, density.settings["cell_m"], grid)
    means = np.full(len(cells.boxes), np.nan)
    for name in times:
        per_km2 = cost_map.maps.m("density", time_of_day=name)
        means_then, _ = cell_means(per_km2, grid, cells)
        means = np.fmax(means, means_then)  # of a number and NaN the number
    cell_density = np.where(np.isnan(means), np.inf, means)

    # Cells that stay open: at the ends, and along the route where their density is not known. The route cannot be made
    # less dense than the densest cell at its ends, so that no lower bound is tried.
    ends = shapely.MultiPoint(planned.xy_m[[0, -1]])
    is_open = shapely.dwithin(cells.boxes, ends, reach_m)
    least_bound = np.nanmax(means[is_open], initial=0.0)
    is_open |= np.isnan(means) & shapely.dwithin(cells.boxes, line_of(planned.xy_m), reach_m)

    # The ends of the route, which a volume takes with their heights.
    corners_m = planned.xy_m
    if cost_map.levels is not None:
        corners_m = np.column_stack([planned.xy_m, planned.z_m])
    start = XY(*corners_m[0])
    goal = XY(*corners_m[-1])
    start_end, goal_end = cost_map.ends(start, goal)

    def map_below(bound: float) -> CostMap:
        """Return the cost map on which no corridor comes to cells above a density, save open ones."""
        dense = shapely.union_all(cells.boxes[(cell_density > bound) & ~is_open])
        closed = touched_cells(shapely.buffer(dense, reach_m * ROUND, quad_segs=16), grid)
        return replace(cost_map, is_free=cost_map.is_free & ~closed)

    def is_joined(bound: float) -> bool:
        """Return whether free cells of `map_below` join start and goal."""
        islands = map_below(bound).islands
        island = islands[start_end.cell]
        return bool(island > 0 and island == islands[goal_end.cell])

    # The least bound under which the ends are joined, by bisection over the densities of cells: as a larger bound opens
    # more cells, `is_joined` is False up to some bound and True from there on.
    is_lower = (cell_density >= least_bound) & (cell_density < route_density)
    bounds = np.unique(cell_density[is_lower]).tolist()
    joining_bounds = bounds[bisect_left(bounds, True, key=is_joined) :]
    tried_bounds = []
    if joining_bounds:
        tried_bounds = [joining_bounds[0], (joining_bounds[0] + route_density) / 2]

    # The route under each bound, and the density along it in the same corridor and at the same times of day.
    corridor: dict[str, Any] = {**density.settings}  # arguments of `overflown_density`
    if len(times) == 1:
        corridor["time_of_day"] = times[0]
    rows = []
    for bound in tried_bounds:
        route = map_below(bound).plan(start, goal, budget_s=planned.settings.get("budget_s"))
        if not route.status.has_path:
            continue
        detour_density = overflown_density(cost_map.maps, route, **corridor).density_per_km2
        rows.append(
            {
                DENSITY: detour_density,
                "lowered_share": 1 - detour_density / route_density,
                "length_m": route.length_m,
                "extra_m": route.length_m - planned.length_m,
                "cost": route.cost,
            }
        )
    return pd.DataFrame(rows, columns=DETOUR)
