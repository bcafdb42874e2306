"""Where pieces of legs meet prisms: buildings by their exact outlines, or cells, and no-fly zones."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.legs import Pieces, between, lines_of
from jaxurban.paths.path import elevation_at
from jaxurban.paths.profile import GUESSED, TOUCHED
from jaxurban.world.city import SLABS, City

TOUCH_M = 0.01  # stretches so near along a mission are one
ARC_PARTS = 16  # of a quarter circle round a corner


class Prisms(NamedTuple):
    """Upright prisms in the maps' CRS. ``B`` of them.

    Attributes:
      polygons: ``[B]`` outlines.
      floor_m, top_m: ``[B]`` heights above the ground that they reach from and to, both included.
      is_guessed: ``[B]`` the height is not known.
    """

    polygons: np.ndarray
    floor_m: np.ndarray
    top_m: np.ndarray
    is_guessed: np.ndarray

    def take(self, chosen: np.ndarray) -> "Prisms":
        """Return some of the prisms."""
        return Prisms(*(values[chosen] for values in self))


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
        held = city.buildings
        hangs = (held.min_height_m > 0) & (city.hanging == SLABS)
        floor_m = np.where(hangs, held.min_height_m, -np.inf)
        return Prisms(held.polygons, floor_m, held.height_m, held.is_guessed)
    if TOUCHED not in maps.ds:
        raise InputError(
            f"maps hold no {TOUCHED!r} and their city is gone: give the City (sources), or make them again"
        )
    roof_m = maps.m(TOUCHED)
    row, col = np.nonzero(roof_m > 0)
    south_west = np.stack([col + grid.first_col, row + grid.first_row])
    polygons = shapely.box(*(np.concatenate([south_west, south_west + 1]) * grid.resolution_m))
    is_guessed = maps.m(GUESSED)[row, col] if GUESSED in maps.ds else np.zeros(len(row))
    return Prisms(
        polygons,
        np.full(len(row), -np.inf),
        roof_m[row, col].astype(float),
        is_guessed.astype(bool),
    )


def contacts(
    pieces: Pieces,
    prisms: Prisms,
    maps: MetricMaps,
    *,
    beside_m: float = 0.0,
    above_m: float = 0.0,
) -> pd.DataFrame:
    """Return a row for each piece and prism that meet, or come nearer than distances beside and above (or below).

    A prism stands on the ground as it is below each point of it. Beside it the ground at its nearest point counts.

    Returns:
      ``prism`` and ``piece`` (numbers), ``from_m`` and ``to_m`` along the mission, ``x_m``, ``y_m`` and ``z_m`` where
      the contact begins, ``gap_m`` (least height over the top or below the floor, negative inside) and ``apart_m``
      (least distance to the outline in plan). In the order of travel.
    """
    most_m = float(prisms.top_m.max(initial=-np.inf)) + above_m
    # Beside a hill's building the ground is another one than below the vehicle.
    is_low = np.isfinite(pieces.z_m).all(axis=1)
    if beside_m == 0 or "terrain" not in maps.ds:
        is_low &= pieces.z_m.min(axis=1) <= most_m
    chosen = np.flatnonzero(is_low)
    lines = lines_of(pieces.ends_m[chosen])
    how: dict[str, Any] = {"predicate": "intersects"}
    if beside_m:
        how = {"predicate": "dwithin", "distance": beside_m}
    near, prism = shapely.STRtree(prisms.polygons).query(lines, **how)
    piece, outlines = chosen[near], prisms.polygons[prism]
    z_m = pieces.z_m[piece]
    if beside_m and "terrain" in maps.ds:
        z_m = z_m + _fall_m(pieces.take(piece), lines[near], outlines, maps)
    low_m, high_m = prisms.floor_m[prism] - above_m, prisms.top_m[prism] + above_m
    shares = _shares_between(z_m, low_m, high_m)
    kept = np.flatnonzero(shares[:, 0] <= shares[:, 1])
    piece, prism, shares, z_m = piece[kept], prism[kept], shares[kept], z_m[kept]
    ends_m = pieces.ends_m[piece]
    parts = lines_of(np.stack([between(ends_m, share) for share in shares.T], axis=1))
    if beside_m:
        which, back = np.unique(prism, return_inverse=True)
        wide = shapely.buffer(prisms.polygons[which], beside_m, quad_segs=ARC_PARTS)[back]
    else:
        wide = prisms.polygons[prism]
    shared = shapely.intersection(parts, wide)
    is_met = ~shapely.is_empty(shared)
    piece, prism, shares, z_m, ends_m = (
        each[is_met] for each in (piece, prism, shares, z_m, ends_m)
    )
    shares = _shares_of(shared[is_met], ends_m, shares)
    inside_z_m = np.stack([between(z_m, share) for share in shares.T], axis=1)
    gap_m = np.maximum(
        inside_z_m.min(axis=1) - prisms.top_m[prism], prisms.floor_m[prism] - inside_z_m.max(axis=1)
    )
    x_m, y_m = between(ends_m, shares[:, 0]).T
    along_m = pieces.along_m[piece]
    rows = {
        "prism": prism,
        "piece": piece,
        "from_m": between(along_m, shares[:, 0]),
        "to_m": between(along_m, shares[:, 1]),
        "x_m": x_m,
        "y_m": y_m,
        "z_m": between(pieces.z_m[piece], shares[:, 0]),
        "gap_m": gap_m,
        "apart_m": shapely.distance(shared[is_met], prisms.polygons[prism]),
    }
    return pd.DataFrame(rows).sort_values(["from_m", "to_m"], ignore_index=True)


def _fall_m(
    pieces: Pieces, lines: np.ndarray, outlines: np.ndarray, maps: MetricMaps
) -> np.ndarray:
    """Return ``[N, 2]`` how much lower the ground is at the nearest point of an outline than under a piece."""
    ways = shapely.shortest_line(lines, outlines)
    x_m, y_m = shapely.get_coordinates(ways)[1::2].T
    grid = maps.grid
    at_m = elevation_at(
        x_m - grid.x_min_m, y_m - grid.y_min_m, maps.m("terrain"), grid.resolution_m
    )
    return np.where(shapely.length(ways)[:, None] > 0, pieces.ground_m - at_m[:, None], 0.0)


def _shares_between(z_m: np.ndarray, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` from which share to which heights lie between others; nowhere if the first is the larger."""
    begin_m, rise_m = z_m[:, 0], z_m[:, 1] - z_m[:, 0]
    with np.errstate(all="ignore"):
        cuts = np.stack([(low_m - begin_m) / rise_m, (high_m - begin_m) / rise_m])
    is_level = rise_m == 0
    is_between = (low_m <= begin_m) & (begin_m <= high_m)
    first = np.where(is_level, np.where(is_between, 0.0, 2.0), np.maximum(cuts.min(axis=0), 0.0))
    last = np.where(is_level, 1.0, np.minimum(cuts.max(axis=0), 1.0))
    return np.stack([first, last], axis=1)


