"""Demonstrations: routes that were shown, measured as planners' routes are, and beside those that weights lead to."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd
import shapely
from scipy.ndimage import distance_transform_edt

from jaxurban.errors import InputError, typed
from jaxurban.metrics.weights import Weights
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.snapping import MAX_SNAP_M, XY, Place, snap_note
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Cell, Problem
from jaxurban.studies.queries import RouteQuery

ON_CENTRE = 0.01  # of a cell side: a point this near a centre is the centre, written with few decimals
# A line is followed on the grid within so many cells to either side, the next where obstacles close the one before.
CORRIDORS_CELLS = (1.5, 3.0, 6.0, 12.0, 24.0)
DRAWN_CELLS = 3.0  # the route that was meant by a line is within so many cells of it


@typed
@dataclass(frozen=True, eq=False)
class Demonstration:
    """A query, and a route between its ends.

    Attributes:
      query: the route's ends on its map.
      points_m: ``[N, 2]`` the route on the grid, metres from the map's southwest corner.
      note: what had to be done to the route; empty where nothing had.
      drawn_cells: within how many cells of ``points_m`` the route that was meant runs; 0: these are its points.
    """

    query: RouteQuery
    points_m: np.ndarray
    note: str = ""
    drawn_cells: float = 0.0

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
        """``[K]`` below which no feature of the route that was meant lies: each the least within ``drawn_cells``."""
        if not self.drawn_cells:
            return self.features
        on, side_m = self.query.cost_map, self.query.cost_map.grid.resolution_m
        cells, pad = np.floor(self.points_m[:, ::-1] / side_m).astype(int), int(np.ceil(self.drawn_cells))
        low, high = np.maximum(cells.min(axis=0) - pad, 0), cells.max(axis=0) + pad + 1
        here = tuple(map(slice, low, high))
        is_far = np.ones(on.is_free[here].shape, bool)
        is_far[tuple((cells - low).T)] = False
        is_near = on.is_free[here] & (distance_transform_edt(is_far) <= self.drawn_cells)
        weights = np.eye(self.features.size)
        start, goal = (tuple((cells[k] - low).tolist()) for k in (0, -1))
        within = Problem(
            on.costs[:, *here], is_near, start, goal, side_m, weights[0], on.cost_model, leg_margin_m=on.leg_margin_m
        )
        routes_m = [astar(within.with_weights(each)).points_m + low[::-1] * side_m for each in weights]
        return np.min([self.features, *(self.query.sums(route_m)[0] for route_m in routes_m)], axis=0)


def optimal_demonstrations(queries: Sequence[RouteQuery], weights: Weights) -> list[Demonstration]:
    """Return the cheapest route of each query under weights as a demonstration.

    Raises:
      InputError: no path joins the ends of a query.
    """
    return [Demonstration(query, query.cheapest(weights.vector(query.names))) for query in queries]


def demonstration_from_line(cost_map: CostMap, xy_m: np.ndarray, name: str = "", label: str = "") -> Demonstration:
    """Return a route as a demonstration that planners of the grid could have made.

    A route over centres of cells is taken as it is, where straight runs may skip what lies between their ends (as
    missions do). Any other line is redrawn on
    the grid, leg by leg, by the shortest grid path within a narrow corridor around it: a grid path is up to
    8.24 % longer than the line that it follows, and a demonstration must not seem cheaper than every route that it
    is compared with. Legs are the line's own, simplified by half a cell; ends in closed cells move to the nearest free
    ones that are joined, by at most 50 m (`jaxurban.paths.snapping`).

    Args:
      cost_map: from `jaxurban.cost_map`.
      xy_m: ``[N, 2]`` easting, northing in the maps' CRS, ``N >= 2``.
      name: for messages and reports.
      label: what messages call the route; left out, by its name.

    Raises:
      InputError: fewer than two points, points that are not finite, or a route that leaves the maps, ends where
        it starts or too far inside an obstacle, or cannot be followed through free cells.
    """
    grid = cost_map.grid
    points = np.asarray(xy_m, np.float64)
    label = label or (f"demonstration {name!r}" if name else "the demonstration")
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError(f"{label} must be [N, 2] finite metres with N >= 2, got shape {points.shape}")
    local = (points - np.array([grid.x_min_m, grid.y_min_m])) / grid.resolution_m
    if np.any(local < 0) or np.any(local >= (grid.num_cols, grid.num_rows)):
        raise InputError(f"{label} leaves the maps: clip it to their region, or make maps of a larger one")
    note, drawn_cells, filled = "", 0.0, _filled(local)
    if _is_grid_path(cost_map, filled):
        local = np.floor(filled) + 0.5  # decimals lost in a file must not make a diagonal step graze a third cell
    else:
        ends = _free_ends(cost_map, points, label)
        for k, end in ((0, ends[0]), (-1, ends[1])):
            if end.is_snapped:
                local[k] = np.array(end.cell[::-1]) + 0.5
        local, widest = _follow(cost_map, local, label)
        wide = f"followed within {widest * grid.resolution_m:.0f} m, since obstacles close the way nearer to it"
        notes = [snap_note(*ends).removesuffix("."), wide if widest > CORRIDORS_CELLS[0] else ""]
        note, drawn_cells = "; ".join(filter(None, notes)), max(widest, DRAWN_CELLS)
    start, goal = (tuple(cell) for cell in np.floor(local[[0, -1], ::-1]).astype(int).tolist())
    if start == goal:
        raise InputError(f"{label} starts and ends in one cell: leave it out, or cut it in two")
    return Demonstration(RouteQuery(cost_map, start, goal, name), local * grid.resolution_m, note, drawn_cells)


def _free_ends(cost_map: CostMap, xy_m: np.ndarray, label: str) -> tuple[Place, Place]:
    """Return the free cells in which a line starts and ends, moved by at most `MAX_SNAP_M`."""
    ends = {"start": XY(*xy_m[0].tolist()), "goal": XY(*xy_m[-1].tolist())}
    for name, end in ends.items():
        cell = cost_map.cell_of(name, end)[1]
        try:
            cost_map.locate(name, end, snap=True)
        except InputError as error:
            raise InputError(
                f"the {name} of {label} is {cost_map.why_closed(cell)}, and no free cell is within {MAX_SNAP_M:g} m of "
                "it: move it there"
            ) from error
    return cost_map.ends(*ends.values(), snap=True)


def _filled(local: np.ndarray) -> np.ndarray:
    """Return points, in cell sides, with the cells between the ends of every straight run along rows or diagonals."""
    steps = np.diff(np.floor(local), axis=0)
    sizes = np.abs(steps).max(axis=1)
    if not np.all((steps == 0) | (np.abs(steps) == sizes[:, None])) or not sizes.all():
        return local
    runs = zip(local, steps / sizes[:, None], sizes.astype(int), strict=False)
    return np.concatenate([*(point + step * np.arange(size)[:, None] for point, step, size in runs), local[-1:]])


def _is_grid_path(cost_map: CostMap, local: np.ndarray) -> bool:
    """Return whether points, in cell sides, are the centres of cells of a valid path of neighbours."""
    cells = np.floor(local)
    is_centre = np.abs(local - cells - 0.5) < ON_CENTRE
    steps = np.abs(np.diff(cells, axis=0))
    sizes = steps.sum(axis=1) if cost_map.cost_model.connectivity == 4 else steps.max(axis=1)
    return (
        bool(is_centre.all() and np.all(sizes == 1))
        and cost_map.problem.features((cells + 0.5) * cost_map.grid.resolution_m).is_valid
    )


def _follow(cost_map: CostMap, local: np.ndarray, label: str) -> tuple[np.ndarray, float]:
    """Return the centres ``[N, 2]`` of a grid path along a line, in cell sides, and the corridor that it needed."""
    line = shapely.LineString(local).simplify(0.5)
    corners = shapely.get_coordinates(line)
    cells = [(int(row), int(col)) for col, row in np.floor(corners)]
    # A corner inside an obstacle is skipped: the legs around it are one.
    kept = [k for k, cell in enumerate(cells) if cost_map.is_free[cell]]
    points, widest = [np.array(cells[0][::-1]) + 0.5], CORRIDORS_CELLS[0]
    for i, j in pairwise(kept):
        if cells[i] == cells[j]:
            continue
        leg = shapely.LineString(corners[i : j + 1])
        for width in CORRIDORS_CELLS:
            path = _shortest_within(cost_map, leg, width, cells[i], cells[j])
            if path is not None:
                break
        else:
            raise InputError(
                f"{label} cannot be followed through free cells at {cost_map.altitude_m:g} m within "
                f"{CORRIDORS_CELLS[-1] * cost_map.grid.resolution_m:.0f} m of it: fly higher, or draw it elsewhere"
            )
        widest = max(widest, width)
        points.extend(path[1:])
    return np.array(points), widest


def _shortest_within(
    cost_map: CostMap, leg: shapely.LineString, width: float, start: Cell, goal: Cell
) -> np.ndarray | None:
    """Return the shortest grid path whose cells' centres lie within ``width`` of a leg, in cell sides; None without."""
    west, south, east, north = leg.bounds
    pad = int(np.ceil(width)) + 1
    low = np.maximum(np.floor([south, west]).astype(int) - pad, 0)
    high = np.minimum(np.floor([north, east]).astype(int) + pad + 1, cost_map.is_free.shape)
    rows, cols = np.mgrid[low[0] : high[0], low[1] : high[1]]
    near = shapely.dwithin(shapely.points(cols + 0.5, rows + 0.5), leg, width)
    is_free = cost_map.is_free[low[0] : high[0], low[1] : high[1]] & near
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
            weights=1.0,
            cost_model=cost_map.cost_model,
            leg_margin_m=cost_map.leg_margin_m / cost_map.grid.resolution_m,
        )
    )
    return found.points_m + low[::-1] if found.status.has_path else None


