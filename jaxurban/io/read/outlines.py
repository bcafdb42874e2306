"""Outlines as a vector file holds them, near a region, and the rules that make Footprints of them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from pyproj.exceptions import ProjError

from jaxurban import settings
from jaxurban.errors import InputError
from jaxurban.io.read.heights import estimate_heights, is_given, with_decks
from jaxurban.io.read.issues import ReadIssue, ReadIssues
from jaxurban.settings import SLABS
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import Bounds, transformer

MARGIN_M = 1000.0  # more than projections tilt boxes against each other, and than most outlines and their parts reach
# An outline covered at least so far by its parts is dropped (design, section 3).
REPLACED_SHARE = 0.9
BELONGING_SHARE = 0.5  # a part is an outline's own if at least so much of it lies inside
PODIUM_M2 = 1.0  # less than this between two drawings of one wall is no podium
DECK = "bridge"  # of the tag man_made
_NO = ("no", "false", "0", "0.0")


@dataclass(frozen=True)
class Outlines:
    """Building outlines as a file holds them. ``N`` outlines.

    Attributes:
      polygons: ``[N]`` shapely Polygons or MultiPolygons in ``crs``, valid or not; None where none could be built.
      tags: ``[N]`` arrays of numbers, or of objects (text, numbers or None), by name: ``building``, ``part``,
        ``height``, ``levels``, ``roof_levels``, ``min_height``, ``min_level``, ``location``, ``layer``,
        ``man_made``. All are optional; without ``building`` every outline is a building.
      crs: CRS of the coordinates, x before y.
      boxes: x_min, y_min, x_max, y_max in ``crs`` each, that the file says it covers.
      issues: what the reader met.
      attribution: the credit that the data's licence asks for.
      is_part: whether these are the outlines near a region only.
    """

    polygons: np.ndarray
    tags: Mapping[str, np.ndarray]
    crs: str
    boxes: tuple[Bounds, ...]
    issues: ReadIssues
    attribution: str = ""
    is_part: bool = False

    def column(self, name: str) -> np.ndarray:
        """Return a tag of every outline, ``[N]`` objects, None where it is missing."""
        return self.tags.get(name, np.full(len(self.polygons), None, object))


class Near(NamedTuple):
    """A region whose surroundings are read.

    Attributes:
      bounds_m: x_min, y_min, x_max, y_max; what does not touch them is not needed.
      crs: their projected CRS.
    """

    bounds_m: Bounds
    crs: str

    def box_in(self, crs: str) -> Bounds | None:
        """Return the box of the region and `MARGIN_M` around it in another CRS.

        None where no box holds it: beyond a projection's reach, or across the antimeridian.
        """
        x_min, y_min, x_max, y_max = self.bounds_m
        wide_m = x_min - MARGIN_M, y_min - MARGIN_M, x_max + MARGIN_M, y_max + MARGIN_M
        box = box_between(wide_m, self.crs, crs)
        is_box = box is not None and box[0] < box[2]  # not across the antimeridian
        return box if is_box else None


def box_between(box: Bounds, crs: str, other: str) -> Bounds | None:
    """Return the box in another CRS around a box; None where there is none or it reaches beyond the projection."""
    if not np.isfinite(box).all():
        return None
    try:
        projected = transformer(crs, other).transform_bounds(*box, densify_pts=101)
    except ProjError:
        return None
    return projected if np.isfinite(projected).all() else None


def meets(boxes: np.ndarray, box: Bounds) -> np.ndarray:
    """Return which of the boxes ``[N, 4]`` touch a box, ``[N]`` bool; none that is NaN does."""
    x_min, y_min, x_max, y_max = boxes.T
    return (x_min <= box[2]) & (x_max >= box[0]) & (y_min <= box[3]) & (y_max >= box[1])


def extent_of(boxes: np.ndarray) -> Bounds:
    """Return the box around boxes ``[N, 4]``, NaN left out; inf and -inf without any."""
    low = np.fmin.reduce(boxes[:, :2], initial=np.inf)
    high = np.fmax.reduce(boxes[:, 2:], initial=-np.inf)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def near_rows(boxes: np.ndarray, box: Bounds) -> np.ndarray:
    """Return which features to read, ``[N]`` bool: all that touch the box around those that touch a box.

    So every outline comes with all its parts, and every part with its outline, however large they are.

    Args:
      boxes: ``[N, 4]`` x_min, y_min, x_max, y_max of the features, NaN where they are empty.
      box: the same of the region.
    """
    is_near = meets(boxes, box)
    return meets(boxes, extent_of(boxes[is_near])) if is_near.any() else is_near


def to_buildings(
    file: settings.Buildings, outlines: Outlines, crs: str
) -> tuple[Footprints, list[Bounds], ReadIssues]:
    """Return the buildings that outlines make, the boxes in ``crs`` that the file declares to cover, and read issues.

    Left out are ``building=no`` without ``building:part``, and ``location=underground`` or ``layer`` below 0. An
    outline that its own parts cover to at least 90 % gives way to them; one that is tagged ``building:part`` as well is
    a part itself and stands. A part without usable height takes that of its highest outline, if it is known. An
    underside at or above the roof raises a roof that was only estimated from levels or by default, and is set to 0
    under a roof with a height. Where parts hang, an outline stays below those that no part stands under (`_podiums`).

    Args:
      file: the file of the outlines and what to make of it; with hanging ``"slabs"`` areas of bridges
        (``man_made=bridge``) that are no buildings are decks (see `with_decks`).
      outlines: from a reader.
      crs: projected CRS of the buildings.

    Raises:
      InputError: no building and no declared box, in a file that was read as a whole.
    """
    # Which outlines stand, and their valid polygons.
    issues = dict(outlines.issues)
    stands, is_part, is_deck = _stands_as_what(outlines, file.hanging == SLABS, issues)
    index = np.flatnonzero(stands)
    polygons, is_sound = _project(outlines.polygons[index], outlines.crs, crs, issues)
    polygons = polygons[is_sound]
    index = index[is_sound]
    to_city = transformer(outlines.crs, crs)
    boxes_m = [to_city.transform_bounds(*box, densify_pts=101) for box in outlines.boxes]
    if not (boxes_m or len(index) or outlines.is_part):
        raise InputError(
            f"{str(file.source)!r} holds no building: give a file with polygons of buildings"
        )

    # Their heights.
    is_part = is_part[index]
    is_deck = is_deck[index]
    tags = {name: column[index] for name, column in outlines.tags.items()}
    buildings = estimate_heights(tags, polygons, is_part, file, issues)
    if is_deck.any():
        buildings = with_decks(buildings, is_deck, _layers(outlines.column("layer")[index]))

    # Outlines and their parts: heights of one for the other, and which outlines the parts replace.
    outline, part, shared = _own_parts(polygons, ~is_part & ~is_deck, is_part)
    buildings = _above_underside(_with_outline_heights(buildings, outline, part, issues), issues)
    is_replaced = _covered_share(polygons, outline, shared) >= REPLACED_SHARE
    issues[ReadIssue.OUTLINES_REPLACED_BY_PARTS] = int(np.sum(is_replaced))
    if file.hanging == SLABS:
        buildings, is_podium = _podiums(buildings, outline, part, is_replaced)
        issues[ReadIssue.OUTLINES_KEPT_AS_PODIUMS] = int(np.sum(is_podium))
        is_replaced &= ~is_podium
    buildings = buildings.take(~is_replaced)
    issues[ReadIssue.PARTS_HANGING] = int(np.sum(buildings.min_height_m > 0))
    return buildings, boxes_m, issues


def _texts(column: np.ndarray) -> np.ndarray:
    """Return a tag of every outline as text in small letters, ``[N]``, empty where it is missing."""
    words = np.full(len(column), "", object)
    is_filled = is_given(column)
    words[is_filled] = [str(value).strip().lower() for value in column[is_filled]]
    return words


def _layers(column: np.ndarray) -> np.ndarray:
    """Return the numbers in a tag of every outline, ``[N]`` float64, NaN where there is none."""
    return pd.to_numeric(pd.Series(_texts(column)), errors="coerce").to_numpy(np.float64)


def _stands_as_what(
    outlines: Outlines, has_decks: bool, issues: ReadIssues
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which outlines stand, and which of all are parts, and which are decks of bridges, ``[N]`` bool each.

    Args:
      outlines: with their tags.
      has_decks: whether areas of bridges that are no buildings are decks; otherwise they are left out.
      issues: gets how many are no buildings, and how many are underground.
    """

    def is_yes(name: str) -> np.ndarray:
        """Return where a tag has any value but those that mean no."""
        text = _texts(outlines.column(name))
        return (text != "") & ~np.isin(text.astype(str), _NO)

    is_part = is_yes("part")
    is_deck = has_decks & (_texts(outlines.column("man_made")) == DECK)
    is_building = np.ones(len(is_part), bool)  # all, of files that do not say it
    if "building" in outlines.tags:
        is_building = is_yes("building") | is_part
        is_deck &= ~is_building
        is_building |= is_deck

    is_below = _texts(outlines.column("location")) == "underground"
    is_below |= _layers(outlines.column("layer")) < 0
    issues[ReadIssue.NOT_BUILDINGS] = int(np.sum(~is_building))
    issues[ReadIssue.UNDERGROUND] = int(np.sum(is_building & is_below))
    return is_building & ~is_below, is_part, is_deck & ~is_part


