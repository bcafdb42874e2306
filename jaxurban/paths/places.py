"""Places as users give them and ends of queries: points, and how far one may be moved."""

import numbers
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import Cell
from jaxurban.world.grid import Grid

# Longitude, latitude in degrees, and between levels an altitude if liked.
Point = tuple[float | None, ...]
IN_METRES = "easting, northing in metres such as (583960.0, 4507351.0)"
IN_DEGREES = "longitude, latitude in degrees such as (-74.0, 40.7)"
MAX_SNAP_M = 50.0  # about half a city block, unless another distance is given


class XY(NamedTuple):
    """A place in the maps' CRS: easting, northing in metres; between levels its altitude if liked.

    Examples:
      >>> place = ju.XY(586650.0, 4514550.0)
      >>> ju.cost_map(maps, 60.0).plan(place, goal).status.value
      'optimal'
    """

    x_m: float
    y_m: float
    altitude_m: float | None = None


def one_place(name: str, place: Point | XY) -> Point | XY:
    """Return a place that a user gives, as floats: an `XY` in metres, or a tuple in degrees.

    Args:
      name: of the place, such as ``"start"``, for messages.
      place: longitude, latitude in degrees, or an `XY`; between levels also an altitude, which may be None.

    Raises:
      InputError: it is not two numbers, and maybe an altitude.
    """
    is_in_metres = isinstance(place, XY)
    try:
        values: Any = [None if value is None else float(value) for value in place]
    except (TypeError, ValueError):  # no numbers; what follows refuses an empty list
        values = []
    if len(values) not in (2, 3) or None in values[:2]:
        expected = IN_METRES if is_in_metres else IN_DEGREES
        raise InputError(f"{name} must be {expected}, got {place!r}")
    return XY(*values) if is_in_metres else tuple(values)


def cell_at(grid: Grid, name: str, place: Point | XY) -> tuple[tuple[float, float], Cell]:
    """Return where a place is on a grid.

    Args:
      grid: of maps.
      name: of the place, for messages.
      place: longitude, latitude in degrees, or an `XY` in the grid's CRS; an altitude does not matter.

    Returns:
      Easting and northing in metres in the grid's CRS, and row and column of the cell.

    Raises:
      InputError: a place outside the grid.

    Examples:
      >>> from jaxurban.paths.places import cell_at
      >>> xy_m, cell = cell_at(maps.grid, "start", start)
      >>> [round(value) for value in xy_m], cell
      ([586650, 4514550], (2, 2))
    """
    coordinates: Any = place[:2]
    try:
        if isinstance(place, XY):
            x_m, y_m = coordinates
            row, col = grid.cell_of_xy(x_m, y_m)
        else:
            x_m, y_m = grid.xy_of_lonlat(*coordinates)
            row, col = grid.cell_of_lonlat(*coordinates)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    return (float(x_m), float(y_m)), (int(row), int(col))


@dataclass(frozen=True)
class End:
    """Where a query starts or ends.

    Attributes:
      cell: row and column; in a volume level, row and column.
      snap_distance_m: from the place that was given to the centre of the cell.
      is_snapped: this is another cell than that of the given place, which was closed or not joined to the other end.
      on_ground: it was moved to where the air is free down to the ground.
      was_free: it was moved although the cell of the given place is free.
    """

    cell: Cell
    snap_distance_m: float
    is_snapped: bool = False
    on_ground: bool = False
    was_free: bool = False


def snap_limit_m(snap: Any) -> float | None:
    """Return how many metres a place may be moved, None where it may not be moved at all.

    Args:
      snap: True for `MAX_SNAP_M`, False for None, or a number of metres.

    Raises:
      InputError: neither a bool nor metres above 0.
    """
    if isinstance(snap, bool | np.bool_):
        return MAX_SNAP_M if snap else None
    if not isinstance(snap, numbers.Real) or not float(snap) > 0:
        raise InputError(
            f"snap must be True (at most {MAX_SNAP_M:g} m), False, or metres above 0, got {snap!r}"
        )
    return float(snap)
