"""Demonstrations: routes on the grid between two ends, each on the map that it was flown on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from scipy.ndimage import distance_transform_edt

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.metrics.weights import Weights
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.places import MAX_SNAP_M, XY
from jaxurban.paths.snapping import snap_note
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Cell, Problem
from jaxurban.studies.queries import RouteQuery

# Of a cell side: a point this near a centre is the centre, written with few decimals.
ON_CENTRE = 0.01
# A line is followed on the grid within so many cells to either side, the next where obstacles close the one before.
CORRIDORS_CELLS = (1.5, 3.0, 6.0, 12.0, 24.0)
DRAWN_CELLS = 3.0  # the route that was meant by a line is within so many cells of it
ROUNDED_CELLS = (
    2.0  # within so many cells of a redrawn line, another route differs by what the grid rounds
)
NEARER = 1e-3  # what a cell away from a line costs, in lengths of a cell


@typed
@dataclass(frozen=True, eq=False)
class Demonstration:
    """A query, and a route between its ends.

    Attributes:
      query: the route's ends on its map.
      points_m: ``[N, 2]`` the route on the grid, metres from the map's southwest corner.
      note: what had to be done to the route; empty where nothing had.
      drawn_cells: within how many cells of ``points_m`` the route that was meant runs; 0: these are its points.
      pilot: the weights under which it was planned; None: it was not, or nobody says.

    Examples:
      >>> (routes,) = ju.fit.demonstrations(path, maps)
      >>> routes.query.start, routes.query.goal, routes.points_m.shape, routes.drawn_cells
      ((2, 2), (27, 27), (38, 2), 0.0)
      >>> dict(zip(routes.query.names, routes.features.round().tolist()))  # metres, then sums of costs
      {'distance': 848.0, 'gps': 20.0, 'lidar': 166.0, 'population': 12.0, 'risk': 0.0}
    """

    query: RouteQuery
    points_m: np.ndarray
    note: str = ""
    drawn_cells: float = 0.0
    pilot: Weights | None = None

    @cached_property
    def sums(self) -> np.ndarray:
        """``[2, K]`` features and integrals of the route (see `RouteQuery.sums`)."""
        return self.query.sums(self.points_m)

    @property
    def features(self) -> np.ndarray:
        """``[K]`` what weights multiply, so that cost = W . features."""
        return self.sums[0]

    @cached_property
    def least_features(self) -> np.ndarray:
        """``[K]`` lower bounds of the features of the route that was meant by a drawn line.

        Each is the least value of its feature over all routes within ``drawn_cells`` of ``points_m``, found by a search
        that minimises this feature alone. Where ``drawn_cells`` is 0 they are the features themselves.
        """
        least = self.features
        for only_one in np.eye(least.size):
            least = np.minimum(least, self.cheapest_near(only_one, self.drawn_cells))
        return least

    def cheapest_near(self, weights: np.ndarray, within_cells: float = ROUNDED_CELLS) -> np.ndarray:
        """Return the features of the cheapest route near this one.

        Args:
          weights: ``[K]`` under which it is the cheapest.
          within_cells: of ``points_m``, and no farther than ``drawn_cells``. Where this is 0 the features are those of
            ``points_m``.

        Returns:
          ``[K]``, in the order of the weights.

        Examples:
          >>> (planned,) = ju.fit.demonstrations(path, maps)  # on the grid, so the same
          >>> bool((planned.cheapest_near(planned.features) == planned.features).all())
          True
        """
        within_cells = min(within_cells, self.drawn_cells)
        if not within_cells:
            return self.features

        # The part of the map around the route, and which of its cells, row and column, are near enough.
        cost_map = self.query.cost_map
        side_m = cost_map.grid.resolution_m
        cells = np.floor(self.points_m[:, ::-1] / side_m).astype(int)
        pad = int(np.ceil(within_cells))
        first = np.maximum(cells.min(axis=0) - pad, 0)
        window = _window(first, cells.max(axis=0) + pad)
        cells = cells - first
        is_off_route = np.ones(cost_map.is_free[window].shape, bool)
        is_off_route[tuple(cells.T)] = False
        is_near = distance_transform_edt(is_off_route) <= within_cells
        start, goal = map(tuple, cells[[0, -1]].tolist())
        problem = replace(
            cost_map.shortest,
            costs=cost_map.costs[:, *window],
            is_free=cost_map.is_free[window] & is_near,
            start=start,
            goal=goal,
        )
        route_m = astar(problem.with_weights(weights)).points_m + first[::-1] * side_m
        return self.query.sums(route_m)[0]


def optimal_demonstrations(queries: Sequence[RouteQuery], weights: Weights) -> list[Demonstration]:
    """Return the cheapest route of each query under weights as a demonstration.

    Raises:
      InputError: no path joins the ends of a query.
    """
    return [
        Demonstration(query, query.cheapest(weights.vector(query.names)), pilot=weights)
        for query in queries
    ]


def demonstration_from_line(cost_map: CostMap, xy_m: np.ndarray, name: str = "") -> Demonstration:
    """Return a route as a demonstration that planners of the grid could have made.

    A route over centres of cells is not changed; where its straight runs skip cells, as missions do, these are filled
    in. Any other line is redrawn on the grid, leg by leg, by the shortest grid path within a narrow corridor around it:
    a grid path is up to 8.24 % longer than the line that it follows, and a demonstration must not seem cheaper than
    every route with which it is compared. Legs are those of the line, simplified by half a cell. Ends in closed cells
    move to the nearest free cells that a path joins, by at most 50 m (`jaxurban.paths.snapping`).

    Args:
      cost_map: from `jaxurban.cost_map`.
      xy_m: ``[N, 2]`` easting, northing in the maps' CRS, ``N >= 2``.
      name: for messages and reports.

    Raises:
      InputError: fewer than two points, points that are not finite, or a route that leaves the maps, ends where
        it starts or too far inside an obstacle, or cannot be followed through free cells.
    """
    # The points of the route, and the same in cell sides from the southwest corner of the maps.
    grid = cost_map.grid
    points = np.asarray(xy_m, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError(
            f"a route must be [N, 2] finite metres with N >= 2, got shape {points.shape}"
        )
    local = (points - grid.bounds_m[:2]) / grid.resolution_m
    if np.any(local < 0) or np.any(local >= (grid.num_cols, grid.num_rows)):
        raise InputError(
            "it leaves the maps: clip it to their region, or make maps of a larger one"
        )

    # A grid path is moved to the exact centres of its cells, since a diagonal step must not graze a third cell because
    # a file has lost decimals. Any other line is redrawn.
    route = _grid_path(cost_map, local) or _redrawn(cost_map, points, local)

    # The cells of the ends as row and column, while points are x and y.
    start, goal = map(tuple, np.floor(route.centres[[0, -1], ::-1]).astype(int).tolist())
    if start == goal:
        raise InputError("it starts and ends in one cell: leave it out, or cut it in two")
    query = RouteQuery(cost_map, start, goal, name)
    return Demonstration(query, route.centres * grid.resolution_m, route.note, route.within_cells)


class _Followed(NamedTuple):
    """A grid path along a line.

    Attributes:
      centres: ``[N, 2]`` x and y of the centres of its cells, in cell sides from the southwest corner.
      within_cells: it runs within this distance of the line, in cell sides.
      note: what had to be done to follow the line; empty where nothing had.
    """

    centres: np.ndarray
    within_cells: float
    note: str = ""


def _redrawn(cost_map: CostMap, xy_m: np.ndarray, local: np.ndarray) -> _Followed:
    """Return a grid path along a line, from the free cell nearest to its start to the one nearest to its end.

    Args:
      cost_map: whose free cells the path uses.
      xy_m: ``[N, 2]`` the line, easting and northing in the maps' CRS.
      local: ``[N, 2]`` the same in cell sides from the southwest corner.

    Raises:
      InputError: no free cell is near an end, or no way through free cells near the line.
    """
    start, goal = xy_m[[0, -1]].tolist()
    try:
        ends = cost_map.free_space.ends(XY(*start), XY(*goal), snap=True)
    except InputError as error:
        raise InputError(
            "it starts or ends inside an obstacle or in a closed cell, and no free cell is within "
            f"{MAX_SNAP_M:g} m of it: move that end there"
        ) from error

    # An end that was moved is now the centre of its cell; a cell is row and column, a point x and y.
    line = local.copy()
    for index, end in zip((0, -1), ends, strict=True):
        if end.is_snapped:
            line[index] = np.array(end.cell[::-1]) + 0.5

    # The corners of the line, simplified by half a cell, and their cells as row and column.
    corners = shapely.get_coordinates(shapely.LineString(line).simplify(0.5))
    cells = [tuple(cell) for cell in np.floor(corners[:, ::-1]).astype(int).tolist()]

    # A corner inside an obstacle is skipped, and the legs before and after it become one that bends there.
    free_corners = [number for number, cell in enumerate(cells) if cost_map.is_free[cell]]
    centres = [np.array(cells[0][::-1]) + 0.5]
    widest = CORRIDORS_CELLS[0]
    for first, last in pairwise(free_corners):
        if cells[first] != cells[last]:
            leg = shapely.LineString(corners[first : last + 1])
            path = _follow_leg(cost_map, leg, cells[first], cells[last])
            centres.extend(path.centres[1:])
            widest = max(widest, path.within_cells)

    # What had to be done.
    notes = [snap_note(*ends).removesuffix(".")]
    if widest > CORRIDORS_CELLS[0]:
        width_m = widest * cost_map.grid.resolution_m
        notes.append(f"followed within {width_m:.0f} m, since obstacles block the way nearer to it")
    note = "; ".join(filter(None, notes))
    return _Followed(np.array(centres), max(widest, DRAWN_CELLS), note)


def _grid_path(cost_map: CostMap, local: np.ndarray) -> _Followed | None:
    """Return a line that is a valid grid path, no cell skipped; None for any other line.

    A grid path joins centres of cells by straight runs along rows, columns and, unless the cost model has 4 neighbours,
    diagonals. It is valid where planners could fly it.

    Args:
      cost_map: whose cost model and free cells count.
      local: ``[N, 2]`` the line, in cell sides from the southwest corner.
    """
    steps = np.diff(np.floor(local), axis=0)
    sizes = np.abs(steps).max(axis=1)  # of a run, in cells
    is_along = (steps == 0) | (np.abs(steps) == sizes[:, None])
    if cost_map.cost_model.connectivity == 4:
        is_along &= (steps == 0).any(axis=1, keepdims=True)
    if not is_along.all() or not sizes.all():
        return None

    # Of each run its points but the last one, from which the next run begins.
    runs = [
        point + step / size * np.arange(size)[:, None]
        for point, step, size in zip(local, steps, sizes.astype(int), strict=False)
    ]
    points = np.concatenate([*runs, local[-1:]])
    centres = np.floor(points) + 0.5
    if np.abs(points - centres).max() >= ON_CENTRE:
        return None
    sums = cost_map.problem.features(centres * cost_map.grid.resolution_m)
    return _Followed(centres, within_cells=0.0) if sums.is_valid else None


def _follow_leg(cost_map: CostMap, leg: shapely.LineString, start: Cell, goal: Cell) -> _Followed:
    """Return the shortest grid path, of several the nearest, in the narrowest corridor around a leg that holds one.

    All lengths are in cell sides, and places are counted from the map's southwest corner.

    Args:
      cost_map: whose free cells, cost model and margin of legs the path keeps.
      leg: part of a line.
      start, goal: the cells at its ends, row and column.

    Raises:
      InputError: no corridor holds one.
    """
    for width in CORRIDORS_CELLS:
        # The part of the map that can lie in the corridor, and its free cells that do.
        west, south, east, north = np.floor(leg.bounds).astype(int)
        pad = int(np.ceil(width)) + 1
        first = np.maximum([south - pad, west - pad], 0)
        window = _window(first, np.array([north + pad, east + pad]))
        is_free = cost_map.is_free[window]
        rows, cols = np.indices(is_free.shape) + first[:, None, None]
        away = shapely.distance(shapely.points(cols + 0.5, rows + 0.5), leg)
        is_free = is_free & (away <= width)
        begin, end = map(tuple, (np.array([start, goal]) - first).tolist())
        if not is_free[begin] or not is_free[end]:
            continue

        # The unit of length is the side of a cell. The one layer costs so little that it only decides which of equally
        # short paths is taken: the nearest to the line.
        problem = Problem(
            costs=NEARER * away[None],
            is_free=is_free,
            start=begin,
            goal=end,
            resolution_m=1.0,
            weights=1.0,
            cost_model=cost_map.cost_model,
            leg_margin_m=cost_map.leg_margin_m / cost_map.grid.resolution_m,
        )
        path = astar(problem)
        if path.status.has_path:
            return _Followed(path.points_m + first[::-1], width)
    raise InputError(
        f"it cannot be followed through free cells at {cost_map.altitude_m:g} m within "
        f"{CORRIDORS_CELLS[-1] * cost_map.grid.resolution_m:.0f} m of it: fly higher, or draw it elsewhere"
    )


def _window(first: np.ndarray, last: np.ndarray) -> tuple[slice, ...]:
    """Return the slices of rows and of columns from a first cell to a last one; the last may lie beyond the map."""
    return tuple(map(slice, first, last + 1))


def compared_demonstrations(
    demonstrations: Sequence[Demonstration], planned: Sequence[Demonstration]
) -> pd.DataFrame:
    """Return a row per demonstration: where it lies, beside a planned route between the same ends.

    The columns are ``name``, altitude and times; ``length_m`` and the mean of each metric along the demonstration; the
    same of the planned route (``planned_length_m`` ...); ``overlap``, the share of the demonstration's cells that the
    planned route shares; and ``note``.

    Args:
      demonstrations: one that has no name is numbered, from 1.
      planned: a route for each, in the same order, on the same map.
    """
    rows = []
    pairs = zip(demonstrations, planned, strict=True)
    for number, (demonstration, route) in enumerate(pairs, start=1):
        query = demonstration.query
        cost_map = query.cost_map
        row = {
            "name": query.name or f"{number}",
            "altitude_m": cost_map.altitude_m,
            "time": cost_map.time,
            "time_of_day": cost_map.time_of_day,
        }
        for prefix, side in (("", demonstration), ("planned_", route)):
            length_m, *integrals = side.sums[1].tolist()
            row[f"{prefix}length_m"] = length_m
            for name, integral in zip(cost_map.names, integrals, strict=True):
                row[f"{prefix}mean_{name}"] = integral / length_m
        overlap = overlap_of(demonstration.points_m, route.points_m, cost_map.grid.resolution_m)
        rows.append(row | {"overlap": overlap, "note": demonstration.note})
    return pd.DataFrame(rows)


def overlap_of(points_m: np.ndarray, others_m: np.ndarray, resolution_m: float) -> float:
    """Return the share of the cells of a route that another one shares.

    Args:
      points_m, others_m: ``[N, 2]`` cell by cell, metres from the map's southwest corner.
      resolution_m: side of a cell.
    """
    cells = pd.MultiIndex.from_arrays([*np.floor(points_m / resolution_m).T]).unique()
    others = pd.MultiIndex.from_arrays([*np.floor(others_m / resolution_m).T])
    return float(cells.isin(others).mean())
