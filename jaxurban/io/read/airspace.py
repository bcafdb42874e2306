"""No-fly zones: polygons with a floor and a ceiling, from GeoJSON, KML and other vector files."""

import hashlib
import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyproj
import shapely

from jaxurban.errors import IgnoredZoneWarning, InputError, finite
from jaxurban.io.read.heights import is_blank
from jaxurban.io.read.outlines import polygonal
from jaxurban.io.read.vector import open_layers
from jaxurban.world.grid import Grid, transformer

# Properties that are read, in any case and with or without "_", "-", " " and ":". All are metres above ground.
FLOOR_NAMES = ("floor_m", "floor_m_agl", "lower_limit_m", "min_altitude_m", "minimumAltitude", "minAltitude")
CEILING_NAMES = ("ceiling_m", "ceiling_m_agl", "upper_limit_m", "max_altitude_m", "maximumAltitude", "maxAltitude")
NAME_NAMES = ("name", "title", "designator", "identifier", "id")
HEIGHT_WORDS = ("floor", "ceiling", "lower", "upper", "altitude", "height")
KML_PROPERTIES = ("altitudemode", "extrude")  # what GDAL calls these tags
# Properties that tell the unit or the zero of heights, by plain name: "uomDimensions", "lowerVerticalReference" ...
UNIT_NAME = re.compile(r"^(uom|units?)|(uom|units?|datum)$|(vertical|altitude|height|limit|lower|upper).*ref")
UNITS_READ = ("m", "metre", "metres", "meter", "meters", "agl", "sfc", "gnd", "ground", "surface", "abovegroundlevel")
ON_THE_GROUND = "relativetoground"
MAX_EDGE_M = 100.0  # longer edges are cut before they are projected: at latitude 60 they then bend less than 1 mm
METRES_PER_DEGREE = 111_320.0
BLOCK = 16  # cells a side that are looked at at once
ROLE = "no-fly"
Facts = Mapping[str, tuple[str, Any]]  # a feature's filled properties: plain name -> name in the file, and value


@dataclass(frozen=True)
class Zone:
    """A place where no flight may go, from a floor to a ceiling, both included.

    Attributes:
      name: for messages.
      polygon: a valid shapely Polygon or MultiPolygon in ``crs``; its border belongs to it.
      crs: any CRS that pyproj knows; edges are straight in it.
      floor_m, ceiling_m: metres above ground; left out, every altitude.
      source: the file it was read from.

    Raises:
      InputError: no polygon or one without area, or a floor above the ceiling or not a number.
    """

    name: str
    polygon: shapely.Geometry
    crs: str = "EPSG:4326"
    floor_m: float = -np.inf
    ceiling_m: float = np.inf
    source: str = ""

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
        """What stands for the outline and its CRS: a hash that differs where they do."""
        return hashlib.sha256(f"{self.crs} {shapely.to_wkb(self.polygon, hex=True)}".encode()).hexdigest()[:16]

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

    def on(self, grid: Grid) -> shapely.Geometry:
        """Return the part of the zone near a grid, in the grid's CRS; empty where it is elsewhere."""
        to_file = transformer(grid.crs, self.crs)
        west, south, east, north = to_file.transform_bounds(*grid.bounds_m, densify_pts=21)
        margin = 0.01 * (east - west + north - south)
        polygon = self.polygon
        if west < east:  # else the grid lies across the antimeridian, and nothing is cut away
            box = shapely.box(west - margin, south - margin, east + margin, north + margin)
            polygon = polygonal(shapely.intersection(polygon, box))
        edge = MAX_EDGE_M / _metres_per_unit(self.crs)
        project = transformer(self.crs, grid.crs)
        moved = shapely.transform(shapely.segmentize(polygon, edge), project.transform, interleaved=False)
        return moved if moved.is_valid else mended(moved)


