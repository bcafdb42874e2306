"""The rules that make of features Footprints: buildings and their parts, and what else stands."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban import settings
from jaxurban.cities.bridges import DECK, bridges_of
from jaxurban.cities.heights import estimate_heights, parse_length_m, read_column, with_decks
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
    ROUGH_LIMIT,
    TURBINE,
    UNLISTED,
    WALLS,
    WOOD,
)
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.solids import prisms_of_solids
from jaxurban.cities.stands import is_water, what_stands
from jaxurban.cities.wires import in_spans, with_supports
from jaxurban.errors import InputError
from jaxurban.io.issues import ReadIssue, ReadIssues
from jaxurban.io.learned import (
    CLASSES_M2,
    IN_NONE,
    PARTS,
    Learned,
    classes_of,
    learned_from,
    of_classes,
)
from jaxurban.settings import SLABS
from jaxurban.world.extent import polygonal
from jaxurban.world.footprints import BUILDING, UNKNOWN, Footprints, HeightOrigin
from jaxurban.world.grid import Bounds, transformer
from jaxurban.world.kinds import PLANTS, WIRES

# An outline covered at least so far by its parts is dropped (design, section 3).
REPLACED_SHARE = 0.9
BELONGING_SHARE = 0.5  # a part is an outline's own if at least so much of it lies inside
PODIUM_M2 = 1.0  # less than this between two drawings of one wall is no podium
STRIP_M = 2.0  # narrower is what parts that are drawn roughly leave of their outline
SAME_HEIGHT_M = 0.5  # an outline and its highest part
MOST_RADIUS_M = 100.0  # of what is a point: more is a slip of the unit
OCTAGON = 1 / math.cos(math.pi / 8)  # its circle outside to that inside: crowns are octagons
RESHAPED = ("polygons", "height_m", "origin", "limit_m")
GUYS = "guys of a mast"  # the rule of what is around it
# Kinds whose names say how high they are; others are learned of no heights.
LEARNED_KINDS = ("chimney", "tank", "tower", "mast", "pole", "pylon", "crane", "turbine", *PLANTS)


class WhatStands(NamedTuple):
    """What stands by the features of a file.

    Attributes:
      buildings: and their parts.
      structures: all else.
      boxes_m: what the file covers, x_min, y_min, x_max, y_max in the city's CRS.
      issues: what was met, by count.
      learned: what the file's heights say of unknown ones, by class and kind.
    """

    buildings: Footprints
    structures: Footprints
    boxes_m: list[Bounds]
    issues: ReadIssues
    learned: dict[str, Learned]


def to_buildings(
    file: settings.Buildings, outlines: Outlines, crs: str, learns: bool = True
) -> WhatStands:
    """Return what stands by the features of a file.

    What stands is decided by `what_stands`. An outline that its own parts cover to at least 90 % gives way to them; one
    that is tagged ``building:part`` as well is a part itself and stands. A part without usable height takes that of its
    highest outline, if it is known. An underside at or above the roof raises a roof that was only estimated from levels
    or by default, and is set to 0 under a roof with a height. Where parts hang, an outline stays below those that no
    part stands under (`_podiums`). An outline as high as its highest part ends beside its parts (`_beside_parts`).

    Args:
      file: the file of the outlines and what to make of it; with hanging ``"slabs"`` areas of bridges
        (``man_made=bridge``) that are no buildings are decks (see `with_decks`).
      outlines: from a reader.
      crs: projected CRS of the buildings.
      learns: whether the outlines' own heights say what is guessed and likely of unknown ones, as of a whole file.

    Raises:
      InputError: no building and no declared box, in a file that was read as a whole.
    """
    issues = dict(outlines.issues)
    to_city = transformer(outlines.crs, crs)
    boxes_m = [to_city.transform_bounds(*box, densify_pts=101) for box in outlines.boxes]
    features, is_building = _in_city(outlines, crs, file.hanging == SLABS, issues)
    if not (boxes_m or len(features.polygons) or outlines.is_part):
        raise InputError(
            f"{str(file.source)!r} holds no building: give a file with polygons of buildings"
        )
    buildings, of_buildings = _buildings(features.take(is_building), file, learns, issues)

    # What else stands.
    waters = shapely.force_2d(outlines.polygons[is_water(outlines)])
    waters = shapely.transform(shapely.make_valid(waters), to_city.transform, interleaved=False)
    others = in_spans(features.take(~is_building))
    structures, of_kinds = _structures(others, file, waters, learns)
    structures, is_same = _on_roofs(structures, others, buildings)
    structures = with_supports(structures, others.polygons)
    is_left_out = (structures.height_m == 0) & (structures.kinds != UNKNOWN)
    issues[ReadIssue.NOT_STANDING] += int(np.sum(is_left_out))
    guys = _guys(structures, others)
    structures = structures.take(~is_left_out & ~is_same).joined(guys)
    is_unknown = structures.kinds == UNKNOWN
    issues[ReadIssue.UNKNOWN_EXTENT] = int(np.sum(is_unknown))
    issues[ReadIssue.UNKNOWN_HEIGHT] = int(np.sum(structures.is_guessed & ~is_unknown))
    learned = of_buildings | of_kinds
    return WhatStands(buildings, _within(structures, file, buildings), boxes_m, issues, learned)


def _in_city(
    outlines: Outlines, crs: str, has_slabs: bool, issues: ReadIssues
) -> tuple[Outlines, np.ndarray]:
    """Return what stands in the city's CRS, each with the height of its solid, and which are buildings, ``[N]`` bool.

    Args:
      outlines: from a reader.
      crs: projected CRS of the result.
      has_slabs: whether areas of bridges are decks.
      issues: gets what is left out, repaired or a solid.
    """
    features, left_out = what_stands(outlines, has_slabs)
    issues |= left_out
    prisms = prisms_of_solids(features)
    shapes, is_sound, is_whole = _project(prisms["polygon"].to_numpy(), outlines.crs, crs, issues)
    prisms = prisms[is_sound]
    features = features.take(prisms["feature"].to_numpy(int))
    # Of solids the height counts in place of what the file says of it. Walls alone, whose height is 0, close nothing.
    height_m = prisms["height_m"].to_numpy(float)
    height = np.where(np.isnan(height_m), features.column("height"), height_m)
    tags = {**features.tags, "height": height, "rise_m": prisms["rise_m"].to_numpy(float)}
    is_building = (tags["verdict"] == BUILDING) & is_whole[is_sound] & (height_m != 0)
    issues[ReadIssue.SOLIDS] = prisms["feature"][is_building & (height_m > 0)].nunique()
    return replace(features, polygons=shapes[is_sound], tags=tags), is_building


def _buildings(
    found: Outlines, file: settings.Buildings, learns: bool, issues: ReadIssues
) -> tuple[Footprints, dict[str, Learned]]:
    """Return buildings with their heights, as `to_buildings` says, and what is learned of these by class.

    Args:
      found: outlines and parts, in a projected CRS.
      file, learns: as of `to_buildings`.
      issues: gets what became of parts and heights.
    """
    polygons = found.polygons
    is_part = found.tags["is_part"]
    is_deck = found.tags["is_deck"]
    buildings = estimate_heights(found.tags, polygons, is_part, file, issues)
    if is_deck.any():
        layer = pd.to_numeric(pd.Series(found.texts("layer")), errors="coerce")
        buildings = with_decks(buildings, is_deck, layer.to_numpy(float))

    # Outlines and their parts: heights of one for the other, and which outlines the parts replace.
    outline, part, share = _own_parts(polygons, ~is_part & ~is_deck, is_part)
    classes = _classes(polygons, is_part, is_deck)
    learned, highest_m = _learned(buildings, found, outline, part, classes, learns)
    if file.default_height_m is None:
        guess_m = of_classes(learned, classes, "guess_m")
        is_low = found.says("building", LOW_BUILDINGS.split()) & (guess_m > LOW_LIMIT_M)
        guess_m[is_low] = LOW_LIMIT_M
        height_m = np.where(buildings.height_m == 0, guess_m, buildings.height_m)
        buildings = replace(buildings, height_m=height_m)
    buildings = _with_outline_heights(buildings, outline, part, issues)
    is_replaced = share >= REPLACED_SHARE
    issues[ReadIssue.OUTLINES_REPLACED_BY_PARTS] = int(np.sum(is_replaced))
    if file.hanging == SLABS:
        buildings, is_podium = _podiums(buildings, outline, part, is_replaced)
        issues[ReadIssue.OUTLINES_KEPT_AS_PODIUMS] = int(np.sum(is_podium))
        is_replaced &= ~is_podium

    # Their bounds.
    above_m = of_classes(learned, classes, "likely_m")
    limit_m = _limits_m(buildings, found, file, highest_m, above_m)
    likely_m = above_m + buildings.min_height_m
    is_of_class = np.isin(buildings.origin, (HeightOrigin.DEFAULT, HeightOrigin.UNREADABLE))
    likely_m = np.where(is_of_class, likely_m + found.tags["rise_m"], np.inf)
    buildings = replace(buildings, limit_m=limit_m, likely_m=likely_m, rule=found.tags["rule"])
    is_bare = is_replaced & ((1 - share) * shapely.area(polygons) > STRIP_M)
    buildings, is_replaced = _beside_parts(buildings, outline, part, is_replaced, is_bare)
    buildings = _within(buildings.take(~is_replaced), file)
    issues[ReadIssue.PARTS_HANGING] = int(np.sum(buildings.min_height_m > 0))
    return buildings, learned


def _structures(
    outlines: Outlines, rules: settings.Buildings, waters: np.ndarray, learns: bool
) -> tuple[Footprints, dict[str, Learned]]:
    """Return structures with their heights, and what is learned of these by kind.

    Points are discs, lines are strips, and what is not whole is a hull.

    Their height is 0 where it is unknown and their kind has none. Trees are as wide as their crowns, which have
    `CROWN_SHARE` of their height where no width is known. Towers without an area are masts.

    Args:
      outlines: ``N`` from `what_stands`, in a projected CRS; a `BUILDING` is a polygon without area.
      rules: height of one level.
      waters: what bridges may cross.
      learns: as of `to_buildings`.
    """
    verdicts = outlines.tags["verdict"]
    kinds = np.array([HULL if kind == BUILDING else kind for kind in verdicts], object)

    def lengths_m(name: str) -> np.ndarray:
        """Return ``[N]`` the lengths that a tag says, NaN where it says none."""
        return read_column(outlines.column(name), parse_length_m)

    is_bridge = kinds == BRIDGE
    bridges = bridges_of(outlines.take(is_bridge), waters)

    def of_kinds(field: str) -> np.ndarray:
        """Return ``[N]`` a number of each kind."""
        values = np.array([getattr(kind, field) for kind in kinds], float)
        values[is_bridge] = getattr(bridges, field)
        return values

    # Heights. The blades of a turbine reach above its hub.
    whole = estimate_heights(
        outlines.tags, outlines.polygons, np.zeros(len(kinds), bool), rules, {}
    )
    rotor_m = lengths_m("rotor")
    tip_m = lengths_m("hub") + np.nan_to_num(rotor_m) / 2
    has_tip = np.isfinite(tip_m) & (kinds == TURBINE)
    origin = np.where(has_tip, HeightOrigin.HEIGHT, whole.origin)
    is_lost = origin == HeightOrigin.UNREADABLE
    has_height = (origin != HeightOrigin.DEFAULT) & ~is_lost
    height_m = np.where(has_height, np.fmax(whole.height_m, tip_m), of_kinds("height_m"))
    is_hull = kinds == HULL
    names = np.array([kind.name for kind in kinds], object)

    # What is learned of kinds that a name alone tells apart.
    is_known = (origin == HeightOrigin.HEIGHT) & ~(is_bridge | is_hull)
    row = np.where(outlines.tags["label"] == "", kinds, outlines.tags["label"])
    highest_m = pd.Series(height_m * is_known).groupby(row, sort=False).transform("max")
    is_given = is_known & np.isin(names, LEARNED_KINDS) & learns
    given_m = np.where(is_given, height_m, 0.0)
    learned = learned_from(names, given_m, given_m)
    guess_m = of_classes(learned, names, "guess_m")
    guess_m[has_height] = np.nan
    height_m = np.where(np.isnan(guess_m), height_m, guess_m)
    likely_m = np.where(has_height, np.nan, of_classes(learned, names, "likely_m"))
    names[has_height & (names == UNKNOWN)] = "structure"
    origin[has_height & is_bridge] = HeightOrigin.ROUGH  # of the deck alone
    origin[names == UNKNOWN] = HeightOrigin.UNKNOWN
    is_large = shapely.area(shapely.convex_hull(outlines.polygons)) >= CLASSES_M2[1]
    of_hulls_m = _limits_by_name_m(outlines, np.where(is_large, np.inf, LIMIT_M))
    of_hulls_m += outlines.tags["rise_m"]
    limit_m = np.where(is_hull, of_hulls_m, of_kinds("limit_m"))
    limit_m[is_lost | (limit_m < np.fmax(guess_m, likely_m))] = np.inf
    limit_m = np.fmax(limit_m, highest_m)

    # Shapes.
    is_border = (kinds == WOOD) | (is_bridge & (outlines.texts("man_made") == DECK))
    is_border &= shapely.get_dimensions(outlines.polygons) == 1
    is_hulled = is_hull | is_border
    shapes = outlines.polygons.copy()
    shapes[is_hulled] = shapely.convex_hull(shapes[is_hulled])
    is_fence = np.array([kind in (FENCE, *WALLS) for kind in kinds], bool)
    is_fence &= shapely.get_dimensions(shapes) == 2
    shapes[is_fence] = shapely.boundary(shapes[is_fence])
    is_areal = shapely.get_dimensions(shapes) == 2
    is_tree = names == "tree"
    width_m = np.where(is_tree, lengths_m("crown"), np.fmax(lengths_m("diameter"), rotor_m))
    width_m[outlines.texts("man_made") == "pipeline"] = np.nan  # theirs are in millimetres
    by_kind_m = np.where(is_tree, CROWN_SHARE * height_m, of_kinds("radius_m"))
    is_wheel = (kinds == RIDE) & (shapely.get_dimensions(shapes) == 0)
    by_kind_m = np.where(is_wheel, np.maximum(RIDE_SHARE * height_m, by_kind_m), by_kind_m)
    radius_m = np.where(width_m > 0, np.minimum(width_m / 2, MOST_RADIUS_M), by_kind_m)
    # What no table knows of barriers encloses its area or fills it, and its border is as thick as a line.
    is_ring = (kinds == UNLISTED) & (outlines.texts("barrier") != "")
    is_wide = is_areal & ~(is_hull | is_ring)
    polygons = shapes.copy()
    for is_of, num_sides, share in ((is_tree, 8, OCTAGON), (~is_tree, 32, 1.0)):
        thin = np.flatnonzero(is_of & ~is_wide)
        polygons[thin] = shapely.buffer(
            shapes[thin], share * radius_m[thin], quad_segs=num_sides // 4
        )
    names[(names == "tower") & ~is_areal] = "mast"
    is_grounded = np.isin(names, (*PLANTS, *WIRES))
    structures = replace(
        whole,
        polygons=polygons,
        height_m=height_m,
        min_height_m=np.where(is_grounded, 0.0, whole.min_height_m),
        origin=origin.astype(np.uint8),
        kind=names,
        limit_m=limit_m,
        label=outlines.tags["label"],
        likely_m=np.nan_to_num(likely_m, nan=np.inf),
        rule=outlines.tags["rule"],
    )
    return structures, learned


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


def _on_roofs(
    structures: Footprints, outlines: Outlines, buildings: Footprints
) -> tuple[Footprints, np.ndarray]:
    """Return structures of which points within buildings may stand on roofs, and which merely name these.

    Whether a height counts from the roof or from the ground is not known unless there is an underside: the higher is a
    bound; a tree stands in a yard. A point of a building, or of what is historic, names its building, ``[N]`` bool.

    Args:
      structures: ``N`` of them.
      outlines: ``N`` that they were made of, before they had an extent.
      buildings: with their bounds.
    """
    shapes = outlines.polygons
    roof_m = np.zeros(len(shapes))
    point, building = shapely.STRtree(buildings.polygons).query(shapes, predicate="within")
    np.maximum.at(roof_m, point, buildings.upper_m[building])
    is_on = (roof_m > 0) & (shapely.get_dimensions(shapes) == 0) & (structures.min_height_m == 0)
    is_on &= ~np.isin(structures.kinds, PLANTS)
    limit_m = structures.upper_m + np.where(is_on, roof_m, 0.0)
    origin = structures.origin.copy()
    origin[is_on & ~structures.is_guessed] = HeightOrigin.ROUGH
    likely_m = np.where(is_on, np.inf, structures.likelies_m)
    on_roofs = replace(structures, limit_m=limit_m, origin=origin, likely_m=likely_m)
    verdicts = outlines.tags["verdict"]
    names_it = np.array([each in (HULL, HISTORIC, MONUMENT) for each in verdicts], bool)
    return on_roofs, is_on & names_it & (structures.kinds == UNKNOWN)


def _limits_by_name_m(outlines: Outlines, others_m: float | np.ndarray) -> np.ndarray:
    """Return ``[N]`` the bound of buildings of unknown height by what their tag calls them, and of others."""
    return np.where(outlines.says("building", LOW_BUILDINGS.split()), LOW_LIMIT_M, others_m)


def _classes(polygons: np.ndarray, is_part: np.ndarray, is_deck: np.ndarray) -> np.ndarray:
    """Return the class of each building, ``[N]`` objects: by its size, or that of the outline that it lies in.

    A part that lies in none is a part `IN_NONE`, whatever it touches: of those of Murray Hill that touch a small
    building and nothing else 4 of 19 are higher than 100 m.

    Args:
      polygons: ``[N]`` outlines and parts.
      is_part: ``[N]`` bool.
      is_deck: ``[N]`` bool, which are no buildings.
    """
    area_m2 = shapely.area(polygons)
    wholes = np.flatnonzero(~(is_part | is_deck))
    middles = shapely.point_on_surface(polygons)
    inner, whole = shapely.STRtree(polygons[wholes]).query(middles, predicate="within")
    np.maximum.at(area_m2, inner, area_m2[wholes[whole]])
    classes = classes_of(area_m2)
    classes[np.setdiff1d(np.flatnonzero(is_part), inner)] = IN_NONE
    return np.where(is_part, PARTS + classes, classes)


def _learned(
    buildings: Footprints,
    found: Outlines,
    outline: np.ndarray,
    part: np.ndarray,
    classes: np.ndarray,
    learns: bool,
) -> tuple[dict[str, Learned], np.ndarray]:
    """Return what a file says of unknown heights, and the highest that it knows of the class of each, ``[N]``.

    An outline is as high as its highest part. In the highest a part is of the class of its building, and what names
    call low is a class of its own; of a part that lies in none it is not known.

    Args:
      buildings: ``N`` outlines and parts, as the file has them.
      found: what their tags call them.
      outline, part: ``[P]`` indices of outlines and their own parts.
      classes: ``[N]`` objects.
      learns: as of `to_buildings`.
    """
    known_m = []
    for origins in (HeightOrigin.HEIGHT,), (HeightOrigin.HEIGHT, HeightOrigin.LEVELS):
        is_known = np.isin(buildings.origin, origins) & ~found.tags["is_deck"]
        height_m = np.where(is_known, buildings.height_m, 0.0)
        np.maximum.at(height_m, outline, height_m[part])
        known_m.append(height_m)
    groups = pd.Series(classes).str.removeprefix(PARTS)
    groups[found.says("building", LOW_BUILDINGS.split())] = "low"
    highest_m = pd.Series(height_m).groupby(groups).transform("max").to_numpy()
    highest_m = np.where(groups == IN_NONE, np.inf, highest_m)
    return learned_from(classes, *(each * learns for each in known_m)), highest_m


def _within(
    footprints: Footprints, rules: settings.Buildings, below: Footprints | None = None
) -> Footprints:
    """Return outlines whose guessed heights and bounds end at what the user says of their kinds.

    What the file itself says, such as levels or a floor, is not taken back: a bound ends there where that is higher.

    Args:
      footprints: the outlines.
      rules: the user's word.
      below: on which these may stand: heights count from the ground, so the word does not count there.
    """
    kinds = footprints.kinds
    by_kind = {kind: settings.highest_of(rules, kind) for kind in {*kinds}}
    highest_m = np.array([by_kind[kind] for kind in kinds], float)
    highest_m[~footprints.is_guessed | (footprints.min_height_m >= highest_m)] = np.inf
    if below is not None and np.isfinite(highest_m).any():
        standing, _ = shapely.STRtree(below.polygons).query(footprints.polygons, "intersects")
        highest_m[standing] = np.inf
    is_unsaid = np.isin(footprints.origin, (HeightOrigin.DEFAULT, HeightOrigin.UNKNOWN))
    height_m = np.where(is_unsaid, np.minimum(footprints.height_m, highest_m), footprints.height_m)
    limit_m = np.minimum(footprints.upper_m, np.maximum(highest_m, height_m))
    return replace(footprints, height_m=height_m, limit_m=limit_m)


def _limits_m(
    buildings: Footprints,
    found: Outlines,
    rules: settings.Buildings,
    highest_m: np.ndarray,
    likely_m: np.ndarray,
) -> np.ndarray:
    """Return ``[B]`` the bound of buildings of guessed height; of decks it is not known.

    Vertices of outlines may lie on the ground or on roofs: how far they rise counts in full.

    Args:
      buildings: with their heights.
      found: ``B`` outlines with what their tag calls them and how far they rise.
      rules: height of one level.
      highest_m, likely_m: ``[B]`` of their classes. What names call low is bounded by the highest that the file knows;
        others have no bound where higher ones are known or likely, as nothing says how high a tower is.
    """
    num_levels = (buildings.height_m - buildings.min_height_m) / rules.level_height_m
    by_name_m = np.maximum(_limits_by_name_m(found, LIMIT_M), found.tags["kind_limit_m"])
    is_higher = np.fmax(highest_m, likely_m) > by_name_m
    others_m = np.where(is_higher, np.inf, by_name_m)
    by_name_m = np.where(by_name_m < LIMIT_M, np.maximum(by_name_m, highest_m), others_m)
    by_name_m += found.tags["rise_m"]
    limits_m = {
        HeightOrigin.LEVELS: LEVEL_LIMIT_M * num_levels + ABOVE_LEVELS_M,
        HeightOrigin.DEFAULT: by_name_m,
        HeightOrigin.ROUGH: np.maximum(ROUGH_LIMIT * buildings.height_m, by_name_m),
    }
    of_origin = [buildings.origin == origin for origin in limits_m]
    above_m = np.select(of_origin, list(limits_m.values()), np.inf)
    return buildings.min_height_m + above_m


def _beside_parts(
    buildings: Footprints,
    outline: np.ndarray,
    part: np.ndarray,
    is_replaced: np.ndarray,
    is_bare: np.ndarray,
) -> tuple[Footprints, np.ndarray]:
    """Return buildings in which outlines cover what their parts leave, and which still give way to them, ``[N]`` bool.

    These are outlines with the height of their highest part, and those that would give way but leave a strip of more
    than `STRIP_M`. As mappers give an outline the height of its tower, the rest of the first is guessed to be as high
    as the lowest part that stands on the ground, and no higher than the outline's height.

    Args:
      buildings: ``N`` outlines and parts.
      outline, part: ``[P]`` indices of outlines and their own parts.
      is_replaced: ``[N]`` bool, which outlines give way to their parts.
      is_bare: ``[N]`` bool, which of these their parts do not cover as a whole.
    """
    columns: Any = {name: getattr(buildings, name).copy() for name in RESHAPED}
    is_known = buildings.origin == HeightOrigin.HEIGHT
    is_own = is_known[outline] & is_known[part] & ~is_replaced[outline]
    is_replaced = is_replaced.copy()
    for owner in np.unique(outline[is_own | is_bare[outline]]):
        own = part[(outline == owner) & is_known[part] & is_known[owner]]
        top_m = buildings.height_m[own]
        standing_m = top_m[buildings.min_height_m[own] == 0]
        height_m = buildings.height_m[owner]
        lowest_m = standing_m.min(initial=height_m)
        is_towers = abs(top_m.max(initial=0) - height_m) <= SAME_HEIGHT_M
        is_towers &= lowest_m < height_m - SAME_HEIGHT_M
        if not (is_towers or is_replaced[owner]):
            continue
        own_parts = shapely.union_all(buildings.polygons[part[outline == owner]])
        rest = polygonal(shapely.difference(buildings.polygons[owner], own_parts))
        if rest.is_empty or (is_replaced[owner] and rest.buffer(-STRIP_M / 2).is_empty):
            continue
        is_replaced[owner] = False
        columns["polygons"][owner] = rest
        if not is_towers:
            continue
        columns["height_m"][owner] = lowest_m
        columns["origin"][owner] = HeightOrigin.BESIDE_PARTS
        columns["limit_m"][owner] = height_m
    return replace(buildings, **columns), is_replaced


def _project(
    shapes: np.ndarray, source: str, crs: str, issues: ReadIssues
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return shapes in another CRS, valid and without heights, which of them could be made, and which are whole.

    Polygons alone in a MultiPolygon, as those of OpenStreetMap are made, come without it: maps burn them more quickly.
    A shape is not whole if it lacks a vertex, or if an area has become a line or a point. The latter are ``[N]`` bool.

    Args:
      shapes: ``[N]`` of any kind, None where there is none.
      source: their CRS.
      crs: projected CRS of the result.
      issues: gets how many were repaired, are missing or empty, or lie where ``crs`` does not reach.
    """
    to_city = transformer(source, crs).transform
    if shapely.has_z(shapes).any():
        shapes = shapely.force_2d(shapes)
    shapes = shapely.transform(shapes, to_city, interleaved=False)
    is_there = ~shapely.is_missing(shapes) & ~shapely.is_empty(shapes)

    # Of a shape that lacks vertices the hull of the others is left.
    vertices, shape = shapely.get_coordinates(shapes, return_index=True)
    is_finite = np.isfinite(vertices).all(axis=1)
    is_whole = np.ones(len(shapes), bool)
    is_whole[shape[~is_finite]] = False
    for index in np.flatnonzero(~is_whole):
        known = vertices[is_finite & (shape == index)]
        shapes[index] = shapely.convex_hull(shapely.multipoints(known))
    is_sound = is_there & ~shapely.is_empty(shapes)

    to_repair = np.flatnonzero(is_sound & ~shapely.is_valid(shapes))
    made = [polygonal(valid) for valid in shapely.make_valid(shapes[to_repair], method="structure")]
    is_flat = shapely.is_empty(made)
    shapes[to_repair] = np.where(is_flat, shapely.convex_hull(shapes[to_repair]), made)
    is_whole[to_repair] &= ~is_flat

    is_alone = shapely.get_type_id(shapes) == shapely.GeometryType.MULTIPOLYGON
    is_alone &= shapely.get_num_geometries(shapes) == 1
    shapes[is_alone] = shapely.get_geometry(shapes[is_alone], 0)

    issues[ReadIssue.OUTSIDE_CRS] = int(np.sum(is_there & ~is_sound))
    num_repaired = int(np.sum(~is_flat))
    issues[ReadIssue.POLYGONS_REPAIRED] = issues.get(ReadIssue.POLYGONS_REPAIRED, 0) + num_repaired
    issues[ReadIssue.POLYGONS_DROPPED] = int(np.sum(~is_there))
    return shapes, is_sound, is_whole


