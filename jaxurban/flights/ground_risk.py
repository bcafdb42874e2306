"""People beneath a flight's corridor, as an assessment of ground risk asks for them; no class is computed."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pandas as pd
import shapely
from shapely.ops import substring

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError
from jaxurban.flights.corridor import Cells, cell_means, cells_within
from jaxurban.knowledge import OF_PEOPLE, Caution, caution_of_guesses, percent
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.paths.lines import line_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.route_report import DENSITY, GRIDS_M, OverflownDensity
from jaxurban.settings import not_negative

# A cell of which at least this share is known counts as wholly known, whatever rounding does.
WHOLE = 1 - 1e-9
GATHERINGS = "Gatherings are yours to name: no map holds them."
RESIDENTS = "By night these are residents by the census, not people outdoors."


@typed
def overflown_density(
    maps: MapsLike,
    path: PlannedPath | np.ndarray,
    *,
    half_width_m: float,
    contingency_m: float = 0.0,
    buffer_m: float | None = None,
    cell_m: float = 200.0,
    time_of_day: str | None = None,
    num_segments: int = 10,
) -> OverflownDensity:
    """Return the largest mean density of people over the cells of a grid that a flight's corridor touches.

    The corridor is all that is within ``half_width_m + contingency_m + buffer_m`` of the route. The grid's cells begin
    at multiples of ``cell_m`` in the maps' CRS. A cell's density is the mean of the maps' density over its area, as far
    as it is known: what lies beyond the maps or without data is never counted as empty, but named
    (``known_share``). It is what an assessment of ground risk such as SORA asks of a map; its classes are not computed.

    Args:
      maps: that hold a density, or their folder.
      path: from `plan`; or a line, ``[N, 2]`` easting, northing in the maps' CRS, or ``[N, 3]`` with the height above
        ground too.
      half_width_m: width of the volume that is flown in, to each side of the route.
      contingency_m: width of the contingency volume around it.
      buffer_m: width of the ground risk buffer around both; left out, the greatest height of the flight (1:1), which
        is a hint and no rule for your aircraft.
      cell_m: side of a grid's cells; the sides of `GRIDS_M` are taken too.
      time_of_day: a time of day of the maps; left out, all of them.
      num_segments: into how many parts of equal length the route is cut.

    Returns:
      `OverflownDensity`.

    Raises:
      InputError: maps without a density, none known in the corridor, an invalid path or in another CRS, a line
        without heights and no ``buffer_m``, or lengths that cannot be.

    Examples:
      >>> density = ju.overflown_density(maps, path, half_width_m=20.0, contingency_m=30.0, buffer_m=60.0)
      >>> density.largest.groupby("cell_m")["density_per_km2"].max().round(-2)
      cell_m
      100.0    ...
    """
    maps = as_maps(maps)
    if "density" not in maps.ds:
        raise InputError(
            "these maps hold no density of people: make them with [population] blocks, of a census or a raster"
        )

    # The route and its corridor.
    xy_m, top_m = _line_of(path, maps)
    if buffer_m is None:
        buffer_m = top_m
    if buffer_m is None:
        raise InputError(
            "buffer_m must be given for a line without heights: give it, or [N, 3] with the height above ground"
        )
    settings = {
        "half_width_m": positive("half_width_m", half_width_m),
        "contingency_m": not_negative("contingency_m", contingency_m),
        "buffer_m": not_negative("buffer_m", buffer_m),
        "cell_m": positive("cell_m", cell_m),
    }
    reach_m = half_width_m + contingency_m + buffer_m
    line = line_of(xy_m)
    num_segments = at_least("num_segments", num_segments, 1)

    # The cells that the corridor touches, on each grid; on that of `cell_m` also which of them each segment touches.
    cells_by_side = {
        side_m: cells_within(line, reach_m, side_m, maps.grid)
        for side_m in sorted({*GRIDS_M, cell_m})
    }
    ends_m = np.linspace(0.0, line.length, (num_segments if line.length else 1) + 1)
    segments = []
    for from_m, to_m in pairwise(ends_m):
        is_near = shapely.dwithin(
            cells_by_side[cell_m].boxes, substring(line, from_m, to_m), reach_m
        )
        segments.append((from_m, to_m, is_near))

    # The largest mean on each grid at each time of day, and on the grid of `cell_m` also that of each segment.
    rows, segment_rows = [], []
    times_of_day = maps.times_of_day if time_of_day is None else (time_of_day,)
    for name in times_of_day:
        density = maps.m("density", time_of_day=name)
        for side_m, cells in cells_by_side.items():
            means, share = cell_means(density, maps.grid, cells)
            is_any = np.ones(len(means), bool)
            row = {"cell_m": side_m, "time_of_day": name}
            rows.append(row | _largest(line, cells, means, share, is_any))
            if side_m != cell_m:
                continue
            for number, (from_m, to_m, is_near) in enumerate(segments, start=1):
                row = {"segment": number, "from_m": from_m, "to_m": to_m, "time_of_day": name}
                segment_rows.append(row | _largest(line, cells, means, share, is_near))

    # Without any density in the corridor there is nothing to report.
    largest = pd.DataFrame(rows)
    on_grid = largest[largest["cell_m"] == cell_m]
    if on_grid[DENSITY].isna().all():
        raise InputError(
            "no density of people is known in the corridor of the path: give maps that cover it, with [population] "
            "blocks there"
        )
    return OverflownDensity(
        largest=largest,
        segments=pd.DataFrame(segment_rows).set_index("segment"),
        settings=settings,
        source=maps.attribution,
        cautions=list(_cautions(maps, on_grid)),
    )


def _line_of(path: PlannedPath | np.ndarray, maps: MetricMaps) -> tuple[np.ndarray, float | None]:
    """Return a route's points ``[N, 2]``, metres in the maps' CRS, and its greatest height above ground in metres.

    The height is None if it is not known.

    Args:
      path: from `plan`, or points ``[N, 3]`` with heights above ground, or points ``[N, 2]`` without heights.
      maps: the maps in whose CRS the route must be.

    Raises:
      InputError: there is no path, it is in another CRS, or the points are no such array of finite numbers.
    """
    if isinstance(path, PlannedPath):
        if not path.status.has_path:
            raise InputError(f"there is no path over people: {path.status.sentence}")
        if path.crs != maps.grid.crs:
            raise InputError(
                f"the path is in {path.crs} and these maps in {maps.grid.crs}: give its own maps"
            )
        return path.xy_m, float(path.z_m.max())
    points = np.asarray(path, float)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or not points.size:
        raise InputError(
            f"path must be points [N, 2] or [N, 3] in metres, got an array of shape {points.shape}"
        )
    if not np.isfinite(points).all():
        raise InputError("path must be finite numbers of metres: leave out points without a place")
    top_m = float(points[:, 2].max()) if points.shape[1] == 3 else None
    return points[:, :2], top_m


def _largest(
    line: shapely.LineString,
    cells: Cells,
    means: np.ndarray,
    share: np.ndarray,
    is_near: np.ndarray,
) -> dict[str, float]:
    """Return the largest mean density of some cells, where it lies, and how many of these cells are known.

    The columns are those of `OverflownDensity.largest` from ``density_per_km2`` on. Where no near cell is known, the
    mean, its place and its known share are NaN.

    Args:
      line: the route.
      cells: the ``C`` cells of a grid.
      means: ``[C]`` mean density of each cell; NaN where nothing is known.
      share: ``[C]`` share of each cell's area over which the density is known.
      is_near: ``[C]`` whether the cell counts.
    """
    # Cells that do not count or are not known are never the largest.
    worst = np.argmax(np.where(is_near & np.isfinite(means), means, -np.inf))
    middle = shapely.centroid(cells.boxes[worst])
    lon, lat = cells.grid.lonlat_of_xy(middle.x, middle.y)
    place = {
        DENSITY: means[worst],
        "lon": float(lon),
        "lat": float(lat),
        "along_m": shapely.line_locate_point(line, middle),
        "known_share": share[worst],
    }
    near_share = share[is_near]
    if not near_share.any():  # no cell that counts is known, and `worst` says nothing
        place = dict.fromkeys(place, np.nan)
    return {
        **place,
        "num_cells": len(near_share),
        "num_partly_known": ((near_share > 0) & (near_share < WHOLE)).sum(),
        "num_unknown": (near_share == 0).sum(),
    }


def _cautions(maps: MetricMaps, rows: pd.DataFrame) -> Iterator[Caution]:
    """Yield cautions on densities: what is guessed, what is unknown, which people they count and which they do not.

    Args:
      maps: the maps that hold the densities.
      rows: of `OverflownDensity.largest`, one for each time of day, on one grid.
    """
    guesses = (guess for guess in maps.guesses if guess.kind in OF_PEOPLE)
    yield from caution_of_guesses(guesses)
    num_beyond = rows["num_unknown"] + rows["num_partly_known"]
    worst = rows.iloc[num_beyond.argmax()]
    if num_beyond.max():
        yield Caution(
            f"People: {num_beyond.max()} of {worst['num_cells']} cells reach beyond what is known, "
            f"{worst['num_unknown']} of them wholly; of the densest {percent(worst['known_share'])} is known, and its "
            "mean is of that part alone.",
            "guess",
        )
    if "night" in set(rows["time_of_day"]):
        yield Caution(RESIDENTS)
    yield Caution(GATHERINGS)
