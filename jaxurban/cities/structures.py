"""What stands beside buildings: the height, what is likely, the bound, the shape and the underside of each."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban import settings
from jaxurban.cities.bridges import DECK, KindSizes, bridges_of
from jaxurban.cities.heights import estimate_heights, parse_length_m, read_column
from jaxurban.cities.kinds import (
    ABOVE_LEVELS_M,
    BRIDGE,
    CROWN_SHARE,
    FENCE,
    GUYS_SHARE,
    HISTORIC,
    HULL,
    LEVEL_LIMIT_M,
    LIMIT_M,
    LOW_BUILDINGS,
    LOW_LIMIT_M,
    MONUMENT,
    RIDE,
    RIDE_SHARE,
    TURBINE,
    UNLISTED,
    WALLS,
    WOOD,
)
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.wires import in_spans, with_supports
from jaxurban.io.issues import ReadIssue, ReadIssues, num_of
from jaxurban.io.learned import CLASSES_M2, Learned, learned_from, of_classes
from jaxurban.world.footprints import BUILDING, UNKNOWN, Footprints, HeightOrigin
from jaxurban.world.kinds import PLANTS, WIRES

MOST_RADIUS_M = 100.0  # of what is a point: more is a slip of the unit
OCTAGON = 1 / math.cos(math.pi / 8)  # its circle outside to that inside: crowns are octagons
GUYS = "guys of a mast"  # the rule of what is around it
# Kinds whose names say how high they are; others are learned of no heights.
LEARNED_KINDS = ("chimney", "tank", "tower", "mast", "pole", "pylon", "crane", "turbine", *PLANTS)


class _Others(NamedTuple):
    """Structures before they have an extent, ``N``.

    Attributes:
      outlines: with lines of wires as their spans.
      kinds, names: ``[N]`` objects, a `Kind` each, and its name.
      dimension: 0 of points, 1 of lines, 2 of areas.
      sizes: by kind, of bridges each its own.
      stated: with the heights that the file says.
      has_height: where that is one that can be read; elsewhere it has no meaning.
      measured_m: the height that the file gives of all of it, 0 without one; bridges name that of their deck.
      levels_limit_m: the bound by a number of levels, NaN without one.
      guess_m, likely_m: what is learned by name, NaN where the height is known or nothing is learned.
    """

    outlines: Outlines
    kinds: np.ndarray
    names: np.ndarray
    dimension: np.ndarray
    sizes: KindSizes
    stated: Footprints
    has_height: np.ndarray
    measured_m: np.ndarray
    levels_limit_m: np.ndarray
    guess_m: np.ndarray
    likely_m: np.ndarray


def to_structures(
    file: settings.Buildings,
    outlines: Outlines,
    buildings: Footprints,
    waters: np.ndarray,
    learns: bool,
) -> tuple[Footprints, dict[str, Learned], ReadIssues]:
    """Return what stands beside buildings, what is learned of unknown heights by kind, and what was met.

    Args:
      file: the settings of the file, such as the height of one level.
      outlines: from `what_stands`, in a projected CRS; a `BUILDING` is a polygon without area.
      buildings: with their bounds.
      waters: what bridges may cross.
      learns: as of `to_buildings`.
    """
    # One row for each of the spans, until some are left out.
    spans = in_spans(outlines)
    others, learned = _others_of(spans, file, waters, learns)
    on_ground = _structures(others)
    roof_m = _roofs_below_m(on_ground, spans.polygons, buildings)
    rows = with_supports(_on_roofs(on_ground, roof_m), spans.polygons)
    names_building = _names_building(on_ground, spans) & (roof_m > 0)
    has_no_height = (rows.height_m == 0) & (rows.kinds != UNKNOWN)
    structures = rows.take(~has_no_height & ~names_building).joined(_guys(rows, spans))
    is_unknown = structures.kinds == UNKNOWN
    issues = {
        ReadIssue.NOT_STANDING: num_of(has_no_height),
        ReadIssue.UNKNOWN_EXTENT: num_of(is_unknown),
        ReadIssue.UNKNOWN_HEIGHT: num_of(structures.is_guessed & ~is_unknown),
    }
    return structures, learned, issues


def _others_of(
    outlines: Outlines, file: settings.Buildings, waters: np.ndarray, learns: bool
) -> tuple[_Others, dict[str, Learned]]:
    """Return structures before they have an extent, and what is learned of kinds that a name alone tells apart.

    Args:
      outlines: ``N``, lines of wires as their spans.
      file, waters, learns: as of `to_structures`.
    """
    verdicts = outlines.tags["verdict"]
    kinds = np.array([HULL if kind == BUILDING else kind for kind in verdicts], object)
    names = np.array([kind.name for kind in kinds], object)
    stated = _stated(outlines, kinds, file)
    has_height = ~np.isin(stated.origin, (HeightOrigin.DEFAULT, HeightOrigin.UNREADABLE))
    measured_m = _measured_m(stated, kinds)
    # A guess and what is likely are both of measured heights, as levels say nothing of what is no building.
    known_m = measured_m * np.isin(names, LEARNED_KINDS) * learns
    learned = learned_from(names, known_m, known_m)
    is_settled = has_height & (stated.origin != HeightOrigin.ESTIMATED)
    others = _Others(
        outlines=outlines,
        kinds=kinds,
        names=names,
        dimension=shapely.get_dimensions(outlines.polygons),
        sizes=_sizes(outlines, kinds, waters),
        stated=stated,
        has_height=has_height,
        measured_m=measured_m,
        levels_limit_m=limits_by_levels_m(stated, file.level_height_m),
        guess_m=np.where(has_height, np.nan, of_classes(learned, names, "guess_m")),
        likely_m=np.where(is_settled, np.nan, _likely_m(outlines, learned, names)),
    )
    return others, learned


def _measured_m(stated: Footprints, kinds: np.ndarray) -> np.ndarray:
    """Return ``[N]`` the heights that the file gives of all of a structure, 0 without one."""
    is_whole = (kinds != BRIDGE) & (kinds != HULL)
    is_measured = (stated.origin == HeightOrigin.HEIGHT) & is_whole
    return np.where(is_measured, stated.height_m, 0.0)


def _likely_m(outlines: Outlines, learned: dict[str, Learned], names: np.ndarray) -> np.ndarray:
    """Return ``[N]`` what is likely by name, or by an estimate's own upper end; NaN where nothing is learned."""
    upper_m = np.nan_to_num(lengths_m(outlines, "estimated_to_m"))
    return np.maximum(of_classes(learned, names, "likely_m"), upper_m)