def read_zones(path: str | Path) -> tuple[Zone, ...]:
    """Return the no-fly zones of a vector file: GeoJSON, KML, GeoPackage, Shapefile and whatever GDAL reads.

    Every layer (every folder of a KML file) is read; features that are not polygons are left out with a warning.
    Floor and ceiling are the properties named in `FLOOR_NAMES` and `CEILING_NAMES`, metres above ground; where
    several are filled, the lowest floor and the highest ceiling count, and where all are empty, the zone has none.
    Other properties that sound like heights are ignored with a warning, and so are all heights of a zone one of
    whose properties tells another unit or another zero than the ground. In KML, an extruded polygon
    ``relativeToGround`` reaches from the ground to its highest corner, if every corner is above 0; any other
    ``altitudeMode`` closes all altitudes. Outlines that cross themselves are mended so that all they enclose
    is closed.

    Raises:
      InputError: a file that is missing, cannot be read, has no CRS or no polygon, a polygon without area, or
        a floor or ceiling that is not a number, or the wrong way round.
    """
    if Path(path).is_dir():
        raise InputError(f"{str(path)!r} is a folder: name each file of no-fly zones in it")
    file = Path(path).name
    zones: list[Zone] = []
    num_others = 0
    for frame in open_layers(path, ROLE):
        num_others += sum(not _is_all_area(shape) for shape in frame.geometry)
        areas = frame[shapely.get_dimensions(frame.geometry.to_numpy()) == 2]  # -1 where there is none
        crs = areas.crs.to_wkt()
        properties = areas.drop(columns=areas.geometry.name)
        _tell_ignored(properties, file)
        for shape, row in zip(areas.geometry, properties.to_dict("records"), strict=True):
            facts = {_plain(name): (str(name), value) for name, value in row.items() if not is_blank(value)}
            names = [str(facts[name][1]).strip() for name in NAME_NAMES if name in facts]
            name = next(iter(names), f"polygon {len(zones) + 1}")
            label = f"{name!r} of {file!r}"
            if not np.isfinite(shapely.get_coordinates(shape)).all():
                raise InputError(f"the no-fly zone {label} has a corner that is not a number: mend the file")
            zones.append(Zone(name, _valid(shape, label), crs, *_heights(facts, shape, label), file))
    if not zones:
        raise InputError(f"the {ROLE} file {str(path)!r} holds no polygons: give a file of polygons")
    if num_others:
        _warn(f"{num_others} feature(s) of {file!r} are not polygons and close nothing: draw them as polygons")
    return tuple(zones)


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


def _is_all_area(shape: shapely.Geometry | None) -> bool:
    return shape is not None and bool(np.all(shapely.get_dimensions(shapely.get_parts(shape)) == 2))


def _valid(shape: shapely.Geometry, label: str) -> shapely.Geometry:
    shape = shapely.force_2d(shape)
    if shape.is_valid and shape.geom_type in ("Polygon", "MultiPolygon"):
        return shape
    whole = mended(shape)
    if not shape.is_valid and not whole.is_empty:
        _warn(f"the outline of {label} crosses itself: all that it encloses is closed")
    return whole


def _metres_per_unit(crs: str) -> float:
    parsed = pyproj.CRS.from_user_input(crs)
    return METRES_PER_DEGREE if parsed.is_geographic else parsed.axis_info[0].unit_conversion_factor


def _plain(name: object) -> str:
    """Return a property's name without case and separators."""
    return re.sub(r"[_\-\s:.]", "", str(name)).lower()


def _heights(facts: Facts, shape: shapely.Geometry, label: str) -> tuple[float, float]:
    """Return floor and ceiling of a polygon, infinite where it has none."""
    floors, ceilings = (
        [
            finite(f"{name} of the no-fly zone {label}", value, "metres above ground")
            for name, value in (facts[key] for key in map(_plain, wanted) if key in facts)
        ]
        for wanted in (FLOOR_NAMES, CEILING_NAMES)
    )
    if strange := (floors or ceilings) and _strange_unit(facts):
        _warn(f"{label} has heights in {strange!r}, so it is closed at all altitudes: give metres above ground")
        floors = ceilings = []
    elif not floors and not ceilings:
        ceilings = _extruded(facts, shape, label)
    return min(floors, default=-np.inf), max(ceilings, default=np.inf)


def _tell_ignored(properties: pd.DataFrame, file: str) -> None:
    """Warn of filled properties that sound like heights and are not read."""
    read = {*map(_plain, FLOOR_NAMES), *map(_plain, CEILING_NAMES), *KML_PROPERTIES}
    ignored = [
        str(column)
        for column in properties
        if (name := _plain(column)) not in read
        and not UNIT_NAME.search(name)
        and any(word in name for word in HEIGHT_WORDS)
        and not all(map(is_blank, properties[column]))
    ]
    if ignored:
        _warn(
            f"{', '.join(map(repr, ignored))} of {file!r} not read: floors and ceilings are {', '.join(FLOOR_NAMES)} "
            f"and {', '.join(CEILING_NAMES)}, metres above ground, and a zone without is closed at all altitudes"
        )


def _strange_unit(facts: Facts) -> str:
    """Return what a property says of units or zero levels other than metres and the ground, else ""."""
    said = (str(value) for name, (_, value) in facts.items() if UNIT_NAME.search(name))
    return next((text for text in said if _plain(text) not in UNITS_READ), "")


def _extruded(facts: Facts, shape: shapely.Geometry, label: str) -> list[float]:
    """Return the ceiling of a KML prism that stands on the ground, if the polygon is one."""
    corners_m = shapely.get_coordinates(shape, include_z=True)[:, 2]
    if not np.any(corners_m > 0) or "altitudemode" not in facts:  # not KML, or clamped to the ground
        return []
    is_extruded = "extrude" in facts and facts["extrude"][1] == 1
    if _plain(facts["altitudemode"][1]) == ON_THE_GROUND and is_extruded and np.all(corners_m > 0):
        return [float(corners_m.max())]
    _warn(
        f"{label} is closed at all altitudes: of KML's heights only those of polygons that are extruded "
        "and relativeToGround are read"
    )
    return []


def _warn(sentence: str) -> None:
    warnings.warn(sentence, IgnoredZoneWarning, stacklevel=3)
