"""What the maps of a region rest on that no file says, beside what the readers of the city guessed."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from jaxurban.io.city import City
from jaxurban.io.read.guesses import (
    BEYOND_DATA,
    LEAST_SHARE,
    NOMINAL_SKY,
    WITHOUT_DATA,
    Guesses,
    guessed_share,
    share_guess,
)
from jaxurban.io.read.rasterise import highest_top_m
from jaxurban.io.read.sampling import pixel_xy
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


def has_guessed_roofs(city: City, region: Grid) -> bool:
    """Return whether the height of any building in a region is guessed."""
    return city.buildings is not None and guessed_share(city.buildings, region.bounds_m) > 0


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

    A city that is from no files (the synthetic one) has no real sky and nothing beyond its edge.

    Args:
      city, region, sky: of the maps.
      altitude_m: the lowest one.
      bands: rasters or arrays of layers of one's own, by name.
      params, people: settings of the population, and that of every block; None without it.
    """
    guesses = {**city.guesses, **sky.guesses}
    if city.sources:
        _, share = leaving_shares(city, region, sky, altitude_m)
        guesses |= share_guess(
            share,
            BEYOND_DATA,
            f"the visibility results at {altitude_m:g} m are of rays that leave the data below the highest roof and "
            "count as clear there, so GPS may look better than it is: give buildings farther around",
        )
    else:
        guesses.pop(NOMINAL_SKY, None)
    guesses |= _coverage_guesses(city, region) | _hanging_guesses(city, region)
    for name, values in bands.items():
        guesses |= _layer_guesses(name, values[0], region)
    if city.blocks is not None and people is not None:
        if city.sources and city.blocks.day_count is None and {*params.times_of_day} - {"night"}:
            guesses["people by factors"] = (
                f"people by day are not counted: they are the census's times {params.gamma_commercial:g} in commercial "
                f"districts and {params.gamma_residential:g} elsewhere; set [population] gamma_commercial and "
                "gamma_residential"
            )
        guesses |= _scale_guesses(city.blocks, region.bounds_m, people, params)
    return guesses


def _hanging_guesses(city: City, region: Grid) -> Guesses:
    """Return how metrics take what hangs over a region; nothing where nothing does, or where it reaches the ground."""
    if city.buildings is None or city.hanging != SLABS:
        return {}
    hanging = city.buildings.take(city.buildings.min_height_m > 0)
    number = int(shapely.intersects(hanging.polygons, shapely.box(*region.bounds_m)).sum())
    if not number:
        return {}
    return {
        f"{number:,} hanging parts": (
            f"{number:,} parts and decks hang over the region, from their floor to their top: lidar meets those with "
            "their floor at or below the altitude as if they reached the ground, and none above it; paths keep away "
            'from all that is under them; set [buildings] hanging = "to_ground" for none'
        )
    }


def outside_share(region: Grid, known: shapely.Geometry) -> float:
    """Return the share of a region that lies beyond what is known, in the region's CRS."""
    whole = shapely.box(*region.bounds_m)
    return 1.0 - float(shapely.intersection(whole, known).area) / float(whole.area)


def _boxes_asked(city: City, buildings: Footprints, region: Grid) -> list[shapely.Geometry]:
    """Return, around each settlement in a region, the box that its bounds in degrees ask for.

    Such bounds are rounded, stand askew in the CRS and are snapped to cells: they reach a little beyond the walls.
    """
    parts = shapely.get_parts(city.known_area)
    boxes = []
    for part in parts[shapely.intersects(parts, shapely.box(*region.bounds_m))]:
        own = buildings.polygons[shapely.intersects(buildings.polygons, part)]
        if len(own):
            bounds = rounded_outward(lonlat_boxes(own, city.crs))
            box_m = box_of(bounds, city.crs)
            edge_m = max(EDGE_M, region.resolution_m)
            boxes.append(shapely.box(*box_m).buffer(edge_m, join_style="mitre"))
    return boxes


