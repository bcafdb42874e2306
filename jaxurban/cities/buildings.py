"""The rules that make of features Footprints: buildings and their parts, and what else stands."""

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban import settings
from jaxurban.cities.heights import (
    estimate_heights,
    parse_length_m,
    read_column,
    with_decks,
)
from jaxurban.cities.kinds import LIMIT_M, LOW_BUILDINGS, ROUGH_LIMIT
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.solids import DIFFER_M, prisms_of_solids
from jaxurban.cities.stands import is_water, what_stands
from jaxurban.cities.structures import (
    lengths_m,
    limits_by_levels_m,
    limits_by_name_m,
    to_structures,
)
from jaxurban.errors import InputError
from jaxurban.io.issues import ReadIssue, ReadIssues, num_of
from jaxurban.io.learned import (
    IN_NONE,
    OPEN_SHARE,
    PARTS,
    Learned,
    built_shares,
    classes_of,
    learned_from,
    of_classes,
)
from jaxurban.settings import MAX_HEIGHT_M, SLABS
from jaxurban.world.extent import polygonal
from jaxurban.world.footprints import BUILDING, Footprints, HeightOrigin
from jaxurban.world.grid import Bounds, transformer

# An outline covered at least so far by its parts is dropped (design, section 3).
REPLACED_SHARE = 0.9
BELONGING_SHARE = 0.5  # a part is an outline's own if at least so much of it lies inside
PODIUM_M2 = 1.0  # less than this between two drawings of one wall is no podium
STRIP_M = 2.0  # narrower is what parts that are drawn roughly leave of their outline
SAME_HEIGHT_M = 0.5  # an outline and its highest part
# Whose likely height is that of their class.
OF_CLASS = (HeightOrigin.DEFAULT, HeightOrigin.UNREADABLE, HeightOrigin.ESTIMATED)


class Parts(NamedTuple):
    """Which parts of buildings are whose, and how much of these they cover.

    Attributes:
      outline, part: ``[P]`` indices of outlines and of a part of each: at least `BELONGING_SHARE` of it lies inside.
      share: ``[N]`` of each polygon that its own parts cover, in [0, 1], 0 without a part.
    """

    outline: np.ndarray
    part: np.ndarray
    share: np.ndarray


class Known(NamedTuple):
    """What the heights that a file states say of others. ``N`` buildings.

    Attributes:
      classes: ``[N]`` objects, in which they are learned.
      learned: by class.
      likely_m: ``[N]`` of the class.
      highest_m: ``[N]`` as of `_highest_m`.
    """

    classes: np.ndarray
    learned: dict[str, Learned]
    likely_m: np.ndarray
    highest_m: np.ndarray


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
    """Return what stands by the features of a file: buildings with their parts, and all else.

    What stands is decided by `what_stands`, heights by `estimate_heights`, the order of outlines and their parts by
    `_buildings`, and what stands beside buildings by `to_structures`.

    Args:
      file: the file of the outlines and what to make of it; with hanging ``"slabs"`` areas of bridges
        (``man_made=bridge``) that are no buildings are decks (see `with_decks`).
      outlines: from a reader.
      crs: projected CRS of the buildings.
      learns: whether the outlines' own heights say what is guessed and likely of unknown ones, as of a whole file.

    Raises:
      InputError: no building and no declared box, in a file that was read as a whole.
    """
    to_city = transformer(outlines.crs, crs)
    boxes_m = [to_city.transform_bounds(*box, densify_pts=101) for box in outlines.boxes]
    features, is_building, issues_of_features = _in_city(outlines, crs, file.hanging == SLABS)
    if not (boxes_m or len(features.polygons) or outlines.is_part):
        raise InputError(
            f"{str(file.source)!r} holds no building: give a file with polygons of buildings"
        )
    buildings, learned_by_class, issues_of_buildings = _buildings(
        features.take(is_building), file, learns
    )
    structures, learned_by_kind, issues_of_structures = to_structures(
        file, features.take(~is_building), buildings, _waters(outlines, crs), learns
    )
    structures = _within(structures, file, buildings)
    issues = Counter(outlines.issues)
    for more in (issues_of_features, issues_of_buildings, issues_of_structures):
        issues.update(more)
    learned = learned_by_class | learned_by_kind
    return WhatStands(buildings, structures, boxes_m, dict(issues), learned)


