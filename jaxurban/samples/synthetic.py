"""The synthetic city: streets, blocks, one park and one tower, the same for the same seed."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely

from jaxurban.checks import at_least, typed
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.world.blocks import OTHER_DISTRICT, Blocks, Zoning
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import (
    WGS84,
    Bounds,
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
CREDIT = "synthetic city"  # below its pictures, lest a stranger takes them for the place that its box is at

# Streets lie as Manhattan's do: 29 degrees clockwise from grid north. Pairs are across and along the avenues.
BEARING_RAD = np.radians(29.0)
BLOCK_M = np.array([200.0, 90.0])  # from the middle of a street to that of the next
STREET_M = np.array([60.0, 40.0])
LOTS = np.array([5, 2])  # of a block: two rows, back to back
# The park's ends as shares of the box's width and height, from its middle; it has one block at least.
PARK_SHARE = np.array([0.06, 0.2])
CENTRE_SHARE = 0.25  # radius of the centre, as a share of the box's sides
MIN_AREA_M2 = 30.0  # houses and blocks of which the box leaves less are left out

# Invented, but much as in Manhattan. Of pairs, the second is what the centre adds.
MEDIAN_HEIGHT_M = 13.0, 45.0
HEIGHT_SPREAD = 0.9  # greatest logarithm of a height over its median, either way
SHARE_BUILT = 0.6, 0.35
# Of the tower's podium and shaft; insets are from the middle of the streets.
TOWER_HEIGHTS_M = 25.0, 320.0
TOWER_INSETS_M = np.array([[30.0, 20.0], [76.0, 26.0]])
# Of the park, of the centre and of what lies around it.
DISTRICTS = np.array([OTHER_DISTRICT, 1, 2], np.int32)
ZONINGS = np.array([Zoning.OTHER, Zoning.COMMERCIAL, Zoning.RESIDENTIAL], np.uint8)
PEOPLE_PER_M2 = np.array([0.0, 0.01, 0.08])  # at night, of the ground that houses cover


class StreetBlocks(NamedTuple):
    """Street blocks, out to the middle of the streets around them. ``N`` blocks.

    Attributes:
      corner_m: ``[N, 2]`` their first corner in the frame of the streets, see `_turned`.
      outlines: ``[N]`` polygons in the CRS, cut by the box.
      is_park: ``[N]`` bool.
      depth: ``[N]`` how deep in the centre they lie: 1 where the tower stands, falling to 0 (a Gaussian).
    """

    corner_m: np.ndarray
    outlines: np.ndarray
    is_park: np.ndarray
    depth: np.ndarray


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

    Streets are turned 29 degrees clockwise from grid north, between blocks of 200 m x 90 m. The block in the middle
    has a tower of 320 m on a podium. North of it lies a park without buildings. Around it houses are high and stand
    close (district 1, commercial); farther out they are lower and sparser (district 2, residential). Each street block
    is a census block. All of it is invented. Centre and park scale with the box. Nothing is known beyond the box.

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
    x_m, y_m = transformer(WGS84, crs).transform(lon_deg, lat_deg)
    x_min = round((x_m - width_m / 2) / SNAP_M) * SNAP_M
    y_min = round((y_m - height_m / 2) / SNAP_M) * SNAP_M
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
    """Return the park of `demo_city_for_bounds`, in its CRS; there is no water. Arguments and errors are the same."""
    extent_m, _ = _box_around(bounds, crs)
    blocks = _street_blocks(extent_m)
    return LandCover(
        water=shapely.Polygon(), park=shapely.union_all(blocks.outlines[blocks.is_park])
    )


def _box_around(bounds: Sequence[float], crs: str | None) -> tuple[Bounds, str]:
    """Return the synthetic city's box around geographic bounds, grown outward to whole `SNAP_M`, and its CRS.

    Args:
      bounds: west, south, east, north in degrees.
      crs: projected, in metres; None for the UTM zone of the middle.

    Raises:
      InputError: as of `demo_city_for_bounds`.
    """
    crs = crs or utm_of(check_bounds(bounds))
    projected_crs(crs)
    low_m, high_m = np.reshape(box_of(check_bounds(bounds), crs), (2, 2))
    width_m, height_m = high_m - low_m
    _check_size(width_m, height_m, f"bounds {list(bounds)}")
    low_m = np.floor(low_m / SNAP_M) * SNAP_M
    high_m = np.ceil(high_m / SNAP_M) * SNAP_M
    return (*low_m.tolist(), *high_m.tolist()), crs


def _check_size(width_m: float, height_m: float, what: str) -> None:
    """Raise InputError unless the synthetic city fits a box; ``what`` names the arguments that gave it."""
    fits_width = MIN_SIDE_M <= width_m <= TOLERANCE * MAX_WIDTH_M
    fits_height = MIN_SIDE_M <= height_m <= TOLERANCE * MAX_HEIGHT_M
    if not (fits_width and fits_height):  # so that NaN is refused too
        raise InputError(
            f"{what} is {width_m:.0f} m x {height_m:.0f} m, but the synthetic city fits boxes from {MIN_SIDE_M:.0f} m "
            f"a side to {MAX_WIDTH_M / 1e3:.0f} km (east) x {MAX_HEIGHT_M / 1e3:.0f} km (north): choose another box"
        )


def _turned(low_m: np.ndarray, high_m: np.ndarray, extent_m: Bounds) -> np.ndarray:
    """Return ``[N]`` rectangles in the CRS as far as they lie in the box, some of them empty.

    Args:
      low_m, high_m: ``[N, 2]`` opposite corners in the frame of the streets: metres across and along the avenues from
        the middle of the box.
      extent_m: the box.
    """
    middle_m = np.reshape(extent_m, (2, 2)).mean(axis=0)
    sin = np.sin(BEARING_RAD)
    cos = np.cos(BEARING_RAD)
    turn = np.array([[cos, -sin], [sin, cos]])
    rectangles = shapely.box(*low_m.T, *high_m.T)
    in_crs = shapely.transform(rectangles, lambda across_along: across_along @ turn + middle_m)
    return shapely.intersection(in_crs, shapely.box(*extent_m))


def _steps(start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` all pairs of a step across and one along the avenues, from ``start`` to before ``stop``."""
    return np.stack(np.meshgrid(*map(np.arange, start, stop)), axis=-1).reshape(-1, 2)