def _coverage_guesses(city: City, region: Grid) -> Guesses:
    """Return how much of the region is taken as free of buildings, or of people, as nothing is known there."""
    share = outside_share(region, city.known_area)
    if share > LEAST_SHARE and city.buildings is not None:
        boxes = _boxes_asked(city, city.buildings, region)
        share = outside_share(region, shapely.union_all([city.known_area, *boxes]))
    guesses = share_guess(
        share,
        WITHOUT_DATA,
        "the region lies beyond what the building source covers and is taken as free of buildings: give a source that "
        "covers it, or a smaller region",
    )
    if city.blocks is not None and city.sources:
        box = shapely.box(*region.bounds_m)
        inhabited_m2 = shapely.area(shapely.intersection(city.blocks.polygons, box)).sum()
        guesses |= share_guess(
            1.0 - float(inhabited_m2) / float(box.area),
            "the region without census",
            "the region lies in no census block and is taken as without people: give blocks that cover it, unless it "
            "is water",
            EMPTY_SHARE,
        )
    return guesses


def _layer_guesses(name: str, band: Raster | np.ndarray, region: Grid) -> Guesses:
    """Return how much of the region a layer's raster closes, as it ends before or has large holes."""
    if not isinstance(band, Raster):
        return {}
    num_rows, num_cols = band.values.shape
    border = shapely.get_coordinates(shapely.segmentize(shapely.box(0, 0, 1, 1), 1 / SIDE_POINTS))
    raster = shapely.Polygon(
        np.stack(pixel_xy(band, border[:, 1] * num_rows, border[:, 0] * num_cols, region.crs), -1)
    )
    return share_guess(
        outside_share(region, shapely.make_valid(raster)),
        f"the region beyond layer {name}",
        f"the region lies beyond the raster of layer {name} and is closed to every path: give a raster that covers it, "
        "or a smaller region",
    ) | share_guess(
        float(np.isnan(band.values).mean()),
        f"layer {name} without a value",
        f"the pixels of layer {name} hold no value and are closed to every path: fill them, unless they are meant to "
        'be closed, or set nan = "error"',
        EMPTY_SHARE,
    )


def leaving_shares(city: City, region: Grid, sky: Sky, altitude_m: float) -> tuple[float, float]:
    """Return the shares of cells and of visibilities whose rays leave the data while a roof could still block them.

    Of cells: those with any such ray. Of visibilities: a cell, a satellite, a time each. Rays start at cells' centres,
    evenly spread: all of them, or as many as make `MOST_RAYS`.
    """
    azimuth_rad = sky.azimuth_rad[sky.is_in_view]
    elevation_rad = sky.elevation_rad[sky.is_in_view]
    num_rays = region.num_rows * region.num_cols * max(len(azimuth_rad), 1)
    stride = math.ceil(math.sqrt(num_rays / MOST_RAYS))
    first_row, first_col = np.minimum(stride, region.shape) // 2
    x_m, y_m = np.meshgrid(region.x_m[first_col::stride], region.y_m[first_row::stride])
    start_m = np.stack([x_m.ravel(), y_m.ravel()], axis=-1)[:, None]
    rise_m = highest_top_m(city) - altitude_m
    leaves = ~stays_within(city.known_ground, start_m, azimuth_rad, elevation_rad, rise_m)
    return float(leaves.any(axis=1).mean()), float(leaves.mean())


def _scale_guesses(
    blocks: Blocks, bounds_m: Bounds, population_layers: BlockLayers, params: Population
) -> Guesses:
    """Return that one block sets the population's scale, at the first time of day where one does."""
    in_region = region_blocks(blocks, bounds_m)
    if params.normalise != "max":
        return {}
    unit = "people" if params.quantity == "count" else "people per km2"
    layers = np.asarray(population_layers.m, float)[:, in_region]
    for m, norm in zip(layers, population_layers.norm_per_km2, strict=True):
        inhabited = m[m > 0]
        num_high = (inhabited > SCALE_M).sum()
        if len(inhabited) >= 3 and num_high <= max(1, SCALE_SHARE * len(inhabited)):
            top = in_region[m.argmax()]
            usual = float(f"{float(norm) * np.percentile(inhabited, 99):.1g}")
            return {
                "one block sets the population scale": (
                    f"census block {blocks.block_id[top]} ({blocks.area_m2[top]:,.0f} m2) with {float(norm):,.0f} "
                    f"{unit} sets the population scale alone: the median inhabited block gets "
                    f'{np.median(inhabited):.2f}; set [population] normalise to a percentile such as "p99" or to a '
                    f"number of {unit} such as {usual:.0f}"
                )
            }
    return {}