def _project(
    polygons: np.ndarray, source: str, crs: str, issues: ReadIssues
) -> tuple[np.ndarray, np.ndarray]:
    """Return polygons in another CRS, valid and without heights, and which of them could be made, ``[N]`` bool.

    Args:
      polygons: ``[N]`` of any kind, None where there is none.
      source: their CRS.
      crs: projected CRS of the result.
      issues: gets how many were repaired, were beyond repair, or lie where ``crs`` does not reach.
    """
    to_city = transformer(source, crs).transform
    if shapely.has_z(polygons).any():
        polygons = shapely.force_2d(polygons)
    polygons = shapely.transform(polygons, to_city, interleaved=False)
    is_there = ~shapely.is_missing(polygons) & ~shapely.is_empty(polygons)
    vertices, polygon = shapely.get_coordinates(polygons, return_index=True)
    is_finite = np.ones(len(polygons), bool)
    is_finite[polygon[~np.isfinite(vertices).all(axis=1)]] = False
    is_sound = is_there & is_finite

    to_repair = np.flatnonzero(is_sound & ~shapely.is_valid(polygons))
    polygons[to_repair] = [polygonal(made) for made in shapely.make_valid(polygons[to_repair])]
    is_sound &= ~shapely.is_empty(polygons)

    issues[ReadIssue.OUTSIDE_CRS] = int(np.sum(is_there & ~is_finite))
    num_repaired = int(np.sum(is_sound[to_repair]))
    issues[ReadIssue.POLYGONS_REPAIRED] = issues.get(ReadIssue.POLYGONS_REPAIRED, 0) + num_repaired
    issues[ReadIssue.POLYGONS_DROPPED] = int(np.sum(~is_there)) + len(to_repair) - num_repaired
    return polygons, is_sound


