"""The synthetic city: deterministic, and Manhattan-like enough to show the paper's findings."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
import shapely

from jaxurban.checks import at_least, typed
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.samples.synthetic_streets import DOWNTOWN, MIDTOWN, Box, CityPlan, Land, StreetFrame
from jaxurban.world.blocks import OTHER_DISTRICT, Blocks, Zoning
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import (
    WGS84,
    box_of,
    check_bounds,
    projected_crs,
    transformer,
    utm_crs,
    utm_of,
)
from jaxurban.world.land_cover import LandCover

# The paper's region.
MAX_WIDTH_M = 10_000.0
MAX_HEIGHT_M = 20_000.0
MIN_SIDE_M = 400.0
TOLERANCE = 1.05  # degrees make no exact box, and boxes are snapped outward
# Boxes given in degrees grow to whole multiples of it, which most resolutions divide.
SNAP_M = 100.0

TALLEST_M = {MIDTOWN: 395.0, DOWNTOWN: 380.0}  # the highest tower of each cluster
NUM_COMMERCIAL = 6  # districts 1 to 6
# Slivers that shores, Broadway and the box cut off are left out.
MIN_BLOCK_M2 = 200.0
MIN_BUILDING_M2 = 30.0
CREDIT = "synthetic city"  # below its pictures, lest a stranger takes them for the place that its box is at
WATERFRONT = 0.5  # share of the people who live in a block by the water
# Index 0 is for the suburbs, as 13 % 13 is 0; then districts 1 to 12. Medians and densities are about Manhattan's.
MEDIAN_HEIGHT_M = np.array([8, 34, 19, 18, 24, 40, 30, 26, 30, 18, 17, 19, 16], float)
NIGHT_PER_KM2 = np.array([9, 19, 26, 31, 26, 21, 33, 43, 50, 36, 35, 35, 36], float) * 1e3


@typed
def demo_city(
    width_m: float = MAX_WIDTH_M,
    height_m: float = MAX_HEIGHT_M,
    *,
    centre_lonlat: tuple[float, float] = (-73.97, 40.78),
    crs: str | None = None,
    seed: int = 0,
) -> City:
    """Return the synthetic city in a box of ``width_m`` (east) by ``height_m`` (north).

    An island between two rivers with low-rise suburbs beyond them; streets turned 29 degrees clockwise from grid
    north; a park without buildings; towers downtown at the southern tip and in midtown, just south of the park;
    districts 1 to 6 (commercial, south) and 7 to 12 (residential, north), 13 elsewhere; census blocks, each a street
    block out to the middle of its streets. All of it is invented. The plan scales with the box, while street blocks
    and buildings keep their real size (boxes under about 2 km have smaller blocks). Nothing is known beyond the box.

    Args:
      width_m: side along easting, from 400 m to 10 km.
      height_m: side along northing, from 400 m to 20 km.
      centre_lonlat: longitude and latitude of the middle, degrees.
      crs: projected CRS in metres; left out, the UTM zone of the middle.
      seed: the same one gives the same city.

    Returns:
      The city, with outlines and census blocks, in metres. The same arguments give the same city.

    Raises:
      InputError: a box that is too large or too small, or a CRS that is unknown or not projected in metres.

    Examples:
      >>> small = ju.demo_city(width_m=600, height_m=400)
      >>> small.facts["extent"], len(small.buildings) > 50
      ('0.6 x 0.4 km', True)
    """
    lon_deg, lat_deg = centre_lonlat
    crs = crs or utm_crs(lon_deg, lat_deg)
    projected_crs(crs)
    _check_size(width_m, height_m, "width_m x height_m")
    centre = transformer(WGS84, crs).transform(lon_deg, lat_deg)
    x_min = round((centre[0] - width_m / 2) / SNAP_M) * SNAP_M
    y_min = round((centre[1] - height_m / 2) / SNAP_M) * SNAP_M
    return _build((x_min, y_min, x_min + width_m, y_min + height_m), crs, seed)


def demo_city_for_bounds(bounds: Sequence[float], crs: str | None = None) -> City:
    """Return the synthetic city in a geographic box; see `demo_city`.

    Args:
      bounds: west, south, east, north in degrees; the projected box grows outward to whole 100 m.
      crs: projected CRS in metres; left out, the UTM zone of the middle.

    Raises:
      InputError: bounds that are not a box, too large or small, or a CRS that is unknown or not in metres.
    """
    return _build(*_box_around(bounds, crs), seed=0)


def demo_cover_for_bounds(bounds: Sequence[float], crs: str | None) -> LandCover:
    """Return the rivers and the park of `demo_city_for_bounds`, in its CRS; arguments and errors are the same."""
    extent_m, _ = _box_around(bounds, crs)
    return demo_cover(extent_m)


def demo_cover(extent_m: Box) -> LandCover:
    """Return the rivers and the park of a synthetic city, by its ``extent_m``."""
    plan = CityPlan(extent_m)
    land = shapely.union_all([part.land for part in plan.parts()])
    return LandCover(
        shapely.difference(plan.box, land), shapely.intersection(plan.park(), plan.box)
    )


def _box_around(bounds: Sequence[float], crs: str | None) -> tuple[Box, str]:
    """Return the synthetic city's box around geographic bounds, grown outward to whole `SNAP_M`, and its CRS.

    Args:
      bounds: west, south, east, north in degrees.
      crs: projected, in metres; None for the UTM zone of the middle.

    Raises:
      InputError: as of `demo_city_for_bounds`.
    """
    crs = crs or utm_of(check_bounds(bounds))
    projected_crs(crs)
    x_min, y_min, x_max, y_max = box_of(check_bounds(bounds), crs)
    _check_size(x_max - x_min, y_max - y_min, f"bounds {list(bounds)}")
    low = np.floor(np.array([x_min, y_min]) / SNAP_M) * SNAP_M
    high = np.ceil(np.array([x_max, y_max]) / SNAP_M) * SNAP_M
    return (*low.tolist(), *high.tolist()), crs


def _check_size(width_m: float, height_m: float, what: str) -> None:
    """Raise InputError unless the synthetic city fits a box; ``what`` names the arguments that gave it."""
    fits_width = MIN_SIDE_M <= width_m <= TOLERANCE * MAX_WIDTH_M
    fits_height = MIN_SIDE_M <= height_m <= TOLERANCE * MAX_HEIGHT_M
    if not (fits_width and fits_height):  # so that NaN is refused too
        raise InputError(
            f"{what} is {width_m:.0f} m x {height_m:.0f} m, but the synthetic city fits boxes from {MIN_SIDE_M:.0f} m "
            f"a side to {MAX_WIDTH_M / 1e3:.0f} km (east) x {MAX_HEIGHT_M / 1e3:.0f} km (north): choose another box"
        )


def _clip(polygons: np.ndarray, area: shapely.Polygon) -> np.ndarray:
    """Return ``[N]`` the part of each polygon ``[N]`` in ``area``, empty where there is none."""
    shapely.prepare(area)
    is_cut = ~shapely.contains_properly(area, polygons)
    clipped = polygons.copy()
    clipped[is_cut] = shapely.intersection(polygons[is_cut], area)
    return clipped


def _lay_out_cells(plan: CityPlan, part: Land) -> tuple[np.recarray, np.ndarray]:
    """Return ``N`` street blocks of an area of land, and their outlines as far as they lie ashore and in the box.

    Blocks reach to the middle of the streets around them. The record of a block holds ``low_m`` and ``high_m``
    (``[N, 2]``, two opposite corners along and across the frame of the land), ``centre_xy`` (``[N, 2]`` in the CRS) and
    ``district``. Slivers are left out, and so are blocks in the park.
    """
    # All blocks of the street grid that the box may touch, counted in streets and avenues.
    street_pitch_m, avenue_pitch_m = part.pitch_m
    along_m, across_m = part.frame.local(shapely.get_coordinates(plan.box))
    along = along_m / street_pitch_m
    across = across_m / avenue_pitch_m
    rows = np.arange(math.floor(along.min()), math.ceil(along.max()))
    # Avenues half a pitch off the axis: with an odd number of columns the park lies between two of them.
    columns = np.arange(math.floor(across.min()), math.ceil(across.max()) + 1) - 0.5
    steps = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    low_m = steps * part.pitch_m
    high_m = (steps + 1) * part.pitch_m

    # Those of some size on land.
    outline = _clip(
        shapely.polygons(part.frame.rectangles(*low_m.T, *high_m.T)),
        shapely.intersection(part.land, plan.box),
    )
    kept = shapely.area(outline) > MIN_BLOCK_M2
    centre_xy = part.frame.xy(*((low_m + high_m) / 2).T)
    district = np.full(len(kept), OTHER_DISTRICT, np.int32)
    if part.is_island:
        district = plan.district(centre_xy)
        kept &= ~shapely.contains_xy(plan.park(), centre_xy)
    blocks = _records(low_m=low_m, high_m=high_m, centre_xy=centre_xy, district=district)
    return blocks[kept], outline[kept]


def _records(**columns: np.ndarray) -> np.recarray:
    """Return columns of one length as one array of records, whose attributes are the columns by their names."""
    dtype = [(name, values.dtype, values.shape[1:]) for name, values in columns.items()]
    return np.rec.fromarrays([*columns.values()], dtype=dtype)


def _split(
    rng: np.random.Generator, start: np.ndarray, end: np.ndarray, num: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return ``S`` random segments that fill ``N`` intervals: the interval of each, its start and its end, ``[S]``.

    Lengths within an interval are between 0.6 and 1.4 of each other's mean, scaled so that they fill it.

    Args:
      rng: the source of random numbers.
      start, end: ``[N]`` of the intervals.
      num: ``[N]`` how many segments each has, at least 1.
    """
    owner = np.repeat(np.arange(len(num)), num)
    size = rng.uniform(0.6, 1.4, len(owner))
    total = np.cumsum(size)  # over all intervals, up to the end of each segment
    first = np.cumsum(num) - num  # segment of each interval
    before = np.r_[0.0, total][first][owner]  # total up to the start of the interval
    scale = ((end - start) / np.bincount(owner, size, minlength=len(num)))[owner]
    segment_start = start[owner] + (total - size - before) * scale
    segment_end = start[owner] + (total - before) * scale
    return owner, segment_start, segment_end