def _sizes(outlines: Outlines, kinds: np.ndarray, waters: np.ndarray) -> KindSizes:
    """Return the sizes of structures by their kinds, of bridges each its own."""
    by_kind = [(kind.height_m, kind.limit_m, kind.radius_m) for kind in kinds]
    sizes = np.reshape(by_kind, (-1, len(KindSizes._fields))).T
    is_bridge = kinds == BRIDGE
    sizes[:, is_bridge] = bridges_of(outlines.take(is_bridge), waters)
    return KindSizes(*sizes)


def _stated(outlines: Outlines, kinds: np.ndarray, file: settings.Buildings) -> Footprints:
    """Return structures with the heights that the file says.

    The blades of a turbine reach above its hub, by an unknown length where the file gives no diameter.
    """
    stated, _ = estimate_heights(outlines.tags, outlines.polygons, np.zeros(len(kinds), bool), file)
    rotor_m = lengths_m(outlines, "rotor")
    tip_m = lengths_m(outlines, "hub") + np.nan_to_num(rotor_m) / 2
    has_tip = np.isfinite(tip_m) & (kinds == TURBINE)
    is_hub = has_tip & np.isnan(rotor_m) & ~(stated.height_m >= tip_m)
    origin = np.where(has_tip, HeightOrigin.HEIGHT, stated.origin)
    origin = np.where(is_hub, HeightOrigin.ROUGH, origin)
    return replace(stated, height_m=np.fmax(stated.height_m, tip_m), origin=origin)


def lengths_m(outlines: Outlines, tag: str) -> np.ndarray:
    """Return ``[N]`` the lengths that a tag says, NaN where it says none."""
    return read_column(outlines.column(tag), parse_length_m)


def _structures(others: _Others) -> Footprints:
    """Return structures; those of no known height and kind are 0 m high."""
    height_m = _height_m(others)
    return replace(
        others.stated,
        polygons=_shape(others, height_m),
        height_m=height_m,
        min_height_m=_underside_m(others),
        origin=_height_origin(others),
        kind=_kind(others),
        limit_m=_bound_m(others),
        label=others.outlines.tags["label"],
        likely_m=np.nan_to_num(others.likely_m, nan=np.inf),
        rule=others.outlines.tags["rule"],
    )


def _height_m(others: _Others) -> np.ndarray:
    """Return ``[N]`` the height that the file says, else what is learned, else that of the kind."""
    unknown_m = np.where(np.isnan(others.guess_m), others.sizes.height_m, others.guess_m)
    return np.where(others.has_height, others.stated.height_m, unknown_m)


