"""Files to City. The reader of a file of buildings is chosen by the content of the file.

A further format of outlines takes a module with a function that returns the `Outlines` of a file, at least those near
a region, a line in `OUTLINE_READERS`, and one in `jaxurban.io.sniff`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyproj
import shapely

from jaxurban import settings
from jaxurban.checks import one_of
from jaxurban.cities.buildings import to_buildings
from jaxurban.cities.census import read_blocks
from jaxurban.cities.columns import named_columns
from jaxurban.cities.estimates import names_estimates
from jaxurban.cities.guesses import census_guesses, height_guesses, structure_guesses
from jaxurban.cities.lidar import Points, heights_of_points, read_points
from jaxurban.cities.osm import OSM_SUFFIXES, header_box, is_osm, read_osm
from jaxurban.cities.outlines import Near, Outlines
from jaxurban.cities.plausible import (
    TALLEST_PLANT_M,
    check_are_heights,
    filled_terrain,
    pixel_guesses,
    plants_guesses,
    read_plants,
    terrain_guesses,
)
from jaxurban.cities.raster import (
    RASTER_SUFFIXES,
    check_is_no_surface,
    check_range,
    heights_of_surface,
    raster_extent_m,
    read_raster,
    zero_is_ground,
)
from jaxurban.cities.stands import is_water
from jaxurban.cities.tiles import ARCHIVE, READERS, read_tiles
from jaxurban.cities.vector import OTHER_SUFFIXES, VECTOR_SUFFIXES, read_vector
from jaxurban.errors import GuessWarning, InputError, not_there, warn
from jaxurban.io.city import City, joined_credits
from jaxurban.io.issues import ReadIssue, ReadIssues, num_of
from jaxurban.io.samples import SAMPLES, located, sample_name, structures_of
from jaxurban.io.sampling import heights_above, pixel_xy
from jaxurban.io.sniff import LIDAR, sniff
from jaxurban.io.stored import ZARR_FOLDER
from jaxurban.knowledge import HIGHEST_M, Guesses, GuessKind, guessed, warn_of
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.population import FILES, Population, check_has_people
from jaxurban.settings import SLABS
from jaxurban.world.blocks import Blocks
from jaxurban.world.extent import MAIN_SHARE, main_bounds, meets
from jaxurban.world.grid import (
    WGS84,
    Bounds,
    box_of,
    check_bounds,
    known_crs,
    projected_crs,
    transformer,
    utm_of,
    where_it_lies,
)
from jaxurban.world.kinds import ALL_KINDS, KindName
from jaxurban.world.raster import Raster

OutlineReader = Callable[..., Outlines]  # of a path, a `Near` or None, and settings or None


def _read_osm(path: Path, near: Near | None, file: settings.Buildings | None) -> Outlines:
    """Return all outlines of OpenStreetMap, as nodes lie anywhere before their ways; it has no columns to name."""
    return read_osm(path)


OUTLINE_READERS: dict[str, OutlineReader] = {  # by `sniff`, or by the file's own suffix
    **dict.fromkeys(OSM_SUFFIXES, _read_osm),
    **dict.fromkeys((*VECTOR_SUFFIXES, *OTHER_SUFFIXES), read_vector),
    **dict.fromkeys((*READERS, ARCHIVE), read_tiles),
}
COLUMNS_SAID = "height_column, ground_column and levels_column are for tables of outlines"
GEOD = pyproj.Geod(ellps="WGS84")
GAP_M = 500.0  # side of the bins: buildings in bins that touch know what lies between them (streets, parks, rivers)
BLOCKS_A_SIDE = 64  # into which a raster with holes is cut
# Surface minus terrain dips below 0 by noise, at cuttings by tens of metres.
ROOF_RANGE_M = -100.0, HIGHEST_M
SMALL_BYTES = 16 * 2**20  # of a file of outlines
GUESSED_OF = {  # what is said of what readers met
    ReadIssue.POLYGONS_DROPPED: GuessKind.WITHOUT_SHAPE,
    ReadIssue.SOLIDS_COARSE: GuessKind.COARSE_SOLIDS,
}
TALLEST_M = 1000.0  # no roof stands higher; bounds how far away its shadow can come from
PLANTS_REACH_M = 1000.0  # farther than a lidar of a drone sees
RELIEF_M = 1000.0  # terrain is read as far as a hill this much higher could shadow the region


class _Region(NamedTuple):
    """The region of a city, and how far around it files are read.

    Attributes:
      bounds: west, south, east, north in degrees.
      crs: projected CRS of the city, and of the boxes x_min, y_min, x_max, y_max.
      box_m: of the region.
      wide_m: from where a shadow reaches the region.
      near_m: in which plants count.
    """

    bounds: Bounds
    crs: str
    box_m: Bounds
    wide_m: Bounds
    near_m: Bounds


class _Sections(NamedTuple):
    """What the settings say of the files of a city."""

    buildings: settings.Buildings
    terrain: settings.Terrain
    people: Population
    vegetation: settings.Vegetation

    def files(self, kinds: tuple[KindName, ...]) -> dict[str, Any]:
        """Return the names of all files by role, as they are written here, None where there is none."""
        return {
            "buildings": self.buildings.source,
            "structures": structures_of(self.buildings.source, kinds),
            "terrain": self.terrain.source,
            "vegetation": self.vegetation.source,
            **{role: getattr(self.people, role) for role in FILES},
        }


def read_city(
    buildings: settings.Buildings,
    *,
    bounds: Sequence[float] | None,
    crs: str | None,
    population: Population | None,
    terrain: settings.Terrain,
    gps: Gps | None,
    vegetation: settings.Vegetation,
    kinds: tuple[KindName, ...],
) -> City:
    """Return the city that files hold around a region; arguments, warnings and errors are as of `City.from_files`."""
    read_points.cache_clear()  # what was read of a file before may have changed
    asked, own_gps, people = _with_sample(buildings.source, bounds, gps, population)
    named = _with_lidar(_Sections(buildings, terrain, people, vegetation))
    files = named.files(kinds)
    placed = _Sections(*map(_placed, named))
    check_has_people(placed.people, placed.people.has_blocks)
    region, standing = _read_standing(placed, files["structures"], asked, crs, gps or Gps())
    blocks, block_issues, of_people = _read_people(placed.people, region)
    city = replace(
        standing,
        blocks=blocks,
        read_issues={**standing.read_issues, **block_issues},
        attribution=joined_credits(standing.attribution, *(each.credit for each in placed)),
        sources={role: str(path) for role, path in files.items() if path is not None},
        bounds=region.bounds,
        gps=own_gps,
        population=population and placed.people,
        heights=placed.buildings,
        kinds=kinds,
    )
    of_city = _guesses_of(city, placed.buildings, region)
    guesses = of_city + of_people + _relief_guesses(city, region)
    warn_of(guesses)
    return replace(city, guesses=guesses)


def _read_standing(
    sections: _Sections,
    structures: str | None,
    asked: Sequence[float] | None,
    crs: str | None,
    gps: Gps,
) -> tuple[_Region, City]:
    """Return the region of a city, and a city of its ground and of what stands on it.

    Args:
      sections: which name the files by their paths.
      structures: as ``beside`` of `read_buildings`.
      asked: bounds of the region, degrees; None for all that the file of buildings covers.
      crs, gps: as of `_region_of`.

    Raises:
      InputError: as of `City.from_files`, but of people.
    """
    file = sections.buildings
    covered, outlines = asked, None
    if asked is None:
        covered, outlines = _extent(file.source, file.crs, file)
    region = _region_of(covered, crs, gps, sections.terrain.source is not None)
    ground, ground_extent_m, of_ground = _read_ground(sections, region)
    plants, of_plants = _read_plants(sections, ground, region)
    city = read_buildings(
        file,
        region.crs,
        bounds_m=region.wide_m,
        terrain=ground,
        beside=structures,
        whole=outlines,
    )
    _check_heights(file, city, ground)
    _check_is_not_empty(file, city, region)
    if asked is None:
        _warn_of_far_buildings(file, city, region)
    return region, replace(
        city,
        terrain=ground,
        terrain_extent_m=ground_extent_m,
        vegetation=plants,
        guesses=of_ground + of_plants + city.guesses,
    )


def _with_lidar(sections: _Sections) -> _Sections:
    """Return sections in which lidar points of buildings are those of the ground and of plants too."""
    source = sections.buildings.source
    if sniff(located(source)) != LIDAR:
        return sections
    terrain = replace(sections.terrain, source=sections.terrain.source or source)
    vegetation = replace(sections.vegetation, source=sections.vegetation.source or source)
    return sections._replace(terrain=terrain, vegetation=vegetation)


def _with_sample(
    source: Any, bounds: Sequence[float] | None, gps: Gps | None, people: Population | None
) -> tuple[Sequence[float] | None, Gps | None, Population]:
    """Return bounds, satellites and people, of which a sample city (`SAMPLES`) gives those that are left out."""
    people = people or Population()
    sample = SAMPLES.get(sample_name(source) or "")
    if sample is None:
        return bounds, gps, people
    if bounds is None:
        bounds = sample["region"]["bounds"]
    if not people.has_blocks:
        own_files = sample.get("population", {}).items()
        left_out = {name: file for name, file in own_files if not getattr(people, name)}
        people = replace(people, **left_out)
    return bounds, gps or Gps(**sample["gps"]), people


def _region_of(bounds: Any, crs: str | None, gps: Gps, has_relief: bool) -> _Region:
    """Return a region with the boxes around it.

    Satellites are in view down to the mask alone. Plants count nearby; where they hide satellites, those on hills do
    too.

    Args:
      bounds: west, south, east, north in degrees.
      crs: projected CRS of the city; None for the UTM zone of the region's middle.
      gps: the mask, and whether plants hide satellites.
      has_relief: whether the ground may rise.
    """
    region = check_bounds(bounds)
    if crs is None:
        crs = utm_of(region)
    projected_crs(crs)
    box_m = box_of(region, crs)
    relief_m = RELIEF_M if has_relief else 0.0
    rise_per_m = math.tan(math.radians(max(gps.lowest_mask_deg, 0.5)))
    wide_m = (TALLEST_M + relief_m) / rise_per_m
    plants_m = TALLEST_PLANT_M + relief_m * (gps.plants == "hide")
    near_m = max(PLANTS_REACH_M, plants_m / rise_per_m)
    box = shapely.box(*box_m)
    around_m = (box.buffer(each_m, join_style="mitre").bounds for each_m in (wide_m, near_m))
    return _Region(region, crs, box_m, *around_m)


def _read_ground(
    sections: _Sections, region: _Region
) -> tuple[Raster | None, Bounds | None, Guesses]:
    """Return the ground by a raster or lidar points, the box of the file, and what was guessed; None without a file."""
    path = sections.terrain.source
    if path is None:
        return None, None, ()
    num_low = 0
    if sniff(path) == LIDAR:
        points = _points_of(path, sections.buildings)
        ground = points.ground
        num_low = points.counts[ReadIssue.GROUND_FAR_BELOW]
        extent_m = area_of_raster(ground, region.crs).bounds
    else:
        ground = read_raster(path, region.crs, region.wide_m)
        extent_m = raster_extent_m(path, region.crs)
    name = repr(str(path))
    ground, guesses = filled_terrain(name, ground, region.crs, region.box_m)
    guesses += guessed(GuessKind.LOW_GROUND, float(num_low > 0), number=num_low, file=name)
    return ground, extent_m, guesses


def _read_plants(
    sections: _Sections, ground: Raster | None, region: _Region
) -> tuple[Raster | None, Guesses]:
    """Return the heights of plants by a raster or lidar points, and what was guessed; None without a file.

    Args:
      sections: which name the file.
      ground: on which plants of points stand.
      region: of the city.

    Raises:
      InputError: lidar points without the ground; as of `read_plants`.
    """
    path = sections.vegetation.source
    if path is None:
        return None, ()
    if sniff(path) != LIDAR:
        plants = read_plants(path, region.crs, region.near_m, region.box_m)
    elif ground is None:
        raise InputError(
            f"plants of the lidar points {str(path)!r} stand on the ground: give its elevation as "
            "[terrain] source, which may be the same file"
        )
    else:
        plants = heights_above(_points_of(path, sections.buildings).plants, ground)
        plants = replace(plants, values=np.nan_to_num(plants.values))
    return plants, plants_guesses(repr(str(path)), plants, region.crs, region.box_m)


def _read_people(people: Population, region: _Region) -> tuple[Blocks | None, ReadIssues, Guesses]:
    """Return census blocks, what was met and what was guessed; None without a file of them."""
    if not people.has_blocks:
        return None, {}, ()
    blocks, issues = read_blocks(people, region.crs, region.wide_m, region.box_m)
    return blocks, issues, census_guesses(issues, blocks, people)


def _guesses_of(city: City, file: settings.Buildings, region: _Region) -> Guesses:
    """Return ``city.guesses`` and what was guessed of heights, of what else stands, and of what has no shape."""
    guesses = (
        *city.guesses,
        *height_guesses(city.buildings, city.learned, region.crs, region.box_m, file),
        *structure_guesses(city.others, region.box_m),
    )
    for issue, kind in GUESSED_OF.items():
        number = city.read_issues.get(issue, 0)
        guesses += guessed(kind, float(number > 0), number=number)
    return guesses


def _relief_guesses(city: City, region: _Region) -> Guesses:
    """Return what was guessed of the ground."""
    if city.terrain is None:
        return guessed(GuessKind.FLAT_GROUND)
    stands = city.roofs if city.standing is None else city.standing
    return terrain_guesses(stands, city.terrain, region.crs, region.box_m)


def _check_heights(file: settings.Buildings, city: City, ground: Raster | None) -> None:
    """Raise InputError where heights look like elevations, unless ``allow`` has "high"."""
    if "high" not in file.allow:
        stands = city.roofs if city.buildings is None else city.buildings
        check_are_heights(repr(str(file.source)), stands, city.crs, city.extent_m, ground)


def _check_is_not_empty(file: settings.Buildings, city: City, region: _Region) -> None:
    """Raise InputError where no building is in the region, unless ``allow`` has "none"."""
    has_outline = city.buildings is not None and city.buildings.touches(region.box_m).any()
    has_roof = city.roofs is not None and (city.roofs.values > 0).any()
    if has_outline or has_roof or "none" in file.allow:
        return
    where = where_it_lies(lonlat_extent(file.source, file.crs), region.bounds)
    # Files of OpenStreetMap are in degrees.
    remedy = "" if is_osm(file.source) else " set [buildings] crs if the file declares a wrong one,"
    raise InputError(
        f"{str(file.source)!r} has no building in the region {list(region.bounds)}: {where}; "
        f'move [region] bounds there,{remedy} or set [buildings] allow = ["none"] if there are none'
    )


def _warn_of_far_buildings(file: settings.Buildings, city: City, region: _Region) -> None:
    """Warn where most buildings stand in a small part of a region that is as large as their file."""
    if city.buildings is None:
        return
    main = main_bounds(city.buildings.polygons, region.crs, region.bounds)
    if main is not None:
        warn(covers_too_much(file.source, region.bounds, main), GuessWarning)


def _points_of(path: str | Path, buildings: settings.Buildings) -> Points:
    """Return the lidar points of a file; the CRS of the settings holds where it is that of the buildings."""
    is_theirs = Path(path) == Path(buildings.source)
    return read_points(Path(path), buildings.kind, buildings.crs if is_theirs else None)


def _placed(section: Any) -> Any:
    """Return a section of settings in which each file, one of a sample city too, stands with its path."""
    paths = {
        name: located(file)
        for name, file in vars(section).items()
        if name in ("source", *FILES) and file is not None
    }
    return replace(section, **paths)


def read_buildings(
    file: settings.Buildings,
    crs: str,
    *,
    bounds_m: Bounds | None = None,
    terrain: Raster | None = None,
    beside: str | Path | None = None,
    whole: Outlines | None = None,
) -> City:
    """Return the buildings in a file as a city without anything else, with the area where the file knows what stands.

    Args:
      file: names the file and says how it is read.
      crs: projected CRS of the city.
      bounds_m: x_min, y_min, x_max, y_max in ``crs``; buildings whose box does not touch it are left out. Which parts
        replace which outlines does not depend on it. None keeps all buildings.
      terrain: elevation of the ground, which a raster of surface elevations needs.
      beside: the file of what else stands in a sample city.
      whole: all outlines of the file, where they were read before.

    Raises:
      InputError: no such file, a format that is not read, a file that cannot be read or is in a wrong CRS, (raster)
        cells that are not heights or look like elevations, or a surface without terrain or that is not a raster.
    """
    projected_crs(crs)
    if isinstance(file.highest_m, Mapping):
        for kind in file.highest_m:
            one_of("a kind of highest_m", kind, ALL_KINDS)
    path = Path(file.source)
    reader = _reader_of(path, file.crs)
    _check_settings_fit(file, reader)
    if reader is None:
        return _read_roofs(file, crs, bounds_m, terrain)
    read = reader if beside is None else partial(read_vector, beside=located(beside))
    # A small file is read whole, and a large one says nothing of unknown heights: they are the same for each region.
    is_small = path.suffix != ARCHIVE and path.is_file() and path.stat().st_size <= SMALL_BYTES
    near = None if is_small or bounds_m is None else Near(bounds_m, crs)
    outlines = whole or read(path, near, file)
    city = _city_of(file, outlines, crs, bounds_m, is_small)
    if city.buildings or not outlines.is_part:
        return city
    # A file without a building near the region is read whole, so that all it covers is known.
    return _city_of(file, read(path, None, file), crs, bounds_m, is_small)


def _check_settings_fit(file: settings.Buildings, read: OutlineReader | None) -> None:
    """Raise InputError if settings are meant for a file of another kind.

    Args:
      file: the settings.
      read: as of `_reader_of`.
    """
    is_raster = read is None
    is_osm_file = read is _read_osm
    is_lidar = is_raster and sniff(file.source) == LIDAR
    meant_for = ""
    if is_raster and file.hanging == SLABS:
        meant_for = 'hanging = "slabs" is for outlines'
    elif not is_raster and file.kind == "surface":
        meant_for = 'kind = "surface" is for rasters'
    elif file.crs is not None and (is_osm_file or (is_raster and not is_lidar)):
        meant_for = "crs is for outlines and lidar points"
    elif is_raster and file.heights is not None:
        meant_for = "heights is for outlines"
    elif (is_raster or is_osm_file) and named_columns(file):
        meant_for = COLUMNS_SAID
    if meant_for:
        raise InputError(f"[buildings] {meant_for}, and {str(file.source)!r} is none: leave it out")


def _reader_of(path: Path, crs: str | None = None) -> OutlineReader | None:
    """Return the function that reads a file of outlines; None for a raster.

    Args:
      path: of the file, or a folder of tiles.
      crs: in place of the one that outlines declare; OpenStreetMap has one.

    Raises:
      InputError: no such file, or a format that is not read.
    """
    if not path.exists():
        raise InputError(not_there(path))
    if (path / ZARR_FOLDER).is_dir():
        raise InputError(
            f"{str(path)!r} is a folder of maps, which open_maps opens: name a file of buildings"
        )
    suffix = path.suffix.lower()
    if suffix in RASTER_SUFFIXES or sniff(path) == LIDAR:
        return None
    if crs is not None:
        known_crs(crs)
    kind = sniff(path) or (ARCHIVE if path.is_dir() else "")
    read = OUTLINE_READERS.get(kind) or OUTLINE_READERS.get(suffix)
    if read is None:
        known = ", ".join((*OUTLINE_READERS, *RASTER_SUFFIXES))
        raise InputError(
            f"{str(path)!r} has the suffix {suffix!r} and no content that is known: buildings are read from {known}, "
            "and from outlines packed as .gz or .bz2"
        )
    return read if crs is None or read is _read_osm else partial(read, crs=crs)


def lonlat_extent(path: str | Path, crs: str | None = None) -> Bounds:
    """Return west, south, east, north in degrees of the box that a file of buildings or a raster covers.

    For a file of OpenStreetMap it is the box that the file declares. For one that declares none and for other files of
    outlines it is the box around all outlines, for which the whole file is read.

    Args:
      path: of the file.
      crs: in place of the one that it declares, as of `settings.Buildings`.

    Raises:
      InputError: a file that cannot be read, or one without an outline.
    """
    return _extent(path, crs, None)[0]


def _extent(
    path: str | Path, crs: str | None, rules: settings.Buildings | None
) -> tuple[Bounds, Outlines | None]:
    """Return the box of `lonlat_extent`, and all outlines of the file where these were read for it, by settings."""
    file = Path(path)
    read = _reader_of(file, crs)
    if sniff(path) == LIDAR:
        return area_of_raster(read_points(file, "height", crs).highest, WGS84).bounds, None
    if read is None:
        return raster_extent_m(path, WGS84), None
    box = header_box(path) if read is _read_osm else None
    if box is not None:
        return box, None
    whole = read(file, None, rules)
    outlines = whole.take(~is_water(whole))  # shores lead far away
    if not len(outlines.polygons) or shapely.is_empty(outlines.polygons).all():
        raise InputError(
            f"{str(path)!r} holds no outline that would say where it lies: give bounds"
        )
    box = shapely.total_bounds(outlines.polygons)
    extent = transformer(outlines.crs, WGS84).transform_bounds(*box)
    if not 0 <= extent[2] - extent[0] <= 180:
        raise InputError(
            f"{str(path)!r} covers half the Earth, or lies on both sides of the antimeridian, across which no region "
            "reaches: give bounds, there on one side, to 180 or from -180; what stands on the other counts too"
        )
    return extent, whole


def proposed_bounds(
    file: settings.Buildings, extent: Sequence[float], crs: str | None
) -> Bounds | None:
    """Return the box in which most buildings of a file stand (see `main_bounds`); None for a raster.

    Args:
      file: names the file and says how it is read.
      extent: the box that the file covers (`lonlat_extent`).
      crs: projected CRS of the city; None for the UTM zone of the middle of ``extent``.

    Raises:
      InputError: as of `read_buildings`.
    """
    file = _placed(file)
    if _reader_of(Path(file.source)) is None:
        return None
    crs = crs or utm_of(extent)
    buildings = read_buildings(file, crs).buildings
    return None if buildings is None else main_bounds(buildings.polygons, crs, extent)


def size_m(extent: Sequence[float]) -> tuple[float, float]:
    """Return the sides in metres of a box in degrees: from west to east in its middle, and from south to north."""
    west, south, east, north = extent
    middle = (south + north) / 2
    east_west_m = GEOD.line_length([west, east], [middle, middle])
    return east_west_m, GEOD.line_length([west, west], [south, north])


def covers_too_much(path: str | Path, extent: Sequence[float], main: Sequence[float]) -> str:
    """Return the warning that a file covers much more than the box of most of its buildings, while no bounds are given.

    Args:
      path: path of the file.
      extent: west, south, east, north in degrees of the box that the file covers.
      main: the same of the box in which most of its buildings stand.
    """
    east_west_m, north_south_m = size_m(extent)
    return (
        f"bounds are left out and {str(path)!r} covers {east_west_m / 1000:.3g} x {north_south_m / 1000:.3g} km, but "
        f"{100 * MAIN_SHARE:.0f} % of its buildings stand in a small part of that: bounds = {list(main)}"
    )


def _city_of(
    file: settings.Buildings, outlines: Outlines, crs: str, bounds_m: Bounds | None, learns: bool
) -> City:
    """Return the city of the buildings that outlines make, and of the area where the file knows what stands.

    Args:
      file: names the file and says how it is read.
      outlines: what a reader has read from the file.
      crs: projected CRS of the city.
      bounds_m: x_min, y_min, x_max, y_max in ``crs`` of a box; buildings whose own box touches it are kept, and the
        part of the area near it. None keeps everything. If neither a building nor a declared box is there, the area is
        that of the whole file, or empty if only a part of the file was read.
      learns: as of `to_buildings`.
    """
    found = to_buildings(file, outlines, crs, learns)
    buildings, structures = found.buildings, found.structures
    area = shapely.Polygon()
    if bounds_m is not None:
        buildings = buildings.take(meets(buildings.boxes_m.T, bounds_m))
        structures = structures.take(meets(structures.boxes_m.T, bounds_m))
        declared = shapely.box(*np.reshape(found.boxes_m, (-1, 4)).T)
        near = shapely.intersection(shapely.box(*bounds_m), declared)
        area = area_of_outlines(buildings.polygons, [box.bounds for box in near if box.area])
    if area.is_empty and not outlines.is_part:
        area = area_of_outlines(found.buildings.polygons, found.boxes_m)
    return City(
        crs=crs,
        extent_m=area.bounds,
        buildings=buildings,
        area=area,
        read_issues=found.issues,
        attribution=outlines.attribution,
        hanging=file.hanging,
        structures=structures,
        learned=found.learned,
    )


def _read_roofs(
    file: settings.Buildings, crs: str, bounds_m: Bounds | None, terrain: Raster | None
) -> City:
    """Return the city of a raster of heights, or of lidar points.

    Cells below 0, the noise of surface minus terrain, count as ground; a read issue says how many they are.

    Args:
      file: names it; its ``kind`` is ``"surface"`` for elevations of roofs and ground, ``"height"`` for heights.
      crs: projected CRS of the city.
      bounds_m: as of `read_buildings`.
      terrain: as of `read_buildings`.

    Raises:
      InputError: as of `read_buildings`.
    """
    path = Path(file.source)
    name = repr(str(path))
    guesses: Guesses = ()
    if sniff(path) == LIDAR:
        roofs, issues = heights_of_points(name, _points_of(path, file), terrain, crs)
    elif file.kind == "surface":
        surface = read_raster(path, crs, bounds_m)
        roofs, issues = heights_of_surface(name, surface, terrain, crs)
    else:
        raster, guesses = zero_is_ground(path, read_raster(path, crs, bounds_m))
        check_range(name, raster.values, ROOF_RANGE_M)
        check_is_no_surface(name, raster, crs)
        is_below = raster.values < 0
        roofs = replace(raster, values=np.where(is_below, np.float32(0), raster.values))
        issues = {ReadIssue.CELLS_BELOW_GROUND: num_of(is_below)}
    check_range(name, roofs.values, ROOF_RANGE_M)
    area = area_of_raster(roofs, crs)
    guesses += pixel_guesses(roofs, crs)
    guesses += guessed(GuessKind.PIXELS_OF_MODEL, float(names_estimates(path.name)), file=name)
    return City(crs, area.bounds, roofs=roofs, area=area, read_issues=issues, guesses=guesses)


def area_of_outlines(polygons: np.ndarray, boxes: Sequence[Bounds]) -> shapely.Geometry:
    """Return the area that a file of outlines knows: the boxes that it declares, and a box around each settlement.

    A building far off has a box of its own, and does not make the land between known.

    Args:
      polygons: ``[N]`` the outlines, in a CRS in metres.
      boxes: x_min, y_min, x_max, y_max of each box that the file declares to cover.
    """
    # The declared boxes, with the boxes of outlines on their borders.
    declared = shapely.union_all([shapely.box(*box) for box in boxes])
    is_inside = shapely.covers(declared, polygons)
    is_apart = ~shapely.intersects(declared, polygons)
    on_border = shapely.box(*shapely.bounds(polygons[~is_inside & ~is_apart]).T)
    known = shapely.union_all([declared, *on_border])
    apart = polygons[is_apart]
    if not len(apart):
        return known
    return shapely.union_all([known, *_settlements(shapely.bounds(apart))])


def _settlements(bounds: np.ndarray) -> np.ndarray:
    """Return a box around the outlines of each settlement: of those whose centres lie in square bins that touch.

    Args:
      bounds: ``[N, 4]`` of outlines.
    """
    centre = (bounds[:, :2] + bounds[:, 2:]) / 2
    bins, bin_of = np.unique(np.floor(centre / GAP_M), axis=0, return_inverse=True)
    bin_of = bin_of.reshape(-1)  # NumPy 2.0 keeps the axis
    corner = bins * GAP_M
    # Grown by a metre, so that bins that touch at a corner are joined too.
    grown = shapely.box(*(corner - 1.0).T, *(corner + GAP_M + 1.0).T)
    joined = shapely.get_parts(shapely.union_all(grown))
    _, settlement_of_bin = shapely.STRtree(joined).query(shapely.points(corner), predicate="within")
    by_settlement = pd.DataFrame(bounds).groupby(settlement_of_bin[bin_of])
    hulls = by_settlement.agg({0: "min", 1: "min", 2: "max", 3: "max"})
    return shapely.box(*hulls.to_numpy().T)


def area_of_raster(raster: Raster, crs: str) -> shapely.Geometry:
    """Return the area in ``crs`` where a raster holds data.

    A raster with holes is cut into blocks, `BLOCKS_A_SIDE` a side, and the area is that of the blocks with any data.
    """
    is_known = np.isfinite(raster.values)
    num_rows, num_cols = is_known.shape
    pixels = shapely.box(0, 0, num_cols, num_rows) if is_known.all() else _known_pixels(is_known)

    # Straight sides of pixels bend in another CRS, so they are cut into short pieces before.
    area = shapely.segmentize(pixels, max(num_rows, num_cols) / BLOCKS_A_SIDE)
    return shapely.transform(
        area, lambda col, row: pixel_xy(raster, row, col, crs), interleaved=False
    )


def _known_pixels(is_known: np.ndarray) -> shapely.Geometry:
    """Return the blocks of a raster that hold any data, ``[Y, X]``, in columns and rows."""
    # Blocks of a small raster are narrower than a pixel: some borders are the same.
    row, col = (
        np.unique(np.linspace(0, num, BLOCKS_A_SIDE + 1).astype(int)) for num in is_known.shape
    )
    has_any = np.logical_or.reduceat(is_known, row[:-1], axis=0)
    has_any = np.logical_or.reduceat(has_any, col[:-1], axis=1)
    i, j = np.nonzero(has_any)
    return shapely.union_all(shapely.box(col[j], row[i], col[j + 1], row[i + 1]))