def _outline(
    lots: np.recarray, frame: StreetFrame, *points: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return ``[N, K, 2]`` coordinates in the CRS of ``K`` points of each of ``N`` lots.

    Args:
      lots: records of `_lay_out_lots`.
      frame: of their streets.
      points: of each point two arrays ``[N]``: metres behind the front, and metres from the left side of the lot.
    """
    along = np.stack([lots.front_m + lots.sign * depth_m for depth_m, _ in points], axis=-1)
    across = np.stack([lots.left_m + side_m for _, side_m in points], axis=-1)
    return frame.xy(along, across)


def _rectangle(
    lots: np.recarray, frame: StreetFrame, front: Any, back: Any, left: Any, right: Any
) -> np.ndarray:
    """Return ``[N, 4, 2]``: the corners of a rectangle set back from the four sides of each lot.

    Args:
      lots: records of `_lay_out_lots`.
      frame: of their streets.
      front, back, left, right: metres from that side of the lot, ``[N]`` or one number.
    """
    rear = lots.depth_m - back
    far_side = lots.right_m - lots.left_m - right
    front = np.broadcast_to(front, rear.shape)
    left = np.broadcast_to(left, rear.shape)
    corners = (front, left), (front, far_side), (rear, far_side), (rear, left)
    return _outline(lots, frame, *corners)


def _ells(lots: np.recarray, frame: StreetFrame, front: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Return ``[N]`` L-shaped polygons: a bar along the street with a wing behind its left half.

    Args:
      lots: records of `_lay_out_lots`.
      frame: of their streets.
      front, left: ``[N]`` metres from the front and from both sides of the lot.
    """
    wide_m = lots.right_m - lots.left_m
    deep = lots.depth_m * 0.6
    rear = lots.depth_m * 0.93
    right = wide_m - left
    middle = wide_m * 0.45
    ell = (front, left), (front, right), (deep, right), (deep, middle), (rear, middle), (rear, left)
    return shapely.polygons(_outline(lots, frame, *ell))


def _lay_out_lots(
    rng: np.random.Generator,
    part: Land,
    cells: np.recarray,
    is_single: np.ndarray,
    lot_m: np.ndarray,
) -> np.recarray:
    """Return the lots of ``N`` blocks: one row through the block where ``is_single``, else two rows back to back.

    The record of a lot holds ``block`` (its number), ``front_m`` (where its street front lies along the frame),
    ``sign`` (1 where it runs on from there, -1 where it runs back), ``depth_m``, and ``left_m`` and ``right_m`` (its
    sides across the frame).

    Args:
      rng: the source of random numbers.
      part: the land, whose streets the blocks leave free.
      cells: records of the blocks (`_lay_out_cells`).
      is_single: ``[N]`` bool.
      lot_m: ``[N]`` mean width of the lots of a block.
    """
    # Rows of lots: the block of each, and whether it is the second of its block.
    street_m, avenue_m = part.street_m
    row_block = np.repeat(np.arange(len(is_single)), np.where(is_single, 1, 2))
    is_second_row = np.r_[False, row_block[1:] == row_block[:-1]]
    left_m = cells.low_m[row_block, 1] + avenue_m / 2
    right_m = cells.high_m[row_block, 1] - avenue_m / 2
    num_lots = np.maximum(1, np.round((right_m - left_m) / lot_m[row_block])).astype(int)

    # Their lots.
    row, left_m, right_m = _split(rng, left_m, right_m, num_lots)
    block = row_block[row]
    is_second = is_second_row[row]
    low_m = cells.low_m[block, 0] + street_m / 2
    high_m = cells.high_m[block, 0] - street_m / 2
    return _records(
        block=block,
        front_m=np.where(is_second, high_m, low_m),
        sign=np.where(is_second, -1.0, 1.0),
        depth_m=(high_m - low_m) / np.where(is_single[block], 1, 2),
        left_m=left_m,
        right_m=right_m,
    )


def _erect(
    rng: np.random.Generator, plan: CityPlan, part: Land, cells: np.recarray
) -> tuple[Footprints, np.ndarray]:
    """Return the buildings on the street blocks of an area of land, and the number of the block that each stands on.

    All numbers below (shares and chances from 0 to 1, sizes in metres, spreads of logarithms) are chosen so that the
    city looks like Manhattan; they have no other source. The order of random numbers is part of the city: another order
    would make another city of the same seed.

    Args:
      rng: the source of random numbers.
      plan: where towers stand.
      part: the land.
      cells: records of the blocks (`_lay_out_cells`).

    Returns:
      The buildings, first an outline for each lot, then the shafts of towers; ``[N]`` the block of each.
    """
    # What stands on each block: towers near the clusters, slabs around courts, or else rows of houses.
    district = cells.district
    num_blocks = len(district)
    is_island = district != OTHER_DISTRICT
    depths = [plan.depth_in(cluster, cells.centre_xy) * is_island for cluster in TALLEST_M]
    depth = np.max(depths, axis=0)  # in the cluster that is nearest, from 0 to 1
    # The middle of each cluster always has towers, so that no city is too small for them.
    is_core = is_island & np.isin(np.arange(num_blocks), np.argmax(depths, axis=1))
    chance = rng.random(num_blocks)
    has_towers = (chance < 1.2 * depth - 0.1) | is_core
    has_slabs = ~has_towers & (chance > 0.93)

    # The lots of each block, in one row or in two; some blocks are squares and some lots vacant, and are left out.
    is_single = has_towers | has_slabs | ((cells.high_m - cells.low_m)[:, 0] < 55.0)
    lot_m = np.select([has_towers, has_slabs, is_island], [54.0, 60.0, 27.0], 44.0)
    lots = _lay_out_lots(rng, part, cells, is_single, lot_m)
    is_square = rng.random(num_blocks) < np.where(is_island, 0.025 * ~has_towers, 0.05)
    is_vacant = rng.random(len(lots)) < np.where(is_island, 0.04, 0.12)[lots.block]
    lots = lots[is_core[lots.block] | ~(is_square[lots.block] | is_vacant)]
    block = lots.block
    num_lots = len(lots)
    wide_m = lots.right_m - lots.left_m

    # Heights, spread around the median of the district, and setbacks: how far buildings are from the sides of the lot.
    median_m = MEDIAN_HEIGHT_M[district % 13] * (1 + 1.2 * depth)
    median_m = (median_m * np.where(has_slabs, 1.5, 1.0))[block]
    height_m = np.maximum(median_m * np.exp(0.34 * rng.standard_normal(num_lots)), 5.0)
    front_m = np.where(is_island[block], 1.5, 5.0)
    island_side_m = np.where(rng.random(num_lots) < 0.15, 1.5, 0.0)  # most touch their neighbours
    side_m = np.where(is_island[block], island_side_m, rng.uniform(2.0, 4.0, num_lots))
    back_m = lots.depth_m * rng.uniform(0.26, 0.48, num_lots)
    back_m = np.where(is_single[block], front_m, back_m)

    # The form of each outline: the podium of a tower, a court with a hole, an L, or else a bar.
    lot_chance = rng.random(num_lots)
    is_tower = has_towers[block] & ((lot_chance < 0.65) | is_core[block])
    is_court = has_slabs[block] & (wide_m > 48) & (lots.depth_m > 40)
    is_ell = ~is_single[block] & (lot_chance < 0.25)
    is_bar = ~(is_tower | is_court | is_ell)

    # The outlines, set back from the front, the back, the left and the right side of their lots.
    frame = part.frame
    side_of_bar_m = side_m[is_bar]
    bar_m = front_m[is_bar], back_m[is_bar], side_of_bar_m, side_of_bar_m
    ring = _rectangle(lots[is_court], frame, 1.5, 1.5, 1.5, 1.5)
    hole = _rectangle(lots[is_court], frame, 16.0, 16.0, 16.0, 16.0)
    polygons = np.empty(num_lots, object)
    polygons[is_bar] = shapely.polygons(_rectangle(lots[is_bar], frame, *bar_m))
    polygons[is_court] = shapely.polygons(ring, holes=shapely.linearrings(hole)[:, None])
    polygons[is_ell] = _ells(lots[is_ell], frame, front_m[is_ell], side_m[is_ell])
    polygons[is_tower] = shapely.polygons(_rectangle(lots[is_tower], frame, 1.5, 1.5, 1.0, 1.0))

    # A tower is a podium and a shaft, a part that stands on it.
    num_towers = is_tower.sum()
    tower_block = block[is_tower]
    height_m[is_tower] = rng.uniform(15.0, 35.0, num_towers)
    centre_xy = cells.centre_xy[tower_block]
    shafts, top_m = _shafts(rng, plan, lots[is_tower], frame, depth[tower_block], centre_xy)

    # Outlines and shafts together.
    num_outlines = num_lots + num_towers
    buildings = Footprints(
        polygons=np.r_[polygons, shafts],
        height_m=np.concatenate([height_m, top_m]).round(1),
        min_height_m=np.zeros(num_outlines),
        origin=np.full(num_outlines, HeightOrigin.GENERATED, np.uint8),
        is_part=np.arange(num_outlines) >= num_lots,
    )
    return buildings, np.r_[block, tower_block]


def _shafts(
    rng: np.random.Generator,
    plan: CityPlan,
    lots: np.recarray,
    frame: StreetFrame,
    depth: np.ndarray,
    centre_xy: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the shafts of ``N`` towers, ``[N]`` polygons, and the heights of their tops, ``[N]`` metres.

    Those near the middle of a cluster are scaled so that the tallest of them has the cluster's height.

    Args:
      rng: the source of random numbers.
      plan: where the clusters are.
      lots: records of the towers' lots (`_lay_out_lots`).
      frame: of their streets.
      depth: ``[N]`` of the towers' blocks in the cluster that is nearest, from 0 to 1.
      centre_xy: ``[N, 2]`` middles of the towers' blocks in the CRS.
    """
    sides_m = np.repeat([lots.depth_m, lots.right_m - lots.left_m], 2, axis=0)
    inset_m = rng.uniform(0.09, 0.24, sides_m.shape) * sides_m  # front, back, left, right
    shafts = shapely.polygons(_rectangle(lots, frame, *inset_m))
    top_m = (45 + 100 * depth) * np.exp(0.42 * rng.standard_normal(len(lots)))
    for cluster, tallest_m in TALLEST_M.items():
        is_near = plan.depth_in(cluster, centre_xy) > 0.3
        top_m[is_near] *= tallest_m / top_m[is_near].max(initial=1.0)
    return shafts, np.maximum(top_m, 40.0)


def _build(extent_m: Box, crs: str, seed: int) -> City:
    """Return the city of a box, a CRS and a seed, one area of land after the other.

    Args:
      extent_m: the box.
      crs: projected, in metres.
      seed: a whole number from 0 up; the same one gives the same city.
    """
    at_least("seed", seed)
    plan = CityPlan(extent_m)
    rng = np.random.default_rng(seed)
    parts = plan.parts()
    buildings = []
    outlines = []
    people = []
    districts = []
    for part in parts:
        # Buildings, cut at the promenade, the box and Broadway.
        cells, outline = _lay_out_cells(plan, part)
        dry = part.land.buffer(-plan.margin_m)
        houses, block = _erect(rng, plan, part, cells)
        ground = (plan.box & dry) - plan.broadway()
        houses = replace(houses, polygons=_clip(houses.polygons, ground))
        kept = shapely.area(houses.polygons) > MIN_BUILDING_M2
        buildings.append(houses.take(kept))

        # People: by the district's density, half as many by the water, and nobody on a block without a building.
        num_blocks = len(outline)
        spread = np.exp(0.45 * rng.standard_normal(num_blocks) - 0.1)
        per_km2 = NIGHT_PER_KM2[cells.district % 13] * spread
        area_km2 = shapely.area(outline) / 1e6
        is_inland = shapely.contains_properly(dry, outline)
        is_home = np.bincount(block[kept], minlength=num_blocks) > 0
        people.append(np.round(per_km2 * area_km2 * np.where(is_inland, 1.0, WATERFRONT) * is_home))
        outlines.append(outline)
        districts.append(cells.district)

    # The park is a block without people, of the island, which is the first area of land.
    outlines.append(np.array([shapely.intersection(plan.park(), parts[0].land & plan.box)]))
    people.append(np.zeros(1))
    districts.append(np.array([OTHER_DISTRICT], np.int32))

    # All areas of land together.
    district = np.concatenate(districts)
    zoning = np.where(district <= NUM_COMMERCIAL, Zoning.COMMERCIAL, Zoning.RESIDENTIAL)
    zoning[district == OTHER_DISTRICT] = Zoning.OTHER
    return City(
        crs=crs,
        extent_m=extent_m,
        buildings=reduce(Footprints.joined, buildings),
        blocks=Blocks(
            polygons=np.concatenate(outlines),
            night_count=np.concatenate(people),
            district=district,
            zoning=zoning.astype(np.uint8),
            block_id=np.array([f"{number:06d}" for number in range(len(district))], object),
        ),
        attribution=CREDIT,
    )