def _height_origin(others: _Others) -> np.ndarray:
    """Return ``[N]`` where heights came from; that of a bridge is rough, as it is of the deck alone."""
    is_rough = others.has_height & (others.kinds == BRIDGE)
    is_unknown = ~others.has_height & (others.names == UNKNOWN)
    origins = [HeightOrigin.ROUGH, HeightOrigin.UNKNOWN]
    return np.select([is_rough, is_unknown], origins, others.stated.origin).astype(np.uint8)


def _bound_m(others: _Others) -> np.ndarray:
    """Return ``[N]`` the bound: that of the kind, but none where higher is likely, estimated or a rough word.

    Nor has one what has a height that cannot be read. It is not below what the file knows of the same row of the table.
    What is not whole has that of its building (`_hull_bounds_m`), over what its outline rises.
    """
    stated = others.stated
    tags = others.outlines.tags
    is_hull = others.kinds == HULL
    by_kind_m = np.where(is_hull, _hull_bounds_m(others), others.sizes.limit_m)
    rise_m = np.where(is_hull, tags["rise_m"], 0.0)
    of_kind_m = np.fmax(by_kind_m, tags["kind_limit_m"]) + rise_m
    is_likely_higher = np.fmax(others.guess_m, others.likely_m) > of_kind_m
    is_doubted = np.isin(stated.origin, (HeightOrigin.ROUGH, HeightOrigin.ESTIMATED))
    is_said_higher = is_doubted & (stated.height_m > of_kind_m)
    is_unreadable = stated.origin == HeightOrigin.UNREADABLE
    is_open = is_likely_higher | is_said_higher | is_unreadable
    row = np.where(tags["label"] == "", others.kinds, tags["label"])
    highest_m = pd.Series(others.measured_m).groupby(row, sort=False).transform("max")
    known_m = np.fmax(highest_m.to_numpy(), lengths_m(others.outlines, "estimated_to_m"))
    return np.fmax(np.where(is_open, np.inf, of_kind_m), known_m)


def _hull_bounds_m(others: _Others) -> np.ndarray:
    """Return ``[N]`` the bound of a building that is not whole: by its levels, else by its name, else by its size."""
    hull_m2 = shapely.area(shapely.convex_hull(others.outlines.polygons))
    by_size_m = np.where(hull_m2 >= CLASSES_M2[1], np.inf, LIMIT_M)
    by_name_m = limits_by_name_m(others.outlines, by_size_m)
    return np.where(np.isnan(others.levels_limit_m), by_name_m, others.levels_limit_m)


def limits_by_name_m(outlines: Outlines, others_m: float | np.ndarray) -> np.ndarray:
    """Return ``[N]`` the bound of buildings of unknown height by what their tag calls them, and of others."""
    return np.where(outlines.says("building", LOW_BUILDINGS.split()), LOW_LIMIT_M, others_m)


def limits_by_levels_m(footprints: Footprints, level_height_m: float) -> np.ndarray:
    """Return ``[N]`` the bound of what has a number of levels, NaN of all else.

    Args:
      footprints: with the heights that the file says.
      level_height_m: height of one level, by which levels became heights.
    """
    num_levels = (footprints.height_m - footprints.min_height_m) / level_height_m
    limit_m = footprints.min_height_m + LEVEL_LIMIT_M * num_levels + ABOVE_LEVELS_M
    return np.where(footprints.origin == HeightOrigin.LEVELS, limit_m, np.nan)


def _kind(others: _Others) -> np.ndarray:
    """Return ``[N]`` names of kinds: with a height nothing is unknown, and towers without an area are masts."""
    is_mast = (others.names == "tower") & (others.dimension != 2)
    is_known = others.has_height & (others.names == UNKNOWN)
    return np.select([is_mast, is_known], ["mast", "structure"], others.names)


def _underside_m(others: _Others) -> np.ndarray:
    """Return ``[N]`` the height of the underside: plants and wires reach the ground."""
    is_grounded = np.isin(others.names, (*PLANTS, *WIRES))
    return np.where(is_grounded, 0.0, others.stated.min_height_m)


