"""cost_to_go: what the cheapest path from every cell to one goal costs."""

from typing import Unpack

import numpy as np

from jaxurban.checks import typed
from jaxurban.maps.metric_maps import MapsLike
from jaxurban.paths.choices import MapChoice
from jaxurban.paths.places import XY, Point, one_place
from jaxurban.paths.plan import cost_map
from jaxurban.planners import astar
from jaxurban.planners.tile_search import costs_by_tiles
from jaxurban.settings import Backend


@typed
def cost_to_go(
    maps: MapsLike,
    goal: Point | XY,
    *,
    altitude_m: float,
    snap: bool | float = False,
    backend: Backend = "auto",
    **choice: Unpack[MapChoice],
) -> np.ndarray:
    """Return the cost of the cheapest path of the grid from each cell to a goal.

    The costs are exact, and those of `plan`. The costs from thousands of starts to one goal are one such field.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      goal: longitude, latitude in degrees, or an `XY` in the maps' CRS.
      altitude_m: within the range of the maps' altitudes.
      weights, objective, cost_model, time, time_of_day, constraints, preset: which map, as in `cost_map`.
      snap: whether a goal that is not free moves to the nearest free cell, as in `plan`.
      backend: ``"numba"``, ``"jax"`` (tiles, `planners.tile_search`), or ``"auto"``: Numba, which is several times as
        fast on a CPU; on a GPU neither is measured.

    Returns:
      ``[Y, X]`` float64, row 0 in the south; inf where a cell is closed or no way leads to the goal.

    Raises:
      InputError: as of `plan`.

    Examples:
      >>> to_go = ju.cost_to_go(maps, goal, altitude_m=60.0)
      >>> row, col = maps.grid.cell_of_lonlat(*start)
      >>> bool(abs(to_go[row, col] - ju.plan(maps, start, goal, altitude_m=60.0).cost) < 1e-9)
      True
    """
    place = one_place("goal", goal)
    weighed_maps = cost_map(
        maps,
        altitude_m,
        **choice,
    )
    _, end = weighed_maps.free_space.ends(place, place, snap=snap)
    problem = weighed_maps.problem.between(end.cell, end.cell)
    return costs_by_tiles(problem) if backend == "jax" else astar.exact_cost_to_go(problem)
