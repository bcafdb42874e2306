"""Files to City."""

import math
from collections.abc import Sequence
from pathlib import Path

import shapely

from jaxurban.city import City
from jaxurban.errors import InputError
from jaxurban.grid import WGS84, Bounds, check_bounds, projected_crs, transformer, utm_crs
from jaxurban.io.buildings import BuildingSource, Kind, read_buildings
from jaxurban.io.census import read_blocks
from jaxurban.io.raster import raster_extent_m, read_raster

OSM_SUFFIXES = (".pbf", ".osm")
OSM_CREDIT = "© OpenStreetMap contributors"  # asked for by the ODbL
TALLEST_M = 1000.0  # no roof stands higher; bounds how far away its shadow can come from
RELIEF_M = 1000.0  # terrain is read as far as a hill this much higher could shadow the region


def read_city(
    buildings: str | Path,
    *,
    bounds: Sequence[float],
    crs: str | None = None,
    blocks: str | Path | None = None,
    table: str | Path | None = None,
    districts: str | Path | None = None,
    terrain: str | Path | None = None,
    block_field: str = "GEOID10",
    district_field: str = "BoroCD",
    commercial: Sequence[int] = (101, 102, 103, 104, 105, 106),
    default_height_m: float = 10.0,
    level_height_m: float = 3.0,
    mask_deg: float = 5.0,
    allow_none: bool = False,
    kind: Kind = "height",
) -> City:
    """Return the city in a set of files, around a region.

    Args:
      buildings: ``.osm.pbf``, ``.osm``, ``.geojson``, ``.gpkg``, ``.shp``, ``.parquet`` or a height raster.
      bounds: west, south, east, north of the region in degrees. Buildings are kept as far around it
        as one of 1,000 m could shadow it from a satellite at the elevation mask.
      crs: projected CRS in metres; left out, the UTM zone of the region's centre.
      blocks, table: census blocks (any vector format) and their population table (CSV).
      districts: district polygons; blocks take the one of largest overlap.
      terrain: ground elevation raster; left out, flat.
      block_field, district_field: identifying columns.
      commercial: labels of the commercial districts.
      default_height_m, level_height_m: for buildings without a height.
      mask_deg: lowest satellite elevation that will be used.
      allow_none: accept a region without a single building.
      kind: of a raster of buildings: ``"height"`` above ground, or ``"surface"`` (a DSM), from which the terrain is
        taken; trees are in it too.

    Raises:
      InputError: a file that is missing, unreadable or of the wrong kind, or no building in the region.
    """
    west, south, east, north = check_bounds(bounds)
    if crs is None:
        crs = utm_crs((west + east) / 2, (south + north) / 2)
    projected_crs(crs)
    box_m = transformer(WGS84, crs).transform_bounds(west, south, east, north, densify_pts=101)
    rise_m = TALLEST_M if terrain is None else TALLEST_M + RELIEF_M
    reach_m = rise_m / math.tan(math.radians(max(mask_deg, 0.5)))
    wide_m = (box_m[0] - reach_m, box_m[1] - reach_m, box_m[2] + reach_m, box_m[3] + reach_m)
    ground = read_raster(terrain, crs, wide_m) if terrain is not None else None
    source = read_buildings(
        buildings,
        crs,
        bounds_m=wide_m,
        default_height_m=default_height_m,
        level_height_m=level_height_m,
        kind=kind,
        terrain=ground,
    )
    if not (allow_none or _has_building(source, box_m)):
        raise InputError(_no_building(buildings, bounds, source.file_extent_m, crs))
    faults = dict(source.faults)
    census = None
    if blocks is not None:
        census, block_faults = read_blocks(
            blocks,
            table,
            crs,
            block_field=block_field,
            districts_path=districts,
            district_field=district_field,
            commercial=tuple(commercial),
            bounds_m=wide_m,
        )
        faults.update(block_faults)
    roles = {"buildings": buildings, "blocks": blocks, "table": table, "districts": districts, "terrain": terrain}
    return City(
        crs=crs,
        extent_m=source.area.bounds,
        buildings=source.buildings,
        roofs=source.roofs,
        blocks=census,
        terrain=ground,
        terrain_extent_m=None if terrain is None else raster_extent_m(terrain, crs),
        faults=faults,
        counts=source.counts,
        attribution=OSM_CREDIT if str(buildings).lower().endswith(OSM_SUFFIXES) else "",
        sources={role: str(path) for role, path in roles.items() if path is not None},
        bounds=(west, south, east, north),
        area=source.area,
    )


def _has_building(source: BuildingSource, box_m: Bounds) -> bool:
    if source.buildings is not None:
        return bool(shapely.intersects(source.buildings.polygons, shapely.box(*box_m)).any())
    assert source.roofs is not None
    return bool((source.roofs.values > 0).any())


def _no_building(
    path: str | Path, bounds: Sequence[float], extent_m: tuple[float, float, float, float], crs: str
) -> str:
    west, south, east, north = transformer(crs, WGS84).transform_bounds(*extent_m)
    box = shapely.box(west, south, east, north)
    swapped = shapely.box(bounds[1], bounds[0], bounds[3], bounds[2])
    hint = "; latitude and longitude look swapped (longitude comes first)" if shapely.intersects(box, swapped) else ""
    return (
        f"{str(path)!r} has no building in the region {list(bounds)}: it covers about {west:.3f}, {south:.3f}, "
        f"{east:.3f}, {north:.3f} (west, south, east, north){hint}; move [region] bounds there, or set "
        "[buildings] allow_none = true if none is right"
    )
