"""People beneath a flight's corridor, as an assessment of ground risk asks for them; no class is computed."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import shapely
from shapely.ops import substring

from jaxurban.checks import at_least, positive, typed
from jaxurban.errors import InputError
from jaxurban.io.read.guesses import is_of_people, percent
from jaxurban.io.tables import records_of
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.paths.corridor import Cells, cell_means, cells_within
from jaxurban.paths.lines import line_of
from jaxurban.paths.path import PlannedPath
from jaxurban.public import Caution, FactsRepr, caution_of_guesses
from jaxurban.settings import not_negative

GRIDS_M = (100.0, 200.0, 500.0)  # printed always: they disagree where towers stand
WHOLE = 1 - 1e-9  # of a cell, but for rounding
GATHERINGS = "Gatherings are yours to name: no map holds them."
RESIDENTS = "By night these are residents by the census, not people outdoors."
DENSITY = "density_per_km2"


@dataclass(frozen=True, eq=False, repr=False)
class OverflownDensity(FactsRepr):
    """The largest mean density of people over the cells that a flight's corridor touches. No class is computed.

    Attributes:
      largest: a row a grid and time of day: ``cell_m``, ``time_of_day``, ``density_per_km2`` (people per km2, the
        largest mean over a cell), that cell's middle (``lon``, ``lat``), ``along_m`` (the place of the route nearest to
        it, metres from the start), ``known_share`` (of its area), all NaN where nothing is known; ``num_cells`` that
        the corridor touches, and of these ``num_partly_known`` and ``num_unknown``.
      segments: the same on the grid of ``cell_m`` for each of a few parts of equal length, ``from_m`` to ``to_m``.
      settings: ``half_width_m``, ``contingency_m``, ``buffer_m`` and ``cell_m``.
      source: whom to credit for the people, and all else in the maps.
      cautions: what to know of the numbers.
      detours: of `density_detours`, where they were planned.

    Examples:
      >>> density = ju.overflown_density(maps, path, half_width_m=20.0, contingency_m=30.0)
      >>> density.facts["corridor"]
      '110 m to each side: half-width 20 m, contingency 30 m, ground risk buffer 60 m'
      >>> bool(density.segments["density_per_km2"].max() == density.density_per_km2)
      True
    """

    largest: pd.DataFrame
    segments: pd.DataFrame
    settings: Mapping[str, float]
    source: str
    cautions: list[Caution]
    detours: pd.DataFrame | None = None

    @property
    def reach_m(self) -> float:
        """From the route to the edge of the corridor."""
        return sum(self.settings[name] for name in ("half_width_m", "contingency_m", "buffer_m"))

    @property
    def density_per_km2(self) -> float:
        """The largest mean over a cell of ``cell_m``, at the time of day when it is largest."""
        return float(self._worst(self.settings["cell_m"])[DENSITY])

    def _worst(self, cell_m: float) -> pd.Series:
        """Return the row of ``largest``, of all times of day, with the largest density on the grid of ``cell_m``."""
        rows = self.largest[self.largest["cell_m"] == cell_m]
        return rows.iloc[rows[DENSITY].fillna(-1.0).argmax()]

    @property
    def facts(self) -> dict[str, str]:
        """The density, where it is, that of the other grids, the corridor and the source."""
        settings = self.settings
        cell_m = settings["cell_m"]
        worst = self._worst(cell_m)
        density = f"{worst[DENSITY]:,.0f} people per km2 over a cell of {cell_m:g} m"
        if worst["time_of_day"]:
            density += f" ({worst['time_of_day']})"
        others = [self._worst(side_m) for side_m in GRIDS_M if side_m != cell_m]
        other_densities = [f"{row[DENSITY]:,.0f} over {row['cell_m']:g} m" for row in others]
        return {
            "largest density": density,
            "where": f"{worst['lon']:.5f}, {worst['lat']:.5f} (lon, lat), {worst['along_m']:.0f} m along the route",
            "other grids": ", ".join(other_densities),
            "corridor": f"{self.reach_m:g} m to each side: half-width {settings['half_width_m']:g} m, contingency "
            f"{settings['contingency_m']:g} m, ground risk buffer {settings['buffer_m']:g} m",
            "detours": self._detours(),
            "source": self.source,
        }

    def _detours(self) -> str:
        """Return density and extra length of each detour in words; empty where none were planned."""
        if self.detours is None:
            return ""
        rows = self.detours.to_dict("records")
        detours = [f"{row[DENSITY]:,.0f} on {row['extra_m']:+,.0f} m" for row in rows]
        return ", or ".join(detours) or "no route between these ends is less dense"

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain, JSON-ready values.

        Returns:
          A dictionary of the settings, ``density_per_km2``, ``source``, ``cautions`` (texts), and the rows of
          ``largest`` and ``segments``.

        Examples:
          >>> record = ju.overflown_density(maps, path, half_width_m=20.0).to_dict()
          >>> record["buffer_m"], [row["cell_m"] for row in record["largest"][:3]]
          (60.0, [100.0, 200.0, 500.0])
        """
        return {
            **self.settings,
            DENSITY: self.density_per_km2,
            "source": self.source,
            "cautions": self.cautions,
            "largest": records_of(self.largest),
            "segments": records_of(self.segments.reset_index()),
            "detours": None if self.detours is None else records_of(self.detours),
        }

    def table(self) -> str:
        """Return the report for a terminal: facts, cautions, and the segments, a column for each time of day.

        Returns:
          Text of a line for each fact and caution, and after an empty line one for each segment.

        Examples:
          >>> print(ju.overflown_density(maps, path, half_width_m=20.0).table())
          largest density ... people per km2 over a cell of 200 m (day)
          ...
        """
        lines = [f"{name:<24}{fact}" for name, fact in self.facts.items() if fact]
        text = "\n".join([*lines, *self.cautions])
        times_of_day = self.segments["time_of_day"].unique()  # in their order
        density = self.segments.set_index(["to_m", "time_of_day"], append=True)[DENSITY].unstack()
        density = density[times_of_day].add_prefix("per km2, ")
        density = density.reset_index("to_m").rename_axis(columns=None)
        return f"{text}\n\n{density.to_string(float_format='{:,.0f}'.format)}"


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
      half_width_m: of the volume that is flown in, to each side of the route.
      contingency_m: of the volume around it.
      buffer_m: of the ground risk buffer around that; left out, the greatest height of the flight (1:1). This is a
        hint, and no rule for your aircraft.
      cell_m: side of a cell, beside those of `GRIDS_M`.
      time_of_day: of the maps; left out, each of them.
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
    ends_m = np.linspace(0.0, line.length, at_least("num_segments", num_segments, 1) + 1)
    parts = [line]
    if line.length:
        parts = [substring(line, from_m, to_m) for from_m, to_m in pairwise(ends_m)]

    # The cells that it touches, on each grid; on that of `cell_m` also those of each segment.
    cells_by_side = {
        side_m: cells_within(line, reach_m, side_m, maps.grid)
        for side_m in sorted({*GRIDS_M, cell_m})
    }
    boxes = cells_by_side[cell_m].boxes
    near_parts = [shapely.dwithin(boxes, part, reach_m) for part in parts]  # of each segment, [C]

    # The largest mean on each grid, and of each segment on that of `cell_m`, at each time of day.
    rows, segment_rows = [], []
    times_of_day = maps.times_of_day if time_of_day is None else (time_of_day,)
    for name in times_of_day:
        density = maps.m("density", time_of_day=name)
        for side_m, cells in cells_by_side.items():
            means, share = cell_means(density, maps.grid, cells)
            is_any = np.ones(len(means), bool)
            largest_on_grid = _largest(line, cells, means, share, is_any)
            rows.append({"cell_m": side_m, "time_of_day": name, **largest_on_grid})
            if side_m != cell_m:
                continue
            for number, is_near in enumerate(near_parts, start=1):
                from_m, to_m = ends_m[number - 1 : number + 1]
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

    Args:
      path: from `plan`, or points ``[N, 2]``, whose height is not known (None), or ``[N, 3]`` with heights.
      maps: in whose CRS the route must be.

    Raises:
      InputError: there is no path, it is in another CRS, or points that are no such array of finite numbers.
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
    """Return the largest mean of the cells that are near, where it lies, and how many of these cells are known.

    The columns are those of `OverflownDensity.largest` from ``density_per_km2`` on. Where no near cell is known, the
    mean, its place and its known share are NaN.

    Args:
      line: the route.
      cells: ``C`` of them.
      means: ``[C]`` their densities, NaN where nothing is known.
      share: ``[C]`` which share of each is known.
      is_near: ``[C]`` which of them count.
    """
    worst = np.argmax(np.where(is_near & np.isfinite(means), means, -1.0))
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
    if not near_share.any():  # no cell is known, so that `worst` is just the first one
        place = dict.fromkeys(place, np.nan)
    return {
        **place,
        "num_cells": len(near_share),
        "num_partly_known": ((near_share > 0) & (near_share < WHOLE)).sum(),
        "num_unknown": (near_share == 0).sum(),
    }


def _cautions(maps: MetricMaps, rows: pd.DataFrame) -> Iterator[Caution]:
    """Yield what to know of densities: guesses on people, what is unknown, whom they count and whom not.

    Args:
      maps: that hold the densities.
      rows: of `OverflownDensity.largest`, one for each time of day, on one grid.
    """
    guesses = {name: guess for name, guess in maps.guesses.items() if is_of_people(name)}
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
