"""What of a file's features stands: one rule for every format, a building, another structure, or nothing and why."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
import shapely

from jaxurban.cities.bridges import DECK, is_raised
from jaxurban.cities.heights import is_given, parse_count, parse_height_m, read_column
from jaxurban.cities.kinds import (
    BRIDGE,
    BY_VALUE,
    FALLS,
    FENCE,
    FIXED,
    GARAGES,
    GENERATOR,
    GROUND,
    HULL,
    IN_WORDS,
    KINDS,
    LAMP,
    LANDFORMS,
    LOW,
    LOW_M,
    NOT_BUILT,
    OTHER,
    OVERGROUND,
    OVERHEAD,
    SITE,
    TURBINE,
    UNLISTED,
    WATERS,
    WIND,
    Kind,
    Nothing,
    Reason,
)
from jaxurban.cities.outlines import Outlines
from jaxurban.io.issues import LEFT_OUT, ReadIssue, ReadIssues
from jaxurban.settings import MAX_HEIGHT_M
from jaxurban.world.footprints import BUILDING, UNKNOWN

NO = ("", "no", "false", "none", "null", "nan")
FLAGS = {"0", "0.0", "1", "1.0"}  # of a column of yes and no; other numbers are names
LEVEL = re.compile(r"(?<!\d)-?\d+")  # also of a range: -1-3


def what_stands(outlines: Outlines, has_decks: bool, issues: ReadIssues) -> Outlines:
    """Return those features that stand by their tags, ``N``, with what they are beside their tags.

    Of files that do not say what is a building every area is one, unless the table of kinds has it. What is in the
    table and a building is a building. A building without an area (a line, a point) is a `HULL`.

    Args:
      outlines: with their tags.
      has_decks: whether areas of bridges that are no buildings are decks.
      issues: gets how many are left out, by reason.

    Returns:
      Tags more: ``verdict``, ``[N]`` objects, `BUILDING` or the `Kind` of another structure; ``label``, what the file
      calls what is unknown; ``kind_limit_m``, the bound of a building's other kind, 0 without one; ``is_part`` and
      ``is_deck``, ``[N]`` bool, of buildings.
    """
    is_areal = ~np.isin(shapely.get_dimensions(outlines.polygons), (0, 1))
    is_part = _says_yes(outlines, "part")
    kinds, label = _kinds(outlines, is_areal)
    is_kind, is_nothing = (_is_each(kinds, of) for of in (Kind, Nothing))
    limit_m = np.zeros(len(kinds))
    limit_m[is_kind] = [kind.limit_m for kind in kinds[is_kind]]
    verdict = kinds.copy()
    is_building = is_areal & pd.isna(verdict)
    is_deck = has_decks & is_areal & (outlines.texts("man_made") == DECK) & ~is_part
    if "building" in outlines.tags:
        is_building = _says_yes(outlines, "building") | is_part
        is_building &= ~outlines.says("building", NOT_BUILT)
        is_deck &= ~is_building
    is_building |= is_deck
    verdict[is_building] = HULL
    verdict[is_building & is_areal] = BUILDING

    # Why the others are left out.
    verdict[pd.isna(verdict)] = ReadIssue.NOT_BUILDINGS
    verdict[is_nothing & ~is_building] = ReadIssue.NOT_STANDING
    stands = is_kind | is_building
    verdict[~stands & is_water(outlines)] = None
    is_below = stands & _is_below(outlines)
    verdict[is_below] = ReadIssue.UNDERGROUND
    issues |= {reason: int(np.sum(verdict == reason)) for reason in LEFT_OUT}
    more = {
        "verdict": verdict,
        "label": label,
        "kind_limit_m": limit_m,
        "is_part": is_part,
        "is_deck": is_deck,
    }
    return replace(outlines, tags={**outlines.tags, **more}).take(stands & ~is_below)


def _is_each(values: np.ndarray, of: type) -> np.ndarray:
    """Return ``[N]`` whether objects are of a class; most of them are None."""
    is_of = ~pd.isna(values)
    is_of[is_of] = [isinstance(value, of) for value in values[is_of]]
    return is_of


def is_water(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether features are water, or a shore of it."""
    return np.logical_or.reduce([outlines.says(key, values) for key, values in WATERS.items()])


def _says_yes(outlines: Outlines, name: str) -> np.ndarray:
    """Return ``[N]`` whether a tag has any value but those that mean no."""
    texts = {*outlines.texts(name)}
    is_number = {value for value in texts if value[:1].isdigit()}
    no = NO if is_number - FLAGS else (*NO, "0", "0.0")
    return outlines.says(name, texts.difference(no))