def _street_blocks(extent_m: Bounds) -> StreetBlocks:
    """Return the street blocks of a box, of which some part lies in it."""
    low_m, high_m = np.reshape(extent_m, (2, 2))
    side_m = high_m - low_m
    reach = np.ceil(side_m.sum() / 2 / BLOCK_M)  # blocks from the middle to beyond any corner
    steps = _steps(-reach, reach + 1)
    corner_m = (steps - 0.5) * BLOCK_M
    park_end = np.maximum(np.round(PARK_SHARE * side_m / BLOCK_M), [0, 1])
    radii = steps * BLOCK_M / (CENTRE_SHARE * side_m)
    blocks = StreetBlocks(
        corner_m=corner_m,
        outlines=_turned(corner_m, corner_m + BLOCK_M, extent_m),
        is_park=(steps[:, 1] > 0) & np.all(np.abs(steps) <= park_end, axis=1),
        depth=np.exp(-np.sum(radii**2, axis=1)),
    )
    is_kept = shapely.area(blocks.outlines) > MIN_AREA_M2
    return StreetBlocks(*(column[is_kept] for column in blocks))


def _houses(
    rng: np.random.Generator, blocks: StreetBlocks, extent_m: Bounds
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``H`` houses on the lots of street blocks: ``[H]`` outlines, heights in metres and numbers of the blocks.

    Each fills its lot from side to side, and from the street to a yard of random depth.
    """
    # The lots, but for those of the park and of the tower.
    lot_m = (BLOCK_M - STREET_M) / LOTS
    steps = _steps(0 * LOTS, LOTS)
    has_lots = ~blocks.is_park & (blocks.depth < 1)
    block = np.repeat(np.flatnonzero(has_lots), len(steps))
    steps = np.tile(steps, (has_lots.sum(), 1))
    low_m = blocks.corner_m[block] + STREET_M / 2 + steps * lot_m
    high_m = low_m + lot_m

    # What stands on them.
    depth = blocks.depth[block]
    yard_m = lot_m[1] * rng.uniform(0.1, 0.4, len(block))
    is_front = steps[:, 1] == 0
    high_m[is_front, 1] -= yard_m[is_front]
    low_m[~is_front, 1] += yard_m[~is_front]
    median_m = MEDIAN_HEIGHT_M[0] + MEDIAN_HEIGHT_M[1] * depth
    height_m = median_m * np.exp(rng.uniform(-HEIGHT_SPREAD, HEIGHT_SPREAD, len(block)))
    outlines = _turned(low_m, high_m, extent_m)
    is_built = rng.random(len(block)) < SHARE_BUILT[0] + SHARE_BUILT[1] * depth
    is_built &= shapely.area(outlines) > MIN_AREA_M2
    return outlines[is_built], height_m[is_built].round(1), block[is_built]


def _build(extent_m: Bounds, crs: str, seed: int) -> City:
    """Return the city of a box, a CRS and a seed.

    Args:
      extent_m: the box.
      crs: projected, in metres.
      seed: a whole number from 0 up; the same one gives the same city.
    """
    at_least("seed", seed)
    blocks = _street_blocks(extent_m)
    houses, height_m, block = _houses(np.random.default_rng(seed), blocks, extent_m)

    # The tower: a podium, and a shaft, which is a part of it.
    corner_m = blocks.corner_m[blocks.depth == 1]
    tower = _turned(corner_m + TOWER_INSETS_M, corner_m + BLOCK_M - TOWER_INSETS_M, extent_m)
    num_outlines = len(houses) + len(tower)

    # People live in the houses.
    num_blocks = len(blocks.outlines)
    covered_m2 = np.bincount(block, shapely.area(houses), num_blocks)
    kind = np.select([blocks.is_park, blocks.depth > 0.5], [0, 1], 2)
    return City(
        crs=crs,
        extent_m=extent_m,
        buildings=Footprints(
            polygons=np.r_[houses, tower],
            height_m=np.r_[height_m, TOWER_HEIGHTS_M],
            min_height_m=np.zeros(num_outlines),
            origin=np.full(num_outlines, HeightOrigin.GENERATED, np.uint8),
            is_part=np.arange(num_outlines) > len(houses),
        ),
        blocks=Blocks(
            polygons=blocks.outlines,
            night_count=np.round(PEOPLE_PER_M2[kind] * covered_m2),
            district=DISTRICTS[kind],
            zoning=ZONINGS[kind],
            block_id=np.array([f"{number:06d}" for number in range(num_blocks)], object),
        ),
        attribution=CREDIT,
    )