@dataclass(frozen=True, eq=False)
class PlannedBeside:
    """Routes under weights, beside the demonstrations that have the same ends.

    Attributes:
      demonstrations: as given.
      planned: the cheapest routes under the weights.
      table: a row a demonstration: where it lies, ``length_m`` and the mean of each metric along it, the same of the
        planned route (``planned_length_m`` ...), and ``overlap``, the share of the demonstration's cells that the
        planned route shares.
    """

    demonstrations: tuple[Demonstration, ...]
    planned: tuple[Demonstration, ...]
    table: pd.DataFrame


def plan_beside(demonstrations: Sequence[Demonstration], weights: Weights) -> PlannedBeside:
    """Return each demonstration beside the cheapest route under weights between its ends."""
    planned = optimal_demonstrations([each.query for each in demonstrations], weights)
    rows = []
    for number, (given, found) in enumerate(zip(demonstrations, planned, strict=True), start=1):
        on = given.query.cost_map
        cells = _cells(given)
        rows.append(
            {
                "name": given.query.name or f"{number}",
                "altitude_m": on.altitude_m,
                "time": on.time,
                "time_of_day": on.time_of_day,
                **_means(given, ""),
                **_means(found, "planned_"),
                "overlap": len(cells & _cells(found)) / len(cells),
                "note": given.note,
            }
        )
    return PlannedBeside(tuple(demonstrations), tuple(planned), pd.DataFrame(rows))


def _means(route: Demonstration, prefix: str) -> dict[str, float]:
    length_m, *sums = route.sums[1].tolist()
    means = zip(route.query.cost_map.names, sums, strict=True)
    return {f"{prefix}length_m": length_m} | {f"{prefix}mean_{name}": value / length_m for name, value in means}


def _cells(route: Demonstration) -> set[tuple[int, int]]:
    return cells_of(route.points_m, route.query.cost_map.grid.resolution_m)


def cells_of(points_m: np.ndarray, resolution_m: float) -> set[tuple[int, int]]:
    """Return the cells, column and row, of points ``[N, 2]`` in metres from the map's southwest corner."""
    return set(map(tuple, np.floor(points_m / resolution_m).astype(int).tolist()))