def _waters(outlines: Outlines, crs: str) -> np.ndarray:
    """Return the valid shapes of water of a file in another CRS."""
    waters = shapely.make_valid(outlines.polygons[is_water(outlines)])
    return shapely.transform(waters, transformer(outlines.crs, crs).transform, interleaved=False)


def _in_city(
    outlines: Outlines, crs: str, has_slabs: bool
) -> tuple[Outlines, np.ndarray, ReadIssues]:
    """Return what stands in the city's CRS, which are buildings, ``[N]`` bool, and what was left out or repaired.

    Of solids the height counts in place of what the file says of it, unless that is more than `DIFFER_M` higher than
    the whole solid. Walls alone, whose height is 0, close nothing.

    Args:
      outlines: from a reader.
      crs: projected CRS of the result.
      has_slabs: whether areas of bridges are decks.
    """
    features, left_out = what_stands(outlines, has_slabs)
    prisms, of_shapes = _project(prisms_of_solids(features), outlines.crs, crs)
    features = features.take(prisms["feature"].to_numpy(int))
    height_m = prisms["height_m"].to_numpy(float)
    stated_m = read_column(features.column("height"), parse_length_m)
    top_m = prisms.groupby("feature")["height_m"].transform("max").to_numpy()
    is_lower = (stated_m > top_m + DIFFER_M) & (stated_m <= MAX_HEIGHT_M)
    height = np.where(np.isnan(height_m) | is_lower, features.column("height"), height_m)
    tags = {**features.tags, "height": height, "rise_m": prisms["rise_m"].to_numpy(float)}
    is_building = (tags["verdict"] == BUILDING) & prisms["is_whole"].to_numpy() & (height_m != 0)
    features = replace(features, polygons=prisms["polygon"].to_numpy(), tags=tags)
    of_solids = {
        ReadIssue.SOLIDS: prisms["feature"][is_building & (height_m > 0)].nunique(),
        ReadIssue.SOLIDS_COARSE: prisms["feature"][is_building & is_lower].nunique(),
    }
    return features, is_building, {**left_out, **of_shapes, **of_solids}


def _buildings(
    found: Outlines, file: settings.Buildings, learns: bool
) -> tuple[Footprints, dict[str, Learned], ReadIssues]:
    """Return buildings with their heights, what is learned by class, and what was met.

    An outline that its own parts cover to `REPLACED_SHARE` gives way to them, but for podiums and bare strips
    (`_podiums`, `_beside_parts`); one that is tagged as a part as well is a part, and stands.

    Args:
      found: outlines and parts, in a projected CRS.
      file, learns: as of `to_buildings`.
    """
    stated, issues = _stated(found, file)
    parts = _own_parts(found)
    known = _known_of(stated, found, parts, learns)
    guessed = stated
    if file.default_height_m is None:
        guessed = _with_guesses(stated, found, known)
    fitted, of_parts = _with_outline_heights(guessed, parts)
    is_covered = parts.share >= REPLACED_SHARE
    issues |= of_parts | {ReadIssue.OUTLINES_REPLACED_BY_PARTS: num_of(is_covered)}
    on_podiums, is_podium = fitted, np.zeros(len(fitted), bool)
    if file.hanging == SLABS:
        on_podiums, is_podium = _podiums(fitted, parts, is_covered)
        issues[ReadIssue.OUTLINES_KEPT_AS_PODIUMS] = num_of(is_podium)
    bounded = replace(
        on_podiums,
        limit_m=_limits_m(on_podiums, found, file, known),
        likely_m=_likelies_m(on_podiums, found, known.likely_m),
        rule=found.tags["rule"],
    )
    reshaped, is_replaced = _beside_parts(bounded, parts, is_covered & ~is_podium)
    buildings = _within(reshaped.take(~is_replaced), file)
    issues[ReadIssue.PARTS_HANGING] = num_of(buildings.min_height_m > 0)
    return buildings, known.learned, issues


def _stated(found: Outlines, file: settings.Buildings) -> tuple[Footprints, ReadIssues]:
    """Return buildings with the heights that the file states, decks by their layers too, and what was met."""
    is_deck = found.tags["is_deck"]
    stated, issues = estimate_heights(found.tags, found.polygons, found.tags["is_part"], file)
    if not is_deck.any():
        return stated, issues
    layer = pd.to_numeric(pd.Series(found.texts("layer")), errors="coerce")
    return with_decks(stated, is_deck, layer.to_numpy(float)), issues


