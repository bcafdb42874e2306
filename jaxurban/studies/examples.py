"""Example routes: what each of them crosses, measured as the planners' own routes are."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely

from jaxurban.cost import Weights
from jaxurban.errors import InputError
from jaxurban.planned import PlannedPath
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Cell, Problem
from jaxurban.studies.pool import cheapest_route
from jaxurban.studies.queries import Query, RouteFacts, route_facts
from jaxurban.weighted import WeightedMap

ON_CENTRE = 0.01  # of a cell side: a point this near a centre is the centre, written with few decimals
CORRIDOR_CELLS = 1.5  # a line is followed on the grid within so many cells to either side ...
WIDEST_CORRIDOR_CELLS = 24.0  # ... widened, where obstacles close it, by doubling up to this


@dataclass(frozen=True, eq=False)
class Example:
    """One example route: a query, and the route that answers it.

    Attributes:
      query: the route's ends on its map.
      route: what it crosses.
      points_m: ``[N, 2]`` the route on the grid, metres from the map's southwest corner.
      note: what had to be done to the route; empty where nothing had.
    """

    query: Query
    route: RouteFacts
    points_m: np.ndarray
    note: str = ""


def optimal_examples(queries: Sequence[Query], weights: Weights) -> list[Example]:
    """Return the cheapest route of each query under weights as an example.

    Raises:
      InputError: no path joins the ends of a query.
    """
    examples = []
    for query in queries:
        vector = np.array([float(getattr(weights, name)) for name in query.names])
        points_m = cheapest_route(query, vector)
        examples.append(Example(query, route_facts(query.unit, points_m), points_m))
    return examples


def example_from_path(unit: WeightedMap, planned: PlannedPath, name: str = "") -> Example:
    """Return a planned path as an example (see `example_from_line`).

    Raises:
      InputError: the path has no points, or is of another altitude than the map.
    """
    if planned.altitude_m != unit.altitude_m:
        raise InputError(
            f"example {name or 'route'!r} is a path at {planned.altitude_m:g} m and the map is of "
            f"{unit.altitude_m:g} m: give the map of its own altitude"
        )
    if len(planned.xy_m) == 0:
        raise InputError(f"example {name or 'route'!r} is a path without points ({planned.status.value}): leave it out")
    return example_from_line(unit, planned.xy_m, name)


def example_from_line(unit: WeightedMap, xy_m: np.ndarray, name: str = "") -> Example:
    """Return a route as an example that planners of the grid could have made.

    A route whose points are centres of neighbouring cells is taken as it is. Any other line is redrawn on
    the grid, leg by leg, by the shortest grid path within a narrow corridor around it: a grid path is up to
    8.24 % longer than the line that it follows, and an example must not seem cheaper than every route that it
    is compared with. Legs are the line's own, simplified by half a cell.

    Args:
      unit: from `queries.unit_map`.
      xy_m: ``[N, 2]`` easting, northing in the maps' CRS, ``N >= 2``.
      name: for messages and reports.

    Raises:
      InputError: fewer than two points, points that are not finite, or a route that leaves the maps, ends where
        it starts, or cannot be followed through free cells.
    """
    grid = unit.grid
    points = np.asarray(xy_m, np.float64)
    label = f"example {name!r}" if name else "the example route"
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError(f"{label} must be [N, 2] finite metres with N >= 2, got shape {points.shape}")
    local = (points - np.array([grid.x_min_m, grid.y_min_m])) / grid.resolution_m
    if np.any(local < 0) or np.any(local >= (grid.num_cols, grid.num_rows)):
        raise InputError(f"{label} leaves the maps: clip it to their region, or make maps of a larger one")
    note = ""
    if _is_grid_path(unit, local):
        local = np.floor(local) + 0.5  # decimals lost in a file must not make a diagonal step graze a third cell
    else:
        local, widest = _follow(unit, local, label)
        if widest > CORRIDOR_CELLS:
            note = f"followed within {widest * grid.resolution_m:.0f} m, since obstacles close the way nearer to it"
    (start_col, start_row), (goal_col, goal_row) = np.floor(local[[0, -1]]).astype(int).tolist()
    if (start_row, start_col) == (goal_row, goal_col):
        raise InputError(f"{label} starts and ends in one cell: leave it out, or cut it in two")
    query = Query(unit, (start_row, start_col), (goal_row, goal_col), name)
    on_grid_m = local * grid.resolution_m
    return Example(query, route_facts(unit, on_grid_m), on_grid_m, note)


def _is_grid_path(unit: WeightedMap, local: np.ndarray) -> bool:
    """Return whether points, in cell sides, are the centres of cells of a valid path of neighbours."""
    cells = np.floor(local)
    is_centre = np.abs(local - cells - 0.5) < ON_CENTRE
    steps = np.abs(np.diff(cells, axis=0))
    sizes = steps.sum(axis=1) if unit.cost_model.connectivity == 4 else steps.max(axis=1)
    return (
        bool(is_centre.all() and np.all(sizes == 1)) and unit.evaluate((cells + 0.5) * unit.grid.resolution_m).is_valid
    )


def _follow(unit: WeightedMap, local: np.ndarray, label: str) -> tuple[np.ndarray, float]:
    """Return the centres ``[N, 2]`` of a grid path along a line, in cell sides, and the corridor that it needed."""
    line = shapely.LineString(local).simplify(0.5)
    corners = shapely.get_coordinates(line)
    cells = [(int(row), int(col)) for col, row in np.floor(corners)]
    for which, cell in (("start", cells[0]), ("goal", cells[-1])):
        if not unit.is_free[cell]:
            remedy = "clip the route, or give its altitude"
            if unit.maps.obstacles == "touched" and unit.maps.is_free(unit.altitude_m, "centre")[cell]:
                remedy += ", or, if it was planned so, choose obstacles = centre (--obstacles centre)"
            raise InputError(f"{label}: its {which} is {unit.why_closed(cell)}: {remedy}")
    # A corner inside an obstacle is skipped: the legs around it are one.
    kept = [k for k, cell in enumerate(cells) if unit.is_free[cell]]
    points, widest = [np.array(cells[0][::-1]) + 0.5], CORRIDOR_CELLS
    for i, j in pairwise(kept):
        if cells[i] == cells[j]:
            continue
        leg = shapely.LineString(corners[i : j + 1])
        width = CORRIDOR_CELLS
        while True:
            path = _shortest_within(unit, leg, width, cells[i], cells[j])
            if path is not None:
                break
            width *= 2
            if width > WIDEST_CORRIDOR_CELLS:
                raise InputError(
                    f"{label} cannot be followed through free cells at {unit.altitude_m:g} m within "
                    f"{WIDEST_CORRIDOR_CELLS * unit.grid.resolution_m:.0f} m of it: check its altitude"
                )
        widest = max(widest, width)
        points.extend(path[1:])
    return np.array(points), widest


def _shortest_within(
    unit: WeightedMap, leg: shapely.LineString, width: float, start: Cell, goal: Cell
) -> np.ndarray | None:
    """Return the shortest grid path whose cells' centres lie within ``width`` of a leg, in cell sides; None without."""
    west, south, east, north = leg.bounds
    pad = int(np.ceil(width)) + 1
    low = np.maximum(np.floor([south, west]).astype(int) - pad, 0)
    high = np.minimum(np.floor([north, east]).astype(int) + pad + 1, unit.is_free.shape)
    rows, cols = np.mgrid[low[0] : high[0], low[1] : high[1]]
    near = shapely.dwithin(shapely.points(cols + 0.5, rows + 0.5), leg, width)
    is_free = unit.is_free[low[0] : high[0], low[1] : high[1]] & near
    ends = [(cell[0] - int(low[0]), cell[1] - int(low[1])) for cell in (start, goal)]
    if not all(is_free[end] for end in ends):
        return None
    found = astar(
        Problem(
            np.zeros((1, *is_free.shape)),
            is_free,
            start=ends[0],
            goal=ends[1],
            resolution_m=1.0,
            distance_weight=1.0,
            cost_model=unit.cost_model,
        )
    )
    return found.points_m + low[::-1] if found.status.has_path else None
