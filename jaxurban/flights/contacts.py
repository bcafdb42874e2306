"""Where steps of a mission meet prisms: buildings by their exact outlines, or cells, and no-fly zones."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.city import WOOD, City
from jaxurban.io.rasterise import unknown_plants_m
from jaxurban.io.sampling import resample_raster
from jaxurban.io.zone import cell_boxes
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.rules import roof_limits_m
from jaxurban.metrics.variables import ROOF_KIND
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.route_report import TOUCHED
from jaxurban.paths.steps import DOT_M, Steps
from jaxurban.settings import SLABS
from jaxurban.world.footprints import BUILDING
from jaxurban.world.grid import Grid
from jaxurban.world.kinds import EFFECTS

TOUCH_M = 0.01  # stretches so near along a mission are one
MOST_PAIRS = 2_000_000  # of steps and prisms beside them: less than a GiB
NUM_TRIED = 100  # steps by which their number is predicted


class Prisms(NamedTuple):
    """Upright prisms in the maps' CRS, which stand on the ground as it is below each of their points. ``B`` of them.

    Attributes:
      polygons: ``[B]`` outlines.
      floor_m, top_m: ``[B]`` heights above the ground that they reach from and to, both included.
      limit_m: ``[B]`` height that what is of guessed height does not exceed, inf where nothing bounds it; -inf where
        nothing is guessed.
      likely_m: ``[B]`` the same of what it likely does not exceed.
      kind: ``[B]`` the `Footprints.named` of each.
    """

    polygons: np.ndarray
    floor_m: np.ndarray
    top_m: np.ndarray
    limit_m: np.ndarray
    likely_m: np.ndarray
    kind: np.ndarray

    @property
    def is_guessed(self) -> np.ndarray:
        """``[B]`` the height is not known."""
        return self.limit_m >= self.top_m


def buildings_of(maps: MetricMaps, city: City | None) -> Prisms:
    """Return what stands in a city as prisms; without a city, a prism for each cell of the maps that a roof touches.

    Prisms begin far below the ground (-inf), save those of what hangs in the air over a slab's floor. What is known not
    to have a roof, but not how high it is, ends there too.

    Args:
      maps: the maps.
      city: that the maps are of; None, or without outlines, for the cells.

    Raises:
      InputError: a city in another CRS than the maps.
    """
    grid = maps.grid
    if city is not None and city.standing is not None:
        if city.crs != grid.crs:
            raise InputError(
                f"sources is a city in {city.crs}, and the maps are in {grid.crs}: give the City that they are of"
            )
        standing = city.standing
        is_slab = (standing.min_height_m > 0) & (city.hanging == SLABS)
        floor_m = np.where(is_slab, standing.min_height_m, -np.inf)
        top_m = np.where(standing.height_m > 0, standing.height_m, -np.inf)
        limit_m, likely_m = (
            np.where(standing.is_guessed, reach_m, -np.inf)
            for reach_m in (standing.upper_m, standing.likely_upper_m)
        )
        outlines = Prisms(standing.polygons, floor_m, top_m, limit_m, likely_m, standing.named)
        if city.plants is None:
            return outlines
        plants_m = resample_raster(city.plants, grid, "max")
        unsure_m = unknown_plants_m(city, grid)
        plants = _of_cells(grid, WOOD, plants_m, unsure_m, unsure_m)
        return Prisms(*(np.concatenate(values) for values in zip(outlines, plants, strict=True)))
    kind: Any = BUILDING
    if ROOF_KIND in maps.ds:
        names = np.array([BUILDING, *EFFECTS], object)  # 0: nothing is known of the kind
        kind = names[maps.m(ROOF_KIND).astype(int)]
    reach_m = (roof_limits_m(maps, "highest"), roof_limits_m(maps, "likely"))
    return _of_cells(grid, kind, maps.m(TOUCHED), *reach_m)


def _of_cells(
    grid: Grid, kind: Any, top_m: np.ndarray, limit_m: np.ndarray, likely_m: np.ndarray
) -> Prisms:
    """Return cells as prisms from far below the ground; all are ``[Y, X]``, tops and limits of 0 are none."""
    is_there = (top_m > 0) | (limit_m > 0)
    cells = np.argwhere(is_there)
    top_m, limit_m, likely_m = (
        np.where(values > 0, values, -np.inf)[is_there] for values in (top_m, limit_m, likely_m)
    )
    floor_m = np.full(len(cells), -np.inf)
    kinds = np.broadcast_to(np.asarray(kind, object), grid.shape)[is_there]
    return Prisms(cell_boxes(grid, cells, 1), floor_m, top_m, limit_m, likely_m, kinds)


def contacts(
    steps: Steps, prisms: Prisms, ground: Elevation, beside_m: float = 0.0
) -> pd.DataFrame:
    """Return a row for each step and prism that meet in plan, or are no farther apart than a distance.

    Args:
      steps: of the mission.
      prisms: in the maps' CRS.
      ground: on which the prisms stand.
      beside_m: the distance in plan; 0 for those that meet alone.

    Returns:
      ``step`` and ``prism`` (numbers), ``from_m`` and ``to_m`` along the mission, ``gap_m`` (least height over the top,
      or below the floor; negative inside), ``spare_m`` and ``likely_spare_m`` (least height over what a guessed one may
      reach, and likely does; inf where nothing is guessed) and ``apart_m`` (distance to the outline in plan), in the
      order of travel.

    Raises:
      InputError: more than about `MOST_PAIRS` pairs that are no farther apart.
    """
    if not len(prisms.polygons):
        steps = steps.take(np.arange(0))  # a million lines take two seconds
    # Pairs that meet in plan. A step straight up or down gets a length there, since a line needs one.
    ends_m = steps.ends_m.copy()
    ends_m[steps.over_m == 0, 1, 0] += DOT_M
    lines = shapely.linestrings(ends_m)
    tree = shapely.STRtree(prisms.polygons)
    if beside_m:
        some = lines[:: len(lines) // NUM_TRIED + 1]
        num_near = len(tree.query(some, predicate="dwithin", distance=beside_m)[0])
        if num_near * len(lines) > MOST_PAIRS * len(some):
            raise InputError(
                f"clearance_m of {beside_m:g} m is too far: {num_near / len(some):,.0f} outlines are as near to a "
                "place of the mission, more than can be looked at; choose a smaller one"
            )
    step, prism = tree.query(lines, predicate="dwithin", distance=beside_m)
    outlines = prisms.polygons[prism]
    z_m = steps.z_m[step]
    apart_m = shapely.distance(lines[step], outlines)

    # What stands beside a step stands on other ground: heights of the step are measured from there.
    if beside_m and not ground.is_flat:
        shortest = shapely.shortest_line(outlines, lines[step])
        nearest = shapely.get_coordinates(shortest)[::2]  # the end at the outline of each line
        fall_m = steps.ground_m[step] - ground.at(nearest)[:, None]
        z_m = z_m + np.where(apart_m[:, None] > 0, np.nan_to_num(fall_m), 0.0)

    gap_m = np.maximum(
        z_m.min(axis=1) - prisms.top_m[prism], prisms.floor_m[prism] - z_m.max(axis=1)
    )
    spare_m, likely_spare_m = (
        z_m.min(axis=1) - reach_m[prism] for reach_m in (prisms.limit_m, prisms.likely_m)
    )
    table = steps.table(
        step,
        prism=prism,
        gap_m=gap_m,
        spare_m=spare_m,
        likely_spare_m=likely_spare_m,
        apart_m=apart_m,
    )
    return table.sort_values("from_m", kind="stable", ignore_index=True)


def merged(rows: pd.DataFrame, key: str | None = None) -> pd.DataFrame:
    """Return a table in which stretches that overlap, or touch within `TOUCH_M`, are one row, in the order of travel.

    A row has the values of the first of its stretches, the last ``to_m``, and the least ``gap_m`` and ``apart_m``.

    Args:
      rows: stretches in the order of travel, with ``from_m`` and ``to_m``.
      key: name of a column: stretches of other values there are not joined. None joins all.
    """
    if rows.empty:
        return rows
    group = np.zeros(len(rows)) if key is None else rows[key].to_numpy()
    order = np.lexsort((rows["from_m"], group))  # by group, and in the order of travel within each
    rows, group = rows.iloc[order], group[order]
    from_m, to_m = rows[["from_m", "to_m"]].to_numpy().T
    # How far the stretches before reach; at the first of a group it has no meaning, and is not used.
    reach_m = pd.Series(to_m).groupby(group).cummax().to_numpy()
    is_new = np.ones(len(rows), bool)
    is_new[1:] = (group[1:] != group[:-1]) | (from_m[1:] > reach_m[:-1] + TOUCH_M)
    begins = np.flatnonzero(is_new)

    joined = {"to_m": np.maximum.reduceat(to_m, begins)}
    for name in rows.columns.intersection(["gap_m", "apart_m"]):
        joined[name] = np.fmin.reduceat(rows[name].to_numpy(), begins)
    return rows.iloc[begins].assign(**joined).sort_values("from_m", ignore_index=True)
