"""City: what stands and who lives in a region, as vectors in one projected CRS."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum, StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
import shapely

from jaxurban import settings
from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.public import Caution, FactsRepr, caution_of_guesses
from jaxurban.settings import SLABS as SLABS
from jaxurban.settings import TO_GROUND as TO_GROUND
from jaxurban.settings import Hanging as Hanging
from jaxurban.world.grid import WGS84, Bounds, transformer

if TYPE_CHECKING:
    from jaxurban.metrics.gps import Gps
    from jaxurban.metrics.population import Population

MAIN_SHARE = 0.99  # of the buildings: the box around them is where a city stands
SMALL_PART = 0.1  # of an extent: such a box is proposed instead of it
MOST_IN = f"{100 * MAIN_SHARE:.0f} % of buildings in"
OTHER_DISTRICT = 13  # the paper's label for every block that no district claims


class HeightOrigin(IntEnum):
    """Where a building's height came from."""

    HEIGHT = 0  # a height tag or column
    LEVELS = 1  # number of levels x level height
    DEFAULT = 2  # neither: the default height
    RASTER = 3  # a height raster
    GENERATED = 4  # the synthetic city
    LAYER = 5  # of a bridge's deck: its layer x a clearance


GUESSED_BY = {  # the origins of heights that are guesses, as reports say them with the settings of the buildings
    HeightOrigin.LEVELS: "by {level_height_m:g} m a level",
    HeightOrigin.DEFAULT: "the default of {default_height_m:g} m",
    HeightOrigin.LAYER: "decks of bridges by {layer_clearance_m:g} m a layer",
}


class Zoning(IntEnum):
    """What a district is for: decides how its population changes by day."""

    OTHER = 0  # district 13 and districts on neither list; counted with the residential ones
    RESIDENTIAL = 1
    COMMERCIAL = 2


class ReadIssue(StrEnum):
    """What the readers of a city repaired, guessed or left out; ``run.json`` counts them under these names.

    Attributes:
      OPEN_WAYS: not closed.
      WAYS_WITH_MISSING_NODES: nodes that the file does not hold.
      DEGENERATE_WAYS: closed and complete, but without area: fewer than three corners.
      RELATIONS_INCOMPLETE: members or their nodes missing.
      NON_POLYGONS: points and lines, left out.
      POLYGONS_REPAIRED: invalid, or not assembled by libosmium.
      POLYGONS_DROPPED: empty, or beyond repair.
      OUTSIDE_CRS: where the city's CRS does not reach.
      NOT_BUILDINGS: building=no without building:part, left out.
      UNDERGROUND: location=underground or layer below 0, left out.
      OUTLINES_REPLACED_BY_PARTS: covered by their own parts to 90 % or more.
      OUTLINES_KEPT_AS_PODIUMS: of these, under hanging parts where no part stands, up to the lowest floor.
      PARTS_GIVEN_OUTLINE_HEIGHT: parts without a height of their own.
      PARTS_HANGING: underside above the ground.
      MIN_HEIGHTS_ABOVE_ROOF: underside at or above the roof, set to 0.
      HEIGHTS_UNUSABLE: unreadable, 0, negative or too high.
      LEVELS_UNUSABLE: the same of levels.
      MIN_HEIGHTS_UNUSABLE: the same of the heights of undersides.
      CELLS_BELOW_GROUND: taken for ground.
      CELLS_NEAR_GROUND: of a surface model: taken for ground.
      BLOCKS_WITHOUT_COUNT: kept with 0 people: no row, or a count that cannot be read.
      COUNTS_UNREADABLE: of these, those with a count that cannot be read.
      COUNTS_WITHOUT_BLOCK: rows of the table for blocks that the whole blocks file lacks.
      BLOCKS_WITHOUT_POLYGON: left out.
      BLOCKS_WITHOUT_DISTRICT: in district 13.
      INVALID_BLOCK_POLYGONS: repaired.
      INVALID_DISTRICT_POLYGONS: repaired.
      COMMERCIAL_NOT_FOUND: labels on the commercial list that no district has.
    """

    OPEN_WAYS = "open_ways"
    WAYS_WITH_MISSING_NODES = "ways_with_missing_nodes"
    DEGENERATE_WAYS = "degenerate_ways"
    RELATIONS_INCOMPLETE = "relations_incomplete"
    NON_POLYGONS = "non_polygons"
    POLYGONS_REPAIRED = "polygons_repaired"
    POLYGONS_DROPPED = "polygons_dropped"
    OUTSIDE_CRS = "outside_crs"
    NOT_BUILDINGS = "not_buildings"
    UNDERGROUND = "underground"
    OUTLINES_REPLACED_BY_PARTS = "outlines_replaced_by_parts"
    OUTLINES_KEPT_AS_PODIUMS = "outlines_kept_as_podiums"
    PARTS_GIVEN_OUTLINE_HEIGHT = "parts_given_outline_height"
    PARTS_HANGING = "parts_hanging"
    MIN_HEIGHTS_ABOVE_ROOF = "min_heights_above_roof"
    HEIGHTS_UNUSABLE = "heights_unusable"
    LEVELS_UNUSABLE = "levels_unusable"
    MIN_HEIGHTS_UNUSABLE = "min_heights_unusable"
    CELLS_BELOW_GROUND = "cells_below_ground"
    CELLS_NEAR_GROUND = "cells_near_ground"
    BLOCKS_WITHOUT_COUNT = "blocks_without_count"
    COUNTS_UNREADABLE = "counts_unreadable"
    COUNTS_WITHOUT_BLOCK = "counts_without_block"
    BLOCKS_WITHOUT_POLYGON = "blocks_without_polygon"
    BLOCKS_WITHOUT_DISTRICT = "blocks_without_district"
    INVALID_BLOCK_POLYGONS = "invalid_block_polygons"
    INVALID_DISTRICT_POLYGONS = "invalid_district_polygons"
    COMMERCIAL_NOT_FOUND = "commercial_not_found"


