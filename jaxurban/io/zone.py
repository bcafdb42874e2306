"""No-fly zones: polygons with a floor, a ceiling and times, and the cells that they touch.

What a file of zones holds is closed, open by its own limits, or unknown, and is a `Zone` in each case.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Literal

import numpy as np
import shapely
from shapely import affinity

from jaxurban.errors import IgnoredZoneWarning, InputError, warn
from jaxurban.knowledge import Caution
from jaxurban.public import listed
from jaxurban.world.extent import polygonal
from jaxurban.world.grid import WGS84, Grid, known_crs, transformer

MAX_EDGE_M = 100.0  # longer edges are cut before they are projected: at latitude 60 they then bend less than 1 mm
METRES_PER_DEGREE = 111_320.0
FLIGHT = timedelta(hours=1)  # from the time that is planned for: a zone in force by then is closed
TURN = 360.0  # degrees of longitude
ZoneState = Literal["closed", "open", "unknown"]


@dataclass(frozen=True)
class Zone:
    """A place where no flight may go, from a floor to a ceiling, both included, or what a file holds in its place.

    Attributes:
      name: for messages.
      polygon: a valid shapely Polygon or MultiPolygon in ``crs``; its border belongs to it. Of a zone that is not
        closed any shape that shows where it lies, empty where that is not known.
      crs: any CRS that pyproj knows; edges are straight in it.
      floor_m, ceiling_m: metres above ground; left out, every altitude.
      source: the file it was read from.
      start, end: times with their offsets between which it is in force, both included; None without one.
      state: ``"closed"``; ``"open"``, by its own limits; or ``"unknown"``: what it closes is not read.
      remarks: why it is not closed, or is closed otherwise than its file may mean: keys of `airspace.REMARKS`,
        ``"other_limits"`` of properties that are not read, or ``"not_in_force"`` at the time of a flight.

    Raises:
      InputError: a closed one that is no polygon or has no area, a floor above the ceiling or not a number, a ceiling
        that is not above the ground.
    """

    name: str
    polygon: shapely.Geometry
    crs: str = "EPSG:4326"
    floor_m: float = -np.inf
    ceiling_m: float = np.inf
    source: str = ""
    start: datetime | None = None
    end: datetime | None = None
    state: ZoneState = "closed"
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the attributes; InputError as of the class."""
        is_closed = self.state == "closed"
        is_area = isinstance(self.polygon, (shapely.Polygon, shapely.MultiPolygon))
        if is_closed and (self.polygon.is_empty or not is_area):
            raise InputError(
                f"the no-fly zone {self.label} has no area: draw it as a polygon of three or more corners"
            )
        if is_closed and not self.polygon.is_valid:
            raise InputError(
                f"the outline of the no-fly zone {self.label} crosses itself: see shapely.make_valid"
            )
        if not (self.floor_m <= self.ceiling_m and self.ceiling_m > 0):
            raise InputError(
                f"the no-fly zone {self.label} has floor {self.floor_m:g} m and ceiling {self.ceiling_m:g} m: give two "
                "numbers of metres above ground, the floor not above the ceiling, the ceiling above 0"
            )

    @property
    def outline(self) -> str:
        """16 hexadecimal digits that stand for the outline, its CRS and its times, and differ where these do."""
        when = f" {self.start} {self.end}" if self.start or self.end else ""
        return hashlib.sha256(
            f"{self.crs} {shapely.to_wkb(self.polygon, hex=True)}{when}".encode()
        ).hexdigest()[:16]

    @property
    def label(self) -> str:
        """Name and file."""
        return f"{self.name!r}" + (f" of {self.source!r}" if self.source else "")

    @property
    def heights(self) -> str:
        """Floor and ceiling, for messages."""
        low = "the ground" if np.isinf(self.floor_m) else f"{self.floor_m:g} m"
        return f"from {low} " + ("up" if np.isinf(self.ceiling_m) else f"to {self.ceiling_m:g} m")

    def heights_past(self, most_m: float) -> str:
        """Floor and ceiling, and at which heights above the ground it is open, up to ``most_m`` (0: without that)."""
        ways = {
            f"below {self.floor_m:g} m": self.floor_m > 0,
            f"above {self.ceiling_m:g} m": self.ceiling_m < most_m,
        }
        past = " or ".join(way for way, is_open in ways.items() if is_open)
        if past:
            return f"{self.heights}, open {past}"
        return self.heights + f", closed at all heights up to {most_m:g} m" * (most_m > 0)

    @property
    def place(self) -> list[float]:
        """Longitude and latitude in degrees of its first corner, or point; empty where its shape has none."""
        corner = shapely.get_coordinates(self.polygon)[:1]
        return np.ravel(transformer(self.crs, WGS84).transform(*corner.T)).tolist()

    def at(self, times: Sequence[datetime]) -> "Zone":
        """Return the zone, open if it is in force at none of several times; without times itself."""
        if not times or any(map(self.is_in_force, times)):
            return self
        return replace(self, state="open", remarks=("not_in_force", *self.remarks))

    def is_in_force(self, time: datetime) -> bool:
        """Return whether the zone is in force at a time (with its offset) or within `FLIGHT` after it."""
        return (self.end is None or time <= self.end) and (
            self.start is None or self.start - time <= FLIGHT
        )

    def on(self, grid: Grid) -> shapely.Geometry:
        """Return what the zone closes near a grid, valid polygons in the grid's CRS; empty where it closes nothing."""
        if self.state != "closed":
            return shapely.Polygon()
        part = self.part_on(grid)
        return polygonal(part) if part.is_valid else made_valid(part)

    def part_on(self, grid: Grid) -> shapely.Geometry:
        """Return the part of the zone's shape near a grid, in the grid's CRS; empty where it is elsewhere."""
        # A box around the grid in the zone's CRS, 1 % of its sides wider, and the outline in it.
        to_file = transformer(grid.crs, self.crs)
        west, south, east, north = to_file.transform_bounds(*grid.bounds_m, densify_pts=21)
        east += TURN * (west > east)  # where the grid lies across the antimeridian
        margin = 0.01 * (east - west + north - south)
        box = shapely.box(west - margin, south - margin, east + margin, north + margin)
        # Where the outline or the box reaches across the antimeridian, it is seen a turn on and back too.
        crs = known_crs(self.crs)
        seen = [self.polygon]
        lons = (self.polygon.bounds[0], self.polygon.bounds[2], box.bounds[0], box.bounds[2])
        if crs.is_geographic and max(map(abs, lons)) > TURN / 2:
            seen = [affinity.translate(self.polygon, turn) for turn in (-TURN, 0.0, TURN)]
        part = shapely.union_all(shapely.intersection(seen, box))

        # Edges are straight in the zone's CRS and bend in the grid's, so they are cut before.
        unit_m = METRES_PER_DEGREE if crs.is_geographic else crs.axis_info[0].unit_conversion_factor
        project = transformer(self.crs, grid.crs)
        return shapely.transform(
            shapely.segmentize(part, MAX_EDGE_M / unit_m), project.transform, interleaved=False
        )