def _known_of(stated: Footprints, found: Outlines, parts: Parts, learns: bool) -> Known:
    """Return what is known by the heights of a file.

    Args:
      stated: ``N`` outlines and parts, as the file has them.
      found: what they were made of.
      parts: of the outlines.
      learns: as of `to_buildings`.
    """
    of_size = _classes(found)
    classes = np.where(found.tags["is_part"], PARTS + of_size, of_size)
    stated_m, known_m = _known_m(stated, found, parts)
    learned = learned_from(classes, stated_m * learns, known_m * learns)
    likely_m = of_classes(learned, classes, "likely_m")
    return Known(classes, learned, likely_m, _highest_m(found, of_size, known_m))


def _with_guesses(buildings: Footprints, found: Outlines, known: Known) -> Footprints:
    """Return buildings that have the guesses of their classes where the file says no height."""
    is_open = built_shares(found.polygons) < OPEN_SHARE
    in_open_m = of_classes(known.learned, known.classes, "open_guess_m")
    beside_others_m = of_classes(known.learned, known.classes, "guess_m")
    of_class_m = np.where(is_open, in_open_m, beside_others_m)
    guess_m = np.minimum(of_class_m, limits_by_name_m(found, np.inf))
    height_m = np.where(buildings.height_m == 0, guess_m, buildings.height_m)
    return replace(buildings, height_m=height_m)