ReadIssues = dict[ReadIssue, int]


class _Rows:
    """Columns of equal length, one a field; ``polygons`` is one of them."""

    polygons: np.ndarray

    def __len__(self) -> int:
        return len(self.polygons)

    @cached_property
    def boxes_m(self) -> np.ndarray:
        """``[4, N]`` x_min, y_min, x_max, y_max of each polygon: which of them are near is asked tile by tile."""
        return np.ascontiguousarray(shapely.bounds(self.polygons).T)

    def take(self, index: np.ndarray) -> Self:
        """Return the rows at ``index`` (integers or a mask)."""
        columns = (getattr(self, column.name) for column in fields(self))  # type: ignore[arg-type]
        return type(self)(*(None if column is None else column[index] for column in columns))


@dataclass(frozen=True)
class Footprints(_Rows):
    """Building outlines as prisms with a flat roof. ``B`` buildings.

    Attributes:
      polygons: ``[B]`` object array of valid shapely Polygons or MultiPolygons, in the city's CRS.
      height_m: ``[B]`` float64 roof height above ground, > 0.
      min_height_m: ``[B]`` float64 height of the underside, 0 for most; `City.hanging` says what it means.
      origin: ``[B]`` uint8, a `HeightOrigin` each.
      is_part: ``[B]`` bool, from ``building:part``.
    """

    polygons: np.ndarray
    height_m: np.ndarray
    min_height_m: np.ndarray
    origin: np.ndarray
    is_part: np.ndarray

    @property
    def is_guessed(self) -> np.ndarray:
        """``[B]`` bool: no height is known, and what `GUESSED_BY` names stands in."""
        return np.isin(self.origin, list(GUESSED_BY))

    def origin_counts(self) -> dict[str, int]:
        """Return the number of buildings by origin of height, only origins that occur."""
        return {o.name.lower(): int(n) for o in HeightOrigin if (n := np.sum(self.origin == o))}


@dataclass(frozen=True)
class Raster:
    """A single-band raster read from a file, north-up, on its own grid and CRS.

    Attributes:
      values: ``[R, C]`` float32, row 0 in the north, NaN where the file declares no data.
      transform: affine coefficients (a, b, c, d, e, f): x = a * col + b * row + c, y = d * col + e * row + f,
        with the file's own row and col.
      crs: the raster's CRS.
      first_row, first_col: the file's row and column of ``values[0, 0]``. A window keeps the file's transform, so
        that a pixel's place does not depend on the window by rounding.
    """

    values: np.ndarray
    transform: tuple[float, float, float, float, float, float]
    crs: str
    first_row: int = 0
    first_col: int = 0


@dataclass(frozen=True)
class Blocks(_Rows):
    """Census blocks with their night population. ``N`` blocks.

    Attributes:
      polygons: ``[N]`` object array of shapely Polygons or MultiPolygons, in the city's CRS.
      night_count: ``[N]`` float64 people at night (the census count).
      district: ``[N]`` int32 label of the district of largest overlap, `OTHER_DISTRICT` where none.
      zoning: ``[N]`` uint8, a `Zoning` each.
      block_id: ``[N]`` object array of identifiers.
      day_count: ``[N]`` float64 people by day, of rasters that hold them; None where factors make them of the night's.
    """

    polygons: np.ndarray
    night_count: np.ndarray
    district: np.ndarray
    zoning: np.ndarray
    block_id: np.ndarray
    day_count: np.ndarray | None = None

    @property
    def area_m2(self) -> np.ndarray:
        """Area of each block in the projected CRS, ``[N]``."""
        return shapely.area(self.polygons)

    def touches(self, bounds_m: tuple[float, float, float, float]) -> np.ndarray:
        """Return ``[N]`` bool: which blocks touch the box x_min, y_min, x_max, y_max of the CRS."""
        return shapely.intersects(self.polygons, shapely.box(*bounds_m))