def _shape(others: _Others, height_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` shapes: points are discs, lines are strips, crowns octagons, and what is not whole a hull.

    What no table knows of barriers and pipelines encloses its area or fills it, and its border is as thick as a line.
    """
    lines = _thin_shape(others)
    is_tree = others.names == "tree"
    is_line = others.outlines.texts("barrier") != ""
    is_line |= others.outlines.texts("pipeline") != ""
    is_ring = (others.kinds == UNLISTED) & is_line
    is_thin = is_ring | (others.kinds == HULL) | (shapely.get_dimensions(lines) != 2)
    radius_m = _radius_m(others, height_m)
    shapes = lines.copy()
    for is_of, share, quad_segs in ((is_tree, OCTAGON, 2), (~is_tree, 1.0, 8)):
        thin = is_of & is_thin
        shapes[thin] = shapely.buffer(lines[thin], share * radius_m[thin], quad_segs=quad_segs)
    return shapes


def _thin_shape(others: _Others) -> np.ndarray:
    """Return ``[N]`` shapes as drawn, the hull of what is not whole, and the border of fences and walls."""
    shapes = others.outlines.polygons.copy()
    is_area_of_bridge = (others.kinds == BRIDGE) & (others.outlines.texts("man_made") == DECK)
    is_cut_off = (others.dimension == 1) & ((others.kinds == WOOD) | is_area_of_bridge)
    is_hulled = is_cut_off | (others.kinds == HULL)
    shapes[is_hulled] = shapely.convex_hull(shapes[is_hulled])
    is_fence = np.array([kind in (FENCE, *WALLS) for kind in others.kinds], bool)
    is_fence &= others.dimension == 2
    shapes[is_fence] = shapely.boundary(shapes[is_fence])
    return shapes


def _radius_m(others: _Others, height_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` half widths that the file says, else those of kinds, of trees and wheels by their heights."""
    is_tree = others.names == "tree"
    is_wheel = (others.kinds == RIDE) & (others.dimension == 0)
    of_kind_m = others.sizes.radius_m
    wheel_m = np.maximum(RIDE_SHARE * height_m, of_kind_m)
    of_kind_m = np.select([is_tree, is_wheel], [CROWN_SHARE * height_m, wheel_m], of_kind_m)
    outlines = others.outlines
    others_m = np.fmax(lengths_m(outlines, "diameter"), lengths_m(outlines, "rotor"))
    width_m = np.where(is_tree, lengths_m(outlines, "crown"), others_m)
    width_m[outlines.texts("man_made") == "pipeline"] = np.nan  # theirs are in millimetres
    return np.where(width_m > 0, np.minimum(width_m / 2, MOST_RADIUS_M), of_kind_m)


def _guys(structures: Footprints, outlines: Outlines) -> Footprints:
    """Return the unknown around masts that guys hold, as far as `GUYS_SHARE` of their heights.

    Args:
      structures: ``N`` of them.
      outlines: ``N`` that they were made of.
    """
    is_guyed = np.array(["guy" in text for text in outlines.texts("construction")], bool)
    masts = structures.take(is_guyed)
    return replace(
        masts,
        polygons=shapely.buffer(shapely.centroid(masts.polygons), GUYS_SHARE * masts.height_m),
        height_m=np.zeros(len(masts)),
        origin=np.full(len(masts), HeightOrigin.UNKNOWN, np.uint8),
        kind=np.full(len(masts), UNKNOWN, object),
        limit_m=masts.upper_m,
        label=np.full(len(masts), "guys", object),
        rule=np.full(len(masts), GUYS, object),
        likely_m=masts.likely_upper_m,
    )


def _roofs_below_m(structures: Footprints, shapes: np.ndarray, buildings: Footprints) -> np.ndarray:
    """Return ``[N]`` the bound of the highest building in which a point lies that may stand on it, 0 of all else.

    A tree stands in a yard, and what has an underside says itself where it stands.

    Args:
      structures: ``N`` of them.
      shapes: ``[N]`` what they were before they had an extent.
      buildings: with their bounds.
    """
    roof_m = np.zeros(len(shapes))
    point, building = shapely.STRtree(buildings.polygons).query(shapes, predicate="within")
    np.maximum.at(roof_m, point, buildings.upper_m[building])
    may_be_on = (shapely.get_dimensions(shapes) == 0) & (structures.min_height_m == 0)
    may_be_on &= ~np.isin(structures.kinds, PLANTS)
    return np.where(may_be_on, roof_m, 0.0)


def _on_roofs(structures: Footprints, roof_m: np.ndarray) -> Footprints:
    """Return structures that may stand on roofs: whether their heights count from there or from the ground is open.

    Args:
      structures: ``N`` of them.
      roof_m: ``[N]`` as of `_roofs_below_m`.
    """
    is_on = roof_m > 0
    is_doubted = is_on & ~structures.is_guessed
    return replace(
        structures,
        limit_m=structures.upper_m + roof_m,
        origin=np.where(is_doubted, HeightOrigin.ROUGH, structures.origin).astype(np.uint8),
        likely_m=np.where(is_on, np.inf, structures.likelies_m),
    )


def _names_building(structures: Footprints, outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether a thing of unknown kind may be the name of a building, or of what is historic in it."""
    kinds = outlines.tags["verdict"]
    is_name = np.array([kind in (HULL, HISTORIC, MONUMENT) for kind in kinds], bool)
    return is_name & (structures.kinds == UNKNOWN)
