"""Signs: what several tags of a feature say together, or with its shape or its height, and no value says alone.

The table of `rules.py` names each by the same words. A height is that of what stands, but for four: those of forms of
the land, of what does not stand any more or not yet, and of what carries traffic are heights of something else.
"""

from typing import Any

import numpy as np
import shapely

from jaxurban.cities.bridges import DECK, is_raised
from jaxurban.cities.heights import is_given, parse_count, parse_height_m, read_column
from jaxurban.cities.kinds import FALLS, GONE, LANDFORMS, LOW_M, NOT_BUILT, WIND
from jaxurban.cities.outlines import Outlines
from jaxurban.io.issues import ReadIssue
from jaxurban.settings import MAX_HEIGHT_M

NO = ("", "no", "false", "none", "null", "nan")
ZERO = ("0", "0.0")
FLAGS = {*ZERO, "1", "1.0"}  # of a column of yes and no; other numbers are names
Signs = dict[str, Any]


def signs_of(outlines: Outlines, has_decks: bool) -> Signs:
    """Return which of ``N`` features have a sign, ``[N]`` bool by its name.

    Among them are shapes, ``"points"``, ``"areas"`` and those of which some may be lone, and what rules ask beside:
    ``"part"`` of a building, ``"low"`` or indoors, and ``"pond"``.

    Args:
      outlines: the features.
      has_decks: whether areas of bridges that are no buildings are decks.
    """
    shapes = _shape_signs(outlines)
    # As a building; in a file that never says it every area is one.
    is_named = _has(outlines, "building") if shapes["names"] else shapes["areas"]
    height_m, is_worded = _heights_beside(outlines, ~is_named)
    is_low = (height_m < LOW_M) | _has(outlines, "indoor")
    is_traffic = is_raised(outlines)
    is_landform = outlines.says("natural", LANDFORMS.split()) & ~is_named
    of_something_else = {
        "form of the land, or a waterfall": is_landform | outlines.says("waterway", FALLS),
        "razed": _is_gone(outlines, ReadIssue.RAZED),
        "planned": _is_gone(outlines, ReadIssue.PLANNED),
        "traffic above the ground": is_traffic,
    }
    is_own = ~np.logical_or.reduce([*of_something_else.values()])
    return {
        **shapes,
        **of_something_else,
        **_building_signs(outlines, shapes, is_own, has_decks),
        **_height_signs(outlines, height_m, is_own),
        **_thing_signs(outlines, np.isnan(height_m) & ~is_worded & ~is_named),
        "low": is_low,
        "height in words": is_worded,
        "pond": shapes["areas"] & outlines.says("natural", ["water"]),
        "way of traffic above the ground": is_traffic & shapes["ways"] & ~is_low,
    }


def _shape_signs(outlines: Outlines) -> Signs:
    """Return the signs of shapes; something is lone only beside buildings that the file names."""
    dimension = shapely.get_dimensions(outlines.polygons)
    is_way = dimension > 0
    is_area = ~np.isin(dimension, (0, 1))  # what has no shape may have been one
    has_names = "building" in outlines.tags
    return {
        "points": ~is_way,
        "ways": is_way,
        "areas": is_area,
        "names": has_names,
        "lone things": has_names,
        "lone areas": is_area & has_names,
        "lone points": ~is_way & has_names,
    }


def _building_signs(
    outlines: Outlines, shapes: Signs, is_own: np.ndarray, has_decks: bool
) -> Signs:
    """Return which features are buildings by their tags.

    Args:
      outlines, has_decks: as of `signs_of`.
      shapes: of `_shape_signs`.
      is_own: ``[N]`` bool, whether what a file says of heights and levels is of what stands.
    """
    is_area, has_names = shapes["areas"], shapes["names"]
    is_part = _has(outlines, "part")
    is_building = _has(outlines, "building") | (is_part & has_names)
    is_building &= ~outlines.says("building", NOT_BUILT)
    is_bridge = outlines.says("man_made", [DECK])
    has_levels = read_column(outlines.column("levels"), parse_count) > 0
    is_unnamed = outlines.texts("building") == ""
    is_buried = outlines.says("parking", [ReadIssue.UNDERGROUND])
    return {
        "part": is_part,
        "area in a file that names no buildings": is_area & (not has_names),
        "deck of a bridge": is_bridge & has_decks & is_area & ~is_part,
        "building": is_building & is_area,
        "building without an area": is_building & ~is_area,
        "levels of a building": has_levels & has_names & is_own & is_unnamed & ~is_buried,
    }