def _kinds(outlines: Outlines, is_areal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what each feature is by its tags, and what the file calls it where that is unknown, ``[N]`` objects each.

    The first is a `Kind`, a `Reason` why nothing stands, or None where the tags say nothing. Of several tags that name
    something the strongest counts: a kind, then what is unknown, a site, and reasons. A height makes anything stand
    that no table knows, or that does not stand by its kind, from `LOW_M` on; one that cannot be read makes it unknown,
    one in words where no table knows it.
    The height of a form of the land (a peak, water) is none of what stands on it, and the word yes of another key says
    of an area of water that this is historic or made; what is razed or planned is left out unless its other tags name a
    kind.

    Args:
      outlines: with their tags.
      is_areal: ``[N]`` bool.
    """
    kind = np.full(len(is_areal), None, object)
    label = np.full(len(is_areal), "", object)
    is_said = outlines.texts("building") != "" if "building" in outlines.tags else is_areal
    height = outlines.column("height")
    is_worded = np.zeros(len(is_areal), bool)
    barrier = outlines.texts("barrier")
    for index in np.flatnonzero(is_given(height) & ~is_said):
        text = str(height[index]).strip().lower()
        is_worded[index] = text.isalpha() and text not in NO
        if is_worded[index]:
            continue
        height_m = parse_height_m(text)
        standing = FENCE if barrier[index] else SITE
        kind[index] = standing if height_m >= LOW_M else LOW
        if height_m > MAX_HEIGHT_M:
            kind[index] = OTHER
    is_low = (kind == LOW) | _says_yes(outlines, "indoor")
    kind[outlines.says("natural", LANDFORMS) & ~is_said] = GROUND
    kind[outlines.says("waterway", FALLS)] = GROUND
    for reason in (ReadIssue.RAZED, ReadIssue.PLANNED):
        values = [value for value, why in NOT_BUILT.items() if why is reason]
        kind[_says_yes(outlines, reason) | outlines.says("building", values)] = reason
    is_pond = is_areal & (outlines.texts("natural") == "water")
    is_above = is_raised(outlines)
    is_way = shapely.get_dimensions(outlines.polygons) > 0
    kind[is_above] = FIXED  # stops on a bridge, ways within a building
    kind[is_above & is_way & ~is_low] = BRIDGE
    is_turned = _says_yes(outlines, "rotor") | _says_yes(outlines, "hub")
    kind[is_turned | outlines.says("wind", WIND)] = TURBINE

    is_tagged = "building" in outlines.tags  # and no column of numbers
    for key, by_value in (BY_VALUE | IN_WORDS | KINDS).items():
        if key not in outlines.tags:
            continue
        texts = outlines.texts(key)
        named = {text: _kind_of(text, by_value, is_tagged) for text in {*texts}}
        telling = [text for text, of_text in named.items() if of_text is not None]
        for index in np.flatnonzero(outlines.says(key, telling)):
            of_key = named[texts[index]]
            is_unknown = isinstance(of_key, Kind) and of_key.name == UNKNOWN
            is_stronger = _strength(of_key) >= _strength(kind[index])
            is_known = is_low[index] or (is_pond[index] and texts[index] == "yes")
            if is_stronger and not (is_unknown and is_known):
                kind[index] = of_key
                label[index] = f"{key}={texts[index]}" if is_unknown else ""
    is_worded &= pd.isna(kind)
    kind[is_worded] = UNLISTED
    label[is_worded] = "height"
    kind[~is_way & ((kind == OVERHEAD) | (kind == OVERGROUND))] = LAMP  # signs and signals
    is_open = (outlines.texts("power") == "generator") & (outlines.texts("wind") == "")
    is_open &= (kind == SITE) & ~is_given(height) & ~is_said
    kind[is_open] = GENERATOR
    label[is_open] = "power=generator"
    return kind, label


def _kind_of(
    text: str, by_value: Mapping[str, Kind | Reason], has_numbers: bool
) -> Kind | Reason | None:
    """Return what a value of a key, or a list of them with semicolons, names; None where it says no or nothing.

    Args:
      text: the value in small letters.
      by_value: what the key's values name.
      has_numbers: whether a number but 0 names something as well.
    """
    words = [word.strip() for word in text.split(";")]
    words = [word for word in words if word not in (*NO, "0", "0.0")]
    other = by_value.get("*")
    named = [by_value.get(word, other) for word in words if has_numbers or word[0].isalpha()]
    return max(named, key=_strength, default=None)


def _strength(kind: Kind | Reason | None) -> int:
    """Return how much what a tag names counts beside what other tags do."""
    if not isinstance(kind, Kind):
        return 0 if kind is None else 1
    return 2 if kind == SITE else 3 + (kind.name != UNKNOWN)


def _is_below(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether features lie below the ground: a layer below 0 does not say it, which orders alone."""
    is_below = outlines.texts("location") == ReadIssue.UNDERGROUND
    is_below_only = np.zeros(len(is_below), bool)
    level = outlines.texts("level")
    is_building = (outlines.texts("building") != "") | (outlines.texts("part") != "")
    for index in np.flatnonzero((level != "") & is_building):
        numbers = LEVEL.findall(level[index])
        is_below_only[index] = bool(numbers) and all(number[0] == "-" for number in numbers)

    # Levels below the ground and none above it; a height says that something stands there all the same.
    levels, roof_levels = (
        read_column(outlines.column(name), parse_count) for name in ("levels", "roof_levels")
    )
    has_none = (levels == 0) & (outlines.texts("levels_below") != "")
    is_below_only |= has_none & ~(roof_levels > 0)
    is_parking = outlines.texts("parking") == ReadIssue.UNDERGROUND
    is_parking &= outlines.says("building", GARAGES)
    is_flat = ~is_given(outlines.column("height"))
    return is_below | is_flat & (is_below_only | is_parking & ~(levels > 0))