def unknown_cautions(zones: Sequence[Zone]) -> list[Caution]:
    """Return a sentence on the zones that are unknown; none where there is no such zone."""
    labels = [zone.label for zone in zones if zone.state == "unknown"]
    sentence = (
        f"{len(labels)} no-fly zone(s) have no area that is read, so what they close is not known ({listed(labels)}): "
        "draw them as polygons, or remove those that close nothing there."
    )
    return [Caution(sentence, "guess", "not judged")] if labels else []


def check_reach(zones: Sequence[Zone], grid: Grid) -> None:
    """Warn where zones are closed and none of them reaches a grid, so that they close nothing there.

    Raises:
      InputError: one of them would reach it with longitude and latitude swapped.
    """
    closed = [zone for zone in zones if zone.state == "closed"]
    if not closed or any(not zone.part_on(grid).is_empty for zone in closed):
        return
    for zone in closed:
        swapped = replace(zone, polygon=shapely.transform(zone.polygon, lambda xy: xy[:, ::-1]))
        if not swapped.part_on(grid).is_empty:
            raise InputError(
                f"longitude and latitude of the no-fly zone {zone.label} look swapped, as it lies in the maps' region "
                "the other way round: give longitude first, or leave the zone out if it does lie elsewhere"
            )
    files = ", ".join(sorted({repr(zone.source) for zone in closed}))
    sentence = (
        f"no zone of {files} lies in the maps' region, so that nothing is closed: check the file"
    )
    warn(sentence, IgnoredZoneWarning)


def touched_cells(polygon: shapely.Geometry, grid: Grid) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells that share at least a point with a polygon in the grid's CRS, borders included.

    Burning leaves out cells that share only a border or a corner: the cells around what it burns are looked at one by
    one (GEOS's robust predicates). It is done on a grid that is wider by a cell on each side, as a polygon beyond the
    grid may touch its border.
    """
    # Imported here: it brings JAX.
    from scipy.ndimage import binary_dilation

    from jaxurban.io.burn import burn

    wider = grid.padded(1, 1, 1, 1)
    closed = burn(np.array([polygon]), np.ones(1), wider, 0, "int32")[1] == 1
    cells = np.argwhere(binary_dilation(closed, np.ones((3, 3))) & ~closed)
    shapely.prepare(polygon)
    closed[tuple(cells.T)] = shapely.intersects(polygon, cell_boxes(wider, cells, 1))
    return closed[1:-1, 1:-1]


def cell_boxes(grid: Grid, corners: np.ndarray, size: int) -> np.ndarray:
    """Return the squares of ``size`` cells a side from southwest cells ``[N, 2]`` (row, column)."""
    south, west = (corners + np.array([grid.first_row, grid.first_col])).T
    return shapely.box(*(np.stack([west, south, west + size, south + size]) * grid.resolution_m))


def made_valid(shape: shapely.Geometry) -> shapely.Geometry:
    """Return the polygons that an outline encloses, all that it goes around twice included."""
    return polygonal(shapely.make_valid(shape, method="structure", keep_collapsed=False))
