"""What the readers of a city repaired, guessed or left out, counted."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class ReadIssue(StrEnum):
    """What the readers of a city repaired, guessed or left out; ``run.json`` counts them under these names.

    Attributes:
      OPEN_WAYS: not closed.
      WAYS_WITH_MISSING_NODES: nodes that the file does not hold.
      DEGENERATE_WAYS: closed and complete, but without area: fewer than three corners.
      RELATIONS_INCOMPLETE: members or their nodes missing.
      NON_POLYGONS: points and lines, left out.
      POLYGONS_REPAIRED: invalid, or not assembled by libosmium.
      POLYGONS_DROPPED: missing or empty, so that it is not known where they are.
      OUTSIDE_CRS: where the city's CRS does not reach.
      NOT_BUILDINGS: building=no without building:part, left out.
      UNDERGROUND: location=underground, level below 0, no level above the ground, or parking below it, left out.
      RAZED, PLANNED: buildings that do not stand any more, or not yet, left out.
      NOT_STANDING: left out for the reasons of `jaxurban.cities.rules`: piers, cameras, sites of plants, low things.
      UNKNOWN_EXTENT: something stands or may stand there, but its extent or kind is not known.
      UNKNOWN_HEIGHT: structures without a height.
      OUTLINES_REPLACED_BY_PARTS: covered by their own parts to 90 % or more.
      OUTLINES_KEPT_AS_PODIUMS: of these, under hanging parts where no part stands, up to the lowest floor.
      PARTS_GIVEN_OUTLINE_HEIGHT: parts without a height of their own.
      PARTS_HANGING: underside above the ground.
      MIN_HEIGHTS_ABOVE_ROOF: underside at or above the roof, set to 0.
      SOLIDS: buildings of three dimensions, read as the prisms of their faces.
      SOLIDS_COARSE: of a lower level of detail, or of the height that the file gives, as these are more than 3 m higher
        than those of a higher level.
      HEIGHTS_UNUSABLE: unreadable, 0, negative or too high.
      LEVELS_UNUSABLE: the same of levels.
      MIN_HEIGHTS_UNUSABLE: the same of the heights of undersides.
      HEIGHTS_BELOW_LEVELS: less than 1.5 m for each level: the levels count instead.
      CELLS_BELOW_GROUND: taken for ground.
      GROUND_FAR_BELOW: cells of lidar points whose ground lies far below all around, left out.
      CELLS_NEAR_GROUND: of a surface model: taken for ground.
      BLOCKS_WITHOUT_COUNT: kept with 0 people: no row, or a count that cannot be read.
      COUNTS_UNREADABLE: of these, those with a count that cannot be read.
      COUNTS_WITHOUT_BLOCK: rows of the table for blocks that the whole blocks file lacks.
      BLOCKS_WITHOUT_POLYGON: left out.
      BLOCKS_WITHOUT_DISTRICT: in district 13.
      INVALID_BLOCK_POLYGONS: repaired.
      INVALID_DISTRICT_POLYGONS: repaired.
      COMMERCIAL_NOT_FOUND: labels on the commercial list that no district has.
    """

    OPEN_WAYS = "open_ways"
    WAYS_WITH_MISSING_NODES = "ways_with_missing_nodes"
    DEGENERATE_WAYS = "degenerate_ways"
    RELATIONS_INCOMPLETE = "relations_incomplete"
    NON_POLYGONS = "non_polygons"
    POLYGONS_REPAIRED = "polygons_repaired"
    POLYGONS_DROPPED = "polygons_dropped"
    OUTSIDE_CRS = "outside_crs"
    NOT_BUILDINGS = "not_buildings"
    UNDERGROUND = "underground"
    RAZED = "razed"
    PLANNED = "planned"
    NOT_STANDING = "not_standing"
    UNKNOWN_EXTENT = "unknown_extent"
    UNKNOWN_HEIGHT = "unknown_height"
    OUTLINES_REPLACED_BY_PARTS = "outlines_replaced_by_parts"
    OUTLINES_KEPT_AS_PODIUMS = "outlines_kept_as_podiums"
    PARTS_GIVEN_OUTLINE_HEIGHT = "parts_given_outline_height"
    PARTS_HANGING = "parts_hanging"
    MIN_HEIGHTS_ABOVE_ROOF = "min_heights_above_roof"
    SOLIDS = "solids"
    SOLIDS_COARSE = "solids_coarse"
    HEIGHTS_UNUSABLE = "heights_unusable"
    LEVELS_UNUSABLE = "levels_unusable"
    MIN_HEIGHTS_UNUSABLE = "min_heights_unusable"
    HEIGHTS_BELOW_LEVELS = "heights_below_levels"
    CELLS_BELOW_GROUND = "cells_below_ground"
    GROUND_FAR_BELOW = "ground_far_below"
    CELLS_NEAR_GROUND = "cells_near_ground"
    BLOCKS_WITHOUT_COUNT = "blocks_without_count"
    COUNTS_UNREADABLE = "counts_unreadable"
    COUNTS_WITHOUT_BLOCK = "counts_without_block"
    BLOCKS_WITHOUT_POLYGON = "blocks_without_polygon"
    BLOCKS_WITHOUT_DISTRICT = "blocks_without_district"
    INVALID_BLOCK_POLYGONS = "invalid_block_polygons"
    INVALID_DISTRICT_POLYGONS = "invalid_district_polygons"
    COMMERCIAL_NOT_FOUND = "commercial_not_found"


ReadIssues = dict[ReadIssue, int]
LEFT_OUT = (  # why nothing stands where a file names something
    ReadIssue.NOT_BUILDINGS,
    ReadIssue.UNDERGROUND,
    ReadIssue.RAZED,
    ReadIssue.PLANNED,
    ReadIssue.NOT_STANDING,
    ReadIssue.POLYGONS_DROPPED,
)


def num_of(is_one: Any) -> int:
    """Return how many of an array or a column of bool are true."""
    return int(is_one.sum())


def listed_counts(counts: Mapping[str, int]) -> str:
    """Return counts as a text, the largest first: ``"12 masts, 3 tanks"``; those of 0 are left out."""
    largest_first = sorted(counts.items(), key=lambda item: -item[1])
    return ", ".join(f"{num:,} {name.replace('_', ' ')}" for name, num in largest_first if num)
