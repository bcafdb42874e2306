"""What the maps of a region rest on that no file says, beside what the readers of the city guessed."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from jaxurban.io.city import City
from jaxurban.io.rasterise import highest_top_m
from jaxurban.io.sampling import pixel_xy
from jaxurban.knowledge import LEAST_SHARE, Guesses, GuessKind, guessed
from jaxurban.metrics.population import BlockLayers, Population, region_blocks
from jaxurban.settings import SLABS
from jaxurban.world.blocks import Blocks
from jaxurban.world.extent import lonlat_boxes, rounded_outward
from jaxurban.world.footprints import Footprints
from jaxurban.world.grid import Bounds, Grid, box_of
from jaxurban.world.known import stays_within
from jaxurban.world.raster import Raster
from jaxurban.world.sky import Sky

EMPTY_SHARE = 0.10  # of the region without a census block (rivers and the sea often have none), of a layer's pixels
SCALE_M = 1 / 3  # few inhabited blocks above this m set the scale
SCALE_SHARE = 0.01  # no more than this share of them are few
MOST_RAYS = 200_000  # followed to tell how many leave the data: a second or so
SIDE_POINTS = 32  # along each side of a raster's outline, which another CRS bends
EDGE_M = 20.0  # that snapping to the cells of any usual resolution adds to bounds, at each side


def region_guesses(
    city: City,
    region: Grid,
    sky: Sky,
    altitude_m: float,
    bands: Mapping[str, Sequence[Raster | np.ndarray]],
    params: Population,
    people: BlockLayers | None,
) -> Guesses:
    """Return every guess behind the maps of a region.

    Args:
      city, region, sky: what the maps are made of.
      altitude_m: the lowest altitude of the maps, above ground.
      bands: rasters or arrays of a user's layers, by name.
      params: settings of the population.
      people: the population of every block; None without population.
    """
    guesses = city.guesses + sky.guesses

    # A city from no files (the synthetic one) has no real sky, and nothing stands beyond its edge.
    if city.sources:
        share = leaving_share(city, region, sky, altitude_m)
        guesses += guessed(GuessKind.BEYOND_DATA, share, altitude_m=altitude_m)
    else:
        guesses = tuple(each for each in guesses if each.kind is not GuessKind.NOMINAL_SKY)
    guesses += _coverage_guesses(city, region)
    guesses += _hanging_guesses(city, region)
    for name, values in bands.items():
        guesses += _layer_guesses(name, values[0], region)

    if city.blocks is not None and people is not None:
        if city.sources and city.blocks.day_count is None and {*params.times_of_day} - {"night"}:
            guesses += guessed(
                GuessKind.PEOPLE_BY_FACTORS,
                commercial=params.gamma_commercial,
                residential=params.gamma_residential,
            )
        guesses += _scale_guesses(city.blocks, region.bounds_m, people, params)
    return guesses


def _hanging_guesses(city: City, region: Grid) -> Guesses:
    """Return the guess of how metrics treat what hangs over a region.

    It is empty where nothing hangs there, or where everything that hangs is taken to reach the ground.
    """
    if city.standing is None or city.hanging != SLABS:
        return ()
    hanging = city.standing.take(city.standing.min_height_m > 0)
    number = int(hanging.touches(region.bounds_m).sum())
    return guessed(GuessKind.HANGING, number=number) if number else ()


def outside_share(region: Grid, known: shapely.Geometry) -> float:
    """Return the share, 0 to 1, of a region's area that lies beyond a known area, which is in the region's CRS."""
    whole = shapely.box(*region.bounds_m)
    return 1.0 - float(shapely.intersection(whole, known).area) / float(whole.area)


def _boxes_asked(city: City, buildings: Footprints, region: Grid) -> list[shapely.Geometry]:
    """Return a box around the buildings of each part of the known area in a region, as bounds in degrees would make it.

    Bounds in degrees are rounded, lie askew in the CRS and are snapped to cells, so a region that was made of them
    reaches a little beyond the walls: these boxes too.

    Args:
      city: whose known area counts.
      buildings: of the city.
      region: grid of the maps.
    """
    edge_m = max(EDGE_M, region.resolution_m)
    parts = shapely.get_parts(city.known_area)
    boxes = []
    for part in parts[shapely.intersects(parts, shapely.box(*region.bounds_m))]:
        polygons = buildings.polygons[shapely.intersects(buildings.polygons, part)]
        if len(polygons):
            bounds = rounded_outward(lonlat_boxes(polygons, city.crs))
            box_m = box_of(bounds, city.crs)
            boxes.append(shapely.box(*box_m).buffer(edge_m, join_style="mitre"))
    return boxes


def _coverage_guesses(city: City, region: Grid) -> Guesses:
    """Return the guesses of how much of a region is taken as free of buildings, or of people, without being known so.

    A share that is small enough gives none.
    """
    # The ground on which buildings are not known. Boxes that the source was asked for count as known too.
    share = outside_share(region, city.known_area)
    if share > LEAST_SHARE and city.buildings is not None:
        boxes = _boxes_asked(city, city.buildings, region)
        share = outside_share(region, shapely.union_all([city.known_area, *boxes]))
    guesses = guessed(GuessKind.WITHOUT_DATA, share)

    # The ground in no census block.
    if city.blocks is not None and city.sources:
        box = shapely.box(*region.bounds_m)
        inhabited_m2 = shapely.area(shapely.intersection(city.blocks.polygons, box)).sum()
        empty_share = 1.0 - float(inhabited_m2) / float(box.area)
        guesses += guessed(GuessKind.WITHOUT_CENSUS, empty_share, least=EMPTY_SHARE)
    return guesses


def _layer_guesses(name: str, band: Raster | np.ndarray, region: Grid) -> Guesses:
    """Return the guesses of how much of a region a layer's raster closes, by its end or by holes; none of an array.

    Args:
      name: of the layer.
      band: its first one.
      region: grid of the maps.
    """
    if not isinstance(band, Raster):
        return ()

    # The raster's outline in the region's CRS, with points along its sides, which a projection bends.
    num_rows, num_cols = band.values.shape
    outline = shapely.segmentize(shapely.box(0, 0, 1, 1), 1 / SIDE_POINTS)
    col_share, row_share = shapely.get_coordinates(outline).T
    xy_m = pixel_xy(band, row_share * num_rows, col_share * num_cols, region.crs)
    area = shapely.make_valid(shapely.Polygon(np.stack(xy_m, -1)))

    beyond = guessed(GuessKind.BEYOND_LAYER, outside_share(region, area), layer=name)
    empty_share = np.isnan(band.values).mean()
    return beyond + guessed(GuessKind.EMPTY_LAYER, empty_share, least=EMPTY_SHARE, layer=name)


def leaving_share(city: City, region: Grid, sky: Sky, altitude_m: float) -> float:
    """Return the share, 0 to 1, of rays that leave the data while a roof could still block them.

    There is a ray for each cell, satellite and time.

    Rays start at the centres of cells, evenly spread: at all of them, or at so few that about `MOST_RAYS` are followed.

    Args:
      city, region, sky: what the maps are made of.
      altitude_m: of the cells, above ground.
    """
    azimuth_rad = sky.azimuth_rad[sky.is_in_view]
    elevation_rad = sky.elevation_rad[sky.is_in_view]
    num_rays = region.num_rows * region.num_cols * max(len(azimuth_rad), 1)
    stride = math.ceil(math.sqrt(num_rays / MOST_RAYS))  # every so many cells, both ways
    first_row, first_col = np.minimum(stride, region.shape) // 2
    x_m, y_m = np.meshgrid(region.x_m[first_col::stride], region.y_m[first_row::stride])
    start_m = np.stack([x_m.ravel(), y_m.ravel()], axis=-1)[:, None]
    rise_m = highest_top_m(city) - altitude_m
    stays = stays_within(city.known_ground, start_m, azimuth_rad, elevation_rad, rise_m)
    return float((~stays).mean())


def _scale_guesses(
    blocks: Blocks, bounds_m: Bounds, population_layers: BlockLayers, params: Population
) -> Guesses:
    """Return the guess that one block alone sets the population's scale, or nothing where none does.

    One block does so where hardly any other inhabited block has an m above `SCALE_M`. The guess names the block and
    proposes another scale, for the first time of day at which this is so.

    Args:
      blocks: the census blocks.
      bounds_m: x_min, y_min, x_max, y_max of the region, whose blocks set the scale.
      population_layers: m of the blocks by time of day, and the number of people at which m is 1 (the scale).
      params: settings of the population; only with ``normalise`` ``"max"`` can one block set the scale.
    """
    if params.normalise != "max":
        return ()
    in_region = region_blocks(blocks, bounds_m)
    unit = "people" if params.quantity == "count" else "people per km2"
    layers = np.asarray(population_layers.m, float)[:, in_region]

    # One time of day after the other: m of the region's blocks, and the scale.
    for m, norm in zip(layers, population_layers.norm_per_km2, strict=True):
        inhabited = m[m > 0]
        num_high = (inhabited > SCALE_M).sum()
        if len(inhabited) >= 3 and num_high <= max(1, SCALE_SHARE * len(inhabited)):
            top = in_region[m.argmax()]
            # A number such as the user might set: the 99th percentile of people, rounded to one digit.
            usual = float(f"{float(norm) * np.percentile(inhabited, 99):.1g}")
            return guessed(
                GuessKind.ONE_BLOCK,
                block=str(blocks.block_id[top]),
                area_m2=blocks.area_m2[top],
                people=norm,
                unit=unit,
                median=np.median(inhabited),
                usual=usual,
            )
    return ()
