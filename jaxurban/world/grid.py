"""Grid: a raster of square cells in one projected CRS, anchored to the CRS's own cell numbers."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import pyproj
import shapely
from numpy.typing import ArrayLike
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info
from pyproj.exceptions import CRSError

from jaxurban.checks import finite, positive, typed
from jaxurban.errors import InputError, shortened
from jaxurban.public import Hints

WGS84 = "EPSG:4326"
MAX_SCALE_ERROR = 0.01  # of a projection at the region: within a UTM zone it stays below 0.001
# Beyond the area that a CRS is made for: some countries use one zone for all, and Norway does UTM 33 to 13 degrees.
MOST_BEYOND_DEG = 15.0
MOST_CELLS = 1e12
MOST_OF_CODE = 60  # characters of a CRS that is a code or short parameters, no definition
MOST_OF_CRS = 20_000  # characters of a definition; the longest of EPSG has 7,000
# By what of a CRS's text PROJ opens a file: but codes of EPSG, grids that are none (@null), and of heights grids that
# are named without a folder, which are looked for among PROJ's own files alone.
OPENS_FILE = re.compile(
    r"""\b(?:init|\w*grids|file|model)\s*=\s*(?!["'@\s]*(?:epsg:\d+|null)(?:[\s"'<]|$))|proj\s*=\s*pipeline|"""
    r"""PROJ4_GRIDS(?![^\])/\\~]{,300}[\])])|"""
    r"""PARAMETERFILE\W++(?!(?:Geoid[^"]{,99}"\s*,\s*"[^"/\\~]{,300}|[^"]{,99}"\s*,\s*"@?null)")""",
    re.IGNORECASE,
)
MAX_SNAP_CELLS = 1000  # of the coarsest resolution that the region may be snapped to
MAX_SIDE = 1024  # cells of a tile's side at most: about 0.2 GiB of work at four altitudes
# x_min, y_min, x_max, y_max in a projected CRS, metres; or west, south, east, north in degrees.
Bounds = tuple[float, float, float, float]


@lru_cache(maxsize=32)
def utm_crs(lon_deg: float, lat_deg: float) -> str:
    """Return the authority code of the WGS 84 / UTM zone that holds a point, as ``"EPSG:32618"`` (cached).

    Raises:
      InputError: no UTM zone covers the point (near the poles).
    """
    infos = query_utm_crs_info(
        datum_name="WGS 84",
        area_of_interest=AreaOfInterest(lon_deg, lat_deg, lon_deg, lat_deg),
    )
    if not infos:
        swapped = ""
        if abs(lon_deg) <= 84:
            swapped = "latitude and longitude look swapped (longitude comes first), else "
        raise InputError(
            f"no UTM zone covers longitude {lon_deg:g}, latitude {lat_deg:g}: {swapped}set [region] crs to a projected "
            "CRS"
        )
    return f"{infos[0].auth_name}:{infos[0].code}"


def utm_of(bounds: Sequence[float]) -> str:
    """Return the UTM zone of the middle of a box, as `utm_crs`.

    Args:
      bounds: west, south, east, north in degrees.

    Raises:
      InputError: no UTM zone covers the middle.
    """
    west, south, east, north = bounds
    return utm_crs((west + east) / 2, (south + north) / 2)


@lru_cache(maxsize=32)
def transformer(source: str, target: str) -> pyproj.Transformer:
    """Return the x, y-ordered transformer between two CRSs (cached); errors as of `known_crs`."""
    return pyproj.Transformer.from_crs(known_crs(source), known_crs(target), always_xy=True)


def box_of(bounds: Bounds, crs: str) -> Bounds:
    """Return the box in a projected CRS around a box in degrees: west, south, east, north."""
    return transformer(WGS84, crs).transform_bounds(*bounds, densify_pts=101)


@lru_cache(maxsize=64)
def known_crs(text: str, of: str = "") -> pyproj.CRS:
    """Return the pyproj CRS of a text of a file or a setting, by which PROJ opens no other file (cached).

    Args:
      text: a code, a name, WKT, PROJJSON or parameters of PROJ.
      of: which file it is of, in messages, as in ``" of 'town.laz'"``.

    Raises:
      InputError: the text is not known as a CRS, is longer than `MOST_OF_CRS`, or names a file or a server.
    """
    _check_crs_text(text, of)
    try:
        parsed = pyproj.CRS.from_user_input(text)
        definition = parsed.to_wkt()
    except (CRSError, ValueError, RecursionError) as error:
        raise InputError(
            f"crs {shortened(text)!r}{of} is not a known CRS: use a projected one such as 'EPSG:32618'"
        ) from error
    _check_crs_text(definition, of)  # JSON may have hidden it
    return parsed


def _check_crs_text(text: str, of: str) -> None:
    """Raise InputError where a text of a CRS names a file or is too long; arguments as of `known_crs`."""
    if len(text) > MOST_OF_CRS or OPENS_FILE.search(text):
        raise InputError(
            f"the CRS {shortened(text)!r}{of} names another file or a server, which is never opened, or is longer than "
            f"{MOST_OF_CRS:,} characters: name it by its code, such as 'EPSG:32618'"
        )


@lru_cache(maxsize=32)
def projected_crs(crs: str) -> pyproj.CRS:
    """Return the pyproj CRS of a name, such as ``"EPSG:32618"``, once it is checked (cached).

    Raises:
      InputError: the name is unknown, or the CRS is not projected, not in metres, or not along east and north.
    """
    parsed = known_crs(crs)
    axes = parsed.axis_info[:2]  # without heights
    in_metres = all(abs(axis.unit_conversion_factor - 1.0) <= 1e-12 for axis in axes)
    if not parsed.is_projected or not in_metres:
        raise InputError(f"{crs!r} is not a projected CRS in metres: use one such as 'EPSG:32618'")
    if {axis.direction for axis in axes} != {"east", "north"}:
        raise InputError(
            f"the axes of {crs!r} do not point east and north: use a CRS such as a UTM zone, 'EPSG:32618'"
        )
    return parsed


def crs_said(crs: str) -> str:
    """Return a CRS as people read it: a code such as ``"EPSG:32618"`` as it is, of a definition its name alone."""
    return crs if len(crs) <= MOST_OF_CODE else shortened(known_crs(crs).name)


def horizontal_of(crs: pyproj.CRS) -> pyproj.CRS:
    """Return a CRS without its vertical axis, and without a shift to another datum."""
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    return (horizontal.source_crs or horizontal) if horizontal.is_bound else horizontal


def area_of(crs: pyproj.CRS) -> Any:
    """Return the area that a CRS is made for, by its horizontal part; None where nothing says it."""
    horizontal = horizontal_of(crs)
    code = horizontal.to_authority()  # WKT may leave the area to it
    return (pyproj.CRS.from_authority(*code) if code else horizontal).area_of_use


def check_on_earth(name: str, crs: pyproj.CRS, box: Sequence[float]) -> None:
    """Check that a file's CRS places it on the Earth, by longitude and latitude or by a map projection made for there.

    Args:
      name: of the file, for the message.
      crs: with heights or without, as `known_crs` has it.
      box: x_min, y_min, x_max, y_max of the file in it; its middle counts.

    Raises:
      InputError: the CRS is geocentric, or a local one that no map projection ties to the Earth, or the file lies far
        outside the area of use of its projection.
    """
    horizontal = horizontal_of(crs)
    if crs.is_geocentric or not (horizontal.is_geographic or horizontal.is_projected):
        raise InputError(
            f"the CRS of {name} is {horizontal.type_name} {horizontal.name!r}, which no map projection places on the "
            "Earth: declare the CRS that it is in, as with `ogr2ogr -a_srs EPSG:...` or `gdal_edit.py -a_srs EPSG:...`"
        )
    area = area_of(crs)
    if horizontal.is_geographic or area is None or not np.isfinite(box).all():
        return
    middle = shapely.box(*box).centroid
    lon, lat = transformer(crs.to_wkt(), WGS84).transform(middle.x, middle.y)
    # Across the antimeridian distances in degrees say nothing.
    with np.errstate(invalid="ignore"):  # of what the projection does not reach
        beyond_deg = shapely.box(*area.bounds).distance(shapely.Point(lon, lat))
    is_across = 180 - MOST_BEYOND_DEG <= abs(lon) <= 180
    if not (beyond_deg <= MOST_BEYOND_DEG or is_across):
        raise InputError(
            f"{name} declares the CRS {shortened(crs.name)!r} and so lies at {lon:.2f}, {lat:.2f} (lon, lat), far "
            f"from the area for which that is made, {area.bounds} (west, south, east, north): declare "
            "the CRS that its coordinates are in, as with `ogr2ogr -a_srs EPSG:...` or `gdal_edit.py -a_srs EPSG:...`, "
            "or for buildings in [buildings] crs"
        )


def check_scale(crs: str, lon_deg: float, lat_deg: float) -> None:
    """Raise InputError unless a metre of the CRS is a metre on the ground, within 1 %, at a point."""
    factors = pyproj.Proj(crs).get_factors(lon_deg, lat_deg)
    scales = factors.meridional_scale, factors.parallel_scale
    scale = max(scales, key=lambda value: abs(value - 1.0))  # the worse of the two
    if not abs(scale - 1.0) < MAX_SCALE_ERROR:
        raise InputError(
            f"a metre of {crs} is {1.0 / scale:.3g} m on the ground at {lon_deg:.2f}, {lat_deg:.2f} (lon, lat): "
            f"use a CRS made for that place, such as {utm_crs(lon_deg, lat_deg)}"
        )


def where_it_lies(extent: Sequence[float], bounds: Sequence[float]) -> str:
    """Return in words what a file covers, with a hint where the bounds of a region seem to be swapped.

    Args:
      extent: of the file: west, south, east, north in degrees.
      bounds: of a region that the file does not reach, in the same order. Where they reach it if latitude and longitude
        are swapped, the words say so.
    """
    west, south, east, north = extent
    low_lat, low_lon, high_lat, high_lon = bounds  # as they are if swapped
    is_swapped = low_lon <= east and west <= high_lon and low_lat <= north and south <= high_lat
    hint = "; latitude and longitude look swapped (longitude comes first)" if is_swapped else ""
    return f"it covers about {west:.4f}, {south:.4f}, {east:.4f}, {north:.4f} (west, south, east, north){hint}"


def check_bounds(bounds: Sequence[float]) -> Bounds:
    """Return bounds as four floats, west, south, east, north in degrees, once they are checked.

    Raises:
      InputError: they are not four finite numbers, out of range (as with latitude and longitude swapped), or a box
        without area.
    """
    try:
        west, south, east, north = (finite("bounds", value, "degrees") for value in bounds)
    except (TypeError, ValueError) as error:
        what = "four finite numbers, west, south, east, north in degrees"
        raise InputError(f"bounds must be {what}, got {bounds!r}") from error
    if abs(south) > 90 or abs(north) > 90:
        raise InputError(
            f"bounds {list(bounds)} have a latitude beyond 90 degrees: the order is west, south, east, north "
            "(longitude first)"
        )
    if west - east > 180:
        raise InputError(
            f"bounds {list(bounds)} reach across the antimeridian, as no region may: let them end at 180 or begin at "
            "-180; what stands on the other side counts too"
        )
    if abs(west) > 180 or abs(east) > 180 or west >= east or south >= north:
        raise InputError(
            f"bounds {list(bounds)} are not a box: west must be below east and south below north, "
            "longitudes within 180 degrees"
        )
    return west, south, east, north


def _common_multiple_m(resolutions_m: Sequence[float]) -> float:
    """Return the least length in metres that is a multiple of every resolution: where they nest, the coarsest one."""
    fractions = [Fraction(str(resolution)) for resolution in resolutions_m]
    denominator = math.lcm(*(fraction.denominator for fraction in fractions))
    numerator = math.lcm(*(int(fraction * denominator) for fraction in fractions))
    return numerator / denominator


def tile_shape(shape: tuple[int, int], max_side: int = MAX_SIDE) -> tuple[int, int]:
    """Return the rows and columns of a tile, of the fewest equal tiles that cover a region.

    They depend on the region alone, never on the machine, as files are cut into the same tiles.

    Args:
      shape: rows and columns of the region's cells.
      max_side: the most cells along a side of a tile.
    """
    num_rows, num_cols = shape
    tiles_down = math.ceil(num_rows / max_side)
    tiles_across = math.ceil(num_cols / max_side)
    return math.ceil(num_rows / tiles_down), math.ceil(num_cols / tiles_across)


def covering_grid(box_m: Bounds, resolution_m: float, crs: str) -> "Grid":
    """Return the grid of the fewest cells that cover a box in its CRS.

    Args:
      box_m: x_min, y_min, x_max, y_max.
      resolution_m: side of a cell.
      crs: projected, in metres.
    """
    # In cells. A border that was snapped to cells before must not move by rounding: a millionth of a cell is nothing.
    west, south, east, north = np.array(box_m) / resolution_m
    first_row = math.floor(south + 1e-6)
    first_col = math.floor(west + 1e-6)
    num_rows = math.ceil(north - 1e-6) - first_row
    num_cols = math.ceil(east - 1e-6) - first_col
    return Grid(crs, resolution_m, first_row, first_col, num_rows, num_cols)


@typed
@dataclass(frozen=True)
class Grid(Hints):
    """A raster of square cells in a projected CRS. Row 0 is the southernmost, column 0 the westernmost.

    A cell is known by its global number: column ``j`` of the CRS covers ``[j, j + 1) * resolution_m``
    in easting, so grids of one resolution always line up and a crop keeps every cell's identity.

    Attributes:
      crs: the projected CRS, in metres.
      resolution_m: side of a cell.
      first_row, first_col: global numbers of the southwest cell.
      num_rows, num_cols: shape of the arrays on this grid (``Y``, ``X``).

    Examples:
      >>> maps.grid
      Grid(crs='EPSG:32618', resolution_m=20.0, first_row=225725, first_col=29330, num_rows=30, num_cols=30)
    """

    crs: str
    resolution_m: float
    first_row: int
    first_col: int
    num_rows: int
    num_cols: int

    def __post_init__(self) -> None:
        """Check the numbers and the CRS; errors as of the class."""
        positive("resolution_m", self.resolution_m)
        if self.num_rows < 1 or self.num_cols < 1:
            raise InputError(
                f"num_rows and num_cols must be 1 or more, got {self.num_rows} x {self.num_cols}"
            )
        projected_crs(self.crs)

    @classmethod
    @typed
    def from_bounds(
        cls,
        bounds: Sequence[float],
        resolution_m: float,
        crs: str | None = None,
        nest_with_m: Sequence[float] = (),
    ) -> "Grid":
        """Return the grid over geographic ``bounds``, snapped outward.

        Args:
          bounds: west, south, east, north in degrees (WGS 84).
          resolution_m: side of a cell.
          crs: projected CRS in metres; left out, the UTM zone of the centre.
          nest_with_m: other resolutions built over the same region; the box is snapped outward to
            whole multiples of the coarsest (their least common multiple where they do not nest).

        Returns:
          The grid: the fewest cells that cover the whole box.

        Raises:
          InputError: bounds that are not a box, or a CRS that is unknown or not projected in metres.

        Examples:
          >>> grid = ju.Grid.from_bounds((-74.02, 40.70, -73.98, 40.73), resolution_m=20.0)
          >>> grid.shape, grid.crs
          ((170, 172), 'EPSG:32618')
        """
        # The arguments, and the CRS.
        west, south, east, north = bounds = check_bounds(bounds)
        resolutions_m = [resolution_m, *nest_with_m]
        for value in resolutions_m:
            positive("resolution_m", value)
        if crs is None:
            crs = utm_of(bounds)
        projected_crs(crs)  # raises InputError for an unusable one
        check_scale(crs, (west + east) / 2, (south + north) / 2)

        # The box in the CRS, which must be finite and hold no more cells than `MOST_CELLS`.
        x_min, y_min, x_max, y_max = box_m = box_of(bounds, crs)
        if not all(map(math.isfinite, box_m)):
            raise InputError(
                f"bounds {list(bounds)} lie outside the area of use of {crs}: choose another CRS"
            )
        if (x_max - x_min) * (y_max - y_min) > MOST_CELLS * min(resolutions_m) ** 2:
            raise InputError(
                f"resolution_m {min(resolutions_m):g} makes more than {MOST_CELLS:.0e} cells: choose a coarser one"
            )

        # The borders lie on multiples of a length that is a whole number of cells at every resolution: so the grids of
        # all resolutions have the same borders.
        snap_m = _common_multiple_m(resolutions_m)
        if snap_m > MAX_SNAP_CELLS * max(resolutions_m):
            raise InputError(
                f"the resolutions {resolutions_m} m have no common grid: choose such as 2, 5, 10"
            )
        snapped = covering_grid(box_m, snap_m, crs).refined(round(snap_m / resolution_m))
        return replace(snapped, resolution_m=float(resolution_m))  # without rounding of a quotient

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.num_rows, self.num_cols

    @property
    def x_min_m(self) -> float:
        """Easting of the western border."""
        return self.first_col * self.resolution_m

    @property
    def y_min_m(self) -> float:
        """Northing of the southern border."""
        return self.first_row * self.resolution_m

    @property
    def x_max_m(self) -> float:
        """Easting of the eastern border."""
        return (self.first_col + self.num_cols) * self.resolution_m

    @property
    def y_max_m(self) -> float:
        """Northing of the northern border."""
        return (self.first_row + self.num_rows) * self.resolution_m

    @property
    def bounds_m(self) -> Bounds:
        """x_min, y_min, x_max, y_max in the CRS."""
        return self.x_min_m, self.y_min_m, self.x_max_m, self.y_max_m

    @property
    def x_m(self) -> np.ndarray:
        """Eastings of the column centres, ``[X]`` float64."""
        return self.xy_of_cell(0, np.arange(self.num_cols))[0]

    @property
    def y_m(self) -> np.ndarray:
        """Northings of the row centres, south to north, ``[Y]`` float64."""
        return self.xy_of_cell(np.arange(self.num_rows), 0)[1]

    @property
    def centre_lonlat(self) -> tuple[float, float]:
        """Longitude and latitude of the middle of the grid, degrees."""
        lon, lat = self.lonlat_of_xy(
            (self.x_min_m + self.x_max_m) / 2, (self.y_min_m + self.y_max_m) / 2
        )
        return float(lon), float(lat)

    def contains_xy(self, x_m: ArrayLike, y_m: ArrayLike) -> np.ndarray:
        """Return whether points of the CRS lie on the grid; its west and south borders belong to it, the others not.

        Returns:
          bool, in the shape of the points; False where a coordinate is NaN.

        Examples:
          >>> grid = maps.grid
          >>> grid.contains_xy([grid.x_min_m, grid.x_max_m], grid.y_min_m).tolist()
          [True, False]
        """
        row, col = self._floor_cell(x_m, y_m)
        return (row >= 0) & (row < self.num_rows) & (col >= 0) & (col < self.num_cols)

    def _floor_cell(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return row and column of points of the CRS, as whole float64 numbers; NaN stays, and any may be outside."""
        col = np.floor(np.asarray(x_m, float) / self.resolution_m) - self.first_col
        row = np.floor(np.asarray(y_m, float) / self.resolution_m) - self.first_row
        return row, col

    def cell_of_xy(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[Any, Any]:
        """Return the cells that hold points of the CRS, easting and northing in metres.

        Returns:
          Row and column (int64), counted from 0 in the southwest, each in the shape of the points.

        Raises:
          InputError: a point is outside the grid or not finite.

        Examples:
          >>> row, col = maps.grid.cell_of_xy(586_650.0, 4_514_570.0)  # easting, northing
          >>> int(row), int(col)
          (3, 2)
        """
        is_inside = self.contains_xy(x_m, y_m)
        if not np.all(is_inside):
            points = np.stack(np.broadcast_arrays(x_m, y_m), dtype=float)
            first_x, first_y = points[:, ~is_inside][:, 0]
            raise InputError(
                f"the point {first_x:.1f}, {first_y:.1f} ({self.crs}) is outside the region, which spans "
                f"{self.x_min_m:.1f} to {self.x_max_m:.1f} east and {self.y_min_m:.1f} to {self.y_max_m:.1f} north "
                "(its east and north borders left out)"
            )
        row, col = self._floor_cell(x_m, y_m)
        return row.astype(np.int64), col.astype(np.int64)

    def xy_of_cell(self, row: ArrayLike, col: ArrayLike) -> tuple[Any, Any]:
        """Return the CRS coordinates of cell centres; rows and columns may lie outside the grid.

        Returns:
          Eastings and northings, metres, float64, each in the shape of the cells.

        Examples:
          >>> x_m, y_m = maps.grid.xy_of_cell([2, 3], [2, 2])
          >>> x_m.tolist(), y_m.tolist()
          ([586650.0, 586650.0], [4514550.0, 4514570.0])
        """
        x_m = (self.first_col + np.asarray(col) + 0.5) * self.resolution_m
        y_m = (self.first_row + np.asarray(row) + 0.5) * self.resolution_m
        return x_m, y_m

    def xy_of_lonlat(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Any, Any]:
        """Return CRS coordinates of longitudes and latitudes (WGS 84).

        Returns:
          Eastings and northings, metres, float64; inf where the projection has no value.

        Examples:
          >>> x_m, y_m = maps.grid.xy_of_lonlat(-73.97, 40.78)
          >>> round(float(x_m)), round(float(y_m))
          (586913, 4514846)
        """
        x_m, y_m = transformer(WGS84, self.crs).transform(lon_deg, lat_deg)
        return np.asarray(x_m), np.asarray(y_m)

    def lonlat_of_xy(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[Any, Any]:
        """Return longitudes and latitudes (WGS 84, degrees) of CRS coordinates, easting and northing in metres.

        Returns:
          Longitudes and latitudes, float64, numbers of a point; inf where the projection has no value.

        Examples:
          >>> lon, lat = maps.grid.lonlat_of_xy(586_650.0, 4_514_550.0)
          >>> round(lon, 5), round(lat, 5)
          (-73.97315, 40.77736)
        """
        lon, lat = map(np.asarray, transformer(self.crs, WGS84).transform(x_m, y_m))
        return (lon, lat) if lon.ndim else (lon.item(), lat.item())

    def xy_at(self, lonlat: np.ndarray) -> np.ndarray:
        """Return CRS coordinates of longitudes and latitudes (WGS 84, degrees), pairs in the last dimension.

        Returns:
          ``[..., 2]`` easting and northing in metres, inf where the projection has no value.

        Examples:
          >>> maps.grid.xy_at(np.array([[-73.97, 40.78]])).round().tolist()
          [[586913.0, 4514846.0]]
        """
        return np.stack(self.xy_of_lonlat(lonlat[..., 0], lonlat[..., 1]), axis=-1)

    def lonlat_at(self, xy_m: np.ndarray) -> np.ndarray:
        """Return longitudes and latitudes (WGS 84, degrees) of CRS coordinates in metres, pairs in the last dimension.

        Returns:
          ``[..., 2]``, inf where the projection has no value.

        Examples:
          >>> maps.grid.lonlat_at(np.array([[586_650.0, 4_514_550.0]])).round(5).tolist()
          [[-73.97315, 40.77736]]
        """
        return np.stack(self.lonlat_of_xy(xy_m[..., 0], xy_m[..., 1]), axis=-1)

    def cell_of_lonlat(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Any, Any]:
        """Return the cells that hold geographic points (WGS 84, degrees).

        Returns:
          Row and column (int64), counted from 0 in the southwest, each in the shape of the points.

        Raises:
          InputError: a point is outside the grid.

        Examples:
          >>> row, col = maps.grid.cell_of_lonlat(-73.97, 40.78)
          >>> int(row), int(col)
          (17, 15)
        """
        x_m, y_m = self.xy_of_lonlat(lon_deg, lat_deg)
        if not np.all(self.contains_xy(x_m, y_m)):
            raise InputError(self.outside_said(lon_deg, lat_deg))
        return self.cell_of_xy(x_m, y_m)

    def is_swapped(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> bool:
        """Return whether points (WGS 84, degrees) all lie on the grid once longitude and latitude change places.

        Returns:
          True where they look swapped, and do not all lie on the grid as they are.

        Examples:
          >>> maps.grid.is_swapped(40.78, -73.97)
          True
        """
        is_on = [
            bool(np.all(self.contains_xy(*self.xy_of_lonlat(*degrees))))
            for degrees in ((lat_deg, lon_deg), (lon_deg, lat_deg))
        ]
        return is_on == [True, False]

    def outside_said(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> str:
        """Return in words that points (WGS 84, degrees) lie outside the grid, and how if they look swapped.

        Returns:
          The words, without a full stop.

        Examples:
          >>> maps.grid.outside_said(40.78, -73.97)
          'the point 40.78, -73.97 (longitude comes first) is outside ...: longitude and latitude look swapped'
        """
        west, south, east, north = transformer(self.crs, WGS84).transform_bounds(*self.bounds_m)
        hint = ""
        if self.is_swapped(lon_deg, lat_deg):
            hint = ": longitude and latitude look swapped"
        elif np.any(np.abs(lat_deg) > 90):
            hint = ": these look like metres: give degrees, or in Python ju.XY(x, y)"
        return (
            f"the point {np.asarray(lon_deg)}, {np.asarray(lat_deg)} (longitude comes first) is outside the region, "
            f"which spans about {west:.4f} to {east:.4f} and {south:.4f} to {north:.4f}{hint}"
        )

    def lonlat_of_cell(self, row: ArrayLike, col: ArrayLike) -> tuple[Any, Any]:
        """Return longitudes and latitudes (WGS 84, degrees) of cell centres; cells may lie outside the grid.

        Returns:
          Longitudes and latitudes, float64, each in the shape of the cells, numbers of one cell.

        Examples:
          >>> lon, lat = maps.grid.lonlat_of_cell(2, 2)
          >>> round(lon, 5), round(lat, 5)
          (-73.97315, 40.77736)
        """
        return self.lonlat_of_xy(*self.xy_of_cell(row, col))

    def convergence_rad(self, lon_deg: float, lat_deg: float) -> float:
        """Return the meridian convergence at a point: grid azimuth = true azimuth - convergence.

        Positive where grid north lies clockwise of (east of) true north, as it does
        east of a UTM zone's central meridian in the northern hemisphere. Source: PROJ.

        Returns:
          The angle in radians.

        Examples:
          >>> convergence_rad = maps.grid.convergence_rad(-73.97, 40.78)
          >>> round(float(np.degrees(convergence_rad)), 2)
          0.67
        """
        factors = pyproj.Proj(self.crs).get_factors(lon_deg, lat_deg)
        return math.radians(float(factors.meridian_convergence))

    def refined(self, n: int) -> "Grid":
        """Return the grid over the same box whose cells are n times smaller.

        Returns:
          The grid, of n times as many rows and columns.

        Examples:
          >>> fine = maps.grid.refined(4)
          >>> fine.resolution_m, fine.shape, fine.bounds_m == maps.grid.bounds_m
          (5.0, (120, 120), True)
        """
        return Grid(
            self.crs,
            self.resolution_m / n,
            self.first_row * n,
            self.first_col * n,
            self.num_rows * n,
            self.num_cols * n,
        )

    def padded(self, west: int, south: int, east: int, north: int) -> "Grid":
        """Return the grid grown by numbers of cells on each side; negative numbers cut cells off.

        Returns:
          The grid, of the same resolution.

        Examples:
          >>> maps.grid.padded(west=1, south=1, east=2, north=2).shape
          (33, 33)
        """
        return replace(
            self,
            first_row=self.first_row - south,
            first_col=self.first_col - west,
            num_rows=self.num_rows + south + north,
            num_cols=self.num_cols + west + east,
        )

    def window_in(self, outer: "Grid") -> tuple[slice, slice]:
        """Return the slices that cut this grid out of an array on ``outer``.

        Returns:
          The slices of rows and of columns.

        Raises:
          InputError: other CRS or resolution, or not wholly inside.

        Examples:
          >>> inner = maps.grid.padded(-5, -5, -5, -5)
          >>> rows, cols = inner.window_in(maps.grid)
          >>> maps.m("gps", 60.0)[rows, cols].shape == inner.shape
          True
        """
        row = self.first_row - outer.first_row
        col = self.first_col - outer.first_col
        if (
            (self.crs, self.resolution_m) != (outer.crs, outer.resolution_m)
            or min(row, col) < 0
            or row + self.num_rows > outer.num_rows
            or col + self.num_cols > outer.num_cols
        ):
            raise InputError(f"the grid {self} is not a part of the grid {outer}")
        return slice(row, row + self.num_rows), slice(col, col + self.num_cols)


def grid_of(ds: Any) -> Grid:
    """Return the grid of an `xarray.Dataset` of maps, as its attributes and the lengths of y and x have it."""
    attrs = ds.attrs
    return Grid(
        attrs["crs"],
        float(attrs["resolution_m"]),
        int(attrs["first_row"]),
        int(attrs["first_col"]),
        num_rows=ds.sizes["y"],
        num_cols=ds.sizes["x"],
    )