def _shares_of(shared: np.ndarray, ends_m: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` from which share to which of its piece a shape on it reaches, within other shares."""
    moved_m = ends_m[:, 1] - ends_m[:, 0]
    axis = np.argmax(np.abs(moved_m), axis=1)
    each = np.arange(len(axis))
    bounds_m = shapely.bounds(shared).reshape(-1, 2, 2)[each, :, axis]
    along_m, begin_m = moved_m[each, axis], ends_m[each, 0, axis]
    with np.errstate(all="ignore"):
        reached = np.sort((bounds_m - begin_m[:, None]) / along_m[:, None], axis=1)
    is_upright = along_m == 0
    reached[is_upright] = shares[is_upright]
    return np.clip(reached, shares[:, :1], shares[:, 1:])


def merged(rows: pd.DataFrame, key: str | None = None) -> pd.DataFrame:
    """Return rows of `contacts` that touch along the mission as one: its begin, its end, its least gap and distance.

    Args:
      rows: in the order of travel.
      key: a column; only rows of one value are joined.
    """
    of = np.zeros(len(rows)) if key is None else rows[key].to_numpy()
    rows = rows.assign(of=of).sort_values(["of", "from_m"], kind="stable", ignore_index=True)
    reach_m = rows.groupby("of")["to_m"].cummax().shift()
    is_new = (rows["of"] != rows["of"].shift()) | (rows["from_m"] > reach_m + TOUCH_M)
    how = dict.fromkeys(rows.columns.drop("of"), "first")
    how |= {"to_m": "max", "gap_m": "min", "apart_m": "min", "short_m": "max"}
    how = {name: each for name, each in how.items() if name in rows}
    groups = rows.groupby(is_new.cumsum())
    return groups.agg(how).sort_values("from_m", ignore_index=True)


def union_m(rows: pd.DataFrame) -> float:
    """Return the length that begins and ends along a mission cover, each metre once."""
    each = merged(rows[["from_m", "to_m"]])
    return float((each["to_m"] - each["from_m"]).sum())