def joined_credits(*credits: str) -> str:
    """Return credits as one text, each once."""
    return "; ".join(dict.fromkeys(credit for credit in credits if credit))


@dataclass(frozen=True)
class LandCover:
    """Where there is water and where there are parks: polygons in a city's CRS, empty where there are none."""

    water: shapely.Geometry
    park: shapely.Geometry


def lonlat_boxes(polygons: np.ndarray, crs: str) -> np.ndarray:
    """Return west, south, east, north in degrees of polygons in ``crs``, ``[N, 4]``."""
    return shapely.bounds(
        shapely.transform(polygons, transformer(crs, WGS84).transform, interleaved=False)
    )


def rounded_outward(boxes: np.ndarray) -> Bounds:
    """Return the box around boxes in degrees ``[N, 4]``, rounded outward to some 10 m."""
    sides = np.round(
        1e4 * shapely.total_bounds(shapely.box(*boxes.T)), 4
    )  # a projection there and back moves them
    west, south, east, north = (np.append(np.floor(sides[:2]), np.ceil(sides[2:])) / 1e4).tolist()
    return west, south, east, north


def main_bounds(polygons: np.ndarray, crs: str, extent: Sequence[float]) -> Bounds | None:
    """Return the box that `MAIN_SHARE` of the polygons lie in, if it is a small part of an extent; else None.

    Args:
      polygons: ``[N]`` in ``crs``; of those that reach into the extent, the ones that lie nearest the median of all,
        along the axis where they are farther, count as most of them.
      crs: of the polygons; the box does not depend on it.
      extent: west, south, east, north in degrees.

    Returns:
      West, south, east, north in degrees, rounded outward to some 10 m.
    """
    boxes = lonlat_boxes(polygons, crs)
    boxes = boxes[shapely.intersects(shapely.box(*boxes.T), shapely.box(*extent))]
    if not len(boxes):
        return None
    centre = (boxes[:, :2] + boxes[:, 2:]) / 2
    middle = np.median(centre, axis=0)
    off = (np.abs(centre - middle) * [np.cos(np.radians(middle[1])), 1.0]).max(axis=1)
    main = rounded_outward(boxes[off <= np.quantile(off, MAIN_SHARE, method="higher")])
    return main if shapely.box(*main).area < SMALL_PART * shapely.box(*extent).area else None


