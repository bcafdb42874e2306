"""The synthetic city: towers amid houses, a river and a park; the same arguments give the same city."""

import math
from collections.abc import Sequence

import numpy as np
import shapely

from jaxurban.checks import at_least, typed
from jaxurban.errors import InputError
from jaxurban.io.city import City
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

Box = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max, metres

# The paper's region.
MAX_WIDTH_M = 10_000.0
MAX_HEIGHT_M = 20_000.0
MIN_SIDE_M = 400.0
TOLERANCE = 1.05  # degrees make no exact box, and boxes are snapped outward
# Boxes given in degrees grow to whole multiples of it, which most resolutions divide.
SNAP_M = 100.0
CREDIT = "synthetic city"  # below its pictures, lest a stranger takes them for the place that its box is at

# Avenues run 29 degrees clockwise from grid north, as Manhattan's do. Points of the plan are (across, along) them,
# from the middle of the box; the rows of this matrix are the two directions in the CRS.
BEARING_RAD = math.radians(29.0)
TO_CRS = np.array(
    [
        [math.cos(BEARING_RAD), -math.sin(BEARING_RAD)],
        [math.sin(BEARING_RAD), math.cos(BEARING_RAD)],
    ]
)

# All below is chosen so that it looks like a city, and has no other source. Fractions are of the way from the middle
# to the edge of the box.
RIVER_ACROSS = -0.75
AREAS = np.array(
    [[(RIVER_ACROSS, -50), (-0.2, 0.3)], [(-0.5, 50), (0.25, 0.75)]]
)  # river and park, by two corners
DOWNTOWN = (0.05, -0.1)
DOWNTOWN_RADIUS = 0.3
PITCH_M = np.array([180.0, 90.0])  # of street blocks
MIN_ROWS = 7  # of street blocks in a box
STREET_SHARE = 0.45  # of the pitch from street to street
LOTS = (4, 2)  # of a street block
VACANT_SHARE = 0.15  # of lots
INSET_SHARE = (0.02, 0.1)  # of a lot, between its border and the house
LOWEST_M, TALLEST_M = 5, 390.0
# Heights: their median far from downtown, how much more it is in the middle of it, and how they spread (log-normal).
HOUSE_M, HOUSE_MORE_M, HOUSE_SPREAD = 10, 15, 0.5
TOWER_M, TOWER_MORE_M, TOWER_SPREAD = 45, 100, 0.42
# The chance of a tower is the first times the depth in downtown, less the second.
TOWER_SLOPE, TOWER_LESS = 1.2, 0.1
SHAFT_INSET_SHARE, SHAFT_SHARE = 0.2, 0.6  # of a lot
MIN_BLOCK_M2 = 200.0  # smaller corners of blocks, which the box cuts off, are left out
PEOPLE = (10, 70)  # by night, in each building
NUM_BANDS = 6  # from south to north, of two districts each
NUM_COMMERCIAL = 6  # districts 1 to 6


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

    Streets turned 29 degrees clockwise from grid north, with four by two lots in each block; houses, ever lower away
    from the towers downtown, in the middle of the box; a park and a river without buildings; districts 1 to 6
    (commercial, south) and 7 to 12 (residential, north), 13 in the park and beyond the river; census blocks, each a
    street block out to the middle of its streets. All of it is invented. The plan scales with the box, while street
    blocks and buildings keep their size (boxes under 630 m have smaller ones). Nothing is known beyond the box.

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
    x, y = transformer(WGS84, crs).transform(lon_deg, lat_deg)
    x_min = round((x - width_m / 2) / SNAP_M) * SNAP_M
    y_min = round((y - height_m / 2) / SNAP_M) * SNAP_M
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
    """Return the river and the park of `demo_city_for_bounds`, in its CRS; arguments and errors are the same."""
    extent_m, _ = _box_around(bounds, crs)
    return demo_cover(extent_m)