def polygonal(geometry: shapely.Geometry) -> shapely.Geometry:
    """Return the polygons of a geometry or collection, as one Polygon or MultiPolygon; empty if it has none."""
    # Twice: a collection may hold MultiPolygons.
    parts = shapely.get_parts(shapely.get_parts(geometry))
    return shapely.union_all(parts[shapely.get_dimensions(parts) == 2])


def _own_parts(
    polygons: np.ndarray, is_outline: np.ndarray, is_part: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return every pair of an outline and a part of its own: `BELONGING_SHARE` of the part at least lies inside it.

    Args:
      polygons: ``[N]`` valid polygons.
      is_outline, is_part: ``[N]`` bool, which of them are outlines, and which are parts.

    Returns:
      ``[P]`` indices of the outlines and of the parts, and ``[P]`` geometries, what each pair shares.
    """
    outlines = np.flatnonzero(is_outline)
    parts = np.flatnonzero(is_part)
    near_outline, near_part = shapely.STRtree(polygons[parts]).query(
        polygons[outlines], predicate="intersects"
    )
    outline = outlines[near_outline]
    part = parts[near_part]
    shared = shapely.intersection(polygons[outline], polygons[part])
    is_own = shapely.area(shared) >= BELONGING_SHARE * shapely.area(polygons[part])
    return outline[is_own], part[is_own], shared[is_own]


def _covered_share(polygons: np.ndarray, outline: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Return how much of each polygon the union of its own parts covers, ``[N]`` in [0, 1], 0 without a part.

    Args:
      polygons: ``[N]`` valid polygons.
      outline, shared: ``[P]`` from `_own_parts`.
    """
    share = np.zeros(len(polygons))
    order = np.argsort(outline, kind="stable")  # the pairs of each outline one after the other
    owners, starts, counts = np.unique(outline[order], return_index=True, return_counts=True)
    for owner, start, count in zip(owners, starts, counts, strict=True):
        covered = shapely.union_all(shared[order[start : start + count]])
        share[owner] = shapely.area(covered) / shapely.area(polygons[owner])
    return share


def _podiums(
    buildings: Footprints, outline: np.ndarray, part: np.ndarray, is_replaced: np.ndarray
) -> tuple[Footprints, np.ndarray]:
    """Return buildings in which replaced outlines are podiums where they have one, and which these are, ``[N]`` bool.

    A podium lies under an outline's own hanging parts where none of its parts stands, up to their lowest floor.

    Args:
      buildings: ``N`` outlines and parts.
      outline, part: ``[P]`` indices of outlines and their own parts.
      is_replaced: ``[N]`` bool, which outlines give way to their parts.
    """
    polygons = buildings.polygons.copy()
    height_m = buildings.height_m.copy()
    origin = buildings.origin.copy()
    is_podium = np.zeros(len(polygons), bool)
    hangs = buildings.min_height_m > 0
    for owner in np.unique(outline[is_replaced[outline] & hangs[part]]):
        own = part[outline == owner]
        hanging = own[hangs[own]]
        standing = shapely.union_all(polygons[own[~hangs[own]]])
        below = shapely.intersection(polygons[hanging], buildings.polygons[owner])
        bare = shapely.difference(below, standing)
        is_wide = shapely.area(bare) > PODIUM_M2
        hanging = hanging[is_wide]
        # Without a part over bare ground the owner itself, which is no higher than itself.
        lowest = hanging[np.argmin(buildings.min_height_m[hanging])] if len(hanging) else owner
        if buildings.min_height_m[lowest] > buildings.min_height_m[owner]:
            polygons[owner] = polygonal(shapely.union_all(bare[is_wide]))
            is_podium[owner] = True
            height_m[owner] = buildings.min_height_m[lowest]
            origin[owner] = buildings.origin[lowest]
    return replace(buildings, polygons=polygons, height_m=height_m, origin=origin), is_podium


def _with_outline_heights(
    buildings: Footprints, outline: np.ndarray, part: np.ndarray, issues: ReadIssues
) -> Footprints:
    """Return buildings in which parts without a height have that of their highest outline whose height is known.

    Args:
      buildings: ``N`` outlines and parts.
      outline, part: ``[P]`` indices of outlines and their own parts.
      issues: gets how many parts were given a height.
    """
    height_m = buildings.height_m.copy()
    origin = buildings.origin.copy()
    is_default = origin == HeightOrigin.DEFAULT
    # A part that hangs above its outline's roof is not as high as it but higher.
    takes = (
        is_default[part] & ~is_default[outline] & (height_m[outline] > buildings.min_height_m[part])
    )
    # From the lowest outline up, so that of several outlines of a part the highest is written last.
    lowest_first = np.flatnonzero(takes)[np.argsort(height_m[outline[takes]], kind="stable")]
    outline = outline[lowest_first]
    part = part[lowest_first]
    height_m[part] = buildings.height_m[outline]
    origin[part] = buildings.origin[outline]
    issues[ReadIssue.PARTS_GIVEN_OUTLINE_HEIGHT] = len(np.unique(part))
    return replace(buildings, height_m=height_m, origin=origin)


def _above_underside(buildings: Footprints, issues: ReadIssues) -> Footprints:
    """Return buildings every roof of which is above its underside.

    A roof at or below its underside is raised by the underside's height if it is an estimate, by levels or by default;
    if its height is known, the underside is set to 0, and ``issues`` gets how many these were.
    """
    height_m = buildings.height_m
    min_height_m = buildings.min_height_m
    is_wrong = min_height_m >= height_m
    is_estimate = buildings.origin != HeightOrigin.HEIGHT
    issues[ReadIssue.MIN_HEIGHTS_ABOVE_ROOF] = int(np.sum(is_wrong & ~is_estimate))
    raised_m = np.where(is_wrong & is_estimate, height_m + min_height_m, height_m)
    return replace(
        buildings,
        height_m=raised_m,
        min_height_m=np.where(is_wrong & ~is_estimate, 0.0, min_height_m),
    )