@typed
@dataclass(frozen=True, repr=False)
class City(FactsRepr):
    """A city in one projected CRS: buildings or a height raster, and optionally blocks and terrain.

    Attributes:
      crs: projected CRS in metres of every polygon.
      extent_m: x_min, y_min, x_max, y_max that the building source covers: beyond it no building is known.
      terrain_extent_m: the same of the terrain, None for flat ground.
      buildings: outlines with heights, or None where ``roofs`` is given.
      roofs: raster of roof heights above ground, or None.
      blocks: census blocks, or None without population data.
      terrain: raster of ground elevation, or None for flat ground.
      read_issues: what the readers repaired, guessed or left out, counted by `jaxurban.world.city.ReadIssue`.
      sources: path by role, for provenance (empty for the synthetic city).
      guesses: what was supposed where the sources are silent, see `jaxurban.io.read.guesses`.
      attribution: the credit that the licence of the sources asks for wherever pictures are shown.
      bounds: west, south, east, north in degrees that the city was read for; None for all that there is.
      area: where the building source knows what stands, within ``extent_m``; None for all of it.
      hanging: what buildings with an underside above the ground do: ``"to_ground"``, they reach it; ``"slabs"``, they
        hang from floor to roof.
      gps: satellites and times that come with the city; maps are made of them where no others are named; None for most.

    Raises:
      InputError: neither buildings nor roofs, both, or an unknown way of hanging.

    Examples:
      >>> city
      City(CRS: EPSG:32618; extent: 0.6 x 0.6 km; buildings: 130; census blocks: 64; terrain: flat; credit: ...)
      >>> round(float(city.buildings.height_m.max()))
      395
    """

    crs: str
    extent_m: tuple[float, float, float, float]
    buildings: Footprints | None = None
    roofs: Raster | None = None
    blocks: Blocks | None = None
    terrain: Raster | None = None
    read_issues: ReadIssues = field(default_factory=dict)
    terrain_extent_m: tuple[float, float, float, float] | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    attribution: str = ""
    bounds: tuple[float, float, float, float] | None = None
    area: shapely.Geometry | None = None
    guesses: Mapping[str, str] = field(default_factory=dict)
    hanging: Hanging = TO_GROUND
    gps: "Gps | None" = None

    def __post_init__(self) -> None:
        if (self.buildings is None) == (self.roofs is None):
            raise InputError(
                "a City needs either buildings (outlines) or roofs (a height raster), and not both"
            )

    @property
    def facts(self) -> dict[str, str]:
        """CRS, extent of the region, what is known of buildings, people and terrain, and the credit."""
        x_min, y_min, x_max, y_max = region_m = self._region_m
        num, main = "a height raster", None
        if self.buildings is not None:
            inside = self.buildings.polygons[
                shapely.intersects(self.buildings.polygons, shapely.box(*region_m))
            ]
            around = len(self.buildings) - len(inside)
            num = f"{len(inside):,}" + (f", and {around:,} around" if around else "")
            extent = self.bounds or transformer(self.crs, WGS84).transform_bounds(*region_m)
            main = main_bounds(self.buildings.polygons, self.crs, extent)
        return {
            "CRS": self.crs,
            "extent": f"{(x_max - x_min) / 1000:.3g} x {(y_max - y_min) / 1000:.3g} km",
            "buildings": num,
            MOST_IN: "" if main is None else str(list(main)),
            "census blocks": "" if self.blocks is None else f"{len(self.blocks):,}",
            "terrain": "flat" if self.terrain is None else "a raster",
            "credit": self.attribution,
        }

    @property
    def known_cautions(self) -> list[Caution]:
        """That it rests on ``guesses``."""
        return caution_of_guesses(self.guesses)

    @property
    def _region_m(self) -> tuple[float, float, float, float]:
        """The box that the city was read for; of one that was not, what its source covers."""
        if self.bounds is None:
            return self.extent_m
        return transformer(WGS84, self.crs).transform_bounds(*self.bounds, densify_pts=101)

    @property
    def known_extent_m(self) -> tuple[float, float, float, float]:
        """The box that holds everything known, buildings and terrain: beyond it nothing can shadow."""
        if self.terrain_extent_m is None:
            return self.extent_m
        (a, b, c, d), (e, f, g, h) = self.extent_m, self.terrain_extent_m
        return min(a, e), min(b, f), max(c, g), max(d, h)

    @property
    def known_area(self) -> shapely.Geometry:
        """Where the building source knows what stands: a building far off does not make the land between known."""
        return shapely.box(*self.extent_m) if self.area is None else self.area

    @classmethod
    @typed
    def from_files(
        cls,
        buildings: str | Path | settings.Buildings,
        *,
        bounds: Sequence[float] | None = None,
        crs: str | None = None,
        population: "Population | None" = None,
        terrain: str | Path | settings.Terrain | None = None,
        gps: "Gps | None" = None,
    ) -> "City":
        """Return the city in a set of files, around a region.

        Args:
          buildings: their file, or ``"sample:lower-manhattan"``, ``"sample:shinjuku"`` or ``"sample:nihonbashi"`` (see
            `sample_city`); or `Buildings`, which also says how the file is read. Buildings are kept as far around the
            region as one of 1,000 m could shadow it from a satellite at the elevation mask.
          bounds: west, south, east, north of the region in degrees; left out, what the file of buildings covers.
          crs: projected CRS in metres; left out, the UTM zone of the region's centre.
          population: names census blocks, their people and districts, or rasters of people; left out, none.
          terrain: ground elevation raster; left out, flat.
          gps: settings with the elevation mask of the maps; left out, the mask is 5 degrees.

        Returns:
          The city, its coordinates in metres in ``crs``. What lies around the region is there too.

        Warns:
          GuessWarning: of each of the city's ``guesses``.

        Raises:
          InputError: a file that is missing, unreadable or of the wrong kind, or no building in the region.

        Examples:
          >>> around = ju.City.from_files("sample:shinjuku", bounds=(139.698, 35.687, 139.703, 35.691))
          >>> around.crs, around.facts["buildings"]
          ('EPSG:32654', '3,052, and 50,419 around')
        """
        # The one import against the layers, for the user's sake.
        from jaxurban.io.read.city import read_city

        file = (
            buildings
            if isinstance(buildings, settings.Buildings)
            else settings.Buildings(buildings)
        )
        ground = terrain if isinstance(terrain, settings.Terrain) else settings.Terrain(terrain)
        return read_city(
            file, bounds=bounds, crs=crs, population=population, terrain=ground, gps=gps
        )