def _likelies_m(buildings: Footprints, found: Outlines, likely_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` what is likely: of a class, ``likely_m``, over the underside and what the outline rises."""
    is_of_class = np.isin(buildings.origin, OF_CLASS)
    over_m = likely_m + buildings.min_height_m + found.tags["rise_m"]
    return np.where(is_of_class, np.fmax(over_m, lengths_m(found, "estimated_to_m")), np.inf)


def _classes(found: Outlines) -> np.ndarray:
    """Return the class of each building, ``[N]`` objects: by its size, or that of the outline that it lies in.

    A part that lies in none is a part `IN_NONE`, whatever it touches: of those of Murray Hill that touch a small
    building and nothing else 4 of 19 are higher than 100 m.
    """
    polygons = found.polygons
    area_m2 = shapely.area(polygons)
    wholes = np.flatnonzero(found.tags["is_outline"])
    middles = shapely.point_on_surface(polygons)
    inner, whole = shapely.STRtree(polygons[wholes]).query(middles, predicate="within")
    np.maximum.at(area_m2, inner, area_m2[wholes[whole]])
    classes = classes_of(area_m2)
    classes[np.setdiff1d(np.flatnonzero(found.tags["is_part"]), inner)] = IN_NONE
    return classes


def _known_m(buildings: Footprints, found: Outlines, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights that the file states, and the same with those by levels, ``[N]`` each, 0 of all others.

    An outline is at least as high as its highest part.

    Args:
      buildings: ``N`` outlines and parts, as the file has them.
      found: which of them are decks, whose heights are not learned from.
      parts: of the outlines.
    """
    is_deck = found.tags["is_deck"]

    def heights_by(*origins: HeightOrigin) -> np.ndarray:
        """Return the heights that are known in some ways."""
        is_known = np.isin(buildings.origin, origins) & ~is_deck
        height_m = np.where(is_known, buildings.height_m, 0.0)
        np.maximum.at(height_m, parts.outline, height_m[parts.part])
        return height_m

    return heights_by(HeightOrigin.HEIGHT), heights_by(HeightOrigin.HEIGHT, HeightOrigin.LEVELS)


def _highest_m(found: Outlines, classes: np.ndarray, known_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` the highest that the file knows of the class of each; of a part that lies in none it is not known.

    Args:
      found: what their tags call them: what names call low is a class of its own.
      classes: ``[N]`` objects, of a part that of its building.
      known_m: ``[N]`` heights, 0 of what the file does not know.
    """
    groups = np.where(found.says("building", LOW_BUILDINGS.split()), "low", classes)
    number, names = pd.factorize(groups)
    highest_m = np.zeros(len(names))
    np.maximum.at(highest_m, number, known_m)
    highest_m[names == IN_NONE] = np.inf
    return highest_m[number]


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
    known: Known,
) -> np.ndarray:
    """Return ``[B]`` the bound of buildings of guessed height; of decks it is not known.

    Vertices of outlines may lie on the ground or on roofs: how far they rise counts in full.

    Args:
      buildings: with their heights.
      found: ``B`` outlines with what their tag calls them and how far they rise.
      rules: height of one level.
      known: of their classes. What names call low is bounded by the highest that the file knows;
        others have no bound where higher ones are known, likely or estimated, as nothing says how high a tower is.
    """
    by_name_m = np.maximum(limits_by_name_m(found, LIMIT_M), found.tags["kind_limit_m"])
    is_low = by_name_m < LIMIT_M
    is_higher = np.fmax(known.highest_m, known.likely_m) > by_name_m
    bounds_m = [np.maximum(by_name_m, known.highest_m), np.inf]
    of_class_m = np.select([is_low, is_higher], bounds_m, by_name_m) + found.tags["rise_m"]
    limits_m = {
        HeightOrigin.DEFAULT: of_class_m,
        HeightOrigin.ROUGH: np.maximum(ROUGH_LIMIT * buildings.height_m, of_class_m),
        HeightOrigin.ESTIMATED: np.where(
            buildings.height_m > of_class_m,
            np.inf,
            np.fmax(of_class_m, lengths_m(found, "estimated_to_m")),
        ),
    }
    of_origin = [buildings.origin == origin for origin in limits_m]
    above_m = np.select(of_origin, list(limits_m.values()), np.inf)
    of_levels_m = limits_by_levels_m(buildings, rules.level_height_m)
    return np.where(np.isnan(of_levels_m), buildings.min_height_m + above_m, of_levels_m)


def _beside_parts(
    buildings: Footprints, parts: Parts, is_replaced: np.ndarray
) -> tuple[Footprints, np.ndarray]:
    """Return buildings in which outlines cover what their parts leave, and which still give way to them, ``[N]`` bool.

    These are outlines with the height of their tower (see `_beside_tower_m`), whose rest is guessed to be lower, but no
    higher than the outline's height; and those that would give way but leave a strip of more than `STRIP_M`.

    Args:
      buildings: ``N`` outlines and parts.
      parts: of the outlines.
      is_replaced: ``[N]`` bool, which outlines give way to their parts.
    """
    outline, part, share = parts
    reshaped = _copied(buildings)
    assert reshaped.limit_m is not None
    is_bare = (1 - share) * shapely.area(buildings.polygons) > STRIP_M
    may_stand = ~is_replaced | is_bare
    gives_way = is_replaced.copy()
    for owner in np.unique(outline[may_stand[outline]]):
        inner = part[outline == owner]
        height_m = buildings.height_m[owner]
        rest_m = _beside_tower_m(buildings, owner, inner)
        is_lower = rest_m < height_m
        if not (is_lower or is_replaced[owner]):
            continue
        rest = _uncovered(buildings.polygons[owner], buildings.polygons[inner])
        is_strip = is_replaced[owner] and rest.buffer(-STRIP_M / 2).is_empty
        if rest.is_empty or is_strip:
            continue
        gives_way[owner] = False
        reshaped.polygons[owner] = rest
        if is_lower:
            reshaped.height_m[owner] = rest_m
            reshaped.origin[owner] = HeightOrigin.BESIDE_PARTS
            reshaped.limit_m[owner] = height_m
    return reshaped, gives_way


def _uncovered(outline: shapely.Geometry, parts: np.ndarray) -> shapely.Geometry:
    """Return the area of an outline that its parts, ``[P]`` polygons, leave; empty where they cover it."""
    return polygonal(shapely.difference(outline, shapely.union_all(parts)))


def _beside_tower_m(buildings: Footprints, owner: int, inner: np.ndarray) -> float:
    """Return how high an outline is beside its tower, whose height mappers give it; its own height where they do not.

    They do where its highest part is as high, and a lower one stands on the ground: as high as the lowest of these is
    the rest.

    Args:
      buildings: outlines and parts, of which only known heights count.
      owner: index of the outline.
      inner: indices of its parts.
    """
    height_m = buildings.height_m[owner]
    if buildings.origin[owner] != HeightOrigin.HEIGHT:
        return height_m
    known = inner[buildings.origin[inner] == HeightOrigin.HEIGHT]
    part_m = buildings.height_m[known]
    lowest_m = part_m[buildings.min_height_m[known] == 0].min(initial=height_m)
    has_tower = abs(part_m.max(initial=0) - height_m) <= SAME_HEIGHT_M
    is_lower = lowest_m < height_m - SAME_HEIGHT_M
    return lowest_m if has_tower and is_lower else height_m


def _copied(buildings: Footprints) -> Footprints:
    """Return buildings in columns of their own, which may be written to."""
    return buildings.take(np.arange(len(buildings)))


def _project(prisms: pd.DataFrame, source: str, crs: str) -> tuple[pd.DataFrame, ReadIssues]:
    """Return prisms in another CRS, valid and without heights, those that could be made, and what was met.

    Polygons alone in a MultiPolygon, as those of OpenStreetMap are made, come without it: maps burn them more quickly.

    Args:
      prisms: of `prisms_of_solids`; a polygon may be of any kind, and None where there is none.
      source: their CRS.
      crs: projected CRS of the result.

    Returns:
      A column more: ``is_whole``, false of what lacks a vertex, and of areas that have become a line or a point; and
      how many were repaired, are missing or empty, or lie where the CRS does not reach.
    """
    to_city = transformer(source, crs).transform
    moved = shapely.transform(prisms["polygon"].to_numpy(), to_city, interleaved=False)
    is_there = shapely.get_num_coordinates(moved) > 0
    hulls, lacks_vertex = _hulls_of_known(moved)
    is_on_map = shapely.get_num_coordinates(hulls) > 0
    valid, is_repaired, is_flat = _repaired(hulls)
    made = prisms.assign(polygon=_unwrapped(valid), is_whole=~lacks_vertex & ~is_flat)
    issues = {
        ReadIssue.OUTSIDE_CRS: num_of(is_there & ~is_on_map),
        ReadIssue.POLYGONS_REPAIRED: num_of(is_repaired),
        ReadIssue.POLYGONS_DROPPED: num_of(~is_there),
    }
    return made[is_on_map], issues


def _hulls_of_known(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return shapes, of those that lack finite vertices the hull of the others, and which lack some, ``[N]`` each."""
    vertices, shape_of = shapely.get_coordinates(shapes, return_index=True)
    is_finite = np.isfinite(vertices).all(axis=1)
    lacks_vertex = np.zeros(len(shapes), bool)
    lacks_vertex[shape_of[~is_finite]] = True
    hulls = shapes.copy()
    for index in np.flatnonzero(lacks_vertex):
        known = vertices[is_finite & (shape_of == index)]
        hulls[index] = shapely.convex_hull(shapely.multipoints(known))
    return hulls, lacks_vertex


def _repaired(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return valid shapes, which were repaired, and which became a line or a point, of which the hull is kept.

    Args:
      shapes: ``[N]``; those without a vertex, or None, are left as they are.
    """
    is_broken = (shapely.get_num_coordinates(shapes) > 0) & ~shapely.is_valid(shapes)
    broken = shapes[is_broken]
    areas = [polygonal(each) for each in shapely.make_valid(broken, method="structure")]
    became_flat = shapely.is_empty(areas)
    valid = shapes.copy()
    valid[is_broken] = np.where(became_flat, shapely.convex_hull(broken), areas)
    is_flat = np.zeros(len(shapes), bool)
    is_flat[is_broken] = became_flat
    return valid, is_broken & ~is_flat, is_flat


def _unwrapped(shapes: np.ndarray) -> np.ndarray:
    """Return ``[N]`` shapes, polygons that are alone in a MultiPolygon without it."""
    is_multi = shapely.get_type_id(shapes) == shapely.GeometryType.MULTIPOLYGON
    is_alone = is_multi & (shapely.get_num_geometries(shapes) == 1)
    unwrapped = shapes.copy()
    unwrapped[is_alone] = shapely.get_geometry(shapes[is_alone], 0)
    return unwrapped


def _own_parts(found: Outlines) -> Parts:
    """Return which parts belong to which outlines, as far as `BELONGING_SHARE` of each, and what share they cover.

    Args:
      found: ``N`` valid polygons, outlines, parts and decks.
    """
    polygons = found.polygons
    outlines = np.flatnonzero(found.tags["is_outline"])
    parts = np.flatnonzero(found.tags["is_part"])
    tree = shapely.STRtree(polygons[parts])
    near_outline, near_part = tree.query(polygons[outlines], predicate="intersects")
    outline, part = outlines[near_outline], parts[near_part]
    shared = shapely.intersection(polygons[outline], polygons[part])
    belongs = shapely.area(shared) >= BELONGING_SHARE * shapely.area(polygons[part])
    outline, part, shared = outline[belongs], part[belongs], shared[belongs]

    share = np.zeros(len(polygons))
    for owner, own in pd.Series(shared).groupby(outline):
        share[owner] = shapely.union_all(own).area / shapely.area(polygons[owner])
    return Parts(outline, part, share)


def _podiums(
    buildings: Footprints, parts: Parts, is_replaced: np.ndarray
) -> tuple[Footprints, np.ndarray]:
    """Return buildings in which replaced outlines are podiums where they have one, and which these are, ``[N]`` bool.

    A podium lies under an outline's own hanging parts where none of its parts stands, up to their lowest floor.

    Args:
      buildings: ``N`` outlines and parts.
      parts: of the outlines.
      is_replaced: ``[N]`` bool, which outlines give way to their parts.
    """
    outline, part, _ = parts
    podiums = _copied(buildings)
    is_podium = np.zeros(len(podiums), bool)
    hangs = buildings.min_height_m > 0
    for owner in np.unique(outline[is_replaced[outline] & hangs[part]]):
        bare, lowest = _below_hanging(buildings, owner, part[outline == owner])
        if buildings.min_height_m[lowest] > buildings.min_height_m[owner]:
            is_podium[owner] = True
            podiums.polygons[owner] = polygonal(bare)
            podiums.height_m[owner] = buildings.min_height_m[lowest]
            podiums.origin[owner] = buildings.origin[lowest]
    return podiums, is_podium


def _below_hanging(
    buildings: Footprints, owner: int, own: np.ndarray
) -> tuple[shapely.Geometry, int]:
    """Return where an outline's parts hang and none stands, and which of them is lowest there, else the outline itself.

    Args:
      buildings: outlines and parts.
      owner: index of the outline.
      own: indices of its parts.
    """
    hangs = buildings.min_height_m[own] > 0
    standing = shapely.union_all(buildings.polygons[own[~hangs]])
    hanging = own[hangs]
    below = shapely.intersection(buildings.polygons[hanging], buildings.polygons[owner])
    bare = shapely.difference(below, standing)
    is_wide = shapely.area(bare) > PODIUM_M2
    hanging = hanging[is_wide]
    lowest = hanging[np.argmin(buildings.min_height_m[hanging])] if len(hanging) else owner
    return shapely.union_all(bare[is_wide]), lowest


def _with_outline_heights(buildings: Footprints, parts: Parts) -> tuple[Footprints, ReadIssues]:
    """Return buildings in which parts without a height have that of their highest outline of known height, and issues.

    Every roof is above its underside then. A roof at or below it is raised by the underside's height if it is an
    estimate, by levels or by default; if its height is known, the underside is set to 0.

    Args:
      buildings: ``N`` outlines and parts.
      parts: of the outlines.

    Returns:
      ``N`` buildings, and how many parts were given a height and how many undersides were set to 0.
    """
    # From the lowest outline up, so that of several outlines of a part the highest is written last.
    lowest_first = np.argsort(buildings.height_m[parts.outline], kind="stable")
    outline, part = parts.outline[lowest_first], parts.part[lowest_first]
    min_height_m = buildings.min_height_m
    is_default = buildings.origin == HeightOrigin.DEFAULT
    # A part that hangs above its outline's roof is not as high as it but higher.
    is_above = min_height_m[part] >= buildings.height_m[outline]
    takes = is_default[part] & ~is_default[outline] & ~is_above
    height_m = buildings.height_m.copy()
    height_m[part[takes]] = buildings.height_m[outline[takes]]
    origin = buildings.origin.copy()
    origin[part[takes]] = buildings.origin[outline[takes]]

    # Roofs at their undersides or below.
    is_wrong = min_height_m >= height_m
    is_known = origin == HeightOrigin.HEIGHT
    issues = {
        ReadIssue.PARTS_GIVEN_OUTLINE_HEIGHT: len(np.unique(part[takes])),
        ReadIssue.MIN_HEIGHTS_ABOVE_ROOF: num_of(is_wrong & is_known),
    }
    buildings = replace(
        buildings,
        height_m=np.where(is_wrong & ~is_known, height_m + min_height_m, height_m),
        min_height_m=np.where(is_wrong & is_known, 0.0, min_height_m),
        origin=origin,
    )
    return buildings, issues