def demo_cover(extent_m: Box) -> LandCover:
    """Return the river and the park of a synthetic city, by its ``extent_m``."""
    plan = _Plan(extent_m)
    return LandCover(water=plan.river & plan.box, park=plan.park & plan.box)


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
    low_xy, high_xy = np.reshape(box_of(check_bounds(bounds), crs), (2, 2))
    width_m, height_m = high_xy - low_xy
    _check_size(width_m, height_m, f"the box west, south, east, north {list(bounds)}")
    low = np.floor(low_xy / SNAP_M) * SNAP_M
    high = np.ceil(high_xy / SNAP_M) * SNAP_M
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


class _Plan:
    """Where the parts of the city lie in a box.

    Attributes:
      middle_xy: ``[2]`` of the box, in the CRS.
      reach_m: ``[2]`` from there to the edge of the box, across and along the avenues.
      pitch_m: ``[2]`` of the street blocks, across and along the avenues.
      box: the box.
      river, park: their rectangles, out to the middle of streets and beyond the box.
    """

    def __init__(self, extent_m: Box) -> None:
        """Scale the plan to a box; street blocks keep their size where `MIN_ROWS` of them have room."""
        low_xy, high_xy = np.reshape(extent_m, (2, 2))
        half_m = (high_xy - low_xy) / 2
        self.middle_xy = low_xy + half_m
        self.reach_m = np.min(half_m / np.abs(TO_CRS), axis=1)
        self.pitch_m = PITCH_M * min(1.0, 2 * half_m.min() / MIN_ROWS / PITCH_M[1])
        self.box = shapely.box(*extent_m)
        low_m, high_m = np.round(AREAS * self.reach_m / self.pitch_m) * self.pitch_m
        self.river, self.park = self.rectangles(low_m, high_m)

    def rectangles(self, low_m: np.ndarray, high_m: np.ndarray) -> np.ndarray:
        """Return polygons ``[N]`` in the CRS, given by opposite corners ``[N, 2]``: metres across and along."""
        boxes = shapely.box(*low_m.T, *high_m.T)
        return shapely.transform(boxes, lambda metres: self.middle_xy + metres @ TO_CRS)


def _build(extent_m: Box, crs: str, seed: int) -> City:
    """Return the city of a box, a CRS and a seed.

    Args:
      extent_m: the box.
      crs: projected, in metres.
      seed: a whole number from 0 up; the same one gives the same city.
    """
    at_least("seed", seed)
    rng = np.random.default_rng(seed)
    plan = _Plan(extent_m)

    # Street blocks out to the middle of their streets, as far as they lie in the box; none in the river and the park.
    # Rows as far as the mean side of the box reach beyond half its diagonal.
    side_m = plan.box.length / 4
    num_rows = math.ceil(side_m / min(plan.pitch_m))
    steps = np.indices((2 * num_rows, 2 * num_rows)).reshape(2, -1).T - num_rows
    corners_m = steps * plan.pitch_m
    whole = plan.rectangles(corners_m, corners_m + plan.pitch_m)
    outlines = shapely.clip_by_rect(whole, *extent_m)
    is_green = shapely.intersects(plan.river | plan.park, shapely.centroid(whole))
    is_block = ~is_green & (shapely.area(outlines) > MIN_BLOCK_M2)
    low_m = corners_m[is_block]

    # Random numbers are drawn in one order, of which the city depends: for the buildings, then for people.
    buildings, block = _buildings(plan, low_m, rng)
    people = rng.uniform(*PEOPLE, len(block))

    # Districts by their place, from the south 1, 3 .. in the west and 2, 4 .. in the east. The park comes last, a block
    # without people.
    across, along = ((low_m + plan.pitch_m / 2) / plan.reach_m).T
    band = np.floor((along + 1) / 2 * NUM_BANDS).clip(0, NUM_BANDS - 1)
    is_east = across > 0
    by_place = np.where(across < RIVER_ACROSS, OTHER_DISTRICT, 1 + 2 * band + is_east)
    district = np.append(by_place, OTHER_DISTRICT).astype(np.int32)
    zoning = np.where(district <= NUM_COMMERCIAL, Zoning.COMMERCIAL, Zoning.RESIDENTIAL)
    zoning[district == OTHER_DISTRICT] = Zoning.OTHER
    return City(
        crs=crs,
        extent_m=extent_m,
        buildings=buildings,
        blocks=Blocks(
            polygons=np.append(outlines[is_block], plan.park & plan.box),
            night_count=np.bincount(block, people, len(district)).round(),
            district=district,
            zoning=zoning.astype(np.uint8),
            block_id=np.array([f"{number:06d}" for number in range(len(district))], object),
        ),
        attribution=CREDIT,
    )


