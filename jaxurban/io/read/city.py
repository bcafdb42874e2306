"""Files to City."""

import math
from collections.abc import Sequence
from pathlib import Path

import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.buildings import BuildingFile, BuildingSource, lonlat_extent, read_buildings
from jaxurban.io.read.census import CensusFiles, read_blocks
from jaxurban.io.read.guesses import FLAT_GROUND, count_guesses, district_guesses, height_guesses, warn_of
from jaxurban.io.read.raster import raster_extent_m, read_raster
from jaxurban.world.city import City
from jaxurban.world.grid import WGS84, Bounds, check_bounds, projected_crs, transformer, utm_crs, where_it_lies

TALLEST_M = 1000.0  # no roof stands higher; bounds how far away its shadow can come from
RELIEF_M = 1000.0  # terrain is read as far as a hill this much higher could shadow the region


def read_city(
    buildings: BuildingFile,
    *,
    bounds: Sequence[float] | None = None,
    crs: str | None = None,
    census: CensusFiles | None = None,
    terrain: str | Path | None = None,
    mask_deg: float = 5.0,
) -> City:
    """Return the city in a set of files, around a region.

    Args:
      buildings: their file. Buildings are kept as far around the region as one of 1,000 m could shadow it from a
        satellite at the elevation mask.
      bounds: west, south, east, north of the region in degrees; left out, what the file covers (`lonlat_extent`).
      crs: projected CRS in metres; left out, the UTM zone of the region's centre.
      census: blocks with their people; left out, none.
      terrain: ground elevation raster; left out, flat.
      mask_deg: lowest satellite elevation that will be used.

    Warns:
      GuessWarning: of each of the city's ``guesses``.

    Raises:
      InputError: a file that is missing, unreadable or of the wrong kind, or no building in the region.
    """
    bounds = check_bounds(lonlat_extent(buildings.source) if bounds is None else bounds)
    west, south, east, north = bounds
    if crs is None:
        crs = utm_crs((west + east) / 2, (south + north) / 2)
    projected_crs(crs)
    box_m = transformer(WGS84, crs).transform_bounds(west, south, east, north, densify_pts=101)
    rise_m = TALLEST_M if terrain is None else TALLEST_M + RELIEF_M
    reach_m = rise_m / math.tan(math.radians(max(mask_deg, 0.5)))
    wide_m = (box_m[0] - reach_m, box_m[1] - reach_m, box_m[2] + reach_m, box_m[3] + reach_m)
    ground = read_raster(terrain, crs, wide_m) if terrain is not None else None
    source = read_buildings(buildings, crs, bounds_m=wide_m, terrain=ground)
    if not buildings.allow_none:
        _check_has_building(buildings, source, bounds, box_m, crs)
    issues = dict(source.issues)
    guesses = height_guesses(source.buildings, box_m, buildings)
    roles: dict[str, str | Path | None] = {"buildings": buildings.source}
    blocks = None
    if census is not None:
        blocks, block_issues = read_blocks(census, crs, wide_m)
        issues |= block_issues
        guesses |= count_guesses(block_issues, blocks) | district_guesses(block_issues, census)
        roles |= {"blocks": census.blocks, "table": census.table, "districts": census.districts}
    roles["terrain"] = terrain
    if terrain is None:
        guesses |= FLAT_GROUND
    warn_of(guesses)
    return City(
        crs=crs,
        extent_m=source.area.bounds,
        buildings=source.buildings,
        roofs=source.roofs,
        blocks=blocks,
        terrain=ground,
        terrain_extent_m=None if terrain is None else raster_extent_m(terrain, crs),
        read_issues=issues,
        counts=source.counts,
        attribution=source.attribution,
        guesses=guesses,
        sources={role: str(path) for role, path in roles.items() if path is not None},
        bounds=(west, south, east, north),
        area=source.area,
        hanging=buildings.hanging,
    )


def _check_has_building(
    buildings: BuildingFile, source: BuildingSource, bounds: Sequence[float], box_m: Bounds, crs: str
) -> None:
    """Raise InputError unless a building stands in the region: any outline there, or any cell of a raster."""
    if source.buildings is not None:
        if shapely.intersects(source.buildings.polygons, shapely.box(*box_m)).any():
            return
    elif source.roofs is not None and (source.roofs.values > 0).any():
        return
    extent = transformer(crs, WGS84).transform_bounds(*source.file_extent_m)
    raise InputError(
        f"{str(buildings.source)!r} has no building in the region {list(bounds)}: {where_it_lies(extent, bounds)}; "
        "move [region] bounds there, or set [buildings] allow_none = true if there are none"
    )