def _height_signs(outlines: Outlines, height_m: np.ndarray, is_own: np.ndarray) -> Signs:
    """Return the signs by heights, ``[N]`` metres, that are the features' own, or of something else."""
    is_high = is_own & (height_m >= LOW_M)
    is_beyond = is_own & (height_m > MAX_HEIGHT_M)
    return {
        "height below 6 m": height_m < LOW_M,
        "height of 6 m or more": is_high,
        "height beyond 1,000 m, or that cannot be read": is_beyond,
        "barrier of 6 m or more": is_high & ~is_beyond & (outlines.texts("barrier") != ""),
    }


def _thing_signs(outlines: Outlines, is_bare: np.ndarray) -> Signs:
    """Return the signs of wind turbines, generators and artworks.

    Args:
      outlines: the features.
      is_bare: ``[N]`` bool, which are no building by their tags and have no height.
    """
    is_turbine = outlines.says("wind", WIND) | _has(outlines, "rotor") | _has(outlines, "hub")
    is_generator = outlines.says("power", ["generator"])
    is_artwork = outlines.says("tourism", ["artwork"])
    return {
        "wind turbine": is_turbine,
        "generator of unknown source and height": (
            is_generator & is_bare & (outlines.texts("wind") == "")
        ),
        "artwork of unknown type": is_artwork & (outlines.texts("artwork_type") == ""),
    }


def are_lone(
    outlines: Outlines, is_building: np.ndarray, is_asked: np.ndarray, ground_share: float
) -> np.ndarray:
    """Return which of the features that are asked for, ``[N]`` bool, lie in no building and are not their ground.

    A feature is the ground of buildings that cover a share of it. A middle decides what lies in what, as outlines need
    not be valid.

    Args:
      outlines: the features.
      is_building, is_asked: ``[N]`` bool.
      ground_share: of a feature's area. The ground of buildings is covered to more than that, and a building that is
        smaller does not hold the feature.
    """
    is_lone = is_asked.copy()
    asked, buildings = outlines.polygons[is_asked], outlines.polygons[is_building]
    least_m2 = ground_share * shapely.area(asked)
    # Pairs of a feature and a building near it.
    feature, near = shapely.STRtree(buildings).query(asked)
    near_m2 = shapely.area(buildings[near])

    middles = shapely.point_on_surface(asked)[feature]
    is_within = shapely.within(middles, buildings[near]) & (near_m2 >= least_m2[feature])
    once, number = np.unique(near, return_inverse=True)
    middles_of_near = shapely.point_on_surface(buildings[once])[number]
    is_held = shapely.within(middles_of_near, asked[feature])
    held_m2 = np.bincount(feature, near_m2 * is_held, len(asked))
    is_taken = held_m2 > least_m2
    is_taken[feature[is_within]] = True
    is_lone[is_asked] = ~is_taken
    return is_lone


def _has(outlines: Outlines, name: str) -> np.ndarray:
    """Return ``[N]`` whether a tag has a value that does not mean no."""
    texts = {*outlines.words(name)[1]}
    is_number = {value for value in texts if value[:1].isdigit()}
    no = NO if is_number - FLAGS else (*NO, *ZERO)
    return outlines.says(name, texts.difference(no))


def _is_gone(outlines: Outlines, reason: ReadIssue) -> np.ndarray:
    """Return ``[N]`` what does not stand for a reason of `GONE`."""
    return _has(outlines, reason) | outlines.says("building", GONE[reason])


def _heights_beside(outlines: Outlines, is_asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights of features in metres, and whether they are words, ``[N]`` each.

    NaN without one, of words, and of what is no height above the ground, such as "?" and -5; inf of what seems to be
    one and cannot be read.
    """
    column = outlines.column("height")
    height_m = np.full(len(column), np.nan)
    is_worded = np.zeros(len(column), bool)
    for index in np.flatnonzero(is_given(column) & is_asked):
        text = str(column[index]).strip().lower()
        is_worded[index] = text.isalpha() and text not in NO
        if not is_worded[index]:
            height_m[index] = parse_height_m(text)
    return height_m, is_worded
