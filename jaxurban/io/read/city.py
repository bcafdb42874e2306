"""Files to City."""

import math
from collections.abc import Sequence

import shapely

from jaxurban import settings
from jaxurban.errors import InputError
from jaxurban.io.read.buildings import BuildingSource, lonlat_extent, read_buildings
from jaxurban.io.read.census import read_blocks
from jaxurban.io.read.guesses import FLAT_GROUND, count_guesses, district_guesses, height_guesses, warn_of
from jaxurban.io.read.raster import raster_extent_m, read_raster
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.population import Population
from jaxurban.world.city import City, joined_credits
from jaxurban.world.grid import WGS84, Bounds, check_bounds, projected_crs, transformer, utm_crs, where_it_lies

TALLEST_M = 1000.0  # no roof stands higher; bounds how far away its shadow can come from
RELIEF_M = 1000.0  # terrain is read as far as a hill this much higher could shadow the region


def read_city(
    buildings: settings.Buildings,
    *,
    bounds: Sequence[float] | None,
    crs: str | None,
    population: Population | None,
    terrain: settings.Terrain,
    gps: Gps | None,
) -> City:
    """Return the city in a set of files, around a region; arguments, warnings and errors as `City.from_files`."""
    bounds = check_bounds(lonlat_extent(buildings.source) if bounds is None else bounds)
    west, south, east, north = bounds
    if crs is None:
        crs = utm_crs((west + east) / 2, (south + north) / 2)
    projected_crs(crs)
    box_m = transformer(WGS84, crs).transform_bounds(west, south, east, north, densify_pts=101)
    rise_m = TALLEST_M if terrain.source is None else TALLEST_M + RELIEF_M
    reach_m = rise_m / math.tan(math.radians(max((gps or Gps()).mask_deg, 0.5)))
    wide_m = (box_m[0] - reach_m, box_m[1] - reach_m, box_m[2] + reach_m, box_m[3] + reach_m)
    ground = None if terrain.source is None else read_raster(terrain.source, crs, wide_m)
    source = read_buildings(buildings, crs, bounds_m=wide_m, terrain=ground)
    if not buildings.allow_none:
        _check_has_building(buildings, source, bounds, box_m, crs)
    issues = dict(source.issues)
    guesses = height_guesses(source.buildings, box_m, buildings)
    people = population or Population()
    files = {"buildings": buildings.source, "terrain": terrain.source}
    files |= {role: getattr(people, role) for role in ("blocks", "table", "districts")}
    blocks = None
    if people.blocks is not None:
        blocks, block_issues = read_blocks(people, crs, wide_m)
        issues |= block_issues
        guesses |= count_guesses(block_issues, blocks) | district_guesses(block_issues, people)
    if terrain.source is None:
        guesses |= FLAT_GROUND
    warn_of(guesses)
    return City(
        crs=crs,
        extent_m=source.area.bounds,
        buildings=source.buildings,
        roofs=source.roofs,
        blocks=blocks,
        terrain=ground,
        terrain_extent_m=None if terrain.source is None else raster_extent_m(terrain.source, crs),
        read_issues=issues,
        counts=source.counts,
        attribution=joined_credits(source.attribution, buildings.credit, terrain.credit, people.credit),
        guesses=guesses,
        sources={role: str(path) for role, path in files.items() if path is not None},
        bounds=(west, south, east, north),
        area=source.area,
        hanging=buildings.hanging,
    )


def _check_has_building(
    buildings: settings.Buildings, source: BuildingSource, bounds: Sequence[float], box_m: Bounds, crs: str
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