def _own_parts(
    polygons: np.ndarray, is_outline: np.ndarray, is_part: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return every pair of an outline and a part of its own, and how much of each polygon its own parts cover.

    `BELONGING_SHARE` of a part at least lies inside an outline that owns it.

    Args:
      polygons: ``[N]`` valid polygons.
      is_outline, is_part: ``[N]`` bool, which of them are outlines, and which are parts.

    Returns:
      ``[P]`` indices of the outlines and of the parts, and ``[N]`` shares in [0, 1], 0 without a part.
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
    outline, part, shared = outline[is_own], part[is_own], shared[is_own]

    share = np.zeros(len(polygons))
    order = np.argsort(outline, kind="stable")  # the pairs of each outline one after the other
    owners, starts = np.unique(outline[order], return_index=True)
    for owner, own in zip(owners, np.split(shared[order], starts[1:]), strict=False):
        share[owner] = shapely.area(shapely.union_all(own)) / shapely.area(polygons[owner])
    return outline, part, share


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

    Every roof is above its underside then. A roof at or below it is raised by the underside's height if it is an
    estimate, by levels or by default; if its height is known, the underside is set to 0.

    Args:
      buildings: ``N`` outlines and parts.
      outline, part: ``[P]`` indices of outlines and their own parts.
      issues: gets how many parts were given a height, and how many undersides were set to 0.
    """
    height_m = buildings.height_m.copy()
    origin = buildings.origin.copy()
    is_default = origin == HeightOrigin.DEFAULT
    # A part that hangs above its outline's roof is not as high as it but higher.
    takes = (
        is_default[part] & ~is_default[outline] & (height_m[outline] > buildings.min_height_m[part])
    )
    # From the lowest outline up, so that of several outlines of a part the highest is written last.
    outline, part = outline[takes], part[takes]
    lowest_first = np.argsort(height_m[outline], kind="stable")
    height_m[part[lowest_first]] = height_m[outline[lowest_first]]
    origin[part[lowest_first]] = origin[outline[lowest_first]]
    issues[ReadIssue.PARTS_GIVEN_OUTLINE_HEIGHT] = len(np.unique(part))

    # Undersides.
    min_height_m = buildings.min_height_m
    is_wrong = min_height_m >= height_m
    is_known = origin == HeightOrigin.HEIGHT
    issues[ReadIssue.MIN_HEIGHTS_ABOVE_ROOF] = int(np.sum(is_wrong & is_known))
    return replace(
        buildings,
        height_m=np.where(is_wrong & ~is_known, height_m + min_height_m, height_m),
        min_height_m=np.where(is_wrong & is_known, 0.0, min_height_m),
        origin=origin,
    )
