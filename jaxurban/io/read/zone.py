"""No-fly zones: polygons with a floor, a ceiling and times, and the cells that they touch."""

import hashlib
import math
import warnings
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import pyproj
import shapely
from shapely import affinity

from jaxurban.errors import IgnoredZoneWarning, InputError
from jaxurban.io.read.outlines import polygonal
from jaxurban.world.grid import Grid, transformer

MAX_EDGE_M = 100.0  # longer edges are cut before they are projected: at latitude 60 they then bend less than 1 mm
METRES_PER_DEGREE = 111_320.0
BLOCK = 16  # cells a side that are looked at at once
FLIGHT = timedelta(hours=1)  # from the time that is planned for: a zone in force by then is closed
DAY = timedelta(days=1)
ROUND = 360.0  # degrees of longitude
MOST_NAMED = 3
Told = dict[str, list[str]]  # what must be said of zones, a sentence each, with the names that it is true of
CROSSING = "have outlines that cross themselves, and close all that these enclose"
THE_SHORT_WAY = (
    "have edges of more than 180 degrees of longitude, and are closed the short way too, across the antimeridian "
    "(cut them there)"
)


@dataclass(frozen=True)
class Period:
    """When a zone is in force: from one time to another, and within these on some days of the week, at some hours.

    Attributes:
      start, end: times with their offsets, both included; None without one.
      days: of the week in UTC, 0 for Monday; empty for every day.
      daily: beginning and end after midnight UTC (before it where clocks go ahead), both included; one that ends no
        later than it begins ends on the next day. None for the whole day.
    """

    start: datetime | None = None
    end: datetime | None = None
    days: frozenset[int] = frozenset()
    daily: tuple[timedelta, timedelta] | None = None

    def __str__(self) -> str:
        return f"{self.start} {self.end} {sorted(self.days)} {self.daily}"  # one text for one period: it is hashed

    __repr__ = __str__

    def meets(self, begin: datetime, end: datetime) -> bool:
        """Whether the zone is in force at some time from one to another, both included."""
        begin = begin if self.start is None else max(begin, self.start)
        end = end if self.end is None else min(end, self.end)
        if begin > end:
            return False
        from_, to = self.daily or (timedelta(0), DAY)
        to = to if to > from_ else to + DAY
        midnight = begin.astimezone(UTC).replace(hour=0, minute=0, second=0, microsecond=0) - 2 * DAY
        while midnight <= end + DAY:
            if (
                (not self.days or midnight.weekday() in self.days)
                and midnight + from_ <= end
                and begin <= midnight + to
            ):
                return True
            midnight += DAY
        return False


@dataclass(frozen=True)
class Zone:
    """A place where no flight may go, from a floor to a ceiling, both included.

    Attributes:
      name: for messages.
      polygon: a valid shapely Polygon or MultiPolygon in ``crs``; its border belongs to it.
      crs: any CRS that pyproj knows; edges are straight in it.
      floor_m, ceiling_m: metres above ground; left out, every altitude.
      source: the file it was read from.
      periods: when it is in force; none: always.

    Raises:
      InputError: no polygon or one without area, or a floor above the ceiling or not a number.
    """

    name: str
    polygon: shapely.Geometry
    crs: str = "EPSG:4326"
    floor_m: float = -np.inf
    ceiling_m: float = np.inf
    source: str = ""
    periods: tuple[Period, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.polygon, (shapely.Polygon, shapely.MultiPolygon)) or self.polygon.is_empty:
            raise InputError(f"the no-fly zone {self.label} has no area: draw it as a polygon of three or more corners")
        if not self.polygon.is_valid:
            raise InputError(f"the outline of the no-fly zone {self.label} crosses itself: see shapely.make_valid")
        if not self.floor_m <= self.ceiling_m:
            raise InputError(
                f"the no-fly zone {self.label} has floor {self.floor_m:g} m and ceiling {self.ceiling_m:g} m: give two "
                "numbers of metres above ground, the floor not above the ceiling"
            )

    @property
    def outline(self) -> str:
        """What stands for the outline, its CRS and its periods: a hash that differs where they do."""
        when = f" {self.periods}" if self.periods else ""
        return hashlib.sha256(f"{self.crs} {shapely.to_wkb(self.polygon, hex=True)}{when}".encode()).hexdigest()[:16]

    @property
    def label(self) -> str:
        """Name and file."""
        return f"{self.name!r}" + (f" of {self.source!r}" if self.source else "")

    @property
    def heights(self) -> str:
        """Floor and ceiling, for messages."""
        if np.isinf(self.floor_m) and np.isinf(self.ceiling_m):
            return "at all altitudes"
        if np.isinf(self.ceiling_m):
            return f"from {self.floor_m:g} m up"
        return f"up to {self.ceiling_m:g} m" if np.isinf(self.floor_m) else f"{self.floor_m:g} to {self.ceiling_m:g} m"

    def is_in_force(self, time: datetime) -> bool:
        """Whether the zone is in force at a time (with its offset) or within `FLIGHT` after it."""
        try:
            return not self.periods or any(period.meets(time, time + FLIGHT) for period in self.periods)
        except OverflowError:  # beside the first or the last day that has a date
            return True

    def _seen_in(self, box: shapely.Geometry) -> list[shapely.Geometry]:
        """Return the outline, once more a turn on and a turn back where it or a box reaches across the antimeridian."""
        lons = (self.polygon.bounds[0], self.polygon.bounds[2], box.bounds[0], box.bounds[2])
        if max(map(abs, lons)) <= ROUND / 2 or not pyproj.CRS.from_user_input(self.crs).is_geographic:
            return [self.polygon]
        return [affinity.translate(self.polygon, turn) for turn in (-ROUND, 0.0, ROUND)]

    def on(self, grid: Grid) -> shapely.Geometry:
        """Return the part of the zone near a grid, in the grid's CRS; empty where it is elsewhere."""
        to_file = transformer(grid.crs, self.crs)
        west, south, east, north = to_file.transform_bounds(*grid.bounds_m, densify_pts=21)
        east += ROUND * (west > east)  # where the grid lies across the antimeridian
        margin = 0.01 * (east - west + north - south)
        box = shapely.box(west - margin, south - margin, east + margin, north + margin)
        polygon = polygonal(shapely.union_all([shapely.intersection(seen, box) for seen in self._seen_in(box)]))
        edge = MAX_EDGE_M / _metres_per_unit(self.crs)
        project = transformer(self.crs, grid.crs)
        moved = shapely.transform(shapely.segmentize(polygon, edge), project.transform, interleaved=False)
        return moved if moved.is_valid else mended(moved)


