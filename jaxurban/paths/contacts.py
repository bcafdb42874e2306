"""Where steps of a mission meet prisms: buildings by their exact outlines, or cells, and no-fly zones."""

from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.read.zone import cell_boxes
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.legs import Steps, ground_at
from jaxurban.paths.profile import GUESSED, TOUCHED
from jaxurban.settings import SLABS

TOUCH_M = 0.01  # stretches so near along a mission are one
DOT_M = 1e-6  # length that a step straight up or down has in plan


class Prisms(NamedTuple):
    """Upright prisms in the maps' CRS, which stand on the ground as it is below each of their points. ``B`` of them.

    Attributes:
      polygons: ``[B]`` outlines.
      floor_m, top_m: ``[B]`` heights above the ground that they reach from and to, both included.
      is_guessed: ``[B]`` the height is not known.
    """

    polygons: np.ndarray
    floor_m: np.ndarray
    top_m: np.ndarray
    is_guessed: np.ndarray


def buildings_of(maps: MetricMaps, city: City | None) -> Prisms:
    """Return the buildings of a city; without one, the cells of maps that a roof touches.

    Raises:
      InputError: a city in another CRS than the maps, or maps that hold no touched roofs.
    """
    grid = maps.grid
    if city is not None and city.buildings is not None:
        if city.crs != grid.crs:
            raise InputError(
                f"sources is a city in {city.crs}, and the maps are in {grid.crs}: give the City that they are of"
            )
        buildings = city.buildings
        hangs = (buildings.min_height_m > 0) & (city.hanging == SLABS)
        floor_m = np.where(hangs, buildings.min_height_m, -np.inf)
        return Prisms(buildings.polygons, floor_m, buildings.height_m, buildings.is_guessed)
    if TOUCHED not in maps.ds:
        raise InputError(
            f"maps hold no {TOUCHED!r}, and no City that they are of is there: make them again, or name it (sources)"
        )
    roof_m = maps.m(TOUCHED)
    cells = np.argwhere(roof_m > 0)
    top_m = roof_m[tuple(cells.T)].astype(float)
    guessed = maps.m(GUESSED) if GUESSED in maps.ds else np.zeros(grid.shape)
    is_guessed = guessed[tuple(cells.T)].astype(bool)
    return Prisms(cell_boxes(grid, cells, 1), np.full(len(cells), -np.inf), top_m, is_guessed)


def contacts(steps: Steps, prisms: Prisms, maps: MetricMaps, beside_m: float = 0.0) -> pd.DataFrame:
    """Return a row for each step and prism that meet in plan, or are no farther apart than a distance.

    Returns:
      ``step`` and ``prism`` (numbers), ``from_m`` and ``to_m`` along the mission, ``gap_m`` (least height over the top,
      or below the floor; negative inside) and ``apart_m`` (distance to the outline in plan), in the order of travel.
    """
    ends_m = steps.ends_m.copy()
    ends_m[:, 1, 0] += DOT_M * (steps.over_m == 0)
    lines = shapely.linestrings(ends_m)
    step, prism = shapely.STRtree(prisms.polygons).query(
        lines, predicate="dwithin", distance=beside_m
    )
    outlines, z_m = prisms.polygons[prism], steps.z_m[step]
    apart_m = shapely.distance(lines[step], outlines)
    if "terrain" in maps.ds and beside_m:  # what stands beside stands on other ground
        nearest = shapely.get_coordinates(shapely.shortest_line(outlines, lines[step]))[::2]
        fall_m = steps.ground_m[step] - ground_at(nearest, maps)[:, None]
        z_m = z_m + np.where(apart_m[:, None] > 0, np.nan_to_num(fall_m), 0.0)
    gap_m = np.maximum(
        z_m.min(axis=1) - prisms.top_m[prism], prisms.floor_m[prism] - z_m.max(axis=1)
    )
    from_m, to_m = steps.along_m[step].T
    rows = {"step": step, "prism": prism, "from_m": from_m, "to_m": to_m}
    table = pd.DataFrame(rows | {"gap_m": gap_m, "apart_m": apart_m})
    return table.sort_values("from_m", kind="stable", ignore_index=True)


def merged(rows: pd.DataFrame, key: str | None = None) -> pd.DataFrame:
    """Return stretches that touch along the mission as one, in their order: the first of each, its end and extremes.

    Args:
      rows: in the order of travel, with ``from_m`` and ``to_m``; of ``gap_m`` and ``apart_m`` the least is kept.
      key: a column; only rows of one value are joined.
    """
    of = np.zeros(len(rows)) if key is None else rows[key].to_numpy()
    rows = rows.assign(of=of).sort_values(["of", "from_m"], kind="stable", ignore_index=True)
    reach_m = rows.groupby("of")["to_m"].cummax().shift()
    is_new = (rows["of"] != rows["of"].shift()) | (rows["from_m"] > reach_m + TOUCH_M)
    how = dict.fromkeys(rows.columns.drop("of"), "first")
    how |= {name: "min" for name in ("gap_m", "apart_m") if name in rows} | {"to_m": "max"}
    return rows.groupby(is_new.cumsum()).agg(how).sort_values("from_m", ignore_index=True)


def union_m(rows: pd.DataFrame) -> float:
    """Return the length along a mission that stretches cover, each metre once."""
    each = merged(rows[["from_m", "to_m"]])
    return float((each["to_m"] - each["from_m"]).sum())