def _buildings(
    plan: _Plan, block_m: np.ndarray, rng: np.random.Generator
) -> tuple[Footprints, np.ndarray]:
    """Return the buildings on street blocks, and ``[B]`` the number of the block that each stands on.

    Args:
      plan: of the city.
      block_m: ``[N, 2]`` lower corners of the street blocks, metres across and along the avenues.
      rng: the source of random numbers, whose order makes the city: chances, insets, houses, towers.
    """
    street_m = STREET_SHARE * plan.pitch_m.min()
    lot_m = (plan.pitch_m - street_m) / LOTS
    places = np.indices(LOTS).reshape(2, -1).T
    low_m = (block_m[:, None] + street_m / 2 + places * lot_m).reshape(-1, 2)
    num_lots = len(low_m)
    from_downtown = (low_m + lot_m / 2) / plan.reach_m - DOWNTOWN
    # How far downtown each lot lies: 1 in its middle, falling to 0 (a Gaussian).
    depth = np.exp(-np.sum((from_downtown / DOWNTOWN_RADIUS) ** 2, axis=1))

    # By one chance a lot has a tower, downtown as a rule, or is vacant; no house is cut by the edge of the box.
    chance = rng.random(num_lots)
    is_towers = chance < TOWER_SLOPE * depth - TOWER_LESS
    is_occupied = is_towers | (chance < 1 - VACANT_SHARE)
    inset_m = rng.uniform(*INSET_SHARE, (2, num_lots, 2)) * lot_m
    houses = plan.rectangles(low_m + inset_m[0], low_m + lot_m - inset_m[1])
    median_house_m = HOUSE_M + HOUSE_MORE_M * depth
    house_m = median_house_m * np.exp(HOUSE_SPREAD * rng.standard_normal(num_lots))
    is_built = is_occupied & shapely.contains(plan.box, houses)

    # A tower is a shaft on a house, as a part of it. One is the tallest.
    has_tower = is_towers & is_built
    shaft_low_m = low_m[has_tower] + SHAFT_INSET_SHARE * lot_m
    shafts = plan.rectangles(shaft_low_m, shaft_low_m + SHAFT_SHARE * lot_m)
    median_tower_m = TOWER_M + TOWER_MORE_M * depth[has_tower]
    tower_m = median_tower_m * np.exp(TOWER_SPREAD * rng.standard_normal(len(shafts)))
    tower_m[np.argmax(tower_m)] = TALLEST_M

    # Houses, then shafts.
    lot = np.r_[np.flatnonzero(is_built), np.flatnonzero(has_tower)]
    buildings = Footprints(
        polygons=np.r_[houses[is_built], shafts],
        height_m=np.r_[house_m[is_built], tower_m].clip(LOWEST_M, TALLEST_M).round(1),
        min_height_m=np.zeros(len(lot)),
        origin=np.full(len(lot), HeightOrigin.GENERATED, np.uint8),
        is_part=np.arange(len(lot)) >= is_built.sum(),
    )
    return buildings, lot // len(places)