def touched_cells(polygon: shapely.Geometry, grid: Grid) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells that share at least a point with a polygon in the grid's CRS, borders included.

    Exact (GEOS's robust predicates). Burning with ``all_touched`` leaves out cells that share only a border or a
    corner. Blocks of cells come first, so that only those on the polygon's border are looked at one by one.
    """
    closed = np.zeros(grid.shape, bool)
    if polygon.is_empty:
        return closed
    shapely.prepare(polygon)
    west, south, east, north = np.array(polygon.bounds) / grid.resolution_m
    near = ((south - grid.first_row, north - grid.first_row), (west - grid.first_col, east - grid.first_col))
    rows, cols = (
        np.arange(max(math.floor(low) // BLOCK - 1, 0), min(math.floor(high) // BLOCK + 2, -(-size // BLOCK))) * BLOCK
        for (low, high), size in zip(near, grid.shape, strict=True)
    )
    blocks = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
    blocks = blocks[shapely.intersects(polygon, cell_boxes(grid, blocks, BLOCK))]
    is_whole = shapely.covers(polygon, cell_boxes(grid, blocks, BLOCK))
    for row, col in blocks[is_whole]:
        closed[row : row + BLOCK, col : col + BLOCK] = True
    within = np.indices((BLOCK, BLOCK)).reshape(2, -1).T
    cells = (blocks[~is_whole][:, None] + within).reshape(-1, 2)
    cells = cells[np.all(cells < grid.shape, axis=1)]
    cells = cells[shapely.intersects(polygon, cell_boxes(grid, cells, 1))]
    closed[cells[:, 0], cells[:, 1]] = True
    return closed


def cell_boxes(grid: Grid, corners: np.ndarray, size: int) -> np.ndarray:
    """Return the squares of ``size`` cells a side from southwest cells ``[N, 2]`` (row, column)."""
    south, west = (corners + np.array([grid.first_row, grid.first_col])).T
    return shapely.box(*(np.stack([west, south, west + size, south + size]) * grid.resolution_m))


def mended(shape: shapely.Geometry) -> shapely.Geometry:
    """Return the polygons that an outline encloses, all that it goes around twice included."""
    return polygonal(shapely.make_valid(shape, method="structure", keep_collapsed=False))


def whole_outline(shape: shapely.Geometry, name: str, told: Told, *, is_lonlat: bool) -> shapely.Geometry:
    """Return valid polygons that close all that the outline of a zone may mean; ``told`` gets what was done."""
    if not shape.is_valid or shape.geom_type not in ("Polygon", "MultiPolygon"):
        polygons = mended(shape)
        if not shape.is_valid and not polygons.is_empty:
            told[CROSSING].append(name)
        shape = polygons
    wider = the_short_way_too(shape) if is_lonlat else shape
    if wider is not shape:
        told[THE_SHORT_WAY].append(name)
    return wider


def the_short_way_too(shape: shapely.Geometry) -> shapely.Geometry:
    """Return a shape in longitude and latitude, and where edges span more than 180 degrees both ways that they may go.

    A file may mean by 179.9, -179.9 what lies between them across the antimeridian, or all the rest of the way round.
    The shape, which must be valid, comes back as it is where there is no such edge. An edge that goes all the way round
    has but one meaning.
    """
    found = [shape]
    for part in shapely.get_parts(shape):
        lon, lat = shapely.get_coordinates(part.exterior).T
        steps = np.abs(np.diff(lon))
        if np.any((steps > ROUND / 2) & (steps < ROUND)):
            around = np.column_stack([np.unwrap(lon, period=ROUND), lat])
            found.append(mended(shapely.Polygon(around)))  # whole: a hole of a valid outline lies on its longer way
    return shape if len(found) == 1 else polygonal(shapely.union_all(found))


def _metres_per_unit(crs: str) -> float:
    parsed = pyproj.CRS.from_user_input(crs)
    return METRES_PER_DEGREE if parsed.is_geographic else parsed.axis_info[0].unit_conversion_factor


def warn_of(told: Told, file: str) -> None:
    """Warn of zones of a file, a sentence each with the first names."""
    for sentence, names in told.items():
        several = list(dict.fromkeys(names))
        shown = ", ".join(map(repr, several[:MOST_NAMED])) + ", ..." * (len(several) > MOST_NAMED)
        warn(f"zones of {file!r} that {sentence}: {len(several)} ({shown})")


def warn(sentence: str) -> None:
    """Warn of something in a file of zones that is not read, or read more cautiously."""
    warnings.warn(sentence, IgnoredZoneWarning, stacklevel=3)
